/* What the driver says of the chips (drivers/imu/pololu/chips.h), against their data sheets: noise densities, status
 * bits, temperature sensors, transfers, and the bandwidths that follow from the rates. test_i2c_board.c has the
 * registers, the digits, the rates and the filters of the gyros. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>
#include <math.h>

#include "drivers/imu/pololu/chips.h"

static void assert_near(const char *name, double value, double expected)
{
	if (!(fabs(value - expected) <= 1e-6 * fabs(expected)))
		fail_msg("%s: %.9g, expected %.9g", name, value, expected);
}

/* Gyros in deg/s, accelerometers in ug, magnetometers in uT, each by the root of Hz: "rate noise density",
 * "acceleration noise density"; of magnetometers the RMS noise or the resolution. */
static void test_the_noise_is_that_of_the_data_sheets(void **state)
{
	static const struct {
		const struct chip *chip;
		double gyro_deg_s, accel_ug, mag_uT;
	} chips[] = {{&CHIP_L3G4200D, 0.03, 0, 0}, {&CHIP_L3GD20, 0.03, 0, 0}, {&CHIP_L3GD20H, 0.011, 0, 0},
		{&CHIP_LSM303DLH_ACCEL, 0, 218, 0}, {&CHIP_LSM303DLHC_ACCEL, 0, 220, 0},
		{&CHIP_LSM303DLH_MAG, 0, 0, 0.033}, {&CHIP_LSM303DLM_MAG, 0, 0, 0.033},
		{&CHIP_LSM303DLHC_MAG, 0, 0, 0.033}, {&CHIP_LSM303D_ACCEL, 0, 150, 0}, {&CHIP_LSM303D_MAG, 0, 0, 0.05},
		{&CHIP_LSM6DS33, 0.007, 90, 0}, {&CHIP_LSM6DSO, 0.0038, 70, 0}, {&CHIP_LIS3MDL, 0, 0, 0.05},
		{&CHIP_LSM9DS1, 0.007, 90, 0}, {&CHIP_LSM9DS1_MAG, 0, 0, 0.05}, {&CHIP_ICM20948, 0.015, 230, 0},
		{&CHIP_AK09916, 0, 0, 0.02}, {&CHIP_ICM42688P, 0.0028, 65, 0}, {&CHIP_BMI270, 0.007, 160, 0}};

	(void)state;
	for (size_t i = 0; i < sizeof chips / sizeof *chips; i++)
		for (size_t t = 0; t < chips[i].chip->triad_count; t++) {
			const struct chip_triad *triad = &chips[i].chip->triads[t];

			assert_near(chips[i].chip->name, triad->density,
				triad->what == IMU_CHIP_GYRO	? chips[i].gyro_deg_s * acos(-1) / 180
				: triad->what == IMU_CHIP_ACCEL ? chips[i].accel_ug * 9.80665e-6
								: chips[i].mag_uT);
		}
}

/* "Data available" and "overrun": ZYXDA and ZYXOR, GDA, RDY, DRDY and DOR, drdy_gyr, DATA_RDY_INT. A read of several
 * registers has bit 7 of the sub-address on I2C, bit 6 on SPI; others count by themselves. */
