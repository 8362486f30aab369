/* 2148h, the mapping of TPDO1 to TPDO4 by one write, and the INTEGER16 twins it maps. */
#include <math.h>
#include <string.h>

#include "tests/scenario/world.h"

static int set_up(void **state)
{
	*state = world_new(sensor_preset("ideal"), 1, "tumble");
	world_seconds(*state, 3);
	world_nmt(*state, 1);
	return 0;
}

static uint32_t choose(struct world *w, uint8_t preset)
{
	return world_sdo_write(w, 0x2148, 0, &preset, 1);
}

/* The PDO of this identifier that answers a SYNC, or NULL. */
static const struct can_msg *pdo_of_sync(struct world *w, uint32_t function)
{
	unsigned before = world_count(w, function + WORLD_NODE_ID);

	world_receive(w, 0x080, 0, NULL);
	return world_count(w, function + WORLD_NODE_ID) > before ? world_last(w, function + WORLD_NODE_ID) : NULL;
}

static int16_t i16(const struct can_msg *msg, size_t n)
{
	return (int16_t)(msg->data[2 * n] | msg->data[2 * n + 1] << 8);
}

static void test_the_default_mapping_is_preset_1(void **state)
{
	struct world *w = *state;

	assert_int_equal(w->device.values.pdo_preset, 1);
	const struct od_values before = w->device.values;
	assert_int_equal(choose(w, 3), 0);
	assert_int_equal(choose(w, 1), 0);
	assert_memory_equal(&w->device.values.tpdo1_mapping, &before.tpdo1_mapping, sizeof(before.tpdo1_mapping));
	assert_memory_equal(&w->device.values.tpdo4_mapping, &before.tpdo4_mapping, sizeof(before.tpdo4_mapping));
	assert_memory_equal(
		&w->device.values.tpdo1_communication, &before.tpdo1_communication, sizeof(before.tpdo1_communication));
}

static void test_preset_2_is_the_inclinometer_of_cia_410(void **state)
{
	struct world *w = *state;

	assert_int_equal(choose(w, 2), 0);
	const struct can_msg *msg = pdo_of_sync(w, 0x180);
	assert_int_equal(msg->len, 4);
	assert_int_equal(i16(msg, 0), w->device.values.slope_long16);
	assert_int_equal(i16(msg, 1), w->device.values.slope_lateral16);
	msg = pdo_of_sync(w, 0x280);
	assert_int_equal(msg->len, 8);
	assert_memory_equal(msg->data, &w->device.values.slope_long32, 4);
	assert_memory_equal(msg->data + 4, &w->device.values.slope_lateral32, 4);
	assert_null(pdo_of_sync(w, 0x380));
	assert_int_equal(pdo_of_sync(w, 0x480)->len, 8);
}

static void test_preset_3_has_the_quaternion_in_one_frame_at_its_step(void **state)
{
	struct world *w = *state;
	const struct od_values *v = &w->device.values;

	assert_int_equal(choose(w, 3), 0);
	for (int i = 0; i < 100; i++) {
		world_sample(w);
		const struct can_msg *msg = pdo_of_sync(w, 0x180);
		assert_int_equal(msg->len, 8);
		const float q[] = {v->quaternion.w, v->quaternion.x, v->quaternion.y, v->quaternion.z};
		for (size_t k = 0; k < 4; k++)
			assert_near(i16(msg, k) * 31e-6, q[k], 15.6e-6);
		msg = pdo_of_sync(w, 0x280);
		assert_near(i16(msg, 0) * 1e-3, v->angular_rate.l, 0.51e-3);
		assert_near(i16(msg, 2) * 1e-3, v->angular_rate.t, 0.51e-3);
		assert_int_equal((uint16_t)i16(msg, 3), v->sample.counter);
	}
}

static void test_preset_4_has_force_rate_and_field(void **state)
{
	struct world *w = *state;
	const struct od_values *v = &w->device.values;

	assert_int_equal(choose(w, 4), 0);
	const struct can_msg *force = pdo_of_sync(w, 0x180), *rate = world_last(w, 0x280 + WORLD_NODE_ID),
			     *field = world_last(w, 0x380 + WORLD_NODE_ID);
	assert_near(i16(force, 0) * 5e-3, v->specific_force.l, 2.6e-3);
	assert_near(i16(force, 2) * 5e-3, v->specific_force.t, 2.6e-3);
	assert_near(i16(rate, 1) * 1e-3, v->angular_rate.s, 0.51e-3);
	assert_near(i16(field, 1) * 0.1, v->magnetic_field.s, 0.051);
}

