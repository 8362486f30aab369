/* ICM-42688-P (DS-000347), ICM-20948 (DS-000189) with its magnetometer AK09916: big-endian, accelerometer before gyro,
 * FIFOs of packets. */
#include "drivers/imu/pololu/chips.h"

/* ---- ICM-42688-P: the codes are at their places in GYRO_CONFIG0 and ACCEL_CONFIG0 -------------------------------- */

static const struct chip_range GYRO_42688[] = {CHIP_RANGE_DPS(125, 0x80), CHIP_RANGE_DPS(250, 0x60),
	CHIP_RANGE_DPS(500, 0x40), CHIP_RANGE_DPS(1000, 0x20), CHIP_RANGE_DPS(2000, 0x00), {.full_scale = 0}};
static const struct chip_range ACCEL_42688[] = {
	CHIP_RANGE_G(2, 0x60), CHIP_RANGE_G(4, 0x40), CHIP_RANGE_G(8, 0x20), CHIP_RANGE_G(16, 0x00), {.full_scale = 0}};
/* Bandwidths: half the rate, then max(400 Hz, rate) / 4, 5, 8, 10, 16, 20, 40 */
#define FILTERS_42688(hz, base)                                                                                    \
	{                                                                                                          \
		(hz) / 2.0, (base) / 4.0, (base) / 5.0, (base) / 8.0, (base) / 10.0, (base) / 16.0, (base) / 20.0, \
			(base) / 40.0                                                                              \
	}
static const struct chip_rate RATES_42688[] = {{50, 9, FILTERS_42688(50, 400)}, {100, 8, FILTERS_42688(100, 400)},
	{200, 7, FILTERS_42688(200, 400)}, {500, 15, FILTERS_42688(500, 500)}, {1000, 6, FILTERS_42688(1000, 1000)},
	{2000, 5, FILTERS_42688(2000, 2000)}, {.hz = 0}};

static void icm42688p(const struct chip_setup *setup, struct chip_registers *out)
{
	chip_put(out, 0x76, 0x00);				      /* bank 0 */
	chip_put(out, 0x16, 0x00);				      /* bypass: empties the FIFO */
	chip_put(out, 0x4C, setup->spi ? 0x33 : 0x30);		      /* big-endian; on SPI no I2C */
	chip_put(out, 0x14, 0x03);				      /* INT1: pulses, push-pull, active high */
	chip_put(out, 0x64, 0x00);				      /* INT_ASYNC_RESET must be 0 */
	chip_put(out, 0x65, setup->data_ready ? 0x08 : 0x00);	      /* UI_DRDY_INT1_EN */
	chip_put(out, 0x52, (unsigned)setup->bandwidth_code * 0x11u); /* of both */
	chip_put(out, 0x5F, 0x07); /* packets with accelerometer, gyro, temperature */
	chip_put(out, 0x4F, (unsigned)setup->range[0]->code | setup->rate->code);
	chip_put(out, 0x50, (unsigned)setup->range[1]->code | setup->rate->code);
	chip_put(out, 0x16, setup->fifo ? 0x40 : 0x00); /* stream */
	chip_put(out, 0x4E, 0x0F);			/* both on, low noise; no write for 200 us */
}

const struct chip CHIP_ICM42688P = {.name = "ICM-42688-P",
	.addresses = {0x68, 0x69},
	.identity_at = 0x75,
	.identity = {0x47},
	.identity_size = 1,
	.spi = {.has = true},
	.big_endian = true,
	.status = 0x2D, /* cleared by the read */
	.ready = 0x08,
	.data = 0x1F,
	.data_size = 12,
	.fifo = CHIP_FIFO_PACKETS,
	.packets = {.level = 0x2E,
		.level_mask = 0xFFFF,
		.depth = 2048,
		.window = 0x30,
		.size = 16,
		.header = 0x60,
		.mask = 0xF0,
		.at = {7, 1},
		.flush = {{0x4B, 0x02, 0}}},
	.rates = RATES_42688,
	.triads = {{.what = IMU_CHIP_GYRO,
			   .ranges = GYRO_42688,
			   .byte = 6,
			   .order = {0, 1, 2},
			   .density = 0.0028 * RAD_PER_DEG},
		{.what = IMU_CHIP_ACCEL,
			.ranges = ACCEL_42688,
			.order = {0, 1, 2},
			.density = 65e-6 * STANDARD_GRAVITY_M_S2}},
	.triad_count = 2,
	.temperature = {0x1D, 2, 1 / 132.48, 25},
	.registers = icm42688p};

/* ---- ICM-20948: codes at their places in GYRO_CONFIG_1 and ACCEL_CONFIG; those of the rates divide 1125 Hz ------ */

static const struct chip_range GYRO_20948[] = {CHIP_RANGE_DPS(250, 0), CHIP_RANGE_DPS(500, 2), CHIP_RANGE_DPS(1000, 4),
	CHIP_RANGE_DPS(2000, 6), {.full_scale = 0}};
static const struct chip_range ACCEL_20948[] = {
	CHIP_RANGE_G(2, 0), CHIP_RANGE_G(4, 2), CHIP_RANGE_G(8, 4), CHIP_RANGE_G(16, 6), {.full_scale = 0}};
