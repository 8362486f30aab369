#include "gateway/canopen/service.h"
#include "od_index.h"

#include <errno.h>
#include <stddef.h>
#include <string.h>

void node_send(struct canopen_node *node, uint32_t id, const uint8_t *data, uint8_t len)
{
	struct can_msg msg = {.id = id, .len = len};

	memcpy(msg.data, data, len);
	(void)can_send(node->bus, &msg, node->now_us); /* the port counts a frame that it drops */
}

const void *node_value(const struct canopen_node *node, uint16_t index, uint8_t sub, size_t size)
{
	static const uint64_t absent;
	const void *value = od_value(node->od, index, sub, size);

	return value ? value : &absent;
}

void node_filter(struct canopen_node *node)
{
	uint32_t ids[4 + CANOPEN_LISTENED + SDO_SERVERS + HEARTBEAT_CONSUMERS + RPDO_MAX + COLLISION_IDS_MAX] = {
		CAN_ID_LSS_REQUEST};
	size_t n = 1;

	for (size_t i = 0; node->listener && i < node->listener->count; i++)
		ids[n++] = node->listener->ids[i];
	if (node->id == CANOPEN_UNCONFIGURED) {
		(void)can_filter(node->bus, ids, n);
		return;
	}
	ids[n++] = CAN_ID_NMT;
	n += sdo_server_ids(node, ids + n);
	if (node->sync.id != CAN_ID_NONE)
		ids[n++] = node->sync.id;
	if (node->time.id != CAN_ID_NONE)
		ids[n++] = node->time.id;
	for (size_t i = 0; i < node->heartbeat.count; i++)
		if (node->heartbeat.consumer[i].node_id)
			ids[n++] = CAN_ID_ERROR_CONTROL + node->heartbeat.consumer[i].node_id;
	n += pdo_receive_ids(node, ids + n);
	n += collision_ids(node, ids + n);   /* node guarding and remote requests of PDOs use them, too */
	(void)can_filter(node->bus, ids, n); /* best effort: canopen_receive() checks the identifier again */
}

void canopen_listen(struct canopen_node *node, struct canopen_listener *listener)
{
	node->listener = listener;
	node_filter(node);
}

enum od_status canopen_read(
	const struct canopen_node *node, uint16_t index, uint8_t sub, void *wire, size_t capacity, size_t *size)
{
	if (od_find(node->od->table, index, sub, NULL) && emcy_history_empty(node, index, sub))
		return OD_NO_DATA;
	return od_read(node->od, index, sub, wire, capacity, size);
}

enum od_status canopen_write(
	struct canopen_node *node, uint16_t index, uint8_t sub, const void *wire, size_t size, uint64_t now_us)
{
	node->now_us = now_us;
	return od_write(node->od, index, sub, wire, size);
}

bool canopen_listens(const struct canopen_node *node)
{
	return !lss_silent(node) && (node->nmt.state != NMT_INITIALISING || node->id == CANOPEN_UNCONFIGURED);
}

bool cob_id_usable(uint32_t cob_id)
{
	static const struct {
		uint16_t first, last;
	} restricted[] = {
		{0x000, 0x07F}, {0x101, 0x180}, {0x581, 0x5FF}, {0x601, 0x67F}, {0x6E0, 0x6FF}, {0x701, 0x7FF}};
	uint32_t id = cob_id & 0x3FFFFFFF;

	for (size_t i = 0; i < sizeof(restricted) / sizeof(restricted[0]); i++)
		if (id >= restricted[i].first && id <= restricted[i].last)
			return false;
	return id <= COB_ID_MASK;
}

bool cob_id_in_use(uint32_t cob_id)
{
	return !(cob_id & (COB_ID_INVALID | COB_ID_NO_RTR)) && cob_id_usable(cob_id);
}

enum od_status cob_id_change(uint32_t old, uint32_t value)
{
	if (value & COB_ID_INVALID)
		return value & ~(COB_ID_INVALID | COB_ID_MASK) ? OD_BAD_VALUE : OD_OK;
	if (!cob_id_in_use(value))
		return OD_BAD_VALUE;
	return !(old & COB_ID_INVALID) && value != old ? OD_BAD_VALUE : OD_OK;
}

void node_bad_data(struct canopen_node *node, uint16_t index)
{
	uint8_t info[5] = {0};

	put_u16(info, index);
	canopen_error_set(node, EMCY_DATA_SET, 0, info, node->now_us);
}

