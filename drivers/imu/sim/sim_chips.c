#include "drivers/imu/sim/sim_chips.h"
#include "model/math/units.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { CHIPS = 3, SETS = 32, WORDS = 4096, ENTRIES = 512, ENTRY = 7, BEHIND_MAX = 64, TEMPERATURE_DEGC = 30 };

enum kind {
	L3G4200D,
	L3GD20,
	L3GD20H,
	DLH_ACCEL,
	DLHC_ACCEL,
	DLH_MAG,
	DLM_MAG,
	DLHC_MAG,
	LSM303D,
	LSM6DS33,
	LSM6DSO,
	LIS3MDL,
	NONE
};

static const struct {
	const char *name;
	struct {
		enum kind kind;
		uint8_t address;
	} chips[CHIPS];
} BOARDS[] = {
	{"v0", {{L3G4200D, 0x69}, {DLH_ACCEL, 0x18}, {DLH_MAG, 0x1E}}},
	{"v1", {{L3G4200D, 0x69}, {DLH_ACCEL, 0x18}, {DLM_MAG, 0x1E}}},
	{"v2", {{L3GD20, 0x6B}, {DLHC_ACCEL, 0x19}, {DLHC_MAG, 0x1E}}},
	{"v3", {{L3GD20H, 0x6B}, {LSM303D, 0x1D}, {NONE, 0}}},
	{"v5", {{LSM6DS33, 0x6B}, {LIS3MDL, 0x1E}, {NONE, 0}}},
	{"v6", {{LSM6DSO, 0x6B}, {LIS3MDL, 0x1E}, {NONE, 0}}},
};

struct sim_triad {
	enum imu_chip what; /* 0: none */
	double rate_hz;	    /* 0: off */
	double rate_error;
	double lsb[3]; /* of the axes x, y, z */
	double grain;  /* step of the word, in digits of lsb */
	struct vec3 self_test;
	bool axis_on[3];
	uint8_t out, status; /* registers: first data register, status */
	uint8_t order[3];    /* register pair of x, y, z */
	struct sensor sensor;
	double epoch_ns;
	int64_t taken;
	int16_t word[3]; /* x, y, z */
	bool ready, overrun;
	bool frozen, stopped, saturated, self_test_broken;
};

struct sim_chip {
	enum kind kind;
	uint8_t address;
	uint8_t regs[256];
	struct sim_triad triads[2];
	bool silent;
	/* FIFO: bytes of sets, words or tagged entries, oldest first */
	uint8_t fifo[WORDS * 2];
	size_t fifo_first, fifo_used, fifo_size, entry; /* in entries; entry: bytes of one */
	bool fifo_on, fifo_overrun;
	unsigned word_phase; /* LSM6DS33: position of the next word in its set */
	size_t entry_byte;   /* of the oldest entry, to be read next */
	unsigned tag_count;
};

struct sim_board {
	struct i2c_bus bus;
	struct sim_config config;
	struct sim_chip chips[CHIPS];
	double start_ns;
	unsigned long accesses;
};

/* ---- effects of the registers ------------------------------------------------------------------------------------ */

static bool is_l3g(enum kind kind)
{
	return kind <= L3GD20H;
}

static bool is_lsm6(enum kind kind)
{
	return kind == LSM6DS33 || kind == LSM6DSO;
}

static bool is_old_mag(enum kind kind)
{
	return kind == DLH_MAG || kind == DLM_MAG || kind == DLHC_MAG;
}

static void set_scale(struct sim_triad *t, double x, double y, double z, double grain)
{
	t->lsb[0] = x;
	t->lsb[1] = y;
	t->lsb[2] = z;
	t->grain = grain;
}

static void set_axes(struct sim_triad *t, unsigned zyx)
{
	for (int i = 0; i < 3; i++)
		t->axis_on[i] = zyx >> i & 1;
}

