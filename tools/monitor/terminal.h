/* tools/monitor/terminal.h
 * Shows the cells of screen.h in the terminal and reads keys, by ncurses. */
#ifndef TOOLS_MONITOR_TERMINAL_H
#define TOOLS_MONITOR_TERMINAL_H

#include "tools/monitor/screen.h"

/** Whether the terminal has Unicode; may be called without terminal_open(). */
bool terminal_has_unicode(void);
/** False: there is no terminal that ncurses knows. */
bool terminal_open(void);
void terminal_close(void);
/** The size at this moment, into cells->rows and columns. */
void terminal_size(struct screen_cells *cells);
void terminal_show(const struct screen_cells *cells);
/** A character, or 0: no key was pressed. */
int terminal_key(void);

#endif
