/* The configuration of the process, and its error messages. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "gateway/config.h"
#include "od_values.h"
#include "tests/unit/descriptors.h"

static struct config config;
static struct od od;
static struct od_values values;
static char why[CONFIG_ERROR_MAX];
static char file[64];

static int set_up(void **state)
{
	(void)state;
	config_init(&config, &imu9_od_table);
	od_init(&od, &imu9_od_table, &values, 1);
	why[0] = '\0';
	return 0;
}

static int read_file(const char *text)
{
	strcpy(file, "/tmp/imu9-config-XXXXXX");
	int fd = mkstemp(file);
	assert_true(fd >= 0);
	assert_int_equal(write(fd, text, strlen(text)), strlen(text));
	close(fd);
	int rc = config_file(&config, file, why);
	unlink(file);
	return rc;
}

/* The error begins with "FILE:LINE: ". */
static void assert_error_at(int line)
{
	char place[80];

	snprintf(place, sizeof(place), "%s:%d: ", file, line);
	assert_memory_equal(why, place, strlen(place));
}

static void test_objects_are_set_by_name_with_or_without_a_section(void **state)
{
	(void)state;
	assert_int_equal(read_file("lever_arm.l = 0.05\nlever_arm_model = 1\n[lever_arm]\ns = -0.25\n"), 0);
	config_apply(&config, &od);
	assert_float_equal(values.lever_arm.l, 0.05, 1e-9);
	assert_float_equal(values.lever_arm.s, -0.25, 1e-9);
	assert_int_equal(values.lever_arm_model, 1);
}

static void test_the_gateway_section_holds_the_process_keys(void **state)
{
	(void)state;
	assert_int_equal(read_file("[gateway]\nimu = replay:a.csv,loop\ncan = udp\nnode_id = "
				   "16\nbitrate=250000\n"),
		0);
	assert_string_equal(config.imu, "replay:a.csv,loop");
	assert_string_equal(config.can, "udp");
	assert_int_equal(config.node_id, 16);
	assert_int_equal(config.bitrate, 250000);
}

static void test_a_later_setting_replaces_an_earlier_one(void **state)
{
	(void)state;
	assert_int_equal(read_file("lever_arm.l = 1\n"), 0);
	assert_int_equal(config_set(&config, "lever_arm.l=2", why), 0);
	config_apply(&config, &od);
	assert_float_equal(values.lever_arm.l, 2, 1e-9);
}

static void test_an_index_can_be_used_as_a_name(void **state)
{
	(void)state;
	assert_int_equal(config_set(&config, "0x2000:2=0.5", why), 0);
	config_apply(&config, &od);
	assert_float_equal(values.lever_arm.s, 0.5, 1e-9);
}

static void test_an_unknown_object_names_its_line(void **state)
{
	(void)state;
	assert_int_equal(read_file("# comment\nlever_arm.l = 1\nlever_arm.q = 1\n"), -ENOENT);
	assert_error_at(3);
	assert_non_null(strstr(why, "lever_arm.q"));
}

static void test_the_name_of_an_unknown_object_has_its_section(void **state)
{
	(void)state;
	assert_int_equal(read_file("[x]\nl = 1\n"), -ENOENT);
	assert_non_null(strstr(why, ":2: no object has the name 'x.l'; `imu9-sdo dump` and objects.md list the names"));
	assert_int_equal(read_file("l = 1\n"), -ENOENT);
	assert_non_null(strstr(why, ":1: no object has the name 'l'; "));
}

static void test_an_unknown_gateway_key_names_its_line_and_the_known_ones(void **state)
{
	(void)state;
	assert_int_equal(read_file("[gateway]\nnodeid = 5\n"), -ENOENT);
	assert_error_at(2);
	assert_non_null(strstr(why, "node_id"));
}

static void test_a_value_out_of_limits_names_line_and_limits(void **state)
{
	(void)state;
	assert_int_equal(read_file("[lever_arm]\nl = 11\n"), -EINVAL);
	assert_error_at(2);
	assert_non_null(strstr(why, "-10 to 10 m"));
}

