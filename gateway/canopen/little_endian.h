/* gateway/canopen/little_endian.h
 * Numbers in the byte order of CANopen, which the store has, too, whatever the host's. */
#ifndef GATEWAY_CANOPEN_LITTLE_ENDIAN_H
#define GATEWAY_CANOPEN_LITTLE_ENDIAN_H

#include <stdint.h>

static inline uint16_t get_u16(const uint8_t *wire)
{
	return (uint16_t)(wire[0] | wire[1] << 8);
}

static inline uint32_t get_u32(const uint8_t *wire)
{
	return get_u16(wire) | (uint32_t)get_u16(wire + 2) << 16;
}

static inline void put_u16(uint8_t *wire, uint16_t value)
{
	wire[0] = (uint8_t)value;
	wire[1] = (uint8_t)(value >> 8);
}

static inline void put_u32(uint8_t *wire, uint32_t value)
{
	put_u16(wire, (uint16_t)value);
	put_u16(wire + 2, (uint16_t)(value >> 16));
}

#endif
