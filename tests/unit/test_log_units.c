/* Units of a log that its header does not name (drivers/imu/log_units.h): which magnitudes are taken for which unit,
 * and which values for the end of a range. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "drivers/imu/log_units.h"
#include "model/sim/rng.h"

static const double DEG = 3.14159265358979323846 / 180, G = 9.80665;

enum { GYRO, ACCEL, MAG };

static void assert_unit(const struct log_units *u, int sensor, const char *word, double value)
{
	char text[200] = "";
	bool warns = log_units_warning(u, sensor, text, sizeof text);

	if (warns != (word != NULL) || (word && !strstr(text, word)))
		fail_msg("sensor %d, %g: '%s' does not say '%s'", sensor, value, text, word ? word : "nothing");
}

/* A hundred samples of this force and this field; each direction is as good as any other. */
static struct log_units of_magnitude(double force, double field)
{
	struct log_units u = {0};

	for (int k = 0; k < 100; k++) {
		struct imu_sample s = {.t_us = (uint64_t)(k * 10000), .flags = SAMPLE_MAG};

		s.accel_m_s2 = (struct vec3){0.6 * force, 0, k % 2 ? 0.8 * force : -0.8 * force};
		s.mag_uT = (struct vec3){0.48 * field, -0.64 * field, k % 2 ? 0.6 * field : -0.6 * field};
		log_units_add(&u, &s);
	}
	return u;
}

/* The documented limits of each unit, from just inside to just outside. */
static void test_the_magnitude_of_gravity_tells_the_unit_of_the_force(void **state)
{
	static const struct {
		double force;
		const char *unit;
	} at[] = {{0.39, "other units"}, {0.41, "in g,"}, {1, "in g,"}, {2.49, "in g,"}, {2.51, NULL}, {3.89, NULL},
		{3.91, NULL}, {9.81, NULL}, {24.9, NULL}, {399, NULL}, {401, "in mg,"}, {2499, "in mg,"},
		{2501, "digits"}, {1e6, "digits"}, {1e-9, "other units"}};

	(void)state;
	for (size_t i = 0; i < sizeof at / sizeof *at; i++) {
		struct log_units u = of_magnitude(at[i].force, 40);

		assert_unit(&u, ACCEL, at[i].unit, at[i].force);
	}
}

static void test_the_magnitude_of_the_field_of_the_earth_tells_its_unit(void **state)
{
	static const struct {
		double field;
		const char *unit;
	} at[] = {{4.9, NULL}, {5.1, NULL}, {40, NULL}, {189, NULL}, {191, "in mG,"}, {999, "in mG,"}, {1001, NULL},
		{0.149, NULL}, {0.151, "in gauss,"}, {1.19, "in gauss,"}, {1.21, NULL}, {1.49e4, NULL},
		{1.51e4, "in nT,"}, {1.19e5, "in nT,"}, {1.21e5, NULL}, {0.99e-5, NULL}, {1.01e-5, "in T,"},
		{1.19e-4, "in T,"}, {1.21e-4, NULL}};

	(void)state;
	for (size_t i = 0; i < sizeof at / sizeof *at; i++) {
		struct log_units u = of_magnitude(9.81, at[i].field);

		assert_unit(&u, MAG, at[i].unit, at[i].field);
	}
}

static void test_more_than_half_of_the_values_tell_the_unit(void **state)
{
	struct log_units u = {0};

	(void)state;
	for (int k = 0; k < 100; k++) {
		struct imu_sample s = {.t_us = (uint64_t)(k * 10000), .accel_m_s2 = {0, 0, k < 50 ? 1 : 3}};

		log_units_add(&u, &s);
	}
	assert_unit(&u, ACCEL, NULL, 50);
	log_units_add(&u, &(struct imu_sample){.t_us = 1000000, .accel_m_s2 = {0, 0, 1}});
	assert_unit(&u, ACCEL, "in g,", 51);
	assert_unit(&u, MAG, NULL, 0);
}

/* A row without a field says nothing of its unit. */
static void test_of_few_fields_more_than_half_tell_the_unit(void **state)
{
	struct log_units u = {0};

	(void)state;
	for (int k = 0; k < 100; k++) {
		struct imu_sample s = {.t_us = (uint64_t)(k * 10000), .accel_m_s2 = {0, 0, 9.81}};

		if (k % 10 == 0) {
			s.mag_uT.x = 0.5;
			s.flags = SAMPLE_MAG;
		}
		log_units_add(&u, &s);
	}
	assert_unit(&u, MAG, "in gauss,", 0.5);
}

