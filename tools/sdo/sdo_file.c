/* imu9-sdo save and load: a configuration as a file of names and values. */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/canopen/cia301.h"
#include "tools/sdo/sdo_load.h"

/* ---- save -------------------------------------------------------------------------------------------------------- */

/* All values that the node stores. False: the node stopped answering. */
static bool save_objects(struct session *s, FILE *out, int *saved, int *failed)
{
	uint8_t wire[OD_VALUE_MAX];
	uint16_t index = 0;
	uint64_t mapped = 0;

	for (size_t i = 0; i < s->table->count; i++) {
		const struct od_entry *entry = &s->table->entries[i];

		if (!settings_has(entry))
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
		if (!settings_write_value(out, entry, wire, s->node.sdo.size)) {
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
	FILE *out = sdo_open_text(&text, &size); /* the file is written only when all values were read */

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

static bool read_settings(struct settings *settings, const char *path)
{
	char error[512];
	FILE *file = strcmp(path, "-") == 0 ? stdin : fopen(path, "re");

	if (!file) {
		cli_error("%s: %s", path, strerror(errno));
		return false;
	}
	bool ok = settings_read(settings, file, path, error, sizeof(error));
	if (!ok)
		cli_error("%s", error);
	if (file != stdin)
		fclose(file);
	return ok;
}

int sdo_command_load(struct session *s, int argc, char **argv)
{
	static struct settings settings;

	(void)argc;
	settings.table = s->table;
	return read_settings(&settings, argv[0]) ? sdo_load(s, &settings) : CLI_FAILED;
}
