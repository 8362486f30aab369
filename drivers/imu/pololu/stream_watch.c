#include "drivers/imu/pololu/board_parts.h"
#include "model/math/units.h"

#include <errno.h>
#include <math.h>

/* Noise of a quiet chip, as a share of the typical value in its data sheet. */
#define LEAST_NOISE 0.6
/* Probability of a false alarm per sample: equal samples by noise alone. At 400 Hz, in the worst case for all axes,
 * this is once in 80 years. */
#define FROZEN_CHANCE 1e-12

enum {
	SILENT_MS = 20,
	STOPPED_MS = 50,
	STOPPED_STUB_MS = 1000, /* a program writes the registers, and may be delayed */
	FROZEN_MS = 50,
	LAST_FROZEN_MS = 1000, /* if equal samples by noise may last longer, they are no fault */
	SATURATED_MS = 60,
};

/* The largest probability that the next value of an axis is the same digit. Noise behind a first-order low-pass is
 * correlated; the innovation of each sample has the remaining standard deviation. */
static double probability_of_same(const struct chip_setup *setup, double density, double digit)
{
	double correlation = exp(-2 * PI * setup->bandwidth_hz / setup->rate->hz);
	double sigma = LEAST_NOISE * density * sqrt(fmin(setup->bandwidth_hz, setup->rate->hz / 2)) *
		       sqrt(1 - correlation * correlation) / digit;

	return erf(0.5 / (sigma * sqrt(2)));
}

static unsigned samples_in(const struct stream *s, int ms)
{
	return (unsigned)ceil(1e-3 * ms * s->setup.rate->hz);
}

unsigned stream_same_limit(const struct stream *s)
{
	double log_probability = 0, n;

	for (size_t i = 0; i < s->chip->triad_count; i++) {
		const struct chip_triad *t = &s->chip->triads[i];
		double digit = s->setup.range[i]->step * (t->digit ? t->digit : 1);

		log_probability += 3 * log(probability_of_same(&s->setup, t->density, digit));
	}
	n = 1 + ceil(log(FROZEN_CHANCE) / log_probability);
	if (!(n <= samples_in(s, LAST_FROZEN_MS)))
		return 0;
	return (unsigned)fmax(n, samples_in(s, FROZEN_MS));
}

void stream_count_errors(struct board *b, struct stream *s, int result)
{
	int64_t t_ns = b->now_ns;

	if (result >= 0) {
		s->failures = 0;
		return;
	}
	b->health.bus_errors++;
	if (s->failures++ == 0)
		s->failing_ns = t_ns;
	if (s->failures >= 3 && t_ns - s->failing_ns >= SILENT_MS * BOARD_MS)
		stream_fail(b, s, IMU_FAULT_SILENT);
}

void stream_verify_next(struct board *b, struct stream *s)
{
	int result;

	/* not those of other banks, which would have to be selected for it */
	while (stream_expected(&s->registers, s->verify) < 0 || s->registers.at[s->verify].bank != 0)
		s->verify = (s->verify + 1) % s->registers.n;
	result = stream_verify(b, s, s->verify);
	if (result == -EBADMSG && (result = stream_verify(b, s, s->verify)) == -EBADMSG) {
		stream_fail(b, s, IMU_FAULT_CONFIGURATION);
		return;
	}
	s->verify = (s->verify + 1) % s->registers.n;
	s->verify_ns = b->now_ns + (STREAM_VERIFY_MS - 1) * BOARD_MS;
	stream_count_errors(b, s, result);
}

/* No new sample from the end of the last read with one to the start of the last read without one. */
static bool stopped(const struct stream *s)
{
	int64_t limit_ns =
		(s->setup.stub ? STOPPED_STUB_MS : STOPPED_MS) * BOARD_MS + (int64_t)(2e9 / s->setup.rate->hz);

	if (s->setup.stub && s->same_limit == 0) /* equal data may be new samples */
		return false;
	return s->none_ns - s->fresh_ns > limit_ns;
}

void stream_watch(struct board *b, struct stream *s)
{
	if (s->state == STREAM_DOWN)
		return;
	if (stopped(s))
		stream_fail(b, s, IMU_FAULT_STOPPED);
	else if (s->saturated == 0 && s->same_limit > 0 && s->same >= s->same_limit)
		stream_fail(b, s, IMU_FAULT_FROZEN);
	else if (s->saturated >= 4 && s->saturated >= samples_in(s, SATURATED_MS))
		stream_fail(b, s, IMU_FAULT_SATURATED);
}
