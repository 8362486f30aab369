/* tools/replay/imu9_replay.c
 * imu9-replay: runs the pipeline of the gateway over a recorded log as fast as possible; one output row for each
 * sample. */
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "gateway/config.h"
#include "gateway/settings.h"
#include "model/math/units.h"
#include "model/pipeline.h"
#include "model/smoother.h"
#include "od_values.h"
#include "tools/lib/cli.h"
#include "tools/lib/cli_config.h"
#include "tools/lib/cli_file.h"
#include "tools/lib/csv.h"
#include "tools/replay/recording.h"

static const char usage[] =
	"Usage: imu9-replay [-c FILE] [--set NAME=VALUE]... [--format FORMAT] [--movements FILE] LOG.imu.csv >OUT.csv\n"
	"  or:  imu9-replay [--frames FILE] [--movements FILE] [--set NAME=VALUE]... RECORDING.imu.csv... >OUT.csv\n"
	"Runs a recorded IMU log through the pipeline of the gateway; `-` reads standard input.\n"
	"\n"
	"  -c, --config FILE     configuration file of the gateway (its section [gateway] is ignored)\n"
	"      --set NAME=VALUE  any configuration object by its EDS name, e.g. lever_arm.l=0.05\n"
	"      --format FORMAT   the log is of another program: phyphox (a file, or the folder of an export),\n"
	"                        euroc, x-io, pandas; imu9 is the default\n"
	"      --movements FILE  write the smoothed path of each movement between two standstills\n"
	"      --frames FILE     of a recording: write the frames that the gateway sent, as candump -L does\n"
	"  -h, --help            this text\n"
	"  -V, --version         the version\n"
	"\n"
	"LOG: header t,gx,gy,gz,ax,ay,az,mx,my,mz; s, rad/s, m/s^2, uT, or the units that it names, e.g.\n"
	"     t[ms], gx[deg/s], ax[g], mx[gauss]; magnetometer fields can be empty. What was skipped or\n"
	"     converted, and units that are unlikely, are told on standard error.\n"
	"RECORDING: files of imu9-gateway --record. They have the configuration and all that came in, so values\n"
	"     and frames are those of then, bit for bit; with -c or --set, what they would have been.\n"
	"OUT: attitude object -> ENU (qw..qz; roll, pitch, yaw in degrees), acceleration of the\n"
	"     reference point in object (al..at) and global frame (awx..awz), velocity, position\n"
	"     (ENU), the rest flag, the sample counter as in the PDOs (here without wrap-around),\n"
	"     angular rate wl..wt and acceleration dwl..dwt, the status word,\n"
	"     1 sigma of the attitude (srx..srz, about x y z of ENU, radians), of aw, v and p.\n"
	"FILE: movement (from 1), t (as in LOG), t_s (since it began), position x_m..z_m since then,\n"
	"     velocity vx_m_s..vz_m_s (ENU), 1 sigma of the position sx_m..sz_m, whole (0: interrupted by a gap).\n"
	"\n" CLI_EXIT_STATUS;

static const char header[] = "t,qw,qx,qy,qz,al,as,at,awx,awy,awz,vx,vy,vz,px,py,pz,rest,sample,roll,pitch,yaw,"
			     "wl,ws,wt,dwl,dws,dwt,status,srx,sry,srz,sawx,sawy,sawz,svx,svy,svz,spx,spy,spz\n";

static const char movements_header[] = "movement,t,t_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,sx_m,sy_m,sz_m,whole\n";

/* ---- a row ------------------------------------------------------------------------------------------------------- */

static void print_row(const struct pipeline_output *o, int64_t t_us, uint64_t sample)
{
	static struct csv_row row;

	csv_time(&row, t_us);
	csv_number(&row, o->q_nb.w, 8);
	csv_vec3(&row, (struct vec3){o->q_nb.x, o->q_nb.y, o->q_nb.z}, 8);
	csv_vec3(&row, o->accel_b_m_s2, 6);
	csv_vec3(&row, o->accel_n_m_s2, 6);
	csv_vec3(&row, o->velocity_n_m_s, 6);
	csv_vec3(&row, o->position_n_m, 6);
	csv_number(&row, o->status & PIPELINE_REST ? 1 : 0, 0);
	csv_number(&row, (double)sample, 0);
	csv_vec3(&row, vec3_scale(DEG_PER_RAD, o->angles_rad), 5);
	csv_vec3(&row, o->rate_b_rad_s, 7);
	csv_vec3(&row, o->alpha_b_rad_s2, 5);
	csv_number(&row, o->status, 0);
	csv_vec3(&row, o->sigma.attitude_rad, 6);
	csv_vec3(&row, o->sigma.accel_m_s2, 5);
	csv_vec3(&row, o->sigma.velocity_m_s, 5);
	csv_vec3(&row, o->sigma.position_m, 5);
	csv_write(&row, stdout);
}

/* The movement ended stood_s before t_us. */
static void print_movement(const struct smoother_movement *m, int64_t t_us, FILE *file)
{
	int64_t start_us = t_us - llround(1e6 * (m->duration_s + m->stood_s));
	static struct csv_row row;

	for (size_t i = 0; i < m->count; i++) {
		const struct smoother_point *p = &m->point[i];

		csv_number(&row, m->number, 0);
		csv_time(&row, start_us + llround(1e6 * p->t_s));
		csv_number(&row, p->t_s, 6);
		csv_vec3(&row, p->position_n_m, 6);
		csv_vec3(&row, p->velocity_n_m_s, 6);
		csv_vec3(&row, p->sigma_m, 6);
		csv_number(&row, m->whole, 0);
		csv_write(&row, file);
	}
}

/* ---- the run ----------------------------------------------------------------------------------------------------- */

