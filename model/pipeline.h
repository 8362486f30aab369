/* model/pipeline.h
 * The way of one sample: calibrate -> fuse (attitude) -> estimate (acceleration of the reference point) -> low-pass ->
 * integrate (velocity, position). Each step has a file of its own; this one composes them. Pure: the same samples and
 * configuration give the same bits, in the gateway and in imu9-replay.
 *
 * Time: attitude and acceleration are published as of the time stamp. They are extrapolated over the sensor's latency
 * by the rate and by the derivative of the specific force, as far as that exceeds its noise (auto_correction.h). The
 * lever arm's share, rates, velocity and position are as of the instant of measurement, so that share and rates agree.
 * Gyro and accelerometer are brought to one instant before anything else. The delay of the acceleration filter is not
 * compensated (2031h:3).
 *
 * Frames: sensor = the axes of the chips; b = object (l, s, t: longitudinal, side, transversal); n = global (ENU: x
 * east, y magnetic north, z up). q_nb turns b into n. */
#ifndef MODEL_PIPELINE_H
#define MODEL_PIPELINE_H

#include "model/auto_correction.h"
#include "model/calibration.h"
#include "model/estimator.h"
#include "model/glitch.h"
#include "model/math/filter.h"
#include "model/fusion.h"
#include "model/position.h"
#include "model/quantisation.h"
#include "model/rates.h"
#include "model/rest.h"
#include "model/sample.h"
#include "model/vibration.h"
#include "model/warming.h"

/** The latency of a sensor: by how much its samples are older than their time stamps, because of its low-pass and its
 * buffers. */
struct latency_config {
	/** s, 0..0.1, default 0.0042 (fitted to the optical rate of the BROAD trials): latency of the gyro. Attitude
	 * and acceleration are extrapolated over it. Too small a value publishes them late, too large a one early. */
	double sensor_s;
	/** s, -0.05..0.05, default -0.0016 (fitted likewise): additional latency of the accelerometer against the gyro;
	 * negative when the accelerometer is faster. Less than -sensor_s counts as -sensor_s: no sample is measured
	 * after its time stamp. Any error of it leaves a share of gravity, rate times error, in the acceleration. */
	double accelerometer_s;
};

/** Start from PIPELINE_DEFAULTS. The header of each step says meaning, unit, range and default of its fields. */
struct pipeline_config {
	struct calibration_config calibration;
	/** (2055h) PIPELINE_UNCALIBRATED_... of the sensors that nobody calibrated, default 0. Their errors are those
	 * of data sheets then (UNCALIBRATED_...), which count in the attitude's sigma until the motion shows less. */
	unsigned uncalibrated;
	/** (2010h) Low-pass of the reference point's acceleration in the global frame. Off by default. */
	struct filter_config accel_filter;
	/** (2011h) Low-pass of the rates, or of the angles before they are differentiated. */
	struct filter_config rate_filter;
	struct latency_config latency; /* (2031h) */
	struct fusion_config fusion;   /* its lever arm and delay are those of estimator and latency */
	struct noise_config noise;     /* of the sensors (2020h) */
	struct estimator_config estimator;
	struct rest_config rest; /* (2040h) its thresholds and time also hold for the navigation */
	/** (2040h:11) s, >= 0, default 0: dwell time of the navigation's detector, such as of a stance in walking. A
	 * smaller one uses shorter stops, a larger one passes over turning points. 0: that of the preset. */
	double stance_s;
	struct position_config position;
};

enum {
	PIPELINE_UNCALIBRATED_GYRO = 1 << 0,
	PIPELINE_UNCALIBRATED_ACCEL = 1 << 1,
	PIPELINE_UNCALIBRATED_MAG = 1 << 2,
};

/* 1 sigma of the errors of chips as delivered, from data sheets (L3GD20, LSM303DLHC, LSM6DS33, MPU-6050): zero-rate
 * level 10 deg/s, sensitivity of the gyro 2 %, zero-g level 60 mg, sensitivity and alignment of the accelerometer 2 %;
 * a hard-iron offset of 50 uT, half the zero-gauss level of an LIS3MDL, and what a board's supply lines make. */
