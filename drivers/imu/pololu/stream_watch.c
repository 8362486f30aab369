#include "drivers/imu/pololu/board_parts.h"
#include "model/math/units.h"

#include <errno.h>
#include <math.h>

/* A chip may have so much less noise than its data sheet's typical figure. */
#define LEAST_NOISE 0.6
/* Chance that noise alone repeats itself often enough to be taken for frozen data; at 400 Hz, with all three axes at
 * the worst place all the time, once in 80 years. */
#define FROZEN_CHANCE 1e-12

enum {
	SILENT_MS = 20,
	STOPPED_MS = 50,
	STOPPED_STUB_MS = 1000, /* its feeder is a program that may have to wait */
	FROZEN_MS = 50,
	LAST_FROZEN_MS = 1000, /* where noise needs longer, it tells nothing */
	SATURATED_MS = 60,
};

/* The greatest chance that the next value of an axis is the same digit, whatever came before. Noise behind a low-pass
 * (of first order) follows itself; what is new in each sample has the deviation that is left. */
static double chance_of_same(const struct chip_setup *setup, double density, double digit)
{
	double follows = exp(-2 * PI * setup->bandwidth_hz / setup->rate->hz);
	double sigma = LEAST_NOISE * density * sqrt(fmin(setup->bandwidth_hz, setup->rate->hz / 2)) *
		       sqrt(1 - follows * follows) / digit;

	return erf(0.5 / (sigma * sqrt(2)));
}

static unsigned samples_in(const struct stream *s, int ms)
{
	return (unsigned)ceil(1e-3 * ms * s->setup.rate->hz);
}

unsigned stream_same_limit(const struct stream *s)
{
	double log_chance = 0, n;

	for (size_t i = 0; i < s->chip->triad_count; i++) {
		const struct chip_triad *t = &s->chip->triads[i];
		double digit = s->setup.range[i]->step * (t->digit ? t->digit : 1);

		log_chance += 3 * log(chance_of_same(&s->setup, t->density, digit));
	}
	n = 1 + ceil(log(FROZEN_CHANCE) / log_chance);
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

	while (stream_expected(&s->registers, s->verify) < 0)
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

/* Nothing new between the end of a read that found something and the beginning of one that did not. */
static bool stopped(const struct stream *s)
{
	int64_t limit_ns =
		(s->setup.stub ? STOPPED_STUB_MS : STOPPED_MS) * BOARD_MS + (int64_t)(2e9 / s->setup.rate->hz);

	if (s->setup.stub && s->same_limit == 0) /* equal data may be new ones */
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
