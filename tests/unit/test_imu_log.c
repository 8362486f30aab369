#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

#include "drivers/imu/imu_log.h"
#include "tests/unit/descriptors.h"

#define HEADER "t,gx,gy,gz,ax,ay,az,mx,my,mz\n"
#define ROW(t) t ",1,2,3,4,5,6,7,8,9\n"

static char path[64];

/* The file "/failing": this text, and then the disk fails. */
static const char *failing;

static ssize_t read_then_fail(void *cookie, char *bytes, size_t size)
{
	size_t left = strlen(failing), n = left < size ? left : size;

	(void)cookie;
	errno = EIO;
	memcpy(bytes, failing, n);
	failing += n;
	return n ? (ssize_t)n : -1;
}

FILE *fopen(const char *restrict name, const char *restrict mode)
{
	FILE *(*real)(const char *, const char *);

	*(void **)&real = dlsym(RTLD_NEXT, "fopen");
	return strcmp(name, "/failing") == 0 ? fopencookie(NULL, mode, (cookie_io_functions_t){.read = read_then_fail})
					     : real(name, mode);
}

static void write_file(const void *text, size_t size)
{
	int fd;

	strcpy(path, "/tmp/imu9_log_XXXXXX");
	fd = mkstemp(path);
	assert_true(fd >= 0);
	assert_int_equal(write(fd, text, size), size);
	close(fd);
}

static struct imu_log opened(const void *text, size_t size)
{
	struct imu_log log;
	char error[256];

	write_file(text, size);
	memset(&log, 0x5A, sizeof log); /* whatever was there */
	if (imu_log_open(&log, path, log_format_at(0), error, sizeof error) != 0)
		fail_msg("%s", error);
	unlink(path);
	return log;
}

static void assert_refused(const char *text, int result, const char *word)
{
	struct imu_log log;
	char error[256] = "";

	write_file(text, strlen(text));
	assert_int_equal(imu_log_open(&log, path, log_format_at(0), error, sizeof error), result);
	unlink(path);
	if (!strstr(error, word))
		fail_msg("'%s' does not say '%s'", error, word);
}

/* Reads all rows. Returns the number of valid ones. */
static int count(struct imu_log *log)
{
	struct imu_sample sample;
	int n = 0, got;

	while ((got = imu_log_next(log, &sample)) == 1)
		n++;
	assert_int_equal(got, 0);
	imu_log_close(log);
	return n;
}

/* A bad row between two valid ones is skipped, and last_skip contains its line and `word`. */
static void assert_skipped(const char *row, const char *word)
{
	static char text[LOG_LINE_MAX + 400];
	struct imu_log log;
	int size = snprintf(text, sizeof text, HEADER ROW("0.00") "%s\n" ROW("0.02"), row);

	log = opened(text, (size_t)size);
	assert_int_equal(count(&log), 2);
	assert_int_equal(log.rows.events.skipped, 1);
	if (!strstr(log.rows.events.last_skip, ":3: ") || !strstr(log.rows.events.last_skip, word))
		fail_msg("'%s' does not say ':3:' and '%s'", log.rows.events.last_skip, word);
}

static void test_a_row_becomes_a_sample_in_si_units(void **state)
{
	const char text[] = HEADER "0.5,0.1,-0.2,3e-1,4,5,+9.81,7,8,-45.25\n" ROW("0.51");
	struct imu_log log = opened(text, strlen(text));
	struct imu_sample s;

	(void)state;
	assert_int_equal(imu_log_next(&log, &s), 1);
	imu_log_close(&log);
	assert_int_equal(s.t_us, 500000);
	assert_true(s.gyro_rad_s.x == 0.1 && s.gyro_rad_s.y == -0.2 && s.gyro_rad_s.z == 0.3);
	assert_true(s.accel_m_s2.x == 4 && s.accel_m_s2.y == 5 && s.accel_m_s2.z == 9.81);
	assert_true(s.mag_uT.x == 7 && s.mag_uT.y == 8 && s.mag_uT.z == -45.25);
	assert_int_equal(s.flags, SAMPLE_MAG);
}

