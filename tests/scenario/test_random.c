/* A hundred thousand random steps: frames that are nearly right, garbage, time, samples, errors, storage. Whatever
 * comes, the node says only what its NMT state allows, knows its next deadline, and serves NMT and SDO afterwards. */
#include "tests/scenario/bus.h"

#include <string.h>

enum { STEPS = 100000 };

/* xorshift32: the same steps on every machine */
static uint32_t next(uint32_t *seed)
{
	*seed ^= *seed << 13;
	*seed ^= *seed >> 17;
	*seed ^= *seed << 5;
	return *seed;
}

static uint32_t below(uint32_t *seed, uint32_t n)
{
	return next(seed) % n;
}

static void fill(uint32_t *seed, uint8_t *data)
{
	for (int i = 0; i < 8; i++)
		data[i] = (uint8_t)next(seed);
}

static struct can_msg garbage(uint32_t *seed)
{
	struct can_msg msg = {.id = below(seed, 0x800),
		.len = (uint8_t)below(seed, 9),
		.extended = below(seed, 8) == 0,
		.remote = below(seed, 8) == 0};

	fill(seed, msg.data);
	return msg;
}

static struct can_msg nmt(uint32_t *seed)
{
	static const uint8_t commands[] = {1, 1, 1, 2, 128, 128, 129, 130, 0, 255};
	struct can_msg msg = {.id = 0x000, .len = 2};

	msg.data[0] = commands[below(seed, sizeof(commands))];
	msg.data[1] = (uint8_t)(below(seed, 3) * BUS_NODE_ID);
	return msg;
}

/* A request for an object that exists, mostly, of any kind, with a value that means something, mostly. */
static struct can_msg sdo(uint32_t *seed, const struct od_table *table)
{
	static const uint8_t commands[] = {0x40, 0x40, 0x23, 0x27, 0x2B, 0x2F, 0x22, 0x21, 0x20, 0x60, 0x70, 0x00, 0x10,
		0x01, 0x11, 0x0D, 0x80, 0xA0, 0xA4, 0xA1, 0xA2, 0xA3, 0xC0, 0xC2, 0xC6, 0xE0};
	static const uint32_t values[] = {0, 1, 2, 3, 4, 100, 254, 255, 0x80000190, 0x40000190, 0xC0000290, 0x80,
		0x21000110, 0x210F0220, 0x10010008, 0x21080120, 0x65766173, 0x64616F6C};
	const struct od_entry *entry = &table->entries[below(seed, (uint32_t)table->count)];
	struct can_msg msg = {.id = 0x600 + BUS_NODE_ID, .len = 8};

	while (below(seed, 2) && entry->index >= 0x2000) /* the core's own objects more often */
		entry = &table->entries[below(seed, (uint32_t)table->count)];
	fill(seed, msg.data);
	if (below(seed, 4)) {
		uint32_t value = values[below(seed, sizeof(values) / sizeof(values[0]))];

		msg.data[0] = commands[below(seed, sizeof(commands))];
		msg.data[1] = (uint8_t)entry->index;
		msg.data[2] = (uint8_t)(entry->index >> 8);
		msg.data[3] = entry->sub;
		for (int i = 0; i < 4; i++)
			msg.data[4 + i] = (uint8_t)(value >> 8 * i);
	}
	if (below(seed, 20) == 0)
		msg.len = (uint8_t)below(seed, 9);
	return msg;
}

static struct can_msg sync(uint32_t *seed)
{
	struct can_msg msg = {.id = 0x080, .len = (uint8_t)(below(seed, 8) == 0), .t_us = 1};

	msg.data[0] = (uint8_t)below(seed, 242);
	return msg;
}

/* Every service but the one that gives another node-ID: the end of this test talks to node 10h. */
static struct can_msg lss(uint32_t *seed)
{
	static const uint8_t commands[] = {0x04, 0x04, 0x13, 0x15, 0x17, 0x40, 0x41, 0x42, 0x43, 0x46, 0x47, 0x48, 0x49,
		0x4A, 0x4B, 0x4C, 0x51, 0x5A, 0x5D, 0x5E, 0x5F, 0xFF};
	static const uint32_t values[] = {0, 1, 0x0200, 0x00494D55, 9, 0x00010000, 0xFFFFFFFF};
	uint32_t value = values[below(seed, sizeof(values) / sizeof(values[0]))];
	struct can_msg msg = {.id = 0x7E5, .len = 8};

	fill(seed, msg.data);
	msg.data[0] = commands[below(seed, sizeof(commands))];
	for (int i = 0; i < 4; i++)
		msg.data[1 + i] = (uint8_t)(value >> 8 * i);
	return msg;
}

