/* The paper's equations (7)-(12) and their rigid-body counterparts. */
#include "model_test.h"

#include "model/seed.h"

static const double G = 9.81;

static struct seed_motion any_seed_motion(void)
{
	struct seed_motion m = {any_vec(PI), any_vec(20), any_vec(200)};

	return m;
}

static struct rigid_motion any_rigid_motion(void)
{
	struct rigid_motion m = {any_attitude(), any_vec(20), any_vec(200)};

	return m;
}

static void test_eq7_is_eq6_applied_to_gravity(void **state)
{
	(void)state;
	for (int i = 0; i < 1000; i++) {
		struct vec3 a = any_vec(PI);

		assert_vec_near(seed_gravity(a, G), mat3_apply(seed_rxyz_inverse(a), (struct vec3){0, 0, G}), 1e-13);
	}
}

static void test_eq8_of_a_level_object_at_rest_reads_plus_g_upwards(void **state)
{
	(void)state;
	assert_vec_near(seed_static((struct vec3){0, 0, 0}, (struct vec3){0, 0, 0}, G), ((struct vec3){0, 0, G}), 0);
}

static void test_eq9_adds_the_lever_arm_terms_the_seed_prints(void **state)
{
	/* One derivative at a time: which axis it reaches, and its sign. */
	static const struct {
		struct vec3 rates, accels, term;
	} printed[] = {
		{{3, 0, 0}, {0, 0, 0}, {0, 9 * 0.2, 0}},  /* phi'^2 r_s */
		{{0, 3, 0}, {0, 0, 0}, {9 * 0.1, 0, 0}},  /* theta'^2 r_l */
		{{0, 0, 3}, {0, 0, 0}, {0, 9 * 0.2, 0}},  /* psi'^2 r_s */
		{{0, 0, 0}, {5, 0, 0}, {0, 0, 5 * 0.3}},  /* phi'' r_t */
		{{0, 0, 0}, {0, 5, 0}, {0, 0, -5 * 0.3}}, /* -theta'' r_t */
		{{0, 0, 0}, {0, 0, 5}, {5 * 0.1, 0, 0}},  /* psi'' r_l */
	};
	const struct vec3 r = {0.1, 0.2, 0.3}, a = {1, -2, 3};

	(void)state;
	for (size_t i = 0; i < sizeof(printed) / sizeof(printed[0]); i++) {
		struct seed_motion m = {{0.3, -0.2, 1}, printed[i].rates, printed[i].accels};
		struct vec3 more = vec3_sub(seed_dynamic(a, &m, r, G), seed_static(a, m.angles_rad, G));

		assert_vec_near(more, printed[i].term, 1e-14);
	}
}

static void test_eq10_is_eq9_turned_into_the_global_frame(void **state)
{
	(void)state;
	for (int i = 0; i < 1000; i++) {
		struct seed_motion m = any_seed_motion();
		struct vec3 a = any_vec(20), r = any_vec(0.5);

		assert_vec_near(seed_dynamic_global(a, &m, r, G),
			mat3_apply(seed_rxyz(m.angles_rad), seed_dynamic(a, &m, r, G)), 1e-10);
	}
}

static void test_eq11_is_eq9_with_the_noise_added(void **state)
{
	struct seed_motion m = any_seed_motion();
	struct vec3 a = any_vec(20), r = any_vec(0.5), noise = any_vec(1);

	(void)state;
	assert_vec_near(vec3_sub(seed_noisy(a, &m, r, G, noise), seed_dynamic(a, &m, r, G)), noise, 1e-12);
}

static void test_eq12_inverts_eq9(void **state)
{
	(void)state;
	for (int i = 0; i < 1000; i++) {
		struct seed_motion m = any_seed_motion();
		struct vec3 a = any_vec(20), r = any_vec(0.5);

		assert_vec_near(seed_estimate(seed_dynamic(a, &m, r, G), &m, r, G), a, 1e-9);
	}
}

static void test_the_exact_estimator_inverts_the_rigid_body(void **state)
{
	(void)state;
	for (int i = 0; i < 1000; i++) {
		struct rigid_motion m = any_rigid_motion();
		struct vec3 a = any_vec(20), r = any_vec(0.5);

		assert_vec_near(rigid_estimate(rigid_dynamic(a, &m, r, G), &m, r, G), a, 1e-9);
	}
}

static void test_the_rigid_body_in_the_global_frame_is_the_same_measurement_turned(void **state)
{
	(void)state;
	for (int i = 0; i < 1000; i++) {
		struct rigid_motion m = any_rigid_motion();
		struct vec3 a = any_vec(20), r = any_vec(0.5), noise = any_vec(1);

		assert_vec_near(
			rigid_dynamic_global(a, &m, r, G), quat_rotate(m.q_nb, rigid_dynamic(a, &m, r, G)), 1e-10);
		assert_vec_near(vec3_sub(rigid_noisy(a, &m, r, G, noise), rigid_dynamic(a, &m, r, G)), noise, 1e-12);
	}
}

/* A tumbling body whose reference point moves, in closed form: its angles as in the paper, and their derivatives. */
static struct vec3 angles_at(double t)
{
	return (struct vec3){0.7 * sin(2 * t), 0.9 * cos(1.5 * t), 0.4 * t + 0.5 * sin(3 * t)};
}

