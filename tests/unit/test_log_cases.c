/* The logs of ../shared/cases, each of which was read or estimated wrongly once: what is right of each. Without that
 * folder (IMU9_CASES, or ../shared/cases/logs) they are skipped; test_imu_log_kinds.c, test_stamps.c and test_start.c
 * have logs of these kinds of their own. */
#include "model_test.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "drivers/imu/imu_log.h"
#include "model/pipeline.h"

struct found {
	int rows, outputs, rest;
	double rate_hz, rate_most, accel_most, tilt_sigma_deg, roll_last_deg, tilt_first_deg;
	uint64_t interval_most_us;
	char messages[1024];
};

static struct imu_log log_;

static void replay(const char *name, struct vec3 lever_arm_b_m, struct found *f)
{
	const char *folder = getenv("IMU9_CASES") ? getenv("IMU9_CASES") : "../shared/cases/logs";
	struct pipeline_config config = PIPELINE_DEFAULTS;
	char path[256], error[512], text[256];
	struct pipeline_output out;
	static struct pipeline p;
	struct imu_sample s;
	uint64_t last_us = 0;
	bool valid_before = false;

	snprintf(path, sizeof path, "%s/%s.imu.csv", folder, name);
	if (access(path, R_OK) != 0) {
		print_message("skipped: no %s\n", path);
		skip();
	}
	memset(f, 0, sizeof *f);
	if (imu_log_open(&log_, path, log_format_at(0), error, sizeof error) < 0)
		fail_msg("%s", error);
	f->rate_hz = log_.rate_hz;
	config.estimator.lever_arm_b_m = lever_arm_b_m;
	assert_int_equal(pipeline_init(&p, &config, log_.rate_hz), 0);
	for (; imu_log_next(&log_, &s) == 1; f->rows++) {
		bool valid;

		f->interval_most_us =
			last_us && s.t_us - last_us > f->interval_most_us ? s.t_us - last_us : f->interval_most_us;
		last_us = s.t_us;
		if (pipeline_step(&p, &s, &out) < 0)
			continue;
		valid = out.status & PIPELINE_VALID;
		f->outputs++;
		f->rest += !!(out.status & PIPELINE_REST);
		f->rate_most = valid ? fmax(f->rate_most, vec3_norm(out.rate_b_rad_s)) : f->rate_most;
		f->accel_most = valid ? fmax(f->accel_most, vec3_norm(out.accel_b_m_s2)) : f->accel_most;
		if (valid && !valid_before)
			f->tilt_first_deg = DEG_PER_RAD * acos(quat_rotate(out.q_nb, (struct vec3){0, 0, 1}).z);
		valid_before |= valid;
	}
	imu_log_close(&log_);
	f->tilt_sigma_deg = DEG_PER_RAD * hypot(out.sigma.attitude_rad.x, out.sigma.attitude_rad.y);
	f->roll_last_deg = DEG_PER_RAD * out.angles_rad.x;
	for (int i = 0; imu_log_message(&log_, i, text, sizeof text); i++)
		strncat(f->messages, text, sizeof f->messages - strlen(f->messages) - 1);
}

static void plain(const char *name, struct found *f)
{
	replay(name, (struct vec3){0, 0, 0}, f);
}

static void test_stamps_close_together_give_outputs_bounded_by_what_was_measured(void **state)
{
	const char *const names[] = {"close_stamps_10us", "pairs_500us"};
	struct found f;

	(void)state;
	for (int i = 0; i < 2; i++) { /* the true rate is at most 1.7 rad/s */
		plain(names[i], &f);
		assert_true(f.outputs == f.rows && f.rows >= 400);
		assert_true(f.rate_most > 1 && f.rate_most < 2 && f.accel_most < 10);
	}
}

static void test_of_a_sensor_at_rest_read_in_bursts_the_mean_rate_and_the_rest_are_found(void **state)
{
	struct found f;

	(void)state;
	plain("real_rest_bursty_mpu6050", &f);
	assert_int_equal(f.rows, 1200);
	assert_near(f.rate_hz, 100, 1);
	assert_true(f.interval_most_us < 25000);
	assert_true(f.rest > 800);
	assert_true(f.tilt_sigma_deg > 0.05 && f.tilt_sigma_deg < 2);
	assert_non_null(strstr(f.messages, "bursts"));
}

static void test_a_start_in_a_turn_takes_the_lever_arms_share_off(void **state)
{
	struct found f;

	(void)state;
	replay("start_moving_lever_0.3m", (struct vec3){0.3, 0, 0}, &f);
	assert_near(f.tilt_first_deg, 17, 6); /* it has turned by 17 degrees when the attitude is known */
}

static void test_one_glitch_costs_one_row(void **state)
{
	struct found f;

	(void)state;
	plain("fmt_t_one_glitch_forward", &f);
	assert_int_equal(f.rows, 1999);
	assert_non_null(strstr(f.messages, "1 row skipped: "));
}

static void test_a_time_in_ms_is_converted_and_told(void **state)
{
	struct found f;

	(void)state;
	plain("fmt_t_ms", &f);
	assert_near(f.rate_hz, 100, 0.1);
	assert_true(f.accel_most < 10);
	assert_non_null(strstr(f.messages, "ms"));
}

static void test_logs_of_another_form_lose_no_row(void **state)
{
	const char *const names[] = {"fmt_t_negative_start", "fmt_nan_mag", "fmt_wide600"};
	struct found f;

	(void)state;
	for (int i = 0; i < 3; i++) {
		plain(names[i], &f);
		assert_int_equal(f.rows, 399);
		assert_string_equal(f.messages, "");
	}
}

static void test_wrong_units_are_told(void **state)
{
	struct found f;

	(void)state;
	plain("accel_in_g", &f);
	assert_non_null(strstr(f.messages, "likely in g,"));
	assert_null(strstr(f.messages, "deg/s"));
	plain("gyro_in_deg_s", &f);
	assert_non_null(strstr(f.messages, "likely in deg/s"));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_stamps_close_together_give_outputs_bounded_by_what_was_measured),
		cmocka_unit_test(test_of_a_sensor_at_rest_read_in_bursts_the_mean_rate_and_the_rest_are_found),
		cmocka_unit_test(test_a_start_in_a_turn_takes_the_lever_arms_share_off),
		cmocka_unit_test(test_one_glitch_costs_one_row),
		cmocka_unit_test(test_a_time_in_ms_is_converted_and_told),
		cmocka_unit_test(test_logs_of_another_form_lose_no_row),
		cmocka_unit_test(test_wrong_units_are_told),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
