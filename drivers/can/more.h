/* drivers/can/more.h
 * Keeps a port's epoll descriptor readable while frames wait in the driver itself, which no descriptor tells. Costs
 * system calls when that changes only. */
#ifndef DRIVERS_CAN_MORE_H
#define DRIVERS_CAN_MORE_H

#include <assert.h>
#include <errno.h>
#include <stdbool.h>
#include <stdint.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <unistd.h>

struct more {
	int fd; /* an eventfd, readable while set */
	bool set;
};

/** Puts it into that epoll descriptor. 0 or -errno. */
static inline int more_open(struct more *more, int epoll)
{
	struct epoll_event event = {.events = EPOLLIN};

	more->set = false;
	more->fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
	return more->fd < 0 || epoll_ctl(epoll, EPOLL_CTL_ADD, more->fd, &event) != 0 ? -errno : 0;
}

static inline void more_set(struct more *more, bool set)
{
	uint64_t value = 1;
	ssize_t n;

	if (set == more->set)
		return;
	more->set = set;
	n = set ? write(more->fd, &value, sizeof(value)) : read(more->fd, &value, sizeof(value));
	assert(n == sizeof(value));
	(void)n;
}

#endif
