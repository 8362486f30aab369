/* Position by the error-state Kalman filter: its sums and covariance against plain calculations, its position against
 * simulated truth. */
#include "model_test.h"

#include <stdio.h>
#include <string.h>

#include "model/pipeline.h"
#include "model/position.h"
#include "model/sim/sensor.h"

enum { N = NAVIGATION_STATES };

static const double DT_S = 0.005, G = 9.81;
static const struct vec3 ZERO = {0, 0, 0};
/* Standstills by dwell, no levelling. */
static const struct navigation_config BARE = {.preset = MOTION_FOOT, .standstill = STANDSTILL_DEFAULTS, .rest_s = 1.5};

static struct navigation_config levelling(void)
{
	struct navigation_config config = BARE;

	config.levelling = 1;
	config.noise = (struct noise_config){.angle_sigma_rad = 0.001,
		.gyro_density_rad_s_sqrt_hz = 0.03 * RAD_PER_DEG,
		.gyro_bias_instability_rad_s = 0.01 * RAD_PER_DEG,
		.accel_density_m_s2_sqrt_hz = 220e-6 * G,
		.accel_bias_instability_m_s2 = 1e-4 * G,
		.mag_sigma_uT = 0.5};
	return config;
}

static struct navigation_input any_input(struct quat q_nb)
{
	struct navigation_input in = {.gyro_b_rad_s = any_vec(3), .force_b_m_s2 = any_vec(15), .q_nb = q_nb};

	in.gravity_m_s2 = G;
	return in;
}

/* ---- the sums are the derivatives
 * --------------------------------------------------------------------------------- */

enum { SAMPLES = 7 };

static struct navigation integrated(struct navigation n, const struct navigation_input *in)
{
	for (int k = 0; k < SAMPLES; k++)
		navigation_step(&n, &in[k], DT_S);
	return n;
}

/* The state with an error of `size` in component i. */
static struct navigation with_error(struct navigation n, int i, double size)
{
	struct vec3 turn = ZERO;
	double *const at[N] = {&turn.x, &turn.y, &turn.z, &n.velocity_n_m_s.x, &n.velocity_n_m_s.y, &n.velocity_n_m_s.z,
		&n.position_n_m.x, &n.position_n_m.y, &n.position_n_m.z, &n.gyro_bias_b_rad_s.x, &n.gyro_bias_b_rad_s.y,
		&n.gyro_bias_b_rad_s.z, &n.accel_bias_b_m_s2.x, &n.accel_bias_b_m_s2.y, &n.accel_bias_b_m_s2.z};

	*at[i] += size;
	n.q_nb = quat_multiply(quat_from_rotation_vector(turn), n.q_nb);
	return n;
}

static void error_of(const struct navigation *true_, const struct navigation *n, double size, double e[9])
{
	struct quat d = quat_multiply(true_->q_nb, quat_conjugate(n->q_nb));
	struct vec3 v = vec3_sub(true_->velocity_n_m_s, n->velocity_n_m_s);
	struct vec3 p = vec3_sub(true_->position_n_m, n->position_n_m);
	const double all[9] = {2 * d.x, 2 * d.y, 2 * d.z, v.x, v.y, v.z, p.x, p.y, p.z};

	for (int i = 0; i < 9; i++)
		e[i] = all[i] / size;
}

static void block(double f[N][N], int row, int column, double sign, const struct mat3 *m)
{
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			f[row + i][column + j] = sign * m->m[i][j];
}

static struct mat3 cross(struct vec3 a)
{
	return (struct mat3){{{0, -a.z, a.y}, {a.z, 0, -a.x}, {-a.y, a.x, 0}}};
}

/* The state transition as navigation_sums.h writes it. */
static void transition(const struct navigation_sums *s, double f[N][N])
{
	struct mat3 f_cross = cross(s->f), ff_cross = cross(s->ff);

	memset(f, 0, sizeof(double[N][N]));
	for (int i = 0; i < N; i++)
		f[i][i] = 1;
	block(f, NAVIGATION_THETA, NAVIGATION_BG, -1, &s->s);
	block(f, NAVIGATION_V, NAVIGATION_THETA, -1, &f_cross);
	block(f, NAVIGATION_V, NAVIGATION_BG, 1, &s->v);
	block(f, NAVIGATION_V, NAVIGATION_BA, -1, &s->s);
	block(f, NAVIGATION_P, NAVIGATION_THETA, -1, &ff_cross);
	block(f, NAVIGATION_P, NAVIGATION_BG, 1, &s->w);
	block(f, NAVIGATION_P, NAVIGATION_BA, -1, &s->u);
	for (int i = 0; i < 3; i++)
		f[NAVIGATION_P + i][NAVIGATION_V + i] = s->t_s;
}

static void test_the_sums_are_the_derivatives_of_the_integration(void **state)
{
	struct navigation start = {.started = false}, n;
	struct navigation_input in[SAMPLES];
	double f[N][N], e[9], size = 1e-6;

	(void)state;
	navigation_start(&start, &BARE, any_attitude());
	for (int k = 0; k < SAMPLES; k++)
		in[k] = any_input(start.q_nb);
	n = integrated(start, in);
	assert_true(n.sums.t_s > 0);
	transition(&n.sums, f);
	for (int i = 0; i < N; i++) {
		struct navigation moved = integrated(with_error(start, i, size), in);

		error_of(&moved, &n, size, e);
		for (int j = 0; j < 9; j++) /* up to terms of dt^2 */
			assert_near(e[j], f[j][i], 0.01 * SAMPLES * DT_S * (j < 3 ? 1 : 15));
	}
}

/* n samples of the same rotation R and force F: each sum is a polynomial of the time. */
static void test_the_sums_of_a_constant_motion_are_in_closed_form(void **state)
{
	const struct mat3 r = mat3_from_quat(any_attitude());
	const struct vec3 force = any_vec(15);
	const struct mat3 f_cross = cross(force), f_cross_r = mat3_multiply(f_cross, r);
	const double n = SAMPLES, t = n * DT_S, t2 = n * (n - 1) / 2 * DT_S * DT_S;
	const double t3 = n * (n - 1) * (n - 2) / 6 * DT_S * DT_S * DT_S;
	struct navigation_sums s = {.t_s = 0};

	(void)state;
	for (int k = 0; k < SAMPLES; k++)
		navigation_sums_add(&s, &r, (struct vec3){1, 2, 2}, force, (struct vec3){0, 3, 4}, DT_S);
	assert_near(s.t_s, t, 1e-12);
	assert_vec_near(s.f, vec3_scale(t, force), 1e-12);
	assert_vec_near(s.ff, vec3_scale(t2, force), 1e-12);
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++) {
			assert_near(s.s.m[i][j], t * r.m[i][j], 1e-12);
			assert_near(s.u.m[i][j], t2 * r.m[i][j], 1e-12);
			assert_near(s.v.m[i][j], t2 * f_cross_r.m[i][j], 1e-12);
			assert_near(s.w.m[i][j], t3 * f_cross_r.m[i][j], 1e-12);
		}
	assert_near(s.turned2_rad2_s, 9 * t, 1e-12);
	assert_near(s.accel2_m2_s3, 25 * t, 1e-12);
}

/* ---- the covariance against dense matrices
 * ------------------------------------------------------------------------ */

static void dense_propagate(double p[N][N], double f[N][N])
{
	double fp[N][N] = {{0}};

	for (int i = 0; i < N; i++)
		for (int j = 0; j < N; j++)
			for (int k = 0; k < N; k++)
				fp[i][j] += f[i][k] * p[k][j];
	memset(p, 0, sizeof(double[N][N]));
	for (int i = 0; i < N; i++)
		for (int j = 0; j < N; j++)
			for (int k = 0; k < N; k++)
				p[i][j] += fp[i][k] * f[j][k];
}

static void test_the_covariance_is_that_of_dense_matrices(void **state)
{
	struct navigation n = {.started = false};
	struct navigation_config never_still = BARE;
	double p[N][N], f[N][N];

	(void)state;
	never_still.preset = MOTION_HAND_HELD; /* of a foot more than these matrices is uncertain */
	never_still.standstill.gyro_threshold_rad_s = 1e-9;
	navigation_start(&n, &never_still, any_attitude());
	for (int round = 0; round < 20; round++) {
		struct navigation_sums sums = n.sums;
		struct navigation_input in;

		memcpy(p, n.p, sizeof(p));
		do {
			sums = n.sums;
			in = any_input(n.q_nb);
			in.force_b_m_s2 = quat_rotate_inverse(
				n.q_nb, (struct vec3){0, 0, G}); /* slow: no process noise of the scale */
			in.gyro_b_rad_s = vec3_scale(1e-4, in.gyro_b_rad_s);
			navigation_step(&n, &in, DT_S);
		} while (n.sums.t_s > 0);
		struct mat3 r = mat3_from_quat(n.q_nb), f_cross = cross((struct vec3){0, 0, G * DT_S});

		/* the sample after `sums` is one more transition */
		transition(&sums, f);
		dense_propagate(p, f);
		for (int i = 0; i < 9; i++)
			r.m[i / 3][i % 3] *= DT_S;
		transition(&(struct navigation_sums){.t_s = DT_S, .s = r}, f);
		block(f, NAVIGATION_V, NAVIGATION_THETA, -1, &f_cross);
		dense_propagate(p, f);
		/* all but the states correlated with the heading, which was measured */
		for (int i = NAVIGATION_V; i < NAVIGATION_BG; i++)
			for (int j = NAVIGATION_V; j < NAVIGATION_BG; j++)
				assert_near(n.p[i][j], p[i][j], 1e-3 * sqrt(p[i][i] * p[j][j]));
	}
}

static void test_the_covariance_stays_symmetric_and_positive(void **state)
{
	const struct navigation_config config = levelling();
	struct navigation n = {.started = false};

	(void)state;
	navigation_start(&n, &config, any_attitude());
	for (int k = 0; k < 100000; k++) {
		bool quiet = k / 2000 % 3 == 0;
		struct navigation_input in = any_input(n.q_nb);

		if (quiet) {
			in.gyro_b_rad_s = vec3_scale(1e-4, in.gyro_b_rad_s);
			in.force_b_m_s2 = quat_rotate_inverse(n.q_nb, (struct vec3){0, 0, G});
		}
		navigation_step(&n, &in, DT_S);
		for (int i = 0; i < N; i++) {
			assert_true(n.p[i][i] >= 0);
			for (int j = 0; j < i; j++)
				assert_near(n.p[i][j], n.p[j][i], 1e-6 * sqrt(n.p[i][i] * n.p[j][j]) + 1e-15);
		}
	}
}

/* ---- position against truth
 * --------------------------------------------------------------------------------------- */

static const double REST_S = 5, END_S = 2;

/* At rest, then on a path to another place, then at rest: s(t) from 0 to 1, smooth to its second derivative. */
struct path {
	double time_s;
	struct vec3 to_n_m, turn_rad;
};

static void path_at(const struct path *path, double t, struct signal_truth *truth)
{
	double x = fmin(fmax((t - REST_S) / path->time_s, 0), 1), w = 2 * PI / path->time_s;
	double s = x - sin(2 * PI * x) / (2 * PI), v = (1 - cos(2 * PI * x)) / path->time_s;
	double a = w / path->time_s * sin(2 * PI * x);

	*truth = (struct signal_truth){
		.t_s = t,
		.q_nb = quat_from_rotation_vector(vec3_scale(s, path->turn_rad)),
		.omega_b_rad_s = vec3_scale(v, path->turn_rad),
		.alpha_b_rad_s2 = vec3_scale(a, path->turn_rad),
		.position_n_m = vec3_scale(s, path->to_n_m),
		.velocity_n_m_s = vec3_scale(v, path->to_n_m),
		.accel_n_m_s2 = vec3_scale(a, path->to_n_m),
	};
}

/* The position at the end; the fusion's attitude has an error of 0.5 degrees in roll and pitch. accel_scale: 1 sigma of
 * the accelerometer's. */
static struct position travel_by_scale(
	const struct path *path, const struct navigation_config *navigation, double accel_scale, uint64_t seed)
{
	struct position_config config = {.mode = POSITION_NAVIGATION, .navigation = *navigation};
	struct sensor_config chip = *sensor_preset("lsm303dlhc_l3gd20");
	static struct sensor sensor;
	struct position p;

	chip.rate_hz = 200;
	sensor_calibrate(&chip);
	chip.accel.scale_sigma = accel_scale;
	assert_int_equal(sensor_init(&sensor, &chip, seed), 0);
	assert_int_equal(position_init(&p, &config), 0);
	for (int k = 0; k < (int)lround((REST_S + path->time_s + END_S) / DT_S); k++) {
		struct navigation_input in = {.gravity_m_s2 = chip.gravity_m_s2};
		struct imu_sample sample;
		struct signal_truth truth;

		path_at(path, sensor_instant_s(&sensor), &truth);
		sensor_measure(&sensor, &truth, &sample);
		in.gyro_b_rad_s = sample.gyro_rad_s;
		in.force_b_m_s2 = sample.accel_m_s2;
		in.q_nb = quat_multiply(
			quat_from_rotation_vector((struct vec3){0.5 * RAD_PER_DEG, -0.5 * RAD_PER_DEG, 0}), truth.q_nb);
		position_navigate(&p, &in, ZERO, 1 / DT_S, DT_S);
	}
	return p;
}

