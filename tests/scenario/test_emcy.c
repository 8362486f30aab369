/* EMCY: CiA 301, 7.2.7, objects 1001h, 1003h, 1014h, 1015h. */
#include "tests/scenario/bus.h"

#include <string.h>

static void set_error(struct bus *bus, uint16_t code, uint8_t register_bits)
{
	canopen_error_set(&bus->node, code, register_bits, NULL, bus->now_us);
	bus_tick(bus);
}

static void clear_error(struct bus *bus, uint16_t code)
{
	canopen_error_clear(&bus->node, code, bus->now_us);
	bus_tick(bus);
}

/* ---- raising and clearing ---------------------------------------------------------------------------------------- */

static void test_an_error_is_sent_at_once_with_the_generic_bit(void **state)
{
	struct bus *bus = *state;

	set_error(bus, 0x5000, 0);
	bus_expect(bus, "090 00 50 01 00 00 00 00 00");
	bus_expect_nothing(bus);
	assert_int_equal(bus_read(bus, 0x1001, 0), 0x01);
}

static void test_the_message_carries_register_bits_and_manufacturer_bytes(void **state)
{
	struct bus *bus = *state;
	const uint8_t info[5] = {0xA1, 0xA2, 0xA3, 0xA4, 0xA5};

	canopen_error_set(&bus->node, 0x8120, 0x90, info, bus->now_us);
	bus_expect(bus, "090 20 81 91 A1 A2 A3 A4 A5");
	assert_int_equal(bus_read(bus, 0x1001, 0), 0x91);
	assert_int_equal(bus_read(bus, 0x1003, 1), 0xA2A18120);
}

static void test_an_error_is_sent_in_operational_too(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "000 01 10");
	set_error(bus, 0x5000, 0);
	bus_expect(bus, "090 00 50 01 00 00 00 00 00");
}

static void test_an_active_error_is_not_sent_again(void **state)
{
	struct bus *bus = *state;

	set_error(bus, 0x5000, 0);
	bus_expect(bus, "090 00 50 01 00 00 00 00 00");
	set_error(bus, 0x5000, 0);
	bus_expect_nothing(bus);
	assert_int_equal(bus_read(bus, 0x1003, 0), 1);
}

static void test_an_error_that_ended_and_recurs_is_sent_again(void **state)
{
	struct bus *bus = *state;

	set_error(bus, 0x5000, 0);
	clear_error(bus, 0x5000);
	set_error(bus, 0x5000, 0);
	bus_expect(bus, "090 00 50 01 00 00 00 00 00");
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
	bus_expect(bus, "090 00 50 01 00 00 00 00 00");
	bus_expect_nothing(bus);
}

static void test_the_error_register_has_the_bits_of_all_active_errors(void **state)
{
	struct bus *bus = *state;

	set_error(bus, 0x5000, 0x80);
	bus_expect(bus, "090 00 50 81 00 00 00 00 00");
	set_error(bus, 0x8120, 0x10);
	bus_expect(bus, "090 20 81 91 00 00 00 00 00");
	clear_error(bus, 0x5000);
	assert_int_equal(bus_read(bus, 0x1001, 0), 0x11);
	clear_error(bus, 0x8120);
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
	assert_int_equal(bus_read(bus, 0x1001, 0), 0x00);
}

static void test_the_error_reset_is_sent_when_the_last_error_ends_and_not_before(void **state)
{
	struct bus *bus = *state;

	set_error(bus, 0x5000, 0);
	set_error(bus, 0x5010, 0x20);
	bus_forget(bus);
	clear_error(bus, 0x5010);
	bus_expect_nothing(bus);
	clear_error(bus, 0x5000);
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
	bus_expect_nothing(bus);
}

static void test_clearing_an_error_that_is_not_active_sends_nothing(void **state)
{
	struct bus *bus = *state;

	clear_error(bus, 0x5000);
	bus_expect_nothing(bus);
}

static void test_one_error_too_many_is_counted_as_lost(void **state)
{
	struct bus *bus = *state;

	for (unsigned i = 0; i < EMCY_ERRORS; i++)
		set_error(bus, (uint16_t)(0xFF00 + i), 0);
	assert_int_equal(bus->node.emcy.lost, 0);
	bus_forget(bus);
	set_error(bus, 0x5000, 0);
	bus_expect_nothing(bus);
	assert_int_equal(bus->node.emcy.lost, 1);
}

