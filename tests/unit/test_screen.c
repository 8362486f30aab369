/* The screen of the monitor as text, at the sizes of terminals: a node's frames go in, rows come out. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <cmocka.h>

#include "gateway/canopen/canopen.h"
#include "od_values.h"
#include "tools/monitor/screen.h"

enum { NODE = 5, SECOND = 1000000 };

static struct od_values values;
static struct watch watch;
static struct history history;
static struct screen_cells cells;
static struct screen screen;

static int discard(struct can_port *port, const struct can_msg *msg)
{
	(void)port, (void)msg;
	return 0;
}

/* With its default mapping, operational. */
static void node_begins(void)
{
	static const struct can_ops ops = {.send = discard};
	static struct can_port bus = {.ops = &ops, .fd = -1};

	watch_init(&watch, &imu9_od_table, &values, &bus, NODE, true, SECOND);
	watch_poll(&watch, SECOND);
	memset(&history, 0, sizeof(history));
	screen = (struct screen){.watch = &watch,
		.history = &history,
		.bus_name = "can0",
		.node_id = NODE,
		.hint = "",
		.now_us = SECOND,
		.keys = true};
}

static void frame(uint32_t id, const void *data, uint8_t len, uint64_t now_us)
{
	struct can_msg msg = {.id = id, .len = len};

	memcpy(msg.data, data, len);
	watch_receive(&watch, &msg, now_us);
	screen.now_us = now_us;
}

#define FRAME(id, now_us, ...) frame(id, (const uint8_t[]){__VA_ARGS__}, sizeof((const uint8_t[]){__VA_ARGS__}), now_us)

/* All four PDOs of a SYNC: l = 0.05 * n m/s^2, roll = n deg, at rest. */
static void sample(uint8_t n, uint64_t now_us)
{
	unsigned int roll = 100u * n;

	FRAME(0x080, now_us, 0);
	FRAME(0x185, now_us, (uint8_t)(10 * n), 0, 0xFE, 0xFF, 0, 0, n, 0);
	FRAME(0x285, now_us, (uint8_t)roll, (uint8_t)(roll >> 8), 0, 0, 0, 0, n, 0);
	FRAME(0x385, now_us, 0xE8, 0x03, 0, 0, 0, 0, n, 0);
	FRAME(0x485, now_us, 0x03, 0, n, 0, 0, 0, 0, 0);
	history_add(&history, &watch);
}

static void draw(int columns, int rows)
{
	cells.columns = columns;
	cells.rows = rows;
	screen_draw(&screen, &cells);
}

static const char *row(int number)
{
	static char text[4 * SCREEN_COLUMNS];

	screen_row_text(&cells, number, text, sizeof(text));
	return text;
}

/* The first row that begins with it, or -1. */
static int find_row(const char *begin)
{
	for (int i = 0; i < cells.rows; i++)
		if (strncmp(row(i), begin, strlen(begin)) == 0)
			return i;
	return -1;
}

/* Whether it is anywhere. */
static bool shows(const char *text)
{
	for (int i = 0; i < cells.rows; i++)
		if (strstr(row(i), text))
			return true;
	return false;
}

static void assert_row_begins(int number, const char *text)
{
	if (strncmp(row(number), text, strlen(text)) != 0)
		fail_msg("row %d is '%s', not '%s'", number, row(number), text);
}

static void test_values_have_units_and_a_sparkline(void **state)
{
	(void)state;
	node_begins();
	for (uint8_t n = 1; n <= 8; n++)
		sample(n, (uint64_t)(1 + n) * SECOND / 10);
	draw(80, 24);
	assert_row_begins(0, "node 5: operational");
	assert_row_begins(1, "SYNC 10.0 Hz");
	assert_row_begins(2, "EMCY none");
	assert_row_begins(4, "TPDO1  185h  10.0 Hz  8 received, sample 8");
	assert_row_begins(5, "  acceleration.l            0.400            m/s^2   "
			     "\u2581\u2582\u2583\u2584\u2585\u2586\u2587\u2588");
	assert_row_begins(6, "  acceleration.s           -0.010            m/s^2   \u2584\u2584");
	assert_row_begins(find_row("TPDO2") + 1, "  angles.roll                8.00            deg");
	assert_row_begins(find_row("TPDO4") + 1, "  sample.status        valid,rest");
	screen.ascii = true;
	draw(80, 24);
	assert_row_begins(5, "  acceleration.l            0.400            m/s^2   _.,-~=^\"");
}

static void test_a_rate_is_shown_when_it_was_measured(void **state)
{
	(void)state;
	node_begins();
	sample(1, SECOND);
	draw(80, 24);
	assert_row_begins(1, "SYNC once; PDO mapping");
	assert_row_begins(4, "TPDO1  185h  1 received, sample 1");
	assert_false(shows("Hz"));
}

