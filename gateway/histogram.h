/* gateway/histogram.h
 * Durations in bins of fixed, logarithmic width: how they are distributed, in constant memory and with constant work
 * for each. A duration is a whole number of the unit of the histogram, us or ns. Pure; one thread for each. */
#ifndef GATEWAY_HISTOGRAM_H
#define GATEWAY_HISTOGRAM_H

#include <stddef.h>
#include <stdint.h>

/** Below 8 each number has a bin of its own. From 8 on each power of two has four, so that a bin is at most a quarter
 * as wide as its lowest number. The last bin also has all that is longer. */
enum { HISTOGRAM_BINS = 96 };

/** Bytes of the wire form, all numbers little-endian: count, minimum, maximum (32 bits each), sum (64 bits), the bins
 * (32 bits each). */
enum { HISTOGRAM_WIRE = 20 + 4 * HISTOGRAM_BINS };

/** Zeroed: empty. */
struct histogram {
	uint32_t count;		   /* at UINT32_MAX it counts no more */
	uint32_t minimum, maximum; /* 0: empty */
	uint64_t sum;
	uint32_t bins[HISTOGRAM_BINS];
};

void histogram_add(struct histogram *h, uint64_t duration);

/** The bin of a duration, and the lowest duration of a bin. */
unsigned histogram_bin(uint32_t duration);
uint32_t histogram_lowest(unsigned bin);
/** No more than this share (0 to 1) of all are longer than what it returns: the highest duration of a bin, or the
 * maximum. 0: empty. */
uint32_t histogram_quantile(const struct histogram *h, double longer);

void histogram_encode(const struct histogram *h, uint8_t wire[HISTOGRAM_WIRE]);
/** 0, or -EINVAL: not a histogram. */
int histogram_decode(struct histogram *h, const uint8_t *wire, size_t size);

#endif
