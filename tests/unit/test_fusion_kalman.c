/* The Kalman filter of the attitude on simulated sensors whose motion is known. */
#include <string.h>

#include "model_test.h"

#include "model/fusion.h"
#include "model/math/rotation.h"
#include "model/sim/sensor.h"

#define G 9.81

static const struct vec3 FIELD_N = {0, 20, -45}; /* magnetic north, dipping, micro-tesla */
static const struct fusion_config NINE_AXES = {
	.algorithm = FUSION_KALMAN,
	.use_magnetometer = 1,
	.madgwick_beta = 0.041,
	.mahony_kp_rad_s = 0.3,
	.kalman = FUSION_KALMAN_DEFAULTS,
};

static struct fusion_config six_axes(void)
{
	struct fusion_config config = NINE_AXES;

	config.use_magnetometer = 0;
	return config;
}

static struct fusion fusion(struct fusion_config config)
{
	struct fusion f;

	assert_int_equal(fusion_init(&f, &config), 0);
	return f;
}

/* One instant of a motion about all axes whose reference point swings, as measured by sensors at `arm` from it. */
struct moment {
	struct quat q_nb;
	struct imu_sample sample;
};

static struct moment swinging(double t, double size, struct vec3 arm)
{
	struct vec3 angle = {0.8 * size * sin(1.3 * t), 0.6 * size * sin(2.1 * t), 1.5 * size * sin(0.7 * t)};
	struct vec3 rate = {1.04 * size * cos(1.3 * t), 1.26 * size * cos(2.1 * t), 1.05 * size * cos(0.7 * t)};
	struct vec3 accel = vec3_scale(size > 0, (struct vec3){2 * sin(5 * t), 1.5 * cos(4 * t), sin(6 * t)});
	struct quat z = quat_from_rotation_vector((struct vec3){0, 0, angle.z});
	struct quat y = quat_from_rotation_vector((struct vec3){0, angle.y, 0});
	struct quat x = quat_from_rotation_vector((struct vec3){angle.x, 0, 0});
	struct quat yx = quat_multiply(y, x);
	struct moment m = {.q_nb = quat_multiply(z, yx)};
	struct vec3 omega =
		vec3_add(vec3_add((struct vec3){rate.x, 0, 0}, quat_rotate_inverse(x, (struct vec3){0, rate.y, 0})),
			quat_rotate_inverse(yx, (struct vec3){0, 0, rate.z}));

	m.sample = (struct imu_sample){
		.gyro_rad_s = omega,
		.accel_m_s2 = vec3_add(quat_rotate_inverse(m.q_nb, vec3_add(accel, (struct vec3){0, 0, G})),
			vec3_cross(omega, vec3_cross(omega, arm))),
		.mag_uT = quat_rotate_inverse(m.q_nb, FIELD_N),
		.flags = SAMPLE_MAG,
	};
	return m;
}

/* The same with the exact angular acceleration over the lever arm. */
static struct moment swinging_over(double t, double size, struct vec3 arm)
{
	struct vec3 before = swinging(t - 1e-5, size, arm).sample.gyro_rad_s;
	struct vec3 after = swinging(t + 1e-5, size, arm).sample.gyro_rad_s;
	struct moment m = swinging(t, size, arm);

	m.sample.accel_m_s2 = vec3_add(m.sample.accel_m_s2, vec3_cross(vec3_scale(5e4, vec3_sub(after, before)), arm));
	return m;
}

/* Errors of the samples. */
struct errors {
	struct vec3 gyro_bias, magnet_b, arm;
	double magnet_from_s, magnet_to_s, no_field_from_s, rate_hz, rest_from_s;
};

struct result {
	double tilt_rad, heading_rad; /* RMS since the second half began */
	int fields;		      /* corrections by the field in it */
	struct quat truth;	      /* at the end */
};

static struct vec3 up_of(struct quat q)
{
	return quat_rotate_inverse(q, (struct vec3){0, 0, 1});
}

/* From t = 0 to `end_s` in equal time steps, at rest after rest_from_s. */
static struct result follow(struct fusion *f, const struct errors *e, double size, double end_s)
{
	double dt_s = 1 / (e->rate_hz > 0 ? e->rate_hz : 200), tilt = 0, heading = 0;
	int n = (int)lround(end_s / dt_s), counted = 0;
	struct result r = {.tilt_rad = 0};

	for (int k = 0; k < n; k++) {
		double t = k * dt_s;
		bool rest = e->rest_from_s > 0 && t > e->rest_from_s;
		struct moment m = swinging_over(rest ? 0.3 : t, rest ? 0 : size, e->arm);
		struct vec3 error_n;

		if (rest)
			fusion_update_bias_at_rest(f, vec3_add(m.sample.gyro_rad_s, e->gyro_bias), dt_s);
		m.sample.gyro_rad_s = vec3_add(m.sample.gyro_rad_s, e->gyro_bias);
		if (t >= e->magnet_from_s && t < e->magnet_to_s)
			m.sample.mag_uT = vec3_add(m.sample.mag_uT, e->magnet_b);
		if (e->no_field_from_s > 0 && t > e->no_field_from_s)
			m.sample.flags = 0;
		fusion_step(f, &m.sample, dt_s);
		r.truth = m.q_nb;
		if (k < n / 2)
			continue;
		r.fields += fusion_mag_used(f);
		error_n = quat_rotate(f->q_nb, quat_rotate_inverse(m.q_nb, (struct vec3){0, 1, 0}));
		heading += pow(atan2(error_n.x, error_n.y), 2);
		tilt += pow(acos(fmin(1, vec3_dot(up_of(f->q_nb), up_of(m.q_nb)))), 2);
		counted++;
	}
	r.tilt_rad = sqrt(tilt / counted);
	r.heading_rad = sqrt(heading / counted);
	return r;
}

static void test_a_moving_body_is_followed_within_half_a_degree(void **state)
{
	struct errors e = {.rate_hz = 0};
	struct fusion f = fusion(NINE_AXES);
	struct result r = follow(&f, &e, 1, 60);

	(void)state;
	assert_true(r.tilt_rad < 0.3 * RAD_PER_DEG);
	assert_true(r.heading_rad < 0.5 * RAD_PER_DEG);
}

static void test_the_error_is_below_a_degree_at_any_sampling_rate(void **state)
{
	const double rates_hz[] = {50, 100, 286, 1000};

	(void)state;
	for (int i = 0; i < 4; i++) {
		struct errors e = {.rate_hz = rates_hz[i]};
		struct fusion f = fusion(NINE_AXES);
		struct result r = follow(&f, &e, 1, 40);

		assert_true(r.tilt_rad < 0.5 * RAD_PER_DEG);
		assert_true(r.heading_rad < 1 * RAD_PER_DEG);
	}
}

static void test_the_attitude_recovers_from_a_wrong_start(void **state)
{
	struct errors e = {.rate_hz = 0};
	struct fusion f = fusion(NINE_AXES);
	struct quat off = quat_from_rotation_vector((struct vec3){0.5, -0.3, 0.6});
	struct result r;

	(void)state;
	follow(&f, &e, 1, 0.02);
	f.q_nb = quat_multiply(off, f.q_nb);
	r = follow(&f, &e, 1, 60);
	assert_true(r.tilt_rad < 0.5 * RAD_PER_DEG);
	assert_quat_near(f.q_nb, r.truth, 2 * RAD_PER_DEG);
}

static void test_the_bias_is_estimated_at_rest_within_seconds(void **state)
{
	struct errors e = {.gyro_bias = {0.01, -0.02, 0.015}, .rest_from_s = 1e-9};
	struct fusion f = fusion(six_axes());

	(void)state;
	follow(&f, &e, 0, 5);
	assert_vec_near(f.gyro_errors.bias_b_rad_s, e.gyro_bias, 1e-4);
}

static void test_the_bias_is_estimated_in_motion(void **state)
{
	struct errors e = {.gyro_bias = {0.01, -0.01, 0.008}};
	struct fusion nine = fusion(NINE_AXES), six = fusion(six_axes());

	(void)state;
	follow(&nine, &e, 1, 120);
	assert_vec_near(nine.gyro_errors.bias_b_rad_s, e.gyro_bias, 1e-3);
	follow(&six, &e, 1, 120); /* the body tilts, so all three axes are observable without a magnetometer */
	assert_vec_near(six.gyro_errors.bias_b_rad_s, e.gyro_bias, 2e-3);
}

static void test_the_bias_estimate_is_limited(void **state)
{
	struct errors e = {.gyro_bias = {0.6, 0.8, 0}}; /* 57 deg/s */
	struct fusion f = fusion(NINE_AXES);

	(void)state;
	follow(&f, &e, 0, 20);
	assert_true(vec3_norm(f.gyro_errors.bias_b_rad_s) < 45.1 * RAD_PER_DEG);
	f = fusion(NINE_AXES);
	f.gyro_errors.bias_b_rad_s = e.gyro_bias;
	follow(&f, &e, 0, 0.1);
	assert_vec_near(f.gyro_errors.bias_b_rad_s, vec3_scale(45 * RAD_PER_DEG, e.gyro_bias), 0.1 * RAD_PER_DEG);
}

/* As chips come: up to 26 deg/s on each axis at 2000 deg/s of range. */
static void test_a_large_bias_of_what_lies_is_learnt_from_the_start(void **state)
{
	static const struct vec3 biases[] = {{0.24, -0.32, -0.37}, {0.7, 0, 0}, {0, 0, 0.7}, {-0.4, 0.4, 0.4}};

	(void)state;
	for (size_t i = 0; i < sizeof(biases) / sizeof(biases[0]); i++) {
		struct fusion f = fusion(six_axes());

		for (int k = 0; k < 200 * 10; k++) {
			struct imu_sample s = {.gyro_rad_s = biases[i], .accel_m_s2 = {0, 0, G}};

			f.steady_s = k / 200.0;
			if (k > 200)
				fusion_update_bias_at_rest(&f, s.gyro_rad_s, 1.0 / 200);
			fusion_step(&f, &s, 1.0 / 200);
		}
		assert_vec_near(f.gyro_errors.bias_b_rad_s, biases[i], 1e-3);
		assert_true(acos(fmin(1, up_of(f.q_nb).z)) < 1 * RAD_PER_DEG);
	}
}

/* Two seconds in a row that agree: a pause of 1.5 s has none, however many there are. */
static void test_a_bias_is_learnt_from_two_steady_seconds_in_a_row(void **state)
{
	static const struct {
		double pause_s;
		bool learnt;
	} cases[] = {{1.5, false}, {2.5, true}};

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct fusion f = fusion(six_axes());

		for (int k = 0; k < 200 * 20; k++) {
			const struct imu_sample s = {.gyro_rad_s = {0.002, -0.001, 0.001}, .accel_m_s2 = {0, 0, G}};

			if (fmod(k / 200.0, cases[i].pause_s + 0.3) < cases[i].pause_s)
				fusion_update_bias_at_rest(&f, s.gyro_rad_s, 1.0 / 200);
			fusion_step(&f, &s, 1.0 / 200);
		}
		assert_int_equal(f.kalman.bias_known, cases[i].learnt);
	}
}

static void test_a_magnet_for_20_seconds_does_not_turn_the_heading(void **state)
{
	const struct vec3 magnets_b[] = {{15, 0, 0}, {0, -30, 20}, {100, 100, 0}};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct errors e = {.magnet_b = magnets_b[i], .magnet_from_s = 40, .magnet_to_s = 60};
		struct fusion f = fusion(NINE_AXES), madgwick = fusion(NINE_AXES);

		double turned = follow(&f, &e, 1, 60).heading_rad;

		madgwick.config.algorithm = FUSION_MADGWICK;
		assert_true(turned < 4 * RAD_PER_DEG);
		assert_true(turned < 0.8 * follow(&madgwick, &e, 1, 60).heading_rad);
	}
}

static void test_a_magnet_beside_a_still_object_does_not_turn_its_heading(void **state)
{
	struct errors e = {.magnet_b = {20, -10, 5}, .magnet_from_s = 20, .magnet_to_s = 60, .rest_from_s = 1e-9};
	struct fusion f = fusion(NINE_AXES);

	(void)state;
	assert_true(follow(&f, &e, 0, 60).heading_rad < 0.1 * RAD_PER_DEG);
	assert_false(fusion_mag_used(&f));
}

