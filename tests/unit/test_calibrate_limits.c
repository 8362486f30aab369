/* Limits of the calibrations: exact samples just inside and just outside of each. */
#include "model_test.h"

#include "model/identify/calibrate_accelerometer.h"
#include "model/identify/calibrate_gyro.h"
#include "model/identify/calibrate_magnetometer.h"
#include "model/identify/calibrate_temperature.h"
#include "model/identify/ellipsoid.h"
#include "model/identify/gyro_turns.h"

#define G 9.81

enum { BLOCK = 25 }; /* samples of a quarter of a second at 100 Hz */
static const uint64_t INTERVAL_US = 10000;

static double *component(struct vec3 *v, int axis)
{
	return axis == 0 ? &v->x : axis == 1 ? &v->y : &v->z;
}

/* ---- rests ------------------------------------------------------------------------------------------------------- */

static struct calibrate_rest rest;
static struct imu_sample sample;
static int blocks, ends;

static int fresh_rest(void **state)
{
	(void)state;
	calibrate_rest_init(&rest, &CALIBRATE_LYING);
	sample = (struct imu_sample){.t_us = 5000000, .accel_m_s2 = {0, 0, G}};
	blocks = ends = 0;
	return 0;
}

static void step_rest(uint64_t interval_us)
{
	enum calibrate_rest_event event = calibrate_rest_step(&rest, &sample);

	blocks += event == CALIBRATE_REST_BLOCK;
	ends += event == CALIBRATE_REST_ENDED;
	sample.t_us += interval_us;
}

/* Whole blocks; the last one is closed by the first sample of the next call. */
static void lie(int count)
{
	for (int i = 0; i < count * BLOCK; i++)
		step_rest(INTERVAL_US);
}

/* Noise of +-noise on one channel, by turns: 25 values have the standard deviation noise sqrt(26 / 25). */
static void shake(double *channel, double noise, int count)
{
	const double still = *channel;

	for (int i = 0; i < count * BLOCK; i++) {
		*channel = still + (i % 2 ? -noise : noise);
		step_rest(INTERVAL_US);
	}
	*channel = still;
}

static void test_the_first_and_the_last_block_of_a_rest_are_not_reported(void **state)
{
	(void)state;
	lie(5);
	shake(&sample.gyro_rad_s.x, 1, 1);
	assert_int_equal(blocks, 3);
	assert_int_equal(ends, 0);
	step_rest(INTERVAL_US);
	assert_int_equal(blocks, 3);
	assert_int_equal(ends, 1);
}

static void test_a_rest_of_two_blocks_is_not_reported_and_one_of_three_has_one_block(void **state)
{
	(void)state;
	shake(&sample.gyro_rad_s.x, 1, 1);
	lie(2);
	shake(&sample.gyro_rad_s.x, 1, 2);
	assert_int_equal(blocks + ends, 0);
	lie(3);
	shake(&sample.gyro_rad_s.x, 1, 2);
	assert_int_equal(blocks, 1);
	assert_int_equal(ends, 1);
}

static void test_three_samples_make_a_block_and_two_do_not(void **state)
{
	(void)state;
	for (int i = 0; i < 100; i++)
		step_rest(125000);
	assert_int_equal(blocks, 0);
	fresh_rest(NULL);
	for (int i = 0; i < 3 * 10 + 1; i++)
		step_rest(100000);
	assert_int_equal(blocks, 10 - 2);
}

static void test_a_few_samples_between_two_rests_end_the_first(void **state)
{
	(void)state;
	lie(4);
	step_rest(300000);
	step_rest(INTERVAL_US);
	assert_int_equal(ends, 1);
}

static void test_a_block_is_the_mean_of_its_samples(void **state)
{
	double mag = 0, temperature = 0;

	(void)state;
	for (int i = 0; i <= 3 * BLOCK; i++) {
		sample.gyro_rad_s = (struct vec3){1e-5 * i, 2e-5 * i, 3e-5 * i};
		sample.accel_m_s2 = (struct vec3){1e-4 * i, 2e-4 * i, G - 3e-4 * i};
		sample.mag_uT = (struct vec3){i, 2 * i, -i};
		sample.temperature_degC = 20 + 0.1 * i;
		sample.flags = (i % 5 ? 0 : SAMPLE_MAG) | (i % 10 ? 0 : SAMPLE_TEMPERATURE);
		if (i >= BLOCK && i < 2 * BLOCK) {
			mag += i % 5 ? 0 : i / 5.0;		  /* 25, 30, .. 45 */
			temperature += i % 10 ? 0 : 20 + 0.1 * i; /* 30 and 40 */
		}
		step_rest(INTERVAL_US);
	}
	assert_int_equal(blocks, 1);
	assert_int_equal(rest.block.samples, BLOCK);
	assert_int_equal(rest.block.mag_samples, 5);
	assert_int_equal(rest.block.temperature_samples, 2);
	assert_vec_near(rest.block.gyro_rad_s, ((struct vec3){37e-5, 74e-5, 111e-5}), 1e-12);
	assert_vec_near(rest.block.accel_m_s2, ((struct vec3){37e-4, 74e-4, G - 111e-4}), 1e-12);
	assert_vec_near(rest.block.mag_uT, ((struct vec3){mag, 2 * mag, -mag}), 1e-12);
	assert_near(rest.block.temperature_degC, temperature / 2, 1e-12);
	assert_near(rest.block.end_s, 0.5, 1e-12);
}

static void test_noise_above_one_degree_per_second_or_0_15_m_s2_on_any_axis_is_not_a_rest(void **state)
{
	const double limit[2] = {RAD_PER_DEG, 0.15};

	(void)state;
	for (int channel = 0; channel < 6; channel++)
		for (int above = 0; above < 2; above++) {
			struct vec3 *triad = channel < 3 ? &sample.gyro_rad_s : &sample.accel_m_s2;
			double noise = limit[channel / 3] / sqrt(26 / 25.0) * (above ? 1.01 : 0.99);

			fresh_rest(NULL);
			shake(component(triad, channel % 3), noise, 4);
			assert_int_equal(blocks, above ? 0 : 1);
		}
}

/* The steps come between two blocks. */
static void test_a_step_of_the_mean_above_the_limit_ends_a_rest(void **state)
{
	const double limit[2] = {RAD_PER_DEG, 0.15};

	(void)state;
	for (int channel = 0; channel < 6; channel++)
		for (int above = 0; above < 2; above++) {
			struct vec3 *triad = channel < 3 ? &sample.gyro_rad_s : &sample.accel_m_s2;

			fresh_rest(NULL);
			lie(5);
			*component(triad, channel % 3) += limit[channel / 3] * (above ? 1.01 : 0.99);
			lie(1);
			step_rest(INTERVAL_US);
			assert_int_equal(ends, above);
		}
}

