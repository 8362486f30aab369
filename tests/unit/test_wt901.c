/* The WT901C-485 through libmodbus on a pseudo terminal, against a simulated sensor whose bytes are made here. How the
 * driver behaves in time is tested with a simulated libmodbus (test_wt901_port.c); here timeouts are long. */
#include <dlfcn.h>
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

#include <modbus/modbus.h>

#include "drivers/ports/imu.h"
#include "model/math/units.h"

enum { ADDRESS = 0x50, REGISTERS = 0x80, BAUD = 115200 };

static struct sensor {
	pthread_t thread;
	int master; /* of the pty; -1: unplugged */
	atomic_bool stop, live, bad_crc_once;
	atomic_int mag_type; /* < 0: an exception */
	pthread_mutex_t lock;
	uint16_t registers[REGISTERS];
	char link[64];
} sensor = {.lock = PTHREAD_MUTEX_INITIALIZER};

/* Instead of the driver's timeouts of some 50 ms, which a busy machine may exceed. */
int modbus_set_response_timeout(modbus_t *line, uint32_t s, uint32_t us)
{
	int (*real)(modbus_t *, uint32_t, uint32_t);

	(void)s, (void)us;
	*(void **)&real = dlsym(RTLD_NEXT, "modbus_set_response_timeout");
	return real(line, 10, 0);
}

int modbus_set_byte_timeout(modbus_t *line, uint32_t s, uint32_t us)
{
	int (*real)(modbus_t *, uint32_t, uint32_t);

	(void)s, (void)us;
	*(void **)&real = dlsym(RTLD_NEXT, "modbus_set_byte_timeout");
	return real(line, 10, 0);
}

static void assert_near(double value, double wanted, double tolerance)
{
	if (!(fabs(value - wanted) <= tolerance))
		fail_msg("%.9g, expected %.9g", value, wanted);
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
	if (write(sensor.master, bytes, n) != (ssize_t)n) { /* the port was closed */
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
	if (sensor.live) /* the last digit of an accelerometer changes always */
		sensor.registers[0x34] ^= 1;
	pthread_mutex_unlock(&sensor.lock);
	append_crc(frame, size);
	if (atomic_exchange(&sensor.bad_crc_once, false))
		frame[size] ^= 0xFF;
	say(frame, size + 2);
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
	if (request[1] == 6)
		say(request, 8); /* the answer to a write is its echo */
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
	sensor.bad_crc_once = false;
	sensor.mag_type = 3;
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
	if (imu_open(src, NULL, &port, error, sizeof error) != 0 || error[0])
		fail_msg("%s", error);
	return port;
}

static struct imu_port *open_sensor(void)
{
	return open_baud(BAUD);
}

/* The next result of read(): 1, or an error. */
static int next(struct imu_port *port, struct imu_sample *sample)
{
	struct pollfd fd = {port->fd, POLLIN, 0};
	int result;

	while ((result = imu_read(port, sample)) == 0)
		assert_int_equal(poll(&fd, 1, 120000), 1);
	return result;
}

/* ---- values ------------------------------------------------------------------------------------------------------ */

static void test_every_measurement_has_the_scale_of_the_data_sheet(void **state)
{
	static const int16_t words[13] = {16384, -2048, 2048, 16384, -16384, 100, 2000, -1000, 1, 11, 12, 13, -1234};
	struct imu_sample sample;
	struct imu_port *port;

	(void)state;
	sensor.live = false;
	set_registers(0x34, 13, words);
	port = open_sensor();
	assert_int_equal(next(port, &sample), 1);
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

static void test_the_scale_of_the_field_is_that_of_the_magnetometer_type(void **state)
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
		assert_int_equal(next(port, &sample), 1);
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
		assert_int_equal(next(port, &sample), 1);
	while (sample.gyro_rad_s.z == 0);
	assert_true(sample.flags & SAMPLE_SATURATED);
	imu_close(port);
}

static void test_an_answer_with_a_bad_crc_is_counted_and_not_a_sample(void **state)
{
	struct imu_port *port = open_sensor();
	struct imu_sample sample;
	uint32_t before;

	(void)state;
	before = port->health.bus_errors; /* on a busy machine an answer may be late, too */
	sensor.bad_crc_once = true;
	while (sensor.bad_crc_once || port->health.bus_errors == before)
		next(port, &sample);
	imu_close(port);
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

static void test_a_wrong_address_or_option_is_refused_with_what_to_do(void **state)
{
	(void)state;
	assert_refused("wt901:", -EINVAL, "wt901:/dev/ttyX");
	assert_refused("wt901:/dev/null,baud=9601", -EINVAL, "baud=9601");
	assert_refused("wt901:/dev/null,baud=", -EINVAL, "'baud='");
	assert_refused("wt901:/dev/null,address=0", -EINVAL, "address=0");
	assert_refused("wt901:/dev/null,speed=9600", -EINVAL, "speed=9600");
	assert_refused("wt901:/nowhere/tty", -ENOENT, "/nowhere/tty: No such file or directory");
}

static void test_any_sensor_reports_that_no_descriptors_are_left(void **state)
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
		SENSOR_TEST(test_every_measurement_has_the_scale_of_the_data_sheet),
		SENSOR_TEST(test_the_scale_of_the_field_is_that_of_the_magnetometer_type),
		SENSOR_TEST(test_a_value_at_the_end_of_its_range_is_flagged),
		SENSOR_TEST(test_an_answer_with_a_bad_crc_is_counted_and_not_a_sample),
		SENSOR_TEST(test_a_wrong_address_or_option_is_refused_with_what_to_do),
		cmocka_unit_test(test_any_sensor_reports_that_no_descriptors_are_left),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
