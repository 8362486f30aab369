/* tests/unit/i2c_world.h
 * A simulated board and the driver on it, in a time that moves only here: each transfer takes as long as at 400 kHz,
 * and reads may be late by a random time. */
#ifndef TESTS_UNIT_I2C_WORLD_H
#define TESTS_UNIT_I2C_WORLD_H

#include <stdbool.h>

#include "drivers/imu/pololu/board.h"
#include "drivers/imu/sim/sim_chips.h"

struct world {
	int64_t now_ns, start_ns;
	struct sim_board *sim;
	struct i2c_bus *bus;
	struct board board;
	struct sim_config config;
	struct rng rng;
	int64_t late_ns; /* wake-ups come up to so much late */
	unsigned long accesses;

	/* what the test does to access number `fault_at` and those after it */
	unsigned long fault_at, fault_count;
	int (*before)(struct world *world, const struct sim_access *access);
	void (*after)(struct world *world, const struct sim_access *access);
};

/** Of that board, at 100 Hz, on `scenario`; with the noise of real chips unless `ideal`. Detected and set up. */
struct world *world_new(const char *board, const char *scenario, bool ideal);
/** The same in two steps: changes may be made between. */
struct world *world_make(const char *board, const char *scenario, bool ideal);
void world_detect(struct world *world);
void world_set_up(struct world *world, const struct imu_settings *settings, bool fifo);
void world_free(struct world *world);

/** Lets time pass until the driver has a sample, for at most `us`. */
bool world_sample(struct world *world, struct imu_sample *sample, int64_t us);
/** Lets time pass; the samples go nowhere. */
void world_run(struct world *world, int64_t us);
/** Lets time pass until the driver finds that fault with that chip; how long that took, us; -1: not within `us`. */
int64_t world_until_fault(struct world *world, enum imu_fault fault, enum imu_chip chip, int64_t us);
/** Until there is none. */
int64_t world_until_well(struct world *world, int64_t us);

/** The truth at a sample's time. */
struct signal_truth world_truth(const struct world *world, const struct imu_sample *sample);

#endif
