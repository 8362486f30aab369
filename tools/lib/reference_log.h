/* tools/lib/reference_log.h
 * The motion of the reference point as something else saw it (a motion capture system, say): rows of time, attitude of the
 * sensor axes (sensor -> world) and acceleration in the world, without gravity. A CSV with the columns
 * t,qw,qx,qy,qz,arx,ary,arz (s, m/s^2) in any order, others ignored; fields are empty where it saw nothing. */
#ifndef TOOLS_LIB_REFERENCE_LOG_H
#define TOOLS_LIB_REFERENCE_LOG_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "model/math/vec3.h"

struct reference_log { /* start from all 0 */
	size_t count;
	/* PRIVATE */
	struct reference_row {
		double t_s;
		struct vec3 accel_m_s2; /* sensor axes */
	} * rows;
	size_t room, at;
};

/** 0, or -errno and one line in `error` with file:line. Close it even then. */
int reference_log_load(struct reference_log *log, const char *path, char *error, size_t error_size);
/** The acceleration at that time in the axes of the sensor, by a straight line between rows; times that rise are found
 * fastest. False where rows are missing (more than 50 ms apart). */
bool reference_log_at(struct reference_log *log, uint64_t t_us, struct vec3 *accel_m_s2);
void reference_log_close(struct reference_log *log);

#endif
