/* The WT901C-485 with libmodbus simulated: its functions are defined here. The driver's thread runs within run(), in a
 * time that moves only here: with each wait, and with each transfer by what it takes on the line. test_wt901.c has the
 * bytes. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <math.h>
#include <modbus/modbus.h>
#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "drivers/imu/imu_thread.h"
#include "tests/unit/descriptors.h"

enum { WRITES = 32, MS = 1000000 };

struct _modbus {
	bool connected;
};

static struct world {
	struct _modbus line;
	unsigned connections, open_lines;
	bool no_line; /* libmodbus makes none */
	int thread_error;
	int connect_error, answer_error; /* errno; 0: the sensor answers */
	int mag_type, mag_error;	 /* of the register with the magnetometer's type; error: no value */
	unsigned missing_reads;		 /* of the measurements, from now on */
	unsigned bad_read;		 /* the answer to this read of the measurements is bad, from 1; 0: none */
	int16_t words[13];
	bool live;
	bool left_over; /* bytes that nobody asked for were received; a flush drops them */
	int baud, address;
	uint32_t response_timeout_us, byte_timeout_us;
	struct {
		int at, value;
	} writes[WRITES];
	size_t write_count;
	unsigned reads;

	int64_t now_ns, request_ns, answer_ns; /* how long a request, and the answer to it, take */
	void *(*thread)(void *);
	void *thread_ctx;
	unsigned waits;	    /* of the thread, that are left */
	unsigned good_from; /* with so many waits left the sensor answers again; 0: it does not */
} w;

static struct imu_port *port;

/* ---- the system -------------------------------------------------------------------------------------------------- */

int clock_gettime(clockid_t clock, struct timespec *t)
{
	(void)clock;
	*t = (struct timespec){w.now_ns / 1000000000, (long)(w.now_ns % 1000000000)};
	return 0;
}

int pthread_create(
	pthread_t *restrict thread, const pthread_attr_t *restrict attr, void *(*start)(void *), void *restrict ctx)
{
	(void)thread, (void)attr;
	if (w.thread_error)
		return w.thread_error;
	w.thread = start;
	w.thread_ctx = ctx;
	return 0;
}

int pthread_join(pthread_t thread, void **result)
{
	(void)thread, (void)result;
	return 0;
}

int ppoll(struct pollfd *fds, nfds_t n, const struct timespec *timeout, const sigset_t *mask)
{
	(void)fds, (void)n, (void)mask;
	w.now_ns += timeout->tv_sec * 1000000000 + timeout->tv_nsec;
	if (w.thread && w.good_from && w.waits == w.good_from)
		w.answer_error = 0;
	if (w.thread && w.waits-- == 0)
		((struct imu_thread *)w.thread_ctx)->stop = true;
	return 0;
}

/* ---- libmodbus --------------------------------------------------------------------------------------------------- */

static int failed(int error)
{
	errno = error;
	return -1;
}

modbus_t *modbus_new_rtu(const char *device, int baud, char parity, int data_bits, int stop_bits)
{
	assert_string_equal(device, "/dev/ttyUSB7");
	assert_int_equal(parity, 'N');
	assert_int_equal(data_bits, 8);
	assert_int_equal(stop_bits, 1);
	if (w.no_line) {
		errno = EINVAL;
		return NULL;
	}
	w.baud = baud;
	w.open_lines++;
	return &w.line;
}

int modbus_set_slave(modbus_t *line, int address)
{
	(void)line;
	w.address = address;
	return 0;
}

int modbus_set_response_timeout(modbus_t *line, uint32_t s, uint32_t us)
{
	(void)line;
	w.response_timeout_us = s * 1000000 + us;
	return 0;
}

int modbus_set_byte_timeout(modbus_t *line, uint32_t s, uint32_t us)
{
	(void)line;
	w.byte_timeout_us = s * 1000000 + us;
	return 0;
}

int modbus_connect(modbus_t *line)
{
	(void)line;
	if (w.connect_error)
		return failed(w.connect_error);
	w.connections++;
	w.left_over = true; /* from before */
	return 0;
}

void modbus_close(modbus_t *line)
{
	(void)line;
}

void modbus_free(modbus_t *line)
{
	(void)line;
	w.open_lines--;
}

int modbus_flush(modbus_t *line)
{
	(void)line;
	w.left_over = false;
	return 0;
}

static int transfer(void)
{
	int error = w.left_over ? EMBBADCRC : w.answer_error; /* libmodbus reads old bytes first */

	w.now_ns += w.request_ns + (error == ETIMEDOUT ? (int64_t)w.response_timeout_us * 1000 : w.answer_ns);
	return error ? failed(error) : 0;
}

