#include "drivers/imu/sim/sim_parts.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { CHIPS = 3, ENTRY = 16, FRAME = 13, SKIP_FRAME = 2, LOADING_NS = 10000000 };

static const struct {
	const char *name;
	struct {
		enum sim_kind kind;
		uint8_t address;
	} chips[CHIPS];
} BOARDS[] = {
	{"v0", {{L3G4200D, 0x69}, {DLH_ACCEL, 0x18}, {DLH_MAG, 0x1E}}},
	{"v1", {{L3G4200D, 0x69}, {DLH_ACCEL, 0x18}, {DLM_MAG, 0x1E}}},
	{"v2", {{L3GD20, 0x6B}, {DLHC_ACCEL, 0x19}, {DLHC_MAG, 0x1E}}},
	{"v3", {{L3GD20H, 0x6B}, {LSM303D, 0x1D}, {NONE, 0}}},
	{"v5", {{LSM6DS33, 0x6B}, {LIS3MDL, 0x1E}, {NONE, 0}}},
	{"v6", {{LSM6DSO, 0x6B}, {LIS3MDL, 0x1E}, {NONE, 0}}},
	{"lsm9ds1", {{LSM9DS1, 0x6B}, {LSM9DS1_MAG, 0x1E}, {NONE, 0}}},
	{"icm20948", {{ICM20948, 0x69}, {AK09916, 0x0C}, {NONE, 0}}},
	{"icm42688", {{ICM42688P, 0x68}, {NONE, 0}, {NONE, 0}}},
	{"bmi270", {{BMI270, 0x68}, {NONE, 0}, {NONE, 0}}},
	/* others than usual, for tests */
	{"v0-sa0", {{L3G4200D, 0x69}, {DLH_ACCEL, 0x19}, {DLH_MAG, 0x1E}}},
	{"v6-6d", {{LSM6DSO, 0x6B}, {NONE, 0}, {NONE, 0}}},
};

struct sim_board {
	struct i2c_bus bus;
	struct sim_config config;
	struct sim_chip chips[CHIPS];
	double start_ns;
	unsigned long accesses;
};

