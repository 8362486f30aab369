#include "drivers/imu/board.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#define MS 1000000LL /* in ns */

/* Oscillators of these chips may be off by that. */
#define RATE_TOLERANCE 0.2
/* Values of a data sheet that near to the one asked for are it: 95 Hz for 100, 245 deg/s for 250. */
#define NEARLY 0.94
/* A chip may have so much less noise than its data sheet's typical figure. */
#define LEAST_NOISE 0.6
/* Chance that noise alone repeats itself often enough to be taken for frozen data; at 400 Hz, with all three axes at
 * the worst place all the time, once in 80 years. */
#define FROZEN_CHANCE 1e-12
#define PI	      3.14159265358979323846

enum {
	FIRST_BACKOFF_MS = 10,
	LAST_BACKOFF_MS = 1000,
	SOUND_MS = 1000, /* so long without a fault, and the back-off begins anew */
	SILENT_MS = 20,
	RETRY_MS = 5,
	STOPPED_MS = 50,
	STOPPED_STUB_MS = 1000, /* its feeder is a program that may have to wait */
	STUB_LATE_MS = 2,	/* what it shows may be that old */
	FROZEN_MS = 50,
	LAST_FROZEN_MS = 1000, /* where noise needs longer, it tells nothing */
	SATURATED_MS = 60,
	VERIFY_MS = 10,
	CAN_WAIT_MS = 11,
	TEMPERATURE_MS = 1000,
	BATCH_US = 2500, /* a FIFO is not read more often */
	/* Until the clock knows when samples are taken; a machine that reads too unevenly for that gets them all the
	 * same after so many. */
	SETTLE_SAMPLES = 16,
	SATURATED_WORD = 32752, /* also the end of left-justified 12 bits */
	FIFO_SOURCE = 0x2F,
	FIFO_DEPTH = 32,
};

/* The clock is read before and after what takes time, and is the same for all that follows. */
static int64_t read_clock(struct board *b)
{
	return b->now_ns = b->clock.now_ns(b->clock.ctx);
}

static int64_t now_ns(const struct board *b)
{
	return b->now_ns;
}

static void sleep_until(struct board *b, int64_t ns)
{
	b->clock.sleep_until(b->clock.ctx, ns);
	read_clock(b);
}

/* ---- what is there ----------------------------------------------------------------------------------------------- */

static int read_chip(
	const struct board *b, const struct chip *chip, uint8_t address, uint8_t at, uint8_t *bytes, size_t n)
{
	return i2c_read(b->bus, address, n > 1 ? at | chip->increment : at, bytes, n);
}

/* 0; -ENODEV: something else is there; other -errno: nobody. */
static int identify(const struct board *b, const struct chip *chip, uint8_t address)
{
	uint8_t bytes[sizeof chip->identity];
	size_t n = chip->identity_size ? chip->identity_size : 1;
	int result = read_chip(b, chip, address, chip->identity_size ? chip->identity_at : 0x20, bytes, n);

	if (result < 0)
		return result;
	return memcmp(bytes, chip->identity, chip->identity_size) == 0 ? 0 : -ENODEV;
}

/* Twice: one disturbed transfer must not hide a chip. */
static bool is_there(const struct board *b, const struct chip *chip, uint8_t address, int *error)
{
	int result = identify(b, chip, address);

	if (result < 0)
		result = identify(b, chip, address);
	if (result < 0 && result != -ENODEV && *error != -EACCES && *error != -EBUSY)
		*error = result;
	return result == 0;
}

/* The first of `candidates` that answers becomes the board's next stream. */
static struct stream *find(struct board *b, const struct chip *const candidates[], int *error)
{
	for (; *candidates; candidates++)
		for (int i = 0; i < 2 && (*candidates)->addresses[i]; i++)
			if (is_there(b, *candidates, (*candidates)->addresses[i], error)) {
				struct stream *s = &b->streams[b->stream_count++];

				*s = (struct stream){.chip = *candidates, .address = (*candidates)->addresses[i]};
				return s;
			}
	return NULL;
}

static void name_board(struct board *b)
{
	static const struct {
		const char *name;
		const struct chip *gyro, *mag;
	} boards[] = {{"v0", &CHIP_L3G4200D, &CHIP_LSM303DLH_MAG}, {"v1", &CHIP_L3G4200D, &CHIP_LSM303DLM_MAG},
		{"v2", &CHIP_L3GD20, &CHIP_LSM303DLHC_MAG}, {"v3", &CHIP_L3GD20H, &CHIP_LSM303D_MAG},
		{"v5", &CHIP_LSM6DS33, &CHIP_LIS3MDL}, {"v6", &CHIP_LSM6DSO, &CHIP_LIS3MDL}};

	snprintf(b->name, sizeof b->name, "%s+%s", b->gyro->chip->name, b->mag->chip->name);
	for (size_t i = 0; i < sizeof boards / sizeof *boards; i++)
		if (b->gyro->chip == boards[i].gyro && b->mag->chip == boards[i].mag)
			snprintf(b->name, sizeof b->name, "%s", boards[i].name);
}

static int missing(const char *what, const char *where, int cause, char *error, size_t error_size)
{
	snprintf(error, error_size,
		"no %s answers at %s (%s): is the board powered and wired, and no other driver on it?", what, where,
		cause ? strerror(-cause) : "other chips do");
	return cause ? cause : -ENODEV;
}

