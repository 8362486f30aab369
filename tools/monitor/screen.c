#include "tools/monitor/screen.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "gateway/canopen/canopen.h"
#include "model/math/units.h"
#include "od_index.h"

enum {
	HEADER_ROWS = 3,
	COLUMN_MIN = 66, /* of a column when there are several */
	COLUMN_MAX = 100,
	LINE_CELLS = SCREEN_COLUMNS,
	BODY_LINES = 320,
	NAME_WIDTH = 20,
	VALUE_WIDTH = 11,
	SIGMA_WIDTH = 11,
	HORIZON_ROWS = 7,
	HORIZON_COLUMNS = 25,
};

/* The body before it is distributed over columns and pages. A block is kept together if it fits. */
struct body {
	struct line {
		bool first; /* of a block */
		struct screen_cell cell[LINE_CELLS];
	} line[BODY_LINES];
	int count, width;
};

static double seconds_since(uint64_t then_us, uint64_t now_us)
{
	return now_us > then_us ? (double)(now_us - then_us) * 1e-6 : 0;
}

/* ---- text into cells ---- */

/* Writes UTF-8 text; what does not fit is cut. Returns the column after it. */
static int put(struct screen_cell *cells, int column, int end, enum screen_style style, const char *text)
{
	for (const unsigned char *c = (const unsigned char *)text; *c && column < end; column++) {
		uint32_t glyph = *c++;
		int more = glyph >= 0xF0 ? 3 : glyph >= 0xE0 ? 2 : glyph >= 0xC0 ? 1 : 0;

		if (more)
			glyph &= 0x3Fu >> more;
		for (; more > 0 && *c; more--)
			glyph = glyph << 6 | (*c++ & 0x3F);
		cells[column] = (struct screen_cell){glyph, (uint8_t)style};
	}
	return column;
}

__attribute__((format(printf, 5, 6))) static int print(
	struct screen_cell *cells, int column, int end, enum screen_style style, const char *format, ...)
{
	char text[4 * LINE_CELLS];
	va_list args;

	va_start(args, format);
	vsnprintf(text, sizeof(text), format, args);
	va_end(args);
	return put(cells, column, end, style, text);
}

/* A number of a line that may be left out, but not cut. */
static int print_count(struct screen_cell *cells, int column, int end, enum screen_style style, const char *separator,
	uint64_t count, const char *what)
{
	char text[64];

	snprintf(text, sizeof(text), "%s%llu%s", separator, (unsigned long long)count, what);
	return column + (int)strlen(text) <= end ? put(cells, column, end, style, text) : column;
}

void screen_row_text(const struct screen_cells *cells, int row, char *text, size_t capacity)
{
	size_t used = 0, kept = 0;

	for (int i = 0; i < cells->columns && used + 5 < capacity; i++) {
		uint32_t g = cells->cell[row][i].glyph ? cells->cell[row][i].glyph : ' ';

		if (g >= 0x800) {
			text[used++] = (char)(0xE0 | g >> 12);
			text[used++] = (char)(0x80 | (g >> 6 & 0x3F));
			text[used++] = (char)(0x80 | (g & 0x3F));
		} else if (g >= 0x80) {
			text[used++] = (char)(0xC0 | g >> 6);
			text[used++] = (char)(0x80 | (g & 0x3F));
		} else {
			text[used++] = (char)g;
		}
		if (g != ' ')
			kept = used;
	}
	text[kept] = '\0';
}

/* ---- the header ---- */

void screen_rate_text(const struct watch_rate *rate, uint64_t now_us, char *text, size_t capacity)
{
	double hz = watch_rate_hz(rate, now_us);

	text[0] = '\0';
	if (hz > 0)
		snprintf(text, capacity, "%.1f Hz", hz);
}

