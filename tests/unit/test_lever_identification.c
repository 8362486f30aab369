/* Identification of the lever arm from simulated sensors on analytical motions, with the true value known. */
#include <string.h>

#include "model/identify/lever_identification.h"
#include "model/sim/sensor.h"
#include "tests/unit/model_test.h"

static const struct vec3 ARM = {0.06, -0.05, 0.0624}; /* 100 mm */

/* Rotation of the object and translation of its reference point. */
struct scene {
	struct vec3 swing_rad, swing_hz; /* amplitude and frequency of roll, pitch, yaw */
	struct vec3 travel_m, travel_hz; /* amplitude and frequency of the reference point, global frame */
	double travel_ahead_s;
	double seconds, rate_hz;
	const char *sensor;
	struct vec3 arm_b_m;
	bool reference, estimate_delay;
	double delay_s; /* of the reference */
	int hold;	/* samples for which a value of the reference is held */
	struct vec3 gyro_bias_rad_s, accel_bias_m_s2;
	double nominal_hz; /* configured sampling rate; 0: rate_hz */
	int pause_each;	   /* no samples in the second half of each pause_each samples */
	int every_lost;	   /* each n-th sample is lost */
	int every_bad;	   /* each n-th sample is no number */
	uint64_t seed;
};

static const struct scene BY_HAND = {
	.swing_rad = {0.9, 0.7, 1.1},
	.swing_hz = {0.61, 0.83, 0.47},
	.seconds = 30,
	.rate_hz = 100,
	.sensor = "lsm303dlhc_l3gd20_fine",
	.arm_b_m = {0.06, -0.05, 0.0624},
	.hold = 1,
};

static struct scene with_reference(double delay_s)
{
	struct scene s = BY_HAND;

	s.travel_m = (struct vec3){0.3, 0.2, 0.1};
	s.travel_hz = (struct vec3){0.7, 0.9, 1.1};
	s.reference = s.estimate_delay = true;
	s.delay_s = delay_s;
	return s;
}

static double swing(double size, double hz, double t_s, double derivative[2])
{
	const double w = 2 * PI * hz, phase = w * t_s;

	derivative[0] = size * w * cos(phase);
	derivative[1] = -size * w * w * sin(phase);
	return size * sin(phase);
}

static struct quat attitude(const struct scene *s, double t_s)
{
	double unused[2];

	return quat_multiply(
		quat_from_rotation_vector((struct vec3){0, 0, swing(s->swing_rad.z, s->swing_hz.z, t_s, unused)}),
		quat_multiply(quat_from_rotation_vector(
				      (struct vec3){0, swing(s->swing_rad.y, s->swing_hz.y, t_s, unused), 0}),
			quat_from_rotation_vector(
				(struct vec3){swing(s->swing_rad.x, s->swing_hz.x, t_s, unused), 0, 0})));
}

/* Body rate from two attitudes 0.2 ms apart: exact to 1e-9. */
static struct vec3 rate(const struct scene *s, double t_s)
{
	const double h = 1e-4;
	struct quat d = quat_multiply(quat_conjugate(attitude(s, t_s - h)), attitude(s, t_s + h));

	return vec3_scale((d.w < 0 ? -1 : 1) / h, (struct vec3){d.x, d.y, d.z});
}

static struct vec3 travel_accel(const struct scene *s, double t_s)
{
	double x[2], y[2], z[2];

	swing(s->travel_m.x, s->travel_hz.x, t_s + s->travel_ahead_s, x);
	swing(s->travel_m.y, s->travel_hz.y, t_s + s->travel_ahead_s, y);
	swing(s->travel_m.z, s->travel_hz.z, t_s + s->travel_ahead_s, z);
	return (struct vec3){x[1], y[1], z[1]};
}

static struct vec3 reference_at(const struct scene *s, double t_s)
{
	return quat_rotate_inverse(attitude(s, t_s), travel_accel(s, t_s));
}

static void truth_at(const struct scene *s, double t_s, struct signal_truth *truth)
{
	const double h = 1e-3;

	*truth = (struct signal_truth){.t_s = t_s, .q_nb = attitude(s, t_s), .omega_b_rad_s = rate(s, t_s)};
	truth->alpha_b_rad_s2 = vec3_scale(1 / (2 * h), vec3_sub(rate(s, t_s + h), rate(s, t_s - h)));
	truth->accel_n_m_s2 = travel_accel(s, t_s);
}

static struct sensor sensor_of(const struct scene *s)
{
	struct sensor_config config = *sensor_preset(s->sensor);
	struct sensor sensor;

	config.rate_hz = s->rate_hz;
	config.lever_arm_b_m = s->arm_b_m;
	config.gyro.range = config.accel.range = 1e3;
	sensor_calibrate(&config);
	assert_int_equal(sensor_init(&sensor, &config, s->seed), 0);
	return sensor;
}

static struct lever_identification id;

