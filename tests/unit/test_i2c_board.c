/* The I2C driver on simulated chips, in simulated time: detection, scales, times, settings. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "tests/unit/i2c_stub.h"
#include "tests/unit/i2c_world.h"
#include "model/math/units.h"

static const char *const BOARDS[] = {"v0", "v1", "v2", "v3", "v5", "v6", "lsm9ds1", "icm20948", "icm42688", "bmi270",
	"v3/spi", "v5/spi", "v6/spi", "lsm9ds1/spi", "icm20948/spi", "icm42688/spi", "bmi270/spi"};
enum { POLOLU_COUNT = 6, STUB_COUNT = 7, BOARD_COUNT = sizeof BOARDS / sizeof *BOARDS };
/* until there are samples; the configuration file of the BMI270 takes 0.3 s at 400 kHz */
enum { START_US = 600000 };

/* ---- detection --------------------------------------------------------------------------------------------------- */

static void test_each_board_is_recognised(void **state)
{
	static const char *const names[BOARD_COUNT] = {"v0", "v1", "v2", "v3", "v5", "v6", "LSM9DS1",
		"ICM-20948+AK09916", "ICM-42688-P", "BMI270", "v3", "v5", "v6", "LSM9DS1", "ICM-20948", "ICM-42688-P",
		"BMI270"};

	(void)state;
	for (int i = 0; i < BOARD_COUNT; i++) {
		struct world *w = world_make(BOARDS[i], "rest", true);

		world_detect(w);
		assert_string_equal(w->board.name, names[i]);
		world_free(w);
	}
}

/* With SA0 high, the accelerometers of LSM303DLH and DLM have the address of the DLHC's. */
static void test_the_accelerometer_of_an_lsm303dlh_is_found_at_19h_too(void **state)
{
	struct world *w = world_new("v0-sa0", "rest", false);
	struct imu_sample sample;

	(void)state;
	assert_string_equal(w->board.name, "v0");
	assert_int_equal(w->board.accel->address, 0x19);
	assert_string_equal(w->board.accel->chip->name, "LSM303DLH");
	assert_true(world_sample(w, &sample, 500000));
	assert_true(fabs(sample.accel_m_s2.z - 9.81) < 0.2);
	world_free(w);
}

static int no_answer_at_1e(struct world *w, const struct sim_access *access)
{
	(void)w;
	return access->address == 0x1E ? -ENXIO : 0;
}

/* The board is none of those that are known. */
static void test_an_accelerometer_without_its_magnetometer_is_named_beside_the_gyro(void **state)
{
	struct world *w = world_make("v2", "rest", false);

	(void)state;
	w->before = no_answer_at_1e;
	world_detect(w);
	assert_string_equal(w->board.name, "L3GD20+LSM303DLHC");
	w->before = NULL;
	world_free(w);
}

static void test_a_board_without_magnetometer_gives_samples_without_it_and_says_so(void **state)
{
	static const struct {
		const char *board, *words;
	} boards[] = {{"v6-6d", "no magnetometer answers (LIS3MDL beside the LSM6DSO)"},
		{"icm42688", "the ICM-42688-P has no magnetometer"}, {"bmi270", "the BMI270 has no magnetometer"},
		{"icm20948/spi", "use I2C"}, {"lsm9ds1", ""}};

	(void)state;
	for (int i = 0; i < 5; i++) {
		struct world *w = world_new(boards[i].board, "rest", false);
		struct imu_sample sample;
		unsigned flags = 0;

		if (boards[i].words[0] ? !strstr(w->board.note, boards[i].words) : w->board.note[0] != '\0')
			fail_msg("%s: '%s'", boards[i].board, w->board.note);
		for (int n = 0; n < 100; n++) {
			assert_true(world_sample(w, &sample, START_US));
			flags |= sample.flags;
		}
		assert_int_equal(flags & SAMPLE_MAG, boards[i].words[0] ? 0 : SAMPLE_MAG);
		assert_int_equal(w->board.health.fault, 0);
		assert_int_equal(w->board.health.degraded, 0);
		world_free(w);
	}
}

static int nobody(struct world *w, const struct sim_access *access)
{
	(void)w, (void)access;
	return -ENXIO;
}

static void test_an_empty_bus_is_refused_with_the_addresses_that_were_tried(void **state)
{
	struct world *w = world_make("v3", "rest", true);
	const struct board_clock clock = w->board.clock;
	char why[200];

	(void)state;
	w->before = nobody;
	assert_int_equal(board_detect(&w->board, w->bus, &clock, why, sizeof why), -ENXIO);
	assert_non_null(strstr(why, "no gyro answers at 68h to 6Bh"));
	world_free(w);
}

static int cause, cause_at; /* of an access to this address; to all others ENXIO */

static int refuse_access(struct world *w, const struct sim_access *access)
{
	(void)w;
	return access->address == cause_at ? -cause : -ENXIO;
}

static int only_the_gyro(struct world *w, const struct sim_access *access)
{
	return access->address == sim_board_address(w->sim, IMU_CHIP_GYRO) ? 0 : refuse_access(w, access);
}

/* Of several causes the one that the user can do something about: a driver that has the chip, or a lack of rights. */
static void test_why_no_chip_was_found_is_told(void **state)
{
	static const struct {
		int at, cause, told;
	} cases[] = {{0, 0, ENXIO}, {0x6B, EIO, ENXIO}, {0x68, EIO, EIO}, {0x6B, EBUSY, EBUSY}, {0x6A, EACCES, EACCES}};
	char why[200], expected[200];

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		struct world *w = world_make("v3", "rest", true);
		const struct board_clock clock = w->board.clock;

		w->before = refuse_access;
		cause_at = cases[i].at;
		cause = cases[i].cause;
		assert_int_equal(board_detect(&w->board, w->bus, &clock, why, sizeof why), -cases[i].told);
		snprintf(expected, sizeof expected,
			"no gyro answers at 68h to 6Bh (%s): check power and wiring, and that no kernel driver is "
			"bound to the chip",
			strerror(cases[i].told));
		assert_string_equal(why, expected);
		w->before = only_the_gyro;
		cause_at = 0x1D;
		cause = EBUSY;
		assert_int_equal(board_detect(&w->board, w->bus, &clock, why, sizeof why), -EBUSY);
		assert_string_equal(why,
			"no accelerometer answers at 18h, 19h, 1Dh or 1Eh (Device or resource busy): check power and "
			"wiring, and that no kernel driver is bound to the chip");
		world_free(w);
	}
}

static void other_identity(struct world *w, const struct sim_access *access)
{
	(void)w;
	if (!access->write && access->sub == 0x0F)
		access->bytes[0] = 0x33;
}

static void test_unknown_chips_are_refused(void **state)
{
	struct world *w = world_make("v6", "rest", true);
	const struct board_clock clock = w->board.clock;
	char why[200];

	(void)state;
	w->after = other_identity;
	assert_int_equal(board_detect(&w->board, w->bus, &clock, why, sizeof why), -ENXIO); /* of the other address */
	w->bus->spi = true;
	w->before = nobody;
	assert_int_equal(board_detect(&w->board, w->bus, &clock, why, sizeof why), -ENXIO);
	assert_string_equal(why,
		"no gyro answers on SPI: name the device of each chip, check power and wiring, and try "
		"speed=100000");
	world_free(w);
}

/* ---- scales and axes, against the data sheets' figures ----------------------------------------------------------- */

enum { X = 4000, Y = -1600, Z = 800 }; /* multiples of 16 */

struct layout {
	uint8_t address, data; /* of the chip; its first data register */
	bool big_endian;
	int y, z;    /* places of y and z; x comes first */
	int against; /* bit 0: x of the chip points against x of the board; 1: y; 2: z */
};

static struct layout layout; /* for fake_data() */

static void put_word(uint8_t *at, int value, bool big)
{
	at[big ? 1 : 0] = (uint8_t)value;
	at[big ? 0 : 1] = (uint8_t)((unsigned)value >> 8);
}

/* Replaces the data of a read by X, Y, Z, and those of the next by -X, -Y, -Z, so that they are not frozen. */
static void fake_data(struct world *w, const struct sim_access *access)
{
	const uint8_t first = access->sub & 0x7F;
	static int sign = 1;

	(void)w;
	if (access->write || access->address != layout.address || first > layout.data ||
		first + access->n < layout.data + 6u)
		return;
	uint8_t *at = access->bytes + (layout.data - first);

	sign = -sign;
	put_word(at, sign * X, layout.big_endian);
	put_word(at + 2 * layout.y, sign * Y, layout.big_endian);
	put_word(at + 2 * layout.z, sign * Z, layout.big_endian);
}

struct scale {
	const char *board;
	enum imu_chip chip;
	double range;		  /* as set: deg/s, g, uT */
	double digit_xy, digit_z; /* of the 16-bit word: deg/s, g, uT */
	struct layout layout;
};

