#include "drivers/imu/pace.h"

#include <errno.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

enum { NS_PER_S = 1000000000 };

static int64_t now_ns(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (int64_t)now.tv_sec * NS_PER_S + now.tv_nsec;
}

/* Setting the timer also makes the descriptor unreadable. */
static void wake_at(const struct pace *pace, int64_t at_ns)
{
	struct itimerspec timer = {.it_value = {at_ns / NS_PER_S, (long)(at_ns % NS_PER_S)}};

	timerfd_settime(pace->fd, TFD_TIMER_ABSTIME, &timer, NULL);
}

int pace_start(struct pace *pace)
{
	pace->fd = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
	if (pace->fd < 0)
		return -errno;
	pace->start_ns = now_ns();
	wake_at(pace, pace->start_ns);
	return 0;
}

int64_t pace_since(const struct pace *pace, int64_t due_ns)
{
	int64_t since_ns = now_ns() - pace->start_ns - due_ns;

	if (since_ns < 0)
		wake_at(pace, pace->start_ns + due_ns);
	return since_ns;
}

void pace_stop(struct pace *pace)
{
	close(pace->fd);
}
