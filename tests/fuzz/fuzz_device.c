/* The whole device under arbitrary frames, writes, configuration snapshots, samples, clocks and power cuts. Input: a
 * sequence of steps, each an operation byte and its arguments. */
#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/device.h"
#include "gateway/log.h"
#include "gateway/snapshot.h"

enum { NODE_ID = 0x10, MAX_TICKS = 64, INTERVAL_US = 10000, BURST_MAX = 32 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

struct input {
	const uint8_t *data;
	size_t size;
};

static struct device device;
static struct can_port bus;
static struct imu_port imu;
static struct store_image disk;
static int disk_answer;
static uint64_t now_us;

/* Instead of gateway/log.c: nobody reads that many lines. */
void log_line(const char *format, ...)
{
	(void)format;
}

static void require(int condition)
{
	if (!condition)
		abort();
}

static uint8_t take(struct input *in)
{
	if (in->size == 0)
		return 0;
	in->size--;
	return *in->data++;
}

static void take_bytes(struct input *in, void *out, size_t size)
{
	for (size_t i = 0; i < size; i++)
		((uint8_t *)out)[i] = take(in);
}

/* ---- around the device ------------------------------------------------------------------------------------------- */

static int port_send(struct can_port *port, const struct can_msg *msg)
{
	(void)port;
	require(msg->id > 0 && msg->id <= 0x7FF && msg->len <= 8 && !msg->extended && !msg->remote);
	return 0;
}

static int port_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port;
	require(ids != NULL && n > 0);
	return 0;
}

static int port_bit_rate(struct can_port *port, uint32_t bit_s, bool dry_run)
{
	if (bit_s < 125000)
		return -EOPNOTSUPP;
	if (!dry_run)
		port->bit_s = bit_s;
	return 0;
}

static int port_restart(struct can_port *port)
{
	port->state = CAN_STATE_ACTIVE;
	return 0;
}

static int save(void *ctx, const uint8_t *bytes, size_t size)
{
	(void)ctx;
	return disk_answer < 0 ? disk_answer : store_decode(&disk, bytes, size);
}

static void power_on(void)
{
	static const struct can_ops ops = {
		.send = port_send, .filter = port_filter, .bit_rate = port_bit_rate, .restart = port_restart};
	static const struct storing_port storage = {.save = save};
	uint8_t node_id = disk.lss.node_id ? disk.lss.node_id : NODE_ID;

	bus = (struct can_port){.ops = &ops, .bit_s = 500000};
	imu = (struct imu_port){.rate_hz = 1e6 / INTERVAL_US, .silence_us = 100000};
	memset(&device, 0, sizeof(device));
	od_init(&device.od, &imu9_od_table, &device.values, node_id);
	require(device_init(&device, &bus, &imu, &storage, &disk, node_id) == 0);
	device_start(&device, false, now_us);
}

/* Whatever was done to them, all values have the type and the limits of their entry. */
static void check_values(void)
{
	for (size_t i = 0; i < imu9_od_table.count; i++) {
		const struct od_entry *entry = &imu9_od_table.entries[i];
		uint8_t wire[OD_VALUE_MAX];
		size_t size = od_get(&device.od, entry, wire, sizeof(wire));

		require(entry->type == OD_DOMAIN || od_check(entry, wire, size) == OD_OK);
	}
}

/* ---- steps ------------------------------------------------------------------------------------------------------- */

static void tick(void)
{
	require(device_tick(&device, now_us) > now_us);
}

static void pass_time(struct input *in)
{
	uint64_t end_us = now_us + ((uint64_t)take(in) << (take(in) & 15));

	for (int i = 0; i < MAX_TICKS && now_us < end_us; i++) {
		uint64_t deadline_us = device_tick(&device, now_us);

		require(deadline_us > now_us);
		now_us = deadline_us < end_us ? deadline_us : end_us;
	}
}

static double take_number(struct input *in, uint8_t kind, double unit)
{
	int16_t steps;
	double any;

	if (kind & 0x80) {
		take_bytes(in, &any, sizeof(any));
		return any;
	}
	take_bytes(in, &steps, sizeof(steps));
	return steps * unit;
}

static struct vec3 take_vector(struct input *in, uint8_t kind, double unit)
{
	return (struct vec3){take_number(in, kind, unit), take_number(in, kind, unit), take_number(in, kind, unit)};
}

