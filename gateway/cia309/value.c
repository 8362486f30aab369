#include "gateway/cia309/value.h"

#include <ctype.h>
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "od/little_endian.h"
#include "od/od.h"

static const struct cia309_type TYPES[] = {
	{"b", 1, OD_BOOLEAN, CIA309_NUMBER},
	{"i8", 1, OD_INTEGER8, CIA309_NUMBER},
	{"i16", 2, OD_INTEGER16, CIA309_NUMBER},
	{"i32", 4, OD_INTEGER32, CIA309_NUMBER},
	{"i64", 8, OD_INTEGER64, CIA309_NUMBER},
	{"u8", 1, OD_UNSIGNED8, CIA309_NUMBER},
	{"u16", 2, OD_UNSIGNED16, CIA309_NUMBER},
	{"u32", 4, OD_UNSIGNED32, CIA309_NUMBER},
	{"u64", 8, OD_UNSIGNED64, CIA309_NUMBER},
	{"x8", 1, OD_UNSIGNED8, CIA309_HEX_NUMBER},
	{"x16", 2, OD_UNSIGNED16, CIA309_HEX_NUMBER},
	{"x32", 4, OD_UNSIGNED32, CIA309_HEX_NUMBER},
	{"x64", 8, OD_UNSIGNED64, CIA309_HEX_NUMBER},
	{"r32", 4, OD_REAL32, CIA309_NUMBER},
	{"r64", 8, OD_REAL64, CIA309_NUMBER},
	{"t", 6, .form = CIA309_TIME},
	{"td", 6, .form = CIA309_TIME},
	{"vs", .form = CIA309_STRING},
	{"os", .form = CIA309_BASE64},
	{"us", .form = CIA309_BASE64},
	{"d", .form = CIA309_BASE64},
};
const struct cia309_type CIA309_TYPE_HEX = {"hex", .form = CIA309_HEX};
const struct cia309_type CIA309_TYPE_RAW = {"", .form = CIA309_RAW};

const struct cia309_type *cia309_type(const char *name)
{
	for (size_t i = 0; i < sizeof(TYPES) / sizeof(TYPES[0]); i++)
		if (strcasecmp(TYPES[i].name, name) == 0)
			return &TYPES[i];
	return strcasecmp(name, CIA309_TYPE_HEX.name) == 0 ? &CIA309_TYPE_HEX : NULL;
}

/* ---- text to bytes ----------------------------------------------------------------------------------------------- */

/* What is left of the line, and where the bytes go. */
struct scan {
	const char *text, *end;
	uint8_t *bytes;
	size_t size, capacity;
	int error;
};

static bool is_blank(char c)
{
	return !isgraph((unsigned char)c);
}

static void skip_blanks(struct scan *s)
{
	while (s->text < s->end && is_blank(*s->text))
		s->text++;
}

/* At the end, but for blanks and a comment. */
static bool at_end(struct scan *s)
{
	skip_blanks(s);
	return s->text == s->end || *s->text == '#';
}

static void put(struct scan *s, unsigned byte)
{
	if (s->size == s->capacity)
		s->error = -ENOSPC;
	else
		s->bytes[s->size++] = (uint8_t)byte;
}

/* The next word into word[capacity]. False: there is none, or it is longer. */
static bool next_word(struct scan *s, char *word, size_t capacity)
{
	size_t n = 0;

	skip_blanks(s);
	while (s->text < s->end && !is_blank(*s->text) && *s->text != '#') {
		if (n + 1 == capacity)
			return false;
		word[n++] = *s->text++;
	}
	word[n] = '\0';
	return n > 0;
}

static bool scan_number(struct scan *s, enum od_type type, size_t size)
{
	const struct od_entry entry = {.type = (uint8_t)type, .size = (uint16_t)size};
	char word[48];
	size_t got;

	if (size > s->capacity - s->size) {
		s->error = -ENOSPC;
		return false;
	}
	if (!next_word(s, word, sizeof(word)) || od_parse(&entry, word, s->bytes + s->size, size, &got) != OD_OK ||
		got != size)
		return false;
	s->size += size;
	return true;
}

/* TIME_OF_DAY and TIME_DIFFERENCE: ms (28 bits), then days (CiA 301, 7.1.6.5). */
static bool scan_time(struct scan *s)
{
	uint8_t days[2] = {0};
	struct scan first = {.text = s->text, .end = s->end, .bytes = days, .capacity = sizeof(days)};

	if (!scan_number(&first, OD_UNSIGNED16, 2))
		return false;
	s->text = first.text;
	if (!scan_number(s, OD_UNSIGNED32, 4) || get_u32(s->bytes) >> 28)
		return false;
	put(s, days[0]);
	put(s, days[1]);
	return true;
}

static int digit(char c)
{
	return isdigit((unsigned char)c) ? c - '0' : tolower((unsigned char)c) - 'a' + 10;
}

/* Two digits are a byte, with blanks between bytes or not; one digit with a blank behind it, too. */
static bool scan_hex(struct scan *s)
{
	if (at_end(s))
		return false;
	while (!at_end(s)) {
		unsigned byte = 0;

		for (int i = 0; i < 2 && s->text < s->end && (i == 0 || !is_blank(*s->text)) && *s->text != '#'; i++) {
			if (!isxdigit((unsigned char)*s->text))
				return false;
			byte = byte << 4 | (unsigned)digit(*s->text++);
		}
		put(s, byte);
	}
	return true;
}

