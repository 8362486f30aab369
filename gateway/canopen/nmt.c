/* NMT slave and heartbeat producer (CiA 301, 7.2.8 and 7.3.2), start-up 1F80h (CiA 302-2), error behaviour 1029h. */
#include "gateway/canopen/service.h"
#include "od_index.h"

enum nmt_command {
	NMT_START = 1,
	NMT_STOP = 2,
	NMT_ENTER_PRE_OPERATIONAL = 128,
	NMT_RESET_NODE = 129,
	NMT_RESET_COMMUNICATION = 130,
};

/* A master that begins to wait after its reset command receives the boot-up message then. */
enum { BOOT_UP_DELAY_US = 10000 };

/* Bits of 1F80h. */
enum { STARTUP_BY_MASTER = 1 << 2 };

/* Values of 1029h:1. */
enum { ON_ERROR_PRE_OPERATIONAL = 0, ON_ERROR_STOP = 2 };

/* The other bits of 1F80h are those of an NMT master, which this node is not. */
static enum od_status before_startup(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	(void)ctx;
	(void)entry;
	(void)size;
	return get_u32(wire) & ~(uint32_t)STARTUP_BY_MASTER ? OD_BAD_VALUE : OD_OK;
}

void nmt_init(struct canopen_node *node)
{
	struct nmt *nmt = &node->nmt;

	nmt->heartbeat_ms = node_value(node, OD_INDEX_PRODUCER_HEARTBEAT_TIME, 0, sizeof(uint16_t));
	nmt->error_behaviour = node_value(node, OD_INDEX_ERROR_BEHAVIOUR, 1, sizeof(uint8_t));
	nmt->boot_up_us = UINT64_MAX;
	nmt->startup = od_value(node->od, OD_INDEX_NMT_STARTUP, 0, sizeof(uint32_t));
	nmt->hook = (struct od_hook){
		.first = OD_INDEX_NMT_STARTUP, .last = OD_INDEX_NMT_STARTUP, .before = before_startup, .ctx = node};
	od_attach(node->od, &nmt->hook);
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
		sdo_server_stop(node);
	if (old == NMT_STOPPED && nmt_communicates(node))
		emcy_leave_stopped(node); /* before the PDOs restart, which may end an error and send EMCY */
	if (state == NMT_OPERATIONAL) {
		sync_start(node);
		pdo_start(node);
	}
}

void nmt_plan_boot_up(struct canopen_node *node)
{
	if (node->id != CANOPEN_UNCONFIGURED)
		node->nmt.boot_up_us = node->now_us + BOOT_UP_DELAY_US;
}

void nmt_boot_up(struct canopen_node *node)
{
	node->nmt.boot_up_us = UINT64_MAX;
	node_send(node, CAN_ID_ERROR_CONTROL + node->id, (const uint8_t[]){0x00}, 1);
	node->nmt.last_heartbeat_us = node->now_us;
	nmt_enter(node, NMT_PRE_OPERATIONAL);
	if (node->nmt.startup && !(*node->nmt.startup & STARTUP_BY_MASTER))
		nmt_enter(node, NMT_OPERATIONAL);
}

void nmt_communication_error(struct canopen_node *node)
{
	uint8_t behaviour = *node->nmt.error_behaviour;

	if (node->nmt.state == NMT_INITIALISING)
		return;
	if (behaviour == ON_ERROR_STOP)
		nmt_enter(node, NMT_STOPPED);
	else if (behaviour == ON_ERROR_PRE_OPERATIONAL && node->nmt.state == NMT_OPERATIONAL)
		nmt_enter(node, NMT_PRE_OPERATIONAL);
}

void canopen_bus_off(struct canopen_node *node, uint64_t now_us)
{
	node->now_us = now_us;
	nmt_communication_error(node);
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

/* A new 1017h is used at once: the next heartbeat is due one new period after the last one, or now. */
uint64_t nmt_tick(struct canopen_node *node)
{
	uint64_t period_us = *node->nmt.heartbeat_ms * 1000u, due_us;

	if (node->nmt.state == NMT_INITIALISING) {
		if (node->now_us < node->nmt.boot_up_us)
			return node->nmt.boot_up_us;
		nmt_boot_up(node);
	}
	if (period_us == 0)
		return UINT64_MAX;
	due_us = node->nmt.last_heartbeat_us + period_us;
	if (node->now_us < due_us)
		return due_us;
	node_send(node, CAN_ID_ERROR_CONTROL + node->id, (const uint8_t[]){(uint8_t)node->nmt.state}, 1);
	/* keep the phase after a small delay, restart it when whole periods were missed */
	node->nmt.last_heartbeat_us = node->now_us - due_us < period_us ? due_us : node->now_us;
	return node->nmt.last_heartbeat_us + period_us;
}
