/* model/sim/sensor.h
 * What a real IMU makes of a motion: three triads (gyro, accelerometer, magnetometer), each with its errors. Per triad,
 * in this order: lever arm and gravity (accelerometer) -> bandwidth -> scale factor and cross-axis -> bias, bias
 * instability, random walk, white noise -> quantisation -> saturation.
 *
 * Densities are one-sided, as datasheets give them: noise of the density n, seen through the bandwidth B, has the
 * standard deviation n sqrt(B); sampled at f it has n sqrt(f / 2), and an Allan deviation of n / sqrt(2 tau). */
#ifndef MODEL_SIM_SENSOR_H
#define MODEL_SIM_SENSOR_H

#include "model/sim/rng.h"
#include "model/sample.h"
#include "model/sim/signal.h"

enum { SENSOR_FLICKER_POLES = 5 };

/* Errors of one triad; "unit" is rad/s, m/s^2 or uT. 0: without that error. */
struct triad_errors {
	double density;		 /* white noise, unit/sqrt(Hz) */
	double bias_instability; /* flicker noise, unit: the Allan deviation's floor is 0.664 of it */
	double random_walk;	 /* of the rate: unit/sqrt(s) */
	/* constant errors differ from device to device: 1-sigma, drawn once from the seed */
	double bias_sigma;	  /* unit, at 25 degC */
	double temperature_sigma; /* of the bias: unit/K */
	double scale_sigma, cross_axis_sigma;
	double bandwidth_hz; /* -3 dB of a first-order low-pass */
	double step;	     /* quantisation: unit per digit */
	double range;	     /* saturates at +- range */
};

struct sensor_config {
	const char *name, *about;
	struct triad_errors gyro, accel, mag;
	double rate_hz;		   /* sampling rate */
	double mag_rate_hz;	   /* new magnetometer values a second; 0: one with each sample */
	double jitter_s;	   /* 1-sigma of the instant of sampling; the time stamp does not show it */
	struct vec3 lever_arm_b_m; /* reference point -> accelerometer */
	double gravity_m_s2;
	struct vec3 field_n_uT; /* Earth's magnetic field */
	/* Warms up from 25 degC by warming_K with the time constant warming_s; 0 K: at 25 degC, and samples without a
	 * temperature. Shown in whole digits of temperature_step_K. */
	double warming_K, warming_s, temperature_step_K;
};

/** Chips as in their datasheets, and `ideal`; ends with a NULL name. Rate 100 Hz, no lever arm. */
extern const struct sensor_config SENSOR_PRESETS[];

/** NULL where there is none of that name. */
const struct sensor_config *sensor_preset(const char *name);

/** Takes away what a calibration would: bias, scale factor and cross-axis errors. */
void sensor_calibrate(struct sensor_config *config);

struct triad {
	struct triad_errors errors;
	struct vec3 bias;    /* as drawn: the known answer of a calibration */
	struct vec3 slope;   /* of the bias: unit/K */
	double matrix[3][3]; /* measured = matrix * true + bias */
	struct rng rng;
	double white_sigma, walk_sigma;
	double flicker_decay[SENSOR_FLICKER_POLES], flicker_drive[SENSOR_FLICKER_POLES];
	double flicker[3][SENSOR_FLICKER_POLES];
	double walk[3];
	double lag_decay, lag_new, lag_old; /* low-pass, its input taken as a straight line between samples */
	struct vec3 lag_in, lag_out;
};

struct sensor {
	struct sensor_config config;
	struct triad gyro, accel, mag;
	struct rng jitter;
	uint64_t taken; /* samples so far */
};

/** 0, or -EINVAL: rate not above 0, jitter not below a tenth of the interval, an error below 0, or a warming
 * without a time constant. */
int sensor_init(struct sensor *sensor, const struct sensor_config *config, uint64_t seed);

/** The instant of the next sample, to evaluate the motion at. Once a sample. Not before 0. */
double sensor_instant_s(struct sensor *sensor);

/** The next sample, from the motion at sensor_instant_s(). */
void sensor_measure(struct sensor *sensor, const struct signal_truth *truth, struct imu_sample *sample);

/** Both: the next sample of a sensor on that motion. `truth` (may be NULL) shows the motion at its instant. */
void sensor_next(
	struct sensor *sensor, const struct signal *signal, struct imu_sample *sample, struct signal_truth *truth);

/** What an ideal accelerometer at the lever arm r shows (exact rigid body):
 * R^T (a_n + g) + alpha x r + omega x (omega x r). */
struct vec3 sensor_specific_force(const struct signal_truth *truth, struct vec3 lever_arm_b_m, double gravity_m_s2);

#endif
