/* Parsing of IIO attributes and merging of readings. test_imu_iio.c tests the driver; tests/rig/test_sensors.py runs it
 * on the kernel's IIO drivers. */
#include <errno.h>
#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <setjmp.h>
/* cmocka wants the above first */
#include <cmocka.h>

#include "drivers/imu/iio_text.h"
#include "drivers/imu/merge.h"

#define MS 1000000LL

static void assert_near(double value, double wanted)
{
	if (!(fabs(value - wanted) <= 1e-9))
		fail_msg("%.9g, expected %.9g", value, wanted);
}

/* ---- mount_matrix ------------------------------------------------------------------------------------------------ */

static void test_a_mount_matrix_is_read_row_by_row(void **state)
{
	struct vec3 rows[3];

	(void)state;
	assert_int_equal(iio_parse_mount_matrix("0, 1, 0; -1, 0, 0; 0, 0, 1", rows), 0);
	assert_near(rows[0].y, 1);
	assert_near(rows[1].x, -1);
	assert_near(rows[2].z, 1);
	assert_int_equal(iio_parse_mount_matrix("0.8, -0.6, 0.0; 0.6, 0.8, 0.0; 0.0, 0.0, 1.0\n", rows), 0);
	assert_near(rows[0].y, -0.6);
}

static void test_a_mount_matrix_that_is_not_a_rotation_is_refused(void **state)
{
	static const char *const wrong[] = {"", "1, 0, 0; 0, 1, 0; 0, 0", "1, 0, 0; 0, 1, 0; 0, 0, 1; 2",
		"1, 0, 0; 0, 1, 0; 0, 0, -2", "2, 0, 0; 0, 2, 0; 0, 0, 2", "0, 0, 0; 0, 0, 0; 0, 0, 0",
		"nan, 0, 0; 0, 1, 0; 0, 0, 1", "x"};
	struct vec3 rows[3] = {{7, 7, 7}};

	(void)state;
	for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
		assert_int_equal(iio_parse_mount_matrix(wrong[i], rows), -EINVAL);
		assert_near(rows[0].x, 7);
	}
}

static void test_a_mount_matrix_that_mirrors_is_told_apart(void **state)
{
	struct vec3 rows[3];

	(void)state;
	assert_int_equal(iio_parse_mount_matrix("1, 0, 0; 0, 1, 0; 0, 0, -1", rows), 1);
	assert_near(rows[2].z, -1);
	assert_int_equal(iio_parse_mount_matrix("0, 1, 0; 1, 0, 0; 0, 0, 1", rows), 1);
	assert_int_equal(iio_parse_mount_matrix("0, 1, 0; 1, 0, 0; 0, 0, -1", rows), 0);
}

/* ---- *_available ------------------------------------------------------------------------------------------------- */

static void assert_chosen(const char *available, double wanted, int result, const char *token)
{
	char chosen[32] = "";

	assert_int_equal(iio_choose(available, wanted, chosen, sizeof chosen), result);
	assert_string_equal(chosen, token);
}

static void test_the_smallest_value_that_is_enough_is_chosen_with_its_text(void **state)
{
	(void)state;
	assert_chosen("1 10 25 50 100 200 400 1600", 100, 0, "100");
	assert_chosen("1 10 25 50 100 200 400 1600\n", 101, 0, "200");
	assert_chosen("0.000153 0.000305 0.001222", 0.0011, 0, "0.001222");
	assert_chosen("800 400.500000 100", 300, 0, "400.500000");
}

static void test_if_no_value_is_enough_the_largest_is_returned(void **state)
{
	(void)state;
	assert_chosen("1 10 75", 100, -ERANGE, "75");
	assert_chosen("", 100, -EINVAL, "");
	assert_chosen("10 fast 1000", 100, -EINVAL, "");
}

