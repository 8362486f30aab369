/* model/glitch.h
 * A single sample far from those before and after it, which agree: a bit that was read wrongly from the chip, or a
 * knock too short for its low-pass. What is integrated must not have it, and only the next sample tells it from the
 * beginning of a motion. So a jump is held back for one sample: if the next one is where the last one was, it never
 * was; if not, it is made up for, and the integral is what it would have been. */
#ifndef MODEL_GLITCH_H
#define MODEL_GLITCH_H

#include <stdbool.h>
#include <stdint.h>

#include "model/math/vec3.h"

/** Of one sensor. Zeroed it is ready; unit: that of the values. */
struct glitch {
	uint32_t count; /* glitches so far */
	/* PRIVATE */
	struct vec3 last, before; /* the last two samples, without a jump that is held back, */
	int known;		  /* .. so many of them are there */
	struct vec3 jump;	  /* what is held back, */
	double jump_s;		  /* .. and its interval; 0: nothing is */
	double interval_s;	  /* before the last sample */
};

/** The next sample begins anew: samples are missing before it. */
void glitch_restart(struct glitch *g);
/** One sample, dt_s > 0 after the one before. least: length of the smallest jump. Returns what is to be integrated over
 * the interval. */
struct vec3 glitch_step(struct glitch *g, struct vec3 value, double least, double dt_s);

#endif
