/* The file of 1010h: complete after any power cut, not used when damaged. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "gateway/store.h"
#include "od/little_endian.h"
#include "od/od.h"
#include "tests/unit/descriptors.h"

static char folder[64], path[128], bad_path[160], new_path[160], lock_path[160];

/* What the disk answers for a folder, and for a file. */
static int folder_sync_errno, file_sync_errno;
static atomic_bool waits; /* for a slow disk */
static bool takes_bytes;  /* one by one, with signals in between */
static bool takes_nothing;
/* What it answers once, or twice, when a file is read. */
static int read_errno[2];
static bool no_thread;

int fsync(int fd)
{
	struct stat status;

	if (fstat(fd, &status) == 0 && S_ISDIR(status.st_mode) && folder_sync_errno) {
		errno = folder_sync_errno;
		return -1;
	}
	while (waits)
		sched_yield();
	errno = file_sync_errno;
	return file_sync_errno ? -1 : (int)syscall(SYS_fsync, fd);
}

ssize_t write(int fd, const void *bytes, size_t size)
{
	static unsigned calls;

	errno = EINTR;
	if (takes_nothing)
		return 0;
	if (takes_bytes && ++calls % 3 == 0)
		return -1;
	return syscall(SYS_write, fd, bytes, takes_bytes ? 1 : size);
}

ssize_t read(int fd, void *bytes, size_t size)
{
	int error = read_errno[0];

	read_errno[0] = read_errno[1];
	read_errno[1] = 0;
	if (!error)
		return syscall(SYS_read, fd, bytes, size);
	errno = error;
	return -1;
}

int pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*body)(void *), void *arg)
{
	int (*create)(pthread_t *, const pthread_attr_t *, void *(*)(void *), void *);

	*(void **)&create = dlsym(RTLD_NEXT, "pthread_create");
	return no_thread ? EAGAIN : create(thread, attributes, body, arg);
}

static int make_folder(void **state)
{
	(void)state;
	strcpy(folder, "/tmp/imu9-store-XXXXXX");
	if (!mkdtemp(folder))
		return -1;
	snprintf(path, sizeof(path), "%s/node-1.store", folder);
	snprintf(bad_path, sizeof(bad_path), "%s.bad", path);
	snprintf(new_path, sizeof(new_path), "%s.new", path);
	snprintf(lock_path, sizeof(lock_path), "%s.lock", path);
	return 0;
}

static int remove_folder(void **state)
{
	(void)state;
	unlink(path);
	unlink(bad_path);
	unlink(new_path);
	unlink(lock_path);
	folder_sync_errno = 0;
	return rmdir(folder);
}

static struct store_image example(uint8_t fill, size_t size)
{
	struct store_image image = {0};

	memset(image.groups[0].dcf, fill, size);
	image.groups[0].size = size;
	image.groups[2].dcf[0] = fill;
	image.groups[2].size = 1;
	return image;
}

static void assert_same(const struct store_image *a, const struct store_image *b)
{
	for (int i = 0; i < STORE_GROUPS; i++) {
		assert_int_equal(a->groups[i].size, b->groups[i].size);
		assert_memory_equal(a->groups[i].dcf, b->groups[i].dcf, a->groups[i].size);
	}
}

static bool exists(const char *name)
{
	return access(name, F_OK) == 0;
}

static void write_bytes(const uint8_t *bytes, size_t size)
{
	FILE *f = fopen(path, "wb");

	assert_non_null(f);
	assert_int_equal(fwrite(bytes, 1, size, f), size);
	fclose(f);
}

static void test_what_is_written_is_read_back(void **state)
{
	const struct store_image image = example(0xA5, 100);
	struct store_image back;
	uint8_t bytes[STORE_FILE_MAX];

	(void)state;
	assert_int_equal(store_write(path, bytes, store_encode(&image, bytes)), 0);
	assert_int_equal(store_read(&back, path), 0);
	assert_same(&image, &back);
	assert_false(exists(new_path));
}

