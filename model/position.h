/* model/position.h
 * Velocity and position of the reference point, in one of two ways: the paper's, double integration of the acceleration
 * with the velocity set to zero whenever the robot is at rest, or by navigation (navigation.h), which corrects the
 * position of the whole movement at its end. After the longest integration time without rest the velocity is zero and
 * the position held until the next rest, so that it does not drift away. */
#ifndef MODEL_POSITION_H
#define MODEL_POSITION_H

#include "model/navigation.h"

enum position_mode { POSITION_OFF = 0, POSITION_ZERO_VELOCITY_AT_REST = 1, POSITION_NAVIGATION = 2 };

struct position_config {
	enum position_mode mode; /* default POSITION_NAVIGATION; off: velocity and position are zero */
	/** s, >= 0, default 60; 0: no limit: integration time since the last rest or velocity from outside after which
	 * the position is held. A smaller one keeps the error small, but misses long movements; a larger one follows
	 * them, with an error that grows with the square of time. */
	double longest_integration_s;
	/** m, >= 0, default 0: no limit: 1 sigma, of all components together, above which position_unsure() is true. A
	 * smaller one reports sooner. Navigation only. */
	double sigma_limit_m;
	struct navigation_config navigation;
};

struct position {
	struct position_config config;
	struct vec3 velocity_n_m_s, position_n_m;
	/* by navigation: the last displacement from one standstill to the next, corrected by the second */
	struct vec3 displacement_n_m, displacement_sigma_m;
	struct navigation_sigma sigma; /* by navigation */
	struct navigation navigation;
	/* PRIVATE */
	struct vec3 accel_n_m_s2;    /* of the last sample */
	struct vec3 residual_n_m_s2; /* mean acceleration at the last rest: what gravity and bias leave */
	double moving_s;	     /* since the last rest, or velocity from outside */
	struct vec3 omega_b_rad_s;   /* of the last sample, by navigation */
	struct vec3 anchor_n_m;	     /* the navigation's position of the reference point where the position is 0 */
	struct vec3 moved_from_n_m;
	bool anchored;
};

/** 0, or -EINVAL with *p untouched: a field out of its range. */
int position_init(struct position *p, const struct position_config *config);
/** The same while it runs: velocity and position stay. */
int position_configure(struct position *p, const struct position_config *config);
/** Velocity and position are zero, the integration time starts again. The mean acceleration at rest stays. */
void position_reset(struct position *p);
/** One sample, dt_s > 0 after the one before. */
void position_step(struct position *p, struct vec3 accel_n_m_s2, bool rest, double dt_s);
/** The same by navigation. lever_b_m: reference point -> sensor; rate_hz: nominal. */
void position_navigate(
	struct position *p, const struct navigation_input *in, struct vec3 lever_b_m, double rate_hz, double dt_s);
/** The same after missing samples, for both modes: the gap is not integrated, but its time counts. */
void position_skip(
	struct position *p, const struct navigation_input *in, struct vec3 accel_n_m_s2, double rate_hz, double dt_s);
/** The velocity of the reference point from outside: a measurement of the navigation, or the new velocity in mode 1.
 * The integration time starts again. */
void position_aid_velocity(struct position *p, struct vec3 velocity_n_m_s, double sigma_m_s, struct vec3 lever_b_m);
/** The sensors' biases have changed since the last sample, with this variance, each axis. */
void position_biases_drift(struct position *p, double gyro_rad2_s2, double accel_m2_s4);
/** The attitude was set from outside; it was `from`. The velocity turns with the object, the position stays. */
void position_set_attitude(struct position *p, struct quat from, struct quat to);
/** The longest integration time has passed. */
bool position_limited(const struct position *p);
/** 1 sigma of the position exceeds the limit. Known by navigation only. */
bool position_unsure(const struct position *p);

#endif
