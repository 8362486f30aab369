/* The driver on chips that another program has used: whatever it left in registers and FIFO, the samples are as after
 * power-on. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <string.h>

#include "tests/unit/i2c_world.h"

static const char *const BOARDS[] = {"v0", "v1", "v2", "v3", "v5", "v6"};
enum { BOARD_COUNT = sizeof BOARDS / sizeof *BOARDS };

/* The registers that the driver writes, of each address. */
static struct {
	bool written[128][256];
	uint8_t value[128][256];
} seen;

static int note(struct world *w, const struct sim_access *access)
{
	(void)w;
	if (access->write) {
		seen.written[access->address][access->sub & 0x7F] = true;
		seen.value[access->address][access->sub & 0x7F] = access->bytes[0];
	}
	return 0;
}

/* All control registers of the chips have the one value, and then the driver starts. */
static struct world *started_after(const char *board, int left_over)
{
	const struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	struct world *w = world_make(board, "turntable", false);

	for (int chip = IMU_CHIP_GYRO; chip <= IMU_CHIP_MAG && left_over >= 0; chip++)
		for (int reg = 0x00; reg < 0x40; reg++)
			i2c_write(w->bus, sim_board_address(w->sim, (enum imu_chip)chip), (uint8_t)reg,
				(uint8_t)left_over);
	w->now_ns += 100000000;
	world_detect(w);
	memset(&seen, 0, sizeof seen);
	w->before = note;
	world_set_up(w, &settings, true);
	world_run(w, 3000000);
	w->before = NULL;
	return w;
}

static void mean_of(struct world *w, struct vec3 mean[3], double *rate_hz)
{
	struct imu_sample sample;
	uint64_t first_us = 0;
	int n = 0, mags = 0;

	memset(mean, 0, 3 * sizeof *mean);
	while (n < 200) {
		assert_true(world_sample(w, &sample, 200000));
		if (n++ == 0)
			first_us = sample.t_us;
		mean[0] = vec3_add(mean[0], vec3_scale(1 / 200.0, sample.gyro_rad_s));
		mean[1].z += sample.accel_m_s2.z / 200;
		mean[2].z += sample.flags & SAMPLE_MAG ? sample.mag_uT.z : 0;
		mags += !!(sample.flags & SAMPLE_MAG);
	}
	assert_true(mags > 0);
	mean[2].z /= mags;
	*rate_hz = 199 / (1e-6 * (double)(sample.t_us - first_us));
}

static void test_what_was_in_the_registers_before_does_not_matter(void **state)
{
	static const int left_over[] = {0x00, 0xFF, 0x55, 0xAA, 0x01, 0x80};

	(void)state;
	for (int i = 0; i < BOARD_COUNT; i++) {
		struct world *w = started_after(BOARDS[i], -1);
		struct vec3 expected[3], found[3];
		double expected_hz, found_hz;

		mean_of(w, expected, &expected_hz);
		world_free(w);
		for (size_t k = 0; k < sizeof left_over / sizeof *left_over; k++) {
			w = started_after(BOARDS[i], left_over[k]);
			assert_int_equal(w->board.health.fault | w->board.health.degraded, 0);
			mean_of(w, found, &found_hz);
			for (int sensor = 0; sensor < 3; sensor++)
				if (vec3_norm(vec3_sub(found[sensor], expected[sensor])) >
					0.02 * vec3_norm(expected[sensor]))
					fail_msg("%s after %02X: sensor %d differs", BOARDS[i], left_over[k], sensor);
			if (fabs(found_hz / expected_hz - 1) > 0.003)
				fail_msg("%s after %02X: %g samples a second", BOARDS[i], left_over[k], found_hz);
			world_free(w);
		}
	}
}

/* What the driver wrote is what the chips have. */
static void test_every_register_has_the_value_that_was_written_last(void **state)
{
	(void)state;
	for (int i = 0; i < BOARD_COUNT; i++) {
		struct world *w = started_after(BOARDS[i], 0xFF);

		for (int chip = IMU_CHIP_GYRO; chip <= IMU_CHIP_MAG; chip++) {
			const uint8_t *regs = sim_board_registers(w->sim, (enum imu_chip)chip);
			const uint8_t address = sim_board_address(w->sim, (enum imu_chip)chip);

			for (int reg = 0; reg < 128; reg++)
				if (seen.written[address][reg])
					assert_int_equal(regs[reg], seen.value[address][reg]);
		}
		world_free(w);
	}
}

