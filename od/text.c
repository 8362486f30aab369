/* od/text.c
 * Names and values as text. */
#include "od/od.h"

#include <ctype.h>
#include <errno.h>
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "od/little_endian.h"

static bool is_name_character(char c)
{
	return isalnum((unsigned char)c) || c == '.';
}

/* Compares a name as entered with a normalised one. `whole`: a ParameterName of the EDS, as "Lever arm l" for
 * "lever_arm.l". */
static bool names_match(const char *typed, const char *name, bool whole)
{
	while (*typed) {
		if (is_name_character(*typed)) {
			if (tolower((unsigned char)*typed++) != *name++)
				return false;
			continue;
		}
		while (*typed && !is_name_character(*typed))
			typed++;
		if (*name != '_' && !(whole && *name == '.'))
			return false;
		name++;
	}
	return !*name;
}

/* "0x2000" or "2000h"; with `plain` also a decimal number (sub-index). Returns the rest of the text, or NULL. */
static const char *parse_index(const char *text, bool plain, unsigned long most, unsigned long *value)
{
	bool prefixed = text[0] == '0' && (text[1] == 'x' || text[1] == 'X');
	char *end;

	if (!isxdigit((unsigned char)text[0]))
		return NULL;
	*value = strtoul(text, &end, 16);
	if (!prefixed && (*end == 'h' || *end == 'H'))
		end++;
	else if (!prefixed && plain)
		*value = strtoul(text, &end, 10);
	else if (!prefixed)
		return NULL;
	return *value <= most ? end : NULL;
}

static const struct od_entry *find_number(const struct od_table *table, const char *text)
{
	unsigned long index, sub = 0;
	const char *end = parse_index(text, false, 0xFFFF, &index);

	if (end && *end == ':')
		end = parse_index(end + 1, true, 0xFF, &sub);
	if (!end || *end)
		return NULL;
	return od_find(table, (uint16_t)index, (uint8_t)sub, NULL);
}

const struct od_entry *od_find_name(const struct od_table *table, const char *name)
{
	for (int whole = 0; whole < 2; whole++)
		for (size_t i = 0; i < table->count; i++)
			if (names_match(name, table->entries[i].name, whole))
				return &table->entries[i];
	return find_number(table, name);
}

static enum od_status parse_unsigned(const char *text, unsigned bits, uint64_t *value)
{
	bool hex = text[0] == '0' && (text[1] == 'x' || text[1] == 'X');
	char *end;

	if (*text == '-' && isdigit((unsigned char)text[1]))
		return OD_TOO_LOW;
	if (!isdigit((unsigned char)*text))
		return OD_BAD_VALUE;
	errno = 0;
	*value = strtoull(text, &end, hex ? 16 : 10);
	if (*end)
		return OD_BAD_VALUE;
	return errno || *value > UINT64_MAX >> (64 - bits) ? OD_TOO_HIGH : OD_OK;
}

static enum od_status parse_signed(const char *text, unsigned bits, uint64_t *value)
{
	bool negative = *text == '-';
	uint64_t most = UINT64_MAX >> (65 - bits);
	enum od_status status;

	if (negative && text[1] == '-')
		return OD_BAD_VALUE;
	status = parse_unsigned(text + negative, 64, value);
	if (status == OD_BAD_VALUE)
		return status;
	if (status || *value > most + negative)
		return negative ? OD_TOO_LOW : OD_TOO_HIGH;
	if (negative)
		*value = -*value;
	return OD_OK;
}

static enum od_status parse_real(const char *text, enum od_type type, uint64_t *value)
{
	double most = type == OD_REAL32 ? (double)FLT_MAX : DBL_MAX, number;
	float real32;
	uint32_t bits;
	char *end;

	number = strtod(text, &end);
	if (end == text || *end || isnan(number) || (isinf(number) && strpbrk(text, "iI")))
		return OD_BAD_VALUE;
	if (fabs(number) > most)
		return number > 0 ? OD_TOO_HIGH : OD_TOO_LOW;
	if (type == OD_REAL64) {
		memcpy(value, &number, sizeof(number));
		return OD_OK;
	}
	real32 = (float)number;
	memcpy(&bits, &real32, sizeof(bits));
	*value = bits;
	return OD_OK;
}

static enum od_status parse_octets(const char *text, uint8_t *wire, size_t capacity, size_t *size)
{
	static const char DIGITS[] = "0123456789abcdef";
	size_t length = strlen(text);

	if (length % 2)
		return OD_BAD_VALUE;
	if (length / 2 > capacity)
		return OD_TOO_LONG;
	for (size_t i = 0; i < length; i++) {
		const char *digit = strchr(DIGITS, tolower((unsigned char)text[i]));

		if (!digit)
			return OD_BAD_VALUE;
		wire[i / 2] = (uint8_t)(wire[i / 2] << 4 | (digit - DIGITS));
	}
	*size = length / 2;
	return OD_OK;
}

bool od_has_words(const struct od_entry *entry)
{
	return entry && entry->words && entry->words[0];
}