#define UNCALIBRATED_GYRO_RAD_S	 (10 * RAD_PER_DEG)
#define UNCALIBRATED_GYRO_SCALE	 0.02
#define UNCALIBRATED_ACCEL_M_S2	 0.6
#define UNCALIBRATED_ACCEL_SCALE 0.02
#define UNCALIBRATED_MAG_UT	 50.0

extern const struct pipeline_config PIPELINE_DEFAULTS;

/** Bits of pipeline_output.status, as published in the status word (210Fh:3). */
enum {
	PIPELINE_VALID = 1 << 0,      /* attitude and acceleration are usable */
	PIPELINE_REST = 1 << 1,	      /* the sensor is at rest */
	PIPELINE_MAG_USED = 1 << 2,   /* a magnetic field corrected the heading within the last second */
	PIPELINE_TIME_LIMIT = 1 << 3, /* the longest integration time has passed: position is held */
	PIPELINE_GAP = 1 << 4,	      /* samples were missing just before this one */
	PIPELINE_UNSURE = 1 << 5,     /* 1 sigma of the position exceeds its limit */
	PIPELINE_ASSUMED = 1 << 6,    /* a standstill is assumed against the estimated velocity */
	PIPELINE_DISAGREES = 1 << 7,  /* the magnetic field does not turn as the gyro says, and is not used */
	/* bits 8 to 13 are the gateway's (gateway/status.h) */
	PIPELINE_VIBRATION = 1 << 14, /* vibration or clipping may falsify the force, and the sigmas are larger */
};

struct pipeline_output {
	uint64_t t_us;
	struct vec3 force_b_m_s2; /* specific force, calibrated, not filtered */
	struct vec3 mag_b_uT;	  /* calibrated field, the last one known */
	/* angular rate and acceleration as used for the lever arm: filtered, from the gyro less its estimated errors,
	 * or from the attitude, as configured */
	struct vec3 rate_b_rad_s, alpha_b_rad_s2;
	struct quat q_nb;
	/* roll, pitch, yaw: aerospace z-y'-x'' of q_nb, yaw from east, counter-clockwise */
	struct vec3 angles_rad;
	/* of the reference point, without gravity; the object's axes are those at the instant of the rates */
	struct vec3 accel_b_m_s2;
	struct vec3 accel_n_m_s2; /* the same, global frame */
	struct vec3 velocity_n_m_s;
	struct vec3 position_n_m;
	/* by navigation only, else 0: from one standstill to the next, and 1 sigma of all */
	struct vec3 displacement_n_m, displacement_sigma_m;
	struct navigation_sigma sigma;
	struct gyro_errors gyro_errors; /* estimated by the fusion, and taken off the rates */
	/* vibration of the specific force (RMS), and samples at the end of the sensors' ranges (model/vibration.h) */
	double vibration_m_s2;
	uint32_t clipped_accel, clipped_gyro;
	double accel_delay_s; /* of the acceleration filter, by which the accelerations are older than t_us */
	unsigned status;
};

struct pipeline {
	struct pipeline_config config;
	struct estimator_config last_estimator; /* of the sample before */
	double rate_hz;
	double accel_delay_s; /* of the acceleration filter */
	/* PRIVATE: the state of each step */
	struct calibration calibration;
	struct differentiator3 accel_change;
	struct filter3 accel_filter;
	struct fusion fusion;	 /* its attitude is published */
	struct fusion reference; /* FUSION_KALMAN, whenever that is another one: for the navigation, sigma and status */
	struct rates rates;
	struct rates_variance rates_variance; /* of the source of rates in use */
	struct auto_correction auto_correction, auto_change;
	double change_of_white; /* variance of accel_change by white noise of variance 1 */
	struct rest rest;
	struct glitch gyro_glitch, accel_glitch;
	struct quantisation accel_steps;
	struct vibration vibration;
	struct warming warming;
	struct position position;
	uint64_t last_t_us;
	struct vec3 last_gyro_b_rad_s;
	bool started; /* there is a sample before this one */
	bool primed;  /* and the filters may continue from it */
	/* before the first attitude: since the filters began, and the mean force of these samples */
	double starting_s;
	int start_samples;
	struct vec3 start_force_b_m_s2;
	bool north_found; /* with the last sample */
	struct vec3 mag_b_uT;
	double since_mag_s;
	uint32_t gaps; /* intervals longer than PIPELINE_GAP_INTERVALS sampling intervals; the filters go on over those
			* up to GAP_S */
	uint32_t refused;     /* samples not used: see pipeline_step() */
	uint32_t implausible; /* outputs not published: see pipeline_step() */
	struct {
		double rate_rad_s, alpha_rad_s2, force_m_s2;
	} most; /* the largest lengths measured so far */
	struct pipeline_output last_good;
};

