/* Transmit PDOs: CiA 301, 7.2.2, 7.5.2.37 and 7.5.2.38. The default mapping of TPDO1 is 2100h:1-3 and 210Fh:1. */
#include "tests/scenario/bus.h"

#include <math.h>
#include <string.h>

#define NO_RTR	0x40000000u
#define INVALID 0x80000000u

/* Only TPDO1, with this type; the others are invalid. */
static void only_tpdo1(struct bus *bus, uint8_t type)
{
	for (uint16_t index = 0x1801; index <= 0x1803; index++)
		assert_int_equal(bus_write(bus, index, 1, 4, INVALID), 0);
	assert_int_equal(bus_write(bus, 0x1800, 2, 1, type), 0);
}

/* Writes a parameter that cannot change while the PDO is valid. */
static void set_tpdo1(struct bus *bus, uint8_t sub, size_t size, uint32_t value)
{
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, INVALID | 0x190), 0);
	assert_int_equal(bus_write(bus, 0x1800, sub, size, value), 0);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, NO_RTR | 0x190), 0);
}

static void set_acceleration(struct bus *bus, uint16_t l, uint16_t s, uint16_t t)
{
	bus_put(bus, 0x2100, 1, 2, l);
	bus_put(bus, 0x2100, 2, 2, s);
	bus_put(bus, 0x2100, 3, 2, t);
}

/* ---- synchronous ------------------------------------------------------------------------------------------------- */

static void test_one_sync_sends_all_four_pdos_with_one_sample(void **state)
{
	struct bus *bus = *state;

	set_acceleration(bus, 0x0102, 0x0304, 0xFFFE);
	bus_put(bus, 0x2101, 1, 2, 0x1122);
	bus_put(bus, 0x2101, 2, 2, 0x3344);
	bus_put(bus, 0x2101, 3, 2, 0x5566);
	bus_put(bus, 0x2102, 1, 2, 0x0A0B);
	bus_put(bus, 0x2102, 2, 2, 0x0C0D);
	bus_put(bus, 0x2102, 3, 2, 0x0E0F);
	bus_put(bus, 0x210F, 3, 2, 0x0001);
	bus_put(bus, 0x210F, 2, 4, 0xA1A2A3A4);
	bus_sample(bus, 0xBEEF);
	bus_expect_nothing(bus);
	bus_send(bus, "080");
	bus_expect(bus, "190 02 01 04 03 FE FF EF BE");
	bus_expect(bus, "290 22 11 44 33 66 55 EF BE");
	bus_expect(bus, "390 0B 0A 0D 0C 0F 0E EF BE");
	bus_expect(bus, "490 01 00 EF BE A4 A3 A2 A1");
	bus_expect_nothing(bus);
	assert_int_equal(bus->seen_us, bus->now_us);
}

static void test_a_pdo_carries_the_values_at_the_time_of_transmission(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 1);
	set_acceleration(bus, 1, 2, 3);
	bus_exchange(bus, "080", "190 01 00 02 00 03 00 00 00");
	set_acceleration(bus, 4, 5, 6);
	bus_exchange(bus, "080", "190 04 00 05 00 06 00 00 00");
}

static void test_a_mapping_changed_without_its_hooks_is_used_from_the_next_reset_on(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 1);
	bus_put(bus, 0x1A00, 0, 1, 200);
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
}

static void test_pdos_are_sent_in_operational_only(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1802, 2, 1, 254);
	bus_write(bus, 0x1803, 2, 1, 254);
	bus_write(bus, 0x1803, 5, 2, 100);
	bus_send(bus, "080");
	bus_sample(bus, 1);
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
	bus_send(bus, "000 02 10");
	bus_send(bus, "080");
	bus_sample(bus, 2);
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
	bus_send(bus, "000 01 10");
	bus_expect_nothing(bus);
	bus_send(bus, "080");
	bus_expect(bus, "190 00 00 00 00 00 00 02 00");
	bus_expect(bus, "290 00 00 00 00 00 00 02 00");
	bus_expect_nothing(bus);
}

static void test_type_n_is_sent_with_every_nth_sync(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 3);
	for (int i = 0; i < 4; i++) {
		bus_send(bus, "080");
		bus_send(bus, "080");
		bus_expect_nothing(bus);
		bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
	}
}

static void test_type_240_is_sent_with_every_240th_sync(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 240);
	for (int i = 0; i < 239; i++)
		bus_send(bus, "080");
	bus_expect_nothing(bus);
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
}

static void test_a_new_type_restarts_the_count_of_syncs(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 3);
	bus_send(bus, "080");
	bus_send(bus, "080");
	bus_write(bus, 0x1800, 2, 1, 2);
	bus_send(bus, "080");
	bus_expect_nothing(bus);
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
}

static void test_type_0_is_sent_with_the_sync_after_a_new_sample_and_only_then(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 0);
	bus_send(bus, "080");
	bus_expect_nothing(bus);
	bus_sample(bus, 7);
	bus_sample(bus, 8);
	bus_expect_nothing(bus);
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 08 00");
	bus_send(bus, "080");
	bus_expect_nothing(bus);
}

static void test_a_sample_before_operational_is_not_an_event(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 0);
	bus_sample(bus, 7);
	bus_send(bus, "000 01 10");
	bus_send(bus, "080");
	bus_expect_nothing(bus);
}

