/* model/navigation.h
 * Velocity and position by an error-state Kalman filter. Gyro and accelerometer are integrated (strapdown), and the
 * filter estimates 15 errors of that: attitude, velocity, position (global frame n), gyro and accelerometer bias
 * (object frame b). Its measurements:
 *   zero-velocity updates: at a standstill velocity and rate are zero, which corrects tilt and biases as well;
 *   the heading of the fusion, but not its tilt, which comes from the same accelerometer;
 *   levelling, or a prior from the user: the velocity during a movement has the mean 0 and a known spread;
 *   a velocity from outside.
 *
 * The covariance is propagated once per NAVIGATION_INTERVAL_S, by sums over the samples (navigation_sums.h).
 *
 * The errors of velocity and position grow together, and the covariance knows their correlation: the velocity error
 * seen at a standstill corrects the position of the whole movement before it. So the displacement at a standstill is
 * that of a fixed-interval smoother over the movement, whose last point is the filter's. The points before it are
 * corrected by smoother.h, which gets every transition and measurement.
 *
 * Levelling: over more than a few seconds no accelerometer can tell tilt from acceleration, so every attitude filter
 * assumes that the acceleration averages out. Here the same is assumed of the reference point's velocity, from 4 s into
 * a movement on, fully from 6 s. How firmly depends on the movement: the spread is that of the high-passed velocity
 * (above 1 / (2 pi NAVIGATION_HIGH_PASS_S) Hz), which a tilt error hardly changes. It is not for a vehicle that keeps a
 * speed for longer.
 *
 * Sources: J. Sola, "Quaternion kinematics for the error-state Kalman filter", 2017; E. Foxlin, "Pedestrian tracking
 * with shoe-mounted inertial sensors", IEEE CG&A 25(6), 2005 (zero-velocity updates of the whole state). */
#ifndef MODEL_NAVIGATION_H
#define MODEL_NAVIGATION_H

#include "model/alias.h"
#include "model/guide.h"
#include "model/navigation_sums.h"
#include "model/noise_seen.h"
#include "model/rest.h"
#include "model/rope.h"
#include "model/zero_velocity.h"

/* s between two updates of the covariance. By judgement: short against a movement, and at 200 samples a second an
 * eighth of the cost of an update per sample. */
#define NAVIGATION_INTERVAL_S 0.04
/* s, time constant of the high-pass of the velocity. By judgement: movements of a hand are faster, the effect of a tilt
 * error (0.17 m/s per degree and second) is slower. */
#define NAVIGATION_HIGH_PASS_S 1.0

/** What is assumed of the motion, see the table of assumptions in navigation.c. */
enum motion_preset {
	MOTION_ANY = 0,		  /* nothing: it may creep, cruise and stop */
	MOTION_HAND_HELD = 1,	  /* a hand moves to and fro, and nothing moves it steadily */
	MOTION_ROBOT_BASE = 2,	  /* a vehicle or robot base: cruises, but does not creep */
	MOTION_LINEAR_AXIS = 3,	  /* a lift or a linear axis: cruises without vibration, but does not creep, nor turn */
	MOTION_ARM = 4,		  /* the link of a robot arm, moves to and fro */
	MOTION_FOOT = 5,	  /* a shoe: stands for a moment in each step, and rolls on */
	MOTION_VERTICAL_LIFT = 6, /* as a lift, and its rails are vertical */
	MOTION_HANGING_LOAD = 7,  /* the load of a crane, see rope.h */
	MOTION_PRESETS
};

struct navigation_config {
	/** Default MOTION_ANY: honest for most motions, see "Honesty of sigma" in model/README.md. The others are
	 * more accurate where they are true, and wrong by more than their sigma where they are not. */
	enum motion_preset preset;
	/** 0 (default) or 1: levelling, as above, with any preset. 0 for vehicles that keep a speed for more than some
	 * 10 s, whose position then drifts with the square of time; 1 for movements to and fro. */
	int levelling;
	/** m/s, >= 0, default 0 (none): 1 sigma of each component of the reference point's velocity during a movement.
	 * With levelling it is the spread, from the first second on: a smaller one holds the velocity nearer to zero, a
	 * larger one trusts the accelerometer for longer. Without levelling the velocity may be the same all the time,
	 * and the prior is used where the accelerometer knows it worse. */
	double velocity_prior_m_s;
	/** >= 0, default 0: 1 sigma of the errors of sensors that nobody calibrated, where it exceeds that of a
	 * calibration. Larger ones make velocity and position less certain: until standstills have shown the biases,
	 * and after each turn (scale, as a share of the turn) and way (as a share of it). */
	double gyro_bias_sigma_rad_s, gyro_scale_sigma, accel_bias_sigma_m_s2, accel_scale_sigma;
	/** m, >= 0, default 0: length of the rope, from the trolley to the sensor, of MOTION_HANGING_LOAD; 0:
	 * unknown, and nothing is assumed. It is estimated from there. */
	double rope_m;
	/** Of the sensors. Smaller densities and instabilities trust the integration more, and the standstills less. */
	struct noise_config noise;
	struct rest_config standstill; /* the detector's parameters: STANDSTILL_DEFAULTS or STANCE_DEFAULTS */
	/** s, >= 0, default 1.5: a standstill that velocity or acceleration contradict is accepted after that time. A
	 * smaller one recovers from a wrong velocity sooner, a larger one takes slow steady motions (a lift) for a
	 * standstill less often. */
	double rest_s;
};