/* From t = 20 s on another hall, whose field is weaker and dips less. */
static void test_another_homogeneous_field_becomes_the_reference_after_20_seconds_of_turning(void **state)
{
	struct fusion f = fusion(NINE_AXES);
	double first_s = 0;
	int used = 0;

	(void)state;
	for (int k = 0; k < 200 * 80; k++) {
		double t = k / 200.0;
		struct moment m = swinging(t, 1, (struct vec3){0, 0, 0});

		if (t > 20)
			m.sample.mag_uT = quat_rotate_inverse(m.q_nb, (struct vec3){0, 18, -20});
		fusion_step(&f, &m.sample, 1.0 / 200);
		if (t > 22 && first_s == 0 && fusion_mag_used(&f))
			first_s = t;
		if (t > 60)
			used += fusion_mag_used(&f);
	}
	assert_true(first_s > 39.5 && first_s < 42);
	assert_true(used > 500);
}

/* Half a minute still in one hall, and then 20 s of turning in another one: the first is no part of what was seen. */
static void test_a_reference_is_of_one_field_from_its_first_moment_on(void **state)
{
	struct fusion f = fusion(NINE_AXES);
	double first_s = 0;

	(void)state;
	for (int k = 0; k < 200 * 120; k++) {
		double t = k / 200.0, motion_s = t < 20 ? t : t < 50 ? 20 : t - 30;
		bool still = t >= 20 && t < 50;
		struct moment m = swinging(motion_s, 1, (struct vec3){0, 0, 0});

		if (still) {
			m.sample.gyro_rad_s = (struct vec3){0, 0, 0};
			m.sample.accel_m_s2 = vec3_scale(G, up_of(m.q_nb));
		}
		if (t >= 20)
			m.sample.mag_uT = quat_rotate_inverse(
				m.q_nb, t < 50 ? (struct vec3){0, 18, -20} : (struct vec3){0, 30, -20});
		fusion_step(&f, &m.sample, 1.0 / 200);
		if (t > 22 && first_s == 0 && fusion_mag_used(&f))
			first_s = t;
	}
	assert_true(first_s > 69.5 && first_s < 72);
}

/* Two halls in turn, so that neither becomes the reference. */
static int fields_used_in_changing_halls(struct fusion *f)
{
	int used = 0;

	for (int k = 0; k < 200 * 60; k++) {
		struct moment m = swinging(k / 200.0, 1, (struct vec3){0, 0, 0});

		if (k >= 200 * 15) /* when the turns about all axes have agreed */
			m.sample.mag_uT = quat_rotate_inverse(
				m.q_nb, k / 3000 % 2 ? (struct vec3){0, 40, -20} : (struct vec3){0, 50, -75});
		fusion_step(f, &m.sample, 1.0 / 200);
		used += k > 200 * 30 && fusion_mag_used(f);
	}
	return used;
}

static void test_a_field_disturbed_for_longer_than_the_rejection_time_counts_with_a_small_weight(void **state)
{
	struct fusion_config config = NINE_AXES;
	struct fusion patient = fusion(config), impatient;

	(void)state;
	config.kalman.rejection_time_s = 10;
	impatient = fusion(config);
	assert_int_equal(fields_used_in_changing_halls(&patient), 0);
	assert_true(fields_used_in_changing_halls(&impatient) > 500);
}

/* ---- a magnetometer that nobody calibrated ---- */

/* Continues the motion from one time to another, in this field; returns the true attitude at the end. */
static struct quat continue_motion(struct fusion *f, double from_s, double to_s, struct vec3 field_n_uT)
{
	struct moment m = swinging(from_s, 1, (struct vec3){0, 0, 0});

	for (int k = 0; k < (to_s - from_s) * 200; k++) {
		m = swinging(from_s + k / 200.0, 1, (struct vec3){0, 0, 0});
		m.sample.mag_uT = quat_rotate_inverse(m.q_nb, field_n_uT);
		fusion_step(f, &m.sample, 0.005);
	}
	return m.q_nb;
}

static double heading_sigma_rad(const struct fusion *f)
{
	return sqrt(fusion_kalman_heading_variance(&f->kalman, &f->config.kalman));
}

static void test_the_heading_gets_over_a_hard_iron_offset_that_was_there_from_the_start(void **state)
{
	static const struct vec3 offsets[] = {{50, 0, 0}, {0, 50, 0}, {0, 0, 50}, {-20, -15, 10}, {0, 7, 0}};

	(void)state;
	for (size_t i = 0; i < sizeof(offsets) / sizeof(offsets[0]); i++) {
		struct errors e = {.magnet_b = offsets[i], .magnet_to_s = 1e9};
		struct fusion f = fusion(NINE_AXES);
		double off = follow(&f, &e, 1, 60).heading_rad;

		assert_true(off < 2 * RAD_PER_DEG);
		assert_true(off < 3 * heading_sigma_rad(&f));
		assert_true(heading_sigma_rad(&f) < 10 * RAD_PER_DEG);
	}
}

/* In other axes it would be another one. */
static void test_an_offset_is_forgotten_when_the_object_has_other_axes(void **state)
{
	struct errors e = {.magnet_b = {50, 0, 0}, .magnet_to_s = 1e9};
	struct fusion f = fusion(NINE_AXES);

	(void)state;
	follow(&f, &e, 1, 60);
	assert_true(f.kalman.hard_iron.known);
	fusion_turn_object(&f, quat_from_rotation_vector((struct vec3){0, 0, 1}));
	assert_false(f.kalman.hard_iron.known || f.kalman.hard_iron.agreed);
	assert_vec_near(f.kalman.hard_iron.offset_b_uT, ((struct vec3){0, 0, 0}), 0);
}

/* The first heading came from that field. */
static void test_while_the_field_turns_otherwise_than_the_gyro_says_the_heading_is_unknown(void **state)
{
	struct fusion f = fusion(NINE_AXES);
	struct moment m;
	double off;

	(void)state;
	for (int k = 0; k < 200 * 60; k++) {
		m = swinging(k / 200.0, 1, (struct vec3){0, 0, 0});
		m.sample.mag_uT.y = -m.sample.mag_uT.y;
		fusion_step(&f, &m.sample, 1.0 / 200);
		assert_true(k < 200 * 10 || heading_sigma_rad(&f) > 1.8);
		assert_false(k > 200 * 10 && fusion_mag_used(&f));
	}
	off = quat_apart_rad(f.q_nb, m.q_nb);
	assert_true(off > 60 * RAD_PER_DEG && off < 3 * heading_sigma_rad(&f));
	assert_near(acos(vec3_dot(up_of(f.q_nb), up_of(m.q_nb))), 0, 1 * RAD_PER_DEG);
}

/* The field of iron has another length and dip than the room's. */
static void test_what_was_switched_on_beside_iron_finds_north_once_it_is_away_from_it(void **state)
{
	const struct vec3 iron_n = {40, -30, 40};
	struct fusion f = fusion(NINE_AXES);
	struct quat truth;
	double off;

	(void)state;
	continue_motion(&f, 0, 3, iron_n);
	continue_motion(&f, 3, 15, FIELD_N);
	assert_true(heading_sigma_rad(&f) > 1.8 && fusion_field_disagrees(&f)); /* which of both is right? */
	truth = continue_motion(&f, 15, 40, FIELD_N);
	off = quat_apart_rad(f.q_nb, truth);
	assert_true(off < 3 * RAD_PER_DEG && off < 3 * heading_sigma_rad(&f));
	assert_true(heading_sigma_rad(&f) < 10 * RAD_PER_DEG && !fusion_field_disagrees(&f));
	/* what it has known for longer than 10 s it believes */
	truth = continue_motion(&f, 40, 65, iron_n);
	off = quat_apart_rad(f.q_nb, truth);
	assert_true(off < 4 * RAD_PER_DEG && off < 3 * heading_sigma_rad(&f));
}

/* A hard-iron offset, on an object whose frame is turned on the way, or whose heading came from outside. */
static void test_the_heading_holds_when_an_offset_is_found_again_or_under_a_heading_from_outside(void **state)
{
	const struct quat mounting = quat_from_rotation_vector((struct vec3){0, 0, 1.5});

	(void)state;
	for (int outside = 0; outside < 2; outside++) {
		struct fusion f = fusion(NINE_AXES);

		for (int k = 0; k < 200 * 120; k++) {
			struct moment m = swinging(k / 200.0, 1, (struct vec3){0, 0, 0});
			bool turned = !outside && k >= 200 * 60;
			struct quat truth = turned ? quat_multiply(m.q_nb, quat_conjugate(mounting)) : m.q_nb;

			m.sample.mag_uT = vec3_add(m.sample.mag_uT, (struct vec3){6.5, 0, 4});
			if (k == 0 && outside)
				m.sample.flags = 0;
			if (turned) {
				m.sample.gyro_rad_s = quat_rotate(mounting, m.sample.gyro_rad_s);
				m.sample.accel_m_s2 = quat_rotate(mounting, m.sample.accel_m_s2);
				m.sample.mag_uT = quat_rotate(mounting, m.sample.mag_uT);
			}
			if (!outside && k == 200 * 60)
				fusion_turn_object(&f, mounting);
			fusion_step(&f, &m.sample, 1.0 / 200);
			if (k == 0 && outside)
				fusion_set_attitude(&f, m.q_nb);
			if (k > 200 * 40)
				assert_quat_near(f.q_nb, truth, 4 * RAD_PER_DEG);
		}
		assert_true(f.kalman.hard_iron.known);
	}
}

static void test_a_heading_from_outside_stays_known_when_the_field_is_wrong(void **state)
{
	struct fusion f = fusion(NINE_AXES);
	struct moment m = swinging(0, 1, (struct vec3){0, 0, 0});

	(void)state;
	m.sample.flags = 0;
	fusion_step(&f, &m.sample, 1.0 / 200);
	fusion_set_attitude(&f, m.q_nb);
	for (int k = 1; k < 200 * 60; k++) {
		m = swinging(k / 200.0, 1, (struct vec3){0, 0, 0});
		m.sample.mag_uT.y = -m.sample.mag_uT.y;
		fusion_step(&f, &m.sample, 1.0 / 200);
	}
	assert_true(heading_sigma_rad(&f) < 10 * RAD_PER_DEG);
	assert_quat_near(f.q_nb, m.q_nb, 5 * RAD_PER_DEG);
}

static void test_without_a_magnetometer_the_tilt_is_as_good_and_the_heading_only_drifts(void **state)
{
	struct errors e = {.rate_hz = 0};
	struct fusion f = fusion(six_axes());
	struct result r = follow(&f, &e, 1, 60);

	(void)state;
	assert_true(r.tilt_rad < 0.3 * RAD_PER_DEG);
	assert_true(r.heading_rad < 3 * RAD_PER_DEG);
}

static void test_without_further_fields_the_gyro_holds_the_heading(void **state)
{
	struct errors e = {.no_field_from_s = 30};
	struct fusion f = fusion(NINE_AXES);

	(void)state;
	assert_true(follow(&f, &e, 1, 60).heading_rad < 1 * RAD_PER_DEG);
	assert_false(fusion_mag_used(&f));
}

static void test_the_attitude_converges_after_a_start_in_motion(void **state)
{
	(void)state;
	for (double start_s = 0; start_s < 5; start_s += 0.3) {
		struct fusion f = fusion(NINE_AXES);

		for (int k = 0; k < 200 * 20; k++) {
			struct moment m = swinging(start_s + k / 200.0, 1.5, (struct vec3){0, 0, 0});

			fusion_step(&f, &m.sample, 1.0 / 200);
			if (k > 200 * 15)
				assert_quat_near(f.q_nb, m.q_nb, 3 * RAD_PER_DEG);
		}
	}
}

/* 20 cm from the reference point, every rotation is an acceleration to the accelerometer. */
static void test_a_known_lever_arm_saves_a_third_of_the_tilt_error(void **state)
{
	struct errors e = {.arm = {0.2, -0.1, 0.1}};
	struct fusion_config config = NINE_AXES;
	struct fusion without = fusion(config), with;
	double ignored = follow(&without, &e, 1.5, 60).tilt_rad, used;

	(void)state;
	config.lever_arm_b_m = e.arm;
	with = fusion(config);
	used = follow(&with, &e, 1.5, 60).tilt_rad;
	print_message("tilt error with a lever arm of 24 cm: %.2f degrees when ignored, %.2f when used\n",
		ignored / RAD_PER_DEG, used / RAD_PER_DEG);
	assert_true(used < 0.7 * ignored);
}

