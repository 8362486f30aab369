#include "drivers/imu/sample_clock.h"

#include <math.h>

/* Largest relative change of an oscillator's period per second, while it warms up. */
#define DRIFT_PER_S 3e-5
/* The bounds of the period are not narrowed below this fraction of it. */
#define FINEST 5e-5
/* Widens both bounds of the period after a contradiction. */
#define LOOSEN 5e-4

/* The period is measured over this time: over a longer one it drifts. */
#define ANCHOR_NS 2.5e9

enum { SMOOTHING = 8 };

double sample_clock_period(const struct sample_clock *c)
{
	return (c->shortest_ns + c->longest_ns) / 2;
}

void sample_clock_start(struct sample_clock *c, double period_ns, double tolerance)
{
	*c = (struct sample_clock){.newest = -1,
		.nominal_ns = period_ns,
		.tolerance = tolerance,
		.shortest_ns = period_ns * (1 - tolerance),
		.longest_ns = period_ns * (1 + tolerance)};
}

static void begin(struct sample_clock *c, int64_t newest, double lo_ns, double hi_ns)
{
	c->newest = c->anchor = newest;
	c->lo_ns = c->anchor_lo_ns = lo_ns;
	c->hi_ns = c->anchor_hi_ns = hi_ns;
	c->taken_ns = (lo_ns + hi_ns) / 2;
}

/* Narrows the bounds of the period by the time since the anchor. */
static void narrow_period(struct sample_clock *c)
{
	double n = (double)(c->newest - c->anchor), period_ns = sample_clock_period(c);
	double shortest_ns, longest_ns;

	if (n < 1)
		return;
	shortest_ns = fmax(c->shortest_ns, (c->lo_ns - c->anchor_hi_ns) / n);
	longest_ns = fmin(c->longest_ns, (c->hi_ns - c->anchor_lo_ns) / n);
	if (longest_ns - shortest_ns > 2 * FINEST * period_ns) {
		c->shortest_ns = shortest_ns;
		c->longest_ns = longest_ns;
	}
	if (n * c->nominal_ns >= ANCHOR_NS ||
		(n * c->nominal_ns < ANCHOR_NS / 4 &&
			c->hi_ns - c->lo_ns < 0.8 * (c->anchor_hi_ns - c->anchor_lo_ns))) {
		c->anchor = c->newest;
		c->anchor_lo_ns = c->lo_ns;
		c->anchor_hi_ns = c->hi_ns;
	}
}

static void clamp_period(struct sample_clock *c)
{
	c->shortest_ns = fmax(c->shortest_ns, c->nominal_ns * (1 - c->tolerance));
	c->longest_ns = fmin(c->longest_ns, c->nominal_ns * (1 + c->tolerance));
}

static void advance(struct sample_clock *c, int64_t newest)
{
	double n = (double)(newest - c->newest), drift = DRIFT_PER_S * n * c->nominal_ns * 1e-9;

	c->taken_ns += n * sample_clock_period(c);
	c->lo_ns += n * c->shortest_ns;
	c->hi_ns += n * c->longest_ns;
	c->newest = newest;
	c->shortest_ns -= drift * c->nominal_ns;
	c->longest_ns += drift * c->nominal_ns;
	clamp_period(c);
}

/* The bracket and this read contradict each other: the period has left its bounds, or samples are uneven. Below a
 * quarter of the period, the bracket becomes the end of the read's that is nearest to it; otherwise the read's bracket
 * replaces it. */
static void reconcile(struct sample_clock *c, double lo_ns, double hi_ns)
{
	const double little_ns = c->nominal_ns / 4, taken_ns = c->taken_ns;

	c->shortest_ns -= LOOSEN * c->nominal_ns;
	c->longest_ns += LOOSEN * c->nominal_ns;
	clamp_period(c);
	if (lo_ns > c->hi_ns && lo_ns - c->hi_ns < little_ns)
		begin(c, c->newest, lo_ns, fmin(hi_ns, lo_ns + little_ns / 2));
	else if (hi_ns < c->lo_ns && c->lo_ns - hi_ns < little_ns)
		begin(c, c->newest, fmax(lo_ns, hi_ns - little_ns / 2), hi_ns);
	else
		begin(c, c->newest, lo_ns, hi_ns);
	c->taken_ns = fmax(c->lo_ns, fmin(c->hi_ns, taken_ns));
}

/* Intersects the bracket of the newest sample with this one. */
static void narrow(struct sample_clock *c, double lo_ns, double hi_ns)
{
	double guess_ns;

	if (lo_ns > c->hi_ns || hi_ns < c->lo_ns) {
		reconcile(c, lo_ns, hi_ns);
		return;
	}
	c->lo_ns = fmax(c->lo_ns, lo_ns);
	c->hi_ns = fmin(c->hi_ns, hi_ns);
	narrow_period(c);
	guess_ns = c->taken_ns + ((c->lo_ns + c->hi_ns) / 2 - c->taken_ns) / SMOOTHING;
	c->taken_ns = fmax(c->lo_ns, fmin(c->hi_ns, guess_ns));
}

void sample_clock_read(struct sample_clock *c, int64_t count, double from_ns, double to_ns)
{
	double ahead;

	if (count == 0) {
		c->none_ns = from_ns;
		return;
	}
	if (c->newest < 0) {
		begin(c, count - 1, fmax(c->none_ns, from_ns - c->longest_ns), to_ns);
		return;
	}
	if (count - 1 > c->newest)
		advance(c, count - 1);
	ahead = (double)(c->newest - (count - 1)); /* > 0: an edge was seen before its sample was read */
	narrow(c, from_ns - c->longest_ns + ahead * c->shortest_ns, to_ns + ahead * c->longest_ns);
}

void sample_clock_edge(struct sample_clock *c, double from_ns, double to_ns)
{
	int64_t index;

	if (c->newest < 0)
		return;
	index = c->newest + (int64_t)floor((to_ns - c->taken_ns) / sample_clock_period(c) + 0.5);
	if (index < c->newest)
		return;
	advance(c, index);
	narrow(c, from_ns, to_ns);
}

double sample_clock_at(const struct sample_clock *c, int64_t index)
{
	return c->taken_ns + (double)(index - c->newest) * sample_clock_period(c);
}

static double width_of(const struct sample_clock *c, int64_t index)
{
	return c->hi_ns - c->lo_ns + (double)(index - c->newest) * (c->longest_ns - c->shortest_ns);
}

bool sample_clock_is_wide(const struct sample_clock *c, int64_t index)
{
	return width_of(c, index) > sample_clock_period(c) / 16;
}

/* The middle of a wide bracket, to halve it; the end of a narrow one, to find the sample. */
double sample_clock_due(const struct sample_clock *c, int64_t index)
{
	double hi_ns = c->hi_ns + (double)(index - c->newest) * c->longest_ns;

	return sample_clock_is_wide(c, index) ? hi_ns - width_of(c, index) / 2 : hi_ns;
}

bool sample_clock_locked(const struct sample_clock *c)
{
	return c->newest >= 0 && c->hi_ns - c->lo_ns < sample_clock_period(c) / 6;
}
