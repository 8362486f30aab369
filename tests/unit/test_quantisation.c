/* An accelerometer that is coarser than its noise: its step, the error of its mean against quantised noise of known
 * size, and what the navigation makes of it. */
#include "model_test.h"

#include "model/pipeline.h"
#include "model/quantisation.h"
#include "model/sim/rng.h"

static const double DT_S = 0.01, G = 9.81;

static double quantised(double value, double step)
{
	return step * round(value / step);
}

static void test_of_few_changes_nothing_is_known(void **state)
{
	struct quantisation q = {.known = false};

	(void)state;
	for (int k = 0; k < 100; k++)
		quantisation_step(&q, (struct vec3){3, -2, 9}, DT_S); /* the first value is no change */
	assert_true(quantisation_variance(&q) == 0);
	for (int k = 0; k < 19; k++)
		quantisation_step(&q, (struct vec3){0.5 * (k & 1), 0, 0}, DT_S);
	assert_true(quantisation_variance(&q) == 0);
}

/* Slowly, so that it does not dither. The finest axis does not count. */
static void test_a_value_that_stays_is_wrong_by_up_to_half_a_step(void **state)
{
	for (int axis = 0; axis < 3; axis++) {
		struct quantisation q = {.known = false};

		(void)state;
		for (int k = 0; k < 4000; k++) {
			double v[3] = {0.001 * k, 0.001 * k, 0.001 * k};

			v[axis] = quantised(v[axis], 0.1);
			quantisation_step(&q, (struct vec3){v[0], v[1], v[2]}, DT_S);
		}
		for (int k = 0; k < 1000; k++)
			quantisation_step(&q, (struct vec3){4, 4, 4}, DT_S);
		assert_near(quantisation_variance(&q), 0.1 * 0.1 / 12, 1e-9);
	}
}

/* Noise of a share of a step, around a value anywhere between two steps. */
static void test_the_mean_is_wrong_by_no_more_than_three_sigma_of_it(void **state)
{
	struct rng rng;
	double least_sigma = 1;

	(void)state;
	rng_init(&rng, 7);
	for (double noise = 0; noise < 1; noise += 0.05)
		for (double at = -0.5; at < 0.5; at += 0.05) {
			struct quantisation q = {.known = false};
			double sum = 0, sigma;
			const int n = 3000;

			for (int k = 0; k < 100; k++)
				quantisation_step(&q, (struct vec3){k % 2, 0, 0}, DT_S);
			for (int k = 0; k < n; k++) {
				double value = quantised(at + noise * rng_gauss(&rng), 1);

				quantisation_step(&q, (struct vec3){value, 0, 0}, DT_S);
				sum += value;
			}
			sigma = sqrt(quantisation_variance(&q));
			least_sigma = fmin(least_sigma, sigma);
			/* the mean of the noise itself counts as noise does */
			assert_true(fabs(sum / n - at) < 3 * hypot(sigma, noise / sqrt(n)) + 1e-9);
		}
	assert_true(least_sigma < 0.005); /* noise of a step averages it out */
}

/* The same accelerometer at 2 g and at 16 g (LSM303DLHC: 1 and 12 mg), 20 s after a standstill. */
static double sigma_after_a_motion_m(double step_m_s2)
{
	struct pipeline_config config = PIPELINE_DEFAULTS;
	struct pipeline_output out = {.t_us = 0};
	struct pipeline p;
	struct rng rng;

	rng_init(&rng, 3);
	config.latency = (struct latency_config){0, 0};
	assert_int_equal(pipeline_init(&p, &config, 100), 0);
	for (int k = 0; k < 3000; k++) {
		double t = 0.01 * k - 10, accel = t > 0 && t < 2 ? sin(PI * t) : 0, noise = 0.01;
		struct imu_sample s = {.t_us = (uint64_t)k * 10000 + 1000000,
			.accel_m_s2 = {quantised(accel + noise * rng_gauss(&rng), step_m_s2),
				quantised(noise * rng_gauss(&rng) + 0.03, step_m_s2),
				quantised(G + noise * rng_gauss(&rng), step_m_s2)},
			.gyro_rad_s = {1e-3 * rng_gauss(&rng), 1e-3 * rng_gauss(&rng), 1e-3 * rng_gauss(&rng)}};

		assert_int_equal(pipeline_step(&p, &s, &out), 0);
		if (t > 1.9)
			break;
	}
	return out.sigma.position_m.x;
}

static void test_the_position_is_less_certain_by_coarse_steps(void **state)
{
	double fine = sigma_after_a_motion_m(1e-3 * G), coarse = sigma_after_a_motion_m(12e-3 * G);
	/* 12 mg / sqrt(12), which lasts for a second, for 1.9 s */
	double steps = 12e-3 * G * sqrt(2 * 1.9 * 1.9 * 1.9 / 12 / 3);

	(void)state;
	print_message("1 sigma: %.3f m in steps of 1 mg, %.3f m in steps of 12 mg\n", fine, coarse);
	assert_near(sqrt(coarse * coarse - fine * fine), steps, 0.4 * steps);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_of_few_changes_nothing_is_known),
		cmocka_unit_test(test_a_value_that_stays_is_wrong_by_up_to_half_a_step),
		cmocka_unit_test(test_the_mean_is_wrong_by_no_more_than_three_sigma_of_it),
		cmocka_unit_test(test_the_position_is_less_certain_by_coarse_steps),
	};

	return cmocka_run_group_tests_name("quantisation", tests, NULL, NULL);
}
