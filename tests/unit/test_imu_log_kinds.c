/* Logs as people have them. A generator writes the same samples in one kind of log after the other; whatever the kind,
 * the samples that are read are those that were written. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "drivers/imu/imu_log.h"
#include "model/math/units.h"
#include "model/sim/rng.h"
#include "model/sim/sensor.h"

enum { ROWS = 2000, SECOND = 500 /* rows of a second log */, SETTLED = 300 };
static const double STEP_S = 0.01, GRAVITY = STANDARD_GRAVITY_M_S2;

static struct imu_sample truth[ROWS];
static bool lossless[ROWS]; /* a radio lets these rows through */
static int through;
enum { THREE_OF_FIVE = -1 }; /* their number */

struct kind {
	const char *name, *header;
	void (*write)(FILE *file, int k, const struct imu_sample *s);
	int rows;	     /* that are read */
	const char *message; /* a part of one; NULL: there is none */
	double from_s;	     /* the time of the first row of the truth */
	double off_s;	     /* by which times may be off, once the clock has settled */
};

#define HEADER "t,gx,gy,gz,ax,ay,az,mx,my,mz\n"

static const char *const FILES[] = {"log.imu.csv", "log.csv", "Gyroscope.csv", "Accelerometer.csv", "Magnetometer.csv"};

static int simulate(void **state)
{
	struct sensor_config config = *sensor_preset("lsm303dlhc_l3gd20_fine");
	struct sensor sensor;
	struct rng rng;

	(void)state;
	config.rate_hz = 1 / STEP_S;
	assert_int_equal(sensor_init(&sensor, &config, 3), 0);
	rng_init(&rng, 1);
	through = 0;
	for (int k = 0; k < ROWS; k++) {
		sensor_next(&sensor, signal_find("tumble"), &truth[k], NULL);
		lossless[k] = k == 0 || rng_uniform(&rng) < 0.6;
		through += lossless[k];
	}
	return 0;
}

/* ---- the generator ----------------------------------------------------------------------------------------------- */

static double t_s(int k)
{
	return k * STEP_S;
}

static void triad(FILE *file, const char *separator, struct vec3 v, double unit)
{
	fprintf(file, "%s%.10g%s%.10g%s%.10g", separator, v.x / unit, separator, v.y / unit, separator, v.z / unit);
}

static void values(FILE *file, const struct imu_sample *s, double rate, double force, double field)
{
	triad(file, ",", s->gyro_rad_s, rate);
	triad(file, ",", s->accel_m_s2, force);
	if (s->flags & SAMPLE_MAG)
		triad(file, ",", s->mag_uT, field);
	else
		fputs(",,,", file);
}

static void row_at(FILE *file, double t, const struct imu_sample *s)
{
	fprintf(file, "%.9g", t);
	values(file, s, 1, 1, 1);
	fputc('\n', file);
}

static void plain(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, t_s(k), s);
}

static void glitch(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, k == 700 ? 99999 : t_s(k), s);
}

static void glitches(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, k >= 700 && k < 704 ? t_s(k) + 0.5 : t_s(k), s);
}

static void glitch_first(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, k == 0 ? 4294.9 : t_s(k), s);
}

static void glitch_last(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, k == ROWS - 1 ? 99999 : t_s(k), s);
}

static void twice(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, t_s(k), s);
	row_at(file, t_s(k), s);
}

static void glitch_back(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, k == 700 ? 0 : t_s(k), s);
}

static void milliseconds(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, 1e3 * t_s(k), s);
}

static void microseconds(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, 1e6 * t_s(k), s);
}

static void nanoseconds_of_the_epoch(FILE *file, int k, const struct imu_sample *s)
{
	fprintf(file, "17000000%02d%09ld", k / 100, k % 100 * 10000000L);
	values(file, s, 1, 1, 1);
	fputc('\n', file);
}

static void below_zero(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, t_s(k) - 0.07, s);
}

static void wrap_s(FILE *file, int k, const struct imu_sample *s)
{
	fprintf(file, "%.6f", 1e-6 * (uint32_t)(4290000000u + (unsigned)k * 10000u));
	values(file, s, 1, 1, 1);
	fputc('\n', file);
}

static void wrap_us(FILE *file, int k, const struct imu_sample *s)
{
	fprintf(file, "%u", (uint32_t)(4290000000u + (unsigned)k * 10000u));
	values(file, s, 1, 1, 1);
	fputc('\n', file);
}

static void second_log(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, k < ROWS - SECOND ? t_s(k) : t_s(k - (ROWS - SECOND)), s);
}

