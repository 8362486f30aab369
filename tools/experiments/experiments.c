#include "tools/experiments/experiments.h"

#include <errno.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "model/math/units.h"
#include "tools/experiments/methods.h"
#include "tools/lib/cli.h"
#include "tools/lib/cli_file.h"
#include "tools/lib/csv.h"
#include "tools/lib/plot.h"

#define BLUE	"#0072b2"
#define ORANGE	"#d55e00"
#define GREEN	"#009e73"
#define PURPLE	"#cc79a7"
#define GREY	"#999999"
#define BLACK	"#000000"
#define LINE(c) "lines lw 1.5 lc rgb '" c "'"
#define BOTH(c) "linespoints pt 7 ps 0.5 lw 1.5 lc rgb '" c "'"

enum { NOISES = 7, PATH_SIZE = 4096 };
static const double NOISE_DEG[NOISES] = {0.02, 0.05, 0.1, 0.2, 0.3, 0.7, 2.0};
static const double G_M_S2 = 9.81;

/* Output directory. All failures end the program: there is nothing to clean up. */
static const char *directory;

static FILE *open_csv(const char *name, const char *header)
{
	char path[PATH_SIZE];
	FILE *file;

	snprintf(path, sizeof path, "%s/%s", directory, name);
	file = cli_create(path);
	fprintf(file, "%s\n", header);
	return file;
}

static void close_csv(FILE *file)
{
	cli_close(file, directory);
}

static void draw(const struct plot_figure *figure)
{
	if (plot_figure(directory, figure) < 0)
		exit(CLI_FAILED);
	printf("  %s.png, .svg: %s\n", figure->name, figure->title);
	fflush(stdout);
}

static struct trial make_trial(const struct trial_config *config)
{
	struct trial trial;

	if (trial_make(&trial, config) < 0) {
		cli_error("out of memory");
		exit(CLI_FAILED);
	}
	return trial;
}

static void *allocate(int count, size_t size)
{
	void *values = calloc((size_t)count, size);

	if (!values) {
		cli_error("out of memory");
		exit(CLI_FAILED);
	}
	return values;
}

static struct score run_and_score(enum method method, const struct trial *trial, double angle_noise_deg)
{
	struct vec3 *estimate = allocate(trial->count, sizeof *estimate);
	struct score score;

	method_run(method, trial, angle_noise_deg * RAD_PER_DEG, estimate);
	score = method_score(trial, estimate);
	free(estimate);
	return score;
}

/* ---- Figs. 5-7: the roll step ------------------------------------------------------------------------------------ */

/* Second component of the last term of (9), in g, from angles with that noise; 0 degrees: the true one. */
static void second_correction(const struct trial *trial, double angle_noise_deg, double *correction_g)
{
	struct seed_motion *motion = trial->scratch;

	for (int k = 0; k < trial->count; k++)
		motion[k].angles_rad = vec3_add(
			trial->motion[k].angles_rad, vec3_scale(angle_noise_deg * RAD_PER_DEG, trial->angle_noise[k]));
	seed_differentiate(motion, trial->count, trial->dt_s);
	for (int k = 0; k < trial->count; k++) {
		/* for the roll alone, as in the paper */
		struct seed_motion roll = {.rates_rad_s = {motion[k].rates_rad_s.x, 0, 0}};

		correction_g[k] = seed_lever_arm(&roll, trial->config.lever_arm_b_m).y / G_M_S2;
	}
}

