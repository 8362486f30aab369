/* Status LEDs: CiA 303-3. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "gateway/canopen/node.h"
#include "gateway/led.h"
#include "tests/unit/descriptors.h"

struct fixture {
	struct can_port bus;
	struct od od;
	struct od_values values;
	struct canopen_node node;
	struct leds leds;
	char folder[64];
};

static int take_frame(struct can_port *port, const struct can_msg *msg)
{
	(void)port, (void)msg;
	return 0;
}

static int take_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port, (void)ids, (void)n;
	return 0;
}

static void start(struct fixture *f, uint8_t node_id)
{
	static const struct can_ops ops = {.send = take_frame, .filter = take_filter};

	*f = (struct fixture){.bus = {.ops = &ops}};
	od_init(&f->od, &imu9_od_table, &f->values, node_id);
	assert_int_equal(canopen_init(&f->node, &f->od, &f->bus, NULL, node_id), 0);
	canopen_start(&f->node, 1);
	leds_init(&f->leds, &f->values, &f->node, &f->bus);
}

static int set_up(void **state)
{
	static struct fixture f;

	start(&f, 16);
	*state = &f;
	return 0;
}

static void receive(struct fixture *f, uint32_t id, uint8_t len, const char *data)
{
	struct can_msg msg = {.id = id, .len = len};

	memcpy(msg.data, data, len);
	canopen_receive(&f->node, &msg, 2);
}

static void raise_error(struct fixture *f, uint16_t code)
{
	canopen_error_set(&f->node, code, 0, NULL, 3);
}

static enum led_state error(struct fixture *f)
{
	leds_tick(&f->leds, 0);
	return (enum led_state)f->values.status_leds.error;
}

static enum led_state run(struct fixture *f)
{
	leds_tick(&f->leds, 0);
	return (enum led_state)f->values.status_leds.run;
}

static void test_the_run_led_shows_the_nmt_state(void **state)
{
	assert_int_equal(run(*state), LED_BLINKING);
	receive(*state, 0, 2, "\x01\x10");
	assert_int_equal(run(*state), LED_ON);
	receive(*state, 0, 2, "\x02\x10");
	assert_int_equal(run(*state), LED_SINGLE_FLASH);
}

static void test_both_leds_flicker_while_lss_configures_the_node(void **state)
{
	receive(*state, 0x7E5, 8, "\x04\x01\0\0\0\0\0\0");
	assert_int_equal(run(*state), LED_FLICKERING);
	assert_int_equal(error(*state), LED_FLICKERING);
	receive(*state, 0x7E5, 8, "\x04\x00\0\0\0\0\0\0");
	assert_int_equal(run(*state), LED_BLINKING);
	assert_int_equal(error(*state), LED_OFF);
}

static void test_both_leds_flicker_while_the_node_waits_for_a_node_id(void **state)
{
	start(*state, CANOPEN_UNCONFIGURED);
	assert_int_equal(run(*state), LED_FLICKERING);
	assert_int_equal(error(*state), LED_FLICKERING);
}

static void test_of_several_errors_the_one_of_highest_priority_is_shown(void **state)
{
	struct fixture *f = *state;

	assert_int_equal(error(f), LED_OFF);
	receive(f, 0x7E5, 8, "\x04\x01\0\0\0\0\0\0");
	raise_error(f, 0x6320);
	assert_int_equal(error(f), LED_BLINKING);
	f->bus.state = CAN_STATE_WARNING;
	assert_int_equal(error(f), LED_SINGLE_FLASH);
	raise_error(f, 0x8130);
	assert_int_equal(error(f), LED_DOUBLE_FLASH);
	raise_error(f, 0x8240);
	assert_int_equal(error(f), LED_TRIPLE_FLASH);
	raise_error(f, 0x8250);
	assert_int_equal(error(f), LED_QUADRUPLE_FLASH);
	f->bus.state = CAN_STATE_BUS_OFF;
	assert_int_equal(error(f), LED_ON);
}

static void test_a_cleared_error_is_not_shown(void **state)
{
	struct fixture *f = *state;

	raise_error(f, 0x8130);
	canopen_error_clear(&f->node, 0x8130, 4);
	assert_int_equal(error(f), LED_OFF);
}

static void test_error_passive_is_shown_like_the_warning_limit(void **state)
{
	((struct fixture *)*state)->bus.state = CAN_STATE_PASSIVE;
	assert_int_equal(error(*state), LED_SINGLE_FLASH);
}

/* One character for each 50 ms, for 2.4 s. */
static void assert_pattern(enum led_state state, bool second, const char *expected)
{
	char text[49] = "";

	for (uint64_t i = 0; i < 48; i++) {
		uint64_t change_us;

		text[i] = led_lit(state, second, i * 50000, &change_us) ? '#' : '.';
		assert_true(change_us > i * 50000);
	}
	assert_string_equal(text, expected);
}

static void test_each_state_has_the_rhythm_of_the_standard(void **state)
{
	(void)state;
	assert_pattern(LED_OFF, false, "................................................");
	assert_pattern(LED_ON, false, "################################################");
	assert_pattern(LED_FLICKERING, false, "#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.");
	assert_pattern(LED_FLICKERING, true, ".#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#.#");
	assert_pattern(LED_BLINKING, false, "####....####....####....####....####....####....");
	assert_pattern(LED_SINGLE_FLASH, false, "####....................####....................");
	assert_pattern(LED_DOUBLE_FLASH, false, "####....####....................####....####....");
	assert_pattern(LED_TRIPLE_FLASH, false, "####....####....####....................####....");
	assert_pattern(LED_QUADRUPLE_FLASH, false, "####....####....####....####....................");
}

/* ---- Linux LEDs -------------------------------------------------------------------------------------------------- */

