#include "tools/fleet/broker.h"

#include <errno.h>
#include <mosquitto.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

enum { LOOP_MS = 500, EVENTS_BYTES = 1 << 18, TLS_VERIFY_PEER = 1 };

static void tell(struct broker *b, const struct broker_event *event)
{
	if (!ring_put(&b->events, event, sizeof(*event)))
		atomic_store(&b->drop, true); /* what was not acknowledged is sent again */
}

/* ---- callbacks of libmosquitto, in the thread -------------------------------------------------------------------- */

struct attempt {
	struct broker *broker;
	int refused; /* reason of CONNACK; -1: none yet */
};

static void on_connect(struct mosquitto *connection, void *ctx, int reason)
{
	struct attempt *attempt = ctx;

	(void)connection;
	attempt->refused = reason;
}

static void on_publish(struct mosquitto *connection, void *ctx, int mid)
{
	const struct attempt *attempt = ctx;

	(void)connection;
	tell(attempt->broker, &(struct broker_event){.kind = BROKER_ACKED, .acknowledgement = mid});
}

static void on_message(struct mosquitto *connection, void *ctx, const struct mosquitto_message *m)
{
	const struct attempt *attempt = ctx;

	(void)connection;
	if (m->payloadlen >= 0)
		attempt->broker->on_message(
			attempt->broker->ctx, m->topic, m->payload, (size_t)m->payloadlen, m->retain);
}

/* ---- the thread -------------------------------------------------------------------------------------------------- */

static int set_up(struct broker *b, struct mosquitto *connection)
{
	const struct broker_config *c = b->config;
	int result = mosquitto_threaded_set(connection, true);

	mosquitto_connect_callback_set(connection, on_connect);
	mosquitto_publish_callback_set(connection, on_publish);
	mosquitto_message_callback_set(connection, on_message);
	mosquitto_max_inflight_messages_set(connection, 0); /* the caller limits them */
	if (result == MOSQ_ERR_SUCCESS && b->will_size > 0)
		result = mosquitto_will_set(
			connection, b->will_topic, (int)b->will_size, b->will_payload, b->will_qos, b->will_retain);
	if (result == MOSQ_ERR_SUCCESS && c->user[0])
		result = mosquitto_username_pw_set(connection, c->user, c->password[0] ? c->password : NULL);
	if (result == MOSQ_ERR_SUCCESS && c->tls)
		result = mosquitto_tls_set(connection, c->ca[0] ? c->ca : NULL, c->ca[0] ? NULL : "/etc/ssl/certs",
			c->cert[0] ? c->cert : NULL, c->key[0] ? c->key : NULL, NULL);
	if (result == MOSQ_ERR_SUCCESS && c->tls)
		result = mosquitto_tls_opts_set(connection, TLS_VERIFY_PEER, "tlsv1.2", NULL);
	return result;
}

static const char *reason_of(int result)
{
	return result == MOSQ_ERR_ERRNO ? strerror(errno) : mosquitto_strerror(result);
}

static bool subscribe(const struct broker_config *config, struct mosquitto *connection)
{
	for (size_t i = 0; i < config->subscription_count; i++)
		if (mosquitto_subscribe(connection, NULL, config->subscriptions[i], 1) != MOSQ_ERR_SUCCESS)
			return false;
	return true;
}

static void offer(struct broker *b, struct mosquitto *connection)
{
	pthread_mutex_lock(&b->lock);
	b->connection = connection;
	pthread_mutex_unlock(&b->lock);
}

static bool is_ending(struct broker *b)
{
	pthread_mutex_lock(&b->lock);
	bool ending = b->ending;
	pthread_mutex_unlock(&b->lock);
	return ending;
}

