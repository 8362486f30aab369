#include "model/zero_velocity.h"

#include <string.h>

#include "model/math/kalman.h"
#include "model/navigation.h"

enum { N = NAVIGATION_STATES, V = NAVIGATION_V, P = NAVIGATION_P, BG = NAVIGATION_BG, BA = NAVIGATION_BA };

static const struct vec3 ZERO = {0, 0, 0};

/* ---- begin of a motion ---- */

/* m/s, 1 sigma of the velocity of what stands, beside its vibration. By judgement: a support that settles. */
static const double STANDS_M_S = 0.002;
/* m/s, the same at the moment of the fork. By judgement: the zero-velocity updates have averaged it. */
static const double FORK_M_S = 0.001;
/* s between two forks, and for how long a motion may have lasted before it is seen. Tuned in simulation: 0.05 m/s
 * reached within a second are seen by a fork of 1 s; from 2 s on the tilt's random walk hides them. */
static const double FORK_S = 0.75;
/* s, within which a motion begins that a fork should see. By judgement: vehicles and axes. */
static const double BEGUN_S = 1;
/* Sigmas of a fork's velocity beyond which a motion has begun; and while the object turns, which it rarely does in
 * place. Tuned in simulation: of days at rest (make soak), in which 5 raise a false alarm once in a day or so. Most are
 * made up for within seconds, since the odds of standing are high after them; some cost the position. */
static const double BEGIN_SIGMAS = 6, BEGIN_TURNING_SIGMAS = 3;
/* Squared sigmas of a fork's velocity from which on its displacement counts in the variance: between the mean of the
 * chi-squared distribution of 3 degrees of freedom and the limit. */
static const double BEGIN_DOUBT = 3;
/* Instabilities of the accelerometer by which its mean over a few seconds differs from that before the fork. By
 * judgement: the difference of two means is 1.4 of them, and recorded chips drift by twice the figure of the
 * datasheet. */
static const double INSTABILITIES = 2;
/* As in navigation.c: share of the acceleration by which the velocity walks. */
static const double ACCEL_SCALE_SQRT_S = 0.001;

/* ---- vibration ---- */

/* s, time constant of the high-pass that parts vibration (above 5 Hz) from motion, and of the one that removes
 * gravity's remains before; memory of its mean square. By judgement: a hand or an arm moves at 2 Hz at most. */
static const double VIBRATION_S = 0.03, VIBRATION_BASE_S = 0.1, VIBRATION_MEMORY_S = 0.3;
/* s, memory of the deviations while it stands; factor by which they may be exceeded by what stands. By judgement: a
 * mean square over 0.15 s of noise scatters by half. */
static const double QUIET_MEMORY_S = 1, QUIET_FACTOR = 3;
/* rad^2/s^2, least limit of the gyro's deviation. By judgement: (0.02 deg/s)^2, less than a digit of the gyros. */
static const double QUIET_GYRO2 = 1e-7;

/* ---- odds ---- */

/* m/s, scales of the speed of steady motions, beside the slowest. A decade and a half in steps of a factor 4 to 5: no
 * scale is preferred. */
static const double SPEED_M_S[] = {0.15, 0.7, 3};
enum { SPEEDS = sizeof(SPEED_M_S) / sizeof(SPEED_M_S[0]) };
/* Prior share of quiet motion, as if observed for PRIOR_S: one in a hundred is for a carrier with wheels or a hand, and
 * is overruled within a second by a carrier that is known to cruise quietly. The least share that observation can lead
 * to. */
static const double PRIOR_QUIET = 0.01, PRIOR_S = 1, LEAST_QUIET = 0.0025;
/* Least share of quiet motion where samples are missing: an acceleration may have been there, and what was seen of the
 * others is evidence as weak as the velocity has become unknown. By judgement. */
static const double UNSEEN_QUIET = 0.3;
/* s, without steadiness after a gap: what stood before it moves. By judgement: the time of the detector, and more. */
static const double UNSTEADY_S = 0.4;
/* Odds of moving when a motion has begun, and the time in which an observation that the odds rest on loses its weight.
 * By judgement: a false alarm, or a stop too gentle to be seen, is made up for within minutes. */
