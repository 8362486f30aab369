/* The CANopen core with arbitrary frames, time, samples and errors. The input is a sequence of steps, each an
 * operation byte and its arguments. Checked: the frames sent are valid for the node and its state, and time goes
 * forward. */
#include <string.h>

#include "gateway/canopen/node.h"
#include "tests/fuzz/fuzz.h"
#include "od_values.h"

enum { NODE_ID = 0x10, MAX_TICKS = 64 };

static struct world {
	struct can_port port;
	struct od_values values;
	struct od_domain domain;
	struct od od;
	struct canopen_node node;
} now, started[2]; /* with a node-ID and without; copied for each run: the start takes longer than most runs */
static enum nmt_state state_before;

static int port_send(struct can_port *port, const struct can_msg *msg)
{
	(void)port;
	require(msg->id <= 0x7FF && msg->len <= 8 && !msg->extended && !msg->remote);
	require(msg->id != 0 &&
		(msg->id <= 0x600 || msg->id > 0x67F)); /* a server sends neither NMT commands nor SDO requests */
	if (msg->id == 0x580 + NODE_ID)
		require(msg->len == 8 && state_before != NMT_STOPPED);
	return 0;
}

static int port_receive(struct can_port *port, struct can_msg *msg, uint64_t now_us)
{
	(void)port;
	(void)msg;
	(void)now_us;
	return 0;
}

static int port_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port;
	require(ids != NULL && n > 0);
	return 0;
}

static enum od_status answer = OD_OK;

static enum od_status device_store(void *ctx, enum od_group group)
{
	(void)ctx;
	(void)group;
	return answer;
}

static enum od_status device_store_lss(void *ctx, uint8_t node_id, uint32_t bit_s)
{
	(void)ctx;
	(void)bit_s;
	require(node_id >= 1 && (node_id <= 127 || node_id == CANOPEN_UNCONFIGURED));
	return answer;
}

static bool device_bit_rate_possible(void *ctx, uint32_t bit_s)
{
	(void)ctx;
	return bit_s >= 125000;
}

static void device_set_bit_rate(void *ctx, uint32_t bit_s)
{
	(void)ctx;
	require(bit_s >= 125000);
}

static double device_change_threshold(void *ctx, const struct od_entry *entry)
{
	(void)ctx;
	return entry->sub & 1;
}

static struct can_msg read_frame(struct input *in)
{
	static const uint32_t ids[] = {0x000, 0x600 + NODE_ID, 0x600 + NODE_ID, 0x080};
	static const uint32_t more[] = {0x7E5, 0x700 + NODE_ID, 0x720, 0x180 + NODE_ID};
	uint8_t kind = read_byte(in);
	struct can_msg msg = {.id = (kind & 0x84) == 0x04 ? more[kind & 3] : ids[kind & 3],
		.len = 8,
		.extended = (kind & 0x84) == 0x84,
		.remote = (kind & 0x88) == 0x88,
		.t_us = (kind & 0x40) != 0};

	if ((kind & 0x8C) == 0x0C) /* RPDO */
		msg.id = 0x200u + NODE_ID + 0x100u * (kind & 3);
	if (msg.id == 0x000)
		msg.len = 2;
	if (msg.id == 0x080)
		msg.len = 0;
	if (msg.id > 0x700 && msg.id < 0x7E5) /* node guarding and heartbeat */
		msg.len = 1;
	if (msg.id == 0x180 + NODE_ID || (msg.id == 0x700 + NODE_ID && kind & 0x40))
		msg.remote = true;
	if (kind & 0x20)
		msg.len = read_byte(in) % 9;
	if (kind & 0x10)
		msg.id = (uint32_t)(read_byte(in) << 8 | read_byte(in)) & 0x7FF;
	for (int i = 0; i < msg.len; i++)
		msg.data[i] = read_byte(in);
	return msg;
}

static uint64_t pass_time(struct input *in, uint64_t now_us)
{
	uint64_t end_us = now_us + ((uint64_t)read_byte(in) << (read_byte(in) & 15));

	for (int i = 0; i < MAX_TICKS && now_us <= end_us; i++) {
		uint64_t deadline_us = canopen_tick(&now.node, now_us);
		require(deadline_us > now_us);
		if (deadline_us > end_us)
			break;
		now_us = deadline_us;
	}
	return now_us;
}

static void power_on(struct world *initial, uint8_t node_id, uint64_t now_us)
{
	static const struct can_ops ops = {.send = port_send, .receive = port_receive, .filter = port_filter};
	static const struct canopen_device device = {.store = device_store,
		.restore = device_store,
		.change_threshold = device_change_threshold,
		.store_lss = device_store_lss,
		.bit_rate_possible = device_bit_rate_possible,
		.set_bit_rate = device_set_bit_rate};
	static const uint8_t eds[1000] = {1, 2, 3};

	now.port = (struct can_port){.ops = &ops};
	now.domain = (struct od_domain){.index = 0x1021, .data = eds, .size = sizeof(eds)};
	state_before = NMT_INITIALISING;
	od_init(&now.od, &imu9_od_table, &now.values, node_id);
	od_set_domain(&now.od, &now.domain);
	require(canopen_init(&now.node, &now.od, &now.port, &device, node_id) == 0);
	canopen_start(&now.node, now_us);
	*initial = now;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct input in = {data, size};
	uint64_t now_us = 1000;
	bool unconfigured = read_byte(&in) == 0xFF;

	if (!started[unconfigured].port.ops)
		power_on(&started[unconfigured], unconfigured ? CANOPEN_UNCONFIGURED : NODE_ID, now_us);
	now = started[unconfigured];
	answer = OD_OK;
	while (in.size > 0) {
		uint8_t operation = read_byte(&in);
		struct can_msg msg;

		state_before = canopen_nmt_state(&now.node);
		switch (operation & 7) {
		case 0:
			now_us = pass_time(&in, now_us);
			break;
		case 1:
			canopen_sample(&now.node, now_us);
			break;
		case 2:
			canopen_error_set(&now.node, (uint16_t)(0xFF00 | read_byte(&in)), read_byte(&in), NULL, now_us);
			break;
		case 3:
			canopen_error_clear(&now.node, (uint16_t)(0xFF00 | read_byte(&in)), now_us);
			break;
		case 4:
			answer = operation & 8 ? OD_PENDING : OD_OK;
			canopen_store_done(&now.node, operation & 16 ? OD_OK : OD_CANNOT_STORE, now_us);
			break;
		default:
			msg = read_frame(&in);
			canopen_receive(&now.node, &msg, now_us);
			break;
		}
		require(canopen_tick(&now.node, now_us) > now_us);
	}
	return 0;
}
