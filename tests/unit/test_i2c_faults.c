/* Faults of the simulated chips and of the bus: each is detected within 100 ms with its kind, and cleared when the chip
 * works again. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "tests/unit/descriptors.h"
#include "tests/unit/i2c_world.h"

static const char *const BOARDS[] = {"v0", "v1", "v2", "v3", "v5", "v6", "lsm9ds1", "icm20948", "icm42688", "bmi270",
	"v3/spi", "v6/spi", "lsm9ds1/spi", "icm20948/spi", "icm42688/spi", "bmi270/spi"};
enum { BOARD_COUNT = sizeof BOARDS / sizeof *BOARDS, DETECTED_US = 100000, RECOVERED_US = 3000000 };
enum { START_US = 600000 }; /* with the configuration file of the BMI270 */

/* After one second without a fault. */
static struct world *settled(const char *board)
{
	struct world *w = world_new(board, "square", false);

	world_run(w, 1000000);
	assert_int_equal(w->board.health.fault, 0);
	assert_int_equal(w->board.health.degraded, 0);
	return w;
}

/* The same; NULL if the board has no such sensor. */
static struct world *settled_with(const char *board, enum imu_chip chip)
{
	struct world *w = settled(board);

	if (chip != IMU_CHIP_MAG || w->board.mag)
		return w;
	world_free(w);
	return NULL;
}

static bool is_spi(const char *board)
{
	return strchr(board, '/') != NULL;
}

/* The chip reported for a sensor: the accelerometer of an LSM6 is reported as the gyro, which is the same chip. */
static enum imu_chip reported_as(const struct world *w, enum imu_chip chip)
{
	return chip == IMU_CHIP_ACCEL && w->board.accel == w->board.gyro ? IMU_CHIP_GYRO : chip;
}

typedef void fault_of_chip(struct sim_board *, enum imu_chip, bool);

static void assert_detected_and_cleared(fault_of_chip *put, enum imu_fault fault)
{
	for (int i = 0; i < BOARD_COUNT; i++)
		for (enum imu_chip chip = IMU_CHIP_GYRO; chip <= IMU_CHIP_MAG; chip++) {
			struct world *w = settled_with(BOARDS[i], chip);
			int64_t us;

			if (!w)
				continue;
			if (is_spi(BOARDS[i]) && fault == IMU_FAULT_SILENT) { /* see below */
				world_free(w);
				continue;
			}
			put(w->sim, chip, true);
			us = world_until_fault(w, fault, reported_as(w, chip), 2 * DETECTED_US);
			if (us < 0 || us > DETECTED_US)
				fail_msg("%s, chip %d: detected after %lld us", BOARDS[i], chip, (long long)us);
			world_run(w, 500000);
			assert_true(w->board.health.fault || w->board.health.degraded); /* still */
			put(w->sim, chip, false);
			assert_true(world_until_recovered(w, RECOVERED_US) >= 0);
			world_free(w);
		}
}

static void test_a_chip_that_does_not_answer_is_detected_and_recovers(void **state)
{
	(void)state;
	assert_detected_and_cleared(sim_board_silence, IMU_FAULT_SILENT);
}

/* There it reads as FFh, which would be values near 0 and not those of a sensor at rest. */
static void test_on_spi_a_chip_that_is_gone_is_detected_and_its_data_are_not_used(void **state)
{
	(void)state;
	for (int i = 0; i < BOARD_COUNT * 3 * 8; i++) { /* each sensor of each board eight times */
		const char *board = BOARDS[i / 24];
		const enum imu_chip chip = (enum imu_chip)(IMU_CHIP_GYRO + i / 8 % 3);
		struct world *w = is_spi(board) ? settled_with(board, chip) : NULL;
		const struct imu_health *h = w ? &w->board.health : NULL;
		struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
		struct imu_sample sample;

		if (!w)
			continue;
		settings.rate_hz = 500; /* with more reads between the checks of the registers */
		world_set_up(w, &settings, true);
		world_run(w, START_US + 1700 * (i % 8)); /* at any time between two reads */
		sim_board_silence(w->sim, chip, true);
		for (int64_t end_ns = w->now_ns + DETECTED_US * 1000; w->now_ns < end_ns;)
			if (world_sample(w, &sample, 10000)) {
				assert_true(fabs(sample.accel_m_s2.z - 9.81) < 1);
				assert_true(!(sample.flags & SAMPLE_MAG) || sample.mag_uT.z < -30);
			}
		assert_int_equal(chip == IMU_CHIP_MAG ? h->degraded_chip : h->fault_chip, reported_as(w, chip));
		sim_board_silence(w->sim, chip, false);
		assert_true(world_until_recovered(w, RECOVERED_US) >= 0);
		world_free(w);
	}
}

