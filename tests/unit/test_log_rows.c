/* Rows of a log as samples (drivers/imu/log_rows.h): values in SI units, the fields that may be empty, rows that are
 * skipped and what is said of them, and a folder with a file for each chip. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "drivers/imu/log_rows.h"
#include "tests/unit/descriptors.h"

static char folder[] = "/tmp/imu9-log-rows.XXXXXX", error[400];
static struct log_rows rows;
static struct log_row row;

static void put_file(const char *name, const char *text)
{
	char path[100];
	FILE *f;

	snprintf(path, sizeof path, "%s/%s", folder, name);
	f = fopen(path, "w");
	assert_non_null(f);
	fputs(text, f);
	fclose(f);
}

static void take_file(const char *name)
{
	char path[100];

	snprintf(path, sizeof path, "%s/%s", folder, name);
	unlink(path);
}

static void open_log(const char *text)
{
	char path[100];

	put_file("a.csv", text);
	snprintf(path, sizeof path, "%s/a.csv", folder);
	memset(&rows, 0xA5, sizeof rows); /* whatever was there */
	if (log_rows_open(&rows, path, log_format_at(0), error, sizeof error) < 0)
		fail_msg("%s", error);
}

static int make_folder(void **state)
{
	assert_non_null(mkdtemp(folder));
	return count_descriptors(state);
}

static int remove_folder(void **state)
{
	static const char *const names[] = {"a.csv", "Gyroscope.csv", "Accelerometer.csv", "Magnetometer.csv"};

	for (int i = 0; i < 4; i++)
		take_file(names[i]);
	rmdir(folder);
	return no_descriptor_is_left(state);
}

static void assert_vector(struct vec3 v, double x, double y, double z)
{
	if (fabs(v.x - x) > 1e-9 || fabs(v.y - y) > 1e-9 || fabs(v.z - z) > 1e-9)
		fail_msg("%g %g %g, expected %g %g %g", v.x, v.y, v.z, x, y, z);
}

/* ---- one file ---------------------------------------------------------------------------------------------------- */

#define NAMES "t,gx[deg/s],gy,gz,ax[g],ay,az,mx[gauss],my,mz,ref_al,ref_as,ref_at,temperature,clipped\n"

/* pi / 180 rad/s, 9.80665 m/s^2, 100 uT */
static void test_each_value_is_in_its_place_in_si_units(void **state)
{
	const double deg = acos(-1) / 180, g = 9.80665;

	(void)state;
	open_log(NAMES "1.5,1,2,3,4,5,6,.1,.2,.3,7,8,9,25.5,1\n");
	assert_int_equal(log_rows_next(&rows, &row), 1);
	assert_true(row.t == 1.5);
	assert_int_equal(row.line, 2);
	assert_false(row.begins);
	assert_vector(row.sample.gyro_rad_s, deg, 2 * deg, 3 * deg);
	assert_vector(row.sample.accel_m_s2, 4 * g, 5 * g, 6 * g);
	assert_vector(row.sample.mag_uT, 10, 20, 30);
	assert_vector(row.sample.ref_accel_b_m_s2, 7, 8, 9);
	assert_true(row.sample.temperature_degC == 25.5);
	assert_int_equal(row.sample.flags, SAMPLE_MAG | SAMPLE_REFERENCE | SAMPLE_TEMPERATURE | SAMPLE_SATURATED);
	assert_int_equal(log_rows_next(&rows, &row), 0);
	assert_int_equal(rows.events.skipped, 0);
	log_rows_close(&rows);
}

static void test_fields_that_are_empty_give_no_flag(void **state)
{
	static const struct {
		const char *fields;
		unsigned flags;
	} cases[] = {{",,,,,,,", 0}, {"1,2,3,,,,,", SAMPLE_MAG}, {",,,1,2,3,,", SAMPLE_REFERENCE},
		{",,,,,,20,", SAMPLE_TEMPERATURE}, {",,,,,,,1", SAMPLE_SATURATED}, {",,,,,,,0", 0},
		{"nan,NaN,null,,,,none,NA", 0}, {",,,,,,,-1", SAMPLE_SATURATED}};
	char text[400];

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		snprintf(text, sizeof text, NAMES "1,1,2,3,4,5,6,%s\n", cases[i].fields);
		open_log(text);
		assert_int_equal(log_rows_next(&rows, &row), 1);
		assert_int_equal(row.sample.flags, cases[i].flags);
		log_rows_close(&rows);
	}
}

