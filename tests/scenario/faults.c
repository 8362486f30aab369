#include "tests/scenario/faults.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "model/math/quat.h"
#include "model/math/units.h"
#include "od/little_endian.h"

enum { STEP_US = 10000, STEPS_S = 100, NODE = WORLD_NODE_ID };
enum { TPDO1 = 0x180 + NODE, TPDO4 = 0x480 + NODE, RPDO1 = 0x200 + NODE, RPDO4 = 0x500 + NODE };
enum { EMCY_ID = 0x080 + NODE, REQUEST = 0x600 + NODE, RESPONSE = 0x580 + NODE, HEARTBEAT = 0x700 + NODE };

#define HOUR_US UINT64_C(3600000000)
static const int64_t HOST_OFFSET_US = INT64_C(1795953600000000);

/* bits of the status word, gateway/README.md */
enum {
	VALID = 1 << 0,
	REST = 1 << 1,
	FIELD_USED = 1 << 2,
	GAP = 1 << 4,
	UNSURE = 1 << 5,
	SATURATED = 1 << 8,
	LOST = 1 << 9
};
enum { CHIP_FAULT = 1 << 10, AIDED = 1 << 11, UTC = 1 << 13, FORCE_DOUBTED = 1 << 14 };

/* ---- the bus ----------------------------------------------------------------------------------------------------- */

static bool connected(const struct site *s)
{
	return s->world.bus.state != CAN_STATE_BUS_OFF && s->world.bus.state != CAN_STATE_DOWN;
}

static void note_emcy(struct site *s, const struct can_msg *msg)
{
	if (s->emcy_count < SITE_EMCYS)
		memcpy(s->emcy[s->emcy_count].data, msg->data, 8);
	s->emcy_count++;
	s->last_emcy = get_u16(msg->data);
}

static int send(struct can_port *port, const struct can_msg *msg)
{
	struct site *s = (struct site *)port;

	if (msg->id == HEARTBEAT && msg->data[0] == 0) /* also when it is lost: the next heartbeat is of this start */
		s->last_emcy = 0;
	if (port->state == CAN_STATE_DOWN)
		return -ENETDOWN;
	if (s->full || port->state == CAN_STATE_BUS_OFF)
		return -ENOBUFS;
	if ((msg->id & 0x7F) == NODE && msg->id >= TPDO1 && msg->id <= TPDO4 && msg->id != RESPONSE)
		s->tpdos[(msg->id - TPDO1) / 0x100] += (msg->id & 0x80) != 0;
	if (msg->id == HEARTBEAT)
		s->heartbeats++;
	if (msg->id == EMCY_ID)
		note_emcy(s, msg);
	if (msg->id == RESPONSE)
		s->sdo = *msg;
	return 0;
}

static int restart(struct can_port *port)
{
	struct site *s = (struct site *)port;

	port->state = CAN_STATE_ACTIVE;
	s->off_us = s->off_again ? s->world.now_us + 2 * STEP_US : 0;
	return 0;
}

static int filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	(void)port, (void)ids, (void)n;
	return 0;
}

/* The device has it, and was not called since. */
static void hand_over(struct site *s, const struct can_msg *msg)
{
	enum nmt_state before = s->world.device.canopen.nmt.state;
	bool disk_waited = s->world.disk_waits;

	if (!connected(s))
		return;
	device_receive(&s->world.device, msg, s->world.now_us);
	if (s->heard)
		s->heard(s, msg, before, disk_waited);
}

void site_send_msg(struct site *s, const struct can_msg *msg)
{
	hand_over(s, msg);
	device_tick(&s->world.device, s->world.now_us);
}

static struct can_msg frame(const struct site *s, uint32_t id, size_t len, const void *data)
{
	struct can_msg msg = {.id = id, .len = (uint8_t)len, .t_us = s->world.now_us};

	if (len)
		memcpy(msg.data, data, len);
	return msg;
}

void site_send(struct site *s, uint32_t id, size_t len, const void *data)
{
	struct can_msg msg = frame(s, id, len, data);

	site_send_msg(s, &msg);
}

static void send_sync(struct site *s, size_t len, uint64_t age_us)
{
	struct can_msg msg = {.id = 0x080, .len = (uint8_t)len, .t_us = s->world.now_us - age_us};

	hand_over(s, &msg);
}

void site_set_real(struct site *s, uint16_t index, uint8_t sub, float value)
{
	uint8_t wire[4];

	memcpy(wire, &value, 4);
	assert_int_equal(device_write(&s->world.device, index, sub, wire, 4, s->world.now_us), OD_OK);
}

bool site_read(struct site *s, uint16_t index, uint8_t sub, uint32_t *value)
{
	s->sdo = (struct can_msg){0};
	site_send(s, REQUEST, 8, (const uint8_t[8]){0x40, (uint8_t)index, (uint8_t)(index >> 8), sub});
	*value = get_u32(s->sdo.data + 4);
	return (s->sdo.data[0] & 0xE3) == 0x43 && get_u16(s->sdo.data + 1) == index && s->sdo.data[3] == sub;
}

/* ---- time -------------------------------------------------------------------------------------------------------- */

/* The device is called at its deadlines. */
static void pass(struct site *s, uint64_t us)
{
	struct world *w = &s->world;
	uint64_t end_us = w->now_us + us;

	for (;;) {
		uint64_t next_us = device_tick(&w->device, w->now_us);
		uint64_t port_us = can_service(&w->bus, w->now_us);

		next_us = port_us < next_us ? port_us : next_us;
		assert_true(next_us > w->now_us);
		if (next_us >= end_us)
			break;
		w->now_us = next_us;
	}
	w->now_us = end_us;
}

void site_wait(struct site *s, uint64_t us)
{
	assert_true(s->waited_us + us < STEP_US);
	pass(s, us);
	s->waited_us += us;
}

