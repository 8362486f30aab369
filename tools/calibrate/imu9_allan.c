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
	"Usage: imu9-allan [-o PREFIX] LOG.imu.csv\n"
	"Identifies the noise of a sensor from a log at rest (several hours are best): the overlapping Allan\n"
	"deviation of gyro and accelerometer, and the figures fitted to it, in the units of the gateway's\n"
	"objects 2020h. A log with motion is refused; of one with gaps each part is used. Figures that it is\n"
	"too short for are left out.\n"
	"`-` reads standard input.\n"
	"\n"
	"  -o, --output PREFIX   write the deviations to PREFIX.csv and plot them to PREFIX.gp, .png and\n"
	"                        .svg (needs gnuplot)\n"
	"  -h, --help            this text\n"
	"  -V, --version         the version\n"
	"\n"
	"Densities are one-sided, as in datasheets: white noise of density n has the Allan deviation\n"
	"n / sqrt(2 tau), bias instability B a floor of 0.664 B, random walk K a rise of K sqrt(tau / 3).\n"
	"\n" CLI_EXIT_STATUS;

enum { CHANNELS = 6, MIN_SAMPLES = 1000 };
/* Sampling intervals: a longer one is a gap. By judgement: one lost sample changes nothing, and times may scatter. */
static const double GAP_INTERVALS = 2.5;
/* s; what a sensor at rest scatters by within that time at most (per 100 samples a second), and by how much its mean
 * may change over hours. By judgement: several times that of the noisiest sensors of drivers/; a hand has more. */
static const double BLOCK_S = 1, STILL_DEG_S = 1.5, STILL_MG = 40, SAME_DEG_S = 1, SAME_MG = 25;
/* More than any gyro's bias: the zero-rate level of the L3GD20 is 25 deg/s with all that adds up. */
static const double BIAS_DEG_S = 30;
static const char *const NAMES[CHANNELS] = {"gx", "gy", "gz", "ax", "ay", "az"};

struct recording {
	double *values[CHANNELS]; /* deg/s and mg */
	size_t count, room;
	size_t *starts, parts, parts_room; /* first value of each part between gaps */
	double recorded_s, longest_gap_s, missing_s;
	double rate_hz;
};

static void *more(void *array, size_t size, const struct recording *r)
{
	array = realloc(array, size);
	if (!array) {
		cli_error("out of memory after %zu samples: use a shorter log", r->count);
		exit(CLI_FAILED);
	}
	return array;
}

static void append(struct recording *r, const struct imu_sample *s)
{
	const double row[CHANNELS] = {s->gyro_rad_s.x * DEG_PER_RAD, s->gyro_rad_s.y * DEG_PER_RAD,
		s->gyro_rad_s.z * DEG_PER_RAD, s->accel_m_s2.x * 1e3 / STANDARD_GRAVITY_M_S2,
		s->accel_m_s2.y * 1e3 / STANDARD_GRAVITY_M_S2, s->accel_m_s2.z * 1e3 / STANDARD_GRAVITY_M_S2};

	if (r->count == r->room) {
		r->room = r->room ? 2 * r->room : 1 << 16;
		for (int i = 0; i < CHANNELS; i++)
			r->values[i] = more(r->values[i], r->room * sizeof(double), r);
	}
	for (int i = 0; i < CHANNELS; i++)
		r->values[i][r->count] = row[i];
	r->count++;
}

static void begin_part(struct recording *r)
{
	if (r->parts == r->parts_room) {
		r->parts_room = r->parts_room ? 2 * r->parts_room : 64;
		r->starts = more(r->starts, r->parts_room * sizeof *r->starts, r);
	}
	r->starts[r->parts++] = r->count;
}

/* A second of the recording, of which the motion is checked. */
struct block {
	double from_s, sum[CHANNELS], square[CHANNELS];
	size_t count;
};

static void refuse_motion(
	const char *path, double from_s, const char *what, double value, double limit, const char *unit)
{
	cli_error("%s: the sensor moved or was shaken at %.1f s (%s %.3g %s, limit %.3g): record it at rest, or cut "
		  "that off",
		path, from_s, what, value, unit, limit);
	exit(CLI_FAILED);
}

