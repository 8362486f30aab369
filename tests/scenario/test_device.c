/* The whole device in simulated time: samples of a simulated robot in, CAN frames out. */
#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/publish.h"
#include "gateway/settings.h"
#include "tests/scenario/world.h"

static struct world *new_world(void)
{
	struct sensor_config sensor = *sensor_preset("ideal");

	sensor.lever_arm_b_m = (struct vec3){0.05, -0.1, 0.2};
	return world_new(&sensor, 1, "tumble");
}

static int set_up(void **state)
{
	*state = new_world();
	return 0;
}

static void sync(struct world *w)
{
	world_receive(w, 0x080, 0, NULL);
}

static void write_lever_arm(struct world *w, float l, float s, float t)
{
	assert_int_equal(world_sdo_write(w, 0x2000, 1, &l, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x2000, 2, &s, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x2000, 3, &t, 4), 0);
}

static int16_t i16(const uint8_t *p)
{
	return (int16_t)(p[0] | p[1] << 8);
}

/* ---- defaults ---------------------------------------------------------------------------------------------------- */

/* The EDS has a real32 of the same value, some of them in other units. */
static void assert_equal(double from_eds, double from_model)
{
	assert_near(from_eds, from_model, 1e-5 * fabs(from_model));
}

/* So that the figures that are measured on the model alone hold for the device. */
static void test_the_defaults_of_the_eds_are_those_of_the_model(void **state)
{
	struct world *w = *state;
	const struct pipeline_config e = settings_pipeline(&w->device.values), m = PIPELINE_DEFAULTS;

	assert_int_equal(e.accel_filter.type, m.accel_filter.type);
	assert_int_equal(e.accel_filter.order, m.accel_filter.order);
	assert_equal(e.accel_filter.cutoff_hz, m.accel_filter.cutoff_hz);
	assert_int_equal(e.rate_filter.type, m.rate_filter.type);
	assert_int_equal(e.rate_filter.order, m.rate_filter.order);
	assert_equal(e.rate_filter.cutoff_hz, m.rate_filter.cutoff_hz);
	assert_int_equal(e.fusion.algorithm, m.fusion.algorithm);
	assert_int_equal(e.fusion.use_magnetometer, m.fusion.use_magnetometer);
	assert_equal(e.fusion.madgwick_beta, m.fusion.madgwick_beta);
	assert_equal(e.fusion.mahony_kp_rad_s, m.fusion.mahony_kp_rad_s);
	assert_equal(e.fusion.mahony_ki_rad_s2, m.fusion.mahony_ki_rad_s2);
	assert_equal(e.fusion.kalman.velocity_sigma_m_s, m.fusion.kalman.velocity_sigma_m_s);
	assert_equal(e.fusion.kalman.heading_sigma_rad, m.fusion.kalman.heading_sigma_rad);
	assert_equal(e.fusion.kalman.field_limit, m.fusion.kalman.field_limit);
	assert_equal(e.fusion.kalman.rejection_time_s, m.fusion.kalman.rejection_time_s);
	assert_equal(e.fusion.kalman.gyro_error, m.fusion.kalman.gyro_error);
	assert_equal(e.fusion.kalman.bias_walk_rad_s_sqrt_s, m.fusion.kalman.bias_walk_rad_s_sqrt_s);
	assert_equal(e.fusion.kalman.gyro_scale_sigma, m.fusion.kalman.gyro_scale_sigma);
	assert_equal(e.latency.sensor_s, m.latency.sensor_s);
	assert_equal(e.latency.accelerometer_s, m.latency.accelerometer_s);
	assert_equal(e.noise.angle_sigma_rad, m.noise.angle_sigma_rad);
	assert_equal(e.noise.gyro_density_rad_s_sqrt_hz, m.noise.gyro_density_rad_s_sqrt_hz);
	assert_equal(e.noise.gyro_bias_instability_rad_s, m.noise.gyro_bias_instability_rad_s);
	assert_equal(e.noise.accel_density_m_s2_sqrt_hz, m.noise.accel_density_m_s2_sqrt_hz);
	assert_equal(e.noise.accel_bias_instability_m_s2, m.noise.accel_bias_instability_m_s2);
	assert_equal(e.noise.gyro_bias_per_K_rad_s, m.noise.gyro_bias_per_K_rad_s);
	assert_equal(e.noise.accel_bias_per_K_m_s2, m.noise.accel_bias_per_K_m_s2);
	assert_equal(e.noise.mag_sigma_uT, m.noise.mag_sigma_uT);
	assert_int_equal(e.estimator.model, m.estimator.model);
	assert_int_equal(e.estimator.rates_from, m.estimator.rates_from);
	assert_equal(e.estimator.gravity_m_s2, m.estimator.gravity_m_s2);
	assert_equal(e.rest.gyro_threshold_rad_s, m.rest.gyro_threshold_rad_s);
	assert_equal(e.rest.accel_threshold_m_s2, m.rest.accel_threshold_m_s2);
	assert_equal(e.rest.time_s, m.rest.time_s);
	assert_int_equal(e.position.mode, m.position.mode);
	assert_equal(e.position.longest_integration_s, m.position.longest_integration_s);
	assert_int_equal(e.position.navigation.preset, m.position.navigation.preset);
	assert_int_equal(e.position.navigation.levelling, m.position.navigation.levelling);
	for (int i = 0; i < 9; i++) {
		assert_equal(e.calibration.gyro.matrix[i / 3][i % 3], m.calibration.gyro.matrix[i / 3][i % 3]);
		assert_equal(e.calibration.accel.matrix[i / 3][i % 3], m.calibration.accel.matrix[i / 3][i % 3]);
		assert_equal(e.calibration.mag.matrix[i / 3][i % 3], m.calibration.mag.matrix[i / 3][i % 3]);
	}
}

/* ---- samples to PDOs --------------------------------------------------------------------------------------------- */

