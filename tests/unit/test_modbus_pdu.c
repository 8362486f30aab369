/* Requests and responses of Modbus. Oracle: the examples and limits of the MODBUS Application Protocol Specification
 * V1.1b3, and for function 43/13 those that a manufacturer of gateways publishes (read 1005h, abort 06020000h). */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <stdlib.h>
#include <string.h>

#include "gateway/canopen/sdo_abort.h"
#include "gateway/modbus/exception.h"
#include "gateway/modbus/pdu.h"

/* A device whose registers are memory: 0 to BANK - 1. Counts what reaches it. */
enum { BANK = 256, BITS = 2048 };

static struct bank {
	struct modbus_registers registers;
	uint16_t words[BANK];
	uint8_t coils[BITS], inputs[BITS];
	const char *identification[256];
	uint8_t object[300];
	size_t object_size;
	enum od_status answer; /* of writes */
	unsigned reads, writes;
} bank;

static enum od_status bank_read(void *ctx, uint16_t address, unsigned count, uint8_t *out)
{
	struct bank *b = ctx;

	b->reads++;
	if (address + count > BANK)
		return OD_NO_OBJECT;
	for (unsigned i = 0; i < count; i++) {
		out[2 * i] = (uint8_t)(b->words[address + i] >> 8);
		out[2 * i + 1] = (uint8_t)b->words[address + i];
	}
	return OD_OK;
}

static enum od_status bank_write(void *ctx, uint16_t address, unsigned count, const uint8_t *in)
{
	struct bank *b = ctx;

	b->writes++;
	if (b->answer)
		return b->answer;
	if (address + count > BANK)
		return OD_NO_OBJECT;
	for (unsigned i = 0; i < count; i++)
		b->words[address + i] = (uint16_t)(in[2 * i] << 8 | in[2 * i + 1]);
	return OD_OK;
}

static enum od_status bank_mask(void *ctx, uint16_t address, uint16_t and_mask, uint16_t or_mask)
{
	struct bank *b = ctx;

	b->words[address] = (uint16_t)((b->words[address] & and_mask) | (or_mask & ~and_mask));
	return OD_OK;
}

static enum od_status bank_read_bits(void *ctx, enum modbus_bits kind, uint16_t address, unsigned count, uint8_t *out)
{
	struct bank *b = ctx;

	b->reads++;
	if (address + count > BITS)
		return OD_NO_OBJECT;
	for (unsigned i = 0; i < count; i++)
		out[i / 8] |= (uint8_t)((kind == MODBUS_COILS ? b->coils : b->inputs)[address + i] << i % 8);
	return OD_OK;
}

static enum od_status bank_write_coils(void *ctx, uint16_t address, unsigned count, const uint8_t *in)
{
	struct bank *b = ctx;

	b->writes++;
	for (unsigned i = 0; i < count; i++)
		b->coils[address + i] = in[i / 8] >> i % 8 & 1;
	return b->answer;
}

static const char *bank_identification(void *ctx, uint8_t number)
{
	return ((struct bank *)ctx)->identification[number];
}

static enum od_status bank_read_object(
	void *ctx, uint16_t index, uint8_t sub, size_t offset, uint8_t *out, size_t *size)
{
	struct bank *b = ctx;

	if (index != 0x1005 || sub != 0)
		return OD_NO_OBJECT;
	size_t left = b->object_size > offset ? b->object_size - offset : 0;
	*size = *size < left ? *size : left;
	memcpy(out, b->object + offset, *size);
	return OD_OK;
}

static enum od_status bank_write_object(void *ctx, uint16_t index, uint8_t sub, const uint8_t *in, size_t size)
{
	struct bank *b = ctx;

	b->writes++;
	if (b->answer)
		return b->answer;
	if (index != 0x203C || sub != 2)
		return OD_READ_ONLY;
	memcpy(b->object, in, size);
	b->object_size = size;
	return OD_OK;
}

static int set_up(void **state)
{
	(void)state;
	bank = (struct bank){.registers = {.ctx = &bank,
				     .node_id = 0x1F,
				     .read = bank_read,
				     .write = bank_write,
				     .mask = bank_mask,
				     .read_bits = bank_read_bits,
				     .write_coils = bank_write_coils,
				     .identification = bank_identification,
				     .read_object = bank_read_object,
				     .write_object = bank_write_object,
				     .abort_code = sdo_abort_code}};
	return 0;
}

static size_t from_hex(const char *hex, uint8_t *out)
{
	size_t n = 0;
	char *end;

	for (; *hex; hex = end, n++) {
		out[n] = (uint8_t)strtoul(hex, &end, 16);
		assert_ptr_not_equal(end, hex);
		end += strspn(end, " ");
	}
	return n;
}

