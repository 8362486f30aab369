/* drivers/ports/imu.h
 * What the gateway needs of an inertial sensor, whatever it is: a log being replayed, chips on I2C (real or simulated),
 * IIO, a serial sensor. One sensor = one struct imu_port, the first member of whatever implements it.
 *
 * A port shows one file descriptor that becomes readable when read() has a sample. No call blocks: a driver that must
 * block keeps its own thread behind that descriptor. */
#ifndef DRIVERS_PORTS_IMU_H
#define DRIVERS_PORTS_IMU_H

#include <stddef.h>
#include <stdint.h>

#include "model/sample.h"

/** What is asked of a sensor that has the choice; each takes the smallest of its own values that is at least that. */
struct imu_settings {
	double rate_hz;
	double gyro_range_deg_s, accel_range_g, mag_range_uT;
	double bandwidth_hz; /* 0: half the rate, or next to it */
	int realtime;	     /* SCHED_FIFO priority of the driver's own thread; 0: none */
	int self_test;	     /* at the start, too; the sensor must be at rest then */
};

#define IMU_SETTINGS_DEFAULTS \
	((struct imu_settings){.rate_hz = 100, .gyro_range_deg_s = 2000, .accel_range_g = 8, .mag_range_uT = 130})

/* In the manufacturer's bytes of EMCY 5030h and 5031h, and in object 2124h. */
enum imu_fault {
	IMU_FAULT_NONE = 0,
	IMU_FAULT_SILENT = 1,	     /* a chip does not answer */
	IMU_FAULT_STOPPED = 2,	     /* it answers, but measures nothing new */
	IMU_FAULT_FROZEN = 3,	     /* the same raw values again and again, more often than its noise allows */
	IMU_FAULT_SATURATED = 4,     /* at the end of its range all the time */
	IMU_FAULT_CONFIGURATION = 5, /* its registers are not what was written: a brown-out */
	IMU_FAULT_WRONG_CHIP = 6,    /* another WHO_AM_I than at the start */
	IMU_FAULT_SELF_TEST = 7,     /* failed its last self-test; samples go on */
};

enum { IMU_SELF_TEST_RUNS = 0x80 }; /* in imu_health.self_test: no samples meanwhile, and no fault */

enum imu_chip { IMU_CHIP_GYRO = 1, IMU_CHIP_ACCEL = 2, IMU_CHIP_MAG = 3 };

struct imu_counters {
	uint32_t samples; /* delivered */
	uint32_t skipped; /* not delivered: malformed, not finite, time not increasing */
	uint32_t late;	  /* delivered after their time by more than one sampling interval */
};

/** How the chips are, of a driver that can tell. */
struct imu_health {
	uint8_t fault;	       /* enum imu_fault of the gyro or accelerometer: no samples meanwhile */
	uint8_t fault_chip;    /* enum imu_chip */
	uint8_t degraded;      /* enum imu_fault of something that samples go on without: magnetometer, self-test */
	uint8_t degraded_chip; /* enum imu_chip */
	uint8_t self_test;     /* bits of passed (0-2) and failed (4-6) gyro, accelerometer, magnetometer; 7: it runs */
	uint32_t bus_errors;   /* transfers that failed */
	uint32_t restarts;     /* initialisations of a chip after a fault */
	uint32_t overruns;     /* samples that a chip took and nobody read in time */
	float rate_hz;	       /* as measured against the clock of this machine */
};

struct imu_port;

struct imu_ops {
	/** 1 and a sample; 0: none due yet; -ENODATA: the source has ended for good; any other -errno: the sensor
	 * failed (keep polling: the driver re-initialises it). */
	int (*read)(struct imu_port *port, struct imu_sample *sample);
	void (*close)(struct imu_port *port);
	/** Takes other settings into use, port->rate_hz with them; -EINVAL: impossible, one line in `error`, the old
	 * ones stay. `dry`: only tells. NULL: this sensor has nothing to set. */
	int (*configure)(
		struct imu_port *port, const struct imu_settings *settings, int dry, char *error, size_t error_size);
	/** Begins a self-test, one or two seconds without samples; port->health tells that it runs, and the result.
	 * NULL: there is none. */
	void (*self_test)(struct imu_port *port);
};

struct imu_port {
	const struct imu_ops *ops;
	int fd;
	double rate_hz;	     /* nominal sampling rate of the samples' own time, known when open() returns */
	uint64_t silence_us; /* no sample for that long: the sensor has failed */
	char name[64];	     /* "replay:09.imu.csv" */
	char last_skip[128]; /* the last skip, for the log: "file:line: what" */
	struct imu_counters counters;
	struct imu_health health; /* as of the last read() */
};

/** Opens SRC, e.g. `i2c:/dev/i2c-1` (drivers/README.md lists the kinds). `settings` NULL: IMU_SETTINGS_DEFAULTS.
 * 0 and *port (close with imu_close()), or -errno and one line in `error` that says what is wrong and what to do. */
int imu_open(
	const char *src, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size);
int imu_read(struct imu_port *port, struct imu_sample *sample);
void imu_close(struct imu_port *port);

#endif