static struct lever_estimate identify(const struct scene *s)
{
	const struct lever_identification_config config = {.rate_hz = s->nominal_hz > 0 ? s->nominal_hz : s->rate_hz,
		.duration_s = 30,
		.reference = s->reference,
		.estimate_delay = s->estimate_delay};
	struct sensor sensor = sensor_of(s);
	const int count = (int)(s->seconds * s->rate_hz);
	struct vec3 ref = {0, 0, 0};

	assert_int_equal(lever_identification_init(&id, &config), 0);
	for (int k = 0; k < count; k++) {
		struct signal_truth truth;
		struct imu_sample sample;
		const double t_s = sensor_instant_s(&sensor);

		truth_at(s, t_s, &truth);
		sensor_measure(&sensor, &truth, &sample);
		if (k % s->hold == 0)
			ref = reference_at(s, t_s - s->delay_s);
		if (s->every_lost && k % s->every_lost == 0)
			continue;
		if (s->pause_each && k % s->pause_each > s->pause_each / 2)
			continue;
		if (s->every_bad && k % s->every_bad == 0)
			sample.gyro_rad_s.y = NAN;
		lever_identification_step(&id, sample.t_us, vec3_add(sample.gyro_rad_s, s->gyro_bias_rad_s),
			vec3_add(sample.accel_m_s2, s->accel_bias_m_s2), s->reference ? &ref : NULL);
	}
	return lever_identification_estimate(&id);
}

static void assert_found(const struct lever_estimate *e, struct vec3 arm_b_m, double tolerance_m)
{
	if (e->verdict != LEVER_FOUND)
		fail_msg("%s", lever_verdict_text(e->verdict));
	assert_vec_near(e->lever_arm_b_m, arm_b_m, tolerance_m);
}

/* ---- reference point held still ---------------------------------------------------------------------------------- */

static void test_with_the_reference_point_held_100_mm_are_identified_within_1_mm(void **state)
{
	(void)state;
	for (uint64_t seed = 1; seed <= 5; seed++) {
		struct scene s = BY_HAND;

		s.seed = seed;
		struct lever_estimate e = identify(&s);
		assert_found(&e, ARM, 0.001);
		assert_int_equal(e.progress_percent, 96); /* 29 windows of 1 s: the filters settle first */
	}
}

static void test_the_result_is_the_same_at_every_usual_sampling_rate(void **state)
{
	const double rates_hz[] = {50, 100, 200, 286, 500, 1000};

	(void)state;
	for (size_t i = 0; i < sizeof(rates_hz) / sizeof(rates_hz[0]); i++) {
		struct scene s = BY_HAND;

		s.rate_hz = rates_hz[i];
		struct lever_estimate e = identify(&s);
		assert_found(&e, ARM, 0.001);
	}
}

static void test_biases_and_lost_samples_cost_less_than_1_mm(void **state)
{
	struct scene s = BY_HAND;

	(void)state;
	s.gyro_bias_rad_s = (struct vec3){0.3 * RAD_PER_DEG, -0.3 * RAD_PER_DEG, 0.2 * RAD_PER_DEG};
	s.accel_bias_m_s2 = (struct vec3){0.3, -0.2, 0.4};
	s.every_lost = 17;
	struct lever_estimate e = identify(&s);
	assert_found(&e, ARM, 0.001);
}

static void test_drift_of_gravity_by_a_gyro_bias_is_eliminated(void **state)
{
	struct scene s = BY_HAND;

	(void)state;
	struct lever_estimate without = identify(&s);
	s.gyro_bias_rad_s = (struct vec3){1 * RAD_PER_DEG, -1 * RAD_PER_DEG, 1 * RAD_PER_DEG};
	struct lever_estimate with = identify(&s);
	assert_found(&with, ARM, 0.001);
	assert_true(with.residual_m_s2 < 2 * without.residual_m_s2);
}

static void test_gaps_of_seconds_do_not_change_the_result(void **state)
{
	struct scene s = BY_HAND;

	(void)state;
	s.pause_each = 700; /* 3.5 s of samples, 3.5 s without */
	s.seconds = 60;
	struct lever_estimate e = identify(&s);
	assert_found(&e, ARM, 0.001);
}

static void test_the_actual_sampling_rate_is_tracked(void **state)
{
	struct scene s = BY_HAND;

	(void)state;
	s.rate_hz = 104;
	s.nominal_hz = 100;
	struct lever_estimate e = identify(&s);
	assert_found(&e, ARM, 0.001);
}

static void test_a_lever_arm_of_zero_is_identified_as_zero(void **state)
{
	struct scene s = BY_HAND;

	(void)state;
	s.arm_b_m = (struct vec3){0, 0, 0};
	struct lever_estimate e = identify(&s);
	assert_found(&e, s.arm_b_m, 0.0005);
}

/* ---- with a reference ----------------------------------------------------------------------------------- */