static void draw_title(const struct screen *s, struct screen_cells *cells)
{
	const struct watch *w = s->watch;
	struct screen_cell *row = cells->cell[0];
	int state = watch_nmt_state(w, s->now_us), end = cells->columns;
	enum screen_style style = state == WATCH_NMT_LOST ? SCREEN_ALARM : SCREEN_TITLE;
	char right[64] = "";

	for (int i = 0; s->keys && i < end; i++)
		row[i] = (struct screen_cell){' ', (uint8_t)style};
	if (s->keys)
		snprintf(right, sizeof(right), cells->pages > 1 ? "  page %u/%u  ? keys " : "  ? keys ",
			s->page % cells->pages + 1, cells->pages);
	int room = end - (int)strlen(right) > 0 ? end - (int)strlen(right) : 0;
	int at = print(row, 0, room, style, "node %ld: %s", s->node_id, watch_nmt_text(state));
	if (state == WATCH_NMT_LOST)
		at = print(row, at, room, style, " for %.1f s", seconds_since(w->heard_us, s->now_us));
	else if (w->heartbeat.count)
		at = print(
			row, at, room, style, ", heartbeat %.1f s ago", seconds_since(w->heartbeat.last_us, s->now_us));
	if (w->boot_ups)
		at = print(row, at, room, style, ", %llu boot-up%s", (unsigned long long)w->boot_ups,
			w->boot_ups > 1 ? "s" : "");
	print(row, at, room, style, ", on %s", s->bus_name); /* the name can be long: what matters is before it */
	put(row, room, end, style, right);
}

static void draw_bus(const struct screen *s, struct screen_cells *cells)
{
	static const char *const mappings[] = {
		[WATCH_READING] = "being read from the node",
		[WATCH_READ] = "read from the node",
		[WATCH_DEFAULTS] = "default of the EDS",
	};
	const struct watch *w = s->watch;
	struct screen_cell *row = cells->cell[1];
	double load = watch_polled(w, OD_INDEX_BUS_HEALTH, OD_SUB_BUS_HEALTH_LOAD);
	double bit_rate = watch_polled(w, OD_INDEX_BUS_HEALTH, OD_SUB_BUS_HEALTH_BIT_RATE);
	char rate[32];

	screen_rate_text(&w->sync, s->now_us, rate, sizeof(rate));
	int at = print(row, 0, cells->columns, SCREEN_PLAIN, "SYNC %s",
		rate[0]		? rate
		: w->sync.count ? "once"
				: "none");
	if (w->bus_hz > 0)
		at = print(row, at, cells->columns, SCREEN_PLAIN, "; bus %.0f frames/s", w->bus_hz);
	if (bit_rate > 0 && load >= 0)
		at = print(row, at, cells->columns, SCREEN_PLAIN, ", %.1f %% of %.0f kbit/s", load, bit_rate / 1000);
	print(row, at, cells->columns, SCREEN_PLAIN, "; PDO mapping: %s", mappings[w->mapping]);
}

static int print_emcy(
	const struct screen *s, const struct watch_emcy *emcy, struct screen_cell *cells, int at, int end, bool active)
{
	return print(cells, at, end, active ? SCREEN_ALARM : SCREEN_PLAIN,
		"EMCY %04Xh: %s, error register %02Xh, %.1f s ago", emcy->code, emcy_code_text(emcy->code),
		emcy->error_register, seconds_since(emcy->at_us, s->now_us));
}

static void draw_header(const struct screen *s, struct screen_cells *cells)
{
	const struct watch *w = s->watch;
	struct screen_cell *row = cells->cell[2];
	int end = cells->columns;

	draw_title(s, cells);
	draw_bus(s, cells);
	if (w->message[0] && end > (int)strlen(w->message) + 2)
		end -= (int)strlen(w->message) + 2;
	if (w->emcy.count)
		print_emcy(s, &w->emcys[0], row, 0, end, w->emcys[0].code != 0);
	else
		put(row, 0, end, SCREEN_PLAIN, "EMCY none");
	if (w->message[0])
		put(row, end + 2, cells->columns, SCREEN_BOLD, w->message);
}

/* ---- blocks ---- */

static struct screen_cell *new_line(struct body *body, bool first)
{
	struct line *line = &body->line[body->count < BODY_LINES ? body->count++ : BODY_LINES - 1];

	memset(line, 0, sizeof(*line));
	line->first = first;
	return line->cell;
}

static bool is_counter(const struct watch_field *field)
{
	return field->entry && field->entry->index == OD_INDEX_SAMPLE && field->entry->sub == OD_SUB_SAMPLE_COUNTER;
}

