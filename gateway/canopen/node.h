/* gateway/canopen/node.h
 * The state of one CANopen device. It is in a header only so that the caller can own the memory: the core alone writes
 * the fields, each struct by the files of its service (service.h). Pointers into the values of the dictionary are
 * looked up once, in canopen_init(), to keep the path from SYNC to PDO short. Times are us, as in canopen.h. */
#ifndef GATEWAY_CANOPEN_NODE_H
#define GATEWAY_CANOPEN_NODE_H

#include "gateway/canopen/canopen.h"

enum {
	RPDO_MAX = 4,	  /* in 1400h to 15FFh */
	TPDO_MAX = 8,	  /* in 1800h to 19FFh */
	PDO_MAP_MAX = 8,  /* mapped objects in one PDO: each has at least one byte */
	EMCY_ERRORS = 16, /* errors active at a time */
	EMCY_QUEUE = 16,  /* EMCY messages that wait for the inhibit time or for NMT stopped to end */
	EMCY_HISTORY = 8, /* entries of 1003h */
	HEARTBEAT_CONSUMERS = 8,
	SDO_SERVERS = 8,	   /* 1200h to 1207h */
	SDO_REQUESTS_AT_ONCE = 16, /* that are answered between two ticks */
	LSS_NUMBERS = 4,	   /* of the LSS address: vendor-ID, product code, revision, serial number */
};

struct nmt {
	struct od_hook hook; /* 1F80h */
	const uint16_t *heartbeat_ms;
	const uint8_t *error_behaviour; /* 1029h:1 */
	const uint32_t *startup;	/* 1F80h; NULL: absent, the master starts the node */
	enum nmt_state state;
	uint64_t boot_up_us;	    /* due after a reset, while initialising; else UINT64_MAX */
	uint64_t last_heartbeat_us; /* boot-up counts as one (CiA 301, 7.2.8.3.2.2) */
};

struct heartbeat_consumer {
	const uint32_t *value; /* 1016h */
	uint8_t node_id;       /* of the producer; 0: none */
	bool alive, lost;      /* neither: no heartbeat was received yet */
	uint64_t deadline_us;  /* for the next heartbeat, while alive */
};

struct heartbeat {
	struct od_hook hook;
	struct heartbeat_consumer consumer[HEARTBEAT_CONSUMERS];
	size_t count;
};

struct guard {
	const uint16_t *time_ms;
	const uint8_t *life_factor;
	uint8_t toggle;	  /* of the next response: 0 or 80h */
	bool alive;	  /* life guarding is active: requests are received in time */
	uint64_t last_us; /* of the last request */
};

enum sdo_server_state {
	SDO_SERVER_IDLE,
	SDO_SERVER_DOWNLOAD,
	SDO_SERVER_UPLOAD,
	SDO_SERVER_BLOCK_DOWNLOAD,     /* segments are received */
	SDO_SERVER_BLOCK_DOWNLOAD_END, /* all are received; the CRC follows */
	SDO_SERVER_BLOCK_UPLOAD_START, /* waits for the "start upload" of the client */
	SDO_SERVER_BLOCK_UPLOAD,       /* segments are sent, until the client acknowledges */
	SDO_SERVER_BLOCK_UPLOAD_END,   /* all are acknowledged, the CRC is sent */
	SDO_SERVER_PENDING,	       /* the value is received; the response waits for canopen_store_done() */
};

enum { SDO_BUFFER_BYTES = OD_DOMAIN_MAX + 6 }; /* a block download pads its last segment */

struct sdo_server {
	uint32_t request_id, response_id;
	enum sdo_server_state state;
	uint16_t index; /* of the transfer under way */
	uint8_t sub;
	uint8_t toggle;	     /* expected in the next segment: 0 or 10h */
	bool size_indicated; /* download: `size` is the client's; false: `size` is the maximum */
	const uint8_t *data; /* upload: the buffer, or a domain's memory */
	size_t size, done;   /* bytes */
	uint64_t deadline_us;
	uint8_t *buffer;     /* of SDO_BUFFER_BYTES */
	uint8_t response[8]; /* sent at the end of SDO_SERVER_PENDING */
	struct {
		uint8_t size;	  /* maximum of segments in this sub-block */
		uint8_t sequence; /* of the last segment sent, or received in order */
		bool crc_wanted;
		bool last;	  /* download: the last segment is received */
		uint16_t crc;	  /* upload: of the first `done` bytes, the acknowledged ones */
		uint64_t next_us; /* upload: when to send more; download: when to request the missing segments */
	} block;
};

struct sdo_channels {
	struct od_hook hook;
	uint32_t *cob_id[SDO_SERVERS][2]; /* 1201h to 1207h, sub-indices 1 and 2: request and response; NULL: absent */
};

struct pdo {
	uint16_t index; /* 1400h or 1800h + number */
	uint32_t *cob_id;
	const uint8_t *type, *sync_start, *map_count;
	const uint16_t *inhibit_100us, *event_ms;
	const uint32_t *map[PDO_MAP_MAX];

	const struct od_entry *mapped[PDO_MAP_MAX];
	uint8_t mapped_count; /* 0: invalid, or nothing is mapped */
	uint8_t bytes;	      /* length of the PDO */
};

