/* LSM6DS33 (DocID027423) and LSM6DSO (DS12140): accelerometer and gyro on one oscillator, sampled together. LIS3MDL
 * (DocID024204): the magnetometer on the same boards. LSM9DS1 (DocID025715): another accelerometer and gyro, and a
 * magnetometer like the LIS3MDL at an address of its own. */
#include "drivers/imu/pololu/chips.h"
#include "model/math/units.h"

/* the code contains FS_G and FS_125 at their places in CTRL2_G */
static const struct chip_range GYRO_RANGES[] = {{125, 4.375e-3 * RAD_PER_DEG, 0, 0x02},
	{250, 8.75e-3 * RAD_PER_DEG, 0, 0x00}, {500, 17.5e-3 * RAD_PER_DEG, 0, 0x04},
	{1000, 35e-3 * RAD_PER_DEG, 0, 0x08}, {2000, 70e-3 * RAD_PER_DEG, 0, 0x0C}, {.full_scale = 0}};
static const struct chip_range ACCEL_RANGES[] = {{2, 0.061 * M_S2_PER_MG, 0, 0x00}, {4, 0.122 * M_S2_PER_MG, 0, 0x08},
	{8, 0.244 * M_S2_PER_MG, 0, 0x0C}, {16, 0.488 * M_S2_PER_MG, 0, 0x04}, {.full_scale = 0}};
static const struct chip_rate RATES[] = {
	{104, 4, {52}}, {208, 5, {104}}, {416, 6, {208}}, {833, 7, {416}}, {1660, 8, {830}}, {.hz = 0}};

static void common(const struct chip_setup *setup, struct chip_registers *out)
{
	unsigned rate = (unsigned)setup->rate->code << 4;

	chip_put(out, 0x0D, setup->data_ready ? 0x02 : 0x00); /* INT1_DRDY_G */
	chip_put(out, 0x12, 0x44);			      /* BDU, IF_INC */
	chip_put(out, 0x14, 0x00);			      /* no self-test, no rounding */
	chip_put(out, 0x10, rate | setup->range[1]->code);
	chip_put(out, 0x11, rate | setup->range[0]->code);
}

static void ds33(const struct chip_setup *setup, struct chip_registers *out)
{
	chip_put(out, 0x0A, 0x00); /* bypass: empties the FIFO */
	common(setup, out);
	chip_put(out, 0x08, setup->fifo ? 0x09 : 0x00); /* gyro and accelerometer, each sample */
	chip_put(out, 0x0A, setup->fifo ? (unsigned)setup->rate->code << 3 | 0x06 : 0x00); /* continuous */
}

static void dso(const struct chip_setup *setup, struct chip_registers *out)
{
	chip_put(out, 0x0A, 0x00);
	common(setup, out);
	chip_put(out, 0x09, setup->fifo ? (unsigned)setup->rate->code * 0x11u : 0x00); /* batch both */
	chip_put(out, 0x0A, setup->fifo ? 0x06 : 0x00);
}

#define EACH(value)                 \
	{                           \
		value, value, value \
	}
/* Limits of the self-test, the gyro's at 2000 deg/s: mechanical characteristics in the data sheets. */
#define LSM6(chip_name, who, fifo_kind, digits_per_degC, put, accel_noise, gyro_noise, least_mg)                     \
	{                                                                                                            \
		.name = (chip_name), .addresses = {0x6B, 0x6A}, .identity_at = 0x0F, .identity = {who},              \
		.identity_size = 1, .spi = {.has = true}, .status = 0x1E, .ready = 0x02, .data = 0x22,               \
		.data_size = 12, .fifo = (fifo_kind), .rates = RATES,                                                \
		.triads = {{.what = IMU_CHIP_GYRO,                                                                   \
				   .ranges = GYRO_RANGES,                                                            \
				   .order = {0, 1, 2},                                                               \
				   .density = (gyro_noise)*RAD_PER_DEG,                                              \
				   .self_test = {0x14, 0x0C, 0x04, .widest = true, .least = EACH(150 * RAD_PER_DEG), \
					   .most = EACH(700 * RAD_PER_DEG)}},                                        \
			{.what = IMU_CHIP_ACCEL,                                                                     \
				.ranges = ACCEL_RANGES,                                                              \
				.byte = 6,                                                                           \
				.order = {0, 1, 2},                                                                  \
				.density = (accel_noise)*1e-6 * STANDARD_GRAVITY_M_S2,                               \
				.self_test = {0x14, 0x03, 0x01, .least = EACH((least_mg)*M_S2_PER_MG),               \
					.most = EACH(1700 * M_S2_PER_MG)}}},                                         \
		.triad_count = 2, .temperature = {0x20, 2, 1.0 / (digits_per_degC), 25}, .registers = (put)          \
	}

const struct chip CHIP_LSM6DS33 = LSM6("LSM6DS33", 0x69, CHIP_FIFO_WORDS, 16, ds33, 90, 0.007, 90);
const struct chip CHIP_LSM6DSO = LSM6("LSM6DSO", 0x6C, CHIP_FIFO_TAGGED, 256, dso, 70, 0.0038, 50);

static const struct chip_range FIELD[] = {{400, UT_PER_GAUSS / 6842, 0, 0x00}, {800, UT_PER_GAUSS / 3421, 0, 0x20},
	{1200, UT_PER_GAUSS / 2281, 0, 0x40}, {1600, UT_PER_GAUSS / 1711, 0, 0x60}, {.full_scale = 0}};
static const struct chip_rate FIELD_RATES[] = {{10, 4, {5}}, {20, 5, {10}}, {40, 6, {20}}, {80, 7, {40}}, {.hz = 0}};

