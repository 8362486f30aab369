/* The simulated chips (drivers/imu/sim/sim_chips.h) in which gyro and accelerometer sample together, LSM9DS1,
 * ICM-42688-P, ICM-20948 and BMI270, and the AK09916: status, FIFO, addresses and what cannot be written, as the data
 * sheets say. test_sim_chips.c has the older ones. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <errno.h>
#include <math.h>
#include <string.h>

#include "tests/unit/i2c_world.h"

static const double G = 9.80665;

static struct world *w;
static enum imu_chip chip; /* whose registers put() and get() mean */

static void board(const char *name, const char *scenario)
{
	w = world_make(name, scenario, true);
	chip = IMU_CHIP_GYRO;
}

static void put(uint8_t reg, uint8_t value)
{
	assert_int_equal(i2c_write(w->bus, sim_board_address(w->sim, chip), reg, value), 0);
}

static void get(uint8_t sub, uint8_t *bytes, size_t n)
{
	assert_int_equal(i2c_read(w->bus, sim_board_address(w->sim, chip), sub, bytes, n), 0);
}

static unsigned get_one(uint8_t sub)
{
	uint8_t byte;

	get(sub, &byte, 1);
	return byte;
}

/* Two registers, the less significant first. */
static unsigned get_word(uint8_t sub)
{
	uint8_t bytes[2];

	get(sub, bytes, 2);
	return bytes[0] | (unsigned)bytes[1] << 8;
}

static unsigned get_big_endian(uint8_t sub)
{
	uint8_t bytes[2];

	get(sub, bytes, 2);
	return bytes[1] | (unsigned)bytes[0] << 8;
}

static void wait_ms(double ms)
{
	w->now_ns += (int64_t)(1e6 * ms);
}

static int little(const uint8_t *bytes)
{
	return (int16_t)(bytes[0] | bytes[1] << 8);
}

static int big(const uint8_t *bytes)
{
	return (int16_t)(bytes[1] | bytes[0] << 8);
}

/* A period of the nominal rate, as long as the simulated oscillator of the gyro makes it. */
static double period_ms(double hz)
{
	return 1e3 / hz / (1 + w->config.rate_error[IMU_CHIP_GYRO]);
}

/* ---- LSM9DS1 ----------------------------------------------------------------------------------------------------- */

/* STATUS_REG: GDA 02h and XLDA 01h, with TDA 04h; reading the last data register of either clears it. */
static void test_the_lsm9ds1_shows_which_sensor_has_a_new_sample(void **state)
{
	uint8_t bytes[6];

	(void)state;
	board("lsm9ds1", "rest");
	assert_int_equal(get_one(0x17) & 3, 0);
	put(0x10, 0x60); /* 119 Hz */
	wait_ms(20);
	assert_int_equal(get_one(0x17), 0x07);
	assert_int_equal(get_one(0x27), 0x07);
	get(0x18, bytes, 6);
	assert_int_equal(get_one(0x17), 0x05);
	get(0x28, bytes, 6);
	assert_int_equal(get_one(0x17), 0x04);
	assert_true(fabs(little(bytes + 4) * 0.061e-3 * G - 9.81) < 0.01);
	world_free(w);
}

/* FIFO_SRC: FSS, up to 32, and OVRN 40h. A set is done with when both its halves have been read. */
static void test_the_fifo_of_the_lsm9ds1_has_sets_of_both_sensors(void **state)
{
	uint8_t gyro[6], accel[6], newest[12];

	(void)state;
	board("lsm9ds1", "tumble");
	put(0x10, 0x68); /* 119 Hz, 500 dps */
	put(0x23, 0x02); /* FIFO_EN */
	put(0x2E, 0xC0); /* continuous */
	assert_int_equal(get_one(0x2F), 0);
	wait_ms(5.5 * period_ms(119));
	assert_int_equal(get_one(0x2F), 5);
	get(0x18, gyro, 6);
	assert_int_equal(get_one(0x2F), 5);
	get(0x28, accel, 6);
	assert_int_equal(get_one(0x2F), 4);
	wait_ms(28 * period_ms(119));
	assert_int_equal(get_one(0x2F), 32);
	wait_ms(period_ms(119));
	assert_int_equal(get_one(0x2F), 0x40 | 32);
	memcpy(newest, sim_board_registers(w->sim, IMU_CHIP_GYRO) + 0x18, 6);
	memcpy(newest + 6, sim_board_registers(w->sim, IMU_CHIP_GYRO) + 0x28, 6);
	for (int left = 31; left >= 0; left--) {
		get(0x18, gyro, 6);
		get(0x28, accel, 6);
		w->now_ns -= (3 + 3 + 12) * 22500; /* as if it took no time */
		assert_int_equal(get_one(0x2F), left);
		w->now_ns -= (3 + 1) * 22500;
	}
	assert_memory_equal(gyro, newest, 6);
	assert_memory_equal(accel, newest + 6, 6);
	put(0x2E, 0x00); /* bypass */
	wait_ms(50);
	assert_int_equal(get_one(0x2F), 0);
	put(0x2E, 0xC0);
	put(0x23, 0x00); /* off */
	wait_ms(50);
	assert_int_equal(get_one(0x2F), 0);
	world_free(w);
}

