#include "model/identify/calibrate_gyro.h"
#include "model/math/units.h"

/* 20 blocks: enough for the standard deviation of their mean. */
static const double MIN_REST_S = 5;
/* Rotation at which a rest is refused, as the rate of change of the measured vector: 0.005 / 9.81 rad/s = 0.03 deg/s of
 * tilt, 0.03 uT/s / 20 uT (horizontal field) = 0.1 deg/s about the vertical. Noise is allowed for in addition. */
static const double GRAVITY_DRIFT_M_S3 = 0.005, FIELD_DRIFT_UT_S = 0.03;
/* Zero-rate levels of the supported chips are specified below 75 deg/s at their coarsest range. */
static const double MAX_BIAS_RAD_S = 100 * RAD_PER_DEG;

const struct calibrate_gyro_config CALIBRATE_GYRO_DEFAULTS = {10, 60, 0.01 * RAD_PER_DEG};

void calibrate_gyro_init(struct calibrate_gyro *c, const struct calibrate_gyro_config *config)
{
	*c = (struct calibrate_gyro){.config = *config};
	calibrate_rest_init(&c->rest, &CALIBRATE_LYING);
}

static struct vec3 multiply(struct vec3 a, struct vec3 b)
{
	return (struct vec3){a.x * b.x, a.y * b.y, a.z * b.z};
}

static void add_to_line(struct calibrate_gyro_line *l, double t, struct vec3 v)
{
	if (l->n == 0)
		l->first = v;
	v = vec3_sub(v, l->first);
	l->n++;
	l->t += t;
	l->tt += t * t;
	l->v = vec3_add(l->v, v);
	l->tv = vec3_add(l->tv, vec3_scale(t, v));
	l->vv += vec3_dot(v, v);
}

static void add(struct calibrate_gyro_sums *s, const struct calibrate_block *b)
{
	double t = s->blocks * CALIBRATE_BLOCK_S;

	if (s->blocks == 0)
		s->first = b->gyro_rad_s;
	struct vec3 gyro = vec3_sub(b->gyro_rad_s, s->first);
	s->blocks++;
	s->gyro = vec3_add(s->gyro, gyro);
	s->gyro_squares = vec3_add(s->gyro_squares, multiply(gyro, gyro));
	add_to_line(&s->accel, t, b->accel_m_s2);
	if (b->mag_samples)
		add_to_line(&s->mag, t, b->mag_uT);
	if (b->temperature_samples) {
		s->temperature_blocks++;
		s->temperature_degC += b->temperature_degC;
	}
}

/* The slope of the line through the values over time exceeds `limit` by more than 3 sigma. */
static bool drifts(const struct calibrate_gyro_line *l, double limit)
{
	double n = l->n, variance = l->tt - l->t * l->t / n;
	struct vec3 product = vec3_sub(l->tv, vec3_scale(l->t / n, l->v));
	double scatter = l->vv - vec3_dot(l->v, l->v) / n, slope;

	if (!(variance > 0) || n < 3)
		return false;
	slope = vec3_norm(product) / variance;
	scatter = fmax(0, scatter - slope * slope * variance) / (n - 2);
	return slope > limit + 3 * sqrt(scatter / variance);
}

static double sigma(double sum, double squares, unsigned n, double instability)
{
	double variance = fmax(0, squares - sum * sum / n) / (n - 1), drift = CALIBRATE_DRIFT * instability;

	return sqrt(variance / n + drift * drift);
}

static enum calibrate_verdict judge(struct calibrate_gyro *c, const struct calibrate_gyro_sums *s)
{
	const unsigned n = s->blocks;
	const double instability = c->config.bias_instability_rad_s;

	if (n * CALIBRATE_BLOCK_S < MIN_REST_S)
		return CALIBRATE_MOVED;
	c->result = (struct calibrate_gyro_result){
		.bias_rad_s = vec3_add(s->first, vec3_scale(1.0 / n, s->gyro)),
		.sigma_rad_s = {sigma(s->gyro.x, s->gyro_squares.x, n, instability),
			sigma(s->gyro.y, s->gyro_squares.y, n, instability),
			sigma(s->gyro.z, s->gyro_squares.z, n, instability)},
		.rest_s = n * CALIBRATE_BLOCK_S,
		.temperature_degC = s->temperature_blocks ? s->temperature_degC / s->temperature_blocks : (double)NAN,
	};
	if (drifts(&s->accel, GRAVITY_DRIFT_M_S3) || drifts(&s->mag, FIELD_DRIFT_UT_S))
		return CALIBRATE_TURNED;
	if (vec3_norm(c->result.bias_rad_s) > MAX_BIAS_RAD_S)
		return CALIBRATE_IMPLAUSIBLE;
	return CALIBRATE_GOOD;
}

static void end_rest(struct calibrate_gyro *c)
{
	if (c->now.blocks > c->longest.blocks)
		c->longest = c->now;
	c->now = (struct calibrate_gyro_sums){0};
}

enum calibrate_verdict calibrate_gyro_step(struct calibrate_gyro *c, const struct imu_sample *raw)
{
	enum calibrate_rest_event event;

	if (c->verdict != CALIBRATE_COLLECTING)
		return c->verdict;
	event = calibrate_rest_step(&c->rest, raw);
	if (event == CALIBRATE_REST_BLOCK)
		add(&c->now, &c->rest.block);
	else if (event == CALIBRATE_REST_ENDED)
		end_rest(c);
	if (c->now.blocks * CALIBRATE_BLOCK_S >= c->config.rest_s)
		c->verdict = judge(c, &c->now);
	else if (calibrate_rest_time_s(&c->rest) > c->config.patience_s)
		c->verdict = CALIBRATE_MOVED;
	return c->verdict;
}

enum calibrate_verdict calibrate_gyro_finish(struct calibrate_gyro *c)
{
	if (c->verdict != CALIBRATE_COLLECTING)
		return c->verdict;
	end_rest(c);
	c->verdict = judge(c, &c->longest);
	return c->verdict;
}

double calibrate_gyro_progress(const struct calibrate_gyro *c)
{
	if (c->verdict != CALIBRATE_COLLECTING)
		return 1;
	return fmin(1, c->now.blocks * CALIBRATE_BLOCK_S / c->config.rest_s);
}
