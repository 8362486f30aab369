/* model/fusion_kalman.h
 * Attitude as a small Kalman filter of its errors. The gyro turns the attitude with every sample; some 30 times a second
 * what has gathered since then is weighed against what is known of tilt, heading and gyro bias.
 *
 * - Tilt: the specific force, turned into the global frame (which errs so slowly that it is almost inertial), is
 *   integrated. Gravity taken for acceleration grows there without end, a velocity does not: it is zero within its
 *   spread, and that follows the velocities seen. In balance this is a second-order low-pass of the accelerometer with
 *   Butterworth's damping, its time constant the longer, the faster the movement and the better the gyro. At rest the
 *   velocity is zero, and the tilt soon that of the accelerometer.
 * - Lever arm: the velocity is the reference point's. The lever arm's share of it, omega x r, needs no angular
 *   acceleration. Nor does an error of the attitude make an error of that share: it turns with the rest.
 * - Heading: that of the field, doubted by how far length and dip are off their reference: what is seen to be disturbed
 *   along two axes is so along the third. Beyond the limits it is left out, until another field stayed the same
 *   in attitudes far apart (that of a magnet nearby does not), or too long a time has passed; so is one from where north cannot
 *   be. An object that does not turn sees the same error again and again: little is learnt from that.
 * - A tilt so wrong that its error would not show as one (upside down) is found anew from the mean force.
 * - Gyro bias: learnt from tilt and heading in motion, from the gyro itself at rest.
 * - Gyro scale: learnt from the tilt of an object that turns to different sides: it turns the attitude by the same share
 *   of each turn. A few turns about the vertical with a scale wrong by 0.2 % turn the heading by degrees, so without a
 *   magnetometer this is what decides. A heading measured bears on the scale only as an error that is there (a
 *   Schmidt-Kalman filter): a magnet carried along would look just like one.
 * - From outside, a heading and a velocity: as measurements of their own. While they come, the magnetometer only learns
 *   where its north lies in their frame, and the velocity expected is the one last told.
 *
 * Sources of the ideas: D. Laidig and T. Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and
 * magnetic disturbance rejection", Information Fusion 91, 2023 (low-pass in the almost inertial frame, limits and times
 * of the field, bias at rest); S. F. Schmidt, "Application of state-space methods to navigation problems", Advances in
 * Control Systems 3, 1966; J. Sola, "Quaternion kinematics for the error-state Kalman filter", 2017 (the errors). */
#ifndef MODEL_FUSION_KALMAN_H
#define MODEL_FUSION_KALMAN_H

#include "model/math/quat.h"
#include "model/math/units.h"

struct fusion_kalman_config {
	double velocity_sigma_m_s; /* 0.01..1000: of the reference point, at most; a smaller one trusts the
				      accelerometer more */
	double heading_sigma_rad;  /* 0.001..1: error of the undisturbed field's heading in one pose; a smaller one
				      trusts the magnetometer more */
	double field_limit;	   /* 0.01..1: disturbance left out: share of the length, and of a radian of the dip
				      twice that */
	double rejection_time_s;   /* 0..1e6: after so much of it, a disturbed field counts for a little, or the heading
				      would drift for ever */
	double gyro_error;	   /* 0..0.1: of the rate, by cross axes and timing */
	double bias_walk_rad_s_sqrt_s; /* 0..0.1: how the gyro bias wanders */
	double gyro_scale_sigma; /* 0..0.05: of the scale factors as calibrated; 0: they are right, none is learnt */
};

#define FUSION_KALMAN_DEFAULTS                                                                               \
	{                                                                                                    \
		.velocity_sigma_m_s = 1, .heading_sigma_rad = 2 * RAD_PER_DEG, .field_limit = 0.1,           \
		.rejection_time_s = 60, .gyro_error = 0.001, .bias_walk_rad_s_sqrt_s = 0.0025 * RAD_PER_DEG, \
		.gyro_scale_sigma = 0.002,                                                                   \
	}

/** What the gyro gets wrong, as learnt: true rate = (1 + scale) (gyro - bias). The scale is that of the object's axes,
 * which are the gyro's unless it is mounted askew. */
struct gyro_errors {
	struct vec3 bias_b_rad_s, scale_b;
};

/* errors of attitude x y z (rad, global), velocity x y (m/s, global), gyro bias x y z (rad/s, object), gyro scale x y z
 * (object) */
enum {
	KALMAN_ATTITUDE = 0,
	KALMAN_HEADING = 2,
	KALMAN_VELOCITY = 3,
	KALMAN_BIAS = 5,
	KALMAN_SCALE = 8,
	KALMAN_STATES = 11
};

