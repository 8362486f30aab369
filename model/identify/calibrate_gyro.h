/* model/identify/calibrate_gyro.h
 * Bias of the gyro: its mean during a rest. A slow, steady rotation looks like a bias to the gyro, so gravity and, for
 * rotations about the vertical, the magnetic field must keep their direction in sensor axes (within 0.03 and 0.1
 * deg/s). */
#ifndef MODEL_IDENTIFY_CALIBRATE_GYRO_H
#define MODEL_IDENTIFY_CALIBRATE_GYRO_H

#include "model/identify/calibrate.h"

struct calibrate_gyro_config {
	/* Rest that is needed, 5 or more, default 10; INFINITY: the longest rest until _finish() (a log). Smaller: more
	 * noise in the bias, a quarter of 10 s doubles it; larger: the user waits, and bias instability limits the
	 * gain. */
	double rest_s;
	/* Time after which a calibration without such a rest is refused, default 60; INFINITY: never. */
	double patience_s;
	/* Bias instability of the sensor, 0 or more, default 0.01 deg/s (2020h). Larger: larger sigma; the bias is the
	 * same. */
	double bias_instability_rad_s;
};

extern const struct calibrate_gyro_config CALIBRATE_GYRO_DEFAULTS;

struct calibrate_gyro_result {
	struct vec3 bias_rad_s, sigma_rad_s; /* sigma: 1 sigma, from noise and bias instability */
	double rest_s;			     /* length of the rest */
	double temperature_degC;	     /* mean during the rest; NAN: not known */
};

struct calibrate_gyro {
	struct calibrate_gyro_config config;
	struct calibrate_gyro_result result; /* with CALIBRATE_GOOD */
	enum calibrate_verdict verdict;
	/* PRIVATE */
	struct calibrate_rest rest;
	struct calibrate_gyro_sums {
		unsigned blocks, temperature_blocks;
		struct vec3 first, gyro, gyro_squares; /* sums of the deviations from the first block */
		double temperature_degC;
		struct calibrate_gyro_line {
			double n, t, tt, vv;
			struct vec3 first, v, tv; /* sums of the deviations from the first value */
		} accel, mag;
	} now, longest;
};

void calibrate_gyro_init(struct calibrate_gyro *c, const struct calibrate_gyro_config *config);
enum calibrate_verdict calibrate_gyro_step(struct calibrate_gyro *c, const struct imu_sample *raw);
/** Call after the last sample of a log: evaluates the longest rest, which must have lasted 5 s. */
enum calibrate_verdict calibrate_gyro_finish(struct calibrate_gyro *c);
/** 0..1, the current rest as a share of the rest needed. */
double calibrate_gyro_progress(const struct calibrate_gyro *c);

#endif