static void test_the_largest_image_fits_the_file(void **state)
{
	struct store_image image = {0}, back;
	uint8_t bytes[STORE_FILE_MAX];

	(void)state;
	for (int i = 0; i < STORE_GROUPS; i++)
		image.groups[i].size = STORE_GROUP_MAX;
	assert_int_equal(store_decode(&back, bytes, store_encode(&image, bytes)), 0);
	assert_same(&image, &back);
}

static void test_no_file_yet_means_nothing_stored(void **state)
{
	struct store_image image;

	(void)state;
	assert_int_equal(store_read(&image, path), 0);
	assert_int_equal(image.groups[0].size, 0);
}

static void test_every_truncation_is_detected_and_the_file_is_kept_as_bad(void **state)
{
	const struct store_image image = example(0x11, 20);
	struct store_image back;
	uint8_t bytes[STORE_FILE_MAX];
	size_t size = store_encode(&image, bytes);

	(void)state;
	for (size_t n = 0; n < size; n++) {
		write_bytes(bytes, n);
		assert_int_equal(store_read(&back, path), -EBADMSG);
		assert_int_equal(back.groups[0].size, 0);
		assert_false(exists(path));
		assert_int_equal(unlink(bad_path), 0);
	}
}

static void test_every_flipped_bit_is_detected(void **state)
{
	const struct store_image image = example(0x77, 20);
	struct store_image back;
	uint8_t bytes[STORE_FILE_MAX];
	size_t size = store_encode(&image, bytes);

	(void)state;
	for (size_t bit = 0; bit < size * 8; bit++) {
		bytes[bit / 8] ^= (uint8_t)(1 << bit % 8);
		assert_int_equal(store_decode(&back, bytes, size), -EBADMSG);
		bytes[bit / 8] ^= (uint8_t)(1 << bit % 8);
	}
	assert_int_equal(store_decode(&back, bytes, size), 0);
}

static void test_a_file_that_cannot_be_read_is_told_and_stays(void **state)
{
	const struct store_image image = example(3, 30);
	struct store_image back;
	uint8_t bytes[STORE_FILE_MAX];

	(void)state;
	assert_int_equal(store_write(path, bytes, store_encode(&image, bytes)), 0);
	read_errno[0] = EINTR; /* a signal */
	read_errno[1] = EIO;
	assert_int_equal(store_read(&back, path), -EIO);
	assert_int_equal(back.groups[0].size, 0);
	read_errno[0] = EINTR;
	assert_int_equal(store_read(&back, path), 0);
	assert_same(&image, &back);
}

/* The names beside it are longer: .new, .lock and .bad.99. */
static void test_the_longest_path_can_be_stored(void **state)
{
	static struct store_writer writer;
	static uint8_t bytes[STORE_FILE_MAX];
	const struct store_image image = example(6, 60);
	char longest[STORE_PATH_MAX + 1], name[STORE_PATH_MAX + 8];
	struct store_image back;
	size_t size = store_encode(&image, bytes);

	(void)state;
	memset(longest, 'x', sizeof(longest) - 1);
	memcpy(longest, folder, strlen(folder));
	for (size_t at = strlen(folder); at < STORE_PATH_MAX - 1; at += 200)
		longest[at] = '/';
	longest[STORE_PATH_MAX] = '\0';
	assert_int_equal(store_writer_open(&writer, longest), -ENAMETOOLONG);
	longest[STORE_PATH_MAX - 1] = '\0';
	assert_int_equal(store_writer_open(&writer, longest), 0);
	store_writer_close(&writer);
	assert_int_equal(store_write(longest, bytes, size), 0);
	assert_int_equal(store_read(&back, longest), 0);
	assert_same(&image, &back);
	for (int n = 0; n < 2; n++) {
		bytes[0] = (uint8_t)n;
		assert_int_equal(store_write(longest, bytes, size), 0);
		assert_int_equal(store_read(&back, longest), -EBADMSG);
	}
	static const char *const endings[] = {"", ".lock", ".bad", ".bad.1"};
	for (size_t i = 0; i < sizeof(endings) / sizeof(endings[0]); i++) {
		snprintf(name, sizeof(name), "%s%s", longest, endings[i]);
		assert_int_equal(unlink(name), i == 0 ? -1 : 0);
	}
	for (char *slash = strrchr(longest, '/'); (size_t)(slash - longest) > strlen(folder);
		slash = strrchr(longest, '/')) {
		*slash = '\0';
		assert_int_equal(rmdir(longest), 0);
	}
}

