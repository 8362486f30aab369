/* gateway/store.h
 * The file that 1010h and LSS keep, safe against power cuts. The codec is pure. The file is written whole beside the
 * old one, synced, and renamed over it: at any moment either the old or the new values are complete.
 *
 * File, little-endian: "IMU9STOR"; u32 version of the format; u32 size of what follows up to the CRC; for each group 2
 * to 4 a u32 size and a concise DCF (od_encode()); u32 node-ID and u32 bit rate of LSS, 0: none (since version 2); u32
 * revision of the objects (since version 3); u32 key of the write lock (version 4, written only while it is locked);
 * u32 CRC-32 of all before. */
#ifndef GATEWAY_STORE_H
#define GATEWAY_STORE_H

#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "od/od.h"

enum {
	STORE_GROUPS = 3,
	STORE_GROUP_MAX = 8192,
	STORE_FILE_MAX = 64 + STORE_GROUPS * (4 + STORE_GROUP_MAX),
	STORE_PATH_MAX = 600,
};

struct store_image {
	struct store_group {
		uint8_t dcf[STORE_GROUP_MAX];
		size_t size; /* 0: nothing stored */
	} groups[STORE_GROUPS];
	struct store_lss {
		uint8_t node_id; /* 1..127; 255: unconfigured; 0: nothing stored */
		uint32_t bit_s;	 /* 0: nothing stored */
	} lss;
	/* 1018h:3 of the gateway that stored, for the meaning of the values. 0: unknown, stored before 0.3.0 */
	uint32_t revision;
	uint32_t lock_key; /* of write_lock.h; 0: open */
};

/** The group in the image: OD_GROUP_COMMUNICATION, _APPLICATION or _MANUFACTURER. */
struct store_group *store_group(struct store_image *image, enum od_group group);

/** Bytes written into out[STORE_FILE_MAX]. */
size_t store_encode(const struct store_image *image, uint8_t *out);
/** All versions of the format. 0; -EBADMSG: truncated, CRC or layout wrong; -ENOTSUP: a later version of the format.
 * *image is then empty. */
int store_decode(struct store_image *image, const uint8_t *in, size_t size);

/** 0 and the image (empty when there is no file yet); -EBADMSG or -ENOTSUP as store_decode(): the file has been renamed
 * to PATH.bad, or PATH.bad.1 to .99 if that exists, so that nothing is lost; -ELOOP: a symbolic link, -EINVAL: not a
 * regular file; other -errno: it cannot be read. Blocks. */
int store_read(struct store_image *image, const char *path);
/** Blocks until the file is on the disk. 0; -errno: the old file is unchanged; a positive errno: the new file is in its
 * place, but its folder could not be synced, so that a power cut may still bring back the old one. */
int store_write(const char *path, const uint8_t *bytes, size_t size);

/** A thread that calls store_write(). `fd` becomes readable when a write has ended. One other thread calls the
 * functions. */
struct store_writer {
	int fd;
	int lock_fd; /* PATH.lock, held as long as the writer is open */
	char path[STORE_PATH_MAX];
	pthread_t thread;
	pthread_mutex_t lock;
	pthread_cond_t wake;
	bool busy, quit;
	int result;
	uint8_t bytes[STORE_FILE_MAX];
	size_t size;
};

/** Creates the missing folders of `path`. 0; -EADDRINUSE: another process stores there; other -errno. */
int store_writer_open(struct store_writer *w, const char *path);
/** 0: in progress; -EBUSY: another write is in progress. Copies the bytes. */
int store_writer_submit(struct store_writer *w, const uint8_t *bytes, size_t size);
/** When `fd` is readable: the result of store_write(). -EAGAIN: no write has ended. */
int store_writer_result(struct store_writer *w);
/** A write is in progress. */
bool store_writer_busy(struct store_writer *w);
/** Waits for a write in progress. */
void store_writer_close(struct store_writer *w);

#endif
