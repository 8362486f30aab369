#include "model/navigation.h"

#include <errno.h>
#include <string.h>

#include "model/math/kalman.h"
#include "model/smoother.h"

enum {
	N = NAVIGATION_STATES,
	THETA = NAVIGATION_THETA,
	V = NAVIGATION_V,
	P = NAVIGATION_P,
	BG = NAVIGATION_BG,
	BA = NAVIGATION_BA
};

static const struct vec3 ZERO = {0, 0, 0};

/* Where a constant is "tuned", its value was chosen for the least position error with honest sigmas on the recorded
 * trials of BROAD and in the simulations of tests/unit/test_navigation.c. Where it is "by judgement", the reason is all
 * there is. */

/* ---- start ---- */

/* rad, 1 sigma of the fusion's attitude when this filter starts (2 degrees). By judgement: a tilt just initialised. */
static const double START_ANGLE_RAD = 0.035;
/* m/s, 1 sigma of the velocity. By judgement: a robot or a hand that does not move yet. */
static const double START_VELOCITY_M_S = 0.1;
/* rad/s, 1 sigma of the gyro bias (0.3 deg/s). By judgement: a calibration at another temperature. */
static const double START_GYRO_BIAS_RAD_S = 0.005;
/* m/s^2, 1 sigma of the accelerometer bias (3 mg). By judgement: what a calibration in six attitudes leaves. */
static const double START_ACCEL_BIAS_M_S2 = 0.03;
/* rad, 1 sigma of an attitude from outside: a degree, as in the fusion. */
static const double SET_ANGLE_RAD = 0.0175;

/* ---- process noise ---- */

/* Random walk of attitude and velocity by errors of scale and cross-axis sensitivity, as a share of rate and
 * acceleration, per square root of a second. A movement to and fro within seconds leaves only a part of these errors
 * behind. With each turn such errors of the accelerometer meet gravity along another axis, so its bias walks, too, up
 * to START_ACCEL_BIAS_M_S2. Tuned: 0.1 % is a calibrated sensor. */
static const double GYRO_SCALE_SQRT_S = 0.001, ACCEL_SCALE_SQRT_S = 0.001;
/* rad/s, 1 sigma by which the gyro bias in motion differs from that at rest: vibration rectification and g-sensitivity.
 * Tuned (0.02 deg/s). */
static const double MOVING_GYRO_BIAS_RAD_S = 0.00035;
/* s, in which biases walk by their instability. By judgement: where the Allan deviation of MEMS sensors has its flat
 * part. */
static const double BIAS_TIME_S = 100;
/* m/s^2, 1 sigma of the acceleration during missing samples. By judgement: a quick robot. */
static const double GAP_ACCEL_M_S2 = 2;

/* ---- standstill ---- */

/* m/s and m/s^2, 1 sigma of velocity and acceleration at a standstill. By judgement: vibration of the support. */
static const double STILL_VELOCITY_M_S = 0.01, STILL_ACCEL_M_S2 = 0.01;
/* rad^2/s^2, variance of the mean rate at a standstill beside the gyro's noise. By judgement: (0.0006 deg/s)^2 keep the
 * innovation variance positive for a gyro without noise. */
static const double STILL_RATE_VARIANCE = 1e-10;
/* s. A shorter standstill does not end a movement. By judgement: a turning point is no place to stop. */
static const double STOOD_S = 1;
/* Sigmas by which velocity and acceleration may differ from zero at a standstill. Convention, as the innovation
 * gate. */
static const double STILL_GATE_SIGMAS = 5;

/* ---- levelling ---- */

/* s, correlation time of the velocity as a measurement of zero. Tuned, at most NAVIGATION_HIGH_PASS_S / (2 pi) = 0.16
 * s, that of the high-passed velocity. */
static const double VELOCITY_CORRELATION_S = 0.1;
/* Square of the greatest velocity of a movement to its mean square. By judgement: 2 for a sine, 3.3 for hand
 * movements. */
static const double CREST2 = 3.3;
/* m/s, least spread. By judgement: slower movements are within the drift of the accelerometer. */
static const double SPREAD_MIN_M_S = 0.05;
/* s into a movement, before which there is no levelling. By judgement: up to then the accelerometer alone is better,
 * and a drive of 5 s came 0.4 m short with levelling. */
