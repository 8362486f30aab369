/* The paper's equations (1)-(6) and the conversions between its angles, quaternions and aerospace angles. */
#include "model_test.h"

#include "model/math/rotation.h"

static void assert_mat_near(struct mat3 a, struct mat3 b, double tolerance)
{
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			assert_near(a.m[i][j], b.m[i][j], tolerance);
}

/* Roll and yaw of the whole circle, pitch within 88 degrees. */
static struct vec3 any_angles(void)
{
	struct vec3 angles = any_vec(PI);

	angles.y *= 0.49;
	return angles;
}

static struct quat turn_about(double x, double y, double z, double angle)
{
	return quat_from_rotation_vector((struct vec3){x * angle, y * angle, z * angle});
}

static const struct mat3 IDENTITY = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};

static void test_eq2_to_4_are_passive_rotations_about_one_axis(void **state)
{
	double angle = 0.3;

	/* Passive: the matrix is the transpose of the one that turns a vector by +angle about that axis. */
	(void)state;
	assert_mat_near(seed_rx(angle), mat3_from_quat(turn_about(1, 0, 0, -angle)), 1e-15);
	assert_mat_near(seed_ry(angle), mat3_from_quat(turn_about(0, 1, 0, -angle)), 1e-15);
	assert_mat_near(seed_rz(angle), mat3_from_quat(turn_about(0, 0, 1, -angle)), 1e-15);
}

static void test_eq5_is_the_product_of_eq2_to_4(void **state)
{
	(void)state;
	for (int i = 0; i < 1000; i++) {
		struct vec3 a = any_vec(2 * PI);
		struct mat3 product = mat3_multiply(seed_rx(a.x), mat3_multiply(seed_ry(a.y), seed_rz(a.z)));

		assert_mat_near(seed_rxyz(a), product, 1e-14);
	}
}

static void test_eq5_with_element_21_as_printed_is_not_a_rotation(void **state)
{
	struct vec3 a = {0.4, -0.7, 1.1};
	struct mat3 r = seed_rxyz(a), printed = r;

	(void)state;
	printed.m[1][0] = -cos(a.x) * sin(a.z) + sin(a.x) * sin(a.y) * sin(a.z);
	assert_mat_near(mat3_multiply(r, mat3_transpose(r)), IDENTITY, 1e-15);
	assert_true(fabs(mat3_multiply(printed, mat3_transpose(printed)).m[1][1] - 1) > 0.1);
}

static void test_eq6_is_the_inverse_and_the_transpose_of_eq5(void **state)
{
	(void)state;
	for (int i = 0; i < 1000; i++) {
		struct vec3 a = any_vec(2 * PI);

		assert_mat_near(mat3_multiply(seed_rxyz(a), seed_rxyz_inverse(a)), IDENTITY, 1e-14);
		assert_mat_near(seed_rxyz_inverse(a), mat3_transpose(seed_rxyz(a)), 1e-14);
	}
}

static void test_the_seeds_matrix_and_the_quaternion_of_its_angles_agree(void **state)
{
	(void)state;
	for (int i = 0; i < 1000; i++) {
		struct vec3 a = any_vec(2 * PI), v = any_vec(10);

		assert_vec_near(mat3_apply(seed_rxyz(a), v), quat_rotate(quat_from_seed_angles(a), v), 1e-13);
	}
}

static void test_seed_angles_convert_to_a_quaternion_and_back(void **state)
{
	(void)state;
	for (int i = 0; i < 1000; i++) {
		struct vec3 a = any_angles();

		assert_vec_near(seed_angles_from_quat(quat_from_seed_angles(a)), a, 1e-13);
	}
}

static void test_aerospace_angles_are_yaw_then_pitch_then_roll(void **state)
{
	struct quat q = quat_multiply(
		turn_about(0, 0, 1, 0.9), quat_multiply(turn_about(0, 1, 0, -0.4), turn_about(1, 0, 0, 2.5)));

	(void)state;
	assert_quat_near(quat_from_aerospace((struct vec3){2.5, -0.4, 0.9}), q, 1e-15);
	assert_vec_near(aerospace_from_quat(q), ((struct vec3){2.5, -0.4, 0.9}), 1e-15);
}

static void test_aerospace_angles_convert_to_a_quaternion_and_back(void **state)
{
	(void)state;
	for (int i = 0; i < 1000; i++) {
		struct vec3 a = any_angles();
		struct quat q = quat_from_aerospace(a);
		struct quat minus_q = {-q.w, -q.x, -q.y, -q.z};

		assert_vec_near(aerospace_from_quat(q), a, 1e-13);
		assert_vec_near(aerospace_from_quat(minus_q), a, 1e-13);
	}
}

static void test_angles_near_gimbal_lock_still_define_the_attitude(void **state)
{
	(void)state;
	for (double off = 1e-1; off > 1e-12; off /= 3)
		for (int sign = -1; sign <= 1; sign += 2) {
			struct vec3 a = {2 * any(), sign * (PI / 2 - off), 2 * any()};
			struct quat q = quat_from_aerospace(a);

			assert_quat_near(quat_from_aerospace(aerospace_from_quat(q)), q,
				off < GIMBAL_LOCK_RAD ? 2 * GIMBAL_LOCK_RAD : 1e-14);
			q = quat_from_seed_angles(a);
			assert_quat_near(quat_from_seed_angles(seed_angles_from_quat(q)), q,
				off < GIMBAL_LOCK_RAD ? 2 * GIMBAL_LOCK_RAD : 1e-14);
		}
}

static void test_in_gimbal_lock_roll_is_zero_and_yaw_turns_with_the_object(void **state)
{
	(void)state;
	for (int sign = -1; sign <= 1; sign += 2)
		for (double yaw = -3; yaw < 3; yaw += 0.1) {
			struct vec3 lock = {0, sign * PI / 2, yaw};

			assert_vec_near(aerospace_from_quat(quat_from_aerospace(lock)), lock, 1e-8);
		}
}

static void test_pitch_stays_within_a_quarter_turn(void **state)
{
	(void)state;
	for (int i = 0; i < 1000; i++)
		assert_true(fabs(aerospace_from_quat(any_attitude()).y) <= PI / 2);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_eq2_to_4_are_passive_rotations_about_one_axis),
		cmocka_unit_test(test_eq5_is_the_product_of_eq2_to_4),
		cmocka_unit_test(test_eq5_with_element_21_as_printed_is_not_a_rotation),
		cmocka_unit_test(test_eq6_is_the_inverse_and_the_transpose_of_eq5),
		cmocka_unit_test(test_the_seeds_matrix_and_the_quaternion_of_its_angles_agree),
		cmocka_unit_test(test_seed_angles_convert_to_a_quaternion_and_back),
		cmocka_unit_test(test_aerospace_angles_are_yaw_then_pitch_then_roll),
		cmocka_unit_test(test_aerospace_angles_convert_to_a_quaternion_and_back),
		cmocka_unit_test(test_angles_near_gimbal_lock_still_define_the_attitude),
		cmocka_unit_test(test_in_gimbal_lock_roll_is_zero_and_yaw_turns_with_the_object),
		cmocka_unit_test(test_pitch_stays_within_a_quarter_turn),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
