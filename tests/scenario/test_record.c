/* A recording gives all that went out again: the device runs with simulated chips in simulated time, what it sends is
 * compared with what the replay of its files sends. Files, their rotation, power cuts and full disks are real. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "gateway/device_state.h"
#include "gateway/log.h"
#include "drivers/imu/imu_log.h"
#include "gateway/record_file.h"
#include "gateway/reload.h"
#include "model/sim/sensor.h"
#include "od/little_endian.h"
#include "tests/unit/descriptors.h"
#include "tools/replay/recording.h"

enum { NODE = 16, RATE_HZ = 50, SLOW_HZ = 25 };

static unsigned syncs;	   /* of files; that takes too long here */
static bool takes_parts;   /* of what is written */
static bool takes_nothing; /* as some full disks */
static int lock_errno;	   /* of a file system without locks */
static bool no_thread;
static atomic_uint turns, turns_until; /* of the thread, which waits for no time; 0: as long as it takes */

int fdatasync(int fd)
{
	(void)fd;
	syncs++;
	return 0;
}

ssize_t write(int fd, const void *bytes, size_t size)
{
	static unsigned calls;

	if (takes_nothing && size > 100)
		return 0;
	if (!takes_parts || size < 100)
		return syscall(SYS_write, fd, bytes, size);
	if (++calls % 4)
		return syscall(SYS_write, fd, bytes, size / 3);
	errno = EINTR; /* a signal */
	return -1;
}

int flock(int fd, int operation)
{
	errno = lock_errno;
	return lock_errno ? -1 : (int)syscall(SYS_flock, fd, operation);
}

int pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*body)(void *), void *arg)
{
	int (*create)(pthread_t *, const pthread_attr_t *, void *(*)(void *), void *);

	*(void **)&create = dlsym(RTLD_NEXT, "pthread_create");
	return no_thread ? EAGAIN : create(thread, attributes, body, arg);
}

int nanosleep(const struct timespec *duration, struct timespec *left)
{
	if (turns_until == 0)
		return (int)syscall(SYS_nanosleep, duration, left);
	if (duration->tv_sec != 0 || duration->tv_nsec != 100000000)
		abort();
	turns++;
	while (turns >= turns_until)
		sched_yield();
	return 0;
}

/* ---- frames that were sent --------------------------------------------------------------------------------------- */

struct sent {
	uint64_t now_us;
	uint32_t id;
	uint8_t len, data[8];
};

struct frames {
	struct sent *frame;
	size_t count, room;
};

static void add_frame(struct frames *f, const struct can_msg *msg, uint64_t now_us)
{
	if (f->count == f->room) {
		f->room = f->room ? 2 * f->room : 4096;
		f->frame = realloc(f->frame, f->room * sizeof(*f->frame));
		assert_non_null(f->frame);
	}
	struct sent *s = &f->frame[f->count++];

	memset(s, 0, sizeof(*s));
	s->now_us = now_us;
	s->id = msg->id;
	s->len = msg->len;
	memcpy(s->data, msg->data, msg->len);
}

/* Of all values of the dictionary, and of the pipeline's output. */
static uint64_t hash_of(const struct device *d)
{
	enum { OUTPUT = offsetof(struct pipeline_output, status) + sizeof(unsigned) /* its last member */ };
	uint64_t words[(sizeof(d->values) + OUTPUT) / sizeof(uint64_t) + 1] = {0}, hash = 0;

	memcpy(words, &d->values, sizeof(d->values));
	memcpy((uint8_t *)words + sizeof(d->values), &d->pipeline.last_good, OUTPUT);
	for (size_t i = 0; i < sizeof(words) / sizeof(words[0]); i++)
		hash = (hash ^ words[i]) * 0x9E3779B97F4A7C15u + (hash >> 29);
	return hash;
}

struct hashes {
	uint64_t *hash; /* after each sample */
	size_t count, room;
};

static void add_hash(struct hashes *h, const struct device *d)
{
	if (h->count == h->room) {
		h->room = h->room ? 2 * h->room : 4096;
		h->hash = realloc(h->hash, h->room * sizeof(*h->hash));
		assert_non_null(h->hash);
	}
	h->hash[h->count++] = hash_of(d);
}

/* ---- the device and what is around it ---------------------------------------------------------------------------- */

struct site {
	struct can_port bus; /* first */
	struct imu_port imu;
	struct device device;
	struct record record;
	struct record_file file;
	bool recording, threaded;
	struct sensor sensor;
	struct store_image disk;
	struct frames sent;
	struct hashes values;
	uint64_t now_us, deadline_us, next_sample_us, interval_us;
	bool sensor_silent, late_disk, drop_next;
	unsigned turns;
	char folder[64];
};

static int bus_send(struct can_port *port, const struct can_msg *msg)
{
	struct site *s = (struct site *)port;

	add_frame(&s->sent, msg, s->now_us);
	if (!s->drop_next)
		return 0;
	s->drop_next = false;
	return -EIO; /* the adapter has lost it */
}

static int bus_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port, (void)ids, (void)n;
	return 0;
}

/* Frames of all nodes, as SocketCAN shows them. */
static void bus_refresh(struct can_port *port)
{
	port->traffic.frames += 700;
	port->traffic.bytes += 4900;
	port->bit_s = 250000;
}

/* Supports rates up to 400 Hz. */
static int imu_configure(
	struct imu_port *port, const struct imu_settings *settings, int dry, char *error, size_t error_size)
{
	(void)port, (void)dry;
	snprintf(error, error_size, "at most 400 Hz");
	return settings->rate_hz > 400 ? -EINVAL : 0;
}

/* Half of the saves take a while. */
static int save(void *ctx, const uint8_t *bytes, size_t size)
{
	struct site *s = ctx;

	assert_int_equal(store_decode(&s->disk, bytes, size), 0);
	s->late_disk = !s->late_disk;
	return s->late_disk ? -EINPROGRESS : 0;
}

static void power_on(struct site *s, const char *const *settings, const struct record_options *options)
{
	static const struct can_ops bus_ops = {.send = bus_send, .filter = bus_filter, .refresh = bus_refresh};
	static const struct imu_ops imu_ops = {.configure = imu_configure};
	const struct storing_port storage = {.ctx = s, .save = save};
	static struct config config;
	char why[CONFIG_ERROR_MAX];

	s->bus = (struct can_port){.ops = &bus_ops, .fd = -1, .name = "can0"};
	s->imu = (struct imu_port){
		.ops = &imu_ops, .rate_hz = 1e6 / (double)s->interval_us, .silence_us = 100000, .name = "chips"};
	memset(&s->device, 0, sizeof(s->device));
	config_init(&config, &imu9_od_table);
	for (; settings && *settings; settings++)
		assert_int_equal(config_set(&config, *settings, why), 0);
	od_init(&s->device.od, &imu9_od_table, &s->device.values, NODE);
	config_apply(&config, &s->device.od);
	assert_int_equal(device_init(&s->device, &s->bus, &s->imu, &storage, &s->disk, NODE), 0);
	if (options) {
		assert_int_equal(record_open(&s->record), 0);
		int rc = s->threaded ? record_file_open(&s->file, &s->record, options)
				     : record_file_init(&s->file, &s->record, options);
		assert_int_equal(rc, 0);
		record_attach(&s->record, &s->device);
	}
	s->recording = options;
	s->late_disk = false;
	device_start(&s->device, false, s->now_us);
	s->deadline_us = s->now_us;
	s->next_sample_us = s->now_us + s->interval_us;
}

