#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>

#include "model/auto_correction.h"
#include "model/sim/rng.h"

enum { N = 100000 };
static const double RATE_HZ = 100;
static const struct filter_config FILTER = {FILTER_BUTTERWORTH, 2, 30};
static const struct noise_config NOISE = {.angle_sigma_rad = 1e-3, .gyro_density_rad_s_sqrt_hz = 5e-4};

static struct vec3 gauss3(struct rng *rng, double sigma)
{
	double x = rng_gauss(rng), y = rng_gauss(rng), z = rng_gauss(rng);

	return vec3_scale(sigma, (struct vec3){x, y, z});
}

static void assert_within(double value, double expected, double share)
{
	if (!(fabs(value - expected) <= share * fabs(expected)))
		fail_msg("%g, expected %g within %g %%", value, expected, 100 * share);
}

static void test_the_calculated_noise_of_the_gyros_rates_is_that_of_a_simulation(void **state)
{
	struct rates_variance expected = rates_variance(&NOISE, RATES_FROM_GYRO, &FILTER, RATE_HZ);
	double omega = 0, alpha = 0;
	struct rates rates;
	struct rng rng;

	(void)state;
	rng_init(&rng, 1);
	assert_int_equal(rates_init(&rates, &FILTER, RATE_HZ), 0);
	rates_prime(&rates, (struct vec3){0, 0, 0}, QUAT_IDENTITY);
	for (int k = 0; k < N; k++) {
		const struct body_rates *out = &rates.out[RATES_FROM_GYRO];

		rates_step(&rates, gauss3(&rng, 5e-4 * sqrt(RATE_HZ / 2)), QUAT_IDENTITY, 1 / RATE_HZ);
		omega += vec3_dot(out->omega_b_rad_s, out->omega_b_rad_s) / 3 / N;
		alpha += vec3_dot(out->alpha_b_rad_s2, out->alpha_b_rad_s2) / 3 / N;
	}
	assert_within(expected.omega, omega, 0.02);
	assert_within(expected.alpha, alpha, 0.02);
}

static void test_the_calculated_noise_of_rates_from_angles_is_that_of_a_simulation(void **state)
{
	struct rates_variance expected = rates_variance(&NOISE, RATES_FROM_ANGLES, &FILTER, RATE_HZ);
	double omega = 0, alpha = 0;
	struct rates rates;
	struct rng rng;

	(void)state;
	rng_init(&rng, 1);
	assert_int_equal(rates_init(&rates, &FILTER, RATE_HZ), 0);
	rates_prime(&rates, (struct vec3){0, 0, 0}, QUAT_IDENTITY);
	for (int k = 0; k < N; k++) {
		const struct body_rates *out = &rates.out[RATES_FROM_ANGLES];

		rates_step(&rates, (struct vec3){0, 0, 0}, quat_from_rotation_vector(gauss3(&rng, 1e-3)), 1 / RATE_HZ);
		omega += vec3_dot(out->omega_b_rad_s, out->omega_b_rad_s) / 3 / N;
		alpha += vec3_dot(out->alpha_b_rad_s2, out->alpha_b_rad_s2) / 3 / N;
	}
	assert_within(expected.omega, omega, 0.03);
	assert_within(expected.alpha, alpha, 0.03);
}

static void add_squares(struct vec3 *sum, struct vec3 v)
{
	*sum = vec3_add(*sum, vec3_scale(1.0 / N, (struct vec3){v.x * v.x, v.y * v.y, v.z * v.z}));
}

static void assert_within3(struct vec3 value, struct vec3 expected)
{
	assert_within(value.x, expected.x, 0.03);
	assert_within(value.y, expected.y, 0.03);
	assert_within(value.z, expected.z, 0.03);
}

static void test_the_calculated_variance_of_the_rigid_bodys_correction_is_that_of_a_simulation(void **state)
{
	const struct vec3 w = {3, -2, 5}, alpha = {20, 10, -5}, r = {0.02, 0.05, -0.1};
	const struct rates_variance variance = {0.01 * 0.01, 0.2 * 0.2};
	struct vec3 true_c = rigid_lever_arm(w, alpha, r), sum = {0, 0, 0};
	struct rng rng;

	(void)state;
	rng_init(&rng, 1);
	for (int k = 0; k < N; k++) {
		struct vec3 noisy_w = vec3_add(w, gauss3(&rng, 0.01)), noisy_alpha = vec3_add(alpha, gauss3(&rng, 0.2));

		add_squares(&sum, vec3_sub(rigid_lever_arm(noisy_w, noisy_alpha, r), true_c));
	}
	assert_within3(rigid_lever_arm_variance(w, r, variance), sum);
}

