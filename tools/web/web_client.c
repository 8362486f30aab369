/* A browser: its requests, the answers that wait for it, and the events that it has not seen. */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/canopen/deadline.h"
#include "gateway/canopen/emcy_codes.h"
#include "tools/web/request.h"
#include "tools/web/web.h"

enum { NODES_US = 500000, BURST = 2 * WEB_REQUESTS_HZ };

#define PLAIN (JSON_C_TO_STRING_PLAIN | JSON_C_TO_STRING_NOSLASHESCAPE)

/* ---- messages ---------------------------------------------------------------------------------------------------- */

/* Names and texts of devices may be in any encoding; a text frame is UTF-8. */
static void make_utf8(char *text, size_t size)
{
	for (size_t i = 0; i < size;) {
		unsigned char c = (unsigned char)text[i];
		size_t more = c < 0x80		      ? 0
			      : c >= 0xC2 && c < 0xE0 ? 1
			      : c >= 0xE0 && c < 0xF0 ? 2
			      : c >= 0xF0 && c < 0xF5 ? 3
						      : 4;
		bool good = more < 4 && i + more < size;

		for (size_t j = 1; good && j <= more; j++)
			good = ((unsigned char)text[i + j] & 0xC0) == 0x80;
		if (good && more >= 2) { /* neither overlong, nor a surrogate, nor above 10FFFFh */
			unsigned char d = (unsigned char)text[i + 1];

			good = !(c == 0xE0 && d < 0xA0) && !(c == 0xED && d > 0x9F) && !(c == 0xF0 && d < 0x90) &&
			       !(c == 0xF4 && d > 0x8F);
		}
		if (!good)
			text[i] = '?';
		i += good ? more + 1 : 1;
	}
}

static void queue_text(struct web_client *client, const char *head, const char *body, const char *tail)
{
	size_t sizes[] = {strlen(head), strlen(body), strlen(tail)}, size = sizes[0] + sizes[1] + sizes[2];
	struct web_message *message = malloc(sizeof(*message) + size + 1);

	if (!message)
		return; /* the browser waits in vain for this answer */
	message->next = NULL;
	message->size = size;
	memcpy(message->text, head, sizes[0]);
	memcpy(message->text + sizes[0], body, sizes[1]);
	memcpy(message->text + sizes[0] + sizes[1], tail, sizes[2] + 1);
	make_utf8(message->text, size);
	if (client->last_answer)
		client->last_answer->next = message;
	else
		client->answers = message;
	client->last_answer = message;
	client->answer_count++;
}

static void answer(struct web_client *client, int64_t id, const char *result)
{
	char head[64];

	snprintf(head, sizeof(head), "{\"id\":%lld,\"ok\":true,\"result\":", (long long)id);
	queue_text(client, head, result, "}");
}

static struct json_object *refusal(int64_t id, const char *error)
{
	struct json_object *json = json_object_new_object();

	json_object_object_add(json, "id", json_object_new_int64(id));
	json_object_object_add(json, "ok", json_object_new_boolean(false));
	json_object_object_add(json, "error", json_object_new_string(error));
	return json;
}

static void queue_json(struct web_client *client, struct json_object *json)
{
	queue_text(client, json_object_to_json_string_ext(json, PLAIN), "", "");
	json_object_put(json);
}

/* NULL: it has gone. */
static struct web_client *client_of(struct web *web, const struct web_job *job)
{
	struct web_client *client = job->client >= 0 ? &web->clients[job->client] : NULL;

	return client && client->open && client->serial == job->serial ? client : NULL;
}

static char *event_text(const char *name, unsigned int node, const char *result)
{
	size_t size = strlen(result) + 64;
	char *text = malloc(size);

	/* `result` is an object with members: its opening brace is left out */
	if (text)
		snprintf(text, size, "{\"event\":\"%s\",\"node\":%u,%s", name, node, result + 1);
	return text;
}

