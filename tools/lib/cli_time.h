/* tools/lib/cli_time.h
 * The time of day as text. */
#ifndef TOOLS_LIB_CLI_TIME_H
#define TOOLS_LIB_CLI_TIME_H

enum { CLI_UTC_TEXT = sizeof("2026-11-30T12:00:00.000Z") };

/** ISO 8601, by the clock of this computer. */
void cli_utc_text(char text[CLI_UTC_TEXT]);

#endif
