#include "model/glitch.h"

/* Share of a jump by which the samples before it may differ from each other, and the one after it from them. By
 * judgement: in none of the recordings of BROAD and of data/field is there a glitch then, but for knocks on the
 * sensor. */
static const double SHARE = 0.15;

/* Intervals this much longer than the one before have missing samples, over which any motion jumps; after one this much
 * shorter not all of a jump is made up for. */
static const double LONGER = 1.5, SHORTER = 4;

void glitch_restart(struct glitch *g)
{
	*g = (struct glitch){.count = g->count};
}

static void push(struct glitch *g, struct vec3 value)
{
	g->before = g->last;
	g->last = value;
	g->known += g->known < 2;
}

static bool near(struct vec3 a, struct vec3 b, struct vec3 jump)
{
	return vec3_norm(vec3_sub(a, b)) < SHARE * vec3_norm(jump);
}

struct vec3 glitch_step(struct glitch *g, struct vec3 value, double least, double dt_s)
{
	struct vec3 jump = vec3_sub(value, g->last), made_up;
	bool missing = dt_s > LONGER * g->interval_s;

	g->interval_s = dt_s;
	if (g->jump_s > 0) {
		bool glitch = near(value, g->last, g->jump);

		made_up = glitch ? value : vec3_add(value, vec3_scale(fmin(g->jump_s / dt_s, SHORTER), g->jump));
		if (!glitch)
			push(g, vec3_add(g->last, g->jump));
		push(g, value);
		g->count += glitch;
		g->jump_s = 0;
		return made_up;
	}
	if (g->known == 2 && !missing && vec3_norm(jump) > least && near(g->last, g->before, jump)) {
		g->jump = jump;
		g->jump_s = dt_s;
		return g->last;
	}
	push(g, value);
	return value;
}
