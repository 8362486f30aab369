#include "tools/fleet/ring.h"

#include <assert.h>
#include <errno.h>
#include <stdlib.h>
#include <sys/eventfd.h>
#include <unistd.h>

enum { LENGTH_BYTES = 4 };

int ring_open(struct ring *ring, size_t capacity)
{
	assert(capacity > 0 && (capacity & (capacity - 1)) == 0);
	*ring = (struct ring){
		.fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK), .bytes = malloc(capacity), .capacity = capacity};
	if (ring->fd >= 0 && ring->bytes)
		return 0;
	int error = ring->fd < 0 ? errno : ENOMEM;
	ring_close(ring);
	return -error;
}

void ring_close(struct ring *ring)
{
	if (ring->fd >= 0)
		close(ring->fd);
	free(ring->bytes);
	ring->bytes = NULL;
	ring->fd = -1;
}

static void copy_in(struct ring *ring, size_t at, const uint8_t *from, size_t size)
{
	for (size_t i = 0; i < size; i++)
		ring->bytes[(at + i) & (ring->capacity - 1)] = from[i];
}

static void copy_out(const struct ring *ring, size_t at, uint8_t *to, size_t size)
{
	for (size_t i = 0; i < size; i++)
		to[i] = ring->bytes[(at + i) & (ring->capacity - 1)];
}

bool ring_put(struct ring *ring, const void *message, size_t size)
{
	size_t head = atomic_load_explicit(&ring->head, memory_order_relaxed);
	size_t used = head - atomic_load_explicit(&ring->tail, memory_order_acquire);
	uint8_t length[LENGTH_BYTES] = {
		(uint8_t)size, (uint8_t)(size >> 8), (uint8_t)(size >> 16), (uint8_t)(size >> 24)};
	const uint64_t one = 1;

	if (ring->capacity - used < size + LENGTH_BYTES) {
		atomic_fetch_add(&ring->dropped, 1);
		return false;
	}
	copy_in(ring, head, length, sizeof(length));
	copy_in(ring, head + LENGTH_BYTES, message, size);
	atomic_store_explicit(&ring->head, head + LENGTH_BYTES + size, memory_order_release);
	return write(ring->fd, &one, sizeof(one)) == sizeof(one) || errno == EAGAIN; /* full: it is readable */
}

size_t ring_get(struct ring *ring, void *message, size_t capacity)
{
	size_t tail = atomic_load_explicit(&ring->tail, memory_order_relaxed);
	uint8_t length[LENGTH_BYTES];

	if (tail == atomic_load_explicit(&ring->head, memory_order_acquire))
		return 0;
	copy_out(ring, tail, length, sizeof(length));
	size_t size = length[0] | (size_t)length[1] << 8 | (size_t)length[2] << 16 | (size_t)length[3] << 24;
	assert(size <= capacity);
	copy_out(ring, tail + LENGTH_BYTES, message, size);
	atomic_store_explicit(&ring->tail, tail + LENGTH_BYTES + size, memory_order_release);
	return size;
}

void ring_clear(struct ring *ring)
{
	uint64_t count;

	if (read(ring->fd, &count, sizeof(count)) < 0)
		return; /* nothing was put */
}
