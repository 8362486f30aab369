/* drivers/imu/frozen.h
 * Tells a sensor that repeats itself from one that is quiet: what it measures has noise, so the same raw values come some
 * times in a row and no more. How often is learned: a run is too long when it is ten times the longest that ended. */
#ifndef DRIVERS_IMU_FROZEN_H
#define DRIVERS_IMU_FROZEN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { FROZEN_BYTES = 24, FROZEN_AT_LEAST = 30, FROZEN_TIMES = 10 };

struct frozen { /* zeroed: nothing known */
	uint8_t last[FROZEN_BYTES];
	unsigned same, longest;
};

/** The next raw values, at most FROZEN_BYTES. True: they, and those before, are no measurements. */
bool frozen_watch(struct frozen *f, const void *raw, size_t size);

#endif