static void test_a_log_names_the_sensors_that_nobody_calibrated_before_its_header(void **state)
{
	static const struct {
		const char *head;
		unsigned uncalibrated;
	} logs[] = {{"", 0}, {"# a board\n", 0}, {"# uncalibrated: gyro accelerometer magnetometer\n", 7},
		{"# a board\n#Uncalibrated: Magnetometer\n", 4}, {"# uncalibrated: none\n", 0}};

	(void)state;
	for (size_t i = 0; i < sizeof logs / sizeof *logs; i++) {
		char text[200];
		int size = snprintf(text, sizeof text, "%s" HEADER ROW("0") ROW("0.01"), logs[i].head);
		struct imu_log log = opened(text, (size_t)size);

		assert_int_equal(imu_log_uncalibrated(&log), logs[i].uncalibrated);
		assert_int_equal(count(&log), 2);
	}
}

static void test_empty_magnetometer_fields_mean_no_measurement(void **state)
{
	const char text[] = HEADER "0,1,2,3,4,5,6,,,\n" ROW("0.01");
	struct imu_log log = opened(text, strlen(text));
	struct imu_sample s;

	(void)state;
	assert_int_equal(imu_log_next(&log, &s), 1);
	assert_int_equal(s.flags, 0);
	assert_int_equal(imu_log_next(&log, &s), 1);
	assert_int_equal(s.flags, SAMPLE_MAG);
	imu_log_close(&log);
}

static void test_temperature_and_reference_acceleration_are_read_where_the_row_has_them(void **state)
{
	const char text[] = "t,gx,gy,gz,ax,ay,az,temperature,ref_al,ref_as,ref_at\n"
			    "0,1,2,3,4,5,6,21.5,0.1,-0.2,0.3\n0.01,1,2,3,4,5,6,,,,\n";
	struct imu_log log = opened(text, strlen(text));
	struct imu_sample s;

	(void)state;
	assert_int_equal(imu_log_next(&log, &s), 1);
	assert_int_equal(s.flags, SAMPLE_TEMPERATURE | SAMPLE_REFERENCE);
	assert_true(s.temperature_degC == 21.5);
	assert_true(s.ref_accel_b_m_s2.x == 0.1 && s.ref_accel_b_m_s2.y == -0.2 && s.ref_accel_b_m_s2.z == 0.3);
	assert_int_equal(imu_log_next(&log, &s), 1);
	assert_int_equal(s.flags, 0);
	imu_log_close(&log);
}

static void test_a_row_with_half_a_reference_or_a_broken_temperature_is_skipped(void **state)
{
	const char text[] = "t,gx,gy,gz,ax,ay,az,temperature,ref_al,ref_as,ref_at\n0,1,2,3,4,5,6,,,,\n"
			    "0.01,1,2,3,4,5,6,,1,,3\n0.02,1,2,3,4,5,6,warm,1,2,3\n0.03,1,2,3,4,5,6,20,1,2,3\n";
	struct imu_log log = opened(text, strlen(text));

	(void)state;
	assert_int_equal(count(&log), 2);
	assert_int_equal(log.rows.events.skipped, 2);
}

static void test_a_header_with_half_a_reference_is_refused(void **state)
{
	(void)state;
	assert_refused("t,gx,gy,gz,ax,ay,az,ref_al,ref_at\n", -EINVAL, "ref_as");
}

static void test_the_header_may_leave_the_magnetometer_out(void **state)
{
	const char text[] = "t,gx,gy,gz,ax,ay,az\n0,1,2,3,4,5,6\n1,1,2,3,4,5,6\n";
	struct imu_log log = opened(text, strlen(text));
	struct imu_sample s;

	(void)state;
	assert_int_equal(imu_log_next(&log, &s), 1);
	assert_int_equal(s.flags, 0);
	imu_log_close(&log);
}

