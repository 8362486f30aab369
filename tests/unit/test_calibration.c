/* Calibration: bias, scale and cross-axis terms, then the mounting. */
#include "model_test.h"

#include "model/calibration.h"

#define IDENTITY_TRIAD                                        \
	{                                                     \
		.matrix = { {1, 0, 0}, {0, 1, 0}, {0, 0, 1} } \
	}

static const struct calibration_config IDEAL = {.gyro = IDENTITY_TRIAD, .accel = IDENTITY_TRIAD, .mag = IDENTITY_TRIAD};

static const struct imu_sample RAW = {
	.t_us = 123456789,
	.gyro_rad_s = {0.1, 0.2, 0.3},
	.accel_m_s2 = {1, 2, 9},
	.mag_uT = {10, 20, -40},
	.flags = SAMPLE_MAG | SAMPLE_DISCONTINUITY,
};

static struct imu_sample apply(const struct calibration_config *config, struct imu_sample raw)
{
	struct calibration cal;

	assert_int_equal(calibration_init(&cal, config), 0);
	return calibration_apply(&cal, &raw);
}

static void test_the_identity_calibration_changes_nothing(void **state)
{
	struct imu_sample s = apply(&IDEAL, RAW);

	(void)state;
	assert_vec_near(s.gyro_rad_s, RAW.gyro_rad_s, 0);
	assert_vec_near(s.accel_m_s2, RAW.accel_m_s2, 0);
	assert_vec_near(s.mag_uT, RAW.mag_uT, 0);
	assert_true(s.t_us == RAW.t_us && s.flags == RAW.flags);
}

static void test_the_bias_is_subtracted_before_the_matrix_is_applied(void **state)
{
	struct calibration_config config = IDEAL;

	(void)state;
	config.accel = (struct triad_calibration){.bias = {1, 1, 1}, .matrix = {{2, 0, 0}, {0.1, 1, 0}, {0, 0, 0.5}}};
	assert_vec_near(apply(&config, RAW).accel_m_s2, ((struct vec3){0, 1, 4}), 1e-15);
}

static void test_each_triad_has_its_own_calibration(void **state)
{
	struct calibration_config config = IDEAL;
	struct imu_sample s;

	(void)state;
	config.gyro.bias.x = 0.1;
	config.accel.bias.y = 2;
	config.mag.bias.z = -40;
	s = apply(&config, RAW);
	assert_vec_near(s.gyro_rad_s, ((struct vec3){0, 0.2, 0.3}), 1e-15);
	assert_vec_near(s.accel_m_s2, ((struct vec3){1, 0, 9}), 1e-15);
	assert_vec_near(s.mag_uT, ((struct vec3){10, 20, 0}), 1e-15);
}

static void test_a_sensor_mounted_a_quarter_turn_about_z_has_its_x_axis_along_the_objects_y(void **state)
{
	struct calibration_config config = IDEAL;
	struct imu_sample s;

	(void)state;
	config.mounting_rad.z = PI / 2;
	s = apply(&config, RAW);
	assert_vec_near(s.gyro_rad_s, ((struct vec3){-0.2, 0.1, 0.3}), 1e-15);
	assert_vec_near(s.accel_m_s2, ((struct vec3){-2, 1, 9}), 1e-15);
	assert_vec_near(s.mag_uT, ((struct vec3){-20, 10, -40}), 1e-14);
}

static void test_the_mounting_is_applied_after_the_matrix(void **state)
{
	struct calibration_config config = IDEAL;

	(void)state;
	config.mounting_rad.z = PI / 2;
	config.accel.matrix[0][0] = 3;
	assert_vec_near(apply(&config, RAW).accel_m_s2, ((struct vec3){-2, 3, 9}), 1e-14);
}

static void test_a_missing_magnetometer_sample_is_not_changed(void **state)
{
	struct calibration_config config = IDEAL;
	struct imu_sample raw = RAW;

	(void)state;
	config.mag.bias.x = 5;
	raw.flags = 0;
	assert_vec_near(apply(&config, raw).mag_uT, RAW.mag_uT, 0);
}

