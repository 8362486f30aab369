#include "tools/fleet/options.h"

#include <errno.h>
#include <ini.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "od_values.h"
#include "tools/lib/cli.h"

enum { MQTT_PORT = 1883, MQTTS_PORT = 8883, SPOOL_MB = 64, KEEPALIVE_S = 15, BYTES_A_MB = 1 << 20 };
static const double AT_LEAST_S = 60, LATE_HZ = 1000;

__attribute__((format(printf, 3, 4))) static int refuse(char *why, int error, const char *format, ...)
{
	va_list args;

	va_start(args, format);
	vsnprintf(why, OPTIONS_ERROR_MAX, format, args);
	va_end(args);
	return error;
}

void options_init(struct options *o)
{
	*o = (struct options){.fleet = {.at_least_s = AT_LEAST_S}, .sender = {.late_hz = LATE_HZ}};
	snprintf(o->bus, sizeof(o->bus), "%s", cli_default_bus());
	snprintf(o->topic, sizeof(o->topic), "imu9");
	o->sender.broker.keepalive_s = KEEPALIVE_S;
	o->sender.ops = &format_json;
}

void options_free(struct options *o)
{
	for (size_t i = 0; i < o->eds_count; i++)
		eds_free(&o->eds[i]);
	o->eds_count = 0;
}

/* ---- keys -------------------------------------------------------------------------------------------------------- */

static int set_text(char *to, size_t size, const char *key, const char *value, char *why)
{
	if (strlen(value) >= size)
		return refuse(why, -EINVAL, "%s: longer than %zu characters", key, size - 1);
	memcpy(to, value, strlen(value) + 1);
	return 0;
}

static int set_real(double *to, const char *key, const char *value, double low, double high, char *why)
{
	if (!cli_real(value, low, high, to))
		return refuse(why, -EINVAL, "%s %s: not a number from %g to %g", key, value, low, high);
	return 0;
}

static int add_text(char list[][OPTIONS_TEXT_MAX], size_t *count, const char *key, const char *value, char *why)
{
	if (*count == OPTIONS_LIST_MAX)
		return refuse(why, -EINVAL, "%s: at most %d of them", key, OPTIONS_LIST_MAX);
	int result = set_text(list[*count], OPTIONS_TEXT_MAX, key, value, why);
	*count += result == 0;
	return result;
}

static int set_yes(bool *to, const char *key, const char *value, char *why)
{
	bool yes = strcmp(value, "yes") == 0;

	if (!yes && strcmp(value, "no") != 0)
		return refuse(why, -EINVAL, "%s %s: yes or no", key, value);
	*to = yes;
	return 0;
}

static int set_format(struct options *o, const char *value, char *why)
{
	bool sparkplug = strcmp(value, "sparkplug") == 0;

	if (!sparkplug && strcmp(value, "json") != 0)
		return refuse(why, -EINVAL, "format %s: json or sparkplug", value);
	o->sender.ops = sparkplug ? &format_sparkplug : &format_json;
	return 0;
}

int options_set(struct options *o, const char *option, const char *value, char *why)
{
	struct broker_config *broker = &o->sender.broker;
	const struct {
		const char *key;
		char *text;
		size_t size;
	} texts[] = {{"can", o->bus, sizeof(o->bus)}, {"node_id", o->nodes, sizeof(o->nodes)},
		{"broker", o->broker, sizeof(o->broker)}, {"topic", o->topic, sizeof(o->topic)},
		{"name", o->name, sizeof(o->name)}, {"spool", o->spool, sizeof(o->spool)},
		{"client_id", broker->client_id, sizeof(broker->client_id)},
		{"credentials", o->credentials, sizeof(o->credentials)}, {"ca", broker->ca, sizeof(broker->ca)},
		{"cert", broker->cert, sizeof(broker->cert)}, {"key", broker->key, sizeof(broker->key)}};
	char key[32];

	snprintf(key, sizeof(key), "%s", option);
	for (char *dash = key; (dash = strchr(dash, '-')) != NULL;)
		*dash = '_';
	for (size_t i = 0; i < sizeof(texts) / sizeof(texts[0]); i++)
		if (strcmp(key, texts[i].key) == 0)
			return set_text(texts[i].text, texts[i].size, option, value, why);
	if (strcmp(key, "eds") == 0)
		return add_text(o->eds_names, &o->eds_count, option, value, why);
	if (strcmp(key, "change") == 0)
		return add_text(o->change, &o->change_count, option, value, why);
	if (strcmp(key, "allow_writes") == 0)
		return add_text(o->allow, &o->allow_count, option, value, why);
	if (strcmp(key, "hz") == 0)
		return set_real(&o->fleet.hz, option, value, 0, 10000, why);
	if (strcmp(key, "at_least") == 0)
		return set_real(&o->fleet.at_least_s, option, value, 0.1, 86400, why);
	if (strcmp(key, "late_rate") == 0)
		return set_real(&o->sender.late_hz, option, value, 1, 1e6, why);
	if (strcmp(key, "format") == 0)
		return set_format(o, value, why);
	if (strcmp(key, "passive") == 0)
		return set_yes(&o->fleet.passive, option, value, why);
	return refuse(why, -ENOENT, "%s: no such option", option);
}

