/* NMT slave and heartbeat producer (CiA 301, 7.2.8 and 7.3.2). */
#include "gateway/canopen/service.h"

enum nmt_command {
	NMT_START = 1,
	NMT_STOP = 2,
	NMT_ENTER_PRE_OPERATIONAL = 128,
	NMT_RESET_NODE = 129,
	NMT_RESET_COMMUNICATION = 130,
};

void nmt_init(struct canopen_node *node)
{
	node->nmt.heartbeat_ms = node_value(node, 0x1017, 0, sizeof(uint16_t));
}

enum nmt_state canopen_nmt_state(const struct canopen_node *node)
{
	return node->nmt.state;
}

bool nmt_communicates(const struct canopen_node *node)
{
	return node->nmt.state == NMT_PRE_OPERATIONAL || node->nmt.state == NMT_OPERATIONAL;
}

void nmt_enter(struct canopen_node *node, enum nmt_state state)
{
	enum nmt_state old = node->nmt.state;

	if (state == old)
		return;
	node->nmt.state = state;
	if (node->device.nmt_changed)
		node->device.nmt_changed(node->device.ctx, state);
	if (state == NMT_STOPPED)
		sdo_server_reset(node);
	if (state == NMT_OPERATIONAL)
		pdo_start(node);
	if (old == NMT_STOPPED && nmt_communicates(node))
		emcy_leave_stopped(node);
}

void nmt_receive(struct canopen_node *node, const struct can_msg *msg)
{
	if (msg->len != 2 || (msg->data[1] != 0 && msg->data[1] != node->id))
		return;
	switch (msg->data[0]) {
	case NMT_START:
		nmt_enter(node, NMT_OPERATIONAL);
		break;
	case NMT_STOP:
		nmt_enter(node, NMT_STOPPED);
		break;
	case NMT_ENTER_PRE_OPERATIONAL:
		nmt_enter(node, NMT_PRE_OPERATIONAL);
		break;
	case NMT_RESET_NODE:
		node_reset(node, OD_GROUP_ALL);
		break;
	case NMT_RESET_COMMUNICATION:
		node_reset(node, OD_GROUP_COMMUNICATION);
		break;
	default:
		break;
	}
}

/* A new 1017h holds at once: the next heartbeat is due one new period after the last one, or now.
 */
uint64_t nmt_tick(struct canopen_node *node)
{
	uint64_t period_us = *node->nmt.heartbeat_ms * 1000u;
	uint64_t due_us = node->nmt.last_heartbeat_us + period_us;

	if (node->nmt.state == NMT_INITIALISING || period_us == 0)
		return UINT64_MAX;
	if (node->now_us < due_us)
		return due_us;
	node_send(node, 0x700u + node->id, (const uint8_t[]){(uint8_t)node->nmt.state}, 1);
	/* keep the phase when a little late, start anew when periods were missed */
	node->nmt.last_heartbeat_us = node->now_us - due_us < period_us ? due_us : node->now_us;
	return node->nmt.last_heartbeat_us + period_us;
}