static void measure(struct site *s)
{
	struct imu_sample sample;
	bool there = true;

	sensor_next(&s->world.sensor, s->world.signal, &sample, NULL);
	sample.t_us += s->sensor_offset_us;
	for (size_t i = 0; there && i < s->fault_count; i++)
		there = !s->faults[i]->sample || s->faults[i]->sample(s, &sample);
	if (there)
		device_sample(&s->world.device, 1, &sample, s->world.now_us);
}

/* The thread that writes the store needs 30 ms. */
static void write_to_disk(struct site *s)
{
	if (!s->world.disk_waits || ++s->disk_steps < 3)
		return;
	s->disk_steps = 0;
	s->world.disk_waits = false;
	if (s->disk_result == 0) {
		s->world.disk = s->world.to_disk;
		s->saves++;
	}
	device_saved(&s->world.device, s->disk_result, s->world.now_us);
	if (s->saved)
		s->saved(s);
}

static void repair(struct site *s)
{
	const struct od_values *v = &s->world.device.values;
	const uint8_t yes = 1;

	if (s->world.device.canopen.nmt.state != NMT_OPERATIONAL)
		site_send(s, 0x000, 2, (const uint8_t[2]){1, NODE});
	if (canopen_lss_active(&s->world.device.canopen))
		site_send(s, 0x7E5, 8, (const uint8_t[8]){0x04, 0});
	if (v->sample.status & SATURATED)
		assert_int_equal(device_write(&s->world.device, 0x2040, 6, &yes, 1, s->world.now_us), OD_OK);
}

static void send_the_rest(struct site *s)
{
	if (s->heartbeat)
		site_send(s, 0x700 + SITE_OTHER_NODE, 1, (const uint8_t[1]){0x05});
	if (s->velocity)
		site_send(s, RPDO1, 8, (const uint8_t[8]){0});
	if (s->master_repairs)
		repair(s);
}

static void step(struct site *s)
{
	pass(s, STEP_US - s->waited_us);
	s->waited_us = 0;
	if (s->off_us && s->world.now_us >= s->off_us) {
		s->off_us = 0;
		s->world.bus.state = CAN_STATE_BUS_OFF;
	}
	for (size_t i = 0; i < s->fault_count; i++)
		if (s->faults[i]->each)
			s->faults[i]->each(s);
	measure(s);
	write_to_disk(s);
	if (s->sync)
		send_sync(s, 0, s->age_us);
	if (s->steps % (STEPS_S / 10) == 0)
		send_the_rest(s);
	if (s->steps % STEPS_S == 0)
		device_host_clock(&s->world.device, s->host_synchronised, s->host_offset_us);
	s->steps++;
}

void site_run(struct site *s, double seconds)
{
	for (int i = (int)lround(seconds * STEPS_S); i > 0; i--)
		step(s);
}

/* ---- faults of the sensor ---------------------------------------------------------------------------------------- */

static bool no_sample(struct site *s, struct imu_sample *sample)
{
	(void)s, (void)sample;
	return false;
}

static void chip_has(struct site *s, enum imu_fault fault, enum imu_chip chip)
{
	s->world.imu.health.fault = (uint8_t)fault;
	s->world.imu.health.fault_chip = (uint8_t)chip;
}

static void gyro_silent(struct site *s)
{
	chip_has(s, IMU_FAULT_SILENT, IMU_CHIP_GYRO);
}

static void accelerometer_frozen(struct site *s)
{
	chip_has(s, IMU_FAULT_FROZEN, IMU_CHIP_ACCEL);
}

static void configuration_lost(struct site *s)
{
	chip_has(s, IMU_FAULT_CONFIGURATION, IMU_CHIP_GYRO);
}

static void chips_healthy(struct site *s)
{
	chip_has(s, IMU_FAULT_NONE, (enum imu_chip)0);
}

static bool read_fails(struct site *s, struct imu_sample *sample)
{
	(void)sample;
	device_sample(&s->world.device, -EIO, NULL, s->world.now_us);
	return false;
}

static void magnetometer_frozen(struct site *s)
{
	s->world.imu.health.degraded = IMU_FAULT_FROZEN;
	s->world.imu.health.degraded_chip = IMU_CHIP_MAG;
}

static void magnetometer_healthy(struct site *s)
{
	s->world.imu.health.degraded = s->world.imu.health.degraded_chip = 0;
}

static bool no_field(struct site *s, struct imu_sample *sample)
{
	(void)s;
	sample->flags &= ~(unsigned)SAMPLE_MAG;
	return true;
}

/* Shocks to and fro, of a chip of 2 g. */
static bool clipped(struct site *s, struct imu_sample *sample)
{
	if (s->steps % 5)
		return true;
	sample->accel_m_s2.x = s->steps % 2 ? 19.6 : -19.6;
	sample->flags |= SAMPLE_SATURATED;
	return true;
}

static bool not_a_number(struct site *s, struct imu_sample *sample)
{
	(void)s;
	sample->gyro_rad_s.y = NAN;
	return true;
}

static bool sometimes_not_a_number(struct site *s, struct imu_sample *sample)
{
	if (s->steps % 7 == 0)
		sample->accel_m_s2.z = NAN;
	return true;
}

static bool beyond_any_range(struct site *s, struct imu_sample *sample)
{
	(void)s;
	sample->accel_m_s2 = (struct vec3){1e30, -1e30, 1e30};
	return true;
}

static bool every_other_lost(struct site *s, struct imu_sample *sample)
{
	(void)sample;
	return s->steps % 2;
}

/* The clock of the sensor stands still. */
static bool time_stands(struct site *s, struct imu_sample *sample)
{
	(void)s;
	sample->t_us = 1000;
	return true;
}

