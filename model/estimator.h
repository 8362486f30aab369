/* model/estimator.h
 * Linear acceleration of the reference point: what the accelerometer saw, less gravity, less the
 * lever arm's share. It has no memory: a new lever arm, model or source of rates counts fully from
 * the next sample on. */
#ifndef MODEL_ESTIMATOR_H
#define MODEL_ESTIMATOR_H

#include "model/math/quat.h"
#include "model/rates.h"

enum lever_arm_model {
	LEVER_ARM_OFF = 0,
	LEVER_ARM_SEED_EQ12 = 1,  /* as the seed printed it */
	LEVER_ARM_RIGID_BODY = 2, /* alpha x r + omega x (omega x r) */
	LEVER_ARM_AUTO = 3,	  /* the same, as far as it exceeds its own noise (auto_correction.h) */
};

struct estimator_config {
	struct vec3 lever_arm_b_m; /* reference point -> accelerometer, object frame; +-10 each */
	enum lever_arm_model model;
	enum rate_source rates_from;
	double gravity_m_s2; /* 9.0..10.5 */
};

/** 0, or -EINVAL: a field out of its range. */
int estimator_check(const struct estimator_config *config);

/** The lever arm's share of the specific force, object frame; for LEVER_ARM_AUTO all of it. Bounded for bounded input:
 * near the gimbal lock of the seed's angles their rates are, too (see seed.h). */
struct vec3 estimator_lever_arm_b(
	const struct estimator_config *config, struct quat q_nb, const struct body_rates *rates);

/** The reference point's acceleration in the object frame, from the specific force at the accelerometer and the lever
 * arm's share of it. */
struct vec3 estimator_accel_b(const struct estimator_config *config, struct vec3 force_b_m_s2, struct quat q_nb,
	struct vec3 lever_arm_b_m_s2);

#endif
