/* tools/experiments/trial.h
 * One experiment's data: a motion, what the sensors made of it, and the truth to compare with. Two worlds:
 *
 * seed      as the paper simulated: discrete signals with sudden changes, smoothed by its FIR (delay removed), derivatives
 *           by differences of neighbouring samples (backward, so an estimator can do the same), measurements by (11)
 *           with white noise of 0.03 g.
 * physical  a rigid body in continuous time (model/sim/signal.h) seen by the sensor preset lsm303dlh_l3g4200d, calibrated. */
#ifndef TOOLS_TRIAL_H
#define TOOLS_TRIAL_H

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
	double angle_scale; /* on all rotations; 1: as chosen */
	struct vec3 lever_arm_b_m;
	double gravity_m_s2;
	double force_sigma_m_s2; /* seed world: white noise of the accelerometer */
	double gyro_noise_scale; /* on the gyro's density and bias instability */
	uint64_t seed;
};

/** 5 cm along each axis, 50 Hz in the seed's world and 100 Hz in the physical one. */
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
	struct vec3 *angle_noise;    /* unit variance: every noise level and method gets the same */
	struct seed_motion *scratch; /* room for a method */
};

/** 0, or -ENOMEM. Free with trial_free(). */
int trial_make(struct trial *trial, const struct trial_config *config);
void trial_free(struct trial *trial);

/** Smooths with the seed's FIR, its delay taken away. In place. */
void seed_fir(struct vec3 *values, int count, double rate_hz);
/** Fills in the derivatives of motion[].angles_rad by backward differences. */
void seed_differentiate(struct seed_motion *motion, int count, double dt_s);

#endif
