/* Registers and bits of a hand-written map, with types that the device's EDS does not use there. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <string.h>

#include "gateway/modbus/map.h"

struct values {
	char text[6];
	uint8_t octets[3];
	int8_t i8;
	uint8_t u8;
	uint32_t u32;
	uint16_t secret;
};

#define ENTRY(i, t, a, member)                                                                                         \
	{                                                                                                              \
		.index = (i), .type = (t), .access = (a), .size = sizeof(((struct values *)0)->member),                \
		.offset = offsetof(struct values, member), .factor = 1, .name = #member, .unit = "", .description = "" \
	}

static const struct od_entry ENTRIES[] = {
	ENTRY(0x2000, OD_VISIBLE_STRING, OD_READ | OD_WRITE, text),
	ENTRY(0x2001, OD_OCTET_STRING, OD_READ | OD_WRITE, octets),
	ENTRY(0x2002, OD_INTEGER8, OD_READ | OD_WRITE, i8),
	ENTRY(0x2003, OD_UNSIGNED8, OD_READ | OD_WRITE, u8),
	ENTRY(0x2004, OD_UNSIGNED32, OD_READ | OD_WRITE, u32),
	ENTRY(0x2005, OD_UNSIGNED16, OD_WRITE, secret),
};
enum { TEXT, OCTETS, I8, U8, U32, SECRET };

static const struct values DEFAULTS = {.text = "abc", .octets = {1, 2, 3}, .i8 = -2, .u8 = 200, .u32 = 0x01020304};
static const struct od_table TABLE = {.entries = ENTRIES,
	.count = sizeof(ENTRIES) / sizeof(*ENTRIES),
	.defaults = &DEFAULTS,
	.values_size = sizeof(DEFAULTS)};

static const struct modbus_point POINTS[] = {
	{10, 3, TEXT}, {13, 2, OCTETS}, {20, 1, I8}, {21, 1, U8}, {22, 2, U32}, {30, 1, SECRET}};
static const struct modbus_input INPUTS[] = {{1, U32, 9}, {2, U32, 10}};
static const struct modbus_coil COILS[] = {{1, U8, false, 0}, {2, U32, true, 7}, {3, I8, true, 8}};
static const struct modbus_map MAP = {POINTS, INPUTS, COILS, 6, 2, 3, "", ""};

static struct od od;
static struct values values;

static int fresh(void **state)
{
	(void)state;
	od_init(&od, &TABLE, &values, 1);
	return 0;
}

/* These registers are read as these bytes. */
static void reads(uint16_t address, unsigned count, bool low_first, const char *bytes)
{
	uint8_t out[20] = {0};

	assert_int_equal(modbus_map_read(&MAP, &od, low_first, address, count, out), OD_OK);
	assert_memory_equal(out, bytes, 2 * count);
}

static void test_strings_have_two_characters_a_register_and_are_padded(void **state)
{
	(void)state;
	reads(10, 5, false, "abc\0\0\0\1\2\3\0");
	reads(10, 5, true, "abc\0\0\0\1\2\3\0"); /* the order of words is that of numbers */
	reads(11, 1, false, "c\0");
	reads(12, 2, false, "\0\0\1\2");
	values.text[0] = '\0';
	reads(10, 3, false, "\0\0\0\0\0\0");
}

static void test_values_of_8_bits_are_extended_by_their_sign(void **state)
{
	(void)state;
	reads(20, 2, false, "\xFF\xFE\0\xC8");
	values.i8 = 127;
	reads(20, 1, false, "\0\x7F");
}

static void test_the_order_of_words_can_be_chosen(void **state)
{
	(void)state;
	reads(22, 2, false, "\1\2\3\4");
	reads(22, 2, true, "\3\4\1\2");
	reads(23, 1, true, "\1\2");
}

static void test_what_cannot_be_read_is_told(void **state)
{
	uint8_t out[40];

	(void)state;
	assert_int_equal(modbus_map_read(&MAP, &od, false, 9, 1, out), OD_NO_OBJECT);
	assert_int_equal(modbus_map_read(&MAP, &od, false, 14, 2, out), OD_NO_OBJECT);
	assert_int_equal(modbus_map_read(&MAP, &od, false, 24, 1, out), OD_NO_OBJECT);
	assert_int_equal(modbus_map_read(&MAP, &od, false, 31, 1, out), OD_NO_OBJECT);
	assert_int_equal(modbus_map_read(&MAP, &od, false, 30, 1, out), OD_WRITE_ONLY);
}

