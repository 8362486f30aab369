/* od/wire.h — inside od/ only
 * Little-endian bytes to numbers and back, whatever the host's byte order. */
#ifndef OD_WIRE_H
#define OD_WIRE_H

#include <assert.h>
#include <stddef.h>
#include <stdint.h>

static inline uint64_t wire_get(const uint8_t *wire, size_t size)
{
	uint64_t value = 0;

	for (size_t i = size; i > 0; i--)
		value = value << 8 | wire[i - 1];
	return value;
}

static inline void wire_put(uint8_t *wire, uint64_t value, size_t size)
{
	for (size_t i = 0; i < size; i++, value >>= 8)
		wire[i] = (uint8_t)value;
}

/* The two's complement number of `size` bytes, 1 to 8. */
static inline int64_t wire_signed(uint64_t raw, size_t size)
{
	uint64_t sign;

	assert(size >= 1 && size <= 8);
	sign = UINT64_C(1) << (8 * size - 1);
	return (int64_t)((raw ^ sign) - sign);
}

#endif
