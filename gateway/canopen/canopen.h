/* gateway/canopen/canopen.h
 * A CANopen device (CiA 301 V4.2) as a passive core: frames and time go in, frames come out through the CAN port. It
 * never reads a clock, sleeps, allocates or touches a file, so the same code runs in the daemon and, in simulated time,
 * in the scenario tests. One file a service: nmt.c, heartbeat.c (1016h), guard.c, sdo_server.c, pdo.c, tpdo.c, rpdo.c, sync.c, emcy.c,
 * store.c (1010h/1011h), lss.c (CiA 305).
 *
 * Use: canopen_init(), canopen_start(), then canopen_receive() for each frame, canopen_tick() whenever the deadline it
 * returned has come, canopen_sample() after each new sample was published in the dictionary. */
#ifndef GATEWAY_CANOPEN_CANOPEN_H
#define GATEWAY_CANOPEN_CANOPEN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "drivers/ports/can.h"
#include "gateway/canopen/emcy_codes.h"
#include "od/od.h"

enum nmt_state { /* the values that the heartbeat carries */
	NMT_INITIALISING = 0x00,
	NMT_STOPPED = 0x04,
	NMT_OPERATIONAL = 0x05,
	NMT_PRE_OPERATIONAL = 0x7F,
};

enum { CANOPEN_UNCONFIGURED = 255 }; /* the node-ID of a node that waits for one by LSS */

/** What the core asks of the device around it. All may be NULL in tests that do not need them. */
struct canopen_device {
	void *ctx;
	/** 1010h: keep one group (or OD_GROUP_ALL) for good. OD_OK: kept; OD_PENDING: canopen_store_done() will tell,
	 * the SDO answer waits for it; OD_CANNOT_STORE. */
	enum od_status (*store)(void *ctx, enum od_group group);
	/** 1011h: forget what was kept of a group; the defaults hold after the next reset. Same answers. */
	enum od_status (*restore)(void *ctx, enum od_group group);
	/** NMT reset: bring the dictionary back to its power-on values (defaults, then what was stored) for the
	 * communication group (reset communication) or for all (reset node, which also restarts the application). */
	void (*reset)(void *ctx, enum od_group group);
	/** LSS: keeps node-ID (or CANOPEN_UNCONFIGURED) and bit rate (0: as it was kept) for the next start. OD_OK;
	 * OD_PENDING: canopen_lss_stored() will tell, the answer to the master waits for it; else it failed. NULL: the
	 * master is told that this is not supported. */
	enum od_status (*store_lss)(void *ctx, uint8_t node_id, uint32_t bit_s);
	/** LSS: whether the bus can be given this bit rate, and the order to do so now. The core keeps the two switch
	 * delays, and is silent for them. NULL: the bit rate cannot be changed from here. */
	bool (*bit_rate_possible)(void *ctx, uint32_t bit_s);
	void (*set_bit_rate)(void *ctx, uint32_t bit_s);
	/** By how many steps of the mapped integer, or by how much of the mapped real, a value has to move for a TPDO to be
	 * sent by event (more than that). 0: any change counts; INFINITY: none does. NULL: every sample is an event. */
	double (*change_threshold)(void *ctx, const struct od_entry *entry);
	/** TIME came (1012h bit 31): days since 1984-01-01 and ms since midnight, at `t_us`. */
	void (*time)(void *ctx, uint16_t day, uint32_t ms, uint64_t t_us);
	/** Another node sends with `id`, an identifier of this one (EMCY 8150h). For the log. */
	void (*collision)(void *ctx, uint32_t id);
	/** For the log. */
	void (*nmt_changed)(void *ctx, enum nmt_state state);
	void (*error_changed)(void *ctx, uint16_t code, bool set, const uint8_t info[5]);
};

struct canopen_node; /* defined in gateway/canopen/node.h: caller-owned, the fields are the core's */

/** Attaches to the dictionary and checks its communication objects. 0; -EINVAL: bad node-ID; -ENOENT: a mandatory
 * object is missing from the dictionary, -ENOSPC: it has more TPDOs than the core (faults of the EDS). A node without
 * a node-ID (CANOPEN_UNCONFIGURED, and so od_init()) waits for one by LSS, silent; LSS may change it later. */
int canopen_init(struct canopen_node *node, struct od *od, struct can_port *bus, const struct canopen_device *device,
	uint8_t node_id);
/** Sends boot-up and enters pre-operational, or waits for a node-ID. */
void canopen_start(struct canopen_node *node, uint64_t now_us);
void canopen_receive(struct canopen_node *node, const struct can_msg *msg, uint64_t now_us);
/** Returns when it must be called again at the latest (UINT64_MAX: never). Any other call here, and a write to the
 * dictionary, may bring that forward: call it after them, too. */
uint64_t canopen_tick(struct canopen_node *node, uint64_t now_us);
/** A new sample stands in the dictionary: event-driven TPDOs may go out. */
void canopen_sample(struct canopen_node *node, uint64_t now_us);

/** Raises an error: EMCY with `code`, the error register's bits (1001h; bit 0 is added), manufacturer field `info`
 * (5 bytes, or NULL for zeros). An error that stands already is not sent again. */
void canopen_error_set(
	struct canopen_node *node, uint16_t code, uint8_t register_bits, const uint8_t *info, uint64_t now_us);
/** The error is over: when it was the last, EMCY 0000h. */
void canopen_error_clear(struct canopen_node *node, uint16_t code, uint64_t now_us);

/** The bus went off: NMT acts as 1029h says. EMCY 8140h is the device's to raise when it is back. */
void canopen_bus_off(struct canopen_node *node, uint64_t now_us);

/** Ends a store or restore that answered OD_PENDING. */
void canopen_store_done(struct canopen_node *node, enum od_status status, uint64_t now_us);
/** Ends a store_lss() that answered OD_PENDING. */
void canopen_lss_stored(struct canopen_node *node, enum od_status status, uint64_t now_us);
/** A master configures this node by LSS, or the node waits for one to do so. */
bool canopen_lss_active(const struct canopen_node *node);

/** Sends TIME, where 1012h bit 30 and the NMT state want it: true. */
bool canopen_send_time(struct canopen_node *node, uint16_t day, uint32_t ms, uint64_t now_us);

/** Whether this error stands, from any source. */
bool canopen_error_stands(const struct canopen_node *node, uint16_t code);

enum nmt_state canopen_nmt_state(const struct canopen_node *node);

#endif
