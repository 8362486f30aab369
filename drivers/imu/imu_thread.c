#include "drivers/imu/imu_thread.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

enum { NS_PER_S = 1000000000, STACK_BYTES = 256 * 1024, MORE_FDS = 4 };
#define BACKOFF_FIRST_NS 10000000

int64_t imu_thread_now_ns(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (int64_t)now.tv_sec * NS_PER_S + now.tv_nsec;
}

/* ---- the thread -------------------------------------------------------------------------------------------------- */

bool imu_thread_stopping(const struct imu_thread *t)
{
	return atomic_load(&t->stop);
}

void imu_thread_send(struct imu_thread *t, const struct imu_sample *sample)
{
	unsigned head = atomic_load_explicit(&t->head, memory_order_relaxed);
	struct imu_message *m = &t->queue[head % IMU_THREAD_QUEUE];
	const uint64_t one = 1;

	if (head - atomic_load_explicit(&t->tail, memory_order_acquire) == IMU_THREAD_QUEUE) {
		atomic_fetch_add_explicit(&t->lost, 1, memory_order_relaxed);
		return;
	}
	*m = (struct imu_message){.health = t->health, .has_sample = sample};
	if (sample)
		m->sample = *sample;
	t->sent = t->health;
	atomic_store_explicit(&t->head, head + 1, memory_order_release);
	if (write(t->port.fd, &one, sizeof one) < 0) { /* the eventfd is at its maximum, and readable */
	}
}

void imu_thread_rate(struct imu_thread *t, const struct imu_sample *sample)
{
	double interval_us = (double)(sample->t_us - t->last_us);

	if (t->last_us > 0)
		t->interval_us = t->interval_us > 0 ? 0.9 * t->interval_us + 0.1 * interval_us : interval_us;
	t->last_us = sample->t_us;
	if (t->interval_us > 0)
		t->health.rate_hz = (float)(1e6 / t->interval_us);
}

static bool state_changed(const struct imu_health *a, const struct imu_health *b)
{
	return a->fault != b->fault || a->fault_chip != b->fault_chip || a->degraded != b->degraded ||
	       a->degraded_chip != b->degraded_chip || a->self_test != b->self_test || a->restarts != b->restarts;
}

void imu_thread_report(struct imu_thread *t)
{
	if (state_changed(&t->sent, &t->health))
		imu_thread_send(t, NULL);
}

void imu_thread_wait(struct imu_thread *t, int64_t until_ns, struct pollfd *fds, size_t n)
{
	struct pollfd all[1 + MORE_FDS] = {{t->wake_fd, POLLIN, 0}};
	int64_t left_ns = until_ns - imu_thread_now_ns();
	struct timespec timeout = {0};
	uint64_t count;

	atomic_fetch_add_explicit(&t->port.turns, 1, memory_order_relaxed);
	if (left_ns > 0)
		timeout = (struct timespec){left_ns / NS_PER_S, (long)(left_ns % NS_PER_S)};
	for (size_t i = 0; i < n; i++)
		all[1 + i] = fds[i];
	if (ppoll(all, (nfds_t)(1 + n), &timeout, NULL) > 0 && all[0].revents &&
		read(t->wake_fd, &count, sizeof count) < 0) { /* reset meanwhile */
	}
	for (size_t i = 0; i < n; i++)
		fds[i].revents = all[1 + i].revents;
}

void imu_thread_sleep(struct imu_thread *t, int64_t until_ns)
{
	while (!imu_thread_stopping(t) && imu_thread_now_ns() < until_ns)
		imu_thread_wait(t, until_ns, NULL, 0);
}

void imu_thread_failed(struct imu_thread *t, enum imu_fault fault, enum imu_chip chip)
{
	t->last_us = 0;
	t->health.fault = (uint8_t)fault;
	t->health.fault_chip = (uint8_t)chip;
	imu_thread_report(t);
	t->backoff_ns = t->backoff_ns == 0 ? BACKOFF_FIRST_NS : 2 * t->backoff_ns;
	if (t->backoff_ns > NS_PER_S)
		t->backoff_ns = NS_PER_S;
	imu_thread_sleep(t, imu_thread_now_ns() + t->backoff_ns);
	t->health.restarts++;
}

