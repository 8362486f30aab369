/* Calibration by SDO (2061h), from the command to the stored result: a chip with its factory errors in simulated time.
 * */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tests/scenario/world.h"

enum { STATUS_BIT = 1 << 12 };
static const uint32_t DEVICE_STATE = 0x08000022, BAD_VALUE = 0x06090030;

static int set_up_with(void **state, double warming_K)
{
	struct sensor_config chip = *sensor_preset("lsm303dlhc_l3gd20_fine");

	chip.warming_K = warming_K;
	*state = world_new(&chip, 7, "rest");
	return 0;
}

static int set_up(void **state)
{
	return set_up_with(state, 0);
}

static int set_up_warm(void **state)
{
	return set_up_with(state, 20);
}

static uint32_t command(struct world *w, uint8_t value)
{
	return world_sdo_write(w, 0x2061, 1, &value, 1);
}

static void seconds(struct world *w, const char *signal, double s)
{
	w->signal = signal_find(signal);
	world_seconds(w, s);
}

static void assert_state(const struct world *w, enum command_state state, enum calibrate_verdict verdict)
{
	assert_int_equal(w->device.values.calibration.state, state);
	assert_int_equal(w->device.values.calibration.verdict, verdict);
}

/* ---- results ----------------------------------------------------------------------------------------------------- */

static void test_a_gyro_bias_is_estimated_accepted_and_used(void **state)
{
	struct world *w = *state;
	const struct od_values *v = &w->device.values;

	assert_int_equal(command(w, 1), 0);
	assert_int_equal(v->calibration.command, 0); /* it is no value that stays */
	seconds(w, "rest", 12);
	assert_state(w, COMMAND_DONE, CALIBRATE_GOOD);
	assert_near(v->gyro_calibration.bias_x, 0, 0);
	assert_int_equal(command(w, 10), 0);
	assert_near(v->gyro_calibration.bias_x, w->sensor.gyro.bias.x, 2e-3); /* flicker noise */
	assert_near(v->gyro_calibration.bias_y, w->sensor.gyro.bias.y, 2e-3);
	assert_near(v->gyro_calibration.bias_z, w->sensor.gyro.bias.z, 2e-3);
	assert_near(v->gyro_calibration.xx, 1, 0);
	assert_int_equal(v->calibration.state, COMMAND_IDLE);
	seconds(w, "rest", 1);
	assert_near(v->angular_rate.l, 0, 0.02);
	assert_non_null(strstr(w->device.log.text, "calibration gyro started"));
	assert_non_null(strstr(w->device.log.text, "calibration gyro done: bias "));
	assert_non_null(strstr(w->device.log.text, "calibration gyro accepted: bias "));
}

/* As far as a bias can have drifted when it is used: 1.5 times 2020h:4. */
static void test_the_sigma_of_a_gyro_bias_has_its_instability(void **state)
{
	static const float instability_deg_s = 0.5f;
	struct world *w = *state;

	assert_int_equal(world_sdo_write(w, 0x2020, 4, &instability_deg_s, 4), 0);
	assert_int_equal(command(w, 1), 0);
	seconds(w, "rest", 12);
	assert_state(w, COMMAND_DONE, CALIBRATE_GOOD);
	assert_near(w->device.values.calibration.quality, 1.5 * 0.5 * M_PI / 180, 1e-4);
}

