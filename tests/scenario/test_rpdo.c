/* Receive PDOs: CiA 301, 7.2.2, 7.5.2.35 and 7.5.2.36. By default RPDO1 has velocity_aid.x16, y16, z16 and sigma16
 * (2070h:5 to 8), RPDO2 yaw_aid.yaw and sigma (2071h, REAL32), RPDO3 attitude_reset.roll16, pitch16, yaw16 and command
 * (2072h:4 to 7), RPDO4 commands (2073h). */
#include "tests/scenario/bus.h"

#define INVALID 0x80000000u

static void expect_velocity(struct bus *bus, int x, int y, int z, unsigned sigma)
{
	assert_int_equal(bus->values.velocity_aid.x16, x);
	assert_int_equal(bus->values.velocity_aid.y16, y);
	assert_int_equal(bus->values.velocity_aid.z16, z);
	assert_int_equal(bus->values.velocity_aid.sigma16, sigma);
}

/* Makes RPDO1 invalid, and valid again: some parameters cannot change while it is valid. */
static void invalidate(struct bus *bus)
{
	assert_int_equal(bus_write(bus, 0x1400, 1, 4, INVALID | 0x210), 0);
}

static void validate(struct bus *bus)
{
	assert_int_equal(bus_write(bus, 0x1400, 1, 4, 0x210), 0);
}

static void begin_mapping(struct bus *bus)
{
	invalidate(bus);
	assert_int_equal(bus_write(bus, 0x1600, 0, 1, 0), 0);
}

static void end_mapping(struct bus *bus, uint8_t count)
{
	assert_int_equal(bus_write(bus, 0x1600, 0, 1, count), 0);
	validate(bus);
}

/* ---- reception --------------------------------------------------------------------------------------------------- */

static void test_the_four_rpdos_exist_by_default_with_the_predefined_identifiers(void **state)
{
	struct bus *bus = *state;

	for (uint16_t i = 0; i < 4; i++) {
		assert_int_equal(bus_read(bus, (uint16_t)(0x1400 + i), 1), 0x210u + 0x100u * i);
		assert_true(bus_listens_to(bus, 0x210u + 0x100u * i));
	}
}

static void test_a_pdo_is_written_into_the_dictionary_little_endian_and_signed(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "210 02 01 FE FF 00 80 34 12");
	expect_velocity(bus, 0x0102, -2, -32768, 0x1234);
	bus_expect_nothing(bus);
}

static void test_real_values_are_received(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "310 00 00 C0 BF 00 00 00 3F");
	assert_true(bus->values.yaw_aid.yaw == -1.5f);
	assert_true(bus->values.yaw_aid.sigma == 0.5f);
}

static void test_pdos_are_received_in_operational_only(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "210 01 00 01 00 01 00 01 00");
	bus_send(bus, "000 02 10");
	bus_send(bus, "210 01 00 01 00 01 00 01 00");
	expect_velocity(bus, 0, 0, 0, 0);
	bus_send(bus, "000 01 10");
	expect_velocity(bus, 0, 0, 0, 0);
	bus_send(bus, "210 01 00 01 00 01 00 01 00");
	expect_velocity(bus, 1, 1, 1, 1);
}

static void test_an_invalid_pdo_is_neither_received_nor_in_the_receive_filter(void **state)
{
	struct bus *bus = *state;

	invalidate(bus);
	assert_false(bus_listens_to(bus, 0x210));
	bus_send(bus, "210 01 00 01 00 01 00 01 00");
	bus_send(bus, "210 01");
	expect_velocity(bus, 0, 0, 0, 0);
	bus_expect_nothing(bus);
}

static void test_a_pdo_with_nothing_mapped_is_not_received(void **state)
{
	struct bus *bus = *state;

	begin_mapping(bus);
	validate(bus);
	assert_false(bus_listens_to(bus, 0x210));
	bus_send(bus, "210 01 00");
	bus_expect_nothing(bus);
}

static void test_a_new_identifier_is_received_at_once(void **state)
{
	struct bus *bus = *state;

	invalidate(bus);
	assert_int_equal(bus_write(bus, 0x1400, 1, 4, 0x1A5), 0);
	assert_true(bus_listens_to(bus, 0x1A5));
	bus_send(bus, "210 07 00 07 00 07 00 07 00");
	bus_send(bus, "1A5 01 00 02 00 03 00 04 00");
	expect_velocity(bus, 1, 2, 3, 4);
}

