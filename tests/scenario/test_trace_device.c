/* What the whole device does in scripted scenes in simulated time, compared with what it did when the trace was written
 * (tests/unit/trace.h): frames with their time, lines of the log, what each write answers, every counter and state that
 * changes, the deadlines that it asks for, the outputs, and what is recorded. Of TPDOs the number counts: their content
 * is that of the outputs. What is right is for the other scenario tests to say. */
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/config.h"
#include "gateway/log.h"
#include "gateway/record_text.h"
#include "gateway/reload.h"
#include "tests/scenario/world.h"
#include "tests/unit/trace.h"

enum { MS = 1000, NODE = WORLD_NODE_ID, FILTERS = 64, ROWS = 8 /* of one kind */, LAST_SHOWN = 0x215C };

struct scene {
	struct world world; /* first: the ports find it */
	const char *name;
	struct imu_sample next; /* of the sensor, due at: */
	uint64_t sample_us, due_us;
	uint64_t sent_us[WORLD_FRAMES];
	size_t frames_seen, log_seen;
	unsigned ticks;
	struct od_values before; /* as traced last */
	/* the sensor */
	bool silent;	    /* it delivers nothing */
	unsigned flags;	    /* of the samples, added */
	double warmer_degC; /* 20 degC is told with SAMPLE_TEMPERATURE, and so much more */
	int configured;	    /* answer of the driver */
	bool plain;	    /* it has neither settings nor a self-test */
	/* the bus */
	int restarted, bit_rate_set; /* answers of the driver */
	uint32_t filter[FILTERS];
	size_t filters;
	/* the clock of the process: each look costs 3 us */
	bool measured;
	uint64_t looked;
	struct record record;
	unsigned restarts, bit_rates, settings, self_tests; /* what the device has asked the ports for */
};

/* Replaces gateway/log.c. Lines of the event log, of which this is the format, are shown as those. */
void log_at(int severity, const char *format, ...)
{
	char text[180], name[20];
	va_list args;

	if (strcmp(format, "%s%s") == 0)
		return;
	va_start(args, format);
	vsnprintf(text, sizeof(text), format, args);
	va_end(args);
	snprintf(name, sizeof(name), "severity %d", severity);
	trace_text(name, text);
}

/* ---- ports ------------------------------------------------------------------------------------------------------- */

static int send_frame(struct can_port *port, const struct can_msg *msg)
{
	struct scene *s = (struct scene *)port;
	size_t at = s->world.frame_count++ % WORLD_FRAMES;

	s->world.frames[at] = *msg;
	s->sent_us[at] = s->world.now_us;
	return 0;
}

static int set_filter(struct can_port *port, const uint32_t *ids, size_t n)
{
	struct scene *s = (struct scene *)port;

	assert_true(n <= FILTERS);
	memcpy(s->filter, ids, n * sizeof(*ids));
	s->filters = n;
	return 0;
}

static int restart(struct can_port *port)
{
	struct scene *s = (struct scene *)port;

	s->restarts++;
	if (s->restarted == 0)
		port->state = CAN_STATE_ACTIVE;
	return s->restarted;
}

static int set_bit_rate(struct can_port *port, uint32_t bit_s, bool dry_run)
{
	struct scene *s = (struct scene *)port;

	s->bit_rates++;
	if (s->bit_rate_set == 0 && !dry_run)
		port->bit_s = bit_s;
	return s->bit_rate_set;
}

static void refresh(struct can_port *port)
{
	port->traffic.frames += 500;
	port->traffic.bytes += 3100;
}

static int configure(struct imu_port *imu, const struct imu_settings *settings, int dry, char *error, size_t size)
{
	struct scene *s = (struct scene *)((char *)imu - offsetof(struct world, imu));

	s->settings++;
	snprintf(error, size, "rate %g Hz, ranges %g, %g, %g, bandwidth %g Hz%s", settings->rate_hz,
		settings->gyro_range_deg_s, settings->accel_range_g, settings->mag_range_uT, settings->bandwidth_hz,
		dry ? ", tried" : "");
	return s->configured;
}

static void self_test(struct imu_port *imu)
{
	((struct scene *)((char *)imu - offsetof(struct world, imu)))->self_tests++;
	imu->health.self_test = IMU_SELF_TEST_RUNS;
}

static uint64_t clock_ns(void *ctx)
{
	struct scene *s = ctx;

	return 1000 * (s->world.now_us + 3 * ++s->looked);
}

/* ---- looking ----------------------------------------------------------------------------------------------------- */

static bool is_tpdo(uint32_t id)
{
	return (id & 0x7F) == NODE && id > 0x180 && id < 0x500 && (id & 0x80);
}

static void show_frames(struct scene *s)
{
	struct world *w = &s->world;
	unsigned tpdos[4] = {0}, same = 0;
	char text[120] = "", name[16], last[120] = "";

	assert_true(w->frame_count - s->frames_seen <= WORLD_FRAMES);
	for (; s->frames_seen < w->frame_count; s->frames_seen++) {
		const struct can_msg *msg = &w->frames[s->frames_seen % WORLD_FRAMES];
		int n = snprintf(text, sizeof(text), "%03X#%s", msg->id, msg->remote ? "R" : "");

		if (is_tpdo(msg->id)) {
			tpdos[msg->id / 0x100 - 1]++;
			continue;
		}
		for (int i = 0; i < msg->len; i++)
			n += snprintf(text + n, sizeof(text) - (size_t)n, "%02X", msg->data[i]);
		if (strcmp(text, last) == 0) {
			same++;
			continue;
		}
		if (same)
			trace_value("and again", same, 0);
		same = 0;
		strcpy(last, text);
		snprintf(text + n, sizeof(text) - (size_t)n, " at %llu",
			(unsigned long long)s->sent_us[s->frames_seen % WORLD_FRAMES]);
		trace_text("frame", text);
	}
	if (same)
		trace_value("and again", same, 0);
	for (int i = 0; i < 4; i++) {
		snprintf(name, sizeof(name), "TPDO%d", i + 1);
		trace_value(name, tpdos[i], 0);
	}
}

/* The numbers in the result of a procedure, which are printed with 0.1 mm or four digits. */
static void show_numbers(const char *text)
{
	while (*text) {
		char *end;
		double value = strtod(text, &end);

		if (end == text) {
			text++;
			continue;
		}
		trace_value("number", value, fmax(fabs(value) * 2e-3, strstr(text, " mm") ? 0.11 : 0));
		text = end;
	}
}

static void show_log(struct scene *s)
{
	const struct event_log *log = &s->world.device.log;
	char line[220];

	assert_true(log->used < sizeof(log->text) - sizeof(line)); /* none was dropped */
	for (const char *end; s->log_seen < log->used; s->log_seen = (size_t)(end - log->text) + 1) {
		end = strchr(log->text + s->log_seen, '\n');
		snprintf(line, sizeof(line), "%.*s", (int)(end - log->text - (ptrdiff_t)s->log_seen),
			log->text + s->log_seen);
		char *result = strstr(line, " done: ");
		result = result ? result : strstr(line, " accepted: ");
		if (result)
			*(result = strchr(result, ':')) = '\0';
		if (strstr(line, "snapshot of"))
			strcpy(strstr(line, "of"), "applied"); /* how many entries there are is for the EDS to say */
		trace_text("log", line + strspn(line, " "));
		if (result)
			show_numbers(result + 1);
	}
}

