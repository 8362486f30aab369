/* JSON, one document a message; tools/imu9-json.schema.json describes them. */
#include <json-c/json.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "gateway/canopen/emcy_codes.h"
#include "od/little_endian.h"
#include "tools/fleet/format.h"
#include "tools/lib/cli_value.h"
#include "tools/lib/json_value.h"
#include "tools/lib/watch.h"

enum { DEPTH = 4 /* of a document */ };

static long publish(struct format *f, const struct publisher *to, struct json_object *document, bool retain)
{
	const char *text =
		json_object_to_json_string_ext(document, JSON_C_TO_STRING_PLAIN | JSON_C_TO_STRING_NOSLASHESCAPE);
	const struct message message = {
		.topic = f->topic, .payload = text, .size = strlen(text), .qos = 1, .retain = retain};
	long result = to->publish(to->ctx, &message);

	json_object_put(document);
	return result;
}

static void bus_topic(struct format *f, const char *what)
{
	snprintf(f->topic, sizeof(f->topic), "%s/%s/%s", f->config.prefix, f->config.bus, what);
}

static void node_topic(struct format *f, uint8_t node_id, const char *what)
{
	snprintf(f->topic, sizeof(f->topic), "%s/%s/%u/%s", f->config.prefix, f->config.bus, node_id, what);
}

static void add_text(struct json_object *to, const char *key, const char *text)
{
	json_object_object_add(to, key, json_object_new_string(text));
}

static void add_count(struct json_object *to, const char *key, uint64_t count)
{
	json_object_object_add(to, key, json_object_new_int64((int64_t)count));
}

static struct json_object *document_of(const struct format *f, uint8_t node_id, int64_t utc_us)
{
	struct json_object *document = json_object_new_object();
	char text[FORMAT_UTC_TEXT];

	format_utc(utc_us, text);
	json_object_object_add(document, "node", json_object_new_int(node_id));
	add_text(document, "bus", f->config.bus);
	add_text(document, "utc", text);
	return document;
}

/* ---- values ------------------------------------------------------------------------------------------------------ */

static struct json_object *field_value(const struct od_entry *entry, const struct record_field *field)
{
	char text[CLI_VALUE_TEXT_MAX];
	uint8_t wire[OD_VALUE_MAX];

	put_uint(wire, field->wire, 8);
	if (!entry)
		return json_object_new_uint64(field->wire);
	if (entry->type == OD_BOOLEAN)
		return json_object_new_boolean(wire[0] != 0);
	bool is_text = entry->type == OD_VISIBLE_STRING || entry->type == OD_OCTET_STRING;
	if (od_format(entry, wire, entry->size, text, sizeof(text)) < 0)
		return NULL;
	if (is_text)
		return json_object_new_string(text);
	double value = cli_number(entry, wire) * field->step;
	if (!isfinite(value))
		return NULL; /* JSON has neither infinity nor NAN */
	if (field->step < 1 || field->step > 1)
		snprintf(text, sizeof(text), "%.10g", value);
	return json_object_new_double_s(value, text);
}

static long publish_values(struct format *f, const struct publisher *to, const struct record *record)
{
	struct json_object *document = document_of(f, record->node_id, record->utc_us);
	struct json_object *values = json_object_new_object();
	char name[128];

	if (record->counted)
		json_object_object_add(document, "sample", json_object_new_int(record->counter));
	for (size_t i = 0; i < record->field_count; i++) {
		const struct od_entry *entry = format_entry(f, record->node_id, &record->fields[i]);

		format_name(entry, &record->fields[i], name, sizeof(name));
		json_object_object_add(values, name, field_value(entry, &record->fields[i]));
	}
	json_object_object_add(document, "values", values);
	node_topic(f, record->node_id, "values");
	return publish(f, to, document, false);
}

