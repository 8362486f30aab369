#include "model/fusion_kalman.h"

#include <errno.h>
#include <float.h>
#include <string.h>

#include "model/math/kalman.h"
#include "model/math/rotation.h"
#include "model/math/units.h"
#include "model/noise.h"

enum {
	BIAS = KALMAN_BIAS,
	SCALE = KALMAN_SCALE,
	ACCEL = KALMAN_ACCEL,
	VELOCITY = KALMAN_VELOCITY,
	HEADING = KALMAN_HEADING,
	STATES = KALMAN_STATES
};

/* Where a constant is "tuned", its value was chosen for the least attitude error on the recorded trials of BROAD and in
 * the simulations of tests/unit/test_fusion_kalman.c. Where it is "by judgement", the reason is all there is. */

/* ---- timing ---- */

/* s between two corrections. By judgement: a tenth of the shortest time constant below (0.25 s), and at 200 samples a
 * second a correction with every sixth sample only. */
static const double CORRECTION_S = 0.03;

/* ---- start ---- */

/* rad, 1 sigma of the tilt from the first sample (6 degrees). By judgement: an acceleration of 1 m/s^2 at that
 * moment. */
static const double START_TILT_RAD = 0.1;
/* Error of the heading per error of the tilt. Derived: the tangent of the dip, 2.5 at the 68 degrees of Central Europe,
 * with some margin. */
static const double HEADING_BY_TILT = 3;
/* m/s, 1 sigma of the velocity when nothing is known of it. By judgement: a hand or a slow robot. */
static const double START_VELOCITY_M_S = 0.3;
/* rad, 1 sigma of an attitude from outside. By judgement: a fixture or another attitude system. */
static const double SET_ANGLE_RAD = 1 * RAD_PER_DEG;

/* ---- process noise ---- */

/* rad/s/sqrt(Hz), of the gyro in motion about horizontal axes and about the vertical. Datasheets have 0.03. Measured:
 * on the trials of BROAD the integrated rate departs from the optical attitude by 0.1 deg/sqrt(s) at most in the tilt,
 * and by up to 0.22 in the heading, where no later turn takes it back. */
static const double TILT_NOISE = 0.09 * RAD_PER_DEG, HEADING_NOISE = 0.12 * RAD_PER_DEG;
/* s, for which the error that is proportional to the rate keeps its sign: its correlation time. By judgement: half a
 * period of a quick hand. */
static const double GYRO_ERROR_TIME_S = 0.3;
/* 1 sigma of the rate beyond the end of the gyro's range, as a share of the range. By judgement. */
static const double SATURATED_SHARE = 0.5;
/* s, in which the scale's variance returns to its start (10 hours). By judgement: temperature and ageing. */
static const double SCALE_TIME_S = 36000;
/* rad/s, limit of the bias estimate, all axes together. Datasheet: zero-rate level of the L3GD20 at 2000 deg/s, up to
 * 75 deg/s; most chips have a third of it on each axis. What turns steadily faster than that lies on a turntable. */
static const double MOST_BIAS_RAD_S = 45 * RAD_PER_DEG;
/* Limit of the scale estimate, in its 1 sigma. By judgement: beyond five sigma the configured sigma is wrong. */
static const double MOST_SCALE_SIGMAS = 5;
/* 1 sigma of the scale beyond which it is considered, not estimated. Measured: in a motion to and fro a lever arm that
 * is not configured looks like a scale error, at 0.3 m and 0.5 Hz like one of 30 %. A scale known to 0.005 keeps
 * the tilt within its sigma there, one to 0.01 does not. */
static const double SCALE_ESTIMATED = 0.005;

/* ---- measured velocity ---- */

/* s, correlation time of a velocity in motion: consecutive measurements of zero velocity are not independent. Measured:
 * the optical velocity of the slower trials of BROAD has 0.2 to 0.55 s at 0.25 to 0.6 Hz, 0.04 to 0.2 s below that. */
static const double VELOCITY_TIME_S = 0.25;
/* s, memory of the velocity's variance. By judgement: several periods of a hand's motion. */
static const double SPREAD_TIME_S = 3;
/* Least 1 sigma of the velocity as a share of the configured one. Tuned: 0.35 m/s keep the errors of the gyro in a pure
 * rotation about the reference point, and those of a robot arm's accelerometer, from being estimated as bias. */
static const double LEAST_SPREAD = 0.35;
/* m/s, 1 sigma of the velocity at rest, per correction. By judgement: vibration of the support. */
static const double REST_VELOCITY_M_S = 0.01;
/* m/s, 1 sigma of the velocity when rest begins: a steady motion has any constant velocity, and feels like rest. By
 * judgement: a vehicle indoors. */
static const double STEADY_VELOCITY_M_S = 3;
/* rad/s/sqrt(Hz), of the gyro at rest: the density in datasheets (L3GD20: 0.03 deg/s/sqrt(Hz)). */
static const double REST_GYRO_NOISE = 0.03 * RAD_PER_DEG;

/* s, correlation time of the errors of vibration and clipping. By judgement: the beat of a vibration against the
 * samples. */
static const double FORCE_ERROR_S = 4;
/* Sigmas of the mean force at rest, or of the velocity, beyond which the force is wrong. Convention. */
static const double CONTRADICTS = 3, FAST = 2;
/* s, for which a motion has no constant acceleration, unless it turns faster than this. By judgement: a lever arm of a
 * metre has 0.04 m/s^2 then. */
static const double STEADY_S = 1, STEADY_TURN_RAD_S = 0.2;
/* m/s^2, 1 sigma of the mean force of a second at rest. By judgement: slow motion of the support. */
static const double STEADY_FORCE_M_S2 = 0.02;
/* s, for which the first attitude is not independent of the accelerometer. By judgement: two memories of the
 * velocity. */
static const double YOUNG_S = 6;
/* A tilt that is not young is lost when the mean force has been far from the vertical for so long (s), and its length
 * differs from gravity by less than this (m/s^2). By judgement: a hand in fast motion. */
static const double LOST_S = 3, LOST_LENGTH_M_S2 = 3;

/* s, memory of the rate about the vertical that is steady. By judgement: some memories of the velocity. */
static const double CIRCLE_S = 5;

/* ---- bias at rest ---- */

/* s, over which the rate is averaged before it counts as bias, once the next mean agrees with it: a motion that begins
 * within a second of it keeps it from being estimated. By judgement: a motion begins within a second. */
static const double BLOCK_S = 1;
/* s, by which a signal that was steady from the start on may have been so for less: the detector has no first sample.
 * By judgement: some corrections. */
static const double STEADY_SINCE_START_S = 0.1;
/* uT, least turn of the field that tells. By judgement: above a magnetometer's noise in a second. */
static const double FIELD_TURNS_UT = 0.3;
/* Sigmas within which two means agree, a mean agrees with the bias estimate, and the short mean with it. Convention,
 * for three axes at a time. */
static const double BLOCK_SIGMAS = 4, BIAS_SIGMAS = 3.5, TURNING_SIGMAS = 4;
/* s, of the short mean. By judgement: a swing turns by more than its sigma within that time. */
static const double MEAN_RATE_S = 0.3;
/* s, memory of the mean length of the force, and the time before which it is not taken at its word. By judgement:
 * motion within a second averages out less than within ten. */
static const double MEAN_LENGTH_S = 10, MEAN_LENGTH_LEAST_S = 0.5;
/* m/s^2, by which that length is too short in motion, too. By judgement: 2 %, more than any calibrated accelerometer
 * lacks, and than motion takes away in a mean. */
static const double UNCALIBRATED_M_S2 = 0.2;
/* m/s^2, by which it may differ at rest: three sigma of the calibration. */
static const double UNCALIBRATED_AT_REST_M_S2 = 0.09;
/* s, memory of that mean while it is further off than any calibration explains, so that it ends soon after the
 * vibration. */
static const double SHORT_MEMORY_S = 2;
/* m/s^2, by which a mean length differs that no calibration explains: vibration beyond the sensor's bandwidth or range.
 * By judgement: data sheets have 3 % of scale and 80 mg of offset. */
static const double VIBRATES_M_S2 = 1;
/* m/s^2, of gravity: half a percent of error on Earth, which the accelerometer's sigma covers. */
static const double GRAVITY_M_S2 = 9.81;

/* ---- re-initialisation of the tilt ---- */

/* s, memory of the mean force, whose direction is that of gravity. By judgement: as short as it can be while it
 * averages over the accelerations of a hand, so that an upside-down start is corrected within a second. */
