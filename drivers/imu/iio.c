/* iio[:DEVICE[,DEVICE]...]: what the kernel's own drivers measure, through libiio. Buffered capture by the devices' own
 * triggers (data ready) or a timer trigger, which is made through configfs; where neither can be, polled through sysfs.
 * Units: Documentation/ABI/testing/sysfs-bus-iio. */
#include <errno.h>
#include <iio.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "drivers/imu/frozen.h"
#include "drivers/imu/iio_text.h"
#include "drivers/imu/imu_thread.h"
#include "drivers/imu/merge.h"
#include "drivers/imu/source.h"
#include "model/math/units.h"

enum { TRIADS = 3, AXES = 3, DEVICES_NAMED = 4, TEXT = 256, KERNEL_SAMPLES = 64, SETTLING_INTERVALS = 5 };
/* A trigger serves two devices (CONFIG_IIO_CONSUMERS_PER_TRIGGER, where nobody raised it): a magnetometer of its own has
 * its own. */
enum { TIMER_MOTION, TIMER_MAG, TIMERS };

#define NS_PER_MS    1000000LL
#define NS_PER_S     1000000000LL
#define WAKE_NS	     (20 * NS_PER_MS)  /* a device that has gone wakes nobody */
#define STALL_NS     (100 * NS_PER_MS) /* or five intervals */
#define MAG_RETRY_NS (2 * NS_PER_S)

static const char TIMER_TRIGGERS[] = "/sys/kernel/config/iio/triggers/hrtimer", TIMER_PREFIX[] = "imu9-";

static const struct kind {
	enum imu_chip chip;
	const char *name;
	enum iio_chan_type type;
	double to_sample; /* from the kernel's unit (m/s^2, rad/s, Gauss) to that of struct imu_sample */
} KINDS[TRIADS] = {
	{IMU_CHIP_GYRO, "gyro", IIO_ANGL_VEL, 1},
	{IMU_CHIP_ACCEL, "accelerometer", IIO_ACCEL, 1},
	{IMU_CHIP_MAG, "magnetometer", IIO_MAGN, 100},
};
enum { GYRO, ACCEL, MAG }; /* indices of KINDS and of what follows */

/* three axes of one device */
struct triad {
	struct iio_device *device; /* NULL: there is none */
	struct iio_channel *axis[AXES];
	double scale[AXES], offset[AXES];
	struct vec3 mount[AXES]; /* rows */
	double lowest, highest;	 /* raw */
	double interval_ns;	 /* of the chip's own samples; 0: not known */
	int64_t settled_ns;	 /* readings before are of a chip that wakes up */
	int64_t seen_ns;	 /* when a reading came last */
	int64_t taken_ns;	 /* the last reading's time */
};

/* one device, whose triads are read together */
struct capture {
	struct iio_device *device;
	struct iio_buffer *buffer;
	struct iio_channel *timestamp;
	const char *timer; /* NULL: it has a clock of its own */
};

/* what can be set, as told when first opened */
struct choice {
	char rates[TEXT], scales[TEXT];
	double digits; /* from the middle to the end of the range */
	bool by_timer;
};

struct iio_imu {
	struct imu_thread thread;
	char names[TEXT];
	const char *wanted[DEVICES_NAMED];
	size_t wanted_count;

	pthread_mutex_t lock;
	struct imu_settings settings;  /* the port's, under `lock` for the thread */
	struct choice choices[TRIADS]; /* the thread's, under `lock` for the port */
	atomic_bool restart;

	/* the thread's own */
	struct iio_context *context;
	struct triad triads[TRIADS];
	struct capture captures[TRIADS];
	size_t capture_count;
	bool running, polled, had_mag;
	char timers[TIMERS][48]; /* names of the triggers that were made; "" */
	double rate_hz;
	double polling_hz; /* no more rounds through sysfs fit into a second, as measured when opened; 0: not polled */
	struct merge merge;
	struct frozen gyro_frozen; /* also over restarts */
	bool is_frozen;
	int64_t next_ns; /* polled; to look for a magnetometer; to read the temperature */
	int64_t mag_retry_ns, temperature_ns;
	bool temperature_new;
	double temperature_degC;
};

/* ---- attributes -------------------------------------------------------------------------------------------------- */