static void test_the_header_names_the_order_and_other_columns_are_ignored(void **state)
{
	const char text[] = "temperature,az,ay,ax,gz,gy,gx,t,note\n21.5,6,5,4,3,2,1,0,hello\n,6,5,4,3,2,1,1,\n";
	struct imu_log log = opened(text, strlen(text));
	struct imu_sample s;

	(void)state;
	assert_int_equal(imu_log_next(&log, &s), 1);
	assert_true(s.gyro_rad_s.x == 1 && s.gyro_rad_s.z == 3 && s.accel_m_s2.x == 4 && s.accel_m_s2.z == 6);
	assert_int_equal(count(&log), 1);
	assert_int_equal(log.rows.events.skipped, 0);
}

static void test_windows_line_ends_blanks_and_a_byte_order_mark_are_accepted(void **state)
{
	const char text[] = "\xef\xbb\xbft, gx, gy, gz, ax, ay, az\r\n 0 ,1,2,3,4,5, 6\r\n1,1,2,3,4,5,6\r\n";
	struct imu_log log = opened(text, strlen(text));

	(void)state;
	assert_int_equal(count(&log), 2);
	assert_int_equal(log.rows.events.skipped, 0);
}

static void test_the_last_line_needs_no_newline(void **state)
{
	const char text[] = HEADER ROW("0") "1,1,2,3,4,5,6,7,8,9";
	struct imu_log log = opened(text, strlen(text));

	(void)state;
	assert_int_equal(count(&log), 2);
}

static void test_a_row_with_too_few_or_too_many_fields_is_skipped(void **state)
{
	(void)state;
	assert_skipped("0.01,1,2,3,4,5", "6 fields, the header has 10");
	assert_skipped("0.01,1,2,3,4,5,6,7,8,9,10", "11 fields");
	assert_skipped("", "1 fields");
}

static void test_a_row_with_a_field_that_is_not_a_finite_number_is_skipped(void **state)
{
	(void)state;
	assert_skipped("0.01,nan,2,3,4,5,6,7,8,9", "gx");
	assert_skipped("0.01,1,2,3,inf,5,6,7,8,9", "ax");
	assert_skipped("0.01,1,2,3,4,1e999,6,7,8,9", "ay");
	assert_skipped("0.01,1,2,3,4,5,0x10,7,8,9", "az");
	assert_skipped("0.01,1,2,,4,5,6,7,8,9", "gz");
	assert_skipped("0.01,1,2,3.0.1,4,5,6,7,8,9", "gz");
	assert_skipped("abc,1,2,3,4,5,6,7,8,9", "t is not a finite number: 'abc'");
	assert_skipped("1e15,1,2,3,4,5,6,7,8,9", "out of range");
}

static void test_a_row_with_half_a_magnetometer_is_skipped(void **state)
{
	(void)state;
	assert_skipped("0.01,1,2,3,4,5,6,7,,9", "my");
}

static void test_a_row_whose_time_does_not_increase_is_skipped(void **state)
{
	(void)state;
	assert_skipped("0.00,1,2,3,4,5,6,7,8,9", "time does not increase: '0'");
	assert_skipped("-1,1,2,3,4,5,6,7,8,9", "time does not increase: '-1'");
	assert_skipped("0.0000001,1,2,3,4,5,6,7,8,9", "time does not increase");
}

static void test_after_a_skipped_row_the_time_is_compared_with_the_last_valid_one(void **state)
{
	const char text[] = HEADER ROW("5") ROW("1") ROW("2") ROW("6");
	struct imu_log log = opened(text, strlen(text));

	(void)state;
	assert_int_equal(count(&log), 2);
	assert_int_equal(log.rows.events.skipped, 2);
}

static void test_a_line_longer_than_the_limit_is_skipped_whole(void **state)
{
	static char row[LOG_LINE_MAX + 100];

	(void)state;
	memset(row, '1', sizeof row - 1);
	assert_skipped(row, "the line is too long");
}

