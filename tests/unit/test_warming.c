/* A chip that warms up: what counts as a change of its temperature, and that the sigmas have what that does to biases
 * which nobody compensates. The truth is a motion in closed form. */
#include "model_test.h"

#include "model/pipeline.h"
#include "model/warming.h"

static const uint64_t SECOND_US = 1000000;

static void test_a_board_that_warms_by_ten_kelvins_has_changed_by_as_much(void **state)
{
	static const double SIGN[] = {1, -1}, STEP_K[] = {0.01, 1};

	(void)state;
	for (int i = 0; i < 4; i++) {
		struct warming w = {0};
		double sum = 0;

		for (uint64_t s = 0; s < 1200; s++) {
			double degC = 25 + SIGN[i % 2] * 10 * (1 - exp(-(double)s / 120)), step = STEP_K[i / 2];
			double change = warming_step(&w, step * round(degC / step), s * SECOND_US);

			assert_true(change >= 0);
			sum += change;
		}
		assert_near(sum, 10 - 0.4, 0.05); /* less the play */
	}
}

static void test_readings_as_often_as_samples_show_the_same_change(void **state)
{
	struct warming often = {0}, seldom = {0};
	double sums[2] = {0};

	(void)state;
	for (uint64_t k = 0; k < 60000; k++) {
		double degC = 20 + 8e-5 * (double)k;

		sums[0] += warming_step(&often, degC, k * SECOND_US / 100);
		sums[1] += k % 100 ? 0 : warming_step(&seldom, degC, k * SECOND_US / 100);
	}
	assert_near(sums[0], 4.8 - 0.008 * 10 - 0.4, 0.05);
	assert_near(sums[1], sums[0], 0.05);
}

static void test_a_reading_between_two_steps_is_no_change(void **state)
{
	struct warming w = {0};
	double sum = 0;

	(void)state;
	for (uint64_t s = 0; s < 86400; s++)
		sum += warming_step(&w, any() > 0 ? 25 : 26, s * SECOND_US);
	assert_near(sum, 0.5, 0.5); /* where the mean is, once */
}

static void test_the_first_reading_is_no_change(void **state)
{
	struct warming w = {0};

	(void)state;
	assert_near(warming_step(&w, -40, 17 * SECOND_US), 0, 0);
	assert_near(warming_step(&w, -40, 18 * SECOND_US), 0, 0);
}

static void test_a_time_that_goes_back_is_no_change(void **state)
{
	struct warming w = {0};

	(void)state;
	warming_step(&w, 20, 17 * SECOND_US);
	assert_near(warming_step(&w, 80, 16 * SECOND_US), 0, 0);
	assert_near(warming_step(&w, 80, 26 * SECOND_US), 30 - 0.4, 1e-9);
}

static void test_the_bias_has_changed_by_its_sigma_a_kelvin_over_three(void **state)
{
	(void)state;
	assert_near(sqrt(warming_variance(3, 0.1)), 0.3, 1e-12);
	assert_near(warming_variance(1, 0.1) + warming_variance(2, 0.1), warming_variance(3, 0.1), 1e-15);
	assert_near(warming_variance(0, 0.1), 0, 0);
}

/* ---- in the pipeline --------------------------------------------------------------------------------------------- */

enum { RATE_HZ = 100 };

struct warm_up {
	double reading_K, true_K; /* by which the readings and the chip are warmer in the end */
	double speed_m_s;	  /* of a drive from 20 to 30 s */
};

/* Its integral over the second from 0 on is 1. */
static double half_a_sine(double t_s)
{
	return t_s > 0 && t_s < 1 ? PI / 2 * sin(PI * t_s) : 0;
}

/* An object that stands, drives along x, and stands: the gyro's bias changes by 0.03 deg/s/K about y, that of the
 * accelerometer by 0.5 mg/K along x, while the board warms up with a time constant of 60 s. */
static struct pipeline_output warm_up(struct pipeline *p, const struct pipeline_config *config, struct warm_up u)
{
	struct pipeline_output out = {0};

	assert_int_equal(pipeline_init(p, config, RATE_HZ), 0);
	for (uint64_t k = 1; k <= 40 * RATE_HZ; k++) {
		double t_s = (double)k / RATE_HZ, warmer = 1 - exp(-t_s / 60);
		double accel = u.speed_m_s * (half_a_sine(t_s - 20) - half_a_sine(t_s - 29));
		const struct imu_sample sample = {.t_us = k * SECOND_US / RATE_HZ,
			.gyro_rad_s = {0, 0.03 * RAD_PER_DEG * u.true_K * warmer, 0},
			.accel_m_s2 = {accel + 0.5e-3 * 9.81 * u.true_K * warmer, 0, 9.81},
			.temperature_degC = 25 + u.reading_K * warmer,
			.flags = k % RATE_HZ ? 0 : SAMPLE_TEMPERATURE};

		assert_int_equal(pipeline_step(p, &sample, &out), 0);
	}
	return out;
}

