/* The queue between a sensor's thread and its port (drivers/imu/imu_thread.h). The test is the thread and the
 * reader. */
#include <errno.h>
#include <poll.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/prctl.h>

#include <setjmp.h>
/* cmocka needs the headers above */
#include <cmocka.h>

#include "drivers/imu/imu_thread.h"
#include "tests/unit/descriptors.h"

static int set_up(void **state)
{
	struct imu_thread *t = calloc(1, sizeof *t);

	*state = t;
	if (!t || imu_thread_init(t) < 0)
		return -1;
	t->port.rate_hz = 100;
	return 0;
}

static int tear_down(void **state)
{
	imu_thread_release(*state);
	free(*state);
	return 0;
}

static void send_numbered(struct imu_thread *t, uint64_t first_us, unsigned n)
{
	for (unsigned i = 0; i < n; i++)
		imu_thread_send(t, &(struct imu_sample){.t_us = first_us + i});
}

static void assert_reads(struct imu_thread *t, uint64_t first_us, unsigned n)
{
	struct imu_sample sample;

	for (unsigned i = 0; i < n; i++) {
		assert_int_equal(imu_thread_read(&t->port, &sample), 1);
		assert_int_equal(sample.t_us, first_us + i);
	}
}

static void assert_reads_nothing(struct imu_thread *t)
{
	struct imu_sample sample;

	assert_int_equal(imu_thread_read(&t->port, &sample), 0);
}

static bool is_readable(const struct imu_thread *t)
{
	struct pollfd fd = {t->port.fd, POLLIN, 0};

	return poll(&fd, 1, 0) == 1;
}

static void test_samples_are_read_in_the_order_they_were_sent(void **state)
{
	struct imu_thread *t = *state;

	send_numbered(t, 1, 3);
	assert_reads(t, 1, 3);
	assert_reads_nothing(t);
	assert_int_equal(t->port.counters.samples, 3);
	assert_int_equal(t->port.counters.skipped, 0);
}

static void test_the_descriptor_is_readable_from_a_sample_until_a_read_finds_none(void **state)
{
	struct imu_thread *t = *state;

	assert_false(is_readable(t));
	send_numbered(t, 1, 2);
	assert_true(is_readable(t));
	assert_reads(t, 1, 2);
	assert_reads_nothing(t);
	assert_false(is_readable(t));
}

static void test_a_full_queue_keeps_the_oldest_samples_and_counts_those_it_drops(void **state)
{
	struct imu_thread *t = *state;

	send_numbered(t, 1, IMU_THREAD_QUEUE + 5);
	assert_reads(t, 1, IMU_THREAD_QUEUE);
	assert_reads_nothing(t);
	assert_int_equal(t->port.counters.samples, IMU_THREAD_QUEUE);
	assert_int_equal(t->port.counters.skipped, 5);
	assert_string_equal(t->port.last_skip, "the gateway did not read them in time: the queue was full");
}

static void test_a_queue_that_is_just_full_loses_nothing(void **state)
{
	struct imu_thread *t = *state;

	send_numbered(t, 1, IMU_THREAD_QUEUE);
	assert_reads(t, 1, IMU_THREAD_QUEUE);
	assert_int_equal(t->port.counters.skipped, 0);
	assert_string_equal(t->port.last_skip, "");
}

static void test_dropped_samples_are_counted_once(void **state)
{
	struct imu_thread *t = *state;

	send_numbered(t, 1, IMU_THREAD_QUEUE + 2);
	assert_reads(t, 1, 10);
	send_numbered(t, 1000, 10 + 3);
	assert_reads(t, 11, IMU_THREAD_QUEUE - 10);
	assert_reads(t, 1000, 10);
	assert_reads_nothing(t);
	assert_int_equal(t->port.counters.skipped, 2 + 3);
}

static void test_the_queue_wraps_around(void **state)
{
	struct imu_thread *t = *state;

	for (uint64_t round = 0; round < 30; round++) {
		send_numbered(t, 100 * round, 100);
		assert_reads(t, 100 * round, 100);
		assert_reads_nothing(t);
	}
	assert_int_equal(t->port.counters.skipped, 0);
}

