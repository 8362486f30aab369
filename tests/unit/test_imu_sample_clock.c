/* The clock of a chip that samples by its own oscillator (drivers/imu/sample_clock.h). Nominal period 10 ms, +-20 %,
 * all times in ns from the start; the expected brackets are worked out by hand. */
#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <setjmp.h>
/* cmocka needs the headers above */
#include <cmocka.h>

#include "drivers/imu/sample_clock.h"

#define MS     1e6
#define PERIOD (10 * MS)

static void assert_near(double value, double expected, double tolerance)
{
	if (!(fabs(value - expected) <= tolerance))
		fail_msg("%.9g, expected %.9g +- %.3g", value, expected, tolerance);
}

static struct sample_clock started(void)
{
	struct sample_clock c;

	sample_clock_start(&c, PERIOD, 0.2);
	return c;
}

/* Sample 0 was taken between 100 and 100.2 ms; nothing more is known of the period. */
static struct sample_clock begun(void)
{
	struct sample_clock c = started();

	sample_clock_read(&c, 0, 100 * MS, 100.1 * MS);
	sample_clock_read(&c, 1, 100.15 * MS, 100.2 * MS);
	return c;
}

static void assert_bracket(const struct sample_clock *c, int64_t newest, double lo_ms, double hi_ms)
{
	assert_int_equal(c->newest, newest);
	assert_near(c->lo_ns, lo_ms * MS, 1);
	assert_near(c->hi_ns, hi_ms * MS, 1);
}

static void test_before_the_first_sample_the_period_is_the_nominal_one(void **state)
{
	struct sample_clock c = started();

	(void)state;
	assert_int_equal(c.newest, -1);
	assert_near(sample_clock_period(&c), PERIOD, 1);
	assert_near(c.shortest_ns, 8 * MS, 1);
	assert_near(c.longest_ns, 12 * MS, 1);
	assert_false(sample_clock_locked(&c));
}

static void test_the_first_sample_was_taken_after_the_read_that_found_none(void **state)
{
	struct sample_clock c = begun();

	(void)state;
	assert_bracket(&c, 0, 100, 100.2);
	assert_near(sample_clock_at(&c, 0), 100.1 * MS, 1);
	assert_near(sample_clock_at(&c, 3), 130.1 * MS, 1);
}

static void test_without_such_a_read_it_is_at_most_one_longest_period_old(void **state)
{
	struct sample_clock c = started();

	(void)state;
	sample_clock_read(&c, 5, 200 * MS, 200.2 * MS);
	assert_bracket(&c, 4, 188, 200.2);
}

/* 20 ms on: the old bracket has grown to 116 .. 124.2, the read says 118 - 12 .. 118.1. */
static void test_a_read_narrows_the_bracket_from_both_sides(void **state)
{
	struct sample_clock c = begun();

	(void)state;
	sample_clock_read(&c, 3, 118 * MS, 118.1 * MS);
	assert_int_equal(c.newest, 2);
	assert_near(c.lo_ns, 116 * MS, 0.1 * MS);
	assert_near(c.hi_ns, 118.1 * MS, 1);
}

/* The two samples took 16 ms at least and 18.1 ms at most. */
static void test_the_period_lies_between_what_the_brackets_permit(void **state)
{
	struct sample_clock c = begun();

	(void)state;
	sample_clock_read(&c, 3, 118 * MS, 118.1 * MS);
	assert_near(c.longest_ns, 18.1 / 2 * MS, 0.02 * MS);
	assert_near(c.shortest_ns, 8 * MS, 0.02 * MS);
}

static void test_an_edge_counts_for_the_sample_nearest_to_it(void **state)
{
	static const struct {
		double edge_ms;
		int64_t index;
	} edges[] = {{104.9, 0}, {105.3, 1}, {110.1, 1}, {114.9, 1}, {115.3, 2}, {120.1, 2}, {124.9, 2}};

	(void)state;
	for (size_t i = 0; i < sizeof edges / sizeof *edges; i++) {
		struct sample_clock c = begun();

		sample_clock_edge(&c, (edges[i].edge_ms - 0.1) * MS, edges[i].edge_ms * MS);
		assert_int_equal(c.newest, edges[i].index);
	}
}

static void test_an_edge_is_the_bracket_of_its_sample(void **state)
{
	struct sample_clock c = begun();

	(void)state;
	sample_clock_edge(&c, 100.05 * MS, 100.06 * MS);
	assert_bracket(&c, 0, 100.05, 100.06);
	c = begun();
	sample_clock_edge(&c, 109.9 * MS, 110 * MS);
	assert_bracket(&c, 1, 109.9, 110);
	assert_true(sample_clock_locked(&c));
}

