/* drivers/can/can_link.h
 * The controller behind a SocketCAN interface, by netlink: bit rate, state, error counters, statistics. Changing it needs
 * CAP_NET_ADMIN. vcan has none. (Not by libsocketcan: that needs a request for each value, and writes to stderr.) */
#ifndef DRIVERS_CAN_CAN_LINK_H
#define DRIVERS_CAN_CAN_LINK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { CAN_LINK_RATES = 16 };

struct can_link {
	uint64_t frames, bytes;	       /* on this bus since the interface came to be, of all nodes */
	bool controller;	       /* there is one, and all below is about it */
	uint32_t state;		       /* 0 active, 1 warning, 2 passive, 3 bus-off, above: stopped */
	uint32_t bit_s;		       /* 0: not set yet */
	uint16_t tx_errors, rx_errors; /* 0 where the driver does not tell */
	uint32_t restart_ms;	       /* the kernel ends bus-off after that; 0: it does not */
	struct can_link_limits {       /* clock_hz 0: not told */
		uint32_t clock_hz, brp_min, brp_max, brp_inc;
		uint32_t tseg1_min, tseg1_max, tseg2_min, tseg2_max; /* time quanta */
	} limits;
	uint32_t rates[CAN_LINK_RATES]; /* the only bit rates that it has, when there are any */
	size_t rate_count;
};

/** `interface` is its index. One request, some 0.1 ms. 0 or -errno; then *link is empty. */
int can_link_look(int interface, struct can_link *link);
/** Stops the interface for the change, for all its users. 0; -EOPNOTSUPP: no controller, or not that bit rate; -EPERM;
 * other -errno. With dry_run nothing changes. */
int can_link_bit_rate(int interface, uint32_t bit_s, bool dry_run);
/** Ends bus-off. 0; -EOPNOTSUPP: no controller, or the kernel does it (restart-ms); -EPERM; other -errno. */
int can_link_restart(int interface);

/** Whether a controller can be given that bit rate: from its list, or to 0.5 % by some prescaler and number of time
 * quanta. */
bool can_link_has_rate(const struct can_link *link, uint32_t bit_s);

#endif
