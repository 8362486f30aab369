/* tools/eds.c
 * The file is read into one array of key=value items, sorted by section and key; everything else
 * looks items up there. Each fault is reported once, the first one found, with the line of the item
 * that has to change. */
#include "tools/eds.h"

#include <ctype.h>
#include <errno.h>
#include <float.h>
#include <ini.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

enum {
	FILE_SIZE_MAX = 16 << 20,
	OBJECT_TYPE_DOMAIN = 0x02,
	OBJECT_TYPE_VAR = 0x07,
	OBJECT_TYPE_ARRAY = 0x08,
	OBJECT_TYPE_RECORD = 0x09,
	OBJ_FLAG_NOT_DOWNLOADED = 1 << 0,
	PDO_BITS_MAX = 64,
};

struct item {
	const char *section, *key, *value;
	unsigned line, header; /* header: the line of its [section] */
};

/* An entry while its place in the table is not known yet. */
struct draft {
	struct od_entry entry;
	const char *label;
	unsigned label_line, default_line;
	union od_number number; /* the default of a number */
	const char *text;	/* the default of a string */
};

struct block { /* one allocation; they are freed together */
	struct block *next;
	max_align_t data[];
};

struct loader {
	struct eds *eds;
	enum eds_rules rules;
	const char *path;
	char *error;
	size_t error_size;
	int result;

	const char *text, *end; /* what is still to be read */
	unsigned line, header;
	struct item *items;
	size_t item_count, item_capacity;

	struct draft *drafts; /* sorted, like the table they become */
	size_t draft_count, draft_capacity;
};

static int fail(struct loader *l, unsigned line, const char *format, ...) __attribute__((format(printf, 3, 4)));

static int fail(struct loader *l, unsigned line, const char *format, ...)
{
	va_list args;
	int length;

	if (l->result)
		return l->result;
	l->result = -EINVAL;
	length = line ? snprintf(l->error, l->error_size, "%s:%u: ", l->path, line)
		      : snprintf(l->error, l->error_size, "%s: ", l->path);
	if (length < 0 || (size_t)length >= l->error_size)
		return l->result;
	va_start(args, format);
	vsnprintf(l->error + length, l->error_size - (size_t)length, format, args);
	va_end(args);
	return l->result;
}

static int fail_memory(struct loader *l)
{
	fail(l, 0, "out of memory");
	return l->result = -ENOMEM;
}

static bool strict(const struct loader *l)
{
	return l->rules == EDS_STRICT;
}

/* Zeroed, and NULL only after fail_memory(). */
static void *allocate(struct loader *l, size_t size)
{
	struct block *block = calloc(1, sizeof(*block) + size);

	if (!block) {
		fail_memory(l);
		return NULL;
	}
	block->next = l->eds->memory;
	l->eds->memory = block;
	return block->data;
}

static const char *copy_string(struct loader *l, const char *text)
{
	size_t size = strlen(text) + 1;
	char *copy = allocate(l, size);

	return copy ? memcpy(copy, text, size) : NULL;
}

/* Room for one more element at the end of a growing array; false after fail_memory(). */
static bool grow(struct loader *l, void **array, size_t count, size_t *capacity, size_t element)
{
	size_t wanted = *capacity ? 2 * *capacity : 64;
	void *bigger;

	if (count < *capacity)
		return true;
	bigger = realloc(*array, wanted * element);
	if (!bigger) {
		fail_memory(l);
		return false;
	}
	*array = bigger;
	*capacity = wanted;
	return true;
}

/* ---- the file as items ---- */

/* inih's reader. Counts the lines (inih keeps its count to itself), notes section headers, and
 * takes leading blanks away, which inih would read as the continuation of the line before. */
static char *read_line(char *buffer, int capacity, void *ctx)
{
	struct loader *l = ctx;
	const char *from = l->text, *newline, *end;
	size_t size;

	if (l->text == l->end || l->result)
		return NULL;
	newline = memchr(from, '\n', (size_t)(l->end - from));
	end = newline ? newline : l->end;
	l->text = newline ? newline + 1 : l->end;
	l->line++;
	while (from < end && (*from == ' ' || *from == '\t'))
		from++;
	size = (size_t)(end - from);
	if (size && *from == ';')
		size = 0;
	if (memchr(from, '\0', size)) {
		fail(l, l->line, "has a NUL byte; an EDS is plain text");
		return NULL;
	}
	if (size >= (size_t)capacity) {
		fail(l, l->line, "is longer than %d characters; shorten it", capacity - 1);
		return NULL;
	}
	if (size && *from == '[')
		l->header = l->line;
	memcpy(buffer, from, size);
	buffer[size] = '\0';
	return buffer;
}

/* inih's handler. An empty value means the same as an absent key (CiA 306). */
static int take_item(void *ctx, const char *section, const char *key, const char *value)
{
	struct loader *l = ctx;
	const struct item *last = l->item_count ? &l->items[l->item_count - 1] : NULL;
	struct item item = {.line = l->line, .header = l->header};

	if (!*value)
		return 1;
	item.section = last && last->header == l->header ? last->section : copy_string(l, section);
	item.key = copy_string(l, key);
	item.value = copy_string(l, value);
	if (!item.section || !item.key || !item.value)
		return 0;
	if (!grow(l, (void **)&l->items, l->item_count, &l->item_capacity, sizeof(item)))
		return 0;
	l->items[l->item_count++] = item;
	return 1;
}

