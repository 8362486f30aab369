/* drivers/imu/imu_thread.h
 * For sensors whose transfers block: a thread of the driver's own does them; samples, and how the sensor is, come to the
 * port through a bounded queue without locks behind an eventfd. */
#ifndef DRIVERS_IMU_IMU_THREAD_H
#define DRIVERS_IMU_IMU_THREAD_H

#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>

#include "drivers/ports/imu.h"

enum { IMU_THREAD_QUEUE = 256 };

struct imu_thread {
	struct imu_port port;	  /* first, as this is first in the driver's struct */
	struct imu_health health; /* the thread's own; port.health follows with what is sent */

	/* PRIVATE */
	pthread_t thread;
	void (*run)(struct imu_thread *t);
	const char *name;
	int wake_fd;
	int64_t backoff_ns;
	double interval_us; /* between samples, smoothed; 0: not known */
	uint64_t last_us;
	struct imu_health told; /* what the last message said */
	struct imu_message {
		struct imu_health health;
		struct imu_sample sample;
		bool has_sample;
	} queue[IMU_THREAD_QUEUE];
	atomic_uint head, tail; /* written by the thread; taken by the port */
	atomic_uint lost;	/* found no room */
	atomic_bool stop;
};

/** CLOCK_MONOTONIC, ns: the time of the samples. */
int64_t imu_thread_now_ns(void);

/** Makes the descriptors; the rest of `t` is the caller's, zeroed. 0 or -errno. Undone by imu_thread_release(). */
int imu_thread_init(struct imu_thread *t);
/** `name` (static) is what ps shows; `realtime` as in struct imu_settings, without it when refused. 0 or -errno. */
int imu_thread_start(struct imu_thread *t, const char *name, int realtime, void (*run)(struct imu_thread *t));
/** Waits until run() has returned. */
void imu_thread_stop(struct imu_thread *t);
void imu_thread_release(struct imu_thread *t);

/* ---- in the thread ---- */
/** run() must return. */
bool imu_thread_stopping(const struct imu_thread *t);
/** Sends a sample, or NULL, and the health with it. Dropped and counted when nobody takes them. */
void imu_thread_send(struct imu_thread *t, const struct imu_sample *sample);
/** Measures the rate that the health tells; each sample before it is sent. */
void imu_thread_rate(struct imu_thread *t, const struct imu_sample *sample);
/** Sends the health without a sample if its state has changed. */
void imu_thread_tell(struct imu_thread *t);
/** Waits for that time, imu_thread_wake(), or one of `n` descriptors (at most 4); their revents are set. */
void imu_thread_wait(struct imu_thread *t, int64_t until_ns, struct pollfd *fds, size_t n);
/** Waits for that time, or until run() must return. */
void imu_thread_sleep(struct imu_thread *t, int64_t until_ns);
/** The sensor failed: tells it, counts a restart, and waits 10 ms, 20 ms, ... 1 s. */
void imu_thread_failed(struct imu_thread *t, enum imu_fault fault, enum imu_chip chip);
/** The sensor gives samples (again). */
void imu_thread_works(struct imu_thread *t);

/* ---- for the port ---- */
/** imu_ops.read */
int imu_thread_read(struct imu_port *port, struct imu_sample *sample);
void imu_thread_wake(struct imu_thread *t);

#endif
