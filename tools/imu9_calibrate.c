/* tools/imu9_calibrate.c
 * imu9-calibrate: what a sensor and its mounting are like, from recorded logs. One subcommand a quantity. */
#include <stdio.h>
#include <string.h>

#include "tools/calibrate_lever_arm.h"
#include "tools/cli.h"

static const struct subcommand {
	const char *name, *about;
	int (*run)(int argc, char **argv);
} subcommands[] = {
	{"lever-arm", "where the accelerometer sits, from a motion", calibrate_lever_arm},
	{0},
};

static void print_usage(void)
{
	puts("usage: imu9-calibrate SUBCOMMAND [OPTION]... LOG.imu.csv\n");
	for (const struct subcommand *s = subcommands; s->name; s++)
		printf("  %-12s %s\n", s->name, s->about);
	puts("\nimu9-calibrate SUBCOMMAND --help tells more.\n"
	     "Exit status: 0 done, 1 failed or refused, 2 wrong usage.");
}

int main(int argc, char **argv)
{
	if (argc < 2)
		cli_usage_error("which quantity?");
	if (strcmp(argv[1], "--help") == 0) {
		print_usage();
		return CLI_OK;
	}
	if (strcmp(argv[1], "--version") == 0) {
		puts("imu9-calibrate " IMU9_VERSION);
		return CLI_OK;
	}
	for (const struct subcommand *s = subcommands; s->name; s++)
		if (strcmp(argv[1], s->name) == 0)
			return s->run(argc - 1, argv + 1);
	cli_usage_error("no such subcommand: %s", argv[1]);
}
