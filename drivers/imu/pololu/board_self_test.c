#include "drivers/imu/pololu/board_parts.h"

#include <errno.h>
#include <math.h>
#include <string.h>

enum { TEST_READS = 16, TEST_SETTLE_MS = 200 };

/* The mean of TEST_READS samples of the data registers. */
static int mean_of(struct board *b, const struct stream *s, struct vec3 mean[CHIP_TRIADS])
{
	int64_t next_ns = board_read_clock(b), period_ns = (int64_t)(1e9 / s->setup.rate->hz);
	uint8_t data[I2C_BLOCK_MAX], set[CHIP_SET];
	bool saturated = false;

	memset(mean, 0, CHIP_TRIADS * sizeof *mean);
	for (int n = 0; n < TEST_READS; n++) {
		int result = board_read_chip(b, s->chip, s->address, s->chip->data, data, s->chip->data_size);

		if (result < 0)
			return result;
		stream_pack(s->chip, data, set);
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

/* Writes the excitation and waits until it has its effect. */
static int excite(struct board *b, const struct stream *s, const struct chip_self_test *test, uint8_t on)
{
	uint8_t value;
	int result = board_read_chip(b, s->chip, s->address, test->address, &value, 1);

	if (result == 0)
		result = i2c_write(b->bus, s->address, test->address, (uint8_t)((value & ~test->mask) | on));
	board_sleep_until(b, b->now_ns + TEST_SETTLE_MS * BOARD_MS);
	return result;
}

static bool test_triad(struct board *b, const struct stream *s, size_t i)
{
	const struct chip_self_test *test = &s->chip->triads[i].self_test;
	struct vec3 off[CHIP_TRIADS], on[CHIP_TRIADS], change;

	if (test->before && excite(b, s, test, test->before) < 0)
		return false;
	if (mean_of(b, s, off) < 0 || excite(b, s, test, test->on) < 0 || mean_of(b, s, on) < 0)
		return false;
	change = vec3_sub(on[i], off[i]);
	return within(change.x, test->least.x, test->most.x) && within(change.y, test->least.y, test->most.y) &&
	       within(change.z, test->least.z, test->most.z);
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

		if (t->self_test.most.x <= 0)
			continue;
		s->setup.fifo = false;
		if (t->self_test.widest)
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