static void test_status_and_transfers_are_those_of_the_data_sheets(void **state)
{
	static const struct {
		const struct chip *chip;
		uint8_t status, ready, overrun, data, increment, multiple, dummy;
	} chips[] = {{&CHIP_L3G4200D, 0x27, 0x08, 0x80, 0x28, 0x80, 0x40, 0},
		{&CHIP_L3GD20, 0x27, 0x08, 0x80, 0x28, 0x80, 0x40, 0},
		{&CHIP_L3GD20H, 0x27, 0x08, 0x80, 0x28, 0x80, 0x40, 0},
		{&CHIP_LSM303DLH_ACCEL, 0x27, 0x08, 0x80, 0x28, 0x80, 0, 0},
		{&CHIP_LSM303DLHC_ACCEL, 0x27, 0x08, 0x80, 0x28, 0x80, 0, 0},
		{&CHIP_LSM303DLH_MAG, 0x09, 0x01, 0, 0x03, 0, 0, 0},
		{&CHIP_LSM303DLM_MAG, 0x09, 0x01, 0, 0x03, 0, 0, 0},
		{&CHIP_LSM303DLHC_MAG, 0x09, 0x01, 0, 0x03, 0, 0, 0},
		{&CHIP_LSM303D_ACCEL, 0x27, 0x08, 0x80, 0x28, 0x80, 0x40, 0},
		{&CHIP_LSM303D_MAG, 0x07, 0x08, 0x80, 0x08, 0x80, 0x40, 0},
		{&CHIP_LSM6DS33, 0x1E, 0x02, 0, 0x22, 0, 0, 0}, {&CHIP_LSM6DSO, 0x1E, 0x02, 0, 0x22, 0, 0, 0},
		{&CHIP_LIS3MDL, 0x27, 0x08, 0x80, 0x28, 0x80, 0x40, 0}, {&CHIP_LSM9DS1, 0x17, 0x02, 0, 0x18, 0, 0, 0},
		{&CHIP_LSM9DS1_MAG, 0x27, 0x08, 0x80, 0x28, 0x80, 0x40, 0},
		{&CHIP_ICM20948, 0x1A, 0x01, 0, 0x2D, 0, 0, 0}, {&CHIP_AK09916, 0x10, 0x01, 0x02, 0x11, 0, 0, 0},
		{&CHIP_ICM42688P, 0x2D, 0x08, 0, 0x1F, 0, 0, 0}, {&CHIP_BMI270, 0x03, 0x40, 0, 0x0C, 0, 0, 1}};

	(void)state;
	for (size_t i = 0; i < sizeof chips / sizeof *chips; i++) {
		const struct chip *c = chips[i].chip;

		assert_int_equal(c->status, chips[i].status);
		assert_int_equal(c->ready, chips[i].ready);
		assert_int_equal(c->overrun, chips[i].overrun);
		assert_int_equal(c->data, chips[i].data);
		assert_int_equal(c->increment, chips[i].increment);
		assert_int_equal(c->spi.multiple, chips[i].multiple);
		assert_int_equal(c->spi.dummy, chips[i].dummy);
	}
}

/* Digits per degree, and the temperature at zero. That of the old gyros falls by a digit per degree. */
static void test_temperature_sensors_are_those_of_the_data_sheets(void **state)
{
	static const struct {
		const struct chip *chip;
		uint8_t address, size;
		double zero_degC, digits;
	} chips[] = {{&CHIP_L3G4200D, 0x26, 1, 25, -1}, {&CHIP_L3GD20, 0x26, 1, 25, -1},
		{&CHIP_L3GD20H, 0x26, 1, 25, -1}, {&CHIP_LSM6DS33, 0x20, 2, 25, 16}, {&CHIP_LSM6DSO, 0x20, 2, 25, 256},
		{&CHIP_LSM9DS1, 0x15, 2, 25, 16}, {&CHIP_ICM20948, 0x39, 2, 21, 333.87},
		{&CHIP_ICM42688P, 0x1D, 2, 25, 132.48}, {&CHIP_BMI270, 0x22, 2, 23, 512}};

	(void)state;
	for (size_t i = 0; i < sizeof chips / sizeof *chips; i++) {
		assert_int_equal(chips[i].chip->temperature.address, chips[i].address);
		assert_int_equal(chips[i].chip->temperature.size, chips[i].size);
		assert_near(chips[i].chip->name, chips[i].chip->temperature.zero_degC, chips[i].zero_degC);
		assert_near(chips[i].chip->name, chips[i].chip->temperature.per_digit, 1 / chips[i].digits);
	}
}

/* Addresses with SA0 (SDO, AD0, SAG) low and high, WHO_AM_I; of the DLH and the DLHC IRA, IRB and IRC, of the AK09916
 * WIA1 and WIA2. The first accelerometers have none. */
