/* What the gateway tells the service manager: sd_notify(3) and systemd.service(5), WatchdogSec=. The manager is a
 * datagram socket here; the time moves only where a test moves it. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "gateway/service.h"
#include "tests/unit/descriptors.h"

#define S 1000000

static char folder[64], path[100], text[300];
static int manager;
static struct service service;
static uint64_t now_us;

/* `name`: with '@' in front in the abstract namespace. */
static void listen_at(const char *name)
{
	struct sockaddr_un address = {.sun_family = AF_UNIX};
	size_t length = strlen(name);

	memcpy(address.sun_path, name, length);
	if (name[0] == '@')
		address.sun_path[0] = '\0';
	manager = socket(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK, 0);
	assert_int_equal(bind(manager, (struct sockaddr *)&address,
				 (socklen_t)(offsetof(struct sockaddr_un, sun_path) + length)),
		0);
}

static int start_manager(void **state)
{
	(void)state;
	strcpy(folder, "/tmp/imu9-service-XXXXXX");
	if (!mkdtemp(folder))
		return -1;
	snprintf(path, sizeof(path), "%s/notify", folder);
	listen_at(path);
	now_us = 100 * S;
	service_open(&service, path, "10000000", NULL);
	return 0;
}

static int end_manager(void **state)
{
	(void)state;
	service_close(&service);
	close(manager);
	unlink(path);
	return rmdir(folder);
}

/* The next message, "" without one. */
static const char *message(void)
{
	ssize_t n = recv(manager, text, sizeof(text) - 1, 0);

	text[n > 0 ? n : 0] = '\0';
	return text;
}

/* Whether the process gives a sign of life at the end of this time, a multiple of 5 s. */
static bool lives_after(unsigned seconds, bool sensor_turns, bool storing)
{
	static unsigned turns = 1;
	bool lives = false;

	for (unsigned i = 0; i < seconds; i += 5) {
		now_us += 5 * S;
		turns += sensor_turns;
		service_tick(&service, turns, storing, now_us);
		lives = strcmp(message(), "WATCHDOG=1") == 0;
	}
	return lives;
}

static void test_it_is_ready_once_with_the_sensor_as_status(void **state)
{
	(void)state;
	assert_string_equal(message(), "");
	service_ready(&service, "sim:square v2");
	service_ready(&service, "sim:square v2");
	assert_string_equal(message(), "READY=1\nSTATUS=sim:square v2");
	assert_string_equal(message(), "");
	service_stopping(&service);
	assert_string_equal(message(), "STOPPING=1");
}

static void test_a_status_has_up_to_240_characters(void **state)
{
	char status[251];

	(void)state;
	memset(status, 'x', 250);
	status[250] = '\0';
	service_ready(&service, status);
	status[240] = '\0';
	assert_string_equal(message() + strlen("READY=1\nSTATUS="), status);
}

static void test_an_abstract_socket_is_reached(void **state)
{
	char name[64];

	(void)state;
	service_close(&service);
	int of_another = dup(STDOUT_FILENO); /* with the number that it had */
	service_close(&service);
	assert_int_equal(close(of_another), 0);
	close(manager);
	snprintf(name, sizeof(name), "@imu9-test-%d", (int)getpid());
	listen_at(name);
	service_open(&service, name, NULL, NULL);
	service_ready(&service, "x");
	assert_string_equal(message(), "READY=1\nSTATUS=x");
}

static void test_a_sign_of_life_is_given_each_half_of_the_watchdog_s_time(void **state)
{
	(void)state;
	assert_int_equal(service_tick(&service, 1, false, now_us), now_us + 5 * S);
	assert_string_equal(message(), "WATCHDOG=1");
	assert_int_equal(service_tick(&service, 2, false, now_us + S), now_us + 5 * S);
	assert_string_equal(message(), "");
	service_tick(&service, 3, false, now_us + 5 * S);
	assert_string_equal(message(), "WATCHDOG=1");
}

static void test_without_a_watchdog_or_for_another_process_there_are_none(void **state)
{
	(void)state;
	service_close(&service);
	service_open(&service, path, NULL, NULL);
	assert_true(service_tick(&service, 1, false, now_us) == UINT64_MAX);
	service_close(&service);
	service_open(&service, path, "10000000", "1");
	assert_true(service_tick(&service, 1, false, now_us) == UINT64_MAX);
	service_close(&service);
	service_open(&service, NULL, "10000000", NULL);
	assert_true(service_tick(&service, 1, false, now_us) == UINT64_MAX);
	service_ready(&service, "x");
	assert_string_equal(message(), "");
}