static void time_leaps(struct site *s)
{
	s->sensor_offset_us += HOUR_US;
}

/* The clock of the sensor goes back, and its driver does not say so. */
static void time_returns(struct site *s)
{
	s->sensor_offset_us -= 5 * UINT64_C(1000000);
}

/* One time stamp is far ahead of all that follow. */
static void stamp_next(struct site *s)
{
	s->stamp_ahead = true;
}

static bool one_time_ahead(struct site *s, struct imu_sample *sample)
{
	if (s->stamp_ahead)
		sample->t_us += HOUR_US;
	s->stamp_ahead = false;
	return true;
}

/* The driver's clock began anew, which it says (drivers/ports/imu.h). */
static bool time_restarts(struct site *s, struct imu_sample *sample)
{
	(void)s;
	sample->flags |= SAMPLE_DISCONTINUITY;
	return true;
}

/* ---- faults of SYNC ---------------------------------------------------------------------------------------------- */

static void no_sync(struct site *s)
{
	s->sync = false;
}

static void sync_again(struct site *s)
{
	s->sync = true;
}

static void second_sync(struct site *s)
{
	send_sync(s, 0, 0);
}

static void long_sync(struct site *s)
{
	send_sync(s, 1, 0);
}

static void late_syncs(struct site *s)
{
	s->age_us = 8000;
}

static void syncs_in_time(struct site *s)
{
	s->age_us = 0;
}

/* ---- faults of the bus ------------------------------------------------------------------------------------------- */

static void set_bus(struct site *s, enum can_state state)
{
	s->world.bus.state = state;
}

static void error_passive(struct site *s)
{
	if (connected(s))
		set_bus(s, CAN_STATE_PASSIVE);
}

static void error_active(struct site *s)
{
	if (s->world.bus.state == CAN_STATE_PASSIVE)
		set_bus(s, CAN_STATE_ACTIVE);
}

/* As controllers do: by way of error passive. */
static void bus_off(struct site *s)
{
	if (!connected(s))
		return;
	set_bus(s, CAN_STATE_PASSIVE);
	device_tick(&s->world.device, s->world.now_us);
	set_bus(s, CAN_STATE_BUS_OFF);
}

static void bus_off_storm(struct site *s)
{
	s->off_again = true;
	bus_off(s);
}

static void storm_over(struct site *s)
{
	s->off_again = false;
	s->off_us = 0;
}

static void interface_down(struct site *s)
{
	set_bus(s, CAN_STATE_DOWN);
}

static void interface_up(struct site *s)
{
	if (s->world.bus.state == CAN_STATE_DOWN)
		set_bus(s, CAN_STATE_ACTIVE);
}

static void bus_full(struct site *s)
{
	s->full = true;
}

static void bus_has_room(struct site *s)
{
	s->full = false;
}

static void own_tpdo_of_another(struct site *s)
{
	site_send(s, TPDO1, 8, (const uint8_t[8]){1, 2, 3, 4, 5, 6, 7, 8});
}

static void own_heartbeat_of_another(struct site *s)
{
	site_send(s, HEARTBEAT, 1, (const uint8_t[1]){0x7F});
}

static void no_heartbeat(struct site *s)
{
	s->heartbeat = false;
}

static void heartbeat_again(struct site *s)
{
	s->heartbeat = true;
}

/* ---- faults of process data -------------------------------------------------------------------------------------- */

static void short_rpdo(struct site *s)
{
	site_send(s, RPDO1, 5, (const uint8_t[8]){0});
}

static void long_rpdo(struct site *s)
{
	site_send(s, RPDO4, 3, (const uint8_t[8]){0});
}

static void refused_rpdo(struct site *s)
{
	site_send(s, RPDO4, 2, (const uint8_t[8]){0x08});
}

/* What ends them: a correct one. */
static void correct_rpdos(struct site *s)
{
	site_send(s, RPDO1, 8, (const uint8_t[8]){0});
	site_send(s, RPDO4, 2, (const uint8_t[8]){0});
}

static void no_velocity(struct site *s)
{
	s->velocity = false;
}

static void velocity_again(struct site *s)
{
	s->velocity = true;
}

static void velocity_flood(struct site *s)
{
	for (int i = 0; i < 50; i++) /* 5000 a second: 0 m/s, 1 sigma 1 m/s */
		site_send(s, RPDO1, 8, (const uint8_t[8]){0, 0, 0, 0, 0, 0, 0xE8, 0x03});
}

/* ---- faults of clients ------------------------------------------------------------------------------------------- */

/* Transfers that begin and are not continued, and frames that fit none. */
static void broken_client(struct site *s)
{
	static const uint8_t requests[][8] = {
		{0x21, 0x30, 0x21, 0, 100},  /* segmented download of 2130h */
		{0xA4, 0x21, 0x10, 0, 127},  /* block upload of the EDS */
		{0xA3},			     /* its start: 127 segments, none is confirmed */
		{0xC6, 0x30, 0x21, 0, 0, 1}, /* block download */
		{0x05, 1, 2, 3, 4, 5, 6, 7}, /* a segment of it */
		{0x70},			     /* a segment of no transfer */
		{0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF}, {0x2F, 0x00, 0x10, 0, 1}, /* a write of a constant */
	};

	site_send(s, REQUEST, 8, requests[s->steps % (sizeof(requests) / sizeof(requests[0]))]);
}

static void impatient_client(struct site *s)
{
	const struct can_msg msg = {.id = REQUEST, .len = 8, .data = {0x40, 0x00, 0x10}, .t_us = s->world.now_us};

	for (int i = 0; i < 40; i++)
		hand_over(s, &msg);
}

static void short_request(struct site *s)
{
	site_send(s, REQUEST, 4, (const uint8_t[8]){0x40, 0x00, 0x10});
}

