/* The order in which imu9-fleet gives records to the broker, and what becomes of them when that is away, slow, or
 * restarted, in simulated time, with a spool on the disk of this machine. The broker of the test takes records and
 * acknowledges them when told. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "tools/fleet/outbox.h"

enum { SECOND = 1000000, MANY = 200000, SIZE = 4 << 20 };

static struct bench {
	char folder[64];
	struct spool spool;
	struct outbox outbox;
	struct outbox_port port;
	unsigned numbers[MANY]; /* of the records that the broker has got; mid = index + 1 */
	bool late[MANY];
	size_t got, acked;
	bool refuses;
	unsigned put;
	uint64_t now_us;
} b;

static long take(void *ctx, const uint8_t *record, size_t size, bool late)
{
	(void)ctx;
	assert_int_equal(size, sizeof(unsigned));
	if (b.refuses)
		return -1;
	assert_true(b.got < MANY);
	memcpy(&b.numbers[b.got], record, size);
	b.late[b.got] = late;
	return (long)++b.got;
}

static void open_outbox(double rate_hz)
{
	b.port = (struct outbox_port){NULL, take};
	assert_int_equal(spool_open(&b.spool, b.folder, SIZE), 0);
	outbox_init(&b.outbox, &b.port, &b.spool, rate_hz);
}

static int set_up(void **state)
{
	(void)state;
	b = (struct bench){.folder = "/tmp/imu9-outbox.XXXXXX", .now_us = SECOND};
	assert_non_null(mkdtemp(b.folder));
	open_outbox(1e6);
	return 0;
}

static int tear_down(void **state)
{
	char command[128];

	(void)state;
	spool_close(&b.spool);
	snprintf(command, sizeof(command), "rm -r %s", b.folder);
	return system(command);
}

/* At 100 Hz. */
static void put(unsigned count)
{
	for (unsigned i = 0; i < count; i++) {
		b.now_us += SECOND / 100;
		outbox_put(&b.outbox, (const uint8_t *)&b.put, sizeof(b.put), b.now_us);
		b.put++;
		outbox_tick(&b.outbox, b.now_us);
	}
}

static void acknowledge(void)
{
	while (b.acked < b.got)
		outbox_acked(&b.outbox, (long)++b.acked);
}

/* Until nothing waits. */
static void drain(void)
{
	for (int i = 0; i < 1000 && (b.outbox.count > 0 || !spool_is_empty(&b.spool)); i++) {
		b.now_us += SECOND / 100;
		outbox_tick(&b.outbox, b.now_us);
		acknowledge();
	}
	assert_true(spool_is_empty(&b.spool));
}

/* Each record came at least once, and none before one that is older, but for those that were sent again. */
static void check_complete(size_t *repeated)
{
	unsigned next = 0;

	*repeated = 0;
	for (size_t i = 0; i < b.got; i++) {
		assert_true(b.numbers[i] <= next);
		*repeated += b.numbers[i] < next;
		next += b.numbers[i] == next;
	}
	assert_int_equal(next, b.put);
}

static void test_with_a_broker_that_answers_nothing_touches_the_disk(void **state)
{
	size_t repeated;

	(void)state;
	outbox_connected(&b.outbox, b.now_us);
	for (int i = 0; i < 500; i++) {
		put(1);
		acknowledge();
		assert_int_equal(b.spool.bytes, 0);
	}
	check_complete(&repeated);
	assert_int_equal(repeated, 0);
	assert_int_equal(b.outbox.delivered, 500);
}

static void test_without_a_broker_all_waits_and_comes_in_order(void **state)
{
	size_t repeated;

	(void)state;
	put(3000);
	assert_int_equal(b.got, 0);
	outbox_connected(&b.outbox, b.now_us);
	put(100); /* new ones wait behind the old ones */
	drain();
	put(10);
	check_complete(&repeated);
	assert_int_equal(repeated, 0);
	assert_true(b.late[0] && !b.late[b.got - 1]);
}

static void test_what_was_not_acknowledged_is_sent_again_over_the_next_connection(void **state)
{
	size_t repeated;

	(void)state;
	outbox_connected(&b.outbox, b.now_us);
	put(40);
	acknowledge();
	put(30); /* under way, when the connection breaks */
	outbox_disconnected(&b.outbox);
	b.acked = b.got;
	put(20);
	outbox_connected(&b.outbox, b.now_us);
	drain();
	check_complete(&repeated);
	assert_int_equal(repeated, 30);
}

