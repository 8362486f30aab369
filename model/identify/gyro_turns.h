/* model/identify/gyro_turns.h
 * Matrix of the gyro (scale factors, cross-axis terms, rotation against the accelerometer) from the turns between
 * rests: what the gyro says of a turn must carry gravity, as the accelerometer measured it before, to what it measures
 * after. Both triads have the axes of the accelerometer afterwards. Method: D. Tedaldi, A. Pretto, E. Menegatti, "A
 * robust and easy to implement method for IMU calibration without external equipments", ICRA 2014, by Gauss-Newton,
 * with the error of the bias as three more unknowns. Pure, no heap. */
#ifndef MODEL_IDENTIFY_GYRO_TURNS_H
#define MODEL_IDENTIFY_GYRO_TURNS_H

#include <stdbool.h>

#include "model/calibration.h"
#include "model/identify/calibrate.h"

/* PARTS: of 0.1 s, 100 s of turns in all. */
enum { GYRO_TURNS_MAX = 32, GYRO_TURNS_PARTS = 1024, GYRO_TURNS_BLOCKS = 4 };

struct gyro_turns_result {
	bool found;	     /* false: too few turns, or the matrix is less certain than 0.2 % */
	double matrix[3][3]; /* of raw less bias, as 2050h */
	double sigma;	     /* 1 sigma of its least certain element, from the residual */
	int turns;
};

struct gyro_turns { /* PRIVATE */
	struct gyro_part {
		struct vec3 angle_rad; /* rotation vector, by the raw gyro less bias_rad_s */
		double s;
	} part[GYRO_TURNS_PARTS];
	struct gyro_turn {
		int end; /* its last part is the one before; it begins where the one before ends */
		struct vec3 before_m_s2, after_m_s2; /* raw: the last second of one rest, the first of the next */
	} turn[GYRO_TURNS_MAX];
	int turns, parts; /* parts: with those of the turn that goes on */
	int kept;	  /* parts before the last block */
	bool integrating;
	uint64_t start_us, last_us;
	struct vec3 gyro_rad_s; /* of the last sample */
	struct quat q;		/* of the part that goes on */
	double s;
	struct vec3 bias_rad_s;		      /* mean of the first rest */
	struct vec3 force[GYRO_TURNS_BLOCKS]; /* of the rest: block i at i % GYRO_TURNS_BLOCKS */
	unsigned blocks;		      /* of the rest */
	bool moved;			      /* since this rest */
	bool first, after_turn;		      /* it is the first one; the last turn ended with it */
};

void gyro_turns_init(struct gyro_turns *t);
/** Each raw sample, before what the detection of rests says of it. One that is saturated spoils its turn. */
void gyro_turns_sample(struct gyro_turns *t, const struct imu_sample *raw);
/** CALIBRATE_REST_BLOCK */
void gyro_turns_block(struct gyro_turns *t, const struct calibrate_block *block);
/** CALIBRATE_REST_ENDED */
void gyro_turns_moved(struct gyro_turns *t);
/** `accel`: the calibration of the accelerometer. */
struct gyro_turns_result gyro_turns_solve(const struct gyro_turns *t, const struct triad_calibration *accel);

#endif
