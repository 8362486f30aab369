/* BMI270 (BST-BMI270-DS000). It measures only after a configuration file of 8192 bytes, which its manufacturer
 * publishes, has been written to it. */
#include "drivers/imu/pololu/board_parts.h"

#include <errno.h>

static const struct chip_range GYRO_RANGES[] = {CHIP_RANGE_DPS(125, 4), CHIP_RANGE_DPS(250, 3), CHIP_RANGE_DPS(500, 2),
	CHIP_RANGE_DPS(1000, 1), CHIP_RANGE_DPS(2000, 0), {.full_scale = 0}};
static const struct chip_range ACCEL_RANGES[] = {
	CHIP_RANGE_G(2, 0), CHIP_RANGE_G(4, 1), CHIP_RANGE_G(8, 2), CHIP_RANGE_G(16, 3), {.full_scale = 0}};
/* bandwidths with fourfold and twofold oversampling and without, about */
#define RATE(hz, code)                                 \
	{                                              \
		hz, code,                              \
		{                                      \
			(hz) * 0.1, (hz)*0.2, (hz)*0.4 \
		}                                      \
	}
static const struct chip_rate RATES[] = {
	RATE(50, 7), RATE(100, 8), RATE(200, 9), RATE(400, 10), RATE(800, 11), RATE(1600, 12), {.hz = 0}};

enum {
	CONFIGURATION = 8192,
	COMMAND = 0x7E,
	SOFT_RESET = 0xB6,
	FLUSH = 0xB0,
	RESET_MS = 3,
	AWAKE_MS = 1,
	LOAD_MS = 150
};

static bool is_loaded(const struct board *b, const struct chip *chip, uint8_t address)
{
	uint8_t status = 0; /* INTERNAL_STATUS */

	return board_read_chip(b, chip, address, 0x21, &status, 1) == 0 && (status & 0x0F) == 1;
}

/* One block at its address, which counts in words of 16 bits; again if a transfer fails. */
static int load_block(struct board *b, uint8_t address, const uint8_t *bytes, size_t at)
{
	const uint8_t words[] = {(uint8_t)(at / 2 & 0x0F), (uint8_t)(at / 2 >> 4)}; /* INIT_ADDR_0 and 1 */
	int result = -EIO;

	for (int tries = 0; tries < 3 && result < 0; tries++) {
		result = i2c_write_block(b->bus, address, 0x5B, words, sizeof words);
		if (result == 0)
			result = i2c_write_block(b->bus, address, 0x5E, bytes + at, I2C_BLOCK_MAX);
	}
	return result;
}

static int load(struct board *b, const struct chip *chip, uint8_t address)
{
	int result = i2c_write(b->bus, address, 0x59, 0); /* INIT_CTRL */

	for (size_t at = 0; at < CONFIGURATION && result == 0; at += I2C_BLOCK_MAX)
		result = load_block(b, address, b->firmware, at);
	if (result == 0)
		result = i2c_write(b->bus, address, 0x59, 1);
	for (int ms = 0; ms < LOAD_MS && result == 0; ms += 5) {
		board_sleep_until(b, board_read_clock(b) + 5 * BOARD_MS);
		if (is_loaded(b, chip, address))
			return 0;
	}
	return result < 0 ? result : -EBADMSG;
}

/* Its registers can be written 0.45 ms after its power saving has been switched off. */
static int prepare(struct board *b, const struct chip *chip, uint8_t address)
{
	uint8_t unused;
	int result = i2c_write(b->bus, address, COMMAND, SOFT_RESET);

	if (result < 0)
		return result;
	board_sleep_until(b, board_read_clock(b) + RESET_MS * BOARD_MS);
	board_read_chip(b, chip, address, 0x00, &unused, 1); /* selects SPI */
	result = i2c_write(b->bus, address, 0x7C, 0x02);
	board_sleep_until(b, board_read_clock(b) + AWAKE_MS * BOARD_MS);
	return result < 0 ? result : load(b, chip, address);
}

static void registers(const struct chip_setup *setup, struct chip_registers *out)
{
	unsigned filter = (unsigned)setup->bandwidth_code << 4 | setup->rate->code;

	chip_put(out, 0x7C, 0x02);	     /* no power saving */
	chip_put(out, 0x40, 0x80u | filter); /* ACC_CONF: performance */
	chip_put(out, 0x41, setup->range[1]->code);
	chip_put(out, 0x42, 0xC0u | filter); /* GYR_CONF: performance */
	chip_put(out, 0x43, setup->range[0]->code);
	chip_put(out, 0x6D, 0x00);			      /* no self-test */
	chip_put(out, 0x45, 0x88);			      /* FIFO: filtered data, each sample */
	chip_put(out, 0x48, 0x00);			      /* the oldest are overwritten, no times */
	chip_put(out, 0x53, setup->data_ready ? 0x0A : 0x00); /* INT1: push-pull, active high */
	chip_put(out, 0x58, setup->data_ready ? 0x04 : 0x00);
	chip_put(out, 0x7D, 0x0E);			/* gyro, accelerometer, temperature */
	chip_put(out, 0x49, setup->fifo ? 0xD0 : 0x10); /* with headers */
}

/* Self-test: +- excitation in the range of 16 g, the difference has no upper limit (manufacturer's driver). */
const struct chip CHIP_BMI270 = {.name = "BMI270",
	.addresses = {0x68, 0x69},
	.identity_at = 0x00,
	.identity = {0x24},
	.identity_size = 1,
	.spi = {.has = true, .dummy = 1},
	.status = 0x03,
	.ready = 0x40,
	.data = 0x0C,
	.data_size = 12,
	.fifo = CHIP_FIFO_PACKETS,
	.packets = {.level = 0x24,
		.level_mask = 0x3FFF,
		.depth = 2048,
		.window = 0x26,
		.size = 13,
		.header = 0x8C,
		.mask = 0xFC,
		.at = {1, 7},
		.flush = {{COMMAND, FLUSH, 0}}},
	.rates = RATES,
	.triads = {{.what = IMU_CHIP_GYRO,
			   .ranges = GYRO_RANGES,
			   .byte = 6,
			   .order = {0, 1, 2},
			   .density = 0.007 * RAD_PER_DEG},
		{.what = IMU_CHIP_ACCEL,
			.ranges = ACCEL_RANGES,
			.order = {0, 1, 2},
			.density = 160e-6 * STANDARD_GRAVITY_M_S2,
			.self_test = {0x6D, 0x0D, 0x0D, .before = 0x09, .widest = true,
				.least = {16 * STANDARD_GRAVITY_M_S2, 15 * STANDARD_GRAVITY_M_S2,
					10 * STANDARD_GRAVITY_M_S2},
				.most = {32 * STANDARD_GRAVITY_M_S2, 32 * STANDARD_GRAVITY_M_S2,
					32 * STANDARD_GRAVITY_M_S2}}}},
	.triad_count = 2,
	.temperature = {0x22, 2, 1.0 / 512, 23},
	.registers = registers,
	.prepare = prepare,
	.firmware_size = CONFIGURATION};
