#include "model/warming.h"

#include <math.h>

/* s, of the low-pass. By judgement: short against the warming of a board, long enough that readings which alternate
 * between two steps of a kelvin stay within the play. */
static const double LOW_PASS_S = 10;
/* K, by which the low-passed temperature may differ from the followed one. By judgement: the scatter of coarse
 * readings. */
static const double PLAY_K = 0.4;
/* K, over which the changes of a bias belong together. By judgement: a board that warms by ten is then at 1.8 sigma. */
static const double DRIFT_K = 3;

double warming_step(struct warming *w, double temperature_degC, uint64_t t_us)
{
	double dt_s = t_us > w->t_us ? (double)(t_us - w->t_us) * 1e-6 : 0, off, moved;

	w->t_us = t_us;
	if (!w->known) {
		w->low_degC = w->followed_degC = temperature_degC;
		w->known = true;
		return 0;
	}
	w->low_degC += dt_s / (LOW_PASS_S + dt_s) * (temperature_degC - w->low_degC);
	off = w->low_degC - w->followed_degC;
	moved = fmax(0, fabs(off) - PLAY_K);
	w->followed_degC += copysign(moved, off);
	return moved;
}

double warming_variance(double change_K, double sigma_per_K)
{
	return sigma_per_K * sigma_per_K * DRIFT_K * change_K;
}