/** One calibrated sample and what else is known at its time. */
struct navigation_input {
	struct vec3 gyro_b_rad_s, force_b_m_s2;
	struct quat q_nb;					   /* the fusion's attitude */
	struct vec3 gyro_bias_b_rad_s, gyro_bias_variance_rad2_s2; /* the fusion's estimate, to start from */
	struct vec3 attitude_variance_rad2; /* of the fusion's attitude, about each axis of n; 0: unknown */
	double velocity2_m2_s2; /* mean square of the horizontal velocity lately, as far as the fusion knows it */
	double unseen_turn_rad; /* 1 sigma, each axis, of the turn by missing samples before this one; 0: none are */
	bool north_found; /* the fusion's heading has just been set: it is another one than that of the sample before */
	double force_variance_m2_s4; /* of the force, each axis, beyond that of a calibration (vibration, clipping) */
	double steps_variance_m2_s4; /* of the error of the mean force by the accelerometer's steps, each axis */
	double gravity_m_s2;
	struct vec3 lever_b_m; /* reference point -> sensor */
};

struct navigation {
	struct navigation_config config;
	struct noise_config noise; /* as told, or as seen where that is more */
	struct smoother *smoother; /* records the movements; or NULL */
	struct quat q_nb;
	struct vec3 velocity_n_m_s, position_n_m; /* of the sensor */
	struct vec3 gyro_bias_b_rad_s, accel_bias_b_m_s2;
	/** Covariance of the errors; that of the position counts from the last standstill. */
	double p[NAVIGATION_STATES][NAVIGATION_STATES];
	struct vec3 earlier_variance_m2;     /* of the position at the last standstill, without errors of scale */
	struct vec3 fusion_difference2_rad2; /* mean square of the rotation from q_nb to the fusion's attitude, n */
	bool north_found;		     /* since the last interval */
	double force_variance_m2_s3;	     /* integral of navigation_input.force_variance_m2_s4 over the interval */
	struct vec3 fusion_variance_rad2;    /* the last of navigation_input.attitude_variance_rad2 */
	double gravity_m_s2;
	struct vec3 lever_b_m; /* the last of navigation_input.lever_b_m */
	bool started, still;
	bool ended_by_reset;   /* the movement before this standstill ended with a reset of the position */
	unsigned movements;    /* that began after a standstill of a second, or one with a reset of the position */
	struct vec3 begin_n_m; /* of the reference point, where the last of them began */
	/* PRIVATE */
	struct navigation_sums sums;
	struct noise_seen seen;
	struct rest rest;
	double stood_s;	       /* duration of the standstill so far */
	double contradicted_s; /* for how long velocity or acceleration contradict the detector */
	bool assumed;	       /* for so long that the standstill holds against them */
	struct zero_velocity zero_velocity;
	struct guide guide;
	struct rope rope;
	struct alias alias;
	bool hangs_still;	       /* the point from which the load hangs */
	bool rope_ended;	       /* a window has just become full, and there are differences */
	struct vec3 mean_rate_b_rad_s; /* over half a second of a standstill, less the bias */
	bool stood;		       /* since the start */
	bool turning;		       /* it differs from zero: the object turns in place */
	double crept_s;		       /* for how long it may have crept, in this standstill */
	double walked_s;	       /* on foot, without the standstills */
	double moved_s, moved_accel2_m2_s3,
		moved_turned2_rad2_s; /* since the last standstill: time, integrals of the squares */
	double bounded_s[3];	      /* in this movement, for which the prior bounded the velocity of each axis */
	struct vec3 net_turn_b_rad;   /* integral of the rate since the last standstill, */
	double net_turn2_max_rad2;    /* .. and its greatest square */
	struct {
		bool begun;	       /* since the last standstill; the movement may have begun before */
		struct vec3 up_b_m_s2; /* gravity then: the bias has the error of that */
		/* what a relative error of each axis adds up to since: of the attitude by the gyro, of the velocity by
		 * that and by the accelerometer, n; a column an axis */
		struct mat3 attitude, velocity_by_gyro, velocity_by_accel;
		double velocity2_max[3]; /* greatest variance of the velocity, m^2/s^2 */
	} scales;
	struct vec3 way_from_n_m;			   /* where the sensor was when the displacement began, */
	double way2_max_m2;				   /* .. and its greatest squared distance from there */
	double accelerated_s;				   /* for how long it still counts as accelerating */
	struct vec3 slow_force_n_m_s2, usual_force_n_m_s2; /* means over a second, and over ten */
	double changed_s;	     /* for how long the force may stay where it is since it changed */
	struct vec3 high_pass_n_m_s; /* of the reference point's velocity, */
	double high_pass2_max;	     /* and its greatest square since the last standstill */
	struct vec3 lever_n_m_s;     /* the lever arm's velocity when that was last moved on */
	bool lever_known;
	struct vec3 lever_from_n_m; /* the lever arm when the position was zero */
	bool lever_from_known;
	double moving_s;      /* since the last standstill */
	double aided_s;	      /* for how long the last velocity from outside holds */
	bool aided_in_motion; /* it was not that of a standstill */
	bool reset_in_motion; /* the position was reset since the last sample */
	bool last_known;      /* of the last sample: */
	struct vec3 last_gyro_b_rad_s, last_force_n_m_s2;
	double last_interval_s; /* .. and the time before it */
};

