/* Identification of the lever arm by SDO (2060h), from start to accept: a robot in simulated time. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/lever_arm_command.h"
#include "tests/scenario/world.h"

enum { ABORT_HELD = 0, START_HELD = 1, START_REFERENCE = 2, ACCEPT = 3, DISCARD = 4 };
static const uint32_t DEVICE_STATE = 0x08000022;
static const struct vec3 ARM = {0.06, -0.05, 0.0624}; /* 100 mm */

struct robot {
	struct world world;
	bool travels;		   /* the reference point moves; in the signal it is at rest */
	bool with_sample;	   /* the samples carry the acceleration of the reference point */
	bool written, by_rpdo;	   /* 2075h is written every second sample, by RPDO or SDO */
	struct signal_truth truth; /* of the last sample */
	unsigned count;
};

static int set_up(void **state)
{
	struct sensor_config sensor = *sensor_preset("lsm303dlhc_l3gd20_fine");
	struct robot *robot = calloc(1, sizeof(*robot));

	assert_non_null(robot);
	*state = robot;
	sensor.rate_hz = 200;
	sensor.lever_arm_b_m = ARM;
	sensor.gyro.range = sensor.accel.range = 1e3;
	sensor_calibrate(&sensor);
	world_init(&robot->world, &sensor, 1, "tumble");
	world_power_on(&robot->world, NULL);
	return 0;
}

static uint32_t command(struct world *w, uint8_t value)
{
	return world_sdo_write(w, 0x2060, 1, &value, 1);
}

static void tell_reference_by_rpdo(struct world *w, struct vec3 accel_b_m_s2)
{
	const int16_t twins[] = {(int16_t)lround(accel_b_m_s2.x / 0.005), (int16_t)lround(accel_b_m_s2.y / 0.005),
		(int16_t)lround(accel_b_m_s2.z / 0.005)};
	uint8_t data[sizeof(twins)];

	memcpy(data, twins, sizeof(data));
	world_receive(w, 0x200 + WORLD_NODE_ID, sizeof(data), data);
}

static void tell_reference(struct world *w, struct vec3 accel_b_m_s2)
{
	const float l = (float)accel_b_m_s2.x, s = (float)accel_b_m_s2.y, t = (float)accel_b_m_s2.z;

	assert_int_equal(world_sdo_write(w, 0x2075, 1, &l, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x2075, 2, &s, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x2075, 3, &t, 4), 0);
}

static struct vec3 reference_b_m_s2(const struct robot *robot)
{
	return quat_rotate_inverse(robot->truth.q_nb, robot->truth.accel_n_m_s2);
}

static void sample(struct robot *robot)
{
	struct world *w = &robot->world;
	struct signal_truth *truth = &robot->truth;
	struct imu_sample s;

	signal_at(w->signal, sensor_instant_s(&w->sensor), truth);
	if (robot->travels)
		truth->accel_n_m_s2 =
			(struct vec3){4 * sin(5 * truth->t_s), 3 * sin(7 * truth->t_s), sin(8 * truth->t_s)};
	sensor_measure(&w->sensor, truth, &s);
	if (robot->with_sample) {
		s.ref_accel_b_m_s2 = reference_b_m_s2(robot);
		s.flags |= SAMPLE_REFERENCE;
	}
	world_deliver(w, &s);
	if (robot->written && robot->count++ % 2 == 0)
		(robot->by_rpdo ? tell_reference_by_rpdo : tell_reference)(w, reference_b_m_s2(robot));
}

static void seconds(struct robot *robot, double s)
{
	for (int n = (int)(s * 1e6 / (double)robot->world.interval_us); n > 0; n--)
		sample(robot);
}

/* RMS error of the published acceleration. */
static double error_over(struct robot *robot, double s)
{
	const struct od_values *v = &robot->world.device.values;
	const int n = (int)(s * 1e6 / (double)robot->world.interval_us);
	double sum = 0;

	for (int i = 0; i < n; i++) {
		sample(robot);
		struct vec3 out = {(double)v->acceleration_object.l, (double)v->acceleration_object.s,
			(double)v->acceleration_object.t};
		struct vec3 off = vec3_sub(out, reference_b_m_s2(robot));
		sum += vec3_dot(off, off);
	}
	return sqrt(sum / n);
}

