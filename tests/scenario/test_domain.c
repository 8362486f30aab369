/* Large objects of a whole device, by the SDO client in simulated time: EDS (1021h), configuration snapshot (2130h) and
 * event log (2131h). The bytes of a concise DCF (CiA 302-3) are written out here. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/canopen/client/sdo_client.h"
#include "tests/scenario/world.h"

enum { TIMEOUT_US = 100000, ANSWERS = 256, LARGE = OD_DOMAIN_MAX };

/* A device and its SDO client. */
struct pair {
	struct world world;
	struct can_port client_bus; /* frames of the client are received by the device at once */
	struct sdo_client client;
	struct can_msg answers[ANSWERS]; /* responses of the device that the client has not received yet */
	size_t answer_count;
	uint8_t value[LARGE + 100];
};

static int from_device(struct can_port *port, const struct can_msg *msg)
{
	struct pair *p = (struct pair *)port;

	if (msg->id != 0x580u + p->world.node_id && msg->id != 0x6A6)
		return 0;
	assert_true(p->answer_count < ANSWERS);
	p->answers[p->answer_count++] = *msg;
	return 0;
}

static int to_device(struct can_port *port, const struct can_msg *msg)
{
	struct pair *p = (struct pair *)((char *)port - offsetof(struct pair, client_bus));

	device_receive(&p->world.device, msg, p->world.now_us);
	device_tick(&p->world.device, p->world.now_us);
	return 0;
}

static int take_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port, (void)ids, (void)n;
	return 0;
}

static struct pair *new_pair(uint8_t node_id)
{
	static const struct can_ops device_ops = {.send = from_device, .filter = take_filter},
				    client_ops = {.send = to_device};
	struct pair *p = calloc(1, sizeof(*p));

	assert_non_null(p);
	world_init(&p->world, sensor_preset("ideal"), 1, "rest");
	p->world.node_id = node_id;
	p->world.now_us = 5000000;
	p->world.bus = (struct can_port){.ops = &device_ops, .fd = -1, .name = "vcan9"};
	p->world.imu = (struct imu_port){.rate_hz = 100, .silence_us = 1000000000, .name = "none"};
	world_power_on(&p->world, NULL);
	p->client_bus = (struct can_port){.ops = &client_ops, .fd = -1};
	sdo_client_init(&p->client, &p->client_bus, node_id, TIMEOUT_US);
	return p;
}

static int set_up(void **state)
{
	*state = new_pair(16);
	return 0;
}

static enum sdo_result finish(struct pair *p)
{
	while (p->client.result == SDO_RUNNING) {
		size_t count = p->answer_count;

		for (size_t i = 0; i < count; i++)
			sdo_client_receive(&p->client, &p->answers[i], p->world.now_us);
		p->answer_count -= count;
		memmove(p->answers, p->answers + count, p->answer_count * sizeof(p->answers[0]));
		if (count)
			continue;
		uint64_t client_us = sdo_client_tick(&p->client, p->world.now_us),
			 device_us = device_tick(&p->world.device, p->world.now_us);
		if (p->answer_count == 0 && client_us > p->world.now_us)
			p->world.now_us = client_us < device_us ? client_us : device_us;
	}
	return p->client.result;
}

static enum sdo_result read_object(struct pair *p, uint16_t index, uint8_t sub)
{
	sdo_client_upload(&p->client, index, sub, p->value, sizeof(p->value), p->world.now_us);
	return finish(p);
}

static enum sdo_result read_in_blocks(struct pair *p, uint16_t index, uint8_t sub)
{
	sdo_client_block_upload(&p->client, index, sub, p->value, sizeof(p->value), p->world.now_us);
	return finish(p);
}

/* The abort code, or 0. */
static uint32_t write_object(struct pair *p, uint16_t index, uint8_t sub, const void *data, size_t size)
{
	sdo_client_download(&p->client, index, sub, data, size, p->world.now_us);
	finish(p);
	assert_true(p->client.result == SDO_DONE || p->client.result == SDO_ABORTED);
	return p->client.abort_code;
}

static uint32_t write_in_blocks(struct pair *p, uint16_t index, uint8_t sub, const void *data, size_t size)
{
	sdo_client_block_download(&p->client, index, sub, data, size, p->world.now_us);
	finish(p);
	assert_true(p->client.result == SDO_DONE || p->client.result == SDO_ABORTED);
	return p->client.abort_code;
}