static void test_without_a_thread_the_store_is_not_open_and_its_lock_is_free(void **state)
{
	static struct store_writer writer;

	(void)state;
	no_thread = true;
	assert_int_equal(store_writer_open(&writer, path), -EAGAIN);
	no_thread = false;
	int of_others[] = {dup(STDOUT_FILENO), dup(STDOUT_FILENO)}; /* with the numbers that it had */
	store_writer_close(&writer);
	for (int i = 0; i < 2; i++)
		assert_int_equal(close(of_others[i]), 0);
	assert_int_equal(store_writer_open(&writer, path), 0);
	store_writer_close(&writer);
}

static void test_without_a_descriptor_the_store_is_not_open_and_its_lock_is_free(void **state)
{
	static struct store_writer writer;
	struct rlimit before, limit;
	int next = dup(STDIN_FILENO); /* of the lock; none is left for the event */

	(void)state;
	close(next);
	assert_int_equal(getrlimit(RLIMIT_NOFILE, &before), 0);
	limit = (struct rlimit){(rlim_t)next + 1, before.rlim_max};
	assert_int_equal(setrlimit(RLIMIT_NOFILE, &limit), 0);
	int result = store_writer_open(&writer, path);
	setrlimit(RLIMIT_NOFILE, &before);
	assert_int_equal(result, -EMFILE);
	assert_int_equal(store_writer_open(&writer, path), 0);
	store_writer_close(&writer);
}

/* A power cut leaves the temporary file in any state and does not change the other one. */
static void test_a_power_cut_during_a_write_keeps_the_old_values(void **state)
{
	const struct store_image old = example(1, 30), new = example(2, 60);
	struct store_image back;
	uint8_t bytes[STORE_FILE_MAX];

	(void)state;
	assert_int_equal(store_write(path, bytes, store_encode(&old, bytes)), 0);
	size_t size = store_encode(&new, bytes);
	FILE *f = fopen(new_path, "wb");
	assert_non_null(f);
	assert_int_equal(fwrite(bytes, 1, size / 2, f), size / 2);
	fclose(f);
	assert_int_equal(store_read(&back, path), 0);
	assert_same(&old, &back);
	assert_int_equal(store_write(path, bytes, size), 0); /* a left-over temporary file is replaced */
	assert_int_equal(store_read(&back, path), 0);
	assert_same(&new, &back);
}

static void test_a_bad_file_is_never_overwritten(void **state)
{
	struct store_image image;
	uint8_t byte;
	char name[200];

	(void)state;
	for (uint8_t n = 0; n < 3; n++) {
		write_bytes(&n, 1);
		assert_int_equal(store_read(&image, path), -EBADMSG);
		assert_false(exists(path));
	}
	for (uint8_t n = 0; n < 3; n++) {
		snprintf(name, sizeof(name), n ? "%s.%d" : "%s", bad_path, n);
		FILE *f = fopen(name, "rb");
		assert_non_null(f);
		assert_int_equal(fread(&byte, 1, 1, f), 1);
		assert_int_equal(byte, n);
		fclose(f);
		unlink(name);
	}
}

