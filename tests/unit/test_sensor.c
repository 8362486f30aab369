#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "model/sim/sensor.h"

static struct sensor_config ideal(void)
{
	return *sensor_preset("ideal");
}

static void start(struct sensor *sensor, const struct sensor_config *config)
{
	assert_int_equal(sensor_init(sensor, config, 1), 0);
}

static void assert_near(struct vec3 a, struct vec3 b, double tolerance)
{
	if (!(vec3_norm(vec3_sub(a, b)) <= tolerance))
		fail_msg("(%.12g %.12g %.12g), expected (%.12g %.12g %.12g)", a.x, a.y, a.z, b.x, b.y, b.z);
}

/* n samples of the x axis of the gyro at rest. */
static double *gyro_at_rest(const struct triad_errors *errors, double rate_hz, int n)
{
	double *x = malloc((size_t)n * sizeof *x);
	struct sensor_config config = ideal();
	struct imu_sample sample;
	struct sensor sensor;

	config.gyro = *errors;
	config.rate_hz = rate_hz;
	start(&sensor, &config);
	for (int i = 0; i < n; i++) {
		sensor_next(&sensor, signal_find("rest"), &sample, NULL);
		x[i] = sample.gyro_rad_s.x;
	}
	return x;
}

/* Allan deviation over m samples, without overlap. */
static double allan(const double *x, int n, int m)
{
	double sum = 0, last = 0;
	int clusters = n / m;

	for (int k = 0; k < clusters; k++) {
		double mean = 0;

		for (int i = 0; i < m; i++)
			mean += x[k * m + i] / m;
		if (k > 0)
			sum += (mean - last) * (mean - last);
		last = mean;
	}
	return sqrt(sum / (2 * (clusters - 1)));
}

static void assert_within(double value, double expected, double share)
{
	if (!(fabs(value - expected) <= share * fabs(expected)))
		fail_msg("%g, expected %g within %g %%", value, expected, 100 * share);
}

static void test_at_rest_the_ideal_sensor_measures_g_upwards_no_rate_and_the_field(void **state)
{
	struct sensor_config config = ideal();
	struct imu_sample sample;
	struct sensor sensor;

	(void)state;
	start(&sensor, &config);
	sensor_next(&sensor, signal_find("rest"), &sample, NULL);
	assert_near(sample.accel_m_s2, (struct vec3){0, 0, 9.81}, 0);
	assert_near(sample.gyro_rad_s, (struct vec3){0, 0, 0}, 0);
	assert_near(sample.mag_uT, (struct vec3){0, 20, -45}, 0);
	assert_int_equal(sample.t_us, 0);
	assert_int_equal(sample.flags, SAMPLE_MAG);
}

/* The oracle is the position of the accelerometer, p + R r, differentiated twice. */
static void test_the_specific_force_is_the_second_derivative_of_the_path_of_the_accelerometer(void **state)
{
	const struct vec3 r = {0.03, -0.05, 0.11}, g = {0, 0, 9.81};
	const double h = 1e-3, weight[4] = {-490, 270, -27, 2}; /* seven-point formula, to be divided by 180 h^2 */

	(void)state;
	for (const struct signal *signal = SIGNALS; signal->name; signal++) {
		for (double t = 0.02; t < 40; t += 0.35) {
			struct vec3 a = {0, 0, 0};
			struct signal_truth truth;

			for (int k = -3; k <= 3; k++) {
				signal_at(signal, t + k * h, &truth);
				a = vec3_add(a, vec3_scale(weight[abs(k)] / (180 * h * h),
							vec3_add(truth.position_n_m, quat_rotate(truth.q_nb, r))));
			}
			signal_at(signal, t, &truth);
			a = quat_rotate_inverse(truth.q_nb, vec3_add(a, g));
			assert_near(sensor_specific_force(&truth, r, 9.81), a, 1e-5);
		}
	}
}

static void test_the_variance_of_white_noise_is_density_squared_times_half_the_sampling_rate(void **state)
{
	const struct triad_errors errors = {.density = 0.01};
	double *x = gyro_at_rest(&errors, 200, 200000), sum = 0;

	(void)state;
	for (int i = 0; i < 200000; i++)
		sum += x[i] * x[i];
	assert_within(sqrt(sum / 200000), 0.01 * sqrt(100), 0.01);
	free(x);
}

