/* Logs with the times and units that programs and people write, read and compared with what was read when the trace was
 * written (trace.h): times, values, messages, errors. What a log means is for test_imu_log*.c and test_log_*.c to
 * say. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "drivers/imu/imu_log.h"
#include "model/math/units.h"
#include "model/sim/sensor.h"
#include "tests/unit/trace.h"

#define HEADER "t,gx,gy,gz,ax,ay,az,mx,my,mz"

/* Where 0 is said, it is the default. */
struct kind {
	const char *name;
	double rate_hz; /* 100 */
	int rows;	/* 1200 */
	double jitter;	/* share of the interval */
	int burst;	/* rows that have the time of the transfer, 0.2 ms apart */
	int lose_each;	/* each n-th row is missing */
	double start_s;
	int event, event_rows; /* from this row on, for so many (0: for good), the time is another one: */
	double event_s;	       /* by so much */
	double wrap_s;	       /* the time is the remainder of this */
	double unit_s;	       /* 1 */
	double gyro, accel, mag;
	double gyro_end, accel_end; /* no number is larger */
	int resolution;		    /* digits behind the point, 6 */
	bool every_mag, without_mag;
	const char *header;   /* HEADER */
	const char *preamble; /* lines before it */
	int format;
};

static const struct kind KINDS[] = {
	{"plain", .resolution = 4},
	{"25 Hz", .rate_hz = 25},
	{"1000 Hz", .rate_hz = 1000},
	{"7 Hz", .rate_hz = 7, .rows = 300},
	{"2 Hz", .rate_hz = 2, .rows = 100},
	{"an epoch", .start_s = 1.7e9, .resolution = 3},
	{"below zero", .start_s = -5},
	{"jitter of a tenth", .jitter = 0.1},
	{"jitter of a third", .jitter = 0.33},
	{"jitter of half", .jitter = 0.5},
	{"bursts of 2", .burst = 2},
	{"bursts of 4", .burst = 4, .jitter = 0.05},
	{"bursts of 10", .burst = 10, .jitter = 0.1},
	{"bursts of 50", .burst = 50},
	{"bursts of 150", .burst = 150},
	{"bursts of 250", .burst = 250},
	{"bursts of 20 at 1000 Hz", .burst = 20, .rate_hz = 1000, .rows = 3000},
	{"bursts of 8, a gap of 1.9 s", .burst = 8, .event = 600, .event_s = 1.9},
	{"bursts of 8, a gap of 2.3 s", .burst = 8, .event = 600, .event_s = 2.3},
	{"bursts of 8, a gap of 60 s", .burst = 8, .event = 600, .event_s = 60},
	{"bursts of 8, one row at another time", .burst = 8, .event = 601, .event_rows = 1, .event_s = 90},
	{"bursts of 8, back to the start", .burst = 8, .event = 600, .event_s = -6},
	{"each fifth is missing", .lose_each = 5},
	{"each second is missing", .lose_each = 2},
	{"each 40th is missing, in bursts", .lose_each = 40, .burst = 6},
	{"a gap of 0.02 s", .event = 500, .event_s = 0.02},
	{"a gap of 0.4 s", .event = 500, .event_s = 0.4},
	{"a gap of 15 s", .event = 500, .event_s = 15},
	{"a gap of an hour", .event = 500, .event_s = 3600},
	{"one row ahead by 0.02 s", .event = 500, .event_rows = 1, .event_s = 0.0205},
	{"one row ahead by 3 s", .event = 500, .event_rows = 1, .event_s = 3},
	{"three rows ahead by 30 s", .event = 500, .event_rows = 3, .event_s = 30},
	{"20 rows ahead by 30 s", .event = 500, .event_rows = 20, .event_s = 30},
	{"the first row ahead", .event = 0, .event_rows = 1, .event_s = 30},
	{"the last row ahead by 9 s", .event = 1199, .event_rows = 1, .event_s = 9},
	{"the last row ahead by 11 s", .event = 1199, .event_rows = 1, .event_s = 11},
	{"one row back by 0.005 s", .event = 500, .event_rows = 1, .event_s = -0.015},
	{"one row back by 3 s", .event = 500, .event_rows = 1, .event_s = -3},
	{"back by 1 s for good", .event = 500, .event_s = -1},
	{"back to the start", .event = 500, .event_s = -5},
	{"a wrap at 4 s", .wrap_s = 4},
	{"a wrap at 2^16 ms", .wrap_s = 65.536, .start_s = 60, .unit_s = 1e-3, .resolution = 3},
	{"a wrap at 2^32 us", .wrap_s = 4294.967296, .start_s = 4290, .unit_s = 1e-6, .resolution = 1},
	{"ms", .unit_s = 1e-3, .resolution = 3},
	{"ms at 5 Hz", .rate_hz = 5, .rows = 200, .unit_s = 1e-3, .resolution = 1},
	{"us", .unit_s = 1e-6, .resolution = 1},
	{"ns", .unit_s = 1e-9, .resolution = 1},
	{"whole ms as s", .resolution = 3, .rate_hz = 400},
	{"tens of ms", .resolution = 2, .rate_hz = 100},
	{"deg/s without a name", .gyro = RAD_PER_DEG},
	{"mdps without a name", .gyro = 1e-3 * RAD_PER_DEG},
	{"g without a name", .accel = STANDARD_GRAVITY_M_S2},
	{"mg without a name", .accel = 1e-3 * STANDARD_GRAVITY_M_S2},
	{"gauss without a name", .mag = 100},
	{"mG without a name", .mag = 0.1},
	{"nT without a name", .mag = 1e-3},
	{"a weak field", .mag = 3},
	{"accelerometer half as strong", .accel = 1.8},
	{"accelerometer twice as strong", .accel = 0.6},
	{"small rates", .gyro = 40},
	{"rates end at 125 deg/s", .gyro_end = 125 * RAD_PER_DEG},
	{"rates end at 250 deg/s", .gyro = 0.4, .gyro_end = 249.98 * RAD_PER_DEG},
	{"rates end at 245 deg/s", .gyro = 0.4, .gyro_end = 245 * RAD_PER_DEG},
	{"rates end at 260 deg/s", .gyro = 0.4, .gyro_end = 260 * RAD_PER_DEG},
	{"deg/s end at 125", .gyro = RAD_PER_DEG, .gyro_end = 125, .header = "t,gx[deg/s],gy,gz,ax,ay,az,mx,my,mz"},
	{"forces end at 2 g", .accel = 0.4, .accel_end = 2 * STANDARD_GRAVITY_M_S2},
	{"forces end at 4 g, nearly", .accel = 0.2, .accel_end = 3.998 * STANDARD_GRAVITY_M_S2},
	{"forces end at 3 g", .accel = 0.25, .accel_end = 3 * STANDARD_GRAVITY_M_S2},
	{"both end", .gyro_end = 125 * RAD_PER_DEG, .accel = 0.4, .accel_end = 2 * STANDARD_GRAVITY_M_S2,
		.lose_each = 3},
	{"tabs", .header = "t\tgx\tgy\tgz\tax\tay\taz\tmx\tmy\tmz"},
	{"tabs and a comma", .header = "t\tgx\tgy\tgz\tax\tay\taz\tmx\tmy\tmz\ta,b"},
	{"units named", .gyro = RAD_PER_DEG, .accel = STANDARD_GRAVITY_M_S2, .mag = 100, .unit_s = 1e-3,
		.header = "t[ms],gx[deg/s],gy,gz,ax[g],ay[g],az[g],mx (gauss),my,mz"},
	{"units named otherwise", .gyro = 1e-3 * RAD_PER_DEG, .accel = 1e-3 * STANDARD_GRAVITY_M_S2, .mag = 1e-3,
		.unit_s = 1e-9, .resolution = 1,
		.header = "T (ns);GX_mdps;gy_mdps;gz_mdps;AX_mg;ay_mg;az_mg;mx_nT;my_nT;mz_nT"},
	{"an unknown unit", .header = "t,gx[rpm],gy,gz,ax,ay,az,mx,my,mz"},
	{"no time", .header = "x,gx,gy,gz,ax,ay,az,mx,my,mz"},
	{"a column twice", .header = "t,gx,gy,gz,ax,ay,az,mx,my,gx"},
	{"the time twice", .header = "t,t,gy,gz,ax,ay,az,mx,my,gx"},
	{"two magnetometer axes", .header = "t,gx,gy,gz,ax,ay,az,mx,my,other"},
	{"without a magnetometer", .without_mag = true, .header = "t,gx,gy,gz,ax,ay,az"},
	{"magnetometer always", .every_mag = true},
	{"uncalibrated", .preamble = "# uncalibrated: 5\n# a comment\n"},
	{"pandas", .format = 4, .header = ",gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z,mag_x,mag_y,mag_z"},
	{"euroc", .format = 2, .unit_s = 1e-9, .resolution = 1,
		.header =
			"#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],"
			"a_RS_S_y [m s^-2],a_RS_S_z [m s^-2],m_RS_S_x,m_RS_S_y,m_RS_S_z"},
	{"x-io", .format = 3, .gyro = RAD_PER_DEG, .accel = STANDARD_GRAVITY_M_S2,
		.header = "Time (s),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s),Accelerometer X (g),"
			  "Accelerometer Y (g),Accelerometer Z (g),Magnetometer X,Magnetometer Y,Magnetometer Z"},
};

