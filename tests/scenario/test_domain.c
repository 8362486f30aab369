/* Large objects of the whole device, over the SDO client in simulated time: the configuration snapshot (2130h) and the
 * event log (2131h). The bytes of a concise DCF are those of CiA 302-3, put together by hand here. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/canopen/sdo_client.h"
#include "gateway/device.h"

enum { TIMEOUT_US = 100000, ANSWERS = 256, LARGE = OD_DOMAIN_MAX };

/* A device on a bus of its own, and its client. */
struct world {
	struct can_port bus;
	struct imu_port imu;
	struct device device;
	struct can_port client_bus; /* what the client sends goes to the device at once */
	struct sdo_client client;
	struct can_msg answers[ANSWERS]; /* of the device, not looked at yet */
	size_t answer_count;
	uint64_t now_us;
	uint8_t node_id;
	uint8_t value[LARGE + 100];
};

static struct world *world_of(const struct can_port *port, size_t offset)
{
	return (struct world *)((char *)(uintptr_t)port - offset);
}

static int from_device(struct can_port *port, const struct can_msg *msg)
{
	struct world *w = world_of(port, offsetof(struct world, bus));

	if (msg->id != 0x580u + w->node_id && msg->id != 0x6A6)
		return 0;
	assert_true(w->answer_count < ANSWERS);
	w->answers[w->answer_count++] = *msg;
	return 0;
}

static int to_device(struct can_port *port, const struct can_msg *msg)
{
	struct world *w = world_of(port, offsetof(struct world, client_bus));

	device_receive(&w->device, msg, w->now_us);
	return 0;
}

static int take_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port, (void)ids, (void)n;
	return 0;
}

static struct world *new_world(uint8_t node_id)
{
	static const struct can_ops device_ops = {.send = from_device, .filter = take_filter},
				    client_ops = {.send = to_device};
	struct world *w = calloc(1, sizeof(*w));

	assert_non_null(w);
	w->node_id = node_id;
	w->bus = (struct can_port){.ops = &device_ops, .fd = -1, .name = "vcan9"};
	w->client_bus = (struct can_port){.ops = &client_ops, .fd = -1};
	w->imu = (struct imu_port){.rate_hz = 100, .silence_us = 1000000000, .name = "none"};
	w->now_us = 5000000;
	od_init(&w->device.od, &imu9_od_table, &w->device.values, node_id);
	assert_int_equal(device_init(&w->device, &w->bus, &w->imu, NULL, NULL, node_id), 0);
	device_start(&w->device, false, w->now_us);
	sdo_client_init(&w->client, &w->client_bus, node_id, TIMEOUT_US);
	return w;
}

static int set_up(void **state)
{
	*state = new_world(16);
	return 0;
}

static int tear_down(void **state)
{
	free(*state);
	return 0;
}

static enum sdo_result finish(struct world *w)
{
	while (w->client.result == SDO_RUNNING) {
		size_t count = w->answer_count;

		for (size_t i = 0; i < count; i++)
			sdo_client_receive(&w->client, &w->answers[i], w->now_us);
		w->answer_count -= count;
		memmove(w->answers, w->answers + count, w->answer_count * sizeof(w->answers[0]));
		if (count)
			continue;
		uint64_t client_us = sdo_client_tick(&w->client, w->now_us),
			 device_us = device_tick(&w->device, w->now_us);
		if (w->answer_count == 0 && client_us > w->now_us)
			w->now_us = client_us < device_us ? client_us : device_us;
	}
	return w->client.result;
}

static enum sdo_result read_object(struct world *w, uint16_t index, uint8_t sub)
{
	sdo_client_upload(&w->client, index, sub, w->value, sizeof(w->value), w->now_us);
	return finish(w);
}

static enum sdo_result read_in_blocks(struct world *w, uint16_t index, uint8_t sub)
{
	sdo_client_block_upload(&w->client, index, sub, w->value, sizeof(w->value), w->now_us);
	return finish(w);
}

/* The abort code, or 0. */
static uint32_t write_object(struct world *w, uint16_t index, uint8_t sub, const void *data, size_t size)
{
	sdo_client_download(&w->client, index, sub, data, size, w->now_us);
	finish(w);
	assert_true(w->client.result == SDO_DONE || w->client.result == SDO_ABORTED);
	return w->client.abort_code;
}

