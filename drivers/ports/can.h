/* drivers/ports/can.h
 * The CAN bus as the gateway and the tools use it. A bus is one struct can_port, the first member of the struct of its
 * driver (SocketCAN, gs_usb, slcan, udp). Classical CAN, data and remote frames of up to 8 bytes.
 *
 * A port has one file descriptor to wait on (a driver with several puts them behind an epoll descriptor). No call
 * blocks. Frames that the bus cannot accept at once wait in the port's queue; a frame that is lost is counted.
 * Functions return 0 or a count, or a negative errno. All calls for one port come from one thread; ports share nothing.
 * Times are us of CLOCK_MONOTONIC. */
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
	uint64_t t_us; /* of reception, from the kernel or the adapter where it has a time stamp; ignored in sending */
};

enum can_state {
	CAN_STATE_ACTIVE,
	CAN_STATE_WARNING,
	CAN_STATE_PASSIVE,
	CAN_STATE_BUS_OFF,
	CAN_STATE_DOWN, /* interface down or removed; the driver re-opens it */
};

struct can_counters {
	uint32_t tx;	     /* frames handed to the bus */
	uint32_t rx;	     /* frames received (after filters) */
	uint32_t tx_retries; /* the bus was full (ENOBUFS, EAGAIN): sent again later */
	uint32_t tx_dropped; /* lost: the queue was full, or the bus was down */
	uint32_t rx_dropped; /* lost before they were read (SO_RXQ_OVFL), or malformed */
	uint32_t errors;     /* error frames */
	uint32_t bus_off;    /* times the controller went bus-off */
};

struct can_port;

/** What a driver implements; the functions below call it. */
struct can_ops {
	/** 0; -ENOBUFS or -EAGAIN: full, send again later; any other -errno: the frame is lost. */
	int (*send)(struct can_port *port, const struct can_msg *msg);
	/** 1 and a frame; 0: no more now; -errno: see `state`, and keep polling. Call it until it returns 0 or less:
	 * the descriptor is not readable for frames that the port has fetched already. A call does a bounded amount of
	 * work: after many unwanted frames it returns 0, and the descriptor remains readable. Error frames are not
	 * returned; they change `state` and `counters`. */
	int (*receive)(struct can_port *port, struct can_msg *msg, uint64_t now_us);
	/** Receive only these 11-bit identifiers from now on; n = 0: all. Best effort: others may be received, too. */
	int (*filter)(struct can_port *port, const uint32_t *ids, size_t n);
	/** Re-opening and recovery. Returns the time of the next call at the latest; UINT64_MAX: none is needed. May be
	 * NULL. */
	uint64_t (*service)(struct can_port *port, uint64_t now_us);
	/** Sets the bit rate in bit/s, which interrupts the bus for a moment. 0; -EOPNOTSUPP: this bus has no bit rate,
	 * or this adapter does not support that one; -EPERM: not permitted. `dry_run` only checks. NULL: -EOPNOTSUPP.
	 */
	int (*bit_rate)(struct can_port *port, uint32_t bit_s, bool dry_run);
	/** Updates `state`, `bit_s`, the error counters and `traffic` where the driver can read them. Takes about 0.1
	 * ms: call it once a second. NULL: `traffic` is that of this port. */
	void (*refresh)(struct can_port *port);
	/** Restarts the controller after bus-off. 0; -EPERM: not permitted; -EOPNOTSUPP (or NULL): the driver cannot;
	 * the kernel or the adapter may restart it. */
	int (*restart)(struct can_port *port);
	void (*close)(struct can_port *port);
};

/** Frames that wait for a full bus, oldest first. When the queue is full, the oldest frame with the identifier of the
 * new one is dropped, or else the oldest of all. */
enum { CAN_QUEUE_LEN = 128 };

struct can_port {
	const struct can_ops *ops;
	int fd; /* readable when frames were received; the same until can_close(), also over a re-opening */
	char name[64];
	enum can_state state;
	const char *down_why; /* while CAN_STATE_DOWN: why, and what to do; NULL: the interface is down */
	const char *notice;   /* a line for the log; who logs it sets NULL */
	struct can_counters counters;
	uint32_t bit_s;		      /* 0: unknown; a bus without one may have a nominal value, for its load */
	uint8_t tx_errors, rx_errors; /* TEC and REC of the controller; 0 where unknown */
	struct can_traffic {
		uint64_t frames, bytes; /* of all nodes, in both directions; data bytes only */
	} traffic;
	struct can_msg queue[CAN_QUEUE_LEN];
	size_t queue_head, queue_count;
	uint64_t retry_at_us; /* end of the back-off after ENOBUFS */
	uint32_t backoff_us;
};

/** Opens BUS: an interface name, `gs_usb[:SERIAL[:CHANNEL]]`, `slcan:DEVICE[@BAUD]`, `udp[:GROUP[:PORT]]`, and
 * options.
 * 0 and *port (close with can_close()), or -errno and one line in `error` that says what to do. `port` NULL: only
 * checks how BUS is written: 0, or -errno and the line. */
int can_open(const char *bus, struct can_port **port, char *error, size_t error_size);
void can_close(struct can_port *port);

/** Sends, or queues when the bus is full or frames are queued already (the order is kept). 0, or -errno when the frame
 * was dropped, which is counted. */
int can_send(struct can_port *port, const struct can_msg *msg, uint64_t now_us);
/** These call the driver, see struct can_ops; can_receive() counts the frames. */
int can_receive(struct can_port *port, struct can_msg *msg, uint64_t now_us);
int can_filter(struct can_port *port, const uint32_t *ids, size_t n);
int can_bit_rate(struct can_port *port, uint32_t bit_s, bool dry_run);
void can_refresh(struct can_port *port);
int can_restart(struct can_port *port);
/** Sends queued frames and does what the driver has to do. Returns the next deadline. */
uint64_t can_service(struct can_port *port, uint64_t now_us);

#endif
