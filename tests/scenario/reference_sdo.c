/* The SDO server of the model (CiA 301, 7.2.4): 1200h to 1207h. */
#include <string.h>

#include "tests/scenario/reference.h"

enum { PATIENCE_US = 1000000, NUDGE_US = 500000 };

#define TOO_LONG  0x06070012u
#define TOO_SHORT 0x06070013u

uint16_t reference_crc(const uint8_t *data, size_t size)
{
	unsigned crc = 0;

	for (size_t i = 0; i < size * 8; i++) {
		unsigned bit = (unsigned)data[i / 8] >> (7 - i % 8) & 1u;

		crc = (crc << 1) ^ ((crc >> 15 ^ bit) & 1u ? 0x1021u : 0);
	}
	return (uint16_t)crc;
}

void ref_sdo_stop(struct reference *r)
{
	for (int i = 0; i < REF_CHANNELS; i++)
		r->sdo[i].state = REF_IDLE;
	r->sdo[0].request = 0x600u + r->node_id;
	r->sdo[0].response = 0x580u + r->node_id;
}

void ref_sdo_open(struct reference *r, uint16_t index)
{
	uint32_t request = ref_value(r, index, 1), response = ref_value(r, index, 2);
	struct reference_transfer *t = &r->sdo[index & 7];

	t->state = REF_IDLE;
	t->request = request >> 31 || response >> 31 ? 0 : request;
	if (t->request)
		t->response = response;
}

static void respond(struct reference *r, struct reference_transfer *t, uint8_t command, uint32_t value)
{
	uint8_t data[8] = {command, (uint8_t)t->index, (uint8_t)(t->index >> 8), t->sub};

	for (int i = 0; i < 4; i++)
		data[4 + i] = (uint8_t)(value >> 8 * i);
	ref_send(r, t->response, data, 8);
}

static void abort_with(struct reference *r, struct reference_transfer *t, uint32_t code)
{
	t->state = REF_IDLE;
	respond(r, t, 0x80, code);
}

static void expect(struct reference *r, struct reference_transfer *t, enum reference_transfer_state state)
{
	t->state = state;
	t->timeout_us = r->now_us + PATIENCE_US;
}

static void begin(struct reference_transfer *t, const uint8_t *f)
{
	t->state = REF_IDLE;
	t->index = (uint16_t)(f[1] | f[2] << 8);
	t->sub = f[3];
	t->done = t->toggle = t->sequence = 0;
	t->last = false;
}

static struct reference_object *object(struct reference *r, const struct reference_transfer *t, uint32_t *code)
{
	struct reference_object *o = reference_find(r, t->index, t->sub);

	*code = o ? 0 : reference_knows(r, t->index) ? 0x06090011 : 0x06020000;
	return o;
}

/* ---- download ---------------------------------------------------------------------------------------------------- */

static uint32_t may_download(struct reference *r, struct reference_transfer *t, bool sized, size_t size)
{
	uint32_t code;
	const struct reference_object *o = object(r, t, &code);

	if (!o)
		return code;
	if (!(o->flags & REF_WRITE))
		return 0x06010002;
	t->sized = sized;
	t->size = o->flags & REF_DOMAIN ? REF_DOMAIN_MAX : o->size;
	if (sized && size > t->size)
		return TOO_LONG;
	if (sized && size < t->size && !(o->flags & (REF_STRING | REF_DOMAIN)))
		return TOO_SHORT;
	if (sized)
		t->size = size;
	return 0;
}

static void append(struct reference *r, struct reference_transfer *t, const uint8_t answer[8])
{
	uint32_t code = ref_write(r, t->index, t->sub, t->data, t->done);

	t->state = REF_IDLE;
	if (code == REF_ABORT_LATER) {
		t->state = REF_PENDING;
		memcpy(t->answer, answer, 8);
	} else if (code) {
		abort_with(r, t, code);
	} else {
		ref_send(r, t->response, answer, 8);
	}
}