/* Quality is the sigma of the worst axis: the same whichever it is. */
static void test_the_noise_of_any_axis_counts(void **state)
{
	double quality[4];

	for (int axis = 0; axis < 4; axis++) { /* 3: none */
		struct world *w = world_new(sensor_preset("ideal"), 1, "rest");

		assert_int_equal(command(w, 1), 0);
		for (int i = 0; w->device.values.calibration.state == COMMAND_RUNNING && i < 3000; i++) {
			struct imu_sample sample;
			double noise_rad_s = (i / 100 % 2 ? 1 : -1) * 0.004;

			sensor_next(&w->sensor, w->signal, &sample, NULL);
			sample.gyro_rad_s.x += axis == 0 ? noise_rad_s : 0;
			sample.gyro_rad_s.y += axis == 1 ? noise_rad_s : 0;
			sample.gyro_rad_s.z += axis == 2 ? noise_rad_s : 0;
			world_deliver(w, &sample);
		}
		assert_state(w, COMMAND_DONE, CALIBRATE_GOOD);
		quality[axis] = w->device.values.calibration.quality;
		free(w);
	}
	(void)state;
	assert_near(quality[1], quality[0], 1e-9);
	assert_near(quality[2], quality[0], 1e-9);
	assert_true(quality[0] > 1.5 * quality[3]);
}

static void test_free_positions_calibrate_the_accelerometer(void **state)
{
	struct world *w = *state;
	const struct od_values *v = &w->device.values;

	assert_int_equal(command(w, 3), 0);
	seconds(w, "multiposition", 19);
	assert_int_equal(v->calibration.positions, 4);
	assert_int_equal(v->calibration.positions_wanted, 12);
	assert_int_equal(v->calibration.progress, 33);
	assert_true(v->calibration.next_side > 0);
	seconds(w, "multiposition", 44);
	assert_state(w, COMMAND_DONE, CALIBRATE_GOOD);
	assert_true(v->calibration.quality > 0 && (double)v->calibration.quality < 0.02);
	assert_int_equal(command(w, 10), 0);
	/* 2003h (gravity) differs from that of the simulation */
	assert_near(v->accelerometer_calibration.bias_x, w->sensor.accel.bias.x, 0.02);
	assert_near(v->accelerometer_calibration.xy, v->accelerometer_calibration.yx, 0);
}

static void calibrate_in_free_positions(struct world *w)
{
	assert_int_equal(command(w, 3), 0);
	seconds(w, "multiposition", 63);
	assert_state(w, COMMAND_DONE, CALIBRATE_GOOD);
	assert_true(w->device.values.calibration.gyro_sigma > 0 && w->device.values.calibration.gyro_sigma < 0.2f);
	assert_int_equal(command(w, 10), 0);
}

static void test_free_positions_calibrate_the_matrix_of_a_gyro_whose_bias_is_known(void **state)
{
	struct world *w = *state;
	const struct od_values *v = &w->device.values;
	const struct sensor *chip = &w->sensor;

	calibrate_in_free_positions(w);
	assert_true(v->gyro_calibration.xx == 1 && v->gyro_calibration.yz == 0); /* its bias is not */

	assert_int_equal(command(w, 1), 0);
	seconds(w, "rest", 12);
	assert_int_equal(command(w, 10), 0);
	float bias = v->gyro_calibration.bias_x;
	calibrate_in_free_positions(w);
	assert_true(v->gyro_calibration.bias_x == bias);
	/* the scale of the first axis, to second order in the cross-axis terms */
	assert_near((double)v->gyro_calibration.xx * chip->gyro.matrix[0][0],
		(double)v->accelerometer_calibration.xx * chip->accel.matrix[0][0], 0.004);
	assert_true(fabs(chip->gyro.matrix[0][0] - 1) > 0.005);
}

/* Since the sensor has changed between them no ellipsoid fits. */
static void test_free_positions_that_do_not_suffice_are_not_all(void **state)
{
	struct world *w = *state;
	const struct od_values *v = &w->device.values;

	assert_int_equal(command(w, 3), 0);
	seconds(w, "multiposition", 30);
	w->sensor.accel.bias.x += 1;
	seconds(w, "multiposition", 40);
	assert_state(w, COMMAND_RUNNING, CALIBRATE_COLLECTING);
	assert_int_equal(v->calibration.positions, 14);
	assert_int_equal(v->calibration.positions_wanted, 14);
	assert_int_equal(v->calibration.progress, 99);
}

