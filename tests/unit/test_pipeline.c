/* The whole pipeline from sample to position. */
#include "model_test.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model/pipeline.h"
#include "model/seed.h"

enum { RATE_HZ = 200, INTERVAL_US = 1000000 / RATE_HZ };

static const double G = 9.81;
static const struct vec3 ZERO = {0, 0, 0}, FIELD_N = {0, 20, -45}, LEVER_B = {0.05, -0.03, 0.08};

static struct pipeline pipeline(const struct pipeline_config *config)
{
	struct pipeline p;

	assert_int_equal(pipeline_init(&p, config, RATE_HZ), 0);
	return p;
}

static struct pipeline_config with_lever(void)
{
	struct pipeline_config config = PIPELINE_DEFAULTS;

	config.estimator.lever_arm_b_m = LEVER_B;
	config.latency = (struct latency_config){0, 0}; /* ideal sensors */
	return config;
}

/* What ideal sensors at LEVER_B measure, and the reference point's true acceleration. */
struct truth {
	struct imu_sample sample;
	struct quat q_nb;
	struct vec3 accel_n;
};

static struct truth sensed(double t, const struct seed_motion *motion, struct vec3 accel_n)
{
	struct rigid_motion body = rigid_motion_from_seed(motion);
	struct truth truth = {.q_nb = body.q_nb, .accel_n = accel_n};

	truth.sample = (struct imu_sample){
		.t_us = (uint64_t)llround(t * 1e6),
		.gyro_rad_s = body.omega_b_rad_s,
		.accel_m_s2 = rigid_dynamic(quat_rotate_inverse(body.q_nb, accel_n), &body, LEVER_B, G),
		.mag_uT = quat_rotate_inverse(body.q_nb, FIELD_N),
		.flags = SAMPLE_MAG,
	};
	return truth;
}

/* A robot that rolls, pitches and turns while its reference point swings to and fro. */
static struct truth moving_at(double t)
{
	const struct seed_motion motion = {
		.angles_rad = {0.5 * sin(4 * t), 0.4 * sin(3 * t), 0.6 * t},
		.rates_rad_s = {2 * cos(4 * t), 1.2 * cos(3 * t), 0.6},
		.accels_rad_s2 = {-8 * sin(4 * t), -3.6 * sin(3 * t), 0},
	};

	return sensed(t, &motion, (struct vec3){0.8 * sin(5 * t), 0.5 * cos(4 * t), -0.4 * sin(6 * t)});
}

static struct truth moving(int k)
{
	return moving_at((double)k / RATE_HZ);
}

/* A robot at rest in an oblique attitude. */
static struct truth standing(int k)
{
	const struct seed_motion motion = {.angles_rad = {0.2, -0.1, 1}};

	return sensed((double)k / RATE_HZ, &motion, ZERO);
}

static struct pipeline_output step(struct pipeline *p, const struct imu_sample *sample)
{
	struct pipeline_output out;

	assert_int_equal(pipeline_step(p, sample, &out), 0);
	return out;
}

/* Samples from..to-1; returns the last output. */
static struct pipeline_output run(struct pipeline *p, struct truth (*at)(int), int from, int to)
{
	struct pipeline_output out = {.t_us = 0};

	for (int k = from; k < to; k++) {
		struct truth truth = at(k);

		out = step(p, &truth.sample);
	}
	return out;
}

static struct vec3 lever_term(const struct pipeline_output *out, struct vec3 r)
{
	return rigid_lever_arm(out->rate_b_rad_s, out->alpha_b_rad_s2, r);
}

static void test_the_defaults_are_valid_at_any_rate(void **state)
{
	struct pipeline p;

	(void)state;
	for (double rate_hz = 1; rate_hz < 1e5; rate_hz *= 3)
		assert_int_equal(pipeline_init(&p, &PIPELINE_DEFAULTS, rate_hz), 0);
}

/* RMS error of the acceleration. The attitude is the true one, so that only the lever arm matters. */
static double accel_error_with(enum lever_arm_model model, enum rate_source source, double gyro_density_rad_s_sqrt_hz)
{
	struct pipeline_config config = with_lever();
	struct pipeline p;
	double sum = 0;

	config.estimator.model = model;
	config.estimator.rates_from = source;
	config.noise.gyro_density_rad_s_sqrt_hz = gyro_density_rad_s_sqrt_hz;
	config.fusion.algorithm = FUSION_MADGWICK;
	config.fusion.madgwick_beta = 0;
	p = pipeline(&config);
	for (int k = 0; k < 2000; k++) {
		struct truth truth = moving(k);
		struct pipeline_output out;
		struct vec3 error;

		if (k == 1)
			p.fusion.q_nb = moving(0).q_nb;
		out = step(&p, &truth.sample);
		error = vec3_sub(quat_rotate(truth.q_nb, out.accel_b_m_s2), truth.accel_n);
		if (k > 400)
			sum += vec3_dot(error, error) / 1600;
	}
	return sqrt(sum);
}

static double accel_error(enum lever_arm_model model, enum rate_source source)
{
	return accel_error_with(model, source, PIPELINE_DEFAULTS.noise.gyro_density_rad_s_sqrt_hz);
}

static void test_the_auto_mode_corrects_with_a_good_gyro_and_not_with_a_very_noisy_one(void **state)
{
	const double off = accel_error(LEVER_ARM_OFF, RATES_FROM_GYRO);
	const double rigid = accel_error(LEVER_ARM_RIGID_BODY, RATES_FROM_GYRO);

	(void)state;
	assert_true(accel_error(LEVER_ARM_AUTO, RATES_FROM_GYRO) < rigid + 0.15 * off);
	assert_true(fabs(accel_error_with(LEVER_ARM_AUTO, RATES_FROM_GYRO, 10) - off) < 0.01 * off);
}

static void test_the_rigid_body_model_gives_the_reference_points_acceleration(void **state)
{
	double off = accel_error(LEVER_ARM_OFF, RATES_FROM_GYRO);

	(void)state;
	assert_true(off > 0.5);
	assert_true(accel_error(LEVER_ARM_RIGID_BODY, RATES_FROM_GYRO) < 0.01 * off);
	assert_true(accel_error(LEVER_ARM_RIGID_BODY, RATES_FROM_ANGLES) < 0.05 * off);
}

/* RMS errors of acceleration and attitude at the time stamp, with sensors of this latency and a configured one. */
static void late(
	double gyro_s, double accel_s, struct latency_config configured, double *accel_error, double *angle_error)
{
	struct pipeline_config config = with_lever();
	double interval_s = 1.0 / RATE_HZ, accel2 = 0, angle2 = 0;
	struct pipeline p;

	config.latency = configured;
	config.noise.gyro_density_rad_s_sqrt_hz = config.noise.accel_density_m_s2_sqrt_hz = 1e-6;
	config.fusion.algorithm = FUSION_MADGWICK;
	config.fusion.madgwick_beta = 0;
	p = pipeline(&config);
	for (int k = 0; k < 2000; k++) {
		struct truth truth = moving(k);
		struct pipeline_output out;

		truth.sample.gyro_rad_s = moving_at(k * interval_s - gyro_s).sample.gyro_rad_s;
		truth.sample.accel_m_s2 = moving_at(k * interval_s - accel_s).sample.accel_m_s2;
		if (k == 1)
			p.fusion.q_nb = moving_at(-gyro_s).q_nb;
		out = step(&p, &truth.sample);
		if (k <= 400)
			continue;
		accel2 += pow(vec3_norm(vec3_sub(out.accel_n_m_s2, truth.accel_n)), 2) / 1599;
		angle2 += pow(quat_apart_rad(out.q_nb, truth.q_nb), 2) / 1599;
	}
	*accel_error = sqrt(accel2);
	*angle_error = sqrt(angle2);
}

static void test_attitude_and_acceleration_are_extrapolated_over_the_latency_to_the_time_stamp(void **state)
{
	const struct latency_config none = {0, 0}, one = {0.008, 0}, both = {0.008, -0.004};
	double accel[3], angle[3];

	(void)state;
	late(0.008, 0.004, none, &accel[0], &angle[0]);
	late(0.008, 0.004, one, &accel[1], &angle[1]);
	late(0.008, 0.004, both, &accel[2], &angle[2]);
	assert_true(angle[0] > 0.5 * RAD_PER_DEG);
	assert_true(angle[2] < 0.1 * RAD_PER_DEG);
	assert_true(accel[2] < 0.5 * accel[1]);
	assert_true(accel[2] < 0.5 * accel[0]);
}

static void test_no_accelerometer_is_faster_than_its_time_stamp(void **state)
{
	const struct latency_config too_fast = {0.001, -0.002}, immediate = {0.001, -0.001};
	double accel[2], angle[2];

	(void)state;
	late(0.001, 0, too_fast, &accel[0], &angle[0]);
	late(0.001, 0, immediate, &accel[1], &angle[1]);
	assert_near(accel[0], accel[1], 0);
	assert_near(angle[0], angle[1], 0);
}

static void test_the_delay_of_the_acceleration_filter_is_reported(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);

	(void)state;
	assert_near(run(&p, moving, 0, 300).accel_delay_s, 0, 0);
	config.accel_filter = (struct filter_config){FILTER_SEED_FIR, 2, 40};
	assert_int_equal(pipeline_configure(&p, &config), 0);
	assert_near(run(&p, moving, 300, 310).accel_delay_s, 5.0 / RATE_HZ, 1e-12);
	p = pipeline(&config);
	assert_near(run(&p, moving, 0, 10).accel_delay_s, 5.0 / RATE_HZ, 1e-12);
}

static void test_a_new_lever_arm_is_in_full_effect_with_the_next_sample(void **state)
{
	struct filter_config filters[] = {{FILTER_OFF, 2, 40}, {FILTER_BUTTERWORTH, 4, 2}, {FILTER_SEED_FIR, 2, 40}};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct pipeline_config config = with_lever();
		struct pipeline old, new;
		struct pipeline_output before, after;
		struct truth truth = moving(300);
		struct vec3 r = {0.2, 0.1, -0.3};

		config.accel_filter = filters[i];
		old = pipeline(&config);
		run(&old, moving, 0, 300);
		new = old;
		config.estimator.lever_arm_b_m = r;
		assert_int_equal(pipeline_configure(&new, &config), 0);
		before = step(&old, &truth.sample);
		after = step(&new, &truth.sample);
		/* the gyro's noise times the lever arm weighs the fusion's next correction, by 1e-8 */
		assert_vec_near(vec3_sub(before.accel_b_m_s2, after.accel_b_m_s2),
			lever_term(&before, vec3_sub(r, LEVER_B)), 1e-6);
	}
}

static void test_a_new_model_or_source_of_rates_has_no_transient(void **state)
{
	(void)state;
	for (int model = LEVER_ARM_OFF; model <= LEVER_ARM_RIGID_BODY; model++)
		for (int source = 0; source < RATE_SOURCES; source++) {
			struct pipeline_config config = with_lever(), switched = config;
			struct pipeline always, late = pipeline(&config);

			switched.estimator.model = (enum lever_arm_model)model;
			switched.estimator.rates_from = (enum rate_source)source;
			always = pipeline(&switched);
			run(&always, moving, 0, 300);
			run(&late, moving, 0, 300);
			assert_int_equal(pipeline_configure(&late, &switched), 0);
			for (int k = 300; k < 310; k++) {
				struct pipeline_output a = run(&always, moving, k, k + 1);
				struct pipeline_output b = run(&late, moving, k, k + 1);

				assert_vec_near(b.accel_b_m_s2, a.accel_b_m_s2, 0);
				assert_vec_near(b.alpha_b_rad_s2, a.alpha_b_rad_s2, 0);
			}
		}
}

