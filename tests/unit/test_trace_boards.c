/* The I2C and SPI driver on each simulated board, with several settings and faults, compared with what it did when the
 * trace was written (trace.h): registers written, reads, samples and their times, health. That the registers are those
 * of the data sheets is for test_i2c_board.c and test_i2c_chips.c to say. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "tests/unit/i2c_world.h"
#include "tests/unit/trace.h"

static const char *const BOARDS[] = {"v0", "v1", "v2", "v3", "v5", "v6", "lsm9ds1", "icm20948", "icm42688", "bmi270",
	"v3/spi", "v5/spi", "v6/spi", "lsm9ds1/spi", "icm20948/spi", "icm42688/spi", "bmi270/spi", "v6-6d"};

enum { ON_I2C = 10 }; /* so many of them */

static const struct variant {
	const char *name;
	struct imu_settings settings;
	bool fifo, data_ready;
} VARIANTS[] = {
	{"usual", {100, 2000, 8, 130, 0, 0, 0}, true, false},
	{"no FIFO", {100, 2000, 8, 130, 0, 0, 0}, false, false},
	{"fast", {400, 250, 2, 400, 60, 0, 0}, true, false},
	{"slow", {26, 500, 16, 800, 10, 0, 0}, true, false},
	{"1 kHz", {1000, 1000, 4, 1200, 0, 0, 0}, true, false},
	{"data ready", {200, 2000, 8, 130, 0, 0, 0}, true, true},
};

/* ---- what is done on the bus ------------------------------------------------------------------------------------- */

enum { READS_MAX = 64, LINE = 96 };

static struct log {
	char line[LINE + 32];
	struct {
		uint8_t address, sub;
		size_t n;
		unsigned count;
	} reads[READS_MAX];
	int kinds;
} bus_log;

static void flush_line(void)
{
	trace_text("write", bus_log.line);
	bus_log.line[0] = 0;
}

/* A long block as its length and a sum. */
static void log_write(const struct sim_access *a)
{
	size_t length = strlen(bus_log.line);
	unsigned sum = 0;

	if (length > LINE - 8)
		flush_line(), length = 0;
	for (size_t i = 0; i < a->n; i++)
		sum = a->n > 4 ? sum * 31 + a->bytes[i] : sum << 8 | a->bytes[i];
	snprintf(bus_log.line + length, sizeof bus_log.line - length,
		a->n > 4 ? "%s%02x:%02x=%zux%x" : "%s%02x:%02x=%.0zu%x", length ? " " : "", a->address, a->sub,
		a->n > 4 ? a->n : 0, sum);
}

static void log_read(const struct sim_access *a)
{
	int i = 0;

	while (i < bus_log.kinds && (bus_log.reads[i].address != a->address || bus_log.reads[i].sub != a->sub ||
					    bus_log.reads[i].n != a->n))
		i++;
	if (i == READS_MAX)
		return;
	if (i == bus_log.kinds) {
		bus_log.kinds++;
		bus_log.reads[i].address = a->address;
		bus_log.reads[i].sub = a->sub;
		bus_log.reads[i].n = a->n;
		bus_log.reads[i].count = 0;
	}
	bus_log.reads[i].count++;
}

static int log_access(struct world *w, const struct sim_access *a)
{
	(void)w;
	if (!a->write)
		log_read(a);
	else if (!(a->sub == 0x5E && a->n > 4)) /* the file for the BMI270 */
		log_write(a);
	return 0;
}

/* address:register x bytes * times */
static void trace_reads(void)
{
	char text[LINE + 32] = "";

	for (int i = 0; i < bus_log.kinds; i++) {
		size_t length = strlen(text);

		snprintf(text + length, sizeof text - length, "%s%02x:%02xx%zu*%u", length ? " " : "",
			bus_log.reads[i].address, bus_log.reads[i].sub, bus_log.reads[i].n, bus_log.reads[i].count);
		if (strlen(text) > LINE - 20 || i == bus_log.kinds - 1) {
			trace_text("read", text);
			text[0] = 0;
		}
	}
	bus_log.kinds = 0;
}

/* ---- what comes out of it ---------------------------------------------------------------------------------------- */

static void trace_health(const struct world *w)
{
	const struct imu_health *h = &w->board.health;

	trace_value("fault", h->fault, 0);
	trace_value("fault_chip", h->fault_chip, 0);
	trace_value("degraded", h->degraded, 0);
	trace_value("degraded_chip", h->degraded_chip, 0);
	trace_value("self_test", h->self_test, 0);
	trace_value("bus_errors", h->bus_errors, 0);
	trace_value("restarts", h->restarts, 0);
	trace_value("overruns", h->overruns, 0);
	trace_value("rate_hz", (double)h->rate_hz, 1e-4);
}

