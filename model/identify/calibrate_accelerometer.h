/* model/identify/calibrate_accelerometer.h
 * The accelerometer's bias, scale factors and cross-axis terms from rests in different positions, gravity being the
 * measure. corrected = matrix * (raw - bias), as 2051h.
 *
 * CALIBRATE_SIX_FACES: in a fixture, each face of which lies level, so that each axis of the sensor points up once and
 * down once, in any order. Gravity's direction is known: all twelve unknowns, the rotation of the triad against the
 * faces included.
 * CALIBRATE_FREE: without a fixture, twelve positions or more; only the length of gravity is known. How the triad is
 * turned against the sensor's other triads stays unknown; the matrix is symmetric (model/identify/ellipsoid.h). After I. Skog and
 * P. Handel, "Calibration of a MEMS inertial measurement unit", 2006, with Levenberg-Marquardt. */
#ifndef MODEL_IDENTIFY_CALIBRATE_ACCELEROMETER_H
#define MODEL_IDENTIFY_CALIBRATE_ACCELEROMETER_H

#include "model/identify/calibrate.h"
#include "model/calibration.h"

enum calibrate_positions { CALIBRATE_SIX_FACES, CALIBRATE_FREE };
enum { CALIBRATE_POSITIONS_MAX = 24, CALIBRATE_FACES = 6, CALIBRATE_FREE_LEAST = 12 };

struct calibrate_accelerometer_config {
	enum calibrate_positions positions;
	double gravity_m_s2;
	double bias_instability_m_s2; /* of the sensor (2020h): what no averaging takes away */
	bool whole;		      /* a log: use all of it, not only what suffices */
	double patience_s;	      /* that long without an answer: refused */
};

struct calibrate_accelerometer_result {
	struct triad_calibration calibration;
	double residual_m_s2;	     /* of |corrected| (six faces: of the vector), RMS per degree of freedom */
	struct vec3 bias_sigma_m_s2; /* 1 sigma, from residual, geometry and bias instability */
	double matrix_sigma;	     /* of the least certain element */
	double faces_turned_rad;     /* six faces: between the faces and the sensor's axes */
	double temperature_degC;     /* NAN: not known */
};

struct calibrate_accelerometer {
	struct calibrate_accelerometer_config config;
	struct calibrate_accelerometer_result result; /* with CALIBRATE_GOOD */
	enum calibrate_verdict verdict;
	int positions;	 /* so far */
	double coverage; /* 0..1: of the faces; free: see struct ellipsoid, once there are ten positions */
	/* PRIVATE */
	struct calibrate_rest rest;
	struct calibrate_position {
		struct vec3 force_m_s2;
		unsigned blocks; /* 0: not taken yet */
	} position[CALIBRATE_POSITIONS_MAX];
	struct vec3 sum_m_s2; /* of the rest that lasts */
	unsigned blocks;
	int at; /* its position; -1: none yet */
	double temperature_sum_degC;
	unsigned temperatures;
};

void calibrate_accelerometer_init(
	struct calibrate_accelerometer *c, const struct calibrate_accelerometer_config *config);
enum calibrate_verdict calibrate_accelerometer_step(struct calibrate_accelerometer *c, const struct imu_sample *raw);
/** No more samples. */
enum calibrate_verdict calibrate_accelerometer_finish(struct calibrate_accelerometer *c);
/** How many positions are asked for. */
int calibrate_accelerometer_wanted(const struct calibrate_accelerometer *c);
/** Which side to turn up next: 1 +x, 2 -x, .. 6 -z, then the corners 7 +x+y+z, 8 -x+y+z, 9 +x-y+z, .. 14 -x-y-z; 0: any.
 * The one that is farthest from all positions so far. */
int calibrate_accelerometer_next(const struct calibrate_accelerometer *c);

#endif
