/* When a chip has a fault, to the sample and the nanosecond (drivers/imu/pololu/board.h): numbers of equal and
 * saturated samples, times without samples and without answers, registers read back. The state of a simulated chip is
 * set by hand; the limits are those of board.h. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>
#include <errno.h>
#include <math.h>

#include "drivers/imu/pololu/board_parts.h"
#include "tests/unit/descriptors.h"
#include "tests/unit/i2c_world.h"

static struct world *w;

/* The gyro of a v3 at this rate, up and without a fault. */
static struct stream *gyro_at(double rate_hz)
{
	struct imu_settings settings = IMU_SETTINGS_DEFAULTS;

	w = world_make("v3", "rest", false);
	world_detect(w);
	settings.rate_hz = rate_hz;
	world_set_up(w, &settings, true);
	world_run(w, 600000);
	assert_int_equal(w->board.gyro->state, STREAM_UP);
	return w->board.gyro;
}

static bool fails(struct stream *s, enum imu_fault fault)
{
	struct stream before = *s;
	bool failed;

	stream_watch(&w->board, s);
	failed = s->state == STREAM_DOWN;
	assert_true(!failed || s->fault == fault);
	*s = before;
	return failed;
}

/* For 60 ms, and four samples at least. */
static void test_a_chip_at_the_end_of_its_range_for_60_ms_has_a_fault(void **state)
{
	static const double RATES[] = {12.5, 100, 200, 800};

	(void)state;
	for (size_t i = 0; i < sizeof RATES / sizeof *RATES; i++) {
		struct stream *s = gyro_at(RATES[i]);
		const unsigned samples = (unsigned)fmax(4, ceil(0.06 * s->setup.rate->hz));

		s->saturated = samples - 1;
		assert_false(fails(s, IMU_FAULT_SATURATED));
		s->saturated = samples;
		assert_true(fails(s, IMU_FAULT_SATURATED));
		world_free(w);
	}
}

static void test_equal_samples_are_a_fault_where_noise_cannot_explain_them(void **state)
{
	struct stream *s = gyro_at(100);

	(void)state;
	s->same_limit = 7;
	s->same = 6;
	assert_false(fails(s, IMU_FAULT_FROZEN));
	s->same = 7;
	assert_true(fails(s, IMU_FAULT_FROZEN));
	s->saturated = 1; /* equal because they are at the end of the range */
	assert_false(fails(s, IMU_FAULT_FROZEN));
	s->saturated = 0;
	s->same_limit = 0;
	assert_false(fails(s, IMU_FAULT_FROZEN));
	world_free(w);
}

/* 50 ms and two sampling intervals between two reads, without a new sample in the second; a program that writes the
 * registers of a stub may be late by a second. */
static void test_a_chip_without_a_sample_for_50_ms_has_stopped(void **state)
{
	struct stream *s = gyro_at(100);

	(void)state;
	s->none_ns = s->fresh_ns + 70000000;
	assert_false(fails(s, IMU_FAULT_STOPPED));
	s->none_ns++;
	assert_true(fails(s, IMU_FAULT_STOPPED));
	s->setup.stub = true;
	assert_false(fails(s, IMU_FAULT_STOPPED));
	s->none_ns = s->fresh_ns + 1020000001;
	assert_true(fails(s, IMU_FAULT_STOPPED));
	s->same_limit = 0; /* equal data may be new */
	assert_false(fails(s, IMU_FAULT_STOPPED));
	world_free(w);
}

/* Three transfers in a row fail, over 20 ms at least. */
static void test_a_chip_that_does_not_answer_for_20_ms_is_silent(void **state)
{
	static const struct {
		unsigned failures;
		int64_t over_ns;
		bool silent;
	} cases[] = {{2, 50000000, false}, {3, 19999999, false}, {3, 20000000, true}, {4, 19999999, false}};

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		struct stream *s = gyro_at(100);
		const uint32_t errors = w->board.health.bus_errors;

		for (unsigned n = 1; n < cases[i].failures; n++)
			stream_count_errors(&w->board, s, -EIO);
		w->board.now_ns += cases[i].over_ns;
		stream_count_errors(&w->board, s, -EIO);
		assert_int_equal(s->state == STREAM_DOWN, cases[i].silent);
		assert_int_equal(s->fault, cases[i].silent ? IMU_FAULT_SILENT : IMU_FAULT_NONE);
		assert_int_equal(w->board.health.bus_errors, errors + cases[i].failures);
		if (!cases[i].silent) { /* an answer ends the row */
			stream_count_errors(&w->board, s, 0);
			stream_count_errors(&w->board, s, -EIO);
			stream_count_errors(&w->board, s, -EIO);
			assert_int_equal(s->state, STREAM_UP);
		}
		world_free(w);
	}
}