static struct position travel(const struct path *path, const struct navigation_config *navigation, uint64_t seed)
{
	return travel_by_scale(path, navigation, 0, seed);
}

static double normalised(struct vec3 error, struct vec3 sigma)
{
	return (pow(error.x / sigma.x, 2) + pow(error.y / sigma.y, 2) + pow(error.z / sigma.z, 2)) / 3;
}

/* No standstill shows an error of scale. */
static void test_after_a_long_way_sigma_counts_the_accelerometers_scale(void **state)
{
	const struct path lift = {10, {0, 0, 40}, {0, 0, 0}};
	struct navigation_config axis = levelling();
	double sum = 0;

	(void)state;
	axis.preset = MOTION_LINEAR_AXIS;
	axis.levelling = 0;
	for (uint64_t seed = 1; seed <= 20; seed++) {
		struct position p = travel_by_scale(&lift, &axis, 0.003, seed);

		assert_true(p.navigation.still);
		sum += pow((p.displacement_n_m.z - lift.to_n_m.z) / p.displacement_sigma_m.z, 2) / 20;
	}
	print_message("40 m in 10 s by 0.3 %% of scale: normalised %.2f\n", sum);
	assert_true(sum > 0.4 && sum < 2);
}

/* The gyro's noise and bias tilt what is not guided. */
static void test_a_guided_way_is_held_level(void **state)
{
	const struct path path = {10, {8, 0, 0}, {0, 0, 0}};
	struct navigation_config axis = levelling(), base;
	double guided_m = 0, free_m = 0;

	(void)state;
	axis.preset = MOTION_LINEAR_AXIS;
	axis.levelling = 0;
	base = axis;
	base.preset = MOTION_ROBOT_BASE;
	for (uint64_t seed = 1; seed <= 20; seed++) {
		struct position guided = travel(&path, &axis, seed), unguided = travel(&path, &base, seed);
		struct vec3 e = vec3_sub(guided.position_n_m, path.to_n_m), s = guided.sigma.position_m;

		assert_true(fabs(e.x) < 3 * s.x && fabs(e.y) < 3 * s.y && fabs(e.z) < 3 * s.z);
		guided_m = fmax(guided_m, vec3_norm(e));
		free_m = fmax(free_m, vec3_norm(vec3_sub(unguided.position_n_m, path.to_n_m)));
	}
	print_message("8 m in 10 s: worst error %.3f m guided, %.3f m not\n", guided_m, free_m);
	assert_true(guided_m < free_m / 2);
}

/* Vertical rails leave nothing but the scale, a part of which the bias at rest shows. */
static void test_a_vertical_lift_ends_within_its_plumb_line(void **state)
{
	const struct path lift = {15, {0, 0, 40}, {0, 0, 0}};
	struct navigation_config rails = levelling(), axis;
	double height2 = 0, axis_height2 = 0, normalised_z = 0;

	(void)state;
	rails.levelling = 0;
	axis = rails;
	rails.preset = MOTION_VERTICAL_LIFT;
	axis.preset = MOTION_LINEAR_AXIS;
	for (uint64_t seed = 1; seed <= 20; seed++) {
		struct position p = travel_by_scale(&lift, &rails, 0.003, seed);
		struct position q = travel_by_scale(&lift, &axis, 0.003, seed);

		assert_true(p.navigation.still && !p.navigation.guide.inclined);
		assert_true(hypot(p.position_n_m.x, p.position_n_m.y) < 0.02);
		assert_true(p.sigma.position_m.x > 0.03 && p.sigma.position_m.x < 0.06); /* 1 mm/m */
		height2 += pow(p.position_n_m.z - 40, 2) / 20;
		axis_height2 += pow(q.position_n_m.z - 40, 2) / 20;
		normalised_z += pow((p.position_n_m.z - 40) / p.sigma.position_m.z, 2) / 20;
	}
	print_message("40 m up: RMS of the height %.3f m, %.3f m without, normalised %.2f\n", sqrt(height2),
		sqrt(axis_height2), normalised_z);
	assert_true(height2 < 0.7 * axis_height2);
	assert_true(normalised_z > 0.3 && normalised_z < 2);
}

/* The assumption is given up for good, and the way is what it would be without. */
static void test_a_lift_that_is_inclined_is_found_to_be(void **state)
{
	struct navigation_config rails = levelling();

	(void)state;
	rails.preset = MOTION_VERTICAL_LIFT;
	rails.levelling = 0;
	for (uint64_t seed = 1; seed <= 20; seed++) {
		double angle = (seed < 11 ? 4 : 30) * RAD_PER_DEG;
		const struct path path = {15, {40 * sin(angle), 0, 40 * cos(angle)}, {0, 0, 0}};
		struct position p = travel(&path, &rails, seed);
		struct vec3 e = vec3_sub(p.position_n_m, path.to_n_m), s = p.sigma.position_m;

		assert_true(p.navigation.guide.inclined);
		assert_true(vec3_norm(e) < 2);
		assert_true(fabs(e.x) < 3 * s.x && fabs(e.y) < 3 * s.y && fabs(e.z) < 3 * s.z);
	}
}

/* As soon as it does turn, it is as if it had never been held. */
static void test_what_turns_on_its_way_is_not_held(void **state)
{
	const struct path path = {6, {3, 2, 0}, {0.2, -0.3, 0.5}};
	struct navigation_config axis = levelling(), base;

	(void)state;
	axis.levelling = 0;
	axis.preset = MOTION_LINEAR_AXIS;
	base = axis;
	base.preset = MOTION_ROBOT_BASE;
	for (uint64_t seed = 1; seed <= 5; seed++) {
		struct position held = travel(&path, &axis, seed), not_held = travel(&path, &base, seed);

		assert_near(vec3_norm(vec3_sub(held.displacement_n_m, not_held.displacement_n_m)), 0, 0.02);
		assert_true(vec3_norm(held.displacement_sigma_m) > 0.8 * vec3_norm(not_held.displacement_sigma_m));
	}
}

static void test_the_displacement_at_rest_is_right_and_its_sigma_honest(void **state)
{
	const struct navigation_config bare = {.noise = levelling().noise, .standstill = STANDSTILL_DEFAULTS};
	const struct path path = {4, {3, -2, 0.5}, {0.2, -0.3, 1}};
	double sum = 0, worst = 0;

	(void)state;
	for (uint64_t seed = 1; seed <= 20; seed++) {
		struct position p = travel(&path, &bare, seed);
		struct vec3 e = vec3_sub(p.displacement_n_m, path.to_n_m), s = p.displacement_sigma_m;

		assert_true(p.navigation.still);
		sum += (e.x * e.x / (s.x * s.x) + e.y * e.y / (s.y * s.y) + e.z * e.z / (s.z * s.z)) / 3 / 20;
		worst = fmax(worst, vec3_norm(e));
	}
	print_message("displacement of %.1f m in %g s: worst error %.3f m, normalised %.2f\n", vec3_norm(path.to_n_m),
		path.time_s, worst, sum);
	assert_true(sum < 2);
	assert_true(worst < 0.5);
}

/* The samples of a robot that slows down gently deviate as little as those of a standstill. */
static void test_a_gentle_drive_is_not_a_standstill(void **state)
{
	static const struct path PATHS[] = {{.time_s = 2, .to_n_m = {0.1, 0, 0}}, {.time_s = 3, .to_n_m = {0, 1, 0}},
		{.time_s = 4, .to_n_m = {1, 0, 0}}};
	struct navigation_config config = levelling();

	(void)state;
	config.preset = MOTION_HAND_HELD; /* a foot may accelerate while it stands */
	for (int i = 0; i < 3; i++)
		for (uint64_t seed = 1; seed <= 5; seed++) {
			struct position p = travel(&PATHS[i], &config, seed);
			struct vec3 error = vec3_sub(p.position_n_m, PATHS[i].to_n_m);

			assert_true(p.navigation.still);
			assert_true(vec3_norm(error) < 0.02 + 0.03 * vec3_norm(PATHS[i].to_n_m));
		}
}

static void test_levelling_does_not_shorten_a_long_steady_drive(void **state)
{
	const struct navigation_config config = levelling();
	const struct path path = {6, {10, 0, 0}, {0, 0, 0.5}};

	(void)state;
	for (uint64_t seed = 1; seed <= 5; seed++) {
		struct position p = travel(&path, &config, seed);

		print_message("10 m in 6 s: %.2f %.2f %.2f\n", p.displacement_n_m.x, p.displacement_n_m.y,
			p.displacement_n_m.z);
		assert_near(p.displacement_n_m.x, 10, 1);
	}
}

/* Mean squares over the last part of a motion, of three simulated sensors with the errors that a calibration leaves, at
 * the reference point or 22 cm from it. */
struct honesty {
	double tilt_rad, position_m;	  /* RMS */
	double attitude, position, accel; /* normalised errors squared, mean of the axes */
};

static struct honesty simulate_chips(const char *signal, double rate_hz, struct vec3 lever_b_m,
	enum motion_preset preset, bool calibrated, unsigned uncalibrated)
{
	const int samples = (int)(30 * rate_hz), from = (int)(5 * rate_hz), n = 3 * (samples - from);
	struct sensor_config chip = *sensor_preset("lsm303dlhc_l3gd20");
	struct pipeline_config config = PIPELINE_DEFAULTS;
	struct honesty sum = {.tilt_rad = 0};

	config.position.navigation.preset = preset;
	config.uncalibrated = uncalibrated;
	chip.rate_hz = rate_hz;
	chip.lever_arm_b_m = config.estimator.lever_arm_b_m = lever_b_m;
	if (calibrated) {
		sensor_calibrate(&chip);
		chip.gyro.scale_sigma = chip.gyro.cross_axis_sigma = chip.accel.scale_sigma =
			chip.accel.cross_axis_sigma = 0.002;
		chip.accel.bias_sigma = 0.03;
		chip.gyro.bias_sigma = 0.003;
	}
	config.latency.sensor_s = 1 / (2 * PI * chip.gyro.bandwidth_hz);
	config.latency.accelerometer_s = 0;
	for (uint64_t seed = 1; seed <= 3; seed++) {
		static struct sensor sensor;
		struct pipeline pipeline;

		assert_int_equal(sensor_init(&sensor, &chip, seed), 0);
		assert_int_equal(pipeline_init(&pipeline, &config, rate_hz), 0);
		for (int k = 0; k < samples; k++) {
			struct pipeline_output out;
			struct signal_truth truth;
			struct imu_sample sample;
			struct quat off;
			struct vec3 turn;

			sensor_next(&sensor, signal_find(signal), &sample, &truth);
			assert_int_equal(pipeline_step(&pipeline, &sample, &out), 0);
			if (k < from)
				continue;
			off = quat_multiply(truth.q_nb, quat_conjugate(out.q_nb));
			turn = vec3_scale(off.w < 0 ? -2 : 2, (struct vec3){off.x, off.y, off.z});
			sum.tilt_rad += (turn.x * turn.x + turn.y * turn.y) / n;
			sum.position_m += pow(vec3_norm(vec3_sub(out.position_n_m, truth.position_n_m)), 2) / n;
			sum.attitude += normalised(turn, out.sigma.attitude_rad) / n;
			sum.position +=
				normalised(vec3_sub(out.position_n_m, truth.position_n_m), out.sigma.position_m) / n;
			sum.accel +=
				normalised(vec3_sub(out.accel_n_m_s2, truth.accel_n_m_s2), out.sigma.accel_m_s2) / n;
		}
	}
	sum.tilt_rad = sqrt(sum.tilt_rad);
	sum.position_m = sqrt(sum.position_m);
	return sum;
}

static struct honesty simulate(const char *signal, double rate_hz, struct vec3 lever_b_m, enum motion_preset preset)
{
	return simulate_chips(signal, rate_hz, lever_b_m, preset, true, 0);
}

/* 60 mg and 10 deg/s of bias, a few percent of scale: turned, they meet gravity along other axes. */
static void test_sigma_knows_that_nobody_calibrated_the_sensors(void **state)
{
	static const char *const motions[] = {"turntable", "square", "multiposition"};
	const unsigned all = PIPELINE_UNCALIBRATED_GYRO | PIPELINE_UNCALIBRATED_ACCEL | PIPELINE_UNCALIBRATED_MAG;

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct honesty h = simulate_chips(motions[i], 100, ZERO, MOTION_ANY, false, all);

		print_message(
			"uncalibrated, %s: NEES of position %.2f, attitude %.2f\n", motions[i], h.position, h.attitude);
		assert_true(h.position > 0.05 && h.position < 1.5 && h.attitude < 1.5);
	}
	assert_true(simulate_chips("turntable", 100, ZERO, MOTION_ANY, false, 0).position > 5);
}

static const double RATES_HZ[] = {100, 200, 952};

/* Sigma accounts for errors that the simulation does not have (magnetic north, residual scale), so it may be too
 * large. */