static void test_the_calculated_variance_of_the_seeds_correction_is_that_of_a_simulation(void **state)
{
	const struct seed_motion motion = {.rates_rad_s = {3, -2, 5}, .accels_rad_s2 = {20, 10, -5}};
	const struct vec3 r = {0.02, 0.05, -0.1};
	const struct rates_variance variance = {0.01 * 0.01, 0.2 * 0.2};
	struct vec3 true_c = seed_lever_arm(&motion, r), sum = {0, 0, 0};
	struct rng rng;

	(void)state;
	rng_init(&rng, 1);
	for (int k = 0; k < N; k++) {
		struct seed_motion noisy = motion;

		noisy.rates_rad_s = vec3_add(motion.rates_rad_s, gauss3(&rng, 0.01));
		noisy.accels_rad_s2 = vec3_add(motion.accels_rad_s2, gauss3(&rng, 0.2));
		add_squares(&sum, vec3_sub(seed_lever_arm(&noisy, r), true_c));
	}
	assert_within3(seed_lever_arm_variance(&motion, r, variance), sum);
}

/* RMS error of the output for true corrections of this 1 sigma, measured with white noise of 1 sigma 1. */
static double error_behind_noise(double size)
{
	struct auto_correction automatic = {{0}};
	const struct vec3 variance = {1, 1, 1};
	double sum = 0;
	struct rng rng;

	rng_init(&rng, 3);
	for (int k = 0; k < N; k++) {
		struct vec3 truth = gauss3(&rng, size), measured = vec3_add(truth, gauss3(&rng, 1));
		struct vec3 error = vec3_sub(auto_correction_step(&automatic, measured, variance, 0.01), truth);

		sum += vec3_dot(error, error) / 3 / N;
	}
	return sqrt(sum);
}

static void test_noise_alone_gives_no_correction(void **state)
{
	(void)state;
	assert_true(error_behind_noise(0) < 0.01);
}

static void test_a_correction_far_above_its_noise_is_applied_in_full(void **state)
{
	(void)state;
	assert_true(error_behind_noise(100) < 1.001);
}

static void test_the_error_never_exceeds_that_of_the_full_or_of_no_correction(void **state)
{
	(void)state;
	for (double size = 0.1; size < 100; size *= 1.3)
		assert_true(error_behind_noise(size) < 1.02 * fmin(size, 1));
}

static void test_the_error_is_below_both_where_correction_and_noise_are_alike(void **state)
{
	(void)state;
	assert_true(error_behind_noise(1.3) < 0.85);
}

static void test_a_sudden_large_correction_is_applied_at_once(void **state)
{
	struct auto_correction automatic = {{0}};
	const struct vec3 variance = {1, 1, 1};
	struct vec3 out;

	(void)state;
	for (int k = 0; k < 1000; k++)
		auto_correction_step(&automatic, (struct vec3){0.1, 0.1, 0.1}, variance, 0.01);
	out = auto_correction_step(&automatic, (struct vec3){10, 0.1, 0.1}, variance, 0.01);
	assert_true(out.x > 9.8 && out.y == 0 && out.z == 0);
}

static void test_without_noise_the_correction_is_applied_in_full(void **state)
{
	struct auto_correction automatic = {{0}};
	struct vec3 out = auto_correction_step(&automatic, (struct vec3){1e-9, -2, 0}, (struct vec3){0, 0, 0}, 0.01);

	(void)state;
	assert_true(out.x == 1e-9 && out.y == -2 && out.z == 0);
}

/* 6.04 sigma squared are 36.5. */
static void test_a_single_correction_counts_at_once_from_six_sigma_on(void **state)
{
	const struct vec3 variance = {4, 9, 16};
	struct auto_correction automatic = {{0}};
	struct vec3 out =
		auto_correction_step(&automatic, (struct vec3){2 * 6.04, -3 * 5.96, 4 * 6.04}, variance, 1e-9);

	(void)state;
	assert_true(fabs(out.x - 2 * (6.04 - 1 / 6.04)) < 1e-9);
	assert_true(out.y == 0);
	assert_true(fabs(out.z - 4 * (6.04 - 1 / 6.04)) < 1e-9);
}

