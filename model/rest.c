#include "model/rest.h"

#include <errno.h>

/* Time constant of the slow mean: long against vibration, short against the time after which rest
 * counts. */
static const double MEAN_TIME_S = 0.5;
/* A sensor sampled faster is noisier: the same sensor is to rest at any rate. */
static const double SMOOTH_TIME_S = 0.004;

int rest_configure(struct rest *r, const struct rest_config *config)
{
	const struct rest_config *c = config;

	if (!(c->gyro_threshold_rad_s > 0 && isfinite(c->gyro_threshold_rad_s)) ||
		!(c->accel_threshold_m_s2 > 0 && isfinite(c->accel_threshold_m_s2)) ||
		!(c->time_s >= 0 && isfinite(c->time_s)))
		return -EINVAL;
	r->config = *config;
	return 0;
}

int rest_init(struct rest *r, const struct rest_config *config)
{
	struct rest fresh = {.still_s = 0};

	if (rest_configure(&fresh, config) < 0)
		return -EINVAL;
	*r = fresh;
	return 0;
}

void rest_restart(struct rest *r)
{
	r->primed = false;
}

/* Moves the mean and returns how far the value is from it. */
static double deviation(struct vec3 *mean, struct vec3 value, double share)
{
	struct vec3 d = vec3_sub(value, *mean);

	*mean = vec3_add(*mean, vec3_scale(share, d));
	return vec3_norm(d);
}

bool rest_step(struct rest *r, struct vec3 gyro_b_rad_s, struct vec3 force_b_m_s2, double dt_s)
{
	const struct rest_config *c = &r->config;
	double share = dt_s / (MEAN_TIME_S + dt_s), smooth = fmin(1, dt_s / SMOOTH_TIME_S), gyro, accel;

	if (!r->primed) {
		r->gyro = r->gyro_mean = gyro_b_rad_s;
		r->accel = r->accel_mean = force_b_m_s2;
		r->still_s = 0;
		r->primed = true;
		return false;
	}
	deviation(&r->gyro, gyro_b_rad_s, smooth);
	deviation(&r->accel, force_b_m_s2, smooth);
	gyro = deviation(&r->gyro_mean, r->gyro, share);
	accel = deviation(&r->accel_mean, r->accel, share);
	if (gyro < c->gyro_threshold_rad_s && accel < c->accel_threshold_m_s2 &&
		vec3_norm(r->gyro_mean) < c->gyro_threshold_rad_s)
		r->still_s += dt_s;
	else
		r->still_s = 0;
	return r->still_s > c->time_s;
}
