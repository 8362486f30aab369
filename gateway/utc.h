/* gateway/utc.h
 * Coordinated universal time of the samples (2117h): from TIME (1012h) on the bus, or from the host's clock when that
 * is synchronised; and the TIME producer. Passive, one thread: clocks are arguments. Times are CLOCK_MONOTONIC in us,
 * UTC in us since 1970 unless said otherwise. */
#ifndef GATEWAY_UTC_H
#define GATEWAY_UTC_H

#include <stdbool.h>
#include <stdint.h>

#include "gateway/canopen/canopen.h"
#include "od_values.h"

/** The values of 2117h:4. */
enum utc_source { UTC_NONE, UTC_TIME, UTC_HOST };

struct utc {
	int64_t taken_us; /* when the last sample was measured, CLOCK_MONOTONIC; 0: none yet */
	/* PRIVATE */
	struct od_values *values;
	struct canopen_node *node;
	int64_t time_offset_us; /* UTC of TIME - CLOCK_MONOTONIC, low-pass filtered */
	uint64_t heard_us;	/* reception of the last TIME; 0: none yet */
	int64_t host_offset_us;
	bool host_synchronised;
	int64_t lag_us; /* CLOCK_MONOTONIC - the time stamps of the samples: recent minimum */
	uint64_t sample_us;
	bool produces;
	uint64_t produce_us; /* the next TIME */
};

void utc_init(struct utc *utc, struct od_values *values, struct canopen_node *node);
/** TIME was received at `t_us`: days since 1984-01-01 and ms of the day. */
void utc_time(struct utc *utc, uint16_t day, uint32_t ms, uint64_t t_us);
/** UTC of the host's clock - CLOCK_MONOTONIC. Once a second. */
void utc_host_clock(struct utc *utc, bool synchronised, int64_t offset_us);
/** Publishes 2117h for a sample with time stamp `t_us` (epoch of the driver) that has just arrived. Returns the source
 * of its UTC. */
enum utc_source utc_sample(struct utc *utc, uint64_t t_us, uint64_t now_us);
/** Produces TIME. Returns the next deadline. */
uint64_t utc_tick(struct utc *utc, uint64_t now_us);

#endif
