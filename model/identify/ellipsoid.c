#include "model/identify/ellipsoid.h"

#include <errno.h>

#include "model/math/linalg.h"

enum { N = ELLIPSOID_UNKNOWNS, ROBUST_PASSES = 3, STEPS_MAX = 15 };
/* Least eigenvalue of the mean information of a point, for points evenly spaced on the sphere: 1/5 - 1/15. */
static const double BEST_INFORMATION = 2.0 / 15;
/* Edge of Huber's weight, in mean absolute distances: 1.6 sigma of a normal distribution. */
static const double HUBER = 2;

/* ---- the quadric ------------------------------------------------------------------------------------------------- */

/* Mean and RMS distance from it: origin and unit in which the normal matrix is well conditioned. */
static double span(const struct vec3 *points, int count, struct vec3 *mean)
{
	double sum = 0;

	*mean = (struct vec3){0, 0, 0};
	for (int i = 0; i < count; i++)
		*mean = vec3_add(*mean, vec3_scale(1.0 / count, points[i]));
	for (int i = 0; i < count; i++) {
		struct vec3 d = vec3_sub(points[i], *mean);

		sum += vec3_dot(d, d);
	}
	return sqrt(sum / count);
}

/* x^2 + y^2 + z^2 = u . row: a quadric of trace 3 */
static void quadric_row(struct vec3 p, double row[N])
{
	double xx = p.x * p.x, yy = p.y * p.y, zz = p.z * p.z;

	row[0] = xx + yy - 2 * zz;
	row[1] = xx + zz - 2 * yy;
	row[2] = 2 * p.x * p.y;
	row[3] = 2 * p.x * p.z;
	row[4] = 2 * p.y * p.z;
	row[5] = 2 * p.x;
	row[6] = 2 * p.y;
	row[7] = 2 * p.z;
	row[8] = 1;
}

static int quadric(const struct vec3 *points, int count, struct vec3 origin, double unit, double u[N])
{
	double normal[N * N] = {0};

	for (int j = 0; j < N; j++)
		u[j] = 0;
	for (int i = 0; i < count; i++) {
		struct vec3 p = vec3_scale(1 / unit, vec3_sub(points[i], origin));
		double row[N], square = vec3_dot(p, p);

		quadric_row(p, row);
		for (int j = 0; j < N; j++) {
			u[j] += row[j] * square;
			for (int k = 0; k < N; k++)
				normal[j * N + k] += row[j] * row[k];
		}
	}
	return linalg_solve(N, normal, u);
}

/* Sum over k of f[k] times the projector on vector k. */
static struct mat3 compose(const double f[3], const double vectors[9])
{
	struct mat3 m = {{{0}}};

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++) {
			for (int k = 0; k < 3; k++)
				m.m[i][j] += f[k] * vectors[3 * k + i] * vectors[3 * k + j];
		}
	return m;
}

/* ---- the fit ----------------------------------------------------------------------------------------------------- */

static double distance(const struct ellipsoid *e, struct vec3 p)
{
	return vec3_norm(mat3_apply(e->matrix, vec3_sub(p, e->centre))) - e->radius;
}

static double weight(const struct ellipsoid *e, struct vec3 p, double edge)
{
	double d = fabs(distance(e, p));

	return d <= edge ? 1 : edge / d;
}

/* Derivatives of distance / radius with respect to centre / radius and the elements of the matrix. */
static void derivatives(const struct ellipsoid *e, struct vec3 p, double row[N])
{
	struct vec3 d = vec3_sub(p, e->centre), f = mat3_apply(e->matrix, d);
	struct vec3 n = vec3_scale(1 / fmax(vec3_norm(f), 1e-9 * e->radius), f), mn = mat3_apply(e->matrix, n);

	d = vec3_scale(1 / e->radius, d);
	row[0] = -mn.x;
	row[1] = -mn.y;
	row[2] = -mn.z;
	row[3] = n.x * d.x;
	row[4] = n.y * d.y;
	row[5] = n.z * d.z;
	row[6] = n.x * d.y + n.y * d.x;
	row[7] = n.x * d.z + n.z * d.x;
	row[8] = n.y * d.z + n.z * d.y;
}

