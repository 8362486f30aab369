/* What the registers of the simulated chips (drivers/imu/sim/sim_chips.h) mean: the sampling rate of each code, the
 * digit of each range and the directions of the axes, against the data sheets. Codes that the driver never writes are
 * here, too. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <string.h>

#include "model/math/quat.h"
#include "tests/unit/i2c_world.h"

enum { WRITES = 4, CODES = 16 };

static const double G = 9.80665;

struct write {
	uint8_t reg, value;
};

static struct world *w;

static void put(enum imu_chip chip, uint8_t reg, uint8_t value)
{
	assert_int_equal(i2c_write(w->bus, sim_board_address(w->sim, chip), reg, value), 0);
}

static void wait_ms(double ms)
{
	w->now_ns += (int64_t)(1e6 * ms);
}

static void start(const char *board)
{
	w = world_make(board, "figure", true);
	if (strcmp(board, "bmi270") == 0)
		world_load_bmi270(w);
}

static void put_all(enum imu_chip chip, const struct write *writes)
{
	for (int i = 0; i < WRITES && (writes[i].reg || writes[i].value); i++)
		put(chip, writes[i].reg, writes[i].value);
}

static bool is_pair(const char *board)
{
	return strcmp(board, "v5") == 0 || strcmp(board, "v6") == 0 || strcmp(board, "lsm9ds1") == 0 ||
	       strcmp(board, "bmi270") == 0 || strncmp(board, "icm", 3) == 0;
}

/* ---- rates ------------------------------------------------------------------------------------------------------- */

struct rates {
	const char *board;
	enum imu_chip chip;
	struct write before[WRITES];
	uint8_t reg;
	struct {
		uint8_t code;
		double hz;
	} codes[CODES]; /* code 0 only as the first one */
};

