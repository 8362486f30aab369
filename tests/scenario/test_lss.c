/* LSS slave: CiA 305. The identity of the node is vendor 00494D55h, product 9, revision 00010000h, serial 12345678h. */
#include "tests/scenario/bus.h"

#define VENDOR_IS_RIGHT	  "7E5 40 55 4D 49 00 00 00 00"
#define PRODUCT_IS_RIGHT  "7E5 41 09 00 00 00 00 00 00"
#define REVISION_IS_RIGHT "7E5 42 00 00 01 00 00 00 00"
#define SERIAL_IS_RIGHT	  "7E5 43 78 56 34 12 00 00 00"

static void set_identity(struct bus *bus)
{
	bus_put(bus, 0x1018, 3, 4, 0x00010000);
	bus_put(bus, 0x1018, 4, 4, 0x12345678);
}

/* A node without a node-ID. */
static struct bus *unconfigured(void)
{
	struct bus *bus = bus_new_with_id(CANOPEN_UNCONFIGURED);

	set_identity(bus);
	bus_start(bus);
	return bus;
}

static void configure(struct bus *bus)
{
	bus_send(bus, "7E5 04 01 00 00 00 00 00 00");
	bus_expect_nothing(bus);
}

/* ---- switching --------------------------------------------------------------------------------------------------- */

static void test_switch_global_has_no_response_and_enters_configuration_state(void **state)
{
	configure(*state);
	bus_exchange(*state, "7E5 5E 00 00 00 00 00 00 00", "7E4 5E 10 00 00 00 00 00 00");
}

static void test_in_waiting_state_configuration_and_inquiry_are_ignored(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "7E5 5E 00 00 00 00 00 00 00");
	bus_send(bus, "7E5 5A 00 00 00 00 00 00 00");
	bus_send(bus, "7E5 11 20 00 00 00 00 00 00");
	bus_send(bus, "7E5 13 00 02 00 00 00 00 00");
	bus_send(bus, "7E5 17 00 00 00 00 00 00 00");
	bus_expect_nothing(bus);
}

static void test_switch_global_0_leaves_configuration_state(void **state)
{
	configure(*state);
	bus_send(*state, "7E5 04 00 00 00 00 00 00 00");
	bus_send(*state, "7E5 5E 00 00 00 00 00 00 00");
	bus_expect_nothing(*state);
}

static void test_the_node_that_matches_all_four_numbers_is_switched_and_responds(void **state)
{
	struct bus *bus = *state;

	set_identity(bus);
	bus_send(bus, VENDOR_IS_RIGHT);
	bus_send(bus, PRODUCT_IS_RIGHT);
	bus_send(bus, REVISION_IS_RIGHT);
	bus_expect_nothing(bus);
	bus_exchange(bus, SERIAL_IS_RIGHT, "7E4 44 00 00 00 00 00 00 00");
	bus_exchange(bus, "7E5 5E 00 00 00 00 00 00 00", "7E4 5E 10 00 00 00 00 00 00");
}

static void test_a_node_with_one_number_that_differs_is_not_switched(void **state)
{
	struct bus *bus = *state;

	set_identity(bus);
	bus_send(bus, VENDOR_IS_RIGHT);
	bus_send(bus, PRODUCT_IS_RIGHT);
	bus_send(bus, "7E5 42 01 00 01 00 00 00 00");
	bus_send(bus, SERIAL_IS_RIGHT);
	bus_expect_nothing(bus);
	bus_send(bus, "7E5 5E 00 00 00 00 00 00 00");
	bus_expect_nothing(bus);
}

static void test_the_last_number_alone_does_not_switch(void **state)
{
	set_identity(*state);
	bus_send(*state, SERIAL_IS_RIGHT);
	bus_expect_nothing(*state);
}

static void test_lss_frames_of_another_length_are_ignored(void **state)
{
	bus_send(*state, "7E5 04 01");
	bus_send(*state, "7E5 5E 00 00 00 00 00 00 00");
	bus_expect_nothing(*state);
}

static void test_lss_is_available_in_operational_and_stopped(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus_send(bus, "000 01 10");
	bus_exchange(bus, "7E5 5E 00 00 00 00 00 00 00", "7E4 5E 10 00 00 00 00 00 00");
	bus_send(bus, "000 02 10");
	bus_exchange(bus, "7E5 5E 00 00 00 00 00 00 00", "7E4 5E 10 00 00 00 00 00 00");
}