static void test_a_rate_that_no_gyro_measures_is_told(void **state)
{
	static const struct vec3 rates[] = {{69, 0, 0}, {71, 0, 0}, {0, -71, 0}, {0, 0, 71}, {0, -69, 69}};

	(void)state;
	for (int i = 0; i < 5; i++) {
		struct log_units u = {0};

		log_units_add(&u, &(struct imu_sample){.accel_m_s2 = {0, 0, 9.81}, .gyro_rad_s = rates[i]});
		assert_unit(&u, GYRO, i % 4 ? "up to 71 rad/s" : NULL, i);
	}
}

/* At rest, `n` steps, each axis with noise of these RMS values; the force in units of gravity. */
static struct log_units resting(int n, double rate_rms, double force_rms)
{
	struct log_units u = {0};
	struct rng rng;

	rng_init(&rng, 1);
	for (int k = 0; k <= n; k++) {
		struct imu_sample s = {.t_us = (uint64_t)(k * 10000)};

		s.gyro_rad_s = (struct vec3){
			rate_rms * rng_gauss(&rng), rate_rms * rng_gauss(&rng), rate_rms * rng_gauss(&rng)};
		s.accel_m_s2 = (struct vec3){G * force_rms * rng_gauss(&rng), G * force_rms * rng_gauss(&rng),
			G * (1 + force_rms * rng_gauss(&rng))};
		log_units_add(&u, &s);
	}
	return u;
}

/* Of a hundred steps or more: a gyro at rest has less than 0.03 rad/s of noise, and it is at rest if the force has less
 * than 0.01 of gravity. */
static void test_the_noise_at_rest_tells_degrees(void **state)
{
	static const struct {
		int steps;
		double rate, force;
		const char *word;
	} at[] = {{5000, 0.031, 0.002, "deg/s"}, {5000, 0.029, 0.002, NULL}, {5000, 0.05, 0.0095, "deg/s"},
		{5000, 0.05, 0.0105, NULL}, {5000, 0.05, 0.02, NULL}, {100, 0.05, 0.002, "deg/s"},
		{99, 0.05, 0.002, NULL}};

	(void)state;
	for (size_t i = 0; i < sizeof at / sizeof *at; i++) {
		struct log_units u = resting(at[i].steps, at[i].rate, at[i].force);

		assert_unit(&u, GYRO, at[i].word, (double)i);
	}
}

/* Turns about x by sine, of this amplitude, for `windows` of 0.2 s and a bit, five a turn. The rates are multiplied by
 * `scale`. */
static struct log_units rocking(int windows, double amplitude_rad, double scale, double dt_s)
{
	struct log_units u = {0};
	int per_window = dt_s < 0.2 ? (int)ceil(0.2 / dt_s) : 1;

	for (int k = 0; k <= windows * per_window; k++) {
		double t = k * dt_s, w = 2 * 3.14159265358979323846 / (5 * per_window * dt_s),
		       angle = amplitude_rad * sin(w * t);
		struct imu_sample s = {.t_us = (uint64_t)(k * dt_s * 1e6 + 0.5),
			/* the mean rate of the interval before */
			.gyro_rad_s = {scale * (angle - amplitude_rad * sin(w * (t - dt_s))) / dt_s, 0, 0},
			.accel_m_s2 = {0, G * sin(angle), G * cos(angle)}};

		log_units_add(&u, &s);
	}
	return u;
}

/* In ten windows of 0.2 s and more in which gravity turns by 0.02 rad or more. */
static void test_gravity_that_turns_tells_degrees(void **state)
{
	struct log_units u;

	(void)state;
	u = rocking(50, 0.15, 1, 0.0101);
	assert_unit(&u, GYRO, NULL, 1);
	u = rocking(50, 0.15, 1 / DEG, 0.0101);
	assert_unit(&u, GYRO, "deg/s", 2);
	/* below 100 steps the noise tells nothing */
	u = rocking(10, 0.15, 1 / DEG, 0.042);
	assert_unit(&u, GYRO, "deg/s", 3);
	u = rocking(9, 0.15, 1 / DEG, 0.042);
	assert_unit(&u, GYRO, NULL, 4);
	/* gravity turns by 0.83 of the amplitude, the RMS of five windows a turn */
	u = rocking(15, 0.0235, 1 / DEG, 0.042);
	assert_unit(&u, GYRO, NULL, 5);
	u = rocking(15, 0.0246, 1 / DEG, 0.042);
	assert_unit(&u, GYRO, "deg/s", 6);
}

