#include "tools/calibrate/allan.h"

#include <math.h>
#include <stdbool.h>

enum { TERMS = 4 };
static const double FLICKER = 0.44127122; /* 2 ln 2 / pi */

/* Replaces values[k] by the sum of all values before k, so that a cluster mean is a difference of two. The last value
 * is not used. */
static void integrate(double *values, size_t count)
{
	double mean = 0, sum = 0;

	for (size_t k = 0; k < count; k++)
		mean += values[k] / (double)count;
	for (size_t k = 0; k < count; k++) {
		double value = values[k] - mean; /* small sums lose no digits in the differences */

		values[k] = sum;
		sum += value;
	}
}

static double deviation(const double *x, size_t count, size_t m)
{
	double sum = 0;

	for (size_t k = 0; k + 2 * m < count; k++) {
		double d = x[k + 2 * m] - 2 * x[k + m] + x[k];

		sum += d * d;
	}
	return sqrt(sum / (2 * (double)m * (double)m * (double)(count - 2 * m)));
}

void allan_deviation(double *values, size_t count, double rate_hz, struct allan *result)
{
	size_t last = 0;

	result->count = 0;
	integrate(values, count);
	for (int i = 0; result->count < ALLAN_POINTS_MAX; i++) {
		size_t m = (size_t)(pow(10, i / 10.0) + 0.5);

		if (m > 1 && m > count / 9)
			break;
		if (m == last)
			continue;
		last = m;
		result->points[result->count++] = (struct allan_point){
			.tau_s = (double)m / rate_hz,
			.deviation = deviation(values, count, m),
			.relative_error = 1 / sqrt(2 * ((double)count / (double)m - 1)),
		};
	}
}

static void basis(double tau_s, double terms[TERMS])
{
	terms[0] = 3 / (tau_s * tau_s);
	terms[1] = 1 / tau_s;
	terms[2] = FLICKER;
	terms[3] = tau_s / 3;
}

double allan_model(const struct allan_noise *noise, double tau_s)
{
	double terms[TERMS];

	basis(tau_s, terms);
	return sqrt(terms[0] * noise->quantisation * noise->quantisation + terms[1] * noise->white * noise->white +
		    terms[2] * noise->bias_instability * noise->bias_instability +
		    terms[3] * noise->random_walk * noise->random_walk);
}

double allan_density(const struct allan_noise *noise)
{
	return noise->white * sqrt(2);
}

struct normal { /* A^T A and A^T 1 */
	double a[TERMS][TERMS], b[TERMS];
};

static void add_point(struct normal *normal, const struct allan_point *point)
{
	double terms[TERMS], square = point->deviation * point->deviation;

	basis(point->tau_s, terms);
	for (int i = 0; i < TERMS; i++)
		terms[i] /= square * 2 * point->relative_error;
	for (int i = 0; i < TERMS; i++) {
		for (int j = 0; j < TERMS; j++)
			normal->a[i][j] += terms[i] * terms[j];
		normal->b[i] += terms[i] / (2 * point->relative_error);
	}
}

/* Solves for the terms in `set` by Gauss-Jordan elimination, scaled because their magnitudes differ by decades; the
 * other terms are 0. False when a term is negative. */
static bool solve(const struct normal *normal, unsigned set, double x[TERMS])
{
	double m[TERMS][TERMS + 1], size[TERMS];

	for (int i = 0; i < TERMS; i++)
		size[i] = normal->a[i][i] > 0 ? 1 / sqrt(normal->a[i][i]) : 0;
	for (int i = 0; i < TERMS; i++) {
		for (int j = 0; j < TERMS; j++)
			m[i][j] = (set >> i & set >> j & 1) ? normal->a[i][j] * size[i] * size[j] : i == j;
		m[i][TERMS] = set >> i & 1 ? normal->b[i] * size[i] : 0;
	}
	for (int i = 0; i < TERMS; i++)
		for (int row = 0; row < TERMS; row++) {
			double k = m[row][i] / m[i][i];

			for (int j = 0; row != i && j <= TERMS; j++)
				m[row][j] -= k * m[i][j];
		}
	for (int i = 0; i < TERMS; i++) {
		x[i] = m[i][TERMS] / m[i][i] * size[i];
		if (!(x[i] >= 0))
			return false;
	}
	return true;
}

/* Sum of squares, without the constant that is independent of x. */
static double misfit(const struct normal *normal, const double x[TERMS])
{
	double sum = 0;

	for (int i = 0; i < TERMS; i++) {
		sum -= 2 * normal->b[i] * x[i];
		for (int j = 0; j < TERMS; j++)
			sum += x[i] * normal->a[i][j] * x[j];
	}
	return sum;
}

struct allan_noise allan_fit(const struct allan *allan)
{
	struct normal normal = {{{0}}, {0}};
	double best[TERMS] = {0}, least = 0;

	for (int i = 0; i < allan->count; i++)
		if (allan->points[i].deviation > 0)
			add_point(&normal, &allan->points[i]);
	for (unsigned set = 1; set < 1u << TERMS; set++) {
		double x[TERMS];

		if (solve(&normal, set, x) && misfit(&normal, x) < least) {
			least = misfit(&normal, x);
			for (int i = 0; i < TERMS; i++)
				best[i] = x[i];
		}
	}
	return (struct allan_noise){sqrt(best[0]), sqrt(best[1]), sqrt(best[2]), sqrt(best[3])};
}
