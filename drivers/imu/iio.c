/* iio[:DEVICE[,DEVICE]...]: sensors of the kernel's IIO drivers, through libiio. Samples are captured in buffers,
 * triggered by the devices (data ready) or by a timer trigger; where neither is possible, they are polled through
 * sysfs. */
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "drivers/imu/iio_parts.h"
#include "drivers/imu/source.h"

#define NS_PER_MS    1000000LL
#define NS_PER_S     1000000000LL
#define WAKE_NS	     (20 * NS_PER_MS)  /* the buffer of a device that was removed does not become readable */
#define STALL_NS     (100 * NS_PER_MS) /* or five sampling intervals, if longer */
#define START_NS     NS_PER_S	       /* until the first reading: chips power up */
#define MAG_RETRY_NS (2 * NS_PER_S)
/* The rate of a chip is within this share of what its driver says. */
#define CLOCK_TOLERANCE 0.1

/* ---- beginning and ending ---------------------------------------------------------------------------------------- */

/* Closes the buffers and the context, and removes the timer triggers. */
static void end(struct iio_imu *imu)
{
	for (size_t i = 0; i < imu->capture_count; i++) {
		struct capture *c = &imu->captures[i];

		if (c->buffer)
			iio_buffer_destroy(c->buffer);
		if (c->timer && iio_device_set_trigger(c->device, NULL) < 0) { /* the device was removed */
		}
	}
	imu->capture_count = 0;
	if (imu->context)
		iio_context_destroy(imu->context);
	imu->context = NULL;
	iio_imu_remove_timers(imu);
	imu->is_frozen = false;
	imu->running = false;
}

/* A reading triggered by a timer is the chip's newest sample: half its interval old, +- half an interval. */
static int64_t tolerance_ns(const struct iio_imu *imu)
{
	double longest = 0;

	for (int kind = GYRO; kind <= ACCEL; kind++)
		if (imu->choices[kind].by_timer)
			longest = fmax(longest, imu->triads[kind].interval_ns);
	return (int64_t)(longest / 2);
}

static double polled_rate(const struct iio_imu *imu, double wanted_hz)
{
	return imu->polling_hz > 0 ? fmin(wanted_hz, imu->polling_hz) : wanted_hz;
}

/* Of the scans of a device that has no time stamps. */
static void start_clock(const struct iio_imu *imu, struct capture *c)
{
	double interval_ns = 0;

	for (int kind = 0; kind < TRIADS; kind++)
		if (iio_imu_is_of(c, &imu->triads[kind]))
			interval_ns = fmax(interval_ns, imu->triads[kind].interval_ns);
	if (c->timer)
		interval_ns = 1e9 / imu->rate_hz;
	sample_clock_start(&c->clock, interval_ns, CLOCK_TOLERANCE);
}

static int begin(struct iio_imu *imu, char *error, size_t error_size)
{
	struct imu_settings settings;
	int result;

	pthread_mutex_lock(&imu->lock);
	settings = imu->settings;
	pthread_mutex_unlock(&imu->lock);
	imu->rate_hz = settings.rate_hz;
	result = iio_imu_find_triads(imu, error, error_size);
	if (result == 0)
		result = iio_imu_plan_capture(imu, error, error_size);
	if (imu->polled)
		imu->rate_hz = polled_rate(imu, settings.rate_hz);
	for (int kind = 0; kind < TRIADS && result == 0; kind++)
		if (imu->triads[kind].device)
			result = iio_imu_set_up(imu, kind, &settings, error, error_size);
	merge_init(&imu->merge, tolerance_ns(imu));
	for (size_t i = 0; i < imu->capture_count && result == 0; i++) {
		if (imu->captures[i].timer)
			result = iio_imu_use_timer(imu, &imu->captures[i], error, error_size);
		if (result == 0)
			result = iio_imu_open_buffer(imu, &imu->captures[i], error, error_size);
		if (result == 0)
			start_clock(imu, &imu->captures[i]);
	}
	if (result < 0) {
		end(imu);
		return result;
	}
	if (!imu->choices[GYRO].by_timer && imu->triads[GYRO].interval_ns > 0)
		imu->rate_hz = 1e9 / imu->triads[GYRO].interval_ns;
	imu->had_mag |= imu->triads[MAG].device != NULL;
	for (int kind = 0; kind < TRIADS; kind++) {
		struct triad *t = &imu->triads[kind];

		t->seen_ns = imu_thread_now_ns() + START_NS - STALL_NS;
	}
	imu->mag_retry_ns = imu->next_ns = imu_thread_now_ns();
	imu->running = true;
	return 0;
}