/* CiA 301, 7.3.5 restricts 701h to 7FFh. */
static void test_a_pdo_may_have_the_highest_identifier_that_is_not_restricted(void **state)
{
	struct bus *bus = *state;

	invalidate(bus);
	assert_int_equal(bus_write(bus, 0x1400, 1, 4, 0x700), 0);
	bus_send(bus, "700 01 00 02 00 03 00 04 00");
	expect_velocity(bus, 1, 2, 3, 4);
}

static void test_two_pdos_may_share_an_identifier(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 1, 4, INVALID), 0);
	assert_int_equal(bus_write(bus, 0x1403, 1, 4, 0x210), 0);
	bus_send(bus, "210 05 00 02 00 03 00 04 00"); /* RPDO4 uses the first two bytes, and reports the rest */
	bus_expect(bus, "090 20 82 11 03 14 08 02 00");
	expect_velocity(bus, 5, 2, 3, 4);
	assert_int_equal(bus->values.commands, 5);
}

static void test_remote_and_29_bit_frames_are_not_pdos(void **state)
{
	struct bus *bus = *state;
	const struct can_msg extended = {.id = 0x210, .len = 8, .extended = true, .data = {1, 1, 1, 1, 1, 1, 1, 1}};

	bus_send(bus, "210 R");
	bus_send_msg(bus, &extended);
	expect_velocity(bus, 0, 0, 0, 0);
	bus_expect_nothing(bus);
}

static void test_reset_communication_restores_the_default_parameters(void **state)
{
	struct bus *bus = *state;

	begin_mapping(bus);
	assert_int_equal(bus_write(bus, 0x1401, 2, 1, 1), 0);
	bus_reset(bus, "000 82 10", "710 00");
	bus_send(bus, "000 01 10");
	bus_send(bus, "210 01 00 02 00 03 00 04 00");
	expect_velocity(bus, 1, 2, 3, 4);
	assert_int_equal(bus_read(bus, 0x1401, 2), 254);
}

/* ---- synchronous ------------------------------------------------------------------------------------------------- */

static void test_types_254_and_255_are_applied_at_once(void **state)
{
	struct bus *bus = *state;

	for (unsigned type = 254; type <= 255; type++) {
		assert_int_equal(bus_write(bus, 0x1403, 2, 1, type), 0);
		bus_send(bus, "510 05 00");
		assert_int_equal(bus->values.commands, 5);
		bus_send(bus, "510 00 00");
	}
}

static void test_types_0_to_240_are_all_applied_at_the_next_sync(void **state)
{
	struct bus *bus = *state;
	static const uint8_t types[] = {0, 1, 2, 239, 240};

	for (size_t i = 0; i < sizeof(types); i++) {
		assert_int_equal(bus_write(bus, 0x1403, 2, 1, types[i]), 0);
		bus_send(bus, "510 05 00");
		assert_int_equal(bus->values.commands, 0);
		bus_send(bus, "080");
		assert_int_equal(bus->values.commands, 5);
		bus_send(bus, "510 00 00");
		bus_send(bus, "080");
		bus_forget(bus);
	}
}

static void test_of_several_pdos_before_one_sync_the_last_is_applied(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1400, 2, 1, 1), 0);
	bus_send(bus, "210 01 00 01 00 01 00 01 00");
	bus_send(bus, "210 02 00 02 00 02 00 02 00");
	bus_send(bus, "080");
	expect_velocity(bus, 2, 2, 2, 2);
}

static void test_a_sync_without_a_pdo_before_it_changes_nothing(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 2, 1, 1), 0);
	bus_send(bus, "510 05 00");
	bus_send(bus, "080");
	bus_forget(bus);
	assert_int_equal(bus_write(bus, 0x2073, 0, 2, 3), 0);
	bus_send(bus, "080");
	assert_int_equal(bus->values.commands, 3);
}

static void test_a_pdo_that_waits_for_a_sync_is_dropped_when_operational_is_left(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 2, 1, 1), 0);
	bus_send(bus, "510 05 00");
	bus_send(bus, "000 80 10");
	bus_send(bus, "080");
	bus_send(bus, "000 01 10");
	bus_send(bus, "080");
	assert_int_equal(bus->values.commands, 0);
}