static void test_of_more_than_a_hundred_bad_files_the_last_one_stays(void **state)
{
	struct store_image image;
	const uint8_t byte = 1;
	char name[200];

	(void)state;
	for (int n = 0; n <= 100; n++) {
		write_bytes(&byte, 1);
		assert_int_equal(store_read(&image, path), -EBADMSG);
		assert_int_equal(exists(path), n == 100);
	}
	for (int n = 0; n < 100; n++) {
		snprintf(name, sizeof(name), n ? "%s.%d" : "%s", bad_path, n);
		assert_int_equal(unlink(name), 0);
	}
}

/* None of them is opened in a way that waits, and none is written through. */
static void test_a_store_that_is_not_a_regular_file_is_told_and_replaced_by_one(void **state)
{
	const struct store_image image = example(4, 10);
	struct store_image back;
	uint8_t bytes[STORE_FILE_MAX];
	size_t size = store_encode(&image, bytes);

	(void)state;
	assert_int_equal(mkfifo(path, 0600), 0);
	assert_int_equal(mkfifo(new_path, 0600), 0);
	assert_int_equal(store_read(&back, path), -EINVAL);
	assert_int_equal(store_write(path, bytes, size), 0);
	assert_int_equal(store_read(&back, path), 0);
	unlink(path);
	assert_int_equal(symlink(lock_path, path), 0);
	assert_int_equal(symlink(lock_path, new_path), 0);
	assert_int_equal(store_read(&back, path), -ELOOP);
	assert_int_equal(store_write(path, bytes, size), 0);
	assert_int_equal(store_read(&back, path), 0);
	assert_same(&image, &back);
	assert_false(exists(lock_path));
}

static void test_a_lock_that_is_a_link_is_not_followed(void **state)
{
	static struct store_writer writer;

	(void)state;
	assert_int_equal(symlink(bad_path, lock_path), 0);
	assert_int_equal(store_writer_open(&writer, path), -ELOOP);
	assert_false(exists(bad_path));
}

static void test_a_folder_that_is_not_synced_leaves_the_new_file_and_says_so(void **state)
{
	const struct store_image image = example(5, 10);
	struct store_image back;
	uint8_t bytes[STORE_FILE_MAX];

	(void)state;
	folder_sync_errno = EIO;
	assert_int_equal(store_write(path, bytes, store_encode(&image, bytes)), EIO);
	assert_int_equal(store_read(&back, path), 0);
	assert_same(&image, &back);
	folder_sync_errno = EINVAL; /* a file system that has no such thing */
	assert_int_equal(store_write(path, bytes, store_encode(&image, bytes)), 0);
}

static void test_a_file_that_is_not_synced_is_an_error_and_the_old_one_stays(void **state)
{
	const struct store_image old = example(5, 10), new = example(6, 20);
	struct store_image back;
	uint8_t bytes[STORE_FILE_MAX];

	(void)state;
	assert_int_equal(store_write(path, bytes, store_encode(&old, bytes)), 0);
	file_sync_errno = EIO;
	assert_int_equal(store_write(path, bytes, store_encode(&new, bytes)), -EIO);
	file_sync_errno = 0;
	assert_false(exists(new_path));
	assert_int_equal(store_read(&back, path), 0);
	assert_same(&old, &back);
}

static void test_a_disk_that_takes_bytes_one_by_one_gets_all_and_one_that_takes_none_is_full(void **state)
{
	const struct store_image image = example(5, 10);
	struct store_image back;
	uint8_t bytes[STORE_FILE_MAX];

	(void)state;
	takes_bytes = true;
	assert_int_equal(store_write(path, bytes, store_encode(&image, bytes)), 0);
	takes_bytes = false;
	takes_nothing = true;
	assert_int_equal(store_write(path, bytes, 10), -ENOSPC);
	takes_nothing = false;
	assert_false(exists(new_path));
	assert_int_equal(store_read(&back, path), 0);
	assert_same(&image, &back);
}

