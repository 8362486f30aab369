/* Stored values as a concise DCF: decoding restores them, and damaged bytes are refused or skipped. */
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

enum { NODE_ID = 5, CAPACITY = 8192, ROUNDS = 200 };

static struct od od;
static struct od_values values, base;
static uint8_t dcf[CAPACITY];

static int fresh(void **state)
{
	(void)state;
	srand(1);
	od_init(&od, &imu9_od_table, &values, NODE_ID);
	base = values;
	return 0;
}

static void random_bytes(uint8_t *bytes, size_t size)
{
	for (size_t i = 0; i < size; i++)
		bytes[i] = (uint8_t)rand();
}

/* Random values for about half of the stored entries; many attempts are refused by a limit. */
static void scatter(void)
{
	uint8_t wire[OD_VALUE_MAX];

	for (size_t i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *entry = &imu9_od_table.entries[i];

		if (!(entry->access & OD_STORED) || rand() % 2)
			continue;
		for (int tries = 0; tries < 100; tries++) {
			random_bytes(wire, entry->size);
			if (od_put(&od, entry, wire, entry->size) == OD_OK)
				break;
		}
	}
}

static void test_random_values_survive_encoding_and_decoding(void **state)
{
	(void)state;
	for (int round = 0; round < ROUNDS; round++) {
		struct od_values stored;
		size_t skipped = 99;
		long size;

		values = base;
		scatter();
		stored = values;
		size = od_encode(&od, OD_GROUP_ALL, &base, dcf, sizeof(dcf));
		assert_true(size > 4);
		values = base;
		assert_true(od_decode(&od, dcf, (size_t)size, &skipped) > 0);
		assert_int_equal(skipped, 0);
		assert_memory_equal(&values, &stored, sizeof(stored));
	}
}

static void test_the_bytes_are_those_of_cia_302(void **state)
{
	static const uint8_t EXPECTED[] = {
		2, 0, 0, 0,					   /* two entries */
		0x17, 0x10, 0, 2, 0, 0, 0, 0xF4, 0x01,		   /* 1017h:0, 2 bytes, 500 */
		0x00, 0x20, 1, 4, 0, 0, 0, 0x00, 0x00, 0x80, 0x3E, /* 2000h:1, 4 bytes, 0.25 */
	};

	(void)state;
	values.producer_heartbeat_time = 500;
	values.lever_arm.l = 0.25f;
	assert_int_equal(od_encode(&od, OD_GROUP_ALL, &base, dcf, sizeof(dcf)), sizeof(EXPECTED));
	assert_memory_equal(dcf, EXPECTED, sizeof(EXPECTED));
}

static void test_no_change_is_encoded_as_a_count_of_zero(void **state)
{
	size_t skipped;

	(void)state;
	assert_int_equal(od_encode(&od, OD_GROUP_ALL, &base, dcf, sizeof(dcf)), 4);
	assert_memory_equal(dcf, "\0\0\0\0", 4);
	assert_int_equal(od_decode(&od, dcf, 4, &skipped), 0);
}

static void test_a_group_contains_only_its_own_objects(void **state)
{
	(void)state;
	values.producer_heartbeat_time = 500;
	values.lever_arm.l = 0.25f;
	values.angle_resolution = 100;
	assert_int_equal(od_encode(&od, OD_GROUP_COMMUNICATION, &base, dcf, sizeof(dcf)), 4 + 7 + 2);
	assert_memory_equal(dcf + 4, "\x17\x10", 2);
	assert_int_equal(od_encode(&od, OD_GROUP_MANUFACTURER, &base, dcf, sizeof(dcf)), 4 + 7 + 4);
	assert_memory_equal(dcf + 4, "\x00\x20", 2);
	assert_int_equal(od_encode(&od, OD_GROUP_APPLICATION, &base, dcf, sizeof(dcf)), 4 + 7 + 2);
	assert_memory_equal(dcf + 4, "\x00\x60", 2);
}

static void test_measurements_and_commands_are_not_encoded(void **state)
{
	(void)state;
	values.sample.counter = 7;
	values.error_history.number_of_errors = 1;
	values.position.reset = 1;
	values.identity.serial_number = 1;
	assert_int_equal(od_encode(&od, OD_GROUP_ALL, &base, dcf, sizeof(dcf)), 4);
}

static void test_a_buffer_that_is_too_small_is_refused(void **state)
{
	long whole;

	(void)state;
	scatter();
	whole = od_encode(&od, OD_GROUP_ALL, &base, dcf, sizeof(dcf));
	for (long capacity = 0; capacity < whole; capacity++)
		assert_int_equal(od_encode(&od, OD_GROUP_ALL, &base, dcf, (size_t)capacity), -ENOSPC);
	assert_int_equal(od_encode(&od, OD_GROUP_ALL, &base, dcf, (size_t)whole), whole);
}

static void test_a_dcf_truncated_anywhere_is_refused_completely(void **state)
{
	size_t skipped;
	long whole;

	(void)state;
	scatter();
	whole = od_encode(&od, OD_GROUP_ALL, &base, dcf, sizeof(dcf));
	values = base;
	for (long size = 0; size < whole; size++) {
		uint8_t *cut = malloc((size_t)size + !size); /* exact size: a sanitizer finds reads beyond the end */

		memcpy(cut, dcf, (size_t)size);
		assert_int_equal(od_decode(&od, cut, (size_t)size, &skipped), -EINVAL);
		assert_memory_equal(&values, &base, sizeof(base));
		free(cut);
	}
}