/* ---- levels of FIFOs --------------------------------------------------------------------------------------------- */

static struct {
	uint8_t at, size, bytes[4];
	int times;
} false_level;

static void put_false_level(struct world *w, const struct sim_access *access)
{
	if (access->write || access->address != sim_board_address(w->sim, IMU_CHIP_GYRO) ||
		(access->sub & 0x7F) != false_level.at || false_level.times == 0)
		return;
	memcpy(access->bytes, false_level.bytes, false_level.size);
	false_level.times--;
}

/* More than the FIFO holds, or an overrun of an empty one: an error of the bus, and the samples are read later. */
static void test_a_level_that_a_fifo_cannot_have_is_a_failed_transfer(void **state)
{
	static const struct {
		const char *board;
		uint8_t at, size, bytes[4];
	} levels[] = {{"v0", 0x2F, 1, {0xFF}}, {"v2", 0x2F, 1, {0xFF}}, {"v3", 0x2F, 1, {0xFF}},
		{"lsm9ds1", 0x2F, 1, {0xFF}}, {"lsm9ds1", 0x2F, 1, {33}}, {"v5", 0x3A, 4, {0xFF, 0xFF, 0xFF, 0xFF}},
		{"v5", 0x3A, 4, {1, 0x10, 0, 0}}, {"v6", 0x3A, 2, {0xFF, 0xFF}}, {"v6", 0x3A, 2, {0x01, 0x02}},
		{"icm20948", 0x70, 2, {0xFF, 0xFF}}, {"icm20948", 0x70, 2, {0x02, 0x0D}},
		{"icm42688", 0x2E, 2, {0xFF, 0xFF}}, {"icm42688", 0x2E, 2, {0x08, 0x11}},
		{"bmi270", 0x24, 2, {0xFF, 0xFF}}, {"bmi270", 0x24, 2, {0x0E, 0x08}}};

	(void)state;
	for (size_t i = 0; i < sizeof levels / sizeof *levels; i++) {
		struct world *w = settled(levels[i].board);
		const uint32_t errors = w->board.health.bus_errors, lost = w->board.health.overruns;

		false_level.at = levels[i].at;
		false_level.size = levels[i].size;
		memcpy(false_level.bytes, levels[i].bytes, sizeof false_level.bytes);
		false_level.times = 1;
		w->after = put_false_level;
		world_run(w, 500000);
		assert_int_equal(false_level.times, 0);
		if (w->board.health.bus_errors != errors + 1 || w->board.health.overruns != lost)
			fail_msg("%s, %02X %02X: %u errors, %u samples lost", levels[i].board, levels[i].bytes[0],
				levels[i].bytes[1], w->board.health.bus_errors - errors,
				w->board.health.overruns - lost);
		assert_int_equal(w->board.health.fault, 0);
		world_free(w);
	}
}

static uint8_t overrun_bit;

/* FIFO_STATUS2 of the LSM6DSO: FIFO_OVR_IA 40h becomes another bit. */
static void change_overrun(struct world *w, const struct sim_access *access)
{
	if (access->write || access->sub != 0x3A || access->address != sim_board_address(w->sim, IMU_CHIP_GYRO) ||
		!(access->bytes[1] & 0x40))
		return;
	access->bytes[1] = (uint8_t)((access->bytes[1] & ~0x40) | overrun_bit);
}

/* An overrun that has ended shows as FIFO_OVR_LATCHED 08h. */
static void test_a_latched_overrun_of_the_lsm6dso_counts(void **state)
{
	uint32_t lost[2];

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct world *w = settled("v6");
		const uint32_t before = w->board.health.overruns;

		overrun_bit = i ? 0x08 : 0x40;
		w->after = change_overrun;
		w->now_ns += 3500000000; /* the FIFO holds 2.5 s */
		board_step(&w->board);
		lost[i] = w->board.health.overruns - before;
		world_free(w);
	}
	assert_true(lost[0] > 50);
	assert_int_equal(lost[1], lost[0]);
}