static void trace_samples(struct world *w, int64_t us)
{
	struct vec3 gyro = {0, 0, 0}, accel = gyro, mag = gyro;
	int64_t end_ns = w->now_ns + us * 1000, first_us = 0, last_us = 0;
	double degC = 0;
	int samples = 0, mags = 0, degrees = 0, saturated = 0;
	struct imu_sample s;

	while (w->now_ns < end_ns) {
		if (!world_sample(w, &s, (end_ns - w->now_ns) / 1000 + 1))
			break;
		last_us = (int64_t)s.t_us;
		first_us = samples++ ? first_us : last_us;
		gyro = vec3_add(gyro, s.gyro_rad_s);
		accel = vec3_add(accel, s.accel_m_s2);
		if (s.flags & SAMPLE_MAG)
			mag = vec3_add(mag, s.mag_uT), mags++;
		if (s.flags & SAMPLE_TEMPERATURE)
			degC += s.temperature_degC, degrees++;
		saturated += (s.flags & SAMPLE_SATURATED) != 0;
	}
	trace_value("samples", samples, 0);
	trace_value("first_us", samples ? (double)(first_us - w->start_ns / 1000) : 0, 0);
	trace_value("last_us", samples ? (double)(last_us - w->start_ns / 1000) : 0, 0);
	trace_vec("gyro_rad_s", vec3_scale(1 / fmax(1, samples), gyro), 1e-6);
	trace_vec("accel_m_s2", vec3_scale(1 / fmax(1, samples), accel), 1e-5);
	trace_vec("mag_uT", vec3_scale(1 / fmax(1, mags), mag), 1e-4);
	trace_value("mags", mags, 0);
	trace_value("temperature_degC", degC / fmax(1, degrees), 1e-4);
	trace_value("temperatures", degrees, 0);
	trace_value("saturated", saturated, 0);
	trace_health(w);
}

static void block(const struct world *w, const char *what)
{
	char header[100];

	snprintf(header, sizeof header, "%s%s, %s", w->name, w->config.spi ? "/spi" : "", what);
	trace_block(header);
}

static void set_up(struct world *w, const struct variant *v)
{
	struct board_plan plan;
	char why[100] = "";
	int result;

	world_detect(w);
	result = board_plan(&w->board, &v->settings, !v->fifo, v->data_ready, &plan, why, sizeof why);
	trace_text("name", w->board.name);
	trace_text("note", w->board.note);
	trace_value("result", result, 0);
	trace_text("why", why);
	if (result < 0)
		return;
	trace_value("planned_rate_hz", plan.rate_hz, 1e-4);
	board_apply(&w->board, &plan);
	trace_samples(w, 1500000);
}

static void test_each_setting(void **state)
{
	(void)state;
	memset(&bus_log, 0, sizeof bus_log);
	for (size_t i = 0; i < sizeof VARIANTS / sizeof *VARIANTS; i++) {
		struct world *w = world_make(*state, i % 2 ? "tumble" : "square", false);

		w->before = log_access;
		block(w, VARIANTS[i].name);
		set_up(w, &VARIANTS[i]);
		flush_line();
		trace_reads();
		w->before = NULL;
		world_free(w);
	}
	trace_check();
}

/* Without samples: what is chosen and written. The numbers of each kind are prime to one another, so that a range of
 * the gyro comes with different ones of the accelerometer. */
static void test_many_settings(void **state)
{
	static const double rates[] = {1, 13, 27, 60, 110, 210, 430, 900, 1700, 4000, 9000},
			    gyro[] = {100, 250, 500, 1000, 2000, 4000, 4001}, accel[] = {1, 2, 4, 8, 16, 17},
			    mag[] = {100, 200, 400, 800, 1600}, bandwidths[] = {0, 3, 30, 200};
	enum { SETTINGS = 33 };

	(void)state;
	for (int i = 0; i < SETTINGS; i++) {
		const struct imu_settings settings = {.rate_hz = rates[i % 11],
			.gyro_range_deg_s = gyro[i % 7],
			.accel_range_g = accel[i % 6],
			.mag_range_uT = mag[i % 5],
			.bandwidth_hz = bandwidths[i / 2 % 4]};
		struct world *w = world_make(*state, "rest", false);
		struct board_plan plan;
		char name[64], why[200] = "";

		snprintf(name, sizeof name, "settings %d", i);
		block(w, name);
		world_detect(w);
		int result = board_plan(&w->board, &settings, i % 3 == 0, false, &plan, why, sizeof why);
		trace_value("result", result, 0);
		trace_text("why", why);
		if (result == 0) {
			trace_value("planned_rate_hz", plan.rate_hz, 1e-4);
			memset(&bus_log, 0, sizeof bus_log);
			w->before = log_access;
			board_apply(&w->board, &plan);
			world_run(w, 150000);
			flush_line();
			w->before = NULL;
		}
		world_free(w);
	}
	trace_check();
}

/* ---- faults ------------------------------------------------------------------------------------------------------ */

/* Of the chip whose address the hooks have. */
static uint8_t faulty;
static bool all_faulty;

static bool concerned(const struct sim_access *a)
{
	return all_faulty || a->address == faulty;
}