static void test_bytes_after_the_last_entry_are_refused(void **state)
{
	size_t skipped;
	long whole;

	(void)state;
	scatter();
	whole = od_encode(&od, OD_GROUP_ALL, &base, dcf, sizeof(dcf) - 1);
	dcf[whole] = 0;
	assert_int_equal(od_decode(&od, dcf, (size_t)whole + 1, &skipped), -EINVAL);
}

/* Every REAL is finite and every value is within its limits. */
static void assert_all_values_are_allowed(void)
{
	static struct od_values copy;
	struct od check;

	od_init(&check, &imu9_od_table, &copy, NODE_ID);
	for (size_t i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *entry = &imu9_od_table.entries[i];
		uint8_t wire[OD_VALUE_MAX];
		size_t size = od_get(&od, entry, wire, sizeof(wire));

		if (!(entry->access & OD_CONST) && entry->type != OD_DOMAIN)
			assert_int_equal(od_put(&check, entry, wire, size), OD_OK);
	}
}

static void test_any_flipped_bit_is_refused_or_skipped_or_an_allowed_value(void **state)
{
	uint8_t flipped[CAPACITY];
	size_t skipped;
	long whole;

	(void)state;
	scatter();
	whole = od_encode(&od, OD_GROUP_ALL, &base, dcf, sizeof(dcf));
	for (long bit = 0; bit < 8 * whole; bit++) {
		long result;

		memcpy(flipped, dcf, (size_t)whole);
		flipped[bit / 8] ^= (uint8_t)(1 << bit % 8);
		values = base;
		result = od_decode(&od, flipped, (size_t)whole, &skipped);
		if (result < 0) {
			assert_int_equal(result, -EINVAL);
			assert_memory_equal(&values, &base, sizeof(base));
		} else if (bit % 17 == 0) {
			assert_all_values_are_allowed();
		}
	}
}

static void test_entries_that_do_not_fit_are_skipped_and_counted(void **state)
{
	static const uint8_t DCF[] = {
		6, 0, 0, 0,			       /* */
		0x00, 0x30, 0, 1, 0, 0, 0, 1,	       /* no such object */
		0x08, 0x10, 0, 1, 0, 0, 0, 'x',	       /* constant */
		0x00, 0x21, 1, 2, 0, 0, 0, 1, 0,       /* read-only */
		0x01, 0x20, 0, 1, 0, 0, 0, 4,	       /* above its limit */
		0x17, 0x10, 0, 4, 0, 0, 0, 1, 0, 0, 0, /* too long */
		0x02, 0x20, 0, 1, 0, 0, 0, 1,	       /* valid */
	};
	size_t skipped = 0;

	(void)state;
	assert_int_equal(od_decode(&od, DCF, sizeof(DCF), &skipped), 1);
	assert_int_equal(skipped, 5);
	assert_int_equal(values.rates_from, 1);
	values.rates_from = 0;
	assert_memory_equal(&values, &base, sizeof(base));
}

static void test_a_count_beyond_the_bytes_is_refused(void **state)
{
	static const uint8_t DCF[] = {0xFF, 0xFF, 0xFF, 0xFF};
	static const uint8_t LENGTH[] = {1, 0, 0, 0, 0x00, 0x20, 1, 0xFF, 0xFF, 0xFF, 0xFF};
	size_t skipped;

	(void)state;
	assert_int_equal(od_decode(&od, DCF, sizeof(DCF), &skipped), -EINVAL);
	assert_int_equal(od_decode(&od, LENGTH, sizeof(LENGTH), &skipped), -EINVAL);
}

static void test_crc32_is_that_of_ieee_802_3(void **state)
{
	(void)state;
	assert_int_equal(od_crc32(0, "123456789", 9), 0xCBF43926);
	assert_int_equal(od_crc32(0, "", 0), 0);
	assert_int_equal(od_crc32(0, "\0\0\0\0", 4), 0x2144DF1C);
}

static void test_crc32_can_be_computed_in_pieces(void **state)
{
	(void)state;
	assert_int_equal(od_crc32(od_crc32(0, "1234", 4), "56789", 5), 0xCBF43926);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test_setup(test_random_values_survive_encoding_and_decoding, fresh),
		cmocka_unit_test_setup(test_the_bytes_are_those_of_cia_302, fresh),
		cmocka_unit_test_setup(test_no_change_is_encoded_as_a_count_of_zero, fresh),
		cmocka_unit_test_setup(test_a_group_contains_only_its_own_objects, fresh),
		cmocka_unit_test_setup(test_measurements_and_commands_are_not_encoded, fresh),
		cmocka_unit_test_setup(test_a_buffer_that_is_too_small_is_refused, fresh),
		cmocka_unit_test_setup(test_a_dcf_truncated_anywhere_is_refused_completely, fresh),
		cmocka_unit_test_setup(test_bytes_after_the_last_entry_are_refused, fresh),
		cmocka_unit_test_setup(test_any_flipped_bit_is_refused_or_skipped_or_an_allowed_value, fresh),
		cmocka_unit_test_setup(test_entries_that_do_not_fit_are_skipped_and_counted, fresh),
		cmocka_unit_test_setup(test_a_count_beyond_the_bytes_is_refused, fresh),
		cmocka_unit_test(test_crc32_is_that_of_ieee_802_3),
		cmocka_unit_test(test_crc32_can_be_computed_in_pieces),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
