/* gateway/record_file.h
 * The files of a recording, written by a thread of their own: DIR/imu9-000001.imu.csv and so on (record_text.h). Each
 * begins with configuration and state, so that it can be replayed without those before it. A file that has reached its
 * size is followed by another one, and the oldest is deleted. Files with the last minute before an EMCY become
 * imu9-000001.kept.imu.csv, which only later ones of that kind replace.
 *
 * A failure of the disk ends the recording (record.error), never the device. After a power cut the last line of the
 * last file may be torn, and seconds of it missing. */
#ifndef GATEWAY_RECORD_FILE_H
#define GATEWAY_RECORD_FILE_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>

#include "gateway/record.h"
#include "gateway/record_text.h"

enum { RECORD_FOLDER_MAX = 256, RECORD_FILES_MAX = 1000 };

struct record_options {
	char folder[RECORD_FOLDER_MAX];
	unsigned size_mb; /* of a file, 1..2000, default 16: about ten minutes at 100 samples a second */
	unsigned files;	  /* 2..1000, default 8; as many kept ones */
};

/** `text`: DIR[,size=MB][,files=N]. 0, or -EINVAL and one line in `why`. */
int record_options(const char *text, struct record_options *options, char *why, size_t why_size);

struct record_file {
	/* PRIVATE */
	struct record *record;
	struct record_options options;
	int folder_fd; /* locked: one process records here */
	int fd;	       /* -1: no file is open */
	size_t written;
	struct record_name {
		unsigned number;
		bool kept, ours; /* of this process, and then: */
		uint64_t began_us;
	} names[2 * RECORD_FILES_MAX + 1]; /* by number */
	size_t count;
	char buffer[1 << 16];
	size_t used;
	pthread_t thread;
	atomic_bool quit;
};

/** Without a thread, for simulated time: makes the folder, finds the files in it. 0; -EADDRINUSE: another process
 * records there; -E2BIG: more files than RECORD_FILES_MAX permits; other -errno. */
int record_file_init(struct record_file *f, struct record *record, const struct record_options *options);
/** Writes what was recorded since. */
void record_file_turn(struct record_file *f);

/** The same with a thread, that takes its turn ten times a second. */
int record_file_open(struct record_file *f, struct record *record, const struct record_options *options);
/** Writes the rest, ends the thread if there is one. */
void record_file_close(struct record_file *f);

#endif
