/* model/identify/calibrate_magnetometer.h
 * The magnetometer's hard iron (bias) and soft iron (matrix) with its own scale and cross-axis errors, from turning it
 * about all axes where the field is even: an ellipsoid through points kept evenly spaced, so that lingering in one
 * attitude weighs nothing; quadric fit, then a robust geometric one (model/identify/ellipsoid.h: the matrix is symmetric, a
 * rotation against the other triads stays unknown). corrected = matrix * (raw - bias), as 2052h. */
#ifndef MODEL_IDENTIFY_CALIBRATE_MAGNETOMETER_H
#define MODEL_IDENTIFY_CALIBRATE_MAGNETOMETER_H

#include "model/identify/calibrate.h"
#include "model/calibration.h"

enum { CALIBRATE_POINTS_MAX = 200 };

struct calibrate_magnetometer_config {
	double field_uT; /* local field strength: corrected vectors get that length; 0: the mean radius of the ellipsoid */
	bool whole;	 /* a log: use all of it, not only what suffices */
	double patience_s;
};

struct calibrate_magnetometer_result {
	struct triad_calibration calibration;
	double field_uT;	   /* length of corrected vectors */
	double residual;	   /* RMS of their length's error, as a part of the field */
	struct vec3 bias_sigma_uT; /* 1 sigma, from the residual and the geometry */
};

struct calibrate_magnetometer {
	struct calibrate_magnetometer_config config;
	struct calibrate_magnetometer_result result; /* with CALIBRATE_GOOD */
	enum calibrate_verdict verdict;
	double coverage; /* 0..1: see struct ellipsoid */
	/* PRIVATE */
	struct vec3 points[CALIBRATE_POINTS_MAX];
	int count;
	double spacing_uT;
	struct vec3 recent[2]; /* the last two samples */
	int recent_count;
	uint64_t last_t_us, elapsed_us, looked_us; /* since the start; the last look whether it suffices */
	bool started;
};

void calibrate_magnetometer_init(struct calibrate_magnetometer *c, const struct calibrate_magnetometer_config *config);
enum calibrate_verdict calibrate_magnetometer_step(struct calibrate_magnetometer *c, const struct imu_sample *raw);
/** No more samples. */
enum calibrate_verdict calibrate_magnetometer_finish(struct calibrate_magnetometer *c);
/** 0..1. */
double calibrate_magnetometer_progress(const struct calibrate_magnetometer *c);

#endif
