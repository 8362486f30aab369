#include "gateway/publish.h"
#include "od_index.h"
#include "model/math/units.h"

#include <limits.h>
#include <math.h>

/* One step of a scaled output, in its unit. */
static double step_of(const struct od *od, uint16_t index, uint8_t sub)
{
	return od_step(od, od_find(od->table, index, sub, NULL));
}

/* The value in units of `lsb`, rounded to the nearest; *saturated is set when it exceeds the limits. */
static int32_t scaled(double value, double lsb, int32_t limit, bool *saturated)
{
	double n = round(value / lsb);

	if (n > limit || n < -(double)limit - 1 || isnan(n)) {
		*saturated = true;
		return n < 0 ? -limit - 1 : limit;
	}
	return (int32_t)n;
}

static int16_t scaled16(double value, double lsb, bool *saturated)
{
	return (int16_t)scaled(value, lsb, INT16_MAX, saturated);
}

/* ---- CiA 410: slopes with inversion, offset and preset ----------------------------------------------------------- */

enum { SLOPE_INVERSION = 1 << 0, SLOPE_SCALING = 1 << 1 };

static int32_t clamp(int64_t value, int64_t limit, bool *saturated)
{
	if (value > limit || value < -limit - 1) {
		*saturated = true;
		return (int32_t)(value < 0 ? -limit - 1 : limit);
	}
	return (int32_t)value;
}

/* The operating parameter (6011h) selects the sign; with scaling enabled the two offsets are added. */
static int64_t slope(int32_t physical, uint8_t operating, int32_t offset, int32_t differential)
{
	int64_t value = operating & SLOPE_INVERSION ? -(int64_t)physical : physical;

	return operating & SLOPE_SCALING ? value + offset + differential : value;
}

static double angle_lsb_rad(const struct od *od)
{
	return step_of(od, OD_INDEX_ANGLES, OD_SUB_ANGLES_ROLL) / DEG_PER_RAD;
}

/* The longitudinal slope is the rotation about the side axis (pitch), the lateral slope the one about the longitudinal
 * axis (roll). */
static int32_t physical_slope(const struct od *od, double angle_deg, bool *saturated)
{
	return scaled(angle_deg / DEG_PER_RAD, angle_lsb_rad(od), INT32_MAX, saturated);
}

/* Returns PUBLISH_CLIPPED_... of the slopes that exceed the range of their objects. */
static unsigned publish_slopes(struct od *od)
{
	struct od_values *v = od->values;
	bool long_clipped = false, lateral_clipped = false;
	int32_t lon = physical_slope(od, (double)v->angles_deg.pitch, &long_clipped);
	int32_t lat = physical_slope(od, (double)v->angles_deg.roll, &lateral_clipped);

	v->slope_long16 = (int16_t)clamp(slope(lon, v->slope_long16_operating_parameter, v->slope_long16_offset,
						 v->slope_long16_differential_offset),
		INT16_MAX, &long_clipped);
	v->slope_lateral16 = (int16_t)clamp(slope(lat, v->slope_lateral16_operating_parameter,
						    v->slope_lateral16_offset, v->slope_lateral16_differential_offset),
		INT16_MAX, &lateral_clipped);
	v->slope_long32 = clamp(slope(lon, v->slope_long32_operating_parameter, v->slope_long32_offset,
					v->slope_long32_differential_offset),
		INT32_MAX, &long_clipped);
	v->slope_lateral32 = clamp(slope(lat, v->slope_lateral32_operating_parameter, v->slope_lateral32_offset,
					   v->slope_lateral32_differential_offset),
		INT32_MAX, &lateral_clipped);
	return (long_clipped ? PUBLISH_CLIPPED_LONG : 0u) | (lateral_clipped ? PUBLISH_CLIPPED_LATERAL : 0u);
}

/* offset = preset - (+-physical) - differential offset */
static int64_t preset_offset(int32_t preset, int32_t physical, uint8_t operating, int32_t differential)
{
	return (int64_t)preset - slope(physical, operating & SLOPE_INVERSION, 0, 0) - differential;
}