/* After 12 blocks at 0 and one at 0.14 m/s^2 the mean is 0.14 / 8; after one of each it is their half. */
static void test_a_step_counts_from_the_mean_over_two_seconds_at_most(void **state)
{
	(void)state;
	for (int above = 0; above < 2; above++) {
		fresh_rest(NULL);
		lie(12);
		sample.accel_m_s2.x = 0.14;
		lie(1);
		sample.accel_m_s2.x = 0.15 + 0.14 / 8 + (above ? 0.001 : -0.001);
		lie(1);
		step_rest(INTERVAL_US);
		assert_int_equal(ends, above);
		fresh_rest(NULL);
		lie(1);
		sample.accel_m_s2.x = 0.14;
		lie(1);
		sample.accel_m_s2.x = 0.15 + 0.14 / 2 + (above ? 0.001 : -0.001);
		lie(1);
		step_rest(INTERVAL_US);
		assert_int_equal(blocks, above ? 0 : 1);
	}
}

static void test_the_time_stands_still_in_gaps_of_more_than_half_a_second(void **state)
{
	(void)state;
	lie(4);
	assert_near(calibrate_rest_time_s(&rest), 0.99, 1e-9);
	sample.t_us += 490000;
	step_rest(INTERVAL_US);
	assert_near(calibrate_rest_time_s(&rest), 1.49, 1e-9);
	assert_int_equal(ends, 0);
	sample.t_us += 490001;
	step_rest(INTERVAL_US);
	assert_near(calibrate_rest_time_s(&rest), 1.49, 1e-9);
	assert_int_equal(ends, 1);
	sample.t_us -= 1000000;
	step_rest(INTERVAL_US);
	step_rest(INTERVAL_US);
	assert_near(calibrate_rest_time_s(&rest), 1.50, 1e-9);
}

static void test_a_discontinuity_or_a_saturated_sample_ends_a_rest(void **state)
{
	static const uint32_t flags[2] = {SAMPLE_DISCONTINUITY, SAMPLE_SATURATED};

	(void)state;
	for (int i = 0; i < 2; i++) {
		fresh_rest(NULL);
		lie(5);
		for (int k = 0; k < 12; k++)
			step_rest(INTERVAL_US);
		assert_int_equal(blocks, 3);
		sample.flags = flags[i];
		step_rest(INTERVAL_US);
		sample.flags = 0;
		assert_int_equal(ends, 1);
		for (int k = 1; k < 3 * BLOCK; k++)
			step_rest(INTERVAL_US);
		assert_int_equal(blocks, 3);
		step_rest(INTERVAL_US);
		assert_int_equal(blocks, 4);
	}
}

/* ---- gyro -------------------------------------------------------------------------------------------------------- */

static struct calibrate_gyro gyro;

struct gyro_drift {
	double accel_m_s3, field_uT_s, alternating_m_s2; /* the last one from block to block */
};

/* A log with `count` whole blocks at rest, of which all but two are used. */
static enum calibrate_verdict gyro_log(int count, struct vec3 bias_rad_s, const struct gyro_drift *drift)
{
	const struct calibrate_gyro_config config = {(double)INFINITY, (double)INFINITY, 1e-4};
	struct imu_sample s = {.flags = SAMPLE_MAG};

	calibrate_gyro_init(&gyro, &config);
	for (int i = 0; i <= count * BLOCK; i++) {
		int block = i / BLOCK;

		s.t_us = (uint64_t)i * INTERVAL_US;
		s.gyro_rad_s = bias_rad_s;
		s.accel_m_s2 = (struct vec3){
			drift->accel_m_s3 * i / 100 + (block % 2 ? 1 : -1) * drift->alternating_m_s2, 0, G};
		s.mag_uT = (struct vec3){20, drift->field_uT_s * i / 100, -45};
		calibrate_gyro_step(&gyro, &s);
	}
	return calibrate_gyro_finish(&gyro);
}

static const struct gyro_drift NO_DRIFT;

static void test_a_gyro_needs_five_seconds_of_rest(void **state)
{
	const struct vec3 bias = {0.01, 0.02, 0.03};

	(void)state;
	assert_int_equal(gyro_log(21, bias, &NO_DRIFT), CALIBRATE_MOVED);
	assert_int_equal(gyro_log(22, bias, &NO_DRIFT), CALIBRATE_GOOD);
	assert_near(gyro.result.rest_s, 5, 1e-9);
	assert_vec_near(gyro.result.bias_rad_s, bias, 1e-12);
}

static void test_the_sigma_of_a_gyro_without_noise_is_that_of_its_drift(void **state)
{
	(void)state;
	gyro_log(42, (struct vec3){0.01, 0, 0}, &NO_DRIFT);
	assert_vec_near(gyro.result.sigma_rad_s, ((struct vec3){1.5e-4, 1.5e-4, 1.5e-4}), 1e-9);
	assert_true(isnan(gyro.result.temperature_degC));
}

/* However large they are: their squares are those of differences. */
static void test_equal_measurements_of_a_gyro_have_no_scatter(void **state)
{
	(void)state;
	for (int i = 0; i < 10; i++) {
		struct imu_sample s = {.gyro_rad_s = any_vec(1), .accel_m_s2 = {0, 0, G}};

		calibrate_gyro_init(&gyro, &(struct calibrate_gyro_config){.rest_s = 10, .patience_s = 60});
		while (calibrate_gyro_step(&gyro, &s) == CALIBRATE_COLLECTING)
			s.t_us += INTERVAL_US;
		assert_vec_near(gyro.result.bias_rad_s, s.gyro_rad_s, 1e-12);
		assert_vec_near(gyro.result.sigma_rad_s, ((struct vec3){0, 0, 0}), 1e-12);
	}
}

static void test_a_gyro_bias_of_more_than_100_degrees_per_second_is_implausible(void **state)
{
	(void)state;
	for (int axis = 0; axis < 3; axis++) {
		struct vec3 bias = {0, 0, 0};

		*component(&bias, axis) = 99.5 * RAD_PER_DEG;
		assert_int_equal(gyro_log(42, bias, &NO_DRIFT), CALIBRATE_GOOD);
		*component(&bias, axis) = -100.5 * RAD_PER_DEG;
		assert_int_equal(gyro_log(42, bias, &NO_DRIFT), CALIBRATE_IMPLAUSIBLE);
	}
}

static void test_gravity_that_drifts_by_5_mm_s3_or_a_field_by_0_03_uT_s_is_a_turn(void **state)
{
	const struct vec3 bias = {0, 0, 0};

	(void)state;
	assert_int_equal(gyro_log(42, bias, &(struct gyro_drift){.accel_m_s3 = 0.0049}), CALIBRATE_GOOD);
	assert_int_equal(gyro_log(42, bias, &(struct gyro_drift){.accel_m_s3 = 0.0051}), CALIBRATE_TURNED);
	assert_int_equal(gyro_log(42, bias, &(struct gyro_drift){.field_uT_s = 0.029}), CALIBRATE_GOOD);
	assert_int_equal(gyro_log(42, bias, &(struct gyro_drift){.field_uT_s = -0.031}), CALIBRATE_TURNED);
}

