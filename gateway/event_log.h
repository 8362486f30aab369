/* gateway/event_log.h
 * The events of the device in memory, readable over the bus (2131h): one line of text each, with the time since the
 * start in s, the oldest first. When it is full the oldest lines are dropped. One thread.
 *
 * What the bus causes can come at its rate: of one kind of line, two appear within a second, and after that one a
 * second, the latest, with the number of those left out. A kind is a format. */
#ifndef GATEWAY_EVENT_LOG_H
#define GATEWAY_EVENT_LOG_H

#include <stdint.h>

#include "od/od.h"

enum { EVENT_LOG_KINDS = 64, EVENT_LOG_TEXT = 151 };

/** Caller-owned. Zeroed: empty. */
struct event_log {
	uint64_t start_us;
	struct od_domain domain;
	size_t used;
	char text[OD_DOMAIN_MAX];
	struct event_kind {
		const char *format;	     /* NULL: unused */
		unsigned number;	     /* 0, or that of event_log_add_about() */
		int severity;		     /* on standard error */
		uint64_t last_us, before_us; /* 1 s after the last two lines; 0: none */
		unsigned left_out;	     /* since the last line; the latest of them: */
		uint64_t latest_us;
		char latest[EVENT_LOG_TEXT];
	} kinds[EVENT_LOG_KINDS];
};

/** Attaches 2131h to the dictionary. */
void event_log_attach(struct event_log *log, struct od *od);
/** The start, from which times count. */
void event_log_start(struct event_log *log, uint64_t now_us);

/** Adds the lines whose second has passed. Returns the next deadline. */
uint64_t event_log_tick(struct event_log *log, uint64_t now_us);

/** Adds a line; `format` has no line break. Text beyond 150 bytes is cut. */
void event_log_add(struct event_log *log, uint64_t now_us, const char *format, ...)
	__attribute__((format(printf, 3, 4)));
/** The same for one of several things, of which each is a kind. */
void event_log_add_about(struct event_log *log, uint64_t now_us, unsigned number, const char *format, ...)
	__attribute__((format(printf, 4, 5)));
/** event_log_add(), and the line goes to standard error, too (those of event_log_add() do with log_level debug). */
void event_log_line(struct event_log *log, uint64_t now_us, const char *format, ...)
	__attribute__((format(printf, 3, 4)));
/** Both. */
void event_log_line_about(struct event_log *log, uint64_t now_us, unsigned number, const char *format, ...)
	__attribute__((format(printf, 4, 5)));
/** event_log_line() about something that does not work. */
void event_log_warning(struct event_log *log, uint64_t now_us, const char *format, ...)
	__attribute__((format(printf, 3, 4)));

#endif