void ref_sdo_done(struct reference *r, bool stored)
{
	for (int i = 0; i < REF_CHANNELS; i++) {
		struct reference_transfer *t = &r->sdo[i];

		if (t->state != REF_PENDING)
			continue;
		t->state = REF_IDLE;
		if (stored)
			ref_send(r, t->response, t->answer, 8);
		else
			abort_with(r, t, 0x08000020);
	}
}

static void download(struct reference *r, struct reference_transfer *t, const uint8_t *f)
{
	const uint8_t answer[8] = {0x60, f[1], f[2], f[3]};
	bool expedited = f[0] & 2, sized = f[0] & 1;
	uint32_t code;

	begin(t, f);
	code = may_download(r, t, sized, expedited ? 4u - (f[0] >> 2 & 3) : ref_u32(f + 4));
	if (code) {
		abort_with(r, t, code);
	} else if (expedited) {
		t->done = t->size > 4 ? 4 : t->size;
		memcpy(t->data, f + 4, 4);
		append(r, t, answer);
	} else {
		expect(r, t, REF_DOWNLOAD);
		ref_send(r, t->response, answer, 8);
	}
}

static void download_segment(struct reference *r, struct reference_transfer *t, const uint8_t *f)
{
	const uint8_t answer[8] = {(uint8_t)(0x20 | t->toggle << 4)};
	size_t n = 7u - (f[0] >> 1 & 7);

	if (t->done + n > t->size) {
		abort_with(r, t, TOO_LONG);
		return;
	}
	memcpy(t->data + t->done, f + 1, n);
	t->done += n;
	t->toggle ^= 1;
	if (!(f[0] & 1)) {
		expect(r, t, REF_DOWNLOAD);
		ref_send(r, t->response, answer, 8);
	} else if (t->sized && t->done != t->size) {
		abort_with(r, t, TOO_SHORT);
	} else {
		append(r, t, answer);
	}
}

static void block_download(struct reference *r, struct reference_transfer *t, const uint8_t *f)
{
	uint32_t code;

	begin(t, f);
	t->crc = f[0] & 4;
	code = may_download(r, t, f[0] & 2, ref_u32(f + 4));
	if (code) {
		abort_with(r, t, code);
		return;
	}
	expect(r, t, REF_BLOCK_DOWNLOAD);
	t->nudge_us = r->now_us + NUDGE_US;
	respond(r, t, 0xA4, REF_BLOCK_SIZE);
}

static void acknowledge(struct reference *r, struct reference_transfer *t)
{
	const uint8_t answer[8] = {0xA2, t->sequence, REF_BLOCK_SIZE};

	t->sequence = 0;
	t->nudge_us = r->now_us + NUDGE_US;
	if (t->last)
		t->state = REF_BLOCK_DOWNLOAD_END;
	ref_send(r, t->response, answer, 8);
}

static void block_segment(struct reference *r, struct reference_transfer *t, const uint8_t *f)
{
	unsigned sequence = f[0] & 127u;

	if (sequence == 0) {
		abort_with(r, t, 0x05040003);
		return;
	}
	expect(r, t, REF_BLOCK_DOWNLOAD);
	t->nudge_us = r->now_us + NUDGE_US;
	if (sequence == t->sequence + 1u) {
		if (t->done && t->done >= t->size) {
			abort_with(r, t, TOO_LONG);
			return;
		}
		memcpy(t->data + t->done, f + 1, 7);
		t->done += 7;
		t->sequence = (uint8_t)sequence;
		t->last = f[0] & 0x80;
	}
	if (f[0] & 0x80 || sequence == REF_BLOCK_SIZE)
		acknowledge(r, t);
}

static void block_download_end(struct reference *r, struct reference_transfer *t, const uint8_t *f)
{
	static const uint8_t answer[8] = {0xA1};

	t->done -= f[0] >> 2 & 7u;
	if (t->done > t->size)
		abort_with(r, t, TOO_LONG);
	else if (t->sized && t->done < t->size)
		abort_with(r, t, TOO_SHORT);
	else if (t->crc && reference_crc(t->data, t->done) != (f[1] | f[2] << 8))
		abort_with(r, t, 0x05040004);
	else
		append(r, t, answer);
}

/* ---- upload ------------------------------------------------------------------------------------------------------ */

