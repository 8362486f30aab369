/* Two nodes with one node-ID, or one identifier given to two PDOs: a data frame with an identifier that only this node
 * sends with, from another (EMCY 8150h). The port does not give a node its own frames back. NMT stays as it is: the
 * frames of both are on the bus either way, and which of the two should be silent is the master's to say. */
#include "gateway/canopen/service.h"

enum { QUIET_US = 10000000 }; /* no such frame for so long: it is over */

size_t collision_ids(const struct canopen_node *node, uint32_t ids[COLLISION_IDS_MAX])
{
	size_t n = 0;

	ids[n++] = CAN_ID_ERROR_CONTROL + node->id;
	if (node->emcy.cob_id && !(*node->emcy.cob_id & COB_ID_INVALID))
		ids[n++] = *node->emcy.cob_id & COB_ID_MASK;
	for (size_t i = 0; i < SDO_SERVERS; i++)
		if (node->sdo_servers[i].request_id != CAN_ID_NONE)
			ids[n++] = node->sdo_servers[i].response_id & COB_ID_MASK;
	for (size_t i = 0; i < node->pdos.tpdo_count; i++)
		if (!(*node->pdos.tpdo[i].pdo.cob_id & COB_ID_INVALID))
			ids[n++] = *node->pdos.tpdo[i].pdo.cob_id & COB_ID_MASK;
	return n;
}

static bool is_ours(const struct canopen_node *node, uint32_t id)
{
	uint32_t ids[COLLISION_IDS_MAX];
	size_t n = collision_ids(node, ids);

	for (size_t i = 0; i < n; i++)
		if (ids[i] == id)
			return true;
	return false;
}

bool collision_receive(struct canopen_node *node, const struct can_msg *msg)
{
	struct collision *collision = &node->collision;
	uint8_t info[5] = {0};

	if (!is_ours(node, msg->id))
		return false;
	collision->over_us = node->now_us + QUIET_US;
	if (collision->stands)
		return true;
	collision->stands = true;
	put_u16(info, (uint16_t)msg->id);
	canopen_error_set(node, EMCY_COLLISION, ERROR_COMMUNICATION, info, node->now_us);
	if (node->device.collision)
		node->device.collision(node->device.ctx, msg->id);
	return true;
}

void collision_reset(struct canopen_node *node)
{
	node->collision.stands = false; /* the error went with the reset */
}

uint64_t collision_tick(struct canopen_node *node)
{
	struct collision *collision = &node->collision;

	if (!collision->stands)
		return UINT64_MAX;
	if (node->now_us < collision->over_us)
		return collision->over_us;
	collision->stands = false;
	emcy_clear(node, EMCY_COLLISION, EMCY_NO_SOURCE);
	return UINT64_MAX;
}
