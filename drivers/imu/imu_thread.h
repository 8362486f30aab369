/* drivers/imu/imu_thread.h
 * For sensors with blocking transfers: a thread of the driver makes them, and passes samples and the sensor's health to
 * the port through a bounded lock-free queue and an eventfd. One thread writes, one reads. */
#ifndef DRIVERS_IMU_IMU_THREAD_H
#define DRIVERS_IMU_IMU_THREAD_H

#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>

#include "drivers/ports/imu.h"

enum { IMU_THREAD_QUEUE = 256 };

struct imu_thread {
	struct imu_port port;	  /* first member; struct imu_thread is the first member of the driver's struct */
	struct imu_health health; /* written by the thread; port.health is that of the last message read */

	/* PRIVATE */
	pthread_t thread;
	void (*run)(struct imu_thread *t);
	const char *name;
	int wake_fd;
	int64_t backoff_ns;
	double interval_us; /* between samples, smoothed; 0: not known */
	uint64_t last_us;
	struct imu_health sent; /* health of the last message sent */
	struct imu_message {
		struct imu_health health;
		struct imu_sample sample;
		bool has_sample;
	} queue[IMU_THREAD_QUEUE];
	atomic_uint head, tail; /* head is written by the thread, tail by the port */
	atomic_uint lost;	/* messages dropped because the queue was full */
	atomic_bool stop;
};

/** CLOCK_MONOTONIC [ns], the clock of the samples. */
int64_t imu_thread_now_ns(void);

/** Opens the descriptors; the rest of `t` must be zero. 0 or -errno; imu_thread_release() closes them. */
int imu_thread_init(struct imu_thread *t);
/** Starts the thread. `name` (static) is shown by ps; `realtime` as in struct imu_settings, ignored where not
 * permitted. 0 or -errno. */
int imu_thread_start(struct imu_thread *t, const char *name, int realtime, void (*run)(struct imu_thread *t));
/** Requests run() to return and waits for it. */
void imu_thread_stop(struct imu_thread *t);
void imu_thread_release(struct imu_thread *t);

/* ---- in the thread ---- */
/** Whether run() must return. */
bool imu_thread_stopping(const struct imu_thread *t);
/** Sends the health, and a sample unless it is NULL. Dropped and counted when the queue is full. */
void imu_thread_send(struct imu_thread *t, const struct imu_sample *sample);
/** Updates the measured rate of the health; call it with each sample before it is sent. */
void imu_thread_rate(struct imu_thread *t, const struct imu_sample *sample);
/** Sends the health without a sample if its state has changed since the last message. */
void imu_thread_report(struct imu_thread *t);
/** Waits until that time, for imu_thread_wake(), or for one of `n` descriptors (at most 4); sets their revents. */
void imu_thread_wait(struct imu_thread *t, int64_t until_ns, struct pollfd *fds, size_t n);
/** Waits until that time, or until run() must return. */
void imu_thread_sleep(struct imu_thread *t, int64_t until_ns);
/** The sensor failed: reports the fault, waits for the back-off time (10 ms, 20 ms, ... 1 s) and counts a restart. */
void imu_thread_failed(struct imu_thread *t, enum imu_fault fault, enum imu_chip chip);
/** The sensor delivers samples: clears the fault and the back-off. */
void imu_thread_recovered(struct imu_thread *t);

/* ---- for the port ---- */
/** imu_ops.read */
int imu_thread_read(struct imu_port *port, struct imu_sample *sample);
void imu_thread_wake(struct imu_thread *t);

#endif
