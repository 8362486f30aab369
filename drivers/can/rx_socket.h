/* drivers/can/rx_socket.h
 * A datagram socket that tells when the kernel received each datagram and how many it had to throw away. It fetches all
 * that wait by one system call, and reads no clock for each. */
#ifndef DRIVERS_CAN_RX_SOCKET_H
#define DRIVERS_CAN_RX_SOCKET_H

#include <stddef.h>
#include <stdint.h>

enum { RX_SOCKET_BATCH = 16 };

struct rx_datagram {
	char data[256];
	size_t size;   /* as it was sent: above sizeof(data) the rest is lost */
	uint64_t t_us; /* received: CLOCK_MONOTONIC */
};

struct rx_socket { /* start from {.fd = fd} */
	int fd;
	/* PRIVATE */
	uint32_t overflows;	   /* what the kernel threw away since the socket was opened, as it said last */
	int64_t realtime_ahead_us; /* CLOCK_REALTIME, which the kernel stamps with, less CLOCK_MONOTONIC */
	uint64_t realtime_read_us; /* when that was read; 0: never */
	unsigned fetched, next;	   /* datagrams of the batch: all, and those given already */
	struct rx_datagram batch[RX_SOCKET_BATCH];
};

/** To be called on a new socket: times, overflows, a receive buffer of 1 MiB where the system allows. 0 or -errno. */
int rx_socket_prepare(int fd);

/** 1 and a datagram, valid until the next call; 0: none now; -errno. What the kernel threw away is added to *dropped.
 * now_us: CLOCK_MONOTONIC, of this moment or a little before. Call until it says 0: the descriptor does not tell of what
 * was fetched already. */
int rx_socket_receive(struct rx_socket *rx, const struct rx_datagram **datagram, uint64_t now_us, uint32_t *dropped);

#endif
