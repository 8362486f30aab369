/* It stands, or it moves steadily: the navigation with nothing assumed, on motions whose truth is known here. The
 * sensor has the noise of the datasheets and a constant error of the accelerometer. */
#include "model_test.h"

#include <string.h>

#include "model/pipeline.h"

enum { RATE_HZ = 100 };

static const double G = 9.81, DT_S = 1.0 / RATE_HZ;

/* A speed that rises within ramp_s, stays and falls, from 10 s on, along one axis; the object turns about the
 * vertical. */
struct motion {
	struct vec3 axis_n;
	double speed_m_s, ramp_s, cruise_s, rate_rad_s, vibration_m_s2;
	enum motion_preset preset;
};

static const double KNOCK_S = 60;

struct run {
	struct pipeline pipeline;
	struct pipeline_output out;
	double way_m;	     /* true */
	double worst_sigmas; /* of the position, any axis, since 3 s */
	double beyond;	     /* share of the samples with an axis beyond 3 sigma */
};

static double acceleration(const struct motion *m, double t_s)
{
	double up = t_s - 10, down = up - m->ramp_s - m->cruise_s, a = m->speed_m_s / m->ramp_s * PI / 2;

	if (up > 0 && up < m->ramp_s)
		return a * sin(PI * up / m->ramp_s);
	return down > 0 && down < m->ramp_s ? -a * sin(PI * down / m->ramp_s) : 0;
}

/* knock_m_s: velocity along x that a knock at KNOCK_S leaves in the samples only. */
static struct run move_and_knock(const struct motion *m, double until_s, double knock_m_s)
{
	struct run run = {.way_m = 0};
	struct pipeline_config config = PIPELINE_DEFAULTS;
	const struct vec3 bias = {0.02, -0.015, 0.01};
	double v = 0, yaw = 0;
	int n = (int)lround(until_s * RATE_HZ), seen = 0;

	config.latency.sensor_s = config.latency.accelerometer_s = 0;
	config.position.navigation.preset = m->preset;
	assert_int_equal(pipeline_init(&run.pipeline, &config, RATE_HZ), 0);
	for (int k = 0; k < n; k++) {
		double t = k * DT_S, a = acceleration(m, t), sigmas;
		double rate = t > 10 && t < until_s - 5 ? m->rate_rad_s : 0;
		struct quat q = quat_from_rotation_vector((struct vec3){0, 0, yaw});
		struct vec3 force_n = vec3_add(vec3_scale(a, m->axis_n), (struct vec3){0, 0, G}), error, s;
		struct imu_sample sample = {.t_us = (uint64_t)(k * 10000) + 10000, .flags = SAMPLE_MAG};

		sample.accel_m_s2 = vec3_add(vec3_add(quat_rotate_inverse(q, force_n), bias), any_vec(0.025));
		if (v > 1e-3)
			sample.accel_m_s2.z += m->vibration_m_s2 * (sin(2 * PI * 7.3 * t) + sin(2 * PI * 17.1 * t));
		if (t > KNOCK_S && t < KNOCK_S + 0.5)
			sample.accel_m_s2.x += 2 * knock_m_s;
		sample.gyro_rad_s = vec3_add((struct vec3){0, 0, rate}, any_vec(0.1 * RAD_PER_DEG));
		sample.mag_uT = vec3_add(quat_rotate_inverse(q, (struct vec3){0, 20, -44}), any_vec(0.5));
		assert_int_equal(pipeline_step(&run.pipeline, &sample, &run.out), 0);
		error = vec3_sub(run.out.position_n_m, vec3_scale(run.way_m, m->axis_n));
		v += DT_S * a;
		run.way_m += DT_S * v;
		yaw += DT_S * rate;
		if (t < 3)
			continue;
		s = run.out.sigma.position_m;
		sigmas = fmax(fabs(error.x) / hypot(s.x, 1e-3),
			fmax(fabs(error.y) / hypot(s.y, 1e-3), fabs(error.z) / hypot(s.z, 1e-3)));
		run.worst_sigmas = fmax(run.worst_sigmas, sigmas);
		run.beyond += sigmas > 3;
		seen++;
	}
	run.beyond /= seen;
	return run;
}

static struct run move(const struct motion *m, double until_s)
{
	return move_and_knock(m, until_s, 0);
}

static double error_m(const struct run *r, const struct motion *m)
{
	return vec3_norm(vec3_sub(r->out.position_n_m, vec3_scale(r->way_m, m->axis_n)));
}

static bool stands(const struct run *r)
{
	return r->pipeline.position.navigation.still;
}

static void test_what_lies_stands_and_its_position_stays(void **state)
{
	const struct motion m = {.axis_n = {1, 0, 0}, .ramp_s = 1};
	struct run r = move(&m, 120);

	(void)state;
	assert_true(stands(&r));
	assert_true(error_m(&r, &m) < 0.01);
	assert_true(vec3_norm(r.out.sigma.position_m) < 0.02);
	assert_true(r.beyond < 0.02);
}

static void test_a_steady_drive_without_vibration_is_no_standstill(void **state)
{
	const double speeds_m_s[] = {0.05, 0.2, 1};

	(void)state;
	for (int i = 0; i < 3; i++) {
		const struct motion m = {{1, 0, 0}, speeds_m_s[i], 1, 10, 0, 0, MOTION_ANY};
		struct run r = move(&m, 18);

		assert_false(stands(&r));
		assert_true(error_m(&r, &m) < 0.3 + 0.1 * r.way_m);
		assert_true(r.beyond < 0.02);
	}
}

/* The start is seen some tenths of a second after it; the way until then is not lost. */
static void test_a_creeping_start_counts_from_its_first_moment(void **state)
{
	const struct motion m = {{0, 1, 0}, 0.1, 1, 10, 0, 0, MOTION_ANY};
	struct run r = move(&m, 12);

	(void)state;
	assert_false(stands(&r));
	assert_near(r.out.position_n_m.y, r.way_m, 0.02);
	assert_near(r.out.velocity_n_m_s.y, 0.1, 0.03);
}

static void test_a_lift_is_followed_with_its_preset(void **state)
{
	const struct motion m = {{0, 0, 1}, 2, 2, 4, 0, 0, MOTION_LINEAR_AXIS};
	struct run r = move(&m, 28);

	(void)state;
	assert_near(r.way_m, 12, 0.1);
	assert_true(stands(&r));
	assert_true(error_m(&r, &m) < 0.15);
	assert_true(r.beyond < 0.02);
}

