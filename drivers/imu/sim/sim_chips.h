/* drivers/imu/sim/sim_chips.h
 * The boards of board.h at the level of their registers, behind an I2C bus: what the driver writes has its effect
 * (rates, ranges, axes, FIFO, self-test), what it reads is what the chips would show of a motion. Written from the data
 * sheets, apart from chips.h: the two do not share a table, so that a mistake in one shows.
 *
 * Time is that of the clock given. Faults can be put in, as tests need them. */
#ifndef DRIVERS_IMU_SIM_SIM_CHIPS_H
#define DRIVERS_IMU_SIM_SIM_CHIPS_H

#include <stdbool.h>

#include "drivers/i2c/i2c.h"
#include "drivers/ports/imu.h"
#include "model/sim/sensor.h"

struct sim_access {
	unsigned long number; /* since the start, from 0 */
	uint8_t address, sub;
	bool write;
	uint8_t *bytes;
	size_t n;
};

struct sim_config {
	const char *board; /* "v0", "v1", "v2", "v3", "v5" or "v6" */
	const struct signal *signal;
	/* the triads' errors; steps and ranges are the chips' own. Rates are those of the registers, too. */
	struct sensor_config sensor;
	uint64_t seed;
	/* the oscillators are that much faster than nominal: 0.01 is 1 % */
	double rate_error[4]; /* by enum imu_chip; [0] is not used */
	void *clock;
	int64_t (*now_ns)(void *clock);

	/* for tests; may be NULL. before(): 0 goes on, -errno is the answer, 1: a write that has no effect. after() may
	 * change what was read. */
	void *hook;
	int (*before)(void *hook, const struct sim_access *access);
	void (*after)(void *hook, const struct sim_access *access);
};

struct sim_board;

/** 0, -ENOMEM, or -EINVAL: no such board, or what sensor_init() refuses. */
int sim_board_open(const struct sim_config *config, struct sim_board **board);

/** For the driver; closing it frees the board. */
struct i2c_bus *sim_board_bus(struct sim_board *board);

/* ---- faults ---- */
void sim_board_silence(struct sim_board *board, enum imu_chip chip, bool on);  /* does not answer */
void sim_board_freeze(struct sim_board *board, enum imu_chip chip, bool on);   /* new data, always the same */
void sim_board_stop(struct sim_board *board, enum imu_chip chip, bool on);     /* no new data */
void sim_board_saturate(struct sim_board *board, enum imu_chip chip, bool on); /* at the end of the range */
void sim_board_brown_out(struct sim_board *board, enum imu_chip chip);	       /* registers as after power-on */
void sim_board_break_self_test(struct sim_board *board, enum imu_chip chip);   /* it changes nothing any more */

/* ---- to look inside ---- */
/** Address of the chip that has it. */
uint8_t sim_board_address(const struct sim_board *board, enum imu_chip chip);
/** When the scenario began. */
int64_t sim_board_start_ns(const struct sim_board *board);
/** Its 256 registers as of now. */
const uint8_t *sim_board_registers(struct sim_board *board, enum imu_chip chip);
/** Samples taken since it was last configured, and when the newest was, ns. */
uint64_t sim_board_taken(struct sim_board *board, enum imu_chip chip, double *t_ns);

#endif
