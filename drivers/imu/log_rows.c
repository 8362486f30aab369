#include "drivers/imu/log_rows.h"

#include <errno.h>
#include <math.h>
#include <stdarg.h>
#include <string.h>
#include <sys/stat.h>

/* Readings of different chips closer than this count as simultaneous. By judgement: well below any sampling
 * interval. */
static const int64_t SIMULTANEOUS_NS = 200000;
/* s, added to the times of several files while they are merged, which has to be of positive times. */
static const double MERGE_EPOCH_S = 1e6, LATEST_S = 9e9;

static const char *base_name(const char *path)
{
	const char *slash = strrchr(path, '/');

	return slash ? slash + 1 : path;
}

static void add_event(struct log_rows *rows, const struct log_table *table, enum log_event event, long line,
	const char *format, va_list args)
{
	char text[sizeof rows->events.of[0].first];
	int n = snprintf(text, sizeof text, "%.60s:%ld: ", base_name(table->path), line);

	vsnprintf(text + n, sizeof text - (size_t)n, format, args);
	if (rows->events.of[event].count++ == 0)
		memcpy(rows->events.of[event].first, text, sizeof text);
	if (event >= LOG_SKIPS)
		return;
	rows->events.skipped++;
	snprintf(rows->events.last_skip, sizeof rows->events.last_skip, "%.*s", (int)sizeof rows->events.last_skip - 1,
		text);
}

void log_rows_event(struct log_rows *rows, enum log_event event, long line, const char *format, ...)
{
	va_list args;

	va_start(args, format);
	add_event(rows, &rows->table[0], event, line, format, args);
	va_end(args);
}

/* Skips the last row of the table. */
__attribute__((format(printf, 4, 5))) static int skip(
	struct log_rows *rows, const struct log_table *table, enum log_event event, const char *format, ...)
{
	va_list args;

	va_start(args, format);
	add_event(rows, table, event, table->line, format, args);
	va_end(args);
	return 0;
}

/* ---- one file ---------------------------------------------------------------------------------------------------- */

/* 1 and a number in SI units, 0: the row was skipped. */
static int parse(struct log_rows *rows, const struct log_table *table, int column, double *value)
{
	const char *text = table->field[column];

	if (log_table_number(text, value) < 0)
		return skip(rows, table, LOG_SKIP_NUMBER, "%s is not a finite number: '%.20s'", log_column_name(column),
			text);
	*value *= table->header.scale[column];
	return 1;
}

static int parse_triad(struct log_rows *rows, const struct log_table *table, int column, struct vec3 *triad)
{
	return parse(rows, table, column, &triad->x) && parse(rows, table, column + 1, &triad->y) &&
	       parse(rows, table, column + 2, &triad->z);
}

/* Whether at least one of the fields has a value. */
static bool any_given(const struct log_table *table, int column, int count)
{
	for (int i = column; i < column + count; i++)
		if (table->field[i] && !log_table_absent(table->field[i]))
			return true;
	return false;
}

/* The fields that may be empty. 0: the row was skipped. */
static int parse_optional(struct log_rows *rows, const struct log_table *table, struct imu_sample *sample)
{
	double clipped = 0;

	if (any_given(table, LOG_MAG, 3)) {
		if (!parse_triad(rows, table, LOG_MAG, &sample->mag_uT))
			return 0;
		sample->flags |= SAMPLE_MAG;
	}
	if (any_given(table, LOG_REFERENCE, 3)) {
		if (!parse_triad(rows, table, LOG_REFERENCE, &sample->ref_accel_b_m_s2))
			return 0;
		sample->flags |= SAMPLE_REFERENCE;
	}
	if (any_given(table, LOG_TEMPERATURE, 1)) {
		if (!parse(rows, table, LOG_TEMPERATURE, &sample->temperature_degC))
			return 0;
		sample->flags |= SAMPLE_TEMPERATURE;
	}
	if (any_given(table, LOG_CLIPPED, 1) && !parse(rows, table, LOG_CLIPPED, &clipped))
		return 0;
	sample->flags |= clipped != 0 ? SAMPLE_SATURATED : 0u;
	return 1;
}

/* The time is not converted yet: its unit may be found later, from its intervals. */
static int parse_t(struct log_rows *rows, const struct log_table *table, double *t)
{
	const char *text = table->field[LOG_T];
	int kind = log_table_time(text, t);

	if (kind < 0)
		return skip(rows, table, LOG_SKIP_NUMBER, "t is not a finite number: '%.20s'", text);
	if (kind == LOG_TIME_CALENDAR)
		rows->time_unit_s = 1;
	return 1;
}

static int parse_row(struct log_rows *rows, const struct log_table *table, struct log_row *row)
{
	*row = (struct log_row){.line = table->line};
	if (!parse_t(rows, table, &row->t))
		return 0;
	if ((table->needed & LOG_NEEDS_GYRO) && !parse_triad(rows, table, LOG_GYRO, &row->sample.gyro_rad_s))
		return 0;
	if ((table->needed & LOG_NEEDS_ACCEL) && !parse_triad(rows, table, LOG_ACCEL, &row->sample.accel_m_s2))
		return 0;
	return parse_optional(rows, table, &row->sample);
}

