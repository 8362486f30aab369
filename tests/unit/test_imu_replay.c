#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "drivers/ports/sources.h"
#include "drivers/ports/imu.h"
#include "tests/unit/descriptors.h"

enum { ROWS = 20 };

static char path[64];

static double now_s(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Rows at 100.00 s, 100.01 s ..; gx counts them. A bad row follows the first. */
static int write_log(void **state)
{
	FILE *file;

	(void)state;
	strcpy(path, "/tmp/imu9_replay_XXXXXX");
	file = fdopen(mkstemp(path), "w");
	fprintf(file, "t,gx,gy,gz,ax,ay,az\n");
	for (int i = 0; i < ROWS; i++) {
		fprintf(file, "%.2f,%d,0,0,0,0,9.81\n", 100 + i * 0.01, i);
		if (i == 0)
			fprintf(file, "100,bad\n");
	}
	return fclose(file);
}

static int remove_log(void **state)
{
	(void)state;
	return unlink(path);
}

static struct imu_port *opened(const char *options)
{
	struct imu_port *port;
	char src[128], error[256] = "";

	snprintf(src, sizeof src, "replay:%s%s", path, options);
	if (imu_open(src, NULL, &port, error, sizeof error) != 0 || error[0])
		fail_msg("%s", error);
	return port;
}

static int wait_and_read(struct imu_port *port, struct imu_sample *sample)
{
	struct pollfd fd = {port->fd, POLLIN, 0};
	int got;

	do {
		assert_int_equal(poll(&fd, 1, 120000), 1);
		got = imu_read(port, sample);
	} while (got == 0);
	return got;
}

static void test_every_row_is_read_in_order_and_not_before_its_time(void **state)
{
	double start = now_s();
	struct imu_port *port = opened("");
	struct imu_sample sample;

	(void)state;
	for (int i = 0; i < ROWS; i++) {
		assert_int_equal(wait_and_read(port, &sample), 1);
		assert_true(now_s() - start >= i * 0.01);
		assert_true(sample.gyro_rad_s.x == i);
		assert_int_equal(sample.t_us, 100000000 + i * 10000);
		assert_int_equal(sample.flags, 0);
	}
	assert_true(now_s() - start < ROWS * 0.01 + 0.5);
	assert_int_equal(port->counters.samples, ROWS);
	imu_close(port);
}

static void test_the_end_of_the_log_is_reported_at_once_and_stays(void **state)
{
	struct imu_port *port = opened(",speed=1000");
	struct imu_sample sample;

	(void)state;
	for (int i = 0; i < ROWS; i++)
		assert_int_equal(wait_and_read(port, &sample), 1);
	assert_int_equal(wait_and_read(port, &sample), -ENODATA);
	assert_int_equal(imu_read(port, &sample), -ENODATA);
	imu_close(port);
}

static void test_the_speed_changes_the_pace_and_not_the_time_stamps(void **state)
{
	double start = now_s();
	struct imu_port *port = opened(",speed=0.5");
	struct imu_sample sample;

	(void)state;
	for (int i = 0; i < 5; i++)
		assert_int_equal(wait_and_read(port, &sample), 1);
	assert_true(now_s() - start >= 4 * 0.02);
	assert_int_equal(sample.t_us, 100040000);
	assert_true(port->rate_hz == 100);
	imu_close(port);
}

/* It is silent after ten intervals, 100 ms at least: at a hundredth of the speed an interval is 1 s. */
static void test_a_slow_replay_is_silent_later(void **state)
{
	static const char *const options[] = {"", ",speed=0.01", ",speed=0.05"};
	static const uint64_t silence_us[] = {100000, 10000000, 2000000};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct imu_port *port = opened(options[i]);

		assert_int_equal(port->silence_us, silence_us[i]);
		imu_close(port);
	}
}

static void test_a_log_of_an_uncalibrated_sensor_is_replayed_as_one(void **state)
{
	char log[64] = "/tmp/imu9_replay_XXXXXX", src[80], error[256];
	FILE *file = fdopen(mkstemp(log), "w");
	struct imu_port *port;

	(void)state;
	fprintf(file, "# uncalibrated: gyro magnetometer\nt,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.81\n1,0,0,0,0,0,9.81\n");
	fclose(file);
	snprintf(src, sizeof src, "replay:%s", log);
	assert_int_equal(imu_open(src, NULL, &port, error, sizeof error), 0);
	assert_int_equal(port->uncalibrated, 1 | 4);
	imu_close(port);
	unlink(log);
}

static void test_a_loop_starts_again_with_a_discontinuity_and_increasing_time(void **state)
{
	struct imu_port *port = opened(",loop,speed=100");
	struct imu_sample sample;

	(void)state;
	for (int i = 0; i < 5 * ROWS; i++) {
		assert_int_equal(wait_and_read(port, &sample), 1);
		assert_true(sample.gyro_rad_s.x == i % ROWS);
		assert_int_equal(sample.t_us, 100000000 + i * 10000);
		assert_int_equal(sample.flags, i > 0 && i % ROWS == 0 ? SAMPLE_DISCONTINUITY : 0);
	}
	imu_close(port);
}

static void test_the_descriptor_is_not_readable_before_a_sample_is_due(void **state)
{
	struct imu_port *port = opened(",speed=0.001");
	struct pollfd fd = {port->fd, POLLIN, 0};
	struct imu_sample sample;

	(void)state;
	assert_int_equal(wait_and_read(port, &sample), 1);
	assert_int_equal(imu_read(port, &sample), 0);
	assert_int_equal(poll(&fd, 1, 0), 0);
	imu_close(port);
}