/* Each address alone, and each bit: those of the tables and no other. */
static void test_only_the_addresses_of_the_map_are_there(void **state)
{
	uint8_t out[OD_VALUE_MAX];

	(void)state;
	for (unsigned a = 0; a <= 0xFFFF; a++) {
		bool text = a >= 10 && a < 13, octets = a == 13 || a == 14, numbers = a >= 20 && a < 24;
		enum od_status expected = text || octets || numbers ? OD_OK : a == 30 ? OD_WRITE_ONLY : OD_NO_OBJECT;

		assert_int_equal(modbus_map_read(&MAP, &od, false, (uint16_t)a, 1, out), expected);
		out[0] = 0;
		assert_int_equal(modbus_map_read_bits(&MAP, &od, MODBUS_COILS, (uint16_t)a, 1, out),
			a >= 1 && a <= 3 ? OD_OK : OD_NO_OBJECT);
		assert_int_equal(modbus_map_read_bits(&MAP, &od, MODBUS_DISCRETE_INPUTS, (uint16_t)a, 1, out),
			a == 1 || a == 2 ? OD_OK : OD_NO_OBJECT);
	}
}

/* A value of the greatest size, as number of four registers and as string. */
static void test_wide_values_are_read_and_written_in_both_orders(void **state)
{
	static const struct od_entry wide[] = {
		{.index = 1, .type = OD_UNSIGNED64, .access = OD_READ | OD_WRITE, .size = 8, .factor = 1, .name = ""},
		{.index = 2,
			.type = OD_OCTET_STRING,
			.access = OD_READ | OD_WRITE,
			.size = OD_VALUE_MAX,
			.offset = 8,
			.factor = 1,
			.name = ""}};
	static const struct modbus_point points[] = {{1, 4, 0}, {5, OD_VALUE_MAX / 2, 1}};
	static const struct modbus_input inputs[] = {{7, 0, 63}, {8, 0, 0}, {9, 1, 255}};
	static const struct modbus_map map = {points, inputs, NULL, 2, 3, 0, "", ""};
	static const uint8_t words[] = {1, 2, 3, 4, 5, 6, 7, 0x88}, low_first[] = {7, 0x88, 5, 6, 3, 4, 1, 2};
	static const uint8_t zeros[8 + OD_VALUE_MAX];
	const struct od_table table = {wide, 2, zeros, sizeof(zeros)};
	struct modbus_item items[2];
	uint64_t bytes[1 + OD_VALUE_MAX / 8];
	uint8_t in[2 * (4 + OD_VALUE_MAX / 2)], out[sizeof(in)], bits[1];
	struct od wide_od;
	unsigned n;

	(void)state;
	od_init(&wide_od, &table, bytes, 1);
	for (int low = 0; low <= 1; low++) {
		memcpy(in, low ? low_first : words, 8);
		for (unsigned i = 0; i < OD_VALUE_MAX; i++)
			in[8 + i] = (uint8_t)(200 - i);
		assert_int_equal(modbus_map_items(&map, &table, low, 1, sizeof(in) / 2, in, items, &n), OD_OK);
		assert_int_equal(n, 2);
		assert_int_equal(items[0].size, 8);
		assert_memory_equal(items[0].wire, "\x88\7\6\5\4\3\2\1", 8);
		assert_int_equal(items[1].size, OD_VALUE_MAX);
		assert_memory_equal(items[1].wire, in + 8, OD_VALUE_MAX);
		for (int i = 0; i < 2; i++)
			assert_int_equal(od_put(&wide_od, items[i].entry, items[i].wire, items[i].size), OD_OK);
		assert_int_equal(modbus_map_read(&map, &wide_od, low, 1, sizeof(out) / 2, out), OD_OK);
		assert_memory_equal(out, in, sizeof(in));
	}
	bits[0] = 0;
	assert_int_equal(modbus_map_read_bits(&map, &wide_od, MODBUS_DISCRETE_INPUTS, 7, 3, bits), OD_OK);
	assert_int_equal(bits[0], 0 | 0 << 1 | (200 - 31) >> 7 << 2);
	bytes[0] = 0x8000000000000001;
	bits[0] = 0;
	assert_int_equal(modbus_map_read_bits(&map, &wide_od, MODBUS_DISCRETE_INPUTS, 7, 2, bits), OD_OK);
	assert_int_equal(bits[0], 3);
}