static void test_a_long_value_out_of_limits_does_not_overflow_the_error_text(void **state)
{
	char assignment[2 * CONFIG_ERROR_MAX + 40], error[4 * CONFIG_ERROR_MAX] = "";

	(void)state;
	snprintf(assignment, sizeof(assignment), "lever_arm.l=%*s", 2 * CONFIG_ERROR_MAX, "1e9");
	assert_int_equal(config_set(&config, assignment, error), -EINVAL);
	for (size_t i = CONFIG_ERROR_MAX; i < sizeof(error); i++)
		assert_int_equal(error[i], 0);
}

static void test_a_value_that_is_not_a_number_is_refused(void **state)
{
	static const char *const bad[] = {"lever_arm.l = five\n", "lever_arm.l = nan\n", "lever_arm.l = inf\n",
		"lever_arm.l =\n", "lever_arm.l = 1 m\n", "lever_arm_model = 1.5\n", "lever_arm_model = -1\n"};

	(void)state;
	for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); i++) {
		assert_int_equal(read_file(bad[i]), -EINVAL);
		assert_error_at(1);
	}
}

static void test_an_object_that_is_not_configuration_cannot_be_set(void **state)
{
	(void)state;
	assert_int_equal(config_set(&config, "acceleration.l=1", why), -EACCES);
	assert_int_equal(config_set(&config, "position.reset=1", why), -EACCES);
	assert_int_equal(config_set(&config, "device_type=1", why), -EACCES);
}

static void test_a_syntax_error_names_its_line(void **state)
{
	(void)state;
	assert_int_equal(read_file("lever_arm.l = 1\nwhat is this\n"), -EINVAL);
	assert_error_at(2);
}

static void test_an_overlong_line_is_named(void **state)
{
	char text[600] = "lever_arm.l = 1\nlever_arm.s = ";

	(void)state;
	memset(text + strlen(text), '1', 400);
	assert_int_equal(read_file(text), -EINVAL);
	assert_error_at(2);
	assert_non_null(strstr(why, ":2: the line is longer than 198 characters"));
	memset(text, ';', sizeof(text));
	strcpy(text + 198, "\nlever_arm.l = 2"); /* that long; and the last line without an end */
	assert_int_equal(read_file(text), 0);
	config_apply(&config, &od);
	assert_float_equal(values.lever_arm.l, 2, 0);
}

static void test_a_folder_is_no_file(void **state)
{
	(void)state;
	assert_int_equal(config_file(&config, "/tmp", why), -EIO);
	assert_string_equal(why, "/tmp: cannot be read");
}

static void test_of_several_errors_the_first_is_told(void **state)
{
	(void)state;
	assert_int_equal(read_file("[Gateway]\nnode_id = 200\nimu =\nwhat is this\n"), -EINVAL);
	assert_non_null(strstr(why, ":2: node_id: '200' is neither a number from 1 to 127 nor 255 (LSS assigns one)"));
	assert_int_equal(read_file("what is this\n[gateway]\nlog_level = loud\n"), -EINVAL);
	assert_error_at(3); /* of a key before the others */
	assert_non_null(strstr(why, ":3: log_level: 'loud' is none of error, warning, info and debug"));
}

static void test_a_number_is_decimal_octal_or_hexadecimal_whatever_failed_before(void **state)
{
	(void)state;
	errno = ERANGE;
	assert_int_equal(config_option(&config, "serial", "0x12AB", why), 0);
	assert_int_equal(config.serial, 0x12AB);
	assert_int_equal(config_option(&config, "serial", "010", why), 0);
	assert_int_equal(config.serial, 8);
}

static void test_a_missing_file_is_an_error(void **state)
{
	(void)state;
	assert_int_equal(config_file(&config, "/no/such/file.ini", why), -ENOENT);
	assert_non_null(strstr(why, "/no/such/file.ini"));
}

static void test_the_example_file_holds_the_defaults(void **state)
{
	(void)state;
	static struct config defaults;
	static struct od_values default_values;

	config_init(&defaults, &imu9_od_table);
	od_init(&od, &imu9_od_table, &default_values, 1);
	od_init(&od, &imu9_od_table, &values, 1);
	assert_int_equal(config_file(&config, "tools/service/imu9-gateway.conf", why), 0);
	config_apply(&config, &od);
	assert_memory_equal(&values, &default_values, sizeof(values));
	assert_string_equal(config.imu, defaults.imu);
	assert_string_equal(config.can, defaults.can);
	assert_int_equal(config.node_id, defaults.node_id);
}

