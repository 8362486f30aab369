/* Rest detection. */
#include "model_test.h"

#include "model/rest.h"

static const double DT_S = 0.01;
static const struct rest_config CONFIG = {2 * RAD_PER_DEG, 0.5, 1.5};
static const struct vec3 STILL = {0, 0, 0}, UP = {0, 0, 9.81};

static struct rest rest(void)
{
	struct rest r;

	assert_int_equal(rest_init(&r, &CONFIG), 0);
	return r;
}

/* Steps for this time; true when the last sample was at rest. */
static bool after(struct rest *r, double time_s, struct vec3 gyro, struct vec3 force)
{
	bool at_rest = false;

	for (int k = 0; k < (int)lround(time_s / DT_S); k++)
		at_rest = rest_step(r, gyro, force, DT_S);
	return at_rest;
}

static void test_rest_is_seen_after_the_rest_time_and_not_before(void **state)
{
	struct rest r = rest();

	(void)state;
	assert_false(after(&r, 1.45, STILL, UP));
	assert_true(after(&r, 0.1, STILL, UP));
}

static void test_noise_below_the_thresholds_is_rest(void **state)
{
	struct rest r = rest();
	bool at_rest = false;

	(void)state;
	for (int k = 0; k < 200; k++)
		at_rest = rest_step(&r, any_vec(1 * RAD_PER_DEG), vec3_add(UP, any_vec(0.2)), DT_S);
	assert_true(at_rest);
}

static void test_one_sample_of_motion_ends_rest_at_once(void **state)
{
	struct rest turning = rest(), pushed = rest();

	(void)state;
	assert_true(after(&turning, 3, STILL, UP) && after(&pushed, 3, STILL, UP));
	assert_false(rest_step(&turning, (struct vec3){0, 0, 2.1 * RAD_PER_DEG}, UP, DT_S));
	assert_false(rest_step(&pushed, STILL, (struct vec3){0.51, 0, 9.81}, DT_S));
	assert_false(after(&turning, 1.4, STILL, UP));
}

/* White noise of one density: 2.2 times as much of it at 952 samples a second as at 200. */
static void test_a_sensor_at_rest_is_so_at_any_rate_of_samples(void **state)
{
	const double rates_hz[] = {50, 200, 952, 4000};

	(void)state;
	for (int i = 0; i < 4; i++) {
		double size = sqrt(rates_hz[i] / 200), rest_s = 0;
		struct rest r = rest();

		for (int k = 0; k < (int)(10 * rates_hz[i]); k++) {
			struct vec3 gyro = any_vec(0.5 * RAD_PER_DEG * size), force = vec3_add(UP, any_vec(0.1 * size));

			rest_s += rest_step(&r, gyro, force, 1 / rates_hz[i]) / rates_hz[i];
		}
		assert_true(rest_s > 8);
	}
}

static void test_a_steady_turn_is_not_rest(void **state)
{
	struct rest r = rest();

	(void)state;
	assert_false(after(&r, 10, (struct vec3){0, 0, 5 * RAD_PER_DEG}, UP));
}

static void test_a_small_gyro_bias_does_not_hide_rest(void **state)
{
	struct rest r = rest();

	(void)state;
	assert_true(after(&r, 3, (struct vec3){0, 0, 1.5 * RAD_PER_DEG}, UP));
}

static void test_a_restart_waits_the_rest_time_again(void **state)
{
	struct rest r = rest();

	(void)state;
	assert_true(after(&r, 3, STILL, UP));
	rest_restart(&r);
	assert_false(after(&r, 1.4, STILL, UP));
	assert_true(after(&r, 0.2, STILL, UP));
}

static void test_new_thresholds_take_effect_at_once(void **state)
{
	struct rest r = rest();
	struct rest_config patient = CONFIG;

	(void)state;
	assert_true(after(&r, 3, STILL, UP));
	patient.time_s = 10;
	assert_int_equal(rest_configure(&r, &patient), 0);
	assert_false(after(&r, 1, STILL, UP));
	assert_true(after(&r, 7, STILL, UP));
}

static void test_a_configuration_out_of_range_is_refused_and_the_old_one_stays(void **state)
{
	static const struct rest_config bad[] = {{0, 0.5, 1.5}, {-1, 0.5, 1.5}, {NAN, 0.5, 1.5}, {1, 0, 1.5},
		{1, INFINITY, 1.5}, {1, 0.5, -1}, {1, 0.5, NAN}};
	struct rest r = rest();

	(void)state;
	for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); i++) {
		assert_int_equal(rest_configure(&r, &bad[i]), -EINVAL);
		assert_int_equal(rest_init(&r, &bad[i]), -EINVAL);
	}
	assert_near(r.config.time_s, 1.5, 0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_rest_is_seen_after_the_rest_time_and_not_before),
		cmocka_unit_test(test_noise_below_the_thresholds_is_rest),
		cmocka_unit_test(test_one_sample_of_motion_ends_rest_at_once),
		cmocka_unit_test(test_a_sensor_at_rest_is_so_at_any_rate_of_samples),
		cmocka_unit_test(test_a_steady_turn_is_not_rest),
		cmocka_unit_test(test_a_small_gyro_bias_does_not_hide_rest),
		cmocka_unit_test(test_a_restart_waits_the_rest_time_again),
		cmocka_unit_test(test_new_thresholds_take_effect_at_once),
		cmocka_unit_test(test_a_configuration_out_of_range_is_refused_and_the_old_one_stays),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