static void test_a_reset_leaves_configuration_state(void **state)
{
	configure(*state);
	bus_reset(*state, "000 82 10", "710 00");
	bus_send(*state, "7E5 5E 00 00 00 00 00 00 00");
	bus_expect_nothing(*state);
}

/* ---- node-ID ----------------------------------------------------------------------------------------------------- */

static void test_a_configured_node_id_is_active_from_reset_communication_on(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus_exchange(bus, "7E5 11 20 00 00 00 00 00 00", "7E4 11 00 00 00 00 00 00 00");
	bus_exchange(bus, "7E5 5E 00 00 00 00 00 00 00", "7E4 5E 10 00 00 00 00 00 00");
	bus_send(bus, "7E5 04 00 00 00 00 00 00 00");
	bus_expect_nothing(bus);
	bus_reset(bus, "000 82 10", "720 00");
	bus_exchange(bus, "620 40 00 10 00 00 00 00 00", "5A0 43 00 10 00 9A 01 04 00");
	bus_send(bus, "610 40 00 10 00 00 00 00 00");
	bus_expect_nothing(bus);
	assert_true(bus_listens_to(bus, 0x620));
	assert_false(bus_listens_to(bus, 0x610));
}

static void test_identifiers_that_follow_the_node_id_follow_it(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus_send(bus, "7E5 11 20 00 00 00 00 00 00");
	bus_forget(bus);
	bus_reset(bus, "000 82 10", "720 00");
	bus_exchange(bus, "620 40 14 10 00 00 00 00 00", "5A0 43 14 10 00 A0 00 00 00");
	bus_exchange(bus, "620 40 00 12 01 00 00 00 00", "5A0 43 00 12 01 20 06 00 00");
	bus_send(bus, "000 01 20");
	bus_send(bus, "080");
	bus_expect(bus, "1A0 00 00 00 00 00 00 00 00");
}

static void test_identifiers_that_were_configured_do_not_follow_the_node_id(void **state)
{
	struct bus *bus = *state;

	bus->power_on.cob_id_emcy = 0x0AA; /* as a stored value */
	configure(bus);
	bus_send(bus, "7E5 11 20 00 00 00 00 00 00");
	bus_forget(bus);
	bus_reset(bus, "000 82 10", "720 00");
	bus_exchange(bus, "620 40 14 10 00 00 00 00 00", "5A0 43 14 10 00 AA 00 00 00");
}

static void test_a_node_id_may_change_and_change_back(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus_send(bus, "7E5 11 20 00 00 00 00 00 00");
	bus_forget(bus);
	bus_reset(bus, "000 82 10", "720 00");
	configure(bus);
	bus_send(bus, "7E5 11 10 00 00 00 00 00 00");
	bus_forget(bus);
	bus_reset(bus, "000 82 20", "710 00");
	assert_int_equal(bus_read(bus, 0x1014, 0), 0x90);
	assert_int_equal(bus_read(bus, 0x1200, 2), 0x590);
	assert_int_equal(bus_read(bus, 0x1800, 1), 0x40000190);
}

static void test_a_node_id_of_0_or_128_to_254_is_refused(void **state)
{
	configure(*state);
	bus_exchange(*state, "7E5 11 00 00 00 00 00 00 00", "7E4 11 01 00 00 00 00 00 00");
	bus_exchange(*state, "7E5 11 80 00 00 00 00 00 00", "7E4 11 01 00 00 00 00 00 00");
	bus_exchange(*state, "7E5 11 FE 00 00 00 00 00 00", "7E4 11 01 00 00 00 00 00 00");
	bus_exchange(*state, "7E5 11 7F 00 00 00 00 00 00", "7E4 11 00 00 00 00 00 00 00");
}

static void test_reset_node_restores_the_stored_node_id(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus_exchange(bus, "7E5 11 20 00 00 00 00 00 00", "7E4 11 00 00 00 00 00 00 00");
	bus_reset(bus, "000 82 10", "720 00");
	bus_reset(bus, "000 81 20", "710 00");
	assert_int_equal(bus_read(bus, 0x1014, 0), 0x90);
}

static void test_a_stored_node_id_is_active_after_reset_node(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus_exchange(bus, "7E5 11 20 00 00 00 00 00 00", "7E4 11 00 00 00 00 00 00 00");
	bus_exchange(bus, "7E5 17 00 00 00 00 00 00 00", "7E4 17 00 00 00 00 00 00 00");
	assert_int_equal(bus->kept_node_id, 0x20);
	bus_reset(bus, "000 81 10", "720 00");
}