static void test_the_allan_deviation_of_white_noise_falls_with_the_root_of_time(void **state)
{
	const struct triad_errors errors = {.density = 0.01};
	double *x = gyro_at_rest(&errors, 100, 500000);

	(void)state;
	assert_within(allan(x, 500000, 10), 0.01 / sqrt(2 * 0.1), 0.02);
	assert_within(allan(x, 500000, 1000), 0.01 / sqrt(2 * 10.0), 0.1);
	free(x);
}

/* Flicker noise of bias instability B: flat at B sqrt(2 ln 2 / pi) between the shortest and the longest time
 * constant. */
static void test_the_allan_deviation_of_bias_instability_is_flat(void **state)
{
	const struct triad_errors errors = {.bias_instability = 0.5};
	double *x = gyro_at_rest(&errors, 2, 1000000);

	(void)state;
	for (int m = 10; m <= 2000; m *= 3)
		assert_within(allan(x, 1000000, m), 0.664 * 0.5, 0.12);
	free(x);
}

static void test_the_allan_deviation_of_a_random_walk_rises_with_the_root_of_time(void **state)
{
	const struct triad_errors errors = {.random_walk = 0.1};
	double *x = gyro_at_rest(&errors, 10, 1000000);

	(void)state;
	assert_within(allan(x, 1000000, 100), 0.1 * sqrt(10 / 3.0), 0.05);
	assert_within(allan(x, 1000000, 1000), 0.1 * sqrt(100 / 3.0), 0.15);
	free(x);
}

static void test_values_are_multiples_of_the_step_and_saturate_at_the_range(void **state)
{
	const struct triad_errors errors = {.density = 0.1, .step = 0.25, .range = 1};
	double *x = gyro_at_rest(&errors, 100, 10000);
	int at_range = 0;

	(void)state;
	for (int i = 0; i < 10000; i++) {
		assert_true(fmod(x[i], 0.25) == 0);
		assert_true(fabs(x[i]) <= 1);
		at_range += fabs(x[i]) == 1;
	}
	assert_true(at_range > 100);
	free(x);
}

static void test_constant_errors_are_those_in_the_struct(void **state)
{
	struct sensor_config config = ideal();
	struct signal_truth truth;
	struct imu_sample sample;
	struct sensor sensor;
	struct vec3 w, expected;

	(void)state;
	config.gyro = (struct triad_errors){.bias_sigma = 1, .scale_sigma = 0.1, .cross_axis_sigma = 0.1};
	start(&sensor, &config);
	for (int i = 0; i < 50; i++)
		sensor_next(&sensor, signal_find("tumble"), &sample, &truth);
	w = truth.omega_b_rad_s;
	expected.x = vec3_dot(
		(struct vec3){sensor.gyro.matrix[0][0], sensor.gyro.matrix[0][1], sensor.gyro.matrix[0][2]}, w);
	expected.y = vec3_dot(
		(struct vec3){sensor.gyro.matrix[1][0], sensor.gyro.matrix[1][1], sensor.gyro.matrix[1][2]}, w);
	expected.z = vec3_dot(
		(struct vec3){sensor.gyro.matrix[2][0], sensor.gyro.matrix[2][1], sensor.gyro.matrix[2][2]}, w);
	assert_near(sample.gyro_rad_s, vec3_add(expected, sensor.gyro.bias), 1e-12);
	assert_true(vec3_norm(sensor.gyro.bias) > 0.1);
}

static void test_constant_errors_of_many_seeds_have_their_sigma(void **state)
{
	struct sensor_config config = ideal();
	double squares = 0;
	struct sensor sensor;

	(void)state;
	config.accel.bias_sigma = 0.6;
	for (uint64_t seed = 0; seed < 2000; seed++) {
		assert_int_equal(sensor_init(&sensor, &config, seed), 0);
		squares += vec3_dot(sensor.accel.bias, sensor.accel.bias);
	}
	assert_within(sqrt(squares / 6000), 0.6, 0.03);
}