static struct ellipsoid step_from(const struct ellipsoid *e, const double step[N])
{
	struct ellipsoid m = *e;

	m.centre = vec3_add(m.centre, vec3_scale(e->radius, (struct vec3){step[0], step[1], step[2]}));
	for (int i = 0; i < 3; i++)
		m.matrix.m[i][i] += step[3 + i];
	m.matrix.m[0][1] = m.matrix.m[1][0] += step[6];
	m.matrix.m[0][2] = m.matrix.m[2][0] += step[7];
	m.matrix.m[1][2] = m.matrix.m[2][1] += step[8];
	return m;
}

/* The weights follow from the ellipsoid at the beginning of a pass of the robust fit. */
struct problem {
	const struct vec3 *points;
	int count;
	struct ellipsoid before;
	double edge;
};

static double cost(const struct problem *p, const struct ellipsoid *e)
{
	double sum = 0;

	for (int i = 0; i < p->count; i++) {
		double d = distance(e, p->points[i]) / e->radius;

		sum += weight(&p->before, p->points[i], p->edge) * d * d;
	}
	return sum;
}

static void normal_equations(const struct problem *p, const struct ellipsoid *e, double normal[N * N], double right[N])
{
	for (int j = 0; j < N * N; j++)
		normal[j] = 0;
	for (int j = 0; j < N; j++)
		right[j] = 0;
	for (int i = 0; i < p->count; i++) {
		double row[N], d = distance(e, p->points[i]) / e->radius;
		double w = weight(&p->before, p->points[i], p->edge);

		derivatives(e, p->points[i], row);
		for (int j = 0; j < N; j++) {
			right[j] -= w * row[j] * d;
			for (int k = 0; k < N; k++)
				normal[j * N + k] += w * row[j] * row[k];
		}
	}
}

static double length(const double v[N])
{
	double sum = 0;

	for (int j = 0; j < N; j++)
		sum += v[j] * v[j];
	return sqrt(sum);
}

/* Ends early when the points do not determine the parameters, which evaluate() reports. */
static void minimise(const struct problem *p, struct ellipsoid *e)
{
	double damping = 1e-4, now = cost(p, e);

	for (int i = 0; i < STEPS_MAX; i++) {
		double normal[N * N], step[N], next;
		struct ellipsoid there;

		normal_equations(p, e, normal, step);
		for (int j = 0; j < N; j++)
			normal[j * (N + 1)] *= 1 + damping;
		if (linalg_solve(N, normal, step) < 0)
			break;
		there = step_from(e, step);
		next = cost(p, &there);
		if (next <= now) {
			*e = there;
			now = next;
			damping *= 0.1;
		} else {
			damping *= 10;
		}
		if (length(step) < 1e-9 || damping > 1e9)
			break;
	}
}

static double mean_distance(const struct vec3 *points, int count, const struct ellipsoid *e)
{
	double sum = 0;

	for (int i = 0; i < count; i++)
		sum += fabs(distance(e, points[i]));
	return sum / count;
}

/* For the directions of the points only, as if they lay on the unit sphere. */
static double coverage(const struct problem *p, const struct ellipsoid *e)
{
	double information[N * N] = {0}, values[N], vectors[N * N];

	for (int i = 0; i < p->count; i++) {
		struct vec3 f = mat3_apply(e->matrix, vec3_sub(p->points[i], e->centre));
		struct vec3 n = vec3_scale(1 / fmax(vec3_norm(f), 1e-9 * e->radius), f);
		const double row[N] = {
			n.x, n.y, n.z, n.x * n.x, n.y * n.y, n.z * n.z, 2 * n.x * n.y, 2 * n.x * n.z, 2 * n.y * n.z};

		for (int j = 0; j < N; j++)
			for (int k = 0; k < N; k++)
				information[j * N + k] += row[j] * row[k] / p->count;
	}
	if (linalg_eigen(N, information, values, vectors) < 0)
		return 0;
	return sqrt(fmin(1, fmax(0, values[0]) / BEST_INFORMATION));
}

