/* tools/fleet/spool.h
 * A queue of records on disk that survives power cuts: a ring of segment files. Records are read in the order in which
 * they were appended. After a power cut what was appended before the last spool_sync() is there, of what came after it
 * perhaps a part; a record is there as it was written or not at all. When the ring is full its oldest segment is
 * dropped, and the records in it are counted.
 *
 * Files: spool-NN.seg has a header with the number of the segment, which never repeats, and records with a CRC over
 * this number, their place and their bytes, so that old contents of a disk never pass for a record. spool.ack has what
 * was delivered, in two places that are written in turn: when the newer one is torn, the older one holds, and records
 * are delivered twice.
 *
 * One thread, which waits for the disk. Functions return 0 or a count, or -errno. */
#ifndef TOOLS_FLEET_SPOOL_H
#define TOOLS_FLEET_SPOOL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { SPOOL_SEGMENTS = 16, SPOOL_PATH_MAX = 512, SPOOL_RECORD_MAX = 1024 };

/** Behind a record. */
struct spool_position {
	uint64_t segment;
	uint32_t offset;
};

struct spool {
	uint64_t records; /* not delivered yet, now */
	uint64_t bytes;	  /* on disk, now */
	uint64_t dropped; /* not delivered, and lost with the oldest segment */
	uint64_t damaged; /* segments that ended before their size, found by spool_open() */
	uint64_t errors;  /* of the disk */

	/* PRIVATE */
	char folder[SPOOL_PATH_MAX];
	int folder_fd;
	uint32_t segment_size; /* bytes */
	struct spool_segment {
		uint64_t number;	       /* 0: none */
		uint32_t size;		       /* of what is valid */
		uint64_t records, read, acked; /* counts of its records */
	} segments[SPOOL_SEGMENTS];	       /* of number n at n % SPOOL_SEGMENTS */
	uint64_t next;			       /* number of the next segment */
	int writing;			       /* the newest segment, or -1 */
	bool unsynced, unsynced_names;
	int reading; /* of the cursor, or -1 */
	uint64_t reading_segment;
	struct spool_position cursor, acked, acked_on_disk;
	int ack_fd;
	uint64_t ack_turn;
};

/** Opens or creates the spool in a folder that exists. `bytes`: the most that the files take together, at least 64 kB.
 * -EBUSY: another process has it. */
int spool_open(struct spool *spool, const char *folder, uint64_t bytes);
/** Synchronises and closes. */
void spool_close(struct spool *spool);

/** The position behind it in *at. After an error the record is lost, and the next one begins a new segment. */
int spool_append(struct spool *spool, const void *record, size_t size, struct spool_position *at);
/** The next record that was not read. 1, or 0: there is none. */
int spool_next(struct spool *spool, void *record, size_t capacity, size_t *size, struct spool_position *at);
/** All that was appended counts as read. */
void spool_skip(struct spool *spool);
/** All up to this position was delivered. */
void spool_acked(struct spool *spool, struct spool_position at);
/** Reads again what was not delivered. */
void spool_rewind(struct spool *spool);
/** Makes durable what was appended and acked, and removes files that are delivered. Once a second. */
int spool_sync(struct spool *spool);

/** Nothing is waiting to be delivered. */
bool spool_is_empty(const struct spool *spool);

#endif
