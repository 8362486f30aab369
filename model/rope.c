#include "model/rope.h"

#include <string.h>

#include "model/math/kalman.h"

/* s, of a window. By judgement: a tilt of 0.5 mrad shows as 5 mm in a second difference, more than the gyro's noise
 * makes of a rope of 10 m; and a crane's acceleration takes some seconds. */
static const double WINDOW_S = 1;
/* 1 sigma of the length as told, as a share of it. By judgement: where on the load the sensor is, and what was
 * hoisted. */
static const double LENGTH_SHARE = 0.1;
/* m/s^2, 1 sigma of the acceleration of what moves steadily: the crane's structure, and rails. By judgement. */
static const double STEADY_M_S2 = 0.003;

enum { GROWING = ROPE_WINDOWS - 1, LAST = GROWING - 1 };

void rope_restart(struct rope *r, struct quat q_nb)
{
	r->full = r->steady = 0;
	r->window[GROWING] = (struct rope_window){.up_n = quat_rotate(q_nb, r->up_b)};
}

void rope_hang(struct rope *r, double length_m, struct quat q_nb)
{
	if (r->given_m != length_m) {
		r->given_m = r->length_m = length_m;
		r->length_variance_m2 = squared(LENGTH_SHARE * length_m);
	}
	r->up_b = quat_rotate_inverse(q_nb, (struct vec3){0, 0, 1});
	rope_restart(r, q_nb);
}

bool rope_swing(struct rope *r, struct quat q_nb, const struct navigation_sums *s, double dt_s)
{
	struct rope_window *growing = &r->window[GROWING];

	r->sample_s = dt_s;
	navigation_sums_append(&growing->sums, s);
	if (growing->sums.t_s < WINDOW_S)
		return false;
	memmove(&r->window[0], &r->window[1], GROWING * sizeof(r->window[0]));
	*growing = (struct rope_window){.up_n = quat_rotate(q_nb, r->up_b)};
	r->full += r->full < GROWING;
	return r->full >= 2;
}

void rope_correct(struct rope *r, struct vec3 theta_n_rad, struct vec3 accel_bias_b_m_s2)
{
	for (int i = 0; i < ROPE_WINDOWS; i++) {
		struct rope_window *w = &r->window[i];
		struct navigation_sums *s = &w->sums;

		s->f = vec3_sub(vec3_add(s->f, vec3_cross(theta_n_rad, s->f)), mat3_apply(s->s, accel_bias_b_m_s2));
		s->ff = vec3_sub(vec3_add(s->ff, vec3_cross(theta_n_rad, s->ff)), mat3_apply(s->u, accel_bias_b_m_s2));
		w->up_n = vec3_add(w->up_n, vec3_cross(theta_n_rad, w->up_n));
	}
}

static struct mat3 mat3_sum(double ka, const struct mat3 *a, double kb, const struct mat3 *b)
{
	struct mat3 sum;

	for (int i = 0; i < 9; i++)
		sum.m[i / 3][i % 3] = ka * a->m[i / 3][i % 3] + kb * b->m[i / 3][i % 3];
	return sum;
}

/* The way in the second window less that in the first one, for windows of the same length. */
struct rope_difference rope_difference(
	const struct rope *r, int which, const struct noise_config *noise, double gravity_m_s2)
{
	const struct rope_window *w = &r->window[which];
	const struct navigation_sums *a = &w[0].sums, *b = &w[1].sums;
	double ta = a->t_s, tb = b->t_s, k = tb / ta, g2 = squared(gravity_m_s2), t4 = squared(squared(tb));
	struct vec3 turned = vec3_sub(vec3_sub(w[2].up_n, w[1].up_n), vec3_scale(k, vec3_sub(w[1].up_n, w[0].up_n)));
	struct mat3 u = mat3_sum(1, &b->u, -k, &a->u);
	struct rope_difference d = {.up_n = turned,
		.force_n_m = vec3_add(vec3_scale(tb, a->f), vec3_sub(b->ff, vec3_scale(k, a->ff))),
		.turned_s2 = mat3_sum(tb, &a->s, 1, &u)};

	d.point_n_m = vec3_add(d.force_n_m, vec3_scale(r->length_m, turned));
	d.point_n_m.z -= gravity_m_s2 * tb * (ta + tb) / 2;
	/* the gyro's noise turns the rope in both windows, and the tilt from their middle until two seconds later */
	d.variance_m2 = squared(noise->gyro_density_rad_s_sqrt_hz) / 2 * 2 * tb * (squared(r->length_m) + g2 * t4) +
			squared(noise->accel_density_m_s2_sqrt_hz) / 2 * tb * tb * tb * 2 / 3 +
			squared(STEADY_M_S2) * t4;
	return d;
}

struct vec3 rope_point_velocity(const struct rope *r, struct vec3 velocity_n_m_s, double gravity_m_s2)
{
	const struct rope_window *w = &r->window[LAST];
	struct vec3 up = vec3_sub(w[1].up_n, w[0].up_n), mean;
	double t = w->sums.t_s;

	mean = vec3_add(velocity_n_m_s, vec3_sub(vec3_scale(1 / t, w->sums.ff), w->sums.f));
	mean.z += gravity_m_s2 * (t + r->sample_s) / 2; /* ff ends with the sample before the last one */
	return vec3_add(mean, vec3_scale(r->length_m / t, up));
}

void rope_measure_length(struct rope *r, const struct rope_difference *earlier, const struct rope_difference *later)
{
	struct vec3 point = vec3_sub(later->point_n_m, earlier->point_n_m), up = vec3_sub(later->up_n, earlier->up_n);
	double up2 = squared(up.x) + squared(up.y), noise = earlier->variance_m2 + later->variance_m2, gain;
	double variance = noise + r->length_variance_m2 * up2;

	if (vec3_dot(point, point) > squared(ROPE_SIGMAS) * (variance + 2 * noise))
		return;
	gain = r->length_variance_m2 / variance;
	r->length_m -= gain * (point.x * up.x + point.y * up.y);
	r->length_variance_m2 *= 1 - gain * up2;
}