static void test_calibration_removes_the_constant_errors_and_keeps_the_noise(void **state)
{
	struct sensor_config config = *sensor_preset("lsm303dlhc_l3gd20");
	struct sensor sensor;

	(void)state;
	sensor_calibrate(&config);
	start(&sensor, &config);
	assert_near(sensor.gyro.bias, (struct vec3){0, 0, 0}, 0);
	assert_true(sensor.accel.matrix[0][0] == 1 && sensor.accel.matrix[0][1] == 0);
	assert_true(config.gyro.density > 0 && config.accel.density > 0 && config.mag.density > 0);
}

/* Amplitude of a sine through a first-order low-pass: 1 / sqrt(1 + (f / f_c)^2). */
static void test_a_sine_at_the_bandwidth_is_attenuated_by_3_db(void **state)
{
	struct sensor_config config = ideal();
	struct signal pendulum = *signal_find("pendulum");
	double in = 0, out = 0;
	struct imu_sample sample;
	struct signal_truth truth;
	struct sensor sensor;

	(void)state;
	pendulum.change_s = 0.1;
	config.rate_hz = 1000;
	config.gyro.bandwidth_hz = 10;
	start(&sensor, &config);
	for (int i = 0; i < 3000; i++) {
		sensor_next(&sensor, &pendulum, &sample, &truth);
		if (i >= 1000) {
			in += truth.omega_b_rad_s.x * truth.omega_b_rad_s.x;
			out += sample.gyro_rad_s.x * sample.gyro_rad_s.x;
		}
	}
	assert_within(sqrt(out / in), 1 / sqrt(2), 0.005);
}

/* The angle of a turntable is proportional to time, so jitter appears as an error of the measured heading. */
static void test_jitter_changes_the_sampling_instant_but_not_the_time_stamp(void **state)
{
	struct sensor_config config = ideal();
	struct signal turntable = *signal_find("turntable");
	double squares = 0;
	struct signal_truth truth;
	struct imu_sample sample;
	struct sensor sensor;

	(void)state;
	turntable.angle_rad = 1;
	turntable.change_s = 1;
	config.jitter_s = 1e-3;
	start(&sensor, &config);
	for (int i = 0; i < 20000; i++) {
		sensor_next(&sensor, &turntable, &sample, &truth);
		assert_int_equal(sample.t_us, (uint64_t)i * 10000);
		squares += pow(truth.angles_rad.z - i * 0.01, 2);
	}
	assert_within(sqrt(squares / 20000), 1e-3, 0.03);
}

static void test_the_magnetometer_measures_at_its_own_rate(void **state)
{
	struct sensor_config config = ideal();
	struct imu_sample sample;
	struct sensor sensor;
	int measured = 0;

	(void)state;
	config.mag_rate_hz = 75;
	start(&sensor, &config);
	for (int i = 0; i < 1000; i++) {
		sensor_next(&sensor, signal_find("rest"), &sample, NULL);
		measured += (sample.flags & SAMPLE_MAG) != 0;
	}
	assert_int_equal(measured, 750);
}

static void test_an_additional_error_does_not_change_the_noise_of_other_triads(void **state)
{
	struct sensor_config config = *sensor_preset("lsm303dlhc_l3gd20");
	struct imu_sample a, b;
	struct sensor sensor;

	(void)state;
	start(&sensor, &config);
	sensor_next(&sensor, signal_find("rest"), &a, NULL);
	config.gyro.random_walk = 0;
	config.jitter_s = 1e-4;
	start(&sensor, &config);
	sensor_next(&sensor, signal_find("rest"), &b, NULL);
	assert_near(a.accel_m_s2, b.accel_m_s2, 0);
	assert_near(a.mag_uT, b.mag_uT, 0);
}

static uint64_t mix(uint64_t hash, double x)
{
	uint64_t bits;

	memcpy(&bits, &x, sizeof bits);
	return (hash ^ bits) * 0x9e3779b97f4a7c15u + (hash >> 29);
}

static uint64_t hash_of(uint64_t seed)
{
	struct sensor_config config = *sensor_preset("lsm303dlhc_l3gd20");
	struct imu_sample s;
	struct sensor sensor;
	uint64_t hash = 0;

	assert_int_equal(sensor_init(&sensor, &config, seed), 0);
	for (int i = 0; i < 1000; i++) {
		sensor_next(&sensor, signal_find("square"), &s, NULL);
		hash = mix(mix(mix(hash, s.gyro_rad_s.x), s.gyro_rad_s.y), s.gyro_rad_s.z);
		hash = mix(mix(mix(hash, s.accel_m_s2.x), s.accel_m_s2.y), s.accel_m_s2.z);
		hash = mix(mix(mix(hash, s.mag_uT.x), s.mag_uT.y), s.mag_uT.z);
	}
	return hash;
}

