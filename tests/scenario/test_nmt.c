/* NMT slave, boot-up and heartbeat producer: CiA 301, 7.2.8 and 7.3.2. */
#include "tests/scenario/bus.h"

#include <errno.h>
#include <string.h>

static void test_boot_up_is_one_zero_byte_and_the_node_is_pre_operational(void **state)
{
	struct bus *bus = bus_new();

	bus_start(bus);
	bus_expect(bus, "710 00");
	bus_expect_nothing(bus);
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
	assert_int_equal(bus->state_count, 1);
	assert_int_equal(bus->states[0], NMT_PRE_OPERATIONAL);
	test_free(bus);
	(void)state;
}

static void test_before_boot_up_the_node_neither_sends_nor_receives(void **state)
{
	struct bus *bus = bus_new();

	assert_int_equal(canopen_init(&bus->node, &bus->od, &bus->port, NULL, BUS_NODE_ID), 0);
	bus_send(bus, "000 01 10");
	bus_send(bus, "610 40 00 10 00 00 00 00 00");
	bus_run(bus, 10000000);
	bus_expect_nothing(bus);
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_INITIALISING);
	test_free(bus);
	(void)state;
}

static void test_a_node_id_is_1_to_127(void **state)
{
	struct bus *bus = bus_new();

	assert_int_equal(canopen_init(&bus->node, &bus->od, &bus->port, NULL, 0), -EINVAL);
	assert_int_equal(canopen_init(&bus->node, &bus->od, &bus->port, NULL, 128), -EINVAL);
	assert_int_equal(canopen_init(&bus->node, &bus->od, &bus->port, NULL, 1), 0);
	bus->od.hooks = NULL;
	assert_int_equal(canopen_init(&bus->node, &bus->od, &bus->port, NULL, 127), 0);
	test_free(bus);
	(void)state;
}

static void test_a_dictionary_without_a_mandatory_object_is_refused(void **state)
{
	static const uint16_t mandatory[] = {0x1000, 0x1001, 0x1017, 0x1018};
	static struct od_entry entries[2000];
	struct bus *bus = bus_new();

	assert_true(imu9_od_table.count <= sizeof(entries) / sizeof(entries[0]));
	for (size_t m = 0; m < sizeof(mandatory) / sizeof(mandatory[0]); m++) {
		struct od_table table = imu9_od_table;

		table.entries = entries;
		table.count = 0;
		for (size_t i = 0; i < imu9_od_table.count; i++)
			if (imu9_od_table.entries[i].index != mandatory[m])
				entries[table.count++] = imu9_od_table.entries[i];
		bus->od.table = &table;
		assert_int_equal(canopen_init(&bus->node, &bus->od, &bus->port, NULL, BUS_NODE_ID), -ENOENT);
	}
	test_free(bus);
	(void)state;
}

static void test_the_receive_filter_has_nmt_sdo_sync_guarding_lss_rpdos_and_its_own_identifiers_only(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus->filter_count, 15);
	assert_true(bus_listens_to(bus, 0x000));
	assert_true(bus_listens_to(bus, 0x610));
	assert_true(bus_listens_to(bus, 0x080));
	assert_true(bus_listens_to(bus, 0x710));
	assert_true(bus_listens_to(bus, 0x7E5));
	for (uint32_t id = 0x210; id <= 0x510; id += 0x100)
		assert_true(bus_listens_to(bus, id));
}

static void test_the_master_starts_and_stops_the_node_and_enters_pre_operational(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "000 01 10");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_OPERATIONAL);
	bus_send(bus, "000 02 10");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_STOPPED);
	bus_send(bus, "000 80 10");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
	bus_send(bus, "000 02 10");
	bus_send(bus, "000 01 10");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_OPERATIONAL);
	bus_send(bus, "000 80 10");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
	bus_expect_nothing(bus);
}

static void test_a_command_to_node_0_is_for_every_node(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "000 01 00");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_OPERATIONAL);
}