static void test_a_long_name_of_the_bus_hides_neither_state_nor_heartbeat(void **state)
{
	(void)state;
	node_begins();
	screen.bus_name = "udp:239.74.163.97:43197,interface=lo";
	FRAME(0x705, SECOND, 5);
	sample(1, SECOND + SECOND / 2);
	draw(60, 15);
	assert_row_begins(0, "node 5: operational, heartbeat 0.5 s ago");
}

static void test_a_value_has_the_sigma_of_its_axis_beside_it(void **state)
{
	static const struct watch_polled SIGMAS[] = {{OD_INDEX_POSITION_SIGMA, 1, 0.25, 1},
		{OD_INDEX_POSITION_SIGMA, 3, 0.5, 1}, {OD_INDEX_ATTITUDE_SIGMA, 1, 0.3, 1},
		{OD_INDEX_ATTITUDE_SIGMA, 2, 0.4, 1}, {OD_INDEX_ATTITUDE_SIGMA, 3, 2.5, 1}};

	(void)state;
	node_begins();
	sample(1, SECOND);
	memset(watch.polled, 0, sizeof(watch.polled));
	memcpy(watch.polled, SIGMAS, sizeof(SIGMAS));
	draw(80, 24);
	assert_row_begins(find_row("  position_output.x"), "  position_output.x         1.000 \u00B10.25      m");
	assert_row_begins(find_row("  position_output.y"), "  position_output.y         0.000            m");
	assert_row_begins(find_row("  angles.pitch"), "  angles.pitch               0.00 \u00B10.4       deg");
	assert_row_begins(find_row("  angles.yaw"), "  angles.yaw                 0.00 \u00B12.5       deg");
}

static void test_a_lost_node_is_grey_with_its_age(void **state)
{
	(void)state;
	node_begins();
	FRAME(0x705, SECOND, 5);
	sample(1, SECOND);
	screen.now_us = SECOND * 25 / 2;
	draw(80, 24);
	assert_row_begins(0, "node 5: lost for 11.5 s, on can0");
	assert_row_begins(4, "TPDO1  185h  1 received, the last 11.5 s ago");
	for (int column = 0; column < 30; column++)
		if (cells.cell[5][column].glyph)
			assert_int_equal(cells.cell[5][column].style, SCREEN_GREY);
	assert_int_equal(cells.cell[0][0].style, SCREEN_ALARM);
}

static void test_a_small_terminal_has_pages_below_the_same_header(void **state)
{
	char header[3][4 * SCREEN_COLUMNS];

	(void)state;
	node_begins();
	for (uint8_t n = 1; n <= 3; n++)
		sample(n, n * SECOND / 10);
	draw(60, 15);
	assert_true(cells.pages >= 2);
	assert_true(strstr(row(0), "page 1/") != NULL);
	assert_true(find_row("TPDO1") == 4 && find_row("TPDO3") == -1);
	for (int i = 1; i < 3; i++)
		strcpy(header[i], row(i));
	screen.page = 1;
	draw(60, 15);
	assert_true(strstr(row(0), "page 2/") != NULL);
	assert_true(find_row("TPDO1") == -1 && find_row("TPDO3") == 4);
	for (int i = 1; i < 3; i++)
		assert_string_equal(row(i), header[i]);
	screen.page = cells.pages; /* beyond the last one: the first again */
	draw(60, 15);
	assert_int_equal(find_row("TPDO1"), 4);
}

static void test_every_pdo_is_on_one_of_the_pages_of_every_size(void **state)
{
	static const int SIZES[][2] = {{80, 24}, {60, 15}, {200, 50}, {20, 5}, {1, 1}, {132, 20}, {320, 100}};

	(void)state;
	node_begins();
	sample(1, SECOND);
	for (size_t i = 0; i < sizeof(SIZES) / sizeof(SIZES[0]); i++) {
		int found = 0;

		screen.page = 0;
		do {
			draw(SIZES[i][0], SIZES[i][1]);
			for (int n = 1; n <= 4; n++) {
				char name[8];

				snprintf(name, sizeof(name), "TPDO%d", n);
				found += shows(name);
			}
		} while (++screen.page < cells.pages);
		if (SIZES[i][0] >= 20 && SIZES[i][1] >= 5)
			assert_int_equal(found, 4);
	}
}

static void test_a_wide_terminal_has_a_second_column_when_one_is_not_enough(void **state)
{
	(void)state;
	node_begins();
	sample(1, SECOND);
	draw(200, 50);
	assert_int_equal(cells.pages, 1);
	assert_true(find_row("TPDO4") > find_row("TPDO1")); /* one column has room for all */
	draw(200, 16);
	assert_true(strstr(row(4), "TPDO1") == row(4) && strstr(row(4), "TPDO3"));
}

static void test_numbers_are_left_out_rather_than_cut(void **state)
{
	(void)state;
	node_begins();
	for (uint8_t n = 0; n < 5; n++)
		sample((uint8_t)(50 * n), (uint64_t)(n + 1) * SECOND / 10);
	for (int columns = 20; columns < 80; columns++) {
		char *at;

		draw(columns, 40);
		if ((at = strstr(row(4), "sample")))
			assert_string_equal(at, "sample 200");
		if ((at = strstr(row(4), "skipped")))
			assert_string_equal(strstr(row(4), "19") ? "196" : "", "196");
	}
}

