#include "tools/lib/csv.h"

#include <math.h>

enum { FIELD_MAX = 32 };

static void put_digits(struct csv_row *row, uint64_t value, int at_least)
{
	char digits[20];
	int n = 0;

	for (; value > 0 || n < at_least; value /= 10)
		digits[n++] = (char)('0' + value % 10);
	while (n > 0)
		row->text[row->length++] = digits[--n];
}

static int next_field(struct csv_row *row)
{
	if (row->length > CSV_ROW_MAX - FIELD_MAX)
		return 0;
	if (row->length > 0)
		row->text[row->length++] = ',';
	return 1;
}

void csv_time(struct csv_row *row, int64_t t_us)
{
	uint64_t us = t_us < 0 ? 0 - (uint64_t)t_us : (uint64_t)t_us;

	if (!next_field(row))
		return;
	if (t_us < 0)
		row->text[row->length++] = '-';
	put_digits(row, us / 1000000, 1);
	row->text[row->length++] = '.';
	put_digits(row, us % 1000000, 6);
}

void csv_number(struct csv_row *row, double value, int decimals)
{
	static const uint64_t UNITS[] = {1, 10, 100, 1000, 10000, 100000, 1000000, 10000000, 100000000, 1000000000};
	const uint64_t unit = UNITS[decimals];
	uint64_t fixed;

	if (!next_field(row))
		return;
	if (!(fabs(value) < 1e9)) {
		row->length += (size_t)snprintf(row->text + row->length, FIELD_MAX, "%.9g", value);
		return;
	}
	fixed = (uint64_t)(fabs(value) * (double)unit + 0.5);
	if (value < 0 && fixed > 0)
		row->text[row->length++] = '-';
	put_digits(row, fixed / unit, 1);
	if (decimals == 0)
		return;
	row->text[row->length++] = '.';
	put_digits(row, fixed % unit, decimals);
}

void csv_vec3(struct csv_row *row, struct vec3 v, int decimals)
{
	csv_number(row, v.x, decimals);
	csv_number(row, v.y, decimals);
	csv_number(row, v.z, decimals);
}

void csv_empty(struct csv_row *row, int fields)
{
	for (int i = 0; i < fields; i++)
		next_field(row);
}

void csv_write(struct csv_row *row, FILE *file)
{
	row->text[row->length++] = '\n';
	fwrite(row->text, 1, row->length, file);
	row->length = 0;
}
