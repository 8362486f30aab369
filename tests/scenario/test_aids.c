/* External aids and commands (2070h to 2073h) and TPDOs triggered by a change (2118h), through the whole device in
 * simulated time; at the end with recorded trials and their optical reference. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "gateway/status.h"
#include "gateway/threshold.h"
#include "model/math/rotation.h"
#include "tests/scenario/world.h"
#include "model/math/units.h"

static struct world *new_world(const char *signal)
{
	struct world *w = world_new(sensor_preset("ideal"), 1, signal);

	world_nmt(w, 1);
	return w;
}

static int set_up(void **state)
{
	*state = new_world("tumble");
	world_samples(*state, 100);
	return 0;
}

static int set_up_at_rest(void **state)
{
	*state = new_world("rest");
	world_samples(*state, 100);
	return 0;
}

static uint32_t write_real(struct world *w, uint16_t index, uint8_t sub, float value)
{
	return world_sdo_write(w, index, sub, &value, 4);
}

static uint32_t write_u8(struct world *w, uint16_t index, uint8_t sub, uint8_t value)
{
	return world_sdo_write(w, index, sub, &value, 1);
}

static void put_16(uint8_t *wire, double value, double lsb)
{
	int n = (int)lround(value / lsb);

	wire[0] = (uint8_t)n;
	wire[1] = (uint8_t)(n >> 8);
}

/* RPDO1 */
static void send_velocity(struct world *w, double x, double y, double z, double sigma)
{
	uint8_t data[8];

	put_16(data, x, 0.001);
	put_16(data + 2, y, 0.001);
	put_16(data + 4, z, 0.001);
	put_16(data + 6, sigma, 0.001);
	world_receive(w, 0x200 + WORLD_NODE_ID, 8, data);
}

/* RPDO2 */
static void send_yaw(struct world *w, double yaw_deg, double sigma_deg)
{
	float values[2] = {(float)yaw_deg, (float)sigma_deg};

	world_receive(w, 0x300 + WORLD_NODE_ID, 8, values);
}

/* RPDO3 */
static void send_attitude(struct world *w, double roll, double pitch, double yaw, uint8_t command)
{
	uint8_t data[7];

	put_16(data, roll, 0.01);
	put_16(data + 2, pitch, 0.01);
	put_16(data + 4, yaw, 0.01);
	data[6] = command;
	world_receive(w, 0x400 + WORLD_NODE_ID, 7, data);
}

/* RPDO4 */
static void send_commands(struct world *w, uint8_t commands)
{
	world_receive(w, 0x500 + WORLD_NODE_ID, 2, (const uint8_t[]){commands, 0});
}

static bool in_use(const struct world *w)
{
	return w->device.values.sample.status & STATUS_EXTERNAL_AID;
}

static struct vec3 velocity(const struct world *w)
{
	const struct od_values *v = &w->device.values;

	return (struct vec3){(double)v->velocity.x, (double)v->velocity.y, (double)v->velocity.z};
}

static void assert_velocity(const struct world *w, double x, double y, double z)
{
	assert_true(vec3_norm(vec3_sub(velocity(w), (struct vec3){x, y, z})) < 0.2);
}

static double turn_deg(double to, double from)
{
	return remainder(to - from, 360);
}

/* ---- velocity ---------------------------------------------------------------------------------------------------- */

static void test_a_velocity_by_rpdo_is_the_velocity_of_the_next_sample(void **state)
{
	struct world *w = *state;

	send_velocity(w, 3, -2, 1, 0.001);
	world_sample(w);
	assert_velocity(w, 3, -2, 1);
}

static void test_a_velocity_by_sdo_is_used_when_its_sigma_is_written(void **state)
{
	struct world *w = *state;

	assert_int_equal(write_real(w, 0x2070, 1, 3), 0);
	assert_int_equal(write_real(w, 0x2070, 2, -2), 0);
	assert_int_equal(write_real(w, 0x2070, 3, 1), 0);
	world_sample(w);
	assert_true(vec3_norm(velocity(w)) < 2);
	assert_false(in_use(w));
	assert_int_equal(write_real(w, 0x2070, 4, 0.001f), 0);
	world_sample(w);
	assert_velocity(w, 3, -2, 1);
	assert_true(in_use(w));
}