static const double MEAN_FORCE_TIME_S = 1;
/* rad, angle of the mean force to the vertical beyond which the tilt is re-initialised. By judgement: beyond 60 degrees
 * the linear filter converges slowly or, upside down, never; no motion has a mean acceleration of 1.7 g. */
static const double LOST_TILT_RAD = 60 * RAD_PER_DEG;
/* rad, 1 sigma of the heading after that. By judgement: unknown, but still linear. */
static const double LOST_HEADING_RAD = 1;
/* rad, by which a hard-iron offset may have turned the heading so that the linear correction holds. By judgement. */
static const double LINEAR_HEADING_RAD = 0.3;
/* rad, 1 sigma of a heading of which nothing is known. Derived: uniform over a full turn. */
static const double UNKNOWN_HEADING_RAD = PI / 1.7320508;

/* ---- magnetic field ---- */

/* Least horizontal part of the field, as a share of its length, that has a direction. Numerical limit. */
static const double LEAST_HORIZONTAL = 1e-3;
/* rad, turn after which the object sees another error of the field (calibration, iron in the object). Until then
 * heading measurements are correlated: for 3 s at most, since the field itself changes, and for 0.5 s at least, since
 * in fast motion the magnetometer lags. Tuned. */
static const double POSE_RAD = 1, POSE_LEAST_S = 0.5, POSE_MOST_S = 3;
/* s, memory of the reference of length and dip. VQF has 20 s. Tuned. */
static const double REFERENCE_TIME_S = 60;
/* s, memory of the candidate reference (by judgement: a tenth of the next), and how long it has to stay within the
 * limits (as in VQF). */
static const double CANDIDATE_TIME_S = 2, CANDIDATE_S = 20;
/* Greatest squared norm of the candidate's mean rotation matrix, as a share of its norm in one attitude. By judgement:
 * 0.7 is a turn to and fro about one axis by 80 degrees. */
static const double CANDIDATE_TURNED_SHARE = 0.7;
/* rad, 1 sigma of the tilt at which the dip seen counts half for the reference. By judgement: the default
 * heading_sigma. */
static const double DIP_TILT_RAD = 2 * RAD_PER_DEG;
/* s, for which the field has to be within the limits after a disturbance. By judgement half of VQF's 0.5 s: the
 * variance of the heading already grows with what is seen of the disturbance. */
static const double UNDISTURBED_S = 0.25;
/* Variance of the disturbance that turns the heading, as a share of the squared disturbance seen in length and dip.
 * Derived: a disturbance alike along all axes has two of its components in length and dip, and one in the heading. */
static const double DISTURBANCE_SHARE = 0.5;
/* s, memory of the disturbance that lasts, by judgement several periods of a swing, and the share of the field up to
 * which it is that of buildings. Tuned: with 0.04 the sigma of the heading in BROAD is twice its error. */
static const double DISTURBED_S = 10, DISTURBED_SHARE = 0.06;
/* s, in which the field at rest is averaged, and the change of it, as a share of its length, that is a moved magnet. By
 * judgement: 4 % of 50 uT are 2 uT, above the noise of a magnetometer and below what turns the heading by 6 degrees. */
static const double REST_FIELD_S = 1, REST_FIELD_SHARE = 0.04;
/* Time within the limits makes up for time of rejection by this factor. As in VQF. */
static const double RECOVERY = 2;
/* Factor of the heading's variance while a disturbed field counts after the rejection time. By judgement: four times
 * the sigma. */
static const double REJECTED_WEIGHT = 16;
/* rad, innovation of the heading beyond which it is an outlier. By judgement: no working gyro drifts by 60 degrees. */
static const double OUTLIER_RAD = 60 * RAD_PER_DEG;
/* s, age of the reference below which there are no outliers, and which is given up when the field is another one for
 * longer: after a start in motion, or beside iron, the first heading may be as wrong. Tuned on simulated starts in
 * motion, of which 2 in 30 kept a wrong heading for a minute. */
static const double OUTLIER_REFERENCE_S = 10;

/* ---- aids ---- */

/* s, for which a heading or a velocity from outside holds. By judgement: a source at 1 Hz may fail for a while. */
static const double AID_S = 10;
/* Innovation gate in sigmas. Convention: 5 sigma do not happen by noise. */
static const double GATE_SIGMAS = 5;
/* With this many rejected headings in a row the last one is applied, since this filter must be wrong. By judgement. */
enum { HEADING_REJECTIONS_MOST = 5 };
/* s, memory of where the field points to in the frame of the aided headings. By judgement: averages over attitudes. */
static const double NORTH_TIME_S = 10;

static bool within(double value, double low, double high)
{
	return value >= low && value <= high;
}

int fusion_kalman_check(const struct fusion_kalman_config *c)
{
	return within(c->velocity_sigma_m_s, 0.01, 1000) && within(c->heading_sigma_rad, 0.001, 1) &&
			       within(c->field_limit, 0.01, 1) && within(c->rejection_time_s, 0, 1e6) &&
			       within(c->gyro_error, 0, 0.1) && within(c->bias_walk_rad_s_sqrt_s, 0, 0.1) &&
			       within(c->gyro_scale_sigma, 0, 0.05) && within(c->field_sigma_uT, 0, 1000) &&
			       within(c->bias_sigma_rad_s, 0, 10) && within(c->accel_sigma_m_s2, 0, 10) &&
			       within(c->offset_sigma_uT, 0, 1000)
		       ? 0
		       : -EINVAL;
}

static void set_variance(struct fusion_kalman *k, int i, double variance)
{
	kalman_set_variance(STATES, k->covariance[0], i, variance);
}

static void clear_sums(struct fusion_kalman *k)
{
	k->sums = (struct fusion_kalman_sums){.time_s = 0};
}

static void reset_velocity(struct fusion_kalman *k)
{
	for (int i = 0; i < 2; i++) {
		k->velocity_n_m_s[i] = 0;
		set_variance(k, VELOCITY + i, squared(START_VELOCITY_M_S));
	}
}

void fusion_kalman_reset_scale(struct fusion_kalman *k, const struct fusion_kalman_config *config)
{
	for (int i = SCALE; i < SCALE + 3; i++)
		set_variance(k, i, squared(config->gyro_scale_sigma));
}

void fusion_kalman_reset_gyro_errors(struct fusion_kalman *k, const struct fusion_kalman_config *config)
{
	for (int i = BIAS; i < BIAS + 3; i++)
		set_variance(k, i, squared(config->bias_sigma_rad_s));
	k->bias_known = false;
	fusion_kalman_reset_scale(k, config);
}

void fusion_kalman_bias_drifts(struct fusion_kalman *k, double variance_rad2_s2)
{
	for (int i = BIAS; i < BIAS + 3 && k->covariance[i][i] > 0; i++) /* 0: not started */
		k->covariance[i][i] += variance_rad2_s2;
}

void fusion_kalman_reset_accelerometer(struct fusion_kalman *k, const struct fusion_kalman_config *config)
{
	k->accel_variance = squared(config->accel_sigma_m_s2);
	for (int i = ACCEL; i < ACCEL + 3; i++)
		set_variance(k, i, k->accel_variance);
}

/* The offset, and what it has done to the heading: with other axes, or after nonsense, none of it means anything. */
static void forget_offset(struct fusion_kalman *k)
{
	k->hard_iron = (struct hard_iron){.prior_uT = k->hard_iron.prior_uT};
	k->heading_by_offset_rad_uT = k->field_by_offset_1_uT = (struct vec3){0, 0, 0};
}

void fusion_kalman_turn_object(struct fusion_kalman *k, const struct fusion_kalman_config *config, struct quat turn,
	struct gyro_errors *gyro_errors)
{
	double(*c)[STATES] = k->covariance;
	double variance = fmax(c[BIAS][BIAS], fmax(c[BIAS + 1][BIAS + 1], c[BIAS + 2][BIAS + 2]));

	for (int i = BIAS; i < BIAS + 3; i++)
		set_variance(k, i, variance);
	fusion_kalman_reset_scale(k, config);
	gyro_errors->bias_b_rad_s = quat_rotate(turn, gyro_errors->bias_b_rad_s);
	gyro_errors->scale_b = (struct vec3){0, 0, 0};
	k->lever_arm_b_m = quat_rotate(turn, k->lever_arm_b_m);
	forget_offset(k);
	clear_sums(k);
}

