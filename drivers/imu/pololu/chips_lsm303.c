/* E-compasses LSM303DLH (Doc ID 16941), LSM303DLM (018725), LSM303DLHC (018771), LSM303D (023312). The first three are
 * an accelerometer and a magnetometer with an address each. */
#include "drivers/imu/pololu/chips.h"
#include "model/math/units.h"

/* ---- accelerometer of DLH and DLM: 12 bits, left-justified, a digit of the data sheet is 16 of the word ---------- */

static const struct chip_range DLH_RANGES[] = {{2, 1 * M_S2_PER_MG / 16, 0, 0}, {4, 2 * M_S2_PER_MG / 16, 0, 1},
	{8, 3.9 * M_S2_PER_MG / 16, 0, 3}, {.full_scale = 0}};
static const struct chip_rate DLH_RATES[] = {
	{50, 0, {37}}, {100, 1, {74}}, {400, 2, {292}}, {1000, 3, {780}}, {.hz = 0}};

static void dlh_accel(const struct chip_setup *setup, struct chip_registers *out)
{
	chip_put(out, 0x21, 0x00); /* no high-pass */
	chip_put(out, 0x22, setup->data_ready ? 0x02 : 0x00);
	chip_put(out, 0x23, 0x80u | (unsigned)setup->range[0]->code << 4); /* BDU */
	chip_put(out, 0x20, 0x27u | (unsigned)setup->rate->code << 3);	   /* normal mode, all axes */
}

/* 19h: with SA0 high, where the DLHC is, too (board_detect.c) */
const struct chip CHIP_LSM303DLH_ACCEL = {.name = "LSM303DLH",
	.addresses = {0x18, 0x19},
	.increment = 0x80,
	.status = 0x27,
	.ready = 0x08,
	.overrun = 0x80,
	.data = 0x28,
	.data_size = 6,
	.rates = DLH_RATES,
	.triads = {{.what = IMU_CHIP_ACCEL,
		.ranges = DLH_RANGES,
		.digit = 16,
		.order = {0, 1, 2},
		.density = 218e-6 * STANDARD_GRAVITY_M_S2,
		.self_test = {0x23, 0x0A, 0x02, .least = {120 * M_S2_PER_MG, 120 * M_S2_PER_MG, 140 * M_S2_PER_MG},
			.most = {550 * M_S2_PER_MG, 550 * M_S2_PER_MG, 750 * M_S2_PER_MG}}}},
	.triad_count = 1,
	.registers = dlh_accel};

/* ---- accelerometer of the DLHC: 12 bits in its high-resolution mode ---------------------------------------------- */

static const struct chip_range DLHC_RANGES[] = {{2, 1 * M_S2_PER_MG / 16, 0, 0}, {4, 2 * M_S2_PER_MG / 16, 0, 1},
	{8, 4 * M_S2_PER_MG / 16, 0, 2}, {16, 12 * M_S2_PER_MG / 16, 0, 3}, {.full_scale = 0}};
static const struct chip_rate DLHC_RATES[] = {{10, 2, {5}}, {25, 3, {12.5}}, {50, 4, {25}}, {100, 5, {50}},
	{200, 6, {100}}, {400, 7, {200}}, {1344, 9, {672}}, {.hz = 0}};

static void dlhc_accel(const struct chip_setup *setup, struct chip_registers *out)
{
	chip_put(out, 0x2E, 0x00); /* bypass: empties the FIFO */
	chip_put(out, 0x21, 0x00);
	chip_put(out, 0x22, setup->data_ready ? 0x10 : 0x00);
	chip_put(out, 0x23, 0x88u | (unsigned)setup->range[0]->code << 4); /* BDU, high resolution */
	chip_put(out, 0x24, setup->fifo ? 0x40 : 0x00);
	chip_put(out, 0x20, 0x07u | (unsigned)setup->rate->code << 4);
	chip_put(out, 0x2E, setup->fifo ? 0x80 : 0x00); /* stream */
}

