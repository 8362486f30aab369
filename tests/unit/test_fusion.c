/* Attitude by Madgwick's and Mahony's filters: an independent gradient, known motions, bad input. */
#include "model_test.h"

#include "model/fusion.h"
#include "model/math/rotation.h"

static const double G = 9.81, DT_S = 0.01;
static const struct vec3 FIELD_N = {0, 20, -45}; /* magnetic north, dipping, micro-tesla */

static const struct fusion_config MADGWICK = {
	.algorithm = FUSION_MADGWICK,
	.use_magnetometer = 1,
	.madgwick_beta = 0.1,
	.mahony_kp_rad_s = 0.74,
	.kalman = FUSION_KALMAN_DEFAULTS,
};
static const struct fusion_config MAHONY = {
	.algorithm = FUSION_MAHONY,
	.use_magnetometer = 1,
	.madgwick_beta = 0.1,
	.mahony_kp_rad_s = 0.74,
	.kalman = FUSION_KALMAN_DEFAULTS,
};

static struct fusion_config six_axes(struct fusion_config config)
{
	config.use_magnetometer = 0;
	return config;
}

static struct fusion fusion(struct fusion_config config)
{
	struct fusion f;

	assert_int_equal(fusion_init(&f, &config), 0);
	return f;
}

/* The sample of ideal sensors at rest in this attitude. */
static struct imu_sample seen_from(struct quat q_nb)
{
	return (struct imu_sample){
		.accel_m_s2 = quat_rotate_inverse(q_nb, (struct vec3){0, 0, G}),
		.mag_uT = quat_rotate_inverse(q_nb, FIELD_N),
		.flags = SAMPLE_MAG,
	};
}

/* A filter whose attitude is `start`, north included. */
static struct fusion standing(struct fusion_config config, struct quat start)
{
	struct fusion f = fusion(config);
	struct imu_sample s = seen_from(start);

	fusion_step(&f, &s, DT_S);
	return f;
}

static void test_the_first_sample_gives_the_attitude(void **state)
{
	(void)state;
	for (int i = 0; i < 1000; i++) {
		struct quat truth = any_attitude();

		assert_quat_near(standing(MADGWICK, truth).q_nb, truth, 1e-7);
		assert_quat_near(standing(MAHONY, truth).q_nb, truth, 1e-7);
	}
}

static void test_without_a_magnetometer_the_heading_starts_at_zero(void **state)
{
	struct vec3 angles = {0.4, -0.6, 1.7};
	struct fusion f = standing(six_axes(MADGWICK), quat_from_aerospace(angles));

	(void)state;
	angles.z = 0;
	assert_vec_near(aerospace_from_quat(f.q_nb), angles, 1e-12);
	assert_false(fusion_mag_used(&f));
}

static void test_the_first_magnetometer_sample_sets_the_heading_at_once(void **state)
{
	struct quat truth = quat_from_aerospace((struct vec3){0.4, -0.6, 3.0});
	struct imu_sample blind = seen_from(truth), s = blind;
	struct fusion f = fusion(MADGWICK);

	(void)state;
	blind.flags = 0;
	for (int k = 0; k < 3; k++)
		fusion_step(&f, &blind, DT_S);
	assert_near(aerospace_from_quat(f.q_nb).z, 0, 1e-9);
	fusion_step(&f, &s, DT_S);
	assert_quat_near(f.q_nb, truth, 1e-9);
}

static void test_a_constant_turn_is_followed_exactly(void **state)
{
	const struct vec3 omega = {0.5, -1, 2};
	const struct fusion_config configs[] = {MADGWICK, MAHONY};

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct quat truth = any_attitude();
		struct quat turn = quat_from_rotation_vector(vec3_scale(DT_S, omega));
		struct fusion f = standing(configs[i], truth);

		f.last_gyro_b_rad_s = omega;
		for (int k = 0; k < 1000; k++) {
			struct imu_sample s;

			truth = quat_multiply(truth, turn);
			s = seen_from(truth);
			s.gyro_rad_s = omega;
			fusion_step(&f, &s, DT_S);
		}
		assert_quat_near(f.q_nb, truth, 1e-7);
	}
}

