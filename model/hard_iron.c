#include "model/hard_iron.h"

#include <string.h>

#include "model/math/kalman.h"
#include "model/math/linalg.h"
#include "model/math/rotation.h"

/* rad, of a turn that counts. By judgement: large against the gyro's errors within seconds, small enough that a hand or
 * an arm makes it. */
static const double TURN_RAD = 0.5;
/* s, for which it may last. By judgement: within that time an unknown gyro bias (0.5 deg/s) turns by a tenth of it. */
static const double TURN_MOST_S = 5;
/* 1 sigma of a field before and after a turn, as a share of its length; of its length; and s, of the lag between
 * magnetometer and gyro. Tuned on the recorded trials of BROAD: with them the offset found is within its sigma of 0. */
static const double FIELD_SHARE = 0.04, LENGTH_SHARE = 0.1, LAG_S = 0.01;
/* Spread of the length, as a share of it, above which all of these are larger by as much. By judgement: fields that
 * differ so from place to place pretend an offset. */
static const double LENGTH_SPREAD = 0.05;
/* uT, 1 sigma of the offset before anything is known. By judgement: a chip beside its supply lines. */
static const double OFFSET_UT = 50;
/* Turns of memory: of the offset, and of the agreement. By judgement: a magnet that was attached is found within a
 * minute. */
static const double OFFSET_TURNS = 100, AGREEMENT_TURNS = 50;
/* Turns of the recent mean of what is unexplained, by how much that is larger than the mean before when the offset has
 * changed (a magnet was attached, or removed), and what is kept then of the earlier turns, with every turn. By
 * judgement: the recorded change is larger by ten. */
static const double RECENT_TURNS = 6, CHANGED = 3, KEPT = 0.7;
/* Factor of the greatest change of the field that a turn can make. By judgement: above the field's noise. */
static const double POSSIBLE = 1.2;
/* Turns before the offset, or the agreement, is judged. By judgement. */
enum { OFFSET_TURNS_LEAST = 6, AGREEMENT_TURNS_LEAST = 4, AGREEMENT_TURNS_SURE = 10 };
/* 1 sigma of what is left, as a share of the field: fields that differ from place to place pretend it. Tuned: the
 * heading of the recorded trials with an offset added is within its sigma. */
static const double PRETENDED_SHARE = 0.03;
/* Least offset as a share of the field, and in sigmas. Tuned: the recorded fields of buildings pretend up to 0.1. Below
 * the last, the magnet is gone. */
static const double OFFSET_SHARE = 0.12, OFFSET_SIGMAS = 4, OFFSET_SHARE_LEAST = 0.06;
/* Turns about an axis before it is judged. By judgement. */
static const double AXIS_TURNS_LEAST = 2;
/* Share of the field's turn (root of the sums of squares) that is unexplained: beyond the first with few turns, beyond
 * the second with more, it disagrees; below the third it agrees; below the fourth an offset explains it. Tuned:
 * recorded fields leave 0.1 to 0.4, swapped or mirrored axes 0.5 to 2. */
static const double DISAGREES_FEW = 0.9, DISAGREES = 0.6, AGREES = 0.4, EXPLAINED = 0.3;

double hard_iron_variance(const struct hard_iron *h, struct vec3 d)
{
	const double v[3] = {d.x, d.y, d.z};
	double sum = 0;

	if (h->turns < OFFSET_TURNS_LEAST)
		return squared(h->prior_uT) * vec3_dot(d, d);
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			sum += v[i] * v[j] * h->variance_uT2[i][j];
	return sum;
}

void hard_iron_skip(struct hard_iron *h)
{
	h->since_s = INFINITY;
}

static void begin_turn(struct hard_iron *h, struct vec3 field_b_uT, double rate2)
{
	h->turned = (struct quat){1, 0, 0, 0};
	h->last_b_uT = field_b_uT;
	h->last_rate2_rad2_s2 = rate2;
	h->since_s = 0;
}

static void add_row(struct hard_iron_rows *r, const double row[4], double value, double weight)
{
	for (int i = 0; i < 4; i++) {
		for (int j = 0; j < 4; j++)
			r->information[i][j] += weight * row[i] * row[j];
		r->projection[i] += weight * row[i] * value;
	}
}

static void keep(struct hard_iron_rows *r, double share)
{
	for (int i = 0; i < 4; i++) {
		for (int j = 0; j < 4; j++)
			r->information[i][j] *= share;
		r->projection[i] *= share;
	}
}

/* What the earlier turns have shown of the offset and of its agreement; and of lengths all, since those of a field with
 * another offset would pretend that turns about one axis show the offset along it. */
static void forget(struct hard_iron *h, double kept)
{
	h->length_off2 *= kept;
	for (int i = 0; i < 3; i++) {
		h->agreement.unexplained[i] *= kept;
		h->agreement.turned_field[i] *= kept;
		h->solved.unexplained[i] *= kept;
		h->solved.turned_field[i] *= kept;
	}
	keep(&h->rows, kept);
	keep(&h->sphere, 0);
}