static void roll_step_figures(void)
{
	const struct trial_config config = trial_defaults(WORLD_SEED, "roll_step");
	const double noise_deg[] = {0, 0.2, 0.7, 2.0};
	struct trial trial = make_trial(&config);
	const int shown = (int)(4 * config.rate_hz);
	FILE *file = open_csv("fig05_07.csv", "t,phi_deg,phi_noisy_deg,phi_rate_gyro,true_g,g_0.2,g_0.7,g_2.0,gyro_g");
	double *correction[4];

	for (int i = 0; i < 4; i++) {
		correction[i] = allocate(trial.count, sizeof(double));
		second_correction(&trial, noise_deg[i], correction[i]);
	}
	for (int k = 0; k < shown; k++) {
		struct csv_row row = {0};
		double phi_deg = trial.motion[k].angles_rad.x / RAD_PER_DEG, rate = trial.gyro_b_rad_s[k].x;

		csv_number(&row, k * trial.dt_s, 3);
		csv_number(&row, phi_deg, 4);
		csv_number(&row, phi_deg + 0.7 * trial.angle_noise[k].x, 4);
		csv_number(&row, rate, 4);
		for (int i = 0; i < 4; i++)
			csv_number(&row, correction[i][k], 5);
		csv_number(&row, rate * rate * config.lever_arm_b_m.y / G_M_S2, 5);
		csv_write(&row, file);
	}
	close_csv(file);
	for (int i = 0; i < 4; i++)
		free(correction[i]);
	trial_free(&trial);

	draw(&(struct plot_figure){"fig05_roll_step", "Fig. 5. Test signal: roll step (50 Hz, 24 degrees)", 1, 2,
		{{"(a) after the FIR", "t [s]", "φ [deg]", NULL,
			 {{"fig05_07.csv", "\"t\":\"phi_deg\"", "φ", BOTH(BLUE)}}},
			{"(b) with noise of 0.7 degrees", "t [s]", "φ [deg]", NULL,
				{{"fig05_07.csv", "\"t\":\"phi_noisy_deg\"", "φ + Δφ", BOTH(BLUE)}}}}});
	draw(&(struct plot_figure){"fig06_correction",
		"Fig. 6. Rotation dynamics (correction term) for the roll step: r = 5 cm, noise of 0.7 degrees", 1, 2,
		{{"the paper's method: differentiated angles", "t [s]", "φ̇^2 r_s [g]", "set yrange [0:1.2]",
			 {{"fig05_07.csv", "\"t\":\"g_0.7\"", "φ̇ from φ + Δφ", BOTH(ORANGE)},
				 {"fig05_07.csv", "\"t\":\"true_g\"", "true", LINE(BLACK)}}},
			{"ours: rate from the gyro", "t [s]", "φ̇^2 r_s [g]", "set yrange [0:1.2]",
				{{"fig05_07.csv", "\"t\":\"gyro_g\"", "φ̇ from the gyro", BOTH(GREEN)},
					{"fig05_07.csv", "\"t\":\"true_g\"", "true", LINE(BLACK)}}}}});
	draw(&(struct plot_figure){"fig07_correction_noisy",
		"Fig. 7. Rotation dynamics for the roll step at two other levels of noise, r = 5 cm", 1, 2,
		{{"(a) noise of 0.2 degrees", "t [s]", "φ̇^2 r_s [g]", "set yrange [0:1.2]",
			 {{"fig05_07.csv", "\"t\":\"g_0.2\"", "φ̇ from φ + Δφ", BOTH(ORANGE)},
				 {"fig05_07.csv", "\"t\":\"true_g\"", "true", LINE(BLACK)}}},
			{"(b) noise of 2.0 degrees", "t [s]", "φ̇^2 r_s [g]", "set yrange [0:1.2]",
				{{"fig05_07.csv", "\"t\":\"g_2.0\"", "φ̇ from φ + Δφ", BOTH(ORANGE)},
					{"fig05_07.csv", "\"t\":\"true_g\"", "true", LINE(BLACK)}}}}});
}

/* ---- Figs. 8-9: the other inputs --------------------------------------------------------------------------------- */

static void input_figure(const char *signal, double until_s, const char *csv, const char *name, const char *title)
{
	const struct trial_config config = trial_defaults(WORLD_SEED, signal);
	const struct plot_figure figure = {name, title, 1, 3,
		{{"angles, noise of 0.7 degrees", "t [s]", "φ, θ, ψ [deg]", NULL,
			 {{csv, "\"t\":\"phi_deg\"", "φ", LINE(BLUE)}, {csv, "\"t\":\"theta_deg\"", "θ", LINE(GREEN)},
				 {csv, "\"t\":\"psi_deg\"", "ψ", LINE(ORANGE)}}},
			{"linear acceleration (truth)", "t [s]", "a [m/s^2]", NULL,
				{{csv, "\"t\":\"al\"", "a_l", LINE(BLUE)}, {csv, "\"t\":\"as\"", "a_s", LINE(GREEN)},
					{csv, "\"t\":\"at\"", "a_t", LINE(ORANGE)}}},
			{"measured acceleration, (11)", "t [s]", "ã [m/s^2]", NULL,
				{{csv, "\"t\":\"fl\"", "ã_l", LINE(BLUE)}, {csv, "\"t\":\"fs\"", "ã_s", LINE(GREEN)},
					{csv, "\"t\":\"ft\"", "ã_t", LINE(ORANGE)}}}}};
	struct trial trial = make_trial(&config);
	FILE *file = open_csv(csv, "t,phi_deg,theta_deg,psi_deg,al,as,at,fl,fs,ft");

	for (int k = 0; k < trial.count && k * trial.dt_s < until_s; k++) {
		struct csv_row row = {0};
		struct vec3 angles_deg = vec3_scale(1 / RAD_PER_DEG, trial.motion[k].angles_rad);

		csv_number(&row, k * trial.dt_s, 3);
		csv_vec3(&row, vec3_add(angles_deg, vec3_scale(0.7, trial.angle_noise[k])), 4);
		csv_vec3(&row, trial.accel_b_m_s2[k], 4);
		csv_vec3(&row, trial.force_b_m_s2[k], 4);
		csv_write(&row, file);
	}
	close_csv(file);
	trial_free(&trial);
	draw(&figure);
}