void publish_preset(struct od *od, uint16_t index)
{
	struct od_values *v = od->values;
	bool saturated = false;
	int32_t lon = physical_slope(od, (double)v->angles_deg.pitch, &saturated);
	int32_t lat = physical_slope(od, (double)v->angles_deg.roll, &saturated);
	int64_t offset;

	switch (index) {
	case OD_INDEX_SLOPE_LONG16_PRESET_VALUE:
		offset = preset_offset(v->slope_long16_preset_value, lon, v->slope_long16_operating_parameter,
			v->slope_long16_differential_offset);
		v->slope_long16_offset = (int16_t)clamp(offset, INT16_MAX, &saturated);
		break;
	case OD_INDEX_SLOPE_LATERAL16_PRESET_VALUE:
		offset = preset_offset(v->slope_lateral16_preset_value, lat, v->slope_lateral16_operating_parameter,
			v->slope_lateral16_differential_offset);
		v->slope_lateral16_offset = (int16_t)clamp(offset, INT16_MAX, &saturated);
		break;
	case OD_INDEX_SLOPE_LONG32_PRESET_VALUE:
		offset = preset_offset(v->slope_long32_preset_value, lon, v->slope_long32_operating_parameter,
			v->slope_long32_differential_offset);
		v->slope_long32_offset = clamp(offset, INT32_MAX, &saturated);
		break;
	case OD_INDEX_SLOPE_LATERAL32_PRESET_VALUE:
		offset = preset_offset(v->slope_lateral32_preset_value, lat, v->slope_lateral32_operating_parameter,
			v->slope_lateral32_differential_offset);
		v->slope_lateral32_offset = clamp(offset, INT32_MAX, &saturated);
		break;
	}
}

/* ---- the sample -------------------------------------------------------------------------------------------------- */

#define PUBLISH_REAL32(record, vector, a, b, c)     \
	do {                                        \
		const struct vec3 value = (vector); \
		(record).a = (float)value.x;        \
		(record).b = (float)value.y;        \
		(record).c = (float)value.z;        \
	} while (0)

/* To find the step takes longer than all else. */
#define PUBLISH_SCALED(record, vector, lsb, a, b, c)              \
	do {                                                      \
		const struct vec3 value = (vector);               \
		const double step = (lsb);                        \
		(record).a = scaled16(value.x, step, &saturated); \
		(record).b = scaled16(value.y, step, &saturated); \
		(record).c = scaled16(value.z, step, &saturated); \
	} while (0)

/* The INTEGER16 twins, 2140h to 2147h: quantities that fit a PDO as vectors. Returns whether one saturates. */
static bool publish_twins(struct od *od, const struct pipeline_output *out)
{
	struct od_values *v = od->values;
	const double quaternion_lsb = step_of(od, OD_INDEX_QUATERNION16, OD_SUB_QUATERNION16_W);
	bool saturated = false;

	v->quaternion16.w = scaled16(out->q_nb.w, quaternion_lsb, &saturated);
	v->quaternion16.x = scaled16(out->q_nb.x, quaternion_lsb, &saturated);
	v->quaternion16.y = scaled16(out->q_nb.y, quaternion_lsb, &saturated);
	v->quaternion16.z = scaled16(out->q_nb.z, quaternion_lsb, &saturated);
	PUBLISH_SCALED(v->angular_rate16, out->rate_b_rad_s, step_of(od, OD_INDEX_ANGULAR_RATE16, 1), l, s, t);
	PUBLISH_SCALED(v->velocity16, out->velocity_n_m_s, step_of(od, OD_INDEX_VELOCITY16, 1), x, y, z);
	PUBLISH_SCALED(v->specific_force16, out->force_b_m_s2, step_of(od, OD_INDEX_SPECIFIC_FORCE16, 1), l, s, t);
	PUBLISH_SCALED(v->magnetic_field16, out->mag_b_uT, step_of(od, OD_INDEX_MAGNETIC_FIELD16, 1), l, s, t);
	PUBLISH_SCALED(v->attitude_sigma16, vec3_scale(DEG_PER_RAD, out->sigma.attitude_rad),
		step_of(od, OD_INDEX_ATTITUDE_SIGMA16, 1), x, y, z);
	PUBLISH_SCALED(
		v->velocity_sigma16, out->sigma.velocity_m_s, step_of(od, OD_INDEX_VELOCITY_SIGMA16, 1), x, y, z);
	PUBLISH_SCALED(v->position_sigma16, out->sigma.position_m, step_of(od, OD_INDEX_POSITION_SIGMA16, 1), x, y, z);
	return saturated;
}