static void test_with_a_start_value_the_sync_that_has_it_counts_as_the_first(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 2);
	assert_int_equal(bus_write(bus, 0x1019, 0, 1, 10), 0);
	set_tpdo1(bus, 6, 1, 4);
	bus_send(bus, "000 01 10");
	bus_send(bus, "080 02");
	bus_send(bus, "080 03");
	bus_send(bus, "080 04");
	bus_expect_nothing(bus);
	bus_exchange(bus, "080 05", "190 00 00 00 00 00 00 00 00");
	bus_send(bus, "080 06");
	bus_expect_nothing(bus);
	bus_exchange(bus, "080 07", "190 00 00 00 00 00 00 00 00");
	bus_send(bus, "080 08");
	bus_exchange(bus, "080 09", "190 00 00 00 00 00 00 00 00");
	bus_send(bus, "080 0A");
	bus_exchange(bus, "080 01", "190 00 00 00 00 00 00 00 00");
}

static void test_the_start_value_applies_each_time_operational_is_entered(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 1);
	assert_int_equal(bus_write(bus, 0x1019, 0, 1, 10), 0);
	set_tpdo1(bus, 6, 1, 4);
	bus_send(bus, "000 01 10");
	bus_exchange(bus, "080 04", "190 00 00 00 00 00 00 00 00");
	bus_send(bus, "000 80 10");
	bus_send(bus, "000 01 10");
	bus_send(bus, "080 05");
	bus_expect_nothing(bus);
	bus_exchange(bus, "080 04", "190 00 00 00 00 00 00 00 00");
}

static void test_without_a_sync_counter_the_start_value_is_ignored(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 1);
	set_tpdo1(bus, 6, 1, 4);
	bus_send(bus, "000 01 10");
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
}

/* ---- event-driven ------------------------------------------------------------------------------------------------ */

static void test_types_254_and_255_are_sent_with_each_new_sample(void **state)
{
	struct bus *bus = *state;

	for (unsigned type = 254; type <= 255; type++) {
		only_tpdo1(bus, (uint8_t)type);
		bus_sample(bus, 1);
		bus_expect(bus, "190 00 00 00 00 00 00 01 00");
		bus_sample(bus, 2);
		bus_expect(bus, "190 00 00 00 00 00 00 02 00");
		bus_send(bus, "080");
		bus_run(bus, 1000000);
		bus_expect_nothing(bus);
	}
}

static void test_one_sample_sends_every_event_driven_pdo_before_the_call_returns(void **state)
{
	struct bus *bus = *state;

	for (uint16_t index = 0x1800; index <= 0x1803; index++)
		assert_int_equal(bus_write(bus, index, 2, 1, 254), 0);
	canopen_sample(&bus->node, bus->now_us);
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
	bus_expect(bus, "290 00 00 00 00 00 00 00 00");
	bus_expect(bus, "390 00 00 00 00 00 00 00 00");
	bus_expect(bus, "490 00 00 00 00 00 00 00 00");
	bus_expect_nothing(bus);
}

static void test_a_pdo_made_valid_again_has_no_inhibit_time_running(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 254);
	set_tpdo1(bus, 3, 2, 500);
	bus_sample(bus, 1);
	bus_expect(bus, "190 00 00 00 00 00 00 01 00");
	set_tpdo1(bus, 3, 2, 600);
	bus_sample(bus, 2);
	bus_expect(bus, "190 00 00 00 00 00 00 02 00");
}

static void test_within_the_inhibit_time_an_event_waits_and_then_carries_the_current_values(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 254);
	set_tpdo1(bus, 3, 2, 500); /* 50 ms */
	bus_sample(bus, 1);
	bus_expect(bus, "190 00 00 00 00 00 00 01 00");
	bus_run(bus, 10000);
	bus_sample(bus, 2);
	bus_run(bus, 10000);
	bus_sample(bus, 3);
	bus_run(bus, 29999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "190 00 00 00 00 00 00 03 00");
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
}

static void test_after_the_inhibit_time_an_event_is_sent_at_once(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 254);
	set_tpdo1(bus, 3, 2, 500);
	bus_sample(bus, 1);
	bus_expect(bus, "190 00 00 00 00 00 00 01 00");
	bus_run(bus, 50000);
	bus_sample(bus, 2);
	bus_expect(bus, "190 00 00 00 00 00 00 02 00");
}

static void test_the_event_timer_sends_without_an_event_and_counts_from_the_last_transmission(void **state)
{
	struct bus *bus = *state;
	uint64_t start_us = bus->now_us;

	only_tpdo1(bus, 254);
	assert_int_equal(bus_write(bus, 0x1800, 5, 2, 100), 0);
	bus_run(bus, 250000);
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
	assert_int_equal(bus->seen_us, start_us + 100000);
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
	assert_int_equal(bus->seen_us, start_us + 200000);
	bus_run(bus, 49999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
}

static void test_with_an_event_timer_the_pdo_is_periodic_and_samples_are_no_events(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 254);
	assert_int_equal(bus_write(bus, 0x1800, 5, 2, 50), 0);
	bus_sample(bus, 0); /* the first one is sent at once */
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
	uint64_t start_us = bus->seen_us;
	for (uint16_t i = 1; i <= 100; i++) {
		bus_run(bus, 10000);
		bus_sample(bus, i);
	}
	for (unsigned i = 1; i <= 20; i++) {
		assert_true(bus->seen < bus->sent_count);
		assert_int_equal(bus->sent[bus->seen++].t_us, start_us + 50000 * i);
	}
	bus_expect_nothing(bus);
}