/* ---- Figs. 10-12: estimates at low, medium and high noise -------------------------------------------------------- */

static void estimate_csv(const char *name, const char *signal, double from_s, double to_s, double noise_deg)
{
	const struct trial_config config = trial_defaults(WORLD_SEED, signal);
	struct trial trial = make_trial(&config);
	struct vec3 *seed = allocate(trial.count, sizeof *seed), *automatic = allocate(trial.count, sizeof *automatic);
	FILE *file = open_csv(name, "t,al,as,at,seed_l,seed_s,seed_t,auto_l,auto_s,auto_t");

	method_run(METHOD_SEED, &trial, noise_deg * RAD_PER_DEG, seed);
	method_run(METHOD_AUTO, &trial, noise_deg * RAD_PER_DEG, automatic);
	for (int k = (int)(from_s * config.rate_hz); k < trial.count && k * trial.dt_s < to_s; k++) {
		struct csv_row row = {0};

		csv_number(&row, k * trial.dt_s, 3);
		csv_vec3(&row, trial.accel_b_m_s2[k], 4);
		csv_vec3(&row, seed[k], 4);
		csv_vec3(&row, automatic[k], 4);
		csv_write(&row, file);
	}
	close_csv(file);
	free(seed);
	free(automatic);
	trial_free(&trial);
}

static struct plot_panel estimate_panel(const char *csv, const char *title, bool seed)
{
	const char *extra = "set yrange [-9:9]";

	if (seed)
		return (struct plot_panel){title, "t [s]", "a [m/s^2]", extra,
			{{csv, "\"t\":\"seed_l\"", "â_l", LINE(BLUE)}, {csv, "\"t\":\"seed_s\"", "â_s", LINE(GREEN)},
				{csv, "\"t\":\"seed_t\"", "â_t", LINE(ORANGE)},
				{csv, "\"t\":\"al\"", "a (true)", LINE(BLACK)}, {csv, "\"t\":\"as\"", "", LINE(BLACK)},
				{csv, "\"t\":\"at\"", "", LINE(BLACK)}}};
	return (struct plot_panel){title, "t [s]", "a [m/s^2]", extra,
		{{csv, "\"t\":\"auto_l\"", "â_l", LINE(BLUE)}, {csv, "\"t\":\"auto_s\"", "â_s", LINE(GREEN)},
			{csv, "\"t\":\"auto_t\"", "â_t", LINE(ORANGE)}, {csv, "\"t\":\"al\"", "a (true)", LINE(BLACK)},
			{csv, "\"t\":\"as\"", "", LINE(BLACK)}, {csv, "\"t\":\"at\"", "", LINE(BLACK)}}};
}

static void estimate_figure(int number, const char *word, double noise_deg)
{
	char name[32], title[128], boat[32], square[32];

	snprintf(name, sizeof name, "fig%d_estimates_%s", number, word);
	snprintf(title, sizeof title, "Fig. %d. Linear acceleration estimation for two tests and %s noise (%g degrees)",
		number, word, noise_deg);
	snprintf(boat, sizeof boat, "fig%d_boat.csv", number);
	snprintf(square, sizeof square, "fig%d_square.csv", number);
	estimate_csv(boat, "boat", 4, 13, noise_deg);
	estimate_csv(square, "square", 0, 10, noise_deg);
	draw(&(struct plot_figure){name, title, 2, 2,
		{estimate_panel(boat, "(a) boat, (12)", true), estimate_panel(square, "(b) robot, (12)", true),
			estimate_panel(boat, "ours, boat: rates from the gyro, auto", false),
			estimate_panel(square, "ours, robot: rates from the gyro, auto", false)}});
}

/* ---- the table --------------------------------------------------------------------------------------------------- */

struct table {
	struct score score[WORLDS][TRIAL_SIGNALS][METHODS][NOISES];
};

static void make_table(struct table *table)
{
	FILE *file = open_csv("table.csv", "world,signal,method,angle_noise_deg,rms_m_s2,peak_m_s2");

	for (int world = 0; world < WORLDS; world++)
		for (int signal = 0; signal < TRIAL_SIGNALS; signal++) {
			const struct trial_config config =
				trial_defaults((enum world)world, TRIAL_SIGNAL_NAMES[signal]);
			struct trial trial = make_trial(&config);

			for (int method = 0; method < METHODS; method++)
				for (int noise = 0; noise < NOISES; noise++) {
					struct score s = run_and_score((enum method)method, &trial, NOISE_DEG[noise]);

					table->score[world][signal][method][noise] = s;
					fprintf(file, "%s,%s,%s,%.2f,%.5f,%.4f\n", WORLD_NAMES[world],
						TRIAL_SIGNAL_NAMES[signal], METHOD_NAMES[method], NOISE_DEG[noise],
						s.rms_m_s2, s.peak_m_s2);
				}
			trial_free(&trial);
		}
	close_csv(file);
	puts("  table.csv: error of each method at each angle noise");
}

