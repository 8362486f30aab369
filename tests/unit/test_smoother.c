/* The path of the movement that has just ended: its points against a Rauch-Tung-Striebel smoother with dense matrices,
 * and against simulated truth. */
#include "model_test.h"

#include <stdio.h>
#include <string.h>

#include "model/pipeline.h"
#include "model/sim/sensor.h"
#include "model/smoother.h"

enum { N = NAVIGATION_STATES, V = NAVIGATION_V, P = NAVIGATION_P, STEPS = 400 };

static const struct vec3 ZERO = {0, 0, 0};
static struct smoother smoother;

static int fresh(void **state)
{
	(void)state;
	memset(&smoother, 0, sizeof(smoother));
	return 0;
}

/* ---- a linear problem with a second solution
 * -------------------------------------------------------------------------- */

/* x and its covariance after the measurements of a step, and before them; f is the transition to it. */
struct step {
	double f[N][N], x[N], p[N][N], x_before[N], p_before[N][N];
};

static struct step chain[STEPS];

static void multiply(double out[N][N], double a[N][N], double b[N][N], bool b_transposed)
{
	memset(out, 0, sizeof(double[N][N]));
	for (int i = 0; i < N; i++)
		for (int j = 0; j < N; j++)
			for (int k = 0; k < N; k++)
				out[i][j] += a[i][k] * (b_transposed ? b[j][k] : b[k][j]);
}

/* b becomes x of a x = b, column by column; Gauss with pivots. */
static void solve(double a[N][N], double b[N][N])
{
	for (int c = 0; c < N; c++) {
		int best = c;

		for (int i = c + 1; i < N; i++)
			best = fabs(a[i][c]) > fabs(a[best][c]) ? i : best;
		for (int j = 0; j < N; j++) {
			double t = a[c][j], u = b[c][j];

			a[c][j] = a[best][j];
			a[best][j] = t;
			b[c][j] = b[best][j];
			b[best][j] = u;
		}
		for (int i = 0; i < N; i++) {
			double q = i == c ? 0 : a[i][c] / a[c][c];

			for (int j = 0; j < N; j++) {
				a[i][j] -= q * a[c][j];
				b[i][j] -= q * b[c][j];
			}
		}
	}
	for (int i = 0; i < N; i++)
		for (int j = 0; j < N; j++)
			b[i][j] /= a[i][i];
}

static void predict(struct step *to, const struct step *from, const double noise[N])
{
	static double fp[N][N];

	memset(to->x, 0, sizeof(to->x));
	for (int i = 0; i < N; i++)
		for (int j = 0; j < N; j++)
			to->x[i] += to->f[i][j] * from->x[j];
	multiply(fp, to->f, ((struct step *)from)->p, false);
	multiply(to->p, fp, to->f, true);
	for (int i = 0; i < N; i++)
		to->p[i][i] += noise[i];
	memcpy(to->x_before, to->x, sizeof(to->x));
	memcpy(to->p_before, to->p, sizeof(to->p));
}

static void measure(struct step *s, const double row[N], double value, double noise)
{
	double h[N] = {0}, variance = noise, innovation = value;

	for (int i = 0; i < N; i++) {
		for (int j = 0; j < N; j++)
			h[i] += s->p[i][j] * row[j];
		innovation -= row[i] * s->x[i];
		variance += row[i] * h[i];
	}
	smoother_measure(&smoother, row, h, innovation, variance);
	for (int i = 0; i < N; i++) {
		s->x[i] += h[i] / variance * innovation;
		for (int j = 0; j < N; j++)
			s->p[i][j] -= h[i] / variance * h[j];
	}
}

static void apply_transition(struct step *to)
{
	double(*map)[N] = smoother_transition(&smoother), before[N][N];

	memcpy(before, map, sizeof(before));
	multiply(map, to->f, before, false);
}

static struct smoother_point here(const struct step *s)
{
	return (struct smoother_point){.position_n_m = {s->x[P], s->x[P + 1], s->x[P + 2]},
		.velocity_n_m_s = {s->x[V], s->x[V + 1], s->x[V + 2]}};
}

/* The position is certain at the beginning, as that of a movement. */
static void begin_chain(void)
{
	memset(chain, 0, sizeof(chain));
	for (int i = 0; i < N; i++) {
		chain[0].x[i] = any();
		chain[0].p[i][i] = i >= P && i < P + 3 ? 0 : 1 + 0.5 * any();
	}
	smoother_begin(&smoother, here(&chain[0]), chain[0].p);
}

