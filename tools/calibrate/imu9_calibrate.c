/* tools/calibrate/imu9_calibrate.c
 * imu9-calibrate: calibration of a sensor and its lever arm, from logs or in a gateway on the bus. One subcommand for
 * each quantity. */
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
	{"magnetometer", "hard and soft iron, from rotations about all axes", calibrate_sensor},
	{"temperature", "temperature dependence of the biases, from a rest while it changes", calibrate_sensor},
	{"lever-arm", "from the reference point to the accelerometer, from a motion", calibrate_lever_arm},
	{0},
};

static void print_usage(void)
{
	puts("Usage: imu9-calibrate SUBCOMMAND [OPTION]... LOG.imu.csv\n"
	     "       imu9-calibrate [-i BUS] [-n NODE] gyro|accelerometer|magnetometer|lever-arm [OPTION]...\n"
	     "Calibrates a sensor and finds its lever arm, from a log or in the gateway on the bus.\n");
	for (const struct subcommand *s = subcommands; s->name; s++)
		printf("  %-14s %s\n", s->name, s->about);
	puts("\nWithout a log the gateway on the bus is calibrated. More: imu9-calibrate SUBCOMMAND --help\n"
	     "\n"
	     "  -h, --help            this text\n"
	     "  -V, --version         the version\n");
	fputs(CLI_EXIT_STATUS, stdout);
}

/* The name of the subcommand can follow options; it is moved to the front. */
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
		cli_usage_error("give a quantity: gyro, accelerometer, magnetometer, temperature or lever-arm");
	if (strcmp(argv[1], "--help") == 0 || strcmp(argv[1], "-h") == 0) {
		print_usage();
		return CLI_OK;
	}
	if (strcmp(argv[1], "--version") == 0 || strcmp(argv[1], "-V") == 0) {
		puts("imu9-calibrate " IMU9_VERSION);
		return CLI_OK;
	}
	for (int i = 1; i < argc; i++)
		for (const struct subcommand *s = subcommands; s->name; s++)
			if (strcmp(argv[i], s->name) == 0)
				return run(s, i, argc, argv);
	cli_usage_error(
		"%s: not a quantity: give gyro, accelerometer, magnetometer, temperature or lever-arm", argv[1]);
}
