#include "model/identify/gyro_turns.h"

#include <string.h>

#include "model/math/linalg.h"

enum { AXES = 3, MATRIX = AXES * AXES, N = MATRIX + AXES, ITERATIONS = 3 };
/* Two equations a turn: nine leave six degrees of freedom for the residual. */
enum { MIN_TURNS = 9 };
static const uint64_t GAP_US = 500000;
/* By judgement: in a longer turn the error of the bias counts more than that of the scale. */
static const uint64_t LONGEST_US = 15000000;
/* A matrix that is a few percent off turns the axis of so short a part by less than its noise. */
static const double PART_S = 0.0999;
/* What the attitude filter takes for the error that a calibration leaves (fusion.gyro_scale_sigma). */
static const double MAX_SIGMA = 0.002;

void gyro_turns_init(struct gyro_turns *t)
{
	*t = (struct gyro_turns){.first = true};
}

/* ---- turns ------------------------------------------------------------------------------------------------------- */

static int first_part(const struct gyro_turns *t, int turn)
{
	return turn == 0 ? 0 : t->turn[turn - 1].end;
}

static void end_part(struct gyro_turns *t)
{
	if (t->parts == GYRO_TURNS_PARTS) {
		t->integrating = false;
		return;
	}
	t->part[t->parts++] = (struct gyro_part){quat_to_rotation_vector(t->q), t->s};
	t->q = QUAT_IDENTITY;
	t->s = 0;
}

void gyro_turns_sample(struct gyro_turns *t, const struct imu_sample *raw)
{
	const uint64_t us = raw->t_us - t->last_us;

	if (!vec3_finite(raw->gyro_rad_s))
		return;
	if (raw->t_us < t->last_us || us > GAP_US || raw->t_us - t->start_us > LONGEST_US ||
		raw->flags & (SAMPLE_DISCONTINUITY | SAMPLE_SATURATED))
		t->integrating = false;
	if (t->integrating) {
		const struct vec3 before = vec3_sub(t->gyro_rad_s, t->bias_rad_s);
		const struct vec3 after = vec3_sub(raw->gyro_rad_s, t->bias_rad_s);
		const double s = (double)us * 1e-6;

		t->q = quat_multiply(t->q, quat_from_rotation_vector(rotation_between(before, after, s)));
		t->s += s;
		if (t->s > PART_S)
			end_part(t);
	}
	t->last_us = raw->t_us;
	t->gyro_rad_s = raw->gyro_rad_s;
}

/* ---- rests ------------------------------------------------------------------------------------------------------- */

/* Mean of the last blocks of the rest. */
static struct vec3 last_force(const struct gyro_turns *t)
{
	const unsigned n = t->blocks < GYRO_TURNS_BLOCKS ? t->blocks : GYRO_TURNS_BLOCKS;
	struct vec3 sum = {0, 0, 0};

	for (unsigned i = 0; i < n; i++)
		sum = vec3_add(sum, t->force[i]);
	return vec3_scale(1.0 / n, sum);
}

static void new_rest(struct gyro_turns *t)
{
	t->after_turn = t->integrating && t->turns < GYRO_TURNS_MAX;
	if (t->after_turn)
		t->turn[t->turns++] = (struct gyro_turn){.end = t->parts, .before_m_s2 = last_force(t)};
	t->kept = t->parts;
	t->blocks = 0;
	t->first = t->moved = false;
}

/* The next turn begins with the time since the last block: when it is reported, the one behind it is over, and motion
 * can reach into that. */
static void begin_turn(struct gyro_turns *t)
{
	const int first = first_part(t, t->turns), n = t->integrating ? t->parts - t->kept : 0;

	memmove(t->part + first, t->part + t->kept, (size_t)n * sizeof(*t->part));
	t->parts = t->kept = first + n;
	t->q = QUAT_IDENTITY;
	t->s = 0;
	t->start_us = t->last_us;
	t->integrating = true;
}

void gyro_turns_block(struct gyro_turns *t, const struct calibrate_block *block)
{
	if (t->integrating)
		end_part(t);
	if (t->moved)
		new_rest(t);
	t->force[t->blocks++ % GYRO_TURNS_BLOCKS] = block->accel_m_s2;
	if (t->after_turn && t->blocks <= GYRO_TURNS_BLOCKS)
		t->turn[t->turns - 1].after_m_s2 = last_force(t);
	if (t->first)
		t->bias_rad_s = vec3_add(
			t->bias_rad_s, vec3_scale(1.0 / t->blocks, vec3_sub(block->gyro_rad_s, t->bias_rad_s)));
	begin_turn(t);
}