/* A triad is whole or empty; a value that is there must be a number. */
static void test_a_row_without_all_its_numbers_is_skipped_and_its_first_fault_told(void **state)
{
	static const struct {
		const char *row, *words;
	} cases[] = {{"x,1,2,3,4,5,6,,,,,,,,", "a.csv:2: t is not a finite number: 'x'"},
		{"1,,2,3,4,5,6,,,,,,,,", "a.csv:2: gx is not a finite number: ''"},
		{"1,1,y,3,4,5,6,,,,,,,,", "gy is not a finite number: 'y'"},
		{"1,1,2,nan,4,5,6,,,,,,,,", "gz is not a finite number: 'nan'"}, {"1,1,2,3,-,5,6,,,,,,,,", "ax is not"},
		{"1,1,2,3,4,inf,6,,,,,,,,", "ay is not"}, {"1,1,2,3,4,5,0x6,,,,,,,,", "az is not"},
		{"1,1,2,3,4,5,6,1,,3,,,,,", "my is not a finite number: ''"}, {"1,1,2,3,4,5,6,,,3,,,,,", "mx is not"},
		{"1,1,2,3,4,5,6,1,2,,,,,,", "mz is not"}, {"1,1,2,3,4,5,6,,,,1,,3,,", "ref_as is not"},
		{"1,1,2,3,4,5,6,,,,,,,hot,", "temperature is not"},
		{"1,1,2,3,4,5,6,,,,,,,,yes", "clipped is not a finite number: 'yes'"}};
	char text[400];

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		snprintf(text, sizeof text, NAMES "%s\n9,1,2,3,4,5,6,,,,,,,,\n", cases[i].row);
		open_log(text);
		assert_int_equal(log_rows_next(&rows, &row), 1);
		assert_true(row.t == 9);
		assert_int_equal(row.line, 3);
		assert_int_equal(rows.events.skipped, 1);
		assert_int_equal(rows.events.of[LOG_SKIP_NUMBER].count, 1);
		if (!strstr(rows.events.of[LOG_SKIP_NUMBER].first, cases[i].words) ||
			!strstr(rows.events.last_skip, cases[i].words))
			fail_msg("'%s' does not say '%s'", rows.events.last_skip, cases[i].words);
		log_rows_close(&rows);
	}
}

static void test_lines_that_are_no_rows_are_counted_by_their_kind(void **state)
{
	(void)state;
	open_log("t,gx,gy,gz,ax,ay,az\n1,2\n1,1,2,3,4,5,6\n3,4,5\n5,1,2,3,4,5,6\n");
	assert_int_equal(log_rows_next(&rows, &row), 1);
	assert_int_equal(log_rows_next(&rows, &row), 1);
	assert_int_equal(rows.events.of[LOG_SKIP_FIELDS].count, 2);
	assert_string_equal(rows.events.of[LOG_SKIP_FIELDS].first, "a.csv:2: 2 fields, the header has 7");
	assert_string_equal(rows.events.last_skip, "a.csv:4: 3 fields, the header has 7");
	assert_int_equal(rows.events.skipped, 2);
	log_rows_event(&rows, LOG_ANOTHER, 77, "%d of them", 5); /* no skipped row */
	assert_string_equal(rows.events.of[LOG_ANOTHER].first, "a.csv:77: 5 of them");
	assert_int_equal(rows.events.skipped, 2);
	assert_string_equal(rows.events.last_skip, "a.csv:4: 3 fields, the header has 7");
	log_rows_close(&rows);
}

static void test_a_header_in_the_middle_marks_the_row_behind_it(void **state)
{
	(void)state;
	open_log("t,gx,gy,gz,ax,ay,az\n1,1,2,3,4,5,6\nt,gx,gy,gz,ax,ay,az\nx,1,2,3,4,5,6\n1,1,2,3,4,5,6\n2,1,2,3,4,5,"
		 "6\n");
	for (int i = 0; i < 3; i++) {
		assert_int_equal(log_rows_next(&rows, &row), 1);
		assert_int_equal(row.begins, i == 1);
	}
	log_rows_close(&rows);
}

static void test_the_unit_of_the_time_is_known_if_the_header_names_it_or_it_is_a_date(void **state)
{
	static const struct {
		const char *name, *value;
		double unit_s;
	} cases[] = {{"t", "1", 0}, {"t[ms]", "1", 1e-3}, {"t[us]", "1", 1e-6}, {"t[s]", "1", 1},
		{"t", "2026-01-31 12:00:00", 1}};
	char text[100];

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		snprintf(text, sizeof text, "%s,gx,gy,gz,ax,ay,az\n%s,1,2,3,4,5,6\n", cases[i].name, cases[i].value);
		open_log(text);
		assert_int_equal(log_rows_next(&rows, &row), 1);
		assert_true(fabs(rows.time_unit_s - cases[i].unit_s) < 1e-12);
		log_rows_close(&rows);
	}
}

