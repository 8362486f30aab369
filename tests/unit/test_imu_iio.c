/* The IIO sensor on devices that are simulated behind libiio's functions, which are defined here. The driver's thread
 * runs within run(), step by step, in a time that moves only here. Units: Documentation/ABI/testing/sysfs-bus-iio. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <iio.h>
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "drivers/imu/imu_thread.h"
#include "tests/unit/descriptors.h"

enum { BUFFER_FD = 77, ATTRS = 8, CHANNELS = 12, DEVICES = 8, SCANS = 32, WORDS = 9, X = IIO_MOD_X, TIMERS = 2 };
#define MS 1000000LL

struct attr {
	const char *name;
	char text[160];
};

struct iio_channel {
	enum iio_chan_type type;
	int modifier;
	bool is_output, is_scan, enabled;
	struct iio_data_format format;
	struct attr attrs[ATTRS];
	int16_t raw;
	size_t place; /* of its bytes in a scan */
};

struct scan {
	int64_t t_ns;
	int64_t words[WORDS]; /* as libiio converts them */
};

struct iio_buffer {
	struct iio_device *device;
	struct scan current;
};

enum { END = -1 };

struct iio_device {
	char id[24], name[24];
	bool hidden, is_trigger;
	int trigger_result; /* of iio_device_get_trigger() */
	struct iio_device *trigger;
	struct iio_channel channels[CHANNELS];
	unsigned channel_count;
	struct attr attrs[ATTRS];
	struct iio_buffer buffer;
	bool buffered;
	struct scan scans[SCANS];
	size_t scan_count, scan_next;
	int refill_error; /* END: it returns 0 */
	unsigned kernel_samples;
};

static struct world {
	struct iio_device devices[DEVICES];
	unsigned device_count;
	bool no_iio, no_configfs, no_raw;
	int no_iio_errno;
	const char *denied; /* attribute that must not be written */
	enum { NOTHING, KERNEL_BUFFERS, BUFFER, NOT_BLOCKING, TIMER } refused;
	unsigned contexts;
	char made[TIMERS][80], removed[TIMERS][80];
	unsigned made_count, removed_count;

	int64_t now_ns;
	void *(*thread)(void *);
	void *thread_ctx;
	int steps; /* that the thread may still take */
	void (*each_step)(void);
	uint64_t polled_reads;
} w;

static struct imu_port *port;

/* ---- the system -------------------------------------------------------------------------------------------------- */

int clock_gettime(clockid_t clock, struct timespec *t)
{
	(void)clock;
	*t = (struct timespec){w.now_ns / (1000 * MS), (long)(w.now_ns % (1000 * MS))};
	return 0;
}

int pthread_create(
	pthread_t *restrict thread, const pthread_attr_t *restrict attr, void *(*start)(void *), void *restrict ctx)
{
	(void)thread, (void)attr;
	w.thread = start;
	w.thread_ctx = ctx;
	return 0;
}

int pthread_join(pthread_t thread, void **result)
{
	(void)thread, (void)result;
	w.thread = NULL;
	return 0;
}

/* The thread waits: time moves on to the end of its wait, and the test does what it does in each step. */
int ppoll(struct pollfd *fds, nfds_t n, const struct timespec *timeout, const sigset_t *mask)
{
	const volatile struct pollfd *asked = fds; /* the declaration says that it is written only */
	int buffers = 0;

	(void)mask;
	for (nfds_t i = 0; i < n; i++) {
		buffers += asked[i].fd == BUFFER_FD && asked[i].events == POLLIN;
		fds[i].revents = 0;
	}
	for (unsigned i = 0; i < w.device_count; i++)
		buffers -= w.devices[i].buffered;
	assert_int_equal(buffers, 0); /* it waits for all of them */
	w.now_ns += timeout->tv_sec * 1000 * MS + timeout->tv_nsec;
	if (w.steps-- <= 0)
		((struct imu_thread *)port)->stop = true;
	else if (w.each_step)
		w.each_step();
	return 0;
}

int mkdir(const char *path, mode_t mode)
{
	struct iio_device *timer = &w.devices[w.device_count];

	(void)mode;
	errno = w.no_configfs ? ENOENT : 0;
	for (unsigned i = 0; i < w.device_count; i++)
		if (strcmp(w.devices[i].name, strrchr(path, '/') + 1) == 0)
			errno = EEXIST;
	if (errno)
		return -1;
	snprintf(w.made[w.made_count++ % TIMERS], sizeof(w.made[0]), "%s", path);
	if (w.refused == TIMER) /* a folder, but no trigger */
		return 0;
	*timer = (struct iio_device){.is_trigger = true};
	snprintf(timer->id, sizeof(timer->id), "trigger%u", w.device_count);
	snprintf(timer->name, sizeof(timer->name), "%s", strrchr(path, '/') + 1);
	timer->attrs[0] = (struct attr){.name = "sampling_frequency"};
	w.device_count++;
	return 0;
}

int rmdir(const char *path)
{
	snprintf(w.removed[w.removed_count++ % TIMERS], sizeof(w.removed[0]), "%s", path);
	return 0;
}

/* ---- libiio ------------------------------------------------------------------------------------------------------ */

struct iio_context {
	unsigned device_count; /* a context knows what there was when it was made */
};

struct iio_context *iio_create_local_context(void)
{
	struct iio_context *context = calloc(1, sizeof(*context));

	if (w.no_iio) {
		free(context);
		errno = w.no_iio_errno;
		return NULL;
	}
	w.contexts++;
	context->device_count = w.device_count;
	return context;
}

void iio_context_destroy(struct iio_context *context)
{
	w.contexts--;
	free(context);
}

unsigned iio_context_get_devices_count(const struct iio_context *context)
{
	return context->device_count;
}

struct iio_device *iio_context_get_device(const struct iio_context *context, unsigned i)
{
	assert_true(i < context->device_count);
	return &w.devices[i];
}

struct iio_device *iio_context_find_device(const struct iio_context *context, const char *name)
{
	for (unsigned i = 0; i < context->device_count; i++)
		if (strcmp(w.devices[i].name, name) == 0)
			return &w.devices[i];
	return NULL;
}

const char *iio_device_get_id(const struct iio_device *device)
{
	return device->id;
}

const char *iio_device_get_name(const struct iio_device *device)
{
	return device->name[0] ? device->name : NULL;
}

bool iio_device_is_trigger(const struct iio_device *device)
{
	return device->is_trigger;
}

unsigned iio_device_get_channels_count(const struct iio_device *device)
{
	return device->hidden ? 0 : device->channel_count;
}

struct iio_channel *iio_device_get_channel(const struct iio_device *device, unsigned i)
{
	assert_true(i < device->channel_count);
	return (struct iio_channel *)&device->channels[i];
}

struct iio_channel *iio_device_find_channel(const struct iio_device *device, const char *name, bool output)
{
	assert_string_equal(name, "timestamp");
	assert_false(output);
	for (unsigned i = 0; i < device->channel_count; i++)
		if (device->channels[i].type == IIO_TIMESTAMP)
			return (struct iio_channel *)&device->channels[i];
	return NULL;
}

static ssize_t get(const struct attr *attrs, const char *name, char *text, size_t size)
{
	for (int i = 0; i < ATTRS; i++)
		if (attrs[i].name && strcmp(attrs[i].name, name) == 0)
			return snprintf(text, size, "%s", attrs[i].text);
	return -ENOENT;
}

static ssize_t put(const struct attr *attrs, const char *name, const char *text)
{
	if (w.denied && strcmp(name, w.denied) == 0)
		return -EACCES;
	for (int i = 0; i < ATTRS; i++)
		if (attrs[i].name && strcmp(attrs[i].name, name) == 0)
			return snprintf((char *)attrs[i].text, sizeof(attrs[i].text), "%s", text);
	return -ENOENT;
}

ssize_t iio_device_attr_read(const struct iio_device *device, const char *name, char *text, size_t size)
{
	return get(device->attrs, name, text, size);
}

ssize_t iio_device_attr_write(const struct iio_device *device, const char *name, const char *text)
{
	return put(device->attrs, name, text);
}

const char *iio_channel_find_attr(const struct iio_channel *channel, const char *name)
{
	char text[160];

	return get(channel->attrs, name, text, sizeof(text)) >= 0 ? name : NULL;
}

ssize_t iio_channel_attr_read(const struct iio_channel *channel, const char *name, char *text, size_t size)
{
	return get(channel->attrs, name, text, size);
}

ssize_t iio_channel_attr_write(const struct iio_channel *channel, const char *name, const char *text)
{
	return put(channel->attrs, name, text);
}

int iio_channel_attr_read_double(const struct iio_channel *channel, const char *name, double *value)
{
	char text[64];

	if (strcmp(name, "raw") == 0 && w.no_raw)
		return -EIO;
	if (strcmp(name, "raw") == 0) {
		w.now_ns += MS; /* sysfs is slow */
		*value = channel->raw + (channel->type == IIO_TEMP ? 0 : (double)(w.polled_reads++ % 2));
		return 0;
	}
	if (get(channel->attrs, name, text, sizeof(text)) < 0)
		return -ENOENT;
	*value = strtod(text, NULL);
	return 0;
}

enum iio_chan_type iio_channel_get_type(const struct iio_channel *channel)
{
	return channel->type;
}