static void test_a_chip_without_new_samples_is_detected_and_recovers(void **state)
{
	struct world *w;

	(void)state;
	/* not the sensors of an LSM6, which stop together */
	for (int i = 0; i < 4; i++)
		for (enum imu_chip chip = IMU_CHIP_GYRO; chip <= IMU_CHIP_MAG; chip++) {
			w = settled(BOARDS[i]);
			sim_board_stop(w->sim, chip, true);
			assert_in_range(world_until_fault(w, IMU_FAULT_STOPPED, chip, 2 * DETECTED_US), 1, DETECTED_US);
			sim_board_stop(w->sim, chip, false);
			assert_true(world_until_recovered(w, RECOVERED_US) >= 0);
			world_free(w);
		}
}

/* With noise below a digit, the detection takes longer. */
static int64_t frozen_within_us(const char *board, enum imu_chip chip)
{
	if (strncmp(board, "v3", 2) == 0 && chip == IMU_CHIP_GYRO)
		return 320000;
	if (board[0] == 'v' && strcmp(board, "v3") < 0 && chip == IMU_CHIP_MAG)
		return 140000;
	if (strcmp(board, "icm20948") == 0 && chip == IMU_CHIP_MAG)
		return 200000;
	return DETECTED_US;
}

static void test_frozen_data_are_detected_and_cleared_by_the_first_other_value(void **state)
{
	(void)state;
	for (int i = 0; i < BOARD_COUNT; i++)
		for (enum imu_chip chip = IMU_CHIP_GYRO; chip <= IMU_CHIP_MAG; chip++) {
			struct world *w = settled_with(BOARDS[i], chip);
			int64_t us;

			if (!w)
				continue;
			sim_board_freeze(w->sim, chip, true);
			if (w->board.accel == w->board.gyro) /* one chip: both freeze */
				sim_board_freeze(w->sim, chip == IMU_CHIP_GYRO ? IMU_CHIP_ACCEL : IMU_CHIP_GYRO, true);
			us = world_until_fault(w, IMU_FAULT_FROZEN, reported_as(w, chip), 4 * DETECTED_US);
			if (us < 0 || us > frozen_within_us(BOARDS[i], chip))
				fail_msg("%s, chip %d: detected after %lld us", BOARDS[i], chip, (long long)us);
			world_run(w, 1000000);
			assert_true(w->board.health.fault || w->board.health.degraded);
			for (enum imu_chip all = IMU_CHIP_GYRO; all <= IMU_CHIP_MAG; all++)
				if (sim_board_has(w->sim, all))
					sim_board_freeze(w->sim, all, false);
			assert_true(world_until_recovered(w, RECOVERED_US) >= 0);
			world_free(w);
		}
}

/* In ranges with digits coarser than the noise, values at rest repeat for seconds. */
static void test_a_coarse_range_at_rest_is_not_frozen(void **state)
{
	static const struct {
		const char *board;
		double accel_g, mag_uT;
	} coarse[] = {{"v0", 8, 810}, {"v1", 8, 810}, {"v2", 16, 810}, {"v3", 16, 1200}};

	(void)state;
	for (int i = 0; i < 4; i++) {
		struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
		struct world *w = world_make(coarse[i].board, "rest", false);

		settings.accel_range_g = coarse[i].accel_g;
		settings.mag_range_uT = coarse[i].mag_uT;
		world_detect(w);
		world_set_up(w, &settings, true);
		world_run(w, 20000000);
		assert_int_equal(w->board.health.restarts, 0);
		assert_int_equal(w->board.health.fault, 0);
		assert_int_equal(w->board.health.degraded, 0);
		world_free(w);
	}
}

static int stalls(struct world *w, const struct sim_access *access)
{
	if (access->number % 97 == 0)
		w->now_ns += (int64_t)(rng_u64(&w->rng) % 500000000);
	return 0;
}

static void stalls_after(struct world *w, const struct sim_access *access)
{
	if (access->number % 89 == 0)
		w->now_ns += (int64_t)(rng_u64(&w->rng) % 500000000);
}

static void test_a_machine_that_stalls_for_half_a_second_is_not_a_fault_of_the_chips(void **state)
{
	(void)state;
	for (int i = 0; i < BOARD_COUNT; i++) {
		struct world *w = settled(BOARDS[i]);

		w->before = stalls;
		w->after = stalls_after;
		w->late_ns = 50000000;
		for (int k = 0; k < 600; k++) {
			world_run(w, 100000);
			assert_int_equal(w->board.health.fault, 0);
			assert_int_equal(w->board.health.degraded, 0);
		}
		assert_int_equal(w->board.health.restarts, 0);
		world_free(w);
	}
}

