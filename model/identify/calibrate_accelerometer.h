/* model/identify/calibrate_accelerometer.h
 * Bias, scale factors and cross-axis terms of the accelerometer from rests in different positions, with gravity as the
 * reference. corrected = matrix * (raw - bias), as 2051h.
 *
 * CALIBRATE_SIX_FACES: in a fixture, level on each of its six faces in any order, so that each axis of the sensor
 * points up once and down once. The direction of gravity is known, so all twelve unknowns are observable, including the
 * rotation of the triad against the faces.
 *
 * CALIBRATE_FREE: without a fixture, in at least twelve positions. Only the magnitude of gravity is known. The rotation
 * of the triad against the other triads is not observable, so the matrix is symmetric (model/identify/ellipsoid.h).
 * Method: I. Skog and P. Handel, "Calibration of a MEMS inertial measurement unit", 2006, solved by
 * Levenberg-Marquardt.
 *
 * The turns from one position to the next give the matrix of the gyro, too, if they are about enough axes. On the
 * device the free positions go on for that to one on each side and corner, but no longer. */
#ifndef MODEL_IDENTIFY_CALIBRATE_ACCELEROMETER_H
#define MODEL_IDENTIFY_CALIBRATE_ACCELEROMETER_H

#include "model/identify/calibrate.h"
#include "model/identify/gyro_turns.h"
#include "model/calibration.h"

enum calibrate_positions { CALIBRATE_SIX_FACES, CALIBRATE_FREE };
enum {
	CALIBRATE_POSITIONS_MAX = 24,
	CALIBRATE_FREE_MIN = 12, /* nine unknowns, and three positions more for the residual */
};

struct calibrate_accelerometer_config {
	enum calibrate_positions positions;
	/* Local gravity, above 0; the gateway passes 2003h, 9.81. An error of 1 % is an error of 1 % in the scale
	 * factors. */
	double gravity_m_s2;
	/* Bias instability of the sensor, 0 or more (2020h). Larger: larger bias_sigma_m_s2; no influence on the
	 * result. */
	double bias_instability_m_s2;
	/* false: end as soon as the positions suffice (the device); true: use every sample until _finish() (a log). */
	bool use_all;
	/* Time after which an unfinished calibration gets its verdict, above 0; INFINITY: never. Smaller: the user is
	 * hurried; larger: an abandoned calibration blocks the command object longer. */
	double patience_s;
};

struct calibrate_accelerometer_result {
	struct triad_calibration calibration;
	double residual_m_s2; /* RMS per degree of freedom, of |corrected| - gravity (six faces: of the vector) */
	struct vec3 bias_sigma_m_s2;   /* 1 sigma, from residual, geometry and bias instability */
	double matrix_sigma;	       /* 1 sigma of the least certain element */
	double faces_turned_rad;       /* six faces: angle between the faces and the sensor's axes */
	double temperature_degC;       /* mean during the rests; NAN: not known */
	struct gyro_turns_result gyro; /* in the axes of the accelerometer */
};

struct calibrate_accelerometer {
	struct calibrate_accelerometer_config config;
	struct calibrate_accelerometer_result result; /* with CALIBRATE_GOOD */
	enum calibrate_verdict verdict;
	int positions;	 /* recorded so far */
	double coverage; /* 0..1: share of the faces; free: see struct ellipsoid, from ten positions on */
	/* PRIVATE */
	struct calibrate_rest rest;
	struct gyro_turns turns;
	struct calibrate_position {
		struct vec3 force_m_s2;
		unsigned blocks; /* 0: not recorded yet */
	} position[CALIBRATE_POSITIONS_MAX];
	/* the current rest: sum of its blocks, their number, index of its position (-1: none yet) */
	struct vec3 sum_m_s2;
	unsigned blocks;
	int at;
	double temperature_sum_degC;
	unsigned temperatures;
};

void calibrate_accelerometer_init(
	struct calibrate_accelerometer *c, const struct calibrate_accelerometer_config *config);
enum calibrate_verdict calibrate_accelerometer_step(struct calibrate_accelerometer *c, const struct imu_sample *raw);
/** Call after the last sample of a log. */
enum calibrate_verdict calibrate_accelerometer_finish(struct calibrate_accelerometer *c);
/** Number of positions that are needed. It becomes larger when the turns do not give the matrix of the gyro. */
int calibrate_accelerometer_wanted(const struct calibrate_accelerometer *c);
/** The angle from a side (calibrate_side()) up to the nearest position so far; PI: there is none. */
double calibrate_accelerometer_gap_rad(const struct calibrate_accelerometer *c, int side);
/** The side to turn up next, the farthest one from all positions so far; 0: any. */
int calibrate_accelerometer_next(const struct calibrate_accelerometer *c);

#endif
