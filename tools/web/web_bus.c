/* The bus: which nodes there are, its load, SYNC, NMT, and the scan. */
#include <stdio.h>
#include <string.h>

#include "gateway/canopen/canopen.h"
#include "gateway/canopen/cia301.h"
#include "gateway/canopen/deadline.h"
#include "tools/web/request.h"
#include "tools/web/web.h"

enum {
	SECOND_US = 1000000,
	SCAN_STEP_US = 2000,	/* between two requests of a scan */
	SCAN_WAIT_US = 1100000, /* after the last: a heartbeat period is often a second */
	SCAN_RECENT_US = 2000000,
	SYNC_ID = 0x080,
};

static bool send(struct web *web, const struct can_msg *msg, uint64_t now_us)
{
	return can_send(web->config.bus, msg, now_us) == 0;
}

/* ---- what is on it ----------------------------------------------------------------------------------------------- */

void web_bus_receive(struct web *web, const struct can_msg *msg, uint64_t now_us)
{
	web->frames++;
	if (msg->id == SYNC_ID && !msg->extended && !msg->remote) {
		web->syncs++;
		web->foreign_sync_us = now_us;
	}
}

/* From start of frame to interframe space a frame without data has 47 bits (ISO 11898-1). Bit stuffing applies to 34 of
 * them and to the data, with at most one stuff bit for each four bits; half of that is counted. */
static double bits(double frames, double bytes)
{
	return 47 * frames + 8 * bytes + (34 * frames + 8 * bytes) / 8;
}

static void measure(struct web *web, uint64_t now_us)
{
	struct can_port *bus = web->config.bus;
	double span_s = (double)(now_us - web->second_us) / 1e6;
	struct can_traffic then = web->traffic;

	can_refresh(bus);
	web->traffic = bus->traffic;
	web->frames_hz = (double)web->frames / span_s;
	web->sync_hz = (double)web->syncs / span_s;
	web->load = -1;
	if (bus->bit_s && bus->traffic.frames >= then.frames) /* else the interface was replaced by another one */
		web->load =
			bits((double)(bus->traffic.frames - then.frames), (double)(bus->traffic.bytes - then.bytes)) /
			(bus->bit_s * span_s);
	web->frames = web->syncs = 0;
	web->second_us = now_us;
	web->bus_version++;
}

static const char *const IDENTITY[] = {"vendor", "product", "revision", "serial"};

static struct json_object *node_json(const struct web_node *node, uint64_t now_us)
{
	struct json_object *json = json_object_new_object();
	double heard_s = node->heard_us ? (double)(now_us - node->heard_us) / 1e6 : -1;
	char text[32];

	json_object_object_add(json, "node", json_object_new_int(node->id));
	json_object_object_add(json, "state", json_object_new_string(web_state_text(node->state)));
	json_object_object_add(json, "name", node->known ? json_object_new_string(node->name) : NULL);
	for (int i = 0; i < 4; i++)
		json_object_object_add(
			json, IDENTITY[i], node->known ? json_object_new_int64(node->identity[i]) : NULL);
	json_object_object_add(json, "ours", json_object_new_boolean(web_is_ours(node)));
	snprintf(text, sizeof(text), "%.1f", heard_s);
	json_object_object_add(json, "heard_s", heard_s < 0 ? NULL : json_object_new_double_s(heard_s, text));
	return json;
}

struct json_object *web_nodes_json(const struct web *web, uint64_t now_us)
{
	struct json_object *json = json_object_new_object(), *nodes = json_object_new_array();

	for (int i = 1; i < WEB_NODES; i++)
		if (web->nodes[i].listed)
			json_object_array_add(nodes, node_json(&web->nodes[i], now_us));
	json_object_object_add(json, "nodes", nodes);
	return json;
}

/* ---- scan -------------------------------------------------------------------------------------------------------- */

void web_op_scan(struct web *web, int client, int64_t id, struct json_object *request, uint64_t now_us)
{
	(void)request;
	if (web->scan_id) {
		web_answer_now(web, client, id, NULL, "a scan is under way");
		return;
	}
	web->scan_next = 1;
	web->scan_us = now_us;
	web->scan_id = id + 1; /* 0: none */
	web->scan_client = client;
	web->scan_serial = web->clients[client].serial;
	web->clients[client].jobs++;
}

/* A request ends the transfer that another client has with that node: those that are known are left alone. */
static bool is_known(const struct web_node *node, uint64_t now_us)
{
	return node->job_count > 0 || (node->identified && now_us - node->heard_us < SCAN_RECENT_US);
}

