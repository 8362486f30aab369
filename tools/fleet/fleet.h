/* tools/fleet/fleet.h
 * All nodes of a bus: finds them by their frames, decodes each by its EDS and the mapping that is read from it
 * (tools/lib/watch.h), puts the PDOs of one sample together, and says what is to be published. Passive: frames, time
 * and the offset to UTC are arguments; records go to a callback. One thread.
 *
 * A sample is what the PDOs with the same sample counter have. It is complete when all PDOs have come that the sample
 * before had, when the counter changes, or after SAMPLE_US. A PDO without a counter joins the sample that is open. */
#ifndef TOOLS_FLEET_FLEET_H
#define TOOLS_FLEET_FLEET_H

#include "drivers/ports/can.h"
#include "od/od.h"
#include "tools/fleet/record.h"
#include "tools/lib/watch.h"

enum { FLEET_NODES = 128, FLEET_THRESHOLDS = 32, FLEET_IDS = 0x800, FLEET_SAMPLE_US = 20000 };

struct fleet_config {
	const struct od_table *tables[FLEET_NODES]; /* by node-ID; NULL: this node is not wanted */
	bool expected[FLEET_NODES];		    /* is asked although it was not heard yet */
	bool passive;				    /* sends nothing; the mapping is the default of the EDS */
	double hz;				    /* samples a second of each node, at most; 0: all */
	/** A sample is published when a value has changed by more than its threshold since the last one that was, or
	 * `at_least_s` have passed. None: all are. */
	struct fleet_threshold {
		uint16_t index;
		uint8_t sub; /* 0: all of them */
		double change;
	} thresholds[FLEET_THRESHOLDS];
	size_t threshold_count;
	double at_least_s;
};

struct fleet_sink {
	void *ctx;
	void (*record)(void *ctx, const struct record *record);
};

struct fleet_node {
	struct watch watch;
	uint8_t id;

	/* PRIVATE */
	void *values;	 /* memory of the watch */
	uint64_t due_us; /* of the watch */
	unsigned configured;
	uint32_t counter_mapping; /* of the sample counter, without bits; 0: it has none */
	int published_state;
	unsigned open, last, expected; /* PDOs of the open sample, of the one before, of a complete one: bits */
	uint64_t opened_us;
	uint16_t last_counter;
	bool last_counted;
	struct record sample, published;
	bool any_published;
	uint64_t next_us; /* decimation */
};

struct fleet {
	size_t node_count;
	uint64_t samples;  /* complete ones */
	uint64_t withheld; /* of them, by decimation or threshold */
	uint64_t misfits;  /* PDOs that do not fit their mapping */

	/* PRIVATE */
	const struct fleet_config *config;
	const struct fleet_sink *sink;
	struct can_port *bus;
	int64_t utc_offset_us;
	struct fleet_node *nodes[FLEET_NODES]; /* by node-ID */
	uint8_t known[FLEET_NODES];	       /* node-IDs, node_count of them */
	uint8_t owner[FLEET_IDS];	       /* node-ID of a CAN-ID; 0: none */
};

/** `config`, `bus` and `sink` must outlive it. */
void fleet_init(struct fleet *fleet, const struct fleet_config *config, struct can_port *bus,
	const struct fleet_sink *sink, uint64_t now_us);
void fleet_free(struct fleet *fleet);
/** `utc_offset_us`: UTC - the clock of now_us and msg->t_us. */
void fleet_receive(struct fleet *fleet, const struct can_msg *msg, uint64_t now_us, int64_t utc_offset_us);
/** Returns the time at which it must be called again at the latest. */
uint64_t fleet_tick(struct fleet *fleet, uint64_t now_us, int64_t utc_offset_us);
/** NULL: not heard. */
struct fleet_node *fleet_node(struct fleet *fleet, unsigned node_id);

#endif
