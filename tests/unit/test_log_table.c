/* The text of a log (drivers/imu/log_table.h): separators, quotes, blanks, comments, headers, numbers and times. A
 * table is written to a file and read again; the oracle is what was written. Days are those of `date -d DATE +%s`. */
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
#include <unistd.h>

#include "drivers/imu/log_table.h"
#include "tests/unit/descriptors.h"

enum { NEEDED = LOG_NEEDS_GYRO | LOG_NEEDS_ACCEL };

static char path[] = "/tmp/imu9-log-table.XXXXXX", error[400], why[200];
static struct log_table table;

static int open_bytes(const char *bytes, size_t size)
{
	FILE *f = fopen(path, "w");

	assert_non_null(f);
	assert_int_equal(fwrite(bytes, 1, size, f), size);
	fclose(f);
	error[0] = why[0] = '\0';
	return log_table_open(&table, path, log_format_at(0), NEEDED, error, sizeof error);
}

static void open_text(const char *text)
{
	if (open_bytes(text, strlen(text)) < 0)
		fail_msg("'%s': %s", text, error);
}

static void assert_refused(const char *text, const char *words)
{
	assert_int_equal(open_bytes(text, strlen(text)), -EINVAL);
	if (!strstr(error, words))
		fail_msg("'%s' does not say '%s'", error, words);
	assert_null(table.file);
}

static void assert_next(int kind)
{
	assert_int_equal(log_table_next(&table, why, sizeof why), kind);
}

static int make_file(void **state)
{
	int fd = mkstemp(path);

	close(fd);
	return count_descriptors(state);
}

static int remove_file(void **state)
{
	unlink(path);
	return no_descriptor_is_left(state);
}

/* ---- fields ------------------------------------------------------------------------------------------------------ */

static void test_numbers_are_decimal_with_point_or_comma(void **state)
{
	static const struct {
		const char *text;
		double value;
	} numbers[] = {{"0", 0}, {"-1.5", -1.5}, {"+2", 2}, {".5", 0.5}, {"1e3", 1000}, {"1E-2", 0.01}, {"1,25", 1.25},
		{"-0,5e1", -5}, {"12345678901234567890", 12345678901234567890.0}};
	static const char *const none[] = {
		"", "nan", "inf", "0x10", "1 ", " 1", "1.2.3", "1,2,3", "1,2.3", "e5", "1e999", "-", "--1", "1a"};
	char text[80];
	double value;

	(void)state;
	for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
		assert_int_equal(log_table_number(numbers[i].text, &value), 0);
		assert_true(value == numbers[i].value);
	}
	for (size_t i = 0; i < sizeof none / sizeof *none; i++)
		if (log_table_number(none[i], &value) != -EINVAL)
			fail_msg("'%s' is taken as %g", none[i], value);
	/* with a comma up to 63 characters */
	for (int length = 63; length <= 64; length++) {
		snprintf(text, sizeof text, "0,%0*d", length - 2, 5);
		assert_int_equal(strlen(text), length);
		assert_int_equal(log_table_number(text, &value), length == 63 ? 0 : -EINVAL);
	}
}

static void test_words_for_no_value(void **state)
{
	static const char *const words[] = {
		"", "nan", "NaN", "-nan", "+NAN", "na", "N/A", "<NA>", "null", "NULL", "None", "NaT"};
	static const char *const values[] = {"0", "n", "nano", "-", "no", " "};

	(void)state;
	for (size_t i = 0; i < sizeof words / sizeof *words; i++)
		assert_true(log_table_absent(words[i]));
	for (size_t i = 0; i < sizeof values / sizeof *values; i++)
		assert_false(log_table_absent(values[i]));
}

static void test_times_are_numbers_dates_and_durations(void **state)
{
	static const struct {
		const char *text;
		double s;
	} times[] = {{"1970-01-01 00:00:00", 0}, {"1970-01-02T00:00:00", 86400}, {"2000-02-29 12:00:00.5", 951825600.5},
		{"2000-03-01 00:00:00", 951868800}, {"1999-12-31 23:59:59.25", 946684799.25},
		{"2024-02-29 00:00:01", 1709164801}, {"2024-12-31 00:00:00", 1735603200},
		{"2100-02-28 00:00:00", 4107456000}, {"2100-03-01 00:00:00", 4107542400}, {"1969-12-31 23:59:59", -1},
		{"2026-01-31 12:34:56.789", 1769862896.789}, {"0 days 00:00:00.01", 0.01},
		{"3 days 01:02:03.5", 3 * 86400 + 3723.5}};
	static const char *const none[] = {"", "noon", "2026-01-31", "2026-01-31 12:00", "12:00:00",
		"2026/01/31 12:00:00", "3 days", "2026-01-31x12:00:00"};
	double value;

	(void)state;
	assert_int_equal(log_table_time("12.5", &value), LOG_TIME_NUMBER);
	assert_true(value == 12.5);
	for (size_t i = 0; i < sizeof times / sizeof *times; i++) {
		assert_int_equal(log_table_time(times[i].text, &value), LOG_TIME_CALENDAR);
		if (fabs(value - times[i].s) > 1e-6)
			fail_msg("%s: %.3f", times[i].text, value);
	}
	for (size_t i = 0; i < sizeof none / sizeof *none; i++)
		if (log_table_time(none[i], &value) != -EINVAL)
			fail_msg("'%s' is taken as %g", none[i], value);
}

