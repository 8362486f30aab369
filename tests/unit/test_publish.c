/* The objects of a sample: scaling, rounding, saturation, and the slopes of CiA 410. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>

#include "gateway/publish.h"
#include "model/math/units.h"

#define RAD(deg) ((deg)*RAD_PER_DEG)

static struct od od;
static struct od_values values;
static struct pipeline_output out;

static int set_up(void **state)
{
	(void)state;
	od_init(&od, &imu9_od_table, &values, 1);
	out = (struct pipeline_output){.q_nb = QUAT_IDENTITY, .status = PIPELINE_VALID};
	return 0;
}

static void test_acceleration_is_rounded_to_the_nearest_unit_of_2110h_1(void **state)
{
	(void)state;
	values.resolution.acceleration = 5; /* 0.005 m/s^2 */
	out.accel_b_m_s2 = (struct vec3){1.0024, -1.0026, 0.0024};
	publish_sample(&od, &out, 0);
	assert_int_equal(values.acceleration.l, 200);
	assert_int_equal(values.acceleration.s, -201);
	assert_int_equal(values.acceleration.t, 0);
}

static void test_angles_are_in_units_of_6000h(void **state)
{
	(void)state;
	values.angle_resolution = 10; /* 0.01 deg */
	out.angles_rad = (struct vec3){RAD(12.344), RAD(-45.006), RAD(180)};
	publish_sample(&od, &out, 0);
	assert_int_equal(values.angles.roll, 1234);
	assert_int_equal(values.angles.pitch, -4501);
	assert_int_equal(values.angles.yaw, 18000);
}

static void test_position_has_16_and_32_bit_objects_of_the_same_unit(void **state)
{
	(void)state;
	values.resolution.position = 10; /* 1 cm */
	out.position_n_m = (struct vec3){1.234, -400, 0};
	publish_sample(&od, &out, 0);
	assert_int_equal(values.position_output.x, 123);
	assert_int_equal(values.position_output.x32, 123);
	assert_int_equal(values.position_output.y, -32768); /* 40000 units do not fit */
	assert_int_equal(values.position_output.y32, -40000);
}

static void test_vibration_and_clipped_samples_are_objects_and_a_status_bit(void **state)
{
	(void)state;
	out.vibration_m_s2 = 2.5;
	out.clipped_accel = 7;
	out.clipped_gyro = 3;
	out.status |= PIPELINE_VIBRATION;
	publish_sample(&od, &out, 0);
	assert_true(values.sensor_state.vibration == 2.5f);
	assert_int_equal(values.sensor_state.clipped_accelerometer, 7);
	assert_int_equal(values.sensor_state.clipped_gyro, 3);
	assert_int_equal(values.sample.status, PIPELINE_VALID | 1 << 14);
}

static void test_a_value_that_does_not_fit_saturates_and_sets_its_status_bit(void **state)
{
	(void)state;
	values.resolution.acceleration = 1;
	out.accel_b_m_s2 = (struct vec3){32.7674, 32.768, -40};
	publish_sample(&od, &out, 0);
	assert_int_equal(values.acceleration.l, 32767);
	assert_int_equal(values.acceleration.s, 32767);
	assert_int_equal(values.acceleration.t, -32768);
	assert_int_equal(values.sample.status, PIPELINE_VALID | STATUS_SATURATED);
	out.accel_b_m_s2 = (struct vec3){0};
	publish_sample(&od, &out, 1);
	assert_int_equal(values.sample.status, PIPELINE_VALID);
}

static void test_counter_and_time_wrap(void **state)
{
	(void)state;
	out.t_us = (1ull << 32) + 5;
	publish_sample(&od, &out, 65535);
	assert_int_equal(values.sample.counter, 65535);
	assert_int_equal(values.sample.time, 5);
	assert_int_equal(values.high_resolution_time_stamp, 5); /* 1013h: the same */
}

static void test_a_lost_sensor_clears_the_valid_bit_and_keeps_the_values(void **state)
{
	(void)state;
	out.accel_b_m_s2.x = 1;
	publish_sample(&od, &out, 7);
	int16_t before = values.acceleration.l;
	publish_sensor_lost(&values);
	assert_int_equal(values.sample.status, STATUS_SENSOR_LOST);
	assert_int_equal(values.acceleration.l, before);
}

