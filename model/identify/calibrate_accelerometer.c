#include "model/identify/calibrate_accelerometer.h"

#include "model/identify/ellipsoid.h"
#include "model/math/linalg.h"
#include "model/math/units.h"

/* MIN_BLOCKS: rest of 1.25 s, shorter than the 3 s that the user is asked for. */
enum { MIN_BLOCKS = 5 };
/* cos 20 deg: positions closer than that are one, and a position farther than that from every axis is not a face. */
static const double SAME_POSITION_COS = 0.9396926;
/* Chosen limits. Faces and corners together have a coverage (struct ellipsoid) of 1.0, a hemisphere 0.13. Simulated
 * chips with the datasheets' errors leave a residual of 0.03 % of gravity; the rest is for a hand. Their offsets are
 * 0.06 g and their scale errors 2 % (1 sigma); data in a wrong unit are off by more than these limits. */
static const double MIN_COVERAGE = 0.4;
static const double MAX_RESIDUAL = 0.008; /* share of gravity */
static const double MAX_BIAS = 0.5;	  /* share of gravity */
static const double MIN_SCALE = 0.7, MAX_SCALE = 1.4;
/* The angle is computed for small rotations. A larger one is a wrong fixture, not a misaligned sensor. */
static const double MAX_FACES_TURNED_RAD = 5 * RAD_PER_DEG;

void calibrate_accelerometer_init(
	struct calibrate_accelerometer *c, const struct calibrate_accelerometer_config *config)
{
	*c = (struct calibrate_accelerometer){.config = *config, .at = -1};
	calibrate_rest_init(&c->rest, &CALIBRATE_HELD);
	gyro_turns_init(&c->turns);
}

int calibrate_accelerometer_wanted(const struct calibrate_accelerometer *c)
{
	if (c->config.positions == CALIBRATE_SIX_FACES)
		return CALIBRATE_FACES;
	return c->positions < CALIBRATE_FREE_MIN || c->result.gyro.found ? CALIBRATE_FREE_MIN : CALIBRATE_SIDES;
}

static double cosine(struct vec3 a, struct vec3 b)
{
	return vec3_dot(a, b) / (vec3_norm(a) * vec3_norm(b));
}

double calibrate_accelerometer_gap_rad(const struct calibrate_accelerometer *c, int side)
{
	double least = PI;

	for (int k = 0; k < CALIBRATE_POSITIONS_MAX; k++)
		if (c->position[k].blocks)
			least = fmin(
				least, calibrate_gap_rad(side, &c->position[k].force_m_s2, 1, (struct vec3){0, 0, 0}));
	return least;
}

int calibrate_accelerometer_next(const struct calibrate_accelerometer *c)
{
	const int sides = c->config.positions == CALIBRATE_SIX_FACES ? CALIBRATE_FACES : CALIBRATE_SIDES;
	double farthest = acos(SAME_POSITION_COS);
	int next = 0;

	for (int i = 1; i <= sides; i++) {
		double gap = calibrate_accelerometer_gap_rad(c, i);

		if (gap > farthest + 1e-6) {
			farthest = gap;
			next = i;
		}
	}
	return next;
}

/* ---- the positions ----------------------------------------------------------------------------------------------- */

/* Index of the face whose axis points up, 0 +x, 1 -x, .. 5 -z; -1: none. */
static int face_of(struct vec3 force)
{
	for (int i = 0; i < CALIBRATE_FACES; i++)
		if (cosine(calibrate_side(i + 1), force) > SAME_POSITION_COS)
			return i;
	return -1;
}

/* Index of the position to which a rest belongs, an existing one or the next free one; -1: none. */
static int position_of(const struct calibrate_accelerometer *c, struct vec3 force)
{
	int nearest = -1;
	double most = SAME_POSITION_COS;

	if (c->config.positions == CALIBRATE_SIX_FACES)
		return face_of(force);
	for (int i = 0; i < c->positions; i++)
		if (cosine(c->position[i].force_m_s2, force) > most) {
			most = cosine(c->position[i].force_m_s2, force);
			nearest = i;
		}
	if (nearest >= 0)
		return nearest;
	return c->positions < CALIBRATE_POSITIONS_MAX ? c->positions : -1;
}