static double number_of(const struct od_entry *e, const uint8_t *wire, size_t size)
{
	char text[3 * OD_VALUE_MAX + 40];

	assert_true(od_format(e, wire, size, text, sizeof(text)) >= 0);
	return strtod(text, NULL);
}

/* So that an object that is added changes no line here. */
static bool is_shown(const struct od_entry *e)
{
	return (e->index <= LAST_SHOWN || e->index >= 0x6000) && e->index != 0x1003 && e->type != OD_DOMAIN &&
	       e->type != OD_VISIBLE_STRING;
}

/* REAL32, and integers that are computed from real numbers. */
static bool is_real(const struct od_entry *e)
{
	return e->type == OD_REAL32 || e->type == OD_REAL64 || e->resolution || e->factor != 1 || e->index >= 0x6000 ||
	       strcmp(e->unit, "%") == 0;
}

/* Integers that have changed since the last time. */
static void show_changes(struct scene *s)
{
	struct od *od = &s->world.device.od, old = {.table = od->table, .values = &s->before};

	for (size_t i = 0; i < od->table->count; i++) {
		const struct od_entry *e = &od->table->entries[i];
		uint8_t wire[OD_VALUE_MAX], then[OD_VALUE_MAX];
		size_t size = od_get(od, e, wire, sizeof(wire));

		if (!is_shown(e) || is_real(e) ||
			(od_get(&old, e, then, sizeof(then)) == size && memcmp(wire, then, size) == 0))
			continue;
		trace_value(e->name, number_of(e, wire, size), 0);
	}
	s->before = s->world.device.values;
}

static void show_filter(const struct scene *s)
{
	char text[200];
	int n = 0;

	for (size_t i = 0; i < s->filters && n < 190; i++)
		n += snprintf(text + n, sizeof(text) - (size_t)n, "%s%03X", i ? " " : "", s->filter[i]);
	if (s->filters)
		trace_text("filter", text);
}

static const char *const KINDS[RECORD_KEEP + 1] = {[RECORD_START] = "start",
	[RECORD_SAMPLE] = "samples",
	[RECORD_FRAME] = "frames",
	[RECORD_TICK] = "ticks",
	[RECORD_CUT] = "begins",
	[RECORD_STOP] = "ends",
	[RECORD_KEEP] = "keeps"};

/* As the thread of the files does it. */
static void show_record(struct scene *s)
{
	unsigned counts[RECORD_KEEP + 1] = {0};
	const struct record_entry *e;
	char text[RECORD_ROW_MAX];

	while (s->record.ring && (e = record_next(&s->record))) {
		if (++counts[e->kind] <= ROWS && !KINDS[e->kind]) {
			record_text(e, text);
			text[strcspn(text, "\n")] = '\0';
			trace_text("row", text + 2);
		}
		if (e->kind == RECORD_CUT)
			atomic_store(&s->record.state_in_use, false);
		record_taken(&s->record);
	}
	for (int kind = 0; kind <= RECORD_KEEP; kind++)
		if (KINDS[kind])
			trace_value(KINDS[kind], counts[kind], 0);
}

/* What has happened since the last time is this block. Writes that follow are in it, too. */
static void look(struct scene *s, const char *what)
{
	char header[120];

	snprintf(header, sizeof(header), "%s: %s", s->name, what);
	trace_block(header);
	trace_value("time us", (double)s->world.now_us, 0);
	trace_value("deadline us", s->due_us == UINT64_MAX ? -1 : (double)(s->due_us - s->world.now_us), 0);
	trace_value("ticks", s->ticks, 0);
	s->ticks = 0;
	trace_value("restarts", s->restarts, 0);
	trace_value("bit rates", s->bit_rates, 0);
	trace_value("settings", s->settings, 0);
	trace_value("self-tests", s->self_tests, 0);
	show_frames(s);
	show_filter(s);
	s->filters = 0;
	show_log(s);
	show_changes(s);
	show_record(s);
}

/* What a client reads as measured. */
static void look_at_outputs(struct scene *s, const char *what)
{
	const struct od *od = &s->world.device.od;

	look(s, what);
	for (size_t i = 0; i < od->table->count; i++) {
		const struct od_entry *e = &od->table->entries[i];
		uint8_t wire[OD_VALUE_MAX];
		size_t size = od_get(od, e, wire, sizeof(wire));

		if (is_shown(e) && is_real(e) && !(e->access & OD_WRITE))
			trace_value(e->name, number_of(e, wire, size), e->type == OD_REAL32 ? 2e-6 : 1);
	}
}

/* ---- doing ------------------------------------------------------------------------------------------------------- */

static void tick(struct scene *s)
{
	s->due_us = device_tick(&s->world.device, s->world.now_us);
	s->ticks++;
	assert_true(s->due_us > s->world.now_us); /* else the process would not rest */
}

static void take_sample(struct scene *s)
{
	struct world *w = &s->world;

	if (!s->silent) {
		w->imu.counters.samples++;
		s->next.flags |= s->flags;
		if (s->flags & SAMPLE_TEMPERATURE)
			s->next.temperature_degC = 20 + s->warmer_degC;
		latency_mark(&w->device.latency, clock_ns(s));
		device_sample(&w->device, 1, &s->next, w->now_us);
		tick(s);
	}
	sensor_next(&w->sensor, w->signal, &s->next, NULL);
	s->sample_us += w->interval_us;
}

/* Time passes. The device is called when a sample comes and at the deadlines that it has asked for. */
static void pass(struct scene *s, uint64_t ms)
{
	struct world *w = &s->world;
	uint64_t end_us = w->now_us + ms * MS;

	for (;;) {
		uint64_t next_us = s->sample_us < s->due_us ? s->sample_us : s->due_us;

		if (next_us > end_us)
			break;
		w->now_us = next_us;
		if (next_us == s->sample_us)
			take_sample(s);
		else
			tick(s);
	}
	w->now_us = end_us;
	tick(s);
}

static void receive(struct scene *s, uint32_t id, size_t len, const char *data)
{
	struct can_msg msg = {.id = id, .len = (uint8_t)len, .t_us = s->world.now_us};

	if (len)
		memcpy(msg.data, data, len);
	s->world.bus.counters.rx++;
	device_receive(&s->world.device, &msg, s->world.now_us);
	tick(s);
}

static void nmt(struct scene *s, uint8_t command)
{
	receive(s, 0, 2, (const char[]){(char)command, NODE});
}

/* A write as Modbus does it; its answer belongs to the last look(). */
static void put(struct scene *s, const char *name, const char *value)
{
	const struct od_entry *e = od_find_name(&imu9_od_table, name);
	uint8_t wire[OD_VALUE_MAX];
	char text[150];
	size_t size;

	assert_non_null(e);
	assert_int_equal(od_parse(e, value, wire, sizeof(wire), &size), OD_OK);
	enum od_status status = device_write(&s->world.device, e->index, e->sub, wire, size, s->world.now_us);
	snprintf(text, sizeof(text), "%s = %s: %s", name, value, status == OD_OK ? "done" : od_status_text(status));
	trace_text("write", text);
	tick(s);
}

static void power_on(struct scene *s, const char *const *settings)
{
	static const struct can_ops ops = {.send = send_frame,
		.filter = set_filter,
		.restart = restart,
		.bit_rate = set_bit_rate,
		.refresh = refresh};
	static const struct imu_ops imu_ops = {.configure = configure, .self_test = self_test};
	struct world *w = &s->world;

	w->bus.ops = &ops;
	w->imu.ops = s->plain ? NULL : &imu_ops;
	strcpy(w->bus.name, "can7");
	world_power_on(w, settings);
	w->device.latency.clock_ns = s->measured ? clock_ns : NULL;
	w->device.latency.clock_ctx = s;
	s->before = w->device.values;
	s->log_seen = 0;
	s->sample_us = w->now_us + w->interval_us;
	sensor_next(&w->sensor, w->signal, &s->next, NULL);
	tick(s);
	look(s, w->node_id == NODE ? "power on" : "power on without a node-ID");
}

