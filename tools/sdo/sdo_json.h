/* tools/sdo/sdo_json.h
 * Results of imu9-sdo as JSON (--json): one document for each command, and one line for each sample of watch. Members
 * of an object are described in tools/README.md, and by tests/interop/json_schema.py. */
#ifndef TOOLS_SDO_SDO_JSON_H
#define TOOLS_SDO_SDO_JSON_H

#include <json-c/json.h>

#include "tools/sdo/sdo_session.h"

/** {"node": 5, "bus": "can0"} */
struct json_object *sdo_json_new(const struct session *s);
/** Adds an array and returns it. */
struct json_object *sdo_json_array(struct json_object *to, const char *key);
/** {"name", "address", and for what was read: "value", "unit", "raw", "words"} */
struct json_object *sdo_json_object(
	struct session *s, const struct target *target, const uint8_t *wire, size_t size, bool read);
/** The physical value: a number, a text, or null for a number that JSON does not have. */
struct json_object *sdo_json_value(struct session *s, const struct target *target, const uint8_t *wire, size_t size);
/** Adds why the last transfer failed: "error", and "abort" if it was one. */
void sdo_json_add_error(struct json_object *to, const struct cli_node *node);
/** For dcf compare: {"name", "address", "unit", "node": its value, "file": the value in the file} */
void sdo_json_add_difference(struct json_object *differences, struct session *s, const struct target *target,
	const uint8_t *there, size_t there_size, const uint8_t *wanted, size_t wanted_size);
/** Adds the counts, prints it and frees it. */
void sdo_json_print_comparison(struct json_object *document, int same, int unreadable);
/** Prints it on standard output, on several lines or on one, and frees it. */
void sdo_json_print(struct json_object *document, bool one_line);

#endif