/* ---- readings ---------------------------------------------------------------------------------------------------- */

/* `host`: its first bytes are the value, in the order of this host. */
static double raw_of(const struct iio_channel *channel, uint64_t host)
{
	const struct iio_data_format *format = iio_channel_get_data_format(channel);
	const union {
		uint64_t u64;
		uint32_t u32;
		uint16_t u16;
		uint8_t u8;
	} word = {host};
	uint64_t value;

	value = format->length == 8    ? word.u8
		: format->length == 16 ? word.u16
		: format->length == 32 ? word.u32
				       : word.u64;
	if (format->is_signed && value >> (format->length - 1) & 1)
		return (double)(int64_t)(value | UINT64_MAX << (format->length - 1));
	return (double)value;
}

static void add_reading(struct iio_imu *imu, int kind, const double raw[AXES], int64_t t_ns)
{
	struct triad *t = &imu->triads[kind];
	struct merge_reading reading = {.t_ns = t_ns};
	struct vec3 v;

	t->seen_ns = imu_thread_now_ns();
	if (t_ns < t->settled_ns)
		return;
	/* accelerometer and magnetometer may be coarse: equal values at rest are normal */
	if (kind == GYRO)
		imu->is_frozen = frozen_watch(&imu->gyro_frozen, raw, AXES);
	if (kind == GYRO && imu->is_frozen)
		return;
	/* a timer that is faster than the chip reads the same sample again */
	if (kind == MAG && (double)(t_ns - t->last_ns) < 0.9 * t->interval_ns)
		return;
	t->last_ns = t_ns;
	for (int i = 0; i < AXES; i++)
		reading.saturated |= raw[i] >= t->highest || raw[i] <= t->lowest;
	v = (struct vec3){(raw[0] + t->offset[0]) * t->scale[0], (raw[1] + t->offset[1]) * t->scale[1],
		(raw[2] + t->offset[2]) * t->scale[2]};
	reading.value = (struct vec3){vec3_dot(t->mount[0], v), vec3_dot(t->mount[1], v), vec3_dot(t->mount[2], v)};
	if (imu->choices[kind].by_timer)
		reading.t_ns -= (int64_t)(t->interval_ns / 2);
	merge_add(&imu->merge, IIO_KINDS[kind].chip, &reading);
}

/* Without time stamps several scans may be read at once. */
static int64_t time_of_scan(const struct capture *c)
{
	return c->clock.newest >= 0 ? (int64_t)sample_clock_at(&c->clock, c->scans) : imu_thread_now_ns();
}

static void process_scan(struct iio_imu *imu, struct capture *c)
{
	int64_t t_ns = time_of_scan(c);

	c->scans++;
	if (c->timestamp)
		iio_channel_convert(c->timestamp, &t_ns, iio_buffer_first(c->buffer, c->timestamp));
	for (int kind = 0; kind < TRIADS; kind++) {
		struct triad *t = &imu->triads[kind];
		double raw[AXES];

		if (!iio_imu_is_of(c, t))
			continue;
		for (int i = 0; i < AXES; i++) {
			uint64_t host = 0;

			iio_channel_convert(t->axis[i], &host, iio_buffer_first(c->buffer, t->axis[i]));
			raw[i] = raw_of(t->axis[i], host);
		}
		add_reading(imu, kind, raw, t_ns);
	}
}

/* Processes all scans of the buffer. 0 or -errno. */
static int drain(struct iio_imu *imu, struct capture *c)
{
	int64_t begun_ns = imu_thread_now_ns();
	ssize_t n;

	for (; (n = iio_buffer_refill(c->buffer)) > 0; begun_ns = imu_thread_now_ns())
		process_scan(imu, c);
	if (!c->timestamp && c->clock.nominal_ns > 0 && n == -EAGAIN) /* the last refill found none */
		sample_clock_read(&c->clock, c->scans, (double)begun_ns, (double)imu_thread_now_ns());
	return n == 0 ? -ENODEV : n == -EAGAIN ? 0 : (int)n;
}

static bool read_raw(const struct triad *t, double raw[AXES])
{
	for (int i = 0; i < AXES; i++)
		if (iio_channel_attr_read_double(t->axis[i], "raw", &raw[i]) < 0)
			return false;
	return true;
}

