#include "tools/experiments/trial.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "model/math/filter.h"
#include "model/math/units.h"

static const double G_M_S2 = 9.81;

const char *const WORLD_NAMES[WORLDS] = {"seed", "physical"};
const char *const TRIAL_SIGNAL_NAMES[TRIAL_SIGNALS] = {"roll_step", "boat", "square"};

struct trial_config trial_defaults(enum world world, const char *signal)
{
	return (struct trial_config){
		.world = world,
		.signal = signal,
		.rate_hz = world == WORLD_SEED ? 50 : 100,
		.angle_scale = 1,
		.lever_arm_b_m = {0.05, 0.05, 0.05},
		.gravity_m_s2 = G_M_S2,
		.force_sigma_m_s2 = 0.03 * G_M_S2,
		.gyro_noise_scale = 1,
		.seed = 1,
	};
}

/* ---- the world `seed`: signals of unlimited bandwidth ---------------------------------------------------------- */

static double degrees(double angle)
{
	return angle * PI / 180;
}

/* 1 from start for length; 0 elsewhere. */
static double pulse(double t, double start, double length)
{
	return t >= start && t < start + length ? 1 : 0;
}

static double ramp(double t, double start, double length)
{
	return fmin(1, fmax(0, (t - start) / length));
}

static double wave(double t, double start, double length, double period)
{
	return pulse(t, start, length) * sin(2 * PI * (t - start) / period);
}

struct raw {
	struct vec3 angles_rad, accel_b_m_s2;
};

static struct raw raw_roll_step(double t)
{
	double second = fmod(t, 4);

	return (struct raw){.angles_rad = {degrees(24) * pulse(second, 1, 2), 0, 0}};
}

/* A light sea, and in each 20 s a sudden wave that heaves, pitches and rolls the boat twice. */
static struct raw raw_boat(double t)
{
	double sea = degrees(1) * sin(2 * PI * t / 4), since = fmod(t, 20);

	return (struct raw){
		.angles_rad = {sea + degrees(18) * wave(since, 6, 6, 2), sea + degrees(25) * wave(since, 5, 5, 2.5),
			degrees(8) * wave(since, 5, 5, 5)},
		.accel_b_m_s2 = {1.5 * wave(since, 5, 5, 2.5), 0.8 * wave(since, 6, 6, 2),
			3 * pulse(since, 5, 0.6) - 3 * pulse(since, 6.2, 0.6) + 1.5 * pulse(since, 7.5, 0.6) -
				1.5 * pulse(since, 8.7, 0.6)},
	};
}

/* Four sides of 10 s: 2 s at rest, 1 s of acceleration, a drive over three bumps, 1 s of braking, a 90 degree turn in 1
 * s. */
static struct raw raw_square(double t)
{
	double leg = fmod(t, 10);
	double bump = pulse(leg, 3.5, 0.1) - pulse(leg, 3.8, 0.1), hole = pulse(leg, 5.2, 0.2);

	return (struct raw){
		.angles_rad = {degrees(3) * bump + degrees(2) * hole, degrees(2) * bump - degrees(3) * hole,
			degrees(90) * (floor(t / 10) + ramp(leg, 8.5, 1))},
		.accel_b_m_s2 = {pulse(leg, 2, 1) - pulse(leg, 7, 1), 0.3 * bump, 3 * bump - 2 * hole},
	};
}

void seed_fir(struct vec3 *values, int count, double rate_hz)
{
	const struct filter_config config = {.type = FILTER_SEED_FIR, .order = 1, .cutoff_hz = rate_hz};
	const int delay = FILTER_SEED_FIR_ORDER / 2;
	const struct vec3 last = values[count - 1];
	struct filter3 filter;

	filter3_init(&filter, &config, rate_hz);
	for (int k = 0; k < count + delay; k++) {
		struct vec3 out = filter3_step(&filter, k < count ? values[k] : last);

		if (k >= delay)
			values[k - delay] = out;
	}
}

static struct vec3 difference(struct vec3 now, struct vec3 before, double dt_s)
{
	return vec3_scale(1 / dt_s, vec3_sub(now, before));
}

void seed_differentiate(struct seed_motion *motion, int count, double dt_s)
{
	motion[0].rates_rad_s = motion[0].accels_rad_s2 = (struct vec3){0, 0, 0};
	for (int k = 1; k < count; k++) {
		struct seed_motion *now = &motion[k], *before = &motion[k - 1];

		now->rates_rad_s = difference(now->angles_rad, before->angles_rad, dt_s);
		now->accels_rad_s2 = difference(now->rates_rad_s, before->rates_rad_s, dt_s);
	}
}

static void seed_signals(struct trial *trial)
{
	struct raw (*raw)(double) = strcmp(trial->config.signal, "roll_step") == 0 ? raw_roll_step
				    : strcmp(trial->config.signal, "boat") == 0	   ? raw_boat
										   : raw_square;
	struct vec3 *angles = trial->gyro_b_rad_s; /* used as a buffer before the gyro is simulated */

	for (int k = 0; k < trial->count; k++) {
		struct raw now = raw(k * trial->dt_s);

		angles[k] = vec3_scale(trial->config.angle_scale, now.angles_rad);
		trial->accel_b_m_s2[k] = now.accel_b_m_s2;
	}
	seed_fir(angles, trial->count, trial->config.rate_hz);
	seed_fir(trial->accel_b_m_s2, trial->count, trial->config.rate_hz);
	for (int k = 0; k < trial->count; k++)
		trial->motion[k].angles_rad = angles[k];
	seed_differentiate(trial->motion, trial->count, trial->dt_s);
}

