/* 1010h on a disk that loses its power, or fails, at every single operation: what is read back is the old or the new
 * configuration as a whole, and the device believes what the disk has. The disk is simulated, its functions are defined
 * here. It keeps what POSIX promises and nothing else: bytes are durable after fsync() of their file, names after that
 * of their folder; of everything before, a power cut may keep any part. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "gateway/storing.h"
#include "od_index.h"

#define FOLDER "/disk/"
#define PATH   FOLDER "node-1.store"

enum { FILES = 8, NAMES = 4, CHANGES = 8, FIRST_FD = 1000, FOLDER_FD = 999, NEVER = 1000000 };

enum remains { NOTHING, HALF, ZEROS, ALL, REMAINS }; /* of bytes that were not synced */

struct name {
	char text[64];
	int file; /* -1: no such file */
};

static struct disk {
	struct file {
		uint8_t bytes[STORE_FILE_MAX], durable[STORE_FILE_MAX];
		size_t size, durable_size, at;
	} files[FILES];
	int file_count;
	struct name names[NAMES], durable[NAMES];
	/* changes of the names since the folder was synced */
	struct name changes[CHANGES];
	int change_count;
	/* the operation that the power cut precedes, or that fails */
	int until;
	int error; /* 0: a power cut */
	int operations;
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

/* The power is cut before the chosen operation, or the operation fails. */
static bool fails(void)
{
	if (disk.operations++ != disk.until)
		return false;
	if (disk.error == 0)
		longjmp(cut, 1);
	errno = disk.error;
	return true;
}

/* After a power cut: any of the changes of names, and any part of the bytes, that were not synced. */
static void restart(unsigned kept_changes, enum remains remains)
{
	for (int i = 0; i < disk.change_count; i++)
		if (kept_changes & 1u << i)
			look_up(disk.durable, disk.changes[i].text)->file = disk.changes[i].file;
	memcpy(disk.names, disk.durable, sizeof(disk.names));
	disk.change_count = 0;
	for (int i = 0; i < disk.file_count; i++) {
		struct file *f = &disk.files[i];
		bool synced = f->size == f->durable_size && memcmp(f->bytes, f->durable, f->size) == 0;

		if (synced || remains == ALL)
			continue;
		if (remains == NOTHING)
			f->size = f->durable_size;
		if (remains == HALF)
			f->size /= 2;
		if (remains == ZEROS)
			memset(f->bytes + f->durable_size, 0, f->size - f->durable_size);
	}
	disk.until = NEVER;
}

static bool on_disk(const char *path)
{
	return strncmp(path, FOLDER, strlen(FOLDER)) == 0;
}

int open(const char *path, int flags, ...)
{
	if (!on_disk(path))
		return (int)syscall(SYS_openat, AT_FDCWD, path, flags, 0644);
	if (fails())
		return -1;
	if (flags & O_DIRECTORY)
		return FOLDER_FD;
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
		disk.files[disk.file_count].size = disk.files[disk.file_count].durable_size = 0;
		set_name(path, disk.file_count++);
	}
	disk.files[name->file].at = 0;
	return FIRST_FD + name->file;
}

int fstat(int fd, struct stat *status)
{
	(void)fd;
	*status = (struct stat){.st_mode = S_IFREG};
	return 0;
}

int lstat(const char *restrict path, struct stat *restrict status)
{
	*status = (struct stat){.st_mode = S_IFREG};
	if (look_up(disk.names, path)->file >= 0)
		return 0;
	errno = ENOENT;
	return -1;
}

ssize_t read(int fd, void *bytes, size_t size)
{
	if (fd < FIRST_FD)
		return syscall(SYS_read, fd, bytes, size);
	struct file *f = &disk.files[fd - FIRST_FD];
	size_t n = f->size - f->at < size ? f->size - f->at : size;
	memcpy(bytes, f->bytes + f->at, n);
	f->at += n;
	return (ssize_t)n;
}

/* At most half a page at a time, so that a file takes several. */
ssize_t write(int fd, const void *bytes, size_t size)
{
	if (fd < FIRST_FD)
		return syscall(SYS_write, fd, bytes, size);
	if (fails())
		return -1;
	struct file *f = &disk.files[fd - FIRST_FD];
	size_t n = size < 512 ? size : 512;
	memcpy(f->bytes + f->at, bytes, n);
	f->at += n;
	f->size = f->at;
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
	if (fd < FOLDER_FD)
		return (int)syscall(SYS_close, fd);
	return fails() ? -1 : 0;
}

int rename(const char *from, const char *to)
{
	if (fails())
		return -1;
	set_name(to, look_up(disk.names, from)->file);
	set_name(from, -1);
	return 0;
}

int unlink(const char *path)
{
	if (fails())
		return -1;
	if (look_up(disk.names, path)->file < 0) {
		errno = ENOENT;
		return -1;
	}
	set_name(path, -1);
	return 0;
}

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
	static const struct disk empty;

	disk = empty;
	disk.until = NEVER;
	boot();
	assert_int_equal(store(OLD), OD_OK);
	disk.operations = 0;
	disk.until = until;
	disk.error = error;
}

/* Whether it was confirmed before the power was cut, if it was. */
static bool store_until_cut(void)
{
	return setjmp(cut) == 0 && store(NEW) == OD_OK;
}

/* The number of operations that one store takes. */
static int operations_of_a_store(void)
{
	start(NEVER, 0);
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
			for (unsigned kept = 0; kept < 1u << CHANGES; kept++) {
				start(until, 0);
				bool confirmed = store_until_cut();
				if (kept >> disk.change_count)
					break; /* all of them were tried */
				restart(kept, (enum remains)remains);
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
			assert_true(status == OD_OK || status == OD_CANNOT_STORE);
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
		for (unsigned kept = 0; kept < 1u << CHANGES; kept++) {
			start(until, EIO);
			enum od_status status = store(NEW);
			if (kept >> disk.change_count)
				break;
			restart(kept, NOTHING);
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