static void test_a_failure_of_the_storage_is_reported(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus->storage_answer = OD_CANNOT_STORE;
	bus_exchange(bus, "7E5 17 00 00 00 00 00 00 00", "7E4 17 02 00 00 00 00 00 00");
}

static void stored(struct bus *bus, enum od_status status)
{
	canopen_lss_stored(&bus->node, status, bus->now_us);
	bus_tick(bus);
}

static void test_the_response_to_a_store_waits_for_the_storage(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus->storage_answer = OD_PENDING;
	bus_exchange(bus, "7E5 11 20 00 00 00 00 00 00", "7E4 11 00 00 00 00 00 00 00");
	bus_send(bus, "7E5 17 00 00 00 00 00 00 00");
	bus_run(bus, 3000000);
	bus_expect_nothing(bus);
	stored(bus, OD_OK);
	bus_expect(bus, "7E4 17 00 00 00 00 00 00 00");
	bus_reset(bus, "000 81 10", "720 00");
}

static void test_a_late_failure_of_the_storage_is_reported_and_the_old_node_id_stays(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus->storage_answer = OD_PENDING;
	bus_exchange(bus, "7E5 11 20 00 00 00 00 00 00", "7E4 11 00 00 00 00 00 00 00");
	bus_send(bus, "7E5 17 00 00 00 00 00 00 00");
	stored(bus, OD_CANNOT_STORE);
	bus_expect(bus, "7E4 17 02 00 00 00 00 00 00");
	bus_reset(bus, "000 81 10", "710 00");
}

static void test_a_second_store_while_one_is_under_way_fails(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus->storage_answer = OD_PENDING;
	bus_send(bus, "7E5 17 00 00 00 00 00 00 00");
	bus_exchange(bus, "7E5 17 00 00 00 00 00 00 00", "7E4 17 02 00 00 00 00 00 00");
	assert_int_equal(bus->store_lss_calls, 1);
	stored(bus, OD_OK);
	bus_expect(bus, "7E4 17 00 00 00 00 00 00 00");
}

static void test_a_store_that_ends_in_waiting_state_has_no_response(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus->storage_answer = OD_PENDING;
	bus_exchange(bus, "7E5 11 20 00 00 00 00 00 00", "7E4 11 00 00 00 00 00 00 00");
	bus_send(bus, "7E5 17 00 00 00 00 00 00 00");
	bus_send(bus, "7E5 04 00 00 00 00 00 00 00");
	stored(bus, OD_OK);
	bus_expect_nothing(bus);
	bus_reset(bus, "000 81 10", "720 00"); /* stored nevertheless */
}

static void test_a_node_id_configured_during_a_store_is_not_the_stored_one(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus->storage_answer = OD_PENDING;
	bus_exchange(bus, "7E5 11 20 00 00 00 00 00 00", "7E4 11 00 00 00 00 00 00 00");
	bus_send(bus, "7E5 17 00 00 00 00 00 00 00");
	bus_exchange(bus, "7E5 11 21 00 00 00 00 00 00", "7E4 11 00 00 00 00 00 00 00");
	stored(bus, OD_OK);
	bus_forget(bus);
	bus_reset(bus, "000 81 10", "720 00");
}

static void test_a_device_without_storage_responds_not_supported(void **state)
{
	struct bus *bus = *state;

	bus->node.device.store_lss = NULL;
	configure(bus);
	bus_exchange(bus, "7E5 17 00 00 00 00 00 00 00", "7E4 17 01 00 00 00 00 00 00");
}

static void test_with_node_id_255_the_node_sends_nothing_from_reset_communication_on(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 40 08 10 00 00 00 00 00", "590 41 08 10 00 14 00 00 00"); /* a transfer under way */
	configure(bus);
	bus_exchange(bus, "7E5 11 FF 00 00 00 00 00 00", "7E4 11 00 00 00 00 00 00 00");
	bus_send(bus, "000 82 10");
	bus_run(bus, 10000000);
	bus_expect_nothing(bus);
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_INITIALISING);
	bus_exchange(bus, "7E5 4C 00 00 00 00 00 00 00", "7E4 50 00 00 00 00 00 00 00");
}

/* ---- a node without a node-ID ------------------------------------------------------------------------------------ */

