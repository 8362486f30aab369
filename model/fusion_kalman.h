/* model/fusion_kalman.h
 * Attitude by an error-state Kalman filter. The gyro turns the attitude with every sample. Some 30 times a second the
 * filter propagates the covariance of 11 errors (attitude, horizontal velocity, gyro bias, gyro scale) over the samples
 * since the last correction, and applies these measurements:
 *
 * - Tilt. The specific force in the global frame is integrated to a horizontal velocity, which is measured to be zero
 *   within its spread. An error of the tilt takes gravity for acceleration and lets that velocity grow without end, so
 *   it shows. In steady state this is a second-order Butterworth low-pass of the accelerometer in an almost inertial
 *   frame. Its time constant grows with the spread of the velocities seen and with the quality of the gyro. At rest the
 *   velocity is zero within 1 cm/s, and the tilt is that of the accelerometer within seconds.
 * - Lever arm. The velocity is that of the reference point: the lever arm's share omega x r is subtracted, which needs
 *   no angular acceleration.
 * - Heading, by the direction of the magnetic field. Its variance grows with the deviation of length and dip from their
 *   reference. A field beyond the limits is rejected. It becomes the reference after it has stayed the same in
 *   attitudes far apart for 20 s (the field of a magnet nearby does not), and it counts with a small weight after the
 *   rejection time. A heading that is off by more than any gyro drifts is an outlier, and rejected for the same time.
 *   An object that does not turn sees the same error of the field again and again, so such measurements are correlated
 *   and weigh less.
 * - Gyro bias, in motion through tilt and heading, at rest from the gyro itself. Of two steady rates in a row after the
 *   start, one may be a turn: the bias is uncertain by as much until the first one returns.
 * - Gyro scale, through the tilt of an object that turns to different sides: 0.2 % of a turn is 0.7 degrees. A measured
 *   heading does not estimate the scale, it only accounts for its uncertainty (consider states of a Schmidt-Kalman
 *   filter): the field of a magnet in the object would look just like a scale error. Nor does the tilt if nobody
 *   calibrated the scale, since a lever arm that is not configured looks like one, too.
 * - Error of the force by vibration and clipping (vibration.h), and by what a steady force or a high velocity
 *   contradicts: the accelerometer's bias is uncertain by as much for some seconds. Such a force does not re-initialise
 *   the tilt.
 * - A steady turn about the vertical may be a circle: the accelerometer's bias is uncertain by the rate times the
 *   spread of the velocity.
 * - Agreement of field and gyro (hard_iron.h). A hard-iron offset that the motion shows is subtracted. While the field
 *   does not turn as the gyro says, it is not used, and a heading that it gave is unknown.
 * - Heading and velocity from outside, with the sigma given. While headings come, the magnetometer only estimates where
 *   its north lies in their frame. While velocities come, the last one is the expected velocity in place of zero.
 *
 * A tilt that is off by more than 60 degrees cannot be corrected by a linear filter. It is re-initialised from the mean
 * force.
 *
 * Sources: D. Laidig and T. Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and magnetic
 * disturbance rejection", Information Fusion 91, 2023 (low-pass in the almost inertial frame, limits and times of the
 * field, bias at rest); S. F. Schmidt, "Application of state-space methods to navigation problems", Advances in Control
 * Systems 3, 1966; J. Sola, "Quaternion kinematics for the error-state Kalman filter", 2017 (the errors). */
#ifndef MODEL_FUSION_KALMAN_H
#define MODEL_FUSION_KALMAN_H

#include "model/hard_iron.h"
#include "model/math/quat.h"
#include "model/math/units.h"

