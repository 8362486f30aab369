/* gateway/device.h
 * The whole device, passive: samples, CAN frames and time go in; CAN frames and files to be stored go out through
 * ports. The process (loop.c) and the scenario tests in simulated time run this same code.
 *
 * Use: od_init() and config_apply() on device.od, then device_init(), device_start(). One thread calls it. Times are
 * CLOCK_MONOTONIC or a simulated clock, in us, and never go back. Each call is an input that record.h records, and so
 * is what the ports answer: nothing else may come in. */
#ifndef GATEWAY_DEVICE_H
#define GATEWAY_DEVICE_H

#include <stdbool.h>
#include <stdint.h>

#include "drivers/ports/can.h"
#include "drivers/ports/imu.h"
#include "gateway/aids.h"
#include "gateway/angle_filter.h"
#include "gateway/bus_health.h"
#include "gateway/led.h"
#include "gateway/utc.h"
#include "gateway/canopen/node.h"
#include "gateway/calibration_command.h"
#include "gateway/lever_arm_command.h"
#include "gateway/event_log.h"
#include "gateway/last_movement.h"
#include "gateway/latency.h"
#include "gateway/lever_arm_um.h"
#include "gateway/procedure_log.h"
#include "gateway/pdo_preset.h"
#include "gateway/record.h"
#include "gateway/sensor_watch.h"
#include "gateway/snapshot.h"
#include "gateway/status.h"
#include "gateway/storing.h"
#include "gateway/write_lock.h"
#include "model/pipeline.h"
#include "od_values.h"

struct device {
	struct od od;
	struct od_values values;
	struct latency latency; /* measures once it has a clock */

	/* PRIVATE */
	struct storing storing;
	struct pipeline pipeline;
	struct command_group commands;
	struct lever_arm_command lever_arm_command;
	struct procedure_log procedure_log;
	struct calibration_command calibration_command;
	struct aids aids;
	struct sensor_watch sensor_watch;
	struct canopen_node canopen;
	struct bus_health bus_health;
	struct leds leds;
	struct utc utc;
	struct can_port *bus;
	struct imu_port *imu;
	struct od_hook configuration_hook, command_hook, resolution_hook, preset_hook;
	struct od_domain eds;
	uint8_t eds_text[IMU9_EDS_SIZE]; /* the EDS with the configured vendor-ID */
	struct event_log log;
	struct snapshot snapshot;
	struct last_movement last_movement;
	struct angle_filter angle_filter;
	struct pdo_preset pdo_preset;
	struct lever_arm_um lever_arm_um;
	struct write_lock write_lock;
	struct record *record; /* NULL: none */
	struct od_hook record_hook;
	uint64_t last_sample_us; /* arrival of the last sample; before the first one, the start */
	uint64_t refused_t_us;	 /* time stamp of the last sample that the pipeline refused */
	uint32_t samples;	 /* delivered since the start */
	bool configuration_changed, sensor_lost, sensor_testing, position_unsure;
	unsigned uncalibrated;	 /* PIPELINE_UNCALIBRATED_... as last told */
	uint32_t implausible;	 /* as of the last sample */
	uint64_t implausible_us; /* when it last grew; 0: EMCY 5032h is over */
	uint64_t now_us;	 /* of the present call */
};

/** device.values are the configuration of file and command line. `storage`: NULL when nothing can be stored. `stored`:
 * what store_read() gave, or NULL. 0; -EINVAL: the configuration of file and command line is inconsistent (for example
 * a singular calibration matrix), or node_id is neither 1..127 nor 255; else the result of canopen_init(). */
int device_init(struct device *d, struct can_port *bus, struct imu_port *imu, const struct storing_port *storage,
	const struct store_image *stored, uint8_t node_id);
/** Sends the boot-up message. `stored_damaged`: store_read() found a damaged file; EMCY 5530h reports it. */
void device_start(struct device *d, bool stored_damaged, uint64_t now_us);

/** The result of imu_read(): 1 and the sample, or a negative errno (the sensor has failed or the log has ended). */
void device_sample(struct device *d, int read, const struct imu_sample *sample, uint64_t now_us);
void device_receive(struct device *d, const struct can_msg *msg, uint64_t now_us);
/** A write to the dictionary that did not come by the bus, as an SDO download of the whole value. OD_PENDING: the value
 * is being stored; device_saved() ends it. */
enum od_status device_write(
	struct device *d, uint16_t index, uint8_t sub, const void *wire, size_t size, uint64_t now_us);
/** UTC of the host's clock less the clock of `now_us`, and whether an NTP or PTP daemon synchronises it. Once a second.
 * */
void device_host_clock(struct device *d, bool synchronised, int64_t offset_us);
/** The save in progress has ended, `result` as of store_write(). */
void device_saved(struct device *d, int result, uint64_t now_us);
/** The process was not scheduled for up to `us` (stopped, or the machine overloaded): the sensor's timeout does not
 * count this time. */
void device_away(struct device *d, uint64_t us, uint64_t now_us);
/** Time-driven work. Returns the next deadline: when to call again at the latest. */
uint64_t device_tick(struct device *d, uint64_t now_us);

#endif