static const double LEVELLING_AFTER_S = 5;

/* ---- heading of the fusion ---- */

/* rad, 1 sigma (2 degrees, the fusion's default), and s, correlation time of its error, seen from this filter.
 * Tuned. */
static const double HEADING_SIGMA_RAD = 0.035, HEADING_CORRELATION_S = 3;
/* rad. A heading further off (20 degrees) is another north, and turns attitude and velocity. By judgement. */
static const double HEADING_JUMP_RAD = 0.35;
/* rad, angle between this filter's vertical and the fusion's beyond which this one is re-initialised, and m/s, 1 sigma
 * of the velocity then. By judgement: 0.1 rad are 1 m/s^2 of gravity, as after a start in full motion. */
static const double LOST_RAD = 0.1, LOST_VELOCITY_M_S = 1;
/* s, memory of the mean square difference between both attitudes. By judgement. */
static const double DIFFERENCE_TIME_S = 1;
/* rad, 1 sigma of magnetic north (1.5 degrees), which no time averages out. Tuned: on the trials of BROAD the field of
 * the room points up to 3 to 4 degrees off north. */
static const double NORTH_SIGMA_RAD = 0.026;

/* ---- velocity from outside ---- */

/* s, for which it holds. By judgement: a source at 1 Hz may fail for a while. */
static const double AIDED_S = 5;
/* Sigmas beyond which it is not that of a standstill, and the innovation gate in sigmas. Convention. */
static const double AIDED_SIGMAS = 3, AIDED_GATE_SIGMAS = 5;

int navigation_check(const struct navigation_config *c)
{
	const struct noise_config *noise = &c->noise;
	const double not_negative[] = {c->velocity_prior_m_s, c->rest_s, noise->gyro_density_rad_s_sqrt_hz,
		noise->gyro_bias_instability_rad_s, noise->accel_density_m_s2_sqrt_hz,
		noise->accel_bias_instability_m_s2};

	if (c->levelling != 0 && c->levelling != 1)
		return -EINVAL;
	for (size_t i = 0; i < sizeof(not_negative) / sizeof(not_negative[0]); i++)
		if (!(not_negative[i] >= 0 && isfinite(not_negative[i])))
			return -EINVAL;
	return rest_check(&c->standstill);
}

/* ---- covariance ---- */

/* Three errors from `at` on are independent of all others. */
static void set_variance(struct navigation *n, int at, double variance)
{
	for (int i = at; i < at + 3; i++)
		kalman_set_variance(N, n->p[0], i, variance);
}

/* They are also independent of those in the past, so that estimates from now on do not correct the path before. */
static void reset_errors(struct navigation *n, int at, double variance)
{
	set_variance(n, at, variance);
	smoother_reset_errors(n->smoother, at);
}

static void add_variance(struct navigation *n, int at, double variance)
{
	for (int i = at; i < at + 3; i++)
		n->p[i][i] += variance;
}

static struct vec3 variance(const struct navigation *n, int at)
{
	return (struct vec3){n->p[at][at], n->p[at + 1][at + 1], n->p[at + 2][at + 2]};
}

static void propagate(struct navigation *n)
{
	const struct noise_config *c = &n->config.noise;
	const struct navigation_sums *s = &n->sums;
	double t = s->t_s, walk = squared(c->accel_density_m_s2_sqrt_hz) / 2 * t,
	       (*since_point)[N] = smoother_transition(n->smoother);

	if (since_point)
		navigation_sums_propagate(s, since_point, n->still);
	/* p is symmetric, so F (F p)^T = F p F^T */
	navigation_sums_propagate(s, n->p, n->still);
	kalman_transpose(N, n->p[0]);
	navigation_sums_propagate(s, n->p, n->still);

	add_variance(n, THETA, squared(c->gyro_density_rad_s_sqrt_hz) / 2 * t);
	add_variance(n, THETA, squared(GYRO_SCALE_SQRT_S) * s->turned2_rad2_s / 3);
	add_variance(n, V, walk + squared(ACCEL_SCALE_SQRT_S) * s->accel2_m2_s3 / 3);
	if (!n->still)
		for (int i = 0; i < 3; i++) {
			n->p[P + i][P + i] += walk * t * t / 3;
			n->p[P + i][V + i] += walk * t / 2;
			n->p[V + i][P + i] += walk * t / 2;
		}
	add_variance(n, BG, squared(c->gyro_bias_instability_rad_s) * t / BIAS_TIME_S);
	for (int i = BA; i < BA + 3; i++)
		n->p[i][i] += squared(ACCEL_SCALE_SQRT_S * n->gravity_m_s2) * s->turned2_rad2_s / 3 *
			      fmax(0, 1 - n->p[i][i] / squared(START_ACCEL_BIAS_M_S2));
	add_variance(n, BA, squared(c->accel_bias_instability_m_s2) * t / BIAS_TIME_S);
}

