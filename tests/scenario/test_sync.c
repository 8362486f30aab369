/* SYNC consumer: CiA 301, 7.2.5, objects 1005h, 1006h, 1007h, 1019h. */
#include "tests/scenario/bus.h"

static void tpdo1_only(struct bus *bus)
{
	for (uint16_t index = 0x1801; index <= 0x1803; index++)
		assert_int_equal(bus_write(bus, index, 1, 4, 0x80000000), 0);
}

static void test_the_sync_identifier_can_change(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	bus_exchange(bus, "610 23 05 10 00 A0 00 00 00", "590 60 05 10 00 00 00 00 00");
	assert_int_equal(bus->filter_count, 12);
	assert_true(bus_listens_to(bus, 0x0A0));
	bus_send(bus, "080");
	bus_expect_nothing(bus);
	bus_exchange(bus, "0A0", "190 00 00 00 00 00 00 00 00");
}

static void test_a_sync_identifier_that_is_restricted_or_29_bits_long_is_refused(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1005, 0, 4, 0x000), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1005, 0, 4, 0x610), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1005, 0, 4, 0x7E5), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1005, 0, 4, 0x20000080), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1005, 0, 4, 0x00000880), 0x06090030);
	assert_int_equal(bus_read(bus, 0x1005, 0), 0x80);
}

static void test_bit_31_of_1005h_is_ignored(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	assert_int_equal(bus_write(bus, 0x1005, 0, 4, 0x80000080), 0);
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
}

static void test_a_stored_sync_identifier_that_is_not_allowed_raises_6300h(void **state)
{
	struct bus *bus = bus_new();

	bus_put(bus, 0x1005, 0, 4, 0x610);
	bus_start(bus);
	bus_expect(bus, "710 00");
	bus_expect(bus, "090 00 63 01 05 10 00 00 00");
	bus_exchange(bus, "610 40 01 20 00 00 00 00 00", "590 4F 01 20 00 02 00 00 00");
	test_free(bus);
	(void)state;
}

static void test_a_sync_with_data_is_an_error_while_the_counter_is_off(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "080 01", "090 40 82 11 00 00 00 00 00");
	bus_send(bus, "080 01 02 03 04 05 06 07 08");
	bus_expect_nothing(bus); /* reported already, and no PDO */
}

static void test_a_sync_without_its_counter_is_an_error_while_the_counter_is_on(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	assert_int_equal(bus_write(bus, 0x1019, 0, 1, 4), 0);
	bus_exchange(bus, "080", "090 40 82 11 00 00 00 00 00");
	bus_send(bus, "080 01 00");
	bus_expect_nothing(bus);
}

static void test_a_sync_of_the_right_length_ends_the_error(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	bus_exchange(bus, "080 01", "090 40 82 11 00 00 00 00 00");
	assert_int_equal(bus_read(bus, 0x1001, 0), 0x11);
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
	bus_expect_error_over(bus);
	assert_int_equal(bus_read(bus, 0x1001, 0), 0);
}

static void test_a_wrong_length_is_reported_in_pre_operational_but_not_in_stopped(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "000 02 10");
	bus_send(bus, "080 01");
	bus_expect_nothing(bus);
	bus_send(bus, "000 80 10");
	bus_expect_nothing(bus);
	bus_exchange(bus, "080 01", "090 40 82 11 00 00 00 00 00");
}

static void test_a_counted_sync_sends_every_cyclic_pdo(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	assert_int_equal(bus_write(bus, 0x1019, 0, 1, 3), 0);
	bus_exchange(bus, "080 01", "190 00 00 00 00 00 00 00 00");
	bus_exchange(bus, "080 02", "190 00 00 00 00 00 00 00 00");
	bus_exchange(bus, "080 03", "190 00 00 00 00 00 00 00 00");
	bus_exchange(bus, "080 01", "190 00 00 00 00 00 00 00 00");
}

