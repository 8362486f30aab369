#include "gateway/modbus/pdu.h"

#include <string.h>

#include "gateway/modbus/exception.h"

enum function {
	READ_COILS = 1,
	READ_DISCRETE_INPUTS = 2,
	READ_HOLDING_REGISTERS = 3,
	READ_INPUT_REGISTERS = 4,
	WRITE_COIL = 5,
	WRITE_REGISTER = 6,
	WRITE_COILS = 15,
	WRITE_REGISTERS = 16,
	MASK_REGISTER = 22,
	READ_WRITE_REGISTERS = 23,
	ENCAPSULATED = 43,
};

enum { MEI_CANOPEN = 13, MEI_IDENTIFICATION = 14 };
enum { WRITE_COILS_MAX = 1968, WRITE_REGISTERS_MAX = 123, READ_WRITE_MAX = 121, COIL_ON = 0xFF00, ERROR = 0x80 };

/* 43/14: the objects of its three levels, and what this server can do. */
enum {
	BASIC_LAST = 0x02,
	REGULAR_LAST = 0x06,
	EXTENDED_FIRST = 0x80,
	EXTENDED_LAST = 0xFF,
	ONE_OBJECT = 4,		    /* the code that reads one, after those of the levels */
	CONFORMITY_EXTENDED = 0x83, /* all levels, as a stream and one by one */
	MORE_FOLLOWS = 0xFF,
	IDENTIFICATION_HEAD = 7,
};

/* 43/13. The protocol control byte has bit 0 for a write; with bit 1 a reserved and an encoding byte follow it. */
enum {
	CONTROL_WRITE = 1,
	CONTROL_ENCODED = 2,
	EXTENDED_EXCEPTION = 0xFF,
	CANOPEN_EXCEPTION = 0xEC,
	OBJECT_BYTES = 8,		 /* node-ID, index, sub-index, offset, count */
	NO_SUCH_NODE_ABORT = 0x060A0023, /* no SDO connection */
};

static uint16_t get16(const uint8_t *at)
{
	return (uint16_t)(at[0] << 8 | at[1]);
}

static void put16(uint8_t *at, unsigned value)
{
	at[0] = (uint8_t)(value >> 8);
	at[1] = (uint8_t)value;
}

static size_t refuse(const uint8_t *request, uint8_t exception, uint8_t *response)
{
	response[0] = request[0] | ERROR;
	response[1] = exception;
	return 2;
}

static bool in_range(uint16_t address, unsigned count)
{
	return address + count <= 0x10000;
}

/* ---- reading ----------------------------------------------------------------------------------------------------- */

static size_t read_bits(const struct modbus_registers *r, const uint8_t *request, size_t size, uint8_t *response)
{
	unsigned count = size == 5 ? get16(request + 3) : 0;

	if (count < 1 || count > MODBUS_BITS_MAX)
		return refuse(request, MODBUS_ILLEGAL_VALUE, response);
	uint16_t address = get16(request + 1);
	enum modbus_bits kind = request[0] == READ_COILS ? MODBUS_COILS : MODBUS_DISCRETE_INPUTS;
	size_t bytes = (count + 7) / 8;
	memset(response + 2, 0, bytes);
	enum od_status status =
		in_range(address, count) ? r->read_bits(r->ctx, kind, address, count, response + 2) : OD_NO_OBJECT;
	if (status)
		return refuse(request, modbus_exception(status), response);
	response[0] = request[0];
	response[1] = (uint8_t)bytes;
	return 2 + bytes;
}

static size_t answer_registers(
	const struct modbus_registers *r, const uint8_t *request, uint16_t address, unsigned count, uint8_t *response)
{
	enum od_status status = in_range(address, count) ? r->read(r->ctx, address, count, response + 2) : OD_NO_OBJECT;

	if (status)
		return refuse(request, modbus_exception(status), response);
	response[0] = request[0];
	response[1] = (uint8_t)(2 * count);
	return 2 + 2 * count;
}

static size_t read_registers(const struct modbus_registers *r, const uint8_t *request, size_t size, uint8_t *response)
{
	unsigned count = size == 5 ? get16(request + 3) : 0;

	if (count < 1 || count > MODBUS_REGISTERS_MAX)
		return refuse(request, MODBUS_ILLEGAL_VALUE, response);
	return answer_registers(r, request, get16(request + 1), count, response);
}

