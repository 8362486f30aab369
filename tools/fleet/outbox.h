/* tools/fleet/outbox.h
 * What waits for the broker, in order. A record goes to the broker at once as long as it takes them, and is kept in
 * memory until it is acknowledged. When the broker is away, does not acknowledge for a second, or the memory is full,
 * what is in memory and all that follows goes through the spool, until that is empty again. Passive: time, connection
 * and acknowledgements are arguments; one thread. */
#ifndef TOOLS_FLEET_OUTBOX_H
#define TOOLS_FLEET_OUTBOX_H

#include "tools/fleet/record.h"
#include "tools/fleet/spool.h"

enum { OUTBOX_WINDOW = 256, OUTBOX_SYNC_US = 1000000 };

struct outbox_port {
	void *ctx;
	/** Publishes a record. `late`: it comes from the spool. The number of the acknowledgement that will come; 0: it
	 * needs none; -1: not now, the connection is about to end. */
	long (*send)(void *ctx, const uint8_t *record, size_t size, bool late);
};

struct outbox {
	uint64_t sent, delivered; /* records */
	uint64_t lost;		  /* by an error of the disk while the broker was away */

	/* PRIVATE */
	const struct outbox_port *port;
	struct spool *spool;
	double rate_hz; /* of records from the spool */
	bool connected;
	struct outbox_entry {
		long acknowledgement;
		bool acked, spooled;
		struct spool_position at; /* spooled */
		uint64_t sent_us;
		size_t size;
		uint8_t bytes[RECORD_MAX];
	} window[OUTBOX_WINDOW]; /* sent, not acknowledged; oldest first */
	size_t first, count;
	uint64_t next_us; /* the next record from the spool */
	uint64_t sync_us;
};

/** `port` and `spool` must outlive it. `rate_hz`: of records from the spool, at most. */
void outbox_init(struct outbox *o, const struct outbox_port *port, struct spool *spool, double rate_hz);
/** A new record, newer than all before. */
void outbox_put(struct outbox *o, const uint8_t *record, size_t size, uint64_t now_us);
void outbox_connected(struct outbox *o, uint64_t now_us);
void outbox_disconnected(struct outbox *o);
void outbox_acked(struct outbox *o, long acknowledgement);
/** Sends what is due, and synchronises the spool once a second. Returns the next deadline. */
uint64_t outbox_tick(struct outbox *o, uint64_t now_us);

#endif
