/* drivers/can/slcan_codec.h
 * The lines of slcan (Lawicel, CANable, CANUSB). Pure, no heap. */
#ifndef DRIVERS_CAN_SLCAN_CODEC_H
#define DRIVERS_CAN_SLCAN_CODEC_H

#include "drivers/ports/can.h"

enum { SLCAN_LINE_MAX = 32 }; /* a frame with 8 bytes takes 27, 31 with its time */

/** Writes the line with its CR and without a NUL. Returns its length. */
size_t slcan_encode(const struct can_msg *msg, char out[SLCAN_LINE_MAX]);

/** The digit of the command S for a bit rate, '0' to '8'; '\0': not supported. */
char slcan_bit_rate_code(uint32_t bit_s);

enum slcan_kind {
	SLCAN_NOTHING, /* the line is not complete */
	SLCAN_FRAME,   /* `msg` */
	SLCAN_OK,      /* a command or a frame was accepted */
	SLCAN_SENT,    /* a frame was accepted: z or Z */
	SLCAN_REFUSED, /* BEL */
	SLCAN_STATUS,  /* `flags`, the answer to F */
	SLCAN_OTHER,   /* another answer: version, serial number */
	SLCAN_BAD,     /* any other line, or one that is too long */
};

/* Flags of the answer to F. */
enum {
	SLCAN_RX_FULL = 1 << 0,
	SLCAN_TX_FULL = 1 << 1,
	SLCAN_WARNING = 1 << 2,
	SLCAN_OVERRUN = 1 << 3,
	SLCAN_PASSIVE = 1 << 5,
	SLCAN_BUS_ERROR = 1 << 7,
};

struct slcan_reader {
	char line[SLCAN_LINE_MAX];
	size_t length;
	bool skipping; /* the line is too long: skip the rest of it */
	struct can_msg msg;
	uint8_t flags;
};

/** Processes one byte from the adapter. Some firmware ends its lines with LF, or CR LF: LF ends a line that is not
 * empty. */
enum slcan_kind slcan_read(struct slcan_reader *reader, char byte);

#endif
