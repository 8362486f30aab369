/* od/od.c
 * Finds, reads and writes entries. */
#include "od/od.h"

#include <math.h>
#include <string.h>

#include "od/little_endian.h"

static bool is_string(const struct od_entry *entry)
{
	return entry->type == OD_VISIBLE_STRING || entry->type == OD_OCTET_STRING;
}

enum { NO_NODE_ID = 255 };

static uint64_t host_get(const void *host, size_t size)
{
	uint8_t u8;
	uint16_t u16;
	uint32_t u32;
	uint64_t u64;

	switch (size) {
	case 1:
		return memcpy(&u8, host, 1), u8;
	case 2:
		return memcpy(&u16, host, 2), u16;
	case 4:
		return memcpy(&u32, host, 4), u32;
	default:
		return memcpy(&u64, host, 8), u64;
	}
}

static void host_put(void *host, uint64_t value, size_t size)
{
	uint8_t u8 = (uint8_t)value;
	uint16_t u16 = (uint16_t)value;
	uint32_t u32 = (uint32_t)value;

	switch (size) {
	case 1:
		memcpy(host, &u8, 1);
		break;
	case 2:
		memcpy(host, &u16, 2);
		break;
	case 4:
		memcpy(host, &u32, 4);
		break;
	default:
		memcpy(host, &value, 8);
	}
}

static uint8_t *value_of(const struct od *od, const struct od_entry *entry)
{
	return (uint8_t *)od->values + entry->offset;
}

void od_init(struct od *od, const struct od_table *table, void *values, uint8_t node_id)
{
	*od = (struct od){.table = table, .values = values};
	memcpy(values, table->defaults, table->values_size);
	od_follow_node_id(table, values, NO_NODE_ID, node_id);
}

static unsigned node_offset(uint8_t node_id)
{
	return node_id <= 127 ? node_id : 0;
}

void od_follow_node_id(const struct od_table *table, void *values, uint8_t old, uint8_t node_id)
{
	for (size_t i = 0; i < table->count; i++) {
		const struct od_entry *entry = &table->entries[i];
		uint8_t *value = (uint8_t *)values + entry->offset;

		if (!(entry->access & OD_NODE_ID))
			continue;
		uint64_t base = host_get((const uint8_t *)table->defaults + entry->offset, entry->size);
		if (host_get(value, entry->size) == base + node_offset(old))
			host_put(value, base + node_offset(node_id), entry->size);
	}
}

void od_reset(struct od *od, enum od_group group, const void *base)
{
	for (size_t i = 0; i < od->table->count; i++) {
		const struct od_entry *entry = &od->table->entries[i];

		if (!(entry->access & OD_STORED))
			continue;
		if (group == OD_GROUP_ALL || group == od_group_of(entry->index))
			memcpy(value_of(od, entry), (const uint8_t *)base + entry->offset, entry->size);
	}
}

void od_attach(struct od *od, struct od_hook *hook)
{
	struct od_hook **end = &od->hooks;

	while (*end)
		end = &(*end)->next;
	hook->next = NULL;
	*end = hook;
}

void od_set_domain(struct od *od, struct od_domain *domain)
{
	domain->next = od->domains;
	od->domains = domain;
}

const struct od_entry *od_find(const struct od_table *table, uint16_t index, uint8_t sub, enum od_status *status)
{
	uint32_t key = (uint32_t)index << 8 | sub;
	size_t low = 0, high = table->count;
	bool object;

	while (low < high) {
		size_t middle = low + (high - low) / 2;
		const struct od_entry *entry = &table->entries[middle];

		if (((uint32_t)entry->index << 8 | entry->sub) < key)
			low = middle + 1;
		else
			high = middle;
	}
	if (low < table->count && table->entries[low].index == index && table->entries[low].sub == sub) {
		if (status)
			*status = OD_OK;
		return &table->entries[low];
	}
	object = (low < table->count && table->entries[low].index == index) ||
		 (low > 0 && table->entries[low - 1].index == index);
	if (status)
		*status = object ? OD_NO_SUBINDEX : OD_NO_OBJECT;
	return NULL;
}

enum od_group od_group_of(uint16_t index)
{
	if (index < 0x2000)
		return OD_GROUP_COMMUNICATION;
	return index < 0x6000 ? OD_GROUP_MANUFACTURER : OD_GROUP_APPLICATION;
}

size_t od_get(const struct od *od, const struct od_entry *entry, void *wire, size_t capacity)
{
	const uint8_t *from = value_of(od, entry);
	size_t size = entry->type == OD_VISIBLE_STRING ? strnlen((const char *)from, entry->size) : entry->size;

	if (size == 0 || size > capacity)
		return 0;
	if (is_string(entry))
		memcpy(wire, from, size);
	else
		put_uint(wire, host_get(from, size), size);
	return size;
}

enum od_status od_read(const struct od *od, uint16_t index, uint8_t sub, void *wire, size_t capacity, size_t *size)
{
	enum od_status status;
	const struct od_entry *entry = od_find(od->table, index, sub, &status);

	if (!entry)
		return status;
	if (!(entry->access & OD_READ))
		return OD_WRITE_ONLY;
	if (entry->type == OD_DOMAIN)
		return OD_UNSUPPORTED_ACCESS;
	if (capacity < entry->size)
		return OD_TOO_LONG;
	*size = od_get(od, entry, wire, capacity);
	return OD_OK;
}

