/* tools/eds/eds.c
 * Converts the items of the file to entries, objects and the table. Each error names the line of the item to change. */
#include "tools/eds/eds.h"

#include <ctype.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "tools/eds/eds_file.h"
#include "tools/eds/eds_value.h"

enum {
	FILE_SIZE_MAX = 16 << 20,
	OBJECT_TYPE_DOMAIN = 0x02,
	OBJECT_TYPE_VAR = 0x07,
	OBJECT_TYPE_ARRAY = 0x08,
	OBJECT_TYPE_RECORD = 0x09,
	OBJ_FLAG_NOT_DOWNLOADED = 1 << 0,
	PDO_BITS_MAX = 64,
};

static const char WORD_CHARACTERS[] = "abcdefghijklmnopqrstuvwxyz0123456789_+-";

/* An entry before its offset in the values struct is known. */
struct draft {
	struct od_entry entry;
	const char *label;
	unsigned label_line, default_line;
	union od_number number; /* the default of a number */
	const char *text;	/* the default of a string */
	const char *value;	/* ParameterValue */
	const struct eds_item *resolution;
};

struct loader {
	struct eds_file file;
	struct eds *eds;
	enum eds_rules rules;
	struct draft *drafts; /* sorted like the table */
	size_t draft_count, draft_capacity;
};

static bool strict(const struct loader *l)
{
	return l->rules == EDS_STRICT;
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

/* Reads the value of a numeric key. 0, or -EINVAL: not a number. Without the key *out is unchanged. */
static int read_u32(struct loader *l, const char *section, const char *key, uint32_t *out)
{
	const struct eds_item *item = eds_find(&l->file, section, key);
	union od_number number;

	if (!item)
		return 0;
	if (!eds_parse_integer(item->value, 32, false, &number))
		return eds_fail(
			&l->file, item->line, "[%s] %s=%s is not a number of 32 bits", section, key, item->value);
	*out = (uint32_t)number.u;
	return 0;
}

static const char *read_text(const struct loader *l, const char *section, const char *key)
{
	const struct eds_item *item = eds_find(&l->file, section, key);

	return item ? item->value : "";
}

/* ---- names ---- */

/* The ParameterName of a section and its normalised form. Lenient rules replace an empty name by `substitute`. */
static int read_name(struct loader *l, const char *section, const struct eds_item *item, const char *substitute,
	const char **label, const char **name, unsigned *line)
{
	char normalised[EDS_LINE_MAX];
	const struct eds_item *header = eds_section(&l->file, section);

	*line = item ? item->line : header ? header->header : 0;
	*label = item ? item->value : substitute;
	if (!item && strict(l))
		return eds_fail(&l->file, *line, "[%s] has no ParameterName; add it", section);
	eds_normalise(*label, normalised, sizeof(normalised));
	if (strict(l) && !isalpha((unsigned char)normalised[0]))
		return eds_fail(&l->file, *line, "[%s] ParameterName=%s must begin with a letter", section, *label);
	if (!normalised[0])
		eds_normalise(substitute, normalised, sizeof(normalised));
	*label = eds_copy(&l->file, *label);
	*name = eds_copy(&l->file, normalised);
	return l->file.result;
}

/* The name of a sub-index without that of its object, which its ParameterName may begin with: "Lever arm l" is "l". */
static const char *short_name(const struct eds_object *object, const char *name)
{
	size_t length = strlen(object->name);
	bool repeated = strncmp(name, object->name, length) == 0 && name[length] == '_';

	return repeated && isalpha((unsigned char)name[length + 1]) ? name + length + 1 : name;
}

/* ---- entries ---- */

/* Section with the keys of an entry: its own, or that of the object with CompactSubObj. */
struct source {
	const char *section;
	const struct eds_item *label, *initial;
	uint32_t inherited_flags;
};

static int read_access(struct loader *l, const struct source *source, struct od_entry *entry)
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
	const struct eds_item *item = eds_find(&l->file, source->section, "AccessType");
	const char *text = item ? item->value : "rw";
	uint32_t mappable = 0, flags = 0, stored = 0;

	if (!item && strict(l))
		return eds_fail(&l->file, eds_section(&l->file, source->section)->header,
			"[%s] has no AccessType; add it", source->section);
	if (read_u32(l, source->section, "PDOMapping", &mappable) || read_u32(l, source->section, "ObjFlags", &flags) ||
		read_u32(l, source->section, "Stored", &stored))
		return l->file.result;
	flags |= source->inherited_flags;
	for (size_t i = 0; i < sizeof(ACCESS) / sizeof(*ACCESS); i++) {
		if (strcasecmp(text, ACCESS[i].text))
			continue;
		entry->access = ACCESS[i].access;
		if (mappable)
			entry->access |= ACCESS[i].pdo;
		if ((entry->access & OD_READ) && (entry->access & OD_WRITE) && entry->type != OD_DOMAIN &&
			!(flags & OBJ_FLAG_NOT_DOWNLOADED))
			stored = 1;
		if (stored)
			entry->access |= OD_STORED;
		return 0;
	}
	return eds_fail(&l->file, item->line, "[%s] AccessType=%s is not one of ro, wo, rw, rwr, rww, const",
		source->section, text);
}

