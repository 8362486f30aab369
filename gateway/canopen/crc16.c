#include "gateway/canopen/crc16.h"

/* Four bits at a time: the remainders of 0h..Fh. */
uint16_t canopen_crc16(uint16_t crc, const uint8_t *data, size_t size)
{
	static const uint16_t remainder[16] = {0x0000, 0x1021, 0x2042, 0x3063, 0x4084, 0x50A5, 0x60C6, 0x70E7, 0x8108,
		0x9129, 0xA14A, 0xB16B, 0xC18C, 0xD1AD, 0xE1CE, 0xF1EF};

	for (size_t i = 0; i < size; i++) {
		crc = (uint16_t)(crc << 4 ^ remainder[crc >> 12 ^ data[i] >> 4]);
		crc = (uint16_t)(crc << 4 ^ remainder[crc >> 12 ^ (data[i] & 15)]);
	}
	return crc;
}
