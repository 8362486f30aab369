/* gateway/canopen/canopen.h
 * A CANopen device (CiA 301 V4.2, LSS slave of CiA 305) as a passive core: frames and time go in, frames come out
 * through the CAN port. The core reads no clock, does not block, allocates nothing and touches no file, so that the
 * daemon and the scenario tests in simulated time run the same code. There is one file for each service: nmt.c,
 * heartbeat.c, guard.c, sdo_server.c and sdo_block.c, pdo.c, tpdo.c and rpdo.c, sync.c, time.c, emcy.c, collision.c,
 * store.c, lss.c.
 *
 * Use: canopen_init(), canopen_start(); then canopen_receive() for each frame, canopen_sample() after each sample that
 * was published in the dictionary, and canopen_tick() at the deadline it returned and after every other call.
 *
 * Threads: none of its own. All calls for one node, and all access to its dictionary, come from one thread; nodes share
 * nothing. Callbacks are called from within these functions and must not call them for the same node, except
 * canopen_error_set() and canopen_error_clear(). Times are us of one monotonic clock, the one of can_msg.t_us. */
#ifndef GATEWAY_CANOPEN_CANOPEN_H
#define GATEWAY_CANOPEN_CANOPEN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "drivers/ports/can.h"
#include "gateway/canopen/emcy_codes.h"
#include "od/od.h"

/** NMT states, as the heartbeat carries them (CiA 301, 7.2.8.3.2.2). */
enum nmt_state {
	NMT_INITIALISING = 0x00,
	NMT_STOPPED = 0x04,
	NMT_OPERATIONAL = 0x05,
	NMT_PRE_OPERATIONAL = 0x7F,
};

enum { CANOPEN_UNCONFIGURED = 255 }; /* the node-ID of a node that waits for one by LSS (CiA 305) */

/** What the core asks of the device around it. Each callback may be NULL; what the core does then is said below. */
struct canopen_device {
	void *ctx;
	/** 1010h: stores one group, or OD_GROUP_ALL, permanently. OD_OK: stored. OD_PENDING: canopen_store_done()
	 * follows, and the SDO response is sent then. Any other status becomes the SDO abort code. NULL:
	 * OD_CANNOT_STORE. */
	enum od_status (*store)(void *ctx, enum od_group group);
	/** 1011h: discards the stored values of a group; the defaults hold from the next reset on. Status as for
	 * store(). */
	enum od_status (*restore)(void *ctx, enum od_group group);
	/** NMT reset, 10 ms before the boot-up message: brings the dictionary back to its power-on values, that is
	 * defaults and then stored values, for OD_GROUP_COMMUNICATION (reset communication) or OD_GROUP_ALL (reset
	 * node, which also restarts the application). */
	void (*reset)(void *ctx, enum od_group group);
	/** LSS store: keeps node-ID (or CANOPEN_UNCONFIGURED) and bit rate in bit/s (0: unchanged) for the next start.
	 * OD_OK; OD_PENDING: canopen_lss_stored() follows, and the LSS response is sent then; any other status: failed.
	 * NULL: the master receives "not supported". */
	enum od_status (*store_lss)(void *ctx, uint8_t node_id, uint32_t bit_s);
	/** LSS: whether the bus supports this bit rate, and the order to switch to it now. The core observes both
	 * switch delays and sends nothing during them. NULL: the bit rate cannot be changed by LSS. */
	bool (*bit_rate_possible)(void *ctx, uint32_t bit_s);
	void (*set_bit_rate)(void *ctx, uint32_t bit_s);
	/** The change of a mapped value, in steps of an integer or in the unit of a real, above which an event-driven
	 * TPDO is sent. 0: any change; INFINITY: this value never triggers. NULL: every sample is an event. */
	double (*change_threshold)(void *ctx, const struct od_entry *entry);
	/** TIME was received (1012h bit 31): days since 1984-01-01 and ms since midnight, received at `t_us`. */
	void (*time)(void *ctx, uint16_t day, uint32_t ms, uint64_t t_us);
	/** Another node sends with `id`, an identifier of this node (EMCY 8150h was raised). For the log. */
	void (*collision)(void *ctx, uint32_t id);
	/** The NMT state has changed; an error was raised or has ended. For the log. */
	void (*nmt_changed)(void *ctx, enum nmt_state state);
	void (*error_changed)(void *ctx, uint16_t code, bool set, const uint8_t info[5]);
};

/** A master in the same process: what the bus does not bring it of this node. Owned by the caller. */
enum { CANOPEN_LISTENED = 2 };
struct canopen_listener {
	void *ctx;
	/** Identifiers that it wants to be received, too; the caller passes these frames on. */
	uint32_t ids[CANOPEN_LISTENED];
	size_t count;
	/** This node answered LSS. Must not call the core. */
	void (*lss_answered)(void *ctx, const struct can_msg *msg);
	/** The status of a canopen_write() that returned OD_PENDING. */
	void (*stored)(void *ctx, enum od_status status);
};

