#include "model/angle_fusion.h"

#include <errno.h>
#include <math.h>

/* s, in which the bias walks by its instability, and its 1 sigma at the start in instabilities. By judgement: where the
 * Allan deviation of MEMS gyros has its flat part; a calibrated gyro after switching on. */
static const double BIAS_TIME_S = 100, START_BIAS_INSTABILITIES = 10;

int angle_fusion_init(struct angle_fusion *f, const struct noise_config *noise)
{
	const double start_bias = START_BIAS_INSTABILITIES * noise->gyro_bias_instability_rad_s;

	if (!(noise->angle_sigma_rad > 0) || !(noise->gyro_density_rad_s_sqrt_hz > 0) ||
		!(noise->gyro_bias_instability_rad_s >= 0))
		return -EINVAL;
	*f = (struct angle_fusion){
		.noise = *noise,
		.q_nb = QUAT_IDENTITY,
		.p_angle = noise->angle_sigma_rad * noise->angle_sigma_rad,
		.p_bias = start_bias * start_bias,
	};
	return 0;
}

static void predict(struct angle_fusion *f, struct vec3 gyro_b_rad_s, double dt_s)
{
	const double n = f->noise.gyro_density_rad_s_sqrt_hz, b = f->noise.gyro_bias_instability_rad_s;
	struct vec3 rate = vec3_sub(gyro_b_rad_s, f->gyro_bias_b_rad_s);

	f->q_nb = quat_normalize(quat_multiply(f->q_nb, quat_from_rotation_vector(vec3_scale(dt_s, rate))));
	f->p_angle += dt_s * (n * n / 2 - 2 * f->p_cross + dt_s * f->p_bias);
	f->p_cross -= dt_s * f->p_bias;
	f->p_bias += dt_s * b * b / BIAS_TIME_S;
}

static void correct(struct angle_fusion *f, struct quat given_q_nb)
{
	struct quat error = quat_multiply(quat_conjugate(f->q_nb), given_q_nb);
	/* the rotation vector of a small error */
	struct vec3 innovation = vec3_scale(error.w < 0 ? -2 : 2, (struct vec3){error.x, error.y, error.z});
	double sigma = f->noise.angle_sigma_rad, innovation_variance = f->p_angle + sigma * sigma;
	double k_angle = f->p_angle / innovation_variance, k_bias = f->p_cross / innovation_variance;

	f->q_nb = quat_multiply(f->q_nb, quat_from_rotation_vector(vec3_scale(k_angle, innovation)));
	f->gyro_bias_b_rad_s = vec3_add(f->gyro_bias_b_rad_s, vec3_scale(k_bias, innovation));
	f->p_bias -= k_bias * f->p_cross;
	f->p_cross -= k_angle * f->p_cross;
	f->p_angle -= k_angle * f->p_angle;
}

void angle_fusion_step(struct angle_fusion *f, struct vec3 gyro_b_rad_s, struct quat given_q_nb, double dt_s)
{
	if (!f->started) {
		f->q_nb = given_q_nb;
		f->started = true;
		return;
	}
	predict(f, gyro_b_rad_s, dt_s);
	correct(f, given_q_nb);
}
