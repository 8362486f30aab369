/* The functions of model/rope.h alone, against closed forms: a load on a rope whose point of hanging moves as it is
 * told. test_rope.c follows whole movements of a crane. */
#include "model_test.h"

#include "model/rope.h"

static const double G = 9.81, DT_S = 0.01, ROPE_M = 5;
static const struct vec3 ZERO = {0, 0, 0};
static const struct noise_config QUIET = {.gyro_density_rad_s_sqrt_hz = 0};

/* A motion of the load: its direction upwards along the rope, and the acceleration of the point it hangs from. */
struct load {
	struct vec3 accel_n_m_s2;
	double swing_rad, swing_hz;
};

/* Small swings about y: the rope leans by the angle towards x. */
static double angle(const struct load *l, double t)
{
	return l->swing_rad * sin(2 * PI * l->swing_hz * t);
}

static struct quat attitude(const struct load *l, double t)
{
	return quat_from_rotation_vector((struct vec3){0, angle(l, t), 0});
}

/* Acceleration of the load: of the point, less that of ROPE_M times the direction upwards (sin, 0, cos). */
static struct vec3 acceleration(const struct load *l, double t)
{
	const double w = 2 * PI * l->swing_hz, a = angle(l, t), rate = w * l->swing_rad * cos(w * t), turn = -w * w * a;
	const struct vec3 up2 = {turn * cos(a) - rate * rate * sin(a), 0, -turn * sin(a) - rate * rate * cos(a)};

	return vec3_sub(l->accel_n_m_s2, vec3_scale(ROPE_M, up2));
}

/* From `from_s` on for `s` seconds, in intervals of 4 samples, so that windows end within none. Returns how often there
 * was another difference. */
static int swing(struct rope *r, const struct load *l, double from_s, double s)
{
	int found = 0;

	for (int k = 0; k < (int)lround(s / DT_S / 4); k++) {
		struct navigation_sums sums = {.t_s = 0};
		double end = from_s;

		for (int i = 0; i < 4; i++) {
			const double t = from_s + (4 * k + i) * DT_S;
			const struct mat3 r_nb = mat3_from_quat(attitude(l, t));
			struct vec3 force = acceleration(l, t + DT_S);

			force.z += G;
			navigation_sums_add(&sums, &r_nb, ZERO, force, ZERO, DT_S);
			end = t + DT_S;
		}
		found += rope_swing(r, attitude(l, end), &sums, DT_S);
	}
	return found;
}

static struct rope hanging(const struct load *l)
{
	struct rope r = {.given_m = 0};

	rope_hang(&r, ROPE_M, attitude(l, 0));
	return r;
}

/* The length as told is known to a tenth; what was learnt of it holds until another one is told. */
static void test_a_length_as_told_is_known_to_a_tenth(void **state)
{
	const struct quat level = {1, 0, 0, 0};
	struct rope r = {.given_m = 0};

	(void)state;
	rope_hang(&r, 5, level);
	assert_near(r.length_m, 5, 0);
	assert_near(r.length_variance_m2, 0.25, 1e-12);
	r.length_m = 5.3;
	r.length_variance_m2 = 0.01;
	rope_hang(&r, 5, level);
	assert_near(r.length_m, 5.3, 0);
	assert_near(r.length_variance_m2, 0.01, 0);
	rope_hang(&r, 8, level);
	assert_near(r.length_m, 8, 0);
	assert_near(r.length_variance_m2, 0.64, 1e-12);
}

/* A window is a second, and a difference needs two of them; after a restart again. */
static void test_there_is_a_difference_each_second_from_the_second_one_on(void **state)
{
	const struct load l = {.swing_hz = 0.2};
	struct rope r = hanging(&l);

	(void)state;
	assert_int_equal(swing(&r, &l, 0, 1.96), 0);
	assert_int_equal(swing(&r, &l, 1.96, 0.08), 1);
	assert_int_equal(swing(&r, &l, 2.04, 2.96), 3);
	assert_int_equal(swing(&r, &l, 5, 10), 10);
	r.steady = 3;
	rope_restart(&r, attitude(&l, 15));
	assert_int_equal(r.steady, 0);
	assert_int_equal(swing(&r, &l, 15, 1.96), 0);
	assert_int_equal(swing(&r, &l, 16.96, 0.08), 1);
}