/* Some of the state's sums are measured each time, with random results. */
static void next_step(int k)
{
	double noise[N];

	for (int i = 0; i < N; i++) {
		noise[i] = 0.1;
		for (int j = 0; j < N; j++)
			chain[k].f[i][j] = (i == j ? 0.95 : 0) + 0.05 * any();
	}
	smoother_elapse(&smoother, SMOOTHER_SPACING_S);
	apply_transition(&chain[k]);
	predict(&chain[k], &chain[k - 1], noise);
	for (int m = 0; m < 3; m++) {
		double row[N] = {0};

		row[(3 * k + 5 * m) % N] = 1;
		row[(k + m) % N] += any();
		measure(&chain[k], row, 3 * any(), 0.5);
	}
	smoother_mark(&smoother, here(&chain[k]), chain[k].p);
}

/* Three errors are reset: a transition that drops them, and noise in their place. */
static void reset_errors(int k, int at)
{
	double noise[N] = {0};

	for (int i = 0; i < N; i++) {
		chain[k].f[i][i] = i >= at && i < at + 3 ? 0 : 1;
		noise[i] = i >= at && i < at + 3 ? 2 : 0;
	}
	predict(&chain[k], &chain[k - 1], noise);
	smoother_reset_errors(&smoother, at);
}

/* Replaces chain[].x and .p by the smoothed ones. */
static void smooth(int last)
{
	static double before[N][N], g[N][N], fp[N][N], dp[N][N], gd[N][N], gdg[N][N];

	for (int k = last; k > 0; k--) {
		struct step *s = &chain[k - 1], *next = &chain[k];

		memcpy(before, next->p_before, sizeof(before));
		multiply(fp, next->f, s->p, false);
		solve(before, fp); /* the transposed gain */
		for (int i = 0; i < N; i++)
			for (int j = 0; j < N; j++) {
				g[i][j] = fp[j][i];
				dp[i][j] = next->p[i][j] - next->p_before[i][j];
			}
		multiply(gd, g, dp, false);
		multiply(gdg, gd, g, true);
		for (int i = 0; i < N; i++)
			for (int j = 0; j < N; j++) {
				s->x[i] += g[i][j] * (next->x[j] - next->x_before[j]);
				s->p[i][j] += gdg[i][j];
			}
	}
}

static void end_chain(int last)
{
	smoother_end(&smoother, 0, chain[last].p);
}

/* Step k of the chain is at time k * SMOOTHER_SPACING_S. */
static void assert_smoothed(const int *step_of_time)
{
	const struct smoother_movement *m = &smoother.last;
	struct vec3 from = m->point[0].position_n_m, start;

	assert_vec_near(from, ZERO, 0);
	start = here(&chain[0]).position_n_m;
	for (size_t i = 0; i < m->count; i++) {
		int k = (int)lround(m->point[i].t_s / SMOOTHER_SPACING_S);
		const struct step *s = &chain[step_of_time ? step_of_time[k] : k];
		struct smoother_point true_ = here(s);

		assert_vec_near(m->point[i].position_n_m, vec3_sub(true_.position_n_m, start), 1e-9);
		assert_vec_near(m->point[i].velocity_n_m_s, true_.velocity_n_m_s, 1e-9);
		assert_vec_near(m->point[i].sigma_m,
			((struct vec3){sqrt(s->p[P][P]), sqrt(s->p[P + 1][P + 1]), sqrt(s->p[P + 2][P + 2])}), 1e-9);
	}
}

static void test_each_point_is_that_of_a_rauch_tung_striebel_smoother(void **state)
{
	const int last = 60;

	(void)state;
	begin_chain();
	for (int k = 1; k <= last; k++)
		next_step(k);
	end_chain(last);
	assert_int_equal(smoother.last.count, last + 1);
	smooth(last);
	assert_smoothed(NULL);
	assert_true(smoother.last.whole);
}

static void test_a_movement_longer_than_the_memory_has_fewer_points_smoothed_as_well(void **state)
{
	const int last = STEPS - 1;

	(void)state;
	begin_chain();
	for (int k = 1; k <= last; k++)
		next_step(k);
	end_chain(last);
	assert_true(smoother.last.count > SMOOTHER_POINTS / 2 - 1 && smoother.last.count <= SMOOTHER_POINTS);
	assert_near(smoother.last.duration_s, last * SMOOTHER_SPACING_S, 1e-9);
	assert_near(smoother.last.point[1].t_s, 4 * SMOOTHER_SPACING_S, 1e-9);
	smooth(last);
	assert_smoothed(NULL);
}