static void test_the_seeds_model_stays_bounded_through_gimbal_lock(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p;
	double most = 0;

	(void)state;
	config.estimator.model = LEVER_ARM_SEED_EQ12;
	p = pipeline(&config);
	for (int k = 0; k < 4 * RATE_HZ; k++) {
		double t = (double)k / RATE_HZ;
		const struct seed_motion motion = {.angles_rad = {0.1, t, 0.3}, .rates_rad_s = {0, 1, 0}};
		struct truth truth = sensed(t, &motion, ZERO);

		most = fmax(most, vec3_norm(step(&p, &truth.sample).accel_b_m_s2));
	}
	assert_true(most < 20);
}

static void test_at_rest_the_velocity_is_zero_and_the_position_stays(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	struct pipeline_output out, later;

	(void)state;
	out = run(&p, standing, 0, RATE_HZ);
	assert_int_equal(out.status & PIPELINE_REST, 0);
	out = run(&p, standing, RATE_HZ, 2 * RATE_HZ);
	assert_int_equal(out.status, PIPELINE_VALID | PIPELINE_REST | PIPELINE_MAG_USED);
	assert_vec_near(out.velocity_n_m_s, ZERO, 0);
	later = run(&p, standing, 2 * RATE_HZ, 4 * RATE_HZ);
	assert_vec_near(later.position_n_m, out.position_n_m, 1e-6);
}

static void stand_with_bias(struct pipeline *p, struct vec3 bias, int from, int to)
{
	for (int k = from; k < to; k++) {
		struct truth truth = standing(k);

		truth.sample.gyro_rad_s = vec3_add(bias, vec3_scale(0.001 * (k % 2 ? 1 : -1), bias));
		step(p, &truth.sample);
	}
}

static void test_the_gyro_bias_is_estimated_at_rest(void **state)
{
	const struct vec3 bias = {0.01, -0.02, 0.015};
	struct pipeline p = pipeline(&PIPELINE_DEFAULTS);

	(void)state;
	stand_with_bias(&p, bias, 0, 5 * RATE_HZ);
	assert_vec_near(p.fusion.gyro_errors.bias_b_rad_s, bias, 1e-4);
	assert_vec_near(p.rates.out[RATES_FROM_GYRO].omega_b_rad_s, ZERO, 1e-3);
}

static void test_a_turn_faster_than_the_rest_threshold_is_not_estimated_as_bias(void **state)
{
	struct pipeline_config config = PIPELINE_DEFAULTS;
	struct pipeline p;

	(void)state;
	config.fusion.algorithm = FUSION_MADGWICK; /* the Kalman filter estimates the bias in motion, too */
	p = pipeline(&config);
	stand_with_bias(&p, (struct vec3){0, 0, 3 * RAD_PER_DEG}, 0, 5 * RATE_HZ);
	assert_vec_near(p.fusion.gyro_errors.bias_b_rad_s, ZERO, 0);
}

static void test_a_new_gyro_calibration_resets_the_bias_estimate(void **state)
{
	const struct vec3 bias = {0.01, -0.02, 0.015};
	struct pipeline_config config = PIPELINE_DEFAULTS;
	struct pipeline p = pipeline(&config);

	(void)state;
	stand_with_bias(&p, bias, 0, 5 * RATE_HZ);
	config.calibration.gyro.bias = bias;
	assert_int_equal(pipeline_configure(&p, &config), 0);
	assert_vec_near(p.fusion.gyro_errors.bias_b_rad_s, ZERO, 0);
}

static void test_a_push_from_rest_is_integrated_and_the_position_can_be_reset(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p;
	struct pipeline_output out;

	(void)state;
	config.fusion.algorithm = FUSION_MADGWICK;
	config.fusion.madgwick_beta = 0; /* or the attitude would follow the acceleration */
	config.position.mode = POSITION_ZERO_VELOCITY_AT_REST;
	p = pipeline(&config);
	run(&p, standing, 0, 400);
	for (int k = 400; k < 400 + RATE_HZ; k++) { /* 1 m/s^2 east for 1 s */
		struct truth truth = standing(k);
		struct vec3 push = quat_rotate_inverse(truth.q_nb, (struct vec3){1, 0, 0});

		truth.sample.accel_m_s2 = vec3_add(truth.sample.accel_m_s2, push);
		out = step(&p, &truth.sample);
	}
	assert_vec_near(out.velocity_n_m_s, ((struct vec3){1, 0, 0}), 0.005);
	assert_vec_near(out.position_n_m, ((struct vec3){0.5, 0, 0}), 0.005);
	assert_int_equal(out.status & PIPELINE_REST, 0);
	pipeline_reset_position(&p);
	assert_vec_near(p.position.position_n_m, ZERO, 0);
	assert_vec_near(p.position.velocity_n_m_s, ZERO, 0);
}

static void test_the_longest_integration_time_shows_in_the_status(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p;

	(void)state;
	config.position.longest_integration_s = 2;
	p = pipeline(&config);
	assert_int_equal(run(&p, moving, 0, 2 * RATE_HZ).status & PIPELINE_TIME_LIMIT, 0);
	assert_true(run(&p, moving, 2 * RATE_HZ, 2 * RATE_HZ + 3).status & PIPELINE_TIME_LIMIT);
}

static void test_values_that_no_sensor_measures_are_refused_and_counted(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	struct pipeline_output out = run(&p, moving, 0, 10), untouched = out;
	struct imu_sample bad[6];

	(void)state;
	for (int i = 0; i < 6; i++)
		bad[i] = moving(10).sample;
	bad[0].gyro_rad_s.y = NAN;
	bad[1].accel_m_s2.z = INFINITY;
	bad[2].mag_uT.x = -INFINITY;
	bad[3].gyro_rad_s.x = 1001;
	bad[4].accel_m_s2.x = -1.1e5;
	bad[5].mag_uT.z = 1.1e6;
	for (int i = 0; i < 6; i++)
		assert_int_equal(pipeline_step(&p, &bad[i], &out), -EINVAL);
	assert_int_equal(p.refused, 6);
	assert_memory_equal(&out, &untouched, sizeof(out));
	assert_int_equal(run(&p, moving, 10, 11).status & PIPELINE_GAP, 0);
}

static void test_time_that_does_not_increase_is_refused_and_counted(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	struct pipeline_output out = run(&p, moving, 0, 10);
	struct imu_sample same = moving(9).sample, earlier = moving(5).sample;

	(void)state;
	assert_int_equal(pipeline_step(&p, &same, &out), -EINVAL);
	assert_int_equal(pipeline_step(&p, &earlier, &out), -EINVAL);
	assert_int_equal(p.refused, 2);
	assert_true(out.t_us == same.t_us);
}

static void test_a_short_gap_is_reported_once_and_not_integrated(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	struct pipeline_output before = run(&p, moving, 0, 300), after;

	(void)state;
	assert_int_equal(before.status & PIPELINE_GAP, 0);
	after = run(&p, moving, 320, 321);
	assert_true(after.status & PIPELINE_GAP);
	assert_int_equal(p.gaps, 1);
	assert_vec_near(after.velocity_n_m_s, before.velocity_n_m_s, 0);
	assert_vec_near(after.position_n_m, before.position_n_m, 0);
	assert_vec_near(after.alpha_b_rad_s2, ZERO, 0);
	assert_vec_near(after.rate_b_rad_s, fusion_rate_b(&p.fusion, moving(320).sample.gyro_rad_s), 1e-12);
	assert_true(quat_apart_rad(after.q_nb, moving(320).q_nb) < 0.2);
	assert_int_equal(run(&p, moving, 321, 322).status & PIPELINE_GAP, 0);
}

static void test_ten_intervals_are_not_a_gap(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);

	(void)state;
	run(&p, moving, 0, 300);
	assert_int_equal(run(&p, moving, 309, 310).status & PIPELINE_GAP, 0);
	assert_true(run(&p, moving, 320, 321).status & PIPELINE_GAP);
}

/* At 1000 samples a second 60 of them are missing: that is seen and counted, but what is at rest stays so. */
static void test_a_gap_of_less_than_a_tenth_of_a_second_interrupts_nothing(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p;
	struct pipeline_output out = {.t_us = 0};

	(void)state;
	assert_int_equal(pipeline_init(&p, &config, 1000), 0);
	for (int k = 0; k < 5000; k++) {
		struct imu_sample sample = standing(0).sample;

		if (k >= 4000 && k < 4060)
			continue;
		sample.t_us = 1000 * (uint64_t)k;
		out = step(&p, &sample);
		assert_int_equal(!!(out.status & PIPELINE_GAP), k == 4060);
		if (k > 3000)
			assert_true(out.status & PIPELINE_REST);
	}
	assert_int_equal(p.gaps, 1);
	assert_true(vec3_norm(out.sigma.position_m) < 0.02);
}

/* Shaken up and down at 0.6 g once a second, and 0.3 s are missing: for a while the force is shorter than gravity, but
 * no accelerometer lacks as much. What it lacks is told by the mean of ten seconds. */
static void test_a_gap_while_it_is_shaken_says_nothing_of_the_accelerometer(void **state)
{
	const int begin = 17 * RATE_HZ;

	(void)state;
	for (int i = 0; i < 10; i++) {
		struct pipeline_config config = with_lever();
		struct pipeline p = pipeline(&config);

		for (int k = 0; k < 20 * RATE_HZ; k++) {
			struct imu_sample sample = standing(k).sample;

			if (k > 5 * RATE_HZ)
				sample.accel_m_s2 = vec3_scale(
					1 + 0.6 * sin(2 * PI * ((double)k / RATE_HZ + 0.1 * i)), sample.accel_m_s2);
			if (k > begin && k < begin + 0.3 * RATE_HZ)
				continue;
			step(&p, &sample);
		}
		assert_int_equal(p.gaps, 1);
		assert_true(sqrt(p.fusion.kalman.accel_variance) < 0.8); /* 5 by the mean of half a second */
	}
}

/* On an arm of a metre that swings by 60 degrees to both sides, once in two seconds, after 10 s of rest. */
static struct truth on_an_arm(int k, struct vec3 *velocity_n)
{
	const double w = PI, swing_rad = PI / 3, t = (double)k / RATE_HZ - 10, rise = fmin(1, fmax(0, t) / 4);
	const double angle = rise * swing_rad * sin(w * t), slope = t > 0 && t < 4 ? 0.25 : 0;
	const double rate = slope * swing_rad * sin(w * t) + rise * w * swing_rad * cos(w * t) * (t > 0);
	const double accel = 2 * slope * w * swing_rad * cos(w * t) - w * w * angle;
	struct quat q_nb = quat_from_rotation_vector((struct vec3){angle, 0, 0});
	const struct vec3 along = quat_rotate(q_nb, (struct vec3){0, 1, 0}); /* its point is 1 m below the axis */

	*velocity_n = vec3_scale(rate, along);
	return (struct truth){.q_nb = q_nb,
		.sample = {.t_us = (uint64_t)llround((double)k / RATE_HZ * 1e6),
			.gyro_rad_s = {rate, 0, 0},
			.accel_m_s2 = vec3_add((struct vec3){0, accel, rate * rate},
				quat_rotate_inverse(q_nb, (struct vec3){0, 0, G}))}};
}

/* The arm is three times as fast as the fusion expects by default, and 0.25 s of it are missing again and again: that
 * the tilt is found again by the force, and the velocity by none, is in both sigmas. */