static void test_a_single_component_is_not_used(void **state)
{
	struct world *w = *state;

	assert_int_equal(write_real(w, 0x2070, 4, 0.1f), 0);
	world_samples(w, 101);
	assert_false(in_use(w));
	for (uint8_t sub = 5; sub <= 7; sub++)
		assert_int_equal(world_sdo_write(w, 0x2070, sub, &(int16_t){1}, 2), 0);
	assert_int_equal(write_u8(w, 0x2070, 9, 0), 0);
	assert_int_equal(write_real(w, 0x2071, 1, 1), 0);
	world_sample(w);
	assert_false(in_use(w));
}

static void test_a_velocity_with_a_sigma_of_zero_is_not_used(void **state)
{
	struct world *w = *state, *twin = new_world("tumble");

	world_samples(twin, 100);
	send_velocity(w, 3, -2, 1, 0);
	world_sample(w);
	world_sample(twin);
	assert_memory_equal(
		&w->device.values.velocity, &twin->device.values.velocity, sizeof(w->device.values.velocity));
	assert_false(in_use(w));
	free(twin);
}

static void test_a_velocity_in_the_object_frame_is_rotated_into_the_global_frame(void **state)
{
	struct world *w = *state;
	const struct od_values *v = &w->device.values;
	struct quat q = {
		(double)v->quaternion.w, (double)v->quaternion.x, (double)v->quaternion.y, (double)v->quaternion.z};
	struct vec3 global = quat_rotate(q, (struct vec3){3, 0, 0});

	assert_int_equal(write_u8(w, 0x2070, 9, 1), 0);
	send_velocity(w, 3, 0, 0, 0.001);
	world_sample(w);
	assert_true(fabs(global.x - 3) > 0.1); /* the frames differ here */
	assert_velocity(w, global.x, global.y, global.z);
}

static void test_an_aid_is_not_used_before_the_attitude_is_valid(void **state)
{
	struct world *w = new_world("tumble");

	send_velocity(w, 3, -2, 1, 0.001);
	world_sample(w);
	assert_false(in_use(w));
	assert_true(vec3_norm(velocity(w)) < 1);
	free(w);
	(void)state;
}

static void test_the_real_values_and_the_integers_are_two_views_of_one_value(void **state)
{
	struct world *w = *state;
	const struct od_values *v = &w->device.values;

	send_velocity(w, 1.5, -0.25, 32.767, 0.04);
	assert_near(v->velocity_aid.x, 1.5, 1e-6);
	assert_near(v->velocity_aid.y, -0.25, 1e-6);
	assert_near(v->velocity_aid.z, 32.767, 1e-5);
	assert_near(v->velocity_aid.sigma, 0.04, 1e-6);
	assert_int_equal(write_real(w, 0x2070, 1, -0.0016f), 0);
	assert_int_equal(v->velocity_aid.x16, -2);
	assert_int_equal(write_real(w, 0x2070, 2, -500), 0);
	assert_int_equal(v->velocity_aid.y16, -32768); /* saturated */
	assert_int_equal(write_real(w, 0x2070, 4, 500), 0);
	assert_int_equal(v->velocity_aid.sigma16, 65535);
	send_attitude(w, 1.25, -2.5, 180, 0);
	assert_near(v->attitude_reset.roll, 1.25, 1e-6);
	assert_near(v->attitude_reset.pitch, -2.5, 1e-6);
	assert_near(v->attitude_reset.yaw, 180, 1e-5);
	assert_int_equal(write_real(w, 0x2072, 2, 45), 0);
	assert_int_equal(v->attitude_reset.pitch16, 4500);
}

/* ---- yaw --------------------------------------------------------------------------------------------------------- */

static void test_a_yaw_by_rpdo_corrects_the_heading(void **state)
{
	struct world *w = *state, *free_run = new_world("tumble");
	const float *yaw = &w->device.values.angles_deg.yaw;
	double goal;

	world_samples(free_run, 100);
	for (int i = 0; i < 200; i++) {
		world_sample(free_run);
		goal = (double)free_run->device.values.angles_deg.yaw + 40;
		send_yaw(w, turn_deg(goal, 0), 0.01);
		world_sample(w);
	}
	assert_near(turn_deg((double)*yaw, goal), 0, 2);
	assert_true(in_use(w));
	free(free_run);
}

