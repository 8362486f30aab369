/* The log of events in memory, and the lines that are left out of it. Its rate with the whole device is in
 * scenario/test_flood.c. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <stdio.h>
#include <string.h>

#include "gateway/event_log.h"

enum { SECOND = 1000000 };

static struct event_log event_log;

static int set_up(void **state)
{
	(void)state;
	memset(&event_log, 0, sizeof(event_log));
	event_log_start(&event_log, 5 * SECOND);
	return 0;
}

static void assert_log_is(const char *expected)
{
	assert_int_equal(event_log.used, strlen(expected));
	assert_memory_equal(event_log.text, expected, strlen(expected));
}

static void test_a_line_has_the_time_since_the_start_and_up_to_150_characters(void **state)
{
	char text[152], expected[200];

	(void)state;
	memset(text, 'x', 151);
	text[151] = '\0';
	event_log_add(&event_log, 6 * SECOND + 20, "%s", text);
	snprintf(expected, sizeof(expected), "      1.000020 %.150s\n", text);
	assert_log_is(expected);
}

static void test_what_was_before_the_start_has_the_time_0(void **state)
{
	(void)state;
	event_log_add(&event_log, 0, "opened");
	assert_log_is("      0.000000 opened\n");
}

static void test_the_latest_line_that_was_left_out_follows_with_their_number_however_long_it_is(void **state)
{
	char text[152], expected[400];

	(void)state;
	memset(text, 'x', 151);
	text[151] = '\0';
	for (int i = 0; i < 2; i++)
		event_log_add(&event_log, 5 * SECOND, "%s", "first");
	event_log_add(&event_log, 5 * SECOND, "%s", "lost");
	for (int i = 0; i < 1000; i++)
		event_log_add(&event_log, 5 * SECOND + 10, "%s", text);
	assert_int_equal(event_log_tick(&event_log, 6 * SECOND - 1), 6 * SECOND);
	snprintf(expected, sizeof(expected), "      0.000000 first\n      0.000000 first\n");
	assert_log_is(expected);
	assert_true(event_log_tick(&event_log, 6 * SECOND) == UINT64_MAX);
	snprintf(expected + strlen(expected), sizeof(expected) - strlen(expected),
		"      0.000010 %.150s (1000 lines like this left out)\n", text);
	assert_log_is(expected);
}

/* Each number is a kind of its own. */
static void test_a_full_log_loses_whole_lines_the_oldest_first(void **state)
{
	char last[60];

	(void)state;
	for (unsigned i = 0; i < 2000; i++)
		event_log_add_about(&event_log, 5 * SECOND, i, "line %04u", i);
	assert_in_range(event_log.used, OD_DOMAIN_MAX - 25 + 1, OD_DOMAIN_MAX);
	assert_int_equal(event_log.used % 25, 0);
	for (size_t at = 0, i = 2000 - event_log.used / 25; at < event_log.used; at += 25, i++) {
		snprintf(last, sizeof(last), "      0.000000 line %04zu\n", i);
		assert_memory_equal(event_log.text + at, last, 25);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test_setup(test_a_line_has_the_time_since_the_start_and_up_to_150_characters, set_up),
		cmocka_unit_test_setup(test_what_was_before_the_start_has_the_time_0, set_up),
		cmocka_unit_test_setup(
			test_the_latest_line_that_was_left_out_follows_with_their_number_however_long_it_is, set_up),
		cmocka_unit_test_setup(test_a_full_log_loses_whole_lines_the_oldest_first, set_up),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
