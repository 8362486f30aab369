/* When a chip has a fault, to the sample and the nanosecond (drivers/imu/pololu/board.h): numbers of equal and
 * saturated samples, times without samples and without answers, registers read back. The state of a simulated chip is
 * set by hand; the limits are those of board.h. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>
#include <errno.h>
#include <math.h>

#include "drivers/imu/pololu/board_parts.h"
#include "tests/unit/descriptors.h"
#include "tests/unit/i2c_world.h"

static struct world *w;

/* The gyro of a v3 at this rate, up and without a fault. */
static struct stream *gyro_at(double rate_hz)
{
	struct imu_settings settings = IMU_SETTINGS_DEFAULTS;

	w = world_make("v3", "rest", false);
	world_detect(w);
	settings.rate_hz = rate_hz;
	world_set_up(w, &settings, true);
	world_run(w, 600000);
	assert_int_equal(w->board.gyro->state, STREAM_UP);
	return w->board.gyro;
}

static bool fails(struct stream *s, enum imu_fault fault)
{
	struct stream before = *s;
	bool failed;

	stream_watch(&w->board, s);
	failed = s->state == STREAM_DOWN;
	assert_true(!failed || s->fault == fault);
	*s = before;
	return failed;
}

/* For 60 ms, and four samples at least. */
static void test_a_chip_at_the_end_of_its_range_for_60_ms_has_a_fault(void **state)
{
	static const double RATES[] = {12.5, 100, 200, 800};

	(void)state;
	for (size_t i = 0; i < sizeof RATES / sizeof *RATES; i++) {
		struct stream *s = gyro_at(RATES[i]);
		const unsigned samples = (unsigned)fmax(4, ceil(0.06 * s->setup.rate->hz));

		s->saturated = samples - 1;
		assert_false(fails(s, IMU_FAULT_SATURATED));
		s->saturated = samples;
		assert_true(fails(s, IMU_FAULT_SATURATED));
		world_free(w);
	}
}

static void test_equal_samples_are_a_fault_where_noise_cannot_explain_them(void **state)
{
	struct stream *s = gyro_at(100);

	(void)state;
	s->same_limit = 7;
	s->same = 6;
	assert_false(fails(s, IMU_FAULT_FROZEN));
	s->same = 7;
	assert_true(fails(s, IMU_FAULT_FROZEN));
	s->saturated = 1; /* equal because they are at the end of the range */
	assert_false(fails(s, IMU_FAULT_FROZEN));
	s->saturated = 0;
	s->same_limit = 0;
	assert_false(fails(s, IMU_FAULT_FROZEN));
	world_free(w);
}

/* 50 ms and two sampling intervals between two reads, without a new sample in the second; a program that writes the
 * registers of a stub may be late by a second. */
static void test_a_chip_without_a_sample_for_50_ms_has_stopped(void **state)
{
	struct stream *s = gyro_at(100);

	(void)state;
	s->none_ns = s->fresh_ns + 70000000;
	assert_false(fails(s, IMU_FAULT_STOPPED));
	s->none_ns++;
	assert_true(fails(s, IMU_FAULT_STOPPED));
	s->setup.stub = true;
	assert_false(fails(s, IMU_FAULT_STOPPED));
	s->none_ns = s->fresh_ns + 1020000001;
	assert_true(fails(s, IMU_FAULT_STOPPED));
	s->same_limit = 0; /* equal data may be new */
	assert_false(fails(s, IMU_FAULT_STOPPED));
	world_free(w);
}

/* Three transfers in a row fail, over 20 ms at least. */
static void test_a_chip_that_does_not_answer_for_20_ms_is_silent(void **state)
{
	static const struct {
		unsigned failures;
		int64_t over_ns;
		bool silent;
	} cases[] = {{2, 50000000, false}, {3, 19999999, false}, {3, 20000000, true}, {4, 19999999, false}};

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		struct stream *s = gyro_at(100);
		const uint32_t errors = w->board.health.bus_errors;

		for (unsigned n = 1; n < cases[i].failures; n++)
			stream_count_errors(&w->board, s, -EIO);
		w->board.now_ns += cases[i].over_ns;
		stream_count_errors(&w->board, s, -EIO);
		assert_int_equal(s->state == STREAM_DOWN, cases[i].silent);
		assert_int_equal(s->fault, cases[i].silent ? IMU_FAULT_SILENT : IMU_FAULT_NONE);
		assert_int_equal(w->board.health.bus_errors, errors + cases[i].failures);
		if (!cases[i].silent) { /* an answer ends the row */
			stream_count_errors(&w->board, s, 0);
			stream_count_errors(&w->board, s, -EIO);
			stream_count_errors(&w->board, s, -EIO);
			assert_int_equal(s->state, STREAM_UP);
		}
		world_free(w);
	}
}