static int next_of(struct log_rows *rows, struct log_table *table, struct log_row *row)
{
	bool begins = false;
	char why[80];

	for (;;) {
		int got = log_table_next(table, why, sizeof why);

		if (got <= 0)
			return got;
		if (got == LOG_LINE_HEADER)
			begins = true;
		else if (got != LOG_LINE_ROW)
			skip(rows, table, got == LOG_LINE_COUNT ? LOG_SKIP_FIELDS : LOG_SKIP_LINE, "%s", why);
		else if (parse_row(rows, table, row)) {
			row->begins = begins;
			return 1;
		}
	}
}

/* ---- several files ----------------------------------------------------------------------------------------------- */

static int64_t ns(const struct log_row *row, const struct log_table *table)
{
	double t_s = row->t * table->header.scale[LOG_T] + MERGE_EPOCH_S;

	return (int64_t)(1e9 * fmax(0, fmin(LATEST_S, t_s)));
}

/* Adds the earliest reading of all files. 1, 0 at the end of all, -EIO. */
static int merge_earliest(struct log_rows *rows)
{
	static const enum imu_chip CHIPS[] = {IMU_CHIP_GYRO, IMU_CHIP_ACCEL, IMU_CHIP_MAG};
	struct merge_reading reading;
	int earliest = -1;

	for (int i = 0; i < rows->tables; i++) {
		if (!rows->has_pending[i] && rows->table[i].file) {
			int got = next_of(rows, &rows->table[i], &rows->pending[i]);

			if (got < 0)
				return got;
			rows->has_pending[i] = got == 1;
			if (got == 0)
				log_table_close(&rows->table[i]);
		}
		if (rows->has_pending[i] &&
			(earliest < 0 || ns(&rows->pending[i], &rows->table[i]) <
						 ns(&rows->pending[earliest], &rows->table[earliest])))
			earliest = i;
	}
	if (earliest < 0)
		return 0;
	const struct imu_sample *s = &rows->pending[earliest].sample;
	reading = (struct merge_reading){.t_ns = ns(&rows->pending[earliest], &rows->table[earliest]),
		.value = earliest == 0	 ? s->gyro_rad_s
			 : earliest == 1 ? s->accel_m_s2
					 : s->mag_uT};
	rows->has_pending[earliest] = false;
	if (earliest != 2 || (s->flags & SAMPLE_MAG))
		merge_add(&rows->merge, CHIPS[earliest], &reading);
	return 1;
}

static int next_merged(struct log_rows *rows, struct log_row *row)
{
	*row = (struct log_row){.line = rows->table[0].line};
	while (!merge_next(&rows->merge, &row->sample)) {
		int got = merge_earliest(rows);

		if (got <= 0)
			return got;
	}
	row->t = (double)row->sample.t_us * 1e-6 - MERGE_EPOCH_S;
	row->sample.t_us = 0;
	return 1;
}

/* ---- both -------------------------------------------------------------------------------------------------------- */

static int open_folder(
	struct log_rows *rows, const char *path, const struct log_format *format, char *error, size_t error_size)
{
	merge_init(&rows->merge, SIMULTANEOUS_NS);
	for (int i = 0; i < LOG_FILES; i++) {
		char file[sizeof rows->table[i].path];
		int result;

		if ((size_t)snprintf(file, sizeof file, "%s/%s", path, format->files[i]) >= sizeof file)
			return -ENAMETOOLONG;
		result = log_table_open(&rows->table[i], file, format, 1u << i, error, error_size);
		if (result < 0 && !(i == 2 && result == -ENOENT)) /* the magnetometer may be missing */
			return result;
		rows->tables++;
	}
	rows->time_unit_s = 1;
	return 0;
}

int log_rows_open(
	struct log_rows *rows, const char *path, const struct log_format *format, char *error, size_t error_size)
{
	struct stat info;
	int result;

	rows->tables = 0;
	rows->time_unit_s = 0;
	memset(&rows->events, 0, sizeof rows->events);
	memset(rows->has_pending, 0, sizeof rows->has_pending);
	if (format->files[0] && stat(path, &info) == 0 && S_ISDIR(info.st_mode)) {
		result = open_folder(rows, path, format, error, error_size);
	} else {
		result = log_table_open(
			&rows->table[0], path, format, LOG_NEEDS_GYRO | LOG_NEEDS_ACCEL, error, error_size);
		rows->tables = 1;
		if (result == 0 && rows->table[0].header.unit_named[LOG_T])
			rows->time_unit_s = rows->table[0].header.scale[LOG_T];
	}
	if (result < 0)
		log_rows_close(rows);
	return result;
}

int log_rows_next(struct log_rows *rows, struct log_row *row)
{
	return rows->tables == 1 ? next_of(rows, &rows->table[0], row) : next_merged(rows, row);
}

void log_rows_close(struct log_rows *rows)
{
	for (int i = 0; i < rows->tables; i++)
		log_table_close(&rows->table[i]);
}
