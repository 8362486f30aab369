#include "tests/scenario/bus.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int port_send(struct can_port *port, const struct can_msg *msg)
{
	struct bus *bus = (struct bus *)port;

	if (bus->full)
		return -ENOBUFS;
	assert_true(bus->sent_count < BUS_FRAMES);
	assert_true(msg->id <= 0x7FF && msg->len <= 8 && !msg->extended);
	bus->sent[bus->sent_count].t_us = bus->now_us;
	bus->sent[bus->sent_count].msg = *msg;
	bus->sent_count++;
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
	struct bus *bus = (struct bus *)port;

	assert_true(n <= sizeof(bus->filter) / sizeof(bus->filter[0]));
	memcpy(bus->filter, ids, n * sizeof(ids[0]));
	bus->filter_count = n;
	return 0;
}

static const struct can_ops port_ops = {.send = port_send, .receive = port_receive, .filter = port_filter};

static enum od_status device_store(void *ctx, enum od_group group)
{
	struct bus *bus = ctx;

	bus->store_calls++;
	bus->stored = group;
	return bus->storage_answer;
}

static enum od_status device_restore(void *ctx, enum od_group group)
{
	struct bus *bus = ctx;

	bus->restore_calls++;
	bus->restored = group;
	return bus->storage_answer;
}

static void device_reset(void *ctx, enum od_group group)
{
	struct bus *bus = ctx;

	bus->reset_calls++;
	bus->reset = group;
	od_reset(&bus->od, group, &bus->power_on);
}

static void device_nmt_changed(void *ctx, enum nmt_state nmt_state)
{
	struct bus *bus = ctx;

	if (bus->state_count < sizeof(bus->states) / sizeof(bus->states[0]))
		bus->states[bus->state_count++] = nmt_state;
}

static enum od_status device_store_lss(void *ctx, uint8_t node_id, uint32_t bit_s)
{
	struct bus *bus = ctx;

	bus->store_lss_calls++;
	bus->kept_node_id = node_id;
	bus->kept_bit_s = bit_s;
	return bus->storage_answer;
}

static bool device_bit_rate_possible(void *ctx, uint32_t bit_s)
{
	(void)ctx;
	return bit_s != 800000;
}

static void device_set_bit_rate(void *ctx, uint32_t bit_s)
{
	struct bus *bus = ctx;

	bus->active_bit_s = bit_s;
	bus->switched_us = bus->now_us;
}

static void device_time(void *ctx, uint16_t day, uint32_t ms, uint64_t t_us)
{
	struct bus *bus = ctx;

	bus->times++;
	bus->time_day = day;
	bus->time_ms = ms;
	bus->time_us = t_us;
}

static void device_collision(void *ctx, uint32_t id)
{
	struct bus *bus = ctx;

	bus->collisions++;
	bus->collision_id = id;
}

bool bus_listens_to(const struct bus *bus, uint32_t id)
{
	for (size_t i = 0; i < bus->filter_count; i++)
		if (bus->filter[i] == id)
			return true;
	return false;
}

void bus_tick(struct bus *bus)
{
	bus->deadline_us = canopen_tick(&bus->node, bus->now_us);
}

struct bus *bus_new_with_id(uint8_t node_id)
{
	struct bus *bus = test_calloc(1, sizeof(*bus));

	bus->port.ops = &port_ops;
	bus->now_us = 1000000;
	bus->node_id = node_id;
	od_init(&bus->od, &imu9_od_table, &bus->values, node_id);
	bus_put(bus, 0x1015, 0, 2, 0);
	bus_put(bus, 0x1017, 0, 2, 0);
	return bus;
}

struct bus *bus_new(void)
{
	return bus_new_with_id(BUS_NODE_ID);
}

void bus_start(struct bus *bus)
{
	const struct canopen_device device = {.ctx = bus,
		.store = device_store,
		.restore = device_restore,
		.reset = device_reset,
		.store_lss = device_store_lss,
		.bit_rate_possible = device_bit_rate_possible,
		.set_bit_rate = device_set_bit_rate,
		.time = device_time,
		.collision = device_collision,
		.nmt_changed = device_nmt_changed};

	bus->power_on = bus->values;
	assert_int_equal(canopen_init(&bus->node, &bus->od, &bus->port, &device, bus->node_id), 0);
	canopen_start(&bus->node, bus->now_us);
	bus_tick(bus);
}

int bus_pre_operational(void **state)
{
	struct bus *bus = bus_new();

	bus_start(bus);
	bus_expect(bus, "710 00");
	*state = bus;
	return 0;
}

int bus_operational(void **state)
{
	bus_pre_operational(state);
	bus_send(*state, "000 01 10");
	return 0;
}

int bus_teardown(void **state)
{
	test_free(*state);
	return 0;
}

void bus_send_msg(struct bus *bus, const struct can_msg *msg)
{
	canopen_receive(&bus->node, msg, bus->now_us);
	bus_tick(bus);
}

void bus_send(struct bus *bus, const char *frame)
{
	struct can_msg msg = {.t_us = bus->now_us};
	char *end;

	msg.id = (uint32_t)strtoul(frame, &end, 16);
	if (strcmp(end, " R") == 0) {
		msg.remote = true;
		end += 2;
	}
	while (*end) {
		assert_true(msg.len < 8);
		msg.data[msg.len++] = (uint8_t)strtoul(end, &end, 16);
	}
	bus_send_msg(bus, &msg);
}