/* In a window they turn by a whole turn more when they are taken for rad/s: both units fit what gravity does. */
static void test_rates_that_fit_in_both_units_are_left(void **state)
{
	const double window_s = 0.2, turn_rad = 2 * 3.14159265358979323846 / (1 / DEG - 1), rate = turn_rad / window_s;
	struct log_units u = {0};

	(void)state;
	for (int k = 0; k <= 50 * 20; k++) {
		/* with errors that differ from window to window */
		double angle = -rate * k * 0.01 + 0.01 * (k / 20 % 3 - 1);
		struct imu_sample s = {.t_us = (uint64_t)(k * 10000),
			.gyro_rad_s = {rate / DEG, 0, 0},
			.accel_m_s2 = {0, -G * sin(angle), G * cos(angle)}};

		log_units_add(&u, &s);
	}
	assert_true(u.windows >= 45);
	assert_true(rate / DEG < 70);
	assert_unit(&u, GYRO, NULL, rate / DEG);
}

/* From one sample to the next half a second: nothing is known of the turn. */
static void test_samples_half_a_second_apart_tell_nothing_of_the_rate(void **state)
{
	struct log_units u;

	(void)state;
	u = rocking(40, 0.15, 1 / DEG, 0.49);
	assert_true(u.steps > 35);
	u = rocking(40, 0.15, 1 / DEG, 0.51);
	assert_int_equal(u.steps, 0);
	assert_unit(&u, GYRO, NULL, 0);
}

/* Rates that are neither: of another scale, or of other axes than those of the force. */
static void test_rates_that_fit_in_no_unit_are_left(void **state)
{
	struct log_units u;

	(void)state;
	u = rocking(50, 0.15, -1 / DEG, 0.0101);
	assert_unit(&u, GYRO, NULL, 1);
	u = rocking(50, 0.15, 0.2 / DEG, 0.0101);
	assert_unit(&u, GYRO, NULL, 2);
	u = rocking(50, 0.15, 0.6 / DEG, 0.0101);
	assert_unit(&u, GYRO, "deg/s", 3);
}

/* ---- the end of a range ------------------------------------------------------------------------------------------ */

static struct imu_sample with(int axis, double value)
{
	struct imu_sample s = {.accel_m_s2 = {0, 0, 0}};
	double *values[] = {
		&s.gyro_rad_s.x, &s.gyro_rad_s.y, &s.gyro_rad_s.z, &s.accel_m_s2.x, &s.accel_m_s2.y, &s.accel_m_s2.z};

	*values[axis] = value;
	return s;
}

/* Whether the middle one of five samples counts as clipped. `same`: a bit for each that has the value, first to
 * last. */
static bool clipped(int axis, double value, double most, unsigned same)
{
	struct log_units u = {0};
	struct imu_sample samples[5];
	const struct imu_sample *five[5];

	for (int i = 0; i < 5; i++) {
		samples[i] = with(axis, same >> i & 1 ? value : 0.9 * value);
		five[i] = &samples[i];
	}
	u.gyro_most_rad_s = axis < 3 ? most : 0;
	u.accel_most_m_s2 = axis < 3 ? 0 : most;
	return log_units_clipped(&u, five);
}

