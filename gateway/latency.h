/* gateway/latency.h
 * Where the time goes, as histograms that are read over the bus:
 *
 *   2149h  age of the sample at its TPDOs: from its measurement until they were handed to the driver of the bus [us];
 *          one for all TPDOs that are sent together, also of the same sample again
 *   214Ah  SYNC to TPDO: from the reception of a SYNC (time stamp of the kernel or adapter), or from sending one, until
 *          all its TPDOs were handed to the driver [us]
 *   214Bh  one turn of the loop, from the event that woke it (a frame: its time stamp) until it waits again [us]
 *   2151h, 2152h, 2153h  of each sample: reading it from the driver, the pipeline, the rest [ns]
 *
 * It measures only when it is given a clock: with none, in a replay, all stay empty. No value of the device depends on
 * it. One thread. */
#ifndef GATEWAY_LATENCY_H
#define GATEWAY_LATENCY_H

#include <stdint.h>

#include "gateway/canopen/node.h"
#include "gateway/histogram.h"
#include "od/od.h"

enum latency_kind {
	LATENCY_SAMPLE_AGE,
	LATENCY_SYNC,
	LATENCY_LOOP,
	LATENCY_READ,
	LATENCY_FILTER,
	LATENCY_PUBLISH,
	LATENCY_KINDS
};

/** Caller-owned. Zeroed: without a clock. */
struct latency {
	/** The clock of all times of the device, in ns; set by the process. NULL: nothing is measured. */
	uint64_t (*clock_ns)(void *ctx);
	void *clock_ctx;
	/* PRIVATE */
	struct latency_object {
		struct histogram histogram;
		uint32_t *count, *minimum, *maximum; /* values of the dictionary */
		struct od_domain domain;
	} objects[LATENCY_KINDS];
	struct od_hook hooks[2];
	uint64_t mark_ns;
	uint32_t tpdos, syncs; /* as of the last latency_sent() */
};

/** Attaches the objects. */
void latency_attach(struct latency *l, struct od *od);

/** The process has read the clock: a stage of a sample may begin. */
void latency_mark(struct latency *l, uint64_t now_ns);
/** READ, FILTER and PUBLISH: the stage has ended, and the next one begins. */
void latency_stage(struct latency *l, enum latency_kind kind);
/** LOOP: a turn that began then has ended; 0: there was none. */
void latency_loop(struct latency *l, uint64_t begun_us);
/** SAMPLE_AGE and SYNC, when TPDOs were sent since the last call. `taken_us`: when the sample that they carry was
 * measured; 0: there was none yet. */
void latency_sent(struct latency *l, const struct canopen_node *node, uint64_t taken_us);

#endif
