/* SYNC consumer: CiA 301, 7.2.5, objects 1005h, 1007h, 1019h. */
#include "tests/scenario/bus.h"

static void tpdo1_only(struct bus *bus)
{
	for (uint16_t index = 0x1801; index <= 0x1803; index++)
		assert_int_equal(bus_write(bus, index, 1, 4, 0x80000000), 0);
}

static void test_the_sync_identifier_can_be_moved(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	bus_exchange(bus, "610 23 05 10 00 A0 00 00 00", "590 60 05 10 00 00 00 00 00");
	assert_int_equal(bus->filter_count, 4);
	assert_int_equal(bus->filter[2], 0x0A0);
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

static void test_this_node_does_not_produce_sync(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1005, 0, 4, 0x40000080), 0x06090030);
}

static void test_bit_31_of_the_sync_identifier_means_nothing(void **state)
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
	bus_expect_nothing(bus); /* told already, and no PDO */
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
	bus_send(bus, "080");
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
	assert_int_equal(bus_read(bus, 0x1001, 0), 0);
}

static void test_a_wrong_length_is_told_in_pre_operational_but_not_in_stopped(void **state)
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

static void test_after_the_synchronous_window_the_pdo_is_dropped_and_counted(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	assert_int_equal(bus_write(bus, 0x1007, 0, 4, 2000), 0);
	sync_seen_late(bus, 2001);
	bus_expect_nothing(bus);
	assert_int_equal(bus->node.sync.late, 1);
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
}

static void test_a_late_sync_still_counts_for_type_n(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	assert_int_equal(bus_write(bus, 0x1007, 0, 4, 2000), 0);
	assert_int_equal(bus_write(bus, 0x1800, 2, 1, 2), 0);
	sync_seen_late(bus, 5000);
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
}

static void test_a_late_sync_leaves_the_sample_of_type_0_to_the_next(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	assert_int_equal(bus_write(bus, 0x1007, 0, 4, 2000), 0);
	assert_int_equal(bus_write(bus, 0x1800, 2, 1, 0), 0);
	bus_sample(bus, 5);
	sync_seen_late(bus, 5000);
	bus_expect_nothing(bus);
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 05 00");
}

static void test_without_a_window_no_sync_is_late(void **state)
{
	struct bus *bus = *state;

	tpdo1_only(bus);
	sync_seen_late(bus, 1000000);
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		OPERATIONAL(test_the_sync_identifier_can_be_moved),
		PRE_OPERATIONAL(test_a_sync_identifier_that_is_restricted_or_29_bits_long_is_refused),
		PRE_OPERATIONAL(test_this_node_does_not_produce_sync),
		OPERATIONAL(test_bit_31_of_the_sync_identifier_means_nothing),
		cmocka_unit_test(test_a_stored_sync_identifier_that_is_not_allowed_raises_6300h),
		OPERATIONAL(test_a_sync_with_data_is_an_error_while_the_counter_is_off),
		OPERATIONAL(test_a_sync_without_its_counter_is_an_error_while_the_counter_is_on),
		OPERATIONAL(test_a_sync_of_the_right_length_ends_the_error),
		PRE_OPERATIONAL(test_a_wrong_length_is_told_in_pre_operational_but_not_in_stopped),
		OPERATIONAL(test_a_counted_sync_sends_every_cyclic_pdo),
		PRE_OPERATIONAL(test_the_counter_overflows_at_2_to_240),
		OPERATIONAL(test_within_the_synchronous_window_the_pdo_is_sent),
		OPERATIONAL(test_after_the_synchronous_window_the_pdo_is_dropped_and_counted),
		OPERATIONAL(test_a_late_sync_still_counts_for_type_n),
		OPERATIONAL(test_a_late_sync_leaves_the_sample_of_type_0_to_the_next),
		OPERATIONAL(test_without_a_window_no_sync_is_late),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
