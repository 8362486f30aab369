/* The options of a BUS (drivers/can/bus_options.h). */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <stdio.h>
#include <string.h>

#include "drivers/can/bus_options.h"

static struct bus_options parsed(const char *text)
{
	struct bus_options options;
	char error[200] = "";

	if (bus_options_parse(&options, text, error, sizeof(error)) < 0)
		fail_msg("%s", error);
	return options;
}

static void test_without_options_the_bit_rate_is_500_kbit_s(void **state)
{
	struct bus_options o = parsed("/dev/ttyACM0@9600");

	(void)state;
	assert_string_equal(o.address, "/dev/ttyACM0@9600");
	assert_int_equal(o.bit_s, 500000);
	assert_int_equal(o.sample_point_permille, 0);
	assert_false(o.listen_only);
}

static void test_options_follow_the_address_in_any_order(void **state)
{
	struct bus_options o = parsed("0042:1,listen-only,sample-point=0.8755,bitrate=125000");

	(void)state;
	assert_string_equal(o.address, "0042:1");
	assert_int_equal(o.bit_s, 125000);
	assert_int_equal(o.sample_point_permille, 876);
	assert_true(o.listen_only);
	assert_string_equal(parsed(",bitrate=125000").address, "");
}

static void test_the_bounds_of_the_values_are_permitted(void **state)
{
	(void)state;
	assert_int_equal(parsed(",bitrate=5000").bit_s, 5000);
	assert_int_equal(parsed(",bitrate=1000000").bit_s, 1000000);
	assert_int_equal(parsed(",bitrate=0125000").bit_s, 125000);
	assert_int_equal(parsed(",sample-point=0.5").sample_point_permille, 500);
	assert_int_equal(parsed(",sample-point=0.95").sample_point_permille, 950);
}

static void test_an_unknown_option_or_a_bad_value_is_refused_with_the_options(void **state)
{
	static const char *const bad[] = {"bitrate=4999", "bitrate=1000001", "bitrate=", "bitrate=-5", "bitrate=+5000",
		"bitrate=125000x", "bitrate=125 000", "sample-point=0.49", "sample-point=0.96",
		"sample-point=", "sample-point=0.8x", "sample-point=nan", "listen", "listen-only=1", "speed=1", ""};

	(void)state;
	for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); i++) {
		struct bus_options options;
		char text[80], quoted[80], error[200] = "";

		snprintf(text, sizeof(text), "address,%s", bad[i]);
		snprintf(quoted, sizeof(quoted), "'%s': use bitrate=5000 to 1000000", bad[i]);
		if (bus_options_parse(&options, text, error, sizeof(error)) != -EINVAL)
			fail_msg("%s was accepted", bad[i]);
		assert_non_null(strstr(error, quoted));
	}
}

static void test_an_address_has_199_characters_at_most(void **state)
{
	struct bus_options options;
	char text[201], error[200] = "";

	(void)state;
	memset(text, 'a', sizeof(text));
	text[199] = '\0';
	assert_int_equal(strlen(parsed(text).address), 199);
	text[199] = 'a';
	text[200] = '\0';
	assert_int_equal(bus_options_parse(&options, text, error, sizeof(error)), -EINVAL);
	assert_non_null(strstr(error, "too long"));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_without_options_the_bit_rate_is_500_kbit_s),
		cmocka_unit_test(test_options_follow_the_address_in_any_order),
		cmocka_unit_test(test_the_bounds_of_the_values_are_permitted),
		cmocka_unit_test(test_an_unknown_option_or_a_bad_value_is_refused_with_the_options),
		cmocka_unit_test(test_an_address_has_199_characters_at_most),
	};

	return cmocka_run_group_tests_name("bus_options", tests, NULL, NULL);
}