static const struct scale SCALES[] = {
	{"v0", IMU_CHIP_GYRO, 250, 0.00875, 0.00875, {0x69, 0x28, false, 1, 2, 0}},
	{"v0", IMU_CHIP_GYRO, 500, 0.0175, 0.0175, {0x69, 0x28, false, 1, 2, 0}},
	{"v0", IMU_CHIP_GYRO, 2000, 0.070, 0.070, {0x69, 0x28, false, 1, 2, 0}},
	{"v0", IMU_CHIP_ACCEL, 2, 0.001 / 16, 0.001 / 16, {0x18, 0x28, false, 1, 2, 0}},
	{"v0", IMU_CHIP_ACCEL, 4, 0.002 / 16, 0.002 / 16, {0x18, 0x28, false, 1, 2, 0}},
	{"v0", IMU_CHIP_ACCEL, 8, 0.0039 / 16, 0.0039 / 16, {0x18, 0x28, false, 1, 2, 0}},
	{"v0", IMU_CHIP_MAG, 130, 100. / 1055, 100. / 950, {0x1E, 0x03, true, 1, 2, 0}},
	{"v0", IMU_CHIP_MAG, 190, 100. / 795, 100. / 710, {0x1E, 0x03, true, 1, 2, 0}},
	{"v0", IMU_CHIP_MAG, 250, 100. / 635, 100. / 570, {0x1E, 0x03, true, 1, 2, 0}},
	{"v0", IMU_CHIP_MAG, 400, 100. / 430, 100. / 385, {0x1E, 0x03, true, 1, 2, 0}},
	{"v0", IMU_CHIP_MAG, 470, 100. / 375, 100. / 335, {0x1E, 0x03, true, 1, 2, 0}},
	{"v0", IMU_CHIP_MAG, 560, 100. / 320, 100. / 285, {0x1E, 0x03, true, 1, 2, 0}},
	{"v0", IMU_CHIP_MAG, 810, 100. / 230, 100. / 205, {0x1E, 0x03, true, 1, 2, 0}},
	{"v1", IMU_CHIP_MAG, 130, 100. / 1100, 100. / 980, {0x1E, 0x03, true, 2, 1, 0}},
	{"v1", IMU_CHIP_MAG, 810, 100. / 230, 100. / 205, {0x1E, 0x03, true, 2, 1, 0}},
	{"v2", IMU_CHIP_GYRO, 250, 0.00875, 0.00875, {0x6B, 0x28, false, 1, 2, 0}},
	{"v2", IMU_CHIP_GYRO, 2000, 0.070, 0.070, {0x6B, 0x28, false, 1, 2, 0}},
	{"v2", IMU_CHIP_ACCEL, 2, 0.001 / 16, 0.001 / 16, {0x19, 0x28, false, 1, 2, 0}},
	{"v2", IMU_CHIP_ACCEL, 4, 0.002 / 16, 0.002 / 16, {0x19, 0x28, false, 1, 2, 0}},
	{"v2", IMU_CHIP_ACCEL, 8, 0.004 / 16, 0.004 / 16, {0x19, 0x28, false, 1, 2, 0}},
	{"v2", IMU_CHIP_ACCEL, 16, 0.012 / 16, 0.012 / 16, {0x19, 0x28, false, 1, 2, 0}},
	{"v2", IMU_CHIP_MAG, 130, 100. / 1100, 100. / 980, {0x1E, 0x03, true, 2, 1, 0}},
	{"v2", IMU_CHIP_MAG, 560, 100. / 330, 100. / 295, {0x1E, 0x03, true, 2, 1, 0}},
	{"v3", IMU_CHIP_GYRO, 250, 0.00875, 0.00875, {0x6B, 0x28, false, 1, 2, 0}},
	{"v3", IMU_CHIP_GYRO, 500, 0.0175, 0.0175, {0x6B, 0x28, false, 1, 2, 0}},
	{"v3", IMU_CHIP_GYRO, 2000, 0.070, 0.070, {0x6B, 0x28, false, 1, 2, 0}},
	{"v3", IMU_CHIP_ACCEL, 2, 0.000061, 0.000061, {0x1D, 0x28, false, 1, 2, 0}},
	{"v3", IMU_CHIP_ACCEL, 4, 0.000122, 0.000122, {0x1D, 0x28, false, 1, 2, 0}},
	{"v3", IMU_CHIP_ACCEL, 6, 0.000183, 0.000183, {0x1D, 0x28, false, 1, 2, 0}},
	{"v3", IMU_CHIP_ACCEL, 8, 0.000244, 0.000244, {0x1D, 0x28, false, 1, 2, 0}},
	{"v3", IMU_CHIP_ACCEL, 16, 0.000732, 0.000732, {0x1D, 0x28, false, 1, 2, 0}},
	{"v3", IMU_CHIP_MAG, 200, 0.0080, 0.0080, {0x1D, 0x08, false, 1, 2, 0}},
	{"v3", IMU_CHIP_MAG, 400, 0.0160, 0.0160, {0x1D, 0x08, false, 1, 2, 0}},
	{"v3", IMU_CHIP_MAG, 800, 0.0320, 0.0320, {0x1D, 0x08, false, 1, 2, 0}},
	{"v3", IMU_CHIP_MAG, 1200, 0.0479, 0.0479, {0x1D, 0x08, false, 1, 2, 0}},
	{"v5", IMU_CHIP_GYRO, 125, 0.004375, 0.004375, {0x6B, 0x22, false, 1, 2, 0}},
	{"v5", IMU_CHIP_GYRO, 1000, 0.035, 0.035, {0x6B, 0x22, false, 1, 2, 0}},
	{"v5", IMU_CHIP_ACCEL, 2, 0.000061, 0.000061, {0x6B, 0x28, false, 1, 2, 0}},
	{"v5", IMU_CHIP_ACCEL, 16, 0.000488, 0.000488, {0x6B, 0x28, false, 1, 2, 0}},
	{"v5", IMU_CHIP_MAG, 400, 100. / 6842, 100. / 6842, {0x1E, 0x28, false, 1, 2, 0}},
	{"v5", IMU_CHIP_MAG, 1600, 100. / 1711, 100. / 1711, {0x1E, 0x28, false, 1, 2, 0}},
	{"v6", IMU_CHIP_GYRO, 250, 0.00875, 0.00875, {0x6B, 0x22, false, 1, 2, 0}},
	{"v6", IMU_CHIP_GYRO, 500, 0.0175, 0.0175, {0x6B, 0x22, false, 1, 2, 0}},
	{"v6", IMU_CHIP_GYRO, 2000, 0.070, 0.070, {0x6B, 0x22, false, 1, 2, 0}},
	{"v6", IMU_CHIP_ACCEL, 4, 0.000122, 0.000122, {0x6B, 0x28, false, 1, 2, 0}},
	{"v6", IMU_CHIP_ACCEL, 8, 0.000244, 0.000244, {0x6B, 0x28, false, 1, 2, 0}},
	/* gyro and accelerometer are left-handed: y against y of the board; the magnetometer's x and y are */
	{"lsm9ds1", IMU_CHIP_GYRO, 245, 0.00875, 0.00875, {0x6B, 0x18, false, 1, 2, 2}},
	{"lsm9ds1", IMU_CHIP_GYRO, 500, 0.0175, 0.0175, {0x6B, 0x18, false, 1, 2, 2}},
	{"lsm9ds1", IMU_CHIP_GYRO, 2000, 0.070, 0.070, {0x6B, 0x18, false, 1, 2, 2}},
	{"lsm9ds1", IMU_CHIP_ACCEL, 2, 0.000061, 0.000061, {0x6B, 0x28, false, 1, 2, 2}},
	{"lsm9ds1", IMU_CHIP_ACCEL, 4, 0.000122, 0.000122, {0x6B, 0x28, false, 1, 2, 2}},
	{"lsm9ds1", IMU_CHIP_ACCEL, 8, 0.000244, 0.000244, {0x6B, 0x28, false, 1, 2, 2}},
	{"lsm9ds1", IMU_CHIP_ACCEL, 16, 0.000732, 0.000732, {0x6B, 0x28, false, 1, 2, 2}},
	{"lsm9ds1", IMU_CHIP_MAG, 400, 0.014, 0.014, {0x1E, 0x28, false, 1, 2, 3}},
	{"lsm9ds1", IMU_CHIP_MAG, 800, 0.029, 0.029, {0x1E, 0x28, false, 1, 2, 3}},
	{"lsm9ds1", IMU_CHIP_MAG, 1200, 0.043, 0.043, {0x1E, 0x28, false, 1, 2, 3}},
	{"lsm9ds1", IMU_CHIP_MAG, 1600, 0.058, 0.058, {0x1E, 0x28, false, 1, 2, 3}},
	/* y and z of the AK09916 are against those of the ICM-20948 */
	{"icm20948", IMU_CHIP_GYRO, 250, 250 / 32768., 250 / 32768., {0x69, 0x33, true, 1, 2, 0}},
	{"icm20948", IMU_CHIP_GYRO, 2000, 2000 / 32768., 2000 / 32768., {0x69, 0x33, true, 1, 2, 0}},
	{"icm20948", IMU_CHIP_ACCEL, 2, 1 / 16384., 1 / 16384., {0x69, 0x2D, true, 1, 2, 0}},
	{"icm20948", IMU_CHIP_ACCEL, 8, 1 / 4096., 1 / 4096., {0x69, 0x2D, true, 1, 2, 0}},
	{"icm20948", IMU_CHIP_ACCEL, 16, 1 / 2048., 1 / 2048., {0x69, 0x2D, true, 1, 2, 0}},
	{"icm20948", IMU_CHIP_MAG, 130, 0.15, 0.15, {0x0C, 0x11, false, 1, 2, 6}},
	{"icm42688", IMU_CHIP_GYRO, 125, 125 / 32768., 125 / 32768., {0x68, 0x25, true, 1, 2, 0}},
	{"icm42688", IMU_CHIP_GYRO, 1000, 1000 / 32768., 1000 / 32768., {0x68, 0x25, true, 1, 2, 0}},
	{"icm42688", IMU_CHIP_ACCEL, 4, 1 / 8192., 1 / 8192., {0x68, 0x1F, true, 1, 2, 0}},
	{"icm42688", IMU_CHIP_ACCEL, 8, 1 / 4096., 1 / 4096., {0x68, 0x1F, true, 1, 2, 0}},
	{"bmi270", IMU_CHIP_GYRO, 500, 500 / 32768., 500 / 32768., {0x68, 0x12, false, 1, 2, 0}},
	{"bmi270", IMU_CHIP_GYRO, 2000, 2000 / 32768., 2000 / 32768., {0x68, 0x12, false, 1, 2, 0}},
	{"bmi270", IMU_CHIP_ACCEL, 2, 1 / 16384., 1 / 16384., {0x68, 0x0C, false, 1, 2, 0}},
	{"bmi270", IMU_CHIP_ACCEL, 8, 1 / 4096., 1 / 4096., {0x68, 0x0C, false, 1, 2, 0}},
};

/* The field is rotated to the sample's time with the noisy gyro, so that it differs a little from what was read. */
static bool shown(struct vec3 got, const struct scale *s, double unit)
{
	const double tolerance = s->chip == IMU_CHIP_MAG ? 0.3 : 1e-9;
	const double xy = s->digit_xy * unit, z = s->digit_z * unit;
	const int against = s->layout.against;
	const double x_sign = got.x < 0 ? -1 : 1, sign = against & 1 ? -x_sign : x_sign;
	const double y_sign = against & 2 ? -sign : sign, z_sign = against & 4 ? -sign : sign;

	return fabs(got.x - x_sign * X * xy) < tolerance && fabs(got.y - y_sign * Y * xy) < tolerance &&
	       fabs(got.z - z_sign * Z * z) < tolerance;
}

static void test_digits_have_the_size_and_the_axes_the_order_of_the_data_sheets(void **state)
{
	(void)state;
	for (size_t i = 0; i < sizeof SCALES / sizeof *SCALES; i++) {
		const struct scale *s = &SCALES[i];
		struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
		struct world *w = world_make(s->board, "rest", false);
		struct imu_sample sample;
		struct vec3 got = {0, 0, 0};

		*(s->chip == IMU_CHIP_GYRO	    ? &settings.gyro_range_deg_s
			: s->chip == IMU_CHIP_ACCEL ? &settings.accel_range_g
						    : &settings.mag_range_uT) = s->range;
		world_detect(w);
		world_set_up(w, &settings, false);
		layout = s->layout;
		w->after = fake_data;
		sample.flags = 0;
		for (int n = 0; n < 100 && (n == 0 || (s->chip == IMU_CHIP_MAG && !(sample.flags & SAMPLE_MAG))); n++)
			assert_true(world_sample(w, &sample, START_US));
		got = s->chip == IMU_CHIP_GYRO	? sample.gyro_rad_s
		      : s->chip == IMU_CHIP_MAG ? sample.mag_uT
						: sample.accel_m_s2;
		if (s->chip == IMU_CHIP_ACCEL && w->board.accel != w->board.gyro) /* between its two signs */
			got = w->board.accel->readings[w->board.accel->first].value[0];
		if (!shown(got, s,
			    s->chip == IMU_CHIP_GYRO	? RAD_PER_DEG
			    : s->chip == IMU_CHIP_ACCEL ? STANDARD_GRAVITY_M_S2
							: 1))
			fail_msg("%s, range %g: %g %g %g", s->board, s->range, got.x, got.y, got.z);
		world_free(w);
	}
}

/* ---- the motion is measured -------------------------------------------------------------------------------------- */

/* digits at 2000 deg/s, 8 g and the finest field range */
static const struct {
	double gyro_dps, accel_g;
} DIGITS[BOARD_COUNT] = {{0.07, 0.0039}, {0.07, 0.0039}, {0.07, 0.004}, {0.07, 0.000244}, {0.07, 0.000244},
	{0.07, 0.000244}, {0.07, 0.000244}, {0.061, 0.000244}, {0.061, 0.000244}, {0.061, 0.000244}, {0.07, 0.000244},
	{0.07, 0.000244}, {0.07, 0.000244}, {0.07, 0.000244}, {0.061, 0.000244}, {0.061, 0.000244}, {0.061, 0.000244}};

static double worst(struct vec3 a, struct vec3 b)
{
	return fmax(fabs(a.x - b.x), fmax(fabs(a.y - b.y), fabs(a.z - b.z)));
}