static void test_measurements_after_a_reset_of_errors_correct_the_path_before_by_the_other_errors(void **state)
{
	const int last = 40, lost = 20;
	int step_of_time[STEPS];

	(void)state;
	begin_chain();
	for (int k = 1; k <= last; k++) {
		step_of_time[k < lost ? k : k - 1] = k;
		if (k == lost)
			reset_errors(k, V);
		else
			next_step(k);
	}
	step_of_time[0] = 0;
	step_of_time[lost - 1] = lost - 1; /* the point is from before the reset */
	end_chain(last);
	smooth(last);
	assert_smoothed(step_of_time);
	assert_false(smoother.last.whole);
}

static void test_the_length_of_a_path_to_and_fro_is_right_even_where_its_points_are_far_apart(void **state)
{
	const double interval_s = 0.04, last_s = 200, rate = 2 * PI * 0.8;
	double p[N][N] = {{0}};
	struct smoother_point here = {.velocity_n_m_s = {rate, 0, 0}};

	(void)state;
	smoother_begin(&smoother, here, p);
	for (double t = interval_s; t < last_s; t += interval_s) {
		here.position_n_m.x = sin(rate * t);
		here.velocity_n_m_s.x = rate * cos(rate * t);
		smoother_elapse(&smoother, interval_s);
		smoother_mark(&smoother, here, p);
	}
	smoother_end(&smoother, 0, p);
	assert_true(smoother.last.point[1].t_s > 1);
	assert_near(smoother.last.path_m / (4 * 0.8 * last_s), 1, 0.01);
}

/* ---- the path of a simulated robot
 * --------------------------------------------------------------------------------- */

enum { RATE_HZ = 100, SAMPLES = 60 * RATE_HZ };

static struct robot {
	struct pipeline pipeline;
	struct sensor sensor;
	struct pipeline_output out[SAMPLES];
	struct signal_truth truth[SAMPLES];
	int samples;
} robot;

static const struct vec3 LEVER_B_M = {0.1, -0.05, 0.05};

/* A cheap sensor, calibrated to 0.6 %. */
static void switch_on(uint64_t seed)
{
	struct sensor_config chip = *sensor_preset("lsm303dlhc_l3gd20");
	struct pipeline_config config = PIPELINE_DEFAULTS;

	sensor_calibrate(&chip);
	chip.rate_hz = RATE_HZ;
	chip.gyro.scale_sigma = chip.gyro.cross_axis_sigma = chip.accel.scale_sigma = chip.accel.cross_axis_sigma =
		0.006;
	chip.accel.bias_sigma = 0.03;
	chip.gyro.bias_sigma = 0.003;
	chip.lever_arm_b_m = config.estimator.lever_arm_b_m = LEVER_B_M;
	config.latency.sensor_s = 1 / (2 * PI * chip.gyro.bandwidth_hz);
	config.latency.accelerometer_s = 0;
	config.position.navigation.preset = MOTION_HAND_HELD;
	robot.samples = 0;
	assert_int_equal(sensor_init(&robot.sensor, &chip, seed), 0);
	assert_int_equal(pipeline_init(&robot.pipeline, &config, RATE_HZ), 0);
	pipeline_smooth(&robot.pipeline, &smoother);
}

static void drive_one_sample(void)
{
	struct imu_sample sample;
	int k = robot.samples++;

	assert_true(k < SAMPLES);
	sensor_next(&robot.sensor, signal_find("square"), &sample, &robot.truth[k]);
	assert_int_equal(pipeline_step(&robot.pipeline, &sample, &robot.out[k]), 0);
}

/* It drives from 2 to 10 s of every 10 s, with stops. */
static void drive(double to_s)
{
	while (robot.samples < to_s * RATE_HZ)
		drive_one_sample();
}

/* Drives to the end of a movement; returns the sample at which that began. */
static int drive_to_the_end(void)
{
	unsigned number = smoother.last.number;

	while (smoother.last.number == number)
		drive_one_sample();
	return robot.samples - 1 - (int)lround((smoother.last.duration_s + smoother.last.stood_s) * RATE_HZ);
}