static struct seed_motion motion_at(double t)
{
	return (struct seed_motion){
		.angles_rad = angles_at(t),
		.rates_rad_s = {1.4 * cos(2 * t), -1.35 * sin(1.5 * t), 0.4 + 1.5 * cos(3 * t)},
		.accels_rad_s2 = {-2.8 * sin(2 * t), -2.025 * cos(1.5 * t), -4.5 * sin(3 * t)},
	};
}

static struct vec3 place_at(double t)
{
	return (struct vec3){0.3 * sin(4 * t), 0.2 * cos(3 * t), 0.1 * t * t};
}

static struct vec3 accelerometer_at(double t, struct vec3 r_b)
{
	return vec3_add(place_at(t), quat_rotate(quat_from_seed_angles(angles_at(t)), r_b));
}

/* Independent of every formula under test but (5): positions differentiated twice by a five-point rule. */
static struct vec3 second_derivative(struct vec3 (*at)(double, struct vec3), double t, struct vec3 r)
{
	static const double weight[5] = {-1.0 / 12, 4.0 / 3, -5.0 / 2, 4.0 / 3, -1.0 / 12};
	const double h = 1e-3;
	struct vec3 sum = {0, 0, 0};

	for (int i = 0; i < 5; i++)
		sum = vec3_add(sum, vec3_scale(weight[i] / (h * h), at(t + (i - 2) * h, r)));
	return sum;
}

static struct vec3 place_of(double t, struct vec3 unused)
{
	(void)unused;
	return place_at(t);
}

static void test_the_acceleration_of_a_tumbling_body_agrees_with_its_path(void **state)
{
	const struct vec3 r = {0.12, -0.07, 0.2}, none = {0, 0, 0};

	(void)state;
	for (double t = 0; t < 6; t += 0.1) {
		struct seed_motion seed = motion_at(t);
		struct rigid_motion body = rigid_motion_from_seed(&seed);
		struct vec3 path_n = second_derivative(accelerometer_at, t, r);
		struct vec3 force_n = vec3_add(path_n, (struct vec3){0, 0, G});
		struct vec3 force_b = quat_rotate_inverse(body.q_nb, force_n);
		struct vec3 a_n = second_derivative(place_of, t, none);

		assert_vec_near(quat_rotate(body.q_nb, rigid_estimate(force_b, &body, r, G)), a_n, 1e-6);
	}
}

static void test_rates_of_the_seeds_angles_convert_to_a_rigid_body_and_back(void **state)
{
	(void)state;
	for (double t = 0; t < 6; t += 0.1) {
		struct seed_motion seed = motion_at(t), back;
		struct rigid_motion body = rigid_motion_from_seed(&seed);

		back = seed_motion_from_rigid(&body);
		assert_quat_near(quat_from_seed_angles(back.angles_rad), body.q_nb, 1e-14);
		assert_vec_near(back.rates_rad_s, seed.rates_rad_s, 1e-12);
		assert_vec_near(back.accels_rad_s2, seed.accels_rad_s2, 1e-11);
	}
}

static void test_near_gimbal_lock_the_seeds_rates_are_bounded(void **state)
{
	double most_rate = 0, most_accel = 0;

	(void)state;
	for (double off = 0.1; off > 1e-15; off /= 2)
		for (int i = 0; i < 100; i++) {
			struct vec3 angles = {PI * any(), PI / 2 - off, PI * any()};
			struct rigid_motion body = {quat_from_seed_angles(angles), any_vec(10), any_vec(100)};
			struct seed_motion seed = seed_motion_from_rigid(&body);

			most_rate = fmax(most_rate, vec3_norm(seed.rates_rad_s));
			most_accel = fmax(most_accel, vec3_norm(seed.accels_rad_s2));
		}
	assert_true(most_rate < 1e3 && most_accel < 1e5);
}

static void test_a_roll_shows_where_the_seed_and_the_rigid_body_differ(void **state)
{
	const struct vec3 omega = {10, 0, 0}, alpha = {50, 0, 0}, r = {0, 0.05, 0};
	const struct rigid_motion body = {QUAT_IDENTITY, omega, alpha};
	const struct seed_motion seed = seed_motion_from_rigid(&body);

	(void)state;
	assert_vec_near(rigid_lever_arm(omega, alpha, r), ((struct vec3){0, -5, 2.5}), 1e-14);
	assert_vec_near(seed_lever_arm(&seed, r), ((struct vec3){0, +5, 0}), 1e-14);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_eq7_is_eq6_applied_to_gravity),
		cmocka_unit_test(test_eq8_of_a_level_object_at_rest_reads_plus_g_upwards),
		cmocka_unit_test(test_eq9_adds_the_lever_arm_terms_the_seed_prints),
		cmocka_unit_test(test_eq10_is_eq9_turned_into_the_global_frame),
		cmocka_unit_test(test_eq11_is_eq9_with_the_noise_added),
		cmocka_unit_test(test_eq12_inverts_eq9),
		cmocka_unit_test(test_the_exact_estimator_inverts_the_rigid_body),
		cmocka_unit_test(test_the_rigid_body_in_the_global_frame_is_the_same_measurement_turned),
		cmocka_unit_test(test_the_acceleration_of_a_tumbling_body_agrees_with_its_path),
		cmocka_unit_test(test_rates_of_the_seeds_angles_convert_to_a_rigid_body_and_back),
		cmocka_unit_test(test_near_gimbal_lock_the_seeds_rates_are_bounded),
		cmocka_unit_test(test_a_roll_shows_where_the_seed_and_the_rigid_body_differ),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
