/* gateway/modbus/link.h
 * Between the loop, which owns the dictionary, and the thread of the Modbus server.
 *
 * Values go to the thread as snapshots in three buffers: one that the loop writes, one that the thread reads, and one
 * that they exchange by an atomic swap. Neither ever waits, and the thread sees whole snapshots only.
 *
 * What changes the dictionary, or needs the device to read it, goes to the loop as a job: one at a time. The thread
 * waits for it, the loop executes it between two events, and publishes a snapshot before it says that the job is done:
 * a client reads what it wrote.
 *
 * modbus_link_submit(), _values() and _late() belong to the thread, the other functions to the loop. */
#ifndef GATEWAY_MODBUS_LINK_H
#define GATEWAY_MODBUS_LINK_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>

#include "gateway/modbus/pdu.h"
#include "od_values.h"

enum { MODBUS_WHO_MAX = 80, MODBUS_LINK_PATIENCE_MS = 1000 };

struct modbus_job {
	enum modbus_job_kind {
		MODBUS_WRITE,
		MODBUS_MASK,
		MODBUS_WRITE_COILS,
		MODBUS_WRITE_OBJECT,
		MODBUS_READ_OBJECT, /* of type DOMAIN */
	} kind;
	char who[MODBUS_WHO_MAX]; /* the client, for the event log */
	uint16_t address, count;  /* registers or coils */
	uint16_t index;		  /* an object */
	uint8_t sub;
	uint8_t data[MODBUS_PDU_MAX]; /* to write; and_mask and or_mask for MODBUS_MASK */
	size_t size;		      /* of data, and of what was read */
	uint8_t *out;		      /* OD_DOMAIN_MAX bytes for what is read */
	const uint8_t *read;	      /* result: it is here (out, or constant memory) */
	enum od_status status;	      /* result */
	uint8_t ticket;		      /* its number, for modbus_link_late() */
};

struct modbus_link {
	/* PRIVATE */
	struct od_values values[3];
	atomic_uint shared;	   /* the buffer that is exchanged; and FRESH */
	unsigned writing, reading; /* of the loop, of the thread */
	struct modbus_job job;
	atomic_int state;
	atomic_int late; /* ticket << 8 | enum od_status of a job that was OD_PENDING; -1: none */
	bool pending;	 /* of the loop: the last such job has not ended */
	uint8_t pending_ticket;
	atomic_bool closing;
	int request_fd, done_fd;  /* eventfd; -1: direct */
	void (*serve)(void *ctx); /* direct: executes the job, without a thread */
	void *ctx;
};

/** Two threads, with eventfds: `request_fd` is for the loop, `done_fd` for the thread. 0, or -errno. */
int modbus_link_open(struct modbus_link *link);
/** One thread: modbus_link_submit() calls serve(ctx), which takes and ends the job. */
void modbus_link_direct(struct modbus_link *link, void (*serve)(void *ctx), void *ctx);
void modbus_link_close(struct modbus_link *link);
/** The loop will take no more jobs. */
void modbus_link_closing(struct modbus_link *link);

void modbus_link_publish(struct modbus_link *link, const struct od_values *values);
/** The latest snapshot. It stays as it is until the next call. */
const struct od_values *modbus_link_values(struct modbus_link *link);

/** Executes link->job and returns its status. OD_PENDING: modbus_link_late() has the status when done_fd is readable.
 * OD_DEVICE_STATE: the loop did not take it within MODBUS_LINK_PATIENCE_MS, and will not. */
enum od_status modbus_link_submit(struct modbus_link *link);
/** The ticket and the status of a job that was OD_PENDING and has ended. False: none has. */
bool modbus_link_late(struct modbus_link *link, uint8_t *ticket, enum od_status *status);

/** The job to be executed, or NULL. */
struct modbus_job *modbus_link_take(struct modbus_link *link);
void modbus_link_done(struct modbus_link *link);
/** A job that was OD_PENDING has ended. Without one this does nothing. */
void modbus_link_ended(struct modbus_link *link, enum od_status status);

#endif