static void test_a_pdo_carries_what_the_pipeline_computes(void **state)
{
	struct world *w = *state;
	struct pipeline pipeline;
	struct pipeline_output out;
	struct pipeline_config settings = settings_pipeline(&w->device.values);
	struct sensor twin = w->sensor;
	struct imu_sample s;

	assert_int_equal(pipeline_init(&pipeline, &settings, 100), 0);
	world_nmt(w, 1);
	for (int k = 0; k < 300; k++) {
		world_sample(w);
		sensor_next(&twin, w->signal, &s, NULL);
		assert_int_equal(pipeline_step(&pipeline, &s, &out), 0);
		sync(w);
		const uint8_t *acceleration = world_last(w, 0x180 + WORLD_NODE_ID)->data,
			      *angles = world_last(w, 0x280 + WORLD_NODE_ID)->data;
		assert_near(i16(acceleration) * 0.005, out.accel_b_m_s2.x, 0.00251);
		assert_near(i16(acceleration + 2) * 0.005, out.accel_b_m_s2.y, 0.00251);
		assert_near(i16(acceleration + 4) * 0.005, out.accel_b_m_s2.z, 0.00251);
		assert_near(i16(angles) * 0.01, out.angles_rad.x * 57.29577951, 0.00501);
		assert_int_equal(i16(acceleration + 6), k);
	}
}

static void test_the_pdos_of_one_sync_carry_the_same_sample(void **state)
{
	struct world *w = *state;

	world_nmt(w, 1);
	world_samples(w, 5);
	sync(w);
	world_sample(w);
	assert_int_equal(i16(world_last(w, 0x180 + WORLD_NODE_ID)->data + 6), 4);
	assert_int_equal(i16(world_last(w, 0x280 + WORLD_NODE_ID)->data + 6), 4);
	assert_int_equal(i16(world_last(w, 0x380 + WORLD_NODE_ID)->data + 6), 4);
	assert_int_equal(i16(world_last(w, 0x480 + WORLD_NODE_ID)->data + 2), 4);
}

static void test_the_counter_of_the_first_sample_is_zero(void **state)
{
	struct world *w = *state;

	world_nmt(w, 1);
	world_sample(w);
	sync(w);
	assert_int_equal(i16(world_last(w, 0x180 + WORLD_NODE_ID)->data + 6), 0);
}

/* ---- configuration, live ----------------------------------------------------------------------------------------- */

static struct vec3 real32(float x, float y, float z)
{
	return (struct vec3){(double)x, (double)y, (double)z};
}

static void test_a_lever_arm_written_by_sdo_takes_effect_in_the_next_sample(void **state)
{
	struct world *w = *state, *untouched = new_world();
	const struct vec3 r = {0.05, -0.1, 0.2};

	world_samples(w, 123);
	world_samples(untouched, 123);
	write_lever_arm(w, (float)r.x, (float)r.y, (float)r.z);
	world_samples(w, 1);
	world_samples(untouched, 1);

	const struct od_values *with = &w->device.values, *without = &untouched->device.values;
	struct vec3 omega = real32(without->angular_rate.l, without->angular_rate.s, without->angular_rate.t);
	struct vec3 alpha = real32(
		without->angular_acceleration.l, without->angular_acceleration.s, without->angular_acceleration.t);
	struct vec3 term = vec3_add(vec3_cross(alpha, r), vec3_cross(omega, vec3_cross(omega, r)));
	assert_true(vec3_norm(term) > 0.5); /* large enough to matter */
	assert_near((without->acceleration.l - with->acceleration.l) * 0.005, term.x, 0.00501);
	assert_near((without->acceleration.s - with->acceleration.s) * 0.005, term.y, 0.00501);
	assert_near((without->acceleration.t - with->acceleration.t) * 0.005, term.z, 0.00501);
	free(untouched);
}

static void test_a_write_does_not_change_the_present_sample(void **state)
{
	struct world *w = *state;

	world_samples(w, 50);
	int16_t before = w->device.values.acceleration.l;
	write_lever_arm(w, 5, 5, 5);
	assert_int_equal(w->device.values.acceleration.l, before);
	world_sample(w);
	assert_int_not_equal(w->device.values.acceleration.l, before);
}

static void test_the_reset_command_sets_the_position_to_zero(void **state)
{
	struct world *w = *state;

	world_samples(w, 400);
	assert_true(fabs((double)w->device.values.position_m.x) > 1e-3);
	assert_int_equal(world_sdo_write(w, 0x2040, 6, (const uint8_t[]){1}, 1), 0);
	world_sample(w);
	assert_true(fabs((double)w->device.values.position_m.x) < 1e-3);
	assert_int_equal(world_sdo_write(w, 0x2040, 6, (const uint8_t[]){2}, 1), 0x06090031);
}

static void test_the_angle_resolution_accepts_only_the_steps_of_cia_410(void **state)
{
	struct world *w = *state;

	assert_int_equal(world_sdo_write(w, 0x6000, 0, (const uint8_t[]){100, 0}, 2), 0);
	assert_int_equal(world_sdo_write(w, 0x6000, 0, (const uint8_t[]){50, 0}, 2), 0x06090030);
	assert_int_equal(w->device.values.angle_resolution, 100);
}

static void test_a_singular_calibration_is_not_used_and_raises_6320h_until_it_is_corrected(void **state)
{
	struct world *w = *state;
	const float zero = 0, one = 1;

	world_samples(w, 10);
	assert_int_equal(world_sdo_write(w, 0x2051, 4, &zero, 4), 0); /* xx of the accelerometer */
	world_sample(w);
	assert_int_equal(world_emcy_code(w), EMCY_CONFIGURATION);
	assert_true(fabs((double)w->device.values.specific_force.l) + fabs((double)w->device.values.specific_force.s) +
			    fabs((double)w->device.values.specific_force.t) >
		    5);
	assert_int_equal(world_sdo_write(w, 0x2051, 4, &one, 4), 0);
	world_sample(w);
	assert_int_equal(world_emcy_code(w), 0);
}

