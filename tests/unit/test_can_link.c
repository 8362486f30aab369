/* Bit rates that a controller supports (drivers/can/can_link.h). The limits are those of the kernel's drivers. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include "drivers/can/can_link.h"
#include "tests/unit/descriptors.h"

/* an SJA1000 with a 16 MHz crystal runs at 8 MHz */
static const struct can_link sja1000 = {.controller = true,
	.limits = {.clock_hz = 8000000,
		.brp_min = 1,
		.brp_max = 64,
		.brp_inc = 1,
		.tseg1_min = 1,
		.tseg1_max = 16,
		.tseg2_min = 1,
		.tseg2_max = 8}};

static void test_a_controller_supports_the_rates_its_clock_can_be_divided_to(void **state)
{
	static const uint32_t rates[] = {1000000, 800000, 500000, 250000, 125000, 50000, 20000, 10000};

	(void)state;
	for (size_t i = 0; i < sizeof(rates) / sizeof(rates[0]); i++)
		assert_true(can_link_has_rate(&sja1000, rates[i]));
}

static void test_a_rate_more_than_half_a_percent_off_is_not_supported(void **state)
{
	(void)state;
	assert_true(can_link_has_rate(&sja1000, 799000));
	assert_false(can_link_has_rate(&sja1000, 780000));
}

static void test_a_rate_that_is_too_low_or_too_high_is_not_supported(void **state)
{
	(void)state;
	assert_false(can_link_has_rate(&sja1000, 4000)); /* 64 x 25 quanta are 5 kbit/s */
	assert_false(can_link_has_rate(&sja1000, 4000000));
	assert_false(can_link_has_rate(&sja1000, 0));
}

static void test_a_controller_with_a_list_supports_only_the_rates_in_it(void **state)
{
	const struct can_link slcan = {.controller = true, .rates = {10000, 125000, 250000}, .rate_count = 2};

	(void)state;
	assert_true(can_link_has_rate(&slcan, 125000));
	assert_false(can_link_has_rate(&slcan, 250000));
}

static void test_where_the_limits_are_unknown_the_kernel_decides(void **state)
{
	const struct can_link unknown = {.controller = true};

	(void)state;
	assert_true(can_link_has_rate(&unknown, 1));
	assert_false(can_link_has_rate(&unknown, 0));
}

static void test_a_bus_without_a_controller_supports_none(void **state)
{
	const struct can_link vcan = {0};

	(void)state;
	assert_false(can_link_has_rate(&vcan, 125000));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_controller_supports_the_rates_its_clock_can_be_divided_to),
		cmocka_unit_test(test_a_rate_more_than_half_a_percent_off_is_not_supported),
		cmocka_unit_test(test_a_rate_that_is_too_low_or_too_high_is_not_supported),
		cmocka_unit_test(test_a_controller_with_a_list_supports_only_the_rates_in_it),
		cmocka_unit_test(test_where_the_limits_are_unknown_the_kernel_decides),
		cmocka_unit_test(test_a_bus_without_a_controller_supports_none),
	};

	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}
