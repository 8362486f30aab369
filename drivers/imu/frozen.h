/* drivers/imu/frozen.h
 * Tells a sensor that repeats itself from one that is quiet. Where the noise is above a digit, the same raw values come
 * some times in a row and no more: how often is learned, and a run is too long when it is ten times the longest that ended.
 * Where the noise is below a digit the values may stand for ever at rest, and that tells nothing. Which it is shows when
 * the sensor is left alone: noise spreads over several digits, or stays within one. */
#ifndef DRIVERS_IMU_FROZEN_H
#define DRIVERS_IMU_FROZEN_H

#include <stdbool.h>
#include <stddef.h>

enum {
	FROZEN_VALUES = 12,
	FROZEN_AT_LEAST = 30,
	FROZEN_TIMES = 10,
	FROZEN_STRETCH = 50, /* values that stay within one digit for longer have no noise to speak of */
	FROZEN_LEARNT = 50,  /* so many shorter stretches, and the noise is taken to be above a digit */
};

struct frozen {	    /* zeroed: nothing known */
	bool noisy; /* set by whoever knows that the noise is above a digit: nothing needs to be learned first */

	/* PRIVATE */
	double last[FROZEN_VALUES], digit[FROZEN_VALUES]; /* the smallest change seen; 0: none yet */
	double low[FROZEN_VALUES], high[FROZEN_VALUES];	  /* of this stretch */
	unsigned same, longest;
	unsigned stretch, stretches;
	bool coarse;
};

/** The next raw values, always the same number of them. True: they, and those before, are no measurements. */
bool frozen_watch(struct frozen *f, const double *raw, size_t n);

#endif
