/* The load of a crane: a spherical pendulum under a trolley, integrated here from its equation of motion, u'' = -(g +
 * a - w)/L across u - |u'|^2 u, for the unit vector u from the trolley to the load, a: the trolley's acceleration, w:
 * wind. */
#include "model_test.h"

#include "model/pipeline.h"

#define RATE_HZ 100
#define G	9.81

enum { STEPS = 10 }; /* of the integration, a sample */
static const double BEGIN_S = 10, RAMP_S = 2;

struct lift {
	double rope_m, told_m;
	struct vec3 speed_m_s; /* of the trolley in its first drive; in the second one it is turned by a right angle */
	double cruise_s, wind_m_s2;
};

struct result {
	struct vec3 error_m, sigma_m;
	double worst_sigmas, length_m;
};

/* Share of the speed's change per second, t after its begin. */
static double ramp(double t)
{
	return t > 0 && t < RAMP_S ? (1 - cos(2 * PI * t / RAMP_S)) / RAMP_S : 0;
}

static struct vec3 trolley_acceleration(const struct lift *l, double t)
{
	double stop = BEGIN_S + RAMP_S + l->cruise_s, again = stop + 20;
	struct vec3 across = {-l->speed_m_s.y, l->speed_m_s.x, 0};
	double first = ramp(t - BEGIN_S) - ramp(t - stop), second = ramp(t - again) - ramp(t - again - l->cruise_s);

	return vec3_add(vec3_scale(first, l->speed_m_s), vec3_scale(second, across));
}

static struct vec3 across(struct vec3 u, struct vec3 v)
{
	return vec3_sub(v, vec3_scale(vec3_dot(u, v), u));
}

static struct result carry(const struct lift *l, double until_s)
{
	static struct pipeline pipeline;
	struct pipeline_config config = PIPELINE_DEFAULTS;
	struct pipeline_output out;
	struct vec3 u = {0, 0, -1}, du = {0, 0, 0}, trolley = {0, 0, 0}, v = {0, 0, 0};
	struct quat q = quat_from_rotation_vector((struct vec3){0, 0, 0.7});
	struct result r = {.worst_sigmas = 0};
	const double dt = 1.0 / RATE_HZ / STEPS;

	config.latency.sensor_s = config.latency.accelerometer_s = 0;
	config.position.longest_integration_s = 0;
	config.position.navigation.preset = MOTION_HANGING_LOAD;
	config.position.navigation.rope_m = l->told_m;
	assert_int_equal(pipeline_init(&pipeline, &config, RATE_HZ), 0);
	for (int k = 0; k < (int)lround(until_s * RATE_HZ); k++) {
		struct imu_sample sample = {.t_us = (uint64_t)(k + 1) * 10000, .flags = SAMPLE_MAG};
		struct vec3 force = {0, 0, 0}, turned = {0, 0, 0}, load, s;

		for (int i = 0; i < STEPS; i++) {
			double t = (k * STEPS + i) * dt;
			struct vec3 wind = {0, t > BEGIN_S ? l->wind_m_s2 * (1 + 0.5 * sin(0.7 * t)) : 0, 0};
			struct vec3 a = trolley_acceleration(l, t),
				    pull = vec3_sub(vec3_add((struct vec3){0, 0, G}, a), wind);
			struct vec3 ddu = vec3_sub(vec3_scale(-1 / l->rope_m, across(u, pull)),
				vec3_add(vec3_scale(vec3_dot(du, du), u), vec3_scale(0.01, du)));
			struct vec3 accel = vec3_add(a, vec3_scale(l->rope_m, ddu)), rate;

			du = across(u, vec3_add(du, vec3_scale(dt, ddu)));
			rate = vec3_cross(u, du);
			u = vec3_add(u, vec3_scale(dt, du));
			u = vec3_scale(1 / vec3_norm(u), u);
			turned = vec3_add(turned, vec3_scale(1.0 / STEPS, quat_rotate_inverse(q, rate)));
			q = quat_normalize(quat_multiply(quat_from_rotation_vector(vec3_scale(dt, rate)), q));
			force = vec3_add(
				force, vec3_scale(1.0 / STEPS,
					       quat_rotate_inverse(q, vec3_add(accel, (struct vec3){0, 0, G}))));
			trolley = vec3_add(trolley, vec3_scale(dt, v));
			v = vec3_add(v, vec3_scale(dt, a));
		}
		sample.accel_m_s2 = vec3_add(vec3_add(force, (struct vec3){0.02, -0.015, 0.01}), any_vec(0.025));
		sample.gyro_rad_s = vec3_add(turned, any_vec(0.1 * RAD_PER_DEG));
		sample.mag_uT = vec3_add(quat_rotate_inverse(q, (struct vec3){0, 20, -44}), any_vec(0.5));
		assert_int_equal(pipeline_step(&pipeline, &sample, &out), 0);
		load = vec3_add(trolley, vec3_scale(l->rope_m, vec3_add(u, (struct vec3){0, 0, 1})));
		r.error_m = vec3_sub(out.position_n_m, load);
		r.sigma_m = s = out.sigma.position_m;
		if (k > 5 * RATE_HZ)
			r.worst_sigmas = fmax(r.worst_sigmas, fmax(fabs(r.error_m.x) / hypot(s.x, 1e-3),
								      fmax(fabs(r.error_m.y) / hypot(s.y, 1e-3),
									      fabs(r.error_m.z) / hypot(s.z, 1e-3))));
	}
	r.length_m = pipeline.position.navigation.rope.length_m;
	return r;
}