/* Whatever the load does, the second difference over a second is the acceleration of the point. */
static void test_the_second_difference_is_the_acceleration_of_the_point(void **state)
{
	static const struct load loads[] = {
		{{0, 0, 0}, 0, 1}, {{0.3, -0.2, 0.1}, 0, 1}, {{0, 0, 0}, 0.1, 0.3}, {{0.05, 0.1, -0.02}, 0.15, 0.23}};

	(void)state;
	for (size_t i = 0; i < sizeof(loads) / sizeof(loads[0]); i++) {
		struct rope r = hanging(&loads[i]);

		swing(&r, &loads[i], 0, 6);
		for (int which = 0; which < ROPE_DIFFERENCES; which++) {
			const struct rope_difference d = rope_difference(&r, which, &QUIET, G);

			assert_vec_near(d.point_n_m, loads[i].accel_n_m_s2, 2e-4);
			/* how the direction of the rope has turned; six windows end with the sixth second */
			const double t = which + 2, up[3] = {sin(angle(&loads[i], t - 1)), sin(angle(&loads[i], t)),
							    sin(angle(&loads[i], t + 1))};

			assert_near(d.up_n.x, up[2] - 2 * up[1] + up[0], 1e-9);
			assert_near(d.up_n.y, 0, 1e-12);
		}
	}
}

/* The variance of that: 3 mm/s^2 of what is steady; the gyro's noise turns the rope and the force; the accelerometer's
 * is integrated twice, in both windows. */
static void test_the_variance_of_a_difference_is_that_of_the_noise(void **state)
{
	const struct load l = {.swing_hz = 0.2};
	const double gyro = 0.002, accel = 0.01;
	struct noise_config noise = QUIET;
	struct rope r = hanging(&l);

	(void)state;
	swing(&r, &l, 0, 6);
	assert_near(rope_difference(&r, 3, &noise, G).variance_m2, 9e-6, 1e-15);
	noise.gyro_density_rad_s_sqrt_hz = gyro;
	assert_near(
		rope_difference(&r, 3, &noise, G).variance_m2, 9e-6 + gyro * gyro * (ROPE_M * ROPE_M + G * G), 1e-12);
	noise = QUIET;
	noise.accel_density_m_s2_sqrt_hz = accel;
	assert_near(rope_difference(&r, 3, &noise, G).variance_m2, 9e-6 + accel * accel / 3, 1e-12);
}

/* An error of the tilt turns the force; one of the bias adds to it: -[force]x theta - turned ba. */
static void test_a_difference_depends_on_tilt_and_bias_as_it_says(void **state)
{
	const struct load l = {{0.05, 0.1, -0.02}, 0.15, 0.23};
	const struct vec3 theta = {1e-5, -2e-5, 1.5e-5}, bias = {1e-4, 2e-4, -3e-4};
	struct rope r = hanging(&l);
	struct rope_difference before, after;

	(void)state;
	swing(&r, &l, 0, 6.5);
	for (int which = 0; which < ROPE_DIFFERENCES; which++) {
		struct rope corrected = r;

		before = rope_difference(&r, which, &QUIET, G);
		rope_correct(&corrected, theta, bias);
		after = rope_difference(&corrected, which, &QUIET, G);
		assert_vec_near(vec3_sub(after.point_n_m, before.point_n_m),
			vec3_sub(vec3_add(vec3_cross(theta, before.force_n_m),
					 vec3_scale(ROPE_M, vec3_cross(theta, before.up_n))),
				mat3_apply(before.turned_s2, bias)),
			1e-9);
		assert_vec_near(after.up_n, vec3_add(before.up_n, vec3_cross(theta, before.up_n)), 1e-9);
	}
}

