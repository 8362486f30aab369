/* tools/experiments/imu9_sim.c
 * imu9-sim: logs of simulated sensors on simulated motions, and the experiments of the paper. */
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model/math/units.h"
#include "model/sim/sensor.h"
#include "tools/lib/cli.h"
#include "tools/lib/cli_file.h"
#include "tools/lib/csv.h"
#include "tools/experiments/experiments.h"

static const char usage[] =
	"Usage: imu9-sim [OPTION]... SIGNAL >LOG.imu.csv\n"
	"       imu9-sim experiments [-o DIR]\n"
	"       imu9-sim --list\n"
	"Writes the log of a simulated IMU: t,gx,gy,gz,ax,ay,az,mx,my,mz in s, rad/s, m/s^2, uT. Or\n"
	"repeats the experiments of the paper of the acceleration model, with tables and figures in DIR.\n"
	"\n"
	"  -d, --duration S      seconds (default: one cycle of the motion)\n"
	"  -r, --rate HZ         samples per second (default 100)\n"
	"  -s, --sensor PRESET   sensor error model (default lsm303dlhc_l3gd20)\n"
	"      --uncalibrated    with bias, scale and cross-axis errors, as delivered\n"
	"      --warming K       warm up by K from 25 degC: the biases change, and the log gets a column\n"
	"                        temperature\n"
	"      --jitter S        1 sigma of the sampling instant, seconds (default 0)\n"
	"      --seed N          each seed is another chip with other noise (default 1)\n"
	"      --lever-arm L,S,T metres from the reference point to the accelerometer (default 0,0,0)\n"
	"      --angle DEG       amplitude of the largest quick rotation of the motion\n"
	"      --change S        duration of a quick change\n"
	"  -t, --truth           append columns: attitude (object -> ENU), rate, angular acceleration,\n"
	"                        acceleration of the reference point in object and global frame,\n"
	"                        velocity, position\n"
	"  -o, --output FILE     output file (default: standard output); experiments: a directory\n"
	"                        (default: build/experiments)\n"
	"  -l, --list            list the signals and sensor presets\n"
	"  -h, --help            this text\n"
	"  -V, --version         the version\n"
	"\n" CLI_EXIT_STATUS;

static const char HEADER[] = "t,gx,gy,gz,ax,ay,az,mx,my,mz";
static const char TRUTH_HEADER[] = ",qw,qx,qy,qz,wl,ws,wt,dwl,dws,dwt,al,as,at,awx,awy,awz,vx,vy,vz,px,py,pz";

struct request {
	struct signal signal;
	struct sensor_config sensor;
	double duration_s;
	uint64_t seed;
	bool truth;
	const char *output;
};

static void list(void)
{
	puts("Signals (amplitude and duration of their quick changes):");
	for (const struct signal *s = SIGNALS; s->name; s++)
		printf("  %-24s %s (%.3g deg, %.3g s; cycle: %.3g s)\n", s->name, s->about, s->angle_rad / RAD_PER_DEG,
			s->change_s, s->period_s);
	puts("Sensor presets:");
	for (const struct sensor_config *s = SENSOR_PRESETS; s->name; s++)
		printf("  %-24s %s\n", s->name, s->about);
	puts("Experiments: imu9-sim experiments");
}

static void write_truth(struct csv_row *row, const struct signal_truth *truth)
{
	csv_number(row, truth->q_nb.w, 9);
	csv_vec3(row, (struct vec3){truth->q_nb.x, truth->q_nb.y, truth->q_nb.z}, 9);
	csv_vec3(row, truth->omega_b_rad_s, 7);
	csv_vec3(row, truth->alpha_b_rad_s2, 6);
	csv_vec3(row, quat_rotate_inverse(truth->q_nb, truth->accel_n_m_s2), 6);
	csv_vec3(row, truth->accel_n_m_s2, 6);
	csv_vec3(row, truth->velocity_n_m_s, 6);
	csv_vec3(row, truth->position_n_m, 6);
}

static void write_sample(struct csv_row *row, const struct imu_sample *sample)
{
	csv_time(row, (int64_t)sample->t_us);
	csv_vec3(row, sample->gyro_rad_s, 6);
	csv_vec3(row, sample->accel_m_s2, 5);
	if (sample->flags & SAMPLE_MAG)
		csv_vec3(row, sample->mag_uT, 3);
	else
		csv_empty(row, 3);
	if (sample->flags & SAMPLE_TEMPERATURE)
		csv_number(row, sample->temperature_degC, 3);
}

static void write_log(const struct request *request, FILE *file)
{
	const uint64_t count = (uint64_t)(request->duration_s * request->sensor.rate_hz + 0.5);
	static struct sensor sensor;
	struct csv_row row = {0};

	if (sensor_init(&sensor, &request->sensor, request->seed) < 0)
		cli_usage_error(
			"--jitter %g: more than a tenth of the interval between samples", request->sensor.jitter_s);
	fprintf(file, "%s%s%s\n", HEADER, request->sensor.warming_K != 0 ? ",temperature" : "",
		request->truth ? TRUTH_HEADER : "");
	for (uint64_t k = 0; k < count && !ferror(file); k++) {
		struct imu_sample sample;
		struct signal_truth truth;

		sensor_next(&sensor, &request->signal, &sample, &truth);
		write_sample(&row, &sample);
		if (request->truth)
			write_truth(&row, &truth);
		csv_write(&row, file);
	}
}

static struct vec3 lever_arm_option(const char *text)
{
	char copy[64], *rest = copy, *part;
	double r[3];
	int n = 0;

