/* gateway/snapshot.h
 * The whole configuration in one object (2130h): read as a concise DCF (CiA 302-3), written back to this node or to
 * another one. It holds every object that can be written and stored, in an order in which each single write is
 * allowed: what is in use is switched off first (SYNC, EMCY, second SDO channel, heartbeat consumers, PDOs), then come
 * the values and the mappings, then it is switched on, and last the date (1020h). Identity and measurements are no part
 * of it.
 *
 * A COB-ID that follows the node-ID has bit 29 set and lacks the node-ID (20000080h for EMCY): whoever takes the
 * snapshot adds its own. No object accepts that bit otherwise, so that it cannot be mistaken. */
#ifndef GATEWAY_SNAPSHOT_H
#define GATEWAY_SNAPSHOT_H

#include "od/od.h"

/** Caller-owned. */
struct snapshot {
	struct od *od;
	const uint8_t *node_id; /* of now */
	void *ctx;
	/** Whether the values in the dictionary go together; if so, they are in use from now on. */
	bool (*take)(void *ctx);
	/** What became of a download: OD_OK and the number of entries, or why it was refused, and the entry (0: the
	 * whole). */
	void (*done)(void *ctx, enum od_status status, unsigned entries, uint16_t index, uint8_t sub);

	struct od_domain domain;       /* PRIVATE */
	uint8_t before[OD_DOMAIN_MAX]; /* PRIVATE: the configuration while another one is tried */
};

/** Set the public fields, then this makes it what 2130h reads and writes. */
void snapshot_attach(struct snapshot *snapshot);

/** Bytes written into out[OD_DOMAIN_MAX]. */
size_t snapshot_encode(const struct od *od, uint8_t node_id, uint8_t *out);

#endif
