/* model/fusion.h
 * Attitude from gyro, accelerometer and magnetometer by one of three filters: Madgwick's and Mahony's, the two usual
 * ones when the seed paper was written, and an error-state Kalman filter (fusion_kalman.h), the default.
 *
 * Madgwick's and Mahony's integrate the gyro and turn the attitude a little with each sample, so that gravity and
 * magnetic north, predicted in the object frame, come closer to the measured directions. Both use as error the small
 * rotation e = a x v_up (+ m x v_field), with a, m the unit measurements and v the predictions. It is minus the
 * gradient of Madgwick's objective in the tangent space of the unit quaternions. They differ in the step: Madgwick's
 * has a fixed length, Mahony's is proportional to e, with an integral part that estimates the gyro bias.
 *
 * Sources: S. Madgwick, "An efficient orientation filter for inertial and inertial/magnetic sensor arrays", 2010, and
 * Madgwick et al., ICORR 2011 (the seed's [10]); R. Mahony et al., "Nonlinear complementary filters on the special
 * orthogonal group", IEEE TAC 53(5), 2008. Frames: q_nb turns the object frame b into ENU n, y = magnetic north. */
#ifndef MODEL_FUSION_H
#define MODEL_FUSION_H

#include "model/fusion_kalman.h"
#include "model/math/quat.h"
#include "model/sample.h"

enum fusion_algorithm { FUSION_MADGWICK = 0, FUSION_MAHONY = 1, FUSION_KALMAN = 2 };

struct fusion_config {
	enum fusion_algorithm algorithm; /* default FUSION_KALMAN */
	/** 0: heading from the gyro alone, 0 at the start; 1 (default): from the magnetometer as well. */
	int use_magnetometer;
	/** rad/s, 0..10, default 0.041 (Madgwick's report of 2010): half the rate at which Madgwick's filter turns the
	 * attitude towards the measurements. A smaller one relies on the gyro: less noise, more drift. A larger one
	 * follows accelerations and magnetic disturbances, too. */
	double madgwick_beta;
	/** rad/s per rad, 0..100, default 0.3: proportional gain of Mahony's filter; its inverse is the time constant.
	 * Smaller and larger as for madgwick_beta. */
	double mahony_kp_rad_s;
	/** rad/s^2 per rad, 0..100, default 0.0012: integral gain of Mahony's filter. A smaller one averages the gyro
	 * bias over a longer time. A larger one finds it sooner, and oscillates above kp^2 / 4. */
	double mahony_ki_rad_s2;
	/** Its heading_sigma_rad also weighs fusion_aid_yaw() for the other filters. */
	struct fusion_kalman_config kalman;
	/** m, default 0: reference point -> accelerometer. Only the Kalman filter uses it. The pipeline sets it. */
	struct vec3 lever_arm_b_m;
	/** s, 0..0.1, default 0: age of the gyro's sample at its time stamp, over which fusion_attitude_now()
	 * extrapolates by the rate. Too small a value leaves the attitude late by the rest, too large a one makes it
	 * early. The pipeline sets it. */
	double delay_s;
	/** s, >= 0, default 0: usual interval between samples. Only intervals beyond 2.5 of it are gaps, if that is
	 * more than 0.1 s and less than 0.5 s. The pipeline sets it. */
	double interval_s;
};

struct fusion {
	struct fusion_config config;
	struct quat q_nb;
	/** Estimates: the bias at rest and by Mahony's integral, or bias and scale by the Kalman filter. */
	struct gyro_errors gyro_errors;
	/* PRIVATE */
	struct fusion_kalman kalman;
	double bias_time_s; /* of rest in the mean that is the bias; limited */
	struct vec3 last_gyro_b_rad_s;
	struct vec3 alpha_from_b_rad_s; /* rate from which the angular acceleration is measured, */
	double alpha_s;			/* .. so long ago; */
	double alpha2_rad2_s4;		/* its mean square, each axis */
	double unseen_turn_rad; /* each axis, 1 sigma of the turn by missing samples before the last one; 0: none are */
	bool started, north_known, mag_used, resting;
	double steady_s;
	double force_noise_m2_s4, force_error_m_s2; /* of the next sample, see fusion_kalman_sample */
};