/* Of the axis, or of the whole device. The length, or -errno. */
static ssize_t read_attr(const struct triad *t, int axis, const char *name, char *text)
{
	ssize_t n = iio_channel_find_attr(t->axis[axis], name) ? iio_channel_attr_read(t->axis[axis], name, text, TEXT)
							       : iio_device_attr_read(t->device, name, text, TEXT);

	if (n < 0)
		text[0] = '\0';
	return n;
}

static ssize_t write_attr(const struct triad *t, const char *name, const char *text)
{
	return iio_channel_find_attr(t->axis[0], name) ? iio_channel_attr_write(t->axis[0], name, text)
						       : iio_device_attr_write(t->device, name, text);
}

static double read_number(const struct triad *t, int axis, const char *name, double otherwise)
{
	char text[TEXT];

	return read_attr(t, axis, name, text) > 0 ? strtod(text, NULL) : otherwise;
}

static const char *label(const struct iio_device *device)
{
	const char *name = iio_device_get_name(device);

	return name ? name : iio_device_get_id(device);
}

/* ---- finding ----------------------------------------------------------------------------------------------------- */

static struct iio_channel *find_axis(const struct iio_device *device, enum iio_chan_type type, int axis)
{
	for (unsigned i = 0; i < iio_device_get_channels_count(device); i++) {
		struct iio_channel *channel = iio_device_get_channel(device, i);

		if (!iio_channel_is_output(channel) && iio_channel_get_type(channel) == type &&
			(int)iio_channel_get_modifier(channel) == IIO_MOD_X + axis)
			return channel;
	}
	return NULL;
}

static bool has_triad(struct iio_device *device, enum iio_chan_type type, struct triad *triad)
{
	*triad = (struct triad){.device = device};
	for (int i = 0; i < AXES; i++) {
		triad->axis[i] = find_axis(device, type, i);
		if (!triad->axis[i])
			return false;
	}
	return true;
}

static bool is_wanted(const struct iio_imu *imu, const struct iio_device *device)
{
	for (size_t i = 0; i < imu->wanted_count; i++)
		if (strcmp(imu->wanted[i], iio_device_get_id(device)) == 0 ||
			(iio_device_get_name(device) && strcmp(imu->wanted[i], iio_device_get_name(device)) == 0))
			return true;
	return imu->wanted_count == 0;
}

/* 0, or -errno: none, or more than one. */
static int find_triad(struct iio_imu *imu, int kind, char *error, size_t error_size)
{
	struct triad found, *triad = &imu->triads[kind];

	*triad = (struct triad){0};
	for (unsigned i = 0; i < iio_context_get_devices_count(imu->context); i++) {
		struct iio_device *device = iio_context_get_device(imu->context, i);

		if (iio_device_is_trigger(device) || !is_wanted(imu, device) ||
			!has_triad(device, KINDS[kind].type, &found))
			continue;
		if (triad->device) {
			snprintf(error, error_size, "iio: %s and %s have a %s each: name one (iio:%s,...)",
				label(triad->device), label(device), KINDS[kind].name, label(device));
			return -EINVAL;
		}
		*triad = found;
	}
	if (triad->device)
		return 0;
	snprintf(error, error_size, "iio: no %s%s in /sys/bus/iio/devices: is its driver loaded and bound?",
		KINDS[kind].name, imu->wanted_count ? " of that name" : "");
	return -ENODEV;
}

static int find_triads(struct iio_imu *imu, char *error, size_t error_size)
{
	if (imu->context)
		iio_context_destroy(imu->context);
	imu->context = iio_create_local_context();
	if (!imu->context) {
		int result = errno ? -errno : -ENODEV;

		snprintf(error, error_size, "iio: %s: this kernel has no IIO device", strerror(-result));
		return result;
	}
	for (int kind = 0; kind < TRIADS; kind++) {
		int result = find_triad(imu, kind, error, error_size);

		if (result < 0 && (kind != MAG || result != -ENODEV))
			return result;
	}
	return 0;
}

/* ---- setting up -------------------------------------------------------------------------------------------------- */

/* What the settings ask of each, in the kernel's unit. */
static double wanted_range(const struct imu_settings *settings, int kind)
{
	return kind == GYRO    ? settings->gyro_range_deg_s * RAD_PER_DEG
	       : kind == ACCEL ? settings->accel_range_g * STANDARD_GRAVITY_M_S2
			       : settings->mag_range_uT / 100;
}