static void test_the_ends_of_usual_ranges_are_clipped_on_every_axis(void **state)
{
	/* 32767 digits of 3.8 to 70 mdps, 0.061 to 0.732 mg, and the nominal values */
	static const double gyro_dps[] = {125, 245, 250, 500, 1000, 2000, 4000, 286.71, 573.42, 1146.8, 2293.7,
		32767 / 262.4, 32767 / 131.2, 32767 / 65.6, 32767 / 32.8, 32767 / 16.4, /* BMI160, LSB a deg/s */
		32767 / 262.0, 32767 / 131.0, 32767 / 65.5, 32767 / 32.8, 32767 / 16.4 /* MPU-6050 */};
	static const double accel_g[] = {
		2, 4, 8, 16, 24, 32, 32767 * 0.061e-3, 32767 * 0.122e-3, 32767 * 0.244e-3, 32767 * 0.488e-3};

	(void)state;
	for (int axis = 0; axis < 6; axis++)
		for (int sign = -1; sign <= 1; sign += 2)
			for (size_t i = 0;
				i < (axis < 3 ? sizeof gyro_dps / sizeof *gyro_dps : sizeof accel_g / sizeof *accel_g);
				i++) {
				double value = axis < 3 ? gyro_dps[i] * DEG : accel_g[i] * G;

				if (!clipped(axis, sign * value, value, 0x1F))
					fail_msg("axis %d: %g is not clipped", axis, value);
				/* 0.001 of it away there is no end, and a larger value was measured */
				assert_false(clipped(axis, sign * 0.997 * value, 0.997 * value, 0x1F) && i < 6);
				assert_false(clipped(axis, sign * value, 1.001 * value, 0x1F));
			}
}

static void test_the_printed_digits_of_an_end_may_be_few(void **state)
{
	(void)state;
	assert_true(clipped(2, 4000 * DEG * (1 + 2.9e-4), 4000 * DEG, 0x1F));
	assert_false(clipped(2, 4000 * DEG * (1 + 3.1e-4), 4000 * DEG, 0x1F));
	assert_false(clipped(2, 4000 * DEG * (1 - 3.1e-4), 0, 0x1F));
	assert_true(clipped(2, 4000 * DEG * (1 - 2.9e-4), 0, 0x1F));
}

static void test_three_in_a_row_with_the_middle_one_are_clipped(void **state)
{
	(void)state;
	for (unsigned same = 0; same < 32; same++) {
		bool three = (same & 0x07) == 0x07 || (same & 0x0E) == 0x0E || (same & 0x1C) == 0x1C;

		assert_int_equal(clipped(0, 4000 * DEG, 4000 * DEG, same), three);
	}
}

static void test_at_the_ends_of_a_log_samples_are_missing(void **state)
{
	const struct imu_sample full = with(4, -8 * G);
	struct log_units u = {.accel_most_m_s2 = 8 * G};

	(void)state;
	assert_true(log_units_clipped(&u, (const struct imu_sample *const[5]){NULL, NULL, &full, &full, &full}));
	assert_true(log_units_clipped(&u, (const struct imu_sample *const[5]){&full, &full, &full, NULL, NULL}));
	assert_true(log_units_clipped(&u, (const struct imu_sample *const[5]){NULL, &full, &full, &full, NULL}));
	assert_false(log_units_clipped(&u, (const struct imu_sample *const[5]){NULL, NULL, &full, &full, NULL}));
	assert_false(log_units_clipped(&u, (const struct imu_sample *const[5]){NULL, &full, &full, NULL, NULL}));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_magnitude_of_gravity_tells_the_unit_of_the_force),
		cmocka_unit_test(test_the_magnitude_of_the_field_of_the_earth_tells_its_unit),
		cmocka_unit_test(test_more_than_half_of_the_values_tell_the_unit),
		cmocka_unit_test(test_of_few_fields_more_than_half_tell_the_unit),
		cmocka_unit_test(test_a_rate_that_no_gyro_measures_is_told),
		cmocka_unit_test(test_the_noise_at_rest_tells_degrees),
		cmocka_unit_test(test_gravity_that_turns_tells_degrees),
		cmocka_unit_test(test_samples_half_a_second_apart_tell_nothing_of_the_rate),
		cmocka_unit_test(test_rates_that_fit_in_both_units_are_left),
		cmocka_unit_test(test_rates_that_fit_in_no_unit_are_left),
		cmocka_unit_test(test_the_ends_of_usual_ranges_are_clipped_on_every_axis),
		cmocka_unit_test(test_the_printed_digits_of_an_end_may_be_few),
		cmocka_unit_test(test_three_in_a_row_with_the_middle_one_are_clipped),
		cmocka_unit_test(test_at_the_ends_of_a_log_samples_are_missing),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