static const char *const SIGNAL_TITLES[TRIAL_SIGNALS] = {"roll step", "boat", "square"};
static const char *const METHOD_TITLES[METHODS] = {
	"no correction", "(12)", "(12), low-pass", "(12), gyro", "rigid body, gyro", "auto"};
static const char *const METHOD_STYLES[METHODS] = {BOTH(BLACK), BOTH(ORANGE), BOTH("#e69f00"), BOTH(PURPLE), BOTH(BLUE),
	"linespoints dt 2 pt 6 ps 1 lw 2 lc rgb '" GREEN "'"};

static void table_figure(void)
{
	static char use[WORLDS][TRIAL_SIGNALS][METHODS][256], titles[WORLDS][TRIAL_SIGNALS][64];
	struct plot_figure figure = {"fig13_error_over_noise",
		"Error of the estimated acceleration over the noise of the given angles, r = (5, 5, 5) cm", 2, 3,
		{{0}}};

	for (int world = 0; world < WORLDS; world++)
		for (int signal = 0; signal < TRIAL_SIGNALS; signal++) {
			struct plot_panel *panel = &figure.panels[world * TRIAL_SIGNALS + signal];
			char *title = titles[world][signal];

			snprintf(title, sizeof titles[0][0], "%s, %s", SIGNAL_TITLES[signal],
				world == WORLD_SEED ? "the paper's world" : "physical world");
			*panel = (struct plot_panel){title, "Δφ, Δθ, Δψ: noise of the angles [deg]",
				"RMS of â - a [m/s^2]", "set logscale xy\nset xrange [0.015:3]", {{0}}};
			for (int method = 0; method < METHODS; method++) {
				char *u = use[world][signal][method];

				snprintf(u, sizeof use[0][0][0],
					"\"angle_noise_deg\":(strcol(\"world\") eq \"%s\" && strcol(\"signal\") eq "
					"\"%s\" && "
					"strcol(\"method\") eq \"%s\" ? column(\"rms_m_s2\") : NaN)",
					WORLD_NAMES[world], TRIAL_SIGNAL_NAMES[signal], METHOD_NAMES[method]);
				panel->series[method] = (struct plot_series){
					"table.csv", u, METHOD_TITLES[method], METHOD_STYLES[method]};
			}
		}
	draw(&figure);
}

/* ---- dependence on lever arm and rate ---------------------------------------------------------------------------- */

/* R^2 of the regression line through the origin. */
static double line_r2(const double *x, const double *y, int n)
{
	double xx = 0, xy = 0, residual = 0, total = 0, mean = 0;

	for (int i = 0; i < n; i++) {
		xx += x[i] * x[i];
		xy += x[i] * y[i];
		mean += y[i] / n;
	}
	for (int i = 0; i < n; i++) {
		residual += pow(y[i] - xy / xx * x[i], 2);
		total += pow(y[i] - mean, 2);
	}
	return 1 - residual / total;
}

struct peaks {
	double rate_rad_s, seed_m_s2, physical_m_s2;
};

/* Largest effect of a lever arm along s on the measured side component: by (9), and for a rigid body. */
static struct peaks lever_arm_peaks(double r_m, double angle_scale)
{
	struct trial_config config = trial_defaults(WORLD_SEED, "roll_step");
	struct signal step = *signal_find("roll_step");
	const struct vec3 r = {0, r_m, 0}, zero = {0, 0, 0};
	struct peaks peaks = {0, 0, 0};
	struct trial trial;

	config.angle_scale = angle_scale;
	trial = make_trial(&config);
	for (int k = 0; k < trial.count; k++)
		peaks.seed_m_s2 = fmax(peaks.seed_m_s2, fabs(seed_lever_arm(&trial.motion[k], r).y));
	trial_free(&trial);
	step.angle_rad *= angle_scale;
	for (double t = 0; t < 4; t += 1e-3) {
		struct signal_truth truth;
		struct vec3 effect;

		signal_at(&step, t, &truth);
		effect =
			vec3_sub(sensor_specific_force(&truth, r, G_M_S2), sensor_specific_force(&truth, zero, G_M_S2));
		peaks.physical_m_s2 = fmax(peaks.physical_m_s2, fabs(effect.y));
		peaks.rate_rad_s = fmax(peaks.rate_rad_s, fabs(truth.omega_b_rad_s.x));
	}
	return peaks;
}

enum { LEVER_ARMS = 20, AMPLITUDES = 12 };

struct dependence {
	double linear_r2[WORLDS], quadratic_r2[WORLDS], peak_5_cm_g[WORLDS];
};

