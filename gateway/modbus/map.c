#include "gateway/modbus/map.h"

#include <string.h>

#include "od/little_endian.h"

enum { REGISTER_BYTES = 2 };

static bool is_text(const struct od_entry *entry)
{
	return entry->type == OD_VISIBLE_STRING || entry->type == OD_OCTET_STRING;
}

static bool is_signed(const struct od_entry *entry)
{
	return entry->type == OD_INTEGER8;
}

/* ---- registers --------------------------------------------------------------------------------------------------- */

/* The point that has the register, or NULL. */
static const struct modbus_point *find_point(const struct modbus_map *map, uint16_t address)
{
	unsigned low = 0, high = map->point_count;

	while (low < high) {
		unsigned middle = low + (high - low) / 2;

		if (map->points[middle].address + map->points[middle].count <= address)
			low = middle + 1;
		else
			high = middle;
	}
	return low < map->point_count && map->points[low].address <= address ? &map->points[low] : NULL;
}

/* Where word `i` of `count` is among the registers of a number; i = 0 is the least significant one. */
static unsigned place(unsigned i, unsigned count, bool low_first)
{
	return low_first ? i : count - 1 - i;
}

static void encode(const struct od *od, const struct od_entry *entry, unsigned count, bool low_first, uint8_t *out)
{
	uint8_t wire[OD_VALUE_MAX + 1] = {0};
	size_t size = od_get(od, entry, wire, OD_VALUE_MAX);

	if (is_text(entry)) {
		memcpy(out, wire, (size_t)count * REGISTER_BYTES);
		return;
	}
	if (size == 1 && is_signed(entry) && wire[0] & 0x80)
		wire[1] = 0xFF;
	for (unsigned i = 0; i < count; i++) {
		uint8_t *at = out + place(i, count, low_first) * REGISTER_BYTES;

		at[0] = wire[2 * i + 1];
		at[1] = wire[2 * i];
	}
}

enum od_status modbus_map_read(const struct modbus_map *map, const struct od *od, bool low_first, uint16_t address,
	unsigned count, uint8_t *out)
{
	uint8_t value[OD_VALUE_MAX + 2];
	unsigned done = 0;

	while (done < count) {
		unsigned at = address + done;
		const struct modbus_point *p = find_point(map, (uint16_t)at);

		if (!p)
			return OD_NO_OBJECT;
		const struct od_entry *entry = &od->table->entries[p->entry];
		if (!(entry->access & OD_READ))
			return OD_WRITE_ONLY;
		unsigned skipped = at - p->address, n = p->count - skipped;
		n = n < count - done ? n : count - done;
		encode(od, entry, p->count, low_first, value);
		memcpy(out + (size_t)done * REGISTER_BYTES, value + (size_t)skipped * REGISTER_BYTES,
			(size_t)n * REGISTER_BYTES);
		done += n;
	}
	return OD_OK;
}

/* A register holds 16 bits, the value only 8. */
static enum od_status narrow(const struct od_entry *entry, const uint8_t wire[2])
{
	if (is_signed(entry)) {
		int16_t value = (int16_t)get_u16(wire);

		return value < INT8_MIN ? OD_TOO_LOW : value > INT8_MAX ? OD_TOO_HIGH : OD_OK;
	}
	return wire[1] ? OD_TOO_HIGH : OD_OK;
}

static enum od_status decode(const uint8_t *in, unsigned count, bool low_first, struct modbus_item *item)
{
	const struct od_entry *entry = item->entry;
	uint8_t wire[OD_VALUE_MAX + 1] = {0};

	item->size = entry->size;
	if (is_text(entry)) {
		memcpy(item->wire, in, entry->size);
		if (entry->type == OD_VISIBLE_STRING)
			item->size = strnlen((const char *)item->wire, entry->size);
		return OD_OK;
	}
	for (unsigned i = 0; i < count; i++) {
		const uint8_t *at = in + place(i, count, low_first) * REGISTER_BYTES;

		wire[2 * i] = at[1];
		wire[2 * i + 1] = at[0];
	}
	memcpy(item->wire, wire, entry->size);
	return entry->size == 1 ? narrow(entry, wire) : OD_OK;
}

enum od_status modbus_map_items(const struct modbus_map *map, const struct od_table *table, bool low_first,
	uint16_t address, unsigned count, const uint8_t *in, struct modbus_item *items, unsigned *item_count)
{
	enum od_status status = OD_OK;
	unsigned done = 0, n = 0;

	while (!status && done < count) {
		const struct modbus_point *p = find_point(map, (uint16_t)(address + done));

		if (!p || p->address != address + done || p->count > count - done)
			return OD_NO_OBJECT;
		items[n].entry = &table->entries[p->entry];
		status = decode(in + (size_t)done * REGISTER_BYTES, p->count, low_first, &items[n++]);
		done += p->count;
	}
	*item_count = n;
	return status;
}

/* ---- bits -------------------------------------------------------------------------------------------------------- */

static const struct modbus_coil *find_coil(const struct modbus_map *map, unsigned address)
{
	for (unsigned i = 0; i < map->coil_count; i++)
		if (map->coils[i].address == address)
			return &map->coils[i];
	return NULL;
}

static const struct modbus_input *find_input(const struct modbus_map *map, unsigned address)
{
	for (unsigned i = 0; i < map->input_count; i++)
		if (map->inputs[i].address == address)
			return &map->inputs[i];
	return NULL;
}

static bool entry_bit(const struct od *od, uint16_t entry, unsigned bit)
{
	uint8_t wire[OD_VALUE_MAX] = {0};

	od_get(od, &od->table->entries[entry], wire, sizeof(wire));
	return wire[bit / 8] >> bit % 8 & 1;
}

enum od_status modbus_map_read_bits(const struct modbus_map *map, const struct od *od, enum modbus_bits kind,
	uint16_t address, unsigned count, uint8_t *out)
{
	for (unsigned i = 0; i < count; i++) {
		const struct modbus_coil *coil = kind == MODBUS_COILS ? find_coil(map, address + i) : NULL;
		const struct modbus_input *input = kind == MODBUS_DISCRETE_INPUTS ? find_input(map, address + i) : NULL;
		bool bit;

		if (input)
			bit = entry_bit(od, input->entry, input->bit);
		else if (coil)
			bit = !coil->command && entry_bit(od, coil->entry, 0);
		else
			return OD_NO_OBJECT;
		out[i / 8] |= (uint8_t)(bit << i % 8);
	}
	return OD_OK;
}

enum od_status modbus_map_coil_items(const struct modbus_map *map, const struct od_table *table, uint16_t address,
	unsigned count, const uint8_t *in, struct modbus_item *items, unsigned *item_count)
{
	bool commands = false;

	*item_count = 0;
	for (unsigned i = 0; i < count; i++) {
		const struct modbus_coil *coil = find_coil(map, address + i);
		bool on = in[i / 8] >> i % 8 & 1;

		if (!coil || *item_count == MODBUS_REGISTERS_MAX)
			return OD_NO_OBJECT;
		if (coil->command && !on)
			continue;
		commands |= coil->command;
		struct modbus_item *item = &items[(*item_count)++];
		item->entry = &table->entries[coil->entry];
		item->size = item->entry->size;
		put_uint(item->wire, coil->command ? coil->value : on, item->size);
	}
	return commands && *item_count > 1 ? OD_INCOMPATIBLE : OD_OK;
}