/* The response to a request, both in hex. */
static void assert_answers(const char *request, const char *response)
{
	uint8_t in[MODBUS_PDU_MAX + 3], expected[MODBUS_PDU_MAX], *out = malloc(MODBUS_PDU_MAX);
	memset(out, 0xA5, MODBUS_PDU_MAX);
	size_t size = modbus_pdu(&bank.registers, in, from_hex(request, in), out);

	assert_int_equal(size, from_hex(response, expected));
	assert_memory_equal(out, expected, size);
	free(out);
}

/* Bit `first` of the specification's examples is the least significant one of the first byte. */
static void set_bits(uint8_t *bits, unsigned first, unsigned count, const uint8_t *packed)
{
	for (unsigned i = 0; i < count; i++)
		bits[first + i] = packed[i / 8] >> i % 8 & 1;
}

static void test_coils_are_read_as_in_the_specification(void **state)
{
	(void)state;
	set_bits(bank.coils, 0x13, 19, (const uint8_t[]){0xCD, 0x6B, 0x05});
	assert_answers("01 00 13 00 13", "01 03 CD 6B 05");
}

static void test_discrete_inputs_are_read_as_in_the_specification(void **state)
{
	(void)state;
	set_bits(bank.inputs, 0xC4, 22, (const uint8_t[]){0xAC, 0xDB, 0x35});
	assert_answers("02 00 C4 00 16", "02 03 AC DB 35");
}

static void test_registers_are_read_as_in_the_specification(void **state)
{
	(void)state;
	bank.words[0x6B] = 0x022B;
	bank.words[0x6D] = 0x0064;
	bank.words[8] = 0x000A;
	assert_answers("03 00 6B 00 03", "03 06 02 2B 00 00 00 64");
	assert_answers("04 00 08 00 01", "04 02 00 0A");
}

static void test_single_writes_are_repeated(void **state)
{
	(void)state;
	assert_answers("05 00 AC FF 00", "05 00 AC FF 00");
	assert_int_equal(bank.coils[0xAC], 1);
	assert_answers("05 00 AC 00 00", "05 00 AC 00 00");
	assert_int_equal(bank.coils[0xAC], 0);
	assert_answers("06 00 01 00 03", "06 00 01 00 03");
	assert_int_equal(bank.words[1], 3);
}

static void test_multiple_writes_answer_address_and_quantity(void **state)
{
	(void)state;
	assert_answers("0F 00 13 00 0A 02 CD 01", "0F 00 13 00 0A");
	const uint8_t coils[10] = {1, 0, 1, 1, 0, 0, 1, 1, 1, 0};
	assert_memory_equal(bank.coils + 0x13, coils, 10);
	assert_answers("10 00 01 00 02 04 00 0A 01 02", "10 00 01 00 02");
	assert_int_equal(bank.words[1], 0x000A);
	assert_int_equal(bank.words[2], 0x0102);
}

static void test_a_mask_write_changes_bits(void **state)
{
	(void)state;
	bank.words[4] = 0x12;
	assert_answers("16 00 04 00 F2 00 25", "16 00 04 00 F2 00 25");
	assert_int_equal(bank.words[4], 0x17);
}

static void test_function_23_writes_before_it_reads(void **state)
{
	(void)state;
	memcpy(bank.words + 3, (uint16_t[]){0x00FE, 0x0ACD, 0x0001, 0x0003, 0x000D, 0x00FF}, 12);
	assert_answers("17 00 03 00 06 00 0E 00 03 06 00 FF 00 FF 00 FF", "17 0C 00 FE 0A CD 00 01 00 03 00 0D 00 FF");
	assert_int_equal(bank.words[0x10], 0x00FF);
	assert_answers("17 00 01 00 01 00 01 00 01 02 12 34", "17 02 12 34");
}

static void test_function_23_writes_nothing_when_its_range_cannot_be_read(void **state)
{
	(void)state;
	assert_answers("17 01 00 00 01 00 01 00 01 02 12 34", "97 02");
	assert_int_equal(bank.writes, 0);
}

static void test_an_address_that_is_not_there_is_exception_2(void **state)
{
	(void)state;
	assert_answers("01 08 A1 00 01", "81 02");
	assert_answers("02 08 00 00 01", "82 02");
	assert_answers("03 00 FF 00 02", "83 02");
	assert_answers("04 FF FF 00 01", "84 02");
	assert_answers("04 FF FF 00 02", "84 02");
	assert_answers("06 01 00 00 00", "86 02");
	assert_answers("10 FF FF 00 02 04 00 00 00 00", "90 02");
	assert_answers("0F FF FF 00 02 01 00", "8F 02");
	assert_answers("17 00 00 00 01 FF FF 00 02 04 00 00 00 00", "97 02");
}

