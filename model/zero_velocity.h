/* model/zero_velocity.h
 * Two hypotheses for the navigation: "it stands" and "it moves steadily". No inertial sensor tells one from the other
 * at an instant; what does is the velocity that led there, with its sigma. So neither is taken for granted, and what is
 * published is the mixture of both.
 *
 * While it stands, zero-velocity updates hold the velocity at zero and would absorb a motion that begins gently. So
 * forks of the navigation, each FORK_S younger than the last, integrate without updates. A motion has begun when the
 * velocity of a fork differs from zero by more than its sigma allows. Then the youngest fork that is older than the
 * beginning is adopted: its state is that of a motion from its first moment on. 0.05 m/s reached within a second are
 * seen so.
 *
 * While it moves, the odds of standing follow from the estimated velocity v with its covariance P: the likelihood ratio
 * of v = 0 against a speed of any scale (a Gaussian each, the slowest given by the user's assumptions), times prior
 * odds. The prior odds grow as far as known motions of this carrier have differed from standing: one that vibrated
 * whenever it moved stands when the vibration ends; one that cruised without vibration (a lift) may cruise again. A
 * motion cannot end without an acceleration, so without one the odds do not rise while P grows; but the longer it is
 * as quiet as it stood, the less likely is it that it ever moved. Above a limit it stands, if the force stays the same:
 * a load that swings passes zero velocity quietly, with an acceleration that changes. Below, position and velocity are
 * those of both, weighted, and their variance has the spread of both.
 *
 * Sources: I. Skog, P. Handel, J.-O. Nilsson, J. Rantakokko, "Zero-velocity detection - an algorithm evaluation", IEEE
 * TBME 57(11), 2010 (likelihood ratio); J. Wahlstrom, I. Skog, F. Gustafsson, A. Markham, N. Trigoni, "Zero-velocity
 * detection - a Bayesian approach to adaptive thresholding", 2019, arXiv 1903.07929 (prior from the velocity and its
 * covariance); Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation",
 * 2001, section 1.4.16 (moments of a mixture). */
#ifndef MODEL_ZERO_VELOCITY_H
#define MODEL_ZERO_VELOCITY_H

#include "model/navigation_sums.h"
#include "model/noise.h"

struct navigation;

/** The navigation since a moment at which it stood, without zero-velocity updates. PRIVATE to zero_velocity.c and
 * navigation.c. */
struct zero_velocity_fork {
	bool set;
	double p[NAVIGATION_STATES][NAVIGATION_STATES]; /* the navigation's covariance at that moment, velocity zero */
	struct vec3 gyro_bias_b_rad_s, accel_bias_b_m_s2; /* its biases at that moment */
	struct vec3 start_n_m;				  /* its position at that moment */
	struct vec3 velocity_n_m_s, position_n_m;	  /* of the sensor, now */
	struct vec3 apart_rad; /* rotation from the navigation's attitude to the one without updates, frame n */
	struct navigation_sums sums;
	double accel_variance_m2_s4[3]; /* at that moment, of each axis */
	double bias_variance_rad2_s2;	/* of the gyro's, mean of the axes */
	struct mat3 r_nb;		/* attitude, at that moment */
};

enum { ZERO_VELOCITY_FORKS = 3 };

struct zero_velocity {
	/** Weight of "it stands", 0..1, while it moves. */
	double weight;
	/** To be added to the reference point's position and velocity, and to their variances, to get the mixture's. */
	struct vec3 position_shift_n_m, velocity_shift_n_m_s, position_variance_m2, velocity_variance_m2_s2;
	/** Variance of the velocity of vibration, all axes, with what counts like it. */
	double vibration_m2_s2;
	/** For how long the odds have been those of standing. */
	double standing_s;
	/* PRIVATE */
	struct vec3 standing_force_n_m_s2;		      /* mean force when that began */
	struct zero_velocity_fork forks[ZERO_VELOCITY_FORKS]; /* from the oldest to the youngest */
	struct vec3 accel_low_n_m_s2, vibration_n_m_s;
	double fast_vibration_m2_s2;			/* of vibration alone */
	double quiet_gyro2_rad2_s2, quiet_accel2_m2_s4; /* mean square deviations while it stood; 0: not known */
	double accel_walk_m2_s3;			/* .. and the velocity's variance in a second by it */
	double moved_s, moved_quietly_s; /* in motions that were known as such; without more deviation than that */
	bool unseen;			 /* samples are missing since the last standstill, */
	double unsteady_s;		 /* .. and for so long it has not been steady since */
	double quiet_s;			 /* for how long it has been that quiet while it moves */
	double least_odds;		 /* of moving, since the last acceleration, */
	struct vec3 odds_velocity_n_m_s; /* .. and the velocity that they rest on, */
	double odds_age_s;		 /* .. so long ago */
};

/** What the signals show at the end of an interval. */
struct zero_velocity_signals {
	bool steady;			    /* the standstill detector's */
	double gyro2_rad2_s2, accel2_m2_s4; /* its mean square deviations */
	bool accelerates;		    /* the mean acceleration differs from zero, significantly */
	double accel_walk_m2_s3;	    /* variance of the velocity in a second by that deviation, if it is noise */
	bool level;			    /* what moves does so horizontally */
	struct vec3 force_n_m_s2;	    /* mean specific force; tilt and bias make it wrong by a constant */
	double force_change2_m2_s4;	    /* square of the least change of it that is significant */
};

/** Each sample: acceleration in the global frame; variance of the velocity by what may be an alias (alias.h) and by the
 * noise of the lever arm's velocity. */
void zero_velocity_vibration(struct zero_velocity *z, struct vec3 accel_n_m_s2, double beside_m2_s2, double dt_s);

/** The end of an interval of samples while it stands, before the update that ends it. dt_s: of the last sample. */
void zero_velocity_integrate(struct zero_velocity *z, const struct navigation *n, double dt_s);
/** .. and after it. turned_rad: by which the update turned the attitude, lever_n_m_s: velocity of the sensor relative
 * to the reference point, turning: the object turns in place, t_s: of the interval. Returns the fork in which a motion
 * has begun, to be adopted, or NULL. */
struct zero_velocity_fork *zero_velocity_stands(struct zero_velocity *z, const struct navigation *n,
	const struct zero_velocity_signals *signals, struct vec3 turned_rad, struct vec3 lever_n_m_s, bool turning,
	double t_s);

/** m/s, of what begins to move within a second: slower ones may not be seen, by the noise of the sensors (2020h). */
double zero_velocity_slowest_seen_m_s(const struct noise_config *noise, double gravity_m_s2);

/** The end of an interval while it moves. velocity_n_m_s: of the reference point; slowest_m_s: of the steady motions
 * that are possible; known: something else says that it moves. */
void zero_velocity_moves(struct zero_velocity *z, const struct navigation *n,
	const struct zero_velocity_signals *signals, struct vec3 velocity_n_m_s, double slowest_m_s, bool known,
	double t_s);

/** It has been as quiet as it stood for a minute or longer: what then is a standstill may be a cruise. */
bool zero_velocity_quiet_for_long(const struct zero_velocity *z);
/** It stands: what was quiet until now was no motion to learn from. */
void zero_velocity_settle(struct zero_velocity *z);

/** A motion has begun: no forks, and no odds of standing until an acceleration; or it stands. */
void zero_velocity_restart(struct zero_velocity *z, bool moving);
/** Samples were missing: no forks, but what moved still does until an acceleration is seen. standing: it stood
 * before. */
void zero_velocity_skip(struct zero_velocity *z, bool standing);

#endif
