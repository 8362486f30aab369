#include "tools/fleet/sender.h"

#include <errno.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "gateway/canopen/deadline.h"
#include "gateway/log.h"
#include "tools/lib/cli.h"

enum {
	RECORDS_BYTES = 1 << 20, /* of 10 nodes at 100 Hz, 5 s */
	RECORDS_A_TURN = 512,
	STATUS_US = 10000000,
	LAST_ACKNOWLEDGEMENTS_US = 500000,
	FIRST_PAUSE_US = 500000,
	LAST_PAUSE_US = 10000000
};

static int64_t utc_us(void)
{
	struct timespec t;

	clock_gettime(CLOCK_REALTIME, &t);
	return (int64_t)t.tv_sec * 1000000 + t.tv_nsec / 1000;
}

/* ---- messages ---------------------------------------------------------------------------------------------------- */

static long publish(void *ctx, const struct message *message)
{
	struct sender *s = ctx;

	long acknowledgement = broker_publish(&s->broker, message);

	if (acknowledgement > 0)
		s->awaited = acknowledgement;
	return acknowledgement;
}

static long send_record(void *ctx, const uint8_t *bytes, size_t size, bool late)
{
	struct sender *s = ctx;
	struct record record;

	if (record_decode(&record, bytes, size) < 0)
		return 0; /* of another version, in the spool */
	return s->format.ops->record(&s->format, &s->publisher, &record, late);
}

static uint64_t dropped(const struct fleet_status *status)
{
	return status->bus_dropped + status->hand_over_dropped + status->commands_dropped + status->spool_dropped +
	       status->lost;
}

static struct fleet_status status_of(struct sender *s)
{
	pthread_mutex_lock(&s->lock);
	struct fleet_status status = s->can;
	pthread_mutex_unlock(&s->lock);
	status.hand_over_dropped = atomic_load(&s->records.dropped);
	status.sent = s->outbox.sent;
	status.delivered = s->outbox.delivered;
	status.lost = s->outbox.lost;
	status.spooled = s->spool.records;
	status.spool_bytes = s->spool.bytes;
	status.spool_dropped = s->spool.dropped;
	status.spool_damaged = s->spool.damaged;
	status.spool_errors = s->spool.errors;
	status.connections = s->connections;
	return status;
}

static void tell_status(struct sender *s, uint64_t now_us)
{
	struct fleet_status status = status_of(s);

	if (status.spool_errors > 0 && !s->disk_told)
		log_warning("the disk of the spool %s fails: records can be lost while the broker is away",
			s->config->spool_folder);
	s->disk_told = status.spool_errors > 0;
	if (!s->connected || (now_us < s->status_us && dropped(&status) == s->told_dropped))
		return;
	s->status_us = now_us + STATUS_US;
	s->told_dropped = dropped(&status);
	s->format.ops->status(&s->format, &s->publisher, &status, utc_us());
}

/* ---- the connection ---------------------------------------------------------------------------------------------- */

static void connect_now(struct sender *s)
{
	struct message will;

	s->connect_us = UINT64_MAX;
	s->format.ops->will(&s->format, &will);
	broker_connect(&s->broker, &will);
}

static void on_connected(struct sender *s, uint64_t now_us)
{
	s->connected = true;
	s->failed_told = false;
	s->pause_us = FIRST_PAUSE_US;
	s->status_us = now_us;
	s->connections++;
	log_line("connected to %s:%d; %llu records wait in the spool", s->config->broker.host, s->config->broker.port,
		(unsigned long long)s->spool.records);
	if (s->format.ops->begin(&s->format, &s->publisher, utc_us()))
		outbox_connected(&s->outbox, now_us);
	else
		broker_drop(&s->broker);
}

static void on_disconnected(struct sender *s, const char *why, uint64_t now_us)
{
	if (s->connected || !s->failed_told)
		log_warning("no connection to %s:%d: %s; records go to the spool %s", s->config->broker.host,
			s->config->broker.port, why, s->config->spool_folder);
	s->failed_told = true;
	s->connected = false;
	outbox_disconnected(&s->outbox);
	s->connect_us = now_us + s->pause_us;
	s->pause_us = earlier(2 * s->pause_us, LAST_PAUSE_US);
}

static void take_events(struct sender *s, uint64_t now_us)
{
	struct broker_event event;

	ring_clear(&s->broker.events);
	while (ring_get(&s->broker.events, &event, sizeof(event)) > 0)
		switch (event.kind) {
		case BROKER_CONNECTED:
			on_connected(s, now_us);
			break;
		case BROKER_DISCONNECTED:
			on_disconnected(s, event.why, now_us);
			break;
		case BROKER_ACKED:
			outbox_acked(&s->outbox, event.acknowledgement);
			if (event.acknowledgement == s->awaited)
				s->awaited = 0;
			break;
		}
}

/* ---- the thread -------------------------------------------------------------------------------------------------- */

/* True: there may be more. */
static bool take_records(struct sender *s, uint64_t now_us)
{
	uint8_t bytes[RECORD_MAX];
	size_t size;

	ring_clear(&s->records);
	for (int n = 0; n < RECORDS_A_TURN; n++) {
		size = ring_get(&s->records, bytes, sizeof(bytes));
		if (size == 0)
			return false;
		if (bytes[0] == RECORD_ANSWER) {
			if (s->connected) /* who asked waits, and has not more of it later */
				send_record(s, bytes, size, false);
		} else {
			outbox_put(&s->outbox, bytes, size, now_us);
		}
	}
	return true;
}

