#include "model/pipeline.h"

#include <errno.h>
#include <string.h>

#include "model/smoother.h"
#include "model/math/units.h"

#define IDENTITY_TRIAD                                        \
	{                                                     \
		.matrix = { {1, 0, 0}, {0, 1, 0}, {0, 0, 1} } \
	}

const struct pipeline_config PIPELINE_DEFAULTS = {
	.calibration = {.gyro = IDENTITY_TRIAD, .accel = IDENTITY_TRIAD, .mag = IDENTITY_TRIAD},
	.accel_filter = {.type = FILTER_OFF, .order = 2, .cutoff_hz = 40},
	.rate_filter = {.type = FILTER_BUTTERWORTH, .order = 2, .cutoff_hz = 40},
	.fusion =
		{
			.algorithm = FUSION_KALMAN,
			.use_magnetometer = 1,
			.madgwick_beta = 0.041,
			.mahony_kp_rad_s = 0.3,
			.mahony_ki_rad_s2 = 0.0012,
			.kalman = FUSION_KALMAN_DEFAULTS,
		},
	.latency = {.sensor_s = 0.0042, .accelerometer_s = -0.0016},
	.noise =
		{
			.angle_sigma_rad = 0.05 * RAD_PER_DEG,
			.gyro_density_rad_s_sqrt_hz = 0.03 * RAD_PER_DEG,
			.gyro_bias_instability_rad_s = 0.01 * RAD_PER_DEG,
			.accel_density_m_s2_sqrt_hz = 220e-6 * STANDARD_GRAVITY_M_S2,
			.accel_bias_instability_m_s2 = 0.1e-3 * STANDARD_GRAVITY_M_S2,
			.gyro_bias_per_K_rad_s = 0.03 * RAD_PER_DEG,
			.accel_bias_per_K_m_s2 = 0.5e-3 * STANDARD_GRAVITY_M_S2,
			.mag_sigma_uT = 0.5,
		},
	.estimator =
		{
			.model = LEVER_ARM_RIGID_BODY,
			.rates_from = RATES_FROM_GYRO,
			.gravity_m_s2 = 9.81,
		},
	.rest = REST_DEFAULTS,
	.position =
		{
			.mode = POSITION_NAVIGATION,
			.longest_integration_s = 60,
			.navigation = {.standstill = STANDSTILL_DEFAULTS},
		},
};

/* Limits of plausible samples, far beyond any sensor's range. */
static const double RATE_MAX_RAD_S = 1e3, FORCE_MAX_M_S2 = 1e5, FIELD_MAX_UT = 1e6;
/* What is beyond this times the largest measured value is no output: corrections and filters overshoot by less. The
 * rate has the largest bias in addition. By judgement. */
static const double GUARD = 3, GUARD_RATE_RAD_S = 0.5;
/* m/s^2: a smaller centripetal share, 11 degrees of tilt, is left in the first attitude. s, and sampling intervals,
 * after which the derivative of the rates has settled. By judgement. */
static const double START_SHARE_M_S2 = 2, START_WAIT_S = 0.05, START_WAIT_INTERVALS = 5;
/* m/s^2, by which the first force may differ from gravity; beyond that the mean over s is the first attitude. By
 * judgement: what a hand or a lever arm adds, and some periods of a vibration. */
static const double START_OFF_M_S2 = 5, START_MEAN_S = 0.5;
/* m/s^2: a smaller force shows no vertical. */
static const double FALLS_M_S2 = 0.5;
/* rad, 1 sigma of the tilt beyond which it is not valid. By judgement: an angle of three sigma is upside down. */
static const double TILT_UNKNOWN_RAD = PI / 6;
/* Hz, bandwidth of the derivative by which the acceleration is extrapolated over its latency. By judgement: four times
 * that of quick hand movements (15 Hz), so that its own phase error does not matter. */
static const double CHANGE_CUTOFF_HZ = 60;
/* Samples of the impulse response of that derivative. By judgement: at 60 Hz it has decayed at any rate below 10
 * kHz. */
enum { IMPULSE_SAMPLES = 1024 };
/* Ranges of the aids, see pipeline.h. */
static const double AID_MAX_M_S = 1e3, AID_SIGMA_MIN_M_S = 1e-3, AID_SIGMA_MIN_RAD = 1e-4, ATTITUDE_NORM_OFF = 0.1;
/* s. After a longer gap only the heading of the attitude is kept. By judgement: within a second a robot may turn
 * over. */
static const double ATTITUDE_HOLD_S = 1;
/* Share of the biases' change with temperature that a calibration of that leaves. By judgement: what is measured on one
 * day over part of the range. */
static const double COMPENSATED = 0.2;
/* The smallest jumps of rate and force that may be glitches, and by how much more in slow samples. By judgement: above
 * what a low-pass of 40 Hz leaves of motions that begin; smaller ones turn by 0.3 degrees at 100 Hz. */
static const double GLITCH_RAD_S = 0.2, GLITCH_RAD_S2 = 50, GLITCH_M_S2 = 3, GLITCH_M_S3 = 500;
/* s. A magnetometer slower than the samples still counts as used between its measurements. By judgement. */
static const double MAG_LATELY_S = 1;

/* The filter whose attitude is published (f = NULL), then, when that is another one, the Kalman filter, then NULL. */
static struct fusion *next_filter(struct pipeline *p, const struct fusion *f)
{
	if (!f)
		return &p->fusion;
	return f == &p->fusion && p->config.fusion.algorithm != FUSION_KALMAN ? &p->reference : NULL;
}