/* ---- ICM-42688-P ------------------------------------------------------------------------------------------------- */

static void test_the_icm42688_clears_data_ready_when_that_is_read(void **state)
{
	uint8_t bytes[6];

	(void)state;
	board("icm42688", "rest");
	put(0x4E, 0x0F); /* both on, 1 kHz */
	put(0x4F, 0x08); /* 100 Hz */
	put(0x50, 0x08);
	get_one(0x2D);
	wait_ms(15);
	get(0x1F, bytes, 6);
	assert_true(fabs(big(bytes + 4) * 16. / 32768 * G - 9.81) < 0.01);
	assert_int_equal(get_one(0x2D), 0x08);
	assert_int_equal(get_one(0x2D), 0x00);
	world_free(w);
}

/* FIFO_COUNT in bytes, of packets of 16: header 68h, accelerometer, gyro. An empty FIFO gives FFh. It has 2 KB. */
static void test_the_fifo_of_the_icm42688_has_packets_of_16_bytes(void **state)
{
	uint8_t packet[32], newest[12];

	(void)state;
	board("icm42688", "tumble");
	put(0x4E, 0x0F);
	put(0x4F, 0x08);
	put(0x50, 0x08);
	put(0x5F, 0x07); /* accelerometer, gyro, temperature */
	put(0x16, 0x40); /* stream */
	wait_ms(5.5 * period_ms(100));
	for (unsigned left = 5; left > 0; left--) {
		assert_int_equal(get_big_endian(0x2E), 16 * left);
		memcpy(newest, sim_board_registers(w->sim, IMU_CHIP_ACCEL) + 0x1F, 12);
		get(0x30, packet, 16);
		assert_int_equal(packet[0], 0x68);
	}
	assert_memory_equal(packet + 1, newest, 12);
	assert_int_equal(get_big_endian(0x2E), 0);
	get(0x30, packet, 2);
	assert_int_equal(packet[0], 0xFF);
	assert_int_equal(packet[1], 0xFF);
	wait_ms(130.5 * period_ms(100));
	assert_int_equal(get_big_endian(0x2E), 2048);
	get(0x30, packet, 32); /* FIFO_DATA does not count on */
	assert_int_equal(packet[16], 0x68);
	assert_int_equal(get_big_endian(0x2E), 2048 - 32);
	put(0x4B, 0x01);
	assert_int_equal(get_big_endian(0x2E), 2048 - 32);
	put(0x4B, 0x02); /* FIFO_FLUSH, which clears itself */
	assert_int_equal(get_big_endian(0x2E), 0);
	assert_int_equal(get_one(0x4B), 0);
	world_free(w);
}

/* ---- ICM-20948 and AK09916 --------------------------------------------------------------------------------------- */

static void wake_icm20948(void)
{
	put(0x06, 0x01);
	put(0x7F, 0x20);
	put(0x00, 10); /* 1125 Hz / 11 */
	put(0x11, 10);
	put(0x7F, 0x00);
}