int board_detect(struct board *b, struct i2c_bus *bus, const struct board_clock *clock, char *error, size_t error_size)
{
	static const struct chip *const gyros[] = {
		&CHIP_LSM6DS33, &CHIP_LSM6DSO, &CHIP_L3GD20H, &CHIP_L3GD20, &CHIP_L3G4200D, NULL};
	static const struct chip *const accels[] = {
		&CHIP_LSM303D_ACCEL, &CHIP_LSM303DLHC_ACCEL, &CHIP_LSM303DLH_ACCEL, NULL};
	static const struct chip *const beside_lsm6[] = {&CHIP_LIS3MDL, NULL},
					*const beside_d[] = {&CHIP_LSM303D_MAG, NULL},
					*const beside_dlhc[] = {&CHIP_LSM303DLHC_MAG, NULL},
					*const beside_dlh[] = {&CHIP_LSM303DLM_MAG, &CHIP_LSM303DLH_MAG, NULL};
	int cause = 0;

	*b = (struct board){.bus = bus, .clock = *clock};
	b->gyro = find(b, gyros, &cause);
	if (!b->gyro)
		return missing("gyro", "68h to 6Bh", cause, error, error_size);
	cause = 0;
	b->accel = b->gyro->chip->triad_count == 2 ? b->gyro : find(b, accels, &cause);
	if (!b->accel)
		return missing("accelerometer", "18h, 19h, 1Dh or 1Eh", cause, error, error_size);
	cause = 0;
	b->mag = find(b,
		b->accel == b->gyro			   ? beside_lsm6
		: b->accel->chip == &CHIP_LSM303D_ACCEL	   ? beside_d
		: b->accel->chip == &CHIP_LSM303DLHC_ACCEL ? beside_dlhc
							   : beside_dlh,
		&cause);
	if (!b->mag)
		return missing("magnetometer", "1Ch to 1Eh", cause, error, error_size);
	name_board(b);
	return 0;
}

/* ---- settings ---------------------------------------------------------------------------------------------------- */

static const struct chip_rate *choose_rate(const struct chip *chip, double hz, bool or_fastest)
{
	const struct chip_rate *r = chip->rates;

	while (r->hz > 0 && r->hz < hz * NEARLY)
		r++;
	if (r->hz > 0)
		return r;
	return or_fastest ? r - 1 : NULL;
}

/* The narrowest that is wide enough, or the widest. */
static void choose_bandwidth(struct chip_setup *setup, double hz)
{
	const double *all = setup->rate->bandwidth_hz;
	int best = 0;

	for (int i = 1; i < CHIP_BANDWIDTHS && all[i] > 0; i++)
		if (all[best] < hz * NEARLY ? all[i] > all[best] : all[i] >= hz * NEARLY && all[i] < all[best])
			best = i;
	setup->bandwidth_code = (uint8_t)best;
	setup->bandwidth_hz = all[best];
}

struct wish {
	const char *what, *unit;
	double value;
};

static struct wish wish_of(enum imu_chip what, const struct imu_settings *settings)
{
	switch (what) {
	case IMU_CHIP_GYRO:
		return (struct wish){"gyro", "deg/s", settings->gyro_range_deg_s};
	case IMU_CHIP_ACCEL:
		return (struct wish){"accelerometer", "g", settings->accel_range_g};
	case IMU_CHIP_MAG:
		break;
	}
	return (struct wish){"magnetometer", "uT", settings->mag_range_uT};
}

static int choose_ranges(const struct stream *s, const struct imu_settings *settings, struct chip_setup *setup,
	char *error, size_t error_size)
{
	for (size_t i = 0; i < s->chip->triad_count; i++) {
		struct wish wish = wish_of(s->chip->triads[i].what, settings);
		const struct chip_range *r = s->chip->triads[i].ranges;

		while (r->full_scale > 0 && !(r->full_scale >= wish.value * NEARLY))
			r++;
		if (r->full_scale > 0) {
			setup->range[i] = r;
			continue;
		}
		snprintf(error, error_size, "%s range %g %s: the %s goes to %g", wish.what, wish.value, wish.unit,
			s->chip->name, (r - 1)->full_scale);
		return -EINVAL;
	}
	return 0;
}

/* Faster than the gyro where it can: less to interpolate, and less to wait for. Not below 400 Hz, where coarse digits
 * repeat too often to be told from frozen ones in time. */
static double accel_rate(double gyro_hz)
{
	return fmax(2 * gyro_hz, 400);
}

int board_plan(const struct board *b, const struct imu_settings *settings, bool stub, bool data_ready,
	struct board_plan *plan, char *error, size_t error_size)
{
	const struct chip_rate *gyro = choose_rate(b->gyro->chip, settings->rate_hz, false);
	double bandwidth_hz;

