#include "tools/lib/json_value.h"

#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "od/little_endian.h"
#include "tools/lib/cli_value.h"
#include "tools/lib/json_words.h"

/* Not with JSON_TOKENER_STRICT, which refuses all that is not ASCII in json-c 0.18 (Debian 13). */
struct json_object *json_parse_object(const char *text, size_t size, int depth)
{
	struct json_tokener *tokener = json_tokener_new_ex(depth);
	struct json_object *json = NULL;

	if (tokener && size > 0 && size <= INT_MAX) {
		json_tokener_set_flags(tokener, JSON_TOKENER_VALIDATE_UTF8);
		json = json_tokener_parse_ex(tokener, text, (int)size);
	}
	if (json && (!json_object_is_type(json, json_type_object) || json_tokener_get_parse_end(tokener) != size)) {
		json_object_put(json);
		json = NULL;
	}
	if (tokener)
		json_tokener_free(tokener);
	return json;
}

static bool is_text(const struct od_entry *entry)
{
	return entry->type == OD_VISIBLE_STRING || entry->type == OD_OCTET_STRING || entry->type == OD_DOMAIN;
}

static bool is_real(const struct od_entry *entry)
{
	return entry->type == OD_REAL32 || entry->type == OD_REAL64;
}

struct json_object *json_number(const char *text)
{
	double value = strtod(text, NULL);

	return isfinite(value) ? json_object_new_double_s(value, text) : NULL;
}

struct json_object *json_value(const struct od_entry *entry, double step, const uint8_t *wire, size_t size)
{
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
	if (step != 1)
		snprintf(text, sizeof(text), "%.9g", cli_number(entry, wire) * step);
	return json_number(text);
}

void json_add_address(struct json_object *to, uint16_t index, uint8_t sub, const struct od_entry *entry)
{
	char text[16];

	if (entry)
		json_object_object_add(to, "name", json_object_new_string(entry->name));
	cli_address_text(index, sub, NULL, text, sizeof(text));
	json_object_object_add(to, "address", json_object_new_string(text));
}

void json_add_value(struct json_object *to, const struct od_entry *entry, double step, const uint8_t *wire, size_t size)
{
	char text[CLI_VALUE_TEXT_MAX];

	json_object_object_add(to, "value", json_value(entry, step, wire, size));
	if (!entry || is_text(entry) || size != entry->size)
		return;
	if (entry->unit[0])
		json_object_object_add(to, "unit", json_object_new_string(entry->unit));
	if (!is_real(entry) && step != 1 && od_format(entry, wire, size, text, sizeof(text)) > 0)
		json_object_object_add(to, "raw", json_number(text));
	if (od_has_words(entry))
		json_object_object_add(to, "words", json_words(entry, get_uint(wire, size)));
}

void json_add_failure(struct json_object *to, enum sdo_result result, uint32_t abort_code)
{
	char text[16];

	if (result != SDO_ABORTED) {
		json_object_object_add(to, "error", json_object_new_string("no answer"));
		return;
	}
	snprintf(text, sizeof(text), "%08Xh", abort_code);
	json_object_object_add(to, "error", json_object_new_string(sdo_abort_text(abort_code)));
	json_object_object_add(to, "abort", json_object_new_string(text));
}
