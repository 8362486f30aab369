#include "drivers/imu/sim/sim_parts.h"
#include "model/math/units.h"

#include <math.h>
#include <string.h>

enum { TEMPERATURE_DEGC = 30 };

/* ---- effects of the registers ------------------------------------------------------------------------------------ */

static void set_scale(struct sim_triad *t, double x, double y, double z, double grain)
{
	t->lsb[0] = x;
	t->lsb[1] = y;
	t->lsb[2] = z;
	t->grain = grain;
}

static void set_axes(struct sim_triad *t, unsigned zyx)
{
	for (int i = 0; i < 3; i++)
		t->axis_on[i] = zyx >> i & 1;
}

static void effect_l3g(struct sim_chip *c)
{
	static const double odr[3][4] = {{100, 200, 400, 800}, {95, 190, 380, 760}, {100, 200, 400, 800}};
	static const double low_odr[4] = {12.5, 25, 50, 50};
	static const double mdps[4] = {8.75, 17.5, 70, 70}, test_dps[4] = {130, 200, 530, 530};
	const uint8_t *r = c->regs;
	struct sim_triad *t = &c->triads[0];
	unsigned fs = r[0x23] >> 4 & 3, test = r[0x23] >> 1 & 3;
	double digit = mdps[fs] * 1e-3 * RAD_PER_DEG;

	t->rate_hz = r[0x20] & 8 ? odr[c->kind][r[0x20] >> 6] : 0;
	if (c->kind == L3GD20H && r[0x39] & 1 && t->rate_hz > 0)
		t->rate_hz = low_odr[r[0x20] >> 6];
	set_axes(t, r[0x20]);
	set_scale(t, digit, digit, digit, 1);
	t->self_test = vec3_scale(test == 1   ? 1
				  : test == 3 ? -1
					      : 0,
		(struct vec3){test_dps[fs] * RAD_PER_DEG, -test_dps[fs] * RAD_PER_DEG, test_dps[fs] * RAD_PER_DEG});
	c->fifo_on = r[0x24] & 0x40 && r[0x2E] >> 5 == 2;
}

static void effect_dlh_accel(struct sim_chip *c)
{
	static const double odr[4] = {50, 100, 400, 1000}, mg[4] = {1, 2, 2, 3.9};
	const uint8_t *r = c->regs;
	struct sim_triad *t = &c->triads[0];
	double digit = mg[r[0x23] >> 4 & 3] * M_S2_PER_MG / 16;

	t->rate_hz = r[0x20] >> 5 == 1 ? odr[r[0x20] >> 3 & 3] : 0;
	set_axes(t, r[0x20]);
	set_scale(t, digit, digit, digit, 16);
	t->self_test = vec3_scale(r[0x23] & 2 ? (r[0x23] & 8 ? -1 : 1) : 0,
		(struct vec3){300 * M_S2_PER_MG, -300 * M_S2_PER_MG, 350 * M_S2_PER_MG});
}

static void effect_dlhc_accel(struct sim_chip *c)
{
	static const double odr[16] = {0, 1, 10, 25, 50, 100, 200, 400, 1620, 1344}, mg[4] = {1, 2, 4, 12};
	const uint8_t *r = c->regs;
	struct sim_triad *t = &c->triads[0];
	double digit = mg[r[0x23] >> 4 & 3] * M_S2_PER_MG / 16;

	t->rate_hz = odr[r[0x20] >> 4];
	set_axes(t, r[0x20]);
	set_scale(t, digit, digit, digit, r[0x23] & 8 ? 16 : 64); /* 12 or 10 bits */
	c->fifo_on = r[0x24] & 0x40 && r[0x2E] >> 6 == 2;
}

