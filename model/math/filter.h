/* model/math/filter.h
 * Causal low-pass filters for three channels at once: Butterworth (bilinear transform, pre-warped, cascaded
 * second-order sections) and the paper's FIR (order 10, Chebyshev window of 30 dB, cut-off 0.6 of the Nyquist
 * frequency, unit gain at DC). Primed with the first sample: no start-up transient. */
#ifndef MODEL_MATH_FILTER_H
#define MODEL_MATH_FILTER_H

#include "model/math/vec3.h"

enum filter_type { FILTER_OFF = 0, FILTER_BUTTERWORTH = 1, FILTER_SEED_FIR = 2 };

enum { FILTER_ORDER_MAX = 8, FILTER_SEED_FIR_ORDER = 10 };

struct filter_config {
	/** Default Butterworth for the rates, off for the acceleration. The FIR has a fixed order and cut-off. */
	enum filter_type type;
	/** 1..8, default 2: order of the Butterworth filter. A smaller one has less delay, a larger one a steeper
	 * slope. */
	unsigned order;
	/** Hz, > 0, default 40: -3 dB of the Butterworth filter. A smaller one passes less noise with more delay (0.22
	 * / cut-off at order 2). At or above 0.45 of the sampling rate the filter passes all. */
	double cutoff_hz;
};

struct filter3 {
	struct filter_config config;
	int sections; /* second-order sections in use; 0: pass-through */
	double b[FILTER_ORDER_MAX / 2][3], a[FILTER_ORDER_MAX / 2][2];
	struct vec3 z[FILTER_ORDER_MAX / 2][2];
	double h[FILTER_SEED_FIR_ORDER + 1];
	struct vec3 x[FILTER_SEED_FIR_ORDER + 1];
	int next, primed;
	struct vec3 out; /* the last output */
};

/** 0, or -EINVAL: unknown type, order not 1..8, cut-off not above 0, rate not above 0. */
int filter3_init(struct filter3 *f, const struct filter_config *config, double rate_hz);
struct vec3 filter3_step(struct filter3 *f, struct vec3 in);
/** The state after a long constant input `value`. */
void filter3_prime(struct filter3 *f, struct vec3 value);
/** The state as if every input so far had been greater by `offset`. */
void filter3_shift(struct filter3 *f, struct vec3 offset);
/** Group delay at DC, seconds. */
double filter3_delay_s(const struct filter3 *f, double rate_hz);

#endif
