/* gateway/event_log.h
 * The events of the device in memory, readable over the bus (2131h): one line of text each, with the time since the
 * start in s, the oldest first. When it is full the oldest lines are dropped. One thread. */
#ifndef GATEWAY_EVENT_LOG_H
#define GATEWAY_EVENT_LOG_H

#include <stdint.h>

#include "od/od.h"

/** Caller-owned. Zeroed: empty. */
struct event_log {
	uint64_t start_us;
	struct od_domain domain;
	size_t used;
	char text[OD_DOMAIN_MAX];
};

/** Attaches 2131h to the dictionary. */
void event_log_attach(struct event_log *log, struct od *od);
/** The start, from which times count. */
void event_log_start(struct event_log *log, uint64_t now_us);

/** Adds a line; `format` has no line break. Text beyond 150 bytes is cut. */
void event_log_add(struct event_log *log, uint64_t now_us, const char *format, ...)
	__attribute__((format(printf, 3, 4)));
/** The same, and the line goes to standard error, too. */
void event_log_line(struct event_log *log, uint64_t now_us, const char *format, ...)
	__attribute__((format(printf, 3, 4)));

#endif
