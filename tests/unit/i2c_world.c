#include "tests/unit/i2c_world.h"

#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const uint8_t firmware[8192]; /* a simulated chip takes any */

enum { BYTE_NS = 22500 /* 9 bits at 400 kHz */ };

static int64_t now_ns(void *ctx)
{
	struct world *w = ctx;

	return w->now_ns;
}

static void sleep_until(void *ctx, int64_t ns)
{
	struct world *w = ctx;

	if (ns > w->now_ns)
		w->now_ns = ns;
}

static int before(void *ctx, const struct sim_access *access)
{
	struct world *w = ctx;

	w->now_ns += (int64_t)(access->n + (access->write ? 2 : 3)) * BYTE_NS;
	w->accesses++;
	return w->before ? w->before(w, access) : 0;
}

static void after(void *ctx, const struct sim_access *access)
{
	struct world *w = ctx;

	if (w->after)
		w->after(w, access);
}

struct world *world_make(const char *board, const char *scenario, bool ideal)
{
	struct world *w = calloc(1, sizeof *w);
	const size_t length = strcspn(board, "/");

	assert(w && length < sizeof w->name);
	memcpy(w->name, board, length);
	w->now_ns = w->start_ns = 5000000000;
	w->firmware = firmware;
	rng_init(&w->rng, 1);
	w->config = (struct sim_config){.board = w->name,
		.spi = strcmp(board + length, "/spi") == 0,
		.signal = signal_find(scenario),
		.sensor = *sensor_preset(ideal ? "ideal" : "lsm303dlhc_l3gd20"),
		.seed = 7,
		.rate_error = {0, 0.013, -0.02, 0.011},
		.clock = w,
		.now_ns = now_ns,
		.hook = w,
		.before = before,
		.after = after};
	sensor_calibrate(&w->config.sensor);
	if (sim_board_open(&w->config, &w->sim) < 0)
		abort();
	w->bus = sim_board_bus(w->sim);
	return w;
}

void world_detect(struct world *w)
{
	const struct board_clock clock = {w, now_ns, sleep_until};
	char why[200];

	if (board_detect(&w->board, w->bus, &clock, why, sizeof why) < 0) {
		fprintf(stderr, "%s\n", why);
		abort();
	}
	w->board.firmware = w->firmware;
}

void world_set_up(struct world *w, const struct imu_settings *settings, bool fifo)
{
	struct board_plan plan;
	char why[200];

	if (board_plan(&w->board, settings, !fifo, false, &plan, why, sizeof why) < 0) {
		fprintf(stderr, "%s\n", why);
		abort();
	}
	board_apply(&w->board, &plan);
}

struct world *world_new(const char *board, const char *scenario, bool ideal)
{
	const struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	struct world *w = world_make(board, scenario, ideal);

	world_detect(w);
	world_set_up(w, &settings, true);
	return w;
}

void world_load_bmi270(struct world *w)
{
	const uint8_t address = sim_board_address(w->sim, IMU_CHIP_GYRO);

	i2c_write(w->bus, address, 0x7C, 0x00); /* no power saving */
	i2c_write(w->bus, address, 0x59, 0x00);
	for (unsigned byte = 0; byte < sizeof firmware; byte += 32) {
		i2c_write(w->bus, address, 0x5B, byte / 2 & 15);
		i2c_write(w->bus, address, 0x5C, (uint8_t)(byte / 2 >> 4));
		i2c_write_block(w->bus, address, 0x5E, firmware + byte, 32);
	}
	i2c_write(w->bus, address, 0x59, 0x01);
	w->now_ns += 20000000;
}

void world_free(struct world *w)
{
	i2c_close(w->bus);
	free(w);
}

/* One step of the driver, and the sleep after it. */
static void step(struct world *w)
{
	int64_t wake_ns = board_step(&w->board);

	w->wakes++;
	if (wake_ns > w->now_ns)
		w->now_ns = wake_ns;
	if (w->late_ns > 0)
		w->now_ns += (int64_t)(rng_u64(&w->rng) % (uint64_t)w->late_ns);
}

bool world_sample(struct world *w, struct imu_sample *sample, int64_t us)
{
	for (int64_t end_ns = w->now_ns + us * 1000; w->now_ns < end_ns; step(w))
		if (board_next(&w->board, sample))
			return true;
	return board_next(&w->board, sample);
}

void world_run(struct world *w, int64_t us)
{
	struct imu_sample sample;
	int64_t end_ns = w->now_ns + us * 1000;

	while (w->now_ns < end_ns)
		world_sample(w, &sample, (end_ns - w->now_ns) / 1000 + 1);
}

int64_t world_until_fault(struct world *w, enum imu_fault fault, enum imu_chip chip, int64_t us)
{
	const struct imu_health *h = &w->board.health;
	struct imu_sample sample;

	for (int64_t start_ns = w->now_ns; w->now_ns < start_ns + us * 1000; step(w)) {
		while (board_next(&w->board, &sample))
			;
		if ((h->fault == fault && h->fault_chip == chip) || (h->degraded == fault && h->degraded_chip == chip))
			return (w->now_ns - start_ns) / 1000;
	}
	return -1;
}

int64_t world_until_recovered(struct world *w, int64_t us)
{
	struct imu_sample sample;

	for (int64_t start_ns = w->now_ns; w->now_ns < start_ns + us * 1000; step(w)) {
		while (board_next(&w->board, &sample))
			;
		if (!w->board.health.fault && !w->board.health.degraded)
			return (w->now_ns - start_ns) / 1000;
	}
	return -1;
}

struct signal_truth world_truth(const struct world *w, const struct imu_sample *sample)
{
	struct signal_truth truth;

	signal_at(w->config.signal, 1e-6 * ((double)sample->t_us + 0.5) - 1e-9 * (double)w->start_ns, &truth);
	return truth;
}
