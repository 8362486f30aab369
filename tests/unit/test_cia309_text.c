/* Lines and values of CiA 309-3. The expected values are those that CANopenNode's canopend takes and prints, the test
 * vectors of RFC 4648 for base64, and the encodings of CiA 301, 7.1. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/cia309/parse.h"

/* ---- values ------------------------------------------------------------------------------------------------------ */

static const struct value {
	const char *type, *text;
	size_t size;
	const char *bytes;
	const char *printed; /* NULL: the text */
} VALUES[] = {
	{"b", "1", 1, "\x01", NULL},
	{"u8", "255", 1, "\xFF", NULL},
	{"u8", "0x1f", 1, "\x1F", "31"},
	{"u8", "00000000000000000000000000000000000000000000001", 1, "\x01", "1"},
	{"i8", "-128", 1, "\x80", NULL},
	{"i8", "127", 1, "\x7F", NULL},
	{"u16", "1000", 2, "\xE8\x03", NULL},
	{"i16", "-2", 2, "\xFE\xFF", NULL},
	{"u32", "4294967295", 4, "\xFF\xFF\xFF\xFF", NULL},
	{"i32", "-2147483648", 4, "\x00\x00\x00\x80", NULL},
	{"u64", "18446744073709551615", 8, "\xFF\xFF\xFF\xFF\xFF\xFF\xFF\xFF", NULL},
	{"i64", "-9223372036854775808", 8, "\x00\x00\x00\x00\x00\x00\x00\x80", NULL},
	{"x8", "0x0A", 1, "\x0A", NULL},
	{"x16", "26", 2, "\x1A\x00", "0x001A"},
	{"x32", "0x12345678", 4, "\x78\x56\x34\x12", NULL},
	{"x64", "0x00000000000000FF", 8, "\xFF\x00\x00\x00\x00\x00\x00\x00", NULL},
	{"r32", "0.05", 4, "\xCD\xCC\x4C\x3D", NULL},
	{"r32", "-1.5", 4, "\x00\x00\xC0\xBF", NULL},
	{"r64", "0.1", 8, "\x9A\x99\x99\x99\x99\x99\xB9\x3F", NULL},
	{"R32", "1e3", 4, "\x00\x00\x7A\x44", "1000"},
	/* 1 day and 2 ms: CiA 301, 7.1.6.5: ms first */
	{"t", "1 2", 6, "\x02\x00\x00\x00\x01\x00", NULL},
	{"td", "65535 268435455", 6, "\xFF\xFF\xFF\x0F\xFF\xFF", NULL},
	{"vs", "save", 4, "save", "\"save\""},
	{"vs", "\"two words\"", 9, "two words", NULL},
	{"vs", "\"a \"\" b\"", 5, "a \" b", NULL},
	{"vs", "say\"\"so", 6, "say\"so", "\"say\"\"so\""},
	{"vs", "a#b", 3, "a#b", "\"a#b\""},
	{"vs", "\"# none\"", 6, "# none", NULL},
	{"vs", "\"\"", 0, "", NULL},
	{"hex", "01 02 FF", 3, "\x01\x02\xFF", NULL},
	{"hex", "0102fF", 3, "\x01\x02\xFF", "01 02 FF"},
	{"hex", "1 2 0A", 3, "\x01\x02\x0A", "01 02 0A"},
	{"d", "Zg==", 1, "f", NULL},
	{"d", "Zm8=", 2, "fo", NULL},
	{"d", "Zm9v", 3, "foo", NULL},
	{"os", "Zm9vYg==", 4, "foob", NULL},
	{"us", "Zm9vYmE=", 5, "fooba", NULL},
	{"d", "Zm9vYmFy", 6, "foobar", NULL},
	{"d", "Zm9vYmE", 5, "fooba", "Zm9vYmE="},
	{"d", "+/+/", 3, "\xFB\xFF\xBF", NULL},
};

/* In pieces of the smallest size that is allowed. */
static size_t print_all(const struct cia309_type *type, const void *bytes, size_t size, char *text)
{
	struct cia309_printer p = {.type = type, .bytes = bytes, .size = size};
	size_t n = 0;

	while (!cia309_printed(&p)) {
		size_t piece = cia309_print(&p, text + n, CIA309_PRINT_MIN);

		assert_in_range(piece, 0, CIA309_PRINT_MIN);
		n += piece;
	}
	text[n] = '\0';
	return n;
}

