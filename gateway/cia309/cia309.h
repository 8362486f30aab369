/* gateway/cia309/cia309.h
 * A CiA 309-3 gateway: clients send lines of text, and read and write the objects of this node and of the others on the
 * bus, and are NMT and LSS master. The language is that of CANopenNode's canopend, so that cocomm and its scripts work.
 *
 * A passive core, as that of CANopen: text, frames and time go in, text and frames go out. Each call does a bounded
 * amount of work: one command, or one piece of a long value, per CIA309_COMMAND_US, of all clients together. This
 * node is answered from the dictionary; its frames to the bus are not those of a client. The bus (SDO client, LSS
 * master) belongs to one client at a time; the others wait. One thread. Times are us of the clock of the device. */
#ifndef GATEWAY_CIA309_CIA309_H
#define GATEWAY_CIA309_CIA309_H

#include "gateway/canopen/client/lss_master.h"
#include "gateway/canopen/client/sdo_client.h"
#include "gateway/canopen/node.h"
#include "gateway/cia309/parse.h"

enum {
	CIA309_SESSIONS = 8,
	CIA309_LINE_MAX = 22528, /* a DOMAIN of OD_DOMAIN_MAX bytes as base64, and its command */
	CIA309_OUT_MAX = 4096,
	CIA309_VALUE_BYTES = 262144, /* the longest value of another node that is read */
	CIA309_WHO_MAX = 64,
	CIA309_COMMAND_US = 1000, /* from one command to the next */
};

/** The device around the core. */
struct cia309_device {
	void *ctx;
	/** This node receives a frame of the gateway, which the bus does not bring back. */
	void (*receive)(void *ctx, const struct can_msg *msg, uint64_t now_us);
	/** canopen_write() */
	enum od_status (*write)(void *ctx, uint16_t index, uint8_t sub, const void *wire, size_t size, uint64_t now_us);
	/** A client has changed something, or was refused: its command, without control codes, and the answer. Equal
	 * commands have the same number. */
	void (*log)(
		void *ctx, unsigned number, const char *who, const char *command, const char *answer, uint64_t now_us);
};

/** One client. */
struct cia309_session {
	/* PRIVATE */
	bool used, may_write, closing;
	bool waits; /* for the owner of the bus */
	enum { CIA309_IDLE, CIA309_BUSY, CIA309_STORING } state;
	char who[CIA309_WHO_MAX];
	char in[CIA309_LINE_MAX];
	size_t in_used, line; /* length of the first line with its LF; 0: it is not complete */
	char out[CIA309_OUT_MAX];
	size_t out_used;
	struct cia309_command command;
	char text[64]; /* its line, for the log */
	bool printing;
	struct cia309_printer printer;
	uint8_t value[OD_VALUE_MAX];
};

/** Caller-owned, large. */
struct cia309 {
	/* PRIVATE */
	struct cia309_device device;
	struct canopen_node *node;
	struct can_port *bus;
	struct canopen_listener listener;
	struct cia309_defaults {
		int node;
		uint32_t sdo_timeout_ms;
		bool sdo_block;
	} defaults[2];	  /* of all clients that only read, and of all that write: each run of cocomm is a client */
	uint64_t next_us; /* the next command */
	unsigned turn;
	struct cia309_session *owner, *storing; /* of the bus and `buffer`; of 1010h or 1011h */
	struct sdo_client sdo;
	struct lss_master lss;
	struct can_msg own_answer; /* to the LSS master */
	bool own_answered, sdo_running, lss_running;
	unsigned lss_step, lss_found;
	uint8_t lss_node;
	uint32_t lss_address[LSS_ADDRESS];
	struct cia309_session sessions[CIA309_SESSIONS];
	uint8_t buffer[CIA309_VALUE_BYTES];
};

/** After canopen_init(); becomes the listener of the node. All pointers must outlive it. Sends nothing. */
void cia309_init(struct cia309 *g, const struct cia309_device *device, struct canopen_node *node, struct can_port *bus);

/** A client has connected; `who` it is goes to the log. NULL: too many. */
struct cia309_session *cia309_open(struct cia309 *g, const char *who, bool may_write);
/** It is gone: what it waits for ends. */
void cia309_close(struct cia309 *g, struct cia309_session *s);

/** How many bytes the client may send now: 0 while it has a complete command that waits. */
size_t cia309_room(const struct cia309_session *s);
/** It has sent these, at most cia309_room(). */
void cia309_input(struct cia309_session *s, const char *bytes, size_t n);
/** What is to be sent to it; then how much of that was sent. */
const char *cia309_output(const struct cia309_session *s, size_t *n);
void cia309_sent(struct cia309_session *s, size_t n);
/** Nothing of it waits or is under way, but for an incomplete line. */
bool cia309_idle(const struct cia309_session *s);
/** Its line was too long: close it once the output is sent. */
bool cia309_closing(const struct cia309_session *s);

/** A frame of the bus, after the device had it. */
void cia309_receive(struct cia309 *g, const struct can_msg *msg, uint64_t now_us);
/** After each call above, and after canopen_tick(). Returns the next deadline. */
uint64_t cia309_tick(struct cia309 *g, uint64_t now_us);

#endif