struct ini_context {
	struct options *options;
	const char *path;
	char *why;
	int result;
};

static int on_item(void *user, const char *section, const char *key, const char *value)
{
	struct ini_context *context = user;
	char why[OPTIONS_ERROR_MAX];

	if (context->result < 0)
		return 1;
	if (strcmp(section, "fleet") != 0)
		context->result = refuse(
			context->why, -EINVAL, "%s: [%s] %s: only [fleet] has keys here", context->path, section, key);
	else if (options_set(context->options, key, value, why) < 0)
		context->result = refuse(context->why, -EINVAL, "%s: %.400s", context->path, why);
	return context->result == 0;
}

int options_file(struct options *o, const char *path, char *why)
{
	struct ini_context context = {.options = o, .path = path, .why = why};
	FILE *file = fopen(path, "re");

	if (!file)
		return refuse(why, -errno, "%s: %s", path, strerror(errno));
	int line = ini_parse_file(file, on_item, &context);
	fclose(file);
	if (context.result < 0)
		return context.result;
	if (line != 0)
		return refuse(why, -EINVAL, "%s:%d: not a line 'key = value'", path, line);
	return 0;
}

/* ---- what they mean ---------------------------------------------------------------------------------------------- */

/* mqtt(s)://HOST[:PORT], of IPv6 [HOST] */
static int parse_broker(struct options *o, char *why)
{
	struct broker_config *broker = &o->sender.broker;
	const char *rest = o->broker, *end;
	long port;

	if (rest[0] == '\0')
		return refuse(why, -EINVAL, "no broker: --broker mqtts://HOST[:PORT]");
	broker->tls = strncmp(rest, "mqtts://", 8) == 0;
	if (!broker->tls && strncmp(rest, "mqtt://", 7) != 0)
		return refuse(why, -EINVAL, "broker %s: write mqtt://HOST[:PORT] or mqtts://HOST[:PORT]", rest);
	rest += broker->tls ? 8 : 7;
	bool v6 = rest[0] == '[';
	rest += v6;
	end = rest + strcspn(rest, v6 ? "]" : ":/");
	snprintf(broker->host, sizeof(broker->host), "%.*s", (int)(end - rest), rest);
	end += v6 && *end == ']';
	port = broker->tls ? MQTTS_PORT : MQTT_PORT;
	if (broker->host[0] == '\0' || (*end == ':' && !cli_integer(end + 1, 1, 65535, &port)) ||
		(*end != ':' && *end != '\0'))
		return refuse(why, -EINVAL, "broker %s: write mqtt://HOST[:PORT] or mqtts://HOST[:PORT]", o->broker);
	broker->port = (int)port;
	if (!broker->tls && (broker->ca[0] || broker->cert[0] || broker->key[0]))
		return refuse(why, -EINVAL, "ca, cert and key are for a broker mqtts://");
	if (!broker->cert[0] != !broker->key[0])
		return refuse(why, -EINVAL, "cert and key go together");
	const char *files[] = {broker->ca, broker->cert, broker->key};
	for (size_t i = 0; i < 3; i++)
		if (files[i][0] && access(files[i], R_OK) < 0)
			return refuse(why, -errno, "%s: %s", files[i], strerror(errno));
	return 0;
}

static bool read_line(FILE *file, char *text, size_t size)
{
	if (!fgets(text, (int)size, file) || (!strchr(text, '\n') && !feof(file)))
		return false;
	text[strcspn(text, "\r\n")] = '\0';
	return true;
}

