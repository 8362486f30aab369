/* tools/fleet/ring.h
 * Hands messages from one thread to one other, in order, without a lock: the giver never waits. What does not fit is
 * dropped and counted. */
#ifndef TOOLS_FLEET_RING_H
#define TOOLS_FLEET_RING_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct ring {
	int fd; /* readable after ring_put(), until ring_clear() */
	atomic_ullong dropped;

	/* PRIVATE */
	uint8_t *bytes;
	size_t capacity;	  /* a power of two */
	atomic_size_t head, tail; /* bytes ever put, ever got */
};

/** 0, or -errno. `capacity`: bytes, a power of two; each message takes four more. */
int ring_open(struct ring *ring, size_t capacity);
void ring_close(struct ring *ring);

/** The giving thread. False: no room, which is counted. */
bool ring_put(struct ring *ring, const void *message, size_t size);

/** The taking thread. Size of the message, or 0: there is none. Messages fit into `capacity` bytes. */
size_t ring_get(struct ring *ring, void *message, size_t capacity);
/** Before ring_get() until that returns 0. */
void ring_clear(struct ring *ring);

#endif
