#include "model/fusion_kalman.h"

#include <errno.h>
#include <string.h>

#include "model/math/kalman.h"
#include "model/math/rotation.h"
#include "model/math/units.h"

enum {
	BIAS = KALMAN_BIAS,
	SCALE = KALMAN_SCALE,
	VELOCITY = KALMAN_VELOCITY,
	HEADING = KALMAN_HEADING,
	STATES = KALMAN_STATES
};

/* Time between two corrections: short against the filter's time constants, long enough to cost little. */
static const double CORRECTION_S = 0.03;
/* 1 sigma at the start. A wrong tilt makes the field's heading wrong by more: by the tangent of the dip. */
static const double START_TILT_RAD = 0.1, HEADING_BY_TILT = 3, START_VELOCITY_M_S = 0.3,
		    START_BIAS_RAD_S = 0.5 * RAD_PER_DEG;
/* No working gyro has more bias than this; the scale is within so many of its sigmas. */
static const double MOST_BIAS_RAD_S = 2 * RAD_PER_DEG, MOST_SIGMAS = 5;
/* What was learnt of the scale is outdated after that time (temperature, ageing). */
static const double SCALE_TIME_S = 36000;
/* White noise of the gyro, rad/s/sqrt(Hz): in motion with what else goes wrong there, and at rest. */
static const double GYRO_NOISE = 0.12 * RAD_PER_DEG, REST_GYRO_NOISE = 0.03 * RAD_PER_DEG;
/* For how long the gyro's error in motion, and a velocity, keep their sign. */
static const double GYRO_ERROR_TIME_S = 0.3, VELOCITY_TIME_S = 0.5;
/* The spread of the velocity: its memory, and the least of it as a share of the configured. */
static const double SPREAD_TIME_S = 3, LEAST_SPREAD = 0.2;
/* Velocity at rest: of the sensor's mounting, of vibration; m/s in one correction. */
static const double REST_VELOCITY_M_S = 0.01;
/* Memory of the mean force, which is gravity's; further off the vertical than this, the tilt is lost; 1 sigma of the
 * heading then. */
static const double MEAN_FORCE_TIME_S = 1, LOST_TILT_RAD = 60 * RAD_PER_DEG, LOST_HEADING_RAD = 1;
/* A rate at the end of the gyro's range may be larger by that share of it. */
static const double SATURATED_SHARE = 0.5;
/* A longer time without samples leaves no velocity to integrate from. */
static const double GAP_S = 0.1;
/* The least horizontal part of the field, as a share of it, that shows a heading. */
static const double LEAST_HORIZONTAL = 1e-3;
/* Turned by so much, the object sees another error of the field; but slow or still, one may wait only so long for it, and
 * fast, the sensor's lag makes the error last. */
static const double POSE_RAD = 1, POSE_LEAST_S = 0.5, POSE_MOST_S = 3;
/* Memory of the field's reference, and of the one that may come in its place: that is taken after it has stayed within
 * the limits for OTHER_FIELD_S and attitudes so far apart that their mean rotation matrix has shrunk to this share of its
 * size (squared; to and fro about one axis by 80 degrees, say). */
static const double REFERENCE_TIME_S = 60, OTHER_FIELD_TIME_S = 2, OTHER_FIELD_S = 20, TURNED_SHARE = 0.7;
/* A tilt known worse than that makes the dip seen count for less. */
static const double DIP_TILT_RAD = 2 * RAD_PER_DEG;
/* After a disturbance the field has to be within the limits for so long. */
static const double UNDISTURBED_S = 0.25;
/* Of the disturbance seen in length and dip, squared, what is to be expected in the heading: as much as along each. */
static const double DISTURBANCE_SHARE = 0.5;
/* At rest, the field of the first time counts, and one near it by this share of its length. */
static const double STILL_FIELD_S = 1, STILL_FIELD_SHARE = 0.04;
/* An attitude from outside is taken to be right within this. What is told from outside holds for so long. */
static const double SET_ANGLE_RAD = 1 * RAD_PER_DEG, TOLD_S = 10;
/* No working gyro loses the heading by so much. */
static const double ASTRAY_RAD = 60 * RAD_PER_DEG;
/* Unless the tilt was wrong when the field was first seen, which this much of it, well known, rules out. */
static const double KNOWN_FIELD_S = 10;
/* A heading told that is further off is refused, but not the fifth in a row: then this filter is wrong; a velocity takes
 * the place of what was. */