enum iio_modifier iio_channel_get_modifier(const struct iio_channel *channel)
{
	return (enum iio_modifier)channel->modifier;
}

bool iio_channel_is_output(const struct iio_channel *channel)
{
	return channel->is_output;
}

bool iio_channel_is_scan_element(const struct iio_channel *channel)
{
	return channel->is_scan;
}

void iio_channel_enable(struct iio_channel *channel)
{
	channel->enabled = true;
}

void iio_channel_disable(struct iio_channel *channel)
{
	channel->enabled = false;
}

const struct iio_data_format *iio_channel_get_data_format(const struct iio_channel *channel)
{
	return &channel->format;
}

int iio_device_get_trigger(const struct iio_device *device, const struct iio_device **trigger)
{
	*trigger = device->trigger;
	return device->trigger_result;
}

int iio_device_set_trigger(const struct iio_device *device, const struct iio_device *trigger)
{
	((struct iio_device *)device)->trigger = (struct iio_device *)trigger;
	return 0;
}

int iio_device_set_kernel_buffers_count(const struct iio_device *device, unsigned count)
{
	((struct iio_device *)device)->kernel_samples = count;
	return w.refused == KERNEL_BUFFERS ? -ENOMEM : 0;
}

struct iio_buffer *iio_device_create_buffer(const struct iio_device *device, size_t samples, bool cyclic)
{
	struct iio_device *d = (struct iio_device *)device;

	assert_int_equal(samples, 1);
	assert_false(cyclic);
	if (w.refused == BUFFER) {
		errno = EBUSY;
		return NULL;
	}
	d->buffer.device = d;
	d->buffered = true;
	return &d->buffer;
}

void iio_buffer_destroy(struct iio_buffer *buffer)
{
	buffer->device->buffered = false;
}

int iio_buffer_set_blocking_mode(struct iio_buffer *buffer, bool blocking)
{
	(void)buffer;
	assert_false(blocking);
	return w.refused == NOT_BLOCKING ? -ENOSYS : 0;
}

int iio_buffer_get_poll_fd(struct iio_buffer *buffer)
{
	(void)buffer;
	return BUFFER_FD;
}

ssize_t iio_buffer_refill(struct iio_buffer *buffer)
{
	struct iio_device *d = buffer->device;

	if (d->scan_next < d->scan_count) {
		buffer->current = d->scans[d->scan_next++];
		return sizeof(buffer->current);
	}
	d->scan_count = d->scan_next = 0;
	return d->refill_error == END ? 0 : d->refill_error ? -d->refill_error : -EAGAIN;
}

void *iio_buffer_first(const struct iio_buffer *buffer, const struct iio_channel *channel)
{
	assert_true(channel->enabled);
	return channel->type == IIO_TIMESTAMP ? (void *)&buffer->current.t_ns
					      : (void *)&buffer->current.words[channel->place];
}

void iio_channel_convert(const struct iio_channel *channel, void *to, const void *from)
{
	memcpy(to, from, channel->format.length / 8);
}

/* ---- the devices ------------------------------------------------------------------------------------------------- */

static void add_triad(struct iio_device *d, enum iio_chan_type type, const char *scale, size_t place)
{
	for (int i = 0; i < 3; i++) {
		struct iio_channel *c = &d->channels[d->channel_count++];

		*c = (struct iio_channel){.type = type,
			.modifier = X + i,
			.is_scan = true,
			.format = {.length = 16, .bits = 16, .is_signed = true},
			.place = place + (size_t)i};
		c->attrs[0] = (struct attr){.name = "scale"};
		strcpy(c->attrs[0].text, scale);
	}
}

static struct iio_device *add_device(const char *name, const char *rate, const char *rates)
{
	struct iio_device *d = &w.devices[w.device_count];

	*d = (struct iio_device){.trigger_result = -ENOENT}; /* a FIFO of its own */
	snprintf(d->id, sizeof(d->id), "iio:device%u", w.device_count++);
	snprintf(d->name, sizeof(d->name), "%s", name);
	d->attrs[0] = (struct attr){.name = "sampling_frequency"};
	d->attrs[1] = (struct attr){.name = "sampling_frequency_available"};
	d->attrs[2] = (struct attr){.name = "current_timestamp_clock", .text = "realtime"};
	strcpy(d->attrs[0].text, rate);
	strcpy(d->attrs[1].text, rates);
	return d;
}

static void add_timestamp(struct iio_device *d)
{
	d->channels[d->channel_count++] = (struct iio_channel){
		.type = IIO_TIMESTAMP, .is_scan = true, .format = {.length = 64, .bits = 64, .is_signed = true}};
}

enum { MOTION, MAGNETOMETER };

/* An LSM6 with gyro and accelerometer in one device, 70 mdps and 0.244 mg a digit, and a LIS3MDL. */
static int set_up(void **state)
{
	struct iio_device *d;

	(void)state;
	w = (struct world){.now_ns = 100000 * MS};
	port = NULL;
	d = add_device("lsm6dso", "104", "52 104 208 416");
	add_triad(d, IIO_ANGL_VEL, "0.001221731", 0);
	add_triad(d, IIO_ACCEL, "0.002392823", 3);
	add_timestamp(d);
	d = add_device("lis3mdl", "80", "10 20 40 80");
	add_triad(d, IIO_MAGN, "0.000146156", 0);
	add_timestamp(d);
	return 0;
}

static int tear_down(void **state)
{
	(void)state;
	if (port)
		imu_close(port);
	assert_int_equal(w.contexts, 0);
	assert_true(w.thread == NULL); /* it has ended */
	for (unsigned i = 0; i < w.device_count; i++)
		assert_false(w.devices[i].buffered);
	return 0;
}

static void open_sensor(const char *src)
{
	char error[300] = "";

	if (imu_open(src, NULL, &port, error, sizeof(error)) < 0)
		fail_msg("%s", error);
}

static void assert_refused(const char *src, int result, const char *words)
{
	char error[300] = "";

	assert_int_equal(imu_open(src, NULL, &port, error, sizeof(error)), result);
	if (!strstr(error, words))
		fail_msg("'%s' does not say '%s'", error, words);
	assert_null(port);
}

static void put_scan(int device, int64_t t_ns, const int16_t words[6])
{
	struct iio_device *d = &w.devices[device];
	struct scan *s = &d->scans[d->scan_count++];

	*s = (struct scan){.t_ns = t_ns};
	for (int i = 0; i < 6; i++)
		s->words[i] = words[i];
}

/* The thread runs for so many waits, then returns as if it were to be stopped; its buffers are closed then. */
static void run(int steps, void (*each_step)(void))
{
	w.steps = steps;
	w.each_step = each_step;
	((struct imu_thread *)port)->stop = false;
	w.thread(w.thread_ctx);
}

static void assert_near(double value, double expected, double tolerance)
{
	if (!(fabs(value - expected) <= tolerance))
		fail_msg("%.9g, expected %.9g", value, expected);
}

static void one_scan_of_each(void)
{
	static const int16_t motion[6] = {1000, -2000, 3000, 4096, -4096, 100}, field[6] = {2000, -1000, 500};

	put_scan(MAGNETOMETER, w.now_ns - 3 * MS, field);
	put_scan(MOTION, w.now_ns - 3 * MS, motion);
}

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static void test_devices_are_found_by_their_channels_and_set_up(void **state)
{
	const struct iio_device *motion = &w.devices[MOTION];

	(void)state;
	open_sensor("iio");
	assert_string_equal(port->name, "iio:lsm6dso+lsm6dso");
	assert_near(port->rate_hz, 104, 1e-9);				  /* 100 Hz asked for */
	assert_string_equal(motion->attrs[0].text, "104");		  /* sampling_frequency */
	assert_string_equal(motion->attrs[2].text, "monotonic");	  /* current_timestamp_clock */
	assert_string_equal(w.devices[MAGNETOMETER].attrs[0].text, "80"); /* its fastest */
	assert_true(motion->buffered && w.devices[MAGNETOMETER].buffered);
	assert_int_equal(motion->kernel_samples, 64);
	for (unsigned i = 0; i < motion->channel_count; i++)
		assert_true(motion->channels[i].enabled);
	assert_int_equal(w.made_count, 0);
}

/* 32768 digits: 2000 deg/s are 0.0010652 rad/s a digit, 8 g are 0.0023942 m/s^2; chips have 0.244 mg, 0.0023928. */
static void test_the_smallest_range_that_is_wide_enough_is_set(void **state)
{
	struct iio_device *motion = &w.devices[MOTION];

	(void)state;
	for (int i = 0; i < 6; i++) {
		motion->channels[i].attrs[1] = (struct attr){.name = "scale_available"};
		strcpy(motion->channels[i].attrs[1].text,
			i < 3 ? "0.000153 0.000611 0.001221" : "0.000598 0.001196 0.002393 0.004785");
	}
	open_sensor("iio");
	assert_string_equal(motion->channels[0].attrs[0].text, "0.001221");
	assert_string_equal(motion->channels[3].attrs[0].text, "0.002393");
}

