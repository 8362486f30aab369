/* Detection of frozen sensors (drivers/imu/frozen.h): raw values of a gyro with noise below and above a digit, at rest
 * and in motion. */
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include <setjmp.h>
/* cmocka wants the above first */
#include <cmocka.h>

#include "drivers/imu/frozen.h"
#include "model/sim/rng.h"

enum { AXES = 3, RATE_HZ = 100 };

struct gyro {
	struct frozen frozen;
	struct rng rng;
	double sigma_digits, digit, low_pass; /* share of the old value in the new one */
	double noise[AXES], offset_digits[AXES], raw[AXES];
	unsigned alarms;
};

static struct gyro gyro_of(double sigma_digits, uint64_t seed)
{
	struct gyro g = {.sigma_digits = sigma_digits, .digit = 1};

	rng_init(&g.rng, seed);
	for (int i = 0; i < AXES; i++)
		g.offset_digits[i] = 20 * rng_uniform(&g.rng) - 10;
	return g;
}

static void watch(struct gyro *g)
{
	g->alarms += frozen_watch(&g->frozen, g->raw, AXES);
}

static void measure(struct gyro *g, double rate_digits)
{
	double fresh = sqrt(1 - g->low_pass * g->low_pass);

	for (int i = 0; i < AXES; i++) {
		g->noise[i] = g->low_pass * g->noise[i] + fresh * g->sigma_digits * rng_gauss(&g->rng);
		g->raw[i] = g->digit * floor(g->offset_digits[i] + rate_digits + g->noise[i] + 0.5);
	}
	watch(g);
}

static void rest(struct gyro *g, double s)
{
	for (int i = 0; i < s * RATE_HZ; i++)
		measure(g, 0);
}

/* An oscillation of 100 digits about all axes; the offsets drift by up to half a digit meanwhile. */
static void move(struct gyro *g, double s)
{
	for (int i = 0; i < s * RATE_HZ; i++)
		measure(g, 100 * sin(0.07 * i));
	for (int i = 0; i < AXES; i++)
		g->offset_digits[i] += rng_uniform(&g->rng) - 0.5;
}

/* Samples until the freeze is detected, or 0. */
static unsigned detected_after(struct gyro *g)
{
	g->alarms = 0;
	for (unsigned n = 1; n <= 1000; n++) {
		watch(g);
		if (g->alarms)
			return n;
	}
	return 0;
}

static void test_a_frozen_gyro_with_noise_of_a_digit_is_detected_within_a_second(void **state)
{
	static const double SIGMAS[] = {0.7, 1, 3, 30};

	(void)state;
	for (uint64_t seed = 0; seed < 40; seed++) {
		struct gyro g = gyro_of(SIGMAS[seed % 4], seed);

		rest(&g, 60);
		move(&g, 3);
		rest(&g, 60);
		assert_int_equal(g.alarms, 0);
		assert_in_range(detected_after(&g), 1, RATE_HZ);
	}
}

static void test_at_rest_noise_below_a_digit_is_not_frozen(void **state)
{
	static const double SIGMAS[] = {0, 0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.5};

	(void)state;
	for (uint64_t seed = 0; seed < 80; seed++) {
		struct gyro g = gyro_of(SIGMAS[seed % 8], seed);

		for (int i = 0; i < 5; i++) {
			rest(&g, 30 * (i + 1));
			move(&g, 5);
		}
		assert_int_equal(g.alarms, 0);
	}
}

/* The narrowest low-pass filters: consecutive values are correlated. */
static void test_correlated_noise_at_rest_is_not_frozen(void **state)
{
	static const double SIGMAS[] = {0.1, 0.3, 0.5, 0.7, 1};

	(void)state;
	for (uint64_t seed = 0; seed < 50; seed++) {
		struct gyro g = gyro_of(SIGMAS[seed % 5], seed);

		g.low_pass = 0.85; /* 2.6 Hz */
		for (int i = 0; i < 5; i++) {
			rest(&g, 60);
			move(&g, 5);
		}
		assert_int_equal(g.alarms, 0);
	}
}

static void test_a_digit_may_be_several_steps_of_the_raw_values(void **state)
{
	(void)state;
	for (uint64_t seed = 0; seed < 20; seed++) {
		struct gyro quiet = gyro_of(0.1, seed), noisy = gyro_of(1, seed);

		quiet.digit = noisy.digit = 16;
		for (int i = 0; i < 5; i++) {
			rest(&quiet, 30);
			move(&quiet, 5);
		}
		rest(&noisy, 30);
		assert_int_equal(quiet.alarms + noisy.alarms, 0);
		assert_in_range(detected_after(&noisy), 1, RATE_HZ);
	}
}