void web_answer_text(struct web *web, struct web_job *job, const char *result)
{
	struct web_client *client = client_of(web, job);

	if (!client)
		return;
	if (job->poll < 0) {
		answer(client, job->id, result);
		return;
	}
	struct web_poll *poll = &client->polls[job->poll];
	if (poll->version != job->poll_version)
		return; /* it was replaced */
	free(poll->event);
	poll->event = event_text("poll", job->node->id, result);
}

void web_answer(struct web *web, struct web_job *job, struct json_object *result)
{
	web_answer_text(web, job, json_object_to_json_string_ext(result, PLAIN));
	json_object_put(result);
}

void web_refuse(struct web *web, struct web_job *job, const char *format, ...)
{
	struct web_client *client = client_of(web, job);
	char text[512];
	va_list args;

	va_start(args, format);
	vsnprintf(text, sizeof(text), format, args);
	va_end(args);
	if (client && job->poll < 0)
		queue_json(client, refusal(job->id, text));
}

void web_refuse_step(struct web *web, struct web_job *job, const struct web_step *step)
{
	struct web_client *client = client_of(web, job);
	char text[256], abort_code[16], name[128];

	if (!client || job->poll >= 0)
		return;
	if (step->result != SDO_ABORTED) {
		web_refuse(web, job, "no answer from node %u", job->node->id);
		return;
	}
	snprintf(name, sizeof(name), "%04Xh:%02X", step->index, step->sub);
	snprintf(
		text, sizeof(text), "%s: %s", step->entry ? step->entry->name : name, sdo_abort_text(step->abort_code));
	snprintf(abort_code, sizeof(abort_code), "%08Xh", step->abort_code);
	struct json_object *json = refusal(job->id, text);
	json_object_object_add(json, "abort", json_object_new_string(abort_code));
	queue_json(client, json);
}

void web_answer_now(struct web *web, int client, int64_t id, struct json_object *result, const char *error)
{
	struct web_client *to = &web->clients[client];

	if (result)
		answer(to, id, json_object_to_json_string_ext(result, PLAIN));
	else
		queue_json(to, refusal(id, error));
	json_object_put(result);
}

/* ---- operations of the client itself ----------------------------------------------------------------------------- */

static struct json_object *hello_json(const struct web *web, const struct web_client *client)
{
	struct json_object *json = json_object_new_object();

	json_object_object_add(json, "program", json_object_new_string("imu9-web"));
	json_object_object_add(json, "version", json_object_new_string(IMU9_VERSION));
	json_object_object_add(json, "bus", json_object_new_string(web->config.bus_name));
	json_object_object_add(json, "unlocked", json_object_new_boolean(client->unlocked));
	return json;
}

static void op_hello(struct web *web, int client, int64_t id, struct json_object *request, uint64_t now_us)
{
	(void)request, (void)now_us;
	web_answer_now(web, client, id, hello_json(web, &web->clients[client]), NULL);
}

static void op_nodes(struct web *web, int client, int64_t id, struct json_object *request, uint64_t now_us)
{
	(void)request;
	web_answer_now(web, client, id, web_nodes_json(web, now_us), NULL);
}

static void op_unlock(struct web *web, int client, int64_t id, struct json_object *request, uint64_t now_us)
{
	const char *token = web_string(request, "token");
	struct json_object *result = NULL;
	char error[128];

	switch (web_token_try(web->config.token, token ? token : "", now_us)) {
	case WEB_UNLOCKED:
		web->clients[client].unlocked = true;
		result = json_object_new_object();
		json_object_object_add(result, "unlocked", json_object_new_boolean(true));
		break;
	case WEB_WRONG_TOKEN:
		web->unlock_failures++;
		fprintf(stderr, "imu9-web: wrong token, %u since the start\n", web->unlock_failures);
		snprintf(error, sizeof(error), "wrong token: imu9-web has printed it at its start");
		break;
	case WEB_WAIT:
		snprintf(error, sizeof(error), "too many wrong tokens: wait %u s",
			web_token_wait_s(web->config.token, now_us));
		break;
	}
	web_answer_now(web, client, id, result, error);
}

/* ---- subscriptions and polls ------------------------------------------------------------------------------------- */

