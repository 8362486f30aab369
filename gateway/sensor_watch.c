#include "gateway/sensor_watch.h"

#include <math.h>
#include <stdio.h>

#include "gateway/status.h"
#include "od_index.h"

enum { SELF_TEST_US = 5000000 /* at most */ };

struct imu_settings sensor_settings(const struct od_values *v)
{
	return (struct imu_settings){
		.rate_hz = (double)v->sensor.rate,
		.gyro_range_deg_s = (double)v->sensor.gyro_range,
		.accel_range_g = (double)v->sensor.accelerometer_range,
		.mag_range_uT = (double)v->sensor.magnetometer_range,
		.bandwidth_hz = (double)v->sensor.bandwidth,
		.self_test = v->sensor.self_test_at_start,
	};
}

static bool same(const struct imu_settings *a, const struct imu_settings *b)
{
	return a->rate_hz == b->rate_hz && a->gyro_range_deg_s == b->gyro_range_deg_s &&
	       a->accel_range_g == b->accel_range_g && a->mag_range_uT == b->mag_range_uT &&
	       a->bandwidth_hz == b->bandwidth_hz;
}

static const char *fault_text(uint8_t fault)
{
	switch ((enum imu_fault)fault) {
	case IMU_FAULT_NONE:
		break;
	case IMU_FAULT_SILENT:
		return "does not answer";
	case IMU_FAULT_STOPPED:
		return "has stopped measuring";
	case IMU_FAULT_FROZEN:
		return "repeats the same values";
	case IMU_FAULT_SATURATED:
		return "is at the limit of its range";
	case IMU_FAULT_CONFIGURATION:
		return "has lost its configuration";
	case IMU_FAULT_WRONG_CHIP:
		return "is a different chip than before";
	case IMU_FAULT_SELF_TEST:
		return "failed its self-test";
	}
	return "has no fault";
}

static const char *chip_text(uint8_t chip)
{
	return chip == IMU_CHIP_GYRO ? "the gyro" : chip == IMU_CHIP_ACCEL ? "the accelerometer" : "the magnetometer";
}

void sensor_fault_text(const uint8_t info[5], char *text, size_t size)
{
	text[0] = '\0';
	if (info[0] != IMU_FAULT_NONE)
		snprintf(text, size, ": %s %s", chip_text(info[1]), fault_text(info[0]));
}

/* ---- settings ---------------------------------------------------------------------------------------------------- */

static bool configure(struct sensor_watch *w, const struct imu_settings *settings, int dry)
{
	char why[160] = "";
	int result = w->imu->ops && w->imu->ops->configure
			     ? w->imu->ops->configure(w->imu, settings, dry, why, sizeof why)
			     : 0;

	record_configured(w->record, result, w->imu);
	if (result < 0)
		event_log_warning(w->log, w->canopen->now_us,
			"the sensor does not support 2058h, its settings are unchanged: %s", why);
	return result == 0;
}

void sensor_watch_apply(struct sensor_watch *w)
{
	struct imu_settings wanted = sensor_settings(w->values);

	w->refused = false;
	if (same(&wanted, &w->in_use))
		return;
	w->refused = !configure(w, &wanted, 0);
	if (!w->refused)
		w->in_use = wanted;
}

static enum od_status before(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	struct sensor_watch *w = ctx;

	if (entry->sub != OD_SUB_SENSOR_SELF_TEST)
		return OD_OK;
	if (size != 1 || *(const uint8_t *)wire != 1)
		return OD_BAD_VALUE;
	if (!w->imu->ops || !w->imu->ops->self_test)
		return OD_DEVICE_STATE;
	w->imu->ops->self_test(w->imu);
	return OD_CONSUMED;
}

/* The settings take effect at the next reset node; unsupported ones are reported now. */
static void after(void *ctx, const struct od_entry *entry)
{
	struct sensor_watch *w = ctx;
	struct imu_settings wanted = sensor_settings(w->values);

	(void)entry;
	w->refused = !configure(w, &wanted, 1);
}