/* Turns about the vertical leave errors of the heading behind that add up in one direction. A measured heading leaves
 * this share of them. */
static void keep_turns(struct fusion_kalman *k, double share)
{
	k->net_turn_rad *= share;
	k->net_turn_max_rad *= share;
}

/* The more the length of the force differs from gravity, the worse is the tilt it shows. Gravity on Earth is 9.8 m/s^2
 * within half a percent, which is close enough here. */
void fusion_kalman_start(struct fusion_kalman *k, const struct fusion_kalman_config *config, double force_m_s2)
{
	double tilt = fmin(START_TILT_RAD + fabs(force_m_s2 / 9.8 - 1), 1);

	for (int i = 0; i < HEADING; i++)
		set_variance(k, i, squared(tilt));
	set_variance(k, HEADING,
		fmax(squared(config->heading_sigma_rad),
			fmin(squared(UNKNOWN_HEADING_RAD), k->covariance[HEADING][HEADING])));
	keep_turns(k, 0);
	reset_velocity(k);
	if (k->covariance[BIAS][BIAS] == 0)
		fusion_kalman_reset_gyro_errors(k, config);
	fusion_kalman_reset_accelerometer(k, config);
	k->mean_force_s = k->since_start_s = k->since_tilt_s = 0;
	k->has_moved = false;
	k->began_steady = true;
	k->doubted_rate_b_rad_s = (struct vec3){INFINITY, 0, 0};
	k->spread_m2_s2 = squared(LEAST_SPREAD * config->velocity_sigma_m_s);
	k->mean_force_n_m_s2 = (struct vec3){0, 0, force_m_s2};
	k->lever_known = false;
	clear_sums(k);
}

/* Of a heading by a field with this horizontal part: it turns with the tilt about the field's own direction. */
static double field_heading_variance(
	const struct fusion_kalman *k, const struct fusion_kalman_config *config, double x, double y)
{
	const double(*c)[STATES] = k->covariance;
	double tilt = (x * x * c[0][0] + 2 * x * y * c[0][1] + y * y * c[1][1]) / (x * x + y * y);

	return squared(config->heading_sigma_rad) + squared(HEADING_BY_TILT) * tilt;
}

/* Moves towards what an offset in the object frame does to a heading set by a field with this horizontal part. */
static void follow_by_offset(struct fusion_kalman *k, struct quat q_nb, struct vec3 field_n_uT, double share)
{
	double x = field_n_uT.x, y = field_n_uT.y, horizontal2 = x * x + y * y;
	struct vec3 across = quat_rotate_inverse(q_nb, (struct vec3){-y / horizontal2, x / horizontal2, 0});
	struct vec3 along = quat_rotate_inverse(q_nb, (struct vec3){x / horizontal2, y / horizontal2, 0});
	struct vec3 *turn = &k->heading_by_offset_rad_uT, *add = &k->field_by_offset_1_uT;

	*turn = vec3_add(*turn, vec3_scale(share, vec3_sub(across, *turn)));
	*add = vec3_add(*add, vec3_scale(share, vec3_sub(along, *add)));
}

double fusion_kalman_heading_variance(const struct fusion_kalman *k, const struct fusion_kalman_config *config)
{
	double variance = k->covariance[HEADING][HEADING] + squared(config->gyro_error * k->net_turn_max_rad);

	if (k->north_from_field) {
		if (k->north_on_trial || (k->hard_iron.disagrees && !k->hard_iron.agreed))
			return squared(UNKNOWN_HEADING_RAD);
		variance +=
			hard_iron_variance(&k->hard_iron, k->heading_by_offset_rad_uT) + k->heading_by_disturbance_rad2;
	}
	return fmin(squared(UNKNOWN_HEADING_RAD), variance);
}

void fusion_kalman_set_north(
	struct fusion_kalman *k, const struct fusion_kalman_config *config, struct quat q_nb, struct vec3 field_n_uT)
{
	set_variance(k, HEADING, field_heading_variance(k, config, field_n_uT.x, field_n_uT.y));
	follow_by_offset(k, q_nb, field_n_uT, 1);
	keep_turns(k, 0);
	k->norm_uT = k->rest_field_s = 0; /* the next field becomes the reference */
	k->north_from_field = true;
}

void fusion_kalman_set_attitude(struct fusion_kalman *k, const struct fusion_kalman_config *config)
{
	for (int i = 0; i <= HEADING; i++)
		set_variance(k, i, squared(SET_ANGLE_RAD));
	reset_velocity(k);
	if (k->covariance[BIAS][BIAS] == 0)
		fusion_kalman_reset_gyro_errors(k, config);
	keep_turns(k, 0);
	k->norm_uT = k->rest_field_s = 0;
	k->north_unknown = true;
	k->north_from_field = k->north_on_trial = false;
	clear_sums(k);
}

/* P = F P with the state transition F: attitude += rotation_rate scale - rotation bias, velocity += attitude x force -
 * rotation accelerometer bias. An error of the attitude turns the accelerometer's velocity and the lever arm's share of
 * it alike, so `force` is the integrated force at the reference point. An error of the heading turns the velocity, too,
 * which only a velocity from outside shows: one of zero is zero in any direction. */
static void propagate_rows(struct fusion_kalman *k, struct vec3 f)
{
	const double shown = k->aided_velocity_s > 0, cross[6] = {0, f.z, -shown * f.y, -f.z, 0, shown * f.x};
	double *p = k->covariance[0];

	kalman_add_rows(STATES, p, 0, 3, -1, k->sums.rotation_s[0], BIAS);
	kalman_add_rows(STATES, p, 0, 3, 1, k->sums.rotation_rate_rad[0], SCALE);
	kalman_add_rows(STATES, p, VELOCITY, 2, 1, cross, 0);
	kalman_add_rows(STATES, p, VELOCITY, 2, -1, k->sums.rotation_s[0], ACCEL);
}

/* Of the accelerometer's error while nothing falsifies it: as calibrated, and what a circle looks like. */
static double usual_accel_variance(const struct fusion_kalman *k)
{
	return k->accel_variance + k->circle_m2_s4;
}

/* What exceeds the accelerometer's usual error is a Gauss-Markov process. */
static void forget_force_error(struct fusion_kalman *k, double t)
{
	double kept = exp(-t / FORCE_ERROR_S), usual = usual_accel_variance(k);

	for (int i = ACCEL; i < ACCEL + 3; i++) {
		double variance = k->covariance[i][i];

		if (variance < 1.001 * usual)
			continue;
		for (int j = 0; j < STATES; j++)
			k->covariance[j][i] = k->covariance[i][j] *= kept;
		k->covariance[i][i] = squared(kept) * variance + (1 - squared(kept)) * usual;
	}
}

/* P = F P F^T + Q over the samples since the last correction. P is symmetric, so F (F P)^T = F P F^T. */
static void predict(struct fusion_kalman *k, const struct fusion_kalman_config *config)
{
	struct vec3 force = vec3_sub(k->sums.force_n_m_s, vec3_sub(k->lever_n_m_s, k->sums.lever_from_n_m_s));
	double t = k->sums.time_s;
	double turn_noise = squared(config->gyro_error) * GYRO_ERROR_TIME_S * k->sums.turned_rad2_s +
			    squared(k->sums.unmeasured_turn_rad);

	propagate_rows(k, force);
	kalman_transpose(STATES, k->covariance[0]);
	propagate_rows(k, force);
	kalman_symmetrize(STATES, k->covariance[0]);
	if (!k->doubted)
		forget_force_error(k, t);
	k->doubted = false;
	for (int i = VELOCITY; i < VELOCITY + 2; i++)
		k->covariance[i][i] += k->sums.force_noise_m2_s2;
	for (int i = 0; i < 3; i++) {
		k->covariance[i][i] += turn_noise + t * squared(i == HEADING ? HEADING_NOISE : TILT_NOISE);
		k->covariance[BIAS + i][BIAS + i] += t * squared(config->bias_walk_rad_s_sqrt_s);
	}
	for (int i = SCALE; i < SCALE + 3; i++)
		k->covariance[i][i] +=
			fmin(1, t / SCALE_TIME_S) * fmax(0, squared(config->gyro_scale_sigma) - k->covariance[i][i]);
}

/* A measurement of state i; `error` collects the estimates of all states. The last states are considered, not
 * estimated: the accelerometer's bias, and by a heading the gyro's scale, too (see the header). */
