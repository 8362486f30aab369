/* tools/web/request.h
 * Requests of a browser: one JSON object, checked before anything of it is used, and its members. */
#ifndef TOOLS_WEB_REQUEST_H
#define TOOLS_WEB_REQUEST_H

#include <json-c/json.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum {
	WEB_REQUEST_MAX = 1 << 19, /* bytes: a DCF has 300 kB */
	WEB_REQUEST_DEPTH = 6,
	WEB_REQUEST_VALUES = 1024, /* in all its arrays and objects: each takes memory */
};

struct web_request {
	struct json_object *json; /* an object; owned, released by web_request_free() */
	int64_t id;
	const char *op; /* in `json` */
};

/** False: `error` says why; request->id is then 0 or, where it could be read, that of the request. */
bool web_request_parse(struct web_request *request, const char *text, size_t size, const char **error);
void web_request_free(struct web_request *request);

/** NULL: there is no such member, or it is no string. */
const char *web_string(struct json_object *json, const char *key);
/** False: there is no such member, or it is no whole number from low to high. */
bool web_integer(struct json_object *json, const char *key, int64_t low, int64_t high, int64_t *value);
/** The same for any number; `fallback` where there is none, clamped to low and high. */
double web_number(struct json_object *json, const char *key, double low, double high, double fallback);
/** An array, or NULL. */
struct json_object *web_array(struct json_object *json, const char *key);

#endif