static struct scene *begin(void **state, const char *name, const char *sensor, const char *signal)
{
	struct scene *s = calloc(1, sizeof(*s));

	assert_non_null(s);
	*state = s;
	s->name = name;
	world_init(&s->world, sensor_preset(sensor), 5, signal);
	s->world.bus.bit_s = 125000;
	s->world.now_us = 4000000000;
	return s;
}

static int end(void **state)
{
	struct scene *s = *state;

	record_close(&s->record);
	free(s);
	return 0;
}

/* ---- scenes: outputs --------------------------------------------------------------------------------------------- */

static void test_outputs_in_motion(void **state)
{
	static const char *const settings[] = {"lever_arm.l=0.3", "lever_arm.s=-0.2", "lever_arm.t=0.1",
		"mounting.roll=10", "mounting.pitch=-20", "mounting.yaw=140", "acceleration_filter.cutoff=11",
		"rate_filter.cutoff=17", "gyro_calibration.bias_y=0.02", "accelerometer_calibration.xy=0.03",
		"magnetometer_calibration.zz=1.1", "temperature_compensation.gyro_slope_z=0.001",
		"temperature_compensation.accelerometer_quadratic_x=0.0002", "angle_filter.cutoff=2",
		"slope_long16_operating_parameter=3", "slope_lateral16_operating_parameter=2",
		"slope_long32_operating_parameter=1", "slope_lateral32_operating_parameter=3",
		"slope_long16_differential_offset=77", "slope_lateral32_differential_offset=-1234",
		"resolution.acceleration=2", "resolution.position=7", "resolution.angular_rate=3", NULL};
	struct scene *s = begin(state, "outputs", "lsm303dlhc_l3gd20", "square");

	s->measured = true;
	s->flags = SAMPLE_TEMPERATURE;
	power_on(s, settings);
	nmt(s, 1);
	for (int i = 0; i < 5; i++) {
		char what[32];

		pass(s, 7000);
		snprintf(what, sizeof(what), "after %d s", 7 * (i + 1));
		look_at_outputs(s, what);
		s->warmer_degC += 7;
	}
	put(s, "slope_long16_preset_value", "100");
	put(s, "slope_lateral16_preset_value", "-200");
	put(s, "slope_long32_preset_value", "300");
	put(s, "slope_lateral32_preset_value", "-400");
	pass(s, 10);
	look_at_outputs(s, "after the presets");
	put(s, "commands", "4");
	pass(s, 10);
	look_at_outputs(s, "after the command of zero slopes");
	trace_check();
}

static void test_aids_and_resets(void **state)
{
	struct scene *s = begin(state, "aids", "lsm303dlhc_l3gd20_fine", "turntable");

	power_on(s, NULL);
	put(s, "velocity_aid.x16", "5"); /* without an attitude */
	put(s, "velocity_aid.sigma16", "5");
	nmt(s, 1);
	pass(s, 5000);
	look_at_outputs(s, "without");
	put(s, "velocity_aid.x", "1.5");
	put(s, "velocity_aid.y16", "-700");
	put(s, "velocity_aid.z", "0.25");
	put(s, "velocity_aid.sigma", "0.05");
	pass(s, 400);
	look_at_outputs(s, "a velocity");
	put(s, "velocity_aid.frame", "1");
	put(s, "velocity_aid.sigma16", "20");
	pass(s, 700);
	look_at_outputs(s, "a velocity of the object frame");
	pass(s, 400);
	look(s, "it is no longer used");
	put(s, "yaw_aid.yaw", "33");
	put(s, "yaw_aid.sigma", "0");
	put(s, "yaw_aid.sigma", "1.5");
	pass(s, 100);
	look_at_outputs(s, "a yaw");
	put(s, "velocity_aid.frame", "0");
	put(s, "velocity_aid.x", "100");
	put(s, "velocity_aid.y", "-100");
	put(s, "velocity_aid.z", "0");
	put(s, "velocity_aid.sigma", "100");
	put(s, "yaw_aid.sigma", "0.0001");
	pass(s, 20);
	look_at_outputs(s, "aids beyond their twins");
	put(s, "velocity_aid.x16", "3");
	put(s, "velocity_aid.y16", "-2");
	put(s, "velocity_aid.sigma", "0.00001");
	pass(s, 20);
	look_at_outputs(s, "the most certain aids");
	put(s, "commands", "2");
	pass(s, 300);
	look_at_outputs(s, "standstill");
	pass(s, 1300);
	look_at_outputs(s, "no standstill");
	put(s, "attitude_reset.roll", "350");
	put(s, "attitude_reset.roll16", "700");
	put(s, "attitude_reset.roll", "-350");
	pass(s, 20);
	look(s, "an attitude beyond its twin");
	put(s, "attitude_reset.roll", "5");
	put(s, "attitude_reset.pitch16", "-1000");
	put(s, "attitude_reset.yaw", "170");
	put(s, "attitude_reset.command", "1");
	pass(s, 20);
	look_at_outputs(s, "attitude reset");
	put(s, "attitude_reset.command", "1");
	put(s, "commands", "3");
	pass(s, 20);
	look_at_outputs(s, "position reset");
	put(s, "position.reset", "1");
	put(s, "position.reset", "0");
	receive(s, 0x200 + NODE, 8, "\x10\x00\x20\x00\xF0\xFF\x08\x00");
	receive(s, 0x300 + NODE, 8, "\x00\x00\x20\x41\x00\x00\x00\x3F");
	receive(s, 0x400 + NODE, 7, "\x10\x00\x20\x00\x30\x00\x00");
	receive(s, 0x500 + NODE, 2, "\x04\x00");
	receive(s, 0x200 + NODE, 3, "\x10\x00\x20");
	pass(s, 1500);
	look_at_outputs(s, "RPDOs");
	nmt(s, 129);
	pass(s, 2000);
	look_at_outputs(s, "reset node");
	trace_check();
}

/* TPDOs by event: the units' thresholds, inhibit times, event timers. */
static void test_thresholds(void **state)
{
	static const char *const preset[] = {"1", "2", "3", "4"};
	static const char *const threshold[] = {"0", "0.02", "0.2", "2"};
	static const char *const names[] = {"change_threshold.acceleration", "change_threshold.angle",
		"change_threshold.angular_rate", "change_threshold.velocity", "change_threshold.position"};
	static const char *const settings[] = {"tpdo1_communication.transmission_type=254",
		"tpdo2_communication.transmission_type=255", "tpdo3_communication.transmission_type=254",
		"tpdo4_communication.transmission_type=255", NULL};
	struct scene *s = begin(state, "thresholds", "ideal", "tumble");
	char what[80];

	s->measured = true;
	power_on(s, settings);
	nmt(s, 1);
	pass(s, 3000);
	for (int p = 0; p < 4; p++)
		for (int t = 0; t < 4; t++) {
			snprintf(what, sizeof(what), "preset %s, %s", preset[p], threshold[t]);
			look(s, what);
			put(s, "pdo_preset", preset[p]);
			for (int i = 0; i < 5; i++)
				put(s, names[i], threshold[t]);
			pass(s, 2000);
		}
	look(s, "the last");
	put(s, "tpdo1_communication.cob_id", "0x80000190");
	put(s, "tpdo1_communication.inhibit_time", "450");
	put(s, "tpdo1_communication.event_timer", "300");
	put(s, "tpdo1_communication.cob_id", "0x190");
	pass(s, 2000);
	look(s, "inhibit time");
	put(s, "tpdo2_communication.transmission_type", "0");
	put(s, "tpdo3_communication.transmission_type", "3");
	put(s, "tpdo4_communication.transmission_type", "253");
	for (int i = 0; i < 40; i++) {
		receive(s, 0x080, 0, NULL);
		pass(s, 50);
	}
	look(s, "SYNC");
	trace_check();
}