static void test_six_faces_calibrate_the_accelerometer(void **state)
{
	struct world *w = *state;

	assert_int_equal(command(w, 2), 0);
	seconds(w, "multiposition", 63);
	assert_state(w, COMMAND_DONE, CALIBRATE_GOOD);
	assert_int_equal(w->device.values.calibration.positions, 6);
	assert_int_equal(command(w, 10), 0);
	assert_near(w->device.values.accelerometer_calibration.bias_z, w->sensor.accel.bias.z, 0.02);
}

static void test_turning_calibrates_the_magnetometer_to_the_given_field(void **state)
{
	struct world *w = *state;
	const struct od_values *v = &w->device.values;
	const float field_uT = 60;

	assert_int_equal(world_sdo_write(w, 0x2061, 13, &field_uT, 4), 0);
	assert_int_equal(command(w, 4), 0);
	seconds(w, "figure", 45);
	assert_state(w, COMMAND_DONE, CALIBRATE_GOOD);
	assert_near(v->calibration.field, 60, 0);
	assert_true((double)v->calibration.quality < 1 && v->calibration.coverage >= 60);
	assert_int_equal(command(w, 10), 0);
	assert_near(v->magnetometer_calibration.bias_x, w->sensor.mag.bias.x, 0.2);
	seconds(w, "figure", 1);
	assert_near(
		sqrt((double)(v->magnetic_field.l * v->magnetic_field.l + v->magnetic_field.s * v->magnetic_field.s +
			      v->magnetic_field.t * v->magnetic_field.t)),
		60, 1.5);
}

static void test_an_accepted_and_stored_result_is_used_after_power_on(void **state)
{
	struct world *w = *state;
	float bias;

	assert_int_equal(command(w, 1), 0);
	seconds(w, "rest", 12);
	assert_int_equal(command(w, 10), 0);
	bias = w->device.values.gyro_calibration.bias_y;
	assert_int_equal(world_sdo_write(w, 0x1010, 1, "save", 4), 0);
	world_power_on(w, NULL);
	assert_true(bias != 0);
	assert_near(w->device.values.gyro_calibration.bias_y, bias, 0);
	assert_int_equal(w->device.values.calibration.state, COMMAND_IDLE);
}

/* 2050h has the bias at the reference temperature; the rate at the present temperature is 0. */
static void test_with_temperature_compensation_the_bias_is_converted_to_the_reference_temperature(void **state)
{
	struct world *w = *state;
	const float slope[] = {
		(float)w->sensor.gyro.slope.x, (float)w->sensor.gyro.slope.y, (float)w->sensor.gyro.slope.z};

	for (uint8_t i = 0; i < 3; i++) {
		assert_true(fabs((double)slope[i]) * 15 > 4e-3); /* so that a wrong sign is seen */
		assert_int_equal(world_sdo_write(w, 0x2054, (uint8_t)(i + 1), &slope[i], 4), 0);
	}
	seconds(w, "rest", 120);
	assert_int_equal(command(w, 1), 0);
	seconds(w, "rest", 12);
	assert_state(w, COMMAND_DONE, CALIBRATE_GOOD);
	assert_true((double)w->device.values.calibration.temperature > 35);
	assert_int_equal(command(w, 10), 0);
	assert_near(w->device.values.gyro_calibration.bias_x, w->sensor.gyro.bias.x, 2e-3);
	assert_near(w->device.values.gyro_calibration.bias_y, w->sensor.gyro.bias.y, 2e-3);
	assert_near(w->device.values.gyro_calibration.bias_z, w->sensor.gyro.bias.z, 2e-3);
}

/* ---- refusals ---------------------------------------------------------------------------------------------------- */

static void test_motion_ends_in_a_refusal_without_a_result(void **state)
{
	struct world *w = *state;

	assert_int_equal(command(w, 1), 0);
	seconds(w, "tumble", 65);
	assert_state(w, COMMAND_REFUSED, CALIBRATE_MOVED);
	assert_int_equal(command(w, 10), DEVICE_STATE);
	assert_near(w->device.values.gyro_calibration.bias_x, 0, 0);
	assert_non_null(strstr(w->device.log.text, "calibration gyro refused: moved"));
}