static void test_the_attitude_does_not_jump_with_a_new_lever_arm(void **state)
{
	struct errors e = {.rate_hz = 0};
	struct fusion_config config = NINE_AXES;
	struct fusion old = fusion(config), new;

	(void)state;
	follow(&old, &e, 1, 20);
	new = old;
	config.lever_arm_b_m = (struct vec3){5, -3, 2};
	assert_int_equal(fusion_configure(&new, &config), 0);
	for (int k = 0; k < 10; k++) {
		struct moment m = swinging(20, 1, (struct vec3){0, 0, 0});

		fusion_step(&old, &m.sample, 0.005);
		fusion_step(&new, &m.sample, 0.005);
		assert_quat_near(new.q_nb, old.q_nb, k < 6 ? 1e-4 : 1e-2);
	}
}

static void test_switching_the_algorithm_keeps_attitude_and_bias(void **state)
{
	struct errors e = {.gyro_bias = {0.01, -0.02, 0.015}, .rest_from_s = 1e-9};
	struct fusion_config madgwick = NINE_AXES;
	struct fusion f = fusion(NINE_AXES);
	struct fusion before;

	(void)state;
	follow(&f, &e, 0, 10);
	before = f;
	madgwick.algorithm = FUSION_MADGWICK;
	assert_int_equal(fusion_configure(&f, &madgwick), 0);
	assert_int_equal(fusion_configure(&f, &NINE_AXES), 0);
	assert_quat_near(f.q_nb, before.q_nb, 1e-7);
	assert_vec_near(f.gyro_errors.bias_b_rad_s, before.gyro_errors.bias_b_rad_s, 0);
	assert_true(follow(&f, &e, 0, 10).tilt_rad < 0.1 * RAD_PER_DEG);
}

static void test_after_a_gap_attitude_and_bias_converge_again(void **state)
{
	struct errors e = {.rate_hz = 0};
	struct fusion f = fusion(NINE_AXES);
	struct moment m = swinging(0.1, 1, (struct vec3){0, 0, 0});

	(void)state;
	follow(&f, &e, 1, 20);
	fusion_step(&f, &m.sample, 0.7); /* 0.7 s without samples, during which anything may have happened */
	assert_true(follow(&f, &e, 1, 120).tilt_rad < 0.5 * RAD_PER_DEG);
	assert_true(vec3_norm(f.gyro_errors.bias_b_rad_s) < 2e-3);
}

static void test_the_filter_recovers_from_nonsense_measurements(void **state)
{
	struct fusion f = fusion(NINE_AXES);
	struct errors e = {.rate_hz = 0};

	(void)state;
	follow(&f, &e, 1, 5);
	for (int k = 0; k < 1000; k++) {
		struct imu_sample s = {
			.gyro_rad_s = any_vec(1000),
			.accel_m_s2 = k % 3 ? any_vec(1e5) : (struct vec3){NAN, 0, INFINITY},
			.mag_uT = k % 5 ? any_vec(1e6) : (struct vec3){0, 0, 0},
			.flags = k % 2 ? SAMPLE_MAG : 0,
		};

		fusion_step(&f, &s, 0.005);
		assert_near(quat_apart_rad(f.q_nb, f.q_nb), 0, 1e-6);
		assert_true(vec3_finite(f.gyro_errors.bias_b_rad_s));
	}
	assert_true(follow(&f, &e, 1, 120).tilt_rad < 2 * RAD_PER_DEG);
}

static double tilt_off_rad(const struct fusion *f, struct quat truth)
{
	return acos(fmin(1, vec3_dot(up_of(f->q_nb), up_of(truth))));
}

static void test_what_the_field_has_shown_is_forgotten_with_a_covariance_that_is_none(void **state)
{
	struct errors e = {.arm = {0, 0, 0}};
	struct fusion f = fusion(NINE_AXES);
	const struct hard_iron *h = &f.kalman.hard_iron;

	(void)state;
	follow(&f, &e, 1, 30);
	assert_true(h->rows.information[0][0] > 0);
	assert_true(vec3_norm(f.kalman.heading_by_offset_rad_uT) > 0);
	f.kalman.covariance[3][3] = NAN;
	for (int k = 0; k < 20; k++) {
		struct moment m = swinging(0, 0, (struct vec3){0, 0, 0});

		fusion_step(&f, &m.sample, 0.005);
	}
	assert_true(h->rows.information[0][0] == 0);
	assert_true(vec3_norm(f.kalman.heading_by_offset_rad_uT) == 0);
	for (int i = 0; i < 3; i++) /* known to 0.5 deg/s and to the configured scale, as at the start */
		assert_true(f.kalman.covariance[KALMAN_BIAS + i][KALMAN_BIAS + i] <
			    0.51 * 0.51 * RAD_PER_DEG * RAD_PER_DEG);
}

/* A field that counts although it is beyond the limits, as one does after the rejection time, is weighed by it. */
static void test_a_covariance_that_is_none_leaves_a_number_for_the_lasting_disturbance(void **state)
{
	struct errors e = {.arm = {0, 0, 0}};
	struct fusion f = fusion(NINE_AXES);

	(void)state;
	follow(&f, &e, 1, 5);
	f.kalman.rejected_s = 1000;
	f.kalman.covariance[3][3] = NAN;
	for (int k = 0; k < 20; k++) {
		struct moment m = swinging(0, 0, (struct vec3){0, 0, 0});

		fusion_step(&f, &m.sample, 0.005);
	}
	assert_true(f.kalman.heading_by_disturbance_rad2 >= 0);
}

static void test_an_attitude_upside_down_is_reinitialised_within_half_a_minute(void **state)
{
	const double turns_rad[] = {PI, 3, 2};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct fusion f = fusion(NINE_AXES);
		struct quat truth;
		struct vec3 turn = {0.6 * turns_rad[i], 0.8 * turns_rad[i], 0};

		continue_motion(&f, 0, 10, FIELD_N);
		f.q_nb = quat_multiply(quat_from_rotation_vector(turn), f.q_nb);
		truth = continue_motion(&f, 10, 40, FIELD_N);
		assert_true(tilt_off_rad(&f, truth) < 1 * RAD_PER_DEG);
		truth = continue_motion(&f, 40, 140, FIELD_N);
		assert_quat_near(f.q_nb, truth, 3 * RAD_PER_DEG);
	}
}

/* Nothing that was estimated under the wrong tilt is kept, nor its certainty. */
static void test_a_lost_tilt_takes_bias_and_scale_with_it(void **state)
{
	struct fusion f = fusion(NINE_AXES);
	struct fusion fresh = fusion(NINE_AXES);
	struct moment m = swinging(0, 0, (struct vec3){0, 0, 0});
	double known, before = PI, off = PI;

	(void)state;
	fusion_step(&fresh, &m.sample, 0.005);
	for (int k = 0; k < 200 * 20; k++)
		fusion_step(&f, &m.sample, 0.005);
	known = f.kalman.covariance[KALMAN_BIAS][KALMAN_BIAS];
	assert_true(known < 0.1 * fresh.kalman.covariance[KALMAN_BIAS][KALMAN_BIAS]);
	f.gyro_errors.scale_b = (struct vec3){0.001, -0.001, 0.001};
	f.q_nb = quat_multiply(quat_from_rotation_vector((struct vec3){2, 0, 0}), f.q_nb);
	for (int k = 0; k < 200 * 10 && off > before - 0.3; k++) {
		before = off;
		fusion_step(&f, &m.sample, 0.005);
		off = tilt_off_rad(&f, m.q_nb);
		before = k == 0 ? off : before;
	}
	assert_true(off < before - 0.3);
	assert_near(f.kalman.covariance[KALMAN_BIAS][KALMAN_BIAS] / fresh.kalman.covariance[KALMAN_BIAS][KALMAN_BIAS],
		1, 0.2);
	assert_vec_near(f.gyro_errors.scale_b, ((struct vec3){0, 0, 0}), 0);
}

/* What lies still was turned unnoticed. The mean force follows until it is off by 60 degrees; there the attitude is
 * turned back by as much or a bit more, about the right axis, and once. */
static void test_a_lost_tilt_is_turned_back_by_60_degrees_about_the_right_axis(void **state)
{
	const double turns[] = {90 * RAD_PER_DEG, 110 * RAD_PER_DEG, 130 * RAD_PER_DEG}, limit = 60 * RAD_PER_DEG;

	(void)state;
	for (int i = 0; i < 12; i++) {
		const double turn = turns[i % 3], direction = i * 0.55;
		struct fusion f = fusion(NINE_AXES);
		struct moment m = swinging(0, 0, (struct vec3){0, 0, 0});
		double before = turn;
		int jumps = 0;

		for (int k = 0; k < 200; k++)
			fusion_step(&f, &m.sample, 0.005);
		f.q_nb = quat_multiply(
			quat_from_rotation_vector((struct vec3){turn * cos(direction), turn * sin(direction), 0}),
			f.q_nb);
		for (int k = 0; k < 40 * 200; k++) {
			double off;

			fusion_step(&f, &m.sample, 0.005);
			off = tilt_off_rad(&f, m.q_nb);
			if (off < before - 0.3) {
				assert_near(before - off, limit, 12 * RAD_PER_DEG);
				jumps++;
			}
			before = off;
		}
		assert_int_equal(jumps, 1);
		assert_true(before < 1 * RAD_PER_DEG);
	}
}

/* RMS error of the tilt in the 5 s after the gyro was saturated, of several times. */
static double tilt_after_clipping_rad(unsigned flag)
{
	const double most_rad_s = 1.2;
	struct fusion f = fusion(NINE_AXES);
	double sum = 0;
	int n = 0;

	for (int k = 0; k < 60 * 200; k++) {
		struct moment m = swinging(k / 200.0, 1, (struct vec3){0, 0, 0});
		struct vec3 *w = &m.sample.gyro_rad_s;
		bool clipped = k % 2000 > 1600 && fmax(fabs(w->x), fmax(fabs(w->y), fabs(w->z))) > most_rad_s;

		if (clipped) {
			*w = (struct vec3){fmin(most_rad_s, fmax(-most_rad_s, w->x)),
				fmin(most_rad_s, fmax(-most_rad_s, w->y)), fmin(most_rad_s, fmax(-most_rad_s, w->z))};
			m.sample.flags |= flag;
		}
		fusion_step(&f, &m.sample, 0.005);
		if (k < 2000 || k % 2000 > 1000)
			continue;
		sum += pow(tilt_off_rad(&f, m.q_nb), 2);
		n++;
	}
	return sqrt(sum / n);
}

static void test_after_saturation_of_the_gyro_the_tilt_follows_the_accelerometer(void **state)
{
	double flagged = tilt_after_clipping_rad(SAMPLE_SATURATED), unflagged = tilt_after_clipping_rad(0);

	(void)state;
	print_message("tilt error after saturation: %.2f degrees, %.2f without the flag\n", flagged / RAD_PER_DEG,
		unflagged / RAD_PER_DEG);
	assert_true(flagged < 0.7 * unflagged);
}

/* A field of the Earth's length and dip, but from the south. */
static void test_a_field_from_the_opposite_direction_is_a_heading_outlier(void **state)
{
	struct fusion f = fusion(NINE_AXES);
	struct quat truth;

	(void)state;
	continue_motion(&f, 0, 30, FIELD_N);
	truth = continue_motion(&f, 30, 80, (struct vec3){5, -19.4, -45});
	assert_quat_near(f.q_nb, truth, 2 * RAD_PER_DEG);
}

/* Accelerated by 10 m/s^2 to and fro, so that the first tilt may be wrong by 45 degrees. */
static void test_the_heading_converges_within_half_a_minute_of_a_start_in_violent_motion(void **state)
{
	double worst = 0;

	(void)state;
	for (int i = 0; i < 60; i++) {
		struct fusion f = fusion(NINE_AXES);
		struct moment m = swinging(0, 1, (struct vec3){0, 0, 0});

		for (int k = 0; k < 30 * 200; k++) {
			double t = 0.7 * i + k / 200.0;
			struct vec3 shaken = {10 * sin(7 * t), 10 * cos(9 * t), 0};

			m = swinging(t, 1, (struct vec3){0, 0, 0});
			m.sample.accel_m_s2 = vec3_add(m.sample.accel_m_s2, quat_rotate_inverse(m.q_nb, shaken));
			fusion_step(&f, &m.sample, 0.005);
		}
		worst = fmax(worst, quat_apart_rad(f.q_nb, m.q_nb));
	}
	print_message("worst of 60 starts in motion: %.1f degrees off after 30 s\n", worst / RAD_PER_DEG);
	assert_true(worst < 10 * RAD_PER_DEG);
}

