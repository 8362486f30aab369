/* The simulated chips (drivers/imu/sim/sim_chips.h) behave as the data sheets say: status, FIFO, self-test, addresses.
 * They are the reference of the driver's tests, so they are tested without it, over the bus. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdlib.h>

#include "tests/unit/i2c_world.h"

static const double G = 9.80665;

static struct world *w;

static void board(const char *name, const char *scenario)
{
	w = world_make(name, scenario, true);
}

static void put(enum imu_chip chip, uint8_t reg, uint8_t value)
{
	assert_int_equal(i2c_write(w->bus, sim_board_address(w->sim, chip), reg, value), 0);
}

static void get(enum imu_chip chip, uint8_t sub, uint8_t *bytes, size_t n)
{
	assert_int_equal(i2c_read(w->bus, sim_board_address(w->sim, chip), sub, bytes, n), 0);
}

static uint8_t get_one(enum imu_chip chip, uint8_t sub)
{
	uint8_t byte;

	get(chip, sub, &byte, 1);
	return byte;
}

static void wait_ms(double ms)
{
	w->now_ns += (int64_t)(1e6 * ms);
}

static int word(const uint8_t *bytes)
{
	return (int16_t)(bytes[0] | bytes[1] << 8);
}

/* ---- status ------------------------------------------------------------------------------------------------------ */

/* STATUS: ZYXDA and the three axes from the first sample on, ZYXOR and the three axes from the second on that was not
 * read; reading the last data register clears both. */
static void test_the_status_shows_new_and_overwritten_samples_until_they_are_read(void **state)
{
	static const struct {
		const char *board;
		enum imu_chip chip;
		uint8_t on_at, on, status, data;
	} chips[] = {
		{"v0", IMU_CHIP_GYRO, 0x20, 0x0F, 0x27, 0xA8},
		{"v2", IMU_CHIP_GYRO, 0x20, 0x0F, 0x27, 0xA8},
		{"v3", IMU_CHIP_GYRO, 0x20, 0x0F, 0x27, 0xA8},
		{"v0", IMU_CHIP_ACCEL, 0x20, 0x2F, 0x27, 0xA8},
		{"v2", IMU_CHIP_ACCEL, 0x20, 0x57, 0x27, 0xA8},
		{"v3", IMU_CHIP_ACCEL, 0x20, 0x67, 0x27, 0xA8},
		{"v3", IMU_CHIP_MAG, 0x26, 0x00, 0x07, 0x88},
		{"v5", IMU_CHIP_MAG, 0x22, 0x00, 0x27, 0xA8},
	};
	uint8_t bytes[6];

	(void)state;
	for (size_t i = 0; i < sizeof chips / sizeof *chips; i++) {
		double period_ms = 10;

		board(chips[i].board, "rest");
		if (chips[i].chip == IMU_CHIP_MAG) {
			put(IMU_CHIP_MAG, chips[i].status == 0x07 ? 0x24 : 0x20, chips[i].status == 0x07 ? 0x74 : 0x1C);
			period_ms = chips[i].status == 0x07 ? 10 : 12.5;
		}
		put(chips[i].chip, chips[i].on_at, chips[i].on);
		assert_int_equal(get_one(chips[i].chip, chips[i].status), 0);
		wait_ms(1.4 * period_ms);
		assert_int_equal(get_one(chips[i].chip, chips[i].status), 0x0F);
		get(chips[i].chip, chips[i].data, bytes, 5);
		assert_int_equal(get_one(chips[i].chip, chips[i].status), 0x0F);
		get(chips[i].chip, chips[i].data, bytes, 6);
		assert_int_equal(get_one(chips[i].chip, chips[i].status), 0);
		wait_ms(period_ms);
		assert_int_equal(get_one(chips[i].chip, chips[i].status), 0x0F);
		wait_ms(period_ms);
		assert_int_equal(get_one(chips[i].chip, chips[i].status), 0xFF);
		get(chips[i].chip, chips[i].data, bytes, 6);
		assert_int_equal(get_one(chips[i].chip, chips[i].status), 0);
		world_free(w);
	}
}

