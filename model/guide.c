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

void guide_engage(struct guide *g)
{
	*g = (struct guide){.holds = true};
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