static int accesses_at_registers(struct world *world, const struct sim_access *access)
{
	(void)world;
	return access->write ? -EIO : 0;
}

/* One register in 10 ms, each in its turn; those that are written twice have the last value. */
static void test_the_registers_are_read_back_in_turn(void **state)
{
	struct stream *s = gyro_at(100);
	size_t checked = 0;

	(void)state;
	w->before = accesses_at_registers; /* nothing is written meanwhile */
	for (size_t i = 0; i < s->registers.n; i++)
		checked += stream_expected(&s->registers, i) >= 0;
	assert_true(checked > 3);
	s->verify = 0;
	for (size_t n = 0; n < 3 * checked; n++) {
		const size_t first = s->verify;

		stream_verify_next(&w->board, s);
		assert_int_equal(s->verify_ns, w->board.now_ns + 9000000); /* and at most one for the next read */
		assert_true(s->verify != first);
		assert_int_equal(s->state, STREAM_UP);
	}
	world_free(w);
}

static uint8_t damaged_reads;

static void damage(struct world *world, const struct sim_access *access)
{
	(void)world;
	if (!access->write && damaged_reads > 0 && damaged_reads-- > 0)
		access->bytes[0] ^= 0x10;
}

/* A value that was read wrongly once is read again. */
static void test_a_register_with_another_value_twice_is_a_fault(void **state)
{
	struct stream *s = gyro_at(100);

	(void)state;
	w->after = damage;
	damaged_reads = 1;
	stream_verify_next(&w->board, s);
	assert_int_equal(s->state, STREAM_UP);
	damaged_reads = 2;
	stream_verify_next(&w->board, s);
	assert_int_equal(s->state, STREAM_DOWN);
	assert_int_equal(s->fault, IMU_FAULT_CONFIGURATION);
	world_free(w);
}

/* Probability that noise of this sigma, in digits, stays within half a digit: Simpson's rule over the density. */
static double within_half_a_digit(double sigma)
{
	const int n = 1000;
	double sum = 0;

	for (int i = 0; i <= n; i++) {
		const double x = (-0.5 + (double)i / n) / sigma;

		sum += (i == 0 || i == n ? 1 : i % 2 ? 4 : 2) * exp(-x * x / 2);
	}
	return sum / (3 * n) / (sigma * sqrt(2 * acos(-1)));
}

/* Of a quiet chip the noise is 0.6 of the data sheet's, behind a low-pass of the first order, of which a new value
 * contains the share that the last one does not determine. Equal values by noise alone, on all axes at once, have a
 * probability below 1e-12; the limit is 50 ms at least, and none beyond a second. */
