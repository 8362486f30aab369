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
		cmocka_unit_test(test_a_sensor_without_filters_has_half_of_its_rate_as_bandwidth),
		cmocka_unit_test(test_filters_of_accelerometers_are_those_of_the_data_sheets),
	};

	return cmocka_run_group_tests_name("i2c_chips", tests, NULL, NULL);
}
