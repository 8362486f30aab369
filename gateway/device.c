#include "gateway/device.h"

#include <stdio.h>
#include <string.h>

#include "gateway/canopen/deadline.h"
#include "gateway/publish.h"
#include "gateway/settings.h"
#include "gateway/slope_range.h"
#include "gateway/threshold.h"
#include "od_index.h"

enum { IMPLAUSIBLE_US = 1000000 /* without another one, and EMCY 5032h is over */ };

/* ---- configuration: objects to pipeline -------------------------------------------------------------------------- */

static void on_configuration_changed(void *ctx, const struct od_entry *entry)
{
	struct device *d = ctx;

	(void)entry;
	d->configuration_changed = true;
}

static struct pipeline_config configuration(struct device *d, const struct od_values *values)
{
	struct pipeline_config config = settings_pipeline(values);

	config.uncalibrated = settings_uncalibrated(values, d->imu->uncalibrated);
	return config;
}

/* Says once which sensors nobody calibrated. */
static void tell_uncalibrated(struct device *d)
{
	unsigned bits = d->pipeline.config.uncalibrated;

	d->values.sensor_state.uncalibrated = (uint8_t)bits;
	if (bits == d->uncalibrated)
		return;
	d->uncalibrated = bits;
	if (bits)
		event_log_line(&d->log, d->now_us,
			"never calibrated:%s%s%s; the sigmas are those of data sheets: see imu9-calibrate, or 2055h",
			bits & PIPELINE_UNCALIBRATED_GYRO ? " gyro" : "",
			bits & PIPELINE_UNCALIBRATED_ACCEL ? " accelerometer" : "",
			bits & PIPELINE_UNCALIBRATED_MAG ? " magnetometer" : "");
	else
		event_log_line(&d->log, d->now_us, "all sensors are calibrated");
}

/* Between two samples, all or nothing: an inconsistent configuration leaves the previous one in use. */
static bool apply_configuration(struct device *d)
{
	struct pipeline_config config = configuration(d, &d->values);

	d->configuration_changed = false;
	if (pipeline_configure(&d->pipeline, &config) < 0)
		return false;
	tell_uncalibrated(d);
	canopen_error_clear(&d->canopen, EMCY_CONFIGURATION, d->now_us);
	return true;
}

static void apply_or_report(struct device *d)
{
	if (!apply_configuration(d))
		canopen_error_set(&d->canopen, EMCY_CONFIGURATION, ERROR_MANUFACTURER, NULL, d->now_us);
}

static bool on_snapshot_apply(void *ctx)
{
	return apply_configuration(ctx);
}

static void on_snapshot_done(void *ctx, enum od_status status, unsigned entries, uint16_t index, uint8_t sub)
{
	struct device *d = ctx;

	if (status == OD_OK)
		event_log_line(&d->log, d->now_us, "configuration snapshot of %u entries applied", entries);
	else if (index)
		event_log_warning(&d->log, d->now_us, "configuration snapshot refused: %04Xh:%02X: %s", index, sub,
			od_status_text(status));
	else
		event_log_warning(&d->log, d->now_us, "configuration snapshot refused: %s", od_status_text(status));
}

/* 2040h:6 = 1 resets velocity and position to zero. */
static enum od_status on_command(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	struct device *d = ctx;

	if (entry->sub != OD_SUB_POSITION_RESET)
		return OD_OK;
	if (size != 1 || *(const uint8_t *)wire != 1)
		return OD_BAD_VALUE;
	pipeline_reset_position(&d->pipeline);
	return OD_CONSUMED;
}

static enum od_status on_resolution(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	const uint8_t *bytes = wire;

	(void)ctx;
	if (entry->index != OD_INDEX_ANGLE_RESOLUTION || size != 2)
		return OD_OK;
	unsigned value = bytes[0] | (unsigned)bytes[1] << 8;
	return value == 1 || value == 10 || value == 100 || value == 1000 ? OD_OK : OD_BAD_VALUE;
}