static void test_a_node_without_a_node_id_sends_nothing_and_receives_lss_only(void **state)
{
	struct bus *bus = unconfigured();

	bus_send(bus, "000 01 00");
	bus_send(bus, "080");
	bus_sample(bus, 1);
	bus_run(bus, 10000000);
	bus_expect_nothing(bus);
	assert_int_equal(bus->filter_count, 1);
	assert_true(bus_listens_to(bus, 0x7E5));
	test_free(bus);
	(void)state;
}

static void test_a_node_without_a_node_id_has_no_heartbeat_consumer(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1016, 1, 4, 0x00050064);
	bus_write(bus, 0x100C, 0, 2, 100);
	bus_write(bus, 0x100D, 0, 1, 2);
	bus_send(bus, "705 05");
	bus_exchange(bus, "710 R", "710 7F");
	bus_send(bus, "7E5 04 01 00 00 00 00 00 00");
	bus_exchange(bus, "7E5 11 FF 00 00 00 00 00 00", "7E4 11 00 00 00 00 00 00 00");
	bus_send(bus, "000 82 10");
	bus_run(bus, 1000000);
	bus_expect_nothing(bus);
	assert_int_equal(bus->values.error_register, 0);
}

static void test_a_node_without_a_node_id_boots_up_with_the_configured_one(void **state)
{
	struct bus *bus = unconfigured();

	configure(bus);
	bus_exchange(bus, "7E5 5E 00 00 00 00 00 00 00", "7E4 5E FF 00 00 00 00 00 00");
	bus_exchange(bus, "7E5 11 20 00 00 00 00 00 00", "7E4 11 00 00 00 00 00 00 00");
	bus_reset(bus, "7E5 04 00 00 00 00 00 00 00", "720 00");
	bus_exchange(bus, "620 40 14 10 00 00 00 00 00", "5A0 43 14 10 00 A0 00 00 00");
	bus_send(bus, "000 01 20");
	bus_send(bus, "080");
	bus_expect(bus, "1A0 00 00 00 00 00 00 00 00");
	test_free(bus);
	(void)state;
}

static void test_an_error_raised_without_a_node_id_is_sent_after_boot_up(void **state)
{
	struct bus *bus = unconfigured();

	canopen_error_set(&bus->node, 0x5530, 0x80, NULL, bus->now_us);
	configure(bus);
	bus_exchange(bus, "7E5 11 20 00 00 00 00 00 00", "7E4 11 00 00 00 00 00 00 00");
	bus_send(bus, "7E5 04 00 00 00 00 00 00 00");
	bus_run(bus, 10000);
	bus_expect(bus, "720 00");
	bus_expect(bus, "0A0 30 55 81 00 00 00 00 00");
	test_free(bus);
	(void)state;
}

static void test_a_node_without_a_node_id_responds_to_identify_non_configured(void **state)
{
	struct bus *bus = unconfigured();

	bus_exchange(bus, "7E5 4C 00 00 00 00 00 00 00", "7E4 50 00 00 00 00 00 00 00");
	test_free(bus);
	(void)state;
}

static void test_a_node_with_a_node_id_does_not_respond_to_identify_non_configured(void **state)
{
	bus_send(*state, "7E5 4C 00 00 00 00 00 00 00");
	bus_expect_nothing(*state);
}

/* ---- bit timing -------------------------------------------------------------------------------------------------- */

static void test_a_configured_bit_rate_is_activated_after_the_switch_delay(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus_exchange(bus, "7E5 13 00 02 00 00 00 00 00", "7E4 13 00 00 00 00 00 00 00");
	assert_int_equal(bus->active_bit_s, 0);
	uint64_t start_us = bus->now_us;
	bus_send(bus, "7E5 15 F4 01 00 00 00 00 00");
	bus_run(bus, 499999);
	assert_int_equal(bus->active_bit_s, 0);
	bus_run(bus, 1);
	assert_int_equal(bus->active_bit_s, 500000);
	assert_int_equal(bus->switched_us - start_us, 500000);
	bus_expect_nothing(bus);
}

/* 500 ms at the old bit rate, 500 ms at the new one. */
static void switch_bit_rate(struct bus *bus)
{
	configure(bus);
	bus_exchange(bus, "7E5 13 00 02 00 00 00 00 00", "7E4 13 00 00 00 00 00 00 00");
	bus_send(bus, "7E5 15 F4 01 00 00 00 00 00");
}

