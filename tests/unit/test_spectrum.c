/* The spectrum of imu9-plot, against signals whose power is known. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <stdlib.h>
#include <cmocka.h>

#include <math.h>

#include "model/math/units.h"
#include "model/sim/rng.h"
#include "tools/plot/spectrum.h"

enum { COUNT = 20000 };
static const double RATE_HZ = 200;

static double values[COUNT];
static bool usable[COUNT];
static struct spectrum spectrum;

static void assert_near(double value, double expected, double tolerance)
{
	if (!(fabs(value - expected) <= tolerance))
		fail_msg("%g is not %g +- %g", value, expected, tolerance);
}

static double power(double from_hz, double to_hz)
{
	double sum = 0;

	for (size_t k = 1; k <= spectrum.bins; k++)
		if ((double)k * spectrum.step_hz >= from_hz && (double)k * spectrum.step_hz <= to_hz)
			sum += spectrum.density[k] * spectrum.step_hz;
	return sum;
}

static void test_a_sine_has_half_of_its_amplitude_squared_at_its_frequency(void **state)
{
	(void)state;
	for (int i = 0; i < COUNT; i++)
		values[i] = 9.81 + 3 * sin(2 * PI * 12.3 * i / RATE_HZ);
	spectrum_of(values, NULL, COUNT, RATE_HZ, &spectrum);
	assert_near(power(12, 12.6), 4.5, 0.01);
	assert_near(power(0, 11) + power(14, 100), 0, 1e-3);
}

static void test_white_noise_has_its_density_everywhere_and_its_variance_in_all(void **state)
{
	struct rng rng;

	(void)state;
	rng_init(&rng, 1);
	for (int i = 0; i < COUNT; i++)
		values[i] = 0.5 * rng_gauss(&rng);
	spectrum_of(values, NULL, COUNT, RATE_HZ, &spectrum);
	assert_near(power(0, 100), 0.25, 0.01);
	assert_near(power(10, 20), 0.025, 0.003); /* 0.25 / 100 Hz */
}

static void test_a_segment_with_a_gap_is_left_out(void **state)
{
	(void)state;
	for (int i = 0; i < COUNT; i++) {
		values[i] = i == COUNT / 2 ? NAN : cos(2 * PI * 25 * i / RATE_HZ);
		usable[i] = i != COUNT / 2 && i != COUNT / 2 + 1;
	}
	spectrum_of(values, usable, COUNT, RATE_HZ, &spectrum);
	assert_near(power(0, 100), 0.5, 0.01);
	for (int i = 0; i < COUNT; i += 10)
		usable[i] = false;
	spectrum_of(values, usable, COUNT, RATE_HZ, &spectrum);
	assert_int_equal(spectrum.bins, 0);
}

static void test_a_short_record_has_a_coarse_spectrum_or_none(void **state)
{
	(void)state;
	for (int i = 0; i < 200; i++)
		values[i] = cos(2 * PI * 25 * i / RATE_HZ);
	spectrum_of(values, NULL, 200, RATE_HZ, &spectrum);
	assert_int_equal(spectrum.bins, 16);
	assert_near(power(0, 100), 0.5, 0.05);
	spectrum_of(values, NULL, 15, RATE_HZ, &spectrum);
	assert_int_equal(spectrum.bins, 0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_sine_has_half_of_its_amplitude_squared_at_its_frequency),
		cmocka_unit_test(test_white_noise_has_its_density_everywhere_and_its_variance_in_all),
		cmocka_unit_test(test_a_segment_with_a_gap_is_left_out),
		cmocka_unit_test(test_a_short_record_has_a_coarse_spectrum_or_none),
	};

	return cmocka_run_group_tests_name("spectrum", tests, NULL, NULL);
}