static void test_a_singular_or_non_finite_calibration_is_refused(void **state)
{
	struct calibration_config config = IDEAL;
	struct calibration cal;

	(void)state;
	config.gyro.matrix[2][2] = 0;
	assert_int_equal(calibration_init(&cal, &config), -EINVAL);
	config = IDEAL;
	config.accel.matrix[0][1] = NAN;
	assert_int_equal(calibration_init(&cal, &config), -EINVAL);
	config = IDEAL;
	config.mag.matrix[1][0] = INFINITY;
	assert_int_equal(calibration_init(&cal, &config), -EINVAL);
	config = IDEAL;
	config.mag.bias.y = INFINITY;
	assert_int_equal(calibration_init(&cal, &config), -EINVAL);
	config = IDEAL;
	config.mounting_rad.x = NAN;
	assert_int_equal(calibration_init(&cal, &config), -EINVAL);
}

/* ---- temperature ------------------------------------------------------------------------------------------------- */

static const struct temperature_compensation WARM = {
	.gyro_slope = {0.01, 0, 0},
	.gyro_quadratic = {0.001, 0, 0},
	.accel_slope = {0, 0.2, 0},
	.reference_degC = 25,
};

static void test_biases_follow_the_temperature_by_slope_and_parabola(void **state)
{
	struct calibration_config config = IDEAL;
	struct calibration cal;
	struct imu_sample s;

	(void)state;
	config.temperature = WARM;
	assert_int_equal(calibration_init(&cal, &config), 0);
	calibration_temperature(&cal, 35);
	s = calibration_apply(&cal, &RAW);
	assert_vec_near(s.gyro_rad_s, ((struct vec3){0.1 - 0.1 - 0.1, 0.2, 0.3}), 1e-15);
	assert_vec_near(s.accel_m_s2, ((struct vec3){1, 2 - 2, 9}), 1e-15);
	assert_vec_near(s.mag_uT, RAW.mag_uT, 0);
}

static void test_without_a_temperature_or_with_an_impossible_one_nothing_is_compensated(void **state)
{
	const double impossible[] = {NAN, INFINITY, -300, 1e9};
	struct calibration_config config = IDEAL;
	struct calibration cal;

	(void)state;
	config.temperature = WARM;
	assert_int_equal(calibration_init(&cal, &config), 0);
	assert_vec_near(calibration_apply(&cal, &RAW).gyro_rad_s, RAW.gyro_rad_s, 0);
	for (int i = 0; i < 4; i++)
		calibration_temperature(&cal, impossible[i]);
	assert_vec_near(calibration_apply(&cal, &RAW).gyro_rad_s, RAW.gyro_rad_s, 0);
}

static void test_a_new_configuration_keeps_the_temperature(void **state)
{
	struct calibration_config config = IDEAL;
	struct calibration cal;

	(void)state;
	assert_int_equal(calibration_init(&cal, &config), 0);
	calibration_temperature(&cal, 35);
	config.temperature = WARM;
	assert_int_equal(calibration_configure(&cal, &config), 0);
	assert_near(calibration_apply(&cal, &RAW).accel_m_s2.y, 0, 1e-15);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_identity_calibration_changes_nothing),
		cmocka_unit_test(test_the_bias_is_subtracted_before_the_matrix_is_applied),
		cmocka_unit_test(test_each_triad_has_its_own_calibration),
		cmocka_unit_test(test_a_sensor_mounted_a_quarter_turn_about_z_has_its_x_axis_along_the_objects_y),
		cmocka_unit_test(test_the_mounting_is_applied_after_the_matrix),
		cmocka_unit_test(test_a_missing_magnetometer_sample_is_not_changed),
		cmocka_unit_test(test_a_singular_or_non_finite_calibration_is_refused),
		cmocka_unit_test(test_biases_follow_the_temperature_by_slope_and_parabola),
		cmocka_unit_test(test_without_a_temperature_or_with_an_impossible_one_nothing_is_compensated),
		cmocka_unit_test(test_a_new_configuration_keeps_the_temperature),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