static void clear_fifo(struct sim_chip *c)
{
	c->fifo_first = c->fifo_used = c->entry_byte = 0;
	c->word_phase = 0;
	c->fifo_overrun = false;
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

static void drop_bytes(struct sim_chip *c, size_t n)
{
	c->fifo_first = (c->fifo_first + n) % c->fifo_size;
	c->fifo_used -= n;
}

/* BMI270: whole frames are overwritten; the first that is read then is a skip frame with their number. */
static void push_frame(struct sim_chip *c, const uint8_t *frame)
{
	const uint8_t skip = c->fifo[c->fifo_first] == 0x40 ? c->fifo[(c->fifo_first + 1) % c->fifo_size] : 0;

	if (c->fifo_used + FRAME > c->fifo_size) {
		drop_bytes(c, skip ? SKIP_FRAME : 0);
		drop_bytes(c, FRAME);
		c->fifo_first = (c->fifo_first + c->fifo_size - SKIP_FRAME) % c->fifo_size;
		c->fifo_used += SKIP_FRAME;
		c->fifo[c->fifo_first] = 0x40;
		c->fifo[(c->fifo_first + 1) % c->fifo_size] = (uint8_t)(skip < 255 ? skip + 1 : 255);
	}
	for (int i = 0; i < FRAME; i++)
		push(c, frame + i);
}

/* One packet with the new samples of both triads. */
static void push_pair(struct sim_chip *c)
{
	const uint8_t *gyro = c->regs + c->triads[0].out, *accel = c->regs + c->triads[1].out;
	uint8_t bytes[ENTRY] = {0};

	switch (c->kind) {
	case LSM9DS1:
		memcpy(bytes, gyro, 6);
		memcpy(bytes + 6, accel, 6);
		push(c, bytes);
		break;
	case ICM42688P:
		bytes[0] = 0x68;
		memcpy(bytes + 1, accel, 6);
		memcpy(bytes + 7, gyro, 6);
		push(c, bytes);
		break;
	case ICM20948: /* its FIFO is one of bytes: it may begin within a packet */
		memcpy(bytes, accel, 6);
		memcpy(bytes + 6, gyro, 6);
		for (int i = 0; i < 12; i++)
			push(c, bytes + i);
		break;
	case BMI270:
		bytes[0] = 0x8C;
		memcpy(bytes + 1, gyro, 6);
		memcpy(bytes + 7, accel, 6);
		push_frame(c, bytes);
		break;
	default:
		push_triad(c, &c->triads[0]);
		push_triad(c, &c->triads[1]);
		c->tag_count++;
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

static struct vec3 self_test_of(const struct sim_triad *t)
{
	return vec3_norm(t->self_test) > 0 && vec3_norm(t->deflection) > 0 ? t->deflection : t->self_test;
}

static void sample_triad(struct sim_board *b, struct sim_chip *c, struct sim_triad *t)
{
	const double t_ns = t->epoch_ns + (double)++t->taken * period_ns(t);
	struct vec3 value = measured(b, t, t_ns);
	const bool big = sim_is_big_endian(c->kind);

	if (!t->self_test_broken)
		value = vec3_add(value, self_test_of(t));
	const double v[3] = {value.x, value.y, value.z};
	for (int i = 0; i < 3; i++) {
		uint8_t *pair = c->regs + t->out + 2 * t->order[i];

		if (!t->frozen)
			t->word[i] = digitise(t, i, v[i]);
		if (sim_is_old_mag(c->kind) && t->saturated)
			t->word[i] = -4096;
		if (t->axis_on[i] && !c->locked) {
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

	switch (c->kind) {
	case LSM6DS33:
	case LSM6DSO:
		c->regs[0x1E] = (uint8_t)(t[0].ready << 1 | t[1].ready | 4);
		return;
	case LSM9DS1:
		c->regs[0x17] = c->regs[0x27] = (uint8_t)(t[0].ready << 1 | t[1].ready | 4);
		c->regs[0x2F] = (uint8_t)((c->fifo_overrun ? 0x40u : 0) | c->fifo_used);
		return;
	case ICM42688P:
		c->regs[0x2D] = t[0].ready ? 0x08 : 0;
		return;
	case ICM20948:
		c->regs[0x1A] = t[0].ready;
		return;
	case BMI270:
		c->regs[0x03] = (uint8_t)(0x10 | t[0].ready << 6 | t[1].ready << 7);
		return;
	case AK09916:
		c->regs[0x10] = (uint8_t)(t[0].overrun << 1 | t[0].ready);
		return;
	default:
		break;
	}
	for (int i = 0; i < 2 && t[i].what; i++)
		c->regs[t[i].status] = sim_is_old_mag(c->kind)
					       ? t[i].ready
					       : (uint8_t)((t[i].ready ? 0x0F : 0) | (t[i].overrun ? 0xF0 : 0));
	if (sim_is_l3g(c->kind) || c->kind == DLHC_ACCEL || c->kind == LSM303D)
		c->regs[0x2F] = (uint8_t)((c->fifo_used == SIM_SETS ? 0x40u | 31u : c->fifo_used) |
					  (c->fifo_used == 0 ? 0x20 : 0));
}

static void show_fifo(struct sim_chip *c)
{
	const size_t bytes = c->fifo_used * c->entry;

	switch (c->kind) {
	case LSM6DS33:
		c->regs[0x3C] = (uint8_t)c->word_phase;
		c->regs[0x3A] = (uint8_t)c->fifo_used;
		c->regs[0x3B] =
			(uint8_t)(c->fifo_used >> 8 | (c->fifo_overrun ? 0x40 : 0) | (c->fifo_used == 0 ? 0x10 : 0));
		break;
	case LSM6DSO:
		c->regs[0x3A] = (uint8_t)c->fifo_used;
		c->regs[0x3B] = (uint8_t)(c->fifo_used >> 8 | (c->fifo_overrun ? 0x40 : 0));
		break;
	case ICM42688P:
		c->regs[0x2E] = (uint8_t)(bytes >> 8);
		c->regs[0x2F] = (uint8_t)bytes;
		break;
	case ICM20948:
		c->regs[0x70] = (uint8_t)(bytes >> 8);
		c->regs[0x71] = (uint8_t)bytes;
		break;
	case BMI270:
		c->regs[0x24] = (uint8_t)bytes;
		c->regs[0x25] = (uint8_t)(bytes >> 8);
		break;
	default:
		break;
	}
}

/* How many samples it keeps while nobody reads it. */
static int64_t kept(const struct sim_chip *c)
{
	return c->kind == LSM6DS33 ? SIM_WORDS / 6 : c->kind == LSM6DSO ? SIM_ENTRIES / 2 : 160;
}

/* The configuration file of the BMI270 has its effect some time later. */
static void start_bmi270(struct sim_chip *c, double now_ns)
{
	if (c->loaded_ns <= 0 || now_ns < c->loaded_ns)
		return;
	c->loaded_ns = 0;
	c->regs[0x21] = c->configured == SIM_CONFIGURATION ? 1 : 2;
	sim_effect(c);
}

/* The two triads of a pair sample at the same time. */
static void advance(struct sim_board *b, struct sim_chip *c)
{
	double now_ns = (double)b->config.now_ns(b->config.clock);

	start_bmi270(c, now_ns);
	for (int i = 0; i < 2 && c->triads[i].what; i++) {
		struct sim_triad *t = &c->triads[i];
		int64_t due;

		if (t->rate_hz <= 0 || t->stopped)
			continue;
		due = (int64_t)floor((now_ns - t->epoch_ns) / period_ns(t));
		if (due - t->taken > kept(c)) {
			t->taken = due - kept(c);
			c->fifo_overrun = true;
		}
		while (t->taken < due) {
			sample_triad(b, c, t);
			if (!c->fifo_on)
				continue;
			if (!sim_is_pair(c->kind)) {
				if (i == 0)
					push_triad(c, t);
			} else if (i == 0) {
				if (c->triads[1].rate_hz > 0) {
					c->triads[1].taken = t->taken - 1;
					sample_triad(b, c, &c->triads[1]);
				}
				push_pair(c);
			}
		}
	}
	show_status(c);
	show_fifo(c);
}

/* ---- access ------------------------------------------------------------------------------------------------------ */

/* The sub-address has a bit for more than one register: bit 7 on I2C, bit 6 on SPI. */
static bool has_multiple_bit(enum sim_kind kind)
{
	return kind <= DLHC_ACCEL || kind == LSM303D || kind == LIS3MDL || kind == LSM9DS1_MAG;
}

static uint8_t following(const struct sim_chip *c, uint8_t reg, bool multiple)
{
	const uint8_t next = (uint8_t)(reg + 1);

	switch (c->kind) {
	case DLH_MAG:
	case DLM_MAG:
	case DLHC_MAG:
		return reg == 0x08 ? 0x03 : next;
	case LSM6DS33:
		return !(c->regs[0x12] & 4) ? reg : reg == 0x3F ? 0x3E : next;
	case LSM6DSO:
		return !(c->regs[0x12] & 4) ? reg : reg == 0x7E ? 0x78 : next;
	case LSM9DS1:
		return c->regs[0x22] & 4 ? next : reg;
	case ICM42688P:
		return reg == 0x30 ? reg : next;
	case ICM20948:
		return reg == 0x72 ? reg : next;
	case BMI270:
		return reg == 0x26 || reg == 0x5E ? reg : next;
	case AK09916:
		return next;
	default:
		return !multiple ? reg : c->fifo_on && reg == 0x2D ? 0x28 : next;
	}
}

static void pop(struct sim_chip *c)
{
	if (c->fifo_used == 0)
		return;
	drop_bytes(c, 1); /* one entry */
	c->entry_byte = 0;
	c->fifo_overrun = false;
	c->word_phase = (c->word_phase + 1) % 6;
}

/* Reading the last data register of a triad clears its status, or, in chips with interrupt registers, reading that. */
static void clear_status(struct sim_chip *c, uint8_t reg)
{
	if (c->kind == AK09916)
		c->locked = c->locked ? reg != 0x18 : reg >= 0x11 && reg <= 0x17;
	for (int i = 0; i < 2 && c->triads[i].what; i++) {
		struct sim_triad *t = &c->triads[i];

		if (c->kind == ICM42688P || c->kind == ICM20948 ? reg == t->status
			: c->kind == AK09916			? reg == 0x18
								: reg == t->out + 5)
			t->ready = t->overrun = false;
	}
}

/* The registers through which the FIFO is read: the first, and how many of an entry's bytes lie there. */
static uint8_t window_of(const struct sim_chip *c, uint8_t reg)
{
	switch (c->kind) {
	case LSM6DS33:
		return 0x3E;
	case LSM6DSO:
		return 0x78;
	case LSM9DS1:
		return reg >= 0x28 ? 0x28 - 6 : 0x18;
	case ICM42688P:
		return 0x30;
	case ICM20948:
		return 0x72;
	case BMI270:
		return 0x26;
	default:
		return 0x28;
	}
}

/* All bytes are read through one register. */
static bool is_stream(enum sim_kind kind)
{
	return kind == ICM42688P || kind == ICM20948 || kind == BMI270;
}

static bool in_window(const struct sim_chip *c, uint8_t reg, size_t offset)
{
	if (c->kind == LSM9DS1)
		return (reg >= 0x18 && reg <= 0x1D) || (reg >= 0x28 && reg <= 0x2D);
	return is_stream(c->kind) ? offset == 0 : offset < c->entry;
}

static uint8_t *bank_register(struct sim_chip *c, uint8_t reg)
{
	const unsigned bank = c->kind == ICM20948 && reg != 0x7F ? c->regs[0x7F] >> 4 & 3 : 0;

	return bank ? &c->banks[bank][reg & 0x7F] : &c->regs[reg];
}

static uint8_t read_register(struct sim_chip *c, uint8_t reg)
{
	const size_t offset = (uint8_t)(reg - window_of(c, reg));
	const bool inside = in_window(c, reg, offset) && c->fifo_on && c->fifo_used > 0;
	const size_t byte = is_stream(c->kind) ? c->entry_byte : offset;
	const uint8_t value = inside ? c->fifo[c->fifo_first * c->entry + byte] : *bank_register(c, reg);

	clear_status(c, reg);
	if (inside) {
		c->entry_byte = byte + 1;
		if (byte == c->entry - 1)
			pop(c);
	} else if (is_stream(c->kind) && offset == 0) {
		return 0xFF; /* the FIFO is empty */
	}
	show_status(c);
	show_fifo(c);
	return value;
}

static bool read_only(const struct sim_chip *c, uint8_t reg)
{
	const uint8_t out = c->triads[0].out, mag = c->triads[1].out;

	if (c->kind == ICM20948 && c->regs[0x7F] >> 4 & 3)
		return false;
	if ((reg >= out && reg < out + 6) || (mag && reg >= mag && reg < mag + 6) || reg == c->triads[0].status ||
		(mag && reg == c->triads[1].status))
		return true;
	switch (c->kind) {
	case ICM42688P:
		return reg == 0x75 || (reg >= 0x2D && reg <= 0x30);
	case ICM20948:
		return reg == 0x00 || (reg >= 0x70 && reg <= 0x72);
	case AK09916:
		return reg < 0x30;
	case BMI270: /* nothing but its power can be changed while it saves power */
		return reg == 0x00 || (reg >= 0x21 && reg <= 0x26) || (c->regs[0x7C] & 1 && reg < 0x7C);
	default:
		return reg == 0x0F || (!sim_is_old_mag(c->kind) && reg == 0x2F) ||
		       (sim_is_old_mag(c->kind) && reg >= 0x0A);
	}
}

/* Registers that do something when they are written. */
static void command(struct sim_chip *c, uint8_t reg, uint8_t value, double now_ns)
{
	const size_t at = ((size_t)c->regs[0x5C] << 4 | (c->regs[0x5B] & 15u)) * 2;

	if ((c->kind == ICM20948 && reg == 0x68 && value) || (c->kind == ICM42688P && reg == 0x4B && value & 2))
		clear_fifo(c);
	if (c->kind == ICM42688P && reg == 0x4B)
		c->regs[reg] = 0;
	if (c->kind != BMI270)
		return;
	if (reg == 0x7E) {
		c->regs[reg] = 0;
		if (value == 0xB6)
			sim_default_registers(c);
		if (value == 0xB6 || value == 0xB0)
			clear_fifo(c);
	}
	if (reg == 0x59)
		c->loaded_ns = value & 1 ? now_ns + LOADING_NS : 0;
	if (reg == 0x59 && !(value & 1))
		c->configured = 0;
	if (reg == 0x5E && at + c->written == c->configured)
		c->configured++;
}

static void write_register(struct sim_board *b, struct sim_chip *c, uint8_t reg, uint8_t value)
{
	const double rates[] = {c->triads[0].rate_hz, c->triads[1].rate_hz};
	double now_ns = (double)b->config.now_ns(b->config.clock);

	if (read_only(c, reg))
		return;
	*bank_register(c, reg) = value;
	if (c->kind != ICM20948 || !(c->regs[0x7F] >> 4 & 3))
		command(c, reg, value, now_ns);
	sim_effect(c);
	for (int i = 0; i < 2 && c->triads[i].what; i++)
		if (c->triads[i].rate_hz != rates[i])
			restart(b, &c->triads[i], now_ns);
	if (sim_is_pair(c->kind))
		c->triads[1].epoch_ns = c->triads[0].epoch_ns;
	if (!c->fifo_on)
		clear_fifo(c);
	show_status(c);
	show_fifo(c);
}

/* The AK09916 is on the bus as long as the ICM-20948 connects it. */
static bool is_connected(const struct sim_board *b, const struct sim_chip *c)
{
	const uint8_t *icm = b->chips[0].regs;

	return c->kind != AK09916 || (!b->bus.spi && icm[0x0F] & 2 && !(icm[0x03] & 0x20));
}

/* On SPI the address is the place of the chip; the magnetometers of old boards and the AK09916 have no SPI. */
static struct sim_chip *chip_at(struct sim_board *b, uint8_t address)
{
	for (uint8_t i = 0; i < CHIPS; i++) {
		struct sim_chip *c = &b->chips[i];

		if (c->kind != NONE && !c->silent && is_connected(b, c) && (b->bus.spi ? i : c->address) == address)
			return c;
	}
	return NULL;
}

/* The sub-address without the bits for a read and for more than one register. */
static uint8_t plain(const struct sim_board *b, const struct sim_chip *c, uint8_t sub)
{
	if (b->bus.spi)
		return has_multiple_bit(c->kind) ? sub & 0x3F : sub & 0x7F;
	return has_multiple_bit(c->kind) ? sub & 0x7F : sub;
}

static int perform(struct sim_board *b, const struct sim_access *access)
{
	struct sim_chip *c = chip_at(b, access->address);
	const bool multiple = access->sub & (b->bus.spi ? 0x40 : 0x80);
	/* on SPI, bit 7 says what the transfer is */
	const bool write = b->bus.spi ? !(access->sub & 0x80) : access->write;
	size_t dummy = b->bus.spi && c && c->kind == BMI270 && !write ? 1 : 0;
	uint8_t reg;

	if (!c && b->bus.spi && !access->write)
		memset(access->bytes, 0xFF, access->n);
	if (!c)
		return b->bus.spi ? 0 : -ENXIO;
	reg = plain(b, c, access->sub);
	advance(b, c);
	c->entry_byte = 0;
	for (size_t i = 0; i < access->n; i++) {
		c->written = i;
		if (write) {
			write_register(b, c, reg, access->bytes[i]);
		} else if (dummy > 0) {
			access->bytes[i] = 0x5A; /* anything */
			dummy--;
			continue;
		} else {
			access->bytes[i] = read_register(c, reg);
		}
		reg = following(c, reg, multiple);
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

static int bus_write(struct i2c_bus *bus, uint8_t address, uint8_t sub, const uint8_t *bytes, size_t n)
{
	uint8_t copy[I2C_BLOCK_MAX];

	memcpy(copy, bytes, n);
	return do_access((struct sim_board *)bus, address, sub, true, copy, n);
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
	b->bus = (struct i2c_bus){.ops = &OPS, .spi = config->spi};
	b->config = *config;
	b->start_ns = (double)config->now_ns(config->clock);
	for (int i = 0; i < CHIPS; i++) {
		sim_make_chip(&b->chips[i], BOARDS[which].chips[i].kind, BOARDS[which].chips[i].address);
		for (int k = 0; k < 2 && b->chips[i].triads[k].what; k++) {
			int result;

			b->chips[i].triads[k].rate_error =
				config->rate_error[b->chips[i].triads[sim_is_pair(b->chips[i].kind) ? 0 : k].what];
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
	abort(); /* see sim_board_has() */
}

bool sim_board_has(const struct sim_board *b, enum imu_chip what)
{
	for (int i = 0; i < CHIPS; i++)
		for (int k = 0; k < 2; k++)
			if (b->chips[i].triads[k].what == what)
				return true;
	return false;
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

void sim_board_deflect(struct sim_board *b, enum imu_chip what, struct vec3 deflection)
{
	struct sim_triad *t;

	chip_of(b, what, &t);
	t->deflection = deflection;
}

void sim_board_brown_out(struct sim_board *b, enum imu_chip what)
{
	struct sim_triad *t;
	struct sim_chip *c = chip_of(b, what, &t);

	sim_default_registers(c);
	sim_effect(c);
	clear_fifo(c);
	for (int i = 0; i < 2 && c->triads[i].what; i++)
		restart(b, &c->triads[i], (double)b->config.now_ns(b->config.clock));
}

uint8_t sim_board_address(const struct sim_board *b, enum imu_chip what)
{
	for (int i = 0; i < CHIPS; i++)
		for (int k = 0; k < 2; k++)
			if (b->chips[i].triads[k].what == what)
				return b->bus.spi ? (uint8_t)i : b->chips[i].address;
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

const uint8_t *sim_board_bank(struct sim_board *b, enum imu_chip what, unsigned bank)
{
	struct sim_triad *t;

	return bank ? chip_of(b, what, &t)->banks[bank] : sim_board_registers(b, what);
}

uint64_t sim_board_taken(struct sim_board *b, enum imu_chip what, double *t_ns)
{
	struct sim_triad *t;

	advance(b, chip_of(b, what, &t));
	*t_ns = t->epoch_ns + (double)t->taken * (t->rate_hz > 0 ? period_ns(t) : 0);
	return (uint64_t)t->taken;
}
