/* imu9-sdo store, restore, nmt. */
#include <stdio.h>
#include <string.h>

#include "tools/sdo/sdo_session.h"
#include "od_index.h"

enum { STORE_TIMEOUT_MS = 5000 }; /* storing waits for the disk */

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
	sdo_close(s);
	return done ? CLI_OK : CLI_FAILED;
}

int sdo_command_store(struct session *s, int argc, char **argv)
{
	return write_signature(s, OD_INDEX_STORE_PARAMETERS, "save", argc ? argv[0] : "all");
}

int sdo_command_restore(struct session *s, int argc, char **argv)
{
	int exit_code = write_signature(s, OD_INDEX_RESTORE_DEFAULTS, "load", argc ? argv[0] : "all");

	if (exit_code == CLI_OK && !s->quiet)
		fprintf(stderr, "imu9-sdo: the defaults apply after the next reset: imu9-sdo nmt reset\n");
	return exit_code;
}

int sdo_command_nmt(struct session *s, int argc, char **argv)
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
	bool sent = sdo_send_frame(s, bus, &msg);
	can_close(bus);
	return sent ? CLI_OK : CLI_FAILED;
}
