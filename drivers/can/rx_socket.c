#include "drivers/can/rx_socket.h"

#include <errno.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>

enum { RECEIVE_BUFFER_BYTES = 1 << 20 };

/* The difference of the two clocks changes only when CLOCK_REALTIME is set. (They are compared at the first datagram,
 * too: CLOCK_MONOTONIC is beyond a second then.) */
enum { CLOCKS_AGREE_US = 1000000, AHEAD_MAX_US = 1000000, AGE_MAX_US = 10000000 };

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

	/* FORCE exceeds net.core.rmem_max but needs CAP_NET_ADMIN */
	if (setsockopt(fd, SOL_SOCKET, SO_RCVBUFFORCE, &size, sizeof(size)) != 0)
		(void)setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &size, sizeof(size));
	if (setsockopt(fd, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof(on)) != 0 ||
		setsockopt(fd, SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof(on)) != 0)
		return -errno;
	return 0;
}

/* The best of three, since the process can lose the processor between the clocks. */
static int64_t realtime_ahead_us(void)
{
	int64_t ahead_us = 0, shortest_us = INT64_MAX;

	for (int i = 0; i < 3; i++) {
		const int64_t before_us = clock_us(CLOCK_MONOTONIC), realtime_us = clock_us(CLOCK_REALTIME),
			      took_us = clock_us(CLOCK_MONOTONIC) - before_us;

		if (took_us < shortest_us) {
			shortest_us = took_us;
			ahead_us = realtime_us - before_us - took_us / 2;
		}
	}
	return ahead_us;
}

static void compare_clocks(struct rx_socket *rx, uint64_t now_us)
{
	if (now_us - rx->realtime_read_us < CLOCKS_AGREE_US)
		return;
	rx->realtime_ahead_us = realtime_ahead_us();
	rx->realtime_read_us = now_us;
}

/* `now_us` may be a little old. A time stamp far after it, or many seconds before it, means that CLOCK_REALTIME was set
 * meanwhile: now_us is the better time then. */
static uint64_t monotonic_us(const struct rx_socket *rx, const struct timespec *stamp, uint64_t now_us)
{
	int64_t received_us = to_us(stamp) - rx->realtime_ahead_us;
	int64_t age_us = (int64_t)now_us - received_us;

	return age_us < -AHEAD_MAX_US || age_us > AGE_MAX_US ? now_us : (uint64_t)received_us;
}

static void read_control(
	struct rx_socket *rx, struct msghdr *header, struct rx_datagram *datagram, uint64_t now_us, uint32_t *dropped)
{
	for (struct cmsghdr *c = CMSG_FIRSTHDR(header); c != NULL; c = CMSG_NXTHDR(header, c)) {
		struct timespec stamp;
		uint32_t overflows;

		if (c->cmsg_level != SOL_SOCKET)
			continue;
		if (c->cmsg_type == SO_TIMESTAMPNS) {
			memcpy(&stamp, CMSG_DATA(c), sizeof(stamp));
			datagram->t_us = monotonic_us(rx, &stamp, now_us);
		} else if (c->cmsg_type == SO_RXQ_OVFL) {
			memcpy(&overflows, CMSG_DATA(c), sizeof(overflows));
			*dropped += overflows - rx->overflows;
			rx->overflows = overflows;
		}
	}
}

/* Fetches a batch. The number of datagrams, or -errno. */
static int fetch(struct rx_socket *rx, uint64_t now_us, uint32_t *dropped)
{
	_Alignas(struct cmsghdr) char control[RX_SOCKET_BATCH]
					     [CMSG_SPACE(sizeof(struct timespec)) + CMSG_SPACE(sizeof(uint32_t))];
	struct mmsghdr headers[RX_SOCKET_BATCH];
	struct iovec buffers[RX_SOCKET_BATCH];
	int count;

	for (int i = 0; i < RX_SOCKET_BATCH; i++) {
		buffers[i] = (struct iovec){rx->batch[i].data, sizeof(rx->batch[i].data)};
		headers[i].msg_hdr = (struct msghdr){.msg_iov = &buffers[i],
			.msg_iovlen = 1,
			.msg_control = control[i],
			.msg_controllen = sizeof(control[i])};
	}
	count = recvmmsg(rx->fd, headers, RX_SOCKET_BATCH, MSG_DONTWAIT | MSG_TRUNC, NULL);
	if (count < 0)
		return errno == EAGAIN ? 0 : -errno;
	compare_clocks(rx, now_us);
	for (int i = 0; i < count; i++) {
		rx->batch[i].size = headers[i].msg_len;
		rx->batch[i].t_us = now_us;
		read_control(rx, &headers[i].msg_hdr, &rx->batch[i], now_us, dropped);
	}
	return count;
}

int rx_socket_receive(struct rx_socket *rx, const struct rx_datagram **datagram, uint64_t now_us, uint32_t *dropped)
{
	if (rx->next == rx->fetched) {
		/* a batch that was not full was the last one */
		bool drained = rx->fetched % RX_SOCKET_BATCH != 0;
		int count = drained ? 0 : fetch(rx, now_us, dropped);

		rx->next = 0;
		rx->fetched = count > 0 ? (unsigned)count : 0;
		if (count <= 0)
			return count;
	}
	*datagram = &rx->batch[rx->next++];
	return 1;
}