/* ---- history 1003h ----------------------------------------------------------------------------------------------- */

static void test_the_history_has_the_newest_error_first(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_read(bus, 0x1003, 0), 0);
	set_error(bus, 0x5000, 0);
	set_error(bus, 0x8120, 0x10);
	clear_error(bus, 0x5000);
	clear_error(bus, 0x8120);
	bus_forget(bus);
	assert_int_equal(bus_read(bus, 0x1003, 0), 2); /* the error reset is not an error */
	assert_int_equal(bus_read(bus, 0x1003, 1), 0x8120);
	assert_int_equal(bus_read(bus, 0x1003, 2), 0x5000);
}

static void test_an_unused_entry_of_the_history_has_no_data(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 40 03 10 01 00 00 00 00", "590 80 03 10 01 24 00 00 08");
	set_error(bus, 0x5000, 0);
	bus_forget(bus);
	bus_exchange(bus, "610 40 03 10 01 00 00 00 00", "590 43 03 10 01 00 50 00 00");
	bus_exchange(bus, "610 40 03 10 02 00 00 00 00", "590 80 03 10 02 24 00 00 08");
	bus_exchange(bus, "610 40 03 10 09 00 00 00 00", "590 80 03 10 09 11 00 09 06");
}

static void test_the_ninth_error_removes_the_first_from_the_history(void **state)
{
	struct bus *bus = *state;

	for (unsigned i = 0; i < 9; i++)
		set_error(bus, (uint16_t)(0xFF00 + i), 0);
	bus_forget(bus);
	assert_int_equal(bus_read(bus, 0x1003, 0), 8);
	assert_int_equal(bus_read(bus, 0x1003, 1), 0xFF08);
	assert_int_equal(bus_read(bus, 0x1003, 8), 0xFF01);
}

/* A device whose 1003h has sub-indices up to `last` only; none at all below 0. */
static struct bus *bus_with_history_up_to(int last)
{
	static struct od_entry entries[2000];
	static struct od_table table;
	struct bus *bus = bus_new();

	table = imu9_od_table;
	assert_true(table.count <= sizeof(entries) / sizeof(entries[0]));
	table.entries = entries;
	table.count = 0;
	for (size_t i = 0; i < imu9_od_table.count; i++)
		if (imu9_od_table.entries[i].index != 0x1003 || imu9_od_table.entries[i].sub <= last)
			entries[table.count++] = imu9_od_table.entries[i];
	bus->od.table = &table;
	bus_start(bus);
	bus_expect(bus, "710 00");
	return bus;
}

static void test_a_history_of_one_entry_has_the_newest_error(void **state)
{
	struct bus *bus = bus_with_history_up_to(1);

	set_error(bus, 0x5000, 0);
	set_error(bus, 0x8120, 0x10);
	bus_forget(bus);
	assert_int_equal(bus_read(bus, 0x1003, 0), 1);
	assert_int_equal(bus_read(bus, 0x1003, 1), 0x8120);
	test_free(bus);
	(void)state;
}

static void test_a_device_without_a_history_sends_its_errors(void **state)
{
	struct bus *bus = bus_with_history_up_to(-1);

	set_error(bus, 0x5000, 0);
	bus_expect(bus, "090 00 50 01 00 00 00 00 00");
	bus_exchange(bus, "610 40 03 10 00 00 00 00 00", "590 80 03 10 00 00 00 02 06");
	test_free(bus);
	(void)state;
}

