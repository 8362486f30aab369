/* drivers/imu/log_table.h
 * A text file with a header and rows of fields, separated by commas, semicolons or tabs. Fields may be in quotes; lines
 * that begin with # are comments, unless it is the header. "# uncalibrated: gyro accelerometer magnetometer" before it
 * names sensors that nobody calibrated; a log that says nothing is one of calibrated sensors. Numbers may have a
 * decimal comma where that is not the separator. */
#ifndef DRIVERS_IMU_LOG_TABLE_H
#define DRIVERS_IMU_LOG_TABLE_H

#include <stdint.h>
#include <stdio.h>

#include "drivers/imu/log_format.h"

enum { LOG_LINE_MAX = 16384 };

enum { LOG_NEEDS_GYRO = 1, LOG_NEEDS_ACCEL = 2, LOG_NEEDS_MAG = 4 }; /* and the time always */

struct log_header {
	char separator;
	int fields;		   /* their number */
	int field_of[LOG_COLUMNS]; /* index of the column's field; -1: no such column */
	double scale[LOG_COLUMNS]; /* turns the column's values into s, rad/s, m/s^2, uT */
	bool unit_named[LOG_COLUMNS];
};

struct log_table {
	FILE *file;
	char path[256];
	const struct log_format *format;
	unsigned needed; /* LOG_NEEDS_... */
	long line;	 /* number of the last line read, from 1 */
	struct log_header header;
	unsigned uncalibrated;		/* imu_port.uncalibrated, by a comment before the header */
	const char *field[LOG_COLUMNS]; /* of the last row; NULL: no such column */
	/* PRIVATE */
	char text[LOG_LINE_MAX], copy[LOG_LINE_MAX];
};

enum log_line {
	LOG_LINE_END = 0,    /* of the file */
	LOG_LINE_ROW = 1,    /* `field` has its fields */
	LOG_LINE_HEADER = 2, /* a header in the middle: another log begins */
	LOG_LINE_BAD = 3,    /* `why` says what is wrong */
	LOG_LINE_COUNT = 4,  /* the number of fields is not that of the header; `why` says it */
};

/** "-" is standard input. Reads the header. 0, or -errno and one line in `error` with file:line. */
int log_table_open(struct log_table *table, const char *path, const struct log_format *format, unsigned needed,
	char *error, size_t error_size);
/** The next line that is not a comment: enum log_line, or -EIO. */
int log_table_next(struct log_table *table, char *why, size_t why_size);
void log_table_close(struct log_table *table);

enum { LOG_TIME_NUMBER = 0, LOG_TIME_CALENDAR = 1 };

/** 0 and a finite number, or -EINVAL. */
int log_table_number(const char *text, double *value);
/** LOG_TIME_NUMBER; LOG_TIME_CALENDAR: a date with a time (2026-01-31 12:00:00.01) or a duration (0 days
 * 00:00:00.01), in s; -EINVAL. */
int log_table_time(const char *text, double *value);
/** The field is empty, or says that there is no value: nan, NA, null, none. */
bool log_table_absent(const char *text);

#endif