static void test_after_a_brown_out_a_chip_is_as_after_power_on(void **state)
{
	uint8_t bytes[6];

	(void)state;
	board("v3", "rest");
	put(IMU_CHIP_GYRO, 0x20, 0x0F);
	wait_ms(34);
	assert_int_equal(get_one(IMU_CHIP_GYRO, 0x27), 0xFF);
	sim_board_brown_out(w->sim, IMU_CHIP_GYRO);
	assert_int_equal(get_one(IMU_CHIP_GYRO, 0x27), 0);
	assert_int_equal(get_one(IMU_CHIP_GYRO, 0x20), 0x07); /* L3GD20H, 7.2: powered down */
	wait_ms(1000);
	assert_int_equal(get_one(IMU_CHIP_GYRO, 0x27), 0);
	put(IMU_CHIP_GYRO, 0x20, 0x0F);
	wait_ms(14);
	assert_int_equal(get_one(IMU_CHIP_GYRO, 0x27), 0x0F);
	get(IMU_CHIP_GYRO, 0xA8, bytes, 6);
	assert_int_equal(get_one(IMU_CHIP_GYRO, 0x27), 0);
	world_free(w);
}

/* SR of the LSM303DLH, DLM and DLHC: RDY. STATUS_REG of the LSM6: TDA, GDA and XLDA. */
static void test_the_status_of_the_other_chips(void **state)
{
	uint8_t bytes[6];

	(void)state;
	for (int i = 0; i < 3; i++) {
		board((const char *const[]){"v0", "v1", "v2"}[i], "rest");
		put(IMU_CHIP_MAG, 0x00, 0x18); /* 75 Hz */
		put(IMU_CHIP_MAG, 0x02, 0x00);
		assert_int_equal(get_one(IMU_CHIP_MAG, 0x09), 0);
		wait_ms(40);
		assert_int_equal(get_one(IMU_CHIP_MAG, 0x09), 1);
		get(IMU_CHIP_MAG, 0x03, bytes, 6);
		assert_int_equal(get_one(IMU_CHIP_MAG, 0x09), 0);
		world_free(w);
	}
	for (int i = 0; i < 2; i++) {
		board(i ? "v6" : "v5", "rest");
		assert_int_equal(get_one(IMU_CHIP_GYRO, 0x1E) & 3, 0);
		put(IMU_CHIP_GYRO, 0x11, 0x40);
		wait_ms(25);
		assert_int_equal(get_one(IMU_CHIP_GYRO, 0x1E), 0x06);
		put(IMU_CHIP_GYRO, 0x10, 0x40);
		wait_ms(25);
		assert_int_equal(get_one(IMU_CHIP_GYRO, 0x1E), 0x07);
		get(IMU_CHIP_GYRO, 0x22, bytes, 6);
		assert_int_equal(get_one(IMU_CHIP_GYRO, 0x1E), 0x05);
		get(IMU_CHIP_GYRO, 0x28, bytes, 6);
		assert_int_equal(get_one(IMU_CHIP_GYRO, 0x1E), 0x04);
		world_free(w);
	}
}

/* ---- FIFO -------------------------------------------------------------------------------------------------------- */

