/* gateway/canopen/emcy_codes.h
 * Every emergency error code that this device sends, and the bits of the error register: the one list for the core, the
 * device, the LEDs, the event log and the tools. gateway/README.md says what to do about each; `make check-layers`
 * holds its table to this list.
 *
 * Codes of CiA 301 (V4.2, table 26) and of CiA 410 have the meaning that those documents give them; "this device" marks
 * its own codes within the classes of that table. "info" is the manufacturer-specific field, bytes 3 to 7 of the EMCY
 * message: numbers in it are little-endian, and it is zero where nothing is said. */
#ifndef GATEWAY_CANOPEN_EMCY_CODES_H
#define GATEWAY_CANOPEN_EMCY_CODES_H

#include <stdint.h>

enum emcy_code {
	EMCY_NO_ERROR = 0x0000,	       /* CiA 301: error reset, no error is left */
	EMCY_SLOPE_LONG = 0x5010,      /* CiA 410: longitudinal slope outside 2119h or the range of its objects */
	EMCY_SLOPE_LATERAL = 0x5020,   /* CiA 410: lateral slope, likewise */
	EMCY_SENSOR_LOST = 0x5030,     /* this device: no samples; info: enum imu_fault, enum imu_chip */
	EMCY_SENSOR_DEGRADED = 0x5031, /* this device: fault of a chip that samples do without; info the same */
	EMCY_IMPLAUSIBLE = 0x5032,     /* this device: outputs not finite or beyond the sensor's range, not published */
	EMCY_STORE_DAMAGED = 0x5530,   /* this device: stored values unreadable, defaults are in use */
	EMCY_DATA_SET = 0x6300,	       /* CiA 301: a stored communication parameter is unusable; info: its index */
	EMCY_CONFIGURATION = 0x6320,   /* this device: configuration objects contradict each other, not applied */
	EMCY_SENSOR_SETTINGS = 0x6321, /* this device: the sensor lacks a setting of 2058h */
	EMCY_SYNC_TIME = 0x8100,       /* CiA 301, communication; info: 1007h, SYNC late, or 1006h, SYNC missing */
	EMCY_CAN_OVERRUN = 0x8110,     /* CiA 301: CAN overrun, frames were lost */
	EMCY_ERROR_PASSIVE = 0x8120,   /* CiA 301: CAN controller in error passive mode */
	EMCY_HEARTBEAT = 0x8130,       /* CiA 301: heartbeat or life guarding; info: silent node, 0 for the master */
	EMCY_BUS_OFF_OVER = 0x8140,    /* CiA 301: recovered from bus-off */
	EMCY_COLLISION = 0x8150,       /* CiA 301: CAN-ID collision; info: the identifier */
	EMCY_PDO_CONTENT = 0x8200,     /* CiA 301, protocol; info: 14xxh, index and sub-index that refuses its value */
	EMCY_PDO_SHORT = 0x8210,       /* CiA 301: PDO too short, not used; info: 14xxh, bytes received, bytes mapped */
	EMCY_PDO_LONG = 0x8220,	       /* CiA 301: PDO too long, first bytes used; info the same */
	EMCY_SYNC_LENGTH = 0x8240,     /* CiA 301: unexpected SYNC data length */
	EMCY_PDO_TIMEOUT = 0x8250,     /* CiA 301: RPDO event timer elapsed; info: 14xxh */
	EMCY_POSITION_UNSURE = 0xFF10, /* this device: 1 sigma of the position exceeds 2040h:9 */
};

/** Bits of the error register 1001h (CiA 301, 7.5.2.2) that this device sets. */
enum error_register {
	ERROR_GENERIC = 1 << 0,
	ERROR_COMMUNICATION = 1 << 4,
	ERROR_PROFILE = 1 << 5, /* specific to the device profile, here CiA 410 */
	ERROR_MANUFACTURER = 1 << 7,
};

/** One phrase for people, below 100 bytes: for the codes above what this device means by them, for any other code the
 * class that CiA 301, table 26 gives it, or "unknown error". The string is static; any thread may call this. */
const char *emcy_code_text(uint16_t code);

#endif