void sensor_watch_init(struct sensor_watch *w, struct imu_port *imu, const struct imu_settings *opened, struct od *od,
	struct od_values *values, struct canopen_node *canopen, struct event_log *log)
{
	*w = (struct sensor_watch){.imu = imu, .values = values, .canopen = canopen, .log = log, .in_use = *opened};
	w->hook = (struct od_hook){
		.first = OD_INDEX_SENSOR, .last = OD_INDEX_SENSOR, .before = before, .after = after, .ctx = w};
	od_attach(od, &w->hook);
	values->sensor_state.temperature = SENSOR_NO_TEMPERATURE;
	values->device_temperature = SENSOR_NO_TEMPERATURE;
}

void sensor_watch_reset(struct sensor_watch *w)
{
	w->degraded = w->degraded_chip = 0;
	w->refusal_reported = false;
}

/* ---- state ------------------------------------------------------------------------------------------------------- */

void sensor_watch_sample(struct sensor_watch *w, const struct imu_sample *sample)
{
	w->saturated = sample->flags & SAMPLE_SATURATED;
	if (!(sample->flags & SAMPLE_TEMPERATURE) || !(fabs(sample->temperature_degC) <= INT16_MAX)) /* NaN, too */
		return;
	w->values->sensor_state.temperature = (float)sample->temperature_degC;
	w->values->device_temperature = (int16_t)floor(sample->temperature_degC + 0.5);
}

static void publish(struct sensor_watch *w)
{
	const struct imu_health *h = &w->imu->health;

	w->values->sensor_state.fault = h->fault;
	w->values->sensor_state.fault_chip = h->fault_chip;
	w->values->sensor_state.degraded = h->degraded;
	w->values->sensor_state.degraded_chip = h->degraded_chip;
	w->values->sensor_state.self_test = h->self_test;
	w->values->sensor_state.bus_errors = h->bus_errors;
	w->values->sensor_state.restarts = h->restarts;
	w->values->sensor_state.overruns = h->overruns;
	w->values->sensor_state.rate = h->rate_hz;
}

static void report_degraded(struct sensor_watch *w, uint64_t now_us)
{
	const struct imu_health *h = &w->imu->health;

	if (h->degraded == w->degraded && h->degraded_chip == w->degraded_chip)
		return;
	if (w->degraded) {
		event_log_line(w->log, now_us, "%s has recovered", chip_text(w->degraded_chip));
		canopen_error_clear(w->canopen, EMCY_SENSOR_DEGRADED, now_us);
	}
	w->degraded = h->degraded;
	w->degraded_chip = h->degraded_chip;
	if (!w->degraded)
		return;
	event_log_warning(w->log, now_us, "%s %s: EMCY %04Xh, samples continue", chip_text(w->degraded_chip),
		fault_text(w->degraded), EMCY_SENSOR_DEGRADED);
	canopen_error_set(w->canopen, EMCY_SENSOR_DEGRADED, ERROR_MANUFACTURER,
		(const uint8_t[5]){w->degraded, w->degraded_chip}, now_us);
}

void sensor_watch_tick(struct sensor_watch *w, uint64_t now_us)
{
	publish(w);
	report_degraded(w, now_us);
	if (w->refused && !w->refusal_reported)
		canopen_error_set(w->canopen, EMCY_SENSOR_SETTINGS, ERROR_MANUFACTURER, NULL, now_us);
	if (!w->refused && w->refusal_reported)
		canopen_error_clear(w->canopen, EMCY_SENSOR_SETTINGS, now_us);
	w->refusal_reported = w->refused;
}

bool sensor_watch_testing(const struct sensor_watch *w)
{
	return w->imu->health.self_test & IMU_SELF_TEST_RUNS;
}

uint64_t sensor_watch_silence_us(const struct sensor_watch *w)
{
	return sensor_watch_testing(w) ? SELF_TEST_US : w->imu->silence_us;
}

unsigned sensor_watch_status(const struct sensor_watch *w)
{
	return w->saturated || w->imu->health.fault || w->imu->health.degraded ? STATUS_SENSOR_FAULT : 0;
}

void sensor_watch_info(const struct sensor_watch *w, uint8_t info[5])
{
	info[0] = w->imu->health.fault;
	info[1] = w->imu->health.fault_chip;
	info[2] = info[3] = info[4] = 0;
}