static void test_a_synchronous_pdo_after_the_window_is_discarded_until_the_next_sync(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 2, 1, 1), 0);
	assert_int_equal(bus_write(bus, 0x1007, 0, 4, 2000), 0);
	bus_send(bus, "080");
	bus_run(bus, 2001);
	bus_send(bus, "510 05 00");
	bus_send(bus, "080");
	assert_int_equal(bus->values.commands, 0);
	assert_int_equal(bus->node.pdos.late, 1);
	bus_run(bus, 2000);
	bus_send(bus, "510 05 00");
	bus_send(bus, "080");
	assert_int_equal(bus->values.commands, 5);
}

static void test_the_window_does_not_apply_to_an_event_driven_pdo(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1007, 0, 4, 2000), 0);
	bus_send(bus, "080");
	bus_run(bus, 1000000);
	bus_send(bus, "510 05 00");
	assert_int_equal(bus->values.commands, 5);
}

static void test_the_window_applies_to_the_sync_of_a_producer_too(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 2, 1, 1), 0);
	assert_int_equal(bus_write(bus, 0x1007, 0, 4, 2000), 0);
	assert_int_equal(bus_write(bus, 0x1006, 0, 4, 10000), 0);
	assert_int_equal(bus_write(bus, 0x1005, 0, 4, 0x40000080), 0);
	bus_run(bus, 10000 + 2001);
	bus_send(bus, "510 05 00");
	bus_run(bus, 10000);
	assert_int_equal(bus->values.commands, 0);
	bus_send(bus, "510 05 00"); /* 2001 us after the next one, and late again */
	bus_run(bus, 9000);
	bus_send(bus, "510 03 00");
	assert_int_equal(bus->values.commands, 0);
	bus_run(bus, 10000);
	assert_int_equal(bus->values.commands, 3);
}

static void test_at_a_sync_the_tpdos_are_sent_before_the_rpdos_are_applied(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1402, 2, 1, 1), 0);
	bus_send(bus, "410 00 00 00 00 00 00 02"); /* not a valid command */
	bus_send(bus, "080");
	bus_expect(bus, "190 00 00 00 00 00 00 00 00");
	bus_expect(bus, "290 00 00 00 00 00 00 00 00");
	bus_expect(bus, "390 00 00 00 00 00 00 00 00");
	bus_expect(bus, "490 00 00 00 00 00 00 00 00");
	bus_expect(bus, "090 00 82 11 02 14 72 20 07");
}

static void test_before_the_first_sync_there_is_no_window(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 2, 1, 1), 0);
	assert_int_equal(bus_write(bus, 0x1007, 0, 4, 2000), 0);
	bus_send(bus, "080");
	bus_send(bus, "000 80 10");
	bus_run(bus, 1000000);
	bus_send(bus, "000 01 10");
	bus_send(bus, "510 05 00");
	bus_send(bus, "080");
	assert_int_equal(bus->values.commands, 5);
}

/* ---- length ------------------------------------------------------------------------------------------------------ */

static void test_a_pdo_that_is_too_short_is_not_used_and_raises_8210h_until_a_correct_one(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "210 01 00 02 00 03 00 04", "090 10 82 11 00 14 07 08 00");
	expect_velocity(bus, 0, 0, 0, 0);
	assert_int_equal(bus_read(bus, 0x1001, 0), 0x11);
	bus_send(bus, "210");
	bus_expect_nothing(bus);
	bus_send(bus, "210 01 00 02 00 03 00 04 00");
	bus_expect_error_over(bus);
	expect_velocity(bus, 1, 2, 3, 4);
	assert_int_equal(bus_read(bus, 0x1001, 0), 0);
}

static void test_of_a_pdo_that_is_too_long_the_mapped_bytes_are_used_and_it_raises_8220h(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "510 05 00 FF", "090 20 82 11 03 14 03 02 00");
	assert_int_equal(bus->values.commands, 5);
	bus_send(bus, "510 04 00 FF FF FF FF FF FF");
	bus_expect_nothing(bus);
	assert_int_equal(bus->values.commands, 4);
	bus_send(bus, "510 00 00");
	bus_expect_error_over(bus);
}

static void test_each_pdo_has_its_own_length_error(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "210 01", "090 10 82 11 00 14 01 08 00");
	bus_exchange(bus, "310 01", "090 10 82 11 01 14 01 08 00");
	bus_send(bus, "210 00 00 00 00 00 00 00 00");
	bus_run(bus, 1000000);
	bus_expect_nothing(bus); /* RPDO2 is still wrong */
	bus_exchange(bus, "310 00 00 00 00 00 00 00 00", "090 00 00 00 00 00 00 00 00");
}