static void test_an_arm_that_loses_samples_is_within_its_sigmas(void **state)
{
	double tilt_beyond = 0, velocity_beyond = 0, n = 0;

	(void)state;
	for (int every = 250; every < 450; every += 40) {
		struct pipeline_config config = with_lever();
		struct pipeline p;

		config.estimator.lever_arm_b_m = ZERO;
		p = pipeline(&config);
		for (int k = 0; k < 60 * RATE_HZ; k++) {
			struct vec3 velocity_n, off, apart;
			struct truth truth = on_an_arm(k, &velocity_n);
			struct pipeline_output out;

			if (k > 16 * RATE_HZ && k % every < 0.25 * RATE_HZ)
				continue;
			out = step(&p, &truth.sample);
			off = quat_to_rotation_vector(quat_multiply(truth.q_nb, quat_conjugate(out.q_nb)));
			apart = vec3_sub(out.velocity_n_m_s, velocity_n);
			n++;
			tilt_beyond += fabs(off.x) > 3 * out.sigma.attitude_rad.x;
			velocity_beyond += fabs(apart.y) > 3 * out.sigma.velocity_m_s.y;
		}
	}
	print_message("beyond 3 sigma: tilt %.4f, velocity %.4f\n", tilt_beyond / n, velocity_beyond / n);
	assert_true(tilt_beyond < 0.02 * n && velocity_beyond < 0.02 * n);
}

/* After 20 s its gripper takes a piece of iron, which turns with it: what the field shows of that is in the heading's
 * sigma, and the swing does not show the iron's part along its axis. */
static void test_an_arm_that_picks_up_iron_is_within_the_sigma_of_its_heading(void **state)
{
	double beyond = 0, n = 0;

	(void)state;
	for (int i = 0; i < 16; i++) {
		const double size = i < 8 ? 5 : 20;
		const struct vec3 iron_b_uT = {i & 1 ? size : -size, i & 2 ? size : -size, i & 4 ? size : -size};
		const struct quat heading = quat_from_rotation_vector((struct vec3){0, 0, 0.4 * i});
		struct pipeline_config config = with_lever();
		struct pipeline p;

		config.estimator.lever_arm_b_m = ZERO;
		p = pipeline(&config);
		for (int k = 0; k < 60 * RATE_HZ; k++) {
			struct vec3 velocity_n, off;
			struct truth truth = on_an_arm(k, &velocity_n);
			struct pipeline_output out;

			truth.q_nb = quat_multiply(heading, truth.q_nb);
			truth.sample.flags = SAMPLE_MAG;
			truth.sample.mag_uT = quat_rotate_inverse(truth.q_nb, FIELD_N);
			if (k > 20 * RATE_HZ)
				truth.sample.mag_uT = vec3_add(truth.sample.mag_uT, iron_b_uT);
			out = step(&p, &truth.sample);
			off = quat_to_rotation_vector(quat_multiply(truth.q_nb, quat_conjugate(out.q_nb)));
			n++;
			beyond += fabs(off.z) > 3 * out.sigma.attitude_rad.z;
		}
	}
	print_message("heading beyond 3 sigma: %.4f\n", beyond / n);
	assert_true(beyond < 0.02 * n);
}

static void test_after_a_gap_rest_is_observed_for_its_time_again(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	const int time = (int)(config.rest.time_s * p.rate_hz); /* samples */

	(void)state;
	assert_true(run(&p, standing, 0, 1000).status & PIPELINE_REST);
	for (int k = 1050; k < 1050 + time - 5; k++)
		assert_int_equal(run(&p, standing, k, k + 1).status & PIPELINE_REST, 0);
	assert_true(run(&p, standing, 1050 + time - 5, 2050 + time).status & PIPELINE_REST);
}

static void test_after_a_long_gap_the_attitude_is_initialised_again(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	struct pipeline_output out;

	(void)state;
	run(&p, moving, 0, 300);
	out = run(&p, standing, 1000, 1001);
	assert_quat_near(out.q_nb, standing(1000).q_nb, 1e-5);
	assert_vec_near(out.accel_n_m_s2, ZERO, 1e-6);
}

/* A sensor that was not there for a moment, and may have been turned meanwhile: about the vertical, where without a
 * magnetometer nothing shows it, or to the side; up to 90 degrees and as fast as 11 rad/s^2 allow. */
static void test_after_a_gap_sigma_covers_a_turn_that_nobody_saw(void **state)
{
	const double gaps_s[] = {0.15, 0.3, 0.5, 0.9, 1.1, 3, 60};

	(void)state;
	for (int i = 0; i < 4 * 7; i++) {
		const double gap_s = gaps_s[i / 4], turn_rad = fmin(1.5, 2.75 * gap_s * gap_s) * (i & 1 ? 1 : 0.5);
		const struct vec3 axis = {0, i & 2 ? 1 : 0, i & 2 ? 0 : 1};
		struct pipeline_config config = with_lever();
		struct pipeline p;

		config.fusion.use_magnetometer = 0;
		p = pipeline(&config);
		for (double t_s = 0; t_s < 20 + gap_s; t_s += t_s < 10 && t_s + 0.015 > 10 ? gap_s : 0.01) {
			struct quat truth = quat_from_rotation_vector(vec3_scale(t_s > 10 ? turn_rad : 0, axis));
			struct imu_sample s = {.t_us = (uint64_t)(t_s * 1e6 + 1e6),
				.accel_m_s2 = quat_rotate_inverse(truth, (struct vec3){0, 0, 9.81})};
			struct pipeline_output out;
			struct vec3 off, sigma;

			assert_int_equal(pipeline_step(&p, &s, &out), 0);
			off = quat_to_rotation_vector(quat_multiply(truth, quat_conjugate(out.q_nb)));
			sigma = out.sigma.attitude_rad;
			if ((out.status & PIPELINE_VALID) &&
				(fabs(off.x) > 3 * sigma.x || fabs(off.y) > 3 * sigma.y || fabs(off.z) > 3 * sigma.z))
				fail_msg("gap of %g s, turn of %.2f rad, %.2f s later: %.3f %.3f %.3f rad off, sigma "
					 "%.3f "
					 "%.3f %.3f",
					gap_s, turn_rad, t_s - 10 - gap_s, off.x, off.y, off.z, sigma.x, sigma.y,
					sigma.z);
		}
		assert_int_equal(p.gaps, 1);
	}
}

/* Without a magnetometer, and without a standstill of some seconds before: 5 deg/s, reached within a second. */
static void test_a_turn_that_begins_soon_after_the_start_is_no_bias(void **state)
{
	struct pipeline_config config = with_lever();

	(void)state;
	config.fusion.use_magnetometer = 0;
	for (double begin_s = 0.4; begin_s < 3; begin_s += 0.2) {
		struct pipeline p = pipeline(&config);
		struct pipeline_output out = {.t_us = 0};
		double yaw = 0;

		for (int k = 0; k < 40 * RATE_HZ; k++) {
			const double t = (double)k / RATE_HZ;
			double rate = 5 * RAD_PER_DEG * pow(sin(PI / 2 * fmin(1, fmax(0, t - begin_s))), 2);
			struct imu_sample s = {.t_us = (uint64_t)k * 1000000 / RATE_HZ,
				.gyro_rad_s = vec3_add((struct vec3){0, 0, rate}, any_vec(0.002)),
				.accel_m_s2 = vec3_add((struct vec3){0, 0, G}, any_vec(0.05))};

			yaw += rate / RATE_HZ;
			out = step(&p, &s);
		}
		assert_near(remainder(out.angles_rad.z - yaw, 2 * PI), 0, fmin(3 * out.sigma.attitude_rad.z, 0.2));
	}
}

static void test_the_first_sample_has_its_sigma(void **state)
{
	const struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	struct pipeline_output out = run(&p, standing, 0, 1);

	(void)state;
	assert_true(out.status & PIPELINE_VALID);
	assert_near(
		out.sigma.attitude_rad.x, 0.1, 0.02); /* an acceleration of 1 m/s^2 at that moment, see the fusion */
	assert_near(out.sigma.attitude_rad.z, hypot(3 * 0.1, 2 * RAD_PER_DEG), 0.05);
	assert_near(out.sigma.velocity_m_s.x, 0.1, 0.01);
	assert_true(out.sigma.accel_m_s2.x > 0.8);
}

static void test_a_discontinuity_starts_everything_over(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	struct imu_sample again = standing(0).sample;
	struct pipeline_output out;

	(void)state;
	run(&p, moving, 0, 300);
	again.flags |= SAMPLE_DISCONTINUITY;
	out = step(&p, &again); /* its time is earlier */
	assert_int_equal(out.status, PIPELINE_VALID | PIPELINE_MAG_USED);
	assert_quat_near(out.q_nb, standing(0).q_nb, 1e-6);
	assert_vec_near(out.velocity_n_m_s, ZERO, 1e-6);
	assert_vec_near(out.position_n_m, ZERO, 1e-6);
	assert_int_equal(p.gaps + p.refused, 0);
}

static void test_a_magnetometer_lost_shows_in_the_status_after_a_second(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);

	(void)state;
	run(&p, standing, 0, 10);
	for (int k = 10; k < 10 + 2 * RATE_HZ; k++) {
		struct truth truth = standing(k);
		struct pipeline_output out;

		truth.sample.flags = 0;
		out = step(&p, &truth.sample);
		if (k < 5 + RATE_HZ)
			assert_true(out.status & PIPELINE_MAG_USED);
		if (k > 15 + RATE_HZ)
			assert_int_equal(out.status & PIPELINE_MAG_USED, 0);
		assert_vec_near(out.mag_b_uT, standing(9).sample.mag_uT, 1e-12);
		assert_quat_near(out.q_nb, truth.q_nb, 1e-6);
	}
}

static void test_the_jump_of_the_heading_to_the_first_north_is_not_an_angular_rate(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p;
	struct truth truth;

	(void)state;
	config.estimator.rates_from = RATES_FROM_ANGLES;
	p = pipeline(&config);
	for (int k = 0; k < 10; k++) {
		truth = standing(k);
		truth.sample.flags = 0;
		step(&p, &truth.sample);
	}
	for (int k = 10; k < 20; k++) {
		struct pipeline_output out = run(&p, standing, k, k + 1);

		assert_quat_near(out.q_nb, standing(k).q_nb, 1e-6);
		assert_vec_near(out.rate_b_rad_s, ZERO, 1e-6);
		assert_vec_near(out.alpha_b_rad_s2, ZERO, 1e-4);
	}
}

static void test_a_mounting_set_before_the_first_sample_leaves_the_heading_at_zero(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);

	(void)state;
	config.calibration.mounting_rad.z = 1;
	config.fusion.use_magnetometer = 0;
	assert_int_equal(pipeline_configure(&p, &config), 0);
	assert_near(run(&p, standing, 0, 1).angles_rad.z, 0, 1e-9);
}

/* It turns by the mean of the rates before and after each interval. */
static void test_a_slow_sensor_keeps_its_attitude_between_samples(void **state)
{
	struct pipeline_config config = PIPELINE_DEFAULTS;
	struct imu_sample s = {.accel_m_s2 = {0, 0, G}};
	struct pipeline_output out = {.t_us = 0};
	struct pipeline p;

	(void)state;
	config.latency.sensor_s = config.latency.accelerometer_s = 0;
	assert_int_equal(pipeline_init(&p, &config, 0.5), 0);
	for (int k = 0; k < 5; k++) {
		s.t_us = (uint64_t)k * 2000000;
		s.gyro_rad_s.z = k > 0 ? 0.1 : 0;
		out = step(&p, &s);
	}
	assert_near(out.angles_rad.z, 3.5 * 2 * 0.1, 1e-9);
}

static void test_until_the_accelerometer_shows_gravity_nothing_is_valid(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	struct imu_sample falling = {.t_us = 1};
	struct pipeline_output out = step(&p, &falling);

	(void)state;
	assert_int_equal(out.status & PIPELINE_VALID, 0);
	assert_vec_near(out.accel_n_m_s2, ZERO, 0);
	assert_true(run(&p, standing, 1, 2).status & PIPELINE_VALID);
}

