/* The timer of sources that deliver in real time: due times count from the start. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <stdbool.h>
#include <sys/timerfd.h>
#include <time.h>

#include "drivers/imu/pace.h"
#include "tests/unit/descriptors.h"

static struct timespec now = {1000, 999999999};
static struct itimerspec timer; /* as set last */
static bool no_timer;

/* Replace those of the system. cmocka looks at other clocks, too. */
int clock_gettime(clockid_t clock, struct timespec *time)
{
	*time = clock == CLOCK_MONOTONIC ? now : (struct timespec){0};
	return 0;
}

int timerfd_create(int clock, int flags)
{
	assert_int_equal(clock, CLOCK_MONOTONIC);
	assert_int_equal(flags, TFD_NONBLOCK | TFD_CLOEXEC);
	errno = EMFILE;
	return no_timer ? -1 : 12345;
}

int timerfd_settime(int fd, int flags, const struct itimerspec *new, struct itimerspec *old)
{
	assert_int_equal(fd, 12345);
	assert_int_equal(flags, TFD_TIMER_ABSTIME);
	assert_null(old);
	timer = *new;
	return 0;
}

static void assert_wakes_at(time_t s, long ns)
{
	assert_int_equal(timer.it_value.tv_sec, s);
	assert_int_equal(timer.it_value.tv_nsec, ns);
	assert_int_equal(timer.it_interval.tv_sec, 0);
	assert_int_equal(timer.it_interval.tv_nsec, 0);
}

static void test_the_first_wake_is_at_once(void **state)
{
	struct pace pace;

	(void)state;
	assert_int_equal(pace_start(&pace), 0);
	assert_wakes_at(1000, 999999999);
}

static void test_what_is_due_later_sets_the_timer(void **state)
{
	struct pace pace;

	(void)state;
	assert_int_equal(pace_start(&pace), 0);
	assert_true(pace_since(&pace, 1) == -1);
	assert_wakes_at(1001, 0);
	now.tv_sec++;
	assert_true(pace_since(&pace, 4500000000) == -3500000000);
	assert_wakes_at(1005, 499999999);
	now.tv_sec--;
}

static void test_what_is_due_now_or_was_leaves_the_timer(void **state)
{
	struct pace pace;

	(void)state;
	assert_int_equal(pace_start(&pace), 0);
	timer.it_value.tv_sec = 7;
	assert_true(pace_since(&pace, 0) == 0);
	now.tv_sec += 3;
	assert_true(pace_since(&pace, 500000000) == 2500000000);
	assert_int_equal(timer.it_value.tv_sec, 7);
	now.tv_sec -= 3;
}

static void test_without_a_timer_it_does_not_start(void **state)
{
	struct pace pace;

	(void)state;
	no_timer = true;
	assert_int_equal(pace_start(&pace), -EMFILE);
	no_timer = false;
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_first_wake_is_at_once),
		cmocka_unit_test(test_what_is_due_later_sets_the_timer),
		cmocka_unit_test(test_what_is_due_now_or_was_leaves_the_timer),
		cmocka_unit_test(test_without_a_timer_it_does_not_start),
	};

	return cmocka_run_group_tests_name("pace", tests, count_descriptors, no_descriptor_is_left);
}