static void test_the_node_neither_sends_nor_receives_until_both_switch_delays_have_passed(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1017, 0, 2, 100);
	bus_forget(bus);
	switch_bit_rate(bus);
	for (int i = 0; i < 9; i++) {
		bus_run(bus, 100000);
		bus_send(bus, "610 40 00 10 00 00 00 00 00");
		bus_send(bus, "7E5 5E 00 00 00 00 00 00 00");
		bus_send(bus, "000 01 00");
		canopen_error_set(&bus->node, 0xFF00, 0x80, NULL, bus->now_us);
		bus_sample(bus, 1);
	}
	bus_run(bus, 99999);
	bus_expect_nothing(bus);
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_PRE_OPERATIONAL);
}

static void test_after_the_switch_the_heartbeat_continues_and_errors_raised_meanwhile_are_sent(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1017, 0, 2, 100);
	bus_forget(bus);
	switch_bit_rate(bus);
	canopen_error_set(&bus->node, 0xFF00, 0x80, NULL, bus->now_us);
	bus_run(bus, 1000000);
	bus_expect(bus, "710 7F");
	bus_expect(bus, "090 00 FF 81 00 00 00 00 00");
	bus_expect_nothing(bus);
	bus_exchange(bus, "7E5 5E 00 00 00 00 00 00 00", "7E4 5E 10 00 00 00 00 00 00");
}

static void test_heartbeat_consumers_are_suspended_while_the_bit_rate_is_switched(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1016, 1, 4, 0x00200064);
	bus_send(bus, "720 05");
	switch_bit_rate(bus);
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);
	bus_send(bus, "720 05");
	bus_run(bus, 100000);
	bus_expect(bus, "090 30 81 11 20 00 00 00 00");
}

static void test_the_timeout_of_sync_is_suspended_while_the_bit_rate_is_switched(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1006, 0, 4, 10000), 0);
	bus_send(bus, "080");
	bus_forget(bus);
	switch_bit_rate(bus);
	bus_run(bus, 5000000);
	assert_int_equal(bus_read(bus, 0x1001, 0), 0);
}

static void test_the_event_timer_of_an_rpdo_is_suspended_while_the_bit_rate_is_switched(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x1403, 5, 2, 100);
	bus_send(bus, "510 00 00");
	bus_forget(bus);
	switch_bit_rate(bus);
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);
	bus_send(bus, "510 00 00");
	bus_run(bus, 100000);
	bus_expect(bus, "090 50 82 11 03 14 00 00 00");
}

static void test_a_switch_delay_of_0_switches_at_once(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus_exchange(bus, "7E5 13 00 04 00 00 00 00 00", "7E4 13 00 00 00 00 00 00 00");
	bus_send(bus, "7E5 15 00 00 00 00 00 00 00");
	assert_int_equal(bus->active_bit_s, 125000);
	bus_exchange(bus, "7E5 5E 00 00 00 00 00 00 00", "7E4 5E 10 00 00 00 00 00 00");
}

static void test_without_a_bit_rate_configured_activation_does_nothing(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus_send(bus, "7E5 15 F4 01 00 00 00 00 00");
	bus_exchange(bus, "7E5 5E 00 00 00 00 00 00 00", "7E4 5E 10 00 00 00 00 00 00");
	bus_run(bus, 2000000);
	assert_int_equal(bus->active_bit_s, 0);
}

static void test_every_bit_rate_of_the_table_has_its_index(void **state)
{
	static const struct {
		const char *request;
		uint32_t bit_s;
	} table[] = {{"7E5 13 00 00 00 00 00 00 00", 1000000}, {"7E5 13 00 02 00 00 00 00 00", 500000},
		{"7E5 13 00 03 00 00 00 00 00", 250000}, {"7E5 13 00 04 00 00 00 00 00", 125000},
		{"7E5 13 00 06 00 00 00 00 00", 50000}, {"7E5 13 00 07 00 00 00 00 00", 20000},
		{"7E5 13 00 08 00 00 00 00 00", 10000}};
	struct bus *bus = *state;

	configure(bus);
	for (size_t i = 0; i < sizeof(table) / sizeof(table[0]); i++) {
		bus_exchange(bus, table[i].request, "7E4 13 00 00 00 00 00 00 00");
		bus_send(bus, "7E5 15 00 00 00 00 00 00 00");
		assert_int_equal(bus->active_bit_s, table[i].bit_s);
	}
}

