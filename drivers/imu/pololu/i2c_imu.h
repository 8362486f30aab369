/* drivers/imu/pololu/i2c_imu.h
 * A board on an I2C bus as an IMU port: its own thread does the transfers, samples come through a bounded queue without
 * locks behind an eventfd. */
#ifndef DRIVERS_IMU_POLOLU_I2C_IMU_H
#define DRIVERS_IMU_POLOLU_I2C_IMU_H

#include <stdbool.h>

#include "drivers/i2c/i2c.h"
#include "drivers/ports/imu.h"

struct i2c_imu_config {
	const char *name;      /* of the port; the board's is added */
	double rate_hz;	       /* whatever the settings say; 0: as they say */
	bool simulated;	       /* no chip that could hang: silent for seconds, its thread was not run */
	bool stub;	       /* the bus is an i2c-stub, which does not know what was read */
	const char *drdy_chip; /* "gpiochip0"; NULL: timed reads */
	unsigned drdy_line;
};

/** Detects the board and begins to read it. Takes the bus over, also when it fails. Samples have the time of
 * CLOCK_MONOTONIC. 0, or -errno and one line in `error`. */
int i2c_imu_start(struct i2c_bus *bus, const struct i2c_imu_config *config, const struct imu_settings *settings,
	struct imu_port **port, char *error, size_t error_size);

/** CLOCK_MONOTONIC, ns; `unused` makes it a clock for board.h and sim_chips.h. */
int64_t i2c_imu_now_ns(void *unused);

#endif