struct fusion_kalman {
	double covariance[KALMAN_STATES][KALMAN_STATES];
	/* PRIVATE */
	double velocity_n_m_s[2];      /* of the accelerometer, horizontal */
	struct vec3 lever_arm_b_m;     /* of the last sample */
	double spread_m2_s2;	       /* of the velocity, an axis */
	struct vec3 mean_force_n_m_s2; /* over a second */
	/* gathered since the last correction */
	double lost_rad;				    /* 1 sigma of the turn that a saturated gyro did not show */
	double time_s, rest_s, turned_rad2_s, turn_s[3][3]; /* turn_s: integral of the rotation matrix, */
	double rate_turn_rad[3][3];			    /* .. and of that, its columns times the rates */
	struct vec3 force_n_m_s, gyro_b_rad, field_n_uT;
	int fields;
	struct vec3 lever_n_m_s, lever_from_n_m_s; /* omega x r now, and when gathering began */
	bool lever_known;
	/* the field, x its length, y its dip: the reference, and what may become it */
	double norm_uT, dip_rad, other_norm_uT, other_dip_rad, other_s, other_turn_s[3][3];
	struct vec3 still_field_n_uT; /* since the beginning of a rest */
	double still_s;
	double reference_s, undisturbed_s, rejected_s, astray_s;
	double north_rad; /* where the field points to, clockwise from y; open: the next field tells */
	bool north_open;
	double yaw_s; /* for so long the heading last told still holds */
	int yaw_refused;
	double told_n_m_s[2], told_s; /* the velocity last told, and for how long it still holds */
};

/** 0, or -EINVAL: a field out of its range. */
int fusion_kalman_check(const struct fusion_kalman_config *config);
/** A new attitude, its tilt that of a force of this length; the gyro's bias as known as before. The very first time,
 * zero the struct. */
void fusion_kalman_start(struct fusion_kalman *k, const struct fusion_kalman_config *config, double force_m_s2);
/** The heading was set by the field. */
void fusion_kalman_north(struct fusion_kalman *k, const struct fusion_kalman_config *config);
/** Nothing is known of the gyro's errors, of its scale, but what the configuration says. */
void fusion_kalman_forget_errors(struct fusion_kalman *k, const struct fusion_kalman_config *config);
void fusion_kalman_forget_scale(struct fusion_kalman *k, const struct fusion_kalman_config *config);

/** The attitude was set from outside, heading included, true to a degree. */
void fusion_kalman_set(struct fusion_kalman *k, const struct fusion_kalman_config *config);
/** The heading was set from outside. */
void fusion_kalman_set_heading(struct fusion_kalman *k, double variance_rad2);
/** A heading from outside: the attitude is to be turned by off_rad about the vertical. What the filter does not believe is
 * refused, the fifth time in a row it is taken as it is. Returns whether the attitude jumped. */
bool fusion_kalman_aid_heading(struct fusion_kalman *k, const struct fusion_kalman_config *config, double off_rad,
	double variance_rad2, struct quat *q_nb, struct gyro_errors *learnt);
/** The velocity of the reference point from outside; lever_n_m_s: that of the accelerometer beyond it. */
void fusion_kalman_aid_velocity(struct fusion_kalman *k, const struct fusion_kalman_config *config,
	struct vec3 velocity_n_m_s, struct vec3 lever_n_m_s, double variance_m2_s2, struct quat *q_nb,
	struct gyro_errors *learnt);

/** The object frame was turned: v_new = R(turn) v_old, the bias learnt, too; the scale is forgotten. */
void fusion_kalman_turn(struct fusion_kalman *k, const struct fusion_kalman_config *config, struct quat turn,
	struct gyro_errors *learnt);

/* What one sample shows. */
struct fusion_kalman_sample {
	struct vec3 gyro_b_rad_s, rate_b_rad_s; /* as measured, and corrected by what was learnt */
	struct vec3 force_b_m_s2;		/* 0: none */
	const struct vec3 *field_b_uT;		/* NULL: none */
	struct vec3 lever_arm_b_m;		/* reference point -> accelerometer */
	bool rest, saturated;
};

/** One sample, after the attitude was turned by it. Corrects attitude and errors now and then; returns true when the field
 * took part in that. */
bool fusion_kalman_step(struct fusion_kalman *k, const struct fusion_kalman_config *config,
	const struct fusion_kalman_sample *sample, double dt_s, struct quat *q_nb, struct gyro_errors *learnt);

#endif