/** 1 sigma: of the fusion's attitude (rotation about each axis of n), of an acceleration turned by it, of velocity, of
 * the position since the reset and since the last standstill. */
struct navigation_sigma {
	struct vec3 attitude_rad, accel_m_s2, velocity_m_s, position_m, displacement_m;
};

/** 0, or -EINVAL: a field out of its range. */
int navigation_check(const struct navigation_config *config);

/** Starts with the fusion's attitude; nothing else is known. The position stays. */
void navigation_start(struct navigation *n, const struct navigation_config *config, struct quat q_nb);

/** Samples are missing before this one: the velocity stays, attitude and its variance are the fusion's, and velocity
 * and position are as uncertain as this acceleration makes them, for dt_s. */
void navigation_skip(struct navigation *n, const struct navigation_input *in, double dt_s);

/** One sample, dt_s > 0 after the one before. Returns true with the last one of an interval, when the covariance
 * changes. */
bool navigation_step(struct navigation *n, const struct navigation_input *in, double dt_s);

/** The velocity of the reference point from outside, global frame. lever_b_m: reference point -> sensor, omega_b_rad_s:
 * rate of the last sample less the bias. It is a measurement; beyond the innovation gate it replaces the velocity. For
 * 5 s after the last one there is no levelling, and a steady motion it reported does not pass for a standstill. */
void navigation_aid_velocity(struct navigation *n, struct vec3 velocity_n_m_s, double sigma_m_s,
	struct vec3 omega_b_rad_s, struct vec3 lever_b_m);

/** The biases have changed since the last sample, with this variance, each axis. */
void navigation_biases_drift(struct navigation *n, double gyro_rad2_s2, double accel_m2_s4);

/** The attitude from outside, with a 1 sigma of a degree. The velocity turns with the object, the position stays. */
void navigation_set_attitude(struct navigation *n, struct quat q_nb);

/** The position is zero, and certain. At a standstill this ends the movement before it. */
void navigation_reset_position(struct navigation *n);

/** Variance of the acceleration along each axis of n, by the errors of tilt and accelerometer bias. */
void navigation_accel_variance(const struct navigation *n, double variance_m2_s4[3]);

/** It stands by the detector alone, with a preset that says so: the estimated velocity or acceleration is another. */
static inline bool navigation_assumes_standstill(const struct navigation *n)
{
	return n->started && n->assumed && n->still;
}

/** The velocity changes, or has changed within the last second, or the force has within four and is not that of a
 * standstill, as at the turning points of a swing: no steady motion, and no standstill. */
static inline bool navigation_accelerates(const struct navigation *n)
{
	return n->started && n->accelerated_s > 0;
}

/** What seems to move may be a vibration near a multiple of the sampling rate. */
static inline bool navigation_may_be_alias(const struct navigation *n)
{
	const double *v = n->alias.velocity_m_s;

	return n->started && v[0] + v[1] + v[2] > 0;
}

/** Nothing moves but a load that swings. */
static inline bool navigation_stands(const struct navigation *n)
{
	return n->still || n->hangs_still;
}

/** rate_hz: of the samples, which is the bandwidth of the acceleration's noise. */
struct navigation_sigma navigation_sigma(const struct navigation *n, double rate_hz);

#endif
