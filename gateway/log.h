/* gateway/log.h
 * Lines on standard error for the operator: start, faults and their end; never per sample. Any thread. */
#ifndef GATEWAY_LOG_H
#define GATEWAY_LOG_H

/** Writes "imu9-gateway: " and the text in one write(). Does not block: the line is lost when its reader does not read.
 * */
void log_line(const char *format, ...) __attribute__((format(printf, 1, 2)));

#endif