static void dependence_figure(struct dependence *d)
{
	double x[LEVER_ARMS], seed[LEVER_ARMS], physical[LEVER_ARMS];
	FILE *file = open_csv("lever_arm.csv", "r_cm,seed_g,physical_g");

	for (int i = 0; i < LEVER_ARMS; i++) {
		struct peaks p = lever_arm_peaks(0.01 * (i + 1), 1);

		x[i] = i + 1;
		seed[i] = p.seed_m_s2 / G_M_S2;
		physical[i] = p.physical_m_s2 / G_M_S2;
		fprintf(file, "%d,%.6f,%.6f\n", i + 1, seed[i], physical[i]);
	}
	close_csv(file);
	d->linear_r2[WORLD_SEED] = line_r2(x, seed, LEVER_ARMS);
	d->linear_r2[WORLD_PHYSICAL] = line_r2(x, physical, LEVER_ARMS);
	d->peak_5_cm_g[WORLD_SEED] = seed[4];
	d->peak_5_cm_g[WORLD_PHYSICAL] = physical[4];

	file = open_csv("rate.csv", "rate_rad_s,rate2,seed_g,physical_g");
	for (int i = 0; i < AMPLITUDES; i++) {
		struct peaks p = lever_arm_peaks(0.05, 0.125 * (i + 1));

		x[i] = p.rate_rad_s * p.rate_rad_s;
		seed[i] = p.seed_m_s2 / G_M_S2;
		physical[i] = p.physical_m_s2 / G_M_S2;
		fprintf(file, "%.5f,%.5f,%.6f,%.6f\n", p.rate_rad_s, x[i], seed[i], physical[i]);
	}
	close_csv(file);
	d->quadratic_r2[WORLD_SEED] = line_r2(x, seed, AMPLITUDES);
	d->quadratic_r2[WORLD_PHYSICAL] = line_r2(x, physical, AMPLITUDES);

	draw(&(struct plot_figure){"fig14_lever_arm", "Peak of the correction in the roll step", 1, 2,
		{{"over the lever arm: linear", "r [cm]", "peak [g]", NULL,
			 {{"lever_arm.csv", "\"r_cm\":\"seed_g\"", "(9), discrete, 50 Hz", BOTH(ORANGE)},
				 {"lever_arm.csv", "\"r_cm\":\"physical_g\"", "rigid body", BOTH(BLUE)}}},
			{"over the rate at r = 5 cm: quadratic", "peak rate of the rigid body [rad/s]", "peak [g]",
				NULL,
				{{"rate.csv", "\"rate_rad_s\":\"seed_g\"", "(9), discrete, 50 Hz", BOTH(ORANGE)},
					{"rate.csv", "\"rate_rad_s\":\"physical_g\"", "rigid body", BOTH(BLUE)}}}}});
}

/* ---- auto over the noise of the gyro ----------------------------------------------------------------------------- */

struct ratio { /* error of auto / smaller one of the errors of none and rigid_gyro */
	double worst, best;
};

static void note(struct ratio *ratio, double automatic, double none, double rigid)
{
	double r = automatic / fmin(none, rigid);

	ratio->worst = fmax(ratio->worst, r);
	ratio->best = fmin(ratio->best, r);
}

static void auto_figure(struct ratio *ratio)
{
	static char use[TRIAL_SIGNALS][3][256];
	const enum method methods[3] = {METHOD_NONE, METHOD_RIGID_GYRO, METHOD_AUTO};
	struct plot_figure figure = {"fig15_auto",
		"auto: the correction weighted against its noise (physical world, angle noise of 0.05 degrees)", 1, 3,
		{{0}}};
	FILE *file = open_csv("auto.csv", "signal,gyro_density,none,rigid_gyro,auto");

	*ratio = (struct ratio){0, 1e9};
	for (int signal = 0; signal < TRIAL_SIGNALS; signal++) {
		figure.panels[signal] = (struct plot_panel){SIGNAL_TITLES[signal],
			"noise density of the gyro [deg/s/√Hz]", "RMS of â - a [m/s^2]", "set logscale xy", {{0}}};
		for (int m = 0; m < 3; m++) {
			snprintf(use[signal][m], sizeof use[0][0],
				"\"gyro_density\":(strcol(\"signal\") eq \"%s\" ? column(\"%s\") : NaN)",
				TRIAL_SIGNAL_NAMES[signal], METHOD_NAMES[methods[m]]);
			figure.panels[signal].series[m] = (struct plot_series){
				"auto.csv", use[signal][m], METHOD_TITLES[methods[m]], METHOD_STYLES[methods[m]]};
		}
		for (double decade = -1; decade < 2.3; decade += 0.2) {
			struct trial_config config = trial_defaults(WORLD_PHYSICAL, TRIAL_SIGNAL_NAMES[signal]);
			struct trial trial;
			double rms[3];

			config.gyro_noise_scale = pow(10, decade);
			trial = make_trial(&config);
			for (int m = 0; m < 3; m++)
				rms[m] = run_and_score(methods[m], &trial, 0.05).rms_m_s2;
			fprintf(file, "%s,%.5f,%.5f,%.5f,%.5f\n", TRIAL_SIGNAL_NAMES[signal],
				trial.sensor.gyro.density / RAD_PER_DEG, rms[0], rms[1], rms[2]);
			note(ratio, rms[2], rms[0], rms[1]);
			trial_free(&trial);
		}
	}
	close_csv(file);
	draw(&figure);
}

