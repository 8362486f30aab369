#include "tools/eds/eds_value.h"

#include <ctype.h>
#include <errno.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

static const struct eds_type TYPES[] = {
	{OD_BOOLEAN, OD_BOOLEAN, 1, 1, false, false},
	{OD_INTEGER8, OD_INTEGER8, 1, 8, true, false},
	{OD_INTEGER16, OD_INTEGER16, 2, 16, true, false},
	{OD_INTEGER32, OD_INTEGER32, 4, 32, true, false},
	{OD_INTEGER64, OD_INTEGER64, 8, 64, true, false},
	{OD_UNSIGNED8, OD_UNSIGNED8, 1, 8, false, false},
	{OD_UNSIGNED16, OD_UNSIGNED16, 2, 16, false, false},
	{OD_UNSIGNED32, OD_UNSIGNED32, 4, 32, false, false},
	{OD_UNSIGNED64, OD_UNSIGNED64, 8, 64, false, false},
	{OD_REAL32, OD_REAL32, 4, 0, false, false},
	{OD_REAL64, OD_REAL64, 8, 0, false, false},
	{OD_VISIBLE_STRING, OD_VISIBLE_STRING, 0, 0, false, false},
	{OD_OCTET_STRING, OD_OCTET_STRING, 0, 0, false, false},
	{OD_DOMAIN, OD_DOMAIN, 0, 0, false, false},
	{0x0B, OD_OCTET_STRING, 0, 0, false, true}, /* UNICODE_STRING */
	{0x0C, OD_OCTET_STRING, 6, 0, false, true}, /* TIME_OF_DAY */
	{0x0D, OD_OCTET_STRING, 6, 0, false, true}, /* TIME_DIFFERENCE */
	{0x10, OD_OCTET_STRING, 3, 0, false, true}, /* INTEGER24, 40, 48, 56 */
	{0x12, OD_OCTET_STRING, 5, 0, false, true},
	{0x13, OD_OCTET_STRING, 6, 0, false, true},
	{0x14, OD_OCTET_STRING, 7, 0, false, true},
	{0x16, OD_OCTET_STRING, 3, 0, false, true}, /* UNSIGNED24, 40, 48, 56 */
	{0x18, OD_OCTET_STRING, 5, 0, false, true},
	{0x19, OD_OCTET_STRING, 6, 0, false, true},
	{0x1A, OD_OCTET_STRING, 7, 0, false, true},
};

const struct eds_type *eds_type_of(uint64_t code)
{
	for (size_t i = 0; i < sizeof(TYPES) / sizeof(*TYPES); i++)
		if (TYPES[i].code == code)
			return &TYPES[i];
	return NULL;
}

bool eds_is_real(const struct eds_type *type)
{
	return type->type == OD_REAL32 || type->type == OD_REAL64;
}

static bool is_hex(const char *text)
{
	return text[0] == '0' && (text[1] == 'x' || text[1] == 'X');
}

bool eds_parse_integer(const char *text, unsigned bits, bool is_signed, union od_number *out)
{
	bool negative = is_signed && *text == '-';
	const char *digits = text + negative;
	uint64_t all = UINT64_MAX >> (64 - bits), most = is_signed ? all >> 1 : all, value;
	char *end;

	if (!isdigit((unsigned char)*digits))
		return false;
	errno = 0;
	value = strtoull(digits, &end, 0);
	if (errno || *end)
		return false;
	if (negative) {
		out->u = -value;
		return value <= most + 1;
	}
	out->u = value;
	if (value > most && is_signed && is_hex(text))
		out->u |= ~all;
	return value <= (is_signed && is_hex(text) ? all : most);
}

bool eds_parse_real(const char *text, enum od_type type, union od_number *out)
{
	unsigned bits = type == OD_REAL32 ? 32 : 64;
	union od_number raw;
	char *end;

	if (is_hex(text)) {
		uint32_t low;
		float single;

		if (!eds_parse_integer(text, bits, false, &raw))
			return false;
		low = (uint32_t)raw.u;
		memcpy(&single, &low, sizeof(single));
		memcpy(&out->f, &raw.u, sizeof(out->f));
		if (type == OD_REAL32)
			out->f = (double)single;
		return isfinite(out->f);
	}
	out->f = strtod(text, &end);
	if (end == text || *end || !isfinite(out->f))
		return false;
	if (type == OD_REAL32) {
		if (fabs(out->f) > (double)FLT_MAX)
			return false;
		out->f = (double)(float)out->f;
	}
	return true;
}

bool eds_parse_number(const char *text, const struct eds_type *type, union od_number *out)
{
	if (eds_is_real(type))
		return eds_parse_real(text, type->type, out);
	return eds_parse_integer(text, type->bits, type->is_signed, out);
}

bool eds_is_above(const struct eds_type *type, union od_number a, union od_number b)
{
	if (eds_is_real(type))
		return a.f > b.f;
	return type->is_signed ? a.i > b.i : a.u > b.u;
}

bool eds_split_node_id(const char *text, char *rest, size_t capacity)
{
	static const char NODE_ID[] = "$NODEID";
	const size_t length = sizeof(NODE_ID) - 1;
	size_t n = 0;

	for (; *text && n + 1 < capacity; text++)
		if (!isspace((unsigned char)*text))
			rest[n++] = *text;
	rest[n] = '\0';
	if (!strcasecmp(rest, NODE_ID)) {
		strcpy(rest, "0");
		return true;
	}
	if (n > length && !strncasecmp(rest, NODE_ID, length) && rest[length] == '+') {
		memmove(rest, rest + length + 1, n - length);
		return true;
	}
	if (n > length && !strcasecmp(rest + n - length, NODE_ID) && rest[n - length - 1] == '+') {
		rest[n - length - 1] = '\0';
		return true;
	}
	return false;
}

int eds_parse_octets(const char *text, uint8_t *bytes, size_t capacity)
{
	static const char DIGITS[] = "0123456789abcdef";
	size_t digits = 0;
	unsigned value = 0;

	for (; *text; text++) {
		const char *digit = strchr(DIGITS, tolower((unsigned char)*text));

		if (*text == ' ')
			continue;
		if (!digit)
			return -1;
		value = (value << 4 | (unsigned)(digit - DIGITS)) & 0xFF;
		if (digits++ % 2 && bytes && digits / 2 <= capacity)
			bytes[digits / 2 - 1] = (uint8_t)value;
	}
	return digits % 2 ? -1 : (int)(digits / 2);
}