/* ---- measurements: x collects the estimates of the errors until they are applied ---- */

/* row: of the measurement matrix; ph = P row^T; the innovation takes account of x. */
static void update(struct navigation *n, double x[N], const double row[N], const double ph[N], double innovation,
	double innovation_variance)
{
	smoother_measure(n->smoother, row, ph, innovation, innovation_variance);
	kalman_update(N, N, n->p[0], x, ph, innovation, innovation_variance);
}

static void measure(struct navigation *n, double x[N], int at, double measured, double noise)
{
	double ph[N], row[N] = {0};

	row[at] = 1;
	memcpy(ph, n->p[at], sizeof(ph));
	update(n, x, row, ph, measured - x[at], n->p[at][at] + noise);
}

static void measure3(struct navigation *n, double x[N], int at, struct vec3 measured, double noise)
{
	measure(n, x, at, measured.x, noise);
	measure(n, x, at + 1, measured.y, noise);
	measure(n, x, at + 2, measured.z, noise);
}

static struct vec3 part(const double x[N], int at)
{
	return (struct vec3){x[at], x[at + 1], x[at + 2]};
}

static void apply_correction(struct navigation *n, const double x[N])
{
	n->q_nb = quat_normalize(quat_multiply(quat_from_rotation_vector(part(x, THETA)), n->q_nb));
	n->velocity_n_m_s = vec3_add(n->velocity_n_m_s, part(x, V));
	n->position_n_m = vec3_add(n->position_n_m, part(x, P));
	n->gyro_bias_b_rad_s = vec3_add(n->gyro_bias_b_rad_s, part(x, BG));
	n->accel_bias_b_m_s2 = vec3_add(n->accel_bias_b_m_s2, part(x, BA));
}

/* ---- standstill ---- */

/* A value of this variance does not differ significantly from zero, known to this sigma. */
static bool may_be_zero(double value, double var, double sigma)
{
	return squared(value) < squared(STILL_GATE_SIGMAS) * (var + squared(sigma));
}

/* Variance of the acceleration along one axis, whose error is theta x f - R ba. minus_f, r: rows of -[f]x and R. */
static double accel_variance(const struct navigation *n, const double minus_f[3], const double r[3])
{
	const int at[6] = {THETA, THETA + 1, THETA + 2, BA, BA + 1, BA + 2};
	const double row[6] = {minus_f[0], minus_f[1], minus_f[2], -r[0], -r[1], -r[2]};
	double var = 0;

	for (int i = 0; i < 6; i++)
		for (int j = 0; j < 6; j++)
			var += row[i] * n->p[at[i]][at[j]] * row[j];
	return var;
}

static bool velocity_may_be_zero(const struct navigation *n)
{
	struct vec3 v = n->velocity_n_m_s, var = variance(n, V);

	return may_be_zero(v.x, var.x, STILL_VELOCITY_M_S) && may_be_zero(v.y, var.y, STILL_VELOCITY_M_S) &&
	       may_be_zero(v.z, var.z, STILL_VELOCITY_M_S);
}

static bool accel_may_be_zero(const struct navigation *n, double gravity_m_s2)
{
	struct mat3 r = mat3_from_quat(n->q_nb);
	struct vec3 f = mat3_apply(r, vec3_sub(n->rest.accel_mean, n->accel_bias_b_m_s2));
	const struct mat3 minus_f = mat3_minus_cross(f);
	const double accel[3] = {f.x, f.y, f.z - gravity_m_s2};

	for (int i = 0; i < 3; i++)
		if (!may_be_zero(accel[i], 0, STILL_ACCEL_M_S2) && /* mostly it is, and the variance costs more */
			!may_be_zero(accel[i], accel_variance(n, minus_f.m[i], r.m[i]), STILL_ACCEL_M_S2))
			return false;
	return true;
}