static void test_a_range_with_steps_is_parsed(void **state)
{
	(void)state;
	assert_chosen("[5 5 1000]", 12, 0, "15");
	assert_chosen("[5 5 1000]", 1, 0, "5");
	assert_chosen("[5 5 1000]", 15, 0, "15");
	assert_chosen("[5 5 1000]", 1001, -ERANGE, "1000");
	assert_chosen("[5 0 1000]", 12, -EINVAL, "");
	assert_chosen("[5", 12, -EINVAL, "");
}

/* ---- merging ----------------------------------------------------------------------------------------------------- */

static void add(struct merge *m, enum imu_chip chip, int64_t t_ns, double x)
{
	merge_add(m, chip, &(struct merge_reading){.t_ns = t_ns, .value = {x, 0, 0}});
}

/* A chord over a hole in the accelerometer's readings is no measurement. At 10 a second 0.2 s are only a reading that
 * is missing; at 100 a second they are 20. */
static void test_over_a_hole_in_the_accelerations_there_is_no_sample(void **state)
{
	static const struct {
		int64_t every_ms, hole_ms;
		uint32_t lost;
	} holes[] = {{10, 100, 0}, {10, 110, 10}, {10, 500, 49}, {100, 300, 0}, {100, 330, 32}};

	(void)state;
	for (int i = 0; i < 5; i++) {
		const int64_t every = holes[i].every_ms * MS, hole = 50 * every, end = hole + holes[i].hole_ms * MS;
		struct imu_sample sample;
		int64_t accel = 0;
		struct merge m;

		merge_init(&m, 0);
		for (int64_t t = 0; t < end + 20 * every; t += 10 * MS) {
			for (; accel <= t; accel = accel == hole ? end : accel + every)
				add(&m, IMU_CHIP_ACCEL, accel, 1e-9 * (double)accel);
			add(&m, IMU_CHIP_GYRO, t, 0);
			while (merge_next(&m, &sample))
				assert_near(sample.accel_m_s2.x, 1e-6 * (double)sample.t_us);
		}
		if (m.lost != holes[i].lost)
			fail_msg("%d: %u lost", i, m.lost);
	}
}

static void test_the_acceleration_is_interpolated_to_the_time_of_the_gyro(void **state)
{
	struct imu_sample sample;
	struct merge m;

	(void)state;
	merge_init(&m, 0);
	add(&m, IMU_CHIP_ACCEL, 10 * MS, 1);
	add(&m, IMU_CHIP_GYRO, 14 * MS, 0.5);
	assert_false(merge_next(&m, &sample)); /* there is no acceleration after it yet */
	add(&m, IMU_CHIP_ACCEL, 20 * MS, 2);
	assert_true(merge_next(&m, &sample));
	assert_int_equal(sample.t_us, 14000);
	assert_near(sample.gyro_rad_s.x, 0.5);
	assert_near(sample.accel_m_s2.x, 1.4);
	assert_int_equal(sample.flags, 0);
	assert_false(merge_next(&m, &sample));
}

static void test_readings_with_equal_times_are_a_sample_at_once(void **state)
{
	struct imu_sample sample;
	struct merge m;

	(void)state;
	merge_init(&m, 0);
	for (int i = 1; i < 100; i++) {
		add(&m, IMU_CHIP_ACCEL, i * 10 * MS, i);
		add(&m, IMU_CHIP_GYRO, i * 10 * MS, -i);
		assert_true(merge_next(&m, &sample));
		assert_near(sample.accel_m_s2.x, i);
		assert_near(sample.gyro_rad_s.x, -i);
	}
	assert_int_equal(m.lost, 0);
}

static void test_readings_within_the_tolerance_are_simultaneous(void **state)
{
	struct imu_sample sample;
	struct merge m;

	(void)state;
	merge_init(&m, 2 * MS);
	add(&m, IMU_CHIP_ACCEL, 10 * MS, 1);
	add(&m, IMU_CHIP_GYRO, 12 * MS, 0);
	assert_true(merge_next(&m, &sample));
	assert_near(sample.accel_m_s2.x, 1);
	add(&m, IMU_CHIP_GYRO, 22 * MS, 0);
	assert_false(merge_next(&m, &sample));
	add(&m, IMU_CHIP_ACCEL, 24 * MS, 3);
	assert_true(merge_next(&m, &sample));
	assert_near(sample.accel_m_s2.x, 3);
	add(&m, IMU_CHIP_GYRO, 34 * MS, 0);
	add(&m, IMU_CHIP_ACCEL, 36 * MS + 1, 6); /* a nanosecond beyond it */
	assert_true(merge_next(&m, &sample));
	assert_near(sample.accel_m_s2.x, 3 + 3 * 10e6 / (12e6 + 1));
}