static void test_a_command_to_another_node_is_ignored(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "000 01 11");
	bus_send(bus, "000 81 0F");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
	bus_expect_nothing(bus);
}

static void test_an_nmt_frame_of_wrong_length_is_ignored(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "000");
	bus_send(bus, "000 01");
	bus_send(bus, "000 01 10 00");
	bus_send(bus, "000 01 10 00 00 00 00 00 00");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
}

static void test_an_unknown_nmt_command_is_ignored(void **state)
{
	struct bus *bus = *state;

	for (unsigned command = 0; command < 256; command++) {
		const struct can_msg msg = {.len = 2, .data = {(uint8_t)command, 0x10}};

		if (command != 1 && command != 2 && command < 128)
			bus_send_msg(bus, &msg);
		if (command > 130)
			bus_send_msg(bus, &msg);
	}
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
	bus_expect_nothing(bus);
}

/* A driver of another bus, such as CAN FD, may hand it over. */
static void test_a_frame_of_more_than_8_bytes_is_nothing(void **state)
{
	struct bus *bus = *state;
	struct can_msg request = {.id = 0x610, .data = {0x40, 0x00, 0x10}, .len = 9};
	size_t before = bus->sent_count;

	bus_send_msg(bus, &request);
	bus_expect_nothing(bus);
	request.len = 8;
	bus_send_msg(bus, &request);
	assert_int_equal(bus->sent_count, before + 1);
}

static void test_extended_and_remote_frames_are_not_nmt_commands(void **state)
{
	struct bus *bus = *state;
	struct can_msg start = {.len = 2, .data = {0x01, 0x10}};

	start.extended = true;
	bus_send_msg(bus, &start);
	start.extended = false;
	start.remote = true;
	bus_send_msg(bus, &start);
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
}

static void test_reset_node_restores_every_value_and_boots_up_again(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x2001, 0, 1, 1);
	bus_write(bus, 0x1019, 0, 1, 10);
	bus_send(bus, "000 01 10");
	bus_reset(bus, "000 81 10", "710 00");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
	assert_int_equal(bus->reset_calls, 1);
	assert_int_equal(bus->reset, OD_GROUP_ALL);
	assert_int_equal(bus_read(bus, 0x2001, 0), 2);
	assert_int_equal(bus_read(bus, 0x1019, 0), 0);
}

static void test_reset_communication_restores_1000h_to_1FFFh_and_leaves_the_rest(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x2001, 0, 1, 1);
	bus_write(bus, 0x1019, 0, 1, 10);
	bus_reset(bus, "000 82 00", "710 00");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
	assert_int_equal(bus->reset, OD_GROUP_COMMUNICATION);
	assert_int_equal(bus_read(bus, 0x2001, 0), 1);
	assert_int_equal(bus_read(bus, 0x1019, 0), 0);
}

static void test_from_reset_to_boot_up_the_node_neither_sends_nor_receives(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1017, 0, 2, 1);
	bus_forget(bus);
	bus_send(bus, "000 82 10");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_INITIALISING);
	bus_send(bus, "000 01 10");
	bus_send(bus, "610 40 00 10 00 00 00 00 00");
	bus_send(bus, "710 R");
	bus_send(bus, "080 00");
	bus_run(bus, 10000);
	bus_expect(bus, "710 00");
	bus_expect_nothing(bus);
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
}

static void test_a_reset_works_from_stopped_too(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "000 02 10");
	bus_reset(bus, "000 82 10", "710 00");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
	bus_send(bus, "000 02 10");
	bus_reset(bus, "000 81 10", "710 00");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
}

static void test_the_device_is_notified_of_each_state_once(void **state)
{
	struct bus *bus = *state;
	const enum nmt_state expected[] = {
		NMT_PRE_OPERATIONAL, NMT_OPERATIONAL, NMT_INITIALISING, NMT_PRE_OPERATIONAL, NMT_STOPPED};

	bus_send(bus, "000 80 10");
	bus_send(bus, "000 01 10");
	bus_send(bus, "000 01 10");
	bus_reset(bus, "000 82 10", "710 00");
	bus_send(bus, "000 02 10");
	assert_int_equal(bus->state_count, 5);
	assert_memory_equal(bus->states, expected, sizeof(expected));
}