static void test_sigma_is_honest_on_a_simulated_robot_at_any_rate(void **state)
{
	(void)state;
	for (int i = 0; i < 3; i++) {
		struct honesty lying = simulate("multiposition", RATES_HZ[i], ZERO, MOTION_ANY);
		struct honesty driving = simulate("square", RATES_HZ[i], ZERO, MOTION_ANY);

		print_message("NEES at %.0f Hz: attitude %.2f %.2f, position %.2f %.2f, acceleration %.2f %.2f\n",
			RATES_HZ[i], lying.attitude, driving.attitude, lying.position, driving.position, lying.accel,
			driving.accel);
		/* the accelerometer's bias is considered with the sigma of a calibration, which these chips do not use
		 * up */
		assert_true(lying.attitude > 0.1 && lying.attitude < 2);
		assert_true(driving.attitude > 0.2 && driving.attitude < 2);
		/* turned by half a turn without levelling, the accelerometer's scale and alignment count, which have no
		 * state */
		assert_true(lying.position > 0.5 && lying.position < 6);
		assert_true(driving.position > 0.05 && driving.position < 2);
		assert_true(lying.accel > 0.3 && lying.accel < 2);
		assert_true(driving.accel > 0.5 && driving.accel < 3);
	}
}

/* From its first sample on, the sensor moves around the reference point at up to 1.5 m/s and 1 g. */
static void test_the_errors_stay_bounded_at_the_end_of_a_lever_arm_at_any_rate(void **state)
{
	const char *const motions[] = {"turntable", "tumble", "pendulum", "square"};
	const struct vec3 lever = {0.2, -0.1, 0.1};

	(void)state;
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 4; j++) {
			struct honesty h = simulate(motions[j], RATES_HZ[i], lever, MOTION_HAND_HELD);

			assert_true(h.tilt_rad < 1.5 * RAD_PER_DEG);
			assert_true(h.position_m < 3); /* over 100 m if the sensor's velocity is levelled instead */
			assert_true(h.position < 3);
			assert_true(h.accel < 2);
		}
}

/* A drive of 5 s is not a movement to and fro: with levelling from its beginning it came 0.4 m short. */
static void test_a_robot_that_stops_at_the_corners_of_its_square_is_followed(void **state)
{
	const struct signal *square = signal_find("square");
	struct sensor_config config = *sensor_preset("lsm303dlhc_l3gd20");
	struct pipeline_config hand_held = PIPELINE_DEFAULTS;
	double sum = 0, worst = 0;

	(void)state;
	hand_held.position.navigation.preset = MOTION_HAND_HELD;
	sensor_calibrate(&config);
	for (uint64_t seed = 1; seed <= 3; seed++) {
		struct pipeline pipeline;
		struct sensor sensor;

		assert_int_equal(sensor_init(&sensor, &config, seed), 0);
		assert_int_equal(pipeline_init(&pipeline, &hand_held, config.rate_hz), 0);
		for (int k = 0; k < 4000; k++) {
			struct signal_truth truth;
			struct imu_sample sample;
			struct pipeline_output out;

			sensor_next(&sensor, square, &sample, &truth);
			assert_int_equal(pipeline_step(&pipeline, &sample, &out), 0);
			double error = vec3_norm(vec3_sub(out.position_n_m, truth.position_n_m));
			sum += error * error / 12000;
			worst = fmax(worst, error);
		}
	}
	assert_true(sqrt(sum) < 0.15);
	assert_true(worst < 0.4);
}

/* rad, of an arm that hangs, and from 4 s on swings by 120 degrees at 0.2 Hz, within 2 s. */
static double arm_angle_rad(double t)
{
	double share = fmax(0, fmin(1, (t - 4) / 2));

	return 120 * RAD_PER_DEG * share * share * (3 - 2 * share) * sin(0.4 * PI * (t - 4));
}

/* What a sensor with these errors of scale measures on it, 1 m from the axis, and where it is. */
static struct imu_sample on_an_arm(int k, struct vec3 gyro_scale, struct vec3 accel_scale, struct vec3 *position_n_m)
{
	const double t = 0.01 * k, h = 1e-4, angle = arm_angle_rad(t);
	const double before = arm_angle_rad(t - h), after = arm_angle_rad(t + h), rate = (after - before) / (2 * h);
	struct quat q_nb = quat_from_rotation_vector((struct vec3){0, -angle, 0});
	struct vec3 up_b = quat_rotate_inverse(q_nb, (struct vec3){0, 0, G});
	struct vec3 f = vec3_add(up_b, (struct vec3){(after - 2 * angle + before) / (h * h), 0, rate * rate});

	*position_n_m = vec3_add(quat_rotate(q_nb, (struct vec3){0, 0, -1}), (struct vec3){0, 0, 1});
	return (struct imu_sample){.t_us = (uint64_t)k * 10000,
		.gyro_rad_s = {0, -rate * (1 + gyro_scale.y), 0},
		.accel_m_s2 = {f.x * (1 + accel_scale.x), f.y * (1 + accel_scale.y), f.z * (1 + accel_scale.z)}};
}

/* The error of an axis is in phase with what it multiplies, so that a part of it never averages out: the height was 8
 * sigma off. */
static void test_what_a_swinging_arm_rectifies_of_the_errors_of_scale_is_in_the_sigma(void **state)
{
	static const struct {
		struct vec3 gyro, accel;
		unsigned uncalibrated;
	} errors[] = {{{0, 0.02, 0}, {0, 0, 0}, PIPELINE_UNCALIBRATED_GYRO},
		{{0, 0, 0}, {0.02, 0, 0}, PIPELINE_UNCALIBRATED_ACCEL},
		{{0, 0, 0}, {0, 0, 0.02}, PIPELINE_UNCALIBRATED_ACCEL}, {{0, 0.003, 0}, {0, 0, 0}, 0},
		{{0, 0, 0}, {-0.003, 0, 0.003}, 0}};

	(void)state;
	for (size_t e = 0; e < sizeof(errors) / sizeof(errors[0]); e++) {
		struct pipeline_config config = PIPELINE_DEFAULTS;
		static struct pipeline p;
		double worst = 0;

		config.latency.sensor_s = config.latency.accelerometer_s = 0;
		config.uncalibrated = errors[e].uncalibrated;
		assert_int_equal(pipeline_init(&p, &config, 100), 0);
		for (int k = 0; k < 64 * 100; k++) {
			struct vec3 position_n_m, off;
			struct imu_sample s = on_an_arm(k, errors[e].gyro, errors[e].accel, &position_n_m);
			struct pipeline_output out;

			assert_int_equal(pipeline_step(&p, &s, &out), 0);
			off = vec3_sub(out.position_n_m, position_n_m);
			if (k > 800)
				worst = fmax(worst, fabs(off.z) / out.sigma.position_m.z);
		}
		print_message("scale error %zu: height off by %.1f sigma at most\n", e, worst);
		assert_true(worst < 2);
	}
}

/* A constant error of acceleration is seen as velocity at the standstill, and half of that velocity times the time is
 * the error of the position. A smoother over the movement removes it, and so must the filter. */
static void test_a_standstill_corrects_the_whole_movement_before_it(void **state)
{
	const double error = 0.05, time_s = 10;
	struct navigation n = {.started = false};
	double before;

	(void)state;
	navigation_start(&n, &BARE, QUAT_IDENTITY);
	for (int k = 0; k < (int)(time_s / DT_S); k++) {
		struct navigation_input in = {
			.force_b_m_s2 = {error, 0, G + (k % 2 ? 3 : -3)}, .q_nb = QUAT_IDENTITY, .gravity_m_s2 = G};

		navigation_step(&n, &in, DT_S);
	}
	before = n.position_n_m.x;
	assert_near(before, error * time_s * time_s / 2, 0.05);
	for (int k = 0; k < (int)(2 / DT_S); k++) {
		struct navigation_input in = {.force_b_m_s2 = {error, 0, G}, .q_nb = QUAT_IDENTITY, .gravity_m_s2 = G};

		navigation_step(&n, &in, DT_S);
	}
	assert_true(n.still);
	assert_near(n.position_n_m.x, 0, 0.1 * before);
}

static void test_a_steady_speed_passes_for_a_standstill_only_after_the_rest_time(void **state)
{
	struct navigation_input in = {.force_b_m_s2 = {0, 0, G}, .q_nb = QUAT_IDENTITY, .gravity_m_s2 = G};
	struct navigation n = {.started = false};
	struct vec3 sigma;

	(void)state;
	navigation_start(&n, &BARE, QUAT_IDENTITY);
	n.velocity_n_m_s = (struct vec3){6, 0, 0};
	for (int k = 0; k < (int)(2 / DT_S); k++) {
		navigation_step(&n, &in, DT_S);
		if (k * DT_S < 1)
			assert_false(n.still || navigation_assumes_standstill(&n));
	}
	assert_true(n.still && navigation_assumes_standstill(&n));
	sigma = navigation_sigma(&n, 1 / DT_S).position_m;
	assert_near(sigma.x, 6 * 1.5, 0.3); /* as far as it may have gone on until then */
	in.force_b_m_s2.x = 3;
	navigation_step(&n, &in, DT_S);
	assert_false(navigation_assumes_standstill(&n));
}

static void test_after_the_longest_integration_time_the_position_is_held_until_it_is_corrected_at_rest(void **state)
{
	const struct path path = {6, {10, 0, 0}, {0, 0, 0}};
	const struct navigation_config config = levelling();
	struct position p = travel(&path, &config, 1), held;

	(void)state;
	p.config.longest_integration_s = 1;
	for (int k = 0; k < (int)(8 / DT_S); k++) {
		bool moves = k * DT_S < 3;
		struct navigation_input in = {.force_b_m_s2 = {moves ? 1 : 0, 0, G + (moves && k % 2 ? 3 : 0)},
			.q_nb = p.navigation.q_nb,
			.gravity_m_s2 = G + (moves ? 1.5 : 0)};

		position_navigate(&p, &in, ZERO, 1 / DT_S, DT_S);
		if (k == (int)(1.5 / DT_S))
			held = p;
		if (k == (int)(2.9 / DT_S)) {
			assert_true(position_limited(&p));
			assert_vec_near(p.position_n_m, held.position_n_m, 0);
			assert_vec_near(p.velocity_n_m_s, ZERO, 0);
		}
	}
	assert_false(position_limited(&p));
	assert_true(fabs(p.position_n_m.x - held.position_n_m.x) > 0.1);
}

static void test_a_prior_limits_the_velocity(void **state)
{
	struct navigation_config config = BARE;
	double end[2];

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct navigation n = {.started = false};

		config.velocity_prior_m_s = i ? 0.3 : 0;
		navigation_start(&n, &config, quat_from_rotation_vector((struct vec3){0, 1 * RAD_PER_DEG, 0}));
		for (int k = 0; k < 4000; k++) {
			struct navigation_input in = {.force_b_m_s2 = {0, 0, G + (k % 2 ? 3 : -3)}, .gravity_m_s2 = G};

			in.q_nb = n.q_nb;
			navigation_step(&n, &in, DT_S);
		}
		end[i] = fabs(n.velocity_n_m_s.x);
	}
	assert_true(end[0] > 3);
	assert_true(end[1] < 0.3);
}

/* A vehicle begins to cruise at 1 m/s within a second; its accelerometer is off by 0.03 m/s^2, half a sigma. */
static void test_a_prior_bounds_the_velocity_of_a_cruise_and_no_time_averages_it_out(void **state)
{
	static const double PRIORS_M_S[] = {0, 0.5, 1, 2};
	double position_sigma_m[4];

	(void)state;
	for (int i = 0; i < 4; i++) {
		struct navigation_config config = BARE;
		struct navigation n = {.started = false};
		struct navigation_sigma sigma;

		config.velocity_prior_m_s = PRIORS_M_S[i];
		navigation_start(&n, &config, QUAT_IDENTITY);
		for (int k = 0; k < (int)(61 / DT_S); k++) {
			struct navigation_input in = {
				.force_b_m_s2 = {k * DT_S < 1 ? 1.03 : 0.03, 0, G + (k % 2 ? 3 : -3)},
				.gravity_m_s2 = G};

			in.q_nb = n.q_nb;
			navigation_step(&n, &in, DT_S);
		}
		sigma = navigation_sigma(&n, 1 / DT_S);
		position_sigma_m[i] = sigma.position_m.x;
		assert_true(fabs(n.velocity_n_m_s.x - 1) < 3 * sigma.velocity_m_s.x);
		assert_true(fabs(n.position_n_m.x - 60.5) < 3 * sigma.position_m.x);
		if (i > 0) {
			assert_near(sigma.velocity_m_s.x, PRIORS_M_S[i], 0.1 * PRIORS_M_S[i]);
			assert_true(sigma.position_m.x > 0.5 * 60 * PRIORS_M_S[i]);
			assert_true(sigma.position_m.x < position_sigma_m[0]);
		}
	}
	assert_true(position_sigma_m[1] < position_sigma_m[2] && position_sigma_m[2] < position_sigma_m[3]);
}

/* Stands for 10 s. */
static struct navigation standing_navigation(void)
{
	struct navigation_config config = levelling();
	struct navigation n = {.started = false};

	config.preset = MOTION_ANY;
	config.levelling = 0;
	navigation_start(&n, &config, QUAT_IDENTITY);
	for (int k = 0; k < (int)(10 / DT_S); k++) {
		struct navigation_input in = {
			.force_b_m_s2 = {0.005 * any(), 0.005 * any(), G + 0.005 * any()}, .gravity_m_s2 = G};

		in.q_nb = n.q_nb;
		navigation_step(&n, &in, DT_S);
	}
	assert_true(n.still);
	return n;
}