/* The latest `width` values between their least and their greatest. */
static void draw_spark(const struct screen *s, const float *values, struct screen_cell *cells, int at, int end)
{
	static const char ASCII[] = "_.,-~=^\"";
	size_t width = end > at ? (size_t)(end - at) : 0, length = s->history->count;
	float low = INFINITY, high = -INFINITY;

	if (length > HISTORY_LENGTH)
		length = HISTORY_LENGTH;
	if (length > width)
		length = width;
	for (size_t i = 0; i < length; i++) {
		float v = values[(s->history->count - length + i) % HISTORY_LENGTH];

		low = fminf(low, v);
		high = fmaxf(high, v);
	}
	for (size_t i = 0; i < length; i++, at++) {
		float v = values[(s->history->count - length + i) % HISTORY_LENGTH];
		int level = high > low ? (int)((v - low) / (high - low) * 7.99f) : 3;

		if (!isnan(v) && level >= 0 && level <= 7)
			cells[at].glyph = s->ascii ? (uint32_t)ASCII[level] : 0x2581u + (uint32_t)level;
	}
}

static void add_words(struct body *body, struct screen_cell *line, int at, const char *words, enum screen_style style)
{
	int begin = at;

	while (*words) {
		size_t length = strcspn(words, ",") + (words[strcspn(words, ",")] == ',');

		if (at + (int)length > body->width && at > begin) {
			line = new_line(body, false);
			at = begin;
		}
		at = print(line, at, body->width, style, "%.*s", (int)length, words);
		words += length;
	}
}

/* A name that is too long is cut before its member. */
static void print_name(struct screen_cell *line, enum screen_style style, const char *name)
{
	const int record = (int)strcspn(name, "."), member = (int)strlen(name + record);

	print(line, 2, 2 + NAME_WIDTH, style, "%.*s%s", record < NAME_WIDTH - member ? record : NAME_WIDTH - member,
		name, name + record);
}

static void add_field(
	const struct screen *s, struct body *body, size_t pdo, size_t field_number, enum screen_style style)
{
	const struct watch_field *field = &s->watch->pdos[pdo].fields[field_number];
	struct screen_cell *line = new_line(body, false);
	double sigma = field->entry ? watch_sigma(s->watch, field->entry) : NAN;
	char value[256];
	int at;

	if (field->entry)
		print_name(line, style, field->entry->name);
	else
		print(line, 2, 2 + NAME_WIDTH, style, "%04Xh:%02X", field->mapping >> 16, field->mapping >> 8 & 0xFF);
	watch_field_text(field, value, sizeof(value));
	at = 2 + NAME_WIDTH;
	if (od_has_words(field->entry)) {
		add_words(body, line, at + 1, value, style);
		return;
	}
	at = print(line, at, body->width, style == SCREEN_PLAIN ? SCREEN_BOLD : style, "%*s", VALUE_WIDTH, value);
	if (!isnan(sigma))
		print(line, at, at + SIGMA_WIDTH, style, s->ascii ? " +-%.3g" : " \u00B1%.3g", sigma);
	at += SIGMA_WIDTH;
	print(line, at, at + 8, style, " %s", field->entry ? field->entry->unit : "");
	at = 2 + NAME_WIDTH + VALUE_WIDTH + SIGMA_WIDTH + 8;
	if (s->history && style == SCREEN_PLAIN)
		draw_spark(s, s->history->values[pdo][field_number], line, at + 1, body->width - 2);
}

static void add_pdo(const struct screen *s, struct body *body, size_t number)
{
	const struct watch_pdo *pdo = &s->watch->pdos[number];
	double age_s = seconds_since(pdo->rate.last_us, s->now_us);
	bool silent = pdo->rate.count == 0 || age_s > 1;
	enum screen_style style =
		silent || watch_nmt_state(s->watch, s->now_us) == WATCH_NMT_LOST ? SCREEN_GREY : SCREEN_PLAIN;
	struct screen_cell *line = new_line(body, true);
	char rate[32];
	int at, end = body->width;

	screen_rate_text(&pdo->rate, s->now_us, rate, sizeof(rate));
	at = print(line, 0, end, style, "TPDO%zu  %03Xh", number + 1, pdo->id);
	if (rate[0] && !silent)
		at = print(line, at, end, style, "  %s", rate);
	at = print(line, at, end, style, "  %llu received", (unsigned long long)pdo->rate.count);
	if (pdo->misfits)
		at = print(line, at, end, SCREEN_ALARM, ", %llu of wrong length", (unsigned long long)pdo->misfits);
	if (pdo->rate.count && silent)
		at = print(line, at, end, style, ", the last %.1f s ago", age_s);
	if (pdo->skipped)
		at = print_count(line, at, end, style, ", ", pdo->skipped, " skipped");
	if (pdo->repeated)
		at = print_count(line, at, end, style, ", ", pdo->repeated, " repeated");
	if (pdo->counted)
		print_count(line, at, end, style, ", sample ", pdo->counter, "");
	for (size_t i = 0; pdo->rate.count && i < pdo->field_count; i++)
		if (!is_counter(&pdo->fields[i]))
			add_field(s, body, number, i, style);
}

