#include "gateway/store.h"

#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "od/little_endian.h"

static const uint8_t magic[8] = {'I', 'M', 'U', '9', 'S', 'T', 'O', 'R'};
enum { VERSION = 4, VERSION_WITHOUT_LOCK = 3, VERSION_WITHOUT_REVISION = 2, VERSION_WITHOUT_LSS = 1 };
enum { HEADER_SIZE = sizeof(magic) + 8, LSS_SIZE = 8, REVISION_SIZE = 4, LOCK_SIZE = 4, CRC_SIZE = 4 };

struct store_group *store_group(struct store_image *image, enum od_group group)
{
	assert(group >= OD_GROUP_COMMUNICATION && group <= OD_GROUP_MANUFACTURER);
	return &image->groups[group - OD_GROUP_COMMUNICATION];
}

size_t store_encode(const struct store_image *image, uint8_t *out)
{
	size_t n = HEADER_SIZE;

	for (int i = 0; i < STORE_GROUPS; i++) {
		const struct store_group *g = &image->groups[i];

		put_u32(out + n, (uint32_t)g->size);
		memcpy(out + n + 4, g->dcf, g->size);
		n += 4 + g->size;
	}
	put_u32(out + n, image->lss.node_id);
	put_u32(out + n + 4, image->lss.bit_s);
	n += LSS_SIZE;
	put_u32(out + n, image->revision);
	n += REVISION_SIZE;
	if (image->lock_key) { /* an earlier version of the gateway can read the others */
		put_u32(out + n, image->lock_key);
		n += LOCK_SIZE;
	}
	memcpy(out, magic, sizeof(magic));
	put_u32(out + 8, image->lock_key ? VERSION : VERSION_WITHOUT_LOCK);
	put_u32(out + 12, (uint32_t)(n - HEADER_SIZE));
	put_u32(out + n, od_crc32(0, out, n));
	return n + CRC_SIZE;
}

/* False unless the groups fill `size` exactly. */
static bool decode_groups(struct store_image *image, const uint8_t *in, size_t size)
{
	for (int i = 0; i < STORE_GROUPS; i++) {
		if (size < 4)
			return false;
		size_t n = get_u32(in);
		if (n > STORE_GROUP_MAX || n > size - 4)
			return false;
		memcpy(image->groups[i].dcf, in + 4, n);
		image->groups[i].size = n;
		in += 4 + n;
		size -= 4 + n;
	}
	return size == 0;
}

static bool decode_lss(struct store_lss *lss, const uint8_t *in)
{
	uint32_t node_id = get_u32(in);

	if (node_id > 127 && node_id != 255)
		return false;
	*lss = (struct store_lss){.node_id = (uint8_t)node_id, .bit_s = get_u32(in + 4)};
	return true;
}

/* Between header and CRC: the groups, and what later versions append. */
static bool decode_body(struct store_image *image, const uint8_t *in, size_t size, uint32_t version)
{
	const size_t lss = version > VERSION_WITHOUT_LSS ? LSS_SIZE : 0;
	const size_t revision = version > VERSION_WITHOUT_REVISION ? REVISION_SIZE : 0;
	const size_t lock = version > VERSION_WITHOUT_LOCK ? LOCK_SIZE : 0, appended = lss + revision + lock;

	if (size < appended)
		return false;
	const uint8_t *tail = in + size - appended;
	if (revision)
		image->revision = get_u32(tail + lss);
	if (lock)
		image->lock_key = get_u32(tail + lss + revision);
	return decode_groups(image, in, size - appended) && (!lss || decode_lss(&image->lss, tail));
}

int store_decode(struct store_image *image, const uint8_t *in, size_t size)
{
	*image = (struct store_image){0};
	if (size < HEADER_SIZE + CRC_SIZE || memcmp(in, magic, sizeof(magic)) != 0)
		return -EBADMSG;
	if (get_u32(in + size - CRC_SIZE) != od_crc32(0, in, size - CRC_SIZE))
		return -EBADMSG;
	uint32_t version = get_u32(in + 8);
	if (version < VERSION_WITHOUT_LSS || version > VERSION)
		return -ENOTSUP;
	if (get_u32(in + 12) != size - HEADER_SIZE - CRC_SIZE ||
		!decode_body(image, in + HEADER_SIZE, size - HEADER_SIZE - CRC_SIZE, version)) {
		*image = (struct store_image){0};
		return -EBADMSG;
	}
	return 0;
}