static void test_with_a_reference_100_mm_are_identified_within_1_mm(void **state)
{
	(void)state;
	for (uint64_t seed = 1; seed <= 5; seed++) {
		struct scene s = with_reference(0);

		s.seed = seed;
		struct lever_estimate e = identify(&s);
		assert_found(&e, ARM, 0.001);
	}
}

static void test_the_delay_of_a_reference_is_estimated(void **state)
{
	const double delays_s[] = {-0.01, -0.002, 0.005, 0.01};

	(void)state;
	for (size_t i = 0; i < sizeof(delays_s) / sizeof(delays_s[0]); i++) {
		struct scene s = with_reference(delays_s[i]);
		struct lever_estimate e = identify(&s);

		assert_found(&e, ARM, 0.001);
		assert_near(
			e.delay_s, delays_s[i] - 1 / (2 * PI * 50), 0.001); /* delay of the sensor by its bandwidth */
	}
}

static void test_the_reference_of_a_quick_movement_can_be_15_ms_late(void **state)
{
	struct scene s = with_reference(0.015);

	(void)state;
	s.travel_m = (struct vec3){0.02, 0.02, 0.02};
	s.travel_hz = (struct vec3){3.1, 3.7, 4.3};
	struct lever_estimate e = identify(&s);
	assert_found(&e, ARM, 0.001);
	assert_true(e.residual_m_s2 <
		    0.15); /* of accelerations up to 15 m/s^2; the delay is expanded to the second order */
}

static void test_a_reference_of_100_hz_suffices_for_samples_at_200_hz(void **state)
{
	struct scene s = with_reference(0.004);

	(void)state;
	s.rate_hz = 200;
	s.hold = 2;
	struct lever_estimate e = identify(&s);
	assert_found(&e, ARM, 0.001);
}

static void test_a_delay_that_is_not_estimated_increases_sigma_by_its_effect(void **state)
{
	struct scene s = with_reference(0.01);

	(void)state;
	/* sideways a quarter of a period ahead of the roll: a delay looks like a longer lever arm */
	s.travel_m = (struct vec3){0, 0.5, 0};
	s.travel_hz.y = s.swing_hz.x;
	s.travel_ahead_s = 0.25 / s.swing_hz.x;
	struct lever_estimate corrected = identify(&s);
	s.estimate_delay = false;
	struct lever_estimate e = identify(&s);
	struct vec3 off = vec3_sub(e.lever_arm_b_m, corrected.lever_arm_b_m);
	assert_true(vec3_norm(off) > 0.002);
	assert_true(e.sigma_b_m.x >= fabs(off.x) && e.sigma_b_m.y >= fabs(off.y) && e.sigma_b_m.z >= fabs(off.z));
	assert_near(e.delay_s, corrected.delay_s, 1e-6);
}

/* ---- sigma ------------------------------------------------------------------------------------------------------- */

/* A coarse sensor, whose noise is larger than all systematic errors. The normalised error squared has the mean 1 if
 * sigma is right (a little more for the Student distribution of few windows). */
static void test_the_noise_sigma_matches_the_scatter_over_60_seeds_and_the_error_is_below_3_sigma(void **state)
{
	double squares = 0;
	const int seeds = 60;

	(void)state;
	for (int seed = 1; seed <= seeds; seed++) {
		struct scene s = BY_HAND;

		s.sensor = "lsm303dlhc_l3gd20";
		s.seed = (uint64_t)seed;
		s.swing_hz = (struct vec3){0.31, 0.43, 0.37};
		struct lever_estimate e = identify(&s);
		struct vec3 off = vec3_sub(e.lever_arm_b_m, ARM), n = e.noise_sigma_b_m;
		assert_int_equal(e.verdict, LEVER_FOUND);
		assert_true(fabs(off.x) < 3 * e.sigma_b_m.x && fabs(off.y) < 3 * e.sigma_b_m.y &&
			    fabs(off.z) < 3 * e.sigma_b_m.z);
		squares +=
			(off.x * off.x / (n.x * n.x) + off.y * off.y / (n.y * n.y) + off.z * off.z / (n.z * n.z)) / 3;
	}
	print_message("normalised error squared: %.2f\n", squares / seeds);
	assert_true(squares / seeds > 0.5 && squares / seeds < 2);
}

/* ---- refusals ---------------------------------------------------------------------------------------------------- */

static void test_rotation_about_one_axis_is_refused_and_the_axis_named(void **state)
{
	const enum lever_verdict blind[] = {LEVER_BLIND_L, LEVER_BLIND_S, LEVER_BLIND_T};

	(void)state;
	for (int axis = 0; axis < 3; axis++) {
		struct scene s = BY_HAND;

		s.swing_rad = (struct vec3){axis == 0, axis == 1, axis == 2};
		assert_int_equal(identify(&s).verdict, blind[axis]);
	}
}

static void test_rotation_about_two_axes_suffices(void **state)
{
	struct scene s = BY_HAND;

	(void)state;
	s.swing_rad.z = 0;
	struct lever_estimate e = identify(&s);
	assert_found(&e, ARM, 0.001);
}

