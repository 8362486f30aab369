/* The object dictionary: a value reads as it was written, and values that the EDS does not allow are refused. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <string.h>

#include "od_values.h"

enum { NODE_ID = 16 };

/* A hand-written table with types that the device's EDS does not use. */
struct other_values {
	uint8_t flag;
	int8_t i8;
	char text[8];
	uint8_t octets[4];
	int64_t i64;
	uint64_t u64;
	double real64;
};

#define OTHER(i, t, a, member)                                                                        \
	.index = (i), .type = (t), .access = (a), .size = sizeof(((struct other_values *)0)->member), \
	.offset = offsetof(struct other_values, member), .factor = 1, .name = #member, .unit = "", .description = ""

static const struct od_entry OTHER_ENTRIES[] = {
	{OTHER(0x2000, OD_BOOLEAN, OD_READ | OD_WRITE, flag)},
	{OTHER(0x2001, OD_INTEGER8, OD_READ | OD_WRITE | OD_LIMIT_LOW | OD_LIMIT_HIGH, i8), .low.i = -10, .high.i = -2},
	{OTHER(0x2002, OD_VISIBLE_STRING, OD_READ | OD_WRITE, text)},
	{OTHER(0x2003, OD_OCTET_STRING, OD_READ | OD_WRITE, octets)},
	{OTHER(0x2004, OD_INTEGER64, OD_READ | OD_WRITE, i64)},
	{OTHER(0x2005, OD_UNSIGNED64, OD_READ | OD_WRITE | OD_LIMIT_HIGH, u64), .high.u = UINT64_MAX - 1},
	{OTHER(0x2006, OD_REAL64, OD_READ | OD_WRITE | OD_LIMIT_LOW, real64), .low.f = 0.5},
};

static const struct other_values OTHER_DEFAULTS = {.i8 = -5, .text = "abc", .real64 = 1};

static const struct od_table OTHER_TABLE = {
	.entries = OTHER_ENTRIES,
	.count = sizeof(OTHER_ENTRIES) / sizeof(*OTHER_ENTRIES),
	.defaults = &OTHER_DEFAULTS,
	.values_size = sizeof(OTHER_DEFAULTS),
};

static struct od od, other;
static struct od_values values;
static struct other_values other_values;

static int fresh(void **state)
{
	(void)state;
	od_init(&od, &imu9_od_table, &values, NODE_ID);
	od_init(&other, &OTHER_TABLE, &other_values, NODE_ID);
	return 0;
}

static enum od_status write_real32(uint16_t index, uint8_t sub, float value)
{
	uint32_t bits;
	uint8_t wire[4];

	memcpy(&bits, &value, sizeof(bits));
	for (int i = 0; i < 4; i++)
		wire[i] = (uint8_t)(bits >> 8 * i);
	return od_write(&od, index, sub, wire, sizeof(wire));
}

static enum od_status write_u8(uint16_t index, uint8_t sub, uint8_t value)
{
	return od_write(&od, index, sub, &value, 1);
}

/* ---- the table ---- */

static void test_entries_are_sorted_so_that_a_binary_search_finds_them(void **state)
{
	(void)state;
	for (size_t i = 1; i < imu9_od_table.count; i++) {
		const struct od_entry *a = &imu9_od_table.entries[i - 1], *b = a + 1;

		assert_true((a->index << 8 | a->sub) < (b->index << 8 | b->sub));
	}
}

static void test_every_entry_is_found_by_its_index_and_sub_index(void **state)
{
	(void)state;
	for (size_t i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *entry = &imu9_od_table.entries[i];
		enum od_status status = OD_GENERAL;

		assert_ptr_equal(od_find(&imu9_od_table, entry->index, entry->sub, &status), entry);
		assert_int_equal(status, OD_OK);
	}
}