static void test_a_new_mounting_turns_the_object_and_not_the_world(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	struct vec3 mounting = {0.3, -0.2, 1};
	struct quat turn = quat_from_aerospace(mounting);
	struct pipeline_output out;

	(void)state;
	run(&p, standing, 0, 600);
	config.calibration.mounting_rad = mounting;
	assert_int_equal(pipeline_configure(&p, &config), 0);
	out = run(&p, standing, 600, 601);
	assert_quat_near(out.q_nb, quat_multiply(standing(600).q_nb, quat_conjugate(turn)), 1e-6);
	assert_vec_near(out.accel_n_m_s2, ZERO, 1e-6);
}

static void test_a_live_change_of_anything_but_the_calibration_keeps_attitude_and_position(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	struct pipeline before;

	(void)state;
	run(&p, moving, 0, 300);
	before = p;
	config.fusion.algorithm = FUSION_MAHONY;
	config.accel_filter = (struct filter_config){FILTER_BUTTERWORTH, 3, 15};
	config.rate_filter.type = FILTER_SEED_FIR;
	config.estimator.gravity_m_s2 = 9.83;
	config.rest.time_s = 3;
	config.position.longest_integration_s = 10;
	assert_int_equal(pipeline_configure(&p, &config), 0);
	assert_memory_equal(&p.fusion.q_nb, &before.fusion.q_nb, sizeof(p.fusion.q_nb));
	assert_vec_near(p.position.velocity_n_m_s, before.position.velocity_n_m_s, 0);
	assert_vec_near(p.position.position_n_m, before.position.position_n_m, 0);
	assert_int_equal(run(&p, moving, 300, 301).status & PIPELINE_GAP, 0);
}

static void test_a_configuration_out_of_range_is_refused_as_a_whole(void **state)
{
	struct pipeline_config config = with_lever(), bad[9];
	struct pipeline p = pipeline(&config), before;

	(void)state;
	run(&p, moving, 0, 50);
	before = p;
	for (int i = 0; i < 9; i++) {
		bad[i] = config;
		bad[i].estimator.lever_arm_b_m.x = 1;
	}
	bad[0].calibration.accel.matrix[0][0] = 0;
	bad[1].accel_filter.order = 9;
	bad[2].rate_filter.cutoff_hz = 0;
	bad[3].fusion.madgwick_beta = -1;
	bad[4].estimator.gravity_m_s2 = 11;
	bad[5].rest.time_s = -1;
	bad[6].position.longest_integration_s = NAN;
	bad[7].latency.sensor_s = 0.2;
	bad[8].latency.accelerometer_s = -0.06;
	for (int i = 0; i < 9; i++) {
		struct pipeline fresh;

		assert_int_equal(pipeline_configure(&p, &bad[i]), -EINVAL);
		assert_memory_equal(&p, &before, sizeof(p));
		assert_int_equal(pipeline_init(&fresh, &bad[i], RATE_HZ), -EINVAL);
	}
}

static void test_the_same_samples_give_the_same_bits(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline a = pipeline(&config), b = pipeline(&config);

	(void)state;
	for (int k = 0; k < 500; k++) {
		struct pipeline_output x = run(&a, moving, k, k + 1), y = run(&b, moving, k, k + 1);

		assert_memory_equal(&x.q_nb, &y.q_nb, sizeof(x.q_nb));
		assert_memory_equal(&x.accel_n_m_s2, &y.accel_n_m_s2, sizeof(x.accel_n_m_s2));
		assert_memory_equal(&x.position_n_m, &y.position_n_m, sizeof(x.position_n_m));
	}
}

/* ---- aids ---- */

static struct pipeline_config by_algorithm(enum fusion_algorithm algorithm)
{
	struct pipeline_config config = with_lever();

	config.fusion.algorithm = algorithm;
	return config;
}

/* Samples from..to-1 of a body at rest, with an aided yaw before every tenth. */
static struct pipeline_output stand_aided(struct pipeline *p, double yaw_rad, double sigma_rad, int from, int to)
{
	struct pipeline_output out = {.t_us = 0};

	for (int k = from; k < to; k++) {
		if (k % 10 == 0)
			assert_int_equal(pipeline_aid_yaw(p, yaw_rad, sigma_rad), 0);
		out = run(p, standing, k, k + 1);
	}
	return out;
}

/* The fifth of five yaws that contradict the heading, and an attitude that is set. */
static void test_the_jump_of_a_heading_from_outside_is_not_an_angular_rate(void **state)
{
	(void)state;
	for (int set = 0; set < 2; set++) {
		struct pipeline_config config = with_lever();
		struct pipeline_output out;
		struct pipeline p;

		config.estimator.rates_from = RATES_FROM_ANGLES;
		p = pipeline(&config);
		out = run(&p, standing, 0, 400);
		for (int i = 0; i < 5 && !set; i++)
			assert_int_equal(pipeline_aid_yaw(&p, out.angles_rad.z + 1.5, 1 * RAD_PER_DEG), 0);
		if (set)
			pipeline_reset_attitude(
				&p, quat_multiply(quat_from_rotation_vector((struct vec3){0, 0, 1.5}), out.q_nb));
		for (int k = 400; k < 420; k++) {
			const struct pipeline_output after = run(&p, standing, k, k + 1);

			assert_near(after.angles_rad.z, out.angles_rad.z + 1.5, 0.02);
			assert_vec_near(after.rate_b_rad_s, ZERO, 0.01);
			assert_vec_near(after.alpha_b_rad_s2, ZERO, 1);
		}
	}
}

/* A yaw that fits the heading is no jump: rest is still found. */
static void test_rest_is_found_under_aided_yaws(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	const double yaw_rad = run(&p, standing, 0, 10).angles_rad.z;

	(void)state;
	assert_true(stand_aided(&p, yaw_rad, 1 * RAD_PER_DEG, 10, 1000).status & PIPELINE_REST);
}

static void test_the_first_aided_yaw_sets_the_heading_when_north_is_unknown(void **state)
{
	(void)state;
	for (int algorithm = FUSION_MADGWICK; algorithm <= FUSION_KALMAN; algorithm++) {
		struct pipeline_config config = by_algorithm((enum fusion_algorithm)algorithm);
		struct pipeline p;

		config.fusion.use_magnetometer = 0;
		p = pipeline(&config);
		run(&p, standing, 0, 200);
		assert_int_equal(pipeline_aid_yaw(&p, -2, 1 * RAD_PER_DEG), 0);
		assert_near(run(&p, standing, 200, 201).angles_rad.z, -2, 0.1 * RAD_PER_DEG);
	}
}

static void test_an_aided_yaw_takes_precedence_over_the_magnetometer(void **state)
{
	(void)state;
	for (int algorithm = FUSION_MADGWICK; algorithm <= FUSION_KALMAN; algorithm++) {
		struct pipeline_config config = by_algorithm((enum fusion_algorithm)algorithm);
		struct pipeline p = pipeline(&config);
		double yaw = run(&p, standing, 0, 2000).angles_rad.z + 20 * RAD_PER_DEG;
		struct pipeline_output out = stand_aided(&p, yaw, 1 * RAD_PER_DEG, 2000, 6000);

		assert_near(out.angles_rad.z, yaw, 0.5 * RAD_PER_DEG);
		assert_near(out.angles_rad.y, aerospace_from_quat(standing(0).q_nb).y, 0.1 * RAD_PER_DEG);
		assert_int_equal(out.status & PIPELINE_MAG_USED, 0);
		/* 40 s after the last aid the magnetometer corrects the heading again, in the frame of the aids */
		out = run(&p, standing, 6000, 14000);
		assert_near(out.angles_rad.z, yaw, 1 * RAD_PER_DEG);
		assert_true(out.status & PIPELINE_MAG_USED);
	}
}

static void test_a_yaw_beyond_the_innovation_gate_is_rejected_and_the_fifth_in_a_row_applied(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	double yaw = run(&p, standing, 0, 2000).angles_rad.z;

	(void)state;
	for (int i = 0; i < 4; i++) {
		assert_int_equal(pipeline_aid_yaw(&p, yaw + 1.5, 1 * RAD_PER_DEG), 0);
		assert_near(run(&p, standing, 2000 + i, 2001 + i).angles_rad.z, yaw, 0.5 * RAD_PER_DEG);
	}
	assert_int_equal(pipeline_aid_yaw(&p, yaw + 1.5, 1 * RAD_PER_DEG), 0);
	assert_near(run(&p, standing, 2004, 2005).angles_rad.z, yaw + 1.5, 0.5 * RAD_PER_DEG);
}

static void test_an_aided_yaw_is_weighed_by_its_sigma(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline sharp = pipeline(&config), vague;
	double yaw = run(&sharp, standing, 0, 2000).angles_rad.z;

	(void)state;
	vague = sharp;
	assert_int_equal(pipeline_aid_yaw(&sharp, yaw + 2 * RAD_PER_DEG, 0.1 * RAD_PER_DEG), 0);
	assert_int_equal(pipeline_aid_yaw(&vague, yaw + 2 * RAD_PER_DEG, 60 * RAD_PER_DEG), 0);
	assert_near(run(&sharp, standing, 2000, 2001).angles_rad.z, yaw + 2 * RAD_PER_DEG, 0.2 * RAD_PER_DEG);
	assert_near(run(&vague, standing, 2000, 2001).angles_rad.z, yaw, 0.2 * RAD_PER_DEG);
}

static void test_a_set_attitude_is_exact_and_the_position_stays(void **state)
{
	const struct vec3 up_b = {0, 0, 1};

	(void)state;
	for (int mode = POSITION_ZERO_VELOCITY_AT_REST; mode <= POSITION_NAVIGATION; mode++) {
		struct pipeline_config config = with_lever();
		struct pipeline_output before, after;
		struct quat turned, own;
		struct pipeline p;

		config.position.mode = (enum position_mode)mode;
		config.latency.sensor_s = config.latency.accelerometer_s = 0;
		p = pipeline(&config);
		before = run(&p, moving, 0, 600);
		own = mode == POSITION_NAVIGATION ? p.position.navigation.q_nb : before.q_nb;
		turned = quat_multiply(quat_from_rotation_vector((struct vec3){0, 0, 1}), before.q_nb);
		assert_int_equal(pipeline_reset_attitude(&p, turned), 0);
		after = run(&p, moving, 600, 601);
		assert_quat_near(after.q_nb,
			quat_multiply(turned, quat_multiply(quat_conjugate(moving(599).q_nb), moving(600).q_nb)),
			0.2 * RAD_PER_DEG);
		assert_vec_near(quat_rotate_inverse(after.q_nb, after.velocity_n_m_s),
			quat_rotate_inverse(own, before.velocity_n_m_s), 0.1);
		assert_vec_near(after.position_n_m, before.position_n_m, 0.02);
		/* and it stays so: the magnetometer has another north now */
		after = run(&p, moving, 601, 6000);
		assert_near(quat_rotate(after.q_nb, up_b).z, quat_rotate(moving(5999).q_nb, up_b).z, 0.02);
		assert_near(remainder(after.angles_rad.z - aerospace_from_quat(moving(5999).q_nb).z, 2 * PI), 1,
			3 * RAD_PER_DEG);
	}
}

static void test_an_attitude_set_before_the_first_sample_holds(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	struct quat north_up = quat_multiply(quat_from_rotation_vector((struct vec3){0, 0, 2}), standing(0).q_nb);

	(void)state;
	assert_int_equal(pipeline_reset_attitude(&p, north_up), 0);
	assert_quat_near(run(&p, standing, 0, 400).q_nb, north_up, 0.5 * RAD_PER_DEG);
}