static void test_the_first_point_is_zero_and_the_last_is_the_displacement(void **state)
{
	const struct smoother_movement *m = &smoother.last;

	(void)state;
	switch_on(1);
	for (unsigned number = 1; number <= 3; number++) {
		drive_to_the_end();
		const struct pipeline_output *out = &robot.out[robot.samples - 1];
		assert_int_equal(m->number, number);
		assert_vec_near(m->point[0].position_n_m, ZERO, 0);
		assert_vec_near(m->point[0].sigma_m, ZERO, 0);
		assert_near(m->point[0].t_s, 0, 0);
		assert_vec_near(m->point[m->count - 1].position_n_m, out->displacement_n_m, 1e-12);
		assert_vec_near(m->point[m->count - 1].sigma_m, out->displacement_sigma_m, 1e-12);
		assert_near(m->point[m->count - 1].t_s, m->duration_s, 0);
		assert_true(m->whole);
	}
}

/* A filter whose position is set to zero and certain at a point estimates at the end how far the point is from there,
 * by all the measurements in between. */
static void test_each_point_is_the_end_less_what_the_filter_makes_of_the_way_from_there(void **state)
{
	static struct pipeline from_there[SMOOTHER_POINTS];
	const struct pipeline *p = &robot.pipeline;
	struct vec3 lever_n_m[SMOOTHER_POINTS], from = ZERO;
	size_t points = 0;

	(void)state;
	switch_on(2);
	while (smoother.last.number == 0) {
		struct imu_sample sample;
		struct pipeline_output out;
		size_t kept = smoother.count;

		sensor_next(&robot.sensor, signal_find("square"), &sample, NULL);
		assert_int_equal(pipeline_step(&robot.pipeline, &sample, &out), 0);
		for (size_t i = 0; i < points; i++)
			assert_int_equal(pipeline_step(&from_there[i], &sample, &out), 0);
		if (!smoother.recording || smoother.count == kept)
			continue;
		from_there[points] = *p;
		pipeline_smooth(&from_there[points], NULL);
		pipeline_reset_position(&from_there[points]);
		from_there[points].position.navigation.ended_by_reset = false; /* it is the same movement */
		lever_n_m[points++] = quat_rotate(p->position.navigation.q_nb, LEVER_B_M);
		from = smoother.from_n_m;
	}
	assert_true(points > smoother.last.count - 2);
	for (size_t i = 1; i < smoother.last.count - 1; i++) {
		struct vec3 rest = from_there[i].position.navigation.position_n_m;
		struct vec3 sensor = vec3_sub(p->position.navigation.position_n_m, rest);

		assert_vec_near(
			smoother.last.point[i].position_n_m, vec3_sub(vec3_sub(sensor, lever_n_m[i]), from), 1e-9);
	}
}

static double squared(struct vec3 v)
{
	return vec3_dot(v, v);
}

static void test_the_smoothed_path_is_nearer_to_the_true_one_than_the_live_path_and_sigma_is_honest(void **state)
{
	const struct smoother_movement *m = &smoother.last;
	double live = 0, smoothed = 0, nees = 0;
	double path = 0, true_path = 0;
	int points = 0;

	(void)state;
	for (uint64_t seed = 1; seed <= 6; seed++) {
		switch_on(seed);
		for (int movement = 0; movement < 4; movement++) {
			int from = drive_to_the_end();

			path += m->path_m;
			for (int k = from + 1; k < robot.samples; k++)
				true_path += vec3_norm(
					vec3_sub(robot.truth[k].position_n_m, robot.truth[k - 1].position_n_m));
			for (size_t i = 1; i < m->count; i++) {
				int k = from + (int)lround(m->point[i].t_s * RATE_HZ);
				struct vec3 s = m->point[i].sigma_m;
				struct vec3 path_n =
					vec3_sub(robot.truth[k].position_n_m, robot.truth[from].position_n_m);
				struct vec3 e = vec3_sub(m->point[i].position_n_m, path_n);
				struct vec3 l = vec3_sub(robot.out[k].position_n_m, robot.out[from].position_n_m);

				live += squared(vec3_sub(l, path_n));
				smoothed += squared(e);
				nees += squared((struct vec3){e.x / s.x, e.y / s.y, e.z / s.z}) / 3;
				points++;
			}
		}
	}
	print_message("%d points: live %.3f, smoothed %.3f m RMS; normalised error squared %.2f\n", points,
		sqrt(live / points), sqrt(smoothed / points), nees / points);
	assert_true(sqrt(smoothed) < 0.7 * sqrt(live));
	assert_true(nees / points > 0.5 && nees / points < 2);
	assert_near(path / true_path, 1, 0.05);
}