/* The user in the first line, the password in the second. */
static int read_credentials(struct options *o, char *why)
{
	struct broker_config *broker = &o->sender.broker;
	struct stat status;

	if (o->credentials[0] == '\0')
		return 0;
	FILE *file = fopen(o->credentials, "re");
	if (!file || fstat(fileno(file), &status) < 0) {
		int error = errno;

		if (file)
			fclose(file);
		return refuse(why, -error, "%s: %s", o->credentials, strerror(error));
	}
	bool is_open = status.st_mode & (S_IRWXG | S_IRWXO);
	bool complete = read_line(file, broker->user, sizeof(broker->user)) && broker->user[0] &&
			read_line(file, broker->password, sizeof(broker->password));
	fclose(file);
	if (is_open)
		return refuse(
			why, -EPERM, "%s: others can read the password: chmod 600 %s", o->credentials, o->credentials);
	if (!complete)
		return refuse(why, -EINVAL, "%s: write the user in the first line, the password in the second",
			o->credentials);
	return 0;
}

/* "5,7,10-19" */
static int parse_nodes(struct options *o, char *why)
{
	char copy[OPTIONS_TEXT_MAX], *rest = copy, *word;
	long first, last;

	if (o->nodes[0] == '\0')
		return 0;
	snprintf(copy, sizeof(copy), "%s", o->nodes);
	while ((word = strsep(&rest, ",")) != NULL) {
		char *dash = strchr(word, '-');

		if (dash)
			*dash = '\0';
		if (!cli_integer(word, 1, FLEET_NODES - 1, &first) ||
			!cli_integer(dash ? dash + 1 : word, first, FLEET_NODES - 1, &last))
			return refuse(why, -EINVAL, "node-id %s: write node-IDs 1 to 127 like 5,7,10-19", o->nodes);
		for (long id = first; id <= last; id++)
			o->fleet.expected[id] = true;
	}
	return 0;
}

/* [NODE=]FILE: of one node, or of all that have no own. */
static int load_eds(struct options *o, char *why)
{
	const struct od_table *all = &imu9_od_table, *own[FLEET_NODES] = {0};
	size_t count = o->eds_count;
	char error[256];

	o->eds_count = 0; /* those that options_free() frees */
	for (size_t i = 0; i < count; i++) {
		char *equals = strchr(o->eds_names[i], '=');
		const char *path = equals ? equals + 1 : o->eds_names[i];
		long id = 0;

		if (equals)
			*equals = '\0';
		if (equals && !cli_integer(o->eds_names[i], 1, FLEET_NODES - 1, &id))
			return refuse(why, -EINVAL, "eds %s=%s: write FILE or NODE=FILE", o->eds_names[i], path);
		int result = eds_load(&o->eds[i], path, EDS_LENIENT, error, sizeof(error));
		if (result < 0)
			return refuse(why, result, "%s", error);
		o->eds_count++;
		if (equals)
			own[id] = &o->eds[i].table;
		else
			all = &o->eds[i].table;
	}
	for (unsigned id = 1; id < FLEET_NODES; id++)
		if (o->nodes[0] == '\0' || o->fleet.expected[id])
			o->fleet.tables[id] = own[id] ? own[id] : all;
	return 0;
}

/* A name, or that of a record; false: neither. */
static bool find_object(const struct options *o, const char *name, uint16_t *index, uint8_t *sub)
{
	size_t length = strlen(name);

	for (unsigned id = 1; id < FLEET_NODES; id++) {
		const struct od_table *table = o->fleet.tables[id];
		const struct od_entry *entry = table ? od_find_name(table, name) : NULL;

		if (entry) {
			*index = entry->index;
			*sub = entry->sub;
			return true;
		}
		for (size_t i = 0; table && i < table->count; i++)
			if (strncmp(table->entries[i].name, name, length) == 0 &&
				table->entries[i].name[length] == '.') {
				*index = table->entries[i].index;
				*sub = 0;
				return true;
			}
	}
	return false;
}

/* Whether all members of the object are meant. */
static bool is_record(const struct options *o, const char *name)
{
	for (unsigned id = 1; id < FLEET_NODES; id++)
		if (o->fleet.tables[id] && od_find_name(o->fleet.tables[id], name))
			return false;
	return true;
}

