#include "gateway/config.h"

#include <errno.h>
#include <ini.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <syslog.h>

void config_init(struct config *config, const struct od_table *table)
{
	*config = (struct config){.imu = "sim", .can = "vcan0", .node_id = 1, .log_level = LOG_INFO, .table = table};
}

/* ---- keys of the process ----------------------------------------------------------------------------------------- */

enum kind { TEXT, LIST, NUMBER, NODE_ID, LOG_LEVEL };

static const struct key {
	const char *name;
	size_t at; /* in struct config */
	enum kind kind;
	unsigned low, high; /* of a NUMBER */
} KEYS[] = {
	{"imu", offsetof(struct config, imu), .kind = TEXT},
	{"can", offsetof(struct config, can), .kind = TEXT},
	{"node_id", offsetof(struct config, node_id), .kind = NODE_ID},
	{"bitrate", offsetof(struct config, bitrate), NUMBER, 10000, 1000000},
	{"store", offsetof(struct config, store), .kind = TEXT},
	{"record", offsetof(struct config, record), .kind = TEXT},
	{"realtime", offsetof(struct config, realtime), NUMBER, 0, 99},
	{"serial", offsetof(struct config, serial), NUMBER, 0, UINT32_MAX},
	{"vendor_id", offsetof(struct config, vendor_id), NUMBER, 0, UINT32_MAX},
	{"run_led", offsetof(struct config, run_led), .kind = TEXT},
	{"error_led", offsetof(struct config, error_led), .kind = TEXT},
	{"log_level", offsetof(struct config, log_level), .kind = LOG_LEVEL},
	{"cia309", offsetof(struct config, cia309), .kind = LIST},
	{"modbus", offsetof(struct config, modbus), .kind = LIST},
};
enum { KEY_COUNT = sizeof(KEYS) / sizeof(KEYS[0]) };

static const char *const SEVERITIES[] = {
	[LOG_ERR] = "error", [LOG_WARNING] = "warning", [LOG_INFO] = "info", [LOG_DEBUG] = "debug"};

static int set_text(char *out, const char *key, const char *value, char *error)
{
	if (value[0] == '\0' || strlen(value) >= CONFIG_TEXT_MAX) {
		snprintf(error, CONFIG_ERROR_MAX, "%s: needs a value of 1 to %d characters", key, CONFIG_TEXT_MAX - 1);
		return -EINVAL;
	}
	strcpy(out, value);
	return 0;
}

/* A key that is given several times: a line for each. */
static int add_text(char *out, const char *key, const char *value, char *error)
{
	char line[CONFIG_TEXT_MAX];
	size_t used = strlen(out);
	int rc = set_text(line, key, value, error);

	if (rc == 0 && used + strlen(line) + 2 > CONFIG_LIST_MAX) {
		snprintf(error, CONFIG_ERROR_MAX, "%s: given too often", key);
		rc = -E2BIG;
	}
	if (rc == 0)
		snprintf(out + used, CONFIG_LIST_MAX - used, "%s\n", line);
	return rc;
}

static int set_number(unsigned *out, const char *key, const char *value, unsigned low, unsigned high, char *error)
{
	char *end;

	errno = 0;
	unsigned long n = strtoul(value, &end, 0);
	if (end == value || *end != '\0' || value[0] == '-' || errno != 0 || n < low || n > high) {
		snprintf(error, CONFIG_ERROR_MAX, "%s: '%s' is not a number from %u to %u", key, value, low, high);
		return -EINVAL;
	}
	*out = (unsigned)n;
	return 0;
}

/* 255: unconfigured, LSS assigns one. */
static int set_node_id(unsigned *out, const char *key, const char *value, char *error)
{
	unsigned node_id;
	int rc = set_number(&node_id, key, value, 1, 255, error);

	if (rc == 0 && node_id > 127 && node_id != 255)
		rc = -EINVAL;
	if (rc < 0)
		snprintf(error, CONFIG_ERROR_MAX,
			"%s: '%.100s' is neither a number from 1 to 127 nor 255 (LSS assigns one)", key, value);
	else
		*out = node_id;
	return rc;
}

static int set_log_level(unsigned *out, const char *key, const char *value, char *error)
{
	for (unsigned i = 0; i < sizeof(SEVERITIES) / sizeof(SEVERITIES[0]); i++)
		if (SEVERITIES[i] && strcmp(SEVERITIES[i], value) == 0) {
			*out = i;
			return 0;
		}
	snprintf(error, CONFIG_ERROR_MAX, "%s: '%.100s' is none of error, warning, info and debug", key, value);
	return -EINVAL;
}

static int set_key(struct config *c, const struct key *key, const char *value, char *error)
{
	void *at = (char *)c + key->at;

	switch (key->kind) {
	case TEXT:
		return set_text(at, key->name, value, error);
	case LIST:
		return add_text(at, key->name, value, error);
	case NUMBER:
		return set_number(at, key->name, value, key->low, key->high, error);
	case NODE_ID:
		return set_node_id(at, key->name, value, error);
	case LOG_LEVEL:
		return set_log_level(at, key->name, value, error);
	}
	return -EINVAL;
}

int config_option(struct config *c, const char *name, const char *value, char *error)
{
	int used = snprintf(error, CONFIG_ERROR_MAX, "unknown key '%.100s' in [gateway]; the keys are", name);

	for (size_t i = 0; i < KEY_COUNT; i++) {
		if (strcmp(name, KEYS[i].name) == 0)
			return set_key(c, &KEYS[i], value, error);
		used += snprintf(error + used, CONFIG_ERROR_MAX - (size_t)used, "%s %s", i ? "," : "", KEYS[i].name);
	}
	return -ENOENT;
}

