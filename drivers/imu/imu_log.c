#include "drivers/imu/imu_log.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { HEAD = 200 };	 /* rows that determine the rate */
enum { AHEAD = 8 };	 /* rows that decide about a time that jumps */
enum { ENDS_LEAST = 4 }; /* bursts in the first rows, below which they are gaps */
/* us. Times beyond are refused (317 years); their sum over logs one behind the other ends here, too. */
static const int64_t LATEST_US = 10000000000000000, LATEST_SUM_US = 1000000000000000000;
/* Sampling intervals by which a time that does not jump may be ahead; behind a wrap; as the last one, with none to
 * compare it. */
static const double JUMP_INTERVALS = 2.5, WRAP_INTERVALS = 20, END_INTERVALS = 1000;
/* us. Intervals in a burst are shorter: the time of a transfer; those between bursts are not longer: the age that the
 * oldest sample of a burst may have. By judgement. */
static const int64_t TRANSFER_US = 2000, BURST_US = 2000000;
/* Share of the intervals that are in bursts, and their length in mean intervals. By judgement: of even samples with a
 * jitter of a third of the interval fewer are so short. */
static const double SHORT_SHARE = 0.2, SHORT = 0.25;
/* Fewer intervals than this share are, within this share of the median, that or a multiple of it (where samples were
 * lost): their rate is the mean one. By judgement. */
static const double USUAL_SHARE = 0.7, USUAL = 0.1;
/* The rate of the first rows is that of the sensor within this share. By judgement. */
static const double CLOCK_TOLERANCE = 0.05;
/* Median intervals above which the time cannot be in s, in ms, in us: from 3 samples a second nothing can be estimated.
 * The limits between ms, us and ns are 4 samples a second of the one, 4000 of the other. */
static const double MS_FROM = 0.3, US_FROM = 250, NS_FROM = 2.5e5;
enum { UNIT_LEAST = 10 }; /* rows to find a unit by */

/* ---- the queue --------------------------------------------------------------------------------------------------- */

static bool same_vec3(struct vec3 a, struct vec3 b)
{
	return a.x == b.x && a.y == b.y && a.z == b.z;
}

/* A logger wrote the row before once more. */
static bool same_row(const struct log_row *a, const struct log_row *b)
{
	return a->t == b->t && a->sample.flags == b->sample.flags &&
	       same_vec3(a->sample.gyro_rad_s, b->sample.gyro_rad_s) &&
	       same_vec3(a->sample.accel_m_s2, b->sample.accel_m_s2) && same_vec3(a->sample.mag_uT, b->sample.mag_uT);
}

/* The i-th row from here, NULL behind the last one. */
static const struct log_row *peek(struct imu_log *log, unsigned i)
{
	while (log->count <= i && !log->ended) {
		struct log_row *next = &log->queue[(log->first + log->count) % IMU_LOG_QUEUE];
		int got = log_rows_next(&log->rows, next);

		if (got != 1) {
			log->ended = got < 0 ? got : 1;
		} else if (log->any && !next->begins && same_row(next, &log->newest)) {
			log_rows_event(
				&log->rows, LOG_SKIP_TIME, next->line, "time does not increase: '%.12g'", next->t);
		} else {
			log->count++;
			log->newest = *next;
			log->any = true;
		}
	}
	return i < log->count ? &log->queue[(log->first + i) % IMU_LOG_QUEUE] : NULL;
}

static void drop(struct imu_log *log)
{
	log->first = (log->first + 1) % IMU_LOG_QUEUE;
	log->count--;
}

static bool in_range(const struct imu_log *log, const struct log_row *row)
{
	return fabs(row->t * log->unit_us) < (double)LATEST_US && log->shift_us < LATEST_SUM_US;
}

/* In microseconds; limited to the range. */
static int64_t time_us(const struct imu_log *log, const struct log_row *row)
{
	double t_us = floor(row->t * log->unit_us + 0.5), latest_us = (double)LATEST_US;

	return (int64_t)fmax(-latest_us, fmin(latest_us, t_us)) + log->shift_us;
}

/* ---- the order of the rows --------------------------------------------------------------------------------------- */

