/* drivers/imu/log_format.h
 * What the columns of a log are called, and in which units: IMU logs and those of other programs. Pure. */
#ifndef DRIVERS_IMU_LOG_FORMAT_H
#define DRIVERS_IMU_LOG_FORMAT_H

#include <stdbool.h>
#include <stddef.h>

/* The columns of a log; a triad has three, x y z or l s t. */
enum log_column {
	LOG_T = 0,
	LOG_GYRO = 1,
	LOG_ACCEL = 4,
	LOG_MAG = 7,
	LOG_REFERENCE = 10,
	LOG_TEMPERATURE = 13,
	LOG_CLIPPED = 14,
	LOG_COLUMNS = 15
};
enum { LOG_NO_COLUMN = -1, LOG_UNKNOWN_UNIT = -2 };

enum { LOG_FILES = 3 }; /* gyro, accelerometer, magnetometer */

struct log_format {
	const char *name;	      /* of --format */
	const char *names[7];	      /* of each quantity, `|` between alternatives, `*` for the axis */
	const char *files[LOG_FILES]; /* in a folder, for logs of one file for each chip; NULL: one file has all */
};

/** The first one is the IMU log of this project; NULL after the last one. */
const struct log_format *log_format_at(int i);
const struct log_format *log_format_named(const char *name);

/** The column of this name, with an optional unit behind it (`gx[deg/s]`, `Time (ms)`, `ax_g`), upper or lower case.
 * *scale turns its values into s, rad/s, m/s^2 or uT. LOG_NO_COLUMN; LOG_UNKNOWN_UNIT: a known name, but the unit in
 * brackets is not. */
int log_format_column(const struct log_format *format, const char *field, double *scale, bool *unit_named);

/** The column's name in an IMU log, e.g. "gx". */
const char *log_column_name(int column);

#endif
