/* model/identify/ellipsoid.h
 * The ellipsoid on which the raw vectors of a triad lie when the measured quantity has a constant magnitude: gravity at
 * rest, the Earth's field while turning. Its centre is the bias; a matrix transforms it into a sphere.
 *
 * A sphere is invariant under rotation, so the rotation of the triad against the axes of the sensor is not observable:
 * three of the nine elements of the matrix stay unknown. The symmetric matrix is chosen, which rotates the vectors
 * least. */
#ifndef MODEL_IDENTIFY_ELLIPSOID_H
#define MODEL_IDENTIFY_ELLIPSOID_H

#include "model/math/rotation.h"

enum { ELLIPSOID_UNKNOWNS = 9 };

struct ellipsoid {
	struct vec3 centre;  /* unit of the points */
	struct mat3 matrix;  /* symmetric: |matrix (p - centre)| = radius */
	double radius;	     /* as given */
	double rms;	     /* of |matrix (p - centre)| - radius, per degree of freedom (points - 9) */
	struct vec3 sigma;   /* 1 sigma of the centre, if the error of each point is rms */
	double matrix_sigma; /* 1 sigma of the least certain element of the matrix */
	/* 0..1: 1 sigma of the least certain unknown for points evenly spaced on the sphere, as a share of its 1 sigma
	 * for these points. 1: even; 0.13: one hemisphere; 0: a circle. */
	double coverage;
	double least, largest, mean; /* eigenvalues of the matrix; their geometric mean */
};

/** Needs no initial value: the quadric of trace 3 with the least algebraic error (a linear problem; the constraint is
 * independent of the origin and the direction of the axes). 0, or -EDOM: 9 points or fewer, they span too little, or
 * the quadric is not an ellipsoid. */
int ellipsoid_guess(const struct vec3 *points, int count, double radius, struct ellipsoid *e);

/** Least squares of |matrix (p - centre)| - radius by Levenberg-Marquardt, from the initial value *e (centre, matrix).
 * robust: outliers get less weight (Huber). 0, or -EDOM: 9 points or fewer, or they span too little. */
int ellipsoid_fit(const struct vec3 *points, int count, double radius, bool robust, struct ellipsoid *e);

#endif
