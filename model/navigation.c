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

/* What each preset assumes. */
static const struct assumptions {
	double slowest_m_s; /* of a steady motion */
	double creep_m_s;   /* of what turns, and seems to turn in place */
	bool dwell;	    /* what is steady for long enough stands, whatever its velocity is estimated to be */
	bool levelling;	    /* the velocity averages out */
	bool stances;	    /* short ones, in which a foot rolls on */
	bool stands_steady; /* what is not steady (it turns, or vibrates) does not stand */
	bool guided;	    /* it does not turn while it moves, see guide.h, */
	bool vertical;	    /* .. and moves vertically */
	bool hangs;	    /* it hangs on a rope, see rope.h */
} ASSUMPTIONS[MOTION_PRESETS] = {
	[MOTION_ANY] = {.slowest_m_s = 0.03, .creep_m_s = 0.03},
	[MOTION_HAND_HELD] = {.dwell = true, .levelling = true},
	[MOTION_ROBOT_BASE] = {.slowest_m_s = 0.1},
	[MOTION_LINEAR_AXIS] = {.slowest_m_s = 0.3, .stands_steady = true, .guided = true},
	[MOTION_ARM] = {.slowest_m_s = 0.03},
	[MOTION_FOOT] = {.dwell = true, .stances = true},
	[MOTION_VERTICAL_LIFT] = {.slowest_m_s = 0.3, .stands_steady = true, .guided = true, .vertical = true},
	[MOTION_HANGING_LOAD] = {.slowest_m_s = 0.1, .hangs = true},
};

static const struct assumptions *assumptions(const struct navigation *n)
{
	return &ASSUMPTIONS[n->config.preset];
}

static bool levels(const struct navigation *n)
{
	return n->config.levelling || assumptions(n)->levelling;
}

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
/* m/s^2, 1 sigma of the accelerometer bias (6 mg), and where the motion goes to and fro and averages part of it out
 * (3 mg). By judgement: what a calibration in six attitudes leaves, with half a percent of gravity by scale and
 * alignment. */
static const double START_ACCEL_BIAS_M_S2 = 0.06, DWELL_ACCEL_BIAS_M_S2 = 0.03;
/* rad, 1 sigma of an attitude from outside: a degree, as in the fusion. */
static const double SET_ANGLE_RAD = 0.0175;

/* ---- process noise ---- */

/* Random walk of attitude and velocity by errors of scale and cross-axis sensitivity, as a share of rate and
 * acceleration, per square root of a second. A movement to and fro within seconds leaves only a part of these errors
 * behind. With each turn such errors of the accelerometer meet gravity along another axis, so its bias walks, too, up
 * to START_ACCEL_BIAS_M_S2. Tuned: 0.1 % is a calibrated sensor. */
static const double GYRO_SCALE_SQRT_S = 0.001, ACCEL_SCALE_SQRT_S = 0.001;
/* 1 sigma of the accelerometer's scale and alignment, as a share of the way: no standstill shows it, since its effect
 * on the velocity vanishes with it. By judgement: a calibrated sensor. */
static const double ACCEL_SCALE = 0.003;
/* 1 sigma of the gyro's scale and alignment, as a share of the angle turned since the last standstill: what a
 * movement in one direction leaves behind. By judgement: a calibrated sensor. */
static const double GYRO_SCALE = 0.003;
/* rad, of a turn beyond which an error of alignment does not grow any more. Derived: half a turn, less what is
 * averaged. */
static const double ALIGNED_TURN_RAD = 2;
/* rad/s, 1 sigma by which the gyro bias in motion differs from that at rest: vibration rectification and g-sensitivity.
 * Tuned (0.02 deg/s). */
static const double MOVING_GYRO_BIAS_RAD_S = 0.00035;
/* 1 sigma by which the accelerometer's bias at a standstill differs from that in the movement before it, as a share
 * of the root mean square of the acceleration: errors of scale and alignment that meet it as the object turns to and
 * fro, by an angle of the rate times that time. By judgement: a calibrated sensor; a hand or an arm. */
static const double MOVING_ACCEL_SHARE = 0.006, MOVING_TURN_S = 0.3;
/* s, in which biases walk by their instability. By judgement: where the Allan deviation of MEMS sensors has its flat
 * part. */
static const double BIAS_TIME_S = 100;
/* s, correlation time of what vibration and clipping do to the force. By judgement: as long as an engine keeps its
 * speed. */
static const double FORCE_ERROR_S = 10;
/* s, correlation time of the error by the accelerometer's steps in a motion. By judgement: that of its force. */
static const double STEPS_ERROR_S = 1;

/* ---- standstill ---- */

/* m/s and m/s^2, 1 sigma of velocity and acceleration at a standstill. By judgement: vibration of the support. */
static const double STILL_VELOCITY_M_S = 0.01, STILL_ACCEL_M_S2 = 0.01;
/* m/s, 1 sigma of the velocity of a foot in its stance, and of the mean error that rolling feet leave behind: no
 * number of steps averages it out, and the swings inherit it. Tuned on recorded walks and on simulated feet that roll
 * 8 mm a step. */
static const double STANCE_M_S = 0.03, STANCE_CREEP_M_S = 0.01;
/* m, from the sensor to the point on which the foot rolls; s, for which it may have accelerated as it does now. Both
 * add to the velocity in a stance, at its end most of all. By judgement: half a shoe, and the detector's window. */
static const double STANCE_PIVOT_M = 0.1, STANCE_END_S = 0.1;
/* rad^2/s^2, variance of the mean rate at a standstill beside the gyro's noise. By judgement: (0.0006 deg/s)^2 keep the
 * innovation variance positive for a gyro without noise. */
static const double STILL_RATE_VARIANCE = 1e-10;
/* s. A shorter standstill does not end a movement. By judgement: a turning point is no place to stop. */
static const double STOOD_S = 1;
/* Sigmas by which velocity and acceleration may differ from zero at a standstill that is detected by dwell.
 * Convention, as the innovation gate. */
static const double STILL_GATE_SIGMAS = 5;
/* Sigmas beyond which the mean acceleration is significant. Tuned in simulation: a robot that comes to rest from 0.05
 * m/s within a second is seen to. */
static const double ACCEL_SIGMAS = 2.5;
/* .. and at one by the hypotheses. Convention. */
static const double CONTRADICTED_SIGMAS = 3;
/* m/s, 1 sigma of the velocity at a standstill by the hypotheses of zero_velocity.h, beside its vibration. By
 * judgement. */
static const double ZERO_VELOCITY_M_S = 0.003;
/* s of odds for a standstill before it is one. By judgement: a turning point is no place to stop. */
static const double STANDING_S = 0.4;
/* s, memory of the mean rate at a standstill, and sigmas beyond which the object turns. By judgement. */
static const double MEAN_RATE_S = 0.5, TURNING_SIGMAS = 3;
/* s, for which a motion that has just begun, and an acceleration, count as one. By judgement. */
static const double BEGIN_S = 1, ACCELERATED_S = 0.3;
/* s, memories of the slow and of the usual mean force; m/s^2 and sigmas of noise beyond which the mean force changes;
 * s, for which it may then stay where it is, off zero by a sigma. Tuned in simulation: loads that swing on 8 to 30 m by
 * half a degree do not rest at their turning points, and a cruise that ends gently does not tilt. */
static const double SLOW_FORCE_S = 1, USUAL_FORCE_S = 10, SAME_FORCE_M_S2 = 0.02, CHANGE_SIGMAS = 3, CHANGED_S = 4;

/* s for which a load on a rope must be steady to stand. By judgement: longer than at the turning point of a swing on
 * 50 m. */
static const double HUNG_STILL_S = 3;

/* s. After a longer gap nothing is known of how it moved before, as at the start. By judgement. */
static const double FORGOTTEN_S = 10;

/* ---- levelling ---- */

/* s, correlation time of the velocity as a measurement of zero. Tuned: at most NAVIGATION_HIGH_PASS_S / (2 pi) = 0.16
 * s, that of the high-passed velocity; less, since a motion to and fro averages out sooner than noise does. Smaller:
 * the position drifts less over a minute, and sigma is smaller. */
static const double VELOCITY_CORRELATION_S = 0.05;
/* Square of the greatest velocity of a movement to its mean square. By judgement: 2 for a sine, 3.3 for hand
 * movements. */
static const double CREST2 = 3.3;
/* m/s, least spread. By judgement: slower movements are within the drift of the accelerometer. */
static const double SPREAD_MIN_M_S = 0.05;
/* s into a movement, before which there is no levelling, and in which its weight rises to the whole. By judgement: up
 * to then the accelerometer alone is better, a drive of 5 s came 0.4 m short with levelling, and half a wave of the
 * motion would pass for its mean. */
static const double LEVELLING_AFTER_S = 4, LEVELLING_RISES_S = 2;

/* ---- heading of the fusion ---- */