static void test_sdo_is_available_in_pre_operational_and_operational_but_not_in_stopped(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 40 00 10 00 00 00 00 00", "590 43 00 10 00 9A 01 04 00");
	bus_send(bus, "000 01 10");
	bus_exchange(bus, "610 40 00 10 00 00 00 00 00", "590 43 00 10 00 9A 01 04 00");
	bus_send(bus, "000 02 10");
	bus_send(bus, "610 40 00 10 00 00 00 00 00");
	bus_expect_nothing(bus);
	bus_send(bus, "000 80 10");
	bus_exchange(bus, "610 40 00 10 00 00 00 00 00", "590 43 00 10 00 9A 01 04 00");
}

static void test_a_stop_ends_the_sdo_transfer_without_an_abort(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_send(bus, "000 02 10");
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);
	bus_send(bus, "000 80 10");
	bus_send(bus, "610 60 00 00 00 00 00 00 00");
	bus_expect(bus, "590 80 00 00 00 01 00 04 05");
}

static void test_a_reset_ends_the_sdo_transfer(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00");
	bus_reset(bus, "000 82 10", "710 00");
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);
}

static void test_a_reset_restores_the_sync_identifier(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1005, 0, 4, 0x0A0), 0);
	assert_true(bus_listens_to(bus, 0x0A0));
	bus_send(bus, "000 82 10");
	assert_true(bus_listens_to(bus, 0x080));
}

/* ---- start-up ---------------------------------------------------------------------------------------------------- */

static void test_with_bit_2_of_1F80h_clear_the_node_enters_operational_by_itself(void **state)
{
	struct bus *bus = bus_new();

	bus_put(bus, 0x1F80, 0, 4, 0);
	bus_start(bus);
	bus_expect(bus, "710 00");
	bus_expect_nothing(bus);
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_OPERATIONAL);
	test_free(bus);
	(void)state;
}

static void test_a_node_that_starts_by_itself_passes_through_pre_operational(void **state)
{
	struct bus *bus = bus_new();
	const enum nmt_state expected[] = {NMT_PRE_OPERATIONAL, NMT_OPERATIONAL};

	bus_put(bus, 0x1F80, 0, 4, 0);
	bus_start(bus);
	assert_int_equal(bus->state_count, 2);
	assert_memory_equal(bus->states, expected, sizeof(expected));
	test_free(bus);
	(void)state;
}

static void test_1F80h_acts_at_boot_up_not_when_it_is_written(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1F80, 0, 4, 0), 0);
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
	bus->power_on = bus->values; /* as a stored value */
	bus_reset(bus, "000 82 10", "710 00");
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_OPERATIONAL);
}

static void test_the_bits_of_an_nmt_master_are_refused_in_1F80h(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1F80, 0, 4, 1), 0x06090030);
	assert_int_equal(bus_write(bus, 0x1F80, 0, 4, 0xC), 0x06090030);
	assert_int_equal(bus_read(bus, 0x1F80, 0), 4);
}

/* ---- error behaviour --------------------------------------------------------------------------------------------- */

static void bus_off(struct bus *bus)
{
	canopen_bus_off(&bus->node, bus->now_us);
	bus_tick(bus);
}

static void test_bus_off_leaves_operational(void **state)
{
	struct bus *bus = *state;

	bus_off(bus);
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
}

static void test_bus_off_does_not_change_the_state_when_the_error_behaviour_is_1(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1029, 1, 1, 1), 0);
	bus_off(bus);
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_OPERATIONAL);
}

static void test_bus_off_stops_the_node_when_the_error_behaviour_is_2(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1029, 1, 1, 2), 0);
	bus_off(bus);
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_STOPPED);
}

static void test_bus_off_leaves_a_stopped_node_stopped(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "000 02 10");
	bus_off(bus);
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_STOPPED);
}

