/* Triggers and buffers of IIO devices. A device is triggered by its own trigger (data ready), or by a timer trigger
 * that is created through configfs. */
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "drivers/imu/iio_parts.h"

enum { KERNEL_SAMPLES = 64 };

static const char TIMER_TRIGGERS[] = "/sys/kernel/config/iio/triggers/hrtimer", TIMER_PREFIX[] = "imu9-";

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
	if (result == -ENOENT) /* the device has a FIFO and needs no trigger */
		return OWN_CLOCK;
	/* not the timer trigger left by a gateway that was killed */
	return result == 0 && trigger && strncmp(iio_imu_label(trigger), TIMER_PREFIX, sizeof TIMER_PREFIX - 1) != 0
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

void iio_imu_remove_timers(struct iio_imu *imu)
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

int iio_imu_use_timer(struct iio_imu *imu, const struct capture *c, char *error, size_t error_size)
{
	const struct iio_device *timer = iio_context_find_device(imu->context, c->timer);
	char rate[32];
	ssize_t n;

	if (!timer) {
		snprintf(error, error_size,
			"iio: the kernel did not create the timer trigger %s: `modprobe iio-trig-hrtimer`", c->timer);
		return -ENODEV;
	}
	snprintf(rate, sizeof rate, "%.3f", imu->rate_hz);
	n = iio_device_attr_write(timer, "sampling_frequency", rate);
	if (n < 0)
		return iio_imu_explain(timer, "the rate", n, error, error_size);
	n = iio_device_set_trigger(c->device, timer);
	return n < 0 ? iio_imu_explain(c->device, "the trigger", n, error, error_size) : 0;
}

/* ---- buffers ----------------------------------------------------------------------------------------------------- */

bool iio_imu_is_of(const struct capture *c, const struct triad *t)
{
	return t->device && t->device == c->device;
}

int iio_imu_open_buffer(struct iio_imu *imu, struct capture *c, char *error, size_t error_size)
{
	ssize_t n;

	for (unsigned i = 0; i < iio_device_get_channels_count(c->device); i++)
		iio_channel_disable(iio_device_get_channel(c->device, i));
	for (int kind = 0; kind < TRIADS; kind++)
		for (int i = 0; i < AXES && iio_imu_is_of(c, &imu->triads[kind]); i++)
			iio_channel_enable(imu->triads[kind].axis[i]);
	c->timestamp = iio_device_find_channel(c->device, "timestamp", false);
	if (c->timestamp)
		iio_channel_enable(c->timestamp);
	/* time stamps of CLOCK_MONOTONIC; without them, the time when the scan is read is used */
	if (c->timestamp && (n = iio_device_attr_write(c->device, "current_timestamp_clock", "monotonic")) < 0)
		return iio_imu_explain(c->device, "the clock", n, error, error_size);
	n = iio_device_set_kernel_buffers_count(c->device, KERNEL_SAMPLES);
	if (n == 0)
		c->buffer = iio_device_create_buffer(c->device, 1, false);
	if (!c->buffer)
		return iio_imu_explain(c->device, "the buffer", n < 0 ? n : -errno, error, error_size);
	n = iio_buffer_set_blocking_mode(c->buffer, false);
	return n < 0 ? iio_imu_explain(c->device, "the buffer", n, error, error_size) : 0;
}

static void add_capture(struct iio_imu *imu, int kind, const char *timer)
{
	struct triad *t = &imu->triads[kind];

	for (size_t i = 0; i < imu->capture_count; i++)
		if (iio_imu_is_of(&imu->captures[i], t))
			return;
	imu->captures[imu->capture_count++] = (struct capture){.device = t->device, .timer = timer};
}

/* Chooses how each triad is triggered and creates timer triggers where needed. A triad for which that fails is polled;
 * the others are not, unless neither gyro nor accelerometer has a buffer. */
int iio_imu_plan_capture(struct iio_imu *imu, char *error, size_t error_size)
{
	enum triggering how[TRIADS] = {NO_BUFFER, NO_BUFFER, NO_BUFFER};
	bool polled[TRIADS] = {false}, timer = false;
	int result = 0;

	for (int kind = 0; kind < TRIADS; kind++) {
		if (!imu->triads[kind].device)
			continue;
		how[kind] = how_triggered(&imu->triads[kind]);
		polled[kind] =
			how[kind] == NO_BUFFER || (how[kind] == NEEDS_TIMER && !make_timer(imu, timer_of(imu, kind)));
		timer |= how[kind] == NEEDS_TIMER && !polled[kind];
	}
	imu->polled = polled[GYRO] && polled[ACCEL];
	if (timer && !imu->polled) /* a context contains the devices that existed when it was created */
		result = iio_imu_find_triads(imu, error, error_size);
	if (result < 0)
		return result;
	for (int kind = 0; kind < TRIADS; kind++) {
		if (!imu->triads[kind].device)
			continue;
		imu->triads[kind].polled = polled[kind] && !imu->polled;
		iio_imu_read_choices(imu, kind, imu->polled || polled[kind] || how[kind] == NEEDS_TIMER);
		if (!imu->polled && !polled[kind])
			add_capture(imu, kind, how[kind] == NEEDS_TIMER ? imu->timers[timer_of(imu, kind)] : NULL);
	}
	return 0;
}