static void must_write(struct pair *p, uint16_t index, uint8_t sub, size_t size, uint32_t value)
{
	const uint8_t wire[] = {(uint8_t)value, (uint8_t)(value >> 8), (uint8_t)(value >> 16), (uint8_t)(value >> 24)};

	assert_int_equal(write_object(p, index, sub, wire, size), 0);
}

static uint32_t value_u32(struct pair *p, uint16_t index, uint8_t sub)
{
	uint32_t value = 0;

	assert_int_equal(read_object(p, index, sub), SDO_DONE);
	memcpy(&value, p->value, p->client.size);
	return value;
}

/* ---- EDS --------------------------------------------------------------------------------------------------------- */

static void test_the_eds_is_read_at_1021h_by_segments_and_blocks_and_1022h_is_plain_text(void **state)
{
	struct pair *p = *state;
	static uint8_t eds[1 << 18];

	assert_int_equal(value_u32(p, 0x1022, 0), 0);
	for (int blocks = 0; blocks < 2; blocks++) {
		if (blocks)
			sdo_client_block_upload(&p->client, 0x1021, 0, eds, sizeof(eds), p->world.now_us);
		else
			sdo_client_upload(&p->client, 0x1021, 0, eds, sizeof(eds), p->world.now_us);
		assert_int_equal(finish(p), SDO_DONE);
		assert_int_equal(p->client.size, imu9_eds_size);
		assert_memory_equal(eds, imu9_eds, imu9_eds_size);
	}
}

static void test_the_eds_has_the_configured_vendor_id_and_is_else_as_built(void **state)
{
	struct pair *p = *state;
	static char eds[1 << 18], built[1 << 18];
	const char *device_info, *identity;

	p->world.vendor = 0x1000ABC;
	world_power_on(&p->world, NULL);
	assert_int_equal(value_u32(p, 0x1018, 1), 0x1000ABC);
	sdo_client_block_upload(&p->client, 0x1021, 0, (uint8_t *)eds, sizeof(eds) - 1, p->world.now_us);
	assert_int_equal(finish(p), SDO_DONE);
	assert_int_equal(p->client.size, imu9_eds_size);
	device_info = strstr(eds, "\nVendorNumber=0x01000ABC\r\n");
	identity = strstr(eds, "\nDefaultValue=0x01000ABC\r\n");
	assert_non_null(device_info);
	assert_true(device_info > strstr(eds, "[DeviceInfo]") && device_info < strstr(eds, "[DummyUsage]"));
	assert_non_null(identity);
	assert_true(identity > strstr(eds, "[1018sub1]") && identity < strstr(eds, "[1018sub2]"));
	memcpy(built, imu9_eds, imu9_eds_size);
	memcpy(built + (device_info - eds), device_info, strlen("\nVendorNumber=0x01000ABC"));
	memcpy(built + (identity - eds), identity, strlen("\nDefaultValue=0x01000ABC"));
	assert_string_equal(eds, built);
}

/* ---- snapshot: upload -------------------------------------------------------------------------------------------- */

