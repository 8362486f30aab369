/* model/guide.h
 * A guide (the rails of a lift, a linear axis) keeps what moves along it from turning. So in a movement that begins
 * at a standstill the attitude of the navigation is held: what the gyro has turned it by decays within seconds, and
 * the gyro's noise and bias no longer add up to a tilt, which would be the greatest error of a long way. The gyro
 * still decides whether the assumption holds: once the net turn differs from zero by more than its sigma, the hold is
 * released, and attitude, velocity and position are what they would be without it.
 *
 * What is left of the gyro's noise, and the guide's own unevenness, act as a random walk of the horizontal velocity.
 *
 * Where the guide is vertical, two things more are known. The horizontal velocity is zero but for swaying, which
 * shows the accelerometer's bias and the tilt that made up for it at rest. Beside that the movement is integrated
 * with the attitude and the bias of its beginning: once that velocity is horizontal by more than its sigma, the guide
 * is inclined, for good, and the movement is what was integrated so. And a part of the vertical bias seen at rest is
 * gravity times the error of the scale, which is most of the error of a long way: the expected part of it is
 * corrected. */
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
	/* of a vertical guide */
	bool inclined; /* found so, once and for all */
	struct guide_start {
		struct quat q_nb;
		struct vec3 position_n_m, accel_bias_b_m_s2;
		double tilt_variance_rad2, bias_variance_m2_s4, accel_variance_m2_s4; /* horizontal axes, mean */
	} start;
	struct vec3 free_n_m_s, free_n_m; /* velocity and way since then, with that attitude and bias */
};

/** The object stands: a movement from here on is held. */
void guide_engage(struct guide *g, const struct guide_start *start);

/** The samples of an interval in which it moves; r_nb: attitude. Returns the rotation of the attitude to be taken
 * back, by which *q_true = exp(-rotation) q*, frame n. */
struct vec3 guide_hold(struct guide *g, const struct mat3 *r_nb, const struct navigation_sums *s);

/** Its net turn is significant. gyro_density_rad_s_sqrt_hz: noise, bias_variance_rad2_s2: of the gyro's bias, sum of
 * the axes. */
bool guide_turns(const struct guide *g, double gyro_density_rad_s_sqrt_hz, double bias_variance_rad2_s2);

/** m^2/s^3, growth of the variance of each horizontal velocity while it holds. */
double guide_walk_m2_s3(double gyro_density_rad_s_sqrt_hz, double gravity_m_s2);

/** The samples of an interval in which it moves, integrated freely; r_nb and accel_bias_b_m_s2: with which their sums
 * are. */
void guide_integrate(struct guide *g, const struct mat3 *r_nb, struct vec3 accel_bias_b_m_s2, double gravity_m_s2,
	const struct navigation_sums *s);
/** m^2/s^2, variance of that velocity, each horizontal axis; walk_m2_s3: guide_walk_m2_s3(). */
double guide_free_variance_m2_s2(const struct guide *g, double walk_m2_s3);
/** It is horizontal by more than its sigma. */
bool guide_inclines(const struct guide *g, double walk_m2_s3);
/** Of a vertical guide at this speed. m^2/s: variance of the mean of each horizontal velocity over a second. */
double guide_sway_m2_s(double speed_m_s);
/** m^2, variance of each horizontal component of a way of this square. */
double guide_plumb_m2(double way2_m2);
/** The share of the vertical bias seen at rest that the scale makes, expected. 1 sigma of the calibration: m/s^2, and
 * of 1. */
double guide_share_of_scale(double bias_sigma_m_s2, double scale_sigma, double gravity_m_s2);

#endif