static void test_an_edge_before_the_first_read_or_of_an_older_sample_changes_nothing(void **state)
{
	struct sample_clock c = started();

	(void)state;
	sample_clock_edge(&c, 109.9 * MS, 110 * MS);
	assert_int_equal(c.newest, -1);
	c = begun();
	sample_clock_edge(&c, 89.9 * MS, 90 * MS);
	assert_bracket(&c, 0, 100, 100.2);
}

/* The edge of sample 2 is known; a read between finds only two samples: sample 1 came before it, sample 2 after it. */
static void test_a_read_that_is_behind_an_edge_is_about_the_older_sample(void **state)
{
	struct sample_clock c = begun();

	(void)state;
	sample_clock_edge(&c, 119.5 * MS, 120 * MS);
	sample_clock_read(&c, 2, 119.7 * MS, 119.8 * MS);
	assert_int_equal(c.newest, 2);
	assert_true(c.lo_ns >= 119.5 * MS && c.hi_ns <= 120 * MS);
	assert_near(sample_clock_at(&c, 1), 110 * MS, 0.5 * MS);
}

static void test_exact_edges_measure_the_period_of_the_oscillator(void **state)
{
	const double period = 1.013 * PERIOD;
	struct sample_clock c = begun();

	(void)state;
	for (int i = 1; i <= 1000; i++)
		sample_clock_edge(&c, 100.1 * MS + i * period - 0.02 * MS, 100.1 * MS + i * period);
	assert_near(sample_clock_period(&c), period, 1e-4 * period);
	assert_near(sample_clock_at(&c, 1000), 100.1 * MS + 1000 * period, 0.02 * MS);
	assert_true(c.shortest_ns <= period && c.longest_ns >= period);
}

/* 30 ppm a second; the period is known to 50 ppm at best. */
static void test_a_period_that_drifts_is_followed(void **state)
{
	struct sample_clock c = begun();
	double t = 100.1 * MS, period = PERIOD;

	(void)state;
	for (int i = 0; i < 30000; i++) {
		t += period;
		period *= 1 + 20e-6 * 0.01;
		sample_clock_edge(&c, t - 0.02 * MS, t);
		assert_true(c.lo_ns <= t && t <= c.hi_ns + 1);
	}
	assert_int_equal(c.newest, 30000);
	assert_near(sample_clock_period(&c), period, 2e-4 * period);
}

/* A quarter of the period is the limit: 2.5 ms. */
static void test_a_small_contradiction_moves_the_bracket_and_a_large_one_replaces_it(void **state)
{
	struct sample_clock c = begun();

	(void)state;
	sample_clock_read(&c, 1, 114 * MS, 130 * MS); /* not before 102: 1.8 ms after the bracket */
	assert_bracket(&c, 0, 102, 103.25);
	c = begun();
	sample_clock_read(&c, 1, 116 * MS, 130 * MS); /* not before 104: 3.8 ms after it */
	assert_bracket(&c, 0, 104, 130);
	c = begun();
	sample_clock_read(&c, 1, 90 * MS, 98.5 * MS); /* 1.5 ms before the bracket */
	assert_bracket(&c, 0, 97.25, 98.5);
	c = begun();
	sample_clock_read(&c, 1, 80 * MS, 96 * MS); /* 4 ms before it */
	assert_bracket(&c, 0, 68, 96);
}

/* Wider than a sixteenth of the period the next read shall halve the bracket, else it shall find the sample. */
static void test_a_read_is_due_in_the_middle_of_a_wide_bracket_and_at_the_end_of_a_narrow_one(void **state)
{
	struct sample_clock c = {
		.newest = 5, .lo_ns = 100 * MS, .hi_ns = 100.64 * MS, .shortest_ns = PERIOD, .longest_ns = PERIOD};

	(void)state;
	assert_true(sample_clock_is_wide(&c, 6));
	assert_near(sample_clock_due(&c, 6), 110.32 * MS, 1);
	c.hi_ns = 100.6 * MS;
	assert_false(sample_clock_is_wide(&c, 6));
	assert_near(sample_clock_due(&c, 6), 110.6 * MS, 1);
	/* three periods on it is wider by what the period is not known */
	c.longest_ns = 10.1 * MS;
	assert_true(sample_clock_is_wide(&c, 8));
	assert_near(sample_clock_due(&c, 8), (130.9 - 0.45) * MS, 1);
}

static void test_a_clock_is_locked_below_a_sixth_of_the_period(void **state)
{
	struct sample_clock c = {
		.newest = 0, .lo_ns = 100 * MS, .hi_ns = 101.6 * MS, .shortest_ns = PERIOD, .longest_ns = PERIOD};

	(void)state;
	assert_true(sample_clock_locked(&c));
	c.hi_ns = 101.7 * MS;
	assert_false(sample_clock_locked(&c));
}