static void test_a_line_with_a_nul_byte_is_skipped(void **state)
{
	const char text[] = HEADER ROW("0") "1,1,2,3,4\0,5,6,7,8,9\n" ROW("2");
	struct imu_log log = opened(text, sizeof text - 1);

	(void)state;
	assert_int_equal(count(&log), 2);
	assert_int_equal(log.rows.events.skipped, 1);
	assert_non_null(strstr(log.rows.events.last_skip, "NUL"));
}

static void test_a_log_without_a_usable_header_is_refused(void **state)
{
	(void)state;
	assert_refused("", -EINVAL, ":1: the file is empty");
	assert_refused("0,1,2,3,4,5,6,7,8,9\n", -EINVAL, ":1: no column t");
	assert_refused("t,gx,gy,gz,ax,ay\n", -EINVAL, "no column az");
	assert_refused("t,gx,gy,gz,ax,ay,az,mx\n", -EINVAL, "no column my");
	assert_refused("t,gx,gy,gz,ax,ay,az,gx\n", -EINVAL, "column gx twice");
}

static void test_a_log_without_two_valid_rows_is_refused_with_the_last_skip(void **state)
{
	(void)state;
	assert_refused(HEADER ROW("0"), -EINVAL, "fewer than two valid rows");
	assert_refused(HEADER ROW("0"), -EINVAL, path);
	assert_refused(HEADER ROW("0") "1,x,2,3,4,5,6,7,8,9\n", -EINVAL, ":3: gx is not a finite number: 'x'");
}

static void test_a_missing_file_and_a_directory_are_refused(void **state)
{
	struct imu_log log;
	char error[256];

	(void)state;
	assert_int_equal(imu_log_open(&log, "/nonexistent.csv", log_format_at(0), error, sizeof error), -ENOENT);
	assert_non_null(strstr(error, "/nonexistent.csv: No such file"));
	assert_int_equal(imu_log_open(&log, "/tmp", log_format_at(0), error, sizeof error), -EIO);
}

static void test_the_rate_is_that_of_the_median_interval(void **state)
{
	const char text[] = HEADER ROW("0") ROW("0.004") ROW("0.008") ROW("3") ROW("3.004") ROW("3.008");
	struct imu_log log = opened(text, strlen(text));

	(void)state;
	assert_true(log.rate_hz == 250);
	imu_log_close(&log);
}

/* The interval in the middle is a lost sample. */
static void test_the_median_is_that_of_the_sorted_intervals(void **state)
{
	static const char *const texts[] = {
		HEADER ROW("0") ROW("0.004") ROW("0.008") ROW("0.012") ROW("0.020") ROW("0.024") ROW("0.028")
			ROW("0.032"),
		HEADER ROW("0") ROW("0.008") ROW("0.012") ROW("0.020") ROW("0.024") ROW("0.028") ROW("0.032")
			ROW("0.036"),
	};

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct imu_log log = opened(texts[i], strlen(texts[i]));

		assert_true(log.rate_hz == 250);
		imu_log_close(&log);
	}
}

static void test_of_two_intervals_the_longer_is_the_median(void **state)
{
	const char text[] = HEADER ROW("0") ROW("0.0100") ROW("0.0205");
	struct imu_log log = opened(text, strlen(text));

	(void)state;
	assert_true(log.rate_hz == 1e6 / 10500);
	imu_log_close(&log);
}

/* Logs one behind the other, each of 1e10 s with its last interval: the 101st begins at 1e18 us, and only its first row
 * is read. */
static void test_the_times_of_logs_end_after_31700_years(void **state)
{
	enum { ROWS = 24, LOGS = 101 };
	static char text[LOGS * ROWS * 40 + 100] = HEADER;
	size_t size = strlen(text);
	struct imu_log log;

	(void)state;
	for (int k = 0; k < LOGS * ROWS; k++) {
		int row = k % ROWS;

		size += (size_t)snprintf(text + size, sizeof text - size, "%s%.2f,1,2,3,4,5,6,7,8,%d\n",
			row < ROWS / 2 ? "" : "99999999", row < ROWS / 2 ? 0.01 * row : 99.76 + 0.01 * row, k % 9);
	}
	log = opened(text, size);
	assert_int_equal(count(&log), (LOGS - 1) * ROWS + 1);
	assert_int_equal(log.rows.events.skipped, ROWS - 1);
	assert_non_null(strstr(log.rows.events.last_skip, "out of range"));
}

