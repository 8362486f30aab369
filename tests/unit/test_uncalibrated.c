/* Chips as delivered: with the errors of data sheets, tilt and heading are within their sigmas from the first
 * sample. */
#include "model_test.h"

#include "model/pipeline.h"
#include "model/sim/sensor.h"

enum { BOARDS = 12, RATE_HZ = 100 };
static const unsigned ALL = PIPELINE_UNCALIBRATED_GYRO | PIPELINE_UNCALIBRATED_ACCEL | PIPELINE_UNCALIBRATED_MAG;

struct shares {
	double tilt, heading; /* of the time beyond 3 sigma, the mean of the boards */
	double first_tilt_rad, last_tilt_rad, first_heading_rad, last_heading_rad; /* largest sigma of a board */
};

static double about_vertical(struct quat truth, struct quat q)
{
	struct quat off = quat_multiply(truth, quat_conjugate(q));

	return fabs(remainder(2 * atan2(off.z, off.w), 2 * PI));
}

static struct shares follow(const char *motion, unsigned uncalibrated, double seconds)
{
	struct shares sum = {0};
	int n = (int)(seconds * RATE_HZ);

	for (uint64_t board = 1; board <= BOARDS; board++) {
		struct pipeline_config config = PIPELINE_DEFAULTS;
		struct sensor_config simulated = *sensor_preset("lsm303dlhc_l3gd20");
		static struct pipeline p;
		struct pipeline_output out;
		struct signal_truth truth;
		struct sensor sensor;
		struct imu_sample s;

		config.latency.sensor_s = config.latency.accelerometer_s = 0;
		config.uncalibrated = uncalibrated;
		assert_int_equal(pipeline_init(&p, &config, RATE_HZ), 0);
		assert_int_equal(sensor_init(&sensor, &simulated, board), 0);
		for (int k = 0; k < n; k++) {
			const struct vec3 up = {0, 0, 1}, *sigma = &out.sigma.attitude_rad;

			sensor_next(&sensor, signal_find(motion), &s, &truth);
			assert_int_equal(pipeline_step(&p, &s, &out), 0);
			if (!(out.status & PIPELINE_VALID))
				continue;
			double tilt = vec3_norm(
				vec3_sub(quat_rotate_inverse(out.q_nb, up), quat_rotate_inverse(truth.q_nb, up)));
			sum.tilt += (tilt > 3 * hypot(sigma->x, sigma->y)) / (double)(n * BOARDS);
			sum.heading += (about_vertical(truth.q_nb, out.q_nb) > 3 * sigma->z) / (double)(n * BOARDS);
			if (k < 10) {
				sum.first_tilt_rad = fmax(sum.first_tilt_rad, sigma->x);
				sum.first_heading_rad = fmax(sum.first_heading_rad, sigma->z);
			}
			if (k == n - 1) {
				sum.last_tilt_rad = fmax(sum.last_tilt_rad, sigma->x);
				sum.last_heading_rad = fmax(sum.last_heading_rad, sigma->z);
			}
		}
	}
	print_message("%s: beyond 3 sigma: tilt %.3f, heading %.3f of the time; sigma at last %.1f and %.1f deg\n",
		motion, sum.tilt, sum.heading, DEG_PER_RAD * sum.last_tilt_rad, DEG_PER_RAD * sum.last_heading_rad);
	return sum;
}

static void test_an_uncalibrated_board_at_rest_is_within_its_sigma_from_the_first_sample(void **state)
{
	struct shares known = follow("rest", ALL, 30), unknown = follow("rest", 0, 30);

	(void)state;
	assert_true(known.tilt < 0.01 && known.heading < 0.01);
	assert_true(unknown.tilt > 0.1); /* the reason */
	assert_true(known.last_tilt_rad > 2 * RAD_PER_DEG && known.last_tilt_rad < 10 * RAD_PER_DEG);
	assert_true(known.first_heading_rad > 30 * RAD_PER_DEG);
}

static void test_turning_shows_the_errors_of_an_uncalibrated_magnetometer(void **state)
{
	struct shares turned = follow("figure", ALL, 60);

	(void)state;
	assert_true(turned.tilt < 0.02 && turned.heading < 0.02);
	assert_true(turned.last_heading_rad < 15 * RAD_PER_DEG);
}

static void test_a_calibration_that_comes_later_ends_the_doubt(void **state)
{
	struct pipeline_config config = PIPELINE_DEFAULTS;
	struct imu_sample s = {.accel_m_s2 = {0, 0, 9.81}, .mag_uT = {0, 20, -45}, .flags = SAMPLE_MAG};
	static struct pipeline p;
	struct pipeline_output out = {.t_us = 0};

	(void)state;
	config.uncalibrated = ALL;
	assert_int_equal(pipeline_init(&p, &config, RATE_HZ), 0);
	for (int k = 0; k < 4000; k++) {
		if (k == 2000) {
			assert_true(out.sigma.attitude_rad.x > 2 * RAD_PER_DEG);
			assert_true(out.sigma.attitude_rad.z > 30 * RAD_PER_DEG);
			config.uncalibrated = 0;
			assert_int_equal(pipeline_configure(&p, &config), 0);
		}
		s.t_us = (uint64_t)k * 10000;
		assert_int_equal(pipeline_step(&p, &s, &out), 0);
	}
	assert_true(out.sigma.attitude_rad.x < 1 * RAD_PER_DEG);
	assert_true(out.sigma.attitude_rad.z < 6 * RAD_PER_DEG);
}