/* Reads each sensor that is polled through sysfs; the time of a reading is the middle of the read. False: gyro or
 * accelerometer failed. */
static bool read_polled(struct iio_imu *imu)
{
	for (int kind = 0; kind < TRIADS; kind++) {
		int64_t begun_ns = imu_thread_now_ns();
		double raw[AXES];

		if (!imu->triads[kind].device || !(imu->polled || imu->triads[kind].polled))
			continue;
		if (read_raw(&imu->triads[kind], raw))
			add_reading(imu, kind, raw, (begun_ns + imu_thread_now_ns()) / 2);
		else if (kind != MAG)
			return false;
	}
	return true;
}

/* ---- the thread -------------------------------------------------------------------------------------------------- */

static void fail(struct iio_imu *imu, enum imu_fault fault, enum imu_chip chip)
{
	end(imu);
	imu->thread.health.bus_errors++;
	imu_thread_failed(&imu->thread, fault, chip);
}

static void read_temperature(struct iio_imu *imu)
{
	int64_t now_ns = imu_thread_now_ns();

	if (now_ns < imu->temperature_ns)
		return;
	imu->temperature_ns = now_ns + NS_PER_S;
	for (unsigned i = 0; i < iio_device_get_channels_count(imu->triads[GYRO].device); i++) {
		struct iio_channel *channel = iio_device_get_channel(imu->triads[GYRO].device, i);
		double raw, offset = 0, scale;

		if (iio_channel_get_type(channel) != IIO_TEMP ||
			iio_channel_attr_read_double(channel, "raw", &raw) < 0 ||
			iio_channel_attr_read_double(channel, "scale", &scale) < 0)
			continue;
		if (iio_channel_attr_read_double(channel, "offset", &offset) < 0)
			offset = 0;
		imu->temperature_degC = (raw + offset) * scale / 1000;
		imu->temperature_new = true;
	}
}

static void deliver(struct iio_imu *imu)
{
	struct imu_sample sample;

	while (merge_next(&imu->merge, &sample)) {
		if (imu->temperature_new) {
			sample.temperature_degC = imu->temperature_degC;
			sample.flags |= SAMPLE_TEMPERATURE;
			imu->temperature_new = false;
		}
		imu_thread_recovered(&imu->thread);
		imu_thread_rate(&imu->thread, &sample);
		imu_thread_send(&imu->thread, &sample);
	}
	imu->thread.health.overruns = imu->merge.lost;
}

static bool stalled(const struct iio_imu *imu, int kind)
{
	const struct triad *t = &imu->triads[kind];
	double limit_ns = fmax((double)STALL_NS, 5 * fmax(t->interval_ns, 1e9 / imu->rate_hz));

	return t->device && (double)(imu_thread_now_ns() - t->seen_ns) > limit_ns;
}

/* Samples continue without the magnetometer. One that was removed is searched for; when it is back, the capture is
 * restarted. */
static void watch_mag(struct iio_imu *imu)
{
	struct imu_health *h = &imu->thread.health;
	bool missing = imu->had_mag && !imu->triads[MAG].device, still = stalled(imu, MAG);
	struct iio_context *context;

	h->degraded = (uint8_t)(missing ? IMU_FAULT_SILENT : still ? IMU_FAULT_STOPPED : IMU_FAULT_NONE);
	h->degraded_chip = h->degraded ? IMU_CHIP_MAG : 0;
	imu_thread_report(&imu->thread);
	if (!missing || imu_thread_now_ns() < imu->mag_retry_ns)
		return;
	imu->mag_retry_ns = imu_thread_now_ns() + MAG_RETRY_NS;
	context = iio_create_local_context();
	for (unsigned i = 0; context && i < iio_context_get_devices_count(context); i++) {
		struct iio_device *device = iio_context_get_device(context, i);
		struct triad found;

		if (iio_imu_is_wanted(imu, device) && iio_imu_has_triad(device, IIO_MAGN, &found))
			atomic_store(&imu->restart, true);
	}
	if (context)
		iio_context_destroy(context);
}