/* A vehicle at 3 m/s without vibration: its sensors measure the same as at rest. */
static void test_an_aided_velocity_is_integrated_where_the_sensors_measure_rest(void **state)
{
	const struct vec3 v = {3, -1, 0};

	(void)state;
	for (int mode = POSITION_ZERO_VELOCITY_AT_REST; mode <= POSITION_NAVIGATION; mode++) {
		struct pipeline_config config = with_lever();
		struct pipeline_output out = {.t_us = 0};
		struct pipeline p;

		config.position.mode = (enum position_mode)mode;
		config.position.longest_integration_s = 2;
		p = pipeline(&config);
		run(&p, standing, 0, 100);
		pipeline_reset_position(&p);
		for (int k = 100; k < 100 + 10 * RATE_HZ; k++) {
			if (k % 20 == 0)
				assert_int_equal(pipeline_aid_velocity(&p, v, 0.05), 0);
			out = run(&p, standing, k, k + 1);
		}
		if (mode == POSITION_NAVIGATION) {
			assert_vec_near(out.velocity_n_m_s, v, 0.05);
			assert_vec_near(out.position_n_m, vec3_scale(10, v), 0.7);
			assert_true(out.sigma.velocity_m_s.x < 0.05);
		}
		assert_int_equal(out.status & PIPELINE_TIME_LIMIT, 0);
	}
}

/* 2 m/s^2 to the east for 10 s: without the velocity every filter takes a part of it for tilt. */
static void test_an_aided_velocity_keeps_a_long_acceleration_from_tilting_the_attitude(void **state)
{
	double tilt[2];

	(void)state;
	for (int aided = 0; aided < 2; aided++) {
		struct pipeline_config config = PIPELINE_DEFAULTS;
		struct pipeline p;
		struct pipeline_output out = {.t_us = 0};

		p = pipeline(&config);
		for (int k = 0; k < 15 * RATE_HZ; k++) {
			double t = (double)k / RATE_HZ - 5;
			struct imu_sample s = {.t_us = (uint64_t)(k * INTERVAL_US),
				.accel_m_s2 = {t > 0 ? 2 : 0, 0, G},
				.mag_uT = FIELD_N,
				.flags = SAMPLE_MAG};

			if (aided && k % 20 == 0)
				pipeline_aid_velocity(&p, (struct vec3){t > 0 ? 2 * t : 0, 0, 0}, 0.05);
			out = step(&p, &s);
		}
		tilt[aided] = fabs(out.angles_rad.y);
		if (aided)
			assert_near(out.velocity_n_m_s.x, 20, 0.3);
	}
	assert_true(tilt[1] < 0.3 * RAD_PER_DEG);
	assert_true(tilt[0] > 3 * tilt[1]);
}

static void test_an_aided_velocity_is_that_of_the_reference_point(void **state)
{
	struct pipeline_config config = PIPELINE_DEFAULTS;
	struct pipeline_output out = {.t_us = 0};
	struct pipeline p;

	(void)state;
	config.estimator.lever_arm_b_m = (struct vec3){1, 0, 0};
	p = pipeline(&config);
	for (int k = 0; k < 10 * RATE_HZ; k++) { /* turns about its reference point at 1 rad/s */
		struct quat q = quat_from_rotation_vector((struct vec3){0, 0, (double)k / RATE_HZ});
		struct imu_sample s = {.t_us = (uint64_t)(k * INTERVAL_US),
			.gyro_rad_s = {0, 0, 1},
			.accel_m_s2 = {-1, 0, G},
			.mag_uT = quat_rotate_inverse(q, FIELD_N),
			.flags = SAMPLE_MAG};

		if (k == 5 * RATE_HZ)
			pipeline_reset_position(&p);
		pipeline_aid_velocity(&p, ZERO, 0.01);
		out = step(&p, &s);
	}
	assert_vec_near(out.velocity_n_m_s, ZERO, 0.05);
	assert_vec_near(out.position_n_m, ZERO, 0.05);
}

static void test_an_aid_out_of_range_is_refused_as_a_whole(void **state)
{
	const double bad[] = {NAN, INFINITY, -INFINITY, 1001, -1001};
	const double sigmas[] = {0, -1, NAN, INFINITY, 1001};
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config), before;

	(void)state;
	run(&p, moving, 0, 300);
	before = p;
	for (int i = 0; i < 5; i++) {
		assert_int_equal(pipeline_aid_velocity(&p, (struct vec3){0, bad[i], 0}, 1), -EINVAL);
		assert_int_equal(pipeline_aid_velocity(&p, ZERO, sigmas[i]), -EINVAL);
		assert_int_equal(pipeline_aid_yaw(&p, bad[i], 1), -EINVAL);
		assert_int_equal(pipeline_aid_yaw(&p, 0, sigmas[i]), -EINVAL);
		assert_int_equal(pipeline_reset_attitude(&p, (struct quat){1, 0, bad[i], 0}), -EINVAL);
	}
	assert_int_equal(pipeline_reset_attitude(&p, (struct quat){0, 0, 0, 0}), -EINVAL);
	assert_memory_equal(&p, &before, sizeof(p));
}

static void test_an_aid_before_there_is_an_attitude_does_nothing(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline aided = pipeline(&config), untouched = aided;

	(void)state;
	assert_int_equal(pipeline_aid_velocity(&aided, (struct vec3){1, 2, 3}, 1), 0);
	assert_int_equal(pipeline_aid_yaw(&aided, 1, 1), 0);
	assert_memory_equal(&aided, &untouched, sizeof(aided));
}

static double wild(void)
{
	double odds = any();

	return odds > 0.99 ? NAN : odds > 0.98 ? INFINITY : odds > 0.9 ? 0 : pow(10, 6 * any()) * any();
}

static struct vec3 wild_vec(void)
{
	struct vec3 v;

	v.x = wild();
	v.y = wild();
	v.z = wild();
	return v;
}

static void test_the_output_is_finite_for_any_input(void **state)
{
	struct pipeline_config config = with_lever();
	uint64_t t_us = 0;
	unsigned taken = 0;
	struct pipeline p = pipeline(&config);

	(void)state;
	for (int k = 0; k < 100000; k++) {
		struct imu_sample s = {
			.gyro_rad_s = wild_vec(),
			.accel_m_s2 = wild_vec(),
			.mag_uT = wild_vec(),
			.flags = any() > 0 ? SAMPLE_MAG : 0,
		};
		struct pipeline_output out;

		t_us += any() > 0.99 ? 1u << 31 : INTERVAL_US;
		s.t_us = t_us;
		if (k % 100 == 0) {
			config.estimator.model = (enum lever_arm_model)(k / 100 % 3);
			config.estimator.rates_from = (enum rate_source)(k / 300 % 2);
			config.fusion.algorithm = (enum fusion_algorithm)(k / 600 % 3);
			config.accel_filter.type = (enum filter_type)(k / 1200 % 3);
			assert_int_equal(pipeline_configure(&p, &config), 0);
		}
		pipeline_aid_yaw(&p, wild(), fabs(wild()));
		if (any() > 0.9)
			pipeline_aid_velocity(&p, wild_vec(), fabs(wild()));
		if (pipeline_step(&p, &s, &out) < 0)
			continue;
		taken++;
		assert_true(vec3_finite(out.accel_b_m_s2) && vec3_finite(out.accel_n_m_s2));
		assert_true(vec3_finite(out.velocity_n_m_s) && vec3_finite(out.position_n_m));
		assert_true(vec3_finite(out.rate_b_rad_s) && vec3_finite(out.alpha_b_rad_s2));
		assert_true(vec3_finite(out.angles_rad));
		assert_near(quat_apart_rad(out.q_nb, out.q_nb), 0, 1e-6);
	}
	assert_true(taken > 10000);
}

static FILE *open_trial(const char *name, const char *kind)
{
	const char *folder = getenv("IMU9_BROAD");
	char path[512];

	snprintf(path, sizeof(path), "%s/%s.%s.csv", folder ? folder : "../shared/data/broad", name, kind);
	return fopen(path, "r");
}

static void test_a_recorded_hand_movement_is_followed_within_five_degrees(void **state)
{
	FILE *imu = open_trial("06_undisturbed_fast_rotation_A", "imu");
	FILE *ref = open_trial("06_undisturbed_fast_rotation_A", "ref");
	struct pipeline p;
	double sum = 0;
	int n = 0;
	char a[512], b[512];

	(void)state;
	if (!imu || !ref) {
		print_message("no recorded trials here (IMU9_BROAD)\n");
		skip();
	}
	assert_int_equal(pipeline_init(&p, &PIPELINE_DEFAULTS, 286), 0);
	while (fgets(a, sizeof(a), imu) && fgets(b, sizeof(b), ref)) {
		struct imu_sample s = {.flags = SAMPLE_MAG};
		struct pipeline_output out;
		struct quat q;
		double t, x, y, z;
		int is_moving;

		if (sscanf(a, "%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf", &t, &s.gyro_rad_s.x, &s.gyro_rad_s.y,
			    &s.gyro_rad_s.z, &s.accel_m_s2.x, &s.accel_m_s2.y, &s.accel_m_s2.z, &s.mag_uT.x,
			    &s.mag_uT.y, &s.mag_uT.z) != 10)
			continue; /* the header */
		s.t_us = (uint64_t)llround(t * 1e6);
		out = step(&p, &s);
		if (sscanf(b, "%*f,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%d", &q.w, &q.x, &q.y, &q.z, &x, &y, &z, &is_moving) !=
				8 ||
			!is_moving)
			continue;
		sum += pow(quat_apart_rad(out.q_nb, q), 2);
		n++;
	}
	fclose(imu);
	fclose(ref);
	assert_true(n > 10000);
	assert_true(sqrt(sum / n) < 5 * RAD_PER_DEG);
}

/* An error of the attitude is one of the acceleration's direction. */
static void test_the_acceleration_sigma_includes_that_of_its_direction(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	double most = 0;

	(void)state;
	for (int k = 0; k < 500; k++) {
		struct pipeline_output out = run(&p, moving, k, k + 1);
		struct vec3 a = out.accel_n_m_s2, angle = out.sigma.attitude_rad, sigma = out.sigma.accel_m_s2;

		assert_true(sigma.x >= angle.z * fabs(a.y) && sigma.y >= angle.z * fabs(a.x));
		assert_true(sigma.x >= angle.y * fabs(a.z + config.estimator.gravity_m_s2));
		most = fmax(most, fmax(fabs(a.x), fabs(a.y)));
	}
	assert_true(most > 1); /* or the test would say nothing */
}

/* Mean of the squared error in units of sigma over the samples of a recorded trial while it moves, and over the axes:
 * of the attitude, and of the displacement since the movement began. */