static const double BEGIN_ODDS = 10, ODDS_MEMORY_S = 20;
/* Odds at most that what moved before a gap still does. By judgement: one gap in fifty hides a stop. */
static const double SKIP_ODDS = 50;
/* Sigmas and m/s beyond which a change of the velocity is an acceleration since the odds were taken. By judgement. */
static const double CHANGE_SIGMAS = 3, CHANGE_M_S = 0.01;
/* Weight of standing above which it stands, once that has held for STANDING_S; and below which a motion is known as
 * such. By judgement. */
static const double STANDS_WEIGHT = 0.95, MOVES_WEIGHT = 0.05;
/* Weight below which the mixture is the motion alone. Numerical limit. */
static const double LEAST_WEIGHT = 0.001;
/* The exponent of a likelihood ratio is limited to that. Numerical limit. */
static const double MOST_EXPONENT = 500;
/* s, in which the odds that what is as quiet as it stood moves nevertheless fall to 1 / e; and what they are at most,
 * since once in a while a knock leaves a velocity behind that is wrong by any amount. By judgement: a quiet motion of a
 * minute is usual, and the longest integration time by default; one of ten minutes is neither. So a false alarm ends
 * after three to four minutes if the velocity has become unknown meanwhile, and after a quarter of an hour if not. */
static const double CRUISE_S = 60, MOST_QUIET_ODDS = 1e5;

/* Inverse of the symmetric, positive definite a; returns the determinant of a. */
static double invert3(double a[3][3], double inverse[3][3])
{
	double determinant = 0;

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++) {
			int i1 = (i + 1) % 3, i2 = (i + 2) % 3, j1 = (j + 1) % 3, j2 = (j + 2) % 3;

			inverse[j][i] = a[i1][j1] * a[i2][j2] - a[i1][j2] * a[i2][j1];
		}
	for (int j = 0; j < 3; j++)
		determinant += a[0][j] * inverse[j][0];
	for (int i = 0; i < 9; i++)
		inverse[i / 3][i % 3] /= determinant;
	return determinant;
}

/* Inverse and determinant of the velocity's covariance plus `variance` on each horizontal axis and `vertical`. */
static double invert_velocity(const double p[N][N], double variance, double vertical, double inverse[3][3])
{
	double s[3][3];

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			s[i][j] = p[V + i][V + j] + (i == j ? (i < 2 ? variance : vertical) : 0);
	return invert3(s, inverse);
}

static double quadratic(double a[3][3], struct vec3 v)
{
	const double x[3] = {v.x, v.y, v.z};
	double sum = 0;

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			sum += x[i] * a[i][j] * x[j];
	return sum;
}

void zero_velocity_vibration(struct zero_velocity *z, struct vec3 accel_n_m_s2, double beside_m2_s2, double dt_s)
{
	struct vec3 off = vec3_sub(accel_n_m_s2, z->accel_low_n_m_s2), *v = &z->vibration_n_m_s;

	*v = vec3_scale(VIBRATION_S / (VIBRATION_S + dt_s), vec3_add(*v, vec3_scale(dt_s, off)));
	z->accel_low_n_m_s2 = vec3_add(z->accel_low_n_m_s2, vec3_scale(dt_s / (VIBRATION_BASE_S + dt_s), off));
	z->fast_vibration_m2_s2 += dt_s / (VIBRATION_MEMORY_S + dt_s) * (vec3_dot(*v, *v) - z->fast_vibration_m2_s2);
	z->vibration_m2_s2 = z->fast_vibration_m2_s2 + beside_m2_s2;
}

/* Prior share of quiet motion. */
static double quiet_share(const struct zero_velocity *z)
{
	double learnt = (z->moved_quietly_s + PRIOR_QUIET * PRIOR_S) / (z->moved_s + PRIOR_S);

	if (!z->unseen)
		return fmax(LEAST_QUIET, learnt);
	return z->unsteady_s < UNSTEADY_S ? PRIOR_QUIET : fmax(UNSEEN_QUIET, learnt);
}

static void forget(struct zero_velocity *z)
{
	for (int i = 0; i < ZERO_VELOCITY_FORKS; i++)
		z->forks[i].set = false;
	z->weight = z->standing_s = 0;
	z->position_shift_n_m = z->velocity_shift_n_m_s = z->position_variance_m2 = z->velocity_variance_m2_s2 = ZERO;
}