static const double GATE_SIGMAS = 5;
enum { YAW_REFUSED_MOST = 5 };
/* Memory of where the field points to in the frame of the headings told. */
static const double NORTH_TIME_S = 10;
/* Time in bounds makes up for time in rejection; a field that counts though it is out of bounds counts for less. */
static const double RECOVERY = 2, REJECTED_WEIGHT = 16;

static bool within(double value, double low, double high)
{
	return value >= low && value <= high;
}

int fusion_kalman_check(const struct fusion_kalman_config *c)
{
	return within(c->velocity_sigma_m_s, 0.01, 1000) && within(c->heading_sigma_rad, 0.001, 1) &&
			       within(c->field_limit, 0.01, 1) && within(c->rejection_time_s, 0, 1e6) &&
			       within(c->gyro_error, 0, 0.1) && within(c->bias_walk_rad_s_sqrt_s, 0, 0.1) &&
			       within(c->gyro_scale_sigma, 0, 0.05)
		       ? 0
		       : -EINVAL;
}

static void renew(struct fusion_kalman *k, int i, double variance)
{
	kalman_set_variance(STATES, k->covariance[0], i, variance);
}

static void forget_gathered(struct fusion_kalman *k)
{
	k->time_s = k->rest_s = k->turned_rad2_s = k->lost_rad = 0;
	memset(k->turn_s, 0, sizeof(k->turn_s));
	memset(k->rate_turn_rad, 0, sizeof(k->rate_turn_rad));
	k->force_n_m_s = k->gyro_b_rad = k->field_n_uT = (struct vec3){0, 0, 0};
	k->fields = 0;
}

static void renew_velocity(struct fusion_kalman *k)
{
	for (int i = 0; i < 2; i++) {
		k->velocity_n_m_s[i] = 0;
		renew(k, VELOCITY + i, squared(START_VELOCITY_M_S));
	}
}

void fusion_kalman_forget_scale(struct fusion_kalman *k, const struct fusion_kalman_config *config)
{
	for (int i = SCALE; i < SCALE + 3; i++)
		renew(k, i, squared(config->gyro_scale_sigma));
}

void fusion_kalman_forget_errors(struct fusion_kalman *k, const struct fusion_kalman_config *config)
{
	for (int i = BIAS; i < BIAS + 3; i++)
		renew(k, i, squared(START_BIAS_RAD_S));
	fusion_kalman_forget_scale(k, config);
}

void fusion_kalman_turn(struct fusion_kalman *k, const struct fusion_kalman_config *config, struct quat turn,
	struct gyro_errors *learnt)
{
	double(*c)[STATES] = k->covariance;
	double variance = fmax(c[BIAS][BIAS], fmax(c[BIAS + 1][BIAS + 1], c[BIAS + 2][BIAS + 2]));

	for (int i = BIAS; i < BIAS + 3; i++)
		renew(k, i, variance);
	fusion_kalman_forget_scale(k, config);
	learnt->bias_b_rad_s = quat_rotate(turn, learnt->bias_b_rad_s);
	learnt->scale_b = (struct vec3){0, 0, 0};
	k->lever_arm_b_m = quat_rotate(turn, k->lever_arm_b_m);
	forget_gathered(k);
}

