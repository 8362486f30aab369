/* The whole device with arbitrary frames, writes, configuration snapshots, samples, clock changes and power cycles.
 * The input is a sequence of steps, each an operation byte and its arguments. Checked: frames and deadlines are
 * valid, and at the end every value has the type and limits of its entry. */
#include <errno.h>
#include <string.h>

#include "gateway/device.h"
#include "gateway/log.h"
#include "gateway/snapshot.h"
#include "tests/fuzz/fuzz_od.h"

enum { NODE_ID = 0x10, MAX_TICKS = 64, INTERVAL_US = 10000, BURST_MAX = 32 };

static struct device device;
static struct can_port bus;
static struct imu_port imu;
static struct store_image disk;
static int disk_answer;
static uint64_t now_us;

/* Replaces gateway/log.c: the log lines are not checked and would slow the fuzzer down. */
void log_at(int severity, const char *format, ...)
{
	(void)severity;
	(void)format;
}

/* ---- bus, storage and power ------------------------------------------------------------------------------------- */

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

/* ---- steps ------------------------------------------------------------------------------------------------------- */

static void tick(void)
{
	require(device_tick(&device, now_us) > now_us);
}

static void pass_time(struct input *in)
{
	uint64_t end_us = now_us + ((uint64_t)read_byte(in) << (read_byte(in) & 15));

	for (int i = 0; i < MAX_TICKS && now_us < end_us; i++) {
		uint64_t deadline_us = device_tick(&device, now_us);

		require(deadline_us > now_us);
		now_us = deadline_us < end_us ? deadline_us : end_us;
	}
}

static double read_number(struct input *in, uint8_t kind, double unit)
{
	int16_t steps;
	double any;

	if (kind & 0x80) {
		read_bytes(in, &any, sizeof(any));
		return any;
	}
	read_bytes(in, &steps, sizeof(steps));
	return steps * unit;
}

static struct vec3 read_vector(struct input *in, uint8_t kind, double unit)
{
	return (struct vec3){read_number(in, kind, unit), read_number(in, kind, unit), read_number(in, kind, unit)};
}

/* One sample, repeated, so that the rest detector is reached. */
static void samples(struct input *in)
{
	uint8_t kind = read_byte(in), count = read_byte(in) % BURST_MAX;
	struct imu_sample s = {.flags = read_byte(in) & 0x3F,
		.gyro_rad_s = read_vector(in, kind, 0.001),
		.accel_m_s2 = read_vector(in, kind, 0.01),
		.mag_uT = read_vector(in, kind, 0.1),
		.ref_accel_b_m_s2 = read_vector(in, kind, 0.01),
		.temperature_degC = read_number(in, kind, 0.1)};

	for (int i = 0; i <= count; i++) {
		now_us += INTERVAL_US;
		s.t_us = now_us;
		device_sample(&device, 1, &s, now_us);
		tick();
	}
}

/* A value for any object, as an SDO client, an RPDO or Modbus can write it. */
static void write_object(struct input *in)
{
	uint16_t number = (uint16_t)(read_byte(in) | read_byte(in) << 8);
	const struct od_entry *entry = &imu9_od_table.entries[number % imu9_od_table.count];
	uint8_t value[OD_VALUE_MAX];
	float real;

	read_bytes(in, value, entry->size);
	if (entry->type == OD_REAL32 && value[3] & 1) { /* often a number of plausible size */
		real = (float)(int16_t)(value[0] | value[1] << 8) / 256;
		memcpy(value, &real, sizeof(real));
	}
	if (entry->index == 0x1010 || entry->index == 0x1011)
		memcpy(value, entry->index == 0x1010 ? "save" : "load", 4);
	(void)od_write(&device.od, entry->index, entry->sub, value, entry->size);
}

/* A configuration snapshot with some bytes changed is applied completely or not at all. */
static void write_snapshot(struct input *in)
{
	static uint8_t snapshot[OD_DOMAIN_MAX], before[OD_DOMAIN_MAX], after[OD_DOMAIN_MAX];
	size_t size = snapshot_encode(&device.od, NODE_ID, snapshot);
	size_t before_size = snapshot_encode(&device.od, NODE_ID, before);

	for (int i = read_byte(in) & 7; i > 0; i--)
		snapshot[(size_t)(read_byte(in) | read_byte(in) << 8) % size] = read_byte(in);
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
	uint8_t kind = read_byte(in), which = (kind & 0x0F) % (sizeof(ids) / sizeof(ids[0]));
	struct can_msg msg = {.id = ids[which], .len = lengths[which], .remote = (kind & 0xC0) == 0xC0, .t_us = now_us};

	if (kind & 0x20)
		msg.len = read_byte(in) % 9;
	if (kind & 0x10)
		msg.id = (uint32_t)(read_byte(in) << 8 | read_byte(in)) & 0x7FF;
	read_bytes(in, msg.data, msg.len);
	device_receive(&device, &msg, now_us);
}

static void inject_fault(struct input *in)
{
	static const int answers[] = {0, -EINPROGRESS, -EIO};
	uint8_t kind = read_byte(in);

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
		device_host_clock(&device, kind & 8, (int64_t)((uint64_t)read_byte(in) << read_byte(in) % 56));
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

/* The device as delivered, just started. A start takes as long as many steps, so it is made once. */
static void start(void)
{
	static struct device started;
	static struct can_port started_bus;
	static struct imu_port started_imu;
	static bool made;

	disk = (struct store_image){0};
	disk_answer = 0;
	now_us = 1000;
	if (!made) {
		power_on();
		started = device;
		started_bus = bus;
		started_imu = imu;
		made = true;
	}
	device = started;
	bus = started_bus;
	imu = started_imu;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct input in = {data, size};

	start();
	while (in.size > 0) {
		switch (read_byte(&in) & 7) {
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
			inject_fault(&in);
			break;
		default:
			receive(&in);
			break;
		}
		tick();
	}
	require_valid_values(&device.od);
	return 0;
}