static void test_writing_0_clears_the_history_and_nothing_else_may_be_written(void **state)
{
	struct bus *bus = *state;

	set_error(bus, 0x5000, 0);
	clear_error(bus, 0x5000);
	set_error(bus, 0x5010, 0);
	bus_forget(bus);
	bus_exchange(bus, "610 2F 03 10 00 01 00 00 00", "590 80 03 10 00 30 00 09 06");
	bus_exchange(bus, "610 23 03 10 01 00 00 00 00", "590 80 03 10 01 02 00 01 06");
	assert_int_equal(bus_read(bus, 0x1003, 0), 2);
	bus_exchange(bus, "610 2F 03 10 00 00 00 00 00", "590 60 03 10 00 00 00 00 00");
	assert_int_equal(bus_read(bus, 0x1003, 0), 0);
	bus_exchange(bus, "610 40 03 10 01 00 00 00 00", "590 80 03 10 01 24 00 00 08");
	assert_int_equal(*(uint32_t *)od_value(&bus->od, 0x1003, 1, 4), 0);
	assert_int_equal(*(uint32_t *)od_value(&bus->od, 0x1003, 2, 4), 0);
	assert_int_equal(bus_read(bus, 0x1001, 0), 1); /* the error is still active */
}

static void test_an_error_that_recurs_moves_to_the_front_of_the_history(void **state)
{
	struct bus *bus = *state;

	for (uint16_t code = 0xFF01; code <= 0xFF08; code++)
		set_error(bus, code, 0);
	for (int i = 0; i < 10; i++) {
		clear_error(bus, 0xFF03);
		set_error(bus, 0xFF03, 0);
	}
	bus_forget(bus);
	assert_int_equal(bus_read(bus, 0x1003, 0), 8);
	assert_int_equal(bus_read(bus, 0x1003, 1), 0xFF03);
	assert_int_equal(bus_read(bus, 0x1003, 2), 0xFF08);
	assert_int_equal(bus_read(bus, 0x1003, 6), 0xFF04);
	assert_int_equal(bus_read(bus, 0x1003, 7), 0xFF02);
	assert_int_equal(bus_read(bus, 0x1003, 8), 0xFF01);
}

/* ---- a bus that misbehaves --------------------------------------------------------------------------------------- */

/* Frames on one bus, a wrong one and a correct one of each kind, and the EMCY of the wrong one. */
static const struct {
	const char *wrong, *correct, *emcy;
} KINDS[] = {
	{"080 01", "080", "090 40 82 11 00 00 00 00 00"},		       /* SYNC with a counter */
	{"210", "210 00 00 00 00 00 00 00 00", "090 10 82 11 00 14 00 08 00"}, /* too short */
	{"510 00 00 00", "510 00 00", "090 20 82 11 03 14 03 02 00"},	       /* too long */
	{"410 00 00 00 00 00 00 02", "410 00 00 00 00 00 00 00", "090 00 82 11 02 14 72 20 07"}, /* bad value */
};
enum { KIND_COUNT = sizeof(KINDS) / sizeof(KINDS[0]) };

static unsigned count_emcy(const struct bus *bus)
{
	unsigned n = 0;

	for (size_t i = bus->seen; i < bus->sent_count; i++)
		n += bus->sent[i].msg.id == 0x090;
	return n;
}

static void test_wrong_and_correct_frames_in_turn_are_one_error(void **state)
{
	(void)state;
	for (size_t kind = 0; kind < KIND_COUNT; kind++) {
		void *fixture;

		bus_operational(&fixture);
		struct bus *bus = fixture;

		for (uint8_t n = 1; n <= 4; n++) /* nothing but EMCY on the bus */
			assert_int_equal(bus_write(bus, 0x1800 + n - 1, 1, 4, 0x80000000), 0);
		bus_exchange(bus, KINDS[kind].wrong, KINDS[kind].emcy);
		for (int i = 0; i < 1000; i++) {
			bus_run(bus, 10000);
			bus_send(bus, i % 2 ? KINDS[kind].wrong : KINDS[kind].correct);
		}
		bus_expect_nothing(bus);
		assert_int_equal(bus_read(bus, 0x1003, 0), 1);
		bus_send(bus, KINDS[kind].correct);
		bus_run(bus, 999999);
		bus_expect_nothing(bus);
		bus_run(bus, 1);
		bus_expect(bus, "090 00 00 00 00 00 00 00 00");
		bus_teardown(&fixture);
	}
}

static void test_an_error_of_wrong_frames_is_forgotten_ten_seconds_after_the_last_one(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "210 01", "090 10 82 11 00 14 01 08 00");
	bus_run(bus, 5000000);
	bus_send(bus, "210 01");
	bus_run(bus, 9999999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
}

