/* tools/calibrate/imu9_allan.c
 * imu9-allan: identifies the noise of a sensor from a log at rest. */
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model/math/units.h"
#include "tools/calibrate/allan.h"
#include "tools/lib/cli.h"
#include "tools/lib/cli_file.h"
#include "tools/lib/plot.h"

static const char usage[] =
	"usage: imu9-allan [-o PREFIX] LOG.imu.csv\n"
	"Overlapping Allan deviation of gyro and accelerometer from a log at rest (several hours are\n"
	"best), and the noise figures fitted to it, in the units of the gateway's objects 2020h.\n"
	"`-` reads standard input.\n"
	"\n"
	"  -o, --output PREFIX   write the deviations to PREFIX.csv and plot them to PREFIX.gp, .png and\n"
	"                        .svg (needs gnuplot)\n"
	"      --help, --version\n"
	"\n"
	"Densities are one-sided, as in datasheets: white noise of density n has the Allan deviation\n"
	"n / sqrt(2 tau), bias instability B a floor of 0.664 B, random walk K a rise of K sqrt(tau / 3).\n"
	"Exit status: 0 done, 1 failed, 2 wrong usage.\n";

enum { CHANNELS = 6, MIN_SAMPLES = 1000 };
static const char *const NAMES[CHANNELS] = {"gx", "gy", "gz", "ax", "ay", "az"};

struct recording {
	double *values[CHANNELS]; /* deg/s and mg */
	size_t count, room;
	double rate_hz;
};

static void append(struct recording *r, const struct imu_sample *s)
{
	const double row[CHANNELS] = {s->gyro_rad_s.x * DEG_PER_RAD, s->gyro_rad_s.y * DEG_PER_RAD,
		s->gyro_rad_s.z * DEG_PER_RAD, s->accel_m_s2.x * 1e3 / STANDARD_GRAVITY_M_S2,
		s->accel_m_s2.y * 1e3 / STANDARD_GRAVITY_M_S2, s->accel_m_s2.z * 1e3 / STANDARD_GRAVITY_M_S2};

	if (r->count == r->room) {
		r->room = r->room ? 2 * r->room : 1 << 16;
		for (int i = 0; i < CHANNELS; i++) {
			r->values[i] = realloc(r->values[i], r->room * sizeof(double));
			if (!r->values[i]) {
				cli_error("out of memory after %zu samples: use a shorter log", r->count);
				exit(CLI_FAILED);
			}
		}
	}
	for (int i = 0; i < CHANNELS; i++)
		r->values[i][r->count] = row[i];
	r->count++;
}

static void load(struct recording *r, const char *path)
{
	static struct imu_log log;
	struct imu_sample sample;
	uint64_t first_us = 0;

	cli_log_open(&log, path, NULL);
	while (cli_log_next(&log, &sample)) {
		if (r->count == 0)
			first_us = sample.t_us;
		append(r, &sample);
	}
	if (r->count < MIN_SAMPLES) {
		cli_error("%s: only %zu samples: record at least %d of a sensor at rest, better several hours", path,
			r->count, MIN_SAMPLES);
		exit(CLI_FAILED);
	}
	/* the mean rate: over hours the median interval of the first rows (log.rate_hz) is too inaccurate */
	r->rate_hz = (double)(r->count - 1) * 1e6 / (double)(sample.t_us - first_us);
}

/* Quantisation step: the smallest difference between successive samples. */
static double digit(const double *values, size_t count)
{
	double least = INFINITY;

	for (size_t i = 1; i < count; i++) {
		double d = fabs(values[i] - values[i - 1]);

		if (d > 1e-9 && d < least)
			least = d;
	}
	return isfinite(least) ? least : 0;
}

static void print_deviations(const struct allan all[CHANNELS])
{
	printf("%10s %10s %10s %10s %10s %10s %10s %7s\n", "tau/s", "gx deg/s", "gy deg/s", "gz deg/s", "ax mg",
		"ay mg", "az mg", "1-sigma");
	for (int k = 0; k < all[0].count; k++) {
		printf("%10.4g", all[0].points[k].tau_s);
		for (int i = 0; i < CHANNELS; i++)
			printf(" %10.4g", all[i].points[k].deviation);
		printf(" %6.1f%%\n", 100 * all[0].points[k].relative_error);
	}
}

static void print_noise(const struct allan_noise noise[CHANNELS], const double digits[CHANNELS], double rate_hz)
{
	printf("\n%-5s %26s %18s %22s %16s\n", "", "density", "bias instability", "random walk", "digit");
	for (int i = 0; i < CHANNELS; i++) {
		const bool gyro = i < 3;
		double density = allan_density(&noise[i]), sigma = density * sqrt(rate_hz / 2);

		printf("%-5s %12.5g %-13s %12.5g %-5s %12.5g %-13s %8.4g %-5s%s\n", NAMES[i],
			gyro ? density : 1e3 * density, gyro ? "deg/s/sqrtHz" : "ug/sqrtHz", noise[i].bias_instability,
			gyro ? "deg/s" : "mg", noise[i].random_walk, gyro ? "deg/s/sqrt(s)" : "mg/sqrt(s)", digits[i],
			gyro ? "deg/s" : "mg",
			digits[i] > 1.5 * sigma ? "  (coarse digits: part of this noise is quantisation)" : "");
	}
}

