/* imu9-sdo read, write, dump, objects, log. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tools/lib/cli_value.h"
#include "tools/sdo/sdo_json.h"
#include "tools/sdo/sdo_session.h"

/* ---- read, log --------------------------------------------------------------------------------------------------- */

static void print_value(struct session *s, const struct target *target, const uint8_t *wire)
{
	char text[CLI_VALUE_TEXT_MAX], name[128];

	sdo_value_text(s, target, wire, s->node.sdo.size, text, sizeof(text));
	if (s->quiet) {
		puts(text);
		return;
	}
	sdo_target_name(target, name, sizeof(name));
	printf("%s = %s\n", name, text);
}

static bool is_domain(const struct target *target)
{
	return target->entry && target->entry->type == OD_DOMAIN;
}

/* --block, --no-block: override the choice of block transfer. */
static void extract_block_options(struct session *s, int *argc, char **argv)
{
	bool always = sdo_extract_flag(argc, argv, "--block"), never = sdo_extract_flag(argc, argv, "--no-block");

	if (always && never)
		cli_usage_error("--block and --no-block exclude each other");
	s->node.blocks = always ? CLI_BLOCKS_ALWAYS : never ? CLI_BLOCKS_NEVER : CLI_BLOCKS_LARGE;
}

static void open_with_blocks(struct session *s)
{
	enum cli_blocks blocks = s->node.blocks;

	sdo_open(s);
	s->node.blocks = blocks;
}

/* The result of the last transfer. */
static void add_object(
	struct json_object *values, struct session *s, const struct target *target, const uint8_t *wire, bool done)
{
	struct json_object *object = sdo_json_object(s, target, wire, s->node.sdo.size, done);

	if (!done)
		sdo_json_add_error(object, &s->node);
	json_object_array_add(values, object);
}

/* `values`: the array of --json, or NULL. */
static bool print_object(struct session *s, const struct target *t, const char *file, struct json_object *values)
{
	static uint8_t wire[SDO_DOMAIN_MAX];
	bool as_bytes = is_domain(t) || file;
	bool large = as_bytes || s->node.blocks == CLI_BLOCKS_ALWAYS;
	bool done = large ? cli_node_read_large(&s->node, t->index, t->sub, wire, sizeof(wire))
			  : cli_node_read(&s->node, t->index, t->sub, wire, sizeof(wire));

	if (values)
		add_object(values, s, t, wire, done);
	if (!done) {
		cli_node_explain(&s->node, t->entry);
		return false;
	}
	if (values)
		return true;
	if (as_bytes)
		return sdo_write_file(file ? file : "-", wire, s->node.sdo.size);
	print_value(s, t, wire);
	return true;
}

int sdo_command_read(struct session *s, int argc, char **argv)
{
	static struct target targets[SDO_TARGETS_MAX];
	const char *file = sdo_extract_value(&argc, argv, "-o");
	size_t n = 0;
	int exit_code = CLI_OK;

	extract_block_options(s, &argc, argv);
	for (int i = 0; i < argc; i++)
		n += sdo_targets(s, argv[i], &targets[n], SDO_TARGETS_MAX - n);
	if (n == 0 || (file && n > 1))
		cli_usage_error("usage: imu9-sdo read OBJECT... (one with -o FILE)");
	for (size_t i = 0; s->json && i < n; i++)
		if (file || is_domain(&targets[i]))
			cli_usage_error("--json is for values: read a DOMAIN, and with -o FILE, without it");
	open_with_blocks(s);
	struct json_object *document = s->json ? sdo_json_new(s) : NULL;
	struct json_object *values = document ? sdo_json_array(document, "values") : NULL;
	for (size_t i = 0; i < n; i++) {
		if (print_object(s, &targets[i], file, values))
			continue;
		exit_code = CLI_FAILED;
		if (s->node.sdo.result != SDO_ABORTED && s->node.sdo.result != SDO_DONE)
			break;
	}
	sdo_close(s);
	if (document)
		sdo_json_print(document, false);
	return exit_code;
}