static void effect_l3g(struct sim_chip *c)
{
	static const double odr[3][4] = {{100, 200, 400, 800}, {95, 190, 380, 760}, {100, 200, 400, 800}};
	static const double low_odr[4] = {12.5, 25, 50, 50};
	static const double mdps[4] = {8.75, 17.5, 70, 70}, test_dps[4] = {130, 200, 530, 530};
	const uint8_t *r = c->regs;
	struct sim_triad *t = &c->triads[0];
	unsigned fs = r[0x23] >> 4 & 3, test = r[0x23] >> 1 & 3;
	double digit = mdps[fs] * 1e-3 * RAD_PER_DEG;

	t->rate_hz = r[0x20] & 8 ? odr[c->kind][r[0x20] >> 6] : 0;
	if (c->kind == L3GD20H && r[0x39] & 1 && t->rate_hz > 0)
		t->rate_hz = low_odr[r[0x20] >> 6];
	set_axes(t, r[0x20]);
	set_scale(t, digit, digit, digit, 1);
	t->self_test = vec3_scale(test == 1   ? 1
				  : test == 3 ? -1
					      : 0,
		(struct vec3){test_dps[fs] * RAD_PER_DEG, -test_dps[fs] * RAD_PER_DEG, test_dps[fs] * RAD_PER_DEG});
	c->fifo_on = r[0x24] & 0x40 && r[0x2E] >> 5 == 2;
}

static void effect_dlh_accel(struct sim_chip *c)
{
	static const double odr[4] = {50, 100, 400, 1000}, mg[4] = {1, 2, 2, 3.9};
	const uint8_t *r = c->regs;
	struct sim_triad *t = &c->triads[0];
	double digit = mg[r[0x23] >> 4 & 3] * M_S2_PER_MG / 16;

	t->rate_hz = r[0x20] >> 5 == 1 ? odr[r[0x20] >> 3 & 3] : 0;
	set_axes(t, r[0x20]);
	set_scale(t, digit, digit, digit, 16);
	t->self_test = vec3_scale(r[0x23] & 2 ? (r[0x23] & 8 ? -1 : 1) : 0,
		(struct vec3){300 * M_S2_PER_MG, -300 * M_S2_PER_MG, 350 * M_S2_PER_MG});
}

static void effect_dlhc_accel(struct sim_chip *c)
{
	static const double odr[16] = {0, 1, 10, 25, 50, 100, 200, 400, 1620, 1344}, mg[4] = {1, 2, 4, 12};
	const uint8_t *r = c->regs;
	struct sim_triad *t = &c->triads[0];
	double digit = mg[r[0x23] >> 4 & 3] * M_S2_PER_MG / 16;

	t->rate_hz = odr[r[0x20] >> 4];
	set_axes(t, r[0x20]);
	set_scale(t, digit, digit, digit, r[0x23] & 8 ? 16 : 64); /* 12 or 10 bits */
	c->fifo_on = r[0x24] & 0x40 && r[0x2E] >> 6 == 2;
}

static void effect_old_mag(struct sim_chip *c)
{
	static const double odr[8] = {0.75, 1.5, 3, 7.5, 15, 30, 75, 220};
	static const double xy[2][8] = {
		{1, 1055, 795, 635, 430, 375, 320, 230}, {1, 1100, 855, 670, 450, 400, 330, 230}};
	static const double z[2][8] = {{1, 950, 710, 570, 385, 335, 285, 205}, {1, 980, 760, 600, 400, 355, 295, 205}};
	const uint8_t *r = c->regs;
	struct sim_triad *t = &c->triads[0];
	unsigned gain = r[0x01] >> 5, table = c->kind != DLH_MAG;

	t->rate_hz = (r[0x02] & 3) == 0 ? odr[r[0x00] >> 2 & 7] : 0;
	set_axes(t, 7);
	set_scale(t, UT_PER_GAUSS / xy[table][gain], UT_PER_GAUSS / xy[table][gain], UT_PER_GAUSS / z[table][gain], 1);
}

