#include "tools/web/request.h"

#include <math.h>

#include "tools/lib/json_value.h"

static struct json_object *member(struct json_object *json, const char *key, enum json_type type)
{
	struct json_object *value = NULL;

	return json_object_object_get_ex(json, key, &value) && json_object_is_type(value, type) ? value : NULL;
}

/* Of all arrays and objects; WEB_REQUEST_DEPTH bounds the recursion. */
static size_t count_values(struct json_object *json)
{
	size_t n = 1;

	if (json_object_is_type(json, json_type_array))
		for (size_t i = 0; i < json_object_array_length(json); i++)
			n += count_values(json_object_array_get_idx(json, i));
	if (json_object_is_type(json, json_type_object)) {
		json_object_object_foreach(json, key, value)
		{
			(void)key;
			n += count_values(value);
		}
	}
	return n;
}

bool web_request_parse(struct web_request *request, const char *text, size_t size, const char **error)
{
	*request = (struct web_request){0};
	if (size > WEB_REQUEST_MAX) {
		*error = "the request is too long";
		return false;
	}
	request->json = json_parse_object(text, size, WEB_REQUEST_DEPTH);
	if (!request->json) {
		*error = "the request is not one JSON object";
		return false;
	}
	if (count_values(request->json) > WEB_REQUEST_VALUES) {
		*error = "the request has too many values";
		web_request_free(request);
		return false;
	}
	bool has_id = web_integer(request->json, "id", 0, INT64_C(1) << 53, &request->id);
	request->op = web_string(request->json, "op");
	if (has_id && request->op)
		return true;
	*error = has_id ? "the request has no \"op\"" : "the request has no whole number as \"id\"";
	web_request_free(request);
	return false;
}

void web_request_free(struct web_request *request)
{
	json_object_put(request->json);
	request->json = NULL;
	request->op = NULL;
}

const char *web_string(struct json_object *json, const char *key)
{
	struct json_object *value = member(json, key, json_type_string);

	return value ? json_object_get_string(value) : NULL;
}

bool web_integer(struct json_object *json, const char *key, int64_t low, int64_t high, int64_t *value)
{
	struct json_object *number = member(json, key, json_type_int);

	if (!number)
		return false;
	*value = json_object_get_int64(number);
	return *value >= low && *value <= high;
}

double web_number(struct json_object *json, const char *key, double low, double high, double fallback)
{
	struct json_object *value = NULL;

	if (!json_object_object_get_ex(json, key, &value) ||
		(!json_object_is_type(value, json_type_int) && !json_object_is_type(value, json_type_double)))
		return fallback;
	double number = json_object_get_double(value);
	return isfinite(number) ? fmin(fmax(number, low), high) : fallback;
}

struct json_object *web_array(struct json_object *json, const char *key)
{
	return member(json, key, json_type_array);
}