static void test_the_length_of_a_synchronous_pdo_is_checked_at_reception(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 2, 1, 1), 0);
	bus_exchange(bus, "510 05", "090 10 82 11 03 14 01 02 00");
	bus_send(bus, "080");
	assert_int_equal(bus->values.commands, 0);
}

static void test_a_length_error_ends_with_a_new_configuration_of_the_pdo(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "510 05", "090 10 82 11 03 14 01 02 00");
	assert_int_equal(bus_write(bus, 0x1403, 1, 4, 0x80000000), 0);
	bus_expect_error_over(bus);
}

/* ---- event timer: deadline monitoring ---------------------------------------------------------------------------- */

static void test_a_pdo_missing_for_its_event_time_raises_8250h_until_the_next_one(void **state)
{
	struct bus *bus = *state;
	uint64_t received_us;

	assert_int_equal(bus_write(bus, 0x1403, 5, 2, 100), 0);
	bus_send(bus, "510 00 00");
	received_us = bus->now_us;
	bus_run_until_sent(bus, 1000000);
	bus_expect(bus, "090 50 82 11 03 14 00 00 00");
	assert_int_equal(bus->seen_us, received_us + 100000);
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
	bus_exchange(bus, "510 00 00", "090 00 00 00 00 00 00 00 00");
}

static void test_the_event_timer_starts_with_the_first_reception(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 5, 2, 100), 0);
	bus_run(bus, 10000000);
	bus_expect_nothing(bus);
}

static void test_each_reception_restarts_the_event_timer(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 5, 2, 100), 0);
	for (int i = 0; i < 10; i++) {
		bus_send(bus, "510 00 00");
		bus_run(bus, 99999);
	}
	bus_expect_nothing(bus);
}

static void test_a_pdo_that_is_not_used_does_not_count_as_received(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 5, 2, 100), 0);
	bus_send(bus, "510 00 00");
	bus_run(bus, 60000);
	bus_exchange(bus, "510 00", "090 10 82 11 03 14 01 02 00");
	bus_run(bus, 40000);
	bus_expect(bus, "090 50 82 11 03 14 00 00 00");
}

static void test_the_event_timer_may_change_while_the_pdo_is_valid_and_starts_with_the_next_reception(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 5, 2, 100), 0);
	bus_send(bus, "510 00 00");
	assert_int_equal(bus_write(bus, 0x1403, 5, 2, 300), 0);
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
	bus_send(bus, "510 00 00");
	bus_run(bus, 299999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "090 50 82 11 03 14 00 00 00");
}

static void test_disabling_the_event_timer_ends_the_error(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 5, 2, 100), 0);
	bus_send(bus, "510 00 00");
	bus_run(bus, 100000);
	bus_expect(bus, "090 50 82 11 03 14 00 00 00");
	bus_send(bus, "610 2B 03 14 05 00 00 00 00");
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
}

static void test_the_event_timer_runs_in_operational_only(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 5, 2, 100), 0);
	bus_send(bus, "510 00 00");
	bus_send(bus, "000 80 10");
	bus_run(bus, 1000000);
	bus_send(bus, "000 01 10");
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
}

static void test_a_missing_pdo_leaves_the_node_operational(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 5, 2, 100), 0);
	bus_send(bus, "510 00 00");
	bus_run(bus, 100000);
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_OPERATIONAL);
}

static void test_reset_communication_ends_the_errors_of_pdos(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 5, 2, 100), 0);
	bus_send(bus, "510 00 00");
	bus_run(bus, 100000);
	bus_expect(bus, "090 50 82 11 03 14 00 00 00");
	bus_reset(bus, "000 82 10", "710 00");
	assert_int_equal(bus_read(bus, 0x1001, 0), 0);
	bus_send(bus, "000 01 10");
	bus_exchange(bus, "510 00", "090 10 82 11 03 14 01 02 00");
}

/* ---- content ----------------------------------------------------------------------------------------------------- */