/* At rest the force is as long as gravity, whose length on Earth is 9.8 within half a percent. */
void fusion_kalman_start(struct fusion_kalman *k, const struct fusion_kalman_config *config, double force_m_s2)
{
	double tilt = fmin(START_TILT_RAD + fabs(force_m_s2 / 9.8 - 1), 1);

	for (int i = 0; i < HEADING; i++)
		renew(k, i, squared(tilt));
	renew(k, HEADING, squared(config->heading_sigma_rad));
	renew_velocity(k);
	if (k->covariance[BIAS][BIAS] == 0)
		fusion_kalman_forget_errors(k, config);
	k->spread_m2_s2 = squared(LEAST_SPREAD * config->velocity_sigma_m_s);
	k->mean_force_n_m_s2 = (struct vec3){0, 0, force_m_s2};
	k->lever_known = false;
	forget_gathered(k);
}

void fusion_kalman_north(struct fusion_kalman *k, const struct fusion_kalman_config *config)
{
	renew(k, HEADING, squared(config->heading_sigma_rad) + squared(HEADING_BY_TILT) * k->covariance[0][0]);
	k->norm_uT = 0; /* the next field is the reference */
}

void fusion_kalman_set(struct fusion_kalman *k, const struct fusion_kalman_config *config)
{
	for (int i = 0; i <= HEADING; i++)
		renew(k, i, squared(SET_ANGLE_RAD));
	renew_velocity(k);
	if (k->covariance[BIAS][BIAS] == 0)
		fusion_kalman_forget_errors(k, config);
	k->norm_uT = 0;
	k->north_open = true;
	forget_gathered(k);
}

/* c = F c: attitude += rate_turn scale - turn bias; velocity += attitude x force. An error of the attitude falsifies the
 * accelerometer's velocity and the lever arm's share of it alike: force is what the reference point feels. */
static void transit(struct fusion_kalman *k, struct vec3 f)
{
	const double cross[6] = {0, f.z, -f.y, -f.z, 0, f.x};
	double *p = k->covariance[0];

	kalman_add_rows(STATES, p, 0, 3, -1, k->turn_s[0], BIAS);
	kalman_add_rows(STATES, p, 0, 3, 1, k->rate_turn_rad[0], SCALE);
	kalman_add_rows(STATES, p, VELOCITY, 2, 1, cross, 0);
}

/* The errors' covariance carried over what was gathered: F c F^T + noise, c being symmetric. */
static void predict(struct fusion_kalman *k, const struct fusion_kalman_config *config)
{
	struct vec3 force = vec3_sub(k->force_n_m_s, vec3_sub(k->lever_n_m_s, k->lever_from_n_m_s));
	double t = k->time_s;
	double turn_noise = t * squared(GYRO_NOISE) +
			    squared(config->gyro_error) * GYRO_ERROR_TIME_S * k->turned_rad2_s + squared(k->lost_rad);

	transit(k, force);
	kalman_transpose(STATES, k->covariance[0]);
	transit(k, force);
	for (int i = 0; i < 3; i++) {
		k->covariance[i][i] += turn_noise;
		k->covariance[BIAS + i][BIAS + i] += t * squared(config->bias_walk_rad_s_sqrt_s);
	}
	for (int i = SCALE; i < SCALE + 3; i++)
		k->covariance[i][i] +=
			fmin(1, t / SCALE_TIME_S) * fmax(0, squared(config->gyro_scale_sigma) - k->covariance[i][i]);
}

/* State i was measured; `error` holds the errors found so far, of all states. A measured heading teaches nothing about the
 * scale (the last states), which only adds to its uncertainty. */
static void measure(struct fusion_kalman *k, double *error, int i, double measured, double variance)
{
	double ph[STATES], innovation = measured - error[i], innovation_variance = k->covariance[i][i] + variance;

	memcpy(ph, k->covariance[i], sizeof(ph));
	kalman_update(
		STATES, i == HEADING ? SCALE : STATES, k->covariance[0], error, ph, innovation, innovation_variance);
}

