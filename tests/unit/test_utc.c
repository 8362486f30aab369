/* UTC of the samples: gateway/utc.h. Days by python's datetime. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include "gateway/canopen/node.h"
#include "gateway/utc.h"

/* 2026-11-29 12:00:00 UTC: day 15673 since 1984-01-01, 1795953600 s since 1970-01-01 */
enum { DAY = 15673, NOON_MS = 43200000 };
#define NOON_US	 UINT64_C(1795953600000000)
#define START_US UINT64_C(1000000000) /* CLOCK_MONOTONIC */

struct fixture {
	struct od od;
	struct od_values values;
	struct canopen_node node;
	struct can_port bus;
	struct utc utc;
	struct can_msg sent;
	unsigned sent_count;
};

static int take_frame(struct can_port *port, const struct can_msg *msg)
{
	struct fixture *f = (struct fixture *)(void *)((char *)port - offsetof(struct fixture, bus));

	f->sent = *msg;
	f->sent_count++;
	return 0;
}

static int take_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port, (void)ids, (void)n;
	return 0;
}

static int set_up(void **state)
{
	static const struct can_ops ops = {.send = take_frame, .filter = take_filter};
	static struct fixture f;

	f = (struct fixture){.bus = {.ops = &ops}};
	od_init(&f.od, &imu9_od_table, &f.values, 16);
	utc_init(&f.utc, &f.values, &f.node);
	assert_int_equal(canopen_init(&f.node, &f.od, &f.bus, NULL, 16), 0);
	canopen_start(&f.node, START_US);
	f.sent_count = 0;
	*state = &f;
	return 0;
}

static void test_without_any_source_there_is_no_utc(void **state)
{
	struct fixture *f = *state;

	assert_int_equal(utc_sample(&f->utc, START_US, START_US), UTC_NONE);
	assert_int_equal(f->values.utc.time, 0);
	assert_int_equal(f->values.utc.source, 0);
}

static void test_a_synchronised_host_is_a_source_of_utc(void **state)
{
	struct fixture *f = *state;

	utc_host_clock(&f->utc, true, (int64_t)(NOON_US - START_US));
	assert_int_equal(utc_sample(&f->utc, START_US, START_US), UTC_HOST);
	assert_true(f->values.utc.time == NOON_US);
	assert_int_equal(f->values.utc.day, DAY);
	assert_int_equal(f->values.utc.ms, NOON_MS);
	assert_int_equal(f->values.utc.source, UTC_HOST);
}

static void test_a_host_that_is_not_synchronised_is_none(void **state)
{
	struct fixture *f = *state;

	utc_host_clock(&f->utc, false, (int64_t)(NOON_US - START_US));
	assert_int_equal(utc_sample(&f->utc, START_US, START_US), UTC_NONE);
}

static void test_time_has_precedence_over_the_host(void **state)
{
	struct fixture *f = *state;

	utc_host_clock(&f->utc, true, 0);
	utc_time(&f->utc, DAY, NOON_MS, START_US);
	assert_int_equal(utc_sample(&f->utc, START_US + 500, START_US + 500), UTC_TIME);
	assert_true(f->values.utc.time == NOON_US + 500);
}

static void test_the_day_changes_at_midnight(void **state)
{
	struct fixture *f = *state;

	utc_time(&f->utc, DAY, 86399999, START_US);
	utc_sample(&f->utc, START_US + 1000, START_US + 1000);
	assert_int_equal(f->values.utc.day, DAY + 1);
	assert_int_equal(f->values.utc.ms, 0);
}

static void test_the_jitter_of_time_is_filtered(void **state)
{
	struct fixture *f = *state;
	uint64_t t_us = START_US;

	for (int i = 0; i < 100; i++) {
		t_us = START_US + (uint64_t)i * 1000000;
		utc_time(&f->utc, DAY, (uint32_t)(NOON_MS + i * 1000),
			t_us + (i % 2 ? 0 : 800)); /* delayed by 0 or 0.8 ms */
	}
	utc_sample(&f->utc, t_us, t_us);
	int64_t error_us = (int64_t)(f->values.utc.time - (NOON_US + t_us - START_US));
	assert_in_range(-error_us, 300, 500); /* the mean of the two is 400 */
}