/** Start from FUSION_KALMAN_DEFAULTS. All of it can be changed while the filter runs. */
struct fusion_kalman_config {
	/** m/s, 0.01..1000, default 1: upper limit of the 1 sigma of the reference point's horizontal velocity in
	 * motion. The sigma in use follows the velocities seen, down to 0.35 of it. A smaller one lets the tilt
	 * follow the accelerometer faster: less drift, but a long acceleration is taken for tilt. A larger one suits
	 * vehicles that keep a speed for long, and needs a better gyro. */
	double velocity_sigma_m_s;
	/** rad, 0.001..1, default 2 degrees: 1 sigma of the heading of the undisturbed field in one attitude
	 * (calibration of the magnetometer, iron in the building). A smaller one follows the magnetometer faster, and
	 * its disturbances, too. A larger one relies on the gyro for longer. */
	double heading_sigma_rad;
	/** 0.01..1, default 0.1: innovation gate of the field. Rejected is a length that differs from the reference by
	 * more than this share of it, or a dip that differs by more than twice this in radians. A smaller one rejects
	 * weaker disturbances, but a badly calibrated magnetometer altogether. A larger one accepts more
	 * disturbance. */
	double field_limit;
	/** s, 0..1e6, default 60: for so long in total a disturbed field, or a heading that is an outlier, is rejected.
	 * Then the field counts with a small weight, and an outlier is taken for the truth. A smaller one returns
	 * earlier from a wrong heading. A larger one withstands longer disturbances, on a gyro that holds the heading
	 * meanwhile. */
	double rejection_time_s;
	/** 0..0.1, default 0.001: 1 sigma of the gyro's error in motion as a share of the rate (cross-axis sensitivity,
	 * non-linearity, timing). A smaller one relies on the gyro in fast motion. A larger one corrects more there. */
	double gyro_error;
	/** rad/s/sqrt(s), 0..0.1, default 0.0025 deg/s/sqrt(s): random walk of the gyro bias. A smaller one averages
	 * the bias over a longer time. A larger one follows quicker changes of temperature, with more noise. */
	double bias_walk_rad_s_sqrt_s;
	/** 0..0.05, default 0.002: 1 sigma of the gyro's scale factors as calibrated; 0: they are exact and not
	 * estimated. A smaller one trusts the calibration. A larger one is for a gyro whose scale was never
	 * calibrated: beyond 0.005 it is not estimated. The estimate stays within five of it. */
	double gyro_scale_sigma;
	/** uT, 0..1000, default 0.5: 1 sigma of one sample of the field, each axis, white.
	 * noise_config.mag_sigma_uT. */
	double field_sigma_uT;
	/** 1 sigma of what each sensor's calibration leaves, each axis: rad/s, 0..10, default 0.5 deg/s, of the gyro's
	 * bias at the start, as in VQF; m/s^2, 0..10, default 0.03 (3 mg), of the accelerometer's, by judgement what
	 * six attitudes leave; uT, 0..1000, default 0, of a hard-iron offset that no motion has shown yet. Smaller ones
	 * claim more than is known, larger ones let the sensor count less. The pipeline sets them. */
	double bias_sigma_rad_s, accel_sigma_m_s2, offset_sigma_uT;
};

#define FUSION_KALMAN_DEFAULTS                                                                               \
	{                                                                                                    \
		.velocity_sigma_m_s = 1, .heading_sigma_rad = 2 * RAD_PER_DEG, .field_limit = 0.1,           \
		.rejection_time_s = 60, .gyro_error = 0.001, .bias_walk_rad_s_sqrt_s = 0.0025 * RAD_PER_DEG, \
		.gyro_scale_sigma = 0.002, .field_sigma_uT = 0.5, .bias_sigma_rad_s = 0.5 * RAD_PER_DEG,     \
		.accel_sigma_m_s2 = 0.03,                                                                    \
	}

/** Estimated errors of the gyro: true rate = (1 + scale) (gyro - bias). The scale is that of the object's axes, which
 * are the gyro's unless the mounting is oblique. */
struct gyro_errors {
	struct vec3 bias_b_rad_s, scale_b;
};

/* Errors in the state: attitude x y z (rad, global), velocity x y (m/s, global), gyro bias x y z (rad/s, object), gyro
 * scale x y z, accelerometer bias x y z (m/s^2, object). The last is a consider state (Schmidt-Kalman): it is not
 * estimated, but its variance and its correlations count, so that a systematic tilt is not taken for gyro bias. */
enum {
	KALMAN_ATTITUDE = 0,
	KALMAN_HEADING = 2,
	KALMAN_VELOCITY = 3,
	KALMAN_BIAS = 5,
	KALMAN_SCALE = 8,
	KALMAN_ACCEL = 11,
	KALMAN_STATES = 14
};

/** Integrals over the samples since the last correction. */
struct fusion_kalman_sums {
	double time_s, rest_s;		     /* and how much of it the object was at rest */
	double turned_up_rad;		     /* about the vertical */
	double turned_rad2_s;		     /* of the squared rate */
	double force_noise_m2_s2;	     /* variance of the velocity by white noise of the force */
	double force_error_m_s2;	     /* the largest of the samples */
	double unmeasured_turn_rad;	     /* 1 sigma of the turn that a saturated gyro did not measure */
	double rotation_s[3][3];	     /* of the rotation matrix object -> global */
	double rotation_rate_rad[3][3];	     /* of its columns times the rates about the object's axes */
	struct vec3 force_n_m_s, gyro_b_rad; /* of specific force and uncorrected rate */
	struct vec3 field_n_uT, field_b_uT;  /* sums of the fields, not integrals */
	double steady_s;		     /* of the last sample */
	int fields;
	struct vec3 lever_from_n_m_s; /* the lever arm's velocity omega x r when they began */
};