static void test_a_missing_object_and_a_missing_sub_index_have_different_statuses(void **state)
{
	static const struct {
		uint16_t index;
		uint8_t sub;
		enum od_status status;
	} CASES[] = {
		{0x0000, 0, OD_NO_OBJECT},
		{0x0FFF, 255, OD_NO_OBJECT},
		{0x1002, 0, OD_NO_OBJECT},
		{0xFFFF, 255, OD_NO_OBJECT},
		{0x1000, 1, OD_NO_SUBINDEX},
		{0x1800, 4, OD_NO_SUBINDEX},
		{0x2000, 4, OD_NO_SUBINDEX},
		{0x6124, 9, OD_NO_SUBINDEX},
	};

	(void)state;
	for (size_t i = 0; i < sizeof(CASES) / sizeof(*CASES); i++) {
		enum od_status status;

		assert_null(od_find(&imu9_od_table, CASES[i].index, CASES[i].sub, &status));
		assert_int_equal(status, CASES[i].status);
	}
}

static void test_objects_belong_to_the_groups_of_1010h(void **state)
{
	(void)state;
	assert_int_equal(od_group_of(0x1000), OD_GROUP_COMMUNICATION);
	assert_int_equal(od_group_of(0x1FFF), OD_GROUP_COMMUNICATION);
	assert_int_equal(od_group_of(0x2000), OD_GROUP_MANUFACTURER);
	assert_int_equal(od_group_of(0x5FFF), OD_GROUP_MANUFACTURER);
	assert_int_equal(od_group_of(0x6000), OD_GROUP_APPLICATION);
	assert_int_equal(od_group_of(0x9FFF), OD_GROUP_APPLICATION);
}

static void test_commands_and_measurements_are_not_stored(void **state)
{
	static const struct {
		uint16_t index;
		uint8_t sub;
	} NOT_STORED[] = {{0x1003, 0}, {0x1010, 1}, {0x1011, 1}, {0x2040, 6}, {0x2100, 1}, {0x1018, 4}, {0x1008, 0}};

	(void)state;
	for (size_t i = 0; i < sizeof(NOT_STORED) / sizeof(*NOT_STORED); i++) {
		const struct od_entry *entry = od_find(&imu9_od_table, NOT_STORED[i].index, NOT_STORED[i].sub, NULL);

		assert_non_null(entry);
		assert_false(entry->access & OD_STORED);
	}
	assert_true(od_find(&imu9_od_table, 0x2000, 1, NULL)->access & OD_STORED);
	assert_true(od_find(&imu9_od_table, 0x1A00, 0, NULL)->access & OD_STORED);
}

/* ---- defaults ---- */

static void test_the_node_id_is_added_to_defaults_with_nodeid(void **state)
{
	(void)state;
	assert_int_equal(values.cob_id_emcy, 0x80 + NODE_ID);
	assert_int_equal(values.tpdo1_communication.cob_id, 0x40000180 + NODE_ID);
	assert_int_equal(values.sdo_server_parameter.cob_id_client_to_server, 0x600 + NODE_ID);
	assert_int_equal(values.cob_id_sync, 0x80);
	od_init(&od, &imu9_od_table, &values, 127);
	assert_int_equal(values.cob_id_emcy, 0x80 + 127);
}

static void test_a_device_without_node_id_has_the_defaults_without_it(void **state)
{
	(void)state;
	od_init(&od, &imu9_od_table, &values, 255);
	assert_int_equal(values.cob_id_emcy, 0x80);
}

static void test_the_defaults_are_those_of_the_eds(void **state)
{
	(void)state;
	assert_int_equal(values.device_type, 0x0004019A);
	assert_int_equal(values.producer_heartbeat_time, 1000);
	assert_int_equal(values.lever_arm_model, 2);
	assert_true(values.gravity == 9.81f);
	assert_true(values.gyro_calibration.yy == 1.0f);
	assert_true(values.gyro_calibration.xy == 0.0f);
	assert_int_equal(values.tpdo4_mapping.object_3, 0x210F0220);
	assert_string_equal(values.manufacturer_device_name, "IMU9 CANopen gateway");
}

/* ---- reading ---- */

static void test_a_number_is_read_as_little_endian_bytes(void **state)
{
	uint8_t wire[OD_VALUE_MAX];
	size_t size = 0;

	(void)state;
	values.cob_id_sync = 0x12345678;
	assert_int_equal(od_read(&od, 0x1005, 0, wire, sizeof(wire), &size), OD_OK);
	assert_int_equal(size, 4);
	assert_memory_equal(wire, "\x78\x56\x34\x12", 4);
}