void zero_velocity_skip(struct zero_velocity *z, bool standing)
{
	double odds = fmin(SKIP_ODDS, (1 - z->weight) / fmax(z->weight, LEAST_WEIGHT));

	z->unseen = true;
	z->unsteady_s = standing ? 0 : UNSTEADY_S;
	if (!standing)
		z->least_odds = fmax(z->least_odds, odds / quiet_share(z));
	forget(z);
}

void zero_velocity_restart(struct zero_velocity *z, bool moving)
{
	forget(z);
	z->least_odds = moving ? BEGIN_ODDS : 0;
	z->quiet_s = z->unsteady_s = 0;
	z->unseen = false;
}

bool zero_velocity_quiet_for_long(const struct zero_velocity *z)
{
	return z->quiet_s >= CRUISE_S;
}

void zero_velocity_settle(struct zero_velocity *z)
{
	double quietly_s = fmin(z->quiet_s, z->moved_quietly_s);

	z->moved_quietly_s -= quietly_s;
	z->moved_s -= quietly_s;
	zero_velocity_restart(z, false);
}

/* ---- it stands ---- */

static void begin_fork(struct zero_velocity_fork *f, const struct zero_velocity *z, const struct navigation *n,
	struct vec3 lever_n_m_s, struct vec3 doubtful_m_s)
{
	const double doubtful[3] = {doubtful_m_s.x, doubtful_m_s.y, doubtful_m_s.z};

	*f = (struct zero_velocity_fork){.set = true,
		.gyro_bias_b_rad_s = n->gyro_bias_b_rad_s,
		.accel_bias_b_m_s2 = n->accel_bias_b_m_s2,
		.start_n_m = n->position_n_m,
		.position_n_m = n->position_n_m,
		.velocity_n_m_s = lever_n_m_s};
	memcpy(f->p, n->p, sizeof(f->p));
	for (int i = 0; i < 3; i++)
		kalman_set_variance(N, f->p[0], V + i, squared(FORK_M_S) + squared(doubtful[i]) + z->vibration_m2_s2);
	f->r_nb = mat3_from_quat(n->q_nb);
	navigation_accel_variance(n, f->accel_variance_m2_s4);
	f->bias_variance_rad2_s2 = (f->p[BG][BG] + f->p[BG + 1][BG + 1] + f->p[BG + 2][BG + 2]) / 3;
}

/* The navigation's sums are in its own attitude and with its own biases: a small rotation and a difference of the
 * biases away from the fork's. */
static void integrate_fork(struct zero_velocity_fork *f, const struct navigation *n, double dt_s)
{
	const struct navigation_sums *s = &n->sums;
	struct vec3 less_bias = mat3_apply(s->s, vec3_sub(n->accel_bias_b_m_s2, f->accel_bias_b_m_s2));
	struct vec3 ff = vec3_add(s->ff, vec3_scale(dt_s / 2, s->f)); /* by the trapezoidal rule, as the position is */
	struct vec3 v = vec3_add(vec3_add(s->f, vec3_cross(f->apart_rad, s->f)), less_bias), p;

	p = vec3_add(vec3_add(ff, vec3_cross(f->apart_rad, ff)), vec3_scale(s->t_s / 2, less_bias));
	v.z -= n->gravity_m_s2 * s->t_s;
	p.z -= n->gravity_m_s2 * s->t_s * s->t_s / 2;
	f->position_n_m = vec3_add(f->position_n_m, vec3_add(vec3_scale(s->t_s, f->velocity_n_m_s), p));
	f->velocity_n_m_s = vec3_add(f->velocity_n_m_s, v);
	f->apart_rad = vec3_add(f->apart_rad, mat3_apply(s->s, vec3_sub(n->gyro_bias_b_rad_s, f->gyro_bias_b_rad_s)));
	navigation_sums_append(&f->sums, s);
}

void zero_velocity_integrate(struct zero_velocity *z, const struct navigation *n, double dt_s)
{
	for (int i = 0; i < ZERO_VELOCITY_FORKS; i++)
		if (z->forks[i].set)
			integrate_fork(&z->forks[i], n, dt_s);
}

/* m^2/s^2, variance of the velocity along axis i by the accelerometer's bias: at the moment of the fork the tilt makes
 * up for it, until the object turns. */