/* ---- the file ---------------------------------------------------------------------------------------------------- */

/* Nothing that is not a regular file: a FIFO or a device would block, a symbolic link is another's file. */
static int open_regular(const char *path, int flags)
{
	struct stat status;
	int fd = open(path, flags | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC, 0644);

	if (fd < 0)
		return -errno;
	int rc = fstat(fd, &status) < 0 ? -errno : S_ISREG(status.st_mode) ? fd : -EINVAL;
	if (rc < 0)
		close(fd);
	return rc;
}

static bool exists(const char *path)
{
	struct stat status;

	return lstat(path, &status) == 0 || errno != ENOENT;
}

/* An earlier one may be all that is left of somebody's configuration. */
static void keep_as_bad(const char *path)
{
	char bad[STORE_PATH_MAX + 8];

	snprintf(bad, sizeof(bad), "%s.bad", path);
	for (int n = 1; n < 100 && exists(bad); n++)
		snprintf(bad, sizeof(bad), "%s.bad.%d", path, n);
	if (!exists(bad))
		rename(path, bad);
}

static ssize_t read_all(int fd, uint8_t *bytes, size_t capacity)
{
	size_t size = 0;
	ssize_t n = 1;

	while (size < capacity && n != 0) {
		n = read(fd, bytes + size, capacity - size);
		if (n < 0 && errno != EINTR)
			return -errno;
		size += n > 0 ? (size_t)n : 0;
	}
	return (ssize_t)size;
}

int store_read(struct store_image *image, const char *path)
{
	uint8_t bytes[STORE_FILE_MAX + 1];
	int fd = open_regular(path, O_RDONLY);

	*image = (struct store_image){0};
	if (fd < 0)
		return fd == -ENOENT ? 0 : fd;
	ssize_t size = read_all(fd, bytes, sizeof(bytes));
	close(fd);
	if (size < 0)
		return (int)size;
	int rc = store_decode(image, bytes, (size_t)size);
	if (rc == -EBADMSG || rc == -ENOTSUP)
		keep_as_bad(path);
	return rc;
}

static int write_all(int fd, const uint8_t *bytes, size_t size)
{
	while (size > 0) {
		ssize_t n = write(fd, bytes, size);

		if (n < 0 && errno == EINTR)
			continue;
		if (n <= 0)
			return n < 0 ? -errno : -ENOSPC;
		bytes += n;
		size -= (size_t)n;
	}
	return fsync(fd) < 0 ? -errno : 0;
}

/* A rename is durable only when its folder is synced, too. Some file systems cannot: EINVAL. */
static int sync_folder_of(const char *path)
{
	char folder[STORE_PATH_MAX];
	const char *slash = strrchr(path, '/');

	snprintf(folder, sizeof(folder), "%.*s", slash ? (int)(slash - path + 1) : 1, slash ? path : ".");
	int fd = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
	if (fd < 0)
		return -errno;
	int rc = fsync(fd) < 0 && errno != EINVAL ? -errno : 0;
	close(fd);
	return rc;
}

int store_write(const char *path, const uint8_t *bytes, size_t size)
{
	char temp[STORE_PATH_MAX + 8];

	snprintf(temp, sizeof(temp), "%s.new", path);
	unlink(temp); /* of a power cut; whatever else has the name is not followed or opened */
	int fd = open_regular(temp, O_WRONLY | O_CREAT | O_EXCL);
	if (fd < 0)
		return fd;
	int rc = write_all(fd, bytes, size);
	if (close(fd) < 0 && rc == 0)
		rc = -errno;
	if (rc == 0 && rename(temp, path) < 0)
		rc = -errno;
	if (rc == 0)
		return -sync_folder_of(path);
	unlink(temp);
	return rc;
}

