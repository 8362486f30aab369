#include "model/sim/sensor.h"
#include "model/math/units.h"

#include <errno.h>
#include <math.h>
#include <string.h>

static const double START_DEGC = 25;
/* Flicker noise is approximated by a sum of Gauss-Markov processes with the time constants 1, 8, .. 4096 s. */
static const double FLICKER_TAU_S = 1, FLICKER_RATIO = 8, LOG_FLICKER_RATIO = 2.0794415416798357;

/* Chips at a full scale with its digit. Densities, offsets, digits and ranges are the typical values of the datasheets
 * (the offset of the gyro is that of its finest range), bandwidths those available at about 100 Hz. The datasheets do
 * not specify bias instability and random walk: the values are common ones for this class of chips. */
#define L3G4200D(full_scale, digit)                                                                     \
	{                                                                                               \
		.density = 0.03 * RAD_PER_DEG, .bias_instability = 0.01 * RAD_PER_DEG,                  \
		.random_walk = 0.0002 * RAD_PER_DEG, .bias_sigma = 10 * RAD_PER_DEG,                    \
		.temperature_sigma = 0.03 * RAD_PER_DEG, .scale_sigma = 0.02, .cross_axis_sigma = 0.01, \
		.bandwidth_hz = 50, .step = (digit)*RAD_PER_DEG, .range = (full_scale)*RAD_PER_DEG      \
	}
#define LSM303DLHC_ACCEL(full_scale, digit)                                                                            \
	{                                                                                                              \
		.density = 220e-6 * STANDARD_GRAVITY_M_S2, .bias_instability = 0.1e-3 * STANDARD_GRAVITY_M_S2,         \
		.random_walk = 2e-6 * STANDARD_GRAVITY_M_S2, .bias_sigma = 0.06 * STANDARD_GRAVITY_M_S2,               \
		.temperature_sigma = 0.5e-3 * STANDARD_GRAVITY_M_S2, .scale_sigma = 0.02, .cross_axis_sigma = 0.01,    \
		.bandwidth_hz = 50, .step = (digit)*STANDARD_GRAVITY_M_S2, .range = (full_scale)*STANDARD_GRAVITY_M_S2 \
	}
#define LSM303DLH_ACCEL(full_scale, digit)                                                                             \
	{                                                                                                              \
		.density = 218e-6 * STANDARD_GRAVITY_M_S2, .bias_instability = 0.1e-3 * STANDARD_GRAVITY_M_S2,         \
		.random_walk = 2e-6 * STANDARD_GRAVITY_M_S2, .bias_sigma = 0.02 * STANDARD_GRAVITY_M_S2,               \
		.temperature_sigma = 0.2e-3 * STANDARD_GRAVITY_M_S2, .scale_sigma = 0.02, .cross_axis_sigma = 0.01,    \
		.bandwidth_hz = 74, .step = (digit)*STANDARD_GRAVITY_M_S2, .range = (full_scale)*STANDARD_GRAVITY_M_S2 \
	}
#define LSM303_MAG(noise_density, digits_per_gauss)                                                          \
	{                                                                                                    \
		.density = (noise_density), .bias_sigma = 10, .scale_sigma = 0.05, .cross_axis_sigma = 0.02, \
		.step = UT_PER_GAUSS / (digits_per_gauss), .range = 1.3 * UT_PER_GAUSS                       \
	}
#define COMMON \
	.rate_hz = 100, .gravity_m_s2 = 9.81, .field_n_uT = {0, 20, -45}, .warming_s = 120, .temperature_step_K = 1

const struct sensor_config SENSOR_PRESETS[] = {
	{.name = "lsm303dlhc_l3gd20",
		.about = "Pololu IMU 9 v2: LSM303DLHC at 8 g and 1.3 gauss, L3GD20 at 2000 deg/s",
		.gyro = L3G4200D(2000, 0.07),
		.accel = LSM303DLHC_ACCEL(8, 0.004),
		.mag = LSM303_MAG(0.02, 1100),
		.mag_rate_hz = 75,
		COMMON},
	{.name = "lsm303dlhc_l3gd20_fine",
		.about = "the same at 2 g and 250 deg/s: finer digits, for calibrations and noise at rest",
		.gyro = L3G4200D(250, 0.00875),
		.accel = LSM303DLHC_ACCEL(2, 0.001),
		.mag = LSM303_MAG(0.02, 1100),
		.mag_rate_hz = 75,
		COMMON},
	{.name = "lsm303dlh_l3g4200d",
		.about = "Pololu IMU 9 v0, as in the paper: LSM303DLH at 8 g and 1.3 gauss, L3G4200D at 2000 deg/s",
		.gyro = L3G4200D(2000, 0.07),
		.accel = LSM303DLH_ACCEL(8, 0.0039),
		.mag = LSM303_MAG(0.1, 1055),
		.mag_rate_hz = 75,
		COMMON},
	{.name = "ideal", .about = "no errors", COMMON},
	{0},
};