/* Whatever the intervals are: SYNC of both lengths with a period, RPDOs of three lengths with a timeout, a heartbeat
 * that is watched. */
static void test_no_flood_sends_more_than_two_emcys_of_a_kind_within_a_second(void **state)
{
	static const char *const FRAMES[] = {
		"080", "080 01", "210", "210 00 00 00 00 00 00 00 00", "510 00 00", "510 00 00 00", "720 05"};
	struct bus *bus = *state;
	uint32_t random = 1;

	for (uint8_t n = 1; n <= 4; n++)
		assert_int_equal(bus_write(bus, 0x1800 + n - 1, 1, 4, 0x80000000), 0);
	assert_int_equal(bus_write(bus, 0x1006, 0, 4, 1000), 0);
	assert_int_equal(bus_write(bus, 0x1029, 1, 1, 1), 0);
	assert_int_equal(bus_write(bus, 0x1016, 1, 4, 0x00200001), 0);
	for (uint16_t n = 0; n < 4; n++)
		assert_int_equal(bus_write(bus, 0x1400 + n, 5, 2, 1), 0);
	for (int i = 0; i < 100000; i++) {
		random = random * 1664525 + 1013904223;
		bus_send(bus, FRAMES[(random >> 8) % 7]);
		bus_run(bus, random >> 20 << (i % 200 ? 0 : 9)); /* to 4 ms, and pauses of up to 2 s */
	}
	assert_true(count_emcy(bus) > 100);
	for (size_t i = bus->seen; i < bus->sent_count; i++) {
		const struct can_msg *msg = &bus->sent[i].msg;
		unsigned same = 0;

		for (size_t k = i; msg->id == 0x090 && k < bus->sent_count; k++)
			same += bus->sent[k].t_us < bus->sent[i].t_us + 1000000 && bus->sent[k].msg.id == 0x090 &&
				memcmp(bus->sent[k].msg.data, msg->data, 2) == 0 &&
				memcmp(bus->sent[k].msg.data + 3, msg->data + 3, 2) == 0;
		assert_in_range(same, 0, 2);
	}
}

static void test_an_error_that_comes_and_goes_ends_once_a_second(void **state)
{
	struct bus *bus = *state;

	for (int i = 0; i < 100; i++) {
		set_error(bus, 0x8120, 0x10);
		clear_error(bus, 0x8120);
		bus_run(bus, 1000);
	}
	bus_expect(bus, "090 20 81 11 00 00 00 00 00");
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
	bus_expect(bus, "090 20 81 11 00 00 00 00 00");
	bus_expect_nothing(bus);
	bus_run(bus, 899999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
	bus_expect_nothing(bus);
}

static void test_by_default_two_emcys_are_a_tenth_of_a_second_apart(void **state)
{
	struct bus *bus = *state;
	struct od_values defaults;
	struct od od;

	od_init(&od, &imu9_od_table, &defaults, BUS_NODE_ID);
	assert_int_equal(defaults.inhibit_time_emcy, 1000); /* 100 us */
	assert_int_equal(bus_write(bus, 0x1015, 0, 2, defaults.inhibit_time_emcy), 0);
	set_error(bus, 0x5000, 0);
	bus_expect(bus, "090 00 50 01 00 00 00 00 00");
	set_error(bus, 0x5010, 0);
	bus_run(bus, 99999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "090 10 50 01 00 00 00 00 00");
}

/* ---- COB-ID 1014h ------------------------------------------------------------------------------------------------ */

static void test_with_bit_31_no_emcy_is_sent_but_errors_are_recorded(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 23 14 10 00 90 00 00 80", "590 60 14 10 00 00 00 00 00");
	set_error(bus, 0x5000, 0);
	clear_error(bus, 0x5000);
	set_error(bus, 0x8120, 0);
	bus_expect_nothing(bus);
	assert_int_equal(bus_read(bus, 0x1003, 0), 2);
	assert_int_equal(bus_read(bus, 0x1001, 0), 1);
	bus_exchange(bus, "610 23 14 10 00 90 00 00 00", "590 60 14 10 00 00 00 00 00");
	clear_error(bus, 0x8120);
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
}

static void test_the_emcy_identifier_changes_only_while_it_is_invalid(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x0A0), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x090), 0); /* no change */
	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x80000090), 0);
	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x0A0), 0);
	set_error(bus, 0x5000, 0);
	bus_expect(bus, "0A0 00 50 01 00 00 00 00 00");
}