static void test_a_turn_in_place_leaves_the_position_and_turns_the_heading(void **state)
{
	const double rates_deg_s[] = {0.5, 2, 20};

	(void)state;
	for (int i = 0; i < 3; i++) {
		const struct motion m = {.axis_n = {1, 0, 0}, .ramp_s = 1, .rate_rad_s = rates_deg_s[i] * RAD_PER_DEG};
		struct run r = move(&m, 40);
		double turned = remainder(r.out.angles_rad.z - 25 * m.rate_rad_s, 2 * PI);

		assert_true(error_m(&r, &m) < 0.1);
		assert_near(turned, 0, 2 * RAD_PER_DEG);
		assert_true(r.beyond < 0.02);
	}
}

/* A carrier that vibrates whenever it moves stands when the vibration ends, also after a long drive. */
static void test_the_end_of_the_vibration_is_a_standstill_of_what_vibrates_in_motion(void **state)
{
	const struct motion m = {{1, 0, 0}, 0.8, 1.5, 20, 0, 1, MOTION_ANY};
	struct run r = move(&m, 40);

	(void)state;
	assert_true(stands(&r));
	assert_true(r.worst_sigmas < 4);
	assert_true(error_m(&r, &m) < 3 * vec3_norm(r.out.sigma.position_m));
}

/* After a minute nobody can tell whether it has stopped: the position is the mean of both, its sigma says how far apart
 * they are. */
static void test_after_a_long_quiet_drive_sigma_says_that_it_may_have_stopped(void **state)
{
	const struct motion m = {{1, 0, 0}, 1, 1, 100, 0, 0, MOTION_ANY};
	struct run r = move(&m, 70);

	(void)state;
	assert_false(stands(&r));
	assert_true(r.beyond < 0.02);
	assert_true(vec3_norm(r.out.sigma.position_m) > error_m(&r, &m) / 3);
}

/* A knock that the sensor falsifies looks like the start of a drive that never ends, to a carrier that drives quietly.
 * Nobody drives so for minutes: it stands again, and sigma says where it may have gone. */
static void test_a_motion_that_was_none_ends_and_sigma_covers_it(void **state)
{
	const struct {
		enum motion_preset preset;
		double knock_m_s, until_s;
	} cases[] = {{MOTION_ANY, 0.06, 300}, {MOTION_ANY, 0.3, 300}, {MOTION_ROBOT_BASE, 0.15, 300},
		{MOTION_LINEAR_AXIS, 0.1, 400}};

	(void)state;
	for (int i = 0; i < 4; i++) {
		struct motion m = {{0, 1, 0}, 0.5, 1, 10, 0, 0, cases[i].preset};
		struct run r = move_and_knock(&m, KNOCK_S + 10, cases[i].knock_m_s);

		assert_false(stands(&r));
		r = move_and_knock(&m, KNOCK_S + cases[i].until_s, cases[i].knock_m_s);
		assert_true(stands(&r));
		assert_true(r.beyond < 0.02);
		assert_vec_near(r.out.velocity_n_m_s, ((struct vec3){0, 0, 0}), 0);
	}
}

/* .. but a lift of 90 s, or a cruise of two minutes, is one. */
static void test_a_quiet_motion_of_two_minutes_is_one(void **state)
{
	const struct motion motions[] = {{{0, 0, 1}, 1, 1, 90, 0, 0, MOTION_LINEAR_AXIS},
		{{1, 0, 0}, 0.3, 1, 120, 0, 0, MOTION_ANY}, {{1, 0, 0}, 2, 1, 120, 0, 0, MOTION_ROBOT_BASE}};

	(void)state;
	for (int i = 0; i < 3; i++) {
		double end_s = 10 + motions[i].cruise_s + 2 * motions[i].ramp_s;
		struct run r = move(&motions[i], end_s - 2);

		assert_false(stands(&r));
		r = move(&motions[i], end_s + 20);
		assert_true(r.beyond < 0.02);
	}
}

/* The object turns about its reference point, by angle_rad and back within 20 s, with the sensor at the end of a lever
 * arm; the reference point stands. */
static struct run turn_about(struct vec3 lever_b_m, double angle_rad)
{
	struct run run = {.way_m = 0};
	struct pipeline_config config = PIPELINE_DEFAULTS;
	const double w = 2 * PI / 20;

	config.latency.sensor_s = config.latency.accelerometer_s = 0;
	config.estimator.lever_arm_b_m = lever_b_m;
	assert_int_equal(pipeline_init(&run.pipeline, &config, RATE_HZ), 0);
	for (int k = 0; k < 50 * RATE_HZ; k++) {
		double t = k * DT_S, turning = t > 20 && t < 40, phase = w * (t - 20);
		double yaw = turning * angle_rad / 2 * (1 - cos(phase)),
		       rate = turning * angle_rad / 2 * w * sin(phase);
		const struct vec3 omega = {0, 0, rate}, alpha = {0, 0, turning * angle_rad / 2 * w * w * cos(phase)};
		struct vec3 at_lever =
			vec3_add(vec3_cross(alpha, lever_b_m), vec3_cross(omega, vec3_cross(omega, lever_b_m)));
		struct imu_sample sample = {.t_us = (uint64_t)(k * 10000) + 10000, .flags = SAMPLE_MAG};
		struct vec3 p, s;

		sample.accel_m_s2 = vec3_add(vec3_add(at_lever, (struct vec3){0.01, -0.02, G}), any_vec(0.025));
		sample.gyro_rad_s = vec3_add(omega, any_vec(0.35 * RAD_PER_DEG));
		sample.mag_uT = vec3_add(quat_rotate_inverse(quat_from_rotation_vector((struct vec3){0, 0, yaw}),
						 (struct vec3){0, 20, -44}),
			any_vec(0.5));
		assert_int_equal(pipeline_step(&run.pipeline, &sample, &run.out), 0);
		p = run.out.position_n_m;
		s = run.out.sigma.position_m;
		run.beyond += fabs(p.x) > 3 * hypot(s.x, 1e-3) || fabs(p.y) > 3 * hypot(s.y, 1e-3) ||
			      fabs(p.z) > 3 * hypot(s.z, 1e-3);
	}
	run.beyond /= 50 * RATE_HZ;
	return run;
}

/* The gyro's noise times the lever arm is no motion. */
static void test_the_reference_point_stands_at_the_end_of_a_lever_arm(void **state)
{
	const struct vec3 levers_b_m[] = {{0.05, 0, 0}, {0.5, 0, 0}, {5, 0, 0}, {0, -5, 0}, {0, 0, 5}};

	(void)state;
	for (int i = 0; i < 5; i++) {
		struct run r = turn_about(levers_b_m[i], 0);

		assert_true(stands(&r));
		assert_true(vec3_norm(r.out.position_n_m) < 0.02);
		assert_true(vec3_norm(r.out.sigma.position_m) < 0.05);
		assert_true(r.beyond < 0.02);
	}
}