static void measure_velocity(struct fusion_kalman *k, const struct fusion_kalman_config *config,
	struct vec3 lever_n_m_s, bool rest, double *error)
{
	double x = k->velocity_n_m_s[0] - lever_n_m_s.x - k->told_n_m_s[0];
	double y = k->velocity_n_m_s[1] - lever_n_m_s.y - k->told_n_m_s[1];
	double most = squared(config->velocity_sigma_m_s), share = fmin(1, k->time_s / SPREAD_TIME_S), variance;

	k->spread_m2_s2 += share * ((x * x + y * y) / 2 - k->spread_m2_s2);
	k->spread_m2_s2 = fmin(most, fmax(k->spread_m2_s2, squared(LEAST_SPREAD) * most));
	variance = rest ? squared(REST_VELOCITY_M_S) : 2 * VELOCITY_TIME_S / k->time_s * k->spread_m2_s2;
	measure(k, error, VELOCITY, -x, variance);
	measure(k, error, VELOCITY + 1, -y, variance);
}

static void measure_bias(struct fusion_kalman *k, struct vec3 bias, double *error)
{
	struct vec3 d = vec3_sub(vec3_scale(1 / k->time_s, k->gyro_b_rad), bias);
	double variance = squared(REST_GYRO_NOISE) / k->time_s;

	measure(k, error, BIAS, d.x, variance);
	measure(k, error, BIAS + 1, d.y, variance);
	measure(k, error, BIAS + 2, d.z, variance);
}

struct field {
	double norm_uT, dip_rad, horizontal_uT, off_norm_uT, off_dip_rad;
	double rate_rad_s; /* at which the object turns */
	bool within;	   /* the limits around the reference */
};

/* The dip is seen only as well as the tilt is known. */
static bool near(const struct fusion_kalman *k, double off_norm, double norm, double off_dip, double limit)
{
	double tilt = sqrt(k->covariance[0][0] + k->covariance[1][1]);

	return fabs(off_norm) < limit * norm && fabs(off_dip) < 2 * (limit + tilt);
}

/* Looks for another field that stays the same while the object turns, and takes it for the reference after a while. */
static void watch_other_field(struct fusion_kalman *k, const struct field *f, double limit)
{
	double off_norm = f->norm_uT - k->other_norm_uT, off_dip = f->dip_rad - k->other_dip_rad;
	double share = fmin(1, k->time_s / OTHER_FIELD_TIME_S), size = 0;

	if (f->within || !near(k, off_norm, k->other_norm_uT, off_dip, limit)) {
		k->other_norm_uT = f->norm_uT;
		k->other_dip_rad = f->dip_rad;
		k->other_s = 0;
		memset(k->other_turn_s, 0, sizeof(k->other_turn_s));
		return;
	}
	k->other_norm_uT += share * off_norm;
	k->other_dip_rad += share * off_dip;
	k->other_s += k->time_s;
	for (int i = 0; i < 9; i++) {
		k->other_turn_s[i / 3][i % 3] += k->turn_s[i / 3][i % 3];
		size += squared(k->other_turn_s[i / 3][i % 3]) / 3;
	}
	if (k->other_s < OTHER_FIELD_S || size > TURNED_SHARE * squared(k->other_s))
		return;
	k->norm_uT = k->other_norm_uT;
	k->dip_rad = k->other_dip_rad;
}

/* The reference follows the undisturbed field, and the times of disturbance are kept. Returns the factor of the heading's
 * variance, 0: the field does not count. */
