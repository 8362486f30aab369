/* The gyro's scale factors, estimated by the fusion from the tilt of an object that turns to different sides. */
#include "model_test.h"

#include "model/fusion.h"

static const double G = 9.81;
static const struct vec3 FIELD_N = {0, 20, -45}, ZERO = {0, 0, 0};

struct moment {
	struct quat q_nb;
	struct vec3 omega_b_rad_s;
};

/* Turns about the vertical in one direction, while it pitches and rolls to and fro about its own axes. */
static struct moment turning(double t)
{
	double around = 0.8 * t - 2 * cos(0.3 * t), nod = 1.2 * sin(0.9 * t), roll = 8 * sin(0.4 * t);
	double around_s = 0.8 + 0.6 * sin(0.3 * t), nod_s = 1.08 * cos(0.9 * t), roll_s = 3.2 * cos(0.4 * t);
	struct quat a = quat_from_rotation_vector((struct vec3){0, 0, around});
	struct quat n = quat_from_rotation_vector((struct vec3){0, nod, 0});
	struct quat r = quat_from_rotation_vector((struct vec3){roll, 0, 0});
	struct vec3 omega = vec3_add(quat_rotate_inverse(n, (struct vec3){0, 0, around_s}), (struct vec3){0, nod_s, 0});

	return (struct moment){
		.q_nb = quat_multiply(a, quat_multiply(n, r)),
		.omega_b_rad_s = vec3_add(quat_rotate_inverse(r, omega), (struct vec3){roll_s, 0, 0}),
	};
}

static struct fusion fusion(int use_magnetometer, double scale_sigma)
{
	struct fusion_config config = {
		.algorithm = FUSION_KALMAN, .use_magnetometer = use_magnetometer, .kalman = FUSION_KALMAN_DEFAULTS};
	struct fusion f;

	config.kalman.gyro_scale_sigma = scale_sigma;
	assert_int_equal(fusion_init(&f, &config), 0);
	return f;
}

/* From from_s to to_s, with a gyro whose output is too small by `scale`, and a magnet in the object. Returns the error
 * of the heading gained in that time. */
static double turn(struct fusion *f, struct vec3 scale, struct vec3 magnet_b_uT, double from_s, double to_s)
{
	const double dt_s = 0.005;
	struct vec3 east_from = ZERO, east = ZERO;

	for (double t = from_s; t < to_s; t += dt_s) {
		struct moment m = turning(t);
		struct vec3 w = m.omega_b_rad_s;
		struct imu_sample sample = {
			.gyro_rad_s = {w.x / (1 + scale.x), w.y / (1 + scale.y), w.z / (1 + scale.z)},
			.accel_m_s2 = quat_rotate_inverse(m.q_nb, (struct vec3){0, 0, G}),
			.mag_uT = vec3_add(quat_rotate_inverse(m.q_nb, FIELD_N), magnet_b_uT),
			.flags = SAMPLE_MAG,
		};

		fusion_step(f, &sample, dt_s);
		east = quat_rotate(f->q_nb, quat_rotate_inverse(m.q_nb, (struct vec3){1, 0, 0}));
		if (t == from_s)
			east_from = east;
	}
	return remainder(atan2(east.y, east.x) - atan2(east_from.y, east_from.x), 2 * PI);
}

static void test_a_scale_error_of_three_permille_is_estimated_without_a_magnetometer(void **state)
{
	const struct vec3 scale = {0.003, 0.003, 0.003};
	struct fusion f = fusion(0, 0.002);

	(void)state;
	turn(&f, scale, ZERO, 0, 120);
	assert_vec_near(f.gyro_errors.scale_b, scale, 0.0008);
	f.gyro_errors.bias_b_rad_s = ZERO;
	assert_near(fusion_rate_b(&f, (struct vec3){0, 0, 3}).z, 3 * (1 + f.gyro_errors.scale_b.z), 1e-12);
}

