/* The source `sim` in simulated time: its thread runs here, from one wait to the next. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdbool.h>
#include <time.h>

#include "drivers/imu/imu_thread.h"
#include "drivers/ports/imu.h"

static int64_t now_ns = 1000000000, end_ns;
static void *(*body)(void *);
static struct imu_thread *thread;

int clock_gettime(clockid_t clock, struct timespec *t)
{
	(void)clock;
	*t = (struct timespec){(time_t)(now_ns / 1000000000), (long)(now_ns % 1000000000)};
	return 0;
}

int pthread_create(
	pthread_t *restrict id, const pthread_attr_t *restrict attr, void *(*start)(void *), void *restrict ctx)
{
	(void)id, (void)attr;
	body = start;
	thread = ctx;
	return 0;
}

int pthread_join(pthread_t id, void **result)
{
	(void)id, (void)result;
	return 0;
}

int ppoll(struct pollfd *fds, nfds_t n, const struct timespec *timeout, const sigset_t *mask)
{
	(void)fds, (void)n, (void)mask;
	now_ns += timeout->tv_sec * 1000000000 + timeout->tv_nsec;
	if (thread && now_ns >= end_ns)
		thread->stop = true;
	return 0;
}

/* What the thread does within 10 ms; then the gateway reads. */
static void pass_10_ms(void)
{
	end_ns = now_ns + 10000000;
	thread->stop = false;
	body(thread);
}

/* The oscillators of real chips are off by as much: gyro 0.4 % fast, magnetometer 1 %. */
static void test_samples_have_the_rate_of_oscillators_that_are_a_little_fast(void **state)
{
	static const struct {
		const char *source;
		double rate_hz, mag_hz; /* as the data sheets have them */
	} BOARDS[] = {{"sim:rest,rate=100", 100, 50}, {"sim:rest,rate=100,board=v5", 104, 80}};
	struct imu_port *port;
	struct imu_sample sample;
	char error[300];

	(void)state;
	for (int k = 0; k < 2; k++) {
		uint64_t first_us = 0, last_us = 0;
		int samples = 0, mags = 0, result;

		assert_int_equal(imu_open(BOARDS[k].source, NULL, &port, error, sizeof(error)), 0);
		for (int i = 0; i < 11000; i++) {
			pass_10_ms();
			while ((result = imu_read(port, &sample)) != 0) {
				assert_int_equal(result, 1);
				if (i < 1000) /* the clock of the samples settles */
					continue;
				first_us = first_us ? first_us : sample.t_us;
				last_us = sample.t_us;
				samples++;
				mags += (sample.flags & SAMPLE_MAG) != 0;
			}
		}
		double seconds = 1e-6 * (double)(last_us - first_us);
		if (fabs((samples - 1) / seconds / BOARDS[k].rate_hz - 1.004) > 1e-4 ||
			fabs(mags / seconds / BOARDS[k].mag_hz - 1.01) > 1e-3)
			fail_msg("%s: %.3f samples a second, %.3f with a magnetic field", BOARDS[k].source,
				(samples - 1) / seconds, mags / seconds);
		imu_close(port);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_samples_have_the_rate_of_oscillators_that_are_a_little_fast),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