/* ---- the log ----------------------------------------------------------------------------------------------------- */

static double or_default(double value, double otherwise)
{
	return value != 0 ? value : otherwise;
}

static double time_of(const struct kind *k, int row, struct rng *rng)
{
	double interval_s = 1 / or_default(k->rate_hz, 100), t_s = k->start_s + row * interval_s;

	if (k->burst > 0) /* all at the last one's time */
		t_s = k->start_s + (row / k->burst + 1) * k->burst * interval_s + row % k->burst * 2e-4;
	t_s += k->jitter * interval_s * (2 * rng_uniform(rng) - 1);
	if (k->event_s != 0 && row >= k->event && (k->event_rows == 0 || row < k->event + k->event_rows))
		t_s += k->event_s;
	return k->wrap_s > 0 ? fmod(t_s, k->wrap_s) : t_s;
}

static void put_vec(FILE *file, char separator, struct vec3 v, double unit, double end)
{
	const double values[] = {v.x / unit, v.y / unit, v.z / unit};

	for (int i = 0; i < 3; i++)
		fprintf(file, "%c%.7g", separator, end > 0 ? fmax(-end, fmin(end, values[i])) : values[i]);
}

static void put_log(FILE *file, const struct kind *k)
{
	struct sensor_config config = *sensor_preset("lsm303dlhc_l3gd20_fine");
	const char *header = k->header ? k->header : HEADER;
	char separator = strchr(header, ';') ? ';' : strchr(header, '\t') ? '\t' : ',';
	int rows = k->rows > 0 ? k->rows : 1200;
	struct sensor sensor;
	struct rng rng;

	sensor_calibrate(&config);
	config.rate_hz = or_default(k->rate_hz, 100);
	config.mag_rate_hz = k->every_mag ? 0 : 0.75 * config.rate_hz;
	assert_int_equal(sensor_init(&sensor, &config, 3), 0);
	rng_init(&rng, 5);
	fprintf(file, "%s%s\n", k->preamble ? k->preamble : "", header);
	for (int row = 0; row < rows; row++) {
		double t_s = time_of(k, row, &rng);
		struct imu_sample s;

		sensor_next(&sensor, signal_find("tumble"), &s, NULL);
		if (k->lose_each > 0 && row % k->lose_each == k->lose_each - 1)
			continue;
		fprintf(file, "%.*f", k->resolution > 0 ? k->resolution : 6, t_s / or_default(k->unit_s, 1));
		put_vec(file, separator, s.gyro_rad_s, or_default(k->gyro, 1), k->gyro_end);
		put_vec(file, separator, s.accel_m_s2, or_default(k->accel, 1), k->accel_end);
		if (s.flags & SAMPLE_MAG && !k->without_mag)
			put_vec(file, separator, s.mag_uT, or_default(k->mag, 1), 0);
		else if (!k->without_mag)
			fprintf(file, "%c%c%c", separator, separator, separator);
		fputc('\n', file);
	}
}