static void test_a_folder_that_cannot_be_written_is_an_error(void **state)
{
	static struct store_writer writer;
	uint8_t bytes[4] = {0};

	(void)state;
	assert_int_equal(store_write("/proc/no/such.store", bytes, 4), -ENOENT);
	assert_int_equal(store_writer_open(&writer, "/proc/no/such.store"), -ENOENT);
}

static mode_t mode_of(const char *name)
{
	struct stat status;

	assert_int_equal(stat(name, &status), 0);
	return status.st_mode & 0777;
}

static void test_the_thread_creates_the_folder_writes_and_signals_the_end(void **state)
{
	static struct store_writer writer;
	const struct store_image image = example(9, 10);
	struct store_image back;
	uint8_t bytes[STORE_FILE_MAX];
	char deep[160];

	(void)state;
	snprintf(deep, sizeof(deep), "%s/a/node-1.store", folder);
	assert_int_equal(store_writer_open(&writer, deep), 0);
	assert_int_equal(store_writer_result(&writer), -EAGAIN);
	assert_int_equal(store_writer_submit(&writer, bytes, store_encode(&image, bytes)), 0);
	struct pollfd p = {.fd = writer.fd, .events = POLLIN};
	assert_int_equal(poll(&p, 1, 120000), 1);
	assert_int_equal(store_writer_result(&writer), 0);
	store_writer_close(&writer);
	assert_int_equal(store_read(&back, deep), 0);
	assert_same(&image, &back);
	assert_int_equal(mode_of(deep), 0644);
	unlink(deep);
	strcat(deep, ".lock");
	assert_int_equal(mode_of(deep), 0644);
	unlink(deep);
	snprintf(deep, sizeof(deep), "%s/a", folder);
	assert_int_equal(mode_of(deep), 0755);
	rmdir(deep);
}

static void test_the_result_of_a_write_is_that_of_the_disk(void **state)
{
	static struct store_writer writer;
	const struct store_image image = example(9, 10);
	uint8_t bytes[STORE_FILE_MAX];

	(void)state;
	assert_int_equal(store_writer_open(&writer, path), 0);
	struct pollfd p = {.fd = writer.fd, .events = POLLIN};
	for (int i = 0; i < 2; i++) {
		file_sync_errno = i == 0 ? EIO : 0;
		assert_int_equal(store_writer_submit(&writer, bytes, store_encode(&image, bytes)), 0);
		assert_int_equal(poll(&p, 1, 120000), 1);
		assert_int_equal(store_writer_result(&writer), i == 0 ? -EIO : 0);
		assert_int_equal(store_writer_result(&writer), -EAGAIN); /* it is told once */
	}
	store_writer_close(&writer);
}

static void test_one_file_has_one_writer(void **state)
{
	static struct store_writer first, second;

	(void)state;
	assert_int_equal(store_writer_open(&first, path), 0);
	assert_int_equal(store_writer_open(&second, path), -EADDRINUSE);
	store_writer_close(&first);
	assert_int_equal(store_writer_open(&second, path), 0);
	store_writer_close(&second);
}

static void test_node_id_and_bit_rate_of_lss_are_read_back_and_initially_none(void **state)
{
	struct store_image image = example(1, 10), back;
	uint8_t bytes[STORE_FILE_MAX];

	(void)state;
	assert_int_equal(store_decode(&back, bytes, store_encode(&image, bytes)), 0);
	assert_int_equal(back.lss.node_id, 0);
	assert_int_equal(back.lss.bit_s, 0);
	image.lss = (struct store_lss){.node_id = 255, .bit_s = 125000};
	assert_int_equal(store_decode(&back, bytes, store_encode(&image, bytes)), 0);
	assert_int_equal(back.lss.node_id, 255);
	assert_int_equal(back.lss.bit_s, 125000);
}