/* REG_BANK_SEL: the same addresses mean other registers in each bank. */
static void test_the_banks_of_the_icm20948_are_apart(void **state)
{
	(void)state;
	board("icm20948", "rest");
	for (unsigned bank = 1; bank < 4; bank++) {
		put(0x7F, (uint8_t)(bank << 4));
		put(0x06, (uint8_t)(0xA0 | bank));
		put(0x00, (uint8_t)bank);
	}
	put(0x7F, 0x00);
	assert_int_equal(get_one(0x00), 0xEA);
	assert_int_equal(get_one(0x06), 0x41);
	for (unsigned bank = 1; bank < 4; bank++) {
		put(0x7F, (uint8_t)(bank << 4));
		assert_int_equal(get_one(0x7F), bank << 4);
		assert_int_equal(get_one(0x06), 0xA0 | bank);
		assert_int_equal(get_one(0x00), bank);
		assert_int_equal(sim_board_bank(w->sim, IMU_CHIP_GYRO, bank)[6], 0xA0 | bank);
	}
	world_free(w);
}

static void test_the_icm20948_clears_data_ready_when_that_is_read(void **state)
{
	uint8_t bytes[6];

	(void)state;
	board("icm20948", "rest");
	wake_icm20948();
	get_one(0x1A);
	wait_ms(15);
	get(0x2D, bytes, 6);
	assert_true(fabs(big(bytes + 4) * 2. / 32768 * G - 9.81) < 0.01);
	assert_int_equal(get_one(0x1A), 0x01);
	assert_int_equal(get_one(0x1A), 0x00);
	world_free(w);
}

/* 512 bytes without packets' limits: 12 of them, accelerometer and gyro, make a set. */
static void test_the_fifo_of_the_icm20948_has_bytes(void **state)
{
	uint8_t bytes[512], newest[12];

	(void)state;
	board("icm20948", "tumble");
	wake_icm20948();
	put(0x67, 0x1E);
	put(0x03, 0x40);
	assert_int_equal(get_big_endian(0x70), 0);
	wait_ms(5.5 * period_ms(1125. / 11));
	assert_int_equal(get_big_endian(0x70), 12 * 5);
	get(0x72, bytes, 7);
	assert_int_equal(get_big_endian(0x70), 12 * 5 - 7);
	wait_ms(60 * period_ms(1125. / 11));
	assert_int_equal(get_big_endian(0x70), 512);
	memcpy(newest, sim_board_registers(w->sim, IMU_CHIP_ACCEL) + 0x2D, 12);
	for (int i = 0; i < 512; i += 32)
		get(0x72, bytes + i, 32);
	assert_int_equal(get_big_endian(0x70) % 12, 0); /* whole sets came meanwhile */
	/* 512 is 42 sets and 8 bytes, so the oldest begins within a set, and the newest is the last */
	assert_memory_equal(bytes + 500, newest, 12);
	put(0x68, 0x00);
	wait_ms(20);
	assert_true(get_big_endian(0x70) > 0);
	put(0x68, 0x1F);
	assert_int_equal(get_big_endian(0x70), 0);
	get(0x72, bytes, 1);
	assert_int_equal(bytes[0], 0xFF);
	world_free(w);
}

/* ST1: DRDY 01h, and DOR 02h when a sample was lost. From the first data register on they stay until ST2 is read. */
static void test_the_ak09916_keeps_the_data_that_are_being_read(void **state)
{
	uint8_t first[6], second[8];

	(void)state;
	board("icm20948", "figure");
	put(0x0F, 0x02);
	chip = IMU_CHIP_MAG;
	assert_int_equal(get_word(0x00), 0x0948);
	put(0x31, 0x08); /* 100 Hz */
	assert_int_equal(get_one(0x10), 0);
	wait_ms(12);
	assert_int_equal(get_one(0x10), 0x01);
	wait_ms(10);
	assert_int_equal(get_one(0x10), 0x03);
	wait_ms(1000);
	get(0x11, first, 6);
	get_one(0x17);
	assert_int_equal(get_one(0x10), 0x03);
	wait_ms(1000);
	get(0x11, second, 8); /* to ST2 */
	assert_memory_equal(first, second, 6);
	assert_int_equal(get_one(0x10), 0);
	wait_ms(1000);
	get(0x11, second, 8);
	assert_memory_not_equal(first, second, 6);
	put(0x31, 0x00);
	assert_int_equal(get_one(0x10), 0);
	world_free(w);
}