/* .. and stays where it is while the object turns about it: what stands is that point, not the sensor. */
static void test_an_object_that_turns_about_its_reference_point_does_not_move_it(void **state)
{
	const struct vec3 levers_b_m[] = {{0.05, 0, 0}, {0.5, 0, 0}, {0, 5, 0}, {0, 0, 5}};
	const double angles_rad[] = {0.1, 2};

	(void)state;
	for (int i = 0; i < 8; i++) {
		struct run r = turn_about(levers_b_m[i % 4], angles_rad[i / 4]);

		assert_true(r.beyond < 0.02);
		assert_true(vec3_norm(r.out.position_n_m) < (i / 4 ? 5 : 0.5));
		assert_true(vec3_norm(r.out.sigma.position_m) < 6);
	}
}

/* One of five minutes is taken for a standstill in the end, and sigma covers that it was none. */
static void test_a_quiet_motion_that_is_taken_for_a_standstill_is_within_its_sigma(void **state)
{
	struct motion m = {{1, 0, 0}, 0.3, 2, 300, 0, 0, MOTION_LINEAR_AXIS};
	struct run r = move(&m, 300);

	(void)state;
	assert_true(stands(&r) && error_m(&r, &m) > 30); /* it was taken for one */
	assert_true(r.beyond < 0.02);
}

/* By dwell, as before the hypotheses: it moves to and fro, so what is steady stands. */
static void test_what_a_hand_holds_steadily_stands_whatever_its_velocity_seems_to_be(void **state)
{
	struct motion m = {{1, 0, 0}, 1, 1, 20, 0, 0, MOTION_HAND_HELD};
	struct run r = move(&m, 25);

	(void)state;
	assert_true(stands(&r));
	assert_true(error_m(&r, &m) > 5); /* which is why it is not the default */
	m.preset = MOTION_ANY;
	r = move(&m, 25);
	assert_false(stands(&r));
}

/* Density of the velocity v, if each axis has this variance. */
static double density(double v_m_s, double variance)
{
	return exp(-v_m_s * v_m_s / (2 * variance)) / pow(variance, 1.5);
}

/* Bayes: standing against a speed of any of the scales alike, none below the slowest of the preset
 * (model/README.md). */
static void test_the_odds_of_standing_are_those_of_the_velocity_against_the_speeds_that_the_preset_allows(void **state)
{
	const struct {
		enum motion_preset preset;
		double scales_m_s[4];
		bool stands_steady; /* only what is steady stands */
	} presets[] = {{MOTION_ANY, {0.03, 0.15, 0.7, 3}, false}, {MOTION_ROBOT_BASE, {0.1, 0.15, 0.7, 3}, false},
		{MOTION_LINEAR_AXIS, {0.3, 0.3, 0.7, 3}, true}, {MOTION_ARM, {0.03, 0.15, 0.7, 3}, false},
		{MOTION_VERTICAL_LIFT, {0.3, 0.3, 0.7, 3}, true}, {MOTION_HANGING_LOAD, {0.1, 0.15, 0.7, 3}, false}};
	const double sigma_m_s = 0.04, speeds_m_s[] = {0.06, 0.1, 0.14};

	(void)state;
	for (size_t i = 0; i < sizeof presets / sizeof *presets; i++)
		for (int j = 0; j < 3; j++) {
			struct navigation_config config = {
				.preset = presets[i].preset, .standstill = STANDSTILL_DEFAULTS, .rest_s = 1.5};
			const struct navigation_input in = {
				.force_b_m_s2 = {0, 0, G}, .q_nb = QUAT_IDENTITY, .gravity_m_s2 = G};
			double v = speeds_m_s[j], moves = 0, stands;
			struct navigation n = {.started = false};

			if (presets[i].stands_steady)
				config.standstill.time_s = 0;
			navigation_start(&n, &config, QUAT_IDENTITY);
			/* a rope counts with its own preset only, and that one with a rope only */
			n.stood = true;
			n.rope.given_m = presets[i].preset == MOTION_HANGING_LOAD ? 0 : 5;
			n.velocity_n_m_s = (struct vec3){v, 0, 0};
			for (int k = 0; k < NAVIGATION_STATES; k++)
				n.p[k][k] = k / 3 == NAVIGATION_V / 3 ? sigma_m_s * sigma_m_s : 0;
			for (int k = 0; k < 100 && n.zero_velocity.weight == 0; k++)
				navigation_step(&n, &in, 1e-3);
			for (int k = 0; k < 4; k++)
				moves += density(v, sigma_m_s * sigma_m_s +
							    presets[i].scales_m_s[k] * presets[i].scales_m_s[k]) /
					 4;
			if (presets[i].stands_steady)
				moves *= 0.01; /* steady: as rare as a quiet motion */
			stands = density(v, sigma_m_s * sigma_m_s);
			assert_near((1 - n.zero_velocity.weight) / n.zero_velocity.weight * stands / moves, 1, 0.15);
		}
}

/* A navigation that stands, with a fork that began t_s ago and has this velocity along an axis since. */
struct standing {
	struct navigation n;
	struct zero_velocity z;
};

static const struct zero_velocity_signals QUIET = {.steady = true};

static struct standing standing_with_fork(const struct noise_config *noise, double gyro_bias_sigma, double t_s)
{
	const struct navigation_config config = {
		.preset = MOTION_ANY, .standstill = STANDSTILL_DEFAULTS, .rest_s = 1.5, .noise = *noise};
	struct standing s = {.z = {.vibration_m2_s2 = 0}};
	struct zero_velocity_fork *fork = &s.z.forks[ZERO_VELOCITY_FORKS - 1];

	navigation_start(&s.n, &config, QUAT_IDENTITY);
	s.n.gravity_m_s2 = G;
	memset(s.n.p, 0, sizeof(s.n.p));
	for (int i = NAVIGATION_BG; i < NAVIGATION_BG + 3; i++)
		s.n.p[i][i] = gyro_bias_sigma * gyro_bias_sigma;
	assert_null(zero_velocity_stands(&s.z, &s.n, &QUIET, (struct vec3){0}, (struct vec3){0}, false, 0.1));
	assert_true(fork->set);
	fork->sums.t_s = t_s;
	for (int i = 0; i < 3; i++)
		fork->sums.s.m[i][i] = t_s;
	return s;
}