/** 0, or -EINVAL with *f untouched: a field out of its range. */
int fusion_init(struct fusion *f, const struct fusion_config *config);
/** The same while the filter runs: attitude and gyro errors stay, the scale only as long as algorithm and
 * gyro_scale_sigma do. If the magnetometer is newly in use and north is unknown, its next measurement sets the
 * heading. */
int fusion_configure(struct fusion *f, const struct fusion_config *config);

/** The next sample initialises the attitude: the tilt by the accelerometer, the heading by the magnetometer or, without
 * one, as it was before, but for what it may have turned in the gap_s without samples. The gyro errors stay. */
void fusion_restart(struct fusion *f, double gap_s);
/** The object frame itself was turned (a new mounting): v_new = R(turn) v_old. */
void fusion_turn_object(struct fusion *f, struct quat turn);

/** The object has been at rest for another dt_s, so the calibrated rate is the gyro's bias. To be called before
 * fusion_step() of this sample. Madgwick's and Mahony's filters estimate the mean over all rest, the last
 * FUSION_BIAS_MEMORY_S of it counting most, so that it follows the temperature; the Kalman filter weighs it itself. */
void fusion_update_bias_at_rest(struct fusion *f, struct vec3 gyro_b_rad_s, double dt_s);
/** The gyro's bias has changed since the last sample, with this variance, each axis: FUSION_KALMAN takes account of
 * it. */
void fusion_bias_drifts(struct fusion *f, double variance_rad2_s2);
/** The gyro has a new calibration: the estimates of its errors are 0 again. */
void fusion_reset_gyro_errors(struct fusion *f);
/** The calibrated rate less the estimated errors. */
struct vec3 fusion_rate_b(const struct fusion *f, struct vec3 gyro_b_rad_s);

/* s. By judgement: averages the gyro's noise to its bias instability, and is short against changes of temperature. */
#define FUSION_BIAS_MEMORY_S 30.0

/** One calibrated sample, dt_s > 0 after the one before (any value for the first). The first sample with a usable
 * accelerometer (length not 0) starts the filter. A measurement without a direction (no magnetometer, length 0, field
 * along the vertical) is not used. */
void fusion_step(struct fusion *f, const struct imu_sample *sample, double dt_s);

/** The attitude at the time stamp of a sample with this calibrated rate: q_nb extrapolated over the delay. */
struct quat fusion_attitude_now(const struct fusion *f, struct vec3 gyro_b_rad_s);

/** Sets the attitude. From then on north is where the field points to in it. */
void fusion_set_attitude(struct fusion *f, struct quat q_nb);
/** A yaw from outside, at the time stamp of the last sample, whose calibrated rate is given. For FUSION_KALMAN it is a
 * measurement; the other filters, which have no covariance, weigh it against heading_sigma_rad. For 10 s after the
 * last one the magnetometer does not correct the heading, but its north in the frame of these yaws is estimated. The
 * first one sets the heading when north is unknown. Within 6 degrees of looking straight up or down it is ignored.
 * Returns whether the attitude jumped. */
bool fusion_aid_yaw(struct fusion *f, double yaw_rad, double sigma_rad, struct vec3 gyro_b_rad_s);
/** The velocity of the reference point from outside, by which FUSION_KALMAN tells tilt from acceleration. The other
 * filters ignore it. */
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

/** The magnetometer is configured, but its field does not turn as the gyro says, or is not the one that set the heading
 * shortly before; FUSION_KALMAN only. */
static inline bool fusion_field_disagrees(const struct fusion *f)
{
	return f->config.use_magnetometer && f->config.algorithm == FUSION_KALMAN &&
	       (fusion_kalman_field_disagrees(&f->kalman) || f->kalman.north_on_trial);
}

/** The force is more wrong than the accelerometer as calibrated, by 0.1 m/s^2 or more; FUSION_KALMAN only. */
static inline bool fusion_force_doubted(const struct fusion *f)
{
	return f->config.algorithm == FUSION_KALMAN && fusion_kalman_force_doubted(&f->kalman);
}

/** The last step used a magnetometer measurement. */
static inline bool fusion_mag_used(const struct fusion *f)
{
	return f->mag_used;
}

#endif