/* The filter that knows its own uncertainty. */
static const struct fusion *kalman(const struct pipeline *p)
{
	return p->config.fusion.algorithm == FUSION_KALMAN ? &p->fusion : &p->reference;
}

/* The rotation from its attitude to the published one, n. */
static struct vec3 apart_n_rad(const struct pipeline *p)
{
	if (kalman(p) == &p->fusion)
		return (struct vec3){0, 0, 0};
	return quat_to_rotation_vector(quat_multiply(p->fusion.q_nb, quat_conjugate(kalman(p)->q_nb)));
}

/* Variance of the derivative behind white noise of variance 1. */
static void update_change_noise(struct pipeline *p)
{
	struct differentiator3 d = p->accel_change;
	const struct vec3 none = {0, 0, 0};

	differentiator3_prime(&d, none);
	p->change_of_white = 0;
	for (int k = 0; k < IMPULSE_SAMPLES; k++)
		p->change_of_white += pow(differentiator3_step(&d, (struct vec3){k == 0, 0, 0}, 1 / p->rate_hz).x, 2);
}

static void update_rates_noise(struct pipeline *p)
{
	p->rates_variance =
		rates_variance(&p->config.noise, p->config.estimator.rates_from, &p->config.rate_filter, p->rate_hz);
}

/* An accelerometer's sample is not measured after its time stamp, also when sensor_s alone was set to 0. */
static double accel_age_s(const struct latency_config *latency)
{
	return fmax(latency->sensor_s + latency->accelerometer_s, 0);
}

static int latency_check(const struct latency_config *latency)
{
	bool known = latency->sensor_s >= 0 && latency->sensor_s <= 0.1 && fabs(latency->accelerometer_s) <= 0.05;

	return known ? 0 : -EINVAL;
}

/* The fusion uses the estimator's lever arm and the gyro's latency. */
static struct fusion_config fusion_config(
	const struct pipeline_config *config, enum fusion_algorithm algorithm, double rate_hz)
{
	struct fusion_config fusion = config->fusion;

	fusion.algorithm = algorithm;
	fusion.interval_s = 1 / rate_hz;
	fusion.lever_arm_b_m = config->estimator.lever_arm_b_m;
	fusion.delay_s = config->latency.sensor_s;
	fusion.kalman.field_sigma_uT = config->noise.mag_sigma_uT;
	if (config->uncalibrated & PIPELINE_UNCALIBRATED_GYRO) {
		fusion.kalman.bias_sigma_rad_s = UNCALIBRATED_GYRO_RAD_S;
		fusion.kalman.gyro_scale_sigma = fmax(fusion.kalman.gyro_scale_sigma, UNCALIBRATED_GYRO_SCALE);
	}
	if (config->uncalibrated & PIPELINE_UNCALIBRATED_ACCEL)
		fusion.kalman.accel_sigma_m_s2 = UNCALIBRATED_ACCEL_M_S2;
	if (config->uncalibrated & PIPELINE_UNCALIBRATED_MAG)
		fusion.kalman.offset_sigma_uT = UNCALIBRATED_MAG_UT;
	return fusion;
}

/* The user's limits of rest; those of a foot are wider. */
static struct rest_config standstill_config(const struct pipeline_config *config)
{
	struct rest_config usual = config->position.navigation.standstill, stance = STANCE_DEFAULTS;
	bool foot = config->position.navigation.preset == MOTION_FOOT;
	struct rest_config c = foot ? stance : usual;

	c.gyro_threshold_rad_s = fmax(foot ? stance.gyro_threshold_rad_s : 0, config->rest.gyro_threshold_rad_s);
	c.accel_threshold_m_s2 = fmax(foot ? stance.accel_threshold_m_s2 : 0, config->rest.accel_threshold_m_s2);
	if (config->stance_s != 0)
		c.time_s = config->stance_s;
	return c;
}

/* The navigation uses the errors of the sensors and the user's limits of rest. */
static struct position_config position_config(const struct pipeline_config *config)
{
	struct position_config position = config->position;

	position.navigation.noise = config->noise;
	if (config->uncalibrated & PIPELINE_UNCALIBRATED_GYRO) {
		position.navigation.gyro_bias_sigma_rad_s = UNCALIBRATED_GYRO_RAD_S;
		position.navigation.gyro_scale_sigma = UNCALIBRATED_GYRO_SCALE;
	}
	if (config->uncalibrated & PIPELINE_UNCALIBRATED_ACCEL) {
		position.navigation.accel_bias_sigma_m_s2 = UNCALIBRATED_ACCEL_M_S2;
		position.navigation.accel_scale_sigma = UNCALIBRATED_ACCEL_SCALE;
	}
	position.navigation.standstill = standstill_config(config);
	position.navigation.rest_s = config->rest.time_s;
	return position;
}

