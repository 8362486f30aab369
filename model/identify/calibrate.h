/* model/identify/calibrate.h
 * What the calibrations share: the verdict, and the detection of rests. A calibration is fed raw samples (sensor axes,
 * not calibrated) one by one and keeps a bounded summary of them. On the device it ends by itself, with a verdict; with
 * a log its _finish() ends it after the last sample. Pure, no heap. */
#ifndef MODEL_IDENTIFY_CALIBRATE_H
#define MODEL_IDENTIFY_CALIBRATE_H

#include "model/sample.h"

/** Outcome of a calibration. Also the value of 2061h:4. */
enum calibrate_verdict {
	CALIBRATE_COLLECTING = 0,
	CALIBRATE_GOOD = 1, /* the result can be used; every later verdict refuses it */
	CALIBRATE_MOVED = 2,
	CALIBRATE_TURNED = 3,
	CALIBRATE_TOO_FEW_POSITIONS = 4,
	CALIBRATE_POOR_COVERAGE = 5,
	CALIBRATE_LARGE_RESIDUAL = 6,
	CALIBRATE_NO_ELLIPSOID = 7,
	CALIBRATE_IMPLAUSIBLE = 8,
	CALIBRATE_FACES_TURNED = 9,
	CALIBRATE_NO_MAGNETOMETER = 10,
	CALIBRATE_NO_TEMPERATURE = 11,
	CALIBRATE_SMALL_TEMPERATURE_SPAN = 12,
	CALIBRATE_SENSOR_LOST = 13,
	CALIBRATE_ABORTED = 14,
	CALIBRATE_VERDICTS
};

/** Directions in sensor axes by which a calibration says what is missing: 1 +x, 2 -x, .. 6 -z, then the corners
 * 7 +x+y+z, 8 -x+y+z, 9 +x-y+z, .. 14 -x-y-z. */
enum { CALIBRATE_FACES = 6, CALIBRATE_SIDES = 14 };
/** Not of unit length for corners. */
struct vec3 calibrate_side(int number);
/** "+x", "the corner +x +y +z"; 0 or an unknown number: "any new side". */
const char *calibrate_side_text(int number);
/** The angle from side `number` to the nearest of these vectors (origin: centre); PI: there is none. */
double calibrate_gap_rad(int number, const struct vec3 *vectors, int count, struct vec3 centre);

/** One line of text: what is wrong and what to do. */
const char *calibrate_text(enum calibrate_verdict verdict);

/** Change of a bias after its calibration, in units of the bias instability B; part of the sigma of every bias. For
 * flicker noise, the difference between a mean over 10 s and the bias 300 s later has the variance 2 B^2 / pi ln(300 /
 * 10), whose root is 1.5 B. */
#define CALIBRATE_DRIFT 1.5

/** Length of a block. Short against a rest of some seconds, long against the period of a hand's tremor (8 to 12 Hz). */
#define CALIBRATE_BLOCK_S 0.25

/** Mean of the samples of CALIBRATE_BLOCK_S. */
struct calibrate_block {
	unsigned samples, mag_samples, temperature_samples;
	double end_s; /* since the first sample of the calibration */
	struct vec3 gyro_rad_s, accel_m_s2;
	struct vec3 mag_uT;	 /* with mag_samples > 0 */
	double temperature_degC; /* with temperature_samples > 0 */
};

/** Limits below which a block counts as rest, for both of: the standard deviation inside the block (root of the sum of
 * the variances of the axes), and the distance of the block's mean from the mean of the blocks before it (time
 * constant 2 s). A constant bias is therefore not mistaken for motion. Smaller: quiet rests only; larger: vibration
 * and slow turns pass. */
struct calibrate_stillness {
	double gyro_rad_s, accel_m_s2;
};

/** LYING: put down or clamped, 1 deg/s and 0.15 m/s^2; three and six times the noise of the supported chips at 100 Hz.
 * HELD: in a hand, 5 deg/s and 0.4 m/s^2. */
extern const struct calibrate_stillness CALIBRATE_LYING, CALIBRATE_HELD;

struct calibrate_rest {
	struct calibrate_stillness stillness;
	struct calibrate_block block; /* valid after CALIBRATE_REST_BLOCK */
	/* PRIVATE */
	struct calibrate_block sum, pending;
	struct vec3 gyro_squares, accel_squares, gyro_mean, accel_mean;
	uint64_t last_t_us, block_t_us, elapsed_us;
	unsigned run; /* consecutive blocks at rest */
	bool started;
};

enum calibrate_rest_event {
	CALIBRATE_REST_NOTHING,
	CALIBRATE_REST_BLOCK, /* `block` belongs to a rest: the blocks before and after it were at rest as well */
	CALIBRATE_REST_ENDED, /* a rest that had at least one block is over */
};

void calibrate_rest_init(struct calibrate_rest *rest, const struct calibrate_stillness *stillness);
enum calibrate_rest_event calibrate_rest_step(struct calibrate_rest *rest, const struct imu_sample *raw);
/** Seconds since the first sample, not counting gaps of more than 0.5 s. */
double calibrate_rest_time_s(const struct calibrate_rest *rest);

#endif