/* Madgwick's objective: half the squared distance of the predicted from the measured directions. */
static double objective(struct quat q, const struct imu_sample *s, struct vec3 field_n)
{
	struct vec3 up = vec3_scale(1 / vec3_norm(s->accel_m_s2), s->accel_m_s2);
	struct vec3 m = vec3_scale(1 / vec3_norm(s->mag_uT), s->mag_uT);
	struct vec3 f = vec3_sub(quat_rotate_inverse(q, (struct vec3){0, 0, 1}), up);
	struct vec3 h = vec3_sub(quat_rotate_inverse(q, field_n), m);

	return (vec3_dot(f, f) + vec3_dot(h, h)) / 2;
}

static void test_madgwicks_step_goes_down_the_gradient_of_his_objective_with_length_2_beta(void **state)
{
	(void)state;
	for (int i = 0; i < 100; i++) {
		struct quat truth = any_attitude();
		struct quat off = quat_from_rotation_vector(any_vec(0.3));
		struct fusion f = standing(MADGWICK, quat_multiply(truth, off));
		struct imu_sample s = seen_from(truth);
		struct quat before = f.q_nb, moved;
		struct vec3 h = quat_rotate(before, s.mag_uT), down, step;
		struct vec3 field_n = {0, hypot(h.x, h.y), h.z};
		double d[3], e = 1e-6;

		field_n = vec3_scale(1 / vec3_norm(field_n), field_n);
		for (int axis = 0; axis < 3; axis++) {
			struct vec3 nudge = {axis == 0 ? e : 0, axis == 1 ? e : 0, axis == 2 ? e : 0};
			struct quat plus = quat_multiply(before, quat_from_rotation_vector(nudge));
			struct quat minus = quat_multiply(before, quat_conjugate(quat_from_rotation_vector(nudge)));

			d[axis] = (objective(plus, &s, field_n) - objective(minus, &s, field_n)) / (2 * e);
		}
		down = vec3_scale(-1 / vec3_norm((struct vec3){d[0], d[1], d[2]}), (struct vec3){d[0], d[1], d[2]});
		fusion_step(&f, &s, DT_S);
		moved = quat_multiply(quat_conjugate(before), f.q_nb);
		step = (struct vec3){2 * moved.x, 2 * moved.y, 2 * moved.z};
		assert_vec_near(step, vec3_scale(2 * 0.1 * DT_S, down), 1e-8);
	}
}

static void test_madgwick_converges_to_the_truth_without_chatter(void **state)
{
	struct quat truth = any_attitude();
	struct fusion f =
		standing(MADGWICK, quat_multiply(truth, quat_from_rotation_vector((struct vec3){0.2, 0.1, 0})));
	struct imu_sample s = seen_from(truth);

	(void)state;
	for (int k = 0; k < 1000; k++)
		fusion_step(&f, &s, DT_S);
	assert_quat_near(f.q_nb, truth, 1e-7);
}

static void test_mahonys_tilt_error_decays_with_the_time_constant_1_over_kp(void **state)
{
	struct quat truth = QUAT_IDENTITY;
	struct quat off = quat_from_rotation_vector((struct vec3){0.01, 0, 0});
	struct fusion f = standing(six_axes(MAHONY), off);
	struct imu_sample s = seen_from(truth);
	int steps = (int)(1 / (0.74 * DT_S));

	(void)state;
	for (int k = 0; k < steps; k++)
		fusion_step(&f, &s, DT_S);
	assert_near(quat_apart_rad(f.q_nb, truth), 0.01 * pow(1 - 0.74 * DT_S, steps), 1e-7);
}

static void test_mahonys_integral_estimates_the_gyro_bias(void **state)
{
	struct fusion_config config = MAHONY;
	const struct vec3 bias = {0.02, -0.01, 0.03};
	struct quat truth = any_attitude();
	struct imu_sample s = seen_from(truth);
	struct fusion f;

	(void)state;
	config.mahony_ki_rad_s2 = 0.2;
	f = standing(config, truth);
	s.gyro_rad_s = bias;
	for (int k = 0; k < 20000; k++)
		fusion_step(&f, &s, DT_S);
	assert_vec_near(f.gyro_errors.bias_b_rad_s, bias, 1e-4);
	assert_quat_near(f.q_nb, truth, 1e-3);
}

