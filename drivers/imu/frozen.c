#include "drivers/imu/frozen.h"

#include <math.h>
#include <string.h>

static void begin_stretch(struct frozen *f, const double *raw, size_t n)
{
	memcpy(f->low, raw, n * sizeof *raw);
	memcpy(f->high, raw, n * sizeof *raw);
	f->stretch = 0;
}

/* A stretch ends when one of the values has moved by more than one digit. */
static void update_stretch(struct frozen *f, const double *raw, size_t n)
{
	bool left = false;

	for (size_t i = 0; i < n; i++) {
		double change = fabs(raw[i] - f->last[i]);

		if (change > 0 && (f->digit[i] == 0 || change < f->digit[i]))
			f->digit[i] = change;
		f->low[i] = fmin(f->low[i], raw[i]);
		f->high[i] = fmax(f->high[i], raw[i]);
		left |= f->high[i] - f->low[i] > f->digit[i];
	}
	if (!left)
		return;
	if (f->stretches < FROZEN_LEARNT)
		f->stretches++;
	begin_stretch(f, raw, n);
}

bool frozen_watch(struct frozen *f, const double *raw, size_t n)
{
	bool known = f->noisy || (f->stretches == FROZEN_LEARNT && !f->coarse);

	if (f->same == 0) {
		memcpy(f->last, raw, n * sizeof *raw);
		begin_stretch(f, raw, n);
	}
	f->stretch++;
	if (memcmp(f->last, raw, n * sizeof *raw) != 0) {
		if (f->same > f->longest)
			f->longest = f->same;
		f->coarse |= f->stretch > FROZEN_STRETCH;
		f->same = 0;
		update_stretch(f, raw, n);
		memcpy(f->last, raw, n * sizeof *raw);
	}
	f->same++;
	return known && f->same >= FROZEN_AT_LEAST && f->same >= FROZEN_TIMES * f->longest;
}
