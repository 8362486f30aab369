#include "model/calibration.h"

#include <errno.h>

static bool triad_valid(const struct triad_calibration *c)
{
	const double(*m)[3] = c->matrix;
	double det = m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) -
		     m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
		     m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);

	/* A NaN in the matrix makes the determinant NaN, an infinity makes it NaN or infinite. */
	return vec3_finite(c->bias) && isfinite(det) && fabs(det) >= 1e-3;
}

static const double TEMPERATURE_MAX_DEGC = 200; /* no sensor reports more */

static bool temperature_valid(const struct temperature_compensation *c)
{
	return vec3_finite(c->gyro_slope) && vec3_finite(c->gyro_quadratic) && vec3_finite(c->accel_slope) &&
	       vec3_finite(c->accel_quadratic) && isfinite(c->reference_degC);
}

static struct vec3 shift(struct vec3 slope, struct vec3 quadratic, double t)
{
	return vec3_add(vec3_scale(t, slope), vec3_scale(t * t, quadratic));
}

struct vec3 calibration_gyro_shift(const struct temperature_compensation *c, double temperature_degC)
{
	return shift(c->gyro_slope, c->gyro_quadratic, temperature_degC - c->reference_degC);
}

struct vec3 calibration_accel_shift(const struct temperature_compensation *c, double temperature_degC)
{
	return shift(c->accel_slope, c->accel_quadratic, temperature_degC - c->reference_degC);
}

static struct mat3 mounted(struct mat3 mounting, const struct triad_calibration *c)
{
	struct mat3 m;

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			m.m[i][j] = c->matrix[i][j];
	return mat3_multiply(mounting, m);
}

int calibration_init(struct calibration *cal, const struct calibration_config *config)
{
	struct mat3 mounting;

	if (!vec3_finite(config->mounting_rad) || !triad_valid(&config->gyro) || !triad_valid(&config->accel) ||
		!triad_valid(&config->mag) || !temperature_valid(&config->temperature))
		return -EINVAL;
	mounting = mat3_from_quat(quat_from_aerospace(config->mounting_rad));
	*cal = (struct calibration){
		.config = *config,
		.gyro = mounted(mounting, &config->gyro),
		.accel = mounted(mounting, &config->accel),
		.mag = mounted(mounting, &config->mag),
		.gyro_bias = config->gyro.bias,
		.accel_bias = config->accel.bias,
	};
	return 0;
}

bool calibration_temperature(struct calibration *cal, double temperature_degC)
{
	const struct calibration_config *c = &cal->config;

	if (!(fabs(temperature_degC) <= TEMPERATURE_MAX_DEGC))
		return false;
	cal->temperature_degC = temperature_degC;
	cal->temperature_known = true;
	cal->gyro_bias = vec3_add(c->gyro.bias, calibration_gyro_shift(&c->temperature, temperature_degC));
	cal->accel_bias = vec3_add(c->accel.bias, calibration_accel_shift(&c->temperature, temperature_degC));
	return true;
}

int calibration_configure(struct calibration *cal, const struct calibration_config *config)
{
	struct calibration next;

	if (calibration_init(&next, config) < 0)
		return -EINVAL;
	if (cal->temperature_known)
		calibration_temperature(&next, cal->temperature_degC);
	*cal = next;
	return 0;
}

struct imu_sample calibration_apply(const struct calibration *cal, const struct imu_sample *raw)
{
	struct imu_sample s = *raw;

	s.gyro_rad_s = mat3_apply(cal->gyro, vec3_sub(raw->gyro_rad_s, cal->gyro_bias));
	s.accel_m_s2 = mat3_apply(cal->accel, vec3_sub(raw->accel_m_s2, cal->accel_bias));
	if (raw->flags & SAMPLE_MAG)
		s.mag_uT = mat3_apply(cal->mag, vec3_sub(raw->mag_uT, cal->config.mag.bias));
	return s;
}