/* A timer takes the newest sample there is: the chip must take them faster than the timer, or some come twice. */
static double wanted_rate(const struct imu_settings *settings, const struct choice *choice)
{
	return choice->by_timer ? 2 * settings->rate_hz : settings->rate_hz;
}

static int choose(const struct choice *choice, const struct imu_settings *settings, int kind, char *rate, char *scale,
	char *error, size_t error_size)
{
	rate[0] = scale[0] = '\0';
	if (choice->rates[0] && iio_choose(choice->rates, wanted_rate(settings, choice), rate, 32) == -ERANGE &&
		kind != MAG && strtod(rate, NULL) < settings->rate_hz) {
		snprintf(error, error_size, "iio: the %s takes %s samples a second at most", KINDS[kind].name, rate);
		return -EINVAL;
	}
	if (choice->scales[0] &&
		iio_choose(choice->scales, wanted_range(settings, kind) / choice->digits, scale, 32) == -ERANGE &&
		strtod(scale, NULL) * choice->digits < 0.99 * wanted_range(settings, kind)) {
		snprintf(error, error_size, "iio: the range of the %s is not so wide", KINDS[kind].name);
		return -EINVAL;
	}
	return 0;
}

static int complain(const struct iio_device *device, const char *what, ssize_t result, char *error, size_t error_size)
{
	snprintf(error, error_size, "iio: %s of %s: %s%s", what, label(device), strerror((int)-result),
		result == -EACCES  ? ": run as root, or give this user the device's files by a udev rule"
		: result == -EBUSY ? ": another program reads it"
				   : "");
	return (int)result;
}

static int read_scales(struct triad *t, int kind, char *error, size_t error_size)
{
	const struct iio_data_format *format = iio_channel_get_data_format(t->axis[0]);
	unsigned bits = format->bits > 0 && format->bits < 64 ? format->bits : 16;
	char text[TEXT];

	for (int i = 0; i < AXES; i++) {
		t->scale[i] = read_number(t, i, "scale", 1) * KINDS[kind].to_sample;
		t->offset[i] = read_number(t, i, "offset", 0);
		t->mount[i] = (struct vec3){i == 0, i == 1, i == 2};
	}
	t->highest = ldexp(1, (int)bits - (format->is_signed ? 1 : 0)) - 1;
	t->lowest = format->is_signed ? -t->highest - 1 : -INFINITY;
	if (read_attr(t, 0, "mount_matrix", text) > 0 && iio_parse_mount_matrix(text, t->mount) < 0) {
		snprintf(
			error, error_size, "iio: the mount_matrix of %s is no rotation: %.60s", label(t->device), text);
		return -EINVAL;
	}
	return 0;
}

static void learn_choices(struct iio_imu *imu, int kind, bool by_timer)
{
	const struct triad *t = &imu->triads[kind];
	const struct iio_data_format *format = iio_channel_get_data_format(t->axis[0]);
	struct choice choice = {.by_timer = by_timer};

	if (imu->choices[kind].digits > 0)
		return;
	read_attr(t, 0, "sampling_frequency_available", choice.rates);
	read_attr(t, 0, "scale_available", choice.scales);
	choice.digits = ldexp(1, format->bits > 0 && format->bits < 64 ? (int)format->bits - 1 : 15);
	pthread_mutex_lock(&imu->lock); /* a magnetometer may come late */
	imu->choices[kind] = choice;
	pthread_mutex_unlock(&imu->lock);
}

static int set_up(struct iio_imu *imu, int kind, const struct imu_settings *settings, char *error, size_t error_size)
{
	struct triad *t = &imu->triads[kind];
	char rate[32], scale[32];
	double taken_hz;
	int result = choose(&imu->choices[kind], settings, kind, rate, scale, error, error_size);
	ssize_t n = 0;

	if (result < 0)
		return result;
	if (scale[0] && (n = write_attr(t, "scale", scale)) < 0)
		return complain(t->device, "the range", n, error, error_size);
	if (rate[0] && (n = write_attr(t, "sampling_frequency", rate)) < 0)
		return complain(t->device, "the rate", n, error, error_size);
	taken_hz = read_number(t, 0, "sampling_frequency", 0);
	t->interval_ns = taken_hz > 0 ? 1e9 / taken_hz : 0;
	t->seen_ns = imu_thread_now_ns();
	t->settled_ns = t->seen_ns + (int64_t)(SETTLING_INTERVALS * t->interval_ns);
	return read_scales(t, kind, error, error_size);
}