const struct chip CHIP_LSM303DLHC_ACCEL = {.name = "LSM303DLHC",
	.addresses = {0x19},
	.increment = 0x80,
	.status = 0x27,
	.ready = 0x08,
	.overrun = 0x80,
	.data = 0x28,
	.data_size = 6,
	.fifo = CHIP_FIFO_SETS,
	.rates = DLHC_RATES,
	.triads = {{.what = IMU_CHIP_ACCEL,
		.ranges = DLHC_RANGES,
		.digit = 16,
		.order = {0, 1, 2},
		.density = 220e-6 * STANDARD_GRAVITY_M_S2}},
	.triad_count = 1,
	.registers = dlhc_accel};

/* ---- magnetometers of the three: big-endian, address auto-increment ---------------------------------------------- */

/* full scale [gauss], digits per gauss in x and y, in z, GN */
#define GAUSS(full_scale, xy, z, gain)                                                            \
	{                                                                                         \
		(full_scale) * UT_PER_GAUSS, UT_PER_GAUSS / (xy), UT_PER_GAUSS / (z), (gain) << 5 \
	}
static const struct chip_range DLH_FIELD[] = {GAUSS(1.3, 1055, 950, 1), GAUSS(1.9, 795, 710, 2),
	GAUSS(2.5, 635, 570, 3), GAUSS(4.0, 430, 385, 4), GAUSS(4.7, 375, 335, 5), GAUSS(5.6, 320, 285, 6),
	GAUSS(8.1, 230, 205, 7), {.full_scale = 0}};
static const struct chip_range DLHC_FIELD[] = {GAUSS(1.3, 1100, 980, 1), GAUSS(1.9, 855, 760, 2),
	GAUSS(2.5, 670, 600, 3), GAUSS(4.0, 450, 400, 4), GAUSS(4.7, 400, 355, 5), GAUSS(5.6, 330, 295, 6),
	GAUSS(8.1, 230, 205, 7), {.full_scale = 0}};
static const struct chip_rate MAG_RATES[] = {
	{7.5, 3, {3.75}}, {15, 4, {7.5}}, {30, 5, {15}}, {75, 6, {37.5}}, {.hz = 0}};

static void mag_registers(const struct chip_setup *setup, struct chip_registers *out)
{
	chip_put(out, 0x00, (unsigned)setup->rate->code << 2); /* CRA_REG_M */
	chip_put(out, 0x01, setup->range[0]->code);
	chip_put(out, 0x02, 0x00); /* continuous */
}

#define LSM303_MAG(chip_name, at, who, size, field, noise, y, z)                                          \
	{                                                                                                 \
		.name = (chip_name), .addresses = {0x1E}, .identity_at = (at), .identity = who,           \
		.identity_size = (size), .big_endian = true, .status = 0x09, .ready = 0x01, .data = 0x03, \
		.data_size = 6, .rates = MAG_RATES,                                                       \
		.triads = {{.what = IMU_CHIP_MAG,                                                         \
			.ranges = (field),                                                                \
			.order = {0, y, z},                                                               \
			.density = (noise),                                                               \
			.overflow = -4096}},                                                              \
		.triad_count = 1, .registers = mag_registers                                              \
	}
#define H43                   \
	{                     \
		'H', '4', '3' \
	}
#define WHO_DLM      \
	{            \
		0x3C \
	}

/* Noise: 2 mgauss at 75 Hz, the resolution given in their data sheets. The order of the words is x, y, z on the DLH and
 * x, z, y on its successors. */
const struct chip CHIP_LSM303DLH_MAG = LSM303_MAG("LSM303DLH", 0x0A, H43, 3, DLH_FIELD, 0.033, 1, 2);
const struct chip CHIP_LSM303DLM_MAG = LSM303_MAG("LSM303DLM", 0x0F, WHO_DLM, 1, DLHC_FIELD, 0.033, 2, 1);
const struct chip CHIP_LSM303DLHC_MAG = LSM303_MAG("LSM303DLHC", 0x0A, H43, 3, DLHC_FIELD, 0.033, 2, 1);

/* ---- LSM303D: one address, 16 bits; accelerometer and magnetometer sample independently -------------------------- */

