#include "tools/calibrate/allan.h"

#include <math.h>
#include <stdbool.h>

enum { TERMS = 4 };
static const double FLICKER = 0.44127122; /* 2 ln 2 / pi */
/* Up to a ninth of the record. */
static const double CLUSTERS_LEAST = 8;
/* A term is observed where it has this share of the variance, at a point of at most this relative error. By judgement:
 * below, the fit takes the scatter of others for it. */
static const double SHARE_LEAST = 0.5, ERROR_MOST = 0.2;

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

/* Of the parts of the record, that of the i-th value ends before this one. */
static size_t end_of(const size_t *starts, size_t parts, size_t i, size_t count)
{
	return i + 1 < parts ? starts[i + 1] : count;
}

/* Sum over the parts. *clusters: the number of independent differences between neighbouring clusters of m values. */
static double deviation(const double *x, size_t count, const size_t *starts, size_t parts, size_t m, double *clusters)
{
	size_t differences = 0;
	double sum = 0;

	*clusters = 0;
	for (size_t i = 0; i < parts; i++) {
		size_t end = end_of(starts, parts, i, count), size = end - starts[i];

		if (size > m)
			*clusters += (double)size / (double)m - 1;
		for (size_t k = starts[i]; k + 2 * m < end; k++) {
			double d = x[k + 2 * m] - 2 * x[k + m] + x[k];

			sum += d * d;
			differences++;
		}
	}
	return differences ? sqrt(sum / (2 * (double)m * (double)m * (double)differences)) : 0;
}

void allan_deviation_of_parts(
	double *values, size_t count, const size_t *starts, size_t parts, double rate_hz, struct allan *result)
{
	size_t last = 0;

	result->count = 0;
	integrate(values, count);
	for (int i = 0; result->count < ALLAN_POINTS_MAX; i++) {
		size_t m = (size_t)(pow(10, i / 10.0) + 0.5);
		double clusters, value;

		if (m == last)
			continue;
		value = deviation(values, count, starts, parts, m, &clusters);
		if (m > 1 && clusters < CLUSTERS_LEAST)
			break;
		last = m;
		result->points[result->count++] = (struct allan_point){
			.tau_s = (double)m / rate_hz,
			.deviation = value,
			.relative_error = 1 / sqrt(2 * clusters),
		};
	}
}

void allan_deviation(double *values, size_t count, double rate_hz, struct allan *result)
{
	const size_t start = 0;

	allan_deviation_of_parts(values, count, &start, 1, rate_hz, result);
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

/* Whether the record is long enough to show each term. */
static void drop_unobserved(const struct allan *allan, double x[TERMS])
{
	bool observed[TERMS] = {false};

	for (int k = 0; k < allan->count; k++) {
		double terms[TERMS], all = 0;

		basis(allan->points[k].tau_s, terms);
		for (int i = 0; i < TERMS; i++)
			all += terms[i] * x[i];
		for (int i = 0; i < TERMS; i++)
			observed[i] |=
				allan->points[k].relative_error <= ERROR_MOST && terms[i] * x[i] > SHARE_LEAST * all;
	}
	for (int i = 0; i < TERMS; i++)
		x[i] = observed[i] ? x[i] : 0;
}

struct allan_noise allan_observed(const struct allan *allan, const struct allan_noise *fit)
{
	double x[TERMS] = {fit->quantisation * fit->quantisation, fit->white * fit->white,
		fit->bias_instability * fit->bias_instability, fit->random_walk * fit->random_walk};

	drop_unobserved(allan, x);
	return (struct allan_noise){sqrt(x[0]), sqrt(x[1]), sqrt(x[2]), sqrt(x[3])};
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
