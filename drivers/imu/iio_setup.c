/* Finds the IIO devices with a gyro, an accelerometer and a magnetometer by their channels, and sets their rates and
 * ranges. Units: Documentation/ABI/testing/sysfs-bus-iio. */
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "drivers/imu/iio_parts.h"
#include "drivers/imu/iio_text.h"
#include "model/math/units.h"

enum { SETTLING_INTERVALS = 5 };
/* A range is wide enough from this share of the requested one on: 32768 digits of 0.244 mg are 7.995 g, for 8 g. */
#define ENOUGH 0.99

const struct iio_kind IIO_KINDS[TRIADS] = {
	{IMU_CHIP_GYRO, "gyro", IIO_ANGL_VEL, 1},
	{IMU_CHIP_ACCEL, "accelerometer", IIO_ACCEL, 1},
	{IMU_CHIP_MAG, "magnetometer", IIO_MAGN, UT_PER_GAUSS},
};

/* ---- attributes -------------------------------------------------------------------------------------------------- */

/* Reads the attribute of the axis, or else of the device. The length, or -errno. */
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

const char *iio_imu_label(const struct iio_device *device)
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

bool iio_imu_has_triad(struct iio_device *device, enum iio_chan_type type, struct triad *triad)
{
	*triad = (struct triad){.device = device};
	for (int i = 0; i < AXES; i++) {
		triad->axis[i] = find_axis(device, type, i);
		if (!triad->axis[i])
			return false;
	}
	return true;
}

bool iio_imu_is_wanted(const struct iio_imu *imu, const struct iio_device *device)
{
	for (size_t i = 0; i < imu->wanted_count; i++)
		if (strcmp(imu->wanted[i], iio_device_get_id(device)) == 0 ||
			(iio_device_get_name(device) && strcmp(imu->wanted[i], iio_device_get_name(device)) == 0))
			return true;
	return imu->wanted_count == 0;
}

/* 0; -ENODEV: none; -EINVAL: more than one. */
static int find_triad(struct iio_imu *imu, int kind, char *error, size_t error_size)
{
	struct triad found, *triad = &imu->triads[kind];

	*triad = (struct triad){0};
	for (unsigned i = 0; i < iio_context_get_devices_count(imu->context); i++) {
		struct iio_device *device = iio_context_get_device(imu->context, i);

		if (iio_device_is_trigger(device) || !iio_imu_is_wanted(imu, device) ||
			!iio_imu_has_triad(device, IIO_KINDS[kind].type, &found))
			continue;
		if (triad->device) {
			snprintf(error, error_size, "iio: %s and %s each have a %s: name one of them (iio:%s,...)",
				iio_imu_label(triad->device), iio_imu_label(device), IIO_KINDS[kind].name,
				iio_imu_label(device));
			return -EINVAL;
		}
		*triad = found;
	}
	if (triad->device)
		return 0;
	snprintf(error, error_size,
		"iio: no %s%s in /sys/bus/iio/devices: load its driver, and check in dmesg that it is bound",
		IIO_KINDS[kind].name, imu->wanted_count ? " with such a name" : "");
	return -ENODEV;
}