/* All but the noise of the rates, which takes as long as 4096 samples. */
static int prepare(struct pipeline *p, const struct pipeline_config *config, double rate_hz)
{
	struct fusion_config published = fusion_config(config, config->fusion.algorithm, rate_hz);
	struct fusion_config reference = fusion_config(config, FUSION_KALMAN, rate_hz);
	struct position_config position = position_config(config);

	memset(p, 0, sizeof(*p));
	p->config = *config;
	p->rate_hz = rate_hz;
	p->since_mag_s = INFINITY;
	p->last_good.q_nb = QUAT_IDENTITY;
	if (latency_check(&config->latency) < 0 || calibration_init(&p->calibration, &config->calibration) < 0 ||
		filter3_init(&p->accel_filter, &config->accel_filter, rate_hz) < 0 ||
		rates_init(&p->rates, &config->rate_filter, rate_hz) < 0 || fusion_init(&p->fusion, &published) < 0 ||
		fusion_init(&p->reference, &reference) < 0 || estimator_check(&config->estimator) < 0 ||
		rest_check(&config->rest) < 0 || position_init(&p->position, &position) < 0)
		return -EINVAL;
	p->accel_delay_s = filter3_delay_s(&p->accel_filter, rate_hz);
	differentiator3_tune(&p->accel_change, CHANGE_CUTOFF_HZ, rate_hz);
	update_change_noise(p);
	return 0;
}

int pipeline_init(struct pipeline *p, const struct pipeline_config *config, double rate_hz)
{
	struct pipeline fresh;

	if (prepare(&fresh, config, rate_hz) < 0)
		return -EINVAL;
	update_rates_noise(&fresh);
	*p = fresh;
	return 0;
}

static bool same_filter(const struct filter_config *a, const struct filter_config *b)
{
	return a->type == b->type && a->order == b->order && a->cutoff_hz == b->cutoff_hz;
}

static int configure_filters(struct pipeline *p, const struct pipeline_config *config)
{
	if (!same_filter(&p->config.accel_filter, &config->accel_filter)) {
		struct vec3 last = p->accel_filter.out;

		if (filter3_init(&p->accel_filter, &config->accel_filter, p->rate_hz) < 0)
			return -EINVAL;
		filter3_prime(&p->accel_filter, last);
		p->accel_delay_s = filter3_delay_s(&p->accel_filter, p->rate_hz);
	}
	if (!same_filter(&p->config.rate_filter, &config->rate_filter))
		return rates_configure(&p->rates, &config->rate_filter, p->rate_hz);
	return 0;
}

/* A new mounting turns the object frame, not the sensor: the attitude turns with it. The state of the filters belongs
 * to the old calibration, and so do the estimated errors of a gyro that has a new one. */
static int configure_calibration(struct pipeline *p, const struct calibration_config *config)
{
	struct quat old = quat_from_aerospace(p->config.calibration.mounting_rad);
	struct quat new = quat_from_aerospace(config->mounting_rad);

	if (memcmp(&p->config.calibration, config, sizeof(*config)) == 0)
		return 0;
	if (calibration_configure(&p->calibration, config) < 0)
		return -EINVAL;
	for (struct fusion *f = NULL; (f = next_filter(p, f)) != NULL;) {
		fusion_turn_object(f, quat_multiply(new, quat_conjugate(old)));
		if (memcmp(&p->config.calibration.gyro, &config->gyro, sizeof(config->gyro)) != 0)
			fusion_reset_gyro_errors(f);
	}
	p->primed = p->position.navigation.started = false;
	return 0;
}

/* Another filter begins with the Kalman filter's attitude; back to this one the published attitude jumps. */
static int configure_fusion(struct pipeline *p, const struct pipeline_config *config)
{
	struct fusion_config published = fusion_config(config, config->fusion.algorithm, p->rate_hz);
	struct fusion_config reference = fusion_config(config, FUSION_KALMAN, p->rate_hz);
	bool was_kalman = p->config.fusion.algorithm == FUSION_KALMAN, is_kalman = published.algorithm == FUSION_KALMAN;

	if (was_kalman && !is_kalman)
		p->reference = p->fusion;
	if (!was_kalman && is_kalman) {
		p->fusion = p->reference;
		p->primed = false;
	}
	if (fusion_configure(&p->fusion, &published) < 0)
		return -EINVAL;
	return is_kalman ? 0 : fusion_configure(&p->reference, &reference);
}

int pipeline_configure(struct pipeline *p, const struct pipeline_config *config)
{
	struct position_config position = position_config(config);
	struct pipeline next = *p;

	if (latency_check(&config->latency) < 0 || configure_calibration(&next, &config->calibration) < 0 ||
		configure_filters(&next, config) < 0 || configure_fusion(&next, config) < 0 ||
		estimator_check(&config->estimator) < 0 || rest_check(&config->rest) < 0 ||
		position_configure(&next.position, &position) < 0)
		return -EINVAL;
	bool noise_changed = memcmp(&p->config.noise, &config->noise, sizeof(config->noise)) != 0 ||
			     p->config.estimator.rates_from != config->estimator.rates_from ||
			     !same_filter(&p->config.rate_filter, &config->rate_filter);
	next.config = *config;
	if (noise_changed)
		update_rates_noise(&next);
	*p = next;
	return 0;
}

void pipeline_reset_position(struct pipeline *p)
{
	position_reset(&p->position);
}

static bool plausible(struct vec3 v, double max)
{
	return fabs(v.x) <= max && fabs(v.y) <= max && fabs(v.z) <= max; /* false for NaN */
}

