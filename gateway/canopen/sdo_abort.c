#include "gateway/canopen/canopen.h"

/* CiA 301, table 22. Exhaustive: the compiler tells when a status has no code. */
uint32_t canopen_abort_code(enum od_status status)
{
	switch (status) {
	case OD_OK:
	case OD_CONSUMED:
	case OD_PENDING:
		return 0;
	case OD_UNSUPPORTED_ACCESS:
		return 0x06010000;
	case OD_WRITE_ONLY:
		return 0x06010001;
	case OD_READ_ONLY:
		return 0x06010002;
	case OD_NO_OBJECT:
		return 0x06020000;
	case OD_NOT_MAPPABLE:
		return 0x06040041;
	case OD_PDO_LENGTH:
		return 0x06040042;
	case OD_INCOMPATIBLE:
		return 0x06040043;
	case OD_TOO_LONG:
		return 0x06070012;
	case OD_TOO_SHORT:
		return 0x06070013;
	case OD_NO_SUBINDEX:
		return 0x06090011;
	case OD_BAD_VALUE:
		return 0x06090030;
	case OD_TOO_HIGH:
		return 0x06090031;
	case OD_TOO_LOW:
		return 0x06090032;
	case OD_CANNOT_STORE:
		return 0x08000020;
	case OD_LOCAL_CONTROL:
		return 0x08000021;
	case OD_DEVICE_STATE:
		return 0x08000022;
	case OD_NO_DATA:
		return 0x08000024;
	case OD_GENERAL:
	case OD_STATUS_COUNT:
		break;
	}
	return 0x08000000;
}