static void test_a_yaw_with_a_sigma_of_zero_changes_nothing(void **state)
{
	struct world *w = *state, *twin = new_world("tumble");

	world_samples(twin, 100);
	send_yaw(w, 90, 0);
	world_sample(w);
	world_sample(twin);
	assert_memory_equal(
		&w->device.values.quaternion, &twin->device.values.quaternion, sizeof(w->device.values.quaternion));
	assert_false(in_use(w));
	free(twin);
}

/* ---- refused ----------------------------------------------------------------------------------------------------- */

static void test_nan_or_a_value_out_of_range_is_refused_by_sdo_and_the_old_value_stays(void **state)
{
	struct world *w = *state;

	assert_int_equal(write_real(w, 0x2070, 1, NAN), 0x06090030);
	assert_int_equal(write_real(w, 0x2070, 4, INFINITY), 0x06090030);
	assert_int_equal(write_real(w, 0x2070, 4, -0.1f), 0x06090032);
	assert_int_equal(write_real(w, 0x2070, 1, 1001), 0x06090031);
	assert_int_equal(write_real(w, 0x2071, 2, -1), 0x06090032);
	assert_int_equal(write_real(w, 0x2071, 1, 361), 0x06090031);
	assert_int_equal(write_u8(w, 0x2072, 7, 2), 0x06090031);
	assert_int_equal(world_sdo_write(w, 0x2073, 0, &(uint16_t){8}, 2), 0x06090031);
	assert_true(w->device.values.velocity_aid.x == 0);
	assert_true(w->device.values.velocity_aid.sigma == 0);
}

static void test_nan_in_an_rpdo_raises_8200h_and_the_next_valid_rpdo_clears_it(void **state)
{
	struct world *w = *state;

	send_yaw(w, NAN, 1);
	assert_memory_equal(world_last(w, 0x080 + WORLD_NODE_ID)->data,
		((const uint8_t[]){0x00, 0x82, 0x11, 0x01, 0x14, 0x71, 0x20, 0x01}), 8);
	world_sample(w);
	assert_false(in_use(w));
	send_yaw(w, 0, 0);
	world_seconds(w, 1);
	assert_memory_equal(world_last(w, 0x080 + WORLD_NODE_ID)->data, ((const uint8_t[8]){0}), 8);
}

static void test_the_smallest_sigma_is_1_mm_s_and_a_hundredth_of_a_degree(void **state)
{
	struct world *w = *state;

	assert_int_equal(write_real(w, 0x2070, 4, 1e-30f), 0);
	world_sample(w);
	assert_true(in_use(w));
	world_samples(w, 101);
	assert_false(in_use(w));
	assert_int_equal(write_real(w, 0x2071, 2, 1e-30f), 0);
	world_sample(w);
	assert_true(in_use(w));
}

/* ---- attitude and commands --------------------------------------------------------------------------------------- */

static void assert_attitude(const struct world *w, double roll, double pitch, double yaw, double tolerance_deg)
{
	assert_near(turn_deg((double)w->device.values.angles_deg.roll, roll), 0, tolerance_deg);
	assert_near(w->device.values.angles_deg.pitch, pitch, tolerance_deg);
	assert_near(turn_deg((double)w->device.values.angles_deg.yaw, yaw), 0, tolerance_deg);
}

static void test_the_attitude_is_reset_at_the_rising_edge_of_the_command_only(void **state)
{
	struct world *w = *state;

	send_attitude(w, 20, -30, 135, 0);
	world_sample(w);
	assert_true(fabs(turn_deg((double)w->device.values.angles_deg.yaw, 135)) > 10);
	send_attitude(w, 20, -30, 135, 1);
	world_sample(w);
	assert_attitude(w, 20, -30, 135, 6); /* the tumble turns by up to 6 degrees within one sample */
	send_attitude(w, -20, 30, -45, 1);
	world_sample(w);
	assert_true(fabs(turn_deg((double)w->device.values.angles_deg.yaw, -45)) > 90);
	send_attitude(w, -20, 30, -45, 0);
	send_attitude(w, -20, 30, -45, 1);
	world_sample(w);
	assert_attitude(w, -20, 30, -45, 6);
}