static void test_a_float_is_read_as_its_little_endian_ieee_754_bits(void **state)
{
	uint8_t wire[OD_VALUE_MAX];
	size_t size = 0;

	(void)state;
	values.lever_arm.s = -0.15625f; /* BE200000h */
	assert_int_equal(od_read(&od, 0x2000, 2, wire, sizeof(wire), &size), OD_OK);
	assert_int_equal(size, 4);
	assert_memory_equal(wire, "\x00\x00\x20\xBE", 4);
}

static void test_a_string_is_read_without_its_padding(void **state)
{
	uint8_t wire[OD_VALUE_MAX];
	size_t size = 0;

	(void)state;
	assert_int_equal(od_read(&od, 0x1008, 0, wire, sizeof(wire), &size), OD_OK);
	assert_int_equal(size, strlen("IMU9 CANopen gateway"));
	assert_memory_equal(wire, "IMU9 CANopen gateway", size);
}

static void test_a_string_that_fills_its_field_is_read_completely(void **state)
{
	uint8_t wire[OD_VALUE_MAX];
	size_t size = 0;

	(void)state;
	assert_int_equal(od_write(&other, 0x2002, 0, "12345678", 8), OD_OK);
	assert_int_equal(od_read(&other, 0x2002, 0, wire, sizeof(wire), &size), OD_OK);
	assert_int_equal(size, 8);
	assert_memory_equal(wire, "12345678", 8);
}

static void test_no_value_is_longer_than_od_value_max(void **state)
{
	(void)state;
	for (size_t i = 0; i < imu9_od_table.count; i++)
		assert_true(imu9_od_table.entries[i].size <= OD_VALUE_MAX);
}

static void test_a_buffer_that_is_too_small_is_refused_and_not_written(void **state)
{
	uint8_t wire[4] = {1, 2, 3, 4};
	size_t size;

	(void)state;
	assert_int_equal(od_read(&od, 0x1005, 0, wire, 3, &size), OD_TOO_LONG);
	assert_int_equal(od_read(&od, 0x1008, 0, wire, 3, &size), OD_TOO_LONG);
	assert_memory_equal(wire, "\1\2\3\4", 4);
	assert_int_equal(od_get(&od, od_find(&imu9_od_table, 0x1005, 0, NULL), wire, 3), 0);
	assert_int_equal(od_get(&od, od_find(&imu9_od_table, 0x1005, 0, NULL), wire, 4), 4);
	assert_int_equal(od_read(&od, 0x1005, 0, wire, 4, &size), OD_OK);
}

static void test_a_write_only_entry_is_not_read(void **state)
{
	uint8_t wire[OD_VALUE_MAX];
	size_t size;

	(void)state;
	assert_int_equal(od_read(&od, 0x2040, 6, wire, sizeof(wire), &size), OD_WRITE_ONLY);
}

static void test_a_domain_is_found_by_its_index(void **state)
{
	struct od_domain domain = {.index = 0x1021, .data = imu9_eds, .size = imu9_eds_size};
	uint8_t wire[OD_VALUE_MAX];
	size_t size;

	(void)state;
	assert_null(od_find_domain(&od, 0x1021, 0));
	od_set_domain(&od, &domain);
	assert_ptr_equal(od_find_domain(&od, 0x1021, 0), &domain);
	assert_null(od_find_domain(&od, 0x1021, 1));
	assert_int_equal(od_read(&od, 0x1021, 0, wire, sizeof(wire), &size), OD_UNSUPPORTED_ACCESS);
	assert_int_equal(od_check(od_find(&imu9_od_table, 0x1021, 0, NULL), "text", 4), OD_UNSUPPORTED_ACCESS);
}