static void test_settings_that_the_devices_do_not_support_are_refused(void **state)
{
	struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	char error[200] = "";

	(void)state;
	settings.rate_hz = 500;
	assert_int_equal(imu_open("iio", &settings, &port, error, sizeof(error)), -EINVAL);
	assert_non_null(strstr(error, "416"));
	open_sensor("iio");
	assert_int_equal(port->ops->configure(port, &settings, 1, error, sizeof(error)), -EINVAL);
	assert_non_null(strstr(error, "416"));
	settings.rate_hz = 416;
	assert_int_equal(port->ops->configure(port, &settings, 1, error, sizeof(error)), 0);
	assert_near(port->rate_hz, 104, 1e-9); /* dry */
	assert_int_equal(port->ops->configure(port, &settings, 0, error, sizeof(error)), 0);
	assert_near(port->rate_hz, 416, 1e-9);
	run(1, NULL);
	assert_string_equal(w.devices[MOTION].attrs[0].text, "416");
}

static void test_a_sensor_that_is_missing_or_there_twice_is_refused(void **state)
{
	struct iio_device *second;

	(void)state;
	second = add_device("itg3200", "100", "100");
	add_triad(second, IIO_ANGL_VEL, "0.001", 0);
	assert_refused("iio", -EINVAL, "lsm6dso and itg3200");
	assert_refused("iio:lis3mdl", -ENODEV, "gyro");
	assert_refused("iio:itg3200", -ENODEV, "accelerometer");
	assert_refused("iio:a,b,c,d,e", -EINVAL, "4");
	char names[400] = "iio:";
	memset(names + 4, 'x', sizeof(names) - 5);
	assert_refused(names, -EINVAL, "the device names have more than");
	open_sensor("iio:lsm6dso,iio:device1");
	imu_close(port);
	port = NULL;
	w.no_iio = true;
	w.no_iio_errno = ENOENT;
	assert_refused("iio", -ENOENT,
		"iio: No such file or directory: this kernel has no IIO devices: load the sensor's driver");
	w.no_iio_errno = 0;
	assert_refused("iio", -ENODEV, "iio: No such device: this kernel has no IIO devices");
	w.no_iio_errno = ELIBACC;
	assert_refused("iio", -ELIBACC, "iio: libiio is missing: apt install libiio0");
}

static void test_without_a_magnetometer_the_others_are_enough(void **state)
{
	(void)state;
	open_sensor("iio:lsm6dso");
	assert_false(w.devices[MAGNETOMETER].buffered);
}

static void test_a_mount_matrix_that_is_not_a_rotation_is_refused(void **state)
{
	(void)state;
	w.devices[MOTION].channels[0].attrs[2] =
		(struct attr){.name = "mount_matrix", .text = "1, 0, 0; 0, 1, 0; 0, 0, 2"};
	assert_refused("iio", -EINVAL, "mount=ignore");
	open_sensor("iio:mount=ignore");
}

static void test_a_mount_matrix_that_mirrors_is_used_and_told(void **state)
{
	struct imu_sample sample;

	(void)state;
	w.devices[MOTION].channels[3].attrs[2] =
		(struct attr){.name = "mount_matrix", .text = "1, 0, 0; 0, -1, 0; 0, 0, 1"};
	open_sensor("iio");
	assert_non_null(strstr(port->notes, "lsm6dso mirrors the axes of the accelerometer"));
	assert_null(strstr(port->notes, "gyro"));
	w.now_ns += 100 * MS;
	run(1, one_scan_of_each);
	assert_int_equal(imu_read(port, &sample), 1);
	assert_near(sample.accel_m_s2.y, 4096 * 0.002392823, 1e-9);
	assert_near(sample.gyro_rad_s.y, -2000 * 0.001221731, 1e-9);
}

/* libiio gives an attribute of the device with its prefix. */
static void test_the_mount_matrix_of_a_device_has_the_prefix_in(void **state)
{
	struct imu_sample sample;

	(void)state;
	w.devices[MAGNETOMETER].attrs[3] =
		(struct attr){.name = "in_mount_matrix", .text = "0, 1, 0; 1, 0, 0; 0, 0, -1"};
	open_sensor("iio");
	w.now_ns += 100 * MS;
	run(1, one_scan_of_each);
	assert_int_equal(imu_read(port, &sample), 1);
	assert_near(sample.mag_uT.x, -1000 * 0.0146156, 1e-6);
	assert_near(sample.mag_uT.z, -500 * 0.0146156, 1e-6);
}

static void test_a_rate_without_a_list_is_set(void **state)
{
	(void)state;
	w.devices[MOTION].attrs[1].name = NULL;
	strcpy(w.devices[MOTION].attrs[0].text, "2000");
	open_sensor("iio");
	assert_string_equal(w.devices[MOTION].attrs[0].text, "100");
	assert_near(port->rate_hz, 100, 1e-9);
}

/* 40 counts per deg/s and 4000 per g, each divided by 65536. */
static void test_a_scale_of_one_digit_is_that_of_the_known_chip(void **state)
{
	struct iio_device *motion = &w.devices[MOTION];
	struct imu_sample sample;

	(void)state;
	strcpy(motion->name, "adis16475-2");
	for (int i = 0; i < 6; i++)
		strcpy(motion->channels[i].attrs[0].text, i < 3 ? "0.000000006" : "0.000000037");
	open_sensor("iio");
	w.now_ns += 100 * MS;
	run(1, one_scan_of_each);
	assert_int_equal(imu_read(port, &sample), 1);
	assert_near(sample.gyro_rad_s.x, 1000 / 40.0 * (M_PI / 180) / 65536, 1e-12);
	assert_near(sample.accel_m_s2.x, 4096 / 4000.0 * 9.80665 / 65536, 1e-12);
}

/* ---- samples ----------------------------------------------------------------------------------------------------- */

/* 48 ms (five intervals of 104 Hz) until readings are used; of 80 Hz 63 ms. */
static void test_a_scan_becomes_a_sample_with_scale_offset_and_mounting(void **state)
{
	struct iio_device *motion = &w.devices[MOTION];
	struct imu_sample sample;

	(void)state;
	motion->channels[3].attrs[1] = (struct attr){.name = "offset", .text = "-96"};
	motion->channels[0].attrs[2] = (struct attr){.name = "mount_matrix", .text = "0, 1, 0; -1, 0, 0; 0, 0, 1"};
	open_sensor("iio");
	w.now_ns += 100 * MS;
	run(1, one_scan_of_each);
	assert_int_equal(imu_read(port, &sample), 1);
	assert_int_equal(sample.t_us, (w.now_ns - 20 * MS - 3 * MS) / 1000);
	assert_near(sample.gyro_rad_s.x, -2000 * 0.001221731, 1e-9); /* y of the chip */
	assert_near(sample.gyro_rad_s.y, -1000 * 0.001221731, 1e-9);
	assert_near(sample.gyro_rad_s.z, 3000 * 0.001221731, 1e-9);
	assert_near(sample.accel_m_s2.x, 4000 * 0.002392823, 1e-9);
	assert_near(sample.accel_m_s2.y, -4096 * 0.002392823, 1e-9);
	assert_near(sample.mag_uT.x, 2000 * 0.0146156, 1e-9); /* the kernel's unit is the gauss */
	assert_near(sample.mag_uT.y, -1000 * 0.0146156, 1e-9);
	assert_int_equal(sample.flags, SAMPLE_MAG);
	assert_int_equal(imu_read(port, &sample), 0);
}

static void test_readings_of_a_chip_that_has_just_been_set_up_are_dropped(void **state)
{
	struct imu_sample sample;

	(void)state;
	open_sensor("iio");
	w.now_ns += 30 * MS; /* + 20 ms of the wait - 3 ms: 47 of 48.08 ms */
	run(1, one_scan_of_each);
	assert_int_equal(imu_read(port, &sample), 0);
}

static int16_t ends[6];

static void scan_of_ends(void)
{
	put_scan(MOTION, w.now_ns, ends);
}

static void test_a_value_at_the_end_of_its_range_is_flagged_on_every_axis(void **state)
{
	static const int16_t values[] = {32767, -32768, 32766, -32767};
	struct imu_sample sample;

	(void)state;
	open_sensor("iio");
	w.now_ns += 100 * MS;
	for (int i = 0; i < 4 * 6; i++) {
		memset(ends, 0, sizeof(ends));
		ends[i % 6] = values[i / 6];
		ends[(i + 1) % 6] = (int16_t)(i + 1); /* so that they differ from the last */
		run(1, scan_of_ends);
		assert_int_equal(imu_read(port, &sample), 1);
		assert_int_equal(sample.flags & SAMPLE_SATURATED, i < 12 ? SAMPLE_SATURATED : 0);
		imu_close(port);
		port = NULL;
		open_sensor("iio");
		w.now_ns += 100 * MS;
	}
}

static void test_a_sample_has_the_temperature_once_a_second(void **state)
{
	struct iio_device *motion = &w.devices[MOTION];
	struct iio_channel *c = &motion->channels[motion->channel_count++];
	struct imu_sample sample;
	int with = 0, n = 0;

	(void)state;
	*c = (struct iio_channel){.type = IIO_TEMP, .raw = 512};
	c->attrs[0] = (struct attr){.name = "scale", .text = "3.90625"}; /* 1/256 K, in mK */
	c->attrs[1] = (struct attr){.name = "offset", .text = "6400"};
	open_sensor("iio");
	w.now_ns += 100 * MS;
	run(110, one_scan_of_each); /* of 20 ms: 2.2 s */
	for (; imu_read(port, &sample) == 1; n++)
		if (sample.flags & SAMPLE_TEMPERATURE) {
			assert_near(sample.temperature_degC, 27, 1e-9);
			with++;
		}
	assert_true(n > 90);
	assert_int_equal(with, 3); /* at 0, 1 and 2 s */
	assert_near((double)port->health.rate_hz, 50, 1);
}