static void test_a_wrong_heading_is_corrected_after_the_rejection_time(void **state)
{
	struct fusion f = fusion(NINE_AXES);
	struct quat truth;

	(void)state;
	continue_motion(&f, 0, 30, FIELD_N);
	f.q_nb = quat_multiply(quat_from_rotation_vector((struct vec3){0, 0, 2.5}), f.q_nb);
	truth = continue_motion(&f, 30, 30 + NINE_AXES.kalman.rejection_time_s + 30, FIELD_N);
	assert_quat_near(f.q_nb, truth, 3 * RAD_PER_DEG);
}

static void test_the_tilt_of_a_simulated_chip_is_within_half_a_degree_in_every_motion(void **state)
{
	(void)state;
	for (const struct signal *signal = SIGNALS; signal->name; signal++) {
		struct sensor_config config = *sensor_preset("lsm303dlhc_l3gd20");
		struct fusion_config now = NINE_AXES;
		struct fusion f;
		const int n = 60 * 100;
		struct sensor sensor;
		double sum = 0;

		now.delay_s = 1 / (2 * PI * config.gyro.bandwidth_hz);
		f = fusion(now);
		sensor_calibrate(&config);
		assert_int_equal(sensor_init(&sensor, &config, 1), 0);
		for (int k = 0; k < n; k++) {
			struct signal_truth truth;
			struct imu_sample s;
			double off;

			sensor_next(&sensor, signal, &s, &truth);
			fusion_step(&f, &s, 1 / config.rate_hz);
			off = acos(fmin(1, vec3_dot(up_of(fusion_attitude_now(&f, s.gyro_rad_s)), up_of(truth.q_nb))));
			sum += k >= n / 2 ? off * off / (n - n / 2) : 0;
		}
		assert_true(sqrt(sum) < 0.5 * RAD_PER_DEG);
	}
}

static void test_the_attitude_is_extrapolated_over_the_delay_by_the_rate(void **state)
{
	struct fusion_config config = NINE_AXES;
	struct errors e = {.rate_hz = 0};
	struct fusion f;

	(void)state;
	config.delay_s = 0.01;
	f = fusion(config);
	follow(&f, &e, 0, 1);
	assert_quat_near(fusion_attitude_now(&f, vec3_add(f.gyro_errors.bias_b_rad_s, (struct vec3){1, 0, 0})),
		quat_multiply(f.q_nb, quat_from_rotation_vector((struct vec3){0.01, 0, 0})), 1e-9);
}

/* 1 sigma of the heading after a second of fields, as their noise makes it. */
static double heading_sigma(double field_sigma_uT)
{
	struct errors e = {.rate_hz = 100};
	struct fusion_config config = NINE_AXES;
	struct fusion f;

	config.kalman.field_sigma_uT = field_sigma_uT;
	f = fusion(config);
	follow(&f, &e, 0, 1);
	fusion_kalman_set_heading(&f.kalman, 1); /* unknown within a radian, */
	f.kalman.aided_heading_s = 0;		 /* .. and the field points to its north */
	follow(&f, &e, 0, 1);
	return sqrt(f.kalman.covariance[KALMAN_HEADING][KALMAN_HEADING]);
}

static void test_the_noise_of_the_magnetometer_counts_in_the_sigma_of_the_heading(void **state)
{
	double quiet = heading_sigma(0.5), noisy = heading_sigma(100);

	(void)state;
	/* 100 uT in 100 fields of 20 uT, horizontally: 0.5 rad beside what a quiet magnetometer leaves */
	assert_true(noisy > 1.2 * quiet);
	assert_true(noisy < hypot(quiet, 0.6));
	assert_near(heading_sigma(0), quiet, 1e-3);
}

/* Those that fusion_kalman.h gives. */
static void test_the_ranges_of_the_configuration_include_their_limits(void **state)
{
	struct fusion_config c = NINE_AXES;
	const struct {
		double *value, least, most;
	} ranges[] = {{&c.kalman.velocity_sigma_m_s, 0.01, 1000}, {&c.kalman.heading_sigma_rad, 0.001, 1},
		{&c.kalman.field_limit, 0.01, 1}, {&c.kalman.rejection_time_s, 0, 1e6}, {&c.kalman.gyro_error, 0, 0.1},
		{&c.kalman.bias_walk_rad_s_sqrt_s, 0, 0.1}, {&c.kalman.gyro_scale_sigma, 0, 0.05},
		{&c.kalman.field_sigma_uT, 0, 1000}};
	struct fusion f;

	(void)state;
	for (size_t i = 0; i < sizeof(ranges) / sizeof(ranges[0]); i++) {
		const double good = *ranges[i].value, beyond = 1e-6 * ranges[i].most;

		for (int k = 0; k < 4; k++) {
			*ranges[i].value = (k % 2 ? ranges[i].most : ranges[i].least) + (k < 2		? 0
												: k % 2 ? beyond
													: -beyond);
			assert_int_equal(fusion_init(&f, &c), k < 2 ? 0 : -EINVAL);
		}
		*ranges[i].value = good;
	}
}

static void test_a_configuration_out_of_range_is_refused(void **state)
{
	struct fusion_config bad[10];
	struct fusion f;

	(void)state;
	for (int i = 0; i < 10; i++)
		bad[i] = NINE_AXES;
	bad[0].kalman.velocity_sigma_m_s = 0;
	bad[1].kalman.heading_sigma_rad = 2;
	bad[2].kalman.field_limit = NAN;
	bad[3].kalman.rejection_time_s = -1;
	bad[4].kalman.gyro_error = 0.2;
	bad[5].kalman.bias_walk_rad_s_sqrt_s = INFINITY;
	bad[6].delay_s = 0.2;
	bad[7].lever_arm_b_m.x = NAN;
	bad[8].algorithm = (enum fusion_algorithm)3;
	bad[9].kalman.field_sigma_uT = -1;
	for (int i = 0; i < 10; i++)
		assert_int_equal(fusion_init(&f, &bad[i]), -EINVAL);
}

/* A level object on a circle: a constant speed in a direction that turns twice a second. Gravity and the centripetal
 * acceleration are all that it feels. */
static void test_the_spread_of_the_velocity_is_its_mean_square_of_an_axis(void **state)
{
	const double speed_m_s = 0.8, omega_rad_s = 4 * PI, dt_s = 0.005;
	struct fusion f = fusion(six_axes());
	double mean_m2_s2 = 0;

	(void)state;
	for (int k = 0; k < 12000; k++) {
		double t = k * dt_s;
		struct imu_sample s = {.accel_m_s2 = {-speed_m_s * omega_rad_s * sin(omega_rad_s * t),
					       speed_m_s * omega_rad_s * cos(omega_rad_s * t), G}};

		fusion_step(&f, &s, dt_s);
		if (k >= 6000)
			mean_m2_s2 += f.kalman.spread_m2_s2 / 6000;
	}
	assert_near(mean_m2_s2, speed_m_s * speed_m_s / 2, 0.05);
}

/* A level object that turns about the vertical, 1 rad/s. */
static struct imu_sample turning_level(double t, struct vec3 field_n)
{
	struct quat q_nb = quat_from_rotation_vector((struct vec3){0, 0, t});

	return (struct imu_sample){.gyro_rad_s = {0, 0, 1},
		.accel_m_s2 = {0, 0, G},
		.mag_uT = quat_rotate_inverse(q_nb, field_n),
		.flags = SAMPLE_MAG};
}

/* The limit is 10 % of the length, and twice 0.1 rad of the dip. */
static void test_a_field_beyond_the_limits_of_length_or_dip_is_not_used(void **state)
{
	static const struct {
		double length, dip_rad;
		bool used;
	} FIELDS[] = {{1.08, 0, true}, {1.12, 0, false}, {0.92, 0, true}, {0.88, 0, false}, {1, 0.17, true},
		{1, 0.25, false}, {1, -0.17, true}, {1, -0.25, false}};

	(void)state;
	for (size_t i = 0; i < sizeof(FIELDS) / sizeof(FIELDS[0]); i++) {
		struct vec3 other = vec3_scale(FIELDS[i].length,
			quat_rotate(quat_from_rotation_vector((struct vec3){-FIELDS[i].dip_rad, 0, 0}), FIELD_N));
		struct fusion f = fusion(NINE_AXES);
		int used = 0;

		for (int k = 0; k < 200 * 30; k++) {
			double t = k / 200.0;
			struct imu_sample s = turning_level(t, t < 20 ? FIELD_N : other);

			fusion_step(&f, &s, 1.0 / 200);
			used += t > 21 && fusion_mag_used(&f);
		}
		assert_int_equal(used > 100, FIELDS[i].used);
		assert_int_equal(used == 0, !FIELDS[i].used);
	}
}

static void test_the_fifth_yaw_in_a_row_that_contradicts_the_heading_sets_it(void **state)
{
	const struct vec3 still = {0, 0, 0};
	const struct imu_sample level = {.accel_m_s2 = {0, 0, G}};
	struct fusion f = fusion(six_axes());

	(void)state;
	fusion_step(&f, &level, 0.01);
	fusion_aid_yaw(&f, 0, RAD_PER_DEG, still);
	for (int k = 1; k <= 5; k++) {
		fusion_step(&f, &level, 0.01);
		assert_int_equal(fusion_aid_yaw(&f, PI / 2, RAD_PER_DEG, still), k == 5);
		assert_quat_near(f.q_nb, quat_from_rotation_vector((struct vec3){0, 0, k == 5 ? PI / 2 : 0}), 1e-3);
	}
}

/* From then on the field keeps the heading that was set: it points where it points under that heading. */
static void test_under_a_heading_that_was_set_the_field_is_the_reference_again(void **state)
{
	const struct vec3 still = {0, 0, 0};

	(void)state;
	for (int by_yaw = 0; by_yaw < 2; by_yaw++) {
		const struct quat set = quat_from_rotation_vector((struct vec3){0, 0, 1});
		struct moment m = swinging(0, 0, (struct vec3){0, 0, 0});
		struct fusion f = fusion(NINE_AXES);

		for (int k = 0; k < 200 * 120; k++) {
			m.sample.gyro_rad_s = (struct vec3){0.3 * sin(k * 0.3), 0, 0};
			fusion_step(&f, &m.sample, 0.005);
			if (by_yaw && k >= 2000 && k < 2010)
				fusion_aid_yaw(&f, 1, RAD_PER_DEG, still);
			if (!by_yaw && k == 2000)
				fusion_set_attitude(&f, set);
		}
		assert_quat_near(f.q_nb, set, 2 * RAD_PER_DEG);
		assert_true(fusion_mag_used(&f) || f.kalman.sums.time_s > 0);
	}
}

/* Straight up there is no yaw: a quarter turn about z is one, a quarter turn about y is not. */
static void test_a_yaw_from_outside_counts_at_any_heading_but_not_straight_up(void **state)
{
	const struct vec3 still = {0, 0, 0}, y = {0, PI / 2, 0}, z = {0, 0, PI / 2};
	struct fusion level = fusion(six_axes()), up = level;

	(void)state;
	fusion_set_attitude(&level, quat_from_rotation_vector(z));
	fusion_set_attitude(&up, quat_from_rotation_vector(y));
	fusion_aid_yaw(&level, PI / 2 + 0.02, 1e-4, still);
	fusion_aid_yaw(&up, 0.02, 1e-4, still);
	assert_quat_near(level.q_nb, quat_from_rotation_vector((struct vec3){0, 0, PI / 2 + 0.02}), 1e-3);
	assert_quat_near(up.q_nb, quat_from_rotation_vector(y), 0);
}

/* ---- the model of the errors, in closed form --------------------------------------------------------------------- */

static const struct fusion_kalman_config KALMAN = FUSION_KALMAN_DEFAULTS;

struct filter {
	struct fusion_kalman k;
	struct quat q_nb;
	struct gyro_errors errors;
};

static struct filter started(double force_m_s2)
{
	struct filter f = {.q_nb = QUAT_IDENTITY};

	fusion_kalman_start(&f.k, &KALMAN, force_m_s2);
	f.k.bias_known = true;
	return f;
}