	if (!gyro || !(settings->rate_hz > 0)) {
		const struct chip_rate *fastest = choose_rate(b->gyro->chip, INFINITY, true);

		snprintf(error, error_size, "sensor rate %g Hz: the %s goes to %g Hz", settings->rate_hz,
			b->gyro->chip->name, fastest->hz);
		return -EINVAL;
	}
	*plan = (struct board_plan){.settings = *settings, .rate_hz = gyro->hz};
	bandwidth_hz = settings->bandwidth_hz > 0 ? settings->bandwidth_hz : gyro->hz / 2;
	for (size_t i = 0; i < b->stream_count; i++) {
		const struct stream *s = &b->streams[i];
		struct chip_setup *setup = &plan->setup[i];

		setup->rate = s == b->gyro    ? gyro
			      : s == b->accel ? choose_rate(s->chip, accel_rate(gyro->hz), true)
					      : choose_rate(s->chip, INFINITY, true);
		setup->stub = stub;
		setup->fifo = !stub && s->chip->fifo != CHIP_NO_FIFO;
		setup->data_ready = data_ready && s == b->gyro;
		choose_bandwidth(setup, bandwidth_hz);
		if (choose_ranges(s, settings, setup, error, error_size) < 0)
			return -EINVAL;
	}
	return 0;
}

/* The greatest chance that the next value of an axis is the same digit, whatever came before. Noise behind a low-pass
 * (of first order) follows itself; what is new in each sample has the deviation that is left. */
static double chance_of_same(const struct chip_setup *setup, double density, double digit)
{
	double follows = exp(-2 * PI * setup->bandwidth_hz / setup->rate->hz);
	double sigma = LEAST_NOISE * density * sqrt(fmin(setup->bandwidth_hz, setup->rate->hz / 2)) *
		       sqrt(1 - follows * follows) / digit;

	return erf(0.5 / (sigma * sqrt(2)));
}

static unsigned samples_in(const struct stream *s, int ms)
{
	return (unsigned)ceil(1e-3 * ms * s->setup.rate->hz);
}

/* So many equal samples are no measurements; 0: this cannot be told, since a digit is coarser than the noise. What
 * shows then that a chip lives is that it says it has new data. */
static unsigned same_limit(const struct stream *s)
{
	double log_chance = 0, n;

	for (size_t i = 0; i < s->chip->triad_count; i++) {
		const struct chip_triad *t = &s->chip->triads[i];
		double digit = s->setup.range[i]->step * (t->digit ? t->digit : 1);

		log_chance += 3 * log(chance_of_same(&s->setup, t->density, digit));
	}
	n = 1 + ceil(log(FROZEN_CHANCE) / log_chance);
	if (!(n <= samples_in(s, LAST_FROZEN_MS)))
		return 0;
	return (unsigned)fmax(n, samples_in(s, FROZEN_MS));
}

/* ---- starting a chip --------------------------------------------------------------------------------------------- */

static void enter(struct board *b, struct stream *s, enum stream_state state)
{
	s->state = state;
	s->since_ns = now_ns(b);
}

static void stream_fail(struct board *b, struct stream *s, enum imu_fault fault)
{
	if (s->fault == IMU_FAULT_NONE)
		s->fault = fault;
	if (s->state == STREAM_UP && now_ns(b) - s->since_ns > SOUND_MS * MS)
		s->backoff_ns = FIRST_BACKOFF_MS * MS;
	enter(b, s, STREAM_DOWN);
	s->retry_ns = s->since_ns + s->backoff_ns;
	s->backoff_ns = s->backoff_ns * 2 < LAST_BACKOFF_MS * MS ? s->backoff_ns * 2 : LAST_BACKOFF_MS * MS;
	s->count = 0;
}

/* What must stand at that place of the list: the last value written there; -1: written again further on. */
static int expected(const struct chip_registers *list, size_t i)
{
	for (size_t later = i + 1; later < list->n; later++)
		if (list->at[later].address == list->at[i].address)
			return -1;
	return list->at[i].value;
}

/* 0; -EBADMSG: something else stands there. */
static int verify(struct board *b, const struct stream *s, size_t i)
{
	int value = expected(&s->registers, i), result;
	uint8_t byte;

	if (value < 0)
		return 0;
	result = read_chip(b, s->chip, s->address, s->registers.at[i].address, &byte, 1);
	if (result < 0)
		return result;
	return byte == value ? 0 : -EBADMSG;
}

static enum imu_fault fault_of(int error)
{
	return error == -EBADMSG ? IMU_FAULT_CONFIGURATION : error == -ENODEV ? IMU_FAULT_WRONG_CHIP : IMU_FAULT_SILENT;
}

static int set_up(struct board *b, struct stream *s)
{
	int result = identify(b, s->chip, s->address);

	for (size_t i = 0; i < s->registers.n && result == 0; i++)
		result = i2c_write(b->bus, s->address, s->registers.at[i].address, s->registers.at[i].value);
	for (size_t i = 0; i < s->registers.n && result == 0; i++)
		result = verify(b, s, i);
	return result;
}

static void stream_start(struct board *b, struct stream *s)
{
	int result = set_up(b, s);

	read_clock(b);
	if (s->fault != IMU_FAULT_NONE)
		b->health.restarts++;
	if (result < 0) {
		b->health.bus_errors += result != -EBADMSG && result != -ENODEV;
		stream_fail(b, s, fault_of(result));
		return;
	}
	enter(b, s, STREAM_STARTING);
	sample_clock_start(&s->clock, 1e9 / s->setup.rate->hz, RATE_TOLERANCE);
	s->taken = 0;
	s->first = s->count = s->verify = 0;
	s->partial_have = s->failures = s->saturated = s->same = 0;
	s->failing_ns = 0;
	s->fresh_ns = s->none_ns = s->due_ns = s->since_ns;
	s->verify_ns = s->since_ns + VERIFY_MS * MS;
	s->same_limit = same_limit(s);
}