/* Both relations of the header for one turn. */
static void add_turn(
	struct hard_iron *h, const struct mat3 *turn, struct vec3 field, struct vec3 apart, double variance)
{
	const double y[3] = {apart.x, apart.y, apart.z}, length2 = vec3_dot(field, field);
	const double sphere[4] = {2 * field.x, 2 * field.y, 2 * field.z, 1};

	keep(&h->rows, 1 - 1 / OFFSET_TURNS);
	keep(&h->sphere, 1 - 1 / OFFSET_TURNS);
	for (int i = 0; i < 3; i++) {
		const double row[4] = {(i == 0) - turn->m[i][0], (i == 1) - turn->m[i][1], (i == 2) - turn->m[i][2], 0};

		add_row(&h->rows, row, y[i], 1 / variance);
	}
	add_row(&h->sphere, sphere, length2, 1 / squared(2 * LENGTH_SHARE * squared(h->field_uT)));
}

/* The least-squares solution with its covariance; false where there is none. */
static bool solve(const struct hard_iron *h, double covariance[4][4], double x[4])
{
	memcpy(covariance, h->rows.information, sizeof(h->rows.information));
	for (int i = 0; i < 16; i++)
		covariance[i / 4][i % 4] += h->sphere.information[i / 4][i % 4];
	for (int i = 0; i < 3; i++)
		covariance[i][i] += 1 / squared(OFFSET_UT);
	if (linalg_invert(4, covariance[0]) < 0)
		return false;
	for (int i = 0; i < 4; i++) {
		x[i] = 0;
		for (int j = 0; j < 4; j++)
			x[i] += covariance[i][j] * (h->rows.projection[j] + h->sphere.projection[j]);
	}
	return true;
}

/* Counts what the turn leaves unexplained with this offset, and how much the field turned, for each axis by its share
 * of the turn: a turn about x says nothing of x. Returns the former. */
static double count(struct hard_iron_agreement *a, const double share[3], const struct mat3 *turn, struct vec3 field,
	struct vec3 apart, struct vec3 offset, double weight)
{
	struct vec3 rest = vec3_sub(apart, vec3_sub(offset, mat3_apply(*turn, offset)));
	struct vec3 from = vec3_sub(field, offset), change = vec3_sub(from, mat3_apply(*turn, from));
	double rest2 = weight * vec3_dot(rest, rest), change2 = weight * vec3_dot(change, change);

	for (int i = 0; i < 3; i++) {
		a->unexplained[i] += share[i] * (rest2 - a->unexplained[i] / AGREEMENT_TURNS);
		a->turned_field[i] += share[i] * (change2 - a->turned_field[i] / AGREEMENT_TURNS);
	}
	return rest2;
}

/* The worst of the axes about which the object has turned. */
static double unexplained_share(const struct hard_iron *h, const struct hard_iron_agreement *a)
{
	double worst = 0;

	for (int i = 0; i < 3; i++)
		if (h->axis_turns[i] >= AXIS_TURNS_LEAST)
			worst = fmax(worst, sqrt(a->unexplained[i] / a->turned_field[i]));
	return worst;
}

static enum hard_iron_event judge(struct hard_iron *h, const double x[4], double covariance[4][4])
{
	double share = unexplained_share(h, &h->agreement), share_solved = unexplained_share(h, &h->solved);
	struct vec3 b = {x[0], x[1], x[2]};
	double length = vec3_norm(b), variance;
	bool before = h->disagrees, found = h->known;
	double worse = fmax(1, h->length_off2 / squared(LENGTH_SPREAD));

	if (h->turns >= OFFSET_TURNS_LEAST && length > 0) {
		for (int i = 0; i < 3; i++)
			for (int j = 0; j < 3; j++)
				h->variance_uT2[i][j] =
					worse * covariance[i][j] + (i == j) * squared(PRETENDED_SHARE * h->field_uT);
		variance = hard_iron_variance(h, vec3_scale(1 / length, b));
		found = h->known ? length > OFFSET_SHARE_LEAST * h->field_uT
				 : share_solved < EXPLAINED && length > OFFSET_SHARE * h->field_uT &&
					   squared(length) > squared(OFFSET_SIGMAS) * variance;
	}
	if (!found) {
		for (int i = 0; i < 3; i++) /* what may be there and is not subtracted */
			for (int j = 0; j < 3; j++)
				h->variance_uT2[i][j] = h->prior_uT > 0 && h->turns >= OFFSET_TURNS_LEAST
								? h->variance_uT2[i][j] + x[i] * x[j]
								: 0;
		h->offset_b_uT = (struct vec3){0, 0, 0};
		h->known = false;
	} else {
		h->offset_b_uT = b;
		share = share_solved;
	}
	h->disagrees = before ? share > AGREES
			      : h->turns >= AGREEMENT_TURNS_LEAST &&
					share > (h->turns < AGREEMENT_TURNS_SURE ? DISAGREES_FEW : DISAGREES);
	h->agreed |= share < EXPLAINED && h->turns >= AGREEMENT_TURNS_SURE &&
		     fmin(h->axis_turns[0], fmin(h->axis_turns[1], h->axis_turns[2])) >= AXIS_TURNS_LEAST;
	if (found && !h->known) {
		h->known = true;
		return HARD_IRON_FOUND;
	}
	return h->disagrees == before ? HARD_IRON_NOTHING : before ? HARD_IRON_AGREES : HARD_IRON_DISAGREES;
}

