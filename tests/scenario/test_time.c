/* TIME: CiA 301, 7.2.6 and 7.5.2.15. Six bytes: ms since midnight (28 bits), days since 1984-01-01. */
#include "tests/scenario/bus.h"

#define CONSUMER 0x80000000u
#define PRODUCER 0x40000000u

static void test_time_is_neither_consumed_nor_produced_by_default(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_read(bus, 0x1012, 0), 0x100);
	assert_false(bus_listens_to(bus, 0x100));
	bus_send(bus, "100 01 00 00 00 01 00");
	assert_int_equal(bus->times, 0);
	assert_false(canopen_send_time(&bus->node, 1, 1, bus->now_us));
	bus_expect_nothing(bus);
}

static void test_a_consumer_receives_the_day_and_the_time_of_day(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1012, 0, 4, CONSUMER | 0x100), 0);
	assert_true(bus_listens_to(bus, 0x100));
	bus_send(bus, "100 FF 5B 26 05 39 3D"); /* 23:59:59.999 of day 15673, 2026-11-29 */
	assert_int_equal(bus->times, 1);
	assert_int_equal(bus->time_ms, 86399999);
	assert_int_equal(bus->time_day, 15673);
	assert_int_equal(bus->time_us, bus->now_us);
	bus_expect_nothing(bus);
}

static void test_the_reserved_bits_of_the_time_of_day_are_ignored(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1012, 0, 4, CONSUMER | 0x100);
	bus_send(bus, "100 01 00 00 F0 02 00");
	assert_int_equal(bus->time_ms, 1);
}

static void test_a_time_of_another_length_or_beyond_midnight_is_ignored(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1012, 0, 4, CONSUMER | 0x100);
	bus_send(bus, "100 01 00 00 00 01");
	bus_send(bus, "100 01 00 00 00 01 00 00");
	bus_send(bus, "100 00 5C 26 05 01 00"); /* 24:00:00.000 */
	assert_int_equal(bus->times, 0);
}

static void test_time_is_consumed_in_pre_operational_and_operational_but_not_in_stopped(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1012, 0, 4, CONSUMER | 0x100);
	bus_send(bus, "100 01 00 00 00 01 00");
	bus_send(bus, "000 01 10");
	bus_send(bus, "100 01 00 00 00 01 00");
	bus_send(bus, "000 02 10");
	bus_send(bus, "100 01 00 00 00 01 00");
	assert_int_equal(bus->times, 2);
}

static void test_a_producer_sends_the_given_time(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1012, 0, 4, PRODUCER | 0x100);
	assert_true(canopen_send_time(&bus->node, 15673, 86399999, bus->now_us));
	bus_expect(bus, "100 FF 5B 26 05 39 3D");
}

static void test_a_stopped_node_does_not_produce_time(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1012, 0, 4, PRODUCER | 0x100);
	bus_send(bus, "000 02 10");
	assert_false(canopen_send_time(&bus->node, 1, 1, bus->now_us));
	bus_expect_nothing(bus);
}

static void test_time_can_be_consumed_with_another_identifier(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1012, 0, 4, CONSUMER | 0x0F0);
	bus_send(bus, "100 01 00 00 00 01 00");
	assert_int_equal(bus->times, 0);
	bus_send(bus, "0F0 01 00 00 00 01 00");
	assert_int_equal(bus->times, 1);
}

static void test_the_identifier_cannot_change_while_time_is_in_use(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1012, 0, 4, CONSUMER | 0x100), 0);
	assert_int_equal(bus_write(bus, 0x1012, 0, 4, CONSUMER | 0x0F0), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1012, 0, 4, 0x100), 0);
	assert_int_equal(bus_write(bus, 0x1012, 0, 4, CONSUMER | 0x0F0), 0);
}

static void test_restricted_and_29_bit_identifiers_are_refused(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1012, 0, 4, 0x000), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1012, 0, 4, 0x701), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1012, 0, 4, 0x20000100), 0x06090030);
	assert_int_equal(bus_read(bus, 0x1012, 0), 0x100);
}

static void test_reset_communication_restores_the_stored_value(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1012, 0, 4, CONSUMER | 0x100);
	bus_reset(bus, "000 82 10", "710 00");
	assert_int_equal(bus_read(bus, 0x1012, 0), 0x100);
	assert_false(bus_listens_to(bus, 0x100));
}

/* Stored by another version, or put there by a file. */
static void test_a_stored_identifier_that_is_not_allowed_raises_6300h(void **state)
{
	static const uint32_t stored[] = {CONSUMER, CONSUMER | 0x701, CONSUMER | 0x20000100};

	(void)state;
	for (int i = 0; i < 3; i++) {
		struct bus *bus = bus_new();

		bus_put(bus, 0x1012, 0, 4, stored[i]);
		bus_start(bus);
		bus_expect(bus, "710 00");
		bus_expect(bus, "090 00 63 01 12 10 00 00 00"); /* data set, 1012h */
		bus_send(bus, "100 01 00 00 00 01 00");
		assert_int_equal(bus->times, 0);
		test_free(bus);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		PRE_OPERATIONAL(test_time_is_neither_consumed_nor_produced_by_default),
		PRE_OPERATIONAL(test_a_consumer_receives_the_day_and_the_time_of_day),
		PRE_OPERATIONAL(test_the_reserved_bits_of_the_time_of_day_are_ignored),
		PRE_OPERATIONAL(test_a_time_of_another_length_or_beyond_midnight_is_ignored),
		PRE_OPERATIONAL(test_time_is_consumed_in_pre_operational_and_operational_but_not_in_stopped),
		PRE_OPERATIONAL(test_a_producer_sends_the_given_time),
		PRE_OPERATIONAL(test_a_stopped_node_does_not_produce_time),
		PRE_OPERATIONAL(test_time_can_be_consumed_with_another_identifier),
		PRE_OPERATIONAL(test_the_identifier_cannot_change_while_time_is_in_use),
		PRE_OPERATIONAL(test_restricted_and_29_bit_identifiers_are_refused),
		PRE_OPERATIONAL(test_reset_communication_restores_the_stored_value),
		cmocka_unit_test(test_a_stored_identifier_that_is_not_allowed_raises_6300h),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
