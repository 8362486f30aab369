#include "model/noise_seen.h"

#include <math.h>

#include "model/math/units.h"

/* s. By judgement: the noise at 2 Hz and below is what the integration meets. */
static const double WINDOW_S = 0.5;
/* Variance of the mean over a window times its length, to half of the squared density. Derived: Hann window. */
static const double BANDWIDTH = 1.5;
/* Differences by which the told noise counts, and by which the seen one is remembered. By judgement: some seconds show
 * what noise it is, and half a minute what it has become. */
static const double TOLD_COUNTS = 2, REMEMBERED = 60;
/* Squared sigmas at which a difference is cut off: a knock is no noise. By judgement. */
static const double MOST_SIGMAS2 = 16;

/* Mean of the axes, of the seen density and the told one. */
static double together(const struct noise_seen *s, double seen2, double told)
{
	return (TOLD_COUNTS * told * told + s->differences * seen2) / (TOLD_COUNTS + s->differences);
}

static void observe(const struct noise_seen *s, double *seen2, double told, struct vec3 difference)
{
	double density2 = vec3_dot(difference, difference) / 3 * WINDOW_S / BANDWIDTH;

	density2 = fmin(density2, MOST_SIGMAS2 * together(s, *seen2, told));
	*seen2 += (density2 - *seen2) / (s->differences + 1);
}

static void end_window(struct noise_seen *s, const struct noise_config *told)
{
	struct vec3 accel = vec3_scale(1 / s->weight_s, s->accel_m_s), rate = vec3_scale(1 / s->weight_s, s->rate_rad);

	if (s->last_known) {
		observe(s, &s->accel2_m2_s3, told->accel_density_m_s2_sqrt_hz, vec3_sub(accel, s->last_m_s2));
		observe(s, &s->rate2_rad2_s, told->gyro_density_rad_s_sqrt_hz, vec3_sub(rate, s->last_rad_s));
		s->differences = fmin(s->differences + 1, REMEMBERED);
	}
	noise_seen_break(s);
	s->last_m_s2 = accel;
	s->last_rad_s = rate;
	s->last_known = true;
}

void noise_seen_step(struct noise_seen *s, const struct noise_config *told, struct vec3 force_b_m_s2,
	struct vec3 rate_b_rad_s, double t_s)
{
	double weight_s;

	if (t_s > WINDOW_S / 4) {
		noise_seen_break(s);
		return;
	}
	weight_s = t_s * (1 - cos(2 * PI * (s->elapsed_s + t_s / 2) / WINDOW_S));

	s->accel_m_s = vec3_add(s->accel_m_s, vec3_scale(weight_s, force_b_m_s2));
	s->rate_rad = vec3_add(s->rate_rad, vec3_scale(weight_s, rate_b_rad_s));
	s->weight_s += weight_s;
	s->elapsed_s += t_s;
	if (s->elapsed_s > WINDOW_S - t_s / 2)
		end_window(s, told);
}

void noise_seen_break(struct noise_seen *s)
{
	s->elapsed_s = s->weight_s = 0;
	s->accel_m_s = s->rate_rad = (struct vec3){0, 0, 0};
	s->last_known = false;
}

struct noise_config noise_seen(const struct noise_seen *s, const struct noise_config *told)
{
	struct noise_config noise = *told;
	double *accel = &noise.accel_density_m_s2_sqrt_hz, *gyro = &noise.gyro_density_rad_s_sqrt_hz;

	*accel = fmax(*accel, sqrt(together(s, s->accel2_m2_s3, *accel)));
	*gyro = fmax(*gyro, sqrt(together(s, s->rate2_rad2_s, *gyro)));
	return noise;
}