static uint32_t write_in_blocks(struct world *w, uint16_t index, uint8_t sub, const void *data, size_t size)
{
	sdo_client_block_download(&w->client, index, sub, data, size, w->now_us);
	finish(w);
	assert_true(w->client.result == SDO_DONE || w->client.result == SDO_ABORTED);
	return w->client.abort_code;
}

static void must_write(struct world *w, uint16_t index, uint8_t sub, size_t size, uint32_t value)
{
	const uint8_t wire[] = {(uint8_t)value, (uint8_t)(value >> 8), (uint8_t)(value >> 16), (uint8_t)(value >> 24)};

	assert_int_equal(write_object(w, index, sub, wire, size), 0);
}

static uint32_t value_u32(struct world *w, uint16_t index, uint8_t sub)
{
	uint32_t value = 0;

	assert_int_equal(read_object(w, index, sub), SDO_DONE);
	memcpy(&value, w->value, w->client.size);
	return value;
}

static void nmt(struct world *w, uint8_t command)
{
	const struct can_msg msg = {.id = 0, .len = 2, .data = {command, w->node_id}};

	device_receive(&w->device, &msg, w->now_us);
}

/* ---- EDS --------------------------------------------------------------------------------------------------------- */

static void test_the_eds_is_read_at_1021h_either_way_and_1022h_says_that_it_is_plain(void **state)
{
	struct world *w = *state;
	static uint8_t eds[1 << 18];

	assert_int_equal(value_u32(w, 0x1022, 0), 0);
	for (int blocks = 0; blocks < 2; blocks++) {
		if (blocks)
			sdo_client_block_upload(&w->client, 0x1021, 0, eds, sizeof(eds), w->now_us);
		else
			sdo_client_upload(&w->client, 0x1021, 0, eds, sizeof(eds), w->now_us);
		assert_int_equal(finish(w), SDO_DONE);
		assert_int_equal(w->client.size, imu9_eds_size);
		assert_memory_equal(eds, imu9_eds, imu9_eds_size);
	}
}

/* ---- snapshot: to read ------------------------------------------------------------------------------------------- */

static void test_the_snapshot_is_a_concise_dcf_of_all_that_can_be_configured(void **state)
{
	struct world *w = *state;
	struct od_dcf_item item;
	size_t used = 0;
	bool *seen = calloc(imu9_od_table.count, sizeof(bool));

	assert_int_equal(read_object(w, 0x2130, 0), SDO_DONE);
	assert_true(od_dcf_valid(w->value, w->client.size));
	while (od_dcf_next(w->value, w->client.size, &used, &item)) {
		const struct od_entry *entry = od_find(&imu9_od_table, item.index, item.sub, NULL);

		assert_non_null(entry);
		seen[entry - imu9_od_table.entries] = true;
	}
	for (size_t i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *entry = &imu9_od_table.entries[i];
		bool configuration = (entry->access & OD_WRITE) && (entry->access & OD_STORED);
		bool mapping = (entry->index & 0xFA00) == 0x1A00 || (entry->index & 0xFE00) == 0x1600;

		if (!mapping || entry->sub == 0)
			assert_int_equal(seen[i], configuration);
	}
	free(seen);
}

static void test_the_snapshot_comes_in_blocks_too(void **state)
{
	struct world *w = *state;
	uint8_t segmented[LARGE];

	assert_int_equal(read_object(w, 0x2130, 0), SDO_DONE);
	size_t size = w->client.size;
	memcpy(segmented, w->value, size);
	assert_int_equal(read_in_blocks(w, 0x2130, 0), SDO_DONE);
	assert_int_equal(w->client.size, size);
	assert_memory_equal(w->value, segmented, size);
}

static void test_a_cob_id_that_follows_the_node_id_says_so_in_bit_29(void **state)
{
	struct world *w = *state;
	const uint8_t emcy[] = {0x14, 0x10, 0, 4, 0, 0, 0, 0x80, 0, 0, 0x20};
	const uint8_t pdo[] = {0x00, 0x18, 1, 4, 0, 0, 0, 0x80, 1, 0, 0x60};

	assert_int_equal(read_object(w, 0x2130, 0), SDO_DONE);
	assert_non_null(memmem(w->value, w->client.size, emcy, sizeof(emcy)));
	assert_non_null(memmem(w->value, w->client.size, pdo, sizeof(pdo)));
}

