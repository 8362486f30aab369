/* drivers/imu/imu_log.h
 * Reads an IMU log. Header `t,gx,gy,gz,ax,ay,az,mx,my,mz`; units s, rad/s, m/s^2, uT, or those that the header names
 * (`gx[deg/s]`); the three magnetometer fields of a row may be empty. Optional columns: `temperature`, degC, `clipped`
 * (1: a value is at the end of its range) and `ref_al,ref_as,ref_at`, the acceleration of the reference point measured
 * by another device (m/s^2, object frame, without gravity); they may be empty, too. Other columns are ignored; the
 * columns may have any order. log_table.h says how the text may look, log_format.h which logs of other programs are
 * read.
 *
 * Bad rows (wrong number of fields, not a finite number, time not increasing) are skipped and counted; a bad header is
 * an error. The rows behind decide about a time that jumps: one that jumps ahead and returns is skipped, one that
 * returns to the start and goes on from there is a counter that wrapped, or another log, whose times then continue
 * those of the first (SAMPLE_DISCONTINUITY). Times of which many follow each other at once are those of transfers: the
 * samples are taken as even, with the mean rate (sample_clock.h). A time in ms, us or ns is found by its intervals. */
#ifndef DRIVERS_IMU_IMU_LOG_H
#define DRIVERS_IMU_IMU_LOG_H

#include <stdint.h>

#include "drivers/imu/log_rows.h"
#include "drivers/imu/log_units.h"
#include "drivers/imu/sample_clock.h"

enum { IMU_LOG_QUEUE = 1024 };

struct imu_log {
	char path[256];
	double rate_hz;	   /* from the first rows; valid after open */
	int64_t origin_us; /* sample.t_us less this is the time of the log: 0, unless that begins below 0 */
	struct log_rows rows;
	/* PRIVATE */
	/* rows read ahead, to determine the rate and to decide about jumps of the time */
	struct log_row queue[IMU_LOG_QUEUE];
	unsigned first, count;
	struct log_row newest; /* of all that were read, if there are any */
	bool any;
	int ended; /* 1: by the end of the file; -EIO */
	double unit_us;
	int64_t interval_us;
	int64_t shift_us; /* added to the times of the file: after a wrap, in another log */
	int64_t last_us;  /* time of the last row, shifted */
	bool started;
	bool even; /* the clock gives the times */
	struct sample_clock clock;
	int64_t index, bracketed; /* of the clock: of the next sample; number of those that it has seen */
	int64_t clock_start_us;
	double late_ns;		     /* by which the end of a burst may be late */
	int64_t last_t_us;	     /* of the last sample */
	struct imu_sample before[2]; /* the last ones, as in the file; zeros at first */
	struct log_units units;
};

/** `path`: a file, "-" for standard input, or for some formats a folder. 0, or -errno and one line in `error` with
 * file:line; fewer than two valid rows are an error. */
int imu_log_open(
	struct imu_log *log, const char *path, const struct log_format *format, char *error, size_t error_size);
/** 1 and a sample, 0 at the end of the file, -EIO when reading fails. */
int imu_log_next(struct imu_log *log, struct imu_sample *sample);
/** What there is to say about the log, one message for each i from 0: what was skipped, how times were taken and, after
 * the last row, which units are unlikely. False: there is no more. */
bool imu_log_message(const struct imu_log *log, int i, char *text, size_t size);
/** imu_port.uncalibrated, by the log's own word. */
unsigned imu_log_uncalibrated(const struct imu_log *log);
/** The header has ref_al,ref_as,ref_at. */
bool imu_log_has_reference(const struct imu_log *log);
void imu_log_close(struct imu_log *log);

#endif