static void test_a_reference_point_that_moves_is_refused_as_not_held(void **state)
{
	struct scene s = BY_HAND;

	(void)state;
	s.travel_m = (struct vec3){0.03, 0.03, 0.03};
	s.travel_hz = (struct vec3){0.8, 0.9, 1.1};
	assert_int_equal(identify(&s).verdict, LEVER_NOT_HELD);
}

static void test_the_reference_of_another_motion_is_refused(void **state)
{
	struct scene s = with_reference(0.3);

	(void)state;
	assert_int_equal(identify(&s).verdict, LEVER_NOT_HELD);
}

static void test_a_robot_at_rest_and_a_slow_one_are_too_slow(void **state)
{
	struct scene s = BY_HAND;

	(void)state;
	s.swing_rad = (struct vec3){0, 0, 0};
	assert_int_equal(identify(&s).verdict, LEVER_TOO_SLOW);
	s.swing_rad = (struct vec3){0.2, 0.2, 0.2};
	s.swing_hz = (struct vec3){0.1, 0.12, 0.14};
	assert_int_equal(identify(&s).verdict, LEVER_TOO_SLOW);
}

static void test_too_little_motion_is_too_short(void **state)
{
	struct scene s = BY_HAND;

	(void)state;
	s.seconds = 9;
	assert_int_equal(identify(&s).verdict, LEVER_TOO_SHORT);
}

static void test_a_missing_reference_is_reported(void **state)
{
	const struct lever_identification_config config = {.rate_hz = 100, .duration_s = 30, .reference = true};

	(void)state;
	assert_int_equal(lever_identification_init(&id, &config), 0);
	for (uint64_t k = 0; k < 3000; k++)
		lever_identification_step(&id, k * 10000, any_vec(1), any_vec(10), NULL);
	assert_int_equal(lever_identification_estimate(&id).verdict, LEVER_NO_REFERENCE);
}

/* Without one for more than half of the samples. */
static void test_a_reference_may_be_missing_for_half_of_the_samples(void **state)
{
	const struct lever_identification_config config = {.rate_hz = 100, .duration_s = 30, .reference = true};
	const struct vec3 reference = {0, 0, 0};

	(void)state;
	for (uint64_t missing = 1000; missing <= 1002; missing++) {
		assert_int_equal(lever_identification_init(&id, &config), 0);
		for (uint64_t k = 0; k < 2002; k++)
			lever_identification_step(
				&id, k * 10000, any_vec(1), any_vec(10), k < missing ? NULL : &reference);
		assert_int_equal(lever_identification_estimate(&id).verdict == LEVER_NO_REFERENCE, missing > 1001);
	}
}

static void test_a_configuration_out_of_range_is_refused(void **state)
{
	struct lever_identification_config config = {.rate_hz = 24.9, .duration_s = 30};

	(void)state;
	assert_int_equal(lever_identification_init(&id, &config), -EINVAL);
	config.rate_hz = 25;
	assert_int_equal(lever_identification_init(&id, &config), 0);
	config = (struct lever_identification_config){.rate_hz = NAN, .duration_s = 30};
	assert_int_equal(lever_identification_init(&id, &config), -EINVAL);
	config = (struct lever_identification_config){.rate_hz = 100, .duration_s = 1};
	assert_int_equal(lever_identification_init(&id, &config), -EINVAL);
}

static void test_the_estimate_stays_finite_for_any_input(void **state)
{
	const struct lever_identification_config config = {
		.rate_hz = 100, .duration_s = 30, .reference = true, .estimate_delay = true};
	const double odd[] = {NAN, INFINITY, -INFINITY, 1e300, 0, 1e4};
	uint64_t t_us = 0;

	(void)state;
	assert_int_equal(lever_identification_init(&id, &config), 0);
	for (int k = 0; k < 30000; k++) {
		struct vec3 gyro = any_vec(900), force = any_vec(9e4), ref = any_vec(9e4);

		t_us += k % 500 ? 10000 : (uint64_t)(2e6 * (1 + any()));
		if (k % 300 == 0)
			gyro.x = odd[k / 300 % 6];
		if (k % 700 == 0)
			force.y = odd[k / 700 % 6];
		if (k % 1100 == 0)
			ref.z = odd[k / 1100 % 6];
		lever_identification_step(&id, t_us, gyro, force, k % 1300 ? &ref : NULL);
	}
	struct lever_estimate e = lever_identification_estimate(&id);
	assert_int_not_equal(e.verdict, LEVER_FOUND);
	assert_true(vec3_finite(e.lever_arm_b_m) && vec3_finite(e.sigma_b_m) && isfinite(e.residual_m_s2) &&
		    isfinite(e.delay_s));
}

