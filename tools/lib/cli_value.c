#include "tools/lib/cli_value.h"

#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "od/little_endian.h"
#include "tools/lib/cli.h"

/* 0x1A or 1Ah; plain decimal only where `decimal` says so. */
static bool object_number(const char *text, size_t length, bool decimal, long high, long *value)
{
	char copy[16] = "0x";

	if (length == 0 || length > 8)
		return false;
	if (length > 1 && tolower((unsigned char)text[length - 1]) == 'h') {
		memcpy(copy + 2, text, length - 1);
		return cli_integer(copy, 0, high, value);
	}
	memcpy(copy, text, length);
	copy[length] = '\0';
	return (decimal || strncasecmp(copy, "0x", 2) == 0) && cli_integer(copy, 0, high, value);
}

bool cli_address(const char *text, uint16_t *index, uint8_t *sub)
{
	size_t length = strcspn(text, ":");
	const char *rest = text[length] ? text + length + 1 : "0";
	long i, s;

	if (!object_number(text, length, false, 0xFFFF, &i) || !object_number(rest, strlen(rest), true, 0xFF, &s))
		return false;
	*index = (uint16_t)i;
	*sub = (uint8_t)s;
	return true;
}

void cli_address_text(uint16_t index, uint8_t sub, const struct od_entry *entry, char *text, size_t capacity)
{
	if (entry)
		snprintf(text, capacity, "%s (%04Xh:%02X)", entry->name, index, sub);
	else
		snprintf(text, capacity, "%04Xh:%02X", index, sub);
}

static bool is_signed(const struct od_entry *entry)
{
	return entry->type == OD_INTEGER8 || entry->type == OD_INTEGER16 || entry->type == OD_INTEGER32 ||
	       entry->type == OD_INTEGER64;
}

static bool is_number(const struct od_entry *entry)
{
	return entry->type != OD_VISIBLE_STRING && entry->type != OD_OCTET_STRING && entry->type != OD_DOMAIN;
}

double cli_number(const struct od_entry *entry, const void *wire)
{
	const uint8_t *bytes = wire;
	uint64_t raw = 0;
	float real32;
	double real64;

	if (!is_number(entry) || entry->size == 0)
		return 0;
	for (size_t i = 0; i < entry->size; i++)
		raw |= (uint64_t)bytes[i] << 8 * i;
	if (entry->type == OD_REAL32) {
		uint32_t bits = (uint32_t)raw;

		memcpy(&real32, &bits, sizeof(real32));
		return (double)real32;
	}
	if (entry->type == OD_REAL64) {
		memcpy(&real64, &raw, sizeof(real64));
		return real64;
	}
	if (is_signed(entry)) {
		unsigned int unused = 64 - 8 * (unsigned int)entry->size;

		return (double)((int64_t)(raw << unused) >> unused);
	}
	return (double)raw;
}

void cli_hex_text(const void *wire, size_t size, char *text, size_t capacity)
{
	const uint8_t *bytes = wire;
	size_t used = 0;

	text[0] = '\0';
	for (size_t i = 0; i < size && used + 8 < capacity; i++) {
		if (i == 32) {
			snprintf(text + used, capacity - used, " ...");
			return;
		}
		used += (size_t)snprintf(text + used, capacity - used, i ? " %02X" : "%02X", bytes[i]);
	}
}

void cli_value_text(
	const struct od_entry *entry, double step, const void *wire, size_t size, char *text, size_t capacity)
{
	char plain[CLI_VALUE_TEXT_MAX], words[CLI_VALUE_TEXT_MAX] = "";

	if (is_number(entry) && size != entry->size) {
		cli_hex_text(wire, size, plain, sizeof(plain));
		snprintf(text, capacity, "%s (%zu bytes where the EDS says %u)", plain, size, entry->size);
		return;
	}
	if (od_format(entry, wire, size, plain, sizeof(plain)) < 0)
		cli_hex_text(wire, size, plain, sizeof(plain));
	if (is_number(entry))
		od_words_text(entry, get_uint(wire, size), words, sizeof(words));
	if (words[0])
		snprintf(text, capacity, "%s", words);
	else if (is_number(entry) && step != 1)
		snprintf(text, capacity, "%s (%.9g%s%s)", plain, cli_number(entry, wire) * step,
			entry->unit[0] ? " " : "", entry->unit);
	else if (entry->unit[0])
		snprintf(text, capacity, "%s %s", plain, entry->unit);
	else if (entry->type == OD_UNSIGNED32 && entry->index < 0x2000)
		snprintf(text, capacity, "%s (0x%08X)", plain, (unsigned int)cli_number(entry, wire));
	else
		snprintf(text, capacity, "%s", plain);
}

static enum od_status hex_bytes(const char *text, uint8_t *wire, size_t capacity, size_t *size)
{
	size_t n = strlen(text);

	if (n % 2 || strspn(text, "0123456789abcdefABCDEF") != n)
		return OD_BAD_VALUE;
	if (n / 2 > capacity)
		return OD_TOO_LONG;
	for (size_t i = 0; i < n / 2; i++) {
		char digits[] = {text[2 * i], text[2 * i + 1], '\0'};

		wire[i] = (uint8_t)strtoul(digits, NULL, 16);
	}
	*size = n / 2;
	return OD_OK;
}

enum od_status cli_typed_value(const char *text, void *wire, size_t capacity, size_t *size)
{
	static const struct {
		const char *prefix;
		uint8_t type, size;
	} types[] = {
		{"bool", OD_BOOLEAN, 1},
		{"i8", OD_INTEGER8, 1},
		{"i16", OD_INTEGER16, 2},
		{"i32", OD_INTEGER32, 4},
		{"i64", OD_INTEGER64, 8},
		{"u8", OD_UNSIGNED8, 1},
		{"u16", OD_UNSIGNED16, 2},
		{"u32", OD_UNSIGNED32, 4},
		{"u64", OD_UNSIGNED64, 8},
		{"r32", OD_REAL32, 4},
		{"r64", OD_REAL64, 8},
		{"str", OD_VISIBLE_STRING, OD_VALUE_MAX},
	};
	size_t length = strcspn(text, ":");
	const char *value = text + length + 1;

	if (text[length] == '\0')
		return OD_BAD_VALUE;
	if (length == 3 && strncmp(text, "hex", 3) == 0)
		return hex_bytes(value, wire, capacity, size);
	for (size_t i = 0; i < sizeof(types) / sizeof(types[0]); i++) {
		struct od_entry entry = {.type = types[i].type, .size = types[i].size};

		entry.name = entry.unit = entry.description = "";
		entry.factor = 1;
		if (strlen(types[i].prefix) == length && strncmp(text, types[i].prefix, length) == 0)
			return od_parse(&entry, value, wire, capacity, size);
	}
	return OD_BAD_VALUE;
}
