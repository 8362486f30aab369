/* gateway/modbus/exception.h
 * Statuses of the dictionary as exceptions of Modbus (MODBUS Application Protocol Specification V1.1b3, 7). Any
 * thread. */
#ifndef GATEWAY_MODBUS_EXCEPTION_H
#define GATEWAY_MODBUS_EXCEPTION_H

#include <stdint.h>

#include "od/od.h"

enum modbus_exception {
	MODBUS_ILLEGAL_FUNCTION = 1,
	MODBUS_ILLEGAL_ADDRESS = 2,
	MODBUS_ILLEGAL_VALUE = 3,
	MODBUS_DEVICE_FAILURE = 4,
	MODBUS_DEVICE_BUSY = 6,
};

/** 0 for the statuses that are not failures: OD_OK, OD_CONSUMED and OD_PENDING. */
uint8_t modbus_exception(enum od_status status);

#endif
