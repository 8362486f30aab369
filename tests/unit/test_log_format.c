/* What the columns of a log may be called, and what each unit is in SI (drivers/imu/log_format.h). The factors are
 * those of the SI brochure and of the units' definitions: 1 g is 9.80665 m/s^2, 1 gauss is 100 uT. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "drivers/imu/log_format.h"

static const double DEG = 3.14159265358979323846 / 180, G = 9.80665;

static void assert_column(const char *format, const char *field, int column, double scale, bool unit_named)
{
	double found_scale = NAN;
	bool found_named = !unit_named;
	int found = log_format_column(log_format_named(format), field, &found_scale, &found_named);

	if (found != column)
		fail_msg("%s: '%s' is column %d, not %d", format, field, found, column);
	if (column < 0)
		return;
	if (fabs(found_scale / scale - 1) > 1e-12)
		fail_msg("%s: the unit of '%s' is %.9g, not %.9g", format, field, found_scale, scale);
	if (found_named != unit_named)
		fail_msg("%s: '%s' names %s unit", format, field, found_named ? "a" : "no");
}

static void test_every_unit_has_its_factor_in_each_way_of_writing_it(void **state)
{
	static const struct {
		const char *name;
		int column;
		const char *units[24];
		double scale[24];
	} quantities[] = {
		{"t", LOG_T, {"s", "sec", "seconds", "ms", "us", "\u00b5s", "\u03bcs", "ns"},
			{1, 1, 1, 1e-3, 1e-6, 1e-6, 1e-6, 1e-9}},
		{"gy", LOG_GYRO + 1,
			{"rad/s", "rads", "rad s^-1", "rad*s^-1", "deg/s", "dps", "\u00b0/s", "deg s^-1", "mdps"},
			{1, 1, 1, 1, DEG, DEG, DEG, DEG, 1e-3 * DEG}},
		{"az", LOG_ACCEL + 2, {"m/s^2", "m/s2", "m/s\u00b2", "m s^-2", "ms2", "m*s^-2", "g", "mg"},
			{1, 1, 1, 1, 1, 1, G, 1e-3 * G}},
		{"mx", LOG_MAG, {"uT", "\u00b5T", "\u03bcT", "nT", "mT", "T", "G", "gauss", "mG", "mgauss"},
			{1, 1, 1, 1e-3, 1e3, 1e6, 100, 100, 0.1, 0.1}},
		{"ref_at", LOG_REFERENCE + 2, {"m/s^2", "m/s2", "g"}, {1, 1, G}},
		{"temperature", LOG_TEMPERATURE, {"degC", "C", "\u00b0C", "celsius"}, {1, 1, 1, 1}},
	};
	static const char *const ways[] = {"%s[%s]", "%s (%s)", "%s_%s", "%s %s", "%s [%s]", "%s(%s)"};

	(void)state;
	for (size_t i = 0; i < sizeof quantities / sizeof *quantities; i++)
		for (int unit = 0; quantities[i].units[unit]; unit++)
			for (size_t way = 0; way < sizeof ways / sizeof *ways; way++) {
				char field[64];

				snprintf(field, sizeof field, ways[way], quantities[i].name, quantities[i].units[unit]);
				assert_column("imu9", field, quantities[i].column, quantities[i].scale[unit], true);
			}
}

static void test_every_column_has_its_name(void **state)
{
	static const char *const names[] = {"t", "gx", "gy", "gz", "ax", "ay", "az", "mx", "my", "mz", "ref_al",
		"ref_as", "ref_at", "temperature", "clipped"};

	(void)state;
	assert_int_equal(sizeof names / sizeof *names, LOG_COLUMNS);
	for (int i = 0; i < LOG_COLUMNS; i++) {
		assert_column("imu9", names[i], i, 1, false);
		assert_string_equal(log_column_name(i), names[i]);
	}
}

static void test_each_program_names_its_columns(void **state)
{
	static const struct {
		const char *format, *name;
		int column;
	} names[] = {
		{"phyphox", "Time (s)", LOG_T},
		{"phyphox", "X (rad/s)", LOG_GYRO},
		{"phyphox", "Gyroscope y (rad/s)", LOG_GYRO + 1},
		{"phyphox", "Z (m/s^2)", LOG_ACCEL + 2},
		{"phyphox", "Acceleration x (m/s^2)", LOG_ACCEL},
		{"phyphox", "Y (\u00b5T)", LOG_MAG + 1},
		{"phyphox", "Magnetic field z (\u00b5T)", LOG_MAG + 2},
		{"euroc", "w_RS_S_y [rad s^-1]", LOG_GYRO + 1},
		{"euroc", "a_RS_S_z [m s^-2]", LOG_ACCEL + 2},
		{"euroc", "m_RS_S_x [uT]", LOG_MAG},
		{"x-io", "Time (s)", LOG_T},
		{"x-io", "Accelerometer Z (m/s^2)", LOG_ACCEL + 2},
		{"x-io", "Magnetometer X (uT)", LOG_MAG},
		{"x-io", "Temperature (degC)", LOG_TEMPERATURE},
		{"pandas", "date s", LOG_T},
		{"pandas", "gyr_x (rad/s)", LOG_GYRO},
		{"pandas", "Gyroscope_Z (rad/s)", LOG_GYRO + 2},
		{"pandas", "wy_rads", LOG_GYRO + 1},
		{"pandas", "acc_y m/s2", LOG_ACCEL + 1},
		{"pandas", "accelerometer z (m/s2)", LOG_ACCEL + 2},
		{"pandas", "mag_z_ut", LOG_MAG + 2},
		{"pandas", "magnetometer_x [uT]", LOG_MAG},
		{"pandas", "ref_as[m/s^2]", LOG_REFERENCE + 1},
		{"pandas", "temp [C]", LOG_TEMPERATURE},
	};
	static const char *const times[] = {"", "t", "time", "timestamp", "DateTime", "date", "index", "Unnamed: 0"};

	(void)state;
	for (size_t i = 0; i < sizeof names / sizeof *names; i++)
		assert_column(names[i].format, names[i].name, names[i].column, 1, true);
	for (size_t i = 0; i < sizeof times / sizeof *times; i++)
		assert_column("pandas", times[i], LOG_T, 1, false);
	assert_column("euroc", "timestamp [ns]", LOG_T, 1e-9, true);
	assert_column("pandas", "clipped", LOG_CLIPPED, 1, false);
}

static void test_what_only_begins_like_a_column_is_another(void **state)
{
	static const char *const others[] = {"", "g", "gw", "gxx", "gx2", "tt", "x", "ref_ax", "ref_al2", "axis", "g_x",
		"t2", "temperatures", "gx_raw", "ax_offset g"};

	(void)state;
	for (size_t i = 0; i < sizeof others / sizeof *others; i++)
		assert_column("imu9", others[i], LOG_NO_COLUMN, 1, false);
	assert_column("phyphox", "X", LOG_NO_COLUMN, 1, false);
	assert_column("phyphox", "Absolute (rad/s)", LOG_NO_COLUMN, 1, false);
}

/* Of an axis alone the unit tells the quantity: a unknown one is of a column that is not needed. */
static void test_a_unit_of_another_quantity_is_unknown_only_in_brackets(void **state)
{
	(void)state;
	assert_column("imu9", "gx[m/s^2]", LOG_UNKNOWN_UNIT, 1, true);
	assert_column("imu9", "ax (rad/s)", LOG_UNKNOWN_UNIT, 1, true);
	assert_column("imu9", "mx[rad]", LOG_UNKNOWN_UNIT, 1, true);
	assert_column("imu9", "gx[]", LOG_UNKNOWN_UNIT, 1, true);
	assert_column("imu9", "gx[rad/ss]", LOG_UNKNOWN_UNIT, 1, true);
	assert_column("imu9", "gx_m/s^2", LOG_NO_COLUMN, 1, true);
	assert_column("phyphox", "x (hPa)", LOG_NO_COLUMN, 1, true);
}

static void test_each_format_has_its_name_and_its_place_in_the_list(void **state)
{
	static const char *const names[] = {"imu9", "phyphox", "euroc", "x-io", "pandas"};
	int i;

	(void)state;
	for (i = 0; i < 5; i++) {
		assert_string_equal(log_format_at(i)->name, names[i]);
		assert_ptr_equal(log_format_named(names[i]), log_format_at(i));
	}
	assert_null(log_format_at(-1));
	assert_null(log_format_at(5));
	assert_null(log_format_named("imu"));
	assert_ptr_equal(log_format_named("EuRoC"), log_format_at(2));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_every_unit_has_its_factor_in_each_way_of_writing_it),
		cmocka_unit_test(test_every_column_has_its_name),
		cmocka_unit_test(test_each_program_names_its_columns),
		cmocka_unit_test(test_what_only_begins_like_a_column_is_another),
		cmocka_unit_test(test_a_unit_of_another_quantity_is_unknown_only_in_brackets),
		cmocka_unit_test(test_each_format_has_its_name_and_its_place_in_the_list),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