static void second_log_with_header(FILE *file, int k, const struct imu_sample *s)
{
	if (k == ROWS - SECOND)
		fputs(HEADER, file);
	second_log(file, k, s);
}

static void nan_words(FILE *file, int k, const struct imu_sample *s)
{
	static const char *const WORDS[] = {"nan,nan,nan", "NaN,NaN,NaN", "NA,NA,NA", "null,null,null", ",,"};

	fprintf(file, "%.9g", t_s(k));
	triad(file, ",", s->gyro_rad_s, 1);
	triad(file, ",", s->accel_m_s2, 1);
	if (s->flags & SAMPLE_MAG)
		triad(file, ",", s->mag_uT, 1);
	else
		fprintf(file, ",%s", WORDS[k % 5]);
	fputc('\n', file);
}

static void wide(FILE *file, int k, const struct imu_sample *s)
{
	fprintf(file, "%.9g", t_s(k));
	values(file, s, 1, 1, 1);
	fprintf(file, ",\"%05000d\"\n", k);
}

static void separated(
	FILE *file, int k, const struct imu_sample *s, const char *separator, const char *quote, bool comma)
{
	const double value[] = {t_s(k), s->gyro_rad_s.x, s->gyro_rad_s.y, s->gyro_rad_s.z, s->accel_m_s2.x,
		s->accel_m_s2.y, s->accel_m_s2.z, s->mag_uT.x, s->mag_uT.y, s->mag_uT.z};
	char text[32];

	for (int i = 0; i < 10; i++) {
		snprintf(text, sizeof text, "%.10g", value[i]);
		if (comma && strchr(text, '.'))
			*strchr(text, '.') = ',';
		if (i > 6 && !(s->flags & SAMPLE_MAG))
			*text = '\0';
		fprintf(file, "%s%s%s%s", i ? separator : "", quote, text, quote);
	}
	fputs("\r\n", file);
}

static void tabs(FILE *file, int k, const struct imu_sample *s)
{
	separated(file, k, s, "\t", "", false);
}

static void semicolons(FILE *file, int k, const struct imu_sample *s)
{
	separated(file, k, s, ";", "", true);
}

static void quotes(FILE *file, int k, const struct imu_sample *s)
{
	separated(file, k, s, ",", "\"", false);
}

static void comments(FILE *file, int k, const struct imu_sample *s)
{
	if (k % 100 == 50)
		fprintf(file, "# %d, still running\n", k);
	plain(file, k, s);
}

static void other_units(FILE *file, int k, const struct imu_sample *s)
{
	fprintf(file, "%.9g", 1e3 * t_s(k));
	values(file, s, RAD_PER_DEG, GRAVITY, 100);
	fputc('\n', file);
}

static void small_units(FILE *file, int k, const struct imu_sample *s)
{
	fprintf(file, "%.9g", 1e6 * t_s(k));
	values(file, s, 1e-3 * RAD_PER_DEG, 1e-3 * GRAVITY, 1e-3);
	fputc('\n', file);
}

/* The host reads 30 samples every 0.3 s, one transfer after the other. */
static void bursts(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, t_s(k / 30 * 30 + 30) + k % 30 * 0.0009, s);
}

static void bursts_with_a_glitch(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, k == 700 ? 99999 : t_s(k / 30 * 30 + 30) + k % 30 * 0.0009, s);
}

static void bursts_then_a_second_log(FILE *file, int k, const struct imu_sample *s)
{
	bursts(file, k < ROWS - SECOND ? k : k - (ROWS - SECOND), s);
}

static void batches(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, t_s(k / 8 * 8 + 8), s);
}

static void deep_batches(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, t_s(k / 128 * 128 + 128) + k % 128 * 0.0002, s);
}

static void doubled(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, t_s(k / 2 * 2 + 2), s);
}

/* The host looks every 15.6 ms, and finds one or two samples. */
static void ticks(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, 0.0156 * ceil(t_s(k + 1) / 0.0156), s);
}

/* The host's delay is anything up to the interval. */
static void jittered(FILE *file, int k, const struct imu_sample *s)
{
	row_at(file, t_s(k) + STEP_S * fmod(k * 0.618034, 1) * fmod(k * 0.618034, 1) * 0.999, s);
}

static void lossy(FILE *file, int k, const struct imu_sample *s)
{
	if (lossless[k])
		row_at(file, t_s(k), s);
}

static void clipped(FILE *file, int k, const struct imu_sample *s)
{
	fprintf(file, "%d,%.9g", k == 5, t_s(k));
	values(file, s, 1, 1, 1);
	fputc('\n', file);
}