/* ---- writing ----------------------------------------------------------------------------------------------------- */

/* The response repeats the request, of a multiple write only address and quantity. */
static size_t confirm(const uint8_t *request, uint8_t *response)
{
	size_t size = request[0] == MASK_REGISTER ? 7 : 5;

	memcpy(response, request, size);
	return size;
}

static size_t end_write(const uint8_t *request, enum od_status status, uint8_t *response)
{
	if (status == OD_PENDING)
		return 0;
	return status ? refuse(request, modbus_exception(status), response) : confirm(request, response);
}

static size_t write_coil(const struct modbus_registers *r, const uint8_t *request, size_t size, uint8_t *response)
{
	unsigned value = size == 5 ? get16(request + 3) : 1;

	if (value != 0 && value != COIL_ON)
		return refuse(request, MODBUS_ILLEGAL_VALUE, response);
	return end_write(request, r->write_coils(r->ctx, get16(request + 1), 1, &(uint8_t){value != 0}), response);
}

static size_t write_register(const struct modbus_registers *r, const uint8_t *request, size_t size, uint8_t *response)
{
	if (size != 5)
		return refuse(request, MODBUS_ILLEGAL_VALUE, response);
	return end_write(request, r->write(r->ctx, get16(request + 1), 1, request + 3), response);
}

static size_t mask_register(const struct modbus_registers *r, const uint8_t *request, size_t size, uint8_t *response)
{
	if (size != 7)
		return refuse(request, MODBUS_ILLEGAL_VALUE, response);
	enum od_status status = r->mask(r->ctx, get16(request + 1), get16(request + 3), get16(request + 5));
	return end_write(request, status, response);
}

static size_t write_many(const struct modbus_registers *r, const uint8_t *request, size_t size, uint8_t *response)
{
	bool coils = request[0] == WRITE_COILS;
	unsigned count = size >= 6 ? get16(request + 3) : 0, max = coils ? WRITE_COILS_MAX : WRITE_REGISTERS_MAX;
	size_t bytes = coils ? (count + 7) / 8 : 2 * count;
	uint16_t address;

	if (count < 1 || count > max || request[5] != bytes || size != 6 + bytes)
		return refuse(request, MODBUS_ILLEGAL_VALUE, response);
	address = get16(request + 1);
	if (!in_range(address, count))
		return refuse(request, MODBUS_ILLEGAL_ADDRESS, response);
	return end_write(request, (coils ? r->write_coils : r->write)(r->ctx, address, count, request + 6), response);
}

/* The write comes first. A range that cannot be read leaves everything as it is. */
static size_t read_write(const struct modbus_registers *r, const uint8_t *request, size_t size, uint8_t *response)
{
	unsigned reads = size >= 10 ? get16(request + 3) : 0, writes = size >= 10 ? get16(request + 7) : 0;

	if (reads < 1 || reads > MODBUS_REGISTERS_MAX || writes < 1 || writes > READ_WRITE_MAX ||
		request[9] != 2 * writes || size != 10 + 2 * writes)
		return refuse(request, MODBUS_ILLEGAL_VALUE, response);
	uint16_t from = get16(request + 1), to = get16(request + 5);
	if (!in_range(from, reads) || !in_range(to, writes))
		return refuse(request, MODBUS_ILLEGAL_ADDRESS, response);
	enum od_status status = r->read(r->ctx, from, reads, response + 2);
	if (!status)
		status = r->write(r->ctx, to, writes, request + 10);
	if (status)
		return refuse(request, status == OD_PENDING ? MODBUS_DEVICE_BUSY : modbus_exception(status), response);
	return answer_registers(r, request, from, reads, response);
}

/* ---- 43/14: identification --------------------------------------------------------------------------------------- */

/* The first object from `number` to `last` that there is; -1: none. */
static int next_identification(const struct modbus_registers *r, unsigned number, unsigned last)
{
	for (; number <= last; number++)
		if ((number <= REGULAR_LAST || number >= EXTENDED_FIRST) && r->identification(r->ctx, (uint8_t)number))
			return (int)number;
	return -1;
}

