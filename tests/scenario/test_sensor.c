/* Settings and faults of the sensor in the whole device: 2058h, 2124h, 6511h, EMCY 5030h, 5031h, 5032h and 6321h. */
#include <string.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>

#include "tests/scenario/world.h"

struct chip {
	struct world world;
	struct imu_settings configured;
	unsigned configurations, self_tests;
};

static struct chip *of(struct imu_port *port)
{
	return (struct chip *)((char *)port - offsetof(struct chip, world.imu));
}

static int configure(struct imu_port *port, const struct imu_settings *settings, int dry, char *error, size_t size)
{
	struct chip *chip = of(port);

	if (settings->rate_hz > 800) {
		snprintf(error, size, "it goes to 800 Hz, %s",
			"and the reason for that has more than 80 characters, "
			"which is no reason to cut it");
		return -EINVAL;
	}
	if (dry)
		return 0;
	chip->configured = *settings;
	chip->configurations++;
	port->rate_hz = settings->rate_hz;
	return 0;
}

static void self_test(struct imu_port *port)
{
	of(port)->self_tests++;
}

static int set_up(void **state)
{
	static const struct imu_ops imu_ops = {.configure = configure, .self_test = self_test};
	struct chip *chip = calloc(1, sizeof(*chip));

	assert_non_null(chip);
	world_init(&chip->world, sensor_preset("ideal"), 1, "rest");
	chip->world.imu.ops = &imu_ops;
	world_power_on(&chip->world, NULL);
	*state = chip;
	return 0;
}

static void sample_with(struct world *w, unsigned flags, double temperature_degC)
{
	struct imu_sample s;

	sensor_next(&w->sensor, w->signal, &s, NULL);
	s.flags |= flags;
	s.temperature_degC = temperature_degC;
	world_deliver(w, &s);
}

static uint32_t write_sensor(struct world *w, uint8_t sub, const void *value, size_t size)
{
	return world_sdo_write(w, 0x2058, sub, value, size);
}

static const uint8_t *emcy(const struct world *w)
{
	return world_last(w, 0x080 + WORLD_NODE_ID)->data;
}

/* ---- faults ------------------------------------------------------------------------------------------------------ */

static void test_a_fault_of_the_gyro_is_reported_with_kind_and_chip_and_invalidates_the_outputs(void **state)
{
	struct world *w = *state;

	for (int i = 0; i < 5; i++)
		world_sample(w);
	w->imu.health.fault = IMU_FAULT_CONFIGURATION;
	w->imu.health.fault_chip = IMU_CHIP_GYRO;
	device_sample(&w->device, -EIO, NULL, w->now_us);
	device_tick(&w->device, w->now_us);
	assert_int_equal(world_emcy_code(w), 0x5030);
	assert_int_equal(emcy(w)[2], 0x81);
	assert_int_equal(emcy(w)[3], IMU_FAULT_CONFIGURATION);
	assert_int_equal(emcy(w)[4], IMU_CHIP_GYRO);
	assert_int_equal(w->device.values.sample.status & (PIPELINE_VALID | STATUS_SENSOR_LOST | STATUS_SENSOR_FAULT),
		STATUS_SENSOR_LOST | STATUS_SENSOR_FAULT);
	assert_int_equal(w->device.values.sensor_state.fault, IMU_FAULT_CONFIGURATION);
	w->imu.health.fault = w->imu.health.fault_chip = 0;
	world_sample(w);
	assert_int_equal(world_emcy_code(w), 0);
	assert_int_equal(w->device.values.sample.status & (PIPELINE_VALID | STATUS_SENSOR_LOST | STATUS_SENSOR_FAULT),
		PIPELINE_VALID);
	assert_int_equal(w->device.values.sensor_state.fault, 0);
}

static void test_a_fault_of_the_magnetometer_is_reported_and_the_outputs_stay_valid(void **state)
{
	struct world *w = *state;

	world_sample(w);
	w->imu.health.degraded = IMU_FAULT_FROZEN;
	w->imu.health.degraded_chip = IMU_CHIP_MAG;
	world_sample(w);
	assert_int_equal(world_emcy_code(w), 0x5031);
	assert_int_equal(emcy(w)[3], IMU_FAULT_FROZEN);
	assert_int_equal(emcy(w)[4], IMU_CHIP_MAG);
	world_sample(w);
	assert_true(w->device.values.sample.status & PIPELINE_VALID);
	assert_true(w->device.values.sample.status & STATUS_SENSOR_FAULT);
	assert_int_equal(world_count(w, 0x080 + WORLD_NODE_ID), 1);
	w->imu.health.degraded = w->imu.health.degraded_chip = 0;
	world_sample(w);
	assert_int_equal(world_emcy_code(w), 0);
}

