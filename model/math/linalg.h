/* model/math/linalg.h
 * Small symmetric systems: normal equations and covariances of the calibrations. Matrices are row-major arrays of the
 * caller, n * n, n from 1 to LINALG_MAX; all elements are read and written, not one triangle only. */
#ifndef MODEL_MATH_LINALG_H
#define MODEL_MATH_LINALG_H

enum { LINALG_MAX = 12 };

/** b becomes the solution x of a x = b; a is overwritten. 0, or -EDOM: a is not positive definite, or so nearly
 * singular that a pivot is below 1e-13 of its diagonal element, or not finite; b is then untouched. */
int linalg_solve(int n, double *a, double *b);
/** a becomes its inverse. 0, or -EDOM as above. */
int linalg_invert(int n, double *a);
/** Eigenvalues in ascending order; row k of vectors is the unit vector of values[k]. a is overwritten. Cyclic Jacobi
 * (Golub, Van Loan, Matrix Computations, 8.5). 0, or -EDOM: not finite. */
int linalg_eigen(int n, double *a, double *values, double *vectors);

#endif
