#include "tools/lib/settings.h"

#include <ctype.h>
#include <errno.h>
#include <ini.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "gateway/canopen/cia301.h"
#include "od/little_endian.h"
#include "tools/lib/cli.h"
#include "tools/lib/cli_value.h"

bool settings_has(const struct od_entry *entry)
{
	return (entry->access & OD_STORED) && (entry->access & OD_WRITE);
}

/* ---- a file of names and values ---------------------------------------------------------------------------------- */

struct reader {
	struct settings *settings;
	FILE *file;
	const char *path;
	char *error;
	size_t error_size;
	int line;
	bool failed;
};

static bool bad_line(struct reader *reader, const char *what, const char *why)
{
	snprintf(reader->error, reader->error_size, "%s:%d: %s%s%s", reader->path, reader->line, what,
		what[0] ? ": " : "", why);
	reader->failed = true;
	return false;
}

/* Line reader for inih that counts lines for error messages. */
static char *next_line(char *text, int size, void *stream)
{
	struct reader *reader = stream;

	if (reader->failed || !fgets(text, size, reader->file))
		return NULL;
	reader->line++;
	if (!strchr(text, '\n') && !feof(reader->file))
		bad_line(reader, "", "the line is too long");
	return text;
}

static int on_setting(void *user, const char *section, const char *key, const char *text)
{
	struct reader *reader = user;
	struct settings *settings = reader->settings;
	struct setting *setting = &settings->list[settings->count];
	char name[256];

	if (reader->failed)
		return false;
	if (strcasecmp(section, "gateway") == 0) { /* keys of the process; only node_id is used here */
		if (strcmp(key, "node_id") == 0 && !cli_integer(text, 1, 127, &settings->node_id))
			return bad_line(reader, text, "not a node-ID from 1 to 127");
		return true;
	}
	snprintf(name, sizeof(name), "%s%s%s", section, section[0] ? "." : "", key);
	setting->entry = od_find_name(settings->table, name);
	if (!setting->entry)
		return bad_line(reader, name, "the EDS has no object of this name");
	if (!settings_has(setting->entry))
		return bad_line(reader, name, "not a configuration object");
	if (settings->count == SETTINGS_MAX - 1)
		return bad_line(reader, name, "too many values in one file");
	enum od_status status = od_parse(setting->entry, text, setting->wire, sizeof(setting->wire), &setting->size);
	if (status != OD_OK)
		return bad_line(reader, name, od_status_text(status));
	settings->count++;
	return true;
}

bool settings_read(struct settings *settings, FILE *file, const char *path, char *error, size_t error_size)
{
	struct reader reader = {
		.settings = settings, .file = file, .path = path, .error = error, .error_size = error_size};
	int line = ini_parse_stream(next_line, &reader, on_setting, &reader);

	if (line > 0 && !reader.failed) {
		reader.line = line;
		bad_line(&reader, "syntax", "write NAME = VALUE");
	}
	return !reader.failed;
}

bool settings_write_value(FILE *out, const struct od_entry *entry, const uint8_t *wire, size_t size)
{
	char text[CLI_VALUE_TEXT_MAX];

	if (entry->type != OD_VISIBLE_STRING && size != entry->size)
		return false;
	if (entry->type == OD_UNSIGNED32 && entry->index < 0x2000 && !entry->unit[0]) /* COB-IDs, mappings */
		snprintf(text, sizeof(text), "0x%08X", (unsigned int)get_uint(wire, size));
	else if (od_format(entry, wire, size, text, sizeof(text)) < 0)
		return false;
	fprintf(out, "%s = %s", entry->name, text);
	if (entry->unit[0] && entry->factor != 1)
		fprintf(out, " ; steps of %.9g %s", entry->factor, entry->unit);
	else if (entry->unit[0])
		fprintf(out, " ; %s", entry->unit);
	fputc('\n', out);
	return true;
}

/* ---- a DCF ------------------------------------------------------------------------------------------------------- */

bool settings_take_dcf(struct settings *settings, const struct eds *dcf, const char *path, uint8_t node_id, char *error,
	size_t error_size)
{
	settings->table = &dcf->table;
	settings->node_id = dcf->info.node_id >= 1 && dcf->info.node_id <= 127 ? (long)dcf->info.node_id : 0;
	for (size_t i = 0; i < dcf->table.count; i++) {
		const struct od_entry *entry = &dcf->table.entries[i];
		struct setting *setting = &settings->list[settings->count];

		if (!dcf->entries[i].value || !settings_has(entry))
			continue;
		if (settings->count == SETTINGS_MAX - 1) {
			snprintf(error, error_size, "%s: more than %d values", path, SETTINGS_MAX - 1);
			return false;
		}
		setting->entry = entry;
		enum od_status status = eds_value(
			entry, dcf->entries[i].value, node_id, setting->wire, sizeof(setting->wire), &setting->size);
		if (status != OD_OK) {
			snprintf(error, error_size, "%s:%u: %s: ParameterValue=%s: %s", path, dcf->entries[i].line,
				entry->name, dcf->entries[i].value, od_status_text(status));
			return false;
		}
		settings->count++;
	}
	if (settings->count == 0)
		snprintf(error, error_size, "%s: contains no ParameterValue of a configuration object: is it a DCF?",
			path);
	return settings->count > 0;
}