/* Lines of 2131h: seconds since the start, a blank, the text. */
static void print_events(const struct session *s, char *text)
{
	struct json_object *document = sdo_json_new(s), *events = sdo_json_array(document, "events");

	for (char *rest = NULL, *line = strtok_r(text, "\n", &rest); line; line = strtok_r(NULL, "\n", &rest)) {
		struct json_object *event = json_object_new_object();
		char *words = line;
		double t_s = strtod(line, &words);

		json_object_object_add(event, "t", json_object_new_double(t_s));
		json_object_object_add(event, "text", json_object_new_string(words + (*words == ' ')));
		json_object_array_add(events, event);
	}
	sdo_json_print(document, false);
}

int sdo_command_log(struct session *s, int argc, char **argv)
{
	static char text[OD_DOMAIN_MAX + 1];
	struct target log;

	(void)argc, (void)argv;
	sdo_targets(s, "0x2131", &log, 1);
	sdo_open(s);
	bool done = s->json ? cli_node_read_large(&s->node, log.index, log.sub, text, sizeof(text) - 1)
			    : print_object(s, &log, "-", NULL);
	if (s->json && done)
		print_events(s, text);
	else if (s->json)
		cli_node_explain(&s->node, log.entry);
	sdo_close(s);
	return done ? CLI_OK : CLI_FAILED;
}

/* ---- write ------------------------------------------------------------------------------------------------------- */

static void parse_value(const struct target *target, const char *text, uint8_t *wire, size_t capacity, size_t *size)
{
	const struct od_entry *entry = target->entry;
	enum od_status status = OD_BAD_VALUE;
	char limits[256] = "";

	/* an explicit type is for objects that are not in the EDS, and to test a wrong type */
	if (!entry || entry->type != OD_VISIBLE_STRING)
		status = cli_typed_value(text, wire, capacity, size);
	if (status == OD_OK)
		return;
	if (!entry)
		cli_usage_error("%s: this object is not in the EDS: give the value with its type, "
				"for example u16:5, r32:0.5 or hex:0102",
			text);
	status = od_parse(entry, text, wire, capacity, size);
	if (status == OD_OK)
		return;
	od_limits_text(entry, limits, sizeof(limits));
	if (od_has_words(entry))
		snprintf(limits, sizeof(limits), "%s", entry->words);
	cli_usage_error(
		"%s = %s: %s%s%s", entry->name, text, od_status_text(status), limits[0] ? "; allowed: " : "", limits);
}

static int write_file_to(struct session *s, const struct target *target, const char *path)
{
	size_t size;
	uint8_t *data = sdo_read_file(path, &size);

	if (!data)
		return CLI_FAILED;
	open_with_blocks(s);
	bool done = cli_node_write_large(&s->node, target->index, target->sub, data, size);
	if (!done)
		cli_node_explain(&s->node, target->entry);
	sdo_close(s);
	free(data);
	return done ? CLI_OK : CLI_FAILED;
}

/* A value is that of one object. */
static struct target find_single(const struct session *s, const char *name)
{
	static struct target targets[SDO_TARGETS_MAX];
	size_t n = sdo_targets(s, name, targets, SDO_TARGETS_MAX), used = 0;
	char members[1024] = "";

	for (size_t i = 0; i < n && used < sizeof(members); i++)
		used += (size_t)snprintf(members + used, sizeof(members) - used, "%s%s", i ? ", " : "",
			targets[i].entry ? targets[i].entry->name : "");
	if (n > 1)
		cli_usage_error("%s is a record: write its members one by one: %s", name, members);
	return targets[0];
}

int sdo_command_write(struct session *s, int argc, char **argv)
{
	uint8_t wire[OD_VALUE_MAX];
	size_t size;

	extract_block_options(s, &argc, argv);
	if (argc != 2)
		cli_usage_error("usage: imu9-sdo write OBJECT VALUE (a DOMAIN: FILE)");
	struct target target = find_single(s, argv[0]);
	bool named = strncmp(argv[1], "file:", 5) == 0 && (!target.entry || target.entry->type != OD_VISIBLE_STRING);
	if (named || is_domain(&target))
		return write_file_to(s, &target, argv[1] + (named ? 5 : 0));
	parse_value(&target, argv[1], wire, sizeof(wire), &size);
	open_with_blocks(s);
	bool done = s->node.blocks == CLI_BLOCKS_ALWAYS
			    ? cli_node_write_large(&s->node, target.index, target.sub, wire, size)
			    : cli_node_write(&s->node, target.index, target.sub, wire, size);
	if (!done)
		cli_node_explain(&s->node, target.entry);
	sdo_close(s);
	return done ? CLI_OK : CLI_FAILED;
}

