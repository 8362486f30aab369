/* drivers/imu/frozen.h
 * Detects a sensor that delivers the same raw values again and again (frozen), and distinguishes it from one at rest.
 *
 * Where the noise exceeds one digit, equal raw values repeat only a few times. The longest run so far is measured; a
 * run ten times as long is a fault. Where the noise is below one digit, the values at rest may stay equal for any time,
 * and a run means nothing. Which of the two holds is determined from stretches in which the values stay within two
 * neighbouring digits: with noise above a digit they are short. */
#ifndef DRIVERS_IMU_FROZEN_H
#define DRIVERS_IMU_FROZEN_H

#include <stdbool.h>
#include <stddef.h>

enum {
	FROZEN_VALUES = 12,
	FROZEN_AT_LEAST = 30, /* equal values: shorter runs are never a fault */
	FROZEN_TIMES = 10,    /* times the longest run that ended */
	FROZEN_STRETCH = 50,  /* samples; with a longer stretch the noise is below a digit */
	FROZEN_LEARNT = 50,   /* after this number of shorter stretches the noise is above a digit */
};

struct frozen {	    /* starts zeroed */
	bool noisy; /* set by a caller that knows that the noise exceeds one digit */

	/* PRIVATE */
	double last[FROZEN_VALUES], digit[FROZEN_VALUES]; /* digit: the smallest change seen; 0: none yet */
	double low[FROZEN_VALUES], high[FROZEN_VALUES];	  /* of this stretch */
	unsigned same, longest;
	unsigned stretch, stretches;
	bool coarse;
};

/** Processes the next raw values; n is the same in each call. True: the sensor is frozen. */
bool frozen_watch(struct frozen *f, const double *raw, size_t n);

#endif
