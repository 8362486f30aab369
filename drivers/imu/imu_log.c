#include "drivers/imu/imu_log.h"

#include <errno.h>
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

static const char *const COLUMNS[IMU_LOG_COLUMNS] = {
	"t", "gx", "gy", "gz", "ax", "ay", "az", "mx", "my", "mz", "ref_al", "ref_as", "ref_at", "temperature"};
enum { COLUMN_T, COLUMN_GYRO, COLUMN_ACCEL = 4, COLUMN_MAG = 7, COLUMN_REFERENCE = 10, COLUMN_TEMPERATURE = 13 };
enum { FIELDS_MAX = IMU_LOG_LINE_MAX / 2 };
static const double LATEST_T_S = 1e12; /* well inside uint64_t in microseconds */

static const char *base_name(const char *path)
{
	const char *slash = strrchr(path, '/');

	return slash ? slash + 1 : path;
}

__attribute__((format(printf, 2, 3))) static int skip(struct imu_log *log, const char *format, ...)
{
	va_list args;
	int n = snprintf(log->last_skip, sizeof log->last_skip, "%.60s:%ld: ", base_name(log->path), log->line);

	va_start(args, format);
	vsnprintf(log->last_skip + n, sizeof log->last_skip - (size_t)n, format, args);
	va_end(args);
	log->skipped++;
	return 0;
}

/* 1 and the line without its end, 0 at the end of the file, -EIO. *bad: why it is not a text line, or NULL. */
static int read_line(struct imu_log *log, char text[IMU_LOG_LINE_MAX], const char **bad)
{
	size_t n = 0;
	int c = getc_unlocked(log->file);

	*bad = NULL;
	if (c == EOF)
		return ferror(log->file) ? -EIO : 0;
	log->line++;
	for (; c != EOF && c != '\n'; c = getc_unlocked(log->file)) {
		if (c == '\0')
			*bad = "a NUL byte";
		else if (n < IMU_LOG_LINE_MAX - 1)
			text[n++] = (char)c;
		else
			*bad = "the line is too long";
	}
	if (ferror(log->file))
		return -EIO;
	if (n > 0 && text[n - 1] == '\r')
		n--;
	text[n] = '\0';
	return 1;
}

/* Splits the line at its commas and removes blanks around the fields. Returns the number of fields; FIELDS_MAX means
 * FIELDS_MAX or more. */
static int split(char *text, char *field[FIELDS_MAX])
{
	int count = 0;

	for (char *next = text; next && count < FIELDS_MAX; count++) {
		char *end;

		text = next + strspn(next, " \t");
		next = strchr(text, ',');
		end = next ? next : text + strlen(text);
		if (next)
			next++;
		while (end > text && (end[-1] == ' ' || end[-1] == '\t'))
			end--;
		*end = '\0';
		field[count] = text;
	}
	return count;
}

/* Accepts finite decimal numbers only: no "nan", no hexadecimal. */
static int parse_number(const char *text, double *value)
{
	char *end;

	if (text[strspn(text, "+-.0123456789eE")] != '\0')
		return -EINVAL;
	*value = strtod(text, &end);
	return end != text && *end == '\0' && isfinite(*value) ? 0 : -EINVAL;
}

static int column_named(const char *name)
{
	for (int column = 0; column < IMU_LOG_COLUMNS; column++)
		if (strcmp(name, COLUMNS[column]) == 0)
			return column;
	return -1;
}

static int first_of_triad(int column)
{
	return column < COLUMN_REFERENCE ? COLUMN_MAG : COLUMN_REFERENCE;
}

/* Whether the header has at least one of the three columns. */
static int any_named(const struct imu_log *log, int column)
{
	return log->field_of[column] >= 0 || log->field_of[column + 1] >= 0 || log->field_of[column + 2] >= 0;
}

static int read_header(struct imu_log *log, char *error, size_t error_size)
{
	char text[IMU_LOG_LINE_MAX], *field[FIELDS_MAX];
	const char *bad;
	int got = read_line(log, text, &bad);

	if (got <= 0 || bad) {
		snprintf(error, error_size, "%s:1: %s", log->path,
			got < 0	   ? strerror(errno)
			: got == 0 ? "the file is empty: an IMU log starts with the header t,gx,gy,gz,ax,ay,az,mx,my,mz"
				   : bad);
		return got < 0 ? got : -EINVAL;
	}
	for (int column = 0; column < IMU_LOG_COLUMNS; column++)
		log->field_of[column] = -1;
	log->fields = split(strncmp(text, "\xef\xbb\xbf", 3) == 0 ? text + 3 : text, field);
	for (int i = 0; i < log->fields; i++) {
		int column = column_named(field[i]);

		if (column >= 0 && log->field_of[column] >= 0) {
			snprintf(error, error_size, "%s:1: the header has column %s twice: remove one", log->path,
				field[i]);
			return -EINVAL;
		}
		if (column >= 0)
			log->field_of[column] = i;
	}
	for (int column = 0; column < COLUMN_TEMPERATURE; column++) {
		if ((column < COLUMN_MAG || any_named(log, first_of_triad(column))) && log->field_of[column] < 0) {
			snprintf(error, error_size,
				"%s:1: no column %s: the header must name t,gx,gy,gz,ax,ay,az, and mx,my,mz all or "
				"none, ref_al,ref_as,ref_at likewise",
				log->path, COLUMNS[column]);
			return -EINVAL;
		}
	}
	return 0;
}