/* FIFO_SRC: EMPTY 20h, FSS the number of sets, OVRN 40h with 31 when all 32 are full. */
static void test_a_fifo_of_32_sets_shows_its_level_and_keeps_the_newest(void **state)
{
	static const struct {
		const char *board;
		enum imu_chip chip;
		uint8_t writes[3][2]; /* 100 Hz, FIFO on, stream mode */
		double hz;
	} chips[] = {
		{"v0", IMU_CHIP_GYRO, {{0x20, 0x0F}, {0x24, 0x40}, {0x2E, 0x40}}, 100},
		{"v2", IMU_CHIP_GYRO, {{0x20, 0x0F}, {0x24, 0x40}, {0x2E, 0x40}}, 95},
		{"v3", IMU_CHIP_GYRO, {{0x20, 0x0F}, {0x24, 0x40}, {0x2E, 0x40}}, 100},
		{"v2", IMU_CHIP_ACCEL, {{0x20, 0x57}, {0x24, 0x40}, {0x2E, 0x80}}, 100},
		{"v3", IMU_CHIP_ACCEL, {{0x20, 0x67}, {0x1F, 0x40}, {0x2E, 0x40}}, 100},
	};
	uint8_t bytes[6];

	(void)state;
	for (size_t i = 0; i < sizeof chips / sizeof *chips; i++) {
		const double period_ms = 1e3 / chips[i].hz /
					 (1 + (board(chips[i].board, "tumble"), w->config.rate_error[chips[i].chip]));
		const enum imu_chip chip = chips[i].chip;
		uint8_t last[6];

		for (int k = 0; k < 3; k++)
			put(chip, chips[i].writes[k][0], chips[i].writes[k][1]);
		assert_int_equal(get_one(chip, 0x2F), 0x20);
		wait_ms(5.5 * period_ms);
		assert_int_equal(get_one(chip, 0x2F), 5);
		get(chip, 0xA8, bytes, 6);
		assert_int_equal(get_one(chip, 0x2F), 4);
		get(chip, 0xA8, bytes, 5); /* not the whole set */
		assert_int_equal(get_one(chip, 0x2F), 4);
		wait_ms(27 * period_ms);
		assert_int_equal(get_one(chip, 0x2F), 31);
		wait_ms(period_ms);
		assert_int_equal(get_one(chip, 0x2F), 0x40 | 31);
		wait_ms(20.55 * period_ms); /* the rest of the test takes 7 ms, within an interval */
		assert_int_equal(get_one(chip, 0x2F), 0x40 | 31);
		for (int k = 0; k < 6; k++)
			last[k] = sim_board_registers(w->sim, chip)[0x28 + k];
		get(chip, 0xA8, bytes, 6);
		assert_int_equal(get_one(chip, 0x2F), 31);
		for (int k = 0; k < 31; k++)
			get(chip, 0xA8, bytes, 6);
		assert_int_equal(get_one(chip, 0x2F), 0x20);
		assert_memory_equal(bytes, last, 6);
		put(chip, 0x2E, 0); /* bypass empties it */
		wait_ms(5 * period_ms);
		assert_int_equal(get_one(chip, 0x2F), 0x20);
		world_free(w);
	}
}

/* LSM6DS33: FIFO_STATUS1 and 2 have the number of words, six to a set of gyro and accelerometer, and 40h after an
 * overrun; FIFO_STATUS3 the place of the next word in its set. */
static void test_the_fifo_of_words_shows_its_level_and_the_place_in_the_set(void **state)
{
	uint8_t status[4], bytes[12];

	(void)state;
	board("v5", "rest");
	put(IMU_CHIP_GYRO, 0x08, 0x09);
	put(IMU_CHIP_GYRO, 0x11, 0x40);
	put(IMU_CHIP_GYRO, 0x10, 0x40);
	put(IMU_CHIP_GYRO, 0x0A, 0x26);
	wait_ms(52);
	get(IMU_CHIP_GYRO, 0x3A, status, 4);
	assert_int_equal(status[0] | (status[1] & 0x0F) << 8, 6 * 5);
	assert_int_equal(status[1] & 0xF0, 0);
	assert_int_equal(status[2] | status[3] << 8, 0);
	get(IMU_CHIP_GYRO, 0x3E, bytes, 12);
	assert_true(fabs(word(bytes + 10) * 0.061e-3 * G - 9.81) < 0.01);
	assert_true(abs(word(bytes + 4)) < 10);
	for (int k = 1; k <= 6; k++) {
		get(IMU_CHIP_GYRO, 0x3E, bytes, 2);
		get(IMU_CHIP_GYRO, 0x3A, status, 4);
		assert_int_equal(status[0], 6 * 4 - k);
		assert_int_equal(status[2], k % 6);
	}
	for (int k = 0; k < 80; k++) { /* 4096 words are 682.7 sets */
		wait_ms(100);
		get(IMU_CHIP_GYRO, 0x3A, status, 4);
	}
	assert_int_equal(status[0] | status[1] << 8, 4096 & 0x0FFF ? 4096 : (0x4000 | 4096));
	assert_int_equal(status[2] | status[3] << 8, (6 - 4096 % 6) % 6);
	get(IMU_CHIP_GYRO, 0x3E, bytes, 2);
	get(IMU_CHIP_GYRO, 0x3A, status, 4);
	assert_int_equal(status[0] | status[1] << 8, 4095);
	put(IMU_CHIP_GYRO, 0x0A, 0x00); /* bypass empties it */
	put(IMU_CHIP_GYRO, 0x0A, 0x26);
	get(IMU_CHIP_GYRO, 0x3A, status, 4);
	assert_int_equal(status[0] | status[1] << 8, 0x1000); /* FIFO_EMPTY */
	assert_int_equal(status[2] | status[3], 0);
	world_free(w);
}