static void power_off(struct site *s)
{
	if (s->recording) {
		record_file_close(&s->file);
		record_close(&s->record);
	}
	s->recording = false;
}

static struct record_options options_of(const struct site *s, unsigned size_mb, unsigned files)
{
	struct record_options options = {.size_mb = size_mb, .files = files};

	strcpy(options.folder, s->folder);
	return options;
}

static struct site *new_site(unsigned rate_hz)
{
	struct sensor_config config = *sensor_preset("lsm303dlhc_l3gd20");
	struct site *s = calloc(1, sizeof(*s));

	assert_non_null(s);
	config.rate_hz = rate_hz;
	s->interval_us = 1000000 / rate_hz;
	config.warming_K = 10;
	assert_int_equal(sensor_init(&s->sensor, &config, 7), 0);
	strcpy(s->folder, "/tmp/imu9-record-XXXXXX");
	assert_non_null(mkdtemp(s->folder));
	s->now_us = 5000000000;
	return s;
}

static size_t files_of(const struct site *s, char names[][64], size_t most)
{
	DIR *folder = opendir(s->folder);
	const struct dirent *entry;
	size_t n = 0;

	assert_non_null(folder);
	while ((entry = readdir(folder)) != NULL) {
		if (entry->d_name[0] == '.')
			continue;
		assert_true(n < most);
		snprintf(names[n++], 64, "%.63s", entry->d_name);
	}
	closedir(folder);
	qsort(names, n, 64, (int (*)(const void *, const void *))strcmp);
	return n;
}

static void remove_files(const struct site *s)
{
	static char names[2000][64];
	char path[160];

	for (size_t n = files_of(s, names, 2000); n > 0; n--) {
		snprintf(path, sizeof(path), "%s/%s", s->folder, names[n - 1]);
		unlink(path);
	}
}

static int set_up(void **state)
{
	*state = new_site(RATE_HZ);
	return 0;
}

static int set_up_slow(void **state)
{
	*state = new_site(SLOW_HZ);
	return 0;
}

static int tear_down(void **state)
{
	struct site *s = *state;

	power_off(s);
	remove_files(s);
	rmdir(s->folder);
	free(s->sent.frame);
	free(s->values.hash);
	free(s);
	return 0;
}

/* ---- time -------------------------------------------------------------------------------------------------------- */

static void tick(struct site *s)
{
	s->deadline_us = device_tick(&s->device, s->now_us);
	if (s->recording && !s->threaded && ++s->turns % 8 == 0)
		record_file_turn(&s->file);
}

static void deliver(struct site *s, const struct imu_sample *sample)
{
	s->imu.counters.samples++;
	device_sample(&s->device, 1, sample, s->now_us);
	add_hash(&s->values, &s->device);
	tick(s);
}

static void next_sample(struct site *s)
{
	struct imu_sample sample;

	s->next_sample_us += s->interval_us;
	sensor_next(&s->sensor, signal_find("square"), &sample, NULL);
	sample.t_us = s->now_us - 1000;
	if (!s->sensor_silent)
		deliver(s, &sample);
}

/* The loop of the process. */
static void run_until(struct site *s, uint64_t until_us)
{
	for (;;) {
		uint64_t next_us = s->deadline_us < s->next_sample_us ? s->deadline_us : s->next_sample_us;

		if (next_us > until_us)
			break;
		s->now_us = next_us > s->now_us ? next_us : s->now_us;
		if (s->now_us >= s->next_sample_us)
			next_sample(s);
		else
			tick(s);
	}
	s->now_us = until_us;
}

static void receive_at(struct site *s, uint32_t id, size_t len, const void *data, uint64_t waited_us)
{
	struct can_msg msg = {.id = id, .len = (uint8_t)len, .t_us = s->now_us - waited_us};

	if (len)
		memcpy(msg.data, data, len);
	s->bus.counters.rx++;
	device_receive(&s->device, &msg, s->now_us);
	tick(s);
}

static void receive(struct site *s, uint32_t id, size_t len, const void *data)
{
	receive_at(s, id, len, data, 0);
}

/* `seconds` of a bus with a master that sends SYNC at 10 Hz. */
static void run(struct site *s, double seconds)
{
	uint64_t end_us = s->now_us + (uint64_t)(seconds * 1e6);

	while (s->now_us + 100000 <= end_us) {
		run_until(s, s->now_us + 100000);
		receive_at(s, 0x080, 0, NULL, s->now_us / 100000 % 7 * 10);
	}
	run_until(s, end_us);
}

static void nmt(struct site *s, uint8_t command)
{
	receive(s, 0x000, 2, (const uint8_t[]){command, NODE});
	run_until(s, s->now_us + 20000);
}

/* Expedited; the abort code or 0. */
static uint32_t write_value(struct site *s, uint16_t index, uint8_t sub, const void *value, size_t size)
{
	uint8_t request[8] = {(uint8_t)(0x23 | (4 - size) << 2), (uint8_t)index, (uint8_t)(index >> 8), sub};

	memcpy(request + 4, value, size);
	receive(s, 0x600 + NODE, 8, request);
	for (size_t i = s->sent.count; i-- > 0;)
		if (s->sent.frame[i].id == 0x580 + NODE)
			return s->sent.frame[i].data[0] == 0x80 ? get_u32(s->sent.frame[i].data + 4) : 0;
	return 0;
}

static uint32_t write_u8(struct site *s, uint16_t index, uint8_t sub, uint8_t value)
{
	return write_value(s, index, sub, &value, 1);
}

static uint32_t write_real(struct site *s, uint16_t index, uint8_t sub, float value)
{
	return write_value(s, index, sub, &value, 4);
}

static void expect_write(uint32_t abort_code)
{
	assert_int_equal(abort_code, 0);
}

/* ---- comparing --------------------------------------------------------------------------------------------------- */

static struct frames replayed;
static struct hashes replayed_values;

static void on_sample(void *ctx, const struct device *d)
{
	add_hash(&replayed_values, d);
	++*(unsigned *)ctx;
}

static void on_frame(void *ctx, const char *bus, const struct can_msg *msg, uint64_t now_us)
{
	(void)ctx;
	assert_string_equal(bus, "can0");
	add_frame(&replayed, msg, now_us);
}

/* The number of samples. */
static unsigned replay_file(const struct site *s, const char *name, bool good)
{
	static struct config unchanged;
	unsigned samples = 0;
	const struct recording_events events = {.ctx = &samples, .sample = on_sample, .frame = on_frame};
	char path[160];

	config_init(&unchanged, &imu9_od_table);
	snprintf(path, sizeof(path), "%s/%s", s->folder, name);
	assert_true(recording_is(path));
	assert_int_equal(recording_replay(path, &unchanged, &events), good);
	return samples;
}

