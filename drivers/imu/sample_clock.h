/* drivers/imu/sample_clock.h
 * Estimates when a chip with its own oscillator took each of its samples, in CLOCK_MONOTONIC, from reads at arbitrary
 * times.
 *
 * A read between t_a and t_b that found `count` samples gives two bounds: sample count - 1 was taken before t_b, sample
 * count after t_a. Both bounds are extrapolated with the period, for which a lower and an upper bound are known, too.
 * Each read narrows all of them. A late read does no harm, and the error is at most half of the bracket.
 * sample_clock_due() schedules reads so that the bracket stays small. All times in ns. */
#ifndef DRIVERS_IMU_SAMPLE_CLOCK_H
#define DRIVERS_IMU_SAMPLE_CLOCK_H

#include <stdbool.h>
#include <stdint.h>

struct sample_clock {
	int64_t newest;			/* index of the newest known sample; -1: none yet */
	double lo_ns, hi_ns;		/* bracket: it was taken between these times */
	double taken_ns;		/* smoothed estimate within the bracket */
	double shortest_ns, longest_ns; /* bounds of the period */
	/* PRIVATE */
	double nominal_ns, tolerance;
	double none_ns; /* last read that found no sample */
	int64_t anchor;
	double anchor_lo_ns, anchor_hi_ns;
};

/** Starts with the nominal period; the true one differs by at most the fraction `tolerance`. */
void sample_clock_start(struct sample_clock *clock, double period_ns, double tolerance);

/** At some time between from_ns and to_ns, `count` samples had been taken since the start. */
void sample_clock_read(struct sample_clock *clock, int64_t count, double from_ns, double to_ns);

/** A sample was taken between from_ns and to_ns (a data-ready edge): the one expected nearest to it. Without effect
 * before the first read. */
void sample_clock_edge(struct sample_clock *clock, double from_ns, double to_ns);

/** The estimated time of sample `index`, past or future. */
double sample_clock_at(const struct sample_clock *clock, int64_t index);

/** When to read next: sample `index` is there, or, while the bracket is wide, the read halves it. */
double sample_clock_due(const struct sample_clock *clock, int64_t index);

/** Whether the bracket of sample `index` is wider than 1/16 period, so that a read at sample_clock_due() is to narrow
 * it. */
bool sample_clock_is_wide(const struct sample_clock *clock, int64_t index);

double sample_clock_period(const struct sample_clock *clock);

/** Whether the bracket is narrower than a sixth of the period. */
bool sample_clock_locked(const struct sample_clock *clock);

#endif