static void left_in_lss(struct site *s)
{
	site_send(s, 0x7E5, 8, (const uint8_t[8]){0x04, 1});
}

static void nmt_of_others(struct site *s)
{
	static const uint8_t commands[][2] = {{2, 99}, {0x81, 17}, {0x82, 15}, {0x03, NODE}, {0xFF, 0}, {0x80, 5}};

	site_send(s, 0x000, 2, commands[s->steps % (sizeof(commands) / sizeof(commands[0]))]);
}

static void garbage(struct site *s)
{
	uint8_t data[8];

	for (int i = 0; i < 8; i++)
		data[i] = (uint8_t)(s->seed = s->seed * 1664525u + 1013904223u, s->seed >> 24);
	site_send(s, 0x100 + data[0] % 0x80u, data[1] % 9u, data); /* of no service of this node, but TIME (1012h) */
	site_send(s, 0x780 + data[2] % 0x60u, data[3] % 9u, data);
}

static void reset_node(struct site *s)
{
	site_send(s, 0x000, 2, (const uint8_t[2]){0x81, NODE});
}

static void reset_communication(struct site *s)
{
	site_send(s, 0x000, 2, (const uint8_t[2]){0x82, NODE});
}

/* ---- faults of the host ------------------------------------------------------------------------------------------ */

static void store_repeatedly(struct site *s)
{
	if (s->steps % 20 == 0)
		site_send(s, REQUEST, 8, (const uint8_t[8]){0x23, 0x10, 0x10, 1, 's', 'a', 'v', 'e'});
}

static void disk_full(struct site *s)
{
	s->disk_result = -ENOSPC;
}

static void disk_has_room(struct site *s)
{
	s->disk_result = 0;
}

static void clock_steps_on(struct site *s)
{
	s->host_offset_us += (int64_t)HOUR_US;
}

static void clock_steps_back(struct site *s)
{
	s->host_offset_us -= (int64_t)HOUR_US;
}

static void clock_free(struct site *s)
{
	s->host_synchronised = false;
}

static void clock_synchronised(struct site *s)
{
	s->host_synchronised = true;
}

/* The process, its driver's thread included, does not run for 0.25 s. Then it finds 25 SYNCs in the socket. */
static void process_stopped(struct site *s)
{
	enum { STEPS = 25 };
	struct can_msg heartbeat = {.id = 0x700 + SITE_OTHER_NODE, .len = 1, .data = {5}};
	struct can_msg velocity = {.id = RPDO1, .len = 8};
	struct world *w = &s->world;

	w->now_us += STEPS * STEP_US;
	s->sensor_offset_us += STEPS * STEP_US;
	for (unsigned i = 0; i < STEPS && s->sync; i++)
		send_sync(s, 0, (STEPS - i) * STEP_US);
	if (s->heartbeat)
		hand_over(s, &heartbeat);
	if (s->velocity)
		hand_over(s, &velocity);
	device_away(&w->device, STEPS * STEP_US, w->now_us);
	device_tick(&w->device, w->now_us);
}

/* ---- faults of the configuration --------------------------------------------------------------------------------- */

static void singular_calibration(struct site *s)
{
	site_set_real(s, 0x2051, 4, 0); /* xx of the accelerometer */
}

static void good_calibration(struct site *s)
{
	site_set_real(s, 0x2051, 4, 1);
}

static int configure(struct imu_port *port, const struct imu_settings *settings, int dry, char *error, size_t size)
{
	(void)port, (void)dry, (void)error, (void)size;
	return settings->rate_hz > 800 ? -EINVAL : 0;
}

static void impossible_rate(struct site *s)
{
	site_set_real(s, 0x2058, 1, 5000);
}

static void possible_rate(struct site *s)
{
	site_set_real(s, 0x2058, 1, 100);
}

static void tight_sigma_limit(struct site *s)
{
	site_set_real(s, 0x2040, 9, 1e-6f);
}

static void no_sigma_limit(struct site *s)
{
	site_set_real(s, 0x2040, 9, 0);
}

static void tight_slope_range(struct site *s)
{
	site_set_real(s, 0x2119, 1, 1e-6f);
}

static void no_slope_range(struct site *s)
{
	site_set_real(s, 0x2119, 1, 0);
}

static void tight_lateral_range(struct site *s)
{
	site_set_real(s, 0x2119, 2, 1e-6f);
}

static void no_lateral_range(struct site *s)
{
	site_set_real(s, 0x2119, 2, 0);
}

/* ---- the list ---------------------------------------------------------------------------------------------------- */