static void on_preset(void *ctx, const struct od_entry *entry)
{
	struct device *d = ctx;

	publish_preset(&d->od, entry->index);
}

/* ---- storage ----------------------------------------------------------------------------------------------------- */

static enum od_status on_store(void *ctx, enum od_group group)
{
	return storing_store(&((struct device *)ctx)->storing, group);
}

static enum od_status on_restore(void *ctx, enum od_group group)
{
	return storing_restore(&((struct device *)ctx)->storing, group);
}

static enum od_status on_store_lss(void *ctx, uint8_t node_id, uint32_t bit_s)
{
	return storing_store_lss(&((struct device *)ctx)->storing, node_id, bit_s);
}

void device_saved(struct device *d, int result, uint64_t now_us)
{
	record_input(d->record, &(struct record_entry){.kind = RECORD_SAVED, .now_us = now_us, .value = result});
	d->now_us = now_us;
	storing_saved(&d->storing, result, now_us);
	write_lock_update(&d->write_lock);
}

/* Inconsistent stored values must not keep the device from starting: it uses those of file and command line until they
 * are corrected; EMCY 6320h reports it with the first sample. */
static int start_pipeline(struct device *d)
{
	struct pipeline_config config = configuration(d, &d->values);
	int rc = pipeline_init(&d->pipeline, &config, d->imu->rate_hz);

	if (rc < 0) {
		d->configuration_changed = true;
		config = configuration(d, &d->storing.base);
		rc = pipeline_init(&d->pipeline, &config, d->imu->rate_hz);
	}
	if (rc == 0)
		last_movement_start(&d->last_movement, &d->pipeline);
	return rc;
}

/* LSS can change the node-ID with a reset. The defaults that contain it follow. */
static void follow_node_id(struct device *d)
{
	if (storing_follow_node_id(&d->storing, d->canopen.id) && d->canopen.id != CANOPEN_UNCONFIGURED)
		event_log_line(&d->log, d->now_us, "node-ID is %u, assigned by LSS", d->canopen.id);
}

/* NMT reset: power-on values; reset node also restarts the application. */
static void on_reset(void *ctx, enum od_group group)
{
	struct device *d = ctx;

	follow_node_id(d); /* on_nmt_changed() is not called when the node loses its node-ID */
	lever_arm_command_reset(&d->lever_arm_command);
	calibration_command_reset(&d->calibration_command);
	event_log_add(&d->log, d->now_us, group == OD_GROUP_ALL ? "reset node" : "reset communication");
	storing_reset(&d->storing, group, d->now_us);
	pdo_preset_update(&d->pdo_preset);
	lever_arm_um_update(&d->lever_arm_um);
	if (group != OD_GROUP_ALL)
		return;
	sensor_watch_apply(&d->sensor_watch);
	sensor_watch_reset(&d->sensor_watch);
	(void)start_pipeline(d); /* cannot fail: the values of file and command line were valid at the start */
	tell_uncalibrated(d);
	aids_reset(&d->aids);
	d->angle_filter = (struct angle_filter){0};
	/* persistent faults are detected and reported again */
	d->sensor_lost = d->position_unsure = false;
	d->implausible = 0;
	d->implausible_us = 0;
	bus_health_reset(&d->bus_health);
}

static bool on_bit_rate_possible(void *ctx, uint32_t bit_s)
{
	return bus_health_bit_rate_possible(&((struct device *)ctx)->bus_health, bit_s);
}

static void on_set_bit_rate(void *ctx, uint32_t bit_s)
{
	bus_health_set_bit_rate(&((struct device *)ctx)->bus_health, bit_s);
}

static void on_time(void *ctx, uint16_t day, uint32_t ms, uint64_t t_us)
{
	utc_time(&((struct device *)ctx)->utc, day, ms, t_us);
}

