#include "tools/lib/plot.h"

#include <errno.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tools/lib/cli.h"

extern char **environ;

enum { PANEL_WIDTH = 640, PANEL_HEIGHT = 440, TITLE_HEIGHT = 70 };

static void write_panel(FILE *file, const struct plot_panel *panel)
{
	fprintf(file, "\nset title \"%s\"\nset xlabel \"%s\"\nset ylabel \"%s\"\n", panel->title, panel->xlabel,
		panel->ylabel);
	if (panel->extra)
		fprintf(file, "%s\n", panel->extra);
	for (int i = 0; i < PLOT_SERIES_MAX && panel->series[i].csv; i++) {
		const struct plot_series *s = &panel->series[i];

		fprintf(file, "%s \"%s\" using %s title \"%s\" with %s", i ? ", \\\n\t" : "plot", s->csv, s->use,
			s->title, s->style);
	}
	fputs("\nunset logscale\nset autoscale\nset xtics autofreq\nset size noratio\nset key maxcols auto\n", file);
}

static int write_script(const char *path, const struct plot_figure *figure)
{
	FILE *file = fopen(path, "we");

	if (!file) {
		cli_error("%s: %s", path, strerror(errno));
		return -1;
	}
	fprintf(file, "# gnuplot -c %s.gp png|svg, in this directory\n", figure->name);
	fprintf(file,
		"if (ARG1 eq \"svg\") set terminal svg size %d,%d dynamic background rgb 'white'; \\\n"
		"else set terminal pngcairo size %d,%d\n",
		figure->columns * PANEL_WIDTH, figure->rows * PANEL_HEIGHT + TITLE_HEIGHT,
		figure->columns * PANEL_WIDTH, figure->rows * PANEL_HEIGHT + TITLE_HEIGHT);
	fprintf(file, "set output \"%s.\".ARG1\n", figure->name);
	/* the legend is above the title of its panel, where neither an axis title nor a curve is */
	fputs("set encoding utf8\nset datafile separator \",\"\nset datafile columnheaders\nset grid\n"
	      "set key above horizontal center samplen 2\n",
		file);
	fprintf(file, "set multiplot layout %d,%d title \"%s\\n\" font \",14\"\n", figure->rows, figure->columns,
		figure->title);
	for (int i = 0; i < figure->rows * figure->columns; i++)
		write_panel(file, &figure->panels[i]);
	fputs("unset multiplot\n", file);
	if (fclose(file) != 0) {
		cli_error("%s: %s", path, strerror(errno));
		return -1;
	}
	return 0;
}

static int run_gnuplot(const char *directory, const char *script, const char *format)
{
	char *const argv[] = {"gnuplot", "-c", (char *)script, (char *)format, NULL};
	posix_spawn_file_actions_t actions;
	int status = -1, error;
	pid_t pid;

	setenv("LC_ALL", "C.UTF-8", 1); /* that of the script */
	posix_spawn_file_actions_init(&actions);
	posix_spawn_file_actions_addchdir_np(&actions, directory);
	error = posix_spawnp(&pid, argv[0], &actions, NULL, argv, environ);
	posix_spawn_file_actions_destroy(&actions);
	if (error == 0 && waitpid(pid, &status, 0) == pid && WIFEXITED(status) && WEXITSTATUS(status) == 0)
		return 0;
	cli_error("gnuplot could not draw %s/%s (%s): is gnuplot installed (apt install gnuplot-nox)?", directory,
		script, error ? strerror(error) : "see above");
	return -1;
}

int plot_figure(const char *directory, const struct plot_figure *figure)
{
	char path[4096], script[256];

	snprintf(script, sizeof script, "%s.gp", figure->name);
	snprintf(path, sizeof path, "%s/%s", directory, script);
	if (write_script(path, figure) < 0)
		return -1;
	if (run_gnuplot(directory, script, "png") < 0)
		return -1;
	return run_gnuplot(directory, script, "svg");
}
