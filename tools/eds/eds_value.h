/* tools/eds/eds_value.h — inside the EDS loader
 * Data types and the notation of their values in an EDS. */
#ifndef TOOLS_EDS_EDS_VALUE_H
#define TOOLS_EDS_EDS_VALUE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "od/od.h"

struct eds_type {
	uint8_t code;  /* CiA 301 */
	uint8_t type;  /* enum od_type used for it */
	uint16_t size; /* bytes; 0: from StringSize or the default */
	unsigned bits; /* of the value; 0: not an integer */
	bool is_signed;
	bool foreign; /* not a type of od: handled as bytes */
};

const struct eds_type *eds_type_of(uint64_t code);
bool eds_is_real(const struct eds_type *type);

/** Decimal, 0x hex or 0 octal. Hex with the full width of a signed type is two's complement. */
bool eds_parse_integer(const char *text, unsigned bits, bool is_signed, union od_number *out);
/** Decimal, or 0x and the IEEE 754 bits. Rounded to the type, so that a default can be equal to its limit. */
bool eds_parse_real(const char *text, enum od_type type, union od_number *out);
bool eds_parse_number(const char *text, const struct eds_type *type, union od_number *out);
/** "0A0BFF" or "0A 0B FF". Returns the number of bytes, or -1; `bytes` may be NULL. */
int eds_parse_octets(const char *text, uint8_t *bytes, size_t capacity);

bool eds_is_above(const struct eds_type *type, union od_number a, union od_number b);

/** Removes "$NODEID+" or "+$NODEID" from a value; `rest` is what remains. Returns whether it was present. */
bool eds_split_node_id(const char *text, char *rest, size_t capacity);

#endif