/* Fills in the quality of the fit. */
static int evaluate(const struct problem *p, struct ellipsoid *e)
{
	double normal[N * N], right[N], copy[9], values[3], vectors[9], sum = 0, variance;

	normal_equations(p, e, normal, right);
	e->coverage = coverage(p, e);
	for (int i = 0; i < p->count; i++)
		sum += distance(e, p->points[i]) * distance(e, p->points[i]);
	e->rms = sqrt(sum / (p->count - N));
	if (linalg_invert(N, normal) < 0)
		return -EDOM;
	variance = e->rms * e->rms;
	e->sigma = (struct vec3){
		sqrt(normal[0] * variance), sqrt(normal[N + 1] * variance), sqrt(normal[2 * (N + 1)] * variance)};
	e->matrix_sigma = 0;
	for (int j = 3; j < N; j++)
		e->matrix_sigma = fmax(e->matrix_sigma, sqrt(normal[j * (N + 1)] * variance) / e->radius);
	for (int j = 0; j < 9; j++)
		copy[j] = e->matrix.m[j / 3][j % 3];
	if (linalg_eigen(3, copy, values, vectors) < 0)
		return -EDOM;
	e->least = values[0];
	e->largest = values[2];
	e->mean = pow(fmax(0, values[0] * values[1] * values[2]), 1.0 / 3);
	return 0;
}

int ellipsoid_guess(const struct vec3 *points, int count, double radius, struct ellipsoid *e)
{
	double u[N], a[9], values[3], vectors[9], f[3], level;
	struct vec3 origin, linear, centre;
	double unit;

	if (count <= N)
		return -EDOM;
	unit = span(points, count, &origin);
	if (!(unit > 0) || !isfinite(unit) || quadric(points, count, origin, unit, u) < 0)
		return -EDOM;
	a[0] = 1 - u[0] - u[1];
	a[4] = 1 - u[0] + 2 * u[1];
	a[8] = 1 + 2 * u[0] - u[1];
	a[1] = a[3] = -u[2];
	a[2] = a[6] = -u[3];
	a[5] = a[7] = -u[4];
	linear = (struct vec3){u[5], u[6], u[7]};
	if (linalg_eigen(3, a, values, vectors) < 0 || !(values[0] > 1e-3))
		return -EDOM;
	for (int k = 0; k < 3; k++)
		f[k] = 1 / values[k];
	centre = mat3_apply(compose(f, vectors), linear);
	level = vec3_dot(centre, linear) + u[8]; /* (p - c)' A (p - c) on the ellipsoid */
	if (!(level > 0))
		return -EDOM;
	for (int k = 0; k < 3; k++)
		f[k] = radius / unit * sqrt(values[k] / level);
	e->matrix = compose(f, vectors);
	e->centre = vec3_add(origin, vec3_scale(unit, centre));
	e->radius = radius;
	return evaluate(&(struct problem){points, count, *e, (double)INFINITY}, e);
}

int ellipsoid_fit(const struct vec3 *points, int count, double radius, bool robust, struct ellipsoid *e)
{
	struct problem p = {.points = points, .count = count};
	struct ellipsoid fit = *e;

	if (count <= N)
		return -EDOM;
	fit.radius = radius;
	for (int pass = 0; pass < (robust ? ROBUST_PASSES : 1); pass++) {
		p.before = fit;
		p.edge = robust ? HUBER * mean_distance(points, count, &fit) : (double)INFINITY;
		minimise(&p, &fit);
	}
	if (evaluate(&p, &fit) < 0)
		return -EDOM;
	*e = fit;
	return 0;
}