static void test_values_of_eight_bytes_are_written_and_read_back(void **state)
{
	static const uint8_t wire[3][8] = {{0xFE, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF}, /* -2 */
		{8, 7, 6, 5, 4, 3, 2, 1}, {0, 0, 0, 0, 0, 0, 0xF8, 0x3F}};		     /* 1.5 */

	(void)state;
	for (uint16_t i = 0; i < 3; i++) {
		uint8_t back[8] = {0};
		size_t size = 0;

		assert_int_equal(od_write(&other, (uint16_t)(0x2004 + i), 0, wire[i], 8), OD_OK);
		assert_int_equal(od_read(&other, (uint16_t)(0x2004 + i), 0, back, sizeof(back), &size), OD_OK);
		assert_int_equal(size, 8);
		assert_memory_equal(back, wire[i], 8);
	}
	assert_true(other_values.i64 == -2);
	assert_true(other_values.u64 == 0x0102030405060708u);
	assert_true(other_values.real64 == 1.5);
}

static void test_a_value_pointer_requires_the_right_size(void **state)
{
	(void)state;
	assert_ptr_equal(od_value(&od, 0x1017, 0, 2), &values.producer_heartbeat_time);
	assert_null(od_value(&od, 0x1017, 0, 4));
	assert_null(od_value(&od, 0x1016, 0, 2));
}

/* ---- writing ---- */

static void test_a_written_float_is_in_the_struct(void **state)
{
	(void)state;
	assert_int_equal(write_real32(0x2000, 1, 0.05f), OD_OK);
	assert_true(values.lever_arm.l == 0.05f);
}

static void test_a_write_above_the_high_limit_is_refused_and_the_old_value_remains(void **state)
{
	(void)state;
	assert_int_equal(write_real32(0x2000, 1, 1.0f), OD_OK);
	assert_int_equal(write_real32(0x2000, 1, nextafterf(10.0f, 11.0f)), OD_TOO_HIGH);
	assert_int_equal(write_u8(0x2001, 0, 4), OD_TOO_HIGH);
	assert_true(values.lever_arm.l == 1.0f);
	assert_int_equal(values.lever_arm_model, 2);
}

static void test_a_write_below_the_low_limit_is_refused_and_the_old_value_remains(void **state)
{
	(void)state;
	assert_int_equal(write_real32(0x2003, 0, nextafterf(9.0f, 0.0f)), OD_TOO_LOW);
	assert_int_equal(write_u8(0x2010, 2, 0), OD_TOO_LOW);
	assert_true(values.gravity == 9.81f);
	assert_int_equal(values.acceleration_filter.order, 2);
}

static void test_a_value_equal_to_a_limit_is_accepted(void **state)
{
	(void)state;
	assert_int_equal(write_real32(0x2000, 1, -10.0f), OD_OK);
	assert_int_equal(write_real32(0x2000, 1, 10.0f), OD_OK);
	assert_int_equal(write_real32(0x2010, 3, 0.01f), OD_OK);
	assert_int_equal(write_u8(0x2010, 2, 1), OD_OK);
	assert_int_equal(write_u8(0x2010, 2, 8), OD_OK);
}

static void test_limits_of_negative_integers_are_checked(void **state)
{
	(void)state;
	assert_int_equal(od_write(&other, 0x2001, 0, "\xF5", 1), OD_TOO_LOW);  /* -11 */
	assert_int_equal(od_write(&other, 0x2001, 0, "\xF6", 1), OD_OK);       /* -10 */
	assert_int_equal(od_write(&other, 0x2001, 0, "\xFF", 1), OD_TOO_HIGH); /* -1 */
	assert_int_equal(od_write(&other, 0x2001, 0, "\x05", 1), OD_TOO_HIGH);
	assert_int_equal(other_values.i8, -10);
	assert_int_equal(od_write(&other, 0x2001, 0, "\xFE", 1), OD_OK); /* -2 */
}

static void test_limits_of_64_bits_are_checked(void **state)
{
	(void)state;
	assert_int_equal(od_write(&other, 0x2005, 0, "\xFF\xFF\xFF\xFF\xFF\xFF\xFF\xFF", 8), OD_TOO_HIGH);
	assert_int_equal(od_write(&other, 0x2005, 0, "\xFE\xFF\xFF\xFF\xFF\xFF\xFF\xFF", 8), OD_OK);
	assert_int_equal(od_write(&other, 0x2006, 0, "\0\0\0\0\0\0\xD0\x3F", 8), OD_TOO_LOW); /* 0.25 */
	assert_int_equal(od_write(&other, 0x2006, 0, "\0\0\0\0\0\0\xE0\x3F", 8), OD_OK);      /* 0.5 */
	assert_true(other_values.u64 == UINT64_MAX - 1);
	assert_true(other_values.real64 == 0.5);
}

