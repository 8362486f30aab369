/* drivers/imu/pace.h
 * Paces samples in real time: a timerfd that becomes readable when the next sample is due. */
#ifndef DRIVERS_IMU_PACE_H
#define DRIVERS_IMU_PACE_H

#include <stdint.h>

struct pace {
	int fd;
	int64_t start_ns; /* CLOCK_MONOTONIC */
};

/** Starts the time. 0 or -errno. */
int pace_start(struct pace *pace);
/** The time since `due_ns` after the start [ns]. Negative: it is in the future, and the descriptor becomes readable
 * then. */
int64_t pace_since(const struct pace *pace, int64_t due_ns);
void pace_stop(struct pace *pace);

#endif