/* The slope over 40 blocks whose means alternate by +-a has the sigma 1.026 a / 18.25 s. 3 sigma are 0.0021 m/s^3 at
 * a = 0.0125 and 0.0030 at 0.0175, and the slope is 0.0025 above the limit, less 0.015 a / s. */
static void test_a_drift_counts_only_beyond_three_sigma_of_its_noise(void **state)
{
	struct gyro_drift drift = {.accel_m_s3 = 0.0075, .alternating_m_s2 = 0.0125};

	(void)state;
	assert_int_equal(gyro_log(42, (struct vec3){0, 0, 0}, &drift), CALIBRATE_TURNED);
	drift.alternating_m_s2 = 0.0175;
	assert_int_equal(gyro_log(42, (struct vec3){0, 0, 0}, &drift), CALIBRATE_GOOD);
}

/* 1 degC more with each block. */
static void test_the_gyro_ends_after_ten_seconds_with_the_mean_temperature_of_the_rest(void **state)
{
	struct imu_sample s = {.accel_m_s2 = {0, 0, G}, .flags = SAMPLE_TEMPERATURE};

	(void)state;
	calibrate_gyro_init(&gyro, &CALIBRATE_GYRO_DEFAULTS);
	for (int i = 0; i < 41 * BLOCK + 1; i++) {
		s.temperature_degC = i / BLOCK;
		assert_int_equal(calibrate_gyro_step(&gyro, &s), CALIBRATE_COLLECTING);
		s.t_us += INTERVAL_US;
		if (i == 22 * BLOCK)
			assert_near(calibrate_gyro_progress(&gyro), 0.5, 1e-9);
	}
	for (int i = 0; i < BLOCK; i++) {
		calibrate_gyro_step(&gyro, &s);
		s.t_us += INTERVAL_US;
	}
	assert_int_equal(gyro.verdict, CALIBRATE_GOOD);
	assert_near(gyro.result.rest_s, 10, 1e-9);
	assert_near(gyro.result.temperature_degC, 20.5, 1e-9); /* of blocks 1 to 40 */
}

static void test_a_gyro_that_moves_for_a_minute_is_refused(void **state)
{
	struct imu_sample s = {.accel_m_s2 = {0, 0, G}};

	(void)state;
	calibrate_gyro_init(&gyro, &CALIBRATE_GYRO_DEFAULTS);
	for (int i = 0; i <= 6000; i++) {
		s.gyro_rad_s.x = i % 2;
		assert_int_equal(calibrate_gyro_step(&gyro, &s), CALIBRATE_COLLECTING);
		s.t_us += INTERVAL_US;
	}
	assert_int_equal(calibrate_gyro_step(&gyro, &s), CALIBRATE_MOVED);
}

/* ---- accelerometer ----------------------------------------------------------------------------------------------- */

static struct calibrate_accelerometer accel;

static void begin_accelerometer(enum calibrate_positions positions)
{
	const struct calibrate_accelerometer_config config = {
		.positions = positions, .gravity_m_s2 = G, .use_all = true, .patience_s = (double)INFINITY};

	calibrate_accelerometer_init(&accel, &config);
}

/* A block of motion, then so many at rest. The last one is closed by the next call, the first and the last are not
 * used: during this call, three less are. */
static void measure_for(struct vec3 raw_m_s2, int still_blocks)
{
	static uint64_t t_us;

	for (int i = 0; i < (1 + still_blocks) * BLOCK; i++) {
		struct imu_sample s = {.t_us = t_us += INTERVAL_US, .accel_m_s2 = raw_m_s2};

		if (i < BLOCK)
			s.accel_m_s2.x += i % 2 ? 5 : -5;
		s.temperature_degC = 20 + accel.positions;
		s.flags = SAMPLE_TEMPERATURE;
		calibrate_accelerometer_step(&accel, &s);
	}
}

static void measure(struct vec3 raw_m_s2)
{
	measure_for(raw_m_s2, 8);
}

/* Six faces, then the eight corners of a cube. */
static struct vec3 side_up(int side)
{
	static const double corner = 0.57735026918962573; /* 1 / sqrt(3) */

	if (side < 6)
		return vec3_scale(side % 2 ? -G : G, (struct vec3){side / 2 == 0, side / 2 == 1, side / 2 == 2});
	return vec3_scale(G * corner, (struct vec3){side & 1 ? -1 : 1, side & 2 ? -1 : 1, side & 4 ? -1 : 1});
}

/* raw = matrix * gravity + bias in 6 or 14 positions. */
static enum calibrate_verdict calibrate_with(enum calibrate_positions positions, struct mat3 matrix, struct vec3 bias)
{
	begin_accelerometer(positions);
	for (int i = 0; i < (positions == CALIBRATE_SIX_FACES ? 6 : 14); i++)
		measure(vec3_add(mat3_apply(matrix, side_up(i)), bias));
	return calibrate_accelerometer_finish(&accel);
}

static const struct mat3 EXACT = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
static const struct vec3 NO_BIAS = {0, 0, 0};

static void test_an_accelerometer_bias_of_more_than_half_of_gravity_is_implausible(void **state)
{
	const double each = G / sqrt(3);

	(void)state;
	assert_int_equal(calibrate_with(CALIBRATE_FREE, EXACT, (struct vec3){0.49 * each, -0.49 * each, 0.49 * each}),
		CALIBRATE_GOOD);
	assert_vec_near(accel.result.calibration.bias, ((struct vec3){0.49 * each, -0.49 * each, 0.49 * each}), 1e-6);
	assert_int_equal(calibrate_with(CALIBRATE_FREE, EXACT, (struct vec3){0.51 * each, -0.51 * each, 0.51 * each}),
		CALIBRATE_IMPLAUSIBLE);
}

static void test_a_scale_factor_outside_0_7_to_1_4_is_implausible(void **state)
{
	(void)state;
	for (int axis = 0; axis < 3; axis++) {
		struct mat3 m = EXACT;

		m.m[axis][axis] = 1 / 0.71;
		assert_int_equal(calibrate_with(CALIBRATE_SIX_FACES, m, NO_BIAS), CALIBRATE_GOOD);
		assert_near(accel.result.calibration.matrix[axis][axis], 0.71, 1e-9);
		m.m[axis][axis] = 1 / 0.69;
		assert_int_equal(calibrate_with(CALIBRATE_SIX_FACES, m, NO_BIAS), CALIBRATE_IMPLAUSIBLE);
		m.m[axis][axis] = 1 / 1.39;
		assert_int_equal(calibrate_with(CALIBRATE_SIX_FACES, m, NO_BIAS), CALIBRATE_GOOD);
		m.m[axis][axis] = 1 / 1.41;
		assert_int_equal(calibrate_with(CALIBRATE_SIX_FACES, m, NO_BIAS), CALIBRATE_IMPLAUSIBLE);
	}
}

