/* drivers/imu/imu_log.h
 * Reads an IMU log. Header `t,gx,gy,gz,ax,ay,az,mx,my,mz`; units s, rad/s, m/s^2, uT; the three magnetometer fields of
 * a row may be empty. Optional columns: `temperature`, degC, and `ref_al,ref_as,ref_at`, the acceleration of the
 * reference point measured by another device (m/s^2, object frame, without gravity); they may be empty, too. Other
 * columns are ignored; the columns may have any order. Bad rows (wrong number of fields, not a number, NaN or infinity,
 * time not increasing) are skipped and counted; a bad header is an error. */
#ifndef DRIVERS_IMU_IMU_LOG_H
#define DRIVERS_IMU_IMU_LOG_H

#include <stdint.h>
#include <stdio.h>

#include "model/sample.h"

enum { IMU_LOG_COLUMNS = 14, IMU_LOG_LINE_MAX = 512, IMU_LOG_HEAD = 200 };

struct imu_log {
	FILE *file;
	char path[256];
	long line;		       /* number of the last line read, from 1 */
	int fields;		       /* in the header */
	int field_of[IMU_LOG_COLUMNS]; /* index of the field with t, gx, ..., temperature; -1: no such column */
	uint64_t last_t_us;
	int started;
	uint32_t skipped;
	double rate_hz;	     /* from the median interval of the first rows; valid after open */
	char last_skip[128]; /* "file:line: what" of the last skipped row */
	/* rows read by open() to determine the rate; next() returns them first, so that none of a pipe is lost */
	struct imu_sample head[IMU_LOG_HEAD];
	int head_count, head_next;
};

/** "-" is standard input. 0, or -errno and one line in `error` with file:line; fewer than two valid rows are an
 * error. */
int imu_log_open(struct imu_log *log, const char *path, char *error, size_t error_size);
/** 1 and a sample, 0 at the end of the file, -EIO when reading fails. */
int imu_log_next(struct imu_log *log, struct imu_sample *sample);
/** The header has ref_al,ref_as,ref_at. */
int imu_log_has_reference(const struct imu_log *log);
void imu_log_close(struct imu_log *log);

#endif