static void test_a_bit_rate_of_another_table_a_reserved_or_an_unsupported_one_is_refused(void **state)
{
	configure(*state);
	bus_exchange(*state, "7E5 13 01 02 00 00 00 00 00", "7E4 13 01 00 00 00 00 00 00");
	bus_exchange(*state, "7E5 13 00 05 00 00 00 00 00", "7E4 13 01 00 00 00 00 00 00");
	bus_exchange(*state, "7E5 13 00 09 00 00 00 00 00", "7E4 13 01 00 00 00 00 00 00");
	bus_exchange(*state, "7E5 13 00 01 00 00 00 00 00", "7E4 13 01 00 00 00 00 00 00");
}

static void test_without_a_bus_that_can_be_switched_no_bit_rate_is_accepted(void **state)
{
	struct bus *bus = *state;

	bus->node.device.bit_rate_possible = NULL;
	configure(bus);
	bus_exchange(bus, "7E5 13 00 02 00 00 00 00 00", "7E4 13 01 00 00 00 00 00 00");
	bus_send(bus, "7E5 15 F4 01 00 00 00 00 00");
	assert_int_equal(bus->active_bit_s, 0);
}

static void test_the_bit_rate_is_stored_with_the_node_id(void **state)
{
	struct bus *bus = *state;

	configure(bus);
	bus_exchange(bus, "7E5 13 00 04 00 00 00 00 00", "7E4 13 00 00 00 00 00 00 00");
	bus_exchange(bus, "7E5 17 00 00 00 00 00 00 00", "7E4 17 00 00 00 00 00 00 00");
	assert_int_equal(bus->kept_bit_s, 125000);
	assert_int_equal(bus->kept_node_id, 0x10);
}

/* ---- inquiry and identification ---------------------------------------------------------------------------------- */

static void test_each_number_of_the_lss_address_can_be_inquired(void **state)
{
	set_identity(*state);
	configure(*state);
	bus_exchange(*state, "7E5 5A 00 00 00 00 00 00 00", "7E4 5A 55 4D 49 00 00 00 00");
	bus_exchange(*state, "7E5 5B 00 00 00 00 00 00 00", "7E4 5B 09 00 00 00 00 00 00");
	bus_exchange(*state, "7E5 5C 00 00 00 00 00 00 00", "7E4 5C 00 00 01 00 00 00 00");
	bus_exchange(*state, "7E5 5D 00 00 00 00 00 00 00", "7E4 5D 78 56 34 12 00 00 00");
}

static void identify(struct bus *bus, const char *serial_from, const char *serial_to)
{
	set_identity(bus);
	bus_send(bus, "7E5 46 55 4D 49 00 00 00 00");
	bus_send(bus, "7E5 47 09 00 00 00 00 00 00");
	bus_send(bus, "7E5 48 00 00 01 00 00 00 00");
	bus_send(bus, "7E5 49 FF FF 01 00 00 00 00");
	bus_send(bus, serial_from);
	bus_expect_nothing(bus);
	bus_send(bus, serial_to);
}

static void test_a_node_within_the_ranges_responds_to_identify(void **state)
{
	identify(*state, "7E5 4A 78 56 34 12 00 00 00", "7E5 4B 78 56 34 12 00 00 00");
	bus_expect(*state, "7E4 4F 00 00 00 00 00 00 00");
	bus_expect_nothing(*state);
}

static void test_a_node_below_the_range_does_not_respond_to_identify(void **state)
{
	identify(*state, "7E5 4A 79 56 34 12 00 00 00", "7E5 4B FF FF FF FF 00 00 00");
	bus_expect_nothing(*state);
}

static void test_a_node_above_the_range_does_not_respond_to_identify(void **state)
{
	identify(*state, "7E5 4A 00 00 00 00 00 00 00", "7E5 4B 77 56 34 12 00 00 00");
	bus_expect_nothing(*state);
}

/* ---- fastscan ---------------------------------------------------------------------------------------------------- */

static bool scan(struct bus *bus, uint32_t value, uint8_t bit, uint8_t number, uint8_t next)
{
	const struct can_msg msg = {.id = 0x7E5,
		.len = 8,
		.data = {0x51, (uint8_t)value, (uint8_t)(value >> 8), (uint8_t)(value >> 16), (uint8_t)(value >> 24),
			bit, number, next}};
	size_t before = bus->sent_count;

	bus_send_msg(bus, &msg);
	if (bus->sent_count == before)
		return false;
	bus_expect(bus, "7E4 4F 00 00 00 00 00 00 00");
	return true;
}