/* ---- dump -------------------------------------------------------------------------------------------------------- */

static bool is_highest_subindex(const struct od_entry *entry)
{
	return entry->sub == 0 && (entry->access & OD_CONST) && entry->type == OD_UNSIGNED8 && strchr(entry->name, '.');
}

static void print_entry(const struct od_entry *entry)
{
	printf("%04Xh:%02X  %-44s %-8s %s\n", entry->index, entry->sub, entry->name, entry->unit, entry->description);
}

/* One object, and the words of its values or bits; with -q only these. */
static void print_words(const struct session *s, const struct od_entry *entry)
{
	struct od_word word = {0};

	if (!s->quiet)
		print_entry(entry);
	while (od_next_word(entry, &word)) {
		if (s->quiet)
			printf("%.*s\n", (int)word.length, word.text);
		else
			printf("  %s%-3u %.*s\n", entry->words_of_bits ? "bit " : "", word.number, (int)word.length,
				word.text);
	}
}

int sdo_command_objects(struct session *s, int argc, char **argv)
{
	static struct target targets[SDO_TARGETS_MAX];
	size_t n = argc > 0 ? sdo_targets(s, argv[0], targets, SDO_TARGETS_MAX) : 0;

	if (n == 1 && targets[0].entry) {
		print_words(s, targets[0].entry);
		return CLI_OK;
	}
	for (size_t i = 0; i < s->table->count; i++) {
		const struct od_entry *entry = &s->table->entries[i];

		if (n > 0 && (entry->index != targets[0].index || entry->sub == 0))
			continue;
		if (is_highest_subindex(entry))
			continue;
		if (s->quiet)
			puts(entry->name);
		else
			print_entry(entry);
	}
	return CLI_OK;
}

/* One object. False: the node does not answer. DOMAINs are not in `values`, the array of --json. */
static bool dump_entry(struct session *s, const struct od_entry *entry, struct json_object *values, int *failed)
{
	const struct target target = {entry->index, entry->sub, entry};
	uint8_t wire[SDO_STRING_MAX];
	char text[CLI_VALUE_TEXT_MAX];
	bool domain = entry->type == OD_DOMAIN;
	bool done = !domain && cli_node_read(&s->node, entry->index, entry->sub, wire, sizeof(wire));

	if (!done && !domain) {
		if (s->node.sdo.result != SDO_ABORTED)
			return false;
		*failed += s->node.sdo.abort_code != SDO_ABORT_NO_DATA;
	}
	if (values && !domain)
		add_object(values, s, &target, wire, done);
	if (values)
		return true;
	if (domain)
		snprintf(text, sizeof(text), "(a file: imu9-sdo read %s -o FILE)", entry->name);
	else if (done)
		sdo_value_text(s, &target, wire, s->node.sdo.size, text, sizeof(text));
	else
		snprintf(text, sizeof(text), "(%s, abort %08Xh)", sdo_abort_text(s->node.sdo.abort_code),
			s->node.sdo.abort_code);
	printf("%04Xh:%02X  %-44s = %s\n", entry->index, entry->sub, entry->name, text);
	return true;
}

int sdo_command_dump(struct session *s, int argc, char **argv)
{
	struct json_object *document = s->json ? sdo_json_new(s) : NULL;
	struct json_object *values = document ? sdo_json_array(document, "values") : NULL;
	bool answers = true;
	int failed = 0;

	(void)argc, (void)argv;
	sdo_open(s);
	for (size_t i = 0; answers && i < s->table->count; i++) {
		const struct od_entry *entry = &s->table->entries[i];

		if ((entry->access & OD_READ) && !is_highest_subindex(entry) &&
			!dump_entry(s, entry, values, &failed)) {
			cli_node_explain(&s->node, entry);
			answers = false;
		}
	}
	sdo_close(s);
	if (document)
		sdo_json_print(document, false);
	if (failed)
		cli_error("%d objects of the EDS could not be read: is this the EDS of this node?", failed);
	return failed || !answers ? CLI_FAILED : CLI_OK;
}