static struct pipeline_config undelayed(void)
{
	struct pipeline_config c = PIPELINE_DEFAULTS;

	c.latency = (struct latency_config){0, 0};
	return c;
}

static struct pipeline pipeline, other;

static void test_a_drive_while_the_chip_warms_up_ends_within_its_sigma(void **state)
{
	struct pipeline_config c = undelayed();
	struct pipeline_output told, untold;

	(void)state;
	for (int preset = 0; preset <= MOTION_LINEAR_AXIS; preset++) {
		c.position.navigation.preset = (enum motion_preset)preset;
		told = warm_up(&pipeline, &c, (struct warm_up){10, 10, 1});
		untold = warm_up(&other, &c, (struct warm_up){0, 10, 1});
		if (preset == MOTION_HAND_HELD) /* nothing moves it steadily */
			continue;
		assert_true(told.status & PIPELINE_VALID);
		assert_true(fabs(told.position_n_m.x - 9) < 2 * told.sigma.position_m.x);
		assert_true(fabs(told.position_n_m.x - 9) < 0.1 * fabs(untold.position_n_m.x - 9));
	}
}

static void test_the_bias_that_changes_is_followed_at_rest(void **state)
{
	struct pipeline_config c = undelayed();
	struct vec3 bias;

	(void)state;
	warm_up(&pipeline, &c, (struct warm_up){10, 10, 0});
	bias = pipeline.position.navigation.gyro_bias_b_rad_s;
	assert_near(bias.y / RAD_PER_DEG, 0.3 * (1 - exp(-40 / 60.0)), 0.01);
	warm_up(&pipeline, &c, (struct warm_up){0, 10, 0});
	bias = pipeline.position.navigation.gyro_bias_b_rad_s;
	assert_true(bias.y / RAD_PER_DEG < 0.3 * (1 - exp(-40 / 60.0)) - 0.02);
}

/* Variance by which a bias is less certain after the chip has become hotter, at rest. */
static double by_heat(const struct pipeline_config *c, int at)
{
	struct imu_sample cold = {.accel_m_s2 = {0, 0, 9.81}, .temperature_degC = 25}, hot;
	struct pipeline_output out;

	warm_up(&pipeline, c, (struct warm_up){0, 0, 0});
	for (uint64_t k = 1; k <= RATE_HZ; k++) {
		cold.t_us = (40 * RATE_HZ + k) * SECOND_US / RATE_HZ;
		cold.flags = k == RATE_HZ ? SAMPLE_TEMPERATURE : 0;
		other = pipeline;
		hot = cold;
		hot.temperature_degC = 40;
		pipeline_step(&pipeline, &cold, &out);
		pipeline_step(&other, &hot, &out);
	}
	return other.position.navigation.p[at][at] - pipeline.position.navigation.p[at][at];
}

static void test_a_compensated_bias_changes_by_a_fifth(void **state)
{
	static const double SLOPE = 1e-12; /* not 0, and without effect */
	struct pipeline_config c = undelayed(), gyro = c, accel = c;

	(void)state;
	gyro.calibration.temperature.gyro_slope.z = SLOPE;
	accel.calibration.temperature.accel_quadratic.x = SLOPE;
	assert_near(by_heat(&c, NAVIGATION_BA) / by_heat(&accel, NAVIGATION_BA), 25, 2);
	assert_true(by_heat(&c, NAVIGATION_BG) > 4 * by_heat(&gyro, NAVIGATION_BG));
	assert_true(by_heat(&gyro, NAVIGATION_BG) > 0);
	assert_near(by_heat(&c, NAVIGATION_BA) / by_heat(&gyro, NAVIGATION_BA), 1, 0.1);
	assert_near(by_heat(&c, NAVIGATION_BG) / by_heat(&accel, NAVIGATION_BG), 1, 0.1);
}

