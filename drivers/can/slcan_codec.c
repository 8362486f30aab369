#include "drivers/can/slcan_codec.h"

#include <string.h>

enum { CR = '\r', LF = '\n', BEL = '\a', TIME_DIGITS = 4 };

static size_t put_hex(char *out, uint32_t value, size_t digits)
{
	for (size_t i = 0; i < digits; i++)
		out[i] = "0123456789ABCDEF"[value >> 4 * (digits - 1 - i) & 15];
	return digits;
}

size_t slcan_encode(const struct can_msg *msg, char out[SLCAN_LINE_MAX])
{
	size_t n = 0;

	out[n++] = msg->remote ? (msg->extended ? 'R' : 'r') : (msg->extended ? 'T' : 't');
	n += put_hex(out + n, msg->id, msg->extended ? 8 : 3);
	n += put_hex(out + n, msg->len, 1);
	for (size_t i = 0; !msg->remote && i < msg->len; i++)
		n += put_hex(out + n, msg->data[i], 2);
	out[n++] = CR;
	return n;
}

char slcan_bit_rate_code(uint32_t bit_s)
{
	static const uint32_t rates[] = {10000, 20000, 50000, 100000, 125000, 250000, 500000, 800000, 1000000};

	for (size_t i = 0; i < sizeof(rates) / sizeof(rates[0]); i++)
		if (rates[i] == bit_s)
			return (char)('0' + i);
	return '\0';
}

static bool get_hex(const char *in, size_t digits, uint32_t *value)
{
	static const char hex[] = "0123456789ABCDEF0123456789abcdef";

	*value = 0;
	for (size_t i = 0; i < digits; i++) {
		const char *digit = in[i] ? strchr(hex, in[i]) : NULL;

		if (digit == NULL)
			return false;
		*value = *value << 4 | (uint32_t)((digit - hex) % 16);
	}
	return true;
}

static bool get_frame(const char *line, size_t length, struct can_msg *msg)
{
	size_t id_digits = line[0] == 'T' || line[0] == 'R' ? 8 : 3, head = 1 + id_digits + 1;
	uint32_t len, value;

	memset(msg, 0, sizeof(*msg));
	msg->extended = id_digits == 8;
	msg->remote = line[0] == 'r' || line[0] == 'R';
	if (length < head || !get_hex(line + 1, id_digits, &msg->id) || !get_hex(line + 1 + id_digits, 1, &len) ||
		len > 8 || msg->id > (msg->extended ? 0x1FFFFFFFu : 0x7FFu))
		return false;
	msg->len = (uint8_t)len;
	size_t data_digits = msg->remote ? 0 : 2 * len;

	if (length != head + data_digits && length != head + data_digits + TIME_DIGITS)
		return false;
	for (size_t i = 0; i < data_digits / 2; i++) {
		if (!get_hex(line + head + 2 * i, 2, &value))
			return false;
		msg->data[i] = (uint8_t)value;
	}
	return true; /* the time stamp is not used: it has 1 ms and wraps every minute */
}

static enum slcan_kind parse_line(struct slcan_reader *r)
{
	uint32_t flags;

	if (r->length == 0)
		return SLCAN_OK;
	switch (r->line[0]) {
	case 't':
	case 'T':
	case 'r':
	case 'R':
		return get_frame(r->line, r->length, &r->msg) ? SLCAN_FRAME : SLCAN_BAD;
	case 'z':
	case 'Z':
		return r->length == 1 ? SLCAN_SENT : SLCAN_BAD;
	case 'F':
		if (r->length != 3 || !get_hex(r->line + 1, 2, &flags))
			return SLCAN_BAD;
		r->flags = (uint8_t)flags;
		return SLCAN_STATUS;
	case 'V':
	case 'v':
	case 'N':
		return SLCAN_OTHER;
	default:
		return SLCAN_BAD;
	}
}

enum slcan_kind slcan_read(struct slcan_reader *r, char byte)
{
	enum slcan_kind kind;

	if (byte == LF && r->length == 0)
		return SLCAN_NOTHING;
	if (byte != CR && byte != LF && byte != BEL) {
		if (r->length < sizeof(r->line))
			r->line[r->length++] = byte;
		else
			r->skipping = true;
		return SLCAN_NOTHING;
	}
	if (r->skipping)
		kind = SLCAN_BAD;
	else if (byte == BEL)
		kind = r->length == 0 ? SLCAN_REFUSED : SLCAN_BAD;
	else
		kind = parse_line(r);
	r->length = 0;
	r->skipping = false;
	return kind;
}
