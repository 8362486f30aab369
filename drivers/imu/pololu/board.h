/* drivers/imu/pololu/board.h
 * The chips of chips.h on an I2C or SPI bus, as on a Pololu IMU 9 of any version: detects them, sets them up, reads
 * them, and estimates when each sample was taken. Passive: clock and sleep are injected, so that tests run in simulated
 * time. Not thread-safe; transfers block, so that it runs in its own thread (i2c_imu.c).
 *
 * Each chip samples by its own oscillator (sample_clock.h). A sample of the board has the time of a gyro sample; the
 * acceleration is interpolated to it.
 *
 * A fault of a chip is detected within 100 ms: it does not answer (20 ms), has no new samples (50 ms), is at the end of
 * its range (60 ms), or a register differs from what was written (each chip's registers are read back in turn, one in
 * 10 ms). On SPI, where a chip that is gone reads as FFh or 00h, the last is what is reported then. Equal raw values
 * are a fault when noise cannot explain them: with IMU_SETTINGS_DEFAULTS after at most 100 ms, for the magnetometers of
 * LSM303DLH, DLM and DLHC 140 ms, for the AK09916 200 ms, for the L3GD20H 320 ms; never in ranges with digits coarser
 * than the noise. Faults are derived from the data that reads return, not from how long they take: a slow machine is
 * not a fault. A faulty chip is initialised again after a back-off of 10 ms, 20 ms, ... 1 s. */
#ifndef DRIVERS_IMU_POLOLU_BOARD_H
#define DRIVERS_IMU_POLOLU_BOARD_H

#include "drivers/i2c/i2c.h"
#include "drivers/imu/pololu/chips.h"
#include "drivers/imu/sample_clock.h"

enum { BOARD_STREAMS = 3, STREAM_READINGS = 64 };

struct board_clock {
	void *ctx;
	int64_t (*now_ns)(void *ctx); /* the clock of the samples, e.g. CLOCK_MONOTONIC */
	void (*sleep_until)(void *ctx, int64_t ns);
};

struct reading {
	double t_ns;
	struct vec3 value[CHIP_TRIADS];
	bool saturated;
};

enum stream_state { STREAM_DOWN, STREAM_STARTING, STREAM_UP };

/* PRIVATE: one chip */
struct stream {
	const struct chip *chip;
	uint8_t address;
	struct chip_setup setup;
	struct chip_registers registers;
	struct sample_clock clock;
	int64_t next; /* index of the next sample to read */
	struct reading readings[STREAM_READINGS];
	size_t first, count;
	uint8_t partial[CHIP_SET]; /* CHIP_FIFO_TAGGED: a set of which one half has been read */
	unsigned partial_have;
	bool flushed; /* the FIFO, so that samples may have been lost */

	enum stream_state state;
	enum imu_fault fault;
	int64_t retry_ns, backoff_ns; /* in STREAM_DOWN */
	int64_t since_ns;	      /* start of this state */
	int64_t due_ns, verify_ns;
	size_t verify;		   /* index of the register to read back next */
	int64_t fresh_ns, none_ns; /* end of the last read with a sample, start of the last read without one */
	int64_t failing_ns;	   /* time of the first of consecutive failed transfers */
	unsigned failures;
	uint8_t last[CHIP_SET];
	unsigned same, same_limit, saturated; /* consecutive samples */
};

struct board {
	char name[32];	/* "v3", or the names of the chips */
	char note[160]; /* what the log should say at the start; "": nothing */
	struct imu_health health;
	/* chip->firmware_size bytes for the gyro's chip; set between board_detect() and board_apply(), the caller's */
	const uint8_t *firmware;

	/* PRIVATE */
	struct i2c_bus *bus;
	struct board_clock clock;
	int64_t now_ns; /* time of the last board_read_clock() */
	struct stream streams[BOARD_STREAMS];
	size_t stream_count;
	struct stream *gyro, *accel; /* the same if they are one chip */
	struct stream *mag;	     /* NULL: none */
	double last_t_ns;
	int64_t temperature_ns; /* next read */
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

/** Detects the chips; a magnetometer is no condition. 0, or -ENODEV or the error of the bus, and one line in `error`.
 */
int board_detect(
	struct board *board, struct i2c_bus *bus, const struct board_clock *clock, char *error, size_t error_size);

/** Chooses the chips' rates, ranges and bandwidths for `settings`. Uses only the result of the detection, so that it
 * may be called while another thread runs board_step(). `stub`: the bus is an i2c-stub: ready bits stay set, FIFOs stay
 * full, and register values may be 2 ms old. 0; -EINVAL: not possible, one line in `error`. */
int board_plan(const struct board *board, const struct imu_settings *settings, bool stub, bool data_ready,
	struct board_plan *plan, char *error, size_t error_size);

/** Initialises the chips with this plan in the next board_step(). */
void board_apply(struct board *board, const struct board_plan *plan);

/** Makes the reads that are due. Returns the time of the next call. */
int64_t board_step(struct board *board);

/** The gyro's data-ready line had a rising edge at this time. */
void board_data_ready(struct board *board, int64_t t_ns);

/** Returns true and the next sample; its t_us is on the injected clock. */
bool board_next(struct board *board, struct imu_sample *sample);

/** Runs the self-test, one to two seconds; the result is in board->health.self_test. The board must be at rest. */
void board_self_test(struct board *board);

#endif