static void drop_subscription(struct web_subscription *subscription)
{
	if (subscription->node)
		web_node_unsubscribe(subscription->node);
	*subscription = (struct web_subscription){0};
}

static struct web_subscription *find_subscription(struct web_client *client, const struct web_node *node)
{
	for (size_t i = 0; i < WEB_SUBSCRIPTIONS; i++)
		if (client->subscriptions[i].node == node)
			return &client->subscriptions[i];
	return NULL;
}

bool web_op_subscribe(struct web *web, struct web_job *job, uint64_t now_us)
{
	struct web_client *client = client_of(web, job);
	struct web_node *node = job->node;

	if (!client)
		return false;
	struct web_subscription *subscription = find_subscription(client, node);
	bool known = subscription;
	if (!known)
		subscription = find_subscription(client, NULL);
	if (!subscription) {
		web_refuse(web, job, "more than %d subscriptions", WEB_SUBSCRIPTIONS);
		return false;
	}
	web_node_subscribe(web, node, now_us);
	if (!node->watch) {
		web_refuse(web, job, "out of memory");
		return false;
	}
	if (!known) {
		*subscription = (struct web_subscription){.node = node, .position = node->rows->count};
		node->subscribers++;
	}
	subscription->fields = 0;
	subscription->interval_us = 1e6 / web_number(job->request, "hz", 0.1, 20, 20);
	web_answer(web, job, json_object_new_object());
	return false;
}

static void op_unsubscribe(struct web *web, int client, int64_t id, struct json_object *request, uint64_t now_us)
{
	int64_t number;
	struct web_node *node = web_integer(request, "node", 1, WEB_NODES - 1, &number) ? web_node(web, number) : NULL;
	struct web_subscription *subscription = node ? find_subscription(&web->clients[client], node) : NULL;

	(void)now_us;
	if (subscription)
		drop_subscription(subscription);
	web_answer_now(web, client, id, node ? json_object_new_object() : NULL, "\"node\" is a number from 1 to 127");
}

static void drop_poll(struct web_poll *poll)
{
	json_object_put(poll->request);
	free(poll->event);
	*poll = (struct web_poll){.running = poll->running, .version = poll->version + 1};
}

static unsigned int count_polls(const struct web *web)
{
	unsigned int n = 0;

	for (int i = 0; i < WEB_CLIENTS; i++)
		for (int j = 0; j < WEB_POLLS; j++)
			n += web->clients[i].open && web->clients[i].polls[j].node;
	return n;
}

static struct web_poll *find_poll(struct web_client *client, const struct web_node *node)
{
	for (size_t i = 0; i < WEB_POLLS; i++)
		if (client->polls[i].node == node)
			return &client->polls[i];
	return NULL;
}

static void op_poll(struct web *web, int client, int64_t id, struct json_object *request, uint64_t now_us)
{
	struct web_client *of = &web->clients[client];
	struct json_object *objects = web_array(request, "objects");
	int64_t number;
	struct web_node *node = web_integer(request, "node", 1, WEB_NODES - 1, &number) ? web_node(web, number) : NULL;
	double hz = web_number(request, "hz", 0, 10, 1);

	if (!node || !objects || json_object_array_length(objects) > WEB_OBJECTS) {
		web_answer_now(web, client, id, NULL,
			!node ? "\"node\" is a number from 1 to 127" : "\"objects\" is an array of names");
		return;
	}
	struct web_poll *poll = find_poll(of, node);
	if (!poll)
		poll = find_poll(of, NULL);
	if (!poll) {
		web_answer_now(web, client, id, NULL, "too many polls");
		return;
	}
	drop_poll(poll);
	if (hz > 0 && json_object_array_length(objects) > 0) {
		poll->node = node;
		poll->interval_us = 1e6 / hz;
		poll->due_us = now_us;
		poll->request = json_object_get(request);
	}
	web_answer_now(web, client, id, json_object_new_object(), NULL);
}

