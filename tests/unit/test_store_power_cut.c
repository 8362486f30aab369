/* 1010h on a disk that loses its power, or fails, at every single operation: what is read back is the old or the new
 * configuration as a whole, and the device believes what the disk has. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <string.h>

#include "gateway/storing.h"
#include "od_index.h"

enum { DISK_FILE_MAX = STORE_FILE_MAX, DISK_WRITE_MAX = 512 /* a file takes several */ };
#include "tests/unit/simulated_disk.h"

#define PATH DISK_FOLDER "/node-1.store"

/* ---- the device that stores -------------------------------------------------------------------------------------- */

static struct device {
	struct od od;
	struct od_values values;
	struct storing storing;
	struct event_log log;
} device;

static int save(void *ctx, const uint8_t *bytes, size_t size)
{
	(void)ctx;
	return store_write(PATH, bytes, size);
}

static void boot(void)
{
	static const struct storing_port port = {.save = save};
	struct store_image image;

	assert_int_equal(store_read(&image, PATH), 0);
	memset(&device, 0, sizeof(device));
	od_init(&device.od, &imu9_od_table, &device.values, 1);
	storing_init(&device.storing, &device.od, NULL, &device.log, &port, &image, 1);
	storing_apply(&device.storing, OD_GROUP_ALL, 0);
}

static uint16_t heartbeat(void)
{
	uint8_t wire[2];
	size_t size;

	assert_int_equal(od_read(&device.od, OD_INDEX_PRODUCER_HEARTBEAT_TIME, 0, wire, sizeof(wire), &size), OD_OK);
	return (uint16_t)(wire[0] | wire[1] << 8);
}

static enum od_status store(uint16_t heartbeat_ms)
{
	const uint8_t wire[2] = {(uint8_t)heartbeat_ms, (uint8_t)(heartbeat_ms >> 8)};

	assert_int_equal(od_write(&device.od, OD_INDEX_PRODUCER_HEARTBEAT_TIME, 0, wire, 2), OD_OK);
	return storing_store(&device.storing, OD_GROUP_ALL);
}

enum { OLD = 1111, NEW = 2222, LATER = 3333 };

/* A device that has stored OLD, and a disk on which the coming operation number `until` is the last. */
static void start(int until, int error)
{
	disk_clear();
	boot();
	assert_int_equal(store(OLD), OD_OK);
	disk_fail_at(until, error);
}

/* Whether it was confirmed before the power was cut, if it was. */
static bool store_until_cut(void)
{
	return setjmp(disk_cut) == 0 && store(NEW) == OD_OK;
}

/* The number of operations that one store takes. */
static int operations_of_a_store(void)
{
	start(DISK_NEVER, 0);
	assert_int_equal(store(NEW), OD_OK);
	return disk.operations;
}

/* ---- the tests --------------------------------------------------------------------------------------------------- */

static void test_after_a_power_cut_at_any_operation_the_old_or_the_new_values_are_there(void **state)
{
	int operations = operations_of_a_store(), seen_old = 0, seen_new = 0;

	(void)state;
	assert_true(operations >= 7); /* unlink, open, write, fsync, close, rename, the folder */
	for (int until = 0; until <= operations; until++)
		for (int remains = NOTHING; remains < REMAINS; remains++)
			for (unsigned kept = 0;; kept++) {
				start(until, 0);
				bool confirmed = store_until_cut();
				if (kept >> disk.change_count)
					break; /* all of them were tried */
				disk_restart(kept, (enum disk_remains)remains);
				boot();
				assert_true(heartbeat() == NEW || (heartbeat() == OLD && !confirmed));
				seen_old += heartbeat() == OLD;
				seen_new += heartbeat() == NEW;
				assert_int_equal(store(LATER), OD_OK); /* whatever was left behind is no obstacle */
				boot();
				assert_int_equal(heartbeat(), LATER);
			}
	assert_true(seen_old > 0 && seen_new > 0);
}

static void test_after_a_failure_of_any_operation_the_device_believes_what_the_disk_has(void **state)
{
	static const int errors[] = {EIO, ENOSPC, EROFS};
	int operations = operations_of_a_store();

	(void)state;
	for (int until = 0; until < operations; until++)
		for (size_t e = 0; e < sizeof(errors) / sizeof(errors[0]); e++) {
			start(until, errors[e]);
			enum od_status status = store(NEW);
			if (until > 0 && until < operations - 1) /* what was left behind; closing the folder */
				assert_int_equal(status, OD_CANNOT_STORE);
			storing_reset(&device.storing, OD_GROUP_ALL, 0); /* what it holds to be stored */
			uint16_t believed = heartbeat();
			assert_true(believed == NEW || (believed == OLD && status == OD_CANNOT_STORE));
			boot();
			assert_int_equal(heartbeat(), believed);
		}
}

static void test_what_was_confirmed_survives_a_power_cut_although_an_operation_failed(void **state)
{
	int operations = operations_of_a_store();

	(void)state;
	for (int until = 0; until < operations; until++)
		for (unsigned kept = 0;; kept++) {
			start(until, EIO);
			enum od_status status = store(NEW);
			if (kept >> disk.change_count)
				break;
			disk_restart(kept, NOTHING);
			boot();
			assert_true(heartbeat() == NEW || (heartbeat() == OLD && status != OD_OK));
		}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_after_a_power_cut_at_any_operation_the_old_or_the_new_values_are_there),
		cmocka_unit_test(test_after_a_failure_of_any_operation_the_device_believes_what_the_disk_has),
		cmocka_unit_test(test_what_was_confirmed_survives_a_power_cut_although_an_operation_failed),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
