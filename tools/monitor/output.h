/* tools/monitor/output.h
 * What imu9-monitor prints for programs: lines of key=value fields, CSV, JSON; and the table at the end. */
#ifndef TOOLS_MONITOR_OUTPUT_H
#define TOOLS_MONITOR_OUTPUT_H

#include "tools/lib/watch.h"

enum output { OUTPUT_SCREEN, OUTPUT_LINE, OUTPUT_CSV, OUTPUT_JSON };

/** Names and units of the columns: of OUTPUT_LINE a comment, of OUTPUT_CSV the header, else nothing. */
void output_header(enum output output, const struct watch *watch);
/** One line. `t_s`: since the start. What was not received is "-", empty or null. */
void output_values(enum output output, const struct watch *watch, long node_id, double t_s, uint64_t now_us);
void output_summary(const struct watch *watch, uint64_t now_us);

#endif
