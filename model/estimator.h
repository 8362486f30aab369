/* model/estimator.h — H1 completes */
#ifndef MODEL_ESTIMATOR_H
#define MODEL_ESTIMATOR_H

#include "model/quat.h"

enum lever_arm_model { LEVER_ARM_OFF = 0, LEVER_ARM_SEED_EQ12 = 1, LEVER_ARM_RIGID_BODY = 2 };
enum rate_source { RATES_FROM_GYRO = 0, RATES_FROM_ANGLES = 1 };

struct estimator_config {
	struct vec3 lever_arm_b_m;  /* reference point -> accelerometer, object frame */
	enum lever_arm_model model;
	enum rate_source rates_from;
	double gravity_m_s2;
};
#endif