static void test_saturated_data_are_detected_and_cleared_by_the_first_value_in_range(void **state)
{
	(void)state;
	assert_detected_and_cleared(sim_board_saturate, IMU_FAULT_SATURATED);
}

static void test_a_short_saturation_is_only_flagged(void **state)
{
	struct world *w = settled("v3");
	struct imu_sample sample;
	int flagged = 0;

	(void)state;
	sim_board_saturate(w->sim, IMU_CHIP_GYRO, true);
	for (int i = 0; i < 4; i++) {
		assert_true(world_sample(w, &sample, 100000));
		flagged += (sample.flags & SAMPLE_SATURATED) != 0;
	}
	assert_true(flagged >= 2);
	sim_board_saturate(w->sim, IMU_CHIP_GYRO, false);
	world_run(w, 200000);
	assert_int_equal(w->board.health.restarts, 0);
	assert_true(world_sample(w, &sample, 100000));
	assert_false(sample.flags & SAMPLE_SATURATED);
	world_free(w);
}

static void test_a_brown_out_is_detected_and_the_chip_initialised_again(void **state)
{
	(void)state;
	for (int i = 0; i < BOARD_COUNT; i++)
		for (enum imu_chip chip = IMU_CHIP_GYRO; chip <= IMU_CHIP_MAG; chip++) {
			struct world *w = settled_with(BOARDS[i], chip);
			struct imu_sample sample;
			int64_t us;

			if (!w)
				continue;
			sim_board_brown_out(w->sim, chip);
			us = world_until_fault(w, IMU_FAULT_CONFIGURATION, reported_as(w, chip), 2 * DETECTED_US);
			if (us < 0 || us > DETECTED_US)
				fail_msg("%s, chip %d: detected after %lld us", BOARDS[i], chip, (long long)us);
			assert_true(world_until_recovered(w, RECOVERED_US) >= 0);
			assert_true(world_sample(w, &sample, 200000));
			assert_true(w->board.health.restarts > 0);
			world_free(w);
		}
}

static void other_gyro(struct world *w, const struct sim_access *access)
{
	if (!access->write && access->sub == 0x0F && access->address == sim_board_address(w->sim, IMU_CHIP_GYRO))
		access->bytes[0] = 0xD4;
}

static void test_another_chip_at_the_same_address_is_not_used(void **state)
{
	struct world *w = settled("v3");

	(void)state;
	w->after = other_gyro;
	sim_board_brown_out(w->sim, IMU_CHIP_GYRO);
	world_run(w, 2000000);
	assert_int_equal(w->board.health.fault_chip, IMU_CHIP_GYRO);
	assert_int_equal(w->board.gyro->state, STREAM_DOWN);
	w->after = NULL;
	assert_true(world_until_recovered(w, RECOVERED_US) >= 0);
	world_free(w);
}

/* The chip is initialised again and again. */
static void test_a_chip_that_does_not_answer_is_a_bus_error_and_another_chip_is_none(void **state)
{
	(void)state;
	for (int other = 0; other < 2; other++) {
		struct world *w = settled("v3");
		unsigned before;

		w->after = other ? other_gyro : NULL;
		if (other)
			sim_board_brown_out(w->sim, IMU_CHIP_GYRO);
		else
			sim_board_silence(w->sim, IMU_CHIP_GYRO, true);
		world_run(w, 2000000);
		assert_int_equal(w->board.gyro->state, STREAM_DOWN);
		before = w->board.health.bus_errors;
		world_run(w, 5000000);
		assert_int_equal(w->board.health.bus_errors > before, !other);
		world_free(w);
	}
}

static void test_samples_continue_without_the_magnetometer_but_not_without_the_gyro(void **state)
{
	struct world *w = settled("v3");
	struct imu_sample sample;

	(void)state;
	sim_board_stop(w->sim, IMU_CHIP_MAG, true);
	assert_true(world_until_fault(w, IMU_FAULT_STOPPED, IMU_CHIP_MAG, DETECTED_US) > 0);
	for (int i = 0; i < 20; i++) {
		assert_true(world_sample(w, &sample, 50000));
		assert_false(sample.flags & SAMPLE_MAG);
	}
	sim_board_stop(w->sim, IMU_CHIP_GYRO, true);
	assert_true(world_until_fault(w, IMU_FAULT_STOPPED, IMU_CHIP_GYRO, DETECTED_US) > 0);
	assert_false(world_sample(w, &sample, 500000));
	world_free(w);
}

