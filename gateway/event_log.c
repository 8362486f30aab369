#include "gateway/event_log.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "gateway/log.h"
#include "od_index.h"

enum { LINE_MAX_BYTES = EVENT_LOG_TEXT + 80, QUIET_US = 1000000 };

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

static void put(
	struct event_log *log, const struct event_kind *kind, uint64_t t_us, const char *text, unsigned left_out)
{
	uint64_t since_us = t_us > log->start_us ? t_us - log->start_us : 0;
	char line[LINE_MAX_BYTES], more[48] = "";
	size_t size;

	if (left_out)
		snprintf(more, sizeof(more), " (%u lines like this left out)", left_out);
	size = (size_t)snprintf(line, sizeof(line), "%7llu.%06llu %s%s\n", (unsigned long long)(since_us / 1000000),
		(unsigned long long)(since_us % 1000000), text, more);
	if (log->used + size > sizeof(log->text))
		make_room(log, size);
	memcpy(log->text + log->used, line, size);
	log->used += size;
	log_at(kind->severity, "%s%s", text, more);
}

/* The entry of this kind; a new one replaces the one that had no line for the longest time. */
static struct event_kind *find_kind(struct event_log *log, const char *format, unsigned number)
{
	struct event_kind *oldest = &log->kinds[0];

	for (struct event_kind *k = log->kinds; k < log->kinds + EVENT_LOG_KINDS; k++) {
		if (k->format == format && k->number == number)
			return k;
		if (k->last_us < oldest->last_us)
			oldest = k;
	}
	*oldest = (struct event_kind){.format = format, .number = number};
	return oldest;
}

/* Notes a line of this kind. */
static void count(struct event_kind *kind, uint64_t now_us)
{
	kind->before_us = kind->last_us;
	kind->last_us = now_us + QUIET_US;
	kind->left_out = 0;
}

__attribute__((format(printf, 5, 0))) static void add(
	struct event_log *log, uint64_t now_us, unsigned number, int severity, const char *format, va_list args)
{
	struct event_kind *kind = find_kind(log, format, number);

	kind->severity = severity;
	kind->latest_us = now_us;
	vsnprintf(kind->latest, sizeof(kind->latest), format, args);
	if (kind->left_out || now_us < kind->before_us) {
		kind->left_out++;
		return;
	}
	put(log, kind, now_us, kind->latest, 0);
	count(kind, now_us);
}

uint64_t event_log_tick(struct event_log *log, uint64_t now_us)
{
	uint64_t next_us = UINT64_MAX;

	for (struct event_kind *k = log->kinds; k < log->kinds + EVENT_LOG_KINDS; k++) {
		if (k->left_out && now_us >= k->last_us) {
			put(log, k, k->latest_us, k->latest, k->left_out - 1);
			count(k, now_us);
			k->before_us = k->last_us; /* one a second from now on */
		} else if (k->left_out && k->last_us < next_us) {
			next_us = k->last_us;
		}
	}
	return next_us;
}

void event_log_add(struct event_log *log, uint64_t now_us, const char *format, ...)
{
	va_list args;

	va_start(args, format);
	add(log, now_us, 0, LOG_DEBUG, format, args);
	va_end(args);
}

void event_log_add_about(struct event_log *log, uint64_t now_us, unsigned number, const char *format, ...)
{
	va_list args;

	va_start(args, format);
	add(log, now_us, number, LOG_DEBUG, format, args);
	va_end(args);
}

void event_log_line(struct event_log *log, uint64_t now_us, const char *format, ...)
{
	va_list args;

	va_start(args, format);
	add(log, now_us, 0, LOG_INFO, format, args);
	va_end(args);
}

void event_log_line_about(struct event_log *log, uint64_t now_us, unsigned number, const char *format, ...)
{
	va_list args;

	va_start(args, format);
	add(log, now_us, number, LOG_INFO, format, args);
	va_end(args);
}

void event_log_warning(struct event_log *log, uint64_t now_us, const char *format, ...)
{
	va_list args;

	va_start(args, format);
	add(log, now_us, 0, LOG_WARNING, format, args);
	va_end(args);
}