/* Records the current rest; the longest one of each position counts. True: it is a new position. */
static bool record_position(struct calibrate_accelerometer *c)
{
	struct vec3 mean = vec3_scale(1.0 / c->blocks, c->sum_m_s2);
	struct calibrate_position *p;
	bool new;

	if (c->at < 0)
		c->at = position_of(c, mean);
	if (c->at < 0)
		return false;
	p = &c->position[c->at];
	new = p->blocks == 0;
	if (c->blocks > p->blocks)
		*p = (struct calibrate_position){mean, c->blocks};
	c->positions += new;
	return new;
}

/* ---- the solution ------------------------------------------------------------------------------------------------ */

static double element(struct vec3 v, int i)
{
	return i == 0 ? v.x : i == 1 ? v.y : v.z;
}

static double determinant(double m[3][3])
{
	return m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
	       m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
}

static void inverse(double m[3][3], double out[3][3])
{
	double det = determinant(m);

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++) {
			int a = (j + 1) % 3, b = (j + 2) % 3, p = (i + 1) % 3, q = (i + 2) % 3;

			out[i][j] = (m[a][p] * m[b][q] - m[a][q] * m[b][p]) / det;
		}
}

/* Least squares of raw = S f + bias with f = +-g along each axis: the bias is the mean of all faces, and column i of S
 * is half the difference of the two faces of axis i. The residual has 18 values less 12 unknowns: the differences of
 * each pair's mean from the bias. */
static enum calibrate_verdict solve_faces(struct calibrate_accelerometer *c)
{
	struct calibrate_accelerometer_result *r = &c->result;
	double s[3][3], squares = 0, g = c->config.gravity_m_s2, turned = 0;
	struct vec3 bias = {0, 0, 0};

	if (c->positions < CALIBRATE_FACES)
		return CALIBRATE_TOO_FEW_POSITIONS;
	for (int i = 0; i < CALIBRATE_FACES; i++)
		bias = vec3_add(bias, vec3_scale(1.0 / CALIBRATE_FACES, c->position[i].force_m_s2));
	for (int axis = 0; axis < 3; axis++) {
		struct vec3 up = c->position[2 * axis].force_m_s2, down = c->position[2 * axis + 1].force_m_s2;
		struct vec3 left = vec3_sub(vec3_scale(0.5, vec3_add(up, down)), bias);

		squares += 2 * vec3_dot(left, left);
		for (int i = 0; i < 3; i++)
			s[i][axis] = element(vec3_sub(up, down), i) / (2 * g);
	}
	if (fabs(determinant(s)) < 0.1)
		return CALIBRATE_IMPLAUSIBLE;
	inverse(s, r->calibration.matrix);
	r->calibration.bias = bias;
	r->residual_m_s2 = sqrt(squares / 6);
	r->bias_sigma_m_s2 = vec3_scale(r->residual_m_s2 / sqrt(6), (struct vec3){1, 1, 1});
	r->matrix_sigma = r->residual_m_s2 / sqrt(2) / g;
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < i; j++)
			turned += (s[i][j] - s[j][i]) * (s[i][j] - s[j][i]) / 4;
	r->faces_turned_rad = sqrt(turned);
	return r->faces_turned_rad > MAX_FACES_TURNED_RAD ? CALIBRATE_FACES_TURNED : CALIBRATE_GOOD;
}

static enum calibrate_verdict solve_free(struct calibrate_accelerometer *c)
{
	struct calibrate_accelerometer_result *r = &c->result;
	struct vec3 points[CALIBRATE_POSITIONS_MAX];
	struct ellipsoid e = {.matrix = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}};

	for (int i = 0; i < c->positions; i++)
		points[i] = c->position[i].force_m_s2;
	if (ellipsoid_fit(points, c->positions, c->config.gravity_m_s2, false, &e) < 0)
		return c->positions < CALIBRATE_FREE_MIN ? CALIBRATE_TOO_FEW_POSITIONS : CALIBRATE_POOR_COVERAGE;
	c->coverage = e.coverage;
	r->calibration.bias = e.centre;
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			r->calibration.matrix[i][j] = e.matrix.m[i][j];
	r->residual_m_s2 = e.rms;
	r->bias_sigma_m_s2 = e.sigma;
	r->matrix_sigma = e.matrix_sigma;
	if (c->positions < CALIBRATE_FREE_MIN)
		return CALIBRATE_TOO_FEW_POSITIONS;
	return e.coverage < MIN_COVERAGE ? CALIBRATE_POOR_COVERAGE : CALIBRATE_GOOD;
}