static void test_the_rising_edge_of_commands_bit_0_resets_velocity_and_position(void **state)
{
	struct world *w = *state;
	const struct od_values *v = &w->device.values;

	send_velocity(w, 10, 0, 0, 0.001);
	world_samples(w, 100);
	assert_true(fabs((double)v->position_m.x) > 1);
	send_commands(w, 1);
	world_sample(w);
	assert_near(v->position_m.x, 0, 0.1);
	send_velocity(w, 10, 0, 0, 0.001);
	world_samples(w, 100);
	send_commands(w, 1);
	world_sample(w);
	assert_true(fabs((double)v->position_m.x) > 1);
	send_commands(w, 0);
	send_commands(w, 1);
	world_sample(w);
	assert_near(v->position_m.x, 0, 0.1);
}

static void test_commands_bit_1_holds_the_velocity_at_zero_for_half_a_second_from_each_write(void **state)
{
	struct world *w = *state;

	send_velocity(w, 10, 0, 0, 0.001);
	world_sample(w);
	send_commands(w, 2);
	world_samples(w, 50);
	assert_true(vec3_norm(velocity(w)) < 0.2);
	assert_true(w->device.aids.standstill_until_us <= w->now_us + w->interval_us);
	world_samples(w, 101);
	assert_false(in_use(w)); /* the master has stopped sending */
	send_commands(w, 2);
	world_sample(w);
	assert_true(in_use(w));
	send_commands(w, 0);
	world_sample(w);
	world_samples(w, 100);
	assert_false(in_use(w));
}

static void test_commands_bit_2_presets_both_slopes_to_zero(void **state)
{
	struct world *w = *state;
	struct od_values *v = &w->device.values;

	assert_int_equal(write_u8(w, 0x6011, 0, 2), 0); /* scaling: offsets are added */
	assert_int_equal(write_u8(w, 0x6121, 0, 2), 0);
	send_attitude(w, 20, -30, 0, 1);
	world_sample(w);
	assert_true(abs(v->slope_long16) > 1000);
	int long_before = v->slope_long16, lateral_before = v->slope_lateral32;
	send_commands(w, 4);
	assert_int_equal(v->slope_long16_offset, -long_before);
	assert_int_equal(v->slope_lateral32_offset, -lateral_before);
}

static void test_the_status_shows_an_aid_for_one_second(void **state)
{
	struct world *w = *state;

	send_velocity(w, 0, 0, 0, 0.1);
	world_samples(w, 100);
	assert_true(in_use(w));
	world_sample(w);
	assert_false(in_use(w));
}

static void test_reset_node_clears_the_aids(void **state)
{
	struct world *w = *state;
	const struct od_values *v = &w->device.values;

	assert_int_equal(write_u8(w, 0x2070, 9, 1), 0);
	send_velocity(w, 1, 2, 3, 0.1);
	send_commands(w, 3);
	world_sample(w);
	world_nmt(w, 129);
	assert_true(v->velocity_aid.x == 0 && v->velocity_aid.x16 == 0 && v->velocity_aid.sigma16 == 0);
	assert_int_equal(v->commands, 0);
	assert_int_equal(v->velocity_aid.highest_sub_index_supported, 9);
	assert_int_equal(v->velocity_aid.frame, 0);
	world_samples(w, 10);
	assert_false(in_use(w));
}

static void test_aids_are_not_stored(void **state)
{
	struct world *w = *state;
	static const uint16_t aids[] = {0x2070, 0x2071, 0x2072, 0x2073};

	assert_int_equal(world_sdo_write(w, 0x1020, 1, &(uint32_t){7}, 4), 0);
	send_velocity(w, 1, 2, 3, 0.1);
	send_yaw(w, 1, 1);
	send_attitude(w, 1, 1, 1, 1);
	send_commands(w, 7);
	assert_false(w->device.configuration_changed);
	assert_int_equal(w->device.values.verify_configuration.configuration_date, 7);
	for (size_t i = 0; i < sizeof(aids) / sizeof(aids[0]); i++)
		for (uint8_t sub = 0; sub < 9; sub++) {
			const struct od_entry *entry = od_find(&imu9_od_table, aids[i], sub, NULL);

			assert_false(entry && entry->access & OD_STORED);
		}
}

/* ---- TPDOs on change --------------------------------------------------------------------------------------------- */