/* The detector takes a steady motion, or one that slows down steadily, for a standstill. So velocity and acceleration
 * have to be compatible with zero, unless the contradiction lasts: then they are wrong. */
static bool stands_still(struct navigation *n, const struct navigation_input *in, double dt)
{
	bool rest = rest_step(&n->rest, &n->config.standstill, in->gyro_b_rad_s, in->force_b_m_s2, dt);

	if (!rest || (n->aided_s > 0 && n->aided_in_motion)) {
		n->contradicted_s = 0;
		return false;
	}
	if (velocity_may_be_zero(n) && accel_may_be_zero(n, in->gravity_m_s2)) {
		n->contradicted_s = fmax(0, n->contradicted_s - dt);
		return true;
	}
	n->contradicted_s += dt;
	return n->contradicted_s > n->config.rest_s;
}

/* ---- movements and their measurements ---- */

/* Position and velocity of the reference point. */
static struct smoother_point reference_point(const struct navigation *n, const struct navigation_input *in)
{
	struct vec3 omega = vec3_sub(in->gyro_b_rad_s, n->gyro_bias_b_rad_s);

	return (struct smoother_point){
		.position_n_m = vec3_sub(n->position_n_m, quat_rotate(n->q_nb, in->lever_b_m)),
		.velocity_n_m_s = vec3_sub(n->velocity_n_m_s, quat_rotate(n->q_nb, vec3_cross(omega, in->lever_b_m))),
	};
}

/* From here on the covariance of the position is that of the displacement. Its correlation with errors that are
 * estimated later is dropped, so a movement does not correct the position before it. */
static void begin_movement(struct navigation *n, const struct navigation_input *in)
{
	n->earlier_variance_m2 = vec3_add(n->earlier_variance_m2, variance(n, P));
	set_variance(n, P, 0);
	n->high_pass_n_m_s = ZERO;
	n->high_pass2_max = 0;
	n->lever_known = false;
	n->moving_s = 0;
	n->movements++;
	add_variance(n, BG, squared(MOVING_GYRO_BIAS_RAD_S));
	smoother_begin(n->smoother, reference_point(n, in), n->p);
}

static void measure_standstill(struct navigation *n, double x[N])
{
	double t = n->sums.t_s;

	measure3(n, x, V, vec3_sub(ZERO, n->velocity_n_m_s), squared(STILL_VELOCITY_M_S));
	measure3(n, x, BG, vec3_scale(1 / t, n->sums.turned_b_rad),
		squared(n->config.noise.gyro_density_rad_s_sqrt_hz) / 2 / t + STILL_RATE_VARIANCE);
}

/* Variance of one component of the reference point's velocity, estimated from its high-pass. u: the lever arm's
 * velocity. */
static double velocity_spread2(struct navigation *n, struct vec3 u_n_m_s, double gravity_m_s2)
{
	double t = n->sums.t_s;
	struct vec3 change = vec3_sub(n->sums.f, (struct vec3){0, 0, gravity_m_s2 * t});

	if (n->lever_known)
		change = vec3_sub(change, vec3_sub(u_n_m_s, n->lever_n_m_s));
	n->lever_n_m_s = u_n_m_s;
	n->lever_known = true;
	n->high_pass_n_m_s =
		vec3_scale(NAVIGATION_HIGH_PASS_S / (NAVIGATION_HIGH_PASS_S + t), vec3_add(n->high_pass_n_m_s, change));
	n->high_pass2_max = fmax(n->high_pass2_max, vec3_dot(n->high_pass_n_m_s, n->high_pass_n_m_s));
	return n->high_pass2_max / 3 / CREST2 + squared(SPREAD_MIN_M_S);
}

/* A measurement of the sum row . errors. */
static void measure_row(struct navigation *n, double x[N], const double row[N], double measured, double noise)
{
	double ph[N] = {0}, innovation = measured, innovation_variance = noise;

	for (int i = 0; i < N; i++)
		for (int j = 0; j < N; j++)
			ph[i] += n->p[i][j] * row[j];
	for (int i = 0; i < N; i++) {
		innovation_variance += row[i] * ph[i];
		innovation -= row[i] * x[i];
	}
	update(n, x, row, ph, innovation, innovation_variance);
}

