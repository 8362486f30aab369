/* gateway/calibrating.h
 * Calibration by command (2061h): raw samples go into one of model/identify/calibrate_*.h, progress and result appear in the
 * object, and "accept" writes the result to 2050h, 2051h or 2052h, from where it takes effect with the next sample and
 * 1010h keeps it. One runs at a time, and not beside the identification of the lever arm (2060h). */
#ifndef GATEWAY_CALIBRATING_H
#define GATEWAY_CALIBRATING_H

#include "model/identify/calibrate_accelerometer.h"
#include "model/identify/calibrate_gyro.h"
#include "model/identify/calibrate_magnetometer.h"
#include "od/od.h"
#include "od_values.h"

enum calibrating_state { CALIBRATING_IDLE, CALIBRATING_RUNNING, CALIBRATING_DONE, CALIBRATING_REFUSED }; /* 2061h:2 */

/** 2061h:1 */
enum {
	CALIBRATING_ABORT = 0,
	CALIBRATING_GYRO = 1,
	CALIBRATING_SIX_FACES = 2,
	CALIBRATING_FREE = 3,
	CALIBRATING_MAGNETOMETER = 4,
	CALIBRATING_ACCEPT = 10,
	CALIBRATING_DISCARD = 11,
};

/** 2061h:12 where no sample had a temperature. */
#define CALIBRATING_NO_TEMPERATURE (-300)

struct calibrating { /* PRIVATE */
	struct od *od;
	struct od_values *values;
	struct od_hook hook;
	bool sensor_lost;
	union {
		struct calibrate_gyro gyro;
		struct calibrate_accelerometer accelerometer;
		struct calibrate_magnetometer magnetometer;
	};
};

/** Attaches to the dictionary. */
void calibrating_init(struct calibrating *c, struct od *od, struct od_values *values);
/** NMT reset: what runs ends, and nothing was found. */
void calibrating_reset(struct calibrating *c);
/** A raw sample, as the driver delivered it. */
void calibrating_sample(struct calibrating *c, const struct imu_sample *raw);
/** The sensor has failed: what runs is refused, and so is a start until the next sample. */
void calibrating_sensor_lost(struct calibrating *c);
/** STATUS_COMMISSIONING, or 0. */
unsigned calibrating_status(const struct calibrating *c);

#endif