static int count_starts(struct world *w, const struct sim_access *access)
{
	if (access->sub != 0x0F || access->write)
		return 0;
	w->fault_count++;
	return -EIO;
}

static void test_the_retries_of_a_dead_chip_back_off_to_one_a_second(void **state)
{
	struct world *w = settled("v3");
	unsigned long first_second, later;

	(void)state;
	sim_board_stop(w->sim, IMU_CHIP_GYRO, true);
	world_until_fault(w, IMU_FAULT_STOPPED, IMU_CHIP_GYRO, DETECTED_US);
	w->before = count_starts;
	world_run(w, 1000000);
	first_second = w->fault_count;
	assert_in_range(first_second, 5, 8); /* after 10, 20, 40 .. 640 ms */
	world_run(w, 10000000);
	later = w->fault_count - first_second;
	assert_in_range(later, 9, 12);
	world_free(w);
}

static int every_tenth(struct world *w, const struct sim_access *access)
{
	(void)w;
	return access->number % 10 == 0 ? -EIO : 0;
}

static void test_a_tenth_of_all_transfers_may_fail(void **state)
{
	(void)state;
	for (int i = 0; i < BOARD_COUNT; i++) {
		struct world *w = settled(BOARDS[i]);
		struct imu_sample sample;

		w->before = every_tenth;
		for (int n = 0; n < 500; n++)
			assert_true(world_sample(w, &sample, 150000));
		assert_int_equal(w->board.health.fault, 0);
		assert_true(w->board.health.bus_errors > 100);
		world_free(w);
	}
}

/* ---- every access of the start and of the first reads, one run each ---------------------------------------------- */

enum { ALL_FOLLOWING = 1000000 };

static bool hit(const struct world *w, const struct sim_access *access)
{
	return access->number >= w->fault_at && access->number < w->fault_at + w->fault_count;
}

static int fails(struct world *w, const struct sim_access *access)
{
	return hit(w, access) ? -EREMOTEIO : 0;
}

static int write_is_lost(struct world *w, const struct sim_access *access)
{
	return access->write && hit(w, access) ? 1 : 0;
}

static void inverted(struct world *w, const struct sim_access *access)
{
	for (size_t i = 0; i < access->n && !access->write && hit(w, access); i++)
		access->bytes[i] = (uint8_t)~access->bytes[i];
}

static void all_ones(struct world *w, const struct sim_access *access)
{
	if (!access->write && hit(w, access))
		memset(access->bytes, 0xFF, access->n);
}

static void all_zeroes(struct world *w, const struct sim_access *access)
{
	if (!access->write && hit(w, access))
		memset(access->bytes, 0x00, access->n);
}

/* Detects and sets up while the fault is active; false: refused with a reason. */
static bool begun(struct world *w)
{
	const struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	const struct board_clock clock = w->board.clock;
	char why[200] = "";

	if (board_detect(&w->board, w->bus, &clock, why, sizeof why) < 0) {
		assert_true(why[0] != '\0');
		return false;
	}
	w->board.firmware = w->firmware;
	world_set_up(w, &settings, true);
	return true;
}

static struct world *with_fault(const char *board, unsigned long at, unsigned long count,
	int (*before)(struct world *, const struct sim_access *),
	void (*after)(struct world *, const struct sim_access *))
{
	struct world *w = world_make(board, "square", false);

	world_detect(w); /* for its clock */
	w->fault_at = at + w->accesses;
	w->fault_count = count;
	w->before = before;
	w->after = after;
	return w;
}

/* After one disturbed access there is no fault and there are samples within a second. */
static void assert_recovers_from_one(int (*before)(struct world *, const struct sim_access *),
	void (*after)(struct world *, const struct sim_access *))
{
	for (int i = 0; i < BOARD_COUNT; i++)
		for (unsigned long at = 0; at < 120; at++) {
			struct world *w = with_fault(BOARDS[i], at, 1, before, after);
			struct imu_sample sample;

			if (begun(w) || begun(w)) {
				world_run(w, 1000000);
				if (w->board.health.fault || w->board.health.degraded ||
					!world_sample(w, &sample, 200000))
					fail_msg("%s, access %lu: fault %d of %d, degraded %d", BOARDS[i], at,
						w->board.health.fault, w->board.health.fault_chip,
						w->board.health.degraded);
			}
			world_free(w);
		}
}

/* All accesses from one on are disturbed: the start fails, or a fault is detected within 100 ms. Without the
 * disturbance the driver recovers. */