static const struct kind KINDS[] = {
	{"plain", HEADER, plain, ROWS, NULL, 0, 0},
	{"one glitch forward", HEADER, glitch, ROWS - 1, ":702: time jumps ahead", 0, 0},
	{"four glitches in a row", HEADER, glitches, ROWS - 4, "4 rows skipped, the first one", 0, 0},
	{"the first row", HEADER, glitch_first, ROWS - 1, ":2: time jumps ahead", 0, 0},
	{"the last row", HEADER, glitch_last, ROWS - 1, ":2001: time jumps ahead", 0, 0},
	{"each row twice", HEADER, twice, ROWS, "2000 rows skipped, the first one: log.imu.csv:3: ", 0, 0},
	{"one glitch back", HEADER, glitch_back, ROWS - 1, ":702: time does not increase", 0, 0},
	{"ms", HEADER, milliseconds, ROWS, "taken as ms", 0, 0},
	{"us", HEADER, microseconds, ROWS, "taken as us", 0, 0},
	{"ns", HEADER, nanoseconds_of_the_epoch, ROWS, "taken as ns", 1.7e9, 1e-6},
	{"begins below 0", HEADER, below_zero, ROWS, NULL, -0.07, 0},
	{"us that wrap, in s", HEADER, wrap_s, ROWS, "wrapped", 4290, 0},
	{"us that wrap", HEADER, wrap_us, ROWS, "wrapped", 4290, 0},
	{"a second log", HEADER, second_log, ROWS, ":1502: another log begins", 0, 0},
	{"a second log with its header", HEADER, second_log_with_header, ROWS, ":1503: another log begins", 0, 0},
	{"nan", HEADER, nan_words, ROWS, NULL, 0, 0},
	{"rows of 5 kB", "t,gx,gy,gz,ax,ay,az,mx,my,mz,note\n", wide, ROWS, NULL, 0, 0},
	{"tabs", "t\tgx\tgy\tgz\tax\tay\taz\tmx\tmy\tmz\r\n", tabs, ROWS, NULL, 0, 0},
	{"semicolons", "t;gx;gy;gz;ax;ay;az;mx;my;mz\r\n", semicolons, ROWS, NULL, 0, 0},
	{"quotes", "\"t\",\"gx\",\"gy\",'gz',\"ax\",\"ay\",\"az\",\"mx\",\"my\",\"mz\"\r\n", quotes, ROWS, NULL, 0, 0},
	{"upper case", "T,GX,GY,GZ,AX,AY,AZ,MX,MY,MZ\n", plain, ROWS, NULL, 0, 0},
	{"comments", "# by a logger\n#\n\n" HEADER, comments, ROWS, NULL, 0, 0},
	{"the header is a comment", "# " HEADER, comments, ROWS, NULL, 0, 0},
	{"ms, deg/s, g, gauss, named",
		"t[ms],gx[deg/s],gy[deg/s],gz[deg/s],ax[g],ay[g],az[g],mx[gauss],my[gauss],mz[gauss]\n", other_units,
		ROWS, NULL, 0, 0},
	{"named once", "t[ms],gx[deg/s],gy,gz,ax[g],ay,az,mx[gauss],my,mz\n", other_units, ROWS, NULL, 0, 0},
	{"us, mdps, mg, nT, named otherwise",
		"t_us,gx (mdps),gy (mdps),gz (mdps),ax_mg,ay_mg,az_mg,mx [nT],my [nT],mz [nT]\n", small_units, ROWS,
		NULL, 0, 0},
	{"bursts", HEADER, bursts, ROWS, "even", 0, 0.040 /* a transfer takes 27 ms */},
	{"bursts with a glitch", HEADER, bursts_with_a_glitch, ROWS - 1, ":702: time jumps ahead", 0, 0.040},
	{"bursts, then a second log", HEADER, bursts_then_a_second_log, ROWS, ":1502: another log begins", 0, 0.350},
	{"batches", HEADER, batches, ROWS, "even", 0, 0.015},
	{"batches of 128", HEADER, deep_batches, ROWS, "even", 0, 0.045 /* a transfer takes 26 ms */},
	{"doubled", HEADER, doubled, ROWS, "even", 0, 0.015},
	{"ticks", HEADER, ticks, ROWS, "even", 0, 0.015},
	{"jittered", HEADER, jittered, ROWS, "the times scatter: the mean rate", 0, STEP_S},
	{"lossy", HEADER, lossy, THREE_OF_FIVE, NULL, 0, 0},
	{"clipped", "clipped," HEADER, clipped, ROWS, NULL, 0, 0},
};