/* rad, of an arm that begins to swing after 5 s, to 60 degrees at 0.5 Hz within 2 s. */
static double arm_angle_rad(double t)
{
	double share = fmax(0, fmin(1, (t - 5) / 2));

	return 60 * RAD_PER_DEG * share * share * (3 - 2 * share) * sin(PI * t);
}

/* The sensor hangs on it, 0.3 m from the axis. */
static struct imu_sample on_an_arm(int k, struct quat *q_nb)
{
	const double t = (double)k / RATE_HZ, h = 1e-4, length_m = 0.3, angle = arm_angle_rad(t);
	const double before = arm_angle_rad(t - h), after = arm_angle_rad(t + h), rate = (after - before) / (2 * h);
	const struct vec3 arm_m_s2 = {(after - 2 * angle + before) / (h * h) * length_m, 0, rate * rate * length_m};

	*q_nb = quat_from_rotation_vector((struct vec3){0, -angle, 0});
	return (struct imu_sample){.t_us = (uint64_t)k * (1000000 / RATE_HZ),
		.gyro_rad_s = {0, -rate, 0},
		.accel_m_s2 = vec3_add(quat_rotate_inverse(*q_nb, (struct vec3){0, 0, 9.81}), arm_m_s2)};
}

/* The tangential acceleration is in phase with the angle, like the gravity that a scale error leaves. */
static void test_a_lever_arm_that_is_not_configured_is_not_taken_for_a_scale_error(void **state)
{
	struct pipeline_config config = PIPELINE_DEFAULTS;
	static struct pipeline p;
	double beyond = 0;

	(void)state;
	config.latency.sensor_s = config.latency.accelerometer_s = 0;
	config.uncalibrated = PIPELINE_UNCALIBRATED_GYRO;
	assert_int_equal(pipeline_init(&p, &config, RATE_HZ), 0);
	for (int k = 0; k < 60 * RATE_HZ; k++) {
		struct pipeline_output out;
		struct quat q_nb;
		struct imu_sample s = on_an_arm(k, &q_nb);

		assert_int_equal(pipeline_step(&p, &s, &out), 0);
		beyond += (quat_apart_rad(out.q_nb, q_nb) > 3 * out.sigma.attitude_rad.y) / (60.0 * RATE_HZ);
	}
	print_message("arm, uncalibrated gyro: tilt beyond 3 sigma for %.3f of the time\n", beyond);
	assert_true(beyond < 0.02);
}

/* A turntable: its rate about the vertical, then another one and a third one, each reached within 0.5 s. A hand may
 * hold the sensor before. */
struct turntable {
	double rad_s[3], for_s[3];
	bool in_a_hand;
};

struct seen {
	double beyond; /* 3 sigma of the heading: share of the time */
	double heading_off_rad, bias_sigma_rad_s;
};

static double turntable_rad_s(const struct turntable *t, double at_s)
{
	double second = fmax(0, fmin(1, 2 * (at_s - t->for_s[0])));
	double third = fmax(0, fmin(1, 2 * (at_s - t->for_s[0] - t->for_s[1])));

	return t->rad_s[0] + second * (t->rad_s[1] - t->rad_s[0]) + third * (t->rad_s[2] - t->rad_s[1]);
}

/* With a gyro whose bias is 2 deg/s, and without a magnetometer. */
static struct seen put_on(struct turntable t, unsigned uncalibrated)
{
	struct pipeline_config config = PIPELINE_DEFAULTS;
	struct seen seen = {.beyond = 0};
	static struct pipeline p;
	double heading_rad = 0, before = t.rad_s[0];
	int n = (int)((t.for_s[0] + t.for_s[1] + t.for_s[2]) * RATE_HZ);