static void test_only_the_sample_that_ends_a_window_gives_news(void **state)
{
	const struct lever_identification_config config = {.rate_hz = 100, .duration_s = 30};
	unsigned news = 0;

	(void)state;
	assert_int_equal(lever_identification_init(&id, &config), 0);
	for (uint64_t i = 1; i <= 1000; i++) {
		uint64_t pause_us = i > 500 ? 1000000 : 0; /* the filters settle again */

		lever_identification_step(
			&id, 10000 * i + pause_us, (struct vec3){1, 0, 0}, (struct vec3){0, 0, 9.81}, NULL);
		news += lever_identification_news(&id);
	}
	assert_true(id.windows >= 8);
	assert_int_equal(news, id.windows);
}

/* Five samples for the derivatives, 0.3 s in which the filters settle, and the window of 1 s. */
static void test_the_first_window_ends_1_34_s_after_the_start(void **state)
{
	const struct lever_identification_config config = {.rate_hz = 100, .duration_s = 30};
	uint64_t k = 0;

	(void)state;
	assert_int_equal(lever_identification_init(&id, &config), 0);
	for (; k < 1000 && !lever_identification_news(&id); k++)
		lever_identification_step(&id, k * 10000, (struct vec3){1, 0, 0}, (struct vec3){0, 0, 9.81}, NULL);
	assert_int_equal(k, 4 + 30 + 100);
}

static void test_the_sampling_rate_is_tracked_with_a_time_constant_of_100_samples(void **state)
{
	const struct lever_identification_config config = {.rate_hz = 100, .duration_s = 30};

	(void)state;
	assert_int_equal(lever_identification_init(&id, &config), 0);
	for (uint64_t k = 0; k <= 100; k++)
		lever_identification_step(&id, k * 9600, (struct vec3){1, 0, 0}, (struct vec3){0, 0, 9.81}, NULL);
	assert_near(id.dt_s, 0.0096 + 0.0004 * exp(-1), 0.00001);
}

static void test_blocks_are_merged_when_the_memory_is_full_and_sigma_decreases(void **state)
{
	struct scene s = BY_HAND;

	(void)state;
	struct lever_estimate first = identify(&s);
	s.seconds = 300; /* blocks are merged three times */
	struct lever_estimate e = identify(&s);
	assert_found(&e, ARM, 0.001);
	assert_true(e.noise_sigma_b_m.x < first.noise_sigma_b_m.x && e.noise_sigma_b_m.z < first.noise_sigma_b_m.z);
	assert_int_equal(e.progress_percent, 100);
	for (int b = 0; b < id.blocks - 1; b++)
		assert_near(id.block[b].samples, id.windows_per_block * id.window_size, 0);
	assert_near(id.block[id.blocks - 1].samples, id.last_block_windows * id.window_size, 0);
	assert_int_equal((id.blocks - 1) * id.windows_per_block + id.last_block_windows, id.windows);
}

/* After 64 windows neighbours share a block and half of the blocks are free again. */
static void test_blocks_that_are_free_again_do_not_count(void **state)
{
	struct scene s = BY_HAND;
	struct lever_estimate before, after;

	(void)state;
	s.seconds = 70;
	before = identify(&s);
	assert_int_equal(before.verdict, LEVER_FOUND);
	assert_true(id.blocks < LEVER_BLOCKS);
	memset(&id.block[id.blocks], 0xFF, (size_t)(LEVER_BLOCKS - id.blocks) * sizeof(id.block[0]));
	after = lever_identification_estimate(&id);
	assert_vec_near(after.lever_arm_b_m, before.lever_arm_b_m, 0);
	assert_vec_near(after.noise_sigma_b_m, before.noise_sigma_b_m, 0);
}

/* A slow short turn to and fro while the hand sways: the noise grows with the swaying. */
static void test_a_noise_of_more_than_5_mm_or_3_percent_of_the_lever_arm_is_unsure(void **state)
{
	const struct vec3 arms_b_m[2] = {{0.06, 0.06, 0.053}, {0.3, 0.3, 0.265}}; /* 0.1 m and 0.5 m */

	(void)state;
	for (int i = 0; i < 2; i++) {
		const double limit_m = i ? 0.03 * 0.5 : 0.005;
		double below_m = 0, above_m = 1;

		for (int sway = 1; sway < 60 && above_m == 1; sway++) {
			struct scene s = BY_HAND;
			struct lever_estimate e;
			double sigma_m;

			s.arm_b_m = arms_b_m[i];
			s.seconds = 12;
			s.swing_rad = vec3_scale(0.3, s.swing_rad);
			s.travel_hz = (struct vec3){1.9, 2.3, 2.7};
			s.travel_m = vec3_scale(0.0001 * sway, (struct vec3){1, 1, 1});
			e = identify(&s);
			sigma_m = fmax(e.noise_sigma_b_m.x, fmax(e.noise_sigma_b_m.y, e.noise_sigma_b_m.z));
			*(e.verdict == LEVER_FOUND ? &below_m : &above_m) = sigma_m;
			assert_true(e.verdict == LEVER_FOUND || e.verdict == LEVER_UNSURE);
		}
		assert_true(below_m < limit_m && above_m > limit_m);
		assert_near(above_m, limit_m, 0.1 * limit_m);
	}
}

