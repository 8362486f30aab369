/* Store (1010h) and restore (1011h): CiA 301, 7.5.2.13 and 7.5.2.14. "save" is 73 61 76 65, "load" 6C 6F 61 64. */
#include "tests/scenario/bus.h"

static void done(struct bus *bus, enum od_status status)
{
	canopen_store_done(&bus->node, status, bus->now_us);
	bus_tick(bus);
}

static void test_the_device_stores_on_command_and_not_by_itself(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_read(bus, 0x1010, 0), 4);
	assert_int_equal(bus_read(bus, 0x1011, 0), 4);
	for (uint8_t sub = 1; sub <= 4; sub++) {
		assert_int_equal(bus_read(bus, 0x1010, sub), 1);
		assert_int_equal(bus_read(bus, 0x1011, sub), 1);
	}
}

static void test_save_stores_the_group_of_its_sub_index(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 23 10 10 01 73 61 76 65", "590 60 10 10 01 00 00 00 00");
	assert_int_equal(bus->store_calls, 1);
	assert_int_equal(bus->stored, OD_GROUP_ALL);
	bus_exchange(bus, "610 23 10 10 02 73 61 76 65", "590 60 10 10 02 00 00 00 00");
	assert_int_equal(bus->stored, OD_GROUP_COMMUNICATION);
	bus_exchange(bus, "610 23 10 10 03 73 61 76 65", "590 60 10 10 03 00 00 00 00");
	assert_int_equal(bus->stored, OD_GROUP_APPLICATION);
	bus_exchange(bus, "610 23 10 10 04 73 61 76 65", "590 60 10 10 04 00 00 00 00");
	assert_int_equal(bus->stored, OD_GROUP_MANUFACTURER);
	assert_int_equal(bus->store_calls, 4);
	assert_int_equal(bus->restore_calls, 0);
	assert_int_equal(bus_read(bus, 0x1010, 1), 1); /* the signature is not a value */
}

static void test_load_restores_the_group_of_its_sub_index(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 23 11 10 01 6C 6F 61 64", "590 60 11 10 01 00 00 00 00");
	assert_int_equal(bus->restored, OD_GROUP_ALL);
	bus_exchange(bus, "610 23 11 10 04 6C 6F 61 64", "590 60 11 10 04 00 00 00 00");
	assert_int_equal(bus->restored, OD_GROUP_MANUFACTURER);
	assert_int_equal(bus->restore_calls, 2);
	assert_int_equal(bus->store_calls, 0);
	assert_int_equal(bus_read(bus, 0x1011, 1), 1);
}

static void test_a_restore_takes_effect_at_the_next_reset(void **state)
{
	struct bus *bus = *state;

	bus_write(bus, 0x2001, 0, 1, 1);
	bus_exchange(bus, "610 23 11 10 01 6C 6F 61 64", "590 60 11 10 01 00 00 00 00");
	assert_int_equal(bus_read(bus, 0x2001, 0), 1);
	bus_reset(bus, "000 81 10", "710 00");
	assert_int_equal(bus_read(bus, 0x2001, 0), 2);
}

static void test_a_wrong_signature_is_refused(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "610 23 10 10 01 6C 6F 61 64", "590 80 10 10 01 20 00 00 08");
	bus_exchange(bus, "610 23 10 10 01 65 76 61 73", "590 80 10 10 01 20 00 00 08");
	bus_exchange(bus, "610 23 10 10 01 01 00 00 00", "590 80 10 10 01 20 00 00 08");
	bus_exchange(bus, "610 23 11 10 01 73 61 76 65", "590 80 11 10 01 20 00 00 08");
	bus_exchange(bus, "610 2B 10 10 01 73 61 00 00", "590 80 10 10 01 13 00 07 06");
	bus_exchange(bus, "610 2F 10 10 00 04 00 00 00", "590 80 10 10 00 02 00 01 06");
	assert_int_equal(bus->store_calls, 0);
	assert_int_equal(bus->restore_calls, 0);
}

static void test_a_failed_store_is_aborted(void **state)
{
	struct bus *bus = *state;

	bus->storage_answer = OD_CANNOT_STORE;
	bus_exchange(bus, "610 23 10 10 01 73 61 76 65", "590 80 10 10 01 20 00 00 08");
	bus_exchange(bus, "610 23 11 10 01 6C 6F 61 64", "590 80 11 10 01 20 00 00 08");
}

