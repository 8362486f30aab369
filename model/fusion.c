#include "model/fusion.h"

#include <errno.h>
#include <stddef.h>

#include "model/math/rotation.h"
#include "model/math/units.h"
#include "model/noise.h"

/* Least horizontal part of the field, as a share of its length, that has a direction. Numerical limit. */
static const double LEAST_HORIZONTAL = 1e-3;
/* Least cosine of the pitch at which a yaw is meaningful: 84 degrees. By judgement: an error of the tilt is ten times
 * as large in the yaw there. */
static const double LEAST_LEVEL = 0.1;
/* s, for which a yaw from outside holds for the filters without a covariance, and memory of where the field points to
 * meanwhile. The same as those of the Kalman filter. */
static const double AID_S = 10, NORTH_TIME_S = 10;
/* Usual intervals, and s, below which there is none. By judgement: two samples are missing; a sensor of less than 5
 * samples a second tells nothing about what was between two of them. */
static const double GAP_INTERVALS = 2.5, GAP_MOST_S = 0.5;
/* rad/s and rad/s^2, 1 sigma of a turn in a gap beside what the rates before and after it tell. By judgement: a hand or
 * a robot. */
static const double UNSEEN_RAD_S = 1, UNSEEN_RAD_S2 = 8;
/* 1 sigma of the turn between two samples T apart beside that by the mean of their rates, each axis, as a share of the
 * angular acceleration times T^2. Measured: 0.11 to 0.20 in eight trials of BROAD for T from 0.02 to 0.15 s. */
static const double UNSEEN_SHARE = 0.17;
/* s, in which a change of the rate is measured, and memory of its mean square. By judgement: the gyro's noise is small
 * against a motion then; a motion to and fro lasts for a second. */
static const double ALPHA_BASE_S = 0.01, ALPHA_MEMORY_S = 1;
/* s. Derived: the mean of the rates at both ends of a gap T is off by (2 pi f T)^2 / 12 of the rate in a motion with
 * the frequency f; by all of it at 1 Hz and that time. */
static const double UNSEEN_S = 0.55;

static bool within(double value, double high)
{
	return value >= 0 && value <= high;
}

static bool config_valid(const struct fusion_config *c)
{
	return (c->algorithm == FUSION_MADGWICK || c->algorithm == FUSION_MAHONY || c->algorithm == FUSION_KALMAN) &&
	       (c->use_magnetometer == 0 || c->use_magnetometer == 1) && within(c->madgwick_beta, 10) &&
	       within(c->mahony_kp_rad_s, 100) && within(c->mahony_ki_rad_s2, 100) &&
	       fusion_kalman_check(&c->kalman) == 0 && vec3_finite(c->lever_arm_b_m) && within(c->delay_s, 0.1) &&
	       within(c->interval_s, INFINITY);
}

int fusion_init(struct fusion *f, const struct fusion_config *config)
{
	if (!config_valid(config))
		return -EINVAL;
	*f = (struct fusion){.config = *config, .q_nb = QUAT_IDENTITY};
	return 0;
}

int fusion_configure(struct fusion *f, const struct fusion_config *config)
{
	if (!config_valid(config))
		return -EINVAL;
	if (config->algorithm == FUSION_KALMAN && f->config.algorithm != FUSION_KALMAN)
		fusion_kalman_start(&f->kalman, &config->kalman, 9.8);
	if (config->algorithm != FUSION_KALMAN ||
		config->kalman.gyro_scale_sigma != f->config.kalman.gyro_scale_sigma) {
		f->gyro_errors.scale_b = (struct vec3){0, 0, 0};
		fusion_kalman_reset_scale(&f->kalman, &config->kalman);
	}
	if (config->kalman.bias_sigma_rad_s != f->config.kalman.bias_sigma_rad_s)
		fusion_kalman_reset_gyro_errors(&f->kalman, &config->kalman);
	if (config->kalman.accel_sigma_m_s2 != f->config.kalman.accel_sigma_m_s2)
		fusion_kalman_reset_accelerometer(&f->kalman, &config->kalman);
	f->config = *config;
	return 0;
}

void fusion_restart(struct fusion *f, double gap_s)
{
	fusion_kalman_doubt_attitude(&f->kalman, UNSEEN_RAD_S * gap_s);
	f->started = false;
	f->north_known = false;
}

void fusion_turn_object(struct fusion *f, struct quat turn)
{
	if (f->started)
		f->q_nb = quat_multiply(f->q_nb, quat_conjugate(turn));
	fusion_kalman_turn_object(&f->kalman, &f->config.kalman, turn, &f->gyro_errors);
}