/* CiA 410: slope = +-physical; with scaling enabled + offset (6013h) + differential offset (6014h). */
static void test_the_long_slope_is_pitch_and_the_lateral_slope_is_roll(void **state)
{
	(void)state;
	out.angles_rad = (struct vec3){RAD(1.5), RAD(-2.25), 0};
	publish_sample(&od, &out, 0);
	assert_int_equal(values.slope_long16, -225);
	assert_int_equal(values.slope_lateral16, 150);
	assert_int_equal(values.slope_long32, -225);
	assert_int_equal(values.slope_lateral32, 150);
}

static void test_the_operating_parameter_inverts_and_scales(void **state)
{
	(void)state;
	out.angles_rad.y = RAD(10);
	values.slope_long16_offset = 30;
	values.slope_long16_differential_offset = 4;
	publish_sample(&od, &out, 0);
	assert_int_equal(values.slope_long16, 1000); /* scaling disabled: no offsets */
	values.slope_long16_operating_parameter = 2;
	publish_sample(&od, &out, 0);
	assert_int_equal(values.slope_long16, 1034);
	values.slope_long16_operating_parameter = 3;
	publish_sample(&od, &out, 0);
	assert_int_equal(values.slope_long16, -966);
}

static void test_a_slope_with_an_offset_saturates_at_the_ends_of_its_object(void **state)
{
	(void)state;
	values.slope_long16_operating_parameter = values.slope_lateral32_operating_parameter = 2;
	for (int sign = -1; sign <= 1; sign += 2) {
		out.angles_rad.y = out.angles_rad.x = RAD(sign * 10);
		values.slope_long16_offset = (int16_t)(sign > 0 ? 31767 : -31768);
		values.slope_lateral32_offset = sign > 0 ? 2147482647 : -2147482648;
		assert_int_equal(publish_sample(&od, &out, 0), 0);
		assert_int_equal(values.slope_long16, sign > 0 ? 32767 : -32768);
		assert_int_equal(values.slope_lateral32, sign > 0 ? 2147483647 : -2147483647 - 1);
		values.slope_long16_differential_offset = (int16_t)sign;
		values.slope_lateral32_differential_offset = sign;
		assert_int_equal(publish_sample(&od, &out, 0), PUBLISH_CLIPPED_LONG | PUBLISH_CLIPPED_LATERAL);
		assert_int_equal(values.slope_long16, sign > 0 ? 32767 : -32768);
		assert_int_equal(values.slope_lateral32, sign > 0 ? 2147483647 : -2147483647 - 1);
		assert_true(values.sample.status & STATUS_SATURATED);
		values.slope_long16_differential_offset = 0;
		values.slope_lateral32_differential_offset = 0;
	}
}

static void test_a_preset_makes_the_present_slope_equal_to_it(void **state)
{
	static const uint8_t operating[] = {2, 3};

	(void)state;
	for (size_t i = 0; i < sizeof(operating); i++) {
		values.slope_lateral32_operating_parameter = operating[i];
		values.slope_lateral32_differential_offset = 17;
		values.slope_lateral32_preset_value = -500;
		out.angles_rad.x = RAD(33.33);
		publish_sample(&od, &out, 0);
		publish_preset(&od, 0x6122);
		publish_sample(&od, &out, 1);
		assert_int_equal(values.slope_lateral32, -500);
	}
}

#define TEST(f) cmocka_unit_test_setup(f, set_up)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_acceleration_is_rounded_to_the_nearest_unit_of_2110h_1),
		TEST(test_angles_are_in_units_of_6000h),
		TEST(test_position_has_16_and_32_bit_objects_of_the_same_unit),
		TEST(test_vibration_and_clipped_samples_are_objects_and_a_status_bit),
		TEST(test_a_value_that_does_not_fit_saturates_and_sets_its_status_bit),
		TEST(test_counter_and_time_wrap),
		TEST(test_a_lost_sensor_clears_the_valid_bit_and_keeps_the_values),
		TEST(test_the_long_slope_is_pitch_and_the_lateral_slope_is_roll),
		TEST(test_the_operating_parameter_inverts_and_scales),
		TEST(test_a_slope_with_an_offset_saturates_at_the_ends_of_its_object),
		TEST(test_a_preset_makes_the_present_slope_equal_to_it),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