/* By a small part of the tilt's sigma: what has just been the same for 20 s differs. */
static void test_a_cruise_that_begins_to_brake_gently_accelerates(void **state)
{
	struct navigation n = standing_navigation();
	double seen_s = 0;

	(void)state;
	for (int k = 0; k < (int)(27 / DT_S) && seen_s == 0; k++) {
		double t = k * DT_S, accel = t < 2 ? 0.5 : t > 25 ? -0.1 * (t - 25) : 0;
		struct navigation_input in = {
			.force_b_m_s2 = {accel + 0.005 * any(), 0.005 * any(), G + 0.005 * any()}, .gravity_m_s2 = G};

		in.q_nb = n.q_nb;
		navigation_step(&n, &in, DT_S);
		assert_true(t < 10 || t > 25 || !navigation_accelerates(&n));
		if (t > 25 && navigation_accelerates(&n))
			seen_s = t - 25;
	}
	assert_true(seen_s > 0 && seen_s < 0.8);
	assert_false(n.still);
}

/* The force of a load that swings on 20 m is always along the rope, and at its turning points nothing changes. */
static void test_a_load_accelerates_at_the_turning_points_of_its_swing(void **state)
{
	const double w = 2 * PI / 9, swing_rad = 0.9 * RAD_PER_DEG;
	struct navigation n = standing_navigation();

	(void)state;
	for (int k = 0; k < (int)(18 / DT_S); k++) {
		double t = k * DT_S;
		struct navigation_input in = {.gyro_b_rad_s = {0, swing_rad * w * cos(w * t), 0},
			.force_b_m_s2 = {0.005 * any(), 0.005 * any(), G + 0.005 * any()},
			.gravity_m_s2 = G};

		in.q_nb = n.q_nb;
		navigation_step(&n, &in, DT_S);
		assert_true(t < 2 || fabs(sin(w * t)) < 0.75 || navigation_accelerates(&n));
	}
}

static void test_at_rest_velocity_is_zero_and_the_position_stays_for_an_hour(void **state)
{
	const struct path stay = {1, {0, 0, 0}, {0, 0, 0}};
	const struct navigation_config config = levelling();
	struct position p = travel(&stay, &config, 3), before;

	(void)state;
	before = p;
	for (int k = 0; k < (int)(3600 / DT_S); k++) {
		struct navigation_input in = {.force_b_m_s2 = {0.001 * any(), 0, G + 0.001 * any()},
			.gyro_b_rad_s = any_vec(1e-4),
			.q_nb = QUAT_IDENTITY,
			.gravity_m_s2 = G};

		position_navigate(&p, &in, ZERO, 1 / DT_S, DT_S);
	}
	assert_vec_near(p.velocity_n_m_s, ZERO, 0);
	assert_vec_near(p.position_n_m, before.position_n_m, 0.01);
	assert_true(vec3_norm(navigation_sigma(&p.navigation, 1 / DT_S).position_m) < 0.05);
}

/* Three times as noisy as 2020h says, and its mean wanders by 2 mm/s^2 within seconds, as those of recorded chips
 * do. */
static void test_a_chip_noisier_than_its_datasheet_does_not_begin_to_move_at_rest(void **state)
{
	struct navigation_config config = {.standstill = STANDSTILL_DEFAULTS,
		.rest_s = 1.5,
		.noise = {.gyro_density_rad_s_sqrt_hz = 5e-4,
			.accel_density_m_s2_sqrt_hz = 2e-3,
			.accel_bias_instability_m_s2 = 1e-3}};
	struct navigation n = {.started = false};

	(void)state;
	navigation_start(&n, &config, QUAT_IDENTITY);
	for (int k = 0; k < (int)(600 / DT_S); k++) {
		const double t = k * DT_S;
		struct navigation_input in = {.force_b_m_s2 = {0.002 * sin(t / 3), 0.002 * cos(t / 4), G},
			.gyro_b_rad_s = any_vec(0.005),
			.q_nb = QUAT_IDENTITY,
			.gravity_m_s2 = G};

		in.force_b_m_s2 = vec3_add(in.force_b_m_s2, any_vec(sqrt(3) * 6e-3 * sqrt(0.5 / DT_S)));
		navigation_step(&n, &in, DT_S);
		assert_true(n.still || k * DT_S < 5);
	}
	assert_int_equal(n.movements, 0);
}

/* At the turning point of a pendulum, or on an arm that turns about the reference point: the velocity is zero, and
 * nothing accelerates. A linear axis does not turn. */
static void test_what_turns_may_stand_except_on_a_linear_axis(void **state)
{
	const enum motion_preset presets[] = {MOTION_ANY, MOTION_ROBOT_BASE, MOTION_LINEAR_AXIS, MOTION_ARM};

	(void)state;
	for (int i = 0; i < 4; i++)
		for (int turns = 0; turns < 2; turns++) {
			struct navigation_config config = levelling();
			struct navigation n = {.started = false};
			struct navigation_input in = {.force_b_m_s2 = {0, 0, G}, .gravity_m_s2 = G};

			config.preset = presets[i];
			config.levelling = 0;
			in.gyro_b_rad_s.z = turns ? 0.1 : 0;
			navigation_start(&n, &config, QUAT_IDENTITY);
			for (int k = 0; k < (int)(10 / DT_S); k++) {
				in.q_nb = quat_from_rotation_vector((struct vec3){0, 0, in.gyro_b_rad_s.z * k * DT_S});
				navigation_step(&n, &in, DT_S);
			}
			if (!turns)
				assert_true(n.still);
			else if (presets[i] == MOTION_LINEAR_AXIS)
				assert_true(!n.still && n.zero_velocity.weight == 0);
			else
				assert_true(n.still || n.zero_velocity.weight > 0.5);
		}
}

/* A foot, or a tool that turns to and fro: the bias seen at the next standstill is not quite that of the movement. */
static void test_after_turning_to_and_fro_the_accelerometers_bias_is_less_certain(void **state)
{
	const double accels[] = {0, 8}, rates[] = {0, 3};
	struct navigation_config config = BARE;

	(void)state;
	config.preset = MOTION_ANY;
	for (int i = 0; i < 4; i++) {
		struct navigation n = {.started = false};
		const double a = accels[i % 2], w = rates[i / 2];
		double before, after;

		navigation_start(&n, &config, QUAT_IDENTITY);
		n.moved_s = 10;
		n.moved_accel2_m2_s3 = 10 * a * a;
		n.moved_turned2_rad2_s = 10 * w * w;
		n.zero_velocity.standing_s = 1; /* it stands with the next sample */
		before = n.p[NAVIGATION_BA][NAVIGATION_BA];
		navigation_step(&n, &(struct navigation_input){.force_b_m_s2 = {0, 0, G}, .gravity_m_s2 = G}, 1e-6);
		after = n.p[NAVIGATION_BA][NAVIGATION_BA];
		assert_true(n.still);
		assert_near(after - before, a > 0 && w > 0 ? pow(0.006 * a, 2) * pow(0.3 * w, 2) : 0, 1e-9);
	}
}

static void test_a_gap_makes_position_and_velocity_less_certain(void **state)
{
	const struct path path = {4, {1, 0, 0}, {0, 0, 0}};
	const struct navigation_config config = levelling();
	struct position p = travel(&path, &config, 1);
	struct vec3 position_n_m = p.position_n_m, sigma = navigation_sigma(&p.navigation, 1 / DT_S).position_m;

	(void)state;
	position_skip(&p,
		&(struct navigation_input){.q_nb = QUAT_IDENTITY, .gravity_m_s2 = G, .force_b_m_s2 = {0, 0, G}}, ZERO,
		1 / DT_S, 2);
	assert_vec_near(p.position_n_m, position_n_m, 0);
	assert_true(navigation_sigma(&p.navigation, 1 / DT_S).position_m.x > sigma.x + 2);
	assert_true(navigation_sigma(&p.navigation, 1 / DT_S).velocity_m_s.x > 2);
}

static void test_a_position_whose_sigma_exceeds_the_limit_is_reported(void **state)
{
	const struct path path = {4, {1, 0, 0}, {0, 0, 0}};
	const struct navigation_config config = levelling();
	struct position p = travel(&path, &config, 1);

	(void)state;
	assert_false(position_unsure(&p));
	p.config.sigma_limit_m = 1e-4;
	assert_true(position_unsure(&p));
	p.sigma.position_m = (struct vec3){0.3, 0, 0.4};
	p.config.sigma_limit_m = 0.5;
	assert_false(position_unsure(&p));
	position_reset(&p);
	assert_false(position_unsure(&p));
}

static void test_another_north_turns_the_velocity_with_the_attitude(void **state)
{
	struct navigation n = {.started = false};

	(void)state;
	navigation_start(&n, &BARE, QUAT_IDENTITY);
	n.velocity_n_m_s = (struct vec3){1, 0, 0};
	for (int k = 0; k < 20; k++) {
		struct navigation_input in = {.force_b_m_s2 = {0, 0, G + (k % 2 ? 3 : -3)}, .gravity_m_s2 = G};

		in.q_nb = quat_from_rotation_vector((struct vec3){0, 0, PI / 2});
		navigation_step(&n, &in, DT_S);
	}
	assert_quat_near(n.q_nb, quat_from_rotation_vector((struct vec3){0, 0, PI / 2}), 0.01);
	assert_vec_near(n.velocity_n_m_s, ((struct vec3){0, 1, 0}), 0.05);
}

/* 3 m to the east of the origin, as it was drawn; the heading of the fusion has this sigma. */
static struct navigation far_from_the_origin(double heading_rad, double heading_sigma_rad)
{
	struct navigation n = {.started = false};

	navigation_start(&n, &BARE, QUAT_IDENTITY);
	n.position_n_m = (struct vec3){3, 0, 1};
	n.velocity_n_m_s = (struct vec3){0.5, 0, 0};
	for (int k = 0; k < 20; k++) {
		struct navigation_input in = {.force_b_m_s2 = {0, 0, G + (k % 2 ? 3 : -3)}, .gravity_m_s2 = G};

		in.q_nb = quat_from_rotation_vector((struct vec3){0, 0, heading_rad});
		in.attitude_variance_rad2 = (struct vec3){1e-6, 1e-6, heading_sigma_rad * heading_sigma_rad};
		navigation_step(&n, &in, DT_S);
	}
	return n;
}

/* Where it is depends on where north is. */
static void test_while_the_heading_is_unknown_so_is_the_direction_of_the_path(void **state)
{
	struct navigation known = far_from_the_origin(0, 0.03), unknown = far_from_the_origin(0, 1.8);
	struct navigation_sigma k = navigation_sigma(&known, 1 / DT_S), u = navigation_sigma(&unknown, 1 / DT_S);

	(void)state;
	assert_true(k.position_m.x < 0.2 && k.position_m.y < 0.2);
	assert_near(u.position_m.x, 3 * sqrt(2), 0.3);
	assert_near(u.position_m.y, 3 * sqrt(2), 0.3);
	assert_near(u.position_m.z, k.position_m.z, 1e-3);
	assert_near(u.velocity_m_s.y, 0.5 * sqrt(2), 0.1);
	assert_quat_near(unknown.q_nb, QUAT_IDENTITY, 0.01);
}

static void test_another_north_leaves_the_path_behind_it_uncertain_by_its_chord(void **state)
{
	struct navigation same = far_from_the_origin(0, 0.03), turned = far_from_the_origin(2, 0.03);
	struct navigation_sigma s = navigation_sigma(&same, 1 / DT_S), t = navigation_sigma(&turned, 1 / DT_S);

	(void)state;
	assert_near(t.position_m.x, hypot(3 * 2 * sin(1), s.position_m.x), 0.2);
	assert_near(t.position_m.z, s.position_m.z, 1e-3);
	navigation_reset_position(&turned);
	assert_near(navigation_sigma(&turned, 1 / DT_S).position_m.x, 0, 1e-9);
}

static void test_a_navigation_configuration_is_checked_field_by_field(void **state)
{
	const struct navigation_config good = levelling();

	(void)state;
	assert_int_equal(navigation_check(&good), 0);
	for (int i = 0; i < 6; i++) {
		struct navigation_config c = good;
		double *const field[6] = {&c.velocity_prior_m_s, &c.rest_s, &c.noise.gyro_density_rad_s_sqrt_hz,
			&c.noise.gyro_bias_instability_rad_s, &c.noise.accel_density_m_s2_sqrt_hz,
			&c.noise.accel_bias_instability_m_s2};

		*field[i] = 0;
		assert_int_equal(navigation_check(&c), 0);
		*field[i] = -1e-9;
		assert_int_equal(navigation_check(&c), -EINVAL);
		*field[i] = (double)INFINITY;
		assert_int_equal(navigation_check(&c), -EINVAL);
	}
}

/* An object that swings to and fro after a rest, followed with levelling and with a live change to none: both are the
 * same at first. */
