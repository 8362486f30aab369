/* The lines of slcan, written out from the protocol of Lawicel's CAN232 (drivers/can/slcan_codec.h). */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <stdio.h>
#include <string.h>

#include "drivers/can/slcan_codec.h"

/* What the last byte of the text makes of it; all others make nothing. */
static enum slcan_kind read_line(struct slcan_reader *r, const char *text)
{
	size_t n = strlen(text);

	for (size_t i = 0; i + 1 < n; i++)
		assert_int_equal(slcan_read(r, text[i]), SLCAN_NOTHING);
	return slcan_read(r, text[n - 1]);
}

static const struct line {
	const char *text;
	struct can_msg msg;
} FRAMES[] = {
	{"t0000\r", {.id = 0}},
	{"t7FF81122334455667788\r", {.id = 0x7FF, .len = 8, .data = {0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88}}},
	{"t18129AF0\r", {.id = 0x181, .len = 2, .data = {0x9A, 0xF0}}},
	{"T1FFFFFFF1AB\r", {.id = 0x1FFFFFFF, .extended = true, .len = 1, .data = {0xAB}}},
	{"T123456780\r", {.id = 0x12345678, .extended = true}},
	{"r7018\r", {.id = 0x701, .remote = true, .len = 8}},
	{"R0ABCDEF13\r", {.id = 0x0ABCDEF1, .extended = true, .remote = true, .len = 3}},
};

static void assert_frame(const struct line *line, const char *text)
{
	struct slcan_reader r = {.length = 0};

	assert_int_equal(read_line(&r, text), SLCAN_FRAME);
	assert_int_equal(r.msg.id, line->msg.id);
	assert_int_equal(r.msg.extended, line->msg.extended);
	assert_int_equal(r.msg.remote, line->msg.remote);
	assert_int_equal(r.msg.len, line->msg.len);
	assert_memory_equal(r.msg.data, line->msg.data, 8);
}

static void test_every_kind_of_frame_has_its_line(void **state)
{
	(void)state;
	for (size_t i = 0; i < sizeof FRAMES / sizeof *FRAMES; i++) {
		char out[SLCAN_LINE_MAX];
		size_t n = slcan_encode(&FRAMES[i].msg, out);

		assert_int_equal(n, strlen(FRAMES[i].text));
		assert_memory_equal(out, FRAMES[i].text, n);
	}
}

/* In digits of either case, with a time stamp of four digits or none. */
static void test_every_line_is_its_frame(void **state)
{
	(void)state;
	for (size_t i = 0; i < sizeof FRAMES / sizeof *FRAMES; i++) {
		const char *text = FRAMES[i].text;
		char other[64];

		assert_frame(&FRAMES[i], text);
		snprintf(other, sizeof other, "%.*s12aB\r", (int)strlen(text) - 1, text);
		assert_frame(&FRAMES[i], other);
		for (size_t k = 1; (other[k] = text[k]); k++)
			if (other[k] >= 'A' && other[k] <= 'F')
				other[k] = (char)(other[k] + 'a' - 'A');
		assert_frame(&FRAMES[i], other);
	}
}

static void test_each_line_of_an_adapter_is_of_its_kind(void **state)
{
	static const struct {
		const char *text;
		enum slcan_kind kind;
	} lines[] = {
		{"\r", SLCAN_OK},
		{"\a", SLCAN_REFUSED},
		{"z\r", SLCAN_SENT},
		{"Z\r", SLCAN_SENT},
		{"F00\r", SLCAN_STATUS},
		{"V1013\r", SLCAN_OTHER},
		{"v0107\r", SLCAN_OTHER},
		{"NA123\r", SLCAN_OTHER},
		/* too long, too short, or none */
		{"zz\r", SLCAN_BAD},
		{"Z0\r", SLCAN_BAD},
		{"F0\r", SLCAN_BAD},
		{"F000\r", SLCAN_BAD},
		{"F0G\r", SLCAN_BAD},
		{"F\r", SLCAN_BAD},
		{"x\r", SLCAN_BAD},
		{"z\a", SLCAN_BAD},
		{"t\r", SLCAN_BAD},
		{"t181\r", SLCAN_BAD},
		{"t18\r", SLCAN_BAD},
		{"t1811\r", SLCAN_BAD},
		{"t18111\r", SLCAN_BAD},
		{"t18111G\r", SLCAN_BAD},
		{"t181G\r", SLCAN_BAD},
		{"t18X0\r", SLCAN_BAD},
		{"t8000\r", SLCAN_BAD},
		{"T200000000\r", SLCAN_BAD},
		{"t1819112233445566778899\r", SLCAN_BAD},
		{"t1810123\r", SLCAN_BAD},
		{"t181012345\r", SLCAN_BAD},
		{"r1812AABB0\r", SLCAN_BAD},
		{"T1FFFFFFF\r", SLCAN_BAD},
		{"t00001234567890123456789012345678901234567890\r", SLCAN_BAD},
	};

	(void)state;
	for (size_t i = 0; i < sizeof lines / sizeof *lines; i++) {
		struct slcan_reader r = {.length = 0};
		enum slcan_kind kind = read_line(&r, lines[i].text);

		if (kind != lines[i].kind)
			fail_msg("'%s' is of kind %d, not %d", lines[i].text, kind, lines[i].kind);
		/* and the next one begins afresh */
		assert_int_equal(read_line(&r, "F2a\r"), SLCAN_STATUS);
		assert_int_equal(r.flags, 0x2A);
		assert_int_equal(read_line(&r, "\r"), SLCAN_OK);
	}
}

/* The longest line is a frame of 8 bytes with an extended identifier and a time stamp. */
static void test_a_line_of_31_characters_is_read_and_one_of_33_is_bad(void **state)
{
	struct slcan_reader r = {.length = 0};

	(void)state;
	assert_int_equal(read_line(&r, "T1FFFFFFF811223344556677881234\r"), SLCAN_FRAME);
	assert_int_equal(read_line(&r, "V1234567890123456789012345678901\r"), SLCAN_OTHER); /* 32 */
	assert_int_equal(read_line(&r, "V12345678901234567890123456789012\r"), SLCAN_BAD);
	assert_int_equal(read_line(&r, "z\r"), SLCAN_SENT);
}

static void test_lf_ends_a_line_that_is_not_empty(void **state)
{
	struct slcan_reader r = {.length = 0};

	(void)state;
	assert_int_equal(slcan_read(&r, '\n'), SLCAN_NOTHING);
	assert_int_equal(read_line(&r, "z\n"), SLCAN_SENT);
	assert_int_equal(slcan_read(&r, '\n'), SLCAN_NOTHING);
}

static void test_each_bit_rate_has_its_digit(void **state)
{
	static const uint32_t rates[] = {10000, 20000, 50000, 100000, 125000, 250000, 500000, 800000, 1000000};

	(void)state;
	for (int i = 0; i < 9; i++) {
		assert_int_equal(slcan_bit_rate_code(rates[i]), '0' + i);
		assert_int_equal(slcan_bit_rate_code(rates[i] + 1), '\0');
	}
	assert_int_equal(slcan_bit_rate_code(0), '\0');
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_every_kind_of_frame_has_its_line),
		cmocka_unit_test(test_every_line_is_its_frame),
		cmocka_unit_test(test_each_line_of_an_adapter_is_of_its_kind),
		cmocka_unit_test(test_a_line_of_31_characters_is_read_and_one_of_33_is_bad),
		cmocka_unit_test(test_lf_ends_a_line_that_is_not_empty),
		cmocka_unit_test(test_each_bit_rate_has_its_digit),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