/* Systematic errors: 0.7 mm of the reference point, and 0.5 % of the lever arm for the scale of the sensors. The effect
 * of a delay is what its estimate changes. */
static void test_sigma_is_made_of_noise_systematic_errors_and_the_effect_of_a_delay_axis_by_axis(void **state)
{
	struct scene s = with_reference(0.01);
	struct lever_estimate e, delayed;
	struct vec3 off, n;
	double systematic;

	(void)state;
	s.travel_m = (struct vec3){0, 0.5, 0};
	s.travel_hz.y = s.swing_hz.x;
	s.travel_ahead_s = 0.25 / s.swing_hz.x;
	delayed = identify(&s);
	s.estimate_delay = false;
	e = identify(&s);
	off = vec3_sub(e.lever_arm_b_m, delayed.lever_arm_b_m);
	n = e.noise_sigma_b_m;
	systematic = hypot(0.0007, 0.005 * vec3_norm(e.lever_arm_b_m));
	assert_true(fabs(off.x) > 1e-5 && fabs(off.y) > 1e-5 && fabs(off.z) > 1e-5);
	assert_near(e.sigma_b_m.x, sqrt(n.x * n.x + systematic * systematic + off.x * off.x), 1e-9);
	assert_near(e.sigma_b_m.y, sqrt(n.y * n.y + systematic * systematic + off.y * off.y), 1e-9);
	assert_near(e.sigma_b_m.z, sqrt(n.z * n.z + systematic * systematic + off.z * off.z), 1e-9);
}

/* Turned much about one axis, along which the lever arm is then least certain. */
static void test_the_noise_sigma_of_each_axis_is_that_of_its_scatter(void **state)
{
	enum { SEEDS = 30 };

	(void)state;
	for (int axis = 0; axis < 3; axis++) {
		struct vec3 scatter = {0, 0, 0}, stated = {0, 0, 0};
		struct scene s = BY_HAND;

		s.sensor = "lsm303dlhc_l3gd20";
		s.seconds = 15;
		s.swing_hz = (struct vec3){0.31, 0.43, 0.37};
		s.swing_rad = (struct vec3){axis == 0 ? 1.2 : 0.4, axis == 1 ? 1.2 : 0.4, axis == 2 ? 1.2 : 0.4};
		for (s.seed = 1; s.seed <= SEEDS; s.seed++) {
			struct lever_estimate e = identify(&s);
			struct vec3 off = vec3_sub(e.lever_arm_b_m, ARM), n = e.noise_sigma_b_m;

			scatter = vec3_add(scatter, (struct vec3){off.x * off.x, off.y * off.y, off.z * off.z});
			stated = vec3_add(stated, (struct vec3){n.x * n.x, n.y * n.y, n.z * n.z});
		}
		assert_true(scatter.x / stated.x > 0.4 && scatter.x / stated.x < 2.5);
		assert_true(scatter.y / stated.y > 0.4 && scatter.y / stated.y < 2.5);
		assert_true(scatter.z / stated.z > 0.4 && scatter.z / stated.z < 2.5);
	}
}

/* ---- limits of the verdicts -------------------------------------------------------------------------------------- */

/* RMS of what the lever arm adds to the acceleration. */
static double arm_rms(const struct scene *s)
{
	const int count = (int)(s->seconds * s->rate_hz);
	double sum = 0;

	for (int k = 0; k < count; k++) {
		struct signal_truth t;
		struct vec3 a;

		truth_at(s, k / s->rate_hz, &t);
		a = vec3_add(vec3_cross(t.alpha_b_rad_s2, s->arm_b_m),
			vec3_cross(t.omega_b_rad_s, vec3_cross(t.omega_b_rad_s, s->arm_b_m)));
		sum += vec3_dot(a, a) / count;
	}
	return sqrt(sum);
}

/* The reference point moves 3 % more each time, and its reference is late. */
static void assert_residual_limit(struct scene s, double limit_m_s2)
{
	struct lever_estimate e = {.verdict = LEVER_FOUND};

	for (double sway_m = 4e-4; e.verdict != LEVER_NOT_HELD; sway_m *= 1.03) {
		s.travel_m = vec3_scale(sway_m, (struct vec3){1, 1, 1});
		e = identify(&s);
	}
	assert_near(e.residual_m_s2, limit_m_s2, 0.04 * limit_m_s2);
}

static void test_the_residual_may_be_0_3_m_s2_or_1_with_a_reference_and_a_tenth_of_what_the_arm_explains(void **state)
{
	(void)state;
	for (int i = 0; i < 3; i++) {
		struct scene s = BY_HAND;

		s.sensor = "ideal";
		s.seconds = 15;
		s.travel_hz = (struct vec3){1.9, 2.3, 2.7};
		s.reference = i == 1;
		s.delay_s = 0.7;
		if (i < 2)
			s.arm_b_m = (struct vec3){0, 0, 0};
		assert_residual_limit(s, (s.reference ? 1 : 0.3) + 0.1 * arm_rms(&s));
	}
}

