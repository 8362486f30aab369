/* model/math/kalman.h
 * What the two Kalman filters (fusion_kalman.c, navigation.c) do with a covariance. p is n x n, row-major, symmetric; x
 * collects the estimated errors of the n states until the filter applies them. Functions are inline so that the
 * compiler knows n.
 *
 * A scalar measurement z = h x + v, v white with the variance R, updates them (A. Gelb (ed.), "Applied Optimal
 * Estimation", 1974, table 4.2-1):
 *   innovation y = z - h x,   its variance S = h P h^T + R,   gain K = P h^T / S,   x += K y,   P -= K h P. */
#ifndef MODEL_MATH_KALMAN_H
#define MODEL_MATH_KALMAN_H

static inline double squared(double a)
{
	return a * a;
}

/** The update above, from ph = P h^T, which must not be a row of p itself. Only the first `estimated` states are
 * corrected; the others (n: none) are consider states of a Schmidt-Kalman filter: their variance stays, their
 * covariance with the estimated ones shrinks. */
static inline void kalman_update(
	int n, int estimated, double *p, double *x, const double *ph, double innovation, double innovation_variance)
{
	for (int i = 0; i < estimated; i++) {
		const double gain = ph[i] / innovation_variance;

		x[i] += gain * innovation;
		for (int j = 0; j < estimated; j++)
			p[i * n + j] -= gain * ph[j];
		for (int j = estimated; j < n; j++)
			p[j * n + i] = p[i * n + j] -= gain * ph[j];
	}
}

/** The error of state i is independent of all others and has this variance. */
static inline void kalman_set_variance(int n, double *p, int i, double variance)
{
	for (int j = 0; j < n; j++)
		p[i * n + j] = p[j * n + i] = 0;
	p[i * n + i] = variance;
}

/** Rows to, to + 1, .. (`rows` of them) of p += sign M (rows from .. from + 2 of p); M is rows x 3, row-major. One
 * block of a state transition F that is the identity elsewhere: p = F p. */
static inline void kalman_add_rows(int n, double *p, int to, int rows, double sign, const double *m, int from)
{
	for (int i = 0; i < rows; i++) {
		const double a = sign * m[3 * i], b = sign * m[3 * i + 1], c = sign * m[3 * i + 2];
		const double *row = p + from * n;

		for (int j = 0; j < n; j++)
			p[(to + i) * n + j] += a * row[j] + b * row[n + j] + c * row[2 * n + j];
	}
}

static inline void kalman_transpose(int n, double *p)
{
	for (int i = 0; i < n; i++)
		for (int j = 0; j < i; j++) {
			double t = p[i * n + j];

			p[i * n + j] = p[j * n + i];
			p[j * n + i] = t;
		}
}

/** Makes p symmetric again, by its upper triangle. Rounding makes p_ij and p_ji differ, and F p F^T as above takes this
 * for a covariance: through a chain of integrators the difference grows with the cube of the time, for hours of a
 * standstill beyond the variances themselves. To be called after each F p F^T. */
static inline void kalman_symmetrize(int n, double *p)
{
	for (int i = 0; i < n; i++)
		for (int j = 0; j < i; j++)
			p[i * n + j] = p[j * n + i];
}

#endif
