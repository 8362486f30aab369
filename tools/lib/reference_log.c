#include "tools/lib/reference_log.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model/math/quat.h"

enum { COLUMN_T, COLUMN_Q, COLUMN_ACCEL = 5, COLUMNS = 8, FIELDS_MAX = 256 };
static const char *const NAMES[COLUMNS] = {"t", "qw", "qx", "qy", "qz", "arx", "ary", "arz"};
static const double MAX_GAP_S = 0.05; /* the longest gap between rows that is interpolated */

static int split(char *line, char *field[FIELDS_MAX])
{
	int count = 0;

	line[strcspn(line, "\r\n")] = '\0';
	for (char *next = line; next && count < FIELDS_MAX; count++)
		field[count] = strsep(&next, ",");
	return count;
}

static int find_columns(char *line, int field_of[COLUMNS], const char *path, char *error, size_t error_size)
{
	char *field[FIELDS_MAX];
	int count = split(line, field);

	for (int column = 0; column < COLUMNS; column++) {
		field_of[column] = -1;
		for (int i = 0; i < count; i++)
			if (strcmp(field[i], NAMES[column]) == 0)
				field_of[column] = i;
		if (field_of[column] < 0) {
			snprintf(error, error_size,
				"%s:1: no column %s: the header must name t,qw,qx,qy,qz,arx,ary,arz", path,
				NAMES[column]);
			return -EINVAL;
		}
	}
	return count;
}

/* 1: a row; 0: a row with an empty field; -EINVAL. */
static int parse(char *line, const int field_of[COLUMNS], int fields, double value[COLUMNS])
{
	char *field[FIELDS_MAX], *end;

	if (split(line, field) != fields)
		return -EINVAL;
	for (int i = 0; i < COLUMNS; i++) {
		const char *text = field[field_of[i]];

		if (*text == '\0')
			return 0;
		value[i] = strtod(text, &end);
		if (end == text || *end != '\0' || !(fabs(value[i]) < 1e9))
			return -EINVAL;
	}
	return 1;
}

static int append(struct reference_log *log, const double value[COLUMNS])
{
	const double *q = value + COLUMN_Q, *a = value + COLUMN_ACCEL;
	struct quat attitude = {q[0], q[1], q[2], q[3]};

	if (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] < 0.25)
		return -EINVAL;
	if (log->count > 0 && value[COLUMN_T] <= log->rows[log->count - 1].t_s)
		return -EINVAL;
	if (log->count == log->room) {
		size_t room = log->room ? 2 * log->room : 4096;
		struct reference_row *more = realloc(log->rows, room * sizeof(*more));

		if (!more)
			return -ENOMEM;
		log->rows = more;
		log->room = room;
	}
	log->rows[log->count++] = (struct reference_row){
		value[COLUMN_T], quat_rotate_inverse(quat_normalize(attitude), (struct vec3){a[0], a[1], a[2]})};
	return 0;
}

static int read_rows(struct reference_log *log, FILE *file, const char *path, char *error, size_t error_size)
{
	int field_of[COLUMNS], fields, result = 0;
	double value[COLUMNS];
	char *line = NULL;
	size_t size = 0;

	if (getline(&line, &size, file) < 0) {
		snprintf(
			error, error_size, "%s:1: empty: a reference needs the header t,qw,qx,qy,qz,arx,ary,arz", path);
		free(line);
		return -EINVAL;
	}
	fields = find_columns(line, field_of, path, error, error_size);
	for (long number = 2; fields > 0 && result >= 0 && getline(&line, &size, file) >= 0; number++) {
		result = parse(line, field_of, fields, value);
		if (result > 0)
			result = append(log, value);
		if (result < 0)
			snprintf(error, error_size, "%s:%ld: %s", path, number,
				result == -ENOMEM ? "out of memory"
						  : "not a number or quaternion, or time does not increase");
	}
	free(line);
	return fields < 0 ? fields : result < 0 ? result : 0;
}

int reference_log_load(struct reference_log *log, const char *path, char *error, size_t error_size)
{
	FILE *file = fopen(path, "re");
	int result;

	if (!file) {
		snprintf(error, error_size, "%s: %s", path, strerror(errno));
		return -errno;
	}
	result = read_rows(log, file, path, error, error_size);
	fclose(file);
	if (result == 0 && log->count == 0) {
		snprintf(error, error_size, "%s: no row has attitude and acceleration", path);
		result = -EINVAL;
	}
	return result;
}

bool reference_log_at(struct reference_log *log, uint64_t t_us, struct vec3 *accel_m_s2)
{
	const double t_s = (double)t_us * 1e-6;
	const struct reference_row *a, *b;

	while (log->at > 0 && log->rows[log->at].t_s > t_s)
		log->at--;
	while (log->at + 2 < log->count && log->rows[log->at + 1].t_s <= t_s)
		log->at++;
	if (log->at + 1 >= log->count)
		return false;
	a = &log->rows[log->at];
	b = a + 1;
	if (t_s < a->t_s || t_s > b->t_s || b->t_s - a->t_s > MAX_GAP_S)
		return false;
	*accel_m_s2 = vec3_add(
		a->accel_m_s2, vec3_scale((t_s - a->t_s) / (b->t_s - a->t_s), vec3_sub(b->accel_m_s2, a->accel_m_s2)));
	return true;
}

void reference_log_close(struct reference_log *log)
{
	free(log->rows);
	*log = (struct reference_log){0};
}
