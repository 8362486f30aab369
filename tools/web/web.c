#include "tools/web/web.h"

#include "gateway/canopen/cia301.h"
#include "gateway/canopen/deadline.h"

void web_init(struct web *web, const struct web_config *config, uint64_t now_us)
{
	*web = (struct web){.config = *config, .start_us = now_us, .second_us = now_us, .load = -1, .sync_client = -1};
	web->traffic = config->bus->traffic;
	for (int i = 1; i < WEB_NODES; i++) {
		web->nodes[i].id = (uint8_t)i;
		web->nodes[i].state = WATCH_NMT_UNKNOWN;
		sdo_client_init(&web->nodes[i].sdo, config->bus, (uint8_t)i, 0);
	}
}

void web_free(struct web *web)
{
	for (int i = 0; i < WEB_CLIENTS; i++)
		if (web->clients[i].open)
			web_disconnect(web, i);
	for (int i = 1; i < WEB_NODES; i++)
		web_node_free(web, &web->nodes[i]);
	web_eds_free(web);
	web_lss_free(web);
}

void web_receive(struct web *web, const struct can_msg *msg, uint64_t now_us)
{
	web_bus_receive(web, msg, now_us);
	web_lss_receive(web, msg, now_us);
	if (msg->extended || msg->remote)
		return;
	struct web_node *node = web_node(web, msg->id & 0x7F);
	if (node)
		web_node_receive(web, node, msg, now_us);
	for (int i = 1; i < WEB_NODES; i++) /* a PDO can have any identifier */
		if (web->nodes[i].watch)
			web_rows_receive(web, &web->nodes[i], msg, now_us);
}

uint64_t web_tick(struct web *web, uint64_t now_us)
{
	uint64_t next_us = earlier(web_bus_tick(web, now_us), web_clients_tick(web, now_us));

	next_us = earlier(next_us, web_lss_tick(web, now_us));
	for (int i = 1; i < WEB_NODES; i++) {
		struct web_node *node = &web->nodes[i];

		if (node->heard_us || node->jobs) /* most node-IDs have no node, and nothing is due for these */
			next_us = earlier(next_us, web_node_tick(web, node, now_us));
	}
	return next_us;
}

bool web_awaits_answer(const struct web *web)
{
	for (int i = 1; i < WEB_NODES; i++) {
		const struct web_node *node = &web->nodes[i];

		if (node->sdo.result == SDO_RUNNING || (node->watch && node->watch->sdo.result == SDO_RUNNING))
			return true;
	}
	return web->lss.doing != WEB_LSS_NOTHING;
}
