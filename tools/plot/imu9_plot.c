/* imu9-plot: figures of a log, a replay or a bus: attitude, acceleration, position, trajectory, spectrum, Allan
 * deviation. */
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "od_values.h"
#include "tools/calibrate/allan.h"
#include "tools/lib/cli.h"
#include "tools/lib/cli_config.h"
#include "tools/lib/cli_file.h"
#include "tools/lib/csv.h"
#include "tools/lib/plot.h"
#include "tools/plot/series.h"
#include "tools/plot/spectrum.h"

#define BLUE	"#0072b2"
#define ORANGE	"#d55e00"
#define GREEN	"#009e73"
#define GREY	"#999999"
#define LINE(c) "lines lw 1.2 lc rgb '" c "'"
#define BAND(c) "filledcurves fs transparent solid 0.25 noborder lc rgb '" c "'"

enum { PATH_SIZE = 4096 };

static const char usage[] =
	"Usage: imu9-plot [-o PREFIX] [-f FIGURE,...] [-c FILE] [--set NAME=VALUE]... FILE\n"
	"Draws figures, each as PNG and SVG, with the gnuplot script and the CSV behind it (needs gnuplot).\n"
	"FILE is a log (LOG.imu.csv), which goes through the pipeline of the gateway, the output of\n"
	"imu9-replay, or that of imu9-monitor --csv; the last two may come from standard input (-).\n"
	"\n"
	"  -o, --output PREFIX   the files are PREFIX_FIGURE.png, .svg, .gp and .csv (default: plot)\n"
	"  -f, --figure FIGURE   attitude, acceleration, position, trajectory, spectrum or allan; several with\n"
	"                        commas (default: all that FILE has values for)\n"
	"  -c, --config FILE     configuration file of the gateway, for a log\n"
	"      --set NAME=VALUE  any configuration object by its EDS name, for a log\n"
	"  -h, --help            this text\n"
	"  -V, --version         the version\n"
	"\n"
	"attitude: roll, pitch, yaw with 1 sigma (roll and pitch: that of the less certain horizontal axis).\n"
	"acceleration: of the reference point, before and after the\n"
	"correction of the lever arm (before: of a log only). position: with its 1-sigma band. trajectory:\n"
	"seen from above. spectrum: of the specific force (Welch), else of the acceleration. allan: Allan\n"
	"deviation of a log at rest.\n"
	"\n" CLI_EXIT_STATUS
	"\nExample: imu9-monitor -n 5 --start --sync 100 --rate 100 --csv -t 30 | imu9-plot -o robot -\n";

struct figures {
	char directory[PATH_SIZE], prefix[256]; /* of the files */
	const struct series *series;
	int drawn;
};

static void names_of(const struct figures *f, const char *figure, char *name, char *csv, size_t capacity)
{
	snprintf(name, capacity, "%s_%s", f->prefix, figure);
	snprintf(csv, capacity, "%s_%s.csv", f->prefix, figure);
}

static FILE *open_csv(const struct figures *f, const char *csv)
{
	char path[2 * PATH_SIZE];

	snprintf(path, sizeof(path), "%s/%s", f->directory, csv);
	return cli_create(path);
}

static void draw(struct figures *f, const struct plot_figure *figure)
{
	if (plot_figure(f->directory, figure) < 0)
		exit(CLI_FAILED);
	printf("%s/%s.png, .svg\n", f->directory, figure->name);
	f->drawn++;
}

/* ---- over time ---- */

/* A CSV of quantities, three columns each: "l0".."l2" of the first one, "m0".. of the second, empty where there is
 * none. */
static void write_rows(const struct figures *f, const char *csv, const enum series_quantity *quantities, int count)
{
	FILE *file = open_csv(f, csv);
	struct csv_row row = {0};

	fputs("t", file);
	for (int q = 0; q < count; q++)
		for (int i = 0; i < 3; i++)
			fprintf(file, ",%c%d", 'l' + q, i);
	fputc('\n', file);
	for (size_t r = 0; r < f->series->count; r++) {
		csv_number(&row, f->series->rows[r].t_s, 6);
		for (int q = 0; q < count; q++)
			for (int i = 0; i < 3; i++) {
				double value = f->series->rows[r].value[quantities[q]][i];

				if (isnan(value))
					csv_empty(&row, 1);
				else
					csv_number(&row, value, 6);
			}
		csv_write(&row, file);
	}
	cli_close(file, csv);
}