int modbus_read_registers(modbus_t *line, int at, int n, uint16_t *words)
{
	(void)line;
	if (transfer() < 0)
		return -1;
	if (at == 0x72) {
		assert_int_equal(n, 1);
		if (w.mag_error)
			return failed(w.mag_error);
		*words = (uint16_t)w.mag_type;
		return 1;
	}
	assert_int_equal(at, 0x34);
	assert_int_equal(n, 13);
	if (w.missing_reads > 0 && w.missing_reads--)
		return failed(ETIMEDOUT);
	if (++w.reads == w.bad_read) {
		w.left_over = true; /* the rest of the answer is on its way */
		return failed(EMBBADCRC);
	}
	memcpy(words, w.words, sizeof(w.words));
	w.words[0] = (int16_t)(w.words[0] ^ w.live); /* the last digit of an accelerometer changes always */
	return n;
}

int modbus_write_register(modbus_t *line, int at, const uint16_t value)
{
	(void)line;
	if (transfer() < 0)
		return -1;
	assert_true(w.write_count < WRITES);
	w.writes[w.write_count].at = at;
	w.writes[w.write_count++].value = value;
	w.left_over = at == 0x1F; /* another answer, of the sensor's own accord */
	return 1;
}

/* ---- the gateway's side ------------------------------------------------------------------------------------------ */

/* At 115200 Bd a request takes 0.7 ms, an answer 2.7 ms and the sensor 3 ms before it. */
static int set_up(void **state)
{
	(void)state;
	w = (struct world){
		.mag_type = 3, .live = true, .now_ns = 1000LL * MS, .request_ns = 694444, .answer_ns = 5690972};
	w.words[2] = 2048;
	port = NULL;
	return 0;
}

static void run(unsigned waits);

static void close_sensor(void)
{
	run(0); /* the thread ends */
	imu_close(port);
	port = NULL;
}

static int tear_down(void **state)
{
	(void)state;
	if (port)
		close_sensor();
	assert_int_equal(w.open_lines, 0);
	return 0;
}

static void open_sensor(const char *options, const struct imu_settings *settings)
{
	char src[80], error[200] = "";

	snprintf(src, sizeof(src), "wt901:/dev/ttyUSB7%s", options);
	if (imu_open(src, settings, &port, error, sizeof(error)) < 0 || error[0])
		fail_msg("%s", error);
}

/* The thread runs for this number of waits and disconnects. Connecting again takes three of them. */
static void run(unsigned waits)
{
	w.waits = waits;
	((struct imu_thread *)w.thread_ctx)->stop = false;
	w.thread(w.thread_ctx);
}

static unsigned count_samples(void)
{
	struct imu_sample sample;
	unsigned n = 0;

	for (int result; (result = imu_read(port, &sample)) != 0;)
		n += result == 1;
	return n;
}

static void assert_near(double value, double expected, double tolerance)
{
	if (!(fabs(value - expected) <= tolerance))
		fail_msg("%.9g, expected %.9g", value, expected);
}

/* ---- the line ---------------------------------------------------------------------------------------------------- */

/* Timeouts: 8 characters of the request, 3 ms until the sensor answers, 40 ms for a USB adapter; 3.5 characters, 40
 * ms. */
static void test_address_baud_rate_and_timeouts_of_the_line(void **state)
{
	(void)state;
	open_sensor("", NULL);
	assert_int_equal(w.baud, 9600);
	assert_int_equal(w.address, 0x50);
	assert_near(w.response_timeout_us, 8 * 10e6 / 9600 + 43000, 1);
	assert_near(w.byte_timeout_us, 3.5 * 10e6 / 9600 + 40000, 1);
	close_sensor();
	open_sensor(",baud=230400,address=0x51", NULL);
	assert_int_equal(w.baud, 230400);
	assert_int_equal(w.address, 0x51);
	assert_near(w.byte_timeout_us, 1750 + 40000, 1); /* above 19200 Bd */
}

/* 39 characters of 10 bits, twice the silence, 3 ms until the sensor answers. */
static void test_the_rate_is_limited_by_the_baud_rate(void **state)
{
	static const struct {
		const char *options;
		double hz;
	} rates[] = {{"", 19.64}, {",baud=38400", 60.04}, {",baud=115200", 100}};
	struct imu_settings settings = IMU_SETTINGS_DEFAULTS;

	(void)state;
	for (size_t i = 0; i < sizeof(rates) / sizeof(*rates); i++) {
		open_sensor(rates[i].options, NULL);
		assert_near(port->rate_hz, rates[i].hz, 0.01);
		close_sensor();
	}
	settings.rate_hz = 1000;
	open_sensor(",baud=115200", &settings);
	assert_near(port->rate_hz, 101.2, 0.1);
}