static bool honesty(const char *name, struct vec3 lever_b_m, double *attitude, double *displacement)
{
	FILE *imu = open_trial(name, "imu"), *ref = open_trial(name, "ref");
	struct pipeline_config config = PIPELINE_DEFAULTS;
	struct vec3 from_true = ZERO;
	bool known = false;
	struct pipeline p;
	char a[512], b[512];
	int n = 0, m = 0;

	*attitude = *displacement = 0;
	config.estimator.lever_arm_b_m = lever_b_m;
	assert_int_equal(pipeline_init(&p, &config, 286), 0);
	while (imu && ref && fgets(a, sizeof(a), imu) && fgets(b, sizeof(b), ref)) {
		struct imu_sample s = {.flags = SAMPLE_MAG};
		struct pipeline_output out;
		struct vec3 at, off, sigma, e;
		struct quat q;
		double t;
		int is_moving, seen;

		if (sscanf(a, "%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf", &t, &s.gyro_rad_s.x, &s.gyro_rad_s.y,
			    &s.gyro_rad_s.z, &s.accel_m_s2.x, &s.accel_m_s2.y, &s.accel_m_s2.z, &s.mag_uT.x,
			    &s.mag_uT.y, &s.mag_uT.z) != 10)
			continue;
		s.t_us = (uint64_t)llround(t * 1e6);
		out = step(&p, &s);
		seen = sscanf(b, "%*f,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%d", &q.w, &q.x, &q.y, &q.z, &at.x, &at.y, &at.z,
			       &is_moving) == 8;
		if (p.position.navigation.still || !seen || !is_moving) {
			known = seen;
			from_true = at;
			continue;
		}
		q = quat_multiply(q, quat_conjugate(out.q_nb));
		e = vec3_scale(q.w < 0 ? -2 : 2, (struct vec3){q.x, q.y, q.z});
		sigma = out.sigma.attitude_rad;
		*attitude += pow(e.x / sigma.x, 2) + pow(e.y / sigma.y, 2) + pow(e.z / sigma.z, 2);
		n += 3;
		off = vec3_sub(vec3_sub(out.position_n_m, p.position.moved_from_n_m), vec3_sub(at, from_true));
		sigma = out.sigma.displacement_m;
		if (!known || out.status & PIPELINE_TIME_LIMIT)
			continue;
		*displacement += pow(off.x / sigma.x, 2) + pow(off.y / sigma.y, 2) + pow(off.z / sigma.z, 2);
		m += 3;
	}
	*attitude /= n;
	*displacement /= m;
	if (imu)
		fclose(imu);
	if (ref)
		fclose(ref);
	return n > 0;
}

static void test_sigma_is_honest_on_recorded_hand_movements(void **state)
{
	static const struct {
		const char *name;
		struct vec3 lever_b_mm;
	} trials[] = {
		{"02_undisturbed_slow_rotation_B", {2.3, -1.9, 7.8}},
		{"06_undisturbed_fast_rotation_A", {-0.8, 0.4, 10.4}},
		{"09_undisturbed_fast_rotation_with_breaks_B", {2.3, -1.9, 7.8}},
		{"14_undisturbed_slow_translation_with_breaks_B", {2.3, -1.9, 7.8}},
	};
	double attitude = 0, displacement = 0;

	(void)state;
	for (int i = 0; i < 4; i++) {
		double a, w;

		if (!honesty(trials[i].name, vec3_scale(1e-3, trials[i].lever_b_mm), &a, &w)) {
			print_message("no recorded trials here (IMU9_BROAD)\n");
			skip();
		}
		print_message("%s: NEES of the attitude %.2f, of the displacement %.2f\n", trials[i].name, a, w);
		attitude += a / 4;
		displacement += w / 4;
	}
	assert_true(attitude > 0.5 && attitude < 2);
	/* this chip is twice as noisy as told, which its standstills show */
	assert_true(displacement > 0.4 && displacement < 1);
}

/* A magnetometer with one axis mirrored, on an object that turns about all axes. */
static void test_a_field_that_does_not_turn_with_the_object_is_a_bit_of_the_status(void **state)
{
	struct pipeline_config config = with_lever();
	struct quat q_nb = QUAT_IDENTITY;

	(void)state;
	for (int use = 0; use < 2; use++)
		for (int mirrored = 0; mirrored < 2; mirrored++) {
			struct pipeline_output out = {.t_us = 0};
			struct pipeline p;

			config.fusion.use_magnetometer = use;
			p = pipeline(&config);
			for (int k = 0; k < 20 * RATE_HZ; k++) {
				const double t = (double)k / RATE_HZ;
				struct imu_sample s = {.flags = SAMPLE_MAG, .t_us = (uint64_t)k * 1000000 / RATE_HZ};

				s.gyro_rad_s = (struct vec3){sin(t), cos(1.3 * t), sin(0.7 * t)};
				q_nb = quat_multiply(
					q_nb, quat_from_rotation_vector(vec3_scale(1.0 / RATE_HZ, s.gyro_rad_s)));
				s.accel_m_s2 = quat_rotate_inverse(q_nb, (struct vec3){0, 0, G});
				s.mag_uT = quat_rotate_inverse(q_nb, (struct vec3){0, 20, -45});
				s.mag_uT.x *= mirrored ? -1 : 1;
				out = step(&p, &s);
			}
			assert_int_equal(!!(out.status & PIPELINE_DISAGREES), use && mirrored);
			assert_int_equal(!!(out.status & PIPELINE_MAG_USED), use && !mirrored);
			assert_int_equal(out.sigma.attitude_rad.z > 1.8, use && mirrored);
		}
}

static void test_the_ranges_of_aids_include_their_limits(void **state)
{
	const struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);

	(void)state;
	assert_int_equal(pipeline_aid_velocity(&p, (struct vec3){1000, -1000, 1000}, 0.001), 0);
	assert_int_equal(pipeline_aid_velocity(&p, (struct vec3){-1000, 1000, -1000}, 1000), 0);
	assert_int_equal(pipeline_aid_velocity(&p, ZERO, 0.00099), -EINVAL);
	assert_int_equal(pipeline_aid_yaw(&p, 2 * PI, 0.0001), 0);
	assert_int_equal(pipeline_aid_yaw(&p, -2 * PI, PI), 0);
	assert_int_equal(pipeline_aid_yaw(&p, 6.3, PI), -EINVAL);
	assert_int_equal(pipeline_aid_yaw(&p, 0, 0.000099), -EINVAL);
	assert_int_equal(pipeline_aid_yaw(&p, 0, 3.15), -EINVAL);
}

static void test_a_live_change_of_the_rate_filter_or_the_noise_gives_the_sigma_of_a_fresh_start(void **state)
{
	struct pipeline_config config = with_lever(), changed[2] = {config, config};

	(void)state;
	changed[0].rate_filter = (struct filter_config){.type = FILTER_BUTTERWORTH, .order = 2, .cutoff_hz = 7};
	changed[1].noise.gyro_density_rad_s_sqrt_hz *= 3;
	for (int i = 0; i < 2; i++) {
		struct pipeline fresh = pipeline(&changed[i]), p = pipeline(&config);

		assert_memory_not_equal(&p.rates_variance, &fresh.rates_variance, sizeof(p.rates_variance));
		assert_int_equal(pipeline_configure(&p, &changed[i]), 0);
		assert_memory_equal(&p.rates_variance, &fresh.rates_variance, sizeof(p.rates_variance));
	}
}

static void test_a_sensor_without_a_magnetometer_has_used_none_from_its_first_sample_on(void **state)
{
	const struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);

	(void)state;
	for (int k = 0; k < 10; k++) {
		struct imu_sample s = moving_at(k / RATE_HZ).sample;
		struct pipeline_output out;

		s.flags = 0;
		pipeline_step(&p, &s, &out);
		assert_int_equal(out.status & PIPELINE_MAG_USED, 0);
	}
}

static void test_samples_at_the_limits_of_the_plausible_are_used_on_every_axis(void **state)
{
	static const double limit[3] = {1e3, 1e5, 1e6}; /* rad/s, m/s^2, uT */
	const struct pipeline_config config = with_lever();

	(void)state;
	for (int channel = 0; channel < 9; channel++)
		for (int sign = -1; sign <= 1; sign += 2) {
			struct pipeline p = pipeline(&config);
			struct imu_sample s = standing(0).sample;
			struct vec3 *triad[3] = {&s.gyro_rad_s, &s.accel_m_s2, &s.mag_uT}, *v = triad[channel / 3];
			double *value = channel % 3 == 0 ? &v->x : channel % 3 == 1 ? &v->y : &v->z;
			struct pipeline_output out;

			*value = sign * limit[channel / 3];
			assert_int_equal(pipeline_step(&p, &s, &out), 0);
			s.t_us += INTERVAL_US;
			*value = sign * 1.001 * limit[channel / 3];
			assert_int_equal(pipeline_step(&p, &s, &out), -EINVAL);
			s.flags = 0; /* without its flag the field is not used */
			assert_int_equal(pipeline_step(&p, &s, &out), channel < 6 ? -EINVAL : 0);
		}
}

static void test_a_set_attitude_may_be_10_percent_off_unit_length(void **state)
{
	const struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);

	(void)state;
	run(&p, standing, 0, 10);
	assert_int_equal(pipeline_reset_attitude(&p, (struct quat){0, 0, 0, 1.099}), 0);
	assert_int_equal(pipeline_reset_attitude(&p, (struct quat){0, 0.901, 0, 0}), 0);
	assert_int_equal(pipeline_reset_attitude(&p, (struct quat){0, 0, 1.101, 0}), -EINVAL);
	assert_int_equal(pipeline_reset_attitude(&p, (struct quat){0.899, 0, 0, 0}), -EINVAL);
}

static void test_the_ranges_of_the_latency_include_their_limits(void **state)
{
	static const struct latency_config good[] = {{0, 0}, {0.1, 0}, {0.1, 0.05}, {0.05, -0.05}, {0, -0.05}};
	static const struct latency_config bad[] = {{-0.001, 0.01}, {0.1001, 0}, {0.1, 0.0501}, {0.1, -0.0501}};
	struct pipeline_config config = with_lever();
	struct pipeline p;

	(void)state;
	for (size_t i = 0; i < sizeof(good) / sizeof(good[0]); i++) {
		config.latency = good[i];
		assert_int_equal(pipeline_init(&p, &config, RATE_HZ), 0);
	}
	for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); i++) {
		config.latency = bad[i];
		assert_int_equal(pipeline_init(&p, &config, RATE_HZ), -EINVAL);
	}
}

/* An error of the attitude, a rotation vector e, changes the acceleration by e x (accel + gravity). The product of e
 * and gravity is in the sigma of the navigation already. */
static void test_each_axis_of_the_acceleration_sigma_has_its_own_errors(void **state)
{
	const struct vec3 angle = {0.01, 0.02, 0.03}, known = {0.5, 0.6, 0.7};
	struct pipeline_config config = with_lever();
	struct pipeline_output out;
	struct imu_sample s;
	struct pipeline p;
	struct vec3 a, force;

	(void)state;
	config.position.mode = POSITION_ZERO_VELOCITY_AT_REST; /* has no sigma of its own */
	config.estimator.model = LEVER_ARM_OFF;
	p = pipeline(&config);
	run(&p, standing, 0, 10);
	p.position.sigma.attitude_rad = angle;
	p.position.sigma.accel_m_s2 = known;
	s = standing(10).sample;
	s.accel_m_s2 = vec3_add(s.accel_m_s2, (struct vec3){10, -20, 15});
	assert_int_equal(pipeline_step(&p, &s, &out), 0);
	a = out.accel_n_m_s2;
	force = vec3_add(a, (struct vec3){0, 0, G});
	assert_true(fabs(a.x) > 5 && fabs(a.y) > 5 && fabs(a.z) > 5);
	assert_near(out.sigma.accel_m_s2.x,
		sqrt(pow(known.x, 2) + pow(angle.y, 2) * (pow(force.z, 2) - G * G) + pow(angle.z * a.y, 2)), 1e-9);
	assert_near(out.sigma.accel_m_s2.y,
		sqrt(pow(known.y, 2) + pow(angle.x, 2) * (pow(force.z, 2) - G * G) + pow(angle.z * a.x, 2)), 1e-9);
	assert_near(
		out.sigma.accel_m_s2.z, sqrt(pow(known.z, 2) + pow(angle.x * a.y, 2) + pow(angle.y * a.x, 2)), 1e-9);
}