static void test_a_position_sigma_above_2040h_9_raises_ff10h_until_it_is_below(void **state)
{
	struct world *w = *state;
	const float limit = 1e-6f, none = 0;

	world_samples(w, 200);
	assert_int_equal(world_sdo_write(w, 0x2040, 9, &limit, 4), 0);
	world_samples(w, 10);
	assert_int_equal(world_emcy_code(w), EMCY_POSITION_UNSURE);
	assert_true(w->device.values.sample.status & PIPELINE_UNSURE);
	assert_int_equal(world_sdo_write(w, 0x2040, 9, &none, 4), 0);
	world_sample(w);
	assert_int_equal(world_emcy_code(w), 0);
	assert_false(w->device.values.sample.status & PIPELINE_UNSURE);
}

static void test_a_slope_beyond_2119h_raises_5010h_until_it_is_within(void **state)
{
	struct world *w = *state;
	const float range = 0.01f, none = 0;

	world_samples(w, 200);
	assert_int_equal(world_sdo_write(w, 0x2119, 1, &range, 4), 0);
	world_samples(w, 10);
	assert_int_equal(world_emcy_code(w), EMCY_SLOPE_LONG);
	assert_int_equal(world_sdo_write(w, 0x2119, 1, &none, 4), 0);
	world_sample(w);
	assert_int_equal(world_emcy_code(w), 0);
}

static void test_inconsistent_stored_values_do_not_keep_the_device_from_starting(void **state)
{
	struct world *w = *state;
	const float zero = 0;

	assert_int_equal(world_sdo_write(w, 0x2051, 4, &zero, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x1010, 1, "save", 4), 0);
	world_power_on(w, NULL);
	world_sample(w);
	assert_int_equal(world_emcy_code(w), EMCY_CONFIGURATION);
	assert_int_equal(w->device.values.sample.status & PIPELINE_VALID, PIPELINE_VALID);
}

/* ---- storage ----------------------------------------------------------------------------------------------------- */

static uint32_t store_all(struct world *w)
{
	return world_sdo_write(w, 0x1010, 1, "save", 4);
}

static void test_stored_values_survive_a_power_cycle(void **state)
{
	struct world *w = *state;
	const uint16_t heartbeat = 250;

	write_lever_arm(w, 0.5f, 0, 0);
	assert_int_equal(world_sdo_write(w, 0x1017, 0, &heartbeat, 2), 0);
	assert_int_equal(store_all(w), 0);
	write_lever_arm(w, 0.7f, 0, 0); /* not stored */
	world_power_on(w, NULL);
	assert_near(w->device.values.lever_arm.l, 0.5, 1e-7);
	assert_int_equal(w->device.values.producer_heartbeat_time, 250);
}

static void test_stored_values_override_the_file_and_the_file_the_defaults(void **state)
{
	static const char *const file[] = {"lever_arm.l=1", "lever_arm.s=2", NULL};
	struct world *w = *state;

	world_power_on(w, file);
	write_lever_arm(w, 3, 2, 0);
	assert_int_equal(store_all(w), 0);
	world_power_on(w, file);
	assert_near(w->device.values.lever_arm.l, 3, 1e-7);
	assert_near(w->device.values.lever_arm.s, 2, 1e-7);
	assert_near(w->device.values.lever_arm.t, 0, 1e-7);
}

static void test_a_stored_default_overrides_the_file_too(void **state)
{
	static const char *const file[] = {"lever_arm.l=1", NULL};
	struct world *w = *state;

	world_power_on(w, file);
	write_lever_arm(w, 0, 0, 0);
	assert_int_equal(store_all(w), 0);
	world_power_on(w, file);
	assert_near(w->device.values.lever_arm.l, 0, 1e-7);
}

static void test_restore_brings_back_the_values_of_the_file_at_the_next_reset(void **state)
{
	struct world *w = *state;

	write_lever_arm(w, 3, 0, 0);
	assert_int_equal(store_all(w), 0);
	assert_int_equal(world_sdo_write(w, 0x1011, 1, "load", 4), 0);
	assert_near(w->device.values.lever_arm.l, 3, 1e-7);
	world_nmt(w, 129);
	assert_near(w->device.values.lever_arm.l, 0, 1e-7);
	world_power_on(w, NULL);
	assert_near(w->device.values.lever_arm.l, 0, 1e-7);
}

static void test_a_group_is_stored_alone(void **state)
{
	struct world *w = *state;
	const uint16_t heartbeat = 250;

	write_lever_arm(w, 3, 0, 0);
	assert_int_equal(world_sdo_write(w, 0x1017, 0, &heartbeat, 2), 0);
	assert_int_equal(world_sdo_write(w, 0x1010, 2, "save", 4), 0);
	world_power_on(w, NULL);
	assert_near(w->device.values.lever_arm.l, 0, 1e-7);
	assert_int_equal(w->device.values.producer_heartbeat_time, 250);
}

static void test_a_preset_of_the_inclinometer_survives_a_power_cycle(void **state)
{
	struct world *w = *state;
	const int16_t preset = 1000;

	world_samples(w, 50);
	assert_int_equal(world_sdo_write(w, 0x6011, 0, (const uint8_t[]){2}, 1), 0); /* offsets on */
	assert_int_equal(world_sdo_write(w, 0x6012, 0, &preset, 2), 0);
	int16_t offset = w->device.values.slope_long16_offset;
	assert_int_not_equal(offset, 0);
	assert_int_equal(store_all(w), 0);
	world_power_on(w, NULL);
	assert_int_equal(w->device.values.slope_long16_offset, offset);
}

static void lss_give_node_id(struct world *w, uint8_t node_id)
{
	world_receive(w, 0x7E5, 8, (const uint8_t[8]){0x04, 1}); /* configuration */
	world_receive(w, 0x7E5, 8, (const uint8_t[8]){0x11, node_id});
	world_receive(w, 0x7E5, 8, (const uint8_t[8]){0x04, 0}); /* waiting */
}