static bool begins(const struct standing *s, struct vec3 velocity_n_m_s, bool turning)
{
	struct standing copy = *s;

	copy.z.forks[ZERO_VELOCITY_FORKS - 1].velocity_n_m_s = velocity_n_m_s;
	return zero_velocity_stands(&copy.z, &copy.n, &QUIET, (struct vec3){0}, (struct vec3){0}, turning, 0.1) != NULL;
}

/* 0.75 s: what had begun to move when a fork was made has lost its velocity at that time. */
static void test_a_motion_counts_from_the_youngest_fork_that_is_older_than_its_beginning(void **state)
{
	static const struct noise_config noise = {.accel_density_m_s2_sqrt_hz = 0.002};

	(void)state;
	for (int young = 0; young < 2; young++) {
		struct standing s = standing_with_fork(&noise, 0, young ? 0.2 : 0.8);
		struct zero_velocity_fork *f = s.z.forks;

		f[0] = f[1] = f[2];
		f[1].sums.t_s += 0.75;
		f[0].sums.t_s += 1.5;
		f[0].velocity_n_m_s.x = f[1].velocity_n_m_s.x = f[2].velocity_n_m_s.x = 0.1;
		assert_ptr_equal(
			zero_velocity_stands(&s.z, &s.n, &QUIET, (struct vec3){0}, (struct vec3){0}, false, 0.04),
			young ? &f[1] : &f[2]);
	}
}

/* When the last one doubts that it stands: of 36 squared sigmas, at which it moves, 3 are noise. */
static void test_a_fork_begins_with_the_velocity_that_the_last_one_suspects(void **state)
{
	static const struct noise_config noise = {0};
	const double sigma = hypot(0.001, 0.002);

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct standing s = standing_with_fork(&noise, 0, 0.75);
		struct zero_velocity_fork *f = s.z.forks;
		const double chi2 = i ? 19.5 : 2.9, doubt = i ? 0.5 : 0;

		f[2].velocity_n_m_s.y = sigma * sqrt(chi2);
		assert_null(zero_velocity_stands(&s.z, &s.n, &QUIET, (struct vec3){0}, (struct vec3){0}, false, 0.04));
		assert_near(f[2].p[NAVIGATION_V + 1][NAVIGATION_V + 1], 1e-6 + doubt * chi2 * sigma * sigma, 1e-12);
		assert_near(f[2].p[NAVIGATION_V][NAVIGATION_V], 1e-6, 1e-12);
	}
}

/* A walk of its own, if it is worse than that of 2020h, and twice the instability of 2020h. */
static void test_what_stands_may_be_as_noisy_as_it_is_and_drift_by_its_instability(void **state)
{
	const struct noise_config noise = {.accel_density_m_s2_sqrt_hz = 0.002, .accel_bias_instability_m_s2 = 0.001};
	const double t = 1.4, walks[] = {0, 1e-5};

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct standing s = standing_with_fork(&noise, 0, t);
		const double walk = fmax(walks[i], 0.002 * 0.002 / 2);
		const double up = sqrt(0.001 * 0.001 + 0.002 * 0.002 + walk * t + pow(2 * 0.001 * t, 2));
		const struct zero_velocity_signals moved = {.steady = true, .accel_walk_m2_s3 = walks[i]};

		s.z.forks[ZERO_VELOCITY_FORKS - 1].velocity_n_m_s = (struct vec3){0, 0, 5.9 * up};
		assert_null(zero_velocity_stands(&s.z, &s.n, &moved, (struct vec3){0}, (struct vec3){0}, false, 0.1));
		s = standing_with_fork(&noise, 0, t);
		s.z.forks[ZERO_VELOCITY_FORKS - 1].velocity_n_m_s = (struct vec3){0, 0, 6.1 * up};
		assert_non_null(
			zero_velocity_stands(&s.z, &s.n, &moved, (struct vec3){0}, (struct vec3){0}, false, 0.1));
	}
}

/* sigma of the velocity of what stands for t_s: 1 mm/s at its begin, 2 mm/s by the support, the accelerometer's random
 * walk, and horizontally the tilt by the gyro's random walk and bias, times gravity, integrated. */
static void test_a_motion_begins_at_6_sigma_of_the_velocity_and_at_3_while_the_object_turns(void **state)
{
	const struct noise_config none = {.accel_density_m_s2_sqrt_hz = 0},
				  real = {.accel_density_m_s2_sqrt_hz = 0.003, .gyro_density_rad_s_sqrt_hz = 1e-3};
	const double bias = 5e-4;

	(void)state;
	for (int i = 0; i < 3; i++) {
		double t = i == 0 ? 0 : i == 1 ? 1 : 1.4;
		struct standing s = standing_with_fork(i ? &real : &none, i ? bias : 0, t);
		double up2 = 0.001 * 0.001 + 0.002 * 0.002 + (i ? 0.003 * 0.003 / 2 * t : 0);
		double level2 = up2 + (i ? G * G * (1e-3 * 1e-3 / 2 * t * t * t / 3 + bias * bias * pow(t, 4) / 4) : 0);

		for (int k = 0; k < 2; k++) {
			const bool turning = k;
			const double limit = turning ? 3 : 6;

			assert_false(begins(&s, (struct vec3){0.98 * limit * sqrt(level2), 0, 0}, turning));
			assert_true(begins(&s, (struct vec3){1.02 * limit * sqrt(level2), 0, 0}, turning));
			assert_false(begins(&s, (struct vec3){0, -0.98 * limit * sqrt(level2), 0}, turning));
			assert_true(begins(&s, (struct vec3){0, -1.02 * limit * sqrt(level2), 0}, turning));
			assert_false(begins(&s, (struct vec3){0, 0, 0.98 * limit * sqrt(up2)}, turning));
			assert_true(begins(&s, (struct vec3){0, 0, 1.02 * limit * sqrt(up2)}, turning));
		}
	}
}

/* A chi-squared value of 3 is that of what stands; the limit, 36, that of what moves. The way of the fork counts in
 * between. */
static void test_a_way_that_may_be_one_makes_the_position_less_certain(void **state)
{
	const struct noise_config none = {.accel_density_m_s2_sqrt_hz = 0};
	const double chi2[] = {2.9, 3 + 0.25 * 33, 3 + 0.75 * 33}, doubts[] = {0, 0.25, 0.75};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct standing s = standing_with_fork(&none, 0, 0);

		s.z.forks[ZERO_VELOCITY_FORKS - 1].velocity_n_m_s.x = sqrt(chi2[i] * (0.001 * 0.001 + 0.002 * 0.002));
		s.z.forks[ZERO_VELOCITY_FORKS - 1].position_n_m = vec3_add(s.n.position_n_m, (struct vec3){1, -2, 3});
		assert_null(zero_velocity_stands(&s.z, &s.n, &QUIET, (struct vec3){0}, (struct vec3){0}, false, 0.1));
		assert_vec_near(s.z.position_variance_m2, vec3_scale(doubts[i], (struct vec3){1, 4, 9}), 1e-6);
	}
}

