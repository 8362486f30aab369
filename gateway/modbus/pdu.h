/* gateway/modbus/pdu.h
 * A request of Modbus to its response, without header or CRC (MODBUS Application Protocol Specification V1.1b3;
 * function 43/13: CANopen General Reference, CiA 309-2). Pure but for the callbacks; any one thread at a time.
 *
 * Functions: 1 to 6, 15, 16, 22, 23, 43/13 and 43/14. Others, and writes of a client that may only read, are answered
 * with exception 01. The order of checks is that of the specification: function, quantity (03), address (02),
 * values. */
#ifndef GATEWAY_MODBUS_PDU_H
#define GATEWAY_MODBUS_PDU_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "od/od.h"

enum { MODBUS_PDU_MAX = 253, MODBUS_REGISTERS_MAX = 125, MODBUS_BITS_MAX = 2000 };

enum modbus_bits { MODBUS_COILS, MODBUS_DISCRETE_INPUTS };

/** What requests read and write. Registers are two bytes, the high one first; bits are packed from bit 0 of the first
 * byte on. `address` + `count` is at most 65536. A read gets a coherent set of values; a write changes all or nothing.
 * A write that returns OD_PENDING is answered by modbus_pdu_done(). */
struct modbus_registers {
	void *ctx;
	bool read_only; /* this client may not write */
	uint8_t node_id;
	enum od_status (*read)(void *ctx, uint16_t address, unsigned count, uint8_t *out);
	enum od_status (*write)(void *ctx, uint16_t address, unsigned count, const uint8_t *in);
	/** The register becomes (old AND and_mask) OR (or_mask AND NOT and_mask). */
	enum od_status (*mask)(void *ctx, uint16_t address, uint16_t and_mask, uint16_t or_mask);
	/** The bits of `out` are 0 before. */
	enum od_status (*read_bits)(void *ctx, enum modbus_bits kind, uint16_t address, unsigned count, uint8_t *out);
	enum od_status (*write_coils)(void *ctx, uint16_t address, unsigned count, const uint8_t *in);
	/** An object of 43/14 as text, or NULL: there is none with this number. */
	const char *(*identification)(void *ctx, uint8_t number);
	/** Up to `*size` bytes of an object of the dictionary from byte `offset` on; *size becomes their number. */
	enum od_status (*read_object)(
		void *ctx, uint16_t index, uint8_t sub, size_t offset, uint8_t *out, size_t *size);
	enum od_status (*write_object)(void *ctx, uint16_t index, uint8_t sub, const uint8_t *in, size_t size);
	/** The SDO abort code of a status. */
	uint32_t (*abort_code)(enum od_status status);
};

/** The size of the response. 0: a write waits for its completion (OD_PENDING). */
size_t modbus_pdu(
	const struct modbus_registers *r, const uint8_t *request, size_t size, uint8_t response[MODBUS_PDU_MAX]);

/** The response to a request that returned 0, which is complete now. */
size_t modbus_pdu_done(const struct modbus_registers *r, const uint8_t *request, enum od_status status,
	uint8_t response[MODBUS_PDU_MAX]);

/** The size of a request that begins with these bytes, for a line that has no length in its frames. 0: more bytes are
 * needed to tell. -1: the function has no known size. */
int modbus_pdu_size(const uint8_t *request, size_t size);

/** Whether the request writes. */
bool modbus_pdu_writes(const uint8_t *request, size_t size);

#endif