	snprintf(copy, sizeof copy, "%s", text);
	while ((part = strsep(&rest, ","))) {
		if (n == 3 || !cli_real(part, -10, 10, &r[n]))
			break;
		n++;
	}
	if (n != 3 || part)
		cli_usage_error("--lever-arm %s: not three numbers from -10 to 10, as in 0.05,0,0", text);
	return (struct vec3){r[0], r[1], r[2]};
}

static const struct sensor_config *sensor_option(const char *name)
{
	const struct sensor_config *preset = sensor_preset(name);

	if (!preset)
		cli_usage_error("--sensor %s: unknown preset: see imu9-sim --list", name);
	return preset;
}

enum {
	OPT_UNCALIBRATED = 256,
	OPT_WARMING,
	OPT_JITTER,
	OPT_SEED,
	OPT_LEVER_ARM,
	OPT_ANGLE,
	OPT_CHANGE,
};

static const struct option options[] = {
	{"duration", required_argument, NULL, 'd'},
	{"rate", required_argument, NULL, 'r'},
	{"sensor", required_argument, NULL, 's'},
	{"uncalibrated", no_argument, NULL, OPT_UNCALIBRATED},
	{"warming", required_argument, NULL, OPT_WARMING},
	{"jitter", required_argument, NULL, OPT_JITTER},
	{"seed", required_argument, NULL, OPT_SEED},
	{"lever-arm", required_argument, NULL, OPT_LEVER_ARM},
	{"angle", required_argument, NULL, OPT_ANGLE},
	{"change", required_argument, NULL, OPT_CHANGE},
	{"truth", no_argument, NULL, 't'},
	{"output", required_argument, NULL, 'o'},
	{"list", no_argument, NULL, 'l'},
	CLI_COMMON_OPTIONS,
};

/* The command line; 0: the value of the signal, whose name is known after the options. */
struct arguments {
	const struct sensor_config *sensor;
	struct vec3 lever_arm_b_m;
	double duration_s, rate_hz, warming_K, jitter_s, angle_rad, change_s;
	uint64_t seed;
	bool uncalibrated, truth;
	const char *output;
};

static void apply_option(struct arguments *a, int option, char **argv)
{
	switch (option) {
	case 'd':
		a->duration_s = cli_real_option("--duration", optarg, 1e-3, 1e7);
		break;
	case 'r':
		a->rate_hz = cli_real_option("--rate", optarg, 0.1, 1e5);
		break;
	case 's':
		a->sensor = sensor_option(optarg);
		break;
	case 't':
		a->truth = true;
		break;
	case 'o':
		a->output = optarg;
		break;
	case OPT_UNCALIBRATED:
		a->uncalibrated = true;
		break;
	case OPT_WARMING:
		a->warming_K = cli_real_option("--warming", optarg, -100, 100);
		break;
	case OPT_JITTER:
		a->jitter_s = cli_real_option("--jitter", optarg, 0, 1);
		break;
	case OPT_SEED:
		a->seed = (uint64_t)cli_integer_option("--seed", optarg, 0, 0x7fffffff);
		break;
	case OPT_LEVER_ARM:
		a->lever_arm_b_m = lever_arm_option(optarg);
		break;
	case OPT_ANGLE:
		a->angle_rad = RAD_PER_DEG * cli_real_option("--angle", optarg, 1e-6, 1e6);
		break;
	case OPT_CHANGE:
		a->change_s = cli_real_option("--change", optarg, 1e-3, 1e4);
		break;
	case 'l':
		list();
		exit(CLI_OK);
	case 'h':
		fputs(usage, stdout);
		exit(CLI_OK);
	case 'V':
		puts("imu9-sim " IMU9_VERSION);
		exit(CLI_OK);
	default:
		cli_bad_option(option, argv);
	}
}

static const struct signal *signal_option(const char *name)
{
	const struct signal *signal = signal_find(name);

	if (!signal)
		cli_usage_error("%s: unknown signal: see imu9-sim --list", name);
	return signal;
}

static struct request request_of(const struct arguments *a, const char *name)
{
	const struct signal *signal = signal_option(name);
	struct request request;

	request = (struct request){.signal = *signal,
		.sensor = *a->sensor,
		.duration_s = a->duration_s > 0 ? a->duration_s : signal->period_s,
		.seed = a->seed,
		.truth = a->truth,
		.output = a->output};
	if (a->angle_rad > 0)
		request.signal.angle_rad = a->angle_rad;
	if (a->change_s > 0)
		request.signal.change_s = a->change_s;
	if (a->rate_hz > 0)
		request.sensor.rate_hz = a->rate_hz;
	request.sensor.warming_K = a->warming_K;
	request.sensor.jitter_s = a->jitter_s;
	request.sensor.lever_arm_b_m = a->lever_arm_b_m;
	if (!a->uncalibrated)
		sensor_calibrate(&request.sensor);
	return request;
}

int main(int argc, char **argv)
{
	struct arguments arguments = {.sensor = &SENSOR_PRESETS[0], .seed = 1};
	struct request request;
	FILE *file;
	bool log_options = false;
	int option;

	opterr = 0;
	while ((option = getopt_long(argc, argv, ":d:r:s:to:lhV", options, NULL)) != -1) {
		apply_option(&arguments, option, argv);
		log_options |= option != 'o';
	}
	if (optind != argc - 1)
		cli_usage_error("give one signal (see imu9-sim --list), or the word experiments");
	if (strcmp(argv[optind], "experiments") == 0 && log_options)
		cli_usage_error("experiments has no option but -o");
	if (strcmp(argv[optind], "experiments") == 0)
		return experiments(arguments.output ? arguments.output : "build/experiments");
	request = request_of(&arguments, argv[optind]);
	file = cli_create(request.output);
	write_log(&request, file);
	cli_close(file, request.output);
	return CLI_OK;
}
