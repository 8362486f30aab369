#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <errno.h>
#include <math.h>
#include <poll.h>
#include <string.h>
#include <time.h>

#include "drivers/imu/source.h"
#include "drivers/ports/imu.h"
#include "tests/unit/descriptors.h"

static double now_s(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static struct imu_port *opened(const char *src)
{
	struct imu_port *port;
	char error[256] = "";

	if (imu_open(src, NULL, &port, error, sizeof error) != 0 || error[0])
		fail_msg("%s", error);
	return port;
}

static void wait_and_read(struct imu_port *port, struct imu_sample *sample)
{
	struct pollfd fd = {port->fd, POLLIN, 0};

	do
		assert_int_equal(poll(&fd, 1, 120000), 1);
	while (imu_read(port, sample) == 0);
}

static void test_the_default_is_the_robot_on_the_square_at_100_hz(void **state)
{
	struct imu_port *port = opened("sim");

	(void)state;
	assert_string_equal(port->name, "sim:square v3");
	assert_true(port->rate_hz == 100);
	imu_close(port);
}

static void test_samples_have_the_requested_rate_in_real_time(void **state)
{
	enum { N = 60 };
	struct imu_port *port = opened("sim:rest,rate=200");
	struct imu_sample sample;
	uint64_t last_us = 0;
	int in_time = 0;

	(void)state;
	for (int i = 0; i < N; i++) {
		wait_and_read(port, &sample);
		assert_true(now_s() >= 1e-6 * (double)sample.t_us);
		/* the oscillator has an error of 0.4 %, and the sample clock is not locked yet */
		in_time += i > 0 && sample.t_us - last_us >= 4500 && sample.t_us - last_us <= 5500;
		last_us = sample.t_us;
	}
	assert_true(in_time > N / 2); /* a busy machine delays some */
	imu_close(port);
}

static void test_at_rest_the_sensor_measures_gravity_and_its_noise(void **state)
{
	struct imu_port *port = opened("sim:rest,rate=800");
	struct vec3 gyro = {0, 0, 0}, accel = {0, 0, 0};
	double squares = 0;
	struct imu_sample sample;

	(void)state;
	for (int i = 0; i < 200; i++) {
		wait_and_read(port, &sample);
		gyro = vec3_add(gyro, vec3_scale(5e-3, sample.gyro_rad_s));
		accel = vec3_add(accel, vec3_scale(5e-3, sample.accel_m_s2));
		squares += vec3_dot(sample.gyro_rad_s, sample.gyro_rad_s);
	}
	assert_true(vec3_norm(gyro) < 0.01);
	assert_true(vec3_norm(vec3_sub(accel, (struct vec3){0, 0, 9.81})) < 0.05);
	assert_true(squares > 0);
	imu_close(port);
}

static void test_a_self_test_at_the_start_is_run_when_the_settings_say_so(void **state)
{
	struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	struct imu_sample sample;
	struct imu_port *port;
	char error[256];

	(void)state;
	for (settings.self_test = 0; settings.self_test <= 1; settings.self_test++) {
		assert_int_equal(imu_open("sim:rest,rate=800,board=v5", &settings, &port, error, sizeof error), 0);
		wait_and_read(port, &sample);
		assert_int_equal(port->health.self_test, settings.self_test ? 0x03 : 0); /* gyro and accelerometer */
		imu_close(port);
	}
}

/* The centripetal acceleration of a sensor 5 cm ahead of the axis points back: -omega^2 * 0.05 m. */
static void test_the_sensor_is_5_cm_ahead_of_the_reference_point(void **state)
{
	struct imu_port *port = opened("sim:turntable,rate=800");
	struct vec3 accel = {0, 0, 0};
	struct imu_sample sample;
	double omega_rad_s = 0;

	(void)state;
	for (int i = 0; i < 100; i++) {
		wait_and_read(port, &sample);
		omega_rad_s += 0.01 * sample.gyro_rad_s.z;
		accel = vec3_add(accel, vec3_scale(0.01, sample.accel_m_s2));
	}
	assert_true(fabs(omega_rad_s) > 3);
	assert_true(fabs(accel.x + 0.05 * omega_rad_s * omega_rad_s) < 0.1);
	assert_true(fabs(accel.y) < 0.1);
	imu_close(port);
}

/* So long may a busy machine stall a simulation. */
static void test_a_simulated_sensor_is_silent_after_10_s_at_any_rate(void **state)
{
	static const char *const rates[] = {"sim:rest,rate=800", "sim:rest", "sim:rest,rate=12.5"};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct imu_port *port = opened(rates[i]);

		assert_int_equal(port->silence_us, 10000000);
		imu_close(port);
	}
}

static void test_another_sensor_is_silent_after_ten_intervals_and_at_least_a_tenth_of_a_second(void **state)
{
	struct imu_port port = {0};

	(void)state;
	source_use_rate(&port, 12.5);
	assert_true(port.rate_hz == 12.5);
	assert_int_equal(port.silence_us, 800000);
	source_use_rate(&port, 800);
	assert_int_equal(port.silence_us, 100000);
}

