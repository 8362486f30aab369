/* gateway/record.h
 * Records all that goes into the device: samples as the driver delivered them, frames, the time of each call, and what
 * the ports answered. The device is passive, so the same inputs give the same outputs: imu9-replay repeats every value
 * and every frame, bit for bit. A recording can begin at any moment, with the state of the device (device_state.h).
 *
 * This is the side of the loop: inputs go into a ring that was allocated at the start, in bounded time and without a
 * system call; record_file.h takes them out in a thread of its own. What does not fit is counted, and recording goes on
 * with a new file, with the state of then. 215Ch starts and stops it. Functions take NULL for "no recording". */
#ifndef GATEWAY_RECORD_H
#define GATEWAY_RECORD_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "drivers/ports/can.h"
#include "drivers/ports/imu.h"
#include "od/od.h"

struct device;

enum record_kind {
	RECORD_START = 1, /* device_start(); value: stored_damaged */
	RECORD_SAMPLE,	  /* device_sample() of one */
	RECORD_FAILED,	  /* device_sample() without; value: what imu_read() returned */
	RECORD_FRAME,	  /* device_receive() */
	RECORD_WRITE,	  /* device_write() of up to OD_VALUE_MAX bytes */
	RECORD_CLOCK,	  /* device_host_clock(): offset; value: synchronised */
	RECORD_SAVED,	  /* device_saved(): value */
	RECORD_AWAY,	  /* device_away(): offset */
	RECORD_TICK,	  /* device_tick() */
	RECORD_ANSWER,	  /* what a port returned during the input before: value */
	RECORD_BUS,	  /* the ports as the next input finds them */
	RECORD_IMU,
	RECORD_SELF,
	RECORD_OTHERS, /* others have sent frames through the bus's port since it was recorded last */
	RECORD_LOST,   /* value: inputs that are missing here; a file ends */
	RECORD_LAST_ROW = RECORD_LOST,
	/* for the files alone */
	RECORD_CUT,  /* a file begins, with the state */
	RECORD_STOP, /* a file ends */
	RECORD_KEEP, /* the last minute */
};

/** What the device reads of a struct can_port. */
struct record_bus {
	struct can_counters counters;
	uint64_t frames, bytes;
	uint32_t queued; /* frames */
	uint32_t bit_s;
	uint8_t state, tx_errors, rx_errors;
};

/** What it reads of a struct imu_port. */
struct record_imu {
	struct imu_health health;
	struct imu_counters counters;
	double rate_hz;
	uint64_t silence_us;
};

enum record_state { RECORD_OFF, RECORD_ON, RECORD_ENDED }; /* 215Ch:2 */

/** A write that came by none of the buses. */
struct record_write {
	uint16_t index;
	uint8_t sub, size;
	uint8_t wire[OD_VALUE_MAX];
};

/** What 215Ch shows. */
struct record_self {
	uint32_t lost;
	uint16_t kept;
	uint8_t state;
	int32_t error; /* errno of RECORD_ENDED */
};

struct record_entry {
	enum record_kind kind;
	int32_t value;
	uint64_t now_us;
	union {
		struct imu_sample sample;
		struct can_msg msg;
		struct record_write write;
		int64_t offset_us;
		struct record_bus bus;
		struct record_imu imu;
		struct record_self self;
	};
};

enum { RECORD_RING = 16384 }; /* inputs: 20 s at 100 samples and SYNCs a second */

struct record {
	struct device *device;
	bool replayed; /* by imu9-replay: nothing is recorded, and `self` is what it was then */
	struct record_self self;
	/* PRIVATE: of the loop */
	bool wanted, on, cut, stop;
	struct record_bus bus; /* as recorded last; without the frames that are counted below */
	struct record_imu imu;
	uint32_t received, samples; /* by the device */
	uint32_t lost, lost_now;    /* since the start; since the ring was full */
	/* PRIVATE: of both threads */
	struct record_entry *ring;
	atomic_size_t head, tail; /* entries put in and taken out so far */
	uint8_t *state;		  /* sizeof(struct device) bytes, for RECORD_CUT */
	atomic_bool state_in_use; /* from RECORD_CUT on until it is in the file */
	atomic_bool full;	  /* the file has its size: begin another one */
	atomic_uint kept;
	atomic_int error; /* errno that ended the recording; 0: none */
};

/** Allocates; recording begins with the first input. 0, or -ENOMEM. */
int record_open(struct record *r);
void record_close(struct record *r);
/** For device_init(): 215Ch. */
void record_attach_object(struct device *d);
/** After device_init(); without it 215Ch refuses commands. */
void record_attach(struct record *r, struct device *d);

/** Before the device does anything with the input. `e`: kind, now_us and what belongs to it. */
void record_input(struct record *r, const struct record_entry *e);
/** RECORD_SAMPLE or RECORD_FAILED, as device_sample() gets it. */
void record_sample(struct record *r, int read, const struct imu_sample *sample, uint64_t now_us);
/** RECORD_TICK; also publishes 215Ch. */
void record_tick(struct record *r, uint64_t now_us);
/** What a port returned: `rc`, which is also the result. */
int record_answer(struct record *r, int rc);
/** The same of the sensor's driver, and its rate. */
void record_configured(struct record *r, int rc, const struct imu_port *imu);
/** can_refresh() has run. */
void record_refreshed(struct record *r, const struct can_port *bus);
/** RECORD_WRITE, as device_write() gets it. */
void record_write(struct record *r, uint16_t index, uint8_t sub, const void *wire, size_t size, uint64_t now_us);
/** RECORD_OTHERS */
void record_others(struct record *r);
/** An error was raised: the last minute is kept. */
void record_emcy(struct record *r, uint64_t now_us);
/** Something came in that is no input: goes on with a new file. */
void record_begin_again(struct record *r);

/** For the thread that writes: the next entry, or NULL; it stays until record_taken(). */
const struct record_entry *record_next(struct record *r);
void record_taken(struct record *r);

#endif