static void test_samples_are_the_motion_within_a_digit_and_the_time_within_a_tenth_of_a_sample(void **state)
{
	(void)state;
	for (int i = 0; i < BOARD_COUNT; i++) {
		struct world *w = world_new(BOARDS[i], "tumble", true);
		struct imu_sample sample;

		for (int n = 0; n < 600; n++) {
			struct signal_truth truth;

			assert_true(world_sample(w, &sample, n ? 200000 : START_US));
			truth = world_truth(w, &sample);
			if (n < 20)
				continue;
			/* |alpha| < 40 rad/s^2 and |jerk| < 300 m/s^3 here */
			assert_true(worst(sample.gyro_rad_s, truth.omega_b_rad_s) <
				    DIGITS[i].gyro_dps * RAD_PER_DEG + 0.001 * 40);
			assert_true(worst(sample.accel_m_s2,
					    sensor_specific_force(&truth, w->config.sensor.lever_arm_b_m, 9.81)) <
				    DIGITS[i].accel_g * STANDARD_GRAVITY_M_S2 + 0.0001 * 300);
			if (sample.flags & SAMPLE_MAG)
				assert_true(worst(sample.mag_uT, quat_rotate_inverse(truth.q_nb,
									 w->config.sensor.field_n_uT)) < 0.4);
		}
		world_free(w);
	}
}

/* The delay [s] that fits the gyro of n samples best. */
static double delay_of(struct world *w, int n)
{
	double late = 0, alpha = 0;
	struct imu_sample sample;

	for (int i = 0; i < n; i++) {
		struct signal_truth truth;

		assert_true(world_sample(w, &sample, 300000));
		truth = world_truth(w, &sample);
		late += vec3_dot(vec3_sub(truth.omega_b_rad_s, sample.gyro_rad_s), truth.alpha_b_rad_s2);
		alpha += vec3_dot(truth.alpha_b_rad_s2, truth.alpha_b_rad_s2);
	}
	return late / alpha;
}

static void test_through_a_stub_samples_have_their_rate_and_their_time_within_a_millisecond(void **state)
{
	const struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	static struct i2c_stub stub;

	(void)state;
	for (int i = 0; i < STUB_COUNT; i++) {
		struct world *w = world_make(BOARDS[i], "tumble", true);
		double delay_s;

		world_detect(w); /* sets its clock */
		stub_begin(&stub, w);
		world_set_up(w, &settings, false);
		delay_of(w, 200);
		delay_s = delay_of(w, 600);
		if (fabs(delay_s) > 0.001 ||
			fabs((double)w->board.health.rate_hz - 1.013 * w->board.gyro->setup.rate->hz) > 0.2)
			fail_msg(
				"%s: %.2f ms late, %.2f Hz", BOARDS[i], 1e3 * delay_s, (double)w->board.health.rate_hz);
		world_free(w);
	}
}

/* How far the time of a sample is from an instant at which the gyro took one, in samples. */
static double time_error(struct world *w, const struct imu_sample *sample, double rate_hz)
{
	double newest_ns, n;

	sim_board_taken(w->sim, IMU_CHIP_GYRO, &newest_ns);
	n = (1e3 * (double)sample->t_us + 500 - newest_ns) * 1e-9 * rate_hz * 1.013;
	return fabs(n - floor(n + 0.5));
}

static void test_late_reads_do_not_change_the_time_stamps(void **state)
{
	const double rates[] = {100, 200, 400, 800};

	(void)state;
	for (int i = 0; i < 4; i++)
		for (int64_t late_ms = 0; late_ms <= 12; late_ms += 4) {
			struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
			struct world *w = world_make("v3", "tumble", false);
			struct imu_sample sample;
			uint64_t last_us = 0;

			settings.rate_hz = rates[i];
			world_detect(w);
			world_set_up(w, &settings, true);
			w->late_ns = late_ms * 1000000;
			for (int n = 0; n < 6 * rates[i]; n++) {
				double interval;

				assert_true(world_sample(w, &sample, 500000));
				interval = 1e-6 * (double)(sample.t_us - last_us) * rates[i] * 1.013;
				last_us = sample.t_us;
				if (n < 2 * rates[i])
					continue;
				if (time_error(w, &sample, rates[i]) > 0.1)
					fail_msg("%g Hz, %d ms late: sample %d off by %g", rates[i], (int)late_ms, n,
						time_error(w, &sample, rates[i]));
				assert_true(fabs(interval - 1) < 0.1); /* no sample is missing */
			}
			world_free(w);
		}
}

static void test_a_stall_longer_than_the_fifo_is_counted_and_times_stay_right(void **state)
{
	(void)state;
	for (int i = 2; i < BOARD_COUNT; i++) {
		struct world *w = world_new(BOARDS[i], "tumble", false);
		struct imu_sample sample;
		const double nominal_hz = w->board.gyro->setup.rate->hz;

		world_run(w, 3000000);
		w->now_ns += 6000000000;
		world_run(w, 1000000);
		assert_true(w->board.health.overruns > 0);
		for (int n = 0; n < 100; n++) {
			assert_true(world_sample(w, &sample, 200000));
			assert_true(time_error(w, &sample, nominal_hz) < 0.1);
		}
		world_free(w);
	}
}

/* The FIFOs of the L3GD20, L3GD20H and LSM303 hold 32 sets; the oldest are overwritten. A set of the gyro is a sample
 * if there is an acceleration of its time, and the accelerometer measures at 400 Hz: 32 sets are 80 ms. */
static void test_after_a_stall_the_newest_sets_with_an_acceleration_become_samples(void **state)
{
	(void)state;
	for (int i = 2; i <= 3; i++) {
		struct world *w = world_new(BOARDS[i], "tumble", false);
		struct imu_sample sample;
		int n = 0;

		world_run(w, 3000000);
		w->now_ns += 1000000000;
		board_step(&w->board);
		while (board_next(&w->board, &sample))
			n++;
		assert_in_range(n, 7, 9);
		assert_true(1000 * (int64_t)sample.t_us > w->now_ns - 20000000);
		world_free(w);
	}
}

/* The FIFOs of LSM6DS33, LSM6DSO and ICM-42688-P hold 682, 256 and 128 sets, read 32 at a time. */
static void test_after_a_stall_shorter_than_the_fifo_no_sample_is_missing_and_the_delay_is_made_up(void **state)
{
	static const struct {
		const char *board;
		int64_t stall_ms;
		double hz;
	} stalls[] = {{"v5", 5000, 104}, {"v6", 2000, 104}, {"icm42688", 1000, 100}, {"icm20948", 350, 1125 / 11.},
		{"bmi270", 1000, 100}, {"lsm9ds1", 200, 119}};

	(void)state;
	for (int i = 0; i < 6; i++) {
		struct world *w = world_new(stalls[i].board, "rest", false);
		struct imu_sample sample;
		uint64_t last_us;

		world_run(w, 3000000);
		assert_true(world_sample(w, &sample, 100000));
		last_us = sample.t_us;
		w->now_ns += stalls[i].stall_ms * 1000000;
		for (int n = 0; n < (int)(1.1e-3 * (double)stalls[i].stall_ms * stalls[i].hz) + 20; n++) {
			assert_true(world_sample(w, &sample, 100000));
			if (!(fabs(1e-6 * (double)(sample.t_us - last_us) * stalls[i].hz * 1.013 - 1) < 0.1))
				fail_msg("%s: sample %d %.1f ms after the one before", stalls[i].board, n,
					1e-3 * (double)(sample.t_us - last_us));
			last_us = sample.t_us;
		}
		if (!w->board.mag) /* which has no FIFO */
			assert_int_equal(w->board.health.overruns, 0);
		assert_true(1000 * (int64_t)sample.t_us > w->now_ns - 30000000);
		world_free(w);
	}
}

/* The acceleration of a sample whose own reading is missing would be a chord across the gap: the sample is missing
 * then, too. */
static void test_after_a_stall_each_acceleration_is_that_of_its_sample(void **state)
{
	(void)state;
	for (int i = 0; i < BOARD_COUNT; i++)
		for (int64_t stall_ms = 20; stall_ms <= 640; stall_ms += 20) {
			struct world *w = world_new(BOARDS[i], "tumble", true);
			struct imu_sample sample;

			world_run(w, 2000000 + stall_ms * 1300);
			w->now_ns += stall_ms * 1000000;
			for (int n = 0; n < 40; n++) {
				struct signal_truth truth;
				double off_m_s2;

				assert_true(world_sample(w, &sample, 700000));
				truth = world_truth(w, &sample);
				off_m_s2 = worst(sample.accel_m_s2,
					sensor_specific_force(&truth, w->config.sensor.lever_arm_b_m, 9.81));
				if (off_m_s2 > 0.4)
					fail_msg("%s, stall of %d ms: sample %d is off by %.2f m/s^2", BOARDS[i],
						(int)stall_ms, n, off_m_s2);
			}
			world_free(w);
		}
}

/* What the FIFO holds then begins within a packet (ICM-20948) or with another kind of frame (BMI270). */
static void test_after_an_overflow_the_values_are_still_those_of_their_axes(void **state)
{
	static const char *const boards[] = {
		"icm20948", "icm20948/spi", "icm42688", "bmi270", "bmi270/spi", "v5", "lsm9ds1"};

	(void)state;
	for (int i = 0; i < 7; i++) {
		struct world *w = world_new(boards[i], "rest", false);
		struct imu_sample sample;

		world_run(w, 2000000);
		w->now_ns += 7000000000;
		for (int n = 0; n < 500; n++) {
			assert_true(world_sample(w, &sample, 100000));
			if (!(vec3_norm(vec3_sub(sample.accel_m_s2, (struct vec3){0, 0, 9.81})) < 0.3 &&
				    vec3_norm(sample.gyro_rad_s) < 0.05))
				fail_msg("%s, sample %d: %g %g %g", boards[i], n, sample.accel_m_s2.x,
					sample.accel_m_s2.y, sample.accel_m_s2.z);
		}
		assert_int_equal(w->board.health.restarts, 0);
		assert_true(w->board.health.overruns > 0);
		world_free(w);
	}
}

/* As a program leaves it that was ended while it wrote the registers of bank 2. */
static void test_an_icm20948_is_found_in_any_bank(void **state)
{
	(void)state;
	for (uint8_t bank = 0; bank < 4; bank++)
		for (int spi = 0; spi < 2; spi++) {
			struct world *w = world_make(spi ? "icm20948/spi" : "icm20948", "rest", false);

			assert_int_equal(
				i2c_write(w->bus, sim_board_address(w->sim, IMU_CHIP_GYRO), 0x7F, (uint8_t)(bank << 4)),
				0);
			world_detect(w);
			assert_string_equal(w->board.gyro->chip->name, "ICM-20948");
			world_free(w);
		}
}

static size_t fifo_bytes;

/* The windows of the FIFOs of the LSM6DS33 and LSM6DSO. */
static int count_fifo_bytes(struct world *w, const struct sim_access *access)
{
	(void)w;
	if (!access->write && access->address == 0x6B && (access->sub == 0x3E || access->sub == 0x78))
		fifo_bytes += access->n;
	return 0;
}

/* 32 sets of twelve bytes; with tags, 64 entries of seven. The rest is for the next time. */
static void test_a_long_fifo_is_read_32_sets_at_a_time(void **state)
{
	(void)state;
	for (int i = 4; i <= 5; i++) {
		struct world *w = world_new(BOARDS[i], "rest", false);

		world_run(w, 3000000);
		w->now_ns += 600000000;
		fifo_bytes = 0;
		w->before = count_fifo_bytes;
		board_step(&w->board);
		assert_int_equal(fifo_bytes, i == 4 ? 32 * 12 : 64 * 7);
		world_free(w);
	}
}

