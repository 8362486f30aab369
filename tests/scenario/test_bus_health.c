/* Diagnosis of the bus by the whole device in simulated time: load, faults, restarts after bus-off. The port is a fake.
 * */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/bus_health.h"
#include "gateway/canopen/node.h"

enum { NODE_ID = 16, SECOND = 1000000 };

struct world {
	struct can_port bus;
	struct od od;
	struct od_values values;
	struct canopen_node node;
	struct event_log log;
	struct bus_health health;
	uint64_t now_us, deadline_us;
	struct can_traffic traffic; /* the counters of the interface */
	int restart_answer, bit_rate_answer;
	unsigned looks, restarts;
	uint64_t restarted_us[32];
	uint32_t set_bit_s;
	uint16_t emcy[32]; /* codes, in order */
	size_t emcy_count;
};

static struct world *of(struct can_port *port)
{
	return (struct world *)(void *)port;
}

static int take_frame(struct can_port *port, const struct can_msg *msg)
{
	struct world *w = of(port);

	if (msg->id == 0x080 + NODE_ID && w->emcy_count < 32)
		w->emcy[w->emcy_count++] = (uint16_t)(msg->data[0] | msg->data[1] << 8);
	return 0;
}

static int take_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port, (void)ids, (void)n;
	return 0;
}

static void look(struct can_port *port)
{
	port->traffic = of(port)->traffic;
	of(port)->looks++;
}

/* Error active at once when a restart is permitted. */
static int restart(struct can_port *port)
{
	struct world *w = of(port);

	w->restarted_us[w->restarts++ % 32] = w->now_us;
	if (w->restart_answer == 0)
		port->state = CAN_STATE_ACTIVE;
	return w->restart_answer;
}

static int bit_rate(struct can_port *port, uint32_t bit_s, bool dry_run)
{
	struct world *w = of(port);

	if (w->bit_rate_answer == 0 && !dry_run)
		w->set_bit_s = bit_s;
	return w->bit_rate_answer;
}

static void tick(struct world *w)
{
	w->deadline_us = bus_health_tick(&w->health, w->now_us);
	canopen_tick(&w->node, w->now_us);
}

static void run(struct world *w, uint64_t us)
{
	uint64_t end_us = w->now_us + us;

	while (w->deadline_us <= end_us) {
		assert_true(w->deadline_us > w->now_us);
		w->now_us = w->deadline_us;
		tick(w);
	}
	w->now_us = end_us;
	tick(w);
}

static int set_up(void **state)
{
	static const struct can_ops ops = {
		.send = take_frame, .filter = take_filter, .refresh = look, .restart = restart, .bit_rate = bit_rate};
	struct world *w = calloc(1, sizeof(*w));

	assert_non_null(w);
	w->bus = (struct can_port){.ops = &ops, .bit_s = 250000, .name = "can0"};
	w->now_us = SECOND;
	od_init(&w->od, &imu9_od_table, &w->values, NODE_ID);
	w->values.inhibit_time_emcy = 0; /* each EMCY at once */
	bus_health_init(&w->health, &w->bus, &w->node, &w->od, &w->log);
	assert_int_equal(canopen_init(&w->node, &w->od, &w->bus, NULL, NODE_ID), 0);
	canopen_start(&w->node, w->now_us);
	tick(w);
	*state = w;
	return 0;
}

static int tear_down(void **state)
{
	free(*state);
	return 0;
}

static void set_state(struct world *w, enum can_state bus_state)
{
	w->bus.state = bus_state;
	tick(w);
}

static unsigned emcy_count(const struct world *w, uint16_t code)
{
	unsigned n = 0;

	for (size_t i = 0; i < w->emcy_count; i++)
		n += w->emcy[i] == code;
	return n;
}

/* ---- load -------------------------------------------------------------------------------------------------------- */

/* 8 bytes: 111 bits, and at most 24 stuff bits (for 34 + 64 bits): half of these, rounded down. */
static void test_a_frame_of_8_bytes_is_counted_with_half_its_stuff_bits(void **state)
{
	(void)state;
	assert_int_equal(bus_health_bits(1, 8), 111 + 12);
	assert_int_equal(bus_health_bits(1, 0), 47 + 4);
	assert_int_equal(bus_health_bits(1000, 8000), 123250);
}