/* FFFFh is an address, 10000h is none: such a range does not reach the device. */
static void test_a_range_ends_at_the_last_address(void **state)
{
	static const struct {
		const char *request;
		unsigned reads, writes;
	} RANGES[] = {{"01 FF FF 00 01", 1, 0}, {"01 FF FF 00 02", 0, 0}, {"02 FF 00 01 00", 1, 0},
		{"02 FF 01 01 00", 0, 0}, {"03 FF FF 00 01", 1, 0}, {"03 FF FF 00 02", 0, 0}, {"04 FF F0 00 10", 1, 0},
		{"04 FF F0 00 11", 0, 0}, {"10 FF FF 00 01 02 00 00", 0, 1}, {"10 FF FF 00 02 04 00 00 00 00", 0, 0},
		{"0F FF FF 00 02 01 00", 0, 0}, {"17 FF FF 00 01 00 00 00 01 02 00 00", 1, 0},
		{"17 FF FF 00 02 00 00 00 01 02 00 00", 0, 0}, {"17 00 00 00 01 FF FF 00 01 02 00 00", 1, 1},
		{"17 00 00 00 01 FF FF 00 02 04 00 00 00 00", 0, 0}};
	uint8_t request[MODBUS_PDU_MAX], response[MODBUS_PDU_MAX];

	(void)state;
	for (size_t i = 0; i < sizeof(RANGES) / sizeof(*RANGES); i++) {
		bank.reads = bank.writes = 0;
		assert_int_equal(
			modbus_pdu(&bank.registers, request, from_hex(RANGES[i].request, request), response), 2);
		assert_int_equal(response[1], 2);
		assert_int_equal(bank.reads, RANGES[i].reads);
		assert_int_equal(bank.writes, RANGES[i].writes);
	}
}

static void test_bits_fill_as_many_bytes_as_they_need(void **state)
{
	(void)state;
	memset(bank.coils, 1, 20);
	assert_answers("01 00 00 00 01", "01 01 01");
	assert_answers("01 00 00 00 08", "01 01 FF");
	assert_answers("01 00 00 00 09", "01 02 FF 01");
	assert_answers("01 00 0A 00 10", "01 02 FF 03");
	assert_answers("0F 00 20 00 08 01 81", "0F 00 20 00 08");
	assert_int_equal(bank.coils[0x20] + bank.coils[0x27], 2);
	assert_answers("0F 00 20 00 09 02 00 01", "0F 00 20 00 09");
	assert_int_equal(bank.coils[0x28], 1);
	assert_answers("0F 00 20 00 08 02 00 01", "8F 03");
	assert_answers("0F 00 20 00 09 01 00", "8F 03");
}

static void test_a_quantity_out_of_range_is_exception_3(void **state)
{
	(void)state;
	assert_answers("01 00 00 00 00", "81 03");
	assert_answers("01 00 00 07 D1", "81 03");
	assert_answers("02 00 00 00 00", "82 03");
	assert_answers("03 00 00 00 00", "83 03");
	assert_answers("03 00 00 00 7E", "83 03");
	assert_answers("04 00 00 00 7E", "84 03");
	assert_answers("0F 00 00 00 00 00", "8F 03");
	assert_answers("10 00 00 00 00 00", "90 03");
	assert_answers("10 00 00 00 02 02 00 00", "90 03");
	assert_answers("10 00 00 00 01 02 00", "90 03");
	assert_answers("05 00 00 12 34", "85 03");
	assert_answers("17 00 00 00 7E 00 00 00 01 02 00 00", "97 03");
	assert_answers("17 00 00 00 01 00 00 00 00 00", "97 03");
	assert_int_equal(bank.writes, 0);
}

/* The quantity is refused before the address is looked at. */
static void test_the_largest_quantities_are_served(void **state)
{
	uint8_t request[MODBUS_PDU_MAX + 1] = {3, 0, 0, 0, 125}, response[MODBUS_PDU_MAX];

	(void)state;
	assert_int_equal(modbus_pdu(&bank.registers, request, 5, response), 2 + 250);
	memcpy(request, (uint8_t[]){16, 0, 0, 0, 123, 246}, 6);
	assert_int_equal(modbus_pdu(&bank.registers, request, 6 + 246, response), 5);
	memcpy(request, (uint8_t[]){23, 0, 0, 0, 125, 0, 0, 0, 121, 242}, 10);
	assert_int_equal(modbus_pdu(&bank.registers, request, 10 + 242, response), 2 + 250);
	memcpy(request, (uint8_t[]){16, 0, 0, 0, 124, 248}, 6);
	assert_int_equal(modbus_pdu(&bank.registers, request, MODBUS_PDU_MAX, response), 2);
	assert_int_equal(response[1], 3);
	memcpy(request, (uint8_t[]){23, 0, 0, 0, 1, 0, 0, 0, 122, 244}, 10);
	assert_int_equal(modbus_pdu(&bank.registers, request, 10 + 244, response), 2);
	assert_int_equal(response[1], 3);
	memcpy(request, (uint8_t[]){1, 0, 0, 2000 >> 8, 2000 & 0xFF}, 5);
	assert_int_equal(modbus_pdu(&bank.registers, request, 5, response), 2 + 250);
	assert_int_equal(response[1], 250);
	memcpy(request, (uint8_t[]){15, 0, 0, 1968 >> 8, 1968 & 0xFF, 246}, 6);
	assert_int_equal(modbus_pdu(&bank.registers, request, 6 + 246, response), 5);
	memcpy(request, (uint8_t[]){15, 0, 0, 1969 >> 8, 1969 & 0xFF, 247}, 6);
	assert_int_equal(modbus_pdu(&bank.registers, request, 6 + 247, response), 2);
	assert_int_equal(response[1], 3);
}