static uint32_t may_upload(struct reference *r, struct reference_transfer *t)
{
	uint32_t code;
	const struct reference_object *o = object(r, t, &code);

	if (!o)
		return code;
	if (t->index == 0x1003 && t->sub > r->history_count)
		return 0x08000024;
	if (!(o->flags & REF_READ))
		return 0x06010001;
	if (t->index == 0x1021) {
		t->size = 1000;
		memcpy(t->data, r->long_domain, t->size);
	} else if (o->flags & REF_DOMAIN) {
		t->size = r->domain_size;
		memcpy(t->data, r->domain, t->size);
	} else if (o->flags & REF_STRING) {
		const char *text = t->index == 0x1008 ? "IMU9 CANopen gateway" : r->text;

		t->size = strlen(text);
		memcpy(t->data, text, t->size);
	} else {
		t->size = o->size;
		for (unsigned i = 0; i < 4; i++)
			t->data[i] = (uint8_t)(o->value >> 8 * i);
	}
	return 0;
}

static void start_upload(struct reference *r, struct reference_transfer *t)
{
	if (t->size == 0 || t->size > 4) {
		expect(r, t, REF_UPLOAD);
		respond(r, t, 0x41, (uint32_t)t->size);
		return;
	}
	memset(t->data + t->size, 0, 4 - t->size);
	respond(r, t, (uint8_t)(0x43 | (4 - t->size) << 2), ref_u32(t->data));
}

static void upload(struct reference *r, struct reference_transfer *t, const uint8_t *f)
{
	uint32_t code;

	begin(t, f);
	code = may_upload(r, t);
	if (code)
		abort_with(r, t, code);
	else
		start_upload(r, t);
}

static void upload_segment(struct reference *r, struct reference_transfer *t)
{
	size_t n = t->size - t->done > 7 ? 7 : t->size - t->done;
	bool last = t->done + n == t->size;
	uint8_t answer[8] = {(uint8_t)((unsigned)t->toggle << 4 | (7 - n) << 1 | last)};

	memcpy(answer + 1, t->data + t->done, n);
	t->done += n;
	t->toggle ^= 1;
	expect(r, t, last ? REF_IDLE : REF_UPLOAD);
	ref_send(r, t->response, answer, 8);
}

static void block_upload(struct reference *r, struct reference_transfer *t, const uint8_t *f)
{
	uint32_t code;

	begin(t, f);
	t->crc = f[0] & 4;
	t->block_size = f[4];
	code = may_upload(r, t);
	if (!code && (f[4] < 1 || f[4] > 127))
		code = 0x05040002;
	if (code) {
		abort_with(r, t, code);
	} else if (f[5] && t->size <= f[5]) {
		start_upload(r, t);
	} else {
		expect(r, t, REF_BLOCK_UPLOAD_START);
		respond(r, t, 0xC6, (uint32_t)t->size);
	}
}

/* Sixteen segments at a time, a microsecond apart. */
static void send_sub_block(struct reference *r, struct reference_transfer *t)
{
	size_t segments = t->size == t->done ? 1 : (t->size - t->done + 6) / 7;

	expect(r, t, REF_BLOCK_UPLOAD);
	if (segments > t->block_size)
		segments = t->block_size;
	for (size_t i = 0; i < segments; i++) {
		size_t at = t->done + i * 7, n = t->size - at > 7 ? 7 : t->size - at;
		uint8_t f[8] = {(uint8_t)(i + 1)};

		if (at + n == t->size)
			f[0] |= 0x80;
		memcpy(f + 1, t->data + at, n);
		ref_send(r, t->response, f, 8);
	}
	t->sequence = (uint8_t)segments;
	t->timeout_us += (segments - 1) / 16;
}