struct output {
	FILE *frames, *movements; /* NULL: not wanted */
	unsigned movement;	  /* the last one that was written */
};

static void on_sample(void *ctx, const struct device *d)
{
	struct output *out = ctx;
	const struct pipeline_output *o = &d->pipeline.last_good;

	print_row(o, (int64_t)o->t_us, d->samples - 1);
	if (out->movements && d->last_movement.smoother.last.number > out->movement)
		print_movement(&d->last_movement.smoother.last, (int64_t)o->t_us, out->movements);
	out->movement = d->last_movement.smoother.last.number;
}

static void on_frame(void *ctx, const char *bus, const struct can_msg *msg, uint64_t now_us)
{
	const struct output *out = ctx;

	if (!out->frames)
		return;
	fprintf(out->frames, "(%010llu.%06llu) %s %03X#", (unsigned long long)(now_us / 1000000),
		(unsigned long long)(now_us % 1000000), bus, msg->id);
	for (int i = 0; i < msg->len; i++)
		fprintf(out->frames, "%02X", msg->data[i]);
	fputc('\n', out->frames);
}

/* Each of the files begins with its state. */
static int replay_recordings(const struct config *changes, char *const paths[], struct output *out)
{
	const struct recording_events events = {.ctx = out, .sample = on_sample, .frame = on_frame};

	fputs(header, stdout);
	if (out->movements)
		fputs(movements_header, out->movements);
	bool good = true;
	for (; *paths; paths++)
		good = recording_replay(*paths, changes, &events) && good;
	cli_close(stdout, NULL);
	return good ? CLI_OK : CLI_FAILED;
}

static int fail(int status, const char *why)
{
	cli_error("%s", why);
	return status;
}

static int replay(const struct config *config, const char *path, const struct log_format *format, FILE *movements)
{
	static struct pipeline pipeline;
	static struct smoother smoother;
	static struct od_values values;
	struct od od;
	static struct imu_log log;
	struct imu_sample sample;
	struct pipeline_output out;
	uint64_t samples = 0, rows = 0;
	unsigned movement = 0;

	cli_log_open(&log, path, format);
	od_init(&od, &imu9_od_table, &values, (uint8_t)config->node_id);
	config_apply(config, &od);
	struct pipeline_config settings = settings_pipeline(&values);
	settings.uncalibrated = settings_uncalibrated(&values, imu_log_uncalibrated(&log));
	if (pipeline_init(&pipeline, &settings, log.rate_hz) < 0)
		return fail(CLI_USAGE, "invalid configuration: is a calibration matrix singular?");
	pipeline_smooth(&pipeline, &smoother);
	fputs(header, stdout);
	if (movements)
		fputs(movements_header, movements);
	for (; cli_log_next(&log, &sample); samples++) {
		int64_t t_us = (int64_t)sample.t_us - log.origin_us;

		if (pipeline_step(&pipeline, &sample, &out) < 0)
			continue;
		print_row(&out, t_us, samples);
		rows++;
		if (movements && smoother.last.number != movement)
			print_movement(&smoother.last, t_us, movements);
		movement = smoother.last.number;
	}
	if (rows == 0)
		return fail(CLI_FAILED, "the log has no usable row");
	cli_close(stdout, NULL);
	return CLI_OK;
}

static const struct log_format *format_named(const char *name)
{
	const struct log_format *format = log_format_named(name);

	if (!format)
		cli_usage_error("unknown format: use imu9, phyphox, euroc, x-io or pandas");
	return format;
}

struct files {
	const char *movements, *frames;
};

/* -1: run; else the exit status. */
static int read_configuration(
	struct config *config, struct files *files, const struct log_format **format, int argc, char **argv)
{
	static const struct option options[] = {{"config", required_argument, NULL, 'c'},
		{"set", required_argument, NULL, 's'}, {"movements", required_argument, NULL, 'm'},
		{"format", required_argument, NULL, 'f'}, {"frames", required_argument, NULL, 'F'}, CLI_COMMON_OPTIONS};
	int option;

	cli_config_files(config, argc, argv, ":c:hV", options);
	while ((option = getopt_long(argc, argv, ":c:hV", options, NULL)) != -1) {
		if (option == 'h') {
			fputs(usage, stdout);
			return CLI_OK;
		}
		if (option == 'V') {
			puts("imu9-replay " IMU9_VERSION);
			return CLI_OK;
		}
		if (option == '?' || option == ':')
			cli_bad_option(option, argv);
		if (option == 's')
			cli_config_set(config, optarg);
		if (option == 'm')
			files->movements = optarg;
		if (option == 'F')
			files->frames = optarg;
		if (option == 'f')
			*format = format_named(optarg);
	}
	if (optind != argc - 1 && !(optind < argc && recording_is(argv[optind])))
		cli_usage_error("give one log, or - for standard input; or the files of a recording");
	return -1;
}

int main(int argc, char **argv)
{
	static struct config config;
	struct files files = {0};
	const struct log_format *format = NULL;
	struct output out = {0};

	config_init(&config, &imu9_od_table);
	int status = read_configuration(&config, &files, &format, argc, argv);
	if (status >= 0)
		return status;
	const char *path = argv[optind];
	bool recording = recording_is(path);
	if (files.frames && !recording)
		cli_usage_error("--frames: %s is no recording of imu9-gateway --record", path);
	out.frames = files.frames ? cli_create(files.frames) : NULL;
	out.movements = files.movements ? cli_create(files.movements) : NULL;
	status = recording ? replay_recordings(&config, argv + optind, &out)
			   : replay(&config, path, format, out.movements);
	if (out.movements)
		cli_close(out.movements, files.movements);
	if (out.frames)
		cli_close(out.frames, files.frames);
	return status;
}
