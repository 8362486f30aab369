#include "tools/lib/cli_file.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "tools/lib/cli.h"

FILE *cli_create(const char *path)
{
	FILE *file = path ? fopen(path, "we") : stdout;

	if (!file) {
		cli_error("%s: %s", path, strerror(errno));
		exit(CLI_FAILED);
	}
	return file;
}

void cli_close(FILE *file, const char *path)
{
	bool failed = fflush(file) != 0 || ferror(file);

	if (path)
		failed |= fclose(file) != 0;
	if (failed) {
		cli_error("%s: cannot be written (%s)", path ? path : "standard output", strerror(errno));
		exit(CLI_FAILED);
	}
}

void cli_log_open(struct imu_log *log, const char *path, const struct log_format *format)
{
	char error[512];

	if (imu_log_open(log, path, format ? format : log_format_at(0), error, sizeof error) < 0) {
		cli_error("%s", error);
		exit(CLI_FAILED);
	}
}

bool cli_log_next(struct imu_log *log, struct imu_sample *sample)
{
	int got = imu_log_next(log, sample);
	char text[256];

	if (got == 1)
		return true;
	imu_log_close(log);
	if (got < 0) {
		cli_error("%s:%ld: %s", log->path, log->rows.table[0].line, strerror(-got));
		exit(CLI_FAILED);
	}
	for (int i = 0; imu_log_message(log, i, text, sizeof text); i++)
		cli_error("%s", text);
	return false;
}