static size_t add_identification(uint8_t *response, size_t used, int number, const char *text)
{
	size_t length = strlen(text);

	if (used + 2 + length > MODBUS_PDU_MAX)
		return 0;
	response[used] = (uint8_t)number;
	response[used + 1] = (uint8_t)length;
	memcpy(response + used + 2, text, length);
	response[6]++;
	return used + 2 + length;
}

static size_t identify(const struct modbus_registers *r, const uint8_t *request, size_t size, uint8_t *response)
{
	static const uint8_t LAST[] = {0, BASIC_LAST, REGULAR_LAST, EXTENDED_LAST, EXTENDED_LAST};
	uint8_t code = size == 4 ? request[2] : 0;

	if (code < 1 || code > ONE_OBJECT)
		return refuse(request, MODBUS_ILLEGAL_VALUE, response);
	int number = request[3];
	bool exists = number <= LAST[code] && next_identification(r, (unsigned)number, (unsigned)number) >= 0;
	if (code == ONE_OBJECT && !exists)
		return refuse(request, MODBUS_ILLEGAL_ADDRESS, response);
	memcpy(response, request, 3);
	memcpy(response + 3, (uint8_t[]){CONFORMITY_EXTENDED, 0, 0, 0}, 4);
	size_t used = IDENTIFICATION_HEAD;
	for (number = exists ? number : next_identification(r, 0, LAST[code]); number >= 0;
		number = next_identification(r, (unsigned)number + 1, LAST[code])) {
		size_t more = add_identification(response, used, number, r->identification(r->ctx, (uint8_t)number));
		if (more == 0) {
			response[4] = MORE_FOLLOWS;
			response[5] = (uint8_t)number;
			break;
		}
		used = more;
		if (code == ONE_OBJECT)
			break;
	}
	return used;
}

/* ---- 43/13: every object of the dictionary ----------------------------------------------------------------------- */

static size_t refuse_object(const uint8_t *request, uint32_t abort_code, uint8_t *response)
{
	const uint8_t bytes[] = {ENCAPSULATED | ERROR, EXTENDED_EXCEPTION, 0, 6, MEI_CANOPEN, CANOPEN_EXCEPTION,
		(uint8_t)(abort_code >> 24), (uint8_t)(abort_code >> 16), (uint8_t)(abort_code >> 8),
		(uint8_t)abort_code};

	(void)request;
	memcpy(response, bytes, sizeof(bytes));
	return sizeof(bytes);
}

/* Where the node-ID is, behind the protocol control byte. */
static size_t object_at(const uint8_t *request)
{
	return request[2] & CONTROL_ENCODED ? 5 : 3;
}

/* The response repeats the request, with the number of bytes that follow. */
static size_t answer_object(const uint8_t *request, size_t count, uint8_t *response)
{
	size_t head = object_at(request) + OBJECT_BYTES;

	memcpy(response, request, head);
	put16(response + head - 2, (unsigned)count);
	return head + count;
}

static size_t end_write_object(
	const struct modbus_registers *r, const uint8_t *request, enum od_status status, uint8_t *response)
{
	if (status == OD_PENDING)
		return 0;
	return status ? refuse_object(request, r->abort_code(status), response) : answer_object(request, 0, response);
}

static size_t access_object(const struct modbus_registers *r, const uint8_t *request, size_t size, uint8_t *response)
{
	size_t at = size >= 3 ? object_at(request) : 0, head = at + OBJECT_BYTES;

	if (size < 3 || request[2] & ~(CONTROL_WRITE | CONTROL_ENCODED) || size < head)
		return refuse(request, MODBUS_ILLEGAL_VALUE, response);
	uint16_t index = get16(request + at + 1), offset = get16(request + at + 4);
	size_t count = get16(request + at + 6), room = MODBUS_PDU_MAX - head;
	uint8_t sub = request[at + 3];
	bool writes = request[2] & CONTROL_WRITE;
	if (size != head + (writes ? count : 0) || (writes && offset != 0))
		return refuse(request, MODBUS_ILLEGAL_VALUE, response);
	if (request[at] != 0 && request[at] != r->node_id)
		return refuse_object(request, NO_SUCH_NODE_ABORT, response);
	if (writes)
		return end_write_object(
			r, request, r->write_object(r->ctx, index, sub, request + head, count), response);
	count = count < room ? count : room;
	enum od_status status = r->read_object(r->ctx, index, sub, offset, response + head, &count);
	return status ? refuse_object(request, r->abort_code(status), response)
		      : answer_object(request, count, response);
}