static void forget_replayed(void)
{
	replayed.count = replayed_values.count = 0;
}

/* All files, one after the other: each begins with its state. */
static unsigned replay_all(const struct site *s)
{
	static char names[2000][64];
	size_t n = files_of(s, names, 2000);
	unsigned samples = 0;

	forget_replayed();
	for (size_t i = 0; i < n; i++)
		samples += replay_file(s, names[i], true);
	return samples;
}

static void assert_same_frames(const struct frames *sent, size_t from)
{
	for (size_t i = 0; i < replayed.count && from + i < sent->count; i++)
		if (memcmp(&replayed.frame[i], &sent->frame[from + i], sizeof(struct sent)) != 0)
			fail_msg("frame %zu differs: %03X at %llu us was %03X at %llu us", i, replayed.frame[i].id,
				(unsigned long long)replayed.frame[i].now_us, sent->frame[from + i].id,
				(unsigned long long)sent->frame[from + i].now_us);
	assert_int_equal(replayed.count, sent->count - from);
}

static void assert_same_values(const struct hashes *values, size_t from)
{
	for (size_t i = 0; i < replayed_values.count && from + i < values->count; i++)
		if (replayed_values.hash[i] != values->hash[from + i])
			fail_msg("a value of sample %zu differs", i);
	assert_int_equal(replayed_values.count, values->count - from);
}

static unsigned count_of(const struct frames *f, uint32_t id)
{
	unsigned n = 0;

	for (size_t i = 0; i < f->count; i++)
		n += f->frame[i].id == id;
	return n;
}

static unsigned emcys(const struct frames *f, uint16_t code)
{
	unsigned n = 0;

	for (size_t i = 0; i < f->count; i++)
		n += f->frame[i].id == 0x080 + NODE && get_u16(f->frame[i].data) == code;
	return n;
}

/* ---- the hour ---------------------------------------------------------------------------------------------------- */

static void velocity_aid(struct site *s, int16_t x_mm_s, int16_t sigma_mm_s)
{
	uint8_t data[8] = {0};

	put_u16(data, (uint16_t)x_mm_s);
	put_u16(data + 6, (uint16_t)sigma_mm_s);
	receive(s, 0x200 + NODE, 8, data);
}

static void yaw_aid(struct site *s, float yaw_deg, float sigma_deg)
{
	const float values[2] = {yaw_deg, sigma_deg};

	receive(s, 0x300 + NODE, 8, values);
}

static void reference_aid(struct site *s, float l)
{
	expect_write(write_real(s, 0x2075, 1, l));
	expect_write(write_real(s, 0x2075, 2, 0));
	expect_write(write_real(s, 0x2075, 3, 0));
}

static void store(struct site *s)
{
	receive(s, 0x600 + NODE, 8, (const uint8_t[]){0x23, 0x10, 0x10, 1, 's', 'a', 'v', 'e'});
	run(s, 0.3);
	if (s->late_disk) {
		device_saved(&s->device, 0, s->now_us);
		tick(s);
	}
}

/* A transfer of several frames, with time between them. */
static void upload_name(struct site *s)
{
	receive(s, 0x600 + NODE, 8, (const uint8_t[]){0x40, 0x08, 0x10, 0, 0, 0, 0, 0});
	run(s, 0.2);
	receive(s, 0x600 + NODE, 8, (const uint8_t[]){0x60, 0, 0, 0, 0, 0, 0, 0});
	run(s, 0.2);
	receive(s, 0x600 + NODE, 8, (const uint8_t[]){0x70, 0, 0, 0, 0, 0, 0, 0});
}

static void lose_sensor(struct site *s, double seconds)
{
	s->sensor_silent = true;
	s->imu.health.fault = IMU_FAULT_SILENT;
	s->imu.health.fault_chip = IMU_CHIP_ACCEL;
	s->imu.health.bus_errors += 12;
	device_sample(&s->device, -EIO, NULL, s->now_us);
	tick(s);
	run(s, seconds);
	s->sensor_silent = false;
	s->imu.health.fault = s->imu.health.fault_chip = 0;
	s->imu.health.restarts++;
}

static void write_u16(struct site *s, uint16_t index, uint8_t sub, uint16_t value)
{
	expect_write(write_value(s, index, sub, &value, 2));
}

static void write_u32(struct site *s, uint16_t index, uint8_t sub, uint32_t value)
{
	expect_write(write_value(s, index, sub, &value, 4));
}

/* What has state of its own between two samples: filters, timers, thresholds, TIME, remote frames, LSS. */
/* As clients of Modbus and CiA 309-3 do. */
static void write_beside_the_bus(struct site *s, uint16_t index, uint8_t sub, float value)
{
	assert_int_equal(device_write(&s->device, index, sub, &value, sizeof(value), s->now_us), OD_OK);
	tick(s);
}

static void other_services(struct site *s, unsigned round)
{
	const struct can_msg remote = {.id = 0x280 + NODE, .remote = true, .t_us = s->now_us};

	expect_write(write_real(s, 0x2012, 1, round % 2 ? 0.5f : 0.2f));
	expect_write(write_u8(s, 0x2030, 1, (uint8_t)(round % 3)));
	expect_write(write_u8(s, 0x2040, 1, round % 3 ? 2 : 1));
	expect_write(write_real(s, 0x2118, 1, 0.3f));
	write_beside_the_bus(s, 0x2011, 3, 15.0f + (float)round);
	write_u32(s, 0x1012, 0, 0x80000100);
	receive(s, 0x100, 6, (const uint8_t[]){0x10, 0x20, 0x30, 0, 0x20, 0x37});
	write_u32(s, 0x1801, 1, 0x80000280 + NODE);
	expect_write(write_u8(s, 0x1801, 2, 252));
	write_u32(s, 0x1801, 1, 0x280 + NODE);
	write_u32(s, 0x1800, 1, 0x80000180 + NODE);
	expect_write(write_u8(s, 0x1800, 2, 254));
	write_u16(s, 0x1800, 3, 700); /* inhibit time, 70 ms */
	write_u16(s, 0x1800, 5, 130);
	write_u32(s, 0x1800, 1, 0x180 + NODE);
	for (int i = 0; i < 60; i++) {
		run(s, 0.3);
		device_receive(&s->device, &remote, s->now_us);
		tick(s);
	}
	receive(s, 0x7E5, 8, (const uint8_t[8]){0x04, 1}); /* LSS: configuration, inquire, waiting */
	receive(s, 0x7E5, 8, (const uint8_t[8]){0x5E});
	run(s, 1);
	receive(s, 0x7E5, 8, (const uint8_t[8]){0x04, 0});
	device_host_clock(&s->device, true, 1790000000000000 + round);
	run(s, 20);
}

