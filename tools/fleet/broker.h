/* tools/fleet/broker.h
 * The connection to the MQTT broker, by libmosquitto, in a thread of its own: only that waits for the network. A
 * connection is made when it is asked for, with a last will, and lives until it breaks; what becomes of it are events.
 * Nothing is sent again over another connection: the caller does that, from what was not acknowledged. */
#ifndef TOOLS_FLEET_BROKER_H
#define TOOLS_FLEET_BROKER_H

#include <pthread.h>

#include "tools/fleet/format.h"
#include "tools/fleet/ring.h"

enum { BROKER_TEXT_MAX = 256, BROKER_COMMAND_MAX = 2048 };

struct broker_config {
	char host[BROKER_TEXT_MAX], client_id[BROKER_TEXT_MAX];
	int port, keepalive_s;
	bool tls;
	char ca[BROKER_TEXT_MAX], cert[BROKER_TEXT_MAX], key[BROKER_TEXT_MAX]; /* files; empty: system's CAs, none */
	char user[BROKER_TEXT_MAX], password[BROKER_TEXT_MAX];		       /* empty: none */
	char subscriptions[FORMAT_SUBSCRIPTIONS][FORMAT_TOPIC_MAX];
	size_t subscription_count;
};

struct broker_event {
	enum { BROKER_CONNECTED, BROKER_DISCONNECTED, BROKER_ACKED } kind;
	long acknowledgement; /* ACKED */
	char why[128];	      /* DISCONNECTED: also when it could not connect */
};

/** In the thread of the connection: must not wait. */
typedef void broker_on_message(void *ctx, const char *topic, const void *payload, size_t size, bool retained);

struct broker {
	struct ring events; /* struct broker_event, for the one thread that calls the functions below */

	/* PRIVATE */
	const struct broker_config *config;
	broker_on_message *on_message;
	void *ctx;
	pthread_t thread;
	pthread_mutex_t lock; /* of what follows */
	pthread_cond_t order;
	bool wanted, ending;
	atomic_bool drop;
	char will_topic[FORMAT_TOPIC_MAX];
	uint8_t will_payload[FORMAT_PAYLOAD_MAX];
	size_t will_size;
	int will_qos;
	bool will_retain;
	struct mosquitto *connection; /* NULL: none that takes messages */
};

/** Starts the thread. 0, or -errno. `config` must outlive it. */
int broker_start(struct broker *b, const struct broker_config *config, broker_on_message *on_message, void *ctx);
/** One attempt to connect; an event tells what becomes of it. Only while there is no connection. */
void broker_connect(struct broker *b, const struct message *will);
/** As struct publisher: the number of the acknowledgement, 0 for QoS 0, -1: no connection. Does not wait. */
long broker_publish(struct broker *b, const struct message *message);
/** Ends the connection, if there is one; an event follows. */
void broker_drop(struct broker *b);
/** Disconnects as MQTT says, so that the last will is not published. Waits a second at most, then leaves the thread to
 * the end of the process. */
void broker_stop(struct broker *b);

#endif