static void measure(struct fusion_kalman *k, const struct fusion_kalman_config *config, double *error, int i,
	double measured, double variance)
{
	const int estimated = i == HEADING || config->gyro_scale_sigma > SCALE_ESTIMATED ? SCALE : ACCEL;
	double ph[STATES], innovation = measured - error[i], innovation_variance = k->covariance[i][i] + variance;

	memcpy(ph, k->covariance[i], sizeof(ph));
	kalman_update(STATES, estimated, k->covariance[0], error, ph, innovation, innovation_variance);
}

/* As if it had been found by a force of this error. */
static void widen_attitude(struct fusion_kalman *k, double force2_m2_s4)
{
	double variance = fmin(1, force2_m2_s4 / squared(GRAVITY_M_S2));

	for (int i = 0; i < HEADING; i++)
		k->covariance[i][i] = fmax(k->covariance[i][i], variance);
	if (k->north_from_field)
		k->covariance[HEADING][HEADING] =
			fmax(k->covariance[HEADING][HEADING], squared(HEADING_BY_TILT) * variance);
}

/* The error of the force is at least this, each axis. It stays as it is while that holds, and what exceeds the error as
 * calibrated ends with FORCE_ERROR_S. A young attitude rests on that force. */
static void doubt_force(struct fusion_kalman *k, double variance)
{
	for (int i = ACCEL; i < ACCEL + 3; i++)
		k->covariance[i][i] = fmax(k->covariance[i][i], variance);
	k->doubted |= variance > usual_accel_variance(k);
	if (k->since_tilt_s < YOUNG_S)
		widen_attitude(k, variance);
}

/* Nothing moves so for long: a constant force without a turn. */
static bool is_steady(const struct fusion_kalman *k)
{
	return k->sums.steady_s > STEADY_S && k->sums.turned_rad2_s < squared(STEADY_TURN_RAD_S) * k->sums.time_s;
}

/* The mean force differs from gravity by more than attitude and accelerometer can be wrong by: at rest by itself, in
 * motion when its velocity is beyond all that was expected. So it is wrong by as much. */
static void doubt_mean_force(
	struct fusion_kalman *k, const struct fusion_kalman_config *config, double velocity2, bool rest)
{
	double(*c)[STATES] = k->covariance;
	double off2 = squared(k->mean_force_n_m_s2.x) + squared(k->mean_force_n_m_s2.y);
	double variance = squared(GRAVITY_M_S2) * (c[0][0] + c[1][1]) + c[ACCEL][ACCEL] + c[ACCEL + 1][ACCEL + 1] +
			  squared(STEADY_FORCE_M_S2);

	k->velocity2_m2_s2 += k->sums.time_s / (SPREAD_TIME_S + k->sums.time_s) * (velocity2 - k->velocity2_m2_s2);
	if (rest || is_steady(k) ? off2 < squared(CONTRADICTS) * variance
				 : k->velocity2_m2_s2 < 2 * squared(FAST * config->velocity_sigma_m_s))
		return;
	doubt_force(k, off2);
}

/* A steady turn may be a circle: its centripetal acceleration, rate times velocity, stays the same in the object as an
 * error of the accelerometer does. */
static void expect_circle(struct fusion_kalman *k)
{
	double t = k->sums.time_s, share = t / (CIRCLE_S + t), rate = k->sums.turned_up_rad / t, steady2;

	k->yaw_rate_rad_s += share * (rate - k->yaw_rate_rad_s);
	k->yaw_rate2_rad2_s2 += share * (squared(rate) - k->yaw_rate2_rad2_s2);
	steady2 = fmax(0, 2 * squared(k->yaw_rate_rad_s) - k->yaw_rate2_rad2_s2); /* less what it varies by */
	k->circle_m2_s4 = k->spread_m2_s2 * steady2;
}

/* m^2/s^2, of the lever arm's velocity by the gyro's noise and bias, each axis. */
static double lever_variance(const struct fusion_kalman *k)
{
	double bias = k->covariance[BIAS][BIAS] + k->covariance[BIAS + 1][BIAS + 1] + k->covariance[BIAS + 2][BIAS + 2];

	return vec3_dot(k->lever_arm_b_m, k->lever_arm_b_m) * (squared(REST_GYRO_NOISE) / k->sums.time_s + bias / 3);
}

/* m^2/s^2, of one horizontal axis: as configured. After missing samples, while their force alone has found the tilt, it
 * is that of before them, too. */
static double most_velocity2(const struct fusion_kalman *k, const struct fusion_kalman_config *config)
{
	double configured = squared(config->velocity_sigma_m_s);

	return k->since_tilt_s < YOUNG_S ? fmax(configured, k->velocity2_m2_s2) : configured;
}

static void measure_velocity(struct fusion_kalman *k, const struct fusion_kalman_config *config,
	struct vec3 lever_n_m_s, bool rest, double *error)
{
	double x = k->velocity_n_m_s[0] - lever_n_m_s.x - k->aided_velocity_n_m_s[0];
	double y = k->velocity_n_m_s[1] - lever_n_m_s.y - k->aided_velocity_n_m_s[1];
	double most = most_velocity2(k, config), share = fmin(1, k->sums.time_s / SPREAD_TIME_S), variance;

	k->spread_m2_s2 += share * ((x * x + y * y) / 2 - k->spread_m2_s2);
	k->spread_m2_s2 = fmax(k->spread_m2_s2, squared(LEAST_SPREAD * config->velocity_sigma_m_s));
	k->spread_m2_s2 = fmin(most, k->spread_m2_s2);
	variance = rest ? squared(REST_VELOCITY_M_S)
			: 2 * VELOCITY_TIME_S / k->sums.time_s * k->spread_m2_s2 + lever_variance(k);
	doubt_mean_force(k, config, x * x + y * y, rest);
	measure(k, config, error, VELOCITY, -x, variance);
	measure(k, config, error, VELOCITY + 1, -y, variance);
}

/* A steady signal is rest only if the object does not turn: a rate is bias as far as the bias's own sigma allows. */
static bool is_resting(struct fusion_kalman *k, bool steady, struct vec3 bias_b_rad_s)
{
	struct vec3 rate = vec3_sub(vec3_scale(1 / k->sums.time_s, k->sums.gyro_b_rad), bias_b_rad_s);
	double share = k->sums.time_s / (MEAN_RATE_S + k->sums.time_s),
	       variance = 3 * squared(REST_GYRO_NOISE) / MEAN_RATE_S;

	k->mean_rate_b_rad_s = vec3_add(k->mean_rate_b_rad_s, vec3_scale(share, vec3_sub(rate, k->mean_rate_b_rad_s)));
	for (int i = BIAS; i < BIAS + 3; i++)
		variance += k->covariance[i][i];
	return steady && !k->turning &&
	       vec3_dot(k->mean_rate_b_rad_s, k->mean_rate_b_rad_s) < squared(TURNING_SIGMAS) * variance;
}

static bool blocks_agree(const struct fusion_kalman *k, struct vec3 mean_b_rad_s, double variance)
{
	struct vec3 apart = vec3_sub(mean_b_rad_s, k->last_block_b_rad_s);

	return k->last_block_known && vec3_dot(apart, apart) < squared(BLOCK_SIGMAS) * 3 * variance;
}

/* Of a mean rate over this time. */
static bool is_noise(struct vec3 rate_b_rad_s, double time_s)
{
	return vec3_dot(rate_b_rad_s, rate_b_rad_s) < squared(TURNING_SIGMAS) * 3 * squared(REST_GYRO_NOISE) / time_s;
}

/* Of the difference of two. */
static bool same_rate(struct vec3 apart_b_rad_s)
{
	return is_noise(apart_b_rad_s, MEAN_RATE_S / 2);
}

/* What has been steady since the start may lie still, and its whole rate be bias, however large: until that is known,
 * the bias is uncertain by as much. A rate that changes is a motion. */