static void test_the_bias_of_a_sensor_that_warms_up_follows_its_temperature(void **state)
{
	struct sensor_config config = ideal();
	struct sensor sensor;
	struct imu_sample s;

	(void)state;
	config.gyro.temperature_sigma = 0.01;
	config.warming_K = 10;
	config.warming_s = 1;
	config.temperature_step_K = 0;
	start(&sensor, &config);
	for (int i = 0; i < 100; i++)
		sensor_next(&sensor, signal_find("rest"), &s, NULL);
	assert_true(s.flags & SAMPLE_TEMPERATURE);
	double warmer_K = 10 * (1 - exp(-0.99));
	assert_true(fabs(s.temperature_degC - 25 - warmer_K) < 1e-9);
	assert_near(s.gyro_rad_s, vec3_scale(warmer_K, sensor.gyro.slope), 1e-12);
}

static void test_one_seed_gives_one_sequence_another_seed_another(void **state)
{
	(void)state;
	assert_true(hash_of(1) == hash_of(1));
	assert_true(hash_of(1) != hash_of(2));
}

static void test_an_invalid_configuration_is_refused(void **state)
{
	struct sensor_config config = ideal();
	struct sensor sensor;

	(void)state;
	config.rate_hz = 0;
	assert_int_equal(sensor_init(&sensor, &config, 1), -EINVAL);
	config = ideal();
	config.accel.density = -1;
	assert_int_equal(sensor_init(&sensor, &config, 1), -EINVAL);
	config = ideal();
	config.mag.range = NAN;
	assert_int_equal(sensor_init(&sensor, &config, 1), -EINVAL);
	config = ideal();
	config.jitter_s = 0.002;
	assert_int_equal(sensor_init(&sensor, &config, 1), -EINVAL);
}

/* Sensitivities and ranges of the datasheets: mdps/digit and deg/s, mg/digit and g, digits/gauss and gauss. */
static void test_the_presets_have_the_digits_and_ranges_of_their_chips(void **state)
{
	static const struct {
		const char *name;
		double mdps, dps, mg, g, digits_per_gauss, mag_density_uT;
	} chips[] = {
		{"lsm303dlhc_l3gd20", 70, 2000, 4, 8, 1100, 0.02},
		{"lsm303dlhc_l3gd20_fine", 8.75, 250, 1, 2, 1100, 0.02},
		{"lsm303dlh_l3g4200d", 70, 2000, 3.9, 8, 1055, 0.1},
	};

	(void)state;
	for (size_t i = 0; i < sizeof chips / sizeof *chips; i++) {
		const struct sensor_config *c = sensor_preset(chips[i].name);

		assert_within(c->gyro.step, chips[i].mdps * 1e-3 * 3.14159265358979 / 180, 1e-9);
		assert_within(c->gyro.range, chips[i].dps * 3.14159265358979 / 180, 1e-9);
		assert_within(c->accel.step, chips[i].mg * 9.80665e-3, 1e-9);
		assert_within(c->accel.range, chips[i].g * 9.80665, 1e-9);
		assert_within(c->mag.step, 100 / chips[i].digits_per_gauss, 1e-9);
		assert_within(c->mag.range, 130, 1e-9);
		assert_within(c->mag.density, chips[i].mag_density_uT, 1e-9);
		assert_within(c->gyro.density, 0.03 * 3.14159265358979 / 180, 1e-9); /* 0.03 dps/sqrt(Hz) */
		assert_within(c->accel.density, i < 2 ? 220e-6 * 9.80665 : 218e-6 * 9.80665, 1e-9);
		assert_within(c->accel.bias_sigma, (i < 2 ? 60e-3 : 20e-3) * 9.80665, 1e-9); /* zero-g level */
		assert_within(c->gyro.bias_sigma, 10 * 3.14159265358979 / 180, 1e-9);	     /* zero-rate level */
		assert_within(c->rate_hz, 100, 0);
		assert_within(c->mag_rate_hz, 75, 0);
	}
	assert_null(sensor_preset("lsm303"));
}