struct dcf {
	FILE *out;
	const struct od_table *table;
	long node_id;
	settings_value *value;
	void *ctx;
	int *saved, *failed;
};

/* The notation of an EDS: integers in decimal, COB-IDs and mappings in hexadecimal, REALs as their IEEE 754 bits. */
static bool dcf_text(const struct dcf *dcf, const struct od_entry *entry, const uint8_t *wire, size_t size, char *text,
	size_t capacity)
{
	bool real = entry->type == OD_REAL32 || entry->type == OD_REAL64;
	unsigned long long value = get_uint(wire, size < 8 ? size : 8);
	uint32_t base = 0;

	if (entry->type != OD_VISIBLE_STRING && size != entry->size)
		return false;
	if (entry->access & OD_NODE_ID && size == 4)
		memcpy(&base, (const uint8_t *)dcf->table->defaults + entry->offset, 4);
	if (base && value == base + (unsigned long long)dcf->node_id)
		return snprintf(text, capacity, "$NODEID+0x%X", (unsigned int)base) > 0;
	if (real || (entry->type == OD_UNSIGNED32 && entry->index < 0x2000))
		return snprintf(text, capacity, "0x%0*llX", (int)(2 * size), value) > 0;
	return od_format(entry, wire, size, text, capacity) >= 0;
}

/* The entry of a section such as [1A00sub3], or NULL. */
static const struct od_entry *entry_of_section(const struct od_table *table, const char *section, size_t length)
{
	const struct od_entry *entry;
	char text[16], *end;
	unsigned long index, sub = 0;
	bool is_sub = false;

	if (length < 4 || length >= sizeof(text) || !isxdigit((unsigned char)section[0]))
		return NULL;
	memcpy(text, section, length);
	text[length] = '\0';
	index = strtoul(text, &end, 16);
	if (end != text + 4)
		return NULL;
	if (strncasecmp(end, "sub", 3) == 0 && isxdigit((unsigned char)end[3])) {
		is_sub = true;
		sub = strtoul(end + 3, &end, 16);
	}
	entry = *end || sub > 0xFF ? NULL : od_find(table, (uint16_t)index, (uint8_t)sub, NULL);
	/* a record itself has no value */
	return entry && is_sub == (strchr(entry->name, '.') != NULL) ? entry : NULL;
}

static void print_parameter(const struct dcf *dcf, const struct od_entry *entry)
{
	uint8_t wire[OD_VALUE_MAX];
	size_t size;
	char text[CLI_VALUE_TEXT_MAX];

	if (!entry || !settings_has(entry))
		return;
	if (!dcf->value(dcf->ctx, entry, wire, &size)) {
		++*dcf->failed;
	} else if (dcf_text(dcf, entry, wire, size, text, sizeof(text))) {
		fprintf(dcf->out, "ParameterValue=%s\r\n", text);
		++*dcf->saved;
	} else {
		++*dcf->failed;
	}
}

void settings_write_dcf(FILE *out, const struct od_table *table, const char *eds, size_t size, long node_id,
	settings_value *value, void *ctx, int *saved, int *failed)
{
	const struct dcf dcf = {out, table, node_id, value, ctx, saved, failed};
	const struct od_entry *entry = NULL;
	const char *text = eds, *end = eds + size;
	bool skip = false; /* [DeviceComissioning] of a DCF that is used as EDS */

	while (text < end) {
		const char *newline = memchr(text, '\n', (size_t)(end - text));
		size_t length = (size_t)((newline ? newline : end) - text);
		const char *line = text;

		text = newline ? newline + 1 : end;
		while (length && (line[length - 1] == '\r' || line[length - 1] == ' '))
			length--;
		if (length && line[0] == '[') {
			const char *close = memchr(line, ']', length);
			size_t name = (size_t)((close ? close : line + length) - (line + 1));

			print_parameter(&dcf, entry); /* there was no blank line before this section */
			skip = name == 18 && strncasecmp(line + 1, "DeviceComissioning", name) == 0;
			if (name == 16 && strncasecmp(line + 1, "MandatoryObjects", name) == 0)
				fprintf(out,
					"[DeviceComissioning]\r\nNodeID=%ld\r\nNodeName=Node %ld\r\n"
					"CANopenManager=0\r\n\r\n",
					node_id, node_id);
			entry = entry_of_section(table, line + 1, name);
		}
		if (length == 0 && entry) {
			print_parameter(&dcf, entry);
			entry = NULL;
		}
		if (!skip && (length < 15 || strncasecmp(line, "ParameterValue=", 15) != 0))
			fprintf(out, "%.*s\r\n", (int)length, line);
	}
	print_parameter(&dcf, entry);
}

/* ---- for another node -------------------------------------------------------------------------------------------- */

void settings_move_to_node(struct settings *settings, long node_id)
{
	if (settings->node_id == 0 || settings->node_id == node_id)
		return;
	for (size_t i = 0; i < settings->count; i++) {
		struct setting *setting = &settings->list[i];
		uint32_t base;

		if (!(setting->entry->access & OD_NODE_ID) || setting->size != 4)
			continue;
		memcpy(&base, (const char *)settings->table->defaults + setting->entry->offset, 4);
		if (get_u32(setting->wire) == base + (uint32_t)settings->node_id)
			put_u32(setting->wire, base + (uint32_t)node_id);
	}
}
