/* Values: objects, read, write, and what writes one value. */
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "gateway/canopen/cia301.h"
#include "od_index.h"
#include "tools/lib/cli_value.h"
#include "tools/lib/json_value.h"
#include "tools/web/request.h"
#include "tools/web/web.h"

enum { STORE_MS = 5000 /* storing waits for the disk */ };

/* ---- names ------------------------------------------------------------------------------------------------------- */

size_t web_targets(const struct od_table *table, const char *text, struct web_target *targets, size_t capacity)
{
	const struct od_entry *entry = capacity > 0 ? od_find_name(table, text) : NULL;
	size_t length = strlen(text), n = 0;

	for (size_t i = 0; i < table->count && n < capacity; i++) {
		const struct od_entry *member = &table->entries[i];

		if (member->sub > 0 && strncasecmp(member->name, text, length) == 0 && member->name[length] == '.')
			targets[n++] = (struct web_target){text, member->index, member->sub, member, SIZE_MAX};
	}
	if (n > 0 || capacity == 0)
		return n;
	targets[0] = (struct web_target){.name = text, .entry = entry, .step = SIZE_MAX};
	if (entry) {
		targets[0].index = entry->index;
		targets[0].sub = entry->sub;
		return 1;
	}
	return cli_address(text, &targets[0].index, &targets[0].sub) ? 1 : 0;
}

static const struct web_step *find_read(const struct web_job *job, const struct od_entry *entry)
{
	for (size_t i = 0; i < job->count; i++)
		if (!job->steps[i].write && job->steps[i].entry == entry)
			return &job->steps[i];
	return NULL;
}

bool web_read_resolution(struct web_job *job, const struct od_entry *entry)
{
	const struct od_entry *resolution = entry ? od_resolution(job->node->eds->table, entry) : NULL;

	return !resolution || find_read(job, resolution) || web_read(job, resolution->index, resolution->sub);
}

double web_step_of(const struct web_job *job, const struct od_entry *entry)
{
	const struct od_entry *resolution = od_resolution(job->node->eds->table, entry);
	const struct web_step *read = resolution ? find_read(job, resolution) : NULL;

	if (!read || read->result != SDO_DONE || read->size != resolution->size)
		return entry->factor;
	return cli_number(resolution, web_bytes(read)) * resolution->factor;
}

static void add_object(struct json_object *to, uint16_t index, uint8_t sub, const struct od_entry *entry)
{
	char text[16];

	snprintf(text, sizeof(text), "%04Xh:%02X", index, sub);
	json_object_object_add(to, "name", json_object_new_string(entry ? entry->name : text));
	text[5] = '\0';
	json_object_object_add(to, "index", json_object_new_string(text));
	json_object_object_add(to, "sub", json_object_new_int(sub));
}

struct json_object *web_value_json(const struct web_job *job, const struct web_step *step)
{
	struct json_object *value = json_object_new_object();

	add_object(value, step->index, step->sub, step->entry);
	if (step->result == SDO_DONE)
		json_add_value(value, step->entry, step->entry ? web_step_of(job, step->entry) : 1, web_bytes(step),
			step->size);
	else
		json_add_failure(value, step->result, step->abort_code);
	return value;
}

/* ---- objects, events --------------------------------------------------------------------------------------------- */

bool web_op_objects(struct web *web, struct web_job *job, uint64_t now_us)
{
	struct web_node *node = job->node;

	(void)now_us;
	if (!node->objects) {
		struct json_object *objects = web_eds_objects(node->eds, node->id);

		node->objects = strdup(json_object_to_json_string_ext(
			objects, JSON_C_TO_STRING_PLAIN | JSON_C_TO_STRING_NOSLASHESCAPE));
		json_object_put(objects);
	}
	if (node->objects)
		web_answer_text(web, job, node->objects);
	else
		web_refuse(web, job, "out of memory");
	return false;
}

/* Lines of 2131h: seconds since the start, a blank, the text. */
static struct json_object *events_json(char *text)
{
	struct json_object *result = json_object_new_object(), *events = json_object_new_array();

