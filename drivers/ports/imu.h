/* drivers/ports/imu.h
 * What the gateway needs of an inertial sensor, whatever it is: a log being replayed, a simulated robot, later chips on
 * I2C, IIO, a serial sensor. One sensor = one struct imu_port, the first member of whatever implements it.
 *
 * A port shows one file descriptor that becomes readable when read() has a sample. No call blocks: a driver that must
 * block keeps its own thread behind that descriptor. */
#ifndef DRIVERS_PORTS_IMU_H
#define DRIVERS_PORTS_IMU_H

#include <stddef.h>
#include <stdint.h>

#include "model/sample.h"

struct imu_counters {
	uint32_t samples; /* delivered */
	uint32_t skipped; /* not delivered: malformed, not finite, time not increasing */
	uint32_t late;	  /* delivered after their time by more than one sampling interval */
};

struct imu_port;

struct imu_ops {
	/** 1 and a sample; 0: none due yet; -ENODATA: the source has ended for good; any other -errno: the sensor
	 * failed (keep polling: the driver re-initialises it). */
	int (*read)(struct imu_port *port, struct imu_sample *sample);
	void (*close)(struct imu_port *port);
};

struct imu_port {
	const struct imu_ops *ops;
	int fd;
	double rate_hz;	     /* nominal sampling rate of the samples' own time, known when open() returns */
	uint64_t silence_us; /* no sample for that long: the sensor has failed */
	char name[64];	     /* "replay:09.imu.csv" */
	char last_skip[128]; /* the last skip, for the log: "file:line: what" */
	struct imu_counters counters;
};

/** Opens SRC: `sim[:SCENARIO[,rate=HZ]]` or `replay:FILE.imu.csv[,loop][,speed=X]`. 0 and *port (close with
 * imu_close()), or -errno and one line in `error` that says what to do. */
int imu_open(const char *src, struct imu_port **port, char *error, size_t error_size);
int imu_read(struct imu_port *port, struct imu_sample *sample);
void imu_close(struct imu_port *port);

#endif
