/* tools/lib/watch.h
 * Monitors one node: decodes its frames by its PDO mapping. Passive like the core of the node itself: frames and time
 * are arguments; SDO requests, which read the mapping, are sent through the bus. */
#ifndef TOOLS_LIB_WATCH_H
#define TOOLS_LIB_WATCH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "drivers/ports/can.h"
#include "gateway/canopen/client/sdo_client.h"
#include "od/od.h"

enum {
	WATCH_PDOS = 8,
	WATCH_FIELDS = 8,
	WATCH_NMT_UNKNOWN = -1,
	WATCH_NMT_LOST = -2,
	WATCH_EMCYS = 8,
	WATCH_POLLED = 14,
	WATCH_COMMANDS = 4,
};

/** One mapped object of a PDO. */
struct watch_field {
	const struct od_entry *entry; /* NULL: not in the EDS */
	uint32_t mapping;	      /* as in 1A00h: index, sub-index, bits */
	unsigned int bit, bits;	      /* place in the PDO */
	double step;		      /* physical value of one step */
	double raw;		      /* the last value, not scaled */
};

/** Count and rate of one kind of frame. */
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
	uint64_t misfits;  /* PDOs whose length does not match the mapping; not decoded */
	bool counted;	   /* a sample counter was seen */
	uint16_t counter;  /* the last one */
	uint64_t skipped;  /* samples that were in no PDO: lost, or SYNC is slower than the IMU */
	uint64_t repeated; /* PDOs with the same sample as the one before */
};

enum watch_mapping {
	WATCH_READING, /* being read from the node; PDOs are not decoded yet */
	WATCH_READ,
	WATCH_DEFAULTS, /* default of the EDS: the node does not answer, or passive */
};

struct watch_emcy {
	uint64_t at_us;
	uint16_t code;
	uint8_t error_register;
};

/** A value that is read again and again by SDO. */
struct watch_polled {
	uint16_t index;
	uint8_t sub;
	double value;
	uint64_t at_us; /* 0: not read yet */
};

/** A write by SDO that waits for its turn. */
struct watch_command {
	const char *name;
	uint16_t index;
	uint8_t sub, size, wire[OD_VALUE_MAX];
};

struct watch {
	enum watch_mapping mapping;
	unsigned int configured; /* incremented when the mapping is set and may have changed */
	struct watch_pdo pdos[WATCH_PDOS];
	size_t pdo_count;
	int nmt_state; /* the last one received: enum nmt_state, or WATCH_NMT_UNKNOWN */
	struct watch_rate heartbeat, sync, emcy;
	uint64_t boot_ups;
	struct watch_emcy emcys[WATCH_EMCYS]; /* the latest first; emcy.count of them */
	double bus_hz;			      /* frames of all nodes, in the last second; 0: not measured yet */
	uint64_t heard_us;		      /* time of the last frame of the node; 0: none yet */
	struct watch_polled polled[WATCH_POLLED];
	char message[160];	/* what became of the last command; "" before */
	unsigned commands_done; /* all commands so far, and the result of the last one */
	enum sdo_result command_result;
	uint32_t command_abort;
	char events[OD_DOMAIN_MAX + 1]; /* 2131h when it was read last */

	/* PRIVATE */
	struct od mirror; /* copy of the node's dictionary, as far as it was read */
	uint8_t node_id;
	bool passive;
	struct sdo_client sdo;
	uint8_t wire[OD_VALUE_MAX];
	enum { WATCH_MAP, WATCH_POLL, WATCH_COMMAND, WATCH_EVENTS } job; /* of the SDO client */
	size_t reading; /* WATCH_MAP: entry of the table that is being read */
	uint64_t retry_us;
	uint64_t second_us; /* its begin, and its frames */
	unsigned int frames;
	bool polls, wants_events;
	size_t polling; /* the next of `polled` */
	uint64_t poll_us;
	struct watch_command commands[WATCH_COMMANDS];
	size_t command_count;
};

/** `values`: memory of table->values_size bytes for the lifetime of the watch. `passive`: sends nothing and uses the
 * default mapping. */
void watch_init(struct watch *watch, const struct od_table *table, void *values, struct can_port *bus, uint8_t node_id,
	bool passive, uint64_t now_us);
void watch_receive(struct watch *watch, const struct can_msg *msg, uint64_t now_us);
/** Returns the time at which it must be called again at the latest. */
uint64_t watch_tick(struct watch *watch, uint64_t now_us);
/** The program itself has sent a SYNC. */
void watch_sync_sent(struct watch *watch, uint64_t now_us);

/** Reads the mapping again at the next watch_tick(): it may have changed. Not with `passive`. */
void watch_read_mapping(struct watch *watch, uint64_t now_us);
/** Reads sigmas and bus health by SDO from now on, one value each 0.1 s. */
void watch_poll(struct watch *watch, uint64_t now_us);
/** Reads the event log (2131h) once. */
void watch_read_events(struct watch *watch);
/** Writes an object by SDO when its turn comes; `message` then says what became of it. `name` lives as long as that. */
void watch_command(struct watch *watch, const char *name, uint16_t index, uint8_t sub, uint32_t value, uint8_t size);
/** The same for a value of any type but DOMAIN. False: passive, or WATCH_COMMANDS of them are waiting. */
bool watch_write(struct watch *watch, const char *name, uint16_t index, uint8_t sub, const void *wire, size_t size);
/** The 1 sigma of a mapped value as polled, in its unit; NAN: unknown. Sigmas are of the global frame: for an axis of
 * the object, or roll and pitch, it is that of the least certain axis (for roll and pitch: of the horizontal ones). */
double watch_sigma(const struct watch *watch, const struct od_entry *entry);
/** A polled value, or NAN. */
double watch_polled(const struct watch *watch, uint16_t index, uint8_t sub);

/** Value of a communication object in the node, such as 1005h, or its default. 0: no such object. */
uint32_t watch_object(const struct watch *watch, uint16_t index, uint8_t sub);
/** Frames per second; decreases when no more frames arrive. 0: not measured yet, that takes two frames. */
double watch_rate_hz(const struct watch_rate *rate, uint64_t now_us);
bool watch_has_values(const struct watch *watch);

/** The physical value as text without unit, with the decimals of its step, or in the words of the EDS. */
void watch_field_text(const struct watch_field *field, char *text, size_t capacity);
/** The NMT state, or WATCH_NMT_LOST after three heartbeat periods without a frame. */
int watch_nmt_state(const struct watch *watch, uint64_t now_us);
/** "operational", .. */
const char *watch_nmt_text(int nmt_state);

#endif