static void test_nan_and_infinity_are_refused(void **state)
{
	(void)state;
	assert_int_equal(write_real32(0x2000, 1, NAN), OD_BAD_VALUE);
	assert_int_equal(write_real32(0x2000, 1, INFINITY), OD_BAD_VALUE);
	assert_int_equal(write_real32(0x2000, 1, -INFINITY), OD_BAD_VALUE);
	assert_int_equal(od_write(&other, 0x2006, 0, "\0\0\0\0\0\0\xF8\x7F", 8), OD_BAD_VALUE);
	assert_true(values.lever_arm.l == 0.0f);
}

static void test_a_boolean_is_0_or_1(void **state)
{
	(void)state;
	assert_int_equal(od_write(&other, 0x2000, 0, "\2", 1), OD_BAD_VALUE);
	assert_int_equal(od_write(&other, 0x2000, 0, "\1", 1), OD_OK);
	assert_int_equal(other_values.flag, 1);
}

static void test_a_value_of_the_wrong_size_is_refused(void **state)
{
	(void)state;
	assert_int_equal(od_write(&od, 0x1017, 0, "\1\2\3", 3), OD_TOO_LONG);
	assert_int_equal(od_write(&od, 0x1017, 0, "\1", 1), OD_TOO_SHORT);
	assert_int_equal(od_write(&od, 0x1017, 0, NULL, 0), OD_TOO_SHORT);
	assert_int_equal(od_write(&other, 0x2003, 0, "abc", 3), OD_TOO_SHORT);
	assert_int_equal(od_write(&other, 0x2002, 0, "123456789", 9), OD_TOO_LONG);
	assert_int_equal(values.producer_heartbeat_time, 1000);
}

static void test_a_shorter_string_replaces_a_longer_one_completely(void **state)
{
	(void)state;
	assert_int_equal(od_write(&other, 0x2002, 0, "12345678", 8), OD_OK);
	assert_int_equal(od_write(&other, 0x2002, 0, "xy", 2), OD_OK);
	assert_memory_equal(other_values.text, "xy\0\0\0\0\0\0", 8);
	assert_int_equal(od_write(&other, 0x2002, 0, NULL, 0), OD_OK);
	assert_memory_equal(other_values.text, "\0\0\0\0\0\0\0\0", 8);
}

static void test_a_nul_is_allowed_only_at_the_end_of_a_string(void **state)
{
	(void)state;
	assert_int_equal(od_write(&other, 0x2002, 0, "xy\0", 3), OD_OK);
	assert_int_equal(od_write(&other, 0x2002, 0, "a\0b", 3), OD_BAD_VALUE);
	assert_string_equal(other_values.text, "xy");
}

static void test_read_only_and_constant_entries_are_not_written(void **state)
{
	(void)state;
	assert_int_equal(od_write(&od, 0x2100, 1, "\0\0", 2), OD_READ_ONLY);
	assert_int_equal(od_write(&od, 0x1008, 0, "x", 1), OD_READ_ONLY);
	assert_int_equal(od_write(&od, 0x1021, 0, "x", 1), OD_READ_ONLY);
}

static void test_a_write_to_a_missing_entry_says_whether_index_or_sub_index_is_missing(void **state)
{
	(void)state;
	assert_int_equal(write_u8(0x3000, 0, 0), OD_NO_OBJECT);
	assert_int_equal(write_u8(0x2000, 9, 0), OD_NO_SUBINDEX);
}

static void test_the_device_itself_can_set_read_only_values_but_not_constants(void **state)
{
	const struct od_entry *serial = od_find(&imu9_od_table, 0x1018, 4, NULL);

	(void)state;
	assert_int_equal(od_put(&od, serial, "\x2A\0\0\0", 4), OD_OK);
	assert_int_equal(values.identity.serial_number, 42);
	assert_int_equal(od_put(&od, od_find(&imu9_od_table, 0x1008, 0, NULL), "x", 1), OD_READ_ONLY);
}

