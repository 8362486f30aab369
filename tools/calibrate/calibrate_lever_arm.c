#include "tools/calibrate/calibrate_lever_arm.h"

#include <stdio.h>
#include <stdlib.h>

#include "gateway/settings.h"
#include "model/identify/lever_identification.h"
#include "od_values.h"
#include "tools/lib/cli.h"
#include "tools/lib/cli_config.h"
#include "tools/lib/cli_file.h"
#include "tools/lib/reference_log.h"

static const char usage[] =
	"Usage: imu9-calibrate lever-arm [--reference REF] [OPTION]... LOG.imu.csv\n"
	"       imu9-calibrate lever-arm [-i BUS] [-n NODE] [--aided] [--yes]\n"
	"Identifies the lever arm (2000h: from the reference point to the accelerometer) from a log, or,\n"
	"without one, in the gateway on the bus (2060h), from a motion in which either\n"
	"  - the reference point was held still while the object was turned about all its axes for 30 s, or\n"
	"  - the object moved in any way with quick rotations, and the acceleration of the reference point\n"
	"    is known: from REF, or from the columns ref_al,ref_as,ref_at of LOG (m/s^2, object frame,\n"
	"    without gravity).\n"
	"On the bus the program says which axis is missing, shows r and its sigma, and asks whether to accept.\n"
	"\n"
	"With a log ('-': standard input):\n"
	"  -r, --reference REF   CSV with the columns t,qw,qx,qy,qz,arx,ary,arz: time in s; attitude\n"
	"                        sensor -> world; acceleration of the reference point in the world frame\n"
	"                        without gravity, m/s^2. Fields can be empty\n"
	"  -d, --estimate-delay  estimate the delay of the reference (+-20 ms) instead of trusting its\n"
	"                        time stamps\n"
	"  -c, --config FILE     configuration of the gateway: its calibration and mounting are applied\n"
	"      --set NAME=VALUE  any configuration object by its EDS name\n"
	"On the bus:\n"
	"  -i, --can BUS         as for imu9-sdo (default: $IMU9_CAN or vcan0)\n"
	"  -n, --node-id NODE    node-ID 1 to 127 (default: $IMU9_NODE or 1)\n"
	"  -a, --aided           another device sends the acceleration of the reference point (2075h)\n"
	"  -y, --yes             start and accept a good result without asking\n"
	"  -t, --timeout MS      for one SDO answer (default 1000)\n"
	"  -h, --help            this text\n"
	"  -V, --version         the version\n"
	"\n"
	"Calibrate gyro and accelerometer first.\n" CLI_EXIT_STATUS;

struct options {
	const char *reference, *log;
	bool estimate_delay;
	struct config config;
	struct lever_request live;
};

/* ---- the run ----------------------------------------------------------------------------------------------------- */

struct run {
	struct imu_log log;
	struct reference_log reference;
	struct pipeline pipeline;
	struct lever_identification identification;
	uint64_t first_us, last_us;
	unsigned long samples;
};

static void prepare(struct run *r, const struct options *o)
{
	static struct od_values values;
	struct lever_identification_config config = {.duration_s = 30, .estimate_delay = o->estimate_delay};
	struct pipeline_config settings;
	char why[512];
	struct od od;

	cli_log_open(&r->log, o->log, NULL);
	if (o->reference && reference_log_load(&r->reference, o->reference, why, sizeof why) < 0) {
		cli_error("%s", why);
		exit(CLI_FAILED);
	}
	config.rate_hz = r->log.rate_hz;
	config.reference = o->reference || imu_log_has_reference(&r->log);
	if (config.estimate_delay && !config.reference)
		cli_usage_error("--estimate-delay needs a reference: give --reference REF");
	od_init(&od, &imu9_od_table, &values, 1);
	config_apply(&o->config, &od);
	settings = settings_pipeline(&values);
	if (pipeline_init(&r->pipeline, &settings, r->log.rate_hz) < 0)
		cli_usage_error("invalid configuration: is a calibration matrix singular?");
	if (lever_identification_init(&r->identification, &config) < 0) {
		cli_error("%s: %.4g samples per second: at least 25 are needed", o->log, r->log.rate_hz);
		exit(CLI_FAILED);
	}
}

/* Acceleration of the reference point in the object frame. REF's acceleration was rotated by REF's own attitude, so a
 * heading offset between REF and this sensor cancels. */
static const struct vec3 *reference_of(struct run *r, struct imu_sample *s)
{
	const struct vec3 mounting_rad = r->pipeline.config.calibration.mounting_rad;
	struct vec3 sensor_m_s2;

	if (s->flags & SAMPLE_REFERENCE)
		return &s->ref_accel_b_m_s2;
	if (r->reference.count == 0 || !reference_log_at(&r->reference, s->t_us, &sensor_m_s2))
		return NULL;
	s->ref_accel_b_m_s2 = quat_rotate(quat_from_aerospace(mounting_rad), sensor_m_s2);
	return &s->ref_accel_b_m_s2;
}

