#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdlib.h>

#include "model/sim/sensor.h"
#include "tools/calibrate/allan.h"

enum { N = 200000 };

static double values[N];
static struct allan allan;

static void assert_within(double value, double expected, double share)
{
	if (!(fabs(value - expected) <= share * fabs(expected)))
		fail_msg("%g, expected %g within %g %%", value, expected, 100 * share);
}

static void test_a_constant_value_has_no_deviation(void **state)
{
	(void)state;
	for (int k = 0; k < N; k++)
		values[k] = 9.81;
	allan_deviation(values, N, 100, &allan);
	for (int i = 0; i < allan.count; i++)
		assert_true(allan.points[i].deviation < 1e-9);
}

/* x = c t: neighbouring means differ by c tau, so sigma = c tau / sqrt(2). */
static void test_a_ramp_deviates_by_its_slope_times_tau_over_root_two(void **state)
{
	(void)state;
	for (int k = 0; k < N; k++)
		values[k] = 0.3 * k / 100;
	allan_deviation(values, N, 100, &allan);
	for (int i = 0; i < allan.count; i++)
		assert_within(allan.points[i].deviation, 0.3 * allan.points[i].tau_s / sqrt(2), 1e-6);
}

/* +1, -1, +1, ..: single values differ by 2, means of pairs by 0. */
static void test_alternating_values_average_out_in_pairs(void **state)
{
	(void)state;
	for (int k = 0; k < N; k++)
		values[k] = k % 2 ? -1 : 1;
	allan_deviation(values, N, 1, &allan);
	assert_within(allan.points[0].deviation, sqrt(2), 1e-9);
	assert_true(allan.points[1].tau_s == 2 && allan.points[1].deviation < 1e-9);
}

static void test_the_deviation_of_white_noise_falls_with_the_root_of_tau_within_its_stated_error(void **state)
{
	struct rng rng;

	(void)state;
	rng_init(&rng, 5);
	for (int k = 0; k < N; k++)
		values[k] = rng_gauss(&rng);
	allan_deviation(values, N, 50, &allan);
	for (int i = 0; i < allan.count; i++)
		assert_within(allan.points[i].deviation, 1 / sqrt(50 * allan.points[i].tau_s),
			3.5 * allan.points[i].relative_error);
}

static void test_there_are_ten_averaging_times_per_decade_up_to_a_ninth_of_the_log(void **state)
{
	(void)state;
	allan_deviation(values, 90000, 100, &allan);
	assert_true(allan.points[0].tau_s == 0.01);
	assert_true(allan.points[allan.count - 1].tau_s == 100);
	for (int i = 1; i < allan.count; i++)
		assert_true(allan.points[i].tau_s > allan.points[i - 1].tau_s);
}

/* Over a gap the sensor's bias may have changed: here by a hundred times the noise. */
static void test_the_parts_of_a_record_with_gaps_count_and_the_gaps_do_not(void **state)
{
	const size_t starts[] = {0, 50000, 120000};
	struct allan whole;
	struct rng rng;

	(void)state;
	rng_init(&rng, 7);
	for (int k = 0; k < N; k++)
		values[k] = rng_gauss(&rng);
	allan_deviation(values, N, 100, &whole);
	rng_init(&rng, 7);
	for (int k = 0; k < N; k++)
		values[k] = rng_gauss(&rng) + (k < 50000 ? 100 : k < 120000 ? -100 : 0);
	allan_deviation_of_parts(values, N, starts, 3, 100, &allan);
	assert_in_range(allan.count, whole.count - 3, whole.count);
	for (int i = 0; i < allan.count; i++) {
		assert_within(allan.points[i].deviation, 1 / sqrt(100 * allan.points[i].tau_s),
			3.5 * allan.points[i].relative_error);
		assert_true(allan.points[i].relative_error >= whole.points[i].relative_error);
	}
}

/* The same white noise and bias instability: an hour shows both, a minute only the noise. */
static void test_a_term_that_the_record_is_too_short_for_is_left_out(void **state)
{
	const struct allan_noise given = {0, 0.02, 0.01, 0};

	(void)state;
	for (int minutes = 1; minutes <= 60; minutes *= 60) {
		struct allan_noise fit, observed;

		allan.count = 0;
		for (double tau_s = 0.01; tau_s < minutes * 60 / 9; tau_s *= 1.26)
			allan.points[allan.count++] = (struct allan_point){
				tau_s, allan_model(&given, tau_s), 1 / sqrt(2 * (minutes * 60 / tau_s - 1))};
		fit = allan_fit(&allan);
		observed = allan_observed(&allan, &fit);
		assert_within(observed.white, given.white, 1e-6);
		if (minutes == 1)
			assert_true(observed.bias_instability == 0);
		else
			assert_within(observed.bias_instability, given.bias_instability, 1e-6);
	}
}

