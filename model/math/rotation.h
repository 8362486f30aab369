/* model/math/rotation.h
 * Rotations as the seed paper writes them, equations (1)-(6), and conversions between them, quaternions and aerospace
 * angles.
 *
 * The paper's angles (phi, theta, psi) are x, y, z of a struct vec3, radians. Its elementary matrices are passive, and
 * it takes their product R_xyz for object -> global: v_n = R_xyz v_b. So they are the aerospace angles (roll, pitch,
 * yaw; z-y'-x'') of the inverse rotation global -> object, not of the object's attitude.
 *
 * Misprints of the paper: (5) names its factors R_x(psi) R_z(phi), but its elements are those of R_x(phi) R_y(theta)
 * R_z(psi); and element (2,1) is printed with s(phi)s(theta)s(psi) where the product has s(phi)s(theta)c(psi). */
#ifndef MODEL_MATH_ROTATION_H
#define MODEL_MATH_ROTATION_H

#include "model/math/quat.h"

struct mat3 {
	double m[3][3]; /* row-major */
};

struct mat3 mat3_multiply(struct mat3 a, struct mat3 b);
struct mat3 mat3_transpose(struct mat3 a);
/** Equation (1): v_global = T v_object. */
struct vec3 mat3_apply(struct mat3 a, struct vec3 v);
struct mat3 mat3_from_quat(struct quat q);
/** -[a]x, so that the product with v is v x a. */
struct mat3 mat3_minus_cross(struct vec3 a);

/** Equations (2), (3), (4). */
struct mat3 seed_rx(double phi);
struct mat3 seed_ry(double theta);
struct mat3 seed_rz(double psi);
/** Equation (5), element by element with its misprint corrected: object -> global. */
struct mat3 seed_rxyz(struct vec3 angles_rad);
/** Equation (6), the product of the inverses in reverse order: global -> object. */
struct mat3 seed_rxyz_inverse(struct vec3 angles_rad);

struct quat quat_from_seed_angles(struct vec3 angles_rad);
struct vec3 seed_angles_from_quat(struct quat q_nb);

/** Roll, pitch, yaw in x, y, z: q = yaw about z, then pitch about the new y, then roll about the new x. */
struct quat quat_from_aerospace(struct vec3 roll_pitch_yaw_rad);
/** Roll and yaw in (-pi, pi], pitch in [-pi/2, pi/2]. Accurate to rounding up to gimbal lock. Within GIMBAL_LOCK_RAD of
 * it roll is 0 and yaw carries the whole rotation, so that yaw stays continuous while the object turns there. */
struct vec3 aerospace_from_quat(struct quat q);

#define GIMBAL_LOCK_RAD 1e-6

#endif
