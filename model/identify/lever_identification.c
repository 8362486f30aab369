#include "model/identify/lever_identification.h"

#include <errno.h>
#include <string.h>

#include "model/math/linalg.h"

/* The parameters: r, bias of the accelerometer, delay of the reference. */
enum { PARAMETER_ARM = 0, PARAMETER_BIAS = 3, PARAMETER_DELAY = 6, PARAMETERS = 7 };

/* A weak prior keeps the unobservable parameters finite: 1 sigma of r, of the bias, and of the noise of a sample to
 * which they are related; that of the delay is its limit. All far wider than the final sigma. */
static const double PRIOR_ARM_M = 10, PRIOR_BIAS_M_S2 = 1, PRIOR_NOISE_M_S2 = 0.2;

/* Newton steps for the delay. */
enum { DELAY_STEPS = 4 };

/* Settling time of the filters: ten time constants of the low-pass. */
static const double SETTLING_S = 0.3;

/* Up to BRIDGED_MAX consecutive lost samples are interpolated; more start a new window. RATE_GAIN: gain of the
 * first-order filter that tracks the sampling interval, a time constant of 100 samples. */
static const double BRIDGED_MAX = 3, RATE_GAIN = 0.01;

/* Limits of the excitation, the RMS of (alpha x + omega x omega x) of a unit lever arm: least value along the best
 * observable direction, along the worst one, and of the worst as a share of the best. The noise of the gyro alone (0.03
 * deg/s/sqrt(Hz), below 8 Hz) gives 0.05; slow movements by hand give 4 and more, quick ones 50. */
static const double MIN_EXCITATION_S2 = 1, MIN_WORST_EXCITATION_S2 = 0.4, MIN_WORST_SHARE = 0.05;
/* Limits of the residual: constant part for a held point and for a reference, plus a share of the acceleration that the
 * lever arm explains. The optical reference of the recorded trials leaves 0.14 to 0.40 m/s^2. */
static const double MAX_HELD_RESIDUAL_M_S2 = 0.3, MAX_REFERENCE_RESIDUAL_M_S2 = 1, MAX_RESIDUAL_SHARE = 0.1;
/* Limit of noise_sigma_b_m: the larger of both, absolute and as a share of |r|. */
static const double MAX_NOISE_SIGMA_M = 0.005, MAX_NOISE_SIGMA_SHARE = 0.03;
/* When sigma is too large: ratio of the best to the worst excitation from which the axis is named as the cause. */
static const double UNEVEN_RATIO = 3;

