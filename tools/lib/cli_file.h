/* tools/lib/cli_file.h
 * Files of a command-line program. A failure ends the program with CLI_FAILED, after a message that says why. */
#ifndef TOOLS_LIB_CLI_FILE_H
#define TOOLS_LIB_CLI_FILE_H

#include <stdbool.h>
#include <stdio.h>

#include "drivers/imu/imu_log.h"

/** Creates the file; standard output for NULL. */
FILE *cli_create(const char *path);
/** Closes it, or flushes standard output. Fails unless everything was written. */
void cli_close(FILE *file, const char *path);

/** Opens a log; "-" is standard input. `format` NULL: an IMU log. */
void cli_log_open(struct imu_log *log, const char *path, const struct log_format *format);
/** The next sample; false at the end of the log, which it closes after reporting what there is to say about it. */
bool cli_log_next(struct imu_log *log, struct imu_sample *sample);

#endif