static void test_a_broker_that_does_not_acknowledge_for_a_second_is_not_trusted_with_the_records(void **state)
{
	size_t repeated;

	(void)state;
	outbox_connected(&b.outbox, b.now_us);
	put(90);
	assert_int_equal(b.spool.records, 0);
	put(20);
	assert_int_equal(b.spool.records, 110);
	assert_int_equal(b.got, 110); /* sent once, all the same */
	drain();
	assert_int_equal(b.spool.records, 0);
	check_complete(&repeated);
	assert_int_equal(repeated, 0);
}

static void test_a_slow_broker_gets_all_in_order(void **state)
{
	size_t repeated;

	(void)state;
	outbox_connected(&b.outbox, b.now_us);
	for (int i = 0; i < 2000; i++) {
		put(1);
		if (i % 2) /* half as fast as records come */
			if (b.acked < b.got)
				outbox_acked(&b.outbox, (long)++b.acked);
		assert_true(b.outbox.count <= OUTBOX_WINDOW);
	}
	assert_true(b.spool.records > 500);
	drain();
	check_complete(&repeated);
	assert_int_equal(repeated, 0);
}

static void test_after_a_restart_what_was_not_delivered_comes_first(void **state)
{
	size_t repeated;

	(void)state;
	put(700);
	outbox_connected(&b.outbox, b.now_us - SECOND); /* the rate allows all of them */
	b.now_us += SECOND / 100;
	outbox_tick(&b.outbox, b.now_us);
	assert_int_equal(b.got, OUTBOX_WINDOW);
	for (int i = 0; i < 100; i++)
		outbox_acked(&b.outbox, (long)++b.acked);
	outbox_disconnected(&b.outbox);
	spool_close(&b.spool);

	open_outbox(1e6);
	b.acked = b.got;
	put(50);
	outbox_connected(&b.outbox, b.now_us);
	drain();
	check_complete(&repeated);
	assert_int_equal(repeated, OUTBOX_WINDOW - 100);
}

static void test_a_connection_that_breaks_again_and_again_loses_nothing(void **state)
{
	size_t repeated;
	unsigned seed = 1;

	(void)state;
	for (int i = 0; i < 300; i++) {
		seed = seed * 1103515245 + 12345;
		outbox_connected(&b.outbox, b.now_us);
		put(seed >> 16 & 15);
		for (unsigned n = seed >> 20 & 15; n > 0 && b.acked < b.got; n--)
			outbox_acked(&b.outbox, (long)++b.acked);
		b.refuses = seed >> 25 & 1;
		put(seed >> 24 & 3);
		outbox_disconnected(&b.outbox);
		b.refuses = false;
		b.acked = b.got;
		put(seed >> 22 & 7);
	}
	outbox_connected(&b.outbox, b.now_us);
	drain();
	check_complete(&repeated);
	assert_int_equal(b.outbox.lost, 0);
}

static void test_records_from_the_spool_keep_to_their_rate(void **state)
{
	(void)state;
	spool_close(&b.spool);
	open_outbox(200);
	put(1000);
	outbox_connected(&b.outbox, b.now_us);
	for (int ms = 0; ms < 2000; ms++) {
		b.now_us += 1000;
		outbox_tick(&b.outbox, b.now_us);
		acknowledge();
	}
	assert_in_range(b.got, 399, 401);
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_with_a_broker_that_answers_nothing_touches_the_disk),
		TEST(test_without_a_broker_all_waits_and_comes_in_order),
		TEST(test_what_was_not_acknowledged_is_sent_again_over_the_next_connection),
		TEST(test_a_broker_that_does_not_acknowledge_for_a_second_is_not_trusted_with_the_records),
		TEST(test_a_slow_broker_gets_all_in_order),
		TEST(test_after_a_restart_what_was_not_delivered_comes_first),
		TEST(test_a_connection_that_breaks_again_and_again_loses_nothing),
		TEST(test_records_from_the_spool_keep_to_their_rate),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
