/* drivers/imu/merge.h
 * One sample out of gyro, accelerometer and magnetometer that each measure at instants of their own: a sample is one of
 * the gyro, the acceleration interpolated to its instant, the field turned to it. Pure. */
#ifndef DRIVERS_IMU_MERGE_H
#define DRIVERS_IMU_MERGE_H

#include "drivers/ports/imu.h"

enum { MERGE_READINGS = 32 };

struct merge_reading {
	int64_t t_ns;
	struct vec3 value; /* in the unit of struct imu_sample, all in the same axes */
	bool saturated;
};

struct merge {
	int64_t tolerance_ns; /* readings as near as that are of one instant: no better is known of their times */
	uint32_t lost;	      /* of the gyro: no acceleration before and after them */
	/* PRIVATE */
	struct merge_ring {
		struct merge_reading at[MERGE_READINGS];
		unsigned first, count;
		int64_t last_ns; /* pushed last, taken out or not */
	} gyro, accel;
	struct merge_reading mag;
	bool mag_new;
};

void merge_init(struct merge *m, int64_t tolerance_ns);
/** Each chip's readings in the order of their times; others are dropped. */
void merge_add(struct merge *m, enum imu_chip chip, const struct merge_reading *reading);
/** Takes the next sample out, when what it takes is there. */
bool merge_next(struct merge *m, struct imu_sample *sample);

#endif
