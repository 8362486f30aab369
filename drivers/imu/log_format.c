#include "drivers/imu/log_format.h"

#include <ctype.h>
#include <string.h>
#include <strings.h>

#include "model/math/units.h"

enum quantity { TIME, RATE, FORCE, FIELD, REFERENCE, TEMPERATURE, CLIPPED, QUANTITIES };

/* Names as the programs write them: EuRoC, the data set of M. Burri et al., imu0/data.csv; phyphox, exported CSV; x-io,
 * the logs of NGIMU and x-IMU3; pandas, DataFrame.to_csv() with the index, which has no name, as the time. */
static const struct log_format FORMATS[] = {
	{.name = "imu9", .names = {"t", "g*", "a*", "m*", "ref_a*", "temperature", "clipped"}},
	{.name = "phyphox",
		.names = {"time", "gyroscope *|*", "acceleration *|*", "magnetic field *|*"},
		.files = {"Gyroscope.csv", "Accelerometer.csv", "Magnetometer.csv"}},
	{.name = "euroc", .names = {"timestamp", "w_rs_s_*", "a_rs_s_*", "m_rs_s_*"}},
	{.name = "x-io",
		.names = {"time|timestamp", "gyroscope *", "accelerometer *", "magnetometer *", NULL, "temperature"}},
	{.name = "pandas",
		.names = {"|t|time|timestamp|datetime|date|index|unnamed: 0", "g*|gyro_*|gyr_*|w*|gyroscope_*",
			"a*|acc_*|accel_*|accelerometer_*", "m*|mag_*|magnetometer_*", "ref_a*", "temperature|temp",
			"clipped"}},
};
enum { FORMAT_COUNT = sizeof FORMATS / sizeof *FORMATS };

static const struct {
	enum quantity quantity;
	const char *name; /* in lower case */
	double scale;
} UNITS[] = {
	{TIME, "s", 1},
	{TIME, "sec", 1},
	{TIME, "seconds", 1},
	{TIME, "ms", 1e-3},
	{TIME, "us", 1e-6},
	{TIME, "\u00b5s", 1e-6},
	{TIME, "\u03bcs", 1e-6},
	{TIME, "ns", 1e-9},
	{RATE, "rad/s", 1},
	{RATE, "rads", 1},
	{RATE, "rad s^-1", 1},
	{RATE, "rad*s^-1", 1},
	{RATE, "deg/s", RAD_PER_DEG},
	{RATE, "dps", RAD_PER_DEG},
	{RATE, "\u00b0/s", RAD_PER_DEG},
	{RATE, "deg s^-1", RAD_PER_DEG},
	{RATE, "mdps", 1e-3 * RAD_PER_DEG},
	{FORCE, "m/s^2", 1},
	{FORCE, "m/s2", 1},
	{FORCE, "m/s\u00b2", 1},
	{FORCE, "m s^-2", 1},
	{FORCE, "ms2", 1},
	{FORCE, "m*s^-2", 1},
	{FORCE, "g", STANDARD_GRAVITY_M_S2},
	{FORCE, "mg", 1e-3 * STANDARD_GRAVITY_M_S2},
	{FIELD, "ut", 1},
	{FIELD, "\u00b5t", 1},
	{FIELD, "\u03bct", 1},
	{FIELD, "nt", 1e-3},
	{FIELD, "mt", 1e3},
	{FIELD, "t", 1e6},
	{FIELD, "g", 100},
	{FIELD, "gauss", 100},
	{FIELD, "mg", 0.1},
	{FIELD, "mgauss", 0.1},
	{REFERENCE, "m/s^2", 1},
	{REFERENCE, "m/s2", 1},
	{REFERENCE, "g", STANDARD_GRAVITY_M_S2},
	{TEMPERATURE, "degc", 1},
	{TEMPERATURE, "c", 1},
	{TEMPERATURE, "\u00b0c", 1},
	{TEMPERATURE, "celsius", 1},
};