/* The rates are those of the attitude, which follows an accelerometer that was hit, for two samples: one would be a
 * glitch. The gyro measured no turn. */
static void test_an_output_beyond_what_was_measured_is_not_published_and_raises_5032h_until_a_second_without(
	void **state)
{
	struct world *w = *state;
	const uint8_t from_angles = 1, madgwick = 0;
	const float beta = 10;
	struct imu_sample s;

	assert_int_equal(world_sdo_write(w, 0x2002, 0, &from_angles, 1), 0);
	assert_int_equal(world_sdo_write(w, OD_INDEX_FUSION, OD_SUB_FUSION_ALGORITHM, &madgwick, 1), 0);
	assert_int_equal(world_sdo_write(w, OD_INDEX_FUSION, OD_SUB_FUSION_MADGWICK_BETA, &beta, 4), 0);
	world_samples(w, 20);
	assert_int_equal(w->device.values.sensor_counters.implausible, 0);
	sensor_next(&w->sensor, w->signal, &s, NULL);
	s.accel_m_s2 = (struct vec3){9.81, 0, 0};
	world_deliver(w, &s);
	sensor_next(&w->sensor, w->signal, &s, NULL);
	s.accel_m_s2 = (struct vec3){9.81, 0, 0};
	world_deliver(w, &s);
	assert_int_equal(world_emcy_code(w), 0x5032);
	assert_int_equal(emcy(w)[2], 0x81);
	assert_false(w->device.values.sample.status & PIPELINE_VALID);
	assert_int_equal(w->device.values.sensor_counters.implausible, 1);
	assert_true(fabs((double)w->device.values.angular_rate.s) < 0.5);
	uint64_t last_us = w->now_us;
	for (uint32_t seen = 1; world_emcy_code(w) != 0; world_sample(w)) {
		if (w->device.values.sensor_counters.implausible != seen)
			last_us = w->now_us;
		seen = w->device.values.sensor_counters.implausible;
		assert_true(w->now_us <= last_us + 1000000);
	}
	assert_int_equal(w->now_us - last_us, 1000000 + w->interval_us);
	assert_true(w->device.values.sample.status & PIPELINE_VALID);
}

static unsigned lines(const struct world *w, const char *line)
{
	const char *at = w->device.log.text, *end = at + w->device.log.used;
	unsigned n = 0;

	while ((at = memmem(at, (size_t)(end - at), line, strlen(line)))) {
		at += strlen(line);
		n++;
	}
	return n;
}

static void test_reset_node_reports_a_fault_that_stays_again_and_forgets_the_others(void **state)
{
	struct world *w = *state;
	const float rate = 1000;

	w->imu.health.degraded = IMU_FAULT_FROZEN;
	w->imu.health.degraded_chip = IMU_CHIP_MAG;
	world_samples(w, 2);
	assert_int_equal(write_sensor(w, 1, &rate, 4), 0);
	assert_int_equal(world_emcy_code(w), 0x6321);
	w->device.pipeline.implausible = 1; /* counted from the reset on */
	world_samples(w, 2);
	assert_int_equal(world_emcy_code(w), 0x5032);
	unsigned before = world_count(w, 0x080 + WORLD_NODE_ID);
	world_nmt(w, 0x81); /* back to a rate that the sensor has */
	world_samples(w, 300);
	assert_int_equal(world_count(w, 0x080 + WORLD_NODE_ID), before + 1);
	assert_int_equal(world_emcy_code(w), 0x5031);
	w->device.storing.base.sensor.rate = rate; /* as if stored */
	for (int i = 2; i <= 4; i += 2) {
		world_nmt(w, 0x81);
		world_samples(w, 300);
		assert_int_equal(world_count(w, 0x080 + WORLD_NODE_ID), before + 1 + (unsigned)i);
	}
}

/* The last one again and again; then the clock has gone back. */
static void test_samples_whose_time_stands_still_are_none(void **state)
{
	struct world *w = *state;
	struct imu_sample s;

	world_seconds(w, 1);
	sensor_next(&w->sensor, w->signal, &s, NULL);
	for (int i = 0; i < 100; i++)
		world_deliver(w, &s);
	assert_int_equal(world_emcy_code(w), 0x5030);
	assert_int_equal(world_count(w, 0x080 + WORLD_NODE_ID), 1);
	assert_false(w->device.values.sample.status & PIPELINE_VALID);
	s.t_us = 1000;
	world_deliver(w, &s);
	assert_int_equal(world_emcy_code(w), 0x5030);
	s.t_us += w->interval_us;
	world_deliver(w, &s);
	assert_int_equal(world_emcy_code(w), 0);
	assert_true(w->device.values.sample.status & PIPELINE_VALID);
}