/* Its motion alone does not show that its noise is below a digit. */
static void test_a_coarse_gyro_that_was_never_at_rest_raises_at_most_one_false_alarm(void **state)
{
	(void)state;
	for (uint64_t seed = 0; seed < 40; seed++) {
		struct gyro g = gyro_of(0.05, seed);

		move(&g, 60);
		rest(&g, 60);
		move(&g, 5);
		g.alarms = 0;
		for (int i = 0; i < 5; i++) {
			rest(&g, 200);
			move(&g, 5);
		}
		assert_int_equal(g.alarms, 0);
	}
}

static void test_values_that_are_constant_from_the_start_are_a_fault_only_with_known_noise(void **state)
{
	struct gyro unknown = gyro_of(1, 1), known = gyro_of(1, 1);

	(void)state;
	known.frozen.noisy = true;
	assert_int_equal(detected_after(&unknown), 0);
	assert_int_equal(detected_after(&known), FROZEN_AT_LEAST);
}

static void test_a_frozen_sensor_has_recovered_with_the_first_other_value(void **state)
{
	struct gyro g = gyro_of(3, 1);

	(void)state;
	rest(&g, 10);
	assert_true(detected_after(&g) > 0);
	g.alarms = 0;
	g.raw[0]++;
	watch(&g);
	assert_int_equal(g.alarms, 0);
}

static void test_a_run_of_equal_values_may_be_ten_times_the_longest_before(void **state)
{
	struct gyro g = {.frozen.noisy = true};

	(void)state;
	for (int i = 0; i < 20; i++)
		watch(&g);
	g.raw[0] = 1;
	for (int i = 0; i < 199; i++)
		watch(&g);
	assert_int_equal(g.alarms, 0);
	watch(&g);
	assert_int_equal(g.alarms, 1);
}

/* The value of one axis for so many samples; the others are the same. True: an alarm with the last. */
static bool hold(struct frozen *f, int axis, double value, unsigned samples)
{
	double raw[AXES] = {7, 7, 7};
	bool alarm = false;

	raw[axis] = value;
	while (samples-- > 0)
		alarm = frozen_watch(f, raw, AXES);
	return alarm;
}

/* One digit, then two at a time: each step ends a stretch. */
static void test_fifty_stretches_show_that_the_noise_exceeds_a_digit(void **state)
{
	(void)state;
	for (int axis = 0; axis < AXES; axis++)
		for (int stretches = 49; stretches <= 50; stretches++) {
			struct frozen f = {.noisy = false};

			hold(&f, axis, -1, 1);
			hold(&f, axis, 0, 1);
			for (int i = 1; i <= stretches; i++)
				hold(&f, axis, 2 * i, 1);
			assert_false(hold(&f, axis, 2 * stretches, 28));
			assert_int_equal(hold(&f, axis, 2 * stretches, 1), stretches == 50);
		}
}

/* The values of a stretch alternate between two digits. */
static void test_a_stretch_of_more_than_fifty_samples_shows_that_it_does_not(void **state)
{
	(void)state;
	for (int samples = 50; samples <= 51; samples++) {
		struct frozen f = {.noisy = false};

		hold(&f, 0, -1, 1);
		for (int i = 0; i <= 50; i++)
			hold(&f, 0, 2 * i, 1);
		for (int i = 1; i < samples; i++)
			hold(&f, 0, 100 + i % 2, 1);
		assert_int_equal(hold(&f, 0, 200, 30), samples == 50);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_frozen_gyro_with_noise_of_a_digit_is_detected_within_a_second),
		cmocka_unit_test(test_at_rest_noise_below_a_digit_is_not_frozen),
		cmocka_unit_test(test_correlated_noise_at_rest_is_not_frozen),
		cmocka_unit_test(test_a_digit_may_be_several_steps_of_the_raw_values),
		cmocka_unit_test(test_a_coarse_gyro_that_was_never_at_rest_raises_at_most_one_false_alarm),
		cmocka_unit_test(test_values_that_are_constant_from_the_start_are_a_fault_only_with_known_noise),
		cmocka_unit_test(test_a_frozen_sensor_has_recovered_with_the_first_other_value),
		cmocka_unit_test(test_fifty_stretches_show_that_the_noise_exceeds_a_digit),
		cmocka_unit_test(test_a_stretch_of_more_than_fifty_samples_shows_that_it_does_not),
		cmocka_unit_test(test_a_run_of_equal_values_may_be_ten_times_the_longest_before),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