/* One-sided spectrum of the sum of the Gauss-Markov processes x <- decay x + drive w, against B^2 / (pi f). Its mean
 * over one ratio of the time constants, 8, has no ripple. */
static void test_flicker_noise_has_its_spectrum(void **state)
{
	const double dt_s = 1 / 100.0, pi = 3.14159265358979, lowest_hz = 8e-4;
	struct sensor_config config = ideal();
	struct sensor sensor;
	double mean = 0;

	(void)state;
	config.gyro.bias_instability = 0.5;
	start(&sensor, &config);
	for (int i = 0; i < 30; i++) {
		double f = lowest_hz * pow(8, (i + 0.5) / 30), w = 2 * pi * f * dt_s;

		for (int k = 0; k < SENSOR_FLICKER_POLES; k++) {
			double a = sensor.gyro.flicker_decay[k], drive = sensor.gyro.flicker_drive[k];

			mean += 2 * dt_s * drive * drive / (1 - 2 * a * cos(w) + a * a) * f / 30;
		}
	}
	assert_within(mean, 0.25 / pi, 0.03);
}

static void test_scale_and_cross_axis_errors_of_many_seeds_have_their_sigma(void **state)
{
	struct sensor_config config = ideal();
	double scale = 0, cross = 0, slope = 0;
	struct sensor sensor;

	(void)state;
	config.gyro = (struct triad_errors){.scale_sigma = 0.02, .cross_axis_sigma = 0.01, .temperature_sigma = 0.3};
	for (uint64_t seed = 0; seed < 2000; seed++) {
		assert_int_equal(sensor_init(&sensor, &config, seed), 0);
		for (int i = 0; i < 3; i++)
			for (int j = 0; j < 3; j++)
				*(i == j ? &scale : &cross) += pow(sensor.gyro.matrix[i][j] - (i == j), 2);
		slope += vec3_dot(sensor.gyro.slope, sensor.gyro.slope);
	}
	assert_within(sqrt(scale / 6000), 0.02, 0.03);
	assert_within(sqrt(cross / 12000), 0.01, 0.03);
	assert_within(sqrt(slope / 6000), 0.3, 0.03);
}

/* The response of a first-order low-pass to a ramp lags by its time constant. */
static void test_the_bandwidth_delays_a_ramp_by_its_time_constant(void **state)
{
	const double tau_s = 1 / (2 * 3.14159265358979 * 5);
	struct sensor_config config = ideal();
	struct signal_truth truth = {.q_nb = {1, 0, 0, 0}};
	struct imu_sample sample;
	struct sensor sensor;

	(void)state;
	config.gyro.bandwidth_hz = 5;
	start(&sensor, &config);
	for (int i = 0; i <= 100; i++) {
		double t = i * 0.01, lag = tau_s * (1 - exp(-t / tau_s));

		truth.omega_b_rad_s = (struct vec3){t, 2 * t, -t};
		sensor_measure(&sensor, &truth, &sample);
		assert_near(sample.gyro_rad_s, (struct vec3){t - lag, 2 * (t - lag), -(t - lag)}, 1e-12);
	}
}

static void test_every_field_out_of_its_range_is_refused(void **state)
{
	struct sensor_config config[12];
	struct sensor sensor;

	(void)state;
	for (int i = 0; i < 12; i++)
		config[i] = ideal();
	config[0].jitter_s = -1e-9;
	config[1].mag_rate_hz = -1;
	config[2].gyro.bias_instability = -1;
	config[3].gyro.random_walk = -1;
	config[4].gyro.bias_sigma = -1;
	config[5].gyro.scale_sigma = -1;
	config[6].gyro.cross_axis_sigma = -1;
	config[7].gyro.bandwidth_hz = -1;
	config[8].gyro.temperature_sigma = -1;
	config[9].temperature_step_K = -1;
	config[10].warming_K = INFINITY;
	config[11].rate_hz = INFINITY;
	for (int i = 0; i < 12; i++)
		assert_int_equal(sensor_init(&sensor, &config[i], 1), -EINVAL);
	config[0] = ideal();
	config[0].jitter_s = 0.1 / config[0].rate_hz;
	assert_int_equal(sensor_init(&sensor, &config[0], 1), 0);
	config[0].warming_K = 10;
	config[0].warming_s = 0;
	assert_int_equal(sensor_init(&sensor, &config[0], 1), -EINVAL);
}