static char folder[] = "/tmp/imu9_kinds_XXXXXX", path[64];

static FILE *create(const char *name)
{
	FILE *file;

	snprintf(path, sizeof path, "%s/%s", folder, name);
	file = fopen(path, "w");
	assert_non_null(file);
	return file;
}

static void write_kind(const struct kind *kind)
{
	FILE *file = create("log.imu.csv");

	fputs(kind->header, file);
	for (int k = 0; k < ROWS; k++)
		kind->write(file, k, &truth[k]);
	fclose(file);
}

/* ---- reading ----------------------------------------------------------------------------------------------------- */

static struct imu_log log_;
static struct imu_sample found[ROWS + 1];

static int read_log(const char *where, const char *format)
{
	char error[512];
	int n = 0, got;

	if (imu_log_open(&log_, where, log_format_named(format), error, sizeof error) < 0)
		fail_msg("%s: %s", where, error);
	while ((got = imu_log_next(&log_, &found[n])) == 1) {
		assert_true(n == 0 || found[n].t_us > found[n - 1].t_us);
		assert_true(n < ROWS);
		n++;
	}
	assert_int_equal(got, 0);
	imu_log_close(&log_);
	return n;
}

static bool says(const char *word)
{
	char text[256];

	for (int i = 0; imu_log_message(&log_, i, text, sizeof text); i++)
		if (!word || strstr(text, word))
			return true;
	return false;
}

static bool close_to(struct vec3 a, struct vec3 b, double off)
{
	return vec3_norm(vec3_sub(a, b)) <= off;
}

/* Each sample found is the next of the true ones that it equals, so that only whole rows are missing. */
static void assert_true_samples(const char *name, int n, double first_s, double off_s)
{
	int k = 0;

	for (int i = 0; i < n; i++, k++) {
		double t = 1e-6 * (double)((int64_t)found[i].t_us - log_.origin_us);

		while (k < ROWS && !(close_to(found[i].gyro_rad_s, truth[k].gyro_rad_s, 1e-8) &&
					   close_to(found[i].accel_m_s2, truth[k].accel_m_s2, 1e-7)))
			k++;
		if (k == ROWS)
			fail_msg("%s: sample %d is none that was written", name, i);
		if ((found[i].flags & SAMPLE_MAG) != (truth[k].flags & SAMPLE_MAG) ||
			!close_to(found[i].mag_uT, truth[k].mag_uT, 1e-6))
			fail_msg("%s: row %d has another field", name, k);
		if (fabs(t - first_s - t_s(k)) > (k < SETTLED ? 0.5 * (off_s > 0.001) : 0) + off_s + 1e-6)
			fail_msg("%s: row %d has the time %.6f", name, k, t);
		if (n == ROWS && k > SETTLED && k < ROWS - SECOND && off_s > STEP_S &&
			fabs((double)(found[i].t_us - found[i - 1].t_us) - 1e4) > 1e3)
			fail_msg("%s: row %d is %d us after the one before", name, k,
				(int)(found[i].t_us - found[i - 1].t_us));
	}
}

static void test_every_kind_of_log_gives_the_samples_that_were_written(void **state)
{
	(void)state;
	for (size_t i = 0; i < sizeof KINDS / sizeof *KINDS; i++) {
		const struct kind *kind = &KINDS[i];
		int n;

		write_kind(kind);
		n = read_log(path, "imu9");
		if (n != (kind->rows == THREE_OF_FIVE ? through : kind->rows))
			fail_msg("%s: %d rows, not %d", kind->name, n, kind->rows);
		if (says(kind->message) != (kind->message != NULL))
			fail_msg("%s: does not say '%s'", kind->name, kind->message ? kind->message : "nothing");
		if (fabs(log_.rate_hz - 100) > (kind->write == ticks || kind->write == jittered ? 0.5 : 0.03))
			fail_msg("%s: %.3f samples a second", kind->name, log_.rate_hz);
		assert_true_samples(kind->name, n, kind->from_s, kind->off_s);
	}
}

static void test_a_second_log_is_a_discontinuity_and_a_wrap_is_none(void **state)
{
	const char *const names[] = {"a second log", "a second log with its header", "us that wrap", "bursts"};

	(void)state;
	for (size_t i = 0; i < sizeof KINDS / sizeof *KINDS; i++)
		for (int which = 0; which < 4; which++)
			if (strcmp(KINDS[i].name, names[which]) == 0) {
				write_kind(&KINDS[i]);
				assert_int_equal(read_log(path, "imu9"), ROWS);
				for (int k = 0; k < ROWS; k++)
					assert_int_equal(!!(found[k].flags & SAMPLE_DISCONTINUITY),
						which < 2 && k == ROWS - SECOND);
			}
}