const struct sensor_config *sensor_preset(const char *name)
{
	for (const struct sensor_config *preset = SENSOR_PRESETS; preset->name; preset++)
		if (strcmp(preset->name, name) == 0)
			return preset;
	return NULL;
}

void sensor_calibrate(struct sensor_config *config)
{
	struct triad_errors *triads[] = {&config->gyro, &config->accel, &config->mag};

	for (int i = 0; i < 3; i++) {
		triads[i]->bias_sigma = 0;
		triads[i]->scale_sigma = 0;
		triads[i]->cross_axis_sigma = 0;
		triads[i]->temperature_sigma = 0;
	}
}

static int errors_valid(const struct triad_errors *e)
{
	const double all[] = {e->density, e->bias_instability, e->random_walk, e->bias_sigma, e->scale_sigma,
		e->cross_axis_sigma, e->bandwidth_hz, e->step, e->range, e->temperature_sigma};

	for (size_t i = 0; i < sizeof all / sizeof *all; i++)
		if (!(all[i] >= 0 && isfinite(all[i])))
			return 0;
	return 1;
}

/* Processes of equal variance v whose time constants differ by a factor k have together the one-sided spectrum
 * v / (ln k f); flicker noise of bias instability B has B^2 / (pi f). */
static void flicker_init(struct triad *triad, double interval_s)
{
	double sigma = triad->errors.bias_instability * sqrt(LOG_FLICKER_RATIO / PI);
	double tau_s = FLICKER_TAU_S;

	for (int k = 0; k < SENSOR_FLICKER_POLES; k++, tau_s *= FLICKER_RATIO) {
		double decay = exp(-interval_s / tau_s);

		triad->flicker_decay[k] = decay;
		triad->flicker_drive[k] = sigma * sqrt(1 - decay * decay);
		for (int axis = 0; axis < 3; axis++)
			triad->flicker[axis][k] = sigma * rng_gauss(&triad->rng);
	}
}

static void lag_init(struct triad *triad, double interval_s)
{
	double a = 2 * PI * triad->errors.bandwidth_hz * interval_s;

	triad->lag_decay = exp(-a);
	triad->lag_new = 1 - (1 - triad->lag_decay) / a;
	triad->lag_old = (1 - triad->lag_decay) / a - triad->lag_decay;
}

static void triad_init(struct triad *triad, const struct triad_errors *errors, double rate_hz, uint64_t seed)
{
	struct rng slopes;

	*triad = (struct triad){.errors = *errors};
	rng_init(&triad->rng, seed);
	triad->bias.x = errors->bias_sigma * rng_gauss(&triad->rng);
	triad->bias.y = errors->bias_sigma * rng_gauss(&triad->rng);
	triad->bias.z = errors->bias_sigma * rng_gauss(&triad->rng);
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++) {
			double g = rng_gauss(&triad->rng);

			triad->matrix[i][j] = i == j ? 1 + errors->scale_sigma * g : errors->cross_axis_sigma * g;
		}
	/* from a generator of its own, so that the other draws do not depend on it */
	rng_init(&slopes, ~seed);
	triad->slope.x = errors->temperature_sigma * rng_gauss(&slopes);
	triad->slope.y = errors->temperature_sigma * rng_gauss(&slopes);
	triad->slope.z = errors->temperature_sigma * rng_gauss(&slopes);
	triad->white_sigma = errors->density * sqrt(rate_hz / 2);
	triad->walk_sigma = errors->random_walk / sqrt(rate_hz);
	flicker_init(triad, 1 / rate_hz);
	if (errors->bandwidth_hz > 0)
		lag_init(triad, 1 / rate_hz);
}

int sensor_init(struct sensor *sensor, const struct sensor_config *config, uint64_t seed)
{
	const double rate_hz = config->rate_hz;
	struct rng seeds;

	if (!(rate_hz > 0 && isfinite(rate_hz)) || !(config->jitter_s >= 0) || config->jitter_s * rate_hz > 0.1 ||
		!(config->mag_rate_hz >= 0) || !errors_valid(&config->gyro) || !errors_valid(&config->accel) ||
		!errors_valid(&config->mag) || !isfinite(config->warming_K) ||
		(config->warming_K != 0 && !(config->warming_s > 0)) || !(config->temperature_step_K >= 0))
		return -EINVAL;
	rng_init(&seeds, seed);
	*sensor = (struct sensor){.config = *config};
	triad_init(&sensor->gyro, &config->gyro, rate_hz, rng_u64(&seeds));
	triad_init(&sensor->accel, &config->accel, rate_hz, rng_u64(&seeds));
	triad_init(&sensor->mag, &config->mag, rate_hz, rng_u64(&seeds));
	rng_init(&sensor->jitter, rng_u64(&seeds));
	return 0;
}

static struct vec3 low_pass(struct triad *triad, struct vec3 in, int first)
{
	struct vec3 out = in;

	if (triad->errors.bandwidth_hz <= 0)
		return in;
	if (!first)
		out = vec3_add(vec3_scale(triad->lag_decay, triad->lag_out),
			vec3_add(vec3_scale(triad->lag_new, in), vec3_scale(triad->lag_old, triad->lag_in)));
	triad->lag_in = in;
	triad->lag_out = out;
	return out;
}