static void test_a_thermometer_begins_at_25_degrees_in_digits_of_one(void **state)
{
	struct sensor_config config = *sensor_preset("lsm303dlhc_l3gd20");
	struct imu_sample s;
	struct sensor sensor;
	int last = 25;

	(void)state;
	config.warming_K = 10;
	start(&sensor, &config);
	for (int i = 0; i < 12000; i++) { /* its time constant */
		sensor_next(&sensor, signal_find("rest"), &s, NULL);
		assert_true(s.temperature_degC == last || s.temperature_degC == last + 1);
		last = (int)s.temperature_degC;
	}
	assert_int_equal(last, 31); /* 25 + 6.3 */
}

static void test_calibration_removes_every_constant_error_of_every_triad(void **state)
{
	const struct triad_errors all = {
		.bias_sigma = 1, .scale_sigma = 1, .cross_axis_sigma = 1, .temperature_sigma = 1, .bandwidth_hz = 7};
	struct sensor_config config = ideal();
	struct sensor sensor;

	(void)state;
	config.gyro = config.accel = config.mag = all;
	sensor_calibrate(&config);
	start(&sensor, &config);
	const struct triad *triads[3] = {&sensor.gyro, &sensor.accel, &sensor.mag};
	for (int i = 0; i < 3; i++) {
		assert_near(triads[i]->bias, (struct vec3){0, 0, 0}, 0);
		assert_near(triads[i]->slope, (struct vec3){0, 0, 0}, 0);
		for (int j = 0; j < 9; j++)
			assert_true(triads[i]->matrix[j / 3][j % 3] == (j % 4 == 0));
		assert_true(triads[i]->errors.bandwidth_hz == 7);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_at_rest_the_ideal_sensor_measures_g_upwards_no_rate_and_the_field),
		cmocka_unit_test(test_the_specific_force_is_the_second_derivative_of_the_path_of_the_accelerometer),
		cmocka_unit_test(test_the_variance_of_white_noise_is_density_squared_times_half_the_sampling_rate),
		cmocka_unit_test(test_the_allan_deviation_of_white_noise_falls_with_the_root_of_time),
		cmocka_unit_test(test_the_allan_deviation_of_bias_instability_is_flat),
		cmocka_unit_test(test_the_allan_deviation_of_a_random_walk_rises_with_the_root_of_time),
		cmocka_unit_test(test_values_are_multiples_of_the_step_and_saturate_at_the_range),
		cmocka_unit_test(test_constant_errors_are_those_in_the_struct),
		cmocka_unit_test(test_constant_errors_of_many_seeds_have_their_sigma),
		cmocka_unit_test(test_calibration_removes_the_constant_errors_and_keeps_the_noise),
		cmocka_unit_test(test_a_sine_at_the_bandwidth_is_attenuated_by_3_db),
		cmocka_unit_test(test_jitter_changes_the_sampling_instant_but_not_the_time_stamp),
		cmocka_unit_test(test_the_magnetometer_measures_at_its_own_rate),
		cmocka_unit_test(test_an_additional_error_does_not_change_the_noise_of_other_triads),
		cmocka_unit_test(test_the_bias_of_a_sensor_that_warms_up_follows_its_temperature),
		cmocka_unit_test(test_one_seed_gives_one_sequence_another_seed_another),
		cmocka_unit_test(test_an_invalid_configuration_is_refused),
		cmocka_unit_test(test_the_presets_have_the_digits_and_ranges_of_their_chips),
		cmocka_unit_test(test_flicker_noise_has_its_spectrum),
		cmocka_unit_test(test_scale_and_cross_axis_errors_of_many_seeds_have_their_sigma),
		cmocka_unit_test(test_the_bandwidth_delays_a_ramp_by_its_time_constant),
		cmocka_unit_test(test_every_field_out_of_its_range_is_refused),
		cmocka_unit_test(test_a_thermometer_begins_at_25_degrees_in_digits_of_one),
		cmocka_unit_test(test_calibration_removes_every_constant_error_of_every_triad),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
