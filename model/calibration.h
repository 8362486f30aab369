/* model/calibration.h
 * From the sensor's raw axes to the object frame: bias, scale factors and cross-axis terms of each
 * triad, then the mounting rotation, the same for all three. corrected = R_mount * M * (raw -
 * bias(T)), bias(T) = bias + slope * (T - T0) + quadratic * (T - T0)^2 for gyro and accelerometer. */
#ifndef MODEL_CALIBRATION_H
#define MODEL_CALIBRATION_H

#include "model/math/rotation.h"
#include "model/sample.h"

struct triad_calibration {
	struct vec3 bias;    /* unit of the triad: rad/s, m/s^2 or uT */
	double matrix[3][3]; /* dimensionless, row-major; identity for an ideal sensor */
};

/* Change of the biases with temperature; all 0: none. Per K and K^2, units of the triad. */
struct temperature_compensation {
	struct vec3 gyro_slope, gyro_quadratic, accel_slope, accel_quadratic;
	double reference_degC; /* T0: the biases of the triads are those at this temperature */
};

struct calibration_config {
	struct triad_calibration gyro, accel, mag;
	struct temperature_compensation temperature;
	struct vec3 mounting_rad; /* roll, pitch, yaw (z-y'-x'') that turn sensor axes into the
				     object frame */
};

struct calibration {
	struct calibration_config config;
	struct mat3 gyro, accel, mag; /* R_mount * M, worked out once */
	/* PRIVATE */
	struct vec3 gyro_bias, accel_bias; /* at the temperature last known */
	double temperature_degC;
	bool temperature_known;
};

/** 0, or -EINVAL: a value not finite, or a matrix singular (|det| < 1e-3). */
int calibration_init(struct calibration *cal, const struct calibration_config *config);
/** The same while it runs: the temperature last known stays. */
int calibration_configure(struct calibration *cal, const struct calibration_config *config);
/** The temperature from now on. Before the first one nothing is compensated; one beyond +-200 degC is not believed. */
void calibration_temperature(struct calibration *cal, double temperature_degC);
/** The sample with its three triads corrected and in the object frame; time and flags as they were. */
struct imu_sample calibration_apply(const struct calibration *cal, const struct imu_sample *raw);
/** How far the biases at that temperature are from those of the triads. */
struct vec3 calibration_gyro_shift(const struct temperature_compensation *c, double temperature_degC);
struct vec3 calibration_accel_shift(const struct temperature_compensation *c, double temperature_degC);

#endif
