/* imu9-sdo: configures a CANopen node by the names of its objects. */
#include <ctype.h>
#include <errno.h>
#include <getopt.h>
#include <ini.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "od_values.h"
#include "tools/cli.h"
#include "tools/cli_node.h"
#include "tools/cli_value.h"
#include "tools/eds.h"

enum { DOMAIN_MAX = 4 << 20, SETTINGS_MAX = 1024, TARGETS_MAX = 512 };
enum { STRING_MAX = 1024 };	  /* of other people's devices */
enum { STORE_TIMEOUT_MS = 5000 }; /* a disk may take its time */

#define COB_ID_INVALID (1u << 31)
#define ABORT_NO_DATA  0x08000024

static const char help[] = "Usage: imu9-sdo [-i BUS] [-n NODE] [-e EDS] [-t MS] [-q] COMMAND\n"
			   "Reads and writes the objects of a CANopen node over SDO.\n"
			   "\n"
			   "  read OBJECT...        print values; OBJECT is a name (lever_arm.l), a whole record\n"
			   "                        (lever_arm) or an index (0x2000:1, 2000h:1, 0x1017);\n"
			   "                        a DOMAIN goes to standard output as it is\n"
			   "  write OBJECT VALUE    VALUE by the object's type: decimal, 0x hex, float or text.\n"
			   "                        For an object that the EDS does not have, with its type:\n"
			   "                        u8: u16: u32: u64: i8: i16: i32: i64: r32: r64: bool: str: hex:\n"
			   "  dump                  print all readable objects of the EDS\n"
			   "  save FILE             keep the configuration in FILE ('-': standard output), in the\n"
			   "                        form that 'load' and 'imu9-gateway -c' read\n"
			   "  load FILE             bring the node to the configuration in FILE; writes only what\n"
			   "                        differs, PDOs by the mapping procedure\n"
			   "  store [GROUP]         let the node keep its configuration over a power cut (1010h)\n"
			   "  restore [GROUP]       let the node forget what it kept (1011h)\n"
			   "                        GROUP: all (default), communication, application, manufacturer\n"
			   "  nmt COMMAND           start, stop, preop, reset or reset-comm; with -n 0 to all nodes\n"
			   "\n"
			   "  -i, --bus BUS         interface name or udp[:GROUP[:PORT]] (default: $IMU9_CAN or "
			   "vcan0)\n"
			   "  -n, --node NODE       node-ID 1 to 127 (default: $IMU9_NODE or 1)\n"
			   "  -e, --eds EDS         the node's EDS (default: the one of the IMU9 gateway, built in)\n"
			   "  -t, --timeout MS      wait so long for each answer (default: 500)\n"
			   "  -q, --quiet           print bare values, without names and units\n"
			   "  -h, --help            this text\n"
			   "  -V, --version         the version\n"
			   "\n"
			   "Exit codes: 0 done, 1 failed, 2 wrong usage.\n"
			   "Example: imu9-sdo -n 5 write lever_arm.l 0.05 && imu9-sdo -n 5 store\n";

struct session {
	const char *bus;
	long node_id;
	const char *eds_path;
	unsigned int timeout_ms;
	bool quiet;

	const struct od_table *table;
	struct cli_node node;
	const struct od_entry *resolution; /* read last, and the step that it gives */
	double step;
};

/* ---- objects named on the command line ---- */

struct target {
	uint16_t index;
	uint8_t sub;
	const struct od_entry *entry; /* NULL: not in the EDS */
};

static bool find_target(const struct session *s, const char *text, struct target *target)
{
	const struct od_entry *entry = od_find_name(s->table, text);

	if (entry) {
		*target = (struct target){entry->index, entry->sub, entry};
		return true;
	}
	*target = (struct target){0};
	return cli_address(text, &target->index, &target->sub);
}