/* ---- the attitude ---- */

static bool find_angles(const struct watch *w, double angles_rad[3], uint64_t *at_us)
{
	bool found[3] = {false};

	for (size_t i = 0; i < w->pdo_count; i++)
		for (size_t k = 0; w->pdos[i].enabled && w->pdos[i].rate.count && k < w->pdos[i].field_count; k++) {
			const struct watch_field *f = &w->pdos[i].fields[k];

			if (!f->entry || (f->entry->index != OD_INDEX_ANGLES && f->entry->index != OD_INDEX_ANGLES_DEG))
				continue;
			angles_rad[f->entry->sub - 1] = f->raw * f->step / DEG_PER_RAD;
			found[f->entry->sub - 1] = true;
			*at_us = w->pdos[i].rate.last_us;
		}
	return found[0] && found[1] && found[2];
}

/* As seen along l: the horizon, which turns with roll and moves with pitch (a row is 10 deg), and the compass below:
 * yaw is counter-clockwise from east, the heading clockwise from north. */
static void add_attitude(const struct screen *s, struct body *body)
{
	static const char COMPASS[] = "N . . NE. . E . . SE. . S . . SW. . W . . NW. . ";
	const int points = (int)sizeof(COMPASS) - 1, middle = HORIZON_COLUMNS / 2;
	double a[3];
	uint64_t at_us = 0;

	if (!find_angles(s->watch, a, &at_us))
		return;
	enum screen_style style = seconds_since(at_us, s->now_us) > 1 ? SCREEN_GREY : SCREEN_PLAIN;
	double heading = fmod(450 - a[2] * DEG_PER_RAD, 360);
	struct screen_cell *line = new_line(body, true);
	print(line, 0, body->width, style, "attitude  roll %.1f  pitch %.1f  heading %.0f deg, %s", a[0] * DEG_PER_RAD,
		a[1] * DEG_PER_RAD, heading, fabs(a[0]) > RAD_PER_DEG * 90 ? "upside down" : "seen along l");
	for (int r = 0; r < HORIZON_ROWS; r++) {
		line = new_line(body, false);
		put(line, 2, 3, style, "|");
		put(line, 3 + HORIZON_COLUMNS, 4 + HORIZON_COLUMNS, style, "|");
		for (int c = 0; c < HORIZON_COLUMNS; c++) {
			double x = (c - middle) / 2.0, y = HORIZON_ROWS / 2 - r; /* a cell is twice as high as wide */
			/* pitch is positive with the nose down: the horizon rises */
			double height = y * cos(a[0]) - x * sin(a[0]) - a[1] * DEG_PER_RAD / 10;
			const char *glyph = c == middle && r == HORIZON_ROWS / 2 ? "+"
					    : fabs(height) <= 0.5		 ? "-"
					    : height < 0			 ? ":"
										 : " ";

			put(line, 3 + c, 4 + c, style, glyph);
		}
	}
	line = new_line(body, false);
	for (int c = 0; c < HORIZON_COLUMNS; c++) {
		int point = ((int)lround(heading / 360 * points) + c - middle + 2 * points) % points;

		print(line, 3 + c, 4 + c, c == middle ? SCREEN_BOLD : style, "%c", COMPASS[point]);
	}
}

/* ---- EMCY, event log, keys ---- */

static void add_emcys(const struct screen *s, struct body *body)
{
	const struct watch *w = s->watch;

	if (w->emcy.count < 2)
		return; /* the header has it */
	print(new_line(body, true), 0, body->width, SCREEN_PLAIN, "emergencies: %llu, the latest first",
		(unsigned long long)w->emcy.count);
	for (size_t i = 0; i < WATCH_EMCYS && i < w->emcy.count; i++)
		print_emcy(s, &w->emcys[i], new_line(body, false), 2, body->width, false);
}

