#include "gateway/canopen/emcy_codes.h"

#include <stddef.h>

/* CiA 301, table 26: by the upper byte where it has a class of its own, else by the upper four bits. */
static const char *class_text(uint16_t code)
{
	static const struct {
		uint16_t mask, code;
		const char *text;
	} classes[] = {
		{0xFF00, 0x0000, "no error"},
		{0xFF00, 0x6100, "internal software"},
		{0xFF00, 0x6200, "user software"},
		{0xFF00, 0x6300, "data set"},
		{0xFF00, 0x8100, "communication"},
		{0xFF00, 0x8200, "protocol error"},
		{0xFF00, 0xFF00, "device-specific"},
		{0xF000, 0x1000, "generic error"},
		{0xF000, 0x2000, "current"},
		{0xF000, 0x3000, "voltage"},
		{0xF000, 0x4000, "temperature"},
		{0xF000, 0x5000, "device hardware"},
		{0xF000, 0x6000, "device software"},
		{0xF000, 0x7000, "additional modules"},
		{0xF000, 0x8000, "monitoring"},
		{0xF000, 0x9000, "external error"},
		{0xF000, 0xF000, "additional functions"},
	};

	for (size_t i = 0; i < sizeof(classes) / sizeof(classes[0]); i++)
		if ((code & classes[i].mask) == classes[i].code)
			return classes[i].text;
	return "unknown error";
}

/* Without a default: the compiler reports a code that has no text. */
const char *emcy_code_text(uint16_t code)
{
	switch ((enum emcy_code)code) {
	case EMCY_NO_ERROR:
		return "no error";
	case EMCY_SLOPE_LONG:
		return "longitudinal slope out of range";
	case EMCY_SLOPE_LATERAL:
		return "lateral slope out of range";
	case EMCY_SENSOR_LOST:
		return "the IMU delivers no samples";
	case EMCY_SENSOR_DEGRADED:
		return "a chip of the IMU has a fault, samples continue without it (2124h)";
	case EMCY_IMPLAUSIBLE:
		return "outputs beyond what the sensor measures were not published (2121h:5)";
	case EMCY_STORE_DAMAGED:
		return "the stored values could not be read, defaults are in use";
	case EMCY_DATA_SET:
		return "a stored communication parameter is unusable";
	case EMCY_CONFIGURATION:
		return "the configuration objects contradict each other";
	case EMCY_SENSOR_SETTINGS:
		return "the IMU does not support a setting of 2058h";
	case EMCY_SYNC_TIME:
		return "SYNC missing (1006h), or received after its window (1007h)";
	case EMCY_CAN_OVERRUN:
		return "CAN overrun: frames were lost";
	case EMCY_ERROR_PASSIVE:
		return "CAN error passive";
	case EMCY_HEARTBEAT:
		return "heartbeat or life guarding lost";
	case EMCY_BUS_OFF_OVER:
		return "recovered from bus-off";
	case EMCY_COLLISION:
		return "another node sends with an identifier of this node";
	case EMCY_PDO_CONTENT:
		return "an object refuses its value in an RPDO";
	case EMCY_PDO_SHORT:
		return "RPDO shorter than its mapping, not processed";
	case EMCY_PDO_LONG:
		return "RPDO longer than its mapping";
	case EMCY_SYNC_LENGTH:
		return "SYNC of unexpected length";
	case EMCY_PDO_TIMEOUT:
		return "RPDO not received within its event time";
	case EMCY_POSITION_UNSURE:
		return "the position is less certain than position.sigma_limit";
	}
	return class_text(code);
}
