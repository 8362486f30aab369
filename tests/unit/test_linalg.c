/* Small symmetric systems, checked by substitution. */
#include "model_test.h"

#include <string.h>

#include "model/math/linalg.h"

/* B B' + 0.1 I, which is positive definite. */
static void any_positive(int n, double *a)
{
	double b[LINALG_MAX * LINALG_MAX];

	for (int i = 0; i < n * n; i++)
		b[i] = any();
	for (int i = 0; i < n; i++)
		for (int j = 0; j < n; j++) {
			a[i * n + j] = i == j ? 0.1 : 0;
			for (int k = 0; k < n; k++)
				a[i * n + j] += b[i * n + k] * b[j * n + k];
		}
}

static void test_a_solution_satisfies_its_system(void **state)
{
	(void)state;
	for (int n = 1; n <= LINALG_MAX; n++) {
		double a[LINALG_MAX * LINALG_MAX], copy[LINALG_MAX * LINALG_MAX], x[LINALG_MAX], b[LINALG_MAX];

		any_positive(n, a);
		memcpy(copy, a, sizeof a);
		for (int i = 0; i < n; i++)
			x[i] = b[i] = any();
		assert_int_equal(linalg_solve(n, copy, x), 0);
		for (int i = 0; i < n; i++) {
			double sum = 0;

			for (int k = 0; k < n; k++)
				sum += a[i * n + k] * x[k];
			assert_near(sum, b[i], 1e-10);
		}
	}
}

static void test_a_matrix_times_its_inverse_is_the_identity(void **state)
{
	(void)state;
	for (int n = 1; n <= LINALG_MAX; n++) {
		double a[LINALG_MAX * LINALG_MAX], inverse[LINALG_MAX * LINALG_MAX];

		any_positive(n, a);
		memcpy(inverse, a, sizeof a);
		assert_int_equal(linalg_invert(n, inverse), 0);
		for (int i = 0; i < n; i++)
			for (int j = 0; j < n; j++) {
				double sum = 0;

				for (int k = 0; k < n; k++)
					sum += a[i * n + k] * inverse[k * n + j];
				assert_near(sum, i == j, 1e-9);
			}
	}
}

static void test_eigenvectors_are_scaled_by_their_eigenvalues_in_ascending_order(void **state)
{
	(void)state;
	for (int n = 1; n <= LINALG_MAX; n++) {
		double a[LINALG_MAX * LINALG_MAX], copy[LINALG_MAX * LINALG_MAX];
		double values[LINALG_MAX], vectors[LINALG_MAX * LINALG_MAX];

		for (int i = 0; i < n; i++)
			for (int j = 0; j <= i; j++)
				a[i * n + j] = a[j * n + i] = any();
		memcpy(copy, a, sizeof a);
		assert_int_equal(linalg_eigen(n, copy, values, vectors), 0);
		for (int k = 0; k < n; k++) {
			double length = 0;

			assert_true(k == 0 || values[k] >= values[k - 1]);
			for (int i = 0; i < n; i++) {
				double sum = 0;

				for (int j = 0; j < n; j++)
					sum += a[i * n + j] * vectors[k * n + j];
				assert_near(sum, values[k] * vectors[k * n + i], 1e-12);
				length += vectors[k * n + i] * vectors[k * n + i];
			}
			assert_near(length, 1, 1e-12);
		}
	}
}

static void test_a_singular_an_indefinite_and_a_non_finite_matrix_are_refused(void **state)
{
	double singular[] = {1, 2, 2, 4}, indefinite[] = {1, 2, 2, 1}, not_finite[] = {1, 0, 0, NAN}, b[] = {3, 4};
	double values[2], vectors[4];

	(void)state;
	assert_int_equal(linalg_solve(2, singular, b), -EDOM);
	assert_int_equal(linalg_invert(2, indefinite), -EDOM);
	assert_int_equal(linalg_invert(2, not_finite), -EDOM);
	assert_true(b[0] == 3 && b[1] == 4);
	not_finite[3] = NAN;
	assert_int_equal(linalg_eigen(2, not_finite, values, vectors), -EDOM);
}

/* The second pivot is this share of its diagonal element, at any size of the matrix. */
static void test_a_matrix_that_is_singular_but_for_rounding_is_refused_at_any_size(void **state)
{
	(void)state;
	for (double size = 1e-9; size < 1e10; size *= 1e3)
		for (int regular = 0; regular < 2; regular++) {
			double share = regular ? 4e-13 : 0.4e-13, a[] = {size, size, size, size * (1 + share)};
			double b[] = {1, 2};

			assert_int_equal(linalg_solve(2, a, b), regular ? 0 : -EDOM);
		}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_solution_satisfies_its_system),
		cmocka_unit_test(test_a_matrix_times_its_inverse_is_the_identity),
		cmocka_unit_test(test_eigenvectors_are_scaled_by_their_eigenvalues_in_ascending_order),
		cmocka_unit_test(test_a_matrix_that_is_singular_but_for_rounding_is_refused_at_any_size),
		cmocka_unit_test(test_a_singular_an_indefinite_and_a_non_finite_matrix_are_refused),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