static void test_levelling_starts_4_s_after_the_last_standstill(void **state)
{
	struct position_config config = {.mode = POSITION_NAVIGATION, .navigation = levelling()};
	struct position with, without;
	double apart_s = 0;

	(void)state;
	assert_int_equal(position_init(&with, &config), 0);
	without = with;
	config.navigation.levelling = 0;
	for (int k = 0; k < 3000 && apart_s == 0; k++) {
		double moving_s = k * DT_S - REST_S, phase = 2 * PI * fmax(0, moving_s);
		struct navigation_input in = {.gyro_b_rad_s = {0.5 * sin(phase), 0, 0},
			.force_b_m_s2 = {5 * sin(phase), 3 * sin(phase), G},
			.q_nb = QUAT_IDENTITY,
			.gravity_m_s2 = G};

		if (k == 100)
			assert_int_equal(position_configure(&without, &config), 0);
		position_navigate(&with, &in, ZERO, 1 / DT_S, DT_S);
		position_navigate(&without, &in, ZERO, 1 / DT_S, DT_S);
		if (vec3_norm(vec3_sub(with.velocity_n_m_s, without.velocity_n_m_s)) > 0)
			apart_s = moving_s;
	}
	assert_near(apart_s, 4.2, 0.3);
}

/* Swings about the reference point, at whose end on a lever arm of 0.5 m the sensor moves with up to 1 m/s. */
static void test_a_swing_about_the_reference_point_is_no_velocity_of_it(void **state)
{
	const struct navigation_config config = levelling();
	const double w = 2 * PI, lever_m = 0.5;
	struct navigation n = {.started = false};

	(void)state;
	navigation_start(&n, &config, QUAT_IDENTITY);
	for (int k = 0; k < (int)(8 / DT_S); k++) {
		double t = k * DT_S, rate = 2 * sin(w * t), angle = 2 / w * (1 - cos(w * t));
		struct navigation_input in = {.gyro_b_rad_s = {0, 0, rate},
			.force_b_m_s2 = {-lever_m * rate * rate, lever_m * 2 * w * cos(w * t), G},
			.lever_b_m = {lever_m, 0, 0},
			.q_nb = quat_from_rotation_vector((struct vec3){0, 0, angle}),
			.gravity_m_s2 = G};

		navigation_step(&n, &in, DT_S);
	}
	assert_false(n.still);
	assert_true(sqrt(n.high_pass2_max) < 0.5);
}

/* ---- what the errors are assumed to be, in closed form ----------------------------------------------------------- */

static const struct noise_config NOISE = {.gyro_density_rad_s_sqrt_hz = 2e-3,
	.gyro_bias_instability_rad_s = 1e-3,
	.accel_density_m_s2_sqrt_hz = 0.02,
	.accel_bias_instability_m_s2 = 0.03};

static struct navigation started(enum motion_preset preset)
{
	struct navigation_config config = BARE;
	struct navigation n = {.started = false};

	config.preset = preset;
	config.noise = NOISE;
	navigation_start(&n, &config, QUAT_IDENTITY);
	return n;
}

/* One interval, in which it turns at this rate and accelerates so; the fusion agrees with the navigation. */
static double one_interval(struct navigation *n, struct vec3 rate_b_rad_s, struct vec3 accel_n_m_s2)
{
	double t_s = 0;
	bool ended = false;

	while (!ended) {
		struct navigation_input in = {
			.gyro_b_rad_s = vec3_add(rate_b_rad_s, n->gyro_bias_b_rad_s), .gravity_m_s2 = G};

		in.q_nb = quat_multiply(n->q_nb, quat_from_rotation_vector(vec3_scale(1e-3, rate_b_rad_s)));
		in.force_b_m_s2 = vec3_add(quat_rotate_inverse(in.q_nb, vec3_add(accel_n_m_s2, (struct vec3){0, 0, G})),
			n->accel_bias_b_m_s2);
		ended = navigation_step(n, &in, 1e-3);
		t_s += 1e-3;
	}
	return t_s;
}

static void assert_sigma(const struct navigation *n, int at, double sigma)
{
	for (int i = at; i < at + 3; i++)
		assert_near(sqrt(n->p[i][i]) / sigma, 1, 0.01);
}

/* 2 degrees, 0.1 m/s, 0.3 deg/s, 6 mg; 3 mg where the motion goes to and fro. */
static void test_at_the_start_nothing_is_known_better_than_after_a_calibration(void **state)
{
	const struct navigation robot = started(MOTION_ANY), hand = started(MOTION_HAND_HELD);

	(void)state;
	assert_sigma(&robot, NAVIGATION_THETA, 2.005 * RAD_PER_DEG);
	assert_sigma(&robot, NAVIGATION_V, 0.1);
	assert_sigma(&robot, NAVIGATION_BG, 0.2865 * RAD_PER_DEG);
	assert_sigma(&robot, NAVIGATION_BA, 0.06);
	assert_sigma(&hand, NAVIGATION_BA, 0.03);
}

/* White noise integrates to density^2 / 2 t; errors of scale and alignment walk by 0.1 % of the motion per sqrt(s), a
 * third of it on each axis; the biases by their instability within 100 s, and the accelerometer's as it turns in
 * gravity. */
static void test_noise_and_errors_of_scale_add_up_within_an_interval(void **state)
{
	const struct vec3 rate = {20, -30, 10}, accel = {20, 10, -15};
	const double rate2 = 1400, accel2 = 725;
	struct navigation n = started(MOTION_HAND_HELD);
	double t;

	(void)state;
	memset(n.p, 0, sizeof(n.p));
	t = one_interval(&n, rate, accel);
	assert_near(n.p[0][0] / (2e-6 * t + 1e-6 * rate2 * t / 3), 1, 0.01);
	assert_near(n.p[1][1] / (2e-6 * t + 1e-6 * rate2 * t / 3), 1, 0.01);
	for (int i = 0; i < 3; i++) {
		const int v = NAVIGATION_V + i, p = NAVIGATION_P + i, bg = NAVIGATION_BG + i, ba = NAVIGATION_BA + i;

		assert_near(n.p[v][v] / (2e-4 * t + 1e-6 * accel2 * t / 3), 1, 0.01);
		/* 0.3 % of the way, a / 2 t^2, too */
		assert_near(n.p[p][p] / (2e-4 * t * t * t / 3 + 9e-6 * accel2 * pow(t, 4) / 4), 1, 0.01);
		assert_near(n.p[p][v] / (2e-4 * t * t / 2), 1, 0.01);
		assert_near(n.p[v][p] / (2e-4 * t * t / 2), 1, 0.01);
		assert_near(n.p[bg][bg] / (1e-6 * t / 100), 1, 0.01);
		assert_near(n.p[ba][ba] / (9e-4 * t / 100 + 1e-6 * G * G * rate2 * t / 3), 1, 0.01);
	}
}

/* The heading of the fusion has an error of 2 degrees for 3 s: as a measurement in each interval, that sigma less
 * often. */
static void test_the_fusions_heading_counts_with_2_degrees_once_in_3_s(void **state)
{
	struct navigation n = started(MOTION_HAND_HELD);
	const double before = pow(10 * RAD_PER_DEG, 2);
	double t, noise;

	(void)state;
	memset(n.p, 0, sizeof(n.p));
	n.config.noise = (struct noise_config){0};
	n.p[NAVIGATION_THETA + 2][NAVIGATION_THETA + 2] = before;
	t = one_interval(&n, ZERO, (struct vec3){3, 0, 0});
	noise = pow(2.005 * RAD_PER_DEG, 2) * 3 / t;
	assert_near(n.p[2][2] / (before * noise / (before + noise)), 1, 0.002);
}

/* At rest until it stands. Then nothing has an error but the velocity, 1 m/s each, and the gyro bias, 1 rad/s. */
static struct navigation standing(enum motion_preset preset, struct vec3 rate_b_rad_s, struct vec3 accel_n_m_s2)
{
	struct navigation n = started(preset);

	for (int k = 0; k < 200; k++)
		one_interval(&n, rate_b_rad_s, accel_n_m_s2);
	assert_true(n.still);
	memset(n.p, 0, sizeof(n.p));
	for (int i = 0; i < 3; i++)
		n.p[NAVIGATION_V + i][NAVIGATION_V + i] = n.p[NAVIGATION_BG + i][NAVIGATION_BG + i] = 1;
	return n;
}

/* 0.01 m/s; of a foot that rolls about a point 0.1 m away, and accelerates for 0.1 s, 0.03 m/s and those. By a hand
 * it does not turn: the mean rate is the gyro's bias but for its white noise and 1e-5 rad/s. */
static void test_a_standstill_by_dwell_is_measured_with_what_may_still_move(void **state)
{
	const struct vec3 rate = {0.02, 0, 0}, accel = {0.1, 0, 0};
	const struct {
		enum motion_preset preset;
		struct vec3 rate, accel;
		double sigma;
	} cases[] = {{MOTION_HAND_HELD, ZERO, ZERO, 0.01}, {MOTION_FOOT, ZERO, ZERO, 0.03},
		{MOTION_FOOT, rate, ZERO, hypot(0.03, 0.002)}, {MOTION_FOOT, ZERO, accel, hypot(0.03, 0.01)}};

	(void)state;
	for (int i = 0; i < 4; i++) {
		struct navigation n = standing(cases[i].preset, cases[i].rate, cases[i].accel);
		double t, bias2;

		n.config.noise.accel_density_m_s2_sqrt_hz = n.config.noise.gyro_bias_instability_rad_s = 0;
		n.accel_bias_b_m_s2 = ZERO;
		t = one_interval(&n, cases[i].rate, cases[i].accel);
		bias2 = 4e-6 / 2 / t + 1e-10;
		assert_near(sqrt(n.p[NAVIGATION_V][NAVIGATION_V]) / cases[i].sigma, 1, 0.002);
		if (i == 0)
			assert_near(n.p[NAVIGATION_BG + 1][NAVIGATION_BG + 1] / bias2, 1, 0.01);
	}
}

/* After 5 s of movement the velocity is measured as zero ten times a second, with a sigma for each axis of its greatest
 * high-pass: of motions whose greatest square is 3.3 times the mean; and 0.05 m/s. */
static void test_levelling_measures_the_velocity_by_its_spread(void **state)
{
	static const struct {
		double moving_s, high_pass2_max, prior_m_s;
	} cases[] = {{3.5, 1, 0}, {4.5, 1, 0}, {5.5, 1, 0}, {6.5, 0, 0}, {6.5, 1, 0}, {60, 4, 0}, {0.5, 1, 0.3}};

	(void)state;
	for (int i = 0; i < 7; i++) {
		struct navigation n = started(MOTION_HAND_HELD);
		double t, weight, noise;

		memset(n.p, 0, sizeof(n.p));
		n.config.noise = (struct noise_config){0};
		n.config.velocity_prior_m_s = cases[i].prior_m_s;
		n.p[NAVIGATION_V][NAVIGATION_V] = 1;
		n.moving_s = cases[i].moving_s;
		n.high_pass2_max = cases[i].high_pass2_max;
		t = one_interval(&n, ZERO, (struct vec3){0.5, 0, 0});
		assert_true(!n.still && n.high_pass2_max < cases[i].high_pass2_max + 0.01);
		weight = fmax(0, fmin((cases[i].moving_s + t - 4) / 2, 1)); /* it rises from 4 to 6 s */
		noise = (n.high_pass2_max / 3 / 3.3 + 0.05 * 0.05) * 0.05 / t;
		if (cases[i].prior_m_s > 0) {
			weight = 1;
			noise = cases[i].prior_m_s * cases[i].prior_m_s * 0.05 / t;
		}
		assert_near(n.p[NAVIGATION_V][NAVIGATION_V], noise / (weight + noise), 1e-3);
	}
}

/* To and fro: the spread is that of the fastest moment, not of the last one. A high-pass of a second takes away what is
 * constant. */
static void test_the_spread_is_that_of_the_fastest_moment(void **state)
{
	struct navigation n = started(MOTION_HAND_HELD);
	double most = 0, velocity = 0;

	(void)state;
	for (int k = 0; k < 100; k++) {
		const double accel = (k < 50 ? 3 : 1) * sin(0.3 * k),
			     t = one_interval(&n, ZERO, (struct vec3){accel, 0, 0});

		velocity = (velocity + accel * t) / (1 + t);
		most = fmax(most, velocity * velocity);
		assert_near(n.high_pass_n_m_s.x, velocity, 0.01);
		assert_near(sqrt(n.high_pass2_max), sqrt(most), 0.01);
	}
	assert_true(most > 0.05);
}

/* The bias at a standstill differs from that in the movement by 0.006 of the acceleration, as far as it has turned
 * within 0.3 s. */
static void test_at_the_end_of_a_movement_the_accelerometers_bias_is_less_certain_by_its_motion(void **state)
{
	(void)state;
	for (int fast = 0; fast < 2; fast++) {
		struct navigation n = started(MOTION_ANY);
		const double rate2 = fast ? 25 : 4, accel2 = 100, moved_s = 1000;

		memset(n.p, 0, sizeof(n.p));
		n.config.noise = (struct noise_config){0};
		n.moved_s = moved_s;
		n.moved_accel2_m2_s3 = accel2 * moved_s;
		n.moved_turned2_rad2_s = rate2 * moved_s;
		n.zero_velocity.standing_s = 1;		  /* as seen by the last correction */
		n.zero_velocity.fast_vibration_m2_s2 = 1; /* the first measurement of zero tells nothing of it */
		one_interval(&n, ZERO, ZERO);
		assert_true(n.still);
		assert_near(sqrt(n.p[NAVIGATION_BA][NAVIGATION_BA]) / (0.006 * 10 * (fast ? 1 : 0.3 * 2)), 1, 0.02);
	}
}