const struct log_format *log_format_at(int i)
{
	return i >= 0 && i < FORMAT_COUNT ? &FORMATS[i] : NULL;
}

const struct log_format *log_format_named(const char *name)
{
	for (int i = 0; i < FORMAT_COUNT; i++)
		if (strcasecmp(name, FORMATS[i].name) == 0)
			return &FORMATS[i];
	return NULL;
}

static int first_column(enum quantity quantity)
{
	static const int FIRST[QUANTITIES] = {
		LOG_T, LOG_GYRO, LOG_ACCEL, LOG_MAG, LOG_REFERENCE, LOG_TEMPERATURE, LOG_CLIPPED};

	return FIRST[quantity];
}

/* The letter in upper or lower case; a blank and an underscore are the same. */
static char plain(char c)
{
	return c == ' ' ? '_' : (char)tolower((unsigned char)c);
}

/* What follows the name in the field, NULL when the field has another one. *axis: 0 to 2, the place of the letter at
 * the name's asterisk; 0 without one. */
static const char *behind(const char *field, const char *name, size_t length, enum quantity quantity, int *axis)
{
	const char *axes = quantity == REFERENCE ? "lst" : "xyz", *found;

	*axis = 0;
	for (size_t i = 0; i < length; i++, field++) {
		if (name[i] == '*') {
			found = *field ? strchr(axes, plain(*field)) : NULL;
			if (!found)
				return NULL;
			*axis = (int)(found - axes);
		} else if (plain(name[i]) != plain(*field)) {
			return NULL;
		}
	}
	return *field == '\0' || strchr(" _[(", *field) ? field : NULL;
}

/* False: there is no such unit. */
static bool unit_scale(enum quantity quantity, const char *text, size_t length, double *scale)
{
	for (size_t i = 0; i < sizeof UNITS / sizeof *UNITS; i++) {
		if (UNITS[i].quantity == quantity && strlen(UNITS[i].name) == length &&
			strncasecmp(UNITS[i].name, text, length) == 0) {
			*scale = UNITS[i].scale;
			return true;
		}
	}
	return false;
}

/* The column, if the field is this name with or without a unit behind it. */
static int match(
	const char *field, const char *name, size_t length, enum quantity quantity, double *scale, bool *unit_named)
{
	int axis, column = first_column(quantity);
	const char *rest = behind(field, name, length, quantity, &axis), *unit;

	if (!rest)
		return LOG_NO_COLUMN;
	unit = rest + strspn(rest, " _[(");
	*scale = 1;
	*unit_named = *unit != '\0';
	if (!*unit_named) /* an axis alone is no name */
		return length == 1 && *name == '*' ? LOG_NO_COLUMN : column + axis;
	if (unit_scale(quantity, unit, strcspn(unit, "])"), scale))
		return column + axis;
	return length > 1 && strpbrk(rest, "[(") ? LOG_UNKNOWN_UNIT : LOG_NO_COLUMN;
}

int log_format_column(const struct log_format *format, const char *field, double *scale, bool *unit_named)
{
	int result = LOG_NO_COLUMN;

	for (int quantity = 0; quantity < QUANTITIES; quantity++) {
		const char *name = format->names[quantity];

		while (name) {
			size_t length = strcspn(name, "|");
			int column = match(field, name, length, (enum quantity)quantity, scale, unit_named);

			if (column >= 0)
				return column;
			if (column == LOG_UNKNOWN_UNIT)
				result = column;
			name = name[length] ? name + length + 1 : NULL;
		}
	}
	return result;
}

const char *log_column_name(int column)
{
	static const char *const NAMES[LOG_COLUMNS] = {"t", "gx", "gy", "gz", "ax", "ay", "az", "mx", "my", "mz",
		"ref_al", "ref_as", "ref_at", "temperature", "clipped"};

	return NAMES[column];
}