static void test_as_many_coils_as_items_are_written_at_once(void **state)
{
	static struct modbus_coil many[MODBUS_REGISTERS_MAX + 1];
	static const uint8_t on[(MODBUS_REGISTERS_MAX + 8) / 8];
	static struct modbus_item items[MODBUS_REGISTERS_MAX];
	const struct modbus_map map = {.coils = many, .coil_count = MODBUS_REGISTERS_MAX + 1};
	unsigned n;

	(void)state;
	for (uint16_t i = 0; i <= MODBUS_REGISTERS_MAX; i++)
		many[i] = (struct modbus_coil){.address = i, .entry = U8};
	assert_int_equal(modbus_map_coil_items(&map, &TABLE, 0, MODBUS_REGISTERS_MAX, on, items, &n), OD_OK);
	assert_int_equal(n, MODBUS_REGISTERS_MAX);
	assert_int_equal(modbus_map_coil_items(&map, &TABLE, 0, MODBUS_REGISTERS_MAX + 1, on, items, &n), OD_NO_OBJECT);
}

static enum od_status items_of(uint16_t address, unsigned count, const char *in, struct modbus_item *items, unsigned *n)
{
	return modbus_map_items(&MAP, &TABLE, false, address, count, (const uint8_t *)in, items, n);
}

static void test_a_written_string_ends_with_its_first_0_and_octets_do_not(void **state)
{
	struct modbus_item items[8];
	unsigned n;

	(void)state;
	assert_int_equal(items_of(10, 5, "xy\0zzz\0\1\2\3", items, &n), OD_OK);
	assert_int_equal(n, 2);
	assert_ptr_equal(items[0].entry, &ENTRIES[TEXT]);
	assert_int_equal(items[0].size, 2);
	assert_memory_equal(items[0].wire, "xy", 2);
	assert_ptr_equal(items[1].entry, &ENTRIES[OCTETS]);
	assert_int_equal(items[1].size, 3);
	assert_memory_equal(items[1].wire, "\0\1\2", 3);
}

static void test_a_register_of_a_value_of_8_bits_has_its_limits(void **state)
{
	static const struct {
		uint16_t address;
		const char *in;
		enum od_status status;
		uint8_t value;
	} cases[] = {{20, "\0\x7F", OD_OK, 127}, {20, "\0\x80", OD_TOO_HIGH, 0}, {20, "\xFF\x80", OD_OK, 128},
		{20, "\xFF\x7F", OD_TOO_LOW, 0}, {21, "\0\xFF", OD_OK, 255}, {21, "\1\0", OD_TOO_HIGH, 0}};
	struct modbus_item items[8];
	unsigned n;

	(void)state;
	for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
		assert_int_equal(items_of(cases[i].address, 1, cases[i].in, items, &n), cases[i].status);
		if (cases[i].status == OD_OK)
			assert_int_equal(items[0].wire[0], cases[i].value);
	}
}

static void test_a_part_of_a_value_is_not_written(void **state)
{
	struct modbus_item items[8];
	unsigned n;

	(void)state;
	assert_int_equal(items_of(22, 1, "\0\0", items, &n), OD_NO_OBJECT);
	assert_int_equal(items_of(23, 1, "\0\0", items, &n), OD_NO_OBJECT);
	assert_int_equal(items_of(21, 2, "\0\0\0\0", items, &n), OD_NO_OBJECT);
	assert_int_equal(items_of(21, 3, "\0\1\5\6\7\10", items, &n), OD_OK);
	assert_int_equal(n, 2);
	assert_memory_equal(items[1].wire, "\10\7\6\5", 4);
	assert_int_equal(modbus_map_items(&MAP, &TABLE, true, 22, 2, (const uint8_t *)"\5\6\7\10", items, &n), OD_OK);
	assert_memory_equal(items[0].wire, "\6\5\10\7", 4);
}