/* The last lines that fit into half a page. */
static void add_events(const struct screen *s, struct body *body, int lines)
{
	const char *text = s->watch->events, *at = text + strlen(text);

	put(new_line(body, true), 0, body->width, SCREEN_PLAIN, "event log, s since the start");
	for (int i = 0; at > text && i <= lines; i++) {
		for (at--; at > text && at[-1] != '\n'; at--)
			;
	}
	while (*at) {
		size_t length = strcspn(at, "\n");

		print(new_line(body, false), 0, body->width, SCREEN_PLAIN, "%.*s", (int)length, at);
		at += length + (at[length] == '\n');
	}
	if (!text[0])
		put(new_line(body, false), 2, body->width, SCREEN_GREY, "not read yet");
}

static void add_keys(struct body *body)
{
	static const char *const KEYS[] = {"keys", "  q        end", "  space, b next page, page before",
		"  s        NMT start", "  x        stop sending: NMT enter pre-operational",
		"  t        tare: both slopes become 0 (2073h)",
		"  z        zero: velocity and position become 0 (2040h:6)", "  S        store all parameters (1010h)",
		"  e        event log (2131h) on, off", "  ?        this list"};

	for (size_t i = 0; i < sizeof(KEYS) / sizeof(KEYS[0]); i++)
		put(new_line(body, i == 0), 0, body->width, SCREEN_PLAIN, KEYS[i]);
}

/* ---- columns and pages ---- */

static int block_length(const struct body *body, int from)
{
	int to = from + 1;

	while (to < body->count && !body->line[to].first)
		to++;
	return to - from;
}

/* Places the lines one below the other; a block that does not fit any more begins the next column. Returns the number
 * of columns of all pages. */
static int flow(const struct body *body, struct screen_cells *cells, int columns, unsigned int page, bool draw)
{
	int height = cells->rows - HEADER_ROWS - 1, slot = 0, row = 0;

	for (int i = 0; i < body->count; i++) {
		int length = body->line[i].first ? block_length(body, i) : 1;
		bool fits = row + length + (row > 0 && body->line[i].first) <= height;

		if (row > 0 && ((!fits && length <= height) || row >= height)) {
			slot++;
			row = 0;
		}
		if (row > 0 && body->line[i].first)
			row++; /* a blank line between blocks */
		if (draw && slot / columns == (int)page && row < height)
			memcpy(&cells->cell[HEADER_ROWS + 1 + row][slot % columns * (body->width + 1)],
				body->line[i].cell, (size_t)body->width * sizeof(struct screen_cell));
		row++;
	}
	return slot + 1;
}

static void fill_body(const struct screen *s, struct body *body, int event_lines)
{
	body->count = 0;
	if (s->help) {
		add_keys(body);
		return;
	}
	if (s->hint[0])
		add_words(body, new_line(body, true), 0, s->hint, SCREEN_BOLD);
	for (size_t i = 0; i < s->watch->pdo_count; i++)
		if (s->watch->pdos[i].enabled)
			add_pdo(s, body, i);
	add_attitude(s, body);
	add_emcys(s, body);
	if (s->events)
		add_events(s, body, event_lines);
}

/* As many columns as are needed for one page, as far as they fit: the fewer, the wider. */
void screen_draw(const struct screen *s, struct screen_cells *cells)
{
	static struct body body;
	int most = cells->columns / COLUMN_MIN, columns = 0, slots;

	memset(cells->cell, 0, sizeof(cells->cell));
	do {
		columns++;
		body.width = cells->columns / columns - (columns > 1);
		body.width = body.width > COLUMN_MAX ? COLUMN_MAX : body.width;
		fill_body(s, &body, cells->rows / 2);
		slots = flow(&body, cells, columns, 0, false);
	} while (slots > columns && columns < most);
	cells->pages = (unsigned int)((slots + columns - 1) / columns);
	draw_header(s, cells);
	flow(&body, cells, columns, s->page % cells->pages, true);
}

/* ---- history ---- */

void history_add(struct history *history, const struct watch *watch)
{
	for (size_t i = 0; i < watch->pdo_count; i++)
		for (size_t k = 0; k < watch->pdos[i].field_count; k++) {
			const struct watch_field *field = &watch->pdos[i].fields[k];

			history->values[i][k][history->count % HISTORY_LENGTH] =
				watch->pdos[i].rate.count ? (float)(field->raw * field->step) : NAN;
		}
	history->count++;
}