/* ---- scenes: faults ---------------------------------------------------------------------------------------------- */

static void test_bus_faults(void **state)
{
	static const struct {
		const char *what;
		enum can_state state;
		int restarted;
		unsigned ms;
	} STEPS[] = {
		{"warning", CAN_STATE_WARNING, 0, 500},
		{"passive", CAN_STATE_PASSIVE, 0, 1500},
		{"active again", CAN_STATE_ACTIVE, 0, 1500},
		{"passive, then off", CAN_STATE_PASSIVE, 0, 100},
		{"off", CAN_STATE_BUS_OFF, 0, 99},
		{"about to be restarted", CAN_STATE_BUS_OFF, 0, 2},
		{"off again", CAN_STATE_BUS_OFF, 0, 199},
		{"restarted again", CAN_STATE_ACTIVE, 0, 300},
		{"off, no restart is permitted", CAN_STATE_BUS_OFF, -EPERM, 5000},
		{"active by itself", CAN_STATE_ACTIVE, 0, 500},
		{"off, the driver has no restart", CAN_STATE_BUS_OFF, -EOPNOTSUPP, 5000},
		{"warning after off", CAN_STATE_WARNING, 0, 500},
		{"off, restarts fail", CAN_STATE_BUS_OFF, -EIO, 9000},
		{"off, goes down", CAN_STATE_DOWN, -EIO, 90000},
		{"off, is up again", CAN_STATE_BUS_OFF, 0, 70000},
		{"active for long", CAN_STATE_ACTIVE, 0, 61000},
		{"off a last time", CAN_STATE_BUS_OFF, 0, 99},
		{"on", CAN_STATE_ACTIVE, 0, 1000},
		{"down", CAN_STATE_DOWN, 0, 3000},
		{"up", CAN_STATE_ACTIVE, 0, 3000},
	};
	struct scene *s = begin(state, "bus", "ideal", "rest");
	struct can_port *bus = &s->world.bus;

	power_on(s, (const char *const[]){"sensor.rate=20", "inhibit_time_emcy=0", NULL});
	nmt(s, 1);
	pass(s, 3500);
	look(s, "well");
	for (size_t i = 0; i < sizeof(STEPS) / sizeof(STEPS[0]); i++) {
		bus->state = STEPS[i].state;
		bus->tx_errors = (uint8_t)(i * 11);
		bus->rx_errors = (uint8_t)(i * 7);
		bus->counters.bus_off += STEPS[i].state == CAN_STATE_BUS_OFF;
		bus->counters.errors += 3;
		s->restarted = STEPS[i].restarted;
		tick(s);
		pass(s, STEPS[i].ms);
		look(s, STEPS[i].what);
	}
	bus->down_why = "the adapter was removed: plug it in";
	bus->state = CAN_STATE_DOWN;
	bus->counters.tx_dropped = 5;
	tick(s);
	pass(s, 500);
	bus->counters.tx_dropped = 9;
	bus->state = CAN_STATE_ACTIVE;
	bus->notice = "another adapter";
	tick(s);
	look(s, "frames lost while down");
	bus->counters.tx_dropped = 12;
	bus->counters.tx_retries = 4;
	bus->counters.rx_dropped = 2;
	pass(s, 700);
	look(s, "frames lost");
	bus->counters.tx_dropped = 13;
	pass(s, 800);
	look(s, "frames lost again");
	pass(s, 300);
	look(s, "no more are lost");
	pass(s, 900);
	look(s, "the error is over");
	bus->traffic = (struct can_traffic){0};
	pass(s, 1200);
	look(s, "another interface");
	bus->bit_s = 10000;
	pass(s, 1200);
	look(s, "a slow bus");
	bus->bit_s = 0;
	pass(s, 1200);
	look(s, "no bit rate");
	trace_check();
}

static void test_bus_limits_and_commands(void **state)
{
	struct scene *s = begin(state, "restarts", "ideal", "rest");
	struct can_port *bus = &s->world.bus;
	char what[40];

	power_on(s, (const char *const[]){"bus_health.restart_delay=40", "bus_health.restart_limit=3",
			    "bus_health.restart_window=2", "error_behaviour.communication_error=2",
			    "inhibit_time_emcy=1000", NULL});
	nmt(s, 1);
	put(s, "bus_health.restart", "1");
	put(s, "bus_health.restart", "2");
	for (int i = 0; i < 5; i++) {
		bus->state = CAN_STATE_BUS_OFF;
		tick(s);
		pass(s, 400);
		snprintf(what, sizeof(what), "off %d", i);
		look(s, what);
	}
	put(s, "bus_health.restart", "1");
	pass(s, 10);
	look(s, "by command");
	pass(s, 1000);
	bus->state = CAN_STATE_BUS_OFF;
	pass(s, 3000);
	look(s, "soon after");
	bus->state = CAN_STATE_BUS_OFF;
	pass(s, 500);
	look(s, "late after");
	put(s, "bus_health.restart_delay", "0");
	bus->state = CAN_STATE_BUS_OFF;
	pass(s, 500);
	look(s, "without a delay");
	nmt(s, 129);
	pass(s, 1000);
	look(s, "reset node");
	for (int i = 0; i < 3; i++)
		receive(s, 0x600 + NODE, 5, "\x40\x00\x10\x00\x00");
	for (int i = 0; i < 40; i++)
		device_receive(&s->world.device,
			&(struct can_msg){.id = 0x600 + NODE, .len = 8, .data = {0x40, 0x17, 0x10}}, s->world.now_us);
	pass(s, 1000);
	look(s, "bad clients");
	receive(s, 0x180 + NODE, 2, "\x01\x02");
	receive(s, 0x700 + NODE, 1, "\x05");
	pass(s, 1000);
	look(s, "the same node-ID twice");
	trace_check();
}