/* On the bus with BYPASS_EN and without I2C_MST_EN, and never on SPI. */
static void test_the_ak09916_is_there_when_the_icm20948_connects_it(void **state)
{
	uint8_t byte;

	(void)state;
	for (int bypass = 0; bypass < 2; bypass++)
		for (int host = 0; host < 2; host++) {
			board("icm20948", "rest");
			put(0x0F, bypass ? 0x02 : 0xFD);
			put(0x03, host ? 0x20 : 0xDF);
			assert_int_equal(i2c_read(w->bus, 0x0C, 0x01, &byte, 1), bypass && !host ? 0 : -ENXIO);
			world_free(w);
		}
	board("icm20948/spi", "rest");
	put(0x0F, 0x02);
	assert_int_equal(i2c_read(w->bus, 1, 0x81, &byte, 1), 0);
	assert_int_equal(byte, 0xFF);
	world_free(w);
}

/* ---- BMI270 ------------------------------------------------------------------------------------------------------ */

static void wake_bmi270(void)
{
	world_load_bmi270(w);
	put(0x40, 0xA8); /* 100 Hz */
	put(0x42, 0xA8);
	put(0x7D, 0x0E);
}

/* STATUS: drdy_acc 80h, drdy_gyr 40h, cmd_rdy 10h. */
static void test_the_bmi270_shows_which_sensor_has_a_new_sample(void **state)
{
	uint8_t bytes[6];

	(void)state;
	board("bmi270", "rest");
	assert_int_equal(get_one(0x03), 0x10);
	wake_bmi270();
	wait_ms(15);
	assert_int_equal(get_one(0x03), 0xD0);
	get(0x12, bytes, 6);
	assert_int_equal(get_one(0x03), 0x90);
	get(0x0C, bytes, 6);
	assert_int_equal(get_one(0x03), 0x10);
	assert_true(fabs(little(bytes + 4) * 8. / 32768 * G - 9.81) < 0.01);
	world_free(w);
}

/* FIFO_LENGTH in bytes, of frames of 13: header 8Ch, gyro, accelerometer. Frames that are lost are counted in a skip
 * frame, 40h, of two bytes, before the others. */
static void test_the_fifo_of_the_bmi270_counts_lost_frames(void **state)
{
	uint8_t frame[26], newest[12];

	(void)state;
	board("bmi270", "tumble");
	wake_bmi270();
	put(0x49, 0xD0);
	assert_int_equal(get_word(0x24), 0);
	wait_ms(5.5 * period_ms(100));
	assert_int_equal(get_word(0x24), 13 * 5);
	get(0x26, frame, 13);
	assert_int_equal(frame[0], 0x8C);
	assert_int_equal(get_word(0x24), 13 * 4);
	for (int k = 0; k < 4; k++) {
		memcpy(newest, sim_board_registers(w->sim, IMU_CHIP_GYRO) + 0x12, 6);
		memcpy(newest + 6, sim_board_registers(w->sim, IMU_CHIP_GYRO) + 0x0C, 6);
		get(0x26, frame, 13);
	}
	assert_memory_equal(frame + 1, newest, 12);
	assert_int_equal(get_one(0x26), 0xFF);
	put(0x7E, 0xB0); /* fifo_flush: whatever came meanwhile */
	assert_int_equal(get_one(0x7E), 0);
	wait_ms(158 * period_ms(100));
	/* 157 frames are 2041 bytes. With the 158th the oldest is lost, and a skip frame fits: 2043 bytes. */
	assert_int_equal(get_word(0x24), 2043);
	get(0x26, frame, 15);
	assert_int_equal(frame[0], 0x40);
	assert_int_equal(frame[1], 1);
	assert_int_equal(frame[2], 0x8C);
	assert_int_equal(get_word(0x24), 2043 - 15);
	wait_ms(4 * period_ms(100));
	assert_int_equal(get_one(0x26), 0x40);
	put(0x7E, 0xB0);
	wait_ms(1000 * period_ms(100));
	get(0x26, frame, 2);
	assert_int_equal(frame[0], 0x40);
	assert_int_equal(frame[1], 3); /* 160 at most are simulated at once */
	world_free(w);
}