static void test_the_snapshot_is_a_concise_dcf_of_every_configuration_object(void **state)
{
	struct pair *p = *state;
	struct od_dcf_item item;
	size_t used = 0;
	bool *seen = calloc(imu9_od_table.count, sizeof(bool));

	assert_int_equal(read_object(p, 0x2130, 0), SDO_DONE);
	assert_true(od_dcf_valid(p->value, p->client.size));
	while (od_dcf_next(p->value, p->client.size, &used, &item)) {
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

static void test_the_snapshot_is_uploaded_in_blocks_too(void **state)
{
	struct pair *p = *state;
	uint8_t segmented[LARGE];

	assert_int_equal(read_object(p, 0x2130, 0), SDO_DONE);
	size_t size = p->client.size;
	memcpy(segmented, p->value, size);
	assert_int_equal(read_in_blocks(p, 0x2130, 0), SDO_DONE);
	assert_int_equal(p->client.size, size);
	assert_memory_equal(p->value, segmented, size);
}

static void test_a_cob_id_that_follows_the_node_id_has_bit_29_set(void **state)
{
	struct pair *p = *state;
	const uint8_t emcy[] = {0x14, 0x10, 0, 4, 0, 0, 0, 0x80, 0, 0, 0x20};
	const uint8_t pdo[] = {0x00, 0x18, 1, 4, 0, 0, 0, 0x80, 1, 0, 0x60};

	assert_int_equal(read_object(p, 0x2130, 0), SDO_DONE);
	assert_non_null(memmem(p->value, p->client.size, emcy, sizeof(emcy)));
	assert_non_null(memmem(p->value, p->client.size, pdo, sizeof(pdo)));
}

/* A master may write a snapshot entry by entry, if it adds the node-ID where bit 29 is set. */
static void test_the_entries_of_a_snapshot_can_be_written_one_by_one_in_their_order(void **state)
{
	struct pair *p = *state;
	static uint8_t snapshot[LARGE];
	struct od_dcf_item item;
	size_t used = 0;

	world_nmt(&p->world, 1);
	assert_int_equal(read_object(p, 0x2130, 0), SDO_DONE);
	size_t size = p->client.size;
	memcpy(snapshot, p->value, size);
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
		if (write_object(p, item.index, item.sub, data, item.size))
			fail_msg("%04X:%02X: %08X", item.index, item.sub, (unsigned)p->client.abort_code);
	}
}

/* ---- snapshot: download to another node -------------------------------------------------------------------------- */

static void configure(struct pair *p)
{
	const float l = 0.125f, beta = 0.25f;

	must_write(p, 0x1801, 1, 4, 0xC0000290); /* TPDO2: four other objects, every third SYNC, another COB-ID */
	must_write(p, 0x1A01, 0, 1, 0);
	must_write(p, 0x1A01, 1, 4, 0x21030120);
	must_write(p, 0x1A01, 2, 4, 0x21030220);
	must_write(p, 0x1A01, 0, 1, 2);
	must_write(p, 0x1801, 2, 1, 3);
	must_write(p, 0x1801, 1, 4, 0x400002A5);
	must_write(p, 0x1803, 1, 4, 0x80000490); /* TPDO4: invalid */
	must_write(p, 0x1019, 0, 1, 10);
	must_write(p, 0x1006, 0, 4, 20000);
	must_write(p, 0x1005, 0, 4, 0x40000081);
	must_write(p, 0x1016, 1, 4, 0x00050100);
	must_write(p, 0x1016, 2, 4, 0x00060200);
	must_write(p, 0x1017, 0, 2, 250);
	must_write(p, 0x1201, 1, 4, 0x6A5);
	must_write(p, 0x1201, 2, 4, 0x6A6);
	assert_int_equal(write_object(p, 0x2000, 1, &l, 4), 0);
	assert_int_equal(write_object(p, 0x2030, 3, &beta, 4), 0);
	must_write(p, 0x2110, 1, 2, 10);
	must_write(p, 0x6000, 0, 2, 100);
	must_write(p, 0x1020, 1, 4, 15000);
	must_write(p, 0x1020, 2, 4, 12345678);
}

static void assert_same_configuration(const struct pair *a, const struct pair *b)
{
	for (size_t i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *entry = &imu9_od_table.entries[i];
		const uint8_t *x = (const uint8_t *)&a->world.device.values + entry->offset;
		const uint8_t *y = (const uint8_t *)&b->world.device.values + entry->offset;

		if ((entry->access & OD_WRITE) && (entry->access & OD_STORED) && !(entry->access & OD_NODE_ID) &&
			memcmp(x, y, entry->size))
			fail_msg("%04X:%02X differs", entry->index, entry->sub);
	}
}

static void copy_configuration(struct pair *from, struct pair *to)
{
	assert_int_equal(read_in_blocks(from, 0x2130, 0), SDO_DONE);
	assert_int_equal(write_in_blocks(to, 0x2130, 0, from->value, from->client.size), 0);
}

static void test_a_snapshot_brings_another_node_to_the_same_configuration(void **state)
{
	struct pair *p = *state, *other = new_pair(17);

	configure(p);
	copy_configuration(p, other);
	assert_same_configuration(p, other);
	free(other);
}

static void test_cob_ids_that_follow_the_node_id_follow_that_of_the_other_node(void **state)
{
	struct pair *p = *state, *other = new_pair(17);

	configure(p);
	must_write(other, 0x1014, 0, 4, 0x800000FF);
	copy_configuration(p, other);
	assert_int_equal(value_u32(other, 0x1014, 0), 0x91);
	assert_int_equal(value_u32(other, 0x1800, 1), 0x40000191);
	assert_int_equal(value_u32(other, 0x1801, 1), 0x400002A5); /* this one was configured */
	assert_int_equal(value_u32(other, 0x1803, 1), 0x80000491);
	free(other);
}

static void test_a_snapshot_is_applied_to_a_node_with_active_pdos_and_sync(void **state)
{
	struct pair *p = *state, *other = new_pair(17);

	configure(other); /* another mapping, SYNC producer, heartbeat consumer */
	must_write(other, 0x1005, 0, 4, 0x81);
	must_write(other, 0x1005, 0, 4, 0x40000082);
	must_write(other, 0x1016, 3, 4, 0x00070200);
	world_nmt(&other->world, 1);
	copy_configuration(p, other);
	assert_same_configuration(p, other);
	assert_int_equal(value_u32(other, 0x1801, 1), 0x40000291);
	assert_int_equal(value_u32(other, 0x1005, 0), 0x80);
	free(other);
}

static void test_a_snapshot_leaves_identity_and_measurements(void **state)
{
	struct pair *p = *state, *other = new_pair(17);

	p->world.device.values.identity.serial_number = 1111;
	other->world.device.values.identity.serial_number = 2222;
	copy_configuration(p, other);
	assert_int_equal(value_u32(other, 0x1018, 4), 2222);
	free(other);
}

static void test_a_snapshot_has_the_configuration_date(void **state)
{
	struct pair *p = *state, *other = new_pair(17);

	configure(p);
	copy_configuration(p, other);
	assert_int_equal(value_u32(other, 0x1020, 1), 15000);
	assert_int_equal(value_u32(other, 0x1020, 2), 12345678);
	free(other);
}

static void test_a_snapshot_read_and_written_back_changes_nothing(void **state)
{
	struct pair *p = *state;
	static uint8_t before[LARGE];

	configure(p);
	assert_int_equal(read_object(p, 0x2130, 0), SDO_DONE);
	size_t size = p->client.size;
	memcpy(before, p->value, size);
	assert_int_equal(write_object(p, 0x2130, 0, before, size), 0);
	assert_int_equal(read_object(p, 0x2130, 0), SDO_DONE);
	assert_int_equal(p->client.size, size);
	assert_memory_equal(p->value, before, size);
}

/* ---- snapshot: refused ------------------------------------------------------------------------------------------- */

#define ENTRY_U8(index, sub, value) (uint8_t)(index), (uint8_t)((index) >> 8), sub, 1, 0, 0, 0, value
#define ENTRY_U16(index, sub, value) \
	(uint8_t)(index), (uint8_t)((index) >> 8), sub, 2, 0, 0, 0, (uint8_t)(value), (uint8_t)((value) >> 8)
#define ENTRY_U32(index, sub, value)                                                                           \
	(uint8_t)(index), (uint8_t)((index) >> 8), sub, 4, 0, 0, 0, (uint8_t)(value), (uint8_t)((value) >> 8), \
		(uint8_t)((value) >> 16), (uint8_t)((uint32_t)(value) >> 24)
#define GOOD_ENTRY ENTRY_U16(0x1017, 0, 777)

/* Refused with this code, and the valid entry before it is not applied either. */
static void assert_refused(struct pair *p, const uint8_t *dcf, size_t size, uint32_t code)
{
	static struct od_values before;

	before = p->world.device.values;
	assert_int_equal(write_object(p, 0x2130, 0, dcf, size), code);
	before.error_register = p->world.device.values.error_register;
	for (size_t i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *entry = &imu9_od_table.entries[i];

		if ((entry->access & OD_STORED) &&
			memcmp((uint8_t *)&before + entry->offset, (uint8_t *)&p->world.device.values + entry->offset,
				entry->size))
			fail_msg("%04X:%02X has changed", entry->index, entry->sub);
	}
}

#define ASSERT_REFUSED(p, code, ...)                                         \
	do {                                                                 \
		const uint8_t dcf[] = {2, 0, 0, 0, GOOD_ENTRY, __VA_ARGS__}; \
		assert_refused(p, dcf, sizeof(dcf), code);                   \
	} while (0)

static void test_a_snapshot_of_some_entries_is_applied(void **state)
{
	struct pair *p = *state;
	const uint8_t dcf[] = {2, 0, 0, 0, GOOD_ENTRY, ENTRY_U8(0x2001, 0, 1)};

	assert_int_equal(write_object(p, 0x2130, 0, dcf, sizeof(dcf)), 0);
	assert_int_equal(value_u32(p, 0x1017, 0), 777);
	assert_int_equal(value_u32(p, 0x2001, 0), 1);
}

static void test_a_snapshot_without_entries_changes_nothing(void **state)
{
	assert_int_equal(write_object(*state, 0x2130, 0, (const uint8_t[4]){0}, 4), 0);
}

static void test_a_snapshot_with_an_unknown_object_is_refused(void **state)
{
	ASSERT_REFUSED(*state, 0x06020000, ENTRY_U8(0x2FFF, 0, 1));
	ASSERT_REFUSED(*state, 0x06090011, ENTRY_U32(0x2000, 9, 0));
}

static void test_a_snapshot_with_an_object_that_is_not_configuration_is_refused(void **state)
{
	ASSERT_REFUSED(*state, 0x06010002, ENTRY_U32(0x1018, 4, 1));	      /* identity */
	ASSERT_REFUSED(*state, 0x06010000, ENTRY_U32(0x1010, 1, 0x65766173)); /* a command */
	ASSERT_REFUSED(*state, 0x06010000, ENTRY_U8(0x2040, 6, 1));
	ASSERT_REFUSED(*state, 0x06010000, 0x30, 0x21, 0, 4, 0, 0, 0, 0, 0, 0, 0); /* itself */
}

static void test_a_snapshot_with_a_value_of_the_wrong_size_or_beyond_its_limits_is_refused(void **state)
{
	ASSERT_REFUSED(*state, 0x06070012, ENTRY_U16(0x2001, 0, 1));
	ASSERT_REFUSED(*state, 0x06070013, ENTRY_U8(0x1017, 0, 1));
	ASSERT_REFUSED(*state, 0x06090031, ENTRY_U8(0x2001, 0, 99));
	ASSERT_REFUSED(*state, 0x06090030, ENTRY_U32(0x2000, 1, 0x7FC00000)); /* NaN */
}

/* As a configuration file of an earlier version could have set it. */
static void test_a_value_that_no_client_could_write_is_there_again_when_a_snapshot_is_rolled_back(void **state)
{
	static const uint8_t dcf[] = {3, 0, 0, 0, GOOD_ENTRY, ENTRY_U16(0x6000, 0, 100), ENTRY_U32(0x2050, 4, 0)};
	struct pair *p = *state;

	p->world.device.values.angle_resolution = 7; /* it can be 1, 10, 100 or 1000 */
	assert_refused(p, dcf, sizeof(dcf), 0x06040043);
	assert_int_equal(p->world.device.values.angle_resolution, 7);
}

static void test_a_snapshot_is_rolled_back_when_an_object_refuses_its_value(void **state)
{
	ASSERT_REFUSED(*state, 0x06090030, ENTRY_U16(0x6000, 0, 7));
	ASSERT_REFUSED(*state, 0x06010000, ENTRY_U8(0x1A00, 0, 0)); /* the PDO is valid */
}

static void test_a_snapshot_with_contradictory_values_is_refused(void **state)
{
	ASSERT_REFUSED(*state, 0x06040043, ENTRY_U32(0x2050, 4, 0)); /* a singular matrix */
}

static void test_bytes_that_are_not_a_concise_dcf_are_refused(void **state)
{
	struct pair *p = *state;
	const uint8_t dcf[] = {1, 0, 0, 0, GOOD_ENTRY, 0};

	assert_refused(p, dcf, 3, 0x06040043);
	assert_refused(p, dcf, sizeof(dcf) - 2, 0x06040043); /* truncated */
	assert_refused(p, dcf, sizeof(dcf), 0x06040043);     /* one byte too many */
}

static void test_a_snapshot_that_is_too_long_is_refused_at_initiation(void **state)
{
	struct pair *p = *state;
	static const uint8_t bytes[LARGE + 1];

	assert_int_equal(write_object(p, 0x2130, 0, bytes, sizeof(bytes)), 0x06070012);
	assert_int_equal(p->client.size, 0);
	assert_int_equal(write_in_blocks(p, 0x2130, 0, bytes, sizeof(bytes)), 0x06070012);
	assert_int_equal(p->client.size, 0);
}

static void request(struct pair *p, const uint8_t data[8])
{
	p->answer_count = 0;
	world_receive(&p->world, 0x610, 8, data);
}

static void assert_answer(const struct pair *p, const uint8_t data[8])
{
	assert_int_equal(p->answer_count, 1);
	assert_memory_equal(p->answers[0].data, data, 8);
}

/* A client that does not indicate the size. */
static void test_a_segmented_download_without_a_size_is_limited_by_the_buffer(void **state)
{
	struct pair *p = *state;
	uint8_t toggle = 0;

	request(p, (const uint8_t[8]){0x20, 0x30, 0x21});
	for (size_t done = 0; done + 7 <= OD_DOMAIN_MAX; done += 7, toggle ^= 0x10) {
		request(p, (const uint8_t[8]){toggle});
		assert_answer(p, (const uint8_t[8]){0x20 | toggle});
	}
	request(p, (const uint8_t[8]){toggle});
	assert_answer(p, (const uint8_t[8]){0x80, 0x30, 0x21, 0, 0x12, 0x00, 0x07, 0x06});
}

static void test_a_block_download_without_a_size_is_limited_by_the_buffer(void **state)
{
	struct pair *p = *state;
	size_t done = 0;
	uint8_t sequence = 0;

	request(p, (const uint8_t[8]){0xC0, 0x30, 0x21});
	assert_answer(p, (const uint8_t[8]){0xA4, 0x30, 0x21, 0, 31});
	while (done < OD_DOMAIN_MAX) {
		sequence = sequence % 31 + 1;
		request(p, (const uint8_t[8]){sequence});
		assert_int_equal(p->answer_count, sequence == 31);
		done += 7;
	}
	request(p, (const uint8_t[8]){sequence + 1});
	assert_answer(p, (const uint8_t[8]){0x80, 0x30, 0x21, 0, 0x12, 0x00, 0x07, 0x06});
}

static void test_a_domain_can_be_written_expedited(void **state)
{
	struct pair *p = *state;

	request(p, (const uint8_t[8]){0x23, 0x30, 0x21}); /* no entries */
	assert_answer(p, (const uint8_t[8]){0x60, 0x30, 0x21});
	request(p, (const uint8_t[8]){0x27, 0x30, 0x21}); /* three bytes are not a DCF */
	assert_answer(p, (const uint8_t[8]){0x80, 0x30, 0x21, 0, 0x43, 0x00, 0x04, 0x06});
}

static void test_a_snapshot_with_a_wrong_crc_changes_nothing(void **state)
{
	struct pair *p = *state;

	request(p, (const uint8_t[8]){0xC6, 0x30, 0x21, 0, 13});
	request(p, (const uint8_t[8]){1, 1, 0, 0, 0, 0x17, 0x10, 0});
	request(p, (const uint8_t[8]){0x82, 2, 0, 0, 0, 0x09, 0x03});
	request(p, (const uint8_t[8]){0xC5, 0x12, 0x34});
	assert_answer(p, (const uint8_t[8]){0x80, 0x30, 0x21, 0, 0x04, 0x00, 0x04, 0x05});
	p->answer_count = 0;
	assert_int_equal(value_u32(p, 0x1017, 0), 1000);
}

static void test_an_aborted_download_of_a_snapshot_changes_nothing(void **state)
{
	struct pair *p = *state;
	const uint8_t dcf[] = {2, 0, 0, 0, GOOD_ENTRY, ENTRY_U8(0x2001, 0, 1)};
	const struct can_msg abort = {.id = 0x610, .len = 8, .data = {0x80, 0x30, 0x21}};

	sdo_client_download(&p->client, 0x2130, 0, dcf, sizeof(dcf), p->world.now_us);
	sdo_client_receive(&p->client, &p->answers[0], p->world.now_us); /* the first segment */
	sdo_client_receive(&p->client, &p->answers[1], p->world.now_us); /* the second */
	device_receive(&p->world.device, &abort, p->world.now_us);
	p->answer_count = 0;
	assert_int_equal(value_u32(p, 0x1017, 0), 1000);
	assert_int_equal(value_u32(p, 0x2001, 0), 2);
}

static void test_a_read_only_domain_refuses_a_write(void **state)
{
	assert_int_equal(write_object(*state, 0x2131, 0, "x", 1), 0x06010002);
	assert_int_equal(write_object(*state, 0x1021, 0, "12345", 5), 0x06010002);
}

/* ---- event log --------------------------------------------------------------------------------------------------- */

static const char *read_log(struct pair *p)
{
	assert_int_equal(read_in_blocks(p, 0x2131, 0), SDO_DONE);
	p->value[p->client.size] = '\0';
	return (const char *)p->value;
}

static void assert_logged(struct pair *p, const char *text)
{
	if (!strstr(read_log(p), text))
		fail_msg("'%s' is not in:\n%s", text, (const char *)p->value);
}

static void test_the_log_has_the_start_and_each_change_of_the_nmt_state(void **state)
{
	struct pair *p = *state;

	p->world.now_us += 1234567;
	world_nmt(&p->world, 1);
	assert_logged(p, "      0.000000 started with node-ID 16 on vcan9, IMU none\n");
	assert_logged(p, "      1.234567 NMT state: operational\n");
}

static void test_the_log_has_errors_and_their_end(void **state)
{
	struct pair *p = *state;

	canopen_error_set(&p->world.device.canopen, 0x8130, 0x10, (const uint8_t[5]){5}, p->world.now_us);
	canopen_error_clear(&p->world.device.canopen, 0x8130, p->world.now_us);
	assert_logged(p, "error 8130h (heartbeat or life guarding lost), EMCY bytes 3 to 7: 05 00 00 00 00\n");
	assert_logged(p, "error 8130h (heartbeat or life guarding lost) is over\n");
}

static void test_the_log_has_bus_states(void **state)
{
	struct pair *p = *state;

	p->world.bus.state = CAN_STATE_BUS_OFF;
	device_tick(&p->world.device, p->world.now_us);
	p->world.bus.state = CAN_STATE_ACTIVE;
	device_tick(&p->world.device, p->world.now_us);
	assert_logged(p, "vcan9: bus-off\n");
	assert_logged(p, "vcan9: error active\n");
}

static void test_the_log_has_the_loss_and_the_return_of_the_sensor(void **state)
{
	struct pair *p = *state;
	const struct imu_sample sample = {.t_us = 1000, .accel_m_s2 = {0, 0, 9.8}};

	device_sample(&p->world.device, -5, NULL, p->world.now_us);
	device_sample(&p->world.device, 1, &sample, p->world.now_us);
	assert_logged(p, "no samples from none");
	assert_logged(p, "samples from none resumed\n");
}

static void test_the_log_has_resets_and_snapshots(void **state)
{
	struct pair *p = *state;
	const uint8_t dcf[] = {1, 0, 0, 0, GOOD_ENTRY}, bad[] = {1, 0, 0, 0, ENTRY_U8(0x2001, 0, 99)};

	assert_int_equal(write_object(p, 0x2130, 0, dcf, sizeof(dcf)), 0);
	write_object(p, 0x2130, 0, bad, sizeof(bad));
	world_nmt(&p->world, 0x82);
	world_nmt(&p->world, 0x81);
	assert_logged(p, "configuration snapshot of 1 entries applied\n");
	assert_logged(p, "configuration snapshot refused: 2001h:00: ");
	assert_logged(p, "reset communication\n");
	assert_logged(p, "reset node\n");
}

static void test_a_full_log_drops_whole_lines_the_oldest_first(void **state)
{
	struct pair *p = *state;

	for (unsigned i = 0; i < 3000; i++)
		event_log_add_about(&p->world.device.log, p->world.now_us, i, "event %u", i);
	const char *text = read_log(p);
	size_t size = p->client.size;
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

static void test_a_very_long_event_is_truncated(void **state)
{
	struct pair *p = *state;
	char text[1000];

	memset(text, 'x', sizeof(text) - 1);
	text[sizeof(text) - 1] = '\0';
	event_log_add(&p->world.device.log, p->world.now_us, "%s", text);
	event_log_add(&p->world.device.log, p->world.now_us, "next");
	assert_logged(p, "xxx\n      0.000000 next\n");
}

static void test_a_transfer_reads_the_log_as_it_was_at_its_start(void **state)
{
	struct pair *p = *state;

	sdo_client_upload(&p->client, 0x2131, 0, p->value, sizeof(p->value), p->world.now_us);
	uint32_t size = p->answers[0].data[4] | (uint32_t)p->answers[0].data[5] << 8;
	for (unsigned i = 0; i < 3000; i++)
		event_log_add_about(&p->world.device.log, p->world.now_us, i, "event %u", i);
	assert_int_equal(finish(p), SDO_DONE);
	assert_int_equal(p->client.size, size);
	p->value[size] = '\0';
	assert_non_null(strstr((char *)p->value, "started with node-ID 16"));
	assert_null(strstr((char *)p->value, "event"));
}

static void test_both_sdo_channels_read_their_own_log_at_once(void **state)
{
	struct pair *p = *state;
	const struct can_msg open = {.id = 0x6A5, .len = 8, .data = {0x40, 0x31, 0x21}};
	const struct can_msg segment = {.id = 0x6A5, .len = 8, .data = {0x60}};

	must_write(p, 0x1201, 1, 4, 0x6A5);
	must_write(p, 0x1201, 2, 4, 0x6A6);
	sdo_client_upload(&p->client, 0x2131, 0, p->value, sizeof(p->value), p->world.now_us);
	size_t first = p->answers[0].data[4];
	event_log_add(&p->world.device.log, p->world.now_us, "in between");
	device_receive(&p->world.device, &open, p->world.now_us);
	assert_int_equal(p->answers[1].data[4], first + strlen("      0.000000 in between\n"));
	device_receive(&p->world.device, &segment, p->world.now_us);
	assert_memory_equal(p->answers[2].data + 1, "      0", 7);
	p->answer_count = 1;
	assert_int_equal(finish(p), SDO_DONE);
	assert_int_equal(p->client.size, first);
}

#define WITH_DEVICE(test) cmocka_unit_test_setup_teardown(test, set_up, world_tear_down)

int main(void)
{
	const struct CMUnitTest tests[] = {
		WITH_DEVICE(test_the_eds_is_read_at_1021h_by_segments_and_blocks_and_1022h_is_plain_text),
		WITH_DEVICE(test_the_eds_has_the_configured_vendor_id_and_is_else_as_built),
		WITH_DEVICE(test_the_snapshot_is_a_concise_dcf_of_every_configuration_object),
		WITH_DEVICE(test_the_snapshot_is_uploaded_in_blocks_too),
		WITH_DEVICE(test_a_cob_id_that_follows_the_node_id_has_bit_29_set),
		WITH_DEVICE(test_the_entries_of_a_snapshot_can_be_written_one_by_one_in_their_order),
		WITH_DEVICE(test_a_snapshot_brings_another_node_to_the_same_configuration),
		WITH_DEVICE(test_cob_ids_that_follow_the_node_id_follow_that_of_the_other_node),
		WITH_DEVICE(test_a_snapshot_is_applied_to_a_node_with_active_pdos_and_sync),
		WITH_DEVICE(test_a_snapshot_leaves_identity_and_measurements),
		WITH_DEVICE(test_a_snapshot_has_the_configuration_date),
		WITH_DEVICE(test_a_snapshot_read_and_written_back_changes_nothing),
		WITH_DEVICE(test_a_snapshot_of_some_entries_is_applied),
		WITH_DEVICE(test_a_snapshot_without_entries_changes_nothing),
		WITH_DEVICE(test_a_snapshot_with_an_unknown_object_is_refused),
		WITH_DEVICE(test_a_snapshot_with_an_object_that_is_not_configuration_is_refused),
		WITH_DEVICE(test_a_snapshot_with_a_value_of_the_wrong_size_or_beyond_its_limits_is_refused),
		WITH_DEVICE(test_a_value_that_no_client_could_write_is_there_again_when_a_snapshot_is_rolled_back),
		WITH_DEVICE(test_a_snapshot_is_rolled_back_when_an_object_refuses_its_value),
		WITH_DEVICE(test_a_snapshot_with_contradictory_values_is_refused),
		WITH_DEVICE(test_bytes_that_are_not_a_concise_dcf_are_refused),
		WITH_DEVICE(test_a_snapshot_that_is_too_long_is_refused_at_initiation),
		WITH_DEVICE(test_a_segmented_download_without_a_size_is_limited_by_the_buffer),
		WITH_DEVICE(test_a_block_download_without_a_size_is_limited_by_the_buffer),
		WITH_DEVICE(test_a_domain_can_be_written_expedited),
		WITH_DEVICE(test_a_snapshot_with_a_wrong_crc_changes_nothing),
		WITH_DEVICE(test_an_aborted_download_of_a_snapshot_changes_nothing),
		WITH_DEVICE(test_a_read_only_domain_refuses_a_write),
		WITH_DEVICE(test_the_log_has_the_start_and_each_change_of_the_nmt_state),
		WITH_DEVICE(test_the_log_has_errors_and_their_end),
		WITH_DEVICE(test_the_log_has_bus_states),
		WITH_DEVICE(test_the_log_has_the_loss_and_the_return_of_the_sensor),
		WITH_DEVICE(test_the_log_has_resets_and_snapshots),
		WITH_DEVICE(test_a_full_log_drops_whole_lines_the_oldest_first),
		WITH_DEVICE(test_a_very_long_event_is_truncated),
		WITH_DEVICE(test_a_transfer_reads_the_log_as_it_was_at_its_start),
		WITH_DEVICE(test_both_sdo_channels_read_their_own_log_at_once),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
