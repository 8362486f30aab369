/* The port of a board on I2C, its data-ready line (drdy=GPIOCHIP:LINE) and its configuration file. libgpiod is
 * simulated by tests/unit/gpiod/. The driver's thread runs within run(), on simulated chips, in a time that moves only
 * here. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "drivers/imu/imu_thread.h"
#include "drivers/imu/source.h"
#include "drivers/imu/pololu/i2c_imu.h"
#include "drivers/imu/sim/sim_chips.h"
#include "tests/unit/descriptors.h"
#include "tests/unit/gpiod/gpiod_stub.h"

enum { LATENCY_NS = 20000 };

static struct world {
	struct sim_board *sim;
	int64_t now_ns, edge_ns; /* edge_ns: the sample of the last edge */
	void *(*thread)(void *);
	void *thread_ctx;
	unsigned waits;
	int thread_error;
	const char *path; /* of the bus */
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

int clock_nanosleep(clockid_t clock, int flags, const struct timespec *t, struct timespec *left)
{
	const int64_t ns = t->tv_sec * 1000000000 + t->tv_nsec;

	(void)clock, (void)flags, (void)left;
	if (ns > w.now_ns)
		w.now_ns = ns;
	return 0;
}

int pthread_join(pthread_t thread, void **result)
{
	(void)thread, (void)result;
	return 0;
}

/* Each sample of the gyro raises the line; 20 us later the thread wakes. */
int ppoll(struct pollfd *fds, nfds_t n, const struct timespec *timeout, const sigset_t *mask)
{
	const int64_t end_ns = w.now_ns + timeout->tv_sec * 1000000000 + timeout->tv_nsec;
	double newest_ns;

	(void)mask;
	assert_in_range(n, 1, 2);
	if (w.waits-- == 0)
		((struct imu_thread *)w.thread_ctx)->stop = true;
	for (nfds_t i = 0; i < n; i++)
		fds[i].revents = 0;
	for (; w.now_ns < end_ns; w.now_ns += w.now_ns + 10000 < end_ns ? 10000 : end_ns - w.now_ns) {
		sim_board_taken(w.sim, IMU_CHIP_GYRO, &newest_ns);
		if (n == 1 || (int64_t)newest_ns <= w.edge_ns || w.now_ns < (int64_t)newest_ns + LATENCY_NS)
			continue;
		assert_int_equal(fds[1].fd, GPIOD_STUB_FD);
		w.edge_ns = (int64_t)newest_ns;
		gpiod_stub.edge_ns = w.edge_ns + LATENCY_NS;
		fds[1].revents = POLLIN;
		return 1;
	}
	return 0;
}

int i2c_dev_open(const char *path, struct i2c_bus **bus, char *error, size_t error_size)
{
	(void)error, (void)error_size;
	w.path = strdup(path);
	*bus = sim_board_bus(w.sim);
	return 0;
}

/* ---- the gateway's side ------------------------------------------------------------------------------------------ */

static int start(struct gpiod_stub gpio, const char *drdy_chip, char *error, size_t error_size)
{
	const struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	const struct i2c_imu_config driver = {.name = "i2c:test", .drdy_chip = drdy_chip, .drdy_line = GPIOD_STUB_LINE};
	struct sim_config config = {.board = "v3",
		.signal = signal_find("rest"),
		.sensor = *sensor_preset("lsm303dlhc_l3gd20"),
		.now_ns = i2c_imu_now_ns};

	gpiod_stub = gpio;
	w = (struct world){.now_ns = 1000000000};
	assert_int_equal(sim_board_open(&config, &w.sim), 0);
	return i2c_imu_start(sim_board_bus(w.sim), &driver, &settings, &port, error, error_size);
}

/* As --imu i2c:ARGS does. */
static int open_as(const char *args, char *error, size_t error_size)
{
	const struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	struct sim_config config = {.board = "v3",
		.signal = signal_find("rest"),
		.sensor = *sensor_preset("lsm303dlhc_l3gd20"),
		.now_ns = i2c_imu_now_ns};
	char copy[200];

	snprintf(copy, sizeof(copy), "%s", args);
	gpiod_stub = (struct gpiod_stub){0};
	w = (struct world){.now_ns = 1000000000};
	assert_int_equal(sim_board_open(&config, &w.sim), 0);
	return i2c_open(copy, &settings, &port, error, error_size);
}

