/* model/quantisation.h
 * The error of a mean by the steps of a sensor that is coarser than its noise, such as a LSM303DLHC at 16 g (12 mg):
 * between two steps its value stays the same, and the mean is wrong by up to half a step. Noise or vibration of half a
 * step and more averages that out. The step is the smallest change that any axis has shown.
 *
 * Source: B. Widrow, I. Kollar, "Quantization Noise", 2008, ch. 19 (dither): the error of the mean falls with
 * exp(-2 (pi sigma / step)^2); here sigma is that of the quantised values, which is less, so the fall is slower. */
#ifndef MODEL_QUANTISATION_H
#define MODEL_QUANTISATION_H

#include <stdbool.h>

#include "model/math/vec3.h"

/** Zeroed it is ready; unit: that of the values. */
struct quantisation {
	/* PRIVATE */
	double last[3], step[3]; /* step: the smallest change so far; 0: none */
	double change2[3];	 /* mean square of the changes, lately */
	int changes[3];		 /* so many were seen, up to those that are needed */
	bool known;		 /* the last value */
};

/** One value as the sensor gives it, without a calibration, dt_s > 0 after the one before. */
void quantisation_step(struct quantisation *q, struct vec3 value, double dt_s);
/** Variance of the error of the mean, that of the worst axis. */
double quantisation_variance(const struct quantisation *q);

#endif
