/* Names and values as text. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "od_values.h"

enum { ROUNDS = 20000 };

static const struct od_entry BOOLEAN = {.type = OD_BOOLEAN, .size = 1}, I8 = {.type = OD_INTEGER8, .size = 1},
			     I16 = {.type = OD_INTEGER16, .size = 2}, I32 = {.type = OD_INTEGER32, .size = 4},
			     I64 = {.type = OD_INTEGER64, .size = 8}, U8 = {.type = OD_UNSIGNED8, .size = 1},
			     U16 = {.type = OD_UNSIGNED16, .size = 2}, U32 = {.type = OD_UNSIGNED32, .size = 4},
			     U64 = {.type = OD_UNSIGNED64, .size = 8}, REAL32 = {.type = OD_REAL32, .size = 4},
			     REAL64 = {.type = OD_REAL64, .size = 8}, TEXT = {.type = OD_VISIBLE_STRING, .size = 8},
			     OCTETS = {.type = OD_OCTET_STRING, .size = 3}, DOMAIN = {.type = OD_DOMAIN};

static void assert_parses(const struct od_entry *entry, const char *text, const char *wire, size_t size)
{
	uint8_t parsed[OD_VALUE_MAX];
	size_t parsed_size = 99;

	assert_int_equal(od_parse(entry, text, parsed, sizeof(parsed), &parsed_size), OD_OK);
	assert_int_equal(parsed_size, size);
	if (size)
		assert_memory_equal(parsed, wire, size);
}

static void assert_refused(const struct od_entry *entry, const char *text, enum od_status status)
{
	uint8_t parsed[OD_VALUE_MAX];
	size_t size;

	assert_int_equal(od_parse(entry, text, parsed, sizeof(parsed), &size), status);
}

static void assert_prints(const struct od_entry *entry, const void *wire, const char *text)
{
	char printed[160];

	assert_int_equal(od_format(entry, wire, entry->size, printed, sizeof(printed)), strlen(text));
	assert_string_equal(printed, text);
}

static void assert_prints_real32(float value, const char *text)
{
	uint8_t wire[4];
	uint32_t bits;

	memcpy(&bits, &value, sizeof(bits));
	for (int i = 0; i < 4; i++)
		wire[i] = (uint8_t)(bits >> 8 * i);
	assert_prints(&REAL32, wire, text);
}

/* ---- values ---- */

static void test_integers_are_decimal_or_hex(void **state)
{
	(void)state;
	assert_parses(&U32, "305419896", "\x78\x56\x34\x12", 4);
	assert_parses(&U32, "0x12345678", "\x78\x56\x34\x12", 4);
	assert_parses(&U32, "0X12345678", "\x78\x56\x34\x12", 4);
	assert_parses(&U8, "010", "\x0A", 1);
	assert_parses(&I16, "-2", "\xFE\xFF", 2);
	assert_parses(&I16, "-0x10", "\xF0\xFF", 2);
	assert_parses(&U16, " 7\t", "\7\0", 2);
}

static void test_true_and_false_are_1_and_0(void **state)
{
	(void)state;
	assert_parses(&BOOLEAN, "true", "\1", 1);
	assert_parses(&U8, "False", "\0", 1);
	assert_parses(&BOOLEAN, "1", "\1", 1);
	assert_refused(&BOOLEAN, "2", OD_TOO_HIGH);
	assert_refused(&REAL32, "true", OD_BAD_VALUE);
}