static void run(unsigned waits)
{
	w.waits = waits;
	((struct imu_thread *)w.thread_ctx)->stop = false;
	w.thread(w.thread_ctx);
}

static void test_the_line_is_requested_and_its_interrupt_enabled_in_the_gyro(void **state)
{
	char error[200];

	(void)state;
	assert_int_equal(start((struct gpiod_stub){0}, "gpiochip3", error, sizeof(error)), 0);
	assert_int_equal(gpiod_stub.requests, 1);
	run(20);
	assert_int_equal(sim_board_registers(w.sim, IMU_CHIP_GYRO)[0x22], 0x08); /* I2_DRDY */
	imu_close(port);
	assert_int_equal(gpiod_stub.open_objects, 0);
}

static void test_each_edge_is_read_and_times_its_sample(void **state)
{
	struct imu_sample sample;
	char error[200];
	uint64_t last_us = 0;
	int n = 0;

	(void)state;
	assert_int_equal(start((struct gpiod_stub){0}, "gpiochip3", error, sizeof(error)), 0);
	run(2000);
	while (imu_read(port, &sample) == 1) {
		double newest_ns, periods;

		sim_board_taken(w.sim, IMU_CHIP_GYRO, &newest_ns);
		periods = (newest_ns - 1e3 * (double)sample.t_us) / 1e7; /* 100 Hz */
		if (n++ < 50)
			continue;
		assert_true(periods - (double)(int64_t)(periods + 0.5) < 0.01);
		assert_true(periods - (double)(int64_t)(periods + 0.5) > -0.01);
		assert_true(last_us == 0 || sample.t_us - last_us < 10100);
		last_us = sample.t_us;
	}
	assert_true(n > 100);
	assert_true(gpiod_stub.events_read > 100);
	imu_close(port);
}

static void assert_refused(struct gpiod_stub gpio, int result)
{
	char error[200] = "";

	assert_int_equal(start(gpio, "gpiochip3", error, sizeof(error)), result);
	assert_non_null(strstr(error, "data-ready line gpiochip3:17"));
	assert_non_null(strstr(error, "gpioinfo"));
	assert_int_equal(gpiod_stub.open_objects, 0);
}

static void test_a_line_that_cannot_be_used_is_refused(void **state)
{
	(void)state;
	assert_refused((struct gpiod_stub){.no_chip = true}, -ENOENT);
	assert_refused((struct gpiod_stub){.no_line = true}, -EINVAL);
	assert_refused((struct gpiod_stub){.busy = true}, -EBUSY);
}

static void test_a_chip_has_a_name_a_number_and_a_path(void **state)
{
	static const char *const names[] = {"gpiochip3", "3", "/dev/gpiochip3"};
	char error[200];

	(void)state;
	for (size_t i = 0; i < sizeof(names) / sizeof(names[0]); i++) {
		assert_int_equal(start((struct gpiod_stub){0}, names[i], error, sizeof(error)), 0);
		imu_close(port);
		assert_int_equal(gpiod_stub.open_objects, 0);
	}
}

/* 8192 bytes over 100 kHz take a second, in which the sensor has not failed. */
static void test_a_bmi270_gets_its_configuration_file_and_has_time_for_it(void **state)
{
	static const uint8_t zeroes[8192];
	const struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	char path[] = "/tmp/imu9-bmi270-XXXXXX", error[300] = "";
	struct i2c_imu_config driver = {.name = "i2c:test", .firmware = path};
	struct sim_config config = {.board = "bmi270",
		.signal = signal_find("rest"),
		.sensor = *sensor_preset("lsm303dlhc_l3gd20"),
		.now_ns = i2c_imu_now_ns};
	int fd = mkstemp(path);
	struct imu_sample sample;

	(void)state;
	assert_int_equal(write(fd, zeroes, sizeof(zeroes)), sizeof(zeroes));
	close(fd);
	w = (struct world){.now_ns = 1000000000};
	assert_int_equal(sim_board_open(&config, &w.sim), 0);
	if (i2c_imu_start(sim_board_bus(w.sim), &driver, &settings, &port, error, sizeof(error)) < 0)
		fail_msg("%s", error);
	remove(path);
	assert_true(port->silence_us >= 2000000);
	assert_string_equal(port->name, "i2c:test BMI270");
	assert_string_equal(port->notes, "i2c:test: the BMI270 has no magnetometer: the heading is not known");
	run(200);
	assert_int_equal(imu_read(port, &sample), 1);
	assert_true(sample.accel_m_s2.z > 9.5 && sample.accel_m_s2.z < 10.1);
	imu_close(port);
}

