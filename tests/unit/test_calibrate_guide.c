/* What imu9-calibrate lever-arm asks for while the object is turned. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include "tools/calibrate/calibrate_lever_arm.h"

static void test_the_axes_whose_rates_are_small_are_missing(void **state)
{
	static const struct {
		double rate_rad_s[3];
		const char *missing;
	} CASES[] = {
		{{2, 0.1, 0.1}, "s and t"},
		{{2, 1.5, 0.2}, "t"},
		{{0.1, 2, 0.1}, "l and t"},
		{{0.1, 0.1, 3}, "l and s"},
		{{0.1, 2, 2}, "l"},
		{{0.1, 0.1, 0.1}, "all axes, and quicker"},
	};

	(void)state;
	for (size_t i = 0; i < sizeof(CASES) / sizeof(CASES[0]); i++)
		assert_string_equal(calibrate_missing_by_rate(CASES[i].rate_rad_s), CASES[i].missing);
	assert_null(calibrate_missing_by_rate((const double[]){1, 2, 1.5}));
}

/* Turned about l only, r is known across l but not along it. */
static void test_an_uncertain_component_needs_rotation_about_the_other_axes(void **state)
{
	(void)state;
	assert_string_equal(calibrate_missing_by_sigma((const double[]){0.020, 0.001, 0.001}), "s and t");
	assert_string_equal(calibrate_missing_by_sigma((const double[]){0.001, 0.005, 0.001}), "l and t");
	assert_string_equal(calibrate_missing_by_sigma((const double[]){0.002, 0.001, 0.010}), "l and s");
	assert_null(calibrate_missing_by_sigma((const double[]){0.004, 0.003, 0.004}));	   /* alike: time helps */
	assert_null(calibrate_missing_by_sigma((const double[]){0.0018, 0.0005, 0.0006})); /* good enough */
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_axes_whose_rates_are_small_are_missing),
		cmocka_unit_test(test_an_uncertain_component_needs_rotation_about_the_other_axes),
	};

	return cmocka_run_group_tests_name("calibration guide", tests, NULL, NULL);
}