static void test_a_pdo_with_a_value_beyond_its_limits_is_not_used_and_raises_8200h_with_the_object(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "410 01 00 02 00 03 00 02", "090 00 82 11 02 14 72 20 07");
	assert_int_equal(bus->values.attitude_reset.roll16, 0);
	assert_int_equal(bus->values.attitude_reset.command, 0);
	bus_send(bus, "410 01 00 02 00 03 00 02");
	bus_expect_nothing(bus);
	bus_send(bus, "410 01 00 02 00 03 00 00");
	bus_expect_error_over(bus);
	assert_int_equal(bus->values.attitude_reset.roll16, 1);
}

static void test_not_a_number_is_refused(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "310 00 00 C0 7F 00 00 80 3F", "090 00 82 11 01 14 71 20 01");
	assert_true(bus->values.yaw_aid.sigma == 0);
}

static enum od_status refuse_yaw(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	(void)ctx, (void)wire, (void)size;
	return entry->sub == 1 ? OD_DEVICE_STATE : OD_OK;
}

static void test_a_value_that_the_device_refuses_raises_8200h(void **state)
{
	struct bus *bus = *state;
	struct od_hook hook = {.first = 0x2071, .last = 0x2071, .before = refuse_yaw};

	od_attach(&bus->od, &hook);
	bus_exchange(bus, "310 00 00 80 3F 00 00 80 3F", "090 00 82 11 01 14 71 20 01");
	assert_true(bus->values.yaw_aid.yaw == 0);
}

/* ---- communication parameters ------------------------------------------------------------------------------------ */

static void test_the_identifier_changes_only_while_the_pdo_is_invalid(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 23 00 14 01 11 02 00 00", "590 80 00 14 01 30 00 09 06");
	assert_int_equal(bus_read(bus, 0x1400, 1), 0x210);
	assert_int_equal(bus_write(bus, 0x1400, 1, 4, INVALID | 0x211), 0);
	assert_int_equal(bus_write(bus, 0x1400, 1, 4, 0x212), 0);
	assert_int_equal(bus_read(bus, 0x1400, 1), 0x212);
}

static void test_bit_30_of_the_cob_id_is_ignored(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1403, 1, 4, 0x40000510), 0);
	bus_send(bus, "510 05 00");
	assert_int_equal(bus->values.commands, 5);
}

static void test_29_bit_and_restricted_identifiers_are_refused(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1400, 1, 4, INVALID | 0x20000210), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1400, 1, 4, INVALID | 0x00010210), 0x06090030);
	for (uint32_t id = 0; id <= 0x7FF; id++) {
		bool restricted = id <= 0x07F || (id >= 0x101 && id <= 0x180) || (id >= 0x581 && id <= 0x5FF) ||
				  (id >= 0x601 && id <= 0x67F) || (id >= 0x6E0 && id <= 0x6FF) || id >= 0x701;

		assert_int_equal(bus_write(bus, 0x1400, 1, 4, INVALID), 0);
		assert_int_equal(bus_write(bus, 0x1400, 1, 4, id), restricted ? 0x06090030 : 0);
		bus->sent_count = bus->seen = 0;
	}
}

static void test_types_241_to_253_are_refused(void **state)
{
	struct bus *bus = *state;

	for (uint32_t type = 0; type <= 255; type++)
		assert_int_equal(bus_write(bus, 0x1400, 2, 1, type), type >= 241 && type <= 253 ? 0x06090030 : 0);
}

static void test_sub_indices_3_4_and_6_do_not_exist(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_read(bus, 0x1400, 0), 5);
	bus_exchange(bus, "610 40 00 14 03 00 00 00 00", "590 80 00 14 03 11 00 09 06");
	assert_int_equal(bus_write(bus, 0x1400, 4, 1, 0), 0x06090011);
	assert_int_equal(bus_write(bus, 0x1400, 6, 1, 0), 0x06090011);
}

/* ---- mapping ----------------------------------------------------------------------------------------------------- */

static void test_the_mapping_procedure_changes_what_is_received(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 23 00 14 01 10 02 00 80", "590 60 00 14 01 00 00 00 00");
	bus_exchange(bus, "610 2F 00 16 00 00 00 00 00", "590 60 00 16 00 00 00 00 00");
	bus_exchange(bus, "610 23 00 16 01 10 00 73 20", "590 60 00 16 01 00 00 00 00"); /* 2073h:0, 16 */
	bus_exchange(bus, "610 23 00 16 02 20 02 71 20", "590 60 00 16 02 00 00 00 00"); /* 2071h:2, 32 */
	bus_exchange(bus, "610 2F 00 16 00 02 00 00 00", "590 60 00 16 00 00 00 00 00");
	bus_exchange(bus, "610 23 00 14 01 10 02 00 00", "590 60 00 14 01 00 00 00 00");
	bus_send(bus, "000 01 10");
	bus_send(bus, "210 04 00 00 00 80 3F");
	assert_int_equal(bus->values.commands, 4);
	assert_true(bus->values.yaw_aid.sigma == 1.0f);
	bus_expect_nothing(bus);
}