/* The inverse of {{1, c}, {c, 1}} is {{1, -c}, {-c, 1}} / (1 - c^2). */
static void test_a_cross_axis_term_of_more_than_0_4_is_implausible(void **state)
{
	(void)state;
	for (int pair = 0; pair < 3; pair++)
		for (int above = 0; above < 2; above++) {
			const int i = pair == 2, j = pair == 0 ? 1 : 2;
			const double c = above ? 0.41 : 0.39, det = 1 - c * c;
			struct mat3 m = EXACT;

			m.m[i][i] = m.m[j][j] = 1 / det;
			m.m[i][j] = m.m[j][i] = -c / det;
			assert_int_equal(calibrate_with(CALIBRATE_FREE, m, NO_BIAS),
				above ? CALIBRATE_IMPLAUSIBLE : CALIBRATE_GOOD);
			assert_near(accel.result.calibration.matrix[i][j], c, 1e-6);
		}
}

/* Both faces of one axis are moved by d along it. The bias takes a third of it. The differences of the pairs from it,
 * twice each, have the sum of squares 2 (4/9 + 1/9 + 1/9) d^2 = 4/3 d^2; with 6 degrees of freedom the residual is
 * d sqrt(2) / 3. */
static void test_a_residual_of_more_than_0_8_percent_of_gravity_is_refused(void **state)
{
	(void)state;
	for (int axis = 0; axis < 3; axis++)
		for (int above = 0; above < 2; above++) {
			const double residual = G * (above ? 0.0081 : 0.0079), d = residual * 3 / sqrt(2);

			begin_accelerometer(CALIBRATE_SIX_FACES);
			for (int i = 0; i < 6; i++) {
				struct vec3 raw = side_up(i);

				if (i / 2 == axis)
					*component(&raw, axis) += d;
				measure(raw);
			}
			assert_int_equal(calibrate_accelerometer_finish(&accel),
				above ? CALIBRATE_LARGE_RESIDUAL : CALIBRATE_GOOD);
			assert_near(accel.result.residual_m_s2, residual, 1e-9);
			assert_near(accel.result.bias_sigma_m_s2.y, residual / sqrt(6), 1e-9);
			assert_near(accel.result.matrix_sigma, residual / sqrt(2) / G, 1e-9);
			assert_near(*component(&accel.result.calibration.bias, axis), d / 3, 1e-9);
		}
}

static void test_faces_turned_by_more_than_5_degrees_are_refused(void **state)
{
	(void)state;
	for (int axis = 0; axis < 3; axis++)
		for (int above = 0; above < 2; above++) {
			struct vec3 turn = {0, 0, 0};

			*component(&turn, axis) = (above ? 5.05 : 4.95) * RAD_PER_DEG;
			assert_int_equal(calibrate_with(CALIBRATE_SIX_FACES,
						 mat3_from_quat(quat_from_rotation_vector(turn)), NO_BIAS),
				above ? CALIBRATE_FACES_TURNED : CALIBRATE_GOOD);
			assert_near(accel.result.faces_turned_rad, *component(&turn, axis), 2e-4);
		}
}

static void test_a_position_needs_five_blocks(void **state)
{
	(void)state;
	begin_accelerometer(CALIBRATE_FREE);
	measure_for((struct vec3){0, 0, G}, 7);
	assert_int_equal(accel.positions, 0);
	begin_accelerometer(CALIBRATE_FREE);
	measure_for((struct vec3){0, 0, G}, 8);
	assert_int_equal(accel.positions, 1);
}

static void test_positions_more_than_20_degrees_apart_are_two(void **state)
{
	(void)state;
	for (int above = 0; above < 2; above++) {
		const double angle = (above ? 20.1 : 19.9) * RAD_PER_DEG;

		begin_accelerometer(CALIBRATE_FREE);
		measure((struct vec3){0, 0, G});
		measure((struct vec3){0, G * sin(angle), G * cos(angle)});
		assert_int_equal(accel.positions, above ? 2 : 1);
		begin_accelerometer(CALIBRATE_SIX_FACES);
		measure((struct vec3){0, G * sin(angle), G * cos(angle)});
		assert_int_equal(accel.positions, above ? 0 : 1);
	}
}

/* The positions are measured at 20, 21, .. 25 degC, with 6 blocks each but the last one, which has 5. */
static void test_an_accelerometer_result_has_the_temperature_of_its_rests_and_the_drift_of_its_bias(void **state)
{
	(void)state;
	begin_accelerometer(CALIBRATE_SIX_FACES);
	accel.config.bias_instability_m_s2 = 0.002;
	for (int i = 0; i < 6; i++)
		measure(side_up(i));
	assert_int_equal(calibrate_accelerometer_finish(&accel), CALIBRATE_GOOD);
	assert_near(accel.result.temperature_degC, (6 * (20 + 21 + 22 + 23 + 24) + 5 * 25) / 35.0, 1e-9);
	assert_vec_near(accel.result.bias_sigma_m_s2, ((struct vec3){0.003, 0.003, 0.003}), 1e-9);
	assert_near(accel.coverage, 1, 1e-12);
}

static void test_each_step_of_an_accelerometer_calibration_returns_its_verdict(void **state)
{
	struct imu_sample s = {.accel_m_s2 = {0, 0, G}};

	(void)state;
	begin_accelerometer(CALIBRATE_SIX_FACES);
	accel.config.use_all = false;
	for (int i = 0; i < 6; i++) {
		assert_int_equal(calibrate_accelerometer_step(&accel, &s), CALIBRATE_COLLECTING);
		measure(side_up(i));
	}
	assert_int_equal(calibrate_accelerometer_step(&accel, &s), CALIBRATE_GOOD);
	assert_int_equal(calibrate_accelerometer_finish(&accel), CALIBRATE_GOOD);
}

/* ---- magnetometer ------------------------------------------------------------------------------------------------ */

static struct calibrate_magnetometer mag;
static struct imu_sample mag_sample;

static void begin_magnetometer(bool use_all)
{
	const struct calibrate_magnetometer_config config = {.use_all = use_all, .patience_s = 1000};

	calibrate_magnetometer_init(&mag, &config);
	mag_sample = (struct imu_sample){.flags = SAMPLE_MAG};
}

static void give(struct vec3 field_uT)
{
	mag_sample.mag_uT = field_uT;
	mag_sample.t_us += 1000;
	calibrate_magnetometer_step(&mag, &mag_sample);
}

/* Point i of 100 on a sphere of radius 1, evenly from its lower pole up to the height `top`. */
static struct vec3 spiral(int i, double top)
{
	double z = -1 + (top + 1) * (i + 0.5) / 100, r = sqrt(1 - z * z);

