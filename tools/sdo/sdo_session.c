#include "tools/sdo/sdo_session.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "tools/lib/cli_value.h"
#include "od_index.h"

/* ---- objects named on the command line --------------------------------------------------------------------------- */

static bool find_target(const struct session *s, const char *text, struct target *target)
{
	static const struct {
		const char *name;
		uint16_t index;
	} short_names[] = {{"eds", OD_INDEX_STORE_EDS}, {"snapshot", OD_INDEX_CONFIGURATION_SNAPSHOT},
		{"log", OD_INDEX_EVENT_LOG}};
	const struct od_entry *entry = od_find_name(s->table, text);

	for (size_t i = 0; !entry && i < sizeof(short_names) / sizeof(short_names[0]); i++)
		if (strcasecmp(text, short_names[i].name) == 0)
			entry = od_find(s->table, short_names[i].index, 0, NULL);
	if (entry) {
		*target = (struct target){entry->index, entry->sub, entry};
		return true;
	}
	*target = (struct target){0};
	return cli_address(text, &target->index, &target->sub);
}

/* All sub-indices of a record except 0, and those that are no values. */
static size_t find_record(const struct session *s, const char *name, struct target *targets, size_t capacity)
{
	size_t length = strlen(name), n = 0;

	for (size_t i = 0; i < s->table->count && n < capacity; i++) {
		const struct od_entry *entry = &s->table->entries[i];

		if (entry->sub > 0 && entry->type != OD_DOMAIN && strncasecmp(entry->name, name, length) == 0 &&
			entry->name[length] == '.')
			targets[n++] = (struct target){entry->index, entry->sub, entry};
	}
	return n;
}

static _Noreturn void unknown_object(const struct session *s, const char *text)
{
	if (text[0] == '-')
		cli_usage_error("%s: options must be before the command", text);
	cli_usage_error("no object '%s' in %s: use a name from 'imu9-sdo dump', or an index such as "
			"0x2000:1",
		text, s->eds_path ? s->eds_path : "the EDS of the IMU9 gateway");
}

size_t sdo_targets(const struct session *s, const char *text, struct target *targets, size_t capacity)
{
	if (capacity == 0)
		cli_usage_error("more than %d objects at once", SDO_TARGETS_MAX);
	size_t n = find_record(s, text, targets, capacity);

	if (n == 0 && !find_target(s, text, targets))
		unknown_object(s, text);
	return n ? n : 1;
}

void sdo_target_name(const struct target *target, char *name, size_t capacity)
{
	if (target->entry)
		snprintf(name, capacity, "%s", target->entry->name);
	else
		cli_address_text(target->index, target->sub, NULL, name, capacity);
}

static const char *extract_option(int *argc, char **argv, const char *option, bool with_value)
{
	for (int i = 0; i < *argc; i++) {
		int words = with_value ? 2 : 1;

		if (strcmp(argv[i], option) != 0)
			continue;
		if (i + words > *argc)
			cli_usage_error("option %s needs a value", option);
		const char *value = argv[i + words - 1];
		memmove(&argv[i], &argv[i + words], (size_t)(*argc - i - words) * sizeof(argv[0]));
		*argc -= words;
		return value;
	}
	return NULL;
}

bool sdo_extract_flag(int *argc, char **argv, const char *option)
{
	return extract_option(argc, argv, option, false) != NULL;
}

const char *sdo_extract_value(int *argc, char **argv, const char *option)
{
	return extract_option(argc, argv, option, true);
}

/* ---- values ------------------------------------------------------------------------------------------------------ */

uint64_t sdo_number(const uint8_t *wire, size_t size)
{
	uint64_t value = 0;

	for (size_t i = 0; i < size && i < 8; i++)
		value |= (uint64_t)wire[i] << 8 * i;
	return value;
}

void sdo_put_u32(uint8_t *wire, uint32_t value)
{
	for (int i = 0; i < 4; i++)
		wire[i] = (uint8_t)(value >> 8 * i);
}

