#include "gateway/event_log.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "gateway/log.h"
#include "od_index.h"

enum { LINE_MAX_BYTES = 180, TEXT_MAX_BYTES = 151 };

/* A transfer reads the state at its beginning. */
static size_t read_log(void *ctx, uint8_t *out)
{
	const struct event_log *log = ctx;

	memcpy(out, log->text, log->used);
	return log->used;
}

void event_log_attach(struct event_log *log, struct od *od)
{
	log->domain = (struct od_domain){.index = OD_INDEX_EVENT_LOG, .read = read_log, .ctx = log};
	od_set_domain(od, &log->domain);
}

void event_log_start(struct event_log *log, uint64_t now_us)
{
	log->start_us = now_us;
}

static void make_room(struct event_log *log, size_t size)
{
	size_t gone = 0;

	while (log->used - gone + size > sizeof(log->text))
		gone = (size_t)((const char *)memchr(log->text + gone, '\n', log->used - gone) - log->text) + 1;
	log->used -= gone;
	memmove(log->text, log->text + gone, log->used);
}

/* Formats into text[TEXT_MAX_BYTES], which log_line() needs. */
__attribute__((format(printf, 3, 0))) static void add(
	struct event_log *log, uint64_t now_us, const char *format, va_list args, char *text)
{
	uint64_t t_us = now_us > log->start_us ? now_us - log->start_us : 0;
	char line[LINE_MAX_BYTES];
	size_t size;

	vsnprintf(text, TEXT_MAX_BYTES, format, args);
	size = (size_t)snprintf(line, sizeof(line), "%7llu.%06llu %s\n", (unsigned long long)(t_us / 1000000),
		(unsigned long long)(t_us % 1000000), text);
	if (log->used + size > sizeof(log->text))
		make_room(log, size);
	memcpy(log->text + log->used, line, size);
	log->used += size;
}

void event_log_add(struct event_log *log, uint64_t now_us, const char *format, ...)
{
	char text[TEXT_MAX_BYTES];
	va_list args;

	va_start(args, format);
	add(log, now_us, format, args, text);
	va_end(args);
}

void event_log_line(struct event_log *log, uint64_t now_us, const char *format, ...)
{
	char text[TEXT_MAX_BYTES];
	va_list args;

	va_start(args, format);
	add(log, now_us, format, args, text);
	va_end(args);
	log_line("%s", text);
}
