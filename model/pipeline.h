/* model/pipeline.h
 * The straight line of one sample: calibrate -> low-pass -> fuse (attitude) -> estimate
 * (acceleration of the reference point) -> integrate (velocity, position). One function a step,
 * each in a file of its own; this one composes them. Pure: the same samples and configuration give
 * the same bits, in the gateway and in imu9-replay.
 *
 * Time: attitude and acceleration are published as of the time stamp, carried over the sensor's latency by the rate and by
 * the derivative of the specific force, as far as that exceeds its noise (auto_correction.h); the lever arm's share, rates,
 * velocity and position as of the instant that was measured, so that share and rates agree. Gyro and accelerometer are
 * brought to one instant before anything else. What the acceleration filter delays stays delayed (2031h:3).
 *
 * Frames: sensor = the axes of the chips; b = object (l, s, t: longitudinal, side, transversal); n
 * = global (ENU: x east, y magnetic north, z up). q_nb turns b into n. */
#ifndef MODEL_PIPELINE_H
#define MODEL_PIPELINE_H

#include "model/auto_correction.h"
#include "model/calibration.h"
#include "model/estimator.h"
#include "model/math/filter.h"
#include "model/fusion.h"
#include "model/position.h"
#include "model/rates.h"
#include "model/rest.h"
#include "model/sample.h"

/* Each sample is older than its time stamp by its sensor's low-pass and buffers. */
struct latency_config {
	double sensor_s;	/* 0..0.1: of the gyro's */
	double accelerometer_s; /* -0.05..0.05: by how much longer of the accelerometer's; not so that it comes before
				   it happens */
};

struct pipeline_config { /* start from PIPELINE_DEFAULTS */
	struct calibration_config calibration;
	struct filter_config accel_filter; /* on the acceleration of the reference point, global frame (2010h) */
	struct filter_config rate_filter;  /* on the rates, or on the angles before they are
					      differentiated (2011h) */
	struct latency_config latency;	   /* (2031h) */
	struct fusion_config fusion; /* the lever arm and the delay are taken from the estimator and the latency */
	struct noise_config noise;   /* of the sensors (2020h) */
	struct estimator_config estimator;
	struct rest_config rest;
	struct position_config position;
};

extern const struct pipeline_config PIPELINE_DEFAULTS;

/** Bits of pipeline_output.status, as published in the status word (210Fh:3). */
enum {
	PIPELINE_VALID = 1 << 0,      /* attitude and acceleration are usable */
	PIPELINE_REST = 1 << 1,	      /* the sensor stands still */
	PIPELINE_MAG_USED = 1 << 2,   /* the magnetometer took part in this sample's heading, or lately */
	PIPELINE_TIME_LIMIT = 1 << 3, /* the longest integration time has passed: position is held */
	PIPELINE_GAP = 1 << 4,	      /* samples were missing just before this one */
	PIPELINE_UNSURE = 1 << 5,     /* 1 sigma of the position exceeds its limit */
};

struct pipeline_output {
	uint64_t t_us;
	struct vec3 force_b_m_s2;   /* calibrated, unfiltered specific force */
	struct vec3 mag_b_uT;	    /* calibrated field, the last one known */
	struct vec3 rate_b_rad_s;   /* angular rate and acceleration as used for the lever arm:
				       filtered, from */
	struct vec3 alpha_b_rad_s2; /* the gyro (less the fusion's bias) or from the attitude, as
				       configured */
	struct quat q_nb;
	struct vec3 angles_rad;	  /* roll, pitch, yaw: aerospace z-y'-x'' of q_nb, yaw from east,
				     counter-clockwise */
	struct vec3 accel_b_m_s2; /* of the reference point, gravity removed, in the object's axes as the rates are */
	struct vec3 accel_n_m_s2; /* the same, global frame */
	struct vec3 velocity_n_m_s;
	struct vec3 position_n_m;
	/* by navigation only, else 0: from one standstill to the next, and how certain all is */
	struct vec3 displacement_n_m, displacement_sigma_m;
	struct navigation_sigma sigma;
	struct gyro_errors gyro_errors; /* by the fusion, and taken off the rates */
	double accel_delay_s;	   /* by which the accelerations stay behind t_us: the acceleration filter's */
	unsigned status;
};

