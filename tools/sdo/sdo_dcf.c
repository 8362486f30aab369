/* imu9-sdo dcf: device configuration files (CiA 306: an EDS with [DeviceComissioning] and ParameterValue), and concise
 * ones (CiA 302-3, as 2130h gives them). */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "od_values.h"
#include "tools/lib/cli_value.h"
#include "tools/sdo/sdo_json.h"
#include "tools/sdo/sdo_load.h"

#define COB_ID_FOLLOWS (1u << 29) /* 2130h: add the node-ID */

/* ---- save -------------------------------------------------------------------------------------------------------- */

struct save {
	struct session *session;
	bool lost;
};

static bool read_value(void *ctx, const struct od_entry *entry, uint8_t wire[OD_VALUE_MAX], size_t *size)
{
	struct save *save = ctx;
	struct cli_node *node = &save->session->node;

	if (save->lost)
		return false;
	if (!cli_node_read(node, entry->index, entry->sub, wire, OD_VALUE_MAX)) {
		cli_node_explain(node, entry);
		save->lost = node->sdo.result != SDO_ABORTED;
		return false;
	}
	*size = node->sdo.size;
	if (entry->type != OD_VISIBLE_STRING && *size != entry->size)
		cli_error("%s: the value in the node does not have the type given in the EDS", entry->name);
	return true;
}

/* The EDS of this program with the vendor-ID of the node, as the node gives it in 1021h. */
static void set_vendor(struct session *s, uint8_t *eds)
{
	uint8_t wire[4];
	char vendor[sizeof("0x00000000")];

	if (!cli_node_read(&s->node, OD_INDEX_IDENTITY, OD_SUB_IDENTITY_VENDOR_ID, wire, sizeof(wire)))
		return;
	snprintf(vendor, sizeof(vendor), "0x%08X", (unsigned)sdo_number(wire, sizeof(wire)));
	for (size_t i = 0; i < IMU9_EDS_VENDORS; i++)
		memcpy(eds + imu9_eds_vendor[i], vendor, strlen(vendor));
}

static uint8_t *own_eds(size_t *size)
{
	uint8_t *eds = malloc(IMU9_EDS_SIZE);

	*size = IMU9_EDS_SIZE;
	return eds ? memcpy(eds, imu9_eds, IMU9_EDS_SIZE) : NULL;
}

static int save_dcf(struct session *s, const char *path)
{
	size_t eds_size, size = 0;
	uint8_t *eds = s->eds_path ? sdo_read_file(s->eds_path, &eds_size) : own_eds(&eds_size);
	char *text = NULL;
	struct save save = {.session = s};
	int saved = 0, failed = 0;

	if (!eds)
		return CLI_FAILED;
	FILE *out = sdo_open_text(&text, &size);
	sdo_open(s);
	if (!s->eds_path)
		set_vendor(s, eds);
	settings_write_dcf(out, s->table, (const char *)eds, eds_size, s->node_id, read_value, &save, &saved, &failed);
	sdo_close(s);
	fclose(out);
	int exit_code = save.lost ? CLI_FAILED : sdo_finish_save(s, path, text, size, saved, failed);
	free(text);
	free(eds);
	return exit_code;
}

/* ---- apply, compare: a DCF --------------------------------------------------------------------------------------- */

static int use_dcf(struct session *s, const char *path, const uint8_t *text, size_t size, bool apply)
{
	static struct settings settings;
	struct eds dcf;
	char error[512];
	int exit_code = CLI_FAILED;

	if (eds_parse(&dcf, path, (const char *)text, size, EDS_LENIENT, error, sizeof(error)) < 0) {
		cli_error("%s", error);
		return CLI_FAILED;
	}
	const struct od_table *table = s->table;
	s->table = &dcf.table;
	if (!settings_take_dcf(&settings, &dcf, path, (uint8_t)s->node_id, error, sizeof(error)))
		cli_error("%s", error);
	else
		exit_code = apply ? sdo_load(s, &settings) : sdo_compare(s, &settings);
	s->table = table;
	eds_free(&dcf);
	return exit_code;
}

/* ---- apply, compare: a concise DCF ------------------------------------------------------------------------------- */