static void test_a_sample_brings_the_health_as_it_was_when_it_was_sent(void **state)
{
	struct imu_thread *t = *state;

	t->health.bus_errors = 1;
	send_numbered(t, 1, 1);
	t->health.bus_errors = 2;
	send_numbered(t, 2, 1);
	assert_reads(t, 1, 1);
	assert_int_equal(t->port.health.bus_errors, 1);
	assert_reads(t, 2, 1);
	assert_int_equal(t->port.health.bus_errors, 2);
}

static void test_a_fault_is_read_as_an_error_in_its_place_among_the_samples(void **state)
{
	struct imu_thread *t = *state;
	struct imu_sample sample;

	send_numbered(t, 1, 1);
	t->health.fault = IMU_FAULT_SILENT;
	t->health.fault_chip = IMU_CHIP_ACCEL;
	imu_thread_report(t);
	imu_thread_recovered(t);
	send_numbered(t, 2, 1);
	assert_reads(t, 1, 1);
	assert_int_equal(imu_thread_read(&t->port, &sample), -EIO);
	assert_int_equal(t->port.health.fault, IMU_FAULT_SILENT);
	assert_int_equal(t->port.health.fault_chip, IMU_CHIP_ACCEL);
	assert_reads(t, 2, 1);
	assert_int_equal(t->port.health.fault, IMU_FAULT_NONE);
	assert_int_equal(t->port.health.fault_chip, 0);
}

static void test_a_degraded_sensor_is_reported_without_an_error(void **state)
{
	struct imu_thread *t = *state;

	t->health.degraded = IMU_FAULT_STOPPED;
	imu_thread_report(t);
	assert_reads_nothing(t);
	assert_int_equal(t->port.health.degraded, IMU_FAULT_STOPPED);
	assert_int_equal(t->port.counters.samples, 0);
}

static void test_health_alone_is_sent_when_its_state_has_changed_and_not_for_a_counter(void **state)
{
	struct imu_thread *t = *state;
	uint8_t *const states[] = {&t->health.fault, &t->health.fault_chip, &t->health.degraded,
		&t->health.degraded_chip, &t->health.self_test};

	for (size_t i = 0; i < sizeof states / sizeof *states; i++) {
		*states[i] = 1;
		imu_thread_report(t);
		imu_thread_report(t); /* nothing has changed since */
		assert_int_equal(t->head, i + 1);
	}
	t->health.restarts++;
	imu_thread_report(t);
	assert_int_equal(t->head, 6);
	t->health.bus_errors++;
	t->health.overruns++;
	t->health.rate_hz = 99;
	imu_thread_report(t);
	assert_int_equal(t->head, 6);
}

static void test_a_sample_read_more_than_two_intervals_after_its_time_is_late(void **state)
{
	struct imu_thread *t = *state;
	double age_s = 1e-9 * (double)imu_thread_now_ns() - 1e-6;

	t->port.rate_hz = 1 / age_s; /* one interval old */
	send_numbered(t, 1, 1);
	assert_reads(t, 1, 1);
	assert_int_equal(t->port.counters.late, 0);
	t->port.rate_hz = 4 / age_s; /* four */
	send_numbered(t, 1, 1);
	assert_reads(t, 1, 1);
	assert_int_equal(t->port.counters.late, 1);
}

static void test_the_rate_is_a_smoothed_interval(void **state)
{
	struct imu_thread *t = *state;

	imu_thread_rate(t, &(struct imu_sample){.t_us = 1000000});
	assert_true(t->health.rate_hz == 0);
	imu_thread_rate(t, &(struct imu_sample){.t_us = 1010000});
	assert_float_equal(t->health.rate_hz, 100, 1e-4f);
	imu_thread_rate(t, &(struct imu_sample){.t_us = 1030000}); /* 0.9 * 10 ms + 0.1 * 20 ms */
	assert_float_equal(t->health.rate_hz, 90.90909f, 1e-4f);
}