/* TPDO1 is event-driven and carries the yaw (two bytes, 0.01 deg) and two more values. Without magnetometer the heading
 * stays as it was reset. */
static void yaw_by_event(struct world *w, uint32_t second, uint32_t third)
{
	const uint32_t mapping[] = {0x21010310, second, third};

	assert_int_equal(write_u8(w, 0x2030, 2, 0), 0); /* no magnetometer */
	assert_int_equal(world_sdo_write(w, 0x1800, 1, &(uint32_t){0x80000190}, 4), 0);
	assert_int_equal(write_u8(w, 0x1800, 2, 254), 0);
	assert_int_equal(write_u8(w, 0x1A00, 0, 0), 0);
	for (uint8_t i = 0; i < 3; i++)
		assert_int_equal(world_sdo_write(w, 0x1A00, (uint8_t)(i + 1), &mapping[i], 4), 0);
	assert_int_equal(write_u8(w, 0x1A00, 0, 3), 0);
	assert_int_equal(world_sdo_write(w, 0x1800, 1, &(uint32_t){0x40000190}, 4), 0);
}

enum { COUNTER = 0x210F0110, STATUS = 0x210F0310, TIME = 0x210F0220 };

/* Number of TPDOs sent since the last call. */
static unsigned sent(struct world *w)
{
	unsigned count = world_count(w, 0x180 + WORLD_NODE_ID);

	w->frame_count = 0;
	return count;
}

/* Turns about z by `deg`; at rest otherwise. */
static void turn(struct world *w, double deg)
{
	double yaw = turn_deg((double)w->device.values.angles_deg.yaw + deg, 0);

	send_attitude(w, (double)w->device.values.angles_deg.roll, (double)w->device.values.angles_deg.pitch, yaw, 0);
	send_attitude(w, (double)w->device.values.angles_deg.roll, (double)w->device.values.angles_deg.pitch, yaw, 1);
	world_sample(w);
}

static void test_without_thresholds_an_event_driven_pdo_is_sent_with_each_sample(void **state)
{
	struct world *w = *state;

	yaw_by_event(w, COUNTER, TIME);
	sent(w);
	world_samples(w, 100);
	assert_int_equal(sent(w), 100);
}

/* A threshold of one degree. */
static void one_degree(struct world *w)
{
	world_samples(w, 300);
	assert_int_equal(write_real(w, 0x2118, 2, 1), 0);
	world_samples(w, 20);
	sent(w);
	world_samples(w, 300);
	assert_int_equal(sent(w), 0);
}

static void test_with_a_threshold_a_pdo_is_sent_when_a_value_has_changed_by_more_and_only_then(void **state)
{
	struct world *w = *state;

	yaw_by_event(w, COUNTER, TIME);
	one_degree(w);
	turn(w, 0.6);
	assert_int_equal(sent(w), 0);
	turn(w, 0.6); /* 1.2 deg since the last TPDO */
	assert_int_equal(sent(w), 1);
	turn(w, -0.6);
	assert_int_equal(sent(w), 0);
	turn(w, -0.6);
	assert_int_equal(sent(w), 1);
}

static void test_a_change_of_the_status_is_sent_whatever_the_threshold(void **state)
{
	struct world *w = *state;

	yaw_by_event(w, COUNTER, STATUS);
	one_degree(w);
	send_velocity(w, 0, 0, 0, 0.1);
	world_sample(w);
	assert_int_equal(sent(w), 1); /* STATUS_EXTERNAL_AID is set */
	world_samples(w, 90);
	assert_int_equal(sent(w), 0);
	world_samples(w, 20);
	assert_int_equal(sent(w), 1); /* and cleared */
}

static void test_a_change_delayed_by_the_inhibit_time_is_sent_even_if_the_value_has_returned(void **state)
{
	struct world *w = *state;

	yaw_by_event(w, COUNTER, TIME);
	assert_int_equal(world_sdo_write(w, 0x1800, 1, &(uint32_t){0x80000190}, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x1800, 3, &(uint16_t){1000}, 2), 0); /* 100 ms */
	assert_int_equal(world_sdo_write(w, 0x1800, 1, &(uint32_t){0x40000190}, 4), 0);
	one_degree(w);
	turn(w, 2);
	assert_int_equal(sent(w), 1);
	turn(w, 2);
	turn(w, -2);
	assert_int_equal(sent(w), 0);
	world_samples(w, 20);
	assert_int_equal(sent(w), 1);
}

