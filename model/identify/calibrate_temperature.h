/* model/identify/calibrate_temperature.h
 * How the biases of gyro and accelerometer follow the temperature, from rests during which it moves:
 * bias(T) = bias + slope (T - T0) + quadratic (T - T0)^2, least squares over quarters of a second. Each rest has an offset
 * of its own: the sensor may be laid down otherwise in between, for the accelerometer sees gravity. Hence no bias comes
 * out of it, only how it changes. */
#ifndef MODEL_IDENTIFY_CALIBRATE_TEMPERATURE_H
#define MODEL_IDENTIFY_CALIBRATE_TEMPERATURE_H

#include "model/identify/calibrate.h"
#include "model/calibration.h"

struct calibrate_temperature_result {
	struct temperature_compensation compensation; /* reference: the mean temperature of the rests */
	double lowest_degC, highest_degC;
	struct vec3 gyro_residual_rad_s, accel_residual_m_s2; /* RMS of a quarter of a second */
	struct vec3 gyro_slope_sigma, accel_slope_sigma;      /* 1 sigma of the noise between quarters of a second */
	struct vec3 gyro_rad_s; /* mean over all rests at the reference: the gyro's bias there */
	double rest_s;
	bool quadratic; /* it explains enough more than a straight line */
};

struct calibrate_temperature {
	struct calibrate_temperature_result result; /* with CALIBRATE_GOOD */
	enum calibrate_verdict verdict;
	/* PRIVATE */
	struct calibrate_rest rest;
	struct calibrate_temperature_sums {
		double n, z[2], zz[3], y[6], zy[2][6],
			yy[6]; /* z: t and t^2, t from the first block; y: gyro, accelerometer */
	} now, all;	       /* of this rest; of all rests, their means taken away */
	double gyro_sum[3], z_sum[2], n;
	double first_degC, lowest_degC, highest_degC;
	double origin[6];
	unsigned rests, blocks;
	bool started;
};

void calibrate_temperature_init(struct calibrate_temperature *c);
void calibrate_temperature_step(struct calibrate_temperature *c, const struct imu_sample *raw);
/** No more samples. */
enum calibrate_verdict calibrate_temperature_finish(struct calibrate_temperature *c);

#endif