static void test_the_ends_of_each_integer_type_are_accepted_and_one_beyond_is_not(void **state)
{
	static const struct {
		const struct od_entry *entry;
		const char *low, *below, *high, *above;
	} CASES[] = {
		{&I8, "-128", "-129", "127", "128"},
		{&I16, "-32768", "-32769", "32767", "32768"},
		{&I32, "-2147483648", "-2147483649", "2147483647", "2147483648"},
		{&I64, "-9223372036854775808", "-9223372036854775809", "9223372036854775807", "9223372036854775808"},
		{&U8, "0", "-1", "255", "256"},
		{&U16, "0", "-1", "0xFFFF", "0x10000"},
		{&U32, "0", "-1", "4294967295", "4294967296"},
		{&U64, "0", "-1", "18446744073709551615", "18446744073709551616"},
	};

	(void)state;
	for (size_t i = 0; i < sizeof(CASES) / sizeof(*CASES); i++) {
		uint8_t wire[8];
		char printed[32];
		size_t size;

		assert_int_equal(od_parse(CASES[i].entry, CASES[i].low, wire, 8, &size), OD_OK);
		assert_true(od_format(CASES[i].entry, wire, size, printed, sizeof(printed)) > 0);
		assert_string_equal(printed, CASES[i].low);
		assert_int_equal(od_parse(CASES[i].entry, CASES[i].high, wire, 8, &size), OD_OK);
		assert_refused(CASES[i].entry, CASES[i].below, OD_TOO_LOW);
		assert_refused(CASES[i].entry, CASES[i].above, OD_TOO_HIGH);
	}
}

static void test_text_that_is_not_an_integer_is_refused(void **state)
{
	static const char *const TEXTS[] = {
		"", " ", "x", "1x", "1.0", "1e3", "0x", "0xG", "--1", "- 1", "+1", "1 2", "-", "0x-1", "nan", "ten"};

	(void)state;
	for (size_t i = 0; i < sizeof(TEXTS) / sizeof(*TEXTS); i++) {
		assert_refused(&U32, TEXTS[i], OD_BAD_VALUE);
		assert_refused(&I32, TEXTS[i], OD_BAD_VALUE);
	}
	assert_refused(&U32, "9999999999999999999999999999999999999999999999999999999999999999999999", OD_TOO_HIGH);
}

static void test_floats_are_read(void **state)
{
	(void)state;
	assert_parses(&REAL32, "0.25", "\x00\x00\x80\x3E", 4);
	assert_parses(&REAL32, " -1e-3 ", "\x6F\x12\x83\xBA", 4);
	assert_parses(&REAL32, "3", "\x00\x00\x40\x40", 4);
	assert_parses(&REAL32, "3.4028234663852886e38", "\xFF\xFF\x7F\x7F", 4);
	assert_parses(&REAL64, "0.5", "\0\0\0\0\0\0\xE0\x3F", 8);
}

static void test_floats_beyond_their_type_and_text_that_is_not_a_number_are_refused(void **state)
{
	static const char *const TEXTS[] = {
		"", "nan", "-NaN", "nan(1)", "inf", "-Infinity", "1.0.0", "1,5", "1 m", "e5"};

	(void)state;
	for (size_t i = 0; i < sizeof(TEXTS) / sizeof(*TEXTS); i++) {
		assert_refused(&REAL32, TEXTS[i], OD_BAD_VALUE);
		assert_refused(&REAL64, TEXTS[i], OD_BAD_VALUE);
	}
	assert_refused(&REAL32, "1e39", OD_TOO_HIGH);
	assert_refused(&REAL32, "-1e39", OD_TOO_LOW);
	assert_refused(&REAL64, "1e400", OD_TOO_HIGH);
	assert_refused(&REAL64, "-1e400", OD_TOO_LOW);
}

static void test_strings_are_not_converted(void **state)
{
	(void)state;
	assert_parses(&TEXT, " a b ", " a b ", 5);
	assert_parses(&TEXT, "", "", 0);
	assert_parses(&TEXT, "12345678", "12345678", 8);
	assert_refused(&TEXT, "123456789", OD_TOO_LONG);
}

static void test_octets_are_pairs_of_hex_digits(void **state)
{
	(void)state;
	assert_parses(&OCTETS, "0a0BfF", "\x0A\x0B\xFF", 3);
	assert_refused(&OCTETS, "0a0", OD_BAD_VALUE);
	assert_refused(&OCTETS, "0g", OD_BAD_VALUE);
	assert_refused(&OCTETS, "00112233", OD_TOO_LONG);
	assert_prints(&OCTETS, "\x0A\x0B\xFF", "0a0bff");
}

static void test_a_domain_has_no_text(void **state)
{
	(void)state;
	assert_refused(&DOMAIN, "x", OD_UNSUPPORTED_ACCESS);
}

