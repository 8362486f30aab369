/* gateway/aids.h
 * What other devices on the bus know better than this one: velocity (2070h), heading (2071h), attitude (2072h), and what
 * they command (2073h). From the objects to the pipeline, whoever wrote them: an RPDO, an SDO client, Modbus.
 *
 * A measurement takes effect with its sigma, which is written last; sigma 0 says that there is none just now, so that a
 * master may send its PDO all the time. An aid that stays away is just not used any more. Commands act when their bit
 * goes from 0 to 1. */
#ifndef GATEWAY_AIDS_H
#define GATEWAY_AIDS_H

#include "model/pipeline.h"
#include "od/od.h"
#include "od_values.h"

struct aids { /* PRIVATE */
	struct od_hook hook;
	struct od *od;
	struct od_values *values;
	struct pipeline *pipeline;
	uint16_t commands;	      /* as they were last: 2073h */
	uint8_t reset_command;	      /* and 2072h:7 */
	bool told, stands;	      /* since the last sample */
	uint64_t used_until_us;	      /* the status says so */
	uint64_t standstill_until_us; /* 2073h bit 1 */
};

/** Attaches to the dictionary. */
void aids_init(struct aids *aids, struct od *od, struct od_values *values, struct pipeline *pipeline);
/** NMT reset node: nothing was told yet. */
void aids_reset(struct aids *aids);
/** Before the pipeline takes a sample. */
void aids_step(struct aids *aids, uint64_t now_us);
/** STATUS_EXTERNAL_AID, or 0. */
unsigned aids_status(const struct aids *aids, uint64_t now_us);

#endif
