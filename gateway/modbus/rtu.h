/* gateway/modbus/rtu.h
 * Frames of a serial line (MODBUS over Serial Line V1.02, 2.5.1): address, PDU, CRC. A frame ends with a silence, but a
 * USB adapter or a pty delivers a frame in pieces, so that a request is known by its size, too. Pure, any thread. */
#ifndef GATEWAY_MODBUS_RTU_H
#define GATEWAY_MODBUS_RTU_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { MODBUS_RTU_MAX = 256, MODBUS_RTU_BROADCAST = 0 };

/** CRC-16, reflected polynomial A001h, initial value FFFFh. 0 over a whole frame. It is sent low byte first. */
uint16_t modbus_crc(const uint8_t *bytes, size_t size);

enum modbus_rtu_result {
	MODBUS_RTU_WAIT,    /* incomplete so far */
	MODBUS_RTU_REQUEST, /* for this address, or a broadcast: the first *size bytes */
	MODBUS_RTU_DROP,    /* *size bytes belong to others */
	MODBUS_RTU_BAD,	    /* all of them are no frame */
};

/** What the `used` received bytes begin with. `silent`: nothing comes any more of this frame. */
enum modbus_rtu_result modbus_rtu_next(const uint8_t *in, size_t used, uint8_t address, bool silent, size_t *size);

#endif