/* Three panels over time, one for each axis: a curve, its band, and another curve below it. */
static void draw_axes(struct figures *f, const char *figure, const char *title, const char *const axes[3],
	const char *unit, const enum series_quantity *quantities, int count, const char *const legends[])
{
	static const char *const BANDS[3] = {"\"t\":(column(\"l0\")-column(\"m0\")):(column(\"l0\")+column(\"m0\"))",
		"\"t\":(column(\"l1\")-column(\"m1\")):(column(\"l1\")+column(\"m1\"))",
		"\"t\":(column(\"l2\")-column(\"m2\")):(column(\"l2\")+column(\"m2\"))"};
	static const char *const CURVES[2][3] = {
		{"\"t\":\"l0\"", "\"t\":\"l1\"", "\"t\":\"l2\""}, {"\"t\":\"m0\"", "\"t\":\"m1\"", "\"t\":\"m2\""}};
	char name[512], csv[512], labels[3][64];
	struct plot_figure plot = {name, title, 3, 1, {{0}}};
	bool band = quantities[count - 1] == SERIES_POSITION_SIGMA || quantities[count - 1] == SERIES_ANGLES_SIGMA;

	names_of(f, figure, name, csv, sizeof(name));
	write_rows(f, csv, quantities, count);
	for (int i = 0; i < 3; i++) {
		struct plot_panel *panel = &plot.panels[i];
		int s = 0;

		snprintf(labels[i], sizeof(labels[i]), "%s [%s]", axes[i], unit);
		*panel = (struct plot_panel){"", "t [s]", labels[i], NULL, {{0}}};
		if (count > 1)
			panel->series[s++] = (struct plot_series){
				csv, band ? BANDS[i] : CURVES[1][i], legends[1], band ? BAND(BLUE) : LINE(GREY)};
		panel->series[s] = (struct plot_series){csv, CURVES[0][i], legends[0], LINE(BLUE)};
	}
	draw(f, &plot);
}

static void draw_attitude(struct figures *f)
{
	static const enum series_quantity ANGLES[] = {SERIES_ANGLES, SERIES_ANGLES_SIGMA};
	static const char *const AXES[] = {"roll φ", "pitch θ", "yaw ψ"};
	static const char *const LEGENDS[] = {"attitude", "±1 sigma"};

	draw_axes(f, "attitude", "Attitude", AXES, "deg", ANGLES, f->series->has[SERIES_ANGLES_SIGMA] ? 2 : 1, LEGENDS);
}

static void draw_acceleration(struct figures *f)
{
	static const enum series_quantity ACCELERATIONS[] = {SERIES_ACCELERATION, SERIES_UNCORRECTED};
	static const char *const AXES[] = {"a_l", "a_s", "a_t"};
	static const char *const LEGENDS[] = {
		"of the reference point (after the correction)", "of the sensor (before it)"};

	draw_axes(f, "acceleration", "Acceleration without gravity", AXES, "m/s^2", ACCELERATIONS,
		f->series->has[SERIES_UNCORRECTED] ? 2 : 1, LEGENDS);
}

static void draw_position(struct figures *f)
{
	static const enum series_quantity POSITIONS[] = {SERIES_POSITION, SERIES_POSITION_SIGMA};
	static const char *const AXES[] = {"x, east", "y, north", "z, up"};
	static const char *const LEGENDS[] = {"position", "±1 sigma"};

	draw_axes(f, "position", "Position", AXES, "m", POSITIONS, f->series->has[SERIES_POSITION_SIGMA] ? 2 : 1,
		LEGENDS);
}

static void draw_trajectory(struct figures *f)
{
	static const enum series_quantity POSITION[] = {SERIES_POSITION};
	char name[512], csv[512];
	struct plot_figure plot = {name, "Trajectory", 1, 2, {{0}}};

	names_of(f, "trajectory", name, csv, sizeof(name));
	write_rows(f, csv, POSITION, 1);
	plot.panels[0] = (struct plot_panel){"from above", "x, east [m]", "y, north [m]", "set size ratio -1",
		{{csv, "\"l0\":\"l1\"", "path", LINE(BLUE)},
			{csv, "(column(0) == 0 ? column(\"l0\") : NaN):\"l1\"", "start",
				"points pt 6 ps 1.5 lc rgb '" GREEN "'"}}};
	plot.panels[1] =
		(struct plot_panel){"height", "t [s]", "z, up [m]", NULL, {{csv, "\"t\":\"l2\"", "path", LINE(BLUE)}}};
	draw(f, &plot);
}

