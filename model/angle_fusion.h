/* model/angle_fusion.h
 * Smooths given angles (from a camera, or another sensor's own fusion) by the gyro: an error-state Kalman filter of two
 * states per axis, angle error and gyro bias, with the same variances for all axes. It starts at the first given
 * attitude with its full uncertainty, so its gain falls from 1 to the steady state. q_nb turns object into global
 * axes. */
#ifndef MODEL_ANGLE_FUSION_H
#define MODEL_ANGLE_FUSION_H

#include <stdbool.h>

#include "model/noise.h"
#include "model/math/quat.h"

struct angle_fusion {
	struct noise_config noise;
	struct quat q_nb;
	struct vec3 gyro_bias_b_rad_s;
	/* PRIVATE */
	double p_angle, p_cross, p_bias; /* covariance of one axis */
	bool started;
};

/** 0, or -EINVAL: angle sigma or gyro density not above 0, or a negative instability. */
int angle_fusion_init(struct angle_fusion *f, const struct noise_config *noise);
/** One sample, dt_s > 0 after the one before: the mean rate since then, and the attitude given for now. */
void angle_fusion_step(struct angle_fusion *f, struct vec3 gyro_b_rad_s, struct quat given_q_nb, double dt_s);

#endif