static void test_a_step_can_be_chosen_and_a_value_beyond_it_sets_the_status_bit(void **state)
{
	struct world *w = *state;
	const uint8_t step[] = {1, 0};

	assert_int_equal(world_sdo_write(w, 0x2110, 6, step, 2), 0); /* 1 mm/s^2: up to 32.767 m/s^2 */
	world_sample(w);
	assert_near(w->device.values.specific_force16.t * 1e-3, w->device.values.specific_force.t, 0.51e-3);
	assert_int_equal(w->device.values.sample.status & STATUS_SATURATED, 0);
	assert_int_equal(world_sdo_write(w, 0x2110, 3, step, 2), 0); /* 1e-6: up to 0.032767 */
	world_sample(w);
	assert_true(w->device.values.quaternion16.w == 32767 || w->device.values.quaternion16.w == -32768);
	assert_true(w->device.values.sample.status & STATUS_SATURATED);
}

static void test_the_object_reads_which_preset_is_mapped(void **state)
{
	struct world *w = *state;
	const uint8_t invalid[] = {WORLD_NODE_ID - 16 + 0x90, 1, 0, 0xC0}, two = 2;

	for (uint8_t preset = 1; preset <= 4; preset++) {
		assert_int_equal(choose(w, preset), 0);
		assert_int_equal(w->device.values.pdo_preset, preset);
	}
	assert_int_equal(world_sdo_write(w, 0x1800, 1, invalid, 4), 0);
	assert_int_equal(w->device.values.pdo_preset, 0);
	assert_int_equal(choose(w, 3), 0);
	assert_int_equal(world_sdo_write(w, 0x1801, 2, &two, 1), 0); /* the transmission type is no part of it */
	assert_int_equal(w->device.values.pdo_preset, 3);
	assert_int_equal(w->device.values.tpdo2_communication.transmission_type, 2);
	world_nmt(w, 0x82);
	assert_int_equal(w->device.values.pdo_preset, 1);
}

/* Each of its 15 entries counts. */
static void test_a_mapping_that_differs_in_one_entry_is_none(void **state)
{
	static const uint8_t ENTRIES[] = {4, 4, 4, 3};
	struct world *w = *state;
	const struct od *od = &w->device.od;

	for (uint16_t pdo = 0; pdo < 4; pdo++)
		for (uint8_t sub = 1; sub <= ENTRIES[pdo]; sub++) {
			uint32_t *entry = od_value(od, 0x1A00 + pdo, sub, 4), before = *entry;

			*entry = 0x210F0210; /* as if it had been mapped so */
			w->device.pdo_preset.mapping.after(&w->device.pdo_preset, NULL);
			assert_int_equal(w->device.values.pdo_preset, 0);
			*entry = before;
			w->device.pdo_preset.mapping.after(&w->device.pdo_preset, NULL);
			assert_int_equal(w->device.values.pdo_preset, 1);
		}
}

static void test_the_beginning_of_a_preset_and_one_that_is_not_valid_are_none(void **state)
{
	struct world *w = *state;
	const uint8_t invalid[] = {0x80 + WORLD_NODE_ID, 1, 0, 0x80}, valid[] = {0x80 + WORLD_NODE_ID, 1, 0, 0};
	const uint8_t none = 0, three = 3, four = 4;

	assert_int_equal(world_sdo_write(w, 0x1800, 1, invalid, 4), 0);
	assert_int_equal(w->device.values.pdo_preset, 0);
	assert_int_equal(world_sdo_write(w, 0x1A00, 0, &none, 1), 0);
	assert_int_equal(world_sdo_write(w, 0x1A00, 0, &three, 1), 0); /* acceleration, without the counter */
	assert_int_equal(world_sdo_write(w, 0x1800, 1, valid, 4), 0);
	assert_int_equal(w->device.values.pdo_preset, 0);
	assert_int_equal(world_sdo_write(w, 0x1800, 1, invalid, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x1A00, 0, &none, 1), 0);
	assert_int_equal(world_sdo_write(w, 0x1A00, 0, &four, 1), 0);
	assert_int_equal(w->device.values.pdo_preset, 0);
	assert_int_equal(world_sdo_write(w, 0x1800, 1, valid, 4), 0);
	assert_int_equal(w->device.values.pdo_preset, 1);
}