static void test_each_value_has_its_bytes_and_its_text(void **state)
{
	(void)state;
	for (size_t i = 0; i < sizeof(VALUES) / sizeof(VALUES[0]); i++) {
		const struct value *v = &VALUES[i];
		const struct cia309_type *type = cia309_type(v->type);
		uint8_t bytes[16];
		char text[64], line[96];

		assert_non_null(type);
		assert_int_equal(cia309_scan(type, v->text, strlen(v->text), bytes, sizeof(bytes)), v->size);
		assert_memory_equal(bytes, v->bytes, v->size);
		print_all(type, v->bytes, v->size, text);
		assert_string_equal(text, v->printed ? v->printed : v->text);
		/* CR, blanks and a comment may follow */
		snprintf(line, sizeof(line), "  %s \t # why\r", v->text);
		assert_int_equal(cia309_scan(type, line, strlen(line), bytes, sizeof(bytes)), v->size);
		assert_memory_equal(bytes, v->bytes, v->size);
	}
}

static void test_what_is_no_value_of_its_type_is_refused(void **state)
{
	static const char *const BAD[][2] = {{"b", "2"}, {"b", "yes"}, {"u8", "256"}, {"u8", "-1"}, {"i8", "128"},
		{"i8", "-129"}, {"u16", "0x10000"}, {"i16", "32768"}, {"u32", "4294967296"}, {"u32", "1 2"},
		{"u32", "1x"}, {"u64", "18446744073709551616"}, {"r32", "1e39"}, {"r32", "abc"},
		{"u8", "000000000000000000000000000000000000000000000000000000000001"}, {"r64", "nan"}, {"t", "1"},
		{"t", "65536 0"}, {"t", "0 268435456"}, {"vs", "two words"}, {"vs", "\"open"}, {"vs", "a\"b"},
		{"vs", "\"a\"b"}, {"hex", "0G"}, {"hex", ""}, {"d", "Zm9vY"}, {"d", "Zm-v"}, {"d", ""}, {"vs", ""},
		{"u8", "# 1"}, {"u8", "000000000000000000000000000000000000000000000001"}};
	uint8_t bytes[16];

	(void)state;
	for (size_t i = 0; i < sizeof(BAD) / sizeof(BAD[0]); i++)
		assert_int_equal(
			cia309_scan(cia309_type(BAD[i][0]), BAD[i][1], strlen(BAD[i][1]), bytes, sizeof(bytes)),
			-EINVAL);
	assert_null(cia309_type("u24"));
	assert_null(cia309_type(""));
}

static void test_a_value_longer_than_its_buffer_is_told_apart(void **state)
{
	uint8_t bytes[4];

	(void)state;
	assert_int_equal(cia309_scan(cia309_type("vs"), "12345", 5, bytes, 4), -ENOSPC);
	assert_int_equal(cia309_scan(cia309_type("hex"), "0102030405", 10, bytes, 4), -ENOSPC);
	assert_int_equal(cia309_scan(cia309_type("d"), "Zm9vYmFy", 8, bytes, 4), -ENOSPC);
	assert_int_equal(cia309_scan(cia309_type("u64"), "1", 1, bytes, 4), -ENOSPC);
	assert_int_equal(cia309_scan(cia309_type("vs"), "1234", 4, bytes, 4), 4);
}

static void test_bytes_of_another_size_than_their_type_are_printed_in_hex(void **state)
{
	char text[64];

	(void)state;
	print_all(cia309_type("u16"), "\x01\x02\x03", 3, text);
	assert_string_equal(text, "01 02 03");
	print_all(cia309_type("r64"), "\x01", 1, text);
	assert_string_equal(text, "01");
}

static void test_no_string_contains_the_end_of_an_answer(void **state)
{
	char text[64];

	(void)state;
	print_all(cia309_type("vs"), "a\r\nb\0c", 6, text);
	assert_string_equal(text, "\"a\nbc\"");
}