/* LSM6DSO: an entry has a tag, 1 gyro and 2 accelerometer, with a counter of two bits, and six bytes. */
static void test_the_fifo_of_tagged_entries_shows_its_level_and_tags(void **state)
{
	uint8_t status[2], bytes[14];

	(void)state;
	board("v6", "rest");
	put(IMU_CHIP_GYRO, 0x09, 0x44);
	put(IMU_CHIP_GYRO, 0x11, 0x40);
	put(IMU_CHIP_GYRO, 0x10, 0x40);
	put(IMU_CHIP_GYRO, 0x0A, 0x06);
	wait_ms(52);
	for (int k = 5; k > 0; k--) {
		get(IMU_CHIP_GYRO, 0x3A, status, 2);
		assert_int_equal(status[0] | status[1] << 8, 2 * k);
		get(IMU_CHIP_GYRO, 0x78, bytes, 14);
		assert_int_equal(bytes[0] >> 3, 1);
		assert_int_equal(bytes[7] >> 3, 2);
		assert_int_equal(bytes[0] >> 1 & 3, (5 - k) & 3);
		assert_int_equal(bytes[7] >> 1 & 3, (5 - k) & 3);
		assert_true(fabs(word(bytes + 12) * 0.061e-3 * G - 9.81) < 0.01);
	}
	for (int k = 0; k < 30; k++) {
		wait_ms(100);
		get(IMU_CHIP_GYRO, 0x3A, status, 2);
	}
	assert_int_equal(status[0] | (status[1] & 3) << 8, 512 & 0x3FF);
	assert_int_equal(status[1] & 0x40, 0x40);
	put(IMU_CHIP_GYRO, 0x0A, 0x00); /* bypass empties it */
	put(IMU_CHIP_GYRO, 0x0A, 0x06);
	get(IMU_CHIP_GYRO, 0x3A, status, 2);
	assert_int_equal(status[0] | status[1] << 8, 0);
	world_free(w);
}

/* ---- self-test and faults ---------------------------------------------------------------------------------------- */