static void doubt_bias(struct fusion_kalman *k, struct vec3 bias_b_rad_s)
{
	struct vec3 rate = vec3_scale(1 / k->sums.time_s, k->sums.gyro_b_rad), off, changed;

	if (k->since_start_s == 0)
		k->last_rate_b_rad_s = rate;
	k->since_start_s += k->sums.time_s;
	k->since_tilt_s += k->sums.time_s;
	k->last_rate_b_rad_s = vec3_add(k->last_rate_b_rad_s,
		vec3_scale(k->sums.time_s / fmin(k->since_start_s, MEAN_RATE_S), vec3_sub(rate, k->last_rate_b_rad_s)));
	if (k->since_start_s < MEAN_RATE_S)
		k->first_rate_b_rad_s = k->last_rate_b_rad_s;
	changed = vec3_sub(k->last_rate_b_rad_s, k->first_rate_b_rad_s);
	k->has_moved |= k->sums.steady_s < k->since_start_s - STEADY_SINCE_START_S || !same_rate(changed) ||
			vec3_norm(rate) > MOST_BIAS_RAD_S;
	if (k->since_start_s < MEAN_RATE_S)
		k->began_steady &= !k->has_moved && is_noise(vec3_sub(rate, k->last_rate_b_rad_s), k->sums.time_s);
	if (k->bias_known || k->has_moved || k->since_start_s < MEAN_RATE_S)
		return;
	off = vec3_sub(k->first_rate_b_rad_s, bias_b_rad_s); /* not what a motion has added by now */
	const double r[3] = {off.x, off.y, off.z};
	for (int i = 0; i < 3; i++)
		k->covariance[BIAS + i][BIAS + i] = fmax(k->covariance[BIAS + i][BIAS + i], squared(r[i]));
}

/* 1 sigma of a steady rate as bias, rad/s. After another steady one, at the start, it is that or a turn more than the
 * bias: the smaller one is the more likely bias, as far as the gyro's calibration tells. */
static double turn_in_rate(
	const struct fusion_kalman *k, const struct fusion_kalman_config *config, struct vec3 rate_b_rad_s)
{
	struct vec3 first = k->first_rate_b_rad_s, turn = vec3_sub(rate_b_rad_s, first);
	double smaller = vec3_dot(first, first) - vec3_dot(rate_b_rad_s, rate_b_rad_s);

	if (k->bias_known || !k->has_moved || !k->began_steady || same_rate(turn))
		return 0;
	return vec3_norm(turn) / sqrt(1 + exp(smaller / (2 * fmax(squared(config->bias_sigma_rad_s), DBL_MIN))));
}

/* The field of an object that turns at this rate turns against it; that of one that lies does not. */
static bool field_turns(const struct fusion_kalman *k, struct vec3 field_b_uT, struct vec3 rate_b_rad_s)
{
	struct vec3 expected = vec3_scale(BLOCK_S, vec3_cross(k->last_block_field_b_uT, rate_b_rad_s));
	struct vec3 moved = vec3_sub(field_b_uT, k->last_block_field_b_uT);

	return vec3_norm(expected) > FIELD_TURNS_UT && vec3_dot(moved, expected) > vec3_dot(expected, expected) / 2;
}

static void begin_block(struct fusion_kalman *k)
{
	k->block_s = 0;
	k->block_b_rad = k->block_field_b_uT = (struct vec3){0, 0, 0};
	k->block_fields = 0;
}

/* Blocks of a second of a steady signal; each counts when the next one agrees with it. */
static void measure_bias(struct fusion_kalman *k, const struct fusion_kalman_config *config, bool steady,
	struct vec3 bias_b_rad_s, double *error)
{
	const double variance = squared(REST_GYRO_NOISE) / BLOCK_S;
	struct vec3 mean, field;
	double turn;

	if (!steady) {
		k->turning = k->last_block_known = false;
		begin_block(k);
		return;
	}
	k->block_field_b_uT = vec3_add(k->block_field_b_uT, k->sums.field_b_uT);
	k->block_fields += k->sums.fields;
	k->block_b_rad = vec3_add(k->block_b_rad, k->sums.gyro_b_rad);
	k->block_s += k->sums.time_s;
	if (k->block_s < BLOCK_S)
		return;
	mean = vec3_scale(1 / k->block_s, k->block_b_rad);
	field = vec3_scale(1.0 / (k->block_fields > 0 ? k->block_fields : 1), k->block_field_b_uT);
	if (blocks_agree(k, mean, variance)) {
		struct vec3 off = vec3_sub(k->last_block_b_rad_s, bias_b_rad_s);
		const double d[3] = {off.x, off.y, off.z};

		k->turning = field_turns(k, field, off);
		for (int i = 0; i < 3; i++)
			k->turning |=
				squared(d[i]) > squared(BIAS_SIGMAS) * (k->covariance[BIAS + i][BIAS + i] + variance);
		turn = turn_in_rate(k, config, mean);
		if (!k->turning && (turn == 0 || !same_rate(vec3_sub(mean, k->doubted_rate_b_rad_s)))) {
			for (int i = 0; i < 3; i++)
				measure(k, config, error, BIAS + i, d[i], variance + squared(turn));
			k->bias_known |= turn == 0;
			k->doubted_rate_b_rad_s = mean; /* seen again, it is no other measurement */
		}
	}
	k->last_block_b_rad_s = mean;
	k->last_block_field_b_uT = field;
	k->last_block_known = true;
	begin_block(k);
}

/* What the mean length of the force lacks to gravity is the accelerometer's error: motion can only add to it. At rest
 * an excess is, too. In motion it is that of one direction of many: the mean square of a vector is three times that of
 * a part. While vibration falsifies the force, its length shows nothing else; beyond what calibrations lack, it shows
 * vibration: an error across gravity makes it longer by its square only. */
static void observe_accelerometer(struct fusion_kalman *k, bool rest)
{
	double length = vec3_norm(k->sums.force_n_m_s) / k->sums.time_s, off, least = VIBRATES_M_S2;

	k->mean_force_s = fmin(k->mean_force_s + k->sums.time_s, MEAN_LENGTH_S);
	if (k->mean_force_s == k->sums.time_s)
		k->mean_force_m_s2 = length;
	k->mean_force_m_s2 += k->sums.time_s / k->mean_force_s * (length - k->mean_force_m_s2);
	off = (GRAVITY_M_S2 - k->mean_force_m_s2) * fmin(1, k->mean_force_s / MEAN_LENGTH_LEAST_S);
	if (k->covariance[ACCEL][ACCEL] > 1.01 * usual_accel_variance(k))
		least = UNCALIBRATED_AT_REST_M_S2;
	if (fabs(off) > least && (rest || is_steady(k))) {
		doubt_force(k, squared(off) + (off < 0 ? -2 * GRAVITY_M_S2 * off : 0));
		k->mean_force_s = fmin(k->mean_force_s, SHORT_MEMORY_S);
	} else if (least == VIBRATES_M_S2 && (rest ? fabs(off) > UNCALIBRATED_AT_REST_M_S2 : off > UNCALIBRATED_M_S2))
		k->accel_variance = fmax(k->accel_variance, (rest ? 1 : 3) * squared(off));
	for (int i = ACCEL; i < ACCEL + 3; i++)
		k->covariance[i][i] = fmax(k->covariance[i][i], usual_accel_variance(k));
}

struct field {
	double norm_uT, dip_rad, horizontal_uT, off_norm_uT, off_dip_rad;
	double rate_rad_s; /* at which the object turns */
	bool within;	   /* the limits around the reference */
};

/* An error of the tilt is one of the measured dip, so the limit of the dip grows with it. */
static bool within_limits(const struct fusion_kalman *k, double off_norm, double norm, double off_dip, double limit)
{
	double tilt = sqrt(k->covariance[0][0] + k->covariance[1][1]);

	return fabs(off_norm) < limit * norm && fabs(off_dip) < 2 * (limit + tilt);
}

/* A field beyond the limits is the candidate for a new reference. It starts again whenever the field leaves the limits
 * around it, and replaces the reference when it has stayed for long enough in attitudes that are far enough apart. */
static void update_candidate_reference(struct fusion_kalman *k, const struct field *f, double limit)
{
	double off_norm = f->norm_uT - k->candidate_norm_uT, off_dip = f->dip_rad - k->candidate_dip_rad;
	double share = fmin(1, k->sums.time_s / CANDIDATE_TIME_S), size = 0;

	if (f->within || !within_limits(k, off_norm, k->candidate_norm_uT, off_dip, limit)) {
		k->candidate_norm_uT = f->norm_uT;
		k->candidate_dip_rad = f->dip_rad;
		k->candidate_s = 0;
		memset(k->candidate_rotation_s, 0, sizeof(k->candidate_rotation_s));
		return;
	}
	k->candidate_norm_uT += share * off_norm;
	k->candidate_dip_rad += share * off_dip;
	k->candidate_s += k->sums.time_s;
	for (int i = 0; i < 9; i++) {
		k->candidate_rotation_s[i / 3][i % 3] += k->sums.rotation_s[i / 3][i % 3];
		size += squared(k->candidate_rotation_s[i / 3][i % 3]) / 3;
	}
	if (k->candidate_s < CANDIDATE_S || size > CANDIDATE_TURNED_SHARE * squared(k->candidate_s))
		return;
	k->norm_uT = k->candidate_norm_uT;
	k->dip_rad = k->candidate_dip_rad;
}