static const struct rates RATES[] = {
	/* DR and PD of CTRL_REG1; LOW_ODR of the L3GD20H */
	{"v0", IMU_CHIP_GYRO, {{0}}, 0x20,
		{{0x00, 0}, {0x0F, 100}, {0x4F, 200}, {0x8F, 400}, {0xCF, 800}, {0x07, 0}, {0xC8, 800}}},
	{"v2", IMU_CHIP_GYRO, {{0}}, 0x20, {{0x00, 0}, {0x0F, 95}, {0x4F, 190}, {0x8F, 380}, {0xCF, 760}, {0x37, 0}}},
	{"v3", IMU_CHIP_GYRO, {{0}}, 0x20, {{0x00, 0}, {0x0F, 100}, {0x4F, 200}, {0x8F, 400}, {0xCF, 800}, {0x37, 0}}},
	{"v3", IMU_CHIP_GYRO, {{0x39, 1}}, 0x20, {{0x00, 0}, {0x0F, 12.5}, {0x4F, 25}, {0x8F, 50}, {0xCF, 50}}},
	{"v2", IMU_CHIP_GYRO, {{0x39, 1}}, 0x20, {{0x00, 0}, {0x0F, 95}}},
	/* PM and DR of CTRL_REG1_A */
	{"v0", IMU_CHIP_ACCEL, {{0}}, 0x20, {{0x07, 0}, {0x27, 50}, {0x2F, 100}, {0x37, 400}, {0x3F, 1000}}},
	/* ODR of CTRL_REG1_A; 8 is of low power only */
	{"v2", IMU_CHIP_ACCEL, {{0}}, 0x20,
		{{0x07, 0}, {0x17, 1}, {0x27, 10}, {0x37, 25}, {0x47, 50}, {0x57, 100}, {0x67, 200}, {0x77, 400},
			{0x87, 1620}, {0x97, 1344}}},
	/* DO of CRA_REG, with MD = 0: continuous */
	{"v0", IMU_CHIP_MAG, {{0x02, 0}}, 0x00,
		{{0x00, 0.75}, {0x04, 1.5}, {0x08, 3}, {0x0C, 7.5}, {0x10, 15}, {0x14, 30}, {0x18, 75}}},
	{"v1", IMU_CHIP_MAG, {{0x02, 0}}, 0x00, {{0x00, 0.75}, {0x10, 15}, {0x18, 75}}},
	{"v2", IMU_CHIP_MAG, {{0x02, 0}}, 0x00, {{0x00, 0.75}, {0x18, 75}, {0x1C, 220}}},
	{"v2", IMU_CHIP_MAG, {{0x00, 0x18}}, 0x02, {{0x01, 0}, {0x02, 0}, {0x03, 0}}},
	/* AODR, M_ODR */
	{"v3", IMU_CHIP_ACCEL, {{0}}, 0x20,
		{{0x07, 0}, {0x17, 3.125}, {0x27, 6.25}, {0x37, 12.5}, {0x47, 25}, {0x57, 50}, {0x67, 100}, {0x77, 200},
			{0x87, 400}, {0x97, 800}, {0xA7, 1600}}},
	{"v3", IMU_CHIP_MAG, {{0x26, 0}}, 0x24,
		{{0x00, 3.125}, {0x04, 6.25}, {0x08, 12.5}, {0x0C, 25}, {0x10, 50}, {0x14, 100}, {0x74, 100}}},
	{"v3", IMU_CHIP_MAG, {{0}}, 0x26, {{0x01, 0}, {0x02, 0}, {0x03, 0}}},
	/* ODR_G, ODR_XL */
	{"v5", IMU_CHIP_GYRO, {{0}}, 0x11,
		{{0x00, 0}, {0x10, 12.5}, {0x20, 26}, {0x30, 52}, {0x40, 104}, {0x50, 208}, {0x60, 416}, {0x70, 833},
			{0x80, 1660}, {0x90, 3330}, {0xA0, 6660}}},
	{"v6", IMU_CHIP_ACCEL, {{0}}, 0x10,
		{{0x00, 0}, {0x10, 12.5}, {0x20, 26}, {0x30, 52}, {0x40, 104}, {0x50, 208}, {0x60, 416}, {0x70, 833},
			{0x80, 1660}, {0x90, 3330}, {0xA0, 6660}}},
	/* DO of CTRL_REG1, with MD = 0 */
	{"v5", IMU_CHIP_MAG, {{0x22, 0}}, 0x20,
		{{0x00, 0.625}, {0x04, 1.25}, {0x08, 2.5}, {0x0C, 5}, {0x10, 10}, {0x14, 20}, {0x18, 40}, {0x1C, 80}}},
	{"v5", IMU_CHIP_MAG, {{0}}, 0x22, {{0x01, 0}, {0x02, 0}, {0x03, 0}}},
	{"lsm9ds1", IMU_CHIP_MAG, {{0x22, 0}}, 0x20, {{0x00, 0.625}, {0x1C, 80}}},
	/* ODR_G gives both rates */
	{"lsm9ds1", IMU_CHIP_GYRO, {{0}}, 0x10,
		{{0x00, 0}, {0x20, 14.9}, {0x40, 59.5}, {0x60, 119}, {0x80, 238}, {0xA0, 476}, {0xC0, 952}}},
	{"lsm9ds1", IMU_CHIP_ACCEL, {{0}}, 0x10, {{0x00, 0}, {0x60, 119}, {0xC0, 952}}},
	/* GYRO_ODR and ACCEL_ODR in low noise mode, and others of PWR_MGMT0 */
	{"icm42688", IMU_CHIP_GYRO, {{0x4E, 0x0F}}, 0x4F,
		{{0x01, 32000}, {0x02, 16000}, {0x03, 8000}, {0x04, 4000}, {0x05, 2000}, {0x06, 1000}, {0x07, 200},
			{0x08, 100}, {0x09, 50}, {0x0A, 25}, {0x0B, 12.5}, {0x0F, 500}}},
	{"icm42688", IMU_CHIP_ACCEL, {{0x4E, 0x0F}}, 0x50,
		{{0x01, 32000}, {0x02, 16000}, {0x03, 8000}, {0x04, 4000}, {0x05, 2000}, {0x06, 1000}, {0x07, 200},
			{0x08, 100}, {0x09, 50}, {0x0A, 25}, {0x0B, 12.5}, {0x0F, 500}}},
	{"icm42688", IMU_CHIP_GYRO, {{0}}, 0x4E, {{0x00, 0}, {0x04, 0}, {0x0C, 1000}, {0x03, 0}}},
	{"icm42688", IMU_CHIP_ACCEL, {{0}}, 0x4E, {{0x00, 0}, {0x01, 0}, {0x03, 1000}, {0x0C, 0}}},
	/* 1125 Hz / (1 + SMPLRT_DIV) while awake, without FCHOICE 9000 and 4500 Hz; PWR_MGMT_2 switches off */
	{"icm20948", IMU_CHIP_GYRO, {{0x06, 0x01}, {0x7F, 0x20}}, 0x00,
		{{0x00, 1125}, {0x01, 562.5}, {0x04, 225}, {0x0A, 1125. / 11}, {0xFF, 1125. / 256}}},
	{"icm20948", IMU_CHIP_ACCEL, {{0x06, 0x01}, {0x7F, 0x20}}, 0x11,
		{{0x00, 1125}, {0x01, 562.5}, {0x0A, 1125. / 11}, {0xFF, 1125. / 256}}},
	{"icm20948", IMU_CHIP_ACCEL, {{0x06, 0x01}, {0x7F, 0x20}}, 0x10, {{0x00, 1125}, {0x01, 1125. / 257}}},
	{"icm20948", IMU_CHIP_GYRO, {{0x06, 0x01}, {0x7F, 0x20}}, 0x01, {{0x00, 9000}, {0x07, 1125}}},
	{"icm20948", IMU_CHIP_ACCEL, {{0x06, 0x01}, {0x7F, 0x20}}, 0x14, {{0x00, 4500}, {0x07, 1125}}},
	{"icm20948", IMU_CHIP_GYRO, {{0x06, 0x01}}, 0x07, {{0x00, 1125}, {0x07, 0}, {0x38, 1125}, {0x01, 0}}},
	{"icm20948", IMU_CHIP_ACCEL, {{0x06, 0x01}}, 0x07, {{0x00, 1125}, {0x07, 1125}, {0x38, 0}, {0x08, 0}}},
	{"icm20948", IMU_CHIP_GYRO, {{0}}, 0x06, {{0x41, 0}, {0x01, 1125}}},
	/* MODE of CNTL2 */
	{"icm20948", IMU_CHIP_MAG, {{0}}, 0x31,
		{{0x00, 0}, {0x01, 0}, {0x02, 10}, {0x04, 20}, {0x06, 50}, {0x08, 100}, {0x10, 0}}},
	/* ODR, 25/64 Hz for 1 and twice as much by each step; PWR_CTRL */
	{"bmi270", IMU_CHIP_GYRO, {{0x7D, 0x0E}}, 0x42,
		{{0xA6, 25}, {0xA7, 50}, {0xA8, 100}, {0xA9, 200}, {0xAA, 400}, {0xAB, 800}, {0xAC, 1600},
			{0xAD, 3200}}},
	{"bmi270", IMU_CHIP_ACCEL, {{0x7D, 0x0E}}, 0x40,
		{{0xA5, 12.5}, {0xA6, 25}, {0xA7, 50}, {0xA8, 100}, {0xA9, 200}, {0xAA, 400}, {0xAB, 800},
			{0xAC, 1600}}},
	{"bmi270", IMU_CHIP_GYRO, {{0}}, 0x7D, {{0x00, 0}, {0x02, 200}, {0x04, 0}}},
	{"bmi270", IMU_CHIP_ACCEL, {{0}}, 0x7D, {{0x00, 0}, {0x04, 100}, {0x02, 0}}},
};