static void test_sensor_faults(void **state)
{
	struct scene *s = begin(state, "sensor", "ideal", "rest");
	struct imu_health *health = &s->world.imu.health;
	char what[40];

	s->world.imu.uncalibrated = IMU_UNCALIBRATED;
	power_on(s, NULL);
	nmt(s, 1);
	pass(s, 500);
	look(s, "well");
	put(s, "gyro_calibration.bias_x", "0.01");
	pass(s, 100);
	put(s, "sensor_calibration.accelerometer", "1");
	put(s, "sensor_calibration.gyro", "2");
	pass(s, 100);
	put(s, "sensor_calibration.gyro", "0");
	put(s, "sensor_calibration.magnetometer", "1");
	pass(s, 100);
	look(s, "calibrated");
	for (uint8_t fault = IMU_FAULT_SILENT; fault <= IMU_FAULT_SELF_TEST + 1; fault++) {
		health->degraded = fault;
		health->degraded_chip = fault % 3 + 1;
		health->bus_errors += 2;
		health->restarts += 3;
		health->overruns += 5;
		health->rate_hz = 99.5f;
		pass(s, 1100);
		snprintf(what, sizeof(what), "degraded %d", fault);
		look(s, what);
	}
	health->degraded = health->degraded_chip = 0;
	pass(s, 1100);
	look(s, "recovered");
	for (uint8_t fault = IMU_FAULT_NONE; fault <= IMU_FAULT_SELF_TEST; fault++) {
		health->fault = fault;
		health->fault_chip = fault % 3 + 1;
		s->silent = true;
		if (fault == IMU_FAULT_FROZEN) {
			device_sample(&s->world.device, -EIO, NULL, s->world.now_us);
			tick(s);
		}
		pass(s, 99);
		device_away(&s->world.device, fault == IMU_FAULT_STOPPED ? 30000 : 0, s->world.now_us);
		pass(s, 50);
		snprintf(what, sizeof(what), "fault %d", fault);
		look(s, what);
		s->silent = false;
		health->fault = health->fault_chip = 0;
		pass(s, 1100);
		snprintf(what, sizeof(what), "no fault %d", fault);
		look(s, what);
	}
	put(s, "sensor.self_test", "0");
	put(s, "sensor.self_test", "1");
	s->silent = true;
	pass(s, 4000);
	look(s, "self-test");
	pass(s, 1500);
	look(s, "it lasts too long");
	health->self_test = 0x52;
	s->silent = false;
	pass(s, 100);
	look(s, "its end");
	s->flags = SAMPLE_SATURATED;
	pass(s, 100);
	look(s, "saturated");
	s->flags = SAMPLE_TEMPERATURE;
	s->warmer_degC = 11.6;
	pass(s, 100);
	look_at_outputs(s, "warm");
	s->warmer_degC = -70.4;
	pass(s, 100);
	look(s, "cold");
	s->warmer_degC = 1e9;
	pass(s, 100);
	s->warmer_degC = (double)NAN;
	pass(s, 100);
	look(s, "no temperature");
	s->flags = 0;
	for (int i = 0; i < 30; i++) {
		s->next.gyro_rad_s.z = i % 4 ? 0 : 1e4;
		pass(s, 50);
	}
	look(s, "implausible rates");
	s->next.accel_m_s2.x = (double)NAN;
	pass(s, 500);
	look(s, "no number");
	pass(s, 1500);
	look(s, "plausible");
	s->world.sensor.count += 60;
	pass(s, 500);
	look(s, "a gap");
	s->world.sensor.count -= 300;
	pass(s, 90);
	look(s, "the clock has gone back");
	pass(s, 300);
	look(s, "and is accepted");
	s->world.imu.counters.skipped = 3;
	s->world.imu.counters.late = 4;
	s->next.t_us += 3600000000;
	pass(s, 50);
	look(s, "one time is far ahead");
	pass(s, 1000);
	look(s, "it is forgotten");
	trace_check();
}

static void test_sensor_settings(void **state)
{
	static const char *const changes[][2] = {{"sensor.rate", "200"}, {"sensor.gyro_range", "500"},
		{"sensor.accelerometer_range", "4"}, {"sensor.magnetometer_range", "400"}, {"sensor.bandwidth", "20"},
		{"sensor.self_test_at_start", "1"}};
	struct scene *s = begin(state, "settings", "ideal", "rest");
	char what[60];

	power_on(s, NULL);
	nmt(s, 1);
	for (int i = 0; i < 6; i++) {
		s->configured = i == 0 ? -EINVAL : i == 1 ? -EIO : 0;
		put(s, changes[i][0], changes[i][1]);
		pass(s, 30);
		snprintf(what, sizeof(what), "%s written", changes[i][0]);
		look(s, what);
		s->configured = i == 2 ? -EINVAL : 0;
		nmt(s, 129);
		pass(s, 100);
		snprintf(what, sizeof(what), "%s used", changes[i][0]);
		look(s, what);
		nmt(s, 1);
	}
	put(s, "accelerometer_calibration.xx", "0");
	pass(s, 50);
	look(s, "a singular matrix");
	put(s, "accelerometer_calibration.xx", "1");
	pass(s, 50);
	look(s, "a good one");
	put(s, "angle_resolution", "11");
	put(s, "angle_resolution", "1");
	put(s, "angle_resolution", "2");
	put(s, "angle_resolution", "1000");
	put(s, "lever_arm_in_um.s", "250000");
	put(s, "lever_arm.t", "-0.125");
	put(s, "lever_arm_in_um.l", "10000001");
	pass(s, 50);
	look(s, "others");
	trace_check();
}

static void test_a_sensor_without_settings(void **state)
{
	struct scene *s = begin(state, "no settings", "ideal", "rest");

	s->plain = true;
	power_on(s, NULL);
	nmt(s, 1);
	put(s, "sensor.rate", "200");
	put(s, "sensor.self_test", "1");
	pass(s, 100);
	look(s, "written");
	nmt(s, 129);
	pass(s, 100);
	look(s, "reset node");
	trace_check();
}

/* ---- scenes: storing and other commands -------------------------------------------------------------------------- */

static void test_storing(void **state)
{
	static const struct {
		const char *what;
		int answer, result; /* of the disk, at once, and later */
	} DISKS[] = {{"at once", 0, 0}, {"later", -EINPROGRESS, 0}, {"no room", -ENOSPC, 0}, {"room again", 0, 0},
		{"room later", -EINPROGRESS, 0}, {"no room later", -EINPROGRESS, -ENOSPC},
		{"not durable", -EINPROGRESS, EIO}};
	struct scene *s = begin(state, "storing", "ideal", "rest");
	struct world *w = &s->world;
	char what[60];

	power_on(s, (const char *const[]){"producer_heartbeat_time=700", NULL});
	nmt(s, 1);
	for (size_t i = 0; i < sizeof(DISKS) / sizeof(DISKS[0]); i++) {
		char heartbeat[8];

		w->disk_answer = DISKS[i].answer;
		snprintf(heartbeat, sizeof(heartbeat), "%d", 800 + (int)i);
		put(s, "producer_heartbeat_time", heartbeat);
		put(s, "lever_arm_model", (const char *const[]){"2", "1", "3"}[i % 3]);
		put(s, "angle_resolution", i % 2 ? "100" : "10");
		put(s, i % 2 ? "store_parameters.communication" : "store_parameters.all", "0x65766173");
		put(s, "store_parameters.application", "0x65766173");
		pass(s, 200);
		snprintf(what, sizeof(what), "%s: asked", DISKS[i].what);
		look(s, what);
		if (w->disk_waits) {
			if (DISKS[i].result >= 0)
				w->disk = w->to_disk;
			device_saved(&w->device, DISKS[i].result, w->now_us);
			tick(s);
		}
		w->disk_waits = false;
		pass(s, 200);
		snprintf(what, sizeof(what), "%s: saved", DISKS[i].what);
		look(s, what);
		for (int g = 0; g < STORE_GROUPS; g++) {
			const struct store_group *group = &w->disk.groups[g];

			trace_value(g == 0   ? "communication"
				    : g == 1 ? "application"
					     : "manufacturer",
				(double)group->size, 0);
			trace_value("crc", od_crc32(0, group->dcf, group->size), 0);
		}
		nmt(s, i % 2 ? 129 : 130);
		pass(s, 200);
		snprintf(what, sizeof(what), "%s: reset", DISKS[i].what);
		look(s, what);
	}
	w->disk_answer = 0;
	put(s, "write_lock.key", "0");
	put(s, "write_lock.key", "12345");
	put(s, "lever_arm.l", "0.1");
	put(s, "lever_arm_in_um.l", "3");
	put(s, "pdo_preset", "2");
	put(s, "calibration.command", "1");
	put(s, "lever_arm_identification.command", "1");
	put(s, "store_parameters.all", "0x65766173");
	put(s, "restore_defaults.all", "0x64616F6C");
	put(s, "velocity_aid.x", "1");
	put(s, "write_lock.key", "54321");
	pass(s, 999);
	put(s, "write_lock.key", "12345");
	look(s, "locked");
	pass(s, 2);
	put(s, "write_lock.key", "12345");
	pass(s, 10);
	look(s, "unlocked");
	put(s, "restore_defaults.manufacturer", "0x64616F6C");
	put(s, "restore_defaults.application", "0x64616F6D");
	nmt(s, 129);
	pass(s, 100);
	look(s, "restored");
	put(s, "restore_defaults.all", "0x64616F6C");
	nmt(s, 129);
	pass(s, 100);
	look(s, "restored as well");
	trace_check();
}