/* run() has to return: sleeping ends at once. */
static void test_the_back_off_doubles_from_10_ms_to_a_second_until_the_sensor_works(void **state)
{
	static const int64_t waits_ms[] = {10, 20, 40, 80, 160, 320, 640, 1000, 1000};
	struct imu_thread *t = *state;

	t->stop = true;
	for (unsigned i = 0; i < sizeof waits_ms / sizeof *waits_ms; i++) {
		imu_thread_failed(t, IMU_FAULT_SILENT, IMU_CHIP_GYRO);
		assert_int_equal(t->backoff_ns, waits_ms[i] * 1000000);
		assert_int_equal(t->health.restarts, i + 1);
		assert_int_equal(t->health.fault, IMU_FAULT_SILENT);
		assert_int_equal(t->health.fault_chip, IMU_CHIP_GYRO);
	}
	imu_thread_recovered(t);
	imu_thread_failed(t, IMU_FAULT_SILENT, IMU_CHIP_GYRO);
	assert_int_equal(t->backoff_ns, 10000000);
}

static void test_a_failure_ends_the_measurement_of_the_rate(void **state)
{
	struct imu_thread *t = *state;

	t->stop = true;
	imu_thread_rate(t, &(struct imu_sample){.t_us = 1000000});
	imu_thread_rate(t, &(struct imu_sample){.t_us = 1010000});
	imu_thread_failed(t, IMU_FAULT_SILENT, IMU_CHIP_GYRO);
	imu_thread_rate(t, &(struct imu_sample){.t_us = 9000000}); /* the pause is not an interval */
	assert_float_equal(t->health.rate_hz, 100, 1e-4f);
}

static void test_a_wait_ends_with_a_wake_or_one_of_its_descriptors(void **state)
{
	struct imu_thread *t = *state, other = {0};
	struct pollfd fd;

	assert_int_equal(imu_thread_init(&other), 0);
	fd = (struct pollfd){other.port.fd, POLLIN, 0};
	imu_thread_wake(t);
	imu_thread_wait(t, INT64_MAX, &fd, 1);
	assert_int_equal(fd.revents, 0);
	send_numbered(&other, 1, 1);
	imu_thread_wait(t, INT64_MAX, &fd, 1); /* the first wake is used up, or this would not have to wait */
	assert_int_equal(fd.revents, POLLIN);
	imu_thread_release(&other);
}

static char thread_name[16];

static void note_name(struct imu_thread *t)
{
	(void)t;
	prctl(PR_GET_NAME, thread_name);
}

/* As ps -L and top -H show it. */
static void test_the_thread_has_its_name(void **state)
{
	struct imu_thread *t = *state;

	assert_int_equal(imu_thread_start(t, "imu9-name", 0, note_name), 0);
	imu_thread_stop(t);
	assert_string_equal(thread_name, "imu9-name");
}

int main(void)
{
#define THREAD_TEST(f) cmocka_unit_test_setup_teardown(f, set_up, tear_down)
	const struct CMUnitTest tests[] = {
		THREAD_TEST(test_samples_are_read_in_the_order_they_were_sent),
		THREAD_TEST(test_the_descriptor_is_readable_from_a_sample_until_a_read_finds_none),
		THREAD_TEST(test_the_thread_has_its_name),
		THREAD_TEST(test_a_full_queue_keeps_the_oldest_samples_and_counts_those_it_drops),
		THREAD_TEST(test_a_queue_that_is_just_full_loses_nothing),
		THREAD_TEST(test_dropped_samples_are_counted_once),
		THREAD_TEST(test_the_queue_wraps_around),
		THREAD_TEST(test_a_sample_brings_the_health_as_it_was_when_it_was_sent),
		THREAD_TEST(test_a_fault_is_read_as_an_error_in_its_place_among_the_samples),
		THREAD_TEST(test_a_degraded_sensor_is_reported_without_an_error),
		THREAD_TEST(test_health_alone_is_sent_when_its_state_has_changed_and_not_for_a_counter),
		THREAD_TEST(test_a_sample_read_more_than_two_intervals_after_its_time_is_late),
		THREAD_TEST(test_the_rate_is_a_smoothed_interval),
		THREAD_TEST(test_the_back_off_doubles_from_10_ms_to_a_second_until_the_sensor_works),
		THREAD_TEST(test_a_failure_ends_the_measurement_of_the_rate),
		THREAD_TEST(test_a_wait_ends_with_a_wake_or_one_of_its_descriptors),
	};

	return cmocka_run_group_tests_name("imu_thread", tests, count_descriptors, no_descriptor_is_left);
}