static void test_an_emcy_identifier_that_is_restricted_or_29_bits_long_is_refused(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x80000000), 0);
	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x000), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x701), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x20000090), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x40000090), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x00000890), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0xA0000090), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x090), 0);
}

static void test_a_stored_emcy_identifier_that_is_not_allowed_is_made_invalid(void **state)
{
	struct bus *bus = bus_new();

	bus_put(bus, 0x1014, 0, 4, 0x000);
	bus_start(bus);
	bus_expect(bus, "710 00");
	bus_expect_nothing(bus);
	assert_int_equal(bus_read(bus, 0x1014, 0), 0x80000000);
	assert_int_equal(bus_read(bus, 0x1003, 1), 0x10146300);
	test_free(bus);
	(void)state;
}

/* ---- inhibit time 1015h ------------------------------------------------------------------------------------------ */

static void test_within_the_inhibit_time_messages_wait_and_none_is_lost(void **state)
{
	struct bus *bus = *state;
	uint64_t start_us = bus->now_us;

	assert_int_equal(bus_write(bus, 0x1015, 0, 2, 100), 0); /* 10 ms */
	set_error(bus, 0x5000, 0x80);
	bus_expect(bus, "090 00 50 81 00 00 00 00 00");
	set_error(bus, 0x5010, 0x20);
	clear_error(bus, 0x5010);
	clear_error(bus, 0x5000);
	bus_expect_nothing(bus);
	bus_run(bus, 9999);
	bus_expect_nothing(bus);
	bus_run(bus, 100000);
	bus_expect(bus, "090 10 50 A1 00 00 00 00 00"); /* the register at the time of the error */
	assert_int_equal(bus->seen_us, start_us + 10000);
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
	assert_int_equal(bus->seen_us, start_us + 20000);
	bus_expect_nothing(bus);
}

static void test_after_the_inhibit_time_a_message_is_sent_at_once(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1015, 0, 2, 100), 0);
	set_error(bus, 0x5000, 0);
	bus_forget(bus);
	bus_run(bus, 10000);
	clear_error(bus, 0x5000);
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
}

static void test_when_too_many_wait_the_oldest_is_dropped_and_counted(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1015, 0, 2, 100), 0);
	set_error(bus, 0xFF00, 0);
	bus_forget(bus);
	for (unsigned i = 0; i < EMCY_QUEUE / 2; i++) {
		set_error(bus, (uint16_t)(0xFF01 + i), 0);
		clear_error(bus, (uint16_t)(0xFF01 + i));
		set_error(bus, (uint16_t)(0xFF81 + i), 0);
		clear_error(bus, (uint16_t)(0xFF81 + i));
	}
	assert_int_equal(bus->node.emcy.lost, 0);
	clear_error(bus, 0xFF00);
	assert_int_equal(bus->node.emcy.lost, 1);
	bus_run_until_sent(bus, 100000);
	bus_expect(bus, "090 81 FF 01 00 00 00 00 00"); /* FF01h was dropped */
	bus_run(bus, 1000000);
	bus->seen = bus->sent_count - 1;
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
}

static void test_disabling_emcy_drops_the_messages_that_wait(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1015, 0, 2, 100), 0);
	set_error(bus, 0x5000, 0);
	clear_error(bus, 0x5000);
	bus_forget(bus);
	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x80000090), 0);
	bus_run(bus, 1000000);
	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x090), 0);
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
}

/* ---- NMT states -------------------------------------------------------------------------------------------------- */

static void test_errors_before_boot_up_are_sent_after_it(void **state)
{
	struct bus *bus = bus_new();

	assert_int_equal(canopen_init(&bus->node, &bus->od, &bus->port, NULL, BUS_NODE_ID), 0);
	canopen_error_set(&bus->node, 0x5000, 0, NULL, bus->now_us);
	bus_expect_nothing(bus);
	canopen_error_set(&bus->node, 0x8120, 0, NULL, bus->now_us);
	canopen_start(&bus->node, bus->now_us);
	bus_tick(bus);
	bus_expect(bus, "710 00");
	bus_expect(bus, "090 00 50 01 00 00 00 00 00");
	bus_expect(bus, "090 20 81 01 00 00 00 00 00");
	test_free(bus);
	(void)state;
}

