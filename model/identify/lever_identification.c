#include "model/identify/lever_identification.h"

#include <errno.h>
#include <string.h>

#include "model/math/linalg.h"

/* The parameters: r, bias of the accelerometer, delay of the reference. */
enum { PARAMETER_ARM = 0, PARAMETER_BIAS = 3, PARAMETER_DELAY = 6, PARAMETERS = 7 };

/* The parameters are known a little beforehand, so that what the motion does not tell stays finite: r and bias to this
 * 1 sigma, the delay to its limit, where samples err by PRIOR_NOISE_M_S2. */
static const double PRIOR_ARM_M = 10, PRIOR_BIAS_M_S2 = 1, PRIOR_NOISE_M_S2 = 0.2;

/* Newton's steps for the delay. */
enum { DELAY_STEPS = 4 };

/* The filters settle for so long: ten time constants. */
static const double SETTLING_S = 0.3;

/* So many lost samples are bridged by a straight line; the interval of sampling follows the time stamps with this share of
 * each. */
static const double BRIDGED = 3, RATE_SHARE = 0.01;

/* Refusals. The RMS of alpha x + omega x omega x of a unit lever arm along the direction that the motion tells least of,
 * absolute and as a share of the best one, and along the best one. The noise of a gyro alone (0.03 deg/s/sqrt(Hz), below
 * 8 Hz) makes 0.05; slow movements by hand have 4 and more, quick ones 50. */
static const double SLOW_S2 = 1, BLIND_S2 = 0.4, BLIND_SHARE = 0.05;
/* What is left over of a held point, of an outside reference, and the share of the lever arm's own acceleration. */
static const double HELD_M_S2 = 0.3, REFERENCE_M_S2 = 1, LEFT_SHARE = 0.1;
/* Noise of r that is too much: per axis, or the share of |r|. */
static const double UNSURE_M = 0.005, UNSURE_SHARE = 0.03;
/* One direction worse than the others by this is named. */
static const double LOPSIDED = 3;

const char *lever_verdict_text(enum lever_verdict verdict)
{
	switch (verdict) {
	case LEVER_FOUND:
		return "found";
	case LEVER_TOO_SHORT:
		return "too short: at least 10 s of motion without gaps are needed, better 30 s";
	case LEVER_NO_REFERENCE:
		return "no reference: the acceleration of the reference point did not come, or not often enough";
	case LEVER_TOO_SLOW:
		return "too slow: turn the object to and fro, about all its axes, once or twice a second";
	case LEVER_BLIND_L:
		return "turned about the longitudinal axis only: that does not tell r along it; turn about the others, "
		       "too";
	case LEVER_BLIND_S:
		return "turned about the side axis only: that does not tell r along it; turn about the others, too";
	case LEVER_BLIND_T:
		return "turned about the transversal axis only: that does not tell r along it; turn about the others, "
		       "too";
	case LEVER_NOT_HELD:
		return "does not fit: the reference point was not held still, or the reference is not that of this "
		       "motion";
	case LEVER_UNSURE:
		return "not sure enough: turn faster, or for longer";
	case LEVER_SENSOR_LOST:
		return "the sensor stopped";
	}
	return "unknown";
}

int lever_identification_init(struct lever_identification *id, const struct lever_identification_config *config)
{
	const struct filter_config low_pass = {.type = FILTER_BUTTERWORTH, .order = 2, .cutoff_hz = LEVER_CUTOFF_HZ};

	if (!(config->rate_hz >= 25 && config->rate_hz <= 10000))
		return -EINVAL;
	if (!(config->duration_s >= LEVER_LEAST_WINDOWS * LEVER_WINDOW_S && config->duration_s <= 3600))
		return -EINVAL;
	memset(id, 0, sizeof(*id));
	id->config = *config;
	for (int i = 0; i < LEVER_TERMS; i++)
		filter3_init(&id->filter[i], &low_pass, config->rate_hz);
	id->window_size = (int)(LEVER_WINDOW_S * config->rate_hz + 0.5);
	id->windows_per_block = 1;
	id->dt_s = 1 / config->rate_hz;
	return 0;
}