/* How much earlier than the one before a row of even samples may be. */
static int64_t slack_us(const struct imu_log *log)
{
	return log->even ? BURST_US : -1;
}

/* The rows from the i-th on have increasing times, all before `end_us`: they begin again, not just one of them. */
static bool begins_again(struct imu_log *log, unsigned i, int64_t end_us)
{
	int64_t last_us = INT64_MIN;
	unsigned rows = 0;

	for (; rows < AHEAD; rows++) {
		const struct log_row *row = peek(log, i + rows);

		if (!row)
			break;
		if (time_us(log, row) + slack_us(log) < last_us || time_us(log, row) >= end_us)
			return false;
		last_us = time_us(log, row);
	}
	return rows >= 3;
}

/* The number of rows from the next one on that jump ahead, while the one behind them does not: 0 when they are just
 * later. */
static unsigned glitches(struct imu_log *log)
{
	int64_t first_us = time_us(log, peek(log, 0));
	double jump_us = log->even ? (double)BURST_US : JUMP_INTERVALS * (double)log->interval_us;

	if (!log->started)
		return begins_again(log, 1, first_us);
	if ((double)(first_us - log->last_us) <= jump_us)
		return 0;
	if (!peek(log, 1)) /* the last row */
		return (double)(first_us - log->last_us) > END_INTERVALS * (double)log->interval_us;
	for (unsigned i = 1; i < AHEAD; i++) {
		const struct log_row *row = peek(log, i);

		if (row && time_us(log, row) + slack_us(log) >= log->last_us && time_us(log, row) < first_us)
			return i;
	}
	return 0;
}

/* The counter behind the times has wrapped: their sum with its range continues them. */
static int64_t wrapped_us(const struct imu_log *log, int64_t t_us)
{
	static const int BITS[] = {32, 31, 24, 16};
	const double units_us[] = {log->unit_us, 1, 1e3};

	for (int i = 0; i < 4; i++) {
		for (int unit = 0; unit < (log->unit_us == 1e6 ? 3 : 1); unit++) {
			double range_us = ldexp(units_us[unit], BITS[i]);
			double ahead_us = (double)(t_us - log->last_us) + range_us;

			if (ahead_us > 0 && ahead_us < WRAP_INTERVALS * (double)log->interval_us)
				return (int64_t)(range_us + 0.5);
		}
	}
	return 0;
}

static void skip_row(struct imu_log *log, enum log_event event, const char *what)
{
	const struct log_row *row = peek(log, 0);

	log_rows_event(&log->rows, event, row->line, "%s: '%.12g'", what, row->t);
	drop(log);
}

/* The next row whose time follows. 1, 0 at the end, -EIO. *t_us: its time, *again: another log begins with it. */
static int next_in_order(struct imu_log *log, struct log_row *row, int64_t *t_us, bool *again)
{
	const struct log_row *next;

	while ((next = peek(log, 0))) {
		int64_t now_us = time_us(log, next), back_us;
		bool later = !log->started || now_us + slack_us(log) >= log->last_us;
		unsigned ahead;

		*again = next->begins && log->started;
		if (!in_range(log, next)) {
			skip_row(log, LOG_SKIP_TIME, "t is out of range");
			continue;
		}
		ahead = glitches(log);
		for (unsigned i = 0; i < ahead; i++)
			skip_row(log, LOG_SKIP_GLITCH, "time jumps ahead, that of the rows behind it does not");
		if (ahead)
			continue;
		if (!later && !*again && !begins_again(log, 0, log->last_us)) {
			skip_row(log, LOG_SKIP_TIME, "time does not increase");
			continue;
		}
		if (!later) {
			back_us = *again ? 0 : wrapped_us(log, now_us);
			if (back_us > 0)
				log_rows_event(&log->rows, LOG_WRAP, next->line, "the counter of the time has wrapped");
			else
				*again = true;
			log->shift_us += back_us > 0 ? back_us : log->last_us + log->interval_us - now_us;
		}
		if (*again)
			log_rows_event(&log->rows, LOG_ANOTHER, next->line, "another log begins");
		*row = *next;
		*t_us = log->last_us = time_us(log, next);
		log->started = true;
		drop(log);
		return 1;
	}
	return log->ended < 0 ? log->ended : 0;
}

