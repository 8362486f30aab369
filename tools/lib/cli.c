#include "drivers/ports/sources.h"
#include "tools/lib/cli.h"

#include <ctype.h>
#include <errno.h>
#include <getopt.h>
#include <inttypes.h>
#include <math.h>
#include <poll.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/signalfd.h>
#include <time.h>
#include <unistd.h>

#include "gateway/canopen/deadline.h"

/* Replaces control codes, which text quoted from a log or a device can contain. */
__attribute__((format(printf, 1, 0))) static void print_error(const char *format, va_list args)
{
	char text[2048];

	vsnprintf(text, sizeof(text), format, args);
	for (char *c = text; *c; c++)
		if (iscntrl((unsigned char)*c) && *c != '\n')
			*c = '?';
	fflush(stdout);
	fprintf(stderr, "%s: %s\n", program_invocation_short_name, text);
}

void cli_error(const char *format, ...)
{
	va_list args;

	va_start(args, format);
	print_error(format, args);
	va_end(args);
}

void cli_usage_error(const char *format, ...)
{
	va_list args;

	va_start(args, format);
	print_error(format, args);
	va_end(args);
	fprintf(stderr, "Try '%s --help'.\n", program_invocation_short_name);
	exit(CLI_USAGE);
}

void cli_bad_option(int getopt_result, char *const argv[])
{
	const char *word = argv[optind - 1];

	if (getopt_result == ':')
		cli_usage_error("option %s needs a value", word);
	if (strncmp(word, "--", 2) != 0 && optopt)
		cli_usage_error("unknown option -%c", optopt);
	if (optopt)
		cli_usage_error("option %s takes no value", word);
	cli_usage_error("unknown option %s", word);
}

/* In 64 bits: a long of 32-bit processors does not hold every UNSIGNED32. */
static bool whole_number(const char *text, int64_t low, int64_t high, int64_t *value)
{
	const char *digits = text + (text[0] == '-');
	bool hex = digits[0] == '0' && (digits[1] == 'x' || digits[1] == 'X');
	char *end;

	if (!isdigit((unsigned char)digits[0]))
		return false; /* strtoll() would accept spaces and a '+' */
	errno = 0;
	*value = strtoll(text, &end, hex ? 16 : 10);
	return !*end && !errno && *value >= low && *value <= high;
}

bool cli_integer(const char *text, long low, long high, long *value)
{
	int64_t n;

	if (!whole_number(text, low, high, &n))
		return false;
	*value = (long)n;
	return true;
}

bool cli_real(const char *text, double low, double high, double *value)
{
	char *end;
	double x = strtod(text, &end);

	if (end == text || *end || !isfinite(x) || x < low || x > high)
		return false;
	*value = x;
	return true;
}

long cli_integer_option(const char *option, const char *text, long low, long high)
{
	long value;

	if (!cli_integer(text, low, high, &value))
		cli_usage_error("%s %s: not a whole number from %ld to %ld", option, text, low, high);
	return value;
}

uint32_t cli_u32_option(const char *option, const char *text)
{
	int64_t value;

	if (!whole_number(text, 0, UINT32_MAX, &value))
		cli_usage_error("%s %s: not a whole number from 0 to %" PRIu32, option, text, UINT32_MAX);
	return (uint32_t)value;
}

double cli_real_option(const char *option, const char *text, double low, double high)
{
	double value;

	if (!cli_real(text, low, high, &value))
		cli_usage_error("%s %s: not a number from %g to %g", option, text, low, high);
	return value;
}

const char *cli_default_bus(void)
{
	const char *bus = getenv("IMU9_CAN");

	return bus && bus[0] ? bus : "vcan0";
}

long cli_default_node(void)
{
	const char *node = getenv("IMU9_NODE");

	return node && node[0] ? cli_integer_option("IMU9_NODE", node, 1, 127) : 1;
}

uint64_t cli_now_us(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (uint64_t)t.tv_sec * 1000000 + (uint64_t)t.tv_nsec / 1000;
}

int cli_signal_fd(void)
{
	sigset_t signals;

	sigemptyset(&signals);
	sigaddset(&signals, SIGINT);
	sigaddset(&signals, SIGTERM);
	sigprocmask(SIG_BLOCK, &signals, NULL);
	int fd = signalfd(-1, &signals, SFD_CLOEXEC | SFD_NONBLOCK);
	if (fd < 0) {
		cli_error("signalfd: %s", strerror(errno));
		exit(CLI_FAILED);
	}
	return fd;
}

void cli_print_help(const char *help)
{
	fputs(help, stdout);
	puts("\nBUS is one of:");
	can_print_sources(stdout);
}

struct can_port *cli_open_bus(const char *bus)
{
	struct can_port *port;
	char error[256];

	if (can_open(bus, &port, error, sizeof(error)) < 0) {
		cli_error("%s", error);
		exit(CLI_FAILED);
	}
	return port;
}

bool cli_wait(struct can_port *bus, int signal_fd, uint64_t deadline_us)
{
	uint64_t now_us = cli_now_us();
	uint64_t until_us = earlier(can_service(bus, now_us), deadline_us);
	uint64_t wait_us = until_us > now_us ? until_us - now_us : 0;
	struct timespec timeout = {
		.tv_sec = (time_t)(wait_us / 1000000),
		.tv_nsec = (long)(wait_us % 1000000) * 1000,
	};
	struct pollfd fds[] = {{.fd = bus->fd, .events = POLLIN}, {.fd = signal_fd, .events = POLLIN}};

	ppoll(fds, 2, until_us == UINT64_MAX ? NULL : &timeout, NULL);
	return fds[1].revents & POLLIN;
}

int cli_flush(struct can_port *bus)
{
	uint64_t end_us = cli_now_us() + 1000000;

	for (;;) {
		uint64_t now_us = cli_now_us();
		uint64_t next_us = can_service(bus, now_us);

		if (bus->queue_count == 0)
			return 0;
		if (now_us >= end_us)
			return -ETIMEDOUT;
		usleep(next_us > now_us && next_us - now_us < 10000 ? (useconds_t)(next_us - now_us) : 1000);
	}
}