static void test_an_error_behaviour_above_2_is_refused(void **state)
{
	assert_int_equal(bus_write(*state, 0x1029, 1, 1, 3), 0x06090031);
}

/* ---- heartbeat --------------------------------------------------------------------------------------------------- */

static void test_boot_up_is_the_first_heartbeat(void **state)
{
	struct bus *bus = bus_new();

	bus_put(bus, 0x1017, 0, 2, 500);
	bus_start(bus);
	bus_expect(bus, "710 00");
	bus_run(bus, 499999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "710 7F");
	test_free(bus);
	(void)state;
}

static void test_the_heartbeat_carries_the_state_in_every_state(void **state)
{
	struct bus *bus = *state;

	bus_run(bus, 1000000);
	bus_write(bus, 0x1017, 0, 2, 100);
	bus_expect(bus, "710 7F");
	bus_send(bus, "000 01 10");
	bus_run(bus, 100000);
	bus_expect(bus, "710 05");
	bus_send(bus, "000 02 10");
	bus_run(bus, 100000);
	bus_expect(bus, "710 04");
	bus_send(bus, "000 80 10");
	bus_run(bus, 100000);
	bus_expect(bus, "710 7F");
	bus_expect_nothing(bus);
}

static void test_a_heartbeat_time_of_0_disables_the_heartbeat(void **state)
{
	struct bus *bus = *state;

	bus_run(bus, 100000000);
	bus_expect_nothing(bus);
	assert_true(bus->deadline_us == UINT64_MAX);
}

static void test_an_enabled_heartbeat_starts_at_once(void **state)
{
	struct bus *bus = *state;
	uint64_t start_us;

	bus_run(bus, 7000000);
	start_us = bus->now_us;
	bus_write(bus, 0x1017, 0, 2, 250);
	bus_expect(bus, "710 7F");
	assert_int_equal(bus->seen_us, start_us);
	bus_run(bus, 500000);
	bus_expect(bus, "710 7F");
	assert_int_equal(bus->seen_us, start_us + 250000);
	bus_expect(bus, "710 7F");
	assert_int_equal(bus->seen_us, start_us + 500000);
	bus_expect_nothing(bus);
}

static void test_a_new_heartbeat_time_counts_from_the_last_heartbeat(void **state)
{
	struct bus *bus = *state;
	uint64_t last_us;

	bus_run(bus, 1000000);
	bus_write(bus, 0x1017, 0, 2, 1000);
	bus_expect(bus, "710 7F");
	last_us = bus->seen_us;
	bus_run(bus, 100000);
	bus_write(bus, 0x1017, 0, 2, 300);
	bus_expect_nothing(bus);
	bus_run_until_sent(bus, 1000000);
	bus_expect(bus, "710 7F");
	assert_int_equal(bus->seen_us, last_us + 300000);
}

static void test_a_disabled_heartbeat_stops_at_once(void **state)
{
	struct bus *bus = *state;

	bus_run(bus, 1000000);
	bus_write(bus, 0x1017, 0, 2, 100);
	bus_expect(bus, "710 7F");
	bus_run(bus, 50000);
	bus_write(bus, 0x1017, 0, 2, 0);
	bus_run(bus, 10000000);
	bus_expect_nothing(bus);
}

static void test_a_late_call_keeps_the_phase_of_the_heartbeat(void **state)
{
	struct bus *bus = bus_new();

	bus_put(bus, 0x1017, 0, 2, 100);
	bus_start(bus);
	bus_forget(bus);
	bus->now_us += 130000; /* 30 ms late */
	bus_tick(bus);
	bus_expect(bus, "710 7F");
	bus_run_until_sent(bus, 100000);
	bus_expect(bus, "710 7F");
	assert_int_equal(bus->seen_us, 1000000 + 200000);
	test_free(bus);
	(void)state;
}

