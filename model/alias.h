/* model/alias.h
 * A vibration near a multiple of the sampling rate, which its samples show as a slow, sinusoidal acceleration.
 *
 * No sample tells it from a motion to and fro, but a motion that repeats itself without any turn is rare, and such a
 * vibration is not. So half-waves of one axis that are alike, and that no turn explains, may be an alias. What an alias
 * of angular frequency w and amplitude a adds to the integrated velocity is a sine of a / w, and a constant up to the
 * same, which depends on the phase in which it began.
 *
 * Before two or three half-waves are over an alias is a motion like any other. Pure. */
#ifndef MODEL_ALIAS_H
#define MODEL_ALIAS_H

#include <stdbool.h>

#include "model/math/vec3.h"

enum { ALIAS_AXES = 3 };

/** PRIVATE: of one axis. Half-waves: their area (change of the velocity), time and peak. */
struct alias_axis {
	double area_m_s, time_s, peak_m_s2, last_area_m_s, last_time_s, last_peak_m_s2;
	struct vec3 turned_b_rad; /* in this half-wave */
	double alike_s;		  /* for how long they have been alike, with the first one */
	int alike;		  /* one like the one before */
};

/** Zeroed it is ready. */
struct alias {
	/** m/s, of each axis: amplitude of the velocity by what may be an alias; 0: nothing may. */
	double velocity_m_s[ALIAS_AXES];
	/** m, the same of the position. */
	double position_m[ALIAS_AXES];
	/** The last step has found one on this axis, which began so long ago [s]; else 0. */
	double found_s[ALIAS_AXES];
	/** m/s and m, its amplitudes, if it ended with the last step; else 0. */
	double ended_m_s[ALIAS_AXES], ended_m[ALIAS_AXES];
	/* PRIVATE */
	struct alias_axis axes[ALIAS_AXES];
};

/** Some hundredths of a second, t_s > 0: their mean acceleration in the global frame, and by how much it turned. */
void alias_step(struct alias *a, struct vec3 accel_n_m_s2, struct vec3 turned_b_rad, double t_s);

#endif