/* As a master: a bit is 0 if at least one node responds. */
static uint32_t find_number(struct bus *bus, uint8_t number)
{
	uint32_t value = 0;

	for (int bit = 31; bit >= 0; bit--)
		if (!scan(bus, value, (uint8_t)bit, number, number))
			value |= 1u << bit;
	return value;
}

static void test_fastscan_determines_the_lss_address_and_switches_the_node(void **state)
{
	static const uint32_t identity[] = {0x00494D55, 9, 0x00010000, 0x12345678};
	struct bus *bus = unconfigured();

	assert_true(scan(bus, 0, 0x80, 0, 0));
	for (uint8_t i = 0; i < 4; i++) {
		assert_int_equal(find_number(bus, i), identity[i]);
		assert_true(scan(bus, identity[i], 0, i, (i + 1) & 3));
	}
	bus_exchange(bus, "7E5 11 20 00 00 00 00 00 00", "7E4 11 00 00 00 00 00 00 00");
	bus_reset(bus, "7E5 04 00 00 00 00 00 00 00", "720 00");
	test_free(bus);
	(void)state;
}

static void test_fastscan_matches_one_number_at_a_time(void **state)
{
	struct bus *bus = unconfigured();

	assert_true(scan(bus, 0, 0x80, 0, 0));
	assert_false(scan(bus, 9, 0, 1, 2));
	test_free(bus);
	(void)state;
}

static void test_fastscan_restarts_with_a_reset(void **state)
{
	struct bus *bus = unconfigured();

	assert_true(scan(bus, 0x00494D55, 0, 0, 1));
	assert_true(scan(bus, 0, 0x80, 0, 0));
	assert_false(scan(bus, 9, 0, 1, 2));
	assert_true(scan(bus, 0x00494D55, 0, 0, 1));
	assert_true(scan(bus, 9, 0, 1, 2));
	test_free(bus);
	(void)state;
}

static void test_fastscan_that_ends_before_all_four_numbers_are_confirmed_selects_no_node(void **state)
{
	static const uint32_t identity[] = {0x00494D55, 9, 0x00010000, 0x12345678};
	/* the numbers that are confirmed, of which the last one ends the scan */
	static const uint8_t scans[][4] = {{0, 1}, {0, 1, 2}, {0, 3}, {0, 2, 3}, {0, 1, 3}};

	(void)state;
	for (size_t i = 0; i < sizeof(scans) / sizeof(scans[0]); i++) {
		struct bus *bus = unconfigured();
		size_t k = 0;

		assert_true(scan(bus, 0, 0x80, 0, 0));
		do {
			assert_true(scan(bus, identity[scans[i][k]], 0, scans[i][k], scans[i][(k + 1) % 4]));
		} while (scans[i][++k]);
		bus_send(bus, "7E5 5E 00 00 00 00 00 00 00");
		bus_send(bus, "7E5 11 20 00 00 00 00 00 00");
		bus_expect_nothing(bus);
		test_free(bus);
	}
}

static void test_fastscan_with_numbers_that_do_not_exist_is_ignored(void **state)
{
	struct bus *bus = unconfigured();

	assert_false(scan(bus, 0, 32, 0, 0));
	assert_false(scan(bus, 0x00494D55, 0, 4, 0));
	assert_false(scan(bus, 0x00494D55, 0, 0, 4));
	test_free(bus);
	(void)state;
}