static void test_the_number_of_equal_samples_follows_from_the_noise_of_the_chip(void **state)
{
	static const char *const BOARDS[] = {"v0", "v2", "v3", "v5", "v6", "lsm9ds1", "icm20948", "bmi270"};
	static const double RATES[] = {50, 100, 400};
	int limited = 0, never = 0;

	(void)state;
	for (size_t i = 0; i < 3 * sizeof BOARDS / sizeof *BOARDS; i++) {
		struct imu_settings settings = IMU_SETTINGS_DEFAULTS;

		w = world_make(BOARDS[i / 3], "rest", false);
		world_detect(w);
		settings.rate_hz = RATES[i % 3];
		settings.mag_range_uT = i % 3 == 1 ? 800 : settings.mag_range_uT; /* a digit coarser than the noise */
		world_set_up(w, &settings, true);
		for (size_t k = 0; k < w->board.stream_count; k++) {
			const struct stream *s = &w->board.streams[k];
			const double rate_hz = s->setup.rate->hz, bandwidth_hz = s->setup.bandwidth_hz,
				     kept = exp(-2 * acos(-1) * bandwidth_hz / rate_hz);
			double chance = 1, expected = 1, n;

			for (size_t t = 0; t < s->chip->triad_count; t++) {
				const struct chip_triad *triad = &s->chip->triads[t];
				const double digit = s->setup.range[t]->step * (triad->digit ? triad->digit : 1);
				const double sigma = 0.6 * triad->density * sqrt(fmin(bandwidth_hz, rate_hz / 2)) *
						     sqrt(1 - kept * kept) / digit;

				chance *= pow(within_half_a_digit(sigma), 3);
			}
			for (n = 1; expected > 1e-12 && n < 1e5; n++)
				expected *= chance;
			n = n > rate_hz ? 0 : fmax(n, ceil(0.05 * rate_hz));
			if (n != stream_same_limit(s))
				fail_msg("%s at %g Hz, chip %zu: %u, expected %g", BOARDS[i / 3], rate_hz, k,
					stream_same_limit(s), n);
			limited += n > 0;
			never += n == 0;
		}
		world_free(w);
	}
	if (limited < 20 || never < 2)
		fail_msg("%d have a limit, %d none", limited, never);
}

/* 10 ms, then twice as long each time, up to a second; from the start again after more than a second without a
 * fault. */
static void test_a_chip_with_a_fault_is_initialised_again_after_a_back_off(void **state)
{
	static const int64_t PAUSES_MS[] = {10, 20, 40, 80, 160, 320, 640, 1000, 1000};
	struct stream *s = gyro_at(100);
	struct board *b = &w->board;

	(void)state;
	s->backoff_ns = 10000000;
	for (size_t i = 0; i < sizeof PAUSES_MS / sizeof *PAUSES_MS; i++) {
		s->state = STREAM_UP;
		s->since_ns = b->now_ns - 1000000000;
		stream_fail(b, s, IMU_FAULT_SILENT);
		assert_int_equal(s->since_ns, b->now_ns);
		assert_int_equal(s->retry_ns, b->now_ns + PAUSES_MS[i] * 1000000);
	}
	s->state = STREAM_STARTING; /* it was not up */
	s->since_ns = b->now_ns - 1000000001;
	stream_fail(b, s, IMU_FAULT_SILENT);
	assert_int_equal(s->retry_ns, b->now_ns + 1000000000);
	s->state = STREAM_UP;
	s->since_ns = b->now_ns - 1000000001;
	stream_fail(b, s, IMU_FAULT_STOPPED);
	assert_int_equal(s->retry_ns, b->now_ns + 10000000);
	assert_int_equal(s->fault, IMU_FAULT_SILENT); /* the first one since it was well */
	assert_int_equal(s->count, 0);
	world_free(w);
}

/* The clock of a chip that was initialised again may begin before the last sample. */
static void test_a_sample_is_later_than_the_one_before(void **state)
{
	struct stream *s = gyro_at(100);
	struct imu_sample sample;
	uint64_t last_us;

	(void)state;
	(void)s;
	assert_true(world_sample(w, &sample, 100000));
	last_us = sample.t_us + 35000;
	w->board.last_t_ns += 35e6;
	assert_true(world_sample(w, &sample, 100000));
	assert_in_range(sample.t_us, last_us + 1, last_us + 12000);
	world_free(w);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_chip_at_the_end_of_its_range_for_60_ms_has_a_fault),
		cmocka_unit_test(test_equal_samples_are_a_fault_where_noise_cannot_explain_them),
		cmocka_unit_test(test_a_chip_without_a_sample_for_50_ms_has_stopped),
		cmocka_unit_test(test_a_chip_that_does_not_answer_for_20_ms_is_silent),
		cmocka_unit_test(test_the_registers_are_read_back_in_turn),
		cmocka_unit_test(test_a_register_with_another_value_twice_is_a_fault),
		cmocka_unit_test(test_the_number_of_equal_samples_follows_from_the_noise_of_the_chip),
		cmocka_unit_test(test_a_chip_with_a_fault_is_initialised_again_after_a_back_off),
		cmocka_unit_test(test_a_sample_is_later_than_the_one_before),
	};

	return cmocka_run_group_tests_name("i2c_watch", tests, count_descriptors, no_descriptor_is_left);
}