/* Between two units: 3.3 and 4 samples a second of the one are 4000 of the other. Ten rows are needed. */
static void test_the_unit_of_the_time_is_found_by_its_interval(void **state)
{
	static const struct {
		double interval;
		int rows;
		double unit_s;
	} at[] = {{0.29, 20, 1}, {0.31, 20, 1e-3}, {249, 20, 1e-3}, {251, 20, 1e-6}, {2.49e5, 20, 1e-6},
		{2.51e5, 20, 1e-9}, {10, 10, 1e-3}, {10, 9, 1}};

	(void)state;
	for (size_t i = 0; i < sizeof at / sizeof *at; i++) {
		char text[2000] = HEADER;
		struct imu_log log;

		for (int k = 0; k < at[i].rows; k++)
			sprintf(text + strlen(text), ROW("%.9g"), k * at[i].interval);
		log = opened(text, strlen(text));
		if (!(log.rate_hz * at[i].interval * at[i].unit_s > 0.999 &&
			    log.rate_hz * at[i].interval * at[i].unit_s < 1.001))
			fail_msg("an interval of %g: %g samples a second", at[i].interval, log.rate_hz);
		imu_log_close(&log);
	}
}

static void assert_first_message(const char *text, const char *expected)
{
	struct imu_log log = opened(text, strlen(text));
	char message[300] = "";

	assert_int_equal(imu_log_message(&log, 0, message, sizeof message), expected[0] != '\0');
	if (!strstr(message, expected))
		fail_msg("'%s' does not say '%s'", message, expected);
	assert_false(imu_log_message(&log, 1, message, sizeof message));
	imu_log_close(&log);
}

/* With the line of the first row, and what to write to be sure. */
static void test_a_unit_that_was_found_by_the_interval_is_told(void **state)
{
	static const struct {
		double interval;
		const char *message;
	} logs[] = {{0.01, ""},
		{10, ":2: the time steps by 10: it is taken as ms; the header can name the unit: t[ms]"},
		{10000, ":2: the time steps by 1e+04: it is taken as us; the header can name the unit: t[us]"},
		{1e7, ":2: the time steps by 1e+07: it is taken as ns; the header can name the unit: t[ns]"}};
	char text[2000];

	(void)state;
	for (size_t i = 0; i < sizeof logs / sizeof *logs; i++) {
		strcpy(text, HEADER);
		for (int k = 0; k < 20; k++)
			sprintf(text + strlen(text), ROW("%.9g"), k * logs[i].interval);
		assert_first_message(text, logs[i].message);
	}
}

static void test_a_log_has_a_reference_in_whichever_column(void **state)
{
	static const struct {
		const char *text;
		bool reference;
	} logs[] = {
		{HEADER ROW("0") ROW("1"), false},
		{"ref_al,ref_as,ref_at,t,gx,gy,gz,ax,ay,az\n1,2,3,0,1,2,3,4,5,6\n1,2,3,1,1,2,3,4,5,6\n", true},
		{"t,ref_al,ref_as,ref_at,gx,gy,gz,ax,ay,az\n0,1,2,3,1,2,3,4,5,6\n1,1,2,3,1,2,3,4,5,6\n", true},
	};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct imu_log log = opened(logs[i].text, strlen(logs[i].text));

		assert_int_equal(imu_log_has_reference(&log), logs[i].reference);
		imu_log_close(&log);
	}
}

