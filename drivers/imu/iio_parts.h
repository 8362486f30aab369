/* drivers/imu/iio_parts.h
 * Shared by the files of the IIO driver: iio_setup.c finds the devices and sets them up, iio_trigger.c chooses their
 * triggers and opens their buffers, iio.c reads them in a thread and implements the port. */
#ifndef DRIVERS_IMU_IIO_PARTS_H
#define DRIVERS_IMU_IIO_PARTS_H

#include <iio.h>

#include "drivers/imu/frozen.h"
#include "drivers/imu/imu_thread.h"
#include "drivers/imu/merge.h"
#include "drivers/imu/sample_clock.h"

enum { TRIADS = 3, AXES = 3, DEVICES_NAMED = 4, TEXT = 256 };
/* A trigger serves two devices (CONFIG_IIO_CONSUMERS_PER_TRIGGER, default 2): a separate magnetometer has its own
 * timer. */
enum { TIMER_MOTION, TIMER_MAG, TIMERS };

struct iio_kind {
	enum imu_chip chip;
	const char *name;
	enum iio_chan_type type;
	double to_sample; /* from the kernel's unit (m/s^2, rad/s, Gauss) to that of struct imu_sample */
};
extern const struct iio_kind IIO_KINDS[TRIADS];
enum { GYRO, ACCEL, MAG }; /* indices of IIO_KINDS, triads and choices */

/* the three axes of one sensor of a device */
struct triad {
	struct iio_device *device; /* NULL: not found */
	struct iio_channel *axis[AXES];
	double scale[AXES], offset[AXES];
	struct vec3 mount[AXES]; /* rows */
	bool mirrored;		 /* by them */
	bool polled;		 /* read through sysfs, while others have buffers */
	double lowest, highest;	 /* raw values at the ends of the range */
	double interval_ns;	 /* of the chip's samples; 0: not known */
	int64_t settled_ns;	 /* earlier readings are dropped: the chip is settling */
	int64_t seen_ns;	 /* when the last reading was processed */
	int64_t last_ns;	 /* time of the last reading */
};

/* one device with a buffer; its triads are read together */
struct capture {
	struct iio_device *device;
	struct iio_buffer *buffer;
	struct iio_channel *timestamp; /* NULL: none; the clock gives the times then */
	struct sample_clock clock;
	int64_t scans;	   /* that were read */
	const char *timer; /* name of the timer trigger; NULL: the device has its own trigger */
};

/* what the kernel's driver offers, read when first opened */
struct choice {
	char rates[TEXT], scales[TEXT];
	double digits; /* from zero to the end of the range */
	bool by_timer;
};

struct iio_imu {
	struct imu_thread thread;
	char names[TEXT];
	const char *wanted[DEVICES_NAMED];
	size_t wanted_count;
	bool ignore_mount;

	pthread_mutex_t lock;
	struct imu_settings settings;  /* written by the port, under `lock` */
	struct choice choices[TRIADS]; /* written by the thread, under `lock` */
	atomic_bool restart;

	/* used by the thread only */
	struct iio_context *context;
	struct triad triads[TRIADS];
	struct capture captures[TRIADS];
	size_t capture_count;
	bool running, polled, had_mag;
	char timers[TIMERS][48]; /* names of the timer triggers that were created; "": none */
	double rate_hz;
	double polling_hz; /* highest rate of reads through sysfs, measured when opened; 0: not polled */
	struct merge merge;
	struct frozen gyro_frozen; /* kept over restarts */
	bool is_frozen;
	int64_t next_ns; /* next poll */
	int64_t mag_retry_ns, temperature_ns;
	bool temperature_new;
	double temperature_degC;
};

/* ---- iio_setup.c ---- */
const char *iio_imu_label(const struct iio_device *device);
bool iio_imu_has_triad(struct iio_device *device, enum iio_chan_type type, struct triad *triad);
bool iio_imu_is_wanted(const struct iio_imu *imu, const struct iio_device *device);
int iio_imu_find_triads(struct iio_imu *imu, char *error, size_t error_size);
int iio_imu_choose_settings(const struct choice *choice, const struct imu_settings *settings, int kind, char *rate,
	char *scale, char *error, size_t error_size);
int iio_imu_explain(const struct iio_device *device, const char *what, ssize_t result, char *error, size_t error_size);
void iio_imu_read_choices(struct iio_imu *imu, int kind, bool by_timer);
int iio_imu_set_up(struct iio_imu *imu, int kind, const struct imu_settings *settings, char *error, size_t error_size);

/* ---- iio_trigger.c ---- */
bool iio_imu_is_of(const struct capture *c, const struct triad *t);
void iio_imu_remove_timers(struct iio_imu *imu);
int iio_imu_use_timer(struct iio_imu *imu, const struct capture *c, char *error, size_t error_size);
int iio_imu_open_buffer(struct iio_imu *imu, struct capture *c, char *error, size_t error_size);
int iio_imu_plan_capture(struct iio_imu *imu, char *error, size_t error_size);

#endif
