/* gateway/snapshot.h
 * The whole configuration in one object (2130h): read as a concise DCF (CiA 302-3), written to this node or to another
 * one. It holds every object that can be written and stored, in an order in which each single write is allowed: first
 * the services are disabled (SYNC, EMCY, second SDO channel, heartbeat consumers, PDOs), then come values and mappings,
 * then they are enabled, and last the date (1020h). It has neither identity nor measurements.
 *
 * A COB-ID that contains the node-ID has bit 29 set and lacks the node-ID (20000080h for EMCY): the node that receives
 * the snapshot adds its own. No object accepts this bit otherwise, so it is unambiguous. One thread. */
#ifndef GATEWAY_SNAPSHOT_H
#define GATEWAY_SNAPSHOT_H

#include "od/od.h"

/** Caller-owned. */
struct snapshot {
	struct od *od;
	const uint8_t *node_id; /* the present one */
	void *ctx;
	/** Applies the values in the dictionary; false, and nothing applied, when they are inconsistent. */
	bool (*apply)(void *ctx);
	/** The result of a download: OD_OK and the number of entries, or why it was refused and the entry (0: as a
	 * whole). */
	void (*done)(void *ctx, enum od_status status, unsigned entries, uint16_t index, uint8_t sub);

	struct od_domain domain;       /* PRIVATE */
	uint8_t before[OD_DOMAIN_MAX]; /* PRIVATE: the previous configuration during a download */
};

/** Attaches 2130h to the dictionary. The public fields are set before. */
void snapshot_attach(struct snapshot *snapshot);

/** Bytes written into out[OD_DOMAIN_MAX]. */
size_t snapshot_encode(const struct od *od, uint8_t node_id, uint8_t *out);

#endif
