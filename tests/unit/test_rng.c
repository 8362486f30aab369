#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>

#include "model/sim/rng.h"

/* The published sequence of xoshiro256++, initialised by splitmix64 from 0. */
static void test_the_integers_are_those_of_xoshiro256plusplus(void **state)
{
	struct rng rng;

	(void)state;
	rng_init(&rng, 0);
	assert_true(rng_u64(&rng) == 5987356902031041503u);
	assert_true(rng_u64(&rng) == 7051070477665621255u);
	assert_true(rng_u64(&rng) == 6633766593972829180u);
	assert_true(rng_u64(&rng) == 211316841551650330u);
}

static void test_uniform_numbers_fill_their_interval_evenly(void **state)
{
	enum { BINS = 16, N = 160000 };
	int count[BINS] = {0};
	double chi2 = 0;
	struct rng rng;

	(void)state;
	rng_init(&rng, 1);
	for (int i = 0; i < N; i++) {
		double u = rng_uniform(&rng);

		assert_true(u >= 0 && u < 1);
		count[(int)(u * BINS)]++;
	}
	for (int i = 0; i < BINS; i++) {
		double d = count[i] - (double)N / BINS;

		chi2 += d * d / ((double)N / BINS);
	}
	assert_true(chi2 < 37.7); /* 15 degrees of freedom: p = 0.001 */
}

/* Share of a normal distribution within 1, 2, 3 sigma: 68.27, 95.45, 99.73 %. */
static void test_gaussian_numbers_are_normal(void **state)
{
	enum { N = 200000 };
	double sum = 0, squares = 0, cubes = 0, pairs = 0, last = 0;
	int within[4] = {0};
	struct rng rng;

	(void)state;
	rng_init(&rng, 7);
	for (int i = 0; i < N; i++) {
		double x = rng_gauss(&rng);

		sum += x;
		squares += x * x;
		cubes += x * x * x;
		pairs += x * last;
		last = x;
		for (int k = 1; k <= 3; k++)
			within[k] += fabs(x) < k;
	}
	assert_true(fabs(sum / N) < 0.01);
	assert_true(fabs(squares / N - 1) < 0.015);
	assert_true(fabs(cubes / N) < 0.03);
	assert_true(fabs(pairs / N) < 0.01);
	assert_true(fabs((double)within[1] / N - 0.6827) < 0.004);
	assert_true(fabs((double)within[2] / N - 0.9545) < 0.002);
	assert_true(fabs((double)within[3] / N - 0.9973) < 0.0005);
}

static void test_neighbouring_seeds_give_unrelated_sequences(void **state)
{
	enum { N = 20000 };
	double product = 0;
	struct rng a, b;

	(void)state;
	rng_init(&a, 100);
	rng_init(&b, 101);
	for (int i = 0; i < N; i++)
		product += rng_gauss(&a) * rng_gauss(&b);
	assert_true(fabs(product / N) < 4 / sqrt(N));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_integers_are_those_of_xoshiro256plusplus),
		cmocka_unit_test(test_uniform_numbers_fill_their_interval_evenly),
		cmocka_unit_test(test_gaussian_numbers_are_normal),
		cmocka_unit_test(test_neighbouring_seeds_give_unrelated_sequences),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
