/* The configuration read again while the device runs (SIGHUP). */
#include <errno.h>
#include <math.h>
#include <string.h>
#include <unistd.h>

#include "gateway/config.h"
#include "gateway/reload.h"
#include "tests/scenario/world.h"

enum { RESET_NODE = 129, RESET_COMMUNICATION = 130 };
static const uint8_t SAVE[] = {'s', 'a', 'v', 'e'};

static int set_up(void **state)
{
	*state = world_new(&SENSOR_PRESETS[0], 1, "rest");
	return 0;
}

/* What the file says, a NULL-terminated list; the device was started with `inhibit_time_emcy=0` only. */
static struct config config_of(const char *const *settings)
{
	struct config config;
	char why[CONFIG_ERROR_MAX];

	config_init(&config, &imu9_od_table);
	assert_int_equal(config_set(&config, "inhibit_time_emcy=0", why), 0);
	for (; settings && *settings; settings++)
		assert_int_equal(config_set(&config, *settings, why), 0);
	return config;
}

static int reload_as(struct world *w, const char *const *settings)
{
	const struct config before = config_of(NULL), after = config_of(settings);

	return reload(&w->device, &before, &after, w->now_us);
}

static void test_a_changed_object_holds_at_once(void **state)
{
	struct world *w = *state;

	world_seconds(w, 1);
	assert_int_equal(reload_as(w, (const char *[]){"lever_arm.l=0.25", NULL}), 0);
	assert_near(w->device.values.lever_arm.l, 0.25, 1e-6);
	world_sample(w);
	assert_near(w->device.pipeline.config.estimator.lever_arm_b_m.x, 0.25, 1e-6);
}

static void test_an_object_that_the_file_no_longer_sets_has_its_default_again(void **state)
{
	struct world *w = *state;

	assert_int_equal(reload_as(w, (const char *[]){"lever_arm.l=0.25", NULL}), 0);
	assert_int_equal(reload_as(w, NULL), 0);
	assert_near(w->device.values.lever_arm.l, 0, 1e-9);
}

static void test_what_the_bus_wrote_stays_where_the_file_is_the_same(void **state)
{
	struct world *w = *state;
	const float metres = 0.5f;

	assert_int_equal(world_sdo_write(w, 0x2000, 1, &metres, 4), 0);
	assert_int_equal(reload_as(w, (const char *[]){"lever_arm.s=0.25", NULL}), 0);
	assert_near(w->device.values.lever_arm.l, 0.5, 1e-6);
	assert_near(w->device.values.lever_arm.s, 0.25, 1e-6);
}

static void test_a_reset_starts_from_the_new_values(void **state)
{
	struct world *w = *state;
	const float metres = 0.5f;

	assert_int_equal(reload_as(w, (const char *[]){"lever_arm.l=0.25", NULL}), 0);
	assert_int_equal(world_sdo_write(w, 0x2000, 1, &metres, 4), 0);
	world_nmt(w, RESET_NODE);
	assert_near(w->device.values.lever_arm.l, 0.25, 1e-6);
}

static void test_communication_objects_hold_from_the_next_reset_communication_on(void **state)
{
	struct world *w = *state;

	assert_int_equal(reload_as(w, (const char *[]){"producer_heartbeat_time=250", NULL}), 0);
	assert_int_equal(w->device.values.producer_heartbeat_time, 1000);
	world_nmt(w, RESET_COMMUNICATION);
	assert_int_equal(w->device.values.producer_heartbeat_time, 250);
}

static void test_a_stored_value_keeps_its_precedence(void **state)
{
	struct world *w = *state;
	const float metres = 0.5f;

	assert_int_equal(world_sdo_write(w, 0x2000, 1, &metres, 4), 0);
	assert_int_equal(world_sdo_write(w, 0x1010, 1, SAVE, 4), 0);
	assert_int_equal(reload_as(w, (const char *[]){"lever_arm.l=0.25", "lever_arm.s=0.25", NULL}), 0);
	assert_near(w->device.values.lever_arm.l, 0.5, 1e-6);
	assert_near(w->device.values.lever_arm.s, 0.25, 1e-6);
}

/* The file changes a locked device, and the bus still does not. */
static void test_a_device_that_is_locked_stays_so(void **state)
{
	struct world *w = *state;
	const float metres = 0.5f;

	assert_int_equal(world_sdo_write(w, 0x214C, 2, "\x78\x56\x34\x12", 4), 0);
	assert_int_equal(reload_as(w, (const char *[]){"lever_arm.l=0.25", NULL}), 0);
	assert_near(w->device.values.lever_arm.l, 0.25, 1e-6);
	assert_int_equal(world_sdo_write(w, 0x2000, 1, &metres, 4), 0x06010002);
	assert_near(w->device.values.lever_arm.l, 0.25, 1e-6);
}

static void test_what_is_no_configuration_stays_as_the_start_has_set_it(void **state)
{
	struct world *w = *state;
	int ends[2], kept = dup(STDERR_FILENO);
	char said[1000] = "";

	w->serial = 1234;
	w->vendor = 0x319;
	world_power_on(w, NULL);
	assert_int_equal(pipe(ends), 0);
	dup2(ends[1], STDERR_FILENO);
	assert_int_equal(reload_as(w, (const char *[]){"lever_arm.l=0.25", "producer_heartbeat_time=500", NULL}), 0);
	dup2(kept, STDERR_FILENO);
	assert_true(read(ends[0], said, sizeof(said) - 1) > 0);
	close(ends[0]);
	close(ends[1]);
	close(kept);
	assert_non_null(strstr(said, "producer_heartbeat_time: from the next NMT reset communication on\n"));
	assert_null(strstr(said, "identity"));
	world_nmt(w, RESET_NODE);
	assert_int_equal(w->device.values.identity.serial_number, 1234);
	assert_int_equal(w->device.values.identity.vendor_id, 0x319);
}

static void test_a_contradiction_changes_nothing(void **state)
{
	struct world *w = *state;

	assert_int_equal(
		reload_as(w, (const char *[]){"lever_arm.l=0.25", "accelerometer_calibration.xx=0", NULL}), -EINVAL);
	assert_near(w->device.values.lever_arm.l, 0, 1e-9);
	world_nmt(w, RESET_NODE);
	assert_near(w->device.values.lever_arm.l, 0, 1e-9);
	assert_near(w->device.values.accelerometer_calibration.xx, 1, 1e-9);
	assert_int_equal(world_emcy_code(w), 0);
}

int main(void)
{
#define TEST(test) cmocka_unit_test_setup_teardown(test, set_up, world_tear_down)
	const struct CMUnitTest tests[] = {
		TEST(test_a_changed_object_holds_at_once),
		TEST(test_an_object_that_the_file_no_longer_sets_has_its_default_again),
		TEST(test_what_the_bus_wrote_stays_where_the_file_is_the_same),
		TEST(test_a_reset_starts_from_the_new_values),
		TEST(test_communication_objects_hold_from_the_next_reset_communication_on),
		TEST(test_a_stored_value_keeps_its_precedence),
		TEST(test_a_device_that_is_locked_stays_so),
		TEST(test_what_is_no_configuration_stays_as_the_start_has_set_it),
		TEST(test_a_contradiction_changes_nothing),
	};

	return cmocka_run_group_tests_name("reload", tests, NULL, NULL);
}