static int parse_changes(struct options *o, char *why)
{
	for (size_t i = 0; i < o->change_count; i++) {
		struct fleet_threshold *threshold = &o->fleet.thresholds[i];
		char *equals = strchr(o->change[i], '=');

		if (!equals || !cli_real(equals + 1, 0, 1e300, &threshold->change))
			return refuse(why, -EINVAL, "change %s: write OBJECT=CHANGE like angles=0.5", o->change[i]);
		*equals = '\0';
		if (!find_object(o, o->change[i], &threshold->index, &threshold->sub))
			return refuse(why, -EINVAL, "change %s: no such object in the EDS", o->change[i]);
	}
	o->fleet.threshold_count = o->change_count;
	return 0;
}

static int parse_allowed(struct options *o, char *why)
{
	struct writes *w = &o->writes;
	uint16_t index;
	uint8_t sub;

	for (size_t i = 0; i < o->allow_count; i++)
		for (char *rest = o->allow[i], *name; (name = strsep(&rest, ", ")) != NULL;) {
			if (name[0] == '\0')
				continue;
			if (w->allowed_count == WRITES_ALLOWED || !find_object(o, name, &index, &sub))
				return refuse(why, -EINVAL, "allow-writes %s: %s", name,
					w->allowed_count == WRITES_ALLOWED ? "too many objects"
									   : "no such object in the EDS");
			w->allowed[w->allowed_count++] = (struct writes_allowed){index, is_record(o, name) ? -1 : sub};
		}
	return 0;
}

/* DIR[,size=MB] */
static int parse_spool(struct options *o, char *why)
{
	const char *state = getenv("XDG_STATE_HOME"), *home = getenv("HOME");
	const char *service = getenv("STATE_DIRECTORY"); /* of systemd */
	char *size = strstr(o->spool, ",size=");
	long mb = SPOOL_MB;

	if (size && !cli_integer(size + 6, 1, 32000, &mb))
		return refuse(why, -EINVAL, "spool %s: write DIR[,size=MB], 1 to 32000", o->spool);
	if (size)
		*size = '\0';
	if (o->spool[0])
		snprintf(o->spool_folder, sizeof(o->spool_folder), "%s", o->spool);
	else if (service && service[0])
		snprintf(o->spool_folder, sizeof(o->spool_folder), "%.400s", service);
	else if (geteuid() == 0 || (!state && !home))
		snprintf(o->spool_folder, sizeof(o->spool_folder), "/var/lib/imu9-fleet/%s", o->name);
	else
		snprintf(o->spool_folder, sizeof(o->spool_folder), "%.200s%s/imu9-fleet/%.200s", state ? state : home,
			state ? "" : "/.local/state", o->name);
	o->sender.spool_folder = o->spool_folder;
	o->sender.spool_bytes = (uint64_t)mb * BYTES_A_MB;
	return 0;
}

/* Topic levels must have no meaning in a topic. */
static int set_names(struct options *o, char *why)
{
	struct broker_config *broker = &o->sender.broker;
	char name[OPTIONS_TEXT_MAX], host[64] = "host";

	if (o->topic[0] == '\0' || o->topic[0] == '$' || strpbrk(o->topic, "+#") || strlen(o->topic) > 64)
		return refuse(why, -EINVAL, "topic %s: 1 to 64 characters, not +, # or a $ in front", o->topic);
	format_level(o->name[0] ? o->name : o->bus, name, sizeof(name));
	snprintf(o->name, sizeof(o->name), "%.64s", name);
	if (o->sender.ops == &format_sparkplug && strchr(o->topic, '/'))
		return refuse(why, -EINVAL, "topic %s: it is the group of Sparkplug: without /", o->topic);
	gethostname(host, sizeof(host) - 1);
	if (broker->client_id[0] == '\0')
		snprintf(broker->client_id, sizeof(broker->client_id), "imu9-fleet-%s-%.64s", host, o->name);
	o->writes.bus = o->name;
	o->sender.format = (struct format_config){.prefix = o->topic, .bus = o->name, .tables = o->fleet.tables};
	broker->subscription_count =
		o->sender.ops->subscriptions(&o->sender.format, o->allow_count > 0, broker->subscriptions);
	return 0;
}

int options_finish(struct options *o, char *why)
{
	int (*const steps[])(struct options * o, char *why) = {parse_broker, read_credentials, parse_nodes, load_eds,
		parse_changes, parse_allowed, set_names, parse_spool};
	int result = 0;

	for (size_t i = 0; result == 0 && i < sizeof(steps) / sizeof(steps[0]); i++)
		result = steps[i](o, why);
	return result;
}