static void test_samples_have_their_rate_and_the_time_between_request_and_answer(void **state)
{
	struct imu_sample sample;
	uint64_t first_us = 0;
	double asked_us;

	(void)state;
	open_sensor(",baud=115200", NULL);
	asked_us = 1e-3 * (double)w.now_ns;
	run(30);
	for (int n = 0; n < 30; n++) {
		assert_int_equal(imu_read(port, &sample), 1);
		if (n == 0)
			first_us = sample.t_us;
		assert_near((double)(sample.t_us - first_us), 1e4 * n, 1);
	}
	/* after 8 characters of the request and before 31 of the answer, of 86.8 us: 694 us to 3694 us */
	assert_near((double)first_us - asked_us, (694.4 + 3694.4) / 2, 2);
	assert_near((double)port->health.rate_hz, 100, 0.01);
}

static void test_a_sensor_that_does_not_answer_is_refused_after_three_attempts(void **state)
{
	char error[200] = "";

	(void)state;
	w.answer_error = ETIMEDOUT;
	assert_int_equal(imu_open("wt901:/dev/ttyUSB7,address=81", NULL, &port, error, sizeof(error)), -ETIMEDOUT);
	assert_non_null(strstr(error, "no answer from address 51h at 9600 Bd"));
	assert_int_equal(w.connections, 3);
	w.connect_error = EACCES;
	assert_int_equal(imu_open("wt901:/dev/ttyUSB7", NULL, &port, error, sizeof(error)), -EACCES);
	assert_non_null(strstr(error, "dialout"));
	w = (struct world){.no_line = true};
	assert_int_equal(imu_open("wt901:/dev/ttyUSB7", NULL, &port, error, sizeof(error)), -EINVAL);
	w = (struct world){.thread_error = EAGAIN};
	assert_int_equal(imu_open("wt901:/dev/ttyUSB7", NULL, &port, error, sizeof(error)), -EAGAIN);
	assert_string_equal(error, "cannot start the sensor's thread: Resource temporarily unavailable");
	assert_null(port);
}

/* ---- settings ---------------------------------------------------------------------------------------------------- */

static void assert_write(size_t i, int at, int value)
{
	assert_true(i < w.write_count);
	assert_int_equal(w.writes[i].at, at);
	assert_int_equal(w.writes[i].value, value);
}

static void test_the_bandwidth_is_unlocked_and_written_and_never_saved(void **state)
{
	struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	char error[100];

	(void)state;
	open_sensor(",baud=115200", NULL);
	assert_int_equal(w.write_count, 2);
	assert_write(0, 0x69, 0xB588);
	assert_write(1, 0x1F, 2); /* half of 100 Hz: 98 Hz is the smallest that is enough */
	settings.bandwidth_hz = 20;
	assert_int_equal(port->ops->configure(port, &settings, 0, error, sizeof(error)), 0);
	run(5);
	assert_int_equal(w.write_count, 4);
	assert_write(2, 0x69, 0xB588);
	assert_write(3, 0x1F, 4); /* 20 Hz */
}

static void test_the_narrowest_bandwidth_that_is_enough_is_chosen(void **state)
{
	static const struct {
		double hz;
		int code;
	} cases[] = {{1, 6}, {5, 6}, {5.1, 5}, {10, 5}, {42, 3}, {43, 2}, {98, 2}, {188, 1}, {189, 0}, {256, 0},
		{400, 0}, {188.5, 0}, {98.5, 1}, {42.5, 2}, {20.5, 3}, {20, 4}, {10.5, 4}};

	(void)state;
	for (size_t i = 0; i < sizeof(cases) / sizeof(*cases); i++) {
		struct imu_settings settings = IMU_SETTINGS_DEFAULTS;

		settings.bandwidth_hz = cases[i].hz;
		w.write_count = 0;
		open_sensor("", &settings);
		assert_write(1, 0x1F, cases[i].code);
		close_sensor();
	}
}

static void test_a_range_that_it_does_not_have_is_refused(void **state)
{
	struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	char error[100];

	(void)state;
	open_sensor("", NULL);
	settings.accel_range_g = 16.1;
	assert_int_equal(port->ops->configure(port, &settings, 1, error, sizeof(error)), -EINVAL);
	assert_string_equal(error, "wt901: range too wide: the sensor has 2000 deg/s and 16 g");
	settings.accel_range_g = 16;
	assert_int_equal(port->ops->configure(port, &settings, 1, error, sizeof(error)), 0);
	settings.gyro_range_deg_s = 2001;
	assert_int_equal(port->ops->configure(port, &settings, 1, error, sizeof(error)), -EINVAL);
}

