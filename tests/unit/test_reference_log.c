/* Reference logs: rows, gaps, and errors with their line. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "tests/unit/model_test.h"
#include "tools/lib/reference_log.h"
#include "tests/unit/descriptors.h"

#define HEADER "t,qw,qx,qy,qz,arx,ary,arz\n"

static int load(struct reference_log *log, const char *text, char error[256])
{
	char path[] = "/tmp/imu9_ref_XXXXXX";
	int fd = mkstemp(path), result;

	assert_true(fd >= 0);
	assert_int_equal(write(fd, text, strlen(text)), strlen(text));
	close(fd);
	*log = (struct reference_log){0};
	result = reference_log_load(log, path, error, 256);
	unlink(path);
	return result;
}

static void assert_refused(const char *text, const char *words)
{
	struct reference_log log;
	char error[256] = "";

	assert_int_equal(load(&log, text, error), -EINVAL);
	if (!strstr(error, words))
		fail_msg("'%s' does not contain '%s'", error, words);
	reference_log_close(&log);
}

static void test_an_acceleration_is_rotated_into_sensor_axes(void **state)
{
	/* the x axis of the sensor points north, its y axis west */
	const char text[] = "t,px,qw,qx,qy,qz,arx,ary,arz\n0,9,0.70710678,0,0,0.70710678,0,5,1\n"
			    "0.01,9,0.70710678,0,0,0.70710678,0,5,1\n";
	struct reference_log log;
	char error[256];
	struct vec3 a;

	(void)state;
	assert_int_equal(load(&log, text, error), 0);
	assert_true(reference_log_at(&log, 5000, &a));
	assert_vec_near(a, ((struct vec3){5, 0, 1}), 1e-7);
	reference_log_close(&log);
}

static void test_values_between_rows_are_interpolated_in_any_order_of_times(void **state)
{
	struct reference_log log;
	char error[256];
	struct vec3 a;

	(void)state;
	assert_int_equal(load(&log, HEADER "1,1,0,0,0,0,0,0\n1.01,1,0,0,0,1,2,3\n1.02,1,0,0,0,0,0,0\n", error), 0);
	assert_true(reference_log_at(&log, 1015000, &a));
	assert_vec_near(a, ((struct vec3){0.5, 1, 1.5}), 1e-9);
	assert_true(reference_log_at(&log, 1002500, &a));
	assert_vec_near(a, ((struct vec3){0.25, 0.5, 0.75}), 1e-9);
	assert_false(reference_log_at(&log, 999999, &a));
	assert_false(reference_log_at(&log, 1020001, &a));
	reference_log_close(&log);
}

static void test_a_gap_of_more_than_50_ms_has_no_value(void **state)
{
	struct reference_log log;
	char error[256];
	struct vec3 a;

	(void)state;
	assert_int_equal(load(&log,
				 HEADER "0,1,0,0,0,1,1,1\n0.04,1,0,0,0,1,1,1\n0.05,,,,,,,\n0.06,1,0,0,0,,,\n"
					"0.1,1,0,0,0,1,1,1\n0.11,1,0,0,0,1,1,1\n",
				 error),
		0);
	assert_true(reference_log_at(&log, 20000, &a));
	assert_false(reference_log_at(&log, 50000, &a));
	assert_false(reference_log_at(&log, 70000, &a));
	assert_true(reference_log_at(&log, 105000, &a));
	reference_log_close(&log);
}

static void test_an_error_is_reported_with_its_line(void **state)
{
	(void)state;
	assert_refused("", ":1: empty");
	assert_refused("t,qw,qx,qy,qz,arx,ary\n", ":1: no column arz");
	assert_refused(HEADER "0,1,0,0,0,1,1\n", ":2:");
	assert_refused(HEADER "0,1,0,0,0,1,1,1\n1,1,0,0,0,x,1,1\n", ":3:");
	assert_refused(HEADER "0,1,0,0,0,1,1,1\n0,1,0,0,0,1,1,1\n", ":3:");
	assert_refused(HEADER "0,0,0,0,0,1,1,1\n", ":2:");
	assert_refused(HEADER "0,1,0,0,0,nan,1,1\n", ":2:");
	assert_refused(HEADER ",,,,,,,\n", "no row");
}

static void test_a_missing_file_is_reported(void **state)
{
	struct reference_log log = {0};
	char error[256] = "";

	(void)state;
	assert_int_equal(reference_log_load(&log, "/nowhere/x.ref.csv", error, sizeof error), -ENOENT);
	assert_non_null(strstr(error, "/nowhere/x.ref.csv: No such file"));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_an_acceleration_is_rotated_into_sensor_axes),
		cmocka_unit_test(test_values_between_rows_are_interpolated_in_any_order_of_times),
		cmocka_unit_test(test_a_gap_of_more_than_50_ms_has_no_value),
		cmocka_unit_test(test_an_error_is_reported_with_its_line),
		cmocka_unit_test(test_a_missing_file_is_reported),
	};

	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}
