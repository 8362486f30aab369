/* Calibrations estimate the errors of a simulated chip within their stated sigma, and refuse unsuitable data. Each seed
 * of model/sim/sensor is another chip: bias, scale, cross-axis errors and noise are drawn from it. */
#include "model_test.h"

#include <stdlib.h>
#include <string.h>

#include "model/identify/calibrate_accelerometer.h"
#include "model/identify/calibrate_gyro.h"
#include "model/identify/calibrate_magnetometer.h"
#include "model/identify/calibrate_temperature.h"
#include "model/identify/ellipsoid.h"
#include "model/sim/sensor.h"

#define G 9.81

enum { CHIPS = 24 };
static const char FINE[] = "lsm303dlhc_l3gd20_fine";

/* ---- simulated chips --------------------------------------------------------------------------------------------- */

static struct sensor sensor;
static struct sensor_config chip;

static void new_chip_of(const char *preset, uint64_t seed)
{
	chip = *sensor_preset(preset);
	assert_int_equal(sensor_init(&sensor, &chip, seed), 0);
}

static void new_chip(uint64_t seed)
{
	new_chip_of(FINE, seed);
}

static struct imu_sample next(const struct signal *signal)
{
	struct imu_sample s;

	sensor_next(&sensor, signal, &s, NULL);
	return s;
}

static double square(double error, double sigma)
{
	return error * error / (sigma * sigma);
}

/* Mean over the axes of the normalised error squared: 1 on average if sigma is right. */
static double normalised(struct vec3 found, struct vec3 truth, struct vec3 sigma)
{
	struct vec3 e = vec3_sub(found, truth);

	return (square(e.x, sigma.x) + square(e.y, sigma.y) + square(e.z, sigma.z)) / 3;
}

/* The chip's measurement of v, corrected. */
static struct vec3 corrected(const struct triad_calibration *c, const struct triad *t, struct vec3 v)
{
	struct mat3 m, s;

	memcpy(m.m, c->matrix, sizeof m.m);
	memcpy(s.m, t->matrix, sizeof s.m);
	return mat3_apply(m, vec3_sub(vec3_add(mat3_apply(s, v), t->bias), c->bias));
}

/* ---- gyro -------------------------------------------------------------------------------------------------------- */

static struct calibrate_gyro gyro;

static enum calibrate_verdict calibrate_gyro_on(const struct signal *signal, double seconds)
{
	calibrate_gyro_init(&gyro, &CALIBRATE_GYRO_DEFAULTS);
	for (int i = 0; i < seconds * 100 && gyro.verdict == CALIBRATE_COLLECTING; i++) {
		struct imu_sample s = next(signal);

		calibrate_gyro_step(&gyro, &s);
	}
	return gyro.verdict;
}

static void test_the_gyro_bias_is_found_within_its_sigma(void **state)
{
	double sum = 0;

	(void)state;
	for (uint64_t seed = 0; seed < CHIPS; seed++) {
		new_chip(seed);
		assert_int_equal(calibrate_gyro_on(signal_find("rest"), 15), CALIBRATE_GOOD);
		sum += normalised(gyro.result.bias_rad_s, sensor.gyro.bias, gyro.result.sigma_rad_s);
	}
	assert_true(sum / CHIPS > 0.4 && sum / CHIPS < 2.2);
}

static void test_a_gyro_that_is_moved_is_refused(void **state)
{
	(void)state;
	new_chip(1);
	assert_int_equal(calibrate_gyro_on(signal_find("tumble"), 100), CALIBRATE_MOVED);
}

static void test_a_gyro_waits_for_the_rest_after_a_motion(void **state)
{
	(void)state;
	new_chip(1);
	calibrate_gyro_init(&gyro, &CALIBRATE_GYRO_DEFAULTS);
	for (int i = 0; i < 3000 && gyro.verdict == CALIBRATE_COLLECTING; i++) {
		struct imu_sample s = next(signal_find(i < 1000 ? "tumble" : "rest"));

		calibrate_gyro_step(&gyro, &s);
	}
	assert_int_equal(gyro.verdict, CALIBRATE_GOOD);
	assert_vec_near(gyro.result.bias_rad_s, sensor.gyro.bias, 0.1 * RAD_PER_DEG);
}

/* Only the magnetometer shows a rotation about the vertical; about a horizontal axis gravity shows it. */
static void test_a_slow_steady_turn_about_the_vertical_is_not_a_rest(void **state)
{
	struct signal slow = *signal_find("turntable");

	(void)state;
	new_chip(1);
	slow.angle_rad = 0.3 * RAD_PER_DEG;
	assert_int_equal(calibrate_gyro_on(&slow, 15), CALIBRATE_TURNED);
}

static void test_a_slow_steady_tilt_is_not_a_rest(void **state)
{
	struct signal slow = *signal_find("roll_step");

	(void)state;
	new_chip(1);
	slow.period_s = 1000;
	slow.change_s = 200;
	slow.angle_rad = 8 * RAD_PER_DEG;
	for (int i = 0; i < 34500; i++)
		next(&slow); /* to the middle of the turn: 0.09 deg/s */
	assert_int_equal(calibrate_gyro_on(&slow, 15), CALIBRATE_TURNED);
}

static void test_a_log_without_a_rest_of_five_seconds_is_refused(void **state)
{
	const struct calibrate_gyro_config of_a_log = {(double)INFINITY, (double)INFINITY, 1e-4};

	(void)state;
	new_chip(1);
	calibrate_gyro_init(&gyro, &of_a_log);
	for (int i = 0; i < 450; i++) {
		struct imu_sample s = next(signal_find("rest"));

		calibrate_gyro_step(&gyro, &s);
	}
	assert_int_equal(calibrate_gyro_finish(&gyro), CALIBRATE_MOVED);
}

/* ---- accelerometer ----------------------------------------------------------------------------------------------- */

static struct calibrate_accelerometer accel;

static void begin_accelerometer(enum calibrate_positions positions)
{
	const struct calibrate_accelerometer_config config = {positions, G, chip.accel.bias_instability, false, 120};

	calibrate_accelerometer_init(&accel, &config);
}

static enum calibrate_verdict calibrate_accelerometer_on(const struct signal *signal, double seconds)
{
	for (int i = 0; i < seconds * 100 && accel.verdict == CALIBRATE_COLLECTING; i++) {
		struct imu_sample s = next(signal);

		calibrate_accelerometer_step(&accel, &s);
	}
	return accel.verdict;
}