static void effect_old_mag(struct sim_chip *c)
{
	static const double odr[8] = {0.75, 1.5, 3, 7.5, 15, 30, 75, 220};
	static const double xy[2][8] = {
		{1, 1055, 795, 635, 430, 375, 320, 230}, {1, 1100, 855, 670, 450, 400, 330, 230}};
	static const double z[2][8] = {{1, 950, 710, 570, 385, 335, 285, 205}, {1, 980, 760, 600, 400, 355, 295, 205}};
	const uint8_t *r = c->regs;
	struct sim_triad *t = &c->triads[0];
	unsigned gain = r[0x01] >> 5, table = c->kind != DLH_MAG;

	t->rate_hz = (r[0x02] & 3) == 0 ? odr[r[0x00] >> 2 & 7] : 0;
	set_axes(t, 7);
	set_scale(t, UT_PER_GAUSS / xy[table][gain], UT_PER_GAUSS / xy[table][gain], UT_PER_GAUSS / z[table][gain], 1);
}

static void effect_lsm303d(struct sim_chip *c)
{
	static const double odr[16] = {0, 3.125, 6.25, 12.5, 25, 50, 100, 200, 400, 800, 1600};
	static const double mg[8] = {0.061, 0.122, 0.183, 0.244, 0.732, 0.732, 0.732, 0.732};
	static const double mag_odr[8] = {3.125, 6.25, 12.5, 25, 50, 100, 100, 100};
	static const double mgauss[4] = {0.080, 0.160, 0.320, 0.479};
	const uint8_t *r = c->regs;
	struct sim_triad *a = &c->triads[0], *m = &c->triads[1];
	double digit = mg[r[0x21] >> 3 & 7] * M_S2_PER_MG, field = mgauss[r[0x25] >> 5 & 3] * 1e-3 * UT_PER_GAUSS;

	a->rate_hz = odr[r[0x20] >> 4];
	set_axes(a, r[0x20]);
	set_scale(a, digit, digit, digit, 1);
	a->self_test =
		vec3_scale(r[0x21] & 2 ? 1 : 0, (struct vec3){400 * M_S2_PER_MG, 400 * M_S2_PER_MG, 400 * M_S2_PER_MG});
	c->fifo_on = r[0x1F] & 0x40 && r[0x2E] >> 5 == 2;
	m->rate_hz = (r[0x26] & 3) == 0 ? mag_odr[r[0x24] >> 2 & 7] : 0;
	set_axes(m, 7);
	set_scale(m, field, field, field, 1);
}

static void effect_lsm6(struct sim_chip *c)
{
	static const double odr[16] = {0, 12.5, 26, 52, 104, 208, 416, 833, 1660, 3330, 6660};
	static const double mg[4] = {0.061, 0.488, 0.122, 0.244}, mdps[4] = {8.75, 17.5, 35, 70};
	const uint8_t *r = c->regs;
	struct sim_triad *g = &c->triads[0], *a = &c->triads[1];
	double rate = r[0x11] & 2 ? 4.375e-3 * RAD_PER_DEG : mdps[r[0x11] >> 2 & 3] * 1e-3 * RAD_PER_DEG;
	double digit = mg[r[0x10] >> 2 & 3] * M_S2_PER_MG;

	g->rate_hz = odr[r[0x11] >> 4];
	a->rate_hz = odr[r[0x10] >> 4];
	set_axes(g, 7);
	set_axes(a, 7);
	set_scale(g, rate, rate, rate, 1);
	set_scale(a, digit, digit, digit, 1);
	g->self_test = vec3_scale((r[0x14] >> 2 & 3) == 1 ? 1 : 0,
		(struct vec3){300 * RAD_PER_DEG, 300 * RAD_PER_DEG, 300 * RAD_PER_DEG});
	a->self_test = vec3_scale(
		(r[0x14] & 3) == 1 ? 1 : 0, (struct vec3){500 * M_S2_PER_MG, 500 * M_S2_PER_MG, 500 * M_S2_PER_MG});
	c->fifo_on = (r[0x0A] & 7) == 6 && (c->kind == LSM6DS33 ? r[0x08] == 0x09 : r[0x09] != 0);
}