/* Its interval is longer by 5 ms, in which the acceleration grows by 3 m/s^2: the velocity is that of an even growth,
 * and may be wrong by as much as that is less. In intervals of one length nothing is added. */
static void test_over_missing_samples_the_acceleration_changes_evenly(void **state)
{
	const double dt_s = 0.01, longer_s[] = {0, 0.005, -0.005};

	(void)state;
	for (int i = 0; i < 3; i++) {
		const double by_growth_m_s = i == 1 ? longer_s[i] / 2 * 3 : 0;
		struct navigation n = started(MOTION_ANY);
		struct navigation_input in = {.q_nb = QUAT_IDENTITY, .gravity_m_s2 = G, .force_b_m_s2 = {1, 0, G}};
		double variance;

		navigation_step(&n, &in, dt_s);
		in.force_b_m_s2.x = 4;
		variance = n.p[NAVIGATION_V][NAVIGATION_V];
		navigation_step(&n, &in, dt_s + longer_s[i]);
		assert_near(n.velocity_n_m_s.x, dt_s * 1 + (dt_s + longer_s[i]) * 4 - by_growth_m_s, 1e-12);
		assert_near(n.p[NAVIGATION_V][NAVIGATION_V] - variance, by_growth_m_s * by_growth_m_s, 1e-12);
	}
}

/* A hand or a robot may have accelerated at 2 m/s^2 meanwhile, or as it does now, and went on with its velocity. */
static void test_after_a_gap_sigma_has_grown_by_what_may_have_happened(void **state)
{
	const double gap_s = 1.5, v2 = 9 + 4, var[3] = {0.01, 0.02, 0.09};

	(void)state;
	for (int i = 0; i < 4; i++) {
		const struct navigation_input in = {
			.q_nb = quat_from_rotation_vector((struct vec3){0, i == 3 ? PI / 2 : 0, 0}),
			.attitude_variance_rad2 = {var[0], var[1], var[2]},
			.gravity_m_s2 = G,
			.force_b_m_s2 = {i == 1	  ? 8
					 : i == 3 ? -G
						  : 0,
				0,
				i == 2	 ? G - 6
				: i == 3 ? 1
					 : G}};
		const double accel = i == 1 ? 8 : i == 2 ? 6 : 2;
		struct navigation n = started(MOTION_ANY);

		memset(n.p, 0, sizeof(n.p));
		n.velocity_n_m_s = (struct vec3){3, -2, 0};
		navigation_skip(&n, &in, gap_s);
		for (int axis = 0; axis < 3; axis++)
			assert_near(n.p[axis][axis], var[axis], 1e-12);
		assert_sigma(&n, NAVIGATION_V, accel * gap_s);
		assert_sigma(&n, NAVIGATION_P, gap_s * hypot(sqrt(v2), accel * gap_s));
		assert_near(navigation_sigma(&n, 100).attitude_rad.x, 0.1, 1e-9);
	}
}

/* An alias that is found is a constant velocity since it began: both errors are one, which grows with the time. Where
 * it ends, its sine is left. */
static void test_what_may_be_an_alias_is_an_error_of_velocity_and_position_as_long_as_it_lasts(void **state)
{
	struct navigation n = started(MOTION_ANY);
	int found = 0, ended = 0;

	(void)state;
	for (int k = 0; k < 2400; k++) {
		const double t = k * DT_S, a = k < 1600 ? sin(2 * PI * t) : 0.3 * sin(0.3 * t);
		const struct navigation_input in = {
			.force_b_m_s2 = {a, 0, G}, .q_nb = QUAT_IDENTITY, .gravity_m_s2 = G};
		struct navigation none = n;

		none.alias = (struct alias){.velocity_m_s = {0}};
		navigation_step(&n, &in, DT_S);
		navigation_step(&none, &in, DT_S);
		const struct alias *alias = &n.alias;
		const double began_s = fmin(alias->found_s[0], n.moved_s), v2 = pow(alias->velocity_m_s[0], 2),
			     vv = n.p[NAVIGATION_V][NAVIGATION_V] - none.p[NAVIGATION_V][NAVIGATION_V],
			     pv = n.p[NAVIGATION_P][NAVIGATION_V] - none.p[NAVIGATION_P][NAVIGATION_V],
			     vp = n.p[NAVIGATION_V][NAVIGATION_P] - none.p[NAVIGATION_V][NAVIGATION_P],
			     pp = n.p[NAVIGATION_P][NAVIGATION_P] - none.p[NAVIGATION_P][NAVIGATION_P];

		if (n.still || vv == 0)
			continue;
		if (alias->found_s[0] > 0) {
			found++;
			assert_near(vv, v2, 1e-9 + 1e-3 * v2);
			assert_near(pv, v2 * began_s, 1e-9 + 1e-3 * v2 * began_s);
			assert_near(vp, v2 * began_s, 1e-9 + 1e-3 * v2 * began_s);
			assert_near(pp, v2 * began_s * began_s, 1e-9 + 1e-3 * v2 * began_s * began_s);
		} else if (alias->ended_m_s[0] > 0) {
			ended++;
			assert_near(vv, pow(alias->ended_m_s[0], 2), 1e-9);
			assert_near(pp, pow(alias->ended_m[0], 2), 1e-9);
			assert_near(pv, 0, 1e-9);
		}
	}
	assert_true(found > 0);
	assert_int_equal(ended, 1);
}

/* In motion the bias differs by 0.02 deg/s from that at rest. */
static void test_a_gyro_bias_is_less_certain_in_motion_than_at_the_rest_before(void **state)
{
	struct navigation n = started(MOTION_HAND_HELD);

	(void)state;
	for (int k = 0; k < 200; k++)
		one_interval(&n, ZERO, ZERO);
	assert_true(n.still);
	n.config.noise = (struct noise_config){0};
	for (int i = NAVIGATION_BG; i < NAVIGATION_BG + 3; i++)
		n.p[i][i] = 1e-12;
	while (n.still)
		one_interval(&n, (struct vec3){1, 1, 1}, (struct vec3){2, 0, 0});
	assert_sigma(&n, NAVIGATION_BG, 0.02005 * RAD_PER_DEG);
}

/* The innovation is the difference of all axes: beyond 5 sigma, of both, the aid replaces the velocity. */
static void test_an_aided_velocity_beyond_5_sigma_replaces_the_velocity(void **state)
{
	const double sigma = 0.3, own = 0.4, limit = 5 * sqrt(3 * (sigma * sigma + own * own));

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct navigation n = started(MOTION_ANY);
		const struct vec3 aid = {(i ? 1.01 : 0.99) * limit, 0, 0};

		for (int k = 0; k < N; k++)
			for (int j = 0; j < N; j++)
				n.p[k][j] = k == j ? own * own : 0;
		navigation_aid_velocity(&n, aid, sigma, ZERO, ZERO);
		/* within: weighed by the variances */
		assert_near(n.velocity_n_m_s.x, i ? aid.x : aid.x * own * own / (own * own + sigma * sigma), 1e-9);
		assert_near(sqrt(n.p[NAVIGATION_V][NAVIGATION_V]), i ? sigma : own * sigma / hypot(own, sigma), 1e-9);
	}
}

/* One of more than 3 sigma and 0.01 m/s is that of a motion, which no steady signal contradicts for 5 s. */
static void test_an_aided_motion_is_no_standstill_for_5_s(void **state)
{
	const double speeds_m_s[] = {0.3, 0.32};

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct navigation n = started(MOTION_HAND_HELD);
		double t = 0;

		for (int k = 0; k < 200; k++)
			one_interval(&n, ZERO, ZERO);
		assert_true(n.still);
		navigation_aid_velocity(&n, (struct vec3){0, speeds_m_s[i], 0}, 0.1, ZERO, ZERO);
		do
			t += one_interval(&n, ZERO, ZERO);
		while (!n.still && t < 10);
		if (i)
			assert_true(t >= 5 && t < 7);
		else
			assert_true(t < 0.1);
	}
}

/* What has been integrated without zero-velocity updates since the object stood is taken over as it is. */
static void test_when_a_motion_begins_position_and_velocity_are_those_since_it_stood(void **state)
{
	struct navigation n = started(MOTION_ANY);
	struct zero_velocity_fork *fork = &n.zero_velocity.forks[ZERO_VELOCITY_FORKS - 1];

	(void)state;
	n.config.noise = (struct noise_config){.gyro_density_rad_s_sqrt_hz = 1e-5, .accel_density_m_s2_sqrt_hz = 1e-3};
	for (int k = 0; k < 400 && !fork->set; k++)
		one_interval(&n, ZERO, ZERO);
	assert_true(n.still && fork->set);
	fork->position_n_m = (struct vec3){1, 2, 3};
	fork->velocity_n_m_s = (struct vec3){0.5, -0.4, 0.3};
	one_interval(&n, ZERO, ZERO);
	assert_false(n.still);
	assert_vec_near(n.velocity_n_m_s, ((struct vec3){0.5, -0.4, 0.3}), 0.01);
	assert_vec_near(n.position_n_m, ((struct vec3){1, 2, 3}), 0.05);
}

static void test_a_set_attitude_is_known_to_a_degree(void **state)
{
	struct navigation n = started(MOTION_ANY);

	(void)state;
	navigation_set_attitude(&n, QUAT_IDENTITY);
	assert_sigma(&n, NAVIGATION_THETA, 1.003 * RAD_PER_DEG);
}

/* 0.1 rad are 1 m/s^2 of gravity. A heading turns with the fusion's from 20 degrees on. */
static void test_a_tilt_or_a_heading_too_far_from_the_fusions_starts_again_from_it(void **state)
{
	const double tilts_rad[] = {0.095, 0.105}, headings_rad[] = {0.34, 0.36};

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct navigation n = started(MOTION_ANY);
		struct navigation_input in = {.force_b_m_s2 = {0, 0, G}, .gravity_m_s2 = G};

		in.q_nb = quat_from_rotation_vector((struct vec3){tilts_rad[i], 0, 0});
		while (!navigation_step(&n, &in, 1e-3))
			;
		assert_near(quat_apart_rad(n.q_nb, in.q_nb), i ? 0 : tilts_rad[i], 0.002);
		if (i)
			assert_sigma(&n, NAVIGATION_V, 1);

		n = started(MOTION_ANY);
		in.q_nb = quat_from_rotation_vector((struct vec3){0, 0, headings_rad[i]});
		while (!navigation_step(&n, &in, 1e-3))
			;
		assert_near(quat_apart_rad(n.q_nb, in.q_nb), i ? 0 : headings_rad[i], 0.03);
	}
}

/* Of an acceleration: gravity times the tilt about the other axis, noise, and a bias; of the heading: that of north,
 * too. */
static void test_the_sigmas_of_acceleration_and_attitude_follow_from_tilt_noise_and_bias(void **state)
{
	struct navigation n = started(MOTION_ANY);
	struct navigation_sigma s;
	double force2 = 0.02 * 0.02 * 100 / 2 + (0.01 + 0.04 + 0.09) / 3;

	(void)state;
	n.gravity_m_s2 = G;
	n.fusion_variance_rad2 = (struct vec3){1e-4, 4e-4, 9e-4};
	for (int i = 0; i < 3; i++)
		n.p[NAVIGATION_BA + i][NAVIGATION_BA + i] = pow(0.1 * (i + 1), 2);
	s = navigation_sigma(&n, 100);
	assert_vec_near(s.accel_m_s2,
		((struct vec3){sqrt(G * G * 4e-4 + force2), sqrt(G * G * 1e-4 + force2), sqrt(force2)}), 1e-9);
	assert_vec_near(s.attitude_rad, ((struct vec3){0.01, 0.02, hypot(0.03, 1.49 * RAD_PER_DEG)}), 1e-4);
	n.fusion_variance_rad2 = ZERO; /* unknown: this filter's, their difference, and what the bias tilts */
	n.fusion_difference2_rad2 = (struct vec3){1e-4, 2e-4, 3e-4};
	for (int i = 0; i < 3; i++)
		n.p[i][i] = 1e-4 * (i + 1);
	s = navigation_sigma(&n, 100);
	assert_near(s.attitude_rad.x, sqrt(2e-4 + 0.14 / 3 / (G * G)), 1e-9);
	assert_near(s.attitude_rad.y, sqrt(4e-4 + 0.14 / 3 / (G * G)), 1e-9);
	assert_near(s.attitude_rad.z, sqrt(6e-4 + pow(1.49 * RAD_PER_DEG, 2)), 1e-4);
}