static void test_free_positions_give_the_bias_within_its_sigma_and_gravity_in_every_attitude(void **state)
{
	double sum = 0;

	(void)state;
	for (uint64_t seed = 0; seed < CHIPS; seed++) {
		new_chip(seed);
		begin_accelerometer(CALIBRATE_FREE);
		assert_int_equal(calibrate_accelerometer_on(signal_find("multiposition"), 130), CALIBRATE_GOOD);
		sum += normalised(accel.result.calibration.bias, sensor.accel.bias, accel.result.bias_sigma_m_s2);
		for (int i = 0; i < 20; i++) {
			struct vec3 g = quat_rotate(any_attitude(), (struct vec3){0, 0, G});

			assert_near(vec3_norm(corrected(&accel.result.calibration, &sensor.accel, g)), G, 0.01);
		}
		assert_true(accel.coverage > 0.4 && accel.coverage <= 1);
		/* of 14 positions: less than the biases' as a share of gravity, which has the drift, too */
		assert_true(accel.result.matrix_sigma * G > vec3_norm(accel.result.bias_sigma_m_s2) / 10);
		assert_true(accel.result.matrix_sigma * G < vec3_norm(accel.result.bias_sigma_m_s2) * 5);
	}
	assert_true(sum / CHIPS > 0.4 && sum / CHIPS < 2);
}

static void test_the_matrix_of_free_positions_is_symmetric(void **state)
{
	double(*m)[3] = accel.result.calibration.matrix;

	(void)state;
	new_chip(5);
	begin_accelerometer(CALIBRATE_FREE);
	calibrate_accelerometer_on(signal_find("multiposition"), 130);
	assert_true(m[0][1] == m[1][0] && m[0][2] == m[2][0] && m[1][2] == m[2][1] && m[0][1] != 0);
}

static void test_six_faces_give_the_full_matrix_including_its_rotation(void **state)
{
	double sum = 0;

	(void)state;
	for (uint64_t seed = 0; seed < CHIPS; seed++) {
		new_chip(seed);
		begin_accelerometer(CALIBRATE_SIX_FACES);
		assert_int_equal(calibrate_accelerometer_on(signal_find("multiposition"), 130), CALIBRATE_GOOD);
		sum += normalised(accel.result.calibration.bias, sensor.accel.bias, accel.result.bias_sigma_m_s2);
		for (int i = 0; i < 20; i++) {
			struct vec3 g = quat_rotate(any_attitude(), (struct vec3){0, 0, G});

			assert_vec_near(corrected(&accel.result.calibration, &sensor.accel, g), g, 0.02);
		}
	}
	assert_true(sum / CHIPS > 0.4 && sum / CHIPS < 2);
}

/* What the matrix of the gyro leaves of the chip's, against what that of the accelerometer leaves: both triads have the
 * same axes then. */
static double square_of_gyro_matrix(double worst[1])
{
	struct mat3 g, a, found, accelerometer;
	double sum = 0;

	memcpy(found.m, accel.result.gyro.matrix, sizeof found.m);
	memcpy(accelerometer.m, accel.result.calibration.matrix, sizeof accelerometer.m);
	memcpy(g.m, sensor.gyro.matrix, sizeof g.m);
	memcpy(a.m, sensor.accel.matrix, sizeof a.m);
	g = mat3_multiply(found, g);
	a = mat3_multiply(accelerometer, a);
	for (int i = 0; i < 9; i++) {
		double off = g.m[i / 3][i % 3] - a.m[i / 3][i % 3];

		sum += square(off, accel.result.gyro.sigma) / 9;
		worst[0] = fmax(worst[0], fabs(off));
	}
	return sum;
}

static void test_the_turns_between_the_positions_give_the_matrix_of_the_gyro(void **state)
{
	double sum = 0, worst = 0;

	(void)state;
	for (uint64_t seed = 0; seed < CHIPS; seed++) {
		new_chip_of("lsm303dlhc_l3gd20", seed); /* the other one's gyro ends at 250 deg/s */
		begin_accelerometer(CALIBRATE_FREE);
		assert_int_equal(calibrate_accelerometer_on(signal_find("multiposition"), 130), CALIBRATE_GOOD);
		assert_true(accel.result.gyro.found);
		assert_int_equal(accel.result.gyro.turns, 13);
		sum += square_of_gyro_matrix(&worst);
	}
	assert_true(worst < 0.003);
	assert_true(sum / CHIPS > 0.2 && sum / CHIPS < 1); /* sigma is that of the least certain element */
}

static void test_a_turn_beyond_the_range_of_the_gyro_is_not_used(void **state)
{
	const struct signal *motion = signal_find("multiposition");

	(void)state;
	new_chip_of("lsm303dlhc_l3gd20", 1);
	begin_accelerometer(CALIBRATE_FREE);
	for (int i = 0; i < 6300 && accel.verdict == CALIBRATE_COLLECTING; i++) {
		struct imu_sample s = next(motion);

		if (i >= 1650 && i < 1660) { /* in the fourth turn */
			s.gyro_rad_s.x *= 0.5;
			s.flags |= SAMPLE_SATURATED;
		}
		calibrate_accelerometer_step(&accel, &s);
	}
	double worst = 0;
	assert_int_equal(accel.result.gyro.turns, 12);
	square_of_gyro_matrix(&worst);
	assert_true(worst < 0.01);
}

static void test_a_gyro_that_does_not_turn_with_the_board_keeps_its_matrix(void **state)
{
	(void)state;
	new_chip_of("lsm303dlhc_l3gd20", 1);
	begin_accelerometer(CALIBRATE_FREE);
	for (int i = 0; i < 6300; i++) {
		struct imu_sample s = next(signal_find("multiposition"));

		s.gyro_rad_s = (struct vec3){0, 0, 0};
		calibrate_accelerometer_step(&accel, &s);
	}
	assert_int_equal(accel.verdict, CALIBRATE_GOOD);
	assert_int_equal(accel.positions, CALIBRATE_SIDES);
	assert_false(accel.result.gyro.found);
}

/* Holds the simulated accelerometer for three seconds, with `up` pointing up. */
static void hold(struct vec3 up, double shake_m_s2)
{
	static uint64_t t_us;
	static struct rng rng;

	if (t_us == 0)
		rng_init(&rng, 1);
	for (int i = 0; i < 300; i++) {
		struct imu_sample s = {.t_us = t_us += 10000, .accel_m_s2 = vec3_scale(G / vec3_norm(up), up)};

		s.accel_m_s2.x += shake_m_s2 * rng_gauss(&rng);
		s.accel_m_s2.y += shake_m_s2 * rng_gauss(&rng);
		s.accel_m_s2.z += shake_m_s2 * rng_gauss(&rng);
		calibrate_accelerometer_step(&accel, &s);
	}
}