	for (char *rest = NULL, *line = strtok_r(text, "\n", &rest); line; line = strtok_r(NULL, "\n", &rest)) {
		struct json_object *event = json_object_new_object();
		char *words = line;
		double t_s = strtod(line, &words);

		json_object_object_add(event, "time", isfinite(t_s) ? json_object_new_double(t_s) : NULL);
		json_object_object_add(event, "text", json_object_new_string(words + (*words == ' ')));
		json_object_array_add(events, event);
	}
	json_object_object_add(result, "events", events);
	return result;
}

bool web_op_events(struct web *web, struct web_job *job, uint64_t now_us)
{
	char text[OD_VALUE_MAX + 1];

	(void)now_us;
	if (job->stage == 0 && !od_find(job->node->eds->table, OD_INDEX_EVENT_LOG, 0, NULL)) {
		web_refuse(web, job, "node %u has no event log (2131h)", job->node->id);
		return false;
	}
	if (job->stage == 0)
		return web_read(job, OD_INDEX_EVENT_LOG, 0);
	struct web_step *log = &job->steps[0];
	if (log->result != SDO_DONE) {
		web_refuse_step(web, job, log);
		return false;
	}
	memcpy(text, log->wire, OD_VALUE_MAX);
	text[log->size < OD_VALUE_MAX ? log->size : OD_VALUE_MAX] = '\0';
	web_answer(web, job, events_json(log->large ? (char *)log->large : text));
	return false;
}

/* ---- read -------------------------------------------------------------------------------------------------------- */

struct reading {
	size_t count;
	struct web_target targets[WEB_OBJECTS];
};

/* False after an answer. */
static bool find_targets(struct web *web, struct web_job *job, struct reading *reading)
{
	struct json_object *objects = web_array(job->request, "objects");
	size_t n = objects ? json_object_array_length(objects) : 0;

	for (size_t i = 0; i < n; i++) {
		struct json_object *name = json_object_array_get_idx(objects, i);
		struct web_target *target = &reading->targets[reading->count];

		if (!json_object_is_type(name, json_type_string)) {
			n = 0;
			break;
		}
		if (reading->count == WEB_OBJECTS) {
			web_refuse(web, job, "more than %d objects at once", WEB_OBJECTS);
			return false;
		}
		size_t found = web_targets(
			job->node->eds->table, json_object_get_string(name), target, WEB_OBJECTS - reading->count);
		reading->count += found ? found : 1;
		if (!found)
			*target = (struct web_target){.name = json_object_get_string(name), .step = SIZE_MAX};
	}
	if (n == 0)
		web_refuse(web, job, "\"objects\" is an array of names");
	return n > 0;
}

static bool start_reading(struct web *web, struct web_job *job)
{
	struct reading *reading = job->data = calloc(1, sizeof(*reading));

	if (!reading) {
		web_refuse(web, job, "out of memory");
		return false;
	}
	if (!find_targets(web, job, reading))
		return false;
	for (size_t i = 0; i < reading->count; i++) {
		struct web_target *target = &reading->targets[i];

		if (target->index == 0 || (target->entry && target->entry->type == OD_DOMAIN))
			continue;
		target->step = job->count;
		if (!web_read(job, target->index, target->sub))
			target->step = SIZE_MAX;
	}
	for (size_t i = 0; i < reading->count; i++)
		web_read_resolution(job, reading->targets[i].entry);
	return true;
}

static struct json_object *no_value(const struct web_target *target)
{
	struct json_object *value = json_object_new_object();

	json_object_object_add(value, "name", json_object_new_string(target->name));
	json_object_object_add(value, "error",
		json_object_new_string(target->index ? "a DOMAIN is not a value" : "the EDS has no such object"));
	return value;
}

bool web_op_read(struct web *web, struct web_job *job, uint64_t now_us)
{
	(void)now_us;
	if (job->stage == 0)
		return start_reading(web, job);
	const struct reading *reading = job->data;
	struct json_object *result = json_object_new_object(), *values = json_object_new_array();
	for (size_t i = 0; i < reading->count; i++) {
		const struct web_target *target = &reading->targets[i];

		json_object_array_add(values,
			target->step == SIZE_MAX ? no_value(target) : web_value_json(job, &job->steps[target->step]));
	}
	json_object_object_add(result, "values", values);
	web_answer(web, job, result);
	return false;
}