/* 1 and three numbers; 0: the row was skipped. */
static int parse_triad(struct imu_log *log, char *const field[], int column, struct vec3 *triad)
{
	double *const value[] = {&triad->x, &triad->y, &triad->z};

	for (int i = 0; i < 3; i++) {
		const char *text = field[log->field_of[column + i]];

		if (parse_number(text, value[i]) < 0)
			return skip(log, "%s is not a finite number: '%.20s'", COLUMNS[column + i], text);
	}
	return 1;
}

/* Whether at least one of the fields is not empty. */
static int any_given(const struct imu_log *log, char *const field[], int column, int count)
{
	for (int i = column; i < column + count; i++)
		if (log->field_of[i] >= 0 && *field[log->field_of[i]] != '\0')
			return 1;
	return 0;
}

/* The fields that may be empty. 0: the row was skipped. */
static int parse_optional(struct imu_log *log, char *const field[], struct imu_sample *sample)
{
	if (any_given(log, field, COLUMN_MAG, 3)) {
		if (!parse_triad(log, field, COLUMN_MAG, &sample->mag_uT))
			return 0;
		sample->flags |= SAMPLE_MAG;
	}
	if (any_given(log, field, COLUMN_REFERENCE, 3)) {
		if (!parse_triad(log, field, COLUMN_REFERENCE, &sample->ref_accel_b_m_s2))
			return 0;
		sample->flags |= SAMPLE_REFERENCE;
	}
	if (any_given(log, field, COLUMN_TEMPERATURE, 1)) {
		const char *text = field[log->field_of[COLUMN_TEMPERATURE]];

		if (parse_number(text, &sample->temperature_degC) < 0)
			return skip(log, "temperature is not a finite number: '%.20s'", text);
		sample->flags |= SAMPLE_TEMPERATURE;
	}
	return 1;
}

/* 1 and a sample; 0: the row was skipped. */
static int parse_row(struct imu_log *log, char *text, struct imu_sample *sample)
{
	char *field[FIELDS_MAX];
	int count = split(text, field);
	double t_s;
	uint64_t t_us;

	*sample = (struct imu_sample){0};
	if (count != log->fields)
		return skip(log, "%d fields, the header has %d", count, log->fields);
	text = field[log->field_of[COLUMN_T]];
	if (parse_number(text, &t_s) < 0)
		return skip(log, "t is not a finite number: '%.20s'", text);
	if (t_s < 0 || t_s > LATEST_T_S)
		return skip(log, "t is out of range: '%.20s'", text);
	t_us = (uint64_t)(t_s * 1e6 + 0.5);
	if (log->started && t_us <= log->last_t_us)
		return skip(log, "time does not increase: '%.20s'", text);
	if (!parse_triad(log, field, COLUMN_GYRO, &sample->gyro_rad_s) ||
		!parse_triad(log, field, COLUMN_ACCEL, &sample->accel_m_s2) || !parse_optional(log, field, sample))
		return 0;
	sample->t_us = t_us;
	log->last_t_us = t_us;
	log->started = 1;
	return 1;
}

static int read_row(struct imu_log *log, struct imu_sample *sample)
{
	char text[IMU_LOG_LINE_MAX];
	const char *bad;

	for (;;) {
		int got = read_line(log, text, &bad);

		if (got <= 0)
			return got;
		if (bad)
			skip(log, "%s", bad);
		else if (parse_row(log, text, sample))
			return 1;
	}
}

static int compare(const void *a, const void *b)
{
	uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;

	return (x > y) - (x < y);
}

static int read_head(struct imu_log *log, char *error, size_t error_size)
{
	uint64_t interval_us[IMU_LOG_HEAD];
	int got = 1, n;

	while (log->head_count < IMU_LOG_HEAD) {
		got = read_row(log, &log->head[log->head_count]);
		if (got <= 0)
			break;
		log->head_count++;
	}
	if (got < 0) {
		snprintf(error, error_size, "%s:%ld: %s", log->path, log->line, strerror(errno));
		return got;
	}
	n = log->head_count - 1;
	if (n < 1) {
		snprintf(error, error_size, "%s: fewer than two valid rows%s%s", log->path,
			log->skipped ? "; last skipped row: " : "", log->last_skip);
		return -EINVAL;
	}
	for (int i = 0; i < n; i++)
		interval_us[i] = log->head[i + 1].t_us - log->head[i].t_us;
	qsort(interval_us, (size_t)n, sizeof *interval_us, compare);
	log->rate_hz = 1e6 / (double)interval_us[n / 2];
	return 0;
}

int imu_log_open(struct imu_log *log, const char *path, char *error, size_t error_size)
{
	int result;

	*log = (struct imu_log){0};
	snprintf(log->path, sizeof log->path, "%s", path);
	log->file = strcmp(path, "-") == 0 ? stdin : fopen(path, "re");
	if (!log->file) {
		result = -errno;
		snprintf(error, error_size, "%s: %s", path, strerror(errno));
		return result;
	}
	result = read_header(log, error, error_size);
	if (result == 0)
		result = read_head(log, error, error_size);
	if (result < 0)
		imu_log_close(log);
	return result;
}

int imu_log_next(struct imu_log *log, struct imu_sample *sample)
{
	if (log->head_next < log->head_count) {
		*sample = log->head[log->head_next++];
		return 1;
	}
	return read_row(log, sample);
}

int imu_log_has_reference(const struct imu_log *log)
{
	return log->field_of[COLUMN_REFERENCE] >= 0;
}

void imu_log_close(struct imu_log *log)
{
	if (log->file && log->file != stdin)
		fclose(log->file);
	log->file = NULL;
}
