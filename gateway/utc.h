/* gateway/utc.h
 * Coordinated universal time of the samples (2117h): from the bus (TIME, 1012h), or from the host's clock when that is
 * synchronised; and TIME for others. Passive: clocks come in as values, in CLOCK_MONOTONIC's time. */
#ifndef GATEWAY_UTC_H
#define GATEWAY_UTC_H

#include <stdbool.h>
#include <stdint.h>

#include "gateway/canopen/canopen.h"
#include "od_values.h"

/** The values of 2117h:4. */
enum utc_source { UTC_NONE, UTC_TIME, UTC_HOST };

struct utc {
	/* PRIVATE */
	struct od_values *values;
	struct canopen_node *node;
	int64_t time_offset_us; /* UTC by TIME - CLOCK_MONOTONIC, smoothed */
	uint64_t heard_us;	/* last TIME; 0: none yet */
	int64_t host_offset_us;
	bool host_synchronised;
	int64_t lag_us; /* CLOCK_MONOTONIC - the samples' own time: the least of late */
	uint64_t sample_us;
	bool produces;
	uint64_t produce_us; /* the next TIME */
};

void utc_init(struct utc *utc, struct od_values *values, struct canopen_node *node);
/** TIME came. */
void utc_time(struct utc *utc, uint16_t day, uint32_t ms, uint64_t t_us);
/** What the host's clock is ahead of CLOCK_MONOTONIC. To be told once a second. */
void utc_host_clock(struct utc *utc, bool synchronised, int64_t offset_us);
/** Publishes 2117h for a sample of time `t_us` (its own epoch) that came now. The source of its UTC. */
enum utc_source utc_sample(struct utc *utc, uint64_t t_us, uint64_t now_us);
/** Produces TIME. Returns when to call again at the latest. */
uint64_t utc_tick(struct utc *utc, uint64_t now_us);

#endif