/* ---- the thread -------------------------------------------------------------------------------------------------- */

static void *writer_main(void *arg)
{
	struct store_writer *w = arg;

	pthread_mutex_lock(&w->lock);
	for (;;) {
		while (!w->busy && !w->quit)
			pthread_cond_wait(&w->wake, &w->lock);
		if (!w->busy)
			break;
		pthread_mutex_unlock(&w->lock);
		int rc = store_write(w->path, w->bytes, w->size); /* store_writer_submit() changes neither while busy */
		pthread_mutex_lock(&w->lock);
		w->result = rc;
		w->busy = false;
		eventfd_write(w->fd, 1);
	}
	pthread_mutex_unlock(&w->lock);
	return NULL;
}

static int make_folders(const char *path)
{
	char folder[STORE_PATH_MAX];

	snprintf(folder, sizeof(folder), "%s", path);
	for (char *p = folder + 1; (p = strchr(p, '/')) != NULL; *p++ = '/') {
		*p = '\0';
		if (mkdir(folder, 0755) < 0 && errno != EEXIST)
			return -errno;
	}
	return 0;
}

/* The kernel releases the lock however the process ends. */
static int lock_path(const char *path)
{
	char name[STORE_PATH_MAX + 8];

	snprintf(name, sizeof(name), "%s.lock", path);
	int fd = open_regular(name, O_RDWR | O_CREAT);
	if (fd < 0)
		return fd;
	if (flock(fd, LOCK_EX | LOCK_NB) == 0)
		return fd;
	int rc = errno == EWOULDBLOCK ? -EADDRINUSE : -errno;
	close(fd);
	return rc;
}

int store_writer_open(struct store_writer *w, const char *path)
{
	*w = (struct store_writer){.fd = -1, .lock_fd = -1};
	if (strlen(path) >= sizeof(w->path))
		return -ENAMETOOLONG;
	strcpy(w->path, path);
	int rc = make_folders(path);
	if (rc < 0)
		return rc;
	w->lock_fd = lock_path(path);
	if (w->lock_fd < 0)
		return w->lock_fd;
	w->fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
	if (w->fd < 0) {
		rc = -errno;
		close(w->lock_fd);
		return rc;
	}
	pthread_mutex_init(&w->lock, NULL);
	pthread_cond_init(&w->wake, NULL);
	rc = pthread_create(&w->thread, NULL, writer_main, w);
	if (rc != 0) {
		close(w->fd);
		close(w->lock_fd);
		w->fd = -1;
	}
	return -rc;
}

int store_writer_submit(struct store_writer *w, const uint8_t *bytes, size_t size)
{
	int rc = -EBUSY;

	assert(size <= sizeof(w->bytes));
	pthread_mutex_lock(&w->lock);
	if (!w->busy) {
		memcpy(w->bytes, bytes, size);
		w->size = size;
		w->busy = true;
		pthread_cond_signal(&w->wake);
		rc = 0;
	}
	pthread_mutex_unlock(&w->lock);
	return rc;
}

int store_writer_result(struct store_writer *w)
{
	eventfd_t ended;

	if (eventfd_read(w->fd, &ended) < 0)
		return -EAGAIN;
	pthread_mutex_lock(&w->lock);
	int rc = w->result;
	pthread_mutex_unlock(&w->lock);
	return rc;
}

bool store_writer_busy(struct store_writer *w)
{
	pthread_mutex_lock(&w->lock);
	bool busy = w->busy;
	pthread_mutex_unlock(&w->lock);
	return busy;
}

void store_writer_close(struct store_writer *w)
{
	if (w->fd < 0)
		return;
	pthread_mutex_lock(&w->lock);
	w->quit = true;
	pthread_cond_signal(&w->wake);
	pthread_mutex_unlock(&w->lock);
	pthread_join(w->thread, NULL);
	pthread_mutex_destroy(&w->lock);
	pthread_cond_destroy(&w->wake);
	close(w->lock_fd);
	close(w->fd);
	w->fd = -1;
}
