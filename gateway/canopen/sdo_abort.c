#include "gateway/canopen/sdo_abort.h"

/* Without a default: the compiler reports a status that has no abort code. */
uint32_t sdo_abort_code(enum od_status status)
{
	switch (status) {
	case OD_OK:
	case OD_CONSUMED:
	case OD_PENDING:
		return 0;
	case OD_UNSUPPORTED_ACCESS:
		return SDO_ABORT_UNSUPPORTED_ACCESS;
	case OD_WRITE_ONLY:
		return SDO_ABORT_WRITE_ONLY;
	case OD_READ_ONLY:
		return SDO_ABORT_READ_ONLY;
	case OD_NO_OBJECT:
		return SDO_ABORT_NO_OBJECT;
	case OD_NOT_MAPPABLE:
		return SDO_ABORT_NOT_MAPPABLE;
	case OD_PDO_LENGTH:
		return SDO_ABORT_PDO_LENGTH;
	case OD_INCOMPATIBLE:
		return SDO_ABORT_INCOMPATIBLE;
	case OD_TOO_LONG:
		return SDO_ABORT_TOO_LONG;
	case OD_TOO_SHORT:
		return SDO_ABORT_TOO_SHORT;
	case OD_NO_SUBINDEX:
		return SDO_ABORT_NO_SUBINDEX;
	case OD_BAD_VALUE:
		return SDO_ABORT_BAD_VALUE;
	case OD_TOO_HIGH:
		return SDO_ABORT_TOO_HIGH;
	case OD_TOO_LOW:
		return SDO_ABORT_TOO_LOW;
	case OD_CANNOT_STORE:
		return SDO_ABORT_CANNOT_STORE;
	case OD_LOCAL_CONTROL:
		return SDO_ABORT_LOCAL_CONTROL;
	case OD_DEVICE_STATE:
		return SDO_ABORT_DEVICE_STATE;
	case OD_NO_DATA:
		return SDO_ABORT_NO_DATA;
	case OD_GENERAL:
	case OD_STATUS_COUNT:
		break;
	}
	return SDO_ABORT_GENERAL;
}

/* Without a default: the compiler reports a code that has no text. */
const char *sdo_abort_text(uint32_t abort_code)
{
	switch ((enum sdo_abort)abort_code) {
	case SDO_ABORT_TOGGLE:
		return "the toggle bit did not alternate";
	case SDO_ABORT_TIMEOUT:
		return "the SDO transfer timed out";
	case SDO_ABORT_COMMAND:
		return "unknown SDO command";
	case SDO_ABORT_BLOCK_SIZE:
		return "wrong block size";
	case SDO_ABORT_SEQUENCE:
		return "wrong sequence number in a block";
	case SDO_ABORT_CRC:
		return "wrong CRC of a block transfer";
	case SDO_ABORT_MEMORY:
		return "out of memory: the value is too large";
	case SDO_ABORT_UNSUPPORTED_ACCESS:
		return "this kind of access is not supported";
	case SDO_ABORT_WRITE_ONLY:
		return "the object can only be written";
	case SDO_ABORT_READ_ONLY:
		return "the object can only be read";
	case SDO_ABORT_NO_OBJECT:
		return "no such object in the node";
	case SDO_ABORT_NOT_MAPPABLE:
		return "the object cannot be mapped into a PDO";
	case SDO_ABORT_PDO_LENGTH:
		return "the mapped objects are longer than a PDO";
	case SDO_ABORT_INCOMPATIBLE:
		return "the parameters do not fit together";
	case SDO_ABORT_INTERNAL_INCOMPATIBILITY:
		return "incompatible inside the device";
	case SDO_ABORT_HARDWARE:
		return "hardware error";
	case SDO_ABORT_LENGTH:
		return "the length does not match the type of the object";
	case SDO_ABORT_TOO_LONG:
		return "the value is too long for the type of the object";
	case SDO_ABORT_TOO_SHORT:
		return "the value is too short for the type of the object";
	case SDO_ABORT_NO_SUBINDEX:
		return "the object has no such sub-index";
	case SDO_ABORT_BAD_VALUE:
		return "this value is not allowed";
	case SDO_ABORT_TOO_HIGH:
		return "the value is above the high limit";
	case SDO_ABORT_TOO_LOW:
		return "the value is below the low limit";
	case SDO_ABORT_MAXIMUM_BELOW_MINIMUM:
		return "the maximum is below the minimum";
	case SDO_ABORT_NO_CONNECTION:
		return "the SDO connection is not available";
	case SDO_ABORT_GENERAL:
		return "general error";
	case SDO_ABORT_CANNOT_STORE:
		return "the data cannot be transferred or stored";
	case SDO_ABORT_LOCAL_CONTROL:
		return "the data cannot be transferred or stored: local control";
	case SDO_ABORT_DEVICE_STATE:
		return "not in the present state of the device";
	case SDO_ABORT_NO_DICTIONARY:
		return "the node has no object dictionary, or could not build it";
	case SDO_ABORT_NO_DATA:
		return "no data available";
	}
	return "unknown abort code";
}
