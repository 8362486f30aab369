/* tools/commission/mounting.h
 * The mounting (2053h) from two poses of the object at rest. The force of the first, level, is along t and gives roll
 * and pitch; that of the second, with the front raised about s, lies in the plane of l and t and gives yaw. Pure. */
#ifndef TOOLS_COMMISSION_MOUNTING_H
#define TOOLS_COMMISSION_MOUNTING_H

#include "model/math/vec3.h"

/** Least angle between the poses: below it yaw is uncertain. */
#define MOUNTING_RAISED_DEG 20

/** The angle between the forces of two poses. */
double mounting_angle_rad(struct vec3 a, struct vec3 b);
/** Roll, pitch, yaw (z-y'-x'') that turn sensor axes into the object frame. `level` and `raised`: specific force in
 * sensor axes, m/s^2, neither 0 nor parallel. */
struct vec3 mounting_from_poses(struct vec3 level, struct vec3 raised);
/** 1 sigma of the same for independent errors of the forces with 1 sigma `sigma_m_s2` on each axis: x, y of the level
 * axes, z of yaw. How well the poses themselves were taken is not in it. */
struct vec3 mounting_sigma_rad(struct vec3 level, struct vec3 raised, double sigma_m_s2);

#endif
