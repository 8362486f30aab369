/* The oracle is numerical differentiation: rates and accelerations of signal_at() must be the derivatives of its
 * attitude and position. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>

#include "model/sim/rng.h"
#include "model/sim/sensor.h"
#include "model/sim/signal.h"
#include "model/math/units.h"

enum { INSTANTS = 300 };

/* Seven-point central difference: the error is of the order h^6. */
static const double STEP_S = 5e-4;
static const double WEIGHT[4] = {0, 45.0 / 60, -9.0 / 60, 1.0 / 60};

static double difference(const struct signal *signal, double t, double (*value)(const struct signal_truth *))
{
	double sum = 0;

	for (int k = 1; k <= 3; k++) {
		struct signal_truth after, before;

		signal_at(signal, t + k * STEP_S, &after);
		signal_at(signal, t - k * STEP_S, &before);
		sum += WEIGHT[k] * (value(&after) - value(&before));
	}
	return sum / STEP_S;
}

static double px(const struct signal_truth *s)
{
	return s->position_n_m.x;
}
static double py(const struct signal_truth *s)
{
	return s->position_n_m.y;
}
static double pz(const struct signal_truth *s)
{
	return s->position_n_m.z;
}
static double vx(const struct signal_truth *s)
{
	return s->velocity_n_m_s.x;
}
static double vy(const struct signal_truth *s)
{
	return s->velocity_n_m_s.y;
}
static double vz(const struct signal_truth *s)
{
	return s->velocity_n_m_s.z;
}
static double qw(const struct signal_truth *s)
{
	return s->q_nb.w;
}
static double qx(const struct signal_truth *s)
{
	return s->q_nb.x;
}
static double qy(const struct signal_truth *s)
{
	return s->q_nb.y;
}
static double qz(const struct signal_truth *s)
{
	return s->q_nb.z;
}
static double wx(const struct signal_truth *s)
{
	return s->omega_b_rad_s.x;
}
static double wy(const struct signal_truth *s)
{
	return s->omega_b_rad_s.y;
}
static double wz(const struct signal_truth *s)
{
	return s->omega_b_rad_s.z;
}
static double ax(const struct signal_truth *s)
{
	return s->angles_rad.x;
}
static double ay(const struct signal_truth *s)
{
	return s->angles_rad.y;
}
static double az(const struct signal_truth *s)
{
	return s->angles_rad.z;
}
static double dx(const struct signal_truth *s)
{
	return s->angles_dot_rad_s.x;
}
static double dy(const struct signal_truth *s)
{
	return s->angles_dot_rad_s.y;
}
static double dz(const struct signal_truth *s)
{
	return s->angles_dot_rad_s.z;
}

static void assert_near(struct vec3 a, struct vec3 b, double tolerance)
{
	double error = vec3_norm(vec3_sub(a, b));

	if (!(error <= tolerance * (1 + vec3_norm(b))))
		fail_msg("(%.12g %.12g %.12g), expected (%.12g %.12g %.12g)", a.x, a.y, a.z, b.x, b.y, b.z);
}

static struct vec3 derivative(const struct signal *signal, double t, double (*x)(const struct signal_truth *),
	double (*y)(const struct signal_truth *), double (*z)(const struct signal_truth *))
{
	return (struct vec3){difference(signal, t, x), difference(signal, t, y), difference(signal, t, z)};
}

/* omega_b = 2 q* dq/dt */
static struct vec3 rate_from_attitude(const struct signal *signal, double t)
{
	struct quat dq = {difference(signal, t, qw), difference(signal, t, qx), difference(signal, t, qy),
		difference(signal, t, qz)};
	struct signal_truth truth;

	signal_at(signal, t, &truth);
	dq = quat_multiply(quat_conjugate(truth.q_nb), dq);
	return (struct vec3){2 * dq.x, 2 * dq.y, 2 * dq.z};
}

/* Instants away from the joints of piecewise motions, which are multiples of 0.05 s. */
static double instant(struct rng *rng)
{
	return 0.05 * (double)(rng_u64(rng) % 800) + 0.01 + 0.03 * rng_uniform(rng);
}

static void for_all(void (*check)(const struct signal *, double t))
{
	struct rng rng;

	rng_init(&rng, 3);
	for (const struct signal *signal = SIGNALS; signal->name; signal++)
		for (int i = 0; i < INSTANTS; i++)
			check(signal, instant(&rng));
}

static void check_translation(const struct signal *signal, double t)
{
	struct signal_truth truth;

	signal_at(signal, t, &truth);
	assert_near(truth.velocity_n_m_s, derivative(signal, t, px, py, pz), 1e-9);
	assert_near(truth.accel_n_m_s2, derivative(signal, t, vx, vy, vz), 1e-9);
}