/* ---- a folder ---------------------------------------------------------------------------------------------------- */

static int open_folder(void)
{
	memset(&rows, 0xA5, sizeof rows);
	return log_rows_open(&rows, folder, log_format_named("phyphox"), error, sizeof error);
}

/* The acceleration is interpolated to the time of the gyro, the field is the last one, turned to it; 0.1 ms apart is at
 * once. */
static void test_the_files_of_a_folder_are_merged_by_their_times(void **state)
{
	(void)state;
	put_file("Gyroscope.csv", "\"Time (s)\",\"X (rad/s)\",\"Y (rad/s)\",\"Z (rad/s)\"\n"
				  "-0.005,9,9,9\n0.0,1,2,3\n0.0105,0,0,0\n0.0201,4,5,6\n");
	put_file("Accelerometer.csv", "\"Time (s)\",\"X (m/s^2)\",\"Y (m/s^2)\",\"Z (m/s^2)\"\n"
				      "0.0,0,0,10\n0.01,1,2,20\n0.02,3,6,30\n0.03,0,0,0\n");
	put_file("Magnetometer.csv",
		"\"Time (s)\",\"X (uT)\",\"Y (uT)\",\"Z (uT)\"\n0.0,20,0,-40\n0.01,,,\n0.02,30,0,-40\n");
	assert_int_equal(open_folder(), 0);
	assert_true(rows.time_unit_s == 1);
	assert_int_equal(log_rows_next(&rows, &row), 1); /* the gyro alone, before, is lost */
	assert_true(fabs(row.t) < 1e-6);
	assert_int_equal(row.sample.t_us, 0);
	assert_vector(row.sample.gyro_rad_s, 1, 2, 3);
	assert_vector(row.sample.accel_m_s2, 0, 0, 10);
	assert_int_equal(row.sample.flags, 0);
	assert_int_equal(log_rows_next(&rows, &row), 1);
	assert_true(fabs(row.t - 0.0105) < 1e-6);
	assert_vector(row.sample.accel_m_s2, 1.1, 2.2, 20.5);
	assert_vector(row.sample.mag_uT, 20, 0, -40); /* the row behind it is empty */
	assert_int_equal(row.sample.flags, SAMPLE_MAG);
	assert_int_equal(log_rows_next(&rows, &row), 1);
	assert_vector(row.sample.accel_m_s2, 3, 6, 30);
	/* 0.1 ms old: v + v x omega dt */
	assert_vector(row.sample.mag_uT, 30 + 200e-4, -340e-4, -40 + 150e-4);
	assert_int_equal(row.sample.flags, SAMPLE_MAG);
	assert_int_equal(log_rows_next(&rows, &row), 0);
	log_rows_close(&rows);
}

static void test_a_folder_needs_gyro_and_accelerometer(void **state)
{
	(void)state;
	take_file("Magnetometer.csv");
	assert_int_equal(open_folder(), 0);
	assert_int_equal(log_rows_next(&rows, &row), 1);
	assert_int_equal(row.sample.flags, 0);
	log_rows_close(&rows);
	put_file("Magnetometer.csv", "no header\n");
	assert_int_equal(open_folder(), -EINVAL);
	assert_non_null(strstr(error, "Magnetometer.csv:1:"));
	take_file("Magnetometer.csv");
	take_file("Accelerometer.csv");
	assert_int_equal(open_folder(), -ENOENT);
	assert_non_null(strstr(error, "Accelerometer.csv: No such file or directory"));
	take_file("Gyroscope.csv");
	assert_int_equal(open_folder(), -ENOENT);
	assert_non_null(strstr(error, "Gyroscope.csv"));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_each_value_is_in_its_place_in_si_units),
		cmocka_unit_test(test_fields_that_are_empty_give_no_flag),
		cmocka_unit_test(test_a_row_without_all_its_numbers_is_skipped_and_its_first_fault_told),
		cmocka_unit_test(test_lines_that_are_no_rows_are_counted_by_their_kind),
		cmocka_unit_test(test_a_header_in_the_middle_marks_the_row_behind_it),
		cmocka_unit_test(test_the_unit_of_the_time_is_known_if_the_header_names_it_or_it_is_a_date),
		cmocka_unit_test(test_the_files_of_a_folder_are_merged_by_their_times),
		cmocka_unit_test(test_a_folder_needs_gyro_and_accelerometer),
	};

	return cmocka_run_group_tests_name("log_rows", tests, make_folder, remove_folder);
}
