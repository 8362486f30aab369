/* drivers/imu/sample_clock.h
 * When a chip that samples by its own oscillator took each of its samples, in the time of this machine, known from
 * reads that come when they come.
 *
 * A read between t_a and t_b that found `count` samples taken says two things for sure: sample count - 1 was taken
 * before t_b, sample count after t_a. Both bounds move on with the period, which is only known to lie between bounds of
 * its own; each read narrows all of them. So a late read does no harm, and the error is never more than half the
 * bracket. sample_clock_due() aims reads so that the bracket stays small. All times in ns. */
#ifndef DRIVERS_IMU_SAMPLE_CLOCK_H
#define DRIVERS_IMU_SAMPLE_CLOCK_H

#include <stdbool.h>
#include <stdint.h>

struct sample_clock {
	int64_t newest;			/* index of the newest sample known; -1: none yet */
	double lo_ns, hi_ns;		/* it was taken between */
	double taken_ns;		/* best guess, smooth */
	double shortest_ns, longest_ns; /* the period is between */
	/* PRIVATE */
	double nominal_ns, tolerance;
	double none_ns; /* nothing had been sampled then */
	int64_t anchor;
	double anchor_lo_ns, anchor_hi_ns;
};

/** The datasheet's period; it may be off by a fraction of `tolerance`. */
void sample_clock_start(struct sample_clock *clock, double period_ns, double tolerance);

/** At some time between the two, `count` samples had been taken since the start. */
void sample_clock_read(struct sample_clock *clock, int64_t count, double from_ns, double to_ns);

/** A sample was taken between the two (a data-ready edge), whichever it was. Without effect before the first read. */
void sample_clock_edge(struct sample_clock *clock, double from_ns, double to_ns);

/** When sample `index` was or will be taken. */
double sample_clock_at(const struct sample_clock *clock, int64_t index);

/** When a read will find sample `index`, or will at least say something about the clock. */
double sample_clock_due(const struct sample_clock *clock, int64_t index);

/** Whether its bracket will be so wide that a read at sample_clock_due() is needed to narrow it. */
bool sample_clock_learns(const struct sample_clock *clock, int64_t index);

double sample_clock_period(const struct sample_clock *clock);

/** Whether the bracket is narrower than a sixth of the period. */
bool sample_clock_locked(const struct sample_clock *clock);

#endif