/* One word, or anything in quotes. In both a quote is written as two. */
static bool scan_string(struct scan *s)
{
	if (at_end(s))
		return false;
	bool quoted = *s->text == '"';
	s->text += quoted;
	while (s->text < s->end && (quoted || !is_blank(*s->text))) {
		if (*s->text == '"' && !(s->text + 1 < s->end && s->text[1] == '"'))
			break;
		s->text += *s->text == '"';
		put(s, (unsigned char)*s->text++);
	}
	if (quoted && s->text < s->end && *s->text == '"') {
		s->text++;
		quoted = false;
		if (s->text < s->end && !is_blank(*s->text))
			return false;
	}
	return !quoted;
}

static const char BASE64[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

static bool scan_base64(struct scan *s)
{
	unsigned bits = 0, count = 0, digits = 0;

	if (at_end(s))
		return false;
	while (s->text < s->end && !is_blank(*s->text) && *s->text != '=' && *s->text != '#') {
		const char *at = strchr(BASE64, *s->text++);

		if (!at)
			return false;
		bits = bits << 6 | (unsigned)(at - BASE64);
		digits++;
		if ((count += 6) >= 8)
			put(s, bits >> (count -= 8) & 0xFF);
	}
	while (s->text < s->end && *s->text == '=')
		s->text++;
	return digits % 4 != 1;
}

long cia309_scan(const struct cia309_type *type, const char *text, size_t length, uint8_t *bytes, size_t capacity)
{
	struct scan s = {.text = text, .end = text + length, .bytes = bytes, .capacity = capacity};
	bool good = false;

	switch (type->form) {
	case CIA309_NUMBER:
	case CIA309_HEX_NUMBER:
		good = scan_number(&s, type->od_type, type->size);
		break;
	case CIA309_TIME:
		good = scan_time(&s);
		break;
	case CIA309_HEX:
		good = scan_hex(&s);
		break;
	case CIA309_STRING:
		good = scan_string(&s);
		break;
	case CIA309_BASE64:
		good = scan_base64(&s);
		break;
	case CIA309_RAW:
		break;
	}
	if (s.error)
		return s.error;
	return good && at_end(&s) ? (long)s.size : -EINVAL;
}

/* ---- bytes to text ----------------------------------------------------------------------------------------------- */

static size_t print_number(struct cia309_printer *p, char *text, size_t capacity)
{
	const struct od_entry entry = {.type = p->type->od_type, .size = p->type->size};
	int n;

	if (p->type->form == CIA309_TIME)
		n = snprintf(text, capacity, "%u %u", get_u16(p->bytes + 4), get_u32(p->bytes) & 0x0FFFFFFF);
	else if (p->type->form == CIA309_HEX_NUMBER)
		n = snprintf(
			text, capacity, "0x%0*llX", 2 * p->type->size, (unsigned long long)get_uint(p->bytes, p->size));
	else
		n = od_format(&entry, p->bytes, p->size, text, capacity);
	p->done = p->size;
	p->closed = true;
	return n > 0 ? (size_t)n : 0;
}

static size_t print_hex(struct cia309_printer *p, char *text, size_t capacity)
{
	static const char DIGITS[] = "0123456789ABCDEF";
	size_t n = 0;

	for (; p->done < p->size && n + 3 <= capacity; p->done++) {
		if (p->done)
			text[n++] = ' ';
		text[n++] = DIGITS[p->bytes[p->done] >> 4];
		text[n++] = DIGITS[p->bytes[p->done] & 15];
	}
	p->closed = p->done == p->size;
	return n;
}

/* CR and NUL are left out: CR LF ends a response. */
static size_t print_string(struct cia309_printer *p, char *text, size_t capacity)
{
	bool quotes = p->type->form == CIA309_STRING;
	size_t n = 0;

	if (quotes && !p->opened)
		text[n++] = '"';
	p->opened = true;
	for (; p->done < p->size && n + 3 <= capacity; p->done++) {
		char c = (char)p->bytes[p->done];

		if (c == '\0' || c == '\r')
			continue;
		text[n++] = c;
		if (quotes && c == '"')
			text[n++] = c;
	}
	p->closed = p->done == p->size;
	if (quotes && p->closed)
		text[n++] = '"';
	return n;
}

static size_t print_base64(struct cia309_printer *p, char *text, size_t capacity)
{
	size_t n = 0;

	while (p->done < p->size && n + 4 <= capacity) {
		size_t left = p->size - p->done, take = left < 3 ? left : 3;
		unsigned bits = 0;

		for (size_t i = 0; i < 3; i++)
			bits = bits << 8 | (i < take ? p->bytes[p->done + i] : 0u);
		for (size_t i = 0; i < 4; i++)
			text[n++] = '=';
		for (size_t i = 0; i <= take; i++)
			text[n - 4 + i] = BASE64[bits >> (18 - 6 * i) & 63];
		p->done += take;
	}
	p->closed = p->done == p->size;
	return n;
}

size_t cia309_print(struct cia309_printer *p, char *text, size_t capacity)
{
	if (p->closed)
		return 0;
	switch (p->type->form) {
	case CIA309_STRING:
	case CIA309_RAW:
		return print_string(p, text, capacity);
	case CIA309_BASE64:
		return print_base64(p, text, capacity);
	case CIA309_NUMBER:
	case CIA309_HEX_NUMBER:
	case CIA309_TIME:
		if (p->size == p->type->size)
			return print_number(p, text, capacity);
		break;
	case CIA309_HEX:
		break;
	}
	return print_hex(p, text, capacity);
}

bool cia309_printed(const struct cia309_printer *p)
{
	return p->closed;
}