/* Applies the values of the dictionary to every service. */
static void reset_services(struct canopen_node *node)
{
	heartbeat_reset(node);
	guard_reset(node);
	if (node->id == CANOPEN_UNCONFIGURED) {
		sdo_server_stop(node);
		node_filter(node);
		return;
	}
	emcy_check(node);
	sdo_server_reset(node);
	sync_reset(node);
	time_reset(node);
	pdo_reset(node);
	node_filter(node);
}

int canopen_init(struct canopen_node *node, struct od *od, struct can_port *bus, const struct canopen_device *device,
	uint8_t node_id)
{
	static const uint16_t mandatory[] = {
		OD_INDEX_DEVICE_TYPE, OD_INDEX_ERROR_REGISTER, OD_INDEX_PRODUCER_HEARTBEAT_TIME, OD_INDEX_IDENTITY};

	if (node_id < 1 || (node_id > 127 && node_id != CANOPEN_UNCONFIGURED))
		return -EINVAL;
	for (size_t i = 0; i < sizeof(mandatory) / sizeof(mandatory[0]); i++)
		if (!od_find(od->table, mandatory[i], 0, NULL))
			return -ENOENT;

	memset(node, 0, offsetof(struct canopen_node, sdo_buffers));
	node->od = od;
	node->bus = bus;
	if (device)
		node->device = *device;
	lss_init(node, node_id);
	nmt_init(node);
	heartbeat_init(node);
	guard_init(node);
	sdo_server_init(node);
	sync_init(node);
	time_init(node);
	emcy_init(node);
	store_init(node);
	int err = pdo_init(node);
	if (err)
		return err;
	reset_services(node);
	return 0;
}

void canopen_start(struct canopen_node *node, uint64_t now_us)
{
	node->now_us = now_us;
	node->started = true;
	if (node->id != CANOPEN_UNCONFIGURED)
		nmt_boot_up(node);
}

void node_reset(struct canopen_node *node, enum od_group group)
{
	nmt_enter(node, NMT_INITIALISING);
	emcy_reset(node, group);
	if (node->device.reset)
		node->device.reset(node->device.ctx, group);
	lss_reset(node, group);
	reset_services(node);
	nmt_plan_boot_up(node);
}

static void receive_remote(struct canopen_node *node, const struct can_msg *msg)
{
	if (msg->id == CAN_ID_ERROR_CONTROL + node->id)
		guard_receive(node);
	else
		pdo_receive_remote(node, msg->id);
}

void canopen_receive(struct canopen_node *node, const struct can_msg *msg, uint64_t now_us)
{
	node->now_us = now_us;
	if (!node->started || lss_silent(node) || msg->extended || msg->len > 8)
		return;
	if (node->nmt.state == NMT_INITIALISING) { /* without a node-ID, or before boot-up */
		if (msg->id == CAN_ID_LSS_REQUEST && !msg->remote)
			lss_receive(node, msg);
		return;
	}
	if (msg->remote) {
		receive_remote(node, msg);
		return;
	}
	if (msg->id == CAN_ID_NMT)
		nmt_receive(node, msg);
	else if (msg->id == node->sync.id)
		sync_receive(node, msg);
	else if (sdo_server_receive(node, msg))
		return;
	else if (msg->id == CAN_ID_LSS_REQUEST)
		lss_receive(node, msg);
	else if (msg->id == node->time.id)
		time_receive(node, msg);
	else if (collision_receive(node, msg))
		return;
	else if (msg->id > CAN_ID_ERROR_CONTROL)
		heartbeat_receive(node, msg);
	else
		pdo_receive(node, msg);
}

uint64_t canopen_tick(struct canopen_node *node, uint64_t now_us)
{
	uint64_t deadline;

	node->now_us = now_us;
	deadline = lss_tick(node);
	if (lss_silent(node))
		return deadline;
	deadline = earlier(heartbeat_tick(node), guard_tick(node)); /* before the PDOs: they may leave operational */
	deadline = earlier(deadline, nmt_tick(node));
	deadline = earlier(deadline, sync_tick(node));
	deadline = earlier(deadline, pdo_tick(node));
	deadline = earlier(deadline, emcy_tick(node));
	return earlier(deadline, sdo_server_tick(node));
}

void canopen_sample(struct canopen_node *node, uint64_t now_us)
{
	node->now_us = now_us;
	if (!lss_silent(node))
		pdo_sample(node);
}