int pipeline_aid_velocity(struct pipeline *p, struct vec3 v_n_m_s, double sigma_m_s)
{
	if (!plausible(v_n_m_s, AID_MAX_M_S) || !(sigma_m_s >= AID_SIGMA_MIN_M_S && sigma_m_s <= AID_MAX_M_S))
		return -EINVAL;
	if (!p->started || !fusion_started(&p->fusion))
		return 0;
	for (struct fusion *f = NULL; (f = next_filter(p, f)) != NULL;)
		fusion_aid_velocity(f, v_n_m_s, sigma_m_s, p->last_gyro_b_rad_s);
	position_aid_velocity(&p->position, v_n_m_s, sigma_m_s, p->config.estimator.lever_arm_b_m);
	return 0;
}

int pipeline_aid_yaw(struct pipeline *p, double yaw_rad, double sigma_rad)
{
	if (!(fabs(yaw_rad) <= 2 * PI) || !(sigma_rad >= AID_SIGMA_MIN_RAD && sigma_rad <= PI))
		return -EINVAL;
	for (struct fusion *f = NULL; p->started && (f = next_filter(p, f)) != NULL;)
		if (fusion_aid_yaw(f, yaw_rad, sigma_rad, p->last_gyro_b_rad_s))
			p->primed = false; /* no rate, no acceleration from the jump */
	return 0;
}

int pipeline_reset_attitude(struct pipeline *p, struct quat q_nb)
{
	double norm = sqrt(q_nb.w * q_nb.w + q_nb.x * q_nb.x + q_nb.y * q_nb.y + q_nb.z * q_nb.z);
	struct quat from = kalman(p)->q_nb;

	if (!(fabs(norm - 1) <= ATTITUDE_NORM_OFF))
		return -EINVAL;
	for (struct fusion *f = NULL; (f = next_filter(p, f)) != NULL;)
		fusion_set_attitude(f, q_nb);
	position_set_attitude(&p->position, from, p->fusion.q_nb);
	p->primed = false;
	return 0;
}

void pipeline_smooth(struct pipeline *p, struct smoother *smoother)
{
	smoother_cancel(smoother);
	p->position.navigation.smoother = smoother;
}

static void start_over(struct pipeline *p)
{
	struct pipeline fresh;

	(void)prepare(&fresh, &p->config, p->rate_hz); /* valid, as it was before */
	fresh.rates_variance = p->rates_variance;
	fresh.calibration = p->calibration; /* with the last temperature */
	fresh.warming = p->warming;
	fresh.last_good = p->last_good;
	fresh.gyro_glitch.count = p->gyro_glitch.count;
	fresh.accel_glitch.count = p->accel_glitch.count;
	fresh.vibration.clipped_accel = p->vibration.clipped_accel;
	fresh.vibration.clipped_gyro = p->vibration.clipped_gyro;
	fresh.gaps = p->gaps;
	fresh.refused = p->refused;
	fresh.implausible = p->implausible;
	pipeline_smooth(&fresh, p->position.navigation.smoother);
	*p = fresh;
}

static bool usable(const struct pipeline *p, const struct imu_sample *s)
{
	if (!plausible(s->gyro_rad_s, RATE_MAX_RAD_S) || !plausible(s->accel_m_s2, FORCE_MAX_M_S2))
		return false;
	if ((s->flags & SAMPLE_MAG) && !plausible(s->mag_uT, FIELD_MAX_UT))
		return false;
	return !p->started || (s->flags & SAMPLE_DISCONTINUITY) || s->t_us > p->last_t_us;
}

/* The mean force of the samples so far, in the present axes. */
static void follow_start_force(struct pipeline *p, const struct imu_sample *s, double dt_s)
{
	struct vec3 before =
		quat_rotate_inverse(quat_from_rotation_vector(vec3_scale(dt_s, s->gyro_rad_s)), p->start_force_b_m_s2);
	bool falls = vec3_norm(s->accel_m_s2) < FALLS_M_S2;

	p->starting_s = p->primed ? p->starting_s + dt_s : 0;
	p->start_samples = p->primed && !falls ? p->start_samples + 1 : !falls;
	p->start_force_b_m_s2 =
		vec3_add(before, vec3_scale(1 / fmax(1, p->start_samples), vec3_sub(s->accel_m_s2, before)));
}

/* The first attitude takes what the accelerometer shows for up. When a known lever arm's share is large, it is taken
 * off before, and when the force is far from gravity, it is averaged. False: the angular acceleration, or the mean,
 * which that needs, is not known yet. */
static bool ready_to_start(struct pipeline *p, struct imu_sample *s, double dt_s)
{
	const struct body_rates *rates = &p->rates.out[RATES_FROM_GYRO];
	struct vec3 arm = p->config.estimator.lever_arm_b_m;

	follow_start_force(p, s, dt_s);
	if (vec3_dot(s->gyro_rad_s, s->gyro_rad_s) * vec3_norm(arm) < START_SHARE_M_S2) {
		double off = vec3_norm(s->accel_m_s2) - p->config.estimator.gravity_m_s2;

		if (p->start_samples == 0)
			return false;
		if (p->start_samples == 1 && fabs(off) < START_OFF_M_S2)
			return true;
		s->accel_m_s2 = p->start_force_b_m_s2;
		return p->starting_s >= START_MEAN_S;
	}
	if (p->starting_s < fmax(START_WAIT_S, START_WAIT_INTERVALS / p->rate_hz))
		return false;
	s->accel_m_s2 = vec3_sub(s->accel_m_s2, rigid_lever_arm(s->gyro_rad_s, rates->alpha_b_rad_s2, arm));
	return true;
}

