/* gateway/calibration_command.h
 * Calibration by command (2061h): raw samples go into one of model/identify/calibrate_*.h, progress and result appear
 * in the object. "Accept" writes the result to 2050h, 2051h or 2052h: it takes effect with the next sample, and 1010h
 * stores it. Units of bias and matrix as in these objects (rad/s, m/s^2, uT), sensor frame. One thread. */
#ifndef GATEWAY_CALIBRATION_COMMAND_H
#define GATEWAY_CALIBRATION_COMMAND_H

#include "gateway/command_object.h"
#include "model/identify/calibrate_accelerometer.h"
#include "model/identify/calibrate_gyro.h"
#include "model/identify/calibrate_magnetometer.h"
#include "od/od.h"
#include "od_values.h"

/** 2061h:1 */
enum {
	CALIBRATION_GYRO = 1,
	CALIBRATION_SIX_FACES = 2,
	CALIBRATION_FREE = 3,
	CALIBRATION_MAGNETOMETER = 4,
	CALIBRATION_ACCEPT = 10,
	CALIBRATION_DISCARD = 11,
};

/** 2061h:12 when no sample had a temperature, degC. */
#define CALIBRATION_NO_TEMPERATURE (-300)

struct calibration_command { /* PRIVATE */
	struct od *od;
	struct od_values *values;
	struct command_object command;
	union {
		struct calibrate_gyro gyro;
		struct calibrate_accelerometer accelerometer;
		struct calibrate_magnetometer magnetometer;
	};
};

/** Attaches to the dictionary. */
void calibration_command_init(
	struct calibration_command *c, struct command_group *group, struct od *od, struct od_values *values);
/** NMT reset: what runs is aborted, and there is no result. */
void calibration_command_reset(struct calibration_command *c);
/** A raw sample, as the driver delivered it. */
void calibration_command_sample(struct calibration_command *c, const struct imu_sample *raw);

#endif