static void test_an_invalid_node_id_is_damage(void **state)
{
	static const uint8_t wrong[] = {128, 254};
	struct store_image image = {.lss.node_id = 127}, back;
	uint8_t bytes[STORE_FILE_MAX];

	(void)state;
	assert_int_equal(store_decode(&back, bytes, store_encode(&image, bytes)), 0);
	for (size_t i = 0; i < 2; i++) {
		image.lss.node_id = wrong[i];
		assert_int_equal(store_decode(&back, bytes, store_encode(&image, bytes)), -EBADMSG);
		assert_int_equal(back.lss.node_id, 0);
	}
}

/* Sizes of the three groups, which have one byte together. */
static void test_groups_that_do_not_fill_the_file_are_damage(void **state)
{
	static const uint32_t sizes[][3] = {
		{0, 0, 0}, {0, 0, 2}, {0, 2, 0}, {2, 0, 0}, {8193, 0, 0}, {UINT32_MAX, 0, 0}, {0, 0, UINT32_MAX - 3}};
	static const struct store_image one_byte = {.groups[2].size = 1};
	struct store_image back;
	uint8_t bytes[STORE_FILE_MAX];
	size_t size = store_encode(&one_byte, bytes);

	(void)state;
	for (size_t i = 0; i < sizeof(sizes) / sizeof(sizes[0]); i++) {
		for (int group = 0; group < 3; group++)
			put_u32(bytes + 16 + 4 * group, sizes[i][group]);
		put_u32(bytes + size - 4, od_crc32(0, bytes, size - 4));
		assert_int_equal(store_decode(&back, bytes, size), -EBADMSG);
	}
	put_u32(bytes + 12, 11); /* less than LSS and revision need */
	put_u32(bytes + 16 + 11, od_crc32(0, bytes, 16 + 11));
	assert_int_equal(store_decode(&back, bytes, 16 + 11 + 4), -EBADMSG);
}

/* Version 1 has no LSS. One group of 3 bytes, two empty ones; the CRC by python's zlib. */
static void test_a_file_of_version_1_is_read(void **state)
{
	static const uint8_t old[] = {0x49, 0x4D, 0x55, 0x39, 0x53, 0x54, 0x4F, 0x52, 0x01, 0x00, 0x00, 0x00, 0x0F,
		0x00, 0x00, 0x00, 0x03, 0x00, 0x00, 0x00, 0xAA, 0xBB, 0xCC, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
		0x00, 0xB3, 0x9C, 0x74, 0x37};
	struct store_image back;

	(void)state;
	assert_int_equal(store_decode(&back, old, sizeof(old)), 0);
	assert_int_equal(back.groups[0].size, 3);
	assert_int_equal(back.groups[0].dcf[2], 0xCC);
	assert_int_equal(back.lss.node_id, 0);
	assert_int_equal(back.revision, 0);
}

/* Version 2 has no revision: 0, not known. LSS: node-ID 5, 125 kbit/s. */
static void test_a_file_of_version_2_is_read(void **state)
{
	static const uint8_t old[] = {0x49, 0x4D, 0x55, 0x39, 0x53, 0x54, 0x4F, 0x52, 0x02, 0x00, 0x00, 0x00, 0x17,
		0x00, 0x00, 0x00, 0x03, 0x00, 0x00, 0x00, 0xAA, 0xBB, 0xCC, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
		0x00, 0x05, 0x00, 0x00, 0x00, 0x48, 0xE8, 0x01, 0x00, 0x67, 0xB3, 0xF5, 0xB1};
	struct store_image back;

	(void)state;
	assert_int_equal(store_decode(&back, old, sizeof(old)), 0);
	assert_int_equal(back.groups[0].size, 3);
	assert_int_equal(back.lss.node_id, 5);
	assert_int_equal(back.lss.bit_s, 125000);
	assert_int_equal(back.revision, 0);
}