static struct vec3 gauss3(struct rng *rng)
{
	struct vec3 v;

	v.x = rng_gauss(rng);
	v.y = rng_gauss(rng);
	v.z = rng_gauss(rng);
	return v;
}

/* The gyro of the preset measures the rates of the angles; its bandwidth has no meaning in discrete time. */
static void seed_measurements(struct trial *trial, struct sensor *sensor, struct rng *rng)
{
	const struct trial_config *c = &trial->config;

	for (int k = 0; k < trial->count; k++) {
		struct rigid_motion rigid = rigid_motion_from_seed(&trial->motion[k]);
		struct signal_truth truth = {.q_nb = rigid.q_nb, .omega_b_rad_s = rigid.omega_b_rad_s};
		struct imu_sample sample;

		sensor_measure(sensor, &truth, &sample);
		trial->gyro_b_rad_s[k] = sample.gyro_rad_s;
		trial->force_b_m_s2[k] = seed_noisy(trial->accel_b_m_s2[k], &trial->motion[k], c->lever_arm_b_m,
			c->gravity_m_s2, vec3_scale(c->force_sigma_m_s2, gauss3(rng)));
	}
}

/* ---- the physical world ------------------------------------------------------------------------------------------ */

/* Yaw without jumps at half a turn, for its derivatives. */
static double unwrap(double angle, double before)
{
	return angle - 2 * PI * round((angle - before) / (2 * PI));
}

static void physical_measurements(struct trial *trial, struct sensor *sensor)
{
	struct signal signal = *signal_find(trial->config.signal);

	signal.angle_rad *= trial->config.angle_scale;
	for (int k = 0; k < trial->count; k++) {
		struct rigid_motion rigid;
		struct signal_truth truth;
		struct imu_sample sample;

		sensor_next(sensor, &signal, &sample, &truth);
		rigid = (struct rigid_motion){truth.q_nb, truth.omega_b_rad_s, truth.alpha_b_rad_s2};
		trial->motion[k] = seed_motion_from_rigid(&rigid);
		if (k > 0)
			trial->motion[k].angles_rad.z =
				unwrap(trial->motion[k].angles_rad.z, trial->motion[k - 1].angles_rad.z);
		trial->accel_b_m_s2[k] = quat_rotate_inverse(truth.q_nb, truth.accel_n_m_s2);
		trial->force_b_m_s2[k] = sample.accel_m_s2;
		trial->gyro_b_rad_s[k] = sample.gyro_rad_s;
	}
}

/* ---- both -------------------------------------------------------------------------------------------------------- */

static struct sensor_config trial_sensor(const struct trial_config *config)
{
	struct sensor_config sensor = *sensor_preset("lsm303dlh_l3g4200d");

	sensor_calibrate(&sensor);
	sensor.rate_hz = config->rate_hz;
	sensor.gravity_m_s2 = config->gravity_m_s2;
	sensor.lever_arm_b_m = config->lever_arm_b_m;
	sensor.gyro.density *= config->gyro_noise_scale;
	sensor.gyro.bias_instability *= config->gyro_noise_scale;
	if (config->world == WORLD_SEED)
		sensor.gyro.bandwidth_hz = 0;
	return sensor;
}

int trial_make(struct trial *trial, const struct trial_config *config)
{
	const double duration_s = strcmp(config->signal, "square") == 0 ? 40 : 20;
	const size_t n = (size_t)(duration_s * config->rate_hz);
	struct sensor sensor;
	struct rng rng;

	*trial = (struct trial){
		.config = *config,
		.sensor = trial_sensor(config),
		.count = (int)n,
		.dt_s = 1 / config->rate_hz,
		.accel_b_m_s2 = calloc(n, sizeof(struct vec3)),
		.motion = calloc(n, sizeof(struct seed_motion)),
		.force_b_m_s2 = calloc(n, sizeof(struct vec3)),
		.gyro_b_rad_s = calloc(n, sizeof(struct vec3)),
		.angle_noise = calloc(n, sizeof(struct vec3)),
		.scratch = calloc(n, sizeof(struct seed_motion)),
	};
	if (!trial->accel_b_m_s2 || !trial->motion || !trial->force_b_m_s2 || !trial->gyro_b_rad_s ||
		!trial->angle_noise || !trial->scratch) {
		trial_free(trial);
		return -ENOMEM;
	}
	rng_init(&rng, config->seed);
	sensor_init(&sensor, &trial->sensor, config->seed);
	for (int k = 0; k < trial->count; k++)
		trial->angle_noise[k] = gauss3(&rng);
	if (config->world == WORLD_SEED) {
		seed_signals(trial);
		seed_measurements(trial, &sensor, &rng);
	} else {
		physical_measurements(trial, &sensor);
	}
	return 0;
}

void trial_free(struct trial *trial)
{
	free(trial->accel_b_m_s2);
	free(trial->motion);
	free(trial->force_b_m_s2);
	free(trial->gyro_b_rad_s);
	free(trial->angle_noise);
	free(trial->scratch);
	*trial = (struct trial){0};
}
