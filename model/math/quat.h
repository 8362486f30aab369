/* model/math/quat.h
 * Unit quaternions (Hamilton convention, w first) by value. q_nb turns a vector of the object frame b into the global
 * frame n (ENU): v_n = quat_rotate(q_nb, v_b). Products compose from right to left, as matrices do. */
#ifndef MODEL_MATH_QUAT_H
#define MODEL_MATH_QUAT_H

#include "model/math/vec3.h"

struct quat {
	double w, x, y, z;
};

#define QUAT_IDENTITY ((struct quat){1, 0, 0, 0})

static inline struct quat quat_multiply(struct quat a, struct quat b)
{
	return (struct quat){
		a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
		a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
		a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
		a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
	};
}

static inline struct quat quat_conjugate(struct quat q)
{
	return (struct quat){q.w, -q.x, -q.y, -q.z};
}

static inline struct quat quat_normalize(struct quat q)
{
	double k = 1 / sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);

	return (struct quat){k * q.w, k * q.x, k * q.y, k * q.z};
}

static inline struct vec3 quat_rotate(struct quat q, struct vec3 v)
{
	struct vec3 u = {q.x, q.y, q.z};
	struct vec3 t = vec3_scale(2, vec3_cross(u, v));

	return vec3_add(v, vec3_add(vec3_scale(q.w, t), vec3_cross(u, t)));
}

/** The inverse rotation: global to object. */
static inline struct vec3 quat_rotate_inverse(struct quat q, struct vec3 v)
{
	return quat_rotate(quat_conjugate(q), v);
}

/** The rotation by the vector `angle_rad` (axis times angle): exact, and safe at zero. */
static inline struct quat quat_from_rotation_vector(struct vec3 angle_rad)
{
	double a = vec3_norm(angle_rad), k = a > 1e-9 ? sin(a / 2) / a : 0.5 - a * a / 48;

	return (struct quat){cos(a / 2), k * angle_rad.x, k * angle_rad.y, k * angle_rad.z};
}

/** The rotation vector of q: its axis times the angle of the shorter way, 0..pi. */
static inline struct vec3 quat_to_rotation_vector(struct quat q)
{
	double s = sqrt(q.x * q.x + q.y * q.y + q.z * q.z), k = s > 1e-9 ? 2 * atan2(s, fabs(q.w)) / s : 2;

	return vec3_scale(q.w < 0 ? -k : k, (struct vec3){q.x, q.y, q.z});
}

/** The rotation vector between two samples of the angular rate. Exact to the third power of dt while the rate changes
 * steadily, its axis included (coning: J. Bortz, "A new mathematical formulation for strapdown inertial navigation",
 * IEEE AES 7(1), 1971). */
static inline struct vec3 rotation_between(struct vec3 before_rad_s, struct vec3 after_rad_s, double dt_s)
{
	struct vec3 mean = vec3_scale(dt_s / 2, vec3_add(before_rad_s, after_rad_s));

	return vec3_add(mean, vec3_scale(dt_s * dt_s / 12, vec3_cross(before_rad_s, after_rad_s)));
}

#endif