static void format(const struct can_msg *msg, char *text, size_t size)
{
	int n = snprintf(text, size, "%03X%s", (unsigned)msg->id, msg->remote ? " R" : "");

	for (int i = 0; i < msg->len; i++)
		n += snprintf(text + n, size - (size_t)n, " %02X", msg->data[i]);
}

void bus_expect(struct bus *bus, const char *frame)
{
	char text[40] = "nothing";

	if (bus->seen < bus->sent_count) {
		format(&bus->sent[bus->seen].msg, text, sizeof(text));
		bus->seen_us = bus->sent[bus->seen].t_us;
		bus->seen++;
	}
	assert_string_equal(text, frame);
}

void bus_expect_nothing(struct bus *bus)
{
	if (bus->seen < bus->sent_count)
		bus_expect(bus, "nothing");
}

void bus_forget(struct bus *bus)
{
	bus->seen = bus->sent_count;
}

void bus_exchange(struct bus *bus, const char *request, const char *response)
{
	bus_send(bus, request);
	bus_expect(bus, response);
	bus_expect_nothing(bus);
}

/* Runs to the next deadline. A microsecond earlier nothing is due, and the deadline is the same. */
static void run_to_deadline(struct bus *bus)
{
	uint64_t deadline_us = bus->deadline_us;
	size_t sent = bus->sent_count;

	assert_true(deadline_us > bus->now_us);
	bus->now_us = deadline_us - 1;
	assert_true(canopen_tick(&bus->node, bus->now_us) == deadline_us);
	assert_int_equal(bus->sent_count, sent);
	bus->now_us = deadline_us;
	bus_tick(bus);
}

void bus_run(struct bus *bus, uint64_t us)
{
	uint64_t end_us = bus->now_us + us;

	while (bus->deadline_us <= end_us)
		run_to_deadline(bus);
	bus->now_us = end_us;
}

void bus_run_until_sent(struct bus *bus, uint64_t us)
{
	uint64_t end_us = bus->now_us + us;
	size_t sent = bus->sent_count;

	while (bus->deadline_us <= end_us && bus->sent_count == sent)
		run_to_deadline(bus);
	assert_true(bus->sent_count > sent);
}

void bus_reset(struct bus *bus, const char *command, const char *boot_up)
{
	bus_send(bus, command);
	bus_run(bus, 9999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, boot_up);
	bus_expect_nothing(bus);
}

void bus_expect_error_over(struct bus *bus)
{
	bus_run_until_sent(bus, 1000000);
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
}

void bus_sample(struct bus *bus, uint16_t counter)
{
	bus_put(bus, 0x210F, 1, 2, counter);
	canopen_sample(&bus->node, bus->now_us);
	bus_tick(bus);
}

static const uint8_t *sdo(struct bus *bus, uint8_t command, uint16_t index, uint8_t sub, uint32_t value)
{
	struct can_msg msg = {.id = 0x600 + BUS_NODE_ID,
		.len = 8,
		.data = {command, (uint8_t)index, (uint8_t)(index >> 8), sub, (uint8_t)value, (uint8_t)(value >> 8),
			(uint8_t)(value >> 16), (uint8_t)(value >> 24)}};

	bus_expect_nothing(bus);
	bus_send_msg(bus, &msg);
	assert_true(bus->sent_count > bus->seen);
	assert_int_equal(bus->sent[bus->seen].msg.id, 0x580 + BUS_NODE_ID);
	assert_memory_equal(bus->sent[bus->seen].msg.data + 1, msg.data + 1, 3);
	return bus->sent[bus->seen++].msg.data;
}

static uint32_t value_of(const uint8_t *answer)
{
	return answer[4] | (uint32_t)answer[5] << 8 | (uint32_t)answer[6] << 16 | (uint32_t)answer[7] << 24;
}

uint32_t bus_write(struct bus *bus, uint16_t index, uint8_t sub, size_t size, uint32_t value)
{
	const uint8_t *answer = sdo(bus, (uint8_t)(0x23 | (4 - size) << 2), index, sub, value);

	if (answer[0] == 0x80)
		return value_of(answer);
	assert_int_equal(answer[0], 0x60);
	return 0;
}

uint32_t bus_read(struct bus *bus, uint16_t index, uint8_t sub)
{
	const uint8_t *answer = sdo(bus, 0x40, index, sub, 0);

	assert_int_equal(answer[0] & 0xF3, 0x43);
	return value_of(answer);
}

void bus_put(struct bus *bus, uint16_t index, uint8_t sub, size_t size, uint32_t value)
{
	void *p = od_value(&bus->od, index, sub, size);

	assert_non_null(p);
	switch (size) {
	case 1:
		*(uint8_t *)p = (uint8_t)value;
		break;
	case 2:
		*(uint16_t *)p = (uint16_t)value;
		break;
	default:
		*(uint32_t *)p = value;
		break;
	}
}

const char *bus_writable_string(struct bus *bus)
{
	static struct od_entry entries[2000];
	static struct od_table table;
	struct od_entry *entry;

	table = imu9_od_table;
	assert_true(table.count <= sizeof(entries) / sizeof(entries[0]));
	memcpy(entries, table.entries, table.count * sizeof(entries[0]));
	table.entries = entries;
	bus->od.table = &table;
	entry = &entries[od_find(&imu9_od_table, 0x1009, 0, NULL) - imu9_od_table.entries];
	entry->access = OD_READ | OD_WRITE;
	return (const char *)&bus->values + entry->offset;
}