static void test_addresses_and_identities_are_those_of_the_data_sheets(void **state)
{
	static const struct {
		const struct chip *chip;
		uint8_t addresses[2], at;
		size_t size;
		uint8_t identity[3];
	} chips[] = {{&CHIP_AK09916, {0x0C, 0}, 0x00, 2, {0x48, 0x09, 0x00}},
		{&CHIP_BMI270, {0x68, 0x69}, 0x00, 1, {0x24, 0, 0}},
		{&CHIP_ICM20948, {0x69, 0x68}, 0x00, 1, {0xEA, 0, 0}},
		{&CHIP_ICM42688P, {0x68, 0x69}, 0x75, 1, {0x47, 0, 0}},
		{&CHIP_L3G4200D, {0x69, 0x68}, 0x0F, 1, {0xD3, 0, 0}},
		{&CHIP_L3GD20, {0x6B, 0x6A}, 0x0F, 1, {0xD4, 0, 0}},
		{&CHIP_L3GD20H, {0x6B, 0x6A}, 0x0F, 1, {0xD7, 0, 0}},
		{&CHIP_LIS3MDL, {0x1E, 0x1C}, 0x0F, 1, {0x3D, 0, 0}},
		{&CHIP_LSM303DLHC_ACCEL, {0x19, 0}, 0x00, 0, {0x00, 0, 0}},
		{&CHIP_LSM303DLHC_MAG, {0x1E, 0}, 0x0A, 3, {0x48, 0x34, 0x33}},
		{&CHIP_LSM303DLH_ACCEL, {0x18, 0x19}, 0x00, 0, {0x00, 0, 0}},
		{&CHIP_LSM303DLH_MAG, {0x1E, 0}, 0x0A, 3, {0x48, 0x34, 0x33}},
		{&CHIP_LSM303DLM_MAG, {0x1E, 0}, 0x0F, 1, {0x3C, 0, 0}},
		{&CHIP_LSM303D_ACCEL, {0x1D, 0x1E}, 0x0F, 1, {0x49, 0, 0}},
		{&CHIP_LSM303D_MAG, {0x1D, 0x1E}, 0x0F, 1, {0x49, 0, 0}},
		{&CHIP_LSM6DS33, {0x6B, 0x6A}, 0x0F, 1, {0x69, 0, 0}},
		{&CHIP_LSM6DSO, {0x6B, 0x6A}, 0x0F, 1, {0x6C, 0, 0}},
		{&CHIP_LSM9DS1, {0x6B, 0x6A}, 0x0F, 1, {0x68, 0, 0}},
		{&CHIP_LSM9DS1_MAG, {0x1E, 0x1C}, 0x0F, 1, {0x3D, 0, 0}}};

	(void)state;
	for (size_t i = 0; i < sizeof chips / sizeof *chips; i++) {
		assert_memory_equal(chips[i].chip->addresses, chips[i].addresses, 2);
		assert_int_equal(chips[i].chip->identity_at, chips[i].at);
		assert_int_equal(chips[i].chip->identity_size, chips[i].size);
		assert_memory_equal(chips[i].chip->identity, chips[i].identity, chips[i].size);
	}
}

/* Full scale in deg/s, g and uT; a digit of the 16-bit word in mdps, mg and mgauss, of z if it differs; the code FS, at
 * its place in the register where that differs from bit to bit. Left-justified words of 12 bits: a sixteenth. */