/* Samples of a level object until a correction; its time. */
static double one_correction_under(
	double force_m_s2, struct filter *f, struct vec3 rate_b_rad_s, bool rest, bool saturated)
{
	const struct fusion_kalman_sample s = {.gyro_b_rad_s = rate_b_rad_s,
		.rate_b_rad_s = rate_b_rad_s,
		.force_b_m_s2 = {0, 0, force_m_s2},
		.rest = rest,
		.steady_s = rest ? 10 : 0,
		.saturated = saturated};
	double t = 0;

	do {
		fusion_kalman_step(&f->k, &KALMAN, &s, 1e-3, &f->q_nb, &f->errors);
		t += 1e-3;
	} while (f->k.sums.time_s > 0);
	return t;
}

static double one_correction(struct filter *f, struct vec3 rate_b_rad_s, bool rest, bool saturated)
{
	return one_correction_under(G, f, rate_b_rad_s, rest, saturated);
}

static double sigma_of(const struct filter *f, int i)
{
	return sqrt(f->k.covariance[i][i]);
}

/* What the length of the force lacks is one of three parts of the accelerometer's error; at rest it is the one that
 * counts, and an excess is an error, too. Up to 2 % in motion, and 1 % at rest, calibrated accelerometers differ as
 * well. */
static void test_an_accelerometer_is_as_uncertain_as_the_length_of_its_force_shows(void **state)
{
	static const struct {
		double force_m_s2;
		bool rest;
		double sigma_m_s2;
	} cases[] = {{9.81, false, 0.03}, {9.63, false, 0.03}, {9.31, false, 0.866}, {10.31, false, 0.03},
		{9.81, true, 0.03}, {9.73, true, 0.03}, {9.31, true, 0.5}, {10.31, true, 0.5}};

	(void)state;
	for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
		struct filter f = started(cases[i].force_m_s2);

		for (int k = 0; k < 100; k++)
			one_correction_under(cases[i].force_m_s2, &f, (struct vec3){0, 0, 0}, cases[i].rest, false);
		for (int k = 0; k < 3; k++)
			assert_near(sigma_of(&f, KALMAN_ACCEL + k), cases[i].sigma_m_s2, 0.01);
	}
}

/* A force that is not gravity shows a tilt that is as wrong as its length. */
static void test_at_the_start_the_tilt_is_known_as_well_as_the_length_of_the_force_fits_gravity(void **state)
{
	const double forces_m_s2[] = {9.8, 9.8 * 1.2, 9.8 * 0.7, 30}, tilts_rad[] = {0.1, 0.3, 0.4, 1};

	(void)state;
	for (int i = 0; i < 4; i++) {
		const struct filter f = started(forces_m_s2[i]);

		assert_near(sigma_of(&f, 0), tilts_rad[i], 1e-9);
		assert_near(sigma_of(&f, 1), tilts_rad[i], 1e-9);
		assert_near(sigma_of(&f, KALMAN_HEADING), KALMAN.heading_sigma_rad, 1e-9);
		for (int k = 0; k < 3; k++) {
			assert_near(sigma_of(&f, KALMAN_BIAS + k), 0.5 * RAD_PER_DEG, 1e-9);
			assert_near(sigma_of(&f, KALMAN_SCALE + k), KALMAN.gyro_scale_sigma, 1e-9);
			assert_near(sigma_of(&f, KALMAN_ACCEL + k), 0.03, 1e-9);
		}
		assert_near(sigma_of(&f, KALMAN_VELOCITY), 0.3, 1e-9);
		assert_near(sigma_of(&f, KALMAN_VELOCITY + 1), 0.3, 1e-9);
	}
}

/* White noise of 0.09 deg/s/sqrt(Hz), about the vertical 0.12, an error proportional to the rate that lasts for 0.3 s,
 * half of the rate where the gyro is saturated; the bias walks, and the scale returns to its start within 10 hours. */
static void test_a_turn_makes_the_attitude_less_certain_by_the_gyros_errors(void **state)
{
	const struct vec3 rate = {3, -4, 12};

	(void)state;
	for (int saturated = 0; saturated < 2; saturated++) {
		struct filter f = started(G);
		double t, by_rate;

		memset(f.k.covariance, 0, sizeof(f.k.covariance));
		t = one_correction(&f, rate, false, saturated);
		by_rate = pow(KALMAN.gyro_error, 2) * 0.3 * 169 * t + pow(saturated ? 0.5 * 13 * t : 0, 2);
		for (int k = 0; k < 3; k++) {
			double white = (k == KALMAN_HEADING ? 0.12 : 0.09) * RAD_PER_DEG;

			assert_near(f.k.covariance[k][k] / (t * white * white + by_rate), 1, 1e-6);
			assert_near(f.k.covariance[KALMAN_BIAS + k][KALMAN_BIAS + k] /
					    (t * pow(KALMAN.bias_walk_rad_s_sqrt_s, 2)),
				1, 1e-6);
			assert_near(f.k.covariance[KALMAN_SCALE + k][KALMAN_SCALE + k] /
					    (t / 36000 * pow(KALMAN.gyro_scale_sigma, 2)),
				1, 1e-6);
		}
	}
}

/* In motion a velocity of zero, with at least 0.35 of the configured sigma, once in 0.25 s; 0.01 m/s at rest. */
static void test_the_velocity_is_measured_as_zero_with_its_spread_or_as_that_of_rest(void **state)
{
	(void)state;
	for (int rest = 0; rest < 2; rest++) {
		struct filter f = started(G);
		double t, noise, before = 0.04;

		memset(f.k.covariance, 0, sizeof(f.k.covariance));
		f.k.resting = rest;
		f.k.covariance[KALMAN_VELOCITY][KALMAN_VELOCITY] = before;
		t = one_correction(&f, (struct vec3){0, 0, rest ? 0 : 1e-3}, rest, false);
		noise = rest ? 1e-4 : 2 * 0.25 / t * pow(0.35 * KALMAN.velocity_sigma_m_s, 2);
		assert_near(f.k.covariance[KALMAN_VELOCITY][KALMAN_VELOCITY] / (before * noise / (before + noise)), 1,
			1e-3);
	}
}

/* While it holds the field does not correct the heading, and the velocity is not measured as zero. */
static void test_a_yaw_and_a_velocity_from_outside_hold_for_10_s(void **state)
{
	struct moment m = swinging(0, 0, (struct vec3){0, 0, 0});
	struct fusion f = fusion(NINE_AXES);
	double used_from_s = 0, velocity_until_s = 0;
	int used_before = 0;

	(void)state;
	for (int k = 0; k < 200 * 30; k++) {
		const double since_s = (k - 2000) / 200.0;

		if (k == 2000) {
			assert_true(used_before > 100);
			fusion_aid_yaw(&f, 0, 0.01, m.sample.gyro_rad_s);
			fusion_aid_velocity(&f, (struct vec3){1, 0, 0}, 0.1, m.sample.gyro_rad_s);
		}
		m.sample.gyro_rad_s.x = 0.3 * sin(k * 0.3); /* no rest */
		fusion_step(&f, &m.sample, 0.005);
		used_before += k < 2000 && fusion_mag_used(&f);
		if (k > 2000 && used_from_s == 0 && fusion_mag_used(&f))
			used_from_s = since_s;
		if (k > 2000 && f.kalman.aided_velocity_s > 0)
			velocity_until_s = since_s;
	}
	assert_near(used_from_s, 10, 0.1);
	assert_near(velocity_until_s, 10, 0.1);
}

/* At any sample between two corrections. The velocity since the last one counts as if the arm had always been the new
 * one. */
static void test_the_velocity_of_the_lever_arm_is_that_of_a_new_arm_from_the_last_correction_on(void **state)
{
	const struct vec3 rate = {0, 0, 2}, arm = {0.3, 0, 0}, new_arm = {0, 0.5, 0};
	struct fusion_kalman_sample s = {.gyro_b_rad_s = rate, .rate_b_rad_s = rate, .force_b_m_s2 = {0, 0, G}};

	(void)state;
	for (int at = 100; at < 140; at++) {
		struct filter f = started(G);

		for (int k = 0; k <= at; k++) {
			s.lever_arm_b_m = k < at ? arm : new_arm;
			fusion_kalman_step(&f.k, &KALMAN, &s, 1e-3, &f.q_nb, &f.errors);
			f.q_nb = QUAT_IDENTITY;
		}
		assert_vec_near(f.k.lever_n_m_s, vec3_cross(rate, new_arm), 1e-9);
		if (f.k.sums.time_s > 0)
			assert_vec_near(f.k.sums.lever_from_n_m_s, vec3_cross(rate, new_arm), 1e-9);
	}
}

/* Turned the one way or the other, fast or slowly. */
static void test_after_half_a_second_without_samples_the_velocity_before_does_not_count(void **state)
{
	struct filter after[2];

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct fusion_kalman_sample s = {
			.rate_b_rad_s = {0, 0, i ? 2 : -2}, .force_b_m_s2 = {0, 0, G}, .lever_arm_b_m = {0.3, 0, 0}};

		after[i] = started(G);
		for (int k = 0; k < 115; k++) {
			fusion_kalman_step(&after[i].k, &KALMAN, &s, 1e-3, &after[i].q_nb, &after[i].errors);
			after[i].q_nb = QUAT_IDENTITY;
			after[i].k.velocity_n_m_s[i] += 0.01;
		}
		s.rate_b_rad_s = (struct vec3){0, 0, 1};
		s.unseen_turn_rad = 0.5;
		fusion_kalman_step(&after[i].k, &KALMAN, &s, 0.5, &after[i].q_nb, &after[i].errors);
		assert_true(sigma_of(&after[i], KALMAN_VELOCITY) > 0.15); /* unknown, but for one measurement of zero */
	}
	assert_quat_near(after[0].q_nb, after[1].q_nb, 1e-9);
	for (int i = 0; i < 2; i++)
		assert_near(after[0].k.velocity_n_m_s[i], after[1].k.velocity_n_m_s[i], 1e-9);
}

static void test_a_yaw_from_outside_counts_up_to_5_sigma(void **state)
{
	const double own = 0.1, sigma = 0.05, limit = 5 * hypot(own, sigma);

	(void)state;
	for (int i = 0; i < 2; i++) {
		const double innovation = (i ? 1.01 : 0.99) * limit;
		struct filter f = started(G);

		memset(f.k.covariance, 0, sizeof(f.k.covariance));
		f.k.covariance[KALMAN_HEADING][KALMAN_HEADING] = own * own;
		assert_false(fusion_kalman_aid_heading(&f.k, &KALMAN, innovation, sigma * sigma, &f.q_nb, &f.errors));
		assert_near(
			2 * f.q_nb.z, i ? 0 : 2 * sin(innovation * own * own / (own * own + sigma * sigma) / 2), 1e-9);
		assert_near(sigma_of(&f, KALMAN_HEADING), i ? own : own * sigma / hypot(own, sigma), 1e-9);
	}
}

/* Of the mean rate over 0.3 s, by a noise of 0.03 deg/s/sqrt(Hz) on each axis, four sigma are 0.379 deg/s. */
static void test_a_steady_rate_beyond_four_sigma_of_a_known_bias_is_no_rest(void **state)
{
	(void)state;
	for (int turns = 0; turns < 2; turns++) {
		struct filter f = started(G);

		for (double t = 0; t < 1.8;) {
			for (int i = KALMAN_BIAS; i < KALMAN_BIAS + 3; i++)
				f.k.covariance[i][i] = 0;
			t += one_correction(&f, (struct vec3){0, 0, (turns ? 0.39 : 0.37) * RAD_PER_DEG}, true, false);
		}
		assert_int_equal(f.k.resting, !turns);
	}
}

/* A second of one steady rate about the vertical, four of another one, and three of the first again. The second rate is
 * measured once: its sigma as bias is the difference d of both, less the more probable it is than the first one, for
 * which the bias's own sigma s speaks: d / sqrt(1 + exp((first^2 - then^2) / 2 s^2)). */
