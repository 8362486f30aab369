/* tools/plot/series.h
 * What imu9-plot draws: rows of values over time, from a log (through the pipeline of the gateway), from the output of
 * imu9-replay, or from imu9-monitor --csv. */
#ifndef TOOLS_PLOT_SERIES_H
#define TOOLS_PLOT_SERIES_H

#include <stdbool.h>
#include <stddef.h>

#include "gateway/config.h"

enum series_quantity {
	SERIES_ANGLES,	     /* roll, pitch, yaw, deg */
	SERIES_ANGLES_SIGMA, /* roll and pitch: of the less certain horizontal axis; deg */
	SERIES_ACCELERATION, /* of the reference point, l, s, t, m/s^2 */
	SERIES_UNCORRECTED,  /* of the sensor, without gravity: no lever arm correction */
	SERIES_POSITION,     /* x, y, z, m */
	SERIES_POSITION_SIGMA,
	SERIES_FORCE, /* specific force, l, s, t, m/s^2 */
	SERIES_RATE,  /* of the gyro, deg/s */
	SERIES_QUANTITIES
};

struct series_row {
	double t_s;
	double value[SERIES_QUANTITIES][3]; /* NAN: none */
	bool rest;
};

struct series {
	struct series_row *rows;
	size_t count;
	bool has[SERIES_QUANTITIES]; /* in some row */
	bool rests;		     /* a log, at rest from begin to end: 99 of 100 rows, without the first 3 s */
	double rate_hz;		     /* by the median interval */
};

/** Reads a file; what it is says its header. A failure ends the program. `config`: for a log. */
void series_load(struct series *series, const char *path, const struct config *config);
/** Whether the row follows the one before without a gap. */
bool series_follows(const struct series *series, size_t row);

#endif