/* Registers 34h to 40h: acceleration, rate, field, three angles that are not used, temperature. At its end a word of
 * the first two is saturated. */
static void test_each_word_has_its_place_its_unit_and_its_end(void **state)
{
	const double g = 16 * 9.80665 / 32768, dps = 2000 / 32768.0 * 3.14159265358979323846 / 180, ut = 0.013;
	const double unit[13] = {g, g, g, dps, dps, dps, ut, ut, ut, 0, 0, 0, 0.01};
	static const int16_t values[] = {1000, -1000, 32766, -32767, INT16_MAX, INT16_MIN};

	(void)state;
	for (int i = 0; i < 13; i++)
		for (size_t k = 0; k < sizeof(values) / sizeof(values[0]); k++) {
			const double expected = unit[i] * values[k];
			struct imu_sample s;

			memset(w.words, 0, sizeof(w.words));
			w.words[i] = values[k];
			w.live = i != 0;
			w.write_count = 0;
			open_sensor(",baud=115200", NULL);
			run(0);
			assert_int_equal(imu_read(port, &s), 1);
			const double found[13] = {s.accel_m_s2.x, s.accel_m_s2.y, s.accel_m_s2.z, s.gyro_rad_s.x,
				s.gyro_rad_s.y, s.gyro_rad_s.z, s.mag_uT.x, s.mag_uT.y, s.mag_uT.z, 0, 0, 0,
				s.temperature_degC};

			for (int other = 0; other < 13; other++)
				assert_near(
					found[other], other == i ? expected : 0, 1e-9 + (other == 0 ? 1.01 * g : 0));
			assert_int_equal(!!(s.flags & SAMPLE_SATURATED), i < 6 && k >= 4);
			close_sensor();
		}
}

/* ---- faults ------------------------------------------------------------------------------------------------------ */

static void test_two_answers_that_are_missing_are_a_fault_and_one_is_not(void **state)
{
	struct imu_sample sample;

	(void)state;
	open_sensor(",baud=115200", NULL);
	run(10);
	assert_int_equal(count_samples(), 11);
	w.bad_read = w.reads + 3;
	run(10); /* seven reads, and one wait until the line is silent: six */
	assert_int_equal(count_samples(), 6);
	assert_int_equal(port->health.bus_errors, 1);
	assert_int_equal(port->health.restarts, 0);
	w.answer_error = ETIMEDOUT;
	run(3);
	assert_int_equal(imu_read(port, &sample), -EIO);
	assert_int_equal(port->health.fault, IMU_FAULT_SILENT);
	assert_int_equal(port->health.fault_chip, IMU_CHIP_GYRO);
	w.answer_error = 0;
	run(10);
	assert_true(count_samples() > 0);
	assert_int_equal(port->health.fault, IMU_FAULT_NONE);
	assert_true(port->health.restarts > 0);
}

/* Two in a row, exactly: a third answer that comes is too late. */
static void test_the_second_answer_that_is_missing_is_the_fault(void **state)
{
	(void)state;
	open_sensor(",baud=115200", NULL);
	w.missing_reads = 1;
	run(20);
	assert_true(count_samples() > 0);
	assert_int_equal(port->health.bus_errors, 1);
	assert_int_equal(port->health.restarts, 0);
	w.missing_reads = 2;
	run(20);
	assert_true(count_samples() > 0);
	assert_int_equal(port->health.bus_errors, 3);
	assert_true(port->health.restarts > 0);
}

static void test_an_answer_that_is_not_valid_is_never_a_sample(void **state)
{
	static const int errors[] = {EMBBADCRC, EMBBADSLAVE, EMBBADDATA, EMBXILADD, EMBXSBUSY, ETIMEDOUT};

	(void)state;
	for (size_t i = 0; i < sizeof(errors) / sizeof(*errors); i++) {
		open_sensor(",baud=115200", NULL);
		w.answer_error = errors[i];
		run(10);
		assert_int_equal(count_samples(), 0);
		assert_int_equal(port->health.fault, IMU_FAULT_SILENT);
		w.answer_error = 0;
		close_sensor();
	}
}