/* The mean velocity over the last second: that of the point in its middle, whatever the load does. */
static void test_the_velocity_of_the_point_is_that_in_the_middle_of_the_last_second(void **state)
{
	static const struct load loads[] = {
		{{0, 0, 0}, 0.1, 0.3}, {{0.05, 0.1, -0.02}, 0, 1}, {{0.05, 0.1, 0}, 0.15, 0.23}};

	(void)state;
	for (size_t i = 0; i < sizeof(loads) / sizeof(loads[0]); i++) {
		const struct load *l = &loads[i];
		const double w = 2 * PI * l->swing_hz, end = 6 + DT_S / 2; /* sums of samples */
		struct rope r = hanging(l);
		struct vec3 load;

		swing(&r, l, 0, 6);
		/* at its end: of the point, less ROPE_M times the change of the direction */
		load = vec3_scale(end, l->accel_n_m_s2);
		load.x -= ROPE_M * w * l->swing_rad * cos(w * end) * cos(angle(l, end));
		load.z += ROPE_M * w * l->swing_rad * cos(w * end) * sin(angle(l, end));
		assert_vec_near(rope_point_velocity(&r, load, G), vec3_scale(5.5, l->accel_n_m_s2), 1e-3);
	}
}

/* By least squares: the length that explains the change, weighed with what was known. Only the horizontal counts. */
static void test_the_length_is_that_of_least_squares(void **state)
{
	const struct rope_difference earlier = {.point_n_m = {0.01, 0.02, 0.3},
					     .up_n = {0.1, 0.05, 0},
					     .variance_m2 = 1e-4},
				     later = {.point_n_m = {-0.02, 0.01, 0.3},
					     .up_n = {-0.1, 0.02, 0.2},
					     .variance_m2 = 2e-4};
	struct rope r = {.length_m = 5, .length_variance_m2 = 0.25};
	/* of -point = up . error, weighed by the noise 3e-4, and the prior */
	const double up2 = 0.2 * 0.2 + 0.03 * 0.03, information = up2 / 3e-4 + 1 / 0.25,
		     projection = -(-0.03 * -0.2 + -0.01 * -0.03) / 3e-4;

	(void)state;
	rope_measure_length(&r, &earlier, &later);
	assert_near(r.length_m, 5 + projection / information, 1e-9);
	assert_near(r.length_variance_m2, 1 / information, 1e-12);
}

/* What differs by more than 3 sigma on three axes is no error of the length. */
static void test_a_change_beyond_3_sigma_says_nothing_of_the_length(void **state)
{
	const double variance = 3e-4 + 0.25 * 0.04, limit = 3 * sqrt(variance + 2 * 3e-4);

	(void)state;
	for (int axis = 0; axis < 3; axis++)
		for (int beyond = 0; beyond < 2; beyond++) {
			const double off = limit * (beyond ? 1.01 : 0.99);
			const struct rope_difference earlier = {.variance_m2 = 1e-4},
						     later = {.point_n_m = {off * (axis == 0), off * (axis == 1),
								      off * (axis == 2)},
							     .up_n = {0.2, 0, 0},
							     .variance_m2 = 2e-4};
			struct rope r = {.length_m = 5, .length_variance_m2 = 0.25};

			rope_measure_length(&r, &earlier, &later);
			assert_int_equal(r.length_variance_m2 == 0.25, beyond);
		}
}

/* Two windows before another load are none of it. */
static void test_a_load_that_is_hung_up_anew_needs_two_windows_of_its_own(void **state)
{
	struct navigation_sums second = {.t_s = 1}, half = {.t_s = 0.5};
	struct quat q = quat_from_rotation_vector((struct vec3){0.1, -0.2, 0.3});
	struct rope rope = {.full = 0};

	(void)state;
	rope_hang(&rope, 5, QUAT_IDENTITY);
	assert_false(rope_swing(&rope, QUAT_IDENTITY, &second, 1));
	assert_true(rope_swing(&rope, QUAT_IDENTITY, &second, 1));
	assert_true(rope_swing(&rope, q, &second, 1));
	assert_false(rope_swing(&rope, q, &half, 1));
	rope_hang(&rope, 5, q);
	assert_near(rope.window[ROPE_WINDOWS - 1].sums.t_s, 0, 0);
	assert_vec_near(rope.window[ROPE_WINDOWS - 1].up_n, ((struct vec3){0, 0, 1}), 1e-12);
	assert_false(rope_swing(&rope, q, &second, 1));
	assert_true(rope_swing(&rope, q, &second, 1));
}

