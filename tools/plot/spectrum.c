#include "tools/plot/spectrum.h"

#include <complex.h>
#include <math.h>
#include <string.h>

#include "model/math/units.h"

enum { SEGMENT_MIN = 16, SEGMENTS_WANTED = 8 };

/* In place, radix 2. */
static void transform(double complex *x, size_t n)
{
	for (size_t i = 1, j = 0; i < n; i++) {
		size_t bit = n >> 1;

		for (; j & bit; bit >>= 1)
			j ^= bit;
		j ^= bit;
		if (i < j) {
			double complex swapped = x[i];

			x[i] = x[j];
			x[j] = swapped;
		}
	}
	for (size_t length = 2; length <= n; length *= 2)
		for (size_t k = 0; k < length / 2; k++) {
			double complex turn = cexp(-2 * PI * I * (double)k / (double)length);

			for (size_t i = k; i < n; i += length) {
				double complex odd = turn * x[i + length / 2];

				x[i + length / 2] = x[i] - odd;
				x[i] += odd;
			}
		}
}

static bool has_gap(const bool *usable, size_t from, size_t n)
{
	for (size_t i = from + 1; usable && i < from + n; i++)
		if (!usable[i])
			return true;
	return false;
}

void spectrum_of(const double *values, const bool *usable, size_t count, double rate_hz, struct spectrum *result)
{
	static double complex x[SPECTRUM_SEGMENT_MAX];
	size_t n = SPECTRUM_SEGMENT_MAX, segments = 0;
	double window_power = 0;

	while (n > SEGMENT_MIN && n * (SEGMENTS_WANTED + 1) / 2 > count)
		n /= 2;
	memset(result, 0, sizeof(*result));
	result->step_hz = rate_hz / (double)n;
	for (size_t i = 0; i < n; i++)
		window_power += pow(0.5 - 0.5 * cos(2 * PI * (double)i / (double)n), 2);
	for (size_t from = 0; from + n <= count; from += n / 2) {
		double mean = 0;

		if (has_gap(usable, from, n))
			continue;
		for (size_t i = 0; i < n; i++)
			mean += values[from + i] / (double)n;
		for (size_t i = 0; i < n; i++)
			x[i] = (values[from + i] - mean) * (0.5 - 0.5 * cos(2 * PI * (double)i / (double)n));
		transform(x, n);
		for (size_t k = 1; k <= n / 2; k++)
			result->density[k] += (k < n / 2 ? 2 : 1) * creal(x[k] * conj(x[k])) / (rate_hz * window_power);
		segments++;
	}
	result->bins = segments ? n / 2 : 0;
	for (size_t k = 1; k <= result->bins; k++)
		result->density[k] /= (double)segments;
}