/* ---- over frequency and averaging time ---- */

static void draw_spectrum(struct figures *f)
{
	static struct spectrum spectra[3];
	const struct series *s = f->series;
	bool force = s->has[SERIES_FORCE];
	double *values = malloc(s->count * sizeof(*values));
	bool *usable = malloc(s->count * sizeof(*usable));
	char name[512], csv[512];

	if (!values || !usable) {
		cli_error("out of memory");
		exit(CLI_FAILED);
	}
	for (int i = 0; i < 3; i++) {
		for (size_t r = 0; r < s->count; r++) {
			values[r] = s->rows[r].value[force ? SERIES_FORCE : SERIES_ACCELERATION][i];
			usable[r] = series_follows(s, r) && !isnan(values[r]);
		}
		spectrum_of(values, usable, s->count, s->rate_hz, &spectra[i]);
	}
	free(values);
	free(usable);
	if (spectra[0].bins == 0) {
		cli_error("no spectrum: no 16 samples without a gap");
		return;
	}
	names_of(f, "spectrum", name, csv, sizeof(name));
	FILE *file = open_csv(f, csv);
	fputs("f,l,s,t\n", file);
	for (size_t k = 1; k <= spectra[0].bins; k++)
		fprintf(file, "%.6g,%.6g,%.6g,%.6g\n", (double)k * spectra[0].step_hz, sqrt(spectra[0].density[k]),
			sqrt(spectra[1].density[k]), sqrt(spectra[2].density[k]));
	cli_close(file, csv);
	struct plot_figure plot = {name, force ? "Spectrum of the specific force" : "Spectrum of the acceleration", 1,
		1,
		{{"", "f [Hz]", "density [m/s^2/√Hz]", "set logscale xy",
			{{csv, "\"f\":\"l\"", "l", LINE(BLUE)}, {csv, "\"f\":\"s\"", "s", LINE(ORANGE)},
				{csv, "\"f\":\"t\"", "t", LINE(GREEN)}}}}};
	draw(f, &plot);
}

static void draw_allan(struct figures *f)
{
	static const enum series_quantity QUANTITIES[2] = {SERIES_RATE, SERIES_FORCE};
	static struct allan all[2][3];
	const struct series *s = f->series;
	double *values = malloc(s->count * sizeof(*values));
	size_t *starts = malloc(s->count * sizeof(*starts)), parts = 0;
	char name[512], csv[512];

	if (!values || !starts) {
		cli_error("out of memory");
		exit(CLI_FAILED);
	}
	for (size_t r = 0; r < s->count; r++)
		if (!series_follows(s, r))
			starts[parts++] = r;
	for (int q = 0; q < 2; q++)
		for (int i = 0; i < 3; i++) {
			for (size_t r = 0; r < s->count; r++)
				values[r] = s->rows[r].value[QUANTITIES[q]][i];
			allan_deviation_of_parts(values, s->count, starts, parts, s->rate_hz, &all[q][i]);
		}
	free(values);
	free(starts);
	names_of(f, "allan", name, csv, sizeof(name));
	FILE *file = open_csv(f, csv);
	fputs("tau,gx,gy,gz,ax,ay,az\n", file);
	for (int k = 0; k < all[0][0].count; k++) {
		fprintf(file, "%.6g", all[0][0].points[k].tau_s);
		for (int q = 0; q < 2; q++)
			for (int i = 0; i < 3; i++)
				fprintf(file, ",%.6g", all[q][i].points[k].deviation);
		fputc('\n', file);
	}
	cli_close(file, csv);
	struct plot_figure plot = {name, "Overlapping Allan deviation", 1, 2,
		{{"gyro", "averaging time τ [s]", "deviation [deg/s]", "set logscale xy",
			 {{csv, "\"tau\":\"gx\"", "x", LINE(BLUE)}, {csv, "\"tau\":\"gy\"", "y", LINE(ORANGE)},
				 {csv, "\"tau\":\"gz\"", "z", LINE(GREEN)}}},
			{"accelerometer", "averaging time τ [s]", "deviation [m/s^2]", "set logscale xy",
				{{csv, "\"tau\":\"ax\"", "x", LINE(BLUE)}, {csv, "\"tau\":\"ay\"", "y", LINE(ORANGE)},
					{csv, "\"tau\":\"az\"", "z", LINE(GREEN)}}}}};
	draw(f, &plot);
}

/* ---- which ---- */

