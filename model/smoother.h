/* model/smoother.h
 * The path of the movement that has just ended, each of its points corrected by everything measured after it, the
 * standstill above all: a fixed-interval smoother for the error-state filter of navigation.h, in bounded memory.
 *
 * While the robot moves, points are kept: position, velocity, and the covariance X of their errors with the errors of
 * the filter now. All that the filter does between two points is one linear map, which is accumulated in the form of
 * the modified Bryson-Frazier smoother, without inverting a matrix. For a transition F and a scalar measurement of row
 * h (innovation y of variance s, gain k)
 *   A <- F A;   g = A^T h:  b <- b - g y / s,  M <- M + g g^T / s,  A <- A - k g^T.
 * Each point kept is then corrected by
 *   point <- point - X b,  its variance <- variance - X M X^T,  X <- X A^T.
 * This is the backward pass of the smoother in the opposite order, so that points can be dropped without loss, and the
 * end of a movement costs no more than any other point. When the memory is full every second point is dropped and the
 * spacing doubles. The first point is zero and certain, the last one is the filter's.
 *
 * Sources: G. Bierman, "Fixed interval smoothing with discrete measurements", Int. J. Control 18(1), 1973; J. Meditch,
 * "Stochastic Optimal Linear Estimation and Control", 1969, ch. 6 (fixed-point smoothing). */
#ifndef MODEL_SMOOTHER_H
#define MODEL_SMOOTHER_H

#include <stddef.h>

#include "model/navigation.h"

enum { SMOOTHER_POINTS = 128, SMOOTHER_ROWS = 6 };

/* s, spacing of the points at first. By judgement: follows a hand movement, and 128 points are then 25 s of it. */
#define SMOOTHER_SPACING_S 0.2

/** Of the reference point, global frame, since the movement began. */
struct smoother_point {
	double t_s;
	struct vec3 position_n_m, velocity_n_m_s, sigma_m; /* 1 sigma of the position */
};

/** From one standstill of a second to the next. */
struct smoother_movement {
	unsigned number; /* counts the movements that ended, from 1; 0: none has */
	/** False when something interrupted it: a gap, a velocity, position or attitude that was set, another north.
	 * Then measurements after the interruption have corrected the points before it in part or not at all. */
	bool whole;
	double duration_s;
	double path_m;		       /* length along the points, scaled by what the live path has between them */
	double stood_s;		       /* duration of the standstill when its end was recognised */
	double farthest_m, farthest_s; /* greatest distance from its first point, and when */
	size_t count;
	struct smoother_point point[SMOOTHER_POINTS];
};

/** A point with the covariance X of its velocity and position errors with all errors of the filter now. */
struct smoother_kept {
	struct smoother_point point, live;
	double variance[3]; /* of the position */
	double x[SMOOTHER_ROWS][NAVIGATION_STATES];
};

/** A, b and M of above. */
struct smoother_map {
	double a[NAVIGATION_STATES][NAVIGATION_STATES], b[NAVIGATION_STATES], m[NAVIGATION_STATES][NAVIGATION_STATES];
};

/** Caller-owned, 134 kB. Zeroed it is ready. */
struct smoother {
	struct smoother_movement last; /* the last movement that ended */
	/* PRIVATE */
	bool recording, whole;
	double t_s, spacing_s;
	struct smoother_map recent;  /* from the last point to now */
	struct smoother_map earlier; /* to the last point, since kept[0] .. kept[settled - 1] were last corrected */
	size_t count, settled;
	struct vec3 from_n_m;	    /* position at the beginning */
	struct smoother_point here; /* at the last smoother_mark() */
	struct smoother_point live; /* the same by integration of the velocity alone, without corrections */
	double live_m;		    /* the length of that path */
	struct smoother_kept kept[SMOOTHER_POINTS];
};

/* All of them do nothing when s is NULL or, but for smoother_begin(), while no movement is recorded. here: position and
 * velocity of the reference point; p: covariance of the filter. */

/** A movement begins. */
void smoother_begin(struct smoother *s, struct smoother_point here, double p[NAVIGATION_STATES][NAVIGATION_STATES]);
/** The position was set to zero: the movement counts from here, and is not whole. */
void smoother_restart(struct smoother *s, struct smoother_point here, double p[NAVIGATION_STATES][NAVIGATION_STATES]);
/** Time passes. */
void smoother_elapse(struct smoother *s, double dt_s);
/** The matrix A, which the filter multiplies by its transition from the left, as its covariance; NULL: none. */
double (*smoother_transition(struct smoother *s))[NAVIGATION_STATES];
/** The filter is about to apply a measurement: its row, p row^T, innovation and innovation variance. */
void smoother_measure(struct smoother *s, const double row[NAVIGATION_STATES], const double p_row[NAVIGATION_STATES],
	double innovation, double variance);
/** Three errors from `at` on are independent of all before. The movement is not whole. */
void smoother_reset_errors(struct smoother *s, int at);
/** Something else interrupted the movement, which goes on. */
void smoother_break(struct smoother *s);
/** After all transitions and measurements up to now. Keeps a point when it is due. To be called often enough to
 * integrate the path from the velocities. */
void smoother_mark(struct smoother *s, struct smoother_point here, double p[NAVIGATION_STATES][NAVIGATION_STATES]);
/** The movement ended stood_s ago, at the last smoother_mark(), and becomes s->last. */
void smoother_end(struct smoother *s, double stood_s, double p[NAVIGATION_STATES][NAVIGATION_STATES]);
/** The movement is dropped. */
void smoother_cancel(struct smoother *s);

#endif