/* ---- rows -------------------------------------------------------------------------------------------------------- */

static void assert_row(const char *t, const char *gx, const char *az)
{
	assert_next(LOG_LINE_ROW);
	assert_string_equal(table.field[LOG_T], t);
	assert_string_equal(table.field[LOG_GYRO], gx);
	assert_string_equal(table.field[LOG_ACCEL + 2], az);
	assert_null(table.field[LOG_MAG]);
}

static void test_the_separator_is_the_one_that_the_header_has_most_of(void **state)
{
	static const char separators[] = ",;\t";
	char text[200];

	(void)state;
	for (int i = 0; i < 3; i++) {
		const char c = separators[i];

		snprintf(text, sizeof text, "t%cgx%cgy%cgz%cax%cay%caz\n1%c2%c3%c4%c5%c6%c7\n", c, c, c, c, c, c, c, c,
			c, c, c, c);
		open_text(text);
		assert_int_equal(table.header.separator, c);
		assert_int_equal(table.header.fields, 7);
		assert_row("1", "2", "7");
		assert_next(LOG_LINE_END);
		log_table_close(&table);
	}
	open_text("t;gx;gy;gz;ax;ay;az;note, with, commas\n1,5;2;3;4;5;6;7;a, b\n");
	assert_row("1,5", "2", "7");
	log_table_close(&table);
}

static void test_fields_are_without_blanks_and_quotes(void **state)
{
	(void)state;
	open_text(" \"t\" ,'gx', gy,gz\t,ax,ay,\"az\"\n  1 , \"2\" ,3,4,5,6,' 7 "
		  "'\n\"1,5\",\"a;b\",3,4,5,6,7\r\n8,9,3,4,5,6,\n");
	assert_row("1", "2", " 7");
	assert_row("1,5", "a;b", "7");
	assert_row("8", "9", "");
	assert_next(LOG_LINE_END);
	log_table_close(&table);
	open_text("t\tgx\tgy\tgz\tax\tay\taz\n 1\t\t 2 \t3\t4\t5\t6\n"); /* a tab is no blank where it separates */
	assert_row("1", "", "6");
	log_table_close(&table);
}

static void test_a_row_with_another_number_of_fields_is_told_with_both_numbers(void **state)
{
	(void)state;
	open_text("t,gx,gy,gz,ax,ay,az\n1,2,3,4,5,6\n1,2,3,4,5,6,7,8\n1,2,3,4,5,6,7\n");
	assert_next(LOG_LINE_COUNT);
	assert_string_equal(why, "6 fields, the header has 7");
	assert_int_equal(table.line, 2);
	assert_next(LOG_LINE_COUNT);
	assert_string_equal(why, "8 fields, the header has 7");
	assert_row("1", "2", "7");
	assert_int_equal(table.line, 4);
	log_table_close(&table);
}

static void test_a_line_that_is_no_text_is_told(void **state)
{
	static const char nul[] = "t,gx,gy,gz,ax,ay,az\n1,2\0,3,4,5,6,7\n1,2,3,4,5,6,7";
	char *text = malloc(3 * LOG_LINE_MAX);
	int n;

	(void)state;
	assert_int_equal(open_bytes(nul, sizeof nul - 1), 0);
	assert_next(LOG_LINE_BAD);
	assert_string_equal(why, "a NUL byte");
	assert_row("1", "2", "7"); /* without an end */
	assert_next(LOG_LINE_END);
	log_table_close(&table);
	for (int length = LOG_LINE_MAX - 1; length <= LOG_LINE_MAX; length++) {
		n = sprintf(text, "t,gx,gy,gz,ax,ay,az\n1,2,3,4,5,6,");
		memset(text + n, '7', (size_t)length);
		strcpy(text + 20 + length, "\n8,2,3,4,5,6,7\n");
		open_text(text);
		assert_next(length < LOG_LINE_MAX ? LOG_LINE_ROW : LOG_LINE_BAD);
		if (length == LOG_LINE_MAX)
			assert_string_equal(why, "the line is too long");
		assert_row("8", "2", "7");
		log_table_close(&table);
	}
	free(text);
}