static void test_between_measurements_of_the_field_the_last_one_is_reported(void **state)
{
	const struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	struct vec3 measured = run(&p, moving, 0, 10).mag_b_uT;
	struct imu_sample s = moving(10).sample;

	(void)state;
	assert_vec_near(measured, moving(9).sample.mag_uT, 0);
	s.flags = 0;
	s.mag_uT = ZERO;
	assert_vec_near(step(&p, &s).mag_b_uT, measured, 0);
}

/* With the latency of the default sensor, with an acceleration filter, and from the first sample on. */
static void test_a_robot_at_rest_does_not_accelerate(void **state)
{
	struct pipeline_config config = PIPELINE_DEFAULTS;
	struct pipeline p;

	(void)state;
	config.estimator.lever_arm_b_m = LEVER_B;
	config.accel_filter.type = FILTER_BUTTERWORTH;
	p = pipeline(&config);
	for (int k = 0; k < 400; k++)
		assert_vec_near(run(&p, standing, k, k + 1).accel_n_m_s2, ZERO, 1e-6);
}

/* A gyro whose bias grows by 0.001 rad/s per K from 25 degC on turns at 0.5 rad/s; only some samples have a
 * temperature. */
static void test_a_temperature_in_a_sample_holds_until_the_next_one(void **state)
{
	const struct {
		double degC, rate;
	} samples[] = {{0, 0.51}, {35, 0.5}, {0, 0.5}, {15, 0.52}, {0, 0.52}};
	struct pipeline_config config = with_lever();
	struct pipeline p;

	(void)state;
	config.calibration.temperature =
		(struct temperature_compensation){.gyro_slope = {0, 0, 0.001}, .reference_degC = 25};
	config.rate_filter.type = FILTER_OFF;
	p = pipeline(&config);
	for (int k = 0; k < 5; k++) {
		struct imu_sample s = standing(k).sample;

		s.gyro_rad_s.z = 0.51;
		s.temperature_degC = samples[k].degC;
		s.flags |= samples[k].degC > 0 ? SAMPLE_TEMPERATURE : 0;
		assert_near(step(&p, &s).rate_b_rad_s.z, samples[k].rate, 1e-4);
	}
}

/* RMS along x of what an accelerometer with white noise measures at rest. */
static double noise_at_rest(double latency_s, double density)
{
	struct pipeline_config config = with_lever();
	struct pipeline p;
	double sum = 0;

	config.latency.sensor_s = latency_s;
	config.noise.accel_density_m_s2_sqrt_hz = density;
	p = pipeline(&config);
	for (int k = 0; k < 4000; k++) {
		struct imu_sample s = standing(k).sample;

		/* uniform, of the standard deviation that the density has at this rate */
		s.accel_m_s2 = vec3_add(s.accel_m_s2, any_vec(sqrt(3.0 * RATE_HZ / 2) * 0.02));
		sum += pow(step(&p, &s).accel_n_m_s2.x, 2) * (k < 2000 ? 0 : 1.0 / 2000);
	}
	return sqrt(sum);
}

/* The derivative of noise is noise: a change that is explained by it is not extrapolated. */
static void test_the_extrapolation_over_the_latency_adds_no_noise_at_rest(void **state)
{
	const double without = noise_at_rest(0, 0.02);

	(void)state;
	print_message("noise at rest: %.3f, extrapolated %.3f, without knowing its density %.3f m/s^2\n", without,
		noise_at_rest(0.0042, 0.02), noise_at_rest(0.0042, 1e-6));
	assert_true(noise_at_rest(0.0042, 0.02) < 1.1 * without);
	assert_true(noise_at_rest(0.0042, 1e-6) > 1.2 * without);
}

/* The noise of the gyro does not influence the attitude. */
static void test_the_auto_mode_with_a_useless_gyro_is_that_without_a_lever_arm(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline automatic, off;

	(void)state;
	config.accel_filter.type = FILTER_BUTTERWORTH;
	config.noise.gyro_density_rad_s_sqrt_hz = 1e3;
	config.estimator.model = LEVER_ARM_AUTO;
	automatic = pipeline(&config);
	config.estimator.model = LEVER_ARM_OFF;
	off = pipeline(&config);
	for (int k = 0; k < 400; k++)
		assert_vec_near(run(&automatic, moving, k, k + 1).accel_n_m_s2,
			run(&off, moving, k, k + 1).accel_n_m_s2, 1e-12);
}

/* Far below the frequency of the motion the filter's output differs from its input. */
static void test_a_new_acceleration_filter_continues_from_the_last_output(void **state)
{
	struct pipeline_config config = with_lever();
	struct vec3 before, after;
	struct pipeline p;

	(void)state;
	config.accel_filter = (struct filter_config){.type = FILTER_BUTTERWORTH, .order = 2, .cutoff_hz = 0.2};
	p = pipeline(&config);
	before = run(&p, moving, 0, 450).accel_n_m_s2;
	config.accel_filter.order = 3;
	assert_int_equal(pipeline_configure(&p, &config), 0);
	after = run(&p, moving, 450, 451).accel_n_m_s2;
	assert_true(vec3_norm(vec3_sub(before, moving(450).accel_n)) > 0.5);
	assert_vec_near(after, before, 0.01);
}

static void test_fusion_and_navigation_use_the_users_limits_of_rest_latency_and_noise(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);

	(void)state;
	config.rest.gyro_threshold_rad_s = 0.011;
	config.rest.accel_threshold_m_s2 = 0.12;
	config.rest.time_s = 1.3;
	config.latency.sensor_s = 0.014;
	config.noise.mag_sigma_uT = 1.5;
	config.noise.accel_density_m_s2_sqrt_hz = 0.016;
	for (int fresh = 0; fresh < 2; fresh++) {
		const struct navigation_config *n = &p.position.config.navigation;

		if (fresh)
			p = pipeline(&config);
		else
			assert_int_equal(pipeline_configure(&p, &config), 0);
		assert_near(n->standstill.gyro_threshold_rad_s, 0.011, 0);
		assert_near(n->standstill.accel_threshold_m_s2, 0.12, 0);
		assert_near(n->rest_s, 1.3, 0);
		assert_near(n->noise.accel_density_m_s2_sqrt_hz, 0.016, 0);
		assert_near(p.fusion.config.delay_s, 0.014, 0);
		assert_near(p.fusion.config.kalman.field_sigma_uT, 1.5, 0);
		assert_vec_near(p.fusion.config.lever_arm_b_m, LEVER_B, 0);
	}
}

static void test_a_new_gyro_bias_is_not_an_angular_acceleration(void **state)
{
	struct pipeline_config config = with_lever();
	struct pipeline p = pipeline(&config);
	struct pipeline_output out;

	(void)state;
	run(&p, standing, 0, 400);
	config.calibration.gyro.bias.x = -0.5;
	assert_int_equal(pipeline_configure(&p, &config), 0);
	out = run(&p, standing, 400, 401);
	assert_vec_near(out.alpha_b_rad_s2, ZERO, 0);
	assert_vec_near(out.rate_b_rad_s, ((struct vec3){0.5, 0, 0}), 0.01);
}

/* Also when another filter's attitude is published: the Kalman filter is the one that knows how well. */
static void test_the_navigation_knows_attitude_and_gyro_bias_as_well_as_the_kalman_filter(void **state)
{
	(void)state;
	for (int algorithm = FUSION_MADGWICK; algorithm <= FUSION_KALMAN; algorithm++) {
		struct pipeline_config config = by_algorithm((enum fusion_algorithm)algorithm);
		const struct navigation *n;
		const struct fusion_kalman *k;
		struct pipeline p;

		config.fusion.kalman.bias_sigma_rad_s = 0.05;
		p = pipeline(&config);
		run(&p, moving, 0, RATE_HZ);
		n = &p.position.navigation;
		k = algorithm == FUSION_KALMAN ? &p.fusion.kalman : &p.reference.kalman;
		assert_vec_near(n->fusion_variance_rad2,
			((struct vec3){k->covariance[0][0], k->covariance[1][1],
				fusion_kalman_heading_variance(k, &config.fusion.kalman)}),
			0);
		for (int i = 0; i < 3; i++)
			assert_true(n->p[NAVIGATION_BG + i][NAVIGATION_BG + i] >
				    0.9 * k->covariance[KALMAN_BIAS + i][KALMAN_BIAS + i]);
	}
}

/* A robot stands for 10 s, reaches 1 m/s within 2 s on a circle, and stays on it. Its centripetal acceleration looks
 * like an accelerometer's error: it turns with the robot. Returns the share of the time beyond 3 sigma. */
static double tilt_beyond_on_a_circle(double radius_m, bool *vibrates)
{
	const double most_rad_s = 1 / radius_m, dt_s = 1.0 / RATE_HZ;
	struct pipeline p = pipeline(&PIPELINE_DEFAULTS);
	double beyond = 0, rate = 0;

	for (int k = 0; k < 60 * RATE_HZ; k++) {
		double next = most_rad_s * fmax(0, fmin(1, (k * dt_s - 10) / 2));
		double t_m_s2 = radius_m * (next - rate) / dt_s;
		struct imu_sample s = {.t_us = (uint64_t)k * (1000000 / RATE_HZ),
			.gyro_rad_s = {0, 0, next},
			.accel_m_s2 = {t_m_s2, radius_m * next * next, 9.81}};
		struct pipeline_output out = step(&p, &s);
		double tilt = hypot(out.angles_rad.x, out.angles_rad.y);

		rate = next;
		beyond += (tilt > 3 * out.sigma.attitude_rad.x) / (60.0 * RATE_HZ);
		*vibrates |= k > 30 * RATE_HZ && out.status & PIPELINE_VIBRATION;
	}
	return beyond;
}

static void test_the_centripetal_acceleration_of_a_long_turn_counts_in_the_sigma_of_the_tilt(void **state)
{
	bool vibrates = false;

	(void)state;
	for (double radius_m = 2; radius_m < 10; radius_m *= 2)
		assert_true(tilt_beyond_on_a_circle(radius_m, &vibrates) < 0.01);
	assert_false(vibrates);
}

/* ---- Madgwick's and Mahony's filters beside the Kalman filter ---- */

/* Two pipelines on the same samples, one with the Kalman filter and one with another. */
struct beside {
	struct pipeline kalman, other;
	struct pipeline_output of_kalman, of_other;
};

static struct beside beside(enum fusion_algorithm algorithm)
{
	struct pipeline_config by_kalman = by_algorithm(FUSION_KALMAN), by_other = by_algorithm(algorithm);

	return (struct beside){.kalman = pipeline(&by_kalman), .other = pipeline(&by_other)};
}

static void run_beside(struct beside *b, struct truth (*motion)(int), int from, int to)
{
	b->of_kalman = run(&b->kalman, motion, from, to);
	b->of_other = run(&b->other, motion, from, to);
}

static void test_another_filter_changes_neither_velocity_nor_position(void **state)
{
	(void)state;
	for (int algorithm = FUSION_MADGWICK; algorithm <= FUSION_MAHONY; algorithm++) {
		struct beside b = beside((enum fusion_algorithm)algorithm);

		run_beside(&b, moving, 0, 10 * RATE_HZ);
		assert_vec_near(b.of_other.velocity_n_m_s, b.of_kalman.velocity_n_m_s, 0);
		assert_vec_near(b.of_other.position_n_m, b.of_kalman.position_n_m, 0);
		assert_vec_near(b.of_other.sigma.position_m, b.of_kalman.sigma.position_m, 0);
		assert_true(quat_apart_rad(b.of_other.q_nb, b.of_kalman.q_nb) > 0.1 * RAD_PER_DEG);
	}
}