static void test_the_same_position_twice_counts_once(void **state)
{
	(void)state;
	new_chip(1);
	begin_accelerometer(CALIBRATE_FREE);
	hold((struct vec3){0, 0, 1}, 0.01);
	hold((struct vec3){1, 0, 0}, 0.01);
	hold((struct vec3){0.1, 0, 1}, 0.01);
	assert_int_equal(accel.positions, 2);
}

static void test_too_few_positions_are_refused(void **state)
{
	(void)state;
	new_chip(1);
	begin_accelerometer(CALIBRATE_FREE);
	calibrate_accelerometer_on(signal_find("multiposition"), 40);
	assert_int_equal(accel.positions, 9);
	assert_int_equal(calibrate_accelerometer_finish(&accel), CALIBRATE_TOO_FEW_POSITIONS);
}

static void test_positions_on_one_hemisphere_are_refused(void **state)
{
	(void)state;
	new_chip(1);
	begin_accelerometer(CALIBRATE_FREE);
	for (int i = 0; i < 6; i++)
		for (int ring = 0; ring < 2; ring++)
			hold((struct vec3){cos(i * PI / 3 + ring), sin(i * PI / 3 + ring), ring ? 0.4 : 1.2}, 0.01);
	assert_int_equal(accel.positions, 12);
	assert_int_equal(calibrate_accelerometer_finish(&accel), CALIBRATE_POOR_COVERAGE);
}

static void test_inconsistent_positions_are_refused(void **state)
{
	(void)state;
	new_chip(1);
	begin_accelerometer(CALIBRATE_FREE);
	accel.config.use_all = true;
	for (int i = 0; i < 14; i++) {
		struct vec3 up = i < 6 ? (struct vec3){i / 2 == 0, i / 2 == 1, i / 2 == 2}
				       : (struct vec3){i & 1 ? -1 : 1, i & 2 ? -1 : 1, i & 4 ? 1 : -1};

		hold(vec3_scale(i < 6 && i % 2 ? -1 : 1, up), 0.01);
	}
	/* no ellipsoid passes through points moved outwards at every other corner of a cube */
	for (int i = 6; i < 14; i++)
		if ((i ^ i >> 1 ^ i >> 2) & 1)
			accel.position[i].force_m_s2 = vec3_scale(1.04, accel.position[i].force_m_s2);
	assert_int_equal(calibrate_accelerometer_finish(&accel), CALIBRATE_LARGE_RESIDUAL);
}

static void test_a_shaking_hand_is_not_a_rest(void **state)
{
	(void)state;
	new_chip(1);
	begin_accelerometer(CALIBRATE_FREE);
	hold((struct vec3){0, 0, 1}, 0.5);
	assert_int_equal(accel.positions, 0);
}

static void test_faces_seven_degrees_off_the_axes_of_the_sensor_are_refused(void **state)
{
	const struct quat turn = quat_from_aerospace((struct vec3){7 * RAD_PER_DEG, 0, 0});

	(void)state;
	new_chip(1);
	begin_accelerometer(CALIBRATE_SIX_FACES);
	for (int i = 0; i < 6; i++) {
		struct vec3 up = {i / 2 == 0, i / 2 == 1, i / 2 == 2};

		hold(quat_rotate(turn, vec3_scale(i % 2 ? -1 : 1, up)), 0.01);
	}
	assert_int_equal(accel.verdict, CALIBRATE_FACES_TURNED);
}

static void test_an_accelerometer_in_units_of_g_is_refused_as_implausible(void **state)
{
	struct imu_sample s;

	(void)state;
	new_chip(1);
	begin_accelerometer(CALIBRATE_SIX_FACES);
	for (int i = 0; i < 6300 && accel.verdict == CALIBRATE_COLLECTING; i++) {
		s = next(signal_find("multiposition"));
		s.accel_m_s2 = vec3_scale(1 / G, s.accel_m_s2);
		calibrate_accelerometer_step(&accel, &s);
	}
	assert_int_equal(accel.verdict, CALIBRATE_IMPLAUSIBLE);
}

static void test_the_next_side_is_the_farthest_one_from_all_positions(void **state)
{
	(void)state;
	new_chip(1);
	begin_accelerometer(CALIBRATE_SIX_FACES);
	hold((struct vec3){0, 0, 1}, 0.01);
	assert_int_equal(calibrate_accelerometer_next(&accel), 6); /* -z is farthest from +z */
	hold((struct vec3){0, 0, -1}, 0.01);
	hold((struct vec3){1, 0, 0}, 0.01);
	assert_int_equal(calibrate_accelerometer_next(&accel), 2);
	hold((struct vec3){-1, 0, 0}, 0.01);
	hold((struct vec3){0, 1, 0}, 0.01);
	assert_int_equal(calibrate_accelerometer_next(&accel), 4); /* the last of the six faces */

	begin_accelerometer(CALIBRATE_FREE);
	for (int face = 0; face < 6; face++) {
		double up = face % 2 ? -1 : 1;

		hold((struct vec3){face / 2 == 0 ? up : 0, face / 2 == 1 ? up : 0, face / 2 == 2 ? up : 0}, 0.01);
	}
	assert_in_range(calibrate_accelerometer_next(&accel), 7, 14); /* then the corners */
}

static void test_a_missing_side_is_named_with_its_angle_to_the_nearest_position(void **state)
{
	(void)state;
	new_chip(1);
	begin_accelerometer(CALIBRATE_FREE);
	assert_near(calibrate_accelerometer_gap_rad(&accel, 5), PI, 0);
	hold((struct vec3){0, 0, 1}, 0.01);
	hold((struct vec3){1, 0, 0}, 0.01);
	assert_near(calibrate_accelerometer_gap_rad(&accel, 5), 0, 5 * RAD_PER_DEG);
	assert_near(calibrate_accelerometer_gap_rad(&accel, 3), PI / 2, 5 * RAD_PER_DEG);
	assert_near(calibrate_accelerometer_gap_rad(&accel, 9), acos(1 / sqrt(3)), 5 * RAD_PER_DEG);
	assert_string_equal(calibrate_side_text(9), "the corner +x -y +z");
	assert_near(calibrate_gap_rad(9, (struct vec3[]){{5, -4, 2}}, 1, (struct vec3){4, -3, 1}), 0, 1e-6);
}