/* ---- write ------------------------------------------------------------------------------------------------------- */

struct writing {
	struct web_target target;
	uint8_t wire[OD_VALUE_MAX];
	size_t size;
};

static bool is_whole(const struct od_entry *entry)
{
	return entry->type != OD_REAL32 && entry->type != OD_REAL64 && entry->type != OD_VISIBLE_STRING &&
	       entry->type != OD_OCTET_STRING;
}

/* Words of bits: "valid,rest", "none". False: not all are words. */
static bool join(struct json_object *words, char *text, size_t capacity)
{
	size_t used = 0;

	snprintf(text, capacity, "none");
	for (size_t i = 0; i < json_object_array_length(words); i++) {
		struct json_object *word = json_object_array_get_idx(words, i);

		if (!json_object_is_type(word, json_type_string))
			return false;
		used += (size_t)snprintf(
			text + used, capacity - used, "%s%s", i ? "," : "", json_object_get_string(word));
		if (used >= capacity)
			return false;
	}
	return true;
}

/* The text that od_parse() reads. `step`: the physical value of 1. */
static bool value_text(
	struct json_object *value, const struct od_entry *entry, double step, char *text, size_t capacity)
{
	switch (json_object_get_type(value)) {
	case json_type_string:
		return (size_t)snprintf(text, capacity, "%s", json_object_get_string(value)) < capacity;
	case json_type_boolean:
		return snprintf(text, capacity, "%d", json_object_get_boolean(value)) > 0;
	case json_type_array:
		return join(value, text, capacity);
	case json_type_int:
	case json_type_double:
		if (!is_whole(entry))
			snprintf(text, capacity, "%.17g", json_object_get_double(value) / step);
		else if (step == 1 && json_object_is_type(value, json_type_int))
			snprintf(text, capacity, "%s", json_object_get_string(value));
		else if (step == 1) /* a fraction is no value of an integer */
			snprintf(text, capacity, "%.17g", json_object_get_double(value));
		else
			snprintf(text, capacity, "%.0f", json_object_get_double(value) / step);
		return true;
	default:
		return false;
	}
}

/* False after an answer. */
static bool encode(struct web *web, struct web_job *job, struct writing *w)
{
	const struct od_entry *entry = w->target.entry;
	struct json_object *value = NULL;
	char text[CLI_VALUE_TEXT_MAX], limits[256] = "";
	enum od_status status = OD_BAD_VALUE;

	json_object_object_get_ex(job->request, "value", &value);
	if (!entry) {
		if (json_object_is_type(value, json_type_string))
			status = cli_typed_value(json_object_get_string(value), w->wire, sizeof(w->wire), &w->size);
		if (status != OD_OK)
			web_refuse(web, job, "%s is not in the EDS: give the value with its type, such as \"u16:5\"",
				w->target.name);
		return status == OD_OK;
	}
	if (value_text(value, entry, web_step_of(job, entry), text, sizeof(text)))
		status = od_parse(entry, text, w->wire, sizeof(w->wire), &w->size);
	if (status == OD_OK)
		status = od_check(entry, w->wire, w->size);
	if (status == OD_OK)
		return true;
	od_limits_text(entry, limits, sizeof(limits));
	if (od_has_words(entry))
		snprintf(limits, sizeof(limits), "%s", entry->words);
	web_refuse(web, job, "%s: %s%s%s", entry->name, od_status_text(status), limits[0] ? "; allowed: " : "", limits);
	return false;
}

/* What the server itself keeps of the node has changed. */
static void after_write(struct web_node *node, uint16_t index, uint64_t now_us)
{
	if (index == OD_INDEX_PRODUCER_HEARTBEAT_TIME)
		node->heartbeat_us = node->heartbeat_interval_us = 0;
	if (index < 0x2000 || index == OD_INDEX_RESOLUTION || index == OD_INDEX_ANGLE_RESOLUTION)
		web_node_mapping_changed(node, now_us);
}

