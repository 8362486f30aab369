/* tools/lib/cli.h
 * What the command-line programs share: messages, strict numbers, time, signals and waiting. A
 * program's name in messages is the one it was started by. */
#ifndef TOOLS_LIB_CLI_H
#define TOOLS_LIB_CLI_H

#include <stdbool.h>
#include <stdint.h>

#include "drivers/ports/can.h"

enum { CLI_OK = 0, CLI_FAILED = 1, CLI_USAGE = 2 }; /* exit codes */

/** "name: what, and what to do" on stderr. */
void cli_error(const char *format, ...) __attribute__((format(printf, 1, 2)));
/** The same with a hint at --help; ends the program with CLI_USAGE. */
_Noreturn void cli_usage_error(const char *format, ...) __attribute__((format(printf, 1, 2)));
/** For getopt_long()'s '?' and ':' (with opterr = 0 and a leading ':' in the option string). Does
 * not return. */
_Noreturn void cli_bad_option(int getopt_result, char *const argv[]);

/** The whole text as a number (decimal, or 0x hexadecimal) from low to high; false otherwise. */
bool cli_integer(const char *text, long low, long high, long *value);
bool cli_real(const char *text, double low, double high, double *value);
/** The same for the value of an option, e.g. "-n"; a wrong one ends the program with CLI_USAGE. */
long cli_integer_option(const char *option, const char *text, long low, long high);
double cli_real_option(const char *option, const char *text, double low, double high);

/** Where a node is found when the command line does not say: IMU9_CAN or vcan0; IMU9_NODE or 1. */
const char *cli_default_bus(void);
long cli_default_node(void);

/** CLOCK_MONOTONIC. */
uint64_t cli_now_us(void);

/** Blocks SIGINT and SIGTERM and returns a descriptor that becomes readable when one comes, or ends
 * the program. */
int cli_signal_fd(void);

/** Opens the bus, or says why not and ends the program with CLI_FAILED. */
struct can_port *cli_open_bus(const char *bus);

/** Waits until the bus has a frame, a signal comes (signal_fd; -1: none) or the time is
 * deadline_us. Serves the bus meanwhile. True when a signal came. */
bool cli_wait(struct can_port *bus, int signal_fd, uint64_t deadline_us);

/** Waits until frames that the bus could not take at once are on their way, 1 s at most. 0, or
 * -ETIMEDOUT. */
int cli_flush(struct can_port *bus);

#endif
