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
		!triad_valid(&config->mag))
		return -EINVAL;
	mounting = mat3_from_quat(quat_from_aerospace(config->mounting_rad));
	*cal = (struct calibration){
		.config = *config,
		.gyro = mounted(mounting, &config->gyro),
		.accel = mounted(mounting, &config->accel),
		.mag = mounted(mounting, &config->mag),
	};
	return 0;
}

struct imu_sample calibration_apply(const struct calibration *cal, const struct imu_sample *raw)
{
	const struct calibration_config *c = &cal->config;
	struct imu_sample s = *raw;

	s.gyro_rad_s = mat3_apply(cal->gyro, vec3_sub(raw->gyro_rad_s, c->gyro.bias));
	s.accel_m_s2 = mat3_apply(cal->accel, vec3_sub(raw->accel_m_s2, c->accel.bias));
	if (raw->flags & SAMPLE_MAG)
		s.mag_uT = mat3_apply(cal->mag, vec3_sub(raw->mag_uT, c->mag.bias));
	return s;
}
