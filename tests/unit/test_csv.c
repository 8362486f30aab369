#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "model/sim/rng.h"
#include "tools/lib/csv.h"

static void assert_number(double value, int decimals, const char *text)
{
	struct csv_row row = {0};

	csv_number(&row, value, decimals);
	row.text[row.length] = '\0';
	assert_string_equal(row.text, text);
}

static void test_numbers_are_written_with_their_decimals_and_rounded(void **state)
{
	(void)state;
	assert_number(0, 3, "0.000");
	assert_number(-1.23456, 3, "-1.235");
	assert_number(0.0004, 3, "0.000");
	assert_number(-0.0004, 3, "0.000");
	assert_number(999.9999, 2, "1000.00");
	assert_number(12345678.5, 0, "12345679");
	assert_number(1e-9, 9, "0.000000001");
}

static void test_large_and_not_finite_values_are_written_in_the_format_g(void **state)
{
	(void)state;
	assert_number(1e12, 3, "1e+12");
	assert_number(-2.5e300, 3, "-2.5e+300");
	assert_number(INFINITY, 3, "inf");
	assert_number(NAN, 3, "nan");
}

/* printf() is the oracle; it rounds halves to even, but random numbers have no halves. */
static void test_random_numbers_are_written_as_printf_does(void **state)
{
	struct rng rng;

	(void)state;
	rng_init(&rng, 1);
	for (int i = 0; i < 20000; i++) {
		double value = rng_gauss(&rng) * pow(10, 6 * rng_uniform(&rng) - 3);
		int decimals = (int)(rng_u64(&rng) % 8);
		char expected[64];

		snprintf(expected, sizeof expected, "%.*f", decimals, value);
		if (strtod(expected, NULL) == 0 && expected[0] == '-')
			memmove(expected, expected + 1, strlen(expected));
		assert_number(value, decimals, expected);
	}
}

static void test_a_row_has_commas_between_its_fields_and_is_empty_after_writing(void **state)
{
	struct csv_row row = {0};
	char text[128] = "";
	FILE *file = fmemopen(text, sizeof text, "w");

	(void)state;
	csv_time(&row, 12000034);
	csv_vec3(&row, (struct vec3){1, -2, 0.5}, 1);
	csv_empty(&row, 2);
	csv_write(&row, file);
	csv_time(&row, 0);
	csv_write(&row, file);
	fclose(file);
	assert_string_equal(text, "12.000034,1.0,-2.0,0.5,,\n0.000000\n");
}

static void test_a_full_row_ignores_further_fields(void **state)
{
	struct csv_row row = {0};

	(void)state;
	for (int i = 0; i < 1000; i++)
		csv_number(&row, -123456789.123456789, 9);
	assert_true(row.length < CSV_ROW_MAX);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_numbers_are_written_with_their_decimals_and_rounded),
		cmocka_unit_test(test_large_and_not_finite_values_are_written_in_the_format_g),
		cmocka_unit_test(test_random_numbers_are_written_as_printf_does),
		cmocka_unit_test(test_a_row_has_commas_between_its_fields_and_is_empty_after_writing),
		cmocka_unit_test(test_a_full_row_ignores_further_fields),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