/* All sub-indices of a record but the highest one supported. */
static size_t find_record(const struct session *s, const char *name, struct target *targets, size_t capacity)
{
	size_t length = strlen(name), n = 0;

	for (size_t i = 0; i < s->table->count && n < capacity; i++) {
		const struct od_entry *entry = &s->table->entries[i];

		if (entry->sub > 0 && strncasecmp(entry->name, name, length) == 0 && entry->name[length] == '.')
			targets[n++] = (struct target){entry->index, entry->sub, entry};
	}
	return n;
}

static _Noreturn void unknown_object(const struct session *s, const char *text)
{
	if (text[0] == '-')
		cli_usage_error("%s: options stand before the command", text);
	cli_usage_error("no object '%s' in %s: give its name as 'imu9-sdo dump' prints it, or its "
			"index as 0x2000:1",
		text, s->eds_path ? s->eds_path : "the EDS of the IMU9 gateway");
}

/* ---- values ---- */

static uint64_t get_number(const uint8_t *wire, size_t size)
{
	uint64_t value = 0;

	for (size_t i = 0; i < size && i < 8; i++)
		value |= (uint64_t)wire[i] << 8 * i;
	return value;
}

static void put_u32(uint8_t *wire, uint32_t value)
{
	for (int i = 0; i < 4; i++)
		wire[i] = (uint8_t)(value >> 8 * i);
}

