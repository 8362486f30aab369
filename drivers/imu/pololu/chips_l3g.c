/* Gyros L3G4200D (Doc ID 17116), L3GD20 (022116), L3GD20H (023469): one register map. */
#include "drivers/imu/pololu/chips.h"
#include "model/math/units.h"

static const struct chip_range RANGES[] = {{250, 8.75e-3 * RAD_PER_DEG, 0, 0}, {500, 17.5e-3 * RAD_PER_DEG, 0, 1},
	{2000, 70e-3 * RAD_PER_DEG, 0, 2}, {.full_scale = 0}};
static const struct chip_range RANGES_H[] = {{245, 8.75e-3 * RAD_PER_DEG, 0, 0}, {500, 17.5e-3 * RAD_PER_DEG, 0, 1},
	{2000, 70e-3 * RAD_PER_DEG, 0, 2}, {.full_scale = 0}};

static const struct chip_rate RATES_4200[] = {{100, 0, {12.5, 25}}, {200, 1, {12.5, 25, 50, 70}},
	{400, 2, {20, 25, 50, 110}}, {800, 3, {30, 35, 50, 110}}, {.hz = 0}};
static const struct chip_rate RATES_20[] = {{95, 0, {12.5, 25}}, {190, 1, {12.5, 25, 50, 70}},
	{380, 2, {20, 25, 50, 100}}, {760, 3, {30, 35, 50, 100}}, {.hz = 0}};
/* bandwidth codes that the data sheet does not list have the value of the next lower one */
static const struct chip_rate RATES_20H[] = {{100, 0, {12.5, 25}}, {200, 1, {12.5, 12.5, 12.5, 70}},
	{400, 2, {20, 25, 50, 110}}, {800, 3, {30, 35, 35, 100}}, {.hz = 0}};

static void registers(const struct chip_setup *setup, struct chip_registers *out)
{
	chip_put(out, 0x2E, 0x00);					   /* bypass: empties the FIFO */
	chip_put(out, 0x21, 0x00);					   /* no high-pass */
	chip_put(out, 0x22, setup->data_ready ? 0x08 : 0x00);		   /* I2_DRDY */
	chip_put(out, 0x23, 0x80u | (unsigned)setup->range[0]->code << 4); /* BDU, full scale */
	chip_put(out, 0x24, setup->fifo ? 0x42 : 0x02);			   /* FIFO_EN, Out_Sel: LPF2 */
	chip_put(out, 0x20,
		(unsigned)setup->rate->code << 6 | (unsigned)setup->bandwidth_code << 4 | 0x0F); /* on, all axes */
	chip_put(out, 0x2E, setup->fifo ? 0x40 : 0x00);						 /* stream */
}

static void registers_h(const struct chip_setup *setup, struct chip_registers *out)
{
	chip_put(out, 0x39, 0x00); /* LOW_ODR off */
	registers(setup, out);
}

#define DPS(value)                                                              \
	{                                                                       \
		(value) * RAD_PER_DEG, (value)*RAD_PER_DEG, (value)*RAD_PER_DEG \
	}
/* OUT_TEMP falls by a digit per degree. The data sheets give no zero: 25 degC here; only changes are measured. */
#define L3G(chip_name, first, second, who, rate_list, range_list, noise, least_dps, most_dps, put)             \
	{                                                                                                      \
		.name = (chip_name), .addresses = {first, second}, .identity_at = 0x0F, .identity = {who},     \
		.identity_size = 1, .increment = 0x80, .spi = {.has = true, .multiple = 0x40}, .status = 0x27, \
		.ready = 0x08, .overrun = 0x80, .data = 0x28, .data_size = 6, .fifo = CHIP_FIFO_SETS,          \
		.rates = (rate_list),                                                                          \
		.triads = {{.what = IMU_CHIP_GYRO,                                                             \
			.ranges = (range_list),                                                                \
			.order = {0, 1, 2},                                                                    \
			.density = (noise)*RAD_PER_DEG,                                                        \
			.self_test = {0x23, 0x06, 0x02, .widest = true, .least = DPS(least_dps),               \
				.most = DPS(most_dps)}}},                                                      \
		.triad_count = 1, .temperature = {0x26, 1, -1, 25}, .registers = (put)                         \
	}

/* Self-test: the data sheet of the L3GD20H has limits at 2000 deg/s, those of the others a typical value of 530. */
const struct chip CHIP_L3G4200D = L3G("L3G4200D", 0x69, 0x68, 0xD3, RATES_4200, RANGES, 0.03, 40, 1500, registers);
const struct chip CHIP_L3GD20 = L3G("L3GD20", 0x6B, 0x6A, 0xD4, RATES_20, RANGES, 0.03, 40, 1500, registers);
const struct chip CHIP_L3GD20H = L3G("L3GD20H", 0x6B, 0x6A, 0xD7, RATES_20H, RANGES_H, 0.011, 200, 800, registers_h);