/* A constant rate is a bias for Madgwick's and Mahony's filters if it is small; the Kalman filter tells it from a turn
 * itself. */
static bool bias_shows(const struct pipeline *p, const struct fusion *f, bool rest)
{
	return rest && (f == kalman(p) || vec3_norm(p->rest.gyro_mean) < p->config.rest.gyro_threshold_rad_s);
}

static void step_filter(
	struct pipeline *p, struct fusion *f, const struct imu_sample *s, bool starts, bool rest, double dt_s)
{
	f->force_noise_m2_s4 = p->vibration.force_noise_m2_s4;
	f->force_error_m_s2 = p->vibration.force_error_m_s2;
	f->steady_s = p->rest.still_s;
	if (bias_shows(p, f, rest))
		fusion_update_bias_at_rest(f, s->gyro_rad_s, dt_s);
	if (fusion_started(f) || starts)
		fusion_step(f, s, dt_s);
}

/* Attitude, and at rest the gyro's bias. Returns rest. When the attitude starts, or jumps to north because that is now
 * known, all that is filtered or differentiated starts again. */
static bool fuse(struct pipeline *p, const struct imu_sample *s, const struct imu_sample *clean, double dt_s)
{
	bool north_known = fusion_north_known(kalman(p)), jumps = !fusion_north_known(&p->fusion), starts, rest;
	struct imu_sample used = *clean; /* its flag says that the gyro is saturated */

	if (!p->primed) {
		rest_restart(&p->rest);
		vibration_skip(&p->vibration);
	}
	vibration_step(&p->vibration, s->accel_m_s2, s->gyro_rad_s, s->flags & SAMPLE_SATURATED, dt_s);
	if (!p->vibration.gyro_clipped)
		used.flags &= ~(unsigned)SAMPLE_SATURATED;
	rest = rest_step(&p->rest, &p->config.rest, clean->gyro_rad_s, clean->accel_m_s2, dt_s) &&
	       !navigation_accelerates(&p->position.navigation);
	if (s->flags & SAMPLE_MAG)
		p->mag_b_uT = s->mag_uT;
	for (struct fusion *f = NULL; !p->primed && dt_s > ATTITUDE_HOLD_S && (f = next_filter(p, f)) != NULL;)
		fusion_restart(f, dt_s);
	starts = !fusion_started(&p->fusion) && ready_to_start(p, &used, dt_s);
	for (struct fusion *f = NULL; (f = next_filter(p, f)) != NULL;)
		step_filter(p, f, &used, starts, rest, dt_s);
	p->north_found = fusion_north_known(kalman(p)) && !north_known;
	jumps &= fusion_north_known(&p->fusion);
	if (starts || jumps) /* until now there was no global frame, or another one */
		p->primed = false;
	p->since_mag_s = fusion_mag_used(&p->fusion) ? 0 : p->since_mag_s + dt_s;
	return rest && kalman(p)->kalman.resting;
}

/* The lever arm's share of the specific force, in auto mode as far as it exceeds its noise. */
static struct vec3 lever_arm_share(struct pipeline *p, double dt_s)
{
	const struct estimator_config *estimator = &p->config.estimator;
	const struct body_rates *rates = &p->rates.out[estimator->rates_from];
	struct vec3 all = estimator_lever_arm_b(estimator, p->fusion.q_nb, rates), variance;

	if (estimator->model != LEVER_ARM_AUTO)
		return all;
	variance = rigid_lever_arm_variance(rates->omega_b_rad_s, estimator->lever_arm_b_m, p->rates_variance);
	return auto_correction_step(&p->auto_correction, all, variance, dt_s);
}

static struct vec3 accel_n(const struct pipeline *p, const struct estimator_config *estimator, struct vec3 force_b_m_s2,
	struct vec3 lever_arm_b_m_s2)
{
	struct quat q_nb = p->fusion.q_nb;

	return quat_rotate(q_nb, estimator_accel_b(estimator, force_b_m_s2, q_nb, lever_arm_b_m_s2));
}

/* The acceleration of this sample by the estimator of the one before. */
static struct vec3 accel_n_as_before(const struct pipeline *p, struct vec3 force_b_m_s2)
{
	const struct estimator_config *before = &p->last_estimator;
	struct vec3 all = estimator_lever_arm_b(before, p->fusion.q_nb, &p->rates.out[before->rates_from]);

	return accel_n(p, before, force_b_m_s2, all);
}

/* What is integrated, see glitch.h. */
static struct imu_sample without_glitches(struct pipeline *p, const struct imu_sample *s, double dt_s)
{
	struct imu_sample clean = *s;

	if (!p->primed) {
		glitch_restart(&p->gyro_glitch);
		glitch_restart(&p->accel_glitch);
	}
	clean.gyro_rad_s = glitch_step(&p->gyro_glitch, s->gyro_rad_s, fmax(GLITCH_RAD_S, GLITCH_RAD_S2 * dt_s), dt_s);
	clean.accel_m_s2 = glitch_step(&p->accel_glitch, s->accel_m_s2, fmax(GLITCH_M_S2, GLITCH_M_S3 * dt_s), dt_s);
	return clean;
}

/* The accelerometer measured at another instant than the gyro: its force in the object's axes at the gyro's instant. */
static struct vec3 at_the_gyros_instant(const struct pipeline *p, const struct imu_sample *s)
{
	const struct latency_config *latency = &p->config.latency;
	double sooner_s = fmin(-latency->accelerometer_s, latency->sensor_s);
	struct vec3 rate = fusion_rate_b(&p->fusion, s->gyro_rad_s);

