/* A shoe: the navigation with the preset "foot", on steps whose truth is known here in closed form. The sensor has the
 * noise of the datasheets and a constant error of the accelerometer. */
#include "model_test.h"

#include "model/pipeline.h"

enum { RATE_HZ = 200, STRIDES = 30 };

static const double G = 9.81, DT_S = 1.0 / RATE_HZ, REST_S = 5, SWING_S = 0.6, STRIDE_M = 1.2, HEIGHT_M = 0.1;
static const double PITCH_RAD = 30 * RAD_PER_DEG;

/* Along x and up; a turn about y. */
struct step_truth {
	double x_m, accel_x_m_s2, accel_z_m_s2, pitch_rad, rate_rad_s;
	bool swings;
};

/* Each swing begins and ends without velocity and without acceleration, and so does the roll by roll_m in each
 * stance. */
static struct step_truth walk(double t_s, double stance_s, double roll_m)
{
	double stride_s = SWING_S + stance_s, walked_s = t_s - REST_S;
	double k = fmax(0, fmin(STRIDES - 1, floor(walked_s / stride_s)));
	double u = fmax(0, fmin(1, (walked_s - k * stride_s) / SWING_S)), s = 2 * PI * u, w = 2 * PI / SWING_S;
	double v = fmax(0, fmin(1, (walked_s - k * stride_s - SWING_S) / stance_s)), r = 2 * PI * v;
	double roll_w = 2 * PI / stance_s;

	return (struct step_truth){
		.x_m = STRIDE_M * (k + u - sin(s) / (2 * PI)) + roll_m * (k + v - sin(r) / (2 * PI)),
		.accel_x_m_s2 = (STRIDE_M * w * w * sin(s) + roll_m * roll_w * roll_w * sin(r)) / (2 * PI),
		.accel_z_m_s2 = HEIGHT_M * w * w / 2 * (cos(s) - cos(2 * s)),
		.pitch_rad = PITCH_RAD * (sin(s) - sin(2 * s) / 2),
		.rate_rad_s = PITCH_RAD * w * (cos(s) - cos(2 * s)),
		.swings = u > 0 && u < 1,
	};
}

struct run {
	struct pipeline_output out;
	struct vec3 error_n_m;
	unsigned stances;
	bool stood_in_mid_swing;
};

static struct run rolls(enum motion_preset preset, double stance_s, double stance_time_s, double roll_m)
{
	struct pipeline_config config = PIPELINE_DEFAULTS;
	const struct vec3 bias = {0.02, -0.015, 0.01};
	int n = (int)lround((2 * REST_S + STRIDES * (SWING_S + stance_s)) * RATE_HZ);
	struct run run = {.stances = 0};
	struct step_truth truth = {.x_m = 0};
	struct pipeline p;
	bool still = true;

	config.latency = (struct latency_config){0, 0};
	config.position.navigation.preset = preset;
	config.stance_s = stance_time_s;
	assert_int_equal(pipeline_init(&p, &config, RATE_HZ), 0);
	for (int i = 0; i < n; i++) {
		struct imu_sample s = {.t_us = (uint64_t)(i + 1) * 5000, .flags = SAMPLE_MAG};
		struct quat q;

		truth = walk(i * DT_S, stance_s, roll_m);
		q = quat_from_rotation_vector((struct vec3){0, truth.pitch_rad, 0});
		s.accel_m_s2 = quat_rotate_inverse(q, (struct vec3){truth.accel_x_m_s2, 0, truth.accel_z_m_s2 + G});
		s.accel_m_s2 = vec3_add(vec3_add(s.accel_m_s2, bias), any_vec(0.025));
		s.gyro_rad_s = vec3_add((struct vec3){0, truth.rate_rad_s, 0}, any_vec(0.1 * RAD_PER_DEG));
		s.mag_uT = vec3_add(quat_rotate_inverse(q, (struct vec3){0, 20, -44}), any_vec(0.5));
		assert_int_equal(pipeline_step(&p, &s, &run.out), 0);
		run.stances += p.position.navigation.still && !still;
		still = p.position.navigation.still;
		run.stood_in_mid_swing |= truth.swings && still && fabs(truth.rate_rad_s) > 2;
	}
	run.error_n_m = vec3_sub(run.out.position_n_m, (struct vec3){truth.x_m, 0, 0});
	return run;
}

static struct run walks(enum motion_preset preset, double stance_s, double stance_time_s)
{
	return rolls(preset, stance_s, stance_time_s, 0);
}

static double worst_sigmas(const struct run *r)
{
	struct vec3 e = r->error_n_m, s = r->out.sigma.position_m;

	return fmax(fabs(e.x) / s.x, fmax(fabs(e.y) / s.y, fabs(e.z) / s.z));
}

static void test_each_stance_of_a_walk_is_a_zero_velocity_update(void **state)
{
	struct run r = walks(MOTION_FOOT, 0.4, 0);

	(void)state;
	assert_int_equal(r.stances, STRIDES + 1); /* the rest at the start as well */
	assert_false(r.stood_in_mid_swing);
	assert_true(fabs(r.error_n_m.x) < 0.005 * STRIDES * STRIDE_M); /* along the way; across, the heading counts */
	assert_true(vec3_norm(r.error_n_m) < 0.03 * STRIDES * STRIDE_M);
	assert_true(worst_sigmas(&r) < 3);
	assert_true(vec3_norm(r.out.sigma.position_m) < 0.02 * STRIDES * STRIDE_M);
}

static void test_a_foot_that_rolls_on_in_each_stance_stays_within_the_sigma(void **state)
{
	struct run r = rolls(MOTION_FOOT, 0.4, 0, 0.008);

	(void)state;
	assert_int_equal(r.stances, STRIDES + 1);
	assert_true(worst_sigmas(&r) < 3);
	assert_true(r.out.sigma.position_m.x > 0.008 * STRIDES);
}

static void test_short_stances_are_used_less_and_the_sigma_says_so(void **state)
{
	struct run usual = walks(MOTION_FOOT, 0.4, 0), quick = walks(MOTION_FOOT, 0.2, 0);

	(void)state;
	assert_true(worst_sigmas(&quick) < 3);
	assert_true(vec3_norm(quick.out.sigma.position_m) > 1.5 * vec3_norm(usual.out.sigma.position_m));
}

static void test_the_stance_time_is_the_shortest_standstill_that_counts(void **state)
{
	struct run longer = walks(MOTION_FOOT, 0.4, 0.6), other = walks(MOTION_HAND_HELD, 0.4, 0);

	(void)state;
	assert_int_equal(longer.stances, 2); /* before and after the walk */
	assert_true(worst_sigmas(&longer) < 3);
	assert_true(other.stances < STRIDES / 2); /* 0.3 s of the usual limits are too long */
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_each_stance_of_a_walk_is_a_zero_velocity_update),
		cmocka_unit_test(test_a_foot_that_rolls_on_in_each_stance_stays_within_the_sigma),
		cmocka_unit_test(test_short_stances_are_used_less_and_the_sigma_says_so),
		cmocka_unit_test(test_the_stance_time_is_the_shortest_standstill_that_counts),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
