/* model/identify/calibrate_magnetometer.h
 * Hard iron (bias) and soft iron (matrix) of the magnetometer, including its own offset, scale and cross-axis errors,
 * from turning it about all axes in a homogeneous field. An ellipsoid is fitted to the measured vectors, which are
 * thinned out to an even spacing so that time spent in one attitude does not add weight: first a quadric, then a robust
 * geometric fit (model/identify/ellipsoid.h; the matrix is symmetric, because the rotation against the other triads is
 * not observable). corrected = matrix * (raw - bias), as 2052h. */
#ifndef MODEL_IDENTIFY_CALIBRATE_MAGNETOMETER_H
#define MODEL_IDENTIFY_CALIBRATE_MAGNETOMETER_H

#include "model/identify/calibrate.h"
#include "model/calibration.h"

enum { CALIBRATE_POINTS_MAX = 200 };

struct calibrate_magnetometer_config {
	/* Local field strength in uT, 22 to 67 on Earth: the length of corrected vectors. 0 (default): the mean radius
	 * of the ellipsoid, i.e. the magnetometer's own scale is believed. Only the length depends on it, not the
	 * heading. */
	double field_uT;
	/* false: end as soon as the coverage suffices (the device); true: use every sample until _finish() (a log). */
	bool use_all;
	/* Time after which an unfinished calibration gets its verdict, above 0; INFINITY: never. */
	double patience_s;
};

struct calibrate_magnetometer_result {
	struct triad_calibration calibration;
	double field_uT;	   /* length of corrected vectors */
	double residual;	   /* RMS error of their length, as a share of field_uT */
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
	struct vec3 recent[2]; /* the last two samples, for the removal of spikes */
	int recent_count;
	uint64_t last_t_us, elapsed_us, solved_us; /* time stamp; time since the start: now, at the last solution */
	bool started;
};

void calibrate_magnetometer_init(struct calibrate_magnetometer *c, const struct calibrate_magnetometer_config *config);
enum calibrate_verdict calibrate_magnetometer_step(struct calibrate_magnetometer *c, const struct imu_sample *raw);
/** Call after the last sample of a log. */
enum calibrate_verdict calibrate_magnetometer_finish(struct calibrate_magnetometer *c);
/** The angle from a side (calibrate_side()) to the nearest direction in which the field has been, seen from the centre
 * of all of them; PI: there is none. */
double calibrate_magnetometer_gap_rad(const struct calibrate_magnetometer *c, int side);
/** The side along which the field has to be next, the farthest one from all of these; 0: any. */
int calibrate_magnetometer_next(const struct calibrate_magnetometer *c);
/** 0..1, the coverage as a share of the coverage wanted. */
double calibrate_magnetometer_progress(const struct calibrate_magnetometer *c);

#endif