static void effect_lsm303d(struct sim_chip *c)
{
	static const double odr[16] = {0, 3.125, 6.25, 12.5, 25, 50, 100, 200, 400, 800, 1600};
	static const double mg[8] = {0.061, 0.122, 0.183, 0.244, 0.732, 0.732, 0.732, 0.732};
	static const double mag_odr[8] = {3.125, 6.25, 12.5, 25, 50, 100, 100, 100};
	static const double mgauss[4] = {0.080, 0.160, 0.320, 0.479};
	const uint8_t *r = c->regs;
	struct sim_triad *a = &c->triads[0], *m = &c->triads[1];
	double digit = mg[r[0x21] >> 3 & 7] * M_S2_PER_MG, field = mgauss[r[0x25] >> 5 & 3] * 1e-3 * UT_PER_GAUSS;

	a->rate_hz = odr[r[0x20] >> 4];
	set_axes(a, r[0x20]);
	set_scale(a, digit, digit, digit, 1);
	a->self_test =
		vec3_scale(r[0x21] & 2 ? 1 : 0, (struct vec3){400 * M_S2_PER_MG, 400 * M_S2_PER_MG, 400 * M_S2_PER_MG});
	c->fifo_on = r[0x1F] & 0x40 && r[0x2E] >> 5 == 2;
	m->rate_hz = (r[0x26] & 3) == 0 ? mag_odr[r[0x24] >> 2 & 7] : 0;
	set_axes(m, 7);
	set_scale(m, field, field, field, 1);
}

static void effect_lsm6(struct sim_chip *c)
{
	static const double odr[16] = {0, 12.5, 26, 52, 104, 208, 416, 833, 1660, 3330, 6660};
	static const double mg[4] = {0.061, 0.488, 0.122, 0.244}, mdps[4] = {8.75, 17.5, 35, 70};
	const uint8_t *r = c->regs;
	struct sim_triad *g = &c->triads[0], *a = &c->triads[1];
	double rate = r[0x11] & 2 ? 4.375e-3 * RAD_PER_DEG : mdps[r[0x11] >> 2 & 3] * 1e-3 * RAD_PER_DEG;
	double digit = mg[r[0x10] >> 2 & 3] * M_S2_PER_MG;

	g->rate_hz = odr[r[0x11] >> 4];
	a->rate_hz = odr[r[0x10] >> 4];
	set_axes(g, 7);
	set_axes(a, 7);
	set_scale(g, rate, rate, rate, 1);
	set_scale(a, digit, digit, digit, 1);
	g->self_test = vec3_scale((r[0x14] >> 2 & 3) == 1 ? 1 : 0,
		(struct vec3){300 * RAD_PER_DEG, 300 * RAD_PER_DEG, 300 * RAD_PER_DEG});
	a->self_test = vec3_scale(
		(r[0x14] & 3) == 1 ? 1 : 0, (struct vec3){500 * M_S2_PER_MG, 500 * M_S2_PER_MG, 500 * M_S2_PER_MG});
	c->fifo_on = (r[0x0A] & 7) == 6 && (c->kind == LSM6DS33 ? r[0x08] == 0x09 : r[0x09] != 0);
}

static void effect_lis3mdl(struct sim_chip *c)
{
	static const double odr[8] = {0.625, 1.25, 2.5, 5, 10, 20, 40, 80}, digits[4] = {6842, 3421, 2281, 1711};
	const uint8_t *r = c->regs;
	struct sim_triad *t = &c->triads[0];
	double field = UT_PER_GAUSS / digits[r[0x21] >> 5 & 3];

	t->rate_hz = (r[0x22] & 3) == 0 ? odr[r[0x20] >> 2 & 7] : 0;
	set_axes(t, 7);
	set_scale(t, field, field, field, 1);
}

static void effect(struct sim_chip *c)
{
	switch (c->kind) {
	case L3G4200D:
	case L3GD20:
	case L3GD20H:
		effect_l3g(c);
		break;
	case DLH_ACCEL:
		effect_dlh_accel(c);
		break;
	case DLHC_ACCEL:
		effect_dlhc_accel(c);
		break;
	case DLH_MAG:
	case DLM_MAG:
	case DLHC_MAG:
		effect_old_mag(c);
		break;
	case LSM303D:
		effect_lsm303d(c);
		break;
	case LSM6DS33:
	case LSM6DSO:
		effect_lsm6(c);
		break;
	case LIS3MDL:
		effect_lis3mdl(c);
		break;
	case NONE:
		break;
	}
}

