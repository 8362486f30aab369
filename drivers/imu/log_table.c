#include "drivers/imu/log_table.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

/* ---- fields ------------------------------------------------------------------------------------------------------ */

bool log_table_absent(const char *text)
{
	static const char *const WORDS[] = {"", "nan", "-nan", "+nan", "na", "n/a", "<na>", "null", "none", "nat"};

	for (size_t i = 0; i < sizeof WORDS / sizeof *WORDS; i++)
		if (strcasecmp(text, WORDS[i]) == 0)
			return true;
	return false;
}

/* Decimal numbers only: no "nan", no hexadecimal. A comma that did not separate fields is a decimal one. */
int log_table_number(const char *text, double *value)
{
	char point[64], *end, *comma;

	if (text[strspn(text, "+-.,0123456789eE")] != '\0')
		return -EINVAL;
	if (strchr(text, ',')) {
		if ((size_t)snprintf(point, sizeof point, "%s", text) >= sizeof point)
			return -EINVAL;
		comma = strchr(point, ',');
		*comma = '.';
		text = point;
	}
	*value = strtod(text, &end);
	return end != text && *end == '\0' && isfinite(*value) ? 0 : -EINVAL;
}

/* Days since 1970-01-01 of a date of the Gregorian calendar: years begin in March, so that the leap day is the last. */
static double days(int year, int month, int day)
{
	int y = year - (month < 3), m = (month + 9) % 12;
	int leap = (int)(floor(y / 4.0) - floor(y / 100.0) + floor(y / 400.0));

	return 365.0 * y + leap + (153 * m + 2) / 5 + day - 719469;
}

int log_table_time(const char *text, double *value)
{
	int year, month, day, hour, minute, used = 0;
	double second;

	if (log_table_number(text, value) == 0)
		return LOG_TIME_NUMBER;
	if (sscanf(text, "%4d-%2d-%2d%*1[ T]%2d:%2d:%lf", &year, &month, &day, &hour, &minute, &second) == 6) {
		*value = 86400 * days(year, month, day);
	} else if (sscanf(text, "%d days %2d:%2d:%lf%n", &day, &hour, &minute, &second, &used) == 4) {
		*value = 86400.0 * day;
	} else {
		return -EINVAL;
	}
	*value += 3600.0 * hour + 60.0 * minute + second;
	return isfinite(*value) ? LOG_TIME_CALENDAR : -EINVAL;
}

/* The next field of the line, without blanks and quotes around it. *next: the one after it, NULL behind the last. */
static char *take_field(char **next, char separator)
{
	const char *blanks = separator == '\t' ? " " : " \t";
	char *text = *next + strspn(*next, blanks), *end;

	if (*text == '"' || *text == '\'') {
		char quote = *text++;

		end = text + strcspn(text, (char[]){quote, '\0'});
		*next = strchr(end, separator);
	} else {
		*next = strchr(text, separator);
		end = *next ? *next : text + strlen(text);
	}
	if (*next)
		(*next)++;
	while (end > text && strchr(blanks, end[-1]))
		end--;
	*end = '\0';
	return text;
}

/* ---- lines ------------------------------------------------------------------------------------------------------- */

/* 1 and the line without its end, 0 at the end of the file, -EIO. *bad: why it is not a text line, or NULL. */
static int read_line(struct log_table *table, const char **bad)
{
	size_t n = 0;
	int c = getc_unlocked(table->file);

	*bad = NULL;
	if (c == EOF)
		return ferror(table->file) ? -EIO : 0;
	table->line++;
	for (; c != EOF && c != '\n'; c = getc_unlocked(table->file)) {
		if (c == '\0')
			*bad = "a NUL byte";
		else if (n < LOG_LINE_MAX - 1)
			table->text[n++] = (char)c;
		else
			*bad = "the line is too long";
	}
	if (ferror(table->file))
		return -EIO;
	if (n > 0 && table->text[n - 1] == '\r')
		n--;
	table->text[n] = '\0';
	return 1;
}

static char separator_of(const char *text)
{
	size_t commas = 0, semicolons = 0, tabs = 0;

	for (; *text; text++) {
		commas += *text == ',';
		semicolons += *text == ';';
		tabs += *text == '\t';
	}
	return semicolons > commas && semicolons > tabs ? ';' : tabs > commas ? '\t' : ',';
}

