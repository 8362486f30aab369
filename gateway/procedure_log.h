/* gateway/procedure_log.h
 * Writes what the procedures of 2060h and 2061h do, and their results, to the event log. One thread. */
#ifndef GATEWAY_PROCEDURE_LOG_H
#define GATEWAY_PROCEDURE_LOG_H

#include "gateway/command_object.h"
#include "gateway/event_log.h"
#include "od_values.h"

struct procedure_log {
	struct event_log *log;
	const struct od_values *values;
	const uint64_t *now_us;
};

/** From now on `group` writes to `log`; all must live as long. */
void procedure_log_attach(struct procedure_log *p, struct command_group *group);

#endif
