/* gateway/histogram.h: bins counted by hand, quantiles, and the wire form byte by byte. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <errno.h>
#include <string.h>

#include "gateway/histogram.h"

static void test_numbers_below_8_have_bins_of_their_own(void **state)
{
	(void)state;
	for (unsigned i = 0; i < 8; i++) {
		assert_int_equal(histogram_bin(i), i);
		assert_int_equal(histogram_lowest(i), i);
	}
}

/* 8 to 15 in steps of 2, 16 to 31 of 4, 32 to 63 of 8, and so on; written out. */
static void test_a_power_of_two_has_four_bins(void **state)
{
	static const uint32_t lowest[] = {8, 10, 12, 14, 16, 20, 24, 28, 32, 40, 48, 56, 64, 80, 96, 112, 128};

	(void)state;
	for (unsigned i = 0; i < sizeof(lowest) / sizeof(lowest[0]); i++) {
		assert_int_equal(histogram_lowest(8 + i), lowest[i]);
		assert_int_equal(histogram_bin(lowest[i]), 8 + i);
		assert_int_equal(histogram_bin(lowest[i] - 1), 7 + i);
	}
	assert_int_equal(histogram_bin(1000), 35); /* 896 to 1023: the fourth of 512 to 1023, bins 32 to 35 */
	assert_int_equal(histogram_lowest(35), 896);
	assert_int_equal(histogram_lowest(36), 1024);
}

static void test_no_bin_is_wider_than_a_quarter_of_its_lowest_number(void **state)
{
	(void)state;
	for (unsigned i = 4; i < HISTOGRAM_BINS - 1; i++) {
		uint32_t lowest = histogram_lowest(i), next = histogram_lowest(i + 1);

		assert_true(next > lowest);
		assert_true(next - lowest <= lowest / 4);
		assert_int_equal(histogram_bin(next - 1), i);
	}
}

static void test_the_last_bin_has_all_that_is_longer(void **state)
{
	struct histogram h = {0};

	(void)state;
	assert_int_equal(histogram_lowest(95), 29360128); /* 7/4 of 2^24 */
	assert_int_equal(histogram_bin(29360127), 94);
	histogram_add(&h, 29360128);
	histogram_add(&h, UINT64_C(1) << 40);
	assert_int_equal(h.bins[95], 2);
	assert_int_equal(h.maximum, UINT32_MAX);
}

static void test_minimum_maximum_and_sum_are_exact(void **state)
{
	struct histogram h = {0};

	(void)state;
	histogram_add(&h, 1000);
	histogram_add(&h, 0);
	histogram_add(&h, 4321);
	assert_int_equal(h.count, 3);
	assert_int_equal(h.minimum, 0);
	assert_int_equal(h.maximum, 4321);
	assert_int_equal(h.sum, 5321);
}

static void test_a_full_histogram_counts_no_more(void **state)
{
	struct histogram h = {.count = UINT32_MAX, .maximum = 5, .sum = 77};

	(void)state;
	histogram_add(&h, 9);
	assert_int_equal(h.count, UINT32_MAX);
	assert_int_equal(h.maximum, 5);
	assert_int_equal(h.sum, 77);
	assert_int_equal(h.bins[8], 0);
}

/* 1000 durations: 900 of 5, 90 of 50 (bin 48 to 55), 9 of 500 (448 to 511), one of 5000. */
static void test_a_quantile_is_the_end_of_its_bin(void **state)
{
	struct histogram h = {0};

	(void)state;
	assert_int_equal(histogram_quantile(&h, 0.5), 0);
	for (int i = 0; i < 1000; i++)
		histogram_add(&h, i < 900 ? 5 : i < 990 ? 50 : i < 999 ? 500 : 5000);
	assert_int_equal(histogram_quantile(&h, 0.5), 5);
	assert_int_equal(histogram_quantile(&h, 0.1), 5); /* just those 100 are longer */
	assert_int_equal(histogram_quantile(&h, 0.0999), 55);
	assert_int_equal(histogram_quantile(&h, 0.01), 55);
	assert_int_equal(histogram_quantile(&h, 0.001), 511);
	assert_int_equal(histogram_quantile(&h, 0), 5000); /* not the end of its bin, which nothing reached */
}

static void test_the_wire_form_is_little_endian(void **state)
{
	struct histogram h = {0}, copy = {.count = 7, .sum = 7};
	uint8_t wire[HISTOGRAM_WIRE];
	static const uint8_t head[] = {2, 0, 0, 0, 3, 0, 0, 0, 0x02, 0x01, 0, 0, 0x05, 0x01, 0, 0, 0, 0, 0, 0};

	(void)state;
	assert_int_equal(HISTOGRAM_WIRE, 404);
	histogram_add(&h, 3);
	histogram_add(&h, 0x102); /* bin 28: 256 to 319 */
	histogram_encode(&h, wire);
	assert_memory_equal(wire, head, sizeof(head));
	for (size_t i = sizeof(head); i < sizeof(wire); i++)
		assert_int_equal(wire[i], i == 20 + 4 * 3 || i == 20 + 4 * 28 ? 1 : 0);
	assert_int_equal(histogram_decode(&copy, wire, sizeof(wire)), 0);
	assert_int_equal(copy.count, 2);
	assert_int_equal(copy.minimum, 3);
	assert_int_equal(copy.maximum, 0x102);
	assert_int_equal(copy.sum, 0x105);
	assert_memory_equal(copy.bins, h.bins, sizeof(h.bins));
}

static void test_what_is_no_histogram_is_refused(void **state)
{
	struct histogram h = {0};
	uint8_t wire[HISTOGRAM_WIRE] = {0};

	(void)state;
	assert_int_equal(histogram_decode(&h, wire, sizeof(wire) - 1), -EINVAL);
	wire[0] = 1; /* one counted, in no bin */
	assert_int_equal(histogram_decode(&h, wire, sizeof(wire)), -EINVAL);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_numbers_below_8_have_bins_of_their_own),
		cmocka_unit_test(test_a_power_of_two_has_four_bins),
		cmocka_unit_test(test_no_bin_is_wider_than_a_quarter_of_its_lowest_number),
		cmocka_unit_test(test_the_last_bin_has_all_that_is_longer),
		cmocka_unit_test(test_minimum_maximum_and_sum_are_exact),
		cmocka_unit_test(test_a_full_histogram_counts_no_more),
		cmocka_unit_test(test_a_quantile_is_the_end_of_its_bin),
		cmocka_unit_test(test_the_wire_form_is_little_endian),
		cmocka_unit_test(test_what_is_no_histogram_is_refused),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