static void test_cob_ids_of_a_node_id_assigned_by_lss_are_not_stored_as_configured(void **state)
{
	struct world *w = *state;

	lss_give_node_id(w, 5);
	world_nmt(w, 130);
	assert_int_equal(w->device.values.tpdo1_communication.cob_id & 0x7FF, 0x185);
	world_receive(w, 0x605, 8, (const uint8_t[8]){0x23, 0x10, 0x10, 1, 's', 'a', 'v', 'e'});
	assert_int_equal(world_last(w, 0x585)->data[0], 0x60);
	world_power_on(w, NULL); /* with node-ID 16: LSS has not stored node-ID 5 */
	assert_int_equal(w->device.values.tpdo1_communication.cob_id & 0x7FF, 0x190);
}

static void test_cob_ids_follow_a_node_id_that_lss_removed_and_assigned_again(void **state)
{
	struct world *w = *state;

	lss_give_node_id(w, 5);
	world_nmt(w, 130);
	lss_give_node_id(w, 255);
	world_receive(w, 0x000, 2, (const uint8_t[]){130, 5});
	lss_give_node_id(w, 7);
	world_seconds(w, 0.1);
	assert_non_null(world_last(w, 0x707));
	assert_int_equal(w->device.values.tpdo1_communication.cob_id & 0x7FF, 0x187);
}

static void lss_store_node_id(struct world *w, uint8_t node_id)
{
	world_receive(w, 0x7E5, 8, (const uint8_t[8]){0x04, 1});
	world_receive(w, 0x7E5, 8, (const uint8_t[8]){0x11, node_id});
	world_receive(w, 0x7E5, 8, (const uint8_t[8]){0x17});
}

static void assert_lss_stored(const struct world *w, uint8_t error)
{
	const struct can_msg *answer = world_last(w, 0x7E4);

	assert_non_null(answer);
	assert_int_equal(answer->data[0], 0x17);
	assert_int_equal(answer->data[1], error);
}

static void test_a_node_id_stored_by_lss_is_used_after_a_power_cycle_with_its_cob_ids(void **state)
{
	struct world *w = *state;

	lss_store_node_id(w, 5);
	assert_lss_stored(w, 0);
	world_power_on(w, NULL);
	assert_non_null(world_last(w, 0x705));
	assert_int_equal(w->device.values.tpdo1_communication.cob_id & 0x7FF, 0x185);
}

static void test_a_node_that_lss_stored_as_unconfigured_is_silent_after_a_power_cycle(void **state)
{
	struct world *w = *state;

	lss_store_node_id(w, 255);
	world_power_on(w, NULL);
	w->frame_count = 0;
	world_samples(w, 100);
	assert_int_equal(w->frame_count, 0);
	world_receive(w, 0x7E5, 8, (const uint8_t[8]){0x4C});
	assert_int_equal(world_last(w, 0x7E4)->data[0], 0x50);
}

static void test_restoring_the_defaults_keeps_what_lss_stored(void **state)
{
	struct world *w = *state;

	lss_store_node_id(w, 5);
	assert_int_equal(world_sdo_write(w, 0x1011, 1, "load", 4), 0);
	assert_int_equal(w->disk.lss.node_id, 5);
}

static void test_storing_by_lss_keeps_what_1010h_stored_and_vice_versa(void **state)
{
	struct world *w = *state;

	write_lever_arm(w, 1, 2, 3);
	assert_int_equal(world_sdo_write(w, 0x1010, 1, "save", 4), 0);
	lss_store_node_id(w, 5);
	assert_int_equal(world_sdo_write(w, 0x1010, 1, "save", 4), 0);
	world_power_on(w, NULL);
	assert_near(w->device.values.lever_arm.l, 1, 0);
	assert_non_null(world_last(w, 0x705));
}

static void test_lss_answers_a_store_only_when_a_slow_disk_has_finished(void **state)
{
	struct world *w = *state;

	w->disk_answer = -EINPROGRESS;
	lss_store_node_id(w, 5);
	world_samples(w, 100);
	assert_int_equal(world_last(w, 0x7E4)->data[0], 0x11);
	device_saved(&w->device, 0, w->now_us);
	assert_lss_stored(w, 0);
}

static void test_a_failed_disk_is_answered_to_lss(void **state)
{
	struct world *w = *state;

	w->disk_answer = -EIO;
	lss_store_node_id(w, 5);
	assert_lss_stored(w, 2);
	world_power_on(w, NULL);
	assert_non_null(world_last(w, 0x700 + WORLD_NODE_ID));
}

static void test_lss_stores_the_bit_rate_that_it_has_set_or_the_one_from_before(void **state)
{
	struct world *w = *state;

	write_lever_arm(w, 3, 0, 0);
	assert_int_equal(store_all(w), 0);
	world_power_on(w, NULL);
	assert_int_equal(storing_store_lss(&w->device.storing, 5, 250000), OD_OK);
	assert_int_equal(w->disk.lss.node_id, 5);
	assert_int_equal(w->disk.lss.bit_s, 250000);
	assert_int_equal(storing_store_lss(&w->device.storing, 6, 0), OD_OK);
	assert_int_equal(w->disk.lss.node_id, 6);
	assert_int_equal(w->disk.lss.bit_s, 250000);
	world_power_on(w, NULL);
	assert_near(w->device.values.lever_arm.l, 3, 0);
}

static void test_lss_does_not_store_while_1010h_does(void **state)
{
	struct world *w = *state;

	w->disk_answer = -EINPROGRESS;
	world_receive(w, 0x600 + WORLD_NODE_ID, 8, (const uint8_t[8]){0x23, 0x10, 0x10, 1, 's', 'a', 'v', 'e'});
	lss_store_node_id(w, 5);
	assert_lss_stored(w, 2);
	device_saved(&w->device, 0, w->now_us);
	assert_int_equal(world_last(w, 0x580 + WORLD_NODE_ID)->data[0], 0x60);
}

static uint32_t write_um(struct world *w, uint8_t sub, int32_t um)
{
	return world_sdo_write(w, 0x2004, sub, &um, 4);
}