static void test_switching_the_algorithm_keeps_the_attitude(void **state)
{
	struct quat truth = any_attitude();
	struct fusion f = standing(MADGWICK, truth);

	(void)state;
	assert_int_equal(fusion_configure(&f, &MAHONY), 0);
	assert_quat_near(f.q_nb, truth, 1e-7);
	assert_true(fusion_started(&f));
}

static void test_the_rate_at_rest_is_subtracted_as_the_gyro_bias(void **state)
{
	const struct vec3 shown = {0.02, 0, -0.04};
	struct fusion f = standing(six_axes(MADGWICK), QUAT_IDENTITY);
	struct imu_sample s = seen_from(QUAT_IDENTITY);

	(void)state;
	fusion_update_bias_at_rest(&f, shown, DT_S);
	assert_vec_near(f.gyro_errors.bias_b_rad_s, shown, 1e-15);
	s.gyro_rad_s = f.last_gyro_b_rad_s = shown;
	fusion_step(&f, &s, 1);
	assert_quat_near(f.q_nb, QUAT_IDENTITY, 1e-9);
	fusion_reset_gyro_errors(&f);
	assert_vec_near(f.gyro_errors.bias_b_rad_s, ((struct vec3){0, 0, 0}), 0);
	fusion_update_bias_at_rest(&f, shown, DT_S); /* the first of a new mean */
	assert_vec_near(f.gyro_errors.bias_b_rad_s, shown, 1e-15);
}

static void test_the_bias_is_the_mean_over_rest_and_follows_its_drift(void **state)
{
	const struct vec3 old = {0.02, 0, 0}, new = {0.01, 0, 0}, more = {0.002, 0, 0};
	struct fusion f = fusion(MADGWICK);

	(void)state;
	for (int k = 0; k < 500; k++)
		fusion_update_bias_at_rest(&f, k % 2 ? vec3_add(old, more) : vec3_sub(old, more), DT_S);
	assert_vec_near(f.gyro_errors.bias_b_rad_s, old, 1e-9);
	for (int k = 0; k < 30000; k++)
		fusion_update_bias_at_rest(&f, new, DT_S);
	assert_vec_near(f.gyro_errors.bias_b_rad_s, new, 1e-4);
}

static void test_magnetometer_samples_missing_now_and_then_still_hold_the_heading(void **state)
{
	const struct vec3 drift_n = {0, 0, 0.01};
	struct quat truth = any_attitude();
	struct fusion f = standing(MAHONY, truth);

	(void)state;
	for (int k = 0; k < 10000; k++) {
		struct imu_sample s = seen_from(truth);

		s.gyro_rad_s = quat_rotate_inverse(truth, drift_n);
		s.flags = k % 3 == 0 ? SAMPLE_MAG : 0;
		fusion_step(&f, &s, DT_S);
		assert_true(fusion_mag_used(&f) == (k % 3 == 0));
	}
	assert_true(quat_apart_rad(f.q_nb, truth) < 0.4); /* the gyro alone drifts 1 rad */
}

static void test_measurements_without_a_direction_are_not_used(void **state)
{
	struct quat truth = any_attitude();
	const struct imu_sample useless[] = {
		{.accel_m_s2 = {0, 0, 0}, .mag_uT = {0, 0, 0}, .flags = SAMPLE_MAG},
		{.accel_m_s2 = {NAN, 0, 0}, .mag_uT = {INFINITY, 0, 0}, .flags = SAMPLE_MAG},
	};
	struct fusion f = standing(MADGWICK, truth);

	(void)state;
	for (int i = 0; i < 2; i++) {
		fusion_step(&f, &useless[i], DT_S);
		assert_quat_near(f.q_nb, truth, 1e-7);
		assert_false(fusion_mag_used(&f));
	}
}

static void test_a_vertical_field_does_not_set_the_heading(void **state)
{
	struct quat truth = quat_from_aerospace((struct vec3){0.4, -0.6, 0});
	struct imu_sample s = seen_from(truth);
	struct fusion f = fusion(MADGWICK);

	(void)state;
	s.mag_uT = quat_rotate_inverse(truth, (struct vec3){0, 0, -45});
	fusion_step(&f, &s, DT_S);
	assert_false(fusion_mag_used(&f));
	assert_quat_near(f.q_nb, truth, 1e-7);
}