/* The AK09916 answers when BYPASS_EN of the ICM-20948 connects it, and I2C_MST_EN does not. */
static void connect_mag(const char *board)
{
	if (strcmp(board, "icm20948") == 0)
		put(IMU_CHIP_GYRO, 0x0F, 0x02);
}

/* The oscillators differ from nominal as the test has set it; both sensors of a chip that samples them together have
 * that of the gyro. */
static void test_the_rate_of_each_code(void **state)
{
	(void)state;
	for (size_t i = 0; i < sizeof RATES / sizeof *RATES; i++)
		for (int k = 0; k < CODES && (k == 0 || RATES[i].codes[k].code); k++) {
			const enum imu_chip chip = RATES[i].chip;
			double hz = RATES[i].codes[k].hz, from_ns, to_ns, taken;

			start(RATES[i].board);
			connect_mag(RATES[i].board);
			put_all(chip, RATES[i].before);
			put(chip, RATES[i].reg, RATES[i].codes[k].code);
			hz *= 1 + w->config.rate_error[is_pair(RATES[i].board) && chip == IMU_CHIP_ACCEL ? IMU_CHIP_GYRO
													 : chip];
			taken = (double)sim_board_taken(w->sim, chip, &from_ns);
			wait_ms(10000);
			taken = (double)sim_board_taken(w->sim, chip, &to_ns) - taken;
			if (fabs(taken - 10 * hz) > (hz > 0 ? 1 : 0))
				fail_msg("%s, chip %d, %02X = %02X: %g Hz, expected %g Hz", RATES[i].board, (int)chip,
					RATES[i].reg, RATES[i].codes[k].code, taken / 10, hz);
			if (hz > 0)
				assert_true(fabs((to_ns - from_ns) * hz - taken * 1e9) < 1e-6 * taken * 1e9);
			world_free(w);
		}
}