static double turned_bias_variance(const struct zero_velocity_fork *f, int i)
{
	double sum = 0;

	for (int j = 0; j < 3; j++)
		sum += squared(f->sums.s.m[i][j] - f->sums.t_s * f->r_nb.m[i][j]) * f->p[BA + j][BA + j];
	return sum;
}

/* Squared distance of the fork's velocity from zero in sigmas. The diagonal of the covariance that
 * navigation_sums_propagate() would give: accelerometer noise, the acceleration's error at the fork, and tilt by the
 * gyro's noise and bias. */
static double distance2(const struct zero_velocity_fork *f, const struct zero_velocity *z, const struct navigation *n,
	struct vec3 lever_n_m_s)
{
	const struct noise_config *noise = &n->noise;
	struct vec3 v = vec3_sub(f->velocity_n_m_s, lever_n_m_s);
	const double x[3] = {v.x, v.y, v.z}, t = f->sums.t_s, g2 = squared(n->gravity_m_s2);
	const double by_tilt = g2 * (squared(noise->gyro_density_rad_s_sqrt_hz) / 2 * t * t * t / 3 +
					    f->bias_variance_rad2_s2 * t * t * t * t / 4);
	const double walk = fmax(squared(noise->accel_density_m_s2_sqrt_hz) / 2, z->accel_walk_m2_s3);
	const double by_lever = f->bias_variance_rad2_s2 * vec3_dot(n->lever_b_m, n->lever_b_m);
	double sum = 0;

	for (int i = 0; i < 3; i++) {
		double variance =
			by_lever + f->p[V + i][V + i] + z->vibration_m2_s2 + squared(STANDS_M_S) +
			(f->accel_variance_m2_s4[i] + squared(INSTABILITIES * noise->accel_bias_instability_m_s2)) * t *
				t +
			walk * t + turned_bias_variance(f, i) + squared(ACCEL_SCALE_SQRT_S) * f->sums.accel2_m2_s3 / 3 +
			(i < 2 ? by_tilt : 0);

		sum += x[i] * x[i] / variance;
	}
	return sum;
}

double zero_velocity_slowest_seen_m_s(const struct noise_config *noise, double gravity_m_s2)
{
	const double t = BEGUN_S, gyro = noise->gyro_density_rad_s_sqrt_hz, accel = noise->accel_density_m_s2_sqrt_hz;
	double by_tilt = squared(gravity_m_s2 * gyro) / 2 * t * t * t / 3;
	double by_bias = squared(INSTABILITIES * noise->accel_bias_instability_m_s2 * t);

	return BEGIN_SIGMAS *
	       sqrt(squared(FORK_M_S) + squared(STANDS_M_S) + squared(accel) / 2 * t + by_bias + by_tilt);
}

static void observe_quiet(struct zero_velocity *z, const struct zero_velocity_signals *s, double t_s)
{
	double share = z->quiet_accel2_m2_s4 > 0 ? fmin(1, t_s / QUIET_MEMORY_S) : 1;

	if (!s->steady)
		return;
	z->quiet_gyro2_rad2_s2 += share * (s->gyro2_rad2_s2 - z->quiet_gyro2_rad2_s2);
	z->quiet_accel2_m2_s4 += share * (s->accel2_m2_s4 - z->quiet_accel2_m2_s4);
	z->accel_walk_m2_s3 += share * (s->accel_walk_m2_s3 - z->accel_walk_m2_s3);
}

/* The youngest fork that began before the motion knows the velocity best. */
static struct zero_velocity_fork *before_motion(struct zero_velocity *z)
{
	int i = ZERO_VELOCITY_FORKS - 1;

	while (i > 0 && z->forks[i - 1].set && z->forks[i].sums.t_s < FORK_S)
		i--;
	return &z->forks[i];
}

