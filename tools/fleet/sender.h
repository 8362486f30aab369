/* tools/fleet/sender.h
 * The thread that publishes: takes the records of the CAN loop, keeps what waits (outbox.h, spool.h), makes messages of
 * it (format.h) and gives them to the broker (broker.h). It waits for the disk; the CAN loop waits for nothing. */
#ifndef TOOLS_FLEET_SENDER_H
#define TOOLS_FLEET_SENDER_H

#include "tools/fleet/broker.h"
#include "tools/fleet/format.h"
#include "tools/fleet/outbox.h"
#include "tools/fleet/ring.h"

struct sender_config {
	struct broker_config broker;
	struct format_config format;
	const struct format_ops *ops;
	const char *spool_folder;
	uint64_t spool_bytes;
	double late_hz; /* records from the spool a second, at most */
};

struct sender {
	struct ring records; /* encoded; put by the CAN loop */

	/* PRIVATE */
	const struct sender_config *config;
	pthread_t thread;
	struct broker broker;
	struct format format;
	struct outbox outbox;
	struct spool spool;
	struct outbox_port port;
	struct publisher publisher;
	uint64_t connect_us; /* next attempt; UINT64_MAX: connected, or one is under way */
	uint64_t pause_us;
	uint64_t status_us, told_dropped;
	uint64_t connections;
	long awaited; /* acknowledgement of the last message; 0: it has come */
	bool connected, failed_told, disk_told;
	atomic_bool ending, rebirth;
	atomic_bool working;
	atomic_uint turns;
	pthread_mutex_t lock;
	struct fleet_status can; /* what the CAN loop counts; under lock */
};

/** Opens the spool and starts the threads. 0, or -errno: of the spool, whose folder is created. `on_command`: in the
 * thread of the broker. */
int sender_start(struct sender *s, const struct sender_config *config, broker_on_message *on_command, void *ctx);
/** A record, of the CAN loop. Does not wait; what does not fit is counted. */
void sender_put(struct sender *s, const struct record *record);
/** Counts of the CAN loop for the status. Does not wait: they may be left out this time. */
void sender_count(struct sender *s, const struct fleet_status *can);
/** Any thread: a subscriber asks for names and last values. */
void sender_rebirth(struct sender *s);
/** Whether the thread is in the same turn as at the call before: it may be waiting for the disk. */
bool sender_is_busy(struct sender *s, unsigned *turns);
/** Puts into the spool what is not delivered, and disconnects. */
void sender_stop(struct sender *s);

#endif