/* of the gyro; those of the accelerometer differ by less than a quarter from code 2 on */
#define FILTERS_20948                                             \
	{                                                         \
		196.6, 151.8, 119.5, 51.2, 23.9, 11.6, 5.7, 361.4 \
	}
static const struct chip_rate RATES_20948[] = {{1125 / 22.0, 21, FILTERS_20948}, {1125 / 11.0, 10, FILTERS_20948},
	{225, 4, FILTERS_20948}, {562.5, 1, FILTERS_20948}, {1125, 0, FILTERS_20948}, {.hz = 0}};

static void icm20948(const struct chip_setup *setup, struct chip_registers *out)
{
	unsigned filter = (unsigned)setup->bandwidth_code << 3 | 1; /* DLPFCFG, FCHOICE */

	chip_put(out, 0x06, 0x01);			/* awake, best clock */
	chip_put(out, 0x67, 0x00);			/* nothing into the FIFO */
	chip_put_bank(out, 2, 0x00, setup->rate->code); /* GYRO_SMPLRT_DIV */
	chip_put_bank(out, 2, 0x01, filter | setup->range[0]->code);
	chip_put_bank(out, 2, 0x09, 0x01); /* ODR_ALIGN_EN */
	chip_put_bank(out, 2, 0x10, 0x00);
	chip_put_bank(out, 2, 0x11, setup->rate->code); /* ACCEL_SMPLRT_DIV */
	chip_put_bank(out, 2, 0x14, filter | setup->range[1]->code);
	chip_put(out, 0x05, 0x00);			      /* no duty cycles */
	chip_put(out, 0x07, 0x00);			      /* all axes on */
	chip_put(out, 0x0F, 0x02);			      /* BYPASS_EN: the AK09916 is on the bus */
	chip_put(out, 0x10, 0x00);			      /* no other interrupts */
	chip_put(out, 0x11, setup->data_ready ? 0x01 : 0x00); /* RAW_DATA_0_RDY_EN */
	chip_put(out, 0x69, 0x00);			      /* FIFO: stream */
	chip_put(out, 0x68, 0x1F);			      /* FIFO_RST on and off */
	chip_put(out, 0x68, 0x00);
	chip_put(out, 0x03, (setup->fifo ? 0x40u : 0) | (setup->spi ? 0x10u : 0)); /* FIFO_EN, I2C_IF_DIS */
	chip_put(out, 0x67, setup->fifo ? 0x1E : 0x00);				   /* accelerometer and gyro */
}

const struct chip CHIP_ICM20948 = {.name = "ICM-20948",
	.addresses = {0x69, 0x68},
	.identity_at = 0x00,
	.identity = {0xEA},
	.identity_size = 1,
	.spi = {.has = true},
	.bank_select = 0x7F,
	.big_endian = true,
	.status = 0x1A, /* cleared by the read */
	.ready = 0x01,
	.data = 0x2D,
	.data_size = 12,
	.fifo = CHIP_FIFO_PACKETS,
	.packets = {.level = 0x70,
		.level_mask = 0x1FFF,
		.depth = 512,
		.window = 0x72,
		.size = 12,
		.at = {6, 0},
		.flush = {{0x68, 0x1F, 0}, {0x68, 0x00, 0}}},
	.rates = RATES_20948,
	.triads = {{.what = IMU_CHIP_GYRO,
			   .ranges = GYRO_20948,
			   .byte = 6,
			   .order = {0, 1, 2},
			   .density = 0.015 * RAD_PER_DEG},
		{.what = IMU_CHIP_ACCEL,
			.ranges = ACCEL_20948,
			.order = {0, 1, 2},
			.density = 230e-6 * STANDARD_GRAVITY_M_S2}},
	.triad_count = 2,
	.temperature = {0x39, 2, 1 / 333.87, 21},
	.registers = icm20948};

/* ---- AK09916: little-endian; the read of ST2 behind the data ends it --------------------------------------------- */

static const struct chip_range FIELD_09916[] = {{4912, 0.15, 0, 0}, {.full_scale = 0}};
static const struct chip_rate FIELD_RATES_09916[] = {
	{10, 0x02, {5}}, {20, 0x04, {10}}, {50, 0x06, {25}}, {100, 0x08, {50}}, {.hz = 0}};

static void ak09916(const struct chip_setup *setup, struct chip_registers *out)
{
	chip_put(out, 0x31, setup->rate->code); /* continuous */
}

/* Its y and z point against those of the ICM-20948. The data sheet gives no noise: a small one, so that equal values
 * are not taken for a fault too soon. */
const struct chip CHIP_AK09916 = {.name = "AK09916",
	.addresses = {0x0C},
	.identity_at = 0x00,
	.identity = {0x48, 0x09},
	.identity_size = 2,
	.status = 0x10,
	.ready = 0x01,
	.overrun = 0x02,
	.data = 0x11,
	.data_size = 8,
	.rates = FIELD_RATES_09916,
	.triads = {{.what = IMU_CHIP_MAG, .ranges = FIELD_09916, .order = {0, 1, 2}, .negative = 6, .density = 0.02}},
	.triad_count = 1,
	.registers = ak09916};
