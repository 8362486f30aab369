/* tests/unit/simulated_disk.h
 * A disk in the folder "/disk" that loses its power, or fails, at a chosen operation. It keeps what POSIX promises and
 * nothing else: bytes are durable after fsync() of their file, names after that of their folder; of everything before,
 * a power cut may keep any part. It defines the system's functions itself, so a program includes it in one file, which
 * says before how long a file can become (DISK_FILE_MAX) and how much one write() takes (DISK_WRITE_MAX). */
#ifndef TESTS_SIMULATED_DISK_H
#define TESTS_SIMULATED_DISK_H

#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#define DISK_FOLDER "/disk"

enum { DISK_FILES = 64, DISK_NAMES = 20, DISK_CHANGES = 64, DISK_FIRST_FD = 100000, DISK_FOLDER_FD = 99999 };
enum { DISK_NEVER = 1000000 /* no operation fails */ };
enum disk_remains { NOTHING, HALF, ZEROS, STALE, ALL, REMAINS }; /* of bytes that were not synced */

struct disk_name {
	char text[64];
	int file; /* -1: no such file */
};

static struct disk {
	struct disk_file {
		uint8_t bytes[DISK_FILE_MAX], durable[DISK_FILE_MAX];
		size_t size, durable_size, read_at, write_at;
	} files[DISK_FILES];
	int file_count;
	struct disk_name names[DISK_NAMES], durable[DISK_NAMES];
	struct disk_name changes[DISK_CHANGES]; /* of the names since the folder was synced */
	int change_count;
	int until; /* the operation that the power cut precedes, or that fails */
	int error; /* 0: a power cut, which is a longjmp() to disk_cut */
	int operations;
	int unlinked;
} disk;
static jmp_buf disk_cut;

/* ---- what a test says -------------------------------------------------------------------------------------------- */

/* An empty disk, on which nothing fails. */
static void disk_clear(void)
{
	memset(disk.files, 0, (size_t)disk.file_count * sizeof(disk.files[0])); /* the others are empty */
	memset(&disk.file_count, 0, sizeof(disk) - offsetof(struct disk, file_count));
	disk.until = DISK_NEVER;
}

/* From now on the operation number `until` fails; with error 0 the power is cut before it. */
static void disk_fail_at(int until, int error)
{
	disk.operations = 0;
	disk.until = until;
	disk.error = error;
}

/* ---- the disk ---------------------------------------------------------------------------------------------------- */

static struct disk_name *look_up(struct disk_name *names, const char *text)
{
	struct disk_name *free_name = NULL;

	for (int i = 0; i < DISK_NAMES; i++) {
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
	assert_true(disk.change_count < DISK_CHANGES);
	struct disk_name *change = &disk.changes[disk.change_count++];
	snprintf(change->text, sizeof(change->text), "%s", text);
	change->file = file;
}

static bool fails(void)
{
	if (disk.operations++ != disk.until)
		return false;
	if (disk.error == 0)
		longjmp(disk_cut, 1);
	errno = disk.error;
	return true;
}

/* ---- the power comes back ---------------------------------------------------------------------------------------- */

/* After a power cut. Bit n of kept_changes: the n-th change of a name is there. STALE: where bytes were not written is
 * what the disk had there before, of another file. */
static void disk_restart(unsigned kept_changes, enum disk_remains remains)
{
	for (int i = 0; i < disk.change_count; i++)
		if (kept_changes & 1u << i % 32)
			look_up(disk.durable, disk.changes[i].text)->file = disk.changes[i].file;
	memcpy(disk.names, disk.durable, sizeof(disk.names));
	disk.change_count = 0;
	for (int i = 0; i < disk.file_count; i++) {
		struct disk_file *f = &disk.files[i];
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
	disk.until = DISK_NEVER;
}

/* ---- the system's functions -------------------------------------------------------------------------------------- */

int open(const char *path, int flags, ...)
{
	if (strncmp(path, DISK_FOLDER, strlen(DISK_FOLDER)) != 0)
		return (int)syscall(SYS_openat, AT_FDCWD, path, flags, 0644);
	if ((flags & (O_DIRECTORY | O_CREAT)) && fails())
		return -1;
	if (flags & O_DIRECTORY)
		return DISK_FOLDER_FD;
	struct disk_name *name = look_up(disk.names, path);
	if (name->file >= 0 && (flags & O_EXCL)) {
		errno = EEXIST;
		return -1;
	}
	if (name->file < 0 && !(flags & O_CREAT)) {
		errno = ENOENT;
		return -1;
	}
	if (name->file < 0) {
		assert_true(disk.file_count < DISK_FILES);
		set_name(path, disk.file_count++);
	}
	disk.files[name->file].read_at = 0;
	if (flags & O_CREAT) /* one writes and one reads at most */
		disk.files[name->file].write_at = 0;
	return DISK_FIRST_FD + name->file;
}

int flock(int fd, int operation)
{
	(void)operation;
	return fd == DISK_FOLDER_FD ? 0 : -1;
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
	if (fd < DISK_FIRST_FD)
		return syscall(SYS_read, fd, bytes, size);
	struct disk_file *f = &disk.files[fd - DISK_FIRST_FD];
	size_t n = f->size - f->read_at < size ? f->size - f->read_at : size;
	memcpy(bytes, f->bytes + f->read_at, n);
	f->read_at += n;
	return (ssize_t)n;
}

ssize_t pread(int fd, void *bytes, size_t size, off_t offset)
{
	const struct disk_file *f = &disk.files[fd - DISK_FIRST_FD];
	size_t at = (size_t)offset < f->size ? (size_t)offset : f->size;
	size_t n = f->size - at < size ? f->size - at : size;

	assert_true(fd >= DISK_FIRST_FD);
	memcpy(bytes, f->bytes + at, n);
	return (ssize_t)n;
}

static void put(struct disk_file *f, size_t at, const void *bytes, size_t size)
{
	assert_true(at + size <= DISK_FILE_MAX);
	memcpy(f->bytes + at, bytes, size);
	if (at + size > f->size)
		f->size = at + size;
}

ssize_t pwrite(int fd, const void *bytes, size_t size, off_t offset)
{
	if (fails())
		return -1;
	put(&disk.files[fd - DISK_FIRST_FD], (size_t)offset, bytes, size);
	return (ssize_t)size;
}

ssize_t write(int fd, const void *bytes, size_t size)
{
	if (fd < DISK_FIRST_FD)
		return syscall(SYS_write, fd, bytes, size);
	if (fails())
		return -1;
	struct disk_file *f = &disk.files[fd - DISK_FIRST_FD];
	size_t n = size < DISK_WRITE_MAX ? size : DISK_WRITE_MAX;
	put(f, f->write_at, bytes, n);
	f->write_at += n;
	return (ssize_t)n;
}

int fsync(int fd)
{
	if (fails())
		return -1;
	if (fd == DISK_FOLDER_FD) {
		memcpy(disk.durable, disk.names, sizeof(disk.durable));
		disk.change_count = 0;
		return 0;
	}
	struct disk_file *f = &disk.files[fd - DISK_FIRST_FD];
	memcpy(f->durable, f->bytes, f->size);
	f->durable_size = f->size;
	return 0;
}

int close(int fd)
{
	if (fd < DISK_FOLDER_FD)
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
	disk.unlinked++;
	set_name(path, -1);
	return 0;
}

#endif
