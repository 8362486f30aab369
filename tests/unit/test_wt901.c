/* The WT901C-485 over a pty against a simulated sensor, of which every byte is made here. The pty has no bit rate: the
 * sensor answers at once. */
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <setjmp.h>
/* cmocka wants the above first */
#include <cmocka.h>

#include "drivers/ports/imu.h"
#include "model/math/units.h"

enum { ADDRESS = 0x50, REGISTERS = 0x80, BAUD = 115200 };
enum answer { RIGHT, NOTHING, BAD_CRC, BAD_CRC_ONCE, EXCEPTION, SHORT, OTHER_SLAVE, GARBAGE };

static struct sensor {
	pthread_t thread;
	int master; /* of the pty; -1: unplugged */
	atomic_bool stop, live;
	atomic_int answer;
	atomic_int mag_type; /* < 0: an exception */
	pthread_mutex_t lock;
	uint16_t registers[REGISTERS];
	struct {
		uint16_t at, value;
	} writes[32];
	atomic_size_t write_count;
	char link[64];
} sensor = {.lock = PTHREAD_MUTEX_INITIALIZER};

static int64_t now_ms(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static void assert_near(double value, double wanted, double tolerance)
{
	if (!(fabs(value - wanted) <= tolerance))
		fail_msg("%.9g, and not %.9g", value, wanted);
}

/* ---- the simulated sensor ---------------------------------------------------------------------------------------- */

static void append_crc(uint8_t *frame, size_t n)
{
	uint16_t crc = 0xFFFF;

	for (size_t i = 0; i < n; i++) {
		crc ^= frame[i];
		for (int bit = 0; bit < 8; bit++)
			crc = (uint16_t)(crc & 1 ? crc >> 1 ^ 0xA001 : crc >> 1);
	}
	frame[n] = (uint8_t)crc;
	frame[n + 1] = (uint8_t)(crc >> 8);
}

static void say(const void *bytes, size_t n)
{
	if (write(sensor.master, bytes, n) != (ssize_t)n) { /* nobody listens */
	}
}

static void say_exception(uint8_t function)
{
	uint8_t frame[5] = {ADDRESS, (uint8_t)(function | 0x80), 2};

	append_crc(frame, 3);
	say(frame, sizeof frame);
}

static void answer_read(unsigned at, unsigned n)
{
	uint8_t frame[260] = {ADDRESS, 3, (uint8_t)(2 * n)};
	size_t size = 3 + 2 * n;

	if (at == 0x72 && sensor.mag_type < 0) {
		say_exception(3);
		return;
	}
	pthread_mutex_lock(&sensor.lock);
	for (unsigned i = 0; i < n && at + i < REGISTERS; i++) {
		uint16_t word = at + i == 0x72 ? (uint16_t)sensor.mag_type : sensor.registers[at + i];

		frame[3 + 2 * i] = (uint8_t)(word >> 8);
		frame[4 + 2 * i] = (uint8_t)word;
	}
	if (sensor.live) /* the last digit of an accelerometer is never still */
		sensor.registers[0x34] ^= 1;
	pthread_mutex_unlock(&sensor.lock);
	append_crc(frame, size);
	switch ((enum answer)sensor.answer) {
	case RIGHT:
		say(frame, size + 2);
		break;
	case NOTHING:
		break;
	case BAD_CRC_ONCE:
		sensor.answer = RIGHT;
		/* fall through */
	case BAD_CRC:
		frame[size] ^= 0xFF;
		say(frame, size + 2);
		break;
	case EXCEPTION:
		say_exception(3);
		break;
	case SHORT:
		say(frame, size - 4);
		break;
	case OTHER_SLAVE:
		frame[0]++;
		append_crc(frame, size);
		say(frame, size + 2);
		break;
	case GARBAGE:
		for (size_t i = 0; i < sizeof frame; i++)
			frame[i] = (uint8_t)(i * 37 + 0x55);
		say(frame, sizeof frame);
		break;
	}
}

static void note_write(const uint8_t *request)
{
	pthread_mutex_lock(&sensor.lock);
	if (sensor.write_count < sizeof sensor.writes / sizeof *sensor.writes) {
		sensor.writes[sensor.write_count].at = (uint16_t)(request[2] << 8 | request[3]);
		sensor.writes[sensor.write_count].value = (uint16_t)(request[4] << 8 | request[5]);
		sensor.write_count++;
	}
	pthread_mutex_unlock(&sensor.lock);
}

static void serve_request(const uint8_t *request)
{
	uint8_t checked[8];

	memcpy(checked, request, 6);
	append_crc(checked, 6);
	if (memcmp(checked, request, 8) != 0 || request[0] != ADDRESS)
		return;
	if (request[1] == 3)
		answer_read((unsigned)(request[2] << 8 | request[3]), request[5]);
	if (request[1] == 6) {
		note_write(request);
		say(request, 8); /* as Modbus has it: the echo */
	}
}

static void *serve(void *unused)
{
	uint8_t request[8];
	size_t have = 0;

	(void)unused;
	while (!sensor.stop) {
		struct pollfd fd = {sensor.master, POLLIN, 0};

		if (poll(&fd, 1, 5) <= 0 || !(fd.revents & POLLIN)) {
			have = 0; /* a pause ends a request */
			if (fd.revents & POLLHUP)
				usleep(1000);
			continue;
		}
		ssize_t n = read(sensor.master, request + have, sizeof request - have);
		if (n > 0)
			have += (size_t)n;
		if (have == sizeof request) {
			serve_request(request);
			have = 0;
		}
	}
	return NULL;
}

static void plug(void)
{
	int master = posix_openpt(O_RDWR | O_NOCTTY);
	struct termios raw;

	assert_true(master >= 0);
	assert_int_equal(grantpt(master), 0);
	assert_int_equal(unlockpt(master), 0);
	tcgetattr(master, &raw);
	cfmakeraw(&raw);
	tcsetattr(master, TCSANOW, &raw);
	unlink(sensor.link);
	assert_int_equal(symlink(ptsname(master), sensor.link), 0);
	sensor.master = master;
	sensor.stop = false;
	assert_int_equal(pthread_create(&sensor.thread, NULL, serve, NULL), 0);
}

static void unplug(void)
{
	sensor.stop = true;
	pthread_join(sensor.thread, NULL);
	close(sensor.master);
	sensor.master = -1;
	unlink(sensor.link);
}

static void set_registers(unsigned at, size_t n, const int16_t *values)
{
	pthread_mutex_lock(&sensor.lock);
	for (size_t i = 0; i < n; i++)
		sensor.registers[at + i] = (uint16_t)values[i];
	pthread_mutex_unlock(&sensor.lock);
}

static int setup(void **state)
{
	static const int16_t at_rest[13] = {0, 0, 2048, 0, 0, 0, 1500, 0, -3000, 0, 0, 0, 2534};

	(void)state;
	snprintf(sensor.link, sizeof sensor.link, "/tmp/imu9-wt901.%d", (int)getpid());
	sensor.live = true;
	sensor.answer = RIGHT;
	sensor.mag_type = 3;
	sensor.write_count = 0;
	memset(sensor.registers, 0, sizeof sensor.registers);
	set_registers(0x34, 13, at_rest);
	plug();
	return 0;
}

static int teardown(void **state)
{
	(void)state;
	if (sensor.master >= 0)
		unplug();
	return 0;
}

/* ---- the gateway's side ------------------------------------------------------------------------------------------ */

static struct imu_port *open_baud(int baud)
{
	char src[96], error[200] = "";
	struct imu_port *port = NULL;

	snprintf(src, sizeof src, "wt901:%s,baud=%d", sensor.link, baud);
	if (imu_open(src, NULL, &port, error, sizeof error) != 0)
		fail_msg("%s", error);
	return port;
}

static struct imu_port *open_sensor(void)
{
	return open_baud(BAUD);
}

/* What read() says next: 1, or an error. -ETIME: nothing within that time. */
static int next(struct imu_port *port, struct imu_sample *sample, int ms)
{
	int64_t until = now_ms() + ms;

	for (;;) {
		struct pollfd fd = {port->fd, POLLIN, 0};
		int result = imu_read(port, sample);

		if (result != 0)
			return result;
		if (now_ms() >= until)
			return -ETIME;
		poll(&fd, 1, (int)(until - now_ms()) + 1);
	}
}

/* The fault that comes within that time, samples before it dropped. */
static int fault_within(struct imu_port *port, int ms)
{
	struct imu_sample sample;
	int64_t until = now_ms() + ms;

	while (now_ms() < until) {
		int result = next(port, &sample, (int)(until - now_ms()));

		if (result == -EIO)
			return port->health.fault;
	}
	return IMU_FAULT_NONE;
}

static void assert_samples_come(struct imu_port *port, int ms)
{
	struct imu_sample sample;
	int64_t until = now_ms() + ms;

	while (next(port, &sample, ms) != 1)
		assert_true(now_ms() < until);
	assert_int_equal(port->health.fault, IMU_FAULT_NONE);
}

/* ---- values ------------------------------------------------------------------------------------------------------ */

static void test_every_measurement_comes_with_the_scale_of_the_data_sheet(void **state)
{
	static const int16_t words[13] = {16384, -2048, 2048, 16384, -16384, 100, 2000, -1000, 1, 11, 12, 13, -1234};
	struct imu_sample sample;
	struct imu_port *port;

	(void)state;
	sensor.live = false;
	set_registers(0x34, 13, words);
	port = open_sensor();
	assert_int_equal(next(port, &sample, 500), 1);
	assert_near(sample.accel_m_s2.x, 8 * STANDARD_GRAVITY_M_S2, 1e-9);
	assert_near(sample.accel_m_s2.y, -STANDARD_GRAVITY_M_S2, 1e-9);
	assert_near(sample.accel_m_s2.z, STANDARD_GRAVITY_M_S2, 1e-9);
	assert_near(sample.gyro_rad_s.x, 1000 * PI / 180, 1e-9);
	assert_near(sample.gyro_rad_s.y, -1000 * PI / 180, 1e-9);
	assert_near(sample.gyro_rad_s.z, 100 * 2000.0 / 32768 * PI / 180, 1e-9);
	assert_near(sample.mag_uT.x, 26, 1e-9);
	assert_near(sample.mag_uT.y, -13, 1e-9);
	assert_near(sample.mag_uT.z, 0.013, 1e-9);
	assert_near(sample.temperature_degC, -12.34, 1e-9);
	assert_int_equal(sample.flags, SAMPLE_MAG | SAMPLE_TEMPERATURE);
	imu_close(port);
}

static void test_the_field_s_scale_is_that_of_the_magnetometer_fitted(void **state)
{
	static const struct {
		int type;
		double step;
	} fitted[] = {{2, 0.15}, {5, 0.098}, {7, 0.02}, {0, 0.013}, {1000, 0.013}, {-1, 0.013}};

	(void)state;
	for (size_t i = 0; i < sizeof fitted / sizeof *fitted; i++) {
		struct imu_sample sample;
		struct imu_port *port;

		sensor.mag_type = fitted[i].type;
		port = open_sensor();
		assert_int_equal(next(port, &sample, 500), 1);
		assert_near(sample.mag_uT.z, -3000 * fitted[i].step, 1e-9);
		imu_close(port);
	}
}

static void test_a_value_at_the_end_of_its_range_is_flagged(void **state)
{
	struct imu_sample sample;
	struct imu_port *port = open_sensor();

	(void)state;
	set_registers(0x39, 1, (const int16_t[]){INT16_MIN});
	do
		assert_int_equal(next(port, &sample, 500), 1);
	while (sample.gyro_rad_s.z == 0);
	assert_true(sample.flags & SAMPLE_SATURATED);
	imu_close(port);
}

/* ---- rate and time ----------------------------------------------------------------------------------------------- */

/* 39 characters of 10 bits, twice 3.5 characters (at least 1.75 ms) of silence, 3 ms until the sensor answers */
static void test_the_rate_is_what_the_baud_rate_permits(void **state)
{
	static const struct {
		int baud;
		double hz;
	} rates[] = {{9600, 19.64}, {38400, 60.04}, {115200, 100}};

	(void)state;
	for (size_t i = 0; i < sizeof rates / sizeof *rates; i++) {
		struct imu_port *port = open_baud(rates[i].baud);

		assert_near(port->rate_hz, rates[i].hz, 0.01);
		imu_close(port);
	}
}

static void test_samples_come_at_that_rate_and_with_the_time_they_were_taken_at(void **state)
{
	struct imu_sample sample;
	struct imu_port *port = open_sensor();
	uint64_t last_us = 0, first_us = 0;
	int n = 0;

	(void)state;
	for (; n < 30; n++) {
		assert_int_equal(next(port, &sample, 500), 1);
		assert_true(sample.t_us > last_us);
		assert_in_range(now_ms() - (int64_t)(sample.t_us / 1000), 0, 50);
		last_us = sample.t_us;
		if (n == 0)
			first_us = sample.t_us;
	}
	assert_in_range((last_us - first_us) / 29, 9900, 12000);
	imu_close(port);
}

/* ---- settings ---------------------------------------------------------------------------------------------------- */

static void test_the_bandwidth_is_unlocked_and_set_and_never_saved(void **state)
{
	struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	struct imu_port *port = open_sensor(); /* 100 Hz: 50 Hz at least is 98 Hz, code 2 */
	char error[100];

	(void)state;
	assert_samples_come(port, 500);
	settings.bandwidth_hz = 20;
	assert_int_equal(port->ops->configure(port, &settings, 0, error, sizeof error), 0);
	for (int64_t until = now_ms() + 1000; sensor.write_count < 4 && now_ms() < until;)
		usleep(1000);
	assert_samples_come(port, 1500);
	imu_close(port);
	assert_true(sensor.write_count >= 4);
	for (size_t i = 0; i + 1 < sensor.write_count; i += 2) {
		assert_int_equal(sensor.writes[i].at, 0x69);
		assert_int_equal(sensor.writes[i].value, 0xB588);
		assert_int_equal(sensor.writes[i + 1].at, 0x1F);
	}
	assert_int_equal(sensor.writes[1].value, 2);
	assert_int_equal(sensor.writes[sensor.write_count - 1].value, 4);
}

static void test_a_range_it_has_not_is_refused(void **state)
{
	struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	struct imu_port *port = open_sensor();
	char error[100];

	(void)state;
	settings.accel_range_g = 24;
	assert_int_equal(port->ops->configure(port, &settings, 1, error, sizeof error), -EINVAL);
	assert_string_equal(error, "wt901: range too wide: the sensor has 2000 deg/s and 16 g");
	imu_close(port);
}

/* ---- faults ------------------------------------------------------------------------------------------------------ */

static void test_silence_is_a_fault_and_samples_come_again_after_it(void **state)
{
	struct imu_port *port = open_sensor();

	(void)state;
	assert_samples_come(port, 500);
	sensor.answer = NOTHING;
	assert_int_equal(fault_within(port, 200), IMU_FAULT_SILENT);
	assert_int_equal(port->health.fault_chip, IMU_CHIP_GYRO);
	sensor.answer = RIGHT;
	assert_samples_come(port, 1500);
	assert_true(port->health.restarts >= 1 && port->health.bus_errors >= 2);
	imu_close(port);
}

static void test_answers_that_are_none_are_faults_and_never_samples(void **state)
{
	static const enum answer wrong[] = {BAD_CRC, EXCEPTION, SHORT, OTHER_SLAVE, GARBAGE};

	(void)state;
	for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
		struct imu_port *port = open_sensor();
		struct imu_sample sample;

		assert_samples_come(port, 500);
		sensor.answer = wrong[i];
		assert_int_equal(fault_within(port, 400), IMU_FAULT_SILENT);
		while (next(port, &sample, 100) == -EIO)
			;
		assert_int_equal(next(port, &sample, 100) == 1, 0);
		sensor.answer = RIGHT;
		assert_samples_come(port, 1500);
		imu_close(port);
	}
}

