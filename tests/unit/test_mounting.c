/* The mounting that imu9-commission computes from two poses. */
#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include "model/math/rotation.h"
#include "model/math/units.h"
#include "tools/commission/mounting.h"

static const struct vec3 LEVEL = {0, 0, 9.81};

/* The front raised by an angle turns the vertical towards l. */
static struct vec3 raised(double angle_deg)
{
	return (struct vec3){9.81 * sin(RAD_PER_DEG * angle_deg), 0, 9.81 * cos(RAD_PER_DEG * angle_deg)};
}

static void test_two_poses_give_the_rotation_of_the_sensor_in_the_object(void **state)
{
	static const struct vec3 MOUNTINGS_DEG[] = {{0, 0, 0}, {20, -35, 110}, {180, 0, 0}, {-90, 0, 90}, {5, 89, -170},
		{0, 90, 30}, {0, -90, 200}, {120, 60, -60}};
	static const double ANGLES_DEG[] = {25, 45, 90};

	(void)state;
	for (size_t i = 0; i < sizeof MOUNTINGS_DEG / sizeof MOUNTINGS_DEG[0]; i++)
		for (size_t k = 0; k < 3; k++) {
			struct quat q = quat_from_aerospace(vec3_scale(RAD_PER_DEG, MOUNTINGS_DEG[i]));
			struct quat found = quat_from_aerospace(mounting_from_poses(
				quat_rotate_inverse(q, LEVEL), quat_rotate_inverse(q, raised(ANGLES_DEG[k]))));
			struct vec3 error = quat_to_rotation_vector(quat_multiply(found, quat_conjugate(q)));

			assert_true(vec3_norm(error) < 1e-6);
		}
}

/* Each of the six components of the forces is wrong in turn, by little. */
static void test_sigma_is_the_root_of_the_sum_of_the_squared_effects_of_each_error(void **state)
{
	(void)state;
	for (double angle_deg = 25; angle_deg <= 90; angle_deg += 20) {
		const double off = 1e-4;
		double square[3] = {0};
		struct vec3 sigma = mounting_sigma_rad(LEVEL, raised(angle_deg), off);

		for (int i = 0; i < 6; i++) {
			struct vec3 f[2] = {LEVEL, raised(angle_deg)};
			struct vec3 *v = &f[i / 3];

			*(i % 3 == 0 ? &v->x : i % 3 == 1 ? &v->y : &v->z) += off;
			struct vec3 error = mounting_from_poses(f[0], f[1]);
			square[0] += error.x * error.x;
			square[1] += error.y * error.y;
			square[2] += error.z * error.z;
		}
		assert_true(fabs(sqrt(square[0]) / sigma.x - 1) < 0.01);
		assert_true(fabs(sqrt(square[1]) / sigma.y - 1) < 0.01);
		assert_true(fabs(sqrt(square[2]) / sigma.z - 1) < 0.01);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_two_poses_give_the_rotation_of_the_sensor_in_the_object),
		cmocka_unit_test(test_sigma_is_the_root_of_the_sum_of_the_squared_effects_of_each_error),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