const struct fault FAULTS[] = {
	{.name = "the sensor is silent",
		.sample = no_sample,
		.seen_s = 0.15,
		.code = 0x5030,
		.error_register = 0x81,
		.set = LOST,
		.clear = VALID,
		.log = "no samples from sensor: EMCY 5030h, outputs marked invalid",
		.over = "samples from sensor resumed",
		.over_s = 0.02,
		.recovered_s = 3,
		.needs = SAMPLES,
		.takes = SAMPLES},
	{.name = "the gyro does not answer",
		.begin = gyro_silent,
		.sample = read_fails,
		.end = chips_healthy,
		.seen_s = 0.05,
		.code = 0x5030,
		.error_register = 0x81,
		.info = {1, 1},
		.set = LOST | CHIP_FAULT,
		.clear = VALID,
		.log = "no samples from sensor: the gyro does not answer: EMCY 5030h",
		.over = "samples from sensor resumed",
		.over_s = 0.02,
		.recovered_s = 3,
		.needs = SAMPLES,
		.takes = SAMPLES},
	{.name = "the accelerometer is frozen",
		.begin = accelerometer_frozen,
		.sample = read_fails,
		.end = chips_healthy,
		.seen_s = 0.05,
		.code = 0x5030,
		.error_register = 0x81,
		.info = {3, 2},
		.set = LOST | CHIP_FAULT,
		.clear = VALID,
		.log = "no samples from sensor: the accelerometer repeats the same values: EMCY 5030h",
		.over = "samples from sensor resumed",
		.over_s = 0.02,
		.recovered_s = 3,
		.needs = SAMPLES,
		.takes = SAMPLES},
	{.name = "the gyro has lost its configuration",
		.begin = configuration_lost,
		.sample = read_fails,
		.end = chips_healthy,
		.seen_s = 0.05,
		.code = 0x5030,
		.error_register = 0x81,
		.info = {5, 1},
		.set = LOST | CHIP_FAULT,
		.clear = VALID,
		.log = "no samples from sensor: the gyro has lost its configuration: EMCY 5030h",
		.over = "samples from sensor resumed",
		.over_s = 0.02,
		.recovered_s = 3,
		.needs = SAMPLES,
		.takes = SAMPLES},
	{.name = "the magnetometer is frozen",
		.begin = magnetometer_frozen,
		.sample = no_field,
		.end = magnetometer_healthy,
		.seen_s = 1.1,
		.code = 0x5031,
		.error_register = 0x81,
		.info = {3, 3},
		.set = CHIP_FAULT,
		.clear = FIELD_USED,
		.log = "the magnetometer repeats the same values: EMCY 5031h, samples continue",
		.over = "the magnetometer has recovered",
		.over_s = 0.02,
		.recovered_s = 1,
		.needs = SAMPLES},
	{.name = "no magnetic field is measured",
		.sample = no_field,
		.seen_s = 1.1,
		.clear = FIELD_USED,
		.recovered_s = 1,
		.needs = SAMPLES},
	{.name = "the accelerometer is at the end of its range",
		.sample = clipped,
		.seen_s = 0.1,
		.set = FORCE_DOUBTED,
		.recovered_s = 12,
		.lingering = FORCE_DOUBTED | FIELD_USED,
		.lingering_s = 60,
		.needs = SAMPLES},
	{.name = "a rate is not a number",
		.sample = not_a_number,
		.seen_s = 0.15,
		.code = 0x5030,
		.error_register = 0x81,
		.set = LOST,
		.clear = VALID,
		.log = "no samples from sensor: EMCY 5030h, outputs marked invalid",
		.over = "samples from sensor resumed",
		.over_s = 0.02,
		.recovered_s = 3,
		.needs = SAMPLES,
		.takes = SAMPLES},
	{.name = "one force of seven is not a number",
		.sample = sometimes_not_a_number,
		.seen_s = 0.1,
		.set = VALID,
		.recovered_s = 0.5,
		.needs = SAMPLES},
	{.name = "a force is beyond any range",
		.sample = beyond_any_range,
		.seen_s = 0.15,
		.code = 0x5030,
		.error_register = 0x81,
		.set = LOST,
		.clear = VALID,
		.log = "no samples from sensor: EMCY 5030h, outputs marked invalid",
		.over = "samples from sensor resumed",
		.over_s = 0.02,
		.recovered_s = 3,
		.needs = SAMPLES,
		.takes = SAMPLES},
	{.name = "every other sample is lost",
		.sample = every_other_lost,
		.seen_s = 0.1,
		.set = VALID,
		.recovered_s = 0.5,
		.needs = SAMPLES},
	{.name = "the sensor's clock stands still",
		.sample = time_stands,
		.seen_s = 0.15,
		.code = 0x5030,
		.error_register = 0x81,
		.set = LOST,
		.clear = VALID,
		.log = "no samples from sensor: EMCY 5030h, outputs marked invalid",
		.over = "samples from sensor resumed",
		.over_s = 0.02,
		.recovered_s = 3,
		.needs = SAMPLES | SENSOR_TIME,
		.takes = SAMPLES},
	{.name = "the sensor's clock leaps an hour",
		.begin = time_leaps,
		.seen_s = 0.05,
		.set = VALID,
		.brief = true,
		.recovered_s = 4,
		.needs = SAMPLES,
		.takes = SENSOR_TIME},
	{.name = "the sensor's clock goes back 5 s",
		.begin = time_returns,
		.seen_s = 0.25,
		.code = 0x5030,
		.error_register = 0x81,
		.brief = true,
		.log = "no samples from sensor: EMCY 5030h, outputs marked invalid",
		.over = "samples from sensor resumed",
		.over_s = 0.02,
		.recovered_s = 4,
		.needs = SAMPLES | SENSOR_TIME,
		.takes = SENSOR_TIME},
	{.name = "a time stamp is an hour ahead",
		.begin = stamp_next,
		.sample = one_time_ahead,
		.seen_s = 0.25,
		.code = 0x5030,
		.error_register = 0x81,
		.brief = true,
		.log = "no samples from sensor: EMCY 5030h, outputs marked invalid",
		.over = "samples from sensor resumed",
		.over_s = 0.02,
		.recovered_s = 4,
		.needs = SAMPLES | SENSOR_TIME,
		.takes = SENSOR_TIME},
	{.name = "the sensor's clock begins again and again",
		.sample = time_restarts,
		.seen_s = 0.1,
		.set = VALID,
		.recovered_s = 4,
		.needs = SAMPLES,
		.takes = SENSOR_TIME},
	{.name = "SYNC is missing",
		.begin = no_sync,
		.end = sync_again,
		.seen_s = 0.03,
		.code = 0x8100,
		.error_register = 0x11,
		.info = {0x06, 0x10},
		.led = RED_TRIPLE,
		.over_s = 1,
		.recovered_s = 1,
		.needs = RECEPTION | OPERATIONAL | SYNCS,
		.takes = SYNCS},
	{.name = "SYNC comes twice",
		.each = second_sync,
		.seen_s = 0.1,
		.set = VALID,
		.needs = SAMPLES,
		.takes = SYNCS},
	{.name = "another SYNC is too long",
		.each = long_sync,
		.seen_s = 0.05,
		.code = 0x8240,
		.error_register = 0x11,
		.led = RED_TRIPLE,
		.over_s = 1.1,
		.recovered_s = 1.1,
		.needs = RECEPTION},
	{.name = "SYNC is processed late",
		.begin = late_syncs,
		.end = syncs_in_time,
		.seen_s = 0.05,
		.code = 0x8100,
		.error_register = 0x11,
		.info = {0x07, 0x10},
		.led = RED_TRIPLE,
		.over_s = 1,
		.recovered_s = 1,
		.needs = RECEPTION | OPERATIONAL | SYNCS,
		.takes = SYNCS},
	{.name = "the controller is error passive",
		.begin = error_passive,
		.end = error_active,
		.seen_s = 0.05,
		.code = 0x8120,
		.error_register = 0x11,
		.led = RED_SINGLE,
		.log = "can: error passive",
		.over = "can: error active",
		.over_s = 1,
		.recovered_s = 1,
		.needs = RECEPTION},
	{.name = "bus-off, once",
		.begin = bus_off,
		.seen_s = 0.03,
		.code = 0x8140,
		.error_register = 0x11,
		.also = {0x8120, 0x8130},
		.led = RED_ON,
		.pre_operational = true,
		.log = "can: bus-off",
		.over = "can: error active",
		.brief = true,
		.over_s = 1.2,
		.recovered_s = 1.2,
		.needs = RECEPTION,
		.takes = RECEPTION | OPERATIONAL},
	{.name = "bus-off after each restart",
		.begin = bus_off_storm,
		.end = storm_over,
		.seen_s = 0.03,
		.code = 0x8140,
		.error_register = 0x11,
		.also = {0x8120, 0x8130},
		.led = RED_ON,
		.pre_operational = true,
		.log = "can: bus-off",
		.over = "can: error active",
		.brief = true,
		.over_s = 3.3, /* the delay has doubled up to 1.6 s */
		.recovered_s = 3.3,
		.needs = RECEPTION,
		.takes = RECEPTION | OPERATIONAL},
	{.name = "the interface is down",
		.begin = interface_down,
		.end = interface_up,
		.seen_s = 0.03,
		.also = {0x8100, 0x8130, 0x8250},
		.led = RED_TRIPLE, /* there is no SYNC */
		.log = "can: down (ip link set ... up)",
		.over = "can: error active",
		.over_s = 1,
		.recovered_s = 1,
		.takes = RECEPTION | OPERATIONAL},
	{.name = "the bus accepts no frame",
		.begin = bus_full,
		.end = bus_has_room,
		.seen_s = 0.5,
		.code = 0x8110,
		.error_register = 0x11,
		.over_s = 1.1,
		.recovered_s = 1.1,
		.needs = RECEPTION | OPERATIONAL | SYNCS,
		.takes = SENDING},
	{.name = "another node sends TPDO1",
		.each = own_tpdo_of_another,
		.seen_s = 0.05,
		.code = 0x8150,
		.error_register = 0x11,
		.info = {0x90, 0x01},
		.log = "another node sends with COB-ID 190h of this node: is node-ID 16 assigned twice?",
		.over_s = 10.1,
		.recovered_s = 10.1,
		.needs = RECEPTION},
	{.name = "another node has this node-ID",
		.each = own_heartbeat_of_another,
		.seen_s = 0.05,
		.code = 0x8150,
		.error_register = 0x11,
		.info = {0x10, 0x07},
		.log = "another node sends with COB-ID 710h of this node: is node-ID 16 assigned twice?",
		.over_s = 10.1,
		.recovered_s = 10.1,
		.needs = RECEPTION},
	{.name = "a heartbeat is missing",
		.begin = no_heartbeat,
		.end = heartbeat_again,
		.seen_s = 0.42,
		.code = 0x8130,
		.error_register = 0x11,
		.info = {5},
		.led = RED_DOUBLE,
		.pre_operational = true,
		.log = "NMT state: pre-operational",
		.over_s = 1,
		.recovered_s = 1,
		.needs = HEARTBEATS,
		.takes = OPERATIONAL},
	{.name = "RPDO1 is too short",
		.each = short_rpdo,
		.end = correct_rpdos,
		.seen_s = 0.05,
		.code = 0x8210,
		.error_register = 0x11,
		.info = {0x00, 0x14, 5, 8},
		.over_s = 1.1,
		.recovered_s = 1.1,
		.needs = RECEPTION | OPERATIONAL},
	{.name = "RPDO4 is too long",
		.each = long_rpdo,
		.end = correct_rpdos,
		.seen_s = 0.05,
		.code = 0x8220,
		.error_register = 0x11,
		.info = {0x03, 0x14, 3, 2},
		.over_s = 10.1, /* or 1 s, when the correct one comes later than the last wrong one */
		.recovered_s = 10.1,
		.needs = RECEPTION | OPERATIONAL},
	{.name = "an object refuses the value of RPDO4",
		.each = refused_rpdo,
		.end = correct_rpdos,
		.seen_s = 0.05,
		.code = 0x8200,
		.error_register = 0x11,
		.info = {0x03, 0x14, 0x73, 0x20, 0},
		.over_s = 10.1,
		.recovered_s = 10.1,
		.needs = RECEPTION | OPERATIONAL},
	{.name = "RPDO1 is missing",
		.begin = no_velocity,
		.end = velocity_again,
		.seen_s = 0.42,
		.code = 0x8250,
		.error_register = 0x11,
		.info = {0x00, 0x14},
		.led = RED_QUADRUPLE,
		.over_s = 1.1,
		.recovered_s = 1.1,
		.needs = RECEPTION | OPERATIONAL | VELOCITIES},
	{.name = "5000 velocities a second",
		.each = velocity_flood,
		.seen_s = 0.1,
		.set = AIDED | VALID,
		.recovered_s = 1.1,
		.needs = SAMPLES | RECEPTION | OPERATIONAL,
		.takes = VELOCITIES},
	{.name = "an SDO client begins and does not continue",
		.each = broken_client,
		.seen_s = 0.1,
		.set = VALID,
		.recovered_s = 1.1,
		.needs = SAMPLES},
	{.name = "an SDO client does not wait for answers",
		.each = impatient_client,
		.seen_s = 0.1,
		.set = VALID,
		.log = "can: an SDO client sends requests without waiting for the answers",
		.needs = SAMPLES | RECEPTION,
		.takes = CLIENTS},
	{.name = "an SDO client sends 4 bytes",
		.each = short_request,
		.seen_s = 0.1,
		.set = VALID,
		.log = "can: an SDO request has fewer than 8 bytes",
		.needs = SAMPLES | RECEPTION},
	{.name = "a master leaves it in LSS configuration",
		.begin = left_in_lss,
		.each = left_in_lss,
		.seen_s = 0.05,
		.set = VALID,
		.led = RED_FLICKERING,
		.recovered_s = 0.2,
		.needs = SAMPLES | RECEPTION},
	{.name = "NMT commands for others, and unknown ones",
		.each = nmt_of_others,
		.seen_s = 0.1,
		.set = VALID,
		.needs = SAMPLES},
	{.name = "frames of no service", .each = garbage, .seen_s = 0.1, .set = VALID, .needs = SAMPLES},
	{.name = "reset node",
		.begin = reset_node,
		.seen_s = 0.05,
		.brief = true,
		.pre_operational = true,
		.log = "reset node",
		.recovered_s = 4,
		.needs = RECEPTION,
		.takes = SAMPLES | OPERATIONAL | CONFIGURATION | RECEPTION | HEARTBEATS},
	{.name = "reset communication",
		.begin = reset_communication,
		.seen_s = 0.05,
		.brief = true,
		.pre_operational = true,
		.log = "reset communication",
		.recovered_s = 0.5,
		.needs = RECEPTION,
		.takes = OPERATIONAL | RECEPTION | HEARTBEATS},
	{.name = "the disk is full at each store",
		.begin = disk_full,
		.each = store_repeatedly,
		.end = disk_has_room,
		.seen_s = 0.3,
		.set = VALID,
		.log = "values could not be stored: No space left on device",
		.needs = SAMPLES | RECEPTION | CLIENTS},
	{.name = "the host's clock is set an hour on",
		.begin = clock_steps_on,
		.seen_s = 1.1,
		.set = VALID | UTC,
		.needs = SAMPLES | HOST_CLOCK},
	{.name = "the host's clock is set an hour back",
		.begin = clock_steps_back,
		.seen_s = 1.1,
		.set = VALID | UTC,
		.needs = SAMPLES | HOST_CLOCK},
	{.name = "the host's clock is not synchronised",
		.begin = clock_free,
		.end = clock_synchronised,
		.seen_s = 1.1,
		.set = VALID,
		.clear = UTC,
		.recovered_s = 1.1,
		.needs = SAMPLES,
		.takes = HOST_CLOCK},
	{.name = "the process does not run for 0.25 s",
		.begin = process_stopped,
		.seen_s = 0.05,
		.code = 0x8100,
		.error_register = 0x11,
		.info = {0x07, 0x10},
		.brief = true,
		.over_s = 1,
		.recovered_s = 1,
		.needs = RECEPTION | OPERATIONAL | SYNCS | SAMPLES},
	{.name = "the calibration is singular",
		.begin = singular_calibration,
		.end = good_calibration,
		.seen_s = 0.05,
		.code = 0x6320,
		.error_register = 0x81,
		.set = VALID,
		.led = RED_BLINKING,
		.over_s = 0.02,
		.recovered_s = 0.5,
		.needs = SAMPLES | CONFIGURATION,
		.takes = VALID_SET},
	{.name = "the sensor does not have a rate",
		.begin = impossible_rate,
		.end = possible_rate,
		.seen_s = 0.05,
		.code = 0x6321,
		.error_register = 0x81,
		.set = VALID,
		.log = "the sensor does not support 2058h",
		.over_s = 0.02,
		.recovered_s = 0.5,
		.needs = SAMPLES | CONFIGURATION},
	{.name = "the position is less certain than wanted",
		.begin = tight_sigma_limit,
		.end = no_sigma_limit,
		.seen_s = 0.05,
		.code = 0xFF10,
		.error_register = 0x81,
		.set = VALID | UNSURE,
		.over_s = 0.02,
		.recovered_s = 0.5,
		.needs = SAMPLES | SENSOR_TIME | CONFIGURATION | VALID_SET},
	{.name = "the longitudinal slope is out of range",
		.begin = tight_slope_range,
		.end = no_slope_range,
		.seen_s = 0.05,
		.code = 0x5010,
		.error_register = 0x21,
		.set = VALID,
		.over_s = 0.02,
		.recovered_s = 0.5,
		.needs = SAMPLES | CONFIGURATION},
	{.name = "the lateral slope is out of range",
		.begin = tight_lateral_range,
		.end = no_lateral_range,
		.seen_s = 0.05,
		.code = 0x5020,
		.error_register = 0x21,
		.set = VALID,
		.over_s = 0.02,
		.recovered_s = 0.5,
		.needs = SAMPLES | CONFIGURATION},
};

