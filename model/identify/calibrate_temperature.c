#include "model/identify/calibrate_temperature.h"
#include "model/math/units.h"

enum { CHANNELS = 6 };
static const double BLOCK_S = 0.25, LEAST_REST_S = 20;
static const double LEAST_SPAN_K = 5, QUADRATIC_SPAN_K = 15;
static const double QUADRATIC_GAIN = 0.8;			 /* of the straight line's sum of squares */
static const double RESIDUAL_MAX[2] = {0.1 * RAD_PER_DEG, 0.05}; /* rad/s, m/s^2 */

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

static void block(struct calibrate_temperature *c, const struct calibrate_block *b)
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

/* Adds this rest's squares and products about its own means to those of all. */
static void rest_over(struct calibrate_temperature *c)
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
	switch (calibrate_rest_step(&c->rest, raw)) {
	case CALIBRATE_REST_BLOCK:
		block(c, &c->rest.block);
		break;
	case CALIBRATE_REST_ENDED:
		rest_over(c);
		break;
	case CALIBRATE_REST_NOTHING:
		break;
	}
}

/* Sums of squares that a straight line leaves, and a parabola with its two coefficients. */
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

static bool quadratic(const struct calibrate_temperature *c)
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

/* Slopes about the first temperature become slopes about the mean one. */
static bool fit(struct calibrate_temperature *c)
{
	struct calibrate_temperature_result *r = &c->result;
	const struct calibrate_temperature_sums *s = &c->all;
	double slope[CHANNELS], square[CHANNELS] = {0}, rms[CHANNELS], sigma[CHANNELS], gyro[3];
	double t0 = c->z_sum[0] / c->n, rise = c->z_sum[1] / c->n - t0 * t0;
	bool good = true;

	r->quadratic = quadratic(c);
	for (int i = 0; i < CHANNELS; i++) {
		double left = r->quadratic ? parabola(s, i, &slope[i], &square[i]) : line(s, i, &slope[i]);

		rms[i] = sqrt(left / (s->n - c->rests - 2));
		sigma[i] = rms[i] / sqrt(s->zz[0]);
		slope[i] += 2 * square[i] * t0;
		good = good && rms[i] <= RESIDUAL_MAX[i / 3];
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
	rest_over(c);
	if (c->blocks * BLOCK_S < LEAST_REST_S)
		c->verdict = CALIBRATE_MOVED;
	else if (c->all.n * BLOCK_S < LEAST_REST_S)
		c->verdict = CALIBRATE_NO_TEMPERATURE;
	/* the span must lie inside the rests, not between them */
	else if (c->highest_degC - c->lowest_degC < LEAST_SPAN_K || !(sqrt(c->all.zz[0] / c->all.n) > LEAST_SPAN_K / 6))
		c->verdict = CALIBRATE_SMALL_TEMPERATURE_SPAN;
	else
		c->verdict = fit(c) ? CALIBRATE_GOOD : CALIBRATE_LARGE_RESIDUAL;
	c->result.lowest_degC = c->lowest_degC;
	c->result.highest_degC = c->highest_degC;
	c->result.rest_s = c->all.n * BLOCK_S;
	return c->verdict;
}