static void test_samples_have_the_rate_of_the_gyro(void **state)
{
	struct imu_sample sample;
	unsigned n = 0;
	struct merge m;

	(void)state;
	merge_init(&m, 0);
	/* a ramp of 1 per ms; the accelerometer has 7 samples to 5 of the gyro, 3 ms later */
	for (int64_t t = 0; t < 1000 * MS; t += MS / 2) {
		if (t % (5 * MS) == 3 * MS)
			add(&m, IMU_CHIP_ACCEL, t, 1e-6 * (double)t);
		if (t % (7 * MS) == 0)
			add(&m, IMU_CHIP_GYRO, t, 0);
		while (merge_next(&m, &sample)) {
			n++;
			assert_near(sample.accel_m_s2.x, 1e-3 * (double)sample.t_us);
		}
	}
	assert_in_range(n, 140, 143);
	assert_int_equal(m.lost, 1); /* the first, before any acceleration */
}

static void test_a_gyro_reading_before_any_acceleration_is_lost_and_counted(void **state)
{
	struct imu_sample sample;
	struct merge m;

	(void)state;
	merge_init(&m, 0);
	add(&m, IMU_CHIP_GYRO, 5 * MS, 0);
	add(&m, IMU_CHIP_ACCEL, 10 * MS, 1);
	assert_false(merge_next(&m, &sample));
	assert_int_equal(m.lost, 1);
}

static void test_without_accelerations_the_oldest_gyro_readings_are_dropped(void **state)
{
	struct imu_sample sample;
	struct merge m;

	(void)state;
	merge_init(&m, 0);
	for (int i = 0; i < 1000; i++)
		add(&m, IMU_CHIP_GYRO, i * MS, 0);
	assert_false(merge_next(&m, &sample));
	assert_int_equal(m.lost, 1000 - MERGE_READINGS);
}

static void test_without_gyro_readings_the_oldest_accelerations_are_dropped(void **state)
{
	struct imu_sample sample;
	struct merge m;

	(void)state;
	merge_init(&m, 0);
	for (int i = 0; i < 1000; i++)
		add(&m, IMU_CHIP_ACCEL, i * MS, i);
	add(&m, IMU_CHIP_GYRO, (998 - MERGE_READINGS) * MS, 0); /* older than all that are left */
	add(&m, IMU_CHIP_GYRO, (1002 - MERGE_READINGS) * MS + MS / 2, 0);
	assert_true(merge_next(&m, &sample));
	assert_near(sample.accel_m_s2.x, 1002 - MERGE_READINGS + 0.5);
	assert_int_equal(m.lost, 1);
}

static void test_readings_that_go_back_in_time_are_dropped(void **state)
{
	struct imu_sample sample;
	struct merge m;

	(void)state;
	merge_init(&m, 0);
	add(&m, IMU_CHIP_ACCEL, 10 * MS, 1);
	add(&m, IMU_CHIP_ACCEL, 9 * MS, 5);
	add(&m, IMU_CHIP_GYRO, 10 * MS, 1);
	add(&m, IMU_CHIP_GYRO, 10 * MS, 2);
	assert_true(merge_next(&m, &sample));
	assert_near(sample.accel_m_s2.x, 1);
	assert_near(sample.gyro_rad_s.x, 1);
	assert_false(merge_next(&m, &sample));
}