/* ---- even samples ------------------------------------------------------------------------------------------------ */

static void start_clock(struct imu_log *log, int64_t t_us, double period_ns)
{
	sample_clock_start(&log->clock, period_ns, CLOCK_TOLERANCE);
	log->clock_start_us = t_us;
	log->index = log->bracketed = 0;
}

/* Shows the clock the end of the burst to which the row of this time belongs: all its samples were taken before, and,
 * but for the lateness of transfers, the one behind it was not. */
static void see_burst(struct imu_log *log, int64_t t_us)
{
	double half_us = 0.5e-3 * sample_clock_period(&log->clock), end_ns;
	const struct log_row *next;
	unsigned n = 0;
	bool whole;

	while ((next = peek(log, n)) && n < IMU_LOG_QUEUE - 1 && (double)llabs(time_us(log, next) - t_us) < half_us) {
		t_us = time_us(log, next);
		n++;
	}
	end_ns = 1e3 * (double)(t_us - log->clock_start_us);
	log->bracketed = log->index + n + 1;
	/* the end of the file may cut a burst short, and a time that jumps is none of a burst */
	whole = next && time_us(log, next) > t_us && time_us(log, next) - t_us < BURST_US;
	if (whole || log->index == 0)
		sample_clock_read(&log->clock, log->bracketed, end_ns - log->late_ns, end_ns);
}

static int64_t even_time_us(struct imu_log *log, int64_t t_us)
{
	if (log->index >= log->bracketed) {
		int64_t even_us = log->clock_start_us + (int64_t)(1e-3 * sample_clock_at(&log->clock, log->index));

		if (log->index > 0 && llabs(t_us - even_us) > BURST_US) /* a gap */
			start_clock(log, t_us, sample_clock_period(&log->clock));
		see_burst(log, t_us);
	}
	return log->clock_start_us + (int64_t)floor(1e-3 * sample_clock_at(&log->clock, log->index++));
}

/* ---- the first rows ---------------------------------------------------------------------------------------------- */

static int compare(const void *a, const void *b)
{
	double x = *(const double *)a, y = *(const double *)b;

	return (x > y) - (x < y);
}

/* The median of the intervals above 0 of the first rows, times `unit`; 0: there is none. */
static double median_interval(struct imu_log *log, double unit)
{
	double interval[HEAD], before = NAN, now;
	const struct log_row *row;
	size_t n = 0;

	for (unsigned i = 0; i < HEAD && (row = peek(log, i)); i++) {
		if (!in_range(log, row))
			continue;
		now = floor(row->t * unit + 0.5);
		interval[n] = now - before;
		n += interval[n] > 0; /* not the first one, which is not a number */
		before = now;
	}
	if (n == 0)
		return 0;
	qsort(interval, n, sizeof *interval, compare);
	return interval[n / 2];
}

/* As the header says it, else by the interval: no sensor is sampled only once in some seconds. */
static void find_time_unit(struct imu_log *log)
{
	static const struct {
		double from, us;
		const char *name;
	} UNITS[] = {{NS_FROM, 1e-3, "ns"}, {US_FROM, 1, "us"}, {MS_FROM, 1e3, "ms"}};
	double interval;

	log->unit_us = 1e-3;
	interval = median_interval(log, 1e3) / 1e3;
	log->unit_us = 1e6 * (log->rows.time_unit_s > 0 ? log->rows.time_unit_s : 1);
	if (log->rows.time_unit_s > 0 || !peek(log, UNIT_LEAST - 1))
		return;
	for (int i = 0; i < 3; i++) {
		if (interval < UNITS[i].from)
			continue;
		log->unit_us = UNITS[i].us;
		log_rows_event(&log->rows, LOG_TIME_UNIT, peek(log, 0)->line,
			"the time steps by %.4g: it is taken as %s; the header can name the unit: t[%s]", interval,
			UNITS[i].name, UNITS[i].name);
		return;
	}
}

