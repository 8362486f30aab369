/* tools/monitor/screen.h
 * The layout of imu9-monitor: a pure function from what is known of the node to a grid of characters, whatever shows it
 * (terminal.c: ncurses; --once: text). Three lines of header stay visible; below them blocks (PDOs, attitude, EMCY,
 * event log) flow through as many columns as fit, and over pages. */
#ifndef TOOLS_MONITOR_SCREEN_H
#define TOOLS_MONITOR_SCREEN_H

#include "tools/lib/watch.h"

enum {
	SCREEN_ROWS = 400,
	SCREEN_COLUMNS = 320,
	HISTORY_LENGTH = 64,
};

enum screen_style { SCREEN_PLAIN, SCREEN_TITLE, SCREEN_BOLD, SCREEN_GREY, SCREEN_ALARM };

struct screen_cell {
	uint32_t glyph; /* Unicode; 0: blank */
	uint8_t style;
};

struct screen_cells {
	int rows, columns; /* set by the caller, at most the maxima above */
	unsigned int pages;
	struct screen_cell cell[SCREEN_ROWS][SCREEN_COLUMNS];
};

/** The values of the last updates, for sparklines. Zeroed: empty. */
struct history {
	size_t count;
	float values[WATCH_PDOS][WATCH_FIELDS][HISTORY_LENGTH]; /* a ring; NAN: none */
};

struct screen {
	const struct watch *watch;
	const struct history *history;
	const char *bus_name;
	long node_id;
	const char *hint; /* why there are no values, or "" */
	uint64_t now_us;
	unsigned int page; /* from 0; taken modulo the pages */
	bool keys;	   /* they work: name them */
	bool help, events; /* show the keys; show the event log */
	bool ascii;	   /* the terminal has no Unicode */
};

void screen_draw(const struct screen *screen, struct screen_cells *cells);
/** A row as UTF-8, without blanks at its end. */
void screen_row_text(const struct screen_cells *cells, int row, char *text, size_t capacity);

/** Adds the present value of each field. */
void history_add(struct history *history, const struct watch *watch);

/** "99.9 Hz", or "" while it is not measured. */
void screen_rate_text(const struct watch_rate *rate, uint64_t now_us, char *text, size_t capacity);

#endif