static void test_a_step_of_time_is_followed_at_once(void **state)
{
	struct fixture *f = *state;

	utc_time(&f->utc, DAY, NOON_MS, START_US);
	utc_time(&f->utc, DAY, NOON_MS + 61000, START_US + 1000000);
	utc_sample(&f->utc, START_US + 1000000, START_US + 1000000);
	assert_true(f->values.utc.time == NOON_US + 61000000);
}

/* Times of day have a resolution of 1 ms, arrivals of 1 us. */
static void test_a_difference_of_10_ms_is_jitter_and_more_is_a_step(void **state)
{
	static const struct {
		int early_us, followed_us;
	} cases[] = {{10000, 1250}, {10001, 10001}, {-10000, -1250}, {-10001, -10001}};
	struct fixture *f = *state;

	for (size_t i = 0; i < 4; i++) {
		uint64_t t_us = START_US + (i + 1) * 10000000, ms = NOON_MS + i * 10000;

		utc_time(&f->utc, DAY, (uint32_t)ms + 1000000, t_us - 1000); /* another step before */
		utc_time(&f->utc, DAY, (uint32_t)ms, t_us);
		utc_time(&f->utc, DAY, (uint32_t)ms + 1000, t_us + 1000000 - (uint64_t)(int64_t)cases[i].early_us);
		utc_sample(&f->utc, t_us + 1000000, t_us + 1000000);
		assert_int_equal(f->values.utc.time - (NOON_US + i * 10000000 + 1000000), cases[i].followed_us);
	}
}

/* A log that is replayed again has another epoch then. */
static void test_a_lag_that_grows_by_more_than_a_second_is_another_epoch(void **state)
{
	struct fixture *f = *state;

	utc_host_clock(&f->utc, true, (int64_t)(NOON_US - START_US));
	utc_sample(&f->utc, 0, START_US);
	utc_sample(&f->utc, 1000, START_US + 1000 + 1000000);
	assert_true(f->values.utc.time == NOON_US + 1000);
	utc_sample(&f->utc, 2000, START_US + 2000 + 1000001);
	assert_true(f->values.utc.time == NOON_US + 2000 + 1000001);
}

static void test_a_lag_of_up_to_a_tenth_of_a_second_is_the_same_clock(void **state)
{
	struct fixture *f = *state;

	utc_host_clock(&f->utc, true, (int64_t)(NOON_US - START_US));
	utc_sample(&f->utc, START_US, START_US + 2000000);
	utc_sample(&f->utc, START_US + 1000, START_US + 1000 + 100001);
	assert_true(f->values.utc.time == NOON_US + 1000 + 100001);
	utc_sample(&f->utc, START_US + 2000, START_US + 2000 + 100000);
	assert_true(f->values.utc.time == NOON_US + 2000);
}

static void test_time_is_used_for_five_minutes(void **state)
{
	struct fixture *f = *state;

	utc_time(&f->utc, DAY, NOON_MS, START_US);
	assert_int_equal(utc_sample(&f->utc, START_US + 300000000, START_US + 300000000), UTC_TIME);
	assert_int_equal(utc_sample(&f->utc, START_US + 300000001, START_US + 300000001), UTC_NONE);
	assert_int_equal(f->values.utc.time, 0);
}

static void test_samples_of_another_epoch_get_the_time_of_the_arrival_with_the_smallest_delay(void **state)
{
	struct fixture *f = *state;

	utc_host_clock(&f->utc, true, (int64_t)(NOON_US - START_US));
	for (uint64_t i = 0; i < 10; i++)
		utc_sample(&f->utc, i * 10000, START_US + i * 10000 + (i == 3 ? 0 : 2000));
	uint64_t error_us = f->values.utc.time - (NOON_US + 90000);
	assert_in_range(error_us, 0, 10);
}

