/* model/identify/lever_identification.h
 * Online identification of the lever arm r (reference point -> accelerometer) from motion. The accelerometer measures
 *
 *   force = a_ref - g + alpha x r + omega x (omega x r) + bias
 *
 * where the acceleration a_ref of the reference point is zero (it is held still and the object turned about it) or is
 * measured by another device (a robot's encoders, an optical system): the reference.
 *
 * Neither attitude nor g nor magnetometer are needed, so an unknown lever arm cannot disturb them. The gyro alone
 * rotates all terms into an almost inertial frame, in which gravity is constant but for a slow drift by the errors of
 * the gyro. A constant and a slope are eliminated from each window of 1 s, with the same result as if least squares had
 * estimated them. All terms pass through the same low-pass before they are compared, because above it there is little
 * but noise.
 *
 * Each window contributes the products of its terms (information form). They are stored per block of windows, and pairs
 * of blocks are merged when the memory is full. The uncertainty follows from the scatter between blocks, for any
 * correlation of the residuals inside a block (cluster-robust variance; K.-Y. Liang and S. Zeger, "Longitudinal data
 * analysis using generalized linear models", Biometrika 73, 1986).
 *
 * The delay of a reference is one more parameter, linearised with the first two derivatives of the reference. */
#ifndef MODEL_IDENTIFY_LEVER_IDENTIFICATION_H
#define MODEL_IDENTIFY_LEVER_IDENTIFICATION_H

#include <stdint.h>

#include "model/math/filter.h"
#include "model/math/quat.h"

enum lever_verdict { /* 0 is left for "none yet" */
	LEVER_FOUND = 1,
	LEVER_TOO_SHORT = 2,	/* fewer than LEVER_LEAST_WINDOWS windows */
	LEVER_NO_REFERENCE = 3, /* more than half of the samples had no reference */
	LEVER_TOO_SLOW = 4,	/* the angular rates were too small */
	LEVER_BLIND_L = 5,	/* (almost) all rotation was about the axis l: r along l is not observable */
	LEVER_BLIND_S = 6,
	LEVER_BLIND_T = 7,
	LEVER_NOT_HELD = 8, /* residual too large: the reference point moved, or the reference is of another motion */
	LEVER_UNSURE = 9,   /* good excitation and residual, but sigma is still too large */
	LEVER_SENSOR_LOST = 10, /* set by the gateway */
};

/** One line of text: what is wrong, and what to do. */
const char *lever_verdict_text(enum lever_verdict verdict);

struct lever_identification_config {
	/* Nominal sampling rate, 25..10000. The actual one is tracked from the time stamps. */
	double rate_hz;
	/* Usable motion until progress is 100 %, 10..3600; 30 in the gateway. It changes nothing but the progress. */
	double duration_s;
	/* true: a_ref is passed with each sample; false: it is zero. */
	bool reference;
	/* true: estimate the delay of the reference, within +-LEVER_DELAY_MAX_S (it costs some certainty of r); false:
	 * use its time stamps unchanged, and add to sigma what the estimated delay would change. */
	bool estimate_delay;
};

struct lever_estimate {
	enum lever_verdict verdict;
	unsigned progress_percent;
	struct vec3 lever_arm_b_m;
	struct vec3 noise_sigma_b_m; /* 1 sigma from the scatter between blocks */
	struct vec3 sigma_b_m; /* and with what that does not show: LEVER_POINT_SIGMA_M, LEVER_SCALE_SIGMA, delay */
	double residual_m_s2;  /* RMS of the residual below LEVER_CUTOFF_HZ */
	double delay_s;	       /* of the reference, > 0: late; even without estimate_delay; 0: no reference */
};

enum { LEVER_LEAST_WINDOWS = 10, LEVER_BLOCKS = 64, LEVER_STENCIL = 5 };

/* Short enough that the drift of gravity in the almost inertial frame is a straight line, long enough for one swing by
 * hand. */
#define LEVER_WINDOW_S 1.0
/* Chosen: above it alpha, a derivative of the gyro, is mostly noise; motion by hand is mostly below 5 Hz. */
#define LEVER_CUTOFF_HZ 8.0
/* The second-order expansion of the delay holds to 2 % of a 4 Hz oscillation at this value. */
#define LEVER_DELAY_MAX_S 0.02
/* The accelerometers of a chip do not sense at one point: RMS difference of estimates from single axes, recorded
 * trials. */
#define LEVER_POINT_SIGMA_M 0.0007
/* Scale factor error that remains after a calibration, of gyro and accelerometer together. */
#define LEVER_SCALE_SIGMA 0.005

/* The terms: force, reference and its two derivatives, (alpha x + omega x omega x) of the three unit vectors, bias */
enum {
	LEVER_FORCE = 0,
	LEVER_REFERENCE = 1,
	LEVER_REFERENCE_DOT = 2,
	LEVER_REFERENCE_DDOT = 3,
	LEVER_ARM = 4,
	LEVER_BIAS = 7,
	LEVER_TERMS = 10,
	LEVER_PRODUCTS = LEVER_TERMS * (LEVER_TERMS + 1) / 2
};

struct lever_block { /* sums of the products of the terms, each pair once */
	double product[LEVER_PRODUCTS];
	double samples;
};

struct lever_identification {
	struct lever_identification_config config;
	/* PRIVATE */
	struct lever_raw {
		struct vec3 gyro_b_rad_s, force_b_m_s2, ref_b_m_s2;
		struct quat q; /* object -> almost inertial frame */
	} raw[LEVER_STENCIL];  /* the last samples; derivatives are taken at the middle one */
	int raw_count;
	uint64_t last_t_us;
	struct filter3 filter[LEVER_TERMS];
	int settling; /* samples since the filters were initialised */
	double dt_s;  /* sampling interval, tracked from the time stamps */
	/* the current window: products of the terms, their sum, and their first moment about its middle */
	struct lever_block window;
	struct vec3 sum[LEVER_TERMS], moment[LEVER_TERMS];
	int window_count, window_size;
	struct lever_block block[LEVER_BLOCKS];
	int blocks, windows_per_block, last_block_windows;
	bool window_ended; /* by the last step */
	uint32_t windows, samples, without_reference;
};

/** 0, or -EINVAL with *id untouched: a field is out of its range. */
int lever_identification_init(struct lever_identification *id, const struct lever_identification_config *config);

/** One calibrated sample, the gyro without its bias. `ref_b_m_s2`: acceleration of the reference point without gravity,
 * object frame, or NULL when it is not known; ignored unless config.reference. A gap in time or in the reference
 * starts a new window, and so does a value that is not finite. */
void lever_identification_step(struct lever_identification *id, uint64_t t_us, struct vec3 gyro_b_rad_s,
	struct vec3 force_b_m_s2, const struct vec3 *ref_b_m_s2);

/** Starts a new window: after a jump of the motion, or instead of a sample that must not be used. */
void lever_identification_break(struct lever_identification *id);

/** The last step completed a window, so lever_identification_estimate() has changed. */
bool lever_identification_news(const struct lever_identification *id);

/** The estimate from all windows so far; takes about 0.2 ms (tests/bench/bench_lever.c). */
struct lever_estimate lever_identification_estimate(const struct lever_identification *id);

#endif
