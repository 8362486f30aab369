#include "drivers/imu/pololu/board_parts.h"

#include <errno.h>
#include <math.h>
#include <string.h>

/* Tolerance of the chips' oscillators. */
#define RATE_TOLERANCE 0.2

enum {
	LAST_BACKOFF_MS = 1000,
	STABLE_MS = 1000, /* after this time without a fault, the back-off is reset */
	STUB_LATE_MS = 2, /* age of the register values of a stub */
	/* Samples are delivered when the sample clock is locked, or after this number of samples on a machine that
	 * reads too unevenly for that. */
	SETTLE_SAMPLES = 16,
	SATURATED_WORD = 32752, /* the end of the range of left-justified 12 bits */
	FIFO_SOURCE = 0x2F,
	FIFO_DEPTH = 32,
};

int board_read_chip(
	const struct board *b, const struct chip *chip, uint8_t address, uint8_t at, uint8_t *bytes, size_t n)
{
	return i2c_read(b->bus, address, n > 1 ? at | chip->increment : at, bytes, n);
}

int board_identify(const struct board *b, const struct chip *chip, uint8_t address)
{
	uint8_t bytes[sizeof chip->identity];
	size_t n = chip->identity_size ? chip->identity_size : 1;
	int result = board_read_chip(b, chip, address, chip->identity_size ? chip->identity_at : 0x20, bytes, n);

	if (result < 0)
		return result;
	return memcmp(bytes, chip->identity, chip->identity_size) == 0 ? 0 : -ENODEV;
}

/* ---- starting a chip --------------------------------------------------------------------------------------------- */

static void enter(struct board *b, struct stream *s, enum stream_state state)
{
	s->state = state;
	s->since_ns = b->now_ns;
}

void stream_fail(struct board *b, struct stream *s, enum imu_fault fault)
{
	if (s->fault == IMU_FAULT_NONE)
		s->fault = fault;
	if (s->state == STREAM_UP && b->now_ns - s->since_ns > STABLE_MS * BOARD_MS)
		s->backoff_ns = STREAM_FIRST_BACKOFF_MS * BOARD_MS;
	enter(b, s, STREAM_DOWN);
	s->retry_ns = s->since_ns + s->backoff_ns;
	s->backoff_ns = s->backoff_ns * 2 < LAST_BACKOFF_MS * BOARD_MS ? s->backoff_ns * 2 : LAST_BACKOFF_MS * BOARD_MS;
	s->count = 0;
}

int stream_expected(const struct chip_registers *list, size_t i)
{
	for (size_t later = i + 1; later < list->n; later++)
		if (list->at[later].address == list->at[i].address)
			return -1;
	return list->at[i].value;
}

int stream_verify(struct board *b, const struct stream *s, size_t i)
{
	int value = stream_expected(&s->registers, i), result;
	uint8_t byte;

	if (value < 0)
		return 0;
	result = board_read_chip(b, s->chip, s->address, s->registers.at[i].address, &byte, 1);
	if (result < 0)
		return result;
	return byte == value ? 0 : -EBADMSG;
}

static enum imu_fault fault_of(int error)
{
	return error == -EBADMSG ? IMU_FAULT_CONFIGURATION : error == -ENODEV ? IMU_FAULT_WRONG_CHIP : IMU_FAULT_SILENT;
}

int stream_set_up(struct board *b, struct stream *s)
{
	int result = board_identify(b, s->chip, s->address);

	for (size_t i = 0; i < s->registers.n && result == 0; i++)
		result = i2c_write(b->bus, s->address, s->registers.at[i].address, s->registers.at[i].value);
	for (size_t i = 0; i < s->registers.n && result == 0; i++)
		result = stream_verify(b, s, i);
	return result;
}

void stream_start(struct board *b, struct stream *s)
{
	int result = stream_set_up(b, s);

	board_read_clock(b);
	if (s->fault != IMU_FAULT_NONE)
		b->health.restarts++;
	if (result < 0) {
		b->health.bus_errors += result != -EBADMSG && result != -ENODEV;
		stream_fail(b, s, fault_of(result));
		return;
	}
	enter(b, s, STREAM_STARTING);
	sample_clock_start(&s->clock, 1e9 / s->setup.rate->hz, RATE_TOLERANCE);
	s->next = 0;
	s->first = s->count = s->verify = 0;
	s->partial_have = s->failures = s->saturated = s->same = 0;
	s->failing_ns = 0;
	s->fresh_ns = s->none_ns = s->due_ns = s->since_ns;
	s->verify_ns = s->since_ns + STREAM_VERIFY_MS * BOARD_MS;
	s->same_limit = stream_same_limit(s);
}