const size_t FAULT_COUNT = sizeof(FAULTS) / sizeof(FAULTS[0]);

/* ---- life -------------------------------------------------------------------------------------------------------- */

void fault_begin(struct site *s, const struct fault *fault)
{
	assert_true(s->fault_count < SITE_FAULTS);
	s->faults[s->fault_count++] = fault;
	if (fault->begin)
		fault->begin(s);
}

void fault_end(struct site *s, const struct fault *fault)
{
	size_t i = 0;

	while (i < s->fault_count && s->faults[i] != fault)
		i++;
	assert_true(i < s->fault_count);
	s->fault_count--;
	memmove(&s->faults[i], &s->faults[i + 1], (s->fault_count - i) * sizeof(s->faults[0]));
	if (fault->end)
		fault->end(s);
}

void site_forget(struct site *s)
{
	memset(s->tpdos, 0, sizeof(s->tpdos));
	s->heartbeats = 0;
	s->emcy_count = 0;
}

void site_init(struct site *s, uint64_t seed)
{
	static const char *const settings[] = {"communication_cycle_period=10000", "synchronous_window_length=5000",
		"consumer_heartbeat_time.consumer_1=327980", /* node 5, 300 ms */
		"rpdo1_communication.event_timer=300", NULL};
	struct sensor_config sensor = *sensor_preset("lsm303dlhc_l3gd20");

	sensor_calibrate(&sensor);
	world_init(&s->world, &sensor, seed, "rest");
	s->can = (struct can_ops){.send = send, .filter = filter, .restart = restart};
	s->imu = (struct imu_ops){.configure = configure};
	s->world.bus.ops = &s->can;
	s->world.imu.ops = &s->imu;
	strcpy(s->world.bus.name, "can");
	s->world.disk_answer = -EINPROGRESS;
	s->seed = (uint32_t)seed;
	s->host_offset_us = HOST_OFFSET_US;
	s->host_synchronised = s->sync = s->heartbeat = s->velocity = s->master_repairs = true;
	world_power_on(&s->world, settings);
	site_run(s, 12);
	s->master_repairs = false;
	site_forget(s);
}