static void test_ranges_are_those_of_the_data_sheets(void **state)
{
	static const struct {
		const struct chip *chip;
		size_t triad;
		struct {
			double full_scale, digit, z;
			uint8_t code;
		} ranges[8];
	} triads[] = {{&CHIP_AK09916, 0, {{4912, 1.5, 0, 0x00}}},
		{&CHIP_BMI270, 0,
			{{125, 3.8147, 0, 0x04}, {250, 7.62939, 0, 0x03}, {500, 15.2588, 0, 0x02},
				{1000, 30.5176, 0, 0x01}, {2000, 61.0352, 0, 0x00}}},
		{&CHIP_BMI270, 1,
			{{2, 0.0610352, 0, 0x00}, {4, 0.12207, 0, 0x01}, {8, 0.244141, 0, 0x02},
				{16, 0.488281, 0, 0x03}}},
		{&CHIP_ICM20948, 0,
			{{250, 7.62939, 0, 0x00}, {500, 15.2588, 0, 0x02}, {1000, 30.5176, 0, 0x04},
				{2000, 61.0352, 0, 0x06}}},
		{&CHIP_ICM20948, 1,
			{{2, 0.0610352, 0, 0x00}, {4, 0.12207, 0, 0x02}, {8, 0.244141, 0, 0x04},
				{16, 0.488281, 0, 0x06}}},
		{&CHIP_ICM42688P, 0,
			{{125, 3.8147, 0, 0x80}, {250, 7.62939, 0, 0x60}, {500, 15.2588, 0, 0x40},
				{1000, 30.5176, 0, 0x20}, {2000, 61.0352, 0, 0x00}}},
		{&CHIP_ICM42688P, 1,
			{{2, 0.0610352, 0, 0x60}, {4, 0.12207, 0, 0x40}, {8, 0.244141, 0, 0x20},
				{16, 0.488281, 0, 0x00}}},
		{&CHIP_L3G4200D, 0, {{250, 8.75, 0, 0x00}, {500, 17.5, 0, 0x01}, {2000, 70, 0, 0x02}}},
		{&CHIP_L3GD20, 0, {{250, 8.75, 0, 0x00}, {500, 17.5, 0, 0x01}, {2000, 70, 0, 0x02}}},
		{&CHIP_L3GD20H, 0, {{245, 8.75, 0, 0x00}, {500, 17.5, 0, 0x01}, {2000, 70, 0, 0x02}}},
		{&CHIP_LIS3MDL, 0,
			{{400, 0.146156, 0, 0x00}, {800, 0.292312, 0, 0x20}, {1200, 0.438404, 0, 0x40},
				{1600, 0.584454, 0, 0x60}}},
		{&CHIP_LSM303DLHC_ACCEL, 0,
			{{2, 0.0625, 0, 0x00}, {4, 0.125, 0, 0x01}, {8, 0.25, 0, 0x02}, {16, 0.75, 0, 0x03}}},
		{&CHIP_LSM303DLHC_MAG, 0,
			{{130, 0.909091, 1.02041, 0x20}, {190, 1.16959, 1.31579, 0x40}, {250, 1.49254, 1.66667, 0x60},
				{400, 2.22222, 2.5, 0x80}, {470, 2.5, 2.8169, 0xA0}, {560, 3.0303, 3.38983, 0xC0},
				{810, 4.34783, 4.87805, 0xE0}}},
		{&CHIP_LSM303DLH_ACCEL, 0, {{2, 0.0625, 0, 0x00}, {4, 0.125, 0, 0x01}, {8, 0.24375, 0, 0x03}}},
		{&CHIP_LSM303DLH_MAG, 0,
			{{130, 0.947867, 1.05263, 0x20}, {190, 1.25786, 1.40845, 0x40}, {250, 1.5748, 1.75439, 0x60},
				{400, 2.32558, 2.5974, 0x80}, {470, 2.66667, 2.98507, 0xA0},
				{560, 3.125, 3.50877, 0xC0}, {810, 4.34783, 4.87805, 0xE0}}},
		{&CHIP_LSM303DLM_MAG, 0,
			{{130, 0.909091, 1.02041, 0x20}, {190, 1.16959, 1.31579, 0x40}, {250, 1.49254, 1.66667, 0x60},
				{400, 2.22222, 2.5, 0x80}, {470, 2.5, 2.8169, 0xA0}, {560, 3.0303, 3.38983, 0xC0},
				{810, 4.34783, 4.87805, 0xE0}}},
		{&CHIP_LSM303D_ACCEL, 0,
			{{2, 0.061, 0, 0x00}, {4, 0.122, 0, 0x01}, {6, 0.183, 0, 0x02}, {8, 0.244, 0, 0x03},
				{16, 0.732, 0, 0x04}}},
		{&CHIP_LSM303D_MAG, 0,
			{{200, 0.08, 0, 0x00}, {400, 0.16, 0, 0x20}, {800, 0.32, 0, 0x40}, {1200, 0.479, 0, 0x60}}},
		{&CHIP_LSM6DS33, 0,
			{{125, 4.375, 0, 0x02}, {250, 8.75, 0, 0x00}, {500, 17.5, 0, 0x04}, {1000, 35, 0, 0x08},
				{2000, 70, 0, 0x0C}}},
		{&CHIP_LSM6DS33, 1,
			{{2, 0.061, 0, 0x00}, {4, 0.122, 0, 0x08}, {8, 0.244, 0, 0x0C}, {16, 0.488, 0, 0x04}}},
		{&CHIP_LSM6DSO, 0,
			{{125, 4.375, 0, 0x02}, {250, 8.75, 0, 0x00}, {500, 17.5, 0, 0x04}, {1000, 35, 0, 0x08},
				{2000, 70, 0, 0x0C}}},
		{&CHIP_LSM6DSO, 1,
			{{2, 0.061, 0, 0x00}, {4, 0.122, 0, 0x08}, {8, 0.244, 0, 0x0C}, {16, 0.488, 0, 0x04}}},
		{&CHIP_LSM9DS1, 0, {{245, 8.75, 0, 0x00}, {500, 17.5, 0, 0x08}, {2000, 70, 0, 0x18}}},
		{&CHIP_LSM9DS1, 1,
			{{2, 0.061, 0, 0x00}, {4, 0.122, 0, 0x10}, {8, 0.244, 0, 0x18}, {16, 0.732, 0, 0x08}}},
		{&CHIP_LSM9DS1_MAG, 0,
			{{400, 0.14, 0, 0x00}, {800, 0.29, 0, 0x20}, {1200, 0.43, 0, 0x40}, {1600, 0.58, 0, 0x60}}}};

	(void)state;
	for (size_t i = 0; i < sizeof triads / sizeof *triads; i++) {
		const struct chip_triad *t = &triads[i].chip->triads[triads[i].triad];
		const double unit = t->what == IMU_CHIP_GYRO	? 1e-3 * acos(-1) / 180
				    : t->what == IMU_CHIP_ACCEL ? 9.80665e-3
								: 0.1;
		size_t k = 0;

		for (; triads[i].ranges[k].full_scale > 0; k++) {
			const struct chip_range *r = &t->ranges[k];

			assert_near(triads[i].chip->name, r->full_scale, triads[i].ranges[k].full_scale);
			if (fabs(r->step / unit - triads[i].ranges[k].digit) > 1e-5 * triads[i].ranges[k].digit)
				fail_msg("%s, %g: digit %g", triads[i].chip->name, r->full_scale, r->step / unit);
			if (fabs(r->step_z / unit - triads[i].ranges[k].z) > 1e-5 * triads[i].ranges[k].z)
				fail_msg(
					"%s, %g: digit of z %g", triads[i].chip->name, r->full_scale, r->step_z / unit);
			assert_int_equal(r->code, triads[i].ranges[k].code);
		}
		assert_true(t->ranges[k].full_scale == 0);
	}
}