static void test_the_rate_is_measured(void **state)
{
	struct world *w = world_new("v3", "rest", false);

	(void)state;
	world_run(w, 5000000);
	assert_true(fabs((double)w->board.health.rate_hz - 101.3) < 0.1);
	world_free(w);
}

/* The largest error of the time stamps of 100 samples [samples], after 100 more, when each wake-up comes up to 12 ms
 * late; with `edges` the data-ready line reports each sample of the gyro 20 us after it was taken. */
static double worst_time_error(bool edges)
{
	const struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	struct world *w = world_make("v3", "tumble", false);
	struct imu_sample sample;
	double newest_ns, last_ns = 0, worst_error = 0;

	world_detect(w);
	world_set_up(w, &settings, false);
	w->late_ns = 12000000;
	for (int n = 0; n < 200; n++) {
		assert_true(world_sample(w, &sample, 200000));
		sim_board_taken(w->sim, IMU_CHIP_GYRO, &newest_ns);
		if (edges && newest_ns > last_ns)
			board_data_ready(&w->board, (int64_t)newest_ns + 20000);
		last_ns = newest_ns;
		if (n >= 100)
			worst_error = fmax(worst_error, time_error(w, &sample, 100));
	}
	world_free(w);
	return worst_error;
}

static void test_data_ready_edges_give_times_that_late_reads_alone_do_not(void **state)
{
	(void)state;
	/* the edge is taken to be up to 0.1 ms before its interrupt: the middle is 30 us from the truth */
	assert_true(worst_time_error(true) < 0.005);
	assert_true(worst_time_error(false) > 0.03);
}

static void test_a_sample_has_the_temperature_once_a_second(void **state)
{
	const char *const with[] = {"v0", "v3", "v5", "v6", "lsm9ds1", "icm20948", "icm42688", "bmi270", "bmi270/spi"};

	(void)state;
	for (int i = 0; i < 9; i++) {
		struct world *w = world_new(with[i], "rest", false);
		struct imu_sample sample;
		int count = 0;

		while (w->now_ns < w->start_ns + 5000000000) {
			assert_true(world_sample(w, &sample, START_US));
			if (!(sample.flags & SAMPLE_TEMPERATURE))
				continue;
			assert_true(fabs(sample.temperature_degC - 30) < 0.01);
			count++;
		}
		assert_in_range(count, 4, 6);
		world_free(w);
	}
}

/* ---- settings ---------------------------------------------------------------------------------------------------- */

static void assert_impossible(const char *board, const struct imu_settings *settings, const char *expected)
{
	struct world *w = world_make(board, "rest", true);
	struct board_plan plan;
	char why[200] = "";

	world_detect(w);
	assert_int_equal(board_plan(&w->board, settings, false, false, &plan, why, sizeof why), -EINVAL);
	assert_string_equal(why, expected);
	world_free(w);
}

static void test_settings_that_the_chips_do_not_support_are_refused_with_the_limit(void **state)
{
	struct imu_settings settings = IMU_SETTINGS_DEFAULTS;

	(void)state;
	settings.rate_hz = 1000;
	assert_impossible("v3", &settings, "sensor rate 1000 Hz: the L3GD20H has at most 800 Hz");
	settings = IMU_SETTINGS_DEFAULTS;
	settings.gyro_range_deg_s = 4000;
	assert_impossible("v0", &settings, "gyro range 4000 deg/s: the L3G4200D has at most 2000");
	settings = IMU_SETTINGS_DEFAULTS;
	settings.accel_range_g = 16;
	assert_impossible("v1", &settings, "accelerometer range 16 g: the LSM303DLH has at most 8");
	settings = IMU_SETTINGS_DEFAULTS;
	settings.mag_range_uT = 1300;
	assert_impossible("v3", &settings, "magnetometer range 1300 uT: the LSM303D has at most 1200");
	settings.mag_range_uT = NAN;
	assert_impossible("v3", &settings, "magnetometer range nan uT: the LSM303D has at most 1200");
}

static void test_the_smallest_values_that_are_enough_are_chosen(void **state)
{
	struct imu_settings settings = {
		.rate_hz = 150, .gyro_range_deg_s = 250, .accel_range_g = 3, .mag_range_uT = 250};
	struct world *w = world_make("v3", "rest", true);
	struct board_plan plan;
	char why[200];

	(void)state;
	settings.bandwidth_hz = 40;
	world_detect(w);
	assert_int_equal(board_plan(&w->board, &settings, false, false, &plan, why, sizeof why), 0);
	assert_true(plan.rate_hz == 200);
	assert_true(plan.setup[0].range[0]->full_scale == 245); /* near enough to 250 */
	assert_true(plan.setup[0].bandwidth_hz == 70);
	assert_true(plan.setup[1].range[0]->full_scale == 4);
	assert_true(plan.setup[1].bandwidth_hz == 50);
	assert_true(plan.setup[2].range[0]->full_scale == 400);
	world_free(w);
}

/* deg/s, g and uT, from the data sheets. */
static void test_each_full_scale_of_the_data_sheets_can_be_chosen(void **state)
{
	static const struct {
		const char *board;
		enum imu_chip chip;
		int stream, triad;
		double full_scales[8];
	} tables[] = {
		{"v0", IMU_CHIP_GYRO, 0, 0, {250, 500, 2000}},
		{"v0", IMU_CHIP_ACCEL, 1, 0, {2, 4, 8}},
		{"v0", IMU_CHIP_MAG, 2, 0, {130, 190, 250, 400, 470, 560, 810}},
		{"v2", IMU_CHIP_GYRO, 0, 0, {250, 500, 2000}},
		{"v2", IMU_CHIP_ACCEL, 1, 0, {2, 4, 8, 16}},
		{"v2", IMU_CHIP_MAG, 2, 0, {130, 190, 250, 400, 470, 560, 810}},
		{"v3", IMU_CHIP_GYRO, 0, 0, {245, 500, 2000}},
		{"v3", IMU_CHIP_ACCEL, 1, 0, {2, 4, 6, 8, 16}},
		{"v3", IMU_CHIP_MAG, 2, 0, {200, 400, 800, 1200}},
		{"v5", IMU_CHIP_GYRO, 0, 0, {125, 250, 500, 1000, 2000}},
		{"v5", IMU_CHIP_ACCEL, 0, 1, {2, 4, 8, 16}},
		{"v5", IMU_CHIP_MAG, 1, 0, {400, 800, 1200, 1600}},
		{"lsm9ds1", IMU_CHIP_GYRO, 0, 0, {245, 500, 2000}},
		{"lsm9ds1", IMU_CHIP_ACCEL, 0, 1, {2, 4, 8, 16}},
		{"lsm9ds1", IMU_CHIP_MAG, 1, 0, {400, 800, 1200, 1600}},
		{"icm20948", IMU_CHIP_GYRO, 0, 0, {250, 500, 1000, 2000}},
		{"icm20948", IMU_CHIP_ACCEL, 0, 1, {2, 4, 8, 16}},
		{"icm20948", IMU_CHIP_MAG, 1, 0, {4912}},
		{"icm42688", IMU_CHIP_GYRO, 0, 0, {125, 250, 500, 1000, 2000}},
		{"icm42688", IMU_CHIP_ACCEL, 0, 1, {2, 4, 8, 16}},
		{"bmi270", IMU_CHIP_GYRO, 0, 0, {125, 250, 500, 1000, 2000}},
		{"bmi270", IMU_CHIP_ACCEL, 0, 1, {2, 4, 8, 16}},
	};

	(void)state;
	for (size_t i = 0; i < sizeof tables / sizeof *tables; i++)
		for (int k = 0; k < 8 && tables[i].full_scales[k] > 0; k++) {
			struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
			struct world *w = world_make(tables[i].board, "rest", true);
			struct board_plan plan;
			char why[200];

			*(tables[i].chip == IMU_CHIP_GYRO	   ? &settings.gyro_range_deg_s
				: tables[i].chip == IMU_CHIP_ACCEL ? &settings.accel_range_g
								   : &settings.mag_range_uT) = tables[i].full_scales[k];
			world_detect(w);
			assert_int_equal(board_plan(&w->board, &settings, false, false, &plan, why, sizeof why), 0);
			assert_true(fabs(plan.setup[tables[i].stream].range[tables[i].triad]->full_scale -
					    tables[i].full_scales[k]) < 1e-6);
			world_free(w);
		}
}

/* Bits BW of CTRL1, from the tables of the data sheets; the first code of several with the same bandwidth. */
static void test_each_bandwidth_of_a_gyro_has_the_code_of_the_data_sheets(void **state)
{
	static const struct {
		const char *board;
		double rate_hz;
		double bandwidths_hz[9]; /* by code, ends with 0; -1: not in the table, or as another one */
	} tables[] = {
		{"v0", 100, {12.5, 25, 0}},
		{"v0", 200, {12.5, 25, 50, 70, 0}},
		{"v0", 400, {20, 25, 50, 110, 0}},
		{"v0", 800, {30, 35, 50, 110, 0}},
		{"v2", 95, {12.5, 25, 0}},
		{"v2", 190, {12.5, 25, 50, 70, 0}},
		{"v2", 380, {20, 25, 50, 100, 0}},
		{"v2", 760, {30, 35, 50, 100, 0}},
		{"v3", 100, {12.5, 25, 0}},
		{"v3", 200, {12.5, -1, -1, 70, 0}},
		{"v3", 400, {20, 25, 50, 110, 0}},
		{"v3", 800, {30, 35, -1, 100, 0}},
		{"lsm9ds1", 119, {14, 31, 0}},
		{"lsm9ds1", 238, {14, 29, 63, 78, 0}},
		{"lsm9ds1", 476, {21, 28, 57, 100, 0}},
		{"lsm9ds1", 952, {33, 40, 58, 100, 0}},
		{"icm20948", 225, {196.6, 151.8, 119.5, 51.2, 23.9, 11.6, 5.7, 361.4, 0}},
		{"icm42688", 100, {50, 100, 80, -1, 40, 25, 20, 10, 0}}, /* ODR / 2; 400 Hz / 4, 5, 8, 10, 16, 20, 40 */
		{"icm42688", 50, {25, 100, 80, 50, 40, -1, 20, 10, 0}},
		{"icm42688", 200, {100, -1, 80, 50, 40, 25, 20, 10, 0}},
		{"icm42688", 500, {250, 125, 100, 62.5, 50, 31.25, 25, 12.5, 0}},
		{"icm42688", 1000, {500, 250, 200, 125, 100, 62.5, 50, 25, 0}},
		{"icm42688", 2000, {1000, 500, 400, 250, 200, 125, 100, 50, 0}},
	};

	(void)state;
	for (size_t i = 0; i < sizeof tables / sizeof *tables; i++)
		for (int code = 0; tables[i].bandwidths_hz[code] != 0; code++) {
			struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
			struct world *w = world_make(tables[i].board, "rest", true);
			struct board_plan plan;
			char why[200];

			settings.rate_hz = tables[i].rate_hz;
			settings.bandwidth_hz = tables[i].bandwidths_hz[code];
			world_detect(w);
			assert_int_equal(board_plan(&w->board, &settings, false, false, &plan, why, sizeof why), 0);
			if (settings.bandwidth_hz > 0) {
				assert_int_equal(plan.setup[0].bandwidth_code, code);
				assert_true(plan.setup[0].bandwidth_hz == settings.bandwidth_hz);
			}
			world_free(w);
		}
}

struct expected_register {
	const char *board;
	enum imu_chip chip;
	uint16_t address; /* 201h: register 1 of bank 2 */
	uint8_t value;
};

