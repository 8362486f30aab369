#include "tools/lib/cli_node.h"

#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "gateway/canopen/cia301.h"
#include "tools/lib/cli_value.h"

enum {
	LARGE_BYTES = 64, /* from this size on, block transfer needs fewer frames */
	PROGRESS_US = 100000,
	BAR_WIDTH = 40,
};

void cli_node_use(
	struct cli_node *node, struct can_port *bus, const char *bus_name, uint8_t id, unsigned int timeout_ms)
{
	uint32_t answers = CAN_ID_SDO_RESPONSE + id;

	*node = (struct cli_node){.bus = bus, .bus_name = bus_name, .id = id, .timeout_ms = timeout_ms};
	can_filter(node->bus, &answers, 1);
	sdo_client_init(&node->sdo, node->bus, id, (uint64_t)timeout_ms * 1000);
}

void cli_node_open(struct cli_node *node, const char *bus, uint8_t id, unsigned int timeout_ms)
{
	cli_node_use(node, cli_open_bus(bus), bus, id, timeout_ms);
}

void cli_node_close(struct cli_node *node)
{
	can_close(node->bus);
}

static void draw(const struct sdo_client *sdo, uint64_t since_us)
{
	bool known = sdo->total != SIZE_MAX && sdo->total > 0;
	int filled = known ? (int)(BAR_WIDTH * (sdo->size < sdo->total ? sdo->size : sdo->total) / sdo->total) : 0;
	char bar[BAR_WIDTH + 1] = "";

	memset(bar, '#', (size_t)filled);
	memset(bar + filled, '.', (size_t)(BAR_WIDTH - filled));
	fprintf(stderr, "\r[%s] %zu bytes, %.1f kB/s ", bar, sdo->size,
		since_us ? (double)sdo->size * 1e3 / (double)since_us : 0);
}

struct progress {
	bool shown;
	uint64_t start_us, next_us;
};

static void show(struct progress *progress, const struct sdo_client *sdo, uint64_t now_us)
{
	if (now_us < progress->next_us)
		return;
	progress->next_us = now_us + PROGRESS_US;
	progress->shown = true;
	draw(sdo, now_us - progress->start_us);
}

static void end_progress(const struct progress *progress, const struct sdo_client *sdo)
{
	if (!progress->shown)
		return;
	draw(sdo, cli_now_us() - progress->start_us);
	fputc('\n', stderr);
}

static bool finish(struct cli_node *node, struct progress *progress)
{
	struct sdo_client *sdo = &node->sdo;
	struct can_msg msg;

	/* frames first: those already received must not count as a timeout */
	while (sdo->result == SDO_RUNNING) {
		uint64_t now_us = cli_now_us();
		while (can_receive(node->bus, &msg, now_us) > 0) {
			now_us = cli_now_us(); /* a complete block can arrive in this loop */
			sdo_client_receive(sdo, &msg, now_us);
			if (progress)
				show(progress, sdo, now_us);
		}
		uint64_t deadline_us = sdo_client_tick(sdo, cli_now_us());
		if (sdo->result == SDO_RUNNING)
			cli_wait(node->bus, -1, deadline_us);
	}
	return sdo->result == SDO_DONE;
}

bool cli_node_read(struct cli_node *node, uint16_t index, uint8_t sub, void *wire, size_t capacity)
{
	sdo_client_upload(&node->sdo, index, sub, wire, capacity, cli_now_us());
	return finish(node, NULL);
}

bool cli_node_write(struct cli_node *node, uint16_t index, uint8_t sub, const void *wire, size_t size)
{
	sdo_client_download(&node->sdo, index, sub, wire, size, cli_now_us());
	return finish(node, NULL);
}

static bool finish_large(struct cli_node *node)
{
	uint64_t now_us = cli_now_us();
	struct progress progress = {.start_us = now_us, .next_us = now_us + 3 * (uint64_t)PROGRESS_US};
	bool visible = node->show_progress && isatty(STDERR_FILENO);
	bool done = finish(node, visible ? &progress : NULL);

	end_progress(&progress, &node->sdo);
	return done;
}

/* The node aborted because it does not support block transfer: use segmented transfer. */
static bool lacks_block_transfer(const struct cli_node *node)
{
	return node->blocks != CLI_BLOCKS_ALWAYS && node->sdo.result == SDO_ABORTED && node->sdo.aborted_by_server &&
	       (node->sdo.abort_code == SDO_ABORT_COMMAND || node->sdo.abort_code == SDO_ABORT_UNSUPPORTED_ACCESS);
}

bool cli_node_read_large(struct cli_node *node, uint16_t index, uint8_t sub, void *wire, size_t capacity)
{
	if (node->blocks != CLI_BLOCKS_NEVER) {
		sdo_client_block_upload(&node->sdo, index, sub, wire, capacity, cli_now_us());
		if (finish_large(node))
			return true;
		if (!lacks_block_transfer(node))
			return false;
	}
	sdo_client_upload(&node->sdo, index, sub, wire, capacity, cli_now_us());
	return finish_large(node);
}

bool cli_node_write_large(struct cli_node *node, uint16_t index, uint8_t sub, const void *wire, size_t size)
{
	bool in_blocks = node->blocks == CLI_BLOCKS_ALWAYS || (node->blocks == CLI_BLOCKS_LARGE && size >= LARGE_BYTES);

	if (in_blocks) {
		sdo_client_block_download(&node->sdo, index, sub, wire, size, cli_now_us());
		if (finish_large(node))
			return true;
		if (!lacks_block_transfer(node))
			return false;
	}
	sdo_client_download(&node->sdo, index, sub, wire, size, cli_now_us());
	return finish_large(node);
}

static void explain_abort(const struct cli_node *node, const struct od_entry *entry)
{
	const struct sdo_client *sdo = &node->sdo;
	char object[128], limits[128] = "";

	cli_address_text(sdo->index, sdo->sub, entry, object, sizeof(object));
	if (entry && (sdo->abort_code == 0x06090030 || sdo->abort_code == 0x06090031 || sdo->abort_code == 0x06090032))
		od_limits_text(entry, limits, sizeof(limits));
	cli_error("%s: %s: %s (abort %08Xh)%s%s", object,
		sdo->aborted_by_server ? "the node refused" : "the node broke the SDO protocol",
		sdo_abort_text(sdo->abort_code), sdo->abort_code, limits[0] ? "; allowed: " : "", limits);
}

/* Only names of kernel interfaces have no colon. */
static void explain_bus(const struct cli_node *node)
{
	if (node->bus->state == CAN_STATE_BUS_OFF)
		cli_error("%s is bus-off: check wiring, termination and bit rate, then try again", node->bus_name);
	else if (strchr(node->bus->name, ':'))
		cli_error("%s is down: is the adapter plugged in?", node->bus_name);
	else
		cli_error("%s is down: set it up with 'ip link set %s up', then try again", node->bus_name,
			node->bus_name);
}

void cli_node_explain(const struct cli_node *node, const struct od_entry *entry)
{
	switch (node->sdo.result) {
	case SDO_ABORTED:
		explain_abort(node, entry);
		return;
	case SDO_TIMEOUT:
		if (node->bus->state == CAN_STATE_DOWN || node->bus->state == CAN_STATE_BUS_OFF)
			explain_bus(node);
		else
			cli_error("no answer from node %u on %s within %u ms: is the gateway running with --node-id %u "
				  "--can %s? (imu9-monitor shows what a node sends; -t waits longer)",
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