/* INTERNAL_STATUS: 0 until INIT_CTRL has been 1 for some time, then 1, or 2 for a file with a gap. */
static void test_the_bmi270_checks_its_configuration_file(void **state)
{
	(void)state;
	board("bmi270", "rest");
	assert_int_equal(get_one(0x21), 0);
	world_load_bmi270(w);
	assert_int_equal(get_one(0x21), 1);
	put(0x7E, 0xB6); /* softreset */
	assert_int_equal(get_one(0x21), 0);
	put(0x7C, 0x00);
	put(0x59, 0x00);
	put(0x5B, 0x00);
	put(0x5C, 0x00);
	put(0x59, 0x01); /* without a file */
	wait_ms(5);
	assert_int_equal(get_one(0x21), 0);
	wait_ms(15);
	assert_int_equal(get_one(0x21), 2);
	put(0x7D, 0x0E);
	wait_ms(100);
	assert_int_equal(get_one(0x03), 0x10);
	world_free(w);
}

/* PWR_CONF: with adv_power_save nothing but PWR_CONF, PWR_CTRL and CMD can be written. A soft reset brings that and all
 * other defaults back. */
static void test_the_bmi270_takes_no_settings_while_it_saves_power(void **state)
{
	(void)state;
	board("bmi270", "rest");
	put(0x40, 0x57);
	assert_int_equal(get_one(0x40), 0xA8);
	put(0x7D, 0x04);
	assert_int_equal(get_one(0x7D), 0x04);
	put(0x7C, 0x02);
	put(0x40, 0x57);
	assert_int_equal(get_one(0x40), 0x57);
	put(0x7E, 0xB0);
	assert_int_equal(get_one(0x40), 0x57);
	put(0x7E, 0xB6);
	assert_int_equal(get_one(0x40), 0xA8);
	assert_int_equal(get_one(0x7C), 0x03);
	assert_int_equal(get_one(0x7D), 0x00);
	world_free(w);
}

/* Sensors that were switched on before begin with the configuration file. */
static void test_the_bmi270_measures_as_soon_as_its_configuration_file_is_accepted(void **state)
{
	(void)state;
	board("bmi270", "rest");
	put(0x7D, 0x0E);
	wait_ms(50);
	assert_int_equal(get_one(0x03), 0x10);
	world_load_bmi270(w);
	wait_ms(20);
	assert_int_equal(get_one(0x03), 0xD0);
	world_free(w);
}

/* ---- all --------------------------------------------------------------------------------------------------------- */

/* 30 degC: 16 digits/K from 25 degC, 132.48 from 25, 333.87 from 21, 512 from 23. */
static void test_the_temperature_is_30_degrees(void **state)
{
	(void)state;
	board("icm20948", "rest");
	assert_int_equal(get_big_endian(0x39), lround(9 * 333.87));
	world_free(w);
	board("lsm9ds1", "rest");
	assert_int_equal(get_word(0x15), 5 * 16);
	world_free(w);
	board("icm42688", "rest");
	assert_int_equal(get_big_endian(0x1D), lround(5 * 132.48));
	world_free(w);
	board("bmi270", "rest");
	assert_int_equal(get_word(0x22), 7 * 512);
	world_free(w);
}

/* Identities, status, data and FIFO keep what they have. */
static void test_what_cannot_be_written(void **state)
{
	static const struct {
		const char *board;
		uint8_t regs[10]; /* ends with two equal ones */
	} chips[] = {{"lsm9ds1", {0x0F, 0x17, 0x18, 0x1D, 0x27, 0x28, 0x2D, 0x2F, 0x2F}},
		{"icm42688", {0x75, 0x2D, 0x2E, 0x2F, 0x1F, 0x24, 0x25, 0x2A, 0x2A}},
		{"icm20948", {0x00, 0x1A, 0x70, 0x71, 0x2D, 0x32, 0x33, 0x38, 0x38}},
		{"bmi270", {0x00, 0x03, 0x21, 0x24, 0x25, 0x0C, 0x11, 0x12, 0x17, 0x17}}};

	(void)state;
	for (size_t i = 0; i < sizeof chips / sizeof *chips; i++) {
		board(chips[i].board, "rest");
		if (strcmp(chips[i].board, "bmi270") == 0)
			put(0x7C, 0x00);
		for (int k = 0; k == 0 || chips[i].regs[k] != chips[i].regs[k - 1]; k++) {
			const unsigned before = get_one(chips[i].regs[k]);

			put(chips[i].regs[k], (uint8_t)~before);
			if (get_one(chips[i].regs[k]) != before)
				fail_msg("%s, register %02X", chips[i].board, chips[i].regs[k]);
		}
		world_free(w);
	}
	board("icm20948", "rest");
	put(0x0F, 0x02);
	chip = IMU_CHIP_MAG;
	put(0x01, 0xFF);
	put(0x2F, 0xFF);
	put(0x30, 0x5A);
	assert_int_equal(get_one(0x01), 0x09);
	assert_int_equal(get_one(0x2F), 0x00);
	assert_int_equal(get_one(0x30), 0x5A);
	world_free(w);
}

