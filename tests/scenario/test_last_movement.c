/* The last complete movement and its path as objects (211Ah, 2132h): the whole device on a simulated robot that
 * alternates between motion and rest. */
#include "tests/scenario/world.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char HEADER[] = "t_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,sx_m,sy_m,sz_m\n";

static char text[OD_DOMAIN_MAX + 1];

static int set_up(void **state)
{
	struct sensor_config chip = *sensor_preset("lsm303dlhc_l3gd20");

	sensor_calibrate(&chip);
	struct world *w = world_new(&chip, 1, "square");

	const uint8_t hand_held = 1;

	assert_int_equal(world_sdo_write(w, 0x2040, 10, &hand_held, 1), 0);
	*state = w;
	return 0;
}

static size_t read_trajectory(struct world *w)
{
	const struct od_domain *domain = od_find_domain(&w->device.od, 0x2132, 0);
	size_t size = domain->read(domain->ctx, (uint8_t *)text);

	assert_true(size <= OD_DOMAIN_MAX);
	text[size] = '\0';
	return size;
}

static void drive_to_the_end_of(struct world *w, uint32_t number)
{
	for (int k = 0; w->device.values.last_movement.number != number; k++) {
		assert_true(k < 3000);
		world_sample(w);
	}
}

static void test_before_the_first_movement_the_trajectory_has_only_its_header(void **state)
{
	struct world *w = *state;

	world_seconds(w, 5);
	assert_int_equal(w->device.values.last_movement.number, 0);
	read_trajectory(w);
	assert_string_equal(text, HEADER);
}

static void test_the_summary_describes_the_drive(void **state)
{
	struct world *w = *state;

	drive_to_the_end_of(w, 1);
	assert_near(w->device.values.last_movement.duration, 8.3, 0.5); /* straight drive, stop, turn */
	assert_near(w->device.values.last_movement.path, 2, 0.3);
	assert_near(w->device.values.last_movement.farthest, 2, 0.1);
	assert_true(w->device.values.last_movement.farthest_time > 4);
	assert_true(w->device.values.last_movement.farthest_time <= w->device.values.last_movement.duration);
	assert_near(w->device.values.last_movement.x, 2, 0.1);
	assert_near(w->device.values.last_movement.y, 0, 0.1);
	assert_near(w->device.values.last_movement.z, 0, 0.1);
	assert_true(w->device.values.last_movement.sigma_x > 0 && w->device.values.last_movement.sigma_x < 0.1);
	assert_int_equal(w->device.values.last_movement.whole, 1);
}

static void test_the_displacement_equals_2115h(void **state)
{
	struct world *w = *state;

	drive_to_the_end_of(w, 1);
	assert_near(w->device.values.last_movement.x, w->device.values.displacement.x, 1e-6);
	assert_near(w->device.values.last_movement.y, w->device.values.displacement.y, 1e-6);
	assert_near(w->device.values.last_movement.z, w->device.values.displacement.z, 1e-6);
	assert_near(w->device.values.last_movement.sigma_z, w->device.values.displacement_sigma.z, 1e-6);
}

static void test_the_trajectory_goes_from_zero_to_the_displacement(void **state)
{
	struct world *w = *state;
	double row[10];
	char *line, *rest;
	int rows = 0;

	drive_to_the_end_of(w, 1);
	read_trajectory(w);
	assert_int_equal(strncmp(text, HEADER, strlen(HEADER)), 0);
	rest = text + strlen(HEADER);
	while ((line = strsep(&rest, "\n")) && *line) {
		for (int i = 0; i < 10; i++, line++)
			row[i] = strtod(line, &line);
		assert_int_equal(line[-1], '\0');
		for (int i = 0; rows == 0 && i < 4; i++)
			assert_near(row[i], 0, 0);
		rows++;
	}
	assert_int_equal(rows, w->device.values.last_movement.points);
	assert_near(row[0], w->device.values.last_movement.duration, 0.001);
	assert_near(row[1], w->device.values.last_movement.x, 0.0001);
	assert_near(row[2], w->device.values.last_movement.y, 0.0001);
	assert_near(row[9], w->device.values.last_movement.sigma_z, 0.0001);
}

static void test_both_stay_until_the_next_movement_ends(void **state)
{
	struct world *w = *state;
	static char before[sizeof(text)];
	float path;

	drive_to_the_end_of(w, 1);
	read_trajectory(w);
	memcpy(before, text, sizeof(text));
	path = w->device.values.last_movement.path;
	world_seconds(w, 7);
	read_trajectory(w);
	assert_string_equal(text, before);
	assert_true(w->device.values.last_movement.path == path);
	drive_to_the_end_of(w, 2);
	read_trajectory(w);
	assert_string_not_equal(text, before);
	assert_near(w->device.values.last_movement.y, 2, 0.1);
}

/* The robot drives for 5 s, rests for 1 s, and turns. */
static void test_a_reset_of_the_position_at_rest_ends_the_movement_and_keeps_the_displacement(void **state)
{
	struct world *w = *state;
	const uint8_t one = 1;

	world_seconds(w, 7.7);
	assert_int_equal(world_sdo_write(w, 0x2040, 6, &one, 1), 0);
	world_seconds(w, 0.1);
	assert_int_equal(w->device.values.last_movement.number, 1);
	assert_near(w->device.values.last_movement.x, 2, 0.1);
	assert_near(w->device.values.displacement.x, 2, 0.1);
	assert_near(w->device.values.position_m.x, 0, 0.01);
	drive_to_the_end_of(w, 2);
	assert_near(w->device.values.last_movement.x, 0, 0.1);
	assert_near(w->device.values.displacement.x, 0, 0.1);
}

static void test_reset_node_clears_both(void **state)
{
	struct world *w = *state;

	drive_to_the_end_of(w, 1);
	world_nmt(w, 0x81);
	world_seconds(w, 0.1);
	assert_int_equal(w->device.values.last_movement.number, 0);
	assert_int_equal(read_trajectory(w), strlen(HEADER));
	drive_to_the_end_of(w, 1);
}

static void test_the_trajectory_fits_its_object_for_any_distance(void **state)
{
	struct world *w = *state;
	const struct vec3 nowhere = {-1e300, NAN, INFINITY};
	struct smoother_movement *m = &w->device.last_movement.smoother.last;

	m->count = SMOOTHER_POINTS;
	for (size_t i = 0; i < m->count; i++)
		m->point[i] = (struct smoother_point){1e300, nowhere, nowhere, nowhere};
	read_trajectory(w);
	assert_int_equal(text[strlen(text) - 1], '\n');
	assert_non_null(strstr(text, "\n99999999.000,-99999.0000,"));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test_setup_teardown(
			test_before_the_first_movement_the_trajectory_has_only_its_header, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(test_the_summary_describes_the_drive, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(test_the_displacement_equals_2115h, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_the_trajectory_goes_from_zero_to_the_displacement, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(test_both_stay_until_the_next_movement_ends, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_a_reset_of_the_position_at_rest_ends_the_movement_and_keeps_the_displacement, set_up,
			world_tear_down),
		cmocka_unit_test_setup_teardown(test_reset_node_clears_both, set_up, world_tear_down),
		cmocka_unit_test_setup_teardown(
			test_the_trajectory_fits_its_object_for_any_distance, set_up, world_tear_down),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
