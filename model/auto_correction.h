/* model/auto_correction.h
 * The lever arm's correction, scaled by what it is worth against its noise. The paper: "in case of very high noise the
 * dynamical correction term should rather be disregarded".
 *
 * A measured correction c of noise variance v is best scaled by S / (S + v), with S the mean square of the true
 * correction (Wiener filter). S is estimated per axis as the mean square of the measured corrections over the last
 * second, less v. Where that is below v the correction is 0. A single correction beyond six sigma is not noise, and
 * counts at once. It has no configuration of its own: the variances follow from noise_config. */
#ifndef MODEL_AUTO_CORRECTION_H
#define MODEL_AUTO_CORRECTION_H

#include "model/noise.h"
#include "model/rates.h"
#include "model/seed.h"

/** Of white noise on one axis: of the rate, rad^2/s^2, and of the angular acceleration, rad^2/s^4. */
struct rates_variance {
	double omega, alpha;
};

struct auto_correction {
	double power[3]; /* mean of c^2 / v over the last second, each c^2 / v limited */
};

/** Variances of the outputs of rates_step() by the noise of their source. */
struct rates_variance rates_variance(const struct noise_config *noise, enum rate_source source,
	const struct filter_config *rate_filter, double rate_hz);

/** The variance of each component of rigid_lever_arm() and seed_lever_arm(). */
struct vec3 rigid_lever_arm_variance(struct vec3 omega_b_rad_s, struct vec3 r_b_m, struct rates_variance variance);
struct vec3 seed_lever_arm_variance(
	const struct seed_motion *motion, struct vec3 r_b_m, struct rates_variance variance);

/** Returns the correction to use in place of `correction`. A zeroed struct auto_correction is ready. */
struct vec3 auto_correction_step(struct auto_correction *a, struct vec3 correction, struct vec3 variance, double dt_s);

#endif