static void test_velocity_and_acceleration_are_the_derivatives_of_the_position(void **state)
{
	(void)state;
	for_all(check_translation);
}

static void check_angles(const struct signal *signal, double t)
{
	struct signal_truth truth;

	signal_at(signal, t, &truth);
	assert_near(truth.angles_dot_rad_s, derivative(signal, t, ax, ay, az), 1e-9);
	assert_near(truth.angles_ddot_rad_s2, derivative(signal, t, dx, dy, dz), 1e-9);
}

static void test_the_angles_have_their_derivatives(void **state)
{
	(void)state;
	for_all(check_angles);
}

static void check_rotation(const struct signal *signal, double t)
{
	struct signal_truth truth;

	signal_at(signal, t, &truth);
	assert_near(truth.omega_b_rad_s, rate_from_attitude(signal, t), 1e-9);
	assert_near(truth.alpha_b_rad_s2, derivative(signal, t, wx, wy, wz), 1e-9);
}

static void test_rate_and_angular_acceleration_are_the_derivatives_of_the_attitude(void **state)
{
	(void)state;
	for_all(check_rotation);
}

/* Rotations about z, y, x in this order, as a product of three quaternions. */
static void check_attitude(const struct signal *signal, double t)
{
	struct signal_truth truth;
	struct vec3 a;
	struct quat q;

	signal_at(signal, t, &truth);
	a = truth.angles_rad;
	q = quat_multiply(quat_from_rotation_vector((struct vec3){0, 0, a.z}),
		quat_multiply(quat_from_rotation_vector((struct vec3){0, a.y, 0}),
			quat_from_rotation_vector((struct vec3){a.x, 0, 0})));
	q = quat_multiply(quat_conjugate(q), truth.q_nb);
	assert_true(fabs(fabs(q.w) - 1) < 1e-12);
	assert_near((struct vec3){q.x, q.y, q.z}, (struct vec3){0, 0, 0}, 1e-12);
}

static void test_the_attitude_is_yaw_then_pitch_then_roll(void **state)
{
	(void)state;
	for_all(check_attitude);
}

static void check_period(const struct signal *signal, double t)
{
	struct signal_truth now, later;

	signal_at(signal, t, &now);
	signal_at(signal, t + 100 * signal->period_s, &later);
	assert_near(later.position_n_m, now.position_n_m, 1e-9);
	assert_near(later.accel_n_m_s2, now.accel_n_m_s2, 1e-7);
	assert_near(later.alpha_b_rad_s2, now.alpha_b_rad_s2, 1e-7);
}

static void test_every_motion_repeats(void **state)
{
	(void)state;
	for_all(check_period);
}

static void test_every_motion_is_continuous_at_the_end_of_its_period(void **state)
{
	(void)state;
	for (const struct signal *signal = SIGNALS; signal->name; signal++) {
		struct signal_truth first, last;
		struct quat turn;

		signal_at(signal, 0, &first);
		signal_at(signal, signal->period_s * (1 - 1e-12), &last);
		turn = quat_multiply(quat_conjugate(first.q_nb), last.q_nb);
		assert_near(last.position_n_m, first.position_n_m, 1e-9);
		assert_near(last.velocity_n_m_s, first.velocity_n_m_s, 1e-9);
		assert_near(last.accel_n_m_s2, first.accel_n_m_s2, 1e-9);
		assert_near(last.alpha_b_rad_s2, first.alpha_b_rad_s2, 1e-8);
		assert_true(fabs(fabs(turn.w) - 1) < 1e-9);
	}
}

static void test_the_robot_stands_still_at_the_corners_of_its_square(void **state)
{
	const struct vec3 corner[4] = {{2, 0, 0}, {2, 2, 0}, {0, 2, 0}, {0, 0, 0}};

	(void)state;
	for (int side = 0; side < 4; side++) {
		struct signal_truth truth;

		signal_at(signal_find("square"), 10 * side + 7.5, &truth);
		assert_near(truth.position_n_m, corner[side], 1e-12);
		assert_near(truth.velocity_n_m_s, (struct vec3){0, 0, 0}, 1e-12);
		assert_near(truth.omega_b_rad_s, (struct vec3){0, 0, 0}, 1e-12);
		signal_at(signal_find("square"), 10 * side + 4.5, &truth);
		assert_true(vec3_norm(truth.velocity_n_m_s) > 0.5);
		assert_true(vec3_norm(truth.omega_b_rad_s) > 0.05);
	}
}

