/* LSS (CiA 305): nodes without a node-ID, and a node-ID for a node. One request at a time. */
#include <stdio.h>
#include <string.h>

#include "gateway/canopen/deadline.h"
#include "tools/web/request.h"
#include "tools/web/web.h"

enum { ANSWER_US = 100000, STORE_US = 5000000, UNITS_MAX = 127 };

static const char *const PARTS[LSS_ADDRESS] = {"vendor", "product", "revision", "serial"};

static void send(void *ctx, const struct can_msg *msg, uint64_t now_us)
{
	struct web *web = ctx;

	can_send(web->config.bus, msg, now_us);
}

static struct json_object *identity_json(const uint32_t identity[LSS_ADDRESS])
{
	struct json_object *json = json_object_new_object();

	for (int i = 0; i < LSS_ADDRESS; i++)
		json_object_object_add(json, PARTS[i], json_object_new_int64(identity[i]));
	return json;
}

/* `result` NULL: refused because of `error`. */
static void end(struct web *web, struct json_object *result, const char *error, uint64_t now_us)
{
	struct web_lss *lss = &web->lss;
	struct web_client *client = &web->clients[lss->client];

	lss_master_switch_global(&lss->master, false, now_us);
	lss->doing = WEB_LSS_NOTHING;
	if (client->open && client->serial == lss->serial) {
		client->jobs--;
		web_answer_now(web, lss->client, lss->id, result, error);
	} else {
		json_object_put(result);
	}
	json_object_put(lss->units);
	lss->units = NULL;
}

static void find(struct web_lss *lss, uint64_t now_us)
{
	static const enum lss_scan all[LSS_ADDRESS] = {LSS_SCAN, LSS_SCAN, LSS_SCAN, LSS_SCAN};

	lss_master_fastscan(&lss->master, all, lss->identity, now_us);
}

static void on_found(struct web *web, uint64_t now_us)
{
	struct web_lss *lss = &web->lss;
	struct json_object *result;

	if (lss->master.result == LSS_DONE)
		json_object_array_add(lss->units, identity_json(lss->master.address));
	if (lss->master.result == LSS_DONE && json_object_array_length(lss->units) < UNITS_MAX) {
		find(lss, now_us);
		return;
	}
	if (lss->master.result == LSS_LOST) {
		end(web, NULL, "nodes answered, but none could be told apart: try again", now_us);
		return;
	}
	result = json_object_new_object();
	json_object_object_add(result, "units", json_object_get(lss->units));
	end(web, result, NULL, now_us);
}

static void on_set(struct web *web, uint64_t now_us)
{
	struct web_lss *lss = &web->lss;
	struct json_object *result;

	if (lss->master.result != LSS_DONE) {
		end(web, NULL,
			lss->master.result == LSS_REFUSED ? "the node refused"
			: lss->doing == WEB_LSS_SELECTING ? "no node with this identity answers"
							  : "the node stopped answering",
			now_us);
		return;
	}
	if (lss->doing == WEB_LSS_SELECTING) {
		lss->doing = WEB_LSS_SETTING;
		lss_master_configure_node_id(&lss->master, lss->node_id, now_us);
		return;
	}
	if (lss->doing == WEB_LSS_SETTING && lss->store) {
		lss->doing = WEB_LSS_STORING;
		lss->master.timeout_us = STORE_US;
		lss_master_store(&lss->master, now_us);
		return;
	}
	result = json_object_new_object();
	json_object_object_add(result, "node", json_object_new_int(lss->node_id));
	json_object_object_add(result, "stored", json_object_new_boolean(lss->store));
	end(web, result, NULL, now_us);
}

void web_lss_receive(struct web *web, const struct can_msg *msg, uint64_t now_us)
{
	if (web->lss.doing != WEB_LSS_NOTHING)
		lss_master_receive(&web->lss.master, msg, now_us);
}

uint64_t web_lss_tick(struct web *web, uint64_t now_us)
{
	struct web_lss *lss = &web->lss;
	uint64_t next_us = UINT64_MAX;

	if (lss->doing == WEB_LSS_NOTHING)
		return UINT64_MAX;
	if (lss->master.result == LSS_RUNNING)
		next_us = lss_master_tick(&lss->master, now_us);
	if (lss->master.result == LSS_RUNNING)
		return next_us;
	if (lss->doing == WEB_LSS_FINDING)
		on_found(web, now_us);
	else
		on_set(web, now_us);
	return lss->doing == WEB_LSS_NOTHING ? UINT64_MAX : now_us;
}

void web_lss_free(struct web *web)
{
	json_object_put(web->lss.units);
}

/* False: not four numbers. */
static bool parse_identity(struct json_object *request, uint32_t identity[LSS_ADDRESS])
{
	struct json_object *json = NULL;
	int64_t number;

	if (!json_object_object_get_ex(request, "identity", &json) || !json_object_is_type(json, json_type_object))
		return false;
	for (int i = 0; i < LSS_ADDRESS; i++) {
		if (!web_integer(json, PARTS[i], 0, UINT32_MAX, &number))
			return false;
		identity[i] = (uint32_t)number;
	}
	return true;
}

void web_op_lss(struct web *web, int client, int64_t id, struct json_object *request, uint64_t now_us)
{
	struct web_lss *lss = &web->lss;
	const char *command = web_string(request, "command");
	struct json_object *store = NULL;
	bool set = command && strcmp(command, "set") == 0;
	int64_t node = 0;

	if (!set && (!command || strcmp(command, "find") != 0)) {
		web_answer_now(web, client, id, NULL, "\"command\" is find or set");
		return;
	}
	if (lss->doing != WEB_LSS_NOTHING) {
		web_answer_now(web, client, id, NULL, "another LSS request is under way");
		return;
	}
	uint32_t identity[LSS_ADDRESS] = {0};
	if (set && (!parse_identity(request, identity) || !web_integer(request, "node", 1, WEB_NODES - 1, &node))) {
		web_answer_now(web, client, id, NULL,
			"\"identity\" has vendor, product, revision and serial, \"node\" is a number from 1 to 127");
		return;
	}
	json_object_object_get_ex(request, "store", &store);
	*lss = (struct web_lss){.client = client,
		.serial = web->clients[client].serial,
		.id = id,
		.node_id = (uint8_t)node,
		.store = json_object_is_type(store, json_type_boolean) && json_object_get_boolean(store)};
	memcpy(lss->identity, identity, sizeof(identity));
	web->clients[client].jobs++;
	lss_master_init(&lss->master, send, web);
	lss->master.timeout_us = ANSWER_US;
	lss_master_switch_global(&lss->master, false, now_us);
	lss->doing = set ? WEB_LSS_SELECTING : WEB_LSS_FINDING;
	if (set) {
		lss_master_switch_selective(&lss->master, lss->identity, now_us);
		return;
	}
	lss->units = json_object_new_array();
	find(lss, now_us);
}