/* ---- power-on ---------------------------------------------------------------------------------------------------- */

static struct sim_triad triad_of(enum imu_chip what, uint8_t status, uint8_t out, uint8_t y, uint8_t z)
{
	return (struct sim_triad){.what = what, .status = status, .out = out, .order = {0, y, z}};
}

static void default_registers(struct sim_chip *c)
{
	static const uint8_t who[] = {[L3G4200D] = 0xD3,
		[L3GD20] = 0xD4,
		[L3GD20H] = 0xD7,
		[DLM_MAG] = 0x3C,
		[LSM303D] = 0x49,
		[LSM6DS33] = 0x69,
		[LSM6DSO] = 0x6C,
		[LIS3MDL] = 0x3D,
		[NONE] = 0};
	uint8_t *r = c->regs;

	memset(r, 0, sizeof c->regs);
	r[0x0F] = who[c->kind];
	if (is_l3g(c->kind) || c->kind == DLH_ACCEL || c->kind == DLHC_ACCEL || c->kind == LSM303D)
		r[0x20] = 0x07;
	if (is_l3g(c->kind))
		r[0x26] = (uint8_t)(25 - TEMPERATURE_DEGC);
	if (is_old_mag(c->kind)) {
		memcpy(r + 0x0A, "H43", 3);
		r[0x00] = 0x10;
		r[0x01] = 0x20;
		r[0x02] = 0x03;
	}
	if (c->kind == LSM303D) {
		r[0x24] = 0x18;
		r[0x25] = 0x20;
		r[0x26] = 0x01;
	}
	if (is_lsm6(c->kind)) {
		int16_t digits = (TEMPERATURE_DEGC - 25) * (c->kind == LSM6DSO ? 256 : 16);

		r[0x12] = 0x04;
		r[0x20] = (uint8_t)digits;
		r[0x21] = (uint8_t)(digits >> 8);
	}
	if (c->kind == LIS3MDL) {
		r[0x20] = 0x10;
		r[0x22] = 0x03;
	}
}

static void clear_fifo(struct sim_chip *c)
{
	c->fifo_first = c->fifo_used = c->entry_byte = 0;
	c->word_phase = 0;
	c->fifo_overrun = false;
}

static void make_chip(struct sim_chip *c, enum kind kind, uint8_t address)
{
	*c = (struct sim_chip){.kind = kind, .address = address, .fifo_size = SETS, .entry = 6};
	if (is_l3g(kind))
		c->triads[0] = triad_of(IMU_CHIP_GYRO, 0x27, 0x28, 1, 2);
	else if (kind == DLH_ACCEL || kind == DLHC_ACCEL)
		c->triads[0] = triad_of(IMU_CHIP_ACCEL, 0x27, 0x28, 1, 2);
	else if (kind == DLH_MAG)
		c->triads[0] = triad_of(IMU_CHIP_MAG, 0x09, 0x03, 1, 2);
	else if (kind == DLM_MAG || kind == DLHC_MAG)
		c->triads[0] = triad_of(IMU_CHIP_MAG, 0x09, 0x03, 2, 1);
	else if (kind == LIS3MDL)
		c->triads[0] = triad_of(IMU_CHIP_MAG, 0x27, 0x28, 1, 2);
	if (kind == LSM303D) {
		c->triads[0] = triad_of(IMU_CHIP_ACCEL, 0x27, 0x28, 1, 2);
		c->triads[1] = triad_of(IMU_CHIP_MAG, 0x07, 0x08, 1, 2);
	}
	if (is_lsm6(kind)) {
		c->triads[0] = triad_of(IMU_CHIP_GYRO, 0x1E, 0x22, 1, 2);
		c->triads[1] = triad_of(IMU_CHIP_ACCEL, 0x1E, 0x28, 1, 2);
		c->fifo_size = kind == LSM6DS33 ? WORDS : ENTRIES;
		c->entry = kind == LSM6DS33 ? 2 : ENTRY;
	}
	default_registers(c);
	effect(c);
}