/* rad, 1 sigma (2 degrees, the fusion's default), and s, correlation time of its error, seen from this filter.
 * Tuned. */
static const double HEADING_SIGMA_RAD = 0.035, HEADING_CORRELATION_S = 3;
/* rad. A heading further off (20 degrees) is another north, and turns attitude and velocity. One that the fusion
 * knows worse is unknown. By judgement. */
static const double HEADING_JUMP_RAD = 0.35;
/* Mean square of the chord that any turn takes, as a share of the radius. Derived: mean of 4 sin^2(angle / 2). */
static const double UNKNOWN_CHORD2 = 2;
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

static double start_accel_bias_m_s2(const struct navigation *n)
{
	return fmax(
		n->config.accel_bias_sigma_m_s2, assumptions(n)->dwell ? DWELL_ACCEL_BIAS_M_S2 : START_ACCEL_BIAS_M_S2);
}

static double start_gyro_bias_rad_s(const struct navigation *n)
{
	return fmax(n->config.gyro_bias_sigma_rad_s, START_GYRO_BIAS_RAD_S);
}

/* 1 sigma of the scales, and of the random walks by them. */
static double gyro_scale(const struct navigation *n)
{
	return fmax(n->config.gyro_scale_sigma, GYRO_SCALE);
}

static double gyro_scale_sqrt_s(const struct navigation *n)
{
	return GYRO_SCALE_SQRT_S / GYRO_SCALE * gyro_scale(n);
}

static double accel_scale(const struct navigation *n)
{
	return fmax(n->config.accel_scale_sigma, ACCEL_SCALE);
}

static double accel_scale_sqrt_s(const struct navigation *n)
{
	return ACCEL_SCALE_SQRT_S / ACCEL_SCALE * accel_scale(n);
}

