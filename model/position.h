/* model/position.h
 * Position of the reference point, in one of two ways. The seed's: its acceleration integrated twice for a short time,
 * the velocity set to zero whenever the robot stands still. Or by navigation (navigation.h), which corrects the position
 * of the whole movement at its end. After the longest integration time without a rest the velocity is zero and the
 * position is held until the next rest, instead of running away. */
#ifndef MODEL_POSITION_H
#define MODEL_POSITION_H

#include "model/navigation.h"

enum position_mode { POSITION_OFF = 0, POSITION_ZERO_VELOCITY_AT_REST = 1, POSITION_NAVIGATION = 2 };

struct position_config {
	enum position_mode mode;      /* off: velocity and position are zero */
	double longest_integration_s; /* since the last rest; 0: no limit */
	double sigma_limit_m;	      /* 1 sigma above which the position is not to be trusted; 0: none */
	struct navigation_config navigation;
};

struct position {
	struct position_config config;
	struct vec3 velocity_n_m_s, position_n_m;
	/* by navigation: from one standstill to the next, all of it corrected by the last; stands until then */
	struct vec3 displacement_n_m, displacement_sigma_m;
	struct navigation_sigma sigma; /* by navigation */
	struct navigation navigation;
	/* PRIVATE */
	struct vec3 accel_n_m_s2;    /* of the last sample */
	struct vec3 residual_n_m_s2; /* acceleration at the last rest */
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
/** Velocity and position zero; the integration time starts anew. What was learnt at rest stays. */
void position_reset(struct position *p);
/** One sample, dt_s > 0 after the one before. */
void position_step(struct position *p, struct vec3 accel_n_m_s2, bool rest, double dt_s);
/** The same by navigation; lever_b_m: from the reference point to the sensor; rate_hz: nominal. */
void position_navigate(
	struct position *p, const struct navigation_input *in, struct vec3 lever_b_m, double rate_hz, double dt_s);
/** The same after missing samples, for both: nothing is integrated over the gap, but its time counts. */
void position_skip(struct position *p, struct vec3 accel_n_m_s2, struct quat q_nb, double dt_s);
/** The velocity of the reference point from outside: to navigation a measurement, else taken as the velocity. The
 * integration time starts anew. */
void position_aid_velocity(struct position *p, struct vec3 velocity_n_m_s, double sigma_m_s, struct vec3 lever_b_m);
/** The attitude from outside, before it `from`: the velocity turns with the object, the position stays. */
void position_set_attitude(struct position *p, struct quat from, struct quat to);
/** The longest integration time has passed. */
bool position_limited(const struct position *p);
/** 1 sigma of the position exceeds the limit. Known by navigation only. */
bool position_unsure(const struct position *p);

#endif
