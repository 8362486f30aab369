/* gateway/modbus/map.h
 * The map of registers, coils and discrete inputs, generated from the EDS (tools/eds/modbus_map.c has its rules), and
 * what it makes of the values of a dictionary. Input and holding registers are the same registers. Pure, any thread.
 *
 * Values of 8 and 16 bits have one register (of 8 bits: extended), of 32 bits two, of 64 bits four: the most
 * significant one first, or the least significant one when `low_first`. Strings have two characters in each, padded
 * with 0. */
#ifndef GATEWAY_MODBUS_MAP_H
#define GATEWAY_MODBUS_MAP_H

#include <stdbool.h>
#include <stdint.h>

#include "gateway/modbus/pdu.h"
#include "od/od.h"

/** Registers of one entry of the dictionary. */
struct modbus_point {
	uint16_t address, count;
	uint16_t entry; /* number in od_table.entries */
};

/** A discrete input: a bit of an unsigned entry. */
struct modbus_input {
	uint16_t address, entry;
	uint8_t bit;
};

/** A coil: an entry that is 0 or 1; or a command, which reads as 0: written 1, `value` goes to the entry, and 0 does
 * nothing. */
struct modbus_coil {
	uint16_t address, entry;
	bool command;
	uint32_t value;
};

/** All sorted by address. */
struct modbus_map {
	const struct modbus_point *points;
	const struct modbus_input *inputs;
	const struct modbus_coil *coils;
	uint16_t point_count, input_count, coil_count;
	const char *vendor_name, *product_code; /* 43/14: VendorName and OrderCode of the EDS */
};

extern const struct modbus_map imu9_modbus_map;

/** For struct modbus_registers. OD_NO_OBJECT: a register or bit of the range is not in the map; OD_WRITE_ONLY. */
enum od_status modbus_map_read(const struct modbus_map *map, const struct od *od, bool low_first, uint16_t address,
	unsigned count, uint8_t *out);
enum od_status modbus_map_read_bits(const struct modbus_map *map, const struct od *od, enum modbus_bits kind,
	uint16_t address, unsigned count, uint8_t *out);

/** One value to be written. */
struct modbus_item {
	const struct od_entry *entry;
	uint8_t wire[OD_VALUE_MAX];
	size_t size;
};

/** The values that the registers or coils are. Their number in *items, at most MODBUS_REGISTERS_MAX. OD_NO_OBJECT: one
 * is not in the map, or belongs to a value that is not written as a whole. OD_TOO_HIGH, OD_TOO_LOW: it does not fit
 * into 8 bits. OD_INCOMPATIBLE: a command beside another coil that is 1: commands cannot be taken back. Values are not
 * checked against the dictionary. */
enum od_status modbus_map_items(const struct modbus_map *map, const struct od_table *table, bool low_first,
	uint16_t address, unsigned count, const uint8_t *in, struct modbus_item *items, unsigned *item_count);
enum od_status modbus_map_coil_items(const struct modbus_map *map, const struct od_table *table, uint16_t address,
	unsigned count, const uint8_t *in, struct modbus_item *items, unsigned *item_count);

#endif