/* sysfs-bus-iio: without an offset it is 0. */
static void test_a_temperature_without_an_offset_is_the_scaled_reading(void **state)
{
	struct iio_device *motion = &w.devices[MOTION];
	struct iio_channel *c = &motion->channels[motion->channel_count++];
	struct imu_sample sample;
	int with = 0;

	(void)state;
	*c = (struct iio_channel){.type = IIO_TEMP, .raw = 512};
	c->attrs[0] = (struct attr){.name = "scale", .text = "50"};
	open_sensor("iio");
	w.now_ns += 100 * MS;
	run(10, one_scan_of_each);
	while (imu_read(port, &sample) == 1)
		if (sample.flags & SAMPLE_TEMPERATURE) {
			assert_near(sample.temperature_degC, 25.6, 1e-9);
			with++;
		}
	assert_int_equal(with, 1);
}

/* ---- devices as the kernel's drivers show them ------------------------------------------------------------------- */

struct shown_triad {
	enum iio_chan_type type;		   /* 0: none, except for IIO_VOLTAGE, which is 0, too */
	const char *scale, *scales, *rate, *rates; /* of the channels; NULL: not there */
	const char *mount;
	unsigned bits, length; /* 0: 16 */
};

struct shown_device {
	const char *name, *rate, *rates, *mount; /* of the device */
	enum { FIFO, OWN_TRIGGER, NO_TRIGGER } trigger;
	struct shown_triad triads[3];
};

#define LSM6_RATES "12.500 26.000 52.000 104.000 208.000 416.000 833.000"
#define ICM_RATES  "12.500000 25.000000 50.000000 100.000000 200.000000 1000.000000 2000.000000 4000.000000"
#define BMI_ACCEL  "0.78125 1.5625 3.125 6.25 12.5 25 50 100 200 400 800 1600"
#define BMI_GYRO   "25 50 100 200 400 800 1600 3200"
#define BMI323_RATES \
	"0.781250 1.562500 3.125000 6.250000 12.500000 25.000000 50.000000 100.000000 200.000000 400.000000"
#define MPU_ACCEL   "0.000598 0.001196 0.002392 0.004785"
#define MPU_GYRO    "0.000133090 0.000266181 0.000532362 0.001064724"
#define NO_ROTATION "1, 0, 0; 0, 1, 0; 0, 0, 1"
#define AKM_ON_MPU  "0, 1, 0; 1, 0, 0; 0, 0, -1"

static const struct description {
	const char *name; /* of the port */
	struct shown_device devices[3];
	const char *gyro_scale, *accel_scale; /* for 2000 deg/s and 8 g */
	double rate_hz;			      /* for 100 Hz */
	const char *accel_rate;		      /* as written */
	bool has_mag;
} DESCRIPTIONS[] = {
	{"iio:mpu6050+mpu6050",
		{{"mpu6050", "50", "10 20 50 100 200 500", NULL, OWN_TRIGGER,
			{{IIO_ACCEL, "0.000598", MPU_ACCEL, NULL, NULL, NULL, 0, 0},
				{IIO_ANGL_VEL, "0.001064724", MPU_GYRO, NULL, NULL, NULL, 0, 0}}}},
		"0.001064724", "0.002392", 100, "100", false},
	{"iio:mpu9250+mpu9250", /* with the AK8963 in it */
		{{"mpu9250", "50", "10 20 50 100 200 500", NULL, OWN_TRIGGER,
			{{IIO_ACCEL, "0.000598", MPU_ACCEL, NULL, NULL, NO_ROTATION, 0, 0},
				{IIO_ANGL_VEL, "0.001064724", MPU_GYRO, NULL, NULL, NO_ROTATION, 0, 0},
				{IIO_MAGN, "0.001498", NULL, NULL, NULL, AKM_ON_MPU, 0, 0}}}},
		"0.001064724", "0.002392", 100, "100", true},
	{"iio:mpu9250+mpu9250", /* with the AK8963 as a device of its own, without a trigger */
		{{"mpu9250", "50", "10 20 50 100 200 500", NULL, OWN_TRIGGER,
			 {{IIO_ACCEL, "0.000598", MPU_ACCEL, NULL, NULL, NULL, 0, 0},
				 {IIO_ANGL_VEL, "0.001064724", MPU_GYRO, NULL, NULL, NULL, 0, 0}}},
			{"ak8963", NULL, NULL, AKM_ON_MPU, NO_TRIGGER,
				{{IIO_MAGN, "0.001498", NULL, NULL, NULL, NULL, 0, 0}}}},
		"0.001064724", "0.002392", 100, "100", true},
	{"iio:icm42688-gyro+icm42688-accel",
		{{"icm42688-gyro", "50.000000", ICM_RATES, NO_ROTATION, FIFO,
			 {{IIO_ANGL_VEL, "0.001065264", "0.001065264 0.000532632 0.000266316 0.000133158", NULL, NULL,
				 NULL, 0, 0}}},
			{"icm42688-accel", "50.000000", ICM_RATES, NO_ROTATION, FIFO,
				{{IIO_ACCEL, "0.004788403", "0.004788403 0.002394202 0.001197101 0.000598550", NULL,
					NULL, NULL, 0, 0}}}},
		"0.001065264", "0.002394202", 100, "100.000000", false},
	{"iio:bmi160+bmi160",
		{{"bmi160", NULL, NULL, NULL, OWN_TRIGGER,
			{{IIO_ACCEL, "0.000598", "0.000598 0.001197 0.002394 0.004788", "100.000000", BMI_ACCEL, NULL,
				 0, 0},
				{IIO_ANGL_VEL, "0.001065", "0.001065 0.000532 0.000266 0.000133 0.000066", "100.000000",
					BMI_GYRO, NULL, 0, 0}}}},
		"0.001065", "0.002394", 100, "100", false},
	{"iio:bmi160+bmi160, by timer", /* without its interrupt line */
		{{"bmi160", NULL, NULL, NULL, NO_TRIGGER,
			{{IIO_ACCEL, "0.000598", "0.000598 0.001197 0.002394 0.004788", "100.000000", BMI_ACCEL, NULL,
				 0, 0},
				{IIO_ANGL_VEL, "0.001065", "0.001065 0.000532 0.000266 0.000133 0.000066", "100.000000",
					BMI_GYRO, NULL, 0, 0}}}},
		"0.001065", "0.002394", 100, "200", false},
	{"iio:bmi323-imu+bmi323-imu",
		{{"bmi323-imu", NULL, NULL, NULL, OWN_TRIGGER,
			{{IIO_ACCEL, "0.000598", "0.000598 0.001197 0.002394 0.004788", "50.000000", BMI323_RATES, NULL,
				 0, 0},
				{IIO_ANGL_VEL, "0.000066", "0.000066 0.000133 0.000266 0.000532 0.001065", "50.000000",
					BMI323_RATES, NULL, 0, 0}}}},
		"0.001065", "0.002394", 100, "100.000000", false},
	{"iio:lsm6dso_gyro+lsm6dso_accel",
		{{"lsm6dso_gyro", "12.500", LSM6_RATES, NO_ROTATION, FIFO,
			 {{IIO_ANGL_VEL, "0.000152716", "0.000152716 0.000305432 0.000610865 0.001221730", NULL, NULL,
				 NULL, 0, 0}}},
			{"lsm6dso_accel", "12.500", LSM6_RATES, NO_ROTATION, FIFO,
				{{IIO_ACCEL, "0.000598205", "0.000598205 0.001196411 0.002392822 0.004785645", NULL,
					NULL, NULL, 0, 0}}}},
		"0.001221730", "0.002392822", 104, "104.000", false},
	{"iio:ism330dlc_gyro+ism330dlc_accel",
		{{"ism330dlc_gyro", "12.500", LSM6_RATES, NO_ROTATION, FIFO,
			 {{IIO_ANGL_VEL, "0.000152716", "0.000152716 0.000305432 0.000610865 0.001221730", NULL, NULL,
				 NULL, 0, 0}}},
			{"ism330dlc_accel", "12.500", LSM6_RATES, NO_ROTATION, FIFO,
				{{IIO_ACCEL, "0.000598205", "0.000598205 0.001196411 0.002392822 0.004785645", NULL,
					NULL, NULL, 0, 0}}}},
		"0.001221730", "0.002392822", 104, "104.000", false},
	{"iio:lsm9ds1_gyro+lsm9ds1_accel, by timer", /* without a FIFO in the driver */
		{{"lsm9ds1_gyro", "14.900", "14.900 59.500 119.000 238.000 476.000 952.000", NULL, NO_TRIGGER,
			 {{IIO_ANGL_VEL, "0.000152716", "0.000152716 0.000305432 0.001221730", NULL, NULL, NULL, 0,
				 0}}},
			{"lsm9ds1_accel", "10.000", "10.000 50.000 119.000 238.000 476.000 952.000", NULL, NO_TRIGGER,
				{{IIO_ACCEL, "0.000598205", "0.000598205 0.001196411 0.002392822 0.007178468", NULL,
					NULL, NULL, 0, 0}}},
			{"lsm9ds1_magn", "1", "0.625 1.25 2.5 5 10 20 40 80", NULL, NO_TRIGGER,
				{{IIO_MAGN, "0.000146", "0.000146 0.000292 0.000438 0.000584", NULL, NULL, NULL, 0,
					0}}}},
		"0.001221730", "0.002392822", 100, "238.000", true},
	{"iio:icm20948+icm20948, by timer", /* of a driver outside the kernel */
		{{"icm20948", NULL, NULL, NULL, NO_TRIGGER,
			{{IIO_ACCEL, "0.000598550", "0.000598550 0.001197101 0.002394202 0.004788403", "112.500000",
				 NULL, NULL, 0, 0},
				{IIO_ANGL_VEL, "0.000133158", "0.000133158 0.000266316 0.000532632 0.001065264",
					"112.500000", NULL, NULL, 0, 0},
				{IIO_MAGN, "0.001500", NULL, "100.000000", NULL, "1, 0, 0; 0, -1, 0; 0, 0, -1", 0,
					0}}}},
		"0.001065264", "0.002394202", 100, "200", true},
	{"iio:adis16475-2+adis16475-2", /* 40 digits per deg/s and 4000 per g in the upper 16 of 32 bits */
		{{"adis16475-2", "2000.000000", NULL, NULL, OWN_TRIGGER,
			{{IIO_ANGL_VEL, "0.000000006", NULL, NULL, NULL, NULL, 32, 32},
				{IIO_ACCEL, "0.000000037", NULL, NULL, NULL, NULL, 32, 32}}}},
		"0.000000006", "0.000000037", 100, "100", false},
	{"iio:bno055+bno055", /* a range of rates */
		{{"bno055", "100", "[1 1 100]", NULL, OWN_TRIGGER,
			{{IIO_ACCEL, "0.010000", NULL, NULL, NULL, NULL, 0, 0},
				{IIO_ANGL_VEL, "0.001090830", NULL, NULL, NULL, NULL, 0, 0},
				{IIO_MAGN, "0.000625000", NULL, NULL, NULL, NULL, 0, 0}}}},
		"0.001090830", "0.010000", 100, "100", true},
	{"iio:le12of16+le12of16", /* twelve bits */
		{{"le12of16", "100", NULL, NULL, OWN_TRIGGER,
			{{IIO_ACCEL, "0.039227", NULL, NULL, NULL, NULL, 12, 16},
				{IIO_ANGL_VEL, "0.001221730", NULL, NULL, NULL, NULL, 0, 0}}}},
		"0.001221730", "0.039227", 100, "100", false},
};
enum { DESCRIPTION_COUNT = sizeof DESCRIPTIONS / sizeof *DESCRIPTIONS };