static void test_a_file_of_version_3_has_the_revision_of_its_values(void **state)
{
	static const uint8_t file[] = {0x49, 0x4D, 0x55, 0x39, 0x53, 0x54, 0x4F, 0x52, 0x03, 0x00, 0x00, 0x00, 0x1B,
		0x00, 0x00, 0x00, 0x03, 0x00, 0x00, 0x00, 0xAA, 0xBB, 0xCC, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
		0x00, 0x05, 0x00, 0x00, 0x00, 0x48, 0xE8, 0x01, 0x00, 0x02, 0x00, 0x01, 0x00, 0xC3, 0xCD, 0x2C, 0xA5};
	struct store_image back;
	uint8_t bytes[STORE_FILE_MAX];

	(void)state;
	assert_int_equal(store_decode(&back, file, sizeof(file)), 0);
	assert_int_equal(back.groups[0].size, 3);
	assert_int_equal(back.lss.bit_s, 125000);
	assert_int_equal(back.revision, 0x00010002);
	assert_int_equal(store_encode(&back, bytes), sizeof(file));
	assert_memory_equal(bytes, file, sizeof(file));
}

/* The key is in the file only while there is one: an earlier gateway reads the others. */
static void test_a_file_of_version_4_has_the_key_of_the_write_lock(void **state)
{
	static const uint8_t file[] = {0x49, 0x4D, 0x55, 0x39, 0x53, 0x54, 0x4F, 0x52, 0x04, 0x00, 0x00, 0x00, 0x1F,
		0x00, 0x00, 0x00, 0x03, 0x00, 0x00, 0x00, 0xAA, 0xBB, 0xCC, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
		0x00, 0x05, 0x00, 0x00, 0x00, 0x48, 0xE8, 0x01, 0x00, 0x02, 0x00, 0x01, 0x00, 0x78, 0x56, 0x34, 0x12,
		0x5C, 0x98, 0x3B, 0x77};
	struct store_image back;
	uint8_t bytes[STORE_FILE_MAX];

	(void)state;
	assert_int_equal(store_decode(&back, file, sizeof(file)), 0);
	assert_int_equal(back.lock_key, 0x12345678);
	assert_int_equal(back.revision, 0x00010002);
	assert_int_equal(store_encode(&back, bytes), sizeof(file));
	assert_memory_equal(bytes, file, sizeof(file));
	back.lock_key = 0;
	store_encode(&back, bytes);
	assert_int_equal(bytes[8], 3);
}

static void test_a_file_of_a_later_version_is_not_read(void **state)
{
	static const uint8_t later[] = {0x49, 0x4D, 0x55, 0x39, 0x53, 0x54, 0x4F, 0x52, 0x05, 0x00, 0x00, 0x00, 0x18,
		0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
		0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x74, 0x4A, 0x72, 0xF3};
	struct store_image back;

	(void)state;
	assert_int_equal(store_decode(&back, later, sizeof(later)), -ENOTSUP);
	write_bytes(later, sizeof(later)); /* it is kept for that version */
	assert_int_equal(store_read(&back, path), -ENOTSUP);
	assert_false(exists(path));
	assert_int_equal(unlink(bad_path), 0);
}

static void test_while_the_thread_writes_it_takes_nothing_else(void **state)
{
	static struct store_writer writer;
	const struct store_image first = example(3, 10), second = example(4, 20);
	struct store_image back;
	uint8_t bytes[STORE_FILE_MAX];

	(void)state;
	assert_int_equal(store_writer_open(&writer, path), 0);
	assert_false(store_writer_busy(&writer));
	waits = true;
	assert_int_equal(store_writer_submit(&writer, bytes, store_encode(&first, bytes)), 0);
	assert_true(store_writer_busy(&writer));
	assert_int_equal(store_writer_submit(&writer, bytes, store_encode(&second, bytes)), -EBUSY);
	waits = false;
	struct pollfd p = {.fd = writer.fd, .events = POLLIN};
	assert_int_equal(poll(&p, 1, 120000), 1);
	assert_int_equal(store_writer_result(&writer), 0);
	assert_int_equal(store_writer_result(&writer), -EAGAIN); /* told once */
	assert_int_equal(store_read(&back, path), 0);
	assert_same(&first, &back);
	assert_int_equal(
		store_writer_submit(&writer, bytes, store_encode(&second, bytes)), 0); /* it waits, and wakes */
	assert_int_equal(poll(&p, 1, 120000), 1);
	store_writer_close(&writer);
	assert_int_equal(store_read(&back, path), 0);
	assert_same(&second, &back);
}