/* Ten minutes, with something of everything. */
static void ten_minutes(struct site *s, unsigned round)
{
	const uint64_t end_us = s->now_us + 600000000;
	struct imu_sample sample;

	nmt(s, 1);
	device_host_clock(&s->device, round % 2, 1790000000000000);
	run(s, 20);
	expect_write(write_real(s, 0x2000, 1, 0.05f + 0.01f * (float)round));
	run(s, 15);
	expect_write(write_real(s, 0x2010, 3, 20));
	expect_write(write_u8(s, 0x2010, 1, 1));
	run(s, 10);
	for (int i = 0; i < 100; i++) {
		velocity_aid(s, (int16_t)(10 * i), 80);
		yaw_aid(s, 0.2f * (float)i, 2);
		run(s, 0.2);
	}
	expect_write(write_u8(s, 0x2148, 0, (uint8_t)(1 + round % 4)));
	run(s, 10);
	expect_write(write_u8(s, 0x1803, 2, 254)); /* TPDO4 with each sample */
	run(s, 20);
	expect_write(write_u8(s, 0x1803, 2, 2));
	other_services(s, round);
	receive(s, 0x400 + NODE, 7, (const uint8_t[]){0, 1, 0, 2, 0, 30, 1}); /* attitude */
	run(s, 5);
	write_u16(s, 0x2073, 0, 0x07);
	run(s, 5);
	write_u16(s, 0x2073, 0, 0);
	upload_name(s);
	store(s);
	expect_write(write_u8(s, 0x2060, 1, 2)); /* lever arm, with a reference */
	for (int i = 0; i < 200; i++) {
		reference_aid(s, 0.1f * (float)(i % 7));
		run(s, 0.1);
	}
	write_u8(s, 0x2060, 1, 0);
	expect_write(write_u8(s, 0x2061, 1, 1)); /* gyro bias */
	run(s, 30);
	write_u8(s, 0x2061, 1, 0);
	lose_sensor(s, 3);
	run(s, 20);
	expect_write(write_real(s, 0x2058, 1, 800)); /* refused by the sensor: EMCY 6321h */
	run(s, 3);
	sensor_next(&s->sensor, signal_find("square"), &sample, NULL); /* clipped, after a jump of the motion */
	run_until(s, s->now_us + 7000);
	sample.t_us = s->now_us;
	sample.flags |= SAMPLE_SATURATED | SAMPLE_DISCONTINUITY;
	s->next_sample_us = s->now_us + s->interval_us;
	deliver(s, &sample);
	s->imu.health.degraded = IMU_FAULT_FROZEN;
	s->imu.health.degraded_chip = IMU_CHIP_MAG;
	run(s, 20);
	s->imu.health.degraded = s->imu.health.degraded_chip = 0;
	device_away(&s->device, 80000, s->now_us);
	s->drop_next = true; /* EMCY 8110h */
	run(s, 30);
	write_u32(s, 0x1016, 1, 0x000503E8); /* node 5, once a second */
	receive(s, 0x705, 1, (const uint8_t[]){5});
	run(s, 5); /* and it is lost: EMCY 8130h, pre-operational */
	nmt(s, 1);
	run(s, 10);
	nmt(s, round % 2 ? 0x81 : 0x82);
	nmt(s, 1);
	run_until(s, s->now_us + 100000);
	while (s->now_us + 10000000 <= end_us)
		run(s, 10);
	run_until(s, end_us);
}

static void test_an_hour_is_replayed_frame_by_frame(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 1, 1000);

	power_on(s, NULL, &options);
	for (unsigned round = 0; round < 3; round++)
		ten_minutes(s, round);
	power_off(s);
	s->now_us += 7000000; /* restart of the process */
	power_on(s, (const char *const[]){"latency.sensor=0.003", "producer_heartbeat_time=500", NULL}, &options);
	for (unsigned round = 3; round < 6; round++)
		ten_minutes(s, round);
	power_off(s);

	static const uint16_t happened[] = {0x5030, 0x5031, 0x6321, 0x8110, 0x8130};
	for (size_t i = 0; i < sizeof(happened) / sizeof(happened[0]); i++)
		assert_true(emcys(&s->sent, happened[i]) >= 5);
	assert_true(count_of(&s->sent, 0x180 + NODE) > 10000 && count_of(&s->sent, 0x480 + NODE) > 10000);
	assert_true(replay_all(s) > 3550 * SLOW_HZ);
	assert_same_frames(&s->sent, 0);
	assert_same_values(&s->values, 0);
}

/* ---- the state --------------------------------------------------------------------------------------------------- */

extern const char __executable_start, end; /* of the linker */

/* A pointer that was stored would be one into the device, its surroundings or this program. */
static void test_the_state_has_no_address(void **state)
{
	struct site *s = *state;
	const uintptr_t site = (uintptr_t)s, program = (uintptr_t)&__executable_start;
	uint8_t *bytes;

	if (sizeof(uintptr_t) < 8)
		skip(); /* half of a double looks like one */
	bytes = malloc(sizeof(struct device));
	assert_non_null(bytes);
	power_on(s, NULL, NULL);
	ten_minutes(s, 0);
	receive(s, 0x600 + NODE, 8, (const uint8_t[]){0x40, 0x08, 0x10, 0, 0, 0, 0, 0}); /* an upload under way */
	expect_write(write_u8(s, 0x2061, 1, 1));					 /* and a calibration */
	receive(s, 0x600 + NODE, 8, (const uint8_t[]){0x40, 0x21, 0x10, 0, 0, 0, 0, 0});
	device_state_save(&s->device, bytes);
	for (size_t at = 0; at + sizeof(uintptr_t) <= sizeof(struct device); at += sizeof(uintptr_t)) {
		uintptr_t word;

		memcpy(&word, bytes + at, sizeof(word));
		if (word - site < sizeof(*s) || word - program < (size_t)(&end - &__executable_start))
			fail_msg("offset %zu of struct device is an address: add it to KEPT or MOVING", at);
	}
	free(bytes);
}

static void test_a_device_with_the_defaults_goes_on_from_a_state_with_other_pdos(void **state)
{
	struct site *s = *state, *other = new_site(RATE_HZ);
	uint8_t *bytes = malloc(sizeof(struct device));

	assert_non_null(bytes);
	power_on(s, NULL, NULL);
	power_on(other, NULL, NULL);
	assert_int_equal(write_u8(s, 0x2148, 0, 3), 0);
	nmt(s, 1);
	run(s, 1);
	device_state_save(&s->device, bytes);
	device_state_load(&other->device, bytes);
	free(bytes);
	other->now_us = s->now_us;
	s->sent.count = other->sent.count = 0;
	receive(s, 0x080, 0, NULL);
	receive(other, 0x080, 0, NULL);
	assert_int_equal(s->sent.count, 4);
	assert_int_equal(other->sent.count, 4);
	assert_memory_equal(s->sent.frame, other->sent.frame, 4 * sizeof(struct sent));
	void *gone = other;
	tear_down(&gone);
}