double sdo_step(struct session *s, const struct od_entry *entry)
{
	const struct od_entry *resolution = od_resolution(s->table, entry);
	uint8_t wire[OD_VALUE_MAX];

	if (!resolution)
		return entry->factor;
	if (resolution == s->resolution)
		return s->step;
	if (!cli_node_read(&s->node, resolution->index, resolution->sub, wire, sizeof(wire)) ||
		s->node.sdo.size != resolution->size)
		return entry->factor;
	s->resolution = resolution;
	s->step = cli_number(resolution, wire) * resolution->factor;
	return s->step;
}

void sdo_value_text(
	struct session *s, const struct target *target, const uint8_t *wire, size_t size, char *text, size_t capacity)
{
	size_t n;

	if (!target->entry) {
		cli_hex_text(wire, size, text, capacity);
		n = strlen(text);
		if (size == 1 || size == 2 || size == 4 || size == 8)
			snprintf(text + n, capacity - n, " (%llu)", (unsigned long long)sdo_number(wire, size));
	} else if (s->quiet) {
		if (od_format(target->entry, wire, size, text, capacity) < 0)
			cli_hex_text(wire, size, text, capacity);
	} else {
		cli_value_text(target->entry, sdo_step(s, target->entry), wire, size, text, capacity);
	}
}

/* ---- the node ---------------------------------------------------------------------------------------------------- */

void sdo_open(struct session *s)
{
	cli_node_open(&s->node, s->bus, (uint8_t)s->node_id, s->timeout_ms);
	s->node.show_progress = !s->quiet;
}

void sdo_close(struct session *s)
{
	cli_node_close(&s->node);
}

bool sdo_send_frame(const struct session *s, struct can_port *bus, const struct can_msg *msg)
{
	int rc = can_send(bus, msg, cli_now_us());

	if (rc == 0)
		rc = cli_flush(bus);
	if (rc < 0)
		cli_error("cannot send on %s: %s: is the bus up, and is another node on it?", s->bus, strerror(-rc));
	return rc == 0;
}

/* ---- files ------------------------------------------------------------------------------------------------------- */

/* Control codes from another device must not reach a terminal. */
static bool print_printable(const uint8_t *data, size_t size)
{
	for (size_t i = 0; i < size; i++)
		putchar((data[i] >= 0x20 && data[i] <= 0x7E) || memchr("\t\r\n", data[i], 3) ? data[i] : '?');
	return fflush(stdout) == 0;
}

bool sdo_write_file(const char *path, const void *data, size_t size)
{
	bool to_stdout = strcmp(path, "-") == 0;

	if (to_stdout && isatty(STDOUT_FILENO))
		return print_printable(data, size);

	FILE *file = to_stdout ? stdout : fopen(path, "we");
	bool ok = file && fwrite(data, 1, size, file) == size && fflush(file) == 0;

	if (!ok)
		cli_error("%s: %s", path, strerror(errno));
	if (file && !to_stdout)
		fclose(file);
	return ok;
}

int sdo_finish_save(const struct session *s, const char *path, const char *text, size_t size, int saved, int failed)
{
	if (!sdo_write_file(path, text, size))
		return CLI_FAILED;
	if (!s->quiet)
		fprintf(stderr, "imu9-sdo: %d values of node %ld saved%s\n", saved, s->node_id,
			failed ? ", some could not be read" : "");
	return failed ? CLI_FAILED : CLI_OK;
}

uint8_t *sdo_read_file(const char *path, size_t *size)
{
	uint8_t *data = malloc(SDO_DOMAIN_MAX + 1);
	FILE *file = !data ? NULL : strcmp(path, "-") == 0 ? stdin : fopen(path, "re");

	if (!file) {
		cli_error("%s: %s", path, strerror(errno));
		free(data);
		return NULL;
	}
	*size = fread(data, 1, SDO_DOMAIN_MAX + 1, file);
	bool failed = ferror(file);
	if (file != stdin)
		fclose(file);
	if (!failed && *size <= SDO_DOMAIN_MAX)
		return data;
	cli_error("%s: %s", path, failed ? strerror(EIO) : "longer than 4 MB");
	free(data);
	return NULL;
}

FILE *sdo_open_text(char **text, size_t *size)
{
	FILE *stream = open_memstream(text, size);

	if (!stream) {
		cli_error("out of memory");
		exit(CLI_FAILED);
	}
	return stream;
}
