/* drivers/can/can_link.h
 * The controller behind a SocketCAN interface, by netlink (libsocketcan): bit rate, state, error counters. Changing it
 * needs CAP_NET_ADMIN. vcan has no controller. */
#ifndef DRIVERS_CAN_CAN_LINK_H
#define DRIVERS_CAN_CAN_LINK_H

#include <stdbool.h>
#include <stdint.h>

struct can_link {
	bool controller; /* there is one; the next four are about it */
	int state;	 /* 0 active, 1 warning, 2 passive, 3 bus-off, above: stopped */
	uint32_t bit_s;
	uint8_t tx_errors, rx_errors; /* 0 where the driver does not tell */
	uint64_t frames, bytes;	      /* on this bus since the interface came to be, of all nodes */
};

void can_link_look(const char *interface, struct can_link *link);
/** Stops the interface for the change, which goes for all its users. 0; -EOPNOTSUPP: no controller, or not that bit
 * rate; -EPERM; other -errno. With dry_run nothing changes. */
int can_link_bit_rate(const char *interface, uint32_t bit_s, bool dry_run);
/** Ends bus-off. 0; -EOPNOTSUPP: no controller, or the kernel does it (restart-ms); -EPERM; other -errno. */
int can_link_restart(const char *interface);

/** The limits of a controller (the kernel's struct can_bittiming_const, without those of no use here). */
struct can_link_limits {
	uint32_t clock_hz, brp_min, brp_max, brp_inc;
	uint32_t tseg1_min, tseg1_max, tseg2_min, tseg2_max; /* time quanta */
};
/** Whether some prescaler and number of time quanta give that bit rate to 0.5 %, what CiA 301 and ISO 11898 leave a
 * crystal and more. */
bool can_link_divides(const struct can_link_limits *limits, uint32_t bit_s);

#endif