static void test_the_counter_overflows_at_2_to_240(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1019, 0, 1, 1), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1019, 0, 1, 241), 0x06090031);
	assert_int_equal(bus_write(bus, 0x1019, 0, 1, 2), 0);
	assert_int_equal(bus_write(bus, 0x1019, 0, 1, 240), 0);
	assert_int_equal(bus_write(bus, 0x1019, 0, 1, 0), 0);
}

static void sync_seen_late(struct bus *bus, uint64_t delay_us)
{
	const struct can_msg sync = {.id = 0x080, .t_us = bus->now_us};

	bus_run(bus, delay_us);
	bus_send_msg(bus, &sync);
}

static void test_within_the_synchronous_window_the_pdo_is_sent(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	assert_int_equal(bus_write(bus, 0x1007, 0, 4, 2000), 0);
	sync_seen_late(bus, 2000);
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
	assert_int_equal(bus->node.sync.late, 0);
}

static void test_after_the_synchronous_window_pdos_are_dropped_and_it_is_reported_until_a_sync_in_time(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	assert_int_equal(bus_write(bus, 0x1007, 0, 4, 2000), 0);
	sync_seen_late(bus, 2001);
	bus_expect(bus, "090 00 81 11 07 10 00 00 00"); /* communication, 1007h */
	sync_seen_late(bus, 2001);
	bus_expect_nothing(bus);
	assert_int_equal(bus->node.sync.late, 2);
	bus_send(bus, "080");
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
}

static void test_a_late_sync_still_counts_for_type_n(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	assert_int_equal(bus_write(bus, 0x1007, 0, 4, 2000), 0);
	assert_int_equal(bus_write(bus, 0x1800, 2, 1, 2), 0);
	sync_seen_late(bus, 5000);
	bus_forget(bus);
	bus_send(bus, "080");
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
}

static void test_a_type_0_pdo_of_a_late_sync_is_sent_with_the_next_one(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	assert_int_equal(bus_write(bus, 0x1007, 0, 4, 2000), 0);
	assert_int_equal(bus_write(bus, 0x1800, 2, 1, 0), 0);
	bus_sample(bus, 5);
	sync_seen_late(bus, 5000);
	bus_forget(bus);
	bus_send(bus, "080");
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
	bus_expect(bus, "190 00 00 00 00 00 00 05 00");
}

static void test_without_a_window_no_sync_is_late(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	sync_seen_late(bus, 1000000);
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
}

/* ---- missing SYNC ------------------------------------------------------------------------------------------------ */

#define MISSING	 "090 00 81 11 06 10 00 00 00" /* communication, 1006h */
#define NO_ERROR "090 00 00 00 00 00 00 00 00"

/* A consumer with a period of 10 ms that receives the first SYNC now. */
static void await_sync(struct bus *bus)
{
	tpdo1_only(bus);
	assert_int_equal(bus_write(bus, 0x1006, 0, 4, 10000), 0);
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
}

static void test_a_sync_missing_for_a_period_and_a_half_is_reported_once_until_the_next_sync(void **state)
{
	struct bus *bus = *state;

	await_sync(bus);
	bus_run(bus, 14999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, MISSING);
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
	bus_send(bus, "080");
	bus_expect(bus, NO_ERROR);
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
	bus_run(bus, 15000);
	bus_expect(bus, MISSING);
}

static void test_a_sync_within_a_period_and_a_half_is_not_missing(void **state)
{
	struct bus *bus = *state;

	await_sync(bus);
	for (int i = 0; i < 10; i++) {
		bus_run(bus, 14999);
		bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
	}
}

static void test_a_new_period_is_watched_from_the_next_sync_on(void **state)
{
	struct bus *bus = *state;

	await_sync(bus);
	assert_int_equal(bus_write(bus, 0x1006, 0, 4, 20000), 0);
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
	bus_run(bus, 29999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, MISSING);
}