/* The heading was set by a field that was wrong: the next one sets it. */
static void lose_north(struct fusion_kalman *k)
{
	k->north_lost = k->north_from_field;
	k->north_unknown = !k->north_from_field;
	k->sums.field_n_uT = k->sums.field_b_uT = (struct vec3){0, 0, 0};
	k->sums.fields = 0;
}

/* Lets the reference follow the undisturbed field and keeps the times of rejection. A reference that was seen for less
 * time than it has been contradicted since (an object that was switched on beside iron) is as likely wrong as right:
 * the next field sets the heading, which is on trial until that one has been seen for long enough. Returns the factor
 * of the heading's variance, or 0 for a field that is rejected. */
static double update_field_reference(
	struct fusion_kalman *k, const struct fusion_kalman_config *config, const struct field *f)
{
	double known_s, share;

	update_candidate_reference(k, f, config->field_limit);
	if (!f->within) {
		k->undisturbed_s = 0;
		k->rejected_s = fmin(k->rejected_s + k->sums.time_s, config->rejection_time_s);
		if (k->north_from_field && k->reference_s < OUTLIER_REFERENCE_S &&
			k->rejected_s > OUTLIER_REFERENCE_S) {
			lose_north(k);
			k->north_on_trial = true;
		}
		return k->rejected_s < config->rejection_time_s ? 0 : REJECTED_WEIGHT;
	}
	known_s = k->sums.time_s * squared(DIP_TILT_RAD) /
		  (squared(DIP_TILT_RAD) + k->covariance[0][0] + k->covariance[1][1]);
	k->reference_s = fmin(k->reference_s + known_s, REFERENCE_TIME_S);
	share = fmin(1, known_s / k->reference_s);
	k->north_on_trial &= k->reference_s < OUTLIER_REFERENCE_S;
	k->norm_uT += share * f->off_norm_uT;
	k->dip_rad += share * f->off_dip_rad;
	k->undisturbed_s += k->sums.time_s;
	k->rejected_s = fmax(0, k->rejected_s - RECOVERY * k->sums.time_s);
	return k->undisturbed_s < UNDISTURBED_S ? 0 : 1;
}

/* An object at rest sees the same field as long as nobody moves a magnet. Such a field may be within the limits, and
 * still is not to turn the heading. */
static bool field_changed_at_rest(struct fusion_kalman *k, struct vec3 field_n_uT, bool rest)
{
	if (!rest) {
		k->rest_field_s = 0;
		return false;
	}
	if (k->rest_field_s < REST_FIELD_S) {
		k->rest_field_s += k->sums.time_s;
		k->rest_field_n_uT = vec3_add(k->rest_field_n_uT, vec3_scale(fmin(1, k->sums.time_s / k->rest_field_s),
									  vec3_sub(field_n_uT, k->rest_field_n_uT)));
	}
	return vec3_norm(vec3_sub(field_n_uT, k->rest_field_n_uT)) > REST_FIELD_SHARE * k->norm_uT;
}

/* The turn about the vertical that would bring the field, now at this bearing (clockwise from y), to where it points
 * to. As long as a heading from outside holds, it is that direction which is estimated. */
static double north_innovation(struct fusion_kalman *k, double bearing_rad)
{
	if (k->north_unknown)
		k->north_rad = bearing_rad;
	k->north_unknown = false;
	if (k->aided_heading_s > 0)
		k->north_rad += k->sums.time_s / (NORTH_TIME_S + k->sums.time_s) *
				remainder(bearing_rad - k->north_rad, 2 * PI);
	return remainder(bearing_rad - k->north_rad, 2 * PI);
}

/* A field within the limits whose direction is further off than the gyro can have drifted is that of a magnet which
 * happens to leave length and dip alike. If it stays so for the rejection time, the heading itself is wrong and is
 * released by the variance of the innovation. */
static bool is_heading_outlier(
	struct fusion_kalman *k, const struct fusion_kalman_config *config, double innovation_rad, double variance)
{
	double gate = fmax(squared(OUTLIER_RAD), squared(GATE_SIGMAS) * (k->covariance[HEADING][HEADING] + variance));

	if (squared(innovation_rad) < gate || k->reference_s < OUTLIER_REFERENCE_S) {
		k->outlier_s = fmax(0, k->outlier_s - RECOVERY * k->sums.time_s);
		return false;
	}
	k->outlier_s += k->sums.time_s;
	if (k->outlier_s < config->rejection_time_s)
		return true;
	set_variance(k, HEADING, squared(innovation_rad));
	k->outlier_s = 0;
	return false;
}

/* rad^2, of the heading by a disturbance that lasts, such as iron that the object picked up: it is wrong by as much in
 * each swing, and no mean of many removes it. What is far beyond the limits does not turn the heading. */
static double lasting_disturbance(
	struct fusion_kalman *k, const struct fusion_kalman_config *config, const struct field *f, double seen2_uT2)
{
	double most2_uT2 = squared(2 * config->field_limit * k->norm_uT);

	k->disturbance2_uT2 +=
		k->sums.time_s / (DISTURBED_S + k->sums.time_s) * (fmin(most2_uT2, seen2_uT2) - k->disturbance2_uT2);
	return DISTURBANCE_SHARE * fmax(0, k->disturbance2_uT2 - squared(DISTURBED_SHARE * k->norm_uT)) /
	       squared(f->horizontal_uT);
}

static bool measure_heading(
	struct fusion_kalman *k, const struct fusion_kalman_config *config, struct quat q_nb, bool rest, double *error)
{
	struct vec3 m = vec3_scale(1.0 / k->sums.fields, k->sums.field_n_uT);
	struct field f = {.norm_uT = vec3_norm(m), .horizontal_uT = hypot(m.x, m.y)};
	double factor, variance, pose_s, white, off, share, seen2_uT2, lasting;
	struct vec3 across;

	if (!(f.horizontal_uT > LEAST_HORIZONTAL * f.norm_uT) || k->hard_iron.disagrees)
		return false;
	variance = field_heading_variance(k, config, m.x, m.y);
	f.dip_rad = atan2(-m.z, f.horizontal_uT);
	if (k->norm_uT == 0) {
		k->norm_uT = f.norm_uT;
		k->dip_rad = f.dip_rad;
		k->undisturbed_s = UNDISTURBED_S;
		k->reference_s = k->rejected_s = k->outlier_s = 0;
	}
	f.off_norm_uT = f.norm_uT - k->norm_uT;
	f.off_dip_rad = f.dip_rad - k->dip_rad;
	f.within = within_limits(k, f.off_norm_uT, k->norm_uT, f.off_dip_rad, config->field_limit);
	f.rate_rad_s = sqrt(k->sums.turned_rad2_s / k->sums.time_s);
	seen2_uT2 = squared(f.off_norm_uT) + squared(k->norm_uT * f.off_dip_rad);
	variance += DISTURBANCE_SHARE * seen2_uT2 / squared(f.horizontal_uT);
	lasting = lasting_disturbance(k, config, &f, seen2_uT2);
	factor = update_field_reference(k, config, &f);
	if (field_changed_at_rest(k, m, rest) || factor == 0)
		return false;
	off = north_innovation(k, atan2(m.x, m.y));
	if (k->aided_heading_s > 0 || is_heading_outlier(k, config, off, variance))
		return false;
	across = quat_rotate_inverse(q_nb, (struct vec3){-m.y, m.x, 0});
	variance += hard_iron_variance(&k->hard_iron, across) / pow(f.horizontal_uT, 4);
	pose_s = fmin(POSE_MOST_S, fmax(POSE_LEAST_S, POSE_RAD / (f.rate_rad_s + 1e-9)));
	white = squared(config->field_sigma_uT / f.horizontal_uT) / k->sums.fields;
	variance = factor * (2 * pose_s / k->sums.time_s * variance + white);
	share = k->covariance[HEADING][HEADING] / (k->covariance[HEADING][HEADING] + variance);
	follow_by_offset(k, q_nb, m, share);
	k->heading_by_disturbance_rad2 += share * (lasting - k->heading_by_disturbance_rad2);
	keep_turns(k, 1 - share);
	measure(k, config, error, HEADING, off, variance);
	return true;
}