/* A limit; for a REAL the key real_key takes precedence. */
static int read_limit(struct loader *l, const char *section, const char *key, const char *real_key,
	const struct eds_type *type, uint16_t flag, struct od_entry *entry, union od_number *limit)
{
	const struct eds_item *item = eds_is_real(type) ? eds_find(&l->file, section, real_key) : NULL;

	if (!item)
		item = eds_find(&l->file, section, key);
	if (!item || (!type->bits && !eds_is_real(type)))
		return 0;
	if (!eds_parse_number(item->value, type, limit))
		return eds_fail(&l->file, item->line, "[%s] %s=%s is not a value of data type 0x%04X", section,
			item->key, item->value, type->code);
	entry->access |= flag;
	return 0;
}

static int read_number(struct loader *l, const struct source *source, const struct eds_type *type, struct draft *draft)
{
	struct od_entry *entry = &draft->entry;
	const struct eds_item *item = eds_is_real(type) ? eds_find(&l->file, source->section, "RealDefault") : NULL;
	char rest[EDS_LINE_MAX];
	const char *text;

	if (read_limit(l, source->section, "LowLimit", "RealLowLimit", type, OD_LIMIT_LOW, entry, &entry->low) ||
		read_limit(l, source->section, "HighLimit", "RealHighLimit", type, OD_LIMIT_HIGH, entry, &entry->high))
		return l->file.result;
	if (!item)
		item = source->initial;
	if (!item)
		return 0;
	draft->default_line = item->line;
	text = item->value;
	if (type->bits && eds_split_node_id(text, rest, sizeof(rest))) {
		text = rest;
		entry->access |= OD_NODE_ID;
	}
	if (!eds_parse_number(text, type, &draft->number))
		return eds_fail(&l->file, item->line, "[%s] %s=%s is not a value of data type 0x%04X", source->section,
			item->key, item->value, type->code);
	if (!strict(l))
		return 0;
	if ((entry->access & OD_LIMIT_LOW) && eds_is_above(type, entry->low, draft->number))
		return eds_fail(&l->file, item->line, "[%s] %s=%s is below the low limit", source->section, item->key,
			item->value);
	if ((entry->access & OD_LIMIT_HIGH) && eds_is_above(type, draft->number, entry->high))
		return eds_fail(&l->file, item->line, "[%s] %s=%s is above the high limit", source->section, item->key,
			item->value);
	return 0;
}

static int read_string(struct loader *l, const struct source *source, const struct eds_type *type, struct draft *draft)
{
	const struct eds_item *item = type->foreign ? NULL : source->initial;
	const struct eds_item *size_item = eds_find(&l->file, source->section, "StringSize");
	uint32_t size = type->size;
	int length = 0;

	if (read_u32(l, source->section, "StringSize", &size))
		return l->file.result;
	if (size_item && (size < 1 || size > OD_VALUE_MAX))
		return eds_fail(&l->file, size_item->line, "[%s] StringSize=%s is not 1 to %d", source->section,
			size_item->value, OD_VALUE_MAX);
	if (item) {
		draft->default_line = item->line;
		draft->text = item->value;
		length = type->type == OD_OCTET_STRING ? eds_parse_octets(item->value, NULL, 0)
						       : (int)strlen(item->value);
		if (length < 0)
			return eds_fail(&l->file, item->line,
				"[%s] DefaultValue=%s does not consist of pairs of hex digits", source->section,
				item->value);
		if (size && (uint32_t)length > size)
			return eds_fail(&l->file, item->line, "[%s] the default has %d bytes, more than StringSize=%u",
				source->section, length, size);
	}
	if (!size && type->type == OD_OCTET_STRING)
		size = (uint32_t)length;
	if (!size || size > OD_VALUE_MAX)
		size = OD_VALUE_MAX;
	draft->entry.size = (uint16_t)size;
	return 0;
}

