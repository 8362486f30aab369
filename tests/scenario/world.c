#include "tests/scenario/world.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "od/little_endian.h"
#include "gateway/config.h"

static int take_frame(struct can_port *port, const struct can_msg *msg)
{
	struct world *w = (struct world *)port;

	w->frames[w->frame_count++ % WORLD_FRAMES] = *msg;
	return 0;
}

static int take_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port, (void)ids, (void)n;
	return 0;
}

static int save_to_disk(void *ctx, const uint8_t *bytes, size_t size)
{
	struct world *w = ctx;

	if (w->disk_answer < 0 && w->disk_answer != -EINPROGRESS)
		return w->disk_answer;
	if (w->disk_answer == 0)
		return store_decode(&w->disk, bytes, size);
	w->disk_waits = true;
	return store_decode(&w->to_disk, bytes, size) < 0 ? -EBADMSG : -EINPROGRESS;
}

void world_init(struct world *w, const struct sensor_config *sensor, uint64_t seed, const char *signal)
{
	static const struct can_ops ops = {.send = take_frame, .filter = take_filter};

	w->node_id = WORLD_NODE_ID;
	w->interval_us = (uint64_t)llround(1e6 / sensor->rate_hz);
	w->bus = (struct can_port){.ops = &ops, .fd = -1};
	w->imu = (struct imu_port){.rate_hz = sensor->rate_hz, .silence_us = 100000, .name = "sensor"};
	w->signal = signal_find(signal);
	assert_non_null(w->signal);
	assert_int_equal(sensor_init(&w->sensor, sensor, seed), 0);
}

void world_power_on(struct world *w, const char *const *settings)
{
	const struct storing_port storage = {.ctx = w, .save = save_to_disk};
	uint8_t node_id = w->disk.lss.node_id ? w->disk.lss.node_id : w->node_id;
	static struct config config;
	char why[CONFIG_ERROR_MAX];

	w->device = (struct device){0};
	config_init(&config, &imu9_od_table);
	assert_int_equal(config_set(&config, "inhibit_time_emcy=0", why), 0);
	for (; settings && *settings; settings++)
		assert_int_equal(config_set(&config, *settings, why), 0);
	od_init(&w->device.od, &imu9_od_table, &w->device.values, node_id);
	config_apply(&config, &w->device.od);
	w->device.values.identity.serial_number = w->serial;
	if (w->vendor)
		w->device.values.identity.vendor_id = w->vendor;
	assert_int_equal(device_init(&w->device, &w->bus, &w->imu, &storage, &w->disk, node_id), 0);
	device_start(&w->device, false, w->now_us);
}

struct world *world_new(const struct sensor_config *sensor, uint64_t seed, const char *signal)
{
	struct world *w = calloc(1, sizeof(*w));

	assert_non_null(w);
	world_init(w, sensor, seed, signal);
	world_power_on(w, NULL);
	return w;
}

int world_tear_down(void **state)
{
	free(*state);
	return 0;
}

void world_receive(struct world *w, uint32_t id, size_t len, const void *data)
{
	struct can_msg msg = {.id = id, .len = (uint8_t)len, .t_us = w->now_us};

	if (len)
		memcpy(msg.data, data, len);
	device_receive(&w->device, &msg, w->now_us);
	device_tick(&w->device, w->now_us);
}

void world_nmt(struct world *w, uint8_t command)
{
	world_receive(w, 0x000, 2, (const uint8_t[]){command, w->node_id});
	if (command < 0x81)
		return;
	w->now_us += 10000; /* a reset: until the boot-up message */
	device_tick(&w->device, w->now_us);
}

/* The first frame that is still recorded. */
static size_t oldest(const struct world *w)
{
	return w->frame_count > WORLD_FRAMES ? w->frame_count - WORLD_FRAMES : 0;
}

const struct can_msg *world_last(const struct world *w, uint32_t id)
{
	for (size_t i = w->frame_count; i > oldest(w); i--)
		if (w->frames[(i - 1) % WORLD_FRAMES].id == id)
			return &w->frames[(i - 1) % WORLD_FRAMES];
	return NULL;
}

unsigned world_count(const struct world *w, uint32_t id)
{
	unsigned count = 0;

	for (size_t i = oldest(w); i < w->frame_count; i++)
		count += w->frames[i % WORLD_FRAMES].id == id;
	return count;
}

uint16_t world_emcy_code(const struct world *w)
{
	const struct can_msg *emcy = world_last(w, 0x080u + w->node_id);

	return emcy ? get_u16(emcy->data) : 0;
}

uint32_t world_sdo_write(struct world *w, uint16_t index, uint8_t sub, const void *value, size_t size)
{
	uint8_t request[8] = {(uint8_t)(0x23 | (4 - size) << 2), (uint8_t)index, (uint8_t)(index >> 8), sub};
	const struct can_msg *answer;

	memcpy(request + 4, value, size);
	world_receive(w, 0x600u + w->node_id, 8, request);
	answer = world_last(w, 0x580u + w->node_id);
	assert_non_null(answer);
	if (answer->data[0] == 0x60)
		return 0;
	assert_int_equal(answer->data[0], 0x80);
	return get_u32(answer->data + 4);
}

void world_deliver(struct world *w, const struct imu_sample *sample)
{
	w->now_us += w->interval_us;
	device_sample(&w->device, 1, sample, w->now_us);
	device_tick(&w->device, w->now_us);
}

void world_sample(struct world *w)
{
	struct imu_sample sample;

	sensor_next(&w->sensor, w->signal, &sample, NULL);
	world_deliver(w, &sample);
}

void world_samples(struct world *w, int n)
{
	while (n-- > 0)
		world_sample(w);
}

void world_seconds(struct world *w, double s)
{
	world_samples(w, (int)(s * 1e6 / (double)w->interval_us));
}
