/* tools/web/web.h
 * imu9-web without its network: the nodes of a bus as browsers ask for them. Passive like the core of a node: frames,
 * requests and the time go in; frames go out through the port, and each client is asked for its next message. So a test
 * runs it in simulated time, and no SDO transfer ever blocks the loop.
 *
 * A browser is a client, a slot of struct web. What it asks of a node is a job: it waits in the queue of that node and
 * then takes SDO transfers one after the other. Answers wait in a queue for each client, whose next requests wait until
 * it has fetched them; events are written only when the client can take one, from what the bus and the nodes are then,
 * so a slow browser loses rows of PDOs and no more.
 *
 * Memory grows with nodes and clients up to the limits below and not with time. One thread; times are us of
 * CLOCK_MONOTONIC. */
#ifndef TOOLS_WEB_WEB_H
#define TOOLS_WEB_WEB_H

#include <json-c/json.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "drivers/ports/can.h"
#include "gateway/canopen/client/lss_master.h"
#include "gateway/canopen/client/sdo_client.h"
#include "od/od.h"
#include "tools/eds/eds.h"
#include "tools/lib/watch.h"
#include "tools/web/access.h"

enum {
	WEB_CLIENTS = 32,
	WEB_NODES = 128, /* by node-ID */
	WEB_SUBSCRIPTIONS = 16,
	WEB_POLLS = 8,	       /* of one client */
	WEB_OBJECTS = 512,     /* of one request */
	WEB_NODE_JOBS = 32,    /* that wait for one node */
	WEB_CLIENT_JOBS = 8,   /* of one client, or answers that it has not fetched: then its input waits */
	WEB_REQUESTS_HZ = 50,  /* of one client, and twice as many at once */
	WEB_EDS_MAX = 1 << 20, /* bytes of an EDS */
	WEB_EDS_CACHE = 64,
	WEB_ROWS = 256,	      /* of PDOs, that wait for slow browsers */
	WEB_ROWS_EVENT = 128, /* in one event */
	WEB_ROW_TEXT = 1056,  /* a time, and 64 fields of 16 characters */
	WEB_EMCYS = 32,	      /* the last ones, for slow browsers */
	WEB_FIELDS = WATCH_PDOS * WATCH_FIELDS,
};

struct web;
struct web_node;
struct web_job;

/** An EDS, shared by the nodes with one identity. */
struct web_eds {
	const struct od_table *table; /* NULL: a free place */
	const char *text;	      /* the EDS itself, for a DCF; NULL: the table is part of that of another device */
	size_t size;
	bool of_device; /* as it was in 1021h, or built in with the revision of the node */
	/* PRIVATE */
	uint32_t identity[3]; /* vendor, product, revision */
	struct eds parsed;
	char *memory; /* `text` if it is owned */
	unsigned int nodes;
};

/** One SDO transfer of a job. */
struct web_step {
	uint16_t index;
	uint8_t sub;
	bool write;
	enum sdo_result result; /* SDO_IDLE: not tried, the node stopped answering or a step before failed */
	uint32_t abort_code;
	const struct od_entry *entry; /* NULL: not in the EDS */
	size_t size;
	uint8_t wire[OD_VALUE_MAX];
	uint8_t *large; /* malloc'ed: what was read, where it is longer than `wire`; terminated by 0 */
};

/** Called with the job at the head of its queue and the EDS of the node at hand, and again each time that all steps are
 * done; job->stage counts these calls from 0. True: it has added steps. False: it has answered. */
typedef bool web_work(struct web *web, struct web_job *job, uint64_t now_us);

struct web_job {
	struct web_job *next;
	struct web_node *node;
	web_work *work;
	int client; /* -1: none, of the server itself */
	uint32_t serial;
	struct json_object *request; /* owned; NULL: none */
	int64_t id;
	size_t bytes; /* of the request */
	int poll;     /* the poll of the client that gets the result as an event; -1: it is an answer */
	unsigned int poll_version;
	bool ready; /* needs neither identity nor EDS */
	bool changes;
	bool stop; /* at the first step that fails */
	unsigned int stage, timeout_ms;
	struct web_step *steps;
	size_t count, room, at;
	uint8_t *buffer; /* of the transfer under way */
	size_t capacity;
	void *data; /* of the work; free()d with the job, or released by: */
	void (*release)(void *data);
};

