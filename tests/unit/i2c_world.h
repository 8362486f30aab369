/* tests/unit/i2c_world.h
 * A simulated board and its driver in simulated time. Each transfer takes as long as at 400 kHz; wake-ups may be late
 * by a random time. */
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
	char name[16];
	const uint8_t *firmware; /* for board.firmware */
	struct rng rng;
	int64_t late_ns; /* upper limit of the delay of a wake-up */
	unsigned long accesses, wakes;

	/* faults: hooks of the test for the accesses from number `fault_at` on */
	unsigned long fault_at, fault_count;
	int (*before)(struct world *world, const struct sim_access *access);
	void (*after)(struct world *world, const struct sim_access *access);
};

/** The board, with "/spi" behind its name on SPI, in `scenario`, detected and set up at 100 Hz; with the noise of real
 * chips unless `ideal`. */
struct world *world_new(const char *board, const char *scenario, bool ideal);
/** The same in separate steps, so that a test can change something between them. */
struct world *world_make(const char *board, const char *scenario, bool ideal);
void world_detect(struct world *world);
void world_set_up(struct world *world, const struct imu_settings *settings, bool fifo);
/** Gives the BMI270 its configuration file, as its driver does, and waits until it works. */
void world_load_bmi270(struct world *world);
void world_free(struct world *world);

/** Runs until the driver has a sample, at most `us`. */
bool world_sample(struct world *world, struct imu_sample *sample, int64_t us);
/** Runs for `us` and drops the samples. */
void world_run(struct world *world, int64_t us);
/** Runs until the driver reports this fault of the chip. Returns the time it took [us]; -1: not within `us`. */
int64_t world_until_fault(struct world *world, enum imu_fault fault, enum imu_chip chip, int64_t us);
/** The same until there is no fault. */
int64_t world_until_recovered(struct world *world, int64_t us);

/** The true motion at the time of a sample. */
struct signal_truth world_truth(const struct world *world, const struct imu_sample *sample);

#endif