static int read_factor(struct loader *l, const char *section, double *factor)
{
	const struct eds_item *item = eds_find(&l->file, section, "Factor");
	union od_number number;

	*factor = 1;
	if (!item)
		return 0;
	if (!eds_parse_real(item->value, OD_REAL64, &number) || number.f == 0)
		return eds_fail(
			&l->file, item->line, "[%s] Factor=%s is not a number other than 0", section, item->value);
	*factor = number.f;
	return 0;
}

/* Values= and Bits=: the numbers rise and fit the type. */
static int read_words(struct loader *l, const char *section, const struct eds_type *type, struct od_entry *entry)
{
	const struct eds_item *values = eds_find(&l->file, section, "Values"),
			      *bits = eds_find(&l->file, section, "Bits");
	const struct eds_item *item = bits ? bits : values;
	struct od_word word = {0};
	unsigned next = 0, end = bits || type->bits > 31 ? type->bits : 1u << type->bits;

	entry->words = "";
	if (!item)
		return 0;
	if (!type->bits)
		return eds_fail(&l->file, item->line, "[%s] %s is for integers only", section, item->key);
	if (bits && values)
		return eds_fail(&l->file, item->line, "[%s] has Values and Bits; keep one of them", section);
	entry->words = item->value;
	entry->words_of_bits = bits;
	while (od_next_word(entry, &word)) {
		if (word.number < next || word.number >= end || strspn(word.text, WORD_CHARACTERS) < word.length)
			return eds_fail(&l->file, item->line,
				"[%s] %s: %.*s is not a word of a-z, 0-9, _, + and -, with a number from %u to %u",
				section, item->key, (int)word.length, word.text, next, end - 1);
		next = word.number + 1;
	}
	return 0;
}

static int add_draft(struct loader *l, const struct draft *draft)
{
	struct draft *drafts = eds_grow(&l->file, l->drafts, l->draft_count, &l->draft_capacity, sizeof(*draft));

	if (drafts) {
		l->drafts = drafts;
		l->drafts[l->draft_count++] = *draft;
	}
	return l->file.result;
}

static const struct eds_type *read_type(struct loader *l, const char *section, uint32_t object_type)
{
	const struct eds_item *item = eds_find(&l->file, section, "DataType");
	const struct eds_type *type;
	union od_number code;

	if (!item && object_type == OBJECT_TYPE_DOMAIN)
		return eds_type_of(OD_DOMAIN);
	if (!item) {
		eds_fail(&l->file, eds_section(&l->file, section)->header, "[%s] has no DataType; add it", section);
		return NULL;
	}
	type = eds_parse_integer(item->value, 32, false, &code) ? eds_type_of(code.u) : NULL;
	if (!type || (type->foreign && strict(l)))
		eds_fail(&l->file, item->line, "[%s] DataType=%s is unknown; use one listed in od/od.h, such as 0x0007",
			section, item->value);
	return l->file.result ? NULL : type;
}

/* Appends an entry of `object`; for a VAR `name` is NULL. */
static int read_entry(struct loader *l, const struct eds_object *object, uint8_t sub, const char *name,
	const struct source *source, struct draft draft)
{
	uint32_t object_type = OBJECT_TYPE_VAR;
	const struct eds_type *type;
	struct od_entry *entry = &draft.entry;
	char full[2 * EDS_LINE_MAX];

	if (read_u32(l, source->section, "ObjectType", &object_type))
		return l->file.result;
	type = read_type(l, source->section, object_type);
	if (!type)
		return l->file.result;
	entry->index = object->index;
	entry->sub = sub;
	entry->type = type->type;
	entry->size = type->size;
	snprintf(full, sizeof(full), "%s%s%s", object->name, name ? "." : "", name ? name : "");
	entry->name = eds_copy(&l->file, full);
	draft.default_line = draft.label_line;
	if (*read_text(l, source->section, "ParameterValue"))
		draft.value = read_text(l, source->section, "ParameterValue");
	entry->unit = read_text(l, source->section, "Unit");
	entry->description = read_text(l, source->section, "Description");
	if (read_words(l, source->section, type, entry))
		return l->file.result;
	draft.resolution = eds_find(&l->file, source->section, "Resolution");
	if (read_access(l, source, entry) || read_factor(l, source->section, &entry->factor))
		return l->file.result;
	if (type->bits || eds_is_real(type))
		read_number(l, source, type, &draft);
	else if (type->type != OD_DOMAIN)
		read_string(l, source, type, &draft);
	return l->file.result ? l->file.result : add_draft(l, &draft);
}