	return quat_rotate(quat_from_rotation_vector(vec3_scale(sooner_s, rate)), s->accel_m_s2);
}

static double accel_variance(const struct pipeline *p)
{
	return p->config.noise.accel_density_m_s2_sqrt_hz * p->config.noise.accel_density_m_s2_sqrt_hz * p->rate_hz / 2;
}

/* Variance of the lever arm's share, mean of the axes. */
static double lever_variance(const struct pipeline *p, struct vec3 omega_b_rad_s)
{
	const struct estimator_config *estimator = &p->config.estimator;
	struct vec3 v = rigid_lever_arm_variance(omega_b_rad_s, estimator->lever_arm_b_m, p->rates_variance);

	return estimator->model == LEVER_ARM_OFF ? 0 : (v.x + v.y + v.z) / 3;
}

static double change_variance(const struct pipeline *p)
{
	double age = accel_age_s(&p->config.latency);

	return age * age * accel_variance(p) * p->change_of_white;
}

/* The change of the sensor's specific force over its latency, by its derivative. The lever arm's share of it is not
 * extrapolated: that would take the derivative of the angular acceleration. */
static struct vec3 change_n(struct pipeline *p, struct vec3 force_b_m_s2, double dt_s)
{
	struct vec3 force_n = quat_rotate(p->fusion.q_nb, force_b_m_s2), change;
	double v = change_variance(p);

	if (!p->primed)
		differentiator3_prime(&p->accel_change, force_n);
	change = vec3_scale(accel_age_s(&p->config.latency), differentiator3_step(&p->accel_change, force_n, dt_s));
	return auto_correction_step(&p->auto_change, change, (struct vec3){v, v, v}, dt_s);
}

/* The reference point's acceleration, extrapolated to the time stamp and low-passed in the global frame: gravity is
 * removed before the filter, or the object could turn away from it within the filter's delay. When the estimator has
 * changed, the filter continues as if the new one had always been in use. */
static struct vec3 estimate(struct pipeline *p, struct vec3 force_b_m_s2, double dt_s)
{
	struct vec3 accel = accel_n(p, &p->config.estimator, force_b_m_s2, lever_arm_share(p, dt_s));

	if (!fusion_started(&p->fusion))
		return (struct vec3){0, 0, 0};
	if (p->primed && memcmp(&p->last_estimator, &p->config.estimator, sizeof(p->last_estimator)) != 0)
		filter3_shift(&p->accel_filter, vec3_sub(accel, accel_n_as_before(p, force_b_m_s2)));
	accel = vec3_add(accel, change_n(p, force_b_m_s2, dt_s));
	if (!p->primed)
		filter3_prime(&p->accel_filter, accel);
	p->last_estimator = p->config.estimator;
	return filter3_step(&p->accel_filter, accel);
}

static struct vec3 fusion_variance(const struct pipeline *p)
{
	const struct fusion_kalman *k = &kalman(p)->kalman;

	return (struct vec3){
		k->covariance[0][0], k->covariance[1][1], fusion_kalman_heading_variance(k, &p->config.fusion.kalman)};
}

static struct vec3 fusion_bias_variance(const struct pipeline *p)
{
	const struct fusion_kalman *k = &kalman(p)->kalman;
	int i = KALMAN_BIAS;

	return (struct vec3){k->covariance[i][i], k->covariance[i + 1][i + 1], k->covariance[i + 2][i + 2]};
}

/* Velocity and position of the reference point. */
static void locate(
	struct pipeline *p, const struct imu_sample *s, struct vec3 accel_n_m_s2, bool rest, bool gap, double dt_s)
{
	const struct navigation_input in = {
		.gyro_b_rad_s = s->gyro_rad_s,
		.force_b_m_s2 = s->accel_m_s2,
		.q_nb = kalman(p)->q_nb,
		.gyro_bias_b_rad_s = kalman(p)->gyro_errors.bias_b_rad_s,
		.gyro_bias_variance_rad2_s2 = fusion_bias_variance(p),
		.attitude_variance_rad2 = fusion_variance(p),
		.velocity2_m2_s2 = kalman(p)->kalman.velocity2_m2_s2,
		.unseen_turn_rad = kalman(p)->unseen_turn_rad,
		.north_found = p->north_found,
		.force_variance_m2_s4 = p->vibration.force_error_m_s2 * p->vibration.force_error_m_s2,
		.steps_variance_m2_s4 = quantisation_variance(&p->accel_steps),
		.gravity_m_s2 = p->config.estimator.gravity_m_s2,
	};

	if (gap)
		position_skip(&p->position, &in, accel_n_m_s2, p->rate_hz, dt_s);
	else if (p->config.position.mode != POSITION_NAVIGATION)
		position_step(&p->position, accel_n_m_s2, rest, dt_s);
	else if (fusion_started(&p->fusion))
		position_navigate(&p->position, &in, p->config.estimator.lever_arm_b_m, p->rate_hz, dt_s);
}