/* One sample, and the same again and again, so that there is some rest. */
static void samples(struct input *in)
{
	uint8_t kind = take(in), count = take(in) % BURST_MAX;
	struct imu_sample s = {.flags = take(in) & 0x3F,
		.gyro_rad_s = take_vector(in, kind, 0.001),
		.accel_m_s2 = take_vector(in, kind, 0.01),
		.mag_uT = take_vector(in, kind, 0.1),
		.ref_accel_b_m_s2 = take_vector(in, kind, 0.01),
		.temperature_degC = take_number(in, kind, 0.1)};

	for (int i = 0; i <= count; i++) {
		now_us += INTERVAL_US;
		s.t_us = now_us;
		device_sample(&device, 1, &s, now_us);
		tick();
	}
}

/* A value for any object, as a client, another RPDO mapping or Modbus might write it. */
static void write_object(struct input *in)
{
	uint16_t number = (uint16_t)(take(in) | take(in) << 8);
	const struct od_entry *entry = &imu9_od_table.entries[number % imu9_od_table.count];
	uint8_t value[OD_VALUE_MAX];
	float real;

	take_bytes(in, value, entry->size);
	if (entry->type == OD_REAL32 && value[3] & 1) { /* often one that means something */
		real = (float)(int16_t)(value[0] | value[1] << 8) / 256;
		memcpy(value, &real, sizeof(real));
	}
	if (entry->index == 0x1010 || entry->index == 0x1011)
		memcpy(value, entry->index == 0x1010 ? "save" : "load", 4);
	(void)od_write(&device.od, entry->index, entry->sub, value, entry->size);
}

/* The configuration with some bytes changed: taken as a whole, or all is as it was. */
static void write_snapshot(struct input *in)
{
	static uint8_t snapshot[OD_DOMAIN_MAX], before[OD_DOMAIN_MAX], after[OD_DOMAIN_MAX];
	size_t size = snapshot_encode(&device.od, NODE_ID, snapshot);
	size_t before_size = snapshot_encode(&device.od, NODE_ID, before);

	for (int i = take(in) & 7; i > 0; i--)
		snapshot[(size_t)(take(in) | take(in) << 8) % size] = take(in);
	if (od_write(&device.od, 0x2130, 0, snapshot, size) == OD_OK)
		return;
	require(snapshot_encode(&device.od, NODE_ID, after) == before_size);
	require(memcmp(before, after, before_size) == 0);
}

static void receive(struct input *in)
{
	static const uint32_t ids[] = {0x000, 0x080, 0x100, 0x7E5, 0x600 + NODE_ID, 0x600 + NODE_ID, 0x200 + NODE_ID,
		0x300 + NODE_ID, 0x400 + NODE_ID, 0x500 + NODE_ID, 0x700 + NODE_ID, 0x720, 0x180 + NODE_ID};
	static const uint8_t lengths[] = {2, 0, 6, 8, 8, 8, 8, 8, 8, 2, 1, 1, 8};
	uint8_t kind = take(in), which = (kind & 0x0F) % (sizeof(ids) / sizeof(ids[0]));
	struct can_msg msg = {.id = ids[which], .len = lengths[which], .remote = (kind & 0xC0) == 0xC0, .t_us = now_us};

	if (kind & 0x20)
		msg.len = take(in) % 9;
	if (kind & 0x10)
		msg.id = (uint32_t)(take(in) << 8 | take(in)) & 0x7FF;
	take_bytes(in, msg.data, msg.len);
	device_receive(&device, &msg, now_us);
}

static void misfortune(struct input *in)
{
	static const int answers[] = {0, -EINPROGRESS, -EIO};
	uint8_t kind = take(in);

	switch (kind & 7) {
	case 0:
		device_sample(&device, -EIO, NULL, now_us);
		break;
	case 1:
		bus.state = (enum can_state)((kind >> 3) % (CAN_STATE_DOWN + 1));
		break;
	case 2:
		bus.counters.tx_dropped++;
		bus.traffic.frames += kind;
		break;
	case 3:
		device_host_clock(&device, kind & 8, (int64_t)((uint64_t)take(in) << take(in) % 56));
		break;
	case 4:
		disk_answer = answers[(kind >> 3) % 3];
		break;
	case 5:
		imu.health.fault = kind >> 3 & 7;
		break;
	case 6:
		device_saved(&device, kind & 8 ? -EIO : 0, now_us);
		break;
	default:
		power_on();
		break;
	}
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct input in = {data, size};

	disk = (struct store_image){0};
	disk_answer = 0;
	now_us = 1000;
	power_on();
	while (in.size > 0) {
		switch (take(&in) & 7) {
		case 0:
			pass_time(&in);
			break;
		case 1:
			samples(&in);
			break;
		case 2:
		case 3:
			write_object(&in);
			break;
		case 4:
			write_snapshot(&in);
			break;
		case 5:
			misfortune(&in);
			break;
		default:
			receive(&in);
			break;
		}
		tick();
	}
	check_values();
	return 0;
}