static void test_without_a_period_no_sync_is_missing(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
	bus_run(bus, 3600000000);
	bus_expect_nothing(bus);
}

static void test_before_the_first_sync_none_is_missing(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1006, 0, 4, 10000), 0);
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
}

static void test_a_sync_is_missing_in_operational_only(void **state)
{
	struct bus *bus = *state;

	await_sync(bus);
	bus_send(bus, "000 80 10");
	bus_run(bus, 1000000);
	bus_send(bus, "080"); /* not used in pre-operational */
	bus_run(bus, 1000000);
	bus_send(bus, "000 01 10");
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
}

static void test_the_error_of_a_missing_sync_ends_with_one_in_pre_operational_or_without_a_period(void **state)
{
	struct bus *bus = *state;

	await_sync(bus);
	bus_run(bus, 15000);
	bus_expect(bus, MISSING);
	bus_send(bus, "000 80 10");
	bus_exchange(bus, "080", NO_ERROR);
	bus_send(bus, "000 01 10");
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
	bus_run(bus, 15000);
	bus_expect(bus, MISSING);
	assert_int_equal(bus_write(bus, 0x1006, 0, 4, 0), 0);
	bus_expect_error_over(bus); /* a second after the last time */
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
}

static void test_a_node_that_becomes_the_producer_misses_no_sync(void **state)
{
	struct bus *bus = *state;

	await_sync(bus);
	bus_run(bus, 5000);
	assert_int_equal(bus_write(bus, 0x1005, 0, 4, 1 << 30 | 0x080), 0);
	bus_run(bus, 1000000);
	bus_forget(bus);
	assert_int_equal(bus_read(bus, 0x1001, 0), 0);
}

static void test_a_late_and_a_missing_sync_are_separate_errors(void **state)
{
	struct bus *bus = *state;

	await_sync(bus);
	assert_int_equal(bus_write(bus, 0x1007, 0, 4, 2000), 0);
	sync_seen_late(bus, 2001);
	bus_expect(bus, "090 00 81 11 07 10 00 00 00");
	bus_run(bus, 15000);
	bus_expect(bus, MISSING);
	sync_seen_late(bus, 2001);
	bus_expect_nothing(bus); /* one of the two is still active */
	assert_int_equal(bus_read(bus, 0x1001, 0), 0x11);
	bus_send(bus, "080");
	bus_expect(bus, NO_ERROR);
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
}

static void test_reset_communication_ends_the_error_of_a_missing_sync(void **state)
{
	struct bus *bus = *state;

	await_sync(bus);
	bus_run(bus, 15000);
	bus_expect(bus, MISSING);
	bus_reset(bus, "000 82 10", "710 00");
	assert_int_equal(bus_read(bus, 0x1001, 0), 0);
}

/* ---- producer ---------------------------------------------------------------------------------------------------- */

enum { PRODUCER = 1 << 30 };

/* Produces SYNC every 10 ms from now on. */
static void produce(struct bus *bus)
{
	assert_int_equal(bus_write(bus, 0x1006, 0, 4, 10000), 0);
	assert_int_equal(bus_write(bus, 0x1005, 0, 4, PRODUCER | 0x080), 0);
}

static void test_a_producer_sends_sync_each_period(void **state)
{
	struct bus *bus = *state;
	uint64_t start_us = bus->now_us;

	produce(bus);
	bus_run(bus, 30000);
	for (uint64_t i = 1; i <= 3; i++) {
		bus_expect(bus, "080");
		assert_int_equal(bus->seen_us, start_us + i * 10000);
	}
	bus_expect_nothing(bus);
}

static void test_a_producer_without_a_period_sends_nothing(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1005, 0, 4, PRODUCER | 0x080), 0);
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
}

static void test_a_consumer_with_a_period_sends_nothing(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1006, 0, 4, 10000), 0);
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
}

