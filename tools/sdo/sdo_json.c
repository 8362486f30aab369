#include "tools/sdo/sdo_json.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "tools/lib/cli_value.h"
#include "tools/lib/json_words.h"

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

static bool is_text(const struct od_entry *entry)
{
	return entry->type == OD_VISIBLE_STRING || entry->type == OD_OCTET_STRING || entry->type == OD_DOMAIN;
}

static bool is_real(const struct od_entry *entry)
{
	return entry->type == OD_REAL32 || entry->type == OD_REAL64;
}

/* The digits of the text, since 0.05 as REAL32 is 0.0500000007. */
static struct json_object *number(const char *text)
{
	double value = strtod(text, NULL);

	return isfinite(value) ? json_object_new_double_s(value, text) : NULL;
}

struct json_object *sdo_json_value(struct session *s, const struct target *target, const uint8_t *wire, size_t size)
{
	const struct od_entry *entry = target->entry;
	char text[CLI_VALUE_TEXT_MAX];

	if (!entry || (!is_text(entry) && size != entry->size) ||
		od_format(entry, wire, size, text, sizeof(text)) < 0) {
		cli_hex_text(wire, size, text, sizeof(text));
		return json_object_new_string(text);
	}
	if (is_text(entry))
		return json_object_new_string(text);
	if (entry->type == OD_BOOLEAN)
		return json_object_new_boolean(wire[0] != 0);
	double step = sdo_step(s, entry);
	if (step != 1)
		snprintf(text, sizeof(text), "%.9g", cli_number(entry, wire) * step);
	return number(text);
}

struct json_object *sdo_json_object(
	struct session *s, const struct target *target, const uint8_t *wire, size_t size, bool read)
{
	const struct od_entry *entry = target->entry;
	struct json_object *object = json_object_new_object();
	char text[128];

	if (entry)
		json_object_object_add(object, "name", json_object_new_string(entry->name));
	cli_address_text(target->index, target->sub, NULL, text, sizeof(text));
	json_object_object_add(object, "address", json_object_new_string(text));
	if (!read)
		return object;
	json_object_object_add(object, "value", sdo_json_value(s, target, wire, size));
	if (!entry || is_text(entry) || size != entry->size)
		return object;
	if (entry->unit[0])
		json_object_object_add(object, "unit", json_object_new_string(entry->unit));
	if (!is_real(entry) && sdo_step(s, entry) != 1 && od_format(entry, wire, size, text, sizeof(text)) > 0)
		json_object_object_add(object, "raw", number(text));
	if (od_has_words(entry))
		json_object_object_add(object, "words", json_words(entry, sdo_number(wire, size)));
	return object;
}

void sdo_json_add_error(struct json_object *to, const struct cli_node *node)
{
	char text[16];

	if (node->sdo.result != SDO_ABORTED) {
		json_object_object_add(to, "error", json_object_new_string("no answer"));
		return;
	}
	snprintf(text, sizeof(text), "%08Xh", node->sdo.abort_code);
	json_object_object_add(to, "error", json_object_new_string(sdo_abort_text(node->sdo.abort_code)));
	json_object_object_add(to, "abort", json_object_new_string(text));
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
