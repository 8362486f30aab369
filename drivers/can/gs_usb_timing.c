#include "drivers/can/gs_usb_timing.h"

#include <errno.h>

enum { RATE_PERMILLE = 5 };

struct candidate {
	uint64_t rate_off;  /* |quanta * brp * bit_s - clock| [Hz] */
	uint64_t point_off; /* distance from the sample point, in 1/1000000 of a bit */
	uint32_t brp, quanta, seg2;
};

static uint64_t distance(uint64_t a, uint64_t b)
{
	return a > b ? a - b : b - a;
}

static bool is_better(const struct candidate *a, const struct candidate *b)
{
	if (a->rate_off != b->rate_off)
		return a->rate_off < b->rate_off;
	if (a->point_off != b->point_off)
		return a->point_off < b->point_off;
	return a->quanta > b->quanta;
}

static uint32_t clamp(uint32_t value, uint32_t low, uint32_t high)
{
	return value < low ? low : value > high ? high : value;
}

/* Chooses seg2 for c->quanta; false: the segments cannot add up to it. */
static bool split(const struct can_link_limits *l, uint32_t permille, struct candidate *c)
{
	uint32_t both = c->quanta - 1; /* without the synchronisation segment */

	if (c->quanta < 1 + l->tseg1_min + l->tseg2_min || c->quanta > 1 + l->tseg1_max + l->tseg2_max)
		return false;
	uint32_t low = both > l->tseg1_max && both - l->tseg1_max > l->tseg2_min ? both - l->tseg1_max : l->tseg2_min;
	uint32_t high = both - l->tseg1_min < l->tseg2_max ? both - l->tseg1_min : l->tseg2_max;

	/* half a quantum is rounded up: of two sample points the earlier one, as in the kernel */
	c->seg2 = clamp((c->quanta * (1000 - permille) + 500) / 1000, low, high);
	c->point_off = distance((uint64_t)(c->quanta - c->seg2) * 1000000 / c->quanta, (uint64_t)permille * 1000);
	return true;
}

static struct bit_timing timing_of(const struct candidate *c, uint32_t sjw_max)
{
	uint32_t tseg1 = c->quanta - 1 - c->seg2;
	struct bit_timing timing = {.prop = tseg1 / 2, .seg2 = c->seg2, .brp = c->brp};

	timing.seg1 = tseg1 - timing.prop;
	timing.sjw = clamp(c->seg2 / 2, 1, sjw_max > 0 ? sjw_max : 1);
	return timing;
}

uint32_t bit_timing_sample_point(uint32_t bit_s)
{
	return bit_s > 800000 ? 750 : bit_s > 500000 ? 800 : 875;
}

int bit_timing_find(const struct can_link_limits *l, uint32_t sjw_max, uint32_t bit_s, uint32_t sample_point_permille,
	struct bit_timing *timing)
{
	const uint32_t step = l->brp_inc > 0 ? l->brp_inc : 1;
	struct candidate best = {.rate_off = UINT64_MAX};

	if (bit_s == 0 || l->brp_min == 0 || sample_point_permille >= 1000)
		return -EOPNOTSUPP;
	for (uint64_t brp = l->brp_min; brp <= l->brp_max; brp += step) {
		const uint64_t quanta = (l->clock_hz + brp * bit_s / 2) / (brp * bit_s);
		struct candidate c = {.brp = (uint32_t)brp, .quanta = (uint32_t)quanta};

		if (quanta == 0)
			break; /* larger prescalers give fewer quanta */
		c.rate_off = distance(quanta * brp * bit_s, l->clock_hz);
		if (split(l, sample_point_permille, &c) && is_better(&c, &best))
			best = c;
	}
	if (best.rate_off == UINT64_MAX || best.rate_off * 1000 > (uint64_t)l->clock_hz * RATE_PERMILLE)
		return -EOPNOTSUPP;
	*timing = timing_of(&best, sjw_max);
	return 0;
}