	return (struct vec3){r * cos(2.4 * i), r * sin(2.4 * i), z};
}

/* Each point three times, so that none is a spike. */
static enum calibrate_verdict magnetometer_log(struct vec3 axes_uT, double top, double ripple)
{
	begin_magnetometer(true);
	for (int i = 0; i < 300; i++) {
		struct vec3 p = vec3_scale(1 + ((i / 3) % 2 ? -ripple : ripple), spiral(i / 3, top));

		give((struct vec3){p.x * axes_uT.x, p.y * axes_uT.y, p.z * axes_uT.z});
	}
	return calibrate_magnetometer_finish(&mag);
}

static void test_a_field_outside_10_to_150_uT_is_implausible(void **state)
{
	(void)state;
	assert_int_equal(magnetometer_log((struct vec3){9.9, 9.9, 9.9}, 1, 0), CALIBRATE_IMPLAUSIBLE);
	assert_int_equal(magnetometer_log((struct vec3){10.1, 10.1, 10.1}, 1, 0), CALIBRATE_GOOD);
	assert_near(mag.result.field_uT, 10.1, 1e-6);
	assert_int_equal(magnetometer_log((struct vec3){149, 149, 149}, 1, 0), CALIBRATE_GOOD);
	assert_int_equal(magnetometer_log((struct vec3){151, 151, 151}, 1, 0), CALIBRATE_IMPLAUSIBLE);
}

static void test_an_ellipsoid_more_than_2_5_times_as_long_as_wide_is_refused(void **state)
{
	(void)state;
	assert_int_equal(magnetometer_log((struct vec3){50, 40, 50 / 2.48}, 1, 0), CALIBRATE_GOOD);
	assert_int_equal(magnetometer_log((struct vec3){50, 40, 50 / 2.52}, 1, 0), CALIBRATE_NO_ELLIPSOID);
	assert_int_equal(magnetometer_log((struct vec3){50 / 2.52, 40, 50}, 1, 0), CALIBRATE_NO_ELLIPSOID);
}

/* Every other point is outside, the others inside, which no ellipsoid follows: with 100 points less 9 unknowns the
 * residual is the ripple times sqrt(100 / 91). */
static void test_a_residual_of_more_than_5_percent_of_the_field_is_refused(void **state)
{
	const struct vec3 sphere = {50, 50, 50};

	(void)state;
	assert_int_equal(magnetometer_log(sphere, 1, 0.049 * sqrt(0.91)), CALIBRATE_GOOD);
	assert_near(mag.result.residual, 0.049, 0.0005);
	assert_int_equal(magnetometer_log(sphere, 1, 0.051 * sqrt(0.91)), CALIBRATE_LARGE_RESIDUAL);
}

/* Coverage as defined in ellipsoid.h, of these points, from the least eigenvalue of their information matrix: 0.39 up
 * to the height 0.4525 and 0.41 up to 0.4757. */
static void test_a_coverage_of_less_than_0_4_is_refused(void **state)
{
	const struct vec3 sphere = {50, 50, 50};

	(void)state;
	assert_int_equal(magnetometer_log(sphere, 0.4525, 0), CALIBRATE_POOR_COVERAGE);
	assert_near(mag.coverage, 0.39, 1e-4);
	assert_int_equal(magnetometer_log(sphere, 0.4757, 0), CALIBRATE_GOOD);
	assert_near(mag.coverage, 0.41, 1e-4);
}

/* As above: 0.59 up to 0.6554 and 0.61 up to 0.673. The last sample comes when a second has passed. */
static void test_the_device_ends_at_a_coverage_of_0_6(void **state)
{
	(void)state;
	for (int above = 0; above < 2; above++) {
		begin_magnetometer(false);
		for (int i = 0; i < 1002; i++)
			give(vec3_scale(50, spiral(i < 300 ? i / 3 : 99, above ? 0.673 : 0.6554)));
		assert_int_equal(mag.verdict, above ? CALIBRATE_GOOD : CALIBRATE_COLLECTING);
		assert_near(calibrate_magnetometer_progress(&mag), above ? 1 : 0.59 / 0.6, 1e-3);
	}
}

static void give_three_times(struct vec3 field_uT)
{
	for (int i = 0; i < 3; i++)
		give(field_uT);
}

static void test_points_nearer_than_2_uT_are_one(void **state)
{
	(void)state;
	begin_magnetometer(true);
	give_three_times((struct vec3){50, 0, 0});
	give_three_times((struct vec3){50, 0, 1.99});
	assert_int_equal(mag.count, 1);
	give_three_times((struct vec3){50, 0, 2.01});
	assert_int_equal(mag.count, 2);
}

/* 2.5 uT apart they are all kept, 2.6 uT every second one. */
static void test_a_full_memory_thins_out_the_points_and_goes_on_with_a_spacing_of_2_6_uT(void **state)
{
	(void)state;
	begin_magnetometer(true);
	for (int i = 0; i < CALIBRATE_POINTS_MAX; i++)
		give_three_times((struct vec3){2.5 * i, 0, 0});
	assert_int_equal(mag.count, CALIBRATE_POINTS_MAX);
	give_three_times((struct vec3){-2.5, 0, 0});
	assert_int_equal(mag.count, CALIBRATE_POINTS_MAX / 2 + 1);
	give_three_times((struct vec3){0, 2.55, 0});
	assert_int_equal(mag.count, CALIBRATE_POINTS_MAX / 2 + 1);
	give_three_times((struct vec3){0, 2.65, 0});
	assert_int_equal(mag.count, CALIBRATE_POINTS_MAX / 2 + 2);
}

/* While the field turns by 20 uT from sample to sample, a sample may be 10 uT more beside the middle. */
static void test_a_sample_more_than_10_uT_from_its_neighbours_is_a_spike(void **state)
{
	static const double turn_uT[2] = {0, 20};

	(void)state;
	for (int i = 0; i < 2; i++) {
		const double most = 10 + turn_uT[i] / 2;

		begin_magnetometer(true);
		give((struct vec3){50, 0, 0});
		give((struct vec3){50, turn_uT[i] / 2, most + 0.1});
		give((struct vec3){50, turn_uT[i], 0});
		assert_int_equal(mag.count, 0);
		begin_magnetometer(true);
		give((struct vec3){50, 0, 0});
		give((struct vec3){50, turn_uT[i] / 2, most - 0.1});
		give((struct vec3){50, turn_uT[i], 0});
		assert_int_equal(mag.count, 1);
	}
}

static void test_a_field_of_more_than_1_T_is_not_a_measurement(void **state)
{
	(void)state;
	begin_magnetometer(true);
	give_three_times((struct vec3){0, 0, 1.01e6});
	assert_int_equal(mag.count, 0);
	give_three_times((struct vec3){0, 0, 0.99e6});
	assert_int_equal(mag.count, 1);
}