/* The mean interval of the first rows, if they scatter so that the median is none of the sensor's; else 0. */
static double scattered_interval_us(struct imu_log *log)
{
	double sum_us = 0, times;
	unsigned n = 0, usual = 0;

	for (unsigned i = 1; i < HEAD && peek(log, i); i++) {
		double d_us = (double)(time_us(log, peek(log, i)) - time_us(log, peek(log, i - 1)));

		if (fabs(d_us) > (double)BURST_US)
			continue;
		sum_us += d_us;
		times = d_us / (double)log->interval_us;
		usual += times > 0.5 && fabs(times - floor(times + 0.5)) <= USUAL;
		n++;
	}
	return usual < USUAL_SHARE * n && sum_us >= n ? sum_us / n : 0;
}

/* The mean interval of samples that come in bursts, from the end of one burst to that of the next, without gaps; else
 * 0. */
static double bursts_interval_us(struct imu_log *log)
{
	int64_t end_us = 0, all_us = 0, sum_us = 0;
	unsigned n = 0, brief = 0, ends = 0, end = 0, samples = 0;
	bool after_end = false;
	double mean_us;

	for (unsigned i = 1; i < IMU_LOG_QUEUE && peek(log, i); i++) {
		int64_t d_us = time_us(log, peek(log, i)) - time_us(log, peek(log, i - 1));

		if (llabs(d_us) <= BURST_US) {
			sum_us += d_us;
			n++;
		}
	}
	if (n == 0 || sum_us <= 0)
		return 0;
	mean_us = (double)sum_us / n;
	for (unsigned i = 1; i < IMU_LOG_QUEUE && peek(log, i); i++) {
		int64_t before_us = time_us(log, peek(log, i - 1)), d_us = time_us(log, peek(log, i)) - before_us;

		brief += llabs(d_us) < TRANSFER_US && (double)d_us < SHORT * mean_us;
		if (llabs(d_us) > BURST_US) {
			after_end = false;
		} else if ((double)d_us > mean_us / 2) {
			all_us += after_end ? before_us - end_us : 0;
			samples += after_end ? i - 1 - end : 0;
			end_us = before_us;
			end = i - 1;
			after_end = true;
			ends++;
		}
	}
	if (ends < ENDS_LEAST || brief < SHORT_SHARE * n)
		return 0;
	return samples > 0 && all_us >= samples ? (double)all_us / samples : 0;
}

/* By how much the ends of the bursts of the first rows are later than others, beyond the interval that even samples
 * read at any time explain. */
static double lateness_us(struct imu_log *log, double interval_us)
{
	double least_us = INFINITY, most_us = -INFINITY, even_us = 0, late_us = 0;

	for (unsigned i = 1; i < IMU_LOG_QUEUE && peek(log, i); i++) {
		int64_t before_us = time_us(log, peek(log, i - 1)), d_us = time_us(log, peek(log, i)) - before_us;

		if (llabs(d_us) > BURST_US) { /* a gap, behind which the samples begin at another time */
			least_us = INFINITY;
			most_us = -INFINITY;
		} else if ((double)d_us > interval_us / 2) {
			least_us = fmin(least_us, (double)before_us - even_us);
			most_us = fmax(most_us, (double)before_us - even_us);
			late_us = fmax(late_us, most_us - least_us);
		}
		even_us += interval_us;
	}
	return fmax(0, late_us - interval_us);
}

static void use_interval(struct imu_log *log, double interval_us)
{
	log->interval_us = (int64_t)(interval_us + 0.5);
	log->rate_hz = 1e6 / interval_us;
}

static int read_head(struct imu_log *log, char *error, size_t error_size)
{
	double interval_us, period_us, scattered_us;

	find_time_unit(log);
	interval_us = median_interval(log, log->unit_us);
	if (log->ended < 0) {
		snprintf(error, error_size, "%s:%ld: %s", log->path, log->rows.table[0].line, strerror(-log->ended));
		return log->ended;
	}
	if (interval_us < 1) {
		snprintf(error, error_size, "%s: fewer than two valid rows%s%s", log->path,
			log->rows.events.skipped ? "; last skipped row: " : "", log->rows.events.last_skip);
		return -EINVAL;
	}
	use_interval(log, interval_us);
	period_us = bursts_interval_us(log);
	log->even = period_us > 0;
	scattered_us = log->even ? 0 : scattered_interval_us(log);
	if (log->even) {
		log_rows_event(&log->rows, LOG_EVEN, peek(log, 0)->line,
			"the times come in bursts (median interval %.4g ms): the samples are taken as even, %.4g a "
			"second",
			1e-3 * interval_us, 1e6 / period_us);
		use_interval(log, period_us);
		log->late_ns = 1e3 * lateness_us(log, period_us);
		start_clock(log, time_us(log, peek(log, 0)), 1e3 * period_us);
	} else if (scattered_us > 0) {
		use_interval(log, scattered_us);
		log_rows_event(&log->rows, LOG_EVEN, peek(log, 0)->line,
			"the times scatter: the mean rate of %.4g a second is taken for the sensor's", log->rate_hz);
	}
	return 0;
}