const struct od_entry *od_resolution(const struct od_table *table, const struct od_entry *entry)
{
	return entry->resolution ? od_find(table, entry->resolution, entry->resolution_sub, NULL) : NULL;
}

double od_step(const struct od *od, const struct od_entry *entry)
{
	const struct od_entry *resolution = od_resolution(od->table, entry);
	uint8_t wire[sizeof(uint32_t)];

	if (!resolution)
		return entry->factor;
	return (double)get_uint(wire, od_get(od, resolution, wire, sizeof(wire))) * resolution->factor;
}

const struct od_domain *od_find_domain(const struct od *od, uint16_t index, uint8_t sub)
{
	for (const struct od_domain *domain = od->domains; domain; domain = domain->next)
		if (domain->index == index && domain->sub == sub)
			return domain;
	return NULL;
}

static enum od_status check_limits(const struct od_entry *entry, bool below, bool above)
{
	if ((entry->access & OD_LIMIT_LOW) && below)
		return OD_TOO_LOW;
	return (entry->access & OD_LIMIT_HIGH) && above ? OD_TOO_HIGH : OD_OK;
}

static enum od_status check_real(const struct od_entry *entry, double value)
{
	bool below = value<entry->low.f, above = value> entry->high.f;

	if (!isfinite(value))
		return OD_BAD_VALUE;
	return check_limits(entry, below, above);
}

static enum od_status check_string(const uint8_t *text, size_t size)
{
	const uint8_t *end = size ? memchr(text, '\0', size) : NULL;

	for (; end && end < text + size; end++)
		if (*end)
			return OD_BAD_VALUE; /* NUL pads a string and is not a character of it */
	return OD_OK;
}

enum od_status od_check(const struct od_entry *entry, const void *wire, size_t size)
{
	uint64_t raw;
	uint32_t low;
	float real32;
	double real64;
	int64_t value;
	bool below, above;

	if (entry->type == OD_DOMAIN)
		return OD_UNSUPPORTED_ACCESS;
	if (size > entry->size)
		return OD_TOO_LONG;
	if (entry->type == OD_VISIBLE_STRING)
		return check_string(wire, size);
	if (size < entry->size)
		return OD_TOO_SHORT;
	if (entry->type == OD_OCTET_STRING)
		return OD_OK;
	raw = get_uint(wire, size);
	switch ((enum od_type)entry->type) {
	case OD_REAL32:
		low = (uint32_t)raw;
		memcpy(&real32, &low, sizeof(real32));
		return check_real(entry, (double)real32);
	case OD_REAL64:
		memcpy(&real64, &raw, sizeof(real64));
		return check_real(entry, real64);
	case OD_INTEGER8:
	case OD_INTEGER16:
	case OD_INTEGER32:
	case OD_INTEGER64:
		value = sign_extend(raw, size);
		below = value < entry->low.i;
		above = value > entry->high.i;
		return check_limits(entry, below, above);
	case OD_BOOLEAN:
		return raw > 1 ? OD_BAD_VALUE : OD_OK;
	default:
		below = raw < entry->low.u;
		above = raw > entry->high.u;
		return check_limits(entry, below, above);
	}
}

static void set(struct od *od, const struct od_entry *entry, const void *wire, size_t size)
{
	uint8_t *to = value_of(od, entry);

	if (!is_string(entry)) {
		host_put(to, get_uint(wire, size), size);
		return;
	}
	if (size)
		memcpy(to, wire, size);
	memset(to + size, 0, entry->size - size);
}

static enum od_status write_domain(const struct od *od, const struct od_entry *entry, const void *data, size_t size)
{
	const struct od_domain *domain = od_find_domain(od, entry->index, entry->sub);

	if (!domain || !domain->write)
		return OD_UNSUPPORTED_ACCESS;
	return size > OD_DOMAIN_MAX ? OD_TOO_LONG : domain->write(domain->ctx, data, size);
}

enum od_status od_write(struct od *od, uint16_t index, uint8_t sub, const void *wire, size_t size)
{
	enum od_status status;
	const struct od_entry *entry = od_find(od->table, index, sub, &status);

	if (!entry)
		return status;
	if (!(entry->access & OD_WRITE))
		return OD_READ_ONLY;
	status = entry->type == OD_DOMAIN ? OD_OK : od_check(entry, wire, size);
	if (status)
		return status;
	for (struct od_hook *hook = od->hooks; hook; hook = hook->next) {
		if (!hook->before || index < hook->first || index > hook->last)
			continue;
		status = hook->before(hook->ctx, entry, wire, size);
		if (status)
			return status == OD_CONSUMED ? OD_OK : status;
	}
	if (entry->type == OD_DOMAIN)
		return write_domain(od, entry, wire, size);
	set(od, entry, wire, size);
	for (struct od_hook *hook = od->hooks; hook; hook = hook->next)
		if (hook->after && index >= hook->first && index <= hook->last)
			hook->after(hook->ctx, entry);
	return OD_OK;
}

enum od_status od_put(struct od *od, const struct od_entry *entry, const void *wire, size_t size)
{
	enum od_status status = entry->access & OD_CONST ? OD_READ_ONLY : od_check(entry, wire, size);

	if (!status)
		set(od, entry, wire, size);
	return status;
}

void *od_value(const struct od *od, uint16_t index, uint8_t sub, size_t size)
{
	const struct od_entry *entry = od_find(od->table, index, sub, NULL);

	return entry && entry->size == size ? value_of(od, entry) : NULL;
}