static void test_the_lever_arm_in_micrometres_is_the_one_in_metres(void **state)
{
	struct world *w = *state;

	assert_int_equal(write_um(w, 1, 50000), 0);
	assert_int_equal(write_um(w, 3, -1), 0);
	assert_true(w->device.values.lever_arm.l == 0.05f);
	assert_true(w->device.values.lever_arm.t == -1e-6f);
	world_sample(w);
	assert_near(w->device.pipeline.config.estimator.lever_arm_b_m.x, 0.05, 1e-9);
	write_lever_arm(w, 0.1f, -9.999999f, 0.0000014f);
	assert_int_equal(w->device.values.lever_arm_in_um.l, 100000);
	assert_int_equal(w->device.values.lever_arm_in_um.s, -9999999);
	assert_int_equal(w->device.values.lever_arm_in_um.t, 1);
	assert_int_equal(write_um(w, 2, 10000001), 0x06090031);
	assert_int_equal(w->device.values.lever_arm_in_um.s, -9999999);
}

static void test_every_micrometre_is_read_back_as_written(void **state)
{
	struct world *w = *state;

	for (int32_t um = -10000000; um <= 10000000; um += 9973) {
		assert_int_equal(write_um(w, 2, um), 0);
		assert_int_equal(w->device.values.lever_arm_in_um.s, um);
	}
}

static void test_the_lever_arm_in_micrometres_follows_reset_and_store(void **state)
{
	struct world *w = *state;

	assert_int_equal(write_um(w, 1, 123456), 0);
	assert_int_equal(store_all(w), 0);
	assert_int_equal(write_um(w, 1, 7), 0);
	world_nmt(w, 129);
	assert_int_equal(w->device.values.lever_arm_in_um.l, 123456);
	world_power_on(w, NULL);
	assert_int_equal(w->device.values.lever_arm_in_um.l, 123456);
	assert_near(w->device.values.lever_arm.l, 0.123456, 1e-8);
}

static void test_the_status_shows_that_2117h_is_utc(void **state)
{
	struct world *w = *state;

	world_sample(w);
	assert_int_equal(w->device.values.sample.status & 1 << 13, 0);
	device_host_clock(&w->device, true, INT64_C(1795953600000000));
	world_sample(w);
	assert_int_equal(w->device.values.sample.status & 1 << 13, 1 << 13);
	assert_int_equal(w->device.values.utc.day, 15673);
}

static void test_a_failed_disk_is_answered_by_an_abort_and_the_old_values_stay_stored(void **state)
{
	struct world *w = *state;

	write_lever_arm(w, 3, 0, 0);
	assert_int_equal(store_all(w), 0);
	write_lever_arm(w, 4, 0, 0);
	w->disk_answer = -ENOSPC;
	assert_int_equal(store_all(w), 0x08000020);
	world_power_on(w, NULL);
	assert_near(w->device.values.lever_arm.l, 3, 1e-7);
}

/* The folder of the file could not be synced (store_write()). */
static void test_values_that_may_not_survive_a_power_cut_are_an_error_but_count_as_stored(void **state)
{
	struct world *w = *state;
	static uint8_t bytes[STORE_FILE_MAX];

	write_lever_arm(w, 3, 0, 0);
	w->disk_answer = -EINPROGRESS;
	world_receive(w, 0x600 + WORLD_NODE_ID, 8, (const uint8_t[8]){0x23, 0x10, 0x10, 1, 's', 'a', 'v', 'e'});
	assert_int_equal(store_decode(&w->disk, bytes, store_encode(&w->device.storing.saving, bytes)), 0);
	device_saved(&w->device, EIO, w->now_us);
	assert_memory_equal(
		world_last(w, 0x580 + WORLD_NODE_ID)->data, ((const uint8_t[]){0x80, 0x10, 0x10, 1, 0x20, 0, 0, 8}), 8);
	w->disk_answer = 0;
	lss_store_node_id(w, 5); /* keeps what the file has */
	world_power_on(w, NULL);
	assert_near(w->device.values.lever_arm.l, 3, 0);
}

static void test_a_device_without_storage_stores_nothing_and_says_so(void **state)
{
	struct world *w = *state;

	w->device = (struct device){0};
	od_init(&w->device.od, &imu9_od_table, &w->device.values, WORLD_NODE_ID);
	assert_int_equal(device_init(&w->device, &w->bus, &w->imu, NULL, NULL, WORLD_NODE_ID), 0);
	device_start(&w->device, false, w->now_us);
	world_samples(w, 2);
	assert_int_equal(store_all(w), 0x08000020);
	assert_int_equal(world_sdo_write(w, 0x1011, 1, "load", 4), 0x08000020);
	assert_int_equal(world_emcy_code(w), 0);
}

/* The process has kept the file as .bad. */
static void test_damaged_stored_values_raise_5530h_at_the_start(void **state)
{
	struct world *w = *state;

	assert_int_equal(world_emcy_code(w), 0);
	w->device = (struct device){0};
	od_init(&w->device.od, &imu9_od_table, &w->device.values, WORLD_NODE_ID);
	assert_int_equal(device_init(&w->device, &w->bus, &w->imu, NULL, NULL, WORLD_NODE_ID), 0);
	device_start(&w->device, true, w->now_us);
	world_samples(w, 2);
	assert_int_equal(world_emcy_code(w), 0x5530);
	assert_int_equal(w->device.values.error_register, 0x81);
}

/* Without stored values there are none to go back to. */
static void test_an_inconsistent_configuration_file_keeps_the_device_from_starting(void **state)
{
	struct world *w = *state;

	w->device = (struct device){0};
	od_init(&w->device.od, &imu9_od_table, &w->device.values, WORLD_NODE_ID);
	w->device.values.gyro_calibration.xx = 0; /* a matrix without an inverse */
	w->device.values.gyro_calibration.xy = 0;
	w->device.values.gyro_calibration.xz = 0;
	assert_int_equal(device_init(&w->device, &w->bus, &w->imu, NULL, NULL, WORLD_NODE_ID), -EINVAL);
}