static void test_of_two_steady_rates_the_second_is_bias_as_far_as_the_calibration_tells(void **state)
{
	static const double rates_deg_s[][2] = {{0, 1}, {1, 0}, {0.4, -0.6}, {-0.6, 0.4}, {0, -0.6}};
	const double s_deg_s = 0.5; /* of FUSION_KALMAN_DEFAULTS */

	(void)state;
	for (size_t i = 0; i < sizeof rates_deg_s / sizeof *rates_deg_s; i++) {
		const double first = rates_deg_s[i][0], then = rates_deg_s[i][1];
		const double more = exp((first * first - then * then) / 2 / s_deg_s / s_deg_s);
		const double variance_deg2_s2 = (then - first) * (then - first) / (1 + more);
		struct filter f = started(G);
		int measured = 0;

		f.k.bias_known = false;
		for (double t = 0; t < 8;) {
			const double before = f.k.covariance[KALMAN_BIAS + 2][KALMAN_BIAS + 2];
			const struct vec3 rate = {0, 0, (t < 1 || t > 5 ? first : then) * RAD_PER_DEG};
			double after;

			t += one_correction(&f, rate, true, false);
			f.q_nb = QUAT_IDENTITY;
			assert_true(t > 5 || !f.k.bias_known);
			after = f.k.covariance[KALMAN_BIAS + 2][KALMAN_BIAS + 2];
			if (t > 5 || t < 2 || after > before)
				continue;
			assert_near(
				before * after / (before - after) / pow(RAD_PER_DEG, 2) / variance_deg2_s2, 1, 0.01);
			measured++;
		}
		assert_int_equal(measured, 1);
		assert_true(f.k.bias_known);
		assert_near(f.errors.bias_b_rad_s.z / RAD_PER_DEG, first, 0.02);
	}
}

/* The centripetal acceleration of a circle: the velocity's spread (here the least, 0.35 m/s) times the rate about the
 * vertical, of which a mean over 5 s is known; what it varies by is no part of it. After a time constant the mean of
 * what began at 0 is 1 - 1/e of it, and so is that of its square. */
static void test_a_steady_rate_about_the_vertical_may_be_that_of_a_circle(void **state)
{
	static const struct {
		double turn_rad_s, varies_rad_s, s, steady2_rad2_s2;
	} cases[] = {
		{0.5, 0, 60, 0.25},
		{-0.5, 0, 60, 0.25},
		{0.5, 0, 5, 0.25 * (2 * 0.632 * 0.632 - 0.632)},
		{0.5, 0.4, 60, 0.25 - 0.16},
		{0.5, 0.6, 60, 0},
		{0, 0.5, 60, 0},
	};
	const struct quat tilted = quat_from_rotation_vector((struct vec3){0.7, -0.4, 0.2});

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		struct filter f = started(G);
		double t = 0;

		for (int n = 0; t < cases[i].s; n++) {
			const double up = cases[i].turn_rad_s + (n % 2 ? 1 : -1) * cases[i].varies_rad_s;
			const struct vec3 rate = quat_rotate_inverse(tilted, (struct vec3){0.2, 0.3, up});
			const struct fusion_kalman_sample s = {.gyro_b_rad_s = rate,
				.rate_b_rad_s = rate,
				.force_b_m_s2 = quat_rotate_inverse(tilted, (struct vec3){0, 0, G})};

			do {
				f.q_nb = tilted;
				fusion_kalman_step(&f.k, &KALMAN, &s, 1e-3, &f.q_nb, &f.errors);
				t += 1e-3;
			} while (f.k.sums.time_s > 0);
		}
		assert_near(f.k.circle_m2_s4 / (0.35 * 0.35), cases[i].steady2_rad2_s2, 3e-3);
	}
}

/* A second's mean of the force that is for 3 s far from the vertical is gravity if it is as long to 3 m/s^2, and so is
 * the mean length over 10 s. In the first 6 s after the force has set the tilt it is gravity at once. */
static void test_a_mean_force_far_from_the_vertical_is_gravity_after_3_s_if_it_is_about_as_long(void **state)
{
	static const struct {
		double force_m_s2, mean_length_m_s2, lost_s, since_tilt_s;
		bool gravity;
	} cases[] = {
		{G + 2.9, G, 3.1, 10, true},
		{G + 3.1, G, 3.1, 10, false},
		{G - 2.9, G, 3.1, 10, true},
		{G - 3.1, G, 3.1, 10, false},
		{G, G + 2.9, 3.1, 10, true},
		{G, G + 3.1, 3.1, 10, false},
		{G, G - 2.9, 3.1, 10, true},
		{G, G - 3.1, 3.1, 10, false},
		{G, G, 2.9, 10, false},
		{G, G, 0, 6.1, false},
		{G + 9, G + 9, 0, 5.9, true},
	};

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		struct filter f = started(G);

		f.k.mean_force_n_m_s2 = (struct vec3){0, 0, -cases[i].force_m_s2};
		f.k.mean_force_m_s2 = cases[i].mean_length_m_s2;
		f.k.lost_s = cases[i].lost_s;
		f.k.since_tilt_s = cases[i].since_tilt_s;
		one_correction_under(-cases[i].force_m_s2, &f, (struct vec3){0, 0, 0}, false, false);
		assert_near(up_of(f.q_nb).z, cases[i].gravity ? -1 : 1, 1e-3);
	}
}

/* Bias that is estimated within 4 s of a steady rate about the vertical, while the field turns by a share of it. */
static double bias_of_a_steady_rate(double rate_rad_s, double share)
{
	struct filter f = started(G);

	f.k.bias_known = false;
	for (int k = 0; k < 4000; k++) {
		const struct vec3 turned = {0, 0, share * rate_rad_s * k * 1e-3};
		const struct vec3 field_b = quat_rotate_inverse(quat_from_rotation_vector(turned), FIELD_N);
		const struct fusion_kalman_sample s = {.gyro_b_rad_s = {0, 0, rate_rad_s},
			.rate_b_rad_s = {0, 0, rate_rad_s - f.errors.bias_b_rad_s.z},
			.force_b_m_s2 = {0, 0, G},
			.field_b_uT = &field_b,
			.rest = true,
			.steady_s = 100};

		f.q_nb = quat_multiply(f.q_nb, quat_from_rotation_vector(vec3_scale(1e-3, s.rate_b_rad_s)));
		fusion_kalman_step(&f.k, &KALMAN, &s, 1e-3, &f.q_nb, &f.errors);
	}
	return f.errors.bias_b_rad_s.z;
}

static void test_a_steady_rate_is_bias_unless_the_field_turns_with_it(void **state)
{
	(void)state;
	assert_near(bias_of_a_steady_rate(0.05, 0), 0.05, 1e-4);
	assert_near(bias_of_a_steady_rate(0.05, 0.3), 0.05, 1e-4);
	assert_true(bias_of_a_steady_rate(0.05, 0.5) < 0.025);
	assert_near(bias_of_a_steady_rate(0.05, 1), 0, 1e-3);
}

/* 1 sigma of the heading by turns, a minute at 3 rad/s without magnetometer, reversed after each `period_s`; and the
 * rest of its variance. */
static double turned_sigma_rad(double period_s, double *covariance_rad2, double aided_rad2)
{
	struct fusion_config config = NINE_AXES;
	struct fusion f;
	double variance;

	config.use_magnetometer = 0;
	f = fusion(config);
	for (int k = 0; k < 60 * 200; k++) {
		double direction = (int)(k / 200.0 / period_s) % 2 == 0 ? 1 : -1;
		const struct imu_sample sample = {.gyro_rad_s = {.z = 3 * direction}, .accel_m_s2 = {.z = G}};

		fusion_step(&f, &sample, 0.005);
	}
	if (aided_rad2 > 0)
		fusion_kalman_aid_heading(&f.kalman, &f.config.kalman, 0, aided_rad2, &f.q_nb, &f.gyro_errors);
	variance = fusion_kalman_heading_variance(&f.kalman, &f.config.kalman);
	*covariance_rad2 = f.kalman.covariance[KALMAN_HEADING][KALMAN_HEADING];
	return sqrt(variance - *covariance_rad2);
}

/* 0.1 % of 180 rad, or of the 3 rad of a turn to and fro; a measured heading leaves its share of it. */
static void test_turns_in_one_direction_leave_an_error_of_the_heading_that_grows_with_them(void **state)
{
	const double aided = 0.01;
	double before, after;

	(void)state;
	assert_near(turned_sigma_rad(1000, &before, 0), 0.18, 0.002);
	assert_near(turned_sigma_rad(1, &after, 0), 0.003, 0.0002);
	assert_near(turned_sigma_rad(1000, &after, aided), 0.18 * aided / (before + aided), 0.002);
}

static void test_no_number_of_turns_makes_the_heading_less_certain_than_unknown(void **state)
{
	struct filter f = started(G);

	(void)state;
	f.k.net_turn_max_rad = 1e6;
	assert_near(fusion_kalman_heading_variance(&f.k, &KALMAN), PI * PI / 3, 1e-6); /* uniform over a full turn */
}

static void test_a_set_attitude_is_known_to_a_degree(void **state)
{
	struct filter f = started(G);

	(void)state;
	fusion_kalman_set_attitude(&f.k, &KALMAN);
	for (int i = 0; i < 3; i++)
		assert_near(sigma_of(&f, i), 1 * RAD_PER_DEG, 1e-9);
	assert_near(sigma_of(&f, KALMAN_VELOCITY), 0.3, 1e-9);
	f = (struct filter){.q_nb = QUAT_IDENTITY}; /* before the first sample */
	fusion_kalman_set_attitude(&f.k, &KALMAN);
	assert_near(sigma_of(&f, KALMAN_BIAS), 0.5 * RAD_PER_DEG, 1e-9);
	assert_near(sigma_of(&f, KALMAN_SCALE), KALMAN.gyro_scale_sigma, 1e-9);
}

/* An error of the tilt about the field's own direction turns the measured field by the tangent of the dip, 3 in Central
 * Europe. One across it turns nothing. */
static void test_the_first_north_is_as_uncertain_as_the_tilt_makes_it(void **state)
{
	struct filter f = started(9.8);

	(void)state;
	fusion_kalman_set_north(&f.k, &KALMAN, QUAT_IDENTITY, (struct vec3){0, 20, -45});
	assert_near(sigma_of(&f, KALMAN_HEADING), hypot(KALMAN.heading_sigma_rad, 3 * 0.1), 1e-9);
	f.k.covariance[0][0] = 0.2 * 0.2;
	fusion_kalman_set_north(&f.k, &KALMAN, QUAT_IDENTITY, (struct vec3){0, 20, -45});
	assert_near(sigma_of(&f, KALMAN_HEADING), hypot(KALMAN.heading_sigma_rad, 3 * 0.1), 1e-9);
	fusion_kalman_set_north(&f.k, &KALMAN, QUAT_IDENTITY, (struct vec3){20, 0, -45});
	assert_near(sigma_of(&f, KALMAN_HEADING), hypot(KALMAN.heading_sigma_rad, 3 * 0.2), 1e-9);
}

/* By what it may have turned without a measurement; at most a radian of tilt, and the heading until it may be any. */
static void test_over_missing_samples_the_attitude_is_uncertain_by_the_unseen_turn(void **state)
{
	const double turns_rad[] = {0, 0.05, 0.25, 3};

	(void)state;
	for (int i = 0; i < 4; i++) {
		const struct fusion_kalman_sample s = {.unseen_turn_rad = turns_rad[i]};
		struct filter f = started(G);

		memset(f.k.covariance, 0, sizeof(f.k.covariance));
		fusion_kalman_step(&f.k, &KALMAN, &s, 0.3, &f.q_nb, &f.errors);
		assert_near(sigma_of(&f, 0), fmin(1, turns_rad[i]), 0.01);
		assert_near(sigma_of(&f, 2), fmin(PI / sqrt(3), turns_rad[i]), 0.01);
	}
}

/* It changes by 2 m/s^2, or as fast as it changes now, until it may be as usual. */
static void test_over_missing_samples_the_velocity_stays_and_is_less_certain(void **state)
{
	static const struct {
		double accel_m_s2, gap_s, sigma_m_s;
	} gaps[] = {{1, 0.2, 0.4}, {4, 0.2, 0.8}, {4, 0.3, 1}};

	(void)state;
	for (int i = 0; i < 3; i++) {
		const struct fusion_kalman_sample s = {
			.unseen_turn_rad = 0.01, .force_b_m_s2 = {0, gaps[i].accel_m_s2, G}};
		struct filter f = started(G);

		memset(f.k.covariance, 0, sizeof(f.k.covariance));
		f.k.velocity_n_m_s[0] = 0.7;
		fusion_kalman_step(&f.k, &KALMAN, &s, gaps[i].gap_s, &f.q_nb, &f.errors);
		/* and one measurement of zero */
		assert_near(sigma_of(&f, KALMAN_VELOCITY), gaps[i].sigma_m_s, 0.2 * gaps[i].sigma_m_s);
		assert_near(f.k.velocity_n_m_s[0], i < 2 ? 0.7 : 0, 0.2);
	}
}

