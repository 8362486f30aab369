/* gateway/canopen/client/lss_master.h
 * LSS master (CiA 305): finds nodes by their LSS address, and configures node-ID and bit rate. A passive core: frames
 * and time go in, frames go out; one service at a time.
 *
 * Use: lss_master_init(), then a function that starts a service. While `result` is LSS_RUNNING, give every received
 * frame to lss_master_receive(), and call lss_master_tick() at the time that it returned last. Times are us of one
 * monotonic clock. One thread. */
#ifndef GATEWAY_CANOPEN_CLIENT_LSS_MASTER_H
#define GATEWAY_CANOPEN_CLIENT_LSS_MASTER_H

#include <stdbool.h>
#include <stdint.h>

#include "drivers/ports/can.h"

enum { LSS_VENDOR, LSS_PRODUCT, LSS_REVISION, LSS_SERIAL, LSS_ADDRESS };

enum lss_result {
	LSS_IDLE,
	LSS_RUNNING,
	LSS_DONE,
	LSS_REFUSED,   /* `error` is the node's error code */
	LSS_NO_ANSWER, /* in time; of a fastscan: there is no node */
	LSS_LOST,      /* fastscan: nodes answered, but none is confirmed */
};

/** Fastscan, for each part of the LSS address. */
enum lss_scan { LSS_SCAN, LSS_IGNORE, LSS_MATCH };

struct lss_master {
	enum lss_result result;
	uint8_t error;
	uint32_t value;		       /* of an inquiry */
	uint32_t address[LSS_ADDRESS]; /* of a fastscan: the node that was found */
	uint64_t timeout_us;	       /* for an answer; the caller may change it between two services */

	/* PRIVATE */
	void (*send)(void *ctx, const struct can_msg *msg, uint64_t now_us);
	void *ctx;
	uint8_t expected; /* command of the answer */
	bool confirmed;	  /* the answer has an error code */
	bool answered;
	uint8_t answer[8];
	uint64_t next_us;
	enum { SCAN_NONE, SCAN_RESET, SCAN_BITS, SCAN_CONFIRM } scanning;
	enum lss_scan how[LSS_ADDRESS];
	uint8_t part, bit;
};

/** `send` gets each frame, for the bus; it must not call the master. */
void lss_master_init(
	struct lss_master *m, void (*send)(void *ctx, const struct can_msg *msg, uint64_t now_us), void *ctx);

/** Unconfirmed: done at once. */
void lss_master_switch_global(struct lss_master *m, bool configuration, uint64_t now_us);
void lss_master_activate_bit_rate(struct lss_master *m, uint16_t delay_ms, uint64_t now_us);
/** The node with this LSS address enters configuration state. */
void lss_master_switch_selective(struct lss_master *m, const uint32_t address[LSS_ADDRESS], uint64_t now_us);
/** Of nodes in configuration state. */
void lss_master_configure_node_id(struct lss_master *m, uint8_t node_id, uint64_t now_us);
void lss_master_configure_bit_rate(struct lss_master *m, uint8_t table, uint8_t index, uint64_t now_us);
void lss_master_store(struct lss_master *m, uint64_t now_us);
/** `part`: LSS_VENDOR to LSS_SERIAL, or LSS_ADDRESS: the node-ID. */
void lss_master_inquire(struct lss_master *m, uint8_t part, uint64_t now_us);
/** Finds one node without a node-ID, which then is in configuration state. `match` has the parts that are LSS_MATCH.
 * Each question without an answer takes the timeout; one with an answer a quarter of it, in which the others may
 * answer, too. */
void lss_master_fastscan(
	struct lss_master *m, const enum lss_scan how[LSS_ADDRESS], const uint32_t match[LSS_ADDRESS], uint64_t now_us);

/** Any frame may be given. Sends nothing. */
void lss_master_receive(struct lss_master *m, const struct can_msg *msg, uint64_t now_us);
/** Returns the time of the next call at the latest; UINT64_MAX: none is needed. */
uint64_t lss_master_tick(struct lss_master *m, uint64_t now_us);

#endif
