#include "tools/fleet/record.h"

#include <assert.h>
#include <errno.h>
#include <math.h>
#include <string.h>

#include "od/little_endian.h"

/* kind u8, node-ID u8, UTC u64; then by kind:
 *   VALUES     counted u8, counter u16, count u8, fields: mapping u32, step f64, the value in as few bytes as it has
 *   STATE      i8
 *   EMCY       8 bytes
 *   ANSWER     the text */
enum { HEAD = 10, VALUES_HEAD = HEAD + 4, FIELD_HEAD = 12, LOWEST_STATE = -2, NODE_MAX = 127 };

_Static_assert(VALUES_HEAD + RECORD_FIELDS * (FIELD_HEAD + 1) <= RECORD_MAX, "fields of 8 PDOs, 64 bytes of values");
_Static_assert(HEAD + RECORD_TEXT_MAX <= RECORD_MAX, "a text");

size_t record_field_size(const struct record_field *field)
{
	return ((field->mapping & 0xFF) + 7) / 8;
}

static size_t encode_values(const struct record *record, uint8_t *bytes)
{
	size_t size = VALUES_HEAD;

	bytes[HEAD] = record->counted;
	put_u16(bytes + HEAD + 1, record->counter);
	bytes[HEAD + 3] = (uint8_t)record->field_count;
	for (size_t i = 0; i < record->field_count; i++) {
		const struct record_field *field = &record->fields[i];
		size_t length = record_field_size(field);
		uint64_t step;

		assert(size + FIELD_HEAD + length <= RECORD_MAX);
		memcpy(&step, &field->step, sizeof(step));
		put_u32(bytes + size, field->mapping);
		put_uint(bytes + size + 4, step, 8);
		put_uint(bytes + size + FIELD_HEAD, field->wire, length);
		size += FIELD_HEAD + length;
	}
	return size;
}

size_t record_encode(const struct record *record, uint8_t bytes[RECORD_MAX])
{
	bytes[0] = (uint8_t)record->kind;
	bytes[1] = record->node_id;
	put_uint(bytes + 2, (uint64_t)record->utc_us, 8);
	switch (record->kind) {
	case RECORD_VALUES:
		return encode_values(record, bytes);
	case RECORD_STATE:
		bytes[HEAD] = (uint8_t)record->nmt_state;
		return HEAD + 1;
	case RECORD_EMCY:
		memcpy(bytes + HEAD, record->emcy, sizeof(record->emcy));
		return HEAD + sizeof(record->emcy);
	case RECORD_CONFIGURED:
		break;
	case RECORD_ANSWER:
		memcpy(bytes + HEAD, record->text, strlen(record->text));
		return HEAD + strlen(record->text);
	}
	return HEAD;
}

static int decode_values(struct record *record, const uint8_t *bytes, size_t size)
{
	size_t at = VALUES_HEAD;

	if (size < VALUES_HEAD || bytes[HEAD] > 1 || bytes[HEAD + 3] > RECORD_FIELDS)
		return -EINVAL;
	record->counted = bytes[HEAD];
	record->counter = get_u16(bytes + HEAD + 1);
	record->field_count = bytes[HEAD + 3];
	for (size_t i = 0; i < record->field_count; i++) {
		struct record_field *field = &record->fields[i];
		uint64_t step;

		if (size - at < FIELD_HEAD)
			return -EINVAL;
		field->mapping = get_u32(bytes + at);
		step = get_uint(bytes + at + 4, 8);
		memcpy(&field->step, &step, sizeof(step));
		size_t length = record_field_size(field);
		if (length < 1 || length > 8 || !isfinite(field->step) || size - at - FIELD_HEAD < length)
			return -EINVAL;
		field->wire = get_uint(bytes + at + FIELD_HEAD, length);
		at += FIELD_HEAD + length;
	}
	return at == size ? 0 : -EINVAL;
}

int record_decode(struct record *record, const uint8_t *bytes, size_t size)
{
	if (size < HEAD || size > RECORD_MAX || bytes[1] < 1 || bytes[1] > NODE_MAX)
		return -EINVAL;
	*record = (struct record){
		.kind = (enum record_kind)bytes[0],
		.node_id = bytes[1],
		.utc_us = (int64_t)get_uint(bytes + 2, 8),
	};
	size_t rest = size - HEAD;
	switch (record->kind) {
	case RECORD_VALUES:
		return decode_values(record, bytes, size);
	case RECORD_STATE:
		record->nmt_state = rest == 1 ? (int)sign_extend(bytes[HEAD], 1) : 0;
		return rest == 1 && record->nmt_state >= LOWEST_STATE ? 0 : -EINVAL;
	case RECORD_EMCY:
		if (rest != sizeof(record->emcy))
			return -EINVAL;
		memcpy(record->emcy, bytes + HEAD, rest);
		return 0;
	case RECORD_CONFIGURED:
		return rest == 0 ? 0 : -EINVAL;
	case RECORD_ANSWER:
		if (rest >= sizeof(record->text) || memchr(bytes + HEAD, '\0', rest))
			return -EINVAL;
		memcpy(record->text, bytes + HEAD, rest);
		return 0;
	}
	return -EINVAL;
}