static void test_a_saturated_field_is_not_used(void **state)
{
	(void)state;
	begin_magnetometer(true);
	mag_sample.flags |= SAMPLE_SATURATED;
	give_three_times((struct vec3){50, 0, 0});
	assert_int_equal(mag.count, 0);
	assert_int_equal(calibrate_magnetometer_finish(&mag), CALIBRATE_NO_MAGNETOMETER);
}

static void test_a_magnetometer_is_missing_after_five_seconds_without_gaps(void **state)
{
	(void)state;
	begin_magnetometer(false);
	mag_sample.flags = 0;
	for (int i = 0; i < 25; i++) {
		mag_sample.t_us += i % 2 ? 400000 : 600000; /* 600 ms are a gap */
		assert_int_equal(calibrate_magnetometer_step(&mag, &mag_sample), CALIBRATE_COLLECTING);
	}
	mag_sample.t_us += 400000;
	calibrate_magnetometer_step(&mag, &mag_sample);
	assert_int_equal(mag.verdict, CALIBRATE_NO_MAGNETOMETER);
}

static void test_each_step_of_a_magnetometer_calibration_returns_its_verdict(void **state)
{
	(void)state;
	begin_magnetometer(false);
	for (int i = 0; i < 1100; i++) {
		mag_sample.mag_uT = vec3_scale(50, spiral(i < 300 ? i / 3 : 99, 1));
		mag_sample.t_us += 1000;
		assert_int_equal(calibrate_magnetometer_step(&mag, &mag_sample),
			i < 1000 ? CALIBRATE_COLLECTING : CALIBRATE_GOOD);
	}
	assert_int_equal(calibrate_magnetometer_finish(&mag), CALIBRATE_GOOD);
}

/* A hyperboloid of two sheets, by which the points of a well covered sphere are outnumbered, is no ellipsoid. */
static void test_points_of_no_ellipsoid_cover_nothing(void **state)
{
	(void)state;
	begin_magnetometer(true);
	for (int i = 0; i < 1100; i++)
		give(vec3_scale(15, spiral(i < 300 ? i / 3 : 99, 1)));
	assert_true(mag.coverage > 0.9);
	for (int i = 0; i < 900; i++) {
		const double angle = 2.4 * (i / 3), r = 3.0 * sqrt(i / 3), z = sqrt(400 + r * r);

		give((struct vec3){r * cos(angle), r * sin(angle), i / 3 % 2 ? z : -z});
	}
	assert_int_equal(calibrate_magnetometer_finish(&mag), CALIBRATE_NO_ELLIPSOID);
	assert_near(mag.coverage, 0, 0);
}

static void test_a_sample_10_uT_from_its_neighbours_is_not_a_spike(void **state)
{
	(void)state;
	begin_magnetometer(true);
	give((struct vec3){50, 0, 0});
	give((struct vec3){50, 0, 10});
	give((struct vec3){50, 0, 0});
	assert_int_equal(mag.count, 1);
	assert_vec_near(mag.points[0], ((struct vec3){50, 0, 10}), 0);
}

/* ---- temperature ------------------------------------------------------------------------------------------------- */

static struct calibrate_temperature temperature;

/* Blocks at rest from 20 degC on, warmed evenly by span_K; then one of motion, a rest with one used block, motion. */
static enum calibrate_verdict temperature_log(int count, double span_K, double square)
{
	struct imu_sample s = {.accel_m_s2 = {0, 0, G}, .flags = SAMPLE_TEMPERATURE};

	calibrate_temperature_init(&temperature);
	for (int i = 0; i < (count + 5) * BLOCK; i++) {
		int block = i / BLOCK - count;
		double warmer_K = span_K * fmin(1, i / (double)(count * BLOCK));

		s.t_us += INTERVAL_US;
		s.temperature_degC = 20 + warmer_K;
		s.gyro_rad_s.y = 1e-5 * warmer_K + square * warmer_K * warmer_K;
		if (block == 0 || block == 4)
			s.gyro_rad_s.y = i % 2;
		calibrate_temperature_step(&temperature, &s);
	}
	return calibrate_temperature_finish(&temperature);
}

static void test_a_rest_with_one_block_does_not_count_for_the_slope(void **state)
{
	(void)state;
	assert_int_equal(temperature_log(102, 20, 0), CALIBRATE_GOOD);
	assert_near(temperature.result.rest_s, 25, 1e-9);
	assert_near(temperature.result.compensation.gyro_slope.y, 1e-5, 1e-12);
}

static void test_a_temperature_calibration_needs_20_seconds_of_rest_and_5_K(void **state)
{
	(void)state;
	assert_int_equal(temperature_log(82, 20, 0), CALIBRATE_GOOD);
	assert_int_equal(temperature_log(81, 20, 0), CALIBRATE_NO_TEMPERATURE);
	assert_int_equal(temperature_log(80, 20, 0), CALIBRATE_MOVED);
	/* the last block of motion and the first and last of the rest do not count */
	assert_int_equal(temperature_log(402, 4.98, 0), CALIBRATE_SMALL_TEMPERATURE_SPAN);
	assert_int_equal(temperature_log(402, 5.05, 0), CALIBRATE_GOOD);
}

/* Two rests of 30 s, each warmed evenly by rise_K; the second one begins 10 K warmer. */
static enum calibrate_verdict two_warm_rests(double rise_K)
{
	struct imu_sample s = {.accel_m_s2 = {0, 0, G}, .flags = SAMPLE_TEMPERATURE};

	calibrate_temperature_init(&temperature);
	for (int i = 0; i < 61 * 100; i++) {
		const int at = i % 3050;

		s.t_us += INTERVAL_US;
		s.temperature_degC = 20 + rise_K * at / 3000 + (i >= 3050 ? 10 : 0);
		s.gyro_rad_s.y = at >= 3000 ? i % 2 : 0;
		calibrate_temperature_step(&temperature, &s);
	}
	return calibrate_temperature_finish(&temperature);
}

/* An even rise has a standard deviation of 1 / sqrt(12) of it; a sixth of the 5 K is 2.89 K of a rise. */
static void test_what_the_temperature_rises_by_between_two_rests_does_not_count(void **state)
{
	(void)state;
	assert_int_equal(two_warm_rests(2.7), CALIBRATE_SMALL_TEMPERATURE_SPAN);
	assert_int_equal(two_warm_rests(3.1), CALIBRATE_GOOD);
	assert_true(temperature.result.highest_degC - temperature.result.lowest_degC > 12);
}