static int compare_items(const void *a, const void *b)
{
	const struct item *x = a, *y = b;
	int order = strcasecmp(x->section, y->section);

	return order ? order : strcasecmp(x->key, y->key);
}

static int compare_items_and_lines(const void *a, const void *b)
{
	const struct item *x = a, *y = b;
	int order = compare_items(a, b);

	return order ? order : (x->line > y->line) - (x->line < y->line);
}

static int read_items(struct loader *l)
{
	static const char BOM[] = "\xEF\xBB\xBF";
	int line;

	if (l->end - l->text >= 3 && !memcmp(l->text, BOM, 3))
		l->text += 3;
	line = ini_parse_stream(read_line, l, take_item, l);
	if (l->result)
		return l->result;
	if (line)
		return fail(l, (unsigned)line, "is no [section], no key=value and no ; comment");
	if (!l->item_count)
		return fail(l, 0, "has no content; is it an EDS file?");
	qsort(l->items, l->item_count, sizeof(*l->items), compare_items_and_lines);
	for (size_t i = 1; i < l->item_count; i++) {
		const struct item *a = &l->items[i - 1], *b = &l->items[i];

		if (!strcasecmp(a->section, b->section) && a->header != b->header)
			return fail(l, a->header > b->header ? a->header : b->header,
				"section [%s] is there twice; merge them", b->section);
		if (!compare_items(a, b))
			return fail(
				l, b->line, "[%s] has %s already in line %u; remove one", b->section, b->key, a->line);
	}
	return 0;
}

static const struct item *find(const struct loader *l, const char *section, const char *key)
{
	struct item wanted = {.section = section, .key = key};

	return bsearch(&wanted, l->items, l->item_count, sizeof(wanted), compare_items);
}

/* The first item of the first section at or after this name. */
static size_t find_section(const struct loader *l, const char *section)
{
	size_t low = 0, high = l->item_count;

	while (low < high) {
		size_t middle = low + (high - low) / 2;

		if (strcasecmp(l->items[middle].section, section) < 0)
			low = middle + 1;
		else
			high = middle;
	}
	return low;
}

static size_t next_section(const struct loader *l, size_t i)
{
	const char *section = l->items[i].section;

	while (i < l->item_count && !strcasecmp(l->items[i].section, section))
		i++;
	return i;
}

static const struct item *header_of(const struct loader *l, const char *section)
{
	size_t i = find_section(l, section);

	return i < l->item_count && !strcasecmp(l->items[i].section, section) ? &l->items[i] : NULL;
}

/* ---- values ---- */

struct type_info {
	uint8_t code, type;
	uint16_t size; /* bytes; 0: from StringSize or the default */
	unsigned bits; /* of the value; 0: not an integer */
	bool is_signed;
	bool foreign; /* od has no such type: handled as bytes */
};