static double judge_field(struct fusion_kalman *k, const struct fusion_kalman_config *config, const struct field *f)
{
	double known_s, share;

	watch_other_field(k, f, config->field_limit);
	if (!f->within) {
		k->undisturbed_s = 0;
		k->rejected_s = fmin(k->rejected_s + k->time_s, config->rejection_time_s);
		return k->rejected_s < config->rejection_time_s ? 0 : REJECTED_WEIGHT;
	}
	known_s =
		k->time_s * squared(DIP_TILT_RAD) / (squared(DIP_TILT_RAD) + k->covariance[0][0] + k->covariance[1][1]);
	k->reference_s = fmin(k->reference_s + known_s, REFERENCE_TIME_S);
	share = fmin(1, known_s / k->reference_s);
	k->norm_uT += share * f->off_norm_uT;
	k->dip_rad += share * f->off_dip_rad;
	k->undisturbed_s += k->time_s;
	k->rejected_s = fmax(0, k->rejected_s - RECOVERY * k->time_s);
	return k->undisturbed_s < UNDISTURBED_S ? 0 : 1;
}

/* An object at rest sees the same field as long as nobody moves a magnet. */
static bool field_moved_at_rest(struct fusion_kalman *k, struct vec3 field_n_uT, bool rest)
{
	if (!rest) {
		k->still_s = 0;
		return false;
	}
	if (k->still_s < STILL_FIELD_S) {
		k->still_s += k->time_s;
		k->still_field_n_uT = vec3_add(k->still_field_n_uT,
			vec3_scale(fmin(1, k->time_s / k->still_s), vec3_sub(field_n_uT, k->still_field_n_uT)));
	}
	return vec3_norm(vec3_sub(field_n_uT, k->still_field_n_uT)) > STILL_FIELD_SHARE * k->norm_uT;
}

/* Where the field points to is the reference, too, and follows as long as the heading is told. Returns how far the
 * attitude is off that. */
static double off_north(struct fusion_kalman *k, double bearing_rad)
{
	if (k->north_open)
		k->north_rad = bearing_rad;
	k->north_open = false;
	if (k->yaw_s > 0)
		k->north_rad += k->time_s / (NORTH_TIME_S + k->time_s) * remainder(bearing_rad - k->north_rad, 2 * PI);
	return remainder(bearing_rad - k->north_rad, 2 * PI);
}

/* A field like the reference's, but from where north cannot be, is a magnet's that happens to be as long and to dip as much;
 * that it stays so for long tells that the heading is lost. */
static bool astray(struct fusion_kalman *k, const struct fusion_kalman_config *config, double off_rad, double variance)
{
	double believed =
		fmax(squared(ASTRAY_RAD), squared(GATE_SIGMAS) * (k->covariance[HEADING][HEADING] + variance));

	if (squared(off_rad) < believed || k->reference_s < KNOWN_FIELD_S) {
		k->astray_s = fmax(0, k->astray_s - RECOVERY * k->time_s);
		return false;
	}
	k->astray_s += k->time_s;
	if (k->astray_s < config->rejection_time_s)
		return true;
	renew(k, HEADING, squared(off_rad));
	k->astray_s = 0;
	return false;
}

static bool measure_heading(
	struct fusion_kalman *k, const struct fusion_kalman_config *config, bool rest, double *error)
{
	struct vec3 m = vec3_scale(1.0 / k->fields, k->field_n_uT);
	struct field f = {.norm_uT = vec3_norm(m), .horizontal_uT = hypot(m.x, m.y)};
	double factor, variance = squared(config->heading_sigma_rad) + squared(HEADING_BY_TILT) * k->covariance[0][0],
		       pose_s, off;