static void test_the_bytes_of_a_dummy_entry_are_skipped(void **state)
{
	struct bus *bus = *state;

	begin_mapping(bus);
	assert_int_equal(bus_write(bus, 0x1600, 1, 4, 0x00050008), 0); /* UNSIGNED8 */
	assert_int_equal(bus_write(bus, 0x1600, 2, 4, 0x20730010), 0);
	assert_int_equal(bus_write(bus, 0x1600, 3, 4, 0x00040020), 0); /* INTEGER32 */
	end_mapping(bus, 3);
	bus_send(bus, "210 FF 05 00 FF FF FF FF");
	assert_int_equal(bus->values.commands, 5);
	bus_exchange(bus, "210 FF 05 00 FF FF FF", "090 10 82 11 00 14 06 07 00");
}

static void test_the_dummies_are_those_that_the_eds_allows(void **state)
{
	struct bus *bus = *state;
	static const uint32_t dummies[] = {0x00020008, 0x00030010, 0x00040020, 0x00050008, 0x00060010, 0x00070020};

	begin_mapping(bus);
	for (size_t i = 0; i < sizeof(dummies) / sizeof(dummies[0]); i++)
		assert_int_equal(bus_write(bus, 0x1600, 1, 4, dummies[i]), 0);
	assert_int_equal(
		bus_write(bus, 0x1600, 1, 4, 0x00010001), 0x06020000); /* not BOOLEAN, which has no whole bytes */
	assert_int_equal(bus_write(bus, 0x1600, 1, 4, 0x00080020), 0x06020000);
	assert_int_equal(bus_write(bus, 0x1600, 1, 4, 0x00050108), 0x06020000);
	assert_int_equal(bus_write(bus, 0x1600, 1, 4, 0x00050010), 0x06040041);
}

static void test_an_unknown_object_cannot_be_mapped(void **state)
{
	struct bus *bus = *state;

	begin_mapping(bus);
	bus_exchange(bus, "610 23 00 16 01 10 01 FF 2F", "590 80 00 16 01 00 00 02 06");
	bus_exchange(bus, "610 23 00 16 01 10 0F 70 20", "590 80 00 16 01 00 00 02 06");
}

static void test_an_object_that_is_not_for_rpdos_cannot_be_mapped(void **state)
{
	struct bus *bus = *state;

	begin_mapping(bus);
	bus_exchange(bus, "610 23 00 16 01 10 01 00 21", "590 80 00 16 01 41 00 04 06"); /* 2100h:1 */
	bus_exchange(bus, "610 23 00 16 01 20 01 00 20", "590 80 00 16 01 41 00 04 06"); /* 2000h:1 */
	bus_exchange(bus, "610 23 00 16 01 08 09 70 20", "590 80 00 16 01 41 00 04 06"); /* 2070h:9 */
}

static void test_an_object_for_rpdos_cannot_be_mapped_into_a_tpdo(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1A04, 1, 4, 0x20730010), 0x06040041);
	assert_int_equal(bus_write(bus, 0x1A04, 1, 4, 0x00050008), 0x06020000); /* nor a dummy entry */
}

static void test_an_object_can_only_be_mapped_with_its_full_length(void **state)
{
	struct bus *bus = *state;

	begin_mapping(bus);
	assert_int_equal(bus_write(bus, 0x1600, 1, 4, 0x20730008), 0x06040041);
	assert_int_equal(bus_write(bus, 0x1600, 1, 4, 0x20730020), 0x06040041);
}

static void test_eight_bytes_may_be_mapped_and_nine_may_not(void **state)
{
	struct bus *bus = *state;

	begin_mapping(bus);
	assert_int_equal(bus_write(bus, 0x1600, 5, 4, 0x00050008), 0);
	assert_int_equal(bus_write(bus, 0x1600, 0, 1, 5), 0x06040042);
	assert_int_equal(bus_read(bus, 0x1600, 0), 0);
	assert_int_equal(bus_write(bus, 0x1600, 0, 1, 4), 0);
}