/* All polls together are at most 10 a second. */
static uint64_t tick_polls(struct web *web, int number, unsigned int polls, uint64_t now_us)
{
	struct web_client *client = &web->clients[number];
	uint64_t next_us = UINT64_MAX;

	for (int i = 0; i < WEB_POLLS; i++) {
		struct web_poll *poll = &client->polls[i];

		if (!poll->node || poll->running)
			continue;
		if (now_us >= poll->due_us) {
			double interval_us = poll->interval_us > polls * 1e5 ? poll->interval_us : polls * 1e5;
			struct web_job *job = NULL;

			if (poll->node->state != WATCH_NMT_LOST)
				job = web_enqueue(poll->node, web_op_read, poll->request);
			poll->due_us = now_us + (uint64_t)interval_us;
			if (job) {
				json_object_get(poll->request);
				poll->running = true;
				job->poll = i;
				job->poll_version = poll->version;
				job->client = number;
				job->serial = client->serial;
			}
		}
		next_us = earlier(next_us, poll->due_us);
	}
	return next_us;
}

/* ---- requests ---------------------------------------------------------------------------------------------------- */

static const struct web_op OPS[] = {
	{"hello", .now = op_hello},
	{"unlock", .now = op_unlock},
	{"nodes", .now = op_nodes},
	{"scan", .now = web_op_scan},
	{"objects", .work = web_op_objects},
	{"read", .work = web_op_read},
	{"events", .work = web_op_events},
	{"subscribe", .work = web_op_subscribe},
	{"unsubscribe", .now = op_unsubscribe},
	{"poll", .now = op_poll},
	{"mapping", .work = web_op_mapping},
	{"save", .work = web_op_save},
	{"compare", .work = web_op_compare},
	{"write", true, .work = web_op_write},
	{"load", true, .work = web_op_load},
	{"store", true, .work = web_op_store},
	{"restore", true, .work = web_op_restore},
	{"nmt", true, .now = web_op_nmt},
	{"set_mapping", true, .work = web_op_set_mapping},
	{"sync", true, .now = web_op_sync},
	{"lss", true, .now = web_op_lss},
	{"record", true, .work = web_op_record},
};

const struct web_op *web_find_op(const char *name)
{
	for (size_t i = 0; i < sizeof(OPS) / sizeof(OPS[0]); i++)
		if (strcmp(OPS[i].name, name) == 0)
			return &OPS[i];
	return NULL;
}

static bool takes_one(struct web_client *client, uint64_t now_us)
{
	client->allowance += (double)(now_us - client->allowance_us) * WEB_REQUESTS_HZ / 1e6;
	client->allowance_us = now_us;
	if (client->allowance > BURST)
		client->allowance = BURST;
	if (client->allowance < 1)
		return false;
	client->allowance--;
	return true;
}

static void refuse_locked(struct web_client *client, int64_t id)
{
	struct json_object *json = refusal(id, "this changes the bus: unlock with the token first");

	json_object_object_add(json, "locked", json_object_new_boolean(true));
	queue_json(client, json);
}

static void start_job(
	struct web *web, int client, const struct web_op *op, const struct web_request *request, size_t size)
{
	int64_t number;
	struct web_node *node =
		web_integer(request->json, "node", 1, WEB_NODES - 1, &number) ? web_node(web, number) : NULL;
	struct web_job *job = node ? web_enqueue(node, op->work, request->json) : NULL;

	if (!job) {
		web_answer_now(web, client, request->id, NULL,
			node ? "too many requests wait for this node" : "\"node\" is a number from 1 to 127");
		return;
	}
	json_object_get(request->json);
	job->client = client;
	job->serial = web->clients[client].serial;
	job->id = request->id;
	job->changes = op->changes;
	job->bytes = size;
	web->clients[client].jobs++;
	web->clients[client].job_bytes += size;
}