static uint64_t tick_scan(struct web *web, uint64_t now_us)
{
	if (!web->scan_id)
		return UINT64_MAX;
	if (now_us < web->scan_us)
		return web->scan_us;
	while (web->scan_next < WEB_NODES && is_known(&web->nodes[web->scan_next], now_us))
		web->scan_next++;
	if (web->scan_next < WEB_NODES) {
		const struct can_msg msg = {
			.id = CAN_ID_SDO_REQUEST + web->scan_next++, .len = 8, .data = {0x40, 0x00, 0x10}};

		send(web, &msg, now_us);
		web->scan_us = now_us + (web->scan_next < WEB_NODES ? SCAN_STEP_US : SCAN_WAIT_US);
		return web->scan_us;
	}
	struct web_client *client = &web->clients[web->scan_client];
	int64_t id = web->scan_id - 1;
	web->scan_id = 0;
	if (client->open && client->serial == web->scan_serial) {
		client->jobs--;
		web_answer_now(web, web->scan_client, id, web_nodes_json(web, now_us), NULL);
	}
	return UINT64_MAX;
}

/* ---- NMT, SYNC --------------------------------------------------------------------------------------------------- */

void web_op_nmt(struct web *web, int client, int64_t id, struct json_object *request, uint64_t now_us)
{
	static const struct {
		const char *name;
		uint8_t command;
	} commands[] = {{"start", 1}, {"stop", 2}, {"preop", 0x80}, {"reset", 0x81}, {"reset-comm", 0x82}};
	const char *name = web_string(request, "command");
	struct can_msg msg = {.len = 2};
	int64_t node;

	for (size_t i = 0; name && i < sizeof(commands) / sizeof(commands[0]); i++)
		if (strcmp(commands[i].name, name) == 0)
			msg.data[0] = commands[i].command;
	if (!web_integer(request, "node", 0, WEB_NODES - 1, &node) || msg.data[0] == 0) {
		web_answer_now(web, client, id, NULL,
			msg.data[0] ? "\"node\" is a number from 0 (all) to 127"
				    : "\"command\" is start, stop, preop, reset or reset-comm");
		return;
	}
	msg.data[1] = (uint8_t)node;
	bool sent = send(web, &msg, now_us);
	web_answer_now(web, client, id, sent ? json_object_new_object() : NULL, "the bus does not take the frame");
}

void web_op_sync(struct web *web, int client, int64_t id, struct json_object *request, uint64_t now_us)
{
	double hz = web_number(request, "hz", 0, 1000, -1);

	if (hz < 0) {
		web_answer_now(web, client, id, NULL, "\"hz\" is a number from 0 (off) to 1000");
		return;
	}
	if (hz > 0 && web->foreign_sync_us && now_us - web->foreign_sync_us < SECOND_US) {
		web_answer_now(web, client, id, NULL, "another node produces SYNC");
		return;
	}
	web->sync_interval_us = hz > 0 ? 1e6 / hz : 0;
	web->sync_us = now_us;
	web->sync_client = client;
	web_answer_now(web, client, id, json_object_new_object(), NULL);
}

/* SYNC ends with the browser that wanted it. */
void web_bus_disconnect(struct web *web, int client)
{
	if (web->sync_client == client)
		web->sync_interval_us = 0;
}

static uint64_t tick_sync(struct web *web, uint64_t now_us)
{
	const struct can_msg msg = {.id = SYNC_ID};

	if (web->sync_interval_us <= 0)
		return UINT64_MAX;
	if (now_us < web->sync_us)
		return web->sync_us;
	if (send(web, &msg, now_us)) {
		web->syncs++;
		web->frames++;
		for (int i = 1; i < WEB_NODES; i++)
			if (web->nodes[i].watch)
				watch_sync_sent(web->nodes[i].watch, now_us);
	}
	uint64_t interval_us = (uint64_t)web->sync_interval_us;
	web->sync_us += interval_us;
	if (web->sync_us <= now_us) /* no burst after a delay */
		web->sync_us = now_us + interval_us;
	return web->sync_us;
}

uint64_t web_bus_tick(struct web *web, uint64_t now_us)
{
	uint64_t next_us = earlier(tick_sync(web, now_us), tick_scan(web, now_us));

	if (now_us >= web->second_us + SECOND_US)
		measure(web, now_us);
	return earlier(next_us, web->second_us + SECOND_US);
}