static void test_free_fall_does_not_start_the_filter(void **state)
{
	const struct imu_sample falling = {.mag_uT = {0, 20, -45}, .flags = SAMPLE_MAG};
	struct quat truth = any_attitude();
	struct imu_sample s = seen_from(truth);
	struct fusion f = fusion(MADGWICK);

	(void)state;
	fusion_step(&f, &falling, DT_S);
	assert_false(fusion_started(&f));
	fusion_step(&f, &s, DT_S);
	assert_quat_near(f.q_nb, truth, 1e-7);
}

static void test_a_restart_without_a_magnetometer_keeps_the_heading(void **state)
{
	struct quat later = quat_from_aerospace((struct vec3){-0.2, 0.3, 0});
	struct imu_sample s = seen_from(later);
	struct fusion f = standing(MADGWICK, quat_from_aerospace((struct vec3){0.1, 0.2, 2.1}));

	(void)state;
	s.flags = 0;
	fusion_restart(&f, 2);
	fusion_step(&f, &s, DT_S);
	assert_vec_near(aerospace_from_quat(f.q_nb), ((struct vec3){-0.2, 0.3, 2.1}), 1e-9);
}

static void test_a_turned_object_frame_turns_the_attitude_and_not_the_world(void **state)
{
	struct quat truth = any_attitude(), turn = any_attitude();
	struct fusion f = standing(MADGWICK, truth);
	struct vec3 v_old = any_vec(1), v_new = quat_rotate(turn, v_old);

	(void)state;
	fusion_turn_object(&f, turn);
	assert_vec_near(quat_rotate(f.q_nb, v_new), quat_rotate(truth, v_old), 1e-6);
}

/* What is known of the sensors is that of the same directions in space, by other names. */
static void test_a_turned_object_frame_turns_the_gyros_bias(void **state)
{
	const struct quat turn = any_attitude();
	const struct vec3 bias = {0.01, -0.02, 0.03};
	struct fusion f = standing(MADGWICK, any_attitude());

	(void)state;
	f.gyro_errors.bias_b_rad_s = bias;
	fusion_turn_object(&f, turn);
	assert_vec_near(f.gyro_errors.bias_b_rad_s, quat_rotate(turn, bias), 1e-12);
}

static void test_a_step_of_any_length_keeps_the_attitude_finite(void **state)
{
	struct quat truth = any_attitude();
	struct imu_sample s = seen_from(truth);
	struct fusion madgwick = standing(MADGWICK, truth), mahony = standing(MAHONY, truth);

	(void)state;
	s.gyro_rad_s = (struct vec3){1000, 1000, -1000};
	for (double dt_s = 1e-6; dt_s < 1e13; dt_s *= 10) {
		fusion_step(&madgwick, &s, dt_s);
		fusion_step(&mahony, &s, dt_s);
		assert_near(quat_apart_rad(madgwick.q_nb, madgwick.q_nb), 0, 1e-6);
		assert_near(quat_apart_rad(mahony.q_nb, mahony.q_nb), 0, 1e-6);
	}
}

static void turn_about_z(struct fusion *f, double rate_rad_s, double dt_s)
{
	const struct imu_sample sample = {.gyro_rad_s = {0, 0, rate_rad_s}, .accel_m_s2 = {0, 0, G}};

	fusion_step(f, &sample, dt_s);
}

/* To and fro about z at 1 to 3 Hz, and at some phase of it 60 ms without a sample: the turn is not the mean of the
 * rates at both ends. Its sigma covers the difference, which the integral of the rate tells, and is not ten times as
 * large. */