int iio_imu_find_triads(struct iio_imu *imu, char *error, size_t error_size)
{
	if (imu->context)
		iio_context_destroy(imu->context);
	imu->context = iio_create_local_context();
	if (!imu->context) {
		int result = errno ? -errno : -ENODEV;

		if (result == -ELIBACC)
			snprintf(error, error_size, "iio: libiio is missing: apt install libiio0");
		else
			snprintf(error, error_size, "iio: %s: this kernel has no IIO devices: load the sensor's driver",
				strerror(-result));
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

/* The range that the settings request, in the kernel's unit. */
static double wanted_range(const struct imu_settings *settings, int kind)
{
	return kind == GYRO    ? settings->gyro_range_deg_s * RAD_PER_DEG
	       : kind == ACCEL ? settings->accel_range_g * STANDARD_GRAVITY_M_S2
			       : settings->mag_range_uT / UT_PER_GAUSS;
}

/* A timer trigger reads the chip's newest sample: the chip must sample faster than the timer, or some are read
 * twice. */
static double wanted_rate(const struct imu_settings *settings, const struct choice *choice)
{
	return choice->by_timer ? 2 * settings->rate_hz : settings->rate_hz;
}

int iio_imu_choose_settings(const struct choice *choice, const struct imu_settings *settings, int kind, char *rate,
	char *scale, char *error, size_t error_size)
{
	rate[0] = scale[0] = '\0';
	if (choice->rates[0] && iio_choose(choice->rates, wanted_rate(settings, choice), rate, 32) == -ERANGE &&
		kind != MAG && strtod(rate, NULL) < settings->rate_hz) {
		snprintf(error, error_size, "iio: sensor rate too high: the %s has at most %s samples a second",
			IIO_KINDS[kind].name, rate);
		return -EINVAL;
	}
	if (choice->scales[0] && iio_choose(choice->scales, ENOUGH * wanted_range(settings, kind) / choice->digits,
					 scale, 32) == -ERANGE) {
		snprintf(error, error_size, "iio: range too wide: the widest of the %s has %s a digit",
			IIO_KINDS[kind].name, scale);
		return -EINVAL;
	}
	return 0;
}

int iio_imu_explain(const struct iio_device *device, const char *what, ssize_t result, char *error, size_t error_size)
{
	snprintf(error, error_size, "iio: %s of %s: %s%s", what, iio_imu_label(device), strerror((int)-result),
		result == -EACCES  ? ": run as root, or give this user the device's files by a udev rule"
		: result == -EBUSY ? ": another program reads it: stop that"
				   : "");
	return (int)result;
}

/* Scales that the kernel prints with nine decimals, which leaves one digit of a 32-bit chip: counts per deg/s and per
 * g, of 16 bits (datasheets of ADIS16475 and ADIS16477). */
static const struct {
	const char *name;
	double per_deg_s, per_g;
} EXACT[] = {{"adis16475-1", 160, 4000}, {"adis16475-2", 40, 4000}, {"adis16475-3", 10, 4000},
	{"adis16477-1", 160, 800}, {"adis16477-2", 40, 800}, {"adis16477-3", 10, 800}};

/* The scale of a known chip, if the printed one is the same but for its last digit. */
static double exact_scale(const struct triad *t, int kind, double printed)
{
	const char *name = iio_device_get_name(t->device);

	for (size_t i = 0; name && i < sizeof EXACT / sizeof *EXACT; i++) {
		double exact = ldexp(
			kind == GYRO ? RAD_PER_DEG / EXACT[i].per_deg_s : STANDARD_GRAVITY_M_S2 / EXACT[i].per_g, -16);

		if (kind != MAG && strcmp(name, EXACT[i].name) == 0 && fabs(printed - exact) < 1e-9)
			return exact;
	}
	return printed;
}

/* libiio gives a device's attribute with the prefix that it has in sysfs. */
static ssize_t read_mount_matrix(const struct triad *t, char *text)
{
	ssize_t n = read_attr(t, 0, "mount_matrix", text);

	return n > 0 ? n : read_attr(t, 0, "in_mount_matrix", text);
}

static int read_scales(const struct iio_imu *imu, struct triad *t, int kind, char *error, size_t error_size)
{
	const struct iio_data_format *format = iio_channel_get_data_format(t->axis[0]);
	unsigned bits = format->bits > 0 && format->bits < 64 ? format->bits : 16;
	char text[TEXT];
	int mount;

	for (int i = 0; i < AXES; i++) {
		t->scale[i] = exact_scale(t, kind, read_number(t, i, "scale", 1)) * IIO_KINDS[kind].to_sample;
		t->offset[i] = read_number(t, i, "offset", 0);
		t->mount[i] = (struct vec3){i == 0, i == 1, i == 2};
	}
	t->highest = ldexp(1, (int)bits - (format->is_signed ? 1 : 0)) - 1;
	t->lowest = format->is_signed ? -t->highest - 1 : -INFINITY;
	mount = !imu->ignore_mount && read_mount_matrix(t, text) > 0 ? iio_parse_mount_matrix(text, t->mount) : 0;
	t->mirrored = mount > 0;
	if (mount < 0) {
		snprintf(error, error_size,
			"iio: the mount_matrix of %s is not a rotation: %.60s: correct it in the device tree, or start "
			"with "
			"mount=ignore",
			iio_imu_label(t->device), text);
		return -EINVAL;
	}
	return 0;
}

void iio_imu_read_choices(struct iio_imu *imu, int kind, bool by_timer)
{
	const struct triad *t = &imu->triads[kind];
	const struct iio_data_format *format = iio_channel_get_data_format(t->axis[0]);
	struct choice choice = {.by_timer = by_timer};

	if (imu->choices[kind].digits > 0)
		return;
	read_attr(t, 0, "sampling_frequency_available", choice.rates);
	read_attr(t, 0, "scale_available", choice.scales);
	choice.digits = ldexp(1, format->bits > 0 && format->bits < 64 ? (int)format->bits - 1 : 15);
	pthread_mutex_lock(&imu->lock); /* a magnetometer may be found later */
	imu->choices[kind] = choice;
	pthread_mutex_unlock(&imu->lock);
}

int iio_imu_set_up(struct iio_imu *imu, int kind, const struct imu_settings *settings, char *error, size_t error_size)
{
	struct triad *t = &imu->triads[kind];
	char rate[32], scale[32];
	double actual_hz;
	int result = iio_imu_choose_settings(&imu->choices[kind], settings, kind, rate, scale, error, error_size);
	ssize_t n = 0;

	if (result < 0)
		return result;
	if (scale[0] && (n = write_attr(t, "scale", scale)) < 0)
		return iio_imu_explain(t->device, "the range", n, error, error_size);
	if (rate[0] && (n = write_attr(t, "sampling_frequency", rate)) < 0)
		return iio_imu_explain(t->device, "the rate", n, error, error_size);
	if (!rate[0]) { /* no list: the driver takes what is next to it, or has one rate only */
		snprintf(rate, sizeof rate, "%.9g", wanted_rate(settings, &imu->choices[kind]));
		if (write_attr(t, "sampling_frequency", rate) < 0) { /* one rate only, which is read below */
		}
	}
	actual_hz = read_number(t, 0, "sampling_frequency", 0);
	t->interval_ns = actual_hz > 0 ? 1e9 / actual_hz : 0;
	t->seen_ns = imu_thread_now_ns();
	t->settled_ns = t->seen_ns + (int64_t)(SETTLING_INTERVALS * t->interval_ns);
	return read_scales(imu, t, kind, error, error_size);
}
