/* drivers/ports/imu.h
 * The interface of an inertial sensor: a log being replayed, chips on I2C (real or simulated), IIO devices, a serial
 * sensor. One sensor is one struct imu_port, the first member of the driver's own struct.
 *
 * The port's file descriptor is readable when read() has a sample. No call blocks: a driver with blocking transfers has
 * its own thread. */
#ifndef DRIVERS_PORTS_IMU_H
#define DRIVERS_PORTS_IMU_H

#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>

#include "model/sample.h"

/** Settings of a sensor, where it can be set. Each sensor uses the smallest value it supports that is at least the one
 * requested. */
struct imu_settings {
	double rate_hz;
	double gyro_range_deg_s, accel_range_g, mag_range_uT;
	double bandwidth_hz; /* of the low-pass filter; 0: half the rate or the nearest to it */
	int realtime;	     /* SCHED_FIFO priority of the driver's own thread; 0: none */
	int self_test;	     /* run a self-test at the start; the sensor must be at rest */
};

#define IMU_SETTINGS_DEFAULTS \
	((struct imu_settings){.rate_hz = 100, .gyro_range_deg_s = 2000, .accel_range_g = 8, .mag_range_uT = 130})

/* Reported in the manufacturer-specific bytes of EMCY 5030h and 5031h, and in object 2124h. */
enum imu_fault {
	IMU_FAULT_NONE = 0,
	IMU_FAULT_SILENT = 1,	     /* a chip does not answer */
	IMU_FAULT_STOPPED = 2,	     /* it answers, but has no new samples */
	IMU_FAULT_FROZEN = 3,	     /* the same raw values more often than its noise permits */
	IMU_FAULT_SATURATED = 4,     /* all samples are at the end of the range */
	IMU_FAULT_CONFIGURATION = 5, /* a register differs from what was written, e.g. after a brown-out */
	IMU_FAULT_WRONG_CHIP = 6,    /* WHO_AM_I differs from that at the start */
	IMU_FAULT_SELF_TEST = 7,     /* the last self-test failed; samples continue */
};

enum { IMU_UNCALIBRATED_MAG = 4, IMU_UNCALIBRATED = 7 }; /* imu_port.uncalibrated: the magnetometer; all three */

enum { IMU_SELF_TEST_RUNS = 0x80 }; /* in imu_health.self_test: it runs; no samples meanwhile, and no fault */

enum imu_chip { IMU_CHIP_GYRO = 1, IMU_CHIP_ACCEL = 2, IMU_CHIP_MAG = 3 };

struct imu_counters {
	uint32_t samples; /* delivered */
	uint32_t skipped; /* not delivered: malformed, not finite, time not increasing */
	uint32_t late;	  /* read late: two sampling intervals after their time, of a replay one */
};

/** Health of the chips, where the driver can determine it. */
struct imu_health {
	uint8_t fault;	       /* enum imu_fault of the gyro or accelerometer: no samples */
	uint8_t fault_chip;    /* enum imu_chip */
	uint8_t degraded;      /* enum imu_fault while samples continue: magnetometer, self-test */
	uint8_t degraded_chip; /* enum imu_chip */
	uint8_t self_test;     /* passed (bits 0-2) and failed (4-6): gyro, accelerometer, magnetometer; 7: running */
	uint32_t bus_errors;   /* transfers that failed */
	uint32_t restarts;     /* initialisations of a chip after a fault */
	uint32_t overruns;     /* samples of a chip that were overwritten before they were read */
	float rate_hz;	       /* measured with CLOCK_MONOTONIC */
};

struct imu_port;

struct imu_ops {
	/** 1 and a sample; 0: none due yet; -ENODATA: the source has ended; any other -errno: the sensor
	 * failed (keep polling: the driver re-initialises it). */
	int (*read)(struct imu_port *port, struct imu_sample *sample);
	void (*close)(struct imu_port *port);
	/** Applies other settings and updates port->rate_hz. 0; -EINVAL: not possible, one line in `error`, the old
	 * settings stay. `dry`: only checks. NULL: this sensor cannot be set. */
	int (*configure)(
		struct imu_port *port, const struct imu_settings *settings, int dry, char *error, size_t error_size);
	/** Starts a self-test of one to two seconds without samples; port->health reports that it runs, and its result.
	 * NULL: not supported. */
	void (*self_test)(struct imu_port *port);
};

struct imu_port {
	const struct imu_ops *ops;
	int fd;
	double rate_hz;	     /* nominal sampling rate, in the time of the samples; valid after open() */
	uint64_t silence_us; /* without a sample for this time, the sensor has failed */
	/** Bits 0 to 2: gyro, accelerometer, magnetometer measure as the chip was delivered; 0: calibrated by their
	 * maker, or nothing is known (a log). */
	uint8_t uncalibrated;
	char name[64];	     /* "replay:09.imu.csv" */
	char last_skip[128]; /* reason of the last skip, for the log: "file:line: what" */
	char notes[1024];    /* what the log should say at the start, a line each, e.g. units that are unlikely */
	struct imu_counters counters;
	struct imu_health health; /* updated by read() */
	atomic_uint turns; /* of the driver's own thread: grows every 2 s at least, unless it hangs. 0: no thread */
};

/** Opens SRC, e.g. `i2c:/dev/i2c-1` (drivers/README.md lists the kinds). `settings` NULL: IMU_SETTINGS_DEFAULTS.
 * 0 and *port (close with imu_close()), or -errno and one line in `error` that says what is wrong and what to do.
 * `port` NULL: only checks how SRC is written, 0 or -EINVAL. */
int imu_open(
	const char *src, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size);
int imu_read(struct imu_port *port, struct imu_sample *sample);
void imu_close(struct imu_port *port);

#endif
