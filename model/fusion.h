/* model/fusion.h
 * Attitude from gyro, accelerometer and magnetometer: the two filters of the seed's time, and a Kalman filter of the first
 * rank (fusion_kalman.h).
 *
 * Madgwick's and Mahony's integrate the gyro and turn the attitude a little each sample so that gravity and magnetic
 * north, as predicted in the object frame, come closer to the measured directions. The error both
 * use is the small rotation e = a x v_up (+ m x v_field),   a, m unit measurements, v the
 * predictions, which is also minus the gradient of Madgwick's objective in the tangent space of the
 * unit quaternions. They differ in the step: Madgwick's has a fixed length, Mahony's is
 * proportional to e, with an integral part that learns gyro bias.
 *
 * Sources: S. Madgwick, "An efficient orientation filter for inertial and inertial/magnetic sensor
 * arrays", 2010, and Madgwick et al., ICORR 2011 (the seed's [10]); R. Mahony et al., "Nonlinear
 * complementary filters on the special orthogonal group", IEEE TAC 53(5), 2008. Frames: q_nb turns
 * the object frame b into ENU n, y = magnetic north. */
#ifndef MODEL_FUSION_H
#define MODEL_FUSION_H

#include "model/fusion_kalman.h"
#include "model/math/quat.h"
#include "model/sample.h"

enum fusion_algorithm { FUSION_MADGWICK = 0, FUSION_MAHONY = 1, FUSION_KALMAN = 2 };

struct fusion_config {
	enum fusion_algorithm algorithm;
	int use_magnetometer;	 /* 0: 6D, heading free, 0 at the start; 1: 9D */
	double madgwick_beta;	 /* rad/s, 0..10: half the rate at which the attitude is turned */
	double mahony_kp_rad_s;	 /* 0..100: turn per error; 1 / kp is the time constant */
	double mahony_ki_rad_s2; /* 0..100: gyro bias learnt per error */
	struct fusion_kalman_config kalman;
	struct vec3 lever_arm_b_m; /* reference point -> accelerometer; the Kalman filter heeds it */
	double delay_s;		   /* 0..0.1: age of the gyro's sample at its time stamp */
};

struct fusion {
	struct fusion_config config;
	struct quat q_nb;
	struct gyro_errors learnt; /* the bias at rest, by Mahony's integral; both by the Kalman filter */
	/* PRIVATE */
	struct fusion_kalman kalman;
	double bias_time_s; /* of rest, learnt from */
	struct vec3 last_gyro_b_rad_s;
	bool started, north_known, mag_used, resting;
};

/** 0, or -EINVAL with *f untouched: a field out of its range. */
int fusion_init(struct fusion *f, const struct fusion_config *config);
/** The same for a filter that runs: attitude and gyro bias stay. With the magnetometer newly in use and
 * north never seen before, the heading is set by the next measurement of it. */
int fusion_configure(struct fusion *f, const struct fusion_config *config);

/** The next sample finds the attitude anew: tilt from the accelerometer, heading from the
 * magnetometer or, without it, the one held before. The gyro bias stays. */
void fusion_restart(struct fusion *f);
/** The object frame itself was turned (a new mounting): v_new = R(turn) v_old. */
void fusion_turn_object(struct fusion *f, struct quat turn);

/** The gyro, calibrated, at rest for another dt_s: that is its bias. Tell it before the step of this sample. Learns the mean
 * over all rest, the last FUSION_BIAS_MEMORY_S of it counting most, so that it follows the temperature (the Kalman filter by
 * its own weights). */
void fusion_learn_bias(struct fusion *f, struct vec3 gyro_b_rad_s, double dt_s);
/** The gyro was calibrated anew: no errors, nothing learnt. */
void fusion_forget_errors(struct fusion *f);
/** What the gyro would have shown without the errors learnt. */
struct vec3 fusion_rate_b(const struct fusion *f, struct vec3 gyro_b_rad_s);

#define FUSION_BIAS_MEMORY_S 30.0

/** One calibrated sample, dt_s > 0 after the one before (any value for the first). The first sample
 * with a usable accelerometer (length not 0) starts the filter. A measurement that shows no
 * direction (no magnetometer, length 0, field along the vertical) is left out of that step. */
void fusion_step(struct fusion *f, const struct imu_sample *sample, double dt_s);

/** The attitude at the time stamp of a sample with this (calibrated) rate: ahead of q_nb by the delay. */
struct quat fusion_attitude_now(const struct fusion *f, struct vec3 gyro_b_rad_s);

/** The attitude from outside, taken as it is. Where the field points to from there is its north from now on. */
void fusion_set_attitude(struct fusion *f, struct quat q_nb);
/** The yaw at the time stamp of the last sample, of this (calibrated) rate, from outside. For FUSION_KALMAN a measurement;
 * the others, which know no sigma of their own, take it for as good as heading_sigma. While it comes (10 s) the
 * magnetometer does not count, but learns where its north lies. The first one, where north is not known, sets the heading.
 * No use looking straight up or down. Returns whether the attitude jumped. */
bool fusion_aid_yaw(struct fusion *f, double yaw_rad, double sigma_rad, struct vec3 gyro_b_rad_s);
/** The velocity of the reference point from outside: FUSION_KALMAN then tells tilt from acceleration by it. */
void fusion_aid_velocity(struct fusion *f, struct vec3 velocity_n_m_s, double sigma_m_s, struct vec3 gyro_b_rad_s);

/** q_nb is an attitude, not the identity it holds before the first usable sample. */
static inline bool fusion_started(const struct fusion *f)
{
	return f->started;
}

/** A magnetometer measurement, or a yaw from outside, has set the heading since the start or restart. */
static inline bool fusion_north_known(const struct fusion *f)
{
	return f->north_known;
}

/** The last step used a magnetometer measurement. */
static inline bool fusion_mag_used(const struct fusion *f)
{
	return f->mag_used;
}

#endif
