/* model/hard_iron.h
 * Does the magnetometer agree with the gyro? In a constant field, what it measures turns against the object as the gyro
 * says, and its length stays. So the field in the object frame before and after a turn R (before -> after) obey
 *
 *   m2 - R m1 = (I - R) b,    |m1 - b| = |m2 - b|
 *
 * with the hard-iron offset b: a constant field of magnets in the object, or an offset of the chip. Both are linear in
 * b and one more unknown, and are solved by least squares over the last hundred turns of half a radian.
 *
 * - An offset beyond four sigma and beyond 0.12 of the field is subtracted from then on. Its covariance remains as an
 *   error of the heading. A smaller one is what fields of buildings pretend.
 * - A field that does not turn with the object, whatever the offset, is of no use: axes that were swapped or mirrored,
 *   or fields of iron nearby. Each axis of the turns is judged by itself: one about x does not show that x is mirrored.
 *   It disagrees until the turns fit again. A rotation of the field about the vertical alone, and one turned upside
 *   down (a southern magnetic hemisphere), cannot be seen so.
 *
 * An object that does not turn shows nothing of both.
 *
 * Sources: the relation of field and rate, e.g. J. F. Vasconcelos et al., "Geometric approach to strapdown magnetometer
 * calibration in sensor frame", IEEE TAES 47(2), 2011 (the sphere); least squares with exponential forgetting:
 * S. Haykin, "Adaptive Filter Theory", chapter on RLS. */
#ifndef MODEL_HARD_IRON_H
#define MODEL_HARD_IRON_H

#include <stdbool.h>

#include "model/math/quat.h"
#include "model/math/vec3.h"

enum hard_iron_event {
	HARD_IRON_NOTHING,
	HARD_IRON_DISAGREES, /* from now on the field cannot be used, and if it never agreed, its heading was wrong */
	HARD_IRON_AGREES,    /* again */
	HARD_IRON_FOUND	     /* an offset is known: heading and reference of the field before it were wrong */
};

/** Zeroed it is ready. */
struct hard_iron {
	struct vec3 offset_b_uT;   /* 0 until known */
	double variance_uT2[3][3]; /* its covariance; 0 until known, unless there is a prior */
	/* 1 sigma of an offset that the motion has not shown yet, each axis; 0 (default): the magnetometer is
	 * calibrated. The caller may change it. After enough turns the covariance is that of what they leave open. */
	double prior_uT;
	bool known, disagrees;
	bool agreed;  /* once, over turns about all axes: what disagrees now is a disturbance */
	bool changes; /* a magnet is being attached or removed: the offset says nothing of earlier fields */
	/* PRIVATE */
	struct quat turned;    /* since the last field that was used: object then -> object now */
	struct vec3 last_b_uT; /* that field */
	double last_rate2_rad2_s2, since_s;
	double field_uT; /* mean length, less the offset */
	/* of b and |field|^2 - |b|^2, by the turns of the field and by its length */
	struct hard_iron_rows {
		double information[4][4], projection[4];
	} rows, sphere;
	struct hard_iron_agreement {
		double unexplained[3], turned_field[3]; /* squares, over the last turns about each axis */
	} agreement, solved;				/* with the offset that is in use, and with the solution */
	double turns, axis_turns[3];			/* turns, and those about each axis, limited */
	double recent, usual; /* means of what the last few and all of the last turns left unexplained */
	/* mean length with the offset solved; mean square of what differs from it, as a share */
	double length_uT, length_off2;
};

/** One sample, after a calibration: the rate, and the field where there is one (NULL: none), of 1 sigma field_sigma_uT
 * each axis. */
enum hard_iron_event hard_iron_step(struct hard_iron *h, struct vec3 rate_b_rad_s, const struct vec3 *field_b_uT,
	double field_sigma_uT, double dt_s);
/** The rate was not measured for a while: the turn since the last field is not known. */
void hard_iron_skip(struct hard_iron *h);
/** Variance of the offset along a unit vector, uT^2. */
double hard_iron_variance(const struct hard_iron *h, struct vec3 direction_b);

#endif