static void test_with_a_threshold_the_first_sample_in_operational_is_sent_and_the_event_timer_runs(void **state)
{
	struct world *w = *state;

	yaw_by_event(w, COUNTER, TIME);
	assert_int_equal(write_real(w, 0x2118, 2, 1000), 0);
	world_nmt(w, 128);
	world_nmt(w, 1);
	sent(w);
	world_samples(w, 10);
	assert_int_equal(sent(w), 1);
	assert_int_equal(world_sdo_write(w, 0x1800, 5, &(uint16_t){100}, 2), 0);
	world_samples(w, 100);
	assert_in_range(sent(w), 9, 11);
}

static void test_with_a_threshold_type_0_is_sent_with_the_sync_after_a_change(void **state)
{
	struct world *w = *state;

	yaw_by_event(w, COUNTER, TIME);
	assert_int_equal(write_u8(w, 0x1800, 2, 0), 0);
	world_sample(w);
	world_receive(w, 0x080, 0, "");
	one_degree(w);
	world_receive(w, 0x080, 0, ""); /* the changes before there was a threshold */
	sent(w);
	world_sample(w);
	world_receive(w, 0x080, 0, "");
	assert_int_equal(sent(w), 0);
	turn(w, 2);
	assert_int_equal(sent(w), 0);
	world_receive(w, 0x080, 0, "");
	assert_int_equal(sent(w), 1);
}

static double threshold(const struct world *w, uint16_t index, uint8_t sub)
{
	return threshold_of(&w->device.od, od_find(&imu9_od_table, index, sub, NULL));
}

static void test_the_unit_of_an_object_selects_its_threshold_which_is_in_steps_of_the_object(void **state)
{
	struct world *w = *state;
	const float thresholds[] = {0.5f, 2, 0.25f, 0.125f, 4};

	for (uint8_t i = 0; i < 5; i++)
		assert_int_equal(write_real(w, 0x2118, (uint8_t)(i + 1), thresholds[i]), 0);
	assert_near(threshold(w, 0x2100, 1), 100, 1e-9); /* m/s^2, 0.005 each */
	assert_near(threshold(w, 0x2107, 1), 0.5, 1e-9);
	assert_near(threshold(w, 0x2101, 1), 200, 1e-9); /* deg, 0.01 each */
	assert_near(threshold(w, 0x6110, 0), 200, 1e-9);
	assert_near(threshold(w, 0x2105, 1), 0.25, 1e-9);  /* rad/s */
	assert_near(threshold(w, 0x2104, 1), 0.125, 1e-9); /* m/s */
	assert_near(threshold(w, 0x2102, 1), 4000, 1e-9);  /* m, 0.001 each */
	assert_true(threshold(w, 0x210F, 1) == INFINITY);
	assert_true(threshold(w, 0x210F, 2) == INFINITY);
	assert_true(threshold(w, 0x210F, 3) == 0);
	assert_int_equal(world_sdo_write(w, 0x6000, 0, &(uint16_t){1000}, 2), 0);
	assert_near(threshold(w, 0x2101, 1), 2, 1e-9);
}

/* ---- recorded trials --------------------------------------------------------------------------------------------- */

enum { TRIAL_HZ = 286, AID_EVERY = 28 }; /* ten aids a second */

struct reference { /* the optical reference at the time of a sample */
	bool seen, moving;
	struct quat q_nb;
	struct vec3 position_m;
};

static FILE *open_trial(const char *name, const char *kind)
{
	const char *folder = getenv("IMU9_BROAD");
	char path[512];

	snprintf(path, sizeof(path), "%s/%s.%s.csv", folder ? folder : "../shared/data/broad", name, kind);
	return fopen(path, "r");
}