/* Until the connection ends; `why`: it could not be made, or what ended it. */
static void live(struct broker *b, struct mosquitto *connection, struct attempt *attempt, char *why, size_t size)
{
	bool offered = false;
	int result = set_up(b, connection);

	if (result == MOSQ_ERR_SUCCESS) {
		errno = 0;
		result = mosquitto_connect(connection, b->config->host, b->config->port, b->config->keepalive_s);
	}
	while (result == MOSQ_ERR_SUCCESS && attempt->refused <= 0 && !atomic_load(&b->drop)) {
		result = mosquitto_loop(connection, LOOP_MS, 1);
		if (attempt->refused != 0 || offered || result != MOSQ_ERR_SUCCESS)
			continue;
		offered = true;
		if (!subscribe(b->config, connection))
			break;
		offer(b, connection);
		tell(b, &(struct broker_event){.kind = BROKER_CONNECTED});
	}
	if (attempt->refused > 0)
		snprintf(why, size, "refused: %s", mosquitto_connack_string(attempt->refused));
	else
		snprintf(why, size, "%s", atomic_load(&b->drop) ? "dropped: it took no message" : reason_of(result));
	offer(b, NULL);
	if (is_ending(b) && result == MOSQ_ERR_SUCCESS && mosquitto_disconnect(connection) == MOSQ_ERR_SUCCESS)
		mosquitto_loop(connection, 0, 1); /* writes what is left */
}

static void connect_once(struct broker *b)
{
	struct attempt attempt = {.broker = b, .refused = -1};
	struct mosquitto *connection = mosquitto_new(b->config->client_id, true, &attempt);
	struct broker_event end = {.kind = BROKER_DISCONNECTED, .why = "no memory"};

	atomic_store(&b->drop, false);
	if (connection)
		live(b, connection, &attempt, end.why, sizeof(end.why));
	mosquitto_destroy(connection);
	tell(b, &end);
}

static bool wait_for_order(struct broker *b)
{
	pthread_mutex_lock(&b->lock);
	while (!b->wanted && !b->ending)
		pthread_cond_wait(&b->order, &b->lock);
	b->wanted = false;
	bool ending = b->ending;
	pthread_mutex_unlock(&b->lock);
	return !ending;
}

static void *run(void *ctx)
{
	struct broker *b = ctx;

	while (wait_for_order(b))
		connect_once(b);
	return NULL;
}

/* ---- the other side ---------------------------------------------------------------------------------------------- */

int broker_start(struct broker *b, const struct broker_config *config, broker_on_message *on_message_, void *ctx)
{
	sigset_t all, before;

	*b = (struct broker){.config = config, .on_message = on_message_, .ctx = ctx};
	int result = ring_open(&b->events, EVENTS_BYTES);
	if (result < 0)
		return result;
	mosquitto_lib_init();
	pthread_mutex_init(&b->lock, NULL);
	pthread_cond_init(&b->order, NULL);
	sigfillset(&all);
	pthread_sigmask(SIG_BLOCK, &all, &before);
	result = pthread_create(&b->thread, NULL, run, b);
	pthread_sigmask(SIG_SETMASK, &before, NULL);
	return -result;
}

void broker_connect(struct broker *b, const struct message *will)
{
	pthread_mutex_lock(&b->lock);
	snprintf(b->will_topic, sizeof(b->will_topic), "%s", will->topic);
	b->will_size = will->size < sizeof(b->will_payload) ? will->size : 0;
	memcpy(b->will_payload, will->payload, b->will_size);
	b->will_qos = will->qos;
	b->will_retain = will->retain;
	b->wanted = true;
	pthread_cond_signal(&b->order);
	pthread_mutex_unlock(&b->lock);
}

long broker_publish(struct broker *b, const struct message *message)
{
	int mid = 0, result = MOSQ_ERR_NO_CONN;

	pthread_mutex_lock(&b->lock);
	if (b->connection)
		result = mosquitto_publish(b->connection, &mid, message->topic, (int)message->size, message->payload,
			message->qos, message->retain);
	pthread_mutex_unlock(&b->lock);
	if (result == MOSQ_ERR_SUCCESS)
		return message->qos > 0 ? mid : 0;
	broker_drop(b);
	return -1;
}

void broker_drop(struct broker *b)
{
	atomic_store(&b->drop, true);
}

void broker_stop(struct broker *b)
{
	struct timespec until;

	pthread_mutex_lock(&b->lock);
	b->ending = true;
	pthread_cond_signal(&b->order);
	pthread_mutex_unlock(&b->lock);
	atomic_store(&b->drop, true);
	clock_gettime(CLOCK_REALTIME, &until);
	until.tv_sec += 1;
	if (pthread_timedjoin_np(b->thread, NULL, &until) != 0)
		return; /* it waits for a name or a connection */
	ring_close(&b->events);
	mosquitto_lib_cleanup();
}
