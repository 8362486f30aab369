/* imu9-sdo scan: the nodes on the bus. Requests the device type from each node-ID and listens for heartbeats. */
#include <stdio.h>
#include <string.h>

#include "gateway/canopen/cia301.h"
#include "tools/sdo/sdo_json.h"
#include "tools/sdo/sdo_session.h"
#include "od_index.h"

enum { NODES = 128, LISTEN_MS = 1100, STATE_UNKNOWN = 0xFF };

enum { IDENTITY_NUMBERS = 4 };

struct seen {
	uint32_t type;			     /* 1000h; 0: not read */
	uint32_t identity[IDENTITY_NUMBERS]; /* 1018h; 0: not read */
	bool answers;
	uint8_t state; /* in its heartbeat */
	char name[65]; /* 1008h */
};

static void on_frame(struct seen nodes[NODES], const struct can_msg *msg)
{
	uint32_t function = msg->id & 0x780, id = msg->id & 0x7F;

	if (msg->extended || msg->remote || id == 0)
		return;
	if (function == CAN_ID_SDO_RESPONSE && msg->len == 8)
		nodes[id].answers = true;
	if (function == CAN_ID_ERROR_CONTROL && msg->len == 1)
		nodes[id].state = msg->data[0] & 0x7F;
}

static void listen(struct can_port *bus, struct seen nodes[NODES], uint64_t until_us)
{
	struct can_msg msg;

	do {
		cli_wait(bus, -1, until_us);
		while (can_receive(bus, &msg, cli_now_us()) > 0)
			on_frame(nodes, &msg);
	} while (cli_now_us() < until_us);
}

static bool request_all(struct session *s, struct can_port *bus, struct seen nodes[NODES])
{
	for (uint32_t id = 1; id < NODES; id++) {
		const struct can_msg msg = {.id = CAN_ID_SDO_REQUEST + id, .len = 8, .data = {0x40, 0x00, 0x10}};

		if (!sdo_send_frame(s, bus, &msg))
			return false;
		listen(bus, nodes, cli_now_us() + 1000);
	}
	return true;
}

/* Whether the requests could be sent. */
static bool look(struct session *s, struct can_port *bus, struct seen nodes[NODES])
{
	uint64_t until_us = cli_now_us() + (s->timeout_given ? s->timeout_ms : LISTEN_MS) * 1000ull;

	for (int id = 0; id < NODES; id++)
		nodes[id] = (struct seen){.state = STATE_UNKNOWN};
	if (!request_all(s, bus, nodes))
		return false;
	listen(bus, nodes, until_us);
	return true;
}

int sdo_find_nodes(struct session *s, uint8_t *first)
{
	struct can_port *bus = cli_open_bus(s->bus);
	struct seen nodes[NODES];
	int found = look(s, bus, nodes) ? 0 : -1;

	for (uint8_t id = 1; found >= 0 && id < NODES; id++)
		if (nodes[id].answers && found++ == 0)
			*first = id;
	can_close(bus);
	return found;
}

static const char *state_text(uint8_t state)
{
	switch (state) {
	case 0x00:
		return "boot-up";
	case 0x04:
		return "stopped";
	case 0x05:
		return "operational";
	case 0x7F:
		return "pre-operational";
	default:
		return "no heartbeat";
	}
}

/* 0: the node does not have it. */
static uint32_t read_number(struct cli_node *node, uint16_t index, uint8_t sub)
{
	uint8_t wire[4];

	if (!cli_node_read(node, index, sub, wire, sizeof(wire)) || node->sdo.size != 4)
		return 0;
	return (uint32_t)sdo_number(wire, 4);
}

static void read_node(struct session *s, struct can_port *bus, uint8_t id, struct seen *seen)
{
	static const struct od_entry TEXT = {.type = OD_VISIBLE_STRING};
	struct cli_node node;
	uint8_t wire[64];

	cli_node_use(&node, bus, s->bus, id, s->timeout_ms);
	seen->type = read_number(&node, OD_INDEX_DEVICE_TYPE, 0);
	for (uint8_t i = 0; i < IDENTITY_NUMBERS; i++)
		seen->identity[i] = read_number(&node, OD_INDEX_IDENTITY, (uint8_t)(i + 1));
	if (!cli_node_read(&node, OD_INDEX_MANUFACTURER_DEVICE_NAME, 0, wire, sizeof(wire)) ||
		od_format(&TEXT, wire, node.sdo.size, seen->name, sizeof(seen->name)) < 0)
		seen->name[0] = '\0';
}

static const char *const identity_names[IDENTITY_NUMBERS] = {"vendor", "product", "revision", "serial"};

static void print_node(uint8_t id, const struct seen *seen)
{
	printf("%3u  %-15s", id, state_text(seen->state));
	if (seen->type)
		printf("  type %08Xh", seen->type);
	for (size_t i = 0; i < IDENTITY_NUMBERS; i++)
		if (seen->identity[i])
			printf("  %s %08Xh", identity_names[i], seen->identity[i]);
	if (seen->name[0])
		printf("  %s", seen->name);
	putchar('\n');
}

static void add_node(struct json_object *nodes, uint8_t id, const struct seen *seen)
{
	struct json_object *node = json_object_new_object();

	json_object_object_add(node, "node", json_object_new_int(id));
	json_object_object_add(node, "state", json_object_new_string(state_text(seen->state)));
	json_object_object_add(node, "answers", json_object_new_boolean(seen->answers));
	if (seen->answers) {
		json_object_object_add(node, "type", json_object_new_int64(seen->type));
		for (size_t i = 0; i < IDENTITY_NUMBERS; i++)
			json_object_object_add(node, identity_names[i], json_object_new_int64(seen->identity[i]));
		json_object_object_add(node, "name", json_object_new_string(seen->name));
	}
	json_object_array_add(nodes, node);
}

/* CiA 301, 7.5.2.20: the four numbers together are unique. */
static void tell_equal(const struct seen nodes[NODES])
{
	for (int a = 1; a < NODES; a++)
		for (int b = a + 1; b < NODES && nodes[a].identity[IDENTITY_NUMBERS - 1]; b++)
			if (memcmp(nodes[a].identity, nodes[b].identity, sizeof(nodes[a].identity)) == 0)
				fprintf(stderr,
					"imu9-sdo: nodes %d and %d have the same identity (1018h): LSS cannot tell "
					"them "
					"apart; give one another serial number\n",
					a, b);
}

int sdo_command_scan(struct session *s, int argc, char **argv)
{
	struct can_port *bus = cli_open_bus(s->bus);
	struct seen nodes[NODES];
	struct json_object *document = s->json ? json_object_new_object() : NULL;
	struct json_object *list = document ? sdo_json_array(document, "nodes") : NULL;
	int found = 0;

	(void)argc, (void)argv;
	bool sent = look(s, bus, nodes);
	for (uint8_t id = 1; sent && id < NODES; id++) {
		if (!nodes[id].answers && nodes[id].state == STATE_UNKNOWN)
			continue;
		if (nodes[id].answers)
			read_node(s, bus, id, &nodes[id]);
		if (list)
			add_node(list, id, &nodes[id]);
		else
			print_node(id, &nodes[id]);
		found++;
	}
	can_close(bus);
	tell_equal(nodes);
	if (document)
		sdo_json_print(document, false);
	if (sent && !s->quiet)
		fprintf(stderr, "imu9-sdo: %d node%s on %s%s\n", found, found == 1 ? "" : "s", s->bus,
			found ? "" : "; nodes without a node-ID: 'imu9-sdo lss scan'");
	return sent && found ? CLI_OK : CLI_FAILED;
}