/* ---- sampling ---------------------------------------------------------------------------------------------------- */

static double period_ns(const struct sim_triad *t)
{
	return 1e9 / (t->rate_hz * (1 + t->rate_error));
}

/* A change of the rate restarts the sampling; the sensor's errors depend on the seed only. */
static int restart(struct sim_board *b, struct sim_triad *t, double now_ns)
{
	struct sensor_config config = b->config.sensor;
	struct triad_errors *all[] = {&config.gyro, &config.accel, &config.mag};

	t->epoch_ns = now_ns;
	t->taken = 0;
	t->ready = t->overrun = false;
	config.rate_hz = t->rate_hz > 0 ? t->rate_hz : 100;
	config.mag_rate_hz = 0;
	for (int i = 0; i < 3; i++)
		all[i]->step = all[i]->range = 0; /* quantised by the chip */
	return sensor_init(&t->sensor, &config, b->config.seed + (uint64_t)t->what);
}

static void push(struct sim_chip *c, const uint8_t *entry)
{
	if (c->fifo_used == c->fifo_size) {
		c->fifo_first = (c->fifo_first + 1) % c->fifo_size;
		c->fifo_used--;
		c->fifo_overrun = true;
		c->word_phase = (c->word_phase + 1) % 6;
	}
	memcpy(c->fifo + (c->fifo_first + c->fifo_used) % c->fifo_size * c->entry, entry, c->entry);
	c->fifo_used++;
}

/* Copies the new sample of a triad from its registers to the FIFO. */
static void push_triad(struct sim_chip *c, const struct sim_triad *t)
{
	uint8_t bytes[ENTRY];

	if (c->kind == LSM6DSO) {
		bytes[0] = (uint8_t)((t->what == IMU_CHIP_GYRO ? 1u : 2u) << 3 | (c->tag_count & 3u) << 1);
		memcpy(bytes + 1, c->regs + t->out, 6);
		push(c, bytes);
	} else if (c->kind == LSM6DS33) {
		for (int i = 0; i < 3; i++)
			push(c, c->regs + t->out + 2 * i);
	} else {
		push(c, c->regs + t->out);
	}
}

static int16_t digitise(const struct sim_triad *t, int axis, double value)
{
	double limit = 32768 / t->grain, digits = floor(value / (t->lsb[axis] * t->grain) + 0.5);

	if (t->saturated)
		digits = limit;
	return (int16_t)(fmax(-limit, fmin(limit - 1, digits)) * t->grain);
}

static struct vec3 measured(struct sim_board *b, struct sim_triad *t, double t_ns)
{
	struct signal_truth truth;
	struct imu_sample sample;

	signal_at(b->config.signal, (t_ns - b->start_ns) * 1e-9, &truth);
	sensor_measure(&t->sensor, &truth, &sample);
	return t->what == IMU_CHIP_GYRO	   ? sample.gyro_rad_s
	       : t->what == IMU_CHIP_ACCEL ? sample.accel_m_s2
					   : sample.mag_uT;
}

static void sample_triad(struct sim_board *b, struct sim_chip *c, struct sim_triad *t)
{
	const double t_ns = t->epoch_ns + (double)++t->taken * period_ns(t);
	struct vec3 value = measured(b, t, t_ns);
	const bool big = is_old_mag(c->kind);

	if (!t->self_test_broken)
		value = vec3_add(value, t->self_test);
	const double v[3] = {value.x, value.y, value.z};
	for (int i = 0; i < 3; i++) {
		uint8_t *pair = c->regs + t->out + 2 * t->order[i];

		if (!t->frozen)
			t->word[i] = digitise(t, i, v[i]);
		if (big && t->saturated)
			t->word[i] = -4096;
		if (t->axis_on[i]) {
			pair[big] = (uint8_t)t->word[i];
			pair[!big] = (uint8_t)((uint16_t)t->word[i] >> 8);
		}
	}
	t->overrun = t->ready;
	t->ready = true;
}