static void assert_all_from_there_are_detected(int (*before)(struct world *, const struct sim_access *),
	void (*after)(struct world *, const struct sim_access *))
{
	for (int i = 0; i < BOARD_COUNT; i++)
		for (unsigned long at = 0; at < 120; at++) {
			struct world *w = with_fault(BOARDS[i], at, ALL_FOLLOWING, before, after);
			struct imu_sample sample;
			bool faulty;

			if (begun(w)) {
				while (w->accesses < w->fault_at)
					world_run(w, 1000);
				world_run(w, DETECTED_US);
				faulty = w->board.health.fault || w->board.health.degraded;
				if (!faulty)
					fail_msg("%s, from access %lu on: no fault after 100 ms", BOARDS[i], at);
			}
			w->before = NULL;
			w->after = NULL;
			assert_true(w->board.gyro && w->board.accel ? true : begun(w));
			assert_true(world_until_recovered(w, RECOVERED_US) >= 0);
			assert_true(world_sample(w, &sample, START_US));
			world_free(w);
		}
}

static void test_the_driver_recovers_from_any_one_failed_transfer(void **state)
{
	(void)state;
	assert_recovers_from_one(fails, NULL);
}

static void test_the_driver_recovers_from_any_one_transfer_with_wrong_data(void **state)
{
	(void)state;
	assert_recovers_from_one(NULL, inverted);
}

static void test_the_driver_recovers_from_any_one_lost_write(void **state)
{
	(void)state;
	assert_recovers_from_one(write_is_lost, NULL);
}

static void test_a_bus_that_fails_from_any_access_on_is_detected(void **state)
{
	(void)state;
	assert_all_from_there_are_detected(fails, NULL);
}

static void test_a_bus_stuck_at_one_from_any_access_on_is_detected(void **state)
{
	(void)state;
	assert_all_from_there_are_detected(NULL, all_ones);
}

static void test_a_bus_stuck_at_zero_from_any_access_on_is_detected(void **state)
{
	(void)state;
	assert_all_from_there_are_detected(NULL, all_zeroes);
}

static void test_wrong_data_from_any_access_on_are_detected(void **state)
{
	(void)state;
	assert_all_from_there_are_detected(NULL, inverted);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_chip_that_does_not_answer_is_detected_and_recovers),
		cmocka_unit_test(test_on_spi_a_chip_that_is_gone_is_detected_and_its_data_are_not_used),
		cmocka_unit_test(test_a_level_that_a_fifo_cannot_have_is_a_failed_transfer),
		cmocka_unit_test(test_a_latched_overrun_of_the_lsm6dso_counts),
		cmocka_unit_test(test_a_chip_without_new_samples_is_detected_and_recovers),
		cmocka_unit_test(test_frozen_data_are_detected_and_cleared_by_the_first_other_value),
		cmocka_unit_test(test_a_coarse_range_at_rest_is_not_frozen),
		cmocka_unit_test(test_a_machine_that_stalls_for_half_a_second_is_not_a_fault_of_the_chips),
		cmocka_unit_test(test_saturated_data_are_detected_and_cleared_by_the_first_value_in_range),
		cmocka_unit_test(test_a_short_saturation_is_only_flagged),
		cmocka_unit_test(test_a_brown_out_is_detected_and_the_chip_initialised_again),
		cmocka_unit_test(test_another_chip_at_the_same_address_is_not_used),
		cmocka_unit_test(test_a_chip_that_does_not_answer_is_a_bus_error_and_another_chip_is_none),
		cmocka_unit_test(test_samples_continue_without_the_magnetometer_but_not_without_the_gyro),
		cmocka_unit_test(test_the_retries_of_a_dead_chip_back_off_to_one_a_second),
		cmocka_unit_test(test_a_tenth_of_all_transfers_may_fail),
		cmocka_unit_test(test_the_driver_recovers_from_any_one_failed_transfer),
		cmocka_unit_test(test_the_driver_recovers_from_any_one_transfer_with_wrong_data),
		cmocka_unit_test(test_the_driver_recovers_from_any_one_lost_write),
		cmocka_unit_test(test_a_bus_that_fails_from_any_access_on_is_detected),
		cmocka_unit_test(test_a_bus_stuck_at_one_from_any_access_on_is_detected),
		cmocka_unit_test(test_a_bus_stuck_at_zero_from_any_access_on_is_detected),
		cmocka_unit_test(test_wrong_data_from_any_access_on_are_detected),
	};

	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}
