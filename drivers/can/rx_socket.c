#include "drivers/can/rx_socket.h"

#include <errno.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>

enum { RECEIVE_BUFFER_BYTES = 1 << 20 };

static int64_t to_us(const struct timespec *t)
{
	return (int64_t)t->tv_sec * 1000000 + t->tv_nsec / 1000;
}

static int64_t clock_us(clockid_t clock)
{
	struct timespec t;

	clock_gettime(clock, &t);
	return to_us(&t);
}

int rx_socket_prepare(int fd)
{
	const int on = 1, size = RECEIVE_BUFFER_BYTES;

	/* FORCE goes beyond net.core.rmem_max but needs CAP_NET_ADMIN. */
	if (setsockopt(fd, SOL_SOCKET, SO_RCVBUFFORCE, &size, sizeof(size)) != 0)
		(void)setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &size, sizeof(size));
	if (setsockopt(fd, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof(on)) != 0 ||
		setsockopt(fd, SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof(on)) != 0)
		return -errno;
	return 0;
}

/* The kernel stamps with CLOCK_REALTIME. An age below zero, or of many seconds, means that this clock was set in
 * between: the time of reading is nearer the truth then. */
static uint64_t monotonic_us(const struct timespec *stamp)
{
	int64_t age_us = clock_us(CLOCK_REALTIME) - to_us(stamp);
	int64_t now_us = clock_us(CLOCK_MONOTONIC);

	return (uint64_t)(age_us < 0 || age_us > 10000000 ? now_us : now_us - age_us);
}

static void read_control(struct rx_socket *rx, struct msghdr *header, struct rx_datagram *datagram, uint32_t *dropped)
{
	for (struct cmsghdr *c = CMSG_FIRSTHDR(header); c != NULL; c = CMSG_NXTHDR(header, c)) {
		struct timespec stamp;
		uint32_t overflows;

		if (c->cmsg_level != SOL_SOCKET)
			continue;
		if (c->cmsg_type == SO_TIMESTAMPNS) {
			memcpy(&stamp, CMSG_DATA(c), sizeof(stamp));
			datagram->t_us = monotonic_us(&stamp);
		} else if (c->cmsg_type == SO_RXQ_OVFL) {
			memcpy(&overflows, CMSG_DATA(c), sizeof(overflows));
			*dropped += overflows - rx->overflows;
			rx->overflows = overflows;
		}
	}
}

int rx_socket_receive(struct rx_socket *rx, struct rx_datagram *datagram, uint32_t *dropped)
{
	_Alignas(struct cmsghdr) char control[CMSG_SPACE(sizeof(struct timespec)) + CMSG_SPACE(sizeof(uint32_t))];
	struct iovec buffer = {datagram->data, sizeof(datagram->data)};
	struct msghdr header = {
		.msg_iov = &buffer,
		.msg_iovlen = 1,
		.msg_control = control,
		.msg_controllen = sizeof(control),
	};
	ssize_t size = recvmsg(rx->fd, &header, MSG_DONTWAIT | MSG_TRUNC);

	if (size < 0)
		return errno == EAGAIN ? 0 : -errno;
	datagram->size = (size_t)size;
	datagram->t_us = 0;
	read_control(rx, &header, datagram, dropped);
	if (datagram->t_us == 0) /* not stamped */
		datagram->t_us = (uint64_t)clock_us(CLOCK_MONOTONIC);
	return 1;
}
