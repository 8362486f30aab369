/* gateway/canopen/pdo.h
 * What pdo.c, tpdo.c and rpdo.c call of each other; no other file includes it. */
#ifndef GATEWAY_CANOPEN_PDO_H
#define GATEWAY_CANOPEN_PDO_H

#include "gateway/canopen/service.h"

enum { /* transmission types (CiA 301, 7.5.2.35 and 7.5.2.37) */
	TYPE_SYNC_ACYCLIC = 0,
	TYPE_SYNC_MAX = 240,
	TYPE_RTR_SYNC = 252, /* TPDO: sampled at the SYNC, sent on request */
	TYPE_RTR = 253,	     /* TPDO: sampled and sent on request */
	TYPE_EVENT = 254,
	PDO_BYTES = 8,
};

/** Clears the state of the PDO: operational begins, or a parameter other than the event timer was written. */
void tpdo_restart(struct canopen_node *node, struct tpdo *tpdo);
void rpdo_restart(struct canopen_node *node, struct rpdo *rpdo);
/** The event timer was written: it starts with the next reception. */
void rpdo_stop_timer(struct canopen_node *node, struct rpdo *rpdo);

void tpdo_sync(struct canopen_node *node, uint8_t counter, bool late);
void rpdo_sync(struct canopen_node *node);
uint64_t tpdo_tick(struct canopen_node *node);
uint64_t rpdo_tick(struct canopen_node *node);

static inline bool pdo_event_driven(const struct pdo *pdo)
{
	return *pdo->type >= TYPE_EVENT;
}

static inline uint32_t pdo_can_id(const struct pdo *pdo)
{
	return *pdo->cob_id & COB_ID_MASK;
}

/** A dummy entry of an RPDO mapping (CiA 301, 7.5.2.36): its index is that of a data type, its bytes are skipped. */
static inline bool pdo_is_dummy(const struct od_entry *entry)
{
	return entry->index < 0x1000;
}

#endif