/* ---- magnetometer ------------------------------------------------------------------------------------------------ */

static struct calibrate_magnetometer mag;

static void begin_magnetometer(double field_uT)
{
	const struct calibrate_magnetometer_config config = {field_uT, false, 60};

	calibrate_magnetometer_init(&mag, &config);
}

/* distort: effect of the surroundings on the field, in sensor axes */
static enum calibrate_verdict calibrate_magnetometer_on(
	const struct signal *signal, struct vec3 (*distort)(struct vec3 field_uT, double t_s))
{
	for (int i = 0; i < 7000 && mag.verdict == CALIBRATE_COLLECTING; i++) {
		struct imu_sample s = next(signal);

		if (distort)
			s.mag_uT = distort(s.mag_uT, i * 0.01);
		calibrate_magnetometer_step(&mag, &s);
	}
	return mag.verdict;
}

static void test_hard_and_soft_iron_are_found_within_their_sigma(void **state)
{
	const double field_uT = vec3_norm(sensor_preset(FINE)->field_n_uT);
	double sum = 0;

	(void)state;
	for (uint64_t seed = 0; seed < CHIPS; seed++) {
		new_chip(seed);
		begin_magnetometer(field_uT);
		assert_int_equal(calibrate_magnetometer_on(signal_find("figure"), NULL), CALIBRATE_GOOD);
		sum += normalised(mag.result.calibration.bias, sensor.mag.bias, mag.result.bias_sigma_uT);
		for (int i = 0; i < 20; i++) {
			struct vec3 f = quat_rotate(any_attitude(), (struct vec3){0, 0, field_uT});
			double length = vec3_norm(corrected(&mag.result.calibration, &sensor.mag, f));

			assert_near(length, field_uT, 0.005 * field_uT);
		}
	}
	assert_true(sum / CHIPS > 0.5 && sum / CHIPS < 2);
}

static struct vec3 car(struct vec3 f, double t_s)
{
	(void)t_s;
	return (struct vec3){1.3 * f.x + 0.1 * f.y + 90, 0.9 * f.y - 60, 0.1 * f.x + 0.8 * f.z + 40};
}

static void test_hard_iron_of_twice_the_field_is_found(void **state)
{
	(void)state;
	new_chip(3);
	begin_magnetometer(0);
	assert_int_equal(calibrate_magnetometer_on(signal_find("figure"), car), CALIBRATE_GOOD);
	assert_true(mag.result.residual < 0.01);
	assert_vec_near(mag.result.calibration.bias, car(sensor.mag.bias, 0), 0.2);
}

static void test_without_a_field_strength_the_matrix_keeps_the_volume(void **state)
{
	double(*m)[3] = mag.result.calibration.matrix;
	double det;

	(void)state;
	new_chip(4);
	begin_magnetometer(0);
	assert_int_equal(calibrate_magnetometer_on(signal_find("figure"), NULL), CALIBRATE_GOOD);
	det = m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
	      m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
	assert_near(det, 1, 1e-9);
}

static void test_a_magnetometer_turned_about_one_axis_is_refused(void **state)
{
	(void)state;
	new_chip(1);
	begin_magnetometer(0);
	assert_int_not_equal(calibrate_magnetometer_on(signal_find("turntable"), NULL), CALIBRATE_GOOD);
	assert_true(mag.verdict == CALIBRATE_POOR_COVERAGE || mag.verdict == CALIBRATE_NO_ELLIPSOID);
}

static struct vec3 any_direction(struct rng *rng, double length)
{
	struct vec3 v;

	v.x = rng_gauss(rng);
	v.y = rng_gauss(rng);
	v.z = rng_gauss(rng);
	return vec3_scale(length / vec3_norm(v), v);
}

static void test_the_direction_that_the_field_lacks_is_named(void **state)
{
	struct imu_sample s = {.flags = SAMPLE_MAG};
	struct rng rng;

	(void)state;
	for (int lacks = 1; lacks <= CALIBRATE_SIDES; lacks++) {
		const struct vec3 side = calibrate_side(lacks), hard_iron = {20, -30, 10};

		rng_init(&rng, 1);
		begin_magnetometer(0);
		for (int i = 0; i < 3000; i++) {
			struct vec3 field = any_direction(&rng, 50);

			s.t_us += 10000;
			s.mag_uT = vec3_add(field, hard_iron);
			if (vec3_dot(field, side) < 0.5 * 50 * vec3_norm(side))
				for (int k = 0; k < 2; k++) /* not a spike */
					calibrate_magnetometer_step(&mag, &s);
		}
		assert_int_equal(calibrate_magnetometer_next(&mag), lacks);
		assert_true(calibrate_magnetometer_gap_rad(&mag, lacks) > 40 * RAD_PER_DEG);
	}
}

static void test_a_magnetometer_at_rest_is_refused(void **state)
{
	(void)state;
	new_chip(1);
	begin_magnetometer(0);
	assert_int_equal(calibrate_magnetometer_on(signal_find("rest"), NULL), CALIBRATE_POOR_COVERAGE);
}

static struct vec3 passing_iron(struct vec3 f, double t_s)
{
	f.x += 12 * sin(2 * t_s);
	f.y += 12 * cos(3.1 * t_s);
	return f;
}

static void test_a_field_that_changes_while_turning_is_refused(void **state)
{
	(void)state;
	new_chip(1);
	begin_magnetometer(0);
	assert_int_equal(calibrate_magnetometer_on(signal_find("figure"), passing_iron), CALIBRATE_LARGE_RESIDUAL);
}

static struct vec3 spikes(struct vec3 f, double t_s)
{
	if (fmod(t_s + 0.005, 1) < 0.01)
		f = vec3_scale(-3, f);
	return f;
}

static void test_single_spikes_do_not_change_the_result(void **state)
{
	(void)state;
	new_chip(1);
	begin_magnetometer(0);
	assert_int_equal(calibrate_magnetometer_on(signal_find("figure"), spikes), CALIBRATE_GOOD);
	assert_true(mag.result.residual < 0.01);
	assert_vec_near(mag.result.calibration.bias, sensor.mag.bias, 0.2);
}

static struct vec3 flat(struct vec3 f, double t_s)
{
	(void)t_s;
	f.z *= 0.3;
	return f;
}

