/* tools/calibrate/calibrate_sensor.h
 * imu9-calibrate gyro, accelerometer, magnetometer, temperature: from a log, or without one in a gateway on the bus. */
#ifndef TOOLS_CALIBRATE_CALIBRATE_SENSOR_H
#define TOOLS_CALIBRATE_CALIBRATE_SENSOR_H

#include <stdbool.h>
#include <stdint.h>

#include "gateway/config.h"
#include "model/calibration.h"
#include "model/pipeline.h"

struct calibrate_request {
	const char *what;   /* "gyro", .. */
	const char *log;    /* NULL: on the bus */
	const char *output; /* INI file; NULL: standard output */
	bool six, yes;
	double field_uT; /* 0: not given */
	struct config config;
	struct pipeline_config settings; /* from config; only with a log */
	const char *bus;
	uint8_t node;
	unsigned timeout_ms;
	struct procedure_lead *lead; /* on the bus; or NULL */
};

/** argv[0] is the name of the subcommand. Returns an exit code of cli.h. */
int calibrate_sensor(int argc, char **argv);

/** With a log, and on the bus. */
int calibrate_from_log(const struct calibrate_request *request);
int calibrate_live(const struct calibrate_request *request);

#endif