const char *config_changed(const struct config *before, const struct config *after, size_t *from)
{
	while (*from < KEY_COUNT) {
		const struct key *key = &KEYS[(*from)++];
		const char *a = (const char *)before + key->at, *b = (const char *)after + key->at;

		if (key->kind == TEXT || key->kind == LIST ? strcmp(a, b) != 0 : memcmp(a, b, sizeof(unsigned)) != 0)
			return key->name;
	}
	return NULL;
}

/* ---- objects ----------------------------------------------------------------------------------------------------- */

static int refuse(char *error, const struct od_entry *e, const char *value, enum od_status status)
{
	char limits[80];

	od_limits_text(e, limits, sizeof(limits));
	snprintf(error, CONFIG_ERROR_MAX, "%s = %.100s: %s%s%s%s", e->name, value, od_status_text(status),
		limits[0] ? " (" : "", limits, limits[0] ? ")" : "");
	return -EINVAL;
}

static int set_object(struct config *c, const char *name, const char *value, char *error)
{
	const struct od_entry *e = od_find_name(c->table, name);
	size_t size = 0;

	if (!e) {
		snprintf(error, CONFIG_ERROR_MAX,
			"no object has the name '%s'; `imu9-sdo dump` and objects.md list the names", name);
		return -ENOENT;
	}
	if (!(e->access & OD_STORED)) {
		snprintf(error, CONFIG_ERROR_MAX, "%s is not a configuration object and cannot be set here", e->name);
		return -EACCES;
	}
	if (c->object_count == CONFIG_OBJECTS_MAX) {
		snprintf(error, CONFIG_ERROR_MAX, "more than %d objects set", CONFIG_OBJECTS_MAX);
		return -E2BIG;
	}
	struct config_object *o = &c->objects[c->object_count];
	enum od_status status = od_parse(e, value, o->wire, sizeof(o->wire), &size);
	if (status == OD_OK)
		status = od_check(e, o->wire, size);
	if (status != OD_OK)
		return refuse(error, e, value, status);
	o->index = e->index;
	o->sub = e->sub;
	o->size = (uint8_t)size;
	c->object_count++;
	return 0;
}

int config_set(struct config *config, const char *assignment, char *error)
{
	char name[CONFIG_TEXT_MAX];
	const char *equals = strchr(assignment, '=');

	if (!equals || equals == assignment || (size_t)(equals - assignment) >= sizeof(name)) {
		snprintf(error, CONFIG_ERROR_MAX, "--set %s: write NAME=VALUE, for example lever_arm.l=0.05",
			assignment);
		return -EINVAL;
	}
	snprintf(name, sizeof(name), "%.*s", (int)(equals - assignment), assignment);
	return set_object(config, name, equals + 1, error);
}

void config_apply(const struct config *config, struct od *od)
{
	for (size_t i = 0; i < config->object_count; i++) {
		const struct config_object *o = &config->objects[i];

		/* cannot fail: od_check() has accepted it */
		od_put(od, od_find(config->table, o->index, o->sub, NULL), o->wire, o->size);
	}
}

/* ---- the file ---------------------------------------------------------------------------------------------------- */

struct reading {
	struct config *config;
	FILE *file;
	const char *path;
	char *error;
	int line;
	int rc;
};

/* Reads for inih and counts the lines for error messages. */
static char *next_line(char *text, int size, void *stream)
{
	struct reading *r = stream;

	if (r->rc < 0 || !fgets(text, size, r->file))
		return NULL;
	r->line++;
	if (!strchr(text, '\n') && !feof(r->file)) {
		snprintf(r->error, CONFIG_ERROR_MAX, "%s:%d: the line is longer than %d characters", r->path, r->line,
			size - 2);
		r->rc = -EINVAL;
		return NULL;
	}
	return text;
}

static int on_key(void *user, const char *section, const char *key, const char *value)
{
	struct reading *r = user;
	char name[CONFIG_TEXT_MAX], why[CONFIG_ERROR_MAX];

	if (r->rc < 0)
		return 0;
	if (strcasecmp(section, "gateway") == 0) {
		r->rc = config_option(r->config, key, value, why);
	} else {
		snprintf(name, sizeof(name), "%s%s%s", section, section[0] ? "." : "", key);
		r->rc = set_object(r->config, name, value, why);
	}
	if (r->rc < 0)
		snprintf(r->error, CONFIG_ERROR_MAX, "%s:%d: %.300s", r->path, r->line, why);
	return r->rc == 0;
}

int config_file(struct config *config, const char *path, char *error)
{
	struct reading r = {.config = config, .path = path, .error = error, .file = fopen(path, "re")};

	if (!r.file) {
		int rc = -errno;

		snprintf(error, CONFIG_ERROR_MAX, "%s: %s", path, strerror(errno));
		return rc;
	}
	int line = ini_parse_stream(next_line, &r, on_key, &r);
	if (r.rc == 0 && ferror(r.file)) {
		snprintf(error, CONFIG_ERROR_MAX, "%s: cannot be read", path);
		r.rc = -EIO;
	} else if (r.rc == 0 && line != 0) {
		snprintf(error, CONFIG_ERROR_MAX, "%s:%d: neither a [section] nor NAME = VALUE", path, line);
		r.rc = -EINVAL;
	}
	fclose(r.file);
	return r.rc;
}
