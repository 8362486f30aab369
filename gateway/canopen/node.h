/* gateway/canopen/node.h
 * The state of one CANopen device. It stands in a header only so that the caller can own it: the fields are the core's,
 * each struct belongs to the file named after its service. Pointers into the dictionary's values are looked up once, in
 * canopen_init(), so that the way from SYNC to PDO is short. */
#ifndef GATEWAY_CANOPEN_NODE_H
#define GATEWAY_CANOPEN_NODE_H

#include "gateway/canopen/canopen.h"

enum {
	RPDO_MAX = 4,	  /* PDOs looked for in 1400h..15FFh */
	TPDO_MAX = 8,	  /* .. and in 1800h..19FFh */
	PDO_MAP_MAX = 8,  /* mapped objects in one PDO: bytes at the smallest */
	EMCY_ERRORS = 16, /* errors standing at a time */
	EMCY_QUEUE = 16,  /* EMCY messages waiting for the inhibit time, or for NMT stopped to end */
	EMCY_HISTORY = 8, /* entries of 1003h */
	HEARTBEAT_CONSUMERS = 8,
	SDO_SERVERS = 2,
	LSS_NUMBERS = 4, /* of an identity: vendor, product, revision, serial */
};

struct nmt {
	struct od_hook hook; /* 1F80h */
	const uint16_t *heartbeat_ms;
	const uint8_t *error_behaviour; /* 1029h:1 */
	const uint32_t *startup;	/* 1F80h; NULL: none, so the master starts the node */
	enum nmt_state state;
	uint64_t last_heartbeat_us; /* boot-up counts as one (CiA 301, 7.2.8.3.2.2) */
};

struct heartbeat_consumer {
	const uint32_t *value; /* 1016h */
	uint8_t node_id;       /* that is watched; 0: none */
	bool alive, lost;      /* neither: no heartbeat came yet */
	uint64_t deadline_us;  /* of the next heartbeat, while alive */
};

struct heartbeat {
	struct od_hook hook;
	struct heartbeat_consumer consumer[HEARTBEAT_CONSUMERS];
	size_t count;
};

struct guard {
	const uint16_t *time_ms;
	const uint8_t *life_factor;
	uint8_t toggle;	  /* of the next answer: 0 or 80h */
	bool alive;	  /* a question came, and none was overdue since */
	uint64_t last_us; /* when the last one came */
};

enum sdo_server_state {
	SDO_SERVER_IDLE,
	SDO_SERVER_DOWNLOAD,
	SDO_SERVER_UPLOAD,
	SDO_SERVER_BLOCK_DOWNLOAD,     /* segments come */
	SDO_SERVER_BLOCK_DOWNLOAD_END, /* all came; the CRC is to come */
	SDO_SERVER_BLOCK_UPLOAD_START, /* the client has yet to say "start" */
	SDO_SERVER_BLOCK_UPLOAD,       /* segments go, until the client acknowledges */
	SDO_SERVER_BLOCK_UPLOAD_END,   /* all is acknowledged, the CRC is sent */
	SDO_SERVER_PENDING,	       /* all is received; the answer waits for canopen_store_done() */
};

struct sdo_server {
	uint32_t request_id, response_id;
	enum sdo_server_state state;
	uint16_t index; /* of the transfer under way */
	uint8_t sub;
	uint8_t toggle;	     /* expected in the next segment: 0 or 10h */
	bool size_indicated; /* download: the client said `size`; otherwise that is the most it may send */
	const uint8_t *data; /* upload: the buffer, or a domain's memory */
	size_t size, done;   /* bytes */
	uint64_t deadline_us;
	uint8_t buffer[OD_DOMAIN_MAX + 6]; /* a block download fills its last segment up */
	uint8_t response[8];		   /* the one that waits in SDO_SERVER_PENDING */
	struct {
		uint8_t size;	  /* segments in this sub-block at the most */
		uint8_t sequence; /* of the last segment that was sent, or received in order */
		bool crc_wanted;
		bool last;	  /* download: the last segment is here */
		uint16_t crc;	  /* upload: of the first `done` bytes, which are acknowledged */
		uint64_t next_us; /* upload: when to send on; download: when to ask for what is missing */
	} block;
};

struct second_sdo {
	struct od_hook hook;
	const uint32_t *cob_id[2]; /* 1201h:1 and 2: request and response */
};

struct pdo {
	uint16_t index; /* 1400h or 1800h + number */
	uint32_t *cob_id;
	const uint8_t *type, *sync_start, *map_count;
	const uint16_t *inhibit_100us, *event_ms;
	const uint32_t *map[PDO_MAP_MAX];

