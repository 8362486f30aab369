/* drivers/can/more.h
 * A port's epoll descriptor, and an eventfd in it that keeps it readable while received frames wait in the driver
 * itself. A system call is made only when that changes. */
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

/** Opens both descriptors, which are -1 before. 0 or -errno. */
static inline int more_open(struct more *more, int *epoll)
{
	struct epoll_event event = {.events = EPOLLIN};

	more->set = false;
	*epoll = epoll_create1(EPOLL_CLOEXEC);
	more->fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
	return *epoll < 0 || more->fd < 0 || epoll_ctl(*epoll, EPOLL_CTL_ADD, more->fd, &event) != 0 ? -errno : 0;
}

/** Also valid after more_open() failed or was not called. */
static inline void more_close(struct more *more, int epoll)
{
	if (more->fd >= 0)
		close(more->fd);
	if (epoll >= 0)
		close(epoll);
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
