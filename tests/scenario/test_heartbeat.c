/* Heartbeat consumer (1016h) and node guarding (100Ch, 100Dh): CiA 301, 7.2.8.3.2 and 7.5.2. */
#include "tests/scenario/bus.h"

#include <stdio.h>

/* Consumes the heartbeat of node 20h with 100 ms, and receives the first one. */
static void consume(struct bus *bus)
{
	assert_int_equal(bus_write(bus, 0x1016, 1, 4, 0x00200064), 0);
	bus_send(bus, "720 05");
}

static void test_a_heartbeat_event_reports_the_node_id_of_the_producer(void **state)
{
	struct bus *bus = *state;

	consume(bus);
	bus_run(bus, 99999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "090 30 81 11 20 00 00 00 00");
	bus_expect_nothing(bus);
	assert_int_equal(bus_read(bus, 0x1001, 0), 0x11);
}

static void test_a_consumer_starts_with_the_first_heartbeat_and_not_before(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1016, 1, 4, 0x00200064), 0);
	bus_run(bus, 10000000);
	bus_expect_nothing(bus);
}

static void test_boot_up_counts_as_a_heartbeat_of_the_producer(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1016, 1, 4, 0x00200064), 0);
	bus_send(bus, "720 00");
	bus_run(bus, 100000);
	bus_expect(bus, "090 30 81 11 20 00 00 00 00");
}

static void test_each_heartbeat_restarts_the_consumer_time(void **state)
{
	struct bus *bus = *state;

	consume(bus);
	for (int i = 0; i < 10; i++) {
		bus_run(bus, 99999);
		bus_send(bus, "720 7F");
	}
	bus_expect_nothing(bus);
}

static void test_the_next_heartbeat_ends_the_error_and_restarts_the_consumer(void **state)
{
	struct bus *bus = *state;

	consume(bus);
	bus_run(bus, 5000000);
	bus_expect(bus, "090 30 81 11 20 00 00 00 00");
	bus_exchange(bus, "720 05", "090 00 00 00 00 00 00 00 00");
	bus_run(bus, 100000);
	bus_expect(bus, "090 30 81 11 20 00 00 00 00");
}

static void test_each_lost_node_is_reported_and_the_last_one_that_returns_ends_the_error(void **state)
{
	struct bus *bus = *state;

	consume(bus);
	assert_int_equal(bus_write(bus, 0x1016, 8, 4, 0x007F0064), 0);
	bus_send(bus, "77F 05");
	bus_run(bus, 100000);
	bus_expect(bus, "090 30 81 11 20 00 00 00 00");
	bus_expect(bus, "090 30 81 11 7F 00 00 00 00");
	bus_send(bus, "720 05");
	bus_expect_nothing(bus);
	bus_exchange(bus, "77F 05", "090 00 00 00 00 00 00 00 00");
}

static void test_eight_producers_are_consumed_at_once(void **state)
{
	struct bus *bus = *state;
	char frame[32];

	for (uint8_t i = 0; i < 8; i++) {
		assert_int_equal(bus_write(bus, 0x1016, i + 1, 4, (0x20u + i) << 16 | (100u + i)), 0);
		snprintf(frame, sizeof(frame), "%03X 05", 0x720u + i);
		bus_send(bus, frame);
	}
	assert_int_equal(bus_write(bus, 0x1016, 9, 4, 0), 0x06090011);
	for (uint8_t i = 0; i < 8; i++) {
		bus_run(bus, i ? 1000 : 100000);
		snprintf(frame, sizeof(frame), "090 30 81 11 %02X 00 00 00 00", 0x20u + i);
		bus_expect(bus, frame);
	}
	bus_expect_nothing(bus);
}

static void test_a_heartbeat_event_leaves_operational(void **state)
{
	struct bus *bus = *state;

	consume(bus);
	bus_run(bus, 100000);
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
}

static void test_a_heartbeat_event_is_sent_before_the_node_stops(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1029, 1, 1, 2), 0);
	consume(bus);
	bus_run(bus, 100000);
	bus_expect(bus, "090 30 81 11 20 00 00 00 00");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_STOPPED);
}

static void test_in_stopped_the_consumer_continues(void **state)
{
	struct bus *bus = *state;

	consume(bus);
	bus_send(bus, "000 02 10");
	bus_run(bus, 100000);
	bus_expect_nothing(bus);
	bus_exchange(bus, "000 80 10", "090 30 81 11 20 00 00 00 00");
}

static void test_a_second_entry_for_the_same_node_is_refused(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1016, 1, 4, 0x00200064), 0);
	assert_int_equal(bus_write(bus, 0x1016, 2, 4, 0x002000C8), 0x06040043);
	assert_int_equal(bus_read(bus, 0x1016, 2), 0);
}