/* ---- triggers ---------------------------------------------------------------------------------------------------- */

enum triggering { NO_BUFFER, OWN_CLOCK, NEEDS_TIMER };

static enum triggering how_triggered(const struct triad *t)
{
	const struct iio_device *trigger = NULL;
	int result;

	for (int i = 0; i < AXES; i++) {
		unsigned bits = iio_channel_get_data_format(t->axis[i])->length;

		if (!iio_channel_is_scan_element(t->axis[i]) || bits < 8 || bits > 64)
			return NO_BUFFER;
	}
	result = iio_device_get_trigger(t->device, &trigger);
	if (result == -ENOENT) /* a FIFO of its own, and nothing to be chosen */
		return OWN_CLOCK;
	/* the timer of a gateway that was killed may be there still */
	return result == 0 && trigger && strncmp(label(trigger), TIMER_PREFIX, sizeof TIMER_PREFIX - 1) != 0
		       ? OWN_CLOCK
		       : NEEDS_TIMER;
}

static int timer_of(const struct iio_imu *imu, int kind)
{
	const struct triad *t = imu->triads;

	return kind == MAG && t[MAG].device != t[GYRO].device && t[MAG].device != t[ACCEL].device ? TIMER_MAG
												  : TIMER_MOTION;
}

static bool make_timer(struct iio_imu *imu, int which)
{
	const char *number = strchr(iio_device_get_id(imu->triads[GYRO].device), ':'); /* iio:device2 */
	char path[160];

	snprintf(imu->timers[which], sizeof *imu->timers, "%s%.30s%s", TIMER_PREFIX, number ? number + 1 : "",
		which == TIMER_MAG ? "-mag" : "");
	snprintf(path, sizeof path, "%s/%s", TIMER_TRIGGERS, imu->timers[which]);
	if (mkdir(path, 0755) == 0 || errno == EEXIST)
		return true;
	imu->timers[which][0] = '\0';
	return false;
}

static void remove_timers(struct iio_imu *imu)
{
	for (int i = 0; i < TIMERS; i++) {
		char path[160];

		if (imu->timers[i][0] == '\0')
			continue;
		snprintf(path, sizeof path, "%s/%s", TIMER_TRIGGERS, imu->timers[i]);
		rmdir(path);
		imu->timers[i][0] = '\0';
	}
}

static int use_timer(struct iio_imu *imu, const struct capture *c, char *error, size_t error_size)
{
	const struct iio_device *timer = iio_context_find_device(imu->context, c->timer);
	char rate[32];
	ssize_t n;

	if (!timer) {
		snprintf(error, error_size, "iio: the timer trigger %s did not come up", c->timer);
		return -ENODEV;
	}
	snprintf(rate, sizeof rate, "%.3f", imu->rate_hz);
	n = iio_device_attr_write(timer, "sampling_frequency", rate);
	if (n < 0)
		return complain(timer, "the rate", n, error, error_size);
	n = iio_device_set_trigger(c->device, timer);
	return n < 0 ? complain(c->device, "the trigger", n, error, error_size) : 0;
}

/* ---- buffers ----------------------------------------------------------------------------------------------------- */

static bool is_of(const struct capture *c, const struct triad *t)
{
	return t->device && t->device == c->device;
}

static int open_buffer(struct iio_imu *imu, struct capture *c, char *error, size_t error_size)
{
	ssize_t n;

	for (unsigned i = 0; i < iio_device_get_channels_count(c->device); i++)
		iio_channel_disable(iio_device_get_channel(c->device, i));
	for (int kind = 0; kind < TRIADS; kind++)
		for (int i = 0; i < AXES && is_of(c, &imu->triads[kind]); i++)
			iio_channel_enable(imu->triads[kind].axis[i]);
	c->timestamp = iio_device_find_channel(c->device, "timestamp", false);
	if (c->timestamp)
		iio_channel_enable(c->timestamp);
	/* the time of the gateway; without it, readings have the time they come at */
	if (c->timestamp && (n = iio_device_attr_write(c->device, "current_timestamp_clock", "monotonic")) < 0)
		return complain(c->device, "the clock", n, error, error_size);
	n = iio_device_set_kernel_buffers_count(c->device, KERNEL_SAMPLES);
	if (n == 0)
		c->buffer = iio_device_create_buffer(c->device, 1, false);
	if (!c->buffer)
		return complain(c->device, "the buffer", n < 0 ? n : -errno, error, error_size);
	n = iio_buffer_set_blocking_mode(c->buffer, false);
	return n < 0 ? complain(c->device, "the buffer", n, error, error_size) : 0;
}