/* ---- the log ----------------------------------------------------------------------------------------------------- */

int imu_log_open(struct imu_log *log, const char *path, const struct log_format *format, char *error, size_t error_size)
{
	int result;

	snprintf(log->path, sizeof log->path, "%s", path);
	log->first = log->count = 0;
	log->any = false;
	log->ended = 0;
	log->origin_us = log->shift_us = 0;
	log->started = log->even = false;
	memset(log->before, 0, sizeof log->before);
	log->units = (struct log_units){0};
	result = log_rows_open(&log->rows, path, format, error, error_size);
	if (result < 0)
		return result;
	result = read_head(log, error, error_size);
	if (result < 0)
		imu_log_close(log);
	return result;
}

static bool is_clipped(struct imu_log *log, const struct imu_sample *sample)
{
	const struct log_row *next = peek(log, 0), *behind = peek(log, 1);
	const struct imu_sample *const five[5] = {
		&log->before[1], &log->before[0], sample, next ? &next->sample : NULL, behind ? &behind->sample : NULL};

	return log_units_clipped(&log->units, five);
}

static int64_t larger(int64_t a, int64_t b)
{
	return a > b ? a : b;
}

int imu_log_next(struct imu_log *log, struct imu_sample *sample)
{
	bool first = !log->started, again;
	struct log_row row;
	int64_t t_us;
	int got = next_in_order(log, &row, &t_us, &again);

	if (got <= 0)
		return got;
	if (again && log->even)
		start_clock(log, t_us, sample_clock_period(&log->clock));
	if (log->even)
		t_us = even_time_us(log, t_us);
	if (first && t_us < 0)
		log->origin_us = -t_us;
	if (!first) /* even times may be corrected by more than an interval */
		t_us = larger(t_us, log->last_t_us + (log->even ? log->interval_us / 4 + 1 : 1) - log->origin_us);
	log->last_t_us = t_us + log->origin_us;
	*sample = row.sample;
	sample->t_us = (uint64_t)log->last_t_us;
	if (is_clipped(log, &row.sample))
		sample->flags |= SAMPLE_SATURATED;
	log->before[1] = log->before[0];
	log->before[0] = row.sample;
	if (again)
		sample->flags |= SAMPLE_DISCONTINUITY;
	log_units_add(&log->units, sample);
	return 1;
}

bool imu_log_message(const struct imu_log *log, int i, char *text, size_t size)
{
	for (int event = 0; event < LOG_EVENTS; event++) {
		uint32_t count = log->rows.events.of[event].count;
		const char *first = log->rows.events.of[event].first;

		if (count == 0 || i-- > 0)
			continue;
		if (event >= LOG_SKIPS && count == 1)
			snprintf(text, size, "%s", first);
		else
			snprintf(text, size, "%u %s%s%s", count,
				event >= LOG_SKIPS ? "times"
				: count == 1	   ? "row skipped"
						   : "rows skipped",
				count == 1 ? ": " : ", the first one: ", first);
		return true;
	}
	for (int sensor = 0; sensor < 3; sensor++)
		if (log_units_warning(&log->units, sensor, text, size) && i-- == 0)
			return true;
	return false;
}

unsigned imu_log_uncalibrated(const struct imu_log *log)
{
	return log->rows.table[0].uncalibrated;
}

bool imu_log_has_reference(const struct imu_log *log)
{
	return log->rows.table[0].header.field_of[LOG_REFERENCE] >= 0;
}

void imu_log_close(struct imu_log *log)
{
	log_rows_close(&log->rows);
}
