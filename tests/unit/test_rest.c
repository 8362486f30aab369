/* The standstill detector, with the parameters of the fusion and of the navigation. */
#include "model_test.h"

#include "model/rest.h"

static const double DT_S = 0.01;
static const struct rest_config CONFIG = REST_DEFAULTS, STANDSTILL = STANDSTILL_DEFAULTS;
static const struct vec3 STILL = {0, 0, 0}, UP = {0, 0, 9.81};

static bool step(struct rest *r, struct vec3 gyro, struct vec3 force)
{
	return rest_step(r, &CONFIG, gyro, force, DT_S);
}

/* Steps for this time; true when the last sample was at rest. */
static bool after(struct rest *r, double time_s, struct vec3 gyro, struct vec3 force)
{
	bool at_rest = false;

	for (int k = 0; k < (int)lround(time_s / DT_S); k++)
		at_rest = step(r, gyro, force);
	return at_rest;
}

static void test_rest_is_seen_after_the_rest_time_and_not_before(void **state)
{
	struct rest r = {.still_s = 0};

	(void)state;
	assert_false(after(&r, 1.45, STILL, UP));
	assert_true(after(&r, 0.1, STILL, UP));
}

static void test_noise_below_the_thresholds_is_rest(void **state)
{
	struct rest r = {.still_s = 0};
	bool at_rest = false;

	(void)state;
	for (int k = 0; k < 200; k++)
		at_rest = step(&r, any_vec(1 * RAD_PER_DEG), vec3_add(UP, any_vec(0.2)));
	assert_true(at_rest);
}

static void test_one_sample_of_motion_ends_rest_at_once(void **state)
{
	struct rest turning = {.still_s = 0}, pushed = {.still_s = 0};

	(void)state;
	assert_true(after(&turning, 3, STILL, UP) && after(&pushed, 3, STILL, UP));
	assert_false(step(&turning, (struct vec3){0, 0, 2.1 * RAD_PER_DEG}, UP));
	assert_false(step(&pushed, STILL, (struct vec3){0.51, 0, 9.81}));
	assert_false(after(&turning, 1.4, STILL, UP));
}

/* White noise of one density: 2.2 times as much of it at 952 samples a second as at 200. */
static void test_a_sensor_at_rest_is_so_at_any_rate_of_samples(void **state)
{
	const double rates_hz[] = {50, 200, 952, 4000};

	(void)state;
	for (int i = 0; i < 4; i++) {
		double size = sqrt(rates_hz[i] / 200), rest_s = 0;
		struct rest r = {.still_s = 0};

		for (int k = 0; k < (int)(10 * rates_hz[i]); k++) {
			struct vec3 gyro = any_vec(0.5 * RAD_PER_DEG * size), force = vec3_add(UP, any_vec(0.1 * size));

			rest_s += rest_step(&r, &CONFIG, gyro, force, 1 / rates_hz[i]) / rates_hz[i];
		}
		assert_true(rest_s > 8);
	}
}

/* The fusion tells a turn from a bias by the bias's sigma; a zero-velocity update has no such sigma. */
static void test_a_steady_turn_is_no_standstill_and_as_steady_as_rest(void **state)
{
	const struct vec3 turn = {0, 0, 5 * RAD_PER_DEG};
	struct rest r = {.still_s = 0}, s = {.still_s = 0};

	(void)state;
	assert_true(after(&r, 10, turn, UP));
	for (int k = 0; k < 1000; k++)
		assert_false(rest_step(&s, &STANDSTILL, turn, UP, DT_S));
}

static void test_a_small_gyro_bias_does_not_hide_rest(void **state)
{
	struct rest r = {.still_s = 0};

	(void)state;
	assert_true(after(&r, 3, (struct vec3){0, 0, 1.5 * RAD_PER_DEG}, UP));
}

static void test_a_restart_waits_the_rest_time_again(void **state)
{
	struct rest r = {.still_s = 0};

	(void)state;
	assert_true(after(&r, 3, STILL, UP));
	rest_restart(&r);
	assert_false(after(&r, 1.4, STILL, UP));
	assert_true(after(&r, 0.2, STILL, UP));
}