	if (!(f.horizontal_uT > LEAST_HORIZONTAL * f.norm_uT))
		return false;
	f.dip_rad = atan2(-m.z, f.horizontal_uT);
	if (k->norm_uT == 0) {
		k->norm_uT = f.norm_uT;
		k->dip_rad = f.dip_rad;
		k->undisturbed_s = UNDISTURBED_S;
		k->reference_s = k->rejected_s = k->astray_s = 0;
	}
	f.off_norm_uT = f.norm_uT - k->norm_uT;
	f.off_dip_rad = f.dip_rad - k->dip_rad;
	f.within = near(k, f.off_norm_uT, k->norm_uT, f.off_dip_rad, config->field_limit);
	f.rate_rad_s = sqrt(k->turned_rad2_s / k->time_s);
	variance += DISTURBANCE_SHARE * (squared(f.off_norm_uT) + squared(k->norm_uT * f.off_dip_rad)) /
		    squared(f.horizontal_uT);
	factor = judge_field(k, config, &f);
	if (field_moved_at_rest(k, m, rest) || factor == 0)
		return false;
	off = off_north(k, atan2(m.x, m.y));
	if (k->yaw_s > 0 || astray(k, config, off, variance))
		return false;
	pose_s = fmin(POSE_MOST_S, fmax(POSE_LEAST_S, POSE_RAD / (f.rate_rad_s + 1e-9)));
	measure(k, error, HEADING, off, factor * 2 * pose_s / k->time_s * variance);
	return true;
}

/* Measurements without sense (1000 rad/s, 100 km/s^2) may leave a covariance that is none. */
static bool sound(const struct fusion_kalman *k)
{
	for (int i = 0; i < STATES; i++)
		if (!(k->covariance[i][i] >= 0 && k->covariance[i][i] < 1e6))
			return false;
	return true;
}

/* Adds what was found; the sum is no longer than `most`. */
static void learn(struct vec3 *of, const double *error, double most)
{
	double norm;

	*of = vec3_add(*of, (struct vec3){error[0], error[1], error[2]});
	norm = vec3_norm(*of);
	if (norm > most)
		*of = vec3_scale(most / norm, *of);
}

static void apply(struct fusion_kalman *k, const struct fusion_kalman_config *config, const double *error,
	struct quat *q_nb, struct gyro_errors *learnt)
{

	*q_nb = quat_normalize(
		quat_multiply(quat_from_rotation_vector((struct vec3){error[0], error[1], error[2]}), *q_nb));
	k->velocity_n_m_s[0] += error[VELOCITY];
	k->velocity_n_m_s[1] += error[VELOCITY + 1];
	learn(&learnt->bias_b_rad_s, error + BIAS, MOST_BIAS_RAD_S);
	learn(&learnt->scale_b, error + SCALE, MOST_SIGMAS * config->gyro_scale_sigma);
}

void fusion_kalman_set_heading(struct fusion_kalman *k, double variance_rad2)
{
	renew(k, HEADING, variance_rad2);
	renew_velocity(k);
	forget_gathered(k);
	k->north_open = true;
	k->yaw_s = TOLD_S;
	k->yaw_refused = 0;
}

bool fusion_kalman_aid_heading(struct fusion_kalman *k, const struct fusion_kalman_config *config, double off_rad,
	double variance_rad2, struct quat *q_nb, struct gyro_errors *learnt)
{
	double error[STATES] = {0}, total = k->covariance[HEADING][HEADING] + variance_rad2;

	if (squared(off_rad) > squared(GATE_SIGMAS) * total) {
		if (++k->yaw_refused < YAW_REFUSED_MOST)
			return false;
		*q_nb = quat_multiply(quat_from_rotation_vector((struct vec3){0, 0, off_rad}), *q_nb);
		fusion_kalman_set_heading(k, variance_rad2);
		return true;
	}
	measure(k, error, HEADING, off_rad, variance_rad2);
	apply(k, config, error, q_nb, learnt);
	k->yaw_s = TOLD_S;
	k->yaw_refused = 0;
	return false;
}

void fusion_kalman_aid_velocity(struct fusion_kalman *k, const struct fusion_kalman_config *config,
	struct vec3 velocity_n_m_s, struct vec3 lever_n_m_s, double variance_m2_s2, struct quat *q_nb,
	struct gyro_errors *learnt)
{
	double error[STATES] = {0};