/** The samples of a watched node as text, each a row of its PDOs. */
struct web_rows {
	uint64_t count;	     /* so many were added; the last WEB_ROWS are there */
	unsigned int fields; /* incremented when their meaning has changed */
	uint64_t first;	     /* the first one of this meaning */
	struct web_row {
		uint16_t size;
		char text[WEB_ROW_TEXT];
	} rows[WEB_ROWS];

	/* PRIVATE: the row that is being filled */
	unsigned int configured; /* that of the watch */
	uint32_t has, expected;	 /* bits of the PDOs */
	uint64_t t_us;
	char values[WEB_FIELDS][16];
};

struct web_node {
	uint8_t id;
	bool listed;	   /* heard, or it has answered */
	int state;	   /* WATCH_NMT_UNKNOWN, WATCH_NMT_LOST or enum nmt_state */
	uint64_t heard_us; /* its last frame; 0: none */
	uint64_t heartbeat_us, heartbeat_interval_us;
	bool identified;
	bool known; /* identified before the last boot-up: so it is shown until it is identified again */
	uint32_t type, identity[4]; /* 1000h; vendor, product, revision, serial */
	char name[65];
	uint64_t identify_us; /* not before */
	uint64_t identify_wait_us;
	struct web_eds *eds;  /* NULL: not needed yet */
	bool eds_interrupted; /* the node was silent while it was read: it is read again after the next boot-up */
	char *objects;	      /* the result of "objects", made once; NULL: not asked for yet */

	struct sdo_client sdo;
	struct web_job *jobs, *last; /* the first one runs */
	size_t job_count;

	unsigned int subscribers;
	struct watch *watch; /* while there are any */
	void *values;
	struct web_rows *rows;
};

struct web_message {
	struct web_message *next;
	size_t size;
	char text[];
};

struct web_subscription {
	struct web_node *node; /* NULL: free */
	double interval_us;
	uint64_t due_us, position, lost;
	unsigned int fields; /* that the client knows */
};

struct web_poll {
	struct web_node *node; /* NULL: free */
	double interval_us;
	uint64_t due_us;
	struct json_object *request; /* its objects */
	bool running;
	unsigned int version; /* incremented when it is replaced */
	char *event;	      /* the last result, not fetched yet */
};

struct web_client {
	bool open, unlocked;
	uint32_t serial; /* of the connection, to tell it from a later one in this slot */
	double allowance;
	uint64_t allowance_us;
	unsigned int jobs; /* without an answer yet */
	size_t job_bytes;  /* of their requests */
	struct web_message *answers, *last_answer;
	unsigned int answer_count;
	struct web_subscription subscriptions[WEB_SUBSCRIPTIONS];
	struct web_poll polls[WEB_POLLS];
	bool said_hello;
	unsigned int nodes_version;
	uint64_t nodes_due_us;
	unsigned int bus_version;
	uint64_t emcys; /* so many are known */
	struct web_message *fetched;
	char *text; /* of the last event */
};

struct web_emcy {
	uint8_t node, error_register;
	uint16_t code;
};

struct web_lss {
	enum { WEB_LSS_NOTHING, WEB_LSS_FINDING, WEB_LSS_SELECTING, WEB_LSS_SETTING, WEB_LSS_STORING } doing;
	struct lss_master master;
	int client;
	uint32_t serial;
	int64_t id;
	uint32_t identity[LSS_ADDRESS];
	uint8_t node_id;
	bool store;
	struct json_object *units; /* that were found */
};

struct web_config {
	struct can_port *bus;
	const char *bus_name;
	struct web_token *token;
	const struct eds *eds; /* of --eds */
	const char *const *eds_texts;
	const size_t *eds_sizes;
	size_t eds_count;
};