/* The host paused for 10 s. */
static void test_after_a_gap_bursts_have_the_time_of_their_rows_again(void **state)
{
	FILE *file = create("log.imu.csv");
	int n;

	(void)state;
	fputs(HEADER, file);
	for (int k = 0; k < ROWS; k++)
		row_at(file, t_s(k / 8 * 8 + 8) + (k < 1000 ? 0 : 10), &truth[k]);
	fclose(file);
	n = read_log(path, "imu9");
	assert_int_equal(n, ROWS);
	assert_true(fabs(log_.rate_hz - 100) < 1e-6);
	for (int k = SETTLED; k < n; k++) {
		double late_s = 1e-6 * (double)found[k].t_us - t_s(k) - (k < 1000 ? 0 : 10);

		assert_true(fabs(late_s) < (k < 1000 || k > 1000 + SETTLED ? 0.015 : 0.1));
	}
}

/* The end of the last one may be missing. */
static void test_a_single_burst_behind_a_gap_was_taken_before_its_rows(void **state)
{
	enum { ROWS_BEFORE = 1000, BURST = 8 };
	FILE *file = create("log.imu.csv");

	(void)state;
	fputs(HEADER, file);
	for (int k = 0; k < ROWS_BEFORE + BURST; k++)
		row_at(file, t_s(k / BURST * BURST + BURST) + (k < ROWS_BEFORE ? 0 : 10), &truth[k]);
	fclose(file);
	assert_int_equal(read_log(path, "imu9"), ROWS_BEFORE + BURST);
	for (int k = ROWS_BEFORE; k < ROWS_BEFORE + BURST; k++)
		assert_true(fabs(1e-6 * (double)found[k].t_us - t_s(k) - 10) < 0.015);
}

static void test_the_column_clipped_marks_saturation(void **state)
{
	(void)state;
	write_kind(&KINDS[sizeof KINDS / sizeof *KINDS - 1]);
	assert_int_equal(read_log(path, "imu9"), ROWS);
	for (int k = 0; k < ROWS; k++)
		assert_true(k != 5 || (found[k].flags & SAMPLE_SATURATED));
}

/* The motion turns at up to 6 rad/s, a sensor of 250 deg/s measures 4.4. */
static void test_values_that_stay_at_the_end_of_a_usual_range_are_saturated(void **state)
{
	int marked = 0, at_end = 0;

	(void)state;
	write_kind(&KINDS[0]);
	assert_int_equal(read_log(path, "imu9"), ROWS);
	for (int k = 0; k < ROWS; k++) {
		const struct vec3 w = truth[k].gyro_rad_s;
		bool end = fmax(fabs(w.x), fmax(fabs(w.y), fabs(w.z))) > 249.9 * RAD_PER_DEG;

		at_end += end;
		marked += !!(found[k].flags & SAMPLE_SATURATED);
		assert_true(end || !(found[k].flags & SAMPLE_SATURATED));
	}
	assert_true(at_end > 50 && marked > 0.9 * at_end);
}

/* Three rows in a row are at the end of the range of 250 deg/s, the largest values so far. */
static void test_all_of_three_samples_at_the_end_of_a_range_are_saturated(void **state)
{
	FILE *file = create("log.imu.csv");

	(void)state;
	fputs(HEADER, file);
	for (int k = 0; k < 40; k++) {
		struct imu_sample s = truth[k];

		s.gyro_rad_s = (struct vec3){0.1, (k >= 20 && k < 23 ? 250 : 100 - k) * RAD_PER_DEG, 0.2};
		row_at(file, t_s(k), &s);
	}
	fclose(file);
	assert_int_equal(read_log(path, "imu9"), 40);
	for (int k = 0; k < 40; k++)
		assert_int_equal(!!(found[k].flags & SAMPLE_SATURATED), k >= 20 && k < 23);
}

static void test_every_kind_of_skipped_row_is_told_with_its_count_and_first_line(void **state)
{
	FILE *file = create("log.imu.csv");

	(void)state;
	fputs(HEADER, file);
	for (int k = 0; k < 30; k++) {
		if (k % 10 == 3)
			fputs("1,2,3\n", file);
		if (k % 10 == 5)
			fprintf(file, "%g,x,0,0,0,0,9.8,,,\n", t_s(k) - 0.005);
		if (k == 7)
			fputs("0.001,0,0,0,0,0,9.8,,,\n", file);
		plain(file, k, &truth[k]);
	}
	fclose(file);
	assert_int_equal(read_log(path, "imu9"), 30);
	assert_int_equal(log_.rows.events.skipped, 7);
	assert_true(says("3 rows skipped, the first one: log.imu.csv:5: 3 fields"));
	assert_true(says("3 rows skipped, the first one: log.imu.csv:8: gx is not"));
	assert_true(says("1 row skipped: log.imu.csv:11: time does not increase"));
}

