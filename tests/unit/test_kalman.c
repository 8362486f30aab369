/* The operations on a covariance that both Kalman filters use, against dense matrices. */
#include "model_test.h"

#include <string.h>

#include "model/math/kalman.h"

enum { N = 7, ESTIMATED = 5 };

static double p[N][N], x[N];

/* B B' + 0.1 I, which is positive definite. */
static int any_covariance(void **state)
{
	double b[N][N];

	(void)state;
	for (int i = 0; i < N; i++)
		for (int j = 0; j < N; j++)
			b[i][j] = any();
	for (int i = 0; i < N; i++) {
		x[i] = any();
		for (int j = 0; j < N; j++) {
			p[i][j] = i == j ? 0.1 : 0;
			for (int k = 0; k < N; k++)
				p[i][j] += b[i][k] * b[j][k];
		}
	}
	return 0;
}

/* Measures the sum row . x with this noise: gain, innovation and (I - K row) P of the textbook. */
struct textbook {
	double ph[N], innovation, innovation_variance, x[N], p[N][N];
};

static struct textbook textbook(const double row[N], double measured, double noise)
{
	struct textbook t = {.innovation = measured, .innovation_variance = noise};

	for (int i = 0; i < N; i++) {
		for (int j = 0; j < N; j++)
			t.ph[i] += p[i][j] * row[j];
		t.innovation -= row[i] * x[i];
		t.innovation_variance += row[i] * t.ph[i];
	}
	for (int i = 0; i < N; i++) {
		t.x[i] = x[i] + t.ph[i] / t.innovation_variance * t.innovation;
		for (int j = 0; j < N; j++)
			t.p[i][j] = p[i][j] - t.ph[i] * t.ph[j] / t.innovation_variance;
	}
	return t;
}

static void test_an_update_corrects_all_states_by_the_gain(void **state)
{
	const double row[N] = {0, 1, 0, -2, 0, 0, 0.5};
	struct textbook t = textbook(row, 3, 0.2);

	(void)state;
	kalman_update(N, N, p[0], x, t.ph, t.innovation, t.innovation_variance);
	for (int i = 0; i < N; i++) {
		assert_near(x[i], t.x[i], 1e-14);
		for (int j = 0; j < N; j++)
			assert_near(p[i][j], t.p[i][j], 1e-14);
	}
}

static void test_consider_states_keep_value_and_variance_but_lose_covariance_with_the_estimated_ones(void **state)
{
	const double row[N] = {0, 0, 1};
	struct textbook t = textbook(row, -1, 0.3);
	double x_before[N], p_before[N][N];

	(void)state;
	memcpy(x_before, x, sizeof(x));
	memcpy(p_before, p, sizeof(p));
	kalman_update(N, ESTIMATED, p[0], x, t.ph, t.innovation, t.innovation_variance);
	for (int i = 0; i < N; i++) {
		assert_near(x[i], i < ESTIMATED ? t.x[i] : x_before[i], 1e-14);
		for (int j = 0; j < N; j++)
			assert_near(p[i][j], i < ESTIMATED || j < ESTIMATED ? t.p[i][j] : p_before[i][j], 1e-14);
	}
}

static void test_a_state_whose_variance_is_set_is_independent_of_all_others(void **state)
{
	double before[N][N];

	(void)state;
	memcpy(before, p, sizeof(p));
	kalman_set_variance(N, p[0], 2, 9);
	for (int i = 0; i < N; i++)
		for (int j = 0; j < N; j++)
			assert_near(p[i][j], i == 2 && j == 2 ? 9 : i == 2 || j == 2 ? 0 : before[i][j], 0);
}

static void test_rows_transposed_and_rows_again_are_a_transition_of_the_covariance(void **state)
{
	const double m[6] = {1, 2, -3, 0.5, -1, 4};
	double f[N][N] = {{0}}, fp[N][N] = {{0}};

	(void)state;
	for (int i = 0; i < N; i++)
		f[i][i] = 1;
	for (int i = 0; i < 2; i++)
		for (int j = 0; j < 3; j++)
			f[1 + i][4 + j] = -m[3 * i + j];
	for (int i = 0; i < N; i++)
		for (int j = 0; j < N; j++)
			for (int k = 0; k < N; k++)
				fp[i][j] += f[i][k] * p[k][j];

	kalman_add_rows(N, p[0], 1, 2, -1, m, 4);
	kalman_transpose(N, p[0]);
	kalman_add_rows(N, p[0], 1, 2, -1, m, 4);
	for (int i = 0; i < N; i++)
		for (int j = 0; j < N; j++) {
			double fpf = 0;

			for (int k = 0; k < N; k++)
				fpf += fp[i][k] * f[j][k];
			assert_near(p[i][j], fpf, 1e-12);
		}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test_setup(test_an_update_corrects_all_states_by_the_gain, any_covariance),
		cmocka_unit_test_setup(
			test_consider_states_keep_value_and_variance_but_lose_covariance_with_the_estimated_ones,
			any_covariance),
		cmocka_unit_test_setup(test_a_state_whose_variance_is_set_is_independent_of_all_others, any_covariance),
		cmocka_unit_test_setup(
			test_rows_transposed_and_rows_again_are_a_transition_of_the_covariance, any_covariance),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
