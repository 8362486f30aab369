/* gateway/bus_health.h
 * Diagnosis of the CAN bus: load, state and error counters of the controller, lost frames; and the restarts after
 * bus-off. Publishes 2120h and 2122h, raises EMCY 8110h, 8120h and 8140h. Passive like the core: time goes in,
 * deadlines come out. */
#ifndef GATEWAY_BUS_HEALTH_H
#define GATEWAY_BUS_HEALTH_H

#include <stdbool.h>
#include <stdint.h>

#include "drivers/ports/can.h"
#include "gateway/canopen/canopen.h"
#include "gateway/event_log.h"
#include "gateway/record.h"
#include "od_values.h"

struct bus_health {
	/* PRIVATE */
	struct can_port *bus;
	struct canopen_node *node;
	struct od_values *values;
	struct event_log *log;
	struct record *record; /* of the device */
	struct od_hook hook;
	enum can_state seen;
	bool was_off, was_down, overrun, excess_told;
	uint32_t dropped_seen; /* bus->counters.tx_dropped at the last tick */
	uint64_t overrun_us;   /* the last tick that found frames lost */
	struct can_traffic traffic;
	uint64_t poll_us;      /* the last measurement of the load; 0: none yet */
	unsigned tries;	       /* restarts, each less than 2122h:9 after the one before */
	uint64_t restart_us;   /* the next one is due; UINT64_MAX: none */
	uint64_t restarted_us; /* the last one */
	uint64_t now_us;
};

/** Attaches to the dictionary; `node` may be initialised later. */
void bus_health_init(
	struct bus_health *h, struct can_port *bus, struct canopen_node *node, struct od *od, struct event_log *log);
/** Reset node: persistent faults are detected and reported again. */
void bus_health_reset(struct bus_health *h);
/** Returns the next deadline. */
uint64_t bus_health_tick(struct bus_health *h, uint64_t now_us);

/** Bits on the wire of `frames` data frames with 11-bit identifiers and `bytes` data bytes in total. Half of the
 * largest possible number of stuff bits is counted. */
uint64_t bus_health_bits(uint64_t frames, uint64_t bytes);

/** For LSS: whether this bit rate can be set, and setting it. The log says why not. */
bool bus_health_bit_rate_possible(struct bus_health *h, uint32_t bit_s);
void bus_health_set_bit_rate(struct bus_health *h, uint32_t bit_s);

#endif