static void test_a_long_value_is_printed_in_pieces_and_read_again(void **state)
{
	static const char *const TYPES[] = {"vs", "d", "os", "hex"};
	static uint8_t bytes[5000], back[sizeof(bytes)];
	static char text[4 * sizeof(bytes)];

	(void)state;
	for (size_t i = 0; i < sizeof(TYPES) / sizeof(TYPES[0]); i++) {
		const struct cia309_type *type = cia309_type(TYPES[i]);

		for (size_t k = 0; k < sizeof(bytes); k++)
			bytes[k] = (uint8_t)(strcmp(TYPES[i], "vs") == 0 ? ' ' + k * 7 % 95 : k * 7 + k / 256);
		for (size_t size = sizeof(bytes) - 3; size <= sizeof(bytes); size++) {
			size_t n = print_all(type, bytes, size, text);

			assert_int_equal(cia309_scan(type, text, n, back, sizeof(back)), size);
			assert_memory_equal(back, bytes, size);
		}
	}
}

/* ---- lines ------------------------------------------------------------------------------------------------------- */

static struct cia309_command parsed(const char *line, enum cia309_error expected)
{
	struct cia309_command c;

	assert_int_equal(cia309_parse(line, strlen(line), &c), expected);
	return c;
}

static void test_read_names_node_object_and_type(void **state)
{
	struct cia309_command c = parsed("[1] 4 read 0x1017 0 u16", CIA309_OK);

	(void)state;
	assert_int_equal(c.verb, CIA309_READ);
	assert_int_equal(c.sequence, 1);
	assert_int_equal(c.net, CIA309_ABSENT);
	assert_int_equal(c.node, 4);
	assert_int_equal(c.index, 0x1017);
	assert_int_equal(c.sub, 0);
	assert_ptr_equal(c.type, cia309_type("u16"));
	c = parsed("[4294967295] 1 127 R 8192 255\r", CIA309_OK);
	assert_int_equal(c.sequence, UINT32_MAX);
	assert_int_equal(c.net, 1);
	assert_int_equal(c.node, 127);
	assert_int_equal(c.index, 0x2000);
	assert_int_equal(c.sub, 255);
	assert_ptr_equal(c.type, &CIA309_TYPE_HEX);
	c = parsed("[0] r 0x1018 1 # who made it", CIA309_OK);
	assert_int_equal(c.node, CIA309_ABSENT);
}

static void test_write_has_the_rest_of_the_line_as_its_value(void **state)
{
	struct cia309_command c = parsed("[7] 3 w 0x2000 1 r32 0.05 # m\r", CIA309_OK);

	(void)state;
	assert_int_equal(c.verb, CIA309_WRITE);
	assert_int_equal(c.value_length, strlen("0.05 # m\r"));
	assert_memory_equal(c.value, "0.05 # m\r", c.value_length);
}

