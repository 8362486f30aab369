#include "model/math/rotation.h"
#include "model/math/units.h"

struct mat3 mat3_multiply(struct mat3 a, struct mat3 b)
{
	struct mat3 c;

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			c.m[i][j] = a.m[i][0] * b.m[0][j] + a.m[i][1] * b.m[1][j] + a.m[i][2] * b.m[2][j];
	return c;
}

struct mat3 mat3_transpose(struct mat3 a)
{
	struct mat3 t;

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			t.m[i][j] = a.m[j][i];
	return t;
}

struct vec3 mat3_apply(struct mat3 a, struct vec3 v)
{
	return (struct vec3){
		a.m[0][0] * v.x + a.m[0][1] * v.y + a.m[0][2] * v.z,
		a.m[1][0] * v.x + a.m[1][1] * v.y + a.m[1][2] * v.z,
		a.m[2][0] * v.x + a.m[2][1] * v.y + a.m[2][2] * v.z,
	};
}

struct mat3 mat3_from_quat(struct quat q)
{
	struct vec3 x = quat_rotate(q, (struct vec3){1, 0, 0});
	struct vec3 y = quat_rotate(q, (struct vec3){0, 1, 0});
	struct vec3 z = quat_rotate(q, (struct vec3){0, 0, 1});

	return (struct mat3){{{x.x, y.x, z.x}, {x.y, y.y, z.y}, {x.z, y.z, z.z}}};
}

struct mat3 mat3_minus_cross(struct vec3 a)
{
	return (struct mat3){{{0, a.z, -a.y}, {-a.z, 0, a.x}, {a.y, -a.x, 0}}};
}

struct mat3 seed_rx(double phi)
{
	double s = sin(phi), c = cos(phi);

	return (struct mat3){{{1, 0, 0}, {0, c, s}, {0, -s, c}}};
}

struct mat3 seed_ry(double theta)
{
	double s = sin(theta), c = cos(theta);

	return (struct mat3){{{c, 0, -s}, {0, 1, 0}, {s, 0, c}}};
}

struct mat3 seed_rz(double psi)
{
	double s = sin(psi), c = cos(psi);

	return (struct mat3){{{c, s, 0}, {-s, c, 0}, {0, 0, 1}}};
}

struct mat3 seed_rxyz(struct vec3 angles_rad)
{
	double sf = sin(angles_rad.x), cf = cos(angles_rad.x);
	double st = sin(angles_rad.y), ct = cos(angles_rad.y);
	double sp = sin(angles_rad.z), cp = cos(angles_rad.z);

	return (struct mat3){{
		{ct * cp, ct * sp, -st},
		{-cf * sp + sf * st * cp, cf * cp + sf * st * sp, sf * ct},
		{sf * sp + cf * st * cp, -sf * cp + cf * st * sp, cf * ct},
	}};
}

struct mat3 seed_rxyz_inverse(struct vec3 angles_rad)
{
	return mat3_multiply(mat3_transpose(seed_rz(angles_rad.z)),
		mat3_multiply(mat3_transpose(seed_ry(angles_rad.y)), mat3_transpose(seed_rx(angles_rad.x))));
}

struct quat quat_from_aerospace(struct vec3 roll_pitch_yaw_rad)
{
	double sr = sin(roll_pitch_yaw_rad.x / 2), cr = cos(roll_pitch_yaw_rad.x / 2);
	double sp = sin(roll_pitch_yaw_rad.y / 2), cp = cos(roll_pitch_yaw_rad.y / 2);
	double sy = sin(roll_pitch_yaw_rad.z / 2), cy = cos(roll_pitch_yaw_rad.z / 2);

	return (struct quat){
		cy * cp * cr + sy * sp * sr,
		cy * cp * sr - sy * sp * cr,
		cy * sp * cr + sy * cp * sr,
		sy * cp * cr - cy * sp * sr,
	};
}

static double wrap(double angle)
{
	return angle > PI ? angle - 2 * PI : angle <= -PI ? angle + 2 * PI : angle;
}

/* Sum and difference of yaw and roll come straight from the quaternion and stay accurate near gimbal lock, where the
 * usual matrix elements all vanish: w +- y = (c +- s) cos((yaw -+ roll) / 2), z -+ x = (c +- s) sin(..), with c, s =
 * cos, sin of half the pitch. */
struct vec3 aerospace_from_quat(struct quat q)
{
	double up = hypot(q.z - q.x, q.w + q.y);   /* c + s: 0 at pitch = -90 degrees */
	double down = hypot(q.z + q.x, q.w - q.y); /* c - s: 0 at pitch = +90 degrees */
	double difference = 2 * atan2(q.z - q.x, q.w + q.y);
	double sum = 2 * atan2(q.z + q.x, q.w - q.y);
	double pitch = 2 * atan2(up, down) - PI / 2;

	if (down < GIMBAL_LOCK_RAD)
		return (struct vec3){0, pitch, wrap(difference)};
	if (up < GIMBAL_LOCK_RAD)
		return (struct vec3){0, pitch, wrap(sum)};
	return (struct vec3){wrap((sum - difference) / 2), pitch, wrap((sum + difference) / 2)};
}

struct quat quat_from_seed_angles(struct vec3 angles_rad)
{
	return quat_conjugate(quat_from_aerospace(angles_rad));
}

struct vec3 seed_angles_from_quat(struct quat q_nb)
{
	return aerospace_from_quat(quat_conjugate(q_nb));
}
