/* 214Ch: what a locked device refuses (06010002h), what it goes on doing, and how it is opened. */
#include <errno.h>
#include <string.h>

#include "od/little_endian.h"
#include "tests/scenario/world.h"

#define READ_ONLY     0x06010002u
#define LOCAL_CONTROL 0x08000021u
#define DEVICE_STATE  0x08000022u
#define NOT_STORED    0x08000020u
#define KEY	      0x12345678u

static int set_up(void **state)
{
	*state = world_new(sensor_preset("ideal"), 1, "tumble");
	return 0;
}

static uint32_t write_u32(struct world *w, uint16_t index, uint8_t sub, uint32_t value)
{
	uint8_t wire[4];

	put_u32(wire, value);
	return world_sdo_write(w, index, sub, wire, 4);
}

static uint32_t write_key(struct world *w, uint32_t key)
{
	return write_u32(w, 0x214C, 2, key);
}

static uint32_t write_u8(struct world *w, uint16_t index, uint8_t sub, uint8_t value)
{
	return world_sdo_write(w, index, sub, &value, 1);
}

static uint32_t write_heartbeat(struct world *w)
{
	return world_sdo_write(w, 0x1017, 0, "\xD0\x07", 2);
}

static uint8_t lock_state(struct world *w)
{
	world_receive(w, 0x600u + w->node_id, 8, (const uint8_t[8]){0x40, 0x4C, 0x21, 1});
	const struct can_msg *answer = world_last(w, 0x580u + w->node_id);
	assert_int_equal(answer->data[0], 0x4F);
	return answer->data[4];
}

static void test_a_device_is_open_until_somebody_writes_a_key(void **state)
{
	struct world *w = *state;

	assert_int_equal(lock_state(w), 0);
	assert_int_equal(write_heartbeat(w), 0);
	assert_int_equal(write_key(w, 0), 0x06090030); /* no key */
	assert_int_equal(lock_state(w), 0);
	assert_int_equal(write_key(w, KEY), 0);
	assert_int_equal(lock_state(w), 1);
}

static void test_a_locked_device_refuses_whatever_changes_its_configuration(void **state)
{
	struct world *w = *state;
	float r = 0.05f;

	assert_int_equal(write_key(w, KEY), 0);
	assert_int_equal(write_heartbeat(w), READ_ONLY);
	assert_int_equal(world_sdo_write(w, 0x2000, 1, &r, 4), READ_ONLY);
	assert_int_equal(write_u32(w, 0x2004, 1, 50000), READ_ONLY);
	assert_int_equal(write_u32(w, 0x1010, 1, 0x65766173), READ_ONLY);
	assert_int_equal(write_u32(w, 0x1011, 1, 0x64616F6C), READ_ONLY);
	assert_int_equal(write_u8(w, 0x2061, 1, 1), READ_ONLY);
	assert_int_equal(write_u8(w, 0x2060, 1, 1), READ_ONLY);
	assert_int_equal(write_u8(w, 0x2148, 0, 3), READ_ONLY);
	assert_int_equal(od_write(&w->device.od, 0x2130, 0, "\0\0\0\0", 4), OD_READ_ONLY);
	assert_true(w->device.values.lever_arm.l == 0);
}

static void test_a_locked_device_still_takes_commands_and_inputs_of_the_machine(void **state)
{
	struct world *w = *state;

	assert_int_equal(write_key(w, KEY), 0);
	assert_int_equal(write_u8(w, 0x2040, 6, 1), 0); /* reset of the position */
	assert_int_equal(write_u8(w, 0x1003, 0, 0), 0); /* error history */
	world_nmt(w, 1);
	world_seconds(w, 0.1);
	world_receive(w, 0x080, 0, NULL);
	assert_true(world_count(w, 0x180u + w->node_id) > 0);
}

static void test_only_the_same_key_opens_it(void **state)
{
	struct world *w = *state;

	assert_int_equal(write_key(w, KEY), 0);
	assert_int_equal(write_key(w, KEY + 1), LOCAL_CONTROL);
	assert_int_equal(write_heartbeat(w), READ_ONLY);
	w->now_us += 999999;
	assert_int_equal(write_key(w, KEY), DEVICE_STATE); /* keys cannot be tried quickly */
	w->now_us += 1;
	assert_int_equal(write_key(w, KEY), 0);
	assert_int_equal(lock_state(w), 0);
	assert_int_equal(write_heartbeat(w), 0);
}

