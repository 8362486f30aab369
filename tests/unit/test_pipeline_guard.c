/* The last guard of the pipeline: an output that is not finite, or beyond what the sensor has measured, is not
 * published. Nothing is known to make one; here the state of a step is damaged. */
#include "model_test.h"

#include "model/pipeline.h"

enum { RATE_HZ = 200, INTERVAL_US = 1000000 / RATE_HZ };

/* Level, and turning to and fro about z. */
static struct imu_sample sample(int k)
{
	return (struct imu_sample){.t_us = (uint64_t)(k + 1) * INTERVAL_US,
		.gyro_rad_s = {0, 0, 2 * cos(k * 0.02)},
		.accel_m_s2 = {0.1 * sin(k * 0.1), 0, 9.81}};
}

static struct pipeline_output run(struct pipeline *p, int from, int to)
{
	struct pipeline_output out = {.t_us = 0};

	for (int k = from; k < to; k++) {
		struct imu_sample s = sample(k);

		assert_int_equal(pipeline_step(p, &s, &out), 0);
	}
	return out;
}

static struct pipeline started(const struct pipeline_config *config)
{
	struct pipeline p;

	assert_int_equal(pipeline_init(&p, config, RATE_HZ), 0);
	assert_true(run(&p, 0, 1000).status & PIPELINE_VALID);
	assert_int_equal(p.implausible, 0);
	return p;
}

/* The output of this step is the one before, with its own time and not valid. */
static void assert_replaced(const struct pipeline_output *out, const struct pipeline_output *before, int k)
{
	assert_int_equal(out->t_us, (uint64_t)(k + 1) * INTERVAL_US);
	assert_false(out->status & PIPELINE_VALID);
	assert_quat_near(out->q_nb, before->q_nb, 1e-15);
	assert_vec_near(out->rate_b_rad_s, before->rate_b_rad_s, 0);
	assert_vec_near(out->accel_n_m_s2, before->accel_n_m_s2, 0);
	assert_vec_near(out->position_n_m, before->position_n_m, 0);
	assert_vec_near(out->sigma.position_m, before->sigma.position_m, 0);
}

static void test_what_is_not_finite_is_replaced_by_the_last_good_output_and_all_begins_again(void **state)
{
	const double bad[] = {NAN, INFINITY, -INFINITY};

	(void)state;
	for (int where = 0; where < 8; where++)
		for (int i = 0; i < 3; i++) {
			struct pipeline p = started(&PIPELINE_DEFAULTS);
			struct pipeline_output before = p.last_good, out;
			double *const damaged[] = {&p.mag_b_uT.x, &p.mag_b_uT.y, &p.mag_b_uT.z,
				&p.fusion.gyro_errors.bias_b_rad_s.z, &p.position.position_n_m.x,
				&p.position.displacement_n_m.y, &p.position.sigma.position_m.z,
				&p.position.displacement_sigma_m.x};

			for (int again = 0; again < 2; again++) { /* and after it has begun again */
				p.position.anchored = false;
				*damaged[where] = bad[i];
				out = run(&p, 1000 + again, 1001 + again);
				if (p.implausible == (unsigned)again) /* that step does not use it any more */
					break;
				assert_replaced(&out, &before, 1000 + again);
			}
			if (where < 4)
				assert_true(p.implausible >= 1);
			out = run(&p, 1002, 1400);
			assert_true(out.status & PIPELINE_VALID);
			assert_true(vec3_finite(out.position_n_m));
			assert_true(p.implausible <= 2);
		}
}

static void test_in_place_of_the_first_output_there_is_an_attitude_and_nothing_else(void **state)
{
	struct pipeline_output out;
	struct pipeline p;

	(void)state;
	assert_int_equal(pipeline_init(&p, &PIPELINE_DEFAULTS, RATE_HZ), 0);
	p.fusion.gyro_errors.bias_b_rad_s.z = NAN;
	out = run(&p, 0, 1);
	assert_int_equal(p.implausible, 1);
	assert_true(out.q_nb.w == 1 && out.q_nb.x == 0 && out.q_nb.y == 0 && out.q_nb.z == 0);
	assert_vec_near(out.accel_n_m_s2, ((struct vec3){0, 0, 0}), 0);
}

/* Three times the greatest rate and 0.5 rad/s. By the angles a jump of the attitude is a rate. */
static void test_a_rate_beyond_three_times_the_greatest_measured_is_not_published(void **state)
{
	struct pipeline_config config = PIPELINE_DEFAULTS;

	(void)state;
	config.estimator.rates_from = RATES_FROM_ANGLES;
	config.rate_filter.type = FILTER_OFF;
	for (int beyond = 0; beyond < 2; beyond++) {
		struct pipeline p = started(&config);
		struct pipeline_output before = p.last_good, out;
		const double limit = 3 * p.most.rate_rad_s + 0.5, rate = (beyond ? 1.03 : 0.97) * limit;

		assert_near(p.most.rate_rad_s, 2, 1e-6);
		/* the attitude before this sample was one that makes its rate that */
		p.rates.q_nb = quat_multiply(p.fusion.q_nb,
			quat_from_rotation_vector((struct vec3){0, 0, -(rate - sample(1000).gyro_rad_s.z) / RATE_HZ}));
		out = run(&p, 1000, 1001);
		assert_int_equal(p.implausible, beyond);
		if (beyond)
			assert_replaced(&out, &before, 1000);
		else
			assert_true(out.status & PIPELINE_VALID);
		out = run(&p, 1001, 1003); /* it continues at once */
		assert_true(out.status & PIPELINE_VALID);
		assert_int_equal(p.implausible, beyond);
	}
}

/* Three times the greatest force and gravity; or those and the lever arm's share. */
static void test_an_acceleration_beyond_what_was_measured_is_not_published(void **state)
{
	(void)state;
	for (int lever = 0; lever < 2; lever++)
		for (int beyond = 0; beyond < 2; beyond++) {
			struct pipeline_config config = PIPELINE_DEFAULTS;
			struct pipeline_output out;
			struct pipeline p;
			double limit;

			config.accel_filter = (struct filter_config){FILTER_BUTTERWORTH, 2, 5};
			config.estimator.lever_arm_b_m = (struct vec3){lever ? 10 : 0, 0, 0};
			assert_int_equal(pipeline_init(&p, &config, RATE_HZ), 0);
			run(&p, 0, 1000);
			p.most.alpha_rad_s2 = 10; /* so that the share is 140 m/s^2 */
			limit = p.most.force_m_s2 + 9.81;
			limit = lever ? limit + 10 * (p.most.rate_rad_s * p.most.rate_rad_s + 10) : 3 * limit;
			assert_near(limit, lever ? 159.6 : 58.9, 0.3);
			filter3_prime(&p.accel_filter, (struct vec3){(beyond ? 1.04 : 0.92) * limit, 0, 0});
			p.implausible = 0;
			out = run(&p, 1000, 1001);
			assert_int_equal(p.implausible, beyond);
			assert_int_equal(!(out.status & PIPELINE_VALID), beyond);
		}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_in_place_of_the_first_output_there_is_an_attitude_and_nothing_else),
		cmocka_unit_test(test_what_is_not_finite_is_replaced_by_the_last_good_output_and_all_begins_again),
		cmocka_unit_test(test_a_rate_beyond_three_times_the_greatest_measured_is_not_published),
		cmocka_unit_test(test_an_acceleration_beyond_what_was_measured_is_not_published),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
