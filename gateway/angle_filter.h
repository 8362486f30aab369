/* gateway/angle_filter.h
 * Low-pass of the published angles (2012h), as inclinometers have: first order, each of roll, pitch and yaw along the
 * shorter way round. Passive; one thread. */
#ifndef GATEWAY_ANGLE_FILTER_H
#define GATEWAY_ANGLE_FILTER_H

#include <stdbool.h>
#include <stdint.h>

#include "model/math/vec3.h"

/** Caller-owned. Zeroed: the next sample starts the filter. */
struct angle_filter {
	bool running;
	uint64_t t_us; /* of the last sample */
	struct vec3 angles_rad;
};

/** The filtered angles of a sample at t_us; `cutoff_hz` 0: unfiltered. After a second without samples the filter starts
 * again. */
struct vec3 angle_filter_step(struct angle_filter *filter, double cutoff_hz, uint64_t t_us, struct vec3 angles_rad);

#endif