struct pipeline {
	struct pipeline_config config;
	struct estimator_config last_estimator; /* of the last sample */
	double rate_hz;
	double accel_delay_s; /* of the acceleration filter */
	/* PRIVATE: the state of each step */
	struct calibration calibration;
	struct differentiator3 accel_change;
	struct filter3 accel_filter;
	struct fusion fusion;
	struct rates rates;
	struct rates_variance rates_variance; /* of the source of rates in use */
	struct auto_correction auto_correction, auto_change;
	double change_of_white; /* variance of accel_change by white noise of variance 1 */
	struct rest rest;
	struct position position;
	uint64_t last_t_us;
	struct vec3 last_gyro_b_rad_s;
	bool started; /* there is a sample before this one */
	bool primed;  /* .. and the filters may go on from it */
	struct vec3 mag_b_uT;
	double since_mag_s;
	uint32_t gaps;	  /* intervals longer than PIPELINE_GAP_INTERVALS sampling intervals */
	uint32_t refused; /* samples not used: see pipeline_step() */
};

enum { PIPELINE_GAP_INTERVALS = 10 };

/** 0, or -EINVAL with *p untouched when a field of the configuration is out of range (see above and each
 * step's header). */
int pipeline_init(struct pipeline *p, const struct pipeline_config *config, double rate_hz);

/** From now on the path of each movement that ends is in smoother->last (position mode 2); NULL: nowhere. It is the
 * caller's, and one pipeline's only. */
void pipeline_smooth(struct pipeline *p, struct smoother *smoother);

/** Takes a new configuration between two samples. What physics allows to keep is kept: attitude,
 * velocity, position; a filter starts anew (primed with its last output, without a step) only when
 * its own parameters changed. */
int pipeline_configure(struct pipeline *p, const struct pipeline_config *config);

/** One sample. 0, or -EINVAL when the sample was refused (counted; *out untouched): a value not
 * finite or beyond what any sensor measures (1000 rad/s, 100 km/s^2, 1 T), or a time that does not
 * increase.
 *
 * After a gap, the filters start anew from this sample, velocity and position stay as they were
 * before it, and the attitude is carried over by the gyro, or, after more than a second, found anew
 * from this sample (without a magnetometer with the old heading). A sample marked
 * SAMPLE_DISCONTINUITY starts everything over. */
int pipeline_step(struct pipeline *p, const struct imu_sample *sample, struct pipeline_output *out);

/* What another device knows, told between two samples; it holds at the time stamp of the last one. 0, or -EINVAL with *p
 * untouched: a value not finite or out of the range given. Before there is an attitude the two aids do nothing. A
 * discontinuity forgets what was told. */

/** The velocity of the reference point, global frame, +-1000 m/s each, with 1 sigma of 0.001..1000 m/s. In position mode 2
 * a measurement of the navigation; in mode 1 it is taken as the velocity. FUSION_KALMAN also corrects its tilt by it. The
 * longest integration time starts anew. */
int pipeline_aid_velocity(struct pipeline *p, struct vec3 v_n_m_s, double sigma_m_s);
/** The heading as yaw of pipeline_output.angles_rad, +-2 pi, with 1 sigma of 0.0001..pi: a measurement of the fusion
 * (fusion_aid_yaw()). Its frame may have another north than the magnetic one. */
int pipeline_aid_yaw(struct pipeline *p, double yaw_rad, double sigma_rad);
/** The attitude, of length 1 within a tenth: taken as it is. The velocity turns with the object, the position stays; where
 * the magnetic field points to from there is its north from now on. */
int pipeline_reset_attitude(struct pipeline *p, struct quat q_nb);

/** Velocity and position to zero (2040h reset command). */
void pipeline_reset_position(struct pipeline *p);

#endif
