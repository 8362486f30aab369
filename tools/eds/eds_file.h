/* tools/eds/eds_file.h — inside the EDS loader
 * An EDS as key=value items with their line numbers, and the first error. */
#ifndef TOOLS_EDS_EDS_FILE_H
#define TOOLS_EDS_EDS_FILE_H

#include <stddef.h>

enum { EDS_LINE_MAX = 200 }; /* bytes, with the NUL */

struct eds_item {
	const char *section, *key, *value;
	unsigned line, header; /* header: the line of its [section] */
};

struct eds_file {
	const char *path; /* path, error and error_size are set by the caller */
	char *error;
	size_t error_size;
	int result;		/* 0, or -errno of the first error */
	void *memory;		/* of eds_allocate() */
	struct eds_item *items; /* sorted by section and key without regard to case; freed by eds_close() */
	size_t count, capacity;
	const char *text, *end; /* text that is not read yet */
	unsigned line, header;
};

/** Fills file->items. 0, or -errno after eds_fail(). */
int eds_read(struct eds_file *file, const char *text, size_t size);
/** Frees the items, but not the memory with their strings. */
void eds_close(struct eds_file *file);

/** Records the first error as "path:line: what", without line if it is 0. Returns file->result. */
int eds_fail(struct eds_file *file, unsigned line, const char *format, ...) __attribute__((format(printf, 3, 4)));

/** Zeroed; NULL after eds_fail(). */
void *eds_allocate(struct eds_file *file, size_t size);
const char *eds_copy(struct eds_file *file, const char *text);
void eds_free_memory(void *memory);
/** The malloc'ed array with room for one more element; NULL after eds_fail(), and then `array` is still valid. */
void *eds_grow(struct eds_file *file, void *array, size_t count, size_t *capacity, size_t element);

const struct eds_item *eds_find(const struct eds_file *file, const char *section, const char *key);
/** Any item of a section, or NULL if there is no such section. */
const struct eds_item *eds_section(const struct eds_file *file, const char *section);
/** Index of the first item of the first section whose name is not before `section`; file->count: none. */
size_t eds_section_start(const struct eds_file *file, const char *section);
/** Index of the first item of the next section. */
size_t eds_section_end(const struct eds_file *file, size_t i);

#endif
