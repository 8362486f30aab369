/* tools/fleet/record.h
 * What is said of a node at one moment, independent of the format in which it is published: the values of one sample, a
 * state, an EMCY. It is handed over between threads and spooled as bytes, little-endian, and carries the mapping and
 * the step of each value, so that it means the same after a restart. No allocation, no state. */
#ifndef TOOLS_FLEET_RECORD_H
#define TOOLS_FLEET_RECORD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { RECORD_FIELDS = 64, RECORD_TEXT_MAX = 768, RECORD_MAX = 1024 /* bytes of the encoded form */ };

enum record_kind {
	RECORD_VALUES = 1, /* of one sample */
	RECORD_STATE,	   /* the NMT state has changed */
	RECORD_EMCY,
	RECORD_CONFIGURED, /* the PDO mapping was read: what was known of the values holds no longer */
	RECORD_ANSWER,	   /* to a write; not spooled */
};

struct record_field {
	uint32_t mapping; /* as in 1A00h: index, sub-index, bits */
	double step;	  /* physical value of one step */
	uint64_t wire;	  /* the mapped bits, not interpreted */
};

struct record {
	enum record_kind kind;
	uint8_t node_id;
	int64_t utc_us; /* since 1970, of the reception of its first frame */

	bool counted; /* VALUES: `counter` is the sample counter of the node */
	uint16_t counter;
	size_t field_count;
	struct record_field fields[RECORD_FIELDS];

	int nmt_state;	 /* STATE: as of watch_nmt_state() */
	uint8_t emcy[8]; /* EMCY: the frame */

	char text[RECORD_TEXT_MAX]; /* ANSWER: a JSON document */
};

/** Bytes of the mapped value, 1 to 8. */
size_t record_field_size(const struct record_field *field);
/** Returns the number of bytes; always fits. */
size_t record_encode(const struct record *record, uint8_t bytes[RECORD_MAX]);
/** 0, or -EINVAL: these bytes are no record. */
int record_decode(struct record *record, const uint8_t *bytes, size_t size);

#endif