/* The change of the output by each mode of the self-test, typical values of the data sheets. */
static void test_a_self_test_moves_the_output_by_the_values_of_the_data_sheets(void **state)
{
	static const struct {
		const char *board;
		enum imu_chip chip;
		uint8_t writes[2][2];
		uint8_t test_at, test, rest, data;
		double digit;  /* mdps, or mg */
		double by[3];  /* dps, or mg */
		double within; /* digits */
	} chips[] = {
		{"v0", IMU_CHIP_GYRO, {{0x20, 0x0F}, {0x21, 0}}, 0x23, 0x82, 0x80, 0xA8, 8.75, {130, -130, 130}, 3},
		{"v2", IMU_CHIP_GYRO, {{0x20, 0x0F}, {0x21, 0}}, 0x23, 0x92, 0x90, 0xA8, 17.5, {200, -200, 200}, 3},
		{"v3", IMU_CHIP_GYRO, {{0x20, 0x0F}, {0x21, 0}}, 0x23, 0xA2, 0xA0, 0xA8, 70, {530, -530, 530}, 3},
		{"v3", IMU_CHIP_GYRO, {{0x20, 0x0F}, {0x21, 0}}, 0x23, 0xB2, 0xB0, 0xA8, 70, {530, -530, 530}, 3},
		{"v0", IMU_CHIP_GYRO, {{0x20, 0x0F}, {0x21, 0}}, 0x23, 0x86, 0x80, 0xA8, 8.75, {-130, 130, -130}, 3},
		{"v0", IMU_CHIP_GYRO, {{0x20, 0x0F}, {0x21, 0}}, 0x23, 0x84, 0x80, 0xA8, 8.75, {0, 0, 0}, 3},
		{"v0", IMU_CHIP_ACCEL, {{0x20, 0x2F}, {0x21, 0}}, 0x23, 0x82, 0x80, 0xA8, 1 / 16., {300, -300, 350},
			40},
		{"v0", IMU_CHIP_ACCEL, {{0x20, 0x2F}, {0x21, 0}}, 0x23, 0x8A, 0x80, 0xA8, 1 / 16., {-300, 300, -350},
			40},
		{"v3", IMU_CHIP_ACCEL, {{0x20, 0x67}, {0x22, 0}}, 0x21, 0x02, 0x00, 0xA8, 0.061, {400, 400, 400}, 3},
		{"v5", IMU_CHIP_ACCEL, {{0x11, 0x40}, {0x10, 0x40}}, 0x14, 0x01, 0x00, 0x28, 0.061, {500, 500, 500}, 3},
		{"v5", IMU_CHIP_GYRO, {{0x11, 0x40}, {0x10, 0x40}}, 0x14, 0x04, 0x00, 0x22, 8.75, {286.7, 286.7, 286.7},
			9},
		{"v6", IMU_CHIP_GYRO, {{0x11, 0x44}, {0x10, 0x40}}, 0x14, 0x04, 0x00, 0x22, 17.5, {300, 300, 300}, 3},
	};

	(void)state;
	for (size_t i = 0; i < sizeof chips / sizeof *chips; i++) {
		const double unit = chips[i].chip == IMU_CHIP_GYRO ? 1e3 : 1;
		uint8_t before[6], after[6];

		board(chips[i].board, "rest");
		for (int k = 0; k < 2; k++)
			put(chips[i].chip, chips[i].writes[k][0], chips[i].writes[k][1]);
		put(chips[i].chip, chips[i].test_at, chips[i].rest);
		wait_ms(100);
		get(chips[i].chip, chips[i].data, before, 6);
		put(chips[i].chip, chips[i].test_at, chips[i].test);
		wait_ms(100);
		get(chips[i].chip, chips[i].data, after, 6);
		for (int axis = 0; axis < 3; axis++) {
			double moved = word(after + 2 * axis) - word(before + 2 * axis);

			if (fabs(moved - unit * chips[i].by[axis] / chips[i].digit) > chips[i].within)
				fail_msg("%s, chip %d, row %zu: axis %d moves by %g digits", chips[i].board,
					chips[i].chip, i, axis, moved);
		}
		world_free(w);
	}
}

/* An axis that is switched off keeps its last word. */
static void test_an_axis_that_is_off_does_not_change(void **state)
{
	(void)state;
	for (unsigned on = 0; on < 8; on++) {
		uint8_t before[6], after[6];

		board("v3", "tumble");
		put(IMU_CHIP_GYRO, 0x20, 0x0F);
		wait_ms(100);
		get(IMU_CHIP_GYRO, 0xA8, before, 6);
		put(IMU_CHIP_GYRO, 0x20, (uint8_t)(0x08 | on));
		wait_ms(300);
		get(IMU_CHIP_GYRO, 0xA8, after, 6);
		for (int axis = 0; axis < 3; axis++)
			assert_int_equal(word(before + 2 * axis) != word(after + 2 * axis), on >> axis & 1);
		world_free(w);
	}
}