static void test_sensors_that_nobody_calibrated_are_told_once_and_in_an_object(void **state)
{
	struct world *w = *state;
	const float bias = 0.01f, none = 0;
	const uint8_t calibrated = 1, not_calibrated = 2;

	assert_int_equal(w->device.values.sensor_state.uncalibrated, 0); /* the source says nothing */
	assert_int_equal(lines(w, "never calibrated"), 0);
	w->imu.uncalibrated = IMU_UNCALIBRATED;
	world_power_on(w, NULL);
	world_samples(w, 10);
	assert_int_equal(w->device.values.sensor_state.uncalibrated, 7);
	assert_int_equal(lines(w, "never calibrated: gyro accelerometer magnetometer;"), 1);
	assert_true((double)w->device.values.attitude_sigma.z > 30);

	assert_int_equal(world_sdo_write(w, OD_INDEX_GYRO_CALIBRATION, 1, &bias, 4), 0);
	world_samples(w, 10);
	assert_int_equal(w->device.values.sensor_state.uncalibrated, 6);
	assert_int_equal(world_sdo_write(w, OD_INDEX_GYRO_CALIBRATION, 1, &none, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x2055, 1, &calibrated, 1), 0); /* its bias is 0 */
	assert_int_equal(world_sdo_write(w, 0x2055, 2, &calibrated, 1), 0);
	world_samples(w, 10);
	assert_int_equal(w->device.values.sensor_state.uncalibrated, 4);
	assert_int_equal(world_sdo_write(w, OD_INDEX_MAGNETOMETER_CALIBRATION, 2, &bias, 4), 0);
	world_samples(w, 10);
	assert_int_equal(w->device.values.sensor_state.uncalibrated, 0);
	assert_int_equal(lines(w, "all sensors are calibrated"), 1);
	world_seconds(w, 5); /* the log has each line again */
	world_nmt(w, 0x81);  /* nothing was stored */
	assert_int_equal(w->device.values.sensor_state.uncalibrated, 7);
	assert_int_equal(lines(w, "never calibrated: gyro accelerometer magnetometer;"), 2);
	assert_int_equal(world_sdo_write(w, 0x2055, 3, &calibrated, 1), 0);
	world_samples(w, 10);
	assert_int_equal(w->device.values.sensor_state.uncalibrated, 3);
	assert_int_equal(world_sdo_write(w, 0x2055, 3, &not_calibrated, 1), 0);
	world_samples(w, 10);
	assert_int_equal(w->device.values.sensor_state.uncalibrated, 7);
}

static void test_a_saturated_sample_sets_its_status_bit(void **state)
{
	struct world *w = *state;

	sample_with(w, SAMPLE_SATURATED, 0);
	assert_true(w->device.values.sample.status & STATUS_SENSOR_FAULT);
	world_sample(w);
	assert_false(w->device.values.sample.status & STATUS_SENSOR_FAULT);
	assert_int_equal(world_count(w, 0x080 + WORLD_NODE_ID), 0);
}

/* A temperature of 0 would look like a measured one. */
static void test_without_a_temperature_it_is_not_known(void **state)
{
	struct world *w = *state;

	assert_int_equal(w->device.values.device_temperature, -300);
	sample_with(w, 0, 20);
	assert_int_equal(w->device.values.device_temperature, -300);
	assert_true(w->device.values.sensor_state.temperature == -300);
}

static void test_the_temperature_is_that_of_the_last_sample_that_had_one(void **state)
{
	struct world *w = *state;

	sample_with(w, SAMPLE_TEMPERATURE, -7.6);
	world_sample(w);
	assert_int_equal(w->device.values.device_temperature, -8);
	assert_true(fabs((double)w->device.values.sensor_state.temperature + 7.6) < 1e-5);
}

static void test_a_temperature_beyond_the_range_of_its_object_is_ignored(void **state)
{
	struct world *w = *state;

	sample_with(w, SAMPLE_TEMPERATURE, 20);
	sample_with(w, SAMPLE_TEMPERATURE, 1e300);
	sample_with(w, SAMPLE_TEMPERATURE, (double)NAN);
	assert_int_equal(w->device.values.device_temperature, 20);
	assert_true(w->device.values.sensor_state.temperature == 20);
}

/* ---- settings ---------------------------------------------------------------------------------------------------- */