static void assert_lever_arm_is_found(const struct world *w)
{
	const struct od_values *v = &w->device.values;

	if (v->lever_arm_identification.state != COMMAND_DONE)
		fail_msg(
			"state %u, verdict %u", v->lever_arm_identification.state, v->lever_arm_identification.verdict);
	assert_int_equal(v->lever_arm_identification.verdict, LEVER_FOUND);
	assert_int_equal(v->lever_arm_identification.progress, 100);
	assert_near(v->lever_arm_identification.l, ARM.x, 0.001);
	assert_near(v->lever_arm_identification.s, ARM.y, 0.001);
	assert_near(v->lever_arm_identification.t, ARM.z, 0.001);
	assert_true(v->lever_arm_identification.sigma_l > 0 && v->lever_arm_identification.sigma_l < 0.003f);
}

/* ---- from start to accept ---------------------------------------------------------------------------------------- */

static void test_the_identified_lever_arm_improves_the_acceleration(void **state)
{
	struct robot *robot = *state;
	struct world *w = &robot->world;
	double before, after;

	seconds(robot, 5);
	before = error_over(robot, 10);
	assert_int_equal(command(w, START_HELD), 0);
	seconds(robot, 32);
	assert_lever_arm_is_found(w);
	assert_near(w->device.values.lever_arm.l, 0, 0); /* not accepted yet */
	assert_int_equal(command(w, ACCEPT), 0);
	assert_near(w->device.values.lever_arm.l, ARM.x, 0.001);
	assert_near(w->device.values.lever_arm.s, ARM.y, 0.001);
	assert_near(w->device.values.lever_arm.t, ARM.z, 0.001);
	after = error_over(robot, 10);
	print_message("acceleration error before %.3f, after %.3f m/s^2\n", before, after);
	assert_true(after < before / 2);
}

static void test_an_accepted_lever_arm_is_used_by_the_next_sample(void **state)
{
	struct robot *robot = *state;
	struct world *w = &robot->world;

	assert_int_equal(command(w, START_HELD), 0);
	seconds(robot, 32);
	assert_lever_arm_is_found(w);
	assert_int_equal(command(w, ACCEPT), 0);
	sample(robot);
	assert_near(w->device.pipeline.config.estimator.lever_arm_b_m.x, w->device.values.lever_arm.l, 0);
	assert_true(w->device.pipeline.config.estimator.lever_arm_b_m.x > 0.05);
}

static void test_a_moving_reference_point_can_be_used_with_its_acceleration_by_2075h_at_100_hz(void **state)
{
	struct robot *robot = *state;
	struct world *w = &robot->world;

	robot->travels = true;
	robot->written = true;
	assert_int_equal(command(w, START_REFERENCE), 0);
	seconds(robot, 32);
	assert_lever_arm_is_found(w);
	assert_true(w->device.values.lever_arm_identification.delay > 0.0025f);
	assert_true(w->device.values.lever_arm_identification.delay < 0.01f);
}

static void test_the_16_bit_twins_of_2075h_count_in_steps_of_5_mm_s2(void **state)
{
	struct world *w = *state;
	const int16_t l = 200, s = -400, t = 1;

	assert_int_equal(world_sdo_write(w, 0x2075, 4, &l, 2), 0);
	assert_int_equal(world_sdo_write(w, 0x2075, 5, &s, 2), 0);
	assert_int_equal(world_sdo_write(w, 0x2075, 6, &t, 2), 0);
	assert_near(w->device.lever_arm_command.ref_b_m_s2.x, 1, 1e-12);
	assert_near(w->device.lever_arm_command.ref_b_m_s2.y, -2, 1e-12);
	assert_near(w->device.lever_arm_command.ref_b_m_s2.z, 0.005, 1e-12);
}