static int accesses_at_registers(struct world *world, const struct sim_access *access)
{
	(void)world;
	return access->write ? -EIO : 0;
}

/* One register in 10 ms, each in its turn; those that are written twice have the last value. */
static void test_the_registers_are_read_back_in_turn(void **state)
{
	struct stream *s = gyro_at(100);
	size_t checked = 0;

	(void)state;
	w->before = accesses_at_registers; /* nothing is written meanwhile */
	for (size_t i = 0; i < s->registers.n; i++)
		checked += stream_expected(&s->registers, i) >= 0;
	assert_true(checked > 3);
	s->verify = 0;
	for (size_t n = 0; n < 3 * checked; n++) {
		const size_t first = s->verify;

		stream_verify_next(&w->board, s);
		assert_int_equal(s->verify_ns, w->board.now_ns + 9000000); /* and at most one for the next read */
		assert_true(s->verify != first);
		assert_int_equal(s->state, STREAM_UP);
	}
	world_free(w);
}

static uint8_t damaged_reads;

static void damage(struct world *world, const struct sim_access *access)
{
	(void)world;
	if (!access->write && damaged_reads > 0 && damaged_reads-- > 0)
		access->bytes[0] ^= 0x10;
}

/* A value that was read wrongly once is read again. */
static void test_a_register_with_another_value_twice_is_a_fault(void **state)
{
	struct stream *s = gyro_at(100);

	(void)state;
	w->after = damage;
	damaged_reads = 1;
	stream_verify_next(&w->board, s);
	assert_int_equal(s->state, STREAM_UP);
	damaged_reads = 2;
	stream_verify_next(&w->board, s);
	assert_int_equal(s->state, STREAM_DOWN);
	assert_int_equal(s->fault, IMU_FAULT_CONFIGURATION);
	world_free(w);
}

/* Probability that noise of this sigma, in digits, stays within half a digit: Simpson's rule over the density. */
static double within_half_a_digit(double sigma)
{
	const int n = 1000;
	double sum = 0;

	for (int i = 0; i <= n; i++) {
		const double x = (-0.5 + (double)i / n) / sigma;

		sum += (i == 0 || i == n ? 1 : i % 2 ? 4 : 2) * exp(-x * x / 2);
	}
	return sum / (3 * n) / (sigma * sqrt(2 * acos(-1)));
}

/* Of a quiet chip the noise is 0.6 of the data sheet's, behind a low-pass of the first order, of which a new value
 * contains the share that the last one does not determine. Equal values by noise alone, on all axes at once, have a
 * probability below 1e-12; the limit is 50 ms at least, and none beyond a second. */
static void test_the_number_of_equal_samples_follows_from_the_noise_of_the_chip(void **state)
{
	static const char *const BOARDS[] = {"v0", "v2", "v3", "v5", "v6", "lsm9ds1", "icm20948", "bmi270"};
	static const double RATES[] = {50, 100, 400};
	int limited = 0, never = 0;

	(void)state;
	for (size_t i = 0; i < 3 * sizeof BOARDS / sizeof *BOARDS; i++) {
		struct imu_settings settings = IMU_SETTINGS_DEFAULTS;

		w = world_make(BOARDS[i / 3], "rest", false);
		world_detect(w);
		settings.rate_hz = RATES[i % 3];
		settings.mag_range_uT = i % 3 == 1 ? 800 : settings.mag_range_uT; /* a digit coarser than the noise */
		world_set_up(w, &settings, true);
		for (size_t k = 0; k < w->board.stream_count; k++) {
			const struct stream *s = &w->board.streams[k];
			const double rate_hz = s->setup.rate->hz, bandwidth_hz = s->setup.bandwidth_hz,
				     kept = exp(-2 * acos(-1) * bandwidth_hz / rate_hz);
			double chance = 1, expected = 1, n;

			for (size_t t = 0; t < s->chip->triad_count; t++) {
				const struct chip_triad *triad = &s->chip->triads[t];
				const double digit = s->setup.range[t]->step * (triad->digit ? triad->digit : 1);
				const double sigma = 0.6 * triad->density * sqrt(fmin(bandwidth_hz, rate_hz / 2)) *
						     sqrt(1 - kept * kept) / digit;

				chance *= pow(within_half_a_digit(sigma), 3);
			}
			for (n = 1; expected > 1e-12 && n < 1e5; n++)
				expected *= chance;
			n = n > rate_hz ? 0 : fmax(n, ceil(0.05 * rate_hz));
			if (n != stream_same_limit(s))
				fail_msg("%s at %g Hz, chip %zu: %u, expected %g", BOARDS[i / 3], rate_hz, k,
					stream_same_limit(s), n);
			limited += n > 0;
			never += n == 0;
		}
		world_free(w);
	}
	if (limited < 20 || never < 2)
		fail_msg("%d have a limit, %d none", limited, never);
}