struct fusion_kalman {
	double covariance[KALMAN_STATES][KALMAN_STATES];
	/* PRIVATE */
	double velocity_n_m_s[2];      /* of the accelerometer, horizontal */
	double spread_m2_s2;	       /* variance of the reference point's velocity, one axis */
	struct vec3 mean_force_n_m_s2; /* over the last second */
	struct fusion_kalman_sums sums;
	struct vec3 lever_arm_b_m, lever_n_m_s; /* of the last sample: lever arm, and omega x r */
	bool lever_known;
	/* sum of the turns about the vertical since the heading was known, and its greatest absolute value */
	double net_turn_rad, net_turn_max_rad;
	/* rest */
	bool resting;			/* what is steady, does not turn */
	struct vec3 mean_rate_b_rad_s;	/* over 0.3 s, less the bias */
	struct vec3 block_b_rad;	/* integral of the rate over the current block of a second of steady samples, */
	double block_s;			/* .. its duration */
	struct vec3 last_block_b_rad_s; /* .. and the mean of the one before, */
	bool last_block_known;		/* .. if there was one */
	struct vec3 block_field_b_uT, last_block_field_b_uT; /* sum of its fields, and the mean of the one before */
	int block_fields;
	bool bias_known;				   /* estimated at rest, since it was reset */
	bool has_moved;					   /* since the start; until then the whole rate may be bias */
	struct vec3 first_rate_b_rad_s, last_rate_b_rad_s; /* means over 0.3 s */
	bool began_steady;				   /* nothing moved while the first one was measured */
	struct vec3 doubted_rate_b_rad_s;		   /* the last one that was measured as bias */
	bool turning;					   /* that one differs from the bias by more than its sigma */
	double since_start_s, since_tilt_s;	  /* since the filter started, and since the force has set the tilt */
	double mean_force_m_s2, mean_force_s;	  /* mean length of the force, and the time behind it */
	double accel_variance;			  /* of the accelerometer's error, m^2/s^4, without that of vibration */
	bool doubted;				  /* it is larger now */
	double yaw_rate_rad_s, yaw_rate2_rad2_s2; /* means of the rate about the vertical and of its square, */
	double circle_m2_s4;			  /* .. and variance of the centripetal acceleration by it */
	double velocity2_m2_s2;			  /* mean square of the measured velocity */
	double lost_s;				  /* for how long the mean force has been far from the vertical */
	/* the field's reference, and the candidate that may replace it */
	double norm_uT, dip_rad, reference_s; /* norm 0: no reference; reference_s: time of fields behind it, limited */
	double candidate_norm_uT, candidate_dip_rad, candidate_s, candidate_rotation_s[3][3];
	struct vec3 rest_field_n_uT; /* mean of the first second at rest */
	double rest_field_s;
	double disturbance2_uT2;	    /* mean square of the field's difference from the reference, lately */
	double heading_by_disturbance_rad2; /* variance that the heading owes to it */
	double undisturbed_s, rejected_s, outlier_s; /* see fusion_kalman_config.rejection_time_s */
	/* aids */
	double north_rad;	/* direction of the field, clockwise from y; 0 unless a heading was set or aided */
	bool north_unknown;	/* the next field defines it */
	double aided_heading_s; /* for so long the last heading from outside holds */
	int heading_rejections; /* of headings from outside, in a row */
	struct hard_iron hard_iron;
	struct vec3
		heading_by_offset_rad_uT; /* how an offset of the field in the object frame has turned the heading, */
	struct vec3 field_by_offset_1_uT; /* .. and the share by which it added to the horizontal field */
	bool north_from_field;		  /* the heading was set by the field, not from outside */
	bool north_on_trial; /* .. in place of another one, and that field has not been seen for long enough */
	bool north_lost;     /* and the field has shown since that it was wrong: to be set anew by the next one */
	double aided_velocity_n_m_s[2], aided_velocity_s; /* the last from outside, and for how long it holds */
};

/** 0, or -EINVAL: a field out of its range. */
int fusion_kalman_check(const struct fusion_kalman_config *config);
/** A new attitude whose tilt is that of a force of this length. The estimates of the gyro's errors stay. The very first
 * time, zero the struct before. */
