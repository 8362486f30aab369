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
	SPI_READ = 0x80,
};

int board_read_chip(
	const struct board *b, const struct chip *chip, uint8_t address, uint8_t at, uint8_t *bytes, size_t n)
{
	uint8_t all[I2C_BLOCK_MAX + SPI_DUMMY_MAX];
	int result;

	if (!b->bus->spi)
		return i2c_read(b->bus, address, n > 1 ? at | chip->increment : at, bytes, n);
	result = i2c_read(
		b->bus, address, (uint8_t)(SPI_READ | at | (n > 1 ? chip->spi.multiple : 0)), all, n + chip->spi.dummy);
	if (result == 0)
		memcpy(bytes, all + chip->spi.dummy, n);
	return result;
}

static int read_identity(const struct board *b, const struct chip *chip, uint8_t address)
{
	uint8_t bytes[sizeof chip->identity];
	size_t n = chip->identity_size ? chip->identity_size : 1;
	int result = board_read_chip(b, chip, address, chip->identity_size ? chip->identity_at : 0x20, bytes, n);

	if (result < 0)
		return result;
	return memcmp(bytes, chip->identity, chip->identity_size) == 0 ? 0 : -ENODEV;
}

static int select_bank(const struct board *b, const struct chip *chip, uint8_t address, uint8_t bank)
{
	return chip->bank_select ? i2c_write(b->bus, address, chip->bank_select, (uint8_t)(bank << 4)) : 0;
}

/* The identity is in bank 0, another one may have been left selected. */
int board_identify(const struct board *b, const struct chip *chip, uint8_t address)
{
	int result = read_identity(b, chip, address);

	if (result != -ENODEV || !chip->bank_select)
		return result;
	result = select_bank(b, chip, address, 0);
	return result < 0 ? result : read_identity(b, chip, address);
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
		if (list->at[later].address == list->at[i].address && list->at[later].bank == list->at[i].bank)
			return -1;
	return list->at[i].value;
}

int stream_verify(struct board *b, const struct stream *s, size_t i)
{
	int value = stream_expected(&s->registers, i), result;
	uint8_t byte = 0;

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

static int write_register(struct board *b, const struct stream *s, size_t i)
{
	return i2c_write(b->bus, s->address, s->registers.at[i].address, s->registers.at[i].value);
}

/* Calls `each` for the registers of the list in turn, in their banks. Bank 0 is selected afterwards. */
static int for_all_registers(
	struct board *b, const struct stream *s, int (*each)(struct board *, const struct stream *, size_t))
{
	int bank = -1, result = 0;

	for (size_t i = 0; i < s->registers.n && result == 0; i++) {
		if (s->registers.at[i].bank != bank) {
			bank = s->registers.at[i].bank;
			result = select_bank(b, s->chip, s->address, (uint8_t)bank);
		}
		if (result == 0)
			result = each(b, s, i);
	}
	return result == 0 && bank > 0 ? select_bank(b, s->chip, s->address, 0) : result;
}

int stream_set_up(struct board *b, struct stream *s)
{
	int result = board_identify(b, s->chip, s->address);

	if (result == 0 && s->chip->prepare)
		result = s->chip->prepare(b, s->chip, s->address);
	if (result == 0)
		result = for_all_registers(b, s, write_register);
	return result == 0 ? for_all_registers(b, s, stream_verify) : result;
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
	s->flushed = false;
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
	int w[3];

	for (int i = 0; i < 3; i++) {
		w[i] = stream_word(s->chip, set + 6 * triad + 2 * t->order[i]);
		*saturated |= t->overflow ? w[i] == t->overflow : w[i] >= SATURATED_WORD || w[i] <= -SATURATED_WORD;
		if (t->negative >> i & 1)
			w[i] = -w[i];
	}
	return (struct vec3){w[0] * r->step, w[1] * r->step, w[2] * (r->step_z > 0 ? r->step_z : r->step)};
}

void stream_pack(const struct chip *chip, const uint8_t *data, uint8_t set[CHIP_SET])
{
	for (size_t i = 0; i < chip->triad_count; i++)
		memcpy(set + 6 * i, data + chip->triads[i].byte, 6);
}

static void watch_data(struct stream *s, const uint8_t *set, bool saturated)
{
	if (s->same > 0 && memcmp(set, s->last, 6 * s->chip->triad_count) == 0)
		s->same++;
	else
		s->same = 1;
	memcpy(s->last, set, 6 * s->chip->triad_count);
	s->saturated = saturated ? s->saturated + 1 : 0;
}

/* Whether the samples of a chip that was initialised again show that the fault is over. */
static bool recovered(const struct stream *s)
{
	if (s->clock.newest + 1 < SETTLE_SAMPLES && !sample_clock_locked(&s->clock))
		return false;
	return (s->fault != IMU_FAULT_FROZEN || s->same == 1) && (s->fault != IMU_FAULT_SATURATED || s->saturated == 0);
}

void stream_add(struct board *b, struct stream *s, const uint8_t *set)
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

void stream_observe(
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

/* On SPI, a chip that is not there reads as FFh. */
static bool is_absent(const struct board *b, const uint8_t *bytes, size_t n)
{
	while (b->bus->spi && n > 0 && bytes[n - 1] == 0xFF)
		n--;
	return b->bus->spi && n == 0;
}

/* Without FIFO: reads status and data, in one transfer if they are close enough. */
static int read_registers(struct board *b, struct stream *s)
{
	const struct chip *chip = s->chip;
	const size_t offset = (uint8_t)(chip->data - chip->status);
	const bool together = chip->data > chip->status && offset + chip->data_size <= I2C_BLOCK_MAX;
	uint8_t bytes[1 + I2C_BLOCK_MAX] = {0}, *data = bytes + (together ? offset : 1), set[CHIP_SET];
	int64_t from_ns = board_read_clock(b), to_ns;
	bool fresh;
	int result = board_read_chip(b, chip, s->address, chip->status, bytes, together ? offset + chip->data_size : 1);

	to_ns = board_read_clock(b);
	if (result < 0)
		return result;
	fresh = bytes[0] & chip->ready;
	if (fresh && !together) {
		result = board_read_chip(b, chip, s->address, chip->data, data, chip->data_size);
		board_read_clock(b);
		if (result < 0)
			return result;
	}
	if (fresh && is_absent(b, data, chip->data_size))
		return -EIO;
	stream_pack(chip, data, set);
	/* the data-ready bit of a stub stays set: a sample is new if its data differ */
	if (fresh && s->setup.stub && s->same > 0 && memcmp(set, s->last, 6 * chip->triad_count) == 0)
		fresh = false;
	stream_observe(b, s, fresh ? 1 : 0, fresh ? losses_of(s, bytes[0]) : LOST_NONE, from_ns, to_ns);
	if (fresh)
		stream_add(b, s, set);
	return fresh;
}

int stream_read(struct board *b, struct stream *s)
{
	return s->setup.fifo ? stream_read_fifo(b, s) : read_registers(b, s);
}
