/* Which bit rates a controller has: drivers/can/can_link.h. The limits are those of the kernel's drivers. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include "drivers/can/can_link.h"

/* SJA1000 with its 16 MHz crystal: 8 MHz */
static const struct can_link sja1000 = {.controller = true,
	.limits = {.clock_hz = 8000000,
		.brp_min = 1,
		.brp_max = 64,
		.brp_inc = 1,
		.tseg1_min = 1,
		.tseg1_max = 16,
		.tseg2_min = 1,
		.tseg2_max = 8}};

static void test_a_controller_has_the_rates_that_its_clock_divides_into(void **state)
{
	static const uint32_t rates[] = {1000000, 800000, 500000, 250000, 125000, 50000, 20000, 10000};

	(void)state;
	for (size_t i = 0; i < sizeof(rates) / sizeof(rates[0]); i++)
		assert_true(can_link_has_rate(&sja1000, rates[i]));
}

static void test_a_rate_beyond_half_a_percent_is_not_had(void **state)
{
	(void)state;
	assert_true(can_link_has_rate(&sja1000, 799000));
	assert_false(can_link_has_rate(&sja1000, 780000));
}

static void test_a_rate_too_slow_or_too_fast_is_not_had(void **state)
{
	(void)state;
	assert_false(can_link_has_rate(&sja1000, 4000)); /* 64 x 25 quanta are 5 kbit/s */
	assert_false(can_link_has_rate(&sja1000, 4000000));
	assert_false(can_link_has_rate(&sja1000, 0));
}

static void test_a_controller_with_a_list_has_what_stands_there(void **state)
{
	const struct can_link slcan = {.controller = true, .rates = {10000, 125000}, .rate_count = 2};

	(void)state;
	assert_true(can_link_has_rate(&slcan, 125000));
	assert_false(can_link_has_rate(&slcan, 250000));
}

static void test_a_bus_without_a_controller_has_none(void **state)
{
	const struct can_link vcan = {0};

	(void)state;
	assert_false(can_link_has_rate(&vcan, 125000));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_controller_has_the_rates_that_its_clock_divides_into),
		cmocka_unit_test(test_a_rate_beyond_half_a_percent_is_not_had),
		cmocka_unit_test(test_a_rate_too_slow_or_too_fast_is_not_had),
		cmocka_unit_test(test_a_controller_with_a_list_has_what_stands_there),
		cmocka_unit_test(test_a_bus_without_a_controller_has_none),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