static void test_sigma_covers_a_turn_to_and_fro_while_samples_are_missing(void **state)
{
	const double interval_s = 0.005, missing_s = 0.06, most_rad_s = 5;
	double square[3] = {0}, sigma2[3] = {0};

	(void)state;
	for (int i = 0; i < 60; i++) {
		const double omega = 2 * PI * (1 + i % 3);
		struct fusion_config config = MADGWICK;
		struct fusion f;
		double t = 0, end, before, off, sigma;

		config.algorithm = FUSION_KALMAN;
		config.interval_s = interval_s;
		f = fusion(six_axes(config));
		for (int k = 0; k < 800 + 7 * i; k++, t += interval_s) {
			turn_about_z(&f, most_rad_s * cos(omega * t), interval_s);
			assert_near(f.unseen_turn_rad, 0, 0);
		}
		t -= interval_s;
		end = t + missing_s;
		before = f.kalman.covariance[2][2];
		turn_about_z(&f, most_rad_s * cos(omega * end), missing_s);
		sigma = f.unseen_turn_rad;
		off = most_rad_s * ((sin(omega * end) - sin(omega * t)) / omega -
					   missing_s / 2 * (cos(omega * end) + cos(omega * t)));
		assert_true(fabs(off) < 3 * sigma);
		assert_true(f.kalman.covariance[2][2] - before > 0.99 * sigma * sigma);
		square[i % 3] += off * off;
		sigma2[i % 3] += sigma * sigma;
	}
	for (int i = 0; i < 3; i++)
		assert_true(square[i] < sigma2[i] && square[i] > sigma2[i] / 100);
}

static void test_a_configuration_out_of_range_is_refused_and_the_old_one_stays(void **state)
{
	struct fusion_config bad[6];
	struct fusion f = standing(MAHONY, QUAT_IDENTITY), fresh;

	(void)state;
	for (int i = 0; i < 6; i++)
		bad[i] = MADGWICK;
	bad[0].algorithm = (enum fusion_algorithm)3;
	bad[1].use_magnetometer = 2;
	bad[2].madgwick_beta = -0.1;
	bad[3].madgwick_beta = NAN;
	bad[4].mahony_kp_rad_s = 101;
	bad[5].mahony_ki_rad_s2 = INFINITY;
	for (int i = 0; i < 6; i++) {
		assert_int_equal(fusion_init(&fresh, &bad[i]), -EINVAL);
		assert_int_equal(fusion_configure(&f, &bad[i]), -EINVAL);
		assert_int_equal(f.config.algorithm, FUSION_MAHONY);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_first_sample_gives_the_attitude),
		cmocka_unit_test(test_without_a_magnetometer_the_heading_starts_at_zero),
		cmocka_unit_test(test_the_first_magnetometer_sample_sets_the_heading_at_once),
		cmocka_unit_test(test_a_constant_turn_is_followed_exactly),
		cmocka_unit_test(test_madgwicks_step_goes_down_the_gradient_of_his_objective_with_length_2_beta),
		cmocka_unit_test(test_madgwick_converges_to_the_truth_without_chatter),
		cmocka_unit_test(test_mahonys_tilt_error_decays_with_the_time_constant_1_over_kp),
		cmocka_unit_test(test_mahonys_integral_estimates_the_gyro_bias),
		cmocka_unit_test(test_switching_the_algorithm_keeps_the_attitude),
		cmocka_unit_test(test_the_rate_at_rest_is_subtracted_as_the_gyro_bias),
		cmocka_unit_test(test_the_bias_is_the_mean_over_rest_and_follows_its_drift),
		cmocka_unit_test(test_magnetometer_samples_missing_now_and_then_still_hold_the_heading),
		cmocka_unit_test(test_measurements_without_a_direction_are_not_used),
		cmocka_unit_test(test_a_vertical_field_does_not_set_the_heading),
		cmocka_unit_test(test_free_fall_does_not_start_the_filter),
		cmocka_unit_test(test_a_restart_without_a_magnetometer_keeps_the_heading),
		cmocka_unit_test(test_a_turned_object_frame_turns_the_attitude_and_not_the_world),
		cmocka_unit_test(test_a_turned_object_frame_turns_the_gyros_bias),
		cmocka_unit_test(test_a_step_of_any_length_keeps_the_attitude_finite),
		cmocka_unit_test(test_sigma_covers_a_turn_to_and_fro_while_samples_are_missing),
		cmocka_unit_test(test_a_configuration_out_of_range_is_refused_and_the_old_one_stays),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