/* An arm of a metre that swings is faster than the metre per second that is expected, before and after missing samples.
 * The tilt that it had meanwhile says nothing else. */
static void test_over_missing_samples_the_velocity_is_what_it_was_usually(void **state)
{
	static const struct {
		double usual_m_s, turn_rad, sigma_m_s;
	} gaps[] = {{0.5, 0.2, 1}, {3, 0.2, 3}, {3, 0.05, 1}}; /* a small turn does not set the tilt */

	(void)state;
	for (int i = 0; i < 3; i++) {
		const struct fusion_kalman_sample s = {.unseen_turn_rad = gaps[i].turn_rad, .force_b_m_s2 = {0, 20, G}};
		struct filter f = started(G);

		f.k.since_tilt_s = 100;
		f.k.velocity2_m2_s2 = gaps[i].usual_m_s * gaps[i].usual_m_s;
		fusion_kalman_step(&f.k, &KALMAN, &s, 0.3, &f.q_nb, &f.errors);
		assert_near(sigma_of(&f, KALMAN_VELOCITY), gaps[i].sigma_m_s, 0.2 * gaps[i].sigma_m_s);
	}
}

/* The offset was wrong: the heading is off by what each microtesla of it has turned it; by too much for a linear
 * filter, and it is unknown. */
static void test_when_the_offset_changes_the_heading_is_less_certain_by_what_it_owes_to_it(void **state)
{
	struct errors e = {.arm = {0, 0, 0}};
	struct fusion settled = fusion(NINE_AXES);

	(void)state;
	follow(&settled, &e, 1, 30);
	settled.kalman.hard_iron.changes = true;
	settled.kalman.heading_by_offset_rad_uT = (struct vec3){0.01, 0, 0};
	memset(settled.kalman.hard_iron.variance_uT2, 0, sizeof settled.kalman.hard_iron.variance_uT2);
	for (int much = 0; much < 2; much++) {
		struct moment m = swinging(0, 0, (struct vec3){0, 0, 0});
		struct fusion f = settled;

		f.kalman.hard_iron.variance_uT2[0][0] = much ? 300 * 300 : 10 * 10;
		fusion_step(&f, &m.sample, 0.005);
		assert_int_equal(f.north_known, !much);
		assert_near(f.kalman.covariance[2][2] - settled.kalman.covariance[2][2], much ? 0 : 0.01, 1e-4);
		assert_vec_near(f.kalman.heading_by_offset_rad_uT, ((struct vec3){0, 0, 0}), 1e-3);
	}
}

/* A filter that has been through everything: each number is another one, each flag set. */
static struct fusion_kalman used_filter(void)
{
	struct fusion_kalman k = {.lever_known = true, .has_moved = true, .bias_known = true};

	for (int i = 0; i < KALMAN_STATES; i++)
		for (int j = 0; j < KALMAN_STATES; j++)
			k.covariance[i][j] = i == j ? 1e-3 * (i + 1) : 1e-5 * (i + j);
	k.velocity_n_m_s[0] = 1;
	k.velocity_n_m_s[1] = 2;
	k.spread_m2_s2 = 99;
	k.mean_force_n_m_s2 = k.lever_arm_b_m = k.heading_by_offset_rad_uT = k.field_by_offset_1_uT =
		(struct vec3){3, 4, 5};
	k.mean_force_s = k.since_start_s = k.since_tilt_s = 6;
	k.net_turn_rad = k.net_turn_max_rad = 11;
	k.accel_variance = 7;
	k.sums.time_s = k.sums.force_n_m_s.x = k.sums.field_b_uT.y = 8;
	k.sums.fields = 9;
	k.hard_iron = (struct hard_iron){.prior_uT = 10, .known = true, .offset_b_uT = {1, 2, 3}, .turns = 5};
	return k;
}

static void assert_no_sums(const struct fusion_kalman *k)
{
	const struct fusion_kalman_sums none = {.time_s = 0};

	assert_memory_equal(&k->sums, &none, sizeof none);
}

/* Known with this variance, and nothing else depends on it. */
static void assert_variance(const struct fusion_kalman *k, int i, double variance)
{
	for (int j = 0; j < KALMAN_STATES; j++) {
		assert_near(k->covariance[i][j], i == j ? variance : 0, 1e-15);
		assert_near(k->covariance[j][i], i == j ? variance : 0, 1e-15);
	}
}

static void test_a_start_keeps_only_what_is_known_of_the_gyro(void **state)
{
	const struct fusion_kalman_config c = {.heading_sigma_rad = 0.1,
		.accel_sigma_m_s2 = 0.2,
		.bias_sigma_rad_s = 0.3,
		.gyro_scale_sigma = 0.01,
		.velocity_sigma_m_s = 2};
	struct fusion_kalman k = used_filter();

	(void)state;
	fusion_kalman_start(&k, &c, 9.8);
	assert_near(k.covariance[0][0], k.covariance[1][1], 0);
	assert_variance(&k, KALMAN_HEADING, 0.01);
	assert_variance(&k, KALMAN_VELOCITY, k.covariance[KALMAN_VELOCITY + 1][KALMAN_VELOCITY + 1]);
	for (int i = 0; i < 3; i++) {
		assert_near(k.covariance[KALMAN_BIAS + i][KALMAN_BIAS + i], 1e-3 * (KALMAN_BIAS + i + 1), 0);
		assert_near(k.covariance[KALMAN_SCALE + i][KALMAN_SCALE + i], 1e-3 * (KALMAN_SCALE + i + 1), 0);
		assert_variance(&k, KALMAN_ACCEL + i, 0.04);
	}
	assert_true(k.velocity_n_m_s[0] == 0 && k.velocity_n_m_s[1] == 0);
	assert_near(k.accel_variance, 0.04, 1e-15);
	assert_near(k.spread_m2_s2, 0.7 * 0.7, 1e-12); /* at least 0.35 of the configured sigma */
	assert_vec_near(k.mean_force_n_m_s2, ((struct vec3){0, 0, 9.8}), 0);
	assert_true(
		k.mean_force_s == 0 && k.since_start_s == 0 && k.since_tilt_s == 0 && !k.has_moved && !k.lever_known);
	assert_true(k.net_turn_rad == 0 && k.net_turn_max_rad == 0);
	assert_no_sums(&k);

	for (int i = KALMAN_BIAS; i < KALMAN_ACCEL; i++)
		k.covariance[i][i] = 0; /* the very first time */
	fusion_kalman_start(&k, &c, 9.8);
	for (int i = 0; i < 3; i++) {
		assert_variance(&k, KALMAN_BIAS + i, 0.09);
		assert_variance(&k, KALMAN_SCALE + i, 1e-4);
	}
	assert_false(k.bias_known);
}

/* A quarter turn about z: what was along x is along y. Of the bias only its greatest sigma is known then. */
static void test_with_other_axes_the_gyros_errors_turn_and_the_offset_is_unknown(void **state)
{
	const struct fusion_kalman_config c = {.gyro_scale_sigma = 0.01};
	struct fusion_kalman k = used_filter();
	struct gyro_errors errors = {.bias_b_rad_s = {1, 2, 3}, .scale_b = {4, 5, 6}};

	(void)state;
	k.covariance[KALMAN_BIAS + 1][KALMAN_BIAS + 1] = 0.5;
	fusion_kalman_turn_object(&k, &c, quat_from_rotation_vector((struct vec3){0, 0, PI / 2}), &errors);
	for (int i = 0; i < 3; i++) {
		assert_variance(&k, KALMAN_BIAS + i, 0.5);
		assert_variance(&k, KALMAN_SCALE + i, 1e-4);
	}
	assert_vec_near(errors.bias_b_rad_s, ((struct vec3){-2, 1, 3}), 1e-12);
	assert_vec_near(errors.scale_b, ((struct vec3){0, 0, 0}), 0);
	assert_vec_near(k.lever_arm_b_m, ((struct vec3){-4, 3, 5}), 1e-12);
	assert_vec_near(k.heading_by_offset_rad_uT, ((struct vec3){0, 0, 0}), 0);
	assert_vec_near(k.field_by_offset_1_uT, ((struct vec3){0, 0, 0}), 0);
	assert_true(k.hard_iron.prior_uT == 10 && !k.hard_iron.known && k.hard_iron.turns == 0);
	assert_no_sums(&k);
}

static void test_an_attitude_or_a_heading_that_was_set_is_all_that_is_known_of_it(void **state)
{
	const struct fusion_kalman_config c = {.bias_sigma_rad_s = 0.3};
	const double degree2 = pow(PI / 180, 2);

	(void)state;
	for (int heading = 0; heading < 2; heading++) {
		struct fusion_kalman k = used_filter();

		k.norm_uT = 50;
		k.north_from_field = k.north_on_trial = true;
		k.aided_heading_s = k.heading_rejections = 3;
		if (heading)
			fusion_kalman_set_heading(&k, 0.02);
		else
			fusion_kalman_set_attitude(&k, &c);
		assert_variance(&k, KALMAN_HEADING, heading ? 0.02 : degree2);
		for (int i = 0; i < 2 && !heading; i++)
			assert_variance(&k, i, degree2);
		assert_variance(&k, KALMAN_VELOCITY, k.covariance[KALMAN_VELOCITY + 1][KALMAN_VELOCITY + 1]);
		assert_true(k.velocity_n_m_s[0] == 0 && k.velocity_n_m_s[1] == 0);
		assert_near(k.covariance[KALMAN_BIAS][KALMAN_BIAS], 1e-3 * (KALMAN_BIAS + 1), 0);
		assert_true(k.north_unknown && !k.north_from_field && !k.north_on_trial);
		assert_near(k.norm_uT, heading ? 50 : 0, 0);
		assert_near(k.aided_heading_s, heading ? 10 : 3, 0);
		assert_int_equal(k.heading_rejections, heading ? 0 : 3);
		assert_no_sums(&k);
	}
}

/* The first one replaces the velocity, and so does one beyond 5 sigma; others are measurements of it. The filter has
 * the velocity of the accelerometer: the lever arm's is added, and turned by the error of the heading. */
static void test_a_velocity_from_outside_is_a_measurement_unless_it_is_the_first_or_contradicts(void **state)
{
	const struct fusion_kalman_config c = {.gyro_scale_sigma = 0.01};
	const struct vec3 v = {1, -2, 9}, lever = {0.3, 0.4, 1.2};

	(void)state;
	for (int i = 0; i < 3; i++) {
		const double off = i == 2 ? 100 : 0.5, variance = 0.04 + 1.69 * 0.01;
		struct fusion_kalman k = {.aided_velocity_s = i > 0 ? 1 : 0, .velocity_n_m_s = {1.3 - off, -1.6 + off}};
		struct gyro_errors errors = {.bias_b_rad_s = {0, 0, 0}};
		struct quat q = QUAT_IDENTITY;
		double gain;

		k.covariance[KALMAN_HEADING][KALMAN_HEADING] = 0.01;
		k.covariance[KALMAN_VELOCITY][KALMAN_VELOCITY] = 0.2;
		k.covariance[KALMAN_VELOCITY + 1][KALMAN_VELOCITY + 1] = 0.3;
		k.covariance[0][KALMAN_VELOCITY + 1] = k.covariance[KALMAN_VELOCITY + 1][0] = 0.01;
		k.covariance[0][0] = 0.01;
		fusion_kalman_aid_velocity(&k, &c, v, lever, 0.04, &q, &errors);
		gain = 0.3 / (0.3 + variance);
		assert_near(k.velocity_n_m_s[0], i == 1 ? 1.3 - off + 0.2 / (0.2 + variance) * off : 1.3, 1e-9);
		assert_near(k.velocity_n_m_s[1], i == 1 ? -1.6 + off - gain * off : -1.6, 1e-9);
		assert_vec_near(quat_to_rotation_vector(q),
			((struct vec3){i == 1 ? -0.01 / (0.3 + variance) * off : 0, 0, 0}), 1e-9);
		if (i == 1)
			assert_near(k.covariance[KALMAN_VELOCITY + 1][KALMAN_VELOCITY + 1], (1 - gain) * 0.3, 1e-9);
		assert_true(k.aided_velocity_n_m_s[0] == 1 && k.aided_velocity_n_m_s[1] == -2);
		assert_near(k.aided_velocity_s, 10, 0);
	}
}

