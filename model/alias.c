#include "model/alias.h"

#include <math.h>

#include "model/math/units.h"

/* m/s^2, and share of the last peak: less than that does not end a half-wave. By judgement: above the tilt's error. */
static const double LEAST_M_S2 = 0.04, LEAST_SHARE = 0.2;
/* By which area and time of half-waves that are alike may differ, and the area of one as a share of peak times time
 * (2 / pi of a sine). By judgement: a tilt, samples that miss the peak, and noise. */
static const double ALIKE = 1.3, LEAST_FULL = 0.5, MOST_FULL = 0.8;
/* s, of half-waves that are looked at, and of those above which two that are alike suffice; otherwise so many have to
 * be. By judgement: a random vibration has two of them often, four hardly ever. */
static const double LEAST_S = 0.1, SLOW_S = 0.4;
enum { ALIKE_SLOW = 2, ALIKE_FAST = 4 };
/* Of the last half-wave's time: what lasts longer is no longer alike. By judgement. */
static const double OVER = 1.5;
/* What hangs turns by its acceleration / gravity, a hand and an arm by more. By judgement: a fifth of that explains
 * nothing. */
static const double EXPLAINED_SHARE = 0.2;

static bool near(double a, double b)
{
	return a < ALIKE * b && b < ALIKE * a;
}

static bool is_alike(const struct alias_axis *x)
{
	double full = fabs(x->area_m_s) / (x->peak_m_s2 * x->time_s);

	return x->time_s > LEAST_S && full > LEAST_FULL && full < MOST_FULL && near(x->time_s, x->last_time_s) &&
	       near(fabs(x->area_m_s), fabs(x->last_area_m_s));
}

/* It turns as far as what hangs, or more. */
static bool is_explained(const struct alias_axis *x)
{
	return vec3_norm(x->turned_b_rad) * STANDARD_GRAVITY_M_S2 >
	       EXPLAINED_SHARE * fmax(x->peak_m_s2, x->last_peak_m_s2);
}

static void end_half_wave(struct alias_axis *x)
{
	bool alike = is_alike(x);

	x->alike = alike ? x->alike + 1 : 0;
	x->alike_s = x->time_s + (alike ? x->alike_s : 0);
	x->last_area_m_s = x->area_m_s;
	x->last_time_s = x->time_s;
	x->last_peak_m_s2 = x->peak_m_s2;
	x->area_m_s = x->time_s = x->peak_m_s2 = 0;
	x->turned_b_rad = (struct vec3){0, 0, 0};
}

static bool may_be_alias(struct alias_axis *x, double accel, struct vec3 turned_b_rad, double t_s)
{
	if (accel * x->area_m_s < 0 && fabs(accel) > fmax(LEAST_M_S2, LEAST_SHARE * x->peak_m_s2))
		end_half_wave(x);
	x->area_m_s += t_s * accel;
	x->time_s += t_s;
	x->peak_m_s2 = fmax(x->peak_m_s2, fabs(accel));
	x->turned_b_rad = vec3_add(x->turned_b_rad, turned_b_rad);
	if (is_explained(x) || x->time_s > OVER * x->last_time_s)
		x->alike = 0;
	return x->alike >= (x->last_time_s > SLOW_S ? ALIKE_SLOW : ALIKE_FAST);
}

void alias_step(struct alias *a, struct vec3 accel_n_m_s2, struct vec3 turned_b_rad, double t_s)
{
	const double accel[ALIAS_AXES] = {accel_n_m_s2.x, accel_n_m_s2.y, accel_n_m_s2.z};

	for (int i = 0; i < ALIAS_AXES; i++) {
		struct alias_axis *x = &a->axes[i];
		bool before = a->velocity_m_s[i] > 0, now = may_be_alias(x, accel[i], turned_b_rad, t_s);

		a->ended_m_s[i] = now ? 0 : a->velocity_m_s[i];
		a->ended_m[i] = now ? 0 : a->position_m[i];
		a->velocity_m_s[i] = now ? fabs(x->last_area_m_s) / 2 : 0;
		a->position_m[i] = a->velocity_m_s[i] * x->last_time_s / PI;
		a->found_s[i] = now && !before ? x->alike_s : 0;
	}
}