static void test_comments_are_skipped_and_a_header_in_the_middle_is_another_log(void **state)
{
	(void)state;
	open_text("# a note\n\n% t\nt,gx,gy,gz,ax,ay,az\n# between\n1,2,3,4,5,6,7\n \"# "
		  "quoted\"\nt,gz,gy,gx,ax,ay,az\n1,2,3,4,5,6,"
		  "7\n");
	assert_int_equal(table.line, 4);
	assert_row("1", "2", "7");
	assert_next(LOG_LINE_HEADER);
	assert_row("1", "4", "7"); /* gx is the fourth now */
	assert_next(LOG_LINE_END);
	log_table_close(&table);
}

/* ---- the header -------------------------------------------------------------------------------------------------- */

static void test_the_header_may_be_a_comment_and_begin_with_a_byte_order_mark(void **state)
{
	static const char *const headers[] = {"# t,gx,gy,gz,ax,ay,az", "#t,gx,gy,gz,ax,ay,az", "% t,gx,gy,gz,ax,ay,az",
		"\xef\xbb\xbft,gx,gy,gz,ax,ay,az", "\xef\xbb\xbf# t,gx,gy,gz,ax,ay,az", " \tt,gx,gy,gz,ax,ay,az",
		" \t# t,gx,gy,gz,ax,ay,az", "T,GX,GY,GZ,AX,AY,AZ"};
	char text[200];

	(void)state;
	for (size_t i = 0; i < sizeof headers / sizeof *headers; i++) {
		snprintf(text, sizeof text, "%s\n1,2,3,4,5,6,7\n%s\n8,2,3,4,5,6,7\n", headers[i], headers[i]);
		open_text(text);
		assert_row("1", "2", "7");
		assert_next(LOG_LINE_HEADER);
		assert_row("8", "2", "7");
		log_table_close(&table);
	}
}

static void test_a_header_that_is_not_one_is_refused_with_what_it_lacks(void **state)
{
	(void)state;
	assert_refused("t,gx,gy,ax,ay,az\n", ":1: no column gz: the header must name t,gx,gy,gz");
	assert_refused("gx,gy,gz,ax,ay,az\n", "no column t");
	assert_refused("t,gx,gy,gz,ax,ay,az,mx,mz\n", "no column my");
	assert_refused("t,gx,gy,gz,ax,ay,az,ref_as\n", "no column ref_al");
	assert_refused("t,gx,gy,gz,ay,az\n", "no column ax");
	assert_refused("t,gx,gy,gz,ax,ay,az,gx\n", "the header has column gx twice");
	assert_refused("t,gx[furlong],gy,gz,ax,ay,az\n", "unknown unit of 'gx[furlong]'");
	assert_refused("# only\n\n# comments\n", ":3: the file is empty");
	assert_refused("", ":1: the file is empty");
	assert_int_equal(open_bytes("a\0b\n", 4), -EINVAL);
	assert_non_null(strstr(error, ":1: a NUL byte"));
	assert_int_equal(
		log_table_open(&table, "/no/such/file", log_format_at(0), NEEDED, error, sizeof error), -ENOENT);
	assert_string_equal(error, "/no/such/file: No such file or directory");
	assert_int_equal(log_table_open(&table, "/tmp", log_format_at(0), NEEDED, error, sizeof error), -EIO);
}

/* A disk that fails behind these bytes. */
static ssize_t read_then_fail(void *cookie, char *bytes, size_t size)
{
	const char **left = cookie;
	size_t n = strlen(*left);

	(void)size;
	errno = EIO;
	memcpy(bytes, *left, n);
	*left += n;
	return n ? (ssize_t)n : -1;
}

static void test_a_disk_that_fails_is_told_wherever_it_does(void **state)
{
	static const char *const BEFORE[] = {
		"", "1", "1,2,3,4,5,6,7", "1,2,3,4,5,6,7\r", "1,2,3,4,5,6,7\n", "# a comment"};

	(void)state;
	for (size_t i = 0; i < sizeof BEFORE / sizeof *BEFORE; i++) {
		const char *left = BEFORE[i];

		open_text("t,gx,gy,gz,ax,ay,az\n");
		fclose(table.file);
		table.file = fopencookie(&left, "r", (cookie_io_functions_t){.read = read_then_fail});
		assert_non_null(table.file);
		if (strcmp(BEFORE[i], "1,2,3,4,5,6,7\n") == 0)
			assert_next(LOG_LINE_ROW);
		assert_next(-EIO);
		log_table_close(&table);
	}
}