/* Anything that writes a snapshot entry by entry succeeds, as long as it adds the node-ID. */
static void test_each_entry_of_the_snapshot_can_be_written_by_itself_in_its_order(void **state)
{
	struct world *w = *state;
	static uint8_t snapshot[LARGE];
	struct od_dcf_item item;
	size_t used = 0;

	nmt(w, 1);
	assert_int_equal(read_object(w, 0x2130, 0), SDO_DONE);
	size_t size = w->client.size;
	memcpy(snapshot, w->value, size);
	while (od_dcf_next(snapshot, size, &used, &item)) {
		uint8_t data[8];

		assert_true(item.size <= sizeof(data));
		memcpy(data, item.data, item.size);
		bool cob_id =
			item.index == 0x1014 || (item.sub == 1 && (item.index >> 8 == 0x14 || item.index >> 8 == 0x18));

		if (cob_id && data[3] & 0x20) {
			data[3] &= 0xDF;
			data[0] = (uint8_t)(data[0] + 16);
		}
		if (write_object(w, item.index, item.sub, data, item.size))
			fail_msg("%04X:%02X: %08X", item.index, item.sub, (unsigned)w->client.abort_code);
	}
}

/* ---- snapshot: to another node ----------------------------------------------------------------------------------- */

static void configure(struct world *w)
{
	const float l = 0.125f, beta = 0.25f;

	must_write(w, 0x1801, 1, 4, 0xC0000290); /* TPDO2: four others, every third SYNC, another COB-ID */
	must_write(w, 0x1A01, 0, 1, 0);
	must_write(w, 0x1A01, 1, 4, 0x21030120);
	must_write(w, 0x1A01, 2, 4, 0x21030220);
	must_write(w, 0x1A01, 0, 1, 2);
	must_write(w, 0x1801, 2, 1, 3);
	must_write(w, 0x1801, 1, 4, 0x400002A5);
	must_write(w, 0x1803, 1, 4, 0x80000490); /* TPDO4: off */
	must_write(w, 0x1019, 0, 1, 10);
	must_write(w, 0x1006, 0, 4, 20000);
	must_write(w, 0x1005, 0, 4, 0x40000081);
	must_write(w, 0x1016, 1, 4, 0x00050100);
	must_write(w, 0x1016, 2, 4, 0x00060200);
	must_write(w, 0x1017, 0, 2, 250);
	must_write(w, 0x1201, 1, 4, 0x6A5);
	must_write(w, 0x1201, 2, 4, 0x6A6);
	assert_int_equal(write_object(w, 0x2000, 1, &l, 4), 0);
	assert_int_equal(write_object(w, 0x2030, 3, &beta, 4), 0);
	must_write(w, 0x2110, 1, 2, 10);
	must_write(w, 0x6000, 0, 2, 100);
	must_write(w, 0x1020, 1, 4, 15000);
	must_write(w, 0x1020, 2, 4, 12345678);
}

static void assert_same_configuration(const struct world *a, const struct world *b)
{
	for (size_t i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *entry = &imu9_od_table.entries[i];
		const uint8_t *x = (const uint8_t *)&a->device.values + entry->offset;
		const uint8_t *y = (const uint8_t *)&b->device.values + entry->offset;

		if ((entry->access & OD_WRITE) && (entry->access & OD_STORED) && !(entry->access & OD_NODE_ID) &&
			memcmp(x, y, entry->size))
			fail_msg("%04X:%02X differs", entry->index, entry->sub);
	}
}

static void bring_over(struct world *from, struct world *to)
{
	assert_int_equal(read_in_blocks(from, 0x2130, 0), SDO_DONE);
	assert_int_equal(write_in_blocks(to, 0x2130, 0, from->value, from->client.size), 0);
}

static void test_a_snapshot_brings_another_node_to_the_same_configuration(void **state)
{
	struct world *w = *state, *other = new_world(17);

	configure(w);
	bring_over(w, other);
	assert_same_configuration(w, other);
	free(other);
}

static void test_cob_ids_that_follow_the_node_id_follow_that_of_the_other_node(void **state)
{
	struct world *w = *state, *other = new_world(17);

	configure(w);
	must_write(other, 0x1014, 0, 4, 0x800000FF);
	bring_over(w, other);
	assert_int_equal(value_u32(other, 0x1014, 0), 0x91);
	assert_int_equal(value_u32(other, 0x1800, 1), 0x40000191);
	assert_int_equal(value_u32(other, 0x1801, 1), 0x400002A5); /* this one was chosen */
	assert_int_equal(value_u32(other, 0x1803, 1), 0x80000491);
	free(other);
}

