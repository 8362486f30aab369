/* model/auto_correction.h
 * The lever arm's correction, as far as its expected benefit exceeds its expected noise (the seed: "in case of very high
 * noise the dynamical correction term should rather be disregarded").
 *
 * A correction c measured with the variance v is best scaled by S / (S + v), S the mean square of the true correction
 * (Wiener). S is learnt per axis from the last second of the measured ones, less their noise; below v nothing is taken
 * from it. A single correction beyond six sigma is real by itself and counts at once. */
#ifndef MODEL_AUTO_CORRECTION_H
#define MODEL_AUTO_CORRECTION_H

#include "model/noise.h"
#include "model/rates.h"
#include "model/seed.h"

/** Of one axis, white; rad^2/s^2 and rad^2/s^4. */
struct rates_variance {
	double omega, alpha;
};

struct auto_correction {
	double power[3]; /* mean of c^2 / v, limited, over the last second */
};

/** What the noise of their source makes of the outputs of rates_step(). */
struct rates_variance rates_variance(const struct noise_config *noise, enum rate_source source,
	const struct filter_config *rate_filter, double rate_hz);

/** The variance of each component of rigid_lever_arm() and seed_lever_arm(). */
struct vec3 rigid_lever_arm_variance(struct vec3 omega_b_rad_s, struct vec3 r_b_m, struct rates_variance variance);
struct vec3 seed_lever_arm_variance(
	const struct seed_motion *motion, struct vec3 r_b_m, struct rates_variance variance);

/** The correction to use in place of `correction`. All 0 is a new struct auto_correction. */
struct vec3 auto_correction_step(struct auto_correction *a, struct vec3 correction, struct vec3 variance, double dt_s);

#endif
