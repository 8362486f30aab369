#include "gateway/settings.h"

#include <string.h>

#include "od/little_endian.h"
#include "model/math/units.h"

/* the three calibration records have the same members, but different generated types */
#define TRIAD(record)                                                                                \
	((struct triad_calibration){                                                                 \
		.bias = {(double)(record).bias_x, (double)(record).bias_y, (double)(record).bias_z}, \
		.matrix = {{(double)(record).xx, (double)(record).xy, (double)(record).xz},          \
			{(double)(record).yx, (double)(record).yy, (double)(record).yz},             \
			{(double)(record).zx, (double)(record).zy, (double)(record).zz}}})

#define LOW_PASS(record)                                 \
	((struct filter_config){                         \
		.type = (enum filter_type)(record).type, \
		.order = (record).order,                 \
		.cutoff_hz = (double)(record).cutoff,    \
	})

static struct temperature_compensation temperature_compensation(const struct od_values *v)
{
	return (struct temperature_compensation){
		.gyro_slope = {(double)v->temperature_compensation.gyro_slope_x,
			(double)v->temperature_compensation.gyro_slope_y,
			(double)v->temperature_compensation.gyro_slope_z},
		.gyro_quadratic = {(double)v->temperature_compensation.gyro_quadratic_x,
			(double)v->temperature_compensation.gyro_quadratic_y,
			(double)v->temperature_compensation.gyro_quadratic_z},
		.accel_slope = {(double)v->temperature_compensation.accelerometer_slope_x,
			(double)v->temperature_compensation.accelerometer_slope_y,
			(double)v->temperature_compensation.accelerometer_slope_z},
		.accel_quadratic = {(double)v->temperature_compensation.accelerometer_quadratic_x,
			(double)v->temperature_compensation.accelerometer_quadratic_y,
			(double)v->temperature_compensation.accelerometer_quadratic_z},
		.reference_degC = (double)v->temperature_compensation.reference_temperature,
	};
}