static void test_the_load_is_that_of_the_last_second_in_permille(void **state)
{
	struct world *w = *state;

	w->traffic = (struct can_traffic){1000, 8000}; /* 123250 bits of 250000 */
	run(w, SECOND);
	assert_int_equal(w->values.bus_health.load, 493);
	run(w, SECOND);
	assert_int_equal(w->values.bus_health.load, 0);
	assert_int_equal(w->values.bus_health.highest_load, 493);
	bus_health_reset(&w->health);
	assert_int_equal(w->values.bus_health.highest_load, 0);
}

static void test_the_bus_is_looked_at_with_the_first_tick_and_each_second(void **state)
{
	struct world *w = *state;

	bus_health_init(&w->health, &w->bus, &w->node, &w->od, &w->log);
	w->looks = 0;
	w->now_us = 1; /* the host has just started */
	tick(w);
	assert_int_equal(w->looks, 1);
	w->now_us = SECOND;
	tick(w);
	assert_int_equal(w->looks, 1);
	w->now_us = SECOND + 1;
	tick(w);
	assert_int_equal(w->looks, 2);
}

static void test_without_a_bit_rate_there_is_no_load(void **state)
{
	struct world *w = *state;

	w->bus.bit_s = 0;
	w->traffic = (struct can_traffic){1000, 8000};
	run(w, SECOND);
	assert_int_equal(w->values.bus_health.load, 0);
}

static void test_counters_that_restart_at_zero_are_no_load(void **state)
{
	struct world *w = *state;

	w->traffic = (struct can_traffic){1000, 8000};
	run(w, SECOND);
	w->traffic = (struct can_traffic){10, 80};
	run(w, SECOND);
	assert_int_equal(w->values.bus_health.load, 0);
}

static void test_state_error_counters_and_bit_rate_are_objects(void **state)
{
	struct world *w = *state;

	w->bus.tx_errors = 130;
	w->bus.rx_errors = 7;
	set_state(w, CAN_STATE_PASSIVE);
	assert_int_equal(w->values.bus_health.state, 2);
	assert_int_equal(w->values.bus_health.tx_error_counter, 130);
	assert_int_equal(w->values.bus_health.rx_error_counter, 7);
	assert_int_equal(w->values.bus_health.bit_rate, 250000);
}

/* ---- faults ------------------------------------------------------------------------------------------------------ */

static void test_a_controller_that_is_error_passive_at_the_start_raises_8120h(void **state)
{
	struct world *w = *state;

	set_state(w, CAN_STATE_PASSIVE);
	assert_int_equal(emcy_count(w, 0x8120), 1);
	set_state(w, CAN_STATE_WARNING);
	assert_int_equal(emcy_count(w, 0x0000), 1);
}

static void test_error_passive_that_ended_in_bus_off_is_over_when_the_controller_is_error_active(void **state)
{
	struct world *w = *state;

	set_state(w, CAN_STATE_PASSIVE);
	set_state(w, CAN_STATE_BUS_OFF);
	assert_int_equal(emcy_count(w, 0x0000), 0);
	run(w, 2 * SECOND);
	assert_int_equal(w->values.bus_health.state, 0);
	assert_int_equal(emcy_count(w, 0x0000), 1);
	assert_int_equal(w->values.error_register, 0);
}

static void test_after_bus_off_the_controller_is_restarted_after_the_delay_and_8140h_is_sent(void **state)
{
	struct world *w = *state;

	set_state(w, CAN_STATE_BUS_OFF);
	run(w, 99999);
	assert_int_equal(w->restarts, 0);
	run(w, 1);
	assert_int_equal(w->restarts, 1);
	run(w, SECOND);
	assert_int_equal(emcy_count(w, 0x8140), 1);
	assert_int_equal(w->values.bus_health.restarts, 1);
	assert_int_equal(w->values.bus_health.state, 0);
}

