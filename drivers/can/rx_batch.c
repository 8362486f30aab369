#include "drivers/can/rx_batch.h"

#include <errno.h>
#include <string.h>

enum { RECEIVE_BUFFER_BYTES = 1 << 20 };

static int64_t clock_ns(clockid_t clock)
{
	struct timespec t;

	clock_gettime(clock, &t);
	return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

int rx_batch_prepare(int fd)
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

static int fill(struct rx_batch *batch, int fd)
{
	int count;

	for (size_t i = 0; i < RX_BATCH_LEN; i++) {
		batch->buffers[i] = (struct iovec){batch->data[i], RX_DATAGRAM_MAX};
		batch->headers[i].msg_hdr = (struct msghdr){
			.msg_iov = &batch->buffers[i],
			.msg_iovlen = 1,
			.msg_control = batch->control[i],
			.msg_controllen = sizeof(batch->control[i]),
		};
	}
	batch->next = batch->count = 0;
	count = recvmmsg(fd, batch->headers, RX_BATCH_LEN, MSG_DONTWAIT, NULL);
	if (count < 0)
		return -errno;
	batch->count = (unsigned)count;
	batch->read_at_us = (uint64_t)clock_ns(CLOCK_MONOTONIC) / 1000;
	batch->realtime_offset_ns = clock_ns(CLOCK_REALTIME) - (int64_t)batch->read_at_us * 1000;
	return count;
}

/* The kernel stamps with CLOCK_REALTIME. A stamp from the future, or of long ago, means that this
 * clock was set in between: the time of reading is nearer the truth then. */
static uint64_t monotonic_us(const struct rx_batch *batch, const struct timespec *stamp)
{
	int64_t t_us = ((int64_t)stamp->tv_sec * 1000000000 + stamp->tv_nsec - batch->realtime_offset_ns) / 1000;
	int64_t age_us = (int64_t)batch->read_at_us - t_us;

	return age_us < 0 || age_us > 1000000 ? batch->read_at_us : (uint64_t)t_us;
}

static void read_control(struct rx_batch *batch, struct msghdr *header, uint64_t *t_us, uint32_t *dropped)
{
	for (struct cmsghdr *c = CMSG_FIRSTHDR(header); c != NULL; c = CMSG_NXTHDR(header, c)) {
		struct timespec stamp;
		uint32_t overflows;

		if (c->cmsg_level != SOL_SOCKET)
			continue;
		if (c->cmsg_type == SO_TIMESTAMPNS) {
			memcpy(&stamp, CMSG_DATA(c), sizeof(stamp));
			*t_us = monotonic_us(batch, &stamp);
		} else if (c->cmsg_type == SO_RXQ_OVFL) {
			memcpy(&overflows, CMSG_DATA(c), sizeof(overflows));
			*dropped += overflows - batch->overflows;
			batch->overflows = overflows;
		}
	}
}

int rx_batch_next(struct rx_batch *batch, int fd, struct rx_datagram *datagram, uint32_t *dropped)
{
	struct mmsghdr *header;

	if (batch->next == batch->count) {
		bool drained = batch->count > 0 && batch->count < RX_BATCH_LEN;
		int result;

		batch->count = batch->next = 0;
		if (drained)
			return 0;
		result = fill(batch, fd);
		if (result < 0)
			return result == -EAGAIN ? 0 : result;
	}
	header = &batch->headers[batch->next];
	datagram->data = batch->data[batch->next];
	datagram->size = header->msg_len;
	datagram->truncated = (header->msg_hdr.msg_flags & MSG_TRUNC) != 0;
	datagram->t_us = batch->read_at_us;
	read_control(batch, &header->msg_hdr, &datagram->t_us, dropped);
	batch->next++;
	return 1;
}