/* Two rows behind a step back do not make another log, three do. */
static void test_a_step_back_just_before_the_end_is_no_second_log(void **state)
{
	static const char *const ends[] = {"", ROW("0.00"), ROW("0.00") ROW("0.01"),
		ROW("0.00") ROW("0.01") ROW("0.02"), ROW("0.00") ROW("0.01") ROW("0.02") ROW("0.03")};
	static const int rows[] = {4, 4, 4, 7, 8};

	(void)state;
	for (int i = 0; i < 5; i++) {
		char text[500];
		struct imu_log log;

		snprintf(text, sizeof text, HEADER ROW("0.50") ROW("0.51") ROW("0.52") ROW("0.53") "%s", ends[i]);
		log = opened(text, strlen(text));
		assert_int_equal(count(&log), rows[i]);
	}
}

/* Of the one that each open file has. */
static void test_no_log_leaves_a_descriptor_open(void **state)
{
	static const char good[] = HEADER ROW("0") ROW("1"), bad_header[] = "t,gx\n", one_row[] = HEADER ROW("0");
	struct rlimit old, few;
	char error[256];

	(void)state;
	assert_int_equal(getrlimit(RLIMIT_NOFILE, &old), 0);
	few = (struct rlimit){32, old.rlim_max};
	assert_int_equal(setrlimit(RLIMIT_NOFILE, &few), 0);
	for (int i = 0; i < 40; i++) {
		struct imu_log log = opened(good, strlen(good));

		assert_int_equal(count(&log), 2);
		assert_refused(bad_header, -EINVAL, "no column");
		assert_refused(one_row, -EINVAL, "fewer than two");
		assert_int_equal(imu_log_open(&log, "/tmp", log_format_at(0), error, sizeof error), -EIO);
	}
	assert_int_equal(setrlimit(RLIMIT_NOFILE, &old), 0);
}

static void test_a_pipe_loses_no_row(void **state)
{
	char error[256], name[32];
	struct imu_log log;
	int fd[2];

	(void)state;
	assert_int_equal(pipe(fd), 0);
	if (fork() == 0) {
		FILE *out = fdopen(fd[1], "w");

		fprintf(out, HEADER);
		for (int i = 0; i < 5000; i++)
			fprintf(out, "%d.5,1,2,3,4,5,6,7,8,9\n", i);
		fclose(out);
		_exit(0);
	}
	close(fd[1]);
	snprintf(name, sizeof name, "/dev/fd/%d", fd[0]);
	assert_int_equal(imu_log_open(&log, name, log_format_at(0), error, sizeof error), 0);
	close(fd[0]);
	assert_int_equal(count(&log), 5000);
}

