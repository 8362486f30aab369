/* model/rates.h
 * Angular rate and angular acceleration of the object, from the gyro and from the change of attitude (the paper's way:
 * its filtered angles differentiated). Both always run, so that a switch between them (2002h) has no transient.
 * Filtering and differentiating commute, so the attitude is differentiated before the low-pass: the rotation between
 * two samples has neither a wrap nor a gimbal lock.
 *
 * Both outputs are of the instant of the sample: the delay of the low-pass is compensated by the angular acceleration,
 * whose differentiator has none. */
#ifndef MODEL_RATES_H
#define MODEL_RATES_H

#include "model/math/differentiator.h"
#include "model/math/filter.h"
#include "model/math/quat.h"

enum rate_source { RATES_FROM_GYRO = 0, RATES_FROM_ANGLES = 1 };
enum { RATE_SOURCES = 2 };

struct body_rates {
	struct vec3 omega_b_rad_s, alpha_b_rad_s2;
};

struct rates {
	struct body_rates out[RATE_SOURCES];
	/* PRIVATE */
	struct filter3 filter[RATE_SOURCES];
	struct differentiator3 differentiator[RATE_SOURCES];
	struct quat q_nb;
	double delay_s; /* of the filter */
	double close_s, since_s;
};

/** 0, or -EINVAL as filter3_init(). */
int rates_init(struct rates *r, const struct filter_config *config, double rate_hz);
/** The new filter continues from the last output, the differentiator from its state. */
int rates_configure(struct rates *r, const struct filter_config *config, double rate_hz);
/** The state after a long turn at this constant rate. */
void rates_prime(struct rates *r, struct vec3 gyro_b_rad_s, struct quat q_nb);
/** One sample, dt_s > 0 after the one before. One within a quarter of the sampling interval leaves the output as it
 * is. */
void rates_step(struct rates *r, struct vec3 gyro_b_rad_s, struct quat q_nb, double dt_s);

#endif