static void effect_lis3mdl(struct sim_chip *c)
{
	static const double odr[8] = {0.625, 1.25, 2.5, 5, 10, 20, 40, 80}, digits[4] = {6842, 3421, 2281, 1711};
	const uint8_t *r = c->regs;
	struct sim_triad *t = &c->triads[0];
	double field = UT_PER_GAUSS / digits[r[0x21] >> 5 & 3];

	t->rate_hz = (r[0x22] & 3) == 0 ? odr[r[0x20] >> 2 & 7] : 0;
	set_axes(t, 7);
	set_scale(t, field, field, field, 1);
}

static void effect_lsm9ds1(struct sim_chip *c)
{
	static const double odr[8] = {0, 14.9, 59.5, 119, 238, 476, 952};
	static const double mdps[4] = {8.75, 17.5, 0, 70}, mg[4] = {0.061, 0.732, 0.122, 0.244};
	const uint8_t *r = c->regs;
	struct sim_triad *g = &c->triads[0], *a = &c->triads[1];
	double rate = mdps[r[0x10] >> 3 & 3] * 1e-3 * RAD_PER_DEG, digit = mg[r[0x20] >> 3 & 3] * M_S2_PER_MG;

	g->rate_hz = a->rate_hz = odr[r[0x10] >> 5]; /* CTRL_REG1_G gives both rates while the gyro is on */
	set_axes(g, r[0x1E] >> 3);
	set_axes(a, r[0x1F] >> 3);
	set_scale(g, rate, -rate, rate, 1); /* left-handed */
	set_scale(a, digit, -digit, digit, 1);
	g->self_test =
		vec3_scale(r[0x24] >> 2 & 1, (struct vec3){500 * RAD_PER_DEG, -500 * RAD_PER_DEG, 500 * RAD_PER_DEG});
	a->self_test = vec3_scale(r[0x24] & 1, (struct vec3){700 * M_S2_PER_MG, 700 * M_S2_PER_MG, 700 * M_S2_PER_MG});
	c->fifo_on = r[0x23] & 2 && r[0x2E] >> 5 == 6;
}

static void effect_lsm9ds1_mag(struct sim_chip *c)
{
	static const double mgauss[4] = {0.14, 0.29, 0.43, 0.58};
	double field = mgauss[c->regs[0x21] >> 5 & 3] * 1e-3 * UT_PER_GAUSS;

	effect_lis3mdl(c);
	set_scale(&c->triads[0], -field, -field, field, 1); /* x against that of the accelerometer, and right-handed */
}

/* FS_SEL and ACCEL_FS_SEL halve the range step by step; a range has 32768 digits. */
static double halved(double widest, unsigned times)
{
	return widest / (1 << times) / 32768;
}

static void effect_icm42688p(struct sim_chip *c)
{
	static const double odr[16] = {0, 32e3, 16e3, 8e3, 4e3, 2e3, 1e3, 200, 100, 50, 25, 12.5, 0, 0, 0, 500};
	const uint8_t *r = c->regs;
	struct sim_triad *g = &c->triads[0], *a = &c->triads[1];
	double rate = halved(2000, r[0x4F] >> 5) * RAD_PER_DEG,
	       digit = halved(16, r[0x50] >> 5) * STANDARD_GRAVITY_M_S2;

	g->rate_hz = (r[0x4E] >> 2 & 3) == 3 ? odr[r[0x4F] & 15] : 0;
	a->rate_hz = (r[0x4E] & 3) == 3 ? odr[r[0x50] & 15] : 0;
	set_axes(g, 7);
	set_axes(a, 7);
	set_scale(g, rate, rate, rate, 1);
	set_scale(a, digit, digit, digit, 1);
	c->fifo_on = r[0x16] >> 6 == 1 && (r[0x5F] & 0x13) == 3;
}

