#include "tools/eds/eds_file.h"

#include <errno.h>
#include <ini.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

_Static_assert(EDS_LINE_MAX == INI_MAX_LINE, "inih truncates lines at another length");

struct block { /* one allocation; all are freed together */
	struct block *next;
	max_align_t data[];
};

int eds_fail(struct eds_file *file, unsigned line, const char *format, ...)
{
	va_list args;
	int length;

	if (file->result)
		return file->result;
	file->result = -EINVAL;
	length = line ? snprintf(file->error, file->error_size, "%s:%u: ", file->path, line)
		      : snprintf(file->error, file->error_size, "%s: ", file->path);
	if (length < 0 || (size_t)length >= file->error_size)
		return file->result;
	va_start(args, format);
	vsnprintf(file->error + length, file->error_size - (size_t)length, format, args);
	va_end(args);
	return file->result;
}

static int eds_out_of_memory(struct eds_file *file)
{
	eds_fail(file, 0, "out of memory");
	return file->result = -ENOMEM;
}

void *eds_allocate(struct eds_file *file, size_t size)
{
	struct block *block = calloc(1, sizeof(*block) + size);

	if (!block) {
		eds_out_of_memory(file);
		return NULL;
	}
	block->next = file->memory;
	file->memory = block;
	return block->data;
}

void eds_free_memory(void *memory)
{
	struct block *next;

	for (struct block *block = memory; block; block = next) {
		next = block->next;
		free(block);
	}
}

const char *eds_copy(struct eds_file *file, const char *text)
{
	size_t size = strlen(text) + 1;
	char *copy = eds_allocate(file, size);

	return copy ? memcpy(copy, text, size) : NULL;
}

void *eds_grow(struct eds_file *file, void *array, size_t count, size_t *capacity, size_t element)
{
	size_t wanted = *capacity ? 2 * *capacity : 64;

	if (count < *capacity)
		return array;
	array = realloc(array, wanted * element);
	if (array)
		*capacity = wanted;
	else
		eds_out_of_memory(file);
	return array;
}

/* A key in a comment, ";Unit=m": other readers refuse keys that are not in CiA 306. */
static bool is_comment_key(const char *from, size_t size)
{
	static const char *const keys[] = {"Unit=", "Factor=", "Description=", "RealDefault=", "RealLowLimit=",
		"RealHighLimit=", "StringSize=", "Stored=", "Resolution=", "Values=", "Bits="};

	for (size_t i = 0; i < sizeof(keys) / sizeof(keys[0]); i++)
		if (size > strlen(keys[i]) && !memcmp(from, keys[i], strlen(keys[i])))
			return true;
	return false;
}

/* Line reader for inih. Counts lines and section headers for error messages, and removes leading blanks, which inih
 * would read as a continuation of the line before. Each line ends with \n alone, and has room for it. */
static char *read_line(char *buffer, int capacity, void *ctx)
{
	struct eds_file *file = ctx;
	const char *from = file->text, *newline, *end;
	size_t size;

	if (file->text == file->end || file->result)
		return NULL;
	newline = memchr(from, '\n', (size_t)(file->end - from));
	end = newline ? newline : file->end;
	file->text = newline ? newline + 1 : file->end;
	file->line++;
	while (from < end && (*from == ' ' || *from == '\t'))
		from++;
	if (end > from && end[-1] == '\r')
		end--;
	size = (size_t)(end - from);
	if (size && *from == ';' && is_comment_key(from + 1, size - 1)) {
		from++;
		size--;
	}
	if (size && *from == ';')
		size = 0;
	if (memchr(from, '\0', size)) {
		eds_fail(file, file->line, "contains a NUL byte; an EDS is plain text");
		return NULL;
	}
	if (size + sizeof("\n") > (size_t)capacity) {
		eds_fail(file, file->line, "is longer than %d characters; shorten it", capacity - 2);
		return NULL;
	}
	if (size && *from == '[')
		file->header = file->line;
	memcpy(buffer, from, size);
	memcpy(buffer + size, "\n", sizeof("\n")); /* to inih 59 a full buffer without it is a part of a line */
	return buffer;
}

/* Handler for inih. An empty value has the same meaning as an absent key (CiA 306). */
static int on_item(void *ctx, const char *section, const char *key, const char *value)
{
	struct eds_file *file = ctx;
	const struct eds_item *last = file->count ? &file->items[file->count - 1] : NULL;
	struct eds_item item = {.line = file->line, .header = file->header}, *items;

	if (!*value)
		return 1;
	item.section = last && last->header == file->header ? last->section : eds_copy(file, section);
	item.key = eds_copy(file, key);
	item.value = eds_copy(file, value);
	items = eds_grow(file, file->items, file->count, &file->capacity, sizeof(item));
	if (!items)
		return 0;
	file->items = items;
	file->items[file->count++] = item;
	return !file->result;
}

static int compare_items(const void *a, const void *b)
{
	const struct eds_item *x = a, *y = b;
	int order = strcasecmp(x->section, y->section);

	return order ? order : strcasecmp(x->key, y->key);
}

static int compare_items_and_lines(const void *a, const void *b)
{
	const struct eds_item *x = a, *y = b;
	int order = compare_items(a, b);

	return order ? order : (x->line > y->line) - (x->line < y->line);
}

int eds_read(struct eds_file *file, const char *text, size_t size)
{
	static const char BOM[] = "\xEF\xBB\xBF";
	int line;

	file->text = text;
	file->end = text + size;
	if (size >= 3 && !memcmp(text, BOM, 3))
		file->text += 3;
	line = ini_parse_stream(read_line, file, on_item, file);
	if (file->result)
		return file->result;
	if (line)
		return eds_fail(file, (unsigned)line, "is not a [section], key=value or ; comment");
	if (!file->count)
		return eds_fail(file, 0, "has no content; is it an EDS file?");
	qsort(file->items, file->count, sizeof(*file->items), compare_items_and_lines);
	for (size_t i = 1; i < file->count; i++) {
		const struct eds_item *a = &file->items[i - 1], *b = &file->items[i];

		if (!strcasecmp(a->section, b->section) && a->header != b->header)
			return eds_fail(file, a->header > b->header ? a->header : b->header,
				"section [%s] exists twice; merge them", b->section);
		if (!compare_items(a, b))
			return eds_fail(file, b->line, "[%s] already has %s in line %u; remove one", b->section, b->key,
				a->line);
	}
	return 0;
}

void eds_close(struct eds_file *file)
{
	free(file->items);
	file->items = NULL;
	file->count = file->capacity = 0;
}

const struct eds_item *eds_find(const struct eds_file *file, const char *section, const char *key)
{
	struct eds_item wanted = {.section = section, .key = key};

	return bsearch(&wanted, file->items, file->count, sizeof(wanted), compare_items);
}

size_t eds_section_start(const struct eds_file *file, const char *section)
{
	size_t low = 0, high = file->count;

	while (low < high) {
		size_t middle = low + (high - low) / 2;

		if (strcasecmp(file->items[middle].section, section) < 0)
			low = middle + 1;
		else
			high = middle;
	}
	return low;
}

size_t eds_section_end(const struct eds_file *file, size_t i)
{
	const char *section = file->items[i].section;

	while (i < file->count && !strcasecmp(file->items[i].section, section))
		i++;
	return i;
}

const struct eds_item *eds_section(const struct eds_file *file, const char *section)
{
	size_t i = eds_section_start(file, section);

	return i < file->count && !strcasecmp(file->items[i].section, section) ? &file->items[i] : NULL;
}