/* A steadily accelerated point, a rope that turns evenly: the middles of the windows are (ta + tb) / 2 apart, which is
 * the time for the difference of the velocities. */
static void test_a_difference_holds_for_windows_of_unequal_length(void **state)
{
	const struct vec3 accel = {0.3, -0.2, 0.1}, force = vec3_add(accel, (struct vec3){0, 0, G}),
			  turn = {0.01, 0.02, 0};
	const struct noise_config noise = {.gyro_density_rad_s_sqrt_hz = 1e-3, .accel_density_m_s2_sqrt_hz = 2e-3};
	const double s[2] = {1, 1.3}, s2 = 1.3 * (1 + 1.3) / 2;
	struct rope rope = {.length_m = ROPE_M};
	struct rope_window *window = &rope.window[ROPE_WINDOWS - 3]; /* the last two of a difference, and the next */
	struct rope_difference d;

	(void)state;
	window[0].up_n = (struct vec3){0.1, -0.1, 1};
	for (int w = 0; w < 2; w++) {
		struct navigation_sums *sums = &window[w].sums;

		sums->t_s = s[w];
		sums->f = vec3_scale(s[w], force);
		sums->ff = vec3_scale(s[w] * s[w] / 2, force);
		for (int i = 0; i < 3; i++) {
			sums->s.m[i][i] = s[w];
			sums->u.m[i][i] = s[w] * s[w] / 2;
		}
		window[w + 1].up_n = vec3_add(window[w].up_n, vec3_scale(s[w], turn));
	}
	d = rope_difference(&rope, ROPE_WINDOWS - 3, &noise, G);
	assert_vec_near(d.up_n, ZERO, 1e-12);
	assert_vec_near(d.point_n_m, vec3_scale(s2, accel), 1e-12);
	assert_vec_near(d.force_n_m, vec3_scale(s2, force), 1e-12);
	for (int i = 0; i < 9; i++)
		assert_near(d.turned_s2.m[i / 3][i % 3], i % 4 ? 0 : s2, 1e-12);
	assert_near(d.variance_m2,
		1e-6 * 1.3 * (ROPE_M * ROPE_M + G * G * pow(1.3, 4)) + 4e-6 / 2 * pow(1.3, 3) * 2 / 3 +
			9e-6 * pow(1.3, 4),
		1e-12);
	/* half of a window ago it was slower, and the rope's end moves with its turn */
	assert_vec_near(rope_point_velocity(&rope, (struct vec3){1, 2, 3}, G),
		vec3_add(vec3_sub((struct vec3){1, 2, 3}, vec3_scale(1.3 / 2, accel)), vec3_scale(ROPE_M, turn)), 1e-9);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_length_as_told_is_known_to_a_tenth),
		cmocka_unit_test(test_there_is_a_difference_each_second_from_the_second_one_on),
		cmocka_unit_test(test_the_second_difference_is_the_acceleration_of_the_point),
		cmocka_unit_test(test_the_variance_of_a_difference_is_that_of_the_noise),
		cmocka_unit_test(test_a_difference_depends_on_tilt_and_bias_as_it_says),
		cmocka_unit_test(test_the_velocity_of_the_point_is_that_in_the_middle_of_the_last_second),
		cmocka_unit_test(test_the_length_is_that_of_least_squares),
		cmocka_unit_test(test_a_change_beyond_3_sigma_says_nothing_of_the_length),
		cmocka_unit_test(test_a_load_that_is_hung_up_anew_needs_two_windows_of_its_own),
		cmocka_unit_test(test_a_difference_holds_for_windows_of_unequal_length),
	};

	return cmocka_run_group_tests_name("rope_windows", tests, NULL, NULL);
}