static bool has_attitude(const struct series *s)
{
	return s->has[SERIES_ANGLES];
}

static bool has_acceleration(const struct series *s)
{
	return s->has[SERIES_ACCELERATION];
}

static bool has_position(const struct series *s)
{
	return s->has[SERIES_POSITION];
}

static bool has_spectrum(const struct series *s)
{
	return s->has[SERIES_FORCE] || s->has[SERIES_ACCELERATION];
}

static bool has_rest(const struct series *s)
{
	return s->rests;
}

static const struct {
	const char *name;
	bool (*possible)(const struct series *s);
	void (*draw)(struct figures *f);
	const char *needs;
} FIGURES[] = {
	{"attitude", has_attitude, draw_attitude, "roll, pitch and yaw"},
	{"acceleration", has_acceleration, draw_acceleration, "the acceleration"},
	{"position", has_position, draw_position, "the position"},
	{"trajectory", has_position, draw_trajectory, "the position"},
	{"spectrum", has_spectrum, draw_spectrum, "the specific force or acceleration"},
	{"allan", has_rest, draw_allan, "a log at rest from begin to end"},
};
enum { FIGURE_COUNT = sizeof(FIGURES) / sizeof(FIGURES[0]) };

/* The bits of the figures in the list. */
static unsigned chosen_figures(char *list)
{
	unsigned chosen = 0;

	for (char *rest = NULL, *word = strtok_r(list, ",", &rest); word; word = strtok_r(NULL, ",", &rest)) {
		int i = 0;

		while (i < FIGURE_COUNT && strcmp(word, FIGURES[i].name) != 0)
			i++;
		if (i == FIGURE_COUNT)
			cli_usage_error(
				"no figure '%s': attitude, acceleration, position, trajectory, spectrum or allan",
				word);
		chosen |= 1u << i;
	}
	return chosen;
}

static void draw_figures(struct figures *f, unsigned chosen, const char *path)
{
	for (int i = 0; i < FIGURE_COUNT; i++) {
		bool possible = FIGURES[i].possible(f->series);

		if (chosen >> i & 1 && !possible) {
			cli_error("%s: no figure %s: it needs %s", path, FIGURES[i].name, FIGURES[i].needs);
			exit(CLI_FAILED);
		}
		if (possible && (!chosen || chosen >> i & 1))
			FIGURES[i].draw(f);
	}
	if (f->drawn == 0) {
		cli_error("%s: has no values for a figure", path);
		exit(CLI_FAILED);
	}
}

static void set_prefix(struct figures *f, const char *prefix)
{
	const char *slash = strrchr(prefix, '/'), *name = slash ? slash + 1 : prefix;

	if (!*name || strlen(name) >= sizeof(f->prefix) || strlen(prefix) >= sizeof(f->directory))
		cli_usage_error("-o %s: give a name, with or without a folder before it", prefix);
	snprintf(f->directory, sizeof(f->directory), "%.*s", slash ? (int)(slash - prefix) : 1, slash ? prefix : ".");
	if (slash == prefix)
		strcpy(f->directory, "/");
	strcpy(f->prefix, name);
}

int main(int argc, char **argv)
{
	static const struct option options[] = {{"output", required_argument, NULL, 'o'},
		{"figure", required_argument, NULL, 'f'}, {"config", required_argument, NULL, 'c'},
		{"set", required_argument, NULL, 's'}, CLI_COMMON_OPTIONS};
	static struct config config;
	static struct series series;
	struct figures f = {.directory = ".", .prefix = "plot", .series = &series};
	unsigned chosen = 0;
	int option;

	config_init(&config, &imu9_od_table);
	cli_config_files(&config, argc, argv, ":o:f:c:hV", options);
	while ((option = getopt_long(argc, argv, ":o:f:c:hV", options, NULL)) != -1) {
		switch (option) {
		case 'o':
			set_prefix(&f, optarg);
			break;
		case 'f':
			chosen |= chosen_figures(optarg);
			break;
		case 'c':
			break; /* read before */
		case 's':
			cli_config_set(&config, optarg);
			break;
		case 'h':
			fputs(usage, stdout);
			return CLI_OK;
		case 'V':
			puts("imu9-plot " IMU9_VERSION);
			return CLI_OK;
		default:
			cli_bad_option(option, argv);
		}
	}
	if (optind != argc - 1)
		cli_usage_error("give one file");
	series_load(&series, argv[optind], &config);
	draw_figures(&f, chosen, argv[optind]);
	return CLI_OK;
}