static void test_the_pdos_of_a_producer_follow_its_own_sync(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	produce(bus);
	bus_run(bus, 10000);
	bus_expect(bus, "080");
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
	bus_expect_nothing(bus);
}

static void test_a_producer_ignores_the_sync_of_another_node(void **state)
{
	struct bus *bus = *state;

	produce(bus);
	assert_int_equal(bus->filter_count, 14);
	bus_send(bus, "080");
	bus_expect_nothing(bus);
}

static void test_a_producer_counts_from_1_to_the_overflow_value(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1019, 0, 1, 3), 0);
	produce(bus);
	bus_run(bus, 40000);
	bus_expect(bus, "080 01");
	bus_expect(bus, "080 02");
	bus_expect(bus, "080 03");
	bus_expect(bus, "080 01");
}

static void test_in_stopped_no_sync_is_sent_and_afterwards_the_counter_starts_at_1(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1019, 0, 1, 10), 0);
	produce(bus);
	bus_run(bus, 20000);
	bus_forget(bus);
	bus_send(bus, "000 02 10");
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
	bus_send(bus, "000 80 10");
	bus_run(bus, 10000);
	bus_expect(bus, "080 01");
}

static void test_the_start_value_applies_to_the_sync_of_a_producer_too(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, 0x80000190), 0);
	assert_int_equal(bus_write(bus, 0x1800, 6, 1, 2), 0);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, 0x40000190), 0);
	assert_int_equal(bus_write(bus, 0x1019, 0, 1, 10), 0);
	produce(bus);
	bus_run(bus, 20000);
	bus_expect(bus, "080 01");
	bus_expect(bus, "080 02");
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
}

static void test_the_identifier_does_not_change_while_sync_is_produced(void **state)
{
	struct bus *bus = *state;

	produce(bus);
	assert_int_equal(bus_write(bus, 0x1005, 0, 4, PRODUCER | 0x0A0), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1005, 0, 4, 0x0A0), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1005, 0, 4, 0x080), 0);
	assert_int_equal(bus_write(bus, 0x1005, 0, 4, PRODUCER | 0x0A0), 0);
	bus_run(bus, 10000);
	bus_expect(bus, "0A0");
}

static void test_the_counter_does_not_change_while_there_is_a_period(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1006, 0, 4, 10000), 0);
	assert_int_equal(bus_write(bus, 0x1019, 0, 1, 10), 0x08000022);
	assert_int_equal(bus_write(bus, 0x1019, 0, 1, 0), 0); /* no change */
	assert_int_equal(bus_write(bus, 0x1006, 0, 4, 0), 0);
	assert_int_equal(bus_write(bus, 0x1019, 0, 1, 10), 0);
}

static void test_a_period_below_a_millisecond_is_refused(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1006, 0, 4, 999), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1006, 0, 4, 1000), 0);
}

static void test_a_new_period_starts_now_and_0_ends_production(void **state)
{
	struct bus *bus = *state;

	produce(bus);
	bus_run(bus, 5000);
	assert_int_equal(bus_write(bus, 0x1006, 0, 4, 20000), 0);
	bus_run(bus, 19999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "080");
	assert_int_equal(bus_write(bus, 0x1006, 0, 4, 0), 0);
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
}

static void test_missed_syncs_are_not_sent_in_a_burst_and_a_late_one_keeps_the_phase(void **state)
{
	struct bus *bus = *state;
	uint64_t start_us = bus->now_us;

	produce(bus);
	bus->now_us = start_us + 13000;
	bus_tick(bus);
	bus_expect(bus, "080");
	assert_int_equal(bus->deadline_us, start_us + 20000);
	bus->now_us = start_us + 45000;
	bus_tick(bus);
	bus_expect(bus, "080");
	bus_expect_nothing(bus);
	assert_int_equal(bus->deadline_us, start_us + 55000);
}