/* ---- units ------------------------------------------------------------------------------------------------------- */

/* The log of a motion without named units; the words of the warning, NULL: there is none. */
static void assert_warns(const char *motion, double rate, double force, double field, const char *word)
{
	struct sensor_config config = *sensor_preset("lsm303dlhc_l3gd20_fine");
	FILE *file = create("log.imu.csv");
	struct sensor sensor;

	sensor_calibrate(&config);
	assert_int_equal(sensor_init(&sensor, &config, 1), 0);
	fputs(HEADER, file);
	for (int k = 0; k < ROWS; k++) {
		struct imu_sample s;

		sensor_next(&sensor, signal_find(motion), &s, NULL);
		fprintf(file, "%.9g", t_s(k));
		values(file, &s, rate, force, field);
		fputc('\n', file);
	}
	fclose(file);
	assert_int_equal(read_log(path, "imu9"), ROWS);
	if (says(word) != (word != NULL))
		fail_msg("%s by %g, %g, %g: does not say '%s'", motion, rate, force, field, word ? word : "nothing");
}

static void test_units_that_the_header_does_not_name_are_recognised_and_told(void **state)
{
	const char *const motions[] = {"square", "rest", "tumble", "turntable", "pendulum", "figure", "roll_step"};

	(void)state;
	for (int i = 0; i < 7; i++) {
		assert_warns(motions[i], 1, 1, 1, NULL);
		assert_warns(motions[i], RAD_PER_DEG, 1, 1, "deg/s");
		assert_warns(motions[i], 1, GRAVITY, 1, "likely in g,");
		assert_warns(motions[i], 1, 1e-3 * GRAVITY, 1, "likely in mg,");
		assert_warns(motions[i], 1, 1, 100, "likely in gauss,");
		assert_warns(motions[i], 1, 1, 0.1, "likely in mG,");
		assert_warns(motions[i], 1, 1, 1e-3, "likely in nT,");
	}
}

static void test_a_unit_that_is_not_known_is_refused_with_those_that_are(void **state)
{
	FILE *file = create("log.imu.csv");
	char error[512];

	(void)state;
	fputs("t,gx[rpm],gy[rpm],gz[rpm],ax,ay,az\n0,0,0,0,0,0,9.8\n", file);
	fclose(file);
	assert_int_equal(imu_log_open(&log_, path, log_format_named("imu9"), error, sizeof error), -EINVAL);
	assert_non_null(strstr(error, ":1: unknown unit of 'gx[rpm]': use"));
	assert_non_null(strstr(error, "deg/s"));
}

/* ---- logs of other programs -------------------------------------------------------------------------------------- */

static void write_text(
	const char *name, const char *header, void (*write)(FILE *file, int k, const struct imu_sample *s))
{
	FILE *file = create(name);

	fputs(header, file);
	for (int k = 0; k < ROWS; k++)
		write(file, k, &truth[k]);
	fclose(file);
}

static void assert_format(const char *where, const char *format, double first_s, double off_s)
{
	int n = read_log(where, format);

	if (n < ROWS - 1)
		fail_msg("%s: %d rows", format, n);
	assert_true_samples(format, n, first_s, off_s);
}

static void write_euroc(FILE *file, int k, const struct imu_sample *s)
{
	fprintf(file, "%lld", 1403636579758555392 + k * 10000000LL); /* ns since 1970, 10 ms apart */
	triad(file, ",", s->gyro_rad_s, 1);
	triad(file, ",", s->accel_m_s2, 1);
	fputc('\n', file);
}

static void write_x_io(FILE *file, int k, const struct imu_sample *s)
{
	fprintf(file, "%.6f", t_s(k));
	values(file, s, RAD_PER_DEG, GRAVITY, 1);
	fprintf(file, ",1013.25\n");
}

static void write_pandas(FILE *file, int k, const struct imu_sample *s)
{
	fprintf(file, "2024-02-29 23:59:%02d.%06d", 40 + k / 100, k % 100 * 10000);
	values(file, s, 1, 1, 1);
	fputc('\n', file);
}

