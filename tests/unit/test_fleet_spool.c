/* The spool of imu9-fleet on a disk that loses its power, or fails, at every single operation: what comes back are the
 * records that were appended, as they were and in order; all that were synchronised and not delivered are there. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <string.h>

#include "tools/fleet/spool.h"

enum { DISK_FILE_MAX = 4200, DISK_WRITE_MAX = 50 /* a record takes several */ };
#include "tests/unit/simulated_disk.h"

enum { SIZE = 65536 /* of the spool: segments of 4 kB */, RECORDS = 150, SYNC_EACH = 7 };

/* ---- who spools -------------------------------------------------------------------------------------------------- */

static struct spool spool;
static struct {
	unsigned appended, synced, acked, durably_acked; /* numbers of records */
} did;

/* Record n has 20 to 90 bytes, which follow from n. */
static size_t make_record(unsigned n, uint8_t *bytes)
{
	size_t size = 20 + n * 37 % 71;

	for (size_t i = 0; i < size; i++)
		bytes[i] = (uint8_t)(n * 31 + i * 7 + (n >> 3));
	bytes[0] = (uint8_t)n;
	bytes[1] = (uint8_t)(n >> 8);
	return size;
}

static unsigned number_of(const uint8_t *bytes, size_t size)
{
	uint8_t expected[SPOOL_RECORD_MAX];
	unsigned n = bytes[0] | (unsigned)bytes[1] << 8;

	assert_int_equal(size, make_record(n, expected));
	assert_memory_equal(bytes, expected, size);
	return n;
}

static int append(unsigned n)
{
	uint8_t bytes[SPOOL_RECORD_MAX];
	struct spool_position at;

	return spool_append(&spool, bytes, make_record(n, bytes), &at);
}

/* The next record that was not read, or 0. Delivers it if it shall. */
static unsigned next(bool deliver)
{
	uint8_t bytes[SPOOL_RECORD_MAX];
	struct spool_position at;
	size_t size;

	if (spool_next(&spool, bytes, sizeof(bytes), &size, &at) == 0)
		return 0;
	unsigned n = number_of(bytes, size);
	if (deliver) {
		did.acked = n;
		spool_acked(&spool, at);
	}
	return n;
}

static void sync_all(void)
{
	if (spool_sync(&spool) == 0) {
		did.synced = did.appended;
		did.durably_acked = did.acked;
	}
}

/* Appends RECORDS records, of which each second one is delivered, from the oldest on. */
static void work(unsigned records)
{
	for (unsigned n = 1; n <= records; n++) {
		if (append(n) == 0)
			did.appended = n;
		if (n % 2 == 0)
			next(true);
		if (n % SYNC_EACH == 0)
			sync_all();
	}
}

static void work_until_cut(void)
{
	if (setjmp(disk_cut) == 0)
		work(RECORDS);
}

static void begin(int until, int error)
{
	disk_clear();
	memset(&did, 0, sizeof(did));
	assert_int_equal(spool_open(&spool, DISK_FOLDER, SIZE), 0);
	disk_fail_at(until, error);
}

static int operations_of_work(unsigned records)
{
	begin(DISK_NEVER, 0);
	work(records);
	return disk.operations;
}

/* What is read after the restart: in order, without a gap. Returns the last number. */
static unsigned check_what_is_there(unsigned *first)
{
	unsigned last = 0, n;

	*first = 0;
	while ((n = next(false)) != 0) {
		if (last)
			assert_int_equal(n, last + 1);
		else
			*first = n;
		last = n;
	}
	return last;
}

static void test_after_a_power_cut_at_any_operation_what_was_synced_is_there_in_order(void **state)
{
	static const unsigned KEPT[] = {0, 0xFFFFFFFF, 0x55555555, 0xAAAAAAAA, 1};
	int operations = operations_of_work(RECORDS), lost = 0, kept_more = 0;
	unsigned first, last;

	(void)state;
	assert_true(operations > 250);
	for (int until = 0; until < operations; until++)
		for (int remains = NOTHING; remains < REMAINS; remains++)
			for (size_t k = 0; k < sizeof(KEPT) / sizeof(KEPT[0]); k++) {
				begin(until, 0);
				work_until_cut();
				disk_restart(KEPT[k], (enum disk_remains)remains);
				assert_int_equal(spool_open(&spool, DISK_FOLDER, SIZE), 0);
				last = check_what_is_there(&first);
				if (did.synced > did.acked) {
					assert_true(last >= did.synced);
					assert_true(first <= did.acked + 1);
				}
				if (last) /* what was known to be delivered does not come again */
					assert_true(first > did.durably_acked);
				lost += last < did.appended;
				kept_more += last > did.synced;
				did.appended = last;
				assert_int_equal(append(500), 0); /* what was left behind is no obstacle */
				assert_int_equal(spool_sync(&spool), 0);
				spool_close(&spool);
				assert_int_equal(spool_open(&spool, DISK_FOLDER, SIZE), 0);
				for (unsigned n = first; last && n <= last; n++)
					assert_int_equal(next(false), n);
				assert_int_equal(next(false), 500);
				assert_int_equal(next(false), 0);
			}
	assert_true(lost > 0 && kept_more > 0);
}

