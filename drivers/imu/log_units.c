#include "drivers/imu/log_units.h"

#include <math.h>
#include <stdio.h>

#include "model/math/units.h"

struct band {
	double low, high;
	const char *unit; /* that of the log, if most values are here; NULL: as it should be */
};

/* Magnitude of the force in each unit: that of gravity, within a factor of about 2.5. */
static const struct band FORCE[LOG_UNITS_BANDS] = {
	{3.9, 25, NULL}, {0.4, 2.5, "g"}, {400, 2500, "mg"}, {0, 0.4, "other units"}, {2500, INFINITY, "digits"}};
/* Of the field: that of the earth is 22 to 67 uT; in uT with the iron of a robot. */
static const struct band FIELD[LOG_UNITS_BANDS] = {
	{5, 190, NULL}, {0.15, 1.2, "gauss"}, {190, 1000, "mG"}, {1.5e4, 1.2e5, "nT"}, {1e-5, 1.2e-4, "T"}};
/* s, of a window over which gravity is compared. By judgement: it turns well above its noise in a movement. */
static const double WINDOW_S = 0.2, GAP_S = 0.5;
/* Mean square of the direction's change in a window from which the rates can be told (1.1 degrees). By judgement: it is
 * well above the noise of an accelerometer. */
static const double MOVED = 0.02 * 0.02;
enum { WINDOWS_LEAST = 10, STEPS_LEAST = 100 };
/* rad/s: no gyro measures more (4000 deg/s). */
static const double RATE_MOST = 70;
/* rad/s, RMS of a sample at rest: that of usual chips is below it in rad/s (1.7 deg/s), and above it in deg/s. Share of
 * gravity, RMS of the axes: that of the accelerometer is below it at rest. */
static const double NOISE_RATE = 0.03, NOISE_FORCE = 0.01;

static void count(const struct band bands[LOG_UNITS_BANDS], double value, unsigned in[LOG_UNITS_BANDS])
{
	for (int i = 0; i < LOG_UNITS_BANDS; i++)
		in[i] += value >= bands[i].low && value < bands[i].high;
}

/* v turned by the rotation vector (Rodrigues' formula). */
static struct vec3 turn(struct vec3 v, struct vec3 by)
{
	double angle = vec3_norm(by);
	struct vec3 k = vec3_scale(angle > 0 ? 1 / angle : 0, by);

	return vec3_add(vec3_add(vec3_scale(cos(angle), v), vec3_scale(sin(angle), vec3_cross(k, v))),
		vec3_scale((1 - cos(angle)) * vec3_dot(k, v), k));
}

static double distance2(struct vec3 a, struct vec3 b)
{
	struct vec3 d = vec3_sub(a, b);

	return vec3_dot(d, d);
}

/* What stands still turns against the rate in the sensor's axes. */
static void add_rate(struct log_units *u, const struct imu_sample *s, double dt_s)
{
	double norm = vec3_norm(s->accel_m_s2);
	struct vec3 up = vec3_scale(norm > 0 ? 1 / norm : 0, s->accel_m_s2);

	if (u->forces > 1 && dt_s < GAP_S) {
		u->turned_rad = turn(u->turned_rad, vec3_scale(-dt_s, s->gyro_rad_s));
		u->turned_deg = turn(u->turned_deg, vec3_scale(-dt_s * RAD_PER_DEG, s->gyro_rad_s));
		u->gyro_steps += distance2(s->gyro_rad_s, u->last.gyro_rad_s);
		u->accel_steps += distance2(s->accel_m_s2, u->last.accel_m_s2);
		u->accel_squares += norm * norm;
		u->steps++;
		u->window_s += dt_s;
		if (u->window_s < WINDOW_S)
			return;
		u->off_rad += distance2(up, u->turned_rad);
		u->off_deg += distance2(up, u->turned_deg);
		u->moved += distance2(up, u->start);
		u->windows++;
	}
	u->window_s = 0;
	u->start = u->turned_rad = u->turned_deg = up;
}

static double largest(struct vec3 v)
{
	return fmax(fabs(v.x), fmax(fabs(v.y), fabs(v.z)));
}

void log_units_add(struct log_units *u, const struct imu_sample *s)
{
	u->forces++;
	count(FORCE, vec3_norm(s->accel_m_s2), u->force_in);
	if (s->flags & SAMPLE_MAG) {
		u->fields++;
		count(FIELD, vec3_norm(s->mag_uT), u->field_in);
	}
	u->gyro_most_rad_s = fmax(u->gyro_most_rad_s, largest(s->gyro_rad_s));
	u->accel_most_m_s2 = fmax(u->accel_most_m_s2, largest(s->accel_m_s2));
	add_rate(u, s, (double)(s->t_us - u->last.t_us) * 1e-6);
	u->last = *s;
}