static void test_a_node_id_that_is_none_is_refused_at_the_start(void **state)
{
	static const uint8_t none[] = {0, 128, 254};
	struct world *w = *state;

	for (size_t i = 0; i < sizeof(none); i++) {
		w->device = (struct device){0};
		od_init(&w->device.od, &imu9_od_table, &w->device.values, none[i]);
		assert_int_equal(device_init(&w->device, &w->bus, &w->imu, NULL, NULL, none[i]), -EINVAL);
	}
}

static void test_a_slow_disk_delays_the_answer_and_not_the_samples(void **state)
{
	struct world *w = *state;
	const uint8_t request[8] = {0x23, 0x10, 0x10, 1, 's', 'a', 'v', 'e'};

	w->disk_answer = -EINPROGRESS;
	size_t sent = w->frame_count;
	world_receive(w, 0x600 + WORLD_NODE_ID, 8, request);
	world_samples(w, 20);
	for (size_t i = sent; i < w->frame_count; i++)
		assert_int_not_equal(w->frames[i % WORLD_FRAMES].id, 0x580 + WORLD_NODE_ID);
	device_saved(&w->device, 0, w->now_us);
	assert_int_equal(world_last(w, 0x580 + WORLD_NODE_ID)->data[0], 0x60);
}

static void test_a_second_store_during_a_store_is_refused(void **state)
{
	struct world *w = *state;
	const uint8_t request[8] = {0x23, 0x10, 0x10, 1, 's', 'a', 'v', 'e'};

	w->disk_answer = -EINPROGRESS;
	world_receive(w, 0x600 + WORLD_NODE_ID, 8, request);
	assert_int_equal(store_all(w), 0x08000022);
	device_saved(&w->device, 0, w->now_us);
	w->disk_answer = 0;
	assert_int_equal(store_all(w), 0);
}

static void test_reset_communication_does_not_change_the_application(void **state)
{
	struct world *w = *state;
	const uint16_t heartbeat = 250;

	write_lever_arm(w, 3, 0, 0);
	assert_int_equal(world_sdo_write(w, 0x1017, 0, &heartbeat, 2), 0);
	world_nmt(w, 130);
	assert_near(w->device.values.lever_arm.l, 3, 1e-7);
	assert_int_equal(w->device.values.producer_heartbeat_time, 1000);
}

static void test_reset_communication_brings_back_what_was_stored_and_not_the_defaults(void **state)
{
	struct world *w = *state;
	const uint16_t stored = 250, later = 50;
	const uint32_t cob_id = 0x1A1, invalid = 0x80000000u | 0x1A1;

	assert_int_equal(world_sdo_write(w, 0x1017, 0, &stored, 2), 0);
	assert_int_equal(world_sdo_write(w, 0x1800, 1, &invalid, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x1800, 1, &cob_id, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x1010, 2, "save", 4), 0);
	assert_int_equal(world_sdo_write(w, 0x1017, 0, &later, 2), 0);
	assert_int_equal(world_sdo_write(w, 0x1800, 1, &invalid, 4), 0);
	world_nmt(w, 130);
	assert_int_equal(w->device.values.producer_heartbeat_time, stored);
	assert_int_equal(w->device.values.tpdo1_communication.cob_id, cob_id);
	world_nmt(w, 1);
	sync(w);
	assert_non_null(world_last(w, cob_id));
	assert_null(world_last(w, 0x180 + WORLD_NODE_ID));
}

static void test_reset_node_restarts_the_application(void **state)
{
	struct world *w = *state;

	world_samples(w, 400);
	assert_true(fabs((double)w->device.values.position_m.x) > 1e-3);
	world_nmt(w, 129);
	world_sample(w);
	assert_true(fabs((double)w->device.values.position_m.x) < 1e-3);
}

/* ---- values stored by an earlier version ------------------------------------------------------------------------- */

/* Files as 0.1 and 0.2 wrote them: lever_arm.l = 0.25 and 2030h:12 = 0.0018, which was a delay in s. The CRC by
 * python's zlib. */
static const uint8_t stored_by_0_1[] = {0x49, 0x4D, 0x55, 0x39, 0x53, 0x54, 0x4F, 0x52, 0x01, 0x00, 0x00, 0x00, 0x26,
	0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x1A, 0x00, 0x00, 0x00, 0x02, 0x00, 0x00,
	0x00, 0x00, 0x20, 0x01, 0x04, 0x00, 0x00, 0x00, 0x00, 0x00, 0x80, 0x3E, 0x30, 0x20, 0x0C, 0x04, 0x00, 0x00,
	0x00, 0xFA, 0xED, 0xEB, 0x3A, 0x76, 0xD2, 0x91, 0x40};
static const uint8_t stored_by_0_2[] = {0x49, 0x4D, 0x55, 0x39, 0x53, 0x54, 0x4F, 0x52, 0x02, 0x00, 0x00, 0x00, 0x2E,
	0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x1A, 0x00, 0x00, 0x00, 0x02, 0x00, 0x00,
	0x00, 0x00, 0x20, 0x01, 0x04, 0x00, 0x00, 0x00, 0x00, 0x00, 0x80, 0x3E, 0x30, 0x20, 0x0C, 0x04, 0x00, 0x00,
	0x00, 0xFA, 0xED, 0xEB, 0x3A, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x69, 0xE8, 0xC8, 0x45};

static const char gyro_scale_left_out[] = "stored fusion.gyro_scale_sigma (2030h:12) not applied: it was a delay, "
					  "which is 2031h now; set both, then store again (1010h)\n";

static bool event_log_has(const struct world *w, const char *line)
{
	return memmem(w->device.log.text, w->device.log.used, line, strlen(line)) != NULL;
}

static void power_on_with(struct world *w, const uint8_t *file, size_t size)
{
	assert_int_equal(store_decode(&w->disk, file, size), 0);
	world_power_on(w, NULL);
}

