/* model/estimator.h
 * Linear acceleration of the reference point: the specific force at the accelerometer less gravity and less the lever
 * arm's share. It has no state: a new lever arm, model or source of rates is in full effect with the next sample. */
#ifndef MODEL_ESTIMATOR_H
#define MODEL_ESTIMATOR_H

#include "model/math/quat.h"
#include "model/rates.h"

enum lever_arm_model {
	LEVER_ARM_OFF = 0,
	LEVER_ARM_SEED_EQ12 = 1,  /* equation (12) of the paper, as printed */
	LEVER_ARM_RIGID_BODY = 2, /* alpha x r + omega x (omega x r) */
	LEVER_ARM_AUTO = 3,	  /* the same, as far as it exceeds its own noise (auto_correction.h) */
};

struct estimator_config {
	/** m, +-10 each, default 0: reference point -> accelerometer, object frame. An error of it is a share of the
	 * same size of the correction: at 10 rad/s 1 mm is 0.1 m/s^2. */
	struct vec3 lever_arm_b_m;
	enum lever_arm_model model;  /* default LEVER_ARM_RIGID_BODY */
	enum rate_source rates_from; /* default RATES_FROM_GYRO; from angles they are noisier and half a sample late */
	/** m/s^2, 9.0..10.5, default 9.81: local gravity. An error of it is one of the vertical acceleration. */
	double gravity_m_s2;
};

/** 0, or -EINVAL: a field out of its range. */
int estimator_check(const struct estimator_config *config);

/** The lever arm's share of the specific force, object frame; for LEVER_ARM_AUTO without regard to its noise. Bounded
 * for bounded input, near the gimbal lock of the paper's angles, too (see seed.h). */
struct vec3 estimator_lever_arm_b(
	const struct estimator_config *config, struct quat q_nb, const struct body_rates *rates);

/** The reference point's acceleration in the object frame, from the specific force at the accelerometer and the lever
 * arm's share of it. */
struct vec3 estimator_accel_b(const struct estimator_config *config, struct vec3 force_b_m_s2, struct quat q_nb,
	struct vec3 lever_arm_b_m_s2);

#endif
