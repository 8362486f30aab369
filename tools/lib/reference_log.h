/* tools/lib/reference_log.h
 * Motion of the reference point as measured by another system, e.g. motion capture: time, attitude of the sensor axes
 * (sensor -> world) and acceleration in the world frame without gravity. A CSV with the columns
 * t,qw,qx,qy,qz,arx,ary,arz (s, m/s^2) in any order; others are ignored. Rows with an empty field are skipped. */
#ifndef TOOLS_LIB_REFERENCE_LOG_H
#define TOOLS_LIB_REFERENCE_LOG_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "model/math/vec3.h"

struct reference_log { /* initialise to 0 */
	size_t count;
	/* PRIVATE */
	struct reference_row {
		double t_s;
		struct vec3 accel_m_s2; /* sensor axes */
	} * rows;
	size_t room, at;
};

/** 0, or -errno and one line in `error` with file:line. Close it in both cases. */
int reference_log_load(struct reference_log *log, const char *path, char *error, size_t error_size);
/** Acceleration at that time in sensor axes, interpolated between rows. Fast for increasing times. False in a gap of
 * more than 50 ms and outside the log. */
bool reference_log_at(struct reference_log *log, uint64_t t_us, struct vec3 *accel_m_s2);
void reference_log_close(struct reference_log *log);

#endif