void fusion_update_bias_at_rest(struct fusion *f, struct vec3 gyro_b_rad_s, double dt_s)
{
	struct vec3 *bias = &f->gyro_errors.bias_b_rad_s;

	f->resting = true;
	if (f->config.algorithm == FUSION_KALMAN)
		return;
	f->bias_time_s = fmin(f->bias_time_s + dt_s, fmax(FUSION_BIAS_MEMORY_S, dt_s));
	*bias = vec3_add(*bias, vec3_scale(dt_s / f->bias_time_s, vec3_sub(gyro_b_rad_s, *bias)));
}

void fusion_reset_gyro_errors(struct fusion *f)
{
	f->gyro_errors = (struct gyro_errors){0};
	f->bias_time_s = 0;
	fusion_kalman_reset_gyro_errors(&f->kalman, &f->config.kalman);
}

void fusion_bias_drifts(struct fusion *f, double variance_rad2_s2)
{
	fusion_kalman_bias_drifts(&f->kalman, variance_rad2_s2);
}

struct vec3 fusion_rate_b(const struct fusion *f, struct vec3 gyro_b_rad_s)
{
	struct vec3 rate = vec3_sub(gyro_b_rad_s, f->gyro_errors.bias_b_rad_s), scale = f->gyro_errors.scale_b;

	return (struct vec3){(1 + scale.x) * rate.x, (1 + scale.y) * rate.y, (1 + scale.z) * rate.z};
}

/* The unit vector along v; false when v has no direction. */
static bool direction(struct vec3 v, struct vec3 *unit)
{
	double norm = vec3_norm(v);

	if (!(norm > 1e-9) || !isfinite(norm))
		return false;
	*unit = vec3_scale(1 / norm, v);
	return true;
}

static void start_filter(struct fusion *f, struct vec3 up_b, double force_m_s2)
{
	double heading = aerospace_from_quat(f->q_nb).z;
	double roll = atan2(up_b.y, up_b.z), pitch = atan2(-up_b.x, hypot(up_b.y, up_b.z));

	f->q_nb = quat_from_aerospace((struct vec3){roll, pitch, heading});
	f->started = true;
	f->kalman.hard_iron.prior_uT = f->config.kalman.offset_sigma_uT;
	fusion_kalman_start(&f->kalman, &f->config.kalman, force_m_s2);
}

/* Turns the attitude about the vertical until the measured field, of direction h_n now and this length, points to
 * north. */
static void set_heading_by_field(struct fusion *f, struct vec3 h_n, double field_uT)
{
	struct vec3 turn = {0, 0, atan2(h_n.x, h_n.y) - f->kalman.north_rad};

	f->q_nb = quat_multiply(quat_from_rotation_vector(turn), f->q_nb);
	f->north_known = true;
	fusion_kalman_set_north(&f->kalman, &f->config.kalman, f->q_nb,
		quat_rotate(quat_from_rotation_vector(turn), vec3_scale(field_uT, h_n)));
}

/* As long as a yaw from outside holds, the field does not correct the heading: its north is estimated. Returns whether
 * one holds. */
static bool estimate_north(struct fusion_kalman *k, struct vec3 h_n, double dt_s)
{
	double bearing = atan2(h_n.x, h_n.y);

	if (k->north_unknown)
		k->north_rad = bearing;
	k->north_unknown = false;
	if (k->aided_heading_s == 0)
		return false;
	k->north_rad += dt_s / (NORTH_TIME_S + dt_s) * remainder(bearing - k->north_rad, 2 * PI);
	return true;
}

/* Minus the gradient of the magnetic part. The reference field has the measured dip (Madgwick 2010, section 3.4), so
 * that the field corrects the heading rather than the tilt. 0 without a usable measurement. */
static struct vec3 field_error(struct fusion *f, const struct imu_sample *sample, double dt_s)
{
	struct vec3 m, h_n, none = {0, 0, 0}, north, field_b_uT;
	double horizontal;

	f->mag_used = false;
	field_b_uT = vec3_sub(sample->mag_uT, f->kalman.hard_iron.offset_b_uT);
	if (!f->config.use_magnetometer || !(sample->flags & SAMPLE_MAG) || !direction(field_b_uT, &m))
		return none;
	h_n = quat_rotate(f->q_nb, m);
	horizontal = hypot(h_n.x, h_n.y);
	if (horizontal < LEAST_HORIZONTAL)
		return none;
	if (f->north_known && estimate_north(&f->kalman, h_n, dt_s))
		return none;
	f->mag_used = true;
	if (!f->north_known) {
		set_heading_by_field(f, h_n, vec3_norm(field_b_uT));
		return none;
	}
	north = (struct vec3){horizontal * sin(f->kalman.north_rad), horizontal * cos(f->kalman.north_rad), h_n.z};
	return vec3_cross(m, quat_rotate_inverse(f->q_nb, north));
}

/* A step of fixed length against the gradient, limited to half the error, so that it stays short of the minimum whether
 * one or two directions were measured. */