/* Of another epoch, for an hour; each second sample arrives 2 ms late. */
static void test_a_clock_of_the_samples_that_is_40_ppm_slow_is_followed(void **state)
{
	struct fixture *f = *state;

	utc_host_clock(&f->utc, true, (int64_t)(NOON_US - START_US));
	for (uint64_t i = 0; i <= 36000; i++) {
		utc_sample(&f->utc, i * 99996, START_US + i * 100000 + (i % 2 ? 2000 : 0));
		int64_t error_us = (int64_t)(f->values.utc.time - (NOON_US + i * 100000));
		assert_true(error_us >= -5 && error_us <= 10);
	}
}

static void test_time_stamps_of_the_monotonic_clock_are_used_as_they_are(void **state)
{
	struct fixture *f = *state;

	utc_host_clock(&f->utc, true, (int64_t)(NOON_US - START_US));
	utc_sample(&f->utc, START_US, START_US + 7000);
	assert_true(f->values.utc.time == NOON_US);
}

static void test_time_is_produced_periodically_by_a_synchronised_host(void **state)
{
	struct fixture *f = *state;

	assert_int_equal(od_write(&f->od, 0x1012, 0, (const uint8_t[]){0x00, 0x01, 0x00, 0x40}, 4), OD_OK);
	assert_true(utc_tick(&f->utc, START_US) == UINT64_MAX);
	assert_int_equal(f->sent_count, 0);
	utc_host_clock(&f->utc, true, (int64_t)(NOON_US - START_US));
	assert_true(utc_tick(&f->utc, START_US) == START_US + 10000000);
	assert_int_equal(f->sent_count, 1);
	assert_int_equal(f->sent.id, 0x100);
	assert_memory_equal(f->sent.data, "\x00\x2E\x93\x02\x39\x3D", 6);
	utc_tick(&f->utc, START_US + 9999999);
	assert_int_equal(f->sent_count, 1);
	utc_tick(&f->utc, START_US + 10000000);
	assert_int_equal(f->sent_count, 2);
}

static void test_received_time_is_not_produced_again(void **state)
{
	struct fixture *f = *state;

	assert_int_equal(od_write(&f->od, 0x1012, 0, (const uint8_t[]){0x00, 0x01, 0x00, 0xC0}, 4), OD_OK);
	utc_time(&f->utc, DAY, NOON_MS, START_US);
	assert_true(utc_tick(&f->utc, START_US) == UINT64_MAX);
	assert_int_equal(f->sent_count, 0);
}

#define TEST(f) cmocka_unit_test_setup(f, set_up)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_without_any_source_there_is_no_utc),
		TEST(test_a_synchronised_host_is_a_source_of_utc),
		TEST(test_a_host_that_is_not_synchronised_is_none),
		TEST(test_time_has_precedence_over_the_host),
		TEST(test_the_day_changes_at_midnight),
		TEST(test_the_jitter_of_time_is_filtered),
		TEST(test_a_step_of_time_is_followed_at_once),
		TEST(test_a_difference_of_10_ms_is_jitter_and_more_is_a_step),
		TEST(test_a_lag_that_grows_by_more_than_a_second_is_another_epoch),
		TEST(test_a_lag_of_up_to_a_tenth_of_a_second_is_the_same_clock),
		TEST(test_time_is_used_for_five_minutes),
		TEST(test_samples_of_another_epoch_get_the_time_of_the_arrival_with_the_smallest_delay),
		TEST(test_a_clock_of_the_samples_that_is_40_ppm_slow_is_followed),
		TEST(test_time_stamps_of_the_monotonic_clock_are_used_as_they_are),
		TEST(test_time_is_produced_periodically_by_a_synchronised_host),
		TEST(test_received_time_is_not_produced_again),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