static void show_status(struct sim_chip *c)
{
	const struct sim_triad *t = c->triads;

	if (is_lsm6(c->kind)) {
		c->regs[0x1E] = (uint8_t)(t[0].ready << 1 | t[1].ready | 4);
		return;
	}
	for (int i = 0; i < 2 && t[i].what; i++)
		c->regs[t[i].status] = is_old_mag(c->kind)
					       ? t[i].ready
					       : (uint8_t)((t[i].ready ? 0x0F : 0) | (t[i].overrun ? 0xF0 : 0));
	if (is_l3g(c->kind) || c->kind == DLHC_ACCEL || c->kind == LSM303D)
		c->regs[0x2F] =
			(uint8_t)((c->fifo_used == SETS ? 0x40u | 31u : c->fifo_used) | (c->fifo_used == 0 ? 0x20 : 0));
}

static void show_fifo(struct sim_chip *c)
{
	if (!is_lsm6(c->kind))
		return;
	c->regs[0x3A] = (uint8_t)c->fifo_used;
	c->regs[0x3B] = (uint8_t)(c->fifo_used >> 8 | (c->fifo_overrun ? 0x40 : 0));
	if (c->kind == LSM6DS33)
		c->regs[0x3C] = (uint8_t)c->word_phase;
}

/* The two triads of an LSM6 sample at the same time. */
static void advance(struct sim_board *b, struct sim_chip *c)
{
	double now_ns = (double)b->config.now_ns(b->config.clock);

	for (int i = 0; i < 2 && c->triads[i].what; i++) {
		struct sim_triad *t = &c->triads[i];
		const bool batched = c->fifo_on && (i == 0 || is_lsm6(c->kind));
		int64_t due;

		if (t->rate_hz <= 0 || t->stopped)
			continue;
		due = (int64_t)floor((now_ns - t->epoch_ns) / period_ns(t));
		if (due - t->taken > BEHIND_MAX) {
			t->taken = due - BEHIND_MAX;
			c->fifo_overrun = true;
		}
		if (is_lsm6(c->kind) && c->fifo_on && i == 0) {
			while (t->taken < due) {
				sample_triad(b, c, t);
				push_triad(c, t);
				if (c->triads[1].rate_hz > 0) {
					c->triads[1].taken = t->taken - 1;
					sample_triad(b, c, &c->triads[1]);
					push_triad(c, &c->triads[1]);
				}
				c->tag_count++;
			}
			continue;
		}
		while (t->taken < due) {
			sample_triad(b, c, t);
			if (batched)
				push_triad(c, t);
		}
	}
	show_status(c);
	show_fifo(c);
}

/* ---- access ------------------------------------------------------------------------------------------------------ */

static uint8_t following(const struct sim_chip *c, uint8_t reg, bool multiple)
{
	if (is_old_mag(c->kind))
		return reg == 0x08 ? 0x03 : (uint8_t)(reg + 1);
	if (!multiple && !(is_lsm6(c->kind) && c->regs[0x12] & 4))
		return reg;
	if (c->kind == LSM6DS33 && reg == 0x3F)
		return 0x3E;
	if (c->kind == LSM6DSO && reg == 0x7E)
		return 0x78;
	if (!is_lsm6(c->kind) && c->fifo_on && reg == 0x2D)
		return 0x28;
	return (uint8_t)(reg + 1);
}

static void pop(struct sim_chip *c)
{
	if (c->fifo_used == 0)
		return;
	c->fifo_first = (c->fifo_first + 1) % c->fifo_size;
	c->fifo_used--;
	c->fifo_overrun = false;
	c->word_phase = (c->word_phase + 1) % 6;
}

/* Reading the last data register of a triad clears its status. */
static void clear_status(struct sim_chip *c, uint8_t reg)
{
	for (int i = 0; i < 2 && c->triads[i].what; i++)
		if (reg == c->triads[i].out + 5)
			c->triads[i].ready = c->triads[i].overrun = false;
}