static void test_a_new_dwell_time_takes_effect_at_once(void **state)
{
	struct rest r = {.still_s = 0};
	struct rest_config patient = CONFIG;

	(void)state;
	assert_true(after(&r, 3, STILL, UP));
	patient.time_s = 10;
	assert_false(rest_step(&r, &patient, STILL, UP, DT_S));
	for (int k = 0; k < (int)lround(7 / DT_S); k++)
		rest_step(&r, &patient, STILL, UP, DT_S);
	assert_true(rest_step(&r, &patient, STILL, UP, DT_S));
}

/* A push that grows by 0.1 m/s^2 a second, or a turn by 0.3 deg/s^2: within the thresholds, the deviation from the
 * short mean is that of rest. */
static void test_only_the_slow_mean_sees_a_motion_that_begins_gently(void **state)
{
	(void)state;
	for (int turn = 0; turn < 2; turn++) {
		struct rest rest = {.still_s = 0}, standstill = rest;
		bool rest_ended = false, standstill_ended = false;

		for (int k = -300; k < 300; k++) {
			double t = fmax(0, k * DT_S);
			const struct vec3 gyro = {0, turn ? 0.3 * RAD_PER_DEG * t : 0, 0};
			const struct vec3 force = {turn ? 0 : 0.1 * t, 0, 9.81};

			rest_ended |= !rest_step(&rest, &CONFIG, gyro, force, DT_S) && k > 0;
			standstill_ended |= !rest_step(&standstill, &STANDSTILL, gyro, force, DT_S) && k > 0;
		}
		assert_false(rest_ended);
		assert_true(standstill_ended);
	}
}

static void test_one_outlier_does_not_end_a_standstill_but_ends_rest(void **state)
{
	struct rest rest = {.still_s = 0}, standstill = rest;
	const struct vec3 outlier = {0.6, 0, 9.81};

	(void)state;
	for (int k = 0; k < 300; k++) {
		rest_step(&rest, &CONFIG, STILL, UP, DT_S);
		rest_step(&standstill, &STANDSTILL, STILL, UP, DT_S);
	}
	assert_false(rest_step(&rest, &CONFIG, STILL, outlier, DT_S));
	assert_true(rest_step(&standstill, &STANDSTILL, STILL, outlier, DT_S));
}

/* To and fro 10 times a second, so that the mean is small and the mean square large. */
static void test_a_standstill_is_seen_within_a_second_of_a_violent_motion(void **state)
{
	struct rest r = {.still_s = 0};
	int k = 0;

	(void)state;
	for (int i = 0; i < 300; i++) {
		double to_and_fro = i / 5 % 2 ? 1 : -1;

		rest_step(&r, &STANDSTILL, (struct vec3){to_and_fro, 0, 0},
			vec3_add(UP, (struct vec3){0, to_and_fro, 0}), DT_S);
	}
	while (!rest_step(&r, &STANDSTILL, STILL, UP, DT_S))
		assert_true(++k * DT_S < 1);
}

static void test_a_configuration_out_of_range_is_refused(void **state)
{
	struct rest_config bad[15];

	(void)state;
	assert_int_equal(rest_check(&CONFIG), 0);
	assert_int_equal(rest_check(&STANDSTILL), 0);
	for (int i = 0; i < 15; i++)
		bad[i] = STANDSTILL;
	bad[0].gyro_threshold_rad_s = 0;
	bad[1].gyro_threshold_rad_s = -1;
	bad[2].gyro_threshold_rad_s = NAN;
	bad[3].accel_threshold_m_s2 = 0;
	bad[4].accel_threshold_m_s2 = INFINITY;
	bad[5].time_s = -1;
	bad[6].time_s = NAN;
	bad[7].mean_time_s = 0;
	bad[8].deviation_time_s = -1;
	bad[9].deviation_time_s = INFINITY;
	bad[10].deviation_share = 0;
	bad[11].deviation_share = INFINITY;
	bad[12].drift_time_s = 0;
	bad[13].drift_share = 0;
	bad[14].drift_share = NAN;
	for (int i = 0; i < 15; i++)
		assert_int_equal(rest_check(&bad[i]), -EINVAL);
}

