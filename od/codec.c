/* od/codec.c
 * Stored values as a concise DCF (CiA 302-3). */
#include "od/od.h"

#include <errno.h>
#include <string.h>

#include "od/wire.h"

enum {
	COUNT_SIZE = 4,
	HEAD_SIZE = 2 + 1 + 4, /* index, sub-index, size of the data */
};

long od_encode(const struct od *od, enum od_group group, const void *base, uint8_t *out, size_t capacity)
{
	const uint8_t *values = od->values, *base_values = base;
	uint8_t value[OD_VALUE_MAX];
	size_t used = COUNT_SIZE;
	uint32_t count = 0;

	if (capacity < COUNT_SIZE)
		return -ENOSPC;
	for (size_t i = 0; i < od->table->count; i++) {
		const struct od_entry *entry = &od->table->entries[i];
		size_t size;

		if (!(entry->access & OD_STORED) || (group != OD_GROUP_ALL && group != od_group_of(entry->index)))
			continue;
		if (!memcmp(values + entry->offset, base_values + entry->offset, entry->size))
			continue;
		size = od_get(od, entry, value, sizeof(value));
		if (capacity - used < HEAD_SIZE + size)
			return -ENOSPC;
		wire_put(out + used, entry->index, 2);
		wire_put(out + used + 2, entry->sub, 1);
		wire_put(out + used + 3, size, 4);
		memcpy(out + used + HEAD_SIZE, value, size);
		used += HEAD_SIZE + size;
		count++;
	}
	wire_put(out, count, COUNT_SIZE);
	return (long)used;
}

/* The bytes are what a count of entries says, neither more nor less. */
static bool is_concise_dcf(const uint8_t *in, size_t size)
{
	size_t used = COUNT_SIZE;
	uint64_t count;

	if (size < COUNT_SIZE)
		return false;
	for (count = wire_get(in, COUNT_SIZE); count && size - used >= HEAD_SIZE; count--) {
		uint64_t length = wire_get(in + used + 3, 4);

		used += HEAD_SIZE;
		if (length > size - used)
			return false;
		used += length;
	}
	return count == 0 && used == size;
}

long od_decode(struct od *od, const uint8_t *in, size_t size, size_t *skipped)
{
	size_t used = COUNT_SIZE;
	long applied = 0;

	*skipped = 0;
	if (!is_concise_dcf(in, size))
		return -EINVAL;
	while (used < size) {
		uint16_t index = (uint16_t)wire_get(in + used, 2);
		size_t length = (size_t)wire_get(in + used + 3, 4);
		const struct od_entry *entry = od_find(od->table, index, in[used + 2], NULL);

		used += HEAD_SIZE;
		if (entry && (entry->access & OD_STORED) && od_put(od, entry, in + used, length) == OD_OK)
			applied++;
		else
			(*skipped)++;
		used += length;
	}
	return applied;
}