struct canopen_node; /* gateway/canopen/node.h: owned by the caller, its fields are written by the core alone */

/** Attaches the node to the dictionary, checks its communication objects and sets the receive filter; sends nothing.
 * `od` and `bus` must outlive the node; `device` (NULL: no callbacks) is copied. `node_id` is 1 to 127, or
 * CANOPEN_UNCONFIGURED, and the same that od_init() had. 0; -EINVAL: bad node-ID; -ENOENT: a mandatory object is
 * missing, -ENOSPC: more PDOs than RPDO_MAX or TPDO_MAX (both are faults of the EDS). */
int canopen_init(struct canopen_node *node, struct od *od, struct can_port *bus, const struct canopen_device *device,
	uint8_t node_id);
/** Sends boot-up and enters pre-operational, and operational where 1F80h says so (CiA 301, 7.3.2; CiA 302-2). A node
 * without a node-ID sends nothing and waits for LSS. */
void canopen_start(struct canopen_node *node, uint64_t now_us);
/** Processes one received frame. A frame that is malformed or for nobody here is ignored. */
void canopen_receive(struct canopen_node *node, const struct can_msg *msg, uint64_t now_us);
/** Does what is due by now. Returns the time of the next call at the latest (UINT64_MAX: none is needed). Any other
 * call of the core, and a write to the dictionary, may bring it forward. */
uint64_t canopen_tick(struct canopen_node *node, uint64_t now_us);
/** A new sample was published in the dictionary: event-driven TPDOs may be sent (CiA 301, 7.2.2.2). */
void canopen_sample(struct canopen_node *node, uint64_t now_us);

/** Raises an error (CiA 301, 7.2.7): sends EMCY with `code`, `register_bits` (enum error_register; ERROR_GENERIC is
 * added) and the manufacturer-specific field `info` (5 bytes; NULL: zeros), and records it in 1003h. An error that is
 * active already is not sent again. More than EMCY_ERRORS active errors are counted and otherwise ignored. */
void canopen_error_set(
	struct canopen_node *node, uint16_t code, uint8_t register_bits, const uint8_t *info, uint64_t now_us);
/** The cause of the error is gone. Sends EMCY 0000h when no other error is active. An error with ERROR_COMMUNICATION
 * ends at most once a second; canopen_tick() ends it when that has passed. */
void canopen_error_clear(struct canopen_node *node, uint16_t code, uint64_t now_us);
/** Whether an error with this code is active, from any source. */
bool canopen_error_active(const struct canopen_node *node, uint16_t code);

/** While the interface is down, when frames are lost, EMCYs wait. */
void canopen_bus_down(struct canopen_node *node, bool down);
/** The controller went bus-off: NMT follows 1029h:1 (CiA 301, 7.5.2.32). The device raises EMCY 8140h on recovery. */
void canopen_bus_off(struct canopen_node *node, uint64_t now_us);

/** Ends a store() or restore() that returned OD_PENDING, and sends the SDO response. */
void canopen_store_done(struct canopen_node *node, enum od_status status, uint64_t now_us);
/** Ends a store_lss() that returned OD_PENDING, and sends the LSS response. */
void canopen_lss_stored(struct canopen_node *node, enum od_status status, uint64_t now_us);
/** Whether the node is in LSS configuration state, or waits for a node-ID. */
bool canopen_lss_active(const struct canopen_node *node);

/** Sends TIME (CiA 301, 7.2.6): days since 1984-01-01, ms since midnight. False: nothing was sent, because 1012h bit 30
 * is not set or the NMT state does not allow it. */
bool canopen_send_time(struct canopen_node *node, uint16_t day, uint32_t ms, uint64_t now_us);

/** After canopen_init(), and when its `ids` have changed. `listener` must outlive the node. */
void canopen_listen(struct canopen_node *node, struct canopen_listener *listener);
/** As od_read() and od_write(), with the checks that an SDO makes besides: for clients that are not on the bus. */
enum od_status canopen_read(
	const struct canopen_node *node, uint16_t index, uint8_t sub, void *wire, size_t capacity, size_t *size);
enum od_status canopen_write(
	struct canopen_node *node, uint16_t index, uint8_t sub, const void *wire, size_t size, uint64_t now_us);
/** Whether the node takes part in the bus now: neither before boot-up nor while the bit rate is switched. A node
 * without a node-ID takes LSS only. */
bool canopen_listens(const struct canopen_node *node);
/** The memory of the node, but for its pointers, was replaced by that of another node of the same dictionary: looks up
 * what its PDOs map. */
void canopen_restored(struct canopen_node *node);

enum nmt_state canopen_nmt_state(const struct canopen_node *node);

#endif
