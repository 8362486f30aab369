#include "gateway/modbus/exception.h"

/* Without a default: the compiler reports a status that has no exception. */
uint8_t modbus_exception(enum od_status status)
{
	switch (status) {
	case OD_OK:
	case OD_CONSUMED:
	case OD_PENDING:
		return 0;
	case OD_NO_OBJECT:
	case OD_NO_SUBINDEX:
	case OD_WRITE_ONLY:
	case OD_READ_ONLY:
	case OD_UNSUPPORTED_ACCESS:
		return MODBUS_ILLEGAL_ADDRESS;
	case OD_TOO_LONG:
	case OD_TOO_SHORT:
	case OD_TOO_HIGH:
	case OD_TOO_LOW:
	case OD_BAD_VALUE:
	case OD_NOT_MAPPABLE:
	case OD_PDO_LENGTH:
	case OD_INCOMPATIBLE:
		return MODBUS_ILLEGAL_VALUE;
	case OD_LOCAL_CONTROL:
	case OD_DEVICE_STATE:
		return MODBUS_DEVICE_BUSY;
	case OD_CANNOT_STORE:
	case OD_NO_DATA:
	case OD_GENERAL:
	case OD_STATUS_COUNT:
		break;
	}
	return MODBUS_DEVICE_FAILURE;
}
