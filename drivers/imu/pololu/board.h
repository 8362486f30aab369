/* drivers/imu/pololu/board.h
 * A Pololu IMU 9, whichever it is, on an I2C bus: finds its chips, sets them up, reads them, and says when each sample
 * was taken. Passive: time and sleep are given, so that tests run it in a time of their own. Not thread-safe; where
 * transfers may block, it belongs into a thread (i2c_imu.c).
 *
 * Each chip samples by its own oscillator (sample_clock.h). A sample of the board is one of the gyro, the accelerometer
 * interpolated to its instant. What goes wrong with a chip is found within 100 ms: it does not answer (20 ms), measures
 * nothing (50 ms), stands at the end of its range (60 ms), or its registers are not what was written (each read back in
 * turn, one in about 10 ms of each chip). Equal raw values are a fault (50 ms) once noise cannot be their reason any
 * more: with the settings of IMU_SETTINGS_DEFAULTS after at most 100 ms, but 140 ms of the magnetometer of LSM303DLH,
 * DLM and DLHC, 320 ms of the L3GD20H; of ranges whose digits are coarser than the noise, never. All this by what reads
 * show, not by how long they take, so that a slow machine is no fault. A chip at fault is started anew, after 10 ms,
 * 20 ms, ... 1 s. */
#ifndef DRIVERS_IMU_POLOLU_BOARD_H
#define DRIVERS_IMU_POLOLU_BOARD_H

#include "drivers/i2c/i2c.h"
#include "drivers/imu/pololu/chips.h"
#include "drivers/imu/sample_clock.h"

enum { BOARD_STREAMS = 3, STREAM_READINGS = 64 };

struct board_clock {
	void *ctx;
	int64_t (*now_ns)(void *ctx); /* CLOCK_MONOTONIC, or whatever the samples' time shall be */
	void (*sleep_until)(void *ctx, int64_t ns);
};

struct reading {
	double t_ns;
	struct vec3 value[CHIP_TRIADS];
	bool saturated;
};

enum stream_state { STREAM_DOWN, STREAM_STARTING, STREAM_UP };

/* PRIVATE: one chip, being read */
struct stream {
	const struct chip *chip;
	uint8_t address;
	struct chip_setup setup;
	struct chip_registers registers;
	struct sample_clock clock;
	int64_t taken; /* index of the next sample to be read */
	struct reading readings[STREAM_READINGS];
	size_t first, count;
	uint8_t partial[CHIP_TRIADS * 6]; /* CHIP_FIFO_TAGGED: a set of which half has come */
	unsigned partial_have;

	enum stream_state state;
	enum imu_fault fault;
	int64_t retry_ns, backoff_ns; /* when DOWN */
	int64_t since_ns;	      /* that it has this state */
	int64_t due_ns, verify_ns;
	size_t verify;		   /* the register to be read back next */
	int64_t fresh_ns, none_ns; /* end of the last read that found a sample, beginning of the last that did not */
	int64_t failing_ns;	   /* first of the failed transfers in a row */
	unsigned failures;
	uint8_t last[CHIP_TRIADS * 6];
	unsigned same, same_limit, saturated; /* samples in a row */
};

struct board {
	char name[32]; /* "v3", or the chips' names */
	struct imu_health health;

	/* PRIVATE */
	struct i2c_bus *bus;
	struct board_clock clock;
	int64_t now_ns; /* as last read */
	struct stream streams[BOARD_STREAMS];
	size_t stream_count;
	struct stream *gyro, *accel, *mag; /* accel == gyro where one chip is both */
	double last_t_ns;
	int64_t temperature_ns; /* when to read it */
	double temperature_degC;
	bool temperature_new;
	bool self_test_failed;
	uint8_t self_test_chip;
};

struct board_plan {
	struct imu_settings settings;
	struct chip_setup setup[BOARD_STREAMS];
	double rate_hz; /* nominal */
};

/** Looks what is there. 0, or -ENODEV (or what the bus said) and one line in `error`. */
int board_detect(
	struct board *board, struct i2c_bus *bus, const struct board_clock *clock, char *error, size_t error_size);

/** What `settings` come to on this board. Reads nothing but what detection found: callable beside board_step().
 * `stub`: the bus is an i2c-stub: ready bits stay, FIFOs do not empty, and registers may be 2 ms old. 0; -EINVAL:
 * impossible, one line in `error`. */
int board_plan(const struct board *board, const struct imu_settings *settings, bool stub, bool data_ready,
	struct board_plan *plan, char *error, size_t error_size);

/** Starts the chips anew with that plan, from the next step on. */
void board_apply(struct board *board, const struct board_plan *plan);

/** Reads what is due. Returns when to call again. */
int64_t board_step(struct board *board);

/** The gyro's data-ready line rose at that time. */
void board_data_ready(struct board *board, int64_t t_ns);

/** Takes the next sample out. Its t_us is that of the clock. */
bool board_next(struct board *board, struct imu_sample *sample);

/** Blocks for one to two seconds; board->health.self_test tells. The board must be at rest. */
void board_self_test(struct board *board);

#endif
