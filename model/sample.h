/* model/sample.h
 * One sample of the IMU as a driver delivers it: SI units (micro-tesla for the magnetometer), the sensor's own axes,
 * right-handed, not calibrated. */
#ifndef MODEL_SAMPLE_H
#define MODEL_SAMPLE_H

#include <stdint.h>

#include "model/math/vec3.h"

enum {
	SAMPLE_MAG = 1 << 0,	       /* mag_uT holds a new measurement */
	SAMPLE_DISCONTINUITY = 1 << 1, /* the motion jumped (a replay in a loop started again): start over */
	SAMPLE_TEMPERATURE = 1 << 2,   /* temperature_degC holds a new measurement */
	SAMPLE_REFERENCE = 1 << 3,     /* ref_accel_b_m_s2 is known */
	SAMPLE_SATURATED = 1 << 4,     /* a value is at the end of its sensor's range */
};

struct imu_sample {
	uint64_t t_us; /* time of measurement; any epoch, strictly increasing */
	struct vec3 gyro_rad_s;
	struct vec3 accel_m_s2;	 /* specific force: +g on the axis that points up at rest */
	struct vec3 mag_uT;	 /* only with SAMPLE_MAG */
	double temperature_degC; /* of the gyro's chip; only with SAMPLE_TEMPERATURE */
	/* acceleration of the reference point without gravity, object frame, as measured by another device (a robot's
	 * encoders); only with SAMPLE_REFERENCE */
	struct vec3 ref_accel_b_m_s2;
	unsigned flags;
};

#endif