/* False: it failed, and the fault was reported. */
static bool capture(struct iio_imu *imu)
{
	struct pollfd fds[TRIADS];

	for (size_t i = 0; i < imu->capture_count; i++)
		fds[i] = (struct pollfd){iio_buffer_get_poll_fd(imu->captures[i].buffer), POLLIN, 0};
	imu_thread_wait(&imu->thread, imu_thread_now_ns() + WAKE_NS, fds, imu->capture_count);
	for (size_t i = 0; i < imu->capture_count; i++) {
		struct capture *c = &imu->captures[i];

		if (drain(imu, c) < 0) {
			fail(imu, IMU_FAULT_SILENT,
				iio_imu_is_of(c, &imu->triads[GYRO])	? IMU_CHIP_GYRO
				: iio_imu_is_of(c, &imu->triads[ACCEL]) ? IMU_CHIP_ACCEL
									: IMU_CHIP_MAG);
			return false;
		}
	}
	if (imu_thread_now_ns() < imu->next_ns)
		return true;
	imu->next_ns = imu_thread_now_ns() + (int64_t)(1e9 / imu->rate_hz);
	if (read_polled(imu))
		return true;
	fail(imu, IMU_FAULT_SILENT, imu->triads[GYRO].polled ? IMU_CHIP_GYRO : IMU_CHIP_ACCEL);
	return false;
}

static bool poll_once(struct iio_imu *imu)
{
	imu_thread_sleep(&imu->thread, imu->next_ns);
	imu->next_ns = (int64_t)fmax((double)imu->next_ns + 1e9 / imu->rate_hz, (double)imu_thread_now_ns());
	if (read_polled(imu))
		return true;
	fail(imu, IMU_FAULT_SILENT, IMU_CHIP_GYRO);
	return false;
}

static void step(struct iio_imu *imu)
{
	if (!(imu->polled ? poll_once(imu) : capture(imu)))
		return;
	read_temperature(imu);
	deliver(imu);
	if (imu->is_frozen) {
		fail(imu, IMU_FAULT_FROZEN, IMU_CHIP_GYRO);
		return;
	}
	for (int kind = GYRO; kind <= ACCEL; kind++)
		if (stalled(imu, kind)) {
			fail(imu, IMU_FAULT_STOPPED, IIO_KINDS[kind].chip);
			return;
		}
	watch_mag(imu);
}

static void run(struct imu_thread *t)
{
	struct iio_imu *imu = (struct iio_imu *)t;

	while (!imu_thread_stopping(t)) {
		if (atomic_exchange(&imu->restart, false))
			end(imu);
		if (imu->running || begin(imu, NULL, 0) == 0) /* the health says which sensor failed */
			step(imu);
		else
			fail(imu, IMU_FAULT_SILENT, imu->triads[GYRO].device ? IMU_CHIP_ACCEL : IMU_CHIP_GYRO);
	}
	end(imu);
}

/* ---- the port ---------------------------------------------------------------------------------------------------- */

static int port_configure(
	struct imu_port *port, const struct imu_settings *settings, int dry, char *error, size_t error_size)
{
	struct iio_imu *imu = (struct iio_imu *)port;
	char rate[32], scale[32], gyro_rate[32] = "";
	struct choice choices[TRIADS];

	pthread_mutex_lock(&imu->lock);
	memcpy(choices, imu->choices, sizeof choices);
	pthread_mutex_unlock(&imu->lock);
	for (int kind = TRIADS - 1; kind >= 0; kind--) {
		const struct choice *choice = &choices[kind];
		int result = choice->digits > 0
				     ? iio_imu_choose_settings(choice, settings, kind, rate, scale, error, error_size)
				     : 0;

		if (result < 0)
			return result;
		if (kind == GYRO && !choice->by_timer)
			strcpy(gyro_rate, rate);
	}
	if (dry)
		return 0;
	pthread_mutex_lock(&imu->lock);
	imu->settings = *settings;
	pthread_mutex_unlock(&imu->lock);
	source_use_rate(port, gyro_rate[0] ? strtod(gyro_rate, NULL) : polled_rate(imu, settings->rate_hz));
	atomic_store(&imu->restart, true);
	imu_thread_wake(&imu->thread);
	return 0;
}

static void release(struct iio_imu *imu)
{
	end(imu);
	pthread_mutex_destroy(&imu->lock);
	imu_thread_release(&imu->thread);
	free(imu);
}

static void port_close(struct imu_port *port)
{
	struct iio_imu *imu = (struct iio_imu *)port;

	imu_thread_stop(&imu->thread);
	release(imu);
}