static double noise(struct triad *triad, int axis)
{
	double sum = triad->white_sigma * rng_gauss(&triad->rng);

	if (triad->errors.bias_instability > 0)
		for (int k = 0; k < SENSOR_FLICKER_POLES; k++) {
			double *x = &triad->flicker[axis][k];

			*x = triad->flicker_decay[k] * *x + triad->flicker_drive[k] * rng_gauss(&triad->rng);
			sum += *x;
		}
	if (triad->errors.random_walk > 0) {
		triad->walk[axis] += triad->walk_sigma * rng_gauss(&triad->rng);
		sum += triad->walk[axis];
	}
	return sum;
}

static double digitise(const struct triad_errors *errors, double value)
{
	if (errors->step > 0)
		value = errors->step * floor(value / errors->step + 0.5);
	if (errors->range > 0)
		value = fmax(-errors->range, fmin(errors->range, value));
	return value;
}

static struct vec3 triad_measure(struct triad *triad, struct vec3 in, double rise_K, int first)
{
	double(*m)[3] = triad->matrix;
	struct vec3 v = low_pass(triad, in, first);
	struct vec3 out = {
		m[0][0] * v.x + m[0][1] * v.y + m[0][2] * v.z + triad->bias.x,
		m[1][0] * v.x + m[1][1] * v.y + m[1][2] * v.z + triad->bias.y,
		m[2][0] * v.x + m[2][1] * v.y + m[2][2] * v.z + triad->bias.z,
	};

	out = vec3_add(out, vec3_scale(rise_K, triad->slope));
	out.x = digitise(&triad->errors, out.x + noise(triad, 0));
	out.y = digitise(&triad->errors, out.y + noise(triad, 1));
	out.z = digitise(&triad->errors, out.z + noise(triad, 2));
	return out;
}

double sensor_instant_s(struct sensor *sensor)
{
	double t_s = (double)sensor->count / sensor->config.rate_hz;

	return fmax(0, t_s + sensor->config.jitter_s * rng_gauss(&sensor->jitter));
}

struct vec3 sensor_specific_force(const struct signal_truth *truth, struct vec3 lever_arm_b_m, double gravity_m_s2)
{
	const struct vec3 up = {0, 0, gravity_m_s2}, w = truth->omega_b_rad_s, r = lever_arm_b_m;
	struct vec3 force = quat_rotate_inverse(truth->q_nb, vec3_add(truth->accel_n_m_s2, up));

	force = vec3_add(force, vec3_cross(truth->alpha_b_rad_s2, r));
	return vec3_add(force, vec3_cross(w, vec3_cross(w, r)));
}

/* The magnetometer has a new value when its own sample number has changed since the last sample. */
static int mag_is_new(const struct sensor *sensor)
{
	double ratio = sensor->config.mag_rate_hz / sensor->config.rate_hz;
	double k = (double)sensor->count;

	return sensor->count == 0 || ratio <= 0 || ratio >= 1 || floor(k * ratio) > floor((k - 1) * ratio);
}

static double temperature_rise(const struct sensor *sensor)
{
	const struct sensor_config *config = &sensor->config;

	if (config->warming_K == 0)
		return 0;
	return config->warming_K * (1 - exp(-(double)sensor->count / (config->rate_hz * config->warming_s)));
}

void sensor_measure(struct sensor *sensor, const struct signal_truth *truth, struct imu_sample *sample)
{
	const struct sensor_config *config = &sensor->config;
	const int first = sensor->count == 0, mag = mag_is_new(sensor);
	struct vec3 force = sensor_specific_force(truth, config->lever_arm_b_m, config->gravity_m_s2);
	struct vec3 field = quat_rotate_inverse(truth->q_nb, config->field_n_uT);
	double rise_K = temperature_rise(sensor);

	*sample = (struct imu_sample){
		.t_us = (uint64_t)floor((double)sensor->count * 1e6 / config->rate_hz + 0.5),
		.gyro_rad_s = triad_measure(&sensor->gyro, truth->omega_b_rad_s, rise_K, first),
		.accel_m_s2 = triad_measure(&sensor->accel, force, rise_K, first),
		.mag_uT = triad_measure(&sensor->mag, field, rise_K, first),
		.flags = mag ? SAMPLE_MAG : 0,
	};
	if (!mag)
		sample->mag_uT = (struct vec3){0, 0, 0};
	if (config->warming_K != 0) {
		const struct triad_errors thermometer = {.step = config->temperature_step_K};

		sample->temperature_degC = digitise(&thermometer, START_DEGC + rise_K);
		sample->flags |= SAMPLE_TEMPERATURE;
	}
	sensor->count++;
}

void sensor_next(
	struct sensor *sensor, const struct signal *signal, struct imu_sample *sample, struct signal_truth *truth)
{
	struct signal_truth own;

	if (!truth)
		truth = &own;
	signal_at(signal, sensor_instant_s(sensor), truth);
	sensor_measure(sensor, truth, sample);
}
