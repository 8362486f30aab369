/* model/identify/calibrate_gyro.h
 * The gyro's bias: its mean over a rest. A rest that turns slowly and steadily is no rest, and the gyro alone cannot tell:
 * gravity and, about the vertical, the magnetic field must stay in the sensor's axes (0.03 deg/s, 0.1 deg/s). */
#ifndef MODEL_IDENTIFY_CALIBRATE_GYRO_H
#define MODEL_IDENTIFY_CALIBRATE_GYRO_H

#include "model/identify/calibrate.h"

struct calibrate_gyro_config {
	double rest_s;		       /* a rest that long is enough; INFINITY: the longest until _finish() */
	double patience_s;	       /* without one in that time: refused */
	double bias_instability_rad_s; /* of the sensor (2020h): what no averaging takes away */
};

extern const struct calibrate_gyro_config CALIBRATE_GYRO_DEFAULTS; /* 10 s, 60 s, 0.01 deg/s */

struct calibrate_gyro_result {
	struct vec3 bias_rad_s, sigma_rad_s; /* 1 sigma: noise and bias instability */
	double rest_s;
	double temperature_degC; /* NAN: not known */
};

struct calibrate_gyro {
	struct calibrate_gyro_config config;
	struct calibrate_gyro_result result; /* with CALIBRATE_GOOD */
	enum calibrate_verdict verdict;
	/* PRIVATE */
	struct calibrate_rest rest;
	struct calibrate_gyro_sums {
		unsigned blocks, temperature_blocks;
		struct vec3 first, gyro, gyro_squares; /* deviations from the first block's */
		double temperature_degC;
		struct calibrate_gyro_line {
			double n, t, tt, vv;
			struct vec3 first, v, tv; /* deviations from the first value */
		} accel, mag;
	} now, best;
};

void calibrate_gyro_init(struct calibrate_gyro *c, const struct calibrate_gyro_config *config);
enum calibrate_verdict calibrate_gyro_step(struct calibrate_gyro *c, const struct imu_sample *raw);
/** No more samples: the longest rest, if it lasted 5 s. */
enum calibrate_verdict calibrate_gyro_finish(struct calibrate_gyro *c);
/** 0..1. */
double calibrate_gyro_progress(const struct calibrate_gyro *c);

#endif
