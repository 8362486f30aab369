#include "model/position.h"

#include <errno.h>

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

void position_step(struct position *p, struct vec3 accel_n_m_s2, bool rest, double dt_s)
{
	struct vec3 sum = vec3_add(p->accel_n_m_s2, accel_n_m_s2), last = p->velocity_n_m_s;

	p->accel_n_m_s2 = accel_n_m_s2;
	p->moving_s = rest ? 0 : p->moving_s + dt_s;
	if (p->config.mode == POSITION_OFF) {
		position_reset(p);
		return;
	}
	if (rest || position_limited(p)) {
		p->velocity_n_m_s = (struct vec3){0, 0, 0};
		return;
	}
	p->velocity_n_m_s = vec3_add(last, vec3_scale(dt_s / 2, sum));
	p->position_n_m =
		vec3_add(p->position_n_m, vec3_scale(dt_s / 2, vec3_add(last, p->velocity_n_m_s)));
}

void position_skip(struct position *p, struct vec3 accel_n_m_s2, double dt_s)
{
	p->accel_n_m_s2 = accel_n_m_s2;
	p->moving_s += dt_s;
}
