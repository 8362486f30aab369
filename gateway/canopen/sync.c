/* SYNC consumer (CiA 301, 7.2.5): COB-ID 1005h, synchronous window 1007h, counter 1019h. */
#include "gateway/canopen/service.h"

#define SYNC_PRODUCER (1u << 30)

static enum od_status before_write(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	const uint8_t *bytes = wire;

	(void)ctx;
	(void)size;
	switch (entry->index) {
	case 0x1005: /* bit 31 means nothing; this node does not produce SYNC */
		return (get_u32(bytes) & SYNC_PRODUCER) || !cob_id_usable(get_u32(bytes)) ? OD_BAD_VALUE : OD_OK;
	case 0x1019:
		return bytes[0] == 1 || bytes[0] > 240 ? OD_BAD_VALUE : OD_OK;
	default:
		return OD_OK;
	}
}

static void listen(struct canopen_node *node)
{
	node->sync.id = cob_id_usable(*node->sync.cob_id) ? *node->sync.cob_id & COB_ID_MASK : CAN_ID_NONE;
}

static void after_write(void *ctx, const struct od_entry *entry)
{
	if (entry->index != 0x1005)
		return;
	listen(ctx);
	node_filter(ctx);
}

void sync_init(struct canopen_node *node)
{
	struct sync *sync = &node->sync;

	sync->cob_id = node_value(node, 0x1005, 0, sizeof(uint32_t));
	sync->window_us = node_value(node, 0x1007, 0, sizeof(uint32_t));
	sync->counter_overflow = node_value(node, 0x1019, 0, sizeof(uint8_t));
	sync->hook = (struct od_hook){
		.first = 0x1005, .last = 0x1019, .before = before_write, .after = after_write, .ctx = node};
	od_attach(node->od, &sync->hook);
}

void sync_reset(struct canopen_node *node)
{
	listen(node);
	if (node->sync.id == CAN_ID_NONE && od_find(node->od->table, 0x1005, 0, NULL))
		node_bad_data(node, 0x1005);
}

/* 1007h: how long after the SYNC its PDOs may still be sent. The core sends them as soon as it sees the SYNC, so
 * they are late only when the SYNC itself was seen late. */
static bool window_passed(const struct canopen_node *node, const struct can_msg *msg)
{
	return *node->sync.window_us && msg->t_us && node->now_us > msg->t_us + *node->sync.window_us;
}

void sync_receive(struct canopen_node *node, const struct can_msg *msg)
{
	bool counted = *node->sync.counter_overflow != 0;

	if (!nmt_communicates(node))
		return;
	if (msg->len != (counted ? 1 : 0)) {
		canopen_error_set(node, EMCY_SYNC_LENGTH, ERROR_COMMUNICATION, NULL, node->now_us);
		return;
	}
	canopen_error_clear(node, EMCY_SYNC_LENGTH, node->now_us);
	if (node->nmt.state != NMT_OPERATIONAL)
		return;
	bool late = window_passed(node, msg);
	node->sync.late += late;
	pdo_sync(node, counted ? msg->data[0] : 0, late);
}