/* ---- digits ------------------------------------------------------------------------------------------------------ */

struct ranges {
	const char *board;
	enum imu_chip chip;
	struct write before[WRITES];
	uint8_t data; /* first data register, with the bit for a read of several */
	bool big_endian;
	uint8_t order[3]; /* which pair has x, y, z */
	double sign[3];	  /* of the axes, against the board's */
	double grain;	  /* step of the word: 16 for 12 bits, left-justified */
	uint8_t reg;
	struct {
		uint8_t code;
		double digit, z; /* mdps, mg or mgauss of a digit of 16 bits; of z where it differs */
	} codes[CODES];
};

static const struct ranges RANGES[] = {
	/* FS of CTRL_REG4 */
	{"v0", IMU_CHIP_GYRO, {{0x20, 0x0F}}, 0xA8, false, {0, 1, 2}, {1, 1, 1}, 1, 0x23,
		{{0x00, 8.75, 0}, {0x10, 17.5, 0}, {0x20, 70, 0}, {0x30, 70, 0}}},
	{"v2", IMU_CHIP_GYRO, {{0x20, 0x0F}}, 0xA8, false, {0, 1, 2}, {1, 1, 1}, 1, 0x23,
		{{0x00, 8.75, 0}, {0x10, 17.5, 0}, {0x20, 70, 0}, {0x30, 70, 0}}},
	{"v3", IMU_CHIP_GYRO, {{0x20, 0x0F}}, 0xA8, false, {0, 1, 2}, {1, 1, 1}, 1, 0x23,
		{{0x00, 8.75, 0}, {0x10, 17.5, 0}, {0x20, 70, 0}, {0x30, 70, 0}}},
	{"v0", IMU_CHIP_ACCEL, {{0x20, 0x2F}}, 0xA8, false, {0, 1, 2}, {1, 1, 1}, 16, 0x23,
		{{0x00, 1. / 16, 0}, {0x10, 2. / 16, 0}, {0x30, 3.9 / 16, 0}}},
	{"v2", IMU_CHIP_ACCEL, {{0x20, 0x57}}, 0xA8, false, {0, 1, 2}, {1, 1, 1}, 16, 0x23,
		{{0x08, 1. / 16, 0}, {0x18, 2. / 16, 0}, {0x28, 4. / 16, 0}, {0x38, 12. / 16, 0}}},
	{"v2", IMU_CHIP_ACCEL, {{0x20, 0x57}}, 0xA8, false, {0, 1, 2}, {1, 1, 1}, 64, 0x23,
		{{0x00, 1. / 16, 0}, {0x10, 2. / 16, 0}, {0x20, 4. / 16, 0}, {0x30, 12. / 16, 0}}},
	/* GN of CRB_REG: digits per gauss. The DLM and the DLHC have z before y. */
	{"v0", IMU_CHIP_MAG, {{0x02, 0}, {0x00, 0x18}}, 0x03, true, {0, 1, 2}, {1, 1, 1}, 1, 0x01,
		{{0x20, 1e3 / 1055, 1e3 / 950}, {0x40, 1e3 / 795, 1e3 / 710}, {0x60, 1e3 / 635, 1e3 / 570},
			{0x80, 1e3 / 430, 1e3 / 385}, {0xA0, 1e3 / 375, 1e3 / 335}, {0xC0, 1e3 / 320, 1e3 / 285},
			{0xE0, 1e3 / 230, 1e3 / 205}}},
	{"v1", IMU_CHIP_MAG, {{0x02, 0}, {0x00, 0x18}}, 0x03, true, {0, 2, 1}, {1, 1, 1}, 1, 0x01,
		{{0x20, 1e3 / 1100, 1e3 / 980}, {0xE0, 1e3 / 230, 1e3 / 205}}},
	{"v2", IMU_CHIP_MAG, {{0x02, 0}, {0x00, 0x18}}, 0x03, true, {0, 2, 1}, {1, 1, 1}, 1, 0x01,
		{{0x20, 1e3 / 1100, 1e3 / 980}, {0x40, 1e3 / 855, 1e3 / 760}, {0x60, 1e3 / 670, 1e3 / 600},
			{0x80, 1e3 / 450, 1e3 / 400}, {0xA0, 1e3 / 400, 1e3 / 355}, {0xC0, 1e3 / 330, 1e3 / 295},
			{0xE0, 1e3 / 230, 1e3 / 205}}},
	/* AFS of CTRL2, MFS of CTRL6 */
	{"v3", IMU_CHIP_ACCEL, {{0x20, 0x67}}, 0xA8, false, {0, 1, 2}, {1, 1, 1}, 1, 0x21,
		{{0x00, 0.061, 0}, {0x08, 0.122, 0}, {0x10, 0.183, 0}, {0x18, 0.244, 0}, {0x20, 0.732, 0}}},
	{"v3", IMU_CHIP_MAG, {{0x26, 0}, {0x24, 0x14}}, 0x88, false, {0, 1, 2}, {1, 1, 1}, 1, 0x25,
		{{0x00, 0.080, 0}, {0x20, 0.160, 0}, {0x40, 0.320, 0}, {0x60, 0.479, 0}}},
	/* FS_G and FS_125, FS_XL */
	{"v5", IMU_CHIP_GYRO, {{0}}, 0x22, false, {0, 1, 2}, {1, 1, 1}, 1, 0x11,
		{{0x40, 8.75, 0}, {0x44, 17.5, 0}, {0x48, 35, 0}, {0x4C, 70, 0}, {0x42, 4.375, 0}, {0x41, 8.75, 0}}},
	{"v6", IMU_CHIP_ACCEL, {{0}}, 0x28, false, {0, 1, 2}, {1, 1, 1}, 1, 0x10,
		{{0x40, 0.061, 0}, {0x44, 0.488, 0}, {0x48, 0.122, 0}, {0x4C, 0.244, 0}}},
	/* FS of CTRL_REG2: 6842, 3421, 2281 and 1711 digits per gauss */
	{"v5", IMU_CHIP_MAG, {{0x22, 0}, {0x20, 0x1C}}, 0xA8, false, {0, 1, 2}, {1, 1, 1}, 1, 0x21,
		{{0x00, 1e3 / 6842, 0}, {0x20, 1e3 / 3421, 0}, {0x40, 1e3 / 2281, 0}, {0x60, 1e3 / 1711, 0}}},
	/* FS_G, FS_XL; y of gyro and accelerometer points against the others' sense; the magnetometer's x and y */
	{"lsm9ds1", IMU_CHIP_GYRO, {{0}}, 0x18, false, {0, 1, 2}, {1, -1, 1}, 1, 0x10,
		{{0x60, 8.75, 0}, {0x68, 17.5, 0}, {0x78, 70, 0}}},
	{"lsm9ds1", IMU_CHIP_ACCEL, {{0x10, 0x60}}, 0x28, false, {0, 1, 2}, {1, -1, 1}, 1, 0x20,
		{{0x60, 0.061, 0}, {0x68, 0.732, 0}, {0x70, 0.122, 0}, {0x78, 0.244, 0}}},
	{"lsm9ds1", IMU_CHIP_MAG, {{0x22, 0}, {0x20, 0x1C}}, 0xA8, false, {0, 1, 2}, {-1, -1, 1}, 1, 0x21,
		{{0x00, 0.14, 0}, {0x20, 0.29, 0}, {0x40, 0.43, 0}, {0x60, 0.58, 0}}},
	/* GYRO_FS_SEL and ACCEL_FS_SEL: 2000 dps and 16 g, halved by each step */
	{"icm42688", IMU_CHIP_GYRO, {{0x4E, 0x0F}}, 0x25, true, {0, 1, 2}, {1, 1, 1}, 1, 0x4F,
		{{0x06, 2e6 / 32768, 0}, {0x26, 1e6 / 32768, 0}, {0x46, 5e5 / 32768, 0}, {0x66, 2.5e5 / 32768, 0}}},
	{"icm42688", IMU_CHIP_ACCEL, {{0x4E, 0x0F}}, 0x1F, true, {0, 1, 2}, {1, 1, 1}, 1, 0x50,
		{{0x06, 16e3 / 32768, 0}, {0x26, 8e3 / 32768, 0}, {0x46, 4e3 / 32768, 0}, {0x66, 2e3 / 32768, 0}}},
	{"icm20948", IMU_CHIP_GYRO, {{0x06, 0x01}, {0x7F, 0x20}}, 0x33, true, {0, 1, 2}, {1, 1, 1}, 1, 0x01,
		{{0x01, 2.5e5 / 32768, 0}, {0x03, 5e5 / 32768, 0}, {0x05, 1e6 / 32768, 0}, {0x07, 2e6 / 32768, 0}}},
	{"icm20948", IMU_CHIP_ACCEL, {{0x06, 0x01}, {0x7F, 0x20}}, 0x2D, true, {0, 1, 2}, {1, 1, 1}, 1, 0x14,
		{{0x01, 2e3 / 32768, 0}, {0x03, 4e3 / 32768, 0}, {0x05, 8e3 / 32768, 0}, {0x07, 16e3 / 32768, 0}}},
	/* 0.15 uT; y and z point against those of the ICM-20948 */
	{"icm20948", IMU_CHIP_MAG, {{0}}, 0x11, false, {0, 1, 2}, {1, -1, -1}, 1, 0x31, {{0x08, 1.5, 0}}},
	/* gyr_range, acc_range */
	{"bmi270", IMU_CHIP_GYRO, {{0x7D, 0x0E}}, 0x12, false, {0, 1, 2}, {1, 1, 1}, 1, 0x43,
		{{0x00, 2e6 / 32768, 0}, {0x01, 1e6 / 32768, 0}, {0x02, 5e5 / 32768, 0}, {0x03, 2.5e5 / 32768, 0},
			{0x04, 1.25e5 / 32768, 0}}},
	{"bmi270", IMU_CHIP_ACCEL, {{0x7D, 0x0E}}, 0x0C, false, {0, 1, 2}, {1, 1, 1}, 1, 0x41,
		{{0x00, 2e3 / 32768, 0}, {0x01, 4e3 / 32768, 0}, {0x02, 8e3 / 32768, 0}, {0x03, 16e3 / 32768, 0}}},
};

