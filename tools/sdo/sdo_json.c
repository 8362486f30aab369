#include "tools/sdo/sdo_json.h"

#include <stdio.h>

#include "tools/lib/json_value.h"

struct json_object *sdo_json_new(const struct session *s)
{
	struct json_object *document = json_object_new_object();

	json_object_object_add(document, "node", json_object_new_int64(s->node_id));
	json_object_object_add(document, "bus", json_object_new_string(s->bus));
	return document;
}

struct json_object *sdo_json_array(struct json_object *to, const char *key)
{
	struct json_object *array = json_object_new_array();

	json_object_object_add(to, key, array);
	return array;
}

struct json_object *sdo_json_value(struct session *s, const struct target *target, const uint8_t *wire, size_t size)
{
	return json_value(target->entry, target->entry ? sdo_step(s, target->entry) : 1, wire, size);
}

struct json_object *sdo_json_object(
	struct session *s, const struct target *target, const uint8_t *wire, size_t size, bool read)
{
	const struct od_entry *entry = target->entry;
	struct json_object *object = json_object_new_object();

	json_add_address(object, target->index, target->sub, entry);
	if (read)
		json_add_value(object, entry, entry ? sdo_step(s, entry) : 1, wire, size);
	return object;
}

void sdo_json_add_error(struct json_object *to, const struct cli_node *node)
{
	json_add_failure(to, node->sdo.result, node->sdo.abort_code);
}

void sdo_json_add_difference(struct json_object *differences, struct session *s, const struct target *target,
	const uint8_t *there, size_t there_size, const uint8_t *wanted, size_t wanted_size)
{
	struct json_object *object = sdo_json_object(s, target, NULL, 0, false);

	if (target->entry && target->entry->unit[0])
		json_object_object_add(object, "unit", json_object_new_string(target->entry->unit));
	json_object_object_add(object, "node", sdo_json_value(s, target, there, there_size));
	json_object_object_add(object, "file", sdo_json_value(s, target, wanted, wanted_size));
	json_object_array_add(differences, object);
}

void sdo_json_print_comparison(struct json_object *document, int same, int unreadable)
{
	json_object_object_add(document, "same", json_object_new_int(same));
	json_object_object_add(document, "unreadable", json_object_new_int(unreadable));
	sdo_json_print(document, false);
}

void sdo_json_print(struct json_object *document, bool one_line)
{
	int flags = JSON_C_TO_STRING_NOSLASHESCAPE |
		    (one_line ? JSON_C_TO_STRING_SPACED : JSON_C_TO_STRING_SPACED | JSON_C_TO_STRING_PRETTY);

	puts(json_object_to_json_string_ext(document, flags));
	json_object_put(document);
}
