/* drivers/imu/log_units.h
 * Are the values of a log in rad/s, m/s^2 and uT? By their magnitude, and the gyro by what its rates do to the
 * direction of gravity. Pure. */
#ifndef DRIVERS_IMU_LOG_UNITS_H
#define DRIVERS_IMU_LOG_UNITS_H

#include <stdbool.h>
#include <stddef.h>

#include "model/sample.h"

enum { LOG_UNITS_BANDS = 5 };

/* Zeroed it is ready. */
struct log_units {
	/* PRIVATE: samples, and those whose magnitude is in each band */
	unsigned forces, force_in[LOG_UNITS_BANDS];
	unsigned fields, field_in[LOG_UNITS_BANDS];
	/* the direction of the force, turned by the rates since the start of a window: in rad/s and in deg/s */
	struct vec3 start, turned_rad, turned_deg;
	double window_s;
	unsigned windows;
	double off_rad, off_deg, moved; /* sums of squares over the windows */
	/* steps from sample to sample, for the noise at rest */
	struct imu_sample last;
	unsigned steps;
	double gyro_steps, accel_steps, accel_squares;
	double gyro_most_rad_s, accel_most_m_s2; /* of one axis */
};

void log_units_add(struct log_units *units, const struct imu_sample *sample);
/** The likely mistake of the i-th sensor (gyro, accelerometer, magnetometer) as text; false: none. */
bool log_units_warning(const struct log_units *units, int i, char *text, size_t size);

/** The middle one of five samples (NULL: there is none) was clipped: a value is the end of a usual range and the
 * largest so far, and three samples in a row have it. */
bool log_units_clipped(const struct log_units *units, const struct imu_sample *const five[5]);

#endif
