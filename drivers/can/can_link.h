/* drivers/can/can_link.h
 * The controller behind a SocketCAN interface, by netlink: bit rate, state, error counters, statistics. Changing it
 * needs CAP_NET_ADMIN. vcan has none. (libsocketcan needs a request for each value and writes to stderr.) */
#ifndef DRIVERS_CAN_CAN_LINK_H
#define DRIVERS_CAN_CAN_LINK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { CAN_LINK_RATES = 16 };

struct can_link {
	uint64_t frames, bytes;	       /* of all nodes on this bus, since the interface exists */
	bool controller;	       /* there is one: the members below are its */
	uint32_t state;		       /* 0 active, 1 warning, 2 passive, 3 bus-off, above: stopped */
	uint32_t bit_s;		       /* 0: not set yet */
	uint16_t tx_errors, rx_errors; /* 0 where the driver does not report them */
	uint32_t restart_ms;	       /* the kernel ends bus-off after this time; 0: it does not */
	struct can_link_limits {       /* clock_hz 0: not reported */
		uint32_t clock_hz, brp_min, brp_max, brp_inc;
		uint32_t tseg1_min, tseg1_max, tseg2_min, tseg2_max; /* time quanta */
	} limits;
	uint32_t rates[CAN_LINK_RATES]; /* the only bit rates it supports; rate_count 0: no such list */
	size_t rate_count;
};

/** `interface` is its index. One request, some 0.1 ms. 0 or -errno; then *link is empty. */
int can_link_look(int interface, struct can_link *link);
/** Sets the bit rate; the interface is down meanwhile, for all its users. 0; -EOPNOTSUPP: no controller, or it does not
 * support this bit rate; -EPERM; other -errno. With dry_run nothing changes. */
int can_link_bit_rate(int interface, uint32_t bit_s, bool dry_run);
/** Ends bus-off. 0; -EOPNOTSUPP: no controller, or the kernel does it (restart-ms); -EPERM; other -errno. */
int can_link_restart(int interface);

/** Whether the controller supports this bit rate: it is in its list, or a prescaler and a number of time quanta come
 * within 0.5 % of it. */
bool can_link_has_rate(const struct can_link *link, uint32_t bit_s);

#endif