static size_t encapsulated(const struct modbus_registers *r, const uint8_t *request, size_t size, uint8_t *response)
{
	if (size < 2)
		return refuse(request, MODBUS_ILLEGAL_VALUE, response);
	if (request[1] == MEI_IDENTIFICATION)
		return identify(r, request, size, response);
	if (request[1] == MEI_CANOPEN)
		return access_object(r, request, size, response);
	return refuse(request, MODBUS_ILLEGAL_FUNCTION, response);
}

/* ---- all of them ------------------------------------------------------------------------------------------------- */

bool modbus_pdu_writes(const uint8_t *request, size_t size)
{
	switch (request[0]) {
	case WRITE_COIL:
	case WRITE_REGISTER:
	case WRITE_COILS:
	case WRITE_REGISTERS:
	case MASK_REGISTER:
	case READ_WRITE_REGISTERS:
		return true;
	case ENCAPSULATED:
		return size > 2 && request[1] == MEI_CANOPEN && request[2] & CONTROL_WRITE;
	default:
		return false;
	}
}

size_t modbus_pdu(
	const struct modbus_registers *r, const uint8_t *request, size_t size, uint8_t response[MODBUS_PDU_MAX])
{
	if (r->read_only && modbus_pdu_writes(request, size))
		return refuse(request, MODBUS_ILLEGAL_FUNCTION, response);
	switch (request[0]) {
	case READ_COILS:
	case READ_DISCRETE_INPUTS:
		return read_bits(r, request, size, response);
	case READ_HOLDING_REGISTERS:
	case READ_INPUT_REGISTERS:
		return read_registers(r, request, size, response);
	case WRITE_COIL:
		return write_coil(r, request, size, response);
	case WRITE_REGISTER:
		return write_register(r, request, size, response);
	case WRITE_COILS:
	case WRITE_REGISTERS:
		return write_many(r, request, size, response);
	case MASK_REGISTER:
		return mask_register(r, request, size, response);
	case READ_WRITE_REGISTERS:
		return read_write(r, request, size, response);
	case ENCAPSULATED:
		return encapsulated(r, request, size, response);
	default:
		return refuse(request, MODBUS_ILLEGAL_FUNCTION, response);
	}
}

size_t modbus_pdu_done(const struct modbus_registers *r, const uint8_t *request, enum od_status status,
	uint8_t response[MODBUS_PDU_MAX])
{
	return request[0] == ENCAPSULATED ? end_write_object(r, request, status, response)
					  : end_write(request, status, response);
}

/* The byte at `at` is the number of those that follow it. */
static int counted(const uint8_t *request, size_t size, size_t at)
{
	return size > at ? (int)(at + 1 + request[at]) : 0;
}

int modbus_pdu_size(const uint8_t *request, size_t size)
{
	if (size < 3)
		return 0;
	switch (request[0]) {
	case READ_COILS:
	case READ_DISCRETE_INPUTS:
	case READ_HOLDING_REGISTERS:
	case READ_INPUT_REGISTERS:
	case WRITE_COIL:
	case WRITE_REGISTER:
		return 5;
	case WRITE_COILS:
	case WRITE_REGISTERS:
		return counted(request, size, 5);
	case MASK_REGISTER:
		return 7;
	case READ_WRITE_REGISTERS:
		return counted(request, size, 9);
	case ENCAPSULATED:
		if (request[1] == MEI_IDENTIFICATION)
			return 4;
		if (request[1] != MEI_CANOPEN)
			return -1;
		size_t head = object_at(request) + OBJECT_BYTES;
		if (!(request[2] & CONTROL_WRITE))
			return (int)head;
		return size < head ? 0 : (int)head + get16(request + head - 2);
	default:
		return -1;
	}
}
