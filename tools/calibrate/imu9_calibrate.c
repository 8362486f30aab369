/* tools/calibrate/imu9_calibrate.c
 * imu9-calibrate: what a sensor and its mounting are like, from recorded logs or by a gateway on the bus. One subcommand a
 * quantity. */
#include <stdio.h>
#include <string.h>

#include "tools/calibrate/calibrate_lever_arm.h"
#include "tools/calibrate/calibrate_sensor.h"
#include "tools/lib/cli.h"

static const struct subcommand {
	const char *name, *about;
	int (*run)(int argc, char **argv);
} subcommands[] = {
	{"gyro", "bias, from a rest", calibrate_sensor},
	{"accelerometer", "bias, scale and cross-axis terms, from rests in many positions", calibrate_sensor},
	{"magnetometer", "hard and soft iron, from turning about all axes", calibrate_sensor},
	{"temperature", "how the biases follow it, from a rest while it moves", calibrate_sensor},
	{"lever-arm", "where the accelerometer sits, from a motion", calibrate_lever_arm},
	{0},
};

static void print_usage(void)
{
	puts("usage: imu9-calibrate SUBCOMMAND [OPTION]... LOG.imu.csv\n"
	     "       imu9-calibrate [-i BUS] [-n NODE] gyro|accelerometer|magnetometer [OPTION]...\n");
	for (const struct subcommand *s = subcommands; s->name; s++)
		printf("  %-14s %s\n", s->name, s->about);
	puts("\nWithout a log the gateway on the bus does it. imu9-calibrate SUBCOMMAND --help tells more.\n"
	     "Exit status: 0 done, 1 failed or refused, 2 wrong usage.");
}

/* Its name may stand behind options: it comes first for the subcommand. */
static int run(const struct subcommand *s, int at, int argc, char **argv)
{
	for (; at > 1; at--)
		argv[at] = argv[at - 1];
	argv[1] = (char *)s->name;
	return s->run(argc - 1, argv + 1);
}

int main(int argc, char **argv)
{
	if (argc < 2)
		cli_usage_error("which quantity? gyro, accelerometer, magnetometer, temperature or lever-arm");
	if (strcmp(argv[1], "--help") == 0) {
		print_usage();
		return CLI_OK;
	}
	if (strcmp(argv[1], "--version") == 0) {
		puts("imu9-calibrate " IMU9_VERSION);
		return CLI_OK;
	}
	for (int i = 1; i < argc; i++)
		for (const struct subcommand *s = subcommands; s->name; s++)
			if (strcmp(argv[i], s->name) == 0)
				return run(s, i, argc, argv);
	cli_usage_error("%s: name a quantity: gyro, accelerometer, magnetometer, temperature or lever-arm", argv[1]);
}