/* The first sample is the mean, whatever was before. */
static void test_a_restart_forgets_all_that_was_before(void **state)
{
	struct rest fresh = {.still_s = 0}, again = {.still_s = 0};
	const struct vec3 turning = {0.4 * RAD_PER_DEG, -0.3 * RAD_PER_DEG, 0.2 * RAD_PER_DEG};

	(void)state;
	after(&again, 2, (struct vec3){1, 2, 3}, (struct vec3){4, 5, 6});
	rest_restart(&again);
	for (int k = 0; k < 20; k++) {
		const struct vec3 rate = vec3_add(turning, any_vec(0.01)), force = vec3_add(UP, any_vec(0.01));

		assert_int_equal(step(&fresh, rate, force), step(&again, rate, force));
		if (k == 0)
			assert_vec_near(fresh.gyro_mean, rate, 0);
		assert_vec_near(again.gyro_mean, fresh.gyro_mean, 0);
		assert_vec_near(again.accel_mean, fresh.accel_mean, 0);
		assert_vec_near(again.gyro_slow, fresh.gyro_slow, 0);
		assert_vec_near(again.accel_slow, fresh.accel_slow, 0);
		assert_near(again.gyro_square, fresh.gyro_square, 0);
		assert_near(again.accel_square, fresh.accel_square, 0);
		assert_near(again.still_s, fresh.still_s, 0);
	}
}

/* A sample before which others are missing is one sample: it moves the means by no more than one of twice the usual
 * interval. */
static void test_a_sample_after_missing_ones_has_the_weight_of_two(void **state)
{
	struct rest missing = {.still_s = 0}, twice;
	const struct vec3 pushed = {0.3, 0, 9.81};

	(void)state;
	after(&missing, 3, STILL, UP);
	twice = missing;
	rest_step(&missing, &CONFIG, STILL, pushed, 30 * DT_S);
	rest_step(&twice, &CONFIG, STILL, pushed, 2 * DT_S);
	assert_vec_near(missing.accel_mean, twice.accel_mean, 1e-12);
	assert_near(missing.accel_square, twice.accel_square, 1e-12);
	assert_vec_near(missing.accel_slow, twice.accel_slow, 1e-12);
	assert_true(vec3_norm(vec3_sub(missing.accel_mean, UP)) > 0.001);
	assert_near(missing.still_s - twice.still_s, 28 * DT_S, 1e-9);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_rest_is_seen_after_the_rest_time_and_not_before),
		cmocka_unit_test(test_noise_below_the_thresholds_is_rest),
		cmocka_unit_test(test_one_sample_of_motion_ends_rest_at_once),
		cmocka_unit_test(test_a_sensor_at_rest_is_so_at_any_rate_of_samples),
		cmocka_unit_test(test_a_steady_turn_is_no_standstill_and_as_steady_as_rest),
		cmocka_unit_test(test_a_small_gyro_bias_does_not_hide_rest),
		cmocka_unit_test(test_a_restart_waits_the_rest_time_again),
		cmocka_unit_test(test_a_new_dwell_time_takes_effect_at_once),
		cmocka_unit_test(test_only_the_slow_mean_sees_a_motion_that_begins_gently),
		cmocka_unit_test(test_one_outlier_does_not_end_a_standstill_but_ends_rest),
		cmocka_unit_test(test_a_standstill_is_seen_within_a_second_of_a_violent_motion),
		cmocka_unit_test(test_a_configuration_out_of_range_is_refused),
		cmocka_unit_test(test_a_restart_forgets_all_that_was_before),
		cmocka_unit_test(test_a_sample_after_missing_ones_has_the_weight_of_two),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
