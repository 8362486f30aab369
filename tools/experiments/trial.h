/* tools/experiments/trial.h
 * Data of one experiment: a motion, its measurements, and the truth for comparison. There are two worlds:
 *
 * seed      as simulated in the paper: discrete signals with sudden changes, smoothed by its FIR (delay removed);
 *           derivatives are backward differences, which an estimator can compute as well; measurements by (11) with
 *           white noise of 0.03 g.
 * physical  a rigid body in continuous time (model/sim/signal.h), measured by the sensor preset lsm303dlh_l3g4200d,
 *           calibrated. */
#ifndef TOOLS_EXPERIMENTS_TRIAL_H
#define TOOLS_EXPERIMENTS_TRIAL_H

#include <stdint.h>

#include "model/seed.h"
#include "model/sim/sensor.h"

enum world { WORLD_SEED, WORLD_PHYSICAL };
enum { WORLDS = 2, TRIAL_SIGNALS = 3 };

extern const char *const WORLD_NAMES[WORLDS];
extern const char *const TRIAL_SIGNAL_NAMES[TRIAL_SIGNALS]; /* the seed's: roll_step, boat, square */

struct trial_config {
	enum world world;
	const char *signal;
	double rate_hz;
	double angle_scale; /* factor on all rotations; default 1 */
	struct vec3 lever_arm_b_m;
	double gravity_m_s2;
	double force_sigma_m_s2; /* white noise of the accelerometer in the world `seed`; default 0.03 g */
	double gyro_noise_scale; /* factor on density and bias instability of the gyro; default 1 */
	uint64_t seed;
};

/** Lever arm of 5 cm along each axis; 50 Hz in the world `seed`, 100 Hz in `physical`. */
struct trial_config trial_defaults(enum world world, const char *signal);

struct trial {
	struct trial_config config;
	struct sensor_config sensor;
	int count;
	double dt_s;
	struct vec3 *accel_b_m_s2;   /* truth: of the reference point */
	struct seed_motion *motion;  /* truth */
	struct vec3 *force_b_m_s2;   /* measured */
	struct vec3 *gyro_b_rad_s;   /* measured */
	struct vec3 *angle_noise;    /* of unit variance, the same for all noise levels and methods */
	struct seed_motion *scratch; /* for the methods */
};

/** 0, or -ENOMEM. Free it with trial_free(). */
int trial_make(struct trial *trial, const struct trial_config *config);
void trial_free(struct trial *trial);

/** Smooths in place with the FIR of the paper, and removes its delay. */
void seed_fir(struct vec3 *values, int count, double rate_hz);
/** Computes the derivatives of motion[].angles_rad by backward differences. */
void seed_differentiate(struct seed_motion *motion, int count, double dt_s);

#endif