static void on_collision(void *ctx, uint32_t id)
{
	struct device *d = ctx;

	event_log_warning(&d->log, d->now_us,
		"another node sends with COB-ID %03Xh of this node: is node-ID %u assigned twice?", id, d->canopen.id);
}

static double change_threshold(void *ctx, const struct od_entry *entry)
{
	return threshold_of(&((struct device *)ctx)->od, entry);
}

static void on_nmt_changed(void *ctx, enum nmt_state state)
{
	struct device *d = ctx;

	follow_node_id(d);
	event_log_line(&d->log, d->now_us, "NMT state: %s",
		state == NMT_OPERATIONAL       ? "operational"
		: state == NMT_PRE_OPERATIONAL ? "pre-operational"
		: state == NMT_STOPPED	       ? "stopped"
					       : "initialising");
}

/* The beginning and the end are lines of one kind. */
static void on_error_changed(void *ctx, uint16_t code, bool set, const uint8_t info[5])
{
	struct device *d = ctx;
	char what[48] = " is over";

	if (set)
		snprintf(what, sizeof(what), ", EMCY bytes 3 to 7: %02X %02X %02X %02X %02X", info[0], info[1], info[2],
			info[3], info[4]);
	if (set)
		record_emcy(d->record, d->now_us);
	event_log_add_about(&d->log, d->now_us, code, "error %04Xh (%s)%s", code, emcy_code_text(code), what);
}

/* ---- life -------------------------------------------------------------------------------------------------------- */

/* 1021h has the vendor-ID of 1018h:1: configuration tools compare the EDS with the device. */
static void set_eds(struct device *d)
{
	char vendor[sizeof("0x00000000")];

	memcpy(d->eds_text, imu9_eds, imu9_eds_size);
	snprintf(vendor, sizeof(vendor), "0x%08X", d->values.identity.vendor_id);
	for (size_t i = 0; i < IMU9_EDS_VENDORS; i++)
		memcpy(d->eds_text + imu9_eds_vendor[i], vendor, strlen(vendor));
	d->eds = (struct od_domain){.index = OD_INDEX_STORE_EDS, .data = d->eds_text, .size = imu9_eds_size};
	od_set_domain(&d->od, &d->eds);
}

static void attach_hooks(struct device *d)
{
	write_lock_attach(&d->write_lock, &d->od, &d->values, &d->storing, &d->log, &d->now_us);
	d->configuration_hook =
		(struct od_hook){.first = 0x2000, .last = 0x206F, .after = on_configuration_changed, .ctx = d};
	d->command_hook =
		(struct od_hook){.first = OD_INDEX_POSITION, .last = OD_INDEX_POSITION, .before = on_command, .ctx = d};
	d->resolution_hook = (struct od_hook){.first = OD_INDEX_ANGLE_RESOLUTION,
		.last = OD_INDEX_ANGLE_RESOLUTION,
		.before = on_resolution,
		.ctx = d};
	d->preset_hook = (struct od_hook){.first = OD_INDEX_SLOPE_LONG16,
		.last = OD_INDEX_SLOPE_LATERAL32_PRESET_VALUE,
		.after = on_preset,
		.ctx = d};
	lever_arm_um_attach(&d->lever_arm_um, &d->od, &d->values);
	aids_init(&d->aids, &d->od, &d->values, &d->pipeline);
	od_attach(&d->od, &d->command_hook);
	od_attach(&d->od, &d->configuration_hook);
	od_attach(&d->od, &d->resolution_hook);
	od_attach(&d->od, &d->preset_hook);
	lever_arm_command_init(&d->lever_arm_command, &d->commands, &d->od, &d->values, &d->pipeline);
	calibration_command_init(&d->calibration_command, &d->commands, &d->od, &d->values);
	d->procedure_log = (struct procedure_log){&d->log, &d->values, &d->now_us};
	procedure_log_attach(&d->procedure_log, &d->commands);
	set_eds(d);
	event_log_attach(&d->log, &d->od);
	last_movement_attach(&d->last_movement, &d->od, &d->values);
	latency_attach(&d->latency, &d->od);
	record_attach_object(d);
	d->snapshot.od = &d->od;
	d->snapshot.node_id = &d->canopen.id;
	d->snapshot.ctx = d;
	d->snapshot.apply = on_snapshot_apply;
	d->snapshot.done = on_snapshot_done;
	snapshot_attach(&d->snapshot);
}