/* With a heading from outside, where the field points to is estimated: with a time constant of 10 s. */
static void test_under_a_heading_from_outside_the_direction_of_the_field_is_followed_in_10_s(void **state)
{
	const struct fusion_kalman_config c = FUSION_KALMAN_DEFAULTS;
	const double bearing = 0.5; /* clockwise from y */
	const struct vec3 field = {20 * sin(bearing), 20 * cos(bearing), -45};
	const struct fusion_kalman_sample sample = {.force_b_m_s2 = {0, 0, G}, .field_b_uT = &field};
	struct fusion_kalman k = {.aided_heading_s = 10};
	struct gyro_errors errors = {.bias_b_rad_s = {0, 0, 0}};
	struct quat q = QUAT_IDENTITY;
	double between_s = 0, left = bearing;

	(void)state;
	fusion_kalman_start(&k, &c, G);
	fusion_kalman_set_north(&k, &c, q, (struct vec3){0, 20, -45});
	for (int i = 0; i < 1000; i++) {
		fusion_kalman_step(&k, &c, &sample, 0.005, &q, &errors);
		between_s += 0.005;
		if (k.sums.time_s > 0)
			continue;
		left *= 10 / (10 + between_s);
		between_s = 0;
	}
	assert_near(k.north_rad, bearing - left, 1e-6);
	assert_near(left, bearing * exp(-0.5), 0.01);
}

/* Where the field points to, once the heading was told, may be south: 3 and -3 rad are 0.28 apart. */
static void test_a_bearing_around_south_goes_the_short_way(void **state)
{
	const struct fusion_kalman_config c = FUSION_KALMAN_DEFAULTS;
	const struct vec3 field = {20 * sin(-3), 20 * cos(-3), -45};
	const struct fusion_kalman_sample sample = {.force_b_m_s2 = {0, 0, G}, .field_b_uT = &field};
	struct fusion_kalman k = {.aided_heading_s = 0};
	struct gyro_errors errors = {.bias_b_rad_s = {0, 0, 0}};
	struct quat q = QUAT_IDENTITY;

	(void)state;
	fusion_kalman_start(&k, &c, G);
	fusion_kalman_set_north(&k, &c, q, field);
	k.north_rad = 3;
	k.covariance[KALMAN_HEADING][KALMAN_HEADING] = 0.1 * 0.1;
	for (int i = 0; i < 400; i++)
		fusion_kalman_step(&k, &c, &sample, 0.005, &q, &errors);
	assert_near(quat_to_rotation_vector(q).z, 0.05, 0.04); /* a known heading follows slowly */
	for (int i = 0; i < 4000; i++)
		fusion_kalman_step(&k, &c, &sample, 0.005, &q, &errors);
	assert_near(quat_to_rotation_vector(q).z, 2 * PI - 6, 0.03);
}

/* A new sigma is that of the state from then on; what did not change stays as it was learnt. */
static void test_a_new_sigma_of_a_sensor_is_that_of_its_error(void **state)
{
	(void)state;
	for (int i = 0; i < 4; i++) {
		struct fusion f = fusion(NINE_AXES);
		struct fusion_config config = f.config;
		const struct fusion_kalman used = used_filter();

		f.kalman = used;
		f.gyro_errors.scale_b.x = 1e-3;
		config.kalman.bias_sigma_rad_s = i == 1 ? 0.07 : config.kalman.bias_sigma_rad_s;
		config.kalman.accel_sigma_m_s2 = i == 2 ? 0.6 : config.kalman.accel_sigma_m_s2;
		config.kalman.gyro_scale_sigma = i == 3 ? 0.02 : config.kalman.gyro_scale_sigma;
		assert_int_equal(fusion_configure(&f, &config), 0);
		for (int k = 0; k < 3; k++) {
			const int bias = KALMAN_BIAS + k, scale = KALMAN_SCALE + k, accel = KALMAN_ACCEL + k;

			assert_near(f.kalman.covariance[bias][bias], i == 1 ? 0.07 * 0.07 : used.covariance[bias][bias],
				1e-15);
			assert_near(f.kalman.covariance[accel][accel], i == 2 ? 0.36 : used.covariance[accel][accel],
				1e-15);
			if (i != 1) /* with the bias, the scale is unknown again */
				assert_near(f.kalman.covariance[scale][scale],
					i == 3 ? 4e-4 : used.covariance[scale][scale], 1e-15);
		}
		assert_near(f.gyro_errors.scale_b.x, i == 3 ? 0 : 1e-3, 0);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_moving_body_is_followed_within_half_a_degree),
		cmocka_unit_test(test_the_error_is_below_a_degree_at_any_sampling_rate),
		cmocka_unit_test(test_the_attitude_recovers_from_a_wrong_start),
		cmocka_unit_test(test_the_bias_is_estimated_at_rest_within_seconds),
		cmocka_unit_test(test_the_bias_is_estimated_in_motion),
		cmocka_unit_test(test_the_bias_estimate_is_limited),
		cmocka_unit_test(test_a_large_bias_of_what_lies_is_learnt_from_the_start),
		cmocka_unit_test(test_a_bias_is_learnt_from_two_steady_seconds_in_a_row),
		cmocka_unit_test(test_a_magnet_for_20_seconds_does_not_turn_the_heading),
		cmocka_unit_test(test_a_magnet_beside_a_still_object_does_not_turn_its_heading),
		cmocka_unit_test(test_another_homogeneous_field_becomes_the_reference_after_20_seconds_of_turning),
		cmocka_unit_test(test_a_reference_is_of_one_field_from_its_first_moment_on),
		cmocka_unit_test(test_a_field_disturbed_for_longer_than_the_rejection_time_counts_with_a_small_weight),
		cmocka_unit_test(test_the_heading_gets_over_a_hard_iron_offset_that_was_there_from_the_start),
		cmocka_unit_test(test_what_was_switched_on_beside_iron_finds_north_once_it_is_away_from_it),
		cmocka_unit_test(test_an_offset_is_forgotten_when_the_object_has_other_axes),
		cmocka_unit_test(test_while_the_field_turns_otherwise_than_the_gyro_says_the_heading_is_unknown),
		cmocka_unit_test(test_the_heading_holds_when_an_offset_is_found_again_or_under_a_heading_from_outside),
		cmocka_unit_test(test_a_heading_from_outside_stays_known_when_the_field_is_wrong),
		cmocka_unit_test(test_without_a_magnetometer_the_tilt_is_as_good_and_the_heading_only_drifts),
		cmocka_unit_test(test_without_further_fields_the_gyro_holds_the_heading),
		cmocka_unit_test(test_the_attitude_converges_after_a_start_in_motion),
		cmocka_unit_test(test_a_known_lever_arm_saves_a_third_of_the_tilt_error),
		cmocka_unit_test(test_the_attitude_does_not_jump_with_a_new_lever_arm),
		cmocka_unit_test(test_switching_the_algorithm_keeps_attitude_and_bias),
		cmocka_unit_test(test_after_a_gap_attitude_and_bias_converge_again),
		cmocka_unit_test(test_the_filter_recovers_from_nonsense_measurements),
		cmocka_unit_test(test_what_the_field_has_shown_is_forgotten_with_a_covariance_that_is_none),
		cmocka_unit_test(test_a_covariance_that_is_none_leaves_a_number_for_the_lasting_disturbance),
		cmocka_unit_test(test_an_attitude_upside_down_is_reinitialised_within_half_a_minute),
		cmocka_unit_test(test_a_lost_tilt_takes_bias_and_scale_with_it),
		cmocka_unit_test(test_a_lost_tilt_is_turned_back_by_60_degrees_about_the_right_axis),
		cmocka_unit_test(test_after_saturation_of_the_gyro_the_tilt_follows_the_accelerometer),
		cmocka_unit_test(test_a_field_from_the_opposite_direction_is_a_heading_outlier),
		cmocka_unit_test(test_the_heading_converges_within_half_a_minute_of_a_start_in_violent_motion),
		cmocka_unit_test(test_a_wrong_heading_is_corrected_after_the_rejection_time),
		cmocka_unit_test(test_the_tilt_of_a_simulated_chip_is_within_half_a_degree_in_every_motion),
		cmocka_unit_test(test_the_attitude_is_extrapolated_over_the_delay_by_the_rate),
		cmocka_unit_test(test_the_noise_of_the_magnetometer_counts_in_the_sigma_of_the_heading),
		cmocka_unit_test(test_an_accelerometer_is_as_uncertain_as_the_length_of_its_force_shows),
		cmocka_unit_test(test_at_the_start_the_tilt_is_known_as_well_as_the_length_of_the_force_fits_gravity),
		cmocka_unit_test(test_a_turn_makes_the_attitude_less_certain_by_the_gyros_errors),
		cmocka_unit_test(test_the_velocity_is_measured_as_zero_with_its_spread_or_as_that_of_rest),
		cmocka_unit_test(test_a_yaw_and_a_velocity_from_outside_hold_for_10_s),
		cmocka_unit_test(test_the_velocity_of_the_lever_arm_is_that_of_a_new_arm_from_the_last_correction_on),
		cmocka_unit_test(test_after_half_a_second_without_samples_the_velocity_before_does_not_count),
		cmocka_unit_test(test_a_yaw_from_outside_counts_up_to_5_sigma),
		cmocka_unit_test(test_a_steady_rate_beyond_four_sigma_of_a_known_bias_is_no_rest),
		cmocka_unit_test(test_of_two_steady_rates_the_second_is_bias_as_far_as_the_calibration_tells),
		cmocka_unit_test(test_a_steady_rate_about_the_vertical_may_be_that_of_a_circle),
		cmocka_unit_test(test_a_mean_force_far_from_the_vertical_is_gravity_after_3_s_if_it_is_about_as_long),
		cmocka_unit_test(test_a_steady_rate_is_bias_unless_the_field_turns_with_it),
		cmocka_unit_test(test_turns_in_one_direction_leave_an_error_of_the_heading_that_grows_with_them),
		cmocka_unit_test(test_no_number_of_turns_makes_the_heading_less_certain_than_unknown),
		cmocka_unit_test(test_a_set_attitude_is_known_to_a_degree),
		cmocka_unit_test(test_the_first_north_is_as_uncertain_as_the_tilt_makes_it),
		cmocka_unit_test(test_over_missing_samples_the_attitude_is_uncertain_by_the_unseen_turn),
		cmocka_unit_test(test_over_missing_samples_the_velocity_stays_and_is_less_certain),
		cmocka_unit_test(test_over_missing_samples_the_velocity_is_what_it_was_usually),
		cmocka_unit_test(test_the_ranges_of_the_configuration_include_their_limits),
		cmocka_unit_test(test_a_configuration_out_of_range_is_refused),
		cmocka_unit_test(test_the_spread_of_the_velocity_is_its_mean_square_of_an_axis),
		cmocka_unit_test(test_a_field_beyond_the_limits_of_length_or_dip_is_not_used),
		cmocka_unit_test(test_the_fifth_yaw_in_a_row_that_contradicts_the_heading_sets_it),
		cmocka_unit_test(test_under_a_heading_that_was_set_the_field_is_the_reference_again),
		cmocka_unit_test(test_a_yaw_from_outside_counts_at_any_heading_but_not_straight_up),
		cmocka_unit_test(test_when_the_offset_changes_the_heading_is_less_certain_by_what_it_owes_to_it),
		cmocka_unit_test(test_a_start_keeps_only_what_is_known_of_the_gyro),
		cmocka_unit_test(test_with_other_axes_the_gyros_errors_turn_and_the_offset_is_unknown),
		cmocka_unit_test(test_an_attitude_or_a_heading_that_was_set_is_all_that_is_known_of_it),
		cmocka_unit_test(test_a_velocity_from_outside_is_a_measurement_unless_it_is_the_first_or_contradicts),
		cmocka_unit_test(test_under_a_heading_from_outside_the_direction_of_the_field_is_followed_in_10_s),
		cmocka_unit_test(test_a_bearing_around_south_goes_the_short_way),
		cmocka_unit_test(test_a_new_sigma_of_a_sensor_is_that_of_its_error),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