/* FIFO count, FIFO data, size and header of a packet with both sensors, and what empties it: FIFO_RST, FIFO_FLUSH of
 * SIGNAL_PATH_RESET, the command fifo_flush. */
static void test_packets_are_those_of_the_data_sheets(void **state)
{
	static const struct {
		const struct chip *chip;
		uint8_t level, window, size, header, mask, gyro, accel;
		uint16_t level_mask, depth;
		struct chip_register flush[2];
	} chips[] = {{&CHIP_BMI270, 0x24, 0x26, 13, 0x8C, 0xFC, 1, 7, 0x3FFF, 2048, {{0x7E, 0xB0, 0}}},
		{&CHIP_ICM20948, 0x70, 0x72, 12, 0, 0, 6, 0, 0x1FFF, 512, {{0x68, 0x1F, 0}, {0x68, 0x00, 0}}},
		{&CHIP_ICM42688P, 0x2E, 0x30, 16, 0x60, 0xF0, 7, 1, 0xFFFF, 2048, {{0x4B, 0x02, 0}}}};

	(void)state;
	for (size_t i = 0; i < sizeof chips / sizeof *chips; i++) {
		const struct chip_packets *p = &chips[i].chip->packets;

		assert_int_equal(p->level, chips[i].level);
		assert_int_equal(p->window, chips[i].window);
		assert_int_equal(p->size, chips[i].size);
		assert_int_equal(p->header, chips[i].header);
		assert_int_equal(p->mask, chips[i].mask);
		assert_int_equal(p->at[0], chips[i].gyro);
		assert_int_equal(p->at[1], chips[i].accel);
		assert_int_equal(p->level_mask, chips[i].level_mask);
		assert_int_equal(p->depth, chips[i].depth);
		assert_memory_equal(p->flush, chips[i].flush, sizeof p->flush);
	}
}