/* A transfer of several bytes goes on to the next register, without or with a bit in the sub-address. */
static void test_a_transfer_of_several_bytes_counts(void **state)
{
	static const struct {
		const char *board;
		enum imu_chip chip;
		uint8_t reg, multiple; /* two registers that can be written */
	} chips[] = {{"lsm9ds1", IMU_CHIP_GYRO, 0x1E, 0}, {"lsm9ds1", IMU_CHIP_MAG, 0x20, 0x80},
		{"icm42688", IMU_CHIP_GYRO, 0x4F, 0}, {"icm20948", IMU_CHIP_GYRO, 0x06, 0},
		{"bmi270", IMU_CHIP_GYRO, 0x40, 0}, {"v0", IMU_CHIP_ACCEL, 0x22, 0x80},
		{"v3", IMU_CHIP_MAG, 0x24, 0x80}, {"v2", IMU_CHIP_ACCEL, 0x22, 0x80}, {"v6", IMU_CHIP_GYRO, 0x18, 0},
		{"v5", IMU_CHIP_MAG, 0x20, 0x80}};
	const uint8_t values[2] = {0x12, 0x34};

	(void)state;
	for (size_t i = 0; i < sizeof chips / sizeof *chips; i++) {
		const uint8_t sub = chips[i].reg | chips[i].multiple;
		uint8_t bytes[2];

		board(chips[i].board, "rest");
		put(0x7C, 0x00); /* of the BMI270; nothing in the others */
		chip = chips[i].chip;
		assert_int_equal(i2c_write_block(w->bus, sim_board_address(w->sim, chip), sub, values, 2), 0);
		get(sub, bytes, 2);
		assert_memory_equal(bytes, values, 2);
		assert_int_equal(get_one(chips[i].reg), values[0]);
		assert_int_equal(get_one(chips[i].reg + 1), values[1]);
		if (chips[i].multiple) {
			get(chips[i].reg, bytes, 2);
			assert_int_equal(bytes[1], values[0]);
		}
		world_free(w);
	}
	board("lsm9ds1", "rest");
	put(0x22, 0x00); /* without IF_ADD_INC */
	assert_int_equal(get_word(0x0F), 0x6868);
	world_free(w);
}

/* On SPI a read has bit 7, a transfer of several bytes of ST's chips bit 6; the BMI270 sends a byte of its own first.
 * No chip pulls the line: ones. */
static void test_transfers_on_spi(void **state)
{
	uint8_t bytes[4];

	(void)state;
	board("v3/spi", "rest");
	assert_int_equal(sim_board_address(w->sim, IMU_CHIP_GYRO), 0);
	assert_int_equal(sim_board_address(w->sim, IMU_CHIP_ACCEL), 1);
	assert_int_equal(get_one(0x8F), 0xD7);
	put(0x22, 0x12);
	put(0x23, 0x34);
	get(0xC0 | 0x22, bytes, 2);
	assert_int_equal(bytes[0], 0x12);
	assert_int_equal(bytes[1], 0x34);
	get(0x80 | 0x22, bytes, 2);
	assert_int_equal(bytes[1], 0x12);
	assert_int_equal(i2c_read(w->bus, 2, 0x8F, bytes, 4), 0);
	for (int i = 0; i < 4; i++)
		assert_int_equal(bytes[i], 0xFF);
	assert_int_equal(i2c_write(w->bus, 2, 0x20, 0x0F), 0);
	world_free(w);

	board("icm42688/spi", "rest");
	assert_int_equal(get_one(0x80 | 0x75), 0x47);
	world_free(w);

	board("bmi270/spi", "rest");
	get(0x80, bytes, 2);
	assert_int_not_equal(bytes[0], 0x24);
	assert_int_equal(bytes[1], 0x24);
	put(0x7C, 0x00); /* a write has no such byte */
	get(0x80 | 0x7C, bytes, 2);
	assert_int_equal(bytes[1], 0x00);
	world_free(w);
}