static void test_process_keys_are_checked(void **state)
{
	static const char *const bad[][2] = {{"node_id", "0"}, {"node_id", "128"}, {"node_id", "5x"}, {"node_id", ""},
		{"node_id", "-1"}, {"node_id", "-18446744073709551615"}, {"node_id", "-4294967295"}, {"bitrate", "1"},
		{"realtime", "100"}, {"imu", ""}, {"log_level", "loud"}};

	(void)state;
	for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); i++)
		assert_int_equal(config_option(&config, bad[i][0], bad[i][1], why), -EINVAL);
	assert_int_equal(config.node_id, 1);
}

/* README.md and the configuration file say so. */
static void test_each_number_has_its_limits(void **state)
{
	static const struct {
		const char *key;
		unsigned long long low, high;
		const unsigned *value;
	} numbers[] = {
		{"node_id", 1, 127, &config.node_id},
		{"bitrate", 10000, 1000000, &config.bitrate},
		{"realtime", 0, 99, &config.realtime},
		{"serial", 0, 4294967295, &config.serial},
		{"vendor_id", 0, 4294967295, &config.vendor_id},
	};
	char text[40];

	(void)state;
	for (size_t i = 0; i < sizeof(numbers) / sizeof(numbers[0]); i++) {
		for (int k = 0; k < 4; k++) {
			unsigned long long limit = k < 2 ? numbers[i].low : numbers[i].high;

			snprintf(text, sizeof(text), "%lld", (long long)limit + (k == 0 ? -1 : k == 3));
			assert_int_equal(
				config_option(&config, numbers[i].key, text, why), k == 0 || k == 3 ? -EINVAL : 0);
			if (k == 1 || k == 2)
				assert_int_equal(*numbers[i].value, limit);
		}
		snprintf(text, sizeof(text), "%llu to %llu", numbers[i].low, numbers[i].high);
		assert_non_null(strstr(why, text));
	}
}

static void test_a_text_has_up_to_255_characters(void **state)
{
	static const char *const keys[] = {"imu", "can", "store", "record", "run_led", "error_led", "cia309", "modbus"};
	char text[CONFIG_TEXT_MAX + 1];

	(void)state;
	memset(text, 'x', CONFIG_TEXT_MAX);
	text[CONFIG_TEXT_MAX] = '\0';
	for (size_t i = 0; i < sizeof(keys) / sizeof(keys[0]); i++) {
		assert_int_equal(config_option(&config, keys[i], text, why), -EINVAL);
		assert_non_null(strstr(why, "1 to 255 characters"));
		assert_int_equal(config_option(&config, keys[i], text + 1, why), 0);
	}
}

static void test_the_keys_that_differ_are_found(void **state)
{
	static struct config other;
	size_t from = 0;

	(void)state;
	other = config;
	assert_null(config_changed(&config, &other, &from));
	assert_int_equal(config_option(&other, "can", "can7", why), 0);
	assert_int_equal(config_option(&other, "log_level", "debug", why), 0);
	from = 0;
	assert_string_equal(config_changed(&config, &other, &from), "can");
	assert_string_equal(config_changed(&config, &other, &from), "log_level");
	assert_null(config_changed(&config, &other, &from));
}

static void test_a_modbus_window_is_added_each_time(void **state)
{
	static struct config before;
	size_t from = 0;

	(void)state;
	assert_int_equal(read_file("[gateway]\nmodbus = tcp:127.0.0.1:1502\nmodbus = rtu:/dev/ttyUSB0\n"), 0);
	before = config;
	assert_int_equal(config_option(&config, "modbus", "tcp:[::1]:1502", why), 0);
	assert_string_equal(config.modbus, "tcp:127.0.0.1:1502\nrtu:/dev/ttyUSB0\ntcp:[::1]:1502\n");
	assert_string_equal(config_changed(&before, &config, &from), "modbus");
	while (config_option(&config, "modbus", "tcp:127.0.0.1:1502", why) == 0)
		assert_true(strlen(config.modbus) < CONFIG_LIST_MAX);
	assert_string_equal(why, "modbus: given too often");
}

static void test_a_set_without_a_value_shows_the_syntax(void **state)
{
	(void)state;
	assert_int_equal(config_set(&config, "lever_arm.l", why), -EINVAL);
	assert_non_null(strstr(why, "NAME=VALUE"));
	assert_int_equal(config_set(&config, "=1", why), -EINVAL);
}