static void test_accept_and_discard_need_a_result(void **state)
{
	struct world *w = *state;

	assert_int_equal(command(w, 10), DEVICE_STATE);
	assert_int_equal(command(w, 11), DEVICE_STATE);
	assert_int_equal(command(w, 1), 0);
	assert_int_equal(command(w, 10), DEVICE_STATE);
}

static void test_a_result_that_its_object_refuses_is_kept_and_nothing_of_it_accepted(void **state)
{
	struct world *w = *state;

	assert_int_equal(command(w, 2), 0);
	seconds(w, "multiposition", 63);
	w->device.values.calibration.zz = 11; /* the last one; 2051h:12 takes up to 10 */
	assert_int_equal(command(w, 10), 0x06090031);
	assert_state(w, COMMAND_DONE, CALIBRATE_GOOD);
	assert_near(w->device.values.accelerometer_calibration.bias_x, 0, 0);
	assert_int_equal(command(w, 11), 0);
}

static void test_a_discarded_result_changes_nothing(void **state)
{
	struct world *w = *state;

	assert_int_equal(command(w, 1), 0);
	seconds(w, "rest", 12);
	assert_int_equal(command(w, 11), 0);
	assert_state(w, COMMAND_IDLE, CALIBRATE_COLLECTING);
	assert_near(w->device.values.gyro_calibration.bias_x, 0, 0);
	assert_int_equal(command(w, 10), DEVICE_STATE);
}

static void test_of_a_discarded_result_nothing_is_left(void **state)
{
	struct world *w = *state;
	const struct od_values before = w->device.values;

	assert_int_equal(before.calibration.kind, 0);
	assert_int_equal(before.calibration.progress, 0);
	assert_int_equal(before.calibration.positions, 0);
	assert_int_equal(before.calibration.positions_wanted, 0);
	assert_int_equal(before.calibration.next_side, 0);
	assert_int_equal(before.calibration.coverage, 0);
	assert_near(before.calibration.quality, 0, 0);
	assert_near(before.calibration.field, 0, 0);
	assert_near(before.calibration.gyro_sigma, 0, 0);
	assert_near(before.calibration.bias_x, 0, 0);
	assert_near(before.calibration.zz, 0, 0);
	assert_int_equal(command(w, 3), 0);
	seconds(w, "multiposition", 19);
	assert_true(w->device.values.calibration.next_side > 0 && w->device.values.calibration.positions > 0);
	assert_int_equal(command(w, 0), 0);
	assert_state(w, COMMAND_IDLE, CALIBRATE_ABORTED);
	w->device.values.calibration.verdict = before.calibration.verdict; /* only that is left */
	assert_memory_equal(&w->device.values.calibration, &before.calibration, sizeof(before.calibration));
	for (uint8_t kind = 2; kind <= 4; kind += 2) {
		assert_int_equal(command(w, kind), 0);
		seconds(w, kind == 4 ? "figure" : "multiposition", 63);
		assert_state(w, COMMAND_DONE, CALIBRATE_GOOD);
		assert_int_equal(command(w, 11), 0);
		assert_memory_equal(&w->device.values.calibration, &before.calibration, sizeof(before.calibration));
	}
}

static void test_only_one_runs_at_a_time(void **state)
{
	struct world *w = *state;

	assert_int_equal(command(w, 1), 0);
	assert_int_equal(command(w, 4), DEVICE_STATE);
	assert_int_equal(w->device.values.calibration.kind, 1);
}

static void test_the_lever_arm_and_a_calibration_exclude_each_other(void **state)
{
	struct world *w = *state;
	const uint8_t start = 1, abort = 0;

	assert_int_equal(command(w, 1), 0);
	assert_int_equal(world_sdo_write(w, 0x2060, 1, &start, 1), DEVICE_STATE);
	assert_int_equal(command(w, 0), 0);
	assert_int_equal(world_sdo_write(w, 0x2060, 1, &start, 1), 0);
	assert_int_equal(command(w, 1), DEVICE_STATE);
	assert_int_equal(world_sdo_write(w, 0x2060, 1, &abort, 1), 0);
	assert_int_equal(command(w, 1), 0);
}