static void test_a_buffer_too_small_for_the_value_is_refused(void **state)
{
	uint8_t wire[4];
	char text[4];
	size_t size;

	(void)state;
	assert_int_equal(od_parse(&U32, "1", wire, 3, &size), OD_TOO_LONG);
	assert_int_equal(od_parse(&TEXT, "abc", wire, 2, &size), OD_TOO_LONG);
	assert_int_equal(od_format(&U32, "\xE8\x03\0\0", 4, text, sizeof(text)), -ENOSPC);
	assert_int_equal(od_format(&U32, "\xE7\x03\0\0", 4, text, sizeof(text)), 3);
	assert_int_equal(od_format(&TEXT, "abcd", 4, text, sizeof(text)), -ENOSPC);
	assert_int_equal(od_format(&OCTETS, "ab", 2, text, sizeof(text)), -ENOSPC);
	assert_int_equal(od_format(&OCTETS, "a", 1, text, sizeof(text)), 2);
}

static void test_a_number_of_another_size_is_not_printed(void **state)
{
	char text[32];

	(void)state;
	assert_int_equal(od_format(&U32, "\1\2", 2, text, sizeof(text)), -EINVAL);
	assert_int_equal(od_format(&REAL32, "\0\0\0\0\0\0\0\0", 8, text, sizeof(text)), -EINVAL);
}

static void test_floats_are_printed_with_the_fewest_digits(void **state)
{
	(void)state;
	assert_prints_real32(0.1f, "0.1");
	assert_prints_real32(9.81f, "9.81");
	assert_prints_real32(0, "0");
	assert_prints_real32(-0.0f, "-0");
	assert_prints_real32(16777216, "16777216");
	assert_prints_real32(8.6e9f, "8.6e+09"); /* 8600000512 */
	assert_prints_real32(1e-20f, "1e-20");
	assert_prints_real32(NAN, "nan");
	assert_prints_real32(-INFINITY, "-inf");
}

static void test_control_codes_from_another_device_do_not_reach_the_terminal(void **state)
{
	char text[16];

	(void)state;
	assert_int_equal(od_format(&TEXT, "a \x1B[2J\n", 7, text, sizeof(text)), 7);
	assert_string_equal(text, "a ?[2J?");
	assert_int_equal(od_format(&TEXT,
				 "\x9B"
				 "2J",
				 3, text, sizeof(text)),
		3);
	assert_string_equal(text, "?2J");
}

static void assert_limits(struct od_entry entry, const char *expected)
{
	char text[64];

	od_limits_text(&entry, text, sizeof(text));
	assert_string_equal(text, expected);
}

static void test_limits_are_printed_with_their_unit_if_a_step_is_one_unit(void **state)
{
	struct od_entry metres = {.type = OD_REAL32, .size = 4, .low.f = -10, .high.f = 2.5, .unit = "m", .factor = 1};
	struct od_entry steps = {
		.type = OD_INTEGER16, .size = 2, .low.i = -9000, .high.i = 9000, .unit = "deg", .factor = 0.01};
	struct od_entry count = {
		.type = OD_UNSIGNED64, .size = 8, .low.u = 1, .high.u = 1u << 31, .unit = "", .factor = 1};

	(void)state;
	assert_limits(metres, "");
	metres.access = OD_LIMIT_LOW | OD_LIMIT_HIGH;
	assert_limits(metres, "-10 to 2.5 m");
	metres.access = OD_LIMIT_LOW;
	assert_limits(metres, "-10 m or more");
	steps.access = OD_LIMIT_LOW | OD_LIMIT_HIGH;
	assert_limits(steps, "-9000 to 9000");
	count.access = OD_LIMIT_HIGH;
	assert_limits(count, "2147483648 or less");
}

static void test_padding_of_a_string_is_not_printed(void **state)
{
	char text[16];

	(void)state;
	assert_int_equal(od_format(&TEXT, "abc\0\0\0", 6, text, sizeof(text)), 3);
	assert_string_equal(text, "abc");
}