static void write_pandas_delta(FILE *file, int k, const struct imu_sample *s)
{
	fprintf(file, "0 days 00:00:%02d.%06d", k / 100, k % 100 * 10000);
	values(file, s, 1, 1, 1);
	fputc('\n', file);
}

static void write_phyphox(FILE *file, int k, const struct imu_sample *s)
{
	fprintf(file, "%.9E", t_s(k) - 0.07);
	triad(file, ",", s->gyro_rad_s, 1);
	fprintf(file, ",%.9g", vec3_norm(s->gyro_rad_s));
	triad(file, ",", s->accel_m_s2, 1);
	fputc('\n', file);
}

static void test_a_log_of_another_program_is_refused_with_the_name_of_its_format(void **state)
{
	static const char *const headers[][2] = {
		{"euroc",
			"#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],"
			"a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n1,2,3,4,5,6,7\n"},
		{"x-io", "Time (s),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s),Accelerometer X (g),"
			 "Accelerometer Y (g),Accelerometer Z (g)\n"},
		{"pandas", ",gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z\n"},
		{"phyphox", "\"Time (s)\";\"Gyroscope x (rad/s)\";\"Gyroscope y (rad/s)\";\"Gyroscope z (rad/s)\";"
			    "\"Acceleration x (m/s^2)\";\"Acceleration y (m/s^2)\";\"Acceleration z (m/s^2)\"\n"}};

	(void)state;
	for (int i = 0; i < 4; i++) {
		char error[512], words[32];
		FILE *file = create("log.csv");

		fputs(headers[i][1], file);
		fclose(file);
		assert_int_equal(imu_log_open(&log_, path, log_format_at(0), error, sizeof error), -EINVAL);
		snprintf(words, sizeof words, "--format %s", headers[i][0]);
		if (!strstr(error, words))
			fail_msg("'%s' does not say '%s'", error, words);
	}
}

static void write_phyphox_gyro(FILE *file, int k, const struct imu_sample *s)
{
	fprintf(file, "%.9E", t_s(k) - 0.07);
	triad(file, ",", s->gyro_rad_s, 1);
	fprintf(file, ",%.9g\n", vec3_norm(s->gyro_rad_s));
}

static void write_phyphox_accel(FILE *file, int k, const struct imu_sample *s)
{
	fprintf(file, "%.9E", t_s(k) - 0.07);
	triad(file, ",", s->accel_m_s2, 1);
	fputc('\n', file);
}

static void write_phyphox_accel_ms(FILE *file, int k, const struct imu_sample *s)
{
	fprintf(file, "%.9E", 1e3 * (t_s(k) - 0.07));
	triad(file, ",", s->accel_m_s2, 1);
	fputc('\n', file);
}

static void write_phyphox_mag(FILE *file, int k, const struct imu_sample *s)
{
	if (!(s->flags & SAMPLE_MAG))
		return;
	fprintf(file, "%.9E", t_s(k) - 0.07);
	triad(file, ",", s->mag_uT, 1);
	fputc('\n', file);
}

static void test_logs_of_euroc_x_io_pandas_and_phyphox_are_read(void **state)
{
	(void)state;
	for (int k = 0; k < ROWS; k++)
		if (k % 3)
			truth[k].flags &= ~(unsigned)SAMPLE_MAG, truth[k].mag_uT = (struct vec3){0, 0, 0};
	write_text("log.csv",
		"Time (s),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s),Accelerometer X (g),"
		"Accelerometer Y (g),Accelerometer Z (g),Magnetometer X (uT),Magnetometer Y (uT),Magnetometer Z (uT),"
		"Barometer (hPa)\n",
		write_x_io);
	assert_format(path, "x-io", 0, 0);
	write_text("log.csv", ",gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z,mag_x,mag_y,mag_z\n", write_pandas);
	assert_format(path, "pandas", 1709251180, 1e-6);
	write_text("log.csv", "time,gx,gy,gz,ax,ay,az,mx,my,mz\n", write_pandas_delta);
	assert_format(path, "pandas", 0, 0);

	for (int k = 0; k < ROWS; k++)
		truth[k].flags = 0, truth[k].mag_uT = (struct vec3){0, 0, 0};
	write_text("log.csv",
		"#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],"
		"a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n",
		write_euroc);
	assert_format(path, "euroc", 1403636579.758555, 1e-6);
	write_text("log.csv",
		"\"Time (s)\",\"Gyroscope x (rad/s)\",\"Gyroscope y (rad/s)\",\"Gyroscope z (rad/s)\",\"Absolute "
		"(rad/s)\",\"Acceleration x (m/s^2)\",\"Acceleration y (m/s^2)\",\"Acceleration z (m/s^2)\"\n",
		write_phyphox);
	assert_format(path, "phyphox", -0.07, 0);
}

