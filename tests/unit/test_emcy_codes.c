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

/* CiA 301, table 26 */
static void test_another_code_has_the_text_of_its_class(void **state)
{
	static const struct {
		unsigned from, to;
		const char *text;
	} classes[] = {{0x1002, 0x10FF, "generic error"}, {0x2000, 0x2FFF, "current"}, {0x3000, 0x3FFF, "voltage"},
		{0x4000, 0x4FFF, "temperature"}, {0x5002, 0x50FF, "device hardware"},
		{0x60FF, 0x60FF, "device software"}, {0x6101, 0x61FF, "internal software"},
		{0x6201, 0x62FF, "user software"}, {0x63F0, 0x63FF, "data set"}, {0x7000, 0x70FF, "additional modules"},
		{0x8001, 0x80FF, "monitoring"}, {0x8190, 0x81FF, "communication"}, {0x8260, 0x82FF, "protocol error"},
		{0x9000, 0x90FF, "external error"}, {0xF000, 0xF0FF, "additional functions"},
		{0xFF90, 0xFFFF, "device-specific"}};

	(void)state;
	for (size_t i = 0; i < sizeof(classes) / sizeof(classes[0]); i++) {
		assert_string_equal(emcy_code_text((uint16_t)classes[i].from), classes[i].text);
		assert_string_equal(emcy_code_text((uint16_t)classes[i].to), classes[i].text);
	}
	assert_string_equal(emcy_code_text(0x00FF), "no error");
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