static void assert_register(const struct world *w, const struct expected_register *e)
{
	uint8_t value = e->address < 0x100 ? sim_board_registers(w->sim, e->chip)[e->address]
					   : sim_board_bank(w->sim, e->chip, e->address >> 8)[e->address & 0x7F];

	if (value != e->value)
		fail_msg("%s, chip %d: register %02Xh is %02Xh, not %02Xh", e->board, e->chip, e->address, value,
			e->value);
}

/* As a program that used the chip before may have done. */
static void leave_another_value(const struct world *w, const struct expected_register *e)
{
	const uint8_t address = sim_board_address(w->sim, e->chip);

	if (e->address >= 0x100)
		assert_int_equal(i2c_write(w->bus, address, 0x7F, (uint8_t)(e->address >> 8 << 4)), 0);
	assert_int_equal(i2c_write(w->bus, address, (uint8_t)e->address, (uint8_t)~e->value), 0);
}

/* Control registers as the data sheets' tables give them for 100 Hz, 2000 deg/s, 8 g, the finest field range: whatever
 * they were before. */
static void test_the_registers_have_the_values_of_the_data_sheets(void **state)
{
	static const struct expected_register expected[] = {
		{"v0", IMU_CHIP_GYRO, 0x20, 0x1F},				     /* 100 Hz, 25 Hz, on, all axes */
		{"v0", IMU_CHIP_GYRO, 0x23, 0xA0},				     /* BDU, 2000 deg/s */
		{"v0", IMU_CHIP_GYRO, 0x2E, 0x40},				     /* stream */
		{"v0", IMU_CHIP_ACCEL, 0x20, 0x37},				     /* normal, 400 Hz */
		{"v0", IMU_CHIP_ACCEL, 0x23, 0xB0},				     /* BDU, 8 g */
		{"v0", IMU_CHIP_MAG, 0x00, 0x18},				     /* 75 Hz */
		{"v0", IMU_CHIP_MAG, 0x01, 0x20},				     /* 1.3 gauss */
		{"v0", IMU_CHIP_MAG, 0x02, 0x00}, {"v0", IMU_CHIP_GYRO, 0x21, 0x00}, /* no high-pass */
		{"v0", IMU_CHIP_GYRO, 0x24, 0x42},				     /* FIFO, output behind LPF2 */
		{"v2", IMU_CHIP_ACCEL, 0x20, 0x77},				     /* 400 Hz */
		{"v2", IMU_CHIP_ACCEL, 0x23, 0xA8},				     /* BDU, 8 g, high resolution */
		{"v2", IMU_CHIP_ACCEL, 0x24, 0x40}, {"v2", IMU_CHIP_ACCEL, 0x2E, 0x80},
		{"v3", IMU_CHIP_GYRO, 0x39, 0x00}, {"v3", IMU_CHIP_ACCEL, 0x20, 0x8F}, /* 400 Hz, BDU */
		{"v3", IMU_CHIP_ACCEL, 0x21, 0xD8},				       /* 50 Hz, 8 g */
		{"v3", IMU_CHIP_MAG, 0x24, 0xF0}, /* temperature, high resolution, 50 Hz */
		{"v3", IMU_CHIP_MAG, 0x25, 0x00}, {"v5", IMU_CHIP_GYRO, 0x11, 0x4C}, /* 104 Hz, 2000 deg/s */
		{"v5", IMU_CHIP_GYRO, 0x10, 0x4C},				     /* 104 Hz, 8 g */
		{"v3", IMU_CHIP_GYRO, 0x24, 0x42}, {"v3", IMU_CHIP_GYRO, 0x2E, 0x40},
		{"v3", IMU_CHIP_ACCEL, 0x1F, 0x40},				      /* FIFO */
		{"v3", IMU_CHIP_ACCEL, 0x2E, 0x40}, {"v3", IMU_CHIP_MAG, 0x26, 0x00}, /* continuous */
		{"v5", IMU_CHIP_GYRO, 0x12, 0x44},				    /* BDU, auto-increment, no reset */
		{"v5", IMU_CHIP_GYRO, 0x14, 0x00},				    /* no self-test */
		{"v5", IMU_CHIP_GYRO, 0x0D, 0x00},				    /* no interrupt */
		{"v5", IMU_CHIP_MAG, 0x21, 0x00},				    /* 4 gauss */
		{"v5", IMU_CHIP_MAG, 0x22, 0x00},				    /* continuous */
		{"v5", IMU_CHIP_MAG, 0x23, 0x0C}, {"v5", IMU_CHIP_MAG, 0x24, 0x40}, /* BDU */
		{"v6", IMU_CHIP_GYRO, 0x12, 0x44}, {"v5", IMU_CHIP_GYRO, 0x08, 0x09}, {"v5", IMU_CHIP_GYRO, 0x0A, 0x26},
		{"v5", IMU_CHIP_MAG, 0x20, 0xFC}, /* 80 Hz, ultra-high performance */
		{"v6", IMU_CHIP_GYRO, 0x09, 0x44}, {"v6", IMU_CHIP_GYRO, 0x0A, 0x06},
		{"lsm9ds1", IMU_CHIP_GYRO, 0x10, 0x79}, /* 119 Hz, 2000 deg/s, 31 Hz */
		{"lsm9ds1", IMU_CHIP_GYRO, 0x11, 0x02}, /* output behind LPF2 */
		{"lsm9ds1", IMU_CHIP_GYRO, 0x20, 0x78}, /* 119 Hz, 8 g */
		{"lsm9ds1", IMU_CHIP_GYRO, 0x22, 0x44}, /* BDU, auto-increment */
		{"lsm9ds1", IMU_CHIP_GYRO, 0x23, 0x02}, /* FIFO */
		{"lsm9ds1", IMU_CHIP_GYRO, 0x2E, 0xC0}, /* continuous */
		{"lsm9ds1", IMU_CHIP_MAG, 0x20, 0xFC}, {"lsm9ds1", IMU_CHIP_MAG, 0x21, 0x00},
		{"lsm9ds1", IMU_CHIP_MAG, 0x22, 0x00}, {"lsm9ds1/spi", IMU_CHIP_GYRO, 0x23, 0x06}, /* and no I2C */
		{"icm20948", IMU_CHIP_GYRO, 0x06, 0x01},  /* awake, best clock */
		{"icm20948", IMU_CHIP_GYRO, 0x03, 0x40},  /* FIFO, no I2C master */
		{"icm20948", IMU_CHIP_GYRO, 0x0F, 0x02},  /* bypass to the AK09916 */
		{"icm20948", IMU_CHIP_GYRO, 0x67, 0x1E},  /* accelerometer and gyro into the FIFO */
		{"icm20948", IMU_CHIP_GYRO, 0x7F, 0x00},  /* bank 0 is left selected */
		{"icm20948", IMU_CHIP_GYRO, 0x200, 10},	  /* 1125 Hz / 11 */
		{"icm20948", IMU_CHIP_GYRO, 0x201, 0x1F}, /* 51.2 Hz, 2000 deg/s, filter on */
		{"icm20948", IMU_CHIP_GYRO, 0x211, 10},
		{"icm20948", IMU_CHIP_GYRO, 0x214, 0x1D}, /* 50.4 Hz, 8 g, filter on */
		{"icm20948", IMU_CHIP_MAG, 0x31, 0x08},	  /* 100 Hz */
		{"icm20948/spi", IMU_CHIP_GYRO, 0x03, 0x50},
		{"icm42688", IMU_CHIP_GYRO, 0x4E, 0x0F}, /* both in low-noise mode */
		{"icm42688", IMU_CHIP_GYRO, 0x4F, 0x08}, /* 2000 deg/s, 100 Hz */
		{"icm42688", IMU_CHIP_GYRO, 0x50, 0x28}, /* 8 g, 100 Hz */
		{"icm42688", IMU_CHIP_GYRO, 0x52, 0x00}, /* half the rate */
		{"icm42688", IMU_CHIP_GYRO, 0x4C, 0x30}, /* big-endian, count in bytes */
		{"icm42688", IMU_CHIP_GYRO, 0x16, 0x40}, /* FIFO: stream */
		{"icm42688", IMU_CHIP_GYRO, 0x5F, 0x07}, {"icm42688/spi", IMU_CHIP_GYRO, 0x4C, 0x33},
		{"bmi270", IMU_CHIP_GYRO, 0x7C, 0x02}, /* no power saving */
		{"bmi270", IMU_CHIP_GYRO, 0x7D, 0x0E}, /* gyro, accelerometer, temperature */
		{"bmi270", IMU_CHIP_GYRO, 0x40, 0xA8}, /* performance, normal, 100 Hz */
		{"bmi270", IMU_CHIP_GYRO, 0x41, 0x02}, /* 8 g */
		{"bmi270", IMU_CHIP_GYRO, 0x42, 0xE8}, {"bmi270", IMU_CHIP_GYRO, 0x43, 0x00}, /* 2000 deg/s */
		{"bmi270", IMU_CHIP_GYRO, 0x49, 0xD0},					      /* FIFO with headers */
		/* no data-ready signal, no high-pass, no self-test */
		{"v0", IMU_CHIP_GYRO, 0x22, 0x00}, {"v0", IMU_CHIP_ACCEL, 0x21, 0x00},
		{"v0", IMU_CHIP_ACCEL, 0x22, 0x00}, {"v2", IMU_CHIP_ACCEL, 0x21, 0x00},
		{"v2", IMU_CHIP_ACCEL, 0x22, 0x00}, {"v3", IMU_CHIP_ACCEL, 0x22, 0x00},
		{"v6", IMU_CHIP_GYRO, 0x0D, 0x00}, {"v6", IMU_CHIP_GYRO, 0x14, 0x00},
		{"lsm9ds1", IMU_CHIP_GYRO, 0x0C, 0x00}, {"lsm9ds1", IMU_CHIP_GYRO, 0x24, 0x00},
		{"icm20948", IMU_CHIP_GYRO, 0x10, 0x00}, {"icm20948", IMU_CHIP_GYRO, 0x11, 0x00},
		{"icm20948", IMU_CHIP_GYRO, 0x05, 0x00},  /* no duty cycles */
		{"icm20948", IMU_CHIP_GYRO, 0x07, 0x00},  /* all axes */
		{"icm20948", IMU_CHIP_GYRO, 0x69, 0x00},  /* FIFO: stream */
		{"icm20948", IMU_CHIP_GYRO, 0x209, 0x01}, /* both start together */
		{"icm20948", IMU_CHIP_GYRO, 0x210, 0x00}, {"icm42688", IMU_CHIP_GYRO, 0x64, 0x00},
		{"icm42688", IMU_CHIP_GYRO, 0x65, 0x00}, {"icm42688", IMU_CHIP_GYRO, 0x76, 0x00}, /* bank 0 */
		{"icm42688", IMU_CHIP_GYRO, 0x14, 0x03}, /* INT1: pulses, push-pull, active high */
		{"bmi270", IMU_CHIP_GYRO, 0x6D, 0x00}, {"bmi270", IMU_CHIP_GYRO, 0x53, 0x00},
		{"bmi270", IMU_CHIP_GYRO, 0x58, 0x00}, {"bmi270", IMU_CHIP_GYRO, 0x45, 0x88}, /* FIFO: filtered */
		{"bmi270", IMU_CHIP_GYRO, 0x48, 0x00}, /* the oldest are overwritten, no times */
	};

	(void)state;
	for (size_t i = 0; i < sizeof expected / sizeof *expected; i++) {
		struct world *w = world_new(expected[i].board, "rest", false);

		leave_another_value(w, &expected[i]);
		world_run(w, START_US);
		assert_register(w, &expected[i]);
		world_free(w);
	}
}