/* The pipeline estimates the bias of the gyro, as in the gateway. */
static void add_sample(struct run *r, const struct imu_sample *sample)
{
	struct imu_sample s = calibration_apply(&r->pipeline.calibration, sample);
	struct pipeline_output out;

	if (pipeline_step(&r->pipeline, sample, &out) < 0)
		return;
	if (s.flags & (SAMPLE_SATURATED | SAMPLE_DISCONTINUITY))
		lever_identification_break(&r->identification);
	else
		lever_identification_step(&r->identification, s.t_us, fusion_rate_b(&r->pipeline.fusion, s.gyro_rad_s),
			s.accel_m_s2, reference_of(r, &s));
	if (r->samples++ == 0)
		r->first_us = s.t_us;
	r->last_us = s.t_us;
}

/* ---- the result ----------------------------------------------------------------------------------------------- */

static void print(const struct run *r, const struct lever_estimate *e)
{
	const struct lever_identification_config *config = &r->identification.config;
	const struct vec3 arm = e->lever_arm_b_m, sigma = e->sigma_b_m;

	printf("%lu samples at %.4g Hz, %.1f s, %s\n", r->samples, config->rate_hz,
		(double)(r->last_us - r->first_us) * 1e-6,
		config->reference ? "with a reference" : "reference point held still");
	printf("lever arm   l %9.2f +- %.2f   s %9.2f +- %.2f   t %9.2f +- %.2f mm (1 sigma)\n", 1e3 * arm.x,
		1e3 * sigma.x, 1e3 * arm.y, 1e3 * sigma.y, 1e3 * arm.z, 1e3 * sigma.z);
	printf("residual    %.3f m/s^2 RMS\n", e->residual_m_s2);
	if (config->reference)
		printf("reference   %.1f ms %s%s\n", fabs(1e3 * e->delay_s), e->delay_s < 0 ? "early" : "late",
			config->estimate_delay ? "" : ", not corrected (see --estimate-delay)");
	printf("verdict     %s\n", lever_verdict_text(e->verdict));
	if (e->verdict == LEVER_FOUND)
		printf("\nFor the configuration file of the gateway:\n[lever_arm]\nl = %.5f\ns = %.5f\nt = %.5f\n",
			arm.x, arm.y, arm.z);
}

static const struct option known[] = {{"reference", required_argument, NULL, 'r'},
	{"estimate-delay", no_argument, NULL, 'd'}, {"config", required_argument, NULL, 'c'},
	{"set", required_argument, NULL, 's'}, CLI_BUS_OPTIONS, {"aided", no_argument, NULL, 'a'},
	{"yes", no_argument, NULL, 'y'}, {"timeout", required_argument, NULL, 't'}, CLI_COMMON_OPTIONS};

static void apply_option(struct options *o, int option, char **argv)
{
	switch (option) {
	case 'r':
		o->reference = optarg;
		break;
	case 'd':
		o->estimate_delay = true;
		break;
	case 's':
		cli_config_set(&o->config, optarg);
		break;
	case 'i':
		o->live.bus = optarg;
		break;
	case 'n':
		o->live.node = (uint8_t)cli_integer_option("-n", optarg, 1, 127);
		break;
	case 'a':
		o->live.reference = true;
		break;
	case 'y':
		o->live.yes = true;
		break;
	case 't':
		o->live.timeout_ms = (unsigned)cli_integer_option("-t", optarg, 1, 600000);
		break;
	case 'h':
		fputs(usage, stdout);
		exit(CLI_OK);
	case 'V':
		puts("imu9-calibrate " IMU9_VERSION);
		exit(CLI_OK);
	case 'c':
		break; /* read by cli_config_files() */
	default:
		cli_bad_option(option, argv);
	}
}

static void parse_options(struct options *o, int argc, char **argv)
{
	static const char letters[] = ":r:dc:i:n:ayt:hV";
	int option;

	config_init(&o->config, &imu9_od_table);
	cli_config_files(&o->config, argc, argv, letters, known);
	while ((option = getopt_long(argc, argv, letters, known, NULL)) != -1)
		apply_option(o, option, argv);
	if (optind < argc - 1)
		cli_usage_error("give one log, or none to identify it in the gateway on the bus");
	o->log = argv[optind];
	if (!o->log && (o->reference || o->estimate_delay))
		cli_usage_error("--reference and --estimate-delay need a log; on the bus: --aided");
	if (!o->live.bus)
		o->live.bus = cli_default_bus();
	if (!o->live.node)
		o->live.node = (uint8_t)cli_default_node();
	if (!o->live.timeout_ms)
		o->live.timeout_ms = 1000;
}

int calibrate_lever_arm(int argc, char **argv)
{
	static struct options options;
	static struct run run;
	struct lever_estimate estimate;
	struct imu_sample sample;

	parse_options(&options, argc, argv);
	if (!options.log)
		return calibrate_lever_live(&options.live);
	prepare(&run, &options);
	while (cli_log_next(&run.log, &sample))
		add_sample(&run, &sample);
	reference_log_close(&run.reference);
	estimate = lever_identification_estimate(&run.identification);
	print(&run, &estimate);
	return estimate.verdict == LEVER_FOUND ? CLI_OK : CLI_FAILED;
}