static void test_one_bad_answer_costs_one_sample_and_is_counted(void **state)
{
	struct imu_port *port = open_sensor();
	struct imu_sample sample;

	(void)state;
	assert_samples_come(port, 500);
	sensor.answer = BAD_CRC_ONCE;
	for (int i = 0; i < 100 && port->health.bus_errors == 0; i++)
		assert_int_equal(next(port, &sample, 500), 1);
	assert_int_equal(port->health.bus_errors, 1);
	assert_int_equal(port->health.restarts, 0);
	imu_close(port);
}

static void test_measurements_that_do_not_change_are_a_fault_until_they_do(void **state)
{
	struct imu_port *port = open_sensor();

	(void)state;
	assert_samples_come(port, 500);
	sensor.live = false;
	assert_int_equal(fault_within(port, 600), IMU_FAULT_FROZEN);
	sensor.live = true;
	assert_samples_come(port, 300);
	imu_close(port);
}

static void test_unplugged_it_is_lost_and_plugged_in_again_it_goes_on(void **state)
{
	struct imu_port *port = open_sensor();

	(void)state;
	for (int i = 0; i < 2; i++) {
		assert_samples_come(port, 1500);
		unplug();
		assert_int_equal(fault_within(port, 200), IMU_FAULT_SILENT);
		plug();
	}
	assert_samples_come(port, 1500);
	imu_close(port);
}

