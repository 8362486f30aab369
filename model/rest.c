#include "model/rest.h"

#include <errno.h>

/* Time constant of a low-pass before all else: a sensor sampled faster is noisier per sample, and the same thresholds
 * have to hold for it. Chosen by judgement: short against any motion, and without effect up to 250 samples a second. */
static const double SMOOTH_TIME_S = 0.004;
/* The mean square is held below this times its limit, so that it is below the limit ln 4 = 1.4 time constants after the
 * end of a motion, however violent that was. Chosen by judgement. */
static const double SQUARE_MOST = 4;

/* A sample after missing ones tells no more than another: its weight is that of so many usual intervals, which follow
 * the intervals by that share. By judgement: twice is what uneven time stamps make of an even interval. */
static const double USUAL_INTERVALS = 2, INTERVAL_SHARE = 0.1;

static bool positive(double a)
{
	return a > 0 && isfinite(a);
}

static bool not_negative(double a)
{
	return a >= 0 && isfinite(a);
}

int rest_check(const struct rest_config *c)
{
	return positive(c->gyro_threshold_rad_s) && c->rate_share > 0 && positive(c->accel_threshold_m_s2) &&
			       not_negative(c->time_s) && positive(c->mean_time_s) &&
			       not_negative(c->deviation_time_s) && positive(c->deviation_share) &&
			       positive(c->drift_time_s) && c->drift_share > 0
		       ? 0
		       : -EINVAL;
}

void rest_restart(struct rest *r)
{
	*r = (struct rest){.interval_s = r->interval_s};
}

/* Moves the mean towards the value; returns how far the value was from it. */
static struct vec3 follow(struct vec3 *mean, struct vec3 value, double share)
{
	struct vec3 d = vec3_sub(value, *mean);

	*mean = vec3_add(*mean, vec3_scale(share, d));
	return d;
}

static bool deviates_less(
	struct vec3 *mean, double *mean_square, struct vec3 value, double share, double square_share, double limit)
{
	struct vec3 d = follow(mean, value, share);

	*mean_square = fmin(*mean_square + square_share * (vec3_dot(d, d) - *mean_square), SQUARE_MOST * limit * limit);
	return *mean_square < limit * limit;
}

static bool drifts_less(struct vec3 *slow, struct vec3 mean, double share, double limit)
{
	struct vec3 d = follow(slow, mean, share);

	return vec3_dot(d, d) < limit * limit;
}

bool rest_step(
	struct rest *r, const struct rest_config *c, struct vec3 gyro_b_rad_s, struct vec3 force_b_m_s2, double dt_s)
{
	double usual_s = r->interval_s > 0 ? r->interval_s : dt_s, weight_s = fmin(dt_s, USUAL_INTERVALS * usual_s);
	double smooth = fmin(1, weight_s / SMOOTH_TIME_S), share = weight_s / (c->mean_time_s + weight_s);
	double square_share = weight_s / (c->deviation_time_s + weight_s), slow_share;
	double gyro_limit = c->gyro_threshold_rad_s, accel_limit = c->accel_threshold_m_s2;
	bool still;

	r->interval_s = usual_s + INTERVAL_SHARE * (weight_s - usual_s);
	if (!r->started) {
		r->gyro = r->gyro_mean = r->gyro_slow = gyro_b_rad_s;
		r->accel = r->accel_mean = r->accel_slow = force_b_m_s2;
		r->gyro_square = r->accel_square = r->still_s = 0;
		r->started = true;
		return false;
	}
	follow(&r->gyro, gyro_b_rad_s, smooth);
	follow(&r->accel, force_b_m_s2, smooth);
	still = deviates_less(
		&r->gyro_mean, &r->gyro_square, r->gyro, share, square_share, c->deviation_share * gyro_limit);
	still &= deviates_less(
		&r->accel_mean, &r->accel_square, r->accel, share, square_share, c->deviation_share * accel_limit);
	still &= vec3_norm(r->gyro_mean) < c->rate_share * gyro_limit;
	/* in motion the slow mean is the short one; then it is the mean since the standstill began, of bounded
	 * memory */
	slow_share = still ? fmax(weight_s / (r->still_s + weight_s), weight_s / c->drift_time_s) : 1;
	still &= drifts_less(&r->gyro_slow, r->gyro_mean, slow_share, c->drift_share * gyro_limit);
	still &= drifts_less(&r->accel_slow, r->accel_mean, slow_share, c->drift_share * accel_limit);
	r->still_s = still ? r->still_s + dt_s : 0;
	return r->still_s > c->time_s;
}

double rest_accel_walk_m2_s3(const struct rest *r, double dt_s)
{
	double share = fmin(1, dt_s / SMOOTH_TIME_S), smoothed = share / (2 - share);

	return r->accel_square / 3 / smoothed * dt_s;
}
