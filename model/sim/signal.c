#include "model/sim/signal.h"
#include "model/math/units.h"

#include <string.h>

#define TWO_PI (2 * PI)

/* A value with its first and second time derivative. */
struct jet {
	double v, d, dd;
};

struct motion {
	struct jet roll, pitch, yaw; /* rad */
	struct jet x, y, z;	     /* m, global */
};

static struct jet constant(double v)
{
	return (struct jet){v, 0, 0};
}

static struct jet add(struct jet a, struct jet b)
{
	return (struct jet){a.v + b.v, a.d + b.d, a.dd + b.dd};
}

static struct jet scale(double k, struct jet a)
{
	return (struct jet){k * a.v, k * a.d, k * a.dd};
}

static struct jet multiply(struct jet a, struct jet b)
{
	return (struct jet){a.v * b.v, a.d * b.v + a.v * b.d, a.dd * b.v + 2 * a.d * b.d + a.v * b.dd};
}

/* sin(2 pi t / period + phase) */
static struct jet sine(double t, double period, double phase)
{
	double w = TWO_PI / period, s = sin(w * t + phase), c = cos(w * t + phase);

	return (struct jet){s, w * c, -w * w * s};
}

/* From 0 to 1 between `start` and `start + length`, with three continuous derivatives: 35u^4 - 84u^5 + 70u^6 -
 * 20u^7. */
static struct jet smooth_step(double t, double start, double length)
{
	double u = (t - start) / length, w = 1 - u;

	if (u <= 0)
		return constant(0);
	if (u >= 1)
		return constant(1);
	return (struct jet){
		u * u * u * u * (35 + u * (-84 + u * (70 - 20 * u))),
		140 * u * u * u * w * w * w / length,
		420 * u * u * w * w * (1 - 2 * u) / (length * length),
	};
}

/* 1 at the middle of each period, and smoothly close to 0 elsewhere: exp(-k (1 + cos)). */
static struct jet swell(double t, double period, double sharpness)
{
	double w = TWO_PI / period, c = cos(w * t), s = sin(w * t);
	double v = exp(-sharpness * (1 + c)), g = sharpness * w * s;

	return (struct jet){v, g * v, (g * g + sharpness * w * w * c) * v};
}

static void rest(const struct signal *signal, double t, struct motion *m)
{
	(void)signal;
	(void)t;
	(void)m;
}

/* Up at a quarter of the period, down at three quarters. */
static void roll_step(const struct signal *signal, double t, struct motion *m)
{
	const double period_s = signal->period_s, rise_s = fmin(signal->change_s, period_s / 4);
	struct jet up, down;

	t = fmod(t, period_s);
	up = smooth_step(t, period_s / 4, rise_s);
	down = smooth_step(t, period_s * 3 / 4, rise_s);
	m->roll = scale(signal->angle_rad, add(up, scale(-1, down)));
}

/* A light sea, and in each period a wave train that heaves, pitches, rolls and displaces the boat. */
static void boat(const struct signal *signal, double t, struct motion *m)
{
	const double period = signal->change_s, angle = signal->angle_rad;
	/* the height grows with the wavelength, so that the slope is constant */
	const double height_m = angle * 9.81 * period * period / (TWO_PI * TWO_PI) / 2;
	struct jet wave = swell(t, signal->period_s, 6);
	struct jet sea = add(constant(0.05), wave);

	m->pitch = scale(angle, multiply(sea, sine(t, period, 0)));
	m->roll = scale(0.7 * angle, multiply(sea, sine(t, period * 4 / 5, 1)));
	m->yaw = scale(0.3 * angle, multiply(sea, sine(t, period * 2, 2)));
	m->z = scale(height_m, multiply(sea, sine(t, period, PI / 2)));
	m->x = scale(height_m, multiply(sea, sine(t, period, PI)));
	m->y = scale(height_m / 2, multiply(wave, sine(t, period * 2, 0)));
}

