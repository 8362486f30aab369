/* gateway/log.h
 * One line to standard error for what a person should know: starts, faults and their end, never per
 * sample. */
#ifndef GATEWAY_LOG_H
#define GATEWAY_LOG_H

/** "imu9-gateway: " and the text, in one write. Never blocks: the line is lost when its reader stands still. */
void log_line(const char *format, ...) __attribute__((format(printf, 1, 2)));

#endif
