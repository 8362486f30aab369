/* drivers/ports/can.h
 * What the gateway and the tools need of a CAN bus. One bus = one struct can_port, the first member of whatever
 * implements it (SocketCAN, gs_usb, slcan, udp). Classical CAN, data and remote frames of up to 8 bytes.
 *
 * A port shows one file descriptor to wait on (a driver with several hides them behind an epoll descriptor). No call
 * blocks. Frames that the bus cannot take at once wait in the port's queue: nothing is lost silently. */
#ifndef DRIVERS_PORTS_CAN_H
#define DRIVERS_PORTS_CAN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct can_msg {
	uint32_t id;   /* 11 or 29 bits, no flags */
	bool extended; /* 29-bit identifier */
	bool remote;   /* RTR */
	uint8_t len;   /* 0..8 */
	uint8_t data[8];
	uint64_t t_us; /* received: CLOCK_MONOTONIC, of the kernel or adapter where it tells; unused in sending */
};

enum can_state {
	CAN_STATE_ACTIVE,
	CAN_STATE_WARNING,
	CAN_STATE_PASSIVE,
	CAN_STATE_BUS_OFF,
	CAN_STATE_DOWN, /* interface down or gone; comes back by itself */
};

struct can_counters {
	uint32_t tx;	     /* frames handed to the bus */
	uint32_t rx;	     /* frames received (after filters) */
	uint32_t tx_retries; /* the bus was full (ENOBUFS, EAGAIN): tried again later */
	uint32_t tx_dropped; /* lost: the queue was full, or the bus down */
	uint32_t rx_dropped; /* lost before we read them (SO_RXQ_OVFL), or malformed */
	uint32_t errors;     /* error frames */
	uint32_t bus_off;    /* times the bus went off */
};

struct can_port;

struct can_ops {
	/** 0; -ENOBUFS or -EAGAIN: try again later; any other -errno: the frame is lost. */
	int (*send)(struct can_port *port, const struct can_msg *msg);
	/** 1 and a frame; 0: none left now; -errno (the port has noted it in `state`; keep polling). To be called until
	 * it is 0 or less: the descriptor does not tell of frames that the port has fetched already. Error frames are
	 * consumed inside and appear in `state` and `counters`. */
	int (*receive)(struct can_port *port, struct can_msg *msg, uint64_t now_us);
	/** Only these 11-bit identifiers need to be received from now on; n = 0: all. Best effort, 0 or -errno. */
	int (*filter)(struct can_port *port, const uint32_t *ids, size_t n);
	/** Housekeeping (re-open, recovery). Returns when to call again at the latest, in now_us's time; UINT64_MAX:
	 * never. May be NULL. */
	uint64_t (*service)(struct can_port *port, uint64_t now_us);
	/** The bus's bit rate from now on (the bus is silent for a moment). 0; -EOPNOTSUPP: this bus has none, or this
	 * adapter cannot do that one; -EPERM: not permitted. With dry_run nothing changes. May be NULL: -EOPNOTSUPP. */
	int (*bit_rate)(struct can_port *port, uint32_t bit_s, bool dry_run);
	/** Brings `state`, `bit_s`, the error counters and `traffic` up to date as far as the driver can ask for them.
	 * Some 0.1 ms: once a second is enough. NULL: `traffic` is what went through this port. */
	void (*look)(struct can_port *port);
	/** Ends bus-off. 0; -EPERM: not permitted; -EOPNOTSUPP (or NULL): not from here, the kernel or the adapter does
	 * so by itself, or nobody. */
	int (*restart)(struct can_port *port);
	void (*close)(struct can_port *port);
};

/** Frames waiting for a bus that was full, oldest first. When there are more, the oldest with the new one's identifier is
 * dropped, or else the oldest of all. */
enum { CAN_QUEUE_LEN = 128 };

struct can_port {
	const struct can_ops *ops;
	int fd; /* readable when frames have come; the same until can_close(), whatever happens to the bus */
	char name[64];
	enum can_state state;
	struct can_counters counters;
	uint32_t bit_s;		      /* 0: not known. A bus that has none may be given one, for its load */
	uint8_t tx_errors, rx_errors; /* error counters of the controller (TEC, REC); 0 where not known */
	struct can_traffic {
		uint64_t frames, bytes; /* of all nodes, in both directions; data bytes only */
	} traffic;
	struct can_msg queue[CAN_QUEUE_LEN];
	size_t queue_head, queue_count;
	uint64_t retry_at_us; /* not before: back-off after ENOBUFS */
	uint32_t backoff_us;
};

/** Opens BUS: an interface name, `gs_usb[:SERIAL[:CHANNEL]]`, `slcan:DEVICE[@BAUD]`, `udp[:GROUP[:PORT]]`.
 * 0 and *port (close with can_close()), or -errno and one line in `error` that says what to do. */
int can_open(const char *bus, struct can_port **port, char *error, size_t error_size);
void can_close(struct can_port *port);

/** Sends, or queues when the bus is full or frames are queued already (order is kept). 0, or -errno when the bus cannot
 * take the frame at all, and it was dropped (counted). */
int can_send(struct can_port *port, const struct can_msg *msg, uint64_t now_us);
int can_receive(struct can_port *port, struct can_msg *msg, uint64_t now_us);
int can_filter(struct can_port *port, const uint32_t *ids, size_t n);
int can_bit_rate(struct can_port *port, uint32_t bit_s, bool dry_run);
void can_look(struct can_port *port);
int can_restart(struct can_port *port);
/** Retries the queue and the driver's housekeeping. Returns the next deadline. */
uint64_t can_service(struct can_port *port, uint64_t now_us);

#endif