struct tpdo {
	struct pdo pdo;
	bool event;	  /* an event occurred that no PDO has carried yet */
	bool await_start; /* no SYNC with the start value (sub-index 6) was received yet */
	uint8_t syncs;	  /* SYNCs since the last transmission */
	bool sent_before;
	uint8_t sent[8];     /* the last transmission */
	uint8_t sampled[8];  /* type 252: at the last SYNC */
	uint8_t sampled_len; /* 0: no SYNC was received yet */
	uint64_t inhibited_until_us;
	uint64_t timer_start_us; /* of the event timer */
};

struct rpdo {
	struct pdo pdo;
	uint8_t data[8]; /* received last */
	bool waits;	 /* synchronous: applied at the next SYNC */
	bool monitored;	 /* the event timer runs until deadline_us */
	uint64_t deadline_us;
};

struct pdos {
	struct od_hook hook;
	struct rpdo rpdo[RPDO_MAX];
	struct tpdo tpdo[TPDO_MAX];
	size_t rpdo_count, tpdo_count;
	uint32_t late;	   /* synchronous RPDOs received after the synchronous window */
	uint32_t sent;	   /* TPDOs, but for answers to remote requests of type 252 */
	uint32_t answered; /* SYNCs after which a TPDO was sent; the time of the last one is sync.last_us */
};

struct sync {
	struct od_hook hook; /* 1005h, 1006h, 1019h */
	const uint32_t *cob_id, *period_us, *window_us;
	const uint8_t *counter_overflow;
	uint32_t id;	  /* consumed; or CAN_ID_NONE */
	uint32_t late;	  /* SYNCs received after their window had passed */
	uint64_t last_us; /* reception of the last SYNC; 0: none in operational yet */
	bool running;	  /* producer: the next SYNC is due at next_us */
	uint64_t next_us;
	uint8_t counter; /* producer: of the last SYNC */
	bool watched;	 /* consumer: the timeout of the next SYNC is missing_us */
	uint64_t missing_us;
};

struct emcy_message {
	uint16_t code;
	uint8_t source;
	uint8_t data[8];
};

struct emcy_error {
	uint16_t code;
	uint8_t source, bits;
	uint64_t earliest_us; /* it ends then at the earliest */
	uint64_t over_us;     /* it ends then unless it is found again; UINT64_MAX: with emcy_clear() */
};

struct emcy {
	struct od_hook cob_id_hook, history_hook;
	uint32_t *cob_id; /* NULL: no 1014h, so no EMCY */
	const uint16_t *inhibit_100us;
	uint8_t *error_register;
	uint8_t *history_count;
	uint32_t *history[EMCY_HISTORY];
	size_t history_size;
	struct emcy_error errors[EMCY_ERRORS]; /* active ones, oldest first */
	size_t error_count;
	struct {
		uint16_t code;
		uint8_t source;
		uint64_t t_us;
	} ended[EMCY_ERRORS]; /* communication errors, the oldest is replaced */
	size_t ended_next;
	struct emcy_message queue[EMCY_QUEUE]; /* oldest first */
	size_t queue_count;
	uint32_t lost; /* errors or messages beyond EMCY_ERRORS and EMCY_QUEUE */
	uint64_t inhibited_until_us;
	bool bus_down; /* messages wait */
};

struct store {
	struct od_hook hook; /* 1010h, 1011h */
	bool pending;
	struct od_hook date_hook; /* every object */
	uint32_t *date[2];	  /* 1020h:1 and 2: day and time of the configuration; NULL: none */
};

struct lss {
	const uint32_t *identity[LSS_NUMBERS]; /* 1018h */
	uint8_t start_id;		       /* of canopen_init() and od_init() */
	uint8_t stored_id;		       /* active from the next reset node on */
	uint8_t node_id;		       /* active from the next reset communication on */
	bool storing;			       /* the response waits for canopen_lss_stored() */
	uint8_t storing_id;
	uint32_t bit_s;							  /* configured, 0: none */
	enum { SWITCH_NONE, SWITCH_OLD_RATE, SWITCH_NEW_RATE } switching; /* nothing is sent unless SWITCH_NONE */
	uint64_t switch_us;						  /* end of the switch delay under way */
	uint32_t switch_delay_us;
	bool configuring;	      /* LSS configuration state; else waiting state */
	uint8_t selected, identified; /* consecutive matching numbers so far */
	uint8_t scanned;	      /* fastscan: the number that is scanned */
	uint8_t confirmed;	      /* fastscan: a bit for each number */
};

struct time {
	struct od_hook hook; /* 1012h */
	const uint32_t *cob_id;
	uint32_t id; /* consumed; or CAN_ID_NONE */
};

struct canopen_node {
	struct od *od;
	struct can_port *bus;
	struct canopen_device device;
	struct canopen_listener *listener; /* NULL: none */
	uint8_t id;			   /* node-ID; written by lss.c */
	bool started;
	uint64_t now_us; /* of the call under way, for hooks, too */
	struct nmt nmt;
	struct heartbeat heartbeat;
	struct guard guard;
	struct sdo_server sdo_servers[SDO_SERVERS];
	uint32_t sdo_short;	/* requests of fewer than 8 bytes */
	uint32_t sdo_excess;	/* requests of clients that do not wait for answers */
	uint8_t sdo_requests;	/* answered since the last tick */
	struct sdo_server *sdo; /* the channel of the frame or tick under way */
	struct sdo_channels sdo_channels;
	struct pdos pdos;
	struct sync sync;
	struct emcy emcy;
	struct store store;
	struct lss lss;
	struct time time;
	/* not cleared by canopen_init(): the memory of channels that nobody uses is never touched */
	uint8_t sdo_buffers[SDO_SERVERS][SDO_BUFFER_BYTES];
};

#endif