static void test_a_lasting_correction_counts_when_its_power_is_twice_that_of_the_noise(void **state)
{
	const struct vec3 variance = {1, 1, 1}, correction = {sqrt(1.99), sqrt(2.01), -sqrt(5)};
	struct auto_correction automatic = {{0}};
	struct vec3 out = {0, 0, 0};

	(void)state;
	for (int k = 0; k < 2000; k++)
		out = auto_correction_step(&automatic, correction, variance, 0.01);
	assert_true(out.x == 0);
	assert_true(fabs(out.y - sqrt(2.01) * (1 - 1 / 2.01)) < 1e-3);
	assert_true(fabs(out.z + sqrt(5) * (1 - 1 / 5.0)) < 1e-3);
}

/* The mean of the power, at most 100, falls to 2 by a factor of 0.99 each 10 ms: in ln(50) / -ln(0.99) = 389.2
 * steps. */
static void test_after_a_violent_motion_small_corrections_end_within_four_seconds(void **state)
{
	const struct vec3 variance = {1, 1, 1};
	struct auto_correction automatic = {{0}};

	(void)state;
	for (int k = 0; k < 10000; k++)
		auto_correction_step(&automatic, (struct vec3){1e3, 1e3, 1e3}, variance, 0.01);
	for (int k = 1; k <= 390; k++) {
		struct vec3 out = auto_correction_step(&automatic, (struct vec3){1e-6, 1e-6, 1e-6}, variance, 0.01);

		assert_true(k < 390 ? out.x > 0 : out.x == 0);
	}
}

static void test_the_instability_of_the_gyro_bias_is_part_of_the_noise_of_its_rate_only(void **state)
{
	struct noise_config unsteady = NOISE;

	(void)state;
	unsteady.gyro_bias_instability_rad_s = 3e-3;
	for (int source = 0; source < RATE_SOURCES; source++) {
		struct rates_variance with = rates_variance(&unsteady, (enum rate_source)source, &FILTER, RATE_HZ);
		struct noise_config steady = unsteady;
		struct rates_variance without;

		steady.gyro_bias_instability_rad_s = 0;
		without = rates_variance(&steady, (enum rate_source)source, &FILTER, RATE_HZ);
		assert_true(fabs(with.omega - without.omega - (source == RATES_FROM_GYRO ? 9e-6 : 0)) < 1e-12);
		assert_true(with.alpha == without.alpha);
	}
}

static void test_after_more_than_a_second_only_the_last_correction_counts(void **state)
{
	const struct vec3 variance = {1, 1, 1};
	struct auto_correction automatic = {{0}};
	struct vec3 out;

	(void)state;
	auto_correction_step(&automatic, (struct vec3){5, 5, 5}, variance, 2);
	out = auto_correction_step(&automatic, (struct vec3){sqrt(5), sqrt(10), 1}, variance, 2);
	assert_true(fabs(out.x - sqrt(5) * (1 - 1 / 5.0)) < 1e-12);
	assert_true(fabs(out.y - sqrt(10) * (1 - 1 / 10.0)) < 1e-12);
	assert_true(out.z == 0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_calculated_noise_of_the_gyros_rates_is_that_of_a_simulation),
		cmocka_unit_test(test_the_calculated_noise_of_rates_from_angles_is_that_of_a_simulation),
		cmocka_unit_test(test_the_calculated_variance_of_the_rigid_bodys_correction_is_that_of_a_simulation),
		cmocka_unit_test(test_the_calculated_variance_of_the_seeds_correction_is_that_of_a_simulation),
		cmocka_unit_test(test_noise_alone_gives_no_correction),
		cmocka_unit_test(test_a_correction_far_above_its_noise_is_applied_in_full),
		cmocka_unit_test(test_the_error_never_exceeds_that_of_the_full_or_of_no_correction),
		cmocka_unit_test(test_the_error_is_below_both_where_correction_and_noise_are_alike),
		cmocka_unit_test(test_a_sudden_large_correction_is_applied_at_once),
		cmocka_unit_test(test_without_noise_the_correction_is_applied_in_full),
		cmocka_unit_test(test_a_single_correction_counts_at_once_from_six_sigma_on),
		cmocka_unit_test(test_a_lasting_correction_counts_when_its_power_is_twice_that_of_the_noise),
		cmocka_unit_test(test_after_a_violent_motion_small_corrections_end_within_four_seconds),
		cmocka_unit_test(test_the_instability_of_the_gyro_bias_is_part_of_the_noise_of_its_rate_only),
		cmocka_unit_test(test_after_more_than_a_second_only_the_last_correction_counts),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