static void test_each_command_is_known_in_any_case(void **state)
{
	static const struct {
		const char *line;
		enum cia309_verb verb;
		unsigned count;
		uint64_t first;
	} LINES[] = {
		{"", CIA309_NOTHING, 0, 0},
		{" \t\r", CIA309_NOTHING, 0, 0},
		{"# comment [1] start", CIA309_NOTHING, 0, 0},
		{"[1] 5 start", CIA309_START, 0, 0},
		{"[1] 5 STOP", CIA309_STOP, 0, 0},
		{"[1] 0 preop", CIA309_PREOP, 0, 0},
		{"[1] preoperational", CIA309_PREOP, 0, 0},
		{"[1] 1 5 reset node", CIA309_RESET_NODE, 0, 0},
		{"[1] 5 reset comm", CIA309_RESET_COMM, 0, 0},
		{"[1] 5 reset Communication#now", CIA309_RESET_COMM, 0, 0},
		{"[1] set network 1", CIA309_SET_NETWORK, 1, 1},
		{"[1] set node 0x7F", CIA309_SET_NODE, 1, 127},
		{"[1] 1 set node 4", CIA309_SET_NODE, 1, 4},
		{"[1] set sdo_timeout 65535", CIA309_SET_SDO_TIMEOUT, 1, 65535},
		{"[1] set sdo_block 1", CIA309_SET_SDO_BLOCK, 1, 1},
		{"[1] lss_switch_glob 1", CIA309_LSS_SWITCH_GLOBAL, 1, 1},
		{"[1] lss_switch_sel 0x494D55 2 3 0xFFFFFFFF", CIA309_LSS_SWITCH_SELECTIVE, 4, 0x494D55},
		{"[1] lss_set_node 255", CIA309_LSS_SET_NODE, 1, 255},
		{"[1] lss_conf_bitrate 0 3", CIA309_LSS_CONFIGURE_BIT_RATE, 2, 0},
		{"[1] lss_activate_bitrate 100", CIA309_LSS_ACTIVATE_BIT_RATE, 1, 100},
		{"[1] lss_store", CIA309_LSS_STORE_CONFIGURATION, 0, 0},
		{"[1] lss_inquire_addr", CIA309_LSS_INQUIRE, 0, 0},
		{"[1] lss_inquire_addr 3", CIA309_LSS_INQUIRE, 1, 3},
		{"[1] lss_get_node", CIA309_LSS_GET_NODE, 0, 0},
		{"[1] _lss_fastscan", CIA309_LSS_FASTSCAN, 0, 0},
		{"[1] _lss_fastscan 25", CIA309_LSS_FASTSCAN, 1, 25},
		{"[1] lss_allnodes", CIA309_LSS_ALL_NODES, 0, 0},
		{"[1] lss_allnodes 100", CIA309_LSS_ALL_NODES, 1, 100},
		{"[1] lss_allnodes 100 5 1", CIA309_LSS_ALL_NODES, 3, 100},
		{"[1] lss_allnodes 100 5 1 2 0x494D55 0 0 1 0 2 7", CIA309_LSS_ALL_NODES, 11, 100},
		{"[1] r p 1", CIA309_READ_PDO, 1, 1},
		{"[1] 5 read pdo 2", CIA309_READ_PDO, 1, 2},
		{"[1] w p 1 2 0x10 20", CIA309_WRITE_PDO, 4, 1},
		{"[1] info version", CIA309_VERSION, 0, 0},
		{"[1] help", CIA309_HELP, 0, 0},
		{"[1] help datatype", CIA309_HELP_TYPES, 0, 0},
		{"[1] help lss", CIA309_HELP_LSS, 0, 0},
		{"[1] log", CIA309_LOG, 0, 0},
	};

	(void)state;
	for (size_t i = 0; i < sizeof(LINES) / sizeof(LINES[0]); i++) {
		struct cia309_command c = parsed(LINES[i].line, CIA309_OK);

		assert_int_equal(c.verb, LINES[i].verb);
		assert_int_equal(c.count, LINES[i].count);
		assert_int_equal(c.numbers[0], LINES[i].first);
	}
}

/* The codes are those of CiA 309-3, as canopend answers these lines. */
static void test_each_wrong_line_has_its_error(void **state)
{
	static const struct {
		const char *line;
		int error;
	} LINES[] = {
		{"read 0x1017 0 u16", 101}, /* no sequence */
		{"[", 101},
		{"[]", 101},
		{"[1", 101},
		{"[-1] start", 101},
		{"[x] start", 101},
		{"[4294967296] start", 101},
		{"[1]", 101},
		{"[1] 5", 101},
		{"[1] 1 2 3 start", 101},
		{"[1] 128 start", 107},
		{"[1] 2 5 start", 106},
		{"[1] 2 set node 4", 106},
		{"[1] begin", 100},
		{"[1] set speed 3", 100},
		{"[1] set", 101},
		{"[1] set node", 101},
		{"[1] set node 0", 101},
		{"[1] set node 128", 101},
		{"[1] set node 4 5", 101},
		{"[1] set sdo_block 2", 101},
		{"[1] 5 start now", 101},
		{"[1] 5 reset", 101},
		{"[1] 5 reset all", 101},
		{"[1] 5 read", 101},
		{"[1] 5 read 0x1017", 101},
		{"[1] 5 read 0x10000 0", 101},
		{"[1] 5 read 0x1017 256", 101},
		{"[1] 5 read 0x1017 0 u17", 101},
		{"[1] 5 read 0x1017 0 u16 1", 101},
		{"[1] 5 write 0x1017 0", 101},
		{"[1] 5 write 0x1017 0 u16", 101},
		{"[1] 5 write 0x1017 0 u16 # none", 101},
		{"[1] lss_switch_glob 2", 101},
		{"[1] lss_switch_sel 1 2 3", 101},
		{"[1] lss_switch_sel 1 2 3 4 5", 101},
		{"[1] lss_set_node 128", 101},
		{"[1] lss_conf_bitrate 1 0", 101},
		{"[1] lss_conf_bitrate 0 5", 101},
		{"[1] lss_conf_bitrate 0 10", 101},
		{"[1] lss_inquire_addr 4", 101},
		{"[1] lss_allnodes 100 5", 101},
		{"[1] lss_allnodes 100 0 1", 101},
		{"[1] lss_allnodes 100 5 1 3 0 0 0 0 0 0 0", 101},
		{"[1] r p 0", 101},
		{"[1] r p", 101},
		{"[1] w p 1", 101},
		{"[1] w p 1 2 3", 101},
		{"[1] w p 1 9 1 2 3 4 5 6 7 8 9", 101},
		{"[1] help me", 101},
		{"[1] an_unreasonably_long_word_that_no_command_has", 101},
	};

	(void)state;
	for (size_t i = 0; i < sizeof(LINES) / sizeof(LINES[0]); i++)
		assert_int_equal(parsed(LINES[i].line, (enum cia309_error)LINES[i].error).sequence,
			strstr(LINES[i].line, "[1] ") || strcmp(LINES[i].line, "[1]") == 0);
}