static void test_a_parabola_needs_a_span_of_15_K(void **state)
{
	(void)state;
	assert_int_equal(temperature_log(402, 14.95, 1e-6), CALIBRATE_GOOD);
	assert_false(temperature.result.quadratic);
	assert_int_equal(temperature_log(402, 15.1, 1e-6), CALIBRATE_GOOD);
	assert_true(temperature.result.quadratic);
	assert_near(temperature.result.compensation.gyro_quadratic.y, 1e-6, 1e-9);
}

static void test_biases_that_do_not_change_with_the_temperature_have_no_slope_and_no_residual(void **state)
{
	const struct calibrate_temperature_result *r = &temperature.result;
	struct imu_sample s = {.gyro_rad_s = {1.1, -0.7, 0.3}, .accel_m_s2 = {5.3, 6.1, -5.7}};

	(void)state;
	calibrate_temperature_init(&temperature);
	s.flags = SAMPLE_TEMPERATURE;
	for (int i = 0; i < 10000; i++) {
		s.t_us += INTERVAL_US;
		s.temperature_degC = 20 + i / 1000.0;
		calibrate_temperature_step(&temperature, &s);
	}
	assert_int_equal(calibrate_temperature_finish(&temperature), CALIBRATE_GOOD);
	assert_vec_near(r->gyro_rad_s, s.gyro_rad_s, 1e-12);
	assert_vec_near(r->compensation.gyro_slope, ((struct vec3){0, 0, 0}), 1e-15);
	assert_vec_near(r->compensation.accel_slope, ((struct vec3){0, 0, 0}), 1e-15);
	assert_vec_near(r->gyro_residual_rad_s, ((struct vec3){0, 0, 0}), 1e-12);
	assert_vec_near(r->accel_residual_m_s2, ((struct vec3){0, 0, 0}), 1e-12);
}

/* ---- the ellipsoid ----------------------------------------------------------------------------------------------- */

static double sum_of_squares(const struct vec3 *points, int count, const struct ellipsoid *e)
{
	double sum = 0;

	for (int i = 0; i < count; i++)
		sum += pow(vec3_norm(mat3_apply(e->matrix, vec3_sub(points[i], e->centre))) - e->radius, 2);
	return sum;
}

/* Element 0 to 8 of centre and symmetric matrix. */
static void change_element(struct ellipsoid *e, int element, double by)
{
	static const int row[6] = {0, 1, 2, 0, 0, 1}, column[6] = {0, 1, 2, 1, 2, 2};

	if (element < 3) {
		*component(&e->centre, element) += by * e->radius;
	} else {
		int i = row[element - 3], j = column[element - 3];

		e->matrix.m[i][j] += by;
		e->matrix.m[j][i] = e->matrix.m[i][j];
	}
}

/* All points but one lie on the sphere from which the fit starts. The parameters of least squares cannot be changed
 * without more of them. */
static void test_the_fit_of_an_ellipsoid_is_that_of_least_squares_whichever_point_is_off(void **state)
{
	enum { POINTS = 25 };

	(void)state;
	for (int off = 0; off < POINTS; off++) {
		struct ellipsoid e = {.matrix = EXACT};
		struct vec3 points[POINTS];
		double least;

		for (int i = 0; i < POINTS; i++)
			points[i] = vec3_scale(i == off ? 53 : 50, spiral(4 * i + 1, 1));
		assert_int_equal(ellipsoid_fit(points, POINTS, 50, false, &e), 0);
		least = sum_of_squares(points, POINTS, &e);
		assert_near(e.rms, sqrt(least / (POINTS - 9)), 1e-9);
		for (int element = 0; element < 9; element++)
			for (int sign = -1; sign <= 1; sign += 2) {
				struct ellipsoid beside = e;

				change_element(&beside, element, sign * 1e-5);
				assert_true(sum_of_squares(points, POINTS, &beside) > least);
			}
	}
}

/* The first full Gauss-Newton step leads away from it. */
static void test_a_fit_that_starts_0_8_radii_beside_the_centre_arrives(void **state)
{
	struct ellipsoid e = {.matrix = EXACT};
	struct vec3 points[50];

	(void)state;
	for (int i = 0; i < 50; i++) {
		struct vec3 u = spiral(2 * i, 1);

		points[i] = (struct vec3){50 * u.x + 40, 65 * u.y, 40 * u.z};
	}
	assert_int_equal(ellipsoid_fit(points, 50, 50, false, &e), 0);
	assert_vec_near(e.centre, ((struct vec3){40, 0, 0}), 1e-6);
	assert_near(e.matrix.m[1][1], 50 / 65.0, 1e-8);
	assert_near(e.matrix.m[2][2], 50 / 40.0, 1e-8);
}

/* Ten of 200 points that lie 10 uT outside, all to one side, move the centre of a plain fit, and hardly that of a
 * robust one. */
static void test_a_robust_fit_is_hardly_moved_by_outliers(void **state)
{
	struct vec3 points[200];
	double off[2];

	(void)state;
	for (int i = 0; i < 200; i++) {
		const struct vec3 n = quat_rotate(any_attitude(), (struct vec3){0, 0, 1});

		points[i] = vec3_scale(50, n);
		if (i < 10)
			points[i] = vec3_scale(60, quat_rotate_inverse(quat_from_rotation_vector(vec3_scale(0.3, n)),
							   (struct vec3){1, 0, 0}));
	}
	for (int robust = 0; robust < 2; robust++) {
		struct ellipsoid e = {.matrix = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}};

		assert_int_equal(ellipsoid_fit(points, 200, 50, robust, &e), 0);
		off[robust] = vec3_norm(e.centre);
	}
	assert_true(off[0] > 0.5);
	assert_true(off[1] < 0.4 * off[0]);
}

/* ---- turns between rests ---- */

/* Of so many whole samples as are 0.1 s or just more. */
static void test_a_turn_is_kept_in_parts_of_a_tenth_of_a_second(void **state)
{
	const double rates_hz[] = {50, 100, 208, 400};

	(void)state;
	for (size_t i = 0; i < sizeof rates_hz / sizeof *rates_hz; i++) {
		static struct gyro_turns t;

		gyro_turns_init(&t);
		t.integrating = true;
		for (int k = 1; k <= (int)rates_hz[i]; k++) {
			const struct imu_sample raw = {
				.t_us = (uint64_t)llround(1e6 * k / rates_hz[i]), .gyro_rad_s = {0.5, 0, -1}};

			gyro_turns_sample(&t, &raw);
		}
		assert_int_equal(t.parts, rates_hz[i] == 208 ? 9 : 10); /* 21 samples of 208 Hz */
		for (int k = 1; k < t.parts; k++) {
			const double s = ceil(0.1 * rates_hz[i] - 1e-9) / rates_hz[i];

			assert_true(fabs(t.part[k].s - s) < 1e-5);
			assert_true(fabs(t.part[k].angle_rad.x - 0.5 * s) < 1e-5);
			assert_true(fabs(t.part[k].angle_rad.z + s) < 1e-5);
		}
	}
}