static void test_every_other_function_is_exception_1(void **state)
{
	static const uint8_t served[] = {1, 2, 3, 4, 5, 6, 15, 16, 22, 23, 43};
	uint8_t response[MODBUS_PDU_MAX];

	(void)state;
	for (unsigned function = 0; function < 128; function++) {
		const uint8_t request[5] = {(uint8_t)function, 0, 0, 0, 1};

		if (memchr(served, (int)function, sizeof(served)))
			continue;
		assert_int_equal(modbus_pdu(&bank.registers, request, 5, response), 2);
		assert_int_equal(response[0], function | 0x80);
		assert_int_equal(response[1], 1);
	}
	assert_answers("2B 0F 00", "AB 01");
}

static void test_a_client_that_may_only_read_gets_exception_1_for_writes(void **state)
{
	(void)state;
	bank.registers.read_only = true;
	assert_answers("05 00 00 FF 00", "85 01");
	assert_answers("06 00 01 00 03", "86 01");
	assert_answers("0F 00 00 00 01 01 01", "8F 01");
	assert_answers("10 00 01 00 01 02 00 0A", "90 01");
	assert_answers("16 00 04 00 F2 00 25", "96 01");
	assert_answers("17 00 00 00 01 00 00 00 01 02 00 00", "97 01");
	assert_answers("2B 0D 01 1F 20 3C 02 00 00 00 02 03 E8", "AB 01");
	assert_int_equal(bank.writes, 0);
	assert_answers("03 00 00 00 01", "03 02 00 00");
}

static void test_the_status_of_a_write_is_its_exception(void **state)
{
	static const struct {
		enum od_status status;
		const char *response;
	} CASES[] = {{OD_NO_OBJECT, "86 02"}, {OD_READ_ONLY, "86 02"}, {OD_TOO_HIGH, "86 03"}, {OD_TOO_LOW, "86 03"},
		{OD_BAD_VALUE, "86 03"}, {OD_GENERAL, "86 04"}, {OD_CANNOT_STORE, "86 04"}, {OD_DEVICE_STATE, "86 06"},
		{OD_LOCAL_CONTROL, "86 06"}};

	(void)state;
	for (size_t i = 0; i < sizeof(CASES) / sizeof(*CASES); i++) {
		bank.answer = CASES[i].status;
		assert_answers("06 00 01 00 03", CASES[i].response);
	}
}

/* 02: nothing to be read or written there; 03: not that value; 06: not now; 04: it failed. */
static void test_every_failure_has_one_of_the_exceptions_2_3_4_and_6(void **state)
{
	static const uint8_t EXCEPTIONS[OD_STATUS_COUNT] = {[OD_NO_OBJECT] = 2,
		[OD_NO_SUBINDEX] = 2,
		[OD_WRITE_ONLY] = 2,
		[OD_READ_ONLY] = 2,
		[OD_UNSUPPORTED_ACCESS] = 2,
		[OD_TOO_LONG] = 3,
		[OD_TOO_SHORT] = 3,
		[OD_TOO_HIGH] = 3,
		[OD_TOO_LOW] = 3,
		[OD_BAD_VALUE] = 3,
		[OD_NOT_MAPPABLE] = 3,
		[OD_PDO_LENGTH] = 3,
		[OD_INCOMPATIBLE] = 3,
		[OD_LOCAL_CONTROL] = 6,
		[OD_DEVICE_STATE] = 6,
		[OD_CANNOT_STORE] = 4,
		[OD_NO_DATA] = 4,
		[OD_GENERAL] = 4};

	(void)state;
	for (enum od_status s = OD_OK; s < OD_STATUS_COUNT; s++) {
		assert_int_equal(modbus_exception(s), EXCEPTIONS[s]);
		assert_int_equal(EXCEPTIONS[s] == 0, sdo_abort_code(s) == 0);
	}
}

