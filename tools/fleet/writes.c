#include "tools/fleet/writes.h"

#include <json-c/json.h>
#include <stdio.h>
#include <string.h>

#include "gateway/canopen/sdo_abort.h"
#include "tools/lib/cli_value.h"

/* ---- answers ----------------------------------------------------------------------------------------------------- */

static void answer(const struct writes *w, struct fleet *fleet, const struct command *command, const char *error,
	uint32_t abort_code, int64_t utc_us)
{
	struct record record = {.kind = RECORD_ANSWER, .node_id = command->node_id, .utc_us = utc_us};
	struct json_object *document = json_object_new_object();
	char text[FORMAT_UTC_TEXT];

	format_utc(utc_us, text);
	json_object_object_add(document, "node", json_object_new_int(command->node_id));
	json_object_object_add(document, "bus", json_object_new_string(w->bus));
	json_object_object_add(document, "utc", json_object_new_string(text));
	json_object_object_add(document, "object", json_object_new_string(command->object));
	if (command->id[0])
		json_object_object_add(document, "id", json_object_new_string(command->id));
	json_object_object_add(document, "done", json_object_new_boolean(!error));
	if (error)
		json_object_object_add(document, "error", json_object_new_string(error));
	if (abort_code) {
		snprintf(text, sizeof(text), "%08Xh", abort_code);
		json_object_object_add(document, "abort", json_object_new_string(text));
	}
	const char *json = json_object_to_json_string_ext(document, JSON_C_TO_STRING_PLAIN);
	if (strlen(json) < sizeof(record.text)) {
		memcpy(record.text, json, strlen(json) + 1);
		fleet->sink->record(fleet->sink->ctx, &record);
	}
	json_object_put(document);
}

/* ---- a write ----------------------------------------------------------------------------------------------------- */

static bool is_allowed(const struct writes *w, const struct od_entry *entry)
{
	for (size_t i = 0; i < w->allowed_count; i++)
		if (w->allowed[i].index == entry->index && (w->allowed[i].sub < 0 || w->allowed[i].sub == entry->sub))
			return true;
	return false;
}

static const char *reason_of(enum od_status status, const struct od_entry *entry, char *text, size_t size)
{
	char limits[128];

	od_limits_text(entry, limits, sizeof(limits));
	snprintf(text, size, "%s%s%s", od_status_text(status), limits[0] ? "; allowed: " : "", limits);
	return text;
}

/* NULL: the node is asked; else why not. */
static const char *submit(
	struct writes *w, struct fleet_node *node, const struct command *command, char *text, size_t text_size)
{
	uint8_t wire[OD_VALUE_MAX];
	size_t size;

	if (!node)
		return "no such node was heard";
	struct writes_node *own = &w->nodes[node->id];
	const struct od_entry *entry = od_find_name(node->watch.mirror.table, command->object);
	if (!entry)
		return "no such object in the EDS";
	if (!is_allowed(w, entry))
		return "not allowed here: --allow-writes";
	if (!(entry->access & OD_WRITE) || entry->type == OD_DOMAIN)
		return "the object is read-only, or no single value";
	enum od_status status = od_parse(entry, command->value, wire, sizeof(wire), &size);
	if (status == OD_OK)
		status = od_check(entry, wire, size);
	if (status != OD_OK)
		return reason_of(status, entry, text, text_size);
	if (own->count == WATCH_COMMANDS ||
		!watch_write(&node->watch, entry->name, entry->index, entry->sub, wire, size))
		return node->watch.passive ? "not with --passive" : "too many writes at once";
	own->waiting[own->count++] = *command;
	w->waiting_count++;
	node->due_us = 0;
	return NULL;
}

void writes_submit(
	struct writes *w, struct fleet *fleet, const struct command *command, uint64_t now_us, int64_t utc_offset_us)
{
	char text[256];
	const char *why = submit(w, fleet_node(fleet, command->node_id), command, text, sizeof(text));

	if (why)
		answer(w, fleet, command, why, 0, (int64_t)now_us + utc_offset_us);
}

void writes_poll(struct writes *w, struct fleet *fleet, uint64_t now_us, int64_t utc_offset_us)
{
	for (size_t i = 0; w->waiting_count > 0 && i < fleet->node_count; i++) {
		const struct watch *watch = &fleet->nodes[fleet->known[i]]->watch;
		struct writes_node *own = &w->nodes[fleet->known[i]];

		if (own->count == 0 || own->done == watch->commands_done)
			continue;
		bool done = watch->command_result == SDO_DONE, aborted = watch->command_result == SDO_ABORTED;

		own->done++; /* at most one transfer ends by a frame */
		answer(w, fleet, &own->waiting[0],
			done	  ? NULL
			: aborted ? sdo_abort_text(watch->command_abort)
				  : "no answer from the node",
			aborted ? watch->command_abort : 0, (int64_t)now_us + utc_offset_us);
		own->count--;
		w->waiting_count--;
		memmove(own->waiting, own->waiting + 1, own->count * sizeof(own->waiting[0]));
	}
}
