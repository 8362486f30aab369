/* model/identify/ellipsoid.h
 * The ellipsoid on which a triad's raw vectors end when what it measures has a constant length: gravity at rest, the
 * Earth's field while turning. Its centre is the bias; a matrix makes it a sphere.
 *
 * A sphere stays one under every rotation, so these measurements can not tell how the triad is turned against the axes
 * of the sensor: of the nine elements three stay unknown. The matrix is taken symmetric, which is the one that turns the
 * vectors least. */
#ifndef MODEL_IDENTIFY_ELLIPSOID_H
#define MODEL_IDENTIFY_ELLIPSOID_H

#include "model/math/rotation.h"

enum { ELLIPSOID_UNKNOWNS = 9 };

struct ellipsoid {
	struct vec3 centre;  /* unit of the points */
	struct mat3 matrix;  /* symmetric: |matrix (p - centre)| = radius */
	double radius;	     /* as given */
	double rms;	     /* of |matrix (p - centre)| - radius, per degree of freedom (points - 9) */
	struct vec3 sigma;   /* 1 sigma of the centre if each point errs by rms */
	double matrix_sigma; /* the largest of the matrix's elements */
	double coverage;     /* 0..1: how certain the least certain unknown is, against points all over the sphere */
	double least, largest, mean; /* eigenvalues of the matrix; their geometric mean */
};

/** Without a beginning: the quadric of least algebraic error whose trace is 3 (a linear problem; the constraint does not
 * depend on origin and direction of the axes). 0, or -EDOM: 9 points or fewer, they span too little, or the quadric is no
 * ellipsoid. */
int ellipsoid_guess(const struct vec3 *points, int count, double radius, struct ellipsoid *e);

/** From *e (centre, matrix) on: least squares of the distance |matrix (p - centre)| - radius by Levenberg and Marquardt.
 * robust: points far off weigh less (Huber). 0, or -EDOM: 9 points or fewer, or they span too little. */
int ellipsoid_fit(const struct vec3 *points, int count, double radius, bool robust, struct ellipsoid *e);

#endif