struct zero_velocity_fork *zero_velocity_stands(struct zero_velocity *z, const struct navigation *n,
	const struct zero_velocity_signals *signals, struct vec3 turned_rad, struct vec3 lever_n_m_s, bool turning,
	double t_s)
{
	const double limit = squared(turning ? BEGIN_TURNING_SIGMAS : BEGIN_SIGMAS);
	struct zero_velocity_fork *youngest = &z->forks[ZERO_VELOCITY_FORKS - 1];
	struct vec3 doubtful_m_s = ZERO; /* 1 sigma of what the youngest fork says that it moves already */
	bool begun = false;

	observe_quiet(z, signals, t_s);
	z->weight = z->standing_s = 0;
	z->position_shift_n_m = z->velocity_shift_n_m_s = z->position_variance_m2 = z->velocity_variance_m2_s2 = ZERO;
	for (int i = 0; i < ZERO_VELOCITY_FORKS; i++) {
		struct zero_velocity_fork *f = &z->forks[i];
		struct vec3 way = vec3_sub(f->position_n_m, n->position_n_m);
		double d2, doubt;

		if (!f->set)
			continue;
		f->apart_rad = vec3_sub(f->apart_rad, turned_rad);
		d2 = distance2(f, z, n, lever_n_m_s);
		doubt = fmax(0, fmin(1, (d2 - BEGIN_DOUBT) / (limit - BEGIN_DOUBT)));
		z->position_variance_m2 = vec3_add(z->position_variance_m2,
			vec3_scale(doubt, (struct vec3){way.x * way.x, way.y * way.y, way.z * way.z}));
		doubtful_m_s = vec3_scale(sqrt(doubt), vec3_sub(f->velocity_n_m_s, lever_n_m_s));
		begun |= d2 > limit;
	}
	if (begun)
		return before_motion(z);
	if (youngest->set && youngest->sums.t_s < FORK_S)
		return NULL;
	if (youngest->set)
		memmove(&z->forks[0], &z->forks[1], (ZERO_VELOCITY_FORKS - 1) * sizeof(z->forks[0]));
	begin_fork(youngest, z, n, lever_n_m_s, doubtful_m_s);
	return NULL;
}

/* ---- it moves ---- */

static bool is_quiet(const struct zero_velocity *z, const struct zero_velocity_signals *s)
{
	bool unknown = z->quiet_accel2_m2_s4 == 0;

	return s->steady &&
	       (unknown || (s->accel2_m2_s4 < QUIET_FACTOR * z->quiet_accel2_m2_s4 &&
				   s->gyro2_rad2_s2 < QUIET_FACTOR * z->quiet_gyro2_rad2_s2 + QUIET_GYRO2));
}

/* Likelihood of moving steadily, at a speed of any of the scales alike, as a multiple of that of standing. level: what
 * moves does so horizontally. */
static double likelihood_ratio(const struct zero_velocity *z, const struct navigation *n, struct vec3 velocity_n_m_s,
	double slowest_m_s, bool level)
{
	double inverse[3][3], noise = squared(STANDS_M_S) + z->vibration_m2_s2, sum = 0;
	double determinant = invert_velocity(n->p, noise, noise, inverse),
	       distance = quadratic(inverse, velocity_n_m_s);

	for (int i = -1; i < SPEEDS; i++) {
		double speed = i < 0 ? slowest_m_s : fmax(slowest_m_s, SPEED_M_S[i]);
		double wider =
			invert_velocity(n->p, noise + squared(speed), level ? noise : noise + squared(speed), inverse);
		double exponent = (distance - quadratic(inverse, velocity_n_m_s)) / 2;

		sum += exp(fmin(MOST_EXPONENT, exponent)) * sqrt(determinant / wider);
	}
	return sum / (SPEEDS + 1);
}

/* The moments of the mixture. "It stands" is the state after a measurement of zero velocity. */
static void mix(struct zero_velocity *z, const struct navigation *n, struct vec3 velocity_n_m_s)
{
	const double v[3] = {velocity_n_m_s.x, velocity_n_m_s.y, velocity_n_m_s.z}, w = z->weight;
	double inverse[3][3], shift[2][3], variance[2][3];

	z->position_shift_n_m = z->velocity_shift_n_m_s = z->position_variance_m2 = z->velocity_variance_m2_s2 = ZERO;
	if (w < LEAST_WEIGHT)
		return;
	invert_velocity(
		n->p, squared(STANDS_M_S) + z->vibration_m2_s2, squared(STANDS_M_S) + z->vibration_m2_s2, inverse);
	for (int k = 0; k < 2; k++)
		for (int i = 0; i < 3; i++) {
			const double *row = n->p[(k ? V : P) + i];
			double by_update = 0, less = 0;

			for (int j = 0; j < 3; j++) {
				double gain = row[V] * inverse[0][j] + row[V + 1] * inverse[1][j] +
					      row[V + 2] * inverse[2][j];

				by_update -= gain * v[j];
				less += gain * row[V + j];
			}
			shift[k][i] = w * by_update;
			variance[k][i] = w * (1 - w) * squared(by_update) - w * less;
		}
	z->position_shift_n_m = (struct vec3){shift[0][0], shift[0][1], shift[0][2]};
	z->velocity_shift_n_m_s = (struct vec3){shift[1][0], shift[1][1], shift[1][2]};
	z->position_variance_m2 = (struct vec3){variance[0][0], variance[0][1], variance[0][2]};
	z->velocity_variance_m2_s2 = (struct vec3){variance[1][0], variance[1][1], variance[1][2]};
}

