/* tools/lib/plot.h
 * Figures drawn by gnuplot: a script, a PNG and an SVG, in the directory of the CSV files they show. */
#ifndef TOOLS_LIB_PLOT_H
#define TOOLS_LIB_PLOT_H

enum { PLOT_SERIES_MAX = 8, PLOT_PANELS_MAX = 6 };

struct plot_series {	   /* ends with a NULL csv */
	const char *csv;   /* file name, in the figure's directory; its first line names the columns */
	const char *use;   /* gnuplot's `using`: "\"t\":\"phi\"" */
	const char *title; /* in the legend */
	const char *style; /* gnuplot's `with`: "lines" */
};

struct plot_panel {
	const char *title, *xlabel, *ylabel;
	const char *extra; /* gnuplot commands before the panel, or NULL */
	struct plot_series series[PLOT_SERIES_MAX];
};

struct plot_figure {
	const char *name, *title;
	int rows, columns;
	struct plot_panel panels[PLOT_PANELS_MAX];
};

/** Writes DIR/NAME.gp, .png and .svg. 0, or -1 after a message on stderr. */
int plot_figure(const char *directory, const struct plot_figure *figure);

#endif
