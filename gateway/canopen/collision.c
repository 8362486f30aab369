/* COB-ID collision (EMCY 8150h): a data frame of another node with an identifier that only this node may send with. Two
 * nodes have the same node-ID, or two PDOs the same identifier. The port does not return a node's own frames. The NMT
 * state stays: both nodes have sent already, and the master decides which of them to stop. */
#include "gateway/canopen/service.h"

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

static bool is_own_id(const struct canopen_node *node, uint32_t id)
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
	uint8_t info[5] = {0};

	if (!is_own_id(node, msg->id))
		return false;
	put_u16(info, (uint16_t)msg->id);
	if (emcy_set_frame(node, EMCY_COLLISION, EMCY_NO_SOURCE, info) && node->device.collision)
		node->device.collision(node->device.ctx, msg->id);
	return true;
}