static void test_the_robot_drives_forward_along_its_longitudinal_axis(void **state)
{
	(void)state;
	for (int side = 0; side < 4; side++) {
		struct signal_truth truth;
		struct vec3 v;

		signal_at(signal_find("square"), 10 * side + 4.5, &truth);
		v = quat_rotate_inverse(truth.q_nb, truth.velocity_n_m_s);
		assert_true(v.x > 0.5 && fabs(v.y) < 0.1);
	}
}

/* The paper, sections V A and VI: p^2 r above 0.5 g, up to 0.8 g, at r = 5 cm. */
static void test_the_roll_step_gives_the_correction_of_the_paper_0_8_g_at_5_cm(void **state)
{
	double peak = 0;

	(void)state;
	for (double t = 0; t < 4; t += 1e-4) {
		struct signal_truth truth;

		signal_at(signal_find("roll_step"), t, &truth);
		peak = fmax(peak, truth.omega_b_rad_s.x * truth.omega_b_rad_s.x * 0.05);
	}
	assert_true(peak > 0.8 * 9.81 && peak < 0.82 * 9.81);
}

static void test_a_turntable_has_the_centripetal_acceleration_rate_squared_times_radius(void **state)
{
	struct signal turntable = *signal_find("turntable");
	struct signal_truth truth;
	struct vec3 force;

	(void)state;
	turntable.angle_rad = 10;
	turntable.change_s = 1;
	signal_at(&turntable, 0.3, &truth);
	force = sensor_specific_force(&truth, (struct vec3){0.1, 0, 0}, 9.81);
	assert_near(force, (struct vec3){-10, 0, 9.81}, 1e-12);
}

/* Tangential A w^2 r at the turning point, centripetal A^2 w^2 r at the lowest point. */
static void test_a_pendulum_has_the_tangential_and_centripetal_acceleration_of_the_textbook(void **state)
{
	const struct signal *pendulum = signal_find("pendulum");
	const double a = pendulum->angle_rad, w = 2 * PI / pendulum->change_s, r = 0.2, g = 9.81;
	struct signal_truth truth;
	struct vec3 force;

	(void)state;
	signal_at(pendulum, 0, &truth);
	force = sensor_specific_force(&truth, (struct vec3){0, 0, -r}, g);
	assert_near(force, (struct vec3){0, 0, g + a * a * w * w * r}, 1e-12);
	signal_at(pendulum, pendulum->change_s / 4, &truth);
	force = sensor_specific_force(&truth, (struct vec3){0, 0, -r}, g);
	assert_near(force, (struct vec3){0, g * sin(a) - a * w * w * r, g * cos(a)}, 1e-12);
}

static void test_an_unknown_name_gives_no_signal(void **state)
{
	(void)state;
	assert_null(signal_find("squar"));
	assert_null(signal_find(""));
}

/* Accelerometer calibrations need these 14 attitudes; the turn to the next one ends each stay. */
static void test_the_multiposition_signal_rests_on_every_face_and_every_corner(void **state)
{
	const struct signal *signal = signal_find("multiposition");
	bool up[3][3][3] = {{{false}}};
	int faces = 0, corners = 0;

	(void)state;
	for (int stay = 0; stay < 14; stay++) {
		struct signal_truth truth;
		struct vec3 u;
		int axes;

		signal_at(signal, (stay + 0.5) * signal->period_s / 14, &truth);
		u = quat_rotate_inverse(truth.q_nb, (struct vec3){0, 0, 1});
		assert_near(truth.omega_b_rad_s, (struct vec3){0, 0, 0}, 1e-12);
		u = (struct vec3){round(u.x), round(u.y), round(u.z)};
		axes = (int)vec3_dot(u, u);
		assert_near(
			quat_rotate_inverse(truth.q_nb, (struct vec3){0, 0, 1}), vec3_scale(1 / sqrt(axes), u), 1e-4);
		assert_false(up[(int)u.x + 1][(int)u.y + 1][(int)u.z + 1]);
		up[(int)u.x + 1][(int)u.y + 1][(int)u.z + 1] = true;
		faces += axes == 1;
		corners += axes == 3;
	}
	assert_int_equal(faces, 6);
	assert_int_equal(corners, 8);
}

/* On deep water the accelerations of a wave of slope s are s g (Airy); the boat follows half of the wave's height. */
static void test_the_boat_heaves_with_half_the_acceleration_of_its_wave(void **state)
{
	const struct signal *boat = signal_find("boat");
	double most = 0;

	(void)state;
	for (double t = 0; t < boat->period_s; t += 0.01) {
		struct signal_truth truth;

		signal_at(boat, t, &truth);
		most = fmax(most, fabs(truth.accel_n_m_s2.z));
	}
	assert_true(fabs(most / (boat->angle_rad * 9.81 / 2) - 1) < 0.15);
}

