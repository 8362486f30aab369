/* model/guide.h
 * A guide (the rails of a lift, a linear axis) keeps what moves along it from turning. So in a movement that begins at
 * a standstill the attitude of the navigation is held: what the gyro has turned it by decays within seconds, and the
 * gyro's noise and bias no longer add up to a tilt, which would be the greatest error of a long way. The gyro still
 * decides whether the assumption holds: once the net turn differs from zero by more than its sigma, the hold is
 * released, and attitude, velocity and position are what they would be without it.
 *
 * What is left of the gyro's noise, and the guide's own unevenness, act as a random walk of the horizontal velocity. */
#ifndef MODEL_GUIDE_H
#define MODEL_GUIDE_H

#include "model/navigation_sums.h"

/** Zeroed it does not hold. All in the global frame n. */
struct guide {
	bool holds;
	double t_s;			    /* since it does */
	struct vec3 off_n_rad;		    /* turned by the gyro and not yet taken back */
	struct vec3 taken_n_rad;	    /* taken back so far, */
	struct vec3 taken_n_m_s, taken_n_m; /* .. and the velocity and way that this has cost */
};

/** The object stands: a movement from here on is held. */
void guide_engage(struct guide *g);

/** The samples of an interval in which it moves; r_nb: attitude. Returns the rotation of the attitude to be taken back,
 * by which *q_true = exp(-rotation) q*, frame n. */
struct vec3 guide_hold(struct guide *g, const struct mat3 *r_nb, const struct navigation_sums *s);

/** Its net turn is significant. gyro_density_rad_s_sqrt_hz: noise, bias_variance_rad2_s2: of the gyro's bias, sum of
 * the axes. */
bool guide_turns(const struct guide *g, double gyro_density_rad_s_sqrt_hz, double bias_variance_rad2_s2);

/** m^2/s^3, growth of the variance of each horizontal velocity while it holds. */
double guide_walk_m2_s3(double gyro_density_rad_s_sqrt_hz, double gravity_m_s2);

#endif
