/* Vibration that sampling folds, and values beyond the end of a range: what is said of them, and what the attitude's
 * sigma is worth meanwhile. The truth is that of an object that does not turn. */
#include "model_test.h"

#include "model/pipeline.h"
#include "model/sim/rng.h"
#include "model/vibration.h"

static const struct vec3 UP_B = {0.3, -0.4, 0.8660254}; /* of the object, a unit vector */
enum { REST_S = 10, SHAKEN_S = 30, AFTER_S = 40 };

static const struct shaking {
	double rate_hz, shaken_hz, amplitude_m_s2;
	struct vec3 along;
	double range_g;
	bool square;
} SHAKINGS[] = {
	{100, 200.4, 60, {0.6, 0.8, 0}, 16, false},
	{100, 200.4, 60, {0.6, 0.8, 0}, 4, false},
	{100, 97, 60, {1, 0, 0}, 4, false},
	{100, 53, 60, {0, 0.6, -0.8}, 4, false},
	{100, 49.5, 60, {0, 0.6, -0.8}, 4, false},
	{100, 100.3, 10, {1, 0, 0}, 8, false},
	{400, 199, 30, {0, 0, 1}, 2, false},
	{5, 25.2, 10, {1, 0, 0}, 8, false},
	{6, 30.7, 10, {0.6, 0.8, 0}, 8, true},
	{10, 30.7, 10, {0.6, 0.8, 0}, 8, true},
};

static double limited(double value, double most, bool *clipped)
{
	*clipped |= fabs(value) >= most;
	return fmax(-most, fmin(most, value));
}

/* What a chip without a low-pass measures. */
static struct imu_sample shaken(const struct shaking *c, double t_s, struct rng *noise)
{
	double wave = sin(2 * PI * c->shaken_hz * t_s), range = c->range_g * STANDARD_GRAVITY_M_S2;
	bool on = t_s >= REST_S && t_s < REST_S + SHAKEN_S, clipped = false;
	struct vec3 f = vec3_add(vec3_scale(9.81, UP_B),
		vec3_scale(on ? c->amplitude_m_s2 * (c->square ? copysign(1, wave) : wave) : 0, c->along));

	return (struct imu_sample){
		.t_us = (uint64_t)llround(1e6 * t_s),
		.gyro_rad_s = {1e-3 * rng_gauss(noise), 1e-3 * rng_gauss(noise), 1e-3 * rng_gauss(noise)},
		.accel_m_s2 = {limited(f.x + 0.01 * rng_gauss(noise), range, &clipped),
			limited(f.y + 0.01 * rng_gauss(noise), range, &clipped),
			limited(f.z + 0.01 * rng_gauss(noise), range, &clipped)},
		.flags = clipped ? SAMPLE_SATURATED : 0,
	};
}

static double tilt_rad(struct quat q_nb)
{
	return vec3_norm(vec3_sub(quat_rotate_inverse(q_nb, (struct vec3){0, 0, 1}), UP_B));
}

static bool beyond_three_sigma(struct vec3 off, struct vec3 sigma)
{
	return fabs(off.x) > 3 * sigma.x + 1e-3 || fabs(off.y) > 3 * sigma.y + 1e-3 || fabs(off.z) > 3 * sigma.z + 1e-3;
}

/* Without the means of vibration.h and fusion_kalman.h against it the tilt is up to 170 degrees off at a sigma of
 * 0.3. */
static void test_what_is_shaken_has_a_tilt_within_three_sigma_while_it_is_valid(void **state)
{
	(void)state;
	for (size_t i = 0; i < sizeof SHAKINGS / sizeof *SHAKINGS; i++) {
		const struct shaking *c = &SHAKINGS[i];
		struct pipeline_config config = PIPELINE_DEFAULTS;
		struct rng noise;
		static struct pipeline p;
		struct pipeline_output out = {.t_us = 0};
		int told = 0, lost = 0, n = (int)((REST_S + SHAKEN_S + AFTER_S) * c->rate_hz);

		config.latency.sensor_s = config.latency.accelerometer_s = 0;
		config.fusion.use_magnetometer = 0;
		rng_init(&noise, i);
		assert_int_equal(pipeline_init(&p, &config, c->rate_hz), 0);
		for (int k = 0; k < n; k++) {
			struct imu_sample s = shaken(c, k / c->rate_hz, &noise);

			assert_int_equal(pipeline_step(&p, &s, &out), 0);
			lost += beyond_three_sigma(out.position_n_m, out.sigma.position_m);
			told += (out.status & PIPELINE_VIBRATION) != 0;
			if (!(out.status & PIPELINE_VALID))
				continue;
			if (tilt_rad(out.q_nb) > 3 * hypot(out.sigma.attitude_rad.x, out.sigma.attitude_rad.y))
				fail_msg("shaking %zu: after %.2f s off by %.2f degrees, sigma %.2f", i, k / c->rate_hz,
					DEG_PER_RAD * tilt_rad(out.q_nb), DEG_PER_RAD * out.sigma.attitude_rad.x);
		}
		if (told < SHAKEN_S * c->rate_hz / 2)
			fail_msg("shaking %zu: told for %d samples of %d", i, told, n);
		/* clipping shows; of the others some look like a motion */
		if (c->amplitude_m_s2 > c->range_g * STANDARD_GRAVITY_M_S2 && lost > 0.05 * n)
			fail_msg("shaking %zu: position beyond 3 sigma for %d samples of %d", i, lost, n);
		if (out.status & PIPELINE_VIBRATION || out.sigma.attitude_rad.x > 2 * RAD_PER_DEG)
			fail_msg("shaking %zu: not over, sigma %.2f", i, DEG_PER_RAD * out.sigma.attitude_rad.x);
	}
}