void board_apply(struct board *b, const struct board_plan *plan)
{
	for (size_t i = 0; i < b->stream_count; i++) {
		struct stream *s = &b->streams[i];

		s->setup = plan->setup[i];
		s->registers = (struct chip_registers){0};
		s->chip->registers(&s->setup, &s->registers);
		s->backoff_ns = FIRST_BACKOFF_MS * MS;
		s->retry_ns = read_clock(b);
		s->state = STREAM_DOWN;
		s->count = 0;
	}
}

/* ---- raw data ---------------------------------------------------------------------------------------------------- */

static int16_t word(const struct chip *chip, const uint8_t *bytes)
{
	return (int16_t)(chip->big_endian ? bytes[0] << 8 | bytes[1] : bytes[1] << 8 | bytes[0]);
}

static struct vec3 decode(const struct stream *s, size_t triad, const uint8_t *set, bool *saturated)
{
	const struct chip_triad *t = &s->chip->triads[triad];
	const struct chip_range *r = s->setup.range[triad];
	int16_t w[3];

	for (int i = 0; i < 3; i++) {
		w[i] = word(s->chip, set + t->byte + 2 * t->order[i]);
		*saturated |= t->overflow ? w[i] == t->overflow : w[i] >= SATURATED_WORD || w[i] <= -SATURATED_WORD;
	}
	return (struct vec3){w[0] * r->step, w[1] * r->step, w[2] * (r->step_z > 0 ? r->step_z : r->step)};
}

static void watch_data(struct stream *s, const uint8_t *set, bool saturated)
{
	if (s->same > 0 && memcmp(set, s->last, s->chip->data_size) == 0)
		s->same++;
	else
		s->same = 1;
	memcpy(s->last, set, s->chip->data_size);
	s->saturated = saturated ? s->saturated + 1 : 0;
}

/* Whether what a chip measures after a fault shows that the fault is over. */
static bool sound(const struct stream *s)
{
	if (s->clock.newest + 1 < SETTLE_SAMPLES && !sample_clock_locked(&s->clock))
		return false;
	return (s->fault != IMU_FAULT_FROZEN || s->same == 1) && (s->fault != IMU_FAULT_SATURATED || s->saturated == 0);
}

static void take(struct board *b, struct stream *s, const uint8_t *set)
{
	struct reading reading = {.t_ns = sample_clock_at(&s->clock, s->taken++)};

	for (size_t i = 0; i < s->chip->triad_count; i++)
		reading.value[i] = decode(s, i, set, &reading.saturated);
	watch_data(s, set, reading.saturated);
	s->fresh_ns = now_ns(b);
	if (s->state == STREAM_STARTING && sound(s)) {
		s->fault = IMU_FAULT_NONE;
		enter(b, s, STREAM_UP);
	}
	if (s->state != STREAM_UP)
		return;
	if (s->count == STREAM_READINGS) {
		s->first = (s->first + 1) % STREAM_READINGS;
		s->count--;
	}
	s->readings[(s->first + s->count++) % STREAM_READINGS] = reading;
}

enum losses { LOST_NONE, LOST_PERHAPS, LOST_SOME };

/* The chip had `level` samples at some time between the two, the oldest of them being taken next. How many it lost
 * before them, the clock tells. */
static void observe(
	struct board *b, struct stream *s, int64_t level, enum losses losses, int64_t from_ns, int64_t to_ns)
{
	if (losses != LOST_NONE && s->clock.newest >= 0) {
		double since_ns = (double)from_ns - sample_clock_at(&s->clock, s->taken + level - 1);
		double n = fmax(floor(since_ns / sample_clock_period(&s->clock)), losses == LOST_SOME ? 1 : 0);

		s->taken += (int64_t)n;
		b->health.overruns += (uint32_t)n;
	}
	if (level == 0)
		s->none_ns = from_ns;
	/* of a stub, what is not there yet may have been sampled already */
	sample_clock_read(&s->clock, s->taken + level, (double)(s->setup.stub ? from_ns - STUB_LATE_MS * MS : from_ns),
		(double)to_ns);
}

/* Between this sample and the one before. */
static enum losses losses_of(const struct stream *s, uint8_t status)
{
	if (s->setup.stub || s->chip->overrun == 0)
		return LOST_PERHAPS;
	return status & s->chip->overrun ? LOST_SOME : LOST_NONE;
}

/* Without FIFO: status and data, in one transfer where they stand near each other. */
static int read_registers(struct board *b, struct stream *s)
{
	const struct chip *chip = s->chip;
	const size_t offset = (uint8_t)(chip->data - chip->status);
	const bool together = chip->data > chip->status && offset + chip->data_size <= I2C_BLOCK_MAX;
	uint8_t bytes[I2C_BLOCK_MAX], *set = bytes + (together ? offset : 1);
	int64_t from_ns = read_clock(b), to_ns;
	bool fresh;
	int result = read_chip(b, chip, s->address, chip->status, bytes, together ? offset + chip->data_size : 1);

	to_ns = read_clock(b);
	if (result < 0)
		return result;
	fresh = bytes[0] & chip->ready;
	if (fresh && !together) {
		result = read_chip(b, chip, s->address, chip->data, set, chip->data_size);
		read_clock(b);
		if (result < 0)
			return result;
	}
	/* in a stub the bit stays: other data are new data */
	if (s->setup.stub && s->same > 0 && memcmp(set, s->last, chip->data_size) == 0)
		fresh = false;
	observe(b, s, fresh ? 1 : 0, fresh ? losses_of(s, bytes[0]) : LOST_NONE, from_ns, to_ns);
	if (fresh)
		take(b, s, set);
	return fresh;
}