enum { PIPELINE_GAP_INTERVALS = 10 };

/** 0, or -EINVAL with *p untouched when a field of the configuration is out of range (see above and each
 * step's header). */
int pipeline_init(struct pipeline *p, const struct pipeline_config *config, double rate_hz);

/** From now on the path of each movement that ends is written to smoother->last (position mode 2); NULL: nowhere. The
 * caller owns the smoother, which serves one pipeline only. */
void pipeline_smooth(struct pipeline *p, struct smoother *smoother);

/** A new configuration between two samples. Attitude, velocity and position are kept as far as physics allows. A filter
 * starts again (primed with its last output, without a step) only when its own parameters changed. 0, or -EINVAL as
 * pipeline_init(). */
int pipeline_configure(struct pipeline *p, const struct pipeline_config *config);

/** One sample. 0, or -EINVAL when the sample was refused (counted; *out untouched): a value that is not finite or
 * beyond what any sensor measures (1000 rad/s, 100 km/s^2, 1 T), or a time that does not increase.
 *
 * After a gap the filters start again from this sample, and velocity and position stay as they were before it. The
 * attitude is carried over by the gyro, or, after more than a second, initialised from this sample (without a
 * magnetometer the old heading is kept). A sample marked SAMPLE_DISCONTINUITY starts everything over.
 *
 * A sample far from those before and after it, which agree, is published but not integrated (glitch.h).
 *
 * The first attitude takes the accelerometer for up, less the lever arm's share: if that is large (2 m/s^2), it is
 * valid only after 0.05 s or five samples, when the angular acceleration is known.
 *
 * A first force that differs from gravity by 5 m/s^2 or more is averaged over 0.5 s. An attitude whose tilt has a 1
 * sigma beyond 30 degrees is not valid.
 *
 * With Madgwick's or Mahony's filter attitude and acceleration are theirs. All else is the Kalman filter's, which runs
 * as well; sigma.attitude_rad and sigma.accel_m_s2 have the distance from it.
 *
 * An output that is not finite, a rate beyond three times the largest one measured, or an acceleration beyond three
 * times the largest force and gravity together (or these and the largest share of the lever arm by the gyro, if that is
 * more) is not published: *out is the last good one without PIPELINE_VALID (counted), and the filters start again. */
int pipeline_step(struct pipeline *p, const struct imu_sample *sample, struct pipeline_output *out);

/* Aids: what another device measures, given between two samples. It holds at the time stamp of the last one. 0, or
 * -EINVAL with *p untouched: a value not finite or out of its range. Before there is an attitude the first two do
 * nothing. A discontinuity drops all aids. */

/** The velocity of the reference point, global frame, +-1000 m/s each, with a 1 sigma of 0.001..1000 m/s. In position
 * mode 2 it is a measurement of the navigation; in mode 1 it becomes the velocity. FUSION_KALMAN corrects its tilt by
 * it, too. The longest integration time starts again. */
int pipeline_aid_velocity(struct pipeline *p, struct vec3 v_n_m_s, double sigma_m_s);
/** The heading as yaw of pipeline_output.angles_rad, +-2 pi, with a 1 sigma of 0.0001..pi: a measurement of the fusion
 * (fusion_aid_yaw()). The north of its frame may differ from the magnetic one. */
int pipeline_aid_yaw(struct pipeline *p, double yaw_rad, double sigma_rad);
/** Sets the attitude, a quaternion of length 1 within a tenth. The velocity turns with the object, the position stays.
 * From then on north is where the magnetic field points to in it. */
int pipeline_reset_attitude(struct pipeline *p, struct quat q_nb);

/** Velocity and position to zero (2040h reset command). */
void pipeline_reset_position(struct pipeline *p);

#endif
