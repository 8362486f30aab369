#include "model/guide.h"

#include "model/math/kalman.h"

/* s, in which the attitude decays to that of the guide. By judgement: longer than what a frame nods by when it is
 * accelerated, shorter than a movement. */
static const double HOLD_S = 1;
/* rad, 1 sigma of the guide's direction along the way (0.02 degrees), whose correlation time is HOLD_S. By judgement:
 * rails are aligned to half a millimetre in a metre. */
static const double UNEVEN_RAD = 0.00035;
/* Sigmas of the net turn beyond which it turns, and rad, a turn that is none: flexing. By judgement. */
static const double TURN_SIGMAS = 3, FLEXING_RAD = 0.002;

/* m/s, s: 1 sigma of the horizontal velocity of a car in vertical guides, and its correlation time: play and swaying
 * of a few millimetres at some hertz. By judgement. */
static const double SWAY_M_S = 0.01, SWAY_S = 0.1;
/* rad, 1 sigma of a vertical guide's direction. By judgement: a millimetre in a metre. */
static const double PLUMB_RAD = 0.001;
/* m/s^2, 1 sigma of local gravity against the configured one. By judgement: 9.78 to 9.83 on Earth. */
static const double GRAVITY_SIGMA_M_S2 = 0.015;
/* m/s^2, least 1 sigma of the bias beside that of the scale: the default of fusion_kalman_config.accel_sigma_m_s2. */
static const double BIAS_SIGMA_M_S2 = 0.03;

/* Sigmas of the horizontal velocity beyond which it is inclined. As those of the net turn. */
static const double INCLINED_SIGMAS = 3;

void guide_engage(struct guide *g, const struct guide_start *start)
{
	*g = (struct guide){.holds = true, .inclined = g->inclined, .start = *start};
}

struct vec3 guide_hold(struct guide *g, const struct mat3 *r_nb, const struct navigation_sums *s)
{
	struct vec3 back;

	g->off_n_rad = vec3_add(g->off_n_rad, mat3_apply(*r_nb, s->turned_b_rad));
	back = vec3_scale(s->t_s / (HOLD_S + s->t_s), g->off_n_rad);
	g->off_n_rad = vec3_sub(g->off_n_rad, back);
	g->taken_n_m = vec3_add(g->taken_n_m, vec3_scale(s->t_s, g->taken_n_m_s));
	g->taken_n_m_s = vec3_add(g->taken_n_m_s, vec3_cross(g->taken_n_rad, s->f));
	g->taken_n_rad = vec3_add(g->taken_n_rad, back);
	g->t_s += s->t_s;
	return back;
}

bool guide_turns(const struct guide *g, double gyro_density_rad_s_sqrt_hz, double bias_variance_rad2_s2)
{
	struct vec3 net = vec3_add(g->off_n_rad, g->taken_n_rad);
	double variance = 3 * squared(gyro_density_rad_s_sqrt_hz) / 2 * g->t_s +
			  bias_variance_rad2_s2 * squared(g->t_s) + squared(FLEXING_RAD);

	return vec3_dot(net, net) > squared(TURN_SIGMAS) * variance;
}

double guide_walk_m2_s3(double gyro_density_rad_s_sqrt_hz, double gravity_m_s2)
{
	return squared(gravity_m_s2) *
	       (squared(gyro_density_rad_s_sqrt_hz) / 2 * squared(HOLD_S) + 2 * HOLD_S * squared(UNEVEN_RAD));
}

void guide_integrate(struct guide *g, const struct mat3 *r_nb, struct vec3 accel_bias_b_m_s2, double gravity_m_s2,
	const struct navigation_sums *s)
{
	struct vec3 less_bias = vec3_scale(s->t_s, vec3_sub(accel_bias_b_m_s2, g->start.accel_bias_b_m_s2));
	struct vec3 force = quat_rotate(g->start.q_nb, vec3_add(mat3_apply(mat3_transpose(*r_nb), s->f), less_bias));
	struct vec3 before = g->free_n_m_s;

	force.z -= gravity_m_s2 * s->t_s;
	g->free_n_m_s = vec3_add(before, force);
	g->free_n_m = vec3_add(g->free_n_m, vec3_scale(s->t_s / 2, vec3_add(before, g->free_n_m_s)));
}

double guide_free_variance_m2_s2(const struct guide *g, double walk_m2_s3)
{
	return g->start.tilt_variance_rad2 * squared(g->free_n_m_s.z) +
	       g->start.accel_variance_m2_s4 * squared(g->t_s) + walk_m2_s3 * g->t_s + guide_sway_m2_s(0) / SWAY_S;
}

bool guide_inclines(const struct guide *g, double walk_m2_s3)
{
	return squared(g->free_n_m_s.x) + squared(g->free_n_m_s.y) >
	       squared(INCLINED_SIGMAS) * 2 * guide_free_variance_m2_s2(g, walk_m2_s3);
}

double guide_sway_m2_s(double speed_m_s)
{
	return squared(SWAY_M_S) * SWAY_S + squared(UNEVEN_RAD * speed_m_s) * HOLD_S;
}

double guide_plumb_m2(double way2_m2)
{
	return squared(PLUMB_RAD) * way2_m2;
}

double guide_share_of_scale(double bias_sigma_m_s2, double scale_sigma, double gravity_m_s2)
{
	double by_scale2 = squared(scale_sigma * gravity_m_s2);

	return by_scale2 / (by_scale2 + squared(fmax(bias_sigma_m_s2, BIAS_SIGMA_M_S2)) + squared(GRAVITY_SIGMA_M_S2));
}