static void test_size_and_limits_apply_to_the_device_itself(void **state)
{
	const struct od_entry *model = od_find(&imu9_od_table, 0x2001, 0, NULL);

	(void)state;
	assert_int_equal(od_put(&od, model, "\4", 1), OD_TOO_HIGH);
	assert_int_equal(od_put(&od, model, "\1\0", 2), OD_TOO_LONG);
	assert_int_equal(values.lever_arm_model, 2);
}

/* ---- hooks ---- */

struct watcher {
	enum od_status answer;
	int before, after;
	uint8_t seen;	     /* the new value passed to `before` */
	uint8_t value_then;  /* the value in place during `before` */
	uint8_t value_after; /* ... and in `after` */
};

static enum od_status watch_before(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	struct watcher *watcher = ctx;

	assert_int_equal(size, 1);
	assert_int_equal(entry->index, 0x2001);
	watcher->before++;
	watcher->seen = *(const uint8_t *)wire;
	watcher->value_then = values.lever_arm_model;
	return watcher->answer;
}

static void watch_after(void *ctx, const struct od_entry *entry)
{
	struct watcher *watcher = ctx;

	assert_int_equal(entry->index, 0x2001);
	watcher->after++;
	watcher->value_after = values.lever_arm_model;
}

static struct od_hook watch(struct watcher *watcher, uint16_t first, uint16_t last)
{
	return (struct od_hook){
		.first = first, .last = last, .before = watch_before, .after = watch_after, .ctx = watcher};
}

static void test_a_hook_gets_the_new_value_before_and_after_it_is_set(void **state)
{
	struct watcher watcher = {.answer = OD_OK};
	struct od_hook hook = watch(&watcher, 0x2001, 0x2001);

	(void)state;
	od_attach(&od, &hook);
	assert_int_equal(write_u8(0x2001, 0, 1), OD_OK);
	assert_int_equal(watcher.seen, 1);
	assert_int_equal(watcher.value_then, 2);
	assert_int_equal(watcher.after, 1);
	assert_int_equal(watcher.value_after, 1);
}

static void test_a_hook_that_refuses_keeps_the_old_value(void **state)
{
	struct watcher watcher = {.answer = OD_DEVICE_STATE};
	struct od_hook hook = watch(&watcher, 0x2001, 0x2001);

	(void)state;
	od_attach(&od, &hook);
	assert_int_equal(write_u8(0x2001, 0, 1), OD_DEVICE_STATE);
	assert_int_equal(values.lever_arm_model, 2);
	assert_int_equal(watcher.after, 0);
}

static void test_a_consumed_command_succeeds_and_stores_no_value(void **state)
{
	struct watcher watcher = {.answer = OD_CONSUMED};
	struct od_hook hook = watch(&watcher, 0x2001, 0x2001);

	(void)state;
	od_attach(&od, &hook);
	assert_int_equal(write_u8(0x2001, 0, 1), OD_OK);
	assert_int_equal(values.lever_arm_model, 2);
	assert_int_equal(watcher.after, 0);
}

static void test_a_pending_command_returns_pending_and_stores_no_value(void **state)
{
	struct watcher watcher = {.answer = OD_PENDING};
	struct od_hook hook = watch(&watcher, 0x2001, 0x2001);

	(void)state;
	od_attach(&od, &hook);
	assert_int_equal(write_u8(0x2001, 0, 1), OD_PENDING);
	assert_int_equal(values.lever_arm_model, 2);
}

static void test_a_hook_is_not_called_for_a_value_outside_the_limits(void **state)
{
	struct watcher watcher = {.answer = OD_OK};
	struct od_hook hook = watch(&watcher, 0x2001, 0x2001);

	(void)state;
	od_attach(&od, &hook);
	assert_int_equal(write_u8(0x2001, 0, 4), OD_TOO_HIGH);
	assert_int_equal(watcher.before, 0);
}