static void test_a_recording_can_begin_in_the_run(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);

	power_on(s, NULL, &options);
	assert_int_equal(write_u8(s, 0x215C, 1, 0), 0);
	nmt(s, 1);
	run(s, 100);
	assert_int_equal(s->device.values.recording.state, RECORD_OFF);
	receive(s, 0x600 + NODE, 8, (const uint8_t[]){0x40, 0x08, 0x10, 0, 0, 0, 0, 0});
	assert_int_equal(write_u8(s, 0x215C, 1, 1), 0);
	size_t from = s->sent.count;
	run(s, 100);
	assert_int_equal(s->device.values.recording.state, RECORD_ON);
	power_off(s);

	forget_replayed();
	assert_true(replay_file(s, "imu9-000002.imu.csv", true) > 99 * RATE_HZ);
	assert_same_frames(&s->sent, from);
}

/* Of a string, of the EDS in constant memory, and of a domain that is assembled. */
static void test_a_transfer_under_way_continues_in_the_next_file(void **state)
{
	static const uint16_t objects[] = {0x1008, 0x1021, 0x2130};
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);
	char name[64];

	power_on(s, NULL, &options);
	nmt(s, 1);
	for (int i = 0; i < 3; i++) {
		const uint8_t upload[8] = {0x40, (uint8_t)objects[i], (uint8_t)(objects[i] >> 8)};

		receive(s, 0x600 + NODE, 8, upload);
		record_file_turn(&s->file);
		record_begin_again(&s->record);
		size_t from = s->sent.count;
		for (int k = 0; k < 100; k++) {
			receive(s, 0x600 + NODE, 8, (const uint8_t[]){k % 2 ? 0x70 : 0x60, 0, 0, 0, 0, 0, 0, 0});
			run(s, 0.1);
		}
		run(s, 2); /* and its file is written */
		record_file_turn(&s->file);
		snprintf(name, sizeof(name), "imu9-%06d.imu.csv", i + 2);
		forget_replayed();
		replay_file(s, name, true);
		assert_true(replayed.count > 500 || i == 2);
		assert_same_frames(&s->sent, from);
	}
}

static void test_a_configuration_that_is_read_again_begins_a_file(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);
	static struct config before, after;
	char why[CONFIG_ERROR_MAX];

	power_on(s, NULL, &options);
	nmt(s, 1);
	run(s, 30);
	config_init(&before, &imu9_od_table);
	config_init(&after, &imu9_od_table);
	assert_int_equal(config_set(&after, "lever_arm.s=-0.2", why), 0);
	assert_int_equal(reload(&s->device, &before, &after, s->now_us), 0);
	size_t from = s->sent.count;
	run(s, 30);
	nmt(s, 0x81); /* to what the file says */
	run(s, 30);
	power_off(s);
	forget_replayed();
	replay_file(s, "imu9-000002.imu.csv", true);
	assert_same_frames(&s->sent, from);
}

/* By Modbus, function 43/13; refused or not. */
static void test_a_write_of_more_than_64_bytes_begins_a_file(void **state)
{
	static const uint8_t bytes[65];
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);
	static char names[20][64];

	power_on(s, NULL, &options);
	for (size_t size = 64; size <= 65; size++) {
		run(s, 1);
		assert_int_not_equal(device_write(&s->device, 0x2000, 1, bytes, size, s->now_us), OD_OK);
		tick(s);
		run(s, 1);
		record_file_turn(&s->file);
		assert_int_equal(files_of(s, names, 20), size - 63);
	}
	replay_all(s);
	assert_same_frames(&s->sent, 0);
}

static void test_another_build_starts_with_the_recorded_configuration(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);
	char path[160];

	power_on(s, (const char *const[]){"lever_arm.l=0.3", NULL}, &options);
	nmt(s, 1);
	run(s, 10);
	record_begin_again(&s->record);
	run(s, 10);
	power_off(s);
	snprintf(path, sizeof(path), "%s/imu9-000002.imu.csv", s->folder);
	int fd = open(path, O_WRONLY);
	assert_int_equal(pwrite(fd, "0000", 4, strlen("# imu9-recording 1 ")), 4);
	close(fd);

	forget_replayed();
	assert_true(replay_file(s, "imu9-000002.imu.csv", true) > 9 * RATE_HZ);
	assert_true(count_of(&replayed, 0x180 + NODE) > 90);
}

static void test_what_comes_before_a_stop_is_in_the_file_and_nothing_behind_it(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);

	power_on(s, NULL, &options);
	nmt(s, 1);
	run(s, 10);
	record_file_turn(&s->file);
	s->turns = 0; /* the turn in which the stop is written has inputs before it, too */
	assert_int_equal(write_u8(s, 0x215C, 1, 0), 0);
	size_t stopped = s->sent.count;
	assert_int_equal(s->sent.frame[stopped - 1].id, 0x580 + NODE);
	syncs = 0;
	run(s, 1);
	assert_int_equal(syncs, 1); /* it is closed */
	power_off(s);
	assert_true(replay_all(s) > 9 * RATE_HZ);
	assert_int_equal(replayed.count, stopped);
	assert_memory_equal(replayed.frame, s->sent.frame, stopped * sizeof(struct sent));
}

/* ---- disks ------------------------------------------------------------------------------------------------------- */

static void test_a_power_cut_costs_the_torn_line(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);
	char path[160];

	power_on(s, NULL, &options);
	nmt(s, 1);
	run(s, 20);
	power_off(s);
	snprintf(path, sizeof(path), "%s/imu9-000001.imu.csv", s->folder);
	FILE *file = fopen(path, "r");
	fseek(file, 0, SEEK_END);
	long size = ftell(file);
	fclose(file);
	for (long cut = size - 1; cut > size - 3000; cut -= 97) {
		assert_int_equal(truncate(path, cut), 0);
		forget_replayed();
		replay_file(s, "imu9-000001.imu.csv", true);
		assert_true(replayed.count > 400 && replayed.count <= s->sent.count);
		assert_memory_equal(replayed.frame, s->sent.frame, replayed.count * sizeof(struct sent));
	}
}

static void test_a_damaged_line_is_told(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);
	char path[160];

	power_on(s, NULL, &options);
	run(s, 5);
	power_off(s);
	snprintf(path, sizeof(path), "%s/imu9-000001.imu.csv", s->folder);
	FILE *file = fopen(path, "a");
	fputs("# tick 12x\n# tick 12\n", file);
	fclose(file);
	replay_file(s, "imu9-000001.imu.csv", false);
}

static void test_a_missing_input_is_noticed(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);
	char command[400];

	power_on(s, NULL, &options);
	nmt(s, 1);
	run(s, 20);
	power_off(s);
	/* one SYNC less */
	snprintf(command, sizeof(command), "sed -i '0,/rx [0-9]* 080#/{/rx [0-9]* 080#/d}' %s/imu9-000001.imu.csv",
		s->folder);
	assert_int_equal(system(command), 0);
	replay_file(s, "imu9-000001.imu.csv", false);
}