/* Of each number of a command: the lowest, the highest, and one beyond each. */
static void test_each_number_of_a_command_has_its_limits(void **state)
{
	static const struct {
		const char *before, *behind;
		uint64_t low, high;
	} NUMBERS[] = {
		{"", "start", 0, 127},
		{"1 ", "start", 0, 127},
		{"", "r 1 1", 0, 127},
		{"", "info version", 0, 1},
		{"", "5 start", 0, 1},
		{"r ", "0", 0, 65535},
		{"r 1 ", "u8", 0, 255},
		{"w ", "0 u8 1", 0, 65535},
		{"w 1 ", "u8 1", 0, 255},
		{"r p ", "", 1, 512},
		{"w p ", "0", 1, 512},
		{"w p 1 1 ", "", 0, UINT64_MAX},
		{"set network ", "", 0, 65535},
		{"set node ", "", 1, 127},
		{"set sdo_timeout ", "", 1, 65535},
		{"set sdo_block ", "", 0, 1},
		{"lss_switch_glob ", "", 0, 1},
		{"lss_switch_sel ", "1 1 1", 0, UINT32_MAX},
		{"lss_switch_sel 1 ", "1 1", 0, UINT32_MAX},
		{"lss_switch_sel 1 1 ", "1", 0, UINT32_MAX},
		{"lss_switch_sel 1 1 1 ", "", 0, UINT32_MAX},
		{"lss_set_node ", "", 0, 127},
		{"lss_set_node ", "", 255, 255},
		{"lss_conf_bitrate ", "1", 0, 0},
		{"lss_conf_bitrate 0 ", "", 0, 4},
		{"lss_conf_bitrate 0 ", "", 6, 9},
		{"lss_activate_bitrate ", "", 0, 65535},
		{"lss_inquire_addr ", "", 0, 3},
		{"_lss_fastscan ", "", 0, 65535},
		{"lss_allnodes ", "", 0, 65535},
		{"lss_allnodes ", "1 1", 0, 65535},
		{"lss_allnodes 0 ", "1", 1, 127},
		{"lss_allnodes 0 1 ", "", 0, 1},
		{"lss_allnodes 0 1 1 ", "0 0 0 0 0 0 0", 0, 2},
		{"lss_allnodes 0 1 1 0 ", "0 0 0 0 0 0", 0, UINT32_MAX},
		{"lss_allnodes 0 1 1 0 0 ", "0 0 0 0 0", 0, 2},
		{"lss_allnodes 0 1 1 0 0 0 ", "0 0 0 0", 0, UINT32_MAX},
		{"lss_allnodes 0 1 1 0 0 0 0 ", "0 0 0", 0, 2},
		{"lss_allnodes 0 1 1 0 0 0 0 0 ", "0 0", 0, UINT32_MAX},
		{"lss_allnodes 0 1 1 0 0 0 0 0 0 ", "0", 0, 2},
		{"lss_allnodes 0 1 1 0 0 0 0 0 0 0 ", "", 0, UINT32_MAX},
	};
	struct cia309_command c;
	char line[100];

	(void)state;
	for (size_t i = 0; i < sizeof(NUMBERS) / sizeof(NUMBERS[0]); i++) {
		const uint64_t low = NUMBERS[i].low, high = NUMBERS[i].high, values[] = {low, high, low - 1, high + 1};

		for (int k = 0; k < 4; k++) {
			if ((k == 2 && low == 0) || (k == 3 && high == UINT64_MAX))
				continue;
			snprintf(line, sizeof(line), "[1] %s%llu %s", NUMBERS[i].before, (unsigned long long)values[k],
				NUMBERS[i].behind);
			if ((cia309_parse(line, strlen(line), &c) == CIA309_OK) != (k < 2))
				fail_msg("%s", line);
		}
	}
}

