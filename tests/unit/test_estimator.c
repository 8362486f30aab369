/* Acceleration of the reference point. */
#include "model_test.h"

#include "model/estimator.h"
#include "model/seed.h"

static const double G = 9.81;

static struct vec3 accel_b(
	const struct estimator_config *c, struct vec3 force_b_m_s2, struct quat q_nb, const struct body_rates *rates)
{
	return estimator_accel_b(c, force_b_m_s2, q_nb, estimator_lever_arm_b(c, q_nb, rates));
}

static struct estimator_config config(enum lever_arm_model model, struct vec3 r)
{
	return (struct estimator_config){.lever_arm_b_m = r, .model = model, .gravity_m_s2 = G};
}

static void test_an_object_at_rest_in_any_attitude_does_not_accelerate(void **state)
{
	const struct body_rates still = {{0, 0, 0}, {0, 0, 0}};

	(void)state;
	for (int model = LEVER_ARM_OFF; model <= LEVER_ARM_AUTO; model++) {
		struct estimator_config c = config((enum lever_arm_model)model, any_vec(1));
		struct quat q = any_attitude();
		struct vec3 force = quat_rotate_inverse(q, (struct vec3){0, 0, G});

		assert_vec_near(accel_b(&c, force, q, &still), ((struct vec3){0, 0, 0}), 1e-14);
	}
}

static void test_the_rigid_body_model_returns_the_true_acceleration(void **state)
{
	(void)state;
	for (int i = 0; i < 1000; i++) {
		struct rigid_motion m = {any_attitude(), any_vec(20), any_vec(200)};
		struct body_rates rates = {m.omega_b_rad_s, m.alpha_b_rad_s2};
		struct vec3 a = any_vec(20), r = any_vec(1);
		struct estimator_config c = config(LEVER_ARM_RIGID_BODY, r);

		assert_vec_near(accel_b(&c, rigid_dynamic(a, &m, r, G), m.q_nb, &rates), a, 1e-9);
	}
}

static void test_the_seeds_model_inverts_the_seeds_measurement(void **state)
{
	(void)state;
	for (int i = 0; i < 1000; i++) {
		struct vec3 angles = any_vec(PI / 2 - 0.2);
		struct seed_motion m = {angles, any_vec(5), any_vec(50)};
		struct rigid_motion body = rigid_motion_from_seed(&m);
		struct body_rates rates = {body.omega_b_rad_s, body.alpha_b_rad_s2};
		struct vec3 a = any_vec(20), r = any_vec(1);
		struct estimator_config c = config(LEVER_ARM_SEED_EQ12, r);

		assert_vec_near(accel_b(&c, seed_dynamic(a, &m, r, G), body.q_nb, &rates), a, 1e-9);
	}
}

static void test_without_a_lever_arm_all_models_agree(void **state)
{
	struct quat q = any_attitude();
	struct body_rates rates = {any_vec(20), any_vec(200)};
	struct vec3 force = any_vec(20), none = {0, 0, 0}, a[3];

	(void)state;
	for (int model = 0; model < 3; model++) {
		struct estimator_config c = config((enum lever_arm_model)model, none);

		a[model] = accel_b(&c, force, q, &rates);
	}
	assert_vec_near(a[1], a[0], 0);
	assert_vec_near(a[2], a[0], 0);
}

static void test_a_configuration_out_of_range_is_refused(void **state)
{
	const struct estimator_config good = config(LEVER_ARM_RIGID_BODY, (struct vec3){1, 2, -10});
	struct estimator_config bad[6];

	(void)state;
	assert_int_equal(estimator_check(&good), 0);
	for (int i = 0; i < 6; i++)
		bad[i] = good;
	bad[0].lever_arm_b_m.x = 10.01;
	bad[1].lever_arm_b_m.z = NAN;
	bad[2].model = (enum lever_arm_model)4;
	bad[3].rates_from = (enum rate_source)2;
	bad[4].gravity_m_s2 = 8.9;
	bad[5].gravity_m_s2 = NAN;
	for (int i = 0; i < 6; i++)
		assert_int_equal(estimator_check(&bad[i]), -EINVAL);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_an_object_at_rest_in_any_attitude_does_not_accelerate),
		cmocka_unit_test(test_the_rigid_body_model_returns_the_true_acceleration),
		cmocka_unit_test(test_the_seeds_model_inverts_the_seeds_measurement),
		cmocka_unit_test(test_without_a_lever_arm_all_models_agree),
		cmocka_unit_test(test_a_configuration_out_of_range_is_refused),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