static void test_a_hook_is_called_only_for_its_own_objects(void **state)
{
	struct watcher below = {.answer = OD_OK}, around = {.answer = OD_OK}, above = {.answer = OD_OK};
	struct od_hook hooks[] = {
		watch(&below, 0x1000, 0x2000), watch(&around, 0x2000, 0x2002), watch(&above, 0x2002, 0xFFFF)};

	(void)state;
	for (int i = 0; i < 3; i++)
		od_attach(&od, &hooks[i]);
	assert_int_equal(write_u8(0x2001, 0, 1), OD_OK);
	assert_int_equal(below.before + below.after, 0);
	assert_int_equal(around.before + around.after, 2);
	assert_int_equal(above.before + above.after, 0);
}

static void test_hooks_run_in_the_order_of_attachment_until_one_refuses(void **state)
{
	struct watcher first = {.answer = OD_OK}, second = {.answer = OD_BAD_VALUE}, third = {.answer = OD_OK};
	struct od_hook hooks[] = {
		watch(&first, 0x2001, 0x2001), watch(&second, 0x2001, 0x2001), watch(&third, 0x2001, 0x2001)};

	(void)state;
	for (int i = 0; i < 3; i++)
		od_attach(&od, &hooks[i]);
	assert_int_equal(write_u8(0x2001, 0, 1), OD_BAD_VALUE);
	assert_int_equal(first.before, 1);
	assert_int_equal(second.before, 1);
	assert_int_equal(third.before, 0);
	assert_int_equal(first.after, 0);
}

/* As one that was attached to another dictionary before. */
static void test_a_hook_that_is_attached_brings_no_other_one_with_it(void **state)
{
	struct watcher watcher = {.answer = OD_OK}, unattached_watcher = {.answer = OD_OK};
	struct od_hook unattached = watch(&unattached_watcher, 0x2001, 0x2001), hook = watch(&watcher, 0x2001, 0x2001);

	(void)state;
	hook.next = &unattached;
	od_attach(&od, &hook);
	assert_int_equal(write_u8(0x2001, 0, 1), OD_OK);
	assert_int_equal(watcher.before, 1);
	assert_int_equal(unattached_watcher.before, 0);
}

static void test_no_hook_runs_when_the_device_itself_sets_a_value(void **state)
{
	struct watcher watcher = {.answer = OD_DEVICE_STATE};
	struct od_hook hook = watch(&watcher, 0x2001, 0x2001);

	(void)state;
	od_attach(&od, &hook);
	assert_int_equal(od_put(&od, od_find(&imu9_od_table, 0x2001, 0, NULL), "\1", 1), OD_OK);
	assert_int_equal(values.lever_arm_model, 1);
	assert_int_equal(watcher.before + watcher.after, 0);
}

/* ---- reset ---- */

static void test_a_reset_of_one_group_leaves_the_others(void **state)
{
	const struct od_values base = values;

	(void)state;
	values.producer_heartbeat_time = 5;
	values.lever_arm.l = 1;
	values.angle_resolution = 100;
	od_reset(&od, OD_GROUP_MANUFACTURER, &base);
	assert_true(values.lever_arm.l == 0.0f);
	assert_int_equal(values.producer_heartbeat_time, 5);
	assert_int_equal(values.angle_resolution, 100);
	od_reset(&od, OD_GROUP_ALL, &base);
	assert_int_equal(values.producer_heartbeat_time, 1000);
	assert_int_equal(values.angle_resolution, 10);
}