static void test_the_text_of_every_value_gives_the_same_bytes(void **state)
{
	static const struct od_entry *const ENTRIES[] = {
		&BOOLEAN, &I8, &I16, &I32, &I64, &U8, &U16, &U32, &U64, &REAL32, &REAL64, &OCTETS};

	(void)state;
	srand(2);
	for (int round = 0; round < ROUNDS; round++) {
		const struct od_entry *entry = ENTRIES[round % 12];
		uint8_t wire[8], again[8];
		char text[64];
		size_t size;

		for (int i = 0; i < 8; i++)
			wire[i] = (uint8_t)rand();
		if (entry == &BOOLEAN)
			wire[0] &= 1;
		if ((entry == &REAL32 && (wire[3] & 0x7F) == 0x7F && wire[2] & 0x80) ||
			(entry == &REAL64 && (wire[7] & 0x7F) == 0x7F && (wire[6] & 0xF0) == 0xF0))
			continue; /* infinity or NaN */
		assert_true(od_format(entry, wire, entry->size, text, sizeof(text)) > 0);
		assert_int_equal(od_parse(entry, text, again, sizeof(again), &size), OD_OK);
		assert_int_equal(size, entry->size);
		assert_memory_equal(again, wire, size);
	}
}

/* ---- names ---- */

static void assert_finds(const char *name, uint16_t index, uint8_t sub)
{
	const struct od_entry *entry = od_find_name(&imu9_od_table, name);

	assert_non_null(entry);
	assert_int_equal(entry->index, index);
	assert_int_equal(entry->sub, sub);
}

static void test_every_entry_is_found_by_its_name(void **state)
{
	(void)state;
	for (size_t i = 0; i < imu9_od_table.count; i++)
		assert_ptr_equal(
			od_find_name(&imu9_od_table, imu9_od_table.entries[i].name), &imu9_od_table.entries[i]);
}

static void test_names_may_be_written_as_in_the_eds(void **state)
{
	(void)state;
	assert_finds("Lever arm.l", 0x2000, 1);
	assert_finds("Lever arm l", 0x2000, 1);
	assert_finds("lever_arm_l", 0x2000, 1);
	assert_finds("TPDO1 communication.COB-ID", 0x1800, 1);
	assert_finds("GRAVITY", 0x2003, 0);
}

static void test_entries_are_found_by_their_numbers(void **state)
{
	(void)state;
	assert_finds("0x2000:1", 0x2000, 1);
	assert_finds("0X2000:1", 0x2000, 1);
	assert_finds("2000h:1", 0x2000, 1);
	assert_finds("0x2003", 0x2003, 0);
	assert_finds("2003H", 0x2003, 0);
	assert_finds("0x2050:12", 0x2050, 12);
	assert_finds("2050h:0Ch", 0x2050, 12);
	assert_finds("0x2050:0xC", 0x2050, 12);
}

static void test_an_unknown_name_is_not_found(void **state)
{
	static const char *const NAMES[] = {"", ".", "lever_arm", "lever_arm.", "lever_arm.x", "lever_arm.ll", "lever",
		"leverarm.l", "lever_arm.l ", "lever_arm.l.l", "2000", "2000:1", "0x2000:", "0x2000:1:1", "0x2000:9",
		"0x2000:256", "0x12003", "2000hh", "h", "0x", "0x2000:1x", "-0x2000", "l ver_arm.l", "lever_a m.l",
		"lever_arm. l"};

	(void)state;
	for (size_t i = 0; i < sizeof(NAMES) / sizeof(*NAMES); i++)
		assert_null(od_find_name(&imu9_od_table, NAMES[i]));
}

static void test_every_status_has_its_own_text(void **state)
{
	(void)state;
	for (int a = 0; a < OD_STATUS_COUNT; a++) {
		assert_string_not_equal(od_status_text((enum od_status)a), od_status_text(OD_STATUS_COUNT));
		for (int b = 0; b < a; b++)
			assert_string_not_equal(od_status_text((enum od_status)a), od_status_text((enum od_status)b));
	}
}

/* ---- words */

static const struct od_entry MODE = {.type = OD_UNSIGNED8, .size = 1, .words = "off, paper, 4 rigid_body, -x"};
static const struct od_entry FLAGS = {
	.type = OD_UNSIGNED16, .size = 2, .words = "valid, rest, 9 lost", .words_of_bits = true};