static void test_a_periodic_pdo_keeps_its_phase_when_it_is_sent_a_little_late(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 254);
	uint64_t start_us = bus->now_us;
	assert_int_equal(bus_write(bus, 0x1800, 5, 2, 10), 0);
	for (unsigned i = 1; i <= 10; i++) {
		bus->now_us = start_us + 10000 * i + 300;
		bus_tick(bus);
		bus_expect(bus, "190 00 00 00 00 00 00 00 00");
		assert_int_equal(bus->deadline_us, start_us + 10000 * (i + 1));
	}
}

static void test_an_event_timer_below_the_inhibit_time_waits_for_it(void **state)
{
	struct bus *bus = *state;
	uint64_t sent_us;

	only_tpdo1(bus, 255);
	set_tpdo1(bus, 3, 2, 2000); /* 200 ms */
	assert_int_equal(bus_write(bus, 0x1800, 5, 2, 100), 0);
	bus_sample(bus, 1);
	bus_expect(bus, "190 00 00 00 00 00 00 01 00");
	sent_us = bus->seen_us;
	bus_run_until_sent(bus, 1000000);
	bus_expect(bus, "190 00 00 00 00 00 00 01 00");
	assert_int_equal(bus->seen_us, sent_us + 200000);
}

static void test_the_event_timer_may_change_while_the_pdo_is_valid(void **state)
{
	struct bus *bus = *state;
	uint64_t sent_us;

	only_tpdo1(bus, 254);
	bus_sample(bus, 1);
	bus_expect(bus, "190 00 00 00 00 00 00 01 00");
	sent_us = bus->seen_us;
	assert_int_equal(bus_write(bus, 0x1800, 5, 2, 1000), 0);
	bus_run(bus, 200000);
	assert_int_equal(bus_write(bus, 0x1800, 5, 2, 300), 0);
	bus_run_until_sent(bus, 1000000);
	bus_expect(bus, "190 00 00 00 00 00 00 01 00");
	assert_int_equal(bus->seen_us, sent_us + 300000);
	assert_int_equal(bus_write(bus, 0x1800, 5, 2, 0), 0);
	bus_run(bus, 10000000);
	bus_expect_nothing(bus);
}

static void test_a_synchronous_pdo_has_neither_event_timer_nor_inhibit_time(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 1);
	set_tpdo1(bus, 3, 2, 60000);
	assert_int_equal(bus_write(bus, 0x1800, 5, 2, 100), 0);
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
}

/* ---- change thresholds ------------------------------------------------------------------------------------------- */

static double threshold_of_3(void *ctx, const struct od_entry *entry)
{
	(void)ctx;
	return entry->index == 0x1001 ? INFINITY : 3;
}

/* TPDO1 by event, with 1001h, which never triggers, and behind it the object of this mapping entry. */
static void map_behind_error_register(struct bus *bus, uint32_t mapping)
{
	only_tpdo1(bus, 254);
	bus->node.device.change_threshold = threshold_of_3;
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, INVALID | 0x190), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 0), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 1, 4, 0x10010008), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 2, 4, mapping), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 2), 0);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, NO_RTR | 0x190), 0);
}

/* Whether a sample in which the mapped object has this value is an event. */
static bool is_sent(struct bus *bus, uint32_t mapping, uint32_t value)
{
	size_t before = bus->sent_count;

	bus_put(bus, (uint16_t)(mapping >> 16), (uint8_t)(mapping >> 8), (mapping & 0xFF) / 8, value);
	bus_sample(bus, 0);
	return bus->sent_count > before;
}

static void test_with_a_threshold_a_pdo_is_sent_when_its_value_of_any_type_changes_by_more(void **state)
{
	static const struct {
		uint32_t mapping, start, at_threshold, above, back_at_threshold, back_above;
	} cases[] = {
		{0x21230108, 100, 103, 104, 101, 100},					  /* UNSIGNED8 */
		{0x210F0310, 40000, 40003, 40004, 40001, 40000},			  /* UNSIGNED16 */
		{0x21000110, 0xFFFF, 2, 3, 0, 0xFFFF},					  /* INTEGER16: -1 */
		{0x21020420, 0xFFFFFFFE, 1, 2, 0xFFFFFFFF, 0xFFFFFFFE},			  /* INTEGER32: -2 */
		{0x21040120, 0xBF800000, 0x40000000, 0x40100000, 0xBF400000, 0xBF800000}, /* REAL32: -1 */
	};

	for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
		struct bus *bus = bus_new();

		bus_start(bus);
		bus_forget(bus);
		map_behind_error_register(bus, cases[i].mapping);
		bus_send(bus, "000 01 10");
		assert_true(is_sent(bus, cases[i].mapping, cases[i].start));
		assert_false(is_sent(bus, cases[i].mapping, cases[i].at_threshold));
		assert_true(is_sent(bus, cases[i].mapping, cases[i].above));
		assert_false(is_sent(bus, cases[i].mapping, cases[i].back_at_threshold));
		assert_true(is_sent(bus, cases[i].mapping, cases[i].back_above));
		test_free(bus);
	}
	(void)state;
}