/* The sensor's velocity relative to the reference point is u = R (omega x r). With the errors of attitude and gyro bias
 * it is u + theta x u - R (bg x r). off: measured velocity of the sensor less the estimated one. */
static void measure_reference_velocity(
	struct navigation *n, double x[N], struct vec3 off, struct vec3 u_n_m_s, struct vec3 lever_b_m, double noise)
{
	struct vec3 u = u_n_m_s, r = quat_rotate(n->q_nb, lever_b_m);
	const double u_cross[3][3] = {{0, -u.z, u.y}, {u.z, 0, -u.x}, {-u.y, u.x, 0}};
	const double r_cross[3][3] = {{0, -r.z, r.y}, {r.z, 0, -r.x}, {-r.y, r.x, 0}}, offs[3] = {off.x, off.y, off.z};
	struct mat3 r_nb = mat3_from_quat(n->q_nb);

	for (int i = 0; i < 3; i++) {
		double row[N] = {0};

		row[V + i] = 1;
		for (int j = 0; j < 3; j++) {
			row[THETA + j] = u_cross[i][j];
			for (int k = 0; k < 3; k++)
				row[BG + j] -= r_cross[i][k] * r_nb.m[k][j];
		}
		measure_row(n, x, row, offs[i], noise);
	}
}

static void measure_velocity(struct navigation *n, double x[N], const struct navigation_input *in)
{
	struct vec3 omega = vec3_sub(in->gyro_b_rad_s, n->gyro_bias_b_rad_s);
	struct vec3 u = quat_rotate(n->q_nb, vec3_cross(omega, in->lever_b_m));
	double spread2 = velocity_spread2(n, u, in->gravity_m_s2);

	n->moving_s = n->aided_s > 0 ? 0 : n->moving_s + n->sums.t_s;
	if (n->config.velocity_prior_m_s > 0)
		spread2 = squared(n->config.velocity_prior_m_s);
	else if (!n->config.levelling || n->moving_s < LEVELLING_AFTER_S)
		return;
	measure_reference_velocity(
		n, x, vec3_sub(u, n->velocity_n_m_s), u, in->lever_b_m, spread2 * VELOCITY_CORRELATION_S / n->sums.t_s);
}

static void turn_heading(struct navigation *n, double angle_rad)
{
	struct quat turn = quat_from_rotation_vector((struct vec3){0, 0, angle_rad});

	n->q_nb = quat_multiply(turn, n->q_nb);
	n->velocity_n_m_s = quat_rotate(turn, n->velocity_n_m_s);
	smoother_break(n->smoother);
}

/* Starts again with the fusion's attitude, as if the reference point stood still, when the tilt is too far from it.
 * Returns whether it did. */
static bool reinitialise_if_lost(struct navigation *n, const struct navigation_input *in)
{
	struct vec3 up = quat_rotate_inverse(in->q_nb, (struct vec3){0, 0, 1});
	struct vec3 off = quat_rotate(n->q_nb, up);

	if (off.z > 0 && hypot(off.x, off.y) < LOST_RAD)
		return false;
	n->q_nb = in->q_nb;
	n->velocity_n_m_s = quat_rotate(n->q_nb, vec3_cross(in->gyro_b_rad_s, in->lever_b_m));
	n->gyro_bias_b_rad_s = n->accel_bias_b_m_s2 = ZERO;
	reset_errors(n, THETA, squared(START_ANGLE_RAD));
	reset_errors(n, V, squared(LOST_VELOCITY_M_S));
	reset_errors(n, BG, squared(START_GYRO_BIAS_RAD_S));
	reset_errors(n, BA, squared(START_ACCEL_BIAS_M_S2));
	n->high_pass_n_m_s = ZERO;
	n->high_pass2_max = 0;
	n->lever_known = false;
	return true;
}

static void measure_heading(struct navigation *n, double x[N], struct quat q_fused)
{
	struct vec3 difference = quat_to_rotation_vector(quat_multiply(q_fused, quat_conjugate(n->q_nb))),
		    *mean = &n->fusion_difference2_rad2;
	double t = n->sums.t_s, share = t / (DIFFERENCE_TIME_S + t);

	if (fabs(difference.z) > HEADING_JUMP_RAD) {
		turn_heading(n, difference.z);
		difference.z = 0;
	}
	measure(n, x, THETA + 2, difference.z, squared(HEADING_SIGMA_RAD) * HEADING_CORRELATION_S / t);
	mean->x += share * (difference.x * difference.x - mean->x);
	mean->y += share * (difference.y * difference.y - mean->y);
	mean->z += share * (difference.z * difference.z - mean->z);
}