/* ---- what is read ------------------------------------------------------------------------------------------------ */

static void trace_samples(struct imu_log *log)
{
	struct vec3 gyro = {0, 0, 0}, accel = gyro, mag = gyro;
	double least_us = INFINITY, most_us = 0, square = 0, first_us = 0, last_us = 0;
	int n = 0, mags = 0, jumps = 0, saturated = 0;
	struct imu_sample s;

	for (; imu_log_next(log, &s) == 1; n++) {
		double t_us = (double)s.t_us;

		if (n > 0) {
			least_us = fmin(least_us, t_us - last_us);
			most_us = fmax(most_us, t_us - last_us);
			square += (t_us - last_us) * (t_us - last_us);
		}
		first_us = n ? first_us : t_us;
		last_us = t_us;
		gyro = vec3_add(gyro, s.gyro_rad_s);
		accel = vec3_add(accel, s.accel_m_s2);
		mag = vec3_add(mag, s.mag_uT);
		mags += (s.flags & SAMPLE_MAG) != 0;
		jumps += (s.flags & SAMPLE_DISCONTINUITY) != 0;
		saturated += (s.flags & SAMPLE_SATURATED) != 0;
	}
	trace_value("samples", n, 0);
	trace_value("first_us", first_us, 0);
	trace_value("last_us", last_us, 0);
	trace_value("least_us", least_us, 0);
	trace_value("most_us", most_us, 0);
	trace_value("rms_us", sqrt(square / n), 1e-3);
	trace_vec("gyro_rad_s", vec3_scale(1.0 / n, gyro), 1e-8);
	trace_vec("accel_m_s2", vec3_scale(1.0 / n, accel), 1e-7);
	trace_vec("mag_uT", vec3_scale(1.0 / n, mag), 1e-7);
	trace_value("mags", mags, 0);
	trace_value("jumps", jumps, 0);
	trace_value("saturated", saturated, 0);
}