static void add_attr(struct attr *attrs, const char *name, const char *text)
{
	if (!text)
		return;
	while (attrs->name)
		attrs++;
	attrs->name = name;
	assert_in_range(strlen(text), 1, sizeof(attrs->text) - 1);
	strcpy(attrs->text, text);
}

static void show(const struct shown_device *shown)
{
	static struct iio_device own = {.id = "trigger0", .name = "own-dev0", .is_trigger = true};
	struct iio_device *d = add_device(shown->name, "", "");

	memset(d->attrs, 0, sizeof(d->attrs));
	add_attr(d->attrs, "sampling_frequency", shown->rate);
	add_attr(d->attrs, "sampling_frequency_available", shown->rates);
	add_attr(d->attrs, "in_mount_matrix", shown->mount); /* with the prefix that libiio gives it */
	add_attr(d->attrs, "current_timestamp_clock", "realtime");
	d->trigger_result = shown->trigger == FIFO ? -ENOENT : 0;
	d->trigger = shown->trigger == OWN_TRIGGER ? &own : NULL;
	for (size_t i = 0; i < 3 && shown->triads[i].scale; i++) {
		const struct shown_triad *t = &shown->triads[i];

		add_triad(d, t->type, t->scale, 3 * i);
		for (unsigned k = d->channel_count - 3; k < d->channel_count; k++) {
			struct iio_channel *c = &d->channels[k];

			if (t->length > 0)
				c->format = (struct iio_data_format){
					.length = t->length, .bits = t->bits, .is_signed = true};
			add_attr(c->attrs, "scale_available", t->scales);
			add_attr(c->attrs, "sampling_frequency", t->rate);
			add_attr(c->attrs, "sampling_frequency_available", t->rates);
			add_attr(c->attrs, "mount_matrix", t->mount);
		}
	}
	add_timestamp(d);
}

/* What the sensors measure, along the axes of the board: rad/s, m/s^2, gauss. */
static const double MEASURED[3][3] = {{0.3, -0.2, 0.1}, {1, -2, 9.80665}, {0.05, 0.2, -0.45}};
static int measurements;

static size_t quantity_of(const struct iio_channel *c)
{
	return c->type == IIO_ANGL_VEL ? 0 : c->type == IIO_ACCEL ? 1 : 2;
}