static void correct(struct navigation *n, const struct navigation_input *in)
{
	double x[N] = {0};

	if (reinitialise_if_lost(n, in))
		return;
	if (n->still)
		measure_standstill(n, x);
	else
		measure_velocity(n, x, in);
	measure_heading(n, x, in->q_nb);
	apply_correction(n, x);
}

/* ---- steps ---- */

void navigation_start(struct navigation *n, const struct navigation_config *config, struct quat q_nb)
{
	struct navigation fresh = {.config = *config, .q_nb = q_nb, .started = true};

	smoother_cancel(n->smoother);
	fresh.smoother = n->smoother;
	fresh.position_n_m = n->position_n_m;
	fresh.gravity_m_s2 = 9.81;
	fresh.earlier_variance_m2 = vec3_add(n->earlier_variance_m2, variance(n, P));
	set_variance(&fresh, THETA, squared(START_ANGLE_RAD));
	set_variance(&fresh, V, squared(START_VELOCITY_M_S));
	set_variance(&fresh, BG, squared(START_GYRO_BIAS_RAD_S));
	set_variance(&fresh, BA, squared(START_ACCEL_BIAS_M_S2));
	*n = fresh;
}

void navigation_skip(struct navigation *n, struct quat q_nb, double dt_s)
{
	n->q_nb = q_nb;
	smoother_elapse(n->smoother, dt_s);
	reset_errors(n, THETA, squared(START_ANGLE_RAD));
	add_variance(n, V, squared(GAP_ACCEL_M_S2 * dt_s));
	add_variance(
		n, P, dt_s * dt_s * (vec3_dot(n->velocity_n_m_s, n->velocity_n_m_s) + squared(GAP_ACCEL_M_S2 * dt_s)));
	memset(&n->sums, 0, sizeof(n->sums));
	rest_restart(&n->rest);
	n->still = n->ended_by_reset = n->last_gyro_known = n->lever_known = false;
}

static void integrate(struct navigation *n, const struct navigation_input *in, double dt)
{
	struct vec3 omega = vec3_sub(in->gyro_b_rad_s, n->gyro_bias_b_rad_s), before = n->velocity_n_m_s, force, accel;
	struct vec3 last = n->last_gyro_known ? vec3_sub(n->last_gyro_b_rad_s, n->gyro_bias_b_rad_s) : omega;
	struct mat3 r_nb;

	n->q_nb = quat_multiply(n->q_nb, quat_from_rotation_vector(rotation_between(last, omega, dt)));
	r_nb = mat3_from_quat(n->q_nb);
	force = mat3_apply(r_nb, vec3_sub(in->force_b_m_s2, n->accel_bias_b_m_s2));
	accel = vec3_sub(force, (struct vec3){0, 0, in->gravity_m_s2});
	navigation_sums_add(&n->sums, &r_nb, omega, force, accel, dt);
	n->velocity_n_m_s = vec3_add(before, vec3_scale(dt, accel));
	if (!n->still)
		n->position_n_m = vec3_add(n->position_n_m, vec3_scale(dt / 2, vec3_add(before, n->velocity_n_m_s)));
	n->last_gyro_known = true;
	n->last_gyro_b_rad_s = in->gyro_b_rad_s;
}

static void record(struct navigation *n, const struct navigation_input *in)
{
	if (!smoother_transition(n->smoother))
		return;
	smoother_mark(n->smoother, reference_point(n, in), n->p);
	if (n->still && n->stood_s > STOOD_S)
		smoother_end(n->smoother, n->stood_s, n->p);
}