static void test_the_horizon_leans_with_roll_and_rises_with_the_nose_down(void **state)
{
	static const uint8_t LEVEL[8] = {0}, ROLLED[8] = {0x94, 0x11}, DOWN[8] = {0, 0, 0xD0, 0x07}; /* 45, 20 deg */
	int first;

	(void)state;
	node_begins();
	frame(0x285, LEVEL, 8, SECOND);
	draw(80, 40);
	first = find_row("attitude") + 1;
	assert_string_equal(row(first + 2), "  |                         |");
	assert_string_equal(row(first + 3), "  |------------+------------|");
	assert_string_equal(row(first + 4), "  |:::::::::::::::::::::::::|");
	frame(0x285, DOWN, 8, SECOND); /* positive pitch: l points down, the horizon is seen above the middle */
	draw(80, 40);
	assert_string_equal(row(first + 1), "  |-------------------------|");
	frame(0x285, ROLLED, 8, SECOND); /* positive roll: the left side up, so the ground is at the right */
	draw(80, 40);
	assert_int_equal(row(first)[3], ' ');
	assert_int_equal(row(first + 6)[3 + 24], ':');
	assert_int_equal(row(first + 3)[3], ' ');
	assert_int_equal(row(first + 3)[3 + 24], ':');
}

static void test_the_compass_points_where_yaw_says(void **state)
{
	static const struct {
		uint8_t yaw[2];
		char letter;
	} CASES[] = {{{0x00, 0x00}, 'E'}, {{0x28, 0x23}, 'N'}, {{0xD8, 0xDC}, 'S'}, {{0x50, 0x46}, 'W'}};

	(void)state;
	for (size_t i = 0; i < sizeof(CASES) / sizeof(CASES[0]); i++) {
		uint8_t data[8] = {0, 0, 0, 0, CASES[i].yaw[0], CASES[i].yaw[1]};

		node_begins();
		frame(0x285, data, 8, SECOND);
		draw(80, 40);
		assert_int_equal(row(find_row("attitude") + 8)[3 + 12], CASES[i].letter);
	}
}

static void test_emergencies_are_listed_and_the_latest_is_in_the_header(void **state)
{
	(void)state;
	node_begins();
	sample(1, SECOND);
	FRAME(0x085, SECOND, 0x20, 0x81, 0x11, 0, 0, 0, 0, 0);
	draw(80, 50);
	assert_row_begins(2, "EMCY 8120h: ");
	assert_int_equal(cells.cell[2][0].style, SCREEN_ALARM);
	FRAME(0x085, 2 * SECOND, 0, 0, 0, 0, 0, 0, 0, 0);
	draw(80, 50);
	assert_row_begins(2, "EMCY 0000h: ");
	assert_int_equal(cells.cell[2][0].style, SCREEN_PLAIN);
	assert_row_begins(find_row("emergencies: 2") + 2, "  EMCY 8120h: ");
}

static void test_keys_hint_event_log_and_the_result_of_a_command_are_shown(void **state)
{
	(void)state;
	node_begins();
	screen.hint = "no PDO yet: a reason";
	strcpy(watch.message, "tare: done");
	strcpy(watch.events, "      0.000000 started\n      1.000000 NMT state\n");
	screen.events = true;
	draw(80, 40);
	assert_row_begins(4, "no PDO yet: a reason");
	assert_true(strstr(row(2), "tare: done") != NULL);
	assert_row_begins(find_row("event log") + 2, "      1.000000 NMT state");
	screen.help = true;
	draw(80, 40);
	assert_true(shows("  q        end"));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_long_name_of_the_bus_hides_neither_state_nor_heartbeat),
		cmocka_unit_test(test_values_have_units_and_a_sparkline),
		cmocka_unit_test(test_a_rate_is_shown_when_it_was_measured),
		cmocka_unit_test(test_a_value_has_the_sigma_of_its_axis_beside_it),
		cmocka_unit_test(test_a_lost_node_is_grey_with_its_age),
		cmocka_unit_test(test_a_small_terminal_has_pages_below_the_same_header),
		cmocka_unit_test(test_every_pdo_is_on_one_of_the_pages_of_every_size),
		cmocka_unit_test(test_a_wide_terminal_has_a_second_column_when_one_is_not_enough),
		cmocka_unit_test(test_numbers_are_left_out_rather_than_cut),
		cmocka_unit_test(test_the_horizon_leans_with_roll_and_rises_with_the_nose_down),
		cmocka_unit_test(test_the_compass_points_where_yaw_says),
		cmocka_unit_test(test_emergencies_are_listed_and_the_latest_is_in_the_header),
		cmocka_unit_test(test_keys_hint_event_log_and_the_result_of_a_command_are_shown),
	};

	return cmocka_run_group_tests_name("monitor screen", tests, NULL, NULL);
}
