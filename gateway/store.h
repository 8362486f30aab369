/* gateway/store.h
 * The file that 1010h and LSS keep, safe against power cuts. The codec is pure. The file is written whole beside the old one,
 * synced, and renamed over it: at any moment either the old or the new values are complete.
 *
 * File, little-endian: "IMU9STOR"; u32 version of the format; u32 size of what follows up to the CRC; for each group 2 to 4 a
 * u32 size and a concise DCF (od_encode()); u32 node-ID and u32 bit rate of LSS, 0: none (since version 2); u32 revision of
 * the objects (since version 3); u32 CRC-32 of all before. */
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
		uint8_t node_id; /* 1..127; 255: to wait for one; 0: nothing stored */
		uint32_t bit_s;	 /* 0: nothing stored */
	} lss;
	/* 1018h:3 of the gateway that stored: which meaning the values have. 0: not known, stored before 0.3.0 */
	uint32_t revision;
};

/** The group's place in the image; group is OD_GROUP_COMMUNICATION, _APPLICATION or _MANUFACTURER.
 */
struct store_group *store_group(struct store_image *image, enum od_group group);

/** Bytes written into out[STORE_FILE_MAX]. */
size_t store_encode(const struct store_image *image, uint8_t *out);
/** All versions of the format. 0; -EBADMSG: truncated, CRC or layout wrong; -ENOTSUP: a later version of the format. *image
 * is then empty. */
int store_decode(struct store_image *image, const uint8_t *in, size_t size);

/** 0 and the image (empty when there is no file yet); -EBADMSG or -ENOTSUP: the file is damaged,
 * and has been renamed to PATH.bad so that nothing is lost; other -errno: it cannot be read. */
int store_read(struct store_image *image, const char *path);
/** Blocks until the disk has it. 0 or -errno; then the old file stands. */
int store_write(const char *path, const uint8_t *bytes, size_t size);

/** A thread that does the blocking store_write(); `fd` becomes readable when one has ended. */
struct store_writer {
	int fd;
	int claim; /* PATH.lock, held as long as the writer is open */
	char path[STORE_PATH_MAX];
	pthread_t thread;
	pthread_mutex_t lock;
	pthread_cond_t wake;
	bool busy, quit;
	int result;
	uint8_t bytes[STORE_FILE_MAX];
	size_t size;
};

/** Makes the folder of `path` where it lacks. 0; -EADDRINUSE: another process stores there; other -errno. */
int store_writer_open(struct store_writer *w, const char *path);
/** 0: under way; -EBUSY: one is under way already. Copies the bytes. */
int store_writer_submit(struct store_writer *w, const uint8_t *bytes, size_t size);
/** After fd became readable: the result of store_write(). -EAGAIN: none has ended. */
int store_writer_result(struct store_writer *w);
/** Waits for a write under way. */
void store_writer_close(struct store_writer *w);

#endif