static void test_a_write_that_takes_longer_is_answered_when_it_has_ended(void **state)
{
	const uint8_t coil[] = {5, 0, 1, 0xFF, 0}, object[] = {0x2B, 0x0D, 1, 0x1F, 0x10, 0x10, 1, 0, 0, 0, 0};
	uint8_t response[MODBUS_PDU_MAX];

	(void)state;
	bank.answer = OD_PENDING;
	assert_int_equal(modbus_pdu(&bank.registers, coil, sizeof(coil), response), 0);
	assert_int_equal(modbus_pdu_done(&bank.registers, coil, OD_OK, response), 5);
	assert_memory_equal(response, coil, 5);
	assert_int_equal(modbus_pdu_done(&bank.registers, coil, OD_CANNOT_STORE, response), 2);
	assert_int_equal(response[1], 4);
	assert_int_equal(modbus_pdu(&bank.registers, object, sizeof(object), response), 0);
	assert_int_equal(modbus_pdu_done(&bank.registers, object, OD_OK, response), sizeof(object));
}

/* ---- 43/14 ------------------------------------------------------------------------------------------------------- */

static void identify(void)
{
	bank.identification[0] = "ACME";
	bank.identification[1] = "X1";
	bank.identification[2] = "V2.11";
	bank.identification[4] = "Thing";
	bank.identification[0x80] = "12345678";
}

#define ACME "00 04 41 43 4D 45"
#define X1   "01 02 58 31"
#define V211 "02 05 56 32 2E 31 31"
#define NAME "04 05 54 68 69 6E 67"
#define UNIT "80 08 31 32 33 34 35 36 37 38"

static void test_identification_has_three_levels(void **state)
{
	(void)state;
	identify();
	assert_answers("2B 0E 01 00", "2B 0E 01 83 00 00 03 " ACME " " X1 " " V211);
	assert_answers("2B 0E 02 00", "2B 0E 02 83 00 00 04 " ACME " " X1 " " V211 " " NAME);
	assert_answers("2B 0E 03 00", "2B 0E 03 83 00 00 05 " ACME " " X1 " " V211 " " NAME " " UNIT);
}

/* V1.1b3, 6.21: basic to 02h, regular to 06h, extended from 80h on; what is between is reserved. */
static void test_each_level_has_its_objects_and_reserved_ones_are_in_none(void **state)
{
	static const unsigned BASIC = 3, REGULAR = 7, ALL = 7 + 128;
	uint8_t request[4] = {0x2B, 0x0E}, response[MODBUS_PDU_MAX];

	(void)state;
	for (int i = 0; i < 256; i++)
		bank.identification[i] = "x";
	for (uint8_t level = 1; level <= 3; level++) {
		unsigned seen = 0;

		request[2] = level;
		request[3] = 0;
		do {
			size_t size = modbus_pdu(&bank.registers, request, 4, response);

			assert_int_equal(size, 7 + 3u * response[6]);
			for (size_t at = 7; at < size; at += 3, seen++)
				assert_int_equal(response[at], seen < REGULAR ? seen : seen - REGULAR + 0x80);
			request[3] = response[5];
		} while (response[4] == 0xFF);
		assert_int_equal(response[5], 0);
		assert_int_equal(seen, level == 1 ? BASIC : level == 2 ? REGULAR : ALL);
	}
	request[2] = 4;
	for (unsigned number = 0; number < 256; number++) {
		request[3] = (uint8_t)number;
		assert_int_equal(
			modbus_pdu(&bank.registers, request, 4, response), number < REGULAR || number >= 0x80 ? 10 : 2);
	}
}

static void test_identification_fills_a_response_to_its_last_byte(void **state)
{
	uint8_t request[4] = {0x2B, 0x0E, 1, 0}, response[MODBUS_PDU_MAX];
	char text[300];

	(void)state;
	memset(text, 'x', sizeof(text));
	text[MODBUS_PDU_MAX - 7 - 2] = '\0';
	bank.identification[0] = text;
	assert_int_equal(modbus_pdu(&bank.registers, request, 4, response), MODBUS_PDU_MAX);
	assert_int_equal(response[8], MODBUS_PDU_MAX - 7 - 2);
	text[MODBUS_PDU_MAX - 7 - 2] = 'x';
	text[MODBUS_PDU_MAX - 7 - 1] = '\0';
	assert_int_equal(modbus_pdu(&bank.registers, request, 4, response), 7);
	assert_int_equal(response[4], 0xFF);
}

static void test_identification_begins_where_the_client_says(void **state)
{
	(void)state;
	identify();
	assert_answers("2B 0E 02 02", "2B 0E 02 83 00 00 02 " V211 " " NAME);
	/* no such object in this level: from the beginning */
	assert_answers("2B 0E 01 04", "2B 0E 01 83 00 00 03 " ACME " " X1 " " V211);
	assert_answers("2B 0E 01 33", "2B 0E 01 83 00 00 03 " ACME " " X1 " " V211);
}

static void test_one_object_of_the_identification(void **state)
{
	(void)state;
	identify();
	assert_answers("2B 0E 04 80", "2B 0E 04 83 00 00 01 " UNIT);
	assert_answers("2B 0E 04 03", "AB 02");
	assert_answers("2B 0E 05 00", "AB 03");
	assert_answers("2B 0E 00 00", "AB 03");
	assert_answers("2B 0E 01", "AB 03");
	assert_answers("2B 0E 01 00 00", "AB 03");
}