/* What an ideal sensor measures on a motion: rate [rad/s], specific force [m/s^2], field [uT]. */
static struct vec3 truth_of(enum imu_chip chip, double t_s)
{
	struct signal_truth truth;
	struct vec3 up = {0, 0, 9.81};

	signal_at(w->config.signal, t_s, &truth);
	return chip == IMU_CHIP_GYRO	? truth.omega_b_rad_s
	       : chip == IMU_CHIP_ACCEL ? quat_rotate_inverse(truth.q_nb, vec3_add(truth.accel_n_m_s2, up))
					: quat_rotate_inverse(truth.q_nb, (struct vec3){0, 20, -45});
}

/* A word times its digit is the motion's value at the time of the sample, rounded. */
static void test_the_digit_and_the_axes_of_each_range(void **state)
{
	(void)state;
	for (size_t i = 0; i < sizeof RANGES / sizeof *RANGES; i++)
		for (int k = 0; k < CODES && RANGES[i].codes[k].digit > 0; k++) {
			const struct ranges *r = &RANGES[i];
			const double unit = r->chip == IMU_CHIP_GYRO	? 1e-3 * acos(-1) / 180
					    : r->chip == IMU_CHIP_ACCEL ? 1e-3 * G
									: 0.1;
			uint8_t bytes[6];
			double t_ns;

			start(r->board);
			connect_mag(r->board);
			put_all(r->chip, r->before);
			put(r->chip, r->reg, r->codes[k].code);
			if (strcmp(r->board, "icm20948") == 0 && r->chip != IMU_CHIP_MAG)
				put(r->chip, 0x7F, 0x00); /* back to bank 0 */
			wait_ms(7000);
			assert_true(sim_board_taken(w->sim, r->chip, &t_ns) > 0);
			assert_int_equal(i2c_read(w->bus, sim_board_address(w->sim, r->chip), r->data, bytes, 6), 0);
			const struct vec3 truth = truth_of(r->chip, 1e-9 * (t_ns - (double)w->start_ns));
			const double v[3] = {truth.x, truth.y, truth.z};

			for (int axis = 0; axis < 3; axis++) {
				const uint8_t *pair = bytes + 2 * r->order[axis];
				const int word =
					(int16_t)(r->big_endian ? pair[0] << 8 | pair[1] : pair[1] << 8 | pair[0]);
				const double digit = axis == 2 && r->codes[k].z > 0 ? r->codes[k].z : r->codes[k].digit;
				const double found = r->sign[axis] * digit * unit * word;

				assert_true(fabs(v[axis]) > 1e-3);
				assert_int_equal(word % (int)r->grain, 0);
				if (!(fabs(found - v[axis]) <= 0.51 * r->grain * digit * unit))
					fail_msg("%s, chip %d, %02X = %02X: axis %d is %g, expected %g", r->board,
						(int)r->chip, r->reg, r->codes[k].code, axis, found, v[axis]);
			}
			world_free(w);
		}
}