static void test_bits_are_those_of_values_and_commands_read_0(void **state)
{
	uint8_t out[1] = {0};

	(void)state;
	assert_int_equal(modbus_map_read_bits(&MAP, &od, MODBUS_DISCRETE_INPUTS, 1, 2, out), OD_OK);
	assert_int_equal(out[0], 1); /* 0x01020304 has bit 9 and not bit 10 */
	values.u8 = 1;
	out[0] = 0;
	assert_int_equal(modbus_map_read_bits(&MAP, &od, MODBUS_COILS, 1, 3, out), OD_OK);
	assert_int_equal(out[0], 1);
	assert_int_equal(modbus_map_read_bits(&MAP, &od, MODBUS_COILS, 0, 1, out), OD_NO_OBJECT);
	assert_int_equal(modbus_map_read_bits(&MAP, &od, MODBUS_DISCRETE_INPUTS, 3, 1, out), OD_NO_OBJECT);
}

static void test_a_command_is_alone(void **state)
{
	static const uint8_t none = 0, value = 1, command = 2, both = 3, commands = 6;
	struct modbus_item items[8];
	unsigned n;

	(void)state;
	assert_int_equal(modbus_map_coil_items(&MAP, &TABLE, 1, 3, &value, items, &n), OD_OK);
	assert_int_equal(n, 1);
	assert_int_equal(items[0].wire[0], 1);
	assert_int_equal(modbus_map_coil_items(&MAP, &TABLE, 1, 1, &none, items, &n), OD_OK);
	assert_int_equal(n, 1);
	assert_int_equal(items[0].wire[0], 0);
	assert_int_equal(modbus_map_coil_items(&MAP, &TABLE, 2, 1, &none, items, &n), OD_OK);
	assert_int_equal(n, 0);
	assert_int_equal(modbus_map_coil_items(&MAP, &TABLE, 2, 1, &value, items, &n), OD_OK);
	assert_int_equal(n, 1);
	assert_int_equal(items[0].size, 4);
	assert_memory_equal(items[0].wire, "\7\0\0\0", 4);
	assert_int_equal(modbus_map_coil_items(&MAP, &TABLE, 1, 3, &command, items, &n), OD_INCOMPATIBLE);
	assert_int_equal(modbus_map_coil_items(&MAP, &TABLE, 1, 3, &both, items, &n), OD_INCOMPATIBLE);
	assert_int_equal(modbus_map_coil_items(&MAP, &TABLE, 1, 3, &commands, items, &n), OD_INCOMPATIBLE);
	assert_int_equal(modbus_map_coil_items(&MAP, &TABLE, 3, 2, &none, items, &n), OD_NO_OBJECT);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test_setup(test_strings_have_two_characters_a_register_and_are_padded, fresh),
		cmocka_unit_test_setup(test_values_of_8_bits_are_extended_by_their_sign, fresh),
		cmocka_unit_test_setup(test_the_order_of_words_can_be_chosen, fresh),
		cmocka_unit_test_setup(test_what_cannot_be_read_is_told, fresh),
		cmocka_unit_test_setup(test_only_the_addresses_of_the_map_are_there, fresh),
		cmocka_unit_test_setup(test_wide_values_are_read_and_written_in_both_orders, fresh),
		cmocka_unit_test_setup(test_as_many_coils_as_items_are_written_at_once, fresh),
		cmocka_unit_test_setup(test_a_written_string_ends_with_its_first_0_and_octets_do_not, fresh),
		cmocka_unit_test_setup(test_a_register_of_a_value_of_8_bits_has_its_limits, fresh),
		cmocka_unit_test_setup(test_a_part_of_a_value_is_not_written, fresh),
		cmocka_unit_test_setup(test_bits_are_those_of_values_and_commands_read_0, fresh),
		cmocka_unit_test_setup(test_a_command_is_alone, fresh),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