/* An error of the device itself, not of an answer: at once, without waiting for a second one. */
static void test_an_unplugged_adapter_is_a_fault_at_once_and_is_opened_again(void **state)
{
	unsigned connections;

	(void)state;
	open_sensor(",baud=115200", NULL);
	connections = w.connections;
	w.answer_error = EIO;
	run(0);
	assert_int_equal(count_samples(), 0);
	assert_int_equal(port->health.fault, IMU_FAULT_SILENT);
	assert_int_equal(port->health.bus_errors, 1);
	w.connect_error = ENOENT;
	run(3);
	assert_int_equal(w.connections, connections);
	w.connect_error = w.answer_error = 0;
	run(10);
	assert_int_equal(w.connections, connections + 1);
	assert_true(count_samples() > 0);
	assert_int_equal(port->health.fault, IMU_FAULT_NONE);
}

/* A device that is unplugged and plugged in again between two requests gets a new number: the old line stays dead. */
static void test_after_a_fault_of_the_line_it_is_opened_again_although_reading_would_work(void **state)
{
	unsigned connections;

	(void)state;
	open_sensor(",baud=115200", NULL);
	connections = w.connections;
	w.answer_error = EIO;
	w.good_from = 15; /* waits before the end: the first request fails, and none behind */
	run(15);
	assert_int_equal(w.connections, connections + 1);
	assert_true(count_samples() > 0);
}

static void test_thirty_equal_measurements_are_a_fault_until_they_change(void **state)
{
	(void)state;
	open_sensor(",baud=115200", NULL);
	w.live = false;
	run(28);
	assert_int_equal(count_samples(), 29);
	assert_int_equal(port->health.fault, IMU_FAULT_NONE);
	run(5);
	assert_int_equal(count_samples(), 0);
	assert_int_equal(port->health.fault, IMU_FAULT_FROZEN);
	w.live = true;
	w.words[3]++;
	run(5);
	assert_int_equal(count_samples(), 3);
	assert_int_equal(port->health.fault, IMU_FAULT_NONE);
}

/* Any exception of Modbus is an answer of the sensor; a bad answer, or an error of the device, is not. */
static void test_firmware_without_the_register_of_the_type_has_the_usual_magnetometer(void **state)
{
	static const struct {
		int error;
		bool answered;
	} cases[] = {{EMBXILFUN, true}, {EMBXILADD, true}, {EMBXGTAR, true}, {MODBUS_ENOBASE, false},
		{EMBBADCRC, false}, {ETIMEDOUT, false}, {EIO, false}};

	(void)state;
	for (size_t i = 0; i < sizeof(cases) / sizeof(*cases); i++) {
		char error[200] = "";

		w.mag_type = 2;
		w.mag_error = cases[i].error;
		assert_int_equal(imu_open("wt901:/dev/ttyUSB7,baud=115200", NULL, &port, error, sizeof(error)),
			cases[i].answered ? 0 : -cases[i].error);
		if (cases[i].answered) {
			struct imu_sample sample;

			w.words[6] = 1000;
			run(3);
			assert_int_equal(imu_read(port, &sample), 1);
			assert_near(vec3_norm(sample.mag_uT), 13, 1e-9);
			close_sensor();
		} else {
			assert_null(port);
		}
	}
}

int main(void)
{
#define LINE_TEST(f) cmocka_unit_test_setup_teardown(f, set_up, tear_down)
	const struct CMUnitTest tests[] = {
		LINE_TEST(test_address_baud_rate_and_timeouts_of_the_line),
		LINE_TEST(test_the_rate_is_limited_by_the_baud_rate),
		LINE_TEST(test_samples_have_their_rate_and_the_time_between_request_and_answer),
		LINE_TEST(test_a_sensor_that_does_not_answer_is_refused_after_three_attempts),
		LINE_TEST(test_the_bandwidth_is_unlocked_and_written_and_never_saved),
		LINE_TEST(test_the_narrowest_bandwidth_that_is_enough_is_chosen),
		LINE_TEST(test_a_range_that_it_does_not_have_is_refused),
		LINE_TEST(test_each_word_has_its_place_its_unit_and_its_end),
		LINE_TEST(test_two_answers_that_are_missing_are_a_fault_and_one_is_not),
		LINE_TEST(test_the_second_answer_that_is_missing_is_the_fault),
		LINE_TEST(test_an_answer_that_is_not_valid_is_never_a_sample),
		LINE_TEST(test_an_unplugged_adapter_is_a_fault_at_once_and_is_opened_again),
		LINE_TEST(test_after_a_fault_of_the_line_it_is_opened_again_although_reading_would_work),
		LINE_TEST(test_thirty_equal_measurements_are_a_fault_until_they_change),
		LINE_TEST(test_firmware_without_the_register_of_the_type_has_the_usual_magnetometer),
	};

	return cmocka_run_group_tests_name("wt901_port", tests, count_descriptors, no_descriptor_is_left);
}