static int no_answer(struct world *w, const struct sim_access *a)
{
	(void)w;
	return concerned(a) ? -EIO : 0;
}

static int third_fails(struct world *w, const struct sim_access *a)
{
	(void)w;
	return concerned(a) && a->number % 3 == 0 ? -EIO : 0;
}

static void all_ones(struct world *w, const struct sim_access *a)
{
	(void)w;
	if (concerned(a) && !a->write)
		memset(a->bytes, 0xFF, a->n);
}

static void one_bit(struct world *w, const struct sim_access *a)
{
	(void)w;
	if (concerned(a) && !a->write && a->n == 1)
		a->bytes[0] ^= 0x10;
}

static void zeros_from_data(struct world *w, const struct sim_access *a)
{
	(void)w;
	if (concerned(a) && !a->write && a->n >= 6)
		memset(a->bytes, 0, a->n);
}

static const struct fault {
	const char *name;
	int (*before)(struct world *w, const struct sim_access *access);
	void (*after)(struct world *w, const struct sim_access *access);
	int64_t us;
} FAULTS[] = {
	{"no answer", no_answer, NULL, 15000},
	{"no answer for long", no_answer, NULL, 400000},
	{"each third access fails", third_fails, NULL, 300000},
	{"ones", NULL, all_ones, 200000},
	{"a bit of registers", NULL, one_bit, 200000},
	{"zeros", NULL, zeros_from_data, 400000},
};

static void test_each_fault(void **state)
{
	(void)state;
	for (size_t i = 0; i < sizeof FAULTS / sizeof *FAULTS; i++)
		for (int chip = 0; chip <= IMU_CHIP_MAG; chip++) { /* 0: all */
			struct world *w = world_new(*state, "tumble", false);
			char name[64];

			if (chip == IMU_CHIP_ACCEL && w->board.accel == w->board.gyro) {
				world_free(w);
				continue;
			}
			all_faulty = chip == 0;
			faulty = chip ? sim_board_address(w->sim, (enum imu_chip)chip) : 0;
			snprintf(name, sizeof name, "%s, chip %d", FAULTS[i].name, chip);
			block(w, name);
			world_run(w, 600000);
			w->before = FAULTS[i].before;
			w->after = FAULTS[i].after;
			trace_samples(w, FAULTS[i].us);
			w->before = NULL;
			w->after = NULL;
			trace_value("recovered_us", (double)world_until_recovered(w, 3000000), 0);
			trace_samples(w, 500000);
			world_free(w);
		}
	trace_check();
}

static void largest_little(struct world *w, const struct sim_access *a)
{
	(void)w;
	for (size_t i = 0; i < a->n && a->n >= 6 && !a->write; i++)
		a->bytes[i] = i % 2 ? 0x7F : 0xFF;
}

static void largest_big(struct world *w, const struct sim_access *a)
{
	(void)w;
	for (size_t i = 0; i < a->n && a->n >= 6 && !a->write; i++)
		a->bytes[i] = i % 2 ? 0xFF : 0x7F;
}

static void test_the_self_test(void **state)
{
	static const char *const names[] = {"self-test", "self-test while it moves",
		"self-test at the end of the range", "self-test at the end, the other order"};

	(void)state;
	for (int kind = 0; kind < 4; kind++) {
		struct world *w = world_new(*state, kind == 1 ? "tumble" : "rest", false);

		block(w, names[kind]);
		world_run(w, 600000);
		memset(&bus_log, 0, sizeof bus_log);
		w->before = log_access;
		w->after = kind == 2 ? largest_little : kind == 3 ? largest_big : NULL;
		board_self_test(&w->board);
		trace_samples(w, 2500000);
		flush_line();
		w->before = NULL;
		w->after = NULL;
		world_free(w);
	}
	trace_check();
}

int main(void)
{
	enum { BOARD_COUNT = sizeof BOARDS / sizeof *BOARDS };
	struct CMUnitTest tests[4 * BOARD_COUNT + 1];
	size_t count = 0;

	for (int i = 0; i < BOARD_COUNT; i++)
		tests[count++] = (struct CMUnitTest){BOARDS[i], test_each_setting, NULL, NULL, (void *)BOARDS[i]};
	for (int i = 0; i < BOARD_COUNT; i++)
		tests[count++] = (struct CMUnitTest){BOARDS[i], test_many_settings, NULL, NULL, (void *)BOARDS[i]};
	for (int i = 0; i < BOARD_COUNT; i += i >= ON_I2C ? 3 : 1) /* on SPI the same but for the bus: a part of them */
		tests[count++] = (struct CMUnitTest){BOARDS[i], test_each_fault, NULL, NULL, (void *)BOARDS[i]};
	for (int i = 0; i < BOARD_COUNT; i++)
		tests[count++] = (struct CMUnitTest){BOARDS[i], test_the_self_test, NULL, NULL, (void *)BOARDS[i]};
	return trace_run("boards", tests, count);
}