static void test_without_any_mapping_there_is_no_preset(void **state)
{
	struct world *w = *state;
	const uint8_t invalid[] = {0, 0, 0, 0x80}, none = 0;

	for (uint16_t pdo = 0; pdo < 4; pdo++) {
		assert_int_equal(world_sdo_write(w, 0x1800 + pdo, 1, invalid, 4), 0);
		assert_int_equal(world_sdo_write(w, 0x1A00 + pdo, 0, &none, 1), 0);
	}
	assert_int_equal(w->device.values.pdo_preset, 0);
}

/* Neither by a preset, nor by one that cannot be mapped. */
static void test_the_fifth_pdo_is_in_no_preset_and_not_changed(void **state)
{
	struct world *w = *state;
	const uint8_t error_register[] = {8, 0, 0x01, 0x10}, valid[] = {0x81, 2, 0, 0}, invalid[] = {0, 0, 0, 0x80};
	const uint8_t one = 1;

	assert_int_equal(world_sdo_write(w, 0x1A04, 1, error_register, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x1A04, 0, &one, 1), 0);
	assert_int_equal(world_sdo_write(w, 0x1804, 1, valid, 4), 0);
	assert_int_equal(w->device.values.pdo_preset, 1);
	assert_int_equal(choose(w, 2), 0);
	assert_int_equal(w->device.values.pdo_preset, 2);
	assert_int_equal(world_sdo_write(w, 0x1803, 1, invalid, 4), 0);
	assert_int_equal(choose(w, 3), 0x06090030);
	assert_int_equal(w->device.values.tpdo5_communication.cob_id, 0x281);
	assert_int_equal(*(uint8_t *)od_value(&w->device.od, 0x1A04, 0, 1), 1);
	assert_memory_equal(od_value(&w->device.od, 0x1A04, 1, 4), error_register, 4);
}

static void test_a_mapping_of_eight_objects_is_kept_when_a_preset_cannot_be_mapped(void **state)
{
	struct world *w = *state;
	const uint8_t invalid[] = {0, 0, 0, 0x80}, valid[] = {0x85, 1, 0, 0}, none = 0, eight = 8;
	const uint8_t error_register[] = {8, 0, 0x01, 0x10};

	assert_int_equal(world_sdo_write(w, 0x1800, 1, invalid, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x1A00, 0, &none, 1), 0);
	for (uint8_t sub = 1; sub <= 8; sub++)
		assert_int_equal(world_sdo_write(w, 0x1A00, sub, error_register, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x1A00, 0, &eight, 1), 0);
	assert_int_equal(world_sdo_write(w, 0x1800, 1, valid, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x1803, 1, invalid, 4), 0);
	const struct od_values before = w->device.values;
	assert_int_equal(choose(w, 4), 0x06090030);
	assert_memory_equal(&w->device.values.tpdo1_mapping, &before.tpdo1_mapping, sizeof(before.tpdo1_mapping));
	assert_int_equal(w->device.values.tpdo1_communication.cob_id, 0x185);
}

static void test_a_preset_is_stored_as_its_mapping(void **state)
{
	struct world *w = *state;

	assert_int_equal(choose(w, 2), 0);
	world_sdo_write(w, 0x1010, 1, "save", 4);
	world_power_on(w, NULL);
	assert_int_equal(w->device.values.pdo_preset, 2);
}

static void test_a_preset_that_cannot_be_mapped_changes_nothing(void **state)
{
	struct world *w = *state;
	const uint8_t none[] = {0, 0, 0, 0x80}; /* not valid, and without a CAN-ID to make it valid with */

	assert_int_equal(choose(w, 3), 0);
	assert_int_equal(world_sdo_write(w, 0x1803, 1, none, 4), 0);
	const struct od_values before = w->device.values;
	assert_int_equal(choose(w, 2), 0x06090030);
	assert_memory_equal(&w->device.values.tpdo1_mapping, &before.tpdo1_mapping, sizeof(before.tpdo1_mapping));
	assert_memory_equal(&w->device.values.tpdo2_mapping, &before.tpdo2_mapping, sizeof(before.tpdo2_mapping));
	assert_memory_equal(&w->device.values.tpdo3_mapping, &before.tpdo3_mapping, sizeof(before.tpdo3_mapping));
	assert_memory_equal(&w->device.values.tpdo4_mapping, &before.tpdo4_mapping, sizeof(before.tpdo4_mapping));
	assert_int_equal(w->device.values.tpdo1_communication.cob_id, before.tpdo1_communication.cob_id);
	assert_int_equal(w->device.values.tpdo4_communication.cob_id, before.tpdo4_communication.cob_id);
	assert_int_equal(w->device.values.pdo_preset, 0);
	assert_int_equal(i16(pdo_of_sync(w, 0x180), 0), w->device.values.quaternion16.w);
	assert_int_equal(pdo_of_sync(w, 0x380)->len, 8);
	assert_null(pdo_of_sync(w, 0x480));
}

