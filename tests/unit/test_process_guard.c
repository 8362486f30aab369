/* Signals before and after the loop. Each test is a process of its own, which ends by what it is sent. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include "gateway/process_guard.h"

enum { STILL_RUNS = 77 };

/* With `impatient`, 5 s have passed at once. */
static volatile bool impatient;
static volatile bool rests; /* the guard was told to end */

int sigtimedwait(const sigset_t *set, siginfo_t *info, const struct timespec *timeout)
{
	if (timeout->tv_sec != 5 || timeout->tv_nsec != 0)
		abort();
	if (impatient) {
		errno = EAGAIN;
		return -1;
	}
	int number = (int)syscall(SYS_rt_sigtimedwait, set, info, timeout, _NSIG / 8);
	rests |= number == SIGURG;
	return number;
}

static struct process_guard guard;

struct child {
	pid_t pid;
	int ready, log;
};

/* Runs `body` in a new process; it calls ready() when the signal may come, and does not return. */
static int ready_fd;

static void ready(void)
{
	if (write(ready_fd, "", 1) != 1)
		_exit(99);
}

static struct child start(void (*body)(void))
{
	int ready_pipe[2], log[2];
	char byte;

	assert_int_equal(pipe(ready_pipe), 0);
	assert_int_equal(pipe(log), 0);
	struct child child = {.pid = fork(), .ready = ready_pipe[0], .log = log[0]};
	if (child.pid == 0) {
		dup2(log[1], STDERR_FILENO);
		close(log[1]);
		ready_fd = ready_pipe[1];
		body();
		_exit(98);
	}
	close(ready_pipe[1]);
	close(log[1]);
	assert_int_equal(read(child.ready, &byte, 1), 1);
	return child;
}

/* The exit status (negative: the signal that killed it), after its log was compared. */
static int end(struct child child, const char *said)
{
	char text[512] = "";
	size_t n = 0;
	ssize_t got;
	int status;

	while ((got = read(child.log, text + n, sizeof(text) - 1 - n)) > 0)
		n += (size_t)got;
	assert_int_equal(waitpid(child.pid, &status, 0), child.pid);
	close(child.ready);
	close(child.log);
	assert_string_equal(text, said);
	return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
}

static void wait_for_ever(void)
{
	ready();
	for (;;)
		pause();
}

static void open_a_fifo(void)
{
	process_guard_start(&guard);
	process_guard_opening(&guard, "replay:fifo.csv");
	wait_for_ever();
}

static void test_a_signal_ends_a_start_that_waits_and_the_log_says_for_what(void **state)
{
	static const struct {
		int number;
		const char *log;
	} signals[] = {{SIGTERM, "imu9-gateway: stopping on SIGTERM before the start, opening replay:fifo.csv\n"},
		{SIGINT, "imu9-gateway: stopping on SIGINT before the start, opening replay:fifo.csv\n"}};

	(void)state;
	for (size_t i = 0; i < 2; i++) {
		struct child child = start(open_a_fifo);

		kill(child.pid, signals[i].number);
		assert_int_equal(end(child, signals[i].log), 0);
	}
}

static void open_something_slow(void)
{
	process_guard_opening(&guard, "slcan:/dev/ttyACM0");
	impatient = true;
	process_guard_start(&guard);
	wait_for_ever();
}

static void test_a_start_that_takes_long_says_what_it_opens_once(void **state)
{
	struct child child = start(open_something_slow);
	char text[256];
	ssize_t n = read(child.log, text, sizeof(text) - 1);

	(void)state;
	assert_true(n > 0);
	text[n] = '\0';
	assert_string_equal(
		text, "imu9-gateway: slcan:/dev/ttyACM0: has been opening for seconds; a FIFO waits for its writer\n");
	kill(child.pid, SIGKILL);
	assert_int_equal(end(child, ""), -SIGKILL);
}

/* As the loop reads it, by a descriptor for pending signals. */
static void run_the_loop(void)
{
	sigset_t stop;

	process_guard_start(&guard);
	process_guard_rest(&guard);
	if (!rests) /* it would take the signals */
		_exit(97);
	ready();
	sigemptyset(&stop);
	sigaddset(&stop, SIGTERM);
	_exit(sigwaitinfo(&stop, NULL) == SIGTERM ? STILL_RUNS : 1);
}

static void test_the_loop_takes_its_signals_itself(void **state)
{
	struct child child = start(run_the_loop);

	(void)state;
	kill(child.pid, SIGTERM);
	assert_int_equal(end(child, ""), STILL_RUNS);
}

static void test_sighup_does_not_end_the_process(void **state)
{
	struct child child = start(run_the_loop);

	(void)state;
	kill(child.pid, SIGHUP);
	kill(child.pid, SIGTERM);
	assert_int_equal(end(child, ""), STILL_RUNS);
}

static void stop_and_hang(void)
{
	process_guard_start(&guard);
	process_guard_rest(&guard);
	process_guard_stop(&guard);
	wait_for_ever();
}

static void test_a_second_signal_ends_an_end_that_hangs(void **state)
{
	struct child child = start(stop_and_hang);

	(void)state;
	kill(child.pid, SIGTERM);
	assert_int_equal(end(child, "imu9-gateway: stopping on SIGTERM\n"), 1);
}

static void stop_and_hang_for_5_s(void)
{
	process_guard_start(&guard);
	process_guard_rest(&guard);
	ready();
	impatient = true;
	process_guard_stop(&guard);
	for (;;)
		pause();
}

static void test_a_store_that_hangs_does_not_keep_the_process_from_ending(void **state)
{
	(void)state;
	assert_int_equal(end(start(stop_and_hang_for_5_s),
				 "imu9-gateway: a device or the store did not end within 5 s; stopped without it\n"),
		1);
}

static void start_without_descriptors(void)
{
	struct stat null, opened;
	int bad = 0;

	for (int fd = 0; fd < 3; fd++)
		close(fd);
	process_guard_start(&guard);
	ready();
	stat("/dev/null", &null);
	for (int fd = 0; fd < 3; fd++)
		bad += fstat(fd, &opened) < 0 || opened.st_rdev != null.st_rdev;
	_exit(bad);
}

static void test_closed_standard_descriptors_are_opened_so_that_no_device_gets_one(void **state)
{
	(void)state;
	assert_int_equal(end(start(start_without_descriptors), ""), 0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_signal_ends_a_start_that_waits_and_the_log_says_for_what),
		cmocka_unit_test(test_a_start_that_takes_long_says_what_it_opens_once),
		cmocka_unit_test(test_the_loop_takes_its_signals_itself),
		cmocka_unit_test(test_sighup_does_not_end_the_process),
		cmocka_unit_test(test_a_second_signal_ends_an_end_that_hangs),
		cmocka_unit_test(test_a_store_that_hangs_does_not_keep_the_process_from_ending),
		cmocka_unit_test(test_closed_standard_descriptors_are_opened_so_that_no_device_gets_one),
	};
	static char name[] = "imu9-gateway"; /* what log lines begin with */

	program_invocation_short_name = name;
	return cmocka_run_group_tests(tests, NULL, NULL);
}
