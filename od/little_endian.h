/* od/little_endian.h
 * Integers in the little-endian byte order of CANopen (CiA 301, 7.1) and of the store, whatever the host's order is.
 * The functions read and write exactly the bytes that their name or `size` says; they need no alignment. */
#ifndef OD_LITTLE_ENDIAN_H
#define OD_LITTLE_ENDIAN_H

#include <assert.h>
#include <stddef.h>
#include <stdint.h>

/** An unsigned integer of `size` bytes, 0 to 8. */
static inline uint64_t get_uint(const uint8_t *wire, size_t size)
{
	uint64_t value = 0;

	for (size_t i = size; i > 0; i--)
		value = value << 8 | wire[i - 1];
	return value;
}

/** Writes the lower `size` bytes of `value`, 0 to 8. */
static inline void put_uint(uint8_t *wire, uint64_t value, size_t size)
{
	for (size_t i = 0; i < size; i++, value >>= 8)
		wire[i] = (uint8_t)value;
}

/** The signed number whose two's complement in `size` bytes, 1 to 8, is `raw`. */
static inline int64_t sign_extend(uint64_t raw, size_t size)
{
	uint64_t sign;

	assert(size >= 1 && size <= 8);
	sign = UINT64_C(1) << (8 * size - 1);
	return (int64_t)((raw ^ sign) - sign);
}

static inline uint16_t get_u16(const uint8_t *wire)
{
	return (uint16_t)get_uint(wire, 2);
}

static inline uint32_t get_u32(const uint8_t *wire)
{
	return (uint32_t)get_uint(wire, 4);
}

static inline void put_u16(uint8_t *wire, uint16_t value)
{
	put_uint(wire, value, 2);
}

static inline void put_u32(uint8_t *wire, uint32_t value)
{
	put_uint(wire, value, 4);
}

#endif
