/* No axis is special to the physics but the vertical. The device follows a simulated robot, then the same one with its
 * sensor's axes renamed, with the robot turned by a quarter, and seen in a mirror; the noise is the same, so all
 * differences but rounding are faults. */
#include <string.h>

#include "model/identify/ellipsoid.h"
#include "model/identify/lever_identification.h"
#include "model/pipeline.h"
#include "model/sim/sensor.h"
#include "model/smoother.h"
#include "tests/unit/model_test.h"

enum { RATE_HZ = 100, SAMPLES = 45 * RATE_HZ };

static struct imu_sample recorded[SAMPLES];
static struct pipeline_output first[SAMPLES], second[SAMPLES];
static struct smoother smoother;
static struct smoother_movement first_movement;

typedef struct vec3 change(struct vec3 v);

static struct vec3 none(struct vec3 v)
{
	return v;
}

/* What was y is x. */
static struct vec3 renamed(struct vec3 v)
{
	return (struct vec3){v.y, v.z, v.x};
}

static struct vec3 quarter_turn(struct vec3 v)
{
	return (struct vec3){-v.y, v.x, v.z};
}

static struct vec3 x_and_y_exchanged(struct vec3 v)
{
	return (struct vec3){v.y, v.x, v.z};
}

static struct vec3 mirrored(struct vec3 v)
{
	return (struct vec3){-v.x, v.y, v.z};
}

/* Angular rates seen in that mirror. */
static struct vec3 mirrored_turn(struct vec3 v)
{
	return (struct vec3){v.x, -v.y, -v.z};
}

/* How the vectors of the second run differ from those of the first. */
struct symmetry {
	change *body, *body_turn, *body_scale, *global, *global_sigma;
	bool heading_set; /* at the start, level, and there is no field then */
	double heading_rad;
};

static const struct symmetry SAME = {none, none, none, none, none, false, 0},
			     RENAMED = {renamed, renamed, renamed, none, none, false, 0},
			     MIRRORED = {mirrored, mirrored_turn, none, mirrored, none, false, 0},
			     SET = {none, none, none, none, none, true, 0},
			     TURNED = {none, none, none, quarter_turn, x_and_y_exchanged, true, PI / 2};

/* What the sensor of the robot measures, with noise. */
static struct pipeline_config record(const char *signal)
{
	struct sensor_config chip = *sensor_preset("lsm303dlhc_l3gd20");
	struct pipeline_config config = PIPELINE_DEFAULTS;
	struct signal_truth truth;
	struct sensor sensor;

	sensor_calibrate(&chip);
	chip.rate_hz = RATE_HZ;
	chip.gyro.bias_sigma = 0.003;
	chip.mag_rate_hz = 0; /* with each sample, the first one as well: it sets the heading */
	chip.lever_arm_b_m = config.estimator.lever_arm_b_m = (struct vec3){0.1, -0.05, 0.07};
	assert_int_equal(sensor_init(&sensor, &chip, 3), 0);
	for (int k = 0; k < SAMPLES; k++)
		sensor_next(&sensor, signal_find(signal), &recorded[k], &truth);
	return config;
}

/* The velocity is aided for a while. */
static void run(struct pipeline_config config, const struct symmetry *c, struct pipeline_output out[SAMPLES])
{
	static struct pipeline p;

	memset(&smoother, 0, sizeof(smoother));
	config.estimator.lever_arm_b_m = c->body(config.estimator.lever_arm_b_m);
	assert_int_equal(pipeline_init(&p, &config, RATE_HZ), 0);
	pipeline_smooth(&p, &smoother);
	if (c->heading_set)
		assert_int_equal(
			pipeline_reset_attitude(&p, quat_from_rotation_vector((struct vec3){0, 0, c->heading_rad})), 0);
	for (int k = 0; k < SAMPLES; k++) {
		struct imu_sample s = recorded[k];

		s.gyro_rad_s = c->body_turn(s.gyro_rad_s);
		s.accel_m_s2 = c->body(s.accel_m_s2);
		s.mag_uT = c->body(s.mag_uT);
		if (c->heading_set)
			s.flags &= ~(unsigned)SAMPLE_MAG;
		assert_int_equal(pipeline_step(&p, &s, &out[k]), 0);
		if (k >= 2600 && k < 3400 && k % 10 == 0)
			assert_int_equal(
				pipeline_aid_velocity(&p, c->global((struct vec3){0.05, -0.02, 0.01}), 0.2), 0);
	}
}