/* ST bits: what they are in, their mask, and their value for the test; the BMI270 is excited to both sides in turn. */
static void test_self_tests_are_switched_on_as_in_the_data_sheets(void **state)
{
	static const struct {
		const struct chip *chip;
		size_t triad;
		uint8_t address, mask, on, before;
		bool widest;
	} tests[] = {{&CHIP_L3G4200D, 0, 0x23, 0x06, 0x02, 0, true}, {&CHIP_L3GD20, 0, 0x23, 0x06, 0x02, 0, true},
		{&CHIP_L3GD20H, 0, 0x23, 0x06, 0x02, 0, true}, {&CHIP_LSM303DLH_ACCEL, 0, 0x23, 0x0A, 0x02, 0, false},
		{&CHIP_LSM303D_ACCEL, 0, 0x21, 0x02, 0x02, 0, false}, {&CHIP_LSM6DS33, 0, 0x14, 0x0C, 0x04, 0, true},
		{&CHIP_LSM6DS33, 1, 0x14, 0x03, 0x01, 0, false}, {&CHIP_LSM6DSO, 0, 0x14, 0x0C, 0x04, 0, true},
		{&CHIP_LSM6DSO, 1, 0x14, 0x03, 0x01, 0, false}, {&CHIP_LSM9DS1, 0, 0x24, 0x04, 0x04, 0, true},
		{&CHIP_LSM9DS1, 1, 0x24, 0x01, 0x01, 0, false}, {&CHIP_BMI270, 1, 0x6D, 0x0D, 0x0D, 0x09, true}};

	(void)state;
	for (size_t i = 0; i < sizeof tests / sizeof *tests; i++) {
		const struct chip_self_test *t = &tests[i].chip->triads[tests[i].triad].self_test;

		assert_int_equal(t->address, tests[i].address);
		assert_int_equal(t->mask, tests[i].mask);
		assert_int_equal(t->on, tests[i].on);
		assert_int_equal(t->before, tests[i].before);
		assert_int_equal(t->widest, tests[i].widest);
	}
}

/* Output data rates that the driver uses, with their codes: ODR, DR, DO, SMPLRT_DIV, MODE. */
static void test_rates_and_their_codes_are_those_of_the_data_sheets(void **state)
{
	static const struct {
		const struct chip *chip;
		struct {
			double hz;
			uint8_t code;
		} rates[9]; /* ends with 0 Hz */
	} chips[] = {{&CHIP_L3G4200D, {{100, 0}, {200, 1}, {400, 2}, {800, 3}}},
		{&CHIP_L3GD20, {{95, 0}, {190, 1}, {380, 2}, {760, 3}}},
		{&CHIP_L3GD20H, {{100, 0}, {200, 1}, {400, 2}, {800, 3}}},
		{&CHIP_LSM303DLH_ACCEL, {{50, 0}, {100, 1}, {400, 2}, {1000, 3}}},
		{&CHIP_LSM303DLHC_ACCEL, {{10, 2}, {25, 3}, {50, 4}, {100, 5}, {200, 6}, {400, 7}, {1344, 9}}},
		{&CHIP_LSM303DLH_MAG, {{7.5, 3}, {15, 4}, {30, 5}, {75, 6}}},
		{&CHIP_LSM303DLM_MAG, {{7.5, 3}, {15, 4}, {30, 5}, {75, 6}}},
		{&CHIP_LSM303DLHC_MAG, {{7.5, 3}, {15, 4}, {30, 5}, {75, 6}}},
		{&CHIP_LSM303D_ACCEL,
			{{12.5, 3}, {25, 4}, {50, 5}, {100, 6}, {200, 7}, {400, 8}, {800, 9}, {1600, 10}}},
		{&CHIP_LSM303D_MAG, {{6.25, 1}, {12.5, 2}, {25, 3}, {50, 4}}},
		{&CHIP_LSM6DS33, {{104, 4}, {208, 5}, {416, 6}, {833, 7}, {1660, 8}}},
		{&CHIP_LSM6DSO, {{104, 4}, {208, 5}, {416, 6}, {833, 7}, {1660, 8}}},
		{&CHIP_LIS3MDL, {{10, 4}, {20, 5}, {40, 6}, {80, 7}}},
		{&CHIP_LSM9DS1, {{59.5, 2}, {119, 3}, {238, 4}, {476, 5}, {952, 6}}},
		{&CHIP_LSM9DS1_MAG, {{10, 4}, {20, 5}, {40, 6}, {80, 7}}},
		{&CHIP_ICM20948, {{1125. / 22, 21}, {1125. / 11, 10}, {225, 4}, {562.5, 1}, {1125, 0}}},
		{&CHIP_AK09916, {{10, 2}, {20, 4}, {50, 6}, {100, 8}}},
		{&CHIP_ICM42688P, {{50, 9}, {100, 8}, {200, 7}, {500, 15}, {1000, 6}, {2000, 5}}},
		{&CHIP_BMI270, {{50, 7}, {100, 8}, {200, 9}, {400, 10}, {800, 11}, {1600, 12}}}};

	(void)state;
	for (size_t i = 0; i < sizeof chips / sizeof *chips; i++) {
		size_t k = 0;

		for (; chips[i].rates[k].hz > 0; k++) {
			assert_near(chips[i].chip->name, chips[i].chip->rates[k].hz, chips[i].rates[k].hz);
			assert_int_equal(chips[i].chip->rates[k].code, chips[i].rates[k].code);
		}
		assert_true(chips[i].chip->rates[k].hz == 0);
	}
}