static void test_an_ellipsoid_flatter_than_soft_iron_can_be_is_refused(void **state)
{
	(void)state;
	new_chip(1);
	begin_magnetometer(0);
	assert_int_equal(calibrate_magnetometer_on(signal_find("figure"), flat), CALIBRATE_NO_ELLIPSOID);
}

static struct vec3 gauss(struct vec3 f, double t_s)
{
	(void)t_s;
	return vec3_scale(10, f);
}

static void test_a_field_ten_times_that_of_the_earth_is_refused_as_implausible(void **state)
{
	(void)state;
	new_chip(1);
	begin_magnetometer(0);
	assert_int_equal(calibrate_magnetometer_on(signal_find("figure"), gauss), CALIBRATE_IMPLAUSIBLE);
}

static void test_a_missing_magnetometer_is_reported_after_five_seconds(void **state)
{
	struct imu_sample s = {.t_us = 0};

	(void)state;
	begin_magnetometer(0);
	for (int i = 0; i < 600; i++) {
		s.t_us += 10000;
		calibrate_magnetometer_step(&mag, &s);
	}
	assert_int_equal(mag.verdict, CALIBRATE_NO_MAGNETOMETER);
}

static void test_values_that_are_not_finite_are_ignored(void **state)
{
	struct imu_sample s = {.t_us = 1, .flags = SAMPLE_MAG, .mag_uT = {NAN, 0, 0}, .accel_m_s2 = {INFINITY, 0, 0}};

	(void)state;
	begin_magnetometer(0);
	begin_accelerometer(CALIBRATE_FREE);
	calibrate_magnetometer_step(&mag, &s);
	calibrate_accelerometer_step(&accel, &s);
	assert_int_equal(mag.count, 0);
	assert_int_equal(calibrate_accelerometer_finish(&accel), CALIBRATE_TOO_FEW_POSITIONS);
}

static void test_values_out_of_any_range_are_ignored_and_fill_no_memory(void **state)
{
	struct imu_sample s = {.flags = SAMPLE_MAG};

	(void)state;
	begin_magnetometer(0);
	for (int i = 0; i < 2 * CALIBRATE_POINTS_MAX; i++) {
		s.t_us += 10000;
		s.mag_uT = vec3_scale(1e200 * (i + 1), (struct vec3){1, -1, 1});
		calibrate_magnetometer_step(&mag, &s);
	}
	assert_int_equal(mag.count, 0);
}

static void test_the_timeout_ends_an_accelerometer_calibration_even_if_all_samples_are_saturated(void **state)
{
	struct imu_sample s = {.flags = SAMPLE_SATURATED, .accel_m_s2 = {160, 0, 0}};

	(void)state;
	begin_accelerometer(CALIBRATE_FREE);
	for (int i = 0; i < 1000000 && accel.verdict == CALIBRATE_COLLECTING; i++) {
		s.t_us += 10000;
		calibrate_accelerometer_step(&accel, &s);
	}
	assert_int_equal(accel.verdict, CALIBRATE_TOO_FEW_POSITIONS);
}

/* ---- temperature ------------------------------------------------------------------------------------------------- */

static struct calibrate_temperature temperature;

static enum calibrate_verdict calibrate_temperature_on(const struct signal *signal, double warming_K, double seconds)
{
	chip.warming_K = warming_K;
	sensor.config.warming_K = warming_K;
	calibrate_temperature_init(&temperature);
	for (int i = 0; i < seconds * 100; i++) {
		struct imu_sample s = next(signal);

		calibrate_temperature_step(&temperature, &s);
	}
	return calibrate_temperature_finish(&temperature);
}

static void test_slopes_of_the_biases_are_found_while_it_warms_up(void **state)
{
	const struct temperature_compensation *t = &temperature.result.compensation;

	(void)state;
	for (uint64_t seed = 0; seed < 4; seed++) {
		new_chip(seed);
		assert_int_equal(calibrate_temperature_on(signal_find("rest"), 20, 300), CALIBRATE_GOOD);
		assert_vec_near(t->gyro_slope, sensor.gyro.slope, 0.003 * RAD_PER_DEG);
		assert_vec_near(t->accel_slope, sensor.accel.slope, 5e-4);
	}
}

static void test_a_temperature_that_changes_too_little_is_refused(void **state)
{
	(void)state;
	new_chip(1);
	assert_int_equal(calibrate_temperature_on(signal_find("rest"), 3, 300), CALIBRATE_SMALL_TEMPERATURE_SPAN);
}

static void test_a_log_without_temperature_is_refused(void **state)
{
	(void)state;
	new_chip(1);
	assert_int_equal(calibrate_temperature_on(signal_find("rest"), 0, 60), CALIBRATE_NO_TEMPERATURE);
}

static void test_temperature_without_a_rest_is_refused(void **state)
{
	(void)state;
	new_chip(1);
	assert_int_equal(calibrate_temperature_on(signal_find("tumble"), 20, 60), CALIBRATE_MOVED);
}

/* Bias 0.002 rad/s + 1e-5 (T - 25) + 2e-6 (T - 25)^2, without noise; the result is for the mean temperature. */
static void test_a_parabola_is_fitted_where_it_fits_better(void **state)
{
	const struct temperature_compensation *t = &temperature.result.compensation;
	struct imu_sample s = {.accel_m_s2 = {0, 0, G}, .flags = SAMPLE_TEMPERATURE};

	(void)state;
	calibrate_temperature_init(&temperature);
	for (int i = 0; i < 10000; i++) {
		double d = 30.0 * i / 10000;

		s.t_us += 10000;
		s.temperature_degC = 25 + d;
		s.gyro_rad_s.x = 0.002 + 1e-5 * d + 2e-6 * d * d;
		calibrate_temperature_step(&temperature, &s);
	}
	assert_int_equal(calibrate_temperature_finish(&temperature), CALIBRATE_GOOD);
	assert_true(temperature.result.quadratic);
	double d0 = t->reference_degC - 25;
	assert_near(t->gyro_quadratic.x, 2e-6, 1e-9);
	assert_near(t->gyro_slope.x, 1e-5 + 4e-6 * d0, 1e-9);
	assert_near(temperature.result.gyro_rad_s.x, 0.002 + 1e-5 * d0 + 2e-6 * d0 * d0, 1e-7);
}

/* ---- common ----------------------------------------------------------------------------------------------------- */