/* Each side: wait, drive, wait, turn left by 90 degrees. Rough ground rolls and pitches the robot while it drives. */
static void square(const struct signal *signal, double t, struct motion *m)
{
	const double side_m = 2, leg_s = signal->period_s / 4;
	const double wait_s = leg_s / 10, drive_s = leg_s / 2, turn_s = leg_s / 5;
	const double bump_s = signal->change_s, angle = signal->angle_rad;
	struct jet moving = constant(0);
	struct jet ground, bumps;

	t = fmod(t, signal->period_s);
	for (int side = 0; side < 4; side++) {
		double start = side * leg_s + 2 * wait_s;
		struct jet way = scale(side_m, smooth_step(t, start, drive_s));
		struct jet *along = side % 2 ? &m->y : &m->x;

		*along = add(*along, scale(side < 2 ? 1 : -1, way));
		m->yaw = add(m->yaw, scale(PI / 2, smooth_step(t, start + drive_s + wait_s, turn_s)));
		moving = add(moving, smooth_step(t, start, drive_s / 4));
		moving = add(moving, scale(-1, smooth_step(t, start + drive_s * 3 / 4, drive_s / 4)));
	}
	ground = add(scale(0.7, sine(t, bump_s, 0)), scale(0.3, sine(t, bump_s * 2.3, 1)));
	m->roll = scale(angle, multiply(moving, ground));
	ground = add(scale(0.6, sine(t, bump_s * 1.3, 2)), scale(0.4, sine(t, bump_s * 3.1, 3)));
	m->pitch = scale(angle, multiply(moving, ground));
	/* height of the centre of a wheelbase of 0.3 m */
	bumps = add(scale(0.5, sine(t, bump_s, 4)), scale(0.5, sine(t, bump_s * 1.7, 5)));
	m->z = scale(0.15 * angle, multiply(moving, bumps));
}

static void turntable(const struct signal *signal, double t, struct motion *m)
{
	double rate = signal->angle_rad / signal->change_s;

	m->yaw = (struct jet){rate * t, rate, 0};
}

static void pendulum(const struct signal *signal, double t, struct motion *m)
{
	m->roll = scale(signal->angle_rad, sine(t, signal->change_s, 0));
}

/* Turned by hand about all axes while the reference point rests: all components of a lever arm are observable. */
static void tumble(const struct signal *signal, double t, struct motion *m)
{
	double period = signal->period_s;

	m->roll = scale(signal->angle_rad, sine(t, period / 7, 0));
	m->pitch = scale(signal->angle_rad, sine(t, period / 5, 0));
	m->yaw = scale(signal->angle_rad, sine(t, period / 4, 0));
}

/* Put on every face, then held on every corner; angle_rad is the pitch of the corners. A rest in each position, then a
 * rotation of change_s to the next. */
static void multiposition(const struct signal *signal, double t, struct motion *m)
{
	enum { POSITIONS = 14 };
	static const struct {
		double roll_deg, corner, pitch_deg; /* pitch = corner * angle + pitch_deg */
	} positions[POSITIONS + 1] = {{0, 0, 0}, {90, 0, 0}, {180, 0, 0}, {270, 0, 0}, {270, 0, 90}, {315, 1, 0},
		{405, 1, 0}, {495, 1, 0}, {585, 1, 0}, {585, -1, 0}, {495, -1, 0}, {405, -1, 0}, {315, -1, 0},
		{360, 0, -90}, {360, 0, 0}};
	const double stay_s = signal->period_s / POSITIONS, turn_s = fmin(signal->change_s, stay_s);

	t = fmod(t, signal->period_s);
	for (int i = 0; i < POSITIONS; i++) {
		struct jet step = smooth_step(t, (i + 1) * stay_s - turn_s, turn_s);
		double roll = RAD_PER_DEG * (positions[i + 1].roll_deg - positions[i].roll_deg);
		double pitch = RAD_PER_DEG * (positions[i + 1].pitch_deg - positions[i].pitch_deg) +
			       signal->angle_rad * (positions[i + 1].corner - positions[i].corner);

		m->roll = add(m->roll, scale(roll, step));
		m->pitch = add(m->pitch, scale(pitch, step));
	}
}