/* ---- raw data ---------------------------------------------------------------------------------------------------- */

static uint16_t get_u16(const uint8_t *bytes)
{
	return (uint16_t)(bytes[0] | bytes[1] << 8);
}

int16_t stream_word(const struct chip *chip, const uint8_t *bytes)
{
	return (int16_t)(chip->big_endian ? bytes[0] << 8 | bytes[1] : get_u16(bytes));
}

struct vec3 stream_decode(const struct stream *s, size_t triad, const uint8_t *set, bool *saturated)
{
	const struct chip_triad *t = &s->chip->triads[triad];
	const struct chip_range *r = s->setup.range[triad];
	int16_t w[3];

	for (int i = 0; i < 3; i++) {
		w[i] = stream_word(s->chip, set + t->byte + 2 * t->order[i]);
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

/* Whether the samples of a chip that was initialised again show that the fault is over. */
static bool recovered(const struct stream *s)
{
	if (s->clock.newest + 1 < SETTLE_SAMPLES && !sample_clock_locked(&s->clock))
		return false;
	return (s->fault != IMU_FAULT_FROZEN || s->same == 1) && (s->fault != IMU_FAULT_SATURATED || s->saturated == 0);
}

static void add_sample(struct board *b, struct stream *s, const uint8_t *set)
{
	struct reading reading = {.t_ns = sample_clock_at(&s->clock, s->next++)};
	bool saturated = false;

	for (size_t i = 0; i < s->chip->triad_count; i++)
		reading.value[i] = stream_decode(s, i, set, &saturated);
	reading.saturated = saturated;
	watch_data(s, set, saturated);
	s->fresh_ns = b->now_ns;
	if (s->state == STREAM_STARTING && recovered(s)) {
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

/* Between from_ns and to_ns the chip had `level` samples, of which the oldest is the next to be read. How many were
 * lost before it is derived from the sample clock. */
static void observe(
	struct board *b, struct stream *s, int64_t level, enum losses losses, int64_t from_ns, int64_t to_ns)
{
	if (losses != LOST_NONE && s->clock.newest >= 0) {
		double since_ns = (double)from_ns - sample_clock_at(&s->clock, s->next + level - 1);
		double n = fmax(floor(since_ns / sample_clock_period(&s->clock)), losses == LOST_SOME ? 1 : 0);

		s->next += (int64_t)n;
		b->health.overruns += (uint32_t)n;
	}
	if (level == 0)
		s->none_ns = from_ns;
	/* a stub may not show a sample that was already taken */
	sample_clock_read(&s->clock, s->next + level,
		(double)(s->setup.stub ? from_ns - STUB_LATE_MS * BOARD_MS : from_ns), (double)to_ns);
}

/* Whether samples were lost between this one and the one before. */
static enum losses losses_of(const struct stream *s, uint8_t status)
{
	if (s->setup.stub || s->chip->overrun == 0)
		return LOST_PERHAPS;
	return status & s->chip->overrun ? LOST_SOME : LOST_NONE;
}

/* Without FIFO: reads status and data, in one transfer if they are close enough. */
static int read_registers(struct board *b, struct stream *s)
{
	const struct chip *chip = s->chip;
	const size_t offset = (uint8_t)(chip->data - chip->status);
	const bool together = chip->data > chip->status && offset + chip->data_size <= I2C_BLOCK_MAX;
	uint8_t bytes[I2C_BLOCK_MAX], *set = bytes + (together ? offset : 1);
	int64_t from_ns = board_read_clock(b), to_ns;
	bool fresh;
	int result = board_read_chip(b, chip, s->address, chip->status, bytes, together ? offset + chip->data_size : 1);

	to_ns = board_read_clock(b);
	if (result < 0)
		return result;
	fresh = bytes[0] & chip->ready;
	if (fresh && !together) {
		result = board_read_chip(b, chip, s->address, chip->data, set, chip->data_size);
		board_read_clock(b);
		if (result < 0)
			return result;
	}
	/* the data-ready bit of a stub stays set: a sample is new if its data differ */
	if (fresh && s->setup.stub && s->same > 0 && memcmp(set, s->last, chip->data_size) == 0)
		fresh = false;
	observe(b, s, fresh ? 1 : 0, fresh ? losses_of(s, bytes[0]) : LOST_NONE, from_ns, to_ns);
	if (fresh)
		add_sample(b, s, set);
	return fresh;
}

static int read_sets(struct board *b, struct stream *s, uint8_t at, int64_t level)
{
	const size_t size = s->chip->data_size;
	uint8_t bytes[I2C_BLOCK_MAX];

	for (int64_t left = level; left > 0;) {
		size_t sets = I2C_BLOCK_MAX / size;
		int result;

		if ((int64_t)sets > left)
			sets = (size_t)left;
		result = board_read_chip(b, s->chip, s->address, at, bytes, sets * size);
		if (result < 0)
			return result;
		for (size_t i = 0; i < sets; i++)
			add_sample(b, s, bytes + i * size);
		left -= (int64_t)sets;
	}
	return (int)level;
}

static int read_fifo_sets(struct board *b, struct stream *s)
{
	int64_t from_ns = board_read_clock(b);
	uint8_t source;
	int result = board_read_chip(b, s->chip, s->address, FIFO_SOURCE, &source, 1);
	int64_t level = source & 0x40 ? FIFO_DEPTH : source & 0x1F;

	if (result < 0)
		return result;
	observe(b, s, level, source & 0x40 ? LOST_PERHAPS : LOST_NONE, from_ns, board_read_clock(b));
	return read_sets(b, s, s->chip->data, level);
}

/* LSM6DS33: the status contains the position of the next word in its set; after an overrun it may be in the middle. */
static int read_fifo_words(struct board *b, struct stream *s)
{
	int64_t from_ns = board_read_clock(b), words;
	uint8_t status[4], skipped[10];
	int result = board_read_chip(b, s->chip, s->address, 0x3A, status, sizeof status), next;

	if (result < 0)
		return result;
	words = get_u16(status) & 0x0FFF;
	next = get_u16(status + 2) & 0x03FF;
	if (next > 0 && next < 6 && words >= 6 - next) {
		words -= 6 - next;
		if ((result = board_read_chip(b, s->chip, s->address, 0x3E, skipped, (size_t)(6 - next) * 2)) < 0)
			return result;
	}
	observe(b, s, words / 6, status[1] & 0x40 ? LOST_PERHAPS : LOST_NONE, from_ns, board_read_clock(b));
	return read_sets(b, s, 0x3E, words / 6 < FIFO_DEPTH ? words / 6 : FIFO_DEPTH);
}

static void add_tagged(struct board *b, struct stream *s, const uint8_t *entry)
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
	add_sample(b, s, s->partial);
}

/* LSM6DSO: each entry is a tag and one triad. */
static int read_fifo_tagged(struct board *b, struct stream *s)
{
	enum { ENTRY = 7, AT_ONCE = 4 };
	int64_t from_ns = board_read_clock(b), entries;
	uint8_t status[2], bytes[ENTRY * AT_ONCE];
	int result = board_read_chip(b, s->chip, s->address, 0x3A, status, sizeof status);

	if (result < 0)
		return result;
	entries = get_u16(status) & 0x03FF;
	observe(b, s, (entries + (s->partial_have != 0)) / 2, status[1] & 0x48 ? LOST_PERHAPS : LOST_NONE, from_ns,
		board_read_clock(b));
	if (entries > 2 * FIFO_DEPTH) /* the rest next time */
		entries = 2 * FIFO_DEPTH;
	for (int64_t left = entries; left > 0; left -= AT_ONCE) {
		size_t n = left < AT_ONCE ? (size_t)left : AT_ONCE;

		if ((result = board_read_chip(b, s->chip, s->address, 0x78, bytes, n * ENTRY)) < 0)
			return result;
		for (size_t i = 0; i < n; i++)
			add_tagged(b, s, bytes + i * ENTRY);
	}
	return (int)entries;
}

int stream_read(struct board *b, struct stream *s)
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