static void test_a_node_with_a_node_id_does_not_respond_to_fastscan(void **state)
{
	assert_false(scan(*state, 0, 0x80, 0, 0));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		PRE_OPERATIONAL(test_switch_global_has_no_response_and_enters_configuration_state),
		PRE_OPERATIONAL(test_in_waiting_state_configuration_and_inquiry_are_ignored),
		PRE_OPERATIONAL(test_switch_global_0_leaves_configuration_state),
		PRE_OPERATIONAL(test_the_node_that_matches_all_four_numbers_is_switched_and_responds),
		PRE_OPERATIONAL(test_a_node_with_one_number_that_differs_is_not_switched),
		PRE_OPERATIONAL(test_the_last_number_alone_does_not_switch),
		PRE_OPERATIONAL(test_lss_frames_of_another_length_are_ignored),
		PRE_OPERATIONAL(test_lss_is_available_in_operational_and_stopped),
		PRE_OPERATIONAL(test_a_reset_leaves_configuration_state),
		PRE_OPERATIONAL(test_a_configured_node_id_is_active_from_reset_communication_on),
		PRE_OPERATIONAL(test_identifiers_that_follow_the_node_id_follow_it),
		PRE_OPERATIONAL(test_identifiers_that_were_configured_do_not_follow_the_node_id),
		PRE_OPERATIONAL(test_a_node_id_may_change_and_change_back),
		PRE_OPERATIONAL(test_a_node_id_of_0_or_128_to_254_is_refused),
		PRE_OPERATIONAL(test_reset_node_restores_the_stored_node_id),
		PRE_OPERATIONAL(test_a_stored_node_id_is_active_after_reset_node),
		PRE_OPERATIONAL(test_a_failure_of_the_storage_is_reported),
		PRE_OPERATIONAL(test_the_response_to_a_store_waits_for_the_storage),
		PRE_OPERATIONAL(test_a_late_failure_of_the_storage_is_reported_and_the_old_node_id_stays),
		PRE_OPERATIONAL(test_a_second_store_while_one_is_under_way_fails),
		PRE_OPERATIONAL(test_a_store_that_ends_in_waiting_state_has_no_response),
		PRE_OPERATIONAL(test_a_node_id_configured_during_a_store_is_not_the_stored_one),
		PRE_OPERATIONAL(test_a_device_without_storage_responds_not_supported),
		PRE_OPERATIONAL(test_a_node_without_a_node_id_has_no_heartbeat_consumer),
		PRE_OPERATIONAL(test_with_node_id_255_the_node_sends_nothing_from_reset_communication_on),
		cmocka_unit_test(test_a_node_without_a_node_id_sends_nothing_and_receives_lss_only),
		cmocka_unit_test(test_a_node_without_a_node_id_boots_up_with_the_configured_one),
		cmocka_unit_test(test_an_error_raised_without_a_node_id_is_sent_after_boot_up),
		cmocka_unit_test(test_a_node_without_a_node_id_responds_to_identify_non_configured),
		PRE_OPERATIONAL(test_a_node_with_a_node_id_does_not_respond_to_identify_non_configured),
		PRE_OPERATIONAL(test_a_configured_bit_rate_is_activated_after_the_switch_delay),
		PRE_OPERATIONAL(test_the_node_neither_sends_nor_receives_until_both_switch_delays_have_passed),
		PRE_OPERATIONAL(test_after_the_switch_the_heartbeat_continues_and_errors_raised_meanwhile_are_sent),
		PRE_OPERATIONAL(test_heartbeat_consumers_are_suspended_while_the_bit_rate_is_switched),
		OPERATIONAL(test_the_timeout_of_sync_is_suspended_while_the_bit_rate_is_switched),
		OPERATIONAL(test_the_event_timer_of_an_rpdo_is_suspended_while_the_bit_rate_is_switched),
		PRE_OPERATIONAL(test_a_switch_delay_of_0_switches_at_once),
		PRE_OPERATIONAL(test_without_a_bit_rate_configured_activation_does_nothing),
		PRE_OPERATIONAL(test_every_bit_rate_of_the_table_has_its_index),
		PRE_OPERATIONAL(test_a_bit_rate_of_another_table_a_reserved_or_an_unsupported_one_is_refused),
		PRE_OPERATIONAL(test_without_a_bus_that_can_be_switched_no_bit_rate_is_accepted),
		PRE_OPERATIONAL(test_the_bit_rate_is_stored_with_the_node_id),
		PRE_OPERATIONAL(test_each_number_of_the_lss_address_can_be_inquired),
		PRE_OPERATIONAL(test_a_node_within_the_ranges_responds_to_identify),
		PRE_OPERATIONAL(test_a_node_below_the_range_does_not_respond_to_identify),
		PRE_OPERATIONAL(test_a_node_above_the_range_does_not_respond_to_identify),
		cmocka_unit_test(test_fastscan_determines_the_lss_address_and_switches_the_node),
		cmocka_unit_test(test_fastscan_matches_one_number_at_a_time),
		cmocka_unit_test(test_fastscan_restarts_with_a_reset),
		cmocka_unit_test(test_fastscan_that_ends_before_all_four_numbers_are_confirmed_selects_no_node),
		cmocka_unit_test(test_fastscan_with_numbers_that_do_not_exist_is_ignored),
		PRE_OPERATIONAL(test_a_node_with_a_node_id_does_not_respond_to_fastscan),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