static void test_all_verdicts_have_different_texts(void **state)
{
	(void)state;
	for (int a = 0; a < CALIBRATE_VERDICTS; a++)
		for (int b = 0; b <= a; b++)
			assert_int_equal(strcmp(calibrate_text((enum calibrate_verdict)a),
						 calibrate_text((enum calibrate_verdict)b)) == 0,
				a == b);
}

/* The inverse was computed with numpy. */
static void test_exact_points_of_an_ellipsoid_give_its_parameters(void **state)
{
	const struct mat3 m = {{{1.1, 0.05, -0.02}, {0.05, 0.9, 0.03}, {-0.02, 0.03, 1.2}}};
	const struct mat3 inverse = {{{0.911717740096, -0.0512001622183, 0.0164752997237},
		{-0.0512001622183, 1.11491310336, -0.0287261636208},
		{0.0164752997237, -0.0287261636208, 0.834326075753}}};
	struct vec3 points[40];
	struct ellipsoid e;

	(void)state;
	for (int i = 0; i < 40; i++) {
		struct vec3 u = quat_rotate(any_attitude(), (struct vec3){0, 0, 50});

		points[i] = vec3_add((struct vec3){100, -20, 5}, mat3_apply(inverse, u));
	}
	assert_int_equal(ellipsoid_guess(points, 9, 50, &e), -EDOM); /* as many as unknowns */
	assert_int_equal(ellipsoid_guess(points, 40, 50, &e), 0);
	assert_int_equal(ellipsoid_fit(points, 40, 50, true, &e), 0);
	assert_vec_near(e.centre, ((struct vec3){100, -20, 5}), 1e-6);
	for (int i = 0; i < 9; i++)
		assert_near(e.matrix.m[i / 3][i % 3], m.m[i / 3][i % 3], 1e-8);
}

/* ---- the ellipsoid ----------------------------------------------------------------------------------------------- */

/* A soft-iron matrix; its inverse and its eigenvalues are numpy's. */
static const struct mat3 IRON = {{{1.1, 0.05, -0.02}, {0.05, 0.9, 0.03}, {-0.02, 0.03, 1.2}}};
static const struct mat3 IRON_INVERSE = {{{0.91171774009581, -0.0512001622183357, 0.0164752997237219},
	{-0.0512001622183357, 1.11491310335505, -0.0287261636208484},
	{0.0164752997237219, -0.0287261636208484, 0.834326075752583}}};
static const double IRON_EIGENVALUES[3] = {0.8845683703123, 1.11013965293517, 1.20529197675253};

/* A vector of that length, all directions equally likely. */
static void test_the_errors_of_an_ellipsoid_fit_are_those_that_it_states(void **state)
{
	enum { TRIALS = 100, POINTS = 60 };
	const struct vec3 centre = {100, -20, 5};
	const double radial_sigma = 0.5;
	double variance = 0, centre_error = 0, stated = 0, largest = 0, matrix_variance[9] = {0};
	struct rng rng;

	(void)state;
	rng_init(&rng, 1);
	for (int trial = 0; trial < TRIALS; trial++) {
		struct vec3 points[POINTS];
		struct ellipsoid e;

		for (int i = 0; i < POINTS; i++)
			points[i] = vec3_add(centre,
				mat3_apply(IRON_INVERSE, any_direction(&rng, 50 + radial_sigma * rng_gauss(&rng))));
		assert_int_equal(ellipsoid_guess(points, POINTS, 50, &e), 0);
		assert_int_equal(ellipsoid_fit(points, POINTS, 50, false, &e), 0);
		variance += e.rms * e.rms / TRIALS;
		centre_error += normalised(e.centre, centre, e.sigma) / TRIALS;
		stated += e.matrix_sigma / TRIALS;
		for (int i = 0; i < 9; i++)
			matrix_variance[i] += square(e.matrix.m[i / 3][i % 3] - IRON.m[i / 3][i % 3], 1) / TRIALS;
	}
	for (int i = 0; i < 9; i++)
		largest = fmax(largest, sqrt(matrix_variance[i]));
	assert_near(sqrt(variance) / radial_sigma, 1, 0.03);
	assert_near(centre_error, 1, 0.2);
	assert_near(largest / stated, 1, 0.2);
}

static void test_the_coverage_of_an_ellipsoid_is_1_all_over_it_and_less_on_its_upper_half(void **state)
{
	struct vec3 whole[2000], upper[2000];
	struct ellipsoid e;
	struct rng rng;

	(void)state;
	rng_init(&rng, 2);
	for (int i = 0; i < 2000; i++) {
		struct vec3 u = any_direction(&rng, 50);

		whole[i] = mat3_apply(IRON_INVERSE, u);
		u.z = fabs(u.z);
		upper[i] = mat3_apply(IRON_INVERSE, u);
	}
	assert_int_equal(ellipsoid_guess(upper, 2000, 50, &e), 0);
	assert_true(e.coverage < 0.5);
	assert_int_equal(ellipsoid_guess(whole, 2000, 50, &e), 0);
	assert_near(e.coverage, 1, 0.05);
	assert_near(e.least, IRON_EIGENVALUES[0], 1e-9);
	assert_near(e.largest, IRON_EIGENVALUES[2], 1e-9);
	assert_near(e.mean, pow(IRON_EIGENVALUES[0] * IRON_EIGENVALUES[1] * IRON_EIGENVALUES[2], 1 / 3.0), 1e-9);
}

/* Ellipsoids with different axes go through two parallel circles of a sphere. */
static void test_points_that_many_ellipsoids_go_through_are_refused(void **state)
{
	const struct ellipsoid sphere = {.matrix = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}, .radius = 50, .rms = -1};
	struct ellipsoid e = sphere;
	struct vec3 points[40];

	(void)state;
	for (int i = 0; i < 40; i++)
		points[i] = (struct vec3){40 * cos(i), 40 * sin(i), i % 2 ? 30 : -30};
	assert_int_equal(ellipsoid_guess(points, 40, 50, &e), -EDOM);
	assert_int_equal(ellipsoid_fit(points, 40, 50, false, &e), -EDOM);
	assert_int_equal(ellipsoid_fit(points, 9, 50, false, &e), -EDOM);
	for (int i = 0; i < 40; i++)
		points[i] = (struct vec3){1, 2, 3};
	assert_int_equal(ellipsoid_guess(points, 40, 50, &e), -EDOM);
	assert_int_equal(ellipsoid_fit(points, 40, 50, true, &e), -EDOM);
	points[17].x = NAN;
	assert_int_equal(ellipsoid_guess(points, 40, 50, &e), -EDOM);
	assert_int_equal(ellipsoid_fit(points, 40, 50, true, &e), -EDOM);
	assert_memory_equal(&e, &sphere, sizeof(e));
}