/* The next sample and its reference; false at the end of the recording. */
static bool next_row(FILE *imu, FILE *ref, struct imu_sample *s, struct reference *r)
{
	char a[512], b[512];
	double t;
	int moving;

	do {
		if (!fgets(a, sizeof(a), imu) || !fgets(b, sizeof(b), ref))
			return false;
		*s = (struct imu_sample){.flags = SAMPLE_MAG};
	} while (sscanf(a, "%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf", &t, &s->gyro_rad_s.x, &s->gyro_rad_s.y,
			 &s->gyro_rad_s.z, &s->accel_m_s2.x, &s->accel_m_s2.y, &s->accel_m_s2.z, &s->mag_uT.x,
			 &s->mag_uT.y, &s->mag_uT.z) != 10);
	s->t_us = (uint64_t)llround(t * 1e6);
	r->seen = sscanf(b, "%*f,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%d", &r->q_nb.w, &r->q_nb.x, &r->q_nb.y, &r->q_nb.z,
			  &r->position_m.x, &r->position_m.y, &r->position_m.z, &moving) == 8;
	r->moving = r->seen && moving;
	return true;
}

struct trial {
	FILE *imu, *ref;
	struct world *w;
};

static struct trial open_both(const char *name)
{
	struct trial trial = {open_trial(name, "imu"), open_trial(name, "ref"), NULL};
	const uint8_t hand_held = 1;

	if (!trial.imu || !trial.ref) {
		print_message("no recorded trials here (IMU9_BROAD)\n");
		skip();
	}
	trial.w = new_world("rest");
	trial.w->imu.rate_hz = TRIAL_HZ;
	world_nmt(trial.w, 129);
	world_nmt(trial.w, 1);
	assert_int_equal(world_sdo_write(trial.w, 0x2040, 10, &hand_held, 1), 0);
	return trial;
}

static void close_both(struct trial *trial)
{
	fclose(trial->imu);
	fclose(trial->ref);
	free(trial->w);
}

static void step(struct world *w, const struct imu_sample *s)
{
	w->now_us = s->t_us + 1000000;
	device_sample(&w->device, 1, s, w->now_us);
	device_tick(&w->device, w->now_us);
}

/* RMS error of the position relative to the first reference [m]. `aided`: the master sends the velocity of the
 * reference, averaged over the last tenth of a second. */
static double position_error_m(const char *name, bool aided)
{
	struct trial trial = open_both(name);
	const struct od_values *v = &trial.w->device.values;
	struct reference r, sent_last = {0}, first = {0};
	struct vec3 origin_m = {0};
	uint64_t told_us = 0;
	struct imu_sample s;
	double sum = 0;
	int n = 0;

	for (int row = 0; next_row(trial.imu, trial.ref, &s, &r); row++) {
		step(trial.w, &s);
		if (!r.seen || row < 5 * TRIAL_HZ)
			continue;
		struct vec3 here_m = {(double)v->position_m.x, (double)v->position_m.y, (double)v->position_m.z};
		if (!first.seen) {
			first = r;
			origin_m = here_m;
		}
		struct vec3 error_m = vec3_sub(vec3_sub(here_m, origin_m), vec3_sub(r.position_m, first.position_m));
		sum += vec3_dot(error_m, error_m);
		n++;
		if (row % AID_EVERY)
			continue;
		double dt_s = (double)(s.t_us - told_us) * 1e-6;
		if (aided && sent_last.seen && dt_s < 0.2) {
			struct vec3 velocity_m_s = vec3_scale(1 / dt_s, vec3_sub(r.position_m, sent_last.position_m));
			send_velocity(trial.w, velocity_m_s.x, velocity_m_s.y, velocity_m_s.z, 0.1);
		}
		sent_last = r;
		told_us = s.t_us;
	}
	close_both(&trial);
	assert_true(n > 10000);
	return sqrt(sum / n);
}

static double yaw_deg(struct quat q)
{
	return aerospace_from_quat(q).z / RAD_PER_DEG;
}

/* RMS error of the heading during motion [deg]: rotation about the vertical between the attitude and that of the
 * reference. `aided`: the master sends the yaw of the reference. */
static double heading_error_deg(const char *name, bool aided)
{
	struct trial trial = open_both(name);
	const struct od_values *v = &trial.w->device.values;
	struct reference r;
	struct imu_sample s;
	double sum = 0;
	int n = 0;

	for (int row = 0; next_row(trial.imu, trial.ref, &s, &r); row++) {
		step(trial.w, &s);
		if (!r.seen)
			continue;
		if (r.moving) {
			struct quat q = {(double)v->quaternion.w, (double)v->quaternion.x, (double)v->quaternion.y,
				(double)v->quaternion.z};
			struct quat left = quat_multiply(q, quat_conjugate(r.q_nb));
			double heading = 2 * atan2(left.z, left.w) / RAD_PER_DEG;
			sum += pow(turn_deg(heading, 0), 2);
			n++;
		}
		if (aided && row % AID_EVERY == 0)
			send_yaw(trial.w, yaw_deg(r.q_nb), 0.5);
	}
	close_both(&trial);
	assert_true(n > 10000);
	return sqrt(sum / n);
}