static void test_a_stored_value_whose_meaning_changed_is_not_applied_and_the_log_names_it(void **state)
{
	static const struct {
		const uint8_t *file;
		size_t size;
	} FILES[] = {{stored_by_0_1, sizeof(stored_by_0_1)}, {stored_by_0_2, sizeof(stored_by_0_2)}};
	struct world *w = *state;

	for (size_t i = 0; i < 2; i++) {
		power_on_with(w, FILES[i].file, FILES[i].size);
		assert_near(w->device.values.lever_arm.l, 0.25, 1e-7);
		assert_near(w->device.values.fusion.gyro_scale_sigma, 0.002, 1e-7); /* the default */
		assert_true(event_log_has(w, gyro_scale_left_out));
	}
}

static void test_stored_values_that_are_unknown_or_out_of_range_are_counted_and_the_others_applied(void **state)
{
	static const uint8_t quarter[] = {0, 0, 0x80, 0x3E}, large[] = {0, 0, 0x80, 0x7E};
	const struct od_dcf_item communication[] = {{0x1017, 0, quarter, 2}, {0x1FFF, 0, quarter, 4}},
				 manufacturer[] = {{0x2000, 1, quarter, 4}, {0x2000, 2, large, 4}};
	struct world *w = *state;

	for (size_t i = 0; i < 2; i++) {
		od_dcf_add(w->disk.groups[0].dcf, STORE_GROUP_MAX, &w->disk.groups[0].size, &communication[i]);
		od_dcf_add(w->disk.groups[2].dcf, STORE_GROUP_MAX, &w->disk.groups[2].size, &manufacturer[i]);
	}
	world_power_on(w, NULL);
	assert_int_equal(w->device.values.producer_heartbeat_time, 0);
	assert_near(w->device.values.lever_arm.l, 0.25, 0);
	assert_near(w->device.values.lever_arm.s, 0, 0);
	assert_true(event_log_has(w, " 2 stored values not applied: unknown or out of range in this version; "
				     "store again (1010h)\n"));
}

static void test_storing_another_group_does_not_restore_the_value_of_the_old_meaning(void **state)
{
	struct world *w = *state;
	const uint32_t save = 0x65766173;

	power_on_with(w, stored_by_0_2, sizeof(stored_by_0_2));
	assert_int_equal(world_sdo_write(w, 0x1010, 2, &save, 4), 0);
	world_power_on(w, NULL);
	assert_near(w->device.values.lever_arm.l, 0.25, 1e-7);
	assert_near(w->device.values.fusion.gyro_scale_sigma, 0.002, 1e-7);
	assert_false(event_log_has(w, gyro_scale_left_out));
}

static void test_a_value_stored_with_the_present_meaning_is_applied(void **state)
{
	struct world *w = *state;
	const float sigma = 0.01f;

	power_on_with(w, stored_by_0_2, sizeof(stored_by_0_2));
	assert_int_equal(world_sdo_write(w, 0x2030, 12, &sigma, 4), 0);
	assert_int_equal(store_all(w), 0);
	assert_int_equal(w->disk.revision, w->device.values.identity.revision_number);
	world_power_on(w, NULL);
	assert_near(w->device.values.fusion.gyro_scale_sigma, 0.01, 1e-7);
	assert_false(event_log_has(w, gyro_scale_left_out));
}

/* ---- faults ------------------------------------------------------------------------------------------------------ */

static void test_missing_samples_raise_5030h_within_100_ms_and_the_next_sample_clears_it(void **state)
{
	struct world *w = *state;

	world_samples(w, 10);
	uint64_t deadline = device_tick(&w->device, w->now_us);
	assert_true(deadline <= w->now_us + 100000);
	w->now_us += 100000;
	device_tick(&w->device, w->now_us);
	assert_int_equal(world_emcy_code(w), EMCY_SENSOR_LOST);
	assert_int_equal(w->device.values.error_register, 0x81);
	assert_int_equal(w->device.values.sample.status & (PIPELINE_VALID | STATUS_SENSOR_LOST), STATUS_SENSOR_LOST);
	world_sample(w);
	assert_int_equal(world_emcy_code(w), 0);
	assert_int_equal(w->device.values.error_register, 0);
	assert_int_equal(w->device.values.sample.status & (PIPELINE_VALID | STATUS_SENSOR_LOST), PIPELINE_VALID);
}

static void test_while_the_process_is_not_scheduled_the_sensor_does_not_time_out(void **state)
{
	struct world *w = *state;

	world_samples(w, 10);
	w->now_us += 40000;
	device_tick(&w->device, w->now_us);
	w->now_us += 500000;
	device_away(&w->device, 500000, w->now_us);
	device_tick(&w->device, w->now_us);
	assert_int_equal(world_emcy_code(w), 0);
	w->now_us += 59999;
	device_tick(&w->device, w->now_us);
	assert_int_equal(world_emcy_code(w), 0);
	w->now_us += 1;
	device_tick(&w->device, w->now_us);
	assert_int_equal(world_emcy_code(w), EMCY_SENSOR_LOST);
}

static void test_the_end_of_a_log_raises_5030h_at_once(void **state)
{
	struct world *w = *state;

	world_samples(w, 10);
	device_sample(&w->device, -ENODATA, NULL, w->now_us);
	assert_int_equal(world_emcy_code(w), EMCY_SENSOR_LOST);
}

static void test_error_passive_raises_8120h_and_lost_frames_8110h(void **state)
{
	struct world *w = *state;

	w->bus.state = CAN_STATE_PASSIVE;
	world_sample(w);
	assert_int_equal(world_emcy_code(w), EMCY_ERROR_PASSIVE);
	w->bus.state = CAN_STATE_ACTIVE;
	world_sample(w);
	assert_int_equal(world_emcy_code(w), 0);
	w->bus.counters.tx_dropped += 3;
	world_sample(w);
	assert_int_equal(world_emcy_code(w), EMCY_CAN_OVERRUN);
	assert_int_equal(w->device.values.bus_counters.tx_dropped, 3);
	world_samples(w, 102); /* one second without another loss */
	assert_int_equal(world_emcy_code(w), 0);
}