/* Published is zero: a support vibrates, and what turns in place may creep at 3 cm/s. */
static void test_the_velocity_at_a_standstill_is_known_to_the_vibration_and_to_a_creeping_turn(void **state)
{
	struct navigation n = started(MOTION_ANY);

	(void)state;
	memset(n.p, 0, sizeof(n.p));
	n.noise = n.config.noise = (struct noise_config){0};
	n.zero_velocity.vibration_m2_s2 = 4e-4;
	assert_vec_near(navigation_sigma(&n, 100).velocity_m_s, ZERO, 1e-12); /* in motion it is part of the velocity */
	n.still = true;
	assert_vec_near(navigation_sigma(&n, 100).velocity_m_s, ((struct vec3){0.02, 0.02, 0.02}), 1e-12);
	n.turning = true;
	assert_near(navigation_sigma(&n, 100).velocity_m_s.y, hypot(0.02, 0.03), 1e-12);
}

/* Six sigmas of the velocity that the sensors' noise leaves unknown after a second, 1 and 2 mm/s beside that: what
 * begins to move more slowly may not be seen. It matters as far as the preset knows slower motions. */
static void test_what_stands_may_creep_as_fast_as_noisy_sensors_do_not_show(void **state)
{
	const struct {
		struct noise_config noise;
		enum motion_preset preset;
		double creep_m_s;
	} cases[] = {{{.accel_bias_instability_m_s2 = 0.002}, MOTION_ANY, 0},
		{{.accel_bias_instability_m_s2 = 0.0025}, MOTION_ANY, sqrt(36 * (5e-6 + 0.005 * 0.005) - 9e-4)},
		{{.accel_density_m_s2_sqrt_hz = 0.01}, MOTION_ANY, sqrt(36 * (5e-6 + 0.01 * 0.01 / 2) - 9e-4)},
		{{.gyro_density_rad_s_sqrt_hz = 0.002}, MOTION_ANY, sqrt(36 * (5e-6 + G * G * 4e-6 / 6) - 9e-4)},
		{{.accel_bias_instability_m_s2 = 0.0025}, MOTION_ROBOT_BASE, 0},
		{{.accel_bias_instability_m_s2 = 0.0025}, MOTION_HAND_HELD, 0}};

	(void)state;
	for (int i = 0; i < 6; i++) {
		const struct navigation_config config = {.preset = cases[i].preset,
			.rest_s = 1.5,
			.noise = cases[i].noise,
			.standstill = STANDSTILL_DEFAULTS};
		struct navigation n = {.started = false};
		struct vec3 after_10_s = ZERO;

		navigation_start(&n, &config, QUAT_IDENTITY);
		for (int k = 0; k < (int)(20 / DT_S); k++) {
			struct navigation_input in = {
				.force_b_m_s2 = {0, 0, G}, .gravity_m_s2 = G, .q_nb = QUAT_IDENTITY};

			navigation_step(&n, &in, DT_S);
			if (k == (int)(10 / DT_S))
				after_10_s = navigation_sigma(&n, 1 / DT_S).position_m;
		}
		assert_true(n.still);
		assert_near(navigation_sigma(&n, 1 / DT_S).velocity_m_s.x, cases[i].creep_m_s, 0.003);
		assert_near(navigation_sigma(&n, 1 / DT_S).position_m.y - after_10_s.y, 10 * cases[i].creep_m_s, 0.01);
		for (int k = 0; k < 20 && n.config.preset != MOTION_HAND_HELD;
			k++) { /* the next standstill is another */
			n.still = false;
			navigation_step(&n,
				&(struct navigation_input){
					.force_b_m_s2 = {3, 0, G}, .gravity_m_s2 = G, .q_nb = QUAT_IDENTITY},
				DT_S);
		}
		assert_near(n.crept_s, 0, 0);
	}
}

/* Axis by axis, with parts of which no two have the same sum. */
static void test_the_sigmas_of_position_and_velocity_are_the_roots_of_the_sums_of_their_parts(void **state)
{
	(void)state;
	for (int still = 0; still < 2; still++) {
		struct navigation n = {.started = false};
		struct navigation_sigma sigma;

		navigation_start(&n, &BARE, QUAT_IDENTITY);
		memset(n.p, 0, sizeof n.p);
		n.still = still;
		n.gravity_m_s2 = G;
		n.earlier_variance_m2 = (struct vec3){1, 2, 3};
		n.zero_velocity.position_variance_m2 = (struct vec3){40, 50, 60};
		n.zero_velocity.velocity_variance_m2_s2 = (struct vec3){4, 5, 6};
		n.zero_velocity.vibration_m2_s2 = 1000;
		for (int i = 0; i < 3; i++) {
			n.p[NAVIGATION_V + i][NAVIGATION_V + i] = 0.1 * (i + 1);
			n.p[NAVIGATION_P + i][NAVIGATION_P + i] = 100 * (i + 1);
			n.alias.position_m[i] = 20 + i;
			n.alias.velocity_m_s[i] = 7 + i;
		}
		sigma = navigation_sigma(&n, 200);
		assert_vec_near(
			sigma.displacement_m, ((struct vec3){sqrt(140 + 400), sqrt(250 + 441), sqrt(360 + 484)}), 1e-9);
		assert_vec_near(
			sigma.position_m, ((struct vec3){sqrt(141 + 400), sqrt(252 + 441), sqrt(363 + 484)}), 1e-9);
		assert_vec_near(sigma.velocity_m_s,
			(still ? (struct vec3){sqrt(1004.1), sqrt(1005.2), sqrt(1006.3)}
			       : (struct vec3){sqrt(4.1 + 49), sqrt(5.2 + 64), sqrt(6.3 + 81)}),
			1e-9);
	}
}

/* What the filter learns of tilt and bias holds for the windows of the rope that it has integrated with the wrong ones:
 * the specific force turns with the attitude. */
static void test_a_correction_of_the_attitude_turns_the_forces_of_a_rope(void **state)
{
	const struct vec3 force = {1, 2, 3};
	struct navigation_config config = BARE;
	struct navigation n = {.started = false};
	struct vec3 theta;

	(void)state;
	config.preset = MOTION_HANGING_LOAD;
	navigation_start(&n, &config, QUAT_IDENTITY);
	n.gravity_m_s2 = G;
	n.rope.window[0].sums.f = force;
	memset(n.p, 0, sizeof n.p);
	for (int i = 0; i < 3; i++) { /* the velocity is off by 0.1 s of a tilt */
		n.p[i][i] = 1e-4;
		n.p[NAVIGATION_V + i][NAVIGATION_V + i] = 1e-6;
		n.p[i][NAVIGATION_V + i] = n.p[NAVIGATION_V + i][i] = 1e-5;
	}
	navigation_aid_velocity(&n, (struct vec3){1e-3, -2e-3, 1e-3}, 1e-3, ZERO, ZERO);
	theta = quat_to_rotation_vector(n.q_nb);
	assert_true(vec3_norm(theta) > 1e-3);
	assert_vec_near(n.rope.window[0].sums.f, quat_rotate(n.q_nb, force), vec3_dot(theta, theta) * vec3_norm(force));
}

/* A share of 0.3 % of the angle, or what is told of an uncalibrated gyro: about the axis of the turn, and by alignment
 * about the others until it has turned by 2 rad. To and fro averages out, as random turns of 0.1 % do. */
static void test_a_turn_in_one_direction_leaves_a_share_of_its_angle_behind(void **state)
{
	const double rate = 20, shares[] = {0.003, 0.01};

	(void)state;
	for (int i = 0; i < 2; i++)
		for (int far = 0; far < 2; far++) {
			struct navigation n = started(MOTION_ANY);
			const double from = far ? 3 : 0;
			double t, random, variance;

			n.config.noise = (struct noise_config){0};
			n.config.gyro_scale_sigma = i ? shares[i] : 0;
			memset(n.p, 0, sizeof(n.p));
			n.net_turn_b_rad.x = from;
			n.net_turn2_max_rad2 = from * from;
			t = one_interval(&n, (struct vec3){rate, 0, 0}, ZERO);
			random = pow(shares[i] / 3, 2) * rate * rate * t / 3;
			variance = pow(shares[i], 2) * (pow(from + rate * t, 2) - from * from);
			assert_near(n.p[0][0] / (random + variance), 1, 0.01);
			assert_near(n.p[1][1] / (random + (far ? 0 : variance)), 1, 0.01);
			variance = n.p[0][0];
			t = one_interval(&n, (struct vec3){-rate, 0, 0}, ZERO); /* back */
			assert_near(n.p[0][0] / (variance + random), 1, 0.01);
		}
}

/* ---- what is forgotten ---- */

/* A navigation that has been through everything, and its variances depend on one another. */
static struct navigation used_navigation(bool still)
{
	struct navigation n = {.started = false};

	navigation_start(&n, &BARE, QUAT_IDENTITY);
	for (int i = 0; i < N; i++)
		for (int j = 0; j < N; j++)
			n.p[i][j] = i == j ? i + 1 : 0.01;
	n.velocity_n_m_s = (struct vec3){1, 2, 3};
	n.position_n_m = n.earlier_variance_m2 = n.way_from_n_m = (struct vec3){4, 5, 6};
	n.way2_max_m2 = 7;
	n.still = still;
	n.stood = true;
	n.ended_by_reset = !still;
	n.reset_in_motion = still;
	n.last_known = n.lever_known = n.lever_from_known = n.guide.holds = n.rest.started = true;
	n.sums.t_s = n.sums.f.x = n.sums.s.m[1][1] = 8;
	n.rope.full = n.rope.steady = 2;
	n.alias.velocity_m_s[1] = n.alias.position_m[2] = n.alias.axes[0].time_s = 9;
	return n;
}

static void assert_no_sums(const struct navigation *n)
{
	const struct navigation_sums none = {.t_s = 0};

	assert_memory_equal(&n->sums, &none, sizeof none);
}

/* Known with this variance, and nothing else depends on it. */
static void assert_variance(const struct navigation *n, int at, double variance)
{
	for (int i = at; i < at + 3; i++)
		for (int j = 0; j < N; j++) {
			assert_near(n->p[i][j], i == j ? variance : 0, 1e-12);
			assert_near(n->p[j][i], i == j ? variance : 0, 1e-12);
		}
}

static void test_a_position_that_is_reset_is_known(void **state)
{
	(void)state;
	for (int still = 0; still < 2; still++) {
		struct navigation n = used_navigation(still);

		navigation_reset_position(&n);
		assert_vec_near(n.position_n_m, ZERO, 0);
		assert_vec_near(n.earlier_variance_m2, ZERO, 0);
		assert_vec_near(n.way_from_n_m, ZERO, 0);
		assert_variance(&n, NAVIGATION_P, 0);
		assert_near(n.p[NAVIGATION_V][NAVIGATION_V], NAVIGATION_V + 1, 0);
		assert_vec_near(n.velocity_n_m_s, ((struct vec3){1, 2, 3}), 0);
		assert_true(n.way2_max_m2 == 0 && !n.lever_from_known);
		assert_int_equal(n.ended_by_reset, still);
		assert_int_equal(n.reset_in_motion, !still);
	}
}

/* A quarter turn about z. */
static void test_with_an_attitude_that_was_set_the_velocity_turns_and_what_was_integrated_is_void(void **state)
{
	const struct quat quarter = quat_from_rotation_vector((struct vec3){0, 0, PI / 2});
	struct navigation n = used_navigation(false);

	(void)state;
	navigation_set_attitude(&n, quarter);
	assert_quat_near(n.q_nb, quarter, 1e-12);
	assert_vec_near(n.velocity_n_m_s, ((struct vec3){-2, 1, 3}), 1e-12);
	assert_vec_near(n.position_n_m, ((struct vec3){4, 5, 6}), 0);
	assert_variance(&n, NAVIGATION_THETA, n.p[0][0]);
	assert_near(n.p[NAVIGATION_V][NAVIGATION_V], NAVIGATION_V + 1, 0);
	assert_false(n.last_known || n.guide.holds || n.lever_from_known || n.rope.full || n.rope.steady);
	assert_no_sums(&n);
}

/* The acceleration in the gap is unknown: the velocity is less certain by twice as much after twice the time, and the
 * position by what it may be times that. */
static void test_what_was_integrated_before_missing_samples_is_void(void **state)
{
	const struct quat quarter = quat_from_rotation_vector((struct vec3){0, 0, PI / 2});
	double by_gap[2];

	(void)state;
	for (int i = 0; i < 2; i++) {
		const double gap_s = i ? 12 : 6; /* after 10 s nobody knows any more whether it stood */
		struct navigation n = used_navigation(true);
		double v;

		navigation_skip(&n,
			&(struct navigation_input){.q_nb = quarter, .gravity_m_s2 = G, .force_b_m_s2 = {0, 0, G}},
			gap_s);
		assert_quat_near(n.q_nb, quarter, 0);
		assert_variance(&n, NAVIGATION_THETA, n.p[0][0]);
		assert_vec_near(n.velocity_n_m_s, ((struct vec3){1, 2, 3}), 0);
		assert_vec_near(n.position_n_m, ((struct vec3){4, 5, 6}), 0);
		v = n.p[NAVIGATION_V + 1][NAVIGATION_V + 1] - (NAVIGATION_V + 2);
		by_gap[i] = sqrt(v);
		assert_near(n.p[NAVIGATION_P][NAVIGATION_P] - (NAVIGATION_P + 1), gap_s * gap_s * (14 + v), 1e-9);
		assert_int_equal(n.stood, gap_s < 10);
		assert_false(n.still || n.ended_by_reset || n.last_known || n.lever_known || n.guide.holds);
		assert_false(n.rest.started || n.rope.full || n.rope.steady);
		assert_true(n.alias.velocity_m_s[1] == 0 && n.alias.position_m[2] == 0 && n.alias.axes[0].time_s == 0);
		assert_no_sums(&n);
	}
	assert_near(by_gap[1], 2 * by_gap[0], 1e-9);
}

