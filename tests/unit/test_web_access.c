/* Who may use imu9-web: Host, Origin, the token and where it listens. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <cmocka.h>

#include "tools/web/access.h"

static const char *const NAMES[] = {"robot.example"};

static void test_a_host_is_an_address_localhost_or_a_given_name(void **state)
{
	static const char *const GOOD[] = {"127.0.0.1", "127.0.0.1:8410", "[::1]:8410", "[::1]", "localhost:8410",
		"LOCALHOST", "192.168.1.7:80", "[fe80::1]:65535", "robot.example", "Robot.Example:443"};

	(void)state;
	for (size_t i = 0; i < sizeof(GOOD) / sizeof(GOOD[0]); i++)
		if (!web_host_allowed(GOOD[i], NAMES, 1))
			fail_msg("%s is refused", GOOD[i]);
}

static void test_a_foreign_name_is_no_host(void **state)
{
	static const char *const BAD[] = {"evil.example:8410", "127.0.0.1.evil.example", "localhost.evil.example",
		"evil.localhost", "", ":8410", "127.0.0.1:", "127.0.0.1:x", "127.0.0.1:65536", "127.0.0.1:8410:1",
		"127.1", "0x7f.0.0.1", "2130706433", "[::1", "::1", "[]:1", "[::1]x", "[localhost]", "127.0.0.1 ",
		"user@127.0.0.1", "robot.example.", "robot.example@evil.example", "127.0.0.1:8410/",
		"127.0.0.1:000080"};

	(void)state;
	assert_false(web_host_allowed(NULL, NAMES, 1));
	for (size_t i = 0; i < sizeof(BAD) / sizeof(BAD[0]); i++)
		if (web_host_allowed(BAD[i], NAMES, 1))
			fail_msg("%s is allowed", BAD[i]);
	assert_false(web_host_allowed("robot.example", NULL, 0));
}

static void test_an_origin_is_http_or_https_at_the_host(void **state)
{
	static const char *const BAD[] = {"http://evil.example", "null", "", "http://127.0.0.1",
		"http://127.0.0.1:84100", "http://127.0.0.1:8411", "ws://127.0.0.1:8410", "127.0.0.1:8410",
		"http://127.0.0.1:8410/", "http://127.0.0.1:8410.evil.example", "file://", "HTTP://127.0.0.1:8410"};

	(void)state;
	assert_true(web_origin_allowed("http://127.0.0.1:8410", "127.0.0.1:8410"));
	assert_true(web_origin_allowed("https://robot.example", "Robot.example"));
	assert_false(web_origin_allowed(NULL, "127.0.0.1:8410"));
	assert_false(web_origin_allowed("http://127.0.0.1:8410", NULL));
	for (size_t i = 0; i < sizeof(BAD) / sizeof(BAD[0]); i++)
		if (web_origin_allowed(BAD[i], "127.0.0.1:8410"))
			fail_msg("%s is allowed", BAD[i]);
}

static void test_it_listens_on_an_address_with_a_port(void **state)
{
	char address[64];
	int port;

	(void)state;
	assert_true(web_listen_address("[::1]:8410", address, &port));
	assert_string_equal(address, "::1");
	assert_int_equal(port, 8410);
	assert_false(web_listen_address("127.0.0.1", address, &port));
	assert_false(web_listen_address("localhost:8410", address, &port));
	assert_true(web_is_loopback("127.0.0.1") && web_is_loopback("127.5.6.7") && web_is_loopback("::1"));
	assert_false(web_is_loopback("0.0.0.0") || web_is_loopback("::") || web_is_loopback("192.168.1.7") ||
		     web_is_loopback("::ffff:127.0.0.1"));
}

static void test_each_start_has_another_token_of_128_bits(void **state)
{
	struct web_token a, b;

	(void)state;
	assert_int_equal(web_token_create(&a), 0);
	assert_int_equal(web_token_create(&b), 0);
	assert_int_equal(strlen(a.text), 32);
	assert_int_equal(strspn(a.text, "0123456789abcdef"), 32);
	assert_string_not_equal(a.text, b.text);
}

static void test_only_the_whole_token_unlocks(void **state)
{
	static const char *const WRONG[] = {
		"", "0123456789abcde", "0123456789abcdef0", "1123456789abcdef", "0123456789abcdeF"};
	struct web_token token = {.text = "0123456789abcdef"}, none = {0};
	char longer[2000];

	(void)state;
	for (size_t i = 0; i < sizeof(WRONG) / sizeof(WRONG[0]); i++)
		assert_int_equal(web_token_try(&token, WRONG[i], i * 100000000), WEB_WRONG_TOKEN);
	memset(longer, '0', sizeof(longer) - 1);
	longer[sizeof(longer) - 1] = '\0';
	assert_int_equal(web_token_try(&token, longer, 1000000000), WEB_WRONG_TOKEN);
	assert_int_equal(web_token_try(&token, "0123456789abcdef", 2000000000), WEB_UNLOCKED);
	assert_int_equal(web_token_try(&none, "", 0), WEB_WRONG_TOKEN);
}

static void test_after_three_wrong_tokens_each_attempt_waits_twice_as_long(void **state)
{
	static const unsigned int WAITS_S[] = {0, 0, 1, 2, 4, 8, 16, 32, 32, 32};
	struct web_token token = {.text = "0123456789abcdef"};
	uint64_t now_us = 1000000;

	(void)state;
	for (size_t i = 0; i < sizeof(WAITS_S) / sizeof(WAITS_S[0]); i++) {
		assert_int_equal(web_token_try(&token, "wrong", now_us), WEB_WRONG_TOKEN);
		assert_int_equal(web_token_wait_s(&token, now_us), WAITS_S[i]);
		if (WAITS_S[i])
			assert_int_equal(
				web_token_try(&token, token.text, now_us + WAITS_S[i] * 1000000ull - 1), WEB_WAIT);
		now_us += WAITS_S[i] * 1000000ull;
	}
	assert_int_equal(web_token_try(&token, token.text, now_us), WEB_UNLOCKED);
	assert_int_equal(web_token_try(&token, "wrong", now_us), WEB_WRONG_TOKEN);
	assert_int_equal(web_token_wait_s(&token, now_us), 0);
}

static int load(const char *text, mode_t mode, struct web_token *token, char error[200])
{
	char path[] = "/tmp/test_web_access.XXXXXX";
	int fd = mkstemp(path);

	assert_true(fd >= 0 && write(fd, text, strlen(text)) == (ssize_t)strlen(text) && fchmod(fd, mode) == 0);
	close(fd);
	int rc = web_token_load(token, path, error, 200);
	unlink(path);
	return rc;
}

static void test_a_token_file_is_for_its_owner_only(void **state)
{
	struct web_token token;
	char error[200];

	(void)state;
	assert_int_equal(load("0123456789abcdef\n", 0600, &token, error), 0);
	assert_string_equal(token.text, "0123456789abcdef");
	assert_true(load("0123456789abcdef\n", 0640, &token, error) < 0);
	assert_non_null(strstr(error, "chmod 600"));
	assert_true(load("0123456789abcdef\n", 0604, &token, error) < 0);
	assert_true(load("0123456789abcde\n", 0600, &token, error) < 0);
	assert_non_null(strstr(error, "16"));
	assert_true(load("0123456789 abcdef\n", 0600, &token, error) < 0);
	assert_true(
		load("01234567890123456789012345678901234567890123456789012345678901234\n", 0600, &token, error) < 0);
	assert_true(web_token_load(&token, "/nonexistent/token", error, sizeof(error)) < 0);
	assert_non_null(strstr(error, "/nonexistent/token"));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_host_is_an_address_localhost_or_a_given_name),
		cmocka_unit_test(test_a_foreign_name_is_no_host),
		cmocka_unit_test(test_an_origin_is_http_or_https_at_the_host),
		cmocka_unit_test(test_it_listens_on_an_address_with_a_port),
		cmocka_unit_test(test_each_start_has_another_token_of_128_bits),
		cmocka_unit_test(test_only_the_whole_token_unlocks),
		cmocka_unit_test(test_after_three_wrong_tokens_each_attempt_waits_twice_as_long),
		cmocka_unit_test(test_a_token_file_is_for_its_owner_only),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