/* Names and units of the values. */
static long publish_objects(struct format *f, const struct publisher *to, const struct record *values)
{
	struct json_object *document = document_of(f, values->node_id, values->utc_us);
	struct json_object *objects = json_object_new_array();
	char text[128];

	for (size_t i = 0; i < values->field_count; i++) {
		const struct record_field *field = &values->fields[i];
		const struct od_entry *entry = format_entry(f, values->node_id, field);
		struct json_object *object = json_object_new_object();

		format_name(entry, field, text, sizeof(text));
		add_text(object, "name", text);
		cli_address_text(
			(uint16_t)(field->mapping >> 16), (uint8_t)(field->mapping >> 8), NULL, text, sizeof(text));
		add_text(object, "address", text);
		if (entry && entry->unit[0])
			add_text(object, "unit", entry->unit);
		if (entry && entry->description[0])
			add_text(object, "description", entry->description);
		json_object_array_add(objects, object);
	}
	json_object_object_add(document, "objects", objects);
	node_topic(f, values->node_id, "objects");
	return publish(f, to, document, true);
}

/* ---- state, EMCY, status ----------------------------------------------------------------------------------------- */

static long publish_state(struct format *f, const struct publisher *to, uint8_t node_id)
{
	const struct node_view *view = &f->nodes[node_id];
	struct json_object *document = document_of(f, node_id, view->state_utc_us);

	add_text(document, "nmt", watch_nmt_text(view->nmt_state));
	node_topic(f, node_id, "state");
	return publish(f, to, document, true);
}

static long publish_emcy(struct format *f, const struct publisher *to, uint8_t node_id)
{
	const struct node_view *view = &f->nodes[node_id];
	struct json_object *document = document_of(f, node_id, view->emcy_utc_us);
	uint16_t code = get_u16(view->emcy);
	char text[32];

	snprintf(text, sizeof(text), "%04X", code);
	add_text(document, "code", text);
	add_text(document, "text", emcy_code_text(code));
	json_object_object_add(document, "register", json_object_new_int(view->emcy[2]));
	snprintf(text, sizeof(text), "%02X%02X%02X%02X%02X", view->emcy[3], view->emcy[4], view->emcy[5], view->emcy[6],
		view->emcy[7]);
	add_text(document, "info", text);
	node_topic(f, node_id, "emcy");
	return publish(f, to, document, true);
}

static struct json_object *status_document(const struct format *f, bool online)
{
	struct json_object *document = json_object_new_object();

	add_text(document, "bus", f->config.bus);
	json_object_object_add(document, "online", json_object_new_boolean(online));
	return document;
}

static bool json_status(struct format *f, const struct publisher *to, const struct fleet_status *status, int64_t utc_us)
{
	struct json_object *document = status_document(f, true);
	struct json_object *dropped = json_object_new_object(), *spool = json_object_new_object();
	char text[FORMAT_UTC_TEXT];

	format_utc(utc_us, text);
	add_text(document, "utc", text);
	add_text(document, "version", IMU9_VERSION);
	add_count(document, "nodes", status->nodes);
	add_count(document, "samples", status->samples);
	add_count(document, "withheld", status->withheld);
	add_count(document, "misfits", status->misfits);
	add_count(document, "sent", status->sent);
	add_count(document, "delivered", status->delivered);
	add_count(document, "connections", status->connections);
	add_count(spool, "records", status->spooled);
	add_count(spool, "bytes", status->spool_bytes);
	add_count(spool, "damaged", status->spool_damaged);
	add_count(spool, "errors", status->spool_errors);
	json_object_object_add(document, "spool", spool);
	add_count(dropped, "frames", status->bus_dropped);
	add_count(dropped, "hand_over", status->hand_over_dropped);
	add_count(dropped, "commands", status->commands_dropped);
	add_count(dropped, "spool", status->spool_dropped);
	add_count(dropped, "disk", status->lost);
	json_object_object_add(document, "dropped", dropped);
	bus_topic(f, "status");
	return publish(f, to, document, true) >= 0;
}

/* Also what is published when the connection breaks. */
static void json_will(struct format *f, struct message *message)
{
	struct json_object *document = status_document(f, false);
	const char *text = json_object_to_json_string_ext(document, JSON_C_TO_STRING_PLAIN);

	snprintf((char *)f->payload, sizeof(f->payload), "%s", text);
	json_object_put(document);
	bus_topic(f, "status");
	*message = (struct message){
		.topic = f->topic, .payload = f->payload, .size = strlen((char *)f->payload), .qos = 1, .retain = true};
}

static void json_end(struct format *f, const struct publisher *to, int64_t utc_us)
{
	struct message message;

	(void)utc_us;
	json_will(f, &message);
	to->publish(to->ctx, &message);
}

/* ---- in order ---------------------------------------------------------------------------------------------------- */