/* A spiral over the sphere, each point measured three times. */
static enum calibrate_verdict calibrate_magnetometer_with(int points)
{
	const struct calibrate_magnetometer_config config = {.use_all = true, .patience_s = 60};

	calibrate_magnetometer_init(&mag, &config);
	for (int i = 0; i < 3 * points; i++) {
		double z = 1 - (2 * (i / 3) + 1.0) / points, turn = 2.4 * (i / 3), r = 50 * sqrt(1 - z * z);
		struct imu_sample s = {.t_us = 1000u * (uint64_t)i,
			.mag_uT = {r * cos(turn), r * sin(turn), 50 * z},
			.flags = SAMPLE_MAG};

		calibrate_magnetometer_step(&mag, &s);
	}
	return calibrate_magnetometer_finish(&mag);
}

static void test_a_magnetometer_needs_30_points(void **state)
{
	(void)state;
	assert_int_equal(calibrate_magnetometer_with(29), CALIBRATE_POOR_COVERAGE);
	assert_int_equal(calibrate_magnetometer_with(30), CALIBRATE_GOOD);
}

/* ---- what the calibrations report -------------------------------------------------------------------------------- */

/* 100 s at rest from 20 to 30 degC. Channel i, of gyro x y z and accelerometer x y z, has the slope i + 1, white noise
 * and a wave of these sizes, times 1e-5. */
static enum calibrate_verdict warm_up(const double noise[6], const double wave[6])
{
	struct rng rng;

	rng_init(&rng, 3);
	calibrate_temperature_init(&temperature);
	for (int k = 0; k < 10000; k++) {
		double kelvin = k / 1000.0, channel[6];
		struct imu_sample s = {
			.t_us = 10000u * (uint64_t)k, .temperature_degC = 20 + kelvin, .flags = SAMPLE_TEMPERATURE};

		for (int i = 0; i < 6; i++)
			channel[i] = 1e-5 * ((i + 1) * kelvin + noise[i] * rng_gauss(&rng) + wave[i] * sin(k / 300.0));
		s.gyro_rad_s = (struct vec3){channel[0], channel[1], channel[2]};
		s.accel_m_s2 = (struct vec3){channel[3], channel[4], channel[5] + G};
		calibrate_temperature_step(&temperature, &s);
	}
	return calibrate_temperature_finish(&temperature);
}

/* The mean of the 25 samples of a quarter of a second has a fifth of their noise. A slope over 10 K, evenly passed
 * through in 400 quarters, has the sigma of one of them / (sqrt(400) 10 K / sqrt(12)). */
static void test_a_temperature_calibration_reports_slopes_and_noise_of_every_axis(void **state)
{
	const double noise[6] = {10, 20, 40, 300, 600, 900}, no_wave[6] = {0};
	const struct vec3 gyro_rms = {2e-5, 4e-5, 8e-5}, accel_rms = {60e-5, 120e-5, 180e-5};
	const struct calibrate_temperature_result *r = &temperature.result;
	const double per_sigma = sqrt(400) * 10 / sqrt(12);

	(void)state;
	assert_int_equal(warm_up(noise, no_wave), CALIBRATE_GOOD);
	assert_false(r->quadratic);
	assert_vec_near(r->gyro_residual_rad_s, gyro_rms, 0.8e-5);
	assert_vec_near(r->accel_residual_m_s2, accel_rms, 18e-5);
	assert_vec_near(vec3_scale(per_sigma, r->gyro_slope_sigma), gyro_rms, 0.8e-5);
	assert_vec_near(vec3_scale(per_sigma, r->accel_slope_sigma), accel_rms, 18e-5);
	assert_vec_near(r->compensation.gyro_slope, ((struct vec3){1e-5, 2e-5, 3e-5}), 4 * 8e-5 / per_sigma);
	assert_vec_near(r->compensation.accel_slope, ((struct vec3){4e-5, 5e-5, 6e-5}), 4 * 180e-5 / per_sigma);
	assert_near(r->lowest_degC, 20, 0.5);
	assert_near(r->highest_degC, 30, 0.5);
	assert_near(r->rest_s, 100, 1);
}

/* The RMS of a wave is its size / sqrt(2): 0.1 deg/s and 0.05 m/s^2 are the limits. */
static void test_a_bias_that_does_not_follow_the_temperature_is_refused_on_every_axis(void **state)
{
	(void)state;
	for (int i = 0; i < 6; i++) {
		const double limit = i < 3 ? 0.1 * RAD_PER_DEG : 0.05, quiet[6] = {0};
		double wave[6] = {0};

		wave[i] = 0.9 * limit * sqrt(2) * 1e5;
		assert_int_equal(warm_up(quiet, wave), CALIBRATE_GOOD);
		wave[i] = 1.1 * limit * sqrt(2) * 1e5;
		assert_int_equal(warm_up(quiet, wave), CALIBRATE_LARGE_RESIDUAL);
	}
}

static void test_of_a_log_the_longest_rest_is_the_gyros(void **state)
{
	const double rest_s[3] = {6, 8, 5.5};
	struct imu_sample s = {.accel_m_s2 = {0, 0, G}};

	(void)state;
	calibrate_gyro_init(&gyro, &CALIBRATE_GYRO_DEFAULTS);
	for (int rest = 0; rest < 3; rest++) {
		for (int k = 0; k < 100 * (1 + rest_s[rest]); k++) {
			s.t_us += 10000;
			s.gyro_rad_s.x = k < 100 ? sin(k) : 0.001 * rest;
			calibrate_gyro_step(&gyro, &s);
		}
	}
	assert_int_equal(calibrate_gyro_finish(&gyro), CALIBRATE_GOOD);
	assert_near(gyro.result.bias_rad_s.x, 0.001, 1e-9);
	assert_near(gyro.result.rest_s, 8, 0.8);
}

static void test_each_step_of_a_gyro_calibration_returns_its_verdict(void **state)
{
	struct imu_sample s = {.accel_m_s2 = {0, 0, G}};
	enum calibrate_verdict verdict = CALIBRATE_COLLECTING;

	(void)state;
	calibrate_gyro_init(&gyro, &CALIBRATE_GYRO_DEFAULTS);
	for (int k = 0; k < 1500; k++) {
		s.t_us += 10000;
		verdict = calibrate_gyro_step(&gyro, &s);
		assert_int_equal(verdict, k < 1000 ? CALIBRATE_COLLECTING : gyro.verdict);
	}
	assert_int_equal(verdict, CALIBRATE_GOOD);
	assert_int_equal(calibrate_gyro_finish(&gyro), CALIBRATE_GOOD);
	assert_near(calibrate_gyro_progress(&gyro), 1, 0);
}