static void test_identification_that_does_not_fit_goes_on_in_the_next_response(void **state)
{
	uint8_t request[4] = {0x2B, 0x0E, 3, 0}, response[MODBUS_PDU_MAX];
	char text[101];

	(void)state;
	memset(text, 'x', 100);
	text[100] = '\0';
	bank.identification[0] = bank.identification[1] = bank.identification[2] = text;
	assert_int_equal(modbus_pdu(&bank.registers, request, 4, response), 7 + 2 * 102);
	assert_int_equal(response[4], 0xFF);
	assert_int_equal(response[5], 2);
	assert_int_equal(response[6], 2);
	request[3] = response[5];
	assert_int_equal(modbus_pdu(&bank.registers, request, 4, response), 7 + 102);
	assert_int_equal(response[4], 0);
	assert_int_equal(response[6], 1);
}

/* ---- 43/13 ------------------------------------------------------------------------------------------------------- */

static void sync_object(void)
{
	memcpy(bank.object, (uint8_t[]){0x80, 0, 0, 0}, 4);
	bank.object_size = 4;
}

static void test_objects_are_read_by_function_43_13(void **state)
{
	(void)state;
	sync_object();
	assert_answers("2B 0D 00 1F 10 05 00 00 00 00 08", "2B 0D 00 1F 10 05 00 00 00 00 04 80 00 00 00");
	/* node-ID 0 is this device, too */
	assert_answers("2B 0D 00 00 10 05 00 00 00 00 08", "2B 0D 00 00 10 05 00 00 00 00 04 80 00 00 00");
	/* the reserved byte and the encoding, where the protocol control byte announces them */
	assert_answers("2B 0D 02 00 50 1F 10 05 00 00 00 00 08", "2B 0D 02 00 50 1F 10 05 00 00 00 00 04 80 00 00 00");
}

static void test_objects_are_read_in_parts(void **state)
{
	(void)state;
	memcpy(bank.object, "ABCDEFGH", 8);
	bank.object_size = 8;
	assert_answers("2B 0D 00 1F 10 05 00 00 00 00 03", "2B 0D 00 1F 10 05 00 00 00 00 03 41 42 43");
	assert_answers("2B 0D 00 1F 10 05 00 00 03 00 03", "2B 0D 00 1F 10 05 00 00 03 00 03 44 45 46");
	assert_answers("2B 0D 00 1F 10 05 00 00 06 00 03", "2B 0D 00 1F 10 05 00 00 06 00 02 47 48");
	assert_answers("2B 0D 00 1F 10 05 00 00 08 00 03", "2B 0D 00 1F 10 05 00 00 08 00 00");
}

/* 253 bytes less the head, which is two bytes longer with an encoding. */
static void test_an_object_fills_a_response_to_its_last_byte(void **state)
{
	uint8_t plain[] = {0x2B, 0x0D, 0, 0x1F, 0x10, 0x05, 0, 0, 0, 0xFF, 0xFF};
	uint8_t encoded[] = {0x2B, 0x0D, 2, 0, 0x50, 0x1F, 0x10, 0x05, 0, 0, 0, 0xFF, 0xFF}, response[MODBUS_PDU_MAX];

	(void)state;
	bank.object_size = 300;
	assert_int_equal(modbus_pdu(&bank.registers, plain, sizeof(plain), response), MODBUS_PDU_MAX);
	assert_int_equal(response[9] << 8 | response[10], 242);
	assert_int_equal(modbus_pdu(&bank.registers, encoded, sizeof(encoded), response), MODBUS_PDU_MAX);
	assert_int_equal(response[11] << 8 | response[12], 240);
	plain[7] = 1; /* from byte 256 on */
	assert_int_equal(modbus_pdu(&bank.registers, plain, sizeof(plain), response), 11 + 44);
}

static void test_objects_are_written_by_function_43_13(void **state)
{
	(void)state;
	assert_answers("2B 0D 03 00 50 1F 20 3C 02 00 00 00 01 07", "2B 0D 03 00 50 1F 20 3C 02 00 00 00 00");
	assert_int_equal(bank.object[0], 7);
	assert_answers("2B 0D 01 00 20 3C 02 00 00 00 01 08", "2B 0D 01 00 20 3C 02 00 00 00 00");
	assert_answers("2B 0D 01 05 20 3C 02 00 00 00 01 09", "AB FF 00 06 0D EC 06 0A 00 23");
	assert_int_equal(bank.object[0], 8);
	assert_answers("2B 0D 01 1F 20 3C 02 00 00 00 02 03 E8", "2B 0D 01 1F 20 3C 02 00 00 00 00");
	assert_memory_equal(bank.object, "\x03\xE8", 2);
}

