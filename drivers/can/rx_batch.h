/* drivers/can/rx_batch.h
 * Datagrams of a non-blocking socket, read several at a time, with the time the kernel received
 * them and the number it had to throw away. For level-triggered polling: after a short batch no
 * further read is tried until the next call. */
#ifndef DRIVERS_CAN_RX_BATCH_H
#define DRIVERS_CAN_RX_BATCH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/socket.h>
#include <time.h>

enum { RX_BATCH_LEN = 16, RX_DATAGRAM_MAX = 256 };

struct rx_datagram {
	const char *data;
	size_t size;
	bool truncated; /* it was longer than RX_DATAGRAM_MAX */
	uint64_t t_us;	/* CLOCK_MONOTONIC */
};

struct rx_batch { /* all zeros: empty */
	struct mmsghdr headers[RX_BATCH_LEN];
	struct iovec buffers[RX_BATCH_LEN];
	char data[RX_BATCH_LEN][RX_DATAGRAM_MAX];
	_Alignas(struct cmsghdr) char control[RX_BATCH_LEN]
					     [CMSG_SPACE(sizeof(struct timespec)) + CMSG_SPACE(sizeof(uint32_t))];
	unsigned count, next;
	int64_t realtime_offset_ns; /* CLOCK_REALTIME - CLOCK_MONOTONIC when the batch was read */
	uint64_t read_at_us;
	uint32_t overflows; /* datagrams the kernel dropped since the socket was opened */
};

/** Makes the kernel tell times and overflows, and asks for a receive buffer of 1 MiB. 0 or -errno.
 */
int rx_batch_prepare(int fd);

/** 1 and a datagram, valid until the next call; 0: none left now; -errno. Adds what the kernel
 * dropped to *dropped. */
int rx_batch_next(struct rx_batch *batch, int fd, struct rx_datagram *datagram, uint32_t *dropped);

#endif