static void test_a_node_that_is_busy_takes_a_snapshot_too(void **state)
{
	struct world *w = *state, *other = new_world(17);

	configure(other); /* produces SYNC, maps and watches otherwise */
	must_write(other, 0x1005, 0, 4, 0x81);
	must_write(other, 0x1005, 0, 4, 0x40000082);
	must_write(other, 0x1016, 3, 4, 0x00070200);
	nmt(other, 1);
	bring_over(w, other);
	assert_same_configuration(w, other);
	assert_int_equal(value_u32(other, 0x1801, 1), 0x40000291);
	assert_int_equal(value_u32(other, 0x1005, 0), 0x80);
	free(other);
}

static void test_the_identity_and_the_measurements_stay(void **state)
{
	struct world *w = *state, *other = new_world(17);

	w->device.values.identity.serial_number = 1111;
	other->device.values.identity.serial_number = 2222;
	bring_over(w, other);
	assert_int_equal(value_u32(other, 0x1018, 4), 2222);
	free(other);
}

static void test_the_date_of_the_configuration_comes_with_it(void **state)
{
	struct world *w = *state, *other = new_world(17);

	configure(w);
	bring_over(w, other);
	assert_int_equal(value_u32(other, 0x1020, 1), 15000);
	assert_int_equal(value_u32(other, 0x1020, 2), 12345678);
	free(other);
}

static void test_a_snapshot_read_and_written_back_changes_nothing(void **state)
{
	struct world *w = *state;
	static uint8_t before[LARGE];

	configure(w);
	assert_int_equal(read_object(w, 0x2130, 0), SDO_DONE);
	size_t size = w->client.size;
	memcpy(before, w->value, size);
	assert_int_equal(write_object(w, 0x2130, 0, before, size), 0);
	assert_int_equal(read_object(w, 0x2130, 0), SDO_DONE);
	assert_int_equal(w->client.size, size);
	assert_memory_equal(w->value, before, size);
}

/* ---- snapshot: refused ------------------------------------------------------------------------------------------- */

#define ENTRY_U8(index, sub, value) (uint8_t)(index), (uint8_t)((index) >> 8), sub, 1, 0, 0, 0, value
#define ENTRY_U16(index, sub, value) \
	(uint8_t)(index), (uint8_t)((index) >> 8), sub, 2, 0, 0, 0, (uint8_t)(value), (uint8_t)((value) >> 8)
#define ENTRY_U32(index, sub, value)                                                                           \
	(uint8_t)(index), (uint8_t)((index) >> 8), sub, 4, 0, 0, 0, (uint8_t)(value), (uint8_t)((value) >> 8), \
		(uint8_t)((value) >> 16), (uint8_t)((uint32_t)(value) >> 24)
#define GOOD_ENTRY ENTRY_U16(0x1017, 0, 777)

/* Refused with this code, and not even the entry before took effect. */
static void assert_refused(struct world *w, const uint8_t *dcf, size_t size, uint32_t code)
{
	static struct od_values before;

	before = w->device.values;
	assert_int_equal(write_object(w, 0x2130, 0, dcf, size), code);
	before.error_register = w->device.values.error_register;
	for (size_t i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *entry = &imu9_od_table.entries[i];

		if ((entry->access & OD_STORED) && memcmp((uint8_t *)&before + entry->offset,
							   (uint8_t *)&w->device.values + entry->offset, entry->size))
			fail_msg("%04X:%02X has changed", entry->index, entry->sub);
	}
}

#define ASSERT_REFUSED(w, code, ...)                                         \
	do {                                                                 \
		const uint8_t dcf[] = {2, 0, 0, 0, GOOD_ENTRY, __VA_ARGS__}; \
		assert_refused(w, dcf, sizeof(dcf), code);                   \
	} while (0)

static void test_some_entries_alone_are_taken_over(void **state)
{
	struct world *w = *state;
	const uint8_t dcf[] = {2, 0, 0, 0, GOOD_ENTRY, ENTRY_U8(0x2001, 0, 1)};

	assert_int_equal(write_object(w, 0x2130, 0, dcf, sizeof(dcf)), 0);
	assert_int_equal(value_u32(w, 0x1017, 0), 777);
	assert_int_equal(value_u32(w, 0x2001, 0), 1);
}