/* Other ropes, speeds and directions; a length that is told 20 % wrong. The second drive begins while the load still
 * swings. */
static void test_a_load_is_followed_through_two_drives_whatever_length_was_told(void **state)
{
	const struct lift lifts[] = {
		{5, 5, {0.5, 0, 0}, 15, 0},
		{5, 4, {0.3, 0.4, 0}, 15, 0},
		{5, 6, {-0.5, 0.2, 0}, 15, 0},
		{12, 12, {0.8, 0, 0}, 20, 0},
		{12, 10, {0, -1.2, 0}, 20, 0},
		{2.5, 2.5, {0.2, 0.2, 0}, 15, 0},
	};

	(void)state;
	for (size_t i = 0; i < sizeof(lifts) / sizeof(lifts[0]); i++) {
		const struct lift *l = &lifts[i];
		struct result r = carry(l, BEGIN_S + 2 * l->cruise_s + 2 * RAMP_S + 40);

		print_message("rope %.1f m, told %.1f, found %.2f: %.2f %.2f %.2f m off, sigma %.2f, worst %.1f\n",
			l->rope_m, l->told_m, r.length_m, r.error_m.x, r.error_m.y, r.error_m.z, r.sigma_m.x,
			r.worst_sigmas);
		assert_true(vec3_norm(r.error_m) < 1.5);
		assert_true(r.worst_sigmas < 3);
		assert_true(fabs(r.length_m / l->rope_m - 1) < 0.03);
		assert_true(vec3_norm(r.sigma_m) < 8);
	}
}

/* What hangs obliquely in the wind hangs all the same: the rope tells where the trolley is. */
static void test_wind_does_not_matter(void **state)
{
	const struct lift l = {5, 5, {0.5, 0, 0}, 15, 0.2};
	struct result r = carry(&l, 60);

	(void)state;
	print_message("wind: %.2f %.2f %.2f m off, sigma %.2f, worst %.1f\n", r.error_m.x, r.error_m.y, r.error_m.z,
		r.sigma_m.x, r.worst_sigmas);
	assert_true(vec3_norm(r.error_m) < 1.5);
	assert_true(r.worst_sigmas < 3);
}

static void test_a_rope_of_unknown_length_is_no_rope(void **state)
{
	const struct lift l = {5, 0, {0.5, 0, 0}, 15, 0};
	const struct lift told = {5, 5, {0.5, 0, 0}, 15, 0};
	struct result r = carry(&l, 60), known = carry(&told, 60);

	(void)state;
	assert_true(r.worst_sigmas < 3);
	assert_true(vec3_norm(r.sigma_m) > 3 * vec3_norm(known.sigma_m));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_load_is_followed_through_two_drives_whatever_length_was_told),
		cmocka_unit_test(test_wind_does_not_matter),
		cmocka_unit_test(test_a_rope_of_unknown_length_is_no_rope),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
