#include "model/math/differentiator.h"
#include "model/math/units.h"

/* Of the sampling rate. By judgement: beyond it the derivative is nearly that of a parabola through three samples. */
static const double CUTOFF_MOST = 0.3;

/* Share of the sampling interval by which an interval may differ until it has gains of its own. By judgement: the poles
 * differ little, and the gains of most samples need no exponentials. */
static const double UNEVEN = 0.3;

/* Compares the characteristic polynomial z^3 + p1 z^2 + p2 z + p3 of the wanted poles with that of the observer. */
static void find_gains(double gain[3], double cutoff_hz, double dt_s)
{
	double w = 2 * PI * fmin(cutoff_hz * dt_s, CUTOFF_MOST);
	double real = exp(-w), radius = exp(-w / 2), pair = 2 * radius * cos(w * sqrt(3) / 2);
	double p1 = -(pair + real), p2 = radius * radius + pair * real;
	double p3 = -radius * radius * real;

	gain[0] = 1 + p3;
	gain[2] = 1 + p1 + p2 + p3;
	gain[1] = 3 + p1 - gain[0] - gain[2] / 2;
}

void differentiator3_tune(struct differentiator3 *d, double cutoff_hz, double rate_hz)
{
	d->cutoff_hz = cutoff_hz;
	d->rate_hz = rate_hz;
	find_gains(d->gain, cutoff_hz, 1 / rate_hz);
}

void differentiator3_prime(struct differentiator3 *d, struct vec3 value)
{
	d->value = value;
	d->first = d->second = (struct vec3){0, 0, 0};
}

struct vec3 differentiator3_step(struct differentiator3 *d, struct vec3 value, double dt_s)
{
	struct vec3 first = vec3_add(d->first, vec3_scale(dt_s, d->second));
	struct vec3 middle = vec3_add(d->first, vec3_scale(dt_s / 2, d->second));
	struct vec3 predicted = vec3_add(d->value, vec3_scale(dt_s, middle));
	struct vec3 error = vec3_sub(value, predicted);
	double own[3], *gain = d->gain;

	if (!(fabs(dt_s * d->rate_hz - 1) < UNEVEN)) {
		find_gains(own, d->cutoff_hz, dt_s);
		gain = own;
	}
	d->value = vec3_add(predicted, vec3_scale(gain[0], error));
	d->first = vec3_add(first, vec3_scale(gain[1] / dt_s, error));
	d->second = vec3_add(d->second, vec3_scale(gain[2] / (dt_s * dt_s), error));
	return d->first;
}