static unsigned status_of(const struct pipeline *p, bool rest, bool missing)
{
	struct vec3 variance = fusion_variance(p), off = apart_n_rad(p);
	double tilt_rad = sqrt(fmax(variance.x, variance.y) + off.x * off.x + off.y * off.y);
	bool known = fusion_started(&p->fusion) && tilt_rad < TILT_UNKNOWN_RAD;
	bool vibrates = p->vibration.lately || fusion_force_doubted(kalman(p)) ||
			navigation_may_be_alias(&p->position.navigation);

	return (known ? PIPELINE_VALID : 0u) | (rest ? PIPELINE_REST : 0u) |
	       (p->since_mag_s < MAG_LATELY_S ? PIPELINE_MAG_USED : 0u) |
	       (position_limited(&p->position) ? PIPELINE_TIME_LIMIT : 0u) | (missing ? PIPELINE_GAP : 0u) |
	       (position_unsure(&p->position) ? PIPELINE_UNSURE : 0u) |
	       (navigation_assumes_standstill(&p->position.navigation) ? PIPELINE_ASSUMED : 0u) |
	       (fusion_field_disagrees(kalman(p)) ? PIPELINE_DISAGREES : 0u) | (vibrates ? PIPELINE_VIBRATION : 0u);
}

/* What is apart about one horizontal axis counts for both: they are turned by the error of the heading. */
static struct vec3 add_distance(struct vec3 sigma, struct vec3 off)
{
	double horizontal = hypot(off.x, off.y);

	return (struct vec3){hypot(sigma.x, horizontal), hypot(sigma.y, horizontal), hypot(sigma.z, off.z)};
}

static double root_of_sum(double sigma, double more)
{
	return sqrt(fmax(0, sigma * sigma + more));
}

/* Adds to the acceleration's sigma the noise of the lever arm's share and of the extrapolation. The error of the
 * attitude turns not only gravity, which is in that sigma already, but the acceleration itself. */
static struct navigation_sigma with_acceleration(
	const struct pipeline *p, struct vec3 omega_b_rad_s, struct vec3 accel_n_m_s2)
{
	struct navigation_sigma sigma = p->position.sigma;
	double more = lever_variance(p, omega_b_rad_s) + change_variance(p), g = p->config.estimator.gravity_m_s2;
	struct vec3 *accel = &sigma.accel_m_s2, a = accel_n_m_s2;
	double x2 = sigma.attitude_rad.x * sigma.attitude_rad.x, y2 = sigma.attitude_rad.y * sigma.attitude_rad.y;
	double z2 = sigma.attitude_rad.z * sigma.attitude_rad.z, lifted = a.z * (a.z + 2 * g);

	if (accel->x > 0)
		*accel = (struct vec3){root_of_sum(accel->x, more + y2 * lifted + z2 * a.y * a.y),
			root_of_sum(accel->y, more + x2 * lifted + z2 * a.x * a.x),
			root_of_sum(accel->z, more + x2 * a.y * a.y + y2 * a.x * a.x)};
	return sigma;
}

/* Adds how far the published attitude and acceleration are from those by the Kalman filter, whose sigma it is. */
static struct navigation_sigma of_published(
	const struct pipeline *p, struct navigation_sigma sigma, struct vec3 accel_n_m_s2)
{
	struct vec3 off = apart_n_rad(p), force = accel_n_m_s2;

	if (kalman(p) == &p->fusion || sigma.attitude_rad.x == 0) /* 0: there is none */
		return sigma;
	force.z += p->config.estimator.gravity_m_s2;
	sigma.attitude_rad = add_distance(sigma.attitude_rad, off);
	sigma.accel_m_s2 = add_distance(
		sigma.accel_m_s2, vec3_sub(force, quat_rotate_inverse(quat_from_rotation_vector(off), force)));
	return sigma;
}

static bool quat_finite(struct quat q)
{
	return isfinite(q.w) && isfinite(q.x) && isfinite(q.y) && isfinite(q.z);
}

static bool all_finite(const struct pipeline_output *o)
{
	const struct vec3 v[] = {o->force_b_m_s2, o->mag_b_uT, o->rate_b_rad_s, o->alpha_b_rad_s2, o->angles_rad,
		o->accel_b_m_s2, o->accel_n_m_s2, o->velocity_n_m_s, o->position_n_m, o->displacement_n_m,
		o->displacement_sigma_m, o->sigma.attitude_rad, o->sigma.accel_m_s2, o->sigma.velocity_m_s,
		o->sigma.position_m, o->gyro_errors.bias_b_rad_s, o->gyro_errors.scale_b};

	for (size_t i = 0; i < sizeof v / sizeof *v; i++)
		if (!vec3_finite(v[i]))
			return false;
	return quat_finite(o->q_nb);
}

/* The largest values measured so far. Their derivative is that of the rates over at least the usual interval. */
static void remember_most(struct pipeline *p, const struct imu_sample *s, struct vec3 force_b_m_s2, double dt_s)
{
	double change = vec3_norm(vec3_sub(s->gyro_rad_s, p->last_gyro_b_rad_s)) / fmax(dt_s, 1 / p->rate_hz);

	p->most.rate_rad_s = fmax(p->most.rate_rad_s, vec3_norm(s->gyro_rad_s));
	p->most.force_m_s2 = fmax(p->most.force_m_s2, vec3_norm(force_b_m_s2));
	p->most.alpha_rad_s2 = fmax(p->most.alpha_rad_s2, p->started ? change : 0);
}

/* The last guard: what is not finite, or beyond what the sensor has measured so far (its lever arm included), is not
 * published as valid. The last good output takes its place. */
