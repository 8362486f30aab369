/* The hand-over between two threads of imu9-fleet: all that fits comes out whole and in order, the rest is counted. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <string.h>

#include "tools/fleet/ring.h"

enum { CAPACITY = 1024, MESSAGES = 20000, LONGEST = 200 };

/* Message n has 4 to 200 bytes, which follow from n. */
static size_t make(uint32_t n, uint8_t *bytes)
{
	size_t size = 4 + n * 7 % (LONGEST - 3);

	memset(bytes, (uint8_t)(n * 31), size);
	memcpy(bytes, &n, sizeof(n));
	return size;
}

static void check(uint32_t n, const uint8_t *bytes, size_t size)
{
	uint8_t expected[LONGEST];

	assert_int_equal(size, make(n, expected));
	assert_memory_equal(bytes, expected, size);
}

static void test_what_does_not_fit_is_dropped_and_counted(void **state)
{
	uint8_t bytes[LONGEST];
	struct ring ring;
	uint32_t put = 0, got = 0;
	size_t size;

	(void)state;
	assert_int_equal(ring_open(&ring, CAPACITY), 0);
	while (ring_put(&ring, bytes, make(put, bytes)))
		put++;
	assert_in_range(put, 5, 20);
	assert_int_equal(atomic_load(&ring.dropped), 1);
	for (; (size = ring_get(&ring, bytes, sizeof(bytes))) > 0; got++)
		check(got, bytes, size);
	assert_int_equal(got, put);
	assert_true(ring_put(&ring, "next", 4));
	ring_close(&ring);
}

static void test_the_descriptor_tells_that_there_is_something(void **state)
{
	struct ring ring;

	(void)state;
	assert_int_equal(ring_open(&ring, CAPACITY), 0);
	struct pollfd fd = {.fd = ring.fd, .events = POLLIN};
	assert_int_equal(poll(&fd, 1, 0), 0);
	assert_true(ring_put(&ring, "a", 1));
	assert_true(ring_put(&ring, "b", 1));
	assert_int_equal(poll(&fd, 1, 0), 1);
	ring_clear(&ring);
	assert_int_equal(poll(&fd, 1, 0), 0);
	ring_close(&ring);
}

static void *give(void *ctx)
{
	uint8_t bytes[LONGEST];

	for (uint32_t n = 0; n < MESSAGES; n++)
		while (!ring_put(ctx, bytes, make(n, bytes)))
			sched_yield();
	return NULL;
}

static void test_between_two_threads_all_come_whole_and_in_order(void **state)
{
	uint8_t bytes[LONGEST];
	struct ring ring;
	pthread_t giver;

	(void)state;
	assert_int_equal(ring_open(&ring, CAPACITY), 0);
	assert_int_equal(pthread_create(&giver, NULL, give, &ring), 0);
	for (uint32_t n = 0; n < MESSAGES;) {
		size_t size = ring_get(&ring, bytes, sizeof(bytes));

		if (size > 0)
			check(n++, bytes, size);
		else
			sched_yield();
	}
	pthread_join(giver, NULL);
	ring_close(&ring);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_what_does_not_fit_is_dropped_and_counted),
		cmocka_unit_test(test_the_descriptor_tells_that_there_is_something),
		cmocka_unit_test(test_between_two_threads_all_come_whole_and_in_order),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