/* What imu9-sdo save writes of a node in which all differs from the defaults. */
static void test_all_configuration_objects_fit_one_file(void **state)
{
	char text[OD_VALUE_MAX * 4], *all = NULL;
	uint8_t wire[OD_VALUE_MAX];
	size_t size, n = 0;
	FILE *f = open_memstream(&all, &size);

	(void)state;
	for (size_t i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *e = &imu9_od_table.entries[i];

		if (!(e->access & OD_STORED) || !(e->access & OD_WRITE) || e->type == OD_VISIBLE_STRING)
			continue;
		assert_true(od_format(e, wire, od_get(&od, e, wire, sizeof(wire)), text, sizeof(text)) > 0);
		fprintf(f, "%s = %s\n", e->name, text);
		n++;
	}
	fclose(f);
	assert_int_equal(read_file(all), 0);
	assert_int_equal(config.object_count, n);
	free(all);
}

#define TEST(f) cmocka_unit_test_setup(f, set_up)

static void test_the_addresses_of_cia309_add_up(void **state)
{
	char text[CONFIG_TEXT_MAX];
	int rc = 0;

	(void)state;
	assert_string_equal(config.cia309, "");
	assert_int_equal(config_option(&config, "cia309", "unix:/run/a", why), 0);
	assert_int_equal(config_option(&config, "cia309", "tcp:127.0.0.1:60000", why), 0);
	assert_string_equal(config.cia309, "unix:/run/a\ntcp:127.0.0.1:60000\n");
	assert_int_equal(config_option(&config, "cia309", "", why), -EINVAL);
	memset(text, 'x', sizeof(text));
	text[sizeof(text) - 1] = '\0';
	for (int i = 0; i < CONFIG_LIST_MAX / CONFIG_TEXT_MAX + 1 && rc == 0; i++)
		rc = config_option(&config, "cia309", text, why);
	assert_int_equal(rc, -E2BIG);
	assert_true(strlen(config.cia309) < CONFIG_LIST_MAX);
}

static void test_too_many_objects_are_refused_with_their_number(void **state)
{
	(void)state;
	for (int i = 0; i < CONFIG_OBJECTS_MAX; i++)
		assert_int_equal(config_set(&config, "lever_arm.l=0.1", why), 0);
	assert_int_equal(config_set(&config, "lever_arm.l=0.1", why), -E2BIG);
	assert_non_null(strstr(why, "more than 512 objects"));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test_setup(test_too_many_objects_are_refused_with_their_number, set_up),
		TEST(test_objects_are_set_by_name_with_or_without_a_section),
		TEST(test_the_gateway_section_holds_the_process_keys),
		TEST(test_a_later_setting_replaces_an_earlier_one),
		TEST(test_an_index_can_be_used_as_a_name),
		TEST(test_an_unknown_object_names_its_line),
		TEST(test_the_name_of_an_unknown_object_has_its_section),
		TEST(test_an_unknown_gateway_key_names_its_line_and_the_known_ones),
		TEST(test_a_value_out_of_limits_names_line_and_limits),
		TEST(test_a_long_value_out_of_limits_does_not_overflow_the_error_text),
		TEST(test_a_value_that_is_not_a_number_is_refused),
		TEST(test_an_object_that_is_not_configuration_cannot_be_set),
		TEST(test_a_syntax_error_names_its_line),
		TEST(test_an_overlong_line_is_named),
		TEST(test_a_folder_is_no_file),
		TEST(test_of_several_errors_the_first_is_told),
		TEST(test_a_number_is_decimal_octal_or_hexadecimal_whatever_failed_before),
		TEST(test_a_missing_file_is_an_error),
		TEST(test_the_example_file_holds_the_defaults),
		TEST(test_process_keys_are_checked),
		TEST(test_each_number_has_its_limits),
		TEST(test_a_text_has_up_to_255_characters),
		TEST(test_the_keys_that_differ_are_found),
		TEST(test_a_modbus_window_is_added_each_time),
		TEST(test_a_set_without_a_value_shows_the_syntax),
		TEST(test_all_configuration_objects_fit_one_file),
		TEST(test_the_addresses_of_cia309_add_up),
	};

	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}