static void test_each_write_of_2075h_updates_the_twin_and_reset_node_sets_both_to_zero(void **state)
{
	struct world *w = *state;
	const float l = 1.26f;
	const int16_t s = -400;

	assert_int_equal(world_sdo_write(w, 0x2075, 1, &l, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x2075, 5, &s, 2), 0);
	assert_int_equal(w->device.values.reference_acceleration.l16, 252);
	assert_true(w->device.values.reference_acceleration.s == -2);
	world_nmt(w, 0x81);
	assert_int_equal(w->device.values.reference_acceleration.l16, 0);
	assert_true(w->device.values.reference_acceleration.l == 0);
	assert_true(w->device.values.reference_acceleration.s == 0);
}

static void test_a_reference_that_comes_with_the_samples_is_used_without_a_delay(void **state)
{
	struct robot *robot = *state;
	struct world *w = &robot->world;

	robot->travels = true;
	robot->with_sample = true;
	assert_int_equal(command(w, START_REFERENCE), 0);
	seconds(robot, 32);
	assert_lever_arm_is_found(w);
	assert_false(w->device.lever_arm_command.lever.config.estimate_delay);
}

static void map_reference_into_rpdo1(struct world *w)
{
	const uint32_t off = 0x80000200 + WORLD_NODE_ID, on = 0x200 + WORLD_NODE_ID;
	const uint32_t entries[] = {0x20750410, 0x20750510, 0x20750610};
	const uint8_t none = 0, three = 3, at_once = 255;

	assert_int_equal(world_sdo_write(w, 0x1400, 1, &off, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x1400, 2, &at_once, 1), 0);
	assert_int_equal(world_sdo_write(w, 0x1600, 0, &none, 1), 0);
	for (uint8_t i = 0; i < 3; i++)
		assert_int_equal(world_sdo_write(w, 0x1600, (uint8_t)(i + 1), &entries[i], 4), 0);
	assert_int_equal(world_sdo_write(w, 0x1600, 0, &three, 1), 0);
	assert_int_equal(world_sdo_write(w, 0x1400, 1, &on, 4), 0);
	world_nmt(w, 1);
}

static void test_one_rpdo_can_carry_the_reference(void **state)
{
	struct robot *robot = *state;
	struct world *w = &robot->world;

	map_reference_into_rpdo1(w);
	robot->travels = true;
	robot->written = robot->by_rpdo = true;
	assert_int_equal(command(w, START_REFERENCE), 0);
	seconds(robot, 32);
	assert_lever_arm_is_found(w);
}

/* ---- refusals ---------------------------------------------------------------------------------------------------- */

static void test_a_reference_that_stops_is_used_for_50_ms_and_the_identification_refused(void **state)
{
	struct robot *robot = *state;
	struct world *w = &robot->world;

	tell_reference(w, (struct vec3){0, 0, 0});
	assert_int_equal(command(w, START_REFERENCE), 0);
	seconds(robot, 89);
	assert_int_equal(w->device.values.lever_arm_identification.state, COMMAND_RUNNING);
	seconds(robot, 2); /* three times the duration */
	assert_int_equal(w->device.values.lever_arm_identification.state, COMMAND_REFUSED);
	assert_int_equal(w->device.values.lever_arm_identification.verdict, LEVER_NO_REFERENCE);
	assert_int_equal(command(w, ACCEPT), DEVICE_STATE);
	assert_int_equal(command(w, DISCARD), 0);
	assert_int_equal(w->device.values.lever_arm_identification.state, COMMAND_IDLE);
	assert_int_equal(w->device.values.lever_arm_identification.verdict, 0);
}

static void test_a_reference_point_that_moves_is_refused_and_2000h_stays(void **state)
{
	struct robot *robot = *state;
	struct world *w = &robot->world;

	robot->travels = true;
	assert_int_equal(command(w, START_HELD), 0);
	seconds(robot, 32);
	assert_int_equal(w->device.values.lever_arm_identification.state, COMMAND_REFUSED);
	assert_int_equal(w->device.values.lever_arm_identification.verdict, LEVER_NOT_HELD);
	assert_int_equal(command(w, ACCEPT), DEVICE_STATE);
	assert_near(w->device.values.lever_arm.l, 0, 0);
}