static void guard(struct pipeline *p, struct pipeline_output *out)
{
	bool of_gyro = p->config.estimator.rates_from == RATES_FROM_GYRO;
	double lever = of_gyro ? vec3_norm(p->config.estimator.lever_arm_b_m) : 0;
	double share = lever * (p->most.rate_rad_s * p->most.rate_rad_s + p->most.alpha_rad_s2);
	double rate = GUARD * p->most.rate_rad_s + GUARD_RATE_RAD_S;
	double force = p->most.force_m_s2 + p->config.estimator.gravity_m_s2;
	double accel = fmax(GUARD * force, force + share);
	bool finite = all_finite(out);

	if (finite && vec3_norm(out->rate_b_rad_s) <= rate && vec3_norm(out->accel_n_m_s2) <= accel) {
		p->last_good = *out;
		return;
	}
	p->last_good.t_us = out->t_us;
	p->last_good.status = out->status & ~(unsigned)PIPELINE_VALID;
	*out = p->last_good;
	p->implausible++;
	p->primed = false;
	if (!finite)
		start_over(p);
}

/* The biases change with temperature, by what calibration leaves of that. */
static void follow_temperature(struct pipeline *p, const struct imu_sample *sample)
{
	const struct temperature_compensation *c = &p->config.calibration.temperature;
	const struct noise_config *noise = &p->config.noise;
	double gyro = noise->gyro_bias_per_K_rad_s * (calibration_compensates_gyro(c) ? COMPENSATED : 1);
	double accel = noise->accel_bias_per_K_m_s2 * (calibration_compensates_accel(c) ? COMPENSATED : 1);
	double change_K;

	if (!calibration_temperature(&p->calibration, sample->temperature_degC))
		return;
	change_K = warming_step(&p->warming, sample->temperature_degC, sample->t_us);
	if (change_K == 0)
		return;
	for (struct fusion *f = NULL; (f = next_filter(p, f)) != NULL;)
		fusion_bias_drifts(f, warming_variance(change_K, gyro));
	position_biases_drift(&p->position, warming_variance(change_K, gyro), warming_variance(change_K, accel));
}

int pipeline_step(struct pipeline *p, const struct imu_sample *sample, struct pipeline_output *out)
{
	struct imu_sample s, clean;
	const struct body_rates *rates = &p->rates.out[p->config.estimator.rates_from];
	struct vec3 gyro, accel, force;
	struct quat q_nb;
	bool missing, gap, rest;
	double dt_s;

	if (sample->flags & SAMPLE_TEMPERATURE)
		follow_temperature(p, sample);
	s = calibration_apply(&p->calibration, sample);
	if (!usable(p, &s)) {
		p->refused++;
		return -EINVAL;
	}
	if (s.flags & SAMPLE_DISCONTINUITY)
		start_over(p);
	dt_s = p->started ? (double)(s.t_us - p->last_t_us) * 1e-6 : 1 / p->rate_hz;
	missing = dt_s * p->rate_hz > PIPELINE_GAP_INTERVALS; /* over a short gap the filters go on, at whatever rate */
	gap = missing && dt_s > GAP_S;
	p->gaps += missing;
	if (gap)
		p->primed = false;

	quantisation_step(&p->accel_steps, sample->accel_m_s2, dt_s);
	clean = without_glitches(p, &s, dt_s);
	force = s.accel_m_s2;
	s.accel_m_s2 = at_the_gyros_instant(p, &s);
	clean.accel_m_s2 = at_the_gyros_instant(p, &clean);
	rest = fuse(p, &s, &clean, dt_s);
	gyro = fusion_rate_b(&p->fusion, s.gyro_rad_s);
	if (p->primed)
		rates_step(&p->rates, gyro, p->fusion.q_nb, dt_s);
	else
		rates_prime(&p->rates, gyro, p->fusion.q_nb);
	accel = estimate(p, s.accel_m_s2, dt_s);
	locate(p, &clean, accel, rest, gap, dt_s);
	remember_most(p, &s, force, dt_s);
	p->last_t_us = s.t_us;
	p->last_gyro_b_rad_s = s.gyro_rad_s;
	p->started = p->primed = true;

	q_nb = fusion_attitude_now(&p->fusion, clean.gyro_rad_s);
	*out = (struct pipeline_output){
		.t_us = s.t_us,
		.force_b_m_s2 = force,
		.mag_b_uT = p->mag_b_uT,
		.rate_b_rad_s = rates->omega_b_rad_s,
		.alpha_b_rad_s2 = rates->alpha_b_rad_s2,
		.q_nb = q_nb,
		.angles_rad = aerospace_from_quat(q_nb),
		.accel_b_m_s2 = quat_rotate_inverse(p->fusion.q_nb, accel),
		.accel_n_m_s2 = accel,
		.velocity_n_m_s = p->position.velocity_n_m_s,
		.position_n_m = p->position.position_n_m,
		.displacement_n_m = p->position.displacement_n_m,
		.displacement_sigma_m = p->position.displacement_sigma_m,
		.sigma = of_published(p, with_acceleration(p, rates->omega_b_rad_s, accel), accel),
		.gyro_errors = p->fusion.gyro_errors,
		.vibration_m_s2 = p->vibration.rms_m_s2,
		.clipped_accel = p->vibration.clipped_accel,
		.clipped_gyro = p->vibration.clipped_gyro,
		.accel_delay_s = p->accel_delay_s,
		.status = status_of(p, rest, missing),
	};
	guard(p, out);
	return 0;
}
