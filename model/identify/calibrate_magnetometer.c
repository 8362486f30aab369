#include "model/identify/calibrate_magnetometer.h"

#include "model/identify/ellipsoid.h"
#include "model/math/units.h"

/* Initial distance between points, and the factor by which it grows whenever the memory is full. 2 uT is 2 deg of the
 * Earth's field, and above the noise of the supported magnetometers (0.1 to 0.6 uT). */
static const double SPACING_UT = 2, SPACING_GROWTH = 1.3;
/* Coverage (struct ellipsoid): below it the quadric is not worth a fit; least one of a valid result; the one at which
 * the device ends. A hemisphere has 0.13, the simulated motion `figure` 0.97. */
static const double MIN_QUADRIC_COVERAGE = 0.2, MIN_COVERAGE = 0.4, COVERAGE_WANTED = 0.6;
static const double COVERED_RAD = 30 * RAD_PER_DEG;	   /* of a side to the nearest point */
static const double MAX_RESIDUAL = 0.05;		   /* share of the field: 3 deg of heading */
static const double MAX_AXIS_RATIO = 2.5;		   /* longest to shortest; soft iron stays below 1.5 */
static const double MIN_FIELD_UT = 10, MAX_FIELD_UT = 150; /* the Earth's field is 22 to 67 */
static const double MAX_RANGE_UT = 1e6;			   /* beyond every magnetometer: not a measurement */
static const double SPIKE_UT = 10;			   /* distance from the middle of both neighbours in time */
static const double RADIUS_UT = 50;			   /* of the fit; the result is scaled afterwards */
static const uint64_t SOLVE_INTERVAL_US = 1000000, NO_MAG_US = 5000000, GAP_US = 500000;
enum { MIN_POINTS = 30 }; /* nine unknowns, and enough points for the residual */

void calibrate_magnetometer_init(struct calibrate_magnetometer *c, const struct calibrate_magnetometer_config *config)
{
	*c = (struct calibrate_magnetometer){.config = *config, .spacing_uT = SPACING_UT};
}

double calibrate_magnetometer_progress(const struct calibrate_magnetometer *c)
{
	return c->verdict != CALIBRATE_COLLECTING ? 1 : fmin(1, c->coverage / COVERAGE_WANTED);
}

/* The centre of the smallest box that holds all points; a sphere that is half covered has its own elsewhere, but the
 * side that is farthest from all points is the same. */
double calibrate_magnetometer_gap_rad(const struct calibrate_magnetometer *c, int side)
{
	struct vec3 low = c->points[0], high = c->points[0];

	for (int i = 1; i < c->count; i++) {
		const struct vec3 *p = &c->points[i];

		low = (struct vec3){fmin(low.x, p->x), fmin(low.y, p->y), fmin(low.z, p->z)};
		high = (struct vec3){fmax(high.x, p->x), fmax(high.y, p->y), fmax(high.z, p->z)};
	}
	return calibrate_gap_rad(side, c->points, c->count, vec3_scale(0.5, vec3_add(low, high)));
}

int calibrate_magnetometer_next(const struct calibrate_magnetometer *c)
{
	double farthest = COVERED_RAD;
	int next = 0;

	for (int side = 1; side <= CALIBRATE_SIDES && c->count > 0; side++) {
		double gap = calibrate_magnetometer_gap_rad(c, side);

		if (gap > farthest + 1e-6) {
			farthest = gap;
			next = side;
		}
	}
	return next;
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

	c->spacing_uT *= SPACING_GROWTH;
	for (int i = 0; i < c->count; i++)
		if (!near_a_point(c, kept, c->points[i]))
			c->points[kept++] = c->points[i];
	c->count = kept;
}

static void add_point(struct calibrate_magnetometer *c, struct vec3 p)
{
	if (!(vec3_norm(p) <= MAX_RANGE_UT) || near_a_point(c, c->count, p)) /* true for NaN, too */
		return;
	while (c->count == CALIBRATE_POINTS_MAX)
		thin_out(c);
	c->points[c->count++] = p;
}

static bool is_spike(struct vec3 before, struct vec3 p, struct vec3 after)
{
	struct vec3 middle = vec3_scale(0.5, vec3_add(before, after));

	return vec3_norm(vec3_sub(p, middle)) > SPIKE_UT + 0.5 * vec3_norm(vec3_sub(after, before));
}

/* A single wrong sample lies far from all others, so thinning out would always keep it. It is removed here instead, for
 * which each sample waits until the next one has come. */
static void filter_spikes(struct calibrate_magnetometer *c, struct vec3 p)
{
	if (c->recent_count == 2 && !is_spike(c->recent[0], c->recent[1], p))
		add_point(c, c->recent[1]);
	c->recent[0] = c->recent[1];
	c->recent[1] = p;
	if (c->recent_count < 2)
		c->recent_count++;
}

/* ---- the solution ------------------------------------------------------------------------------------------------ */

static enum calibrate_verdict solve(struct calibrate_magnetometer *c)
{
	struct calibrate_magnetometer_result *r = &c->result;
	struct ellipsoid e = {0};
	double mean, scale;

	c->coverage = 0;
	if (c->count < MIN_POINTS)
		return CALIBRATE_POOR_COVERAGE;
	if (ellipsoid_guess(c->points, c->count, RADIUS_UT, &e) < 0)
		return CALIBRATE_NO_ELLIPSOID;
	c->coverage = e.coverage;
	if (e.coverage < MIN_QUADRIC_COVERAGE)
		return CALIBRATE_POOR_COVERAGE;
	if (ellipsoid_fit(c->points, c->count, RADIUS_UT, true, &e) < 0)
		return CALIBRATE_NO_ELLIPSOID;
	c->coverage = e.coverage;
	if (!(e.least > 0))
		return CALIBRATE_NO_ELLIPSOID;
	if (e.coverage < MIN_COVERAGE)
		return CALIBRATE_POOR_COVERAGE;
	if (e.largest > MAX_AXIS_RATIO * e.least)
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
	if (r->residual > MAX_RESIDUAL)
		return CALIBRATE_LARGE_RESIDUAL;
	return mean > MIN_FIELD_UT && mean < MAX_FIELD_UT ? CALIBRATE_GOOD : CALIBRATE_IMPLAUSIBLE;
}

/* ---- sample by sample -------------------------------------------------------------------------------------------- */

static void run_clock(struct calibrate_magnetometer *c, uint64_t t_us)
{
	if (c->started && t_us > c->last_t_us && t_us - c->last_t_us < GAP_US)
		c->elapsed_us += t_us - c->last_t_us;
	c->started = true;
	c->last_t_us = t_us;
}

static void try_to_end(struct calibrate_magnetometer *c)
{
	enum calibrate_verdict verdict = solve(c);
	bool timeout = (double)c->elapsed_us * 1e-6 > c->config.patience_s;

	c->solved_us = c->elapsed_us;
	if (timeout || (verdict == CALIBRATE_GOOD && c->coverage >= COVERAGE_WANTED && !c->config.use_all))
		c->verdict = verdict;
}

enum calibrate_verdict calibrate_magnetometer_step(struct calibrate_magnetometer *c, const struct imu_sample *raw)
{
	if (c->verdict != CALIBRATE_COLLECTING)
		return c->verdict;
	run_clock(c, raw->t_us);
	if ((raw->flags & SAMPLE_MAG) && !(raw->flags & SAMPLE_SATURATED))
		filter_spikes(c, raw->mag_uT);
	if (c->elapsed_us - c->solved_us >= SOLVE_INTERVAL_US)
		try_to_end(c);
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