static int take_sets(struct board *b, struct stream *s, uint8_t at, int64_t level)
{
	const size_t size = s->chip->data_size;
	uint8_t bytes[I2C_BLOCK_MAX];

	for (int64_t left = level; left > 0;) {
		size_t sets = I2C_BLOCK_MAX / size;
		int result;

		if ((int64_t)sets > left)
			sets = (size_t)left;
		result = read_chip(b, s->chip, s->address, at, bytes, sets * size);
		if (result < 0)
			return result;
		for (size_t i = 0; i < sets; i++)
			take(b, s, bytes + i * size);
		left -= (int64_t)sets;
	}
	return (int)level;
}

static int read_fifo_sets(struct board *b, struct stream *s)
{
	int64_t from_ns = read_clock(b);
	uint8_t source;
	int result = read_chip(b, s->chip, s->address, FIFO_SOURCE, &source, 1);
	int64_t level = source & 0x40 ? FIFO_DEPTH : source & 0x1F;

	if (result < 0)
		return result;
	observe(b, s, level, source & 0x40 ? LOST_PERHAPS : LOST_NONE, from_ns, read_clock(b));
	return take_sets(b, s, s->chip->data, level);
}

/* LSM6DS33: the status tells which word of the set comes next; after an overrun it may be one in the middle. */
static int read_fifo_words(struct board *b, struct stream *s)
{
	int64_t from_ns = read_clock(b), words;
	uint8_t status[4], skipped[10];
	int result = read_chip(b, s->chip, s->address, 0x3A, status, sizeof status), next;

	if (result < 0)
		return result;
	words = status[0] | (status[1] & 0x0F) << 8;
	next = status[2] | (status[3] & 0x03) << 8;
	if (next > 0 && next < 6 && words >= 6 - next) {
		words -= 6 - next;
		if ((result = read_chip(b, s->chip, s->address, 0x3E, skipped, (size_t)(6 - next) * 2)) < 0)
			return result;
	}
	observe(b, s, words / 6, status[1] & 0x40 ? LOST_PERHAPS : LOST_NONE, from_ns, read_clock(b));
	return take_sets(b, s, 0x3E, words / 6 < FIFO_DEPTH ? words / 6 : FIFO_DEPTH);
}

static void take_tagged(struct board *b, struct stream *s, const uint8_t *entry)
{
	enum { TAG_GYRO = 1, TAG_ACCEL = 2 };
	unsigned tag = entry[0] >> 3;

	if (tag != TAG_GYRO && tag != TAG_ACCEL)
		return;
	memcpy(s->partial + (tag == TAG_GYRO ? 0 : 6), entry + 1, 6);
	s->partial_have |= tag;
	if (s->partial_have != (TAG_GYRO | TAG_ACCEL))
		return;
	s->partial_have = 0;
	take(b, s, s->partial);
}

/* LSM6DSO: each entry is a tag and one triad. */
static int read_fifo_tagged(struct board *b, struct stream *s)
{
	enum { ENTRY = 7, AT_ONCE = 4 };
	int64_t from_ns = read_clock(b), entries;
	uint8_t status[2], bytes[ENTRY * AT_ONCE];
	int result = read_chip(b, s->chip, s->address, 0x3A, status, sizeof status);

	if (result < 0)
		return result;
	entries = status[0] | (status[1] & 0x03) << 8;
	observe(b, s, (entries + (s->partial_have != 0)) / 2, status[1] & 0x48 ? LOST_PERHAPS : LOST_NONE, from_ns,
		read_clock(b));
	if (entries > 2 * FIFO_DEPTH) /* the rest next time */
		entries = 2 * FIFO_DEPTH;
	for (int64_t left = entries; left > 0; left -= AT_ONCE) {
		size_t n = left < AT_ONCE ? (size_t)left : AT_ONCE;

		if ((result = read_chip(b, s->chip, s->address, 0x78, bytes, n * ENTRY)) < 0)
			return result;
		for (size_t i = 0; i < n; i++)
			take_tagged(b, s, bytes + i * ENTRY);
	}
	return (int)entries;
}

static int read_new(struct board *b, struct stream *s)
{
	switch (s->setup.fifo ? s->chip->fifo : CHIP_NO_FIFO) {
	case CHIP_FIFO_SETS:
		return read_fifo_sets(b, s);
	case CHIP_FIFO_WORDS:
		return read_fifo_words(b, s);
	case CHIP_FIFO_TAGGED:
		return read_fifo_tagged(b, s);
	case CHIP_NO_FIFO:
		break;
	}
	return read_registers(b, s);
}

/* ---- faults ------------------------------------------------------------------------------------------------------ */