static void test_numbers_are_kept_in_their_order(void **state)
{
	struct cia309_command c = parsed("[1] lss_allnodes 1 2 0 0 0x494D55 1 6 2 7 0 8", CIA309_OK);
	static const uint64_t LSS[] = {1, 2, 0, 0, 0x494D55, 1, 6, 2, 7, 0, 8};

	(void)state;
	assert_memory_equal(c.numbers, LSS, sizeof(LSS));
	c = parsed("[1] w pdo 512 8 1 2 3 4 5 6 7 18446744073709551615", CIA309_OK);
	static const uint64_t PDO[] = {512, 8, 1, 2, 3, 4, 5, 6, 7, UINT64_MAX};
	assert_int_equal(c.count, 10);
	assert_memory_equal(c.numbers, PDO, sizeof(PDO));
	assert_int_equal(parsed("[1] W P 1 0", CIA309_OK).count, 2);
	parsed("[1] w p 1 8 1 2 3 4 5 6 7 8 9", CIA309_SYNTAX);
	parsed("[1] w p 1 1 18446744073709551616", CIA309_SYNTAX);
	parsed("[1] r p 1 1", CIA309_SYNTAX);
	parsed("[1] lss_allnodes 1 2 0 0 0 0 0 0 0 0 0 0", CIA309_SYNTAX);
	for (int n = 4; n <= 10; n++) {
		char line[64] = "[1] lss_allnodes";

		for (int i = 0; i < n; i++)
			strcat(line, " 1");
		parsed(line, CIA309_SYNTAX);
	}
}

static void test_net_and_node_before_a_command_are_told_apart(void **state)
{
	static const struct {
		const char *line;
		int net, node;
	} LINES[] = {{"[1] start", -1, -1}, {"[1] 7 start", -1, 7}, {"[1] 0 7 start", 0, 7}, {"[1] 1 0 start", 1, 0},
		{"[1] info version", -1, -1}, {"[1] 1 info version", 1, -1}, {"[1] 0 set node 7", 0, -1}};

	(void)state;
	for (size_t i = 0; i < sizeof(LINES) / sizeof(LINES[0]); i++) {
		struct cia309_command c = parsed(LINES[i].line, CIA309_OK);

		assert_int_equal(c.net, LINES[i].net);
		assert_int_equal(c.node, LINES[i].node);
	}
	parsed("[1] 1 1 info version", CIA309_SYNTAX);
	parsed("[1] 4294967296 start", CIA309_SYNTAX);
	parsed("[1] 2 info version", CIA309_BAD_NET);
	parsed("[1] 1x start", CIA309_SYNTAX);
}

/* 23 characters are a word of the language; of a longer one no part is taken for one. */
static void test_words_are_whole_up_to_a_blank_or_a_comment(void **state)
{
	(void)state;
	parsed("[1] set node 0x00000000000000000007f", CIA309_OK);
	parsed("[1] set node 0x000000000000000000007f", CIA309_SYNTAX);
	parsed("aaaaaaaaaaaaaaaaaaaaaaastart", CIA309_SYNTAX);
	parsed("[1] aaaaaaaaaaaaaaaaaaaaaaastart", CIA309_SYNTAX);
	parsed("[1] 5 start#comment", CIA309_OK);
	parsed("[1] 5 r 0x1017 0#comment", CIA309_OK);
	parsed("[1] 5 r 0x1017 0 u16#comment", CIA309_OK);
	parsed("[1]\t5\vstart\f\r", CIA309_OK);
	parsed("[1]#start", CIA309_SYNTAX);
	parsed("[1]start", CIA309_SYNTAX);
	parsed("(1] start", CIA309_SYNTAX);
	parsed("[1) start", CIA309_SYNTAX);
	assert_int_equal(cia309_parse("[1] 5 startx", 11, &(struct cia309_command){0}), CIA309_OK);
}

