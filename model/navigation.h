/* model/navigation.h
 * Velocity and position by an error-state Kalman filter: gyro and accelerometer are integrated (strapdown), and 15
 * errors are estimated beside: attitude, velocity, position (global frame n), gyro and accelerometer bias (object frame
 * b). What corrects them:
 *   standing still: velocity zero, rate zero (and through both the tilt and the biases);
 *   the fusion: its heading, never its tilt, which rests on the same accelerometer;
 *   levelling, or a prior of the user's: the velocity of a movement has the mean 0 and a known spread.
 *
 * The error of the attitude is a small rotation in the global frame, q_true = exp(theta) q. So the way from one sample
 * to the next adds up over samples, and the covariance takes many of them at once (NAVIGATION_INTERVAL_S), exactly as it
 * would one by one:
 *   theta += -S bg,  v += -[f]x theta + V bg - S ba,  p += T v - [F]x theta + W bg - U ba.
 *
 * The errors of velocity and position grow together and their covariance knows how: the velocity left at a standstill
 * corrects the position of the whole movement before it. So the displacement at a standstill is that of a fixed-interval
 * smoother over the movement, which at its last point is the filter. The points before it are corrected by smoother.h, which
 * is told each transition and measurement.
 *
 * Levelling: over more than a few seconds no accelerometer can tell tilt from acceleration; every attitude filter
 * presumes that the acceleration averages out. Here the same is said of the reference point's velocity, from 5 s into a movement on, and how
 * firmly follows from the movement itself: its spread is that of the quick part of the velocity (above 1 / (2 pi
 * NAVIGATION_QUICK_S) Hz), which tilt does not falsify. A vehicle that drives on at a constant speed for longer should
 * switch it off, or give the spread of its speed as the prior.
 *
 * Sources: J. Sola, "Quaternion kinematics for the error-state Kalman filter", 2017; E. Foxlin, "Pedestrian tracking
 * with shoe-mounted inertial sensors", IEEE CG&A 25(6), 2005 (zero-velocity updates of the whole state). */
#ifndef MODEL_NAVIGATION_H
#define MODEL_NAVIGATION_H

#include "model/noise.h"
#include "model/rest.h"
#include "model/math/rotation.h"

#define NAVIGATION_INTERVAL_S 0.04
#define NAVIGATION_QUICK_S    1.0

/** The errors' places in the state, three each. */
enum {
	NAVIGATION_THETA = 0,
	NAVIGATION_V = 3,
	NAVIGATION_P = 6,
	NAVIGATION_BG = 9,
	NAVIGATION_BA = 12,
	NAVIGATION_STATES = 15
};

struct navigation_config {
	int levelling;		   /* 0 or 1; the prior, if there is one, is used instead */
	double velocity_prior_m_s; /* >= 0: 1 sigma of each component while it moves; 0: none */
	struct noise_config noise;
	struct rest_config standstill;
	double rest_s; /* >= 0: after so long it is believed, whatever velocity and acceleration seem to be */
};

/** One calibrated sample and what is known beside it. */
struct navigation_input {
	struct vec3 gyro_b_rad_s, force_b_m_s2;
	struct quat q_nb;		    /* the fusion's attitude */
	struct vec3 attitude_variance_rad2; /* what it says of it, about each axis of n; 0: nothing */
	double gravity_m_s2;
	struct vec3 lever_b_m; /* reference point -> sensor */
};

/** What the samples since the last propagation do to the errors: the sums above. */
struct navigation_sums {
	double t_s;
	struct vec3 f, ff; /* integral of the force, and of that */
	struct mat3 s, u, v, w;
	struct vec3 turned_b_rad; /* integral of the rate, less the bias */
	double turned2_rad2_s;	  /* integral of its square */
	double shaken2_m2_s3;	  /* integral of the squared acceleration */
};

struct navigation {
	struct navigation_config config;
	struct smoother *smoother; /* that records the movements; or NULL */
	struct quat q_nb;
	struct vec3 velocity_n_m_s, position_n_m; /* of the sensor */
	struct vec3 gyro_bias_b_rad_s, accel_bias_b_m_s2;
	/** Covariance of the errors; that of the position since the last standstill. */
	double p[NAVIGATION_STATES][NAVIGATION_STATES];
	struct vec3 earlier_variance_m2; /* of the position at the last standstill */
	struct vec3 fused_apart2_rad2;	 /* mean square of the rotation from q_nb to the fusion's attitude, frame n */
	struct vec3 fused_variance_rad2; /* as the fusion said last */
	double gravity_m_s2;
	bool started, still;
	bool parted;	    /* the movement before this standstill ended with a reset of the position */
	unsigned movements; /* begun after a standstill of a second, or one with a reset of the position */
	/* PRIVATE */
	struct navigation_sums sums;
	struct rest rest;
	double stood_s;		 /* for how long it is still */
	double contradicted_s;	 /* for how long it would be, but for velocity or acceleration */
	struct vec3 quick_n_m_s; /* high-pass of the reference point's velocity */
	struct vec3 lever_n_m_s; /* of the sensor's velocity, the lever arm's share when that was last moved on */
	bool lever_known;
	double quick2_max; /* of its square, since the last standstill */
	double moving_s;   /* since the last standstill */
	double aided_s;	   /* for how long the velocity last told still holds */
	bool told_to_move; /* it was no standstill's */
	bool place_reset;  /* in motion, since the last sample */
	bool sampled;	   /* there is a sample before the next: */
	struct vec3 last_gyro_b_rad_s;
};

/** 1 sigma: of the fusion's attitude (rotation about each axis of n), of an acceleration turned by it, of velocity, of
 * the position since the reset and since the last standstill. */
struct navigation_sigma {
	struct vec3 attitude_rad, accel_m_s2, velocity_m_s, position_m, displacement_m;
};

/** 0, or -EINVAL: a field out of its range. */
int navigation_check(const struct navigation_config *config);

/** Nothing is known but the fusion's attitude. The position stays. */
void navigation_start(struct navigation *n, const struct navigation_config *config, struct quat q_nb);

/** Samples were missing: the velocity goes on, the attitude is the fusion's, and all is less certain. */
void navigation_skip(struct navigation *n, struct quat q_nb, double dt_s);

/** One sample, dt_s > 0 after the one before. Returns whether it was the last of an interval, with which the covariance
 * changes. */
bool navigation_step(struct navigation *n, const struct navigation_input *in, double dt_s);

/** The velocity of the reference point from outside, global frame; lever_b_m: from it to the sensor, omega: of the last
 * sample, without bias. A measurement, and where it is beyond belief taken in place of what was. For 5 s after the last
 * one no levelling takes place, nor does a steady motion that it told of pass for a standstill. */
void navigation_aid_velocity(struct navigation *n, struct vec3 velocity_n_m_s, double sigma_m_s,
	struct vec3 omega_b_rad_s, struct vec3 lever_b_m);

/** The attitude from outside, true to a degree: the velocity turns with the object, the position stays. */
void navigation_set_attitude(struct navigation *n, struct quat q_nb);

/** Position zero, and certain. At a standstill it ends the movement before it. */
void navigation_reset_position(struct navigation *n);

/** rate_hz: at which the acceleration is sampled. */
struct navigation_sigma navigation_sigma(const struct navigation *n, double rate_hz);

#endif
