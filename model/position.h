/* model/position.h
 * The seed's position: acceleration integrated twice for a short time, velocity set to zero
 * whenever the robot stands still. After the longest integration time without a rest the velocity
 * is zero and the position is held until the next rest, instead of running away. */
#ifndef MODEL_POSITION_H
#define MODEL_POSITION_H

#include "model/vec3.h"

enum position_mode { POSITION_OFF = 0, POSITION_ZERO_VELOCITY_AT_REST = 1 };

struct position_config {
	enum position_mode mode;      /* off: velocity and position are zero */
	double longest_integration_s; /* since the last rest; 0: no limit */
};

struct position {
	struct position_config config;
	struct vec3 velocity_n_m_s, position_n_m;
	/* PRIVATE */
	struct vec3 accel_n_m_s2;    /* of the last sample */
	struct vec3 residual_n_m_s2; /* acceleration at the last rest */
	double moving_s;	     /* since the last rest */
};

/** 0, or -EINVAL with *p untouched: a field out of its range. */
int position_init(struct position *p, const struct position_config *config);
/** The same while it runs: velocity and position stay. */
int position_configure(struct position *p, const struct position_config *config);
/** Velocity and position zero; the integration time starts anew. What was learnt at rest stays. */
void position_reset(struct position *p);
/** One sample, dt_s > 0 after the one before. */
void position_step(struct position *p, struct vec3 accel_n_m_s2, bool rest, double dt_s);
/** The same after missing samples: nothing is integrated over the gap, but its time counts. */
void position_skip(struct position *p, struct vec3 accel_n_m_s2, double dt_s);
/** The longest integration time has passed. */
bool position_limited(const struct position *p);

#endif
