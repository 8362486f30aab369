#include "tools/plot/series.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gateway/settings.h"
#include "model/math/units.h"
#include "model/pipeline.h"
#include "od_values.h"
#include "tools/lib/cli.h"
#include "tools/lib/cli_file.h"

enum { LINE_LENGTH = 8192, CELLS_MAX = 256 };
static const double REST_KNOWN_S = 3; /* until then rest is being detected */

static struct series_row *add_row(struct series *s)
{
	if (s->count % 4096 == 0) {
		struct series_row *rows = realloc(s->rows, (s->count + 4096) * sizeof(*rows));

		if (!rows) {
			cli_error("out of memory after %zu rows: cut the log", s->count);
			exit(CLI_FAILED);
		}
		s->rows = rows;
	}
	struct series_row *row = &s->rows[s->count++];
	for (int q = 0; q < SERIES_QUANTITIES; q++)
		for (int i = 0; i < 3; i++)
			row->value[q][i] = NAN;
	row->rest = false;
	return row;
}

static void set(struct series_row *row, enum series_quantity quantity, double factor, struct vec3 v)
{
	row->value[quantity][0] = factor * v.x;
	row->value[quantity][1] = factor * v.y;
	row->value[quantity][2] = factor * v.z;
}

/* ---- a log, through the pipeline with and without the correction of the lever arm ---- */

static void load_log(struct series *s, const char *path, const struct config *config)
{
	static struct pipeline pipeline, plain;
	static struct od_values values;
	static struct imu_log log;
	struct od od;
	struct imu_sample sample;
	struct pipeline_output out, uncorrected;

	cli_log_open(&log, path, NULL);
	od_init(&od, &imu9_od_table, &values, (uint8_t)config->node_id);
	config_apply(config, &od);
	struct pipeline_config settings = settings_pipeline(&values);
	settings.uncalibrated = settings_uncalibrated(&values, imu_log_uncalibrated(&log));
	struct pipeline_config without = settings;
	without.estimator.model = LEVER_ARM_OFF;
	if (pipeline_init(&pipeline, &settings, log.rate_hz) < 0 || pipeline_init(&plain, &without, log.rate_hz) < 0) {
		cli_error("invalid configuration: is a calibration matrix singular?");
		exit(CLI_USAGE);
	}
	while (cli_log_next(&log, &sample)) {
		if (pipeline_step(&pipeline, &sample, &out) < 0 || pipeline_step(&plain, &sample, &uncorrected) < 0)
			continue;
		struct series_row *row = add_row(s);
		row->t_s = 1e-6 * (double)((int64_t)sample.t_us - log.origin_us);
		row->rest = out.status & PIPELINE_REST;
		set(row, SERIES_FORCE, 1, out.force_b_m_s2);
		set(row, SERIES_RATE, DEG_PER_RAD, sample.gyro_rad_s);
		if (!(out.status & PIPELINE_VALID))
			continue;
		set(row, SERIES_ANGLES, DEG_PER_RAD, out.angles_rad);
		set(row, SERIES_ANGLES_SIGMA, DEG_PER_RAD, out.sigma.attitude_rad);
		set(row, SERIES_ACCELERATION, 1, out.accel_b_m_s2);
		set(row, SERIES_UNCORRECTED, 1, uncorrected.accel_b_m_s2);
		set(row, SERIES_POSITION, 1, out.position_n_m);
		set(row, SERIES_POSITION_SIGMA, 1, out.sigma.position_m);
	}
	s->rests = true;
}

/* ---- CSV with columns by name ---- */

/* Cuts the line at its commas, those in quotes excepted. */
static size_t split(char *line, char *cells[CELLS_MAX])
{
	size_t n = 0;
	bool quoted = false;

	line[strcspn(line, "\r\n")] = '\0';
	cells[n++] = line;
	for (char *c = line; *c && n < CELLS_MAX; c++) {
		quoted ^= *c == '"';
		if (*c == ',' && !quoted) {
			*c = '\0';
			cells[n++] = c + 1;
		}
	}
	return n;
}

struct column {
	const char *replay, *monitor[2]; /* names in the output of imu9-replay and imu9-monitor */
	enum series_quantity quantity;
	int axis;
	double replay_factor;
};

