/* imu9-sdo dcf: device configuration files (CiA 306: an EDS with [DeviceComissioning] and ParameterValue), and concise
 * ones (CiA 302-3, as 2130h gives them). */
#include <ctype.h>
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

/* The notation of an EDS: integers in decimal, COB-IDs and mappings in hexadecimal, REALs as their IEEE 754 bits. */
static bool value_text(const struct session *s, const struct od_entry *entry, const uint8_t *wire, size_t size,
	char *text, size_t capacity)
{
	bool real = entry->type == OD_REAL32 || entry->type == OD_REAL64;
	unsigned long long value = sdo_number(wire, size);
	uint32_t base = 0;

	if (entry->type != OD_VISIBLE_STRING && size != entry->size)
		return false;
	if (entry->access & OD_NODE_ID && size == 4)
		memcpy(&base, (const uint8_t *)s->table->defaults + entry->offset, 4);
	if (base && value == base + (unsigned long long)s->node_id)
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

struct save {
	struct session *session;
	FILE *out;
	int saved, failed;
	bool lost;
};

static void print_parameter(struct save *save, const struct od_entry *entry)
{
	struct session *s = save->session;
	uint8_t wire[OD_VALUE_MAX];
	char text[CLI_VALUE_TEXT_MAX];

	if (!entry || !sdo_is_configuration(entry) || save->lost)
		return;
	if (!cli_node_read(&s->node, entry->index, entry->sub, wire, sizeof(wire))) {
		cli_node_explain(&s->node, entry);
		save->failed++;
		save->lost = s->node.sdo.result != SDO_ABORTED;
	} else if (value_text(s, entry, wire, s->node.sdo.size, text, sizeof(text))) {
		fprintf(save->out, "ParameterValue=%s\r\n", text);
		save->saved++;
	} else {
		cli_error("%s: the value in the node does not have the type given in the EDS", entry->name);
		save->failed++;
	}
}

static void print_commissioning(const struct save *save)
{
	fprintf(save->out, "[DeviceComissioning]\r\nNodeID=%ld\r\nNodeName=Node %ld\r\nCANopenManager=0\r\n\r\n",
		save->session->node_id, save->session->node_id);
}

/* Copies the EDS line by line and appends the value to each section of an object. */
static void print_dcf(struct save *save, const char *text, size_t size)
{
	const struct od_entry *entry = NULL;
	const char *end = text + size;
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

			print_parameter(save, entry); /* there was no blank line before this section */
			skip = name == 18 && strncasecmp(line + 1, "DeviceComissioning", name) == 0;
			if (name == 16 && strncasecmp(line + 1, "MandatoryObjects", name) == 0)
				print_commissioning(save);
			entry = entry_of_section(save->session->table, line + 1, name);
		}
		if (length == 0 && entry) {
			print_parameter(save, entry);
			entry = NULL;
		}
		if (!skip && (length < 15 || strncasecmp(line, "ParameterValue=", 15) != 0))
			fprintf(save->out, "%.*s\r\n", (int)length, line);
	}
	print_parameter(save, entry);
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
	struct save save = {.session = s, .out = open_memstream(&text, &size)};

	if (!save.out || !eds) {
		free(eds);
		return CLI_FAILED;
	}
	sdo_open(s);
	if (!s->eds_path)
		set_vendor(s, eds);
	print_dcf(&save, (const char *)eds, eds_size);
	sdo_close(s);
	fclose(save.out);
	int exit_code = save.lost ? CLI_FAILED : sdo_finish_save(s, path, text, size, save.saved, save.failed);
	free(text);
	free(eds);
	return exit_code;
}

/* ---- apply, compare: a DCF --------------------------------------------------------------------------------------- */

static bool parse_values(struct settings *settings, const struct eds *dcf, const char *path, uint8_t node_id)
{
	for (size_t i = 0; i < dcf->table.count; i++) {
		const struct od_entry *entry = &dcf->table.entries[i];
		struct setting *setting = &settings->list[settings->count];

		if (!dcf->entries[i].value || !sdo_is_configuration(entry))
			continue;
		if (settings->count == SETTINGS_MAX - 1) {
			cli_error("%s: more than %d values", path, SETTINGS_MAX - 1);
			return false;
		}
		setting->entry = entry;
		enum od_status status = eds_value(
			entry, dcf->entries[i].value, node_id, setting->wire, sizeof(setting->wire), &setting->size);
		if (status != OD_OK) {
			cli_error("%s:%u: %s: ParameterValue=%s: %s", path, dcf->entries[i].line, entry->name,
				dcf->entries[i].value, od_status_text(status));
			return false;
		}
		settings->count++;
	}
	if (settings->count == 0)
		cli_error("%s: contains no ParameterValue of a configuration object: is it a DCF?", path);
	return settings->count > 0;
}

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
	settings.session = s;
	settings.node_id = dcf.info.node_id >= 1 && dcf.info.node_id <= 127 ? (long)dcf.info.node_id : 0;
	if (parse_values(&settings, &dcf, path, (uint8_t)s->node_id))
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