static void test_closing_does_not_wait_for_a_sensor_that_is_silent(void **state)
{
	struct imu_port *port = open_sensor();
	int64_t begun;

	(void)state;
	sensor.answer = NOTHING;
	fault_within(port, 200);
	begun = now_ms();
	imu_close(port);
	assert_in_range(now_ms() - begun, 0, 150);
}

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static void assert_refused(const char *src, int result, const char *words)
{
	struct imu_port *port;
	char error[200] = "";

	assert_int_equal(imu_open(src, NULL, &port, error, sizeof error), result);
	if (!strstr(error, words))
		fail_msg("'%s' does not say '%s'", error, words);
}

static void test_what_is_wrong_is_said(void **state)
{
	char src[96];

	(void)state;
	assert_refused("wt901:", -EINVAL, "wt901:/dev/ttyX");
	assert_refused("wt901:/dev/null,baud=9601", -EINVAL, "baud=9601");
	assert_refused("wt901:/dev/null,baud=", -EINVAL, "'baud='");
	assert_refused("wt901:/dev/null,address=0", -EINVAL, "address=0");
	assert_refused("wt901:/dev/null,speed=9600", -EINVAL, "speed=9600");
	assert_refused("wt901:/nowhere/tty", -ENOENT, "/nowhere/tty: No such file or directory");
	snprintf(src, sizeof src, "wt901:%s,address=81,baud=115200", sensor.link);
	assert_refused(src, -ETIMEDOUT, "no answer from address 51h at 115200 Bd");
}

