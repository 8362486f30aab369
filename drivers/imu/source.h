/* drivers/imu/source.h
 * The sources of imu_open(). `args` is the text after the colon of SRC, NULL without a colon, and is modified. Results
 * as those of imu_open(). */
#ifndef DRIVERS_IMU_SOURCE_H
#define DRIVERS_IMU_SOURCE_H

#include "drivers/ports/imu.h"

#define SIM_SYNTAX    "sim[:SCENARIO][,board=B][,rate=HZ][,uncalibrated]"
#define REPLAY_SYNTAX "replay:FILE.imu.csv[,loop][,speed=X]"
#define I2C_SYNTAX    "i2c:/dev/i2c-N[,drdy=GPIOCHIP:LINE][,config=FILE]"
#define SPI_SYNTAX    "spi:/dev/spidevB.C[,/dev/spidevB.C][,mode=3][,speed=1000000][,drdy=GPIOCHIP:LINE][,config=FILE]"
#define IIO_SYNTAX    "iio[:DEVICE[,DEVICE]...][,mount=ignore]"
#define WT901_SYNTAX  "wt901:/dev/ttyX[,baud=9600][,address=0x50]"

int replay_open(
	char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size);
int i2c_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size);
int spi_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size);
int iio_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size);
int wt901_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size);
int sim_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size);

/** imu_port.silence_us for samples at rate_hz: 100 ms, or ten sampling intervals if that is longer. */
uint64_t source_silence_us(double rate_hz);
/** Sets port->rate_hz and the silence_us for it; not for a log that is replayed at another speed. */
void source_use_rate(struct imu_port *port, double rate_hz);

/** Parses a number above 0. 0 or -EINVAL. */
int source_positive(const char *text, double *value);

#endif