static void test_more_than_eight_objects_are_too_many(void **state)
{
	struct bus *bus = *state;

	begin_mapping(bus);
	assert_int_equal(bus_write(bus, 0x1600, 0, 1, 9), 0x06040042);
	assert_int_equal(bus_write(bus, 0x1600, 0, 1, 64), 0x06040042);
	assert_int_equal(bus_write(bus, 0x1600, 0, 1, 65), 0x06090031);
	assert_int_equal(bus_write(bus, 0x1600, 0, 1, 254), 0x06090031); /* no multiplexed PDO */
}

static void test_an_entry_may_be_0_unless_it_is_counted(void **state)
{
	struct bus *bus = *state;

	begin_mapping(bus);
	assert_int_equal(bus_write(bus, 0x1600, 3, 4, 0), 0);
	assert_int_equal(bus_write(bus, 0x1600, 0, 1, 3), 0x06020000);
}

static void test_the_mapping_of_a_valid_pdo_cannot_be_written(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 2F 00 16 00 00 00 00 00", "590 80 00 16 00 00 00 01 06");
	bus_exchange(bus, "610 23 00 16 01 10 00 73 20", "590 80 00 16 01 00 00 01 06");
	assert_int_equal(bus_read(bus, 0x1600, 0), 4);
}

static void test_an_entry_cannot_be_written_while_sub_index_0_is_not_0(void **state)
{
	struct bus *bus = *state;

	invalidate(bus);
	bus_exchange(bus, "610 23 00 16 01 10 00 73 20", "590 80 00 16 01 00 00 01 06");
}

static void test_the_checks_are_the_same_in_operational_and_pre_operational(void **state)
{
	struct bus *bus = *state;

	for (int i = 0; i < 2; i++) {
		assert_int_equal(bus_write(bus, 0x1400, 1, 4, 0x211), 0x06090030);
		assert_int_equal(bus_write(bus, 0x1400, 2, 1, 252), 0x06090030);
		assert_int_equal(bus_write(bus, 0x1600, 0, 1, 0), 0x06010000);
		assert_int_equal(bus_write(bus, 0x1600, 1, 4, 0x20730010), 0x06010000);
		bus_send(bus, "000 80 10");
	}
}

/* ---- unusable stored values -------------------------------------------------------------------------------------- */

static void expect_rpdo1_refused_at_start(struct bus *bus)
{
	bus_start(bus);
	bus_expect(bus, "710 00");
	bus_expect(bus, "090 00 63 01 00 14 00 00 00"); /* data set, 1400h */
	assert_true(bus_read(bus, 0x1400, 1) & INVALID);
	assert_false(bus_listens_to(bus, 0x210));
	assert_true(bus_listens_to(bus, 0x310));
	test_free(bus);
}

