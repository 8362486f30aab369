/* model/seed.h
 * The accelerometer model of the seed paper (Kowalczuk and Merta, "Modelling an Accelerometer for Robot Position
 * Estimation"), equations (7)-(12) as printed, and beside each its exact rigid-body counterpart. Angles are the paper's
 * (see rotation.h). Measurements are specific force: +g on the axis that points up at rest. r: reference point ->
 * accelerometer, object frame, metres.
 *
 * Where the two differ: for a roll rate p and r = (0, r_s, 0) a rigid body gives a_s = -p^2 r_s and a_t = p' r_s; the
 * paper's (9) gives a_s = +p^2 r_s and, for r_t alone, a_t = p' r_t. */
#ifndef MODEL_SEED_H
#define MODEL_SEED_H

#include "model/math/rotation.h"

/** The seed's angles phi, theta, psi (in x, y, z) and their first and second derivatives. */
struct seed_motion {
	struct vec3 angles_rad, rates_rad_s, accels_rad_s2;
};

/** A rigid body's motion: attitude, angular rate and angular acceleration in the object frame. */
struct rigid_motion {
	struct quat q_nb;
	struct vec3 omega_b_rad_s, alpha_b_rad_s2;
};

/** (7): gravity on the three axes of an object at rest. */
struct vec3 seed_gravity(struct vec3 angles_rad, double g_m_s2);
/** The last term of (9): ((theta'^2 + psi'') r_l, (phi'^2 + psi'^2) r_s, (phi'' - theta'') r_t). */
struct vec3 seed_lever_arm(const struct seed_motion *motion, struct vec3 r_b_m);
/** (8): measured = a + gravity. */
struct vec3 seed_static(struct vec3 a_b_m_s2, struct vec3 angles_rad, double g_m_s2);
/** (9): measured = a + gravity + lever arm. */
struct vec3 seed_dynamic(struct vec3 a_b_m_s2, const struct seed_motion *motion, struct vec3 r_b_m, double g_m_s2);
/** (10): the measurement of (9) in the global frame, R_xyz a + (0, 0, g) + R_xyz (lever arm). */
struct vec3 seed_dynamic_global(
	struct vec3 a_b_m_s2, const struct seed_motion *motion, struct vec3 r_b_m, double g_m_s2);
/** (11): (9) with noise. */
struct vec3 seed_noisy(struct vec3 a_b_m_s2, const struct seed_motion *motion, struct vec3 r_b_m, double g_m_s2,
	struct vec3 noise_b_m_s2);
/** (12): the acceleration, from the measurement and the estimated motion. The inverse of (9). */
struct vec3 seed_estimate(
	struct vec3 measured_b_m_s2, const struct seed_motion *motion, struct vec3 r_b_m, double g_m_s2);

/** alpha x r + omega x (omega x r): the exact counterpart of the last term of (9). */
struct vec3 rigid_lever_arm(struct vec3 omega_b_rad_s, struct vec3 alpha_b_rad_s2, struct vec3 r_b_m);
/** The exact counterparts of (9), (10), (11) and (12). */
struct vec3 rigid_dynamic(struct vec3 a_b_m_s2, const struct rigid_motion *motion, struct vec3 r_b_m, double g_m_s2);
struct vec3 rigid_dynamic_global(
	struct vec3 a_b_m_s2, const struct rigid_motion *motion, struct vec3 r_b_m, double g_m_s2);
struct vec3 rigid_noisy(struct vec3 a_b_m_s2, const struct rigid_motion *motion, struct vec3 r_b_m, double g_m_s2,
	struct vec3 noise_b_m_s2);
struct vec3 rigid_estimate(
	struct vec3 measured_b_m_s2, const struct rigid_motion *motion, struct vec3 r_b_m, double g_m_s2);

/** The paper's angles and their derivatives from a rigid body's motion. Exact but near gimbal lock: within about 6
 * degrees of it cos(theta) is held at SEED_COS_THETA_LEAST, so that the derivatives stay bounded. */
struct seed_motion seed_motion_from_rigid(const struct rigid_motion *motion);
/** The inverse, exact everywhere. */
struct rigid_motion rigid_motion_from_seed(const struct seed_motion *motion);

/* By judgement: bounds the derivatives at ten times the rates, 6 degrees from gimbal lock. */
#define SEED_COS_THETA_LEAST 0.1

#endif