static void test_a_snapshot_without_entries_changes_nothing(void **state)
{
	assert_int_equal(write_object(*state, 0x2130, 0, (const uint8_t[4]){0}, 4), 0);
}

static void test_an_entry_that_does_not_exist_refuses_the_whole(void **state)
{
	ASSERT_REFUSED(*state, 0x06020000, ENTRY_U8(0x2FFF, 0, 1));
	ASSERT_REFUSED(*state, 0x06090011, ENTRY_U32(0x2000, 9, 0));
}

static void test_what_is_no_configuration_refuses_the_whole(void **state)
{
	ASSERT_REFUSED(*state, 0x06010002, ENTRY_U32(0x1018, 4, 1));	      /* identity */
	ASSERT_REFUSED(*state, 0x06010000, ENTRY_U32(0x1010, 1, 0x65766173)); /* a command */
	ASSERT_REFUSED(*state, 0x06010000, ENTRY_U8(0x2040, 6, 1));
	ASSERT_REFUSED(*state, 0x06010000, 0x30, 0x21, 0, 4, 0, 0, 0, 0, 0, 0, 0); /* itself */
}

static void test_a_value_of_the_wrong_size_or_beyond_its_limits_refuses_the_whole(void **state)
{
	ASSERT_REFUSED(*state, 0x06070012, ENTRY_U16(0x2001, 0, 1));
	ASSERT_REFUSED(*state, 0x06070013, ENTRY_U8(0x1017, 0, 1));
	ASSERT_REFUSED(*state, 0x06090031, ENTRY_U8(0x2001, 0, 99));
	ASSERT_REFUSED(*state, 0x06090030, ENTRY_U32(0x2000, 1, 0x7FC00000)); /* not a number */
}

static void test_a_value_that_the_object_itself_refuses_takes_back_what_came_before(void **state)
{
	ASSERT_REFUSED(*state, 0x06090030, ENTRY_U16(0x6000, 0, 7));
	ASSERT_REFUSED(*state, 0x06010000, ENTRY_U8(0x1A00, 0, 0)); /* the PDO is in use */
}

static void test_values_that_contradict_each_other_are_refused(void **state)
{
	ASSERT_REFUSED(*state, 0x06040043, ENTRY_U32(0x2050, 4, 0)); /* a singular matrix */
}

static void test_bytes_that_are_no_concise_dcf_are_refused(void **state)
{
	struct world *w = *state;
	const uint8_t dcf[] = {1, 0, 0, 0, GOOD_ENTRY, 0};

	assert_refused(w, dcf, 3, 0x06040043);
	assert_refused(w, dcf, sizeof(dcf) - 2, 0x06040043); /* cut */
	assert_refused(w, dcf, sizeof(dcf), 0x06040043);     /* a byte too many */
}

static void test_a_snapshot_that_is_too_long_is_refused_before_it_comes(void **state)
{
	struct world *w = *state;
	static const uint8_t bytes[LARGE + 1];

	assert_int_equal(write_object(w, 0x2130, 0, bytes, sizeof(bytes)), 0x06070012);
	assert_int_equal(w->client.size, 0);
	assert_int_equal(write_in_blocks(w, 0x2130, 0, bytes, sizeof(bytes)), 0x06070012);
	assert_int_equal(w->client.size, 0);
}

static void request(struct world *w, const uint8_t data[8])
{
	struct can_msg msg = {.id = 0x610, .len = 8};

	memcpy(msg.data, data, 8);
	w->answer_count = 0;
	device_receive(&w->device, &msg, w->now_us);
}

static void assert_answer(const struct world *w, const uint8_t data[8])
{
	assert_int_equal(w->answer_count, 1);
	assert_memory_equal(w->answers[0].data, data, 8);
}

/* A client that does not say how much it has. */
static void test_a_segmented_download_without_a_size_ends_where_the_buffer_does(void **state)
{
	struct world *w = *state;
	uint8_t toggle = 0;

	request(w, (const uint8_t[8]){0x20, 0x30, 0x21});
	for (size_t done = 0; done + 7 <= OD_DOMAIN_MAX; done += 7, toggle ^= 0x10) {
		request(w, (const uint8_t[8]){toggle});
		assert_answer(w, (const uint8_t[8]){0x20 | toggle});
	}
	request(w, (const uint8_t[8]){toggle});
	assert_answer(w, (const uint8_t[8]){0x80, 0x30, 0x21, 0, 0x12, 0x00, 0x07, 0x06});
}

