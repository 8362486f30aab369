/* The spool of imu9-fleet on a disk that loses its power, or fails, at every single operation: what comes back are the
 * records that were appended, as they were and in order; all that were synchronised and not delivered are there.
 * The disk is simulated, its functions are defined here. It keeps what POSIX promises and nothing else: bytes are
 * durable after fsync() of their file, names after that of their folder; of everything before, a power cut may keep any
 * part. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "tools/fleet/spool.h"

#define FOLDER "/disk"

enum {
	FILES = 64,
	NAMES = 20,
	CHANGES = 64,
	FILE_MAX = 4200,
	FIRST_FD = 100000,
	FOLDER_FD = 99999,
	NEVER = 1000000,
	SIZE = 65536, /* of the spool: segments of 4 kB */
	RECORDS = 150,
	SYNC_EACH = 7
};

enum remains { NOTHING, HALF, ZEROS, STALE, ALL, REMAINS }; /* of bytes that were not synced */

struct name {
	char text[64];
	int file; /* -1: no such file */
};

static struct disk {
	struct file {
		uint8_t bytes[FILE_MAX], durable[FILE_MAX];
		size_t size, durable_size, at;
	} files[FILES];
	int file_count;
	struct name names[NAMES], durable[NAMES];
	struct name changes[CHANGES]; /* of the names since the folder was synced */
	int change_count;
	int until; /* the operation that the power cut precedes, or that fails */
	int error; /* 0: a power cut */
	int operations;
	int unlinked;
} disk;
static jmp_buf cut;

/* ---- the disk ---------------------------------------------------------------------------------------------------- */

static struct name *look_up(struct name *names, const char *text)
{
	struct name *free_name = NULL;

	for (int i = 0; i < NAMES; i++) {
		if (strcmp(names[i].text, text) == 0)
			return &names[i];
		if (names[i].text[0] == '\0' && !free_name)
			free_name = &names[i];
	}
	assert_non_null(free_name);
	snprintf(free_name->text, sizeof(free_name->text), "%s", text);
	free_name->file = -1;
	return free_name;
}

static void set_name(const char *text, int file)
{
	look_up(disk.names, text)->file = file;
	assert_true(disk.change_count < CHANGES);
	struct name *change = &disk.changes[disk.change_count++];
	snprintf(change->text, sizeof(change->text), "%s", text);
	change->file = file;
}

static bool fails(void)
{
	if (disk.operations++ != disk.until)
		return false;
	if (disk.error == 0)
		longjmp(cut, 1);
	errno = disk.error;
	return true;
}

/* After a power cut. STALE: what was not written is what the disk had there before, of another segment. */
static void restart(unsigned kept_changes, enum remains remains)
{
	for (int i = 0; i < disk.change_count; i++)
		if (kept_changes & 1u << i % 32)
			look_up(disk.durable, disk.changes[i].text)->file = disk.changes[i].file;
	memcpy(disk.names, disk.durable, sizeof(disk.names));
	disk.change_count = 0;
	for (int i = 0; i < disk.file_count; i++) {
		struct file *f = &disk.files[i];
		bool synced = f->size == f->durable_size && memcmp(f->bytes, f->durable, f->size) == 0;

		if (synced || remains == ALL)
			continue;
		if (remains == NOTHING) {
			memcpy(f->bytes, f->durable, f->durable_size);
			f->size = f->durable_size;
		}
		if (remains == HALF && f->size > f->durable_size)
			f->size = f->durable_size + (f->size - f->durable_size) / 2;
		if (remains == ZEROS && f->size > f->durable_size)
			memset(f->bytes + f->durable_size, 0, f->size - f->durable_size);
		if (remains == STALE && i > 0 && f->size > f->durable_size)
			memcpy(f->bytes + f->durable_size, disk.files[i - 1].bytes + f->durable_size,
				f->size - f->durable_size);
	}
	disk.until = NEVER;
}