/* 10 ms, then twice as long each time, up to a second; from the start again after more than a second without a
 * fault. */
static void test_a_chip_with_a_fault_is_initialised_again_after_a_back_off(void **state)
{
	static const int64_t PAUSES_MS[] = {10, 20, 40, 80, 160, 320, 640, 1000, 1000};
	struct stream *s = gyro_at(100);
	struct board *b = &w->board;

	(void)state;
	s->backoff_ns = 10000000;
	for (size_t i = 0; i < sizeof PAUSES_MS / sizeof *PAUSES_MS; i++) {
		s->state = STREAM_UP;
		s->since_ns = b->now_ns - 1000000000;
		stream_fail(b, s, IMU_FAULT_SILENT);
		assert_int_equal(s->since_ns, b->now_ns);
		assert_int_equal(s->retry_ns, b->now_ns + PAUSES_MS[i] * 1000000);
	}
	s->state = STREAM_STARTING; /* it was not up */
	s->since_ns = b->now_ns - 1000000001;
	stream_fail(b, s, IMU_FAULT_SILENT);
	assert_int_equal(s->retry_ns, b->now_ns + 1000000000);
	s->state = STREAM_UP;
	s->since_ns = b->now_ns - 1000000001;
	stream_fail(b, s, IMU_FAULT_STOPPED);
	assert_int_equal(s->retry_ns, b->now_ns + 10000000);
	assert_int_equal(s->fault, IMU_FAULT_SILENT); /* the first one since it was well */
	assert_int_equal(s->count, 0);
	world_free(w);
}

/* The clock of a chip that was initialised again may begin before the last sample. */
static void test_a_sample_is_later_than_the_one_before(void **state)
{
	struct stream *s = gyro_at(100);
	struct imu_sample sample;
	uint64_t last_us;

	(void)state;
	(void)s;
	assert_true(world_sample(w, &sample, 100000));
	last_us = sample.t_us + 35000;
	w->board.last_t_ns += 35e6;
	assert_true(world_sample(w, &sample, 100000));
	assert_in_range(sample.t_us, last_us + 1, last_us + 12000);
	world_free(w);
}

/* ---- samples ----------------------------------------------------------------------------------------------------- */

/* Sample 10 was taken at 1 s, and one every 10 ms exactly. */
static void know_the_time_of_sample_10(struct stream *s)
{
	sample_clock_start(&s->clock, 1e7, 0.2);
	s->clock.newest = s->clock.anchor = 10;
	s->clock.lo_ns = s->clock.hi_ns = s->clock.taken_ns = s->clock.anchor_lo_ns = s->clock.anchor_hi_ns = 1e9;
	s->clock.shortest_ns = s->clock.longest_ns = 1e7;
	s->next = 11;
}

