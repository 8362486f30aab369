/* TIME (CiA 301, 7.2.6): consumer and producer of the time of day, COB-ID 1012h. The device has the time, and decides
 * when to send it. */
#include "gateway/canopen/service.h"
#include "od_index.h"

enum { TIME_SIZE = 6, MS_PER_DAY = 86400000 };

/* The identifier cannot change while TIME is consumed or produced. */
static enum od_status before_write(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	const struct canopen_node *node = ctx;
	uint32_t old = *node->time.cob_id, value = get_u32(wire);
	const uint32_t in_use = COB_ID_CONSUMES | COB_ID_PRODUCES;

	(void)entry;
	(void)size;
	if (!cob_id_usable(value) || (old & in_use && (old ^ value) & COB_ID_MASK))
		return OD_BAD_VALUE;
	return value & in_use && sdo_server_uses(node, value) ? OD_INCOMPATIBLE : OD_OK;
}

static void update_id(struct canopen_node *node)
{
	uint32_t cob_id = *node->time.cob_id;

	node->time.id = cob_id & COB_ID_CONSUMES && cob_id_usable(cob_id) ? cob_id & COB_ID_MASK : CAN_ID_NONE;
}

static void after_write(void *ctx, const struct od_entry *entry)
{
	(void)entry;
	update_id(ctx);
	node_filter(ctx);
}

void time_init(struct canopen_node *node)
{
	struct time *time = &node->time;

	time->cob_id = node_value(node, OD_INDEX_COB_ID_TIME, 0, sizeof(uint32_t));
	time->hook = (struct od_hook){.first = OD_INDEX_COB_ID_TIME,
		.last = OD_INDEX_COB_ID_TIME,
		.before = before_write,
		.after = after_write,
		.ctx = node};
	od_attach(node->od, &time->hook);
}

void time_reset(struct canopen_node *node)
{
	update_id(node);
	if (!cob_id_usable(*node->time.cob_id) && od_find(node->od->table, OD_INDEX_COB_ID_TIME, 0, NULL))
		node_bad_data(node, OD_INDEX_COB_ID_TIME);
}

void time_receive(struct canopen_node *node, const struct can_msg *msg)
{
	uint32_t ms = get_u32(msg->data) & 0x0FFFFFFF; /* the upper bits are reserved */

	if (!nmt_communicates(node) || msg->len != TIME_SIZE || ms >= MS_PER_DAY || !node->device.time)
		return;
	node->device.time(node->device.ctx, get_u16(msg->data + 4), ms, msg->t_us ? msg->t_us : node->now_us);
}

bool canopen_send_time(struct canopen_node *node, uint16_t day, uint32_t ms, uint64_t now_us)
{
	uint32_t cob_id = *node->time.cob_id;
	uint8_t data[TIME_SIZE];

	node->now_us = now_us;
	if (!(cob_id & COB_ID_PRODUCES) || !cob_id_usable(cob_id) || !nmt_communicates(node) || lss_silent(node))
		return false;
	put_u32(data, ms);
	put_u16(data + 4, day);
	node_send(node, cob_id & COB_ID_MASK, data, sizeof(data));
	return true;
}
