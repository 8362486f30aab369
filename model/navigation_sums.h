/* model/navigation_sums.h
 * The state transition of the errors of a strapdown integration over many samples, as sums over the samples.
 *
 * The error of the attitude is a small rotation in the global frame, q_true = exp(theta) q. With that, the transition
 * over many samples has such sums as its blocks, and a covariance can be propagated over all of them at once, exactly
 * as sample by sample:
 *   theta += -S bg,  v += -[f]x theta + V bg - S ba,  p += T v - [F]x theta + W bg - U ba. */
#ifndef MODEL_NAVIGATION_SUMS_H
#define MODEL_NAVIGATION_SUMS_H

#include "model/math/rotation.h"

/** Places of the errors in the state, three each. */
enum {
	NAVIGATION_THETA = 0,
	NAVIGATION_V = 3,
	NAVIGATION_P = 6,
	NAVIGATION_BG = 9,
	NAVIGATION_BA = 12,
	NAVIGATION_STATES = 15
};

/** Zeroed it is the transition over no samples: the identity. */
struct navigation_sums {
	double t_s;
	bool held;		  /* the gyro does not turn the attitude: no error depends on its bias */
	struct vec3 f, ff;	  /* integral of the specific force in the global frame, m/s; and of that, F, m */
	struct mat3 s, u, v, w;	  /* integrals of the rotation matrix: s of itself, u of s, v of [force]x s, w of v */
	struct vec3 turned_b_rad; /* integral of the rate, less the bias */
	double turned2_rad2_s;	  /* integral of the squared rate */
	double accel2_m2_s3;	  /* integral of the squared acceleration */
};

/** One sample: attitude and specific force in the global frame, rate less the bias, acceleration (without gravity). */
void navigation_sums_add(struct navigation_sums *s, const struct mat3 *r_nb, struct vec3 omega_b, struct vec3 force_n,
	struct vec3 accel_n, double dt);
/** The samples of b after those of a: *a becomes the transition over both. */
void navigation_sums_append(struct navigation_sums *a, const struct navigation_sums *b);
/** p = F p. At a standstill (`still`) the position keeps its error. */
void navigation_sums_propagate(
	const struct navigation_sums *s, double p[NAVIGATION_STATES][NAVIGATION_STATES], bool still);

#endif
