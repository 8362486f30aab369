/* drivers/imu/sim/sim_chips.h
 * The chips of board.h simulated at the level of their registers, behind an I2C bus. Registers that the driver writes
 * have their effect (rates, ranges, axes, FIFO, self-test); it reads what the chips would measure of a motion. Written
 * from the data sheets independently of chips.h, without common tables, so that the tests detect a mistake in either.
 *
 * The clock is injected. Tests can inject faults. */
#ifndef DRIVERS_IMU_SIM_SIM_CHIPS_H
#define DRIVERS_IMU_SIM_SIM_CHIPS_H

#include <stdbool.h>

#include "drivers/i2c/i2c.h"
#include "drivers/ports/imu.h"
#include "model/sim/sensor.h"

struct sim_access {
	unsigned long number; /* counts the accesses from 0 */
	uint8_t address, sub;
	bool write;
	uint8_t *bytes;
	size_t n;
};

struct sim_config {
	const char
		*board; /* as in the table of sim_chips.c: "v0".. "v6", "lsm9ds1", "icm20948", "icm42688", "bmi270" */
	bool spi;	/* instead of I2C; the chips have the addresses 0, 1... */
	const struct signal *signal;
	/* errors of the triads; steps, ranges and rates are those set in the registers */
	struct sensor_config sensor;
	uint64_t seed;
	/* relative error of the oscillators: 0.01 is 1 % faster than nominal */
	double rate_error[4]; /* by enum imu_chip; [0] is not used */
	void *clock;
	int64_t (*now_ns)(void *clock);

	/* for tests; may be NULL. before(): 0 continues, -errno is the result of the access, 1: the write has no
	 * effect. after() may change the bytes read. */
	void *hook;
	int (*before)(void *hook, const struct sim_access *access);
	void (*after)(void *hook, const struct sim_access *access);
};

struct sim_board;

/** 0; -ENOMEM; -EINVAL: unknown board, or rejected by sensor_init(). */
int sim_board_open(const struct sim_config *config, struct sim_board **board);

/** The bus for the driver; closing it frees the board. */
struct i2c_bus *sim_board_bus(struct sim_board *board);

/* ---- faults ---- */
void sim_board_silence(struct sim_board *board, enum imu_chip chip, bool on);  /* does not answer */
void sim_board_freeze(struct sim_board *board, enum imu_chip chip, bool on);   /* new samples with equal values */
void sim_board_stop(struct sim_board *board, enum imu_chip chip, bool on);     /* no new samples */
void sim_board_saturate(struct sim_board *board, enum imu_chip chip, bool on); /* at the end of the range */
void sim_board_brown_out(struct sim_board *board, enum imu_chip chip);	       /* power-on values of the registers */
void sim_board_break_self_test(struct sim_board *board, enum imu_chip chip);   /* it has no effect on the output */
/** Its self-test changes the output by this [rad/s, m/s^2]. */
void sim_board_deflect(struct sim_board *board, enum imu_chip chip, struct vec3 deflection);

/* ---- for tests ---- */
/** Whether the board has such a sensor. The functions of faults and those below need it. */
bool sim_board_has(const struct sim_board *board, enum imu_chip chip);
/** Address of the chip with this sensor. */
uint8_t sim_board_address(const struct sim_board *board, enum imu_chip chip);
/** Start of the scenario. */
int64_t sim_board_start_ns(const struct sim_board *board);
/** The chip's 256 registers, up to date. */
const uint8_t *sim_board_registers(struct sim_board *board, enum imu_chip chip);
/** The 128 registers of a bank (ICM-20948). */
const uint8_t *sim_board_bank(struct sim_board *board, enum imu_chip chip, unsigned bank);
/** Number of samples since the last change of the rate, and the time of the newest [ns]. */
uint64_t sim_board_taken(struct sim_board *board, enum imu_chip chip, double *t_ns);

#endif