bool od_next_word(const struct od_entry *entry, struct od_word *word)
{
	const char *at = word->text ? word->text + word->length : entry->words;
	unsigned number = word->text ? word->number + 1 : 0;

	if (!at)
		return false;
	at += strspn(at, ", ");
	if (isdigit((unsigned char)*at)) {
		number = (unsigned)strtoul(at, (char **)(uintptr_t)&at, 10);
		at += strspn(at, " ");
	}
	*word = (struct od_word){number, at, strcspn(at, ", ")};
	return word->length > 0;
}

static bool find_word(const struct od_entry *entry, const char *text, size_t length, uint64_t *value)
{
	struct od_word word = {0};

	while (od_next_word(entry, &word)) {
		if (word.length != length || strncasecmp(word.text, text, length) != 0)
			continue;
		*value |= entry->words_of_bits ? UINT64_C(1) << word.number : word.number;
		return true;
	}
	return false;
}

/* "rigid_body"; of bits "valid,rest" or "none". */
static enum od_status parse_words(const struct od_entry *entry, const char *text, uint64_t *value)
{
	*value = 0;
	if (!entry->words_of_bits)
		return find_word(entry, text, strlen(text), value) ? OD_OK : OD_BAD_VALUE;
	if (!strcasecmp(text, "none"))
		return OD_OK;
	for (;; text++) {
		size_t length = strcspn(text, ",");

		if (!find_word(entry, text, length, value))
			return OD_BAD_VALUE;
		text += length;
		if (!*text)
			return OD_OK;
	}
}

void od_words_text(const struct od_entry *entry, uint64_t value, char *text, size_t capacity)
{
	struct od_word word = {0};
	size_t used = 0;

	text[0] = '\0';
	if (!od_has_words(entry))
		return;
	if (!entry->words_of_bits) {
		while (od_next_word(entry, &word))
			if (word.number == value)
				snprintf(text, capacity, "%.*s", (int)word.length, word.text);
		return;
	}
	if (value == 0)
		snprintf(text, capacity, "none");
	for (unsigned bit = 0; bit < 64 && used < capacity; bit++) {
		if (!(value >> bit & 1))
			continue;
		for (word = (struct od_word){0}; od_next_word(entry, &word) && word.number != bit;)
			;
		if (word.length)
			used += (size_t)snprintf(
				text + used, capacity - used, "%s%.*s", used ? "," : "", (int)word.length, word.text);
		else
			used += (size_t)snprintf(text + used, capacity - used, "%sbit%u", used ? "," : "", bit);
	}
}

/* Blanks around the number are allowed, and true and false for 1 and 0. */
static enum od_status parse_number(const struct od_entry *entry, const char *text, uint64_t *value)
{
	unsigned bits = entry->type == OD_BOOLEAN ? 1 : 8u * entry->size;
	char word[256];
	size_t length;

	text += strspn(text, " \t");
	length = strlen(text);
	while (length && strchr(" \t\r\n", text[length - 1]))
		length--;
	if (length >= sizeof(word))
		return OD_BAD_VALUE;
	memcpy(word, text, length);
	word[length] = '\0';
	if (entry->type == OD_REAL32 || entry->type == OD_REAL64)
		return parse_real(word, entry->type, value);
	if (entry->words && parse_words(entry, word, value) == OD_OK)
		return OD_OK;
	if (!strcasecmp(word, "true") || !strcasecmp(word, "false")) {
		*value = tolower((unsigned char)*word) == 't';
		return OD_OK;
	}
	switch (entry->type) {
	case OD_INTEGER8:
	case OD_INTEGER16:
	case OD_INTEGER32:
	case OD_INTEGER64:
		return parse_signed(word, bits, value);
	default:
		return parse_unsigned(word, bits, value);
	}
}

enum od_status od_parse(const struct od_entry *entry, const char *text, void *wire, size_t capacity, size_t *size)
{
	size_t most = entry->size < capacity ? entry->size : capacity;
	enum od_status status;
	uint64_t value;

	switch (entry->type) {
	case OD_DOMAIN:
		return OD_UNSUPPORTED_ACCESS;
	case OD_OCTET_STRING:
		return parse_octets(text, wire, most, size);
	case OD_VISIBLE_STRING:
		*size = strlen(text);
		if (*size > most)
			return OD_TOO_LONG;
		if (*size)
			memcpy(wire, text, *size);
		return OD_OK;
	default:
		if (entry->size > capacity)
			return OD_TOO_LONG;
		status = parse_number(entry, text, &value);
		if (status)
			return status;
		*size = entry->size;
		put_uint(wire, value, entry->size);
		return OD_OK;
	}
}

/* The shortest decimal text that gives the same bits when read again. */
static void print_real(uint64_t raw, enum od_type type, char *text, size_t capacity)
{
	uint32_t bits = (uint32_t)raw;
	float real32;
	double real64;

	memcpy(&real32, &bits, sizeof(real32));
	memcpy(&real64, &raw, sizeof(real64));
	if (type == OD_REAL32) {
		for (int digits = 6; digits <= FLT_DECIMAL_DIG; digits++) {
			snprintf(text, capacity, "%.*g", digits, (double)real32);
			if (strtof(text, NULL) == real32)
				return;
		}
		return;
	}
	for (int digits = 15; digits <= DBL_DECIMAL_DIG; digits++) {
		snprintf(text, capacity, "%.*g", digits, real64);
		if (strtod(text, NULL) == real64)
			return;
	}
}