/* The value for this node, in `wire` if it is a COB-ID that depends on the node-ID. */
static const uint8_t *concise_value(const struct session *s, const struct od_dcf_item *item, uint8_t wire[4])
{
	const struct od_entry *entry = od_find(s->table, item->index, item->sub, NULL);
	uint32_t value;

	if (!entry || !(entry->access & OD_NODE_ID) || item->size != 4)
		return item->data;
	value = (uint32_t)sdo_number(item->data, 4);
	if (!(value & COB_ID_FOLLOWS))
		return item->data;
	sdo_put_u32(wire, (value & ~COB_ID_FOLLOWS) + (uint32_t)s->node_id);
	return wire;
}

/* Whether a later entry writes the same object, so that this one is an intermediate value. */
static bool is_written_later(const uint8_t *bytes, size_t size, size_t used, const struct od_dcf_item *item)
{
	struct od_dcf_item next;

	while (od_dcf_next(bytes, size, &used, &next))
		if (next.index == item->index && next.sub == item->sub)
			return true;
	return false;
}

static bool differs(
	struct session *s, const struct od_dcf_item *item, const uint8_t *value, struct json_object *differences)
{
	const struct od_entry *entry = od_find(s->table, item->index, item->sub, NULL);
	uint8_t wire[OD_VALUE_MAX];
	char name[128], there[128], wanted[128];

	if (!cli_node_read(&s->node, item->index, item->sub, wire, sizeof(wire))) {
		cli_node_explain(&s->node, entry);
		return true;
	}
	if (s->node.sdo.size == item->size && memcmp(wire, value, item->size) == 0)
		return false;
	if (differences) {
		sdo_json_add_difference(differences, s, &(struct target){item->index, item->sub, entry}, wire,
			s->node.sdo.size, value, item->size);
		return true;
	}
	cli_address_text(item->index, item->sub, entry, name, sizeof(name));
	cli_hex_text(wire, s->node.sdo.size, there, sizeof(there));
	cli_hex_text(value, item->size, wanted, sizeof(wanted));
	printf("%s  node: %s  file: %s\n", name, there, wanted);
	return true;
}

static bool write_item(struct session *s, const struct od_dcf_item *item, const uint8_t *value)
{
	if (cli_node_write(&s->node, item->index, item->sub, value, item->size))
		return true;
	cli_node_explain(&s->node, od_find(s->table, item->index, item->sub, NULL));
	return false;
}

/* A concise DCF is written in the order of the file. */
static int use_concise(struct session *s, const uint8_t *bytes, size_t size, bool apply)
{
	struct od_dcf_item item;
	size_t used = 0;
	int good = 0, bad = 0;
	struct json_object *document = s->json ? sdo_json_new(s) : NULL;
	struct json_object *differences = document ? sdo_json_array(document, "differences") : NULL;

	sdo_open(s);
	while (od_dcf_next(bytes, size, &used, &item)) {
		uint8_t wire[4];
		const uint8_t *value = concise_value(s, &item, wire);

		if (!apply && is_written_later(bytes, size, used, &item))
			continue;
		bool ok = apply ? write_item(s, &item, value) : !differs(s, &item, value, differences);
		good += ok;
		bad += !ok;
		if (!ok && s->node.sdo.result != SDO_ABORTED && s->node.sdo.result != SDO_DONE)
			break;
	}
	sdo_close(s);
	if (document)
		sdo_json_print_comparison(document, good, bad - (int)json_object_array_length(differences));
	else if (!s->quiet)
		fprintf(stderr, "imu9-sdo: node %ld: %d values %s, %d %s\n", s->node_id, good,
			apply ? "written" : "as in the file", bad, apply ? "failed" : "differ");
	return bad ? CLI_FAILED : CLI_OK;
}

static int use_file(struct session *s, const char *path, bool apply)
{
	size_t size;
	uint8_t *bytes = sdo_read_file(path, &size);

	if (!bytes)
		return CLI_FAILED;
	int exit_code =
		od_dcf_valid(bytes, size) ? use_concise(s, bytes, size, apply) : use_dcf(s, path, bytes, size, apply);
	free(bytes);
	return exit_code;
}

int sdo_command_dcf(struct session *s, int argc, char **argv)
{
	(void)argc;
	if (s->json && strcmp(argv[0], "compare") != 0)
		cli_usage_error("--json is for dcf compare only");
	if (strcmp(argv[0], "apply") == 0)
		return use_file(s, argv[1], true);
	if (strcmp(argv[0], "compare") == 0)
		return use_file(s, argv[1], false);
	if (strcmp(argv[0], "save") == 0)
		return save_dcf(s, argv[1]);
	cli_usage_error("dcf %s: use apply, compare or save", argv[0]);
}