static void add_capture(struct iio_imu *imu, int kind, const char *timer)
{
	struct triad *t = &imu->triads[kind];

	for (size_t i = 0; i < imu->capture_count; i++)
		if (is_of(&imu->captures[i], t))
			return;
	imu->captures[imu->capture_count++] = (struct capture){.device = t->device, .timer = timer};
}

/* Closes everything; the trigger that was made goes, too. */
static void end(struct iio_imu *imu)
{
	for (size_t i = 0; i < imu->capture_count; i++) {
		struct capture *c = &imu->captures[i];

		if (c->buffer)
			iio_buffer_destroy(c->buffer);
		if (c->timer && iio_device_set_trigger(c->device, NULL) < 0) { /* the device has gone */
		}
	}
	imu->capture_count = 0;
	if (imu->context)
		iio_context_destroy(imu->context);
	imu->context = NULL;
	remove_timers(imu);
	imu->is_frozen = false;
	imu->running = false;
}

/* How each is triggered; makes the timer where one needs it. Polled is what is left. */
static int plan_capture(struct iio_imu *imu, char *error, size_t error_size)
{
	enum triggering how[TRIADS] = {OWN_CLOCK, OWN_CLOCK, OWN_CLOCK};
	bool timer = false;
	int result = 0;

	imu->polled = false;
	for (int kind = 0; kind < TRIADS; kind++) {
		if (!imu->triads[kind].device)
			continue;
		how[kind] = how_triggered(&imu->triads[kind]);
		imu->polled |= how[kind] == NO_BUFFER;
		timer |= how[kind] == NEEDS_TIMER;
	}
	for (int kind = 0; kind < TRIADS && timer && !imu->polled; kind++)
		if (imu->triads[kind].device && how[kind] == NEEDS_TIMER)
			imu->polled = !make_timer(imu, timer_of(imu, kind));
	if (timer && !imu->polled) /* a context knows what there was when it was made */
		result = find_triads(imu, error, error_size);
	if (result < 0)
		return result;
	for (int kind = 0; kind < TRIADS; kind++) {
		if (!imu->triads[kind].device)
			continue;
		learn_choices(imu, kind, imu->polled || how[kind] == NEEDS_TIMER);
		if (!imu->polled)
			add_capture(imu, kind, how[kind] == NEEDS_TIMER ? imu->timers[timer_of(imu, kind)] : NULL);
	}
	return 0;
}

/* A reading taken by a timer is as old as the chip's newest sample then was: half its interval, more or less. */
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

static int begin(struct iio_imu *imu, char *error, size_t error_size)
{
	struct imu_settings settings;
	int result;

	pthread_mutex_lock(&imu->lock);
	settings = imu->settings;
	pthread_mutex_unlock(&imu->lock);
	imu->rate_hz = settings.rate_hz;
	result = find_triads(imu, error, error_size);
	if (result == 0)
		result = plan_capture(imu, error, error_size);
	if (imu->polled)
		imu->rate_hz = polled_rate(imu, settings.rate_hz);
	for (int kind = 0; kind < TRIADS && result == 0; kind++)
		if (imu->triads[kind].device)
			result = set_up(imu, kind, &settings, error, error_size);
	merge_init(&imu->merge, tolerance_ns(imu));
	for (size_t i = 0; i < imu->capture_count && result == 0; i++) {
		if (imu->captures[i].timer)
			result = use_timer(imu, &imu->captures[i], error, error_size);
		if (result == 0)
			result = open_buffer(imu, &imu->captures[i], error, error_size);
	}
	if (result < 0) {
		end(imu);
		return result;
	}
	if (!imu->choices[GYRO].by_timer && imu->triads[GYRO].interval_ns > 0)
		imu->rate_hz = 1e9 / imu->triads[GYRO].interval_ns;
	imu->had_mag |= imu->triads[MAG].device != NULL;
	imu->mag_retry_ns = imu->next_ns = imu_thread_now_ns();
	imu->running = true;
	return 0;
}