/* ---- windows to blocks ------------------------------------------------------------------------------------------- */

static int pair(int i, int j)
{
	return i >= j ? i * (i + 1) / 2 + j : j * (j + 1) / 2 + i;
}

static void empty_window(struct lever_identification *id)
{
	memset(&id->window, 0, sizeof(id->window));
	memset(id->sum, 0, sizeof(id->sum));
	memset(id->moment, 0, sizeof(id->moment));
	id->window_count = 0;
}

static void add_block(struct lever_block *to, const struct lever_block *from)
{
	for (int i = 0; i < LEVER_PRODUCTS; i++)
		to->product[i] += from->product[i];
	to->samples += from->samples;
}

static void halve_blocks(struct lever_identification *id)
{
	for (int i = 0; i < LEVER_BLOCKS / 2; i++) {
		id->block[i] = id->block[2 * i];
		add_block(&id->block[i], &id->block[2 * i + 1]);
	}
	id->blocks = LEVER_BLOCKS / 2;
	id->windows_per_block *= 2;
}

static void keep_window(struct lever_identification *id)
{
	if (id->blocks > 0 && id->last_block_windows < id->windows_per_block) {
		add_block(&id->block[id->blocks - 1], &id->window);
		id->last_block_windows++;
		return;
	}
	if (id->blocks == LEVER_BLOCKS)
		halve_blocks(id);
	id->block[id->blocks++] = id->window;
	id->last_block_windows = 1;
}

/* What a constant and a slope, one of each for each axis, would explain goes out of the products. */
static void end_window(struct lever_identification *id)
{
	const double n = id->window_count, spread = n * (n * n - 1) / 12; /* of the instants about their middle */

	for (int i = 0; i < LEVER_TERMS; i++)
		for (int j = 0; j <= i; j++)
			id->window.product[pair(i, j)] -=
				vec3_dot(id->sum[i], id->sum[j]) / n + vec3_dot(id->moment[i], id->moment[j]) / spread;
	id->window.samples = n;
	keep_window(id);
	id->windows++;
	id->window_ended = true;
	empty_window(id);
}

static void gather(struct lever_identification *id, const struct vec3 term[LEVER_TERMS])
{
	const double instant = id->window_count - 0.5 * (id->window_size - 1);

	for (int i = 0; i < LEVER_TERMS; i++) {
		id->sum[i] = vec3_add(id->sum[i], term[i]);
		id->moment[i] = vec3_add(id->moment[i], vec3_scale(instant, term[i]));
		for (int j = 0; j <= i; j++)
			id->window.product[pair(i, j)] += vec3_dot(term[i], term[j]);
	}
	if (++id->window_count == id->window_size)
		end_window(id);
}

/* ---- samples to terms -------------------------------------------------------------------------------------------- */

/* Five-point formulas, exact for polynomials of the fourth degree: three points lose 7 % of an oscillation at a tenth of
 * the sampling rate. */
static struct vec3 first_derivative(const struct vec3 x[LEVER_STENCIL], double dt_s)
{
	struct vec3 near = vec3_sub(x[3], x[1]), far = vec3_sub(x[4], x[0]);

	return vec3_scale(1 / (12 * dt_s), vec3_sub(vec3_scale(8, near), far));
}

static struct vec3 second_derivative(const struct vec3 x[LEVER_STENCIL], double dt_s)
{
	struct vec3 near = vec3_add(x[3], x[1]), far = vec3_add(x[4], x[0]);

	return vec3_scale(1 / (12 * dt_s * dt_s), vec3_sub(vec3_scale(16, near), vec3_add(far, vec3_scale(30, x[2]))));
}