/* Nonsense measurements (1000 rad/s, 100 km/s^2) may leave a covariance that is not positive, or not finite. */
static bool covariance_is_valid(const struct fusion_kalman *k)
{
	for (int i = 0; i < STATES; i++)
		if (!(k->covariance[i][i] >= 0 && k->covariance[i][i] < 1e6))
			return false;
	return true;
}

/* *sum += error, limited to the length `most`. */
static void add_limited(struct vec3 *sum, const double *error, double most)
{
	double norm;

	*sum = vec3_add(*sum, (struct vec3){error[0], error[1], error[2]});
	norm = vec3_norm(*sum);
	if (norm > most)
		*sum = vec3_scale(most / norm, *sum);
}

static void apply_correction(struct fusion_kalman *k, const struct fusion_kalman_config *config, const double *error,
	struct quat *q_nb, struct gyro_errors *gyro_errors)
{
	*q_nb = quat_normalize(
		quat_multiply(quat_from_rotation_vector((struct vec3){error[0], error[1], error[2]}), *q_nb));
	k->velocity_n_m_s[0] += error[VELOCITY];
	k->velocity_n_m_s[1] += error[VELOCITY + 1];
	add_limited(&gyro_errors->bias_b_rad_s, error + BIAS, MOST_BIAS_RAD_S);
	add_limited(&gyro_errors->scale_b, error + SCALE, MOST_SCALE_SIGMAS * config->gyro_scale_sigma);
}

void fusion_kalman_set_heading(struct fusion_kalman *k, double variance_rad2)
{
	set_variance(k, HEADING, variance_rad2);
	keep_turns(k, 0);
	reset_velocity(k);
	clear_sums(k);
	k->north_unknown = true;
	k->north_from_field = k->north_on_trial = false;
	k->aided_heading_s = AID_S;
	k->heading_rejections = 0;
	k->rest_field_s = 0;
}

bool fusion_kalman_aid_heading(struct fusion_kalman *k, const struct fusion_kalman_config *config,
	double innovation_rad, double variance_rad2, struct quat *q_nb, struct gyro_errors *gyro_errors)
{
	double error[STATES] = {0}, innovation_variance = k->covariance[HEADING][HEADING] + variance_rad2;

	if (squared(innovation_rad) > squared(GATE_SIGMAS) * innovation_variance) {
		if (++k->heading_rejections < HEADING_REJECTIONS_MOST)
			return false;
		*q_nb = quat_multiply(quat_from_rotation_vector((struct vec3){0, 0, innovation_rad}), *q_nb);
		fusion_kalman_set_heading(k, variance_rad2);
		return true;
	}
	keep_turns(k, variance_rad2 / innovation_variance);
	measure(k, config, error, HEADING, innovation_rad, variance_rad2);
	apply_correction(k, config, error, q_nb, gyro_errors);
	k->aided_heading_s = AID_S;
	k->heading_rejections = 0;
	return false;
}

void fusion_kalman_aid_velocity(struct fusion_kalman *k, const struct fusion_kalman_config *config,
	struct vec3 velocity_n_m_s, struct vec3 lever_n_m_s, double variance_m2_s2, struct quat *q_nb,
	struct gyro_errors *gyro_errors)
{
	double x = velocity_n_m_s.x + lever_n_m_s.x - k->velocity_n_m_s[0];
	double y = velocity_n_m_s.y + lever_n_m_s.y - k->velocity_n_m_s[1], error[STATES] = {0};
	double variance = k->covariance[VELOCITY][VELOCITY] + k->covariance[VELOCITY + 1][VELOCITY + 1];

	/* an error of the heading turns the lever arm's share */
	variance_m2_s2 += vec3_dot(lever_n_m_s, lever_n_m_s) * k->covariance[HEADING][HEADING];

	if (k->aided_velocity_s == 0 || x * x + y * y > squared(GATE_SIGMAS) * (variance + 2 * variance_m2_s2)) {
		reset_velocity(k);
		k->velocity_n_m_s[0] = velocity_n_m_s.x + lever_n_m_s.x;
		k->velocity_n_m_s[1] = velocity_n_m_s.y + lever_n_m_s.y;
	} else {
		measure(k, config, error, VELOCITY, x, variance_m2_s2);
		measure(k, config, error, VELOCITY + 1, y, variance_m2_s2);
		apply_correction(k, config, error, q_nb, gyro_errors);
	}
	k->aided_velocity_n_m_s[0] = velocity_n_m_s.x;
	k->aided_velocity_n_m_s[1] = velocity_n_m_s.y;
	k->aided_velocity_s = AID_S;
}

/* Aids hold for AID_S. After that zero is the expected velocity again, and since the actual one is unknown, it is
 * reset. */
static void expire_aids(struct fusion_kalman *k)
{
	k->aided_heading_s = fmax(0, k->aided_heading_s - k->sums.time_s);
	if (k->aided_velocity_s == 0)
		return;
	k->aided_velocity_s = fmax(0, k->aided_velocity_s - k->sums.time_s);
	if (k->aided_velocity_s > 0)
		return;
	k->aided_velocity_n_m_s[0] = k->aided_velocity_n_m_s[1] = 0;
	reset_velocity(k);
}

/* Turns the attitude by the shortest rotation that makes the mean force vertical, when it is too far off for the linear
 * filter. Returns whether it did. */
static bool reinitialise_lost_tilt(struct fusion_kalman *k, const struct fusion_kalman_config *config,
	struct quat *q_nb, struct gyro_errors *gyro_errors)
{
	struct vec3 *mean = &k->mean_force_n_m_s2, now = vec3_scale(1 / k->sums.time_s, k->sums.force_n_m_s), axis;
	double length, angle;

	*mean = vec3_add(
		*mean, vec3_scale(k->sums.time_s / (MEAN_FORCE_TIME_S + k->sums.time_s), vec3_sub(now, *mean)));
	length = vec3_norm(*mean);
	if (mean->z >= cos(LOST_TILT_RAD) * length)
		k->lost_s = 0;
	else
		k->lost_s += k->sums.time_s;
	if (k->lost_s == 0)
		return false;
	if (k->since_tilt_s > YOUNG_S &&
		(k->lost_s < LOST_S || fabs(k->mean_force_m_s2 - GRAVITY_M_S2) > LOST_LENGTH_M_S2 ||
			fabs(length - GRAVITY_M_S2) > LOST_LENGTH_M_S2 || k->sums.force_error_m_s2 > VIBRATES_M_S2))
		return false;
	angle = acos(fmax(-1, mean->z / length));
	axis = (struct vec3){mean->y, -mean->x, 0};
	axis = vec3_norm(axis) > 1e-9 * length ? vec3_scale(1 / vec3_norm(axis), axis) : (struct vec3){1, 0, 0};
	*q_nb = quat_normalize(quat_multiply(quat_from_rotation_vector(vec3_scale(angle, axis)), *q_nb));
	*gyro_errors = (struct gyro_errors){0};
	fusion_kalman_reset_gyro_errors(k, config);
	fusion_kalman_start(k, config, length);
	set_variance(k, HEADING, squared(LOST_HEADING_RAD));
	return true;
}

static bool correct(struct fusion_kalman *k, const struct fusion_kalman_config *config, struct vec3 lever_n_m_s,
	struct quat *q_nb, struct gyro_errors *gyro_errors)
{
	double error[STATES] = {0};
	bool steady = k->sums.rest_s > 0.5 * k->sums.time_s, rest, field_used;

	if (reinitialise_lost_tilt(k, config, q_nb, gyro_errors))
		return false;
	predict(k, config);
	expire_aids(k);
	doubt_bias(k, gyro_errors->bias_b_rad_s);
	rest = is_resting(k, steady, gyro_errors->bias_b_rad_s);
	expect_circle(k);
	observe_accelerometer(k, rest);
	doubt_force(k, squared(k->sums.force_error_m_s2));
	for (int i = VELOCITY; i < VELOCITY + 2 && rest && !k->resting; i++)
		set_variance(k, i, squared(STEADY_VELOCITY_M_S));
	k->resting = rest;
	measure_velocity(k, config, rest ? (struct vec3){0, 0, 0} : lever_n_m_s, rest, error);
	measure_bias(k, config, steady, gyro_errors->bias_b_rad_s, error);
	field_used = k->sums.fields > 0 && measure_heading(k, config, *q_nb, rest, error);
	if (!covariance_is_valid(k)) {
		*gyro_errors = (struct gyro_errors){0};
		forget_offset(k);
		k->heading_by_disturbance_rad2 = 0;
		fusion_kalman_reset_gyro_errors(k, config);
		fusion_kalman_start(k, config, 0);
		return false;
	}
	apply_correction(k, config, error, q_nb, gyro_errors);
	clear_sums(k);
	return field_used;
}