static void test_function_43_13_answers_with_sdo_abort_codes(void **state)
{
	(void)state;
	assert_answers("2B 0D 00 1F 99 99 00 00 00 00 08", "AB FF 00 06 0D EC 06 02 00 00");
	assert_answers("2B 0D 01 1F 10 08 00 00 00 00 01 00", "AB FF 00 06 0D EC 06 01 00 02");
	/* another node */
	assert_answers("2B 0D 00 05 10 05 00 00 00 00 08", "AB FF 00 06 0D EC 06 0A 00 23");
}

static void test_malformed_requests_of_function_43_are_exception_3(void **state)
{
	(void)state;
	assert_answers("2B", "AB 03");
	assert_answers("2B 0D", "AB 03");
	assert_answers("2B 05", "AB 01"); /* there is no such kind */
	assert_answers("2B 0D 00 1F 10 05 00 00 00 00", "AB 03");
	assert_answers("2B 0D 00 1F 10 05 00 00 00 00 08 00", "AB 03");
	assert_answers("2B 0D 04 1F 10 05 00 00 00 00 08", "AB 03");
	assert_answers("2B 0D 01 1F 20 3C 02 00 00 00 02 03", "AB 03");
	assert_answers("2B 0D 01 1F 20 3C 02 00 01 00 02 03 E8", "AB 03");
	assert_int_equal(bank.writes, 0);
}

/* ---- any request ------------------------------------------------------------------------------------------------- */

/* Exhaustive in the length: whatever is cut off, the response is an exception 3 or 1, and nothing is written. */
static void test_a_request_that_is_cut_off_writes_nothing(void **state)
{
	static const char *const REQUESTS[] = {"05 00 AC FF 00", "06 00 01 00 03", "0F 00 13 00 0A 02 CD 01",
		"10 00 01 00 02 04 00 0A 01 02", "16 00 04 00 F2 00 25",
		"17 00 03 00 06 00 0E 00 03 06 00 FF 00 FF 00 FF", "2B 0D 01 1F 20 3C 02 00 00 00 02 03 E8",
		"01 00 00 00 01", "03 00 00 00 01", "2B 0E 01 00"};
	uint8_t request[MODBUS_PDU_MAX], response[MODBUS_PDU_MAX];

	(void)state;
	for (size_t i = 0; i < sizeof(REQUESTS) / sizeof(*REQUESTS); i++) {
		size_t size = from_hex(REQUESTS[i], request);

		for (size_t cut = 1; cut < size; cut++) {
			uint8_t *exact = malloc(cut);

			memcpy(exact, request, cut);
			assert_int_equal(modbus_pdu(&bank.registers, exact, cut, response), 2);
			assert_int_equal(response[1], 3);
			free(exact);
		}
		assert_int_equal(modbus_pdu_size(request, size), size);
		assert_true(size > 5 || modbus_pdu_size(request, 2) == 0);
	}
	assert_int_equal(bank.writes, 0);
}

/* As the requests above, with a byte too many: of those with a byte count this is wrong, too. */
static void test_a_request_with_a_byte_too_many_does_nothing(void **state)
{
	static const char *const REQUESTS[] = {"01 00 00 00 01 00", "02 00 00 00 01 00", "03 00 00 00 01 00",
		"04 00 00 00 01 00", "05 00 AC FF 00 00", "06 00 01 00 03 00", "0F 00 13 00 0A 02 CD 01 00",
		"10 00 01 00 02 04 00 0A 01 02 00", "16 00 04 00 F2 00 25 00",
		"17 00 03 00 06 00 0E 00 03 06 00 FF 00 FF 00 FF 00", "2B 0D 01 1F 20 3C 02 00 00 00 02 03 E8 00",
		"2B 0E 01 00 00"};
	uint8_t request[MODBUS_PDU_MAX], response[MODBUS_PDU_MAX];

	(void)state;
	for (size_t i = 0; i < sizeof(REQUESTS) / sizeof(*REQUESTS); i++) {
		assert_int_equal(modbus_pdu(&bank.registers, request, from_hex(REQUESTS[i], request), response), 2);
		assert_int_equal(response[1], 3);
	}
	assert_int_equal(bank.reads + bank.writes, 0);
}

