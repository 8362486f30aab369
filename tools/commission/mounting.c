#include "tools/commission/mounting.h"

#include <math.h>

#include "model/math/rotation.h"

static struct vec3 unit(struct vec3 v)
{
	return vec3_scale(1 / vec3_norm(v), v);
}

double mounting_angle_rad(struct vec3 a, struct vec3 b)
{
	return atan2(vec3_norm(vec3_cross(a, b)), vec3_dot(a, b));
}

struct vec3 mounting_from_poses(struct vec3 level, struct vec3 raised)
{
	/* the axes of the object in those of the sensor: the rows of the rotation sensor -> object */
	const struct vec3 t = unit(level), s = unit(vec3_cross(t, raised)), l = vec3_cross(s, t);
	const double across = hypot(l.x, s.x);

	if (across < GIMBAL_LOCK_RAD)
		return (struct vec3){0, atan2(-t.x, across), atan2(-l.y, s.y)};
	return (struct vec3){atan2(t.y, t.z), atan2(-t.x, across), atan2(s.x, l.x)};
}

struct vec3 mounting_sigma_rad(struct vec3 level, struct vec3 raised, double sigma_m_s2)
{
	const double angle = mounting_angle_rad(level, raised), tilt = sigma_m_s2 / vec3_norm(level);

	return (struct vec3){tilt, tilt, tilt * hypot(1, cos(angle)) / sin(angle)};
}