static const struct imu_ops OPS = {.read = imu_thread_read, .close = port_close, .configure = port_configure};

/* ---- iio[:DEVICE[,DEVICE]...] ------------------------------------------------------------------------------------ */

static int parse(struct iio_imu *imu, const char *args, char *error, size_t error_size)
{
	char *rest = imu->names, *name;

	if ((size_t)snprintf(imu->names, sizeof imu->names, "%s", args ? args : "") >= sizeof imu->names) {
		snprintf(error, error_size, "iio: the device names have more than %zu characters: name fewer devices",
			sizeof imu->names - 1);
		return -EINVAL;
	}
	while ((name = strsep(&rest, ","))) {
		if (*name == '\0')
			continue;
		if (strcmp(name, "mount=ignore") == 0) {
			imu->ignore_mount = true;
			continue;
		}
		if (imu->wanted_count == DEVICES_NAMED) {
			snprintf(error, error_size, "iio: more than %d devices named: use at most %d", DEVICES_NAMED,
				DEVICES_NAMED);
			return -EINVAL;
		}
		imu->wanted[imu->wanted_count++] = name;
	}
	return 0;
}

/* A read through sysfs may take longer than the sampling interval: some drivers power the chip up for each one. */
static int measure_polling(struct iio_imu *imu, char *error, size_t error_size)
{
	int64_t begun_ns = imu_thread_now_ns();

	if (!read_polled(imu)) {
		snprintf(error, error_size, "iio: %s cannot be read through sysfs: see the kernel log (dmesg)",
			iio_imu_label(imu->triads[GYRO].device));
		return -EIO;
	}
	imu->polling_hz = 0.9e9 / (double)(imu_thread_now_ns() - begun_ns);
	imu->rate_hz = polled_rate(imu, imu->rate_hz);
	return 0;
}

/* A matrix that mirrors is used, since some chips have left-handed axes; it may as well be a mistake. */
static void tell_mirrors(struct iio_imu *imu)
{
	struct imu_port *port = &imu->thread.port;
	size_t n = 0;

	for (int kind = 0; kind < TRIADS; kind++)
		if (imu->triads[kind].device && imu->triads[kind].mirrored && n < sizeof port->notes)
			n += (size_t)snprintf(port->notes + n, sizeof port->notes - n,
				"%siio: the mount_matrix of %s mirrors the axes of the %s: check their signs, or start "
				"with mount=ignore",
				n ? "\n" : "", iio_imu_label(imu->triads[kind].device), IIO_KINDS[kind].name);
}

static int start(struct iio_imu *imu, const struct imu_settings *settings, char *error, size_t error_size)
{
	struct imu_port *port = &imu->thread.port;
	int result = imu_thread_init(&imu->thread);

	imu->settings = *settings;
	if (result == 0)
		result = begin(imu, error, error_size);
	if (result == 0 && imu->polled)
		result = measure_polling(imu, error, error_size);
	if (result < 0)
		return result;
	source_use_rate(port, imu->rate_hz);
	/* Analog Devices calibrates its ADIS modules; no other driver of the kernel's is one of calibrated chips */
	port->uncalibrated = strncmp(iio_imu_label(imu->triads[GYRO].device), "adis", 4) == 0 ? IMU_UNCALIBRATED_MAG
											      : IMU_UNCALIBRATED;
	snprintf(port->name, sizeof port->name, "iio:%.20s+%.20s%s", iio_imu_label(imu->triads[GYRO].device),
		iio_imu_label(imu->triads[ACCEL].device),
		imu->polled		       ? ", polled"
		: imu->timers[TIMER_MOTION][0] ? ", by timer"
					       : "");
	tell_mirrors(imu);
	result = imu_thread_start(&imu->thread, "imu9-iio", settings->realtime, run);
	if (result < 0)
		snprintf(error, error_size, "cannot start the sensor's thread: %s", strerror(-result));
	return result;
}

int iio_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size)
{
	struct iio_imu *imu = calloc(1, sizeof *imu);
	int result;

	if (!imu)
		return -ENOMEM;
	result = parse(imu, args, error, error_size);
	if (result < 0 || !port) {
		free(imu);
		return result;
	}
	imu->thread.port.ops = &OPS;
	pthread_mutex_init(&imu->lock, NULL);
	result = start(imu, settings, error, error_size);
	if (result < 0) {
		release(imu);
		return result;
	}
	*port = &imu->thread.port;
	return 0;
}