/* A value of more than 4 bytes has no distance: any change of it is one. */
static void test_with_a_threshold_a_pdo_of_8_bytes_is_sent_when_they_change(void **state)
{
	static const uint64_t values[] = {0, 1, UINT64_C(1) << 63};
	struct bus *bus = bus_new();
	uint64_t *utc = od_value(&bus->od, 0x2117, 3, sizeof(*utc));

	bus_start(bus);
	bus_forget(bus);
	only_tpdo1(bus, 254);
	bus->node.device.change_threshold = threshold_of_3;
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, INVALID | 0x190), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 0), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 1, 4, 0x21170340), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 1), 0);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, NO_RTR | 0x190), 0);
	bus_send(bus, "000 01 10");
	for (size_t i = 0; i < sizeof(values) / sizeof(values[0]); i++)
		for (int again = 0; again < 2; again++) {
			size_t before = bus->sent_count;

			*utc = values[i];
			bus_sample(bus, 0);
			assert_int_equal(bus->sent_count - before, !again);
		}
	test_free(bus);
	(void)state;
}

/* ---- communication parameters ------------------------------------------------------------------------------------ */

static void test_an_invalid_pdo_is_not_sent(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 1);
	bus_exchange(bus, "610 23 00 18 01 90 01 00 C0", "590 60 00 18 01 00 00 00 00");
	bus_send(bus, "080");
	bus_expect_nothing(bus);
	bus_exchange(bus, "610 23 00 18 01 90 01 00 40", "590 60 00 18 01 00 00 00 00");
	bus_exchange(bus, "080", "190 00 00 00 00 00 00 00 00");
}

static void test_the_identifier_changes_only_while_the_pdo_is_invalid(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 1);
	bus_exchange(bus, "610 23 00 18 01 91 01 00 40", "590 80 00 18 01 30 00 09 06");
	assert_int_equal(bus_read(bus, 0x1800, 1), NO_RTR | 0x190);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, INVALID | NO_RTR | 0x190), 0);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, NO_RTR | 0x1A5), 0);
	bus_exchange(bus, "080", "1A5 00 00 00 00 00 00 00 00");
}

static void test_the_identifier_may_change_together_with_the_valid_bit(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1800, 1, 4, INVALID | 0x1A5), 0);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, 0x1A6), 0);
	assert_int_equal(bus_read(bus, 0x1800, 1), 0x1A6);
}

static void test_the_no_rtr_bit_may_change_while_the_pdo_is_valid(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1800, 1, 4, 0x190), 0);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, NO_RTR | 0x190), 0);
}

static void test_29_bit_identifiers_are_refused(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1800, 1, 4, INVALID | 0x20000190), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, INVALID | 0x00010190), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, INVALID), 0);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, 0x20000190), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, 0x00000990), 0x06090030);
}

static void test_every_restricted_identifier_is_refused_and_every_other_is_not(void **state)
{
	struct bus *bus = *state;

	for (uint32_t id = 0; id <= 0x7FF; id++) {
		bool restricted = id <= 0x07F || (id >= 0x101 && id <= 0x180) || (id >= 0x581 && id <= 0x5FF) ||
				  (id >= 0x601 && id <= 0x67F) || (id >= 0x6E0 && id <= 0x6FF) ||
				  (id >= 0x701 && id <= 0x77F) || id >= 0x780;

		assert_int_equal(bus_write(bus, 0x1800, 1, 4, INVALID), 0);
		assert_int_equal(bus_write(bus, 0x1800, 1, 4, NO_RTR | id), restricted ? 0x06090030 : 0);
		bus->sent_count = bus->seen = 0;
	}
}

static void test_every_type_but_the_reserved_ones_is_accepted(void **state)
{
	struct bus *bus = *state;

	for (uint32_t type = 0; type <= 255; type++)
		assert_int_equal(bus_write(bus, 0x1800, 2, 1, type), type >= 241 && type <= 251 ? 0x06090030 : 0);
}

static void test_inhibit_time_and_start_value_do_not_change_while_the_pdo_is_valid(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1800, 3, 2, 100), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1800, 6, 1, 1), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1800, 3, 2, 0), 0); /* no change */
	assert_int_equal(bus_write(bus, 0x1800, 6, 1, 0), 0);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, INVALID), 0);
	assert_int_equal(bus_write(bus, 0x1800, 3, 2, 100), 0);
	assert_int_equal(bus_write(bus, 0x1800, 6, 1, 240), 0);
	assert_int_equal(bus_write(bus, 0x1800, 6, 1, 241), 0x06090031);
	assert_int_equal(bus_read(bus, 0x1800, 3), 100);
	assert_int_equal(bus_read(bus, 0x1800, 6), 240);
}

static void test_sub_index_4_does_not_exist(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 40 00 18 04 00 00 00 00", "590 80 00 18 04 11 00 09 06");
	assert_int_equal(bus_write(bus, 0x1800, 4, 1, 0), 0x06090011);
}

static void test_the_parameters_are_checked_in_operational_too(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1800, 1, 4, NO_RTR | 0x1A5), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1800, 2, 1, 250), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 0), 0x06010000);
}

/* ---- mapping ----------------------------------------------------------------------------------------------------- */