/* Period and first sample are known exactly. */
static struct sample_clock exact(void)
{
	return (struct sample_clock){.newest = 0,
		.lo_ns = 100 * MS,
		.hi_ns = 100 * MS,
		.taken_ns = 100 * MS,
		.shortest_ns = PERIOD,
		.longest_ns = PERIOD,
		.nominal_ns = PERIOD,
		.tolerance = 0.2,
		.anchor_lo_ns = 100 * MS,
		.anchor_hi_ns = 100 * MS};
}

/* 30 ppm in a second, which is 100 samples: 300 ns of 10 ms. The read says nothing new. */
static void test_a_known_period_becomes_uncertain_by_the_drift_of_an_oscillator(void **state)
{
	struct sample_clock c = exact();

	(void)state;
	sample_clock_read(&c, 101, 1105 * MS, 1105 * MS);
	assert_bracket(&c, 100, 1100, 1100);
	assert_near(c.shortest_ns, PERIOD - 300, 1);
	assert_near(c.longest_ns, PERIOD + 300, 1);
}

static void test_the_drift_does_not_exceed_the_tolerance(void **state)
{
	struct sample_clock c = exact();

	(void)state;
	c.tolerance = 20e-6;
	sample_clock_read(&c, 101, 1105 * MS, 1105 * MS);
	assert_near(c.shortest_ns, PERIOD - 200, 1);
	assert_near(c.longest_ns, PERIOD + 200, 1);
	sample_clock_edge(&c, 1111 * MS, 1111.1 * MS); /* a contradiction */
	assert_near(c.shortest_ns, PERIOD - 200, 1);
	assert_near(c.longest_ns, PERIOD + 200, 1);
}

static void test_two_neighbouring_samples_bound_the_period(void **state)
{
	struct sample_clock c = exact();

	(void)state;
	c.shortest_ns = 8 * MS;
	c.longest_ns = 12 * MS;
	sample_clock_edge(&c, 109.9 * MS, 110.1 * MS);
	assert_near(c.shortest_ns, 9.9 * MS, 1);
	assert_near(c.longest_ns, 10.1 * MS, 1);
}

/* 100 samples on, an edge is known to 110 us, the period to 1.1 us: 110 ppm; the finest is 50 ppm to both sides. */
static void test_a_period_is_known_to_fifty_ppm_at_best(void **state)
{
	(void)state;
	for (int finer = 0; finer < 2; finer++) {
		const double wide = finer ? 0.09 * MS : 0.11 * MS;
		struct sample_clock c = exact();

		c.shortest_ns = 0.999 * PERIOD;
		c.longest_ns = 1.001 * PERIOD;
		sample_clock_edge(&c, 1100 * MS, 1100 * MS + wide);
		assert_near(c.shortest_ns, finer ? 0.999 * PERIOD - 300 : PERIOD, 1);
		assert_near(c.longest_ns, finer ? 1.001 * PERIOD + 300 : PERIOD + wide / 100, 1);
	}
}

/* Half a per mille of the period to both sides, and 30 ppm for the second. */
static void test_a_contradiction_loosens_the_bounds_of_the_period(void **state)
{
	struct sample_clock c = exact();

	(void)state;
	sample_clock_edge(&c, 1101 * MS, 1101.1 * MS);
	assert_near(c.shortest_ns, PERIOD - 300 - 5000, 1);
	assert_near(c.longest_ns, PERIOD + 300 + 5000, 1);
	assert_bracket(&c, 100, 1101, 1101.1);
	assert_near(sample_clock_at(&c, 100), 1101 * MS, 1); /* of the new bracket the end next to what was expected */
	c = exact();
	sample_clock_edge(&c, 1098.9 * MS, 1099 * MS);
	assert_near(sample_clock_at(&c, 100), 1099 * MS, 1);
}

/* The period is measured from a sample to others until 2.5 s later, then from that one on: what it was before counts no
 * more. A sample that is known better by a fifth or more replaces it within the first quarter of that time. */