/* Length of the vector of deviations, of the gyro (first = 0) or the accelerometer. */
static double scatter(const struct block *b, int first)
{
	double sum = 0;

	for (int i = first; i < first + 3; i++)
		sum += fmax(0, b->square[i] / (double)b->count - pow(b->sum[i] / (double)b->count, 2));
	return sqrt(sum);
}

static double away(const struct block *b, const struct block *from, int first)
{
	double sum = 0;

	for (int i = first; i < first + 3; i++)
		sum += pow(b->sum[i] / (double)b->count - from->sum[i] / (double)from->count, 2);
	return sqrt(sum);
}

/* Each second on its own: how much it scatters, and how far its mean is from that of the first one. */
static void check_rest(const struct block *b, const struct block *first, const char *path, double rate_hz)
{
	const struct block still = {.count = 1};
	double noisier = fmax(1, sqrt(rate_hz / 100)); /* more noise with more bandwidth */

	if (b->count < 2)
		return;
	if (scatter(b, 0) > STILL_DEG_S * noisier)
		refuse_motion(path, b->from_s, "rates scatter by", scatter(b, 0), STILL_DEG_S * noisier, "deg/s");
	if (scatter(b, 3) > STILL_MG * noisier)
		refuse_motion(path, b->from_s, "forces scatter by", scatter(b, 3), STILL_MG * noisier, "mg");
	if (away(b, &still, 0) > BIAS_DEG_S)
		refuse_motion(path, b->from_s, "it turns by", away(b, &still, 0), BIAS_DEG_S, "deg/s");
	if (away(b, first, 0) > SAME_DEG_S)
		refuse_motion(path, b->from_s, "the rate changed by", away(b, first, 0), SAME_DEG_S, "deg/s");
	if (away(b, first, 3) > SAME_MG)
		refuse_motion(path, b->from_s, "the force changed by", away(b, first, 3), SAME_MG, "mg");
}

static void add_to_block(struct block *b, const struct recording *r)
{
	for (int i = 0; i < CHANNELS; i++) {
		double value = r->values[i][r->count - 1];

		b->sum[i] += value;
		b->square[i] += value * value;
	}
	b->count++;
}

