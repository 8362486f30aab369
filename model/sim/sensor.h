/* model/sim/sensor.h
 * Error model of an IMU: three triads (gyro, accelerometer, magnetometer), each with its errors. The order in each
 * triad: lever arm and gravity (accelerometer) -> bandwidth -> scale factor and cross-axis -> bias, bias instability,
 * random walk, white noise -> quantisation -> saturation.
 *
 * Densities are one-sided, as in datasheets: noise of density n has the standard deviation n sqrt(B) in the bandwidth
 * B, n sqrt(f / 2) when sampled at f, and an Allan deviation of n / sqrt(2 tau). */
#ifndef MODEL_SIM_SENSOR_H
#define MODEL_SIM_SENSOR_H

#include "model/sim/rng.h"
#include "model/sample.h"
#include "model/sim/signal.h"

enum { SENSOR_FLICKER_POLES = 5 };

/* Errors of one triad. "unit" is rad/s, m/s^2 or uT. All are 0 or more; 0 (default): without that error. */
struct triad_errors {
	double density;		 /* white noise, one-sided, unit/sqrt(Hz) */
	double bias_instability; /* flicker noise B, unit: the floor of the Allan deviation is 0.664 B */
	double random_walk;	 /* of the bias, unit/sqrt(s): the Allan deviation rises as K sqrt(tau / 3) */
	/* Constant errors, 1 sigma over devices. They are drawn once, from the seed. */
	double bias_sigma;	  /* unit, at 25 degC */
	double temperature_sigma; /* of the change of the bias, unit/K */
	double scale_sigma;	  /* of each scale factor, as a share of 1 */
	double cross_axis_sigma;  /* of each off-diagonal element of the matrix */
	double bandwidth_hz;	  /* -3 dB of a first-order low-pass; smaller: more delay */
	double step;		  /* quantisation, unit per digit */
	double range;		  /* saturation at +-range, unit */
};

struct sensor_config {
	const char *name, *about;
	struct triad_errors gyro, accel, mag;
	double rate_hz;	    /* sampling rate, above 0; presets 100 */
	double mag_rate_hz; /* rate of new magnetometer values; presets 75, `ideal` 0: one with each sample */
	double jitter_s;    /* 1 sigma of the sampling instant, at most 0.1 / rate_hz; not in the time stamp; 0 */
	struct vec3 lever_arm_b_m; /* reference point -> accelerometer; 0 */
	double gravity_m_s2;	   /* 9.81 */
	struct vec3 field_n_uT;	   /* Earth's magnetic field, ENU; (0, 20, -45): central Europe */
	/* The sensor warms up from 25 degC by warming_K, with the time constant warming_s. 0 K (default): it stays at
	 * 25 degC, and samples have no temperature. */
	double warming_K, warming_s; /* presets 0 and 120 */
	double temperature_step_K;   /* digit of the temperature; presets 1 */
};

/** Chips with the errors of their datasheets, and `ideal`, without errors. Ends with a NULL name. */
extern const struct sensor_config SENSOR_PRESETS[];

/** NULL when there is no preset of that name. */
const struct sensor_config *sensor_preset(const char *name);

/** Removes the errors that a calibration removes: bias, its temperature dependence, scale factor and cross-axis
 * errors. */
void sensor_calibrate(struct sensor_config *config);

struct triad {
	struct triad_errors errors;
	struct vec3 bias;    /* as drawn: the true value for a test of a calibration */
	struct vec3 slope;   /* of the bias, unit/K */
	double matrix[3][3]; /* measured = matrix * true + bias */
	struct rng rng;
	double white_sigma, walk_sigma;
	double flicker_decay[SENSOR_FLICKER_POLES], flicker_drive[SENSOR_FLICKER_POLES];
	double flicker[3][SENSOR_FLICKER_POLES];
	double walk[3];
	double lag_decay, lag_new, lag_old; /* low-pass of an input that is linear between samples */
	struct vec3 lag_in, lag_out;
};

struct sensor {
	struct sensor_config config;
	struct triad gyro, accel, mag;
	struct rng jitter;
	uint64_t count; /* samples so far */
};

/** 0, or -EINVAL: a field is out of its range, or warming_K without a time constant. One seed is one device with one
 * noise sequence. */
int sensor_init(struct sensor *sensor, const struct sensor_config *config, uint64_t seed);

/** Instant of the next sample, at which to evaluate the motion; 0 or later. Call it once for each sample. */
double sensor_instant_s(struct sensor *sensor);

/** Next sample, from the motion at sensor_instant_s(). */
void sensor_measure(struct sensor *sensor, const struct signal_truth *truth, struct imu_sample *sample);

/** Next sample of a sensor on that motion. `truth` (or NULL) receives the motion at its instant. */
void sensor_next(
	struct sensor *sensor, const struct signal *signal, struct imu_sample *sample, struct signal_truth *truth);

/** Specific force of a rigid body at the lever arm r: R^T (a_n + g) + alpha x r + omega x (omega x r). */
struct vec3 sensor_specific_force(const struct signal_truth *truth, struct vec3 lever_arm_b_m, double gravity_m_s2);

#endif
