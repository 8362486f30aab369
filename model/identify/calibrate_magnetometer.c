#include "model/identify/calibrate_magnetometer.h"

#include "model/identify/ellipsoid.h"

static const double SPACING_UT = 2, WIDER = 1.3;
static const double COVERAGE_HOPELESS = 0.2;			 /* of the first guess: not worth a fit */
static const double COVERAGE_LEAST = 0.4, COVERAGE_WANTED = 0.6; /* to take it; to end by itself */
static const double RESIDUAL_MAX = 0.05;			 /* of the field */
static const double STRETCH_MAX = 2.5;			   /* longest by shortest axis: soft iron stays below 1.5 */
static const double FIELD_MIN_UT = 10, FIELD_MAX_UT = 150; /* the Earth's has 22 to 67 */
static const double RANGE_MAX_UT = 1e6;			   /* of any magnetometer, and then some */
static const double SPIKE_UT = 10;			   /* off the two samples beside it */
static const double RADIUS_UT = 50;			   /* of the fit; the scale comes after it */
static const uint64_t LOOK_US = 1000000, NO_MAG_US = 5000000, GAP_US = 500000;
enum { POINTS_LEAST = 30 };

void calibrate_magnetometer_init(struct calibrate_magnetometer *c, const struct calibrate_magnetometer_config *config)
{
	*c = (struct calibrate_magnetometer){.config = *config, .spacing_uT = SPACING_UT};
}

double calibrate_magnetometer_progress(const struct calibrate_magnetometer *c)
{
	return c->verdict != CALIBRATE_COLLECTING ? 1 : fmin(1, c->coverage / COVERAGE_WANTED);
}

/* ---- the points -------------------------------------------------------------------------------------------------- */

static bool near_a_point(const struct calibrate_magnetometer *c, int count, struct vec3 p)
{
	const double least = c->spacing_uT * c->spacing_uT;

	for (int i = 0; i < count; i++) {
		struct vec3 d = vec3_sub(p, c->points[i]);

		if (vec3_dot(d, d) < least)
			return true;
	}
	return false;
}

static void thin_out(struct calibrate_magnetometer *c)
{
	int kept = 0;

	c->spacing_uT *= WIDER;
	for (int i = 0; i < c->count; i++)
		if (!near_a_point(c, kept, c->points[i]))
			c->points[kept++] = c->points[i];
	c->count = kept;
}

static void keep(struct calibrate_magnetometer *c, struct vec3 p)
{
	if (!(vec3_norm(p) <= RANGE_MAX_UT) || near_a_point(c, c->count, p)) /* nor NaN */
		return;
	while (c->count == CALIBRATE_POINTS_MAX)
		thin_out(c);
	c->points[c->count++] = p;
}

static bool spike(struct vec3 before, struct vec3 p, struct vec3 after)
{
	struct vec3 half_way = vec3_scale(0.5, vec3_add(before, after));

	return vec3_norm(vec3_sub(p, half_way)) > SPIKE_UT + 0.5 * vec3_norm(vec3_sub(after, before));
}

/* A single wrong sample lies far from all others: evenly spaced points would keep it, whatever their number. Each waits
 * for the one after it. */
static void take(struct calibrate_magnetometer *c, struct vec3 p)
{
	if (c->recent_count == 2 && !spike(c->recent[0], c->recent[1], p))
		keep(c, c->recent[1]);
	c->recent[0] = c->recent[1];
	c->recent[1] = p;
	if (c->recent_count < 2)
		c->recent_count++;
}

/* ---- the answer -------------------------------------------------------------------------------------------------- */

static enum calibrate_verdict solve(struct calibrate_magnetometer *c)
{
	struct calibrate_magnetometer_result *r = &c->result;
	struct ellipsoid e = {0};
	double mean, scale;

	c->coverage = 0;
	if (c->count < POINTS_LEAST)
		return CALIBRATE_POOR_COVERAGE;
	if (ellipsoid_guess(c->points, c->count, RADIUS_UT, &e) < 0)
		return CALIBRATE_NO_ELLIPSOID;
	c->coverage = e.coverage;
	if (e.coverage < COVERAGE_HOPELESS)
		return CALIBRATE_POOR_COVERAGE;
	if (ellipsoid_fit(c->points, c->count, RADIUS_UT, true, &e) < 0)
		return CALIBRATE_NO_ELLIPSOID;
	c->coverage = e.coverage;
	if (!(e.least > 0))
		return CALIBRATE_NO_ELLIPSOID;
	if (e.coverage < COVERAGE_LEAST)
		return CALIBRATE_POOR_COVERAGE;
	if (e.largest > STRETCH_MAX * e.least)
		return CALIBRATE_NO_ELLIPSOID;
	mean = RADIUS_UT / e.mean;
	r->field_uT = c->config.field_uT > 0 ? c->config.field_uT : mean;
	scale = r->field_uT / RADIUS_UT;
	r->calibration.bias = e.centre;
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			r->calibration.matrix[i][j] = scale * e.matrix.m[i][j];
	r->residual = e.rms / RADIUS_UT;
	r->bias_sigma_uT = e.sigma;
	if (r->residual > RESIDUAL_MAX)
		return CALIBRATE_LARGE_RESIDUAL;
	return mean > FIELD_MIN_UT && mean < FIELD_MAX_UT ? CALIBRATE_GOOD : CALIBRATE_IMPLAUSIBLE;
}

/* ---- sample by sample -------------------------------------------------------------------------------------------- */

static void run_clock(struct calibrate_magnetometer *c, uint64_t t_us)
{
	if (c->started && t_us > c->last_t_us && t_us - c->last_t_us < GAP_US)
		c->elapsed_us += t_us - c->last_t_us;
	c->started = true;
	c->last_t_us = t_us;
}

static void look(struct calibrate_magnetometer *c)
{
	enum calibrate_verdict verdict = solve(c);
	bool late = (double)c->elapsed_us * 1e-6 > c->config.patience_s;

	c->looked_us = c->elapsed_us;
	if (late || (verdict == CALIBRATE_GOOD && c->coverage >= COVERAGE_WANTED && !c->config.whole))
		c->verdict = verdict;
}

enum calibrate_verdict calibrate_magnetometer_step(struct calibrate_magnetometer *c, const struct imu_sample *raw)
{
	if (c->verdict != CALIBRATE_COLLECTING)
		return c->verdict;
	run_clock(c, raw->t_us);
	if ((raw->flags & SAMPLE_MAG) && !(raw->flags & SAMPLE_SATURATED))
		take(c, raw->mag_uT);
	if (c->elapsed_us - c->looked_us >= LOOK_US)
		look(c);
	if (c->count == 0 && c->elapsed_us > NO_MAG_US)
		c->verdict = CALIBRATE_NO_MAGNETOMETER;
	return c->verdict;
}

enum calibrate_verdict calibrate_magnetometer_finish(struct calibrate_magnetometer *c)
{
	if (c->verdict == CALIBRATE_COLLECTING)
		c->verdict = c->count ? solve(c) : CALIBRATE_NO_MAGNETOMETER;
	return c->verdict;
}
