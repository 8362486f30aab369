/* model/warming.h
 * By how much the chip's temperature has changed, for what the biases do that nobody compensates (2054h). Readings come
 * once a second or with each sample, in steps of a kelvin with some chips, and scatter: they are low-passed, and what
 * goes to and fro within a kelvin is no change. */
#ifndef MODEL_WARMING_H
#define MODEL_WARMING_H

#include <stdbool.h>
#include <stdint.h>

/** Zeroed it is ready. */
struct warming {
	/* PRIVATE */
	double low_degC, followed_degC;
	uint64_t t_us; /* of the last reading */
	bool known;
};

/** A reading at its time. Returns the change since the last one, in K, >= 0. */
double warming_step(struct warming *w, double temperature_degC, uint64_t t_us);

/** Variance by which a bias has changed with that, from its 1 sigma per K, in the square of its unit. A change of the
 * temperature in one direction changes it in one direction: it counts as one drift for some kelvins. */
double warming_variance(double change_K, double sigma_per_K);

#endif
