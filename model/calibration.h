/* model/calibration.h
 * From the sensor's raw axes to the object frame: bias, scale factors and cross-axis terms of each triad, then the
 * mounting rotation, the same for all three:
 *   corrected = R_mount M (raw - bias(T)),
 *   bias(T) = bias + slope (T - T0) + quadratic (T - T0)^2 for gyro and accelerometer. */
#ifndef MODEL_CALIBRATION_H
#define MODEL_CALIBRATION_H

#include "model/math/rotation.h"
#include "model/sample.h"

/** As imu9-calibrate determines it. */
struct triad_calibration {
	/** Unit of the triad (rad/s, m/s^2 or uT), default 0: what it measures where the true value is 0. */
	struct vec3 bias;
	/** Dimensionless, row-major, |determinant| >= 1e-3, default identity: the diagonal elements correct the scale
	 * (larger: a larger output), the others what one axis measures of another. */
	double matrix[3][3];
};

/** Change of the biases with temperature; all 0 (default): none. Per K and K^2, in units of the triad. */
struct temperature_compensation {
	struct vec3 gyro_slope, gyro_quadratic, accel_slope, accel_quadratic;
	double reference_degC; /* T0, 25 in the object: temperature at which the biases of the triads hold */
};

struct calibration_config {
	struct triad_calibration gyro, accel, mag;
	struct temperature_compensation temperature;
	/** Default 0: roll, pitch, yaw (z-y'-x'') that turn sensor axes into the object frame. */
	struct vec3 mounting_rad;
};

struct calibration {
	struct calibration_config config;
	struct mat3 gyro, accel, mag; /* R_mount M */
	/* PRIVATE */
	struct vec3 gyro_bias, accel_bias; /* at the last temperature */
	double temperature_degC;
	bool temperature_known;
};

/** 0, or -EINVAL: a value not finite, or a matrix singular (|det| < 1e-3). */
int calibration_init(struct calibration *cal, const struct calibration_config *config);
/** The same while it runs: the last temperature stays. */
int calibration_configure(struct calibration *cal, const struct calibration_config *config);
/** The temperature from now on. Before the first one nothing is compensated. One beyond +-200 degC is ignored:
 * false. */
bool calibration_temperature(struct calibration *cal, double temperature_degC);
/** The sample with its three triads corrected and in the object frame. Time and flags stay. */
struct imu_sample calibration_apply(const struct calibration *cal, const struct imu_sample *raw);
/** Biases at that temperature less those of the triads. */
struct vec3 calibration_gyro_shift(const struct temperature_compensation *c, double temperature_degC);
struct vec3 calibration_accel_shift(const struct temperature_compensation *c, double temperature_degC);

/** The change of the biases with temperature was calibrated: some coefficient is not 0. */
static inline bool calibration_compensates_gyro(const struct temperature_compensation *c)
{
	return vec3_norm(c->gyro_slope) + vec3_norm(c->gyro_quadratic) > 0;
}

static inline bool calibration_compensates_accel(const struct temperature_compensation *c)
{
	return vec3_norm(c->accel_slope) + vec3_norm(c->accel_quadratic) > 0;
}

#endif