static void test_a_device_without_storage_refuses(void **state)
{
	struct bus *bus = bus_new();

	assert_int_equal(canopen_init(&bus->node, &bus->od, &bus->port, NULL, BUS_NODE_ID), 0);
	canopen_start(&bus->node, bus->now_us);
	bus_forget(bus);
	bus_exchange(bus, "610 23 10 10 01 73 61 76 65", "590 80 10 10 01 20 00 00 08");
	test_free(bus);
	(void)state;
}

/* ---- a slow disk ------------------------------------------------------------------------------------------------- */

static void test_the_answer_waits_until_the_store_is_done(void **state)
{
	struct bus *bus = *state;

	bus->storage_answer = OD_PENDING;
	bus_send(bus, "610 23 10 10 01 73 61 76 65");
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);
	done(bus, OD_OK);
	bus_expect(bus, "590 60 10 10 01 00 00 00 00");
	done(bus, OD_OK);
	bus_run(bus, 5000000);
	bus_expect_nothing(bus);
}

static void test_a_store_that_fails_later_is_aborted(void **state)
{
	struct bus *bus = *state;

	bus->storage_answer = OD_PENDING;
	bus_send(bus, "610 23 11 10 02 6C 6F 61 64");
	done(bus, OD_CANNOT_STORE);
	bus_expect(bus, "590 80 11 10 02 20 00 00 08");
	bus_expect_nothing(bus);
}

static void test_a_segmented_save_is_answered_with_its_segment(void **state)
{
	struct bus *bus = *state;

	bus->storage_answer = OD_PENDING;
	bus_exchange(bus, "610 21 10 10 01 04 00 00 00", "590 60 10 10 01 00 00 00 00");
	bus_send(bus, "610 07 73 61 76 65 00 00 00");
	bus_expect_nothing(bus);
	done(bus, OD_OK);
	bus_expect(bus, "590 20 00 00 00 00 00 00 00");
}

static void test_while_one_store_runs_the_next_is_refused(void **state)
{
	struct bus *bus = *state;

	bus->storage_answer = OD_PENDING;
	bus_send(bus, "610 23 10 10 01 73 61 76 65");
	bus_exchange(bus, "610 23 10 10 02 73 61 76 65", "590 80 10 10 02 22 00 00 08");
	bus_exchange(bus, "610 23 11 10 01 6C 6F 61 64", "590 80 11 10 01 22 00 00 08");
	assert_int_equal(bus->store_calls, 1);
	done(bus, OD_OK);
	bus_forget(bus);
	bus_send(bus, "610 23 10 10 02 73 61 76 65");
	assert_int_equal(bus->store_calls, 2);
}

static void test_another_request_during_a_store_is_served_and_the_answer_of_the_store_is_dropped(void **state)
{
	struct bus *bus = *state;

	bus->storage_answer = OD_PENDING;
	bus_send(bus, "610 23 10 10 01 73 61 76 65");
	bus_exchange(bus, "610 40 00 10 00 00 00 00 00", "590 43 00 10 00 9A 01 04 00");
	done(bus, OD_OK);
	bus_expect_nothing(bus);
}

static void test_the_clients_abort_a_stop_and_a_reset_drop_the_answer(void **state)
{
	struct bus *bus = *state;

	bus->storage_answer = OD_PENDING;
	bus_send(bus, "610 23 10 10 01 73 61 76 65");
	bus_send(bus, "610 80 10 10 01 00 00 04 05");
	done(bus, OD_OK);
	bus_expect_nothing(bus);

	bus_send(bus, "610 23 10 10 01 73 61 76 65");
	bus_send(bus, "000 02 10");
	done(bus, OD_OK);
	bus_expect_nothing(bus);
	bus_send(bus, "000 80 10");

	bus_send(bus, "610 23 10 10 01 73 61 76 65");
	bus_reset(bus, "000 82 10", "710 00");
	done(bus, OD_OK);
	bus_expect_nothing(bus);
	assert_int_equal(bus->store_calls, 3);
}

static void test_a_store_without_an_sdo_client_sends_nothing(void **state)
{
	struct bus *bus = *state;
	const uint8_t save[] = {'s', 'a', 'v', 'e'};

	bus->storage_answer = OD_PENDING;
	assert_int_equal(od_write(&bus->od, 0x1010, 1, save, 4), OD_PENDING); /* not by SDO */
	done(bus, OD_OK);
	bus_expect_nothing(bus);
}

