/* od/codec.c
 * Stored values as a concise DCF (CiA 302-3). */
#include "od/od.h"

#include <errno.h>
#include <string.h>

#include "od/little_endian.h"

enum {
	COUNT_SIZE = 4,
	HEAD_SIZE = 2 + 1 + 4, /* index, sub-index, size of the data */
};

bool od_dcf_add(uint8_t *out, size_t capacity, size_t *used, const struct od_dcf_item *item)
{
	size_t from = *used ? *used : COUNT_SIZE;

	if (capacity < from || capacity - from < HEAD_SIZE || capacity - from - HEAD_SIZE < item->size)
		return false;
	if (!*used)
		put_uint(out, 0, COUNT_SIZE);
	put_uint(out, get_uint(out, COUNT_SIZE) + 1, COUNT_SIZE);
	put_uint(out + from, item->index, 2);
	put_uint(out + from + 2, item->sub, 1);
	put_uint(out + from + 3, item->size, 4);
	if (item->size)
		memcpy(out + from + HEAD_SIZE, item->data, item->size);
	*used = from + HEAD_SIZE + item->size;
	return true;
}

long od_encode(const struct od *od, enum od_group group, const void *base, uint8_t *out, size_t capacity)
{
	const uint8_t *values = od->values, *base_values = base;
	uint8_t value[OD_VALUE_MAX];
	size_t used = 0;

	if (capacity < COUNT_SIZE)
		return -ENOSPC;
	put_uint(out, 0, COUNT_SIZE);
	for (size_t i = 0; i < od->table->count; i++) {
		const struct od_entry *entry = &od->table->entries[i];
		struct od_dcf_item item = {.index = entry->index, .sub = entry->sub, .data = value};

		if (!(entry->access & OD_STORED) || (group != OD_GROUP_ALL && group != od_group_of(entry->index)))
			continue;
		if (!memcmp(values + entry->offset, base_values + entry->offset, entry->size))
			continue;
		item.size = od_get(od, entry, value, sizeof(value));
		if (!od_dcf_add(out, capacity, &used, &item))
			return -ENOSPC;
	}
	return used ? (long)used : COUNT_SIZE;
}

bool od_dcf_valid(const uint8_t *in, size_t size)
{
	size_t used = COUNT_SIZE;
	uint64_t count;

	if (size < COUNT_SIZE)
		return false;
	for (count = get_uint(in, COUNT_SIZE); count && size - used >= HEAD_SIZE; count--) {
		uint64_t length = get_uint(in + used + 3, 4);

		used += HEAD_SIZE;
		if (length > size - used)
			return false;
		used += (size_t)length;
	}
	return count == 0 && used == size;
}

bool od_dcf_next(const uint8_t *in, size_t size, size_t *used, struct od_dcf_item *item)
{
	size_t from = *used ? *used : COUNT_SIZE;

	if (from >= size)
		return false;
	*item = (struct od_dcf_item){.index = (uint16_t)get_uint(in + from, 2),
		.sub = in[from + 2],
		.size = (size_t)get_uint(in + from + 3, 4),
		.data = in + from + HEAD_SIZE};
	*used = from + HEAD_SIZE + item->size;
	return true;
}

long od_decode(struct od *od, const uint8_t *in, size_t size, size_t *skipped)
{
	struct od_dcf_item item;
	size_t used = 0;
	long applied = 0;

	*skipped = 0;
	if (!od_dcf_valid(in, size))
		return -EINVAL;
	while (od_dcf_next(in, size, &used, &item)) {
		const struct od_entry *entry = od_find(od->table, item.index, item.sub, NULL);

		if (entry && (entry->access & OD_STORED) && od_put(od, entry, item.data, item.size) == OD_OK)
			applied++;
		else
			(*skipped)++;
	}
	return applied;
}