/* The oldest of `level` samples is the next one, at 1.01 s, unless samples were lost before it. */
static void test_lost_samples_are_counted_by_the_time(void **state)
{
	static const struct {
		int64_t level, from_ns;
		enum losses losses;
		int64_t lost;
	} cases[] = {{1, 1045000000, LOST_PERHAPS, 3}, {1, 1045000000, LOST_SOME, 3}, {1, 1045000000, LOST_NONE, 0},
		{1, 1019000000, LOST_PERHAPS, 0}, {1, 1021000000, LOST_PERHAPS, 1}, {1, 1011000000, LOST_SOME, 1},
		{3, 1045000000, LOST_PERHAPS, 1}, {0, 1045000000, LOST_PERHAPS, 4}, {4, 1020000000, LOST_PERHAPS, 0}};
	struct stream *s = gyro_at(100);

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		const uint32_t before = w->board.health.overruns;

		know_the_time_of_sample_10(s);
		s->none_ns = 0;
		stream_observe(
			&w->board, s, cases[i].level, cases[i].losses, cases[i].from_ns, cases[i].from_ns + 50000);
		assert_int_equal(s->next, 11 + cases[i].lost);
		assert_int_equal(w->board.health.overruns - before, cases[i].lost);
		assert_int_equal(s->none_ns, cases[i].level == 0 ? cases[i].from_ns : 0);
	}
	know_the_time_of_sample_10(s);
	s->clock.newest = -1; /* there was no sample before */
	stream_observe(&w->board, s, 1, LOST_SOME, 1045000000, 1045050000);
	assert_int_equal(s->next, 11);
	world_free(w);
}

/* A program copies samples to the registers of a stub within 2 ms. */
static void test_a_sample_of_a_stub_may_be_two_milliseconds_older_than_the_read(void **state)
{
	struct stream *s = gyro_at(100);

	(void)state;
	for (int stub = 0; stub < 2; stub++) {
		sample_clock_start(&s->clock, 1e7, 0);
		s->setup.stub = stub;
		s->next = 0;
		stream_observe(&w->board, s, 1, LOST_NONE, 1000000000, 1000100000);
		assert_true(fabs(s->clock.lo_ns - (990e6 - 2e6 * stub)) < 1);
		assert_true(fabs(s->clock.hi_ns - 1000.1e6) < 1);
	}
	world_free(w);
}

static void add_word(struct stream *s, int16_t x)
{
	const uint8_t set[CHIP_SET] = {(uint8_t)x, (uint8_t)((uint16_t)x >> 8), 1, 0, 2, 0};

	stream_add(&w->board, s, set);
}

/* 32752 is 2047 left-justified in 16 bits, the end of 12 bits. */
static void test_words_at_the_ends_of_the_range_are_saturated_and_counted(void **state)
{
	static const struct {
		int16_t word;
		bool saturated;
	} words[] = {{32751, false}, {32752, true}, {32767, true}, {-32751, false}, {-32752, true}, {-32768, true}};
	struct stream *s = gyro_at(100);

	(void)state;
	for (size_t i = 0; i < sizeof words / sizeof *words; i++) {
		s->saturated = 3;
		s->count = s->first = 0;
		add_word(s, words[i].word);
		assert_int_equal(s->saturated, words[i].saturated ? 4 : 0);
		assert_int_equal(s->readings[0].saturated, words[i].saturated);
	}
	world_free(w);
}

static void test_equal_words_are_counted_from_one(void **state)
{
	struct stream *s = gyro_at(100);

	(void)state;
	s->same = 0;
	add_word(s, 5);
	assert_int_equal(s->same, 1);
	add_word(s, 5);
	assert_int_equal(s->same, 2);
	add_word(s, 6);
	assert_int_equal(s->same, 1);
	world_free(w);
}

static void test_of_readings_that_nobody_takes_the_newest_64_remain(void **state)
{
	struct stream *s = gyro_at(100);
	const double digit = s->setup.range[0]->step;

	(void)state;
	s->count = 0;
	s->first = 60;
	for (int16_t i = 0; i < 67; i++)
		add_word(s, i);
	assert_int_equal(s->count, 64);
	for (size_t i = 0; i < 64; i++)
		assert_true(fabs(s->readings[(s->first + i) % 64].value[0].x - (3 + (double)i) * digit) < 1e-9);
	world_free(w);
}