static void test_a_reset_does_not_change_entries_that_are_not_stored(void **state)
{
	const struct od_values base = values;

	(void)state;
	values.identity.serial_number = 7;
	values.sample.counter = 99;
	od_reset(&od, OD_GROUP_ALL, &base);
	assert_int_equal(values.identity.serial_number, 7);
	assert_int_equal(values.sample.counter, 99);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_entries_are_sorted_so_that_a_binary_search_finds_them),
		cmocka_unit_test(test_every_entry_is_found_by_its_index_and_sub_index),
		cmocka_unit_test(test_a_missing_object_and_a_missing_sub_index_have_different_statuses),
		cmocka_unit_test(test_objects_belong_to_the_groups_of_1010h),
		cmocka_unit_test(test_commands_and_measurements_are_not_stored),
		cmocka_unit_test_setup(test_the_node_id_is_added_to_defaults_with_nodeid, fresh),
		cmocka_unit_test_setup(test_a_device_without_node_id_has_the_defaults_without_it, fresh),
		cmocka_unit_test_setup(test_the_defaults_are_those_of_the_eds, fresh),
		cmocka_unit_test_setup(test_a_number_is_read_as_little_endian_bytes, fresh),
		cmocka_unit_test_setup(test_a_float_is_read_as_its_little_endian_ieee_754_bits, fresh),
		cmocka_unit_test_setup(test_a_string_is_read_without_its_padding, fresh),
		cmocka_unit_test_setup(test_a_string_that_fills_its_field_is_read_completely, fresh),
		cmocka_unit_test(test_no_value_is_longer_than_od_value_max),
		cmocka_unit_test_setup(test_a_buffer_that_is_too_small_is_refused_and_not_written, fresh),
		cmocka_unit_test_setup(test_a_write_only_entry_is_not_read, fresh),
		cmocka_unit_test_setup(test_a_domain_is_found_by_its_index, fresh),
		cmocka_unit_test_setup(test_values_of_eight_bytes_are_written_and_read_back, fresh),
		cmocka_unit_test_setup(test_a_value_pointer_requires_the_right_size, fresh),
		cmocka_unit_test_setup(test_a_written_float_is_in_the_struct, fresh),
		cmocka_unit_test_setup(test_a_write_above_the_high_limit_is_refused_and_the_old_value_remains, fresh),
		cmocka_unit_test_setup(test_a_write_below_the_low_limit_is_refused_and_the_old_value_remains, fresh),
		cmocka_unit_test_setup(test_a_value_equal_to_a_limit_is_accepted, fresh),
		cmocka_unit_test_setup(test_limits_of_negative_integers_are_checked, fresh),
		cmocka_unit_test_setup(test_limits_of_64_bits_are_checked, fresh),
		cmocka_unit_test_setup(test_nan_and_infinity_are_refused, fresh),
		cmocka_unit_test_setup(test_a_boolean_is_0_or_1, fresh),
		cmocka_unit_test_setup(test_a_value_of_the_wrong_size_is_refused, fresh),
		cmocka_unit_test_setup(test_a_shorter_string_replaces_a_longer_one_completely, fresh),
		cmocka_unit_test_setup(test_a_nul_is_allowed_only_at_the_end_of_a_string, fresh),
		cmocka_unit_test_setup(test_read_only_and_constant_entries_are_not_written, fresh),
		cmocka_unit_test_setup(
			test_a_write_to_a_missing_entry_says_whether_index_or_sub_index_is_missing, fresh),
		cmocka_unit_test_setup(test_the_device_itself_can_set_read_only_values_but_not_constants, fresh),
		cmocka_unit_test_setup(test_size_and_limits_apply_to_the_device_itself, fresh),
		cmocka_unit_test_setup(test_a_hook_gets_the_new_value_before_and_after_it_is_set, fresh),
		cmocka_unit_test_setup(test_a_hook_that_refuses_keeps_the_old_value, fresh),
		cmocka_unit_test_setup(test_a_consumed_command_succeeds_and_stores_no_value, fresh),
		cmocka_unit_test_setup(test_a_pending_command_returns_pending_and_stores_no_value, fresh),
		cmocka_unit_test_setup(test_a_hook_is_not_called_for_a_value_outside_the_limits, fresh),
		cmocka_unit_test_setup(test_a_hook_is_called_only_for_its_own_objects, fresh),
		cmocka_unit_test_setup(test_hooks_run_in_the_order_of_attachment_until_one_refuses, fresh),
		cmocka_unit_test_setup(test_a_hook_that_is_attached_brings_no_other_one_with_it, fresh),
		cmocka_unit_test_setup(test_no_hook_runs_when_the_device_itself_sets_a_value, fresh),
		cmocka_unit_test_setup(test_a_reset_of_one_group_leaves_the_others, fresh),
		cmocka_unit_test_setup(test_a_reset_does_not_change_entries_that_are_not_stored, fresh),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
