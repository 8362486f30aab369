#include "drivers/imu/pololu/board_parts.h"

#include <errno.h>
#include <math.h>
#include <string.h>

enum { TEST_READS = 16, TEST_SETTLE_MS = 200 };

/* The mean of TEST_READS samples of the data registers. */
static int mean_of(struct board *b, const struct stream *s, struct vec3 mean[CHIP_TRIADS])
{
	int64_t next_ns = board_read_clock(b), period_ns = (int64_t)(1e9 / s->setup.rate->hz);
	uint8_t set[CHIP_TRIADS * 6];
	bool saturated = false;

	memset(mean, 0, CHIP_TRIADS * sizeof *mean);
	for (int n = 0; n < TEST_READS; n++) {
		int result = board_read_chip(b, s->chip, s->address, s->chip->data, set, s->chip->data_size);

		if (result < 0)
			return result;
		for (size_t i = 0; i < s->chip->triad_count; i++)
			mean[i] = vec3_add(mean[i], vec3_scale(1.0 / TEST_READS, stream_decode(s, i, set, &saturated)));
		board_sleep_until(b, next_ns += period_ns);
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

	if (mean_of(b, s, off) < 0 || board_read_chip(b, s->chip, s->address, t->self_test.address, &value, 1) < 0)
		return false;
	value = (uint8_t)((value & ~t->self_test.mask) | t->self_test.on);
	if (i2c_write(b->bus, s->address, t->self_test.address, value) < 0)
		return false;
	board_sleep_until(b, b->now_ns + TEST_SETTLE_MS * BOARD_MS);
	if (mean_of(b, s, on) < 0)
		return false;
	change = vec3_sub(on[i], off[i]);
	return within(change.x, t->self_test.least, t->self_test.most) &&
	       within(change.y, t->self_test.least, t->self_test.most) &&
	       within(change.z, t->self_test.least, t->self_test.most);
}

static const struct chip_range *widest(const struct chip_triad *triad)
{
	const struct chip_range *r = triad->ranges;

	while (r[1].full_scale > 0)
		r++;
	return r;
}

/* Reads the data registers, without FIFO. Afterwards the chip is initialised again, as after a fault. */
static void test_stream(struct board *b, struct stream *s)
{
	const struct chip_setup setup = s->setup;

	for (size_t i = 0; i < s->chip->triad_count; i++) {
		const struct chip_triad *t = &s->chip->triads[i];
		bool passed;

		if (t->self_test.most <= 0)
			continue;
		s->setup.fifo = false;
		if (t->what == IMU_CHIP_GYRO) /* its limits are specified for it */
			s->setup.range[i] = widest(t);
		s->registers = (struct chip_registers){0};
		s->chip->registers(&s->setup, &s->registers);
		passed = stream_set_up(b, s) == 0;
		board_sleep_until(b, b->now_ns + TEST_SETTLE_MS * BOARD_MS);
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
	s->retry_ns = b->now_ns;
	s->count = 0;
}

void board_self_test(struct board *b)
{
	b->health.self_test = IMU_SELF_TEST_RUNS; /* until there are samples again */
	b->self_test_failed = false;
	for (size_t i = 0; i < b->stream_count; i++)
		test_stream(b, &b->streams[i]);
	board_update_health(b);
}