static const struct column columns[] = {
	{"roll", {"angles.roll [deg]", "angles_deg.roll [deg]"}, SERIES_ANGLES, 0, 1},
	{"pitch", {"angles.pitch [deg]", "angles_deg.pitch [deg]"}, SERIES_ANGLES, 1, 1},
	{"yaw", {"angles.yaw [deg]", "angles_deg.yaw [deg]"}, SERIES_ANGLES, 2, 1},
	{"srx", {"attitude_sigma16.x [deg]", "attitude_sigma.x [deg]"}, SERIES_ANGLES_SIGMA, 0, DEG_PER_RAD},
	{"sry", {"attitude_sigma16.y [deg]", "attitude_sigma.y [deg]"}, SERIES_ANGLES_SIGMA, 1, DEG_PER_RAD},
	{"srz", {"attitude_sigma16.z [deg]", "attitude_sigma.z [deg]"}, SERIES_ANGLES_SIGMA, 2, DEG_PER_RAD},
	{"al", {"acceleration.l [m/s^2]", "acceleration_object.l [m/s^2]"}, SERIES_ACCELERATION, 0, 1},
	{"as", {"acceleration.s [m/s^2]", "acceleration_object.s [m/s^2]"}, SERIES_ACCELERATION, 1, 1},
	{"at", {"acceleration.t [m/s^2]", "acceleration_object.t [m/s^2]"}, SERIES_ACCELERATION, 2, 1},
	{"px", {"position_output.x [m]", "position_m.x [m]"}, SERIES_POSITION, 0, 1},
	{"py", {"position_output.y [m]", "position_m.y [m]"}, SERIES_POSITION, 1, 1},
	{"pz", {"position_output.z [m]", "position_m.z [m]"}, SERIES_POSITION, 2, 1},
	{"spx", {"position_sigma16.x [m]", "position_sigma.x [m]"}, SERIES_POSITION_SIGMA, 0, 1},
	{"spy", {"position_sigma16.y [m]", "position_sigma.y [m]"}, SERIES_POSITION_SIGMA, 1, 1},
	{"spz", {"position_sigma16.z [m]", "position_sigma.z [m]"}, SERIES_POSITION_SIGMA, 2, 1},
	{"", {"specific_force16.l [m/s^2]", "specific_force.l [m/s^2]"}, SERIES_FORCE, 0, 1},
	{"", {"specific_force16.s [m/s^2]", "specific_force.s [m/s^2]"}, SERIES_FORCE, 1, 1},
	{"", {"specific_force16.t [m/s^2]", "specific_force.t [m/s^2]"}, SERIES_FORCE, 2, 1},
};

static const struct column *find_column(const char *name, bool monitor)
{
	for (size_t i = 0; i < sizeof(columns) / sizeof(columns[0]); i++)
		if (monitor ? !strcmp(name, columns[i].monitor[0]) || !strcmp(name, columns[i].monitor[1])
			    : name[0] && !strcmp(name, columns[i].replay))
			return &columns[i];
	return NULL;
}

static void load_csv(struct series *s, FILE *file, char *line, bool monitor)
{
	const struct column *meaning[CELLS_MAX] = {NULL};
	char *cells[CELLS_MAX];
	size_t n = split(line, cells), rest = CELLS_MAX;

	for (size_t i = 0; i < n; i++) {
		meaning[i] = find_column(cells[i], monitor);
		if (!monitor && strcmp(cells[i], "rest") == 0)
			rest = i;
	}
	while (fgets(line, LINE_LENGTH, file)) {
		size_t count = split(line, cells);
		char *end;
		double t_s = strtod(cells[0], &end);

		if (end == cells[0] || count != n)
			continue; /* a header again: the mapping has changed */
		struct series_row *row = add_row(s);
		row->t_s = t_s;
		row->rest = rest < n && cells[rest][0] == '1';
		for (size_t i = 1; i < n; i++)
			if (meaning[i] && cells[i][0])
				row->value[meaning[i]->quantity][meaning[i]->axis] =
					strtod(cells[i], NULL) * (monitor ? 1 : meaning[i]->replay_factor);
	}
}

/* ---- */

static int compare(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

static void find_rate(struct series *s)
{
	double *intervals = malloc(s->count * sizeof(*intervals));

	if (!intervals)
		exit(CLI_FAILED);
	for (size_t i = 1; i < s->count; i++)
		intervals[i - 1] = s->rows[i].t_s - s->rows[i - 1].t_s;
	qsort(intervals, s->count - 1, sizeof(*intervals), compare);
	double median = intervals[(s->count - 1) / 2];
	s->rate_hz = median > 0 ? 1 / median : 0;
	free(intervals);
}

bool series_follows(const struct series *s, size_t row)
{
	return row > 0 && (s->rows[row].t_s - s->rows[row - 1].t_s) * s->rate_hz < 1.5;
}

static void find_contents(struct series *s)
{
	size_t at_rest = 0, judged = 0;

	for (size_t r = 0; r < s->count; r++) {
		double *sigma = s->rows[r].value[SERIES_ANGLES_SIGMA];

		sigma[0] = sigma[1] = fmax(sigma[0], sigma[1]); /* they are about east and north */
		if (s->rows[r].t_s - s->rows[0].t_s > REST_KNOWN_S) {
			at_rest += s->rows[r].rest;
			judged++;
		}
		for (int q = 0; q < SERIES_QUANTITIES; q++)
			for (int i = 0; i < 3; i++)
				s->has[q] |= !isnan(s->rows[r].value[q][i]);
	}
	s->rests = s->rests && judged > 0 && at_rest * 100 > judged * 99;
}

void series_load(struct series *s, const char *path, const struct config *config)
{
	static char line[LINE_LENGTH];
	bool from_stdin = strcmp(path, "-") == 0;
	FILE *file = from_stdin ? stdin : fopen(path, "re");

	if (!file || !fgets(line, sizeof(line), file)) {
		cli_error("%s: %s", path, file ? "is empty" : strerror(errno));
		exit(CLI_FAILED);
	}
	bool replay = strncmp(line, "t,qw,", 5) == 0, monitor = strncmp(line, "t [s],utc,", 10) == 0;
	if (replay || monitor)
		load_csv(s, file, line, monitor);
	else if (from_stdin)
		cli_usage_error("standard input is neither the output of imu9-replay nor of imu9-monitor --csv: give a "
				"log as a file");
	if (!from_stdin)
		fclose(file);
	if (!replay && !monitor)
		load_log(s, path, config);
	if (s->count < 3) {
		cli_error("%s: %zu rows are too few for a figure", path, s->count);
		exit(CLI_FAILED);
	}
	find_rate(s);
	find_contents(s);
}