static void test_after_a_failure_of_any_operation_all_that_was_appended_is_there_in_order(void **state)
{
	static const int errors[] = {EIO, ENOSPC};
	int operations = operations_of_work(RECORDS);

	(void)state;
	for (int until = 0; until < operations; until++)
		for (size_t e = 0; e < sizeof(errors) / sizeof(errors[0]); e++) {
			bool accepted[RECORDS + 1] = {false};
			unsigned before, n;

			begin(until, errors[e]);
			for (n = 1; n <= RECORDS; n++) {
				accepted[n] = append(n) == 0;
				if (n % SYNC_EACH == 0)
					spool_sync(&spool);
			}
			spool_close(&spool);
			disk.until = DISK_NEVER;
			assert_int_equal(spool_open(&spool, DISK_FOLDER, SIZE), 0);
			for (before = 0; (n = next(false)) != 0; before = n) {
				assert_true(n > before && accepted[n]);
				for (unsigned i = before + 1; i < n; i++)
					assert_false(accepted[i]);
			}
			for (unsigned i = before + 1; i <= RECORDS; i++)
				assert_false(accepted[i]);
		}
}

static void test_a_full_ring_drops_its_oldest_records_and_counts_them(void **state)
{
	unsigned n, first, records = 2000;

	(void)state;
	begin(DISK_NEVER, 0);
	for (n = 1; n <= records; n++)
		assert_int_equal(append(n), 0);
	assert_true(spool.bytes <= SIZE);
	first = next(false);
	assert_true(first > 1);
	assert_int_equal(spool.dropped, first - 1);
	assert_int_equal(spool.records, records - first + 1);
	for (n = first + 1; n <= records; n++)
		assert_int_equal(next(false), n);
	assert_int_equal(next(false), 0);
}

static void test_what_is_delivered_leaves_the_disk(void **state)
{
	(void)state;
	begin(DISK_NEVER, 0);
	for (unsigned n = 1; n <= 200; n++)
		assert_int_equal(append(n), 0);
	assert_true(spool.bytes > 3 * 4096);
	while (next(true))
		;
	assert_true(spool_is_empty(&spool));
	assert_int_equal(spool_sync(&spool), 0);
	assert_int_equal(spool.bytes, 0);
	assert_true(disk.unlinked > 3);
	assert_int_equal(append(201), 0);
	assert_int_equal(next(false), 201);
}

static void test_what_was_read_and_not_delivered_is_read_again(void **state)
{
	(void)state;
	begin(DISK_NEVER, 0);
	for (unsigned n = 1; n <= 100; n++)
		assert_int_equal(append(n), 0);
	for (unsigned n = 1; n <= 60; n++)
		assert_int_equal(next(n <= 50), n);
	spool_rewind(&spool);
	assert_int_equal(next(false), 51);
	assert_int_equal(spool.records, 50);
}

static void test_a_flipped_bit_ends_its_segment_and_no_other(void **state)
{
	unsigned n, before = 0, gaps = 0;

	(void)state;
	begin(DISK_NEVER, 0);
	for (n = 1; n <= 200; n++)
		assert_int_equal(append(n), 0);
	spool_close(&spool);
	disk.files[look_up(disk.names, DISK_FOLDER "/spool-02.seg")->file].bytes[1000] ^= 4;
	assert_int_equal(spool_open(&spool, DISK_FOLDER, SIZE), 0);
	assert_int_equal(spool.damaged, 1);
	for (; (n = next(false)) != 0; before = n)
		gaps += n != before + 1;
	assert_int_equal(gaps, 1);
	assert_int_equal(before, 200);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_after_a_power_cut_at_any_operation_what_was_synced_is_there_in_order),
		cmocka_unit_test(test_after_a_failure_of_any_operation_all_that_was_appended_is_there_in_order),
		cmocka_unit_test(test_a_full_ring_drops_its_oldest_records_and_counts_them),
		cmocka_unit_test(test_what_is_delivered_leaves_the_disk),
		cmocka_unit_test(test_what_was_read_and_not_delivered_is_read_again),
		cmocka_unit_test(test_a_flipped_bit_ends_its_segment_and_no_other),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
