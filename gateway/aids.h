/* gateway/aids.h
 * External aids: velocity (2070h), heading (2071h) and attitude (2072h) that other devices on the bus measure, and
 * commands (2073h). From the objects to the pipeline, whether an RPDO or an SDO client wrote them.
 *
 * The write of its sigma, the last one of a measurement, makes it take effect. Sigma 0 means no measurement, so that a
 * master can send its PDO cyclically. A missing aid is no fault. A command acts on the rising edge of its bit. One
 * thread. */
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
	uint16_t commands;	      /* 2073h at the last write, for the edges */
	uint8_t reset_command;	      /* 2072h:7, the same */
	bool aided, standstill;	      /* written since the last sample */
	uint64_t used_until_us;	      /* STATUS_EXTERNAL_AID is set until then */
	uint64_t standstill_until_us; /* 2073h bit 1 applies until then */
};

/** Attaches to the dictionary. */
void aids_init(struct aids *aids, struct od *od, struct od_values *values, struct pipeline *pipeline);
/** NMT reset node: no aid was written yet. */
void aids_reset(struct aids *aids);
/** A value in steps of its twin in 16 bits, which saturates. */
int16_t aids_to_16(float value, double step);
/** Before each pipeline_step(). */
void aids_step(struct aids *aids, uint64_t now_us);
/** STATUS_EXTERNAL_AID, or 0. */
unsigned aids_status(const struct aids *aids, uint64_t now_us);

#endif
