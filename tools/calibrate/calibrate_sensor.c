#include "tools/calibrate/calibrate_sensor.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/settings.h"
#include "od_values.h"
#include "tools/lib/cli.h"
#include "tools/lib/cli_config.h"

static const char usage[] =
	"Usage: imu9-calibrate gyro|accelerometer|magnetometer|temperature [OPTION]... LOG.imu.csv\n"
	"       imu9-calibrate gyro|accelerometer|magnetometer [-i BUS] [-n NODE] [OPTION]...\n"
	"Estimates bias, scale factors and cross-axis terms of a sensor from a log of its raw values, or,\n"
	"without a log, in the gateway on the bus (2061h). Unsuitable data are refused with the reason.\n"
	"\n"
	"  gyro            bias: let the sensor rest for 10 s (in a log the longest rest is used)\n"
	"  accelerometer   hold it still for 3 s in at least 12 positions, every side up and down; no\n"
	"                  fixture is needed\n"
	"      --six       use a fixture instead, on each of its six faces, in any order\n"
	"  magnetometer    turn it slowly through all directions for half a minute, away from iron\n"
	"      --field UT  local field strength from a map (default: as the magnetometer measures it)\n"
	"  temperature     temperature dependence of the biases of gyro and accelerometer: let the sensor\n"
	"                  rest while it warms up; the log needs a column temperature\n"
	"\n"
	"With a log ('-': standard input):\n"
	"  -o, --output FILE   write the result as a configuration file for imu9-gateway -c\n"
	"  -c, --config FILE   present configuration: gravity, noise, temperature compensation\n"
	"      --set NAME=VALUE  any configuration object by its EDS name\n"
	"On the bus:\n"
	"  -i, --can BUS       as for imu9-sdo (default: $IMU9_CAN or vcan0)\n"
	"  -n, --node-id NODE  node-ID 1 to 127 (default: $IMU9_NODE or 1)\n"
	"  -y, --yes           start and accept a good result without asking\n"
	"  -t, --timeout MS    for one SDO answer (default 1000)\n"
	"  -h, --help          this text\n"
	"  -V, --version       the version\n"
	"\n" CLI_EXIT_STATUS;

enum { OPT_SIX = 256, OPT_FIELD, OPT_SET };

static const struct option options[] = {
	{"six", no_argument, NULL, OPT_SIX},
	{"field", required_argument, NULL, OPT_FIELD},
	{"output", required_argument, NULL, 'o'},
	{"config", required_argument, NULL, 'c'},
	{"set", required_argument, NULL, OPT_SET},
	CLI_BUS_OPTIONS,
	{"yes", no_argument, NULL, 'y'},
	{"timeout", required_argument, NULL, 't'},
	CLI_COMMON_OPTIONS,
};

static void apply_option(struct calibrate_request *r, int option, char **argv)
{
	switch (option) {
	case OPT_SIX:
		r->six = true;
		break;
	case OPT_FIELD:
		r->field_uT = cli_real_option("--field", optarg, 10, 200);
		break;
	case OPT_SET:
		cli_config_set(&r->config, optarg);
		break;
	case 'c':
		break; /* read by cli_config_files() */
	case 'o':
		r->output = optarg;
		break;
	case 'i':
		r->bus = optarg;
		break;
	case 'n':
		r->node = (uint8_t)cli_integer_option("-n", optarg, 1, 127);
		break;
	case 'y':
		r->yes = true;
		break;
	case 't':
		r->timeout_ms = (unsigned)cli_integer_option("-t", optarg, 1, 600000);
		break;
	case 'h':
		fputs(usage, stdout);
		exit(CLI_OK);
	case 'V':
		puts("imu9-calibrate " IMU9_VERSION);
		exit(CLI_OK);
	default:
		cli_bad_option(option, argv);
	}
}

static void check(const struct calibrate_request *r)
{
	if (r->six && strcmp(r->what, "accelerometer") != 0)
		cli_usage_error("--six is for the accelerometer");
	if (r->field_uT > 0 && strcmp(r->what, "magnetometer") != 0)
		cli_usage_error("--field is for the magnetometer");
	if (!r->log && strcmp(r->what, "temperature") == 0)
		cli_usage_error("temperature needs a log");
	if (!r->log && r->output)
		cli_usage_error("-o needs a log: the gateway stores the result itself (imu9-sdo store)");
}

int calibrate_sensor(int argc, char **argv)
{
	static const char letters[] = ":o:c:i:n:yt:hV";
	static struct calibrate_request r;
	static struct od_values values;
	struct od od;
	int option;

	r = (struct calibrate_request){.what = argv[0], .timeout_ms = 1000};
	config_init(&r.config, &imu9_od_table);
	cli_config_files(&r.config, argc, argv, letters, options);
	while ((option = getopt_long(argc, argv, letters, options, NULL)) != -1)
		apply_option(&r, option, argv);
	if (optind < argc - 1)
		cli_usage_error("give one log, or none to calibrate in the gateway on the bus");
	r.log = argv[optind];
	check(&r);
	if (r.log) {
		od_init(&od, &imu9_od_table, &values, 1);
		config_apply(&r.config, &od);
		r.settings = settings_pipeline(&values);
		return calibrate_from_log(&r);
	}
	if (!r.bus)
		r.bus = cli_default_bus();
	if (!r.node)
		r.node = (uint8_t)cli_default_node();
	return calibrate_live(&r);
}