static void test_a_second_entry_with_time_0_may_have_the_same_node_id(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1016, 1, 4, 0x00200064), 0);
	assert_int_equal(bus_write(bus, 0x1016, 2, 4, 0x00200000), 0);
}

static void test_the_time_of_an_entry_may_change(void **state)
{
	struct bus *bus = *state;

	consume(bus);
	assert_int_equal(bus_write(bus, 0x1016, 1, 4, 0x002000C8), 0);
	bus_send(bus, "720 05");
	bus_run(bus, 199999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "090 30 81 11 20 00 00 00 00");
}

static void test_reserved_bits_and_node_ids_above_127_are_refused(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1016, 1, 4, 0x01200064), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1016, 1, 4, 0x00800064), 0x06090030);
}

static void test_an_entry_set_to_0_stops_its_consumer_and_ends_its_error(void **state)
{
	struct bus *bus = *state;

	consume(bus);
	bus_run(bus, 100000);
	bus_expect(bus, "090 30 81 11 20 00 00 00 00");
	bus_send(bus, "610 23 16 10 01 00 00 00 00");
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
	bus_expect(bus, "590 60 16 10 01 00 00 00 00");
	bus_send(bus, "720 05");
	bus_run(bus, 10000000);
	bus_expect_nothing(bus);
}

static void test_the_receive_filter_has_the_heartbeats_of_the_producers(void **state)
{
	struct bus *bus = *state;

	consume(bus);
	assert_int_equal(bus->filter_count, 16);
	assert_true(bus_listens_to(bus, 0x720));
}

static void test_reset_communication_stops_the_consumer_and_ends_the_error(void **state)
{
	struct bus *bus = *state;

	consume(bus);
	bus_run(bus, 100000);
	bus_expect(bus, "090 30 81 11 20 00 00 00 00");
	bus_reset(bus, "000 82 10", "710 00");
	assert_int_equal(bus_read(bus, 0x1001, 0), 0);
	bus_send(bus, "720 05");
	bus_run(bus, 10000000);
	bus_expect_nothing(bus);
}

static void test_of_two_stored_entries_for_one_node_the_first_is_used(void **state)
{
	struct bus *bus = bus_new();

	bus_put(bus, 0x1016, 3, 4, 0x00200064);
	bus_put(bus, 0x1016, 5, 4, 0x00200010);
	bus_start(bus);
	bus_expect(bus, "710 00");
	bus_expect(bus, "090 00 63 01 16 10 00 00 00");
	bus_send(bus, "720 05");
	bus_run(bus, 99999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "090 30 81 11 20 00 00 00 00");
	test_free(bus);
	(void)state;
}

static void test_a_heartbeat_of_wrong_length_is_ignored(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1016, 1, 4, 0x00200064), 0);
	bus_send(bus, "720");
	bus_send(bus, "720 05 00");
	bus_run(bus, 10000000);
	bus_expect_nothing(bus);
}

/* ---- node guarding ----------------------------------------------------------------------------------------------- */

static void test_guarding_is_answered_with_the_state_and_a_toggle_bit(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "710 R", "710 7F");
	bus_exchange(bus, "710 R", "710 FF");
	bus_exchange(bus, "710 R", "710 7F");
	bus_send(bus, "000 01 10");
	bus_exchange(bus, "710 R", "710 85");
	bus_send(bus, "000 02 10");
	bus_exchange(bus, "710 R", "710 04");
}

static void test_reset_communication_clears_the_toggle_bit(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "710 R", "710 7F");
	bus_reset(bus, "000 82 10", "710 00");
	bus_exchange(bus, "710 R", "710 7F");
}

static void test_guarding_of_another_node_is_not_answered(void **state)
{
	bus_send(*state, "711 R");
	bus_expect_nothing(*state);
}

static void test_a_node_with_a_heartbeat_answers_guarding_and_has_no_life_guarding(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1017, 0, 2, 60000), 0);
	assert_int_equal(bus_write(bus, 0x100C, 0, 2, 100), 0);
	assert_int_equal(bus_write(bus, 0x100D, 0, 1, 3), 0);
	bus_exchange(bus, "710 R", "710 7F");
	bus_exchange(bus, "710 R", "710 FF");
	bus_run(bus, 10000000);
	bus_expect_nothing(bus);
}

/* Life time: 3 times 100 ms. */
static void guard_life(struct bus *bus)
{
	assert_int_equal(bus_write(bus, 0x100C, 0, 2, 100), 0);
	assert_int_equal(bus_write(bus, 0x100D, 0, 1, 3), 0);
}