/* ---- interruptions of a movement
 * ---------------------------------------------------------------------------------------- */

static void assert_ends_at_the_displacement(void)
{
	const struct smoother_movement *m = &smoother.last;

	assert_vec_near(m->point[0].position_n_m, ZERO, 0);
	assert_vec_near(m->point[m->count - 1].position_n_m, robot.out[robot.samples - 1].displacement_n_m, 1e-12);
	for (size_t i = 1; i < m->count; i++) {
		assert_true(m->point[i].t_s > m->point[i - 1].t_s);
		assert_true(vec3_finite(m->point[i].position_n_m) && vec3_finite(m->point[i].velocity_n_m_s));
		assert_true(m->point[i].sigma_m.x > 0 && m->point[i].sigma_m.x < 100);
	}
}

static void test_a_gap_interrupts_the_movement_and_its_path_continues_less_certain(void **state)
{
	struct imu_sample lost;
	struct signal_truth truth;
	double duration_s;

	(void)state;
	switch_on(1);
	drive_to_the_end();
	duration_s = smoother.last.duration_s;
	switch_on(1);
	drive(5);
	for (int k = 0; k < RATE_HZ / 2; k++)
		sensor_next(&robot.sensor, signal_find("square"), &lost, &truth);
	drive_to_the_end();
	assert_false(smoother.last.whole);
	assert_near(smoother.last.duration_s, duration_s, 0.2);
	assert_ends_at_the_displacement();
	assert_true(smoother.last.point[10].sigma_m.x < 0.1);
	assert_true(smoother.last.point[smoother.last.count - 1].sigma_m.x > 0.3);
}

static void test_after_a_reset_of_the_position_the_path_counts_from_there(void **state)
{
	(void)state;
	switch_on(1);
	drive(6);
	pipeline_reset_position(&robot.pipeline);
	drive_to_the_end();
	assert_int_equal(smoother.last.number, 1);
	assert_false(smoother.last.whole);
	assert_vec_near(smoother.last.point[0].position_n_m, ZERO, 0);
	assert_vec_near(smoother.last.point[0].sigma_m, ZERO, 0);
	assert_true(smoother.last.duration_s > 3 && smoother.last.duration_s < 5);
	assert_ends_at_the_displacement();
}

/* It drives for 5 s, stands for 1 s and turns for 2 s, which without the reset is one movement. */
static void test_a_reset_of_the_position_at_a_standstill_ends_the_movement(void **state)
{
	struct vec3 displacement;

	(void)state;
	switch_on(1);
	drive(7.7);
	assert_true(robot.pipeline.position.navigation.still);
	displacement = robot.out[robot.samples - 1].displacement_n_m;
	assert_near(displacement.x, 2, 0.1);
	pipeline_reset_position(&robot.pipeline);
	assert_int_equal(smoother.last.number, 1);
	assert_true(smoother.last.whole);
	assert_vec_near(smoother.last.point[smoother.last.count - 1].position_n_m, displacement, 0.001);
	drive(7.8);
	assert_vec_near(robot.out[robot.samples - 1].displacement_n_m, displacement, 0);
	drive_to_the_end();
	assert_true(smoother.last.whole);
	assert_near(smoother.last.duration_s, 2.3, 0.5);
	assert_ends_at_the_displacement();
	assert_near(smoother.last.farthest_m, 0, 0.05);
}

static void test_a_velocity_beyond_the_innovation_gate_interrupts_the_movement(void **state)
{
	(void)state;
	switch_on(1);
	drive(4);
	pipeline_aid_velocity(&robot.pipeline, (struct vec3){0, 3, 0}, 0.01);
	pipeline_aid_velocity(&robot.pipeline, robot.truth[robot.samples - 1].velocity_n_m_s, 0.01);
	drive(9.5); /* 5 s after an aided velocity in motion there is no standstill */
	drive_to_the_end();
	assert_false(smoother.last.whole);
	assert_ends_at_the_displacement();
}