static void test_with_ten_velocities_a_second_by_rpdo_the_position_of_a_recorded_trial_does_not_drift(void **state)
{
	double alone_m = position_error_m("09_undisturbed_fast_rotation_with_breaks_B", false);
	double aided_m = position_error_m("09_undisturbed_fast_rotation_with_breaks_B", true);

	print_message("position RMS: %.3f m alone, %.3f m with the velocity\n", alone_m, aided_m);
	assert_true(aided_m < alone_m / 3 && aided_m < 0.15);
	(void)state;
}

static void test_with_the_yaw_by_rpdo_an_attached_magnet_does_not_disturb_the_heading(void **state)
{
	double alone_deg = heading_error_deg("34_disturbed_attached_magnet_3cm", false);
	double aided_deg = heading_error_deg("34_disturbed_attached_magnet_3cm", true);

	print_message("heading RMS: %.2f degrees alone, %.2f with the yaw\n", alone_deg, aided_deg);
	assert_true(aided_deg < 0.5 && aided_deg < alone_deg / 2);
	(void)state;
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test_setup_teardown(
			test_a_velocity_by_rpdo_is_the_velocity_of_the_next_sample, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_a_velocity_by_sdo_is_used_when_its_sigma_is_written, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(test_a_single_component_is_not_used, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_a_velocity_with_a_sigma_of_zero_is_not_used, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_a_velocity_in_the_object_frame_is_rotated_into_the_global_frame, set_up, world_tear_down),
		cmocka_unit_test(test_an_aid_is_not_used_before_the_attitude_is_valid),
		cmocka_unit_test_setup_teardown(
			test_the_real_values_and_the_integers_are_two_views_of_one_value, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(test_a_yaw_by_rpdo_corrects_the_heading, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_a_yaw_with_a_sigma_of_zero_changes_nothing, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_nan_or_a_value_out_of_range_is_refused_by_sdo_and_the_old_value_stays, set_up,
			world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_nan_in_an_rpdo_raises_8200h_and_the_next_valid_rpdo_clears_it, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_the_smallest_sigma_is_1_mm_s_and_a_hundredth_of_a_degree, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_the_attitude_is_reset_at_the_rising_edge_of_the_command_only, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_the_rising_edge_of_commands_bit_0_resets_velocity_and_position, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_commands_bit_1_holds_the_velocity_at_zero_for_half_a_second_from_each_write, set_up,
			world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_commands_bit_2_presets_both_slopes_to_zero, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(test_the_status_shows_an_aid_for_one_second, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(test_reset_node_clears_the_aids, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(test_aids_are_not_stored, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(test_without_thresholds_an_event_driven_pdo_is_sent_with_each_sample,
			set_up_at_rest, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_with_a_threshold_a_pdo_is_sent_when_a_value_has_changed_by_more_and_only_then,
			set_up_at_rest, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_a_change_of_the_status_is_sent_whatever_the_threshold, set_up_at_rest, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_a_change_delayed_by_the_inhibit_time_is_sent_even_if_the_value_has_returned,
			set_up_at_rest, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_with_a_threshold_the_first_sample_in_operational_is_sent_and_the_event_timer_runs,
			set_up_at_rest, world_tear_down),
		cmocka_unit_test_setup_teardown(test_with_a_threshold_type_0_is_sent_with_the_sync_after_a_change,
			set_up_at_rest, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_the_unit_of_an_object_selects_its_threshold_which_is_in_steps_of_the_object,
			set_up_at_rest, world_tear_down),
		cmocka_unit_test(
			test_with_ten_velocities_a_second_by_rpdo_the_position_of_a_recorded_trial_does_not_drift),
		cmocka_unit_test(test_with_the_yaw_by_rpdo_an_attached_magnet_does_not_disturb_the_heading),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