static void test_each_error_has_its_text(void **state)
{
	static const struct {
		int error;
		const char *text;
	} TEXTS[] = {{0, "-"}, {100, "Request not supported."}, {101, "Syntax error."},
		{102, "Request not processed due to internal state."}, {103, "Time-out."}, {104, "-"},
		{105, "No default node set."}, {106, "Unsupported net."}, {107, "Unsupported node."},
		{204, "Wrong NMT state."}, {301, "Bus off."}, {303, "CAN buffer overflow."},
		{401, "PDO length exceeded."}, {501, "LSS implementation- / manufacturer-specific error."},
		{502, "LSS node-ID not supported."}, {503, "LSS bit-rate not supported."},
		{504, "LSS parameter storing failed."}, {600, "Running out of memory."}};

	(void)state;
	for (size_t i = 0; i < sizeof(TEXTS) / sizeof(TEXTS[0]); i++)
		assert_string_equal(cia309_error_text((enum cia309_error)TEXTS[i].error), TEXTS[i].text);
}

/* Whatever room there is from the smallest on, no value is cut, and none needs more. */
static void test_a_value_is_printed_the_same_whatever_the_room(void **state)
{
	static const char *const TYPES[] = {"vs", "d", "hex", "r64", "x64", "t"};
	static uint8_t bytes[300];
	static char whole[1300], text[1300];

	(void)state;
	for (size_t i = 0; i < sizeof(bytes); i++)
		bytes[i] = i % 3 ? '"' : (uint8_t)('A' + i % 26);
	for (size_t i = 0; i < sizeof(TYPES) / sizeof(TYPES[0]); i++)
		for (size_t room = CIA309_PRINT_MIN; room < CIA309_PRINT_MIN + 9; room++) {
			const struct cia309_type *type = cia309_type(TYPES[i]);
			size_t size = type->size ? type->size : sizeof(bytes), n = 0;
			struct cia309_printer all = {.type = type, .bytes = bytes, .size = size};
			struct cia309_printer p = {.type = type, .bytes = bytes, .size = size};
			size_t expected = cia309_print(&all, whole, sizeof(whole));

			assert_true(cia309_printed(&all));
			for (int pieces = 0; !cia309_printed(&p); pieces++) {
				size_t piece = cia309_print(&p, text + n, room);

				assert_in_range(piece, 1, room);
				assert_true(pieces < 40);
				n += piece;
			}
			assert_int_equal(cia309_print(&p, text, room), 0);
			assert_int_equal(n, expected);
			assert_memory_equal(text, whole, n);
		}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_each_value_has_its_bytes_and_its_text),
		cmocka_unit_test(test_what_is_no_value_of_its_type_is_refused),
		cmocka_unit_test(test_a_value_longer_than_its_buffer_is_told_apart),
		cmocka_unit_test(test_bytes_of_another_size_than_their_type_are_printed_in_hex),
		cmocka_unit_test(test_no_string_contains_the_end_of_an_answer),
		cmocka_unit_test(test_a_long_value_is_printed_in_pieces_and_read_again),
		cmocka_unit_test(test_read_names_node_object_and_type),
		cmocka_unit_test(test_write_has_the_rest_of_the_line_as_its_value),
		cmocka_unit_test(test_each_command_is_known_in_any_case),
		cmocka_unit_test(test_each_wrong_line_has_its_error),
		cmocka_unit_test(test_each_number_of_a_command_has_its_limits),
		cmocka_unit_test(test_numbers_are_kept_in_their_order),
		cmocka_unit_test(test_net_and_node_before_a_command_are_told_apart),
		cmocka_unit_test(test_words_are_whole_up_to_a_blank_or_a_comment),
		cmocka_unit_test(test_each_error_has_its_text),
		cmocka_unit_test(test_a_value_is_printed_the_same_whatever_the_room),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
