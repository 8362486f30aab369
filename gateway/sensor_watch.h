/* gateway/sensor_watch.h
 * The settings of the sensor (2058h), the state of its chips (2124h, EMCY 5031h and 6321h, status bit 10) and its
 * temperature (6511h, degC). One thread. */
#ifndef GATEWAY_SENSOR_WATCH_H
#define GATEWAY_SENSOR_WATCH_H

#include <stdbool.h>

#include "drivers/ports/imu.h"
#include "gateway/canopen/node.h"
#include "gateway/event_log.h"
#include "gateway/record.h"
#include "od_values.h"

/** 6511h and 2124h:10 as long as no sample has had a temperature, degC. */
#define SENSOR_NO_TEMPERATURE (-300)

struct sensor_watch {
	/* PRIVATE */
	struct imu_port *imu;
	struct od_values *values;
	struct canopen_node *canopen;
	struct event_log *log;
	struct record *record; /* of the device */
	struct od_hook hook;
	struct imu_settings in_use;
	bool refused, refusal_reported;
	bool saturated;			 /* the last sample */
	uint8_t degraded, degraded_chip; /* as reported by EMCY */
};

/** 2058h as settings of the driver, without the priority of its thread. */
struct imu_settings sensor_settings(const struct od_values *values);

/** `opened`: the settings that the sensor was opened with. */
void sensor_watch_init(struct sensor_watch *watch, struct imu_port *imu, const struct imu_settings *opened,
	struct od *od, struct od_values *values, struct canopen_node *canopen, struct event_log *log);

/** At the start and with reset node: configures the sensor when 2058h differs from its settings. May change
 * imu->rate_hz. */
void sensor_watch_apply(struct sensor_watch *watch);
/** Reset node: persistent faults are reported again. */
void sensor_watch_reset(struct sensor_watch *watch);

void sensor_watch_sample(struct sensor_watch *watch, const struct imu_sample *sample);
void sensor_watch_tick(struct sensor_watch *watch, uint64_t now_us);

/** A self-test runs: no samples arrive, which is no fault. */
bool sensor_watch_testing(const struct sensor_watch *watch);
/** Timeout: without a sample for so long the sensor is lost. */
uint64_t sensor_watch_silence_us(const struct sensor_watch *watch);

/** Bits of the status word. */
unsigned sensor_watch_status(const struct sensor_watch *watch);

/** The manufacturer-specific bytes of EMCY 5030h: enum imu_fault, enum imu_chip; 0: unknown. */
void sensor_watch_info(const struct sensor_watch *watch, uint8_t info[5]);

/** The same as text for the log: ": the gyro does not answer", or "". */
void sensor_fault_text(const uint8_t info[5], char *text, size_t size);

#endif
