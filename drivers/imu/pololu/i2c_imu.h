/* drivers/imu/pololu/i2c_imu.h
 * A board on an I2C or SPI bus as an IMU port. The transfers are made in its own thread (imu_thread.h). */
#ifndef DRIVERS_IMU_POLOLU_I2C_IMU_H
#define DRIVERS_IMU_POLOLU_I2C_IMU_H

#include <stdbool.h>

#include "drivers/i2c/i2c.h"
#include "drivers/ports/imu.h"

struct i2c_imu_config {
	const char *name;      /* of the port; the name of the board is appended */
	double rate_hz;	       /* overrides the settings; 0: as in the settings */
	bool simulated;	       /* a bus that cannot hang: the port tolerates seconds without a sample */
	bool stub;	       /* the bus is an i2c-stub */
	const char *drdy_chip; /* "gpiochip0"; NULL: timed reads */
	unsigned drdy_line;
	const char *firmware; /* file of the chip that needs one (BMI270); NULL: where Linux has it */
};

/** Detects the board and starts reading it. Owns the bus, also on failure. The times of the samples are
 * CLOCK_MONOTONIC. 0, or -errno and one line in `error`. */
int i2c_imu_start(struct i2c_bus *bus, const struct i2c_imu_config *config, const struct imu_settings *settings,
	struct imu_port **port, char *error, size_t error_size);

/** CLOCK_MONOTONIC [ns], with the signature of the clocks of board.h and sim_chips.h. */
int64_t i2c_imu_now_ns(void *unused);

#endif