static void test_what_is_not_needed_may_be_missing(void **state)
{
	static const char text[] = "t,mx,my,mz\n1,2,3,4\n";

	(void)state;
	assert_int_equal(open_bytes(text, strlen(text)), -EINVAL);
	assert_int_equal(log_table_open(&table, path, log_format_at(0), LOG_NEEDS_MAG, error, sizeof error), 0);
	assert_next(LOG_LINE_ROW);
	assert_string_equal(table.field[LOG_MAG + 2], "4");
	assert_null(table.field[LOG_GYRO]);
	log_table_close(&table);
	assert_int_equal(log_table_open(&table, path, log_format_at(0), 0, error, sizeof error), 0);
	log_table_close(&table);
}

/* The name of an IMU log wins over another one of the same column, wherever it is. */
static void test_of_two_names_of_a_column_that_of_an_imu_log_counts(void **state)
{
	(void)state;
	open_text("timestamp,t,gx,gy,gz,ax,ay,az\n100,1,2,3,4,5,6,7\n");
	assert_row("1", "2", "7");
	log_table_close(&table);
	open_text("t,timestamp,gx,gy,gz,ax,ay,az\n1,100,2,3,4,5,6,7\n");
	assert_row("1", "2", "7");
	log_table_close(&table);
}

/* deg/s are pi / 180 rad/s, mg 9.80665e-3 m/s^2. */
static void test_the_unit_of_one_axis_is_that_of_its_triad(void **state)
{
	static const char *const gyros[] = {"gx[deg/s],gy,gz", "gx,gy[deg/s],gz", "gx,gy,gz[deg/s]"};
	char text[100];

	(void)state;
	for (int i = 0; i < 3; i++) {
		snprintf(text, sizeof text, "t,%s,ax,ay,az[mg]\n", gyros[i]);
		open_text(text);
		for (int axis = 0; axis < 3; axis++) {
			assert_true(fabs(table.header.scale[LOG_GYRO + axis] - acos(-1) / 180) < 1e-12);
			assert_true(fabs(table.header.scale[LOG_ACCEL + axis] - 9.80665e-3) < 1e-12);
		}
		log_table_close(&table);
	}
	open_text("t,gx[deg/s],gy[rad/s],gz,ax,ay,az\n");
	assert_true(table.header.scale[LOG_GYRO + 1] == 1);
	log_table_close(&table);
}

static void test_a_comment_names_the_sensors_that_nobody_calibrated(void **state)
{
	static const struct {
		const char *comment;
		unsigned bits;
	} comments[] = {{"# uncalibrated: gyro accelerometer magnetometer", 7}, {"# uncalibrated: gyro", 1},
		{"#uncalibrated: accelerometer", 2}, {"% Uncalibrated: Magnetometer", 4}, {"# calibrated: gyro", 0},
		{"# uncalibrated gyro", 0}, {"# gyro", 0}, {"# uncalibrated:", 0}};
	char text[200];

	(void)state;
	for (size_t i = 0; i < sizeof comments / sizeof *comments; i++) {
		snprintf(text, sizeof text, "%s\n# more\nt,gx,gy,gz,ax,ay,az\n", comments[i].comment);
		open_text(text);
		assert_int_equal(table.uncalibrated, comments[i].bits);
		log_table_close(&table);
	}
	open_text("# uncalibrated: gyro\n# uncalibrated: magnetometer\nt,gx,gy,gz,ax,ay,az\n");
	assert_int_equal(table.uncalibrated, 5);
	log_table_close(&table);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_numbers_are_decimal_with_point_or_comma),
		cmocka_unit_test(test_words_for_no_value),
		cmocka_unit_test(test_times_are_numbers_dates_and_durations),
		cmocka_unit_test(test_the_separator_is_the_one_that_the_header_has_most_of),
		cmocka_unit_test(test_fields_are_without_blanks_and_quotes),
		cmocka_unit_test(test_a_row_with_another_number_of_fields_is_told_with_both_numbers),
		cmocka_unit_test(test_a_line_that_is_no_text_is_told),
		cmocka_unit_test(test_comments_are_skipped_and_a_header_in_the_middle_is_another_log),
		cmocka_unit_test(test_the_header_may_be_a_comment_and_begin_with_a_byte_order_mark),
		cmocka_unit_test(test_a_header_that_is_not_one_is_refused_with_what_it_lacks),
		cmocka_unit_test(test_a_disk_that_fails_is_told_wherever_it_does),
		cmocka_unit_test(test_what_is_not_needed_may_be_missing),
		cmocka_unit_test(test_of_two_names_of_a_column_that_of_an_imu_log_counts),
		cmocka_unit_test(test_the_unit_of_one_axis_is_that_of_its_triad),
		cmocka_unit_test(test_a_comment_names_the_sensors_that_nobody_calibrated),
	};

	return cmocka_run_group_tests_name("log_table", tests, make_file, remove_file);
}