/* The outcome of a transfer with that chip. */
static void count_errors(struct board *b, struct stream *s, int result)
{
	int64_t t_ns = now_ns(b);

	if (result >= 0) {
		s->failures = 0;
		return;
	}
	b->health.bus_errors++;
	if (s->failures++ == 0)
		s->failing_ns = t_ns;
	if (s->failures >= 3 && t_ns - s->failing_ns >= SILENT_MS * MS)
		stream_fail(b, s, IMU_FAULT_SILENT);
}

static void verify_next(struct board *b, struct stream *s)
{
	int result;

	while (expected(&s->registers, s->verify) < 0)
		s->verify = (s->verify + 1) % s->registers.n;
	result = verify(b, s, s->verify);
	if (result == -EBADMSG && (result = verify(b, s, s->verify)) == -EBADMSG) {
		stream_fail(b, s, IMU_FAULT_CONFIGURATION);
		return;
	}
	s->verify = (s->verify + 1) % s->registers.n;
	s->verify_ns = now_ns(b) + (VERIFY_MS - 1) * MS;
	count_errors(b, s, result);
}

/* Nothing new between the end of a read that found something and the beginning of one that did not. */
static bool stopped(const struct stream *s)
{
	int64_t limit_ns = (s->setup.stub ? STOPPED_STUB_MS : STOPPED_MS) * MS + (int64_t)(2e9 / s->setup.rate->hz);

	if (s->setup.stub && s->same_limit == 0) /* equal data may be new ones */
		return false;
	return s->none_ns - s->fresh_ns > limit_ns;
}

/* By what reads have shown, not by how long they took: a machine that is slow is not a chip that failed. */
static void watch_stream(struct board *b, struct stream *s)
{
	if (s->state == STREAM_DOWN)
		return;
	if (stopped(s))
		stream_fail(b, s, IMU_FAULT_STOPPED);
	else if (s->saturated == 0 && s->same_limit > 0 && s->same >= s->same_limit)
		stream_fail(b, s, IMU_FAULT_FROZEN);
	else if (s->saturated >= 4 && s->saturated >= samples_in(s, SATURATED_MS))
		stream_fail(b, s, IMU_FAULT_SATURATED);
}

static void update_health(struct board *b)
{
	struct imu_health *h = &b->health;
	const struct stream *bad = b->gyro->fault ? b->gyro : b->accel;
	double period_ns = sample_clock_period(&b->gyro->clock);

	h->fault = (uint8_t)bad->fault;
	h->fault_chip = bad->fault ? (uint8_t)(bad == b->gyro ? IMU_CHIP_GYRO : IMU_CHIP_ACCEL) : 0;
	h->degraded = (uint8_t)b->mag->fault;
	h->degraded_chip = b->mag->fault ? (uint8_t)IMU_CHIP_MAG : 0;
	if (!h->degraded && b->self_test_failed) {
		h->degraded = IMU_FAULT_SELF_TEST;
		h->degraded_chip = b->self_test_chip;
	}
	if (h->fault || (b->gyro->state == STREAM_UP && b->accel->state == STREAM_UP))
		h->self_test &= (uint8_t)~IMU_SELF_TEST_RUNS;
	h->rate_hz = b->gyro->state == STREAM_UP && period_ns > 0 ? (float)(1e9 / period_ns) : 0;
}

/* ---- when what is read ------------------------------------------------------------------------------------------- */

static const struct reading *peek(const struct stream *s, size_t i)
{
	return &s->readings[(s->first + i) % STREAM_READINGS];
}

static int64_t gyro_target(const struct stream *s)
{
	double period_us = sample_clock_period(&s->clock) / 1000;

	return s->setup.fifo ? s->taken + (int64_t)ceil(BATCH_US / period_us) - 1 : s->taken;
}

/* The newest sample of the gyro has none of the accelerometer after it. */
static bool gyro_waits(const struct board *b)
{
	const struct stream *g = b->gyro, *a = b->accel;

	return g->count > 0 && peek(g, g->count - 1)->t_ns > sample_clock_at(&a->clock, a->clock.newest);
}

/* With a FIFO the accelerometer is read once a batch of the gyro: when it has a sample after it. */
static int64_t accel_target(const struct board *b, const struct stream *s)
{
	const struct stream *g = b->gyro;
	double until_ns;
	int64_t index;

	if (!s->setup.fifo || g->state != STREAM_UP)
		return s->taken;
	until_ns = gyro_waits(b) ? peek(g, g->count - 1)->t_ns : sample_clock_at(&g->clock, gyro_target(g));
	index = s->clock.newest + (int64_t)ceil((until_ns - sample_clock_at(&s->clock, s->clock.newest)) /
						sample_clock_period(&s->clock));
	return index > s->taken ? index : s->taken;
}

/* The gyro waits for the accelerometer, without which its sample is of no use: both are read in one go. Not where its
 * clock has something to learn. */
static double gyro_due(const struct board *b, const struct stream *g)
{
	const struct stream *a = b->accel;
	double due_ns = sample_clock_due(&g->clock, gyro_target(g));

	if (a == g || !g->setup.fifo || !a->setup.fifo || g->state != STREAM_UP || a->state != STREAM_UP ||
		gyro_waits(b) || a->failures > 0 || sample_clock_learns(&g->clock, gyro_target(g)))
		return due_ns;
	return fmax(due_ns, sample_clock_due(&a->clock, accel_target(b, a)));
}

