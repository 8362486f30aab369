/* tools/plot/spectrum.h
 * Power spectral density by Welch's method: Hann window, segments that overlap by half, each without its mean. Pure. */
#ifndef TOOLS_PLOT_SPECTRUM_H
#define TOOLS_PLOT_SPECTRUM_H

#include <stdbool.h>
#include <stddef.h>

enum { SPECTRUM_SEGMENT_MAX = 4096 };

struct spectrum {
	size_t bins; /* frequencies k * step_hz, k = 1 .. bins; 0: too few samples */
	double step_hz;
	double density[SPECTRUM_SEGMENT_MAX / 2 +
		       1]; /* one-sided, unit^2 / Hz; the sum over k times step_hz is the variance */
};

/** `usable`: whether a sample follows the one before without a gap; segments with another one are left out. NULL: all
 * are. The segment is the longest power of two of which eight fit, or, of a short record, one. */
void spectrum_of(const double *values, const bool *usable, size_t count, double rate_hz, struct spectrum *result);

#endif