/* ---- readings ---------------------------------------------------------------------------------------------------- */

static double raw_of(const struct iio_channel *channel, const void *host)
{
	const struct iio_data_format *format = iio_channel_get_data_format(channel);
	uint64_t value = 0;

	memcpy(&value, host, format->length / 8); /* little-endian hosts only */
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
	/* the others may be coarse, and then be still at rest */
	if (kind == GYRO)
		imu->is_frozen = frozen_watch(&imu->gyro_frozen, raw, AXES);
	if (kind == GYRO && imu->is_frozen)
		return;
	/* a timer faster than the chip reads the same sample again */
	if (kind == MAG && (double)(t_ns - t->taken_ns) < 0.9 * t->interval_ns)
		return;
	t->taken_ns = t_ns;
	for (int i = 0; i < AXES; i++)
		reading.saturated |= raw[i] >= t->highest || raw[i] <= t->lowest;
	v = (struct vec3){(raw[0] + t->offset[0]) * t->scale[0], (raw[1] + t->offset[1]) * t->scale[1],
		(raw[2] + t->offset[2]) * t->scale[2]};
	reading.value = (struct vec3){vec3_dot(t->mount[0], v), vec3_dot(t->mount[1], v), vec3_dot(t->mount[2], v)};
	if (imu->choices[kind].by_timer)
		reading.t_ns -= (int64_t)(t->interval_ns / 2);
	merge_add(&imu->merge, KINDS[kind].chip, &reading);
}

static void take_scan(struct iio_imu *imu, const struct capture *c)
{
	int64_t t_ns = imu_thread_now_ns();

	if (c->timestamp)
		iio_channel_convert(c->timestamp, &t_ns, iio_buffer_first(c->buffer, c->timestamp));
	for (int kind = 0; kind < TRIADS; kind++) {
		struct triad *t = &imu->triads[kind];
		double raw[AXES];

		if (!is_of(c, t))
			continue;
		for (int i = 0; i < AXES; i++) {
			int64_t host = 0;

			iio_channel_convert(t->axis[i], &host, iio_buffer_first(c->buffer, t->axis[i]));
			raw[i] = raw_of(t->axis[i], &host);
		}
		add_reading(imu, kind, raw, t_ns);
	}
}

/* Everything that is there. 0 or -errno. */
static int drain(struct iio_imu *imu, const struct capture *c)
{
	ssize_t n;

	while ((n = iio_buffer_refill(c->buffer)) > 0)
		take_scan(imu, c);
	return n == 0 ? -ENODEV : n == -EAGAIN ? 0 : (int)n;
}

static bool read_raw(const struct triad *t, double raw[AXES])
{
	for (int i = 0; i < AXES; i++)
		if (iio_channel_attr_read_double(t->axis[i], "raw", &raw[i]) < 0)
			return false;
	return true;
}