bool navigation_step(struct navigation *n, const struct navigation_input *in, double dt_s)
{
	bool still = stands_still(n, in, dt_s), ended;

	if (n->still && !still && (n->stood_s > STOOD_S || n->ended_by_reset))
		begin_movement(n, in);
	n->ended_by_reset &= still;
	smoother_elapse(n->smoother, dt_s);
	n->aided_s = fmax(0, n->aided_s - dt_s);
	n->stood_s = still ? n->stood_s + dt_s : 0;
	n->still = still;
	n->gravity_m_s2 = in->gravity_m_s2;
	n->fusion_variance_rad2 = in->attitude_variance_rad2;
	integrate(n, in, dt_s);
	ended = n->sums.t_s >= NAVIGATION_INTERVAL_S;
	if (ended) {
		propagate(n);
		correct(n, in);
		memset(&n->sums, 0, sizeof(n->sums));
		record(n, in);
	}
	if (n->reset_in_motion)
		smoother_restart(n->smoother, reference_point(n, in), n->p);
	n->reset_in_motion = false;
	return ended;
}

void navigation_aid_velocity(struct navigation *n, struct vec3 velocity_n_m_s, double sigma_m_s,
	struct vec3 omega_b_rad_s, struct vec3 lever_b_m)
{
	struct vec3 u = quat_rotate(n->q_nb, vec3_cross(omega_b_rad_s, lever_b_m)), var = variance(n, V);
	struct vec3 off = vec3_sub(vec3_add(velocity_n_m_s, u), n->velocity_n_m_s);
	double x[N] = {0};

	if (vec3_dot(off, off) > squared(AIDED_GATE_SIGMAS) * (var.x + var.y + var.z + 3 * squared(sigma_m_s))) {
		n->velocity_n_m_s = vec3_add(velocity_n_m_s, u);
		reset_errors(n, V, squared(sigma_m_s));
	} else {
		measure_reference_velocity(n, x, off, u, lever_b_m, squared(sigma_m_s));
		apply_correction(n, x);
	}
	n->aided_s = AIDED_S;
	n->aided_in_motion = vec3_norm(velocity_n_m_s) > AIDED_SIGMAS * sigma_m_s + STILL_VELOCITY_M_S;
}

void navigation_set_attitude(struct navigation *n, struct quat q_nb)
{
	n->velocity_n_m_s = quat_rotate(q_nb, quat_rotate_inverse(n->q_nb, n->velocity_n_m_s));
	n->q_nb = q_nb;
	n->last_gyro_known = false;
	reset_errors(n, THETA, squared(SET_ANGLE_RAD));
	memset(&n->sums, 0, sizeof(n->sums));
}

void navigation_reset_position(struct navigation *n)
{
	if (n->still)
		smoother_end(n->smoother, n->stood_s, n->p);
	n->position_n_m = n->earlier_variance_m2 = ZERO;
	set_variance(n, P, 0);
	n->ended_by_reset = n->still;
	n->reset_in_motion = !n->still;
}

/* ---- 1 sigma ---- */

static struct vec3 root(struct vec3 a)
{
	return (struct vec3){sqrt(fmax(a.x, 0)), sqrt(fmax(a.y, 0)), sqrt(fmax(a.z, 0))};
}

/* Variance of the fusion's attitude: its own, or if it has none, this filter's plus the mean square difference of both.
 * In addition the accelerometer's bias tilts what is taken for gravity, and the error of north does not average out. */
static struct vec3 attitude_variance(const struct navigation *n)
{
	struct vec3 var = n->fusion_variance_rad2, bias = variance(n, BA);
	double tilt = (bias.x + bias.y + bias.z) / 3 / squared(n->gravity_m_s2);

	if (vec3_dot(var, var) == 0)
		var = vec3_add(variance(n, THETA), n->fusion_difference2_rad2);
	return vec3_add(var, (struct vec3){tilt, tilt, squared(NORTH_SIGMA_RAD)});
}

struct navigation_sigma navigation_sigma(const struct navigation *n, double rate_hz)
{
	struct vec3 angle = attitude_variance(n), bias = variance(n, BA);
	double force =
		squared(n->config.noise.accel_density_m_s2_sqrt_hz) * rate_hz / 2 + (bias.x + bias.y + bias.z) / 3;
	double g2 = squared(n->gravity_m_s2);

	return (struct navigation_sigma){
		.attitude_rad = root(angle),
		.accel_m_s2 = root((struct vec3){g2 * angle.y + force, g2 * angle.x + force, force}),
		.velocity_m_s = root(variance(n, V)),
		.position_m = root(vec3_add(n->earlier_variance_m2, variance(n, P))),
		.displacement_m = root(variance(n, P)),
	};
}
