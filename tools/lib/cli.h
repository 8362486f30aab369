/* tools/lib/cli.h
 * Shared by the command-line programs: messages, number parsing, time, signals and waiting. Messages start with the
 * name by which the program was started. */
#ifndef TOOLS_LIB_CLI_H
#define TOOLS_LIB_CLI_H

#include <stdbool.h>
#include <stdint.h>

#include "drivers/ports/can.h"

enum { CLI_OK = 0, CLI_FAILED = 1, CLI_USAGE = 2 }; /* exit status, as every --help says: */
#define CLI_EXIT_STATUS "Exit status: 0 done, 1 failed or refused, 2 wrong usage or configuration.\n"

/* every program of the bus has these, and the names that versions before 0.4 had */
#define CLI_BUS_OPTIONS                                                               \
	{"can", required_argument, NULL, 'i'}, {"bus", required_argument, NULL, 'i'}, \
		{"node-id", required_argument, NULL, 'n'},                            \
	{                                                                             \
		"node", required_argument, NULL, 'n'                                  \
	}
/* every program has these */
#define CLI_COMMON_OPTIONS                                                     \
	{"help", no_argument, NULL, 'h'}, {"version", no_argument, NULL, 'V'}, \
	{                                                                      \
		0                                                              \
	}

/** "name: what, and what to do" on stderr. */
void cli_error(const char *format, ...) __attribute__((format(printf, 1, 2)));
/** Likewise, with a hint to --help; ends the program with CLI_USAGE. */
_Noreturn void cli_usage_error(const char *format, ...) __attribute__((format(printf, 1, 2)));
/** For the results '?' and ':' of getopt_long(), with opterr = 0 and an option string that starts with ':'. */
_Noreturn void cli_bad_option(int getopt_result, char *const argv[]);

/** The whole text as a number (decimal, or 0x hexadecimal) from low to high; false otherwise. */
bool cli_integer(const char *text, long low, long high, long *value);
bool cli_real(const char *text, double low, double high, double *value);
/** Likewise for the value of an option, e.g. "-n"; an invalid one ends the program with CLI_USAGE. */
long cli_integer_option(const char *option, const char *text, long low, long high);
double cli_real_option(const char *option, const char *text, double low, double high);

/** Bus and node-ID when the command line has none: $IMU9_CAN or vcan0, $IMU9_NODE or 1. */
const char *cli_default_bus(void);
long cli_default_node(void);

/** CLOCK_MONOTONIC. */
uint64_t cli_now_us(void);

/** Blocks SIGINT and SIGTERM and returns a descriptor that becomes readable when one arrives. A failure ends the
 * program. */
int cli_signal_fd(void);

/** Prints `help`, and after it the kinds of BUS. */
void cli_print_help(const char *help);

/** Opens the bus. A failure ends the program with CLI_FAILED. */
struct can_port *cli_open_bus(const char *bus);

/** Waits for a frame, a signal (signal_fd; -1: none) or the time deadline_us, and services the bus. True: a signal. */
bool cli_wait(struct can_port *bus, int signal_fd, uint64_t deadline_us);

/** Waits until all queued frames are sent, at most 1 s. 0, or -ETIMEDOUT. */
int cli_flush(struct can_port *bus);

#endif