static void add_rotation(struct fusion_kalman *k, struct quat q, struct vec3 rate_b_rad_s, double dt_s)
{
	struct mat3 m = mat3_from_quat(q);
	const double turned_rad[3] = {dt_s * rate_b_rad_s.x, dt_s * rate_b_rad_s.y, dt_s * rate_b_rad_s.z};

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++) {
			k->sums.rotation_s[i][j] += dt_s * m.m[i][j];
			k->sums.rotation_rate_rad[i][j] += turned_rad[j] * m.m[i][j];
		}
}

void fusion_kalman_doubt_attitude(struct fusion_kalman *k, double turn_rad)
{
	for (int i = 0; i < HEADING; i++)
		k->covariance[i][i] += squared(fmin(turn_rad, 1));
	k->covariance[HEADING][HEADING] += squared(fmin(turn_rad, UNKNOWN_HEADING_RAD));
}

/* Over missing samples the velocity has changed, up to what is usual for this motion. Only this sample is used. A tilt
 * that is as uncertain as at the start is found by the same force as there. */
static void skip_gap(struct fusion_kalman *k, const struct fusion_kalman_config *config,
	const struct fusion_kalman_sample *s, struct vec3 force_n_m_s2, double dt_s)
{
	double change = fmax(GAP_ACCEL_M_S2, hypot(force_n_m_s2.x, force_n_m_s2.y)) * dt_s;
	double most;

	fusion_kalman_doubt_attitude(k, s->unseen_turn_rad);
	if (s->unseen_turn_rad > LINEAR_HEADING_RAD)
		lose_north(k);
	if (s->unseen_turn_rad > START_TILT_RAD) {
		k->since_tilt_s = 0;
		k->spread_m2_s2 = fmax(k->spread_m2_s2, k->velocity2_m2_s2);
	}
	most = most_velocity2(k, config);
	for (int i = 0; i < 2; i++) {
		double *variance = &k->covariance[VELOCITY + i][VELOCITY + i];

		*variance += squared(change);
		if (*variance < most)
			continue;
		k->velocity_n_m_s[i] = 0;
		set_variance(k, VELOCITY + i, most);
	}
	clear_sums(k);
	k->lever_known = false;
	hard_iron_skip(&k->hard_iron);
}

/* What the heading owes to earlier fields says nothing of an offset that changes now. */
static void part_from_offset(struct fusion_kalman *k)
{
	double variance = hard_iron_variance(&k->hard_iron, k->heading_by_offset_rad_uT);

	k->heading_by_offset_rad_uT = k->field_by_offset_1_uT = (struct vec3){0, 0, 0};
	if (variance < squared(LINEAR_HEADING_RAD))
		k->covariance[HEADING][HEADING] += variance;
	else
		lose_north(k);
}

/* A better offset turns the heading back as far as the one before had turned it. */
static void improve_offset(struct fusion_kalman *k, struct vec3 change_b_uT, struct quat *q_nb)
{
	double turn = atan2(
		vec3_dot(k->heading_by_offset_rad_uT, change_b_uT), 1 - vec3_dot(k->field_by_offset_1_uT, change_b_uT));

	if (fabs(turn) > LINEAR_HEADING_RAD)
		lose_north(k);
	else if (turn != 0)
		*q_nb = quat_multiply(quat_from_rotation_vector((struct vec3){0, 0, turn}), *q_nb);
}

static void use_field(struct fusion_kalman *k, const struct fusion_kalman_config *config,
	const struct fusion_kalman_sample *s, double dt_s, struct quat *q_nb)
{
	struct hard_iron *h = &k->hard_iron;
	struct vec3 before = h->offset_b_uT;
	enum hard_iron_event event = hard_iron_step(h, s->rate_b_rad_s, s->field_b_uT, config->field_sigma_uT, dt_s);

	h->prior_uT = config->offset_sigma_uT;
	if (s->saturated)
		hard_iron_skip(h);
	if (event == HARD_IRON_FOUND) { /* the next field becomes the reference, and where it points to */
		k->norm_uT = 0;
		k->north_unknown |= !k->north_from_field;
	}
	if (event == HARD_IRON_DISAGREES && !h->agreed)
		lose_north(k);
	if (k->north_from_field && h->changes)
		part_from_offset(k);
	if (k->north_from_field)
		improve_offset(k, vec3_sub(h->offset_b_uT, before), q_nb);
	if (s->field_b_uT) {
		struct vec3 field = vec3_sub(*s->field_b_uT, h->offset_b_uT);

		k->sums.field_n_uT = vec3_add(k->sums.field_n_uT, quat_rotate(*q_nb, field));
		k->sums.field_b_uT = vec3_add(k->sums.field_b_uT, field);
		k->sums.fields++;
	}
}

/* A new lever arm adds its share to the accelerometer's velocity, so that the reference point's does not jump. */
static void change_lever_arm(struct fusion_kalman *k, const struct fusion_kalman_sample *s, struct quat q_nb)
{
	struct vec3 moved = vec3_sub(s->lever_arm_b_m, k->lever_arm_b_m);
	struct vec3 v = quat_rotate(q_nb, vec3_cross(s->rate_b_rad_s, moved));

	k->velocity_n_m_s[0] += v.x;
	k->velocity_n_m_s[1] += v.y;
	k->lever_n_m_s = vec3_add(k->lever_n_m_s, v);
	k->sums.lever_from_n_m_s = vec3_add(k->sums.lever_from_n_m_s, v);
	k->lever_arm_b_m = s->lever_arm_b_m;
}

bool fusion_kalman_step(struct fusion_kalman *k, const struct fusion_kalman_config *config,
	const struct fusion_kalman_sample *s, double dt_s, struct quat *q_nb, struct gyro_errors *gyro_errors)
{
	struct vec3 force_n = quat_rotate(*q_nb, s->force_b_m_s2);
	struct vec3 lever_n = quat_rotate(*q_nb, vec3_cross(s->rate_b_rad_s, s->lever_arm_b_m));
	double turned_up_rad;

	change_lever_arm(k, s, *q_nb);
	if (s->unseen_turn_rad > 0) {
		skip_gap(k, config, s, force_n, dt_s);
		dt_s = CORRECTION_S;
	}
	if (k->sums.time_s == 0)
		k->sums.lever_from_n_m_s = k->lever_known ? k->lever_n_m_s : lever_n;
	k->lever_n_m_s = lever_n;
	k->lever_known = true;
	add_rotation(k, *q_nb, s->rate_b_rad_s, dt_s);
	k->sums.force_n_m_s = vec3_add(k->sums.force_n_m_s, vec3_scale(dt_s, force_n));
	k->velocity_n_m_s[0] += dt_s * force_n.x;
	k->velocity_n_m_s[1] += dt_s * force_n.y;
	k->sums.gyro_b_rad = vec3_add(k->sums.gyro_b_rad, vec3_scale(dt_s, s->gyro_b_rad_s));
	k->sums.turned_rad2_s += dt_s * vec3_dot(s->rate_b_rad_s, s->rate_b_rad_s);
	turned_up_rad = dt_s * quat_rotate(*q_nb, s->rate_b_rad_s).z;
	k->sums.turned_up_rad += turned_up_rad;
	k->net_turn_rad += turned_up_rad;
	k->net_turn_max_rad = fmax(k->net_turn_max_rad, fabs(k->net_turn_rad));
	k->sums.rest_s += s->rest ? dt_s : 0;
	k->sums.steady_s = s->steady_s;
	k->sums.unmeasured_turn_rad += s->saturated ? SATURATED_SHARE * dt_s * vec3_norm(s->rate_b_rad_s) : 0;
	k->sums.force_noise_m2_s2 += squared(dt_s) * s->force_noise_m2_s4;
	k->sums.force_error_m_s2 = fmax(k->sums.force_error_m_s2, s->force_error_m_s2);
	use_field(k, config, s, dt_s, q_nb);
	k->sums.time_s += dt_s;
	if (k->sums.time_s < CORRECTION_S)
		return false;
	return correct(k, config, lever_n, q_nb, gyro_errors);
}