/* On a line: how long a request is, as soon as its bytes tell. */
static void test_the_size_of_a_request_follows_from_its_first_bytes(void **state)
{
	static const struct {
		const char *request;
		size_t known_from; /* bytes; before: 0 */
		int size;
	} REQUESTS[] = {{"01 00 00 00 01", 3, 5}, {"02 00 00 00 01", 3, 5}, {"03 00 00 00 01", 3, 5},
		{"04 00 00 00 01", 3, 5}, {"05 00 AC FF 00", 3, 5}, {"06 00 01 00 03", 3, 5},
		{"0F 00 13 00 0A 02 CD 01", 6, 8}, {"10 00 01 00 02 04 00 0A 01 02", 6, 10},
		{"10 00 01 00 7B F6", 6, 6 + 246}, {"16 00 04 00 F2 00 25", 3, 7},
		{"17 00 03 00 06 00 0E 00 03 06 00 FF 00 FF 00 FF", 10, 16},
		{"2B 0D 00 1F 10 05 00 00 00 00 08", 3, 11}, {"2B 0D 02 00 50 1F 10 05 00 00 00 00 08", 3, 13},
		{"2B 0D 01 1F 20 3C 02 00 00 00 02 03 E8", 11, 13},
		{"2B 0D 01 1F 20 3C 02 00 00 01 02 03", 11, 11 + 258},
		{"2B 0D 03 00 50 1F 20 3C 02 00 00 00 02 03 E8", 13, 15}, {"2B 0E 01 00", 3, 4}, {"2B 0F 00", 3, -1},
		{"07 00 00", 3, -1}, {"41 00 00", 3, -1}};
	uint8_t request[MODBUS_PDU_MAX];

	(void)state;
	for (size_t i = 0; i < sizeof(REQUESTS) / sizeof(*REQUESTS); i++) {
		size_t size = from_hex(REQUESTS[i].request, request);

		for (size_t n = 0; n <= size; n++) {
			uint8_t *exact = malloc(n + 1);

			memcpy(exact, request, n);
			assert_int_equal(modbus_pdu_size(exact, n), n >= REQUESTS[i].known_from ? REQUESTS[i].size : 0);
			free(exact);
		}
	}
}

static void test_which_requests_write_is_known(void **state)
{
	static const uint8_t WRITES[] = {5, 6, 15, 16, 22, 23};
	uint8_t request[3] = {0};

	(void)state;
	for (unsigned function = 0; function < 256; function++) {
		request[0] = (uint8_t)function;
		assert_int_equal(modbus_pdu_writes(request, 3), memchr(WRITES, (int)function, sizeof(WRITES)) != NULL);
	}
	assert_true(modbus_pdu_writes((const uint8_t[]){0x2B, 0x0D, 1}, 3));
	assert_true(modbus_pdu_writes((const uint8_t[]){0x2B, 0x0D, 3}, 3));
	assert_false(modbus_pdu_writes((const uint8_t[]){0x2B, 0x0D, 2}, 3));
	assert_false(modbus_pdu_writes((const uint8_t[]){0x2B, 0x0E, 1}, 3));
	assert_false(modbus_pdu_writes((const uint8_t[]){0x2B, 0x0D, 1}, 2));
}

#define TEST(name) cmocka_unit_test_setup(name, set_up)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_coils_are_read_as_in_the_specification),
		TEST(test_discrete_inputs_are_read_as_in_the_specification),
		TEST(test_registers_are_read_as_in_the_specification),
		TEST(test_single_writes_are_repeated),
		TEST(test_multiple_writes_answer_address_and_quantity),
		TEST(test_a_mask_write_changes_bits),
		TEST(test_function_23_writes_before_it_reads),
		TEST(test_function_23_writes_nothing_when_its_range_cannot_be_read),
		TEST(test_an_address_that_is_not_there_is_exception_2),
		TEST(test_a_range_ends_at_the_last_address),
		TEST(test_bits_fill_as_many_bytes_as_they_need),
		TEST(test_a_quantity_out_of_range_is_exception_3),
		TEST(test_the_largest_quantities_are_served),
		TEST(test_every_other_function_is_exception_1),
		TEST(test_a_client_that_may_only_read_gets_exception_1_for_writes),
		TEST(test_the_status_of_a_write_is_its_exception),
		TEST(test_every_failure_has_one_of_the_exceptions_2_3_4_and_6),
		TEST(test_a_write_that_takes_longer_is_answered_when_it_has_ended),
		TEST(test_identification_has_three_levels),
		TEST(test_each_level_has_its_objects_and_reserved_ones_are_in_none),
		TEST(test_identification_fills_a_response_to_its_last_byte),
		TEST(test_identification_begins_where_the_client_says),
		TEST(test_one_object_of_the_identification),
		TEST(test_identification_that_does_not_fit_goes_on_in_the_next_response),
		TEST(test_objects_are_read_by_function_43_13),
		TEST(test_objects_are_read_in_parts),
		TEST(test_an_object_fills_a_response_to_its_last_byte),
		TEST(test_objects_are_written_by_function_43_13),
		TEST(test_function_43_13_answers_with_sdo_abort_codes),
		TEST(test_malformed_requests_of_function_43_are_exception_3),
		TEST(test_a_request_that_is_cut_off_writes_nothing),
		TEST(test_a_request_with_a_byte_too_many_does_nothing),
		TEST(test_the_size_of_a_request_follows_from_its_first_bytes),
		TEST(test_which_requests_write_is_known),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
