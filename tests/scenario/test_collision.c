/* COB-ID collision: frames of other nodes with identifiers of this node, 10h: EMCY 8150h (CiA 301, table 26). */
#include "tests/scenario/bus.h"

#define COLLISION_710 "090 50 81 11 10 07 00 00 00"

static void test_a_boot_up_of_another_node_with_this_node_id_is_reported(void **state)
{
	bus_exchange(*state, "710 00", COLLISION_710);
}

static void test_a_heartbeat_of_another_node_with_this_node_id_is_reported(void **state)
{
	bus_exchange(*state, "710 7F", COLLISION_710);
}

static void test_a_response_of_another_sdo_server_with_this_identifier_is_reported(void **state)
{
	bus_exchange(*state, "590 60 00 20 01 00 00 00 00", "090 50 81 11 90 05 00 00 00");
}

static void test_an_emcy_with_this_identifier_is_reported(void **state)
{
	bus_exchange(*state, "090 00 00 00 00 00 00 00 00", "090 50 81 11 90 00 00 00 00");
}

static void test_a_pdo_with_the_identifier_of_a_tpdo_is_reported_in_operational(void **state)
{
	bus_send(*state, "000 01 10");
	bus_exchange(*state, "390 00 00 00 00 00 00 00 00", "090 50 81 11 90 03 00 00 00");
}

static void test_an_invalid_tpdo_has_no_identifier_that_could_collide(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1802, 1, 4, 0x80000390), 0);
	bus_send(bus, "390 00 00 00 00 00 00 00 00");
	bus_expect_nothing(bus);
	assert_false(bus_listens_to(bus, 0x390));
}

static void test_a_changed_identifier_collides_where_it_is_now(void **state)
{
	struct bus *bus = *state;

	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x80000090), 0);
	assert_int_equal(bus_write(bus, 0x1014, 0, 4, 0x000000AA), 0);
	assert_true(bus_listens_to(bus, 0x0AA));
	assert_false(bus_listens_to(bus, 0x090));
	bus_send(bus, "090 00 00 00 00 00 00 00 00");
	bus_expect_nothing(bus);
	bus_exchange(bus, "0AA 00 00 00 00 00 00 00 00", "0AA 50 81 11 AA 00 00 00 00");
}

static void test_a_remote_request_is_not_a_collision(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "710 R", "710 7F");
	bus_send(bus, "190 R");
	bus_expect_nothing(bus);
}

static void test_frames_of_other_nodes_are_not_a_collision(void **state)
{
	bus_send(*state, "711 00");
	bus_send(*state, "591 60 00 20 01 00 00 00 00");
	bus_send(*state, "091 00 00 00 00 00 00 00 00");
	bus_send(*state, "191 00 00 00 00 00 00 00 00");
	bus_expect_nothing(*state);
}

static void test_a_lasting_collision_is_reported_once(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "710 00", COLLISION_710);
	for (int i = 0; i < 20; i++) {
		bus_run(bus, 5000000);
		bus_send(bus, "710 7F");
	}
	bus_expect_nothing(bus);
}

static void test_a_collision_ends_after_ten_seconds_without_such_a_frame(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "710 00", COLLISION_710);
	bus_run(bus, 9999999);
	bus_expect_nothing(bus);
	bus_run(bus, 1);
	bus_expect(bus, "090 00 00 00 00 00 00 00 00");
	bus_exchange(bus, "710 00", COLLISION_710);
}

static void test_a_collision_does_not_change_the_nmt_state(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "000 01 10");
	bus_exchange(bus, "710 05", COLLISION_710);
	assert_int_equal(canopen_nmt_state(&bus->node), NMT_OPERATIONAL);
}

static void test_the_device_is_notified_of_a_collision_once(void **state)
{
	struct bus *bus = *state;

	bus_send(bus, "710 00");
	bus_send(bus, "710 7F");
	assert_int_equal(bus->collisions, 1);
	assert_int_equal(bus->collision_id, 0x710);
}

static void test_after_reset_communication_a_collision_is_reported_again(void **state)
{
	struct bus *bus = *state;

	bus_exchange(bus, "710 00", COLLISION_710);
	bus_reset(bus, "000 82 10", "710 00");
	bus_exchange(bus, "710 7F", COLLISION_710);
}

static void test_the_receive_filter_has_the_identifiers_of_this_node(void **state)
{
	assert_true(bus_listens_to(*state, 0x710));
	assert_true(bus_listens_to(*state, 0x590));
	assert_true(bus_listens_to(*state, 0x090));
	for (uint32_t id = 0x190; id <= 0x490; id += 0x100)
		assert_true(bus_listens_to(*state, id));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		PRE_OPERATIONAL(test_a_boot_up_of_another_node_with_this_node_id_is_reported),
		PRE_OPERATIONAL(test_a_heartbeat_of_another_node_with_this_node_id_is_reported),
		PRE_OPERATIONAL(test_a_response_of_another_sdo_server_with_this_identifier_is_reported),
		PRE_OPERATIONAL(test_an_emcy_with_this_identifier_is_reported),
		PRE_OPERATIONAL(test_a_pdo_with_the_identifier_of_a_tpdo_is_reported_in_operational),
		PRE_OPERATIONAL(test_an_invalid_tpdo_has_no_identifier_that_could_collide),
		PRE_OPERATIONAL(test_a_changed_identifier_collides_where_it_is_now),
		PRE_OPERATIONAL(test_a_remote_request_is_not_a_collision),
		PRE_OPERATIONAL(test_frames_of_other_nodes_are_not_a_collision),
		PRE_OPERATIONAL(test_a_lasting_collision_is_reported_once),
		PRE_OPERATIONAL(test_a_collision_ends_after_ten_seconds_without_such_a_frame),
		PRE_OPERATIONAL(test_a_collision_does_not_change_the_nmt_state),
		PRE_OPERATIONAL(test_the_device_is_notified_of_a_collision_once),
		PRE_OPERATIONAL(test_after_reset_communication_a_collision_is_reported_again),
		PRE_OPERATIONAL(test_the_receive_filter_has_the_identifiers_of_this_node),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