/* The velocity has changed since the odds were taken, by more than the acceleration's error makes of it. */
static bool has_accelerated(const struct zero_velocity *z, const struct navigation *n, struct vec3 velocity_n_m_s)
{
	struct vec3 change = vec3_sub(velocity_n_m_s, z->odds_velocity_n_m_s);
	double a[3], t = z->odds_age_s, noise = squared(n->noise.accel_density_m_s2_sqrt_hz) / 2 * t;

	navigation_accel_variance(n, a);
	return vec3_dot(change, change) > squared(CHANGE_SIGMAS) * ((a[0] + a[1] + a[2]) * t * t + 3 * noise +
									   z->vibration_m2_s2 + squared(CHANGE_M_S));
}

static void update_odds(
	struct zero_velocity *z, const struct navigation *n, struct vec3 velocity_n_m_s, double odds, double t_s)
{
	double most = z->quiet_s > 0 ? MOST_QUIET_ODDS : INFINITY;

	odds = fmin(odds, most);
	z->least_odds = fmin(z->least_odds * (1 - t_s / ODDS_MEMORY_S), most);
	z->odds_age_s += t_s;
	if (odds < z->least_odds && !has_accelerated(z, n, velocity_n_m_s))
		return;
	z->least_odds = odds;
	z->odds_velocity_n_m_s = velocity_n_m_s;
	z->odds_age_s = 0;
}

/* What stands feels the same force all the time; what swings passes a moment at which it stands. */
static void stand(struct zero_velocity *z, const struct zero_velocity_signals *s, double t_s)
{
	struct vec3 change = vec3_sub(s->force_n_m_s2, z->standing_force_n_m_s2);

	if (z->weight <= STANDS_WEIGHT) {
		z->standing_s = 0;
		return;
	}
	if (z->standing_s == 0 || vec3_dot(change, change) > s->force_change2_m2_s4) {
		z->standing_s = 0;
		z->standing_force_n_m_s2 = s->force_n_m_s2;
	}
	z->standing_s += t_s;
}

/* A motion that is known as such. */
static void learn(struct zero_velocity *z, bool quiet, double t_s)
{
	if (z->quiet_accel2_m2_s4 == 0)
		return;
	z->moved_s += t_s;
	z->moved_quietly_s += quiet ? t_s : 0;
}

void zero_velocity_moves(struct zero_velocity *z, const struct navigation *n,
	const struct zero_velocity_signals *signals, struct vec3 velocity_n_m_s, double slowest_m_s, bool known,
	double t_s)
{
	bool quiet = is_quiet(z, signals) && !known;
	double odds = likelihood_ratio(z, n, velocity_n_m_s, slowest_m_s, signals->level);

	z->unsteady_s += z->unseen && !signals->steady ? t_s : 0;
	z->weight = 0;
	z->quiet_s = quiet ? z->quiet_s + t_s : 0;
	/* nothing accelerates evenly for so long: its tilt or bias is another */
	if (known || (signals->accelerates && z->quiet_s < CRUISE_S)) {
		z->least_odds = z->standing_s = 0;
		if (odds > 1 / MOVES_WEIGHT)
			learn(z, quiet, t_s);
		mix(z, n, velocity_n_m_s);
		return;
	}
	update_odds(z, n, velocity_n_m_s, odds, t_s);
	z->weight = 1 / (1 + z->least_odds * (quiet ? quiet_share(z) * exp(-z->quiet_s / CRUISE_S) : 1));
	stand(z, signals, t_s);
	if (z->weight < MOVES_WEIGHT)
		learn(z, quiet, t_s);
	mix(z, n, velocity_n_m_s);
}