/* What LSS does, frame by frame: CiA 305. */
static void test_lss(void **state)
{
	static const char *const requests[] = {"\x04\x01", "\x5E", "\x11\x2A", "\x13\x00\x04", "\x13\x00\x02",
		"\x13\x00\x09", "\x17", "\x5A", "\x5B", "\x5D", "\x15\x32\x00", "\x13\x00\x03", "\x15\x20\x00",
		"\x13\x00\x06", "\x04\x00"};
	struct scene *s = begin(state, "LSS", "ideal", "rest");
	char data[8], what[30];

	power_on(s, NULL);
	pass(s, 100);
	for (size_t i = 0; i < sizeof(requests) / sizeof(requests[0]); i++) {
		s->bit_rate_set = i == 4 ? -EOPNOTSUPP : i == 12 ? -EIO : i == 13 ? -EPERM : 0;
		memset(data, 0, sizeof(data));
		data[0] = requests[i][0];
		data[1] = requests[i][1];
		data[2] = requests[i][1] ? requests[i][2] : 0;
		if (requests[i][0] == 0x13)
			data[1] = 0, data[2] = requests[i][2];
		receive(s, 0x7E5, 8, data);
		pass(s, 300);
		snprintf(what, sizeof(what), "request %zu, %02X", i, (uint8_t)data[0]);
		look(s, what);
	}
	nmt(s, 130);
	pass(s, 300);
	look(s, "another node-ID");
	s->world.disk = (struct store_image){0};
	s->world.node_id = CANOPEN_UNCONFIGURED;
	power_on(s, NULL);
	pass(s, 500);
	look(s, "unconfigured");
	trace_check();
}

static void test_time(void **state)
{
	const int64_t noon_us = INT64_C(1795953600000000); /* 2026-11-29 12:00 UTC */
	struct scene *s = begin(state, "time", "ideal", "rest");
	struct device *d = &s->world.device;

	power_on(s, (const char *const[]){"cob_id_time=0xC0000100", "utc.producer_period=2", NULL});
	nmt(s, 1);
	pass(s, 300);
	device_host_clock(d, false, noon_us);
	tick(s);
	pass(s, 300);
	look(s, "a host that is not synchronised");
	device_host_clock(d, true, noon_us);
	tick(s);
	pass(s, 5000);
	look(s, "a host that is");
	receive(s, 0x100, 6, "\x10\x27\x00\x00\x39\x3D");
	pass(s, 1000);
	look(s, "TIME");
	receive(s, 0x100, 6, "\x00\x2B\x00\x00\x39\x3D"); /* 8 ms more than have passed */
	pass(s, 100);
	look(s, "TIME, with jitter");
	receive(s, 0x100, 6, "\x78\x2B\x00\x00\x39\x3D"); /* 20 ms, 12 ms more than its jitter */
	pass(s, 100);
	look(s, "TIME, set a little");
	receive(s, 0x100, 6, "\x00\x3B\x00\x00\x39\x3D");
	receive(s, 0x100, 5, "\x00\x3B\x00\x00\x39");
	pass(s, 100);
	look(s, "TIME, set");
	s->world.sensor.count += 500;
	pass(s, 100);
	look(s, "samples of another time");
	device_host_clock(d, true, -5);
	tick(s);
	pass(s, 5000);
	look(s, "a wrong host");
	pass(s, 300000);
	look(s, "TIME is too old");
	trace_check();
}

/* The calibration in use. */
static void show_triad(struct scene *s, const char *name, uint16_t index)
{
	for (uint8_t sub = 1; sub <= 12; sub += 3) {
		float v[3];

		for (uint8_t i = 0; i < 3; i++)
			memcpy(&v[i], od_value(&s->world.device.od, index, sub + i, sizeof(v[i])), sizeof(v[i]));
		trace_vec(name, (struct vec3){(double)v[0], (double)v[1], (double)v[2]}, 2e-6);
	}
}

static void test_procedures(void **state)
{
	struct scene *s = begin(state, "procedures", "lsm303dlhc_l3gd20_fine", "rest");
	struct world *w = &s->world;

	s->flags = SAMPLE_TEMPERATURE;
	power_on(s, (const char *const[]){"temperature_compensation.gyro_slope_x=0.002",
			    "temperature_compensation.accelerometer_slope_y=0.03",
			    "lever_arm_identification.duration=10", NULL});
	put(s, "calibration.command", "1"); /* without a sample */
	nmt(s, 1);
	pass(s, 1000);
	put(s, "calibration.command", "10");
	put(s, "calibration.command", "11");
	put(s, "calibration.command", "5");
	put(s, "calibration.command", "1");
	put(s, "calibration.command", "2");
	put(s, "lever_arm_identification.command", "1");
	pass(s, 3000);
	look_at_outputs(s, "gyro");
	s->warmer_degC = 9;
	pass(s, 12000);
	look_at_outputs(s, "gyro, done");
	put(s, "calibration.command", "10");
	look_at_outputs(s, "gyro, accepted");
	show_triad(s, "gyro", 0x2050);
	w->signal = signal_find("multiposition");
	put(s, "calibration.command", "3");
	pass(s, 110000);
	look_at_outputs(s, "free positions");
	put(s, "calibration.command", "10");
	look_at_outputs(s, "free positions, accepted");
	show_triad(s, "gyro", 0x2050);
	show_triad(s, "accelerometer", 0x2051);
	put(s, "calibration.command", "4");
	w->signal = signal_find("figure");
	pass(s, 10000);
	look_at_outputs(s, "field");
	pass(s, 50000);
	look_at_outputs(s, "field, done");
	put(s, "calibration.command", "10");
	show_triad(s, "magnetometer", 0x2052);
	put(s, "calibration.command", "1");
	w->signal = signal_find("tumble");
	pass(s, 65000);
	look_at_outputs(s, "gyro, moved");
	put(s, "calibration.command", "11");
	w->signal = signal_find("rest");
	put(s, "calibration.command", "4");
	pass(s, 190000);
	look_at_outputs(s, "field, not turned");
	put(s, "calibration.command", "2");
	pass(s, 950000);
	look_at_outputs(s, "six faces, not turned");
	w->signal = signal_find("tumble");
	put(s, "calibration.command", "11");
	put(s, "lever_arm_identification.command", "2");
	pass(s, 31000);
	look_at_outputs(s, "lever arm without a reference");
	put(s, "lever_arm_identification.command", "4");
	put(s, "lever_arm_identification.command", "1");
	pass(s, 13000);
	look_at_outputs(s, "lever arm");
	put(s, "lever_arm_identification.command", "3");
	put(s, "lever_arm_identification.command", "1");
	put(s, "lever_arm_identification.command", "0");
	put(s, "calibration.command", "4");
	put(s, "calibration.command", "0");
	put(s, "calibration.command", "4");
	s->silent = true;
	pass(s, 200);
	look(s, "sensor lost");
	trace_check();
}