/* The displacement begins at zero, and what was uncertain of the position before it is kept apart. */
static void test_a_movement_that_begins_knows_nothing_of_the_one_before(void **state)
{
	const struct navigation_input in = {
		.gyro_b_rad_s = {2, 0, 0}, .force_b_m_s2 = {0, 0, G}, .q_nb = QUAT_IDENTITY, .gravity_m_s2 = G};
	struct navigation n = used_navigation(true);

	(void)state;
	n.sums = (struct navigation_sums){.t_s = 0};
	n.reset_in_motion = false;
	n.stood_s = 2;
	n.movements = 3;
	n.high_pass_n_m_s = (struct vec3){1, 2, 3};
	n.high_pass2_max = n.moving_s = 9;
	navigation_step(&n, &in, 1e-3);
	assert_false(n.still);
	assert_int_equal(n.movements, 4);
	assert_vec_near(n.begin_n_m, ((struct vec3){4, 5, 6}), 0.01);
	assert_vec_near(n.way_from_n_m, ((struct vec3){4, 5, 6}), 0.01);
	assert_vec_near(n.earlier_variance_m2,
		((struct vec3){4 + NAVIGATION_P + 1, 5 + NAVIGATION_P + 2, 6 + NAVIGATION_P + 3}), 1e-3);
	assert_variance(&n, NAVIGATION_P, 0);
	assert_vec_near(n.high_pass_n_m_s, ZERO, 0);
	assert_true(n.high_pass2_max == 0 && n.moving_s < 0.01 && !n.lever_known && n.stood_s == 0);
	assert_true(n.p[NAVIGATION_BG][NAVIGATION_BG] > NAVIGATION_BG + 1); /* as it moves the bias is another */
}

/* Lying on its side in this filter, upright in the fusion: as at the start, but for the velocity, which is that of the
 * lever arm. */
static void test_a_tilt_that_is_lost_takes_biases_and_velocity_with_it(void **state)
{
	const struct vec3 bias = {0.01, 0.02, 0.03};
	const struct navigation_input in = {.gyro_b_rad_s = {0.01, 0.02, 1.03},
		.force_b_m_s2 = {0, 0, G},
		.q_nb = QUAT_IDENTITY,
		.gyro_bias_b_rad_s = bias,
		.gravity_m_s2 = G,
		.lever_b_m = {2, 0, 0}};
	struct navigation n = used_navigation(false), fresh = {.started = false};

	(void)state;
	navigation_start(&fresh, &BARE, QUAT_IDENTITY);
	n.sums = (struct navigation_sums){.t_s = 0};
	n.reset_in_motion = false;
	n.q_nb = quat_from_rotation_vector((struct vec3){PI / 2, 0, 0});
	n.accel_bias_b_m_s2 = n.high_pass_n_m_s = (struct vec3){1, 2, 3};
	n.high_pass2_max = 9;
	assert_true(navigation_step(&n, &in, 0.1));
	assert_quat_near(n.q_nb, QUAT_IDENTITY, 1e-9);
	assert_vec_near(n.gyro_bias_b_rad_s, bias, 0);
	assert_vec_near(n.accel_bias_b_m_s2, ZERO, 0);
	assert_vec_near(n.velocity_n_m_s, ((struct vec3){0, 2, 0}), 1e-9);
	assert_variance(&n, NAVIGATION_THETA, fresh.p[NAVIGATION_THETA][NAVIGATION_THETA]);
	assert_variance(&n, NAVIGATION_V, 1);
	assert_variance(&n, NAVIGATION_BG, fresh.p[NAVIGATION_BG][NAVIGATION_BG]);
	assert_variance(&n, NAVIGATION_BA, fresh.p[NAVIGATION_BA][NAVIGATION_BA]);
	assert_vec_near(n.high_pass_n_m_s, ZERO, 0);
	assert_false(n.high_pass2_max > 0 || n.lever_known || n.rope.full || n.rope.steady);
}

/* A mean over a second: after an interval of a tenth, 1/11 of the square. */
static void test_the_difference_to_the_fusion_is_remembered_for_a_second(void **state)
{
	const struct navigation_input in = {.force_b_m_s2 = {0, 0, G},
		.q_nb = quat_from_rotation_vector((struct vec3){0.02, -0.01, 0}),
		.gravity_m_s2 = G};
	struct navigation n = started(MOTION_ANY);

	(void)state;
	assert_true(navigation_step(&n, &in, 0.1));
	assert_near(n.fusion_difference2_rad2.x, 4e-4 / 11, 1e-7);
	assert_near(n.fusion_difference2_rad2.y, 1e-4 / 11, 1e-7);
}

/* It has moved at 3 m/s lately, and the fusion knows its tilt to 0.1 or 0.2 rad: that still is so. */
static void test_a_tilt_that_is_lost_is_found_as_the_fusion_knows_it(void **state)
{
	const struct navigation_input in = {.force_b_m_s2 = {0, 0, G},
		.q_nb = QUAT_IDENTITY,
		.attitude_variance_rad2 = {0.01, 0.04, 1e-4},
		.velocity2_m2_s2 = 9,
		.gravity_m_s2 = G};
	struct navigation n = used_navigation(false);

	(void)state;
	n.sums = (struct navigation_sums){.t_s = 0};
	n.q_nb = quat_from_rotation_vector((struct vec3){PI / 2, 0, 0});
	assert_true(navigation_step(&n, &in, 0.1));
	assert_vec_near(n.velocity_n_m_s, ZERO, 0);
	assert_variance(&n, NAVIGATION_V, 9);
	assert_variance(&n, NAVIGATION_THETA, 0.04);
}

/* Of a load that stands it is known that nothing moves; what was seen of its rope before is over. */
static void test_a_load_that_stands_hangs_no_longer(void **state)
{
	const struct navigation_input in = {.force_b_m_s2 = {0, 0, G}, .q_nb = QUAT_IDENTITY, .gravity_m_s2 = G};
	struct navigation_config config = BARE;
	struct navigation n = {.started = false};

	(void)state;
	config.preset = MOTION_HANGING_LOAD;
	config.rope_m = 5;
	navigation_start(&n, &config, QUAT_IDENTITY);
	for (int k = 0; k < 300; k++)
		navigation_step(&n, &in, 0.01);
	assert_true(n.still);
	n.rope_ended = n.hangs_still = true;
	for (int k = 0; k < 20; k++)
		navigation_step(&n, &in, 0.01);
	assert_true(n.still);
	assert_false(n.rope_ended || n.hangs_still);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_sums_are_the_derivatives_of_the_integration),
		cmocka_unit_test(test_the_sums_of_a_constant_motion_are_in_closed_form),
		cmocka_unit_test(test_the_covariance_is_that_of_dense_matrices),
		cmocka_unit_test(test_the_covariance_stays_symmetric_and_positive),
		cmocka_unit_test(test_the_velocity_at_a_standstill_is_known_to_the_vibration_and_to_a_creeping_turn),
		cmocka_unit_test(test_what_stands_may_creep_as_fast_as_noisy_sensors_do_not_show),
		cmocka_unit_test(test_after_a_long_way_sigma_counts_the_accelerometers_scale),
		cmocka_unit_test(test_sigma_knows_that_nobody_calibrated_the_sensors),
		cmocka_unit_test(test_a_guided_way_is_held_level),
		cmocka_unit_test(test_a_vertical_lift_ends_within_its_plumb_line),
		cmocka_unit_test(test_a_lift_that_is_inclined_is_found_to_be),
		cmocka_unit_test(test_what_turns_on_its_way_is_not_held),
		cmocka_unit_test(test_the_displacement_at_rest_is_right_and_its_sigma_honest),
		cmocka_unit_test(test_a_gentle_drive_is_not_a_standstill),
		cmocka_unit_test(test_levelling_does_not_shorten_a_long_steady_drive),
		cmocka_unit_test(test_sigma_is_honest_on_a_simulated_robot_at_any_rate),
		cmocka_unit_test(test_the_errors_stay_bounded_at_the_end_of_a_lever_arm_at_any_rate),
		cmocka_unit_test(test_what_a_swinging_arm_rectifies_of_the_errors_of_scale_is_in_the_sigma),
		cmocka_unit_test(test_a_robot_that_stops_at_the_corners_of_its_square_is_followed),
		cmocka_unit_test(test_a_standstill_corrects_the_whole_movement_before_it),
		cmocka_unit_test(test_a_steady_speed_passes_for_a_standstill_only_after_the_rest_time),
		cmocka_unit_test(
			test_after_the_longest_integration_time_the_position_is_held_until_it_is_corrected_at_rest),
		cmocka_unit_test(test_a_prior_limits_the_velocity),
		cmocka_unit_test(test_a_prior_bounds_the_velocity_of_a_cruise_and_no_time_averages_it_out),
		cmocka_unit_test(test_a_cruise_that_begins_to_brake_gently_accelerates),
		cmocka_unit_test(test_a_load_accelerates_at_the_turning_points_of_its_swing),
		cmocka_unit_test(test_at_rest_velocity_is_zero_and_the_position_stays_for_an_hour),
		cmocka_unit_test(test_a_chip_noisier_than_its_datasheet_does_not_begin_to_move_at_rest),
		cmocka_unit_test(test_what_turns_may_stand_except_on_a_linear_axis),
		cmocka_unit_test(test_after_turning_to_and_fro_the_accelerometers_bias_is_less_certain),
		cmocka_unit_test(test_a_gap_makes_position_and_velocity_less_certain),
		cmocka_unit_test(test_a_position_whose_sigma_exceeds_the_limit_is_reported),
		cmocka_unit_test(test_another_north_turns_the_velocity_with_the_attitude),
		cmocka_unit_test(test_while_the_heading_is_unknown_so_is_the_direction_of_the_path),
		cmocka_unit_test(test_another_north_leaves_the_path_behind_it_uncertain_by_its_chord),
		cmocka_unit_test(test_a_navigation_configuration_is_checked_field_by_field),
		cmocka_unit_test(test_levelling_starts_4_s_after_the_last_standstill),
		cmocka_unit_test(test_a_swing_about_the_reference_point_is_no_velocity_of_it),
		cmocka_unit_test(test_at_the_start_nothing_is_known_better_than_after_a_calibration),
		cmocka_unit_test(test_noise_and_errors_of_scale_add_up_within_an_interval),
		cmocka_unit_test(test_the_fusions_heading_counts_with_2_degrees_once_in_3_s),
		cmocka_unit_test(test_a_standstill_by_dwell_is_measured_with_what_may_still_move),
		cmocka_unit_test(test_levelling_measures_the_velocity_by_its_spread),
		cmocka_unit_test(test_the_spread_is_that_of_the_fastest_moment),
		cmocka_unit_test(test_at_the_end_of_a_movement_the_accelerometers_bias_is_less_certain_by_its_motion),
		cmocka_unit_test(test_over_missing_samples_the_acceleration_changes_evenly),
		cmocka_unit_test(test_after_a_gap_sigma_has_grown_by_what_may_have_happened),
		cmocka_unit_test(test_what_may_be_an_alias_is_an_error_of_velocity_and_position_as_long_as_it_lasts),
		cmocka_unit_test(test_a_gyro_bias_is_less_certain_in_motion_than_at_the_rest_before),
		cmocka_unit_test(test_an_aided_velocity_beyond_5_sigma_replaces_the_velocity),
		cmocka_unit_test(test_an_aided_motion_is_no_standstill_for_5_s),
		cmocka_unit_test(test_when_a_motion_begins_position_and_velocity_are_those_since_it_stood),
		cmocka_unit_test(test_a_set_attitude_is_known_to_a_degree),
		cmocka_unit_test(test_a_tilt_or_a_heading_too_far_from_the_fusions_starts_again_from_it),
		cmocka_unit_test(test_the_sigmas_of_acceleration_and_attitude_follow_from_tilt_noise_and_bias),
		cmocka_unit_test(test_the_sigmas_of_position_and_velocity_are_the_roots_of_the_sums_of_their_parts),
		cmocka_unit_test(test_a_correction_of_the_attitude_turns_the_forces_of_a_rope),
		cmocka_unit_test(test_a_load_that_stands_hangs_no_longer),
		cmocka_unit_test(test_a_position_that_is_reset_is_known),
		cmocka_unit_test(test_with_an_attitude_that_was_set_the_velocity_turns_and_what_was_integrated_is_void),
		cmocka_unit_test(test_what_was_integrated_before_missing_samples_is_void),
		cmocka_unit_test(test_a_movement_that_begins_knows_nothing_of_the_one_before),
		cmocka_unit_test(test_a_tilt_that_is_lost_takes_biases_and_velocity_with_it),
		cmocka_unit_test(test_the_difference_to_the_fusion_is_remembered_for_a_second),
		cmocka_unit_test(test_a_tilt_that_is_lost_is_found_as_the_fusion_knows_it),
		cmocka_unit_test(test_a_turn_in_one_direction_leaves_a_share_of_its_angle_behind),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