/* Over 10 s, 40 quarters of a second, the mean of 1000 samples has sigma / sqrt(1000). */
static void test_the_sigma_of_a_gyro_bias_is_that_of_its_axis(void **state)
{
	const struct calibrate_gyro_config steady = {.rest_s = 10, .patience_s = 60};
	struct imu_sample s = {.accel_m_s2 = {0, 0, G}};
	struct rng rng;

	(void)state;
	rng_init(&rng, 4);
	calibrate_gyro_init(&gyro, &steady);
	while (gyro.verdict == CALIBRATE_COLLECTING) {
		s.t_us += 10000;
		s.gyro_rad_s.x = 0.001 * rng_gauss(&rng);
		s.gyro_rad_s.y = 0.002 * rng_gauss(&rng);
		s.gyro_rad_s.z = 0.004 * rng_gauss(&rng);
		calibrate_gyro_step(&gyro, &s);
	}
	assert_int_equal(gyro.verdict, CALIBRATE_GOOD);
	assert_near(gyro.result.sigma_rad_s.x * sqrt(1000) / 0.001, 1, 0.3);
	assert_near(gyro.result.sigma_rad_s.y * sqrt(1000) / 0.002, 1, 0.3);
	assert_near(gyro.result.sigma_rad_s.z * sqrt(1000) / 0.004, 1, 0.3);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_gyro_bias_is_found_within_its_sigma),
		cmocka_unit_test(test_a_gyro_that_is_moved_is_refused),
		cmocka_unit_test(test_a_gyro_waits_for_the_rest_after_a_motion),
		cmocka_unit_test(test_a_slow_steady_turn_about_the_vertical_is_not_a_rest),
		cmocka_unit_test(test_a_slow_steady_tilt_is_not_a_rest),
		cmocka_unit_test(test_a_log_without_a_rest_of_five_seconds_is_refused),
		cmocka_unit_test(test_free_positions_give_the_bias_within_its_sigma_and_gravity_in_every_attitude),
		cmocka_unit_test(test_the_matrix_of_free_positions_is_symmetric),
		cmocka_unit_test(test_six_faces_give_the_full_matrix_including_its_rotation),
		cmocka_unit_test(test_the_turns_between_the_positions_give_the_matrix_of_the_gyro),
		cmocka_unit_test(test_a_turn_beyond_the_range_of_the_gyro_is_not_used),
		cmocka_unit_test(test_a_gyro_that_does_not_turn_with_the_board_keeps_its_matrix),
		cmocka_unit_test(test_the_same_position_twice_counts_once),
		cmocka_unit_test(test_too_few_positions_are_refused),
		cmocka_unit_test(test_positions_on_one_hemisphere_are_refused),
		cmocka_unit_test(test_inconsistent_positions_are_refused),
		cmocka_unit_test(test_a_shaking_hand_is_not_a_rest),
		cmocka_unit_test(test_faces_seven_degrees_off_the_axes_of_the_sensor_are_refused),
		cmocka_unit_test(test_an_accelerometer_in_units_of_g_is_refused_as_implausible),
		cmocka_unit_test(test_the_next_side_is_the_farthest_one_from_all_positions),
		cmocka_unit_test(test_hard_and_soft_iron_are_found_within_their_sigma),
		cmocka_unit_test(test_hard_iron_of_twice_the_field_is_found),
		cmocka_unit_test(test_without_a_field_strength_the_matrix_keeps_the_volume),
		cmocka_unit_test(test_a_magnetometer_turned_about_one_axis_is_refused),
		cmocka_unit_test(test_a_missing_side_is_named_with_its_angle_to_the_nearest_position),
		cmocka_unit_test(test_the_direction_that_the_field_lacks_is_named),
		cmocka_unit_test(test_a_magnetometer_at_rest_is_refused),
		cmocka_unit_test(test_a_field_that_changes_while_turning_is_refused),
		cmocka_unit_test(test_an_ellipsoid_flatter_than_soft_iron_can_be_is_refused),
		cmocka_unit_test(test_a_field_ten_times_that_of_the_earth_is_refused_as_implausible),
		cmocka_unit_test(test_single_spikes_do_not_change_the_result),
		cmocka_unit_test(test_a_missing_magnetometer_is_reported_after_five_seconds),
		cmocka_unit_test(test_values_that_are_not_finite_are_ignored),
		cmocka_unit_test(test_values_out_of_any_range_are_ignored_and_fill_no_memory),
		cmocka_unit_test(test_the_timeout_ends_an_accelerometer_calibration_even_if_all_samples_are_saturated),
		cmocka_unit_test(test_slopes_of_the_biases_are_found_while_it_warms_up),
		cmocka_unit_test(test_a_temperature_that_changes_too_little_is_refused),
		cmocka_unit_test(test_a_log_without_temperature_is_refused),
		cmocka_unit_test(test_temperature_without_a_rest_is_refused),
		cmocka_unit_test(test_a_parabola_is_fitted_where_it_fits_better),
		cmocka_unit_test(test_all_verdicts_have_different_texts),
		cmocka_unit_test(test_exact_points_of_an_ellipsoid_give_its_parameters),
		cmocka_unit_test(test_the_errors_of_an_ellipsoid_fit_are_those_that_it_states),
		cmocka_unit_test(test_the_coverage_of_an_ellipsoid_is_1_all_over_it_and_less_on_its_upper_half),
		cmocka_unit_test(test_points_that_many_ellipsoids_go_through_are_refused),
		cmocka_unit_test(test_a_magnetometer_needs_30_points),
		cmocka_unit_test(test_a_temperature_calibration_reports_slopes_and_noise_of_every_axis),
		cmocka_unit_test(test_a_bias_that_does_not_follow_the_temperature_is_refused_on_every_axis),
		cmocka_unit_test(test_of_a_log_the_longest_rest_is_the_gyros),
		cmocka_unit_test(test_each_step_of_a_gyro_calibration_returns_its_verdict),
		cmocka_unit_test(test_the_sigma_of_a_gyro_bias_is_that_of_its_axis),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
