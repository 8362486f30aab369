/* The lines of the gateway on standard error. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "gateway/log.h"
#include "tests/unit/descriptors.h"

static int stderr_to(int fd)
{
	int kept = dup(STDERR_FILENO);

	dup2(fd, STDERR_FILENO);
	return kept;
}

static void stderr_back(int kept)
{
	dup2(kept, STDERR_FILENO);
	close(kept);
}

static void test_a_line_is_written_in_one_piece_and_ends_with_a_newline(void **state)
{
	char text[100] = "";
	int ends[2], kept;

	(void)state;
	assert_int_equal(pipe(ends), 0);
	kept = stderr_to(ends[1]);
	log_line("node %u", 5u);
	stderr_back(kept);
	assert_true(read(ends[0], text, sizeof(text) - 1) > 0);
	assert_string_equal(text, "imu9-gateway: node 5\n");
	close(ends[0]);
	close(ends[1]);
}

static void test_control_codes_are_replaced(void **state)
{
	char text[100] = "";
	int ends[2], kept;

	(void)state;
	assert_int_equal(pipe(ends), 0);
	kept = stderr_to(ends[1]);
	log_line("'%s' is no number", "\x1B[2J\n1");
	stderr_back(kept);
	assert_true(read(ends[0], text, sizeof(text) - 1) > 0);
	assert_string_equal(text, "imu9-gateway: '?[2J?1' is no number\n");
	close(ends[0]);
	close(ends[1]);
}

static void test_the_journal_gets_priorities_and_a_redirected_stderr_does_not(void **state)
{
	char text[100] = "", stream[64];
	int ends[2], kept;
	struct stat s;

	(void)state;
	assert_int_equal(pipe(ends), 0);
	assert_int_equal(fstat(ends[1], &s), 0);
	snprintf(stream, sizeof(stream), "%llu:%llu", (unsigned long long)s.st_dev, (unsigned long long)s.st_ino);
	setenv("JOURNAL_STREAM", stream, 1);
	kept = stderr_to(ends[1]);
	log_warning("no samples");
	log_error("bad\n");
	setenv("JOURNAL_STREAM", "1:1", 1);
	log_line("elsewhere");
	stderr_back(kept);
	unsetenv("JOURNAL_STREAM");
	assert_true(read(ends[0], text, sizeof(text) - 1) > 0);
	assert_string_equal(text, "<4>no samples\n<3>bad?\nimu9-gateway: elsewhere\n");
	close(ends[0]);
	close(ends[1]);
}

static void test_a_line_has_up_to_511_characters(void **state)
{
	char text[600] = "", long_text[600];
	int ends[2], kept;

	(void)state;
	memset(long_text, 'x', sizeof(long_text) - 1);
	long_text[sizeof(long_text) - 1] = '\0';
	assert_int_equal(pipe(ends), 0);
	kept = stderr_to(ends[1]);
	log_line("%s", long_text);
	log_line("%.497s", long_text);
	stderr_back(kept);
	assert_int_equal(read(ends[0], text, 511), 511);
	assert_memory_equal(text, "imu9-gateway: xxx", 17);
	assert_string_equal(text + 509, "x\n");
	assert_int_equal(read(ends[0], text, sizeof(text)), 511);
	close(ends[0]);
	close(ends[1]);
}

static void test_the_level_leaves_out_what_is_less_severe(void **state)
{
	char text[100] = "";
	int ends[2], kept;

	(void)state;
	assert_int_equal(pipe(ends), 0);
	kept = stderr_to(ends[1]);
	log_at(LOG_DEBUG, "not by default");
	log_set_level(LOG_WARNING);
	log_line("fine");
	log_warning("not fine");
	log_set_level(LOG_INFO);
	stderr_back(kept);
	assert_true(read(ends[0], text, sizeof(text) - 1) > 0);
	assert_string_equal(text, "imu9-gateway: not fine\n");
	close(ends[0]);
	close(ends[1]);
}

static void test_a_reader_that_does_not_read_does_not_block_the_gateway(void **state)
{
	char block[4096] = "";
	int ends[2], kept;

	(void)state;
	assert_int_equal(pipe(ends), 0);
	fcntl(ends[1], F_SETFL, O_NONBLOCK);
	while (write(ends[1], block, sizeof(block)) > 0) {
	}
	fcntl(ends[1], F_SETFL, 0);
	kept = stderr_to(ends[1]);
	alarm(5); /* ends a test that blocks */
	log_line("nobody reads this");
	alarm(0);
	stderr_back(kept);
	close(ends[0]);
	close(ends[1]);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_line_is_written_in_one_piece_and_ends_with_a_newline),
		cmocka_unit_test(test_control_codes_are_replaced),
		cmocka_unit_test(test_the_journal_gets_priorities_and_a_redirected_stderr_does_not),
		cmocka_unit_test(test_a_line_has_up_to_511_characters),
		cmocka_unit_test(test_the_level_leaves_out_what_is_less_severe),
		cmocka_unit_test(test_a_reader_that_does_not_read_does_not_block_the_gateway),
	};
	static char name[] = "imu9-gateway"; /* what log lines begin with */

	program_invocation_short_name = name;
	return cmocka_run_group_tests_name("log", tests, count_descriptors, no_descriptor_is_left);
}