/* The physical value of 1, as the node's resolution objects say now. */
static double step_of(struct session *s, const struct od_entry *entry)
{
	const struct od_entry *resolution = cli_resolution(s->table, entry);
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

static void value_text(
	struct session *s, const struct target *target, const uint8_t *wire, size_t size, char *text, size_t capacity)
{
	size_t n;

	if (!target->entry) {
		cli_hex_text(wire, size, text, capacity);
		n = strlen(text);
		if (size == 1 || size == 2 || size == 4 || size == 8)
			snprintf(text + n, capacity - n, " (%llu)", (unsigned long long)get_number(wire, size));
	} else if (s->quiet) {
		if (od_format(target->entry, wire, size, text, capacity) < 0)
			cli_hex_text(wire, size, text, capacity);
	} else {
		cli_value_text(target->entry, step_of(s, target->entry), wire, size, text, capacity);
	}
}

/* ---- read, write, dump ---- */

static void print_value(struct session *s, const struct target *target, const uint8_t *wire)
{
	char text[CLI_VALUE_TEXT_MAX], name[128];

	value_text(s, target, wire, s->node.sdo.size, text, sizeof(text));
	if (s->quiet) {
		puts(text);
		return;
	}
	if (target->entry)
		snprintf(name, sizeof(name), "%s", target->entry->name);
	else
		cli_address_text(target->index, target->sub, NULL, name, sizeof(name));
	printf("%s = %s\n", name, text);
}

static int command_read(struct session *s, int argc, char **argv)
{
	static struct target targets[TARGETS_MAX];
	static uint8_t wire[DOMAIN_MAX];
	size_t n = 0;
	int exit_code = CLI_OK;

	for (int i = 0; i < argc; i++) {
		if (n == TARGETS_MAX)
			cli_usage_error("more than %d objects at once", TARGETS_MAX);
		size_t record = find_record(s, argv[i], &targets[n], TARGETS_MAX - n);

		if (record == 0 && !find_target(s, argv[i], &targets[n]))
			unknown_object(s, argv[i]);
		n += record ? record : 1;
	}
	cli_node_open(&s->node, s->bus, (uint8_t)s->node_id, s->timeout_ms);
	for (size_t i = 0; i < n; i++) {
		const struct target *t = &targets[i];

		if (!cli_node_read(&s->node, t->index, t->sub, wire, sizeof(wire))) {
			cli_node_explain(&s->node, t->entry);
			exit_code = CLI_FAILED;
			if (s->node.sdo.result != SDO_ABORTED)
				break;
		} else if (t->entry && t->entry->type == OD_DOMAIN) {
			fwrite(wire, 1, s->node.sdo.size, stdout);
		} else {
			print_value(s, t, wire);
		}
	}
	cli_node_close(&s->node);
	return exit_code;
}

static void parse_value(const struct target *target, const char *text, uint8_t *wire, size_t capacity, size_t *size)
{
	const struct od_entry *entry = target->entry;
	enum od_status status = OD_BAD_VALUE;
	char limits[128] = "";

	/* a value with its type is for objects that the EDS does not know, and to try a wrong type
	 * on purpose */
	if (!entry || entry->type != OD_VISIBLE_STRING)
		status = cli_typed_value(text, wire, capacity, size);
	if (status == OD_OK)
		return;
	if (!entry)
		cli_usage_error("%s: the EDS does not have this object; give the value with its type, "
				"for example u16:5, r32:0.5 or hex:0102",
			text);
	status = od_parse(entry, text, wire, capacity, size);
	if (status == OD_OK)
		return;
	cli_limits_text(entry, limits, sizeof(limits));
	cli_usage_error(
		"%s = %s: %s%s%s", entry->name, text, od_status_text(status), limits[0] ? "; allowed: " : "", limits);
}

static int command_write(struct session *s, int argc, char **argv)
{
	(void)argc;
	struct target target;
	uint8_t wire[OD_VALUE_MAX];
	size_t size;

	if (!find_target(s, argv[0], &target))
		unknown_object(s, argv[0]);
	parse_value(&target, argv[1], wire, sizeof(wire), &size);
	cli_node_open(&s->node, s->bus, (uint8_t)s->node_id, s->timeout_ms);
	bool done = cli_node_write(&s->node, target.index, target.sub, wire, size);
	if (!done)
		cli_node_explain(&s->node, target.entry);
	cli_node_close(&s->node);
	return done ? CLI_OK : CLI_FAILED;
}

static bool is_highest_subindex(const struct od_entry *entry)
{
	return entry->sub == 0 && (entry->access & OD_CONST) && entry->type == OD_UNSIGNED8 && strchr(entry->name, '.');
}

static int command_dump(struct session *s, int argc, char **argv)
{
	(void)argc, (void)argv;
	uint8_t wire[STRING_MAX];
	char text[CLI_VALUE_TEXT_MAX];
	int failed = 0;

	cli_node_open(&s->node, s->bus, (uint8_t)s->node_id, s->timeout_ms);
	for (size_t i = 0; i < s->table->count; i++) {
		const struct od_entry *entry = &s->table->entries[i];
		const struct target target = {entry->index, entry->sub, entry};

		if (!(entry->access & OD_READ) || is_highest_subindex(entry))
			continue;
		if (entry->type == OD_DOMAIN) {
			snprintf(text, sizeof(text), "(a file: imu9-sdo read %s >FILE)", entry->name);
		} else if (cli_node_read(&s->node, entry->index, entry->sub, wire, sizeof(wire))) {
			value_text(s, &target, wire, s->node.sdo.size, text, sizeof(text));
		} else if (s->node.sdo.result == SDO_ABORTED) {
			failed += s->node.sdo.abort_code != ABORT_NO_DATA;
			snprintf(text, sizeof(text), "(%s, abort %08Xh)", sdo_abort_text(s->node.sdo.abort_code),
				s->node.sdo.abort_code);
		} else {
			cli_node_explain(&s->node, entry);
			cli_node_close(&s->node);
			return CLI_FAILED;
		}
		printf("%04Xh:%02X  %-44s = %s\n", entry->index, entry->sub, entry->name, text);
	}
	cli_node_close(&s->node);
	if (failed)
		cli_error("%d objects of the EDS could not be read: is it the EDS of this node?", failed);
	return failed ? CLI_FAILED : CLI_OK;
}

/* ---- save ---- */

static bool is_pdo_parameter(uint16_t index)
{
	return index >= 0x1400 && index < 0x1C00;
}

static bool is_mapping(uint16_t index)
{
	return is_pdo_parameter(index) && (index & 0x200);
}

/* One line of the file; false when the value is not of the object's type. */
static bool save_value(FILE *out, const struct od_entry *entry, const uint8_t *wire, size_t size)
{
	char text[CLI_VALUE_TEXT_MAX];

	if (entry->type != OD_VISIBLE_STRING && size != entry->size)
		return false;
	if (entry->type == OD_UNSIGNED32 && entry->index < 0x2000 && !entry->unit[0]) /* COB-IDs, mappings */
		snprintf(text, sizeof(text), "0x%08X", (unsigned int)get_number(wire, size));
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

/* What a client may bring to another node: stored, and writable. */
static bool is_configuration(const struct od_entry *entry)
{
	return (entry->access & OD_STORED) && (entry->access & OD_WRITE);
}

/* All that the node would store itself. False when it stopped to answer. */
static bool save_objects(struct session *s, FILE *out, int *saved, int *failed)
{
	uint8_t wire[OD_VALUE_MAX];
	uint16_t index = 0;
	uint64_t mapped = 0;

	for (size_t i = 0; i < s->table->count; i++) {
		const struct od_entry *entry = &s->table->entries[i];

		if (!is_configuration(entry))
			continue;
		if (entry->index != index) {
			index = entry->index;
			mapped = UINT64_MAX; /* until sub-index 0 was read */
			fprintf(out, "\n# %04Xh\n", index);
		}
		if (is_mapping(index) && entry->sub > mapped)
			continue; /* not in use */
		if (!cli_node_read(&s->node, entry->index, entry->sub, wire, sizeof(wire))) {
			cli_node_explain(&s->node, entry);
			if (s->node.sdo.result != SDO_ABORTED)
				return false;
			++*failed;
			continue;
		}
		if (entry->sub == 0)
			mapped = get_number(wire, s->node.sdo.size);
		if (!save_value(out, entry, wire, s->node.sdo.size)) {
			cli_error("%s: the value in the node is not of the type in the EDS", entry->name);
			++*failed;
			continue;
		}
		++*saved;
	}
	return true;
}

static bool write_file(const char *path, const char *text, size_t size)
{
	bool to_stdout = strcmp(path, "-") == 0;
	FILE *file = to_stdout ? stdout : fopen(path, "we");
	bool ok = file && fwrite(text, 1, size, file) == size && fflush(file) == 0;

	if (!ok)
		cli_error("%s: %s", path, strerror(errno));
	if (file && !to_stdout)
		fclose(file);
	return ok;
}

static int command_save(struct session *s, int argc, char **argv)
{
	(void)argc;
	char *text = NULL;
	size_t size = 0;
	int saved = 0, failed = 0;
	FILE *out = open_memstream(&text, &size); /* a file appears only when all was read */

	if (!out) {
		cli_error("out of memory");
		return CLI_FAILED;
	}
	cli_node_open(&s->node, s->bus, (uint8_t)s->node_id, s->timeout_ms);
	fprintf(out,
		"# Configuration of node %ld, read by imu9-sdo save.\n"
		"# For 'imu9-sdo load' and 'imu9-gateway -c'.\n",
		s->node_id);
	bool complete = save_objects(s, out, &saved, &failed);
	fprintf(out, "\n[gateway]\nnode_id = %ld\n", s->node_id);
	fclose(out);
	cli_node_close(&s->node);
	bool written = complete && write_file(argv[0], text, size);
	free(text);
	if (!written)
		return CLI_FAILED;
	if (!s->quiet)
		fprintf(stderr, "imu9-sdo: %d values of node %ld saved%s\n", saved, s->node_id,
			failed ? ", some could not be read" : "");
	return failed ? CLI_FAILED : CLI_OK;
}

/* ---- load: the file ---- */

struct setting {
	const struct od_entry *entry;
	uint8_t wire[OD_VALUE_MAX];
	size_t size;
};

struct settings {
	const struct session *session;
	struct setting list[SETTINGS_MAX];
	size_t count;
	long node_id; /* whose configuration it is; 0: the file does not say */

	FILE *file;
	const char *path;
	int line;
	bool failed;
};

/* inih's reader, counting lines so that messages can name them. */
static char *next_line(char *text, int size, void *stream)
{
	struct settings *settings = stream;

	if (settings->failed || !fgets(text, size, settings->file))
		return NULL;
	settings->line++;
	if (!strchr(text, '\n') && !feof(settings->file)) {
		cli_error("%s:%d: the line is too long", settings->path, settings->line);
		settings->failed = true;
	}
	return text;
}

static bool bad_line(struct settings *settings, const char *what, const char *why)
{
	cli_error("%s:%d: %s: %s", settings->path, settings->line, what, why);
	settings->failed = true;
	return false;
}

static int on_setting(void *user, const char *section, const char *key, const char *text)
{
	struct settings *settings = user;
	struct setting *setting = &settings->list[settings->count];
	char name[256];

	if (settings->failed)
		return false;
	if (strcasecmp(section, "gateway") == 0) { /* of the process; only its node-ID matters here */
		if (strcmp(key, "node_id") == 0 && !cli_integer(text, 1, 127, &settings->node_id))
			return bad_line(settings, text, "not a node-ID from 1 to 127");
		return true;
	}
	snprintf(name, sizeof(name), "%s%s%s", section, section[0] ? "." : "", key);
	setting->entry = od_find_name(settings->session->table, name);
	if (!setting->entry)
		return bad_line(settings, name, "the EDS has no object of this name");
	if (!is_configuration(setting->entry))
		return bad_line(settings, name, "not a configuration object");
	if (settings->count == SETTINGS_MAX - 1)
		return bad_line(settings, name, "too many values in one file");
	enum od_status status = od_parse(setting->entry, text, setting->wire, sizeof(setting->wire), &setting->size);
	if (status != OD_OK)
		return bad_line(settings, name, od_status_text(status));
	settings->count++;
	return true;
}

static bool read_settings(struct settings *settings, const char *path)
{
	settings->path = path;
	settings->file = strcmp(path, "-") == 0 ? stdin : fopen(path, "re");
	if (!settings->file) {
		cli_error("%s: %s", path, strerror(errno));
		return false;
	}
	int line = ini_parse_stream(next_line, settings, on_setting, settings);
	if (line > 0 && !settings->failed) {
		settings->line = line;
		bad_line(settings, "syntax", "write NAME = VALUE");
	}
	if (settings->file != stdin)
		fclose(settings->file);
	return !settings->failed;
}

/* COB-IDs at their default for the node that the file is of become those of this node. */
static void move_to_node(struct settings *settings, long node_id)
{
	const struct od_table *table = settings->session->table;

	if (settings->node_id == 0 || settings->node_id == node_id)
		return;
	for (size_t i = 0; i < settings->count; i++) {
		struct setting *setting = &settings->list[i];
		uint32_t base;

		if (!(setting->entry->access & OD_NODE_ID) || setting->size != 4)
			continue;
		memcpy(&base, (const char *)table->defaults + setting->entry->offset, 4);
		if (get_number(setting->wire, 4) == (uint32_t)(base + settings->node_id))
			put_u32(setting->wire, (uint32_t)(base + node_id));
	}
}

static const struct setting *find_setting(const struct settings *settings, unsigned int index, unsigned int sub)
{
	for (size_t i = settings->count; i-- > 0;) /* the last one holds */
		if (settings->list[i].entry->index == index && settings->list[i].entry->sub == sub)
			return &settings->list[i];
	return NULL;
}

static bool has_settings(const struct settings *settings, uint16_t index)
{
	for (size_t i = 0; i < settings->count; i++)
		if (settings->list[i].entry->index == index)
			return true;
	return false;
}

/* ---- load: to the node ---- */

struct load {
	struct session *session;
	const struct settings *settings;
	int written, same, failed;
	bool lost; /* the node does not answer any more */
};

static bool load_failed(struct load *load, const struct od_entry *entry)
{
	cli_node_explain(&load->session->node, entry);
	load->failed++;
	load->lost = load->session->node.sdo.result != SDO_ABORTED;
	return false;
}

static bool load_write(struct load *load, const struct od_entry *entry, const void *wire, size_t size)
{
	if (load->lost)
		return false;
	return cli_node_write(&load->session->node, entry->index, entry->sub, wire, size) || load_failed(load, entry);
}

static bool load_read_u32(struct load *load, const struct od_entry *entry, uint32_t *value)
{
	uint8_t wire[OD_VALUE_MAX];

	if (load->lost)
		return false;
	if (!cli_node_read(&load->session->node, entry->index, entry->sub, wire, sizeof(wire)))
		return load_failed(load, entry);
	*value = (uint32_t)get_number(wire, load->session->node.sdo.size);
	return true;
}

/* True when the node has this value already. */
static bool is_same(struct load *load, const struct setting *setting)
{
	uint8_t wire[OD_VALUE_MAX];
	struct cli_node *node = &load->session->node;

	if (load->lost)
		return false;
	if (cli_node_read(node, setting->entry->index, setting->entry->sub, wire, sizeof(wire)))
		return node->sdo.size == setting->size && memcmp(wire, setting->wire, setting->size) == 0;
	return node->sdo.result != SDO_ABORTED && load_failed(load, setting->entry);
}

static bool write_cob_id(struct load *load, const struct od_entry *entry, uint32_t cob_id)
{
	uint8_t wire[4];

	put_u32(wire, cob_id);
	return load_write(load, entry, wire, sizeof(wire));
}

/* CiA 301, 7.5.2.17: the CAN-ID of an EMCY that exists must not change, so it is switched off first. */
static bool write_emcy(struct load *load, const struct setting *setting)
{
	uint32_t old;

	if (!load_read_u32(load, setting->entry, &old) || !write_cob_id(load, setting->entry, old | COB_ID_INVALID))
		return false;
	if (load_write(load, setting->entry, setting->wire, setting->size))
		return true;
	write_cob_id(load, setting->entry, old);
	return false;
}

static void load_plain(struct load *load, const struct setting *setting)
{
	if (is_same(load, setting))
		load->same++;
	else if (setting->entry->index == 0x1014)
		load->written += write_emcy(load, setting);
	else
		load->written += load_write(load, setting->entry, setting->wire, setting->size);
}

static bool write_mapped_count(struct load *load, const struct od_entry *entry, uint32_t count)
{
	const uint8_t wire = (uint8_t)count;

	return load_write(load, entry, &wire, 1);
}

static bool write_mapping(struct load *load, uint16_t index)
{
	const struct od_entry *entry = od_find(load->session->table, index, 0, NULL);
	const struct setting *setting = find_setting(load->settings, index, 0);
	uint32_t count;

	if (!has_settings(load->settings, index))
		return true;
	if (!entry || !load_read_u32(load, entry, &count))
		return false;
	if (setting)
		count = setting->wire[0];
	if (!write_mapped_count(load, entry, 0))
		return false;
	for (unsigned int sub = 1; sub <= count; sub++) {
		setting = find_setting(load->settings, index, sub);
		if (setting && !load_write(load, setting->entry, setting->wire, setting->size))
			return false;
	}
	return write_mapped_count(load, entry, count);
}

static bool write_transmission(struct load *load, unsigned int index)
{
	for (unsigned int sub = 2; sub <= 6; sub++) {
		const struct setting *setting = find_setting(load->settings, index, sub);

		if (setting && !load_write(load, setting->entry, setting->wire, setting->size))
			return false;
	}
	return true;
}

/* The mapping procedure (CiA 301, 7.5.2.36): switch the PDO off, map, and switch it on again.
 * `index`: 1800h.. */
static void load_pdo(struct load *load, uint16_t index)
{
	const struct od_entry *entry = od_find(load->session->table, index, 1, NULL);
	const struct setting *cob_id = find_setting(load->settings, index, 1);
	int settings = 0, same = 0;
	uint32_t old;

	for (size_t i = 0; i < load->settings->count; i++) {
		const struct setting *setting = &load->settings->list[i];

		if ((setting->entry->index & ~0x200) == index) {
			settings++;
			same += is_same(load, setting);
		}
	}
	if (settings == same) {
		load->same += same;
		return;
	}
	if (!entry || !load_read_u32(load, entry, &old))
		return;
	if (!write_cob_id(load, entry, old | COB_ID_INVALID))
		return;
	if (!write_mapping(load, (uint16_t)(index | 0x200)) || !write_transmission(load, index)) {
		cli_error("the PDO at %04Xh is left switched off", index);
		return;
	}
	if (write_cob_id(load, entry, cob_id ? (uint32_t)get_number(cob_id->wire, 4) : old))
		load->written += settings;
}

static void load_all(struct load *load)
{
	uint16_t index = 0;

	for (size_t i = 0; i < load->session->table->count && !load->lost; i++) {
		const struct od_entry *entry = &load->session->table->entries[i];
		const struct setting *setting = find_setting(load->settings, entry->index, entry->sub);

		if (!is_pdo_parameter(entry->index)) {
			if (setting)
				load_plain(load, setting);
		} else if (!is_mapping(entry->index) && entry->index != index) {
			index = entry->index;
			load_pdo(load, index);
		}
	}
}

static int command_load(struct session *s, int argc, char **argv)
{
	(void)argc;
	static struct settings settings;
	struct load load = {.session = s, .settings = &settings};

	settings.session = s;
	if (!read_settings(&settings, argv[0]))
		return CLI_FAILED;
	move_to_node(&settings, s->node_id);
	cli_node_open(&s->node, s->bus, (uint8_t)s->node_id, s->timeout_ms);
	load_all(&load);
	cli_node_close(&s->node);
	if (!s->quiet)
		fprintf(stderr, "imu9-sdo: node %ld: %d values written, %d were so already, %d failed%s\n", s->node_id,
			load.written, load.same, load.failed, load.written ? "; 'imu9-sdo store' keeps them" : "");
	return load.failed ? CLI_FAILED : CLI_OK;
}

/* ---- store, restore, nmt ---- */

static int write_signature(struct session *s, uint16_t index, const char *signature, const char *group)
{
	static const char *const groups[] = {"all", "communication", "application", "manufacturer"};
	unsigned int timeout_ms = s->timeout_ms < STORE_TIMEOUT_MS ? STORE_TIMEOUT_MS : s->timeout_ms;
	uint8_t sub = 0;

	for (uint8_t i = 0; i < 4; i++)
		if (strcmp(groups[i], group) == 0)
			sub = (uint8_t)(i + 1);
	if (sub == 0)
		cli_usage_error("%s: not a group; use all, communication, application or manufacturer", group);
	cli_node_open(&s->node, s->bus, (uint8_t)s->node_id, timeout_ms);
	bool done = cli_node_write(&s->node, index, sub, signature, 4);
	if (!done)
		cli_node_explain(&s->node, od_find(s->table, index, sub, NULL));
	cli_node_close(&s->node);
	return done ? CLI_OK : CLI_FAILED;
}

static int command_store(struct session *s, int argc, char **argv)
{
	return write_signature(s, 0x1010, "save", argc ? argv[0] : "all");
}

static int command_restore(struct session *s, int argc, char **argv)
{
	int exit_code = write_signature(s, 0x1011, "load", argc ? argv[0] : "all");

	if (exit_code == CLI_OK && !s->quiet)
		fprintf(stderr, "imu9-sdo: the defaults hold after the next reset: imu9-sdo nmt reset\n");
	return exit_code;
}

static int command_nmt(struct session *s, int argc, char **argv)
{
	(void)argc;
	static const struct {
		const char *name;
		uint8_t command;
	} commands[] = {{"start", 1}, {"stop", 2}, {"preop", 0x80}, {"reset", 0x81}, {"reset-comm", 0x82}};
	struct can_msg msg = {.len = 2, .data = {0, (uint8_t)s->node_id}};

	for (size_t i = 0; i < sizeof(commands) / sizeof(commands[0]); i++)
		if (strcmp(commands[i].name, argv[0]) == 0)
			msg.data[0] = commands[i].command;
	if (msg.data[0] == 0)
		cli_usage_error("nmt %s: use start, stop, preop, reset or reset-comm", argv[0]);
	struct can_port *bus = cli_open_bus(s->bus);
	int rc = can_send(bus, &msg, cli_now_us());
	if (rc == 0)
		rc = cli_flush(bus);
	can_close(bus);
	if (rc < 0)
		cli_error("cannot send on %s: %s: is the bus up, and is another node on it?", s->bus, strerror(-rc));
	return rc < 0 ? CLI_FAILED : CLI_OK;
}

/* ---- the command line ---- */

static const struct command {
	const char *name;
	int (*run)(struct session *s, int argc, char **argv);
	int args_min, args_max;
	const char *args;
} commands[] = {
	{"read", command_read, 1, TARGETS_MAX, "OBJECT..."},
	{"write", command_write, 2, 2, "OBJECT VALUE"},
	{"dump", command_dump, 0, 0, "(no arguments)"},
	{"save", command_save, 1, 1, "FILE"},
	{"load", command_load, 1, 1, "FILE"},
	{"store", command_store, 0, 1, "[all|communication|application|manufacturer]"},
	{"restore", command_restore, 0, 1, "[all|communication|application|manufacturer]"},
	{"nmt", command_nmt, 1, 1, "start|stop|preop|reset|reset-comm"},
};

static const struct command *find_command(const char *name)
{
	for (size_t i = 0; i < sizeof(commands) / sizeof(commands[0]); i++)
		if (strcmp(commands[i].name, name) == 0)
			return &commands[i];
	cli_usage_error("unknown command '%s'", name);
}

static void parse_options(struct session *s, int argc, char **argv)
{
	static const struct option options[] = {
		{"bus", required_argument, NULL, 'i'},
		{"node", required_argument, NULL, 'n'},
		{"eds", required_argument, NULL, 'e'},
		{"timeout", required_argument, NULL, 't'},
		{"quiet", no_argument, NULL, 'q'},
		{"help", no_argument, NULL, 'h'},
		{"version", no_argument, NULL, 'V'},
		{0},
	};
	int option;

	opterr = 0;
	/* '+': options end at the command, so that "write OBJECT -1" is a value */
	while ((option = getopt_long(argc, argv, "+:i:n:e:t:qhV", options, NULL)) != -1) {
		switch (option) {
		case 'i':
			s->bus = optarg;
			break;
		case 'n':
			s->node_id = cli_integer_option("-n", optarg, 0, 127);
			break;
		case 'e':
			s->eds_path = optarg;
			break;
		case 't':
			s->timeout_ms = (unsigned int)cli_integer_option("-t", optarg, 1, 3600000);
			break;
		case 'q':
			s->quiet = true;
			break;
		case 'h':
			fputs(help, stdout);
			exit(CLI_OK);
		case 'V':
			puts("imu9-sdo " IMU9_VERSION);
			exit(CLI_OK);
		default:
			cli_bad_option(option, argv);
		}
	}
}

int main(int argc, char **argv)
{
	struct session s = {.bus = cli_default_bus(), .node_id = -1, .timeout_ms = 500};
	struct eds eds;
	char error[512];

	parse_options(&s, argc, argv);
	if (s.node_id < 0)
		s.node_id = cli_default_node();
	argc -= optind;
	argv += optind;
	if (argc == 0)
		cli_usage_error("what shall be done? Commands: read, write, dump, save, load, store, "
				"restore, nmt");
	const struct command *command = find_command(argv[0]);
	if (argc - 1 < command->args_min || argc - 1 > command->args_max)
		cli_usage_error("usage: imu9-sdo %s %s", command->name, command->args);
	if (s.node_id == 0 && command->run != command_nmt)
		cli_usage_error("-n 0 (all nodes) is for nmt only: give a node-ID from 1 to 127");

	s.table = &imu9_od_table;
	if (s.eds_path) {
		if (eds_load(&eds, s.eds_path, EDS_LENIENT, error, sizeof(error)) < 0) {
			cli_error("%s", error);
			return CLI_FAILED;
		}
		s.table = &eds.table;
	}
	int exit_code = command->run(&s, argc - 1, argv + 1);
	if (s.eds_path)
		eds_free(&eds);
	if (fflush(stdout) != 0 || ferror(stdout)) {
		cli_error("standard output: %s", strerror(errno));
		return CLI_FAILED;
	}
	return exit_code;
}
