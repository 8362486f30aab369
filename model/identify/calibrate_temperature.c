#include "model/identify/calibrate_temperature.h"
#include "model/math/units.h"

enum { CHANNELS = 6 };
static const double MIN_REST_S = 20;
/* Over 5 K a typical slope of 0.03 deg/s/K is 15 times the bias instability. A parabola needs a wider span, and must
 * reduce the sum of squares of at least one channel to QUADRATIC_GAIN of the straight line's. */
static const double MIN_SPAN_K = 5, QUADRATIC_SPAN_K = 15, QUADRATIC_GAIN = 0.8;
/* RMS of the blocks: 10 (gyro) and 50 times (accelerometer) the bias instability of the supported chips. */
static const double MAX_RESIDUAL[2] = {0.1 * RAD_PER_DEG, 0.05}; /* rad/s, m/s^2 */

void calibrate_temperature_init(struct calibrate_temperature *c)
{
	*c = (struct calibrate_temperature){.verdict = CALIBRATE_COLLECTING};
	calibrate_rest_init(&c->rest, &CALIBRATE_LYING);
}

static void begin(struct calibrate_temperature *c, const struct calibrate_block *b)
{
	c->started = true;
	c->first_degC = c->lowest_degC = c->highest_degC = b->temperature_degC;
}

static void add_block(struct calibrate_temperature *c, const struct calibrate_block *b)
{
	struct calibrate_temperature_sums *s = &c->now;
	double y[CHANNELS] = {
		b->gyro_rad_s.x, b->gyro_rad_s.y, b->gyro_rad_s.z, b->accel_m_s2.x, b->accel_m_s2.y, b->accel_m_s2.z};
	double t, z[2];

	c->blocks++;
	if (b->temperature_samples == 0)
		return;
	if (!c->started)
		begin(c, b);
	if (s->n == 0)
		for (int i = 0; i < CHANNELS; i++)
			c->origin[i] = y[i];
	t = b->temperature_degC - c->first_degC;
	z[0] = t;
	z[1] = t * t;
	c->lowest_degC = fmin(c->lowest_degC, b->temperature_degC);
	c->highest_degC = fmax(c->highest_degC, b->temperature_degC);
	s->n++;
	c->n++;
	for (int j = 0; j < 2; j++) {
		s->z[j] += z[j];
		c->z_sum[j] += z[j];
	}
	s->zz[0] += z[0] * z[0];
	s->zz[1] += z[0] * z[1];
	s->zz[2] += z[1] * z[1];
	for (int i = 0; i < CHANNELS; i++) {
		double d = y[i] - c->origin[i];

		if (i < 3)
			c->gyro_sum[i] += y[i];
		s->y[i] += d;
		s->yy[i] += d * d;
		s->zy[0][i] += z[0] * d;
		s->zy[1][i] += z[1] * d;
	}
}

/* Adds the squares and products of this rest, about its own means, to those of all rests. */
static void end_rest(struct calibrate_temperature *c)
{
	struct calibrate_temperature_sums *s = &c->now, *all = &c->all;

	if (s->n > 1) {
		c->rests++;
		all->n += s->n;
		all->zz[0] += s->zz[0] - s->z[0] * s->z[0] / s->n;
		all->zz[1] += s->zz[1] - s->z[0] * s->z[1] / s->n;
		all->zz[2] += s->zz[2] - s->z[1] * s->z[1] / s->n;
		for (int i = 0; i < CHANNELS; i++) {
			all->yy[i] += s->yy[i] - s->y[i] * s->y[i] / s->n;
			for (int j = 0; j < 2; j++)
				all->zy[j][i] += s->zy[j][i] - s->z[j] * s->y[i] / s->n;
		}
	}
	*s = (struct calibrate_temperature_sums){0};
}

void calibrate_temperature_step(struct calibrate_temperature *c, const struct imu_sample *raw)
{
	enum calibrate_rest_event event = calibrate_rest_step(&c->rest, raw);

	if (event == CALIBRATE_REST_BLOCK)
		add_block(c, &c->rest.block);
	else if (event == CALIBRATE_REST_ENDED)
		end_rest(c);
}