static void test_the_mapping_procedure_changes_what_is_sent(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 1);
	bus_put(bus, 0x210F, 2, 4, 0xA1A2A3A4);
	bus_exchange(bus, "610 23 00 18 01 90 01 00 C0", "590 60 00 18 01 00 00 00 00");
	bus_exchange(bus, "610 2F 00 1A 00 00 00 00 00", "590 60 00 1A 00 00 00 00 00");
	bus_exchange(bus, "610 23 00 1A 01 20 02 0F 21", "590 60 00 1A 01 00 00 00 00"); /* 210Fh:2, 32 */
	bus_exchange(bus, "610 23 00 1A 02 08 00 01 10", "590 60 00 1A 02 00 00 00 00"); /* 1001h:0, 8 */
	bus_exchange(bus, "610 2F 00 1A 00 02 00 00 00", "590 60 00 1A 00 00 00 00 00");
	bus_exchange(bus, "610 23 00 18 01 90 01 00 40", "590 60 00 18 01 00 00 00 00");
	bus_send(bus, "000 01 10");
	bus_exchange(bus, "080", "190 A4 A3 A2 A1 00");
}

static void test_eight_bytes_may_be_mapped_and_nine_may_not(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1800, 1, 4, INVALID);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 0), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 5, 4, 0x10010008), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 5), 0x06040042);
	assert_int_equal(bus_read(bus, 0x1A00, 0), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 4), 0);
}

static void test_eight_objects_of_one_byte_may_be_mapped(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 1);
	bus_put(bus, 0x1001, 0, 1, 0xAB);
	bus_write(bus, 0x1800, 1, 4, INVALID);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 0), 0);
	for (uint8_t sub = 1; sub <= 8; sub++)
		assert_int_equal(bus_write(bus, 0x1A00, sub, 4, 0x10010008), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 8), 0);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, NO_RTR | 0x190), 0);
	bus_exchange(bus, "080", "190 AB AB AB AB AB AB AB AB");
}

static void test_more_than_eight_objects_are_too_many(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1800, 1, 4, INVALID);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 0), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 9), 0x06040042);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 254), 0x06090031); /* no multiplexed PDO */
}

static void test_an_unknown_object_cannot_be_mapped(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1800, 1, 4, INVALID);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 0), 0);
	bus_exchange(bus, "610 23 00 1A 01 10 01 FF 2F", "590 80 00 1A 01 00 00 02 06");
	bus_exchange(bus, "610 23 00 1A 01 10 09 00 21", "590 80 00 1A 01 00 00 02 06");
	bus_exchange(bus, "610 23 00 1A 01 08 00 05 00", "590 80 00 1A 01 00 00 02 06"); /* a dummy entry */
}

static void test_an_object_that_is_not_mappable_cannot_be_mapped(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1800, 1, 4, INVALID);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 0), 0);
	bus_exchange(bus, "610 23 00 1A 01 20 00 00 10", "590 80 00 1A 01 41 00 04 06"); /* 1000h */
	bus_exchange(bus, "610 23 00 1A 01 20 01 00 20", "590 80 00 1A 01 41 00 04 06"); /* 2000h:1 */
}

static void test_an_object_can_only_be_mapped_with_its_full_length(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1800, 1, 4, INVALID);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 0), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 1, 4, 0x21000108), 0x06040041);
	assert_int_equal(bus_write(bus, 0x1A00, 1, 4, 0x21000120), 0x06040041);
	assert_int_equal(bus_write(bus, 0x1A00, 1, 4, 0x21000100), 0x06040041);
}

static void test_an_entry_may_be_0_unless_it_is_counted(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1800, 1, 4, INVALID);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 0), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 3, 4, 0), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 3), 0x06020000);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 2), 0);
}

static void test_the_mapping_of_a_valid_pdo_cannot_be_written(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 2F 00 1A 00 00 00 00 00", "590 80 00 1A 00 00 00 01 06");
	bus_exchange(bus, "610 23 00 1A 01 10 01 00 21", "590 80 00 1A 01 00 00 01 06");
	assert_int_equal(bus_read(bus, 0x1A00, 0), 4);
}

static void test_an_entry_cannot_be_written_while_sub_index_0_is_not_0(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1800, 1, 4, INVALID);
	bus_exchange(bus, "610 23 00 1A 01 10 01 01 21", "590 80 00 1A 01 00 00 01 06");
	assert_int_equal(bus_read(bus, 0x1A00, 1), 0x21000110);
}

static void test_a_pdo_with_nothing_mapped_is_not_sent(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 1);
	bus_write(bus, 0x1800, 1, 4, INVALID | 0x190);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 0), 0);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, 0x190), 0);
	bus_send(bus, "080");
	bus_sample(bus, 1);
	bus_expect_nothing(bus);
}

static void test_reset_communication_restores_the_default_mapping(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 1);
	bus_write(bus, 0x1800, 1, 4, INVALID);
	bus_write(bus, 0x1A00, 0, 1, 0);
	bus_reset(bus, "000 82 10", "710 00");
	bus_send(bus, "000 01 10");
	bus_send(bus, "080");
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
	bus_expect(bus, "290 00 00 00 00 00 00 00 00");
}

/* ---- unusable stored values (of another version, or of a hand-written file) -------------------------------------- */

static void expect_tpdo1_refused_at_start(struct bus *bus)
{
	bus_start(bus);
	bus_expect(bus, "710 00");
	bus_expect(bus, "090 00 63 01 00 18 00 00 00"); /* data set, 1800h */
	assert_int_equal(bus_read(bus, 0x1800, 1), INVALID | NO_RTR | (bus->values.tpdo1_communication.cob_id & 0x7FF));
	bus_send(bus, "000 01 10");
	bus_send(bus, "080");
	bus_expect(bus, "290 00 00 00 00 00 00 00 00");
	test_free(bus);
}