	const struct od_entry *mapped[PDO_MAP_MAX];
	uint8_t mapped_count; /* 0: not in use, because it is invalid or nothing is mapped */
	uint8_t bytes;	      /* of all that is mapped */
};

struct tpdo {
	struct pdo pdo;
	bool event;	  /* a sample is news, and this PDO has not carried it yet */
	bool await_start; /* no SYNC had the start value yet */
	uint8_t syncs;	  /* SYNCs since the last transmission */
	bool sent_before;
	uint8_t sent[8];     /* the last time */
	uint8_t sampled[8];  /* type 252: at the last SYNC */
	uint8_t sampled_len; /* 0: no SYNC came yet */
	uint64_t inhibited_until_us;
	uint64_t timer_start_us; /* the event timer runs from here */
};

struct rpdo {
	struct pdo pdo;
	uint8_t data[8]; /* received last */
	bool waits;	 /* for a SYNC */
	uint8_t faults;	 /* that stand, a bit each */
	bool monitored;	 /* the next one has to come before deadline_us */
	uint64_t deadline_us;
};

struct pdos {
	struct od_hook hook;
	struct rpdo rpdo[RPDO_MAX];
	struct tpdo tpdo[TPDO_MAX];
	size_t rpdo_count, tpdo_count;
	uint32_t late; /* synchronous RPDOs that came after the synchronous window */
};

struct sync {
	struct od_hook hook; /* 1005h, 1006h, 1019h */
	const uint32_t *cob_id, *period_us, *window_us;
	const uint8_t *counter_overflow;
	uint32_t id;	  /* that is listened to; CAN_ID_NONE */
	uint32_t late;	  /* SYNCs whose window had passed before the PDOs could be sent */
	uint64_t last_us; /* when the last one was on the bus; 0: none yet */
	bool running;	  /* the next SYNC of our own is due at next_us */
	uint64_t next_us;
	uint8_t counter; /* of the last one */
	bool watched;	 /* another's: the next one is missing at missing_us */
	uint64_t missing_us;
};

struct emcy_message {
	uint16_t code;
	uint8_t source;
	uint8_t data[8];
};

struct emcy {
	struct od_hook cob_id_hook, history_hook;
	uint32_t *cob_id; /* NULL: no 1014h, so no EMCY */
	const uint16_t *inhibit_100us;
	uint8_t *error_register;
	uint8_t *history_count;
	uint32_t *history[EMCY_HISTORY];
	size_t history_size;
	struct {
		uint16_t code;
		uint8_t source, bits;
	} errors[EMCY_ERRORS]; /* that stand, oldest first */
	size_t error_count;
	struct emcy_message queue[EMCY_QUEUE]; /* oldest first */
	size_t queue_count;
	uint32_t lost; /* errors or messages that did not fit */
	uint64_t inhibited_until_us;
};

struct store {
	struct od_hook hook; /* 1010h, 1011h */
	bool pending;
	struct od_hook date_hook; /* every object */
	uint32_t *date[2];	  /* 1020h:1 and 2: day and time of the configuration; NULL: none */
};

struct lss {
	const uint32_t *identity[LSS_NUMBERS]; /* 1018h */
	uint8_t start_id;		       /* that the dictionary was made for */
	uint8_t stored_id;		       /* from reset node on */
	uint8_t node_id;		       /* from reset communication on */
	bool storing;			       /* the answer waits for canopen_lss_stored() */
	uint8_t storing_id;
	uint32_t bit_s;							  /* configured, 0: none */
	enum { SWITCH_NONE, SWITCH_OLD_RATE, SWITCH_NEW_RATE } switching; /* silent, unless SWITCH_NONE */
	uint64_t switch_us;						  /* when the delay under way ends */
	uint32_t switch_delay_us;
	bool configuring;	      /* or else waiting */
	uint8_t selected, identified; /* numbers that were right so far */
	uint8_t scanned;	      /* fastscan: the number that is looked for */
};

struct time {
	struct od_hook hook; /* 1012h */
	const uint32_t *cob_id;
	uint32_t id; /* that is listened to; CAN_ID_NONE */
};

struct collision {
	bool stands;
	uint64_t over_us; /* when no more of such frames come */
};

struct canopen_node {
	struct od *od;
	struct can_port *bus;
	struct canopen_device device;
	uint8_t id;
	bool started;
	uint64_t now_us; /* the time of the last call: what a hook goes by */
	struct nmt nmt;
	struct heartbeat heartbeat;
	struct guard guard;
	struct sdo_server sdo_servers[SDO_SERVERS];
	struct sdo_server *sdo; /* the one that is served now */
	struct second_sdo second_sdo;
	struct pdos pdos;
	struct sync sync;
	struct emcy emcy;
	struct store store;
	struct lss lss;
	struct time time;
	struct collision collision;
};

#endif