static void load(struct recording *r, const char *path)
{
	static struct imu_log log;
	struct block block = {.count = 0}, first = {.count = 0};
	struct imu_sample sample;
	int64_t start_us = 0, last_us = 0;

	cli_log_open(&log, path, NULL);
	for (; cli_log_next(&log, &sample); last_us = (int64_t)sample.t_us) {
		double dt_s = 1e-6 * (double)((int64_t)sample.t_us - last_us), now_s;

		if (r->count == 0)
			start_us = (int64_t)sample.t_us;
		now_s = 1e-6 * (double)((int64_t)sample.t_us - start_us);
		if (r->count == 0 || dt_s * log.rate_hz > GAP_INTERVALS || (sample.flags & SAMPLE_DISCONTINUITY)) {
			begin_part(r);
			r->longest_gap_s = r->count ? fmax(r->longest_gap_s, dt_s) : 0;
			r->missing_s += r->count ? dt_s : 0;
		} else {
			r->recorded_s += dt_s;
		}
		if (now_s - block.from_s >= BLOCK_S) {
			first = first.count ? first : block;
			check_rest(&block, &first, path, log.rate_hz);
			block = (struct block){.from_s = now_s};
		}
		append(r, &sample);
		add_to_block(&block, r);
	}
	check_rest(&block, first.count ? &first : &block, path, log.rate_hz);
	if (r->count < MIN_SAMPLES) {
		cli_error("%s: only %zu samples: record at least %d of a sensor at rest, better several hours", path,
			r->count, MIN_SAMPLES);
		exit(CLI_FAILED);
	}
	if (r->parts > 1)
		cli_error("%s: %zu gap%s, %.4g s in all, the longest %.4g s: each of the %zu parts is used on its own",
			path, r->parts - 1, r->parts == 2 ? "" : "s", r->missing_s, r->longest_gap_s, r->parts);
	/* the mean rate: over hours the median interval of the first rows (log.rate_hz) is too inaccurate */
	r->rate_hz = r->count > r->parts ? (double)(r->count - r->parts) / r->recorded_s : log.rate_hz;
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

static void print_figure(double value, int width, const char *unit, int unit_width)
{
	if (value > 0)
		printf(" %*.5g %-*s", width, value, unit_width, unit);
	else
		printf(" %*s %-*s", width, "-", unit_width, "");
}

static void print_noise(const struct allan_noise noise[CHANNELS], const double digits[CHANNELS], double rate_hz)
{
	printf("\n%-5s %26s %18s %22s %16s\n", "", "density", "bias instability", "random walk", "digit");
	for (int i = 0; i < CHANNELS; i++) {
		const bool gyro = i < 3;
		double density = allan_density(&noise[i]), sigma = density * sqrt(rate_hz / 2);

		printf("%-5s", NAMES[i]);
		print_figure(gyro ? density : 1e3 * density, 12, gyro ? "deg/s/sqrtHz" : "ug/sqrtHz", 13);
		print_figure(noise[i].bias_instability, 12, gyro ? "deg/s" : "mg", 5);
		print_figure(noise[i].random_walk, 12, gyro ? "deg/s/sqrt(s)" : "mg/sqrt(s)", 13);
		printf(" %8.4g %-5s%s\n", digits[i], gyro ? "deg/s" : "mg",
			digits[i] > 1.5 * sigma ? "  (coarse digits: part of this noise is quantisation)" : "");
	}
	printf("-: the log is too short to show it\n");
}

/* The mean over the axes where it was found; a comment if it was on none. */
static void print_setting(const char *name, const double v[3])
{
	double sum = 0;
	int found = 0;

	for (int i = 0; i < 3; i++) {
		sum += v[i];
		found += v[i] > 0;
	}
	if (found)
		printf("%s=%.4g\n", name, sum / found);
	else
		printf("# %s: the log is too short to show it\n", name);
}

static void print_settings(const struct allan_noise noise[CHANNELS])
{
	double density[CHANNELS], bias[CHANNELS];

	for (int i = 0; i < CHANNELS; i++) {
		density[i] = (i < 3 ? 1 : 1e3) * allan_density(&noise[i]);
		bias[i] = noise[i].bias_instability;
	}
	printf("\nFor the configuration of the gateway (mean of the axes on which it was found):\n");
	print_setting("noise.gyro_density", density);
	print_setting("noise.accelerometer_density", density + 3);
	print_setting("noise.gyro_bias_instability", bias);
	print_setting("noise.accelerometer_bias_instability", bias + 3);
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

static const struct option options[] = {{"output", required_argument, NULL, 'o'}, CLI_COMMON_OPTIONS};

int main(int argc, char **argv)
{
	static struct recording recording;
	static struct allan all[CHANNELS];
	struct allan_noise fit[CHANNELS], noise[CHANNELS];
	double digits[CHANNELS];
	const char *prefix = NULL;
	int option;

	opterr = 0;
	while ((option = getopt_long(argc, argv, ":o:hV", options, NULL)) != -1) {
		switch (option) {
		case 'o':
			prefix = optarg;
			break;
		case 'h':
			fputs(usage, stdout);
			return CLI_OK;
		case 'V':
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
		allan_deviation_of_parts(recording.values[i], recording.count, recording.starts, recording.parts,
			recording.rate_hz, &all[i]);
		fit[i] = allan_fit(&all[i]);
		noise[i] = allan_observed(&all[i], &fit[i]);
	}
	printf("%zu samples at %.4g Hz: %.4g s\n\n", recording.count, recording.rate_hz,
		(double)recording.count / recording.rate_hz);
	print_deviations(all);
	print_noise(noise, digits, recording.rate_hz);
	print_settings(noise);
	if (!prefix)
		return CLI_OK;
	write_csv(prefix, all, fit);
	return plot(prefix) == 0 ? CLI_OK : CLI_FAILED;
}