/* LSM6DS33: FIFO_STATUS3 says that a FIFO begins in the middle of a set, after an overrun. The rest of that set is read
 * first. */
static int place;
static size_t first_read;

static void begins_inside(struct world *w, const struct sim_access *access)
{
	(void)w;
	if (access->write || access->address != 0x6B)
		return;
	if (access->sub == 0x3A && access->n == 4 && first_read == 0)
		access->bytes[2] = (uint8_t)place;
	if (access->sub == 0x3E && first_read == 0)
		first_read = access->n;
}

static void test_a_fifo_that_begins_inside_a_set_is_read_from_the_next_one_on(void **state)
{
	(void)state;
	for (place = 0; place < 6; place++) {
		struct world *w = world_new("v5", "rest", false);
		struct imu_sample sample;

		world_run(w, 1000000);
		w->now_ns += 500000000;
		first_read = 0;
		w->after = begins_inside;
		board_step(&w->board);
		assert_int_equal(first_read % 12, place ? 2 * (6 - place) : 0);
		(void)board_next(&w->board, &sample);
		world_free(w);
	}
}

/* Whatever the chips and the machine do meanwhile: stopped, silent, out of power, or not read for a while. */
static void test_the_times_of_samples_increase_over_every_fault(void **state)
{
	(void)state;
	for (int i = 0; i < BOARD_COUNT; i++) {
		struct world *w = world_new(BOARDS[i], "tumble", false);
		struct imu_sample sample;
		uint64_t last_us = 0;

		w->late_ns = 3000000;
		for (int k = 0; k < 60; k++) {
			const enum imu_chip chip = k % 2 ? IMU_CHIP_GYRO : IMU_CHIP_ACCEL;

			for (int64_t end_ns = w->now_ns + (int64_t)(rng_u64(&w->rng) % 700) * 1000000;
				w->now_ns < end_ns;)
				if (world_sample(w, &sample, 20000)) {
					assert_true(sample.t_us > last_us);
					assert_true((int64_t)sample.t_us * 1000 <= w->now_ns);
					last_us = sample.t_us;
				}
			sim_board_silence(w->sim, chip, k % 5 == 0);
			sim_board_stop(w->sim, chip, k % 5 == 1);
			if (k % 5 == 2)
				sim_board_brown_out(w->sim, chip);
			if (k % 5 == 3)
				w->now_ns += 1000000 * (int64_t)(rng_u64(&w->rng) % 500);
		}
		assert_true(last_us > 0);
		world_free(w);
	}
}

/* Time of the soft reset (B6h to CMD) and of the first write behind it that leaves power saving, and when the next
 * access began. */
static int64_t reset_ns, reset_next_ns, awake_ns, awake_next_ns;

static int time_start(struct world *w, const struct sim_access *access)
{
	if (reset_ns && !reset_next_ns)
		reset_next_ns = w->now_ns;
	if (awake_ns && !awake_next_ns)
		awake_next_ns = w->now_ns;
	if (access->write && access->sub == 0x7E && access->bytes[0] == 0xB6)
		reset_ns = w->now_ns;
	if (access->write && access->sub == 0x7C && reset_ns && !awake_ns)
		awake_ns = w->now_ns;
	return 0;
}

/* Data sheet: 2 ms after a soft reset, 0.45 ms after power saving. */
static void test_a_bmi270_is_left_alone_after_a_reset_and_until_it_is_awake(void **state)
{
	struct world *w = world_new("bmi270", "rest", false);

	(void)state;
	reset_ns = reset_next_ns = awake_ns = awake_next_ns = 0;
	w->before = time_start;
	world_run(w, 1000000);
	assert_true(reset_ns > 0 && awake_ns > reset_ns);
	assert_true(reset_next_ns - reset_ns >= 2000000);
	assert_true(awake_next_ns - awake_ns >= 450000);
	w->before = NULL;
	world_free(w);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_what_was_in_the_registers_before_does_not_matter),
		cmocka_unit_test(test_every_register_has_the_value_that_was_written_last),
		cmocka_unit_test(test_the_times_of_samples_increase_over_every_fault),
		cmocka_unit_test(test_a_fifo_that_begins_inside_a_set_is_read_from_the_next_one_on),
		cmocka_unit_test(test_a_bmi270_is_left_alone_after_a_reset_and_until_it_is_awake),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