static void test_the_key_cannot_be_read(void **state)
{
	struct world *w = *state;
	uint8_t wire[4];
	size_t size;

	assert_int_equal(write_key(w, KEY), 0);
	assert_int_equal(od_read(&w->device.od, 0x214C, 2, wire, sizeof(wire), &size), OD_WRITE_ONLY);
	assert_int_equal(w->device.values.write_lock.key, 0);
}

static void test_the_lock_is_stored_at_once_and_nothing_else_with_it(void **state)
{
	struct world *w = *state;

	assert_int_equal(write_heartbeat(w), 0);
	assert_int_equal(write_key(w, KEY), 0);
	world_power_on(w, NULL);
	assert_int_equal(lock_state(w), 1);
	assert_int_equal(write_heartbeat(w), READ_ONLY);
	assert_int_equal(w->device.values.producer_heartbeat_time, 1000); /* 2000 was not stored */
	assert_int_equal(write_key(w, KEY), 0);
	world_power_on(w, NULL);
	assert_int_equal(write_heartbeat(w), 0);
}

static void test_what_was_stored_before_stays(void **state)
{
	struct world *w = *state;

	assert_int_equal(write_heartbeat(w), 0);
	assert_int_equal(write_u32(w, 0x1010, 1, 0x65766173), 0);
	world_power_on(w, NULL);
	assert_int_equal(write_key(w, KEY), 0);
	world_power_on(w, NULL);
	assert_int_equal(w->device.values.producer_heartbeat_time, 2000);
	assert_int_equal(write_key(w, KEY), 0);
	world_power_on(w, NULL);
	assert_int_equal(w->device.values.producer_heartbeat_time, 2000);
	assert_int_equal(write_u32(w, 0x1011, 3, 0x64616F6C), 0); /* of another group */
	world_power_on(w, NULL);
	assert_int_equal(w->device.values.producer_heartbeat_time, 2000);
}

static void test_a_lock_that_cannot_be_stored_is_refused(void **state)
{
	struct world *w = *state;

	w->disk_answer = -EIO;
	assert_int_equal(write_key(w, KEY), NOT_STORED);
	assert_int_equal(lock_state(w), 0);
	assert_int_equal(write_heartbeat(w), 0);
}

/* The storage has room for one image. */
static void test_while_anything_is_stored_nothing_else_is(void **state)
{
	struct world *w = *state;

	w->disk_answer = -EINPROGRESS;
	world_receive(w, 0x600u + w->node_id, 8, (const uint8_t[8]){0x23, 0x10, 0x10, 1, 's', 'a', 'v', 'e'});
	assert_int_equal(write_key(w, KEY), DEVICE_STATE);
	device_saved(&w->device, 0, w->now_us);
	world_receive(w, 0x600u + w->node_id, 8, (const uint8_t[8]){0x23, 0x4C, 0x21, 2, 0x78, 0x56, 0x34, 0x12});
	assert_int_equal(write_u32(w, 0x1010, 1, 0x65766173), DEVICE_STATE);
	assert_int_equal(write_u32(w, 0x1011, 1, 0x64616F6C), DEVICE_STATE);
	assert_int_equal(lock_state(w), 0);
	device_saved(&w->device, 0, w->now_us + 2500000);
	assert_int_equal(lock_state(w), 1);
	assert_non_null(strstr(w->device.log.text, " 2.500000 configuration locked (214Ch)\n"));
}

int main(void)
{
#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, world_tear_down)
	const struct CMUnitTest tests[] = {
		TEST(test_a_device_is_open_until_somebody_writes_a_key),
		TEST(test_a_locked_device_refuses_whatever_changes_its_configuration),
		TEST(test_a_locked_device_still_takes_commands_and_inputs_of_the_machine),
		TEST(test_only_the_same_key_opens_it),
		TEST(test_the_key_cannot_be_read),
		TEST(test_the_lock_is_stored_at_once_and_nothing_else_with_it),
		TEST(test_what_was_stored_before_stays),
		TEST(test_a_lock_that_cannot_be_stored_is_refused),
		TEST(test_while_anything_is_stored_nothing_else_is),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
