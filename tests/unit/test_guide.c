/* What moves along a guide (model/guide.h): its functions alone, against closed forms. */
#include "model_test.h"

#include "model/guide.h"

static const double G = 9.81, DT_S = 0.01;
static const struct vec3 ZERO = {0, 0, 0};

/* An interval of DT_S of one sample: rate and specific force in the global frame, which is the object's. */
static struct navigation_sums interval(struct vec3 rate, struct vec3 force)
{
	const struct mat3 same = mat3_from_quat((struct quat){1, 0, 0, 0});
	struct navigation_sums s = {.t_s = 0};

	navigation_sums_add(&s, &same, rate, force, ZERO, DT_S);
	return s;
}

static struct guide engaged(void)
{
	const struct guide_start start = {.q_nb = {1, 0, 0, 0}};
	struct guide g = {.holds = false};

	guide_engage(&g, &start);
	assert_true(g.holds);
	return g;
}

/* A turn decays with a time constant of a second, all of it is taken back, and nothing is lost. */
static void test_a_turn_decays_with_a_time_constant_of_a_second(void **state)
{
	const struct mat3 same = mat3_from_quat((struct quat){1, 0, 0, 0});
	const struct vec3 turn = {0.01, -0.02, 0.03};
	struct navigation_sums s = interval(vec3_scale(1 / DT_S, turn), ZERO);
	struct guide g = engaged();
	struct vec3 back = guide_hold(&g, &same, &s);

	(void)state;
	s = interval(ZERO, ZERO);
	for (int k = 1; k < 300; k++) {
		back = vec3_add(back, guide_hold(&g, &same, &s));
		assert_vec_near(g.off_n_rad, vec3_scale(exp(-(k + 1) * DT_S), turn), 1e-3 * 0.03 * 4);
		assert_vec_near(vec3_add(back, g.off_n_rad), turn, 1e-12);
		assert_vec_near(g.taken_n_rad, back, 1e-12);
	}
	assert_near(g.t_s, 3, 1e-9);
}

/* The turn is that of the object in the global frame. */
static void test_the_turn_is_turned_into_the_global_frame(void **state)
{
	const struct mat3 quarter = mat3_from_quat(quat_from_rotation_vector((struct vec3){0, 0, PI / 2}));
	const struct navigation_sums s = interval((struct vec3){1, 0, 0}, ZERO);
	const struct vec3 turned = {0, DT_S, 0};
	struct guide g = engaged();
	const struct vec3 back = guide_hold(&g, &quarter, &s);

	(void)state;
	assert_vec_near(vec3_add(back, g.off_n_rad), turned, 1e-12);
}

/* An attitude that was turned back by phi about x sees gravity's force along -y: sin(phi) g t, and g t^2 / 2. */
static void test_what_was_taken_back_has_cost_its_share_of_gravity(void **state)
{
	const struct mat3 same = mat3_from_quat((struct quat){1, 0, 0, 0});
	const struct navigation_sums s = interval(ZERO, (struct vec3){0, 0, G});
	const struct vec3 cost = {0, -0.01 * G * 2, 0};
	struct guide g = engaged();

	(void)state;
	g.taken_n_rad.x = 0.01;
	for (int k = 0; k < 200; k++)
		guide_hold(&g, &same, &s);
	assert_vec_near(g.taken_n_m_s, cost, 1e-9);
	assert_vec_near(g.taken_n_m, cost, 0.006 * vec3_norm(cost));
}

/* 3 sigma of the gyro's noise and bias on three axes, and of 2 mrad of flexing. */
static void test_it_turns_beyond_3_sigma(void **state)
{
	static const struct {
		double density, bias_variance, t_s;
	} gyros[] = {{0, 0, 0}, {0.001, 0, 10}, {0, 1e-6, 10}, {0.001, 4e-6, 5}};

	(void)state;
	for (size_t i = 0; i < sizeof(gyros) / sizeof(gyros[0]); i++) {
		const double noise = 3 * pow(gyros[i].density, 2) / 2 * gyros[i].t_s,
			     bias = gyros[i].bias_variance * pow(gyros[i].t_s, 2),
			     limit = 3 * sqrt(noise + bias + 0.002 * 0.002);

		for (int axis = 0; axis < 3; axis++)
			for (int beyond = 0; beyond < 2; beyond++) {
				const double net = limit * (beyond ? 1.01 : 0.99);
				struct guide g = engaged();

				g.t_s = gyros[i].t_s;
				/* in part still there, in part taken back */
				g.off_n_rad = vec3_scale(0.3 * net, (struct vec3){axis == 0, axis == 1, axis == 2});
				g.taken_n_rad = vec3_scale(0.7 * net, (struct vec3){axis == 0, axis == 1, axis == 2});
				assert_int_equal(guide_turns(&g, gyros[i].density, gyros[i].bias_variance), beyond);
			}
	}
}

/* Noise of the gyro in the second in which it is held, and a direction that is uneven by 0.35 mrad: 1 sigma, correlated
 * over that second. Play and swaying are 10 mm/s, correlated over 0.1 s; plumb is a millimetre in a metre. */