int navigation_check(const struct navigation_config *c)
{
	const struct noise_config *noise = &c->noise;
	const double not_negative[] = {c->velocity_prior_m_s, c->rope_m, c->rest_s, c->gyro_bias_sigma_rad_s,
		c->gyro_scale_sigma, c->accel_bias_sigma_m_s2, c->accel_scale_sigma, noise->gyro_density_rad_s_sqrt_hz,
		noise->gyro_bias_instability_rad_s, noise->accel_density_m_s2_sqrt_hz,
		noise->accel_bias_instability_m_s2, noise->gyro_bias_per_K_rad_s, noise->accel_bias_per_K_m_s2};

	if (c->preset < 0 || c->preset >= MOTION_PRESETS || (c->levelling != 0 && c->levelling != 1))
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

static void add_variances(struct navigation *n, int at, struct vec3 variance)
{
	n->p[at][at] += variance.x;
	n->p[at + 1][at + 1] += variance.y;
	n->p[at + 2][at + 2] += variance.z;
}

static void add_variance(struct navigation *n, int at, double variance)
{
	add_variances(n, at, (struct vec3){variance, variance, variance});
}

static struct vec3 variance(const struct navigation *n, int at)
{
	return (struct vec3){n->p[at][at], n->p[at + 1][at + 1], n->p[at + 2][at + 2]};
}

/* m^2/s^2, each axis: of the sensor's velocity relative to the reference point by the noise of the mean rate of t_s. */
static double lever_noise(const struct navigation *n, double t_s)
{
	return squared(n->noise.gyro_density_rad_s_sqrt_hz) / 2 / t_s * vec3_dot(n->lever_b_m, n->lever_b_m);
}

static double guide_walk(const struct navigation *n)
{
	return guide_walk_m2_s3(n->noise.gyro_density_rad_s_sqrt_hz, n->gravity_m_s2);
}

static void propagate(struct navigation *n, const struct navigation_sums *s)
{
	const struct noise_config *c = &n->noise;
	double t = s->t_s, walk = squared(c->accel_density_m_s2_sqrt_hz) / 2 * t,
	       (*since_point)[N] = smoother_transition(n->smoother);

	if (since_point)
		navigation_sums_propagate(s, since_point, n->still);
	/* p is symmetric, so F (F p)^T = F p F^T */
	navigation_sums_propagate(s, n->p, n->still);
	kalman_transpose(N, n->p[0]);
	navigation_sums_propagate(s, n->p, n->still);
	kalman_symmetrize(N, n->p[0]);

	if (s->held) {
		for (int i = V; i < V + 2; i++)
			n->p[i][i] += guide_walk(n) * t;
	} else {
		add_variance(n, THETA, squared(c->gyro_density_rad_s_sqrt_hz) / 2 * t);
		add_variance(n, THETA, squared(gyro_scale_sqrt_s(n)) * s->turned2_rad2_s / 3);
	}
	add_variance(n, V,
		walk + squared(accel_scale_sqrt_s(n)) * s->accel2_m2_s3 / 3 +
			2 * FORCE_ERROR_S * n->force_variance_m2_s3);
	n->force_variance_m2_s3 = 0;
	if (!n->still)
		for (int i = 0; i < 3; i++) {
			n->p[P + i][P + i] += walk * t * t / 3;
			n->p[P + i][V + i] += walk * t / 2;
			n->p[V + i][P + i] += walk * t / 2;
		}
	add_variance(n, BG, squared(c->gyro_bias_instability_rad_s) * t / BIAS_TIME_S);
	for (int i = BA; i < BA + 3; i++)
		n->p[i][i] += squared(accel_scale_sqrt_s(n) * n->gravity_m_s2) * s->turned2_rad2_s / 3 *
			      fmax(0, 1 - n->p[i][i] / squared(start_accel_bias_m_s2(n)));
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

/* The reference point of what stands stays where it is. */
static void turn_to(struct navigation *n, struct quat q_nb)
{
	if (n->still)
		n->position_n_m = vec3_add(
			n->position_n_m, vec3_sub(quat_rotate(q_nb, n->lever_b_m), quat_rotate(n->q_nb, n->lever_b_m)));
	n->q_nb = q_nb;
}

static void apply_correction(struct navigation *n, const double x[N])
{
	turn_to(n, quat_normalize(quat_multiply(quat_from_rotation_vector(part(x, THETA)), n->q_nb)));
	n->velocity_n_m_s = vec3_add(n->velocity_n_m_s, part(x, V));
	n->position_n_m = vec3_add(n->position_n_m, part(x, P));
	n->gyro_bias_b_rad_s = vec3_add(n->gyro_bias_b_rad_s, part(x, BG));
	n->accel_bias_b_m_s2 = vec3_add(n->accel_bias_b_m_s2, part(x, BA));
	if (assumptions(n)->hangs)
		rope_correct(&n->rope, part(x, THETA), part(x, BA));
}

/* ---- standstill ---- */

/* A value of this variance does not differ significantly from zero, known to this sigma. */
static bool may_be_zero(double value, double var, double sigma, double sigmas)
{
	return squared(value) < squared(sigmas) * (var + squared(sigma));
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

void navigation_accel_variance(const struct navigation *n, double variance_m2_s4[3])
{
	const struct mat3 r = mat3_from_quat(n->q_nb), minus_f = mat3_minus_cross((struct vec3){0, 0, n->gravity_m_s2});

	for (int i = 0; i < 3; i++)
		variance_m2_s4[i] = accel_variance(n, minus_f.m[i], r.m[i]);
}

/* m/s, 1 sigma of the velocity at a standstill by dwell. */
static double still_velocity_m_s(const struct navigation *n)
{
	return assumptions(n)->stances ? STANCE_M_S : STILL_VELOCITY_M_S;
}

static bool velocity_may_be_zero(const struct navigation *n)
{
	struct vec3 v = n->velocity_n_m_s, var = variance(n, V);
	double sigma = still_velocity_m_s(n);

	return may_be_zero(v.x, var.x, sigma, STILL_GATE_SIGMAS) && may_be_zero(v.y, var.y, sigma, STILL_GATE_SIGMAS) &&
	       may_be_zero(v.z, var.z, sigma, STILL_GATE_SIGMAS);
}

static struct vec3 mean_force(const struct navigation *n)
{
	return quat_rotate(n->q_nb, vec3_sub(n->rest.accel_mean, n->accel_bias_b_m_s2));
}

static bool accel_may_be_zero(const struct navigation *n, double gravity_m_s2, double sigmas)
{
	struct mat3 r = mat3_from_quat(n->q_nb);
	struct vec3 f = mean_force(n);
	const struct mat3 minus_f = mat3_minus_cross(f);
	const double accel[3] = {f.x, f.y, f.z - gravity_m_s2};

	for (int i = 0; i < 3; i++)
		if (!may_be_zero(
			    accel[i], 0, STILL_ACCEL_M_S2, sigmas) && /* mostly it is, and the variance costs more */
			!may_be_zero(accel[i], accel_variance(n, minus_f.m[i], r.m[i]), STILL_ACCEL_M_S2, sigmas))
			return false;
	return true;
}

static bool aided_to_move(const struct navigation *n)
{
	return n->aided_s > 0 && n->aided_in_motion;
}

/* By dwell: the detector takes a steady motion, or one that slows down steadily, for a standstill. So velocity and
 * acceleration have to be compatible with zero, unless the contradiction lasts: then they are wrong. A foot accelerates
 * in its stance, too. */
static bool stands_by_dwell(struct navigation *n, bool steady, double gravity_m_s2, double dt)
{
	if (!steady || aided_to_move(n)) {
		n->contradicted_s = 0;
		n->assumed = false;
		return false;
	}
	if (velocity_may_be_zero(n) &&
		(assumptions(n)->stances || accel_may_be_zero(n, gravity_m_s2, STILL_GATE_SIGMAS))) {
		n->contradicted_s = fmax(0, n->contradicted_s - dt);
		return true;
	}
	n->contradicted_s += dt;
	if (n->contradicted_s <= n->config.rest_s)
		return false;
	if (!n->assumed) /* it may have moved on for that long */
		add_variance(n, P, vec3_dot(n->velocity_n_m_s, n->velocity_n_m_s) * squared(n->config.rest_s));
	n->assumed = true;
	return true;
}

static bool hangs(const struct navigation *n)
{
	return assumptions(n)->hangs && n->rope.given_m > 0;
}

/* A load that may be at the turning point of a swing. */
static bool swings(const struct navigation *n)
{
	return hangs(n) && n->stood && n->rest.still_s < HUNG_STILL_S;
}

/* By the hypotheses: a standstill lasts until the motion that ends it is seen to begin. */
static bool stands_still(struct navigation *n, const struct navigation_input *in, double dt)
{
	bool steady = rest_step(&n->rest, &n->config.standstill, vec3_sub(in->gyro_b_rad_s, in->gyro_bias_b_rad_s),
		in->force_b_m_s2, dt);

	if (assumptions(n)->dwell)
		return stands_by_dwell(n, steady, in->gravity_m_s2, dt);
	if (swings(n) && !n->still)
		return false;
	return !aided_to_move(n) && (n->still || n->zero_velocity.standing_s > STANDING_S);
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

static bool vertical(const struct navigation *n)
{
	return assumptions(n)->vertical && !n->guide.inclined;
}

static double share_of_scale(const struct navigation *n)
{
	return guide_share_of_scale(n->config.accel_bias_sigma_m_s2, accel_scale(n), n->gravity_m_s2);
}

/* Variance of the position since the reset, less that of the displacement and of earlier movements. Errors of scale
 * add up on ways in one direction and cancel on the way back, so they follow from the distance, not from the
 * movements. */
static struct vec3 by_accel_scale(const struct navigation *n, double distance2_m2)
{
	double way2 = distance2_m2 - n->way2_max_m2, variance = squared(accel_scale(n)) * way2;

	if (vertical(n))
		return (struct vec3){guide_plumb_m2(way2), guide_plumb_m2(way2), (1 - share_of_scale(n)) * variance};
	return (struct vec3){variance, variance, variance};
}

/* Of all movements but errors of scale. */
static struct vec3 end_displacement(struct navigation *n)
{
	struct vec3 earlier = vec3_add(n->earlier_variance_m2, vec3_add(variance(n, P), by_accel_scale(n, 0)));

	n->way2_max_m2 = 0;
	n->way_from_n_m = n->position_n_m;
	return earlier;
}

/* From here on the covariance of the position is that of the displacement. Its correlation with errors that are
 * estimated later is dropped, so a movement does not correct the position before it. */
static void begin_movement(struct navigation *n, struct smoother_point here)
{
	n->earlier_variance_m2 = end_displacement(n);
	set_variance(n, P, 0);
	n->high_pass_n_m_s = ZERO;
	n->high_pass2_max = 0;
	n->lever_known = false;
	n->moving_s = 0;
	memset(n->bounded_s, 0, sizeof(n->bounded_s));
	n->movements++;
	n->begin_n_m = here.position_n_m;
	add_variance(n, BG, squared(MOVING_GYRO_BIAS_RAD_S));
	smoother_begin(n->smoother, here, n->p);
}

/* The bias that shows at a standstill is not quite that of the movement before it. */
static void end_movement(struct navigation *n)
{
	double accel2 = n->moved_accel2_m2_s3 / n->moved_s, rate2 = n->moved_turned2_rad2_s / n->moved_s;

	add_variance(n, BA, squared(MOVING_ACCEL_SHARE) * accel2 * fmin(1, squared(MOVING_TURN_S) * rate2));
	n->moved_s = n->moved_accel2_m2_s3 = n->moved_turned2_rad2_s = 0;
}

static void measure_reference_velocity(
	struct navigation *n, double x[N], struct vec3 off, struct vec3 u_n_m_s, struct vec3 lever_b_m, double noise);

/* The reference point stands; the object may turn about it, and does so when the mean rate differs from its bias. */
static void measure_zero_velocity(struct navigation *n, double x[N], const struct navigation_input *in)
{
	struct vec3 rate = vec3_scale(1 / n->sums.t_s, n->sums.turned_b_rad), bias = variance(n, BG);
	struct vec3 u = quat_rotate(n->q_nb, vec3_cross(rate, in->lever_b_m)), *mean = &n->mean_rate_b_rad_s;
	double share = n->sums.t_s / (MEAN_RATE_S + n->sums.t_s);
	double noise = 3 * squared(n->noise.gyro_density_rad_s_sqrt_hz) / 2 / MEAN_RATE_S + STILL_RATE_VARIANCE;

	*mean = vec3_add(*mean, vec3_scale(share, vec3_sub(rate, *mean)));
	n->turning = vec3_dot(*mean, *mean) > squared(TURNING_SIGMAS) * (bias.x + bias.y + bias.z + noise);
	measure_reference_velocity(n, x, vec3_sub(u, n->velocity_n_m_s), u, in->lever_b_m,
		squared(ZERO_VELOCITY_M_S) + n->zero_velocity.vibration_m2_s2);
}

/* The mean rate is the gyro's bias. */
static bool rate_is_bias(const struct navigation *n)
{
	if (assumptions(n)->stances)
		return n->stood_s > STOOD_S;
	return assumptions(n)->dwell || (n->rest.still_s > n->config.standstill.time_s && !n->turning);
}

/* m^2/s^2, variance of the velocity at a standstill by dwell. */
static double still_variance(const struct navigation *n)
{
	double t = n->sums.t_s, rate = vec3_norm(n->sums.turned_b_rad) / t;
	double accel = vec3_norm(vec3_sub(n->sums.f, (struct vec3){0, 0, n->gravity_m_s2 * t})) / t;

	if (!assumptions(n)->stances)
		return squared(STILL_VELOCITY_M_S);
	return squared(STANCE_M_S) + squared(STANCE_PIVOT_M * rate) + squared(STANCE_END_S * accel);
}

static void measure_standstill(struct navigation *n, double x[N], const struct navigation_input *in)
{
	double t = n->sums.t_s;

	if (assumptions(n)->dwell)
		measure3(n, x, V, vec3_sub(ZERO, n->velocity_n_m_s), still_variance(n));
	else
		measure_zero_velocity(n, x, in);
	if (rate_is_bias(n))
		measure3(n, x, BG, vec3_scale(1 / t, n->sums.turned_b_rad),
			squared(n->noise.gyro_density_rad_s_sqrt_hz) / 2 / t + STILL_RATE_VARIANCE);
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
 * it is u + theta x u - R (bg x r). off: measured velocity of the sensor less the estimated one, along this axis. */
static void measure_reference_axis(struct navigation *n, double x[N], int axis, double off, struct vec3 u_n_m_s,
	struct vec3 lever_b_m, double noise)
{
	struct vec3 u = u_n_m_s, r = quat_rotate(n->q_nb, lever_b_m);
	const double u_cross[3][3] = {{0, -u.z, u.y}, {u.z, 0, -u.x}, {-u.y, u.x, 0}};
	const double r_cross[3][3] = {{0, -r.z, r.y}, {r.z, 0, -r.x}, {-r.y, r.x, 0}};
	struct mat3 r_nb = mat3_from_quat(n->q_nb);
	double row[N] = {0};

	row[V + axis] = 1;
	for (int j = 0; j < 3; j++) {
		row[THETA + j] = u_cross[axis][j];
		for (int k = 0; k < 3; k++)
			row[BG + j] -= r_cross[axis][k] * r_nb.m[k][j];
	}
	measure_row(n, x, row, off, noise);
}

static void measure_reference_velocity(
	struct navigation *n, double x[N], struct vec3 off, struct vec3 u_n_m_s, struct vec3 lever_b_m, double noise)
{
	measure_reference_axis(n, x, 0, off.x, u_n_m_s, lever_b_m, noise);
	measure_reference_axis(n, x, 1, off.y, u_n_m_s, lever_b_m, noise);
	measure_reference_axis(n, x, 2, off.z, u_n_m_s, lever_b_m, noise);
}

/* Where the velocity is less certain than the user's prior, the prior brings its variance down to its own, and never
 * further: what keeps its velocity says the same all the time, and the position is off by the velocity times the time
 * since the prior was needed. */
static void bound_velocity(
	struct navigation *n, double x[N], struct vec3 off, struct vec3 u_n_m_s, struct vec3 lever_b_m)
{
	const double offs[3] = {off.x, off.y, off.z}, prior = squared(n->config.velocity_prior_m_s);

	if (prior == 0)
		return;
	for (int i = 0; i < 3; i++) {
		double known = n->p[V + i][V + i];

		if (known <= prior)
			continue;
		measure_reference_axis(n, x, i, offs[i], u_n_m_s, lever_b_m, known * prior / (known - prior));
		n->bounded_s[i] += n->sums.t_s;
		n->p[P + i][P + i] += 2 * prior * n->bounded_s[i] * n->sums.t_s;
	}
}

static void measure_velocity(struct navigation *n, double x[N], const struct navigation_input *in)
{
	struct vec3 omega = vec3_sub(in->gyro_b_rad_s, n->gyro_bias_b_rad_s);
	struct vec3 u = quat_rotate(n->q_nb, vec3_cross(omega, in->lever_b_m)), off = vec3_sub(u, n->velocity_n_m_s);
	double spread2 = velocity_spread2(n, u, in->gravity_m_s2), weight = 1;

	n->moving_s = n->aided_s > 0 ? 0 : n->moving_s + n->sums.t_s;
	if (!levels(n)) {
		bound_velocity(n, x, off, u, in->lever_b_m);
		return;
	}
	if (n->config.velocity_prior_m_s > 0)
		spread2 = squared(n->config.velocity_prior_m_s);
	else
		weight = fmin((n->moving_s - LEVELLING_AFTER_S) / LEVELLING_RISES_S, 1);
	if (weight > 0)
		measure_reference_velocity(
			n, x, off, u, in->lever_b_m, spread2 * VELOCITY_CORRELATION_S / weight / n->sums.t_s);
}

/* In vertical rails the sensor's horizontal velocity is zero. */
static void measure_vertical(struct navigation *n, double x[N])
{
	double noise = guide_sway_m2_s(n->velocity_n_m_s.z) / n->sums.t_s;

	measure(n, x, V, -n->velocity_n_m_s.x, noise);
	measure(n, x, V + 1, -n->velocity_n_m_s.y, noise);
}

/* Of the sum row . errors. */
static double measured_variance(const struct navigation *n, const double row[N])
{
	double sum = 0;

	for (int i = 0; i < N; i++)
		for (int j = 0; j < N; j++)
			sum += row[i] * n->p[i][j] * row[j];
	return sum;
}

/* Of the measurement matrix, for one axis of a difference. */
static void rope_row(double row[N], const struct rope_difference *d, int axis)
{
	struct mat3 minus_force = mat3_minus_cross(d->force_n_m);

	for (int j = 0; j < 3; j++) {
		row[THETA + j] = minus_force.m[axis][j];
		row[BA + j] = -d->turned_s2.m[axis][j];
	}
}

static bool moves_steadily(const struct navigation *n, const struct rope_difference *d)
{
	const double point[3] = {d->point_n_m.x, d->point_n_m.y, d->point_n_m.z},
		     up[3] = {d->up_n.x, d->up_n.y, d->up_n.z};

	for (int i = 0; i < 3; i++) {
		double row[N] = {0}, variance = d->variance_m2 + n->rope.length_variance_m2 * squared(up[i]);

		rope_row(row, d, i);
		if (squared(point[i]) > squared(ROPE_SIGMAS) * (variance + measured_variance(n, row)))
			return false;
	}
	return true;
}

/* When there is another difference: those that count, and those before and after them, must be of a steady motion. The
 * tilt is not corrected as long as that might be an error of the length. */
static void measure_rope(struct navigation *n, double x[N])
{
	struct rope *rope = &n->rope;
	struct rope_difference d[ROPE_DIFFERENCES], *middle = &d[2];

	for (int i = 0; i < ROPE_DIFFERENCES; i++)
		d[i] = rope_difference(rope, i, &n->noise, n->gravity_m_s2);
	rope->steady = moves_steadily(n, &d[3]) ? rope->steady + 1 : 0;
	n->hangs_still &= rope->steady > 0;
	if (rope->steady < ROPE_DIFFERENCES)
		return;
	rope_measure_length(rope, &d[1], middle);
	*middle = rope_difference(rope, 2, &n->noise, n->gravity_m_s2);
	if (rope->length_variance_m2 * vec3_dot(middle->up_n, middle->up_n) > middle->variance_m2)
		return;
	const double point[3] = {middle->point_n_m.x, middle->point_n_m.y, middle->point_n_m.z};
	const double up[3] = {middle->up_n.x, middle->up_n.y, middle->up_n.z};
	for (int i = 0; i < 3; i++) {
		double row[N] = {0};

		rope_row(row, middle, i);
		measure_row(n, x, row, -point[i], middle->variance_m2 + rope->length_variance_m2 * squared(up[i]));
	}
}

/* The point from which the load hangs stands. */
static void measure_hanging_still(struct navigation *n, double x[N])
{
	struct vec3 v = rope_point_velocity(&n->rope, n->velocity_n_m_s, n->gravity_m_s2);

	measure3(n, x, V, vec3_scale(-1, v), squared(STILL_VELOCITY_M_S));
}

static void turn_heading(struct navigation *n, double angle_rad)
{
	struct quat turn = quat_from_rotation_vector((struct vec3){0, 0, angle_rad});

	turn_to(n, quat_multiply(turn, n->q_nb));
	n->lever_from_n_m = quat_rotate(turn, n->lever_from_n_m);
	n->velocity_n_m_s = quat_rotate(turn, n->velocity_n_m_s);
	smoother_break(n->smoother);
	rope_restart(&n->rope, n->q_nb);
}

/* Starts again with the fusion's attitude, as if the reference point stood still, when the tilt is too far from it. How
 * well both are known is what the fusion knows. Returns whether it did. */
static bool reinitialise_if_lost(struct navigation *n, const struct navigation_input *in)
{
	struct vec3 up = quat_rotate_inverse(in->q_nb, (struct vec3){0, 0, 1});
	struct vec3 off = quat_rotate(n->q_nb, up), angle = in->attitude_variance_rad2;

	if (off.z > 0 && hypot(off.x, off.y) < LOST_RAD)
		return false;
	turn_to(n, in->q_nb);
	n->gyro_bias_b_rad_s = in->gyro_bias_b_rad_s;
	n->accel_bias_b_m_s2 = ZERO;
	n->velocity_n_m_s =
		quat_rotate(n->q_nb, vec3_cross(vec3_sub(in->gyro_b_rad_s, n->gyro_bias_b_rad_s), in->lever_b_m));
	reset_errors(n, THETA, fmax(squared(START_ANGLE_RAD), fmax(angle.x, angle.y)));
	reset_errors(n, V, fmax(squared(LOST_VELOCITY_M_S), in->velocity2_m2_s2));
	reset_errors(n, BG, squared(start_gyro_bias_rad_s(n)));
	reset_errors(n, BA, squared(start_accel_bias_m_s2(n)));
	n->high_pass_n_m_s = ZERO;
	n->high_pass2_max = 0;
	n->lever_known = false;
	rope_restart(&n->rope, n->q_nb);
	return true;
}

static bool heading_unknown(const struct navigation *n)
{
	return n->fusion_variance_rad2.z > squared(HEADING_JUMP_RAD);
}

/* Variance of a vector of which a share, squared, of the horizontal part is an error of the heading. */
static struct vec3 by_heading(struct vec3 v_n, double share2)
{
	double variance = share2 * (squared(v_n.x) + squared(v_n.y));

	return (struct vec3){variance, variance, 0};
}

/* The path so far was drawn towards another north. */
static void measure_heading(struct navigation *n, double x[N], struct quat q_fused)
{
	struct vec3 difference = quat_to_rotation_vector(quat_multiply(q_fused, quat_conjugate(n->q_nb))),
		    *mean = &n->fusion_difference2_rad2;
	double t = n->sums.t_s, share = t / (DIFFERENCE_TIME_S + t);

	if (heading_unknown(n))
		return;
	if (n->north_found || fabs(difference.z) > HEADING_JUMP_RAD) {
		turn_heading(n, difference.z);
		n->earlier_variance_m2 = vec3_add(
			n->earlier_variance_m2, by_heading(n->position_n_m, 4 * squared(sin(difference.z / 2))));
		difference.z = 0;
	}
	n->north_found = false;
	measure(n, x, THETA + 2, difference.z, squared(HEADING_SIGMA_RAD) * HEADING_CORRELATION_S / t);
	mean->x += share * (difference.x * difference.x - mean->x);
	mean->y += share * (difference.y * difference.y - mean->y);
	mean->z += share * (difference.z * difference.z - mean->z);
}

/* At the end of a long movement: a tilt that was wrong by an angle took its square off gravity, which no linear
 * filter sees. */
static void add_linearisation_error(struct navigation *n, const double x[N])
{
	double angle2 = squared(x[THETA]) + squared(x[THETA + 1]);

	if (n->still && !assumptions(n)->dwell)
		add_variance(n, P, squared(n->gravity_m_s2 * angle2 / 4 * squared(n->moving_s)));
}

static void correct(struct navigation *n, const struct navigation_input *in)
{
	double x[N] = {0};

	if (reinitialise_if_lost(n, in))
		return;
	if (n->still)
		measure_standstill(n, x, in);
	else
		measure_velocity(n, x, in);
	if (!n->still && n->guide.holds && vertical(n))
		measure_vertical(n, x);
	if (n->rope_ended)
		measure_rope(n, x);
	if (n->rope_ended && n->hangs_still)
		measure_hanging_still(n, x);
	measure_heading(n, x, in->q_nb);
	add_linearisation_error(n, x);
	apply_correction(n, x);
}

/* ---- steps ---- */

void navigation_start(struct navigation *n, const struct navigation_config *config, struct quat q_nb)
{
	struct navigation fresh = {.config = *config, .q_nb = q_nb, .started = true, .seen = n->seen};

	smoother_cancel(n->smoother);
	fresh.smoother = n->smoother;
	fresh.position_n_m = n->position_n_m;
	fresh.gravity_m_s2 = 9.81;
	noise_seen_break(&fresh.seen);
	fresh.noise = noise_seen(&fresh.seen, &config->noise);
	fresh.earlier_variance_m2 = end_displacement(n);
	fresh.way_from_n_m = n->way_from_n_m;
	set_variance(&fresh, THETA, squared(START_ANGLE_RAD));
	set_variance(&fresh, V, squared(START_VELOCITY_M_S));
	set_variance(&fresh, BG, squared(start_gyro_bias_rad_s(&fresh)));
	set_variance(&fresh, BA, squared(start_accel_bias_m_s2(&fresh)));
	*n = fresh;
}

void navigation_skip(struct navigation *n, const struct navigation_input *in, double dt_s)
{
	struct vec3 force_n = quat_rotate(in->q_nb, in->force_b_m_s2), turned = in->attitude_variance_rad2;
	double a_m_s2 = fmax(GAP_ACCEL_M_S2, hypot(hypot(force_n.x, force_n.y), force_n.z - in->gravity_m_s2));

	n->q_nb = in->q_nb;
	n->fusion_variance_rad2 = turned;
	smoother_elapse(n->smoother, dt_s);
	reset_errors(n, THETA, 0);
	add_variances(n, THETA, turned);
	add_variance(n, V, squared(a_m_s2 * dt_s));
	add_variance(n, P, dt_s * dt_s * (vec3_dot(n->velocity_n_m_s, n->velocity_n_m_s) + squared(a_m_s2 * dt_s)));
	memset(&n->sums, 0, sizeof(n->sums));
	rest_restart(&n->rest);
	rope_restart(&n->rope, n->q_nb);
	n->alias = (struct alias){.velocity_m_s = {0}};
	n->stood &= dt_s < FORGOTTEN_S;
	if (n->stood)
		zero_velocity_skip(&n->zero_velocity, n->still);
	else
		zero_velocity_restart(&n->zero_velocity, false);
	n->still = n->ended_by_reset = n->last_known = n->lever_known = n->guide.holds = false;
}

static double alias_variance(const struct alias *a)
{
	const double *v = a->velocity_m_s;

	return fmax(squared(v[0]), fmax(squared(v[1]), squared(v[2])));
}

/* Since an alias began, t_s ago, the velocity may have been wrong by a constant. */
static void add_constant_velocity(struct navigation *n, int axis, double variance, double t_s)
{
	n->p[V + axis][V + axis] += variance;
	n->p[P + axis][V + axis] += variance * t_s;
	n->p[V + axis][P + axis] += variance * t_s;
	n->p[P + axis][P + axis] += variance * squared(t_s);
}

/* It stands, against the estimate, or because nobody moves so quietly for so long: the velocity was wrong, since the
 * movement began or later; or it moves on. */
static void doubt_velocity(struct navigation *n, struct vec3 velocity_n_m_s)
{
	const double v[3] = {velocity_n_m_s.x, velocity_n_m_s.y, velocity_n_m_s.z};

	n->assumed = false;
	for (int i = 0; i < 3; i++) {
		bool contradicted = !may_be_zero(v[i], n->p[V + i][V + i], ZERO_VELOCITY_M_S, CONTRADICTED_SIGMAS);

		n->assumed |= contradicted;
		if (!contradicted && !zero_velocity_quiet_for_long(&n->zero_velocity))
			continue;
		add_constant_velocity(n, i, squared(v[i]), n->moved_s);
		n->p[P + i][P + i] += squared(v[i] * n->moved_s / 2);
	}
}

/* Where an alias ends, its sine stays behind. */
static void add_sine(struct navigation *n, const double velocity_m_s[ALIAS_AXES], const double position_m[ALIAS_AXES])
{
	for (int i = 0; i < ALIAS_AXES; i++) {
		n->p[V + i][V + i] += squared(velocity_m_s[i]);
		n->p[P + i][P + i] += squared(position_m[i]);
	}
}

/* Once an interval, after its transition. What goes to and fro by assumption does so, and levelling removes a constant
 * velocity. */
static void follow_alias(struct navigation *n, const struct navigation_sums *s)
{
	struct alias *a = &n->alias;
	struct vec3 accel = vec3_scale(1 / s->t_s, s->f);

	if (levels(n)) {
		*a = (struct alias){.velocity_m_s = {0}};
		return;
	}
	accel.z -= n->gravity_m_s2;
	alias_step(a, accel, s->turned_b_rad, s->t_s);
	if (n->still)
		return;
	for (int i = 0; i < ALIAS_AXES; i++)
		if (a->found_s[i] > 0)
			add_constant_velocity(n, i, squared(a->velocity_m_s[i]), fmin(a->found_s[i], n->moved_s));
	add_sine(n, a->ended_m_s, a->ended_m);
}

/* The force for the rectangular rule. That errs by half of the force's change times the interval, and the next interval
 * makes up for it, if it is as long. Where this one is longer, the force is taken to have changed evenly, with an error
 * of as much. */
static struct vec3 over_longer_interval(struct navigation *n, struct vec3 force_n_m_s2, double dt_s)
{
	double longer_s = n->last_known ? fmax(0, dt_s - n->last_interval_s) : 0;
	struct vec3 change = vec3_sub(force_n_m_s2, n->last_force_n_m_s2), v = vec3_scale(longer_s / 2, change);

	n->last_force_n_m_s2 = force_n_m_s2;
	n->last_interval_s = dt_s;
	add_variances(n, V, (struct vec3){v.x * v.x, v.y * v.y, v.z * v.z});
	return vec3_sub(force_n_m_s2, vec3_scale(1 / dt_s, v));
}

static void integrate(struct navigation *n, const struct navigation_input *in, double dt)
{
	struct vec3 omega = vec3_sub(in->gyro_b_rad_s, n->gyro_bias_b_rad_s), before = n->velocity_n_m_s, force, accel;
	struct vec3 last = n->last_known ? vec3_sub(n->last_gyro_b_rad_s, n->gyro_bias_b_rad_s) : omega;
	struct mat3 r_nb;

	turn_to(n, quat_multiply(n->q_nb, quat_from_rotation_vector(rotation_between(last, omega, dt))));
	r_nb = mat3_from_quat(n->q_nb);
	force = mat3_apply(r_nb, vec3_sub(in->force_b_m_s2, n->accel_bias_b_m_s2));
	force = over_longer_interval(n, force, dt);
	accel = vec3_sub(force, (struct vec3){0, 0, in->gravity_m_s2});
	if (vertical(n))
		accel.z *= 1 - share_of_scale(n) * mat3_apply(r_nb, n->accel_bias_b_m_s2).z / in->gravity_m_s2;
	navigation_sums_add(&n->sums, &r_nb, omega, force, accel, dt);
	zero_velocity_vibration(
		&n->zero_velocity, accel, alias_variance(&n->alias) + lever_noise(n, NAVIGATION_INTERVAL_S), dt);
	n->velocity_n_m_s = vec3_add(before, vec3_scale(dt, accel));
	if (!n->still)
		n->position_n_m = vec3_add(n->position_n_m, vec3_scale(dt / 2, vec3_add(before, n->velocity_n_m_s)));
	n->last_known = true;
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

/* A motion has begun in this fork: the navigation is what it would be without the zero-velocity updates since then. */
static void adopt(struct navigation *n, const struct navigation_input *in, const struct zero_velocity_fork *f)
{
	const struct smoother_point start = {
		.position_n_m = vec3_sub(f->start_n_m, quat_rotate(n->q_nb, in->lever_b_m))};

	memcpy(n->p, f->p, sizeof(n->p));
	n->still = false;
	if (n->stood_s > STOOD_S || n->ended_by_reset)
		begin_movement(n, start);
	smoother_elapse(n->smoother, f->sums.t_s);
	propagate(n, &f->sums);
	n->q_nb = quat_normalize(quat_multiply(quat_from_rotation_vector(f->apart_rad), n->q_nb));
	n->velocity_n_m_s = f->velocity_n_m_s;
	n->position_n_m = f->position_n_m;
	n->gyro_bias_b_rad_s = f->gyro_bias_b_rad_s;
	n->accel_bias_b_m_s2 = f->accel_bias_b_m_s2;
	n->ended_by_reset = false;
	n->accelerated_s = BEGIN_S;
	zero_velocity_restart(&n->zero_velocity, true);
}

/* Before the first standstill the biases are those of the calibration. The length of a steady force shows when that
 * of the accelerometer is worse, and the fusion how well the gyro's is known. */
static void observe_biases(struct navigation *n, struct vec3 gyro_bias_variance_rad2_s2, bool steady)
{
	double off = steady ? vec3_norm(n->rest.accel_mean) - n->gravity_m_s2 : 0;
	const double gyro[3] = {
		gyro_bias_variance_rad2_s2.x, gyro_bias_variance_rad2_s2.y, gyro_bias_variance_rad2_s2.z};

	for (int i = 0; i < 3; i++)
		n->p[BG + i][BG + i] = fmax(n->p[BG + i][BG + i], gyro[i]);

	for (int i = BA; i < BA + 3; i++)
		n->p[i][i] = fmax(n->p[i][i], squared(off));
}

/* A constant velocity of that sigma adds to the position since a time, for t_s more. */
static void creep(struct navigation *n, double sigma_m_s, double *since_s, double t_s)
{
	double before = *since_s;

	*since_s += t_s;
	add_variance(n, P, squared(sigma_m_s) * (squared(*since_s) - squared(before)));
}

/* m/s, 1 sigma of what stands: what turns may travel, too, and slower than any fork shows; and so may all, where the
 * sensors are so noisy that the slowest motions do not show. */
static double creep_m_s(const struct navigation *n)
{
	double turning_m_s = n->turning ? assumptions(n)->creep_m_s : 0;
	const struct noise_config noise = noise_seen(&n->seen, &n->config.noise); /* hidden steps do not creep */
	double seen_m_s = zero_velocity_slowest_seen_m_s(&noise, n->gravity_m_s2);

	return fmax(turning_m_s, sqrt(fmax(0, squared(seen_m_s) - squared(assumptions(n)->slowest_m_s))));
}

static void add_creep(struct navigation *n, double t_s)
{
	double sigma_m_s = n->still ? creep_m_s(n) : 0;

	if (sigma_m_s > 0)
		creep(n, sigma_m_s, &n->crept_s, t_s);
	else
		n->crept_s = 0;
}

/* Once a window: the hypotheses are those of the point from which the load hangs. */
static void weigh_hanging(struct navigation *n, struct zero_velocity_signals signals)
{
	struct zero_velocity *z = &n->zero_velocity;
	double t_s = n->rope.window[0].sums.t_s;

	if (!n->rope_ended)
		return;
	signals.level = true;
	signals.steady = false; /* a load that hardly swings is as quiet while it is carried along */
	signals.accelerates = n->rope.steady < ROPE_DIFFERENCES;
	zero_velocity_moves(z, n, &signals, rope_point_velocity(&n->rope, n->velocity_n_m_s, n->gravity_m_s2),
		assumptions(n)->slowest_m_s, aided_to_move(n), t_s);
	n->hangs_still = z->standing_s > 0;
}

/* Square of the least change of the mean force that is significant. Before the first standstill an unknown gyro bias
 * turns it. */
static double force_change2_m2_s4(const struct navigation *n, double walk_m2_s3)
{
	double noise2 = squared(CHANGE_SIGMAS) * 3 * walk_m2_s3 / n->config.standstill.mean_time_s;

	return n->stood ? squared(SAME_FORCE_M_S2) + noise2 : INFINITY;
}

/* The mean force leaves the usual one: a steady motion begins to brake, or a load swings. Smaller changes are seen than
 * differ from zero, since tilt and bias stay the same. */
static bool force_changes(struct navigation *n, const struct zero_velocity_signals *s, double t_s)
{
	struct vec3 change, off, slow_off;

	if (vec3_dot(n->usual_force_n_m_s2, n->usual_force_n_m_s2) == 0)
		n->slow_force_n_m_s2 = n->usual_force_n_m_s2 = s->force_n_m_s2;
	change = vec3_sub(s->force_n_m_s2, n->slow_force_n_m_s2);
	off = vec3_sub(s->force_n_m_s2, n->usual_force_n_m_s2);
	slow_off = vec3_sub(n->slow_force_n_m_s2, n->usual_force_n_m_s2);
	n->slow_force_n_m_s2 = vec3_add(n->slow_force_n_m_s2, vec3_scale(t_s / (SLOW_FORCE_S + t_s), change));
	n->usual_force_n_m_s2 = vec3_add(n->usual_force_n_m_s2, vec3_scale(t_s / (USUAL_FORCE_S + t_s), off));
	return vec3_dot(off, off) > vec3_dot(slow_off, slow_off) && vec3_dot(change, change) > s->force_change2_m2_s4;
}

/* What accelerates does not rest. */
static void follow_acceleration(
	struct navigation *n, const struct zero_velocity_signals *s, bool accelerates, double gravity_m_s2, double t_s)
{
	bool changes = force_changes(n, s, t_s);

	n->changed_s = changes ? CHANGED_S : fmax(0, n->changed_s - t_s);
	accelerates =
		accelerates || (!n->still && (changes || (n->changed_s > 0 && !accel_may_be_zero(n, gravity_m_s2, 1))));
	n->accelerated_s = fmax(accelerates ? ACCELERATED_S : 0, n->accelerated_s - t_s);
}

/* At the end of an interval, after its measurements; turned_rad: how they turned the attitude, rate_b_rad_s: mean of
 * the interval, whose noise is less than that of a sample. */
static void weigh_hypotheses(struct navigation *n, const struct navigation_input *in, struct vec3 turned_rad,
	struct vec3 rate_b_rad_s, double t_s, double dt_s)
{
	struct vec3 lever = quat_rotate(n->q_nb, vec3_cross(rate_b_rad_s, in->lever_b_m));
	bool steady = n->rest.still_s > n->config.standstill.time_s;
	bool accelerates = !n->still && !accel_may_be_zero(n, in->gravity_m_s2, ACCEL_SIGMAS);
	double walk = rest_accel_walk_m2_s3(&n->rest, dt_s);

	n->stood |= n->still;
	if (!n->stood)
		observe_biases(n, in->gyro_bias_variance_rad2_s2, steady);
	const struct zero_velocity_signals signals = {
		.steady = steady,
		.gyro2_rad2_s2 = n->rest.gyro_square,
		.accel2_m2_s4 = n->rest.accel_square,
		.accel_walk_m2_s3 = walk,
		.force_n_m_s2 = mean_force(n),
		.force_change2_m2_s4 = force_change2_m2_s4(n, walk),
		.accelerates = accelerates || (!n->still && assumptions(n)->stands_steady && !steady),
	};
	struct zero_velocity_fork *begun = NULL;

	follow_acceleration(n, &signals, accelerates, in->gravity_m_s2, t_s);
	add_creep(n, t_s);
	if (n->still)
		begun = zero_velocity_stands(&n->zero_velocity, n, &signals, turned_rad, lever, n->turning, t_s);
	else if (swings(n))
		weigh_hanging(n, signals);
	else
		zero_velocity_moves(&n->zero_velocity, n, &signals, vec3_sub(n->velocity_n_m_s, lever),
			assumptions(n)->slowest_m_s, aided_to_move(n), t_s);
	if (begun)
		adopt(n, in, begun);
}

/* An error of scale is one about the axis of the turn; one of alignment is about the others, and averages out over a
 * whole turn. */
static void add_turn_variance(struct navigation *n, double variance, bool alignment)
{
	struct vec3 axis = quat_rotate(n->q_nb, vec3_scale(1 / vec3_norm(n->net_turn_b_rad), n->net_turn_b_rad));
	const double u[3] = {axis.x, axis.y, axis.z};

	if (alignment)
		add_variance(n, THETA, variance);
	for (int i = 0; i < 3 && !alignment; i++)
		for (int j = 0; j < 3; j++)
			n->p[THETA + i][THETA + j] += variance * u[i] * u[j];
}

/* A turn in one direction leaves an error of attitude behind that grows with its angle; one to and fro does not. */
static void add_scale_error(struct navigation *n)
{
	double turned2;

	if (n->still && !n->turning) {
		n->net_turn_b_rad = ZERO;
		n->net_turn2_max_rad2 = 0;
		return;
	}
	n->net_turn_b_rad = vec3_add(n->net_turn_b_rad, n->sums.turned_b_rad);
	turned2 = vec3_dot(n->net_turn_b_rad, n->net_turn_b_rad);
	if (turned2 < n->net_turn2_max_rad2)
		return;
	add_turn_variance(
		n, squared(gyro_scale(n)) * (turned2 - n->net_turn2_max_rad2), turned2 < squared(ALIGNED_TURN_RAD));
	n->net_turn2_max_rad2 = turned2;
}

/* An error of scale is one of the velocity along that axis, which vanishes with the velocity unless the object turns to
 * and fro as it accelerates: what a swinging arm rectifies grows with time. */
static void add_rectified_error(struct navigation *n)
{
	const struct mat3 r_nb = mat3_from_quat(n->q_nb);
	const struct vec3 f = n->sums.f, turned = n->sums.turned_b_rad;
	const struct vec3 up_b = quat_rotate_inverse(n->q_nb, (struct vec3){0, 0, n->gravity_m_s2});
	const struct vec3 v_b = quat_rotate_inverse(n->q_nb, n->velocity_n_m_s);
	const double t = n->sums.t_s, accel[3] = {f.x, f.y, f.z - n->gravity_m_s2 * t};
	struct mat3 *attitude = &n->scales.attitude;
	bool begun = n->scales.begun;
	struct vec3 force_b;

	if (n->still && !n->turning) {
		memset(&n->scales, 0, sizeof(n->scales));
		return;
	}
	if (!begun)
		n->scales.up_b_m_s2 = up_b;
	force_b = vec3_sub(quat_rotate_inverse(n->q_nb, f), vec3_scale(t, n->scales.up_b_m_s2));
	const double force[3] = {force_b.x, force_b.y, force_b.z}, vanishes[3] = {v_b.x, v_b.y, v_b.z};
	const double turned_rad[3] = {turned.x, turned.y, turned.z};

	for (int i = 0; i < 3; i++) {
		const int k = (i + 1) % 3, l = (i + 2) % 3;
		double *by_gyro = n->scales.velocity_by_gyro.m[i], *by_accel = n->scales.velocity_by_accel.m[i];
		double gyro2 = 0, accel2 = 0, variance;

		for (int j = 0; j < 3; j++) {
			by_gyro[j] += attitude->m[k][j] * accel[l] - attitude->m[l][j] * accel[k];
			by_accel[j] = begun ? by_accel[j] + r_nb.m[i][j] * force[j] : r_nb.m[i][j] * vanishes[j];
			gyro2 += squared(by_gyro[j]);
			accel2 += squared(by_accel[j] - r_nb.m[i][j] * vanishes[j]);
		}
		variance = squared(gyro_scale(n)) * gyro2 + squared(accel_scale(n)) * accel2;
		n->p[V + i][V + i] += fmax(0, variance - n->scales.velocity2_max[i]);
		n->scales.velocity2_max[i] = fmax(n->scales.velocity2_max[i], variance);
	}
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			attitude->m[i][j] += r_nb.m[i][j] * turned_rad[j];
	n->scales.begun = true;
}

/* A way in one direction leaves an error of position behind that grows with it. */
static void add_way_error(struct navigation *n)
{
	struct vec3 way = vec3_sub(n->position_n_m, n->way_from_n_m);
	double way2 = vec3_dot(way, way);

	if (way2 < n->way2_max_m2)
		return;
	add_variances(n, P, by_accel_scale(n, way2));
	n->way2_max_m2 = way2;
}

/* It turned while it was held: the state is what it would be without that, but for the covariance's cross terms. */
static void release(struct navigation *n)
{
	const struct guide *g = &n->guide;
	struct vec3 bias = variance(n, BG);
	double t = g->t_s, walk = squared(n->noise.gyro_density_rad_s_sqrt_hz) / 2 * t, g2 = squared(n->gravity_m_s2);
	double drift = (bias.x + bias.y + bias.z) / 3 * squared(t);

	n->q_nb = quat_multiply(quat_from_rotation_vector(g->taken_n_rad), n->q_nb);
	n->velocity_n_m_s = vec3_add(n->velocity_n_m_s, g->taken_n_m_s);
	n->position_n_m = vec3_add(n->position_n_m, g->taken_n_m);
	add_variance(n, THETA, walk + drift);
	add_variance(n, V, g2 * squared(t) * (walk / 3 + drift / 4));
	add_variance(n, P, g2 * squared(squared(t)) * (walk / 20 + drift / 36));
	smoother_break(n->smoother);
	n->guide.holds = false;
}

static struct guide_start guide_start(const struct navigation *n)
{
	struct vec3 tilt = variance(n, THETA), bias = variance(n, BA);
	double accel[3];

	navigation_accel_variance(n, accel);
	return (struct guide_start){.q_nb = n->q_nb,
		.position_n_m = n->position_n_m,
		.accel_bias_b_m_s2 = n->accel_bias_b_m_s2,
		.tilt_variance_rad2 = (tilt.x + tilt.y) / 2,
		.bias_variance_m2_s4 = (bias.x + bias.y + bias.z) / 3,
		.accel_variance_m2_s4 = (accel[0] + accel[1]) / 2};
}

/* The guide is not vertical: the movement so far is what was integrated with the attitude and bias of its beginning. */
static void incline(struct navigation *n)
{
	const struct guide *g = &n->guide;
	double velocity_variance = guide_free_variance_m2_s2(g, guide_walk(n));

	n->q_nb = g->start.q_nb;
	n->accel_bias_b_m_s2 = g->start.accel_bias_b_m_s2;
	n->velocity_n_m_s = g->free_n_m_s;
	n->position_n_m = vec3_add(g->start.position_n_m, g->free_n_m);
	reset_errors(n, THETA, g->start.tilt_variance_rad2);
	reset_errors(n, BA, g->start.bias_variance_m2_s4);
	reset_errors(n, V, velocity_variance);
	reset_errors(n, P, velocity_variance * squared(g->t_s));
	smoother_break(n->smoother);
	n->guide.inclined = true;
}

/* Once an interval, before its transition. */
static void follow_guide(struct navigation *n)
{
	struct vec3 bias = variance(n, BG), back;
	struct mat3 r_nb = mat3_from_quat(n->q_nb);

	if (n->still) {
		const struct guide_start start = guide_start(n);

		guide_engage(&n->guide, &start);
		return;
	}
	if (!n->guide.holds)
		return;
	if (vertical(n)) {
		guide_integrate(&n->guide, &r_nb, n->accel_bias_b_m_s2, n->gravity_m_s2, &n->sums);
		if (guide_inclines(&n->guide, guide_walk(n)))
			incline(n);
	}
	n->sums.held = true;
	back = guide_hold(&n->guide, &r_nb, &n->sums);
	n->q_nb = quat_multiply(quat_from_rotation_vector(vec3_scale(-1, back)), n->q_nb);
	if (guide_turns(&n->guide, n->noise.gyro_density_rad_s_sqrt_hz, bias.x + bias.y + bias.z))
		release(n);
}

static void follow_rope(struct navigation *n, double dt_s)
{
	n->rope_ended = false;
	if (n->still || n->rope.given_m != n->config.rope_m) {
		rope_hang(&n->rope, n->config.rope_m, n->q_nb);
		n->hangs_still = false;
	} else {
		n->rope_ended = hangs(n) && rope_swing(&n->rope, n->q_nb, &n->sums, dt_s);
	}
}

/* A chip may be noisier than told, and coarser. */
static void watch_noise(struct navigation *n, double steps_variance_m2_s4)
{
	const struct navigation_sums *s = &n->sums;

	if (assumptions(n)->dwell || !n->still || n->rest.still_s <= n->config.standstill.time_s)
		noise_seen_break(&n->seen);
	else
		noise_seen_step(&n->seen, &n->config.noise, quat_rotate_inverse(n->q_nb, vec3_scale(1 / s->t_s, s->f)),
			vec3_scale(1 / s->t_s, s->turned_b_rad), s->t_s);
	n->noise = noise_seen(&n->seen, &n->config.noise);
	n->noise.accel_density_m_s2_sqrt_hz =
		sqrt(squared(n->noise.accel_density_m_s2_sqrt_hz) + 4 * STEPS_ERROR_S * steps_variance_m2_s4);
}

static void end_interval(struct navigation *n, const struct navigation_input *in, double dt_s)
{
	double t_s = n->sums.t_s;
	struct quat before = n->q_nb;
	struct vec3 rate_b_rad_s = vec3_scale(1 / t_s, n->sums.turned_b_rad);

	watch_noise(n, in->steps_variance_m2_s4);
	if (!assumptions(n)->dwell)
		add_scale_error(n);
	if (!assumptions(n)->dwell)
		add_rectified_error(n);
	if (assumptions(n)->stances && n->stood_s < STOOD_S)
		creep(n, STANCE_CREEP_M_S, &n->walked_s, t_s);

	if (n->still && !assumptions(n)->dwell)
		zero_velocity_integrate(&n->zero_velocity, n, dt_s);
	if (!n->still) {
		n->moved_s += t_s;
		n->moved_accel2_m2_s3 += n->sums.accel2_m2_s3;
		n->moved_turned2_rad2_s += n->sums.turned2_rad2_s;
		add_way_error(n);
	}
	if (assumptions(n)->guided)
		follow_guide(n);
	else
		n->guide.holds = false;
	if (assumptions(n)->hangs)
		follow_rope(n, dt_s);
	else
		n->hangs_still = n->rope_ended = false;
	propagate(n, &n->sums);
	follow_alias(n, &n->sums);
	correct(n, in);
	memset(&n->sums, 0, sizeof(n->sums));
	if (!assumptions(n)->dwell)
		weigh_hypotheses(n, in, quat_to_rotation_vector(quat_multiply(n->q_nb, quat_conjugate(before))),
			rate_b_rad_s, t_s, dt_s);
	record(n, in);
}

static void follow_lever(struct navigation *n, struct vec3 lever_b_m)
{
	struct vec3 change = vec3_sub(lever_b_m, n->lever_b_m);

	if (!n->lever_from_known || vec3_dot(change, change) > 0)
		n->lever_from_n_m = quat_rotate(n->q_nb, lever_b_m);
	n->lever_from_known = true;
	n->lever_b_m = lever_b_m;
}

bool navigation_step(struct navigation *n, const struct navigation_input *in, double dt_s)
{
	bool still = stands_still(n, in, dt_s), ended;

	if (n->still && !still && (n->stood_s > STOOD_S || n->ended_by_reset))
		begin_movement(n, reference_point(n, in));
	if (still && !n->still && n->moved_s > 0 && !assumptions(n)->dwell) {
		doubt_velocity(n, reference_point(n, in).velocity_n_m_s);
		end_movement(n);
	}
	if (still && !n->still)
		add_sine(n, n->alias.velocity_m_s, n->alias.position_m);
	if (still && !n->still)
		zero_velocity_settle(&n->zero_velocity);
	else if (!still && n->still)
		zero_velocity_restart(&n->zero_velocity, true);
	n->ended_by_reset &= still;
	smoother_elapse(n->smoother, dt_s);
	n->aided_s = fmax(0, n->aided_s - dt_s);
	n->stood_s = still ? n->stood_s + dt_s : 0;
	n->still = still;
	n->gravity_m_s2 = in->gravity_m_s2;
	follow_lever(n, in->lever_b_m);
	n->fusion_variance_rad2 = in->attitude_variance_rad2;
	add_variance(n, THETA, squared(in->unseen_turn_rad));
	n->north_found |= in->north_found;
	n->force_variance_m2_s3 += dt_s * in->force_variance_m2_s4;
	integrate(n, in, dt_s);
	ended = n->sums.t_s >= NAVIGATION_INTERVAL_S;
	if (ended)
		end_interval(n, in, dt_s);
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

void navigation_biases_drift(struct navigation *n, double gyro_rad2_s2, double accel_m2_s4)
{
	add_variance(n, BG, gyro_rad2_s2);
	add_variance(n, BA, accel_m2_s4);
}

void navigation_set_attitude(struct navigation *n, struct quat q_nb)
{
	n->velocity_n_m_s = quat_rotate(q_nb, quat_rotate_inverse(n->q_nb, n->velocity_n_m_s));
	n->q_nb = q_nb;
	n->last_known = n->guide.holds = n->lever_from_known = false;
	rope_restart(&n->rope, q_nb);
	reset_errors(n, THETA, squared(SET_ANGLE_RAD));
	memset(&n->sums, 0, sizeof(n->sums));
}

void navigation_reset_position(struct navigation *n)
{
	if (n->still)
		smoother_end(n->smoother, n->stood_s, n->p);
	n->position_n_m = n->earlier_variance_m2 = n->way_from_n_m = ZERO;
	n->way2_max_m2 = 0;
	n->lever_from_known = false;
	set_variance(n, P, 0);
	n->ended_by_reset = n->still;
	n->reset_in_motion = !n->still;
}

/* ---- 1 sigma ---- */

static struct vec3 root(struct vec3 a)
{
	return (struct vec3){sqrt(fmax(a.x, 0)), sqrt(fmax(a.y, 0)), sqrt(fmax(a.z, 0))};
}

/* Variance of the fusion's attitude: its own, or if it has none, this filter's plus the mean square difference of
 * both and what the accelerometer's bias tilts. The error of north does not average out. */
static struct vec3 attitude_variance(const struct navigation *n)
{
	struct vec3 var = n->fusion_variance_rad2, bias = variance(n, BA);
	double tilt = (bias.x + bias.y + bias.z) / 3 / squared(n->gravity_m_s2);

	if (vec3_dot(var, var) == 0)
		var = vec3_add(vec3_add(variance(n, THETA), n->fusion_difference2_rad2), (struct vec3){tilt, tilt, 0});
	return vec3_add(var, (struct vec3){0, 0, squared(NORTH_SIGMA_RAD)});
}

/* m^2/s^2, of each axis at a standstill, where zero is published: what vibrates, or creeps, may move beside that. */
static double standstill_velocity_variance(const struct navigation *n)
{
	return n->zero_velocity.vibration_m2_s2 + (assumptions(n)->dwell ? 0 : squared(creep_m_s(n)));
}

static struct vec3 squares(const double a[3])
{
	return (struct vec3){squared(a[0]), squared(a[1]), squared(a[2])};
}

/* m^2/s^2: of the reference point's velocity, by the gyro's noise and bias. */
static struct vec3 by_lever_rate(const struct navigation *n, double rate_hz)
{
	struct vec3 bias = variance(n, BG);
	double v = lever_noise(n, 1 / rate_hz) + (bias.x + bias.y + bias.z) / 3 * vec3_dot(n->lever_b_m, n->lever_b_m);

	return (struct vec3){v, v, v};
}

/* The reference point is off by the lever arm's turn since the position was zero, times the error of the attitude. */
static struct vec3 by_lever(const struct navigation *n, struct vec3 angle2)
{
	struct vec3 d = vec3_sub(quat_rotate(n->q_nb, n->lever_b_m), n->lever_from_n_m);

	return (struct vec3){angle2.y * d.z * d.z + angle2.z * d.y * d.y, angle2.x * d.z * d.z + angle2.z * d.x * d.x,
		angle2.x * d.y * d.y + angle2.y * d.x * d.x};
}

struct navigation_sigma navigation_sigma(const struct navigation *n, double rate_hz)
{
	struct vec3 angle = attitude_variance(n), bias = variance(n, BA);
	double force = squared(n->noise.accel_density_m_s2_sqrt_hz) * rate_hz / 2 + (bias.x + bias.y + bias.z) / 3;
	double g2 = squared(n->gravity_m_s2);
	struct vec3 displacement = vec3_add(variance(n, P), n->zero_velocity.position_variance_m2);
	struct vec3 velocity = vec3_add(variance(n, V), n->zero_velocity.velocity_variance_m2_s2);
	struct vec3 position = vec3_add(vec3_add(n->earlier_variance_m2, displacement),
		by_accel_scale(n, vec3_dot(n->position_n_m, n->position_n_m)));

	position = vec3_add(position, by_lever(n, angle));
	displacement = vec3_add(displacement, squares(n->alias.position_m));
	position = vec3_add(position, squares(n->alias.position_m));
	if (n->still) {
		double variance = standstill_velocity_variance(n);

		velocity = vec3_add(velocity, (struct vec3){variance, variance, variance});
	} else {
		velocity = vec3_add(vec3_add(velocity, squares(n->alias.velocity_m_s)), by_lever_rate(n, rate_hz));
	}
	if (heading_unknown(n)) {
		position = vec3_add(position, by_heading(n->position_n_m, UNKNOWN_CHORD2));
		velocity = vec3_add(velocity, by_heading(n->velocity_n_m_s, UNKNOWN_CHORD2));
	}
	return (struct navigation_sigma){
		.attitude_rad = root(angle),
		.accel_m_s2 = root((struct vec3){g2 * angle.y + force, g2 * angle.x + force, force}),
		.velocity_m_s = root(velocity),
		.position_m = root(position),
		.displacement_m = root(displacement),
	};
}