/* Velocity of vibration: the acceleration through the integrator with a time constant of 30 ms, behind a high-pass of
 * 0.1 s. */
static void test_vibration_is_the_velocity_above_5_hz(void **state)
{
	const double frequencies_hz[] = {0.5, 5, 20}, dt_s = 1e-4;

	(void)state;
	for (int i = 0; i < 3; i++) {
		const double w = 2 * PI * frequencies_hz[i];
		const double gain = 0.03 / hypot(1, 0.03 * w) * 0.1 * w / hypot(1, 0.1 * w);
		struct zero_velocity z = {.vibration_m2_s2 = 0};
		double t = 0, mean = 0, later;

		for (; t < 4; t += dt_s) {
			zero_velocity_vibration(&z, (struct vec3){sin(w * t), 0, 2 * cos(w * t)}, 0, dt_s);
			mean += t < 2 ? 0 : z.vibration_m2_s2 * dt_s / 2;
		}
		assert_near(mean / (5 * gain * gain / 2), 1, 0.02);
		z.vibration_n_m_s = z.accel_low_n_m_s2 = (struct vec3){0};
		later = z.vibration_m2_s2 * exp(-1);
		for (t = 0; t < 0.3; t += dt_s) /* it is forgotten with a time constant of 0.3 s */
			zero_velocity_vibration(&z, (struct vec3){0}, 0, dt_s);
		assert_near(z.vibration_m2_s2 / later, 1, 0.02);
	}
}

/* ---- it moves ---- */

/* A navigation that knows its velocity with this sigma, and nothing else can have changed it. */
static struct standing moving_with(double sigma_m_s)
{
	const struct navigation_config config = {
		.preset = MOTION_ANY, .standstill = STANDSTILL_DEFAULTS, .rest_s = 1.5};
	struct standing s = {.z = {.quiet_accel2_m2_s4 = 1e-4, .quiet_gyro2_rad2_s2 = 1e-6}};

	navigation_start(&s.n, &config, QUAT_IDENTITY);
	memset(s.n.p, 0, sizeof(s.n.p));
	for (int i = NAVIGATION_V; i < NAVIGATION_V + 3; i++)
		s.n.p[i][i] = sigma_m_s * sigma_m_s;
	return s;
}

static const struct zero_velocity_signals NOISY = {.steady = false};

/* Weight of standing after 0.1 s more. */
static double weight_of(struct standing *s, const struct zero_velocity_signals *signals, double velocity_m_s)
{
	zero_velocity_moves(&s->z, &s->n, signals, (struct vec3){velocity_m_s, 0, 0}, 0.03, false, 0.1);
	return s->z.weight;
}

/* Odds of standing in a quiet moment: as often as it has moved quietly, of which one in a hundred of a second is
 * assumed at first; at least one in 400. */
static void test_a_quiet_moment_is_a_standstill_as_far_as_motions_of_this_carrier_were_not_quiet(void **state)
{
	const struct {
		double moved_s, quietly_s, share;
	} cases[] = {{0, 0, 0.01}, {9, 9, 9.01 / 10}, {9, 4, 4.01 / 10}, {99, 0, 0.0025}};

	(void)state;
	for (int i = 0; i < 4; i++) {
		struct standing s = moving_with(0.04), noisy;

		s.z.moved_s = cases[i].moved_s;
		s.z.moved_quietly_s = cases[i].quietly_s;
		noisy = s;
		double odds = 1 / weight_of(&noisy, &NOISY, 0.2) - 1;
		assert_near(1 / weight_of(&s, &QUIET, 0.2) - 1, odds * cases[i].share * exp(-0.1 / 60), 1e-6 * odds);
	}
}

/* Quiet is up to three times the mean squares of what stood, and (0.02 deg/s)^2 more of the gyro. */
static void test_a_moment_is_quiet_up_to_three_times_the_mean_squares_of_a_standstill(void **state)
{
	const struct {
		bool steady;
		double gyro2_rad2_s2, accel2_m2_s4;
		bool quiet;
	} cases[] = {{true, 2.9e-6, 2.9e-4, true}, {true, 0, 3.1e-4, false}, {true, 3.05e-6, 0, true},
		{true, 3.15e-6, 0, false}, {false, 0, 0, false}};

	(void)state;
	for (int i = 0; i < 5; i++) {
		struct standing s = moving_with(0.04), noisy = s;
		double odds = 1 / weight_of(&noisy, &NOISY, 0.2) - 1;
		const struct zero_velocity_signals signals = {.steady = cases[i].steady,
			.gyro2_rad2_s2 = cases[i].gyro2_rad2_s2,
			.accel2_m2_s4 = cases[i].accel2_m2_s4};

		assert_near(1 / weight_of(&s, &signals, 0.2) - 1, odds * (cases[i].quiet ? 0.01 * exp(-0.1 / 60) : 1),
			1e-6 * odds);
	}
}

/* A load that swings is quiet, and so are the moments in which its velocity passes zero. */
static void test_a_motion_that_accelerates_quietly_may_move_on_quietly(void **state)
{
	const struct zero_velocity_signals smooth = {.steady = true, .accelerates = true},
					   rough = {.steady = false, .accelerates = true};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct standing s = moving_with(0.04);

		for (int k = 0; k < 20; k++) /* slower than 0.04 m/s it may stand, for all that is known */
			assert_near(weight_of(&s, k % 2 ? &smooth : &rough, i ? 0.2 * i : 0.01), 0, 0);
		assert_near(s.z.moved_s, i ? 2 : 0, 1e-9);
		assert_near(s.z.moved_quietly_s, i ? 1 : 0, 1e-9);
	}
}

/* What swings passes the moment at which it stands, with an acceleration that changes all the time. */
static void test_what_stands_feels_the_same_force_all_the_time(void **state)
{
	const double change_m_s2[] = {0, 0.09, 0.11};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct standing s = moving_with(0.001);
		struct zero_velocity_signals signals = {
			.steady = true, .force_n_m_s2 = {0.3, 0, G}, .force_change2_m2_s4 = 0.1 * 0.1};

		for (int k = 0; k < 3; k++)
			assert_true(weight_of(&s, &signals, 0) > 0.95);
		assert_near(s.z.standing_s, 0.3, 1e-9);
		signals.force_n_m_s2.y = change_m_s2[i];
		weight_of(&s, &signals, 0);
		assert_near(s.z.standing_s, i < 2 ? 0.4 : 0.1, 1e-9);
		weight_of(&s, &signals, 0); /* from here on it stands, with that force */
		assert_near(s.z.standing_s, i < 2 ? 0.5 : 0.2, 1e-9);
	}
}

