#include "model/vibration.h"

#include <math.h>

#include "model/math/units.h"

/* s, memory of the vibration, and of the share of clipped samples. By judgement: some beats of engine and sampling
 * rate. */
static const double VIBRATION_S = 0.5, CLIPPED_S = 2;
/* Hz, s: a vibration of one frequency that changes, such as an engine's, folds to any frequency alike, and falls into
 * the band in which the tilt follows the force with the share of that band of the sampling rate; for so long it is
 * remembered. By judgement. */
static const double TILT_BAND_HZ = 0.3, STRONGEST_S = 2, STEADY_RISES_S = 3, STEADY_FALLS_S = 0.05;
/* m/s^2, what is left of the motion of a hand and of the noise of a chip: no vibration. By judgement. */
static const double HAND_M_S2 = 0.5;
/* 1 sigma of what is beyond the end of the range, as a share of the range. By judgement. */
static const double BEYOND_SHARE = 0.5;
/* Least ranges of chips, less a margin for calibration: 2 g and 125 deg/s. A smaller value is not at the end. */
static const double LEAST_ACCEL_RANGE_M_S2 = 0.9 * 2 * STANDARD_GRAVITY_M_S2,
		    LEAST_GYRO_RANGE_RAD_S = 0.9 * 125 * RAD_PER_DEG;
/* s, for which clipping counts as recent. */
static const double LATELY_S = 1;

/* The fourth difference, scaled so that white noise keeps its variance: of a motion of 2 Hz, sampled at 40 Hz, 1 % is
 * left (of the second difference 4 %). */
static double fourth_difference2(struct vec3 now, const struct vec3 before[4])
{
	struct vec3 even = vec3_add(vec3_add(now, vec3_scale(6, before[1])), before[3]);
	struct vec3 d = vec3_sub(even, vec3_scale(4, vec3_add(before[0], before[2])));

	return vec3_dot(d, d) / 70;
}

static void remember(struct vec3 before[4], struct vec3 now)
{
	for (int i = 3; i > 0; i--)
		before[i] = before[i - 1];
	before[0] = now;
}

static double largest(struct vec3 v)
{
	return fmax(fabs(v.x), fmax(fabs(v.y), fabs(v.z)));
}

static void follow(double *mean, double value, double dt_s, double time_s)
{
	*mean += dt_s / (time_s + dt_s) * (value - *mean);
}

void vibration_skip(struct vibration *v)
{
	v->known = 0;
}

static void count_clipped(struct vibration *v, struct vec3 force, struct vec3 gyro, bool saturated, double dt_s)
{
	bool accel = saturated && largest(force) > LEAST_ACCEL_RANGE_M_S2;

	v->gyro_clipped = saturated && largest(gyro) > LEAST_GYRO_RANGE_RAD_S;
	v->clipped_accel += accel;
	v->clipped_gyro += v->gyro_clipped;
	v->end_m_s2 = accel ? largest(force) : v->end_m_s2;
	follow(&v->clipped_share, accel, dt_s, CLIPPED_S);
	v->since_clipped_s = accel || v->gyro_clipped ? 0 : v->since_clipped_s + dt_s;
	v->lately = v->clipped_accel + v->clipped_gyro > 0 && v->since_clipped_s < LATELY_S;
}

void vibration_step(struct vibration *v, struct vec3 force, struct vec3 gyro, bool saturated, double dt_s)
{
	double clipped, folded, steady;

	count_clipped(v, force, gyro, saturated, dt_s);
	if (v->known == 4) {
		double force2 = fourth_difference2(force, v->force_b_m_s2);

		follow(&v->force_square, force2, dt_s, VIBRATION_S);
		follow(&v->force_length, sqrt(force2), dt_s, STEADY_FALLS_S);
		follow(&v->steady_m_s2, v->force_length, dt_s,
			v->force_length > v->steady_m_s2 ? STEADY_RISES_S : STEADY_FALLS_S);
		follow(&v->gyro_square, fourth_difference2(gyro, v->gyro_b_rad_s), dt_s, VIBRATION_S);
	}
	v->known += v->known < 4;
	remember(v->force_b_m_s2, force);
	remember(v->gyro_b_rad_s, gyro);
	v->rms_m_s2 = sqrt(v->force_square);
	v->rms_rad_s = sqrt(v->gyro_square);
	clipped = v->clipped_share * BEYOND_SHARE * v->end_m_s2;
	steady = sqrt(fmax(0, v->steady_m_s2 * v->steady_m_s2 - HAND_M_S2 * HAND_M_S2));
	v->strongest_m_s2 = fmax(steady, v->strongest_m_s2 * exp(-dt_s / STRONGEST_S));
	folded = v->strongest_m_s2 * sqrt(fmin(1, TILT_BAND_HZ * dt_s));
	v->force_noise_m2_s4 = steady * steady / 3;
	v->force_error_m_s2 = sqrt(clipped * clipped + folded * folded);
}