static void test_settings_are_applied_with_reset_node(void **state)
{
	struct chip *chip = *state;
	struct world *w = &chip->world;
	const float rate = 200, range = 4;

	assert_int_equal(chip->configurations, 0); /* it was opened with the settings of 2058h */
	assert_int_equal(write_sensor(w, 1, &rate, 4), 0);
	assert_int_equal(write_sensor(w, 3, &range, 4), 0);
	assert_int_equal(chip->configurations, 0);
	w->device.storing.base.sensor.rate = 200; /* as if stored */
	world_nmt(w, 0x81);
	assert_int_equal(chip->configurations, 1);
	assert_true(chip->configured.rate_hz == 200);
	assert_true(w->device.pipeline.rate_hz == 200);
	world_nmt(w, 0x81);
	assert_int_equal(chip->configurations, 1); /* unchanged settings */
}

static void test_unsupported_settings_raise_6321h_at_once_and_the_sensor_is_unchanged(void **state)
{
	struct world *w = *state;
	float rate = 1000;

	assert_int_equal(write_sensor(w, 1, &rate, 4), 0);
	assert_int_equal(world_emcy_code(w), 0x6321);
	assert_true(w->imu.rate_hz == 100);
	assert_non_null(
		strstr(w->device.log.text, "unchanged: it goes to 800 Hz, and the reason for that has more than 80 "
					   "characters, which is no rea\n")); /* 150 in all */
	rate = 400;
	assert_int_equal(write_sensor(w, 1, &rate, 4), 0);
	assert_int_equal(world_emcy_code(w), 0);
}

static void test_only_1_starts_a_self_test(void **state)
{
	struct chip *chip = *state;
	struct world *w = &chip->world;

	assert_int_equal(write_sensor(w, 7, (const uint8_t[]){0}, 1), 0x06090030);
	assert_int_equal(chip->self_tests, 0);
	assert_int_equal(write_sensor(w, 7, (const uint8_t[]){1}, 1), 0);
	assert_int_equal(chip->self_tests, 1);
}

static void test_during_a_self_test_the_outputs_are_invalid_but_the_sensor_is_not_lost(void **state)
{
	struct world *w = *state;

	world_sample(w);
	w->imu.health.self_test = 0x80;
	device_tick(&w->device, w->now_us);
	assert_int_equal(w->device.values.sample.status & 0x201, 0x200);
	device_tick(&w->device, w->now_us += 2000000);
	assert_int_equal(world_emcy_code(w), 0);
	w->imu.health.self_test = 0x03;
	world_sample(w);
	assert_int_equal(w->device.values.sample.status & 0x201, 0x001);
}

static void test_a_self_test_that_does_not_end_loses_the_sensor(void **state)
{
	struct world *w = *state;

	world_sample(w);
	w->imu.health.self_test = 0x80;
	device_tick(&w->device, w->now_us += 5000000);
	assert_int_equal(world_emcy_code(w), 0x5030);
}

static void test_a_sensor_without_self_test_refuses_the_command(void **state)
{
	struct world *w = *state;

	w->imu.ops = NULL;
	assert_int_equal(write_sensor(w, 7, (const uint8_t[]){1}, 1), 0x08000022);
}

#define WORLD(test) cmocka_unit_test_setup_teardown(test, set_up, world_tear_down)

int main(void)
{
	const struct CMUnitTest tests[] = {
		WORLD(test_a_fault_of_the_gyro_is_reported_with_kind_and_chip_and_invalidates_the_outputs),
		WORLD(test_a_fault_of_the_magnetometer_is_reported_and_the_outputs_stay_valid),
		WORLD(test_an_output_beyond_what_was_measured_is_not_published_and_raises_5032h_until_a_second_without),
		WORLD(test_reset_node_reports_a_fault_that_stays_again_and_forgets_the_others),
		WORLD(test_samples_whose_time_stands_still_are_none),
		WORLD(test_sensors_that_nobody_calibrated_are_told_once_and_in_an_object),
		WORLD(test_a_saturated_sample_sets_its_status_bit),
		WORLD(test_without_a_temperature_it_is_not_known),
		WORLD(test_the_temperature_is_that_of_the_last_sample_that_had_one),
		WORLD(test_a_temperature_beyond_the_range_of_its_object_is_ignored),
		WORLD(test_settings_are_applied_with_reset_node),
		WORLD(test_unsupported_settings_raise_6321h_at_once_and_the_sensor_is_unchanged),
		WORLD(test_only_1_starts_a_self_test),
		WORLD(test_during_a_self_test_the_outputs_are_invalid_but_the_sensor_is_not_lost),
		WORLD(test_a_self_test_that_does_not_end_loses_the_sensor),
		WORLD(test_a_sensor_without_self_test_refuses_the_command),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
