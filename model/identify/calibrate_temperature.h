/* model/identify/calibrate_temperature.h
 * Temperature dependence of the biases of gyro and accelerometer, from rests during which the temperature changes:
 * bias(T) = bias + slope (T - T0) + quadratic (T - T0)^2, by least squares over blocks of CALIBRATE_BLOCK_S. Each rest
 * has its own constant offset, because the accelerometer measures gravity and the sensor can be put down differently
 * each time. Hence the accelerometer's bias itself is not observable, only its change. */
#ifndef MODEL_IDENTIFY_CALIBRATE_TEMPERATURE_H
#define MODEL_IDENTIFY_CALIBRATE_TEMPERATURE_H

#include "model/identify/calibrate.h"
#include "model/calibration.h"

struct calibrate_temperature_result {
	struct temperature_compensation compensation; /* reference: the mean temperature of the rests */
	double lowest_degC, highest_degC;
	struct vec3 gyro_residual_rad_s, accel_residual_m_s2; /* RMS of the blocks */
	struct vec3 gyro_slope_sigma, accel_slope_sigma;      /* 1 sigma per K, from the residual */
	struct vec3 gyro_rad_s;				      /* bias of the gyro at the reference temperature */
	double rest_s;					      /* total length of the rests with a temperature */
	bool quadratic;					      /* a parabola was fitted, not a straight line */
};

struct calibrate_temperature {
	struct calibrate_temperature_result result; /* with CALIBRATE_GOOD */
	enum calibrate_verdict verdict;
	/* PRIVATE */
	struct calibrate_rest rest;
	struct calibrate_temperature_sums {
		/* sums over blocks; z: t and t^2, with t the temperature from first_degC; y: gyro, accelerometer */
		double n, z[2], zz[3], y[6], zy[2][6], yy[6];
	} now, all; /* the current rest; all rests, about the means of each */
	double gyro_sum[3], z_sum[2], n;
	double first_degC, lowest_degC, highest_degC;
	double origin[6];
	unsigned rests, blocks;
	bool started;
};

void calibrate_temperature_init(struct calibrate_temperature *c);
void calibrate_temperature_step(struct calibrate_temperature *c, const struct imu_sample *raw);
/** Call after the last sample of a log. */
enum calibrate_verdict calibrate_temperature_finish(struct calibrate_temperature *c);

#endif