void web_request(struct web *web, int client, const char *text, size_t size, uint64_t now_us)
{
	struct web_client *from = &web->clients[client];
	struct web_request request;
	const char *error = NULL;

	/* not even parsed: its id is unknown */
	if (!takes_one(from, now_us)) {
		web_answer_now(web, client, 0, NULL, "too many requests in a second");
		return;
	}
	if (from->jobs + from->answer_count >= 2 * WEB_CLIENT_JOBS) { /* it should have waited */
		web_answer_now(web, client, 0, NULL, "too many requests without an answer");
		return;
	}
	if (!web_request_parse(&request, text, size, &error)) {
		web_answer_now(web, client, request.id, NULL, error);
		return;
	}
	const struct web_op *op = web_find_op(request.op);
	if (!op)
		web_answer_now(web, client, request.id, NULL, "there is no operation of this name");
	else if (op->changes && !from->unlocked)
		refuse_locked(from, request.id);
	else if (op->now)
		op->now(web, client, request.id, request.json, now_us);
	else
		start_job(web, client, op, &request, size);
	web_request_free(&request);
}

bool web_takes_input(const struct web *web, int client)
{
	const struct web_client *from = &web->clients[client];

	return from->jobs + from->answer_count < WEB_CLIENT_JOBS && from->job_bytes < WEB_REQUEST_MAX;
}

/* ---- connections ------------------------------------------------------------------------------------------------- */

int web_connect(struct web *web, uint64_t now_us)
{
	for (int i = 0; i < WEB_CLIENTS; i++) {
		struct web_client *client = &web->clients[i];

		if (client->open)
			continue;
		*client = (struct web_client){
			.open = true,
			.serial = ++web->serial,
			.allowance = BURST,
			.allowance_us = now_us,
			.nodes_version = web->nodes_version - 1,
			.bus_version = web->bus_version,
			.emcys = web->emcy_count,
		};
		return i;
	}
	return -1;
}

static void free_messages(struct web_message *message)
{
	while (message) {
		struct web_message *next = message->next;

		free(message);
		message = next;
	}
}

void web_disconnect(struct web *web, int number)
{
	struct web_client *client = &web->clients[number];

	for (size_t i = 0; i < WEB_SUBSCRIPTIONS; i++)
		drop_subscription(&client->subscriptions[i]);
	for (size_t i = 0; i < WEB_POLLS; i++)
		drop_poll(&client->polls[i]);
	free_messages(client->answers);
	free_messages(client->fetched);
	free(client->text);
	*client = (struct web_client){0};
	web_bus_disconnect(web, number);
}

/* ---- output ------------------------------------------------------------------------------------------------------ */

static bool is_due(uint64_t at_us, uint64_t now_us, uint64_t *due_us)
{
	if (now_us >= at_us)
		return true;
	*due_us = earlier(*due_us, at_us);
	return false;
}

static bool has_rows(const struct web_subscription *s, uint64_t now_us, uint64_t *due_us)
{
	const struct web_rows *rows = s->node ? s->node->rows : NULL;

	if (!rows || rows->fields == 0)
		return false;
	if (s->fields != rows->fields)
		return true;
	return s->position < rows->count && is_due(s->due_us, now_us, due_us);
}

bool web_has_output(const struct web *web, int number, uint64_t now_us, uint64_t *due_us)
{
	const struct web_client *client = &web->clients[number];

	if (!client->open)
		return false;
	if (client->answers || !client->said_hello || client->bus_version != web->bus_version ||
		client->emcys != web->emcy_count)
		return true;
	if (client->nodes_version != web->nodes_version && is_due(client->nodes_due_us, now_us, due_us))
		return true;
	for (size_t i = 0; i < WEB_POLLS; i++)
		if (client->polls[i].event)
			return true;
	for (size_t i = 0; i < WEB_SUBSCRIPTIONS; i++)
		if (has_rows(&client->subscriptions[i], now_us, due_us))
			return true;
	return false;
}

static const char *as_event(struct web_client *client, const char *name, struct json_object *json, size_t *size)
{
	json_object_object_add(json, "event", json_object_new_string(name));
	client->text = strdup(json_object_to_json_string_ext(json, PLAIN));
	json_object_put(json);
	if (client->text)
		make_utf8(client->text, *size = strlen(client->text));
	return client->text;
}