static void test_commands_in_a_wrong_state_are_refused_with_08000022h(void **state)
{
	struct world *w = *state;
	const uint8_t five = 5;

	assert_int_equal(command(w, ACCEPT), DEVICE_STATE);
	assert_int_equal(command(w, DISCARD), DEVICE_STATE);
	assert_int_equal(command(w, ABORT_HELD), 0);
	assert_int_equal(command(w, START_HELD), 0);
	assert_int_equal(command(w, START_HELD), DEVICE_STATE);
	assert_int_equal(command(w, START_REFERENCE), DEVICE_STATE);
	assert_int_equal(command(w, ACCEPT), DEVICE_STATE);
	assert_int_equal(command(w, DISCARD), DEVICE_STATE);
	assert_int_equal(world_sdo_write(w, 0x2060, 1, &five, 1), 0x06090031);
	assert_int_equal(w->device.values.lever_arm_identification.state, COMMAND_RUNNING);
}

/* ---- life -------------------------------------------------------------------------------------------------------- */

static void test_bit_12_of_the_status_is_set_until_abort(void **state)
{
	struct robot *robot = *state;
	struct world *w = &robot->world;

	sample(robot);
	assert_int_equal(w->device.values.sample.status & STATUS_COMMISSIONING, 0);
	assert_int_equal(command(w, START_HELD), 0);
	sample(robot);
	assert_int_equal(w->device.values.sample.status & STATUS_COMMISSIONING, STATUS_COMMISSIONING);
	assert_int_equal(command(w, ABORT_HELD), 0);
	sample(robot);
	assert_int_equal(w->device.values.sample.status & STATUS_COMMISSIONING, 0);
	assert_int_equal(w->device.values.lever_arm_identification.state, COMMAND_IDLE);
}

static void test_nmt_reset_ends_an_identification(void **state)
{
	const uint8_t resets[] = {129, 130};
	struct robot *robot = *state;
	struct world *w = &robot->world;

	for (int i = 0; i < 2; i++) {
		assert_int_equal(command(w, START_HELD), 0);
		seconds(robot, 5);
		assert_int_not_equal(w->device.values.lever_arm_identification.progress, 0);
		world_nmt(w, resets[i]);
		assert_int_equal(w->device.values.lever_arm_identification.state, COMMAND_IDLE);
		assert_int_equal(w->device.values.lever_arm_identification.progress, 0);
	}
}

static void test_a_sensor_with_fewer_than_25_samples_a_second_cannot_identify_it(void **state)
{
	struct robot *robot = *state;
	struct world *w = &robot->world;

	w->imu.rate_hz = 24;
	world_power_on(w, NULL);
	assert_int_equal(command(w, START_HELD), DEVICE_STATE);
	assert_int_equal(w->device.values.lever_arm_identification.state, COMMAND_IDLE);
	w->imu.rate_hz = 25;
	world_power_on(w, NULL);
	assert_int_equal(command(w, START_HELD), 0);
}

/* Both within the 50 ms for which it is used: before, and after the first sample that used it. */
static void test_reset_node_forgets_the_reference(void **state)
{
	struct robot *robot = *state;
	struct world *w = &robot->world;

	for (int samples = 0; samples < 2; samples++) {
		tell_reference(w, (struct vec3){1, 2, 3});
		for (int i = 0; i < samples; i++)
			sample(robot);
		world_nmt(w, 0x81);
		sample(robot);
		assert_int_equal(command(w, START_REFERENCE), 0);
		sample(robot);
		assert_false(w->device.lever_arm_command.lever.config.estimate_delay);
		assert_int_equal(command(w, ABORT_HELD), 0);
	}
	tell_reference(w, (struct vec3){1, 2, 3});
	assert_near(w->device.lever_arm_command.ref_b_m_s2.x, 1, 0);
	assert_near(w->device.lever_arm_command.ref_b_m_s2.y, 2, 0);
	assert_near(w->device.lever_arm_command.ref_b_m_s2.z, 3, 0);
	assert_int_equal(command(w, START_REFERENCE), 0);
	sample(robot);
	assert_true(w->device.lever_arm_command.lever.config.estimate_delay);
}