static void test_the_heading_drifts_a_fifth_as_much_with_the_scale_estimated(void **state)
{
	const struct vec3 scale = {0.003, 0.003, 0.003};
	struct fusion adaptive = fusion(0, 0.002), constant = fusion(0, 0);
	double estimated, fixed;

	(void)state;
	turn(&adaptive, scale, ZERO, 0, 60);
	turn(&constant, scale, ZERO, 0, 60);
	estimated = turn(&adaptive, scale, ZERO, 60, 120);
	fixed = turn(&constant, scale, ZERO, 60, 120);
	print_message("heading after a minute of turning: %.2f degrees, with the scale estimated %.2f\n",
		fixed / RAD_PER_DEG, estimated / RAD_PER_DEG);
	assert_true(fabs(fixed) > 5 * RAD_PER_DEG);
	assert_true(fabs(estimated) < fabs(fixed) / 5);
}

static void test_a_scale_sigma_of_zero_switches_the_estimation_off(void **state)
{
	struct fusion f = fusion(1, 0);

	(void)state;
	turn(&f, (struct vec3){0.01, 0.01, 0.01}, ZERO, 0, 30);
	assert_vec_near(f.gyro_errors.scale_b, ZERO, 0);
}

static void test_a_magnet_in_the_object_does_not_disturb_the_scale(void **state)
{
	struct fusion f = fusion(1, 0.002);

	(void)state;
	turn(&f, ZERO, (struct vec3){12, -8, 5}, 0, 60);
	assert_vec_near(f.gyro_errors.scale_b, ZERO, 0.0002);
}

static void test_the_scale_estimate_stays_within_five_sigma(void **state)
{
	struct fusion f = fusion(0, 0.001);

	(void)state;
	turn(&f, (struct vec3){0.05, 0.05, 0.05}, ZERO, 0, 120);
	assert_near(vec3_norm(f.gyro_errors.scale_b), 0.005, 1e-6);
}

static void test_a_new_sigma_gyro_calibration_mounting_or_algorithm_resets_the_scale(void **state)
{
	const struct vec3 scale = {0.003, 0.003, 0.003};
	struct fusion estimated = fusion(0, 0.002), f;
	struct fusion_config config;

	(void)state;
	turn(&estimated, scale, ZERO, 0, 30);
	assert_true(vec3_norm(estimated.gyro_errors.scale_b) > 0.001);

	f = estimated;
	config = f.config;
	config.kalman.field_limit = 0.2;
	assert_int_equal(fusion_configure(&f, &config), 0);
	assert_vec_near(f.gyro_errors.scale_b, estimated.gyro_errors.scale_b, 0);
	config.kalman.gyro_scale_sigma = 0.004;
	assert_int_equal(fusion_configure(&f, &config), 0);
	assert_vec_near(f.gyro_errors.scale_b, ZERO, 0);

	f = estimated;
	config.algorithm = FUSION_MAHONY;
	assert_int_equal(fusion_configure(&f, &config), 0);
	assert_vec_near(f.gyro_errors.scale_b, ZERO, 0);

	f = estimated;
	fusion_reset_gyro_errors(&f);
	assert_vec_near(f.gyro_errors.scale_b, ZERO, 0);

	f = estimated;
	fusion_turn_object(&f, quat_from_rotation_vector((struct vec3){1, 0, 0}));
	assert_vec_near(f.gyro_errors.scale_b, ZERO, 0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_scale_error_of_three_permille_is_estimated_without_a_magnetometer),
		cmocka_unit_test(test_the_heading_drifts_a_fifth_as_much_with_the_scale_estimated),
		cmocka_unit_test(test_a_scale_sigma_of_zero_switches_the_estimation_off),
		cmocka_unit_test(test_a_magnet_in_the_object_does_not_disturb_the_scale),
		cmocka_unit_test(test_the_scale_estimate_stays_within_five_sigma),
		cmocka_unit_test(test_a_new_sigma_gyro_calibration_mounting_or_algorithm_resets_the_scale),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