static void go_off(struct world *w, unsigned times)
{
	while (times-- > 0) {
		unsigned before = w->restarts;

		set_state(w, CAN_STATE_BUS_OFF);
		for (int i = 0; i < 100 && w->restarts == before; i++)
			run(w, SECOND);
	}
}

static void test_each_restart_in_a_row_doubles_the_delay_up_to_a_minute(void **state)
{
	struct world *w = *state;

	for (unsigned i = 0; i < 12; i++) {
		uint64_t off_us = w->now_us, expected_ms = i < 10 ? 100u << i : 60000;

		set_state(w, CAN_STATE_BUS_OFF);
		run(w, 60 * SECOND);
		assert_int_equal(w->restarts, i + 1);
		assert_int_equal(w->restarted_us[i] - off_us, (expected_ms < 60000 ? expected_ms : 60000) * 1000);
		w->now_us = w->restarted_us[i] + 1; /* bus-off again at once */
		w->deadline_us = w->now_us + 1;
	}
}

static void test_a_delay_of_a_millisecond_grows_to_a_minute_too(void **state)
{
	struct world *w = *state;

	w->values.bus_health.restart_delay = 1;
	for (unsigned i = 0; i < 19; i++) {
		uint64_t off_us = w->now_us;

		set_state(w, CAN_STATE_BUS_OFF);
		run(w, 60 * SECOND);
		assert_int_equal(w->restarted_us[i] - off_us, i < 16 ? 1000u << i : 60000000);
		w->now_us = w->restarted_us[i] + 1; /* bus-off again at once */
		w->deadline_us = w->now_us + 1;
	}
}

static void test_a_minute_without_bus_off_resets_the_delay(void **state)
{
	struct world *w = *state;

	go_off(w, 3);
	run(w, 60 * SECOND);
	uint64_t off_us = w->now_us;
	go_off(w, 1);
	assert_int_equal(w->restarted_us[3] - off_us, 100000);
}

static void test_beyond_the_limit_the_controller_stays_bus_off_until_the_command(void **state)
{
	struct world *w = *state;

	w->values.bus_health.restart_limit = 2;
	go_off(w, 2);
	set_state(w, CAN_STATE_BUS_OFF);
	run(w, 3600ul * SECOND);
	assert_int_equal(w->restarts, 2);
	assert_int_equal(od_write(&w->od, 0x2122, 11, "\x01", 1), OD_OK);
	tick(w);
	assert_int_equal(w->restarts, 3);
}

static void test_a_delay_of_0_leaves_bus_off_to_the_kernel(void **state)
{
	struct world *w = *state;

	w->values.bus_health.restart_delay = 0;
	set_state(w, CAN_STATE_BUS_OFF);
	run(w, 3600ul * SECOND);
	assert_int_equal(w->restarts, 0);
	set_state(w, CAN_STATE_ACTIVE); /* by the kernel */
	assert_int_equal(emcy_count(w, 0x8140), 1);
}

static void test_without_permission_one_restart_is_attempted(void **state)
{
	struct world *w = *state;

	w->restart_answer = -EPERM;
	set_state(w, CAN_STATE_BUS_OFF);
	run(w, 3600ul * SECOND);
	assert_int_equal(w->restarts, 1);
	assert_int_equal(w->values.bus_health.restarts, 0);
}

static void test_a_failed_restart_is_repeated_later(void **state)
{
	struct world *w = *state;
	uint64_t off_us = w->now_us;

	w->restart_answer = -EIO;
	set_state(w, CAN_STATE_BUS_OFF);
	run(w, SECOND);
	assert_int_equal(w->restarts, 3);
	assert_int_equal(w->restarted_us[1] - off_us, 300000);
	assert_int_equal(w->restarted_us[2] - off_us, 700000);
}

static void test_the_command_is_refused_unless_the_controller_is_bus_off(void **state)
{
	struct world *w = *state;

	assert_int_equal(od_write(&w->od, 0x2122, 11, "\x01", 1), OD_DEVICE_STATE);
	assert_int_equal(od_write(&w->od, 0x2122, 11, "\x02", 1), OD_BAD_VALUE);
}

