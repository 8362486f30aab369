/* model/rest.h
 * Standstill detector: gyro and accelerometer both stay close to their mean over a short window, the mean rate is close
 * to zero, and both short means stay close to a slow one, for a dwell time. The first sample that breaks a condition
 * ends the standstill.
 *
 * It looks at two sensors only, so a motion at constant velocity, without vibration, is a standstill to it. Which
 * motions pass depends on the windows. Three sets of parameters are in use: REST_DEFAULTS, by which the fusion
 * estimates the gyro's bias; STANDSTILL_DEFAULTS, quicker and stricter, for the zero-velocity updates of the
 * navigation; and STANCE_DEFAULTS for those of a foot.
 *
 * Source of the conditions on mean and deviation: D. Laidig and T. Seel, "VQF: Highly accurate IMU orientation
 * estimation with bias estimation and magnetic disturbance rejection", Information Fusion 91, 2023, section on rest
 * detection. The mean square and the slow mean are this project's. */
#ifndef MODEL_REST_H
#define MODEL_REST_H

#include "model/math/units.h"
#include "model/math/vec3.h"

/** Start from REST_DEFAULTS, STANDSTILL_DEFAULTS or STANCE_DEFAULTS. */
struct rest_config {
	/** rad/s, > 0, default 2 deg/s: unit of the limits of the gyro. It has to be above the gyro's noise, or rest is
	 * never seen; a larger one takes quicker changes of the rate for rest. */
	double gyro_threshold_rad_s;
	/** > 0: limit of the length of the mean rate, as a share of the threshold; INFINITY: no limit, a steady turn
	 * passes, too. */
	double rate_share;
	/** m/s^2, > 0, default 0.5: unit of the limits of the accelerometer. It has to be above the vibration of the
	 * support; a larger one takes gentle motions for rest. */
	double accel_threshold_m_s2;
	/** s, >= 0: dwell time, for which all conditions have to hold. A smaller one detects rest earlier, but also in
	 * the turning points of a motion; a larger one misses short stops. */
	double time_s;
	/** s, > 0: time constant of the short mean. Longer than a period of the vibration, or the mean follows it;
	 * shorter than the dwell time, or rest begins late. */
	double mean_time_s;
	/** s, >= 0: time constant of the mean square of the deviation from the short mean. 0: each sample counts by
	 * itself, which ends rest at once but also by a single outlier. */
	double deviation_time_s;
	/** > 0: limit of that deviation's root mean square, as a share of the thresholds. A smaller one detects gentler
	 * motions and needs a quieter sensor. */
	double deviation_share;
	/** s, > 0: time constant of the slow mean. A larger one detects slower changes. */
	double drift_time_s;
	/** > 0: limit of the distance between short and slow mean, as a share of the thresholds; INFINITY: no limit. A
	 * smaller one detects motions that begin so gently that the deviation stays small. */
	double drift_share;
};

/** For the gyro's bias. Thresholds, dwell and window as VQF's defaults, for the short mean an exponential one in place
 * of its second-order low-pass. */
#define REST_DEFAULTS                                                                                              \
	{                                                                                                          \
		.gyro_threshold_rad_s = 2 * RAD_PER_DEG, .rate_share = INFINITY, .accel_threshold_m_s2 = 0.5,      \
		.time_s = 1.5, .mean_time_s = 0.5, .deviation_time_s = 0, .deviation_share = 1, .drift_time_s = 5, \
		.drift_share = INFINITY,                                                                           \
	}

/** For zero-velocity updates: a movement ends within half a second, and even a gentle one is seen. Window, dwell and
 * shares were chosen on the recorded trials of BROAD with breaks and on simulated gentle drives. */
#define STANDSTILL_DEFAULTS                                                                                           \
	{                                                                                                             \
		.gyro_threshold_rad_s = 2 * RAD_PER_DEG, .rate_share = 1, .accel_threshold_m_s2 = 0.5, .time_s = 0.3, \
		.mean_time_s = 0.15, .deviation_time_s = 0.15, .deviation_share = 0.5, .drift_time_s = 5,             \
		.drift_share = 0.2,                                                                                   \
	}

/** For the stances of a foot: rate and acceleration are above those of what stands, and the attitude differs from step
 * to step. Chosen on recorded walks, where 20 to 50 deg/s, 1 to 4 m/s^2 and 0.05 to 0.15 s end within the same
 * sigma. */
#define STANCE_DEFAULTS                                                                                              \
	{                                                                                                            \
		.gyro_threshold_rad_s = 30 * RAD_PER_DEG, .rate_share = 1, .accel_threshold_m_s2 = 2, .time_s = 0.1, \
		.mean_time_s = 0.05, .deviation_time_s = 0.05, .deviation_share = 1, .drift_time_s = 5,              \
		.drift_share = INFINITY,                                                                             \
	}

/** Zeroed it is ready: the next sample begins the observation. */
struct rest {
	struct vec3 gyro_mean, accel_mean; /* short means, rad/s and m/s^2 */
	double still_s;			   /* for how long all conditions have held */
	/* PRIVATE */
	struct vec3 gyro, accel; /* low-passed */
	struct vec3 gyro_slow, accel_slow;
	double gyro_square, accel_square; /* mean square of the deviation from the short mean */
	double interval_s;		  /* the usual one between two samples */
	bool started;
};

/** 0, or -EINVAL: a field out of its range. */
int rest_check(const struct rest_config *config);
/** Forgets all: the next sample is not at rest. */
void rest_restart(struct rest *r);
/** One calibrated sample, dt_s > 0 after the one before. The configuration may change between two. Returns true at
 * rest. */
bool rest_step(struct rest *r, const struct rest_config *config, struct vec3 gyro_b_rad_s, struct vec3 force_b_m_s2,
	double dt_s);

/** m^2/s^3, variance of a velocity integrated for a second, each axis, by the accelerometer's deviation from its short
 * mean, taken for white noise of samples dt_s apart. */
double rest_accel_walk_m2_s3(const struct rest *r, double dt_s);

#endif