static int read_sub(struct loader *l, const struct eds_object *object, uint8_t sub, const struct source *source)
{
	struct draft draft = {0};
	char substitute[sizeof("Sub 255")];
	const char *name = substitute;

	snprintf(substitute, sizeof(substitute), "Sub %d", sub);
	if (read_name(l, source->section, source->label, substitute, &draft.label, &name, &draft.label_line))
		return l->file.result;
	return read_entry(l, object, sub, short_name(object, name), source, draft);
}

/* CompactSubObj: sub-index 0 is implied, the others use the keys of the object's section. */
static int read_compact_subs(struct loader *l, const struct eds_object *object, const char *section, uint8_t count)
{
	static const char LABEL[] = "NrOfObjects";
	char names[sizeof("FFFFValue")], values[sizeof("FFFFValue")], number[sizeof("255")];
	char full[EDS_LINE_MAX + sizeof(number)];
	struct draft zero = {.label = LABEL, .label_line = object->line, .number.u = count};

	zero.entry = (struct od_entry){.index = object->index,
		.type = OD_UNSIGNED8,
		.size = 1,
		.access = OD_READ | OD_CONST,
		.factor = 1,
		.unit = "",
		.description = "",
		.words = ""};
	snprintf(full, sizeof(full), "%s.nrofobjects", object->name);
	zero.entry.name = eds_copy(&l->file, full);
	if (add_draft(l, &zero))
		return l->file.result;
	snprintf(names, sizeof(names), "%XName", object->index);
	snprintf(values, sizeof(values), "%XValue", object->index);
	for (unsigned sub = 1; sub <= count; sub++) {
		struct source source = {.section = section};
		struct eds_item label = {.value = full, .line = object->line};

		snprintf(number, sizeof(number), "%u", sub);
		snprintf(full, sizeof(full), "%.150s%u", object->label, sub);
		source.label = eds_find(&l->file, names, number);
		source.initial = eds_find(&l->file, values, number);
		if (!source.label)
			source.label = &label;
		if (!source.initial)
			source.initial = eds_find(&l->file, section, "DefaultValue");
		if (read_u32(l, section, "ObjFlags", &source.inherited_flags) ||
			read_sub(l, object, (uint8_t)sub, &source))
			return l->file.result;
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

/* All sections [1018subN] of an object, in any order of the file. */
static int read_subs(struct loader *l, const struct eds_object *object, const char *section)
{
	char prefix[sizeof("FFFFsub")];
	size_t length = (size_t)snprintf(prefix, sizeof(prefix), "%Xsub", object->index);
	uint32_t flags = 0;

	if (read_u32(l, section, "ObjFlags", &flags))
		return l->file.result;
	for (size_t i = eds_section_start(&l->file, prefix); i < l->file.count; i = eds_section_end(&l->file, i)) {
		const char *name = l->file.items[i].section;
		struct source source = {.section = name, .inherited_flags = flags};
		unsigned long sub;
		char *end;

		if (strncasecmp(name, prefix, length))
			break;
		sub = strtoul(name + length, &end, 16);
		if (!isxdigit((unsigned char)name[length]) || *end || sub > 0xFF)
			return eds_fail(
				&l->file, l->file.items[i].header, "[%s] does not name a sub-index from 0 to FF", name);
		source.label = eds_find(&l->file, name, "ParameterName");
		source.initial = eds_find(&l->file, name, "DefaultValue");
		if (read_sub(l, object, (uint8_t)sub, &source))
			return l->file.result;
	}
	if (l->draft_count > object->first)
		qsort(l->drafts + object->first, l->draft_count - object->first, sizeof(*l->drafts), compare_subs);
	return 0;
}

static int check_subs(struct loader *l, const struct eds_object *object, const char *section)
{
	const struct draft *subs = l->drafts + object->first;
	const struct eds_item *item = eds_find(&l->file, section, "SubNumber");
	uint32_t count = 0;

	for (size_t i = 1; i < object->count; i++)
		if (subs[i].entry.sub == subs[i - 1].entry.sub)
			return eds_fail(&l->file, subs[i].label_line,
				"[%s] sub-index %X is described twice; remove one", section, subs[i].entry.sub);
	if (read_u32(l, section, "SubNumber", &count) || !strict(l))
		return l->file.result;
	if (!item)
		return eds_fail(&l->file, object->line, "[%s] has no SubNumber; add it", section);
	if (count != object->count)
		return eds_fail(&l->file, item->line, "[%s] SubNumber=%s, but %zu sub-indices are described", section,
			item->value, object->count);
	if (subs[0].entry.sub != 0)
		return eds_fail(&l->file, item->line, "[%s] has no sub-index 0; add it", section);
	if ((subs[0].entry.access & OD_CONST) && subs[0].number.u != subs[count - 1].entry.sub)
		return eds_fail(&l->file, subs[0].default_line, "[%s] sub-index 0 is not %d, the highest sub-index",
			section, subs[count - 1].entry.sub);
	return 0;
}

/* ---- objects ---- */

static int read_object(struct loader *l, struct eds_object *object, const struct eds_item *listed)
{
	char section[sizeof("FFFF")], substitute[sizeof("Object FFFF")];
	uint32_t object_type = OBJECT_TYPE_VAR, compact = 0;
	const struct eds_item *item;

	snprintf(section, sizeof(section), "%X", object->index);
	snprintf(substitute, sizeof(substitute), "Object %X", object->index);
	if (!eds_section(&l->file, section))
		return eds_fail(&l->file, listed->line,
			"object %s is listed, but has no section [%s]; add it or unlist it", listed->value, section);
	if (read_name(l, section, eds_find(&l->file, section, "ParameterName"), substitute, &object->label,
		    &object->name, &object->line) ||
		read_u32(l, section, "ObjectType", &object_type) || read_u32(l, section, "CompactSubObj", &compact))
		return l->file.result;
	object->description = read_text(l, section, "Description");
	object->first = l->draft_count;
	switch (object_type) {
	case OBJECT_TYPE_DOMAIN:
	case OBJECT_TYPE_VAR: {
		struct source source = {.section = section, .initial = eds_find(&l->file, section, "DefaultValue")};
		struct draft draft = {.label = object->label, .label_line = object->line};

		object->kind = EDS_VAR;
		read_entry(l, object, 0, NULL, &source, draft);
		break;
	}
	case OBJECT_TYPE_ARRAY:
	case OBJECT_TYPE_RECORD:
		object->kind = object_type == OBJECT_TYPE_ARRAY ? EDS_ARRAY : EDS_RECORD;
		item = eds_find(&l->file, section, "CompactSubObj");
		if (compact > 0xFE)
			eds_fail(&l->file, item->line, "[%s] CompactSubObj=%s is above 254", section, item->value);
		else if (compact)
			read_compact_subs(l, object, section, (uint8_t)compact);
		else
			read_subs(l, object, section);
		break;
	default: /* NULL, DEFTYPE, DEFSTRUCT: cannot be accessed by SDO */
		item = eds_find(&l->file, section, "ObjectType");
		if (strict(l))
			eds_fail(&l->file, item->line, "[%s] ObjectType=%s is not 0x2, 0x7, 0x8 or 0x9", section,
				item->value);
		return l->file.result;
	}
	object->count = l->draft_count - object->first;
	if (l->file.result || object->kind == EDS_VAR || compact)
		return l->file.result;
	if (!object->count)
		return eds_fail(&l->file, object->line, "[%s] has no sub-index; add [%ssub0]", section, section);
	return check_subs(l, object, section);
}

struct listing {
	const struct eds_item *item;
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

/* Appends the indices of a list. `listings` has room for as many as there are items in the file. */
static int read_list(struct loader *l, const char *list, struct listing *listings, size_t *count)
{
	const struct eds_item *supported = eds_find(&l->file, list, "SupportedObjects");
	size_t from = eds_section_start(&l->file, list), present;
	uint32_t n = 0;

	if (read_u32(l, list, "SupportedObjects", &n))
		return l->file.result;
	if (!eds_section(&l->file, list))
		return strict(l) ? eds_fail(&l->file, 0, "has no section [%s]; add it", list) : 0;
	present = eds_section_end(&l->file, from) - from - (supported != NULL);
	if (strict(l) && (!supported || present != n))
		return eds_fail(&l->file, supported ? supported->line : l->file.items[from].header,
			"[%s] SupportedObjects=%u, but %zu are listed", list, n, present);
	for (uint32_t i = 1; i <= n && i <= 0xFFFF; i++) {
		char key[sizeof("65535")];
		const struct eds_item *item;
		union od_number index;

		snprintf(key, sizeof(key), "%u", i);
		item = eds_find(&l->file, list, key);
		if (!item && strict(l))
			return eds_fail(
				&l->file, supported->line, "[%s] has no entry %u; number them 1 to %u", list, i, n);
		if (!item)
			continue;
		if (!eds_parse_integer(item->value, 16, false, &index))
			return eds_fail(&l->file, item->line, "[%s] %s is not an index of 16 bits, such as 0x1000",
				list, item->value);
		if (strict(l) && !belongs_to_list(list, (uint16_t)index.u))
			return eds_fail(
				&l->file, item->line, "object %s does not belong in [%s]; move it", item->value, list);
		if (index.u < 0x1000)
			continue; /* data types are not objects */
		listings[(*count)++] = (struct listing){item, (uint16_t)index.u};
	}
	return 0;
}

static int read_objects(struct loader *l)
{
	struct listing *listings = eds_allocate(&l->file, l->file.count * sizeof(*listings));
	struct eds *eds = l->eds;
	size_t count = 0;

	if (!listings || read_list(l, "MandatoryObjects", listings, &count) ||
		read_list(l, "OptionalObjects", listings, &count) ||
		read_list(l, "ManufacturerObjects", listings, &count))
		return l->file.result;
	if (!count)
		return eds_fail(&l->file, 0, "lists no objects; is it an EDS file?");
	qsort(listings, count, sizeof(*listings), compare_listings);
	eds->objects = eds_allocate(&l->file, count * sizeof(*eds->objects));
	if (!eds->objects)
		return l->file.result;
	for (size_t i = 0; i < count; i++) {
		struct eds_object *object = &eds->objects[eds->object_count];

		if (i && listings[i].index == listings[i - 1].index)
			return eds_fail(&l->file, listings[i].item->line,
				"object %s is already listed in line %u; remove one", listings[i].item->value,
				listings[i - 1].item->line);
		object->index = listings[i].index;
		if (read_object(l, object, listings[i].item))
			return l->file.result;
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

/* Sets the offsets as a compiler does for a struct with one member per object, itself a struct with one member per
 * sub-index for arrays and records. Returns the size. */
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

static void set_default(const struct draft *draft, uint8_t *values)
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
			eds_parse_octets(draft->text, to, entry->size);
		break;
	case OD_DOMAIN:
		break;
	}
}

static bool is_resolution(const struct od_entry *entry)
{
	return entry->type == OD_UNSIGNED8 || entry->type == OD_UNSIGNED16 || entry->type == OD_UNSIGNED32;
}

/* Resolution: the entry may come later in the file than the one that refers to it. */
static int link_resolutions(struct loader *l, struct od_entry *entries)
{
	for (size_t i = 0; i < l->draft_count; i++) {
		const struct eds_item *item = l->drafts[i].resolution;
		const struct od_entry *resolution = item ? od_find_name(&l->eds->table, item->value) : NULL;

		if (resolution && is_resolution(resolution)) {
			entries[i].resolution = resolution->index;
			entries[i].resolution_sub = resolution->sub;
		} else if (item && strict(l)) {
			return eds_fail(&l->file, item->line, "[%s] Resolution=%s is not the name of an UNSIGNED entry",
				item->section, item->value);
		}
	}
	return 0;
}

static int build_table(struct loader *l)
{
	struct eds *eds = l->eds;
	size_t values_size = lay_out(l);
	struct od_entry *entries = eds_allocate(&l->file, l->draft_count * sizeof(*entries));
	uint8_t *defaults = eds_allocate(&l->file, values_size);

	eds->entries = eds_allocate(&l->file, l->draft_count * sizeof(*eds->entries));
	if (l->file.result)
		return l->file.result;
	for (size_t i = 0; i < l->draft_count; i++) {
		entries[i] = l->drafts[i].entry;
		eds->entries[i] = (struct eds_entry){l->drafts[i].label, l->drafts[i].label_line, l->drafts[i].value};
		set_default(&l->drafts[i], defaults);
	}
	eds->table = (struct od_table){entries, l->draft_count, defaults, values_size};
	return link_resolutions(l, entries);
}

static int read_info(struct loader *l)
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
		{"DeviceComissioning", "NodeID", &info->node_id},
	};

	for (size_t i = 0; i < sizeof(numbers) / sizeof(*numbers); i++)
		if (read_u32(l, numbers[i].section, numbers[i].key, numbers[i].value))
			return l->file.result;
	info->file_name = read_text(l, "FileInfo", "FileName");
	info->description = read_text(l, "FileInfo", "Description");
	info->vendor_name = read_text(l, "DeviceInfo", "VendorName");
	info->product_name = read_text(l, "DeviceInfo", "ProductName");
	info->order_code = read_text(l, "DeviceInfo", "OrderCode");
	return 0;
}

enum od_status eds_value(
	const struct od_entry *entry, const char *text, uint8_t node_id, void *wire, size_t capacity, size_t *size)
{
	const struct eds_type *type = eds_type_of(entry->type);
	bool number = type && (type->bits || eds_is_real(type));
	char rest[EDS_LINE_MAX], plain[32];
	union od_number value;
	bool relative = number && eds_split_node_id(text, rest, sizeof(rest));

	if (!number || capacity < entry->size)
		return od_parse(entry, text, wire, capacity, size);
	if (!eds_parse_number(relative ? rest : text, type, &value))
		return OD_BAD_VALUE;
	if (eds_is_real(type))
		snprintf(plain, sizeof(plain), "%.17g", value.f);
	else if (type->is_signed)
		snprintf(plain, sizeof(plain), "%lld", (long long)value.i);
	else
		snprintf(plain, sizeof(plain), "%llu", (unsigned long long)(value.u + (relative ? node_id : 0)));
	return od_parse(entry, plain, wire, capacity, size);
}

/* ---- rules for the device's own file (EDS_STRICT) ---- */

static int check_names(struct loader *l)
{
	const struct eds *eds = l->eds;

	for (size_t i = 0; i < eds->object_count; i++)
		for (size_t k = 0; k < i; k++)
			if (!strcmp(eds->objects[i].name, eds->objects[k].name))
				return eds_fail(&l->file, eds->objects[i].line,
					"object %04X already has the name \"%s\"; choose another",
					eds->objects[k].index, eds->objects[i].name);
	for (size_t o = 0; o < eds->object_count; o++) {
		const struct draft *subs = l->drafts + eds->objects[o].first;

		for (size_t i = 0; i < eds->objects[o].count; i++)
			for (size_t k = 0; k < i; k++)
				if (!strcmp(subs[i].entry.name, subs[k].entry.name))
					return eds_fail(&l->file, subs[i].label_line,
						"sub-index %X already has the name \"%s\"; choose "
						"another",
						subs[k].entry.sub, subs[i].entry.name);
	}
	return 0;
}

/* Every section [1018...] must belong to a listed object. */
static int check_sections(struct loader *l)
{
	for (size_t i = 0; i < l->file.count; i = eds_section_end(&l->file, i)) {
		char digits[5] = "";
		uint16_t index;
		char *end;

		strncpy(digits, l->file.items[i].section, 4);
		index = (uint16_t)strtoul(digits, &end, 16);
		if (end != digits + 4 || strchr("+- ", digits[0]))
			continue;
		for (size_t k = 0; k <= l->eds->object_count; k++) {
			if (k == l->eds->object_count)
				return eds_fail(&l->file, l->file.items[i].header,
					"[%s] belongs to an object that is not listed; list it",
					l->file.items[i].section);
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
			return eds_fail(&l->file, subs[i].default_line, "maps %04X:%02X, which is not in the file",
				mapped >> 16, mapped >> 8 & 0xFF);
		if (!(target->access & direction))
			return eds_fail(&l->file, subs[i].default_line, "maps %s, which cannot be mapped into this PDO",
				target->name);
		if ((mapped & 0xFF) != 8u * target->size)
			return eds_fail(&l->file, subs[i].default_line, "maps %u bits of %s, which has %u",
				mapped & 0xFF, target->name, 8u * target->size);
		if (subs[i].entry.sub <= subs[0].number.u)
			bits += mapped & 0xFF;
	}
	if (bits > PDO_BITS_MAX)
		return eds_fail(&l->file, subs[0].default_line, "the default mapping has %u bits; a PDO has at most %d",
			bits, PDO_BITS_MAX);
	return 0;
}

static int check_pdos(struct loader *l)
{
	const struct eds *eds = l->eds;
	uint32_t rpdos = 0, tpdos = 0;
	const struct eds_item *item;

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
	item = eds_find(&l->file, "DeviceInfo", "NrOfRXPDO");
	if (eds->info.rpdo_count != rpdos)
		return eds_fail(&l->file, item ? item->line : 0,
			"[DeviceInfo] NrOfRXPDO must be %u, the number of RPDOs described", rpdos);
	item = eds_find(&l->file, "DeviceInfo", "NrOfTXPDO");
	if (eds->info.tpdo_count != tpdos)
		return eds_fail(&l->file, item ? item->line : 0,
			"[DeviceInfo] NrOfTXPDO must be %u, the number of TPDOs described", tpdos);
	return l->file.result;
}

static int check_identity(struct loader *l)
{
	static const char *const KEYS[] = {"VendorNumber", "ProductNumber", "RevisionNumber"};
	const struct eds_info *info = &l->eds->info;
	const uint32_t numbers[] = {info->vendor_number, info->product_number, info->revision_number};

	for (uint8_t i = 0; i < 3; i++) {
		const struct od_entry *entry = od_find(&l->eds->table, 0x1018, i + 1, NULL);
		const struct eds_item *item = eds_find(&l->file, "DeviceInfo", KEYS[i]);

		if (entry && l->drafts[entry - l->eds->table.entries].number.u != numbers[i])
			return eds_fail(&l->file, item ? item->line : 0, "[DeviceInfo] %s differs from [1018sub%u]",
				KEYS[i], i + 1u);
	}
	return 0;
}

static int build(struct loader *l, const char *text, size_t size)
{
	if (eds_read(&l->file, text, size) || read_info(l) || read_objects(l) || build_table(l))
		return l->file.result;
	if (!strict(l))
		return 0;
	if (check_sections(l) || check_names(l) || check_pdos(l))
		return l->file.result;
	return check_identity(l);
}

int eds_parse(struct eds *eds, const char *path, const char *text, size_t size, enum eds_rules rules, char *error,
	size_t error_size)
{
	struct loader l = {
		.file = {.path = path, .error = error, .error_size = error_size}, .eds = eds, .rules = rules};

	memset(eds, 0, sizeof(*eds));
	build(&l, text, size);
	eds->memory = l.file.memory;
	eds_close(&l.file);
	free(l.drafts);
	if (l.file.result)
		eds_free(eds);
	return l.file.result;
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
	eds_free_memory(eds->memory);
	memset(eds, 0, sizeof(*eds));
}

const char *eds_type_name(const struct od_entry *entry)
{
	switch ((enum od_type)entry->type) {
	case OD_BOOLEAN:
		return "BOOLEAN";
	case OD_INTEGER8:
		return "INTEGER8";
	case OD_INTEGER16:
		return "INTEGER16";
	case OD_INTEGER32:
		return "INTEGER32";
	case OD_INTEGER64:
		return "INTEGER64";
	case OD_UNSIGNED8:
		return "UNSIGNED8";
	case OD_UNSIGNED16:
		return "UNSIGNED16";
	case OD_UNSIGNED32:
		return "UNSIGNED32";
	case OD_UNSIGNED64:
		return "UNSIGNED64";
	case OD_REAL32:
		return "REAL32";
	case OD_REAL64:
		return "REAL64";
	case OD_VISIBLE_STRING:
		return "VISIBLE_STRING";
	case OD_OCTET_STRING:
		return "OCTET_STRING";
	case OD_DOMAIN:
		return "DOMAIN";
	}
	return "";
}
