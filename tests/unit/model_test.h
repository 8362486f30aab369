/* tests/unit/model_test.h
 * Shared by the tests of model/: cmocka, comparison of doubles and vectors, and repeatable random motions. */
#ifndef TESTS_UNIT_MODEL_TEST_H
#define TESTS_UNIT_MODEL_TEST_H

#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <errno.h>
#include <cmocka.h>

#include "model/math/quat.h"
#include "model/math/units.h"

#define assert_near(a, b, tolerance)	 assert_near_at(a, b, tolerance, #a, __FILE__, __LINE__)
#define assert_vec_near(a, b, tolerance) assert_vec_near_at(a, b, tolerance, #a, __FILE__, __LINE__)
/* q and -q are the same rotation. */
#define assert_quat_near(a, b, tolerance) assert_near_at(quat_apart_rad(a, b), 0, tolerance, #a, __FILE__, __LINE__)

static inline void assert_near_at(double a, double b, double tolerance, const char *what, const char *file, int line)
{
	if (fabs(a - b) <= tolerance)
		return;
	print_error("%s is %.17g, not %.17g within %g\n", what, a, b, tolerance);
	_fail(file, line);
}

static inline void assert_vec_near_at(
	struct vec3 a, struct vec3 b, double tolerance, const char *what, const char *file, int line)
{
	assert_near_at(a.x, b.x, tolerance, what, file, line);
	assert_near_at(a.y, b.y, tolerance, what, file, line);
	assert_near_at(a.z, b.z, tolerance, what, file, line);
}

/** The angle between two attitudes. */
static inline double quat_apart_rad(struct quat a, struct quat b)
{
	struct quat d = quat_multiply(quat_conjugate(a), b);

	return 2 * atan2(sqrt(d.x * d.x + d.y * d.y + d.z * d.z), fabs(d.w));
}

/** Uniform in -1..1; xorshift64*, the same sequence in every run of a test program. */
static inline double any(void)
{
	static uint64_t state = 88172645463325252u;

	state ^= state >> 12;
	state ^= state << 25;
	state ^= state >> 27;
	return (double)(int64_t)(state * 2685821657736338717u) / 9223372036854775808.0;
}

static inline struct vec3 any_vec(double most)
{
	struct vec3 v;

	v.x = most * any();
	v.y = most * any();
	v.z = most * any();
	return v;
}

static inline struct quat any_attitude(void)
{
	struct quat q;

	do {
		q.w = any();
		q.x = any();
		q.y = any();
		q.z = any();
	} while (q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z < 0.01);
	return quat_normalize(q);
}

#endif