static struct json_object *bus_json(const struct web *web)
{
	struct json_object *json = json_object_new_object();

	json_object_object_add(json, "frames_hz", json_object_new_double(web->frames_hz));
	json_object_object_add(json, "load", web->load < 0 ? NULL : json_object_new_double(web->load));
	json_object_object_add(json, "sync_hz", json_object_new_double(web->sync_hz));
	return json;
}

static struct json_object *emcy_json(const struct web *web, struct web_client *client)
{
	struct json_object *json = json_object_new_object();
	uint64_t oldest = web->emcy_count > WEB_EMCYS ? web->emcy_count - WEB_EMCYS : 0;
	char code[8];

	if (client->emcys < oldest) {
		json_object_object_add(json, "lost", json_object_new_int64((int64_t)(oldest - client->emcys)));
		client->emcys = oldest;
	}
	const struct web_emcy *emcy = &web->emcys[client->emcys++ % WEB_EMCYS];
	snprintf(code, sizeof(code), "%04Xh", emcy->code);
	json_object_object_add(json, "node", json_object_new_int(emcy->node));
	json_object_object_add(json, "code", json_object_new_string(code));
	json_object_object_add(json, "text", json_object_new_string(emcy_code_text(emcy->code)));
	json_object_object_add(json, "register", json_object_new_int(emcy->error_register));
	return json;
}

/* What the loop of the nodes has for it; `text` is owned by the client. */
static const char *next_of_nodes(const struct web *web, struct web_client *client, size_t *size, uint64_t now_us)
{
	uint64_t due_us = UINT64_MAX;

	for (size_t i = 0; i < WEB_POLLS; i++) {
		struct web_poll *poll = &client->polls[i];

		if (!poll->event)
			continue;
		client->text = poll->event;
		poll->event = NULL;
		make_utf8(client->text, *size = strlen(client->text));
		return client->text;
	}
	for (size_t i = 0; i < WEB_SUBSCRIPTIONS; i++) {
		struct web_subscription *s = &client->subscriptions[i];

		if (!has_rows(s, now_us, &due_us))
			continue;
		if (s->fields != s->node->rows->fields) {
			client->text = web_fields_event(s, size);
			if (client->text)
				make_utf8(client->text, *size);
			return client->text;
		}
		client->text = web_rows_event(web, s, size, now_us);
		if (s->position == s->node->rows->count)
			s->due_us = now_us + (uint64_t)s->interval_us;
		return client->text;
	}
	return NULL;
}

const char *web_output(struct web *web, int number, size_t *size, uint64_t now_us)
{
	struct web_client *client = &web->clients[number];

	free(client->text);
	free(client->fetched);
	client->text = NULL;
	client->fetched = NULL;
	if (!client->said_hello) {
		client->said_hello = true;
		return as_event(client, "hello", hello_json(web, client), size);
	}
	if (client->answers) {
		struct web_message *message = client->fetched = client->answers;

		client->answers = message->next;
		if (!client->answers)
			client->last_answer = NULL;
		message->next = NULL;
		client->answer_count--;
		*size = message->size;
		return message->text;
	}
	if (client->emcys != web->emcy_count)
		return as_event(client, "emcy", emcy_json(web, client), size);
	if (client->nodes_version != web->nodes_version && now_us >= client->nodes_due_us) {
		client->nodes_version = web->nodes_version;
		client->nodes_due_us = now_us + NODES_US;
		return as_event(client, "nodes", web_nodes_json(web, now_us), size);
	}
	if (client->bus_version != web->bus_version) {
		client->bus_version = web->bus_version;
		return as_event(client, "bus", bus_json(web), size);
	}
	return next_of_nodes(web, client, size, now_us);
}

uint64_t web_clients_tick(struct web *web, uint64_t now_us)
{
	unsigned int polls = count_polls(web);
	uint64_t next_us = UINT64_MAX;

	for (int i = 0; i < WEB_CLIENTS && polls > 0; i++)
		if (web->clients[i].open)
			next_us = earlier(next_us, tick_polls(web, i, polls, now_us));
	return next_us;
}
