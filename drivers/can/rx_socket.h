/* drivers/can/rx_socket.h
 * A datagram socket that reports when the kernel received each datagram and how many the kernel dropped. It fetches up
 * to a batch of datagrams with one system call. */
#ifndef DRIVERS_CAN_RX_SOCKET_H
#define DRIVERS_CAN_RX_SOCKET_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { RX_SOCKET_BATCH = 16, RX_SOCKET_PER_CALL = 64 };

struct rx_datagram {
	char data[256];
	size_t size;   /* as sent; what exceeds sizeof(data) is lost */
	uint64_t t_us; /* received: CLOCK_MONOTONIC */
};

struct rx_socket { /* start from {.fd = fd} */
	int fd;
	/* PRIVATE */
	uint32_t overflows;	   /* datagrams the kernel has dropped since the socket was opened, as last reported */
	int64_t realtime_ahead_us; /* CLOCK_REALTIME, the clock of the kernel's time stamps, minus CLOCK_MONOTONIC */
	uint64_t realtime_read_us; /* when the difference was read; 0: never */
	unsigned fetched, next;	   /* datagrams in the batch; index of the next to return */
	struct rx_datagram batch[RX_SOCKET_BATCH];
};

/** Prepares a new socket: time stamps, drop counter, a receive buffer of 1 MiB where permitted. 0 or -errno. */
int rx_socket_prepare(int fd);

/** 1 and a datagram, valid until the next call; 0: none now; -errno. Adds the datagrams that the kernel dropped to
 * *dropped. now_us: CLOCK_MONOTONIC, now or a little earlier. Call it until it returns 0: the descriptor is not
 * readable for datagrams of a batch that has been fetched. */
int rx_socket_receive(struct rx_socket *rx, const struct rx_datagram **datagram, uint64_t now_us, uint32_t *dropped);

/** Whether datagram `n` (0, 1, ...) may be read within one call of the port: after RX_SOCKET_PER_CALL only the rest of
 * the batch, so that unwanted datagrams do not keep the caller. */
static inline bool rx_socket_may_read(const struct rx_socket *rx, unsigned n)
{
	return n < RX_SOCKET_PER_CALL || rx->next < rx->fetched;
}

#endif
