/* drivers/can/rx_socket.h
 * A datagram socket that tells when the kernel received each datagram and how many it had to throw away. */
#ifndef DRIVERS_CAN_RX_SOCKET_H
#define DRIVERS_CAN_RX_SOCKET_H

#include <stddef.h>
#include <stdint.h>

struct rx_socket {
	int fd;
	uint32_t overflows; /* what the kernel threw away since the socket was opened, as it said last */
};

struct rx_datagram {
	char data[256];
	size_t size;   /* as it was sent: above sizeof(data) the rest is lost */
	uint64_t t_us; /* received: CLOCK_MONOTONIC */
};

/** To be called on a new socket: times, overflows, a receive buffer of 1 MiB where the system allows. 0 or -errno. */
int rx_socket_prepare(int fd);

/** 1 and a datagram; 0: none now; -errno. What the kernel threw away is added to *dropped. */
int rx_socket_receive(struct rx_socket *rx, struct rx_datagram *datagram, uint32_t *dropped);

#endif