static struct vec3 madgwick_turn(const struct fusion *f, struct vec3 error, double dt_s)
{
	double norm = vec3_norm(error);

	if (norm == 0)
		return error;
	return vec3_scale(fmin(2 * f->config.madgwick_beta, norm / (2 * dt_s)) / norm, error);
}

static struct vec3 mahony_turn(struct fusion *f, struct vec3 error, double dt_s)
{
	struct vec3 *bias = &f->gyro_errors.bias_b_rad_s;

	*bias = vec3_sub(*bias, vec3_scale(f->config.mahony_ki_rad_s2 * dt_s, error));
	return vec3_scale(fmin(f->config.mahony_kp_rad_s, 1 / (2 * dt_s)), error);
}

static void correct_by_error(struct fusion *f, const struct imu_sample *sample, double dt_s)
{
	struct vec3 up, error = {0, 0, 0}, half;

	if (direction(sample->accel_m_s2, &up))
		error = vec3_cross(up, quat_rotate_inverse(f->q_nb, (struct vec3){0, 0, 1}));
	error = vec3_add(error, field_error(f, sample, dt_s));
	f->kalman.aided_heading_s = fmax(0, f->kalman.aided_heading_s - dt_s);
	half = vec3_scale(dt_s / 2,
		f->config.algorithm == FUSION_MADGWICK ? madgwick_turn(f, error, dt_s) : mahony_turn(f, error, dt_s));
	f->q_nb = quat_normalize(quat_multiply(f->q_nb, (struct quat){1, half.x, half.y, half.z}));
}

/* 1 sigma of the turn between two samples beside that by the mean of their rates; 0: it is not a gap. What turns and
 * stands again at its end has half the time to accelerate. */
static double unseen_turn_rad(const struct fusion *f, struct vec3 before_b_rad_s, struct vec3 now_b_rad_s, double dt_s)
{
	double rate_rad_s, share = dt_s / UNSEEN_S;

	if (dt_s <= fmax(GAP_S, fmin(GAP_MOST_S, GAP_INTERVALS * f->config.interval_s)))
		return 0;
	rate_rad_s = fmax(vec3_norm(before_b_rad_s), vec3_norm(now_b_rad_s));
	return dt_s * hypot(rate_rad_s * fmin(1, share * share), fmin(UNSEEN_RAD_S, UNSEEN_RAD_S2 / 4 * dt_s));
}

static bool samples_missing(const struct fusion *f, double dt_s)
{
	return f->config.interval_s > 0 && dt_s > GAP_INTERVALS * f->config.interval_s;
}

/* What turns to and fro does so while samples are missing, too. */
static void observe_alpha(struct fusion *f, struct vec3 rate_b_rad_s, double dt_s)
{
	struct vec3 alpha;

	f->alpha_s += dt_s;
	if (f->alpha_s < ALPHA_BASE_S)
		return;
	alpha = vec3_scale(1 / f->alpha_s, vec3_sub(rate_b_rad_s, f->alpha_from_b_rad_s));
	f->alpha2_rad2_s4 +=
		f->alpha_s / (ALPHA_MEMORY_S + f->alpha_s) * (vec3_dot(alpha, alpha) / 3 - f->alpha2_rad2_s4);
	f->alpha_from_b_rad_s = rate_b_rad_s;
	f->alpha_s = 0;
}

/* 1 sigma of the turn that missing samples hide; a radian is an unknown tilt, and more says no more. */
static void follow_alpha(struct fusion *f, struct vec3 rate_b_rad_s, double dt_s)
{
	if (!samples_missing(f, dt_s)) {
		f->unseen_turn_rad = 0;
		observe_alpha(f, rate_b_rad_s, dt_s);
		return;
	}
	f->unseen_turn_rad = fmin(1, UNSEEN_SHARE * sqrt(f->alpha2_rad2_s4) * dt_s * dt_s);
	f->alpha_from_b_rad_s = rate_b_rad_s;
	f->alpha_s = 0;
}

static void correct_by_kalman(struct fusion *f, const struct imu_sample *sample, struct vec3 before_b_rad_s,
	struct vec3 rate_b_rad_s, double dt_s)
{
	bool field = f->config.use_magnetometer && (sample->flags & SAMPLE_MAG) && vec3_finite(sample->mag_uT);
	struct fusion_kalman_sample s = {
		.gyro_b_rad_s = sample->gyro_rad_s,
		.rate_b_rad_s = rate_b_rad_s,
		.force_b_m_s2 = vec3_finite(sample->accel_m_s2) ? sample->accel_m_s2 : (struct vec3){0, 0, 0},
		.field_b_uT = field ? &sample->mag_uT : NULL,
		.lever_arm_b_m = f->config.lever_arm_b_m,
		.rest = f->resting,
		.steady_s = f->steady_s,
		.saturated = sample->flags & SAMPLE_SATURATED,
		.force_noise_m2_s4 = f->force_noise_m2_s4,
		.force_error_m_s2 = f->force_error_m_s2,
		.unseen_turn_rad = unseen_turn_rad(f, before_b_rad_s, rate_b_rad_s, dt_s),
	};