struct web {
	struct web_config config;
	uint64_t start_us;
	struct web_node nodes[WEB_NODES];
	unsigned int nodes_version;
	struct web_client clients[WEB_CLIENTS];
	uint32_t serial;
	struct web_eds eds[WEB_EDS_CACHE];
	unsigned int unlock_failures; /* since the start */

	uint64_t second_us; /* of the measurement of the bus */
	struct can_traffic traffic;
	uint64_t frames, syncs;
	unsigned int bus_version;
	double frames_hz, load /* below 0: unknown */, sync_hz;
	uint64_t foreign_sync_us; /* the last SYNC of another producer */

	double sync_interval_us; /* 0: this program produces none */
	uint64_t sync_us;
	int sync_client;

	uint8_t scan_next;
	uint64_t scan_us;
	int64_t scan_id; /* that of the request + 1; 0: no scan is under way */
	int scan_client;
	uint32_t scan_serial;

	struct web_lss lss;

	uint64_t emcy_count;
	struct web_emcy emcys[WEB_EMCYS];
};

/* ---- for the loop and for tests ---- */

/** `web` is cleared. The bus, the token and the EDS files outlive it. */
void web_init(struct web *web, const struct web_config *config, uint64_t now_us);
void web_free(struct web *web);
void web_receive(struct web *web, const struct can_msg *msg, uint64_t now_us);
/** Returns the time of the next call at the latest. */
uint64_t web_tick(struct web *web, uint64_t now_us);

/** A node has been asked for something: its answer should not wait. */
bool web_awaits_answer(const struct web *web);

/** A slot, or -1: there are WEB_CLIENTS. */
int web_connect(struct web *web, uint64_t now_us);
void web_disconnect(struct web *web, int client);
/** A text frame of a client. */
void web_request(struct web *web, int client, const char *text, size_t size, uint64_t now_us);
/** False: its input must wait until it has fetched answers. */
bool web_takes_input(const struct web *web, int client);
/** Whether there is a message for the client now; else *due_us is lowered to the time of the next one, if it is known.
 */
bool web_has_output(const struct web *web, int client, uint64_t now_us, uint64_t *due_us);
/** The next message, valid until the next call for this client; NULL: none. */
const char *web_output(struct web *web, int client, size_t *size, uint64_t now_us);

/* ---- between the files of imu9-web ---- */

/* web_client.c */
/** `result` is taken over. */
void web_answer(struct web *web, struct web_job *job, struct json_object *result);
/** The same for JSON text, which is copied. */
void web_answer_text(struct web *web, struct web_job *job, const char *result);
void web_refuse(struct web *web, struct web_job *job, const char *format, ...) __attribute__((format(printf, 3, 4)));
/** Because a step failed. */
void web_refuse_step(struct web *web, struct web_job *job, const struct web_step *step);
/** Of a client without a job: `result` NULL and the reason `error`. */
void web_answer_now(struct web *web, int client, int64_t id, struct json_object *result, const char *error);
uint64_t web_clients_tick(struct web *web, uint64_t now_us);

/* web_node.c */
struct web_node *web_node(struct web *web, int64_t id);
/** NULL: there are too many. `request` is taken over, or NULL. */
struct web_job *web_enqueue(struct web_node *node, web_work *work, struct json_object *request);
/** A step at the end, or NULL: out of memory. */
struct web_step *web_read(struct web_job *job, uint16_t index, uint8_t sub);
struct web_step *web_write(struct web_job *job, uint16_t index, uint8_t sub, const void *wire, size_t size);
/** Forgets the steps. */
void web_clear_steps(struct web_job *job);
const uint8_t *web_bytes(const struct web_step *step);
uint32_t web_u32(const struct web_step *step, uint32_t otherwise);
const char *web_state_text(int state);
bool web_is_ours(const struct web_node *node);
void web_node_receive(struct web *web, struct web_node *node, const struct can_msg *msg, uint64_t now_us);
uint64_t web_node_tick(struct web *web, struct web_node *node, uint64_t now_us);
void web_node_subscribe(struct web *web, struct web_node *node, uint64_t now_us);
void web_node_unsubscribe(struct web_node *node);
/** The PDOs of the node may have changed. */
void web_node_mapping_changed(struct web_node *node, uint64_t now_us);
void web_node_free(struct web *web, struct web_node *node);