/* ST_G and ST_XL of the LSM9DS1's CTRL_REG10, and ACC_SELF_TEST of the BMI270, whose sign and amplitude are set:
 * typical values in dps and mg; the simulation has chosen their signs. */
static void test_self_tests_move_the_output(void **state)
{
	static const struct {
		const char *board;
		uint8_t reg, on, data;
		double digit; /* mdps, mg */
		double by[3];
	} tests[] = {{"lsm9ds1", 0x24, 0x04, 0x18, 70, {500e3, 500e3, 500e3}},
		{"lsm9ds1", 0x24, 0x01, 0x28, 0.061, {700, -700, 700}},
		{"bmi270", 0x6D, 0x0D, 0x0C, 16e3 / 32768, {9000, -9000, 6300}},
		{"bmi270", 0x6D, 0x09, 0x0C, 16e3 / 32768, {-9000, 9000, -6300}},
		{"bmi270", 0x6D, 0x05, 0x0C, 16e3 / 32768, {1000, -1000, 700}},
		{"bmi270", 0x6D, 0x0C, 0x0C, 16e3 / 32768, {0, 0, 0}}};

	(void)state;
	for (size_t i = 0; i < sizeof tests / sizeof *tests; i++) {
		uint8_t before[6], after[6];

		board(tests[i].board, "rest");
		if (strcmp(tests[i].board, "bmi270") == 0) {
			wake_bmi270();
			put(0x41, 0x03);
		} else {
			put(0x10, 0x78);
		}
		wait_ms(50);
		get(tests[i].data, before, 6);
		put(tests[i].reg, tests[i].on);
		wait_ms(50);
		get(tests[i].data, after, 6);
		for (int axis = 0; axis < 3; axis++) {
			const double moved = little(after + 2 * axis) - little(before + 2 * axis);

			if (fabs(moved - tests[i].by[axis] / tests[i].digit) > 2)
				fail_msg("row %zu, axis %d: %g digits", i, axis, moved);
		}
		world_free(w);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_lsm9ds1_shows_which_sensor_has_a_new_sample),
		cmocka_unit_test(test_the_fifo_of_the_lsm9ds1_has_sets_of_both_sensors),
		cmocka_unit_test(test_the_icm42688_clears_data_ready_when_that_is_read),
		cmocka_unit_test(test_the_fifo_of_the_icm42688_has_packets_of_16_bytes),
		cmocka_unit_test(test_the_banks_of_the_icm20948_are_apart),
		cmocka_unit_test(test_the_icm20948_clears_data_ready_when_that_is_read),
		cmocka_unit_test(test_the_fifo_of_the_icm20948_has_bytes),
		cmocka_unit_test(test_the_ak09916_keeps_the_data_that_are_being_read),
		cmocka_unit_test(test_the_ak09916_is_there_when_the_icm20948_connects_it),
		cmocka_unit_test(test_the_bmi270_shows_which_sensor_has_a_new_sample),
		cmocka_unit_test(test_the_fifo_of_the_bmi270_counts_lost_frames),
		cmocka_unit_test(test_the_bmi270_checks_its_configuration_file),
		cmocka_unit_test(test_the_bmi270_takes_no_settings_while_it_saves_power),
		cmocka_unit_test(test_the_bmi270_measures_as_soon_as_its_configuration_file_is_accepted),
		cmocka_unit_test(test_the_temperature_is_30_degrees),
		cmocka_unit_test(test_what_cannot_be_written),
		cmocka_unit_test(test_a_transfer_of_several_bytes_counts),
		cmocka_unit_test(test_transfers_on_spi),
		cmocka_unit_test(test_self_tests_move_the_output),
	};

	return cmocka_run_group_tests_name("sim_pairs", tests, NULL, NULL);
}
