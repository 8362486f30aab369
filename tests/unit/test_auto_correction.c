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
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
