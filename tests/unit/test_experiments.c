/* The claims of tools/experiments/REPORT.md, at the noise levels of the paper. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdlib.h>

#include "tools/experiments/methods.h"
#include "model/math/units.h"

static const double NOISE_DEG[] = {0.02, 0.05, 0.1, 0.2, 0.3, 0.7, 2.0};
enum { NOISES = sizeof NOISE_DEG / sizeof *NOISE_DEG };

static double rms(const struct trial_config *config, enum method method, double noise_deg)
{
	struct vec3 *estimate;
	struct trial trial;
	double error;

	assert_int_equal(trial_make(&trial, config), 0);
	estimate = calloc((size_t)trial.count, sizeof *estimate);
	method_run(method, &trial, noise_deg * RAD_PER_DEG, estimate);
	error = method_score(&trial, estimate).rms_m_s2;
	free(estimate);
	trial_free(&trial);
	return error;
}

static void test_in_the_world_of_the_paper_the_gyro_at_2_degrees_beats_eq12_at_0_02_degrees(void **state)
{
	(void)state;
	for (uint64_t seed = 1; seed <= 3; seed++)
		for (int signal = 0; signal < TRIAL_SIGNALS; signal++) {
			struct trial_config config = trial_defaults(WORLD_SEED, TRIAL_SIGNAL_NAMES[signal]);

			config.seed = seed;
			assert_true(rms(&config, METHOD_SEED_GYRO, 2) < rms(&config, METHOD_SEED, 0.02));
		}
}

static void test_in_the_physical_world_the_rigid_body_at_2_degrees_beats_eq12_at_0_02_degrees(void **state)
{
	(void)state;
	for (uint64_t seed = 1; seed <= 3; seed++)
		for (int signal = 0; signal < TRIAL_SIGNALS; signal++) {
			struct trial_config config = trial_defaults(WORLD_PHYSICAL, TRIAL_SIGNAL_NAMES[signal]);

			config.seed = seed;
			assert_true(rms(&config, METHOD_RIGID_GYRO, 2) < 0.2 * rms(&config, METHOD_SEED, 0.02));
		}
}

static void test_auto_is_at_most_5_percent_worse_than_the_better_of_none_and_rigid_at_every_angle_noise(void **state)
{
	(void)state;
	for (int world = 0; world < WORLDS; world++)
		for (int signal = 0; signal < TRIAL_SIGNALS; signal++)
			for (int i = 0; i < NOISES; i++) {
				const struct trial_config config =
					trial_defaults((enum world)world, TRIAL_SIGNAL_NAMES[signal]);
				double none = rms(&config, METHOD_NONE, NOISE_DEG[i]);
				double rigid = rms(&config, METHOD_RIGID_GYRO, NOISE_DEG[i]);

				assert_true(rms(&config, METHOD_AUTO, NOISE_DEG[i]) < 1.05 * fmin(none, rigid));
			}
}

/* At the gyro noise at which none and rigid have the same error. */
static void test_auto_beats_none_and_rigid_where_they_are_equal(void **state)
{
	(void)state;
	for (int signal = 0; signal < TRIAL_SIGNALS; signal++) {
		struct trial_config config = trial_defaults(WORLD_PHYSICAL, TRIAL_SIGNAL_NAMES[signal]);
		double none = rms(&config, METHOD_NONE, 0.05);

		while (rms(&config, METHOD_RIGID_GYRO, 0.05) < none)
			config.gyro_noise_scale *= 1.3;
		while (rms(&config, METHOD_RIGID_GYRO, 0.05) > none)
			config.gyro_noise_scale /= 1.1;
		assert_true(rms(&config, METHOD_AUTO, 0.05) < 0.85 * rms(&config, METHOD_RIGID_GYRO, 0.05));
	}
}

/* Without noise, (12) removes exactly what (9) adds. */
static void test_in_the_world_of_the_paper_eq12_is_exact_without_noise(void **state)
{
	(void)state;
	for (int signal = 0; signal < TRIAL_SIGNALS; signal++) {
		struct trial_config config = trial_defaults(WORLD_SEED, TRIAL_SIGNAL_NAMES[signal]);

		config.force_sigma_m_s2 = 0;
		assert_true(rms(&config, METHOD_SEED, 0) < 1e-9);
	}
}

static void test_the_fir_of_the_paper_keeps_a_constant_and_does_not_delay_a_pulse(void **state)
{
	struct vec3 values[101];

	(void)state;
	for (int k = 0; k < 101; k++)
		values[k] = (struct vec3){k == 50, 3, 0};
	seed_fir(values, 101, 50);
	for (int k = 1; k <= 20; k++)
		assert_true(fabs(values[50 - k].x - values[50 + k].x) < 1e-15 && values[50].x > values[50 + k].x);
	for (int k = 0; k < 101; k++)
		assert_true(fabs(values[k].y - 3) < 1e-12);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_in_the_world_of_the_paper_the_gyro_at_2_degrees_beats_eq12_at_0_02_degrees),
		cmocka_unit_test(test_in_the_physical_world_the_rigid_body_at_2_degrees_beats_eq12_at_0_02_degrees),
		cmocka_unit_test(
			test_auto_is_at_most_5_percent_worse_than_the_better_of_none_and_rigid_at_every_angle_noise),
		cmocka_unit_test(test_auto_beats_none_and_rigid_where_they_are_equal),
		cmocka_unit_test(test_in_the_world_of_the_paper_eq12_is_exact_without_noise),
		cmocka_unit_test(test_the_fir_of_the_paper_keeps_a_constant_and_does_not_delay_a_pulse),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