static void test_a_socket_that_cannot_be_used_is_none(void **state)
{
	struct sockaddr_un address;
	char long_path[sizeof(address.sun_path) + 1];

	(void)state;
	memset(long_path, 'x', sizeof(long_path) - 1);
	long_path[sizeof(long_path) - 1] = '\0';
	const char *const paths[] = {"", long_path, "/no/such/socket"};
	for (size_t i = 0; i < sizeof(paths) / sizeof(paths[0]); i++) {
		service_close(&service);
		service_open(&service, paths[i], "10000000", NULL);
		assert_true(service_tick(&service, 1, false, now_us) == UINT64_MAX);
	}
}

static void test_a_name_has_up_to_107_characters(void **state)
{
	char name[109];

	(void)state;
	memset(name, 'x', sizeof(name));
	name[108] = '\0';
	snprintf(name, 24, "@imu9-test-%-12d", (int)getpid());
	name[strlen(name)] = 'x';
	for (int length = 107; length <= 108; length++) {
		service_close(&service);
		close(manager);
		name[length] = '\0';
		listen_at(name);
		service_open(&service, name, "10000000", NULL);
		assert_int_equal(service_tick(&service, 1, false, now_us) == UINT64_MAX, length == 108);
		name[length] = 'x';
	}
}

static void test_a_sensor_s_thread_that_hangs_ends_the_signs_of_life(void **state)
{
	(void)state;
	assert_true(lives_after(20, true, false));
	assert_true(lives_after(10, false, false));
	assert_false(lives_after(10, false, false));
	assert_true(lives_after(10, true, false)); /* it was slow only */
}

static void test_a_sensor_without_a_thread_cannot_hang(void **state)
{
	(void)state;
	for (int i = 0; i < 100; i++) {
		now_us += 5 * S;
		service_tick(&service, 0, false, now_us);
		assert_string_equal(message(), "WATCHDOG=1");
	}
}

static void test_a_write_to_the_store_that_hangs_ends_the_signs_of_life(void **state)
{
	(void)state;
	assert_true(lives_after(20, true, false));
	assert_true(lives_after(50, true, true)); /* a slow SD card */
	assert_true(lives_after(5, true, false));
	assert_true(lives_after(50, true, true)); /* another write */
	assert_false(lives_after(30, true, true));
}

static void test_time_in_which_the_process_was_stopped_is_no_hang(void **state)
{
	(void)state;
	assert_true(lives_after(20, true, false));
	now_us += 600 * (uint64_t)S; /* a suspended machine */
	service_away(&service, 600 * (uint64_t)S);
	assert_true(lives_after(5, false, false));
	assert_true(lives_after(5, true, true));
	service_away(&service, 600 * (uint64_t)S); /* the write began while the process was stopped */
	assert_true(lives_after(5, true, true));
}

/* Once each time. */
static void test_the_log_says_what_hangs(void **state)
{
	char said[400] = "";
	int ends[2], kept = dup(STDERR_FILENO);

	(void)state;
	assert_int_equal(pipe(ends), 0);
	dup2(ends[1], STDERR_FILENO);
	lives_after(100, false, false);
	lives_after(100, true, true);
	lives_after(100, false, false);
	dup2(kept, STDERR_FILENO);
	close(kept);
	close(ends[1]);
	assert_true(read(ends[0], said, sizeof(said) - 1) > 0);
	close(ends[0]);
	assert_string_equal(said,
		"test_service: the sensor's driver hangs: waiting for the service manager to restart this process\n"
		"test_service: the write to the store hangs: waiting for the service manager to restart this process\n"
		"test_service: the sensor's driver hangs: waiting for the service manager to restart this process\n");
}

int main(void)
{
#define TEST(test) cmocka_unit_test_setup_teardown(test, start_manager, end_manager)
	const struct CMUnitTest tests[] = {
		TEST(test_it_is_ready_once_with_the_sensor_as_status),
		TEST(test_a_status_has_up_to_240_characters),
		TEST(test_an_abstract_socket_is_reached),
		TEST(test_a_sign_of_life_is_given_each_half_of_the_watchdog_s_time),
		TEST(test_without_a_watchdog_or_for_another_process_there_are_none),
		TEST(test_a_socket_that_cannot_be_used_is_none),
		TEST(test_a_name_has_up_to_107_characters),
		TEST(test_a_sensor_s_thread_that_hangs_ends_the_signs_of_life),
		TEST(test_a_sensor_without_a_thread_cannot_hang),
		TEST(test_a_write_to_the_store_that_hangs_ends_the_signs_of_life),
		TEST(test_time_in_which_the_process_was_stopped_is_no_hang),
		TEST(test_the_log_says_what_hangs),
	};

	return cmocka_run_group_tests_name("service", tests, count_descriptors, no_descriptor_is_left);
}