static uint8_t read_register(struct sim_chip *c, uint8_t reg)
{
	const uint8_t window = c->kind == LSM6DS33 ? 0x3E : c->kind == LSM6DSO ? 0x78 : 0x28;
	const bool inside = reg >= window && reg < window + c->entry && c->fifo_on && c->fifo_used > 0;
	uint8_t value = inside ? c->fifo[c->fifo_first * c->entry + reg - window] : c->regs[reg];

	clear_status(c, reg);
	if (inside && (size_t)(reg - window) == c->entry - 1)
		pop(c);
	show_status(c);
	show_fifo(c);
	return value;
}

/* The sub-address without the auto-increment bit. */
static uint8_t plain(const struct sim_chip *c, uint8_t sub)
{
	return is_lsm6(c->kind) || is_old_mag(c->kind) ? sub : sub & 0x7F;
}

static bool read_only(const struct sim_chip *c, uint8_t reg)
{
	const uint8_t out = c->triads[0].out, mag = c->triads[1].out;

	return reg == 0x0F || (reg >= out && reg < out + 6) || (mag && reg >= mag && reg < mag + 6) ||
	       reg == c->triads[0].status || (mag && reg == c->triads[1].status) ||
	       (!is_old_mag(c->kind) && reg == 0x2F) || (is_old_mag(c->kind) && reg >= 0x0A);
}

static void write_register(struct sim_board *b, struct sim_chip *c, uint8_t reg, uint8_t value)
{
	const double rates[] = {c->triads[0].rate_hz, c->triads[1].rate_hz};
	const bool fifo_was_on = c->fifo_on;
	double now_ns = (double)b->config.now_ns(b->config.clock);

	if (read_only(c, reg))
		return;
	c->regs[reg] = value;
	effect(c);
	for (int i = 0; i < 2 && c->triads[i].what; i++)
		if (c->triads[i].rate_hz != rates[i])
			restart(b, &c->triads[i], now_ns);
	if (is_lsm6(c->kind)) /* one oscillator */
		c->triads[1].epoch_ns = c->triads[0].epoch_ns;
	if (c->fifo_on != fifo_was_on || !c->fifo_on)
		clear_fifo(c);
	show_status(c);
	show_fifo(c);
}

static struct sim_chip *chip_at(struct sim_board *b, uint8_t address)
{
	for (int i = 0; i < CHIPS; i++)
		if (b->chips[i].kind != NONE && b->chips[i].address == address)
			return &b->chips[i];
	return NULL;
}

static int perform(struct sim_board *b, const struct sim_access *access)
{
	struct sim_chip *c = chip_at(b, access->address);
	uint8_t reg;

	if (!c || c->silent)
		return -ENXIO;
	reg = plain(c, access->sub);
	advance(b, c);
	if (access->write) {
		write_register(b, c, reg, access->bytes[0]);
		return 0;
	}
	for (size_t i = 0; i < access->n; i++) {
		access->bytes[i] = read_register(c, reg);
		reg = following(c, reg, access->sub & 0x80);
	}
	return 0;
}

static int do_access(struct sim_board *b, uint8_t address, uint8_t sub, bool write, uint8_t *bytes, size_t n)
{
	const struct sim_access access = {b->accesses++, address, sub, write, bytes, n};
	int result = b->config.before ? b->config.before(b->config.hook, &access) : 0;

	if (result == 0)
		result = perform(b, &access);
	if (result == 0 && b->config.after)
		b->config.after(b->config.hook, &access);
	return result < 0 ? result : 0;
}

static int bus_read(struct i2c_bus *bus, uint8_t address, uint8_t sub, uint8_t *bytes, size_t n)
{
	memset(bytes, 0, n);
	return do_access((struct sim_board *)bus, address, sub, false, bytes, n);
}

static int bus_write(struct i2c_bus *bus, uint8_t address, uint8_t sub, uint8_t value)
{
	return do_access((struct sim_board *)bus, address, sub, true, &value, 1);
}

static void bus_close(struct i2c_bus *bus)
{
	free(bus);
}

static const struct i2c_ops OPS = {bus_read, bus_write, bus_close};