static void test_in_stopped_no_emcy_is_sent_and_afterwards_the_most_recent_active_one(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "000 02 10");
	set_error(bus, 0x5000, 0);
	set_error(bus, 0x8120, 0);
	set_error(bus, 0x8130, 0);
	clear_error(bus, 0x8130);
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
	bus_send(bus, "000 80 10");
	bus_expect(bus, "090 20 81 01 00 00 00 00 00");
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
	assert_int_equal(bus_read(bus, 0x1003, 0), 3); /* the history has all of them */
}

static void test_an_error_that_ended_in_stopped_is_reset_afterwards(void **state)
{
	struct bus *bus = *state;

	set_error(bus, 0x5000, 0);
	bus_forget(bus);
	bus_send(bus, "000 02 10");
	clear_error(bus, 0x5000);
	bus_expect_nothing(bus);
	bus_exchange(bus, "000 01 10", "090 00 00 00 00 00 00 00 00");
}

static void test_an_error_within_stopped_is_not_sent_while_another_is_active(void **state)
{
	struct bus *bus = *state;

	set_error(bus, 0x5000, 0);
	bus_forget(bus);
	bus_send(bus, "000 02 10");
	set_error(bus, 0x8120, 0);
	clear_error(bus, 0x8120);
	bus_send(bus, "000 80 10");
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
}

static void test_an_error_within_stopped_is_followed_by_one_error_reset(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "000 02 10");
	for (int i = 0; i < 3; i++) {
		set_error(bus, 0x8120, 0);
		clear_error(bus, 0x8120);
	}
	bus_exchange(bus, "000 80 10", "090 00 00 00 00 00 00 00 00");
}

static void test_an_error_that_ended_in_stopped_is_not_sent_when_operational_ends_that_of_a_pdo(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "210 02", "090 10 82 11 00 14 01 08 00");
	bus_send(bus, "000 02 10");
	canopen_error_set(&bus->node, 0xFF13, 0, NULL, bus->now_us);
	canopen_error_clear(&bus->node, 0xFF13, bus->now_us);
	bus_expect_nothing(bus);
	bus_send(bus, "000 01 10");
	bus_expect_error_over(bus);
}

static void test_a_reset_drops_the_messages_that_wait_and_the_inhibit_time(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1015, 0, 2, 60000), 0);
	set_error(bus, 0x5000, 0);
	set_error(bus, 0x8120, 0);
	bus_forget(bus);
	bus_reset(bus, "000 82 10", "710 00");
	set_error(bus, 0x8130, 0);
	bus_expect(bus, "090 30 81 01 00 00 00 00 00");
	bus_run(bus, 10000000);
	bus_expect_nothing(bus);
}

static void test_an_error_sent_before_stopped_is_not_sent_again(void **state)
{
	struct bus *bus = *state;

	set_error(bus, 0x5000, 0);
	bus_forget(bus);
	bus_send(bus, "000 02 10");
	bus_send(bus, "000 80 10");
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
}

static void test_reset_node_clears_errors_and_history(void **state)
{
	struct bus *bus = *state;

	set_error(bus, 0x5000, 0x80);
	bus_forget(bus);
	bus_reset(bus, "000 81 10", "710 00");
	assert_int_equal(bus_read(bus, 0x1001, 0), 0);
	assert_int_equal(bus_read(bus, 0x1003, 0), 0);
	set_error(bus, 0x5000, 0x80);
	bus_expect(bus, "090 00 50 81 00 00 00 00 00");
}