static void test_a_block_download_without_a_size_ends_where_the_buffer_does(void **state)
{
	struct world *w = *state;
	size_t done = 0;
	uint8_t sequence = 0;

	request(w, (const uint8_t[8]){0xC0, 0x30, 0x21});
	assert_answer(w, (const uint8_t[8]){0xA4, 0x30, 0x21, 0, 31});
	while (done < OD_DOMAIN_MAX) {
		sequence = sequence % 31 + 1;
		request(w, (const uint8_t[8]){sequence});
		assert_int_equal(w->answer_count, sequence == 31);
		done += 7;
	}
	request(w, (const uint8_t[8]){sequence + 1});
	assert_answer(w, (const uint8_t[8]){0x80, 0x30, 0x21, 0, 0x12, 0x00, 0x07, 0x06});
}

static void test_four_bytes_are_a_domain_too(void **state)
{
	struct world *w = *state;

	request(w, (const uint8_t[8]){0x23, 0x30, 0x21}); /* no entries */
	assert_answer(w, (const uint8_t[8]){0x60, 0x30, 0x21});
	request(w, (const uint8_t[8]){0x27, 0x30, 0x21}); /* three bytes are nothing */
	assert_answer(w, (const uint8_t[8]){0x80, 0x30, 0x21, 0, 0x43, 0x00, 0x04, 0x06});
}

static void test_a_wrong_crc_takes_nothing_over(void **state)
{
	struct world *w = *state;

	request(w, (const uint8_t[8]){0xC6, 0x30, 0x21, 0, 13});
	request(w, (const uint8_t[8]){1, 1, 0, 0, 0, 0x17, 0x10, 0});
	request(w, (const uint8_t[8]){0x82, 2, 0, 0, 0, 0x09, 0x03});
	request(w, (const uint8_t[8]){0xC5, 0x12, 0x34});
	assert_answer(w, (const uint8_t[8]){0x80, 0x30, 0x21, 0, 0x04, 0x00, 0x04, 0x05});
	w->answer_count = 0;
	assert_int_equal(value_u32(w, 0x1017, 0), 1000);
}

static void test_a_download_that_is_broken_off_leaves_nothing(void **state)
{
	struct world *w = *state;
	const uint8_t dcf[] = {2, 0, 0, 0, GOOD_ENTRY, ENTRY_U8(0x2001, 0, 1)};
	const struct can_msg abort = {.id = 0x610, .len = 8, .data = {0x80, 0x30, 0x21}};

	sdo_client_download(&w->client, 0x2130, 0, dcf, sizeof(dcf), w->now_us);
	sdo_client_receive(&w->client, &w->answers[0], w->now_us); /* the first segment */
	sdo_client_receive(&w->client, &w->answers[1], w->now_us); /* the second */
	device_receive(&w->device, &abort, w->now_us);
	w->answer_count = 0;
	assert_int_equal(value_u32(w, 0x1017, 0), 1000);
	assert_int_equal(value_u32(w, 0x2001, 0), 2);
}

static void test_a_domain_that_is_only_read_refuses_a_write(void **state)
{
	assert_int_equal(write_object(*state, 0x2131, 0, "x", 1), 0x06010002);
	assert_int_equal(write_object(*state, 0x1021, 0, "12345", 5), 0x06010002);
}

/* ---- event log --------------------------------------------------------------------------------------------------- */

static const char *read_log(struct world *w)
{
	assert_int_equal(read_in_blocks(w, 0x2131, 0), SDO_DONE);
	w->value[w->client.size] = '\0';
	return (const char *)w->value;
}

static void assert_logged(struct world *w, const char *text)
{
	if (!strstr(read_log(w), text))
		fail_msg("'%s' is not in:\n%s", text, (const char *)w->value);
}

static void test_the_log_tells_the_start_and_each_change_of_the_nmt_state(void **state)
{
	struct world *w = *state;

	w->now_us += 1234567;
	nmt(w, 1);
	assert_logged(w, "      0.000000 started with node-ID 16 on vcan9, IMU none\n");
	assert_logged(w, "      1.234567 NMT state: operational\n");
}

