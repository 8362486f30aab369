/* model/smoother.h
 * The path of the movement just ended, each of its points corrected by everything that was measured after it, the
 * standstill above all: a fixed-interval smoother for the error-state filter of navigation.h, in bounded memory.
 *
 * While the robot moves, points are kept: place, velocity, and the covariance X of their errors with the filter's of now.
 * What the filter does from one point to the next is one linear map, however many steps it was. It is accumulated as the
 * modified Bryson-Frazier smoother does it, which inverts no matrix: with a transition F and a scalar measurement of
 * row h (innovation y of variance s, gain k)
 *   A <- F A;   g = A^T h:  b <- b - g y / s,  M <- M + g g^T / s,  A <- A - k g^T,
 * and moves every point kept by
 *   point <- point - X b,  its variance <- variance - X M X^T,  X <- X A^T.
 * That is the smoother's backward pass in the other order, so that points can be dropped at no loss and none is computed at
 * the end. When the memory is full every second point goes and the spacing doubles. The first point is zero and certain,
 * the last is the filter's.
 *
 * Sources: G. Bierman, "Fixed interval smoothing with discrete measurements", Int. J. Control 18(1), 1973; J. Meditch,
 * "Stochastic Optimal Linear Estimation and Control", 1969, ch. 6 (fixed-point smoothing). */
#ifndef MODEL_SMOOTHER_H
#define MODEL_SMOOTHER_H

#include <stddef.h>

#include "model/navigation.h"

enum { SMOOTHER_POINTS = 128, SMOOTHER_ROWS = 6 };

#define SMOOTHER_SPACING_S 0.2 /* of the points, to begin with */

/** Of the reference point, global frame, since the movement began. sigma: 1 sigma of the position. */
struct smoother_point {
	double t_s;
	struct vec3 position_n_m, velocity_n_m_s, sigma_m;
};

/** From one standstill of a second to the next. */
struct smoother_movement {
	unsigned number; /* of those that ended, from 1; 0: there was none */
	bool whole; /* else something broke it: a gap, a velocity, place or attitude set, another north. What was learnt
			    after that has corrected the points before it in part or not at all */
	double duration_s;
	double path_m; /* its length: along the points, and more by as much as the live path is longer than along them */
	double stood_s;		       /* for how long it had been over when this was known */
	double farthest_m, farthest_s; /* the greatest distance from where it began, and when */
	size_t count;
	struct smoother_point point[SMOOTHER_POINTS];
};

/** Of a point: the errors of its velocity and its position, with all of the filter's errors of now. */
struct smoother_kept {
	struct smoother_point point, live;
	double variance[3];
	double x[SMOOTHER_ROWS][NAVIGATION_STATES];
};

/** From one time to another: A, b and M of above. */
struct smoother_map {
	double a[NAVIGATION_STATES][NAVIGATION_STATES], b[NAVIGATION_STATES], m[NAVIGATION_STATES][NAVIGATION_STATES];
};

/** Caller-owned, 134 kB; zeroed it is ready. */
struct smoother {
	struct smoother_movement last; /* the movement last ended */
	/* PRIVATE */
	bool recording, whole;
	double t_s, spacing_s;
	struct smoother_map recent;  /* from the last point to now */
	struct smoother_map earlier; /* to the last point from where kept[0] to kept[settled - 1] were moved to */
	size_t count, settled;
	struct vec3 from_n_m;	    /* where it began */
	struct smoother_point here; /* where it was marked last */
	struct smoother_point live; /* the same as the velocity led there from the beginning */
	double live_m;		    /* the length of that way */
	struct smoother_kept kept[SMOOTHER_POINTS];
};

/* All of them take NULL for s, and do nothing then, or while no movement is recorded. here: position and velocity; p: the
 * filter's covariance. */

/** A movement begins. */
void smoother_begin(struct smoother *s, struct smoother_point here, double p[NAVIGATION_STATES][NAVIGATION_STATES]);
/** The place was set to zero: the movement counts from here, and is not whole. */
void smoother_restart(struct smoother *s, struct smoother_point here, double p[NAVIGATION_STATES][NAVIGATION_STATES]);
/** Time passes. */
void smoother_elapse(struct smoother *s, double dt_s);
/** What is to be multiplied by the filter's transition from the left, as its covariance is; NULL: nothing. */
double (*smoother_transition(struct smoother *s))[NAVIGATION_STATES];
/** The filter takes a measurement: its row, p row, innovation and variance. */
void smoother_measure(struct smoother *s, const double row[NAVIGATION_STATES], const double p_row[NAVIGATION_STATES],
	double innovation, double variance);
/** Three errors from `at` on are independent of all before. The movement is not whole. */
void smoother_reset_errors(struct smoother *s, int at);
/** Something else broke the movement, which goes on. */
void smoother_break(struct smoother *s);
/** All transitions and measurements up to here were told: a point is kept when it is time. Often enough to follow the path
 * by the velocities. */
void smoother_mark(struct smoother *s, struct smoother_point here, double p[NAVIGATION_STATES][NAVIGATION_STATES]);
/** The movement was over stood_s ago, where it was marked last: s->last is it now. */
void smoother_end(struct smoother *s, double stood_s, double p[NAVIGATION_STATES][NAVIGATION_STATES]);
/** The movement is given up. */
void smoother_cancel(struct smoother *s);

#endif