/* Turned by hand slowly, until each axis of the sensor has pointed in all directions. */
static void figure(const struct signal *signal, double t, struct motion *m)
{
	double turn = TWO_PI / signal->change_s;

	m->roll = (struct jet){turn * t, turn, 0};
	m->pitch = scale(signal->angle_rad, sine(t, signal->period_s, 0));
	m->yaw = (struct jet){TWO_PI * 2 * t / signal->period_s, TWO_PI * 2 / signal->period_s, 0};
}

const struct signal SIGNALS[] = {
	{"square", "robot on a manoeuvring square of 2 m: drives over rough ground, stops, turns", square,
		3 * RAD_PER_DEG, 0.2, 40},
	{"boat", "boat on a light sea, a large wave every 20 s", boat, 25 * RAD_PER_DEG, 2.5, 20},
	{"roll_step", "step about the roll axis, up and down", roll_step, 33 * RAD_PER_DEG, 0.1, 4},
	{"rest", "level and still", rest, 0, 1, 10},
	{"turntable", "constant turn about the vertical axis", turntable, TWO_PI, 1, 10},
	{"pendulum", "swing about the roll axis", pendulum, 30 * RAD_PER_DEG, 1, 10},
	{"tumble", "turned about all three axes around a point at rest", tumble, 60 * RAD_PER_DEG, 1, 10},
	{"multiposition", "put on six faces, then held on eight corners: to calibrate an accelerometer", multiposition,
		35.264 * RAD_PER_DEG, 1.5, 63},
	{"figure", "turned slowly through all directions: to calibrate a magnetometer", figure, 60 * RAD_PER_DEG, 5,
		40},
	{0},
};

const struct signal *signal_find(const char *name)
{
	for (const struct signal *signal = SIGNALS; signal->name; signal++)
		if (strcmp(signal->name, name) == 0)
			return signal;
	return NULL;
}

/* Yaw, then pitch, then roll (z-y'-x''). */
static struct quat attitude(const struct motion *m)
{
	double cr = cos(m->roll.v / 2), sr = sin(m->roll.v / 2);
	double cp = cos(m->pitch.v / 2), sp = sin(m->pitch.v / 2);
	double cy = cos(m->yaw.v / 2), sy = sin(m->yaw.v / 2);

	return (struct quat){
		cy * cp * cr + sy * sp * sr,
		cy * cp * sr - sy * sp * cr,
		cy * sp * cr + sy * cp * sr,
		sy * cp * cr - cy * sp * sr,
	};
}

/* Rates of z-y'-x'' angles in the body frame, and their derivative. */
static void body_rates(const struct motion *m, struct signal_truth *truth)
{
	const struct jet f = m->roll, h = m->pitch, y = m->yaw;
	double cf = cos(f.v), sf = sin(f.v), ch = cos(h.v), sh = sin(h.v);

	truth->omega_b_rad_s = (struct vec3){
		f.d - y.d * sh,
		h.d * cf + y.d * sf * ch,
		-h.d * sf + y.d * cf * ch,
	};
	truth->alpha_b_rad_s2 = (struct vec3){
		f.dd - y.dd * sh - y.d * h.d * ch,
		h.dd * cf - h.d * f.d * sf + y.dd * sf * ch + y.d * (f.d * cf * ch - h.d * sf * sh),
		-h.dd * sf - h.d * f.d * cf + y.dd * cf * ch - y.d * (f.d * sf * ch + h.d * cf * sh),
	};
}

void signal_at(const struct signal *signal, double t_s, struct signal_truth *truth)
{
	struct motion m = {0};

	signal->motion(signal, t_s, &m);
	truth->t_s = t_s;
	truth->angles_rad = (struct vec3){m.roll.v, m.pitch.v, m.yaw.v};
	truth->angles_dot_rad_s = (struct vec3){m.roll.d, m.pitch.d, m.yaw.d};
	truth->angles_ddot_rad_s2 = (struct vec3){m.roll.dd, m.pitch.dd, m.yaw.dd};
	truth->q_nb = attitude(&m);
	body_rates(&m, truth);
	truth->position_n_m = (struct vec3){m.x.v, m.y.v, m.z.v};
	truth->velocity_n_m_s = (struct vec3){m.x.d, m.y.d, m.z.d};
	truth->accel_n_m_s2 = (struct vec3){m.x.dd, m.y.dd, m.z.dd};
}