static void make_file(const char *folder, const char *led, const char *file)
{
	char path[400];

	snprintf(path, sizeof(path), "%s/%s", folder, led);
	mkdir(path, 0755);
	snprintf(path, sizeof(path), "%s/%s/%s", folder, led, file);
	FILE *f = fopen(path, "w");
	assert_non_null(f);
	fputs("?", f);
	fclose(f);
}

/* In sysfs each write stands alone; here it replaces as many characters. */
static void assert_holds(const char *folder, const char *led, const char *file, const char *expected)
{
	char path[200], text[20];

	snprintf(path, sizeof(path), "%s/%s/%s", folder, led, file);
	FILE *f = fopen(path, "r");
	assert_non_null(f);
	assert_int_equal(fread(text, 1, sizeof(text), f), strlen(expected));
	fclose(f);
	assert_memory_equal(text, expected, strlen(expected));
}

static void test_linux_leds_lose_their_trigger_and_blink(void **state)
{
	struct fixture *f = *state;
	const char *which;
	char command[100];

	strcpy(f->folder, "/tmp/imu9-leds-XXXXXX");
	assert_non_null(mkdtemp(f->folder));
	make_file(f->folder, "green", "trigger");
	make_file(f->folder, "green", "brightness");
	make_file(f->folder, "red", "brightness"); /* without a trigger */
	assert_int_equal(leds_open(&f->leds, f->folder, "green", "red", &which), 0);
	assert_holds(f->folder, "green", "trigger", "none");
	assert_holds(f->folder, "red", "brightness", "0");
	assert_int_equal(leds_tick(&f->leds, 0), 200000);
	assert_holds(f->folder, "green", "brightness", "255");
	assert_int_equal(leds_tick(&f->leds, 200000), 400000);
	assert_holds(f->folder, "green", "brightness", "055");
	f->bus.state = CAN_STATE_BUS_OFF;
	leds_tick(&f->leds, 200000);
	assert_holds(f->folder, "red", "brightness", "255");
	leds_close(&f->leds);
	assert_holds(f->folder, "red", "brightness", "055");
	snprintf(command, sizeof(command), "rm -r %s", f->folder);
	assert_int_equal(system(command), 0);
}

static void test_a_missing_led_is_an_error(void **state)
{
	struct fixture *f = *state;
	const char *which;

	assert_int_equal(leds_open(&f->leds, "/nowhere", "green", "", &which), -2);
	assert_string_equal(which, "green");
	assert_true(leds_tick(&f->leds, 0) == UINT64_MAX);
}

/* So can the folder. */
static void test_names_can_have_200_characters(void **state)
{
	struct fixture *f = *state;
	char led[201], folder[201], long_folder[300];
	const char *which;

	strcpy(f->folder, "/tmp/imu9-leds-XXXXXX");
	assert_non_null(mkdtemp(f->folder));
	memset(led, 'x', 200);
	led[200] = '\0';
	snprintf(long_folder, sizeof(long_folder), "%s/", f->folder);
	while (strlen(long_folder) < 200)
		strcat(long_folder, "/");
	snprintf(folder, sizeof(folder), "%.200s", long_folder);
	make_file(f->folder, led, "brightness");
	assert_int_equal(leds_open(&f->leds, folder, led, "", &which), 0);
	leds_close(&f->leds);
	snprintf(long_folder, sizeof(long_folder), "rm -r %s", f->folder);
	assert_int_equal(system(long_folder), 0);
}

static void test_a_led_without_a_name_is_none(void **state)
{
	struct fixture *f = *state;
	const char *which;

	assert_int_equal(leds_open(&f->leds, "/nowhere", "", "", &which), 0);
	assert_true(leds_tick(&f->leds, 0) == UINT64_MAX);
	leds_close(&f->leds);
}

static void test_a_missing_error_led_is_told_by_its_name(void **state)
{
	struct fixture *f = *state;
	const char *which;

	assert_int_equal(leds_open(&f->leds, "/nowhere", "", "red", &which), -2);
	assert_string_equal(which, "red");
}

static void test_the_error_led_works_without_the_run_led(void **state)
{
	struct fixture *f = *state;
	const char *which;
	char command[100];

	strcpy(f->folder, "/tmp/imu9-leds-XXXXXX");
	assert_non_null(mkdtemp(f->folder));
	make_file(f->folder, "red", "brightness");
	assert_int_equal(leds_open(&f->leds, f->folder, "green", "red", &which), -2);
	assert_string_equal(which, "green");
	f->bus.state = CAN_STATE_BUS_OFF;
	leds_tick(&f->leds, 0);
	assert_holds(f->folder, "red", "brightness", "255");
	leds_close(&f->leds);
	snprintf(command, sizeof(command), "rm -r %s", f->folder);
	assert_int_equal(system(command), 0);
}

#define TEST(f) cmocka_unit_test_setup(f, set_up)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_the_run_led_shows_the_nmt_state),
		TEST(test_both_leds_flicker_while_lss_configures_the_node),
		TEST(test_both_leds_flicker_while_the_node_waits_for_a_node_id),
		TEST(test_of_several_errors_the_one_of_highest_priority_is_shown),
		TEST(test_a_cleared_error_is_not_shown),
		TEST(test_error_passive_is_shown_like_the_warning_limit),
		cmocka_unit_test(test_each_state_has_the_rhythm_of_the_standard),
		TEST(test_linux_leds_lose_their_trigger_and_blink),
		TEST(test_a_missing_led_is_an_error),
		TEST(test_names_can_have_200_characters),
		TEST(test_a_led_without_a_name_is_none),
		TEST(test_a_missing_error_led_is_told_by_its_name),
		TEST(test_the_error_led_works_without_the_run_led),
	};

	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}
