#include "gateway/histogram.h"

#include <errno.h>

#include "od/little_endian.h"

/* A power of two has 1 << FRACTION bins. */
enum { FRACTION = 2, OF_POWER = 1 << FRACTION };

/* ---- bins -------------------------------------------------------------------------------------------------------- */

/* The number of the power of two, and the two bits below its leading one. */
unsigned histogram_bin(uint32_t duration)
{
	unsigned power, bin;

	if (duration < OF_POWER)
		return duration;
	power = 31 - (unsigned)__builtin_clz(duration);
	bin = (power - 1) * OF_POWER + (duration >> (power - FRACTION) & (OF_POWER - 1));
	return bin < HISTOGRAM_BINS ? bin : HISTOGRAM_BINS - 1;
}

uint32_t histogram_lowest(unsigned bin)
{
	if (bin < OF_POWER)
		return bin;
	return (OF_POWER + bin % OF_POWER) << (bin / OF_POWER - 1);
}

void histogram_add(struct histogram *h, uint64_t duration)
{
	uint32_t value = duration < UINT32_MAX ? (uint32_t)duration : UINT32_MAX;

	if (h->count == UINT32_MAX)
		return;
	if (h->count == 0 || value < h->minimum)
		h->minimum = value;
	if (value > h->maximum)
		h->maximum = value;
	h->count++;
	h->sum += value;
	h->bins[histogram_bin(value)]++;
}

uint32_t histogram_quantile(const struct histogram *h, double longer)
{
	uint64_t above = 0;

	for (unsigned bin = HISTOGRAM_BINS; bin > 0; bin--) {
		above += h->bins[bin - 1];
		if ((double)above <= longer * h->count)
			continue;
		uint32_t highest = bin < HISTOGRAM_BINS ? histogram_lowest(bin) - 1 : UINT32_MAX;
		return highest < h->maximum ? highest : h->maximum;
	}
	return h->maximum;
}

/* ---- wire form --------------------------------------------------------------------------------------------------- */

enum { AT_MINIMUM = 4, AT_MAXIMUM = 8, AT_SUM = 12, AT_BINS = 20 };

void histogram_encode(const struct histogram *h, uint8_t wire[HISTOGRAM_WIRE])
{
	put_u32(wire, h->count);
	put_u32(wire + AT_MINIMUM, h->minimum);
	put_u32(wire + AT_MAXIMUM, h->maximum);
	put_uint(wire + AT_SUM, h->sum, 8);
	for (size_t i = 0; i < HISTOGRAM_BINS; i++)
		put_u32(wire + AT_BINS + 4 * i, h->bins[i]);
}

int histogram_decode(struct histogram *h, const uint8_t *wire, size_t size)
{
	uint64_t count = 0;

	if (size != HISTOGRAM_WIRE)
		return -EINVAL;
	h->count = get_u32(wire);
	h->minimum = get_u32(wire + AT_MINIMUM);
	h->maximum = get_u32(wire + AT_MAXIMUM);
	h->sum = get_uint(wire + AT_SUM, 8);
	for (size_t i = 0; i < HISTOGRAM_BINS; i++) {
		h->bins[i] = get_u32(wire + AT_BINS + 4 * i);
		count += h->bins[i];
	}
	return count == h->count ? 0 : -EINVAL;
}
