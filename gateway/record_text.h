/* gateway/record_text.h
 * A recording as text: an IMU log (drivers/README.md) that any program reads. A sample is a row, with the columns
 * now_us (when the device got it, CLOCK_MONOTONIC) and flags (enum of model/sample.h) behind those of a log; every
 * other input of the device is a comment, `# WORD NUMBER...`. Numbers read back to the same bits. Pure. */
#ifndef GATEWAY_RECORD_TEXT_H
#define GATEWAY_RECORD_TEXT_H

#include <stddef.h>

#include "gateway/record.h"

enum { RECORD_ROW_MAX = 640 };

/** The header of the samples' columns, without line break. */
extern const char RECORD_COLUMNS[];

/** One line with its line break; the number of characters. `e`: of a kind up to RECORD_LAST_ROW. */
size_t record_text(const struct record_entry *e, char out[RECORD_ROW_MAX]);
/** `line`: without its line break. 1 and the entry; 0: a line of another kind; -EBADMSG: damaged. */
int record_parse(const char *line, struct record_entry *e);

/** Bytes as base64 (RFC 4648), 4 characters for 3 bytes, and back: the number of bytes, or -EBADMSG. */
size_t record_base64(const uint8_t *bytes, size_t size, char *out);
long record_from_base64(const char *text, size_t length, uint8_t *out);

#endif
