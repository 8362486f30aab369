/* gateway/cia309/value.h
 * The data types of CiA 309-3 and their values: text to the bytes that SDO transmits (little-endian), and back. Pure.
 * */
#ifndef GATEWAY_CIA309_VALUE_H
#define GATEWAY_CIA309_VALUE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/** A data type: of a name. Static. */
struct cia309_type {
	const char *name; /* "u16" */
	uint8_t size;	  /* bytes of a number or a time; 0: as many as there are */
	uint8_t od_type;  /* enum od_type: how a number is written; 0: not a number */
	enum cia309_form {
		CIA309_NUMBER,
		CIA309_HEX_NUMBER, /* read as a number, written as 0x001F */
		CIA309_HEX,	   /* "01 02 FF" */
		CIA309_TIME,	   /* days since 1984-01-01 (of t), and ms */
		CIA309_STRING,	   /* in quotes; a quote in it is doubled */
		CIA309_BASE64,	   /* RFC 2045, in one line */
		CIA309_RAW,	   /* only printed: text as it is */
	} form;
};

/** By name, in any case; NULL: there is none. */
const struct cia309_type *cia309_type(const char *name);
/** For a value whose type the client did not name. */
extern const struct cia309_type CIA309_TYPE_HEX;
/** For text of the gateway itself. */
extern const struct cia309_type CIA309_TYPE_RAW;

/** Reads a value from the rest of a command line (`text`, without line break), and a comment behind it. The number of
 * bytes, at most `capacity`; -EINVAL: not a value of that type, or out of its range; -ENOSPC: more than `capacity`. */
long cia309_scan(const struct cia309_type *type, const char *text, size_t length, uint8_t *bytes, size_t capacity);

/** Prints one value, in pieces where it is long. Start: the first three fields, the rest 0. `bytes` must stay. */
struct cia309_printer {
	const struct cia309_type *type;
	const uint8_t *bytes;
	size_t size;
	/* PRIVATE */
	size_t done;
	bool opened, closed;
};

enum { CIA309_PRINT_MIN = 64 };

/** The next piece: how many characters, without NUL; `capacity` is CIA309_PRINT_MIN at least. Bytes that do not have
 * the size of a number are printed as hex. */
size_t cia309_print(struct cia309_printer *p, char *text, size_t capacity);
/** Whether all is printed. */
bool cia309_printed(const struct cia309_printer *p);

#endif