/* The wheelbase is 0.3 m: a bump that pitches the robot by the angle lifts its centre by 0.15 m times that. */
static void test_rough_ground_rolls_pitches_and_lifts_the_robot_by_its_angle_while_it_drives(void **state)
{
	const struct signal *square = signal_find("square");
	struct vec3 most = {0, 0, 0};

	(void)state;
	for (double t = 0; t < square->period_s; t += 0.002) {
		struct signal_truth truth;

		signal_at(square, t, &truth);
		most.x = fmax(most.x, fabs(truth.angles_rad.x));
		most.y = fmax(most.y, fabs(truth.angles_rad.y));
		most.z = fmax(most.z, fabs(truth.position_n_m.z) / 0.15);
	}
	most = vec3_scale(1 / (3 * RAD_PER_DEG), most);
	assert_true(most.x > 0.99 && most.x <= 1);
	assert_true(most.y > 0.99 && most.y <= 1);
	assert_true(most.z > 0.99 && most.z <= 1);
}

enum ground { GROUND_ROLL, GROUND_PITCH, GROUND_HEIGHT };

/* The amplitude of a wave of that period, while the robot drives along the first side at full speed. A Hann window
 * separates it from others. */
static double wave_of(enum ground what, double period_s)
{
	double in_phase = 0, across = 0;
	const int n = 2400;

	for (int k = 0; k < n; k++) {
		double t = 3.3 + k * 1e-3, window = 1 - cos(2 * PI * (k + 0.5) / n), value;
		struct signal_truth truth;

		signal_at(signal_find("square"), t, &truth);
		value = what == GROUND_ROLL    ? truth.angles_rad.x
			: what == GROUND_PITCH ? truth.angles_rad.y
					       : truth.position_n_m.z / 0.15; /* half of a wheelbase */
		in_phase += window * value * cos(2 * PI / period_s * t) * 2 / n;
		across += window * value * sin(2 * PI / period_s * t) * 2 / n;
	}
	return hypot(in_phase, across);
}

/* Two waves each, none a multiple of another, of which one has 0.2 s. */
static void test_rough_ground_has_bumps_of_0_2_to_0_6_s(void **state)
{
	static const struct {
		enum ground what;
		double period_s, share;
	} waves[] = {{GROUND_ROLL, 0.2, 0.7}, {GROUND_ROLL, 0.46, 0.3}, {GROUND_PITCH, 0.26, 0.6},
		{GROUND_PITCH, 0.62, 0.4}, {GROUND_HEIGHT, 0.2, 0.5}, {GROUND_HEIGHT, 0.34, 0.5}};

	(void)state;
	for (size_t i = 0; i < sizeof waves / sizeof *waves; i++)
		if (fabs(wave_of(waves[i].what, waves[i].period_s) / (waves[i].share * 3 * RAD_PER_DEG) - 1) > 0.05)
			fail_msg("%zu: %g", i, wave_of(waves[i].what, waves[i].period_s) / 3 / RAD_PER_DEG);
	assert_true(wave_of(GROUND_ROLL, 0.25) < 0.05 * wave_of(GROUND_ROLL, 0.2));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_velocity_and_acceleration_are_the_derivatives_of_the_position),
		cmocka_unit_test(test_the_angles_have_their_derivatives),
		cmocka_unit_test(test_rate_and_angular_acceleration_are_the_derivatives_of_the_attitude),
		cmocka_unit_test(test_the_attitude_is_yaw_then_pitch_then_roll),
		cmocka_unit_test(test_every_motion_repeats),
		cmocka_unit_test(test_every_motion_is_continuous_at_the_end_of_its_period),
		cmocka_unit_test(test_the_robot_stands_still_at_the_corners_of_its_square),
		cmocka_unit_test(test_the_robot_drives_forward_along_its_longitudinal_axis),
		cmocka_unit_test(test_the_roll_step_gives_the_correction_of_the_paper_0_8_g_at_5_cm),
		cmocka_unit_test(test_a_turntable_has_the_centripetal_acceleration_rate_squared_times_radius),
		cmocka_unit_test(test_a_pendulum_has_the_tangential_and_centripetal_acceleration_of_the_textbook),
		cmocka_unit_test(test_rough_ground_has_bumps_of_0_2_to_0_6_s),
		cmocka_unit_test(test_an_unknown_name_gives_no_signal),
		cmocka_unit_test(test_the_multiposition_signal_rests_on_every_face_and_every_corner),
		cmocka_unit_test(test_the_boat_heaves_with_half_the_acceleration_of_its_wave),
		cmocka_unit_test(test_rough_ground_rolls_pitches_and_lifts_the_robot_by_its_angle_while_it_drives),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
