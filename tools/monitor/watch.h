/* tools/monitor/watch.h
 * Watches one node from outside: what it sends, decoded by the PDO mapping that it has. A passive
 * core like the node's own: frames and time go in; SDO requests (to learn the mapping) go out
 * through the bus. */
#ifndef TOOLS_MONITOR_WATCH_H
#define TOOLS_MONITOR_WATCH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "drivers/ports/can.h"
#include "gateway/canopen/client/sdo_client.h"
#include "od/od.h"

enum { WATCH_PDOS = 8, WATCH_FIELDS = 8, WATCH_NMT_UNKNOWN = -1, WATCH_NMT_LOST = -2 };

/** One mapped object of a PDO. */
struct watch_field {
	const struct od_entry *entry; /* NULL: not in the EDS */
	uint32_t mapping;	      /* as in 1A00h: index, sub-index, bits */
	unsigned int bit, bits;	      /* place in the PDO */
	double step;		      /* physical value of 1 */
	double raw;		      /* the last value, not scaled */
};

/** Frames of one kind, and how often they come. */
struct watch_rate {
	uint64_t count;
	uint64_t first_us, last_us;
	double interval_us; /* smoothed */
};

struct watch_pdo {
	bool enabled;
	uint32_t id;
	uint8_t type; /* transmission type */
	struct watch_field fields[WATCH_FIELDS];
	size_t field_count;
	struct watch_rate rate;
	uint64_t misfits;  /* PDOs of another length than the mapping says; not decoded */
	bool counted;	   /* a sample counter was seen */
	uint16_t counter;  /* the last one */
	uint64_t skipped;  /* samples that no PDO brought: lost, or the SYNC is slower than the IMU */
	uint64_t repeated; /* PDOs that brought the same sample again */
};

enum watch_mapping {
	WATCH_LEARNING, /* asking the node; PDOs are counted, not decoded */
	WATCH_LEARNED,
	WATCH_DEFAULTS, /* of the EDS, because the node did not answer or must not be asked */
};

struct watch {
	enum watch_mapping mapping;
	unsigned int configured; /* times that the mapping was set: rises when it may have changed */
	struct watch_pdo pdos[WATCH_PDOS];
	size_t pdo_count;
	int nmt_state; /* the last one told: enum nmt_state, or WATCH_NMT_UNKNOWN */
	struct watch_rate heartbeat, sync, emcy;
	uint64_t boot_ups;
	uint16_t emcy_code; /* of the last EMCY */
	uint8_t emcy_register;
	uint64_t heard_us; /* anything from the node; 0: nothing yet */

	/* PRIVATE */
	struct od mirror; /* of the node's dictionary, as far as it was read */
	uint8_t node_id;
	bool passive;
	struct sdo_client sdo;
	uint8_t wire[OD_VALUE_MAX];
	size_t asked; /* entry of the table that is being read */
	uint64_t ask_again_us;
};

/** `values`: memory of table->values_size bytes, kept. `passive`: send nothing, use the default
 * mapping. */
void watch_init(struct watch *watch, const struct od_table *table, void *values, struct can_port *bus, uint8_t node_id,
	bool passive, uint64_t now_us);
void watch_receive(struct watch *watch, const struct can_msg *msg, uint64_t now_us);
/** Returns when it must be called again at the latest. */
uint64_t watch_tick(struct watch *watch, uint64_t now_us);
/** The watcher has sent a SYNC itself. */
void watch_sync_sent(struct watch *watch, uint64_t now_us);

/** A communication object as the node has it (or its default): 1005h, 1019h. 0 when there is none.
 */
uint32_t watch_object(const struct watch *watch, uint16_t index, uint8_t sub);
/** Per second, now; falls when nothing comes any more. */
double watch_rate_hz(const struct watch_rate *rate, uint64_t now_us);
bool watch_has_values(const struct watch *watch);

/** The physical value as text, with as many decimals as its step has, without the unit. */
void watch_field_text(const struct watch_field *field, char *text, size_t capacity);
/** The NMT state, or WATCH_NMT_LOST when a node with a heartbeat has been silent for three heartbeat times. */
int watch_nmt_state(const struct watch *watch, uint64_t now_us);
/** "operational", .. */
const char *watch_nmt_text(int nmt_state);
/** What an emergency error code means (CiA 301 table 26 and the gateway's own). */
const char *watch_emcy_text(uint16_t code);
/** The bits of the status word (210Fh:3) in words, separated by commas; "none" for 0. */
void watch_status_text(unsigned int status, char *text, size_t capacity);

#endif