/* web_eds.c */
/** What is known without the node: the built-in EDS for a gateway of this version, or what was read before. NULL: 1021h
 * must be read. */
struct web_eds *web_eds_known(struct web *web, const struct web_node *node);
/** From 1021h; `text` is taken over. NULL: it is no EDS. */
struct web_eds *web_eds_read(struct web *web, const struct web_node *node, char *text, size_t size);
/** Of --eds, or else the communication objects that every device has. */
struct web_eds *web_eds_otherwise(struct web *web, const struct web_node *node);
/** The objects of an EDS as JSON, with the defaults for this node-ID. */
struct json_object *web_eds_objects(const struct web_eds *eds, uint8_t node_id);
void web_eds_free(struct web *web);

/* web_rows.c */
void web_rows_receive(struct web *web, struct web_node *node, const struct can_msg *msg, uint64_t now_us);
uint64_t web_rows_tick(struct web *web, struct web_node *node, uint64_t now_us);
/** Text of an event, malloc'ed. */
char *web_rows_event(const struct web *web, struct web_subscription *subscription, size_t *size, uint64_t now_us);
char *web_fields_event(struct web_subscription *subscription, size_t *size);

/* web_bus.c */
void web_bus_receive(struct web *web, const struct can_msg *msg, uint64_t now_us);
uint64_t web_bus_tick(struct web *web, uint64_t now_us);
struct json_object *web_nodes_json(const struct web *web, uint64_t now_us);
void web_bus_disconnect(struct web *web, int client);

/* web_lss.c */
void web_lss_receive(struct web *web, const struct can_msg *msg, uint64_t now_us);
uint64_t web_lss_tick(struct web *web, uint64_t now_us);
void web_lss_free(struct web *web);

/* web_value.c */
/** An object, or all members of a record, as targets with a step that reads each of them and what its step of scaled
 * values needs. The count; 0: the EDS has no such object, and it is no index. */
struct web_target {
	const char *name; /* as it was asked for */
	uint16_t index;
	uint8_t sub;
	const struct od_entry *entry;
	size_t step; /* SIZE_MAX: there is none */
};
size_t web_targets(const struct od_table *table, const char *text, struct web_target *targets, size_t capacity);
/** Adds a step that reads the resolution object of the entry, if it has one and there is none yet. */
bool web_read_resolution(struct web_job *job, const struct od_entry *entry);
/** The physical value of 1, by the steps that were read. */
double web_step_of(const struct web_job *job, const struct od_entry *entry);
struct json_object *web_value_json(const struct web_job *job, const struct web_step *step);

/* the operations: by name; NULL: there is none */
struct web_op {
	const char *name;
	bool changes; /* needs the token */
	/* of the bus or the client: answers at once, or keeps what it needs */
	void (*now)(struct web *web, int client, int64_t id, struct json_object *request, uint64_t now_us);
	/* or of a node */
	web_work *work;
};
const struct web_op *web_find_op(const char *name);

web_work web_op_read, web_op_write, web_op_objects, web_op_events, web_op_subscribe, web_op_mapping, web_op_set_mapping,
	web_op_store, web_op_restore, web_op_record, web_op_save, web_op_compare, web_op_load;
void web_op_nmt(struct web *web, int client, int64_t id, struct json_object *request, uint64_t now_us);
void web_op_sync(struct web *web, int client, int64_t id, struct json_object *request, uint64_t now_us);
void web_op_lss(struct web *web, int client, int64_t id, struct json_object *request, uint64_t now_us);
void web_op_scan(struct web *web, int client, int64_t id, struct json_object *request, uint64_t now_us);

#endif