static const struct type_info TYPES[] = {
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

static const struct type_info *find_type(uint64_t code)
{
	for (size_t i = 0; i < sizeof(TYPES) / sizeof(*TYPES); i++)
		if (TYPES[i].code == code)
			return &TYPES[i];
	return NULL;
}

static bool is_real(const struct type_info *type)
{
	return type->type == OD_REAL32 || type->type == OD_REAL64;
}

static bool is_hex(const char *text)
{
	return text[0] == '0' && (text[1] == 'x' || text[1] == 'X');
}

/* Decimal, 0x hex or 0 octal. Hex of the full width is taken as two's complement. */
static bool parse_integer(const char *text, unsigned bits, bool is_signed, union od_number *out)
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

/* Decimal, or 0x and the IEEE 754 bits. Rounded to the type, so that a default may stand right on
 * its limit. */
static bool parse_real(const char *text, enum od_type type, union od_number *out)
{
	unsigned bits = type == OD_REAL32 ? 32 : 64;
	union od_number raw;
	char *end;

	if (is_hex(text)) {
		uint32_t low;
		float single;

		if (!parse_integer(text, bits, false, &raw))
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

static bool parse_number(const char *text, const struct type_info *type, union od_number *out)
{
	if (is_real(type))
		return parse_real(text, type->type, out);
	return parse_integer(text, type->bits, type->is_signed, out);
}

static bool is_above(const struct type_info *type, union od_number a, union od_number b)
{
	if (is_real(type))
		return a.f > b.f;
	return type->is_signed ? a.i > b.i : a.u > b.u;
}

/* Takes "$NODEID+" or "+$NODEID" off a value. True if it was there, with the rest in `rest`. */
static bool split_node_id(const char *text, char *rest, size_t capacity)
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

/* "0A0BFF" or "0A 0B FF". Returns the number of bytes, or -1; `bytes` may be NULL. */
static int parse_octets(const char *text, uint8_t *bytes, size_t capacity)
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

size_t eds_normalise(const char *label, char *name, size_t capacity)
{
	size_t n = 0;

	for (; *label; label++) {
		bool kept = (*label >= '0' && *label <= '9') || (*label >= 'a' && *label <= 'z') ||
			    (*label >= 'A' && *label <= 'Z');
		char c = kept ? (char)tolower((unsigned char)*label) : '_';

		if (c == '_' && (n == 0 || name[n - 1] == '_'))
			continue;
		if (n + 1 < capacity)
			name[n++] = c;
	}
	while (n && name[n - 1] == '_')
		n--;
	name[n] = '\0';
	return n;
}

/* The value of a numeric key: 0, or -EINVAL when it is there and does not parse. Absent: *out
 * stays. */
static int take_u32(struct loader *l, const char *section, const char *key, uint32_t *out)
{
	const struct item *item = find(l, section, key);
	union od_number number;

	if (!item)
		return 0;
	if (!parse_integer(item->value, 32, false, &number))
		return fail(l, item->line, "[%s] %s=%s is no number of 32 bits", section, key, item->value);
	*out = (uint32_t)number.u;
	return 0;
}

static const char *take_text(const struct loader *l, const char *section, const char *key)
{
	const struct item *item = find(l, section, key);

	return item ? item->value : "";
}

/* ---- names ---- */

/* The human name of a section and its normalised form. A name that says nothing is replaced, except
 * in our own file. */
static int take_name(struct loader *l, const char *section, const struct item *item, const char *substitute,
	const char **label, const char **name, unsigned *line)
{
	char normalised[INI_MAX_LINE];
	const struct item *header = header_of(l, section);

	*line = item ? item->line : header ? header->header : 0;
	*label = item ? item->value : substitute;
	if (!item && strict(l))
		return fail(l, *line, "[%s] has no ParameterName; add it", section);
	eds_normalise(*label, normalised, sizeof(normalised));
	if (strict(l) && !isalpha((unsigned char)normalised[0]))
		return fail(l, *line, "[%s] ParameterName=%s must begin with a letter", section, *label);
	if (!normalised[0])
		eds_normalise(substitute, normalised, sizeof(normalised));
	*label = copy_string(l, *label);
	*name = copy_string(l, normalised);
	return l->result;
}

/* ---- entries ---- */

/* Where the facts of an entry stand: its own section, or for a CompactSubObj its object's. */
struct source {
	const char *section;
	const struct item *label, *initial;
	uint32_t inherited_flags;
};

static int take_access(struct loader *l, const struct source *source, struct od_entry *entry)
{
	static const struct {
		const char *text;
		uint16_t access, pdo;
	} ACCESS[] = {
		{"ro", OD_READ, OD_TPDO},
		{"wo", OD_WRITE, OD_RPDO},
		{"rw", OD_READ | OD_WRITE, OD_TPDO | OD_RPDO},
		{"rwr", OD_READ | OD_WRITE, OD_TPDO},
		{"rww", OD_READ | OD_WRITE, OD_RPDO},
		{"const", OD_READ | OD_CONST, OD_TPDO},
	};
	const struct item *item = find(l, source->section, "AccessType");
	const char *text = item ? item->value : "rw";
	uint32_t mappable = 0, flags = 0;

	if (!item && strict(l))
		return fail(
			l, header_of(l, source->section)->header, "[%s] has no AccessType; add it", source->section);
	if (take_u32(l, source->section, "PDOMapping", &mappable) || take_u32(l, source->section, "ObjFlags", &flags))
		return l->result;
	flags |= source->inherited_flags;
	for (size_t i = 0; i < sizeof(ACCESS) / sizeof(*ACCESS); i++) {
		if (strcasecmp(text, ACCESS[i].text))
			continue;
		entry->access = ACCESS[i].access;
		if (mappable)
			entry->access |= ACCESS[i].pdo;
		if ((entry->access & OD_READ) && (entry->access & OD_WRITE) && entry->type != OD_DOMAIN &&
			!(flags & OBJ_FLAG_NOT_DOWNLOADED))
			entry->access |= OD_STORED;
		return 0;
	}
	return fail(
		l, item->line, "[%s] AccessType=%s is not one of ro, wo, rw, rwr, rww, const", source->section, text);
}

/* One limit, of the key for REALs if that is there. */
static int take_limit(struct loader *l, const char *section, const char *key, const char *real_key,
	const struct type_info *type, uint16_t flag, struct od_entry *entry, union od_number *limit)
{
	const struct item *item = is_real(type) ? find(l, section, real_key) : NULL;

	if (!item)
		item = find(l, section, key);
	if (!item || (!type->bits && !is_real(type)))
		return 0;
	if (!parse_number(item->value, type, limit))
		return fail(l, item->line, "[%s] %s=%s is no value of data type 0x%04X", section, item->key,
			item->value, type->code);
	entry->access |= flag;
	return 0;
}

static int take_number(struct loader *l, const struct source *source, const struct type_info *type, struct draft *draft)
{
	struct od_entry *entry = &draft->entry;
	const struct item *item = is_real(type) ? find(l, source->section, "RealDefault") : NULL;
	char rest[INI_MAX_LINE];
	const char *text;

	if (take_limit(l, source->section, "LowLimit", "RealLowLimit", type, OD_LIMIT_LOW, entry, &entry->low) ||
		take_limit(l, source->section, "HighLimit", "RealHighLimit", type, OD_LIMIT_HIGH, entry, &entry->high))
		return l->result;
	if (!item)
		item = source->initial;
	if (!item)
		return 0;
	draft->default_line = item->line;
	text = item->value;
	if (type->bits && split_node_id(text, rest, sizeof(rest))) {
		text = rest;
		entry->access |= OD_NODE_ID;
	}
	if (!parse_number(text, type, &draft->number))
		return fail(l, item->line, "[%s] %s=%s is no value of data type 0x%04X", source->section, item->key,
			item->value, type->code);
	if (!strict(l))
		return 0;
	if ((entry->access & OD_LIMIT_LOW) && is_above(type, entry->low, draft->number))
		return fail(
			l, item->line, "[%s] %s=%s is below the low limit", source->section, item->key, item->value);
	if ((entry->access & OD_LIMIT_HIGH) && is_above(type, draft->number, entry->high))
		return fail(
			l, item->line, "[%s] %s=%s is above the high limit", source->section, item->key, item->value);
	return 0;
}

static int take_string(struct loader *l, const struct source *source, const struct type_info *type, struct draft *draft)
{
	const struct item *item = type->foreign ? NULL : source->initial;
	const struct item *size_item = find(l, source->section, "StringSize");
	uint32_t size = type->size;
	int length = 0;

	if (take_u32(l, source->section, "StringSize", &size))
		return l->result;
	if (size_item && (size < 1 || size > OD_VALUE_MAX))
		return fail(l, size_item->line, "[%s] StringSize=%s is not 1 to %d", source->section, size_item->value,
			OD_VALUE_MAX);
	if (item) {
		draft->default_line = item->line;
		draft->text = item->value;
		length = type->type == OD_OCTET_STRING ? parse_octets(item->value, NULL, 0) : (int)strlen(item->value);
		if (length < 0)
			return fail(l, item->line, "[%s] DefaultValue=%s is not made of pairs of hex digits",
				source->section, item->value);
		if (size && (uint32_t)length > size)
			return fail(l, item->line, "[%s] the default has %d bytes, more than StringSize=%u",
				source->section, length, size);
	}
	if (!size && type->type == OD_OCTET_STRING)
		size = (uint32_t)length;
	if (!size || size > OD_VALUE_MAX)
		size = OD_VALUE_MAX;
	draft->entry.size = (uint16_t)size;
	return 0;
}

static int take_factor(struct loader *l, const char *section, double *factor)
{
	const struct item *item = find(l, section, "Factor");
	union od_number number;

	*factor = 1;
	if (!item)
		return 0;
	if (!parse_real(item->value, OD_REAL64, &number) || number.f == 0)
		return fail(l, item->line, "[%s] Factor=%s is no number other than 0", section, item->value);
	*factor = number.f;
	return 0;
}

static const struct type_info *take_type(struct loader *l, const char *section, uint32_t object_type)
{
	const struct item *item = find(l, section, "DataType");
	const struct type_info *type;
	union od_number code;

	if (!item && object_type == OBJECT_TYPE_DOMAIN)
		return find_type(OD_DOMAIN);
	if (!item) {
		fail(l, header_of(l, section)->header, "[%s] has no DataType; add it", section);
		return NULL;
	}
	type = parse_integer(item->value, 32, false, &code) ? find_type(code.u) : NULL;
	if (!type || (type->foreign && strict(l)))
		fail(l, item->line, "[%s] DataType=%s is not known; use one that od/od.h lists, such as 0x0007",
			section, item->value);
	return l->result ? NULL : type;
}

/* Appends one entry of `object`; for a VAR `name` is NULL. */
static int take_entry(struct loader *l, const struct eds_object *object, uint8_t sub, const char *name,
	const struct source *source, struct draft draft)
{
	uint32_t object_type = OBJECT_TYPE_VAR;
	const struct type_info *type;
	struct od_entry *entry = &draft.entry;
	char full[2 * INI_MAX_LINE];

	if (take_u32(l, source->section, "ObjectType", &object_type))
		return l->result;
	type = take_type(l, source->section, object_type);
	if (!type)
		return l->result;
	entry->index = object->index;
	entry->sub = sub;
	entry->type = type->type;
	entry->size = type->size;
	snprintf(full, sizeof(full), "%s%s%s", object->name, name ? "." : "", name ? name : "");
	entry->name = copy_string(l, full);
	draft.default_line = draft.label_line;
	entry->unit = take_text(l, source->section, "Unit");
	entry->description = take_text(l, source->section, "Description");
	if (take_access(l, source, entry) || take_factor(l, source->section, &entry->factor))
		return l->result;
	if (type->bits || is_real(type))
		take_number(l, source, type, &draft);
	else if (type->type != OD_DOMAIN)
		take_string(l, source, type, &draft);
	if (l->result || !grow(l, (void **)&l->drafts, l->draft_count, &l->draft_capacity, sizeof(draft)))
		return l->result;
	l->drafts[l->draft_count++] = draft;
	return 0;
}

static int take_sub(struct loader *l, const struct eds_object *object, uint8_t sub, const struct source *source)
{
	struct draft draft = {0};
	const char *name;
	char substitute[sizeof("Sub 255")];

	snprintf(substitute, sizeof(substitute), "Sub %d", sub);
	if (take_name(l, source->section, source->label, substitute, &draft.label, &name, &draft.label_line))
		return l->result;
	return take_entry(l, object, sub, name, source, draft);
}

/* CompactSubObj: sub-index 0 is implied, the others share the facts of the object's own section. */
static int take_compact(struct loader *l, const struct eds_object *object, const char *section, uint8_t count)
{
	static const char LABEL[] = "NrOfObjects";
	char names[sizeof("FFFFValue")], values[sizeof("FFFFValue")], number[sizeof("255")];
	char full[INI_MAX_LINE + sizeof(number)];
	struct draft zero = {.label = LABEL, .label_line = object->line, .number.u = count};

	zero.entry = (struct od_entry){.index = object->index,
		.type = OD_UNSIGNED8,
		.size = 1,
		.access = OD_READ | OD_CONST,
		.factor = 1,
		.unit = "",
		.description = ""};
	snprintf(full, sizeof(full), "%s.nrofobjects", object->name);
	zero.entry.name = copy_string(l, full);
	if (!zero.entry.name || !grow(l, (void **)&l->drafts, l->draft_count, &l->draft_capacity, sizeof(zero)))
		return l->result;
	l->drafts[l->draft_count++] = zero;
	snprintf(names, sizeof(names), "%XName", object->index);
	snprintf(values, sizeof(values), "%XValue", object->index);
	for (unsigned sub = 1; sub <= count; sub++) {
		struct source source = {.section = section};
		struct item label = {.value = full, .line = object->line};

		snprintf(number, sizeof(number), "%u", sub);
		snprintf(full, sizeof(full), "%.150s%u", object->label, sub);
		source.label = find(l, names, number);
		source.initial = find(l, values, number);
		if (!source.label)
			source.label = &label;
		if (!source.initial)
			source.initial = find(l, section, "DefaultValue");
		if (take_u32(l, section, "ObjFlags", &source.inherited_flags) ||
			take_sub(l, object, (uint8_t)sub, &source))
			return l->result;
	}
	return 0;
}

static int compare_subs(const void *a, const void *b)
{
	const struct draft *x = a, *y = b;

	if (x->entry.sub != y->entry.sub)
		return x->entry.sub - y->entry.sub;
	return (x->label_line > y->label_line) - (x->label_line < y->label_line);
}

/* All [1018subN] of an object, whatever the order in the file. */
static int take_subs(struct loader *l, const struct eds_object *object, const char *section)
{
	char prefix[sizeof("FFFFsub")];
	size_t length = (size_t)snprintf(prefix, sizeof(prefix), "%Xsub", object->index);
	uint32_t flags = 0;

	if (take_u32(l, section, "ObjFlags", &flags))
		return l->result;
	for (size_t i = find_section(l, prefix); i < l->item_count; i = next_section(l, i)) {
		const char *name = l->items[i].section;
		struct source source = {.section = name, .inherited_flags = flags};
		unsigned long sub;
		char *end;

		if (strncasecmp(name, prefix, length))
			break;
		sub = strtoul(name + length, &end, 16);
		if (!isxdigit((unsigned char)name[length]) || *end || sub > 0xFF)
			return fail(l, l->items[i].header, "[%s] names no sub-index of 0 to FF", name);
		source.label = find(l, name, "ParameterName");
		source.initial = find(l, name, "DefaultValue");
		if (take_sub(l, object, (uint8_t)sub, &source))
			return l->result;
	}
	if (l->draft_count > object->first)
		qsort(l->drafts + object->first, l->draft_count - object->first, sizeof(*l->drafts), compare_subs);
	return 0;
}

static int check_subs(struct loader *l, const struct eds_object *object, const char *section)
{
	const struct draft *subs = l->drafts + object->first;
	const struct item *item = find(l, section, "SubNumber");
	uint32_t count = 0;

	for (size_t i = 1; i < object->count; i++)
		if (subs[i].entry.sub == subs[i - 1].entry.sub)
			return fail(l, subs[i].label_line, "[%s] has sub-index %X twice; remove one", section,
				subs[i].entry.sub);
	if (take_u32(l, section, "SubNumber", &count) || !strict(l))
		return l->result;
	if (!item)
		return fail(l, object->line, "[%s] has no SubNumber; add it", section);
	if (count != object->count)
		return fail(l, item->line, "[%s] SubNumber=%s, but %zu sub-indices are described", section, item->value,
			object->count);
	if (subs[0].entry.sub != 0)
		return fail(l, item->line, "[%s] has no sub-index 0; add it", section);
	if ((subs[0].entry.access & OD_CONST) && subs[0].number.u != subs[count - 1].entry.sub)
		return fail(l, subs[0].default_line, "[%s] sub-index 0 is not %d, the highest sub-index", section,
			subs[count - 1].entry.sub);
	return 0;
}

/* ---- objects ---- */

static int take_object(struct loader *l, struct eds_object *object, const struct item *listed)
{
	char section[sizeof("FFFF")], substitute[sizeof("Object FFFF")];
	uint32_t object_type = OBJECT_TYPE_VAR, compact = 0;
	const struct item *item;

	snprintf(section, sizeof(section), "%X", object->index);
	snprintf(substitute, sizeof(substitute), "Object %X", object->index);
	if (!header_of(l, section))
		return fail(l, listed->line, "object %s is listed, but has no section [%s]; add it or unlist it",
			listed->value, section);
	if (take_name(l, section, find(l, section, "ParameterName"), substitute, &object->label, &object->name,
		    &object->line) ||
		take_u32(l, section, "ObjectType", &object_type) || take_u32(l, section, "CompactSubObj", &compact))
		return l->result;
	object->description = take_text(l, section, "Description");
	object->first = l->draft_count;
	switch (object_type) {
	case OBJECT_TYPE_DOMAIN:
	case OBJECT_TYPE_VAR: {
		struct source source = {.section = section, .initial = find(l, section, "DefaultValue")};
		struct draft draft = {.label = object->label, .label_line = object->line};

		object->kind = EDS_VAR;
		take_entry(l, object, 0, NULL, &source, draft);
		break;
	}
	case OBJECT_TYPE_ARRAY:
	case OBJECT_TYPE_RECORD:
		object->kind = object_type == OBJECT_TYPE_ARRAY ? EDS_ARRAY : EDS_RECORD;
		item = find(l, section, "CompactSubObj");
		if (compact > 0xFE)
			fail(l, item->line, "[%s] CompactSubObj=%s is above 254", section, item->value);
		else if (compact)
			take_compact(l, object, section, (uint8_t)compact);
		else
			take_subs(l, object, section);
		break;
	default: /* NULL, DEFTYPE, DEFSTRUCT: nothing to be read or written */
		item = find(l, section, "ObjectType");
		if (strict(l))
			fail(l, item->line, "[%s] ObjectType=%s is none of 0x2, 0x7, 0x8, 0x9", section, item->value);
		return l->result;
	}
	object->count = l->draft_count - object->first;
	if (l->result || object->kind == EDS_VAR || compact)
		return l->result;
	if (!object->count)
		return fail(l, object->line, "[%s] has no sub-index; add [%ssub0]", section, section);
	return check_subs(l, object, section);
}

struct listing {
	const struct item *item;
	uint16_t index;
};

static int compare_listings(const void *a, const void *b)
{
	const struct listing *x = a, *y = b;

	if (x->index != y->index)
		return x->index - y->index;
	return (x->item->line > y->item->line) - (x->item->line < y->item->line);
}

static bool belongs_to_list(const char *list, uint16_t index)
{
	bool mandatory = index == 0x1000 || index == 0x1001 || index == 0x1018;
	bool manufacturer = index >= 0x2000 && index < 0x6000;

	if (!strcmp(list, "MandatoryObjects"))
		return mandatory;
	return strcmp(list, "ManufacturerObjects") ? !mandatory && !manufacturer : manufacturer;
}

/* Appends what one list holds. `listings` has room for as many as there are items in the file. */
static int take_list(struct loader *l, const char *list, struct listing *listings, size_t *count)
{
	const struct item *supported = find(l, list, "SupportedObjects");
	size_t from = find_section(l, list), present;
	uint32_t n = 0;

	if (take_u32(l, list, "SupportedObjects", &n))
		return l->result;
	if (!header_of(l, list))
		return strict(l) ? fail(l, 0, "has no section [%s]; add it", list) : 0;
	present = next_section(l, from) - from - (supported != NULL);
	if (strict(l) && (!supported || present != n))
		return fail(l, supported ? supported->line : l->items[from].header,
			"[%s] SupportedObjects=%u, but %zu are listed", list, n, present);
	for (uint32_t i = 1; i <= n && i <= 0xFFFF; i++) {
		char key[sizeof("65535")];
		const struct item *item;
		union od_number index;

		snprintf(key, sizeof(key), "%u", i);
		item = find(l, list, key);
		if (!item && strict(l))
			return fail(l, supported->line, "[%s] has no entry %u; number them 1 to %u", list, i, n);
		if (!item)
			continue;
		if (!parse_integer(item->value, 16, false, &index))
			return fail(l, item->line, "[%s] %s is no index of 16 bits, such as 0x1000", list, item->value);
		if (strict(l) && !belongs_to_list(list, (uint16_t)index.u))
			return fail(l, item->line, "object %s does not belong in [%s]; move it", item->value, list);
		if (index.u < 0x1000)
			continue; /* data types, no objects */
		listings[(*count)++] = (struct listing){item, (uint16_t)index.u};
	}
	return 0;
}

static int take_objects(struct loader *l)
{
	struct listing *listings = allocate(l, l->item_count * sizeof(*listings));
	struct eds *eds = l->eds;
	size_t count = 0;

	if (!listings || take_list(l, "MandatoryObjects", listings, &count) ||
		take_list(l, "OptionalObjects", listings, &count) ||
		take_list(l, "ManufacturerObjects", listings, &count))
		return l->result;
	if (!count)
		return fail(l, 0, "lists no objects; is it an EDS file?");
	qsort(listings, count, sizeof(*listings), compare_listings);
	eds->objects = allocate(l, count * sizeof(*eds->objects));
	if (!eds->objects)
		return l->result;
	for (size_t i = 0; i < count; i++) {
		struct eds_object *object = &eds->objects[eds->object_count];

		if (i && listings[i].index == listings[i - 1].index)
			return fail(l, listings[i].item->line, "object %s is listed in line %u already; remove one",
				listings[i].item->value, listings[i - 1].item->line);
		object->index = listings[i].index;
		if (take_object(l, object, listings[i].item))
			return l->result;
		if (object->count)
			eds->object_count++;
	}
	return 0;
}

/* ---- the table ---- */

static size_t alignment(const struct od_entry *entry)
{
	if (entry->type == OD_VISIBLE_STRING || entry->type == OD_OCTET_STRING || entry->type == OD_DOMAIN)
		return 1;
	return entry->size;
}

static size_t round_up(size_t value, size_t to)
{
	return (value + to - 1) / to * to;
}

/* As a compiler lays out a struct with one member per object, which is a struct with one member per
 * sub-index. */
static size_t lay_out(struct loader *l)
{
	size_t end = 0, widest = 1;

	for (size_t i = 0; i < l->eds->object_count; i++) {
		const struct eds_object *object = &l->eds->objects[i];
		struct draft *drafts = l->drafts + object->first;
		size_t align = 1;

		for (size_t k = 0; k < object->count; k++)
			if (align < alignment(&drafts[k].entry))
				align = alignment(&drafts[k].entry);
		end = round_up(end, align);
		for (size_t k = 0; k < object->count; k++) {
			end = round_up(end, alignment(&drafts[k].entry));
			drafts[k].entry.offset = (uint32_t)end;
			end += drafts[k].entry.size;
		}
		end = round_up(end, align);
		if (widest < align)
			widest = align;
	}
	return round_up(end, widest);
}

static void place_default(const struct draft *draft, uint8_t *values)
{
	const struct od_entry *entry = &draft->entry;
	uint8_t *to = values + entry->offset;
	uint8_t u8 = (uint8_t)draft->number.u;
	uint16_t u16 = (uint16_t)draft->number.u;
	uint32_t u32 = (uint32_t)draft->number.u;
	float real32;

	switch ((enum od_type)entry->type) {
	case OD_BOOLEAN:
	case OD_INTEGER8:
	case OD_UNSIGNED8:
		*to = u8;
		break;
	case OD_INTEGER16:
	case OD_UNSIGNED16:
		memcpy(to, &u16, sizeof(u16));
		break;
	case OD_INTEGER32:
	case OD_UNSIGNED32:
		memcpy(to, &u32, sizeof(u32));
		break;
	case OD_INTEGER64:
	case OD_UNSIGNED64:
	case OD_REAL64:
		memcpy(to, &draft->number, sizeof(draft->number));
		break;
	case OD_REAL32:
		real32 = (float)draft->number.f;
		memcpy(to, &real32, sizeof(real32));
		break;
	case OD_VISIBLE_STRING:
		if (draft->text)
			memcpy(to, draft->text, strnlen(draft->text, entry->size));
		break;
	case OD_OCTET_STRING:
		if (draft->text)
			parse_octets(draft->text, to, entry->size);
		break;
	case OD_DOMAIN:
		break;
	}
}

static int build_table(struct loader *l)
{
	struct eds *eds = l->eds;
	size_t values_size = lay_out(l);
	struct od_entry *entries = allocate(l, l->draft_count * sizeof(*entries));
	uint8_t *defaults = allocate(l, values_size);

	eds->entries = allocate(l, l->draft_count * sizeof(*eds->entries));
	if (l->result)
		return l->result;
	for (size_t i = 0; i < l->draft_count; i++) {
		entries[i] = l->drafts[i].entry;
		eds->entries[i] = (struct eds_entry){l->drafts[i].label, l->drafts[i].label_line};
		place_default(&l->drafts[i], defaults);
	}
	eds->table = (struct od_table){entries, l->draft_count, defaults, values_size};
	return 0;
}

static int take_info(struct loader *l)
{
	struct eds_info *info = &l->eds->info;
	const struct {
		const char *section, *key;
		uint32_t *value;
	} numbers[] = {
		{"FileInfo", "FileVersion", &info->file_version},
		{"FileInfo", "FileRevision", &info->file_revision},
		{"DeviceInfo", "VendorNumber", &info->vendor_number},
		{"DeviceInfo", "ProductNumber", &info->product_number},
		{"DeviceInfo", "RevisionNumber", &info->revision_number},
		{"DeviceInfo", "NrOfRXPDO", &info->rpdo_count},
		{"DeviceInfo", "NrOfTXPDO", &info->tpdo_count},
	};

	for (size_t i = 0; i < sizeof(numbers) / sizeof(*numbers); i++)
		if (take_u32(l, numbers[i].section, numbers[i].key, numbers[i].value))
			return l->result;
	info->file_name = take_text(l, "FileInfo", "FileName");
	info->description = take_text(l, "FileInfo", "Description");
	info->vendor_name = take_text(l, "DeviceInfo", "VendorName");
	info->product_name = take_text(l, "DeviceInfo", "ProductName");
	info->order_code = take_text(l, "DeviceInfo", "OrderCode");
	return 0;
}

/* ---- what only our own file must fulfil ---- */

static int check_names(struct loader *l)
{
	const struct eds *eds = l->eds;

	for (size_t i = 0; i < eds->object_count; i++)
		for (size_t k = 0; k < i; k++)
			if (!strcmp(eds->objects[i].name, eds->objects[k].name))
				return fail(l, eds->objects[i].line,
					"the name \"%s\" is that of object %04X already; choose "
					"another",
					eds->objects[i].name, eds->objects[k].index);
	for (size_t o = 0; o < eds->object_count; o++) {
		const struct draft *subs = l->drafts + eds->objects[o].first;

		for (size_t i = 0; i < eds->objects[o].count; i++)
			for (size_t k = 0; k < i; k++)
				if (!strcmp(subs[i].entry.name, subs[k].entry.name))
					return fail(l, subs[i].label_line,
						"the name \"%s\" is that of sub-index %X already; "
						"choose another",
						subs[i].entry.name, subs[k].entry.sub);
	}
	return 0;
}

/* Every [1018...] section belongs to a listed object. */
static int check_sections(struct loader *l)
{
	for (size_t i = 0; i < l->item_count; i = next_section(l, i)) {
		char digits[5] = "";
		uint16_t index;
		char *end;

		strncpy(digits, l->items[i].section, 4);
		index = (uint16_t)strtoul(digits, &end, 16);
		if (end != digits + 4 || strchr("+- ", digits[0]))
			continue;
		for (size_t k = 0; k <= l->eds->object_count; k++) {
			if (k == l->eds->object_count)
				return fail(l, l->items[i].header, "[%s] belongs to no listed object; list it",
					l->items[i].section);
			if (l->eds->objects[k].index == index)
				break;
		}
	}
	return 0;
}

static int check_mapping(struct loader *l, const struct eds_object *object, uint16_t direction)
{
	const struct draft *subs = l->drafts + object->first;
	unsigned bits = 0;

	for (size_t i = 1; i < object->count; i++) {
		uint32_t mapped = (uint32_t)subs[i].number.u;
		const struct od_entry *target;

		if (!mapped && subs[i].entry.sub > subs[0].number.u)
			continue;
		target = od_find(&l->eds->table, (uint16_t)(mapped >> 16), (uint8_t)(mapped >> 8), NULL);
		if (!target)
			return fail(l, subs[i].default_line, "maps %04X:%02X, which is not in the file", mapped >> 16,
				mapped >> 8 & 0xFF);
		if (!(target->access & direction))
			return fail(
				l, subs[i].default_line, "maps %s, which is not mappable into this PDO", target->name);
		if ((mapped & 0xFF) != 8u * target->size)
			return fail(l, subs[i].default_line, "maps %u bits of %s, which has %u", mapped & 0xFF,
				target->name, 8u * target->size);
		if (subs[i].entry.sub <= subs[0].number.u)
			bits += mapped & 0xFF;
	}
	if (bits > PDO_BITS_MAX)
		return fail(l, subs[0].default_line, "the default mapping has %u bits, a PDO at most %d", bits,
			PDO_BITS_MAX);
	return 0;
}

static int check_pdos(struct loader *l)
{
	const struct eds *eds = l->eds;
	uint32_t rpdos = 0, tpdos = 0;
	const struct item *item;

	for (size_t i = 0; i < eds->object_count; i++) {
		const struct eds_object *object = &eds->objects[i];
		uint16_t block = object->index & 0xFE00;

		rpdos += block == 0x1400;
		tpdos += block == 0x1800;
		if (block == 0x1600)
			check_mapping(l, object, OD_RPDO);
		if (block == 0x1A00)
			check_mapping(l, object, OD_TPDO);
	}
	item = find(l, "DeviceInfo", "NrOfRXPDO");
	if (eds->info.rpdo_count != rpdos)
		return fail(l, item ? item->line : 0, "[DeviceInfo] NrOfRXPDO must be %u, as described", rpdos);
	item = find(l, "DeviceInfo", "NrOfTXPDO");
	if (eds->info.tpdo_count != tpdos)
		return fail(l, item ? item->line : 0, "[DeviceInfo] NrOfTXPDO must be %u, as described", tpdos);
	return l->result;
}

static int check_identity(struct loader *l)
{
	static const char *const KEYS[] = {"VendorNumber", "ProductNumber", "RevisionNumber"};
	const struct eds_info *info = &l->eds->info;
	const uint32_t numbers[] = {info->vendor_number, info->product_number, info->revision_number};

	for (uint8_t i = 0; i < 3; i++) {
		const struct od_entry *entry = od_find(&l->eds->table, 0x1018, i + 1, NULL);
		const struct item *item = find(l, "DeviceInfo", KEYS[i]);

		if (entry && l->drafts[entry - l->eds->table.entries].number.u != numbers[i])
			return fail(
				l, item ? item->line : 0, "[DeviceInfo] %s differs from [1018sub%u]", KEYS[i], i + 1u);
	}
	return 0;
}

static int build(struct loader *l)
{
	if (read_items(l) || take_info(l) || take_objects(l) || build_table(l))
		return l->result;
	if (!strict(l))
		return 0;
	if (check_sections(l) || check_names(l) || check_pdos(l))
		return l->result;
	return check_identity(l);
}

int eds_parse(struct eds *eds, const char *path, const char *text, size_t size, enum eds_rules rules, char *error,
	size_t error_size)
{
	struct loader l = {.eds = eds,
		.rules = rules,
		.path = path,
		.error = error,
		.error_size = error_size,
		.text = text,
		.end = text + size};

	memset(eds, 0, sizeof(*eds));
	build(&l);
	free(l.items);
	free(l.drafts);
	if (l.result)
		eds_free(eds);
	return l.result;
}

static long read_file(const char *path, char *text)
{
	FILE *file = fopen(path, "rb");
	size_t size;
	int error;

	if (!file)
		return -errno;
	errno = 0;
	size = fread(text, 1, FILE_SIZE_MAX, file);
	error = ferror(file) ? errno : size == FILE_SIZE_MAX ? EFBIG : 0;
	fclose(file);
	return error ? -error : (long)size;
}

int eds_load(struct eds *eds, const char *path, enum eds_rules rules, char *error, size_t error_size)
{
	char *text = malloc(FILE_SIZE_MAX);
	long size = text ? read_file(path, text) : -ENOMEM;
	int result = (int)size;

	memset(eds, 0, sizeof(*eds));
	if (size < 0)
		snprintf(error, error_size, "%s: %s", path, strerror(-result));
	else
		result = eds_parse(eds, path, text, (size_t)size, rules, error, error_size);
	free(text);
	return result;
}

void eds_free(struct eds *eds)
{
	struct block *next;

	for (struct block *block = eds->memory; block; block = next) {
		next = block->next;
		free(block);
	}
	memset(eds, 0, sizeof(*eds));
}