/* A broker without persistence has lost what it retained. */
static bool json_begin(struct format *f, const struct publisher *to, int64_t utc_us)
{
	(void)utc_us;
	for (unsigned id = 1; id < FORMAT_NODES; id++) {
		const struct node_view *view = &f->nodes[id];

		if ((view->configured && publish_objects(f, to, &view->values) < 0) ||
			(view->has_state && publish_state(f, to, (uint8_t)id) < 0) ||
			(view->has_emcy && publish_emcy(f, to, (uint8_t)id) < 0))
			return false;
	}
	return true;
}

static long json_record(struct format *f, const struct publisher *to, const struct record *record, bool late)
{
	struct node_view *view = &f->nodes[record->node_id];
	struct json_object *answer;

	(void)late; /* its time stamp says when it was measured */
	switch (record->kind) {
	case RECORD_VALUES:
		if (format_learn(view, record) && publish_objects(f, to, &view->values) < 0)
			return -1;
		return publish_values(f, to, record);
	case RECORD_STATE:
		view->nmt_state = record->nmt_state;
		view->state_utc_us = record->utc_us;
		view->has_state = true;
		return publish_state(f, to, record->node_id);
	case RECORD_EMCY:
		memcpy(view->emcy, record->emcy, sizeof(view->emcy));
		view->emcy_utc_us = record->utc_us;
		view->has_emcy = true;
		return publish_emcy(f, to, record->node_id);
	case RECORD_CONFIGURED:
		view->configured = false;
		return 0;
	case RECORD_ANSWER:
		answer = json_parse_object(record->text, strlen(record->text), DEPTH);
		node_topic(f, record->node_id, "answer");
		return answer ? publish(f, to, answer, false) : 0;
	}
	return 0;
}

/* ---- commands ---------------------------------------------------------------------------------------------------- */

static size_t json_subscriptions(const struct format_config *config, bool writes, char topics[][FORMAT_TOPIC_MAX])
{
	if (!writes)
		return 0;
	snprintf(topics[0], FORMAT_TOPIC_MAX, "%s/%s/+/write", config->prefix, config->bus);
	return 1;
}

/* A text, number or boolean as text. False: another type, or too long. */
static bool member(struct json_object *document, const char *key, char *text, size_t size)
{
	struct json_object *value;

	if (!json_object_object_get_ex(document, key, &value))
		return false;
	bool scalar = json_object_is_type(value, json_type_string) || json_object_is_type(value, json_type_int) ||
		      json_object_is_type(value, json_type_double) || json_object_is_type(value, json_type_boolean);
	const char *written = scalar ? json_object_get_string(value) : NULL;
	if (!written || strlen(written) >= size)
		return false;
	memcpy(text, written, strlen(written) + 1);
	return true;
}

/* PREFIX/BUS/NODE/write {"object":"lever_arm.l","value":0.05,"id":"7"} */
static bool json_command(const struct format_config *config, const char *topic, const uint8_t *payload, size_t size,
	format_on_command *on_command, void *ctx)
{
	struct command command = {.kind = COMMAND_WRITE};
	char start[FORMAT_TOPIC_MAX], id[8];
	int length = snprintf(start, sizeof(start), "%s/%s/", config->prefix, config->bus);

	if (strncmp(topic, start, (size_t)length) != 0)
		return false;
	const char *slash = strchr(topic + length, '/');
	if (!slash || strcmp(slash, "/write") != 0 || slash - (topic + length) > 3)
		return false;
	snprintf(id, sizeof(id), "%.*s", (int)(slash - (topic + length)), topic + length);
	int node_id = format_node(id);
	struct json_object *document = json_parse_object((const char *)payload, size, DEPTH);
	bool good = document && node_id > 0 && member(document, "object", command.object, sizeof(command.object)) &&
		    member(document, "value", command.value, sizeof(command.value)) &&
		    (!json_object_object_get_ex(document, "id", NULL) ||
			    member(document, "id", command.id, sizeof(command.id)));
	json_object_put(document);
	if (!good)
		return false;
	command.node_id = (uint8_t)node_id;
	on_command(ctx, &command);
	return true;
}

const struct format_ops format_json = {.subscriptions = json_subscriptions,
	.command = json_command,
	.will = json_will,
	.begin = json_begin,
	.record = json_record,
	.status = json_status,
	.end = json_end};