static void test_closing_waits_for_a_write_in_progress(void **state)
{
	static struct store_writer writer;
	const struct store_image image = example(3, 10);
	struct store_image back;
	uint8_t bytes[STORE_FILE_MAX];

	(void)state;
	assert_int_equal(store_writer_open(&writer, path), 0);
	assert_int_equal(store_writer_submit(&writer, bytes, store_encode(&image, bytes)), 0);
	store_writer_close(&writer);
	assert_int_equal(store_read(&back, path), 0);
	assert_same(&image, &back);
}

#define TEST(f) cmocka_unit_test_setup_teardown(f, make_folder, remove_folder)

int main(void)
{
	const struct CMUnitTest tests[] = {
		TEST(test_what_is_written_is_read_back),
		cmocka_unit_test(test_the_largest_image_fits_the_file),
		TEST(test_no_file_yet_means_nothing_stored),
		TEST(test_every_truncation_is_detected_and_the_file_is_kept_as_bad),
		cmocka_unit_test(test_every_flipped_bit_is_detected),
		TEST(test_a_file_that_cannot_be_read_is_told_and_stays),
		TEST(test_the_longest_path_can_be_stored),
		TEST(test_without_a_descriptor_the_store_is_not_open_and_its_lock_is_free),
		TEST(test_without_a_thread_the_store_is_not_open_and_its_lock_is_free),
		TEST(test_a_power_cut_during_a_write_keeps_the_old_values),
		TEST(test_a_bad_file_is_never_overwritten),
		TEST(test_of_more_than_a_hundred_bad_files_the_last_one_stays),
		TEST(test_a_store_that_is_not_a_regular_file_is_told_and_replaced_by_one),
		TEST(test_a_lock_that_is_a_link_is_not_followed),
		TEST(test_a_folder_that_is_not_synced_leaves_the_new_file_and_says_so),
		TEST(test_a_file_that_is_not_synced_is_an_error_and_the_old_one_stays),
		TEST(test_a_disk_that_takes_bytes_one_by_one_gets_all_and_one_that_takes_none_is_full),
		cmocka_unit_test(test_a_folder_that_cannot_be_written_is_an_error),
		TEST(test_the_thread_creates_the_folder_writes_and_signals_the_end),
		TEST(test_the_result_of_a_write_is_that_of_the_disk),
		TEST(test_one_file_has_one_writer),
		cmocka_unit_test(test_node_id_and_bit_rate_of_lss_are_read_back_and_initially_none),
		cmocka_unit_test(test_an_invalid_node_id_is_damage),
		cmocka_unit_test(test_groups_that_do_not_fill_the_file_are_damage),
		cmocka_unit_test(test_a_file_of_version_1_is_read),
		cmocka_unit_test(test_a_file_of_version_2_is_read),
		cmocka_unit_test(test_a_file_of_version_3_has_the_revision_of_its_values),
		cmocka_unit_test(test_a_file_of_version_4_has_the_key_of_the_write_lock),
		TEST(test_a_file_of_a_later_version_is_not_read),
		TEST(test_while_the_thread_writes_it_takes_nothing_else),
		TEST(test_closing_waits_for_a_write_in_progress),
	};

	umask(022);
	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}