const char *lever_verdict_text(enum lever_verdict verdict)
{
	switch (verdict) {
	case LEVER_FOUND:
		return "found";
	case LEVER_TOO_SHORT:
		return "too short: move it for at least 10 s without gaps, better 30 s";
	case LEVER_NO_REFERENCE:
		return "no reference: the acceleration of the reference point was not received often enough";
	case LEVER_TOO_SLOW:
		return "too slow: turn the object back and forth about all its axes, once or twice a second";
	case LEVER_BLIND_L:
		return "turned about the longitudinal axis only, so r along it is not observable: turn about the other "
		       "axes as well";
	case LEVER_BLIND_S:
		return "turned about the side axis only, so r along it is not observable: turn about the other axes as "
		       "well";
	case LEVER_BLIND_T:
		return "turned about the transversal axis only, so r along it is not observable: turn about the other "
		       "axes as well";
	case LEVER_NOT_HELD:
		return "does not fit: the reference point was not held still, or the reference belongs to another "
		       "motion";
	case LEVER_UNSURE:
		return "sigma is too large: turn faster, or for longer";
	case LEVER_SENSOR_LOST:
		return "the sensor stopped sending samples";
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

static void reset_window(struct lever_identification *id)
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

static void merge_blocks(struct lever_identification *id)
{
	for (int i = 0; i < LEVER_BLOCKS / 2; i++) {
		id->block[i] = id->block[2 * i];
		add_block(&id->block[i], &id->block[2 * i + 1]);
	}
	id->blocks = LEVER_BLOCKS / 2;
	id->windows_per_block *= 2;
}

static void store_window(struct lever_identification *id)
{
	if (id->blocks > 0 && id->last_block_windows < id->windows_per_block) {
		add_block(&id->block[id->blocks - 1], &id->window);
		id->last_block_windows++;
		return;
	}
	if (id->blocks == LEVER_BLOCKS)
		merge_blocks(id);
	id->block[id->blocks++] = id->window;
	id->last_block_windows = 1;
}

/* Removes from the products what a constant and a slope of each axis explain. */
static void end_window(struct lever_identification *id)
{
	const double n = id->window_count, spread = n * (n * n - 1) / 12; /* sum of squares of the instants */

	for (int i = 0; i < LEVER_TERMS; i++)
		for (int j = 0; j <= i; j++)
			id->window.product[pair(i, j)] -=
				vec3_dot(id->sum[i], id->sum[j]) / n + vec3_dot(id->moment[i], id->moment[j]) / spread;
	id->window.samples = n;
	store_window(id);
	id->windows++;
	id->window_ended = true;
	reset_window(id);
}

static void accumulate(struct lever_identification *id, const struct vec3 term[LEVER_TERMS])
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

/* Five-point formulas, exact for polynomials of degree 4. With three points an oscillation at a tenth of the sampling
 * rate would lose 7 %. */
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

/* At the middle of the stencil, in the almost inertial frame. */
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
	reset_window(id);
}

static void push(struct lever_identification *id, const struct lever_raw *raw)
{
	if (id->raw_count == LEVER_STENCIL)
		memmove(id->raw, id->raw + 1, (LEVER_STENCIL - 1) * sizeof(*raw));
	else
		id->raw_count++;
	id->raw[id->raw_count - 1] = *raw;
}

/* Attitude of the next sample, from the mean of both rates. */
static struct quat propagate(const struct lever_raw *from, struct vec3 gyro_b_rad_s, double dt_s)
{
	struct vec3 mean = vec3_scale(0.5, vec3_add(from->gyro_b_rad_s, gyro_b_rad_s));

	return quat_normalize(quat_multiply(from->q, quat_from_rotation_vector(vec3_scale(dt_s, mean))));
}

static bool usable(struct vec3 v)
{
	return fabs(v.x) < 1e5 && fabs(v.y) < 1e5 && fabs(v.z) < 1e5; /* false for NaN */
}

static struct vec3 interpolate(struct vec3 a, struct vec3 b, double share)
{
	return vec3_add(a, vec3_scale(share, vec3_sub(b, a)));
}

static void add_sample(struct lever_identification *id, struct lever_raw raw)
{
	struct vec3 term[LEVER_TERMS];

	if (id->raw_count > 0)
		raw.q = propagate(&id->raw[id->raw_count - 1], raw.gyro_b_rad_s, id->dt_s);
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
		accumulate(id, term);
}

/* Interpolates the samples lost before this one, or starts a new window if they are too many. */
static void bridge(struct lever_identification *id, const struct lever_raw *to, double interval_s)
{
	const double intervals = fmax(floor(interval_s * id->config.rate_hz + 0.5), 1);
	const struct lever_raw from = id->raw[id->raw_count > 0 ? id->raw_count - 1 : 0];

	if (!(interval_s > 0 && intervals <= 1 + BRIDGED_MAX))
		lever_identification_break(id);
	if (id->raw_count == 0)
		return;
	id->dt_s += RATE_GAIN * (interval_s / intervals - id->dt_s);
	for (double k = 1; k < intervals; k++)
		add_sample(id, (struct lever_raw){
				       .gyro_b_rad_s = interpolate(from.gyro_b_rad_s, to->gyro_b_rad_s, k / intervals),
				       .force_b_m_s2 = interpolate(from.force_b_m_s2, to->force_b_m_s2, k / intervals),
				       .ref_b_m_s2 = interpolate(from.ref_b_m_s2, to->ref_b_m_s2, k / intervals),
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
	add_sample(id, raw);
}

bool lever_identification_news(const struct lever_identification *id)
{
	return id->window_ended;
}

/* ---- blocks to an estimate --------------------------------------------------------------------------------------- */

/* Row 0: the dependent variable; the other rows: the regressor of each parameter. Each is a linear combination of
 * terms. */
typedef double combination[1 + PARAMETERS][LEVER_TERMS];

/* a_ref(t) = ref(t + delay) to the second order, and its derivative with respect to the delay. */
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

/* Products of the combinations; [0][0] is the square of the dependent variable. */
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
	double inverse[PARAMETERS * PARAMETERS]; /* of the information matrix, for samples of unit variance */
	double noise_variance[3];		 /* of r */
	double residual_m_s2, arm_m_s2;		 /* RMS of the residual, and of what the lever arm explains */
	double delay_s;
	combination c; /* at this delay */
};

static void add_prior(double information[PARAMETERS * PARAMETERS], bool with_delay)
{
	const double variance = PRIOR_NOISE_M_S2 * PRIOR_NOISE_M_S2;

	for (int i = 0; i < 3; i++) {
		information[(PARAMETER_ARM + i) * (PARAMETERS + 1)] += variance / (PRIOR_ARM_M * PRIOR_ARM_M);
		information[(PARAMETER_BIAS + i) * (PARAMETERS + 1)] += variance / (PRIOR_BIAS_M_S2 * PRIOR_BIAS_M_S2);
	}
	/* a delay that is not estimated is known to be 0 */
	information[PARAMETER_DELAY * (PARAMETERS + 1)] +=
		with_delay ? variance / (LEVER_DELAY_MAX_S * LEVER_DELAY_MAX_S) : 1e12;
}

/* One Newton step, linearised at s->delay_s. */
static bool solve_once(const struct lever_block *total, bool with_delay, struct solution *s)
{
	double product[1 + PARAMETERS][1 + PARAMETERS], explained = 0, arm = 0;

	combine(s->delay_s, s->c);
	multiply(total, s->c, product);
	for (int i = 0; i < PARAMETERS; i++)
		for (int j = 0; j < PARAMETERS; j++)
			s->inverse[i * PARAMETERS + j] = product[1 + i][1 + j];
	add_prior(s->inverse, with_delay);
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

/* Cluster-robust variance: the sum over blocks of the squared influence of each (inverse information times score). */
static void estimate_variance(const struct lever_identification *id, bool with_delay, struct solution *s)
{
	const int free_parameters = with_delay ? PARAMETERS : PARAMETERS - 1;
	double product[1 + PARAMETERS][1 + PARAMETERS], score[PARAMETERS];

	for (int b = 0; b < id->blocks; b++) {
		multiply(&id->block[b], s->c, product);
		for (int i = 0; i < PARAMETERS; i++) {
			score[i] = product[1 + i][0];
			for (int j = 0; j < PARAMETERS; j++)
				score[i] -= product[1 + i][1 + j] * s->value[j];
		}
		for (int i = 0; i < 3; i++) {
			double influence = 0;

			for (int j = 0; j < PARAMETERS; j++)
				influence += s->inverse[i * PARAMETERS + j] * score[j];
			s->noise_variance[i] += influence * influence;
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
	estimate_variance(id, with_delay, s);
	return true;
}

/* RMS of (alpha x + omega x omega x) of a unit lever arm along the worst and the best observable direction; the axis
 * next to the worst one. */
struct excitation {
	double worst_s2, best_s2;
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
	e.worst_s2 = 1 / sqrt(values[2] * samples);
	e.best_s2 = 1 / sqrt(values[0] * samples);
	for (int i = 1; i < 3; i++)
		if (fabs(vectors[6 + i]) > fabs(vectors[6 + e.axis]))
			e.axis = i;
	return e;
}

static bool too_noisy(const struct lever_estimate *e)
{
	const double limit_m = fmax(MAX_NOISE_SIGMA_M, MAX_NOISE_SIGMA_SHARE * vec3_norm(e->lever_arm_b_m));
	const struct vec3 n = e->noise_sigma_b_m;

	return !(n.x <= limit_m && n.y <= limit_m && n.z <= limit_m);
}

static enum lever_verdict judge(
	const struct lever_identification *id, const struct solution *s, const struct lever_estimate *e)
{
	const double samples = (double)id->windows * id->window_size;
	const struct excitation x = excitation(s, samples);
	const double limit_m_s2 = (id->config.reference ? MAX_REFERENCE_RESIDUAL_M_S2 : MAX_HELD_RESIDUAL_M_S2) +
				  MAX_RESIDUAL_SHARE * s->arm_m_s2;
	const enum lever_verdict blind = (enum lever_verdict)(LEVER_BLIND_L + x.axis);

	if (!(x.best_s2 >= MIN_EXCITATION_S2))
		return LEVER_TOO_SLOW;
	if (x.worst_s2 < MIN_WORST_EXCITATION_S2 || x.worst_s2 < MIN_WORST_SHARE * x.best_s2)
		return blind;
	if (s->residual_m_s2 > limit_m_s2)
		return LEVER_NOT_HELD;
	if (too_noisy(e))
		return UNEVEN_RATIO * x.worst_s2 < x.best_s2 ? blind : LEVER_UNSURE;
	return LEVER_FOUND;
}

static double hypot3(double a, double b, double c)
{
	return sqrt(a * a + b * b + c * c);
}

/* Noise, systematic errors that the data do not show, and the effect of a delay that was not estimated. */
static struct vec3 total_sigma(const struct lever_estimate *e, struct vec3 by_delay)
{
	const double systematic = hypot(LEVER_POINT_SIGMA_M, LEVER_SCALE_SIGMA * vec3_norm(e->lever_arm_b_m));

	return (struct vec3){hypot3(e->noise_sigma_b_m.x, systematic, by_delay.x),
		hypot3(e->noise_sigma_b_m.y, systematic, by_delay.y),
		hypot3(e->noise_sigma_b_m.z, systematic, by_delay.z)};
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

	if (2 * id->without_reference > id->samples)
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
	e.sigma_b_m = total_sigma(&e, by_delay);
	e.verdict = judge(id, &s, &e);
	return e;
}
