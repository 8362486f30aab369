/* drivers/imu/log_rows.h
 * The rows of a log as samples, in the order of the file and with the times that it says. From one file, or from a
 * folder with a file for each chip, whose readings are merged (merge.h). */
#ifndef DRIVERS_IMU_LOG_ROWS_H
#define DRIVERS_IMU_LOG_ROWS_H

#include "drivers/imu/log_table.h"
#include "drivers/imu/merge.h"

/* What is worth a message, with the number of times and the first one. The first kinds are skipped rows. */
enum log_event {
	LOG_SKIP_LINE,	 /* too long, or not text */
	LOG_SKIP_FIELDS, /* another number of fields than the header has */
	LOG_SKIP_NUMBER, /* not a finite number */
	LOG_SKIP_TIME,	 /* the time does not increase */
	LOG_SKIP_GLITCH, /* the time of the row jumps ahead, that of the rows behind it does not */
	LOG_SKIPS,
	LOG_ANOTHER = LOG_SKIPS, /* another log begins */
	LOG_WRAP,		 /* the counter of the times starts again */
	LOG_TIME_UNIT,
	LOG_EVEN, /* the times are not those of the samples: the mean rate counts */
	LOG_EVENTS
};

struct log_events {
	struct {
		uint32_t count;
		char first[200];
	} of[LOG_EVENTS];
	uint32_t skipped;    /* rows */
	char last_skip[128]; /* "file:line: what" */
};

struct log_row {
	struct imu_sample sample; /* t_us: not set */
	double t;		  /* in the unit of the file */
	long line;
	bool begins; /* a header is before it */
};

struct log_rows {
	double time_unit_s; /* named by the header, or calendar time; 0: not known */
	struct log_events events;
	/* PRIVATE */
	int tables;
	struct log_table table[LOG_FILES];
	struct log_row pending[LOG_FILES]; /* of several files */
	bool has_pending[LOG_FILES];
	struct merge merge;
};

/** `path`: a file, a folder with the files of the format, or "-" for standard input. 0, or -errno and one line in
 * `error`. */
int log_rows_open(
	struct log_rows *rows, const char *path, const struct log_format *format, char *error, size_t error_size);
/** 1 and a row, 0 at the end, -EIO. Bad rows are skipped and counted. */
int log_rows_next(struct log_rows *rows, struct log_row *row);
void log_rows_close(struct log_rows *rows);

/** Counts an event at this line of the (first) file. */
__attribute__((format(printf, 4, 5))) void log_rows_event(
	struct log_rows *rows, enum log_event event, long line, const char *format, ...);

#endif