static void test_nothing_is_interpolated_over_a_sample_that_is_clipped_or_behind_a_gap(void **state)
{
	static const unsigned flags[] = {SAMPLE_SATURATED, SAMPLE_DISCONTINUITY};
	struct robot *robot = *state;
	struct world *w = &robot->world;
	struct imu_sample s;

	assert_int_equal(command(w, START_HELD), 0);
	for (int i = 0; i < 2; i++) {
		seconds(robot, 1);
		assert_true(w->device.lever_arm_command.lever.raw_count > 1);
		sensor_next(&w->sensor, w->signal, &s, NULL);
		s.flags |= flags[i];
		world_deliver(w, &s);
		sample(robot);
		assert_int_equal(w->device.lever_arm_command.lever.raw_count, 1);
	}
}

static void test_a_lost_sensor_ends_in_a_refusal_with_its_verdict(void **state)
{
	struct robot *robot = *state;
	struct world *w = &robot->world;

	assert_int_equal(command(w, START_HELD), 0);
	seconds(robot, 3);
	w->now_us += 1000000;
	device_tick(&w->device, w->now_us);
	assert_int_equal(w->device.values.lever_arm_identification.state, COMMAND_REFUSED);
	assert_int_equal(w->device.values.lever_arm_identification.verdict, LEVER_SENSOR_LOST);
	assert_false(w->device.values.sample.status & STATUS_COMMISSIONING);
	assert_int_equal(command(w, ACCEPT), DEVICE_STATE);
	seconds(robot, 1);
	assert_int_equal(w->device.values.lever_arm_identification.state, COMMAND_REFUSED);
}

static void test_a_start_is_refused_without_samples_and_accepted_after_the_next_sample(void **state)
{
	struct robot *robot = *state;
	struct world *w = &robot->world;

	seconds(robot, 1);
	w->now_us += 1000000;
	device_tick(&w->device, w->now_us);
	assert_int_equal(command(w, START_HELD), DEVICE_STATE);
	assert_int_equal(w->device.values.lever_arm_identification.state, COMMAND_IDLE);
	seconds(robot, 0.1);
	assert_int_equal(command(w, START_HELD), 0);
}

static void test_progress_is_relative_to_the_requested_duration(void **state)
{
	struct robot *robot = *state;
	struct world *w = &robot->world;
	const float duration = 100;

	assert_int_equal(world_sdo_write(w, 0x2060, 5, &duration, 4), 0);
	assert_int_equal(command(w, START_HELD), 0);
	seconds(robot, 21);
	assert_int_equal(w->device.values.lever_arm_identification.progress, 20);
}

int main(void)
{
#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, world_tear_down)
	const struct CMUnitTest tests[] = {
		TEST(test_the_identified_lever_arm_improves_the_acceleration),
		TEST(test_an_accepted_lever_arm_is_used_by_the_next_sample),
		TEST(test_a_moving_reference_point_can_be_used_with_its_acceleration_by_2075h_at_100_hz),
		TEST(test_a_reference_that_comes_with_the_samples_is_used_without_a_delay),
		TEST(test_one_rpdo_can_carry_the_reference),
		TEST(test_the_16_bit_twins_of_2075h_count_in_steps_of_5_mm_s2),
		TEST(test_each_write_of_2075h_updates_the_twin_and_reset_node_sets_both_to_zero),
		TEST(test_a_reference_that_stops_is_used_for_50_ms_and_the_identification_refused),
		TEST(test_a_reference_point_that_moves_is_refused_and_2000h_stays),
		TEST(test_commands_in_a_wrong_state_are_refused_with_08000022h),
		TEST(test_bit_12_of_the_status_is_set_until_abort),
		TEST(test_nmt_reset_ends_an_identification),
		TEST(test_a_sensor_with_fewer_than_25_samples_a_second_cannot_identify_it),
		TEST(test_reset_node_forgets_the_reference),
		TEST(test_nothing_is_interpolated_over_a_sample_that_is_clipped_or_behind_a_gap),
		TEST(test_a_lost_sensor_ends_in_a_refusal_with_its_verdict),
		TEST(test_a_start_is_refused_without_samples_and_accepted_after_the_next_sample),
		TEST(test_progress_is_relative_to_the_requested_duration),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
