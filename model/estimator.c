#include "model/estimator.h"

#include <errno.h>

#include "model/seed.h"

int estimator_check(const struct estimator_config *config)
{
	const struct vec3 r = config->lever_arm_b_m;

	if (!(fabs(r.x) <= 10 && fabs(r.y) <= 10 && fabs(r.z) <= 10))
		return -EINVAL;
	if (config->model < LEVER_ARM_OFF || config->model > LEVER_ARM_AUTO)
		return -EINVAL;
	if (config->rates_from != RATES_FROM_GYRO && config->rates_from != RATES_FROM_ANGLES)
		return -EINVAL;
	return config->gravity_m_s2 >= 9.0 && config->gravity_m_s2 <= 10.5 ? 0 : -EINVAL;
}

struct vec3 estimator_lever_arm_b(
	const struct estimator_config *config, struct quat q_nb, const struct body_rates *rates)
{
	const struct rigid_motion rigid = {q_nb, rates->omega_b_rad_s, rates->alpha_b_rad_s2};
	struct seed_motion seed;

	switch (config->model) {
	case LEVER_ARM_OFF:
		break;
	case LEVER_ARM_SEED_EQ12:
		seed = seed_motion_from_rigid(&rigid);
		return seed_lever_arm(&seed, config->lever_arm_b_m);
	case LEVER_ARM_RIGID_BODY:
	case LEVER_ARM_AUTO:
		return rigid_lever_arm(rates->omega_b_rad_s, rates->alpha_b_rad_s2, config->lever_arm_b_m);
	}
	return (struct vec3){0, 0, 0};
}

struct vec3 estimator_accel_b(
	const struct estimator_config *config, struct vec3 force_b_m_s2, struct quat q_nb, struct vec3 lever_arm_b_m_s2)
{
	struct vec3 gravity_b = quat_rotate_inverse(q_nb, (struct vec3){0, 0, config->gravity_m_s2});

	return vec3_sub(vec3_sub(force_b_m_s2, gravity_b), lever_arm_b_m_s2);
}