static void test_a_full_disk_ends_the_recording_and_nothing_else(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);
	const struct rlimit limit = {400000, RLIM_INFINITY}, none = {RLIM_INFINITY, RLIM_INFINITY};

	signal(SIGXFSZ, SIG_IGN);
	power_on(s, NULL, &options);
	nmt(s, 1);
	setrlimit(RLIMIT_FSIZE, &limit);
	run(s, 100);
	setrlimit(RLIMIT_FSIZE, &none);
	assert_int_equal(s->device.values.recording.state, RECORD_ENDED);
	assert_non_null(strstr(s->device.log.text, "recording ended: File too large"));
	assert_int_equal(s->device.samples, 100 * RATE_HZ + 1);

	assert_int_equal(write_u8(s, 0x215C, 1, 1), 0); /* there is room again */
	size_t from = s->sent.count;
	run(s, 10);
	assert_int_equal(s->device.values.recording.state, RECORD_ON);
	power_off(s);
	forget_replayed();
	replay_file(s, "imu9-000002.imu.csv", true);
	assert_same_frames(&s->sent, from);
}

static void test_a_file_begins_with_what_it_is_of(void **state)
{
	static const char *const lines[] = {"# device 16 0 5 0\n", "# sensor chips\n", "# can can0\n",
		"# uncalibrated: gyro magnetometer\n", "# config lever_arm.l = 0.25\n",
		"# config lever_arm_model = 1\n"};
	static const char *const settings[] = {"lever_arm.l=0.25", "lever_arm_model=1", NULL};
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);
	char path[160], line[2000];
	unsigned found = 0, configured = 0, year, columns = 0;
	char last;

	power_on(s, settings, &options);
	s->imu.uncalibrated = 5;
	run(s, 2);
	power_off(s);
	snprintf(path, sizeof(path), "%s/imu9-000001.imu.csv", s->folder);
	FILE *f = fopen(path, "r");
	assert_non_null(f);
	assert_non_null(fgets(line, sizeof(line), f));
	assert_int_equal(strncmp(line, "# imu9-recording 1 ", 19), 0);
	assert_non_null(fgets(line, sizeof(line), f));
	assert_int_equal(strncmp(line, "# of imu9-gateway ", 18), 0);
	assert_int_equal(sscanf(strstr(line, ", at ") + 5, "%u-%*2u-%*2uT%*2u:%*2u:%*2uZ%c", &year, &last), 2);
	assert_int_equal(last, '\n');
	assert_in_range(year, 1970, 9999);
	while (columns == 0 && fgets(line, sizeof(line), f)) {
		for (size_t i = 0; i < sizeof(lines) / sizeof(lines[0]); i++)
			found += strcmp(line, lines[i]) == 0;
		configured += strncmp(line, "# config ", 9) == 0;
		columns += strncmp(line, "t,gx,gy,gz,", 11) == 0;
	}
	fclose(f);
	assert_int_equal(found, sizeof(lines) / sizeof(lines[0]));
	assert_int_equal(configured, 2); /* the others have their defaults */
	assert_int_equal(columns, 1);
}

static void test_a_disk_that_takes_a_part_of_each_write_gets_all(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);

	takes_parts = true;
	power_on(s, NULL, &options);
	nmt(s, 1);
	run(s, 60);
	power_off(s);
	takes_parts = false;
	assert_true(replay_all(s) > 59 * RATE_HZ);
	assert_same_frames(&s->sent, 0);
}

/* As in the process; an hour of it in seconds would fill the ring. */
static void test_a_thread_writes_what_the_loop_records(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);

	s->threaded = true;
	power_on(s, NULL, &options);
	nmt(s, 1);
	run(s, 60);
	while (record_next(&s->record)) /* it takes them without being asked: a test that hangs has failed */
		usleep(1000);
	power_off(s);
	assert_true(replay_all(s) > 59 * RATE_HZ);
	assert_same_frames(&s->sent, 0);
}

static void let_it_turn(unsigned until)
{
	turns_until = until;
	while (turns < until)
		sched_yield();
}

static void test_the_thread_syncs_the_file_each_fifty_turns_of_a_tenth_of_a_second(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);

	s->threaded = true;
	turns = 0;
	turns_until = 1; /* the first turn finds nothing */
	power_on(s, NULL, &options);
	let_it_turn(1);
	syncs = 0;
	run(s, 1);
	let_it_turn(50);
	assert_int_equal(syncs, 0);
	let_it_turn(51);
	assert_int_equal(syncs, 1);
	let_it_turn(100);
	assert_int_equal(syncs, 1);
	let_it_turn(151);
	assert_int_equal(syncs, 3);
	turns_until = UINT_MAX;
	power_off(s);
	turns_until = 0;
}

static void test_without_a_thread_there_is_no_recording_and_the_folder_is_free(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);
	static struct record_file file;

	no_thread = true;
	assert_int_equal(record_file_open(&file, &s->record, &options), -EAGAIN);
	no_thread = false;
	power_on(s, NULL, &options);
}

static void test_a_disk_that_takes_nothing_is_full(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);

	power_on(s, NULL, &options);
	run(s, 10);
	takes_nothing = true;
	run(s, 10);
	takes_nothing = false;
	assert_int_equal(s->device.values.recording.state, RECORD_ENDED);
	const char *said = strstr(s->device.log.text, "recording ended: No space left on device; "
						      "correct that, then write 1 to 215Ch:1 to start it again\n");
	assert_non_null(said);
	assert_null(strstr(said + 1, "recording ended")); /* once */
}

static void test_a_file_that_cannot_begin_ends_the_recording_each_time(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);

	power_on(s, NULL, &options);
	run(s, 1);
	remove_files(s);
	assert_int_equal(rmdir(s->folder), 0);
	record_begin_again(&s->record);
	for (int i = 0; i < 3; i++) {
		run(s, 10);
		assert_int_equal(s->device.values.recording.state, RECORD_ENDED);
		assert_non_null(strstr(s->device.log.text, "recording ended: No such file or directory"));
		s->device.log.used = 0;
		memset(s->device.log.text, 0, sizeof(s->device.log.text));
		assert_int_equal(write_u8(s, 0x215C, 1, 1), 0);
	}
	assert_int_equal(mkdir(s->folder, 0700), 0);
}

/* Nothing is taken out of the ring for minutes. */
static void test_a_slow_disk_loses_inputs_which_are_counted_and_delays_no_sample(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);
	size_t last = 0;

	power_on(s, NULL, &options);
	nmt(s, 1);
	run(s, 10);
	s->recording = false;
	run(s, 300);
	assert_true(s->device.values.recording.lost > 100);
	assert_int_equal(s->device.samples, 310 * RATE_HZ + 1);
	s->recording = true;
	record_file_turn(&s->file);
	size_t from = s->sent.count;
	run(s, 60);
	power_off(s);

	forget_replayed();
	replay_file(s, "imu9-000001.imu.csv", true);
	last = replayed.count;
	assert_memory_equal(replayed.frame, s->sent.frame, last * sizeof(struct sent));
	forget_replayed();
	replay_file(s, "imu9-000002.imu.csv", true);
	assert_same_frames(&s->sent, from);
	assert_true(last < from);
}