static void test_the_options_of_the_bus_choose_line_and_stub(void **state)
{
	static const struct {
		const char *args;
		unsigned requests;
		bool fifo;
	} cases[] = {{"/dev/i2c-1", 0, true}, {"/dev/i2c-1,drdy=gpiochip3:17", 1, true}, {"/dev/i2c-1,stub", 0, false},
		{"/dev/i2c-1,drdy=3:017", 1, true}};
	char error[300] = "";

	(void)state;
	for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
		if (open_as(cases[i].args, error, sizeof(error)) < 0)
			fail_msg("%s", error);
		assert_string_equal(w.path, "/dev/i2c-1");
		assert_string_equal(port->name, "i2c:/dev/i2c-1 v3");
		assert_int_equal(port->uncalibrated, 7); /* gyro, accelerometer, magnetometer */
		assert_int_equal(gpiod_stub.requests, cases[i].requests);
		run(20);
		/* FIFO_EN in CTRL5 */
		assert_int_equal(sim_board_registers(w.sim, IMU_CHIP_GYRO)[0x24] >> 6 & 1, cases[i].fifo);
		imu_close(port);
		free((void *)w.path);
	}
}

static void test_options_of_the_bus_that_are_none_are_refused(void **state)
{
	static const char *const options[] = {"drdy", "drdy=gpiochip3", "drdy=:17",
		"drdy=gpiochip3:", "drdy=gpiochip3:x", "drdy=gpiochip3:17x", "drdy=gpiochip3:-1", "config=", "stub=1",
		"stubs", ""};
	char args[100], error[300], quoted[60];
	const struct imu_settings settings = IMU_SETTINGS_DEFAULTS;

	(void)state;
	for (size_t i = 0; i < sizeof(options) / sizeof(options[0]); i++) {
		snprintf(args, sizeof(args), "/dev/i2c-1,%s", options[i]);
		assert_int_equal(i2c_open(args, &settings, &port, error, sizeof(error)), -EINVAL);
		snprintf(quoted, sizeof(quoted), "i2c: unknown option '%.10s", options[i]);
		assert_non_null(strstr(error, strncmp(options[i], "drdy=", 5) ? quoted : "i2c: unknown option 'drdy="));
	}
	snprintf(args, sizeof(args), "/dev/i2c-1,drdy=gpiochip3:17,stub,config=/x");
	assert_int_equal(i2c_open(args, &settings, NULL, error, sizeof(error)), 0); /* --check */
}

static void test_without_a_thread_there_is_no_sensor(void **state)
{
	const struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	const struct i2c_imu_config driver = {.name = "i2c:test"};
	struct sim_config config = {.board = "v3",
		.signal = signal_find("rest"),
		.sensor = *sensor_preset("lsm303dlhc_l3gd20"),
		.now_ns = i2c_imu_now_ns};
	char error[200] = "";

	(void)state;
	w = (struct world){.now_ns = 1000000000, .thread_error = EAGAIN};
	assert_int_equal(sim_board_open(&config, &w.sim), 0);
	assert_int_equal(i2c_imu_start(sim_board_bus(w.sim), &driver, &settings, &port, error, sizeof(error)), -EAGAIN);
	assert_string_equal(error, "cannot start the sensor's thread: Resource temporarily unavailable");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_line_is_requested_and_its_interrupt_enabled_in_the_gyro),
		cmocka_unit_test(test_each_edge_is_read_and_times_its_sample),
		cmocka_unit_test(test_a_bmi270_gets_its_configuration_file_and_has_time_for_it),
		cmocka_unit_test(test_the_options_of_the_bus_choose_line_and_stub),
		cmocka_unit_test(test_options_of_the_bus_that_are_none_are_refused),
		cmocka_unit_test(test_without_a_thread_there_is_no_sensor),
		cmocka_unit_test(test_a_line_that_cannot_be_used_is_refused),
		cmocka_unit_test(test_a_chip_has_a_name_a_number_and_a_path),
	};

	return cmocka_run_group_tests_name("i2c_drdy", tests, count_descriptors, no_descriptor_is_left);
}