static void test_the_log_tells_errors_and_their_end(void **state)
{
	struct world *w = *state;

	canopen_error_set(&w->device.canopen, 0x8130, 0x10, (const uint8_t[5]){5}, w->now_us);
	canopen_error_clear(&w->device.canopen, 0x8130, w->now_us);
	assert_logged(w, "error 8130h, EMCY with 05 00 00 00 00\n");
	assert_logged(w, "error 8130h is over\n");
}

static void test_the_log_tells_bus_states(void **state)
{
	struct world *w = *state;

	w->bus.state = CAN_STATE_BUS_OFF;
	device_tick(&w->device, w->now_us);
	w->bus.state = CAN_STATE_ACTIVE;
	device_tick(&w->device, w->now_us);
	assert_logged(w, "vcan9: bus-off\n");
	assert_logged(w, "vcan9: error active\n");
}

static void test_the_log_tells_that_the_sensor_is_lost_and_back(void **state)
{
	struct world *w = *state;
	const struct imu_sample sample = {.t_us = 1000, .accel_m_s2 = {0, 0, 9.8}};

	device_sample(&w->device, -5, NULL, w->now_us);
	device_sample(&w->device, 1, &sample, w->now_us);
	assert_logged(w, "no samples from none");
	assert_logged(w, "samples from none again\n");
}

static void test_the_log_tells_resets_and_configurations(void **state)
{
	struct world *w = *state;
	const uint8_t dcf[] = {1, 0, 0, 0, GOOD_ENTRY}, bad[] = {1, 0, 0, 0, ENTRY_U8(0x2001, 0, 99)};

	assert_int_equal(write_object(w, 0x2130, 0, dcf, sizeof(dcf)), 0);
	write_object(w, 0x2130, 0, bad, sizeof(bad));
	nmt(w, 0x82);
	nmt(w, 0x81);
	assert_logged(w, "configuration snapshot of 1 entries taken over\n");
	assert_logged(w, "configuration snapshot refused: 2001h:00: ");
	assert_logged(w, "reset communication\n");
	assert_logged(w, "reset node\n");
}

static void test_a_full_log_drops_its_oldest_lines_whole(void **state)
{
	struct world *w = *state;

	for (int i = 0; i < 3000; i++)
		event_log_add(&w->device.log, w->now_us, "event %d", i);
	const char *text = read_log(w);
	size_t size = w->client.size;
	assert_true(size <= OD_DOMAIN_MAX && size > OD_DOMAIN_MAX - 100);
	assert_null(strstr(text, "event 5\n"));
	assert_string_equal(text + size - strlen(" event 2999\n"), " event 2999\n");
	int first = 0;
	assert_int_equal(sscanf(text, " 0.000000 event %d\n", &first), 1);
	for (int i = first; i < 3000; i++) {
		char line[64];

		snprintf(line, sizeof(line), "      0.000000 event %d\n", i);
		assert_int_equal(strncmp(text, line, strlen(line)), 0);
		text += strlen(line);
	}
	assert_string_equal(text, "");
}

static void test_a_very_long_event_is_cut(void **state)
{
	struct world *w = *state;
	char text[1000];

	memset(text, 'x', sizeof(text) - 1);
	text[sizeof(text) - 1] = '\0';
	event_log_add(&w->device.log, w->now_us, "%s", text);
	event_log_add(&w->device.log, w->now_us, "next");
	assert_logged(w, "xxx\n      0.000000 next\n");
}

static void test_a_transfer_shows_the_log_of_its_beginning(void **state)
{
	struct world *w = *state;

	sdo_client_upload(&w->client, 0x2131, 0, w->value, sizeof(w->value), w->now_us);
	uint32_t size = w->answers[0].data[4] | (uint32_t)w->answers[0].data[5] << 8;
	for (int i = 0; i < 3000; i++)
		event_log_add(&w->device.log, w->now_us, "event %d", i);
	assert_int_equal(finish(w), SDO_DONE);
	assert_int_equal(w->client.size, size);
	w->value[size] = '\0';
	assert_non_null(strstr((char *)w->value, "started with node-ID 16"));
	assert_null(strstr((char *)w->value, "event"));
}