/* The terms at the middle of the stencil, in the almost inertial frame. */
static void make_terms(const struct lever_identification *id, struct vec3 term[LEVER_TERMS])
{
	static const struct vec3 UNIT[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
	const struct lever_raw *at = &id->raw[LEVER_STENCIL / 2];
	struct vec3 gyro[LEVER_STENCIL], ref[LEVER_STENCIL], alpha;

	for (int i = 0; i < LEVER_STENCIL; i++) {
		gyro[i] = id->raw[i].gyro_b_rad_s;
		ref[i] = id->raw[i].ref_b_m_s2;
	}
	alpha = first_derivative(gyro, id->dt_s);
	term[LEVER_FORCE] = at->force_b_m_s2;
	term[LEVER_REFERENCE] = at->ref_b_m_s2;
	term[LEVER_REFERENCE_DOT] = first_derivative(ref, id->dt_s);
	term[LEVER_REFERENCE_DDOT] = second_derivative(ref, id->dt_s);
	for (int i = 0; i < 3; i++) {
		struct vec3 omega = at->gyro_b_rad_s, speed = vec3_cross(omega, UNIT[i]);

		term[LEVER_ARM + i] = vec3_add(vec3_cross(alpha, UNIT[i]), vec3_cross(omega, speed));
		term[LEVER_BIAS + i] = UNIT[i];
	}
	for (int i = 0; i < LEVER_TERMS; i++)
		term[i] = quat_rotate(at->q, term[i]);
}

void lever_identification_break(struct lever_identification *id)
{
	id->raw_count = id->settling = 0;
	id->window_ended = false;
	empty_window(id);
}

static void push(struct lever_identification *id, const struct lever_raw *raw)
{
	if (id->raw_count == LEVER_STENCIL)
		memmove(id->raw, id->raw + 1, (LEVER_STENCIL - 1) * sizeof(*raw));
	else
		id->raw_count++;
	id->raw[id->raw_count - 1] = *raw;
}

/* The gyro's turn from one sample to the next, by the mean of both rates. */
static struct quat turned(const struct lever_raw *from, struct vec3 gyro_b_rad_s, double dt_s)
{
	struct vec3 mean = vec3_scale(0.5, vec3_add(from->gyro_b_rad_s, gyro_b_rad_s));

	return quat_normalize(quat_multiply(from->q, quat_from_rotation_vector(vec3_scale(dt_s, mean))));
}

static bool usable(struct vec3 v)
{
	return fabs(v.x) < 1e5 && fabs(v.y) < 1e5 && fabs(v.z) < 1e5; /* false for NaN */
}

static struct vec3 between(struct vec3 a, struct vec3 b, double share)
{
	return vec3_add(a, vec3_scale(share, vec3_sub(b, a)));
}

static void take(struct lever_identification *id, struct lever_raw raw)
{
	struct vec3 term[LEVER_TERMS];

	if (id->raw_count > 0)
		raw.q = turned(&id->raw[id->raw_count - 1], raw.gyro_b_rad_s, id->dt_s);
	push(id, &raw);
	if (id->raw_count < LEVER_STENCIL)
		return;
	make_terms(id, term);
	for (int i = 0; i < LEVER_TERMS; i++) {
		if (id->settling == 0)
			filter3_prime(&id->filter[i], term[i]);
		term[i] = filter3_step(&id->filter[i], term[i]);
	}
	if (id->settling < SETTLING_S * id->config.rate_hz)
		id->settling++;
	else
		gather(id, term);
}

/* The samples lost before this one, as a straight line; too many of them begin a new window. */
static void bridge(struct lever_identification *id, const struct lever_raw *to, double interval_s)
{
	const double intervals = fmax(floor(interval_s * id->config.rate_hz + 0.5), 1);
	const struct lever_raw from = id->raw[id->raw_count > 0 ? id->raw_count - 1 : 0];

	if (!(interval_s > 0 && intervals <= 1 + BRIDGED))
		lever_identification_break(id);
	if (id->raw_count == 0)
		return;
	id->dt_s += RATE_SHARE * (interval_s / intervals - id->dt_s);
	for (double k = 1; k < intervals; k++)
		take(id, (struct lever_raw){
				 .gyro_b_rad_s = between(from.gyro_b_rad_s, to->gyro_b_rad_s, k / intervals),
				 .force_b_m_s2 = between(from.force_b_m_s2, to->force_b_m_s2, k / intervals),
				 .ref_b_m_s2 = between(from.ref_b_m_s2, to->ref_b_m_s2, k / intervals),
				 .q = QUAT_IDENTITY,
			 });
}

void lever_identification_step(struct lever_identification *id, uint64_t t_us, struct vec3 gyro_b_rad_s,
	struct vec3 force_b_m_s2, const struct vec3 *ref_b_m_s2)
{
	const double interval_s = (double)(t_us - id->last_t_us) * 1e-6;
	const bool missing = id->config.reference && !ref_b_m_s2;
	struct lever_raw raw = {.gyro_b_rad_s = gyro_b_rad_s, .force_b_m_s2 = force_b_m_s2, .q = QUAT_IDENTITY};

	if (id->config.reference && ref_b_m_s2)
		raw.ref_b_m_s2 = *ref_b_m_s2;
	id->last_t_us = t_us;
	id->window_ended = false;
	id->samples++;
	id->without_reference += missing;
	if (missing || !usable(gyro_b_rad_s) || !usable(force_b_m_s2) || !usable(raw.ref_b_m_s2)) {
		lever_identification_break(id);
		return;
	}
	bridge(id, &raw, interval_s);
	take(id, raw);
}

bool lever_identification_news(const struct lever_identification *id)
{
	return id->window_ended;
}

/* ---- blocks to an estimate --------------------------------------------------------------------------------------- */

/* What is compared (row 0) and what explains it (one row a parameter), each a sum of terms. */
typedef double combination[1 + PARAMETERS][LEVER_TERMS];

/* a_ref(t) = ref(t + delay), to the second order, and its change with the delay. */
static void combine(double delay_s, combination c)
{
	memset(c, 0, sizeof(combination));
	c[0][LEVER_FORCE] = 1;
	c[0][LEVER_REFERENCE] = -1;
	c[0][LEVER_REFERENCE_DOT] = -delay_s;
	c[0][LEVER_REFERENCE_DDOT] = -delay_s * delay_s / 2;
	for (int i = 0; i < 3; i++) {
		c[1 + PARAMETER_ARM + i][LEVER_ARM + i] = 1;
		c[1 + PARAMETER_BIAS + i][LEVER_BIAS + i] = 1;
	}
	c[1 + PARAMETER_DELAY][LEVER_REFERENCE_DOT] = 1;
	c[1 + PARAMETER_DELAY][LEVER_REFERENCE_DDOT] = delay_s;
}

/* Products of the combinations; [0][0] is the square of what is compared. */
static void multiply(const struct lever_block *b, combination c, double out[1 + PARAMETERS][1 + PARAMETERS])
{
	combination half;

	for (int i = 0; i <= PARAMETERS; i++)
		for (int j = 0; j < LEVER_TERMS; j++) {
			half[i][j] = 0;
			for (int k = 0; k < LEVER_TERMS; k++)
				half[i][j] += c[i][k] * b->product[pair(k, j)];
		}
	for (int i = 0; i <= PARAMETERS; i++)
		for (int j = 0; j <= PARAMETERS; j++) {
			out[i][j] = 0;
			for (int k = 0; k < LEVER_TERMS; k++)
				out[i][j] += half[i][k] * c[j][k];
		}
}

struct solution {
	double value[PARAMETERS];
	double inverse[PARAMETERS * PARAMETERS]; /* of the information; in units of a sample's variance */
	double noise_variance[3];		 /* of r */
	double residual_m_s2, arm_m_s2;		 /* RMS: what is left over, what the lever arm explains */
	double delay_s;
};

static void weigh_prior(double information[PARAMETERS * PARAMETERS], bool with_delay)
{
	const double variance = PRIOR_NOISE_M_S2 * PRIOR_NOISE_M_S2;

	for (int i = 0; i < 3; i++) {
		information[(PARAMETER_ARM + i) * (PARAMETERS + 1)] += variance / (PRIOR_ARM_M * PRIOR_ARM_M);
		information[(PARAMETER_BIAS + i) * (PARAMETERS + 1)] += variance / (PRIOR_BIAS_M_S2 * PRIOR_BIAS_M_S2);
	}
	/* what is not estimated is known to be 0 */
	information[PARAMETER_DELAY * (PARAMETERS + 1)] +=
		with_delay ? variance / (LEVER_DELAY_MAX_S * LEVER_DELAY_MAX_S) : 1e12;
}

/* One linear step, the delay's terms taken at s->delay_s. */
static bool solve_once(const struct lever_block *total, bool with_delay, struct solution *s)
{
	double product[1 + PARAMETERS][1 + PARAMETERS], explained = 0, arm = 0;
	combination c;

	combine(s->delay_s, c);
	multiply(total, c, product);
	for (int i = 0; i < PARAMETERS; i++)
		for (int j = 0; j < PARAMETERS; j++)
			s->inverse[i * PARAMETERS + j] = product[1 + i][1 + j];
	weigh_prior(s->inverse, with_delay);
	if (linalg_invert(PARAMETERS, s->inverse) < 0)
		return false;
	for (int i = 0; i < PARAMETERS; i++) {
		s->value[i] = 0;
		for (int j = 0; j < PARAMETERS; j++)
			s->value[i] += s->inverse[i * PARAMETERS + j] * product[1 + j][0];
		explained += s->value[i] * product[1 + i][0];
	}
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			arm += s->value[i] * s->value[j] * product[1 + i][1 + j];
	s->residual_m_s2 = sqrt(fmax(product[0][0] - explained, 0) / total->samples);
	s->arm_m_s2 = sqrt(fmax(arm, 0) / total->samples);
	return true;
}

/* Each block pulls the estimate where it would have it (its score); the scatter of these pulls is the noise. */
static void scatter(const struct lever_identification *id, bool with_delay, struct solution *s)
{
	const int free_parameters = with_delay ? PARAMETERS : PARAMETERS - 1;
	double product[1 + PARAMETERS][1 + PARAMETERS], score[PARAMETERS];
	combination c;

	combine(s->delay_s, c);
	memset(s->noise_variance, 0, sizeof(s->noise_variance));
	for (int b = 0; b < id->blocks; b++) {
		multiply(&id->block[b], c, product);
		for (int i = 0; i < PARAMETERS; i++) {
			score[i] = product[1 + i][0];
			for (int j = 0; j < PARAMETERS; j++)
				score[i] -= product[1 + i][1 + j] * s->value[j];
		}
		for (int i = 0; i < 3; i++) {
			double pull = 0;

			for (int j = 0; j < PARAMETERS; j++)
				pull += s->inverse[i * PARAMETERS + j] * score[j];
			s->noise_variance[i] += pull * pull;
		}
	}
	for (int i = 0; i < 3; i++)
		s->noise_variance[i] *= (double)id->blocks / (id->blocks - free_parameters);
}

static bool solve(const struct lever_identification *id, bool with_delay, struct solution *s)
{
	struct lever_block total = {.samples = 0};

	memset(s, 0, sizeof(*s));
	if (id->windows < LEVER_LEAST_WINDOWS)
		return false;
	for (int b = 0; b < id->blocks; b++)
		add_block(&total, &id->block[b]);
	for (int i = 0; i < (with_delay ? DELAY_STEPS : 1); i++) {
		s->delay_s = fmin(fmax(s->delay_s + s->value[PARAMETER_DELAY], -LEVER_DELAY_MAX_S), LEVER_DELAY_MAX_S);
		if (!solve_once(&total, with_delay, s))
			return false;
	}
	scatter(id, with_delay, s);
	return true;
}

/* RMS of alpha x + omega x omega x a unit lever arm along the direction that it tells least of, and most; the weakest
 * axis. */
struct excitation {
	double weakest_s2, strongest_s2;
	int axis;
};

static struct excitation excitation(const struct solution *s, double samples)
{
	double covariance[9], values[3], vectors[9];
	struct excitation e = {0, 0, 0};

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			covariance[3 * i + j] = s->inverse[i * PARAMETERS + j];
	if (linalg_eigen(3, covariance, values, vectors) < 0)
		return e;
	e.weakest_s2 = 1 / sqrt(values[2] * samples);
	e.strongest_s2 = 1 / sqrt(values[0] * samples);
	for (int i = 1; i < 3; i++)
		if (fabs(vectors[6 + i]) > fabs(vectors[6 + e.axis]))
			e.axis = i;
	return e;
}

static bool too_noisy(const struct lever_estimate *e)
{
	const double limit_m = fmax(UNSURE_M, UNSURE_SHARE * vec3_norm(e->lever_arm_b_m));
	const struct vec3 n = e->noise_sigma_b_m;

	return !(n.x <= limit_m && n.y <= limit_m && n.z <= limit_m);
}

static enum lever_verdict judge(
	const struct lever_identification *id, const struct solution *s, const struct lever_estimate *e)
{
	const double samples = (double)id->windows * id->window_size;
	const struct excitation x = excitation(s, samples);
	const double allowed_m_s2 = (id->config.reference ? REFERENCE_M_S2 : HELD_M_S2) + LEFT_SHARE * s->arm_m_s2;
	const enum lever_verdict blind = (enum lever_verdict)(LEVER_BLIND_L + x.axis);

	if (!(x.strongest_s2 >= SLOW_S2))
		return LEVER_TOO_SLOW;
	if (x.weakest_s2 < BLIND_S2 || x.weakest_s2 < BLIND_SHARE * x.strongest_s2)
		return blind;
	if (s->residual_m_s2 > allowed_m_s2)
		return LEVER_NOT_HELD;
	if (too_noisy(e))
		return LOPSIDED * x.weakest_s2 < x.strongest_s2 ? blind : LEVER_UNSURE;
	return LEVER_FOUND;
}

static double hypotenuse(double a, double b, double c)
{
	return sqrt(a * a + b * b + c * c);
}

/* Noise, what no recording shows of itself, and what a delay would change that was not to be estimated. */
static struct vec3 whole_sigma(const struct lever_estimate *e, struct vec3 by_delay)
{
	const double always = hypot(LEVER_POINT_SIGMA_M, LEVER_SCALE_SIGMA * vec3_norm(e->lever_arm_b_m));

	return (struct vec3){hypotenuse(e->noise_sigma_b_m.x, always, by_delay.x),
		hypotenuse(e->noise_sigma_b_m.y, always, by_delay.y),
		hypotenuse(e->noise_sigma_b_m.z, always, by_delay.z)};
}

static struct vec3 arm_of(const struct solution *s)
{
	return (struct vec3){s->value[PARAMETER_ARM], s->value[PARAMETER_ARM + 1], s->value[PARAMETER_ARM + 2]};
}

struct lever_estimate lever_identification_estimate(const struct lever_identification *id)
{
	const bool reference = id->config.reference, with_delay = reference && id->config.estimate_delay;
	const double progress = 100 * id->windows * LEVER_WINDOW_S / id->config.duration_s;
	struct lever_estimate e = {.verdict = LEVER_TOO_SHORT, .progress_percent = (unsigned)fmin(progress, 100)};
	struct vec3 by_delay = {0, 0, 0};
	struct solution s, other;

	if (id->samples > 0 && 2 * id->without_reference > id->samples)
		e.verdict = LEVER_NO_REFERENCE;
	if (!solve(id, with_delay, &s))
		return e;
	e.lever_arm_b_m = arm_of(&s);
	e.noise_sigma_b_m =
		(struct vec3){sqrt(s.noise_variance[0]), sqrt(s.noise_variance[1]), sqrt(s.noise_variance[2])};
	e.residual_m_s2 = s.residual_m_s2;
	e.delay_s = s.delay_s;
	if (reference && !with_delay && solve(id, true, &other)) {
		by_delay = vec3_sub(arm_of(&other), e.lever_arm_b_m);
		e.delay_s = other.delay_s;
	}
	e.sigma_b_m = whole_sigma(&e, by_delay);
	e.verdict = judge(id, &s, &e);
	return e;
}