static void trace_messages(const struct imu_log *log)
{
	char text[201];

	for (int i = 0; imu_log_message(log, i, text, sizeof text); i++)
		trace_text("message", text);
}

static void test_kind(void **state)
{
	const struct kind *kind = *state;
	int memory = memfd_create("log", 0), fd = dup2(memory, 100); /* the number is in messages */
	FILE *file = fdopen(fd, "w+");
	static struct imu_log log;
	char path[32], error[256] = "";
	int result;

	assert_non_null(file);
	put_log(file, kind);
	fflush(file);
	snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
	trace_block(kind->name);
	result = imu_log_open(&log, path, log_format_at(kind->format), error, sizeof error);
	trace_value("result", result, 0);
	if (result < 0) {
		error[200] = 0;
		trace_text("error", error);
	} else {
		trace_value("rate_hz", log.rate_hz, 1e-6);
		trace_value("origin_us", (double)log.origin_us, 0);
		trace_value("uncalibrated", imu_log_uncalibrated(&log), 0);
		trace_samples(&log);
		trace_messages(&log);
		imu_log_close(&log);
	}
	fclose(file);
	close(memory);
	trace_check();
}

int main(void)
{
	enum { COUNT = sizeof KINDS / sizeof *KINDS };
	struct CMUnitTest tests[COUNT + 1];

	for (int i = 0; i < COUNT; i++)
		tests[i] = (struct CMUnitTest){KINDS[i].name, test_kind, NULL, NULL, (void *)&KINDS[i]};
	return trace_run("logs", tests, COUNT);
}