static void test_both_sdo_channels_read_their_own_log_at_once(void **state)
{
	struct world *w = *state;
	const struct can_msg open = {.id = 0x6A5, .len = 8, .data = {0x40, 0x31, 0x21}};
	const struct can_msg segment = {.id = 0x6A5, .len = 8, .data = {0x60}};

	must_write(w, 0x1201, 1, 4, 0x6A5);
	must_write(w, 0x1201, 2, 4, 0x6A6);
	sdo_client_upload(&w->client, 0x2131, 0, w->value, sizeof(w->value), w->now_us);
	size_t first = w->answers[0].data[4];
	event_log_add(&w->device.log, w->now_us, "in between");
	device_receive(&w->device, &open, w->now_us);
	assert_int_equal(w->answers[1].data[4], first + strlen("      0.000000 in between\n"));
	device_receive(&w->device, &segment, w->now_us);
	assert_memory_equal(w->answers[2].data + 1, "      0", 7);
	w->answer_count = 1;
	assert_int_equal(finish(w), SDO_DONE);
	assert_int_equal(w->client.size, first);
}

#define WITH_DEVICE(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)

int main(void)
{
	const struct CMUnitTest tests[] = {
		WITH_DEVICE(test_the_eds_is_read_at_1021h_either_way_and_1022h_says_that_it_is_plain),
		WITH_DEVICE(test_the_snapshot_is_a_concise_dcf_of_all_that_can_be_configured),
		WITH_DEVICE(test_the_snapshot_comes_in_blocks_too),
		WITH_DEVICE(test_a_cob_id_that_follows_the_node_id_says_so_in_bit_29),
		WITH_DEVICE(test_each_entry_of_the_snapshot_can_be_written_by_itself_in_its_order),
		WITH_DEVICE(test_a_snapshot_brings_another_node_to_the_same_configuration),
		WITH_DEVICE(test_cob_ids_that_follow_the_node_id_follow_that_of_the_other_node),
		WITH_DEVICE(test_a_node_that_is_busy_takes_a_snapshot_too),
		WITH_DEVICE(test_the_identity_and_the_measurements_stay),
		WITH_DEVICE(test_the_date_of_the_configuration_comes_with_it),
		WITH_DEVICE(test_a_snapshot_read_and_written_back_changes_nothing),
		WITH_DEVICE(test_some_entries_alone_are_taken_over),
		WITH_DEVICE(test_a_snapshot_without_entries_changes_nothing),
		WITH_DEVICE(test_an_entry_that_does_not_exist_refuses_the_whole),
		WITH_DEVICE(test_what_is_no_configuration_refuses_the_whole),
		WITH_DEVICE(test_a_value_of_the_wrong_size_or_beyond_its_limits_refuses_the_whole),
		WITH_DEVICE(test_a_value_that_the_object_itself_refuses_takes_back_what_came_before),
		WITH_DEVICE(test_values_that_contradict_each_other_are_refused),
		WITH_DEVICE(test_bytes_that_are_no_concise_dcf_are_refused),
		WITH_DEVICE(test_a_snapshot_that_is_too_long_is_refused_before_it_comes),
		WITH_DEVICE(test_a_segmented_download_without_a_size_ends_where_the_buffer_does),
		WITH_DEVICE(test_a_block_download_without_a_size_ends_where_the_buffer_does),
		WITH_DEVICE(test_four_bytes_are_a_domain_too),
		WITH_DEVICE(test_a_wrong_crc_takes_nothing_over),
		WITH_DEVICE(test_a_download_that_is_broken_off_leaves_nothing),
		WITH_DEVICE(test_a_domain_that_is_only_read_refuses_a_write),
		WITH_DEVICE(test_the_log_tells_the_start_and_each_change_of_the_nmt_state),
		WITH_DEVICE(test_the_log_tells_errors_and_their_end),
		WITH_DEVICE(test_the_log_tells_bus_states),
		WITH_DEVICE(test_the_log_tells_that_the_sensor_is_lost_and_back),
		WITH_DEVICE(test_the_log_tells_resets_and_configurations),
		WITH_DEVICE(test_a_full_log_drops_its_oldest_lines_whole),
		WITH_DEVICE(test_a_very_long_event_is_cut),
		WITH_DEVICE(test_a_transfer_shows_the_log_of_its_beginning),
		WITH_DEVICE(test_both_sdo_channels_read_their_own_log_at_once),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
