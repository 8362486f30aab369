/* tools/experiments/methods.h
 * The ways to the reference point's acceleration that the experiments compare. All see the same accelerations and the same
 * noisy angles; those with gyro a gyro, too, and the estimator, rates and differentiator of the gateway's pipeline. */
#ifndef TOOLS_METHODS_H
#define TOOLS_METHODS_H

#include "tools/experiments/trial.h"

enum method {
	METHOD_NONE,	     /* gravity alone is taken away */
	METHOD_SEED,	     /* (12), the given angles differentiated */
	METHOD_SEED_LOWPASS, /* the same, the angles smoothed by the seed's FIR first, its delay removed */
	METHOD_SEED_GYRO,    /* (12), rates from the gyro, angles fused with it */
	METHOD_RIGID_GYRO,   /* the rigid body in place of (12) */
	METHOD_AUTO,	     /* .. as far as it is worth its noise */
	METHODS
};

extern const char *const METHOD_NAMES[METHODS];

struct score {
	double rms_m_s2, peak_m_s2; /* of the length of the error vector */
};

/** The acceleration of each sample, object frame, into estimate[trial->count]. */
void method_run(enum method method, const struct trial *trial, double angle_sigma_rad, struct vec3 *estimate);
struct score method_score(const struct trial *trial, const struct vec3 *estimate);

#endif