/* Steps and ranges of the sensor model, which a preset has, are not those of the chip. */
static void test_the_chip_alone_rounds_and_limits(void **state)
{
	static const struct {
		enum imu_chip chip;
		uint8_t writes[2][2], data;
	} triads[] = {{IMU_CHIP_GYRO, {{0x11, 0x40}, {0x11, 0x40}}, 0x22},
		{IMU_CHIP_ACCEL, {{0x10, 0x40}, {0x10, 0x40}}, 0x28},
		{IMU_CHIP_MAG, {{0x22, 0x00}, {0x20, 0x1C}}, 0xA8}};

	(void)state;
	for (size_t i = 0; i < 3; i++) {
		uint8_t words[2][6];

		for (int coarse = 0; coarse < 2; coarse++) {
			struct sim_config config;
			struct sim_board *sim;

			start("v5");
			config = w->config;
			if (coarse)
				config.sensor.gyro.step = config.sensor.accel.step = config.sensor.mag.step =
					config.sensor.gyro.range = config.sensor.accel.range = config.sensor.mag.range =
						0.1;
			assert_int_equal(sim_board_open(&config, &sim), 0);
			for (int k = 0; k < 2; k++)
				i2c_write(sim_board_bus(sim), sim_board_address(sim, triads[i].chip),
					triads[i].writes[k][0], triads[i].writes[k][1]);
			wait_ms(7000);
			assert_int_equal(i2c_read(sim_board_bus(sim), sim_board_address(sim, triads[i].chip),
						 triads[i].data, words[coarse], 6),
				0);
			i2c_close(sim_board_bus(sim));
			world_free(w);
		}
		assert_memory_equal(words[0], words[1], 6);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_rate_of_each_code),
		cmocka_unit_test(test_the_digit_and_the_axes_of_each_range),
		cmocka_unit_test(test_the_chip_alone_rounds_and_limits),
	};

	return cmocka_run_group_tests_name("sim_registers", tests, NULL, NULL);
}
