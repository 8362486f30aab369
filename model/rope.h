/* model/rope.h
 * A load that hangs on a rope, with the sensor fixed to it: the load swings about the point from which it hangs, and
 * that point (the trolley of a crane) stands or moves steadily, but for short accelerations. The load's path less the
 * rope is the path of that point:
 *   s = p + L u,   u: the rope's direction upwards, which is that of gravity in the object at its last standstill.
 * While the point moves steadily, the second difference of s over two windows of a second is zero. What is left of it
 * is the error of tilt and accelerometer bias, so the filter has a vertical that no swing falsifies, and the mean of
 * s over a window is a velocity that may be that of a standstill.
 *
 * Whether it moves steadily is decided by that same difference: it must be compatible with zero, and so must be the
 * ones a second before and after, so that the first moments of an acceleration do not count. The length of the rope
 * is estimated with it, from the one that was given.
 *
 * This is kinematics alone: it holds for any swing and in wind. It needs a load that does not turn against its rope. */
#ifndef MODEL_ROPE_H
#define MODEL_ROPE_H

#include "model/navigation_sums.h"
#include "model/noise.h"

enum { ROPE_WINDOWS = 6, ROPE_DIFFERENCES = 4 };
/* Sigmas beyond which the point accelerates. Convention. */
#define ROPE_SIGMAS 3.0

/** A second: the errors' transition, and the rope's direction at its beginning. */
struct rope_window {
	struct navigation_sums sums;
	struct vec3 up_n;
};

/** Zeroed no rope is known. n: global frame, b: object. */
struct rope {
	double given_m;			     /* its length as told; 0: no rope */
	double length_m, length_variance_m2; /* as estimated */
	int steady;			     /* second differences in a row that are compatible with zero */
	/* PRIVATE */
	struct vec3 up_b;			 /* its direction */
	struct rope_window window[ROPE_WINDOWS]; /* the last one grows */
	int full;				 /* how many of those before it are */
	double sample_s;			 /* interval of the samples */
};

/** A second difference; its error is -[force]x theta - turned ba. */
struct rope_difference {
	struct vec3 point_n_m; /* of the point from which the load hangs, */
	struct vec3 up_n;      /* of the rope's direction, */
	struct vec3 force_n_m; /* of the twice integrated specific force, */
	struct mat3 turned_s2; /* .. and rotation matrix */
	double variance_m2;    /* of the point, by the sensors' noise, each axis */
};

/** The load stands at this attitude: what it does from here on is observed. length_m: as told. */
void rope_hang(struct rope *r, double length_m, struct quat q_nb);
/** The observation begins anew: samples are missing, or the attitude has jumped. */
void rope_restart(struct rope *r, struct quat q_nb);
/** The samples of an interval in which the load moves, dt_s apart, at whose end it has this attitude. Returns true
 * when there is another difference. */
bool rope_swing(struct rope *r, struct quat q_nb, const struct navigation_sums *s, double dt_s);
/** Attitude and bias, with which the sums were taken, were corrected by these. */
void rope_correct(struct rope *r, struct vec3 theta_n_rad, struct vec3 accel_bias_b_m_s2);
/** Over the last two full windows (which = ROPE_DIFFERENCES - 1), or as many seconds earlier as it is less than
 * that. */
struct rope_difference rope_difference(
	const struct rope *r, int which, const struct noise_config *noise, double gravity_m_s2);
/** Mean velocity of the point over the last full window; velocity_n_m_s: of the load at its end. */
struct vec3 rope_point_velocity(const struct rope *r, struct vec3 velocity_n_m_s, double gravity_m_s2);
/** The change from one difference of a steady motion to the next, in which the errors of tilt and bias cancel,
 * estimates the length. */
void rope_measure_length(struct rope *r, const struct rope_difference *earlier, const struct rope_difference *later);

#endif