static const char *unit_of(const struct band bands[LOG_UNITS_BANDS], const unsigned in[LOG_UNITS_BANDS], unsigned all)
{
	for (int i = 0; i < LOG_UNITS_BANDS; i++)
		if (2 * in[i] > all)
			return bands[i].unit;
	return NULL;
}

static bool rate_in_degrees(const struct log_units *u)
{
	double noise_rate = sqrt(u->gyro_steps / (6.0 * u->steps)),
	       noise_force = sqrt(u->accel_steps / (6 * u->accel_squares));

	if (u->windows >= WINDOWS_LEAST && u->moved > MOVED * u->windows)
		return u->off_deg < 0.5 * u->moved && u->off_deg < 0.1 * u->off_rad;
	return u->steps >= STEPS_LEAST && noise_rate > NOISE_RATE && noise_force < NOISE_FORCE;
}

bool log_units_warning(const struct log_units *u, int i, char *text, size_t size)
{
	const char *unit;

	switch (i) {
	case 0:
		if (rate_in_degrees(u))
			snprintf(text, size, "the rates are likely in deg/s, not rad/s: name the unit, gx[deg/s]");
		else if (u->gyro_most_rad_s > RATE_MOST)
			snprintf(text, size,
				"rates up to %.3g rad/s are beyond any gyro: are they in deg/s? Name the unit, "
				"gx[deg/s]",
				u->gyro_most_rad_s);
		else
			return false;
		return true;
	case 1:
		unit = unit_of(FORCE, u->force_in, u->forces);
		if (unit)
			snprintf(text, size, "the forces are likely in %s, not m/s^2: name the unit, ax[g] or ax[mg]",
				unit);
		return unit;
	case 2:
		unit = unit_of(FIELD, u->field_in, u->fields);
		if (unit)
			snprintf(text, size, "the fields are likely in %s, not uT: name the unit, mx[%s]", unit, unit);
		return unit;
	default:
		return false;
	}
}

/* Ends of the ranges of usual chips, as nominal and as 32767 digits: deg/s and g. */
static const double GYRO_ENDS[] = {124.88, 125, 125.07, 245, 249.75, 250, 250.13, 286.71, 499.5, 500, 500.26, 573.42,
	998.99, 1000, 1146.8, 1997.99, 2000, 2293.7, 4000};
static const double ACCEL_ENDS[] = {1.9988, 2, 3.9976, 4, 7.9952, 8, 15.99, 16, 24, 32};
/* Share by which a printed value differs from them. */
static const double PRINTED = 3e-4;

static bool at_end(double value, double unit, const double *ends, size_t count)
{
	for (size_t i = 0; i < count; i++)
		if (fabs(fabs(value) - ends[i] * unit) < PRINTED * ends[i] * unit)
			return true;
	return false;
}

static double axis_of(const struct imu_sample *s, int axis)
{
	const double values[] = {
		s->gyro_rad_s.x, s->gyro_rad_s.y, s->gyro_rad_s.z, s->accel_m_s2.x, s->accel_m_s2.y, s->accel_m_s2.z};

	return values[axis];
}

/* Three samples in a row have the same value, one of them the middle one of the five. */
static bool stays(const struct imu_sample *const five[5], int axis)
{
	for (int i = 0; i < 3; i++)
		if (five[i] && five[i + 1] && five[i + 2] && axis_of(five[i], axis) == axis_of(five[i + 1], axis) &&
			axis_of(five[i], axis) == axis_of(five[i + 2], axis))
			return true;
	return false;
}

bool log_units_clipped(const struct log_units *u, const struct imu_sample *const five[5])
{
	for (int axis = 0; axis < 6; axis++) {
		double value = axis_of(five[2], axis);

		if (axis < 3 ? fabs(value) < u->gyro_most_rad_s ||
					!at_end(value, RAD_PER_DEG, GYRO_ENDS, sizeof GYRO_ENDS / sizeof *GYRO_ENDS)
			     : fabs(value) < u->accel_most_m_s2 || !at_end(value, STANDARD_GRAVITY_M_S2, ACCEL_ENDS,
									   sizeof ACCEL_ENDS / sizeof *ACCEL_ENDS))
			continue;
		if (stays(five, axis))
			return true;
	}
	return false;
}