	config.latency.sensor_s = config.latency.accelerometer_s = 0;
	config.uncalibrated = uncalibrated;
	assert_int_equal(pipeline_init(&p, &config, RATE_HZ), 0);
	for (int k = 0; k < n; k++) {
		double rate = turntable_rad_s(&t, (double)k / RATE_HZ);
		double hand = t.in_a_hand && k < t.for_s[0] * RATE_HZ ? 0.3 * sin(0.2 * k) : 0;
		struct imu_sample s = {.t_us = (uint64_t)k * (1000000 / RATE_HZ),
			.gyro_rad_s = {hand, 0, rate + 2 * RAD_PER_DEG},
			.accel_m_s2 = {0, 0, 9.81}};
		struct pipeline_output out;

		heading_rad += (before + rate) / 2 / RATE_HZ;
		before = rate;
		assert_int_equal(pipeline_step(&p, &s, &out), 0);
		seen.heading_off_rad = fabs(remainder(out.angles_rad.z - heading_rad, 2 * PI));
		seen.beyond += (seen.heading_off_rad > 3 * out.sigma.attitude_rad.z) / (double)n;
	}
	seen.bias_sigma_rad_s = sqrt(p.fusion.kalman.covariance[KALMAN_BIAS + 2][KALMAN_BIAS + 2]);
	return seen;
}

/* Whether it lay and turns now, or turned and lies now, no gyro shows that may have any bias. */
static void test_of_two_steady_rates_after_the_start_either_is_the_bias_until_the_first_one_returns(void **state)
{
	const double turn = 5 * RAD_PER_DEG;

	(void)state;
	for (double s = 0.5; s < 4; s *= 2) {
		struct seen turns = put_on((struct turntable){{0, turn, 0}, {s, 20, 0}, 0}, PIPELINE_UNCALIBRATED_GYRO);
		struct seen lies = put_on((struct turntable){{turn, 0, 0}, {s, 20, 0}, 0}, PIPELINE_UNCALIBRATED_GYRO);
		struct seen back = put_on((struct turntable){{0, turn, 0}, {s, 20, 9}, 0}, PIPELINE_UNCALIBRATED_GYRO);

		assert_true(turns.beyond < 0.01 && lies.beyond < 0.01 && back.beyond < 0.01);
		assert_true(turns.bias_sigma_rad_s > turn / 2 && lies.bias_sigma_rad_s > turn / 2);
		assert_true(back.bias_sigma_rad_s < 0.1 * RAD_PER_DEG);
		assert_true(back.heading_off_rad < 5 * RAD_PER_DEG);
	}
}

static void test_what_a_hand_laid_down_lies(void **state)
{
	struct seen seen = put_on((struct turntable){{0.5, 0, 0}, {3, 20, 0}, true}, PIPELINE_UNCALIBRATED_GYRO);

	(void)state;
	assert_true(seen.bias_sigma_rad_s < 0.1 * RAD_PER_DEG);
}

/* 20 deg/s are no bias of a gyro that was calibrated to 0.5. */
static void test_a_calibrated_gyro_knows_which_rate_is_the_turn(void **state)
{
	struct seen turns = put_on((struct turntable){{0, 20 * RAD_PER_DEG, 0}, {3, 20, 9}, 0}, 0);
	struct seen lies = put_on((struct turntable){{20 * RAD_PER_DEG, 0, 0}, {3, 20, 0}, 0}, 0);

	(void)state;
	assert_true(turns.bias_sigma_rad_s < 0.1 * RAD_PER_DEG && lies.bias_sigma_rad_s < 0.1 * RAD_PER_DEG);
	assert_true(turns.beyond < 0.01);
}

/* A rate beyond the limit of rest, until it is known to be the gyro's bias. */
static void test_a_lift_with_chips_as_delivered_is_seen_to_stand(void **state)
{
	static const enum motion_preset presets[] = {MOTION_ANY, MOTION_LINEAR_AXIS, MOTION_VERTICAL_LIFT};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct pipeline_config config = PIPELINE_DEFAULTS;
		static struct pipeline p;

		config.uncalibrated = ALL;
		config.position.navigation.preset = presets[i];
		assert_int_equal(pipeline_init(&p, &config, RATE_HZ), 0);
		for (int k = 0; k < 8 * RATE_HZ; k++) {
			struct imu_sample s = {.t_us = (uint64_t)k * (1000000 / RATE_HZ),
				.gyro_rad_s = {2 * RAD_PER_DEG, -2 * RAD_PER_DEG, 4 * RAD_PER_DEG},
				.accel_m_s2 = {0.3, -0.2, 10.1}};
			struct pipeline_output out;

			assert_int_equal(pipeline_step(&p, &s, &out), 0);
		}
		assert_true(p.position.navigation.still);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_an_uncalibrated_board_at_rest_is_within_its_sigma_from_the_first_sample),
		cmocka_unit_test(test_turning_shows_the_errors_of_an_uncalibrated_magnetometer),
		cmocka_unit_test(test_a_calibration_that_comes_later_ends_the_doubt),
		cmocka_unit_test(test_a_lever_arm_that_is_not_configured_is_not_taken_for_a_scale_error),
		cmocka_unit_test(
			test_of_two_steady_rates_after_the_start_either_is_the_bias_until_the_first_one_returns),
		cmocka_unit_test(test_what_a_hand_laid_down_lies),
		cmocka_unit_test(test_a_lift_with_chips_as_delivered_is_seen_to_stand),
		cmocka_unit_test(test_a_calibrated_gyro_knows_which_rate_is_the_turn),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