/* Residual sum of squares of channel i for a straight line; likewise for a parabola below. */
static double line(const struct calibrate_temperature_sums *s, int i, double *slope)
{
	*slope = s->zy[0][i] / s->zz[0];
	return fmax(0, s->yy[i] - *slope * s->zy[0][i]);
}

static double parabola(const struct calibrate_temperature_sums *s, int i, double *slope, double *square)
{
	double det = s->zz[0] * s->zz[2] - s->zz[1] * s->zz[1];

	*slope = (s->zz[2] * s->zy[0][i] - s->zz[1] * s->zy[1][i]) / det;
	*square = (s->zz[0] * s->zy[1][i] - s->zz[1] * s->zy[0][i]) / det;
	return fmax(0, s->yy[i] - *slope * s->zy[0][i] - *square * s->zy[1][i]);
}

static bool parabola_is_better(const struct calibrate_temperature *c)
{
	const struct calibrate_temperature_sums *s = &c->all;
	double slope, square;

	if (c->highest_degC - c->lowest_degC < QUADRATIC_SPAN_K ||
		!(s->zz[0] * s->zz[2] - s->zz[1] * s->zz[1] > 1e-6 * s->zz[0] * s->zz[2]))
		return false;
	for (int i = 0; i < CHANNELS; i++)
		if (parabola(s, i, &slope, &square) < QUADRATIC_GAIN * line(s, i, &slope))
			return true;
	return false;
}

static struct vec3 triad(const double v[3])
{
	return (struct vec3){v[0], v[1], v[2]};
}

/* Slopes are converted from the first temperature to the mean one. False: a residual is too large. */
static bool fit(struct calibrate_temperature *c)
{
	struct calibrate_temperature_result *r = &c->result;
	const struct calibrate_temperature_sums *s = &c->all;
	double slope[CHANNELS], square[CHANNELS] = {0}, rms[CHANNELS], sigma[CHANNELS], gyro[3];
	double t0 = c->z_sum[0] / c->n, rise = c->z_sum[1] / c->n - t0 * t0;
	bool good = true;

	r->quadratic = parabola_is_better(c);
	for (int i = 0; i < CHANNELS; i++) {
		double squares = r->quadratic ? parabola(s, i, &slope[i], &square[i]) : line(s, i, &slope[i]);

		rms[i] = sqrt(squares / (s->n - c->rests - 2));
		sigma[i] = rms[i] / sqrt(s->zz[0]);
		slope[i] += 2 * square[i] * t0;
		good = good && rms[i] <= MAX_RESIDUAL[i / 3];
	}
	for (int i = 0; i < 3; i++)
		gyro[i] = c->gyro_sum[i] / c->n - square[i] * rise;
	r->compensation = (struct temperature_compensation){
		.gyro_slope = triad(slope),
		.accel_slope = triad(slope + 3),
		.gyro_quadratic = triad(square),
		.accel_quadratic = triad(square + 3),
		.reference_degC = c->first_degC + t0,
	};
	r->gyro_residual_rad_s = triad(rms);
	r->accel_residual_m_s2 = triad(rms + 3);
	r->gyro_slope_sigma = triad(sigma);
	r->accel_slope_sigma = triad(sigma + 3);
	r->gyro_rad_s = triad(gyro);
	return good;
}

enum calibrate_verdict calibrate_temperature_finish(struct calibrate_temperature *c)
{
	end_rest(c);
	if (c->blocks * CALIBRATE_BLOCK_S < MIN_REST_S)
		c->verdict = CALIBRATE_MOVED;
	else if (c->all.n * CALIBRATE_BLOCK_S < MIN_REST_S)
		c->verdict = CALIBRATE_NO_TEMPERATURE;
	/* the temperature must change during the rests, not between them */
	else if (c->highest_degC - c->lowest_degC < MIN_SPAN_K || !(sqrt(c->all.zz[0] / c->all.n) > MIN_SPAN_K / 6))
		c->verdict = CALIBRATE_SMALL_TEMPERATURE_SPAN;
	else
		c->verdict = fit(c) ? CALIBRATE_GOOD : CALIBRATE_LARGE_RESIDUAL;
	c->result.lowest_degC = c->lowest_degC;
	c->result.highest_degC = c->highest_degC;
	c->result.rest_s = c->all.n * CALIBRATE_BLOCK_S;
	return c->verdict;
}