/* One of each through sysfs, its time the middle of its reading. False: gyro or accelerometer cannot be read. */
static bool read_polled(struct iio_imu *imu)
{
	for (int kind = 0; kind < TRIADS; kind++) {
		int64_t begun_ns = imu_thread_now_ns();
		double raw[AXES];

		if (!imu->triads[kind].device)
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
		imu_thread_works(&imu->thread);
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

/* Samples go on without the magnetometer. One that went away is looked for; what has come back is found by beginning
 * anew. */
static void watch_mag(struct iio_imu *imu)
{
	struct imu_health *h = &imu->thread.health;
	bool missing = imu->had_mag && !imu->triads[MAG].device, still = stalled(imu, MAG);
	struct iio_context *context;

	h->degraded = (uint8_t)(missing ? IMU_FAULT_SILENT : still ? IMU_FAULT_STOPPED : IMU_FAULT_NONE);
	h->degraded_chip = h->degraded ? IMU_CHIP_MAG : 0;
	imu_thread_tell(&imu->thread);
	if (!missing || imu_thread_now_ns() < imu->mag_retry_ns)
		return;
	imu->mag_retry_ns = imu_thread_now_ns() + MAG_RETRY_NS;
	context = iio_create_local_context();
	for (unsigned i = 0; context && i < iio_context_get_devices_count(context); i++) {
		struct iio_device *device = iio_context_get_device(context, i);
		struct triad found;

		if (is_wanted(imu, device) && has_triad(device, IIO_MAGN, &found))
			atomic_store(&imu->restart, true);
	}
	if (context)
		iio_context_destroy(context);
}

/* False: it failed, and that was told. */
static bool capture(struct iio_imu *imu)
{
	struct pollfd fds[TRIADS];

	for (size_t i = 0; i < imu->capture_count; i++)
		fds[i] = (struct pollfd){iio_buffer_get_poll_fd(imu->captures[i].buffer), POLLIN, 0};
	imu_thread_wait(&imu->thread, imu_thread_now_ns() + WAKE_NS, fds, imu->capture_count);
	for (size_t i = 0; i < imu->capture_count; i++) {
		const struct capture *c = &imu->captures[i];

		if (drain(imu, c) < 0) {
			fail(imu, IMU_FAULT_SILENT,
				is_of(c, &imu->triads[GYRO])	? IMU_CHIP_GYRO
				: is_of(c, &imu->triads[ACCEL]) ? IMU_CHIP_ACCEL
								: IMU_CHIP_MAG);
			return false;
		}
	}
	return true;
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
			fail(imu, IMU_FAULT_STOPPED, KINDS[kind].chip);
			return;
		}
	watch_mag(imu);
}

static void run(struct imu_thread *t)
{
	struct iio_imu *imu = (struct iio_imu *)t;
	char error[200];

	while (!imu_thread_stopping(t)) {
		if (atomic_exchange(&imu->restart, false))
			end(imu);
		if (imu->running || begin(imu, error, sizeof error) == 0)
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
		int result = choice->digits > 0 ? choose(choice, settings, kind, rate, scale, error, error_size) : 0;

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
		snprintf(error, error_size, "iio: names longer than %zu characters", sizeof imu->names - 1);
		return -EINVAL;
	}
	while ((name = strsep(&rest, ","))) {
		if (*name == '\0')
			continue;
		if (imu->wanted_count == DEVICES_NAMED) {
			snprintf(error, error_size, "iio: more than %d devices", DEVICES_NAMED);
			return -EINVAL;
		}
		imu->wanted[imu->wanted_count++] = name;
	}
	return 0;
}

/* A round through sysfs may take longer than asked for: drivers switch the chip on for each. */
static int measure_polling(struct iio_imu *imu, char *error, size_t error_size)
{
	int64_t begun_ns = imu_thread_now_ns();

	if (!read_polled(imu)) {
		snprintf(error, error_size, "iio: %s cannot be read", label(imu->triads[GYRO].device));
		return -EIO;
	}
	imu->polling_hz = 0.9e9 / (double)(imu_thread_now_ns() - begun_ns);
	imu->rate_hz = polled_rate(imu, imu->rate_hz);
	return 0;
}

static int start(
	struct iio_imu *imu, const char *args, const struct imu_settings *settings, char *error, size_t error_size)
{
	struct imu_port *port = &imu->thread.port;
	int result = imu_thread_init(&imu->thread);

	imu->settings = *settings;
	if (result == 0)
		result = parse(imu, args, error, error_size);
	if (result == 0)
		result = begin(imu, error, error_size);
	if (result == 0 && imu->polled)
		result = measure_polling(imu, error, error_size);
	if (result < 0)
		return result;
	source_use_rate(port, imu->rate_hz);
	snprintf(port->name, sizeof port->name, "iio:%.20s+%.20s%s", label(imu->triads[GYRO].device),
		label(imu->triads[ACCEL].device),
		imu->polled		       ? ", polled"
		: imu->timers[TIMER_MOTION][0] ? ", by timer"
					       : "");
	result = imu_thread_start(&imu->thread, "imu9-iio", settings->realtime, run);
	if (result < 0)
		snprintf(error, error_size, "no thread for the sensor: %s", strerror(-result));
	return result;
}

int iio_open(char *args, const struct imu_settings *settings, struct imu_port **port, char *error, size_t error_size)
{
	struct iio_imu *imu = calloc(1, sizeof *imu);
	int result;

	if (!imu)
		return -ENOMEM;
	imu->thread.port.ops = &OPS;
	pthread_mutex_init(&imu->lock, NULL);
	result = start(imu, args, settings, error, error_size);
	if (result < 0) {
		release(imu);
		return result;
	}
	*port = &imu->thread.port;
	return 0;
}