/* The variance of the Kalman filter's attitude and the square of the distance from it. */
static void test_the_sigma_of_another_filters_attitude_has_its_distance_from_the_kalman_filters(void **state)
{
	(void)state;
	for (int algorithm = FUSION_MADGWICK; algorithm <= FUSION_MAHONY; algorithm++) {
		struct beside b = beside((enum fusion_algorithm)algorithm);
		struct vec3 apart, sigma, expected, accel_apart;

		for (int k = 0; k < 10 * RATE_HZ; k++) {
			run_beside(&b, moving, k, k + 1);
			apart = quat_to_rotation_vector(
				quat_multiply(b.other.fusion.q_nb, quat_conjugate(b.kalman.fusion.q_nb)));
			sigma = b.of_kalman.sigma.attitude_rad;
			expected = (struct vec3){sqrt(sigma.x * sigma.x + apart.x * apart.x + apart.y * apart.y),
				sqrt(sigma.y * sigma.y + apart.x * apart.x + apart.y * apart.y),
				sqrt(sigma.z * sigma.z + apart.z * apart.z)};
			assert_vec_near(b.of_other.sigma.attitude_rad, expected, 1e-9);
			accel_apart = vec3_sub(b.of_other.accel_n_m_s2, b.of_kalman.accel_n_m_s2);
			if (k < RATE_HZ)
				continue;
			sigma = b.of_other.sigma.accel_m_s2;
			assert_true(fabs(accel_apart.x) < 1.2 * sigma.x && fabs(accel_apart.y) < 1.2 * sigma.y &&
				    fabs(accel_apart.z) < 1.2 * sigma.z);
		}
	}
}

/* A bias of 10 deg/s is more than Madgwick's filter makes good; the Kalman filter finds it. */
static void test_an_attitude_that_is_known_to_be_wrong_is_not_valid(void **state)
{
	struct pipeline_config config = by_algorithm(FUSION_MADGWICK);
	struct pipeline p;
	bool was_valid = false;

	(void)state;
	config.uncalibrated = PIPELINE_UNCALIBRATED_GYRO;
	p = pipeline(&config);
	for (int k = 0; k < 20 * RATE_HZ; k++) {
		struct truth truth = standing(k);
		struct pipeline_output out;

		truth.sample.gyro_rad_s = (struct vec3){10 * RAD_PER_DEG, 0, 0};
		out = step(&p, &truth.sample);
		was_valid |= out.status & PIPELINE_VALID;
		if (quat_apart_rad(p.fusion.q_nb, truth.q_nb) > 35 * RAD_PER_DEG)
			assert_int_equal(out.status & PIPELINE_VALID, 0);
	}
	assert_true(was_valid);
	assert_true(quat_apart_rad(p.fusion.q_nb, standing(0).q_nb) > 35 * RAD_PER_DEG);
}

/* To another filter it goes on; back to the Kalman filter it is this one's again, without a rate from the jump. */
static void test_the_filter_is_changed_while_the_gateway_runs(void **state)
{
	(void)state;
	for (int algorithm = FUSION_MADGWICK; algorithm <= FUSION_MAHONY; algorithm++) {
		struct beside b = beside(FUSION_KALMAN);
		struct pipeline_config config = b.other.config;
		struct quat before;

		config.estimator.rates_from = RATES_FROM_ANGLES;
		assert_int_equal(pipeline_configure(&b.other, &config), 0);
		assert_int_equal(pipeline_configure(&b.kalman, &config), 0);
		run_beside(&b, moving, 0, 5 * RATE_HZ);
		before = b.other.fusion.q_nb;
		config.fusion.algorithm = (enum fusion_algorithm)algorithm;
		assert_int_equal(pipeline_configure(&b.other, &config), 0);
		assert_memory_equal(&b.other.fusion.q_nb, &before, sizeof(before));
		run_beside(&b, moving, 5 * RATE_HZ, 10 * RATE_HZ);
		config.fusion.algorithm = FUSION_KALMAN;
		assert_int_equal(pipeline_configure(&b.other, &config), 0);
		run_beside(&b, moving, 10 * RATE_HZ, 10 * RATE_HZ + 1);
		assert_memory_equal(&b.of_other.q_nb, &b.of_kalman.q_nb, sizeof(before));
		assert_vec_near(b.of_other.sigma.attitude_rad, b.of_kalman.sigma.attitude_rad, 0);
		assert_vec_near(b.of_other.rate_b_rad_s, b.of_kalman.rate_b_rad_s, 0.1);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_defaults_are_valid_at_any_rate),
		cmocka_unit_test(test_the_rigid_body_model_gives_the_reference_points_acceleration),
		cmocka_unit_test(test_the_auto_mode_corrects_with_a_good_gyro_and_not_with_a_very_noisy_one),
		cmocka_unit_test(test_attitude_and_acceleration_are_extrapolated_over_the_latency_to_the_time_stamp),
		cmocka_unit_test(test_no_accelerometer_is_faster_than_its_time_stamp),
		cmocka_unit_test(test_the_delay_of_the_acceleration_filter_is_reported),
		cmocka_unit_test(test_a_new_lever_arm_is_in_full_effect_with_the_next_sample),
		cmocka_unit_test(test_a_new_model_or_source_of_rates_has_no_transient),
		cmocka_unit_test(test_the_seeds_model_stays_bounded_through_gimbal_lock),
		cmocka_unit_test(test_at_rest_the_velocity_is_zero_and_the_position_stays),
		cmocka_unit_test(test_the_gyro_bias_is_estimated_at_rest),
		cmocka_unit_test(test_a_turn_faster_than_the_rest_threshold_is_not_estimated_as_bias),
		cmocka_unit_test(test_a_new_gyro_calibration_resets_the_bias_estimate),
		cmocka_unit_test(test_a_push_from_rest_is_integrated_and_the_position_can_be_reset),
		cmocka_unit_test(test_the_longest_integration_time_shows_in_the_status),
		cmocka_unit_test(test_values_that_no_sensor_measures_are_refused_and_counted),
		cmocka_unit_test(test_time_that_does_not_increase_is_refused_and_counted),
		cmocka_unit_test(test_a_short_gap_is_reported_once_and_not_integrated),
		cmocka_unit_test(test_ten_intervals_are_not_a_gap),
		cmocka_unit_test(test_a_gap_of_less_than_a_tenth_of_a_second_interrupts_nothing),
		cmocka_unit_test(test_a_gap_while_it_is_shaken_says_nothing_of_the_accelerometer),
		cmocka_unit_test(test_an_arm_that_loses_samples_is_within_its_sigmas),
		cmocka_unit_test(test_an_arm_that_picks_up_iron_is_within_the_sigma_of_its_heading),
		cmocka_unit_test(test_after_a_gap_rest_is_observed_for_its_time_again),
		cmocka_unit_test(test_after_a_long_gap_the_attitude_is_initialised_again),
		cmocka_unit_test(test_after_a_gap_sigma_covers_a_turn_that_nobody_saw),
		cmocka_unit_test(test_a_turn_that_begins_soon_after_the_start_is_no_bias),
		cmocka_unit_test(test_the_first_sample_has_its_sigma),
		cmocka_unit_test(test_a_discontinuity_starts_everything_over),
		cmocka_unit_test(test_a_magnetometer_lost_shows_in_the_status_after_a_second),
		cmocka_unit_test(test_the_jump_of_the_heading_to_the_first_north_is_not_an_angular_rate),
		cmocka_unit_test(test_a_mounting_set_before_the_first_sample_leaves_the_heading_at_zero),
		cmocka_unit_test(test_a_slow_sensor_keeps_its_attitude_between_samples),
		cmocka_unit_test(test_until_the_accelerometer_shows_gravity_nothing_is_valid),
		cmocka_unit_test(test_a_new_mounting_turns_the_object_and_not_the_world),
		cmocka_unit_test(test_a_live_change_of_anything_but_the_calibration_keeps_attitude_and_position),
		cmocka_unit_test(test_a_configuration_out_of_range_is_refused_as_a_whole),
		cmocka_unit_test(test_the_same_samples_give_the_same_bits),
		cmocka_unit_test(test_the_jump_of_a_heading_from_outside_is_not_an_angular_rate),
		cmocka_unit_test(test_rest_is_found_under_aided_yaws),
		cmocka_unit_test(test_the_first_aided_yaw_sets_the_heading_when_north_is_unknown),
		cmocka_unit_test(test_an_aided_yaw_takes_precedence_over_the_magnetometer),
		cmocka_unit_test(test_a_yaw_beyond_the_innovation_gate_is_rejected_and_the_fifth_in_a_row_applied),
		cmocka_unit_test(test_an_aided_yaw_is_weighed_by_its_sigma),
		cmocka_unit_test(test_a_set_attitude_is_exact_and_the_position_stays),
		cmocka_unit_test(test_an_attitude_set_before_the_first_sample_holds),
		cmocka_unit_test(test_an_aided_velocity_is_integrated_where_the_sensors_measure_rest),
		cmocka_unit_test(test_an_aided_velocity_keeps_a_long_acceleration_from_tilting_the_attitude),
		cmocka_unit_test(test_an_aided_velocity_is_that_of_the_reference_point),
		cmocka_unit_test(test_an_aid_out_of_range_is_refused_as_a_whole),
		cmocka_unit_test(test_an_aid_before_there_is_an_attitude_does_nothing),
		cmocka_unit_test(test_the_output_is_finite_for_any_input),
		cmocka_unit_test(test_a_recorded_hand_movement_is_followed_within_five_degrees),
		cmocka_unit_test(test_the_acceleration_sigma_includes_that_of_its_direction),
		cmocka_unit_test(test_sigma_is_honest_on_recorded_hand_movements),
		cmocka_unit_test(test_a_field_that_does_not_turn_with_the_object_is_a_bit_of_the_status),
		cmocka_unit_test(test_the_ranges_of_aids_include_their_limits),
		cmocka_unit_test(test_a_live_change_of_the_rate_filter_or_the_noise_gives_the_sigma_of_a_fresh_start),
		cmocka_unit_test(test_a_sensor_without_a_magnetometer_has_used_none_from_its_first_sample_on),
		cmocka_unit_test(test_samples_at_the_limits_of_the_plausible_are_used_on_every_axis),
		cmocka_unit_test(test_a_set_attitude_may_be_10_percent_off_unit_length),
		cmocka_unit_test(test_the_ranges_of_the_latency_include_their_limits),
		cmocka_unit_test(test_each_axis_of_the_acceleration_sigma_has_its_own_errors),
		cmocka_unit_test(test_between_measurements_of_the_field_the_last_one_is_reported),
		cmocka_unit_test(test_a_robot_at_rest_does_not_accelerate),
		cmocka_unit_test(test_the_extrapolation_over_the_latency_adds_no_noise_at_rest),
		cmocka_unit_test(test_a_temperature_in_a_sample_holds_until_the_next_one),
		cmocka_unit_test(test_the_auto_mode_with_a_useless_gyro_is_that_without_a_lever_arm),
		cmocka_unit_test(test_a_new_acceleration_filter_continues_from_the_last_output),
		cmocka_unit_test(test_fusion_and_navigation_use_the_users_limits_of_rest_latency_and_noise),
		cmocka_unit_test(test_a_new_gyro_bias_is_not_an_angular_acceleration),
		cmocka_unit_test(test_the_navigation_knows_attitude_and_gyro_bias_as_well_as_the_kalman_filter),
		cmocka_unit_test(test_the_centripetal_acceleration_of_a_long_turn_counts_in_the_sigma_of_the_tilt),
		cmocka_unit_test(test_another_filter_changes_neither_velocity_nor_position),
		cmocka_unit_test(test_the_sigma_of_another_filters_attitude_has_its_distance_from_the_kalman_filters),
		cmocka_unit_test(test_an_attitude_that_is_known_to_be_wrong_is_not_valid),
		cmocka_unit_test(test_the_filter_is_changed_while_the_gateway_runs),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
