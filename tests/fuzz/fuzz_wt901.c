/* The WT901 driver, with libmodbus, at a sensor that sends anything: good answers, bad ones, in pieces, late, none,
 * left-over bytes, a line that fails and comes back. The serial line is simulated at the system calls, and time passes
 * in waiting only; the driver's thread runs within the target. Every sample is in the range of the sensor, has a time
 * after its request, and its measurements were in what the sensor sent. */
#include <dlfcn.h>
#include <errno.h>
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <stdbool.h>
#include <string.h>
#include <sys/select.h>
#include <termios.h>
#include <time.h>

#include "drivers/imu/imu_thread.h"
#include "model/math/units.h"
#include "tests/fuzz/fuzz.h"

enum { BUFFER = 512, HISTORY = 4096, REQUEST = 8, WORDS = 13, US = 1000, IDLE_WAITS = 5 };

static struct world {
	struct input *in;
	bool running; /* in the driver: the functions below are simulated */
	int64_t now_ns;
	struct imu_port *port;
	void *(*thread)(void *);
	void *thread_ctx;
	unsigned idle; /* waits since the end of the input */
	unsigned requests, samples;
	uint64_t last_us;

	/* the line */
	int fd; /* -1: closed */
	bool failed;
	uint8_t request[REQUEST];
	uint8_t pending[BUFFER];
	size_t pending_count;
	uint8_t history[HISTORY]; /* what the sensor has sent */
	size_t history_count;
} w;

/* ---- the sensor -------------------------------------------------------------------------------------------------- */

/* Modbus over serial line, 6.2.2 */
static uint16_t crc16(const uint8_t *bytes, size_t size)
{
	uint16_t crc = 0xFFFF;

	for (size_t i = 0; i < size; i++) {
		crc ^= bytes[i];
		for (int bit = 0; bit < 8; bit++)
			crc = (uint16_t)(crc & 1 ? crc >> 1 ^ 0xA001 : crc >> 1);
	}
	return crc;
}

static void sends(const uint8_t *bytes, size_t size)
{
	if (size > BUFFER - w.pending_count || size > HISTORY - w.history_count)
		return;
	memcpy(w.pending + w.pending_count, bytes, size);
	w.pending_count += size;
	memcpy(w.history + w.history_count, bytes, size);
	w.history_count += size;
}

/* The answer to the last request, with these words; `damage` changes one thing. */
static void answers(uint8_t damage)
{
	uint8_t bytes[256], count = w.request[5];
	size_t size = REQUEST - 2;

	memcpy(bytes, w.request, size);
	if (bytes[1] == 3) {
		bytes[2] = (uint8_t)(2 * count);
		size = 3;
		for (uint8_t i = 0; i < 2 * count && i < 2 * WORDS; i++)
			bytes[size++] = read_byte(w.in);
	}
	if (damage == 1)
		bytes[0] ^= 1;
	if (damage == 2)
		bytes[1] ^= 0x80; /* an exception, or too many bytes of one */
	if (damage == 3)
		size--;
	if (damage == 4)
		bytes[2]++;
	uint16_t crc = crc16(bytes, size);
	bytes[size++] = (uint8_t)crc;
	bytes[size++] = (uint8_t)((crc >> 8) ^ (damage == 5));
	sends(bytes, damage == 6 ? size / 2 : size);
}

/* One byte says what happens while the driver waits for bytes. */
static void sensor_acts(void)
{
	uint8_t kind = read_byte(w.in), bytes[64];

	switch (kind >> 6) {
	case 0:
		break; /* silent */
	case 1:
		answers(kind & 15);
		break;
	case 2:
		read_bytes(w.in, bytes, kind & 63);
		sends(bytes, kind & 63);
		break;
	default:
		w.failed = (kind & 0x38) == 0x38;
		answers(0);
		break;
	}
}

/* ---- the gateway's side ------------------------------------------------------------------------------------------ */

static void check_triad(struct vec3 v, double limit)
{
	require(fabs(v.x) <= limit && fabs(v.y) <= limit && fabs(v.z) <= limit);
}

static void put_word(uint8_t *out, double value, double step)
{
	int word = (int)lround(value / step);

	require(fabs(value / step - word) < 1e-6 && word >= INT16_MIN && word <= INT16_MAX);
	out[0] = (uint8_t)(word >> 8);
	out[1] = (uint8_t)word;
}

static void check_sample(const struct imu_sample *s)
{
	const double g = 16 * STANDARD_GRAVITY_M_S2 / 32768, rate = 2000 * RAD_PER_DEG / 32768;
	uint8_t bytes[12];

	check_triad(s->mag_uT, 32768 * 0.15);
	require(fabs(s->temperature_degC) <= 327.68);
	put_word(bytes, s->accel_m_s2.x, g);
	put_word(bytes + 2, s->accel_m_s2.y, g);
	put_word(bytes + 4, s->accel_m_s2.z, g);
	put_word(bytes + 6, s->gyro_rad_s.x, rate);
	put_word(bytes + 8, s->gyro_rad_s.y, rate);
	put_word(bytes + 10, s->gyro_rad_s.z, rate);
	require(memmem(w.history, w.history_count, bytes, sizeof(bytes)) != NULL);
	require(s->t_us <= (uint64_t)w.now_ns / US && s->t_us >= w.last_us);
	w.last_us = s->t_us;
	require(++w.samples <= w.requests);
}