/* Without an acceleration a motion cannot end: the odds hold while sigma grows, and are forgotten within 20 s. A change
 * of the velocity by three times 0.01 m/s is an acceleration. */
static void test_the_odds_of_moving_hold_until_the_velocity_changes(void **state)
{
	const double changes_m_s[] = {0, 0.029, 0.031};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct standing s = moving_with(0.04), fresh = moving_with(0.1);
		double odds = 1 / weight_of(&s, &NOISY, 0.2) - 1, v = 0.2 - changes_m_s[i];
		double now = 1 / weight_of(&fresh, &NOISY, v) - 1;

		s.n = fresh.n;
		assert_near((1 / weight_of(&s, &NOISY, v) - 1) / (i < 2 ? odds * (1 - 0.1 / 20) : now), 1, 1e-6);
	}
}

/* After missing samples the odds of moving are as they were, or at least 50, however unknown the velocity has become
 * and however quiet it is. */
static void test_what_moved_before_missing_samples_still_does(void **state)
{
	(void)state;
	for (int i = 0; i < 2; i++) {
		struct standing s = moving_with(0.04), unknown = moving_with(2);
		const double v = i ? 0.1 : 0.4;
		double odds = 1 / weight_of(&s, &NOISY, v) - 1, after;

		assert_true(i ? odds < 40 : odds > 1000);
		s.n = unknown.n;
		zero_velocity_skip(&s.z, false);
		after = (1 / weight_of(&s, &QUIET, v) - 1) / (1 - 0.1 / 20) / exp(-0.1 / 60);
		assert_true(i ? fabs(after / odds - 1) < 1e-6 : after > 50);
	}
}

/* What stood before missing samples, and is steady after them, stands; what is unsteady for 0.4 s may as well move. */
static void test_what_stood_before_missing_samples_stands_while_it_is_steady(void **state)
{
	const struct zero_velocity_signals unsteady = {.steady = false};
	struct standing s = moving_with(0.4), moves;

	(void)state;
	s.z.moved_quietly_s = s.z.moved_s = 100; /* it is known to cruise quietly */
	zero_velocity_skip(&s.z, true);
	moves = s;
	assert_true(weight_of(&s, &QUIET, 0.1) > 0.98);
	for (int k = 0; k < 5; k++)
		weight_of(&moves, &unsteady, 0.1);
	assert_true(weight_of(&moves, &QUIET, 0.1) < 0.8);
}

/* To 1 / e within a minute: what is as quiet as it stood moves by 100000 to 1 at most. A moment that is not quiet
 * begins anew. */
static void test_the_odds_of_a_quiet_motion_fall_with_its_time(void **state)
{
	const double share = 0.01;

	(void)state;
	for (int far = 0; far < 2; far++) {
		struct standing s = moving_with(0.04);
		double v = far ? 0.6 : 0.2, odds = 1 / weight_of(&s, &NOISY, v) - 1;

		s = moving_with(0.04);
		s.z.moved_s = 1e9; /* nothing more is learnt */
		s.z.moved_quietly_s = 1e9 * share;
		odds = fmin(odds, 1e5) * share;
		for (int k = 1; k <= 3000; k++) {
			double weight = weight_of(&s, &QUIET, v);

			if (k % 100 == 0)
				assert_near(1 / weight - 1, odds * exp(-0.1 * k / 60), 1e-5 * odds);
		}
		weight_of(&s, &NOISY, v);
		assert_near(1 / weight_of(&s, &QUIET, v) - 1, odds * exp(-0.1 / 60), 1e-4 * odds);
	}
}

/* What was quiet before the standstill was part of it. */
static void test_a_quiet_time_that_ends_in_a_standstill_was_no_motion_to_learn_from(void **state)
{
	struct standing s = moving_with(0.01);

	(void)state;
	for (int k = 0; k < 50; k++) {
		weight_of(&s, &NOISY, 1);
		weight_of(&s, &NOISY, 1);
	}
	for (int k = 0; k < 30; k++)
		weight_of(&s, &QUIET, 1);
	assert_near(s.z.moved_s, 13, 1e-6);
	assert_near(s.z.moved_quietly_s, 3, 1e-6);
	zero_velocity_settle(&s.z);
	assert_near(s.z.moved_s, 10, 1e-6);
	assert_near(s.z.moved_quietly_s, 0, 1e-6);
}

static void test_a_motion_that_has_just_begun_is_ten_times_as_likely_as_a_standstill(void **state)
{
	struct standing s = moving_with(0.04);

	(void)state;
	zero_velocity_restart(&s.z, true);
	assert_near(1 / weight_of(&s, &NOISY, 0) - 1, 10 * (1 - 0.1 / 20), 1e-9);
}

/* Above a weight of 0.95 it stands; below 0.05 its motion is one to learn from. */
static void test_it_stands_above_a_weight_of_0_95_and_moves_below_0_05(void **state)
{
	(void)state;
	for (double v = 0; v < 0.3; v += 0.001) {
		struct standing s = moving_with(0.04);
		double weight = weight_of(&s, &NOISY, v);

		assert_near(s.z.standing_s, weight > 0.95 ? 0.1 : 0, 0);
		assert_near(s.z.moved_s, weight < 0.05 ? 0.1 : 0, 0);
		assert_near(s.z.moved_quietly_s, 0, 0);
		s = moving_with(0.04);
		weight = weight_of(&s, &QUIET, v);
		assert_near(s.z.moved_quietly_s, weight < 0.05 ? 0.1 : 0, 0);
	}
}

static void assert_nothing_is_mixed(const struct zero_velocity *z)
{
	const struct vec3 zero = {0, 0, 0};

	assert_near(z->weight, 0, 0);
	assert_near(z->standing_s, 0, 0);
	assert_vec_near(z->position_shift_n_m, zero, 0);
	assert_vec_near(z->velocity_shift_n_m_s, zero, 0);
	assert_vec_near(z->position_variance_m2, zero, 0);
	assert_vec_near(z->velocity_variance_m2_s2, zero, 0);
}