/* Low-pass at half of the rate where there is no filter to choose. */
static void test_a_sensor_without_filters_has_half_of_its_rate_as_bandwidth(void **state)
{
	static const struct chip *const chips[] = {&CHIP_LSM303DLHC_ACCEL, &CHIP_LSM303DLH_MAG, &CHIP_LSM303DLM_MAG,
		&CHIP_LSM303DLHC_MAG, &CHIP_LSM6DS33, &CHIP_LSM6DSO, &CHIP_LIS3MDL, &CHIP_LSM9DS1_MAG, &CHIP_AK09916};

	(void)state;
	for (size_t i = 0; i < sizeof chips / sizeof *chips; i++)
		for (const struct chip_rate *rate = chips[i]->rates; rate->hz > 0; rate++) {
			if (fabs(rate->bandwidth_hz[0] - rate->hz / 2) > 0.5)
				fail_msg("%s: %g Hz at %g Hz", chips[i]->name, rate->bandwidth_hz[0], rate->hz);
			assert_true(rate->bandwidth_hz[1] == 0);
		}
}

static void assert_bandwidths(const struct chip *chip, size_t i, const double expected[CHIP_BANDWIDTHS])
{
	for (size_t code = 0; code < CHIP_BANDWIDTHS; code++)
		assert_near(chip->name, chip->rates[i].bandwidth_hz[code], expected[code]);
}

/* LSM303DLH: cut-off by DR. LSM303D: anti-alias filter by ABW, at all rates. */
static void test_filters_of_accelerometers_are_those_of_the_data_sheets(void **state)
{
	static const double cut_off[] = {37, 74, 292, 780}, anti_alias[CHIP_BANDWIDTHS] = {773, 194, 362, 50};

	(void)state;
	for (size_t i = 0; i < 4; i++)
		assert_bandwidths(&CHIP_LSM303DLH_ACCEL, i, (const double[CHIP_BANDWIDTHS]){cut_off[i]});
	for (size_t i = 0; i < 8; i++)
		assert_bandwidths(&CHIP_LSM303D_ACCEL, i, anti_alias);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_noise_is_that_of_the_data_sheets),
		cmocka_unit_test(test_status_and_transfers_are_those_of_the_data_sheets),
		cmocka_unit_test(test_temperature_sensors_are_those_of_the_data_sheets),
		cmocka_unit_test(test_addresses_and_identities_are_those_of_the_data_sheets),
		cmocka_unit_test(test_ranges_are_those_of_the_data_sheets),
		cmocka_unit_test(test_packets_are_those_of_the_data_sheets),
		cmocka_unit_test(test_self_tests_are_switched_on_as_in_the_data_sheets),
		cmocka_unit_test(test_rates_and_their_codes_are_those_of_the_data_sheets),
		cmocka_unit_test(test_a_sensor_without_filters_has_half_of_its_rate_as_bandwidth),
		cmocka_unit_test(test_filters_of_accelerometers_are_those_of_the_data_sheets),
	};

	return cmocka_run_group_tests_name("i2c_chips", tests, NULL, NULL);
}
