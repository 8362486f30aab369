/* tools/experiments/methods.h
 * The estimators of the acceleration of the reference point that the experiments compare. All use the same
 * accelerations and the same noisy angles. Those with gyro use a gyro as well, and rates, differentiator and estimator
 * of the pipeline. */
#ifndef TOOLS_EXPERIMENTS_METHODS_H
#define TOOLS_EXPERIMENTS_METHODS_H

#include "tools/experiments/trial.h"

enum method {
	METHOD_NONE,	     /* subtract gravity only */
	METHOD_SEED,	     /* (12) with differentiated angles */
	METHOD_SEED_LOWPASS, /* likewise, angles smoothed by the paper's FIR without its delay */
	METHOD_SEED_GYRO,    /* (12) with rates from the gyro and angles fused with it */
	METHOD_RIGID_GYRO,   /* the rigid body instead of (12) */
	METHOD_AUTO,	     /* likewise, weighted against its noise */
	METHODS
};

extern const char *const METHOD_NAMES[METHODS];

struct score {
	double rms_m_s2, peak_m_s2; /* of the length of the error vector */
};

/** Writes the acceleration of each sample, object frame, to estimate[trial->count]. */
void method_run(enum method method, const struct trial *trial, double angle_sigma_rad, struct vec3 *estimate);
struct score method_score(const struct trial *trial, const struct vec3 *estimate);

#endif
