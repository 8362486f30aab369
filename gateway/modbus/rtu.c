#include "gateway/modbus/rtu.h"

#include "gateway/modbus/pdu.h"

enum { FRAME_MIN = 4, AROUND_PDU = 3 };

uint16_t modbus_crc(const uint8_t *bytes, size_t size)
{
	unsigned crc = 0xFFFF;

	for (size_t i = 0; i < size; i++) {
		crc ^= bytes[i];
		for (int bit = 0; bit < 8; bit++)
			crc = crc & 1 ? crc >> 1 ^ 0xA001 : crc >> 1;
	}
	return (uint16_t)crc;
}

/* A frame of others, requests or responses, ends where the CRC fits. */
static enum modbus_rtu_result others(const uint8_t *in, size_t used, bool silent, size_t *size)
{
	for (*size = FRAME_MIN; *size <= used; ++*size)
		if (modbus_crc(in, *size) == 0)
			return MODBUS_RTU_DROP;
	*size = used;
	return silent || used == MODBUS_RTU_MAX ? MODBUS_RTU_DROP : MODBUS_RTU_WAIT;
}

enum modbus_rtu_result modbus_rtu_next(const uint8_t *in, size_t used, uint8_t address, bool silent, size_t *size)
{
	if (in[0] != address && in[0] != MODBUS_RTU_BROADCAST)
		return others(in, used, silent, size);
	int pdu = modbus_pdu_size(in + 1, used > AROUND_PDU ? used - AROUND_PDU : 0);
	*size = pdu > 0 ? (size_t)pdu + AROUND_PDU : used;
	if (*size > MODBUS_RTU_MAX)
		return MODBUS_RTU_BAD;
	if (*size > used || pdu == 0 || (pdu < 0 && !silent))
		return silent || used == MODBUS_RTU_MAX ? MODBUS_RTU_BAD : MODBUS_RTU_WAIT;
	return *size >= FRAME_MIN && modbus_crc(in, *size) == 0 ? MODBUS_RTU_REQUEST : MODBUS_RTU_BAD;
}