static void test_a_saturated_chip_has_words_at_the_end_of_its_range(void **state)
{
	static const struct {
		const char *board;
		enum imu_chip chip;
		uint8_t on_at, on, data;
		int word;
	} chips[] = {
		{"v3", IMU_CHIP_GYRO, 0x20, 0x0F, 0xA8, 32767},
		{"v0", IMU_CHIP_ACCEL, 0x20, 0x2F, 0xA8, 32767 - 15}, /* 12 bits, left-justified */
		{"v2", IMU_CHIP_ACCEL, 0x20, 0x57, 0xA8, 32767 - 63}, /* 10 bits */
		{"v3", IMU_CHIP_MAG, 0x26, 0x00, 0x88, 32767},
		{"v2", IMU_CHIP_MAG, 0x02, 0x00, 0x03, -4096}, /* big-endian */
	};

	(void)state;
	for (size_t i = 0; i < sizeof chips / sizeof *chips; i++) {
		uint8_t bytes[6];

		board(chips[i].board, "rest");
		put(chips[i].chip, chips[i].on_at, chips[i].on);
		sim_board_saturate(w->sim, chips[i].chip, true);
		wait_ms(1000);
		get(chips[i].chip, chips[i].data, bytes, 6);
		for (int axis = 0; axis < 3; axis++) {
			int found = chips[i].word == -4096 ? (int16_t)(bytes[2 * axis] << 8 | bytes[2 * axis + 1])
							   : word(bytes + 2 * axis);

			assert_int_equal(found, chips[i].word);
		}
		world_free(w);
	}
}

/* ---- addresses --------------------------------------------------------------------------------------------------- */

/* A sub-address without its bit 7 (or IF_INC of the LSM6, IF_ADD_INC of the LSM9DS1) repeats one register. The old
 * magnetometers always count, and from the last data register on begin again with the first. */
static void test_a_read_of_several_registers_counts_where_the_data_sheet_says_so(void **state)
{
	uint8_t bytes[8];

	(void)state;
	board("v3", "rest");
	get(IMU_CHIP_GYRO, 0x0F, bytes, 3);
	for (int k = 0; k < 3; k++)
		assert_int_equal(bytes[k], 0xD7);
	put(IMU_CHIP_GYRO, 0x21, 0x12);
	put(IMU_CHIP_GYRO, 0x22, 0x34);
	get(IMU_CHIP_GYRO, 0xA0, bytes, 3);
	assert_int_equal(bytes[0], 0x07);
	assert_int_equal(bytes[1], 0x12);
	assert_int_equal(bytes[2], 0x34);
	world_free(w);

	board("v5", "rest");
	get(IMU_CHIP_GYRO, 0x0F, bytes, 2);
	assert_int_equal(bytes[0], 0x69);
	assert_int_equal(bytes[1], 0x00);
	put(IMU_CHIP_GYRO, 0x12, 0x00);
	get(IMU_CHIP_GYRO, 0x0F, bytes, 2);
	assert_int_equal(bytes[1], 0x69);
	world_free(w);

	board("lsm9ds1", "rest");
	get(IMU_CHIP_GYRO, 0x0F, bytes, 2);
	assert_int_equal(bytes[0], 0x68);
	assert_int_equal(bytes[1], 0x00);
	put(IMU_CHIP_GYRO, 0x22, 0x01);
	get(IMU_CHIP_GYRO, 0x0F, bytes, 2);
	assert_int_equal(bytes[1], 0x68);
	world_free(w);

	board("v2", "rest");
	put(IMU_CHIP_MAG, 0x02, 0x00);
	wait_ms(1000);
	get(IMU_CHIP_MAG, 0x03, bytes, 8);
	assert_memory_equal(bytes, bytes + 6, 2);
	assert_true(bytes[4] != bytes[0] || bytes[5] != bytes[1]);
	get(IMU_CHIP_MAG, 0x00, bytes, 2);
	assert_int_equal(bytes[0], 0x10);
	assert_int_equal(bytes[1], 0x20);
	world_free(w);
}