void fusion_kalman_start(struct fusion_kalman *k, const struct fusion_kalman_config *config, double force_m_s2);
/** The heading was set by this field. */
void fusion_kalman_set_north(
	struct fusion_kalman *k, const struct fusion_kalman_config *config, struct quat q_nb, struct vec3 field_n_uT);
/** The gyro's bias has changed since the last sample, with this variance, each axis. */
void fusion_kalman_bias_drifts(struct fusion_kalman *k, double variance_rad2_s2);
/** The estimates of the gyro's errors, or of its scale alone, were reset: their variances are those of the start. */
void fusion_kalman_reset_gyro_errors(struct fusion_kalman *k, const struct fusion_kalman_config *config);
void fusion_kalman_reset_scale(struct fusion_kalman *k, const struct fusion_kalman_config *config);
/** The accelerometer has another calibration. */
void fusion_kalman_reset_accelerometer(struct fusion_kalman *k, const struct fusion_kalman_config *config);

/** The attitude was set from outside, heading included, with a 1 sigma of one degree. */
void fusion_kalman_set_attitude(struct fusion_kalman *k, const struct fusion_kalman_config *config);
/** The heading was set from outside. */
void fusion_kalman_set_heading(struct fusion_kalman *k, double variance_rad2);
/** A heading from outside: innovation_rad is the turn about the vertical that would bring the attitude to it. Beyond
 * the innovation gate it is rejected, but the fifth in a row is applied as it is. Returns whether the attitude
 * jumped. */
bool fusion_kalman_aid_heading(struct fusion_kalman *k, const struct fusion_kalman_config *config,
	double innovation_rad, double variance_rad2, struct quat *q_nb, struct gyro_errors *gyro_errors);
/** The velocity of the reference point from outside. lever_n_m_s: the accelerometer's velocity relative to it. */
void fusion_kalman_aid_velocity(struct fusion_kalman *k, const struct fusion_kalman_config *config,
	struct vec3 velocity_n_m_s, struct vec3 lever_n_m_s, double variance_m2_s2, struct quat *q_nb,
	struct gyro_errors *gyro_errors);

/** It may have turned by that much more or less while nothing was measured, 1 sigma about each axis. */
void fusion_kalman_doubt_attitude(struct fusion_kalman *k, double turn_rad);

/** The object frame was turned, v_new = R(turn) v_old. The bias turns with it, the scale is reset. */
void fusion_kalman_turn_object(struct fusion_kalman *k, const struct fusion_kalman_config *config, struct quat turn,
	struct gyro_errors *gyro_errors);

struct fusion_kalman_sample {
	struct vec3 gyro_b_rad_s, rate_b_rad_s; /* calibrated, and less the estimated errors */
	struct vec3 force_b_m_s2;		/* specific force; 0: none */
	const struct vec3 *field_b_uT;		/* NULL: none */
	struct vec3 lever_arm_b_m;		/* reference point -> accelerometer */
	/* of the force's error by vibration and clipping, each axis: variance of what is white from sample to sample,
	 * and 1 sigma of what stays the same for seconds */
	double force_noise_m2_s4, force_error_m_s2;
	bool rest, saturated;	/* saturated: the gyro */
	double unseen_turn_rad; /* 1 sigma: samples are missing before this one; 0: none are */
	double steady_s; /* for how long gyro and accelerometer are steady; longer than since the start: not known */
};

/** The field cannot be used now: it does not turn as the gyro says. */
static inline bool fusion_kalman_field_disagrees(const struct fusion_kalman *k)
{
	return k->hard_iron.disagrees;
}
/** The error of the force exceeds that of the calibration by a 1 sigma of 0.1 m/s^2 (0.6 degrees of tilt). */
static inline bool fusion_kalman_force_doubted(const struct fusion_kalman *k)
{
	return k->covariance[KALMAN_ACCEL][KALMAN_ACCEL] > k->accel_variance + k->circle_m2_s4 + 0.01;
}
/** Variance of the heading, rad^2, with what the turns in one direction left behind: of a full turn while the heading
 * was set by a field that cannot be used, or that has just replaced another one. */
double fusion_kalman_heading_variance(const struct fusion_kalman *k, const struct fusion_kalman_config *config);

/** One sample, after the attitude was turned by it. Every 0.03 s it corrects attitude and gyro errors. Returns true
 * when a measured field took part in that. */
bool fusion_kalman_step(struct fusion_kalman *k, const struct fusion_kalman_config *config,
	const struct fusion_kalman_sample *sample, double dt_s, struct quat *q_nb, struct gyro_errors *gyro_errors);

#endif