static void test_that_descriptors_are_short_is_said_of_whatever_sensor(void **state)
{
	static const char *const SOURCES[] = {"wt901:/dev/null", "iio", "sim"};
	struct rlimit limit, none;

	(void)state;
	getrlimit(RLIMIT_NOFILE, &limit);
	none = (struct rlimit){0, limit.rlim_max};
	setrlimit(RLIMIT_NOFILE, &none);
	for (size_t i = 0; i < sizeof SOURCES / sizeof *SOURCES; i++) {
		struct imu_port *port;
		char error[200] = "what was here before";

		assert_int_equal(imu_open(SOURCES[i], NULL, &port, error, sizeof error), -EMFILE);
		assert_non_null(strstr(error, "Too many open files"));
	}
	setrlimit(RLIMIT_NOFILE, &limit);
}

int main(void)
{
#define SENSOR_TEST(f) cmocka_unit_test_setup_teardown(f, setup, teardown)
	const struct CMUnitTest tests[] = {
		SENSOR_TEST(test_every_measurement_comes_with_the_scale_of_the_data_sheet),
		SENSOR_TEST(test_the_field_s_scale_is_that_of_the_magnetometer_fitted),
		SENSOR_TEST(test_a_value_at_the_end_of_its_range_is_flagged),
		SENSOR_TEST(test_the_rate_is_what_the_baud_rate_permits),
		SENSOR_TEST(test_samples_come_at_that_rate_and_with_the_time_they_were_taken_at),
		SENSOR_TEST(test_the_bandwidth_is_unlocked_and_set_and_never_saved),
		SENSOR_TEST(test_a_range_it_has_not_is_refused),
		SENSOR_TEST(test_silence_is_a_fault_and_samples_come_again_after_it),
		SENSOR_TEST(test_answers_that_are_none_are_faults_and_never_samples),
		SENSOR_TEST(test_one_bad_answer_costs_one_sample_and_is_counted),
		SENSOR_TEST(test_measurements_that_do_not_change_are_a_fault_until_they_do),
		SENSOR_TEST(test_unplugged_it_is_lost_and_plugged_in_again_it_goes_on),
		SENSOR_TEST(test_closing_does_not_wait_for_a_sensor_that_is_silent),
		SENSOR_TEST(test_what_is_wrong_is_said),
		cmocka_unit_test(test_that_descriptors_are_short_is_said_of_whatever_sensor),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