/* ---- files ------------------------------------------------------------------------------------------------------- */

/* A tick is one entry; the others of an input are what the ports have answered. */
static void test_the_last_16_places_of_the_ring_are_for_one_input_and_half_of_it_for_a_new_file(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);
	struct record *r = &s->record;

	power_on(s, NULL, &options);
	run(s, 1);
	record_file_turn(&s->file);
	s->recording = false; /* nothing is taken out */
	while (r->lost == 0)
		tick(s);
	assert_int_equal(r->head - r->tail, RECORD_RING - 16);
	for (int i = 0; i < 8; i++)
		tick(s);
	assert_int_equal(r->head - r->tail, RECORD_RING - 16);
	assert_int_equal(r->lost, 9);
	while (r->head - r->tail > RECORD_RING / 2)
		record_taken(r);
	tick(s);
	assert_int_equal(r->lost, 10);
	record_taken(r);
	tick(s);
	assert_int_equal(r->lost, 10);
	assert_int_equal(r->lost_now, 0);
	s->recording = true;
}

static void test_what_the_ports_and_the_recording_show_is_a_row_when_it_changes(void **state)
{
	static const char *const rows[] = {"# imu ", "# bus ", "# recording "};
	unsigned counts[3] = {0};
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);
	char path[160], line[2000];

	power_on(s, NULL, &options);
	nmt(s, 1);
	run(s, 10.5);
	power_off(s);
	snprintf(path, sizeof(path), "%s/imu9-000001.imu.csv", s->folder);
	FILE *f = fopen(path, "r");
	assert_non_null(f);
	while (fgets(line, sizeof(line), f))
		for (int i = 0; i < 3; i++)
			counts[i] += strncmp(line, rows[i], strlen(rows[i])) == 0;
	fclose(f);
	assert_int_equal(counts[0], 1);
	assert_int_equal(counts[1], 1 + 11); /* the counters of the interface are read each second */
	assert_int_equal(counts[2], 2);	     /* off, then on */
}

static void test_a_recording_is_an_imu_log(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);
	static struct imu_log log;
	struct imu_sample sample, first;
	char path[160], error[200];
	unsigned samples = 0, fields = 0, temperatures = 0;

	power_on(s, NULL, &options);
	uint64_t start_us = s->next_sample_us - 1000;
	run(s, 20);
	power_off(s);
	snprintf(path, sizeof(path), "%s/imu9-000001.imu.csv", s->folder);
	assert_int_equal(imu_log_open(&log, path, log_format_at(0), error, sizeof(error)), 0);
	for (; imu_log_next(&log, &sample); samples++) {
		first = samples == 0 ? sample : first;
		fields += (sample.flags & SAMPLE_MAG) != 0;
		temperatures += (sample.flags & SAMPLE_TEMPERATURE) != 0;
	}
	assert_int_equal(samples, 20 * RATE_HZ);
	assert_int_equal(fields, samples); /* the magnetometer is the faster one */
	assert_true(temperatures > 0);
	assert_int_equal(log.rows.events.skipped, 0);
	assert_float_equal(log.rate_hz, RATE_HZ, 1e-6);
	assert_int_equal(first.t_us, start_us);
	imu_log_close(&log);
}

static long size_of(const struct site *s, const char *name)
{
	struct stat status;
	char path[160];

	snprintf(path, sizeof(path), "%s/%s", s->folder, name);
	assert_int_equal(stat(path, &status), 0);
	assert_int_equal(status.st_mode & 0777, 0644);
	return status.st_size;
}

static void test_rotation_leaves_the_newest_files(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 1, 3);
	static char names[20][64];

	syncs = 0;
	power_on(s, NULL, &options);
	run(s, 700);
	power_off(s);
	assert_int_equal(files_of(s, names, 20), 3);
	unsigned first, second;
	assert_int_equal(sscanf(names[0], "imu9-%u.imu.csv", &first), 1);
	assert_int_equal(sscanf(names[2], "imu9-%u.imu.csv", &second), 1);
	assert_true(first > 3 && second == first + 2);
	assert_int_equal(syncs, second); /* each file when it has ended */
	assert_in_range(size_of(s, names[0]), 1000000, 1100000);
	assert_in_range(size_of(s, names[1]), 1000000, 1100000);

	power_on(s, NULL, &options); /* a restart continues the numbers */
	run(s, 1);
	power_off(s);
	assert_int_equal(files_of(s, names, 20), 3);
	assert_int_equal(sscanf(names[2], "imu9-%u.imu.csv", &first), 1);
	assert_int_equal(first, second + 1);
}

/* Numbers need not be in the order of the folder, and go beyond six digits. */
static void test_files_of_earlier_runs_count_and_others_are_left_alone(void **state)
{
	static const char *const before[] = {"imu9-000007.imu.csv", "imu9-000009.imu.csv", "imu9-000008.imu.csv",
		"imu9-000011.kept.imu.csv", "imu9-000003.kept.imu.csv", "imu9-000010.kept.imu.csv",
		"imu9-000005.kept.imu.csv", "imu9-12.imu.csv", "imu9-000013.csv", "imu9-000014.imu.csv.bak",
		"other.csv", "imu9-x.imu.csv", "imu9-1000000.imu.csv"};
	static const char *const after[] = {"imu9-000010.kept.imu.csv", "imu9-000011.kept.imu.csv", "imu9-000013.csv",
		"imu9-000014.imu.csv.bak", "imu9-1000000.imu.csv", "imu9-1000001.imu.csv", "imu9-12.imu.csv",
		"imu9-x.imu.csv", "other.csv"};
	struct site *s = *state;
	struct record_options options = options_of(s, 1, 2);
	static char names[20][64];
	char path[160];

	for (size_t i = 0; i < sizeof(before) / sizeof(before[0]); i++) {
		snprintf(path, sizeof(path), "%s/%s", s->folder, before[i]);
		fclose(fopen(path, "w"));
	}
	power_on(s, NULL, &options);
	run(s, 1);
	power_off(s);
	assert_int_equal(files_of(s, names, 20), sizeof(after) / sizeof(after[0]));
	for (size_t i = 0; i < sizeof(after) / sizeof(after[0]); i++)
		assert_string_equal(names[i], after[i]);
}