int device_init(struct device *d, struct can_port *bus, struct imu_port *imu, const struct storing_port *storage,
	const struct store_image *stored, uint8_t node_id)
{
	const struct canopen_device callbacks = {.ctx = d,
		.store = on_store,
		.restore = on_restore,
		.reset = on_reset,
		.nmt_changed = on_nmt_changed,
		.change_threshold = change_threshold,
		.error_changed = on_error_changed,
		.store_lss = storage ? on_store_lss : NULL,
		.bit_rate_possible = on_bit_rate_possible,
		.set_bit_rate = on_set_bit_rate,
		.time = on_time,
		.collision = on_collision};

	d->bus = bus;
	d->imu = imu;
	const struct imu_settings opened = sensor_settings(&d->values);
	storing_init(&d->storing, &d->od, &d->canopen, &d->log, storage, stored, node_id);
	storing_apply(&d->storing, OD_GROUP_ALL, d->now_us);
	sensor_watch_init(&d->sensor_watch, imu, &opened, &d->od, &d->values, &d->canopen, &d->log);
	sensor_watch_apply(&d->sensor_watch);

	int rc = start_pipeline(d);
	if (rc < 0)
		return rc;
	attach_hooks(d);
	bus_health_init(&d->bus_health, bus, &d->canopen, &d->od, &d->log);
	leds_init(&d->leds, &d->values, &d->canopen, bus);
	utc_init(&d->utc, &d->values, &d->canopen);
	rc = canopen_init(&d->canopen, &d->od, bus, &callbacks, node_id);
	pdo_preset_attach(&d->pdo_preset, &d->od, &d->values.pdo_preset);
	return rc;
}

void device_start(struct device *d, bool stored_damaged, uint64_t now_us)
{
	record_input(
		d->record, &(struct record_entry){.kind = RECORD_START, .now_us = now_us, .value = stored_damaged});
	d->now_us = d->last_sample_us = now_us;
	event_log_start(&d->log, now_us);
	event_log_add(&d->log, now_us, "started with node-ID %u on %s, IMU %s", d->storing.node_id, d->bus->name,
		d->imu->name);
	tell_uncalibrated(d);
	canopen_start(&d->canopen, now_us);
	if (stored_damaged)
		canopen_error_set(&d->canopen, EMCY_STORE_DAMAGED, ERROR_MANUFACTURER, NULL, now_us);
}

static void measure_sent(struct device *d)
{
	latency_sent(&d->latency, &d->canopen, (uint64_t)d->utc.taken_us);
}

/* ---- samples ----------------------------------------------------------------------------------------------------- */

/* Until the next sample. A calibration or identification in progress ends as refused. */
static void invalidate_outputs(struct device *d)
{
	publish_sensor_lost(&d->values);
	command_group_sensor_lost(&d->commands);
	d->values.sample.status &= (uint16_t)~STATUS_COMMISSIONING;
}

static void sensor_lost(struct device *d)
{
	uint8_t info[5];
	char why[64];

	if (d->sensor_lost)
		return;
	d->sensor_lost = true;
	sensor_watch_info(&d->sensor_watch, info);
	sensor_fault_text(info, why, sizeof(why));
	event_log_warning(&d->log, d->now_us, "no samples from %s%s: EMCY %04Xh, outputs marked invalid", d->imu->name,
		why, EMCY_SENSOR_LOST);
	invalidate_outputs(d);
	d->values.sample.status |= (uint16_t)sensor_watch_status(&d->sensor_watch);
	canopen_error_set(&d->canopen, EMCY_SENSOR_LOST, ERROR_MANUFACTURER, info, d->now_us);
	canopen_sample(&d->canopen, d->now_us); /* the status word has changed */
}

