#include "model/math/linalg.h"

#include <errno.h>
#include <math.h>

/* Least pivot as a share of its diagonal element. By judgement: some 500 times the rounding of a double. */
static const double LEAST_PIVOT = 1e-13;
enum { SWEEPS_MAX = 50 }; /* quadratic convergence: six are usual */

/* a becomes its Cholesky factor L (lower triangle, zeros above): a = L L'. 0, or -EDOM. */
static int cholesky(int n, double *a)
{
	for (int j = 0; j < n; j++) {
		double pivot = a[j * n + j];
		double least = LEAST_PIVOT * pivot;

		for (int k = 0; k < j; k++)
			pivot -= a[j * n + k] * a[j * n + k];
		if (!(pivot > least && pivot > 0 && isfinite(pivot)))
			return -EDOM;
		a[j * n + j] = sqrt(pivot);
		for (int i = j + 1; i < n; i++) {
			double sum = a[i * n + j];

			for (int k = 0; k < j; k++)
				sum -= a[i * n + k] * a[j * n + k];
			a[i * n + j] = sum / a[j * n + j];
			a[j * n + i] = 0;
		}
	}
	return 0;
}

/* b becomes the solution x of L L' x = b. */
static void solve(int n, const double *l, double *b)
{
	for (int i = 0; i < n; i++) {
		for (int k = 0; k < i; k++)
			b[i] -= l[i * n + k] * b[k];
		b[i] /= l[i * n + i];
	}
	for (int i = n - 1; i >= 0; i--) {
		for (int k = i + 1; k < n; k++)
			b[i] -= l[k * n + i] * b[k];
		b[i] /= l[i * n + i];
	}
}

int linalg_solve(int n, double *a, double *b)
{
	int result = cholesky(n, a);

	if (result == 0)
		solve(n, a, b);
	return result;
}

int linalg_invert(int n, double *a)
{
	double l[LINALG_MAX * LINALG_MAX] = {0}, column[LINALG_MAX];
	int result = cholesky(n, a);

	if (result < 0)
		return result;
	for (int i = 0; i < n * n; i++)
		l[i] = a[i];
	for (int j = 0; j < n; j++) {
		for (int i = 0; i < n; i++)
			column[i] = i == j;
		solve(n, l, column);
		for (int i = 0; i < n; i++)
			a[i * n + j] = column[i];
	}
	return 0;
}

/* Turns rows and columns p and q of a so that a[p][q] becomes 0, and the vectors with them. */
static void rotate(int n, double *a, double *vectors, int p, int q)
{
	double theta = (a[q * n + q] - a[p * n + p]) / (2 * a[p * n + q]);
	double t = (theta >= 0 ? 1 : -1) / (fabs(theta) + sqrt(theta * theta + 1));
	double c = 1 / sqrt(t * t + 1), s = t * c;

	for (int k = 0; k < n; k++) {
		double kp = a[k * n + p], kq = a[k * n + q];

		a[k * n + p] = c * kp - s * kq;
		a[k * n + q] = s * kp + c * kq;
	}
	for (int k = 0; k < n; k++) {
		double pk = a[p * n + k], qk = a[q * n + k];
		double vp = vectors[p * n + k], vq = vectors[q * n + k];

		a[p * n + k] = c * pk - s * qk;
		a[q * n + k] = s * pk + c * qk;
		vectors[p * n + k] = c * vp - s * vq;
		vectors[q * n + k] = s * vp + c * vq;
	}
	a[p * n + q] = a[q * n + p] = 0;
}

static void swap(double *x, double *y)
{
	double z = *x;

	*x = *y;
	*y = z;
}

static void sort(int n, double *values, double *vectors)
{
	for (int i = 0; i < n - 1; i++)
		for (int j = i + 1; j < n; j++) {
			if (values[j] >= values[i])
				continue;
			swap(&values[i], &values[j]);
			for (int k = 0; k < n; k++)
				swap(&vectors[i * n + k], &vectors[j * n + k]);
		}
}

int linalg_eigen(int n, double *a, double *values, double *vectors)
{
	double size = 0;

	for (int i = 0; i < n * n; i++) {
		vectors[i] = i % (n + 1) == 0;
		size += fabs(a[i]);
	}
	if (!isfinite(size))
		return -EDOM;
	for (int sweep = 0; sweep < SWEEPS_MAX; sweep++)
		for (int p = 0; p < n - 1; p++)
			for (int q = p + 1; q < n; q++)
				if (fabs(a[p * n + q]) > 1e-300)
					rotate(n, a, vectors, p, q);
	for (int i = 0; i < n; i++)
		values[i] = a[i * n + i];
	sort(n, values, vectors);
	return 0;
}