static void test_a_velocity_within_the_innovation_gate_does_not_interrupt_the_movement(void **state)
{
	(void)state;
	switch_on(1);
	drive(4);
	pipeline_aid_velocity(&robot.pipeline, robot.truth[robot.samples - 1].velocity_n_m_s, 0.05);
	drive_to_the_end();
	assert_true(smoother.last.whole);
	assert_ends_at_the_displacement();
}

static void test_setting_the_attitude_interrupts_the_movement(void **state)
{
	(void)state;
	switch_on(1);
	drive(5);
	pipeline_reset_attitude(&robot.pipeline, quat_from_rotation_vector((struct vec3){0, 0, 1}));
	drive_to_the_end();
	assert_int_equal(smoother.last.number, 1);
	assert_false(smoother.last.whole);
}

static void configure(void (*change)(struct pipeline_config *config))
{
	struct pipeline_config config = robot.pipeline.config;

	change(&config);
	assert_int_equal(pipeline_configure(&robot.pipeline, &config), 0);
}

static void without_levelling(struct pipeline_config *config)
{
	config->position.navigation.levelling = 0;
}

static void with_another_bias(struct pipeline_config *config)
{
	config->calibration.gyro.bias.x += 1e-4;
}

static void without_position(struct pipeline_config *config)
{
	config->position.mode = POSITION_OFF;
}

static void with_navigation(struct pipeline_config *config)
{
	config->position.mode = POSITION_NAVIGATION;
}

static void test_a_new_parameter_of_the_navigation_does_not_interrupt_the_movement(void **state)
{
	(void)state;
	switch_on(1);
	drive(5);
	configure(without_levelling);
	drive_to_the_end();
	assert_true(smoother.last.whole);
	assert_ends_at_the_displacement();
}

/* The interrupted movement is dropped, the next one is whole. */
static void assert_movement_dropped(void)
{
	assert_true(drive_to_the_end() > 10 * RATE_HZ);
	assert_int_equal(smoother.last.number, 1);
	assert_true(smoother.last.whole);
	assert_ends_at_the_displacement();
}

static void test_a_new_calibration_drops_the_movement(void **state)
{
	(void)state;
	switch_on(1);
	drive(5);
	configure(with_another_bias);
	assert_movement_dropped();
}

static void test_switching_the_position_off_drops_the_movement(void **state)
{
	(void)state;
	switch_on(1);
	drive(5);
	configure(without_position);
	drive(6);
	configure(with_navigation);
	assert_movement_dropped();
}

static void test_a_discontinuity_drops_the_movement(void **state)
{
	struct imu_sample sample;
	struct pipeline_output out;
	struct signal_truth truth;

	(void)state;
	switch_on(1);
	drive(5);
	sensor_next(&robot.sensor, signal_find("square"), &sample, &truth);
	sample.flags |= SAMPLE_DISCONTINUITY;
	assert_int_equal(pipeline_step(&robot.pipeline, &sample, &out), 0);
	assert_movement_dropped();
}

static void test_the_last_movement_stays_until_the_next_one_ends(void **state)
{
	static struct smoother_movement before;

	(void)state;
	switch_on(1);
	drive_to_the_end();
	before = smoother.last;
	drive(18);
	assert_memory_equal(&before, &smoother.last, sizeof(before));
	drive_to_the_end();
	assert_int_equal(smoother.last.number, 2);
}

/* ---- movements of constant velocity ------------------------------------------------------------------------------ */

/* A filter without errors moves along x, at 1 m/s for `out_s` and back for `back_s`. */
static void go_and_return(double out_s, double back_s, double stood_s)
{
	const double dt_s = 0.01;
	double p[N][N] = {{0}};
	struct smoother_point at = {.position_n_m = {5, 6, 7}, .velocity_n_m_s = {1, 0, 0}};

	smoother_begin(&smoother, at, p);
	for (int k = 1; k <= lround((out_s + back_s) / dt_s); k++) {
		at.velocity_n_m_s.x = k * dt_s <= out_s + dt_s / 2 ? 1 : -1;
		at.position_n_m.x += dt_s * at.velocity_n_m_s.x;
		smoother_elapse(&smoother, dt_s);
		smoother_mark(&smoother, at, p);
	}
	smoother_end(&smoother, stood_s, p);
}

