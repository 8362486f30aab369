#include "tools/cli_node.h"

#include <stdio.h>
#include <string.h>

#include "tools/cli_value.h"

void cli_node_open(struct cli_node *node, const char *bus, uint8_t id, unsigned int timeout_ms)
{
	uint32_t answers = 0x580u + id;

	*node = (struct cli_node){.bus = cli_open_bus(bus), .bus_name = bus, .id = id, .timeout_ms = timeout_ms};
	can_filter(node->bus, &answers, 1);
	sdo_client_init(&node->sdo, node->bus, id, (uint64_t)timeout_ms * 1000);
}

void cli_node_close(struct cli_node *node)
{
	can_close(node->bus);
}

static bool finish(struct cli_node *node)
{
	struct sdo_client *sdo = &node->sdo;
	struct can_msg msg;

	while (sdo->result == SDO_RUNNING) {
		uint64_t deadline_us = sdo_client_tick(sdo, cli_now_us());

		if (sdo->result != SDO_RUNNING)
			break;
		cli_wait(node->bus, -1, deadline_us);
		uint64_t now_us = cli_now_us();
		while (can_receive(node->bus, &msg, now_us) > 0)
			sdo_client_receive(sdo, &msg, now_us);
	}
	return sdo->result == SDO_DONE;
}

bool cli_node_read(struct cli_node *node, uint16_t index, uint8_t sub, void *wire, size_t capacity)
{
	sdo_client_upload(&node->sdo, index, sub, wire, capacity, cli_now_us());
	return finish(node);
}

bool cli_node_write(struct cli_node *node, uint16_t index, uint8_t sub, const void *wire, size_t size)
{
	sdo_client_download(&node->sdo, index, sub, wire, size, cli_now_us());
	return finish(node);
}

static void explain_abort(const struct cli_node *node, const struct od_entry *entry)
{
	const struct sdo_client *sdo = &node->sdo;
	char object[128], limits[128] = "";

	cli_address_text(sdo->index, sdo->sub, entry, object, sizeof(object));
	if (entry && (sdo->abort_code == 0x06090030 || sdo->abort_code == 0x06090031 || sdo->abort_code == 0x06090032))
		cli_limits_text(entry, limits, sizeof(limits));
	cli_error("%s: %s: %s (abort %08Xh)%s%s", object,
		sdo->aborted_by_server ? "the node refused" : "the node broke the SDO protocol",
		sdo_abort_text(sdo->abort_code), sdo->abort_code, limits[0] ? "; allowed: " : "", limits);
}

void cli_node_explain(const struct cli_node *node, const struct od_entry *entry)
{
	switch (node->sdo.result) {
	case SDO_ABORTED:
		explain_abort(node, entry);
		return;
	case SDO_TIMEOUT:
		if (node->bus->state == CAN_STATE_DOWN || node->bus->state == CAN_STATE_BUS_OFF)
			cli_error("%s is %s: set it up with 'ip link set %s up', then try again", node->bus_name,
				node->bus->state == CAN_STATE_DOWN ? "down" : "bus-off", node->bus_name);
		else
			cli_error("no answer from node %u on %s within %u ms: is the gateway "
				  "running with "
				  "--node-id %u --can %s? (imu9-monitor shows what a node sends; "
				  "-t waits longer)",
				node->id, node->bus_name, node->timeout_ms, node->id, node->bus_name);
		return;
	case SDO_UNSENT:
		cli_error("cannot send on %s: %s: is the bus up, and is another node on it?", node->bus_name,
			strerror(-node->sdo.send_error));
		return;
	case SDO_IDLE:
	case SDO_RUNNING:
	case SDO_DONE:
		return;
	}
}