static void test_rest_and_a_slow_motion_are_no_vibration(void **state)
{
	struct vibration v = {.known = 0};
	struct rng noise;

	(void)state;
	rng_init(&noise, 1);
	for (int k = 0; k < 1000; k++) {
		struct vec3 force = {3 * sin(2 * PI * 0.01 * k) + 0.02 * rng_gauss(&noise), 0, 9.81};

		vibration_step(&v, force, (struct vec3){0, 0, 0}, false, 0.01);
	}
	assert_true(v.rms_m_s2 < 0.05 && v.force_error_m_s2 < 0.01);
	assert_false(v.lately);
}

static void test_the_rms_of_white_noise_is_its_sigma_of_all_axes_together(void **state)
{
	struct vibration v = {.known = 0};
	double sum = 0;
	struct rng noise;

	(void)state;
	rng_init(&noise, 1);
	for (int k = 0; k < 20000; k++) {
		struct vec3 force = {2 * rng_gauss(&noise), 2 * rng_gauss(&noise), 2 * rng_gauss(&noise)};

		vibration_step(&v, force, force, false, 0.01);
		sum += k >= 1000 ? v.rms_m_s2 * v.rms_m_s2 / 19000 : 0;
	}
	assert_true(fabs(sqrt(sum) - 2 * sqrt(3)) < 0.1);
}

/* One flag stands for all sensors: the values say which one is at its end. */
static void test_clipped_samples_are_counted_for_the_sensor_that_can_be_at_its_end(void **state)
{
	const struct vec3 gravity = {0, 0, 9.81}, hit = {-39.2, 0, 9.81}, slow = {0.1, 0, 0}, fast = {4.36, 0, 0};
	struct vibration v = {.known = 0};

	(void)state;
	vibration_step(&v, gravity, slow, true, 0.01); /* the magnetometer */
	assert_int_equal(v.clipped_accel + v.clipped_gyro, 0);
	vibration_step(&v, hit, slow, true, 0.01);
	assert_int_equal(v.clipped_accel, 1);
	assert_int_equal(v.clipped_gyro, 0);
	assert_true(v.lately && !v.gyro_clipped && v.force_error_m_s2 > 0);
	vibration_step(&v, gravity, fast, true, 0.01);
	assert_int_equal(v.clipped_accel, 1);
	assert_int_equal(v.clipped_gyro, 1);
	assert_true(v.gyro_clipped);
	for (int k = 0; k < 150; k++)
		vibration_step(&v, hit, fast, false, 0.01);
	assert_int_equal(v.clipped_accel + v.clipped_gyro, 2);
	assert_false(v.lately);
}

/* ---- closed forms ---- */

static const double DT_S = 0.01;

/* Up and down with each sample: the fourth difference is 16 times that, and its mean square 256 / 70. */
static void shake(struct vibration *v, double force_m_s2, double rate_rad_s, double s)
{
	for (int k = 0; k < (int)lround(s / DT_S); k++) {
		const double sign = k % 2 ? -1 : 1;

		vibration_step(v, (struct vec3){0, 0, 9.81 + sign * force_m_s2}, (struct vec3){0, sign * rate_rad_s, 0},
			false, DT_S);
	}
}

static void test_the_rms_of_a_vibration_has_a_memory_of_half_a_second(void **state)
{
	const double scale = sqrt(256. / 70);

	(void)state;
	for (double s = 0.2; s < 2; s *= 2) {
		const double reached = 1 - exp(-(s - 0.04) / 0.5); /* four samples have no difference */
		struct vibration v = {.known = 0};

		shake(&v, 3, 0.2, s);
		assert_near(v.rms_m_s2, 3 * scale * sqrt(reached), 0.02 * 3 * scale);
		assert_near(v.rms_rad_s, 0.2 * scale * sqrt(reached), 0.02 * 0.2 * scale);
	}
}