/* Three turns about each axis, from as many attitudes, by a gyro without errors. */
static void test_nine_turns_give_the_matrix_of_a_gyro_and_eight_do_not(void **state)
{
	const struct triad_calibration exact = {.matrix = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};

	(void)state;
	for (int turns = 8; turns <= 9; turns++) {
		static struct gyro_turns t;
		struct gyro_turns_result r;

		gyro_turns_init(&t);
		for (int i = 0; i < turns; i++) {
			struct vec3 angle = {0.3, -0.2, 0.1}, before = {1, 2, -2};

			*component(&angle, i % 3) = i < 6 ? 1.6 : -1.5;
			*component(&before, i / 3) *= -1;
			before = vec3_scale(G / 3, before);
			for (int k = 0; k < 10; k++)
				t.part[t.parts++] = (struct gyro_part){vec3_scale(0.1, angle), 0.1 * (1 + i % 4)};
			t.turn[t.turns++] = (struct gyro_turn){.end = t.parts,
				.before_m_s2 = before,
				.after_m_s2 = quat_rotate_inverse(quat_from_rotation_vector(angle), before)};
		}
		r = gyro_turns_solve(&t, &exact);
		assert_int_equal(r.turns, turns);
		assert_int_equal(r.found, turns == 9);
		for (int i = 0; i < 9 && r.found; i++)
			assert_near(r.matrix[i / 3][i % 3], i % 4 == 0, 1e-6);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test_setup(test_the_first_and_the_last_block_of_a_rest_are_not_reported, fresh_rest),
		cmocka_unit_test_setup(
			test_a_rest_of_two_blocks_is_not_reported_and_one_of_three_has_one_block, fresh_rest),
		cmocka_unit_test_setup(test_three_samples_make_a_block_and_two_do_not, fresh_rest),
		cmocka_unit_test_setup(test_a_few_samples_between_two_rests_end_the_first, fresh_rest),
		cmocka_unit_test_setup(test_a_block_is_the_mean_of_its_samples, fresh_rest),
		cmocka_unit_test_setup(
			test_noise_above_one_degree_per_second_or_0_15_m_s2_on_any_axis_is_not_a_rest, fresh_rest),
		cmocka_unit_test_setup(test_a_step_of_the_mean_above_the_limit_ends_a_rest, fresh_rest),
		cmocka_unit_test_setup(test_a_step_counts_from_the_mean_over_two_seconds_at_most, fresh_rest),
		cmocka_unit_test_setup(test_the_time_stands_still_in_gaps_of_more_than_half_a_second, fresh_rest),
		cmocka_unit_test_setup(test_a_discontinuity_or_a_saturated_sample_ends_a_rest, fresh_rest),
		cmocka_unit_test_setup(test_a_gyro_needs_five_seconds_of_rest, fresh_rest),
		cmocka_unit_test(test_a_robust_fit_is_hardly_moved_by_outliers),
		cmocka_unit_test(test_the_sigma_of_a_gyro_without_noise_is_that_of_its_drift),
		cmocka_unit_test(test_equal_measurements_of_a_gyro_have_no_scatter),
		cmocka_unit_test(test_a_gyro_bias_of_more_than_100_degrees_per_second_is_implausible),
		cmocka_unit_test(test_gravity_that_drifts_by_5_mm_s3_or_a_field_by_0_03_uT_s_is_a_turn),
		cmocka_unit_test(test_a_drift_counts_only_beyond_three_sigma_of_its_noise),
		cmocka_unit_test(test_the_gyro_ends_after_ten_seconds_with_the_mean_temperature_of_the_rest),
		cmocka_unit_test(test_a_gyro_that_moves_for_a_minute_is_refused),
		cmocka_unit_test(test_an_accelerometer_bias_of_more_than_half_of_gravity_is_implausible),
		cmocka_unit_test(test_a_scale_factor_outside_0_7_to_1_4_is_implausible),
		cmocka_unit_test(test_a_cross_axis_term_of_more_than_0_4_is_implausible),
		cmocka_unit_test(test_a_residual_of_more_than_0_8_percent_of_gravity_is_refused),
		cmocka_unit_test(test_faces_turned_by_more_than_5_degrees_are_refused),
		cmocka_unit_test(test_a_position_needs_five_blocks),
		cmocka_unit_test(test_positions_more_than_20_degrees_apart_are_two),
		cmocka_unit_test(
			test_an_accelerometer_result_has_the_temperature_of_its_rests_and_the_drift_of_its_bias),
		cmocka_unit_test(test_each_step_of_an_accelerometer_calibration_returns_its_verdict),
		cmocka_unit_test(test_a_field_outside_10_to_150_uT_is_implausible),
		cmocka_unit_test(test_an_ellipsoid_more_than_2_5_times_as_long_as_wide_is_refused),
		cmocka_unit_test(test_a_residual_of_more_than_5_percent_of_the_field_is_refused),
		cmocka_unit_test(test_a_coverage_of_less_than_0_4_is_refused),
		cmocka_unit_test(test_the_device_ends_at_a_coverage_of_0_6),
		cmocka_unit_test(test_points_nearer_than_2_uT_are_one),
		cmocka_unit_test(test_a_full_memory_thins_out_the_points_and_goes_on_with_a_spacing_of_2_6_uT),
		cmocka_unit_test(test_a_sample_more_than_10_uT_from_its_neighbours_is_a_spike),
		cmocka_unit_test(test_a_field_of_more_than_1_T_is_not_a_measurement),
		cmocka_unit_test(test_a_saturated_field_is_not_used),
		cmocka_unit_test(test_a_magnetometer_is_missing_after_five_seconds_without_gaps),
		cmocka_unit_test(test_each_step_of_a_magnetometer_calibration_returns_its_verdict),
		cmocka_unit_test(test_points_of_no_ellipsoid_cover_nothing),
		cmocka_unit_test(test_a_sample_10_uT_from_its_neighbours_is_not_a_spike),
		cmocka_unit_test(test_a_rest_with_one_block_does_not_count_for_the_slope),
		cmocka_unit_test(test_a_temperature_calibration_needs_20_seconds_of_rest_and_5_K),
		cmocka_unit_test(test_what_the_temperature_rises_by_between_two_rests_does_not_count),
		cmocka_unit_test(test_a_parabola_needs_a_span_of_15_K),
		cmocka_unit_test(test_biases_that_do_not_change_with_the_temperature_have_no_slope_and_no_residual),
		cmocka_unit_test(test_the_fit_of_an_ellipsoid_is_that_of_least_squares_whichever_point_is_off),
		cmocka_unit_test(test_a_fit_that_starts_0_8_radii_beside_the_centre_arrives),
		cmocka_unit_test(test_a_turn_is_kept_in_parts_of_a_tenth_of_a_second),
		cmocka_unit_test(test_nine_turns_give_the_matrix_of_a_gyro_and_eight_do_not),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
