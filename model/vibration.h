/* model/vibration.h
 * What samples cannot show of the motion between them: vibration beyond half the sampling rate, and values beyond the
 * end of a sensor's range. Both falsify the mean force, which is all that tilt and velocity rest on.
 *
 * - Vibration shows in the fourth difference of the samples, as far as it does not fold to a low frequency. What folds
 *   is as large as what shows: white noise from sample to sample. The mean of a vibrating chip is wrong by a share that
 *   grows with the square of it: non-linearity, and clipping before the chip's low-pass, which no sample shows.
 * - A clipped axis was beyond its end by half of the range, by judgement, so the mean is wrong by the share of the
 *   clipped samples of that.
 *
 * A vibration near a multiple of the sampling rate looks like a slow acceleration. That cannot be seen here;
 * fusion_kalman.h compares the velocity with its sigma for that, and alias.h looks for its repetition. Pure. */
#ifndef MODEL_VIBRATION_H
#define MODEL_VIBRATION_H

#include <stdbool.h>
#include <stdint.h>

#include "model/math/vec3.h"

/** Zeroed it is ready. */
struct vibration {
	double rms_m_s2, rms_rad_s;	      /* root mean square of the length of the vibration, over half a second */
	uint32_t clipped_accel, clipped_gyro; /* samples at the end of the range of accelerometer and gyro */
	/* error of the force, each axis: variance of what is white from sample to sample, and 1 sigma of its mean */
	double force_noise_m2_s4, force_error_m_s2;
	bool gyro_clipped, lately; /* the last sample; any one of the last second */
	/* PRIVATE */
	struct vec3 force_b_m_s2[4], gyro_b_rad_s[4]; /* the samples before */
	int known;
	double force_square, force_length, steady_m_s2, gyro_square, clipped_share, end_m_s2, strongest_m_s2,
		since_clipped_s;
};

/** One calibrated sample. `saturated`: a value of any sensor is at the end of its range. */
void vibration_step(
	struct vibration *v, struct vec3 force_b_m_s2, struct vec3 gyro_b_rad_s, bool saturated, double dt_s);
/** After a gap: the next sample begins the observation. Counters and what is known of the last seconds stay. */
void vibration_skip(struct vibration *v);

#endif