static void test_a_stored_parameter_that_is_not_allowed_makes_the_pdo_invalid_and_raises_6300h(void **state)
{
	struct bus *bus = bus_new();

	bus_put(bus, 0x1400, 1, 4, 0x00000080 - 1);
	expect_rpdo1_refused_at_start(bus);
	bus = bus_new();
	bus_put(bus, 0x1400, 2, 1, 252);
	expect_rpdo1_refused_at_start(bus);
	bus = bus_new();
	bus_put(bus, 0x1600, 1, 4, 0x21000110);
	expect_rpdo1_refused_at_start(bus);
	(void)state;
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		OPERATIONAL(test_the_four_rpdos_exist_by_default_with_the_predefined_identifiers),
		OPERATIONAL(test_a_pdo_is_written_into_the_dictionary_little_endian_and_signed),
		OPERATIONAL(test_real_values_are_received),
		PRE_OPERATIONAL(test_pdos_are_received_in_operational_only),
		OPERATIONAL(test_an_invalid_pdo_is_neither_received_nor_in_the_receive_filter),
		OPERATIONAL(test_a_pdo_with_nothing_mapped_is_not_received),
		OPERATIONAL(test_a_new_identifier_is_received_at_once),
		OPERATIONAL(test_a_pdo_may_have_the_highest_identifier_that_is_not_restricted),
		OPERATIONAL(test_two_pdos_may_share_an_identifier),
		OPERATIONAL(test_remote_and_29_bit_frames_are_not_pdos),
		OPERATIONAL(test_reset_communication_restores_the_default_parameters),
		OPERATIONAL(test_types_254_and_255_are_applied_at_once),
		OPERATIONAL(test_types_0_to_240_are_all_applied_at_the_next_sync),
		OPERATIONAL(test_of_several_pdos_before_one_sync_the_last_is_applied),
		OPERATIONAL(test_a_sync_without_a_pdo_before_it_changes_nothing),
		OPERATIONAL(test_a_pdo_that_waits_for_a_sync_is_dropped_when_operational_is_left),
		OPERATIONAL(test_a_synchronous_pdo_after_the_window_is_discarded_until_the_next_sync),
		OPERATIONAL(test_the_window_does_not_apply_to_an_event_driven_pdo),
		OPERATIONAL(test_the_window_applies_to_the_sync_of_a_producer_too),
		OPERATIONAL(test_at_a_sync_the_tpdos_are_sent_before_the_rpdos_are_applied),
		OPERATIONAL(test_before_the_first_sync_there_is_no_window),
		OPERATIONAL(test_a_pdo_that_is_too_short_is_not_used_and_raises_8210h_until_a_correct_one),
		OPERATIONAL(test_of_a_pdo_that_is_too_long_the_mapped_bytes_are_used_and_it_raises_8220h),
		OPERATIONAL(test_each_pdo_has_its_own_length_error),
		OPERATIONAL(test_the_length_of_a_synchronous_pdo_is_checked_at_reception),
		OPERATIONAL(test_a_length_error_ends_with_a_new_configuration_of_the_pdo),
		OPERATIONAL(test_a_pdo_missing_for_its_event_time_raises_8250h_until_the_next_one),
		OPERATIONAL(test_the_event_timer_starts_with_the_first_reception),
		OPERATIONAL(test_each_reception_restarts_the_event_timer),
		OPERATIONAL(test_a_pdo_that_is_not_used_does_not_count_as_received),
		OPERATIONAL(test_the_event_timer_may_change_while_the_pdo_is_valid_and_starts_with_the_next_reception),
		OPERATIONAL(test_disabling_the_event_timer_ends_the_error),
		OPERATIONAL(test_the_event_timer_runs_in_operational_only),
		OPERATIONAL(test_a_missing_pdo_leaves_the_node_operational),
		OPERATIONAL(test_reset_communication_ends_the_errors_of_pdos),
		OPERATIONAL(test_a_pdo_with_a_value_beyond_its_limits_is_not_used_and_raises_8200h_with_the_object),
		OPERATIONAL(test_not_a_number_is_refused),
		OPERATIONAL(test_a_value_that_the_device_refuses_raises_8200h),
		OPERATIONAL(test_the_identifier_changes_only_while_the_pdo_is_invalid),
		OPERATIONAL(test_bit_30_of_the_cob_id_is_ignored),
		PRE_OPERATIONAL(test_29_bit_and_restricted_identifiers_are_refused),
		PRE_OPERATIONAL(test_types_241_to_253_are_refused),
		OPERATIONAL(test_sub_indices_3_4_and_6_do_not_exist),
		PRE_OPERATIONAL(test_the_mapping_procedure_changes_what_is_received),
		OPERATIONAL(test_the_bytes_of_a_dummy_entry_are_skipped),
		OPERATIONAL(test_the_dummies_are_those_that_the_eds_allows),
		OPERATIONAL(test_an_unknown_object_cannot_be_mapped),
		OPERATIONAL(test_an_object_that_is_not_for_rpdos_cannot_be_mapped),
		OPERATIONAL(test_an_object_for_rpdos_cannot_be_mapped_into_a_tpdo),
		OPERATIONAL(test_an_object_can_only_be_mapped_with_its_full_length),
		OPERATIONAL(test_eight_bytes_may_be_mapped_and_nine_may_not),
		OPERATIONAL(test_more_than_eight_objects_are_too_many),
		OPERATIONAL(test_an_entry_may_be_0_unless_it_is_counted),
		OPERATIONAL(test_the_mapping_of_a_valid_pdo_cannot_be_written),
		OPERATIONAL(test_an_entry_cannot_be_written_while_sub_index_0_is_not_0),
		OPERATIONAL(test_the_checks_are_the_same_in_operational_and_pre_operational),
		cmocka_unit_test(test_a_stored_parameter_that_is_not_allowed_makes_the_pdo_invalid_and_raises_6300h),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