static void run_a_while(struct bus *bus, uint32_t *seed)
{
	uint64_t end_us = bus->now_us + below(seed, 1u << below(seed, 22));

	for (int i = 0; i < 100 && bus->deadline_us <= end_us; i++) /* short event timers: not all of them */
		bus_run(bus, bus->deadline_us - bus->now_us);
	if (bus->deadline_us > end_us)
		bus_run(bus, end_us - bus->now_us);
}

static void step(struct bus *bus, uint32_t *seed)
{
	static const enum od_status answers[] = {OD_OK, OD_PENDING, OD_CANNOT_STORE};
	struct can_msg msg;

	switch (below(seed, 13)) {
	case 0:
		msg = garbage(seed);
		break;
	case 1:
		msg = nmt(seed);
		break;
	case 2:
	case 3:
	case 4:
	case 5:
	case 6:
		msg = sdo(seed, bus->od.table);
		break;
	case 7:
	case 8:
		msg = sync(seed);
		break;
	case 12:
		msg = lss(seed);
		break;
	case 9:
		bus_sample(bus, (uint16_t)next(seed));
		return;
	case 10:
		if (below(seed, 2))
			canopen_error_set(&bus->node, (uint16_t)(0xFF00 + below(seed, 20)), (uint8_t)next(seed), NULL,
				bus->now_us);
		else
			canopen_error_clear(&bus->node, (uint16_t)(0xFF00 + below(seed, 20)), bus->now_us);
		bus_tick(bus);
		return;
	default:
		bus->storage_answer = answers[below(seed, 3)];
		if (below(seed, 4) == 0)
			canopen_store_done(&bus->node, OD_OK, bus->now_us);
		run_a_while(bus, seed);
		return;
	}
	bus_send_msg(bus, &msg);
}

/* CiA 301, table 37. Nobody may move a PDO, SYNC or EMCY to one of these identifiers. */
static void check_what_was_said(const struct bus *bus)
{
	enum nmt_state now = canopen_nmt_state(&bus->node);

	for (size_t i = 0; i < bus->sent_count; i++) {
		const struct can_msg *msg = &bus->sent[i].msg;

		if (msg->id == 0x700 + BUS_NODE_ID) {
			assert_int_equal(msg->len, 1);
			assert_true(msg->data[0] == 0 || msg->data[0] == (uint8_t)now);
			continue;
		}
		if (msg->id == 0x7E4) {
			assert_int_equal(msg->len, 8);
			continue;
		}
		assert_true(now == NMT_PRE_OPERATIONAL || now == NMT_OPERATIONAL);
		assert_true(msg->id != 0x000 && (msg->id & 0x780) != 0x600);
		if (msg->id == 0x580 + BUS_NODE_ID)
			assert_int_equal(msg->len, 8);
	}
}

/* A bit rate that is being switched keeps the node silent for up to two minutes. */
static void wait_for_the_bit_rate(struct bus *bus)
{
	while (bus->node.lss.switching)
		bus_run(bus, bus->deadline_us - bus->now_us);
}

static void test_random_steps_neither_break_nor_jam_the_node(void **state)
{
	struct bus *bus = *state;
	uint32_t seed = 20261122;

	for (int i = 0; i < STEPS; i++) {
		step(bus, &seed);
		assert_true(bus->deadline_us > bus->now_us);
		check_what_was_said(bus);
		bus->sent_count = bus->seen = 0;
		if (below(&seed, 8) == 0)
			wait_for_the_bit_rate(bus);
		if (i % 1000)
			continue;
		wait_for_the_bit_rate(bus);
		bus_send(bus, "610 80 00 00 00 00 00 00 00");
		bus_send(bus, "000 80 10");
		bus_forget(bus);
		bus_send(bus, "610 40 00 10 00 00 00 00 00");
		bus_expect(bus, "590 43 00 10 00 9A 01 04 00");
		bus->sent_count = bus->seen = 0;
	}
	wait_for_the_bit_rate(bus);
	bus_forget(bus);
	bus_exchange(bus, "000 81 10", "710 00");
	bus_exchange(bus, "610 40 00 10 00 00 00 00 00", "590 43 00 10 00 9A 01 04 00");
	bus_exchange(bus, "610 2F 01 20 00 01 00 00 00", "590 60 01 20 00 00 00 00 00");
	bus_send(bus, "000 01 10");
	bus_send(bus, "080");
	assert_int_equal(bus->sent_count - bus->seen, 4);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		PRE_OPERATIONAL(test_random_steps_neither_break_nor_jam_the_node),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
