/* The texts of the emergency error codes. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>
#include <string.h>

#include "gateway/canopen/emcy_codes.h"

static void test_a_code_of_this_device_has_its_own_text(void **state)
{
	(void)state;
	assert_string_equal(emcy_code_text(EMCY_ERROR_PASSIVE), "CAN error passive");
	assert_string_equal(emcy_code_text(EMCY_SENSOR_LOST), "the IMU delivers no samples");
	assert_string_equal(emcy_code_text(EMCY_NO_ERROR), "no error");
}

static void test_another_code_has_the_text_of_its_class(void **state)
{
	(void)state;
	assert_string_equal(emcy_code_text(0x8230), "protocol error");
	assert_string_equal(emcy_code_text(0x8160), "communication");
	assert_string_equal(emcy_code_text(0x8F00), "monitoring");
	assert_string_equal(emcy_code_text(0x2310), "current");
	assert_string_equal(emcy_code_text(0x6399), "data set");
	assert_string_equal(emcy_code_text(0xFF99), "device-specific");
	assert_string_equal(emcy_code_text(0xF001), "additional functions");
}

static void test_a_code_outside_every_class_is_unknown(void **state)
{
	(void)state;
	assert_string_equal(emcy_code_text(0xA000), "unknown error");
	assert_string_equal(emcy_code_text(0x0100), "unknown error");
}

/* The event log cuts a line at 150 bytes, of which 48 are around the text. */
static void test_every_text_fits_into_a_line_of_the_event_log(void **state)
{
	(void)state;
	for (unsigned code = 0; code <= 0xFFFF; code++)
		assert_true(strlen(emcy_code_text((uint16_t)code)) < 100);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_code_of_this_device_has_its_own_text),
		cmocka_unit_test(test_another_code_has_the_text_of_its_class),
		cmocka_unit_test(test_a_code_outside_every_class_is_unknown),
		cmocka_unit_test(test_every_text_fits_into_a_line_of_the_event_log),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