	double x = velocity_n_m_s.x + lever_n_m_s.x - k->velocity_n_m_s[0];
	double y = velocity_n_m_s.y + lever_n_m_s.y - k->velocity_n_m_s[1];
	double total = k->covariance[VELOCITY][VELOCITY] + k->covariance[VELOCITY + 1][VELOCITY + 1];

	/* the lever arm's share is known as well as the attitude */
	variance_m2_s2 += vec3_dot(lever_n_m_s, lever_n_m_s) * k->covariance[HEADING][HEADING];

	if (k->told_s == 0 || x * x + y * y > squared(GATE_SIGMAS) * (total + 2 * variance_m2_s2)) {
		renew_velocity(k);
		k->velocity_n_m_s[0] = velocity_n_m_s.x + lever_n_m_s.x;
		k->velocity_n_m_s[1] = velocity_n_m_s.y + lever_n_m_s.y;
	} else {
		measure(k, error, VELOCITY, x, variance_m2_s2);
		measure(k, error, VELOCITY + 1, y, variance_m2_s2);
		apply(k, config, error, q_nb, learnt);
	}
	k->told_n_m_s[0] = velocity_n_m_s.x;
	k->told_n_m_s[1] = velocity_n_m_s.y;
	k->told_s = TOLD_S;
}

/* What was told is forgotten after a while: without it, another velocity is expected. */
static void age_what_was_told(struct fusion_kalman *k)
{
	k->yaw_s = fmax(0, k->yaw_s - k->time_s);
	if (k->told_s == 0)
		return;
	k->told_s = fmax(0, k->told_s - k->time_s);
	if (k->told_s > 0)
		return;
	k->told_n_m_s[0] = k->told_n_m_s[1] = 0;
	renew_velocity(k);
}

/* Upside down, an error of the tilt would not show as one: found anew from the mean force. Returns whether it had to be. */
static bool find_tilt_again(struct fusion_kalman *k, const struct fusion_kalman_config *config, struct quat *q_nb,
	struct gyro_errors *learnt)
{
	struct vec3 *mean = &k->mean_force_n_m_s2, now = vec3_scale(1 / k->time_s, k->force_n_m_s), axis;
	double length, angle;

	*mean = vec3_add(*mean, vec3_scale(k->time_s / (MEAN_FORCE_TIME_S + k->time_s), vec3_sub(now, *mean)));
	length = vec3_norm(*mean);
	if (!(mean->z < cos(LOST_TILT_RAD) * length))
		return false;
	angle = acos(fmax(-1, mean->z / length));
	axis = (struct vec3){mean->y, -mean->x, 0};
	axis = vec3_norm(axis) > 1e-9 * length ? vec3_scale(1 / vec3_norm(axis), axis) : (struct vec3){1, 0, 0};
	*q_nb = quat_normalize(quat_multiply(quat_from_rotation_vector(vec3_scale(angle, axis)), *q_nb));
	*learnt = (struct gyro_errors){0};
	fusion_kalman_forget_errors(k, config);
	fusion_kalman_start(k, config, length);
	renew(k, HEADING, squared(LOST_HEADING_RAD));
	return true;
}

static bool correct(struct fusion_kalman *k, const struct fusion_kalman_config *config, struct vec3 lever_n_m_s,
	struct quat *q_nb, struct gyro_errors *learnt)
{
	double error[STATES] = {0};
	bool rest = k->rest_s > 0.5 * k->time_s, field_used;

	if (find_tilt_again(k, config, q_nb, learnt))
		return false;
	predict(k, config);
	age_what_was_told(k);
	measure_velocity(k, config, lever_n_m_s, rest, error);
	if (rest)
		measure_bias(k, learnt->bias_b_rad_s, error);
	field_used = k->fields > 0 && measure_heading(k, config, rest, error);
	if (!sound(k)) {
		*learnt = (struct gyro_errors){0};
		fusion_kalman_forget_errors(k, config);
		fusion_kalman_start(k, config, 0);
		return false;
	}
	apply(k, config, error, q_nb, learnt);
	forget_gathered(k);
	return field_used;
}

