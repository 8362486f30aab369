/* imu9-sdo save and load: a configuration as a file of names and values. */
#include <errno.h>
#include <ini.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "gateway/canopen/cia301.h"
#include "tools/lib/cli_value.h"
#include "tools/sdo/sdo_load.h"

/* ---- save -------------------------------------------------------------------------------------------------------- */

/* One line of the file. False: the value does not have the type of the object. */
static bool save_value(FILE *out, const struct od_entry *entry, const uint8_t *wire, size_t size)
{
	char text[CLI_VALUE_TEXT_MAX];

	if (entry->type != OD_VISIBLE_STRING && size != entry->size)
		return false;
	if (entry->type == OD_UNSIGNED32 && entry->index < 0x2000 && !entry->unit[0]) /* COB-IDs, mappings */
		snprintf(text, sizeof(text), "0x%08X", (unsigned int)sdo_number(wire, size));
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

/* All values that the node stores. False: the node stopped answering. */
static bool save_objects(struct session *s, FILE *out, int *saved, int *failed)
{
	uint8_t wire[OD_VALUE_MAX];
	uint16_t index = 0;
	uint64_t mapped = 0;

	for (size_t i = 0; i < s->table->count; i++) {
		const struct od_entry *entry = &s->table->entries[i];

		if (!sdo_is_configuration(entry))
			continue;
		if (entry->index != index) {
			index = entry->index;
			mapped = UINT64_MAX; /* until sub-index 0 was read */
			fprintf(out, "\n# %04Xh\n", index);
		}
		if (is_pdo_mapping(index) && entry->sub > mapped)
			continue; /* not in use */
		if (!cli_node_read(&s->node, entry->index, entry->sub, wire, sizeof(wire))) {
			cli_node_explain(&s->node, entry);
			if (s->node.sdo.result != SDO_ABORTED)
				return false;
			++*failed;
			continue;
		}
		if (entry->sub == 0)
			mapped = sdo_number(wire, s->node.sdo.size);
		if (!save_value(out, entry, wire, s->node.sdo.size)) {
			cli_error("%s: the value in the node does not have the type given in the EDS", entry->name);
			++*failed;
			continue;
		}
		++*saved;
	}
	return true;
}

int sdo_command_save(struct session *s, int argc, char **argv)
{
	(void)argc;
	char *text = NULL;
	size_t size = 0;
	int saved = 0, failed = 0;
	FILE *out = open_memstream(&text, &size); /* the file is written only when all values were read */

	if (!out) {
		cli_error("out of memory");
		return CLI_FAILED;
	}
	sdo_open(s);
	fprintf(out,
		"# Configuration of node %ld, read by imu9-sdo save.\n"
		"# For 'imu9-sdo load' and 'imu9-gateway -c'.\n",
		s->node_id);
	bool complete = save_objects(s, out, &saved, &failed);
	fprintf(out, "\n[gateway]\nnode_id = %ld\n", s->node_id);
	fclose(out);
	sdo_close(s);
	int exit_code = complete ? sdo_finish_save(s, argv[0], text, size, saved, failed) : CLI_FAILED;
	free(text);
	return exit_code;
}

/* ---- load -------------------------------------------------------------------------------------------------------- */

struct reader {
	struct settings *settings;
	FILE *file;
	const char *path;
	int line;
	bool failed;
};

/* Line reader for inih that counts lines for error messages. */
static char *next_line(char *text, int size, void *stream)
{
	struct reader *reader = stream;

	if (reader->failed || !fgets(text, size, reader->file))
		return NULL;
	reader->line++;
	if (!strchr(text, '\n') && !feof(reader->file)) {
		cli_error("%s:%d: the line is too long", reader->path, reader->line);
		reader->failed = true;
	}
	return text;
}

static bool bad_line(struct reader *reader, const char *what, const char *why)
{
	cli_error("%s:%d: %s: %s", reader->path, reader->line, what, why);
	reader->failed = true;
	return false;
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
	setting->entry = od_find_name(settings->session->table, name);
	if (!setting->entry)
		return bad_line(reader, name, "the EDS has no object of this name");
	if (!sdo_is_configuration(setting->entry))
		return bad_line(reader, name, "not a configuration object");
	if (settings->count == SETTINGS_MAX - 1)
		return bad_line(reader, name, "too many values in one file");
	enum od_status status = od_parse(setting->entry, text, setting->wire, sizeof(setting->wire), &setting->size);
	if (status != OD_OK)
		return bad_line(reader, name, od_status_text(status));
	settings->count++;
	return true;
}

static bool read_settings(struct settings *settings, const char *path)
{
	struct reader of_file = {.settings = settings}, *reader = &of_file;

	reader->path = path;
	reader->file = strcmp(path, "-") == 0 ? stdin : fopen(path, "re");
	if (!reader->file) {
		cli_error("%s: %s", path, strerror(errno));
		return false;
	}
	int line = ini_parse_stream(next_line, reader, on_setting, reader);
	if (line > 0 && !reader->failed) {
		reader->line = line;
		bad_line(reader, "syntax", "write NAME = VALUE");
	}
	if (reader->file != stdin)
		fclose(reader->file);
	return !reader->failed;
}

int sdo_command_load(struct session *s, int argc, char **argv)
{
	static struct settings settings;

	(void)argc;
	settings.session = s;
	return read_settings(&settings, argv[0]) ? sdo_load(s, &settings) : CLI_FAILED;
}
