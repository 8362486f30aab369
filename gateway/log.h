/* gateway/log.h
 * Lines on standard error for the operator: start, faults and their end; never per sample. Any thread. Where systemd's
 * journal reads standard error, a line begins with its priority (<4>, sd-daemon(3)), else with the name of the program
 * ("imu9-gateway: "). */
#ifndef GATEWAY_LOG_H
#define GATEWAY_LOG_H

#include <syslog.h> /* the severities: LOG_ERR, LOG_WARNING, LOG_INFO, LOG_DEBUG */

/** Lines less severe than this are not written; LOG_INFO until it is called. */
void log_set_level(int severity);

/** Writes the line in one write(). Does not block: the line is lost when its reader does not read. log_error(): why the
 * process cannot start or ends; log_warning(): something does not work, or not as configured. */
void log_at(int severity, const char *format, ...) __attribute__((format(printf, 2, 3)));
#define log_error(...)	 log_at(LOG_ERR, __VA_ARGS__)
#define log_warning(...) log_at(LOG_WARNING, __VA_ARGS__)
#define log_line(...)	 log_at(LOG_INFO, __VA_ARGS__)

#endif
