#include "tools/lib/cli_time.h"

#include <stdio.h>
#include <string.h>
#include <time.h>

void cli_utc_text(char text[CLI_UTC_TEXT])
{
	struct timespec now;
	struct tm utc;

	clock_gettime(CLOCK_REALTIME, &now);
	gmtime_r(&now.tv_sec, &utc);
	strftime(text, CLI_UTC_TEXT, "%Y-%m-%dT%H:%M:%S", &utc);
	snprintf(text + strlen(text), CLI_UTC_TEXT - strlen(text), ".%03dZ", (int)(now.tv_nsec / 1000000 % 1000));
}