static int64_t next_due(const struct board *b, const struct stream *s)
{
	double period_ns = sample_clock_period(&s->clock), t_ns = (double)now_ns(b), due_ns;

	if (s->failures > 0)
		return (int64_t)t_ns + RETRY_MS * MS;
	if (s->clock.newest < 0)
		return (int64_t)(t_ns + period_ns / 4);
	due_ns = s == b->gyro	 ? gyro_due(b, s)
		 : s == b->accel ? sample_clock_due(&s->clock, accel_target(b, s))
				 : sample_clock_due(&s->clock, s->taken);
	return (int64_t)fmax(due_ns, t_ns + period_ns / 32);
}

static void step_stream(struct board *b, struct stream *s)
{
	if (s->state == STREAM_DOWN && now_ns(b) >= s->retry_ns)
		stream_start(b, s);
	if (s->state != STREAM_DOWN && now_ns(b) >= s->due_ns) {
		count_errors(b, s, read_new(b, s));
		s->due_ns = next_due(b, s);
	}
	if (s->state != STREAM_DOWN && now_ns(b) >= s->verify_ns)
		verify_next(b, s);
	watch_stream(b, s);
}

/* The magnetometer and the registers that are read back can wait for the gyro to be read. */
static int64_t wake_of(const struct board *b, const struct stream *s)
{
	int64_t can_wait_ns = b->gyro->state == STREAM_UP ? CAN_WAIT_MS * MS : 0, due_ns;

	if (s->state == STREAM_DOWN)
		return s->retry_ns;
	due_ns = s->due_ns;
	if (s == b->mag && s->failures == 0 && s->state == STREAM_UP && !sample_clock_learns(&s->clock, s->taken))
		due_ns += can_wait_ns;
	return due_ns < s->verify_ns + can_wait_ns ? due_ns : s->verify_ns + can_wait_ns;
}

static void read_temperature(struct board *b)
{
	const struct stream *s = b->gyro;
	uint8_t bytes[2] = {0};

	if (now_ns(b) < b->temperature_ns || s->state != STREAM_UP || s->chip->temperature.size == 0)
		return;
	b->temperature_ns = now_ns(b) + TEMPERATURE_MS * MS;
	if (read_chip(b, s->chip, s->address, s->chip->temperature.address, bytes, s->chip->temperature.size) < 0) {
		b->health.bus_errors++;
		return;
	}
	b->temperature_degC = s->chip->temperature.zero_degC +
			      s->chip->temperature.per_digit *
				      (s->chip->temperature.size == 1 ? (int8_t)bytes[0] : word(s->chip, bytes));
	b->temperature_new = true;
}

int64_t board_step(struct board *b)
{
	int64_t wake_ns = INT64_MAX;

	read_clock(b);
	for (size_t i = 0; i < b->stream_count; i++)
		step_stream(b, &b->streams[i]);
	/* it may wait for a sample of the gyro that has just been read */
	if (b->accel != b->gyro && b->accel->state != STREAM_DOWN && b->accel->failures == 0) {
		b->accel->due_ns = next_due(b, b->accel);
		if (b->gyro->state == STREAM_UP && b->gyro->failures == 0 && b->gyro->due_ns > now_ns(b))
			b->gyro->due_ns = next_due(b, b->gyro);
	}
	read_temperature(b);
	update_health(b);
	for (size_t i = 0; i < b->stream_count; i++)
		if (wake_of(b, &b->streams[i]) < wake_ns)
			wake_ns = wake_of(b, &b->streams[i]);
	return wake_ns;
}

/* The interrupt and its time stamp may come a little after the edge. */
void board_data_ready(struct board *b, int64_t t_ns)
{
	enum { LATENCY_NS = 100000 };

	if (b->gyro->state == STREAM_DOWN)
		return;
	sample_clock_edge(&b->gyro->clock, (double)t_ns - LATENCY_NS, (double)t_ns);
	b->gyro->due_ns = t_ns;
}

/* ---- samples of the board ---------------------------------------------------------------------------------------- */

static void drop(struct stream *s)
{
	s->first = (s->first + 1) % STREAM_READINGS;
	s->count--;
}

/* The accelerometer at the instant of a sample of the gyro: 1; 0: not known yet; -1: never will be. */
static int accel_at(struct board *b, const struct reading *gyro, struct vec3 *value, bool *saturated)
{
	struct stream *a = b->accel;
	const struct reading *before, *after;
	double w;

	if (a == b->gyro) {
		*value = gyro->value[1];
		return 1;
	}
	while (a->count >= 2 && peek(a, 1)->t_ns <= gyro->t_ns)
		drop(a);
	if (a->count > 0 && peek(a, 0)->t_ns > gyro->t_ns)
		return -1;
	if (a->count < 2)
		return 0;
	before = peek(a, 0);
	after = peek(a, 1);
	w = (gyro->t_ns - before->t_ns) / (after->t_ns - before->t_ns);
	*value = vec3_add(vec3_scale(1 - w, before->value[0]), vec3_scale(w, after->value[0]));
	*saturated |= before->saturated || after->saturated;
	return 1;
}