static bool is_default(const struct triad_calibration *c)
{
	static const struct triad_calibration unchanged = {.matrix = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
	bool same = c->bias.x == 0 && c->bias.y == 0 && c->bias.z == 0;

	for (int i = 0; i < 9; i++)
		same &= c->matrix[i / 3][i % 3] == unchanged.matrix[i / 3][i % 3];
	return same;
}

unsigned settings_uncalibrated(const struct od_values *v, unsigned source)
{
	enum { AUTOMATIC = 0, NOT_CALIBRATED = 2 };
	const struct {
		unsigned bit;
		uint8_t said;
		struct triad_calibration triad;
	} sensors[] = {
		{PIPELINE_UNCALIBRATED_GYRO, v->sensor_calibration.gyro, TRIAD(v->gyro_calibration)},
		{PIPELINE_UNCALIBRATED_ACCEL, v->sensor_calibration.accelerometer, TRIAD(v->accelerometer_calibration)},
		{PIPELINE_UNCALIBRATED_MAG, v->sensor_calibration.magnetometer, TRIAD(v->magnetometer_calibration)},
	};
	unsigned bits = 0;

	for (size_t i = 0; i < sizeof sensors / sizeof *sensors; i++)
		if (sensors[i].said == NOT_CALIBRATED ||
			(sensors[i].said == AUTOMATIC && (source & sensors[i].bit) && is_default(&sensors[i].triad)))
			bits |= sensors[i].bit;
	return bits;
}

struct pipeline_config settings_pipeline(const struct od_values *v)
{
	struct pipeline_config c = PIPELINE_DEFAULTS;

	c.calibration.gyro = TRIAD(v->gyro_calibration);
	c.calibration.accel = TRIAD(v->accelerometer_calibration);
	c.calibration.mag = TRIAD(v->magnetometer_calibration);
	c.uncalibrated = settings_uncalibrated(v, 0);
	c.calibration.temperature = temperature_compensation(v);
	c.calibration.mounting_rad = (struct vec3){(double)v->mounting.roll * RAD_PER_DEG,
		(double)v->mounting.pitch * RAD_PER_DEG, (double)v->mounting.yaw * RAD_PER_DEG};

	c.accel_filter = LOW_PASS(v->acceleration_filter);
	c.rate_filter = LOW_PASS(v->rate_filter);

	c.fusion.algorithm = (enum fusion_algorithm)v->fusion.algorithm;
	c.fusion.use_magnetometer = v->fusion.use_magnetometer;
	c.fusion.madgwick_beta = (double)v->fusion.madgwick_beta;
	c.fusion.mahony_kp_rad_s = (double)v->fusion.mahony_kp;
	c.fusion.mahony_ki_rad_s2 = (double)v->fusion.mahony_ki;
	c.fusion.kalman.velocity_sigma_m_s = (double)v->fusion.velocity_sigma;
	c.fusion.kalman.heading_sigma_rad = (double)v->fusion.heading_sigma * RAD_PER_DEG;
	c.fusion.kalman.field_limit = (double)v->fusion.field_limit;
	c.fusion.kalman.rejection_time_s = (double)v->fusion.rejection_time;
	c.fusion.kalman.gyro_error = (double)v->fusion.gyro_error;
	c.fusion.kalman.bias_walk_rad_s_sqrt_s = (double)v->fusion.bias_walk * RAD_PER_DEG;
	c.fusion.kalman.gyro_scale_sigma = (double)v->fusion.gyro_scale_sigma;
	c.latency = (struct latency_config){(double)v->latency.sensor, (double)v->latency.accelerometer};

	c.noise = (struct noise_config){
		.angle_sigma_rad = (double)v->noise.angle_sigma * RAD_PER_DEG,
		.gyro_density_rad_s_sqrt_hz = (double)v->noise.gyro_density * RAD_PER_DEG,
		.gyro_bias_instability_rad_s = (double)v->noise.gyro_bias_instability * RAD_PER_DEG,
		.accel_density_m_s2_sqrt_hz = (double)v->noise.accelerometer_density * 1e-6 * STANDARD_GRAVITY_M_S2,
		.accel_bias_instability_m_s2 =
			(double)v->noise.accelerometer_bias_instability * 1e-3 * STANDARD_GRAVITY_M_S2,
		.gyro_bias_per_K_rad_s = (double)v->noise.gyro_bias_per_kelvin * RAD_PER_DEG,
		.accel_bias_per_K_m_s2 = (double)v->noise.accelerometer_bias_per_kelvin * 1e-3 * STANDARD_GRAVITY_M_S2,
		.mag_sigma_uT = (double)v->noise.magnetometer_sigma,
	};

	c.estimator.lever_arm_b_m =
		(struct vec3){(double)v->lever_arm.l, (double)v->lever_arm.s, (double)v->lever_arm.t};
	c.estimator.model = (enum lever_arm_model)v->lever_arm_model;
	c.estimator.rates_from = (enum rate_source)v->rates_from;
	c.estimator.gravity_m_s2 = (double)v->gravity;

	c.rest.gyro_threshold_rad_s = (double)v->position.rest_gyro_threshold * RAD_PER_DEG;
	c.rest.accel_threshold_m_s2 = (double)v->position.rest_acceleration_threshold;
	c.rest.time_s = (double)v->position.rest_time;
	c.stance_s = (double)v->position.stance_time;

	c.position.mode = (enum position_mode)v->position.mode;
	c.position.longest_integration_s = (double)v->position.longest_integration_time;
	c.position.sigma_limit_m = (double)v->position.sigma_limit;
	c.position.navigation.preset = (enum motion_preset)v->position.motion_preset;
	c.position.navigation.levelling = v->position.levelling;
	c.position.navigation.velocity_prior_m_s = (double)v->position.velocity_prior;
	c.position.navigation.rope_m = (double)v->position.rope_length;
	return c;
}

static void put_real32(uint8_t wire[sizeof(float)], float value)
{
	uint32_t bits;

	memcpy(&bits, &value, sizeof(bits));
	put_u32(wire, bits);
}

bool settings_valid(const struct od_values *values)
{
	const struct pipeline_config config = settings_pipeline(values);
	struct pipeline pipeline;

	return pipeline_init(&pipeline, &config, values->sensor.rate) == 0;
}

enum od_status settings_write(struct od *od, uint16_t index, const float *values, uint8_t count)
{
	enum od_status status = OD_OK;
	uint8_t wire[sizeof(float)];

	for (uint8_t sub = 1; sub <= count && status == OD_OK; sub++) {
		put_real32(wire, values[sub - 1]);
		status = od_check(od_find(od->table, index, sub, NULL), wire, sizeof(wire));
	}
	for (uint8_t sub = 1; sub <= count && status == OD_OK; sub++) {
		put_real32(wire, values[sub - 1]);
		status = od_write(od, index, sub, wire, sizeof(wire));
	}
	return status;
}