static double mean3(const double v[3])
{
	return (v[0] + v[1] + v[2]) / 3;
}

static void print_settings(const struct allan_noise noise[CHANNELS])
{
	double density[CHANNELS], bias[CHANNELS];

	for (int i = 0; i < CHANNELS; i++) {
		density[i] = allan_density(&noise[i]);
		bias[i] = noise[i].bias_instability;
	}
	printf("\nFor the configuration of the gateway (mean of the axes):\n");
	printf("noise.gyro_density=%.4g\nnoise.accelerometer_density=%.4g\n", mean3(density), 1e3 * mean3(density + 3));
	printf("noise.gyro_bias_instability=%.4g\nnoise.accelerometer_bias_instability=%.4g\n", mean3(bias),
		mean3(bias + 3));
}

static void write_csv(const char *prefix, const struct allan all[CHANNELS], const struct allan_noise noise[CHANNELS])
{
	char path[4096];
	FILE *file;

	snprintf(path, sizeof path, "%s.csv", prefix);
	file = cli_create(path);
	fputs("tau", file);
	for (int i = 0; i < CHANNELS; i++)
		fprintf(file, ",%s,%s_fit", NAMES[i], NAMES[i]);
	for (int k = 0; k < all[0].count; k++) {
		fprintf(file, "\n%.6g", all[0].points[k].tau_s);
		for (int i = 0; i < CHANNELS; i++)
			fprintf(file, ",%.6g,%.6g", all[i].points[k].deviation,
				allan_model(&noise[i], all[0].points[k].tau_s));
	}
	fputc('\n', file);
	cli_close(file, path);
}

static struct plot_panel panel(const char *title, const char *ylabel, const char *csv, const char *const names[3])
{
	static const char *const POINTS[3] = {"points pt 7 ps 0.5 lc rgb '#0072b2'",
		"points pt 7 ps 0.5 lc rgb '#d55e00'", "points pt 7 ps 0.5 lc rgb '#009e73'"};
	static const char *const LINES[3] = {
		"lines lc rgb '#0072b2'", "lines lc rgb '#d55e00'", "lines lc rgb '#009e73'"};
	static char use[2 * CHANNELS][32], titles[CHANNELS][16];
	static int used;
	struct plot_panel p = {title, "averaging time tau [s]", ylabel, "set logscale xy", {{0}}};

	for (int i = 0; i < 3; i++, used++) {
		snprintf(use[2 * used], sizeof use[0], "\"tau\":\"%s\"", names[i]);
		snprintf(use[2 * used + 1], sizeof use[0], "\"tau\":\"%s_fit\"", names[i]);
		snprintf(titles[used], sizeof titles[0], "%s, fit", names[i]);
		p.series[2 * i] = (struct plot_series){csv, use[2 * used], names[i], POINTS[i]};
		p.series[2 * i + 1] = (struct plot_series){csv, use[2 * used + 1], titles[used], LINES[i]};
	}
	return p;
}

static int plot(const char *prefix)
{
	const char *slash = strrchr(prefix, '/'), *name = slash ? slash + 1 : prefix;
	char directory[4096], csv[256];
	struct plot_figure figure = {name, "Overlapping Allan deviation", 1, 2, {{0}}};

	snprintf(directory, sizeof directory, "%.*s", slash ? (int)(slash - prefix + 1) : 1, slash ? prefix : ".");
	snprintf(csv, sizeof csv, "%s.csv", name);
	figure.panels[0] = panel("gyro", "Allan deviation [deg/s]", csv, NAMES);
	figure.panels[1] = panel("accelerometer", "Allan deviation [mg]", csv, NAMES + 3);
	return plot_figure(directory, &figure);
}

static const struct option options[] = {{"output", required_argument, NULL, 'o'}, {"help", no_argument, NULL, 'h'},
	{"version", no_argument, NULL, 'v'}, {0}};

int main(int argc, char **argv)
{
	static struct recording recording;
	static struct allan all[CHANNELS];
	struct allan_noise noise[CHANNELS];
	double digits[CHANNELS];
	const char *prefix = NULL;
	int option;

	opterr = 0;
	while ((option = getopt_long(argc, argv, ":o:", options, NULL)) != -1) {
		switch (option) {
		case 'o':
			prefix = optarg;
			break;
		case 'h':
			fputs(usage, stdout);
			return CLI_OK;
		case 'v':
			puts("imu9-allan " IMU9_VERSION);
			return CLI_OK;
		default:
			cli_bad_option(option, argv);
		}
	}
	if (optind != argc - 1)
		cli_usage_error("give one log, or - for standard input");
	load(&recording, argv[optind]);
	for (int i = 0; i < CHANNELS; i++) {
		digits[i] = digit(recording.values[i], recording.count);
		allan_deviation(recording.values[i], recording.count, recording.rate_hz, &all[i]);
		noise[i] = allan_fit(&all[i]);
	}
	printf("%zu samples at %.4g Hz: %.4g s\n\n", recording.count, recording.rate_hz,
		(double)recording.count / recording.rate_hz);
	print_deviations(all);
	print_noise(noise, digits, recording.rate_hz);
	print_settings(noise);
	if (!prefix)
		return CLI_OK;
	write_csv(prefix, all, noise);
	return plot(prefix) == 0 ? CLI_OK : CLI_FAILED;
}
