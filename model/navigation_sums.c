#include "model/navigation_sums.h"

#include "model/math/kalman.h"

enum {
	N = NAVIGATION_STATES,
	THETA = NAVIGATION_THETA,
	V = NAVIGATION_V,
	P = NAVIGATION_P,
	BG = NAVIGATION_BG,
	BA = NAVIGATION_BA
};

static void add_scaled(struct mat3 *a, double k, const struct mat3 *b)
{
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			a->m[i][j] += k * b->m[i][j];
}

/* a += [f]x b */
static void add_cross(struct mat3 *a, struct vec3 f, const struct mat3 *b)
{
	for (int j = 0; j < 3; j++) {
		a->m[0][j] += f.y * b->m[2][j] - f.z * b->m[1][j];
		a->m[1][j] += f.z * b->m[0][j] - f.x * b->m[2][j];
		a->m[2][j] += f.x * b->m[1][j] - f.y * b->m[0][j];
	}
}

void navigation_sums_add(struct navigation_sums *s, const struct mat3 *r_nb, struct vec3 omega_b, struct vec3 force_n,
	struct vec3 accel_n, double dt)
{
	struct vec3 f_dt = vec3_scale(dt, force_n);

	add_scaled(&s->w, dt, &s->v);
	add_scaled(&s->u, dt, &s->s);
	s->ff = vec3_add(s->ff, vec3_scale(dt, s->f));
	add_cross(&s->v, f_dt, &s->s);
	add_scaled(&s->s, dt, r_nb);
	s->f = vec3_add(s->f, f_dt);
	s->turned_b_rad = vec3_add(s->turned_b_rad, vec3_scale(dt, omega_b));
	s->turned2_rad2_s += dt * vec3_dot(omega_b, omega_b);
	s->accel2_m2_s3 += dt * vec3_dot(accel_n, accel_n);
	s->t_s += dt;
}

/* Each line uses the values of a before the samples of b, so the order matters. */
void navigation_sums_append(struct navigation_sums *a, const struct navigation_sums *b)
{
	add_scaled(&a->w, b->t_s, &a->v);
	add_scaled(&a->w, 1, &b->w);
	add_cross(&a->w, b->ff, &a->s);
	add_scaled(&a->u, b->t_s, &a->s);
	add_scaled(&a->u, 1, &b->u);
	a->ff = vec3_add(a->ff, vec3_add(b->ff, vec3_scale(b->t_s, a->f)));
	add_scaled(&a->v, 1, &b->v);
	add_cross(&a->v, b->f, &a->s);
	add_scaled(&a->s, 1, &b->s);
	a->f = vec3_add(a->f, b->f);
	a->turned_b_rad = vec3_add(a->turned_b_rad, b->turned_b_rad);
	a->turned2_rad2_s += b->turned2_rad2_s;
	a->accel2_m2_s3 += b->accel2_m2_s3;
	a->t_s += b->t_s;
}

void navigation_sums_propagate(const struct navigation_sums *s, double p[N][N], bool still)
{
	const struct mat3 minus_f = mat3_minus_cross(s->f), minus_ff = mat3_minus_cross(s->ff);

	if (!still) {
		for (int i = 0; i < 3; i++)
			for (int j = 0; j < N; j++)
				p[P + i][j] += s->t_s * p[V + i][j];
		kalman_add_rows(N, p[0], P, 3, 1, minus_ff.m[0], THETA);
		kalman_add_rows(N, p[0], P, 3, -1, s->u.m[0], BA);
	}
	kalman_add_rows(N, p[0], V, 3, 1, minus_f.m[0], THETA);
	kalman_add_rows(N, p[0], V, 3, -1, s->s.m[0], BA);
	if (s->held)
		return;
	if (!still)
		kalman_add_rows(N, p[0], P, 3, 1, s->w.m[0], BG);
	kalman_add_rows(N, p[0], V, 3, 1, s->v.m[0], BG);
	kalman_add_rows(N, p[0], THETA, 3, -1, s->s.m[0], BG);
}
