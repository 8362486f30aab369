/* tools/fleet/format.h
 * Topics and payloads: how records become MQTT messages. JSON (format_json.c) or Sparkplug B (format_sparkplug.c). It
 * remembers of each node what a subscriber has to be told first: the names and units of its values. Used by the thread
 * that publishes, but for format_command(). */
#ifndef TOOLS_FLEET_FORMAT_H
#define TOOLS_FLEET_FORMAT_H

#include "od/od.h"
#include "tools/fleet/record.h"

enum { FORMAT_NODES = 128, FORMAT_TOPIC_MAX = 256, FORMAT_PAYLOAD_MAX = 16384, FORMAT_SUBSCRIPTIONS = 4 };

struct message {
	const char *topic;
	const void *payload;
	size_t size;
	int qos;
	bool retain;
};

/** What becomes of a message: the number of its acknowledgement, 0: it needs none; -1: no connection. */
struct publisher {
	void *ctx;
	long (*publish)(void *ctx, const struct message *message);
};

struct format_config {
	const char *prefix;		      /* the first level of the topics; Sparkplug: the group */
	const char *bus;		      /* the bus in the topics; Sparkplug: the edge node */
	const struct od_table *const *tables; /* by node-ID; NULL: none */
};

/** Counts since the start, unless said otherwise. */
struct fleet_status {
	uint64_t nodes, samples, withheld, misfits;
	uint64_t bus_dropped;	    /* frames lost by driver or kernel, and those that were refused */
	uint64_t hand_over_dropped; /* records: the writer was too slow */
	uint64_t commands_dropped;
	uint64_t sent, delivered;      /* records */
	uint64_t spooled, spool_bytes; /* now */
	uint64_t spool_dropped, spool_damaged, spool_errors, lost;
	uint64_t connections;
};

/** What is known of a node. */
struct node_view {
	bool known, configured; /* configured: the values are complete as far as they were seen */
	struct record values;	/* all fields seen since then, the last values */
	int nmt_state;
	bool has_state, has_emcy, born;
	uint8_t emcy[8];
	int64_t state_utc_us, emcy_utc_us;
};

struct format {
	const struct format_ops *ops;
	struct format_config config;
	struct node_view nodes[FORMAT_NODES];
	struct fleet_status status; /* the last one published */
	uint8_t birth;		    /* Sparkplug: bdSeq of the connection */
	uint8_t seq;		    /* Sparkplug: of the next message */
	char topic[FORMAT_TOPIC_MAX];
	uint8_t payload[FORMAT_PAYLOAD_MAX];
};

/** What a subscriber asks for. */
struct command {
	enum { COMMAND_WRITE, COMMAND_REBIRTH } kind;
	uint8_t node_id;
	char object[96]; /* name or address */
	char value[128]; /* as imu9-sdo write takes it */
	char id[64];	 /* returned with the answer; or empty */
};
typedef void format_on_command(void *ctx, const struct command *command);

struct format_ops {
	/** Topics of commands, for subscriptions, in topics[FORMAT_SUBSCRIPTIONS]. Returns their number. */
	size_t (*subscriptions)(const struct format_config *config, bool writes, char topics[][FORMAT_TOPIC_MAX]);
	/** Calls `on_command` for each command in a message. False: it is none. Any thread. */
	bool (*command)(const struct format_config *config, const char *topic, const uint8_t *payload, size_t size,
		format_on_command *on_command, void *ctx);
	/** The last will, for the next connection; it is in f->topic and f->payload. */
	void (*will)(struct format *f, struct message *message);
	/** Just connected: what a subscriber must know first. Also for a rebirth. False: no connection. */
	bool (*begin)(struct format *f, const struct publisher *to, int64_t utc_us);
	/** Publishes a record. `late`: it waited in the spool. The acknowledgement of the last message. */
	long (*record)(struct format *f, const struct publisher *to, const struct record *record, bool late);
	bool (*status)(struct format *f, const struct publisher *to, const struct fleet_status *status, int64_t utc_us);
	/** About to disconnect on purpose. */
	void (*end)(struct format *f, const struct publisher *to, int64_t utc_us);
};

extern const struct format_ops format_json, format_sparkplug;

/** `birth`: the bdSeq before the first one. */
void format_init(struct format *f, const struct format_ops *ops, const struct format_config *config, uint8_t birth);

/* ---- for the formats */

/** The entry of a mapped value, or NULL: not in the EDS, or another size there. */
const struct od_entry *format_entry(const struct format *f, uint8_t node_id, const struct record_field *field);
/** "acceleration.l", or "2100h:01". */
void format_name(const struct od_entry *entry, const struct record_field *field, char *name, size_t capacity);
/** Remembers the values. True: there are some that were not known before. */
bool format_learn(struct node_view *view, const struct record *record);
/** The node-ID that the rest of a topic is, or -1. */
int format_node(const char *text);
/** The name of a bus as a level of a topic: '_' for what has a meaning there. */
void format_level(const char *text, char *level, size_t capacity);
/** ISO 8601 with microseconds. */
enum { FORMAT_UTC_TEXT = sizeof("2026-11-30T12:00:00.000000Z") };
void format_utc(int64_t utc_us, char text[FORMAT_UTC_TEXT]);

#endif