void gyro_turns_moved(struct gyro_turns *t)
{
	t->moved = true;
}

/* ---- the solution ------------------------------------------------------------------------------------------------ */

static struct vec3 direction(const struct triad_calibration *c, struct vec3 raw)
{
	struct mat3 matrix;

	memcpy(matrix.m, c->matrix, sizeof(matrix.m));
	const struct vec3 v = mat3_apply(matrix, vec3_sub(raw, c->bias));
	return vec3_scale(1 / vec3_norm(v), v);
}

/* The rotation of a turn (after -> before) with the matrix and the rate x, and how it turns with each of them, in the
 * axes before. */
static struct quat rotation(const struct gyro_turns *t, int turn, const double x[N], struct vec3 by[N])
{
	static const struct vec3 UNIT[AXES] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
	const struct mat3 matrix = {{{x[0], x[1], x[2]}, {x[3], x[4], x[5]}, {x[6], x[7], x[8]}}};
	const struct vec3 rate = {x[MATRIX], x[MATRIX + 1], x[MATRIX + 2]};
	struct quat q = QUAT_IDENTITY;

	for (int i = 0; i < N; i++)
		by[i] = (struct vec3){0, 0, 0};
	for (const struct gyro_part *p = t->part + first_part(t, turn); p < t->part + t->turn[turn].end; p++) {
		const struct vec3 angle = vec3_add(mat3_apply(matrix, p->angle_rad), vec3_scale(p->s, rate));
		const struct quat half = quat_from_rotation_vector(vec3_scale(0.5, angle));
		const double share[AXES] = {p->angle_rad.x, p->angle_rad.y, p->angle_rad.z};

		q = quat_multiply(q, half);
		for (int i = 0; i < AXES; i++) {
			const struct vec3 axis = quat_rotate(q, UNIT[i]);

			for (int k = 0; k < AXES; k++)
				by[AXES * i + k] = vec3_add(by[AXES * i + k], vec3_scale(share[k], axis));
			by[MATRIX + i] = vec3_add(by[MATRIX + i], vec3_scale(p->s, axis));
		}
		q = quat_normalize(quat_multiply(q, half));
	}
	return q;
}

/* The normal equations a dx = b at x; returns the sum of the squared residuals. */
static double equations(const struct gyro_turns *t, const struct triad_calibration *accel, const double x[N],
	double a[N * N], double b[N])
{
	double squares = 0;

	for (int i = 0; i < N * N; i++)
		a[i] = 0;
	for (int i = 0; i < N; i++)
		b[i] = 0;
	for (int turn = 0; turn < t->turns; turn++) {
		struct vec3 by[N];
		const struct quat q = rotation(t, turn, x, by);
		const struct vec3 before = direction(accel, t->turn[turn].before_m_s2);
		const struct vec3 off =
			vec3_sub(direction(accel, t->turn[turn].after_m_s2), quat_rotate_inverse(q, before));

		for (int i = 0; i < N; i++)
			by[i] = quat_rotate_inverse(q, vec3_cross(before, by[i]));
		for (int i = 0; i < N; i++) {
			b[i] += vec3_dot(by[i], off);
			for (int j = 0; j < N; j++)
				a[N * i + j] += vec3_dot(by[i], by[j]);
		}
		squares += vec3_dot(off, off);
	}
	return squares;
}

struct gyro_turns_result gyro_turns_solve(const struct gyro_turns *t, const struct triad_calibration *accel)
{
	struct gyro_turns_result r = {.turns = t->turns};
	double a[N * N], b[N], x[N] = {1, 0, 0, 0, 1, 0, 0, 0, 1};

	if (t->turns < MIN_TURNS)
		return r;
	for (int n = 0; n < ITERATIONS; n++) {
		equations(t, accel, x, a, b);
		if (linalg_solve(N, a, b) < 0)
			return r;
		for (int i = 0; i < N; i++)
			x[i] += b[i];
	}
	const double variance = equations(t, accel, x, a, b) / (2 * t->turns - N);
	if (linalg_invert(N, a) < 0)
		return r;
	for (int i = 0; i < MATRIX; i++) {
		r.matrix[i / AXES][i % AXES] = x[i];
		r.sigma = fmax(r.sigma, sqrt(a[(N + 1) * i] * variance));
	}
	r.found = r.sigma < MAX_SIGMA;
	return r;
}
