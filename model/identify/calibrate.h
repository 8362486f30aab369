/* model/identify/calibrate.h
 * What the calibrations share: the verdict, and blocks of rest. Each calibration takes raw samples (sensor axes, not
 * calibrated) one by one, holds a bounded amount of them, and ends by itself with a verdict (the device), or is ended by
 * its _finish() (a log). Pure, no heap. */
#ifndef MODEL_IDENTIFY_CALIBRATE_H
#define MODEL_IDENTIFY_CALIBRATE_H

#include "model/sample.h"

/** What has come of a calibration. Also the value of 2061h:4. */
enum calibrate_verdict {
	CALIBRATE_COLLECTING = 0,
	CALIBRATE_GOOD = 1, /* the result may be used; each other verdict refuses it */
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

/** One line for people: what is wrong and what to do. */
const char *calibrate_text(enum calibrate_verdict verdict);

/** Flicker noise of bias instability B moves the bias by about 1.5 B in the five minutes after a mean over ten seconds:
 * the variance of the difference is 2 B^2 / pi ln(300 / 10). It counts in every sigma of a bias. */
#define CALIBRATE_DRIFT 1.5

/** A quarter of a second of samples, averaged. */
struct calibrate_block {
	unsigned samples, mag_samples, temperature_samples;
	double end_s; /* since the first sample of all */
	struct vec3 gyro_rad_s, accel_m_s2;
	struct vec3 mag_uT;	 /* with mag_samples > 0 */
	double temperature_degC; /* with temperature_samples > 0 */
};

/** How still is still: norm over the axes of the standard deviations inside a block, and distance of a block's mean from
 * the slow mean (2 s) of the blocks before. A constant bias is no motion. */
struct calibrate_stillness {
	double gyro_rad_s, accel_m_s2;
};

/** The sensor lies or is clamped: 1 deg/s, 0.15 m/s^2. Held in a hand: 5 deg/s, 0.4 m/s^2. */
extern const struct calibrate_stillness CALIBRATE_LYING, CALIBRATE_HELD;

struct calibrate_rest {
	struct calibrate_stillness stillness;
	struct calibrate_block block; /* after CALIBRATE_REST_BLOCK */
	/* PRIVATE */
	struct calibrate_block sum, pending;
	struct vec3 gyro_squares, accel_squares, gyro_mean, accel_mean;
	uint64_t last_t_us, block_t_us, elapsed_us;
	unsigned run; /* still blocks in a row */
	bool started;
};

enum calibrate_rest_event {
	CALIBRATE_REST_NOTHING,
	CALIBRATE_REST_BLOCK, /* `block` is one more of this rest: the blocks before and after it were still, too */
	CALIBRATE_REST_ENDED, /* and it had blocks */
};

void calibrate_rest_init(struct calibrate_rest *rest, const struct calibrate_stillness *stillness);
enum calibrate_rest_event calibrate_rest_step(struct calibrate_rest *rest, const struct imu_sample *raw);
/** Seconds since the first sample, gaps left out. */
double calibrate_rest_time_s(const struct calibrate_rest *rest);

#endif