/* Control codes in the text of another device must not reach a terminal. VISIBLE_CHAR is 20h to 7Eh (CiA 301). */
static char printable(uint8_t c)
{
	return c < 0x20 || c > 0x7E ? '?' : (char)c;
}

static int print_string(const struct od_entry *entry, const uint8_t *wire, size_t size, char *text, size_t capacity)
{
	bool hex = entry->type == OD_OCTET_STRING;

	while (!hex && size && !wire[size - 1])
		size--;
	if (size >= (hex ? capacity / 2 + capacity % 2 : capacity))
		return -ENOSPC;
	for (size_t i = 0; i < size; i++) {
		if (hex)
			snprintf(text + 2 * i, 3, "%02x", wire[i]);
		else
			text[i] = printable(wire[i]);
	}
	size *= hex ? 2 : 1;
	text[size] = '\0';
	return (int)size;
}

int od_format(const struct od_entry *entry, const void *wire, size_t size, char *text, size_t capacity)
{
	char number[32];
	uint64_t raw;
	size_t length;

	if (entry->type == OD_VISIBLE_STRING || entry->type == OD_OCTET_STRING || entry->type == OD_DOMAIN)
		return print_string(entry, wire, size, text, capacity);
	if (size != entry->size)
		return -EINVAL;
	raw = get_uint(wire, size);
	switch (entry->type) {
	case OD_REAL32:
	case OD_REAL64:
		print_real(raw, entry->type, number, sizeof(number));
		break;
	case OD_INTEGER8:
	case OD_INTEGER16:
	case OD_INTEGER32:
	case OD_INTEGER64:
		snprintf(number, sizeof(number), "%lld", (long long)sign_extend(raw, size));
		break;
	default:
		snprintf(number, sizeof(number), "%llu", (unsigned long long)raw);
	}
	length = strlen(number);
	if (length >= capacity)
		return -ENOSPC;
	memcpy(text, number, length + 1);
	return (int)length;
}

double od_number_value(enum od_type type, union od_number number)
{
	switch (type) {
	case OD_REAL32:
	case OD_REAL64:
		return number.f;
	case OD_INTEGER8:
	case OD_INTEGER16:
	case OD_INTEGER32:
	case OD_INTEGER64:
		return (double)number.i;
	default:
		return (double)number.u;
	}
}

void od_limits_text(const struct od_entry *entry, char *text, size_t capacity)
{
	double low = od_number_value(entry->type, entry->low), high = od_number_value(entry->type, entry->high);
	const char *unit = entry->factor == 1 ? entry->unit : "", *space = unit[0] ? " " : "";

	text[0] = '\0';
	if (entry->access & OD_LIMIT_LOW && entry->access & OD_LIMIT_HIGH)
		snprintf(text, capacity, "%.10g to %.10g%s%s", low, high, space, unit);
	else if (entry->access & OD_LIMIT_LOW)
		snprintf(text, capacity, "%.10g%s%s or more", low, space, unit);
	else if (entry->access & OD_LIMIT_HIGH)
		snprintf(text, capacity, "%.10g%s%s or less", high, space, unit);
}

const char *od_status_text(enum od_status status)
{
	switch (status) {
	case OD_OK:
		return "done";
	case OD_CONSUMED:
		return "command executed";
	case OD_PENDING:
		return "accepted, not completed yet";
	case OD_NO_OBJECT:
		return "no such object";
	case OD_NO_SUBINDEX:
		return "no such sub-index";
	case OD_WRITE_ONLY:
		return "write-only, cannot be read";
	case OD_READ_ONLY:
		return "read-only, cannot be written";
	case OD_UNSUPPORTED_ACCESS:
		return "access not supported for this object";
	case OD_TOO_LONG:
		return "value too long for its type";
	case OD_TOO_SHORT:
		return "value too short for its type";
	case OD_TOO_HIGH:
		return "value above its high limit";
	case OD_TOO_LOW:
		return "value below its low limit";
	case OD_BAD_VALUE:
		return "not a valid value";
	case OD_NOT_MAPPABLE:
		return "cannot be mapped into a PDO";
	case OD_PDO_LENGTH:
		return "mapping is longer than a PDO";
	case OD_INCOMPATIBLE:
		return "incompatible with other parameters";
	case OD_CANNOT_STORE:
		return "could not be stored";
	case OD_LOCAL_CONTROL:
		return "refused because of local control";
	case OD_DEVICE_STATE:
		return "refused in the present device state";
	case OD_NO_DATA:
		return "no data yet";
	case OD_GENERAL:
		return "internal error";
	case OD_STATUS_COUNT:
		break;
	}
	return "unknown status";
}
