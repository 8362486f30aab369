/* model/calibration.h
 * From the sensor's raw axes to the object frame: bias, scale factors and cross-axis terms of each
 * triad, then the mounting rotation, the same for all three. corrected = R_mount * M * (raw -
 * bias). */
#ifndef MODEL_CALIBRATION_H
#define MODEL_CALIBRATION_H

#include "model/rotation.h"
#include "model/sample.h"

struct triad_calibration {
	struct vec3 bias;    /* unit of the triad: rad/s, m/s^2 or uT */
	double matrix[3][3]; /* dimensionless, row-major; identity for an ideal sensor */
};

struct calibration_config {
	struct triad_calibration gyro, accel, mag;
	struct vec3 mounting_rad; /* roll, pitch, yaw (z-y'-x'') that turn sensor axes into the
				     object frame */
};

struct calibration {
	struct calibration_config config;
	struct mat3 gyro, accel, mag; /* R_mount * M, worked out once */
};

/** 0, or -EINVAL: a value not finite, or a matrix singular (|det| < 1e-3). */
int calibration_init(struct calibration *cal, const struct calibration_config *config);
/** The sample with its three triads corrected and in the object frame; time and flags as they were.
 */
struct imu_sample calibration_apply(const struct calibration *cal, const struct imu_sample *raw);

#endif