/* Swings of 4 Hz about l and 5 Hz about t: whole ones in each window of 1 s, so that nothing is lost with the mean. The
 * excitation is that below LEVER_CUTOFF_HZ, of the second order. A lever arm along l or s is accelerated across by
 * alpha_t, one along t only by alpha_l. */
static struct scene about_l_and_t(double l_rms_s2, double t_rms_s2)
{
	const double l_hz = 4, t_hz = 5;
	struct scene s = BY_HAND;

	s.sensor = "ideal";
	s.seconds = 12;
	s.swing_hz = (struct vec3){l_hz, 1, t_hz};
	s.swing_rad =
		(struct vec3){sqrt(2) * l_rms_s2 / pow(2 * PI * l_hz, 2) * sqrt(1 + pow(l_hz / LEVER_CUTOFF_HZ, 4)), 0,
			sqrt(2) * t_rms_s2 / pow(2 * PI * t_hz, 2) * sqrt(1 + pow(t_hz / LEVER_CUTOFF_HZ, 4))};
	return s;
}

static enum lever_verdict verdict_about_l_and_t(double l_rms_s2, double t_rms_s2)
{
	const struct scene s = about_l_and_t(l_rms_s2, t_rms_s2);

	return identify(&s).verdict;
}

static void test_what_accelerates_a_lever_arm_of_1_m_by_less_than_1_m_s2_is_too_slow(void **state)
{
	(void)state;
	assert_int_equal(verdict_about_l_and_t(0, 0.9), LEVER_TOO_SLOW);
	assert_int_equal(verdict_about_l_and_t(0, 1.1), LEVER_BLIND_T);
}

static void test_a_second_axis_needs_0_4_m_s2(void **state)
{
	(void)state;
	assert_int_equal(verdict_about_l_and_t(0.36, 5), LEVER_BLIND_T);
	assert_int_equal(verdict_about_l_and_t(0.44, 5), LEVER_FOUND);
}

/* Quick swings about t, of 15 Hz: at 5 Hz the tilted bias of the accelerometer could explain as much. */
static void test_a_second_axis_needs_a_twentieth_of_the_first(void **state)
{
	const double t_hz = 15, t_rms_s2 = 16;

	(void)state;
	for (int enough = 0; enough < 2; enough++) {
		struct scene s = about_l_and_t((enough ? 1.15 : 0.85) * t_rms_s2 / 20, 0);

		s.rate_hz = 200;
		s.swing_hz.z = t_hz;
		s.swing_rad.z = sqrt(2) * t_rms_s2 / pow(2 * PI * t_hz, 2) * sqrt(1 + pow(t_hz / LEVER_CUTOFF_HZ, 4));
		assert_int_equal(identify(&s).verdict, enough ? LEVER_FOUND : LEVER_BLIND_T);
	}
}

/* Too uncertain, since the hand sways: more of all helps, or more about the other axes only. */
static void test_the_axis_is_named_if_the_other_one_has_less_than_a_third_of_its_excitation(void **state)
{
	(void)state;
	for (int i = 0; i < 2; i++) {
		struct scene s = about_l_and_t(i ? 1.5 / 3.4 : 1.5 / 2.6, 1.5);

		s.travel_hz = (struct vec3){1.9, 2.3, 2.7};
		s.travel_m = (struct vec3){0.0007, 0.0007, 0.0007};
		assert_int_equal(identify(&s).verdict, i ? LEVER_BLIND_T : LEVER_UNSURE);
	}
}

static void test_up_to_three_lost_samples_in_a_row_are_interpolated(void **state)
{
	struct scene s = BY_HAND;

	(void)state;
	s.pause_each = 8; /* 5, 6 and 7 of each 8 are lost */
	assert_int_equal(identify(&s).verdict, LEVER_FOUND);
	s.pause_each = 9; /* 5 to 8 of each 9 */
	assert_int_equal(identify(&s).verdict, LEVER_TOO_SHORT);
}

/* Each verdict names its own cause, beginning with what is seen and behind the colon with what to do. */
static void test_each_verdict_has_a_text(void **state)
{
	static const char *const words[] = {[LEVER_FOUND] = "found",
		[LEVER_TOO_SHORT] = "too short: move it for at least 10 s",
		[LEVER_NO_REFERENCE] = "no reference: ",
		[LEVER_TOO_SLOW] = "too slow: turn the object",
		[LEVER_BLIND_L] = "turned about the longitudinal axis only",
		[LEVER_BLIND_S] = "turned about the side axis only",
		[LEVER_BLIND_T] = "turned about the transversal axis only",
		[LEVER_NOT_HELD] = "does not fit: the reference point was not held still",
		[LEVER_UNSURE] = "sigma is too large: turn faster",
		[LEVER_SENSOR_LOST] = "the sensor stopped sending samples"};

	(void)state;
	for (int verdict = LEVER_FOUND; verdict <= LEVER_SENSOR_LOST; verdict++) {
		const char *text = lever_verdict_text((enum lever_verdict)verdict);

		assert_non_null(text);
		assert_int_equal(strncmp(text, words[verdict], strlen(words[verdict])), 0);
	}
	assert_string_equal(lever_verdict_text((enum lever_verdict)0), "unknown");
}

