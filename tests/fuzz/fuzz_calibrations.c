/* The calibrations and the lever arm's identification with arbitrary motion, to their end: a good result is finite. The
 * input is a sequence of attitudes, rates and disturbances, each held for some samples. */
#include <math.h>
#include <string.h>

#include "model/identify/calibrate_accelerometer.h"
#include "model/identify/calibrate_gyro.h"
#include "model/identify/calibrate_magnetometer.h"
#include "model/identify/calibrate_temperature.h"
#include "model/identify/lever_identification.h"
#include "tests/fuzz/fuzz.h"

enum { HELD_MAX = 128, PERIOD_US = 10000 };

static struct calibrate_gyro gyro;
static struct calibrate_accelerometer accelerometer;
static struct calibrate_magnetometer magnetometer;
static struct calibrate_temperature temperature;
static struct lever_identification lever;

static void init(uint8_t kind)
{
	struct calibrate_accelerometer_config positions = {.positions = kind & 1 ? CALIBRATE_FREE : CALIBRATE_SIX_FACES,
		.gravity_m_s2 = 9.81,
		.use_all = kind & 2,
		.patience_s = kind & 4 ? INFINITY : 300};
	struct calibrate_magnetometer_config field = {
		.field_uT = kind & 8 ? 48 : 0, .use_all = kind & 2, .patience_s = positions.patience_s};
	struct lever_identification_config motion = {
		.rate_hz = 100, .duration_s = 30, .reference = kind & 16, .estimate_delay = kind & 32};

	calibrate_gyro_init(&gyro, &CALIBRATE_GYRO_DEFAULTS);
	calibrate_accelerometer_init(&accelerometer, &positions);
	calibrate_magnetometer_init(&magnetometer, &field);
	calibrate_temperature_init(&temperature);
	require(lever_identification_init(&lever, &motion) == 0);
}

static double number(struct input *in, uint8_t kind, double unit)
{
	double any;

	if (kind & 0x80) {
		read_bytes(in, &any, sizeof(any));
		return any;
	}
	return (int8_t)read_byte(in) * unit;
}

static struct vec3 vector(struct input *in, uint8_t kind, double unit)
{
	return (struct vec3){number(in, kind, unit), number(in, kind, unit), number(in, kind, unit)};
}

static void hold(struct input *in, uint64_t *t_us)
{
	uint8_t kind = read_byte(in), count = read_byte(in) % HELD_MAX, noise = read_byte(in);
	struct imu_sample s = {.flags = kind & 0x3F,
		.gyro_rad_s = vector(in, kind, 0.03),
		.accel_m_s2 = vector(in, kind, 0.1),
		.mag_uT = vector(in, kind, 0.5),
		.ref_accel_b_m_s2 = vector(in, kind, 0.05),
		.temperature_degC = number(in, kind, 0.5)};
	struct vec3 start = s.gyro_rad_s;

	for (int i = 0; i <= count; i++) {
		*t_us += (uint64_t)PERIOD_US << (kind & 0x40 ? noise & 7 : 0);
		s.t_us = *t_us;
		s.gyro_rad_s.x = start.x * cos(i * (noise & 15) * 0.05);
		calibrate_gyro_step(&gyro, &s);
		calibrate_accelerometer_step(&accelerometer, &s);
		calibrate_magnetometer_step(&magnetometer, &s);
		calibrate_temperature_step(&temperature, &s);
		lever_identification_step(&lever, s.t_us, s.gyro_rad_s, s.accel_m_s2, &s.ref_accel_b_m_s2);
	}
}

static void require_finite(const struct triad_calibration *c)
{
	require(vec3_finite(c->bias));
	for (int row = 0; row < 3; row++)
		for (int column = 0; column < 3; column++)
			require(isfinite(c->matrix[row][column]));
}

static void finish(void)
{
	struct lever_estimate estimate = lever_identification_estimate(&lever);

	if (calibrate_gyro_finish(&gyro) == CALIBRATE_GOOD)
		require(vec3_finite(gyro.result.bias_rad_s) && vec3_finite(gyro.result.sigma_rad_s));
	if (calibrate_accelerometer_finish(&accelerometer) == CALIBRATE_GOOD)
		require_finite(&accelerometer.result.calibration);
	if (calibrate_magnetometer_finish(&magnetometer) == CALIBRATE_GOOD)
		require_finite(&magnetometer.result.calibration);
	if (calibrate_temperature_finish(&temperature) == CALIBRATE_GOOD)
		require(vec3_finite(temperature.result.gyro_rad_s));
	require(estimate.progress_percent <= 100);
	if (estimate.verdict == LEVER_FOUND)
		require(vec3_finite(estimate.lever_arm_b_m) && vec3_finite(estimate.sigma_b_m));
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct input in = {data, size};
	uint64_t t_us = 1000;

	init(read_byte(&in));
	while (in.size > 0)
		hold(&in, &t_us);
	finish();
	return 0;
}
