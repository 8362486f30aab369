#include "tools/experiments/methods.h"

#include <math.h>

#include "model/angle_fusion.h"
#include "model/auto_correction.h"
#include "model/estimator.h"
#include "model/pipeline.h"

const char *const METHOD_NAMES[METHODS] = {"none", "seed", "seed_lowpass", "seed_gyro", "rigid_gyro", "auto"};

static struct vec3 given_angles(const struct trial *trial, int k, double angle_sigma_rad)
{
	return vec3_add(trial->motion[k].angles_rad, vec3_scale(angle_sigma_rad, trial->angle_noise[k]));
}

/* From angles only: (8) or (12), solved for the acceleration. */
static void from_angles(enum method method, const struct trial *trial, double angle_sigma_rad, struct vec3 *estimate)
{
	const struct trial_config *c = &trial->config;
	const struct vec3 r = method == METHOD_NONE ? (struct vec3){0, 0, 0} : c->lever_arm_b_m;
	struct seed_motion *motion = trial->scratch;

	for (int k = 0; k < trial->count; k++)
		estimate[k] = given_angles(trial, k, angle_sigma_rad);
	if (method == METHOD_SEED_LOWPASS)
		seed_fir(estimate, trial->count, c->rate_hz);
	for (int k = 0; k < trial->count; k++)
		motion[k].angles_rad = estimate[k];
	seed_differentiate(motion, trial->count, trial->dt_s);
	for (int k = 0; k < trial->count; k++)
		estimate[k] = seed_estimate(trial->force_b_m_s2[k], &motion[k], r, c->gravity_m_s2);
}

/* Motion from the gyro and the given angles. */
struct fused {
	struct angle_fusion angles;
	struct rates rates;
	struct noise_config noise;
	struct rates_variance variance; /* of the rates */
};

static void fused_init(struct fused *f, const struct trial *trial, double angle_sigma_rad)
{
	const struct filter_config *filter = &PIPELINE_DEFAULTS.rate_filter;

	*f = (struct fused){.noise = {
				    .angle_sigma_rad = angle_sigma_rad,
				    .gyro_density_rad_s_sqrt_hz = trial->sensor.gyro.density,
				    .gyro_bias_instability_rad_s = trial->sensor.gyro.bias_instability,
			    }};
	angle_fusion_init(&f->angles, &f->noise);
	rates_init(&f->rates, filter, trial->config.rate_hz);
	f->variance = rates_variance(&f->noise, RATES_FROM_GYRO, filter, trial->config.rate_hz);
}

static void fused_step(struct fused *f, const struct trial *trial, int k)
{
	struct quat given = quat_from_seed_angles(given_angles(trial, k, f->noise.angle_sigma_rad));
	struct vec3 gyro;

	angle_fusion_step(&f->angles, trial->gyro_b_rad_s[k], given, trial->dt_s);
	gyro = vec3_sub(trial->gyro_b_rad_s[k], f->angles.gyro_bias_b_rad_s);
	if (k == 0)
		rates_prime(&f->rates, gyro, f->angles.q_nb);
	else
		rates_step(&f->rates, gyro, f->angles.q_nb, trial->dt_s);
}

/* The physical world: what the gateway computes. */
static void with_gyro(enum method method, const struct trial *trial, double angle_sigma_rad, struct vec3 *estimate)
{
	const struct vec3 r = trial->config.lever_arm_b_m;
	const struct estimator_config estimator = {
		.lever_arm_b_m = r,
		.model = method == METHOD_SEED_GYRO    ? LEVER_ARM_SEED_EQ12
			 : method == METHOD_RIGID_GYRO ? LEVER_ARM_RIGID_BODY
			 : method == METHOD_AUTO       ? LEVER_ARM_AUTO
						       : LEVER_ARM_OFF,
		.rates_from = RATES_FROM_GYRO,
		.gravity_m_s2 = trial->config.gravity_m_s2,
	};
	struct auto_correction automatic = {{0}};
	struct fused f;

	fused_init(&f, trial, angle_sigma_rad);
	for (int k = 0; k < trial->count; k++) {
		const struct body_rates *rates = &f.rates.out[RATES_FROM_GYRO];

		fused_step(&f, trial, k);
		struct vec3 lever_arm = estimator_lever_arm_b(&estimator, f.angles.q_nb, rates);
		if (method == METHOD_AUTO)
			lever_arm = auto_correction_step(&automatic, lever_arm,
				rigid_lever_arm_variance(rates->omega_b_rad_s, r, f.variance), trial->dt_s);
		estimate[k] = estimator_accel_b(&estimator, trial->force_b_m_s2[k], f.angles.q_nb, lever_arm);
	}
}

/* World of the paper: (12) with the rates of the gyro, differentiated as in that world. */
static void seed_with_gyro(enum method method, const struct trial *trial, double angle_sigma_rad, struct vec3 *estimate)
{
	const struct trial_config *c = &trial->config;
	const struct vec3 zero = {0, 0, 0};
	struct auto_correction automatic = {{0}};
	struct vec3 before = zero;
	struct rates_variance variance;
	struct fused f;

	fused_init(&f, trial, angle_sigma_rad);
	variance.omega = trial->sensor.gyro.density * trial->sensor.gyro.density * c->rate_hz / 2;
	variance.alpha = 2 * variance.omega * c->rate_hz * c->rate_hz;
	for (int k = 0; k < trial->count; k++) {
		struct rigid_motion rigid = {QUAT_IDENTITY, zero, zero};
		struct seed_motion motion;
		struct vec3 correction;

		fused_step(&f, trial, k);
		rigid.q_nb = f.angles.q_nb;
		rigid.omega_b_rad_s = vec3_sub(trial->gyro_b_rad_s[k], f.angles.gyro_bias_b_rad_s);
		motion = seed_motion_from_rigid(&rigid);
		motion.accels_rad_s2 = k ? vec3_scale(c->rate_hz, vec3_sub(motion.rates_rad_s, before)) : zero;
		before = motion.rates_rad_s;
		correction = seed_lever_arm(&motion, c->lever_arm_b_m);
		if (method == METHOD_AUTO)
			correction = auto_correction_step(&automatic, correction,
				seed_lever_arm_variance(&motion, c->lever_arm_b_m, variance), trial->dt_s);
		estimate[k] =
			vec3_sub(seed_estimate(trial->force_b_m_s2[k], &motion, zero, c->gravity_m_s2), correction);
	}
}

void method_run(enum method method, const struct trial *trial, double angle_sigma_rad, struct vec3 *estimate)
{
	if (method == METHOD_NONE || method == METHOD_SEED || method == METHOD_SEED_LOWPASS)
		from_angles(method, trial, angle_sigma_rad, estimate);
	else if (trial->config.world == WORLD_SEED && method != METHOD_RIGID_GYRO)
		seed_with_gyro(method, trial, angle_sigma_rad, estimate);
	else
		with_gyro(method, trial, angle_sigma_rad, estimate);
}

struct score method_score(const struct trial *trial, const struct vec3 *estimate)
{
	struct score score = {0, 0};

	for (int k = 0; k < trial->count; k++) {
		double error = vec3_norm(vec3_sub(estimate[k], trial->accel_b_m_s2[k]));

		score.rms_m_s2 += error * error / trial->count;
		score.peak_m_s2 = fmax(score.peak_m_s2, error);
	}
	score.rms_m_s2 = sqrt(score.rms_m_s2);
	return score;
}