static void assert_words(const struct od_entry *entry, uint64_t value, const char *expected)
{
	char text[64];

	od_words_text(entry, value, text, sizeof(text));
	assert_string_equal(text, expected);
}

static void test_a_value_is_read_by_its_word(void **state)
{
	(void)state;
	assert_parses(&MODE, "off", "\0", 1);
	assert_parses(&MODE, " Rigid_Body ", "\4", 1);
	assert_parses(&MODE, "-x", "\5", 1);
	assert_parses(&MODE, "3", "\3", 1);
	assert_refused(&MODE, "rigid", OD_BAD_VALUE);
	assert_refused(&MODE, "off,paper", OD_BAD_VALUE);
	assert_refused(&MODE, "none", OD_BAD_VALUE);
	assert_refused(&MODE, "", OD_BAD_VALUE);
	assert_refused(&U8, "off", OD_BAD_VALUE);
}

static void test_bits_are_read_by_their_words(void **state)
{
	(void)state;
	assert_parses(&FLAGS, "rest", "\2\0", 2);
	assert_parses(&FLAGS, "lost,valid", "\1\2", 2);
	assert_parses(&FLAGS, "none", "\0\0", 2);
	assert_parses(&FLAGS, "0x200", "\0\2", 2);
	assert_refused(&FLAGS, "valid,", OD_BAD_VALUE);
	assert_refused(&FLAGS, "valid,found", OD_BAD_VALUE);
}

static void test_values_and_bits_are_written_as_words(void **state)
{
	(void)state;
	assert_words(&MODE, 0, "off");
	assert_words(&MODE, 4, "rigid_body");
	assert_words(&MODE, 3, "");
	assert_words(&FLAGS, 0, "none");
	assert_words(&FLAGS, 1 << 9 | 1, "valid,lost");
	assert_words(&FLAGS, 1 << 3 | 1 << 1, "rest,bit3");
	assert_words(&U8, 1, "");
}

static void test_words_that_do_not_fit_are_cut(void **state)
{
	char text[8];

	(void)state;
	od_words_text(&FLAGS, 0xFFFF, text, sizeof(text));
	assert_string_equal(text, "valid,r");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_value_is_read_by_its_word),
		cmocka_unit_test(test_bits_are_read_by_their_words),
		cmocka_unit_test(test_values_and_bits_are_written_as_words),
		cmocka_unit_test(test_words_that_do_not_fit_are_cut),
		cmocka_unit_test(test_integers_are_decimal_or_hex),
		cmocka_unit_test(test_true_and_false_are_1_and_0),
		cmocka_unit_test(test_the_ends_of_each_integer_type_are_accepted_and_one_beyond_is_not),
		cmocka_unit_test(test_text_that_is_not_an_integer_is_refused),
		cmocka_unit_test(test_floats_are_read),
		cmocka_unit_test(test_floats_beyond_their_type_and_text_that_is_not_a_number_are_refused),
		cmocka_unit_test(test_strings_are_not_converted),
		cmocka_unit_test(test_octets_are_pairs_of_hex_digits),
		cmocka_unit_test(test_a_domain_has_no_text),
		cmocka_unit_test(test_a_buffer_too_small_for_the_value_is_refused),
		cmocka_unit_test(test_a_number_of_another_size_is_not_printed),
		cmocka_unit_test(test_floats_are_printed_with_the_fewest_digits),
		cmocka_unit_test(test_control_codes_from_another_device_do_not_reach_the_terminal),
		cmocka_unit_test(test_limits_are_printed_with_their_unit_if_a_step_is_one_unit),
		cmocka_unit_test(test_padding_of_a_string_is_not_printed),
		cmocka_unit_test(test_the_text_of_every_value_gives_the_same_bytes),
		cmocka_unit_test(test_every_entry_is_found_by_its_name),
		cmocka_unit_test(test_names_may_be_written_as_in_the_eds),
		cmocka_unit_test(test_entries_are_found_by_their_numbers),
		cmocka_unit_test(test_an_unknown_name_is_not_found),
		cmocka_unit_test(test_every_status_has_its_own_text),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
