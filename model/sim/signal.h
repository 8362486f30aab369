/* model/sim/signal.h
 * Test signals: motions of a rigid body in continuous time, for simulated sensors. Each is an analytical function, so
 * attitude, rate, angular acceleration, position, velocity and acceleration are exactly consistent at every instant.
 * They are the three of the paper (section V: roll step, boat on a large wave, robot on a manoeuvring square) and some
 * with textbook solutions.
 *
 * Amplitude and duration, which the paper does not specify, are parameters of struct signal: copy one and change
 * it. */
#ifndef MODEL_SIM_SIGNAL_H
#define MODEL_SIM_SIGNAL_H

#include "model/math/quat.h"

struct signal_truth {
	double t_s;
	struct vec3 angles_rad;	      /* roll, pitch, yaw: z-y'-x'' of q_nb (rotation.h) */
	struct vec3 angles_dot_rad_s; /* their derivatives, which are not the body rates */
	struct vec3 angles_ddot_rad_s2;
	struct quat q_nb;
	struct vec3 omega_b_rad_s;  /* what an ideal gyro measures */
	struct vec3 alpha_b_rad_s2; /* derivative of omega_b */
	struct vec3 position_n_m;   /* of the reference point */
	struct vec3 velocity_n_m_s;
	struct vec3 accel_n_m_s2;
};

struct motion;

struct signal {
	const char *name;
	const char *about;
	void (*motion)(const struct signal *signal, double t_s, struct motion *motion);
	double angle_rad; /* amplitude of the largest quick rotation; larger: faster rotation */
	double change_s; /* duration of a quick change: rise of the step, period of the wave, of a bump or of the swing;
			     the turntable turns by angle_rad in this time. Smaller: faster rotation */
	double period_s; /* duration of one cycle of the motion, which repeats for ever */
};

/** All signals; ends with a NULL name. The first one is the default of simulations. */
extern const struct signal SIGNALS[];

/** NULL when there is no signal of that name. */
const struct signal *signal_find(const char *name);

/** The motion at t_s >= 0. */
void signal_at(const struct signal *signal, double t_s, struct signal_truth *truth);

#endif