static void effect_icm20948(struct sim_chip *c)
{
	const uint8_t *r = c->regs, *two = c->banks[2];
	struct sim_triad *g = &c->triads[0], *a = &c->triads[1];
	const bool awake = !(r[0x06] & 0x40);
	double rate = halved(2000, 3 - (two[0x01] >> 1 & 3)) * RAD_PER_DEG;
	double digit = halved(16, 3 - (two[0x14] >> 1 & 3)) * STANDARD_GRAVITY_M_S2;

	g->rate_hz = !awake || r[0x07] & 7 ? 0 : two[0x01] & 1 ? 1125.0 / (1 + two[0x00]) : 9000;
	a->rate_hz = !awake || r[0x07] & 0x38 ? 0 : two[0x14] & 1 ? 1125.0 / (1 + (two[0x10] << 8 | two[0x11])) : 4500;
	set_axes(g, 7);
	set_axes(a, 7);
	set_scale(g, rate, rate, rate, 1);
	set_scale(a, digit, digit, digit, 1);
	c->fifo_on = r[0x03] & 0x40 && r[0x67] == 0x1E;
}

static void effect_ak09916(struct sim_chip *c)
{
	struct sim_triad *t = &c->triads[0];

	switch (c->regs[0x31] & 0x1F) {
	case 0x02:
		t->rate_hz = 10;
		break;
	case 0x04:
		t->rate_hz = 20;
		break;
	case 0x06:
		t->rate_hz = 50;
		break;
	case 0x08:
		t->rate_hz = 100;
		break;
	default:
		t->rate_hz = 0;
	}
	set_axes(t, 7);
	set_scale(t, 0.15, -0.15, -0.15, 1); /* y and z against those of the ICM-20948 */
}

static void effect_bmi270(struct sim_chip *c)
{
	const uint8_t *r = c->regs;
	struct sim_triad *g = &c->triads[0], *a = &c->triads[1];
	const bool works = (r[0x21] & 15) == 1;
	double rate = halved(2000, r[0x43] & 7) * RAD_PER_DEG;
	double digit = 2.0 * (1 << (r[0x41] & 3)) / 32768 * STANDARD_GRAVITY_M_S2;
	double test = r[0x6D] & 1 ? (r[0x6D] & 4 ? 1 : -1) * (r[0x6D] & 8 ? 9 : 1) * STANDARD_GRAVITY_M_S2 : 0;

	g->rate_hz = works && r[0x7D] & 2 ? 25 * ldexp(1, (r[0x42] & 15) - 6) : 0;
	a->rate_hz = works && r[0x7D] & 4 ? 25 * ldexp(1, (r[0x40] & 15) - 6) : 0;
	set_axes(g, 7);
	set_axes(a, 7);
	set_scale(g, rate, rate, rate, 1);
	set_scale(a, digit, digit, digit, 1);
	a->self_test = (struct vec3){test, -test, 0.7 * test};
	c->fifo_on = (r[0x49] & 0xD0) == 0xD0;
}

void sim_effect(struct sim_chip *c)
{
	switch (c->kind) {
	case L3G4200D:
	case L3GD20:
	case L3GD20H:
		effect_l3g(c);
		break;
	case DLH_ACCEL:
		effect_dlh_accel(c);
		break;
	case DLHC_ACCEL:
		effect_dlhc_accel(c);
		break;
	case DLH_MAG:
	case DLM_MAG:
	case DLHC_MAG:
		effect_old_mag(c);
		break;
	case LSM303D:
		effect_lsm303d(c);
		break;
	case LSM6DS33:
	case LSM6DSO:
		effect_lsm6(c);
		break;
	case LIS3MDL:
		effect_lis3mdl(c);
		break;
	case LSM9DS1:
		effect_lsm9ds1(c);
		break;
	case LSM9DS1_MAG:
		effect_lsm9ds1_mag(c);
		break;
	case ICM42688P:
		effect_icm42688p(c);
		break;
	case ICM20948:
		effect_icm20948(c);
		break;
	case AK09916:
		effect_ak09916(c);
		break;
	case BMI270:
		effect_bmi270(c);
		break;
	case NONE:
		break;
	}
}