static void test_a_command_that_does_not_exist_is_refused(void **state)
{
	struct world *w = *state;

	assert_int_equal(command(w, 5), BAD_VALUE);
}

static void test_abort_ends_a_calibration(void **state)
{
	struct world *w = *state;

	assert_int_equal(command(w, 1), 0);
	seconds(w, "rest", 3);
	assert_true(w->device.values.sample.status & STATUS_BIT);
	assert_int_equal(command(w, 0), 0);
	assert_state(w, COMMAND_IDLE, CALIBRATE_ABORTED);
	seconds(w, "rest", 0.02);
	assert_false(w->device.values.sample.status & STATUS_BIT);
}

static void test_a_reset_ends_a_calibration(void **state)
{
	struct world *w = *state;

	assert_int_equal(command(w, 1), 0);
	seconds(w, "rest", 3);
	world_nmt(w, 0x81);
	assert_state(w, COMMAND_IDLE, CALIBRATE_COLLECTING);
}

static void test_a_lost_sensor_ends_a_calibration(void **state)
{
	struct world *w = *state;

	assert_int_equal(command(w, 1), 0);
	seconds(w, "rest", 3);
	w->now_us += 1000000;
	device_tick(&w->device, w->now_us);
	assert_state(w, COMMAND_REFUSED, CALIBRATE_SENSOR_LOST);
	assert_false(w->device.values.sample.status & STATUS_BIT);
}

static void test_a_start_is_refused_without_samples_and_accepted_after_the_next_sample(void **state)
{
	struct world *w = *state;

	seconds(w, "rest", 1);
	w->now_us += 1000000;
	device_tick(&w->device, w->now_us);
	assert_int_equal(command(w, 1), DEVICE_STATE);
	assert_state(w, COMMAND_IDLE, CALIBRATE_COLLECTING);
	seconds(w, "rest", 0.1);
	assert_int_equal(command(w, 1), 0);
}

#define TEST(test) cmocka_unit_test_setup_teardown(test, set_up, world_tear_down)
#define WARM(test) cmocka_unit_test_setup_teardown(test, set_up_warm, world_tear_down)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_a_gyro_bias_is_estimated_accepted_and_used),
		TEST(test_the_sigma_of_a_gyro_bias_has_its_instability),
		TEST(test_the_noise_of_any_axis_counts),
		TEST(test_free_positions_calibrate_the_accelerometer),
		TEST(test_free_positions_that_do_not_suffice_are_not_all),
		TEST(test_free_positions_calibrate_the_matrix_of_a_gyro_whose_bias_is_known),
		TEST(test_six_faces_calibrate_the_accelerometer),
		TEST(test_turning_calibrates_the_magnetometer_to_the_given_field),
		TEST(test_an_accepted_and_stored_result_is_used_after_power_on),
		WARM(test_with_temperature_compensation_the_bias_is_converted_to_the_reference_temperature),
		TEST(test_motion_ends_in_a_refusal_without_a_result),
		TEST(test_accept_and_discard_need_a_result),
		TEST(test_a_result_that_its_object_refuses_is_kept_and_nothing_of_it_accepted),
		TEST(test_a_discarded_result_changes_nothing),
		TEST(test_of_a_discarded_result_nothing_is_left),
		TEST(test_only_one_runs_at_a_time),
		TEST(test_the_lever_arm_and_a_calibration_exclude_each_other),
		TEST(test_a_command_that_does_not_exist_is_refused),
		TEST(test_abort_ends_a_calibration),
		TEST(test_a_reset_ends_a_calibration),
		TEST(test_a_lost_sensor_ends_a_calibration),
		TEST(test_a_start_is_refused_without_samples_and_accepted_after_the_next_sample),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