/* ---- what the paper leaves open: sampling rate and amplitude ----------------------------------------------------- */

enum { RATES = 5, SCALES = 4 };
static const double RATE_HZ[RATES] = {25, 50, 100, 200, 400}, ANGLE_SCALE[SCALES] = {0.25, 0.5, 1, 1.5};

static void sweep_one(FILE *file, const struct trial_config *config)
{
	const double noise_deg[] = {0.02, 0.05, 0.3, 2.0};
	struct trial trial = make_trial(config);

	for (int method = 0; method < METHODS; method++)
		for (int i = 0; i < 4; i++) {
			struct score s = run_and_score((enum method)method, &trial, noise_deg[i]);

			fprintf(file, "%s,%s,%g,%g,%s,%.2f,%.5f,%.4f\n", WORLD_NAMES[config->world], config->signal,
				config->rate_hz, config->angle_scale, METHOD_NAMES[method], noise_deg[i], s.rms_m_s2,
				s.peak_m_s2);
		}
	trial_free(&trial);
}

static void sweep(void)
{
	FILE *file =
		open_csv("sweep.csv", "world,signal,rate_hz,angle_scale,method,angle_noise_deg,rms_m_s2,peak_m_s2");

	for (int world = 0; world < WORLDS; world++)
		for (int signal = 0; signal < TRIAL_SIGNALS; signal++) {
			struct trial_config config = trial_defaults((enum world)world, TRIAL_SIGNAL_NAMES[signal]);
			const double rate_hz = config.rate_hz;

			for (int i = 0; i < RATES; i++) {
				config.rate_hz = RATE_HZ[i];
				sweep_one(file, &config);
			}
			config.rate_hz = rate_hz;
			for (int i = 0; i < SCALES; i++) {
				config.angle_scale = ANGLE_SCALE[i];
				if (config.angle_scale != 1)
					sweep_one(file, &config);
			}
		}
	close_csv(file);
	puts("  sweep.csv: the same over sampling rate and amplitude");
}

/* Angle noise at which (12) is as good as no correction, degrees. */
static double break_even_deg(const struct trial_config *config)
{
	struct trial trial = make_trial(config);
	double low = log(1e-4), high = log(10);

	for (int i = 0; i < 12; i++) {
		double middle = (low + high) / 2, noise_deg = exp(middle);

		if (run_and_score(METHOD_SEED, &trial, noise_deg).rms_m_s2 <
			run_and_score(METHOD_NONE, &trial, noise_deg).rms_m_s2)
			low = middle;
		else
			high = middle;
	}
	trial_free(&trial);
	return exp(low);
}

static double peak_g(double rate_hz, double angle_scale)
{
	struct trial_config config = trial_defaults(WORLD_SEED, "roll_step");
	const struct vec3 r = {0, 0.05, 0};
	struct trial trial;
	double peak = 0;

	config.rate_hz = rate_hz;
	config.angle_scale = angle_scale;
	trial = make_trial(&config);
	for (int k = 0; k < trial.count; k++)
		peak = fmax(peak, seed_lever_arm(&trial.motion[k], r).y / G_M_S2);
	trial_free(&trial);
	return peak;
}

