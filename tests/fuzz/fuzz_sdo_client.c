/* The SDO client against a server that answers anything, at any time. The client stays within its buffer, sends only
 * requests of its node, and ends each transfer. */
#include <string.h>

#include "gateway/canopen/client/sdo_client.h"
#include "tests/fuzz/fuzz.h"

enum { NODE = 5, TIMEOUT_US = 500000, CAPACITY = 200, GUARD = 16, STEPS = 200 };

static uint8_t memory[CAPACITY + GUARD];
static unsigned sent;

static int port_send(struct can_port *port, const struct can_msg *msg)
{
	(void)port;
	require(msg->id == 0x600 + NODE && msg->len == 8 && !msg->extended && !msg->remote);
	sent++;
	return 0;
}

static void start(struct sdo_client *client, struct input *in, uint64_t now_us)
{
	uint8_t kind = read_byte(in);
	uint16_t index = (uint16_t)(0x1000 | (kind & 0xF0));
	size_t size = read_byte(in) % (CAPACITY + 1);

	memset(memory + size, 0xA5, sizeof(memory) - size);
	switch (kind & 3) {
	case 0:
		sdo_client_upload(client, index, kind & 1, memory, size, now_us);
		break;
	case 1:
		sdo_client_block_upload(client, index, 0, memory, size, now_us);
		break;
	case 2:
		sdo_client_download(client, index, 0, memory, size, now_us);
		break;
	default:
		sdo_client_block_download(client, index, 0, memory, size, now_us);
		break;
	}
	for (int i = 0; i < STEPS && client->result == SDO_RUNNING && in->size > 0; i++) {
		struct can_msg msg = {.id = 0x580 + NODE, .len = 8, .t_us = now_us};
		uint8_t what = read_byte(in);
		uint64_t deadline_us;

		if (what & 0x80) { /* the command byte as it is, and its index, so that answers often fit */
			msg.data[0] = read_byte(in);
			msg.data[1] = (uint8_t)index;
			msg.data[2] = (uint8_t)(index >> 8);
			read_bytes(in, msg.data + 4, what & 4);
		} else {
			read_bytes(in, msg.data, 8);
		}
		if (what & 0x40)
			msg.len = what & 7;
		sdo_client_receive(client, &msg, now_us);
		now_us += (uint64_t)(what & 0x30) * 10000;
		deadline_us = sdo_client_tick(client, now_us);
		require(client->result != SDO_RUNNING || deadline_us <= now_us + TIMEOUT_US);
	}
	if (client->result == SDO_RUNNING)
		sdo_client_tick(client, now_us + 2 * TIMEOUT_US);
	for (int i = 0; i < 10 && client->result == SDO_RUNNING; i++) /* a block is repeated before it is given up */
		sdo_client_tick(client, now_us + (uint64_t)(4 + 2 * i) * TIMEOUT_US);
	require(client->result != SDO_RUNNING && client->result != SDO_IDLE);
	require(client->result != SDO_DONE || client->size <= size);
	for (size_t i = size; i < sizeof(memory); i++)
		require(memory[i] == 0xA5);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	static const struct can_ops ops = {.send = port_send};
	struct can_port bus = {.ops = &ops, .fd = -1};
	struct sdo_client client;
	struct input in = {data, size};

	sent = 0;
	sdo_client_init(&client, &bus, NODE, TIMEOUT_US);
	while (in.size > 0)
		start(&client, &in, 1000);
	require(sent <= 130 * (unsigned)(size + 10)); /* a block has 127 segments */
	return 0;
}