static void test_missed_heartbeats_are_not_sent_in_a_burst(void **state)
{
	struct bus *bus = bus_new();

	bus_put(bus, 0x1017, 0, 2, 100);
	bus_start(bus);
	bus_forget(bus);
	bus->now_us += 1050000;
	bus_tick(bus);
	bus_expect(bus, "710 7F");
	bus_expect_nothing(bus);
	assert_int_equal(bus->deadline_us, bus->now_us + 100000);
	test_free(bus);
	(void)state;
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_boot_up_is_one_zero_byte_and_the_node_is_pre_operational),
		cmocka_unit_test(test_before_boot_up_the_node_neither_sends_nor_receives),
		cmocka_unit_test(test_a_node_id_is_1_to_127),
		cmocka_unit_test(test_a_dictionary_without_a_mandatory_object_is_refused),
		PRE_OPERATIONAL(
			test_the_receive_filter_has_nmt_sdo_sync_guarding_lss_rpdos_and_its_own_identifiers_only),
		PRE_OPERATIONAL(test_the_master_starts_and_stops_the_node_and_enters_pre_operational),
		PRE_OPERATIONAL(test_a_command_to_node_0_is_for_every_node),
		PRE_OPERATIONAL(test_a_command_to_another_node_is_ignored),
		PRE_OPERATIONAL(test_an_nmt_frame_of_wrong_length_is_ignored),
		PRE_OPERATIONAL(test_an_unknown_nmt_command_is_ignored),
		PRE_OPERATIONAL(test_a_frame_of_more_than_8_bytes_is_nothing),
		PRE_OPERATIONAL(test_extended_and_remote_frames_are_not_nmt_commands),
		PRE_OPERATIONAL(test_reset_node_restores_every_value_and_boots_up_again),
		PRE_OPERATIONAL(test_reset_communication_restores_1000h_to_1FFFh_and_leaves_the_rest),
		PRE_OPERATIONAL(test_from_reset_to_boot_up_the_node_neither_sends_nor_receives),
		PRE_OPERATIONAL(test_a_reset_works_from_stopped_too),
		PRE_OPERATIONAL(test_the_device_is_notified_of_each_state_once),
		PRE_OPERATIONAL(test_sdo_is_available_in_pre_operational_and_operational_but_not_in_stopped),
		PRE_OPERATIONAL(test_a_stop_ends_the_sdo_transfer_without_an_abort),
		PRE_OPERATIONAL(test_a_reset_ends_the_sdo_transfer),
		PRE_OPERATIONAL(test_a_reset_restores_the_sync_identifier),
		cmocka_unit_test(test_with_bit_2_of_1F80h_clear_the_node_enters_operational_by_itself),
		cmocka_unit_test(test_a_node_that_starts_by_itself_passes_through_pre_operational),
		PRE_OPERATIONAL(test_1F80h_acts_at_boot_up_not_when_it_is_written),
		PRE_OPERATIONAL(test_the_bits_of_an_nmt_master_are_refused_in_1F80h),
		OPERATIONAL(test_bus_off_leaves_operational),
		OPERATIONAL(test_bus_off_does_not_change_the_state_when_the_error_behaviour_is_1),
		OPERATIONAL(test_bus_off_stops_the_node_when_the_error_behaviour_is_2),
		OPERATIONAL(test_bus_off_leaves_a_stopped_node_stopped),
		PRE_OPERATIONAL(test_an_error_behaviour_above_2_is_refused),
		cmocka_unit_test(test_boot_up_is_the_first_heartbeat),
		PRE_OPERATIONAL(test_the_heartbeat_carries_the_state_in_every_state),
		PRE_OPERATIONAL(test_a_heartbeat_time_of_0_disables_the_heartbeat),
		PRE_OPERATIONAL(test_an_enabled_heartbeat_starts_at_once),
		PRE_OPERATIONAL(test_a_new_heartbeat_time_counts_from_the_last_heartbeat),
		PRE_OPERATIONAL(test_a_disabled_heartbeat_stops_at_once),
		cmocka_unit_test(test_a_late_call_keeps_the_phase_of_the_heartbeat),
		cmocka_unit_test(test_missed_heartbeats_are_not_sent_in_a_burst),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