static void fit_of(const struct allan_noise *noise, struct allan_noise *fit)
{
	allan.count = 0;
	for (double tau_s = 0.01; tau_s < 2000; tau_s *= 1.3)
		allan.points[allan.count++] = (struct allan_point){tau_s, allan_model(noise, tau_s), 0.01};
	*fit = allan_fit(&allan);
}

static void test_the_fit_finds_the_noise_of_an_exact_curve(void **state)
{
	const struct allan_noise noise = {1e-4, 0.02, 0.01, 3e-4};
	struct allan_noise fit;

	(void)state;
	fit_of(&noise, &fit);
	assert_within(fit.quantisation, noise.quantisation, 1e-6);
	assert_within(fit.white, noise.white, 1e-6);
	assert_within(fit.bias_instability, noise.bias_instability, 1e-6);
	assert_within(fit.random_walk, noise.random_walk, 1e-6);
}

static void test_the_fit_gives_0_for_absent_noise(void **state)
{
	const struct allan_noise noise = {0, 0.02, 0, 0};
	struct allan_noise fit;

	(void)state;
	fit_of(&noise, &fit);
	assert_within(fit.white, noise.white, 1e-6);
	assert_true(fit.quantisation < 1e-8 && fit.bias_instability < 1e-6 && fit.random_walk < 1e-7);
}

static void test_without_noise_all_terms_are_0(void **state)
{
	struct allan_noise fit;

	(void)state;
	for (int k = 0; k < N; k++)
		values[k] = 0;
	allan_deviation(values, N, 100, &allan);
	fit = allan_fit(&allan);
	assert_true(fit.white == 0 && fit.bias_instability == 0 && fit.random_walk == 0 && fit.quantisation == 0);
}

/* Curve and identified noise of a simulated gyro at rest are those of its configuration. */
static void test_the_noise_of_a_simulated_gyro_is_identified_from_six_hours(void **state)
{
	struct sensor_config config = *sensor_preset("lsm303dlhc_l3gd20_fine");
	const struct triad_errors *gyro = &config.gyro;
	const struct allan_noise given = {0, gyro->density / sqrt(2), gyro->bias_instability, gyro->random_walk};
	const size_t count = 6 * 3600 * 20;
	double *x = malloc(count * sizeof *x);
	struct imu_sample sample;
	struct allan_noise found;
	struct sensor sensor;

	(void)state;
	config.rate_hz = 20;
	sensor_calibrate(&config);
	assert_int_equal(sensor_init(&sensor, &config, 2), 0);
	for (size_t k = 0; k < count; k++) {
		sensor_next(&sensor, signal_find("rest"), &sample, NULL);
		x[k] = sample.gyro_rad_s.z;
	}
	allan_deviation(x, count, 20, &allan);
	free(x);
	for (int i = 0; i < allan.count; i++) /* 8 %: five processes approximate flicker noise */
		assert_within(allan.points[i].deviation, allan_model(&given, allan.points[i].tau_s),
			0.08 + 3 * allan.points[i].relative_error);
	found = allan_fit(&allan);
	assert_within(allan_density(&found), gyro->density, 0.1);
	assert_within(found.bias_instability, gyro->bias_instability, 0.3);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_constant_value_has_no_deviation),
		cmocka_unit_test(test_a_ramp_deviates_by_its_slope_times_tau_over_root_two),
		cmocka_unit_test(test_alternating_values_average_out_in_pairs),
		cmocka_unit_test(test_the_deviation_of_white_noise_falls_with_the_root_of_tau_within_its_stated_error),
		cmocka_unit_test(test_there_are_ten_averaging_times_per_decade_up_to_a_ninth_of_the_log),
		cmocka_unit_test(test_the_parts_of_a_record_with_gaps_count_and_the_gaps_do_not),
		cmocka_unit_test(test_a_term_that_the_record_is_too_short_for_is_left_out),
		cmocka_unit_test(test_the_fit_finds_the_noise_of_an_exact_curve),
		cmocka_unit_test(test_the_fit_gives_0_for_absent_noise),
		cmocka_unit_test(test_without_noise_all_terms_are_0),
		cmocka_unit_test(test_the_noise_of_a_simulated_gyro_is_identified_from_six_hours),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
