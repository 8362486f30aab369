/* gateway/canopen/crc16.h
 * The CRC of SDO block transfers (CiA 301, 7.2.4.3.16): x^16 + x^12 + x^5 + 1, most significant bit first, initial
 * value 0. "123456789" gives 31C3h. */
#ifndef GATEWAY_CANOPEN_CRC16_H
#define GATEWAY_CANOPEN_CRC16_H

#include <stddef.h>
#include <stdint.h>

/** The CRC of the bytes so far, whose CRC is `crc` (0 to begin with), and of `data`. */
uint16_t canopen_crc16(uint16_t crc, const uint8_t *data, size_t size);

#endif