static void open_choices_figure(void)
{
	FILE *file = open_csv("step_height.csv", "step_deg,hz25,hz50,hz100,hz200");

	for (double step_deg = 2; step_deg <= 60; step_deg += 2) {
		fprintf(file, "%g", step_deg);
		for (int i = 0; i < 4; i++)
			fprintf(file, ",%.5f", peak_g(RATE_HZ[i], step_deg / 24));
		fputc('\n', file);
	}
	close_csv(file);
	file = open_csv("break_even.csv", "rate_hz,roll_step,boat,square");
	for (int i = 0; i < RATES; i++) {
		fprintf(file, "%g", RATE_HZ[i]);
		for (int signal = 0; signal < TRIAL_SIGNALS; signal++) {
			struct trial_config config = trial_defaults(WORLD_SEED, TRIAL_SIGNAL_NAMES[signal]);

			config.rate_hz = RATE_HZ[i];
			fprintf(file, ",%.4f", break_even_deg(&config));
		}
		fputc('\n', file);
	}
	close_csv(file);
	draw(&(struct plot_figure){"fig16_open_choices",
		"The results of the paper depend on what it leaves open (its world)", 1, 2,
		{{"peak of φ̇^2 r_s at r_s = 5 cm", "height of the roll step [deg]", "peak [g]", "set yrange [0:4]",
			 {{"step_height.csv", "\"step_deg\":\"hz25\"", "25 Hz", LINE(GREY)},
				 {"step_height.csv", "\"step_deg\":\"hz50\"", "50 Hz (chosen)", LINE(ORANGE)},
				 {"step_height.csv", "\"step_deg\":\"hz100\"", "100 Hz", LINE(BLUE)},
				 {"step_height.csv", "\"step_deg\":\"hz200\"", "200 Hz", LINE(GREEN)},
				 {"step_height.csv", "\"step_deg\":(0.5)", "the paper: 0.5 g ..",
					 "lines dt 2 lc rgb '" BLACK "'"},
				 {"step_height.csv", "\"step_deg\":(0.8)", ".. to 0.8 g",
					 "lines dt 3 lc rgb '" BLACK "'"}}},
			{"angle noise at which (12) equals no correction", "sampling rate [Hz]", "angle noise [deg]",
				"set key maxcols 2\nset logscale xy\nset xtics (25, 50, 100, 200, 400)",
				{{"break_even.csv", "\"rate_hz\":\"roll_step\"", "roll step", BOTH(BLUE)},
					{"break_even.csv", "\"rate_hz\":\"boat\"", "boat", BOTH(GREEN)},
					{"break_even.csv", "\"rate_hz\":\"square\"", "square", BOTH(ORANGE)},
					{"break_even.csv", "\"rate_hz\":(0.05)", "the paper: 0.05",
						"lines dt 2 lc rgb '" BLACK "'"},
					{"break_even.csv", "\"rate_hz\":(0.3)", "the paper: 0.3",
						"lines dt 3 lc rgb '" BLACK "'"}}}}});
}

/* ---- the claims ---------------------------------------------------------------------------------------------- */

/* What the claims that do not hold mean, for the end of the table. */
static struct {
	char text[512];
} refuted[32];
static int refuted_count;

/* `if_not`: the sentence for a claim that does not hold. */
static void claim(FILE *file, const char *text, double measured, bool holds, const char *if_not)
{
	fprintf(file, "\"%s\",%.6g,%s\n", text, measured, holds ? "yes" : "no");
	printf("  %-92s %10.5g  %s\n", text, measured, holds ? "yes" : "NO");
	if (!holds)
		snprintf(refuted[refuted_count++].text, sizeof refuted[0].text, "%s\n      %s", text, if_not);
}

static void explain_claims(void)
{
	if (refuted_count == 0)
		return;
	puts("\nWhat a NO means: the sentence does not hold for this signal, in this world. For a sentence of the\n"
	     "paper that is a result; for one about our methods it would be a fault, and a unit test fails.");
	for (int i = 0; i < refuted_count; i++)
		printf("  NO  %s\n", refuted[i].text);
}

/* Ratio of the errors of two methods, each at its noise. */
static double compare(
	const struct table *table, int world, int signal, enum method a, int noise_a, enum method b, int noise_b)
{
	return table->score[world][signal][a][noise_a].rms_m_s2 / table->score[world][signal][b][noise_b].rms_m_s2;
}

static void table_claims(FILE *file, const struct table *table)
{
	char text[160];

	for (int signal = 0; signal < TRIAL_SIGNALS; signal++) {
		const char *name = TRIAL_SIGNAL_NAMES[signal];
		double r = compare(table, WORLD_SEED, signal, METHOD_SEED, 1, METHOD_NONE, 1);

		snprintf(text, sizeof text, "paper, %s: 0.05 degrees suffice (ratio of errors to none)", name);
		claim(file, text, r, r < 1,
			"With angles this accurate the estimate by (12) is worse than one without correction: the "
			"rotations of "
			"this\n      signal are so slow that the noise of the correction exceeds the correction "
			"itself.");
		r = compare(table, WORLD_SEED, signal, METHOD_SEED, 5, METHOD_NONE, 5);
		snprintf(
			text, sizeof text, "paper, %s: above 0.3 degrees useless (0.7; ratio of errors to none)", name);
		claim(file, text, r, r > 1,
			"The correction still helps at 0.7 degrees: the rotations of this signal are so quick that "
			"they exceed "
			"its noise.");
		r = compare(table, WORLD_SEED, signal, METHOD_SEED_GYRO, NOISES - 1, METHOD_SEED, 0);
		snprintf(text, sizeof text,
			"world of the paper, %s: seed_gyro at 2.0 beats seed at 0.02 degrees (ratio)", name);
		claim(file, text, r, r < 1,
			"A gyro with bad angles is no better here than good angles without a gyro.");
		r = compare(table, WORLD_PHYSICAL, signal, METHOD_RIGID_GYRO, NOISES - 1, METHOD_SEED, 0);
		snprintf(text, sizeof text, "physical world, %s: rigid_gyro at 2.0 beats seed at 0.02 degrees (ratio)",
			name);
		claim(file, text, r, r < 1,
			"A gyro with bad angles is no better here than good angles without a gyro.");
	}
}