static void assert_alike(const struct pipeline_output *a, const struct pipeline_output *b, const struct symmetry *c)
{
	const double rounding = 1e-9;

	assert_vec_near(b->rate_b_rad_s, c->body_turn(a->rate_b_rad_s), rounding);
	assert_vec_near(b->alpha_b_rad_s2, c->body_turn(a->alpha_b_rad_s2), rounding);
	assert_vec_near(b->accel_b_m_s2, c->body(a->accel_b_m_s2), rounding);
	assert_vec_near(b->gyro_errors.bias_b_rad_s, c->body_turn(a->gyro_errors.bias_b_rad_s), rounding);
	assert_vec_near(b->gyro_errors.scale_b, c->body_scale(a->gyro_errors.scale_b), rounding);
	assert_vec_near(b->accel_n_m_s2, c->global(a->accel_n_m_s2), rounding);
	assert_vec_near(b->velocity_n_m_s, c->global(a->velocity_n_m_s), rounding);
	assert_vec_near(b->position_n_m, c->global(a->position_n_m), rounding);
	assert_vec_near(b->displacement_n_m, c->global(a->displacement_n_m), rounding);
	assert_vec_near(b->displacement_sigma_m, c->global_sigma(a->displacement_sigma_m), rounding);
	assert_vec_near(b->sigma.position_m, c->global_sigma(a->sigma.position_m), rounding);
	assert_vec_near(b->sigma.velocity_m_s, c->global_sigma(a->sigma.velocity_m_s), rounding);
	assert_int_equal(b->status, a->status);
}

static void assert_symmetric(const struct symmetry *as, const struct symmetry *c)
{
	const char *const signals[] = {"square", "tumble"};

	for (int i = 0; i < 2; i++) {
		struct pipeline_config config = record(signals[i]);

		for (int preset = 0; preset < MOTION_PRESETS; preset++) {
			config.position.navigation.preset = (enum motion_preset)preset;
			run(config, as, first);
			first_movement = smoother.last;
			run(config, c, second);
			for (int k = 10; k < SAMPLES; k++) /* when the first field has set north */
				assert_alike(&first[k], &second[k], c);
			assert_int_equal(smoother.last.count, first_movement.count);
			for (size_t k = 0; k < first_movement.count; k++) {
				assert_vec_near(smoother.last.point[k].position_n_m,
					c->global(first_movement.point[k].position_n_m), 1e-9);
				assert_vec_near(smoother.last.point[k].sigma_m,
					c->global_sigma(first_movement.point[k].sigma_m), 1e-9);
			}
		}
	}
}

static void test_renamed_axes_of_the_sensor_change_nothing_in_the_global_frame(void **state)
{
	(void)state;
	assert_symmetric(&SAME, &RENAMED);
}

static void test_a_robot_turned_by_a_quarter_follows_a_path_turned_by_a_quarter(void **state)
{
	(void)state;
	assert_symmetric(&SET, &TURNED);
}

static void test_a_robot_in_a_mirror_follows_the_mirrored_path(void **state)
{
	(void)state;
	assert_symmetric(&SAME, &MIRRORED);
}

/* ---- identification ---------------------------------------------------------------------------------------------- */

/* With the sensor's axes renamed, or in the mirror; with a reference, which is late. */
static struct lever_estimate identified(const struct symmetry *c, bool with_delay)
{
	const struct lever_identification_config config = {
		.rate_hz = RATE_HZ, .duration_s = 30, .reference = true, .estimate_delay = with_delay};
	static struct lever_identification id;