static void test_the_changes_a_kelvin_are_configuration(void **state)
{
	struct pipeline_config c = undelayed(), none = c, twice = c;

	(void)state;
	none.noise.gyro_bias_per_K_rad_s = none.noise.accel_bias_per_K_m_s2 = 0;
	twice.noise.gyro_bias_per_K_rad_s *= 2;
	twice.noise.accel_bias_per_K_m_s2 *= 2;
	assert_near(by_heat(&none, NAVIGATION_BA), 0, 0);
	assert_near(by_heat(&none, NAVIGATION_BG), 0, 0);
	assert_near(by_heat(&twice, NAVIGATION_BA) / by_heat(&c, NAVIGATION_BA), 4, 0.4);
	assert_true(by_heat(&twice, NAVIGATION_BG) > 1.5 * by_heat(&c, NAVIGATION_BG));
}

/* Without a magnetometer only the gyro knows the heading. */
static void test_the_attitude_is_less_certain_with_any_filter(void **state)
{
	struct pipeline_config c = undelayed();

	(void)state;
	for (int algorithm = FUSION_MADGWICK; algorithm <= FUSION_KALMAN; algorithm++) {
		const struct fusion *f[] = {&pipeline.fusion, &other.fusion};

		c.fusion.algorithm = (enum fusion_algorithm)algorithm;
		if (algorithm != FUSION_KALMAN)
			f[0] = &pipeline.reference, f[1] = &other.reference;
		warm_up(&pipeline, &c, (struct warm_up){10, 0, 1});
		warm_up(&other, &c, (struct warm_up){0, 0, 1});
		assert_true(f[0]->kalman.covariance[KALMAN_BIAS + 2][KALMAN_BIAS + 2] >
			    1.1 * f[1]->kalman.covariance[KALMAN_BIAS + 2][KALMAN_BIAS + 2]);
	}
}

static void test_what_is_no_temperature_changes_nothing(void **state)
{
	static const double NONE[] = {NAN, INFINITY, 1000, -1000};
	struct imu_sample sample = {.accel_m_s2 = {0, 0, 9.81}, .flags = SAMPLE_TEMPERATURE};
	struct pipeline_config c = undelayed();
	struct pipeline_output out;

	(void)state;
	for (int i = 0; i < 4; i++) {
		warm_up(&pipeline, &c, (struct warm_up){0, 0, 0});
		other = pipeline;
		for (int k = 1; k <= RATE_HZ; k++) {
			sample.t_us = (40 * RATE_HZ + (uint64_t)k) * SECOND_US / RATE_HZ;
			sample.temperature_degC = NONE[i];
			assert_int_equal(pipeline_step(&pipeline, &sample, &out), 0);
			sample.temperature_degC = 25;
			assert_int_equal(pipeline_step(&other, &sample, &out), 0);
		}
		assert_memory_equal(pipeline.position.navigation.p, other.position.navigation.p,
			sizeof(other.position.navigation.p));
	}
}

/* A restart of the filters is none of the chip. */
static void test_a_discontinuity_is_no_change_of_temperature(void **state)
{
	struct imu_sample sample = {.accel_m_s2 = {0, 0, 9.81}, .flags = SAMPLE_TEMPERATURE};
	struct pipeline_config c = undelayed();
	struct pipeline_output out;

	(void)state;
	warm_up(&pipeline, &c, (struct warm_up){10, 0, 0});
	other = pipeline;
	sample.t_us = 40 * SECOND_US + SECOND_US / RATE_HZ;
	sample.temperature_degC = 40;
	sample.flags |= SAMPLE_DISCONTINUITY;
	assert_int_equal(pipeline_step(&pipeline, &sample, &out), 0);
	assert_near(pipeline.warming.low_degC, other.warming.low_degC, 0.2);
	assert_true(pipeline.warming.known);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_board_that_warms_by_ten_kelvins_has_changed_by_as_much),
		cmocka_unit_test(test_readings_as_often_as_samples_show_the_same_change),
		cmocka_unit_test(test_a_reading_between_two_steps_is_no_change),
		cmocka_unit_test(test_the_first_reading_is_no_change),
		cmocka_unit_test(test_a_time_that_goes_back_is_no_change),
		cmocka_unit_test(test_the_bias_has_changed_by_its_sigma_a_kelvin_over_three),
		cmocka_unit_test(test_a_drive_while_the_chip_warms_up_ends_within_its_sigma),
		cmocka_unit_test(test_the_bias_that_changes_is_followed_at_rest),
		cmocka_unit_test(test_a_compensated_bias_changes_by_a_fifth),
		cmocka_unit_test(test_the_changes_a_kelvin_are_configuration),
		cmocka_unit_test(test_the_attitude_is_less_certain_with_any_filter),
		cmocka_unit_test(test_what_is_no_temperature_changes_nothing),
		cmocka_unit_test(test_a_discontinuity_is_no_change_of_temperature),
	};

	return cmocka_run_group_tests_name("warming", tests, NULL, NULL);
}