static const struct chip_range D_RANGES[] = {{2, 0.061 * M_S2_PER_MG, 0, 0}, {4, 0.122 * M_S2_PER_MG, 0, 1},
	{6, 0.183 * M_S2_PER_MG, 0, 2}, {8, 0.244 * M_S2_PER_MG, 0, 3}, {16, 0.732 * M_S2_PER_MG, 0, 4},
	{.full_scale = 0}};
#define D_FILTERS                 \
	{                         \
		773, 194, 362, 50 \
	}
static const struct chip_rate D_RATES[] = {{12.5, 3, D_FILTERS}, {25, 4, D_FILTERS}, {50, 5, D_FILTERS},
	{100, 6, D_FILTERS}, {200, 7, D_FILTERS}, {400, 8, D_FILTERS}, {800, 9, D_FILTERS}, {1600, 10, D_FILTERS},
	{.hz = 0}};
static const struct chip_range D_FIELD[] = {{200, 0.0080, 0, 0x00}, {400, 0.0160, 0, 0x20}, {800, 0.0320, 0, 0x40},
	{1200, 0.0479, 0, 0x60}, {.full_scale = 0}};
/* not 100 Hz: it requires an accelerometer rate above 50 Hz */
static const struct chip_rate D_MAG_RATES[] = {
	{6.25, 1, {3}}, {12.5, 2, {6}}, {25, 3, {12.5}}, {50, 4, {25}}, {.hz = 0}};

static void d_accel(const struct chip_setup *setup, struct chip_registers *out)
{
	chip_put(out, 0x2E, 0x00);			/* bypass: empties the FIFO */
	chip_put(out, 0x1F, setup->fifo ? 0x40 : 0x00); /* FIFO_EN */
	chip_put(out, 0x21, (unsigned)setup->bandwidth_code << 6 | (unsigned)setup->range[0]->code << 3);
	chip_put(out, 0x22, setup->data_ready ? 0x04 : 0x00);
	chip_put(out, 0x20, 0x0Fu | (unsigned)setup->rate->code << 4); /* BDU, all axes */
	chip_put(out, 0x2E, setup->fifo ? 0x40 : 0x00);		       /* stream */
}

static void d_mag(const struct chip_setup *setup, struct chip_registers *out)
{
	chip_put(out, 0x24, 0xE0u | (unsigned)setup->rate->code << 2); /* temperature, high resolution */
	chip_put(out, 0x25, setup->range[0]->code);
	chip_put(out, 0x26, 0x00); /* continuous */
}

const struct chip CHIP_LSM303D_ACCEL = {.name = "LSM303D",
	.addresses = {0x1D, 0x1E},
	.identity_at = 0x0F,
	.identity = {0x49},
	.identity_size = 1,
	.increment = 0x80,
	.spi = {.has = true, .multiple = 0x40},
	.status = 0x27,
	.ready = 0x08,
	.overrun = 0x80,
	.data = 0x28,
	.data_size = 6,
	.fifo = CHIP_FIFO_SETS,
	.rates = D_RATES,
	.triads = {{.what = IMU_CHIP_ACCEL,
		.ranges = D_RANGES,
		.order = {0, 1, 2},
		.density = 150e-6 * STANDARD_GRAVITY_M_S2,
		.self_test = {0x21, 0x02, 0x02, .least = {70 * M_S2_PER_MG, 70 * M_S2_PER_MG, 70 * M_S2_PER_MG},
			.most = {1700 * M_S2_PER_MG, 1700 * M_S2_PER_MG, 1700 * M_S2_PER_MG}}}},
	.triad_count = 1,
	.registers = d_accel};

const struct chip CHIP_LSM303D_MAG = {.name = "LSM303D",
	.addresses = {0x1D, 0x1E},
	.identity_at = 0x0F,
	.identity = {0x49},
	.identity_size = 1,
	.increment = 0x80,
	.spi = {.has = true, .multiple = 0x40},
	.status = 0x07,
	.ready = 0x08,
	.overrun = 0x80,
	.data = 0x08,
	.data_size = 6,
	.rates = D_MAG_RATES,
	.triads = {{.what = IMU_CHIP_MAG, .ranges = D_FIELD, .order = {0, 1, 2}, .density = 0.05}},
	.triad_count = 1,
	.registers = d_mag};
