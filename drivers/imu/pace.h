/* drivers/imu/pace.h
 * Hands out samples in real time: a timerfd that is readable from the moment the next sample is
 * due. */
#ifndef DRIVERS_IMU_PACE_H
#define DRIVERS_IMU_PACE_H

#include <stdint.h>

struct pace {
	int fd;
	int64_t start_ns; /* CLOCK_MONOTONIC */
};

/** Time runs from now on. 0 or -errno. */
int pace_start(struct pace *pace);
/** How long ago the instant `due_ns` after the start was, ns; negative: not yet, and the descriptor
 * wakes at it. */
int64_t pace_since(const struct pace *pace, int64_t due_ns);
void pace_stop(struct pace *pace);

#endif