static void test_after_a_pause_all_due_samples_are_read_and_counted_as_late(void **state)
{
	struct imu_port *port = opened("");
	struct pollfd fd = {port->fd, POLLIN, 0};
	struct imu_sample sample;

	(void)state;
	usleep(125000);
	for (int i = 0; i < 12; i++) {
		assert_int_equal(poll(&fd, 1, 0), 1);
		assert_int_equal(imu_read(port, &sample), 1);
		assert_true(sample.gyro_rad_s.x == i);
	}
	assert_in_range(port->counters.late, 10, 12);
	imu_close(port);
}

static void test_skipped_rows_are_counted_with_the_reason_of_the_last(void **state)
{
	struct imu_port *port = opened("");

	(void)state;
	assert_int_equal(port->counters.skipped, 1);
	assert_non_null(strstr(port->last_skip, ":3: 2 fields"));
	imu_close(port);
}

static void assert_refused(const char *src, const char *word)
{
	struct imu_port *port;
	char error[256] = "";

	assert_true(imu_open(src, NULL, &port, error, sizeof error) < 0);
	if (!strstr(error, word))
		fail_msg("%s: '%s' does not say '%s'", src, error, word);
}

static void test_an_unknown_source_or_option_is_refused_with_what_to_use(void **state)
{
	(void)state;
	assert_refused("", "unknown IMU source '': use one of sim");
	assert_refused("usb:/dev/ttyUSB0", "use one of sim[:SCENARIO][,board=B][,rate=HZ][,uncalibrated], replay:FILE");
	assert_refused("replay", "no file");
	assert_refused("replay:", "no file");
	assert_refused("replay:/nonexistent.csv", "/nonexistent.csv: No such file");
	assert_refused("replay:x.csv,lop", "unknown option 'lop': use loop, speed=X");
	assert_refused("replay:x.csv,speed=0", "factor from 0.001");
	assert_refused("replay:x.csv,speed=fast", "factor from 0.001");
	assert_refused("replay:x.csv,", "unknown option ''");
}

/* Bus and options of the sensor on I2C, before anything is opened; with none wrong, the bus is what is missing. */
static void test_a_wrong_option_of_i2c_is_refused_with_what_to_use(void **state)
{
	static const char *const wrong[] = {"foo", "drdy=", "drdy=gpiochip0", "drdy=gpiochip0:", "drdy=gpiochip0:x",
		"drdy=gpiochip0:3x", "drdy=:3", "stub,foo", "config=", "speed=1e6", ""};

	(void)state;
	assert_refused("i2c", "no bus: use i2c:");
	assert_refused("i2c:", "no bus: use i2c:");
	assert_refused("i2c:,stub", "no bus: use i2c:");
	for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
		char src[100];

		snprintf(src, sizeof src, "i2c:/nonexistent,%s", wrong[i]);
		assert_refused(src, "unknown option");
	}
	assert_refused("i2c:/nonexistent,stub,drdy=gpiochip0:17", "/nonexistent");
	assert_refused("i2c:/nonexistent", "/nonexistent");
}

static void test_the_port_is_named_after_the_file_without_its_folder(void **state)
{
	struct imu_port *port = opened("");

	(void)state;
	assert_memory_equal(port->name, "replay:imu9_replay_", 19);
	imu_close(port);
}

static void test_a_source_of_4096_characters_is_too_long(void **state)
{
	static char src[4097];

	(void)state;
	memset(src, 'x', 4096);
	assert_refused(src, "too long: use at most 4095");
	src[4095] = '\0';
	assert_refused(src, "unknown IMU source");
}

/* What --help of the programs lists. */
static void test_the_list_of_sources_has_syntax_and_description_of_each(void **state)
{
	static const char *const words[] = {
		"sim[:SCENARIO]", "replay:FILE", "i2c:", "spi:", "iio", "wt901:", "real time", "WitMotion", "Pololu"};
	char text[2000] = "";
	FILE *out = fmemopen(text, sizeof text, "w");

	(void)state;
	imu_print_sources(out);
	fclose(out);
	for (size_t i = 0; i < sizeof words / sizeof *words; i++)
		assert_non_null(strstr(text, words[i]));
}

static void test_closing_null_is_permitted(void **state)
{
	(void)state;
	imu_close(NULL);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_every_row_is_read_in_order_and_not_before_its_time),
		cmocka_unit_test(test_the_end_of_the_log_is_reported_at_once_and_stays),
		cmocka_unit_test(test_the_speed_changes_the_pace_and_not_the_time_stamps),
		cmocka_unit_test(test_a_slow_replay_is_silent_later),
		cmocka_unit_test(test_a_log_of_an_uncalibrated_sensor_is_replayed_as_one),
		cmocka_unit_test(test_a_loop_starts_again_with_a_discontinuity_and_increasing_time),
		cmocka_unit_test(test_the_descriptor_is_not_readable_before_a_sample_is_due),
		cmocka_unit_test(test_after_a_pause_all_due_samples_are_read_and_counted_as_late),
		cmocka_unit_test(test_skipped_rows_are_counted_with_the_reason_of_the_last),
		cmocka_unit_test(test_an_unknown_source_or_option_is_refused_with_what_to_use),
		cmocka_unit_test(test_a_wrong_option_of_i2c_is_refused_with_what_to_use),
		cmocka_unit_test(test_the_port_is_named_after_the_file_without_its_folder),
		cmocka_unit_test(test_a_source_of_4096_characters_is_too_long),
		cmocka_unit_test(test_the_list_of_sources_has_syntax_and_description_of_each),
		cmocka_unit_test(test_closing_null_is_permitted),
	};

	count_descriptors(NULL);
	int failed = cmocka_run_group_tests(tests, write_log, remove_log);
	no_descriptor_is_left(NULL);
	return failed;
}
