/* tools/lib/csv.h
 * Rows of numbers as text with fixed-point digits, without printf(): fast enough for logs of millions of rows. */
#ifndef TOOLS_LIB_CSV_H
#define TOOLS_LIB_CSV_H

#include <stdint.h>
#include <stdio.h>

#include "model/math/quat.h"

enum { CSV_ROW_MAX = 1024 };

struct csv_row { /* all 0: an empty row */
	size_t length;
	char text[CSV_ROW_MAX];
};

/** Microseconds as seconds with six decimals. */
void csv_time(struct csv_row *row, int64_t t_us);
/** `decimals`: at most nine. A value of 1e9 or more, or not finite, is written in the format %.9g. */
void csv_number(struct csv_row *row, double value, int decimals);
void csv_vec3(struct csv_row *row, struct vec3 v, int decimals);
void csv_empty(struct csv_row *row, int fields);
/** Ends the row, writes it and empties it for the next one. */
void csv_write(struct csv_row *row, FILE *file);

#endif
