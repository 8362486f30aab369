#include "model/rates.h"

#include <errno.h>
#include <string.h>

/* Sampling intervals. Samples closer together change neither the filters, which would take each for a whole interval,
 * nor the derivative of the attitude, whose corrections by the other sensors take no time. By judgement. */
static const double CLOSE = 0.25;

static void tune(struct rates *r, const struct filter_config *config, double rate_hz)
{
	r->close_s = CLOSE / rate_hz;
	r->delay_s = filter3_delay_s(&r->filter[0], rate_hz);
	double cutoff_hz = config->type == FILTER_BUTTERWORTH ? config->cutoff_hz : rate_hz;

	for (int i = 0; i < RATE_SOURCES; i++)
		differentiator3_tune(&r->differentiator[i], cutoff_hz, rate_hz);
}

int rates_init(struct rates *r, const struct filter_config *config, double rate_hz)
{
	struct filter3 filter;

	if (filter3_init(&filter, config, rate_hz) < 0)
		return -EINVAL;
	memset(r, 0, sizeof(*r));
	for (int i = 0; i < RATE_SOURCES; i++)
		r->filter[i] = filter;
	tune(r, config, rate_hz);
	r->q_nb = QUAT_IDENTITY;
	return 0;
}

int rates_configure(struct rates *r, const struct filter_config *config, double rate_hz)
{
	struct filter3 filter;

	if (filter3_init(&filter, config, rate_hz) < 0)
		return -EINVAL;
	for (int i = 0; i < RATE_SOURCES; i++)
		r->filter[i] = filter;
	tune(r, config, rate_hz);
	for (int i = 0; i < RATE_SOURCES; i++) {
		struct vec3 behind = vec3_scale(r->delay_s, r->out[i].alpha_b_rad_s2);

		filter3_prime(&r->filter[i], vec3_sub(r->out[i].omega_b_rad_s, behind));
	}
	return 0;
}

void rates_prime(struct rates *r, struct vec3 gyro_b_rad_s, struct quat q_nb)
{
	for (int i = 0; i < RATE_SOURCES; i++) {
		filter3_prime(&r->filter[i], gyro_b_rad_s);
		differentiator3_prime(&r->differentiator[i], gyro_b_rad_s);
		r->out[i] = (struct body_rates){.omega_b_rad_s = gyro_b_rad_s};
	}
	r->q_nb = q_nb;
	r->since_s = 0;
}

void rates_step(struct rates *r, struct vec3 gyro_b_rad_s, struct quat q_nb, double dt_s)
{
	struct quat turn = quat_multiply(quat_conjugate(r->q_nb), q_nb);

	r->since_s += dt_s;
	if (r->since_s < r->close_s)
		return;
	dt_s = r->since_s;
	r->since_s = 0;
	const struct vec3 in[RATE_SOURCES] = {
		[RATES_FROM_GYRO] = gyro_b_rad_s,
		[RATES_FROM_ANGLES] = vec3_scale(1 / dt_s, quat_to_rotation_vector(turn)),
	};

	for (int i = 0; i < RATE_SOURCES; i++) {
		struct vec3 omega = filter3_step(&r->filter[i], in[i]);
		struct vec3 alpha = differentiator3_step(&r->differentiator[i], in[i], dt_s);

		r->out[i] = (struct body_rates){vec3_add(omega, vec3_scale(r->delay_s, alpha)), alpha};
	}
	r->q_nb = q_nb;
}