static void add_turn(struct fusion_kalman *k, struct quat q, struct vec3 rate_b_rad_s, double dt_s)
{
	struct mat3 m = mat3_from_quat(q);
	const double turned_rad[3] = {dt_s * rate_b_rad_s.x, dt_s * rate_b_rad_s.y, dt_s * rate_b_rad_s.z};

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++) {
			k->turn_s[i][j] += dt_s * m.m[i][j];
			k->rate_turn_rad[i][j] += turned_rad[j] * m.m[i][j];
		}
}

/* Over missing samples the rate may have been any other, and the velocity is anyone's guess: this sample counts alone. */
static void skip_gap(struct fusion_kalman *k, struct vec3 rate_b_rad_s, double dt_s)
{
	double off = fmin(1, squared(dt_s) * vec3_dot(rate_b_rad_s, rate_b_rad_s));

	for (int i = 0; i <= HEADING; i++)
		k->covariance[i][i] += off;
	renew_velocity(k);
	forget_gathered(k);
	k->lever_known = false;
}

/* A new lever arm is no jump of the velocity. */
static void move_reference_point(struct fusion_kalman *k, const struct fusion_kalman_sample *s, struct quat q_nb)
{
	struct vec3 moved = vec3_sub(s->lever_arm_b_m, k->lever_arm_b_m);
	struct vec3 v = quat_rotate(q_nb, vec3_cross(s->rate_b_rad_s, moved));

	k->velocity_n_m_s[0] += v.x;
	k->velocity_n_m_s[1] += v.y;
	k->lever_n_m_s = vec3_add(k->lever_n_m_s, v);
	k->lever_from_n_m_s = vec3_add(k->lever_from_n_m_s, v);
	k->lever_arm_b_m = s->lever_arm_b_m;
}

bool fusion_kalman_step(struct fusion_kalman *k, const struct fusion_kalman_config *config,
	const struct fusion_kalman_sample *s, double dt_s, struct quat *q_nb, struct gyro_errors *learnt)
{
	struct vec3 force_n = quat_rotate(*q_nb, s->force_b_m_s2);
	struct vec3 lever_n = quat_rotate(*q_nb, vec3_cross(s->rate_b_rad_s, s->lever_arm_b_m));

	move_reference_point(k, s, *q_nb);
	if (dt_s > GAP_S) {
		skip_gap(k, s->rate_b_rad_s, dt_s);
		dt_s = CORRECTION_S;
	}
	if (k->time_s == 0)
		k->lever_from_n_m_s = k->lever_known ? k->lever_n_m_s : lever_n;
	k->lever_n_m_s = lever_n;
	k->lever_known = true;
	add_turn(k, *q_nb, s->rate_b_rad_s, dt_s);
	k->force_n_m_s = vec3_add(k->force_n_m_s, vec3_scale(dt_s, force_n));
	k->velocity_n_m_s[0] += dt_s * force_n.x;
	k->velocity_n_m_s[1] += dt_s * force_n.y;
	k->gyro_b_rad = vec3_add(k->gyro_b_rad, vec3_scale(dt_s, s->gyro_b_rad_s));
	k->turned_rad2_s += dt_s * vec3_dot(s->rate_b_rad_s, s->rate_b_rad_s);
	k->rest_s += s->rest ? dt_s : 0;
	k->lost_rad += s->saturated ? SATURATED_SHARE * dt_s * vec3_norm(s->rate_b_rad_s) : 0;
	if (s->field_b_uT) {
		k->field_n_uT = vec3_add(k->field_n_uT, quat_rotate(*q_nb, *s->field_b_uT));
		k->fields++;
	}
	k->time_s += dt_s;
	if (k->time_s < CORRECTION_S)
		return false;
	return correct(k, config, lever_n, q_nb, learnt);
}