/* ---- the header -------------------------------------------------------------------------------------------------- */

/* Which of two fields of one column is meant: the one that is called as in an IMU log, the unnamed index last. */
static int rank(int column, const char *name)
{
	if (strcmp(name, log_column_name(column)) == 0)
		return 2;
	return *name != '\0' && strcasecmp(name, "index") != 0;
}

static const int TRIADS[] = {LOG_GYRO, LOG_ACCEL, LOG_MAG, LOG_REFERENCE};

/* The three columns of a triad. */
static bool any_named(const struct log_header *h, int first)
{
	return h->field_of[first] >= 0 || h->field_of[first + 1] >= 0 || h->field_of[first + 2] >= 0;
}

/* The first missing column, LOG_NO_COLUMN if all are there. Of a triad that is not needed all three or none. */
static int missing(const struct log_header *h, unsigned needed)
{
	if (h->field_of[LOG_T] < 0)
		return LOG_T;
	for (int i = 0; i < 4; i++)
		for (int column = TRIADS[i]; column < TRIADS[i] + 3; column++)
			if (((needed >> i & 1) || any_named(h, TRIADS[i])) && h->field_of[column] < 0)
				return column;
	return LOG_NO_COLUMN;
}

/* A unit that one column of a triad names is that of all three. */
static void share_units(struct log_header *h)
{
	for (int triad = 0; triad < 4; triad++)
		for (int i = 0; i < 9; i++) {
			int from = TRIADS[triad] + i % 3, to = TRIADS[triad] + i / 3;

			if (h->unit_named[from] && !h->unit_named[to])
				h->scale[to] = h->scale[from];
		}
}

/* Reads the names in `text`, which is modified. 0, or -EINVAL and why. */
static int read_names(
	const struct log_format *format, unsigned needed, char *text, struct log_header *h, char *why, size_t why_size)
{
	int ranks[LOG_COLUMNS], column;
	char *next = text;

	*h = (struct log_header){.separator = separator_of(text)};
	for (column = 0; column < LOG_COLUMNS; column++)
		h->field_of[column] = LOG_NO_COLUMN;
	for (; next; h->fields++) {
		char *name = take_field(&next, h->separator);
		double scale;
		bool unit_named;

		column = log_format_column(format, name, &scale, &unit_named);
		if (column == LOG_UNKNOWN_UNIT) {
			snprintf(why, why_size,
				"unknown unit of '%.40s': use s, ms, us, ns; rad/s, deg/s; m/s^2, g, mg; uT, nT, mG, "
				"gauss",
				name);
			return -EINVAL;
		}
		if (column < 0 || (h->field_of[column] >= 0 && rank(column, name) < ranks[column]))
			continue;
		if (h->field_of[column] >= 0 && rank(column, name) == ranks[column]) {
			snprintf(why, why_size, "the header has column %s twice: remove one", log_column_name(column));
			return -EINVAL;
		}
		ranks[column] = rank(column, name);
		h->field_of[column] = h->fields;
		h->scale[column] = scale;
		h->unit_named[column] = unit_named;
	}
	share_units(h);
	column = missing(h, needed);
	if (column < 0)
		return 0;
	snprintf(why, why_size,
		"no column %s: the header must name t,gx,gy,gz,ax,ay,az, and mx,my,mz all or none, "
		"ref_al,ref_as,ref_at likewise",
		log_column_name(column));
	return -EINVAL;
}

/* As read_names(), of the last line read, which stays as it is. The header may be a comment. */
static int read_header_line(
	struct log_table *table, const struct log_format *format, struct log_header *h, char *why, size_t why_size)
{
	char *text = table->copy;

	memcpy(text, table->text, strlen(table->text) + 1);
	if (strncmp(text, "\xef\xbb\xbf", 3) == 0)
		text += 3;
	text += strspn(text, " \t");
	return read_names(format, table->needed, text + strspn(text, "#% "), h, why, why_size);
}

/* Whether the last line read is a header; the table takes it over then. */
static bool take_header(struct log_table *table)
{
	struct log_header h;
	char why[200];

	if (read_header_line(table, table->format, &h, why, sizeof why) < 0)
		return false;
	table->header = h;
	return true;
}

static bool is_comment(const char *text)
{
	text += strspn(text, " \t\"");
	return *text == '#' || *text == '%';
}