/* No samples arrive during a self-test. The next one makes the outputs valid again. */
static void watch_self_test(struct device *d)
{
	bool testing = sensor_watch_testing(&d->sensor_watch);

	if (testing && !d->sensor_testing) {
		event_log_line(
			&d->log, d->now_us, "self-test of %s: outputs marked invalid until it has ended", d->imu->name);
		invalidate_outputs(d);
		canopen_sample(&d->canopen, d->now_us);
	}
	d->sensor_testing = testing;
}

static void sensor_back(struct device *d)
{
	if (!d->sensor_lost)
		return;
	d->sensor_lost = false;
	event_log_line(&d->log, d->now_us, "samples from %s resumed", d->imu->name);
	canopen_error_clear(&d->canopen, EMCY_SENSOR_LOST, d->now_us);
}

static void publish_sensor_counters(struct device *d)
{
	d->values.sensor_counters.samples = d->imu->counters.samples;
	d->values.sensor_counters.skipped = d->imu->counters.skipped;
	d->values.sensor_counters.late = d->imu->counters.late;
	d->values.sensor_counters.gaps = d->pipeline.gaps;
	d->values.sensor_counters.implausible = d->pipeline.implausible;
	d->values.sensor_counters.glitches = d->pipeline.gyro_glitch.count + d->pipeline.accel_glitch.count;
}

/* The pipeline kept an output back. */
static void watch_plausibility(struct device *d, uint64_t now_us)
{
	bool more = d->pipeline.implausible != d->implausible;

	if (more)
		canopen_error_set(&d->canopen, EMCY_IMPLAUSIBLE, ERROR_MANUFACTURER, NULL, now_us);
	else if (d->implausible_us && now_us - d->implausible_us > IMPLAUSIBLE_US)
		canopen_error_clear(&d->canopen, EMCY_IMPLAUSIBLE, now_us);
	else
		return;
	d->implausible = d->pipeline.implausible;
	d->implausible_us = more ? now_us : 0;
}

/* 2040h:9. Not a fault of the sensor: the movement has lasted too long without a zero-velocity update. */
static void watch_uncertainty(struct device *d, unsigned status)
{
	bool unsure = status & PIPELINE_UNSURE;

	if (unsure && !d->position_unsure)
		canopen_error_set(&d->canopen, EMCY_POSITION_UNSURE, ERROR_MANUFACTURER, NULL, d->now_us);
	if (!unsure && d->position_unsure)
		canopen_error_clear(&d->canopen, EMCY_POSITION_UNSURE, d->now_us);
	d->position_unsure = unsure;
}

/* Samples are refused whose time does not increase. When the sensor counts as lost, and the time of such samples does
 * increase, its clock has gone back, or one time stamp was too far ahead: the pipeline starts over. */
static int step_pipeline(struct device *d, const struct imu_sample *sample, struct pipeline_output *out)
{
	struct imu_sample again = *sample;
	int rc = pipeline_step(&d->pipeline, sample, out);

	if (rc < 0 && d->sensor_lost && sample->t_us > d->refused_t_us) {
		again.flags |= SAMPLE_DISCONTINUITY;
		rc = pipeline_step(&d->pipeline, &again, out);
	}
	if (rc < 0)
		d->refused_t_us = sample->t_us;
	return rc;
}

