/* Position by double integration. */
#include "model_test.h"

#include "model/position.h"

static const double DT_S = 0.01;
static const struct vec3 ZERO = {0, 0, 0};

#define NAVIGATION                                 \
	{                                          \
		.standstill = STANDSTILL_DEFAULTS, \
	}

static struct position position(enum position_mode mode, double longest_s)
{
	struct position_config config = {.mode = mode, .longest_integration_s = longest_s, .navigation = NAVIGATION};
	struct position p;

	assert_int_equal(position_init(&p, &config), 0);
	return p;
}

static struct position no_limit(void)
{
	return position(POSITION_ZERO_VELOCITY_AT_REST, 0);
}

static void go(struct position *p, double time_s, struct vec3 accel, bool rest)
{
	for (int k = 0; k < (int)lround(time_s / DT_S); k++)
		position_step(p, accel, rest, DT_S);
}

static void test_the_position_is_the_double_integral_of_the_acceleration(void **state)
{
	struct position p = no_limit();
	double t = 0;

	/* a = sin: velocity 1 - cos, back to 0 after one period, distance 2 pi */
	(void)state;
	while (t < 2 * PI) {
		t += DT_S;
		position_step(&p, (struct vec3){sin(t), 0, -2 * sin(t)}, false, DT_S);
	}
	assert_vec_near(p.position_n_m, ((struct vec3){2 * PI, 0, -4 * PI}), 2e-3);
	assert_vec_near(p.velocity_n_m_s, ZERO, 1e-3);
}

static void test_the_trapezoidal_rule_is_used_with_the_actual_time(void **state)
{
	struct position p = no_limit();

	(void)state;
	position_step(&p, (struct vec3){2, 0, 0}, false, 0.1); /* mean 1 */
	assert_near(p.velocity_n_m_s.x, 0.1, 1e-15);
	assert_near(p.position_n_m.x, 0.005, 1e-15);
	position_step(&p, (struct vec3){4, 0, 0}, false, 0.2); /* mean 3 */
	assert_near(p.velocity_n_m_s.x, 0.7, 1e-15);
	assert_near(p.position_n_m.x, 0.085, 1e-15);
}

static const struct navigation_input NOWHERE = {.q_nb = {1, 0, 0, 0}, .gravity_m_s2 = 9.81};

/* Over missing samples nothing is integrated; the mean of the next interval is with the acceleration at their end. */
static void test_after_missing_samples_integration_continues_from_the_acceleration_then(void **state)
{
	struct position p = no_limit();

	(void)state;
	position_step(&p, (struct vec3){2, 0, 0}, false, 0.1);
	position_skip(&p, &NOWHERE, (struct vec3){6, 0, 0}, 100, 0.5);
	assert_near(p.velocity_n_m_s.x, 0.1, 1e-15);
	assert_near(p.moving_s, 0.6, 1e-15);
	position_step(&p, (struct vec3){4, 0, 0}, false, 0.2); /* mean 5 */
	assert_near(p.velocity_n_m_s.x, 1.1, 1e-15);
	assert_near(p.position_n_m.x, 0.005 + 0.12, 1e-15);
}

static void test_rest_zeroes_the_velocity_and_holds_the_position(void **state)
{
	struct position p = no_limit();
	struct vec3 there;

	(void)state;
	go(&p, 1, (struct vec3){1, 0, 0}, false);
	there = p.position_n_m;
	assert_true(there.x > 0.49);
	go(&p, 1, ZERO, true);
	assert_vec_near(p.velocity_n_m_s, ZERO, 0);
	assert_vec_near(p.position_n_m, there, 0);
}

static void test_the_mean_acceleration_at_rest_is_subtracted_in_the_movement_after_it(void **state)
{
	const struct vec3 error = {0.05, -0.02, 0.1};
	struct position p = no_limit();

	(void)state;
	go(&p, 10, error, true);
	go(&p, 10, error, false);
	assert_vec_near(p.position_n_m, ZERO, 0.001); /* 5 m without it */
}

static void test_after_the_longest_integration_time_the_position_is_held(void **state)
{
	struct position p = position(POSITION_ZERO_VELOCITY_AT_REST, 2);
	struct vec3 held;

	(void)state;
	go(&p, 1.99, (struct vec3){1, 0, 0}, false);
	assert_false(position_limited(&p));
	go(&p, 0.03, (struct vec3){1, 0, 0}, false);
	assert_true(position_limited(&p));
	assert_vec_near(p.velocity_n_m_s, ZERO, 0);
	held = p.position_n_m;
	go(&p, 5, (struct vec3){1, 0, 0}, false);
	assert_vec_near(p.position_n_m, held, 0);
}

static void test_a_rest_restarts_the_integration_time(void **state)
{
	struct position p = position(POSITION_ZERO_VELOCITY_AT_REST, 2);

	(void)state;
	go(&p, 3, (struct vec3){1, 0, 0}, false);
	assert_true(position_limited(&p));
	go(&p, 0.01, ZERO, true);
	assert_false(position_limited(&p));
	go(&p, 1, (struct vec3){1, 0, 0}, false);
	assert_true(p.velocity_n_m_s.x > 0.9);
}