/* Another format, whose header the line is, or NULL. */
static const char *other_format(struct log_table *table)
{
	const struct log_format *format;
	struct log_header h;
	char why[200];

	for (int i = 0; (format = log_format_at(i)); i++)
		if (read_header_line(table, format, &h, why, sizeof why) == 0)
			return format->name;
	return NULL;
}

static bool is_blank(const char *text)
{
	return text[strspn(text, " \t")] == '\0';
}

static unsigned uncalibrated_of(const char *comment)
{
	static const char *const names[] = {"gyro", "accelerometer", "magnetometer"};
	static const char key[] = "uncalibrated:";
	unsigned bits = 0;

	comment += strspn(comment, " \t\"#%");
	if (strncasecmp(comment, key, sizeof key - 1) != 0)
		return 0;
	for (unsigned i = 0; i < 3; i++)
		bits |= strcasestr(comment, names[i]) ? 1u << i : 0;
	return bits;
}

static int read_header(struct log_table *table, char *error, size_t error_size)
{
	const char *bad, *other = NULL;
	char why[200];
	int got;

	while ((got = read_line(table, &bad)) > 0 && !bad && (is_blank(table->text) || is_comment(table->text))) {
		if (take_header(table))
			return 0;
		table->uncalibrated |= uncalibrated_of(table->text);
		other = other ? other : other_format(table);
	}
	if (got <= 0 || bad) {
		snprintf(error, error_size, "%s:%ld: %s", table->path, table->line ? table->line : 1,
			got < 0	   ? strerror(errno)
			: got == 0 ? "the file is empty: an IMU log starts with the header t,gx,gy,gz,ax,ay,az,mx,my,mz"
				   : bad);
		return got < 0 ? got : -EINVAL;
	}
	if (read_header_line(table, table->format, &table->header, why, sizeof why) == 0)
		return 0;
	other = other ? other : other_format(table);
	snprintf(error, error_size, "%s:%ld: %s%s%s", table->path, table->line, why,
		other ? "; it is of another format: imu9-replay --format " : "", other ? other : "");
	return -EINVAL;
}

int log_table_open(struct log_table *table, const char *path, const struct log_format *format, unsigned needed,
	char *error, size_t error_size)
{
	int result;

	table->line = 0;
	table->uncalibrated = 0;
	table->format = format;
	table->needed = needed;
	table->header = (struct log_header){0};
	snprintf(table->path, sizeof table->path, "%s", path);
	table->file = strcmp(path, "-") == 0 ? stdin : fopen(path, "re");
	if (!table->file) {
		result = -errno;
		snprintf(error, error_size, "%s: %s", path, strerror(errno));
		return result;
	}
	result = read_header(table, error, error_size);
	if (result < 0)
		log_table_close(table);
	return result;
}

/* ---- rows -------------------------------------------------------------------------------------------------------- */

/* Points `field` into the row. Returns the number of its fields. */
static int split(struct log_table *table)
{
	int count = 0;

	for (int column = 0; column < LOG_COLUMNS; column++)
		table->field[column] = NULL;
	for (char *next = table->text; next; count++) {
		const char *text = take_field(&next, table->header.separator);

		for (int column = 0; column < LOG_COLUMNS; column++)
			if (table->header.field_of[column] == count)
				table->field[column] = text;
	}
	return count;
}

/* The line begins like a header, so that it is worth while to compare it with one. */
static bool like_a_header(const char *text)
{
	text += strspn(text, "\xef\xbb\xbf \t\"'#%");
	return (*text >= 'a' && *text <= 'z') || (*text >= 'A' && *text <= 'Z');
}

int log_table_next(struct log_table *table, char *why, size_t why_size)
{
	const char *bad;
	int got, count;

	do {
		got = read_line(table, &bad);
		if (got <= 0)
			return got;
		if (bad) {
			snprintf(why, why_size, "%s", bad);
			return LOG_LINE_BAD;
		}
		if (like_a_header(table->text) && take_header(table))
			return LOG_LINE_HEADER;
	} while (is_comment(table->text));
	count = split(table);
	if (count == table->header.fields)
		return LOG_LINE_ROW;
	snprintf(why, why_size, "%d fields, the header has %d", count, table->header.fields);
	return LOG_LINE_COUNT;
}

void log_table_close(struct log_table *table)
{
	if (table->file && table->file != stdin)
		fclose(table->file);
	table->file = NULL;
}