void device_sample(struct device *d, int read, const struct imu_sample *sample, uint64_t now_us)
{
	struct pipeline_output out;

	record_sample(d->record, read, sample, now_us);
	d->now_us = now_us;
	if (read < 0) {
		sensor_lost(d);
		return;
	}
	if (d->configuration_changed)
		apply_or_report(d);
	aids_step(&d->aids, now_us);
	uint16_t counter = (uint16_t)d->samples++;
	if (step_pipeline(d, sample, &out) < 0)
		return;
	latency_stage(&d->latency, LATENCY_FILTER);
	d->last_sample_us = now_us;
	sensor_back(d);
	command_group_sample(&d->commands);
	lever_arm_command_sample(&d->lever_arm_command, sample, now_us);
	calibration_command_sample(&d->calibration_command, sample);
	sensor_watch_sample(&d->sensor_watch, sample);
	out.angles_rad = angle_filter_step(
		&d->angle_filter, (double)d->values.angle_filter.cutoff, sample->t_us, out.angles_rad);
	unsigned clipped = publish_sample(&d->od, &out, counter);
	last_movement_publish(&d->last_movement);
	slope_range_check(&d->canopen, &d->values, clipped, now_us);
	if (utc_sample(&d->utc, sample->t_us, now_us) != UTC_NONE)
		d->values.sample.status |= STATUS_UTC;
	d->values.sample.status |= (uint16_t)command_group_status(&d->commands);
	d->values.sample.status |= (uint16_t)aids_status(&d->aids, now_us);
	d->values.sample.status |= (uint16_t)sensor_watch_status(&d->sensor_watch);
	publish_sensor_counters(d);
	watch_uncertainty(d, out.status);
	watch_plausibility(d, now_us);
	canopen_sample(&d->canopen, now_us);
	latency_stage(&d->latency, LATENCY_PUBLISH);
	measure_sent(d);
}

/* ---- the bus ----------------------------------------------------------------------------------------------------- */

void device_receive(struct device *d, const struct can_msg *msg, uint64_t now_us)
{
	record_input(d->record, &(struct record_entry){.kind = RECORD_FRAME, .now_us = now_us, .msg = *msg});
	d->now_us = now_us;
	canopen_receive(&d->canopen, msg, now_us);
	measure_sent(d);
}

enum od_status device_write(
	struct device *d, uint16_t index, uint8_t sub, const void *wire, size_t size, uint64_t now_us)
{
	record_write(d->record, index, sub, wire, size, now_us);
	d->now_us = now_us;
	return canopen_write(&d->canopen, index, sub, wire, size, now_us);
}

void device_away(struct device *d, uint64_t us, uint64_t now_us)
{
	record_input(
		d->record, &(struct record_entry){.kind = RECORD_AWAY, .now_us = now_us, .offset_us = (int64_t)us});
	d->last_sample_us = earlier(d->last_sample_us + us, now_us);
}

void device_host_clock(struct device *d, bool synchronised, int64_t offset_us)
{
	record_input(d->record,
		&(struct record_entry){
			.kind = RECORD_CLOCK, .now_us = d->now_us, .value = synchronised, .offset_us = offset_us});
	utc_host_clock(&d->utc, synchronised, offset_us);
}

uint64_t device_tick(struct device *d, uint64_t now_us)
{
	d->now_us = now_us;
	record_tick(d->record, now_us);
	watch_self_test(d);
	if (now_us - d->last_sample_us >= sensor_watch_silence_us(&d->sensor_watch))
		sensor_lost(d);
	sensor_watch_tick(&d->sensor_watch, now_us);

	uint64_t next = bus_health_tick(&d->bus_health, now_us);
	next = earlier(next, utc_tick(&d->utc, now_us));
	next = earlier(next, canopen_tick(&d->canopen, now_us));
	measure_sent(d);
	next = earlier(next, leds_tick(&d->leds, now_us));
	next = earlier(next, event_log_tick(&d->log, now_us));
	if (!d->sensor_lost)
		next = earlier(next, d->last_sample_us + sensor_watch_silence_us(&d->sensor_watch));
	return next;
}
