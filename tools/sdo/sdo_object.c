/* imu9-sdo read, write, dump, log, watch. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tools/lib/cli_value.h"
#include "tools/sdo/sdo_session.h"

enum { STRING_MAX = 1024 }; /* longest string of other devices */

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

static bool print_object(struct session *s, const struct target *t, const char *file)
{
	static uint8_t wire[SDO_DOMAIN_MAX];
	bool as_bytes = is_domain(t) || file;
	bool large = as_bytes || s->node.blocks == CLI_BLOCKS_ALWAYS;
	bool done = large ? cli_node_read_large(&s->node, t->index, t->sub, wire, sizeof(wire))
			  : cli_node_read(&s->node, t->index, t->sub, wire, sizeof(wire));

	if (!done) {
		cli_node_explain(&s->node, t->entry);
		return false;
	}
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
	open_with_blocks(s);
	for (size_t i = 0; i < n; i++) {
		if (print_object(s, &targets[i], file))
			continue;
		exit_code = CLI_FAILED;
		if (s->node.sdo.result != SDO_ABORTED && s->node.sdo.result != SDO_DONE)
			break;
	}
	sdo_close(s);
	return exit_code;
}

int sdo_command_log(struct session *s, int argc, char **argv)
{
	struct target log;

	(void)argc, (void)argv;
	sdo_targets(s, "0x2131", &log, 1);
	sdo_open(s);
	bool done = print_object(s, &log, "-");
	sdo_close(s);
	return done ? CLI_OK : CLI_FAILED;
}

/* ---- write ------------------------------------------------------------------------------------------------------- */

static void parse_value(const struct target *target, const char *text, uint8_t *wire, size_t capacity, size_t *size)
{
	const struct od_entry *entry = target->entry;
	enum od_status status = OD_BAD_VALUE;
	char limits[128] = "";

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

int sdo_command_write(struct session *s, int argc, char **argv)
{
	struct target target;
	uint8_t wire[OD_VALUE_MAX];
	size_t size;

	extract_block_options(s, &argc, argv);
	if (argc != 2 || sdo_targets(s, argv[0], &target, 1) != 1)
		cli_usage_error("usage: imu9-sdo write OBJECT VALUE (a DOMAIN: FILE)");
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

int sdo_command_objects(struct session *s, int argc, char **argv)
{
	(void)argc, (void)argv;
	for (size_t i = 0; i < s->table->count; i++) {
		const struct od_entry *entry = &s->table->entries[i];

		if (is_highest_subindex(entry))
			continue;
		if (s->quiet)
			puts(entry->name);
		else
			printf("%04Xh:%02X  %-44s %-8s %s\n", entry->index, entry->sub, entry->name, entry->unit,
				entry->description);
	}
	return CLI_OK;
}

int sdo_command_dump(struct session *s, int argc, char **argv)
{
	(void)argc, (void)argv;
	uint8_t wire[STRING_MAX];
	char text[CLI_VALUE_TEXT_MAX];
	int failed = 0;

	sdo_open(s);
	for (size_t i = 0; i < s->table->count; i++) {
		const struct od_entry *entry = &s->table->entries[i];
		const struct target target = {entry->index, entry->sub, entry};

		if (!(entry->access & OD_READ) || is_highest_subindex(entry))
			continue;
		if (entry->type == OD_DOMAIN) {
			snprintf(text, sizeof(text), "(a file: imu9-sdo read %s -o FILE)", entry->name);
		} else if (cli_node_read(&s->node, entry->index, entry->sub, wire, sizeof(wire))) {
			sdo_value_text(s, &target, wire, s->node.sdo.size, text, sizeof(text));
		} else if (s->node.sdo.result == SDO_ABORTED) {
			failed += s->node.sdo.abort_code != SDO_ABORT_NO_DATA;
			snprintf(text, sizeof(text), "(%s, abort %08Xh)", sdo_abort_text(s->node.sdo.abort_code),
				s->node.sdo.abort_code);
		} else {
			cli_node_explain(&s->node, entry);
			sdo_close(s);
			return CLI_FAILED;
		}
		printf("%04Xh:%02X  %-44s = %s\n", entry->index, entry->sub, entry->name, text);
	}
	sdo_close(s);
	if (failed)
		cli_error("%d objects of the EDS could not be read: is this the EDS of this node?", failed);
	return failed ? CLI_FAILED : CLI_OK;
}

/* ---- watch ------------------------------------------------------------------------------------------------------- */

static bool print_line(struct session *s, const struct target *targets, size_t n, double t_s)
{
	char text[CLI_VALUE_TEXT_MAX], name[128];
	uint8_t wire[STRING_MAX];

	for (size_t i = 0; i < n; i++) {
		if (!cli_node_read(&s->node, targets[i].index, targets[i].sub, wire, sizeof(wire))) {
			cli_node_explain(&s->node, targets[i].entry);
			return false;
		}
		if (i == 0 && !s->quiet)
			printf("%10.3f s", t_s);
		sdo_value_text(s, &targets[i], wire, s->node.sdo.size, text, sizeof(text));
		sdo_target_name(&targets[i], name, sizeof(name));
		if (s->quiet)
			printf("%s%s", i ? " " : "", text);
		else
			printf("  %s = %s", name, text);
	}
	putchar('\n');
	return fflush(stdout) == 0;
}

/* True: a signal arrived before that time. */
static bool wait_until(struct session *s, int signals, uint64_t until_us)
{
	struct can_msg msg;

	while (cli_now_us() < until_us) {
		if (cli_wait(s->node.bus, signals, until_us))
			return true;
		while (can_receive(s->node.bus, &msg, cli_now_us()) > 0)
			; /* late answers */
	}
	return false;
}

int sdo_command_watch(struct session *s, int argc, char **argv)
{
	static struct target targets[SDO_TARGETS_MAX];
	const char *rate_text = sdo_extract_value(&argc, argv, "--rate");
	const char *count_text = sdo_extract_value(&argc, argv, "--count");
	double rate_hz = rate_text ? cli_real_option("--rate", rate_text, 0.01, 1000) : 2;
	long left = count_text ? cli_integer_option("--count", count_text, 1, 1000000000) : -1;
	size_t n = 0;
	bool ok = true;

	for (int i = 0; i < argc; i++)
		n += sdo_targets(s, argv[i], &targets[n], SDO_TARGETS_MAX - n);
	if (n == 0)
		cli_usage_error("usage: imu9-sdo watch OBJECT... [--rate HZ] [--count N]");
	int signals = cli_signal_fd();
	sdo_open(s);
	uint64_t start_us = cli_now_us(), next_us = start_us;
	while (ok && left != 0 && !wait_until(s, signals, next_us)) {
		ok = print_line(s, targets, n, (double)(cli_now_us() - start_us) / 1e6);
		next_us += (uint64_t)(1e6 / rate_hz);
		left -= left > 0;
	}
	sdo_close(s);
	return ok ? CLI_OK : CLI_FAILED;
}