/* ---- power-on ---------------------------------------------------------------------------------------------------- */

static struct sim_triad triad_of(enum imu_chip what, uint8_t status, uint8_t out, uint8_t y, uint8_t z)
{
	return (struct sim_triad){.what = what, .status = status, .out = out, .order = {0, y, z}};
}

static void put_word(uint8_t *at, double value, bool big_endian)
{
	const int word = (int)floor(value + 0.5);

	at[big_endian] = (uint8_t)word;
	at[!big_endian] = (uint8_t)((unsigned)word >> 8);
}

void sim_default_registers(struct sim_chip *c)
{
	static const uint8_t who[] = {[L3G4200D] = 0xD3,
		[L3GD20] = 0xD4,
		[L3GD20H] = 0xD7,
		[DLM_MAG] = 0x3C,
		[LSM303D] = 0x49,
		[LSM6DS33] = 0x69,
		[LSM6DSO] = 0x6C,
		[LIS3MDL] = 0x3D,
		[LSM9DS1] = 0x68,
		[LSM9DS1_MAG] = 0x3D,
		[NONE] = 0};
	uint8_t *r = c->regs;

	memset(r, 0, sizeof c->regs);
	r[0x0F] = who[c->kind];
	if (sim_is_l3g(c->kind) || c->kind == DLH_ACCEL || c->kind == DLHC_ACCEL || c->kind == LSM303D)
		r[0x20] = 0x07;
	if (sim_is_l3g(c->kind))
		r[0x26] = (uint8_t)(25 - TEMPERATURE_DEGC);
	if (sim_is_old_mag(c->kind)) {
		memcpy(r + 0x0A, "H43", 3);
		r[0x00] = 0x10;
		r[0x01] = 0x20;
		r[0x02] = 0x03;
	}
	if (c->kind == LSM303D) {
		r[0x24] = 0x18;
		r[0x25] = 0x20;
		r[0x26] = 0x01;
	}
	if (sim_is_lsm6(c->kind)) {
		int16_t digits = (TEMPERATURE_DEGC - 25) * (c->kind == LSM6DSO ? 256 : 16);

		r[0x12] = 0x04;
		r[0x20] = (uint8_t)digits;
		r[0x21] = (uint8_t)(digits >> 8);
	}
	if (c->kind == LIS3MDL || c->kind == LSM9DS1_MAG) {
		r[0x20] = 0x10;
		r[0x22] = 0x03;
	}
	if (c->kind == LSM9DS1) {
		r[0x1E] = r[0x1F] = 0x38;
		r[0x22] = 0x04;
		put_word(r + 0x15, (TEMPERATURE_DEGC - 25) * 16, false);
	}
	if (c->kind == ICM42688P) {
		r[0x75] = 0x47;
		r[0x4C] = 0x30;
		r[0x4F] = r[0x50] = 0x06;
		r[0x52] = 0x11;
		r[0x64] = r[0x65] = 0x10;
		put_word(r + 0x1D, (TEMPERATURE_DEGC - 25) * 132.48, true);
	}
	if (c->kind == ICM20948) {
		memset(c->banks, 0, sizeof c->banks);
		r[0x00] = 0xEA;
		r[0x05] = 0x40;
		r[0x06] = 0x41;
		c->banks[2][0x01] = c->banks[2][0x14] = 0x01;
		put_word(r + 0x39, (TEMPERATURE_DEGC - 21) * 333.87, true);
	}
	if (c->kind == AK09916) {
		r[0x00] = 0x48;
		r[0x01] = 0x09;
	}
	if (c->kind == BMI270) {
		c->configured = 0;
		c->loaded_ns = 0;
		r[0x00] = 0x24;
		r[0x03] = 0x10;
		r[0x40] = 0xA8;
		r[0x41] = 0x02;
		r[0x42] = 0xA9;
		r[0x45] = 0x88;
		r[0x48] = 0x02;
		r[0x49] = 0x10;
		r[0x7C] = 0x03;
		put_word(r + 0x22, (TEMPERATURE_DEGC - 23) * 512, false);
	}
}