static void test_six_faces(void **state)
{
	struct scene *s = begin(state, "six faces", "lsm303dlhc_l3gd20_fine", "multiposition");

	power_on(s, NULL);
	nmt(s, 1);
	pass(s, 50);
	put(s, "calibration.command", "2");
	look(s, "begun");
	pass(s, 25000);
	look_at_outputs(s, "half of them");
	pass(s, 40000);
	look_at_outputs(s, "done");
	put(s, "calibration.command", "11");
	look_at_outputs(s, "discarded");
	trace_check();
}

/* The reference point is at rest. */
static void test_lever_arm(void **state)
{
	struct scene *s = begin(state, "lever arm", "ideal", "tumble");
	struct sensor_config sensor = *sensor_preset("lsm303dlhc_l3gd20_fine");

	sensor.rate_hz = 200;
	sensor.lever_arm_b_m = (struct vec3){0.06, -0.05, 0.0624};
	sensor.gyro.range = sensor.accel.range = 1e3;
	sensor_calibrate(&sensor);
	world_init(&s->world, &sensor, 1, "tumble");
	power_on(s, NULL);
	nmt(s, 1);
	pass(s, 500);
	put(s, "reference_acceleration.l", "1000");
	put(s, "reference_acceleration.s16", "-200");
	put(s, "reference_acceleration.t", "0.5");
	put(s, "lever_arm_identification.command", "1");
	pass(s, 15000);
	look_at_outputs(s, "on the way");
	pass(s, 30000);
	look_at_outputs(s, "done");
	put(s, "lever_arm_identification.command", "3");
	pass(s, 100);
	look_at_outputs(s, "accepted");
	put(s, "lever_arm_identification.command", "2");
	for (int i = 0; i < 300; i++) {
		const uint8_t l16[2] = {i % 2 ? 20 : 40, 0}, t16[2] = {0};

		device_write(&s->world.device, 0x2075, 4, l16, 2, s->world.now_us);
		device_write(&s->world.device, 0x2075, 6, t16, 2, s->world.now_us);
		pass(s, i < 200 ? 10 : 60); /* it holds for 50 ms */
	}
	look_at_outputs(s, "with a reference");
	trace_check();
}

static void test_last_movement(void **state)
{
	struct scene *s = begin(state, "movement", "lsm303dlhc_l3gd20_fine", "square");
	const struct od_domain *path = NULL;
	uint8_t text[OD_DOMAIN_MAX];
	char what[30], *line;

	power_on(s, (const char *const[]){"position.motion_preset=2", "position.sigma_limit=0.02", NULL});
	nmt(s, 1);
	for (int i = 0; i < 6; i++) {
		pass(s, 6000);
		snprintf(what, sizeof(what), "after %d s", 6 * (i + 1));
		look_at_outputs(s, what);
	}
	path = od_find_domain(&s->world.device.od, 0x2132, 0);
	text[path->read(path->ctx, text)] = '\0';
	line = strtok((char *)text, "\n");
	trace_text("header", line);
	for (int n = 0; (line = strtok(NULL, "\n")) != NULL; n++) {
		double t_s, v[9];

		assert_int_equal(sscanf(line, "%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf", &t_s, &v[0], &v[1], &v[2],
					 &v[3], &v[4], &v[5], &v[6], &v[7], &v[8]),
			10);
		if (n % 8)
			continue;
		snprintf(what, sizeof(what), "row_%d_s", n); /* rows of zeros are not in the file */
		trace_value(what, t_s, 0.0011);
		for (int i = 0; i < 3; i++) {
			static const char *const names[] = {"position", "velocity", "sigma"};

			snprintf(what, sizeof(what), "row_%d_%s", n, names[i]);
			trace_vec(what, (struct vec3){v[3 * i], v[3 * i + 1], v[3 * i + 2]}, 0.00011);
		}
	}
	trace_check();
}

/* ---- scenes: configuration --------------------------------------------------------------------------------------- */

/* 2130h, changed. */
static void apply_snapshot(
	struct scene *s, const char *what, uint16_t index, uint8_t sub, const void *data, size_t size)
{
	const struct od_domain *snapshot = od_find_domain(&s->world.device.od, 0x2130, 0);
	static uint8_t now[OD_DOMAIN_MAX], then[OD_DOMAIN_MAX];
	size_t length = snapshot->read(snapshot->ctx, now), from = 0, used = 0;
	struct od_dcf_item item, added = {index, sub, data, size};
	bool found = false;
	char text[60];

	while (od_dcf_next(now, length, &from, &item)) {
		if (item.index == index && item.sub == sub)
			item = added, found = true;
		assert_true(od_dcf_add(then, sizeof(then), &used, &item));
	}
	if (!found)
		assert_true(od_dcf_add(then, sizeof(then), &used, &added));
	snprintf(text, sizeof(text), "%s", od_status_text(snapshot->write(snapshot->ctx, then, used)));
	tick(s);
	look(s, what);
	trace_text("snapshot", text);
	trace_value("same", snapshot->read(snapshot->ctx, then) == length && memcmp(now, then, length) == 0, 0);
}

static void test_snapshots(void **state)
{
	static const char *const settings[] = {"cob_id_sync=0x40000085", "communication_cycle_period=10000",
		"consumer_heartbeat_time.consumer_1=0x00050064",
		"second_sdo_server_parameter.cob_id_client_to_server=0x641",
		"second_sdo_server_parameter.cob_id_server_to_client=0x5C1",
		"verify_configuration.configuration_date=9000",
		"third_sdo_server_parameter.cob_id_client_to_server=0x80000010",
		"tpdo2_communication.cob_id=0x80000290", "tpdo3_mapping.number_of_mapped_objects=2", NULL};
	struct scene *s = begin(state, "snapshots", "ideal", "rest");
	uint8_t wire[4] = {0};
	const struct od_domain *snapshot;
	static uint8_t bytes[OD_DOMAIN_MAX];
	struct od_dcf_item item;
	size_t used = 0, size;
	char text[200];

	power_on(s, settings);
	nmt(s, 1);
	pass(s, 100);
	look(s, "as it is");
	snapshot = od_find_domain(&s->world.device.od, 0x2130, 0);
	size = snapshot->read(snapshot->ctx, bytes);
	while (od_dcf_next(bytes, size, &used, &item)) {
		int n = snprintf(text, sizeof(text), "%04X:%02X", item.index, item.sub);

		if (item.index >= 0x2000)
			continue;
		for (size_t i = 0; i < item.size; i++)
			n += snprintf(text + n, sizeof(text) - (size_t)n, " %02X", item.data[i]);
		trace_text("item", text);
	}
	apply_snapshot(s, "the same", 0x1017, 0, "\xE8\x03", 2);
	apply_snapshot(s, "another heartbeat", 0x1017, 0, "\x64\x00", 2);
	apply_snapshot(s, "too long", 0x1017, 0, "\x64\x00\x00", 3);
	apply_snapshot(s, "no such object", 0x5FFF, 0, "\x64", 1);
	apply_snapshot(s, "no such sub-index", 0x2000, 9, "\x64", 1);
	apply_snapshot(s, "read-only", 0x1018, 1, wire, 4);
	apply_snapshot(s, "no configuration", 0x2073, 0, wire, 2);
	apply_snapshot(s, "out of limits", 0x2040, 1, "\x07", 1);
	apply_snapshot(s, "not possible", 0x2051, 4, wire, 4);
	apply_snapshot(s, "refused by a service", 0x1A01, 1, "\x10\x00\x01\x55", 4);
	apply_snapshot(s, "another SYNC", 0x1005, 0, "\x90\x00\x00\x40", 4);
	apply_snapshot(s, "the identifier of a PDO with the node-ID", 0x1801, 1, "\x00\x03\x00\x20", 4);
	pass(s, 200);
	look(s, "in the end");
	trace_check();
}