static void test_the_recovery_from_bus_off_sends_8140h(void **state)
{
	struct world *w = *state;
	bool reported = false;

	w->bus.state = CAN_STATE_BUS_OFF;
	world_sample(w);
	size_t from = w->frame_count;
	w->bus.state = CAN_STATE_ACTIVE;
	world_sample(w);
	for (size_t i = from; i < w->frame_count; i++)
		reported |= w->frames[i % WORLD_FRAMES].id == 0x080 + WORLD_NODE_ID &&
			    i16(w->frames[i % WORLD_FRAMES].data) == (int16_t)EMCY_BUS_OFF_OVER;
	assert_true(reported);
}

static void test_bus_off_leaves_operational(void **state)
{
	struct world *w = *state;

	world_nmt(w, 1);
	w->bus.state = CAN_STATE_BUS_OFF;
	world_sample(w);
	assert_int_equal(canopen_nmt_state(&w->device.canopen), NMT_PRE_OPERATIONAL);
}

static void test_an_hour_of_syncs_gets_every_pdo(void **state)
{
	struct world *w = *state;

	world_nmt(w, 1);
	size_t before = w->frame_count;
	for (int k = 0; k < 360000; k++) {
		world_sample(w);
		sync(w);
	}
	/* four PDOs for each SYNC, one heartbeat a second */
	assert_int_equal(w->frame_count - before, 4 * 360000 + 3600);
	assert_int_equal((uint16_t)i16(world_last(w, 0x180 + WORLD_NODE_ID)->data + 6), (360000 - 1) % 65536);
}

#define TEST(f) cmocka_unit_test_setup_teardown(f, set_up, world_tear_down)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_the_defaults_of_the_eds_are_those_of_the_model),
		TEST(test_a_pdo_carries_what_the_pipeline_computes),
		TEST(test_the_pdos_of_one_sync_carry_the_same_sample),
		TEST(test_the_counter_of_the_first_sample_is_zero),
		TEST(test_a_lever_arm_written_by_sdo_takes_effect_in_the_next_sample),
		TEST(test_a_write_does_not_change_the_present_sample),
		TEST(test_the_reset_command_sets_the_position_to_zero),
		TEST(test_the_angle_resolution_accepts_only_the_steps_of_cia_410),
		TEST(test_a_singular_calibration_is_not_used_and_raises_6320h_until_it_is_corrected),
		TEST(test_a_position_sigma_above_2040h_9_raises_ff10h_until_it_is_below),
		TEST(test_a_slope_beyond_2119h_raises_5010h_until_it_is_within),
		TEST(test_inconsistent_stored_values_do_not_keep_the_device_from_starting),
		TEST(test_stored_values_survive_a_power_cycle),
		TEST(test_stored_values_override_the_file_and_the_file_the_defaults),
		TEST(test_a_stored_default_overrides_the_file_too),
		TEST(test_restore_brings_back_the_values_of_the_file_at_the_next_reset),
		TEST(test_a_group_is_stored_alone),
		TEST(test_a_preset_of_the_inclinometer_survives_a_power_cycle),
		TEST(test_cob_ids_of_a_node_id_assigned_by_lss_are_not_stored_as_configured),
		TEST(test_cob_ids_follow_a_node_id_that_lss_removed_and_assigned_again),
		TEST(test_a_node_id_stored_by_lss_is_used_after_a_power_cycle_with_its_cob_ids),
		TEST(test_a_node_that_lss_stored_as_unconfigured_is_silent_after_a_power_cycle),
		TEST(test_restoring_the_defaults_keeps_what_lss_stored),
		TEST(test_storing_by_lss_keeps_what_1010h_stored_and_vice_versa),
		TEST(test_lss_answers_a_store_only_when_a_slow_disk_has_finished),
		TEST(test_a_failed_disk_is_answered_to_lss),
		TEST(test_lss_stores_the_bit_rate_that_it_has_set_or_the_one_from_before),
		TEST(test_lss_does_not_store_while_1010h_does),
		TEST(test_the_lever_arm_in_micrometres_is_the_one_in_metres),
		TEST(test_every_micrometre_is_read_back_as_written),
		TEST(test_the_lever_arm_in_micrometres_follows_reset_and_store),
		TEST(test_the_status_shows_that_2117h_is_utc),
		TEST(test_a_failed_disk_is_answered_by_an_abort_and_the_old_values_stay_stored),
		TEST(test_values_that_may_not_survive_a_power_cut_are_an_error_but_count_as_stored),
		TEST(test_a_device_without_storage_stores_nothing_and_says_so),
		TEST(test_damaged_stored_values_raise_5530h_at_the_start),
		TEST(test_an_inconsistent_configuration_file_keeps_the_device_from_starting),
		TEST(test_a_node_id_that_is_none_is_refused_at_the_start),
		TEST(test_a_slow_disk_delays_the_answer_and_not_the_samples),
		TEST(test_a_second_store_during_a_store_is_refused),
		TEST(test_a_stored_value_whose_meaning_changed_is_not_applied_and_the_log_names_it),
		TEST(test_stored_values_that_are_unknown_or_out_of_range_are_counted_and_the_others_applied),
		TEST(test_storing_another_group_does_not_restore_the_value_of_the_old_meaning),
		TEST(test_a_value_stored_with_the_present_meaning_is_applied),
		TEST(test_reset_communication_does_not_change_the_application),
		TEST(test_reset_communication_brings_back_what_was_stored_and_not_the_defaults),
		TEST(test_reset_node_restarts_the_application),
		TEST(test_missing_samples_raise_5030h_within_100_ms_and_the_next_sample_clears_it),
		TEST(test_while_the_process_is_not_scheduled_the_sensor_does_not_time_out),
		TEST(test_the_end_of_a_log_raises_5030h_at_once),
		TEST(test_error_passive_raises_8120h_and_lost_frames_8110h),
		TEST(test_the_recovery_from_bus_off_sends_8140h),
		TEST(test_bus_off_leaves_operational),
		TEST(test_an_hour_of_syncs_gets_every_pdo),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