static void test_a_gap_is_not_integrated_but_its_time_counts(void **state)
{
	struct position p = position(POSITION_ZERO_VELOCITY_AT_REST, 2);
	struct vec3 velocity, there;

	(void)state;
	go(&p, 1, (struct vec3){1, 0, 0}, false);
	velocity = p.velocity_n_m_s;
	there = p.position_n_m;
	position_skip(&p, &NOWHERE, (struct vec3){50, 0, 0}, 100, 1.5);
	assert_vec_near(p.velocity_n_m_s, velocity, 0);
	assert_vec_near(p.position_n_m, there, 0);
	assert_true(position_limited(&p));
}

static void test_with_the_position_off_it_stays_at_the_origin(void **state)
{
	struct position p = no_limit();
	const struct position_config off = {.mode = POSITION_OFF, .navigation = NAVIGATION};

	(void)state;
	go(&p, 1, (struct vec3){1, 0, 0}, false);
	assert_int_equal(position_configure(&p, &off), 0);
	go(&p, 1, (struct vec3){1, 0, 0}, false);
	assert_vec_near(p.velocity_n_m_s, ZERO, 0);
	assert_vec_near(p.position_n_m, ZERO, 0);
	assert_false(position_limited(&p));
}

static void test_a_reset_returns_to_the_origin_and_restarts_the_integration_time(void **state)
{
	struct position p = position(POSITION_ZERO_VELOCITY_AT_REST, 2);

	(void)state;
	go(&p, 3, (struct vec3){1, 0, 0}, false);
	position_reset(&p);
	assert_vec_near(p.velocity_n_m_s, ZERO, 0);
	assert_vec_near(p.position_n_m, ZERO, 0);
	assert_false(position_limited(&p));
}

static void test_a_configuration_out_of_range_is_refused_and_the_old_one_stays(void **state)
{
	static const struct position_config bad[] = {
		{.mode = (enum position_mode)3, .navigation = NAVIGATION},
		{.longest_integration_s = -1, .navigation = NAVIGATION},
		{.longest_integration_s = NAN, .navigation = NAVIGATION},
		{.longest_integration_s = INFINITY, .navigation = NAVIGATION},
		{.sigma_limit_m = -1, .navigation = NAVIGATION},
		{.mode = POSITION_NAVIGATION},
	};
	struct position p = no_limit();

	(void)state;
	for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); i++) {
		assert_int_equal(position_configure(&p, &bad[i]), -EINVAL);
		assert_int_equal(position_init(&p, &bad[i]), -EINVAL);
	}
	assert_int_equal(p.config.mode, POSITION_ZERO_VELOCITY_AT_REST);
}

static void test_without_navigation_there_is_no_sigma_and_no_displacement(void **state)
{
	static const enum position_mode modes[2] = {POSITION_OFF, POSITION_ZERO_VELOCITY_AT_REST};

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct position p = position(POSITION_NAVIGATION, 0);
		struct position_config config = p.config;
		const struct vec3 some = {1, 2, 3};

		p.sigma = (struct navigation_sigma){some, some, some, some, some};
		p.displacement_n_m = p.displacement_sigma_m = some;
		p.navigation.started = true;
		config.mode = modes[i];
		assert_int_equal(position_configure(&p, &config), 0);
		assert_false(p.navigation.started); /* it starts again when it is switched on again */
		assert_vec_near(p.sigma.attitude_rad, ZERO, 0);
		assert_vec_near(p.sigma.accel_m_s2, ZERO, 0);
		assert_vec_near(p.sigma.velocity_m_s, ZERO, 0);
		assert_vec_near(p.sigma.position_m, ZERO, 0);
		assert_vec_near(p.sigma.displacement_m, ZERO, 0);
		assert_vec_near(p.displacement_n_m, ZERO, 0);
		assert_vec_near(p.displacement_sigma_m, ZERO, 0);
	}
}

/* 0.25 s of a time constant of 1 s have the share 0.25 / 1.25. */
static void test_the_mean_acceleration_at_rest_has_a_time_constant_of_a_second(void **state)
{
	struct position p = no_limit();

	(void)state;
	position_step(&p, (struct vec3){1, 0, 0}, true, 0.25);
	position_step(&p, (struct vec3){1, 0, 0}, false, 0.1);
	assert_near(p.velocity_n_m_s.x, 0.1 * (1 - 0.2), 1e-15);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_position_is_the_double_integral_of_the_acceleration),
		cmocka_unit_test(test_the_trapezoidal_rule_is_used_with_the_actual_time),
		cmocka_unit_test(test_after_missing_samples_integration_continues_from_the_acceleration_then),
		cmocka_unit_test(test_rest_zeroes_the_velocity_and_holds_the_position),
		cmocka_unit_test(test_the_mean_acceleration_at_rest_is_subtracted_in_the_movement_after_it),
		cmocka_unit_test(test_after_the_longest_integration_time_the_position_is_held),
		cmocka_unit_test(test_a_rest_restarts_the_integration_time),
		cmocka_unit_test(test_a_gap_is_not_integrated_but_its_time_counts),
		cmocka_unit_test(test_with_the_position_off_it_stays_at_the_origin),
		cmocka_unit_test(test_a_reset_returns_to_the_origin_and_restarts_the_integration_time),
		cmocka_unit_test(test_a_configuration_out_of_range_is_refused_and_the_old_one_stays),
		cmocka_unit_test(test_without_navigation_there_is_no_sigma_and_no_displacement),
		cmocka_unit_test(test_the_mean_acceleration_at_rest_has_a_time_constant_of_a_second),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