/* The same without FIFO, and with the gyro's data-ready signal. */
static void test_without_fifo_and_with_data_ready_the_registers_have_the_values_of_the_data_sheets(void **state)
{
	static const struct expected_register expected[] = {
		{"v0", IMU_CHIP_GYRO, 0x22, 0x08},  /* I2_DRDY */
		{"v0", IMU_CHIP_GYRO, 0x24, 0x02},  /* no FIFO, output behind LPF2 */
		{"v0", IMU_CHIP_GYRO, 0x2E, 0x00},  /* bypass */
		{"v0", IMU_CHIP_ACCEL, 0x22, 0x00}, /* the gyro's only */
		{"v2", IMU_CHIP_GYRO, 0x22, 0x08},
		{"v2", IMU_CHIP_ACCEL, 0x22, 0x00},
		{"v2", IMU_CHIP_ACCEL, 0x24, 0x00},
		{"v2", IMU_CHIP_ACCEL, 0x2E, 0x00},
		{"v3", IMU_CHIP_GYRO, 0x22, 0x08},
		{"v3", IMU_CHIP_ACCEL, 0x1F, 0x00},
		{"v3", IMU_CHIP_ACCEL, 0x22, 0x00},
		{"v3", IMU_CHIP_ACCEL, 0x2E, 0x00},
		{"v5", IMU_CHIP_GYRO, 0x0D, 0x02}, /* INT1_DRDY_G */
		{"v5", IMU_CHIP_GYRO, 0x08, 0x00},
		{"v5", IMU_CHIP_GYRO, 0x0A, 0x00},
		{"v6", IMU_CHIP_GYRO, 0x0D, 0x02},
		{"v6", IMU_CHIP_GYRO, 0x09, 0x00},
		{"v6", IMU_CHIP_GYRO, 0x0A, 0x00},
		{"lsm9ds1", IMU_CHIP_GYRO, 0x0C, 0x02}, /* DRDY_G */
		{"lsm9ds1", IMU_CHIP_GYRO, 0x23, 0x00},
		{"lsm9ds1", IMU_CHIP_GYRO, 0x2E, 0x00},
		{"icm20948", IMU_CHIP_GYRO, 0x11, 0x01}, /* RAW_DATA_0_RDY_EN */
		{"icm20948", IMU_CHIP_GYRO, 0x67, 0x00},
		{"icm42688", IMU_CHIP_GYRO, 0x65, 0x08}, /* UI_DRDY_INT1_EN */
		{"icm42688", IMU_CHIP_GYRO, 0x64, 0x00}, /* INT_ASYNC_RESET */
		{"icm42688", IMU_CHIP_GYRO, 0x16, 0x00},
		{"bmi270", IMU_CHIP_GYRO, 0x53, 0x0A}, /* INT1 is an output, active high */
		{"bmi270", IMU_CHIP_GYRO, 0x58, 0x04}, /* data ready on INT1 */
		{"bmi270", IMU_CHIP_GYRO, 0x49, 0x10},
	};
	const struct imu_settings settings = IMU_SETTINGS_DEFAULTS;

	(void)state;
	for (size_t i = 0; i < sizeof expected / sizeof *expected; i++) {
		struct world *w = world_make(expected[i].board, "rest", false);
		struct board_plan plan;
		char why[200];

		world_detect(w);
		assert_int_equal(board_plan(&w->board, &settings, true, true, &plan, why, sizeof why), 0);
		board_apply(&w->board, &plan);
		world_run(w, START_US);
		assert_register(w, &expected[i]);
		world_free(w);
	}
}

/* What the data sheets give as the values after power-on: of registers that the driver does not write, it finds
 * these. */
static void test_simulated_chips_have_the_registers_of_the_data_sheets_after_power_on(void **state)
{
	static const struct expected_register expected[] = {
		{"v0", IMU_CHIP_GYRO, 0x0F, 0xD3},
		{"v0", IMU_CHIP_GYRO, 0x20, 0x07},
		{"v0", IMU_CHIP_ACCEL, 0x20, 0x07},
		{"v0", IMU_CHIP_MAG, 0x00, 0x10},
		{"v0", IMU_CHIP_MAG, 0x01, 0x20},
		{"v0", IMU_CHIP_MAG, 0x02, 0x03},
		{"v0", IMU_CHIP_MAG, 0x0A, 'H'},
		{"v0", IMU_CHIP_MAG, 0x0B, '4'},
		{"v0", IMU_CHIP_MAG, 0x0C, '3'},
		{"v1", IMU_CHIP_MAG, 0x0F, 0x3C},
		{"v2", IMU_CHIP_GYRO, 0x0F, 0xD4},
		{"v2", IMU_CHIP_GYRO, 0x20, 0x07},
		{"v2", IMU_CHIP_ACCEL, 0x20, 0x07},
		{"v3", IMU_CHIP_GYRO, 0x0F, 0xD7},
		{"v3", IMU_CHIP_GYRO, 0x20, 0x07},
		{"v3", IMU_CHIP_ACCEL, 0x0F, 0x49},
		{"v3", IMU_CHIP_ACCEL, 0x20, 0x07},
		{"v3", IMU_CHIP_MAG, 0x24, 0x18},
		{"v3", IMU_CHIP_MAG, 0x25, 0x20},
		{"v3", IMU_CHIP_MAG, 0x26, 0x01},
		{"v5", IMU_CHIP_GYRO, 0x0F, 0x69},
		{"v5", IMU_CHIP_GYRO, 0x12, 0x04},
		{"v5", IMU_CHIP_MAG, 0x0F, 0x3D},
		{"v5", IMU_CHIP_MAG, 0x20, 0x10},
		{"v5", IMU_CHIP_MAG, 0x22, 0x03},
		{"v6", IMU_CHIP_GYRO, 0x0F, 0x6C},
		{"v6", IMU_CHIP_GYRO, 0x12, 0x04},
		{"lsm9ds1", IMU_CHIP_GYRO, 0x0F, 0x68},
		{"lsm9ds1", IMU_CHIP_GYRO, 0x1E, 0x38},
		{"lsm9ds1", IMU_CHIP_GYRO, 0x1F, 0x38},
		{"lsm9ds1", IMU_CHIP_GYRO, 0x22, 0x04},
		{"lsm9ds1", IMU_CHIP_MAG, 0x0F, 0x3D},
		{"lsm9ds1", IMU_CHIP_MAG, 0x20, 0x10},
		{"lsm9ds1", IMU_CHIP_MAG, 0x22, 0x03},
		{"icm20948", IMU_CHIP_GYRO, 0x00, 0xEA},
		{"icm20948", IMU_CHIP_GYRO, 0x05, 0x40},
		{"icm20948", IMU_CHIP_GYRO, 0x06, 0x41},
		{"icm20948", IMU_CHIP_GYRO, 0x201, 0x01},
		{"icm20948", IMU_CHIP_GYRO, 0x214, 0x01},
		{"icm20948", IMU_CHIP_MAG, 0x00, 0x48},
		{"icm20948", IMU_CHIP_MAG, 0x01, 0x09},
		{"icm42688", IMU_CHIP_GYRO, 0x75, 0x47},
		{"icm42688", IMU_CHIP_GYRO, 0x4C, 0x30},
		{"icm42688", IMU_CHIP_GYRO, 0x4F, 0x06},
		{"icm42688", IMU_CHIP_GYRO, 0x50, 0x06},
		{"icm42688", IMU_CHIP_GYRO, 0x64, 0x10},
		{"icm42688", IMU_CHIP_GYRO, 0x65, 0x10},
		{"bmi270", IMU_CHIP_GYRO, 0x00, 0x24},
		{"bmi270", IMU_CHIP_GYRO, 0x40, 0xA8},
		{"bmi270", IMU_CHIP_GYRO, 0x41, 0x02},
		{"bmi270", IMU_CHIP_GYRO, 0x42, 0xA9},
		{"bmi270", IMU_CHIP_GYRO, 0x41, 0x02},
		{"bmi270", IMU_CHIP_GYRO, 0x43, 0x00},
		{"bmi270", IMU_CHIP_GYRO, 0x45, 0x88},
		{"bmi270", IMU_CHIP_GYRO, 0x48, 0x02},
		{"bmi270", IMU_CHIP_GYRO, 0x49, 0x10},
		{"bmi270", IMU_CHIP_GYRO, 0x7C, 0x03},
		{"icm42688", IMU_CHIP_GYRO, 0x52, 0x11},
		{"v2", IMU_CHIP_MAG, 0x02, 0x03},
		{"v2", IMU_CHIP_MAG, 0x0C, '3'},
		{"v2", IMU_CHIP_MAG, 0x0D, 0x00},
	};

	(void)state;
	for (size_t i = 0; i < sizeof expected / sizeof *expected; i++) {
		struct world *w = world_make(expected[i].board, "rest", false);

		assert_register(w, &expected[i]);
		world_free(w);
	}
}

/* Sizes of a digit by the code of the full scale, [mg] and [mdps], from the data sheets. The chip lies, 9.81 m/s^2
 * along z, or turns at 360 deg/s about z; beyond its range a word is at its end. */
static void test_simulated_chips_have_the_digits_of_the_data_sheets(void **state)
{
	static const struct {
		const char *board;
		enum imu_chip chip;
		uint8_t on_at, on;	  /* power */
		uint8_t range_at, others; /* full scale */
		int shift;
		uint8_t data;
		double digits[9]; /* ends with 0 */
	} tables[] = {
		{"v0", IMU_CHIP_ACCEL, 0x20, 0x37, 0x23, 0x80, 4, 0xA8, {1 / 16., 2 / 16., 2 / 16., 3.9 / 16., 0}},
		{"v2", IMU_CHIP_ACCEL, 0x20, 0x57, 0x23, 0x88, 4, 0xA8, {1 / 16., 2 / 16., 4 / 16., 12 / 16., 0}},
		{"v3", IMU_CHIP_ACCEL, 0x20, 0x67, 0x21, 0x00, 3, 0xA8, {0.061, 0.122, 0.183, 0.244, 0.732, 0}},
		{"v5", IMU_CHIP_ACCEL, 0x11, 0x40, 0x10, 0x40, 2, 0x28, {0.061, 0.488, 0.122, 0.244, 0}},
		{"v6", IMU_CHIP_ACCEL, 0x11, 0x40, 0x10, 0x40, 2, 0x28, {0.061, 0.488, 0.122, 0.244, 0}},
		{"v0", IMU_CHIP_GYRO, 0x20, 0x0F, 0x23, 0x80, 4, 0xA8, {8.75, 17.5, 70, 70, 0}},
		{"v2", IMU_CHIP_GYRO, 0x20, 0x0F, 0x23, 0x80, 4, 0xA8, {8.75, 17.5, 70, 70, 0}},
		{"v3", IMU_CHIP_GYRO, 0x20, 0x0F, 0x23, 0x80, 4, 0xA8, {8.75, 17.5, 70, 70, 0}},
		{"v5", IMU_CHIP_GYRO, 0x10, 0x40, 0x11, 0x40, 2, 0x22, {8.75, 17.5, 35, 70, 0}},
		{"v5", IMU_CHIP_GYRO, 0x10, 0x40, 0x11, 0x42, 2, 0x22, {4.375, 0}}, /* FS_125 */
		{"lsm9ds1", IMU_CHIP_ACCEL, 0x10, 0x60, 0x20, 0x60, 3, 0x28, {0.061, 0.732, 0.122, 0.244, 0}},
		{"lsm9ds1", IMU_CHIP_GYRO, 0x20, 0x60, 0x10, 0x60, 3, 0x18, {8.75, 17.5, 0}},
		{"lsm9ds1", IMU_CHIP_GYRO, 0x20, 0x60, 0x10, 0x78, 3, 0x18, {70, 0}},
		{"icm42688", IMU_CHIP_ACCEL, 0x4E, 0x0F, 0x50, 0x08, 5, 0x1F,
			{1e3 / 2048, 1e3 / 4096, 1e3 / 8192, 1e3 / 16384, 0}},
		{"icm42688", IMU_CHIP_GYRO, 0x4E, 0x0F, 0x4F, 0x08, 5, 0x25,
			{1e3 / 16.4, 1e3 / 32.8, 1e3 / 65.5, 1e3 / 131, 0}},
	};

	(void)state;
	for (size_t i = 0; i < sizeof tables / sizeof *tables; i++)
		for (unsigned code = 0; tables[i].digits[code] > 0; code++) {
			const bool gyro = tables[i].chip == IMU_CHIP_GYRO,
				   big = strcmp(tables[i].board, "icm42688") == 0;
			struct world *w = world_make(tables[i].board, gyro ? "turntable" : "rest", true);
			const uint8_t address = sim_board_address(w->sim, tables[i].chip);
			const double value = gyro ? 360e3 : 9.81 / 9.80665e-3;
			uint8_t bytes[6];
			double z;

			assert_int_equal(i2c_write(w->bus, address, tables[i].on_at, tables[i].on), 0);
			assert_int_equal(i2c_write(w->bus, address, tables[i].range_at,
						 (uint8_t)(tables[i].others | code << tables[i].shift)),
				0);
			w->now_ns += 500000000;
			assert_int_equal(i2c_read(w->bus, address, tables[i].data, bytes, 6), 0);
			z = (int16_t)(bytes[4 + big] | bytes[5 - big] << 8);
			if (!(fabs(z - fmin(32767, value / tables[i].digits[code])) < 20))
				fail_msg("%s, chip %d, code %u: %g", tables[i].board, tables[i].chip, code, z);
			assert_in_range((int16_t)(bytes[0 + big] | bytes[1 - big] << 8) + 20, 0, 40);
			assert_in_range((int16_t)(bytes[2 + big] | bytes[3 - big] << 8) + 20, 0, 40);
			world_free(w);
		}
}

