#include "model/position.h"

#include <errno.h>

/* Time constant of the mean acceleration at rest. */
static const double RESIDUAL_TIME_S = 1;

int position_configure(struct position *p, const struct position_config *config)
{
	if (config->mode != POSITION_OFF && config->mode != POSITION_ZERO_VELOCITY_AT_REST)
		return -EINVAL;
	if (!(config->longest_integration_s >= 0 && isfinite(config->longest_integration_s)))
		return -EINVAL;
	p->config = *config;
	return 0;
}

int position_init(struct position *p, const struct position_config *config)
{
	struct position fresh = {.moving_s = 0};

	if (position_configure(&fresh, config) < 0)
		return -EINVAL;
	*p = fresh;
	return 0;
}

void position_reset(struct position *p)
{
	p->velocity_n_m_s = (struct vec3){0, 0, 0};
	p->position_n_m = (struct vec3){0, 0, 0};
	p->moving_s = 0;
}

bool position_limited(const struct position *p)
{
	return p->config.mode != POSITION_OFF && p->config.longest_integration_s > 0 &&
	       p->moving_s > p->config.longest_integration_s;
}

static void stand_still(struct position *p, struct vec3 accel_n_m_s2, double dt_s)
{
	struct vec3 *mean = &p->residual_n_m_s2;
	double share = dt_s / (RESIDUAL_TIME_S + dt_s);

	*mean = vec3_add(*mean, vec3_scale(share, vec3_sub(accel_n_m_s2, *mean)));
	p->velocity_n_m_s = (struct vec3){0, 0, 0};
	p->moving_s = 0;
}

/* By the trapezoidal rule. */
static void integrate(struct position *p, struct vec3 accel_n_m_s2, double dt_s)
{
	struct vec3 last = p->velocity_n_m_s;
	struct vec3 mean = vec3_scale(0.5, vec3_add(p->accel_n_m_s2, accel_n_m_s2));

	p->velocity_n_m_s = vec3_add(last, vec3_scale(dt_s, vec3_sub(mean, p->residual_n_m_s2)));
	p->position_n_m = vec3_add(p->position_n_m, vec3_scale(dt_s / 2, vec3_add(last, p->velocity_n_m_s)));
}

void position_step(struct position *p, struct vec3 accel_n_m_s2, bool rest, double dt_s)
{
	p->moving_s += dt_s;
	if (rest)
		stand_still(p, accel_n_m_s2, dt_s);
	else if (p->config.mode != POSITION_OFF && !position_limited(p))
		integrate(p, accel_n_m_s2, dt_s);
	else
		p->velocity_n_m_s = (struct vec3){0, 0, 0};
	if (p->config.mode == POSITION_OFF)
		p->position_n_m = (struct vec3){0, 0, 0};
	p->accel_n_m_s2 = accel_n_m_s2;
}

void position_skip(struct position *p, struct vec3 accel_n_m_s2, double dt_s)
{
	p->accel_n_m_s2 = accel_n_m_s2;
	p->moving_s += dt_s;
}
