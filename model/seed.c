#include "model/seed.h"

struct vec3 seed_gravity(struct vec3 angles_rad, double g_m_s2)
{
	double sf = sin(angles_rad.x), cf = cos(angles_rad.x);
	double st = sin(angles_rad.y), ct = cos(angles_rad.y);
	double sp = sin(angles_rad.z), cp = cos(angles_rad.z);

	return (struct vec3){
		g_m_s2 * (sf * sp + cf * st * cp),
		g_m_s2 * (-sf * cp + cf * st * sp),
		g_m_s2 * (cf * ct),
	};
}

struct vec3 seed_lever_arm(const struct seed_motion *motion, struct vec3 r_b_m)
{
	struct vec3 d = motion->rates_rad_s, dd = motion->accels_rad_s2;

	return (struct vec3){
		(d.y * d.y + dd.z) * r_b_m.x,
		(d.x * d.x + d.z * d.z) * r_b_m.y,
		(dd.x - dd.y) * r_b_m.z,
	};
}

struct vec3 seed_static(struct vec3 a_b_m_s2, struct vec3 angles_rad, double g_m_s2)
{
	return vec3_add(a_b_m_s2, seed_gravity(angles_rad, g_m_s2));
}

struct vec3 seed_dynamic(struct vec3 a_b_m_s2, const struct seed_motion *motion, struct vec3 r_b_m, double g_m_s2)
{
	return vec3_add(seed_static(a_b_m_s2, motion->angles_rad, g_m_s2), seed_lever_arm(motion, r_b_m));
}

struct vec3 seed_dynamic_global(
	struct vec3 a_b_m_s2, const struct seed_motion *motion, struct vec3 r_b_m, double g_m_s2)
{
	struct mat3 r_xyz = seed_rxyz(motion->angles_rad);
	struct vec3 gravity_n = {0, 0, g_m_s2};

	return vec3_add(
		vec3_add(mat3_apply(r_xyz, a_b_m_s2), gravity_n), mat3_apply(r_xyz, seed_lever_arm(motion, r_b_m)));
}

struct vec3 seed_noisy(struct vec3 a_b_m_s2, const struct seed_motion *motion, struct vec3 r_b_m, double g_m_s2,
	struct vec3 noise_b_m_s2)
{
	return vec3_add(seed_dynamic(a_b_m_s2, motion, r_b_m, g_m_s2), noise_b_m_s2);
}

struct vec3 seed_estimate(
	struct vec3 measured_b_m_s2, const struct seed_motion *motion, struct vec3 r_b_m, double g_m_s2)
{
	return vec3_sub(
		vec3_sub(measured_b_m_s2, seed_gravity(motion->angles_rad, g_m_s2)), seed_lever_arm(motion, r_b_m));
}

struct vec3 rigid_lever_arm(struct vec3 omega_b_rad_s, struct vec3 alpha_b_rad_s2, struct vec3 r_b_m)
{
	return vec3_add(vec3_cross(alpha_b_rad_s2, r_b_m), vec3_cross(omega_b_rad_s, vec3_cross(omega_b_rad_s, r_b_m)));
}

static struct vec3 gravity_and_lever_arm(const struct rigid_motion *motion, struct vec3 r_b_m, double g_m_s2)
{
	return vec3_add(quat_rotate_inverse(motion->q_nb, (struct vec3){0, 0, g_m_s2}),
		rigid_lever_arm(motion->omega_b_rad_s, motion->alpha_b_rad_s2, r_b_m));
}

struct vec3 rigid_dynamic(struct vec3 a_b_m_s2, const struct rigid_motion *motion, struct vec3 r_b_m, double g_m_s2)
{
	return vec3_add(a_b_m_s2, gravity_and_lever_arm(motion, r_b_m, g_m_s2));
}

struct vec3 rigid_dynamic_global(
	struct vec3 a_b_m_s2, const struct rigid_motion *motion, struct vec3 r_b_m, double g_m_s2)
{
	return quat_rotate(motion->q_nb, rigid_dynamic(a_b_m_s2, motion, r_b_m, g_m_s2));
}

struct vec3 rigid_noisy(struct vec3 a_b_m_s2, const struct rigid_motion *motion, struct vec3 r_b_m, double g_m_s2,
	struct vec3 noise_b_m_s2)
{
	return vec3_add(rigid_dynamic(a_b_m_s2, motion, r_b_m, g_m_s2), noise_b_m_s2);
}

struct vec3 rigid_estimate(
	struct vec3 measured_b_m_s2, const struct rigid_motion *motion, struct vec3 r_b_m, double g_m_s2)
{
	return vec3_sub(measured_b_m_s2, gravity_and_lever_arm(motion, r_b_m, g_m_s2));
}

/* R_bn = Rz(psi) Ry(theta) Rx(phi) in active matrices, so the rate of the global frame seen from
 * the object, -omega_b, is psi' z + theta' Rz y + phi' Rz Ry x: -u = cos(theta) phi',  -v = theta',
 * -omega_z = psi' - sin(theta) phi' with u, v the components of omega_b along and across the
 * direction psi in the object's x-y plane. */
struct seed_motion seed_motion_from_rigid(const struct rigid_motion *motion)
{
	struct vec3 w = motion->omega_b_rad_s, a = motion->alpha_b_rad_s2;
	struct seed_motion s = {.angles_rad = seed_angles_from_quat(motion->q_nb)};
	double sp = sin(s.angles_rad.z), cp = cos(s.angles_rad.z), st = sin(s.angles_rad.y);
	double ct = fmax(cos(s.angles_rad.y), SEED_COS_THETA_LEAST);
	double u = cp * w.x + sp * w.y, v = -sp * w.x + cp * w.y;
	double phi_d = -u / ct, theta_d = -v, psi_d = -w.z + st * phi_d;
	double u_d = cp * a.x + sp * a.y + psi_d * v, v_d = -sp * a.x + cp * a.y - psi_d * u;
	double phi_dd = (-u_d + st * theta_d * phi_d) / ct;

	s.rates_rad_s = (struct vec3){phi_d, theta_d, psi_d};
	s.accels_rad_s2 = (struct vec3){phi_dd, -v_d, -a.z + ct * theta_d * phi_d + st * phi_dd};
	return s;
}

struct rigid_motion rigid_motion_from_seed(const struct seed_motion *motion)
{
	struct vec3 d = motion->rates_rad_s, dd = motion->accels_rad_s2;
	double sp = sin(motion->angles_rad.z), cp = cos(motion->angles_rad.z);
	double st = sin(motion->angles_rad.y), ct = cos(motion->angles_rad.y);
	double u = -ct * d.x, v = -d.y;
	double u_d = -ct * dd.x + st * d.y * d.x, v_d = -dd.y;

	return (struct rigid_motion){
		.q_nb = quat_from_seed_angles(motion->angles_rad),
		.omega_b_rad_s = {cp * u - sp * v, sp * u + cp * v, st * d.x - d.z},
		.alpha_b_rad_s2 =
			{
				cp * u_d - sp * v_d - d.z * (sp * u + cp * v),
				sp * u_d + cp * v_d + d.z * (cp * u - sp * v),
				ct * d.y * d.x + st * dd.x - dd.z,
			},
	};
}