static uint64_t turn(struct sender *s, bool *more)
{
	uint64_t now_us = cli_now_us();

	take_events(s, now_us);
	*more = take_records(s, now_us);
	if (atomic_exchange(&s->rebirth, false) && s->connected &&
		!s->format.ops->begin(&s->format, &s->publisher, utc_us()))
		broker_drop(&s->broker);
	uint64_t next_us = outbox_tick(&s->outbox, now_us);
	tell_status(s, now_us);
	if (now_us >= s->connect_us)
		connect_now(s);
	return earlier(next_us, s->connect_us);
}

static void wait_until(struct sender *s, uint64_t until_us)
{
	struct pollfd fds[] = {{.fd = s->records.fd, .events = POLLIN}, {.fd = s->broker.events.fd, .events = POLLIN}};
	uint64_t now_us = cli_now_us();
	uint64_t wait_us = until_us > now_us ? earlier(until_us - now_us, 1000000) : 0;
	struct timespec timeout = {.tv_nsec = (long)(wait_us % 1000000) * 1000, .tv_sec = (time_t)(wait_us / 1000000)};

	ppoll(fds, 2, &timeout, NULL);
}

/* What is acknowledged at the last moment is not sent again after the next start. And a connection that is closed with
 * input unread is reset: the broker then misses the DISCONNECT, and publishes the will. */
static void wait_for_acknowledgements(struct sender *s)
{
	uint64_t now_us = cli_now_us(), end_us = now_us + LAST_ACKNOWLEDGEMENTS_US;

	for (; s->connected && (s->outbox.count > 0 || s->awaited > 0) && now_us < end_us; now_us = cli_now_us()) {
		wait_until(s, end_us);
		take_events(s, now_us);
	}
}

static void *run(void *ctx)
{
	struct sender *s = ctx;

	while (!atomic_load(&s->ending)) {
		bool more;

		atomic_store(&s->working, true);
		uint64_t next_us = turn(s, &more);
		atomic_store(&s->working, false);
		atomic_fetch_add(&s->turns, 1);
		if (!more)
			wait_until(s, next_us);
	}
	while (take_records(s, cli_now_us()))
		;
	wait_for_acknowledgements(s);
	if (s->connected) {
		s->format.ops->end(&s->format, &s->publisher, utc_us());
		wait_for_acknowledgements(s);
	}
	outbox_disconnected(&s->outbox);
	spool_close(&s->spool);
	return NULL;
}

/* ---- the other side ---------------------------------------------------------------------------------------------- */

/* The folder and those above it. */
static int make_folder(const char *path)
{
	char part[SPOOL_PATH_MAX];

	if (strlen(path) >= sizeof(part))
		return -ENAMETOOLONG;
	for (size_t i = 1; i <= strlen(path); i++)
		if (path[i] == '/' || path[i] == '\0') {
			snprintf(part, sizeof(part), "%.*s", (int)i, path);
			if (mkdir(part, 0700) < 0 && errno != EEXIST)
				return -errno;
		}
	return 0;
}

int sender_start(struct sender *s, const struct sender_config *config, broker_on_message *on_command, void *ctx)
{
	sigset_t all, before;

	*s = (struct sender){.config = config, .pause_us = FIRST_PAUSE_US};
	s->port = (struct outbox_port){s, send_record};
	s->publisher = (struct publisher){s, publish};
	int result = make_folder(config->spool_folder);
	if (result == 0)
		result = spool_open(&s->spool, config->spool_folder, config->spool_bytes);
	if (result == 0)
		result = ring_open(&s->records, RECORDS_BYTES);
	if (result == 0)
		result = broker_start(&s->broker, &config->broker, on_command, ctx);
	if (result < 0)
		return result;
	outbox_init(&s->outbox, &s->port, &s->spool, config->late_hz);
	format_init(&s->format, config->ops, &config->format, (uint8_t)(utc_us() / 1000000));
	pthread_mutex_init(&s->lock, NULL);
	sigfillset(&all);
	pthread_sigmask(SIG_BLOCK, &all, &before);
	result = pthread_create(&s->thread, NULL, run, s);
	pthread_sigmask(SIG_SETMASK, &before, NULL);
	return -result;
}

void sender_put(struct sender *s, const struct record *record)
{
	uint8_t bytes[RECORD_MAX];

	ring_put(&s->records, bytes, record_encode(record, bytes)); /* counted in it */
}

void sender_count(struct sender *s, const struct fleet_status *can)
{
	if (pthread_mutex_trylock(&s->lock) != 0)
		return;
	s->can = *can;
	pthread_mutex_unlock(&s->lock);
}

void sender_rebirth(struct sender *s)
{
	atomic_store(&s->rebirth, true);
}

bool sender_is_busy(struct sender *s, unsigned *turns)
{
	unsigned before = *turns;

	*turns = atomic_load(&s->turns);
	return atomic_load(&s->working) && *turns == before;
}

void sender_stop(struct sender *s)
{
	const uint64_t one = 1;

	atomic_store(&s->ending, true);
	if (write(s->records.fd, &one, sizeof(one)) < 0)
		log_warning("the thread that publishes is woken late");
	pthread_join(s->thread, NULL);
	broker_stop(&s->broker);
	ring_close(&s->records);
}