static double add_drift(const struct calibrate_accelerometer *c, double sigma)
{
	double drift = CALIBRATE_DRIFT * c->config.bias_instability_m_s2;

	return sqrt(sigma * sigma + drift * drift);
}

static bool plausible(const struct calibrate_accelerometer *c)
{
	const struct triad_calibration *t = &c->result.calibration;

	if (!(vec3_norm(t->bias) < MAX_BIAS * c->config.gravity_m_s2))
		return false;
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++) {
			double m = t->matrix[i][j];

			if (i == j ? !(m > MIN_SCALE && m < MAX_SCALE) : !(fabs(m) < MAX_SCALE - 1))
				return false;
		}
	return true;
}

static enum calibrate_verdict solve(struct calibrate_accelerometer *c)
{
	enum calibrate_verdict verdict;

	c->result = (struct calibrate_accelerometer_result){
		.temperature_degC = c->temperatures ? c->temperature_sum_degC / c->temperatures : (double)NAN};
	verdict = c->config.positions == CALIBRATE_SIX_FACES ? solve_faces(c) : solve_free(c);
	c->result.bias_sigma_m_s2 = (struct vec3){add_drift(c, c->result.bias_sigma_m_s2.x),
		add_drift(c, c->result.bias_sigma_m_s2.y), add_drift(c, c->result.bias_sigma_m_s2.z)};
	if (verdict != CALIBRATE_GOOD)
		return verdict;
	if (c->result.residual_m_s2 > MAX_RESIDUAL * c->config.gravity_m_s2)
		return CALIBRATE_LARGE_RESIDUAL;
	if (!plausible(c))
		return CALIBRATE_IMPLAUSIBLE;
	c->result.gyro = gyro_turns_solve(&c->turns, &c->result.calibration);
	return CALIBRATE_GOOD;
}

/* ---- sample by sample -------------------------------------------------------------------------------------------- */

static void end_rest(struct calibrate_accelerometer *c)
{
	c->sum_m_s2 = (struct vec3){0, 0, 0};
	c->blocks = 0;
	c->at = -1;
}

/* Free positions that do not suffice yet can do so with the next ones; six faces cannot. */
static void new_position(struct calibrate_accelerometer *c)
{
	const bool free = c->config.positions == CALIBRATE_FREE;
	enum calibrate_verdict verdict = solve(c);

	if (!free)
		c->coverage = c->positions / (double)CALIBRATE_FACES;
	if (c->config.use_all || c->positions < calibrate_accelerometer_wanted(c))
		return;
	if (verdict == CALIBRATE_GOOD || !free || c->positions == CALIBRATE_POSITIONS_MAX)
		c->verdict = verdict;
}

static void rest_block(struct calibrate_accelerometer *c)
{
	const struct calibrate_block *b = &c->rest.block;

	c->sum_m_s2 = vec3_add(c->sum_m_s2, b->accel_m_s2);
	c->blocks++;
	if (b->temperature_samples) {
		c->temperature_sum_degC += b->temperature_degC;
		c->temperatures++;
	}
	if (c->blocks >= MIN_BLOCKS && record_position(c))
		new_position(c);
}

enum calibrate_verdict calibrate_accelerometer_step(struct calibrate_accelerometer *c, const struct imu_sample *raw)
{
	enum calibrate_rest_event event;

	if (c->verdict != CALIBRATE_COLLECTING)
		return c->verdict;
	gyro_turns_sample(&c->turns, raw);
	event = calibrate_rest_step(&c->rest, raw);
	if (event == CALIBRATE_REST_BLOCK) {
		gyro_turns_block(&c->turns, &c->rest.block);
		rest_block(c);
	} else if (event == CALIBRATE_REST_ENDED) {
		gyro_turns_moved(&c->turns);
		end_rest(c);
	}
	if (c->verdict == CALIBRATE_COLLECTING && calibrate_rest_time_s(&c->rest) > c->config.patience_s)
		c->verdict = solve(c);
	return c->verdict;
}

enum calibrate_verdict calibrate_accelerometer_finish(struct calibrate_accelerometer *c)
{
	if (c->verdict == CALIBRATE_COLLECTING)
		c->verdict = solve(c);
	return c->verdict;
}
