#include "model/position.h"

#include <errno.h>

/* s, time constant of the mean acceleration at rest. By judgement: averages vibration, shorter than the usual rest. */
static const double RESIDUAL_TIME_S = 1;

int position_configure(struct position *p, const struct position_config *config)
{
	if (config->mode != POSITION_OFF && config->mode != POSITION_ZERO_VELOCITY_AT_REST &&
		config->mode != POSITION_NAVIGATION)
		return -EINVAL;
	if (!(config->longest_integration_s >= 0 && isfinite(config->longest_integration_s)) ||
		!(config->sigma_limit_m >= 0 && isfinite(config->sigma_limit_m)))
		return -EINVAL;
	if (navigation_check(&config->navigation) < 0)
		return -EINVAL;
	if (config->mode != POSITION_NAVIGATION) {
		p->navigation.started = false;
		p->sigma = (struct navigation_sigma){.attitude_rad = {0, 0, 0}};
		p->displacement_n_m = p->displacement_sigma_m = (struct vec3){0, 0, 0};
	}
	p->navigation.config = config->navigation;
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
	p->position_n_m = p->moved_from_n_m = (struct vec3){0, 0, 0};
	p->moving_s = 0;
	p->anchored = false;
	p->sigma.position_m = p->sigma.displacement_m = (struct vec3){0, 0, 0};
	navigation_reset_position(&p->navigation);
}

bool position_limited(const struct position *p)
{
	return p->config.mode != POSITION_OFF && p->config.longest_integration_s > 0 &&
	       p->moving_s > p->config.longest_integration_s;
}

bool position_unsure(const struct position *p)
{
	return p->navigation.started && p->config.sigma_limit_m > 0 &&
	       vec3_norm(p->sigma.position_m) > p->config.sigma_limit_m;
}

static void stand_still(struct position *p, struct vec3 accel_n_m_s2, double dt_s)
{
	struct vec3 *mean = &p->residual_n_m_s2;
	double share = dt_s / (RESIDUAL_TIME_S + dt_s);

	*mean = vec3_add(*mean, vec3_scale(share, vec3_sub(accel_n_m_s2, *mean)));
	p->velocity_n_m_s = (struct vec3){0, 0, 0};
	p->moving_s = 0;
}

/* Trapezoidal rule. */
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

static struct vec3 add_square(struct vec3 sigma, struct vec3 off)
{
	return (struct vec3){hypot(sigma.x, off.x), hypot(sigma.y, off.y), hypot(sigma.z, off.z)};
}

/* The position stays, and zero velocity is published: what the navigation says of both is part of their error. */
static void hold(struct position *p, struct vec3 position_n_m, struct vec3 velocity_n_m_s, bool new_sigma)
{
	p->velocity_n_m_s = (struct vec3){0, 0, 0};
	if (!new_sigma)
		return;
	p->sigma.position_m = add_square(p->sigma.position_m, vec3_sub(position_n_m, p->position_n_m));
	p->sigma.velocity_m_s = add_square(p->sigma.velocity_m_s, velocity_n_m_s);
}

/* Velocity and position of the reference point from the navigation's of the sensor. */
static void follow(struct position *p, const struct navigation_input *in, struct vec3 lever_b_m, bool new_sigma)
{
	const struct navigation *n = &p->navigation;
	struct vec3 omega_b_rad_s = vec3_sub(in->gyro_b_rad_s, n->gyro_bias_b_rad_s);
	struct vec3 reference_n_m = vec3_sub(n->position_n_m, quat_rotate(n->q_nb, lever_b_m));
	struct vec3 position_n_m, velocity_n_m_s = {0, 0, 0};

	if (!p->anchored) {
		p->anchor_n_m = vec3_sub(reference_n_m, p->position_n_m);
		p->anchored = true;
	}
	p->omega_b_rad_s = omega_b_rad_s;
	position_n_m = vec3_add(vec3_sub(reference_n_m, p->anchor_n_m), n->zero_velocity.position_shift_n_m);
	if (!n->still)
		velocity_n_m_s = vec3_sub(vec3_add(n->velocity_n_m_s, n->zero_velocity.velocity_shift_n_m_s),
			quat_rotate(n->q_nb, vec3_cross(omega_b_rad_s, lever_b_m)));
	if (position_limited(p)) {
		hold(p, position_n_m, velocity_n_m_s, new_sigma);
		return;
	}
	p->position_n_m = position_n_m;
	p->velocity_n_m_s = velocity_n_m_s;
}

void position_navigate(
	struct position *p, const struct navigation_input *in, struct vec3 lever_b_m, double rate_hz, double dt_s)
{
	struct navigation *n = &p->navigation;
	struct navigation_input with_lever = *in;
	unsigned movements = n->movements;
	bool first = !n->started, new_sigma;

	with_lever.lever_b_m = lever_b_m;
	if (first) {
		navigation_start(n, &p->config.navigation, in->q_nb);
		/* the reference point is assumed to be at rest; the sensor may turn about it */
		n->velocity_n_m_s = quat_rotate(in->q_nb, vec3_cross(in->gyro_b_rad_s, lever_b_m));
		p->anchored = false;
	}
	new_sigma = navigation_step(n, &with_lever, dt_s) || first;
	if (new_sigma)
		p->sigma = navigation_sigma(n, rate_hz);
	p->moving_s = navigation_stands(n) ? 0 : p->moving_s + dt_s;
	if (n->movements != movements)
		p->moved_from_n_m = vec3_sub(n->begin_n_m, p->anchor_n_m);
	follow(p, in, lever_b_m, new_sigma);
	if (n->still && !n->ended_by_reset) {
		p->displacement_n_m = vec3_sub(p->position_n_m, p->moved_from_n_m);
		p->displacement_sigma_m = p->sigma.displacement_m;
	}
	p->accel_n_m_s2 = (struct vec3){0, 0, 0};
}

void position_skip(
	struct position *p, const struct navigation_input *in, struct vec3 accel_n_m_s2, double rate_hz, double dt_s)
{
	if (p->navigation.started) {
		navigation_skip(&p->navigation, in, dt_s);
		p->sigma = navigation_sigma(&p->navigation, rate_hz);
	}
	p->accel_n_m_s2 = accel_n_m_s2;
	p->moving_s += dt_s;
}

void position_aid_velocity(struct position *p, struct vec3 velocity_n_m_s, double sigma_m_s, struct vec3 lever_b_m)
{
	p->moving_s = 0;
	if (p->config.mode == POSITION_ZERO_VELOCITY_AT_REST)
		p->velocity_n_m_s = velocity_n_m_s;
	else if (p->navigation.started)
		navigation_aid_velocity(&p->navigation, velocity_n_m_s, sigma_m_s, p->omega_b_rad_s, lever_b_m);
}

void position_biases_drift(struct position *p, double gyro_rad2_s2, double accel_m2_s4)
{
	if (p->navigation.started)
		navigation_biases_drift(&p->navigation, gyro_rad2_s2, accel_m2_s4);
}

void position_set_attitude(struct position *p, struct quat from, struct quat to)
{
	p->velocity_n_m_s = quat_rotate(to, quat_rotate_inverse(from, p->velocity_n_m_s));
	p->residual_n_m_s2 = (struct vec3){0, 0, 0};
	p->anchored = false;
	if (p->navigation.started)
		navigation_set_attitude(&p->navigation, to);
}
