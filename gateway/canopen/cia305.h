/* gateway/canopen/cia305.h
 * Numbers of LSS (CiA 305, V3.0.0), for the slave, the masters and the tools: byte 0 of its messages. */
#ifndef GATEWAY_CANOPEN_CIA305_H
#define GATEWAY_CANOPEN_CIA305_H

enum lss_command {
	LSS_SWITCH_GLOBAL = 0x04,
	LSS_CONFIGURE_NODE_ID = 0x11,
	LSS_CONFIGURE_BIT_TIMING = 0x13,
	LSS_ACTIVATE_BIT_TIMING = 0x15,
	LSS_STORE = 0x17,
	LSS_SWITCH_SELECTIVE = 0x40, /* to 43h: vendor-ID, product code, revision, serial number */
	LSS_SWITCHED = 0x44,
	LSS_IDENTIFY = 0x46, /* to 4Bh: vendor-ID, product code, lowest and highest revision, serial number */
	LSS_IDENTIFY_UNCONFIGURED = 0x4C,
	LSS_IDENTIFIED = 0x4F,
	LSS_IDENTIFIED_UNCONFIGURED = 0x50,
	LSS_FASTSCAN = 0x51,
	LSS_INQUIRE_IDENTITY = 0x5A, /* to 5Dh */
	LSS_INQUIRE_NODE_ID = 0x5E,
};

#endif