/* The lowest bit of a word that noise reaches: twelve bits, left-justified, or sixteen; ten bits without the high
 * resolution of the LSM303DLHC. */
static void test_words_of_simulated_chips_have_the_resolution_of_the_data_sheets(void **state)
{
	static const struct {
		const char *board;
		enum imu_chip chip;
		uint8_t writes[3][2], data;
		unsigned lowest;
	} words[] = {
		{"v0", IMU_CHIP_GYRO, {{0x20, 0xCF}, {0x23, 0x80}, {0x21, 0}}, 0xA8, 1},
		{"v0", IMU_CHIP_ACCEL, {{0x20, 0x3F}, {0x23, 0x80}, {0x21, 0}}, 0xA8, 16},
		{"v2", IMU_CHIP_ACCEL, {{0x20, 0x77}, {0x23, 0x88}, {0x21, 0}}, 0xA8, 16},
		{"v2", IMU_CHIP_ACCEL, {{0x20, 0x77}, {0x23, 0x80}, {0x21, 0}}, 0xA8, 64},
		{"v3", IMU_CHIP_ACCEL, {{0x20, 0x87}, {0x21, 0}, {0x22, 0}}, 0xA8, 1},
		{"v3", IMU_CHIP_MAG, {{0x24, 0xF0}, {0x25, 0}, {0x26, 0}}, 0x88, 1},
		{"v5", IMU_CHIP_GYRO, {{0x11, 0x60}, {0x10, 0x60}, {0x12, 0x04}}, 0x22, 1},
		{"v5", IMU_CHIP_ACCEL, {{0x11, 0x60}, {0x10, 0x60}, {0x12, 0x04}}, 0x28, 1},
		{"v5", IMU_CHIP_MAG, {{0x20, 0xFC}, {0x21, 0}, {0x22, 0}}, 0xA8, 1},
	};

	(void)state;
	for (size_t i = 0; i < sizeof words / sizeof *words; i++) {
		struct world *w = world_make(words[i].board, "rest", false);
		const uint8_t address = sim_board_address(w->sim, words[i].chip);
		unsigned bits = 0;
		uint8_t bytes[6];

		for (int k = 0; k < 3; k++)
			assert_int_equal(i2c_write(w->bus, address, words[i].writes[k][0], words[i].writes[k][1]), 0);
		for (int k = 0; k < 200; k++) {
			w->now_ns += 30000000;
			assert_int_equal(i2c_read(w->bus, address, words[i].data, bytes, 6), 0);
			bits |= (unsigned)(bytes[0] | bytes[1] << 8 | bytes[2] | bytes[3] << 8 | bytes[4] |
					   bytes[5] << 8);
		}
		assert_int_equal(bits & -bits, words[i].lowest);
		world_free(w);
	}
}

/* Rates and the control registers for them, from the tables of the data sheets: the gyro's (with its widest bandwidth)
 * and the accelerometer's, which samples at least twice as fast where it can. */
static void test_each_rate_has_the_registers_of_the_data_sheets(void **state)
{
	static const struct {
		const char *board;
		double wanted_hz, hz;
		uint8_t gyro_at, gyro, accel_at, accel;
	} rates[] = {
		{"v0", 100, 100, 0x20, 0x1F, 0x20, 0x37}, /* DR, BW, PD, axes; 400 Hz */
		{"v0", 200, 200, 0x20, 0x7F, 0x20, 0x37},
		{"v0", 400, 400, 0x20, 0xBF, 0x20, 0x3F}, /* 1000 Hz */
		{"v0", 800, 800, 0x20, 0xFF, 0x20, 0x3F},
		{"v2", 100, 95, 0x20, 0x1F, 0x20, 0x77}, /* 400 Hz */
		{"v2", 200, 190, 0x20, 0x7F, 0x20, 0x77},
		{"v2", 400, 380, 0x20, 0xBF, 0x20, 0x97}, /* 1344 Hz */
		{"v2", 800, 760, 0x20, 0xFF, 0x20, 0x97},
		{"v3", 100, 100, 0x20, 0x1F, 0x20, 0x8F}, /* 400 Hz */
		{"v3", 200, 200, 0x20, 0x7F, 0x20, 0x8F},
		{"v3", 400, 400, 0x20, 0xBF, 0x20, 0x9F}, /* 800 Hz */
		{"v3", 800, 800, 0x20, 0xFF, 0x20, 0xAF}, /* 1600 Hz */
		{"v5", 100, 104, 0x11, 0x4C, 0x10, 0x4C}, /* one oscillator */
		{"v5", 200, 208, 0x11, 0x5C, 0x10, 0x5C},
		{"v5", 400, 416, 0x11, 0x6C, 0x10, 0x6C},
		{"v5", 800, 833, 0x11, 0x7C, 0x10, 0x7C},
		{"v6", 1600, 1660, 0x11, 0x8C, 0x10, 0x8C},
		{"lsm9ds1", 100, 119, 0x10, 0x79, 0x20, 0x78},
		{"lsm9ds1", 200, 238, 0x10, 0x9B, 0x20, 0x98},
		{"lsm9ds1", 400, 476, 0x10, 0xBB, 0x20, 0xB8},
		{"lsm9ds1", 800, 952, 0x10, 0xDB, 0x20, 0xD8},
		{"icm42688", 50, 50, 0x4F, 0x09, 0x50, 0x29},
		{"icm42688", 200, 200, 0x4F, 0x07, 0x50, 0x27},
		{"icm42688", 400, 500, 0x4F, 0x0F, 0x50, 0x2F},
		{"icm42688", 1000, 1000, 0x4F, 0x06, 0x50, 0x26},
		{"icm42688", 2000, 2000, 0x4F, 0x05, 0x50, 0x25},
		{"bmi270", 50, 50, 0x42, 0xE7, 0x40, 0xA7},
		{"bmi270", 200, 200, 0x42, 0xE9, 0x40, 0xA9},
		{"bmi270", 400, 400, 0x42, 0xEA, 0x40, 0xAA},
		{"bmi270", 800, 800, 0x42, 0xEB, 0x40, 0xAB},
		{"bmi270", 1600, 1600, 0x42, 0xEC, 0x40, 0xAC},
	};

	(void)state;
	for (size_t i = 0; i < sizeof rates / sizeof *rates; i++) {
		struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
		struct world *w = world_make(rates[i].board, "rest", false);
		struct board_plan plan;
		char why[200];

		settings.rate_hz = rates[i].wanted_hz;
		world_detect(w);
		assert_int_equal(board_plan(&w->board, &settings, false, false, &plan, why, sizeof why), 0);
		assert_true(plan.rate_hz == rates[i].hz);
		board_apply(&w->board, &plan);
		world_run(w, START_US);
		assert_int_equal(sim_board_registers(w->sim, IMU_CHIP_GYRO)[rates[i].gyro_at], rates[i].gyro);
		assert_int_equal(sim_board_registers(w->sim, IMU_CHIP_ACCEL)[rates[i].accel_at], rates[i].accel);
		assert_int_equal(w->board.health.fault, 0);
		world_free(w);
	}
}

/* ---- self-test --------------------------------------------------------------------------------------------------- */

static void test_a_self_test_at_rest_passes_where_there_is_one(void **state)
{
	static const uint8_t passed[BOARD_COUNT] = {
		0x03, 0x03, 0x01, 0x03, 0x03, 0x03, 0x03, 0, 0, 0x02, 0x03, 0x03, 0x03, 0x03, 0, 0, 0x02};
	struct imu_sample sample;

	(void)state;
	for (int i = 0; i < BOARD_COUNT; i++) {
		struct world *w = world_new(BOARDS[i], "rest", false);

		world_run(w, START_US);
		board_self_test(&w->board);
		assert_int_equal(w->board.health.self_test, passed[i] | IMU_SELF_TEST_RUNS);
		assert_true(world_sample(w, &sample, START_US)); /* samples continue */
		assert_int_equal(w->board.health.self_test, passed[i]);
		assert_int_equal(w->board.health.degraded, 0);
		assert_true(vec3_norm(vec3_sub(sample.accel_m_s2, (struct vec3){0, 0, 9.81})) < 0.5);
		world_free(w);
	}
}

/* For each sensor 0.2 s until the settings are settled and as much for the test signal, and twice 16 samples. */
static void test_a_self_test_takes_as_long_as_its_samples(void **state)
{
	struct world *w = world_new("v3", "rest", false);
	int64_t begun_ns;

	(void)state;
	world_run(w, 100000);
	begun_ns = w->now_ns;
	board_self_test(&w->board);
	/* gyro: 0.4 + 30 / 100 s, accelerometer: 0.4 + 30 / 400 s, and the transfers */
	assert_in_range((w->now_ns - begun_ns) / 1000000, 1175, 1300);
	world_free(w);
}

/* A FIFO is read every 2.5 ms at most, its level and then its samples, and the accelerometer's together with the
 * gyro's; the magnetometer and the registers that are read back wait for it. So the thread wakes up hardly more often
 * than there are samples, or batches. The v0's accelerometer has no FIFO: it is read four times as often. */