static void assert_folder_is_merged(void)
{
	int n = read_log(folder, "phyphox"), fields = 0, measured = 0;

	assert_in_range(n, ROWS - 1, ROWS);
	for (int k = 0; k < n; k++) {
		assert_int_equal(found[k].t_us, found[0].t_us + 10000 * (uint64_t)k);
		assert_true(close_to(found[k].gyro_rad_s, truth[k].gyro_rad_s, 1e-8));
		assert_true(close_to(found[k].accel_m_s2, truth[k].accel_m_s2, 1e-6));
		fields += !!(found[k].flags & SAMPLE_MAG);
		measured += !!(truth[k].flags & SAMPLE_MAG);
	}
	assert_in_range(fields, measured - 2, measured);
}

static void test_an_exported_folder_of_phyphox_is_merged(void **state)
{
	(void)state;
	write_text("Gyroscope.csv", "\"Time (s)\",\"X (rad/s)\",\"Y (rad/s)\",\"Z (rad/s)\",\"Absolute (rad/s)\"\n",
		write_phyphox_gyro);
	write_text("Accelerometer.csv",
		"\"Time (s)\",\"Acceleration x (m/s^2)\",\"Acceleration y (m/s^2)\",\"Acceleration z (m/s^2)\"\n",
		write_phyphox_accel);
	write_text("Magnetometer.csv",
		"\"Time (s)\",\"Magnetic field x (\u00b5T)\",\"Magnetic field y (\u00b5T)\",\"Magnetic field z "
		"(\u00b5T)\"\n",
		write_phyphox_mag);
	assert_folder_is_merged();
	/* each file may have a time of its own unit */
	write_text("Accelerometer.csv",
		"\"Time (ms)\",\"Acceleration x (m/s^2)\",\"Acceleration y (m/s^2)\",\"Acceleration z (m/s^2)\"\n",
		write_phyphox_accel_ms);
	assert_folder_is_merged();
}

/* The clock begins again with the second log, and is settled after its first burst: 4 s later no millisecond is added,
 * where the clock of the first log would still be following. */
static void test_samples_of_a_second_log_are_even_from_its_second_burst_on(void **state)
{
	FILE *file = create("log.imu.csv");

	(void)state;
	fputs(HEADER, file);
	for (int k = 0; k < ROWS; k++)
		bursts_then_a_second_log(file, k, &truth[k]);
	fclose(file);
	assert_int_equal(read_log(path, "imu9"), ROWS);
	for (int k = ROWS - SECOND + 60; k < ROWS; k++)
		assert_true(llabs((int64_t)(found[k].t_us - found[ROWS - SECOND + 60].t_us) -
				    10000 * (k - (ROWS - SECOND + 60))) < 1000);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_every_kind_of_log_gives_the_samples_that_were_written),
		cmocka_unit_test(test_a_second_log_is_a_discontinuity_and_a_wrap_is_none),
		cmocka_unit_test(test_after_a_gap_bursts_have_the_time_of_their_rows_again),
		cmocka_unit_test(test_a_single_burst_behind_a_gap_was_taken_before_its_rows),
		cmocka_unit_test(test_the_column_clipped_marks_saturation),
		cmocka_unit_test(test_values_that_stay_at_the_end_of_a_usual_range_are_saturated),
		cmocka_unit_test(test_all_of_three_samples_at_the_end_of_a_range_are_saturated),
		cmocka_unit_test(test_every_kind_of_skipped_row_is_told_with_its_count_and_first_line),
		cmocka_unit_test(test_units_that_the_header_does_not_name_are_recognised_and_told),
		cmocka_unit_test(test_a_unit_that_is_not_known_is_refused_with_those_that_are),
		cmocka_unit_test_setup(test_logs_of_euroc_x_io_pandas_and_phyphox_are_read, simulate),
		cmocka_unit_test(test_a_log_of_another_program_is_refused_with_the_name_of_its_format),
		cmocka_unit_test_setup(test_an_exported_folder_of_phyphox_is_merged, simulate),
		cmocka_unit_test(test_samples_of_a_second_log_are_even_from_its_second_burst_on),
	};
	int failed;

	if (!mkdtemp(folder))
		return 1;
	failed = cmocka_run_group_tests(tests, simulate, NULL);
	for (size_t i = 0; i < sizeof FILES / sizeof *FILES; i++) {
		snprintf(path, sizeof path, "%s/%s", folder, FILES[i]);
		unlink(path);
	}
	rmdir(folder);
	return failed;
}