static void test_walk_sway_and_plumb_line(void **state)
{
	(void)state;
	assert_near(guide_walk_m2_s3(0, G), G * G * 2 * 0.00035 * 0.00035, 1e-12);
	assert_near(guide_walk_m2_s3(0.001, G), G * G * (5e-7 + 2 * 0.00035 * 0.00035), 1e-12);
	assert_near(guide_sway_m2_s(0), 0.01 * 0.01 * 0.1, 1e-15);
	assert_near(guide_sway_m2_s(-2), 1e-5 + 0.0007 * 0.0007, 1e-15);
	assert_near(guide_plumb_m2(400), 0.02 * 0.02, 1e-15);
}

/* Of the bias at rest, gravity times the scale's error, at least 0.03 m/s^2 of bias itself, and gravity of 9.78 to
 * 9.83. */
static void test_the_share_of_the_scale_is_that_of_its_variance(void **state)
{
	const double by_scale2 = pow(0.01 * G, 2);

	(void)state;
	assert_near(guide_share_of_scale(0.1, 0.01, G), by_scale2 / (by_scale2 + 0.01 + 0.015 * 0.015), 1e-12);
	assert_near(guide_share_of_scale(0, 0.01, G), by_scale2 / (by_scale2 + 0.03 * 0.03 + 0.015 * 0.015), 1e-12);
	assert_near(guide_share_of_scale(0.029, 0.01, G), guide_share_of_scale(0, 0.01, G), 1e-12);
	assert_true(guide_share_of_scale(0.031, 0.01, G) < guide_share_of_scale(0, 0.01, G));
}

/* Beside the navigation: the attitude of the start, although that has turned, and the bias of the start. */
static void test_a_movement_is_integrated_with_attitude_and_bias_of_its_beginning(void **state)
{
	const struct quat at_start = quat_from_rotation_vector((struct vec3){0, 0, PI / 2}),
			  now = quat_from_rotation_vector((struct vec3){0.3, -0.2, 0.1});
	const struct mat3 r_nb = mat3_from_quat(now);
	const struct vec3 force_b = {1, 2, 12}, bias_now = {0.01, 0.02, 0.03}, bias_then = {0.03, -0.01, 0.02};
	const struct guide_start start = {.q_nb = at_start, .accel_bias_b_m_s2 = bias_then};
	const struct vec3 free_b = vec3_sub(force_b, bias_then),
			  accel_n = {-free_b.y, free_b.x, free_b.z - G}; /* a quarter turn */
	struct guide g = {.inclined = true};

	(void)state;
	guide_engage(&g, &start);
	assert_true(g.inclined); /* for good */
	for (int k = 0; k < 100; k++) {
		struct navigation_sums s = {.t_s = 0};

		navigation_sums_add(&s, &r_nb, ZERO, quat_rotate(now, vec3_sub(force_b, bias_now)), ZERO, DT_S);
		guide_integrate(&g, &r_nb, bias_now, G, &s);
	}
	assert_vec_near(g.free_n_m_s, accel_n, 1e-9);
	assert_vec_near(g.free_n_m, vec3_scale(0.5, accel_n), 1e-9);
}

/* Tilt times the vertical velocity, bias times the time, the walk, and swaying. */
static void test_it_is_inclined_beyond_3_sigma_of_the_horizontal_velocity(void **state)
{
	static const struct {
		double tilt, bias, t_s, up_m_s, walk;
	} lifts[] = {{0, 0, 0, 0, 0}, {4e-6, 0, 5, 2, 0}, {0, 1e-4, 5, 2, 0}, {0, 0, 5, 2, 1e-4}};

	(void)state;
	for (size_t i = 0; i < sizeof(lifts) / sizeof(lifts[0]); i++) {
		const double variance = lifts[i].tilt * pow(lifts[i].up_m_s, 2) + lifts[i].bias * pow(lifts[i].t_s, 2) +
					lifts[i].walk * lifts[i].t_s + 0.01 * 0.01;
		struct guide g = engaged();

		g.t_s = lifts[i].t_s;
		g.start.tilt_variance_rad2 = lifts[i].tilt;
		g.start.accel_variance_m2_s4 = lifts[i].bias;
		for (int beyond = 0; beyond < 2; beyond++)
			for (int axis = 0; axis < 2; axis++) {
				const double v = 3 * sqrt(2 * variance) * (beyond ? 1.01 : 0.99);

				g.free_n_m_s = (struct vec3){axis ? 0 : v, axis ? v : 0, lifts[i].up_m_s};
				assert_near(guide_free_variance_m2_s2(&g, lifts[i].walk), variance, 1e-12);
				assert_int_equal(guide_inclines(&g, lifts[i].walk), beyond);
			}
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_turn_decays_with_a_time_constant_of_a_second),
		cmocka_unit_test(test_the_turn_is_turned_into_the_global_frame),
		cmocka_unit_test(test_what_was_taken_back_has_cost_its_share_of_gravity),
		cmocka_unit_test(test_it_turns_beyond_3_sigma),
		cmocka_unit_test(test_walk_sway_and_plumb_line),
		cmocka_unit_test(test_the_share_of_the_scale_is_that_of_its_variance),
		cmocka_unit_test(test_a_movement_is_integrated_with_attitude_and_bias_of_its_beginning),
		cmocka_unit_test(test_it_is_inclined_beyond_3_sigma_of_the_horizontal_velocity),
	};

	return cmocka_run_group_tests_name("guide", tests, NULL, NULL);
}