/* What stands, and what begins again after missing samples or a new attitude. */
static void test_there_is_no_second_hypothesis_of_what_is_known_to_stand_or_begins_again(void **state)
{
	(void)state;
	for (int i = 0; i < 5; i++) {
		struct standing s = moving_with(0.01);

		for (int k = 0; k < 10; k++)
			weight_of(&s, &NOISY, 0.002);
		assert_true(s.z.weight > 0.5 && s.z.standing_s > 0);
		assert_true(vec3_norm(s.z.velocity_shift_n_m_s) > 0);
		if (i == 0)
			assert_null(zero_velocity_stands(
				&s.z, &s.n, &QUIET, (struct vec3){0}, (struct vec3){0}, false, 0.1));
		else if (i < 3)
			zero_velocity_restart(&s.z, i == 1);
		else if (i == 3)
			zero_velocity_skip(&s.z, false);
		else
			zero_velocity_moves(&s.z, &s.n, &NOISY, (struct vec3){0.2, 0, 0}, 0.03, true, 0.1); /* known */
		assert_nothing_is_mixed(&s.z);
	}
}

/* Of two states, the one that moves and the one after a measurement of zero velocity with 2 mm/s, by their weights. */
static void test_position_and_velocity_are_the_moments_of_the_mixture(void **state)
{
	const double velocity[3] = {0.03, -0.02, 0.05}, own[3] = {0.05, 0.04, 0.06}, position_of[3] = {0.3, -0.2, 0.5};

	(void)state;
	for (int far = 0; far < 2; far++) {
		struct standing s = moving_with(0.04);
		double w;

		for (int i = 0; i < 3; i++) {
			const int v = NAVIGATION_V + i, p = NAVIGATION_P + i;

			s.n.p[v][v] = own[i] * own[i];
			s.n.p[p][v] = s.n.p[v][p] = position_of[i] * s.n.p[v][v];
			s.n.p[p][p] = 1;
		}
		zero_velocity_moves(&s.z, &s.n, &NOISY,
			vec3_scale(far ? 20 : 1, (struct vec3){velocity[0], velocity[1], velocity[2]}), 0.03, false,
			0.1);
		w = s.z.weight;
		assert_true(far ? w < 0.001 : w > 0.1 && w < 0.99);
		for (int i = 0; i < 3; i++) {
			double gain = own[i] * own[i] / (own[i] * own[i] + 0.002 * 0.002), by = -gain * velocity[i];
			double less = gain * own[i] * own[i], c = position_of[i];

			if (far) /* the motion alone */
				w = by = less = 0;
			assert_near((&s.z.velocity_shift_n_m_s.x)[i], w * by, 1e-9);
			assert_near((&s.z.position_shift_n_m.x)[i], w * c * by, 1e-9);
			assert_near((&s.z.velocity_variance_m2_s2.x)[i], w * (1 - w) * by * by - w * less, 1e-9);
			assert_near((&s.z.position_variance_m2.x)[i], w * (1 - w) * c * c * by * by - w * c * c * less,
				1e-9);
		}
	}
}

/* The navigation's own sigma of the gyro's bias is that of a calibration, until it has stood; the fusion may know
 * better. */
static void test_a_gyro_bias_is_as_uncertain_as_the_fusion_says_axis_by_axis_before_the_first_standstill(void **state)
{
	const struct navigation_config config = {
		.preset = MOTION_ANY, .standstill = STANDSTILL_DEFAULTS, .rest_s = 1.5};
	const struct navigation_input in = {.force_b_m_s2 = {0, 0, G + 1},
		.q_nb = QUAT_IDENTITY,
		.gravity_m_s2 = G,
		.gyro_bias_variance_rad2_s2 = {1e-4, 4e-4, 9e-4}};
	struct navigation n = {.started = false};

	(void)state;
	navigation_start(&n, &config, QUAT_IDENTITY);
	for (int k = 0; k < 10; k++)
		navigation_step(&n, &in, DT_S);
	for (int i = 0; i < 3; i++)
		assert_near(sqrt(n.p[NAVIGATION_BG + i][NAVIGATION_BG + i]), 0.01 * (i + 1), 1e-4);
}

/* Over any split of the samples: sums(a then b) = append(sums(a), sums(b)). */
static void test_sums_of_parts_append_to_the_sums_of_all(void **state)
{
	struct navigation_sums all = {.t_s = 0}, first = {.t_s = 0}, second = {.t_s = 0};
	const double *x = &all.t_s, *y = &first.t_s;

	(void)state;
	for (int k = 0; k < 20; k++) {
		struct mat3 r = mat3_from_quat(any_attitude());
		struct vec3 omega = any_vec(2), force = any_vec(15), accel = any_vec(5);

		navigation_sums_add(&all, &r, omega, force, accel, 0.01);
		navigation_sums_add(k < 7 ? &first : &second, &r, omega, force, accel, 0.01);
	}
	navigation_sums_append(&first, &second);
	for (size_t i = 0; i < sizeof(all) / sizeof(double); i++)
		assert_near(x[i], y[i], 1e-12);
}

/* The first steady interval counts in full, of later ones all quantities take the same share. */
static void test_what_is_quiet_is_the_mean_of_the_steady_intervals_at_a_standstill(void **state)
{
	static const struct noise_config noise = {.accel_density_m_s2_sqrt_hz = 0.002};
	struct zero_velocity_signals signals = {
		.steady = true, .gyro2_rad2_s2 = 1e-6, .accel2_m2_s4 = 1e-4, .accel_walk_m2_s3 = 1e-5};
	struct standing s = standing_with_fork(&noise, 0, 0.1);
	double followed;

	(void)state;
	s.z.quiet_accel2_m2_s4 = s.z.quiet_gyro2_rad2_s2 = s.z.accel_walk_m2_s3 = 0;
	for (int step = 0; step < 2; step++) {
		zero_velocity_stands(&s.z, &s.n, &signals, (struct vec3){0}, (struct vec3){0}, false, 0.1);
		assert_near(s.z.quiet_gyro2_rad2_s2, 1e-6, 1e-18);
		assert_near(s.z.quiet_accel2_m2_s4, 1e-4, 1e-16);
		assert_near(s.z.accel_walk_m2_s3, 1e-5, 1e-17);
	}
	signals = (struct zero_velocity_signals){
		.steady = true, .gyro2_rad2_s2 = 2e-6, .accel2_m2_s4 = 2e-4, .accel_walk_m2_s3 = 2e-5};
	zero_velocity_stands(&s.z, &s.n, &signals, (struct vec3){0}, (struct vec3){0}, false, 0.1);
	followed = s.z.quiet_accel2_m2_s4 / 1e-4 - 1;
	assert_near(followed, 0.1, 1e-9); /* 0.1 s of a second */
	assert_near(s.z.quiet_gyro2_rad2_s2 / 1e-6 - 1, followed, 1e-9);
	assert_near(s.z.accel_walk_m2_s3 / 1e-5 - 1, followed, 1e-9);
	signals.steady = false;
	zero_velocity_stands(&s.z, &s.n, &signals, (struct vec3){0}, (struct vec3){0}, false, 0.1);
	assert_near(s.z.quiet_accel2_m2_s4 / 1e-4 - 1, followed, 1e-9);
}