static void test_a_stored_mapping_of_an_unknown_object_makes_the_pdo_invalid_and_raises_6300h(void **state)
{
	struct bus *bus = bus_new();

	bus_put(bus, 0x1A00, 2, 4, 0x2FFF0110);
	expect_tpdo1_refused_at_start(bus);
	(void)state;
}

static void test_a_stored_mapping_that_is_too_long_makes_the_pdo_invalid_and_raises_6300h(void **state)
{
	struct bus *bus = bus_new();

	bus_put(bus, 0x1A00, 5, 4, 0x21000110);
	bus_put(bus, 0x1A00, 0, 1, 5);
	expect_tpdo1_refused_at_start(bus);
	bus = bus_new();
	bus_put(bus, 0x1A00, 0, 1, 200);
	expect_tpdo1_refused_at_start(bus);
	(void)state;
}

static void test_a_stored_identifier_or_type_that_is_not_allowed_makes_the_pdo_invalid_and_raises_6300h(void **state)
{
	struct bus *bus = bus_new();

	bus_put(bus, 0x1800, 1, 4, NO_RTR);
	expect_tpdo1_refused_at_start(bus);
	bus = bus_new();
	bus_put(bus, 0x1800, 2, 1, 251);
	expect_tpdo1_refused_at_start(bus);
	(void)state;
}

static void test_the_error_of_a_stored_mapping_ends_with_a_reset_to_a_valid_one(void **state)
{
	struct bus *bus = bus_new();

	bus_put(bus, 0x1A03, 1, 4, 0x2FFF0110);
	bus_start(bus);
	bus_expect(bus, "710 00");
	bus_expect(bus, "090 00 63 01 03 18 00 00 00");
	bus->power_on.tpdo4_mapping.object_1 = 0x210F0310;
	bus_reset(bus, "000 82 10", "710 00");
	assert_int_equal(bus_read(bus, 0x1001, 0), 0);
	assert_int_equal(bus_read(bus, 0x1803, 1), NO_RTR | 0x490);
	test_free(bus);
	(void)state;
}

static void test_a_pdo_with_a_bad_mapping_cannot_be_made_valid(void **state)
{
	struct bus *bus = bus_new();

	bus_put(bus, 0x1A00, 2, 4, 0x2FFF0110);
	bus_start(bus);
	bus_forget(bus);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, NO_RTR | 0x190), 0x06020000);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 0), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 2, 4, 0x21000210), 0);
	assert_int_equal(bus_write(bus, 0x1A00, 0, 1, 4), 0);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, NO_RTR | 0x190), 0);
	test_free(bus);
	(void)state;
}

/* ---- remote request (RTR) ---------------------------------------------------------------------------------------- */

/* Only TPDO1, with this type, and without the no-RTR bit. */
static void requestable(struct bus *bus, uint8_t type)
{
	only_tpdo1(bus, type);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, 0x190), 0);
}

static void test_type_253_is_sent_on_request_with_the_current_values(void **state)
{
	struct bus *bus = *state;

	requestable(bus, 253);
	set_acceleration(bus, 1, 2, 3);
	bus_send(bus, "080");
	bus_sample(bus, 7);
	bus_expect_nothing(bus);
	bus_exchange(bus, "190 R", "190 01 00 02 00 03 00 07 00");
	set_acceleration(bus, 4, 5, 6);
	bus_exchange(bus, "190 R", "190 04 00 05 00 06 00 07 00");
}

static void test_type_252_is_sent_on_request_with_the_values_of_the_last_sync(void **state)
{
	struct bus *bus = *state;

	requestable(bus, 252);
	set_acceleration(bus, 1, 2, 3);
	bus_send(bus, "080");
	bus_expect_nothing(bus);
	set_acceleration(bus, 4, 5, 6);
	bus_exchange(bus, "190 R", "190 01 00 02 00 03 00 00 00");
	bus_exchange(bus, "190 R", "190 01 00 02 00 03 00 00 00");
	bus_send(bus, "080");
	bus_exchange(bus, "190 R", "190 04 00 05 00 06 00 00 00");
}

static void test_type_252_is_not_sent_before_the_first_sync(void **state)
{
	struct bus *bus = *state;

	requestable(bus, 252);
	bus_send(bus, "190 R");
	bus_expect_nothing(bus);
}

static void test_type_252_is_not_sent_before_a_sync_in_the_new_operational_state(void **state)
{
	struct bus *bus = *state;

	requestable(bus, 252);
	bus_send(bus, "080");
	bus_send(bus, "000 80 10");
	bus_send(bus, "000 01 10");
	bus_send(bus, "190 R");
	bus_expect_nothing(bus);
}

static void test_an_event_driven_pdo_is_sent_on_request_too(void **state)
{
	struct bus *bus = *state;

	requestable(bus, 254);
	bus_exchange(bus, "190 R", "190 00 00 00 00 00 00 00 00");
}

/* .. before the next frame, which stops it. */
static void test_an_event_driven_pdo_is_sent_at_once_on_request(void **state)
{
	const struct can_msg request = {.id = 0x190, .remote = true}, stop = {.data = {2, 0x10}, .len = 2};
	struct bus *bus = *state;

	requestable(bus, 254);
	canopen_receive(&bus->node, &request, bus->now_us);
	canopen_receive(&bus->node, &stop, bus->now_us);
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
}