static void read_samples(void)
{
	struct imu_sample sample;
	int result;

	do {
		result = imu_read(w.port, &sample);
		if (result > 0)
			check_sample(&sample);
	} while (result != 0);
}

/* ---- the system -------------------------------------------------------------------------------------------------- */

#define REAL(function)                       \
	static __typeof__(&(function)) real; \
	if (!real)                           \
	*(void **)&real = dlsym(RTLD_NEXT, #function)

int clock_gettime(clockid_t clock, struct timespec *t)
{
	REAL(clock_gettime);
	if (!w.running || clock != CLOCK_MONOTONIC)
		return real(clock, t);
	*t = (struct timespec){w.now_ns / 1000000000, w.now_ns % 1000000000};
	return 0;
}

/* AddressSanitizer's, which must know of the threads of libFuzzer; NULL without it. */
int __interceptor_pthread_create(pthread_t *thread, const pthread_attr_t *attr, void *(*start)(void *), void *ctx)
	__attribute__((weak));

int pthread_create(
	pthread_t *restrict thread, const pthread_attr_t *restrict attr, void *(*start)(void *), void *restrict ctx)
{
	REAL(pthread_create);
	if (!w.running && __interceptor_pthread_create)
		return __interceptor_pthread_create(thread, attr, start, ctx);
	if (!w.running)
		return real(thread, attr, start, ctx);
	w.thread = start;
	w.thread_ctx = ctx;
	return 0;
}

int pthread_join(pthread_t thread, void **result)
{
	REAL(pthread_join);
	return w.running ? 0 : real(thread, result);
}

/* The driver's thread waits. */
int ppoll(struct pollfd *fds, nfds_t n, const struct timespec *timeout, const sigset_t *mask)
{
	REAL(ppoll);
	if (!w.running)
		return real(fds, n, timeout, mask);
	w.now_ns += timeout->tv_sec * 1000000000 + timeout->tv_nsec;
	if (w.thread_ctx) {
		read_samples();
		if (w.in->size == 0 && ++w.idle > IDLE_WAITS)
			((struct imu_thread *)w.thread_ctx)->stop = true;
	}
	return 0;
}

int tcsetattr(int fd, int actions, const struct termios *settings)
{
	(void)actions, (void)settings;
	if (w.failed) { /* it is plugged in again the next time */
		w.failed = false;
		errno = EIO;
		return -1;
	}
	w.fd = fd;
	w.pending_count = 0;
	return 0;
}

int tcflush(int fd, int queue)
{
	(void)fd, (void)queue;
	w.pending_count = 0;
	return 0;
}

/* libmodbus waits for bytes. */
int select(int n, fd_set *restrict read_fds, fd_set *restrict write_fds, fd_set *restrict except_fds,
	struct timeval *restrict timeout)
{
	REAL(select);
	if (!w.running)
		return real(n, read_fds, write_fds, except_fds, timeout);
	require(timeout != NULL && FD_ISSET(w.fd, read_fds));
	if (w.pending_count == 0)
		sensor_acts();
	if (w.pending_count > 0 || w.failed)
		return 1;
	w.now_ns += timeout->tv_sec * 1000000000 + timeout->tv_usec * US;
	return 0;
}

ssize_t write(int fd, const void *bytes, size_t size)
{
	REAL(write);
	if (!w.running || fd != w.fd)
		return real(fd, bytes, size);
	require(size == REQUEST && crc16(bytes, size) == 0);
	memcpy(w.request, bytes, size);
	w.requests++;
	if (w.failed)
		errno = EIO;
	return w.failed ? -1 : (ssize_t)size;
}

ssize_t read(int fd, void *bytes, size_t size)
{
	REAL(read);
	if (!w.running || fd != w.fd)
		return real(fd, bytes, size);
	if (w.failed)
		errno = EIO;
	if (w.failed)
		return -1;
	size = size < w.pending_count ? size : w.pending_count;
	memcpy(bytes, w.pending, size);
	memmove(w.pending, w.pending + size, w.pending_count -= size);
	w.now_ns += (int64_t)size * 87 * US; /* at 115200 Bd */
	return (ssize_t)size;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct input in = {data, size};
	char error[300] = "";

	w = (struct world){.in = &in, .now_ns = 1000000000, .fd = -1};
	w.running = true;
	if (imu_open("wt901:/dev/null,baud=115200", NULL, &w.port, error, sizeof(error)) == 0) {
		w.thread(w.thread_ctx);
		read_samples();
		imu_close(w.port);
	} else {
		require(error[0] != '\0');
	}
	w.running = false;
	return 0;
}
