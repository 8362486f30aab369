/* model/rest.h
 * Rest detection: gyro and accelerometer both stay close to their slow mean, and the gyro's mean
 * close to zero, for a while. Rest ends with the first sample that does not. After the rest
 * detection of VQF (D. Laidig and T. Seel, "VQF: Highly accurate IMU orientation estimation with
 * bias estimation and magnetic disturbance rejection", 2023). */
#ifndef MODEL_REST_H
#define MODEL_REST_H

#include "model/math/vec3.h"

struct rest_config {
	double gyro_threshold_rad_s; /* > 0: deviation from the slow mean, and the mean itself; so a
					gyro with a larger bias has to be calibrated first */
	double accel_threshold_m_s2; /* > 0: deviation from the slow mean */
	double time_s;		     /* >= 0: all of them below for that long: at rest */
};

struct rest {
	struct rest_config config;
	/* PRIVATE */
	struct vec3 gyro, accel; /* the noise of quick sampling smoothed away */
	struct vec3 gyro_mean, accel_mean;
	double still_s; /* since the last motion */
	bool primed;
};

/** 0, or -EINVAL with *r untouched: a field out of its range. */
int rest_init(struct rest *r, const struct rest_config *config);
/** The same while it runs: the means and the time already still stay. */
int rest_configure(struct rest *r, const struct rest_config *config);
/** The next sample starts anew: not at rest. */
void rest_restart(struct rest *r);
/** One calibrated sample, dt_s > 0 after the one before. Returns true at rest. */
bool rest_step(struct rest *r, struct vec3 gyro_b_rad_s, struct vec3 force_b_m_s2, double dt_s);

#endif