/* What lasts is the noise of the force, less the 0.5 m/s^2 of a hand, after seconds. Of the strongest that there was,
 * the share of 0.3 Hz of the rate of samples falls into the band of the tilt; that is forgotten in 2 s. */
static void test_a_vibration_that_lasts_is_noise_and_an_error_of_the_force(void **state)
{
	const double lasting = 4 * sqrt(256. / 70);
	struct vibration v = {.known = 0};
	double steady, error;

	(void)state;
	shake(&v, 4, 0, 3);
	steady = lasting * (1 - (3 * exp(-1) - 0.05 * exp(-60)) / (3 - 0.05));
	assert_near(v.force_noise_m2_s4, (steady * steady - 0.25) / 3, 0.04 * steady * steady / 3);
	error = sqrt((steady * steady - 0.25) * 0.3 * DT_S);
	assert_near(v.force_error_m_s2, error, 0.02 * error);
	shake(&v, 0, 0, 1);
	error = v.force_error_m_s2;
	assert_true(v.force_noise_m2_s4 == 0);
	shake(&v, 0, 0, 2);
	assert_near(v.force_error_m_s2 / error, exp(-1), 1e-3);
	v = (struct vibration){.known = 0};
	shake(&v, 0.4, 0, 30); /* little more than a hand */
	assert_near(v.force_noise_m2_s4, (0.16 * 256 / 70 - 0.25) / 3, 1e-3);
}

/* Half of the range may be beyond its end, in as many of the samples as were clipped in the last 2 s. */
static void test_clipped_samples_are_an_error_of_half_of_the_range(void **state)
{
	struct vibration v = {.known = 0};
	const struct vec3 hit = {0, -30, 9.81}, slow = {0, 0, 0};

	(void)state;
	for (int k = 0; k < 200; k++)
		vibration_step(&v, hit, slow, true, DT_S);
	assert_near(v.force_error_m_s2, (1 - exp(-1)) * 15, 0.05);
	for (int k = 0; k < 99; k++)
		vibration_step(&v, hit, slow, false, DT_S);
	assert_true(v.lately);
	assert_near(v.force_error_m_s2, (1 - exp(-1)) * exp(-0.5) * 15, 0.1);
	for (int k = 0; k < 2; k++)
		vibration_step(&v, hit, slow, false, DT_S);
	assert_false(v.lately); /* for a second */
}

/* The smallest ranges are 2 g and 125 deg/s, and calibration takes a tenth at most. */
static void test_no_sensor_is_at_its_end_below_nine_tenths_of_the_smallest_range(void **state)
{
	(void)state;
	for (int above = 0; above < 2; above++) {
		const double share = above ? 0.91 : 0.89;

		for (int axis = 0; axis < 3; axis++) {
			struct vibration v = {.known = 0};
			double f[3] = {0}, w[3] = {0};

			f[axis] = -share * 2 * 9.80665;
			w[axis] = -share * 125 * PI / 180;
			vibration_step(
				&v, (struct vec3){f[0], f[1], f[2]}, (struct vec3){w[0], w[1], w[2]}, true, DT_S);
			assert_int_equal(v.clipped_accel, above);
			assert_int_equal(v.clipped_gyro, above);
			assert_int_equal(v.gyro_clipped, above);
		}
	}
}

static void test_after_missing_samples_there_is_no_difference_for_four(void **state)
{
	struct vibration v = {.known = 0};
	double rms;

	(void)state;
	shake(&v, 3, 0, 1);
	rms = v.rms_m_s2;
	vibration_skip(&v);
	shake(&v, 100, 0, 4 * DT_S);
	assert_near(v.rms_m_s2, rms, 0);
	shake(&v, 100, 0, DT_S);
	assert_true(v.rms_m_s2 > 2 * rms);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_what_is_shaken_has_a_tilt_within_three_sigma_while_it_is_valid),
		cmocka_unit_test(test_rest_and_a_slow_motion_are_no_vibration),
		cmocka_unit_test(test_the_rms_of_white_noise_is_its_sigma_of_all_axes_together),
		cmocka_unit_test(test_clipped_samples_are_counted_for_the_sensor_that_can_be_at_its_end),
		cmocka_unit_test(test_the_rms_of_a_vibration_has_a_memory_of_half_a_second),
		cmocka_unit_test(test_a_vibration_that_lasts_is_noise_and_an_error_of_the_force),
		cmocka_unit_test(test_clipped_samples_are_an_error_of_half_of_the_range),
		cmocka_unit_test(test_no_sensor_is_at_its_end_below_nine_tenths_of_the_smallest_range),
		cmocka_unit_test(test_after_missing_samples_there_is_no_difference_for_four),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