/* A window is 100 samples, and the filters settle for 30 before it. */
static void test_a_window_with_a_sample_that_is_no_number_does_not_count(void **state)
{
	struct scene s = BY_HAND;
	struct lever_estimate e;

	(void)state;
	s.every_bad = 90;
	assert_int_equal(identify(&s).verdict, LEVER_TOO_SHORT);
	s.every_bad = 1000; /* three, each with its window and the settling */
	e = identify(&s);
	assert_found(&e, ARM, 0.001);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_with_the_reference_point_held_100_mm_are_identified_within_1_mm),
		cmocka_unit_test(test_the_result_is_the_same_at_every_usual_sampling_rate),
		cmocka_unit_test(test_biases_and_lost_samples_cost_less_than_1_mm),
		cmocka_unit_test(test_the_actual_sampling_rate_is_tracked),
		cmocka_unit_test(test_gaps_of_seconds_do_not_change_the_result),
		cmocka_unit_test(test_drift_of_gravity_by_a_gyro_bias_is_eliminated),
		cmocka_unit_test(test_a_lever_arm_of_zero_is_identified_as_zero),
		cmocka_unit_test(test_with_a_reference_100_mm_are_identified_within_1_mm),
		cmocka_unit_test(test_the_delay_of_a_reference_is_estimated),
		cmocka_unit_test(test_the_reference_of_a_quick_movement_can_be_15_ms_late),
		cmocka_unit_test(test_a_reference_of_100_hz_suffices_for_samples_at_200_hz),
		cmocka_unit_test(test_a_delay_that_is_not_estimated_increases_sigma_by_its_effect),
		cmocka_unit_test(test_the_noise_sigma_matches_the_scatter_over_60_seeds_and_the_error_is_below_3_sigma),
		cmocka_unit_test(test_rotation_about_one_axis_is_refused_and_the_axis_named),
		cmocka_unit_test(test_rotation_about_two_axes_suffices),
		cmocka_unit_test(test_a_reference_point_that_moves_is_refused_as_not_held),
		cmocka_unit_test(test_the_reference_of_another_motion_is_refused),
		cmocka_unit_test(test_a_robot_at_rest_and_a_slow_one_are_too_slow),
		cmocka_unit_test(test_too_little_motion_is_too_short),
		cmocka_unit_test(test_a_missing_reference_is_reported),
		cmocka_unit_test(test_a_reference_may_be_missing_for_half_of_the_samples),
		cmocka_unit_test(test_a_configuration_out_of_range_is_refused),
		cmocka_unit_test(test_the_estimate_stays_finite_for_any_input),
		cmocka_unit_test(test_only_the_sample_that_ends_a_window_gives_news),
		cmocka_unit_test(test_the_first_window_ends_1_34_s_after_the_start),
		cmocka_unit_test(test_the_sampling_rate_is_tracked_with_a_time_constant_of_100_samples),
		cmocka_unit_test(test_blocks_are_merged_when_the_memory_is_full_and_sigma_decreases),
		cmocka_unit_test(test_blocks_that_are_free_again_do_not_count),
		cmocka_unit_test(test_a_noise_of_more_than_5_mm_or_3_percent_of_the_lever_arm_is_unsure),
		cmocka_unit_test(test_sigma_is_made_of_noise_systematic_errors_and_the_effect_of_a_delay_axis_by_axis),
		cmocka_unit_test(test_the_noise_sigma_of_each_axis_is_that_of_its_scatter),
		cmocka_unit_test(
			test_the_residual_may_be_0_3_m_s2_or_1_with_a_reference_and_a_tenth_of_what_the_arm_explains),
		cmocka_unit_test(test_what_accelerates_a_lever_arm_of_1_m_by_less_than_1_m_s2_is_too_slow),
		cmocka_unit_test(test_a_second_axis_needs_0_4_m_s2),
		cmocka_unit_test(test_a_second_axis_needs_a_twentieth_of_the_first),
		cmocka_unit_test(test_the_axis_is_named_if_the_other_one_has_less_than_a_third_of_its_excitation),
		cmocka_unit_test(test_each_verdict_has_a_text),
		cmocka_unit_test(test_up_to_three_lost_samples_in_a_row_are_interpolated),
		cmocka_unit_test(test_a_window_with_a_sample_that_is_no_number_does_not_count),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