static void test_a_movement_has_its_duration_path_and_farthest_point(void **state)
{
	const struct smoother_movement *m = &smoother.last;

	(void)state;
	go_and_return(2, 1, 0);
	assert_int_equal(m->number, 1);
	assert_int_equal(m->count, 3 * 5 + 1);
	assert_near(m->duration_s, 3, 1e-9);
	assert_near(m->stood_s, 0, 0);
	assert_near(m->path_m, 3, 0.02);
	assert_near(m->farthest_m, 2, 1e-9);
	assert_near(m->farthest_s, 2, 1e-9);
	assert_vec_near(m->point[15].position_n_m, ((struct vec3){1, 0, 0}), 1e-9);
	assert_vec_near(m->point[5].position_n_m, ((struct vec3){1, 0, 0}), 1e-9);
	go_and_return(1, 0, 0);
	assert_int_equal(m->number, 2);
	assert_near(m->farthest_m, 1, 1e-9);
	assert_near(m->path_m, 1, 0.02);
}

/* Points up to 1 s before the end are kept, and the last one has the position at the end. */
static void test_a_movement_ends_where_its_standstill_began(void **state)
{
	const struct smoother_movement *m = &smoother.last;

	(void)state;
	go_and_return(3, 0, 1.1);
	assert_near(m->duration_s, 1.9, 1e-9);
	assert_near(m->stood_s, 1.1, 0);
	assert_int_equal(m->count, 11);
	assert_near(m->point[9].t_s, 1.8, 1e-9);
	assert_near(m->point[10].t_s, 1.9, 1e-9);
	assert_vec_near(m->point[10].position_n_m, ((struct vec3){3, 0, 0}), 1e-9);
}

static void test_a_movement_shorter_than_its_standstill_has_a_first_and_a_last_point_only(void **state)
{
	const struct smoother_movement *m = &smoother.last;

	(void)state;
	go_and_return(1, 0, 1.5);
	assert_int_equal(m->count, 2);
	assert_near(m->duration_s, 0, 0);
	assert_vec_near(m->point[0].position_n_m, ZERO, 0);
	assert_vec_near(m->point[1].position_n_m, ((struct vec3){1, 0, 0}), 1e-9);
	assert_near(m->path_m, 0, 0);
}

static void test_without_a_smoother_or_a_movement_nothing_is_recorded(void **state)
{
	static struct smoother before;
	double p[N][N] = {{0}};
	struct smoother_point at = {.velocity_n_m_s = {1, 0, 0}};

	(void)state;
	smoother_begin(NULL, at, p);
	smoother_mark(NULL, at, p);
	smoother_end(NULL, 0, p);
	smoother_cancel(NULL);
	assert_null(smoother_transition(NULL));
	before = smoother;
	smoother_elapse(&smoother, 1);
	smoother_mark(&smoother, at, p);
	smoother_restart(&smoother, at, p);
	smoother_reset_errors(&smoother, V);
	smoother_break(&smoother);
	smoother_end(&smoother, 0, p);
	assert_null(smoother_transition(&smoother));
	assert_memory_equal(&before, &smoother, sizeof(before));
}

static void test_a_smoother_set_while_moving_begins_with_the_next_movement(void **state)
{
	(void)state;
	switch_on(1);
	drive(5);
	assert_true(smoother.recording);
	pipeline_smooth(&robot.pipeline, &smoother);
	assert_false(smoother.recording);
	assert_movement_dropped();
}

/* A movement of so many seconds with a measurement of some sum of the errors each second. */
static void record_movement(struct smoother *s, double seconds, double size)
{
	double p[NAVIGATION_STATES][NAVIGATION_STATES] = {{0}};

	for (int i = 0; i < NAVIGATION_STATES; i++)
		for (int j = 0; j < NAVIGATION_STATES; j++)
			p[i][j] = (i == j) + 0.01 * (i + j);
	for (int k = 0; k < (int)lround(seconds / 0.05); k++) {
		const double t = 0.05 * k, row[NAVIGATION_STATES] = {0.1, [NAVIGATION_V] = 1, [NAVIGATION_BA] = 0.3};
		struct smoother_point here = {.velocity_n_m_s = {size * cos(t), size, -size * t},
			.position_n_m = {size * sin(t) + 3, size * t, -size * t * t / 2}};
		double(*a)[NAVIGATION_STATES];

		if (k == 0)
			smoother_begin(s, here, p);
		smoother_elapse(s, 0.05);
		a = smoother_transition(s);
		for (int j = 0; j < NAVIGATION_STATES; j++)
			a[NAVIGATION_P][j] += 0.05 * a[NAVIGATION_V][j];
		if (k % 20 == 19)
			smoother_measure(s, row, p[NAVIGATION_V], 0.1 * size, 2);
		smoother_mark(s, here, p);
	}
	smoother_end(s, 0.5, p);
}