/* After its initialisation a chip gives samples once their time is known, or after 16; and when its fault is over. */
static void test_a_chip_is_up_when_its_clock_is_locked_or_after_16_samples(void **state)
{
	static const struct {
		bool locked;
		int64_t samples;
		enum imu_fault fault;
		int16_t word; /* the one before was 7 */
		bool up;
	} cases[] = {{true, 2, IMU_FAULT_SILENT, 5, true}, {false, 15, IMU_FAULT_SILENT, 5, false},
		{false, 16, IMU_FAULT_SILENT, 5, true}, {true, 2, IMU_FAULT_FROZEN, 7, false},
		{true, 2, IMU_FAULT_FROZEN, 8, true}, {true, 2, IMU_FAULT_SATURATED, 32767, false},
		{true, 2, IMU_FAULT_SATURATED, 8, true}, {true, 2, IMU_FAULT_SILENT, 32767, true},
		{true, 2, IMU_FAULT_SILENT, 7, true}};

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		struct stream *s = gyro_at(100);

		know_the_time_of_sample_10(s);
		add_word(s, 7);
		s->state = STREAM_STARTING;
		s->fault = cases[i].fault;
		s->saturated = 0;
		s->count = 0;
		s->clock.newest = cases[i].samples - 1;
		s->clock.hi_ns += cases[i].locked ? 0 : 5e6;
		add_word(s, cases[i].word);
		assert_int_equal(s->state, cases[i].up ? STREAM_UP : STREAM_STARTING);
		assert_int_equal(s->fault, cases[i].up ? IMU_FAULT_NONE : cases[i].fault);
		assert_int_equal(s->count, cases[i].up);
		assert_int_equal(s->fresh_ns, w->board.now_ns);
		world_free(w);
	}
}

/* ---- samples of the board ---------------------------------------------------------------------------------------- */

static void put_reading(struct stream *s, double t_ms, double x, double y, bool saturated)
{
	s->readings[(s->first + s->count++) % STREAM_READINGS] =
		(struct reading){.t_ns = 1e6 * t_ms, .value = {{x, y, 0}}, .saturated = saturated};
}

/* A board of three chips without any reading, nothing delivered yet. */
static struct board *empty_board(void)
{
	struct board *b;

	(void)gyro_at(100);
	b = &w->board;
	for (size_t i = 0; i < b->stream_count; i++)
		b->streams[i].count = b->streams[i].first = 0;
	b->last_t_ns = 0;
	b->temperature_new = false;
	return b;
}

static void test_the_acceleration_is_that_of_the_time_of_the_gyro(void **state)
{
	struct board *b = empty_board();
	struct imu_sample sample;

	(void)state;
	assert_false(board_next(b, &sample));
	put_reading(b->gyro, 990, 1, 0, false); /* before any acceleration: lost */
	put_reading(b->gyro, 1000, 2, 0, false);
	assert_false(board_next(b, &sample));
	put_reading(b->accel, 995, 10, 1, false);
	assert_false(board_next(b, &sample)); /* the one behind is not known yet */
	assert_int_equal(b->gyro->count, 1);
	put_reading(b->accel, 1005, 20, 3, false);
	assert_true(board_next(b, &sample));
	assert_int_equal(sample.t_us, 1000000);
	assert_true(sample.gyro_rad_s.x == 2);
	assert_true(fabs(sample.accel_m_s2.x - 15) < 1e-9 && fabs(sample.accel_m_s2.y - 2) < 1e-9);
	assert_int_equal(sample.flags, 0);
	put_reading(b->gyro, 1005, 3, 0, false); /* at the same time, and the one behind is not known */
	assert_false(board_next(b, &sample));
	put_reading(b->accel, 1015, 40, 3, false);
	assert_true(board_next(b, &sample));
	assert_true(fabs(sample.accel_m_s2.x - 20) < 1e-9);
	put_reading(b->gyro, 1012, 3, 0, false);
	assert_true(board_next(b, &sample));
	assert_true(fabs(sample.accel_m_s2.x - 34) < 1e-9);
	world_free(w);
}

static void test_a_sample_is_saturated_if_one_of_its_readings_is(void **state)
{
	(void)state;
	for (int which = 0; which < 5; which++) {
		struct board *b = empty_board();
		struct imu_sample sample;

		put_reading(b->accel, 995, 1, 0, which == 1);
		put_reading(b->accel, 1005, 1, 0, which == 2);
		put_reading(b->gyro, 1000, 1, 0, which == 0);
		put_reading(b->mag, 999, 1, 0, which == 3);
		assert_true(board_next(b, &sample));
		assert_int_equal(sample.flags, SAMPLE_MAG | (which < 4 ? SAMPLE_SATURATED : 0));
		world_free(w);
	}
}