void imu_thread_recovered(struct imu_thread *t)
{
	t->backoff_ns = 0;
	t->health.fault = IMU_FAULT_NONE;
	t->health.fault_chip = 0;
}

static void *run(void *ctx)
{
	struct imu_thread *t = ctx;

	prctl(PR_SET_NAME, t->name);
	prctl(PR_SET_TIMERSLACK, 1UL);
	t->run(t);
	return NULL;
}

/* ---- the port ---------------------------------------------------------------------------------------------------- */

static void note_lost(struct imu_thread *t)
{
	unsigned lost = atomic_exchange_explicit(&t->lost, 0, memory_order_relaxed);

	if (lost == 0)
		return;
	t->port.counters.skipped += lost;
	snprintf(t->port.last_skip, sizeof t->port.last_skip,
		"the gateway did not read them in time: the queue was full");
}

static int read_message(struct imu_thread *t, struct imu_sample *sample)
{
	unsigned tail = atomic_load_explicit(&t->tail, memory_order_relaxed);
	const struct imu_message *m = &t->queue[tail % IMU_THREAD_QUEUE];
	int result = 0;

	t->port.health = m->health;
	if (m->has_sample) {
		*sample = m->sample;
		t->port.counters.samples++;
		if ((double)imu_thread_now_ns() - 1e3 * (double)sample->t_us > 2e9 / t->port.rate_hz)
			t->port.counters.late++;
		result = 1;
	} else if (m->health.fault) {
		result = -EIO;
	}
	atomic_store_explicit(&t->tail, tail + 1, memory_order_release);
	return result;
}

static bool queue_empty(struct imu_thread *t)
{
	return atomic_load_explicit(&t->head, memory_order_acquire) ==
	       atomic_load_explicit(&t->tail, memory_order_relaxed);
}

int imu_thread_read(struct imu_port *port, struct imu_sample *sample)
{
	struct imu_thread *t = (struct imu_thread *)port;
	uint64_t count;
	int result = 0;

	note_lost(t);
	if (queue_empty(t) && read(port->fd, &count, sizeof count) < 0 && errno != EAGAIN)
		return -errno;
	while (result == 0 && !queue_empty(t)) /* a message may have arrived before the eventfd was read */
		result = read_message(t, sample);
	return result;
}

void imu_thread_wake(struct imu_thread *t)
{
	const uint64_t one = 1;

	if (write(t->wake_fd, &one, sizeof one) < 0) { /* at its maximum, and readable */
	}
}

int imu_thread_init(struct imu_thread *t)
{
	t->port.fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
	t->wake_fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
	return t->port.fd < 0 || t->wake_fd < 0 ? -errno : 0;
}

int imu_thread_start(struct imu_thread *t, const char *name, int realtime, void (*run_it)(struct imu_thread *t))
{
	const struct sched_param param = {.sched_priority = realtime};
	pthread_attr_t attributes;
	int result;

	t->name = name;
	t->run = run_it;
	pthread_attr_init(&attributes);
	pthread_attr_setstacksize(&attributes, STACK_BYTES);
	result = pthread_create(&t->thread, &attributes, run, t);
	pthread_attr_destroy(&attributes);
	/* if not permitted, the process reports it for its main thread */
	if (result == 0 && realtime > 0)
		pthread_setschedparam(t->thread, SCHED_FIFO, &param);
	return -result;
}

void imu_thread_stop(struct imu_thread *t)
{
	atomic_store(&t->stop, true);
	imu_thread_wake(t);
	pthread_join(t->thread, NULL);
}

void imu_thread_release(struct imu_thread *t)
{
	if (t->port.fd >= 0)
		close(t->port.fd);
	if (t->wake_fd >= 0)
		close(t->wake_fd);
}