bool site_log_has(const struct site *s, const char *text)
{
	const struct event_log *log = &s->world.device.log;

	return memmem(log->text, log->used, text, strlen(text));
}

/* ---- as before --------------------------------------------------------------------------------------------------- */

/* Degrees between up as the device has it, and up. */
static double tilt_error_deg(const struct site *s)
{
	const struct od_values *v = &s->world.device.values;
	struct quat q = {
		(double)v->quaternion.w, (double)v->quaternion.x, (double)v->quaternion.y, (double)v->quaternion.z};
	struct signal_truth truth;
	struct vec3 up, true_up;

	signal_at(s->world.signal, 0, &truth);
	up = quat_rotate_inverse(q, (struct vec3){0, 0, 1});
	true_up = quat_rotate_inverse(truth.q_nb, (struct vec3){0, 0, 1});
	return acos(fmin(1, vec3_dot(up, true_up))) / RAD_PER_DEG;
}

/* 2117h less the clock of the host at the instant of the last sample, s. */
static double utc_error_s(const struct site *s)
{
	int64_t utc_us = (int64_t)s->world.device.values.utc.time;

	return fabs((double)(utc_us - s->host_offset_us - (int64_t)s->world.now_us)) * 1e-6;
}

const char *site_communicates(struct site *s)
{
	static char what[80];
	const struct od_values *v = &s->world.device.values;
	uint16_t counter = v->sample.counter;
	uint32_t value;

	if (s->last_emcy != 0) {
		snprintf(what, sizeof(what), "the last EMCY is %04Xh", s->last_emcy);
		return what;
	}
	site_forget(s);
	site_run(s, 1);
	for (int i = 0; i < 4; i++)
		if (s->tpdos[i] != STEPS_S) {
			snprintf(what, sizeof(what), "TPDO%d was sent %u times after 100 SYNCs", i + 1, s->tpdos[i]);
			return what;
		}
	if (s->heartbeats != 1)
		return "there is not one heartbeat a second";
	if (s->emcy_count) {
		snprintf(what, sizeof(what), "EMCY %04Xh", get_u16(s->emcy[0].data));
		return what;
	}
	if ((uint16_t)(v->sample.counter - counter) != STEPS_S)
		return "samples are not counted";
	if (!site_read(s, 0x1001, 0, &value) || (value & 0xFF) != 0)
		return "SDO does not answer, or the error register is not 0";
	if (s->world.device.canopen.nmt.state != NMT_OPERATIONAL || v->status_leds.error != RED_OFF ||
		v->status_leds.run != 1)
		return "NMT state or LEDs";
	return NULL;
}

const char *site_deviation(struct site *s, unsigned but)
{
	static char what[160];
	const struct od_values *v = &s->world.device.values;
	const char *wrong = site_communicates(s);

	if (wrong)
		return wrong;
	if ((v->sample.status | but) != (VALID | REST | FIELD_USED | UTC | but)) {
		snprintf(what, sizeof(what), "the status is %04Xh", v->sample.status);
		return what;
	}
	if (tilt_error_deg(s) > 1 || fabs((double)v->acceleration_object.l) > 0.3 ||
		fabs((double)v->acceleration_object.s) > 0.3 || fabs((double)v->acceleration_object.t) > 0.3) {
		snprintf(what, sizeof(what), "tilt off by %.2f deg, acceleration %.2f %.2f %.2f m/s^2",
			tilt_error_deg(s), (double)v->acceleration_object.l, (double)v->acceleration_object.s,
			(double)v->acceleration_object.t);
		return what;
	}
	if (utc_error_s(s) > 0.05) {
		snprintf(what, sizeof(what), "UTC is off by %.3f s", utc_error_s(s));
		return what;
	}
	return NULL;
}
