#define NCURSES_WIDECHAR 1 /* cells are wide characters */
#include "tools/monitor/terminal.h"

#include <curses.h>
#include <langinfo.h>
#include <locale.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static SCREEN *terminal;

bool terminal_has_unicode(void)
{
	setlocale(LC_CTYPE, "");
	return strcmp(nl_langinfo(CODESET), "UTF-8") == 0;
}

bool terminal_open(void)
{
	terminal = newterm(NULL, stdout, stdin);
	if (!terminal)
		return false;
	cbreak();
	noecho();
	curs_set(0);
	nodelay(stdscr, true);
	keypad(stdscr, true);
	if (has_colors() && start_color() == OK && use_default_colors() == OK)
		init_pair(1, COLOR_RED, -1);
	return true;
}

void terminal_close(void)
{
	endwin();
	delscreen(terminal);
}

void terminal_size(struct screen_cells *cells)
{
	getmaxyx(stdscr, cells->rows, cells->columns);
	if (cells->rows > SCREEN_ROWS)
		cells->rows = SCREEN_ROWS;
	if (cells->columns > SCREEN_COLUMNS)
		cells->columns = SCREEN_COLUMNS;
}

static attr_t attribute(uint8_t style)
{
	switch ((enum screen_style)style) {
	case SCREEN_TITLE:
		return A_REVERSE;
	case SCREEN_BOLD:
		return A_BOLD;
	case SCREEN_GREY:
		return A_DIM;
	case SCREEN_ALARM:
		return A_REVERSE | A_BOLD;
	case SCREEN_PLAIN:
		break;
	}
	return A_NORMAL;
}

void terminal_show(const struct screen_cells *cells)
{
	for (int row = 0; row < cells->rows; row++)
		for (int column = 0; column < cells->columns; column++) {
			const struct screen_cell *cell = &cells->cell[row][column];
			const wchar_t text[2] = {(wchar_t)(cell->glyph ? cell->glyph : ' '), L'\0'};
			cchar_t c;

			setcchar(&c, text, attribute(cell->style), cell->style == SCREEN_ALARM ? 1 : 0, NULL);
			mvadd_wch(row, column, &c);
		}
	refresh();
}

int terminal_key(void)
{
	int key = getch();

	if (key == KEY_NPAGE)
		return ' ';
	if (key == KEY_PPAGE)
		return 'b';
	return key > 0 && key < 0x7F ? key : 0;
}