/* A field v that is dt old was v in axes that have turned by omega dt since: v + v x omega dt, with 50 ms at most. */
static void test_the_newest_field_is_turned_to_the_time_of_the_gyro(void **state)
{
	static const double FIELDS_MS[] = {990, 930};
	static const double AGES_S[] = {0.01, 0.05};

	(void)state;
	for (int i = 0; i < 2; i++) {
		struct board *b = empty_board();
		struct imu_sample sample;

		put_reading(b->accel, 995, 1, 0, false);
		put_reading(b->accel, 1005, 1, 0, false);
		put_reading(b->gyro, 1000, 0, 2, false);
		put_reading(b->mag, 900, 99, 99, false);
		put_reading(b->mag, FIELDS_MS[i], 30, 40, false);
		put_reading(b->mag, 1000.001, 7, 8, false); /* of the next sample */
		assert_true(board_next(b, &sample));
		/* (30, 40, 0) x (0, 2, 0) = (0, 0, 60) */
		assert_true(fabs(sample.mag_uT.x - 30) < 1e-9 && fabs(sample.mag_uT.y - 40) < 1e-9);
		assert_true(fabs(sample.mag_uT.z - 60 * AGES_S[i]) < 1e-9);
		assert_int_equal(b->mag->count, 1);
		world_free(w);
	}
}

static void test_a_temperature_is_delivered_once(void **state)
{
	struct board *b = empty_board();
	struct imu_sample sample;

	(void)state;
	put_reading(b->accel, 995, 1, 0, false);
	put_reading(b->accel, 1015, 1, 0, false);
	put_reading(b->gyro, 1000, 0, 2, false);
	put_reading(b->gyro, 1010, 0, 2, false);
	b->temperature_new = true;
	b->temperature_degC = 31.5;
	assert_true(board_next(b, &sample));
	assert_int_equal(sample.flags, SAMPLE_TEMPERATURE);
	assert_true(sample.temperature_degC == 31.5);
	assert_true(board_next(b, &sample));
	assert_int_equal(sample.flags, 0);
	world_free(w);
}

/* The time of the interrupt is up to 0.1 ms after the edge. */
static void test_an_edge_makes_the_gyro_due_and_bounds_its_sample(void **state)
{
	struct board *b = empty_board();

	(void)state;
	know_the_time_of_sample_10(b->gyro);
	b->gyro->due_ns = 0;
	board_data_ready(b, 1010050000);
	assert_int_equal(b->gyro->due_ns, 1010050000);
	assert_int_equal(b->gyro->clock.newest, 11);
	assert_true(b->gyro->clock.hi_ns <= 1010050000 && b->gyro->clock.lo_ns >= 1010050000 - 100000);
	b->gyro->state = STREAM_DOWN;
	board_data_ready(b, 1020050000);
	assert_int_equal(b->gyro->due_ns, 1010050000);
	world_free(w);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_chip_at_the_end_of_its_range_for_60_ms_has_a_fault),
		cmocka_unit_test(test_equal_samples_are_a_fault_where_noise_cannot_explain_them),
		cmocka_unit_test(test_a_chip_without_a_sample_for_50_ms_has_stopped),
		cmocka_unit_test(test_a_chip_that_does_not_answer_for_20_ms_is_silent),
		cmocka_unit_test(test_the_registers_are_read_back_in_turn),
		cmocka_unit_test(test_a_register_with_another_value_twice_is_a_fault),
		cmocka_unit_test(test_the_number_of_equal_samples_follows_from_the_noise_of_the_chip),
		cmocka_unit_test(test_a_chip_with_a_fault_is_initialised_again_after_a_back_off),
		cmocka_unit_test(test_a_sample_is_later_than_the_one_before),
		cmocka_unit_test(test_the_acceleration_is_that_of_the_time_of_the_gyro),
		cmocka_unit_test(test_a_sample_is_saturated_if_one_of_its_readings_is),
		cmocka_unit_test(test_the_newest_field_is_turned_to_the_time_of_the_gyro),
		cmocka_unit_test(test_a_temperature_is_delivered_once),
		cmocka_unit_test(test_an_edge_makes_the_gyro_due_and_bounds_its_sample),
		cmocka_unit_test(test_lost_samples_are_counted_by_the_time),
		cmocka_unit_test(test_a_sample_of_a_stub_may_be_two_milliseconds_older_than_the_read),
		cmocka_unit_test(test_words_at_the_ends_of_the_range_are_saturated_and_counted),
		cmocka_unit_test(test_equal_words_are_counted_from_one),
		cmocka_unit_test(test_of_readings_that_nobody_takes_the_newest_64_remain),
		cmocka_unit_test(test_a_chip_is_up_when_its_clock_is_locked_or_after_16_samples),
	};

	return cmocka_run_group_tests_name("i2c_watch", tests, count_descriptors, no_descriptor_is_left);
}