/* As shipped it has the bias of the preset, and says that it is uncalibrated; calibrated it has none. */
static void test_an_uncalibrated_sensor_has_its_bias(void **state)
{
	(void)state;
	for (int uncalibrated = 0; uncalibrated < 2; uncalibrated++) {
		struct imu_port *port = opened(uncalibrated ? "sim:rest,rate=800,uncalibrated" : "sim:rest,rate=800");
		struct vec3 accel = {0, 0, 0};
		struct imu_sample sample;

		assert_int_equal(port->uncalibrated, uncalibrated ? IMU_UNCALIBRATED : 0);
		for (int i = 0; i < 100; i++) {
			wait_and_read(port, &sample);
			accel = vec3_add(accel, vec3_scale(0.01, sample.accel_m_s2));
		}
		assert_int_equal(vec3_norm(vec3_sub(accel, (struct vec3){0, 0, 9.81})) > 0.1, uncalibrated);
		imu_close(port);
	}
}

static void test_an_unknown_scenario_or_option_is_refused_with_what_to_use(void **state)
{
	const char *const bad[][2] = {{"sim:circle", "use one of square, boat, roll_step, rest"},
		{"sim:boat,speed=2", "use rate=HZ, board="}, {"sim:boat,rate=0", "use rate=HZ"},
		{"sim:boat,rate;100", "use rate=HZ"}, {"sim:boat,board;v3", "use rate=HZ"},
		{"sim:boat,rate=100x", "use rate=HZ"}, {"sim:boat,rate=1e9", "the L3GD20H has at most 800 Hz"},
		{"sim:boat,board=v4", "use v0, v1, v2, v3, v5, v6, lsm9ds1, icm20948, icm42688 or bmi270"}};
	struct imu_port *port;
	char error[256];

	(void)state;
	for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
		assert_true(imu_open(bad[i][0], NULL, &port, error, sizeof error) < 0);
		if (!strstr(error, bad[i][1]))
			fail_msg("%s: '%s' does not say '%s'", bad[i][0], error, bad[i][1]);
	}
}

static void test_settings_can_be_changed_while_it_runs(void **state)
{
	struct imu_port *port = opened("sim:rest");
	struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	struct imu_sample sample;
	uint64_t last_us = 0;
	char error[160];

	(void)state;
	wait_and_read(port, &sample);
	settings.rate_hz = 400;
	assert_int_equal(port->ops->configure(port, &settings, 0, error, sizeof error), 0);
	assert_true(port->rate_hz == 400);
	for (int i = 0; i < 60; i++) {
		last_us = sample.t_us;
		wait_and_read(port, &sample);
	}
	assert_in_range(sample.t_us - last_us, 2300, 2700);
	imu_close(port);
}

static void test_settings_that_are_not_possible_are_refused_and_the_old_ones_stay(void **state)
{
	struct imu_port *port = opened("sim:rest,board=v2");
	struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	struct imu_sample sample;
	char error[160];

	(void)state;
	settings.accel_range_g = 32;
	assert_int_equal(port->ops->configure(port, &settings, 0, error, sizeof error), -EINVAL);
	assert_string_equal(error, "accelerometer range 32 g: the LSM303DLHC has at most 16");
	wait_and_read(port, &sample);
	settings = IMU_SETTINGS_DEFAULTS;
	settings.rate_hz = 700;
	assert_int_equal(port->ops->configure(port, &settings, 1, error, sizeof error), 0);
	assert_true(port->rate_hz == 95); /* dry */
	imu_close(port);
}

static void test_a_self_test_on_command_reports_its_result(void **state)
{
	struct imu_port *port = opened("sim:rest");
	struct imu_sample sample;

	(void)state;
	port->ops->self_test(port);
	for (int i = 0; i < 400 && port->health.self_test == 0; i++)
		wait_and_read(port, &sample);
	assert_int_equal(port->health.self_test, 3);
	imu_close(port);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_default_is_the_robot_on_the_square_at_100_hz),
		cmocka_unit_test(test_samples_have_the_requested_rate_in_real_time),
		cmocka_unit_test(test_at_rest_the_sensor_measures_gravity_and_its_noise),
		cmocka_unit_test(test_settings_can_be_changed_while_it_runs),
		cmocka_unit_test(test_settings_that_are_not_possible_are_refused_and_the_old_ones_stay),
		cmocka_unit_test(test_a_self_test_on_command_reports_its_result),
		cmocka_unit_test(test_a_self_test_at_the_start_is_run_when_the_settings_say_so),
		cmocka_unit_test(test_the_sensor_is_5_cm_ahead_of_the_reference_point),
		cmocka_unit_test(test_a_simulated_sensor_is_silent_after_10_s_at_any_rate),
		cmocka_unit_test(test_another_sensor_is_silent_after_ten_intervals_and_at_least_a_tenth_of_a_second),
		cmocka_unit_test(test_an_uncalibrated_sensor_has_its_bias),
		cmocka_unit_test(test_an_unknown_scenario_or_option_is_refused_with_what_to_use),
	};

	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}
