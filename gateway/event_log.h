/* gateway/event_log.h
 * What happened to the device, kept in memory and readable over the bus (2131h): a line of text for each event, with
 * the time since the start, the oldest first. When it is full the oldest lines go. */
#ifndef GATEWAY_EVENT_LOG_H
#define GATEWAY_EVENT_LOG_H

#include <stdint.h>

#include "od/od.h"

/** Caller-owned; zeroed, it is empty. */
struct event_log {
	uint64_t start_us;
	struct od_domain domain;
	size_t used;
	char text[OD_DOMAIN_MAX];
};

/** The log is what 2131h reads. */
void event_log_attach(struct event_log *log, struct od *od);
/** Times count from here. */
void event_log_start(struct event_log *log, uint64_t now_us);

/** Notes an event, without a line break; text beyond 150 bytes is cut. */
void event_log_add(struct event_log *log, uint64_t now_us, const char *format, ...)
	__attribute__((format(printf, 3, 4)));
/** The same, and on standard error: what a person should know now. */
void event_log_line(struct event_log *log, uint64_t now_us, const char *format, ...)
	__attribute__((format(printf, 3, 4)));

#endif