int open(const char *path, int flags, ...)
{
	if (strncmp(path, FOLDER, strlen(FOLDER)) != 0)
		return (int)syscall(SYS_openat, AT_FDCWD, path, flags, 0644);
	if (flags & O_DIRECTORY)
		return FOLDER_FD;
	if ((flags & O_CREAT) && fails())
		return -1;
	struct name *name = look_up(disk.names, path);
	if (name->file >= 0 && (flags & O_EXCL)) {
		errno = EEXIST;
		return -1;
	}
	if (name->file < 0 && !(flags & O_CREAT)) {
		errno = ENOENT;
		return -1;
	}
	if (name->file < 0) {
		assert_true(disk.file_count < FILES);
		set_name(path, disk.file_count++);
	}
	if (flags & O_CREAT)
		disk.files[name->file].at = 0; /* of the one that writes; who reads has no place of its own */
	return FIRST_FD + name->file;
}

int flock(int fd, int operation)
{
	(void)operation;
	return fd == FOLDER_FD ? 0 : -1;
}

ssize_t pread(int fd, void *bytes, size_t size, off_t offset)
{
	const struct file *f = &disk.files[fd - FIRST_FD];
	size_t at = (size_t)offset < f->size ? (size_t)offset : f->size;
	size_t n = f->size - at < size ? f->size - at : size;

	assert_true(fd >= FIRST_FD);
	memcpy(bytes, f->bytes + at, n);
	return (ssize_t)n;
}

static void put(struct file *f, size_t at, const void *bytes, size_t size)
{
	assert_true(at + size <= FILE_MAX);
	memcpy(f->bytes + at, bytes, size);
	if (at + size > f->size)
		f->size = at + size;
}

ssize_t pwrite(int fd, const void *bytes, size_t size, off_t offset)
{
	if (fails())
		return -1;
	put(&disk.files[fd - FIRST_FD], (size_t)offset, bytes, size);
	return (ssize_t)size;
}

/* At most 50 bytes at a time, so that a record takes several. */
ssize_t write(int fd, const void *bytes, size_t size)
{
	if (fd < FIRST_FD)
		return syscall(SYS_write, fd, bytes, size);
	if (fails())
		return -1;
	struct file *f = &disk.files[fd - FIRST_FD];
	size_t n = size < 50 ? size : 50;
	put(f, f->at, bytes, n);
	f->at += n;
	return (ssize_t)n;
}

int fsync(int fd)
{
	if (fails())
		return -1;
	if (fd == FOLDER_FD) {
		memcpy(disk.durable, disk.names, sizeof(disk.durable));
		disk.change_count = 0;
		return 0;
	}
	struct file *f = &disk.files[fd - FIRST_FD];
	memcpy(f->durable, f->bytes, f->size);
	f->durable_size = f->size;
	return 0;
}

int close(int fd)
{
	return fd < FOLDER_FD ? (int)syscall(SYS_close, fd) : 0;
}

int unlink(const char *path)
{
	if (fails())
		return -1;
	if (look_up(disk.names, path)->file < 0) {
		errno = ENOENT;
		return -1;
	}
	disk.unlinked++;
	set_name(path, -1);
	return 0;
}

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
	if (setjmp(cut) == 0)
		work(RECORDS);
}

static void begin(int until, int error)
{
	memset(disk.files, 0, (size_t)disk.file_count * sizeof(disk.files[0])); /* the others are empty */
	memset(&disk.file_count, 0, sizeof(disk) - offsetof(struct disk, file_count));
	memset(&did, 0, sizeof(did));
	disk.until = NEVER;
	assert_int_equal(spool_open(&spool, FOLDER, SIZE), 0);
	disk.operations = 0;
	disk.until = until;
	disk.error = error;
}

static int operations_of_work(unsigned records)
{
	begin(NEVER, 0);
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
				restart(KEPT[k], (enum remains)remains);
				assert_int_equal(spool_open(&spool, FOLDER, SIZE), 0);
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
				assert_int_equal(spool_open(&spool, FOLDER, SIZE), 0);
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
			disk.until = NEVER;
			assert_int_equal(spool_open(&spool, FOLDER, SIZE), 0);
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
	begin(NEVER, 0);
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
	begin(NEVER, 0);
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
	begin(NEVER, 0);
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
	begin(NEVER, 0);
	for (n = 1; n <= 200; n++)
		assert_int_equal(append(n), 0);
	spool_close(&spool);
	disk.files[look_up(disk.names, FOLDER "/spool-02.seg")->file].bytes[1000] ^= 4;
	assert_int_equal(spool_open(&spool, FOLDER, SIZE), 0);
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