static void test_a_fifo_is_read_in_batches(void **state)
{
	static const struct {
		const char *board;
		double hz, transfers, wakes; /* a second */
	} rates[] = {{"v0", 100, 1056, 494}, {"v2", 100, 839, 111}, {"v3", 100, 731, 115}, {"v3", 800, 1600, 503},
		{"v5", 100, 483, 109}, {"v6", 100, 483, 109}, {"v6", 800, 1117, 285}, {"lsm9ds1", 100, 571, 127},
		{"icm20948", 100, 512, 108}, {"icm42688", 100, 309, 104}, {"icm42688", 1000, 1099, 338},
		{"bmi270", 100, 308, 103}, {"bmi270", 800, 904, 271}};

	(void)state;
	for (size_t i = 0; i < sizeof rates / sizeof *rates; i++) {
		struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
		struct world *w = world_make(rates[i].board, "rest", false);
		double transfers, wakes;

		settings.rate_hz = rates[i].hz;
		world_detect(w);
		world_set_up(w, &settings, true);
		world_run(w, 3000000);
		transfers = (double)w->accesses;
		wakes = (double)w->wakes;
		world_run(w, 1000000);
		transfers = (double)w->accesses - transfers;
		wakes = (double)w->wakes - wakes;
		if (fabs(transfers - rates[i].transfers) > 0.03 * rates[i].transfers ||
			fabs(wakes - rates[i].wakes) > 0.05 * rates[i].wakes)
			fail_msg("%s at %g Hz: %g transfers, %g wake-ups", rates[i].board, rates[i].hz, transfers,
				wakes);
		world_free(w);
	}
}

static size_t fifo_bytes;
static uint8_t fifo_at;

static void count_fifo(struct world *w, const struct sim_access *access)
{
	(void)w;
	fifo_bytes += !access->write && (access->sub & 0x7F) == fifo_at ? access->n : 0;
}

/* After stalls of 38 and 125 samples at 833 Hz: 32 samples a step, so that the bus is free for a command in between. */
static void test_a_step_takes_32_samples_at_most_from_a_fifo(void **state)
{
	static const struct {
		const char *board;
		uint8_t at;
		size_t set; /* bytes of a sample of both */
	} boards[] = {{"v5", 0x3E, 12}, {"v6", 0x78, 14}};

	(void)state;
	for (size_t k = 0; k < 2 * sizeof boards / sizeof *boards; k++) {
		const size_t i = k / 2;
		struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
		struct world *w = world_make(boards[i].board, "rest", false);

		settings.rate_hz = 800;
		world_detect(w);
		world_set_up(w, &settings, true);
		world_run(w, 1000000);
		w->now_ns += k % 2 ? 150000000 : 46000000;
		w->after = count_fifo;
		fifo_at = boards[i].at;
		fifo_bytes = 0;
		board_step(&w->board);
		assert_int_equal(fifo_bytes, 32 * boards[i].set);
		world_free(w);
	}
}

static uint8_t self_test_with(const char *board, enum imu_chip chip, struct vec3 deflection)
{
	struct world *w = world_new(board, "rest", false);
	uint8_t result;

	world_run(w, 100000);
	sim_board_deflect(w->sim, chip, deflection);
	board_self_test(&w->board);
	result = w->board.health.self_test;
	world_free(w);
	return result;
}

/* [mg] and, at 2000 deg/s, [deg/s], from the data sheets and, for the LSM9DS1, its manufacturer's example. */
static void test_a_self_test_has_the_limits_of_the_data_sheets(void **state)
{
	static const struct {
		const char *board;
		enum imu_chip chip;
		struct vec3 least, most;
		double share; /* beside a limit: more than the noise of the reading */
	} limits[] = {
		{"v0", IMU_CHIP_ACCEL, {120, 120, 140}, {550, 550, 750}, 0.03},
		{"v1", IMU_CHIP_ACCEL, {120, 120, 140}, {550, 550, 750}, 0.03},
		{"v3", IMU_CHIP_GYRO, {200, 200, 200}, {800, 800, 800}, 0.01},
		{"v3", IMU_CHIP_ACCEL, {70, 70, 70}, {1700, 1700, 1700}, 0.03},
		{"v5", IMU_CHIP_GYRO, {150, 150, 150}, {700, 700, 700}, 0.01},
		{"v5", IMU_CHIP_ACCEL, {90, 90, 90}, {1700, 1700, 1700}, 0.03},
		{"v6", IMU_CHIP_GYRO, {150, 150, 150}, {700, 700, 700}, 0.01},
		{"v6", IMU_CHIP_ACCEL, {50, 50, 50}, {1700, 1700, 1700}, 0.03},
		{"lsm9ds1", IMU_CHIP_GYRO, {200, 200, 200}, {800, 800, 800}, 0.01},
		{"lsm9ds1", IMU_CHIP_ACCEL, {70, 70, 70}, {1500, 1500, 1500}, 0.03},
	};

	(void)state;
	for (size_t i = 0; i < sizeof limits / sizeof *limits; i++)
		for (int axis = 0; axis < 3; axis++)
			for (int k = 0; k < 4; k++) {
				const double unit = limits[i].chip == IMU_CHIP_GYRO ? RAD_PER_DEG : M_S2_PER_MG;
				const double off = limits[i].share, shares[] = {1 - off, 1 + off, 1 - off, 1 + off};
				const struct vec3 limit = k < 2 ? limits[i].least : limits[i].most;
				struct vec3 d = vec3_scale(0.5 * unit, vec3_add(limits[i].least, limits[i].most));
				const bool passes = k == 1 || k == 2;

				*(axis == 0	    ? &d.x
					: axis == 1 ? &d.y
						    : &d.z) = unit * shares[k] *
							      (axis == 0	  ? limit.x
								      : axis == 1 ? limit.y
										  : limit.z);
				if (!(self_test_with(limits[i].board, limits[i].chip, d) &
					    1u << (limits[i].chip - 1)) == passes)
					fail_msg("%s, chip %d, axis %d, limit %d", limits[i].board, limits[i].chip,
						axis, k);
			}
}

static void test_a_self_test_passes_in_any_range(void **state)
{
	struct imu_settings settings = IMU_SETTINGS_DEFAULTS;

	(void)state;
	settings.gyro_range_deg_s = 125;
	settings.accel_range_g = 2;
	for (int i = 0; i < BOARD_COUNT; i++) {
		struct world *w = world_make(BOARDS[i], "rest", false);

		world_detect(w);
		world_set_up(w, &settings, true);
		board_self_test(&w->board);
		assert_int_equal(w->board.health.self_test & 0x70, 0);
		world_free(w);
	}
}

/* What was written, in its order. */
static struct {
	struct {
		uint8_t address, sub, value;
	} at[1000];
	size_t n;
} written;

static int record_writes(struct world *w, const struct sim_access *access)
{
	(void)w;
	if (access->write) {
		assert_in_range(written.n, 0, 999);
		written.at[written.n].address = access->address;
		written.at[written.n].sub = access->sub;
		written.at[written.n++].value = access->bytes[0];
	}
	return 0;
}

static void test_after_a_self_test_and_after_new_settings_the_chips_are_initialised_as_at_first(void **state)
{
	const struct imu_settings settings = IMU_SETTINGS_DEFAULTS;

	(void)state;
	for (int i = 0; i < BOARD_COUNT; i++) {
		struct world *w = world_new(BOARDS[i], "rest", false);

		for (int again = 0; again < 3; again++) {
			static __typeof__(written) first;

			written.n = 0;
			w->before = record_writes;
			world_run(w, START_US);
			w->before = NULL;
			if (again == 0)
				first = written;
			assert_in_range(first.n, 6, w->board.gyro->chip->firmware_size ? 600 : 30);
			assert_int_equal(written.n, first.n);
			assert_memory_equal(written.at, first.at, first.n * sizeof first.at[0]);
			if (again == 0)
				board_self_test(&w->board);
			else
				world_set_up(w, &settings, true);
		}
		world_free(w);
	}
}

static void test_a_self_test_without_effect_has_failed(void **state)
{
	struct world *w = world_new("v3", "rest", false);

	(void)state;
	sim_board_break_self_test(w->sim, IMU_CHIP_ACCEL);
	board_self_test(&w->board);
	world_run(w, 300000);
	assert_int_equal(w->board.health.self_test, 0x21);
	assert_int_equal(w->board.health.degraded, IMU_FAULT_SELF_TEST);
	assert_int_equal(w->board.health.degraded_chip, IMU_CHIP_ACCEL);
	world_free(w);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_each_board_is_recognised),
		cmocka_unit_test(test_the_accelerometer_of_an_lsm303dlh_is_found_at_19h_too),
		cmocka_unit_test(test_an_accelerometer_without_its_magnetometer_is_named_beside_the_gyro),
		cmocka_unit_test(test_a_board_without_magnetometer_gives_samples_without_it_and_says_so),
		cmocka_unit_test(test_an_empty_bus_is_refused_with_the_addresses_that_were_tried),
		cmocka_unit_test(test_why_no_chip_was_found_is_told),
		cmocka_unit_test(test_unknown_chips_are_refused),
		cmocka_unit_test(test_digits_have_the_size_and_the_axes_the_order_of_the_data_sheets),
		cmocka_unit_test(test_samples_are_the_motion_within_a_digit_and_the_time_within_a_tenth_of_a_sample),
		cmocka_unit_test(test_through_a_stub_samples_have_their_rate_and_their_time_within_a_millisecond),
		cmocka_unit_test(test_late_reads_do_not_change_the_time_stamps),
		cmocka_unit_test(test_a_stall_longer_than_the_fifo_is_counted_and_times_stay_right),
		cmocka_unit_test(test_after_a_stall_the_newest_sets_with_an_acceleration_become_samples),
		cmocka_unit_test(
			test_after_a_stall_shorter_than_the_fifo_no_sample_is_missing_and_the_delay_is_made_up),
		cmocka_unit_test(test_after_a_stall_each_acceleration_is_that_of_its_sample),
		cmocka_unit_test(test_after_an_overflow_the_values_are_still_those_of_their_axes),
		cmocka_unit_test(test_an_icm20948_is_found_in_any_bank),
		cmocka_unit_test(test_a_long_fifo_is_read_32_sets_at_a_time),
		cmocka_unit_test(test_the_rate_is_measured),
		cmocka_unit_test(test_data_ready_edges_give_times_that_late_reads_alone_do_not),
		cmocka_unit_test(test_a_sample_has_the_temperature_once_a_second),
		cmocka_unit_test(test_settings_that_the_chips_do_not_support_are_refused_with_the_limit),
		cmocka_unit_test(test_the_smallest_values_that_are_enough_are_chosen),
		cmocka_unit_test(test_each_full_scale_of_the_data_sheets_can_be_chosen),
		cmocka_unit_test(test_each_bandwidth_of_a_gyro_has_the_code_of_the_data_sheets),
		cmocka_unit_test(test_the_registers_have_the_values_of_the_data_sheets),
		cmocka_unit_test(
			test_without_fifo_and_with_data_ready_the_registers_have_the_values_of_the_data_sheets),
		cmocka_unit_test(test_simulated_chips_have_the_digits_of_the_data_sheets),
		cmocka_unit_test(test_words_of_simulated_chips_have_the_resolution_of_the_data_sheets),
		cmocka_unit_test(test_simulated_chips_have_the_registers_of_the_data_sheets_after_power_on),
		cmocka_unit_test(test_each_rate_has_the_registers_of_the_data_sheets),
		cmocka_unit_test(test_a_self_test_at_rest_passes_where_there_is_one),
		cmocka_unit_test(test_a_self_test_has_the_limits_of_the_data_sheets),
		cmocka_unit_test(test_a_step_takes_32_samples_at_most_from_a_fifo),
		cmocka_unit_test(test_a_fifo_is_read_in_batches),
		cmocka_unit_test(test_a_self_test_takes_as_long_as_its_samples),
		cmocka_unit_test(test_a_self_test_passes_in_any_range),
		cmocka_unit_test(test_after_a_self_test_and_after_new_settings_the_chips_are_initialised_as_at_first),
		cmocka_unit_test(test_a_self_test_without_effect_has_failed),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