static void test_a_reading_older_than_a_delivered_sample_is_dropped(void **state)
{
	struct imu_sample sample;
	struct merge m;

	(void)state;
	merge_init(&m, 0);
	add(&m, IMU_CHIP_ACCEL, 10 * MS, 1);
	add(&m, IMU_CHIP_ACCEL, 20 * MS, 1);
	add(&m, IMU_CHIP_GYRO, 14 * MS, 0);
	assert_true(merge_next(&m, &sample));
	add(&m, IMU_CHIP_GYRO, 12 * MS, 0);
	assert_false(merge_next(&m, &sample));
}

static void test_each_field_is_delivered_once_rotated_to_the_time_of_the_gyro(void **state)
{
	struct imu_sample sample;
	struct merge m;

	(void)state;
	merge_init(&m, 0);
	merge_add(&m, IMU_CHIP_MAG, &(struct merge_reading){.t_ns = 90 * MS, .value = {40, 0, 0}});
	for (int i = 10; i < 12; i++) {
		add(&m, IMU_CHIP_ACCEL, i * 10 * MS, 0);
		merge_add(&m, IMU_CHIP_GYRO, &(struct merge_reading){.t_ns = i * 10 * MS, .value = {0, 0, 2}});
	}
	assert_true(merge_next(&m, &sample));
	assert_int_equal(sample.flags, SAMPLE_MAG);
	/* with a rotation about +z, a field along x moves towards -y: 2 rad/s for 10 ms */
	assert_near(sample.mag_uT.x, 40);
	assert_near(sample.mag_uT.y, -0.8);
	assert_true(merge_next(&m, &sample));
	assert_int_equal(sample.flags, 0);
}

static void test_saturation_of_either_flags_the_sample(void **state)
{
	struct imu_sample sample;
	struct merge m;

	(void)state;
	merge_init(&m, 0);
	add(&m, IMU_CHIP_ACCEL, 0, 0);
	add(&m, IMU_CHIP_GYRO, 5 * MS, 0);
	merge_add(&m, IMU_CHIP_ACCEL, &(struct merge_reading){.t_ns = 10 * MS, .saturated = true});
	assert_true(merge_next(&m, &sample));
	assert_int_equal(sample.flags, SAMPLE_SATURATED);
	merge_add(&m, IMU_CHIP_ACCEL, &(struct merge_reading){.t_ns = 20 * MS});
	merge_add(&m, IMU_CHIP_GYRO, &(struct merge_reading){.t_ns = 20 * MS, .saturated = true});
	assert_true(merge_next(&m, &sample));
	assert_int_equal(sample.flags, SAMPLE_SATURATED);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_mount_matrix_is_read_row_by_row),
		cmocka_unit_test(test_a_mount_matrix_that_is_not_a_rotation_is_refused),
		cmocka_unit_test(test_a_mount_matrix_that_mirrors_is_told_apart),
		cmocka_unit_test(test_the_smallest_value_that_is_enough_is_chosen_with_its_text),
		cmocka_unit_test(test_if_no_value_is_enough_the_largest_is_returned),
		cmocka_unit_test(test_a_range_with_steps_is_parsed),
		cmocka_unit_test(test_the_acceleration_is_interpolated_to_the_time_of_the_gyro),
		cmocka_unit_test(test_readings_with_equal_times_are_a_sample_at_once),
		cmocka_unit_test(test_readings_within_the_tolerance_are_simultaneous),
		cmocka_unit_test(test_samples_have_the_rate_of_the_gyro),
		cmocka_unit_test(test_a_gyro_reading_before_any_acceleration_is_lost_and_counted),
		cmocka_unit_test(test_without_accelerations_the_oldest_gyro_readings_are_dropped),
		cmocka_unit_test(test_without_gyro_readings_the_oldest_accelerations_are_dropped),
		cmocka_unit_test(test_readings_that_go_back_in_time_are_dropped),
		cmocka_unit_test(test_a_reading_older_than_a_delivered_sample_is_dropped),
		cmocka_unit_test(test_each_field_is_delivered_once_rotated_to_the_time_of_the_gyro),
		cmocka_unit_test(test_saturation_of_either_flags_the_sample),
		cmocka_unit_test(test_over_a_hole_in_the_accelerations_there_is_no_sample),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