/* The value along an axis of the chip. The matrices used are their own inverses. */
static double along(const struct iio_device *d, const struct iio_channel *c)
{
	double m[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
	const double *v = MEASURED[quantity_of(c)], *row = m + 3 * (c->modifier - X);
	char text[160];

	if (get(c->attrs, "mount_matrix", text, sizeof(text)) > 0 ||
		get(d->attrs, "in_mount_matrix", text, sizeof(text)) > 0)
		assert_int_equal(sscanf(text, "%lf, %lf, %lf; %lf, %lf, %lf; %lf, %lf, %lf", &m[0], &m[1], &m[2], &m[3],
					 &m[4], &m[5], &m[6], &m[7], &m[8]),
			9);
	return row[0] * v[0] + row[1] * v[1] + row[2] * v[2];
}

/* Digits per unit: the reciprocal of the scale, or, where its print has one digit, of the data sheet's. */
static double digit_of(const struct iio_device *d, const struct iio_channel *c)
{
	char text[160];

	if (strcmp(d->name, "adis16475-2") == 0)
		return (c->type == IIO_ANGL_VEL ? M_PI / 180 / 40 : 9.80665 / 4000) / 65536;
	assert_true(get(c->attrs, "scale", text, sizeof(text)) > 0);
	return strtod(text, NULL);
}

static void scans_of_all(void)
{
	measurements++;
	for (unsigned i = 0; i < w.device_count; i++) {
		struct iio_device *d = &w.devices[i];
		struct scan *s = &d->scans[d->scan_count];

		if (!d->buffered)
			continue;
		*s = (struct scan){.t_ns = w.now_ns - 3 * MS};
		for (unsigned k = 0; k < d->channel_count; k++)
			if (d->channels[k].type != IIO_TIMESTAMP)
				s->words[d->channels[k].place] =
					(int64_t)floor(along(d, &d->channels[k]) / digit_of(d, &d->channels[k]) + 0.5) +
					(k < 6 ? measurements % 2 : 0); /* not frozen */
		d->scan_count++;
	}
}

static const char *attr_of(enum iio_chan_type type, const char *name)
{
	static char text[160];

	for (unsigned i = 0; i < w.device_count; i++)
		for (unsigned k = 0; k < w.devices[i].channel_count; k++)
			if (w.devices[i].channels[k].type == type &&
				(get(w.devices[i].channels[k].attrs, name, text, sizeof(text)) > 0 ||
					get(w.devices[i].attrs, name, text, sizeof(text)) > 0))
				return text;
	return "";
}

static void test_devices_as_the_kernels_drivers_show_them_give_samples_of_the_right_scale_axes_and_rate(void **state)
{
	(void)state;
	for (int i = 0; i < DESCRIPTION_COUNT; i++) {
		const struct description *d = &DESCRIPTIONS[i];
		struct imu_sample sample;
		int samples = 0, fields = 0;

		w = (struct world){.now_ns = 100000 * MS};
		for (size_t k = 0; k < 3 && d->devices[k].name; k++)
			show(&d->devices[k]);
		open_sensor("iio");
		assert_string_equal(port->name, d->name);
		assert_string_equal(port->notes, "");
		assert_near(port->rate_hz, d->rate_hz, 1e-6);
		assert_string_equal(attr_of(IIO_ANGL_VEL, "scale"), d->gyro_scale);
		assert_string_equal(attr_of(IIO_ACCEL, "scale"), d->accel_scale);
		assert_string_equal(attr_of(IIO_ACCEL, "sampling_frequency"), d->accel_rate);
		w.now_ns += 300 * MS;
		run(20, scans_of_all);
		for (; imu_read(port, &sample) == 1; samples++) {
			const double digit = strtod(d->accel_scale, NULL);

			assert_near(sample.gyro_rad_s.x, 0.3, 0.0025);
			assert_near(sample.gyro_rad_s.y, -0.2, 0.0025);
			assert_near(sample.gyro_rad_s.z, 0.1, 0.0025);
			assert_near(sample.accel_m_s2.x, 1, 2 * digit);
			assert_near(sample.accel_m_s2.y, -2, 2 * digit);
			assert_near(sample.accel_m_s2.z, 9.80665, 2 * digit);
			assert_int_equal(sample.flags & ~(unsigned)SAMPLE_MAG, 0);
			if (!(sample.flags & SAMPLE_MAG))
				continue;
			fields++;
			assert_near(sample.mag_uT.x, 5, 0.4);
			assert_near(sample.mag_uT.y, 20, 0.4);
			assert_near(sample.mag_uT.z, -45, 0.4);
		}
		if (samples < 15 || (fields > 10) != d->has_mag)
			fail_msg("%s: %d samples, %d with a field", d->name, samples, fields);
		imu_close(port);
		port = NULL;
	}
}

static void test_a_temperature_that_cannot_be_read_is_not_known(void **state)
{
	struct iio_device *motion = &w.devices[MOTION];
	struct iio_channel *c = &motion->channels[motion->channel_count++];
	struct imu_sample sample;
	int n = 0;

	(void)state;
	*c = (struct iio_channel){.type = IIO_TEMP, .raw = 512}; /* without a scale */
	open_sensor("iio");
	w.now_ns += 100 * MS;
	run(60, one_scan_of_each);
	for (; imu_read(port, &sample) == 1; n++)
		assert_int_equal(sample.flags & SAMPLE_TEMPERATURE, 0);
	assert_in_range(n, 40, 60);
}

/* ---- triggers ---------------------------------------------------------------------------------------------------- */

static void needs_trigger(int device)
{
	w.devices[device].trigger_result = 0; /* it can have one, and has none */
}

static void test_a_device_without_a_trigger_gets_a_timer_and_takes_twice_as_many_samples(void **state)
{
	(void)state;
	needs_trigger(MOTION);
	open_sensor("iio");
	assert_string_equal(port->name, "iio:lsm6dso+lsm6dso, by timer");
	assert_int_equal(w.made_count, 1);
	assert_string_equal(w.made[0], "/sys/kernel/config/iio/triggers/hrtimer/imu9-device0");
	assert_string_equal(w.devices[2].attrs[0].text, "100.000");
	assert_ptr_equal(w.devices[MOTION].trigger, &w.devices[2]);
	assert_string_equal(w.devices[MOTION].attrs[0].text, "208"); /* 200 asked for */
	assert_near(port->rate_hz, 100, 1e-9);
	assert_null(w.devices[MAGNETOMETER].trigger);
	imu_close(port);
	port = NULL;
	assert_int_equal(w.removed_count, 1);
	assert_string_equal(w.removed[0], w.made[0]);
	assert_null(w.devices[MOTION].trigger);
}

static void test_a_new_rate_is_that_of_the_timer_where_there_is_one(void **state)
{
	struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	char error[200] = "";

	(void)state;
	settings.rate_hz = 60;
	for (int timer = 0; timer < 2; timer++) {
		if (timer)
			needs_trigger(MOTION);
		open_sensor("iio");
		assert_int_equal(port->ops->configure(port, &settings, 0, error, sizeof(error)), 0);
		assert_near(port->rate_hz, timer ? 60 : 104, 1e-9);
		imu_close(port);
		port = NULL;
	}
}

/* A trigger serves two devices. */
static void test_a_magnetometer_of_its_own_has_a_timer_of_its_own(void **state)
{
	(void)state;
	needs_trigger(MOTION);
	needs_trigger(MAGNETOMETER);
	open_sensor("iio");
	assert_int_equal(w.made_count, 2);
	assert_string_equal(w.made[1], "/sys/kernel/config/iio/triggers/hrtimer/imu9-device0-mag");
	assert_ptr_equal(w.devices[MAGNETOMETER].trigger, &w.devices[3]);
}

static void test_a_trigger_of_its_own_is_kept_and_one_a_killed_gateway_left_is_not(void **state)
{
	static struct iio_device data_ready = {.id = "trigger9", .name = "lsm6dso-dev0", .is_trigger = true},
				 left = {.id = "trigger8", .name = "imu9-0", .is_trigger = true};

	(void)state;
	needs_trigger(MOTION);
	w.devices[MOTION].trigger = &data_ready;
	open_sensor("iio");
	assert_int_equal(w.made_count, 0);
	imu_close(port);
	port = NULL;
	w.devices[MOTION].trigger = &left;
	open_sensor("iio");
	assert_int_equal(w.made_count, 1);
}

/* The chip's newest sample is half of its interval of 208 Hz old, on average. */
static void test_a_reading_by_timer_is_half_an_interval_of_the_chip_old(void **state)
{
	struct imu_sample sample;

	(void)state;
	needs_trigger(MOTION);
	open_sensor("iio");
	w.now_ns += 100 * MS;
	run(1, one_scan_of_each);
	assert_int_equal(imu_read(port, &sample), 1);
	assert_near((double)sample.t_us, 1e-3 * (double)(w.now_ns - 20 * MS - 3 * MS) - 1e6 / 208 / 2, 1);
}

static void test_without_configfs_the_devices_are_polled(void **state)
{
	struct imu_sample sample;
	double rate_hz;

	(void)state;
	w.no_configfs = true;
	needs_trigger(MOTION);
	w.devices[MOTION].channels[0].raw = 1000;
	w.devices[MAGNETOMETER].channels[0].raw = 2000;
	open_sensor("iio");
	assert_string_equal(port->name, "iio:lsm6dso+lsm6dso, polled");
	rate_hz = port->rate_hz; /* a round of nine files of 1 ms, and a tenth in reserve */
	assert_near(rate_hz, 0.9e3 / 9, 1e-6);
	w.now_ns += 100 * MS;
	run(20, NULL);
	assert_int_equal(imu_read(port, &sample), 1);
	assert_near(sample.gyro_rad_s.x, 1000 * 0.001221731, 0.0013);
	assert_near(sample.mag_uT.x, 2000 * 0.0146156, 0.016);
	uint64_t first_us = sample.t_us;
	int more = 0;
	for (; imu_read(port, &sample) == 1; more++)
		;
	assert_true(more > 10);
	assert_near((double)(sample.t_us - first_us) / more, 10000, 500); /* the first round was late */
}

/* 100 readings a second are possible, see above. */
static void test_a_polled_device_has_the_rate_that_is_possible_at_most(void **state)
{
	struct imu_settings settings = IMU_SETTINGS_DEFAULTS;
	const double wanted_hz[] = {50, 208};
	char error[300] = "";

	(void)state;
	w.no_configfs = true;
	needs_trigger(MOTION);
	for (int i = 0; i < 2; i++) {
		settings.rate_hz = wanted_hz[i];
		assert_int_equal(imu_open("iio", &settings, &port, error, sizeof(error)), 0);
		assert_near(port->rate_hz, i ? 100 : 50, 1e-6);
		imu_close(port);
		port = NULL;
	}
	w.no_raw = true;
	assert_refused("iio", -EIO, "sysfs");
}

static void test_an_attribute_that_must_not_be_written_is_named_with_what_to_do(void **state)
{
	static const struct {
		const char *attribute, *words;
	} denied[] = {{"scale", "the range of lsm6dso"}, {"sampling_frequency", "the rate of lsm6dso"},
		{"current_timestamp_clock", "the clock of lsm6dso"}};

	(void)state;
	for (int i = 0; i < 6; i++) {
		w.devices[MOTION].channels[i].attrs[1] = (struct attr){.name = "scale_available"};
		strcpy(w.devices[MOTION].channels[i].attrs[1].text, i < 3 ? "0.001221" : "0.002393");
	}
	for (int i = 0; i < 3; i++) {
		w.denied = denied[i].attribute;
		assert_refused("iio", -EACCES, denied[i].words);
		assert_refused("iio", -EACCES, "run as root");
	}
}

static void test_a_buffer_that_cannot_be_had_is_named(void **state)
{
	(void)state;
	w.refused = KERNEL_BUFFERS;
	assert_refused("iio", -ENOMEM, "the buffer of lsm6dso");
	w.refused = BUFFER;
	assert_refused(
		"iio", -EBUSY, "the buffer of lsm6dso: Device or resource busy: another program reads it: stop that");
	w.refused = NOT_BLOCKING;
	assert_refused("iio", -ENOSYS, "the buffer of lsm6dso");
}

static void test_a_timer_that_the_kernel_does_not_make_is_named_with_its_module(void **state)
{
	(void)state;
	needs_trigger(MOTION);
	w.refused = TIMER;
	assert_refused("iio", -ENODEV, "did not create the timer trigger imu9-device0");
	w.made_count = 0;
	assert_refused("iio", -ENODEV, "modprobe iio-trig-hrtimer");
}

static void test_a_timer_that_could_not_be_made_is_not_removed(void **state)
{
	(void)state;
	w.no_configfs = true;
	needs_trigger(MOTION);
	open_sensor("iio");
	imu_close(port);
	port = NULL;
	assert_int_equal(w.removed_count, 0);
}

/* A reading fits into 64 bits; the kernel's formats have whole bytes. */
static void test_a_device_is_read_by_its_buffer_if_its_values_have_one_to_eight_bytes(void **state)
{
	static const unsigned bits[] = {0, 7, 8, 16, 32, 64, 65, 128};

	(void)state;
	for (size_t i = 0; i < sizeof(bits) / sizeof(bits[0]); i++) {
		bool fits = bits[i] >= 8 && bits[i] <= 64;

		for (int channel = 0; channel < 6; channel++)
			w.devices[MOTION].channels[channel].format.length = bits[i];
		open_sensor("iio");
		assert_int_equal(w.devices[MOTION].buffered, fits);
		assert_string_equal(port->name, fits ? "iio:lsm6dso+lsm6dso" : "iio:lsm6dso+lsm6dso, polled");
		imu_close(port);
		port = NULL;
	}
}

static void only_motion(void)
{
	static const int16_t motion[6] = {1, 2, 3, 4, 5, 6};

	put_scan(MOTION, w.now_ns - MS, motion);
}

static void test_a_magnetometer_without_a_trigger_is_polled_and_the_others_are_not(void **state)
{
	struct imu_sample sample;
	int samples = 0, fields = 0;

	(void)state;
	w.no_configfs = true;
	needs_trigger(MAGNETOMETER);
	w.devices[MAGNETOMETER].channels[0].raw = 2000;
	open_sensor("iio");
	assert_string_equal(port->name, "iio:lsm6dso+lsm6dso");
	assert_near(port->rate_hz, 104, 1e-9);
	assert_true(w.devices[MOTION].buffered && !w.devices[MAGNETOMETER].buffered);
	w.now_ns += 100 * MS;
	run(20, only_motion);
	for (; imu_read(port, &sample) == 1; samples++) {
		if (!(sample.flags & SAMPLE_MAG))
			continue;
		assert_near(sample.mag_uT.x, 2000 * 0.0146156, 0.016);
		fields++;
	}
	assert_in_range(samples, 15, 20);
	assert_in_range(fields, 10, samples);
}

/* Four scans wait after every other step of 20 ms: 100 a second. */
static void batches_of_four(void)
{
	static int16_t turn;

	turn++;
	for (int i = 0; i < 4 && w.steps % 2; i++) {
		const int16_t motion[6] = {(int16_t)(turn * 4 + i), 2, 3, 4, 5, 6};

		put_scan(MOTION, 0, motion);
	}
}

static void test_without_time_stamps_the_scans_of_a_batch_are_even(void **state)
{
	struct imu_sample sample;
	uint64_t last_us = 0;
	int n = 0;

	(void)state;
	w.devices[MOTION].channel_count--;	/* the timestamp */
	w.devices[MOTION].attrs[1].name = NULL; /* no list of rates: 100 Hz is set */
	open_sensor("iio:lsm6dso");
	run(100, batches_of_four);
	for (; imu_read(port, &sample) == 1; n++) {
		if (n > 30)
			assert_in_range(sample.t_us - last_us, 8000, 12000);
		last_us = sample.t_us;
	}
	assert_in_range(n, 150, 200);
	assert_true((double)last_us > 1e-3 * (double)w.now_ns - 80000);
}

/* The chip samples twice as fast as its timer, which gives the rate of the scans. */
static void test_without_time_stamps_the_scans_of_a_timer_have_its_rate(void **state)
{
	struct imu_sample sample;
	uint64_t last_us = 0;
	int n = 0;

	(void)state;
	w.devices[MOTION].channel_count--; /* the timestamp */
	needs_trigger(MOTION);
	open_sensor("iio:lsm6dso");
	assert_string_equal(port->name, "iio:lsm6dso+lsm6dso, by timer");
	run(100, batches_of_four);
	for (; imu_read(port, &sample) == 1; n++) {
		if (n > 30)
			assert_in_range(sample.t_us - last_us, 8000, 12000);
		last_us = sample.t_us;
	}
	assert_in_range(n, 150, 200);
}

/* ---- faults ------------------------------------------------------------------------------------------------------ */

static int next_result(void)
{
	struct imu_sample sample;

	return imu_read(port, &sample);
}

/* The last of all that is there. */
static int last_result(void)
{
	int last = 0;

	for (int result; (result = next_result()) != 0;)
		last = result;
	return last;
}

static void gone(void)
{
	w.devices[MOTION].refill_error = ENODEV;
}

static void test_a_device_that_is_gone_is_silent_and_opened_again(void **state)
{
	(void)state;
	open_sensor("iio");
	w.now_ns += 100 * MS;
	run(1, gone);
	assert_int_equal(next_result(), -EIO);
	assert_int_equal(port->health.fault, IMU_FAULT_SILENT);
	assert_int_equal(port->health.fault_chip, IMU_CHIP_GYRO);
	w.devices[MOTION].refill_error = 0;
	w.now_ns += 100 * MS;
	run(10, one_scan_of_each);
	assert_int_equal(last_result(), 1);
	assert_int_equal(port->health.fault, IMU_FAULT_NONE);
	assert_int_equal(port->health.bus_errors, 1);
}

static void ended(void)
{
	w.devices[MOTION].refill_error = END;
}

static void test_a_buffer_at_its_end_is_that_of_a_sensor_that_has_gone(void **state)
{
	(void)state;
	open_sensor("iio");
	w.now_ns += 100 * MS;
	run(1, ended);
	assert_int_equal(next_result(), -EIO);
	assert_int_equal(port->health.fault, IMU_FAULT_SILENT);
}

static int scans_left;

static void scans(void)
{
	if (scans_left-- > 0)
		one_scan_of_each();
}

static void test_a_device_without_samples_for_100_ms_has_stopped(void **state)
{
	(void)state;
	open_sensor("iio");
	scans_left = 1;
	run(5, scans); /* the wait that ends it is the fifth of 20 ms behind the scan */
	assert_int_equal(last_result(), 0);
	scans_left = 1;
	run(6, scans);
	assert_int_equal(last_result(), -EIO);
	assert_int_equal(port->health.fault, IMU_FAULT_STOPPED);
	assert_int_equal(port->health.fault_chip, IMU_CHIP_GYRO);
}

/* A gyro with noise; then it repeats itself. */
static int16_t noise;
static bool repeats;

static void noisy_scan(void)
{
	const int16_t words[6] = {noise, (int16_t)(noise * 3 % 17), (int16_t)(noise * 5 % 23), 4096, 1, noise};

	if (!repeats)
		noise = (int16_t)((noise * 7 + 5) % 101);
	put_scan(MOTION, w.now_ns - MS, words);
}

static void test_a_gyro_that_repeats_its_values_is_frozen(void **state)
{
	(void)state;
	open_sensor("iio");
	noise = 1;
	repeats = false;
	w.now_ns += 100 * MS;
	run(100, noisy_scan);
	assert_int_equal(last_result(), 1);
	assert_int_equal(port->health.fault, IMU_FAULT_NONE);
	repeats = true;
	run(28, noisy_scan);
	assert_int_equal(port->health.fault, IMU_FAULT_NONE);
	run(10, noisy_scan);
	assert_int_equal(last_result(), -EIO);
	assert_int_equal(port->health.fault, IMU_FAULT_FROZEN);
	assert_int_equal(port->health.fault_chip, IMU_CHIP_GYRO);
}

static void test_a_timer_is_removed_once(void **state)
{
	(void)state;
	needs_trigger(MOTION);
	open_sensor("iio");
	w.now_ns += 100 * MS;
	run(1, gone);
	assert_int_equal(w.removed_count, 1);
	imu_close(port);
	port = NULL;
	assert_int_equal(w.removed_count, 1);
}

static void test_a_device_that_starts_up_has_a_second_for_it(void **state)
{
	(void)state;
	open_sensor("iio");
	run(49, NULL);
	assert_int_equal(last_result(), 0);
	run(50, NULL);
	assert_int_equal(last_result(), -EIO);
	assert_int_equal(port->health.fault, IMU_FAULT_STOPPED);
}

static void test_samples_go_on_without_a_magnetometer_that_has_stopped(void **state)
{
	struct imu_sample sample;
	int n = 0;

	(void)state;
	open_sensor("iio");
	run(52, only_motion); /* it has a second to start */
	while (imu_read(port, &sample) == 1)
		n++;
	assert_in_range(n, 47, 50);
	assert_int_equal(port->health.fault, IMU_FAULT_NONE);
	assert_int_equal(port->health.degraded, IMU_FAULT_STOPPED);
	assert_int_equal(port->health.degraded_chip, IMU_CHIP_MAG);
}

static void test_a_magnetometer_that_was_removed_is_used_again_when_it_is_back(void **state)
{
	struct imu_sample sample;
	bool had_field = false;

	(void)state;
	open_sensor("iio");
	w.devices[MAGNETOMETER].hidden = true;
	w.now_ns += 100 * MS;
	run(3, only_motion); /* begins again, without it */
	w.now_ns += 100 * MS;
	run(10, only_motion);
	while (imu_read(port, &sample) == 1)
		;
	assert_int_equal(port->health.degraded, IMU_FAULT_SILENT);
	assert_int_equal(port->health.degraded_chip, IMU_CHIP_MAG);
	w.devices[MAGNETOMETER].hidden = false;
	w.now_ns += 2000 * MS;
	run(20, one_scan_of_each);
	for (int result; (result = imu_read(port, &sample)) != 0;)
		had_field |= result == 1 && (sample.flags & SAMPLE_MAG) != 0;
	assert_true(had_field);
	assert_int_equal(port->health.degraded, IMU_FAULT_NONE);
	assert_int_equal(port->health.degraded_chip, 0);
}

static void magnetometer_comes_back(void)
{
	if (w.now_ns > 103000 * MS)
		w.devices[MAGNETOMETER].hidden = false;
	if (w.devices[MAGNETOMETER].buffered)
		one_scan_of_each();
	else
		only_motion();
}

/* It is looked for every 2 s. */
static void test_the_capture_starts_again_when_the_magnetometer_is_back(void **state)
{
	struct imu_sample sample;
	unsigned flags = 0;

	(void)state;
	open_sensor("iio");
	w.devices[MAGNETOMETER].hidden = true;
	run(1, only_motion);
	w.now_ns = 102000 * MS;
	run(30, magnetometer_comes_back); /* it is back from 103 s on only */
	while (imu_read(port, &sample) != 0)
		flags |= sample.flags;
	assert_int_equal(flags & SAMPLE_MAG, 0);
	run(150, magnetometer_comes_back); /* 3 s */
	while (imu_read(port, &sample) != 0)
		flags |= sample.flags;
	assert_int_equal(flags & SAMPLE_MAG, SAMPLE_MAG);
}

static void only_the_gyro(void)
{
	const int16_t gyro[6] = {(int16_t)w.steps, 2, 3}; /* not frozen */

	put_scan(2, w.now_ns - MS, gyro);
}

static void both(void)
{
	static const int16_t accel[6] = {4, 5, 6};

	only_the_gyro();
	put_scan(3, w.now_ns - MS, accel);
}

static void test_an_accelerometer_of_its_own_that_stops_is_named(void **state)
{
	struct iio_device *d;

	(void)state;
	d = add_device("l3gd20", "95", "95 190");
	add_triad(d, IIO_ANGL_VEL, "0.00122", 0);
	add_timestamp(d);
	d = add_device("lsm303", "100", "100 200");
	add_triad(d, IIO_ACCEL, "0.0024", 0);
	add_timestamp(d);
	open_sensor("iio:l3gd20,lsm303");
	assert_string_equal(port->name, "iio:l3gd20+lsm303");
	w.now_ns += 100 * MS;
	run(20, both);
	assert_int_equal(last_result(), 1);
	assert_int_equal(port->health.fault, IMU_FAULT_NONE);
	run(60, only_the_gyro); /* each run begins again, with a second to start */
	assert_int_equal(last_result(), -EIO);
	assert_int_equal(port->health.fault, IMU_FAULT_STOPPED);
	assert_int_equal(port->health.fault_chip, IMU_CHIP_ACCEL);
}

static void test_a_gyro_that_does_not_come_back_is_reported_each_time(void **state)
{
	(void)state;
	open_sensor("iio");
	w.now_ns += 100 * MS;
	run(1, gone);
	assert_int_equal(last_result(), -EIO);
	w.devices[MOTION].hidden = true;
	run(3, NULL);
	assert_int_equal(last_result(), -EIO);
	assert_int_equal(port->health.fault, IMU_FAULT_SILENT);
	assert_int_equal(port->health.fault_chip, IMU_CHIP_GYRO);
	assert_true(port->health.bus_errors > 1);
}

/* A timer reads both, of which one has measured 3.75 ms earlier on average: the later one is not waited for. */
static void test_readings_by_timer_belong_together_within_half_an_interval_of_the_slower_chip(void **state)
{
	struct imu_sample sample;

	(void)state;
	add_triad(add_device("l3gd20", "400", "400"), IIO_ANGL_VEL, "0.00122", 0);
	add_triad(add_device("lsm303", "100", "100"), IIO_ACCEL, "0.0024", 0);
	for (int device = 2; device < 4; device++) {
		add_timestamp(&w.devices[device]);
		needs_trigger(device);
	}
	open_sensor("iio:l3gd20,lsm303");
	w.now_ns += 100 * MS;
	run(1, both);
	assert_int_equal(imu_read(port, &sample), 1);
	assert_near(sample.accel_m_s2.x, 4 * 0.0024, 1e-9);
}

static void first_the_gyro_alone(void)
{
	if (scans_left-- > 0)
		only_the_gyro();
	else
		both();
}

static void test_readings_of_the_gyro_before_the_first_acceleration_are_counted_as_lost(void **state)
{
	(void)state;
	add_triad(add_device("l3gd20", "100", "100"), IIO_ANGL_VEL, "0.00122", 0);
	add_triad(add_device("lsm303", "100", "100"), IIO_ACCEL, "0.0024", 0);
	add_timestamp(&w.devices[2]);
	add_timestamp(&w.devices[3]);
	open_sensor("iio:l3gd20,lsm303");
	w.now_ns += 100 * MS;
	scans_left = 3;
	run(8, first_the_gyro_alone);
	assert_int_equal(last_result(), 1);
	assert_int_equal(port->health.overruns, 3);
}

static void test_an_accelerometer_without_a_trigger_is_polled_and_the_gyro_is_not(void **state)
{
	(void)state;
	w.no_configfs = true;
	add_triad(add_device("l3gd20", "100", "100"), IIO_ANGL_VEL, "0.00122", 0);
	add_triad(add_device("lsm303", "100", "100"), IIO_ACCEL, "0.0024", 0);
	add_timestamp(&w.devices[2]);
	add_timestamp(&w.devices[3]);
	needs_trigger(3);
	open_sensor("iio:l3gd20,lsm303");
	assert_string_equal(port->name, "iio:l3gd20+lsm303");
	assert_true(w.devices[2].buffered && !w.devices[3].buffered);
}

int main(void)
{
#define IIO_TEST(f) cmocka_unit_test_setup_teardown(f, set_up, tear_down)
	const struct CMUnitTest tests[] = {
		IIO_TEST(test_devices_are_found_by_their_channels_and_set_up),
		IIO_TEST(test_the_smallest_range_that_is_wide_enough_is_set),
		IIO_TEST(test_settings_that_the_devices_do_not_support_are_refused),
		IIO_TEST(test_a_sensor_that_is_missing_or_there_twice_is_refused),
		IIO_TEST(test_without_a_magnetometer_the_others_are_enough),
		IIO_TEST(test_a_mount_matrix_that_is_not_a_rotation_is_refused),
		IIO_TEST(test_a_mount_matrix_that_mirrors_is_used_and_told),
		IIO_TEST(test_the_mount_matrix_of_a_device_has_the_prefix_in),
		IIO_TEST(test_a_rate_without_a_list_is_set),
		IIO_TEST(test_a_scale_of_one_digit_is_that_of_the_known_chip),
		IIO_TEST(test_without_time_stamps_the_scans_of_a_batch_are_even),
		IIO_TEST(test_without_time_stamps_the_scans_of_a_timer_have_its_rate),
		IIO_TEST(test_a_magnetometer_without_a_trigger_is_polled_and_the_others_are_not),
		IIO_TEST(test_a_scan_becomes_a_sample_with_scale_offset_and_mounting),
		IIO_TEST(test_readings_of_a_chip_that_has_just_been_set_up_are_dropped),
		IIO_TEST(test_devices_as_the_kernels_drivers_show_them_give_samples_of_the_right_scale_axes_and_rate),
		IIO_TEST(test_a_value_at_the_end_of_its_range_is_flagged_on_every_axis),
		IIO_TEST(test_a_sample_has_the_temperature_once_a_second),
		IIO_TEST(test_a_temperature_without_an_offset_is_the_scaled_reading),
		IIO_TEST(test_a_temperature_that_cannot_be_read_is_not_known),
		IIO_TEST(test_a_device_without_a_trigger_gets_a_timer_and_takes_twice_as_many_samples),
		IIO_TEST(test_a_new_rate_is_that_of_the_timer_where_there_is_one),
		IIO_TEST(test_a_magnetometer_of_its_own_has_a_timer_of_its_own),
		IIO_TEST(test_a_trigger_of_its_own_is_kept_and_one_a_killed_gateway_left_is_not),
		IIO_TEST(test_a_reading_by_timer_is_half_an_interval_of_the_chip_old),
		IIO_TEST(test_without_configfs_the_devices_are_polled),
		IIO_TEST(test_a_polled_device_has_the_rate_that_is_possible_at_most),
		IIO_TEST(test_an_attribute_that_must_not_be_written_is_named_with_what_to_do),
		IIO_TEST(test_a_gyro_that_repeats_its_values_is_frozen),
		IIO_TEST(test_a_timer_is_removed_once),
		IIO_TEST(test_a_buffer_that_cannot_be_had_is_named),
		IIO_TEST(test_a_timer_that_the_kernel_does_not_make_is_named_with_its_module),
		IIO_TEST(test_a_timer_that_could_not_be_made_is_not_removed),
		IIO_TEST(test_a_device_is_read_by_its_buffer_if_its_values_have_one_to_eight_bytes),
		IIO_TEST(test_a_device_that_is_gone_is_silent_and_opened_again),
		IIO_TEST(test_a_buffer_at_its_end_is_that_of_a_sensor_that_has_gone),
		IIO_TEST(test_a_device_without_samples_for_100_ms_has_stopped),
		IIO_TEST(test_a_device_that_starts_up_has_a_second_for_it),
		IIO_TEST(test_samples_go_on_without_a_magnetometer_that_has_stopped),
		IIO_TEST(test_a_magnetometer_that_was_removed_is_used_again_when_it_is_back),
		IIO_TEST(test_the_capture_starts_again_when_the_magnetometer_is_back),
		IIO_TEST(test_an_accelerometer_of_its_own_that_stops_is_named),
		IIO_TEST(test_a_gyro_that_does_not_come_back_is_reported_each_time),
		IIO_TEST(test_readings_of_the_gyro_before_the_first_acceleration_are_counted_as_lost),
		IIO_TEST(test_an_accelerometer_without_a_trigger_is_polled_and_the_gyro_is_not),
		IIO_TEST(test_readings_by_timer_belong_together_within_half_an_interval_of_the_slower_chip),
	};

	return cmocka_run_group_tests_name("imu_iio", tests, count_descriptors, no_descriptor_is_left);
}