static bool start_writing(struct web *web, struct web_job *job)
{
	struct writing *w = job->data = calloc(1, sizeof(*w));
	const char *name = web_string(job->request, "object");
	struct web_target members[2];
	size_t n = name ? web_targets(job->node->eds->table, name, members, 2) : 0;

	if (!w || n != 1) {
		web_refuse(web, job, "%s",
			!w	 ? "out of memory"
			: n == 0 ? "\"object\" is no name of the EDS and no index"
				 : "a record: write its members one by one");
		return false;
	}
	w->target = members[0];
	if (w->target.entry && w->target.entry->type == OD_DOMAIN) {
		web_refuse(web, job, "a DOMAIN is not a value");
		return false;
	}
	return web_read_resolution(job, w->target.entry);
}

static bool read_back(struct web *web, struct web_job *job, uint64_t now_us)
{
	const struct writing *w = job->data;
	struct json_object *result;

	if (job->steps[job->count - 1].result != SDO_DONE) {
		web_refuse_step(web, job, &job->steps[job->count - 1]);
		return false;
	}
	after_write(job->node, w->target.index, now_us);
	if (!w->target.entry || (w->target.entry->access & OD_READ))
		return web_read(job, w->target.index, w->target.sub);
	result = json_object_new_object();
	json_object_object_add(result, "values", json_object_new_array());
	web_answer(web, job, result);
	return false;
}

bool web_op_write(struct web *web, struct web_job *job, uint64_t now_us)
{
	struct writing *w = job->data;
	struct json_object *result, *values;

	switch (job->stage) {
	case 0:
		return start_writing(web, job);
	case 1:
		if (job->count > 0 &&
			job->steps[0].result != SDO_DONE) { /* in another scale it would be another value */
			web_refuse_step(web, job, &job->steps[0]);
			return false;
		}
		return encode(web, job, w) && web_write(job, w->target.index, w->target.sub, w->wire, w->size);
	case 2:
		return read_back(web, job, now_us);
	default:
		result = json_object_new_object();
		values = json_object_new_array();
		json_object_array_add(values, web_value_json(job, &job->steps[job->count - 1]));
		json_object_object_add(result, "values", values);
		web_answer(web, job, result);
		return false;
	}
}

/* ---- store, restore, record -------------------------------------------------------------------------------------- */

/* A single write, answered by {}. */
static bool write_one(struct web *web, struct web_job *job, uint16_t index, uint8_t sub, const void *wire, size_t size)
{
	if (job->stage == 0)
		return web_write(job, index, sub, wire, size);
	if (job->steps[0].result == SDO_DONE)
		web_answer(web, job, json_object_new_object());
	else
		web_refuse_step(web, job, &job->steps[0]);
	return false;
}

static bool write_signature(struct web *web, struct web_job *job, uint16_t index, const char *signature)
{
	static const char *const groups[] = {"all", "communication", "application", "manufacturer"};
	const char *group = web_string(job->request, "group");
	uint8_t sub = 0;

	for (uint8_t i = 0; group && i < 4; i++)
		if (strcmp(groups[i], group) == 0)
			sub = (uint8_t)(i + 1);
	if (sub == 0) {
		web_refuse(web, job, "\"group\" is all, communication, application or manufacturer");
		return false;
	}
	job->timeout_ms = STORE_MS;
	return write_one(web, job, index, sub, signature, 4);
}

bool web_op_store(struct web *web, struct web_job *job, uint64_t now_us)
{
	(void)now_us;
	return write_signature(web, job, OD_INDEX_STORE_PARAMETERS, "save");
}

bool web_op_restore(struct web *web, struct web_job *job, uint64_t now_us)
{
	(void)now_us;
	return write_signature(web, job, OD_INDEX_RESTORE_DEFAULTS, "load");
}

bool web_op_record(struct web *web, struct web_job *job, uint64_t now_us)
{
	const struct od_entry *entry = od_find_name(job->node->eds->table, "recording.command");
	struct json_object *on = NULL;
	uint8_t command;

	(void)now_us;
	json_object_object_get_ex(job->request, "on", &on);
	if (!entry || !json_object_is_type(on, json_type_boolean)) {
		web_refuse(web, job, "%s", entry ? "\"on\" is true or false" : "this node has no recording (215Ch)");
		return false;
	}
	command = (uint8_t)json_object_get_boolean(on); /* 0 stop, 1 start */
	return write_one(web, job, entry->index, entry->sub, &command, 1);
}