static void test_reset_communication_keeps_the_errors_of_the_application(void **state)
{
	struct bus *bus = *state;

	set_error(bus, 0x5000, 0x80);
	bus_send(bus, "080 01"); /* wrong length: an error of the core */
	bus_forget(bus);
	bus_reset(bus, "000 82 10", "710 00");
	assert_int_equal(bus_read(bus, 0x1001, 0), 0x81);
	assert_int_equal(bus_read(bus, 0x1003, 0), 2);
	clear_error(bus, 0x5000);
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		PRE_OPERATIONAL(test_an_error_is_sent_at_once_with_the_generic_bit),
		PRE_OPERATIONAL(test_the_message_carries_register_bits_and_manufacturer_bytes),
		PRE_OPERATIONAL(test_an_error_is_sent_in_operational_too),
		PRE_OPERATIONAL(test_an_active_error_is_not_sent_again),
		PRE_OPERATIONAL(test_an_error_that_ended_and_recurs_is_sent_again),
		PRE_OPERATIONAL(test_the_error_register_has_the_bits_of_all_active_errors),
		PRE_OPERATIONAL(test_the_error_reset_is_sent_when_the_last_error_ends_and_not_before),
		PRE_OPERATIONAL(test_clearing_an_error_that_is_not_active_sends_nothing),
		PRE_OPERATIONAL(test_one_error_too_many_is_counted_as_lost),
		PRE_OPERATIONAL(test_the_history_has_the_newest_error_first),
		PRE_OPERATIONAL(test_an_unused_entry_of_the_history_has_no_data),
		PRE_OPERATIONAL(test_the_ninth_error_removes_the_first_from_the_history),
		cmocka_unit_test(test_a_history_of_one_entry_has_the_newest_error),
		cmocka_unit_test(test_a_device_without_a_history_sends_its_errors),
		PRE_OPERATIONAL(test_writing_0_clears_the_history_and_nothing_else_may_be_written),
		PRE_OPERATIONAL(test_an_error_that_recurs_moves_to_the_front_of_the_history),
		cmocka_unit_test(test_wrong_and_correct_frames_in_turn_are_one_error),
		OPERATIONAL(test_an_error_of_wrong_frames_is_forgotten_ten_seconds_after_the_last_one),
		OPERATIONAL(test_no_flood_sends_more_than_two_emcys_of_a_kind_within_a_second),
		PRE_OPERATIONAL(test_an_error_that_comes_and_goes_ends_once_a_second),
		PRE_OPERATIONAL(test_by_default_two_emcys_are_a_tenth_of_a_second_apart),
		PRE_OPERATIONAL(test_with_bit_31_no_emcy_is_sent_but_errors_are_recorded),
		PRE_OPERATIONAL(test_the_emcy_identifier_changes_only_while_it_is_invalid),
		PRE_OPERATIONAL(test_an_emcy_identifier_that_is_restricted_or_29_bits_long_is_refused),
		cmocka_unit_test(test_a_stored_emcy_identifier_that_is_not_allowed_is_made_invalid),
		PRE_OPERATIONAL(test_within_the_inhibit_time_messages_wait_and_none_is_lost),
		PRE_OPERATIONAL(test_after_the_inhibit_time_a_message_is_sent_at_once),
		PRE_OPERATIONAL(test_when_too_many_wait_the_oldest_is_dropped_and_counted),
		PRE_OPERATIONAL(test_disabling_emcy_drops_the_messages_that_wait),
		cmocka_unit_test(test_errors_before_boot_up_are_sent_after_it),
		PRE_OPERATIONAL(test_in_stopped_no_emcy_is_sent_and_afterwards_the_most_recent_active_one),
		PRE_OPERATIONAL(test_an_error_that_ended_in_stopped_is_reset_afterwards),
		PRE_OPERATIONAL(test_an_error_within_stopped_is_not_sent_while_another_is_active),
		PRE_OPERATIONAL(test_an_error_within_stopped_is_followed_by_one_error_reset),
		OPERATIONAL(test_an_error_that_ended_in_stopped_is_not_sent_when_operational_ends_that_of_a_pdo),
		PRE_OPERATIONAL(test_a_reset_drops_the_messages_that_wait_and_the_inhibit_time),
		PRE_OPERATIONAL(test_an_error_sent_before_stopped_is_not_sent_again),
		PRE_OPERATIONAL(test_reset_node_clears_errors_and_history),
		PRE_OPERATIONAL(test_reset_communication_keeps_the_errors_of_the_application),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