static void test_other_numbers_are_refused_and_change_nothing(void **state)
{
	struct world *w = *state;

	assert_int_equal(choose(w, 0), 0x06090030);
	assert_int_equal(choose(w, 5), 0x06090031);
	assert_int_equal(w->device.values.pdo_preset, 1);
	assert_int_equal(pdo_of_sync(w, 0x180)->len, 8);
}

/* ---- the low-pass of the angles ---------------------------------------------------------------------------------- */

static void test_the_cut_off_of_2012h_filters_angles_and_slopes_and_nothing_else(void **state)
{
	struct world *w = *state, *plain = world_new(sensor_preset("ideal"), 1, "tumble");
	const float cutoff = 0.5F;

	world_seconds(plain, 3);
	assert_int_equal(world_sdo_write(w, 0x2012, 1, &cutoff, 4), 0);
	const double gain = 1 - exp(-2 * M_PI * 0.5 * 0.01);
	double filtered = (double)w->device.values.angles_deg.roll, largest = 0;
	for (int i = 0; i < 300; i++) {
		world_sample(w);
		world_sample(plain);
		const double raw = (double)plain->device.values.angles_deg.roll;
		filtered = remainder(filtered + gain * remainder(raw - filtered, 360), 360);
		assert_near(w->device.values.angles_deg.roll, filtered, 1e-3);
		assert_near(w->device.values.angles.roll * 0.01, filtered, 0.0051 + 1e-3);
		assert_near(w->device.values.slope_lateral32 * 0.01, filtered, 0.0051 + 1e-3);
		assert_float_equal(w->device.values.quaternion.w, plain->device.values.quaternion.w, 0);
		largest = fmax(largest, fabs(remainder(raw - filtered, 360)));
	}
	assert_true(largest > 5); /* the signal moves, and the filter delays */
	world_nmt(w, 0x81);
	world_nmt(plain, 0x81);
	assert_int_equal(world_sdo_write(w, 0x2012, 1, &cutoff, 4), 0);
	world_sample(w);
	world_sample(plain);
	assert_near(w->device.values.angles_deg.roll, plain->device.values.angles_deg.roll, 1e-6); /* it starts anew */
	void *other = plain;
	world_tear_down(&other);
}

#define PRESET_TEST(test) cmocka_unit_test_setup_teardown(test, set_up, world_tear_down)

int main(void)
{
	const struct CMUnitTest tests[] = {
		PRESET_TEST(test_the_default_mapping_is_preset_1),
		PRESET_TEST(test_preset_2_is_the_inclinometer_of_cia_410),
		PRESET_TEST(test_preset_3_has_the_quaternion_in_one_frame_at_its_step),
		PRESET_TEST(test_preset_4_has_force_rate_and_field),
		PRESET_TEST(test_a_step_can_be_chosen_and_a_value_beyond_it_sets_the_status_bit),
		PRESET_TEST(test_the_object_reads_which_preset_is_mapped),
		PRESET_TEST(test_a_mapping_that_differs_in_one_entry_is_none),
		PRESET_TEST(test_the_beginning_of_a_preset_and_one_that_is_not_valid_are_none),
		PRESET_TEST(test_without_any_mapping_there_is_no_preset),
		PRESET_TEST(test_the_fifth_pdo_is_in_no_preset_and_not_changed),
		PRESET_TEST(test_a_mapping_of_eight_objects_is_kept_when_a_preset_cannot_be_mapped),
		PRESET_TEST(test_a_preset_is_stored_as_its_mapping),
		PRESET_TEST(test_a_preset_that_cannot_be_mapped_changes_nothing),
		PRESET_TEST(test_other_numbers_are_refused_and_change_nothing),
		PRESET_TEST(test_the_cut_off_of_2012h_filters_angles_and_slopes_and_nothing_else),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