static void test_reset_communication_ends_production(void **state)
{
	struct bus *bus = *state;

	produce(bus);
	bus_reset(bus, "000 82 10", "710 00");
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
	assert_int_equal(bus_read(bus, 0x1005, 0), 0x80);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		OPERATIONAL(test_the_sync_identifier_can_change),
		PRE_OPERATIONAL(test_a_sync_identifier_that_is_restricted_or_29_bits_long_is_refused),
		OPERATIONAL(test_bit_31_of_1005h_is_ignored),
		cmocka_unit_test(test_a_stored_sync_identifier_that_is_not_allowed_raises_6300h),
		OPERATIONAL(test_a_sync_with_data_is_an_error_while_the_counter_is_off),
		OPERATIONAL(test_a_sync_without_its_counter_is_an_error_while_the_counter_is_on),
		OPERATIONAL(test_a_sync_of_the_right_length_ends_the_error),
		PRE_OPERATIONAL(test_a_wrong_length_is_reported_in_pre_operational_but_not_in_stopped),
		OPERATIONAL(test_a_counted_sync_sends_every_cyclic_pdo),
		PRE_OPERATIONAL(test_the_counter_overflows_at_2_to_240),
		OPERATIONAL(test_within_the_synchronous_window_the_pdo_is_sent),
		OPERATIONAL(test_after_the_synchronous_window_pdos_are_dropped_and_it_is_reported_until_a_sync_in_time),
		OPERATIONAL(test_a_late_sync_still_counts_for_type_n),
		OPERATIONAL(test_a_type_0_pdo_of_a_late_sync_is_sent_with_the_next_one),
		OPERATIONAL(test_without_a_window_no_sync_is_late),
		OPERATIONAL(test_a_sync_missing_for_a_period_and_a_half_is_reported_once_until_the_next_sync),
		OPERATIONAL(test_a_sync_within_a_period_and_a_half_is_not_missing),
		OPERATIONAL(test_a_new_period_is_watched_from_the_next_sync_on),
		OPERATIONAL(test_without_a_period_no_sync_is_missing),
		OPERATIONAL(test_before_the_first_sync_none_is_missing),
		OPERATIONAL(test_a_sync_is_missing_in_operational_only),
		OPERATIONAL(test_the_error_of_a_missing_sync_ends_with_one_in_pre_operational_or_without_a_period),
		OPERATIONAL(test_a_node_that_becomes_the_producer_misses_no_sync),
		OPERATIONAL(test_a_late_and_a_missing_sync_are_separate_errors),
		OPERATIONAL(test_reset_communication_ends_the_error_of_a_missing_sync),
		PRE_OPERATIONAL(test_a_producer_sends_sync_each_period),
		PRE_OPERATIONAL(test_a_producer_without_a_period_sends_nothing),
		PRE_OPERATIONAL(test_a_consumer_with_a_period_sends_nothing),
		OPERATIONAL(test_the_pdos_of_a_producer_follow_its_own_sync),
		PRE_OPERATIONAL(test_a_producer_ignores_the_sync_of_another_node),
		PRE_OPERATIONAL(test_a_producer_counts_from_1_to_the_overflow_value),
		PRE_OPERATIONAL(test_in_stopped_no_sync_is_sent_and_afterwards_the_counter_starts_at_1),
		OPERATIONAL(test_the_start_value_applies_to_the_sync_of_a_producer_too),
		PRE_OPERATIONAL(test_the_identifier_does_not_change_while_sync_is_produced),
		PRE_OPERATIONAL(test_the_counter_does_not_change_while_there_is_a_period),
		PRE_OPERATIONAL(test_a_period_below_a_millisecond_is_refused),
		PRE_OPERATIONAL(test_a_new_period_starts_now_and_0_ends_production),
		PRE_OPERATIONAL(test_missed_syncs_are_not_sent_in_a_burst_and_a_late_one_keeps_the_phase),
		PRE_OPERATIONAL(test_reset_communication_ends_production),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
