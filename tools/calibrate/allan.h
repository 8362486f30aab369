/* tools/calibrate/allan.h
 * Overlapping Allan deviation, and a noise model fitted to it: sigma^2(tau) = 3 Q^2 / tau^2 + N^2 / tau + (2 ln 2 / pi)
 * B^2 + K^2 tau / 3 (IEEE Std 952-1997, annex C), where
 *   Q  quantisation of the integral, unit s
 *   N  white noise, unit / sqrt(Hz), two-sided; the density in datasheets is N sqrt(2)
 *   B  bias instability, unit
 *   K  random walk, unit / sqrt(s) */
#ifndef TOOLS_CALIBRATE_ALLAN_H
#define TOOLS_CALIBRATE_ALLAN_H

#include <stddef.h>

enum { ALLAN_POINTS_MAX = 80 };

struct allan_point {
	double tau_s, deviation;
	double relative_error; /* 1-sigma of the deviation, from the number of independent clusters */
};

struct allan {
	int count;
	struct allan_point points[ALLAN_POINTS_MAX];
};

struct allan_noise {
	double quantisation, white, bias_instability, random_walk; /* Q, N, B, K; 0: not observable */
};

/** At ten averaging times per decade, up to a ninth of the record. Replaces `values` (at least 3) by their running
 * sum. */
void allan_deviation(double *values, size_t count, double rate_hz, struct allan *result);
/** The same of a record with gaps: `starts` has the index of the first value of each part, 0 first. No difference is
 * taken over a gap. */
void allan_deviation_of_parts(
	double *values, size_t count, const size_t *starts, size_t parts, double rate_hz, struct allan *result);
/** Weighted least squares of the relative errors of sigma^2, with no term below 0. */
struct allan_noise allan_fit(const struct allan *allan);
/** The terms of a fit that the record is long enough for: those with half of the variance at a time whose deviation is
 * known within 20 %. The others are 0. */
struct allan_noise allan_observed(const struct allan *allan, const struct allan_noise *fit);
/** sigma(tau) of the noise model. */
double allan_model(const struct allan_noise *noise, double tau_s);

/** One-sided density of the white noise, as in datasheets. */
double allan_density(const struct allan_noise *noise);

#endif