static void claims(const struct table *table, const struct dependence *d, const struct ratio *swept)
{
	FILE *file = open_csv("claims.csv", "claim,measured,holds");
	struct ratio ratio = {0, 1e9};

	for (int world = 0; world < WORLDS; world++)
		for (int signal = 0; signal < TRIAL_SIGNALS; signal++)
			for (int noise = 0; noise < NOISES; noise++) {
				const struct score(*s)[NOISES] = table->score[world][signal];

				note(&ratio, s[METHOD_AUTO][noise].rms_m_s2, s[METHOD_NONE][noise].rms_m_s2,
					s[METHOD_RIGID_GYRO][noise].rms_m_s2);
			}
	printf("\nClaims (claims.csv):\n");
	claim(file, "paper: correction above 0.5 g at r = 5 cm [g]", d->peak_5_cm_g[WORLD_SEED],
		d->peak_5_cm_g[WORLD_SEED] > 0.5, "The correction term of this roll step stays below half of g.");
	claim(file, "the same for a rigid body [g]", d->peak_5_cm_g[WORLD_PHYSICAL],
		d->peak_5_cm_g[WORLD_PHYSICAL] > 0.5,
		"The centripetal acceleration of this rotation stays below half of g.");
	claim(file, "paper: the peak grows linearly with r (R^2)", d->linear_r2[WORLD_SEED],
		d->linear_r2[WORLD_SEED] > 0.999, "The peaks are not proportional to r.");
	claim(file, "the same for a rigid body (R^2)", d->linear_r2[WORLD_PHYSICAL],
		d->linear_r2[WORLD_PHYSICAL] > 0.999, "The peaks are not proportional to r.");
	claim(file, "the peak grows with the square of the rate (R^2)", d->quadratic_r2[WORLD_SEED],
		d->quadratic_r2[WORLD_SEED] > 0.999, "The peaks are not proportional to the square of the rate.");
	claim(file, "the same for a rigid body (R^2)", d->quadratic_r2[WORLD_PHYSICAL],
		d->quadratic_r2[WORLD_PHYSICAL] > 0.999, "The peaks are not proportional to the square of the rate.");
	table_claims(file, table);
	claim(file, "auto is at most 5 % worse than the better of none and rigid_gyro (table, worst ratio)",
		ratio.worst, ratio.worst <= 1.05,
		"The weight of auto is wrong somewhere: a method that it chooses from is clearly better.");
	claim(file, "likewise over the noise of the gyro (worst ratio)", swept->worst, swept->worst <= 1.05,
		"The weight of auto is wrong somewhere: a method that it chooses from is clearly better.");
	claim(file, "auto is better than both where they are equal (best ratio)", swept->best, swept->best < 0.95,
		"Weighting gains nothing over choosing one of the two.");
	close_csv(file);
	explain_claims();
}

/* mkdir -p */
static int make_directory(const char *path)
{
	char part[PATH_SIZE];

	for (size_t i = 1; i <= strlen(path); i++) {
		if (path[i] != '/' && path[i] != '\0')
			continue;
		snprintf(part, sizeof part, "%.*s", (int)i, path);
		if (mkdir(part, 0777) < 0 && errno != EEXIST) {
			cli_error("%s: %s", part, strerror(errno));
			return -1;
		}
	}
	return 0;
}

int experiments(const char *into)
{
	static struct table table;
	struct dependence dependence;
	struct ratio swept;

	directory = into;
	if (make_directory(directory) < 0)
		return CLI_FAILED;
	printf("Writing to %s:\n", directory);
	make_table(&table);
	roll_step_figures();
	input_figure("boat", 20, "fig08.csv", "fig08_boat",
		"Fig. 8. Simulated input signals of the boat's movement (50 Hz)");
	input_figure("square", 40, "fig09.csv", "fig09_robot",
		"Fig. 9. Simulated input signals of the manoeuvring robot (50 Hz)");
	estimate_figure(10, "low", 0.02);
	estimate_figure(11, "medium", 0.1);
	estimate_figure(12, "high", 0.3);
	table_figure();
	dependence_figure(&dependence);
	auto_figure(&swept);
	open_choices_figure();
	sweep();
	claims(&table, &dependence, &swept);
	return CLI_OK;
}