static void test_a_request_within_the_inhibit_time_waits_for_it(void **state)
{
	struct bus *bus = *state;

	requestable(bus, 254);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, INVALID | 0x190), 0);
	assert_int_equal(bus_write(bus, 0x1800, 3, 2, 100), 0);
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, 0x190), 0);
	bus_exchange(bus, "190 R", "190 00 00 00 00 00 00 00 00");
	bus_send(bus, "190 R");
	bus_run(bus, 9999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
}

static void test_a_synchronous_pdo_is_not_sent_on_request(void **state)
{
	struct bus *bus = *state;

	requestable(bus, 1);
	bus_send(bus, "190 R");
	bus_expect_nothing(bus);
}

static void test_with_the_no_rtr_bit_a_pdo_is_not_sent_on_request(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 253);
	bus_send(bus, "190 R");
	bus_expect_nothing(bus);
}

static void test_pdos_are_sent_on_request_in_operational_only(void **state)
{
	struct bus *bus = *state;

	requestable(bus, 253);
	bus_send(bus, "000 80 10");
	bus_send(bus, "190 R");
	bus_send(bus, "000 02 10");
	bus_send(bus, "190 R");
	bus_expect_nothing(bus);
}

static void test_the_receive_filter_has_the_remote_requests(void **state)
{
	struct bus *bus = *state;

	requestable(bus, 253);
	assert_true(bus_listens_to(bus, 0x190));
	assert_int_equal(bus_write(bus, 0x1800, 1, 4, INVALID | 0x190), 0);
	assert_false(bus_listens_to(bus, 0x190));
}

/* ---- TPDO5 to TPDO8 ---------------------------------------------------------------------------------------------- */

static void test_tpdo_5_to_8_are_invalid_and_empty_until_configured(void **state)
{
	struct bus *bus = *state;

	for (uint16_t i = 4; i < 8; i++) {
		assert_int_equal(bus_read(bus, (uint16_t)(0x1800 + i), 1), INVALID);
		assert_int_equal(bus_read(bus, (uint16_t)(0x1A00 + i), 0), 0);
	}
}

static void test_tpdo_8_can_be_configured_and_is_sent_after_the_others(void **state)
{
	struct bus *bus = *state;

	only_tpdo1(bus, 1);
	assert_int_equal(bus_write(bus, 0x1A07, 1, 4, 0x210F0110), 0);
	assert_int_equal(bus_write(bus, 0x1A07, 0, 1, 1), 0);
	assert_int_equal(bus_write(bus, 0x1807, 1, 4, NO_RTR | 0x1E0), 0);
	bus_sample(bus, 0x1234);
	bus_send(bus, "080");
	bus_expect(bus, "190 00 00 00 00 00 00 34 12");
	bus_expect(bus, "1E0 34 12");
	bus_expect_nothing(bus);
}

static void test_a_pdo_is_not_made_valid_without_an_identifier(void **state)
{
	assert_int_equal(bus_write(*state, 0x1804, 1, 4, 0), 0x06090030);
}