/* The field as it stood a little earlier, in the axes as they are turned now: dv/dt = v x omega. */
static void add_mag(struct board *b, double t_ns, struct imu_sample *sample)
{
	for (struct stream *m = b->mag; m->count > 0 && peek(m, 0)->t_ns <= t_ns; drop(m)) {
		const struct vec3 field = peek(m, 0)->value[0];
		const double age_s = fmin((t_ns - peek(m, 0)->t_ns) * 1e-9, 0.05);

		sample->mag_uT = vec3_add(field, vec3_scale(age_s, vec3_cross(field, sample->gyro_rad_s)));
		sample->flags |= SAMPLE_MAG | (peek(m, 0)->saturated ? SAMPLE_SATURATED : 0u);
	}
}

bool board_next(struct board *b, struct imu_sample *sample)
{
	struct reading gyro;
	bool saturated;
	int have = -1;

	while (have < 0) {
		if (b->gyro->count == 0)
			return false;
		gyro = *peek(b->gyro, 0);
		saturated = gyro.saturated;
		*sample = (struct imu_sample){.t_us = (uint64_t)(gyro.t_ns / 1000), .gyro_rad_s = gyro.value[0]};
		have = accel_at(b, &gyro, &sample->accel_m_s2, &saturated);
		if (have == 0)
			return false;
		drop(b->gyro);
		if (gyro.t_ns < b->last_t_ns + 1000) /* a clock that began anew */
			have = -1;
	}
	b->last_t_ns = gyro.t_ns;
	sample->flags = saturated ? SAMPLE_SATURATED : 0;
	add_mag(b, gyro.t_ns, sample);
	if (b->temperature_new) {
		sample->temperature_degC = b->temperature_degC;
		sample->flags |= SAMPLE_TEMPERATURE;
		b->temperature_new = false;
	}
	return true;
}

/* ---- self-test --------------------------------------------------------------------------------------------------- */

enum { TEST_READS = 16, TEST_SETTLE_MS = 200 };

/* Mean of what the data registers show. */
static int mean_of(struct board *b, const struct stream *s, struct vec3 mean[CHIP_TRIADS])
{
	int64_t next_ns = read_clock(b), period_ns = (int64_t)(1e9 / s->setup.rate->hz);
	uint8_t set[CHIP_TRIADS * 6];
	bool saturated = false;

	memset(mean, 0, CHIP_TRIADS * sizeof *mean);
	for (int n = 0; n < TEST_READS; n++) {
		int result = read_chip(b, s->chip, s->address, s->chip->data, set, s->chip->data_size);

		if (result < 0)
			return result;
		for (size_t i = 0; i < s->chip->triad_count; i++)
			mean[i] = vec3_add(mean[i], vec3_scale(1.0 / TEST_READS, decode(s, i, set, &saturated)));
		sleep_until(b, next_ns += period_ns);
	}
	return saturated ? -ERANGE : 0;
}

static bool within(double change, double least, double most)
{
	return fabs(change) >= least && fabs(change) <= most;
}

static bool test_triad(struct board *b, const struct stream *s, size_t i)
{
	const struct chip_triad *t = &s->chip->triads[i];
	struct vec3 off[CHIP_TRIADS], on[CHIP_TRIADS], change;
	uint8_t value;

	if (mean_of(b, s, off) < 0 || read_chip(b, s->chip, s->address, t->self_test.address, &value, 1) < 0)
		return false;
	value = (uint8_t)((value & ~t->self_test.mask) | t->self_test.on);
	if (i2c_write(b->bus, s->address, t->self_test.address, value) < 0)
		return false;
	sleep_until(b, now_ns(b) + TEST_SETTLE_MS * MS);
	if (mean_of(b, s, on) < 0)
		return false;
	change = vec3_sub(on[i], off[i]);
	return within(change.x, t->self_test.least, t->self_test.most) &&
	       within(change.y, t->self_test.least, t->self_test.most) &&
	       within(change.z, t->self_test.least, t->self_test.most);
}

/* Through the data registers, without FIFO; afterwards the chip is started anew like after a fault. */
static void test_stream(struct board *b, struct stream *s)
{
	const struct chip_setup setup = s->setup;

	for (size_t i = 0; i < s->chip->triad_count; i++) {
		const struct chip_triad *t = &s->chip->triads[i];
		bool passed;

		if (t->self_test.most <= 0)
			continue;
		s->setup.fifo = false;
		s->registers = (struct chip_registers){0};
		s->chip->registers(&s->setup, &s->registers);
		passed = set_up(b, s) == 0;
		sleep_until(b, now_ns(b) + TEST_SETTLE_MS * MS);
		passed = passed && test_triad(b, s, i);
		b->health.self_test |= (uint8_t)(1u << (t->what - 1) << (passed ? 0 : 4));
		if (!passed && !b->self_test_failed)
			b->self_test_chip = (uint8_t)t->what;
		b->self_test_failed |= !passed;
	}
	s->setup = setup;
	s->registers = (struct chip_registers){0};
	s->chip->registers(&s->setup, &s->registers);
	s->state = STREAM_DOWN;
	s->retry_ns = now_ns(b);
	s->count = 0;
}

void board_self_test(struct board *b)
{
	b->health.self_test = IMU_SELF_TEST_RUNS; /* until samples come again */
	b->self_test_failed = false;
	for (size_t i = 0; i < b->stream_count; i++)
		test_stream(b, &b->streams[i]);
	update_health(b);
}