/* Of this process: a busy machine adds none. */
static double cpu_seconds(void)
{
	struct timespec t;

	clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
	return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static double seconds_of_strtod(const char *text)
{
	const double start = cpu_seconds();
	char *end;

	for (text = strchr(text, '\n'); text[1]; text = end) {
		const double value = strtod(text + 1, &end);

		assert_true(value > -100);
	}
	return cpu_seconds() - start;
}

static void test_a_log_is_read_as_fast_as_strtod_reads_its_numbers(void **state)
{
	char *text = malloc(8 << 20);
	double start, s, canary_s;
	struct imu_log log;
	size_t n = 0;

	(void)state;
	n += (size_t)sprintf(text, HEADER);
	for (int i = 0; i < 54000; i++)
		n += (size_t)sprintf(text + n,
			"%.6f,0.00213,-0.00320,0.12345,0.0488,0.0600,9.7836,0.628,15.100,-40.758\n", i * 0.0035);
	log = opened(text, n);
	start = cpu_seconds();
	assert_int_equal(count(&log), 54000);
	s = cpu_seconds() - start;
	canary_s = seconds_of_strtod(text);
	free(text);
	print_message("54,000 rows in %.3f s, strtod alone %.3f s\n", s, canary_s);
	assert_true(s < 20 * canary_s); /* 2.3 times measured, 5 with sanitizers */
}

static void test_a_disk_that_fails_is_told_when_its_rows_are_read(void **state)
{
	static const char *const HEADS[] = {"", "t,gx", HEADER, HEADER ROW("1") "1.0"};
	static const char *const TEXTS[] = {"/failing:1: Input/output error", "/failing:1: Input/output error",
		"/failing:1: Input/output error", "/failing:3: Input/output error"};
	static char text[600000];
	struct imu_sample sample;
	struct imu_log log;
	char error[256];
	int rows = 0, got;

	(void)state;
	for (size_t i = 0; i < sizeof HEADS / sizeof *HEADS; i++) {
		failing = HEADS[i];
		assert_int_equal(imu_log_open(&log, "/failing", log_format_at(0), error, sizeof error), -EIO);
		assert_string_equal(error, TEXTS[i]);
	}
	strcpy(text, HEADER);
	for (size_t n = strlen(text), i = 0; i < 10000; i++)
		n += (size_t)sprintf(text + n, "%.2f,1,2,3,4,5,6,7,8,9\n", 0.01 * (double)i);
	failing = text;
	assert_int_equal(imu_log_open(&log, "/failing", log_format_at(0), error, sizeof error), 0);
	while ((got = imu_log_next(&log, &sample)) > 0)
		rows++;
	assert_int_equal(got, -EIO);
	assert_int_equal(rows, 10000);
	imu_log_close(&log);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_disk_that_fails_is_told_when_its_rows_are_read),
		cmocka_unit_test(test_a_row_becomes_a_sample_in_si_units),
		cmocka_unit_test(test_a_log_names_the_sensors_that_nobody_calibrated_before_its_header),
		cmocka_unit_test(test_empty_magnetometer_fields_mean_no_measurement),
		cmocka_unit_test(test_temperature_and_reference_acceleration_are_read_where_the_row_has_them),
		cmocka_unit_test(test_a_row_with_half_a_reference_or_a_broken_temperature_is_skipped),
		cmocka_unit_test(test_a_header_with_half_a_reference_is_refused),
		cmocka_unit_test(test_the_header_may_leave_the_magnetometer_out),
		cmocka_unit_test(test_the_header_names_the_order_and_other_columns_are_ignored),
		cmocka_unit_test(test_windows_line_ends_blanks_and_a_byte_order_mark_are_accepted),
		cmocka_unit_test(test_the_last_line_needs_no_newline),
		cmocka_unit_test(test_a_row_with_too_few_or_too_many_fields_is_skipped),
		cmocka_unit_test(test_a_row_with_a_field_that_is_not_a_finite_number_is_skipped),
		cmocka_unit_test(test_a_row_with_half_a_magnetometer_is_skipped),
		cmocka_unit_test(test_a_row_whose_time_does_not_increase_is_skipped),
		cmocka_unit_test(test_after_a_skipped_row_the_time_is_compared_with_the_last_valid_one),
		cmocka_unit_test(test_a_line_longer_than_the_limit_is_skipped_whole),
		cmocka_unit_test(test_a_line_with_a_nul_byte_is_skipped),
		cmocka_unit_test(test_a_log_without_a_usable_header_is_refused),
		cmocka_unit_test(test_a_log_without_two_valid_rows_is_refused_with_the_last_skip),
		cmocka_unit_test(test_a_missing_file_and_a_directory_are_refused),
		cmocka_unit_test(test_the_rate_is_that_of_the_median_interval),
		cmocka_unit_test(test_the_median_is_that_of_the_sorted_intervals),
		cmocka_unit_test(test_of_two_intervals_the_longer_is_the_median),
		cmocka_unit_test(test_the_times_of_logs_end_after_31700_years),
		cmocka_unit_test(test_the_unit_of_the_time_is_found_by_its_interval),
		cmocka_unit_test(test_a_unit_that_was_found_by_the_interval_is_told),
		cmocka_unit_test(test_a_log_has_a_reference_in_whichever_column),
		cmocka_unit_test(test_a_step_back_just_before_the_end_is_no_second_log),
		cmocka_unit_test(test_no_log_leaves_a_descriptor_open),
		cmocka_unit_test(test_a_pipe_loses_no_row),
		cmocka_unit_test(test_a_log_is_read_as_fast_as_strtod_reads_its_numbers),
	};

	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}