static void test_a_master_that_stops_its_requests_is_a_life_guarding_event(void **state)
{
	struct bus *bus = *state;

	guard_life(bus);
	bus_exchange(bus, "710 R", "710 05");
	bus_run(bus, 299999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "090 30 81 11 00 00 00 00 00");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
}

static void test_life_guarding_starts_with_the_first_request(void **state)
{
	struct bus *bus = *state;

	guard_life(bus);
	bus_run(bus, 10000000);
	bus_expect_nothing(bus);
}

static void test_the_next_request_ends_a_life_guarding_event(void **state)
{
	struct bus *bus = *state;

	guard_life(bus);
	bus_exchange(bus, "710 R", "710 7F");
	bus_run(bus, 10000000);
	bus_expect(bus, "090 30 81 11 00 00 00 00 00");
	bus_send(bus, "710 R");
	bus_expect(bus, "710 FF");
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
	bus_expect_nothing(bus);
}

static void test_without_a_life_time_there_is_no_life_guarding(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x100C, 0, 2, 100), 0);
	bus_exchange(bus, "710 R", "710 7F");
	bus_run(bus, 100000000);
	bus_expect_nothing(bus);
}

static void test_enabling_the_heartbeat_ends_life_guarding(void **state)
{
	struct bus *bus = *state;

	guard_life(bus);
	bus_exchange(bus, "710 R", "710 7F");
	assert_int_equal(bus_write(bus, 0x1017, 0, 2, 60000), 0);
	bus_run(bus, 10000000);
	bus_expect_nothing(bus);
}

static void test_enabling_the_heartbeat_ends_the_error_of_life_guarding(void **state)
{
	struct bus *bus = *state;

	guard_life(bus);
	bus_exchange(bus, "710 R", "710 7F");
	bus_run(bus, 300000);
	bus_expect(bus, "090 30 81 11 00 00 00 00 00");
	assert_int_equal(bus_write(bus, 0x1017, 0, 2, 60000), 0);
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		PRE_OPERATIONAL(test_a_heartbeat_event_reports_the_node_id_of_the_producer),
		PRE_OPERATIONAL(test_a_consumer_starts_with_the_first_heartbeat_and_not_before),
		PRE_OPERATIONAL(test_boot_up_counts_as_a_heartbeat_of_the_producer),
		PRE_OPERATIONAL(test_each_heartbeat_restarts_the_consumer_time),
		PRE_OPERATIONAL(test_the_next_heartbeat_ends_the_error_and_restarts_the_consumer),
		PRE_OPERATIONAL(test_each_lost_node_is_reported_and_the_last_one_that_returns_ends_the_error),
		PRE_OPERATIONAL(test_eight_producers_are_consumed_at_once),
		OPERATIONAL(test_a_heartbeat_event_leaves_operational),
		OPERATIONAL(test_a_heartbeat_event_is_sent_before_the_node_stops),
		PRE_OPERATIONAL(test_in_stopped_the_consumer_continues),
		PRE_OPERATIONAL(test_a_second_entry_for_the_same_node_is_refused),
		PRE_OPERATIONAL(test_a_second_entry_with_time_0_may_have_the_same_node_id),
		PRE_OPERATIONAL(test_the_time_of_an_entry_may_change),
		PRE_OPERATIONAL(test_reserved_bits_and_node_ids_above_127_are_refused),
		PRE_OPERATIONAL(test_an_entry_set_to_0_stops_its_consumer_and_ends_its_error),
		PRE_OPERATIONAL(test_the_receive_filter_has_the_heartbeats_of_the_producers),
		PRE_OPERATIONAL(test_reset_communication_stops_the_consumer_and_ends_the_error),
		cmocka_unit_test(test_of_two_stored_entries_for_one_node_the_first_is_used),
		PRE_OPERATIONAL(test_a_heartbeat_of_wrong_length_is_ignored),
		PRE_OPERATIONAL(test_guarding_is_answered_with_the_state_and_a_toggle_bit),
		PRE_OPERATIONAL(test_reset_communication_clears_the_toggle_bit),
		PRE_OPERATIONAL(test_guarding_of_another_node_is_not_answered),
		PRE_OPERATIONAL(test_a_node_with_a_heartbeat_answers_guarding_and_has_no_life_guarding),
		OPERATIONAL(test_a_master_that_stops_its_requests_is_a_life_guarding_event),
		PRE_OPERATIONAL(test_life_guarding_starts_with_the_first_request),
		PRE_OPERATIONAL(test_the_next_request_ends_a_life_guarding_event),
		PRE_OPERATIONAL(test_without_a_life_time_there_is_no_life_guarding),
		PRE_OPERATIONAL(test_enabling_the_heartbeat_ends_life_guarding),
		PRE_OPERATIONAL(test_enabling_the_heartbeat_ends_the_error_of_life_guarding),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