static void test_a_folder_that_cannot_be_used_is_told(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 1, 2);
	static struct record_file file;
	struct stat status;
	char path[160];

	snprintf(options.folder, sizeof(options.folder), "%s/no/such", s->folder);
	assert_int_equal(record_file_init(&file, &s->record, &options), -ENOENT);
	snprintf(options.folder, sizeof(options.folder), "%s/new", s->folder);
	assert_int_equal(record_file_init(&file, &s->record, &options), 0);
	assert_int_equal(stat(options.folder, &status), 0);
	assert_int_equal(status.st_mode & 0777, 0755);
	record_file_close(&file);
	lock_errno = ENOLCK;
	assert_int_equal(record_file_init(&file, &s->record, &options), -ENOLCK);
	lock_errno = 0;
	for (unsigned i = 1; i <= 2 * RECORD_FILES_MAX + 1; i++) {
		snprintf(path, sizeof(path), "%s/new/imu9-%06u.imu.csv", s->folder, i);
		fclose(fopen(path, "w"));
	}
	assert_int_equal(record_file_init(&file, &s->record, &options), -E2BIG);
	for (unsigned i = 1; i <= 2 * RECORD_FILES_MAX + 1; i++) {
		snprintf(path, sizeof(path), "%s/new/imu9-%06u.imu.csv", s->folder, i);
		unlink(path);
	}
	assert_int_equal(rmdir(options.folder), 0);
	snprintf(options.folder, sizeof(options.folder), "%s/file", s->folder);
	fclose(fopen(options.folder, "w"));
	assert_int_equal(record_file_init(&file, &s->record, &options), -ENOTDIR);
}

static void test_the_minute_before_an_emcy_is_kept(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 1, 2);
	static char names[20][64];

	power_on(s, NULL, &options);
	nmt(s, 1);
	run(s, 300);
	uint64_t then_us = s->now_us;
	lose_sensor(s, 1);
	size_t event = s->sent.count;
	run(s, 700);
	power_off(s);

	size_t n = files_of(s, names, 20);
	forget_replayed();
	for (size_t i = 0; i < n; i++)
		if (strstr(names[i], ".kept."))
			replay_file(s, names[i], true);
	assert_in_range(s->device.values.recording.kept, 1, 2); /* one more if the file was young */
	assert_true(replayed.count > 0 && replayed.frame[0].now_us + 60000000 <= then_us);
	assert_true(replayed.frame[replayed.count - 1].now_us >= s->sent.frame[event - 1].now_us);
	assert_int_equal(emcys(&replayed, 0x5030), 1);
	assert_true(n <= 4);
}

static void test_the_file_that_began_a_minute_before_is_the_oldest_that_is_kept(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 8);
	static char names[20][64];

	for (int kept = 2; kept <= 3; kept++) { /* the second file began 61 s before, then 59 s */
		power_on(s, NULL, &options);
		run(s, 30);
		record_begin_again(&s->record);
		run(s, 30);
		record_begin_again(&s->record);
		run(s, kept == 2 ? 31 : 29);
		assert_int_equal(write_u8(s, 0x215C, 1, 2), 0);
		run(s, 1);
		assert_int_equal(s->device.values.recording.kept, kept);
		power_off(s);
		assert_int_equal(files_of(s, names, 20), 3);
		assert_int_equal(strstr(names[0], ".kept.") != NULL, kept == 3);
		remove_files(s);
	}
}

static void test_kept_files_are_bounded(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 1, 2);
	static char names[20][64];

	power_on(s, NULL, &options);
	for (int i = 0; i < 5; i++) {
		run(s, 110);
		lose_sensor(s, 1);
	}
	run(s, 230);
	power_off(s);
	assert_int_equal(files_of(s, names, 20), 4);
	assert_true(s->device.values.recording.kept >= 4);
}

static void test_only_one_process_records_in_a_folder(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 1, 2);
	static struct record_file other;

	power_on(s, NULL, &options);
	assert_int_equal(record_file_init(&other, &s->record, &options), -EADDRINUSE);
}

static void test_without_a_folder_the_object_refuses_commands(void **state)
{
	struct site *s = *state;

	power_on(s, NULL, NULL);
	assert_int_equal(write_u8(s, 0x215C, 1, 1), 0x08000022);
	assert_int_equal(s->device.values.recording.state, RECORD_OFF);
}

static void test_a_command_keeps_the_last_minute(void **state)
{
	struct site *s = *state;
	struct record_options options = options_of(s, 16, 2);
	static char names[20][64];

	power_on(s, NULL, &options);
	run(s, 10);
	assert_int_equal(write_u8(s, 0x215C, 1, 2), 0);
	run(s, 10);
	assert_int_equal(s->device.values.recording.kept, 1);
	assert_int_equal(write_u8(s, 0x215C, 1, 0), 0);
	run(s, 1);
	assert_int_equal(write_u8(s, 0x215C, 1, 2), 0x08000022);
	power_off(s);
	assert_int_equal(files_of(s, names, 20), 1);
	assert_string_equal(names[0], "imu9-000001.kept.imu.csv");
	assert_true(replay_all(s) > 19 * RATE_HZ);
}

#define TEST(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test_setup_teardown(test_an_hour_is_replayed_frame_by_frame, set_up_slow, tear_down),
		TEST(test_the_state_has_no_address),
		TEST(test_a_device_with_the_defaults_goes_on_from_a_state_with_other_pdos),
		TEST(test_a_recording_can_begin_in_the_run),
		TEST(test_a_transfer_under_way_continues_in_the_next_file),
		TEST(test_a_configuration_that_is_read_again_begins_a_file),
		TEST(test_a_write_of_more_than_64_bytes_begins_a_file),
		TEST(test_another_build_starts_with_the_recorded_configuration),
		TEST(test_what_comes_before_a_stop_is_in_the_file_and_nothing_behind_it),
		TEST(test_a_power_cut_costs_the_torn_line),
		TEST(test_a_damaged_line_is_told),
		TEST(test_a_missing_input_is_noticed),
		TEST(test_a_full_disk_ends_the_recording_and_nothing_else),
		TEST(test_a_file_begins_with_what_it_is_of),
		TEST(test_a_disk_that_takes_a_part_of_each_write_gets_all),
		TEST(test_a_thread_writes_what_the_loop_records),
		TEST(test_the_thread_syncs_the_file_each_fifty_turns_of_a_tenth_of_a_second),
		TEST(test_without_a_thread_there_is_no_recording_and_the_folder_is_free),
		TEST(test_a_disk_that_takes_nothing_is_full),
		TEST(test_a_file_that_cannot_begin_ends_the_recording_each_time),
		TEST(test_a_slow_disk_loses_inputs_which_are_counted_and_delays_no_sample),
		TEST(test_the_last_16_places_of_the_ring_are_for_one_input_and_half_of_it_for_a_new_file),
		TEST(test_what_the_ports_and_the_recording_show_is_a_row_when_it_changes),
		TEST(test_a_recording_is_an_imu_log),
		TEST(test_rotation_leaves_the_newest_files),
		TEST(test_files_of_earlier_runs_count_and_others_are_left_alone),
		TEST(test_a_folder_that_cannot_be_used_is_told),
		TEST(test_the_minute_before_an_emcy_is_kept),
		TEST(test_the_file_that_began_a_minute_before_is_the_oldest_that_is_kept),
		TEST(test_kept_files_are_bounded),
		TEST(test_only_one_process_records_in_a_folder),
		TEST(test_without_a_folder_the_object_refuses_commands),
		TEST(test_a_command_keeps_the_last_minute),
	};

	log_set_level(LOG_ERR);
	umask(022);
	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}