static void block_acknowledged(struct reference *r, struct reference_transfer *t, uint8_t sequence, uint8_t next)
{
	size_t bytes = sequence * 7u, left = t->size - t->done;
	uint8_t end[8] = {0xC1};
	uint16_t crc = t->crc ? reference_crc(t->data, t->size) : 0;
	size_t in_last = t->size % 7 ? t->size % 7 : t->size ? 7 : 0;

	if (sequence > t->sequence) {
		abort_with(r, t, 0x05040003);
		return;
	}
	if (sequence > 0 && bytes >= left) {
		end[0] |= (uint8_t)((7 - in_last) << 2);
		end[1] = (uint8_t)crc;
		end[2] = (uint8_t)(crc >> 8);
		expect(r, t, REF_BLOCK_UPLOAD_END);
		ref_send(r, t->response, end, 8);
		return;
	}
	if (next < 1 || next > 127) {
		abort_with(r, t, 0x05040002);
		return;
	}
	t->done += bytes;
	t->block_size = next;
	send_sub_block(r, t);
}

/* ---- frames ------------------------------------------------------------------------------------------------------ */

static bool block_frame(struct reference *r, struct reference_transfer *t, const uint8_t *f)
{
	if (f[0] >> 5 == 6 && !(f[0] & 1))
		block_download(r, t, f);
	else if (f[0] >> 5 == 6 && t->state == REF_BLOCK_DOWNLOAD_END)
		block_download_end(r, t, f);
	else if (f[0] >> 5 == 5 && (f[0] & 3) == 0)
		block_upload(r, t, f);
	else if (f[0] >> 5 == 5 && (f[0] & 3) == 3 && t->state == REF_BLOCK_UPLOAD_START)
		send_sub_block(r, t);
	else if (f[0] >> 5 == 5 && (f[0] & 3) == 2 && t->state == REF_BLOCK_UPLOAD)
		block_acknowledged(r, t, f[1], f[2]);
	else if (f[0] >> 5 == 5 && (f[0] & 3) == 1 && t->state == REF_BLOCK_UPLOAD_END)
		t->state = REF_IDLE;
	else
		return false;
	return true;
}

static bool segment_frame(struct reference *r, struct reference_transfer *t, const uint8_t *f)
{
	bool up = f[0] >> 5 == 3 && t->state == REF_UPLOAD, down = f[0] >> 5 == 0 && t->state == REF_DOWNLOAD;

	if (!up && !down)
		return false;
	if ((f[0] >> 4 & 1) != t->toggle)
		abort_with(r, t, 0x05030000);
	else if (up)
		upload_segment(r, t);
	else
		download_segment(r, t, f);
	return true;
}

static void frame(struct reference *r, struct reference_transfer *t, const uint8_t *f)
{
	if (t->state == REF_BLOCK_DOWNLOAD && f[0] != 0x80 && (f[0] & 127) <= REF_BLOCK_SIZE) {
		block_segment(r, t, f);
		return;
	}
	if (block_frame(r, t, f) || segment_frame(r, t, f))
		return;
	switch (f[0] >> 5) {
	case 1:
		download(r, t, f);
		break;
	case 2:
		upload(r, t, f);
		break;
	case 4:
		t->state = REF_IDLE;
		break;
	default:
		if (t->state == REF_IDLE)
			begin(t, f);
		abort_with(r, t, 0x05040001);
	}
}

bool ref_sdo_receive(struct reference *r, const struct can_msg *msg)
{
	for (int i = 0; i < REF_CHANNELS; i++) {
		if (!r->sdo[i].request || msg->id != r->sdo[i].request)
			continue;
		if (msg->len == 8 && ref_talks(r))
			frame(r, &r->sdo[i], msg->data);
		return true;
	}
	return false;
}

uint64_t ref_sdo_tick(struct reference *r)
{
	uint64_t next = UINT64_MAX;

	for (int i = 0; i < REF_CHANNELS; i++) {
		struct reference_transfer *t = &r->sdo[i];

		if (t->state == REF_IDLE || t->state == REF_PENDING)
			continue;
		if (t->state == REF_BLOCK_DOWNLOAD && r->now_us >= t->nudge_us) {
			acknowledge(r, t);
			t->nudge_us = UINT64_MAX;
		}
		if (r->now_us >= t->timeout_us) {
			abort_with(r, t, 0x05040000);
			continue;
		}
		next = ref_earlier(next, t->timeout_us);
		if (t->state == REF_BLOCK_DOWNLOAD)
			next = ref_earlier(next, t->nudge_us);
	}
	return next;
}
