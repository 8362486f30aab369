/* tools/lib/json_value.h
 * Values of objects as JSON, described by tools/imu9-json.schema.json. The caller owns what is returned. */
#ifndef TOOLS_LIB_JSON_VALUE_H
#define TOOLS_LIB_JSON_VALUE_H

#include <json-c/json.h>

#include "gateway/canopen/client/sdo_client.h"
#include "od/od.h"

/** One whole JSON object in UTF-8, of at most `depth` levels; NULL: the text is something else. */
struct json_object *json_parse_object(const char *text, size_t size, int depth);
/** The digits of the text, since 0.05 as REAL32 is 0.0500000007; NULL for a number that JSON does not have. */
struct json_object *json_number(const char *text);
/** The physical value of a value in wire form: a number, true, false, a text, or NULL for a number that JSON does not
 * have; bytes in hex when there is no entry (NULL) or the size does not match. `step` is the physical value of 1. */
struct json_object *json_value(const struct od_entry *entry, double step, const uint8_t *wire, size_t size);
/** Adds "name" (of an entry, or NULL) and "address". */
void json_add_address(struct json_object *to, uint16_t index, uint8_t sub, const struct od_entry *entry);
/** Adds "value", and "unit", "raw" and "words" where it has them. */
void json_add_value(
	struct json_object *to, const struct od_entry *entry, double step, const uint8_t *wire, size_t size);
/** Adds why a transfer failed: "error", and "abort" if it was aborted. */
void json_add_failure(struct json_object *to, enum sdo_result result, uint32_t abort_code);

#endif