unsigned publish_sample(struct od *od, const struct pipeline_output *out, uint16_t counter)
{
	const double acceleration_lsb_m_s2 = step_of(od, OD_INDEX_ACCELERATION, OD_SUB_ACCELERATION_L);
	const double position_lsb_m = step_of(od, OD_INDEX_POSITION_OUTPUT, OD_SUB_POSITION_OUTPUT_X);
	const struct vec3 angles_deg = vec3_scale(DEG_PER_RAD, out->angles_rad);
	struct od_values *v = od->values;
	bool saturated = false;

	v->quaternion.w = (float)out->q_nb.w;
	v->quaternion.x = (float)out->q_nb.x;
	v->quaternion.y = (float)out->q_nb.y;
	v->quaternion.z = (float)out->q_nb.z;
	PUBLISH_REAL32(v->velocity, out->velocity_n_m_s, x, y, z);
	PUBLISH_REAL32(v->angular_rate, out->rate_b_rad_s, l, s, t);
	PUBLISH_REAL32(v->angular_acceleration, out->alpha_b_rad_s2, l, s, t);
	PUBLISH_REAL32(v->specific_force, out->force_b_m_s2, l, s, t);
	PUBLISH_REAL32(v->magnetic_field, out->mag_b_uT, l, s, t);
	PUBLISH_REAL32(v->acceleration_object, out->accel_b_m_s2, l, s, t);
	PUBLISH_REAL32(v->acceleration_global, out->accel_n_m_s2, x, y, z);
	PUBLISH_REAL32(v->angles_deg, angles_deg, roll, pitch, yaw);
	PUBLISH_REAL32(v->position_m, out->position_n_m, x, y, z);
	PUBLISH_REAL32(v->attitude_sigma, vec3_scale(DEG_PER_RAD, out->sigma.attitude_rad), x, y, z);
	PUBLISH_REAL32(v->acceleration_sigma, out->sigma.accel_m_s2, x, y, z);
	PUBLISH_REAL32(v->velocity_sigma, out->sigma.velocity_m_s, x, y, z);
	PUBLISH_REAL32(v->position_sigma, out->sigma.position_m, x, y, z);
	PUBLISH_REAL32(v->displacement, out->displacement_n_m, x, y, z);
	PUBLISH_REAL32(v->displacement_sigma, out->displacement_sigma_m, x, y, z);
	PUBLISH_REAL32(v->gyro_errors, vec3_scale(DEG_PER_RAD, out->gyro_errors.bias_b_rad_s), bias_l, bias_s, bias_t);
	PUBLISH_REAL32(v->gyro_errors, vec3_scale(100, out->gyro_errors.scale_b), scale_l, scale_s, scale_t);
	v->sensor_state.vibration = (float)out->vibration_m_s2;
	v->sensor_state.clipped_accelerometer = out->clipped_accel;
	v->sensor_state.clipped_gyro = out->clipped_gyro;
	v->latency.acceleration_filter = (float)out->accel_delay_s;

	PUBLISH_SCALED(v->acceleration, out->accel_b_m_s2, acceleration_lsb_m_s2, l, s, t);
	PUBLISH_SCALED(v->angles, out->angles_rad, angle_lsb_rad(od), roll, pitch, yaw);
	PUBLISH_SCALED(v->position_output, out->position_n_m, position_lsb_m, x, y, z);
	v->position_output.x32 = scaled(out->position_n_m.x, position_lsb_m, INT32_MAX, &saturated);
	v->position_output.y32 = scaled(out->position_n_m.y, position_lsb_m, INT32_MAX, &saturated);
	v->position_output.z32 = scaled(out->position_n_m.z, position_lsb_m, INT32_MAX, &saturated);
	saturated |= publish_twins(od, out);
	unsigned clipped = publish_slopes(od);

	v->sample.counter = counter;
	v->sample.time = v->high_resolution_time_stamp = (uint32_t)out->t_us;
	v->sample.status = (uint16_t)(out->status | (saturated || clipped ? STATUS_SATURATED : 0u));
	return clipped;
}

void publish_sensor_lost(struct od_values *v)
{
	v->sample.status = (uint16_t)((v->sample.status & ~(unsigned)PIPELINE_VALID) | STATUS_SENSOR_LOST);
}
