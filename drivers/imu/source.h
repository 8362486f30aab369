/* drivers/imu/source.h
 * What imu_open() chooses from. `args` is what follows the colon of SRC, NULL without one; results
 * as imu_open()'s. */
#ifndef DRIVERS_IMU_SOURCE_H
#define DRIVERS_IMU_SOURCE_H

#include "drivers/ports/imu.h"

#define SIM_SYNTAX    "sim[:SCENARIO][,board=B][,rate=HZ][,uncalibrated]"
#define REPLAY_SYNTAX "replay:FILE.imu.csv[,loop][,speed=X]"
#define I2C_SYNTAX    "i2c:/dev/i2c-N[,drdy=GPIOCHIP:LINE]"
#define IIO_SYNTAX    "iio[:DEVICE[,DEVICE]...]"
#define WT901_SYNTAX  "wt901:/dev/ttyX[,baud=9600][,address=0x50]"

int replay_open(
	char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size);
int i2c_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size);
int iio_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size);
int wt901_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size);
int sim_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size);

/** imu_port.silence_us for samples that arrive at rate_hz: 100 ms, or ten intervals when that is longer. */
uint64_t source_silence_us(double rate_hz);
/** Of a sensor that is as fast as its samples' own time: the rate and the silence that goes with it. */
void source_use_rate(struct imu_port *port, double rate_hz);

/** A number above 0 and nothing after it. 0 or -EINVAL. */
int source_positive(const char *text, double *value);

#endif