	fusion_kalman_doubt_attitude(&f->kalman, f->unseen_turn_rad);
	if (!f->north_known && !fusion_kalman_field_disagrees(&f->kalman))
		field_error(f, sample, dt_s);
	f->mag_used = fusion_kalman_step(&f->kalman, &f->config.kalman, &s, dt_s, &f->q_nb, &f->gyro_errors);
	f->north_known &= !f->kalman.north_lost;
	f->kalman.north_lost = false;
}

/* The gyro comes first, so that prediction and measurement are of the same moment. */
void fusion_step(struct fusion *f, const struct imu_sample *sample, double dt_s)
{
	struct vec3 up, before = fusion_rate_b(f, f->last_gyro_b_rad_s), rate = fusion_rate_b(f, sample->gyro_rad_s);

	if (!f->started) {
		f->last_gyro_b_rad_s = sample->gyro_rad_s;
		f->alpha_from_b_rad_s = rate;
		if (!direction(sample->accel_m_s2, &up))
			return;
		start_filter(f, up, vec3_norm(sample->accel_m_s2));
		field_error(f, sample, dt_s);
		return;
	}
	f->q_nb = quat_multiply(f->q_nb, quat_from_rotation_vector(rotation_between(before, rate, dt_s)));
	follow_alpha(f, rate, dt_s);
	f->last_gyro_b_rad_s = sample->gyro_rad_s;
	if (f->config.algorithm == FUSION_KALMAN)
		correct_by_kalman(f, sample, before, rate, dt_s);
	else
		correct_by_error(f, sample, dt_s);
	f->resting = false;
}

struct quat fusion_attitude_now(const struct fusion *f, struct vec3 gyro_b_rad_s)
{
	struct vec3 rate = fusion_rate_b(f, gyro_b_rad_s);

	if (!f->started)
		return f->q_nb;
	return quat_multiply(f->q_nb, quat_from_rotation_vector(vec3_scale(f->config.delay_s, rate)));
}

void fusion_set_attitude(struct fusion *f, struct quat q_nb)
{
	f->q_nb = quat_normalize(q_nb);
	f->started = f->north_known = true;
	fusion_kalman_set_attitude(&f->kalman, &f->config.kalman);
}

static void turn_heading(struct fusion *f, double angle_rad)
{
	f->q_nb = quat_multiply(quat_from_rotation_vector((struct vec3){0, 0, angle_rad}), f->q_nb);
}

bool fusion_aid_yaw(struct fusion *f, double yaw_rad, double sigma_rad, struct vec3 gyro_b_rad_s)
{
	const struct vec3 now = aerospace_from_quat(fusion_attitude_now(f, gyro_b_rad_s));
	double off = remainder(yaw_rad - now.z, 2 * PI), variance = sigma_rad * sigma_rad, own, turn;
	bool first = !f->north_known;

	if (!f->started || cos(now.y) < LEAST_LEVEL)
		return false;
	/* an error of the tilt is one of the yaw, by the tangent of the pitch */
	variance += pow(tan(now.y), 2) * (f->kalman.covariance[0][0] + f->kalman.covariance[1][1]) / 2;
	if (first) {
		turn_heading(f, off);
		f->north_known = true;
		fusion_kalman_set_heading(&f->kalman, variance);
		return true;
	}
	if (f->config.algorithm == FUSION_KALMAN)
		return fusion_kalman_aid_heading(
			&f->kalman, &f->config.kalman, off, variance, &f->q_nb, &f->gyro_errors);
	own = f->config.kalman.heading_sigma_rad * f->config.kalman.heading_sigma_rad;
	turn = own / (own + variance) * off;
	turn_heading(f, turn);
	f->kalman.north_rad -= turn;
	f->kalman.aided_heading_s = AID_S;
	return false;
}

void fusion_aid_velocity(struct fusion *f, struct vec3 velocity_n_m_s, double sigma_m_s, struct vec3 gyro_b_rad_s)
{
	struct vec3 rate = fusion_rate_b(f, gyro_b_rad_s);
	struct vec3 lever_n = quat_rotate(f->q_nb, vec3_cross(rate, f->config.lever_arm_b_m));

	if (f->started && f->config.algorithm == FUSION_KALMAN)
		fusion_kalman_aid_velocity(&f->kalman, &f->config.kalman, velocity_n_m_s, lever_n,
			sigma_m_s * sigma_m_s, &f->q_nb, &f->gyro_errors);
}