int sim_board_open(const struct sim_config *config, struct sim_board **board)
{
	struct sim_board *b;
	size_t which = 0;

	while (which < sizeof BOARDS / sizeof *BOARDS && strcmp(BOARDS[which].name, config->board) != 0)
		which++;
	if (which == sizeof BOARDS / sizeof *BOARDS)
		return -EINVAL;
	b = calloc(1, sizeof *b);
	if (!b)
		return -ENOMEM;
	b->bus.ops = &OPS;
	b->config = *config;
	b->start_ns = (double)config->now_ns(config->clock);
	for (int i = 0; i < CHIPS; i++) {
		make_chip(&b->chips[i], BOARDS[which].chips[i].kind, BOARDS[which].chips[i].address);
		for (int k = 0; k < 2 && b->chips[i].triads[k].what; k++) {
			int result;

			b->chips[i].triads[k].rate_error =
				config->rate_error[b->chips[i].triads[is_lsm6(b->chips[i].kind) ? 0 : k].what];
			result = restart(b, &b->chips[i].triads[k], b->start_ns);

			if (result < 0) {
				free(b);
				return result;
			}
		}
	}
	*board = b;
	return 0;
}

struct i2c_bus *sim_board_bus(struct sim_board *b)
{
	return &b->bus;
}

/* ---- faults, and access for tests -------------------------------------------------------------------------------- */

static struct sim_chip *chip_of(struct sim_board *b, enum imu_chip what, struct sim_triad **triad)
{
	for (int i = 0; i < CHIPS; i++)
		for (int k = 0; k < 2; k++)
			if (b->chips[i].triads[k].what == what) {
				*triad = &b->chips[i].triads[k];
				return &b->chips[i];
			}
	abort(); /* every board has all three */
}

void sim_board_silence(struct sim_board *b, enum imu_chip what, bool on)
{
	struct sim_triad *t;

	chip_of(b, what, &t)->silent = on;
}

void sim_board_freeze(struct sim_board *b, enum imu_chip what, bool on)
{
	struct sim_triad *t;

	chip_of(b, what, &t);
	t->frozen = on;
}

void sim_board_stop(struct sim_board *b, enum imu_chip what, bool on)
{
	struct sim_triad *t;

	chip_of(b, what, &t);
	t->stopped = on;
}

void sim_board_saturate(struct sim_board *b, enum imu_chip what, bool on)
{
	struct sim_triad *t;

	chip_of(b, what, &t);
	t->saturated = on;
}

void sim_board_break_self_test(struct sim_board *b, enum imu_chip what)
{
	struct sim_triad *t;

	chip_of(b, what, &t);
	t->self_test_broken = true;
}

void sim_board_brown_out(struct sim_board *b, enum imu_chip what)
{
	struct sim_triad *t;
	struct sim_chip *c = chip_of(b, what, &t);

	default_registers(c);
	effect(c);
	clear_fifo(c);
	for (int i = 0; i < 2 && c->triads[i].what; i++)
		restart(b, &c->triads[i], (double)b->config.now_ns(b->config.clock));
}

uint8_t sim_board_address(const struct sim_board *b, enum imu_chip what)
{
	for (int i = 0; i < CHIPS; i++)
		for (int k = 0; k < 2; k++)
			if (b->chips[i].triads[k].what == what)
				return b->chips[i].address;
	return 0;
}

int64_t sim_board_start_ns(const struct sim_board *b)
{
	return (int64_t)b->start_ns;
}

const uint8_t *sim_board_registers(struct sim_board *b, enum imu_chip what)
{
	struct sim_triad *t;
	struct sim_chip *c = chip_of(b, what, &t);

	advance(b, c);
	return c->regs;
}

uint64_t sim_board_taken(struct sim_board *b, enum imu_chip what, double *t_ns)
{
	struct sim_triad *t;

	advance(b, chip_of(b, what, &t));
	*t_ns = t->epoch_ns + (double)t->taken * (t->rate_hz > 0 ? period_ns(t) : 0);
	return (uint64_t)t->taken;
}
