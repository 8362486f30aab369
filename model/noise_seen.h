/* model/noise_seen.h
 * The noise that the sensors show at standstills, for a chip that is noisier than told (2020h). It is that of their
 * means over half a second, as in the Allan variance: what vibrates faster is averaged out by the window (Hann), and
 * drifts are slower. Where the told noise is more, that holds.
 *
 * Source: IEEE Std 952-1997, annex C (Allan variance); F. J. Harris, "On the use of windows for harmonic analysis with
 * the discrete Fourier transform", Proc. IEEE 66(1), 1978 (noise bandwidth of the Hann window, 1.5 bins). */
#ifndef MODEL_NOISE_SEEN_H
#define MODEL_NOISE_SEEN_H

#include <stdbool.h>

#include "model/math/vec3.h"
#include "model/noise.h"

/** Zeroed it has seen nothing. */
struct noise_seen {
	/* PRIVATE */
	double elapsed_s, weight_s;	   /* of the window under way, */
	struct vec3 accel_m_s, rate_rad;   /* .. and weighted sums */
	struct vec3 last_m_s2, last_rad_s; /* means of the window before, */
	bool last_known;		   /* .. if there was one */
	double differences;		   /* that count */
	double accel2_m2_s3, rate2_rad2_s; /* squared densities, one-sided, by them */
};

/** An interval of a standstill: mean specific force and rate, object frame. Of one longer than 0.12 s nothing is
 * learnt. */
void noise_seen_step(struct noise_seen *s, const struct noise_config *told, struct vec3 force_b_m_s2,
	struct vec3 rate_b_rad_s, double t_s);
/** It does not stand. What was seen stays. */
void noise_seen_break(struct noise_seen *s);
/** The told noise, or what was seen of the densities where that is more. */
struct noise_config noise_seen(const struct noise_seen *s, const struct noise_config *told);

#endif