/* The node's memory was replaced by that of another process, where the dictionary is elsewhere. */
static void test_what_pdos_map_is_looked_up_again_after_the_state_was_restored(void **state)
{
	struct bus *bus = *state;
	struct pdos *pdos = &bus->node.pdos;

	set_acceleration(bus, 1, 2, 3);
	for (size_t i = 0; i < pdos->rpdo_count; i++)
		memset(pdos->rpdo[i].pdo.mapped, 0, sizeof(pdos->rpdo[i].pdo.mapped));
	for (size_t i = 0; i < pdos->tpdo_count; i++)
		memset(pdos->tpdo[i].pdo.mapped, 0, sizeof(pdos->tpdo[i].pdo.mapped));
	canopen_restored(&bus->node);
	bus_send(bus, "080");
	bus_expect(bus, "190 01 00 02 00 03 00 00 00");
	bus_expect(bus, "290 00 00 00 00 00 00 00 00");
	bus_expect(bus, "390 00 00 00 00 00 00 00 00");
	bus_expect(bus, "490 00 00 00 00 00 00 00 00");
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		OPERATIONAL(test_what_pdos_map_is_looked_up_again_after_the_state_was_restored),
		OPERATIONAL(test_one_sync_sends_all_four_pdos_with_one_sample),
		OPERATIONAL(test_a_pdo_carries_the_values_at_the_time_of_transmission),
		OPERATIONAL(test_a_mapping_changed_without_its_hooks_is_used_from_the_next_reset_on),
		PRE_OPERATIONAL(test_pdos_are_sent_in_operational_only),
		OPERATIONAL(test_type_n_is_sent_with_every_nth_sync),
		OPERATIONAL(test_type_240_is_sent_with_every_240th_sync),
		OPERATIONAL(test_a_new_type_restarts_the_count_of_syncs),
		OPERATIONAL(test_type_0_is_sent_with_the_sync_after_a_new_sample_and_only_then),
		PRE_OPERATIONAL(test_a_sample_before_operational_is_not_an_event),
		PRE_OPERATIONAL(test_with_a_start_value_the_sync_that_has_it_counts_as_the_first),
		PRE_OPERATIONAL(test_the_start_value_applies_each_time_operational_is_entered),
		PRE_OPERATIONAL(test_without_a_sync_counter_the_start_value_is_ignored),
		OPERATIONAL(test_types_254_and_255_are_sent_with_each_new_sample),
		OPERATIONAL(test_one_sample_sends_every_event_driven_pdo_before_the_call_returns),
		OPERATIONAL(test_a_pdo_made_valid_again_has_no_inhibit_time_running),
		OPERATIONAL(test_within_the_inhibit_time_an_event_waits_and_then_carries_the_current_values),
		OPERATIONAL(test_after_the_inhibit_time_an_event_is_sent_at_once),
		OPERATIONAL(test_the_event_timer_sends_without_an_event_and_counts_from_the_last_transmission),
		OPERATIONAL(test_with_an_event_timer_the_pdo_is_periodic_and_samples_are_no_events),
		OPERATIONAL(test_a_periodic_pdo_keeps_its_phase_when_it_is_sent_a_little_late),
		OPERATIONAL(test_an_event_timer_below_the_inhibit_time_waits_for_it),
		OPERATIONAL(test_the_event_timer_may_change_while_the_pdo_is_valid),
		OPERATIONAL(test_a_synchronous_pdo_has_neither_event_timer_nor_inhibit_time),
		cmocka_unit_test(test_with_a_threshold_a_pdo_is_sent_when_its_value_of_any_type_changes_by_more),
		cmocka_unit_test(test_with_a_threshold_a_pdo_of_8_bytes_is_sent_when_they_change),
		OPERATIONAL(test_an_invalid_pdo_is_not_sent),
		OPERATIONAL(test_the_identifier_changes_only_while_the_pdo_is_invalid),
		PRE_OPERATIONAL(test_the_identifier_may_change_together_with_the_valid_bit),
		PRE_OPERATIONAL(test_the_no_rtr_bit_may_change_while_the_pdo_is_valid),
		PRE_OPERATIONAL(test_29_bit_identifiers_are_refused),
		PRE_OPERATIONAL(test_every_restricted_identifier_is_refused_and_every_other_is_not),
		PRE_OPERATIONAL(test_every_type_but_the_reserved_ones_is_accepted),
		PRE_OPERATIONAL(test_inhibit_time_and_start_value_do_not_change_while_the_pdo_is_valid),
		PRE_OPERATIONAL(test_sub_index_4_does_not_exist),
		OPERATIONAL(test_the_parameters_are_checked_in_operational_too),
		PRE_OPERATIONAL(test_the_mapping_procedure_changes_what_is_sent),
		PRE_OPERATIONAL(test_eight_bytes_may_be_mapped_and_nine_may_not),
		OPERATIONAL(test_eight_objects_of_one_byte_may_be_mapped),
		PRE_OPERATIONAL(test_more_than_eight_objects_are_too_many),
		PRE_OPERATIONAL(test_an_unknown_object_cannot_be_mapped),
		PRE_OPERATIONAL(test_an_object_that_is_not_mappable_cannot_be_mapped),
		PRE_OPERATIONAL(test_an_object_can_only_be_mapped_with_its_full_length),
		PRE_OPERATIONAL(test_an_entry_may_be_0_unless_it_is_counted),
		PRE_OPERATIONAL(test_the_mapping_of_a_valid_pdo_cannot_be_written),
		PRE_OPERATIONAL(test_an_entry_cannot_be_written_while_sub_index_0_is_not_0),
		OPERATIONAL(test_a_pdo_with_nothing_mapped_is_not_sent),
		PRE_OPERATIONAL(test_reset_communication_restores_the_default_mapping),
		cmocka_unit_test(test_a_stored_mapping_of_an_unknown_object_makes_the_pdo_invalid_and_raises_6300h),
		cmocka_unit_test(test_a_stored_mapping_that_is_too_long_makes_the_pdo_invalid_and_raises_6300h),
		cmocka_unit_test(
			test_a_stored_identifier_or_type_that_is_not_allowed_makes_the_pdo_invalid_and_raises_6300h),
		cmocka_unit_test(test_the_error_of_a_stored_mapping_ends_with_a_reset_to_a_valid_one),
		cmocka_unit_test(test_a_pdo_with_a_bad_mapping_cannot_be_made_valid),
		OPERATIONAL(test_type_253_is_sent_on_request_with_the_current_values),
		OPERATIONAL(test_type_252_is_sent_on_request_with_the_values_of_the_last_sync),
		OPERATIONAL(test_type_252_is_not_sent_before_the_first_sync),
		OPERATIONAL(test_type_252_is_not_sent_before_a_sync_in_the_new_operational_state),
		OPERATIONAL(test_an_event_driven_pdo_is_sent_at_once_on_request),
		OPERATIONAL(test_an_event_driven_pdo_is_sent_on_request_too),
		OPERATIONAL(test_a_request_within_the_inhibit_time_waits_for_it),
		OPERATIONAL(test_a_synchronous_pdo_is_not_sent_on_request),
		OPERATIONAL(test_with_the_no_rtr_bit_a_pdo_is_not_sent_on_request),
		OPERATIONAL(test_pdos_are_sent_on_request_in_operational_only),
		OPERATIONAL(test_the_receive_filter_has_the_remote_requests),
		OPERATIONAL(test_tpdo_5_to_8_are_invalid_and_empty_until_configured),
		OPERATIONAL(test_tpdo_8_can_be_configured_and_is_sent_after_the_others),
		OPERATIONAL(test_a_pdo_is_not_made_valid_without_an_identifier),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