/* Whatever came before: a longer one, one that was dropped, or one whose position was reset. */
static void test_a_movement_is_recorded_as_if_it_were_the_first(void **state)
{
	static struct smoother first, later;
	double p[NAVIGATION_STATES][NAVIGATION_STATES] = {{0}};

	(void)state;
	first = (struct smoother){.recording = false};
	record_movement(&first, 20, 1);
	assert_true(first.last.count > 10 && first.last.path_m > 1);
	for (int before = 0; before < 3; before++) {
		later = (struct smoother){.recording = false};
		record_movement(&later, 300, 7);
		if (before > 0) {
			smoother_begin(&later, (struct smoother_point){.position_n_m = {9, 9, 9}}, p);
			smoother_elapse(&later, 2);
			smoother_measure(&later, p[0], p[1], 3, 1);
			if (before == 1)
				smoother_cancel(&later);
			else
				smoother_restart(&later, (struct smoother_point){.position_n_m = {8, 8, 8}}, p);
		}
		record_movement(&later, 20, 1);
		later.last.number = first.last.number;
		assert_memory_equal(&later.last, &first.last, offsetof(struct smoother_movement, point));
		assert_memory_equal(later.last.point, first.last.point, first.last.count * sizeof first.last.point[0]);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test_setup(test_each_point_is_that_of_a_rauch_tung_striebel_smoother, fresh),
		cmocka_unit_test_setup(test_a_movement_longer_than_the_memory_has_fewer_points_smoothed_as_well, fresh),
		cmocka_unit_test_setup(
			test_measurements_after_a_reset_of_errors_correct_the_path_before_by_the_other_errors, fresh),
		cmocka_unit_test_setup(
			test_the_length_of_a_path_to_and_fro_is_right_even_where_its_points_are_far_apart, fresh),
		cmocka_unit_test_setup(test_the_first_point_is_zero_and_the_last_is_the_displacement, fresh),
		cmocka_unit_test_setup(
			test_each_point_is_the_end_less_what_the_filter_makes_of_the_way_from_there, fresh),
		cmocka_unit_test_setup(
			test_the_smoothed_path_is_nearer_to_the_true_one_than_the_live_path_and_sigma_is_honest, fresh),
		cmocka_unit_test_setup(test_a_gap_interrupts_the_movement_and_its_path_continues_less_certain, fresh),
		cmocka_unit_test_setup(test_after_a_reset_of_the_position_the_path_counts_from_there, fresh),
		cmocka_unit_test_setup(test_a_reset_of_the_position_at_a_standstill_ends_the_movement, fresh),
		cmocka_unit_test_setup(test_a_velocity_beyond_the_innovation_gate_interrupts_the_movement, fresh),
		cmocka_unit_test_setup(
			test_a_velocity_within_the_innovation_gate_does_not_interrupt_the_movement, fresh),
		cmocka_unit_test_setup(test_setting_the_attitude_interrupts_the_movement, fresh),
		cmocka_unit_test_setup(test_a_new_parameter_of_the_navigation_does_not_interrupt_the_movement, fresh),
		cmocka_unit_test_setup(test_a_new_calibration_drops_the_movement, fresh),
		cmocka_unit_test_setup(test_switching_the_position_off_drops_the_movement, fresh),
		cmocka_unit_test_setup(test_a_discontinuity_drops_the_movement, fresh),
		cmocka_unit_test_setup(test_the_last_movement_stays_until_the_next_one_ends, fresh),
		cmocka_unit_test_setup(test_a_movement_has_its_duration_path_and_farthest_point, fresh),
		cmocka_unit_test_setup(test_a_movement_ends_where_its_standstill_began, fresh),
		cmocka_unit_test_setup(
			test_a_movement_shorter_than_its_standstill_has_a_first_and_a_last_point_only, fresh),
		cmocka_unit_test_setup(test_without_a_smoother_or_a_movement_nothing_is_recorded, fresh),
		cmocka_unit_test_setup(test_a_smoother_set_while_moving_begins_with_the_next_movement, fresh),
		cmocka_unit_test(test_a_movement_is_recorded_as_if_it_were_the_first),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