	assert_int_equal(lever_identification_init(&id, &config), 0);
	for (int k = 0; k < SAMPLES; k++) {
		const struct imu_sample *s = &recorded[k];
		double t_s = k * (1.0 / RATE_HZ);
		struct vec3 reference = {sin(3 * t_s), 0.5 * cos(4 * t_s), 0.3 * sin(5 * t_s)};

		reference = c->body(reference);
		lever_identification_step(&id, s->t_us, c->body_turn(s->gyro_rad_s),
			vec3_add(c->body(s->accel_m_s2), reference), &reference);
	}
	return lever_identification_estimate(&id);
}

static void test_an_identified_lever_arm_is_renamed_and_mirrored_with_the_axes(void **state)
{
	(void)state;
	record("tumble");
	for (int i = 0; i < 4; i++) {
		const struct symmetry *c = i < 2 ? &RENAMED : &MIRRORED;
		struct lever_estimate a = identified(&SAME, i % 2), b = identified(c, i % 2);

		assert_int_equal(a.verdict, LEVER_FOUND);
		assert_int_equal(b.verdict, a.verdict);
		assert_vec_near(b.lever_arm_b_m, c->body(a.lever_arm_b_m), 1e-9);
		assert_vec_near(b.noise_sigma_b_m, c->body_scale(a.noise_sigma_b_m), 1e-9);
		assert_vec_near(b.sigma_b_m, c->body_scale(a.sigma_b_m), 1e-9);
		assert_near(b.residual_m_s2, a.residual_m_s2, 1e-9);
		assert_near(b.delay_s, a.delay_s, 1e-9);
	}
}

static struct ellipsoid fitted(change *changed)
{
	enum { POINTS = 80 };
	struct vec3 points[POINTS];
	struct ellipsoid e;

	for (int i = 0; i < POINTS; i++) {
		double z = 1 - (i + 0.5) * 2 / POINTS, r = sqrt(1 - z * z), turn = 2.4 * i, off = sin(3.7 * i * i);

		points[i] = changed((struct vec3){10 + (40 + off) * r * cos(turn) + 5 * z,
			-5 + (50 - off) * r * sin(turn), 3 + (60 + off) * z + 4 * r * cos(turn)});
	}
	assert_int_equal(ellipsoid_guess(points, POINTS, 50, &e), 0);
	assert_int_equal(ellipsoid_fit(points, POINTS, 50, true, &e), 0);
	return e;
}

static void test_a_fitted_ellipsoid_is_renamed_and_mirrored_with_the_axes(void **state)
{
	const struct ellipsoid a = fitted(none);

	(void)state;
	for (int i = 0; i < 2; i++) {
		const struct symmetry *c = i ? &MIRRORED : &RENAMED;
		const struct ellipsoid b = fitted(c->body);
		const struct vec3 diagonal = {a.matrix.m[0][0], a.matrix.m[1][1], a.matrix.m[2][2]};
		const struct vec3 across = {a.matrix.m[1][2], a.matrix.m[2][0], a.matrix.m[0][1]};

		assert_vec_near(b.centre, c->body(a.centre), 1e-7);
		assert_vec_near(b.sigma, c->body_scale(a.sigma), 1e-7);
		assert_vec_near(((struct vec3){b.matrix.m[0][0], b.matrix.m[1][1], b.matrix.m[2][2]}),
			c->body_scale(diagonal), 1e-9);
		assert_vec_near(((struct vec3){b.matrix.m[1][2], b.matrix.m[2][0], b.matrix.m[0][1]}),
			c->body_turn(across), 1e-9);
		assert_near(b.rms, a.rms, 1e-7);
		assert_near(b.matrix_sigma, a.matrix_sigma, 1e-9);
		assert_near(b.coverage, a.coverage, 1e-9);
		assert_near(b.mean, a.mean, 1e-9);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_renamed_axes_of_the_sensor_change_nothing_in_the_global_frame),
		cmocka_unit_test(test_a_robot_turned_by_a_quarter_follows_a_path_turned_by_a_quarter),
		cmocka_unit_test(test_a_robot_in_a_mirror_follows_the_mirrored_path),
		cmocka_unit_test(test_an_identified_lever_arm_is_renamed_and_mirrored_with_the_axes),
		cmocka_unit_test(test_a_fitted_ellipsoid_is_renamed_and_mirrored_with_the_axes),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