/* The odds and what they rest on are forgotten, what is known of the sensors and of the carrier's motions is not. A
 * standstill takes back that the quiet time before it was a motion. */
static void test_a_restart_forgets_the_odds_and_a_standstill_what_was_quiet_before_it(void **state)
{
	const struct vec3 one = {1, 2, 3}, zero = {0, 0, 0};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct zero_velocity z = {.weight = 0.5,
			.standing_s = 1,
			.quiet_s = 4,
			.least_odds = 7,
			.moved_s = 100,
			.moved_quietly_s = 10,
			.quiet_gyro2_rad2_s2 = 1e-6,
			.quiet_accel2_m2_s4 = 1e-4,
			.vibration_m2_s2 = 1e-2,
			.position_shift_n_m = one,
			.velocity_shift_n_m_s = one,
			.position_variance_m2 = one,
			.velocity_variance_m2_s2 = one};

		for (int k = 0; k < ZERO_VELOCITY_FORKS; k++)
			z.forks[k].set = true;
		if (i < 2)
			zero_velocity_restart(&z, i == 1);
		else
			zero_velocity_settle(&z);
		for (int k = 0; k < ZERO_VELOCITY_FORKS; k++)
			assert_false(z.forks[k].set);
		assert_true(z.weight == 0 && z.standing_s == 0 && z.quiet_s == 0);
		assert_near(z.least_odds, i == 1 ? 10 : 0, 0); /* what has begun to move does so, ten to one */
		assert_vec_near(z.position_shift_n_m, zero, 0);
		assert_vec_near(z.velocity_shift_n_m_s, zero, 0);
		assert_vec_near(z.position_variance_m2, zero, 0);
		assert_vec_near(z.velocity_variance_m2_s2, zero, 0);
		assert_near(z.moved_s, i == 2 ? 96 : 100, 0);
		assert_near(z.moved_quietly_s, i == 2 ? 6 : 10, 0);
		assert_true(z.quiet_gyro2_rad2_s2 == 1e-6 && z.quiet_accel2_m2_s4 == 1e-4 && z.vibration_m2_s2 == 1e-2);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_what_lies_stands_and_its_position_stays),
		cmocka_unit_test(test_a_steady_drive_without_vibration_is_no_standstill),
		cmocka_unit_test(test_a_creeping_start_counts_from_its_first_moment),
		cmocka_unit_test(test_a_lift_is_followed_with_its_preset),
		cmocka_unit_test(test_a_turn_in_place_leaves_the_position_and_turns_the_heading),
		cmocka_unit_test(test_the_end_of_the_vibration_is_a_standstill_of_what_vibrates_in_motion),
		cmocka_unit_test(test_after_a_long_quiet_drive_sigma_says_that_it_may_have_stopped),
		cmocka_unit_test(test_a_motion_that_was_none_ends_and_sigma_covers_it),
		cmocka_unit_test(test_a_quiet_motion_of_two_minutes_is_one),
		cmocka_unit_test(test_a_quiet_motion_that_is_taken_for_a_standstill_is_within_its_sigma),
		cmocka_unit_test(test_the_reference_point_stands_at_the_end_of_a_lever_arm),
		cmocka_unit_test(test_an_object_that_turns_about_its_reference_point_does_not_move_it),
		cmocka_unit_test(test_what_a_hand_holds_steadily_stands_whatever_its_velocity_seems_to_be),
		cmocka_unit_test(
			test_the_odds_of_standing_are_those_of_the_velocity_against_the_speeds_that_the_preset_allows),
		cmocka_unit_test(
			test_a_gyro_bias_is_as_uncertain_as_the_fusion_says_axis_by_axis_before_the_first_standstill),
		cmocka_unit_test(test_a_motion_counts_from_the_youngest_fork_that_is_older_than_its_beginning),
		cmocka_unit_test(test_a_fork_begins_with_the_velocity_that_the_last_one_suspects),
		cmocka_unit_test(test_what_stands_may_be_as_noisy_as_it_is_and_drift_by_its_instability),
		cmocka_unit_test(test_a_motion_begins_at_6_sigma_of_the_velocity_and_at_3_while_the_object_turns),
		cmocka_unit_test(test_a_way_that_may_be_one_makes_the_position_less_certain),
		cmocka_unit_test(test_vibration_is_the_velocity_above_5_hz),
		cmocka_unit_test(test_a_quiet_moment_is_a_standstill_as_far_as_motions_of_this_carrier_were_not_quiet),
		cmocka_unit_test(test_a_moment_is_quiet_up_to_three_times_the_mean_squares_of_a_standstill),
		cmocka_unit_test(test_a_motion_that_accelerates_quietly_may_move_on_quietly),
		cmocka_unit_test(test_what_stands_feels_the_same_force_all_the_time),
		cmocka_unit_test(test_the_odds_of_moving_hold_until_the_velocity_changes),
		cmocka_unit_test(test_what_moved_before_missing_samples_still_does),
		cmocka_unit_test(test_what_stood_before_missing_samples_stands_while_it_is_steady),
		cmocka_unit_test(test_the_odds_of_a_quiet_motion_fall_with_its_time),
		cmocka_unit_test(test_a_quiet_time_that_ends_in_a_standstill_was_no_motion_to_learn_from),
		cmocka_unit_test(test_a_motion_that_has_just_begun_is_ten_times_as_likely_as_a_standstill),
		cmocka_unit_test(test_there_is_no_second_hypothesis_of_what_is_known_to_stand_or_begins_again),
		cmocka_unit_test(test_position_and_velocity_are_the_moments_of_the_mixture),
		cmocka_unit_test(test_it_stands_above_a_weight_of_0_95_and_moves_below_0_05),
		cmocka_unit_test(test_sums_of_parts_append_to_the_sums_of_all),
		cmocka_unit_test(test_what_is_quiet_is_the_mean_of_the_steady_intervals_at_a_standstill),
		cmocka_unit_test(test_a_restart_forgets_the_odds_and_a_standstill_what_was_quiet_before_it),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