/* ---- date of the configuration (1020h) --------------------------------------------------------------------------- */

static void set_date(struct bus *bus)
{
	assert_int_equal(bus_write(bus, 0x1020, 1, 4, 15666), 0);
	assert_int_equal(bus_write(bus, 0x1020, 2, 4, 36000000), 0);
}

static void test_the_date_of_the_configuration_stays_as_it_was_written(void **state)
{
	struct bus *bus = *state;

	set_date(bus);
	assert_int_equal(bus_read(bus, 0x1020, 1), 15666);
	assert_int_equal(bus_read(bus, 0x1020, 2), 36000000);
}

static void test_a_later_change_of_the_configuration_clears_its_date(void **state)
{
	struct bus *bus = *state;

	set_date(bus);
	assert_int_equal(bus_write(bus, 0x2001, 0, 1, 1), 0);
	assert_int_equal(bus_read(bus, 0x1020, 1), 0);
	assert_int_equal(bus_read(bus, 0x1020, 2), 0);
}

static void test_a_change_of_a_communication_object_clears_the_date_too(void **state)
{
	struct bus *bus = *state;

	set_date(bus);
	assert_int_equal(bus_write(bus, 0x1017, 0, 2, 0), 0);
	assert_int_equal(bus_read(bus, 0x1020, 1), 0);
}

static void test_a_command_or_a_refused_write_keeps_the_date(void **state)
{
	struct bus *bus = *state;

	set_date(bus);
	bus_exchange(bus, "610 23 10 10 01 73 61 76 65", "590 60 10 10 01 00 00 00 00");
	assert_int_equal(bus_write(bus, 0x1003, 0, 1, 0), 0);
	assert_int_equal(bus_write(bus, 0x2001, 0, 1, 200), 0x06090031);
	assert_int_equal(bus_read(bus, 0x1020, 1), 15666);
	assert_int_equal(bus_read(bus, 0x1020, 2), 36000000);
}

static void test_the_date_is_stored(void **state)
{
	struct bus *bus = *state;
	const uint8_t kept[] = {1, 0, 0, 0, 0x20, 0x10, 1, 4, 0, 0, 0, 0x32, 0x3D, 0, 0};
	uint8_t dcf[256];

	assert_int_equal(bus_write(bus, 0x1020, 1, 4, 15666), 0);
	assert_int_equal(od_encode(&bus->od, OD_GROUP_COMMUNICATION, &bus->power_on, dcf, sizeof(dcf)), sizeof(kept));
	assert_memory_equal(dcf, kept, sizeof(kept));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		PRE_OPERATIONAL(test_the_device_stores_on_command_and_not_by_itself),
		PRE_OPERATIONAL(test_save_stores_the_group_of_its_sub_index),
		PRE_OPERATIONAL(test_load_restores_the_group_of_its_sub_index),
		PRE_OPERATIONAL(test_a_restore_takes_effect_at_the_next_reset),
		PRE_OPERATIONAL(test_a_wrong_signature_is_refused),
		PRE_OPERATIONAL(test_a_failed_store_is_aborted),
		cmocka_unit_test(test_a_device_without_storage_refuses),
		PRE_OPERATIONAL(test_the_answer_waits_until_the_store_is_done),
		PRE_OPERATIONAL(test_a_store_that_fails_later_is_aborted),
		PRE_OPERATIONAL(test_a_segmented_save_is_answered_with_its_segment),
		PRE_OPERATIONAL(test_while_one_store_runs_the_next_is_refused),
		PRE_OPERATIONAL(test_another_request_during_a_store_is_served_and_the_answer_of_the_store_is_dropped),
		PRE_OPERATIONAL(test_the_clients_abort_a_stop_and_a_reset_drop_the_answer),
		PRE_OPERATIONAL(test_a_store_without_an_sdo_client_sends_nothing),
		PRE_OPERATIONAL(test_the_date_of_the_configuration_stays_as_it_was_written),
		PRE_OPERATIONAL(test_a_later_change_of_the_configuration_clears_its_date),
		PRE_OPERATIONAL(test_a_change_of_a_communication_object_clears_the_date_too),
		PRE_OPERATIONAL(test_a_command_or_a_refused_write_keeps_the_date),
		PRE_OPERATIONAL(test_the_date_is_stored),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