static void test_identities_status_and_data_cannot_be_written(void **state)
{
	static const struct {
		const char *board;
		enum imu_chip chip;
		uint8_t regs[6];
	} chips[] = {
		{"v3", IMU_CHIP_GYRO, {0x0F, 0x27, 0x28, 0x2D, 0x2F, 0x0F}},
		{"v3", IMU_CHIP_ACCEL, {0x0F, 0x07, 0x08, 0x0D, 0x27, 0x28}},
		{"v2", IMU_CHIP_MAG, {0x03, 0x08, 0x09, 0x0A, 0x0B, 0x0C}},
		{"v5", IMU_CHIP_MAG, {0x0F, 0x27, 0x28, 0x2D, 0x0F, 0x0F}},
	};

	(void)state;
	for (size_t i = 0; i < sizeof chips / sizeof *chips; i++) {
		board(chips[i].board, "rest");
		for (int k = 0; k < 6; k++) {
			uint8_t before = get_one(chips[i].chip, chips[i].regs[k]);

			put(chips[i].chip, chips[i].regs[k], (uint8_t)~before);
			assert_int_equal(get_one(chips[i].chip, chips[i].regs[k]), before);
		}
		world_free(w);
	}
}

static void test_no_chip_answers_at_another_address(void **state)
{
	static const struct {
		const char *board;
		uint8_t addresses[3];
	} boards[] = {{"v0", {0x69, 0x18, 0x1E}}, {"v1", {0x69, 0x18, 0x1E}}, {"v2", {0x6B, 0x19, 0x1E}},
		{"v3", {0x6B, 0x1D, 0x1D}}, {"v5", {0x6B, 0x1E, 0x1E}}, {"v6", {0x6B, 0x1E, 0x1E}}};

	(void)state;
	for (size_t i = 0; i < sizeof boards / sizeof *boards; i++) {
		board(boards[i].board, "rest");
		for (int address = 0x08; address < 0x78; address++) {
			bool there = false;
			uint8_t byte;

			for (int k = 0; k < 3; k++)
				there |= boards[i].addresses[k] == address;
			assert_int_equal(i2c_read(w->bus, (uint8_t)address, 0x0F, &byte, 1) == 0, there);
		}
		world_free(w);
	}
}

/* 30 degC: the L3G count down from 25 degC, the LSM6DS33 has 16 and the LSM6DSO 256 digits per degree. */
static void test_the_temperature_is_30_degrees(void **state)
{
	uint8_t bytes[2];

	(void)state;
	board("v3", "rest");
	assert_int_equal((int8_t)get_one(IMU_CHIP_GYRO, 0x26), -5);
	world_free(w);
	board("v5", "rest");
	get(IMU_CHIP_GYRO, 0x20, bytes, 2);
	assert_int_equal(word(bytes), 5 * 16);
	world_free(w);
	board("v6", "rest");
	get(IMU_CHIP_GYRO, 0x20, bytes, 2);
	assert_int_equal(word(bytes), 5 * 256);
	world_free(w);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_status_shows_new_and_overwritten_samples_until_they_are_read),
		cmocka_unit_test(test_after_a_brown_out_a_chip_is_as_after_power_on),
		cmocka_unit_test(test_the_status_of_the_other_chips),
		cmocka_unit_test(test_a_fifo_of_32_sets_shows_its_level_and_keeps_the_newest),
		cmocka_unit_test(test_the_fifo_of_words_shows_its_level_and_the_place_in_the_set),
		cmocka_unit_test(test_the_fifo_of_tagged_entries_shows_its_level_and_tags),
		cmocka_unit_test(test_a_self_test_moves_the_output_by_the_values_of_the_data_sheets),
		cmocka_unit_test(test_an_axis_that_is_off_does_not_change),
		cmocka_unit_test(test_a_saturated_chip_has_words_at_the_end_of_its_range),
		cmocka_unit_test(test_a_read_of_several_registers_counts_where_the_data_sheet_says_so),
		cmocka_unit_test(test_identities_status_and_data_cannot_be_written),
		cmocka_unit_test(test_no_chip_answers_at_another_address),
		cmocka_unit_test(test_the_temperature_is_30_degrees),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
