/* model/identify/lever_identification.h
 * Finds the lever arm r (reference point -> accelerometer) from motion, while it happens. What the accelerometer sees is
 *
 *   force = a_ref - g + alpha x r + omega x (omega x r) + bias
 *
 * where the acceleration a_ref of the reference point is zero (it is held still and the object turned about it) or comes
 * from outside (a robot's encoders, an optical reference).
 *
 * No attitude, no g and no magnetometer are needed, so a lever arm that is still unknown cannot spoil them: the gyro alone
 * turns everything into a frame that is almost inertial, where gravity is a constant and errors of the gyro let it drift
 * slowly. Constant and slope are eliminated from each window of a second, exactly as least squares would estimate them.
 * All terms go through one low-pass, alike, before they are compared: above it there is little but noise.
 *
 * Each window leaves the products of its terms (information form). They are kept window by window, neighbours put together
 * when there is no more room: the scatter between windows tells the uncertainty, however the residuals are correlated
 * inside them (K.-Y. Liang and S. Zeger, "Longitudinal data analysis using generalized linear models", Biometrika 73, 1986).
 *
 * An outside reference may come late. Its delay is one parameter more, by its first two derivatives. */
#ifndef MODEL_IDENTIFY_LEVER_IDENTIFICATION_H
#define MODEL_IDENTIFY_LEVER_IDENTIFICATION_H

#include <stdint.h>

#include "model/math/filter.h"
#include "model/math/quat.h"

enum lever_verdict { /* 0 is left for "none yet" */
	LEVER_FOUND = 1,
	LEVER_TOO_SHORT = 2,	/* less than LEVER_LEAST_WINDOWS windows */
	LEVER_NO_REFERENCE = 3, /* hardly any sample had the acceleration from outside */
	LEVER_TOO_SLOW = 4,	/* the object hardly turned */
	LEVER_BLIND_L = 5,	/* it turned about the axis l only, or almost: that says nothing of r along l */
	LEVER_BLIND_S = 6,
	LEVER_BLIND_T = 7,
	LEVER_NOT_HELD = 8,	/* too much is left over: the point moved, or the reference is another's */
	LEVER_UNSURE = 9,	/* all well, but not enough of it */
	LEVER_SENSOR_LOST = 10, /* said by the gateway */
};

/** One line for people: what is wrong, and what to do. */
const char *lever_verdict_text(enum lever_verdict verdict);

struct lever_identification_config {
	double rate_hz;	   /* of the samples, 25..10000 */
	double duration_s; /* of usable motion until progress is 100 %, 10..3600 */
	bool reference;	   /* a_ref comes from outside; else it is zero */
	/* The reference may be late by up to LEVER_DELAY_MAX_S, or early: estimate that. Without it, the time stamps are
	 * believed, and sigma says how much they would matter. */
	bool estimate_delay;
};

struct lever_estimate {
	enum lever_verdict verdict;
	unsigned progress_percent;
	struct vec3 lever_arm_b_m;
	struct vec3 noise_sigma_b_m; /* 1 sigma as the scatter of the windows shows it */
	struct vec3 sigma_b_m;	     /* with what cannot be seen there: see LEVER_POINT_SIGMA_M */
	double residual_m_s2;	     /* RMS of what is left over, below LEVER_CUTOFF_HZ */
	double delay_s; /* by which the reference is late, also where it was not to be heeded; 0 without one */
};

enum { LEVER_LEAST_WINDOWS = 10, LEVER_BLOCKS = 64, LEVER_STENCIL = 5 };

#define LEVER_WINDOW_S	  1.0
#define LEVER_CUTOFF_HZ	  8.0
#define LEVER_DELAY_MAX_S 0.02
/* The three accelerometers of a chip do not sense in one point. Estimates by each of them alone, from recorded trials,
 * differ by this (RMS). */
#define LEVER_POINT_SIGMA_M 0.0007
/* Scale factor errors that a calibration leaves. */
#define LEVER_SCALE_SIGMA 0.005

/* The terms: force, reference and two derivatives of it, alpha x + omega x omega x (of the three components of r), bias */
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

struct lever_block { /* products of the terms, each pair once */
	double product[LEVER_PRODUCTS];
	double samples;
};

struct lever_identification {
	struct lever_identification_config config;
	/* PRIVATE */
	struct lever_raw {
		struct vec3 gyro_b_rad_s, force_b_m_s2, ref_b_m_s2;
		struct quat q; /* object -> almost inertial frame */
	} raw[LEVER_STENCIL];  /* the last samples, for derivatives at the middle one */
	int raw_count;
	uint64_t last_t_us;
	struct filter3 filter[LEVER_TERMS];
	int settling; /* samples since the filters began */
	double dt_s;  /* of sampling, as the time stamps show it */
	/* the window under way: products, sum, and moment about its middle, of the terms */
	struct lever_block window;
	struct vec3 sum[LEVER_TERMS], moment[LEVER_TERMS];
	int window_count, window_size;
	struct lever_block block[LEVER_BLOCKS];
	int blocks, windows_per_block, last_block_windows;
	bool window_ended; /* with the last step */
	uint32_t windows, samples, without_reference;
};

/** 0, or -EINVAL with *id untouched: a field out of its range. */
int lever_identification_init(struct lever_identification *id, const struct lever_identification_config *config);

/** One calibrated sample, the gyro without its bias. `ref_b_m_s2`: acceleration of the reference point without gravity,
 * object frame, NULL where it is not known (always, when it is held still). A gap in time, or in the reference, begins a
 * new window; so does anything not finite. */
void lever_identification_step(struct lever_identification *id, uint64_t t_us, struct vec3 gyro_b_rad_s,
	struct vec3 force_b_m_s2, const struct vec3 *ref_b_m_s2);

/** The motion jumps here, or the sample was not to be used: a new window. */
void lever_identification_break(struct lever_identification *id);

/** A window has ended with the last step: there is news for lever_identification_estimate(). */
bool lever_identification_news(const struct lever_identification *id);

/** What is known by now. */
struct lever_estimate lever_identification_estimate(const struct lever_identification *id);

#endif
