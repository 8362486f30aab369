/* drivers/imu/merge.h
 * Makes samples from a gyro, an accelerometer and a magnetometer that measure at different times. A sample has the time
 * of a gyro reading; the acceleration is interpolated to it, the magnetic field is rotated to it. Pure. */
#ifndef DRIVERS_IMU_MERGE_H
#define DRIVERS_IMU_MERGE_H

#include "drivers/ports/imu.h"

enum { MERGE_READINGS = 32 };

struct merge_reading {
	int64_t t_ns;
	struct vec3 value; /* units of struct imu_sample, common axes */
	bool saturated;
};

struct merge {
	int64_t tolerance_ns; /* readings closer than this count as simultaneous: the uncertainty of their times */
	uint32_t lost; /* gyro readings without an acceleration before and after, or with too long between these */
	/* PRIVATE */
	struct merge_ring {
		struct merge_reading at[MERGE_READINGS];
		unsigned first, count;
		int64_t last_ns;  /* time of the newest reading ever added */
		int64_t usual_ns; /* between two readings; 0: not known yet */
	} gyro, accel;
	struct merge_reading mag;
	bool mag_new;
};

void merge_init(struct merge *m, int64_t tolerance_ns);
/** Adds a reading. The readings of a chip must have increasing times; others are dropped. */
void merge_add(struct merge *m, enum imu_chip chip, const struct merge_reading *reading);
/** Returns true and the next sample, if all its readings are there. */
bool merge_next(struct merge *m, struct imu_sample *sample);

#endif