static void test_reload(void **state)
{
	static const char *const settings[] = {"lever_arm.l=0.5", "producer_heartbeat_time=300", NULL};
	static struct config before, after;
	struct scene *s = begin(state, "reload", "ideal", "rest");
	char error[CONFIG_ERROR_MAX];

	power_on(s, settings);
	put(s, "lever_arm.s", "0.25");
	put(s, "store_parameters.manufacturer", "0x65766173");
	config_init(&before, &imu9_od_table);
	assert_int_equal(config_set(&before, "inhibit_time_emcy=0", error), 0);
	for (int i = 0; settings[i]; i++)
		assert_int_equal(config_set(&before, settings[i], error), 0);
	after = before;
	pass(s, 100);
	trace_value("result", reload(&s->world.device, &before, &after, s->world.now_us), 0);
	look(s, "nothing");
	assert_int_equal(config_set(&after, "lever_arm.l=0.7", error), 0);
	assert_int_equal(config_set(&after, "lever_arm.s=0.8", error), 0);
	assert_int_equal(config_set(&after, "lever_arm.t=0.9", error), 0);
	assert_int_equal(config_set(&after, "lever_arm_model=1", error), 0);
	assert_int_equal(config_set(&after, "angle_resolution=100", error), 0);
	assert_int_equal(config_set(&after, "producer_heartbeat_time=400", error), 0);
	static const char *const keys[] = {"imu", "can", "store", "record", "run_led", "error_led", "cia309", "modbus"};
	for (size_t i = 0; i < sizeof(keys) / sizeof(keys[0]); i++)
		assert_int_equal(config_option(&after, keys[i], "another", error), 0);
	static const char *const numbers[] = {"node_id", "realtime", "serial", "vendor_id"};
	for (size_t i = 0; i < sizeof(numbers) / sizeof(numbers[0]); i++)
		assert_int_equal(config_option(&after, numbers[i], "7", error), 0);
	assert_int_equal(config_option(&after, "bitrate", "125000", error), 0);
	assert_int_equal(config_option(&after, "log_level", "debug", error), 0);
	trace_value("result", reload(&s->world.device, &before, &after, s->world.now_us), 0);
	tick(s);
	pass(s, 100);
	look(s, "much");
	trace_vec("lever arm",
		(struct vec3){(double)s->world.device.values.lever_arm.l, (double)s->world.device.values.lever_arm.s,
			(double)s->world.device.values.lever_arm.t},
		1e-6);
	assert_int_equal(config_set(&after, "accelerometer_calibration.xx=0", error), 0);
	trace_value("result", reload(&s->world.device, &before, &after, s->world.now_us), 0);
	tick(s);
	look(s, "a contradiction");
	nmt(s, 129);
	pass(s, 100);
	look(s, "reset node");
	trace_check();
}

/* ---- scenes: recording ------------------------------------------------------------------------------------------- */

static void test_recording(void **state)
{
	struct scene *s = begin(state, "recording", "ideal", "rest");
	struct world *w = &s->world;

	power_on(s, NULL);
	put(s, "recording.command", "1"); /* there is none */
	assert_int_equal(record_open(&s->record), 0);
	record_attach(&s->record, &w->device);
	pass(s, 500);
	look(s, "begun");
	nmt(s, 1);
	put(s, "lever_arm.l", "0.5");
	device_host_clock(&w->device, true, 77);
	device_away(&w->device, 1000, w->now_us);
	device_saved(&w->device, 0, w->now_us);
	w->disk_answer = -EIO;
	put(s, "store_parameters.all", "0x65766173");
	put(s, "sensor.rate", "200");
	w->bus.counters.tx += 9;
	for (int i = 0; i < 30; i++) {
		receive(s, 0x080, 0, NULL);
		pass(s, 50);
	}
	look(s, "inputs");
	const struct od_domain *snapshot = od_find_domain(&w->device.od, 0x2130, 0);
	static uint8_t bytes[OD_DOMAIN_MAX];
	size_t size = snapshot->read(snapshot->ctx, bytes);
	device_write(&w->device, 0x2130, 0, bytes, size, w->now_us);
	tick(s);
	pass(s, 30);
	look(s, "a snapshot written");
	w->bus.counters = (struct can_counters){200, 31, 2, 3, 4, 5, 6};
	w->bus.tx_errors = 7;
	w->bus.rx_errors = 8;
	w->bus.state = CAN_STATE_WARNING;
	pass(s, 30);
	look(s, "the bus");
	w->imu.health = (struct imu_health){0, 1, 2, 3, 4, 5, 6, 7, 8.5f};
	w->imu.counters.skipped = 9;
	w->imu.counters.late = 10;
	w->imu.silence_us = 110000;
	pass(s, 30);
	look(s, "the sensor");
	w->bus.state = CAN_STATE_BUS_OFF;
	tick(s);
	pass(s, 1200);
	look(s, "bus-off");
	put(s, "recording.command", "2");
	put(s, "recording.command", "0");
	pass(s, 30);
	look(s, "stopped");
	put(s, "recording.command", "2");
	put(s, "recording.command", "1");
	pass(s, 30);
	look(s, "started");
	record_others(&s->record);
	record_begin_again(&s->record);
	pass(s, 30);
	look(s, "again");
	atomic_store(&s->record.full, true);
	pass(s, 30);
	look(s, "full");
	atomic_store(&s->record.full, false);
	atomic_store(&s->record.kept, 3);
	pass(s, 100000); /* nobody takes the entries */
	look(s, "too many");
	pass(s, 30);
	look(s, "room again");
	atomic_store(&s->record.error, ENOSPC);
	pass(s, 30);
	look(s, "no room on the disk");
	put(s, "recording.command", "1");
	pass(s, 30);
	look(s, "started again");
	device_sample(&w->device, -EIO, NULL, w->now_us);
	tick(s);
	look(s, "the sensor fails");
	trace_check();
}

int main(void)
{
#define TEST(test) cmocka_unit_test_teardown(test, end)
	struct CMUnitTest tests[] = {
		TEST(test_outputs_in_motion), TEST(test_aids_and_resets), TEST(test_thresholds), TEST(test_bus_faults),
		TEST(test_bus_limits_and_commands), TEST(test_sensor_faults), TEST(test_sensor_settings),
		TEST(test_a_sensor_without_settings), TEST(test_storing), TEST(test_lss), TEST(test_time),
		TEST(test_procedures), TEST(test_six_faces), TEST(test_lever_arm), TEST(test_last_movement),
		TEST(test_snapshots), TEST(test_reload), TEST(test_recording), {0}, /* of trace_run() */
	};

	return trace_run("device", tests, sizeof(tests) / sizeof(tests[0]) - 1);
}