static void lis3mdl(const struct chip_setup *setup, struct chip_registers *out)
{
	chip_put(out, 0x20, 0xE0u | (unsigned)setup->rate->code << 2); /* temperature, ultra-high performance */
	chip_put(out, 0x21, setup->range[0]->code);
	chip_put(out, 0x23, 0x0C); /* z: ultra-high performance */
	chip_put(out, 0x24, 0x40); /* BDU */
	chip_put(out, 0x22, 0x00); /* continuous */
}

#define LIKE_LIS3MDL(chip_name, field, against)                                                                \
	{                                                                                                      \
		.name = (chip_name), .addresses = {0x1E, 0x1C}, .identity_at = 0x0F, .identity = {0x3D},       \
		.identity_size = 1, .increment = 0x80, .spi = {.has = true, .multiple = 0x40}, .status = 0x27, \
		.ready = 0x08, .overrun = 0x80, .data = 0x28, .data_size = 6, .rates = FIELD_RATES,            \
		.triads = {{.what = IMU_CHIP_MAG,                                                              \
			.ranges = (field),                                                                     \
			.order = {0, 1, 2},                                                                    \
			.negative = (against),                                                                 \
			.density = 0.05}},                                                                     \
		.triad_count = 1, .registers = lis3mdl                                                         \
	}

const struct chip CHIP_LIS3MDL = LIKE_LIS3MDL("LIS3MDL", FIELD, 0);

/* ---- LSM9DS1 ----------------------------------------------------------------------------------------------------- */

/* the code contains FS at its place in CTRL_REG1_G and CTRL_REG6_XL */
static const struct chip_range GYRO_RANGES_9[] = {{245, 8.75e-3 * RAD_PER_DEG, 0, 0x00},
	{500, 17.5e-3 * RAD_PER_DEG, 0, 0x08}, {2000, 70e-3 * RAD_PER_DEG, 0, 0x18}, {.full_scale = 0}};
static const struct chip_range ACCEL_RANGES_9[] = {{2, 0.061 * M_S2_PER_MG, 0, 0x00}, {4, 0.122 * M_S2_PER_MG, 0, 0x10},
	{8, 0.244 * M_S2_PER_MG, 0, 0x18}, {16, 0.732 * M_S2_PER_MG, 0, 0x08}, {.full_scale = 0}};
static const struct chip_range FIELD_9[] = {{400, 0.014, 0, 0x00}, {800, 0.029, 0, 0x20}, {1200, 0.043, 0, 0x40},
	{1600, 0.058, 0, 0x60}, {.full_scale = 0}};
/* bandwidth codes that the data sheet does not list have the value of the next lower one */
static const struct chip_rate RATES_9[] = {{59.5, 2, {16}}, {119, 3, {14, 31}}, {238, 4, {14, 29, 63, 78}},
	{476, 5, {21, 28, 57, 100}}, {952, 6, {33, 40, 58, 100}}, {.hz = 0}};

static void lsm9ds1(const struct chip_setup *setup, struct chip_registers *out)
{
	unsigned rate = (unsigned)setup->rate->code << 5;

	chip_put(out, 0x2E, 0x00);						   /* bypass: empties the FIFO */
	chip_put(out, 0x0C, setup->data_ready ? 0x02 : 0x00);			   /* DRDY_G */
	chip_put(out, 0x22, 0x44);						   /* BDU, IF_ADD_INC */
	chip_put(out, 0x23, (setup->fifo ? 0x02u : 0) | (setup->spi ? 0x04u : 0)); /* FIFO_EN, I2C_DISABLE */
	chip_put(out, 0x24, 0x00);						   /* no self-test */
	chip_put(out, 0x11, 0x02);						   /* output behind LPF2 */
	chip_put(out, 0x20, rate | setup->range[1]->code);
	chip_put(out, 0x10, rate | setup->range[0]->code | setup->bandwidth_code);
	chip_put(out, 0x2E, setup->fifo ? 0xC0 : 0x00); /* continuous */
}

/* The axes of gyro and accelerometer are left-handed, those of the magnetometer are not: its x points against theirs.
 * The board has x and z of the accelerometer. The data sheet gives no noise; that of the LSM6DS0, the same chip without
 * magnetometer, is taken. Limits of the self-test: the manufacturer's example. */
const struct chip CHIP_LSM9DS1 = {.name = "LSM9DS1",
	.addresses = {0x6B, 0x6A},
	.identity_at = 0x0F,
	.identity = {0x68},
	.identity_size = 1,
	.spi = {.has = true},
	.status = 0x17,
	.ready = 0x02,
	.data = 0x18,
	.data_size = 22, /* 18h-1Dh and 28h-2Dh */
	.fifo = CHIP_FIFO_PAIRS,
	.rates = RATES_9,
	.triads = {{.what = IMU_CHIP_GYRO,
			   .ranges = GYRO_RANGES_9,
			   .order = {0, 1, 2},
			   .negative = 2,
			   .density = 0.007 * RAD_PER_DEG,
			   .self_test = {0x24, 0x04, 0x04, .widest = true, .least = EACH(200 * RAD_PER_DEG),
				   .most = EACH(800 * RAD_PER_DEG)}},
		{.what = IMU_CHIP_ACCEL,
			.ranges = ACCEL_RANGES_9,
			.byte = 16,
			.order = {0, 1, 2},
			.negative = 2,
			.density = 90e-6 * STANDARD_GRAVITY_M_S2,
			.self_test = {0x24, 0x01, 0x01, .least = EACH(70 * M_S2_PER_MG),
				.most = EACH(1500 * M_S2_PER_MG)}}},
	.triad_count = 2,
	.temperature = {0x15, 2, 1.0 / 16, 25},
	.registers = lsm9ds1};

const struct chip CHIP_LSM9DS1_MAG = LIKE_LIS3MDL("LSM9DS1", FIELD_9, 3);