static void test_an_interface_that_goes_down_after_bus_off_has_not_recovered(void **state)
{
	struct world *w = *state;

	w->values.bus_health.restart_delay = 0;
	set_state(w, CAN_STATE_BUS_OFF);
	set_state(w, CAN_STATE_DOWN);
	assert_int_equal(emcy_count(w, 0x8140), 0);
	set_state(w, CAN_STATE_ACTIVE);
	assert_int_equal(emcy_count(w, 0x8140), 1);
}

static void test_emcys_of_the_time_when_the_interface_is_down_are_sent_when_it_is_up(void **state)
{
	struct world *w = *state;

	canopen_error_set(&w->node, 0xFF00, 0x81, NULL, w->now_us);
	set_state(w, CAN_STATE_DOWN);
	canopen_error_clear(&w->node, 0xFF00, w->now_us);
	assert_int_equal(emcy_count(w, 0x0000), 0);
	set_state(w, CAN_STATE_ACTIVE);
	run(w, SECOND);
	assert_int_equal(emcy_count(w, 0xFF00), 1);
	assert_int_equal(emcy_count(w, 0x0000), 1);
}

static void test_a_restart_due_while_the_interface_is_down_waits_without_busy_polling(void **state)
{
	struct world *w = *state;

	set_state(w, CAN_STATE_BUS_OFF);
	set_state(w, CAN_STATE_DOWN);
	run(w, SECOND); /* asserts that each deadline is in the future */
	assert_int_equal(w->restarts, 0);
	set_state(w, CAN_STATE_BUS_OFF);
	run(w, SECOND);
	assert_int_equal(w->restarts, 1);
}

/* ---- bit rate ---------------------------------------------------------------------------------------------------- */

static void test_a_bit_rate_that_is_unsupported_or_not_permitted_is_not_possible(void **state)
{
	struct world *w = *state;

	w->bit_rate_answer = -EOPNOTSUPP;
	assert_false(bus_health_bit_rate_possible(&w->health, 125000));
	w->bit_rate_answer = -EPERM;
	assert_false(bus_health_bit_rate_possible(&w->health, 125000));
	w->bit_rate_answer = 0;
	assert_true(bus_health_bit_rate_possible(&w->health, 125000));
	assert_int_equal(w->set_bit_s, 0);
	bus_health_set_bit_rate(&w->health, 125000);
	assert_int_equal(w->set_bit_s, 125000);
}

#define TEST(f) cmocka_unit_test_setup_teardown(f, set_up, tear_down)

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_frame_of_8_bytes_is_counted_with_half_its_stuff_bits),
		TEST(test_the_load_is_that_of_the_last_second_in_permille),
		TEST(test_the_bus_is_looked_at_with_the_first_tick_and_each_second),
		TEST(test_without_a_bit_rate_there_is_no_load),
		TEST(test_counters_that_restart_at_zero_are_no_load),
		TEST(test_state_error_counters_and_bit_rate_are_objects),
		TEST(test_a_controller_that_is_error_passive_at_the_start_raises_8120h),
		TEST(test_error_passive_that_ended_in_bus_off_is_over_when_the_controller_is_error_active),
		TEST(test_after_bus_off_the_controller_is_restarted_after_the_delay_and_8140h_is_sent),
		TEST(test_each_restart_in_a_row_doubles_the_delay_up_to_a_minute),
		TEST(test_a_delay_of_a_millisecond_grows_to_a_minute_too),
		TEST(test_a_minute_without_bus_off_resets_the_delay),
		TEST(test_beyond_the_limit_the_controller_stays_bus_off_until_the_command),
		TEST(test_a_delay_of_0_leaves_bus_off_to_the_kernel),
		TEST(test_without_permission_one_restart_is_attempted),
		TEST(test_a_failed_restart_is_repeated_later),
		TEST(test_the_command_is_refused_unless_the_controller_is_bus_off),
		TEST(test_an_interface_that_goes_down_after_bus_off_has_not_recovered),
		TEST(test_emcys_of_the_time_when_the_interface_is_down_are_sent_when_it_is_up),
		TEST(test_a_restart_due_while_the_interface_is_down_waits_without_busy_polling),
		TEST(test_a_bit_rate_that_is_unsupported_or_not_permitted_is_not_possible),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
