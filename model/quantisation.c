#include "model/quantisation.h"

#include <math.h>

/* Changes of an axis after which its smallest one is a step. By judgement: a second of a slow motion. */
enum { CHANGES = 20 };
/* s, memory of the mean square of the changes. By judgement: short against a motion, long against a vibration. */
static const double MEMORY_S = 0.5;
/* By how much the error falls with the square of the values' sigma in steps. Simulated: with noise of 0 to 0.6 steps
 * before the steps, and a value anywhere between them, the error is below 2.3 sigma of this. */
static const double DITHER = 12;

static void follow_axis(struct quantisation *q, int i, double value, double share)
{
	double change = fabs(value - q->last[i]);

	q->last[i] = value;
	q->change2[i] += share * (change * change - q->change2[i]);
	if (change == 0)
		return;
	if (q->changes[i] == 0 || change < q->step[i])
		q->step[i] = change;
	q->changes[i] += q->changes[i] < CHANGES;
}

void quantisation_step(struct quantisation *q, struct vec3 value, double dt_s)
{
	const double axes[3] = {value.x, value.y, value.z};

	for (int i = 0; i < 3; i++)
		if (q->known)
			follow_axis(q, i, axes[i], dt_s / (MEMORY_S + dt_s));
		else
			q->last[i] = axes[i];
	q->known = true;
}

double quantisation_variance(const struct quantisation *q)
{
	double most = 0;

	for (int i = 0; i < 3; i++) {
		double step2 = q->step[i] * q->step[i];

		if (q->changes[i] == CHANGES)
			most = fmax(most, step2 / 12 * exp(-DITHER * q->change2[i] / 2 / step2));
	}
	return most;
}