static void test_the_period_is_measured_over_two_and_a_half_seconds(void **state)
{
	static const struct {
		int samples;
		double wide_ms;
		bool replaced;
	} cases[] = {{249, 0.2, false}, {250, 0.2, true}, {62, 0.15, true}, {62, 0.165, false}, {63, 0.15, false}};

	(void)state;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		struct sample_clock c = exact();
		const double end_ns = (100 + 10.0 * cases[i].samples) * MS, wide_ns = cases[i].wide_ms * MS;

		c.lo_ns -= 0.1 * MS;
		c.hi_ns += 0.1 * MS;
		c.anchor_lo_ns = c.lo_ns;
		c.anchor_hi_ns = c.hi_ns;
		sample_clock_edge(&c, end_ns - wide_ns / 2, end_ns + wide_ns / 2);
		assert_int_equal(c.anchor, cases[i].replaced ? cases[i].samples : 0);
		assert_near(c.anchor_lo_ns, cases[i].replaced ? end_ns - wide_ns / 2 : 99.9 * MS, 1);
		assert_near(c.anchor_hi_ns, cases[i].replaced ? end_ns + wide_ns / 2 : 100.1 * MS, 1);
	}
}

/* By an eighth of the way at a time, and never out of the bracket. */
static void test_the_estimate_moves_smoothly_to_the_middle_of_the_bracket(void **state)
{
	struct sample_clock c = exact();

	(void)state;
	c.hi_ns = 101 * MS;
	c.taken_ns = 100.2 * MS;
	sample_clock_read(&c, 1, 105 * MS, 105 * MS); /* nothing new */
	assert_near(sample_clock_at(&c, 0), (100.2 + 0.3 / 8) * MS, 1);
	sample_clock_read(&c, 1, 105 * MS, 100.1 * MS);
	assert_near(sample_clock_at(&c, 0), 100.1 * MS, 1);
	c.lo_ns = 100 * MS;
	c.hi_ns = 101 * MS;
	sample_clock_read(&c, 1, 110.9 * MS, 111 * MS); /* after 100.9 */
	assert_near(sample_clock_at(&c, 0), 100.9 * MS, 1);
}

/* An edge has shown sample 2; a read finds one sample less: sample 1 was taken before it, and sample 2 after it. */
static void test_a_read_behind_an_edge_bounds_both_samples(void **state)
{
	struct sample_clock c = exact();

	(void)state;
	c.newest = 2;
	c.lo_ns = 119 * MS;
	c.hi_ns = 121 * MS;
	c.taken_ns = 120 * MS;
	c.shortest_ns = 9 * MS;
	c.longest_ns = 11 * MS;
	c.anchor = 2;					  /* the period is not measured by this */
	sample_clock_read(&c, 2, 121.5 * MS, 109.5 * MS); /* 121.5 - 11 + 9, and 109.5 + 11 */
	assert_bracket(&c, 2, 119.5, 120.5);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_before_the_first_sample_the_period_is_the_nominal_one),
		cmocka_unit_test(test_the_first_sample_was_taken_after_the_read_that_found_none),
		cmocka_unit_test(test_without_such_a_read_it_is_at_most_one_longest_period_old),
		cmocka_unit_test(test_a_read_narrows_the_bracket_from_both_sides),
		cmocka_unit_test(test_the_period_lies_between_what_the_brackets_permit),
		cmocka_unit_test(test_an_edge_counts_for_the_sample_nearest_to_it),
		cmocka_unit_test(test_an_edge_is_the_bracket_of_its_sample),
		cmocka_unit_test(test_an_edge_before_the_first_read_or_of_an_older_sample_changes_nothing),
		cmocka_unit_test(test_a_read_that_is_behind_an_edge_is_about_the_older_sample),
		cmocka_unit_test(test_exact_edges_measure_the_period_of_the_oscillator),
		cmocka_unit_test(test_a_period_that_drifts_is_followed),
		cmocka_unit_test(test_a_small_contradiction_moves_the_bracket_and_a_large_one_replaces_it),
		cmocka_unit_test(test_a_known_period_becomes_uncertain_by_the_drift_of_an_oscillator),
		cmocka_unit_test(test_the_drift_does_not_exceed_the_tolerance),
		cmocka_unit_test(test_two_neighbouring_samples_bound_the_period),
		cmocka_unit_test(test_a_period_is_known_to_fifty_ppm_at_best),
		cmocka_unit_test(test_a_contradiction_loosens_the_bounds_of_the_period),
		cmocka_unit_test(test_the_period_is_measured_over_two_and_a_half_seconds),
		cmocka_unit_test(test_the_estimate_moves_smoothly_to_the_middle_of_the_bracket),
		cmocka_unit_test(test_a_read_behind_an_edge_bounds_both_samples),
		cmocka_unit_test(test_a_read_is_due_in_the_middle_of_a_wide_bracket_and_at_the_end_of_a_narrow_one),
		cmocka_unit_test(test_a_clock_is_locked_below_a_sixth_of_the_period),
	};

	return cmocka_run_group_tests_name("sample_clock", tests, NULL, NULL);
}