static enum hard_iron_event end_turn(struct hard_iron *h, struct vec3 field, double rate2, double field_sigma_uT)
{
	struct quat q = h->turned;
	struct mat3 turn = mat3_from_quat(quat_conjugate(q));
	struct vec3 apart = vec3_sub(field, mat3_apply(turn, h->last_b_uT));
	const double sin2 = q.x * q.x + q.y * q.y + q.z * q.z,
		     axis_share[3] = {q.x * q.x / sin2, q.y * q.y / sin2, q.z * q.z / sin2};
	double covariance[4][4], x[4] = {0}, rest2, length = vec3_norm(vec3_sub(field, h->offset_b_uT)), variance,
				 weight;

	h->field_uT += (length - h->field_uT) / fmin(h->turns + 1, AGREEMENT_TURNS);
	variance = squared(h->field_uT) * (squared(FIELD_SHARE) + squared(LAG_S) * (rate2 + h->last_rate2_rad2_s2)) +
		   2 * squared(field_sigma_uT);
	weight = squared(FIELD_SHARE * h->field_uT) / variance / squared(h->field_uT);
	if (!solve(h, covariance, x))
		memset(x, 0, sizeof(x));
	length = vec3_norm(vec3_sub(field, (struct vec3){x[0], x[1], x[2]}));
	h->length_uT += (length - h->length_uT) / fmin(h->turns + 1, h->changes ? RECENT_TURNS : AGREEMENT_TURNS);
	h->length_off2 += (squared(length / h->length_uT - 1) - h->length_off2) / fmin(h->turns + 1, AGREEMENT_TURNS);
	for (int i = 0; i < 3; i++)
		h->axis_turns[i] = fmin(h->axis_turns[i] + axis_share[i], AGREEMENT_TURNS);
	count(&h->agreement, axis_share, &turn, field, apart, h->offset_b_uT, weight);
	rest2 = count(&h->solved, axis_share, &turn, field, apart, (struct vec3){x[0], x[1], x[2]}, weight);
	h->usual += (rest2 - h->usual) / (h->changes ? OFFSET_TURNS : fmin(h->turns + 1, AGREEMENT_TURNS));
	h->recent += (rest2 - h->recent) / RECENT_TURNS;
	h->changes = h->recent > CHANGED * h->usual;
	if (h->changes)
		forget(h, KEPT);
	add_turn(h, &turn, field, apart, variance);
	h->turns = fmin(h->turns + 1, OFFSET_TURNS);
	if (!solve(h, covariance, x)) { /* after nonsense measurements */
		*h = (struct hard_iron){.prior_uT = h->prior_uT};
		return HARD_IRON_NOTHING;
	}
	return judge(h, x, covariance);
}

/* Whether this turn can have changed the field so: |(I - R) b| is at most 2 sin(angle / 2) |b|, and |b| at most the sum
 * of what is measured and the true field. A magnet that appears meanwhile changes it by more. */
static bool is_possible(const struct hard_iron *h, struct vec3 field)
{
	double most = vec3_norm(field) + vec3_norm(h->last_b_uT), half2 = fmax(0, 1 - squared(h->turned.w));
	struct vec3 apart = vec3_sub(field, quat_rotate_inverse(h->turned, h->last_b_uT));

	return vec3_dot(apart, apart) <= squared(POSSIBLE * 2 * most) * half2;
}

enum hard_iron_event hard_iron_step(struct hard_iron *h, struct vec3 rate_b_rad_s, const struct vec3 *field_b_uT,
	double field_sigma_uT, double dt_s)
{
	double rate2 = vec3_dot(rate_b_rad_s, rate_b_rad_s);
	enum hard_iron_event event;

	h->turned = quat_multiply(h->turned, quat_from_rotation_vector(vec3_scale(dt_s, rate_b_rad_s)));
	h->since_s += dt_s;
	if (!field_b_uT)
		return HARD_IRON_NOTHING;
	if (vec3_dot(h->last_b_uT, h->last_b_uT) == 0 || !(h->since_s < TURN_MOST_S)) {
		begin_turn(h, *field_b_uT, rate2);
		return HARD_IRON_NOTHING;
	}
	if (fabs(h->turned.w) > cos(TURN_RAD / 2))
		return HARD_IRON_NOTHING;
	event = is_possible(h, *field_b_uT) ? end_turn(h, *field_b_uT, rate2, field_sigma_uT) : HARD_IRON_NOTHING;
	begin_turn(h, *field_b_uT, rate2);
	return event;
}