void sim_make_chip(struct sim_chip *c, enum sim_kind kind, uint8_t address)
{
	*c = (struct sim_chip){.kind = kind, .address = address, .fifo_size = SIM_SETS, .entry = 6};
	if (sim_is_l3g(kind))
		c->triads[0] = triad_of(IMU_CHIP_GYRO, 0x27, 0x28, 1, 2);
	else if (kind == DLH_ACCEL || kind == DLHC_ACCEL)
		c->triads[0] = triad_of(IMU_CHIP_ACCEL, 0x27, 0x28, 1, 2);
	else if (kind == DLH_MAG)
		c->triads[0] = triad_of(IMU_CHIP_MAG, 0x09, 0x03, 1, 2);
	else if (kind == DLM_MAG || kind == DLHC_MAG)
		c->triads[0] = triad_of(IMU_CHIP_MAG, 0x09, 0x03, 2, 1);
	else if (kind == LIS3MDL)
		c->triads[0] = triad_of(IMU_CHIP_MAG, 0x27, 0x28, 1, 2);
	if (kind == LSM303D) {
		c->triads[0] = triad_of(IMU_CHIP_ACCEL, 0x27, 0x28, 1, 2);
		c->triads[1] = triad_of(IMU_CHIP_MAG, 0x07, 0x08, 1, 2);
	}
	if (sim_is_lsm6(kind)) {
		c->triads[0] = triad_of(IMU_CHIP_GYRO, 0x1E, 0x22, 1, 2);
		c->triads[1] = triad_of(IMU_CHIP_ACCEL, 0x1E, 0x28, 1, 2);
		c->fifo_size = kind == LSM6DS33 ? SIM_WORDS : SIM_ENTRIES;
		c->entry = kind == LSM6DS33 ? 2 : 7;
	}
	if (kind == LSM9DS1) {
		c->triads[0] = triad_of(IMU_CHIP_GYRO, 0x17, 0x18, 1, 2);
		c->triads[1] = triad_of(IMU_CHIP_ACCEL, 0x27, 0x28, 1, 2);
		c->entry = 12;
	}
	if (kind == LSM9DS1_MAG)
		c->triads[0] = triad_of(IMU_CHIP_MAG, 0x27, 0x28, 1, 2);
	if (kind == ICM42688P) {
		c->triads[0] = triad_of(IMU_CHIP_GYRO, 0x2D, 0x25, 1, 2);
		c->triads[1] = triad_of(IMU_CHIP_ACCEL, 0x2D, 0x1F, 1, 2);
		c->fifo_size = 128;
		c->entry = 16;
	}
	if (kind == ICM20948) {
		c->triads[0] = triad_of(IMU_CHIP_GYRO, 0x1A, 0x33, 1, 2);
		c->triads[1] = triad_of(IMU_CHIP_ACCEL, 0x1A, 0x2D, 1, 2);
		c->fifo_size = 512;
		c->entry = 1;
	}
	if (kind == AK09916)
		c->triads[0] = triad_of(IMU_CHIP_MAG, 0x10, 0x11, 1, 2);
	if (kind == BMI270) {
		c->triads[0] = triad_of(IMU_CHIP_GYRO, 0x03, 0x12, 1, 2);
		c->triads[1] = triad_of(IMU_CHIP_ACCEL, 0x03, 0x0C, 1, 2);
		c->fifo_size = 2048;
		c->entry = 1;
	}
	sim_default_registers(c);
	sim_effect(c);
}
