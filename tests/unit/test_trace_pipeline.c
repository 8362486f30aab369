/* What the pipeline publishes in simulated motions, compared with what it published when the trace was written
 * (trace.h): values, sigmas, estimated errors and status, as means over some seconds each. The motions are those that
 * the presets are for, and what disturbs them, so that each part of the online path has an influence somewhere. */
#include "tests/unit/model_test.h"

#include <stdio.h>
#include <string.h>

#include "model/pipeline.h"
#include "model/seed.h"
#include "model/sim/sensor.h"
#include "model/smoother.h"
#include "tests/unit/trace.h"

#define DEG(x) ((x)*RAD_PER_DEG)

enum { STEPS = 12, CRUISES = 4, SINES = 5, STRIDES = 14 };
enum axis { X, Y, Z, ROLL, PITCH, YAW, AXES };

/* A coordinate with its first two derivatives. */
struct jet {
	double v, d, dd;
};

/* The coordinate changes by `by` between begin_s and begin_s + in_s. */
struct step {
	enum axis axis;
	double begin_s, in_s, by;
};

/* Its speed is `by` from begin_s + in_s to end_s - in_s, with smooth ramps. */
struct cruise {
	enum axis axis;
	double begin_s, end_s, in_s, by;
};

/* A sine of a coordinate that fades in and out within FADE_S. */
struct sine {
	enum axis axis;
	double begin_s, end_s, amplitude, hz, phase;
};

static const double FADE_S = 1;

struct world {
	const struct motion *motion;
	struct pipeline_config config;
	struct pipeline pipeline;
	struct sensor sensor;
	struct vec3 iron_n_uT, magnet_b_uT; /* added to the field */
	struct vec3 gyro_b_rad_s;	    /* added to the rate */
	double silent_until_s;
	unsigned flags; /* of the next sample */
};

struct motion {
	const char *name;
	double seconds, rate_hz; /* default 100 */
	double each_s;		 /* of the trace, default: a fifth of all */
	const char *signal;	 /* one of SIGNALS, and beside it: */
	double start[AXES];
	struct step steps[STEPS];
	struct cruise cruises[CRUISES];
	struct sine sines[SINES];
	struct step stride; /* of a foot, STRIDES times, one each stride.in_s; .by: metres */
	void (*setup)(struct pipeline_config *config, struct sensor_config *chip);
	void (*act)(struct world *w, double t_s); /* before each sample */
};

/* ---- the motion -------------------------------------------------------------------------------------------------- */

static struct jet step_at(double t_s, double begin_s, double in_s)
{
	double u = fmax(0, fmin(1, (t_s - begin_s) / in_s)), w = 1 - u;

	return (struct jet){u * u * u * u * (35 + u * (-84 + u * (70 - 20 * u))), 140 * u * u * u * w * w * w / in_s,
		420 * u * u * w * w * (1 - 2 * u) / (in_s * in_s)};
}

/* The integral of step_at(). */
static struct jet ramp_at(double t_s, double begin_s, double in_s)
{
	double u = fmax(0, fmin(1, (t_s - begin_s) / in_s)), after_s = fmax(0, t_s - begin_s - in_s);
	struct jet step = step_at(t_s, begin_s, in_s);

	return (struct jet){in_s * u * u * u * u * u * (7 + u * (-14 + u * (10 - 2.5 * u))) + after_s, step.v, step.d};
}

static struct jet sine_at(const struct sine *s, double t_s)
{
	double w = 2 * PI * s->hz, p = w * (t_s - s->begin_s) + s->phase;
	struct jet in = step_at(t_s, s->begin_s, FADE_S), out = step_at(t_s, s->end_s - FADE_S, FADE_S);
	struct jet a = {in.v - out.v, in.d - out.d, in.dd - out.dd};

	return (struct jet){a.v * sin(p), a.d * sin(p) + a.v * w * cos(p),
		a.dd * sin(p) + 2 * a.d * w * cos(p) - a.v * w * w * sin(p)};
}

static void add(struct jet *to, double scale, struct jet j)
{
	to->v += scale * j.v;
	to->d += scale * j.d;
	to->dd += scale * j.dd;
}

/* Forward in the first half of each stride, with the foot lifted and pitched; then it stands. */
static void walk(struct jet at[AXES], const struct step *stride, double t_s)
{
	const double swing_s = stride->in_s * 0.55;

	for (int k = 0; k < STRIDES; k++) {
		double begin_s = stride->begin_s + k * stride->in_s;

		add(&at[X], stride->by, step_at(t_s, begin_s, swing_s));
		add(&at[Z], 0.12, step_at(t_s, begin_s, swing_s / 2));
		add(&at[Z], -0.12, step_at(t_s, begin_s + swing_s / 2, swing_s / 2));
		add(&at[PITCH], DEG(35), step_at(t_s, begin_s, swing_s / 3));
		add(&at[PITCH], DEG(-55), step_at(t_s, begin_s + swing_s / 3, swing_s / 3));
		add(&at[PITCH], DEG(20), step_at(t_s, begin_s + 2 * swing_s / 3, swing_s / 3));
	}
}

static struct signal_truth truth_at(const struct motion *m, double t_s)
{
	struct signal_truth truth = {.t_s = t_s};
	struct jet at[AXES] = {{0}};
	struct seed_motion turn;
	struct rigid_motion body;

	if (m->signal)
		signal_at(signal_find(m->signal), t_s, &truth);
	for (int i = 0; i < AXES; i++)
		at[i].v = m->start[i];
	for (int i = 0; i < STEPS && m->steps[i].in_s > 0; i++)
		add(&at[m->steps[i].axis], m->steps[i].by, step_at(t_s, m->steps[i].begin_s, m->steps[i].in_s));
	for (int i = 0; i < CRUISES && m->cruises[i].in_s > 0; i++) {
		const struct cruise *c = &m->cruises[i];

		add(&at[c->axis], c->by, ramp_at(t_s, c->begin_s, c->in_s));
		add(&at[c->axis], -c->by, ramp_at(t_s, c->end_s - c->in_s, c->in_s));
	}
	for (int i = 0; i < SINES && m->sines[i].hz > 0; i++)
		add(&at[m->sines[i].axis], m->sines[i].amplitude, sine_at(&m->sines[i], t_s));
	if (m->stride.in_s > 0)
		walk(at, &m->stride, t_s);
	truth.position_n_m = vec3_add(truth.position_n_m, (struct vec3){at[X].v, at[Y].v, at[Z].v});
	truth.accel_n_m_s2 = vec3_add(truth.accel_n_m_s2, (struct vec3){at[X].dd, at[Y].dd, at[Z].dd});
	if (m->signal)
		return truth;
	turn = (struct seed_motion){
		.angles_rad = {at[ROLL].v, at[PITCH].v, at[YAW].v},
		.rates_rad_s = {at[ROLL].d, at[PITCH].d, at[YAW].d},
		.accels_rad_s2 = {at[ROLL].dd, at[PITCH].dd, at[YAW].dd},
	};
	body = rigid_motion_from_seed(&turn);
	truth.q_nb = body.q_nb;
	truth.omega_b_rad_s = body.omega_b_rad_s;
	truth.alpha_b_rad_s2 = body.alpha_b_rad_s2;
	return truth;
}

static bool at_end(struct vec3 v, double range)
{
	return range > 0 && fmax(fmax(fabs(v.x), fabs(v.y)), fabs(v.z)) >= range;
}

static struct imu_sample sample_at(struct world *w, double t_s)
{
	struct signal_truth truth = truth_at(w->motion, t_s);
	struct imu_sample s;

	(void)sensor_instant_s(&w->sensor);
	sensor_measure(&w->sensor, &truth, &s);
	if (s.flags & SAMPLE_MAG)
		s.mag_uT = vec3_add(s.mag_uT, vec3_add(quat_rotate_inverse(truth.q_nb, w->iron_n_uT), w->magnet_b_uT));
	s.gyro_rad_s = vec3_add(s.gyro_rad_s, w->gyro_b_rad_s);
	if (at_end(s.accel_m_s2, w->sensor.config.accel.range) || at_end(s.gyro_rad_s, w->sensor.config.gyro.range))
		s.flags |= SAMPLE_SATURATED;
	s.flags |= w->flags;
	w->flags = 0;
	return s;
}

/* ---- the trace --------------------------------------------------------------------------------------------------- */

enum kind { MEAN, RMS };

static const struct column {
	const char *name;
	size_t at; /* of a vector in struct pipeline_output */
	enum kind kind;
	double resolution;
} COLUMNS[] = {
#define COLUMN(name, field, kind, resolution)                                   \
	{                                                                       \
		name, offsetof(struct pipeline_output, field), kind, resolution \
	}
	COLUMN("angles_rad", angles_rad, MEAN, 1e-6),
	COLUMN("rate_rms_rad_s", rate_b_rad_s, RMS, 1e-7),
	COLUMN("alpha_rms_rad_s2", alpha_b_rad_s2, RMS, 1e-5),
	COLUMN("force_m_s2", force_b_m_s2, MEAN, 1e-6),
	COLUMN("mag_uT", mag_b_uT, MEAN, 1e-5),
	COLUMN("accel_b_rms_m_s2", accel_b_m_s2, RMS, 1e-6),
	COLUMN("accel_m_s2", accel_n_m_s2, MEAN, 1e-6),
	COLUMN("velocity_m_s", velocity_n_m_s, MEAN, 1e-6),
	COLUMN("position_m", position_n_m, MEAN, 1e-5),
	COLUMN("displacement_m", displacement_n_m, MEAN, 1e-5),
	COLUMN("displacement_sigma_m", displacement_sigma_m, MEAN, 1e-7),
	COLUMN("sigma_attitude_rad", sigma.attitude_rad, MEAN, 1e-8),
	COLUMN("sigma_accel_m_s2", sigma.accel_m_s2, MEAN, 1e-7),
	COLUMN("sigma_velocity_m_s", sigma.velocity_m_s, MEAN, 1e-7),
	COLUMN("sigma_position_m", sigma.position_m, MEAN, 1e-7),
	COLUMN("gyro_bias_rad_s", gyro_errors.bias_b_rad_s, MEAN, 1e-9),
	COLUMN("gyro_scale", gyro_errors.scale_b, MEAN, 1e-9),
#undef COLUMN
};

static const struct {
	unsigned bit;
	const char *name;
} STATUS[] = {
	{PIPELINE_VALID, "valid"},
	{PIPELINE_REST, "rest"},
	{PIPELINE_MAG_USED, "mag_used"},
	{PIPELINE_TIME_LIMIT, "time_limit"},
	{PIPELINE_GAP, "gap"},
	{PIPELINE_UNSURE, "unsure"},
	{PIPELINE_ASSUMED, "assumed"},
	{PIPELINE_DISAGREES, "disagrees"},
	{PIPELINE_VIBRATION, "vibration"},
};

enum { COLUMNS_COUNT = sizeof COLUMNS / sizeof *COLUMNS, BITS = sizeof STATUS / sizeof *STATUS };

struct means {
	struct vec3 sum[COLUMNS_COUNT];
	int samples, set[BITS];
	double vibration_m_s2;
};

static struct vec3 square(struct vec3 v)
{
	return (struct vec3){v.x * v.x, v.y * v.y, v.z * v.z};
}

static void collect(struct means *m, const struct pipeline_output *out)
{
	for (int i = 0; i < COLUMNS_COUNT; i++) {
		struct vec3 v = *(const struct vec3 *)((const char *)out + COLUMNS[i].at);

		m->sum[i] = vec3_add(m->sum[i], COLUMNS[i].kind == RMS ? square(v) : v);
	}
	for (int i = 0; i < BITS; i++)
		m->set[i] += (out->status & STATUS[i].bit) != 0;
	m->vibration_m_s2 += out->vibration_m_s2;
	m->samples++;
}

static void trace_means(const struct world *w, const struct means *m, const struct pipeline_output *out, double t_s)
{
	char header[64];

	snprintf(header, sizeof header, "%s, %.6g s", w->motion->name, t_s);
	trace_block(header);
	for (int i = 0; i < COLUMNS_COUNT; i++) {
		struct vec3 v = vec3_scale(1.0 / m->samples, m->sum[i]);

		if (COLUMNS[i].kind == RMS)
			v = (struct vec3){sqrt(v.x), sqrt(v.y), sqrt(v.z)};
		trace_vec(COLUMNS[i].name, v, COLUMNS[i].resolution);
	}
	for (int i = 0; i < BITS; i++)
		trace_value(STATUS[i].name, m->set[i], 0);
	trace_value("vibration_m_s2", m->vibration_m_s2 / m->samples, 1e-6);
	trace_value("clipped_accel", out->clipped_accel, 0);
	trace_value("clipped_gyro", out->clipped_gyro, 0);
	trace_value("accel_delay_s", out->accel_delay_s, 1e-9);
	trace_value("gaps", w->pipeline.gaps, 0);
	trace_value("refused", w->pipeline.refused, 0);
	trace_value("implausible", w->pipeline.implausible, 0);
}

/* The last movement, at some of its points. */
static void trace_movement(const struct world *w, const struct smoother_movement *m)
{
	enum { PARTS = 4 };
	char name[64];

	if (m->number == 0)
		return;
	snprintf(name, sizeof name, "%s, last movement", w->motion->name);
	trace_block(name);
	trace_value("number", m->number, 0);
	trace_value("whole", m->whole, 0);
	trace_value("duration_s", m->duration_s, 1e-6);
	trace_value("path_m", m->path_m, 1e-6);
	trace_value("stood_s", m->stood_s, 1e-6);
	trace_value("farthest_m", m->farthest_m, 1e-6);
	trace_value("farthest_s", m->farthest_s, 1e-6);
	trace_value("points", (double)m->count, 0);
	for (int i = 1; i <= PARTS; i++) {
		const struct smoother_point *p = &m->point[(m->count - 1) * (size_t)i / PARTS];

		trace_value("t_s", p->t_s, 1e-6);
		trace_vec("position_m", p->position_n_m, 1e-5);
		trace_vec("velocity_m_s", p->velocity_n_m_s, 1e-6);
		trace_vec("sigma_m", p->sigma_m, 1e-7);
	}
}

/* A calibrated chip with what calibrations leave, and its lever arm known, if setup() does not say otherwise. */
static void prepare(struct world *w, const struct motion *m)
{
	struct sensor_config chip = *sensor_preset("lsm303dlhc_l3gd20");

	sensor_calibrate(&chip);
	chip.rate_hz = m->rate_hz > 0 ? m->rate_hz : 100;
	chip.gyro.bias_sigma = DEG(0.1);
	chip.gyro.scale_sigma = chip.accel.scale_sigma = 0.002;
	chip.accel.bias_sigma = 0.02;
	*w = (struct world){.motion = m, .config = PIPELINE_DEFAULTS};
	if (m->setup)
		m->setup(&w->config, &chip);
	assert_int_equal(sensor_init(&w->sensor, &chip, 7), 0);
	assert_int_equal(pipeline_init(&w->pipeline, &w->config, chip.rate_hz), 0);
}

static void test_motion(void **state)
{
	static struct world w;
	static struct smoother smoother;
	const struct motion *m = *state;
	double each_s = m->each_s > 0 ? m->each_s : m->seconds / 5, next_s = each_s;
	struct pipeline_output out = {0};
	struct means means = {0};

	prepare(&w, m);
	memset(&smoother, 0, sizeof smoother);
	pipeline_smooth(&w.pipeline, &smoother);
	for (int k = 0; k < m->seconds * w.sensor.config.rate_hz; k++) {
		double t_s = k / w.sensor.config.rate_hz;
		struct imu_sample s;

		if (m->act)
			m->act(&w, t_s);
		s = sample_at(&w, t_s);
		if (t_s >= w.silent_until_s && pipeline_step(&w.pipeline, &s, &out) == 0)
			collect(&means, &out);
		if (t_s + 1.5 / w.sensor.config.rate_hz > next_s) {
			trace_means(&w, &means, &out, next_s);
			means = (struct means){0};
			next_s += each_s;
		}
	}
	trace_movement(&w, &smoother.last);
	trace_check();
}

/* ---- the motions ------------------------------------------------------------------------------------------------- */

/* At t_s, and not at the sample before. */
static bool is(const struct world *w, double t_s, double event_s)
{
	return t_s >= event_s && t_s < event_s + 0.999 / w->sensor.config.rate_hz;
}

static bool each(const struct world *w, double t_s, double begin_s, double end_s, double interval_s)
{
	double at_s = begin_s + interval_s * floor((t_s - begin_s) / interval_s + 1e-6);

	return t_s > begin_s - 1e-6 && t_s < end_s && is(w, t_s + 1e-6, at_s);
}

static void preset(struct pipeline_config *c, enum motion_preset preset)
{
	c->position.navigation.preset = preset;
}

static void lever_arm(struct pipeline_config *c, struct sensor_config *chip)
{
	c->estimator.lever_arm_b_m = chip->lever_arm_b_m = (struct vec3){0.2, -0.1, 0.15};
}

static void base(struct pipeline_config *c, struct sensor_config *chip)
{
	preset(c, MOTION_ROBOT_BASE);
	lever_arm(c, chip);
	c->estimator.model = LEVER_ARM_AUTO;
	c->accel_filter = (struct filter_config){FILTER_SEED_FIR, 2, 40};
	c->position.sigma_limit_m = 0.2;
}

static void base_from_angles(struct pipeline_config *c, struct sensor_config *chip)
{
	base(c, chip);
	c->estimator.rates_from = RATES_FROM_ANGLES;
	c->rate_filter = (struct filter_config){FILTER_BUTTERWORTH, 3, 15};
	c->calibration.mounting_rad = (struct vec3){DEG(3), DEG(-2), DEG(90)};
	chip->jitter_s = 5e-4;
}

static void without_magnetometer(struct pipeline_config *c, struct sensor_config *chip)
{
	(void)chip;
	c->fusion.use_magnetometer = 0;
}

static void clipping_gyro(struct pipeline_config *c, struct sensor_config *chip)
{
	(void)c;
	chip->gyro.range = DEG(250);
}

static void axis(struct pipeline_config *c, struct sensor_config *chip)
{
	(void)chip;
	preset(c, MOTION_LINEAR_AXIS);
}

static void vertical_lift(struct pipeline_config *c, struct sensor_config *chip)
{
	(void)chip;
	preset(c, MOTION_VERTICAL_LIFT);
}

static void foot(struct pipeline_config *c, struct sensor_config *chip)
{
	(void)chip;
	preset(c, MOTION_FOOT);
}

static void foot_with_own_times(struct pipeline_config *c, struct sensor_config *chip)
{
	(void)chip;
	preset(c, MOTION_FOOT);
	c->stance_s = 0.15;
	c->rest.gyro_threshold_rad_s = DEG(40);
	c->rest.accel_threshold_m_s2 = 3;
}

static void hand(struct pipeline_config *c, struct sensor_config *chip)
{
	preset(c, MOTION_HAND_HELD);
	lever_arm(c, chip);
	c->accel_filter = (struct filter_config){FILTER_BUTTERWORTH, 4, 10};
}

static void levelled(struct pipeline_config *c, struct sensor_config *chip)
{
	(void)chip;
	c->position.navigation.levelling = 1;
}

static void prior(struct pipeline_config *c, struct sensor_config *chip)
{
	levelled(c, chip);
	c->position.navigation.velocity_prior_m_s = 0.3;
}

static void crane(struct pipeline_config *c, struct sensor_config *chip)
{
	preset(c, MOTION_HANGING_LOAD);
	c->position.navigation.rope_m = 4.5;
	chip->lever_arm_b_m.z = -5;
}

static void crane_of_known_rope(struct pipeline_config *c, struct sensor_config *chip)
{
	crane(c, chip);
	c->position.navigation.rope_m = 5;
	chip->gyro.density /= 1.5; /* a better chip, which tells that the trolley stands while the load swings */
	chip->accel.density /= 1.5;
	chip->gyro.step = chip->accel.step = 0;
	c->noise.gyro_density_rad_s_sqrt_hz /= 1.5;
	c->noise.accel_density_m_s2_sqrt_hz /= 1.5;
}

static void arm(struct pipeline_config *c, struct sensor_config *chip)
{
	preset(c, MOTION_ARM);
	chip->lever_arm_b_m.z = -0.6;
}

static void known_arm(struct pipeline_config *c, struct sensor_config *chip)
{
	preset(c, MOTION_ARM);
	c->estimator.lever_arm_b_m = chip->lever_arm_b_m = (struct vec3){0.4, 0.1, -0.3};
}

static void as_in_the_paper(struct pipeline_config *c, struct sensor_config *chip)
{
	lever_arm(c, chip);
	c->estimator.model = LEVER_ARM_SEED_EQ12;
	c->estimator.rates_from = RATES_FROM_ANGLES;
	c->rate_filter.type = FILTER_SEED_FIR;
	c->accel_filter.type = FILTER_SEED_FIR;
	c->fusion.algorithm = FUSION_MADGWICK;
	c->position.mode = POSITION_ZERO_VELOCITY_AT_REST;
	c->position.longest_integration_s = 8;
}

static void mahony(struct pipeline_config *c, struct sensor_config *chip)
{
	lever_arm(c, chip);
	c->fusion.algorithm = FUSION_MAHONY;
	c->position.longest_integration_s = 30;
}

static void mahony_mode_1(struct pipeline_config *c, struct sensor_config *chip)
{
	mahony(c, chip);
	c->position.mode = POSITION_ZERO_VELOCITY_AT_REST;
	c->estimator.model = LEVER_ARM_OFF;
}

static void kalman_mode_1(struct pipeline_config *c, struct sensor_config *chip)
{
	lever_arm(c, chip);
	c->position.mode = POSITION_ZERO_VELOCITY_AT_REST;
}

static void impatient(struct pipeline_config *c, struct sensor_config *chip)
{
	(void)chip;
	c->fusion.kalman.rejection_time_s = 15;
	c->fusion.kalman.heading_sigma_rad = DEG(1);
	c->fusion.kalman.gyro_error = 1e-4;
}

static void warming(struct pipeline_config *c, struct sensor_config *chip)
{
	lever_arm(c, chip);
	c->estimator.model = LEVER_ARM_AUTO;
	chip->warming_K = 15;
	chip->warming_s = 20;
	chip->gyro.temperature_sigma = DEG(0.03);
	chip->jitter_s = 5e-4;
	c->calibration.temperature = (struct temperature_compensation){
		{1e-4, -2e-4, 3e-4}, {1e-6, 2e-6, -1e-6}, {1e-3, -1e-3, 5e-4}, {1e-5, 0, -2e-5}, 25};
	c->calibration.gyro.bias = (struct vec3){0.01, -0.02, 0.005};
	c->calibration.accel.matrix[0][1] = 0.01;
	c->calibration.mag.bias = (struct vec3){1, -2, 3};
}

static void uncalibrated(struct pipeline_config *c, struct sensor_config *chip)
{
	const struct sensor_config as_delivered = *sensor_preset("lsm303dlhc_l3gd20");

	chip->gyro = as_delivered.gyro;
	chip->accel = as_delivered.accel;
	chip->mag = as_delivered.mag;
	c->uncalibrated = PIPELINE_UNCALIBRATED_GYRO | PIPELINE_UNCALIBRATED_ACCEL | PIPELINE_UNCALIBRATED_MAG;
}

static void small_range(struct pipeline_config *c, struct sensor_config *chip)
{
	(void)c;
	chip->accel.range = 2 * STANDARD_GRAVITY_M_S2;
	chip->accel.bandwidth_hz = 0;
}

static void all_band(struct pipeline_config *c, struct sensor_config *chip)
{
	(void)c;
	chip->accel.bandwidth_hz = 0;
}

/* What is a floor or a limit elsewhere decides here. */
static void ideal(struct pipeline_config *c, struct sensor_config *chip)
{
	double rate_hz = chip->rate_hz;

	*chip = *sensor_preset("ideal");
	chip->rate_hz = rate_hz;
	chip->lever_arm_b_m = c->estimator.lever_arm_b_m = (struct vec3){0.05, 0, -0.02};
	c->noise = (struct noise_config){0};
}

static void noisy(struct pipeline_config *c, struct sensor_config *chip)
{
	chip->gyro.density *= 10;
	chip->accel.density *= 10;
	chip->mag.density *= 10;
	c->noise.gyro_density_rad_s_sqrt_hz *= 10;
	c->noise.accel_density_m_s2_sqrt_hz *= 10;
	c->noise.gyro_bias_instability_rad_s *= 10;
	c->noise.accel_bias_instability_m_s2 *= 10;
	c->noise.mag_sigma_uT = 3;
}

/* A magnet in the load that the robot takes and puts down. */
static void magnet_comes_and_goes(struct world *w, double t_s)
{
	w->magnet_b_uT = t_s > 30 && t_s < 60 ? (struct vec3){15, -8, 10} : (struct vec3){0, 0, 0};
}

/* One that stays. */
static void magnet_comes(struct world *w, double t_s)
{
	w->magnet_b_uT = t_s > 60 ? (struct vec3){15, -8, 10} : (struct vec3){0, 0, 0};
}

/* .. and one whose field is as strong as that of no place on Earth nearby. */
static void another_strength(struct world *w, double t_s)
{
	w->iron_n_uT = t_s > 40 ? (struct vec3){6, 3, -15} : (struct vec3){0, 0, 0};
}

/* A hall whose field has the usual length and dip, but another direction. */
static void other_north(struct world *w, double t_s)
{
	w->iron_n_uT = t_s > 40 ? (struct vec3){-20, -20, 0} : (struct vec3){0, 0, 0};
}

/* Iron beams: the field is another one in some places, and at last for good. */
static void iron(struct world *w, double t_s)
{
	w->iron_n_uT = (struct vec3){0, 0, 0};
	if ((t_s > 20 && t_s < 35) || t_s > 120)
		w->iron_n_uT = (struct vec3){12, 6, -4};
	if (t_s > 50 && t_s < 80)
		w->iron_n_uT = (struct vec3){10, -8, 0}; /* another heading, the same length */
}

static void gyro_bias(struct world *w, double t_s)
{
	w->gyro_b_rad_s = t_s < 60 ? (struct vec3){DEG(4), DEG(-3), DEG(2)} : (struct vec3){DEG(4), DEG(-3), DEG(2.6)};
}

static void gaps(struct world *w, double t_s)
{
	const double gap[][2] = {{14, 0.13}, {26, 0.3}, {33, 0.8}, {45, 3}, {57, 0.05}, {70, 12}};

	for (size_t i = 0; i < sizeof gap / sizeof *gap; i++)
		if (is(w, t_s, gap[i][0]))
			w->silent_until_s = gap[i][0] + gap[i][1];
	if (is(w, t_s, 95))
		w->flags = SAMPLE_DISCONTINUITY;
	w->gyro_b_rad_s.x = is(w, t_s, 20) ? NAN : is(w, t_s, 21) ? 2000 : 0;
}

static void aids(struct world *w, double t_s)
{
	struct signal_truth truth = truth_at(w->motion, t_s);
	struct pipeline *p = &w->pipeline;

	if (each(w, t_s, 12, 22, 0.2))
		assert_int_equal(pipeline_aid_velocity(p, (struct vec3){0.4, 0.02, -0.01}, 0.1), 0);
	if (each(w, t_s, 31, 36, 0.5)) /* it stands, says the master */
		assert_int_equal(pipeline_aid_velocity(p, (struct vec3){0, 0, 0}, 0.005), 0);
	if (is(w, t_s, 44)) /* beyond the gate */
		assert_int_equal(pipeline_aid_velocity(p, (struct vec3){3, -2, 0.5}, 0.05), 0);
	if (each(w, t_s, 50, 65, 1))
		assert_int_equal(pipeline_aid_yaw(p, aerospace_from_quat(truth.q_nb).z + DEG(10), DEG(1.5)), 0);
	if (is(w, t_s, 72))
		assert_int_equal(pipeline_reset_attitude(p, quat_from_aerospace((struct vec3){0, 0.02, 1})), 0);
	if (is(w, t_s, 25) || is(w, t_s, 78))
		pipeline_reset_position(p);
	if (is(w, t_s, 84)) /* cannot be corrected by a linear filter */
		assert_int_equal(pipeline_reset_attitude(p, quat_from_aerospace((struct vec3){1.4, 0, 0})), 0);
}

static void reset_while_it_stands(struct world *w, double t_s)
{
	if (is(w, t_s, 54) || is(w, t_s, 74))
		pipeline_reset_position(&w->pipeline);
}

static void yaw_aids(struct world *w, double t_s)
{
	struct signal_truth truth = truth_at(w->motion, t_s);

	if (each(w, t_s, 9, 40, 0.5))
		assert_int_equal(pipeline_aid_yaw(&w->pipeline, aerospace_from_quat(truth.q_nb).z, DEG(1)), 0);
}

static void configurations(struct world *w, double t_s)
{
	struct pipeline_config *c = &w->config;

	if (is(w, t_s, 8))
		c->estimator.lever_arm_b_m = (struct vec3){0.2, -0.1, 0.15};
	else if (is(w, t_s, 16))
		c->accel_filter = (struct filter_config){FILTER_BUTTERWORTH, 5, 8};
	else if (is(w, t_s, 24))
		c->rate_filter = (struct filter_config){FILTER_BUTTERWORTH, 1, 20};
	else if (is(w, t_s, 32))
		preset(c, MOTION_ROBOT_BASE);
	else if (is(w, t_s, 40))
		c->calibration.mounting_rad = (struct vec3){0, DEG(5), DEG(30)};
	else if (is(w, t_s, 48))
		c->fusion.algorithm = FUSION_MAHONY;
	else if (is(w, t_s, 56))
		c->position.mode = POSITION_ZERO_VELOCITY_AT_REST;
	else if (is(w, t_s, 64))
		c->position.mode = POSITION_NAVIGATION, c->fusion.algorithm = FUSION_KALMAN;
	else if (is(w, t_s, 72))
		c->noise.gyro_density_rad_s_sqrt_hz *= 4, c->calibration.gyro.bias.x = 0.01;
	else if (is(w, t_s, 80))
		c->fusion.use_magnetometer = 0, c->estimator.rates_from = RATES_FROM_ANGLES;
	else if (is(w, t_s, 88))
		c->fusion.use_magnetometer = 1, c->position.mode = POSITION_OFF;
	else if (is(w, t_s, 92))
		c->position.mode = POSITION_NAVIGATION, c->uncalibrated = PIPELINE_UNCALIBRATED_GYRO;
	else if (is(w, t_s, 96))
		c->uncalibrated = PIPELINE_UNCALIBRATED_ACCEL, c->fusion.kalman.gyro_scale_sigma = 0;
	else
		return;
	assert_int_equal(pipeline_configure(&w->pipeline, c), 0);
}

static const struct motion MOTIONS[] = {
	{"robot on a square", 120, .signal = "square", .setup = lever_arm},
	{"robot on a square, base", 120, .signal = "square", .setup = base},
	{"robot on a square, rates from angles", 80, .signal = "square", .setup = base_from_angles},
	{"robot that is aided", 90, .signal = "square", .act = aids},
	{"robot that is aided, mode 1", 90, .signal = "square", .setup = as_in_the_paper, .act = aids},
	{"robot that is configured", 104, .each_s = 8, .signal = "square", .act = configurations},
	{"robot with missing samples", 110, .signal = "square", .setup = warming, .act = gaps},
	{"robot that carries a magnet", 90, .signal = "square", .act = magnet_comes_and_goes},
	{"robot as delivered", 120, .rate_hz = 200, .signal = "square", .setup = uncalibrated},
	{"robot with yaw aids alone", 60, .signal = "square", .setup = without_magnetometer, .act = yaw_aids},
	{"stops of some seconds, Kalman, mode 1", 60, .setup = kalman_mode_1,
		.steps = {{X, 8, 4, 1}, {YAW, 18, 3, 1}, {Y, 28, 4, 1}, {X, 40, 8, -2}}},
	{"stops of some seconds, Mahony, mode 1", 60, .setup = mahony_mode_1,
		.steps = {{X, 8, 4, 1}, {YAW, 18, 3, 1}, {Y, 28, 4, 1}, {X, 40, 8, -2}}},
	{"stops of some seconds, as in the paper", 60, .setup = as_in_the_paper,
		.steps = {{X, 8, 4, 1}, {YAW, 18, 3, 1}, {Y, 28, 4, 1}, {X, 40, 12, -2}}},
	{"drive with a long cruise", 130, .cruises = {{X, 10, 90, 3, 0.8}, {Y, 108, 120, 1, 0.3}},
		.steps = {{YAW, 95, 5, 1.5}}},
	{"drive as slow as a drift", 100, .rate_hz = 400, .cruises = {{X, 15, 75, 1, 0.05}},
		.steps = {{YAW, 80, 5, 1}}},
	{"drive on a conveyor", 80, .rate_hz = 200, .cruises = {{Y, 10, 42, 0.5, 0.3}, {Y, 50, 66, 0.5, -0.3}},
		.sines = {{Z, 10, 42, 0.1 / 8000, 14.3, 0}, {X, 10, 42, 0.05 / 20000, 23, 1},
			{Z, 50, 66, 0.1 / 8000, 14.3, 0}}},
	{"slow drive that begins gently", 80, .act = reset_while_it_stands,
		.steps = {{X, 20, 30, 1.2}, {Y, 58, 12, 0.15}}},
	{"drive on a rough road", 80, .setup = base, .steps = {{YAW, 30, 6, -1.2}, {X, 58, 10, -5}},
		.cruises = {{X, 12, 52, 2, 1}},
		.sines = {{Z, 11, 52, 0.4 / 3000, 9, 0}, {Z, 11, 52, 0.5 / 9000, 17, 1}, {X, 11, 52, 0.3 / 5000, 12, 2},
			{PITCH, 11, 52, 0.01, 1.3, 0}, {Z, 57, 69, 0.4 / 6000, 13, 2}}},
	{"iron near a robot", 240, .rate_hz = 50, .act = iron,
		.steps = {{YAW, 8, 6, 2}, {YAW, 40, 8, -3}, {X, 60, 10, 4}, {YAW, 90, 6, 2}, {YAW, 130, 60, 12},
			{YAW, 210, 5, -4}}},
	{"another north", 120, .setup = impatient, .act = other_north,
		.sines = {{YAW, 5, 110, 0.4, 0.05, 0}, {ROLL, 5, 110, 0.1, 0.08, 0}}},
	{"another strength of the field", 120, .setup = impatient, .act = another_strength,
		.sines = {{YAW, 5, 110, 0.4, 0.05, 0}, {ROLL, 5, 110, 0.1, 0.08, 0}}},
	{"a magnet that stays", 140, .signal = "figure", .act = magnet_comes},
	{"a magnet that stays, uncalibrated", 140, .signal = "figure", .setup = uncalibrated, .act = magnet_comes},
	{"a magnet on a turning robot", 140, .act = magnet_comes, .sines = {{YAW, 5, 120, 2.5, 0.05, 0}}},
	{"turntable", 60, .signal = "turntable"},
	{"turntable without magnetometer", 60, .rate_hz = 200, .setup = without_magnetometer,
		.cruises = {{YAW, 8, 28, 1, DEG(17)}, {YAW, 36, 52, 1, -1}}},
	{"turn as slow as a gyro bias", 150, .rate_hz = 50, .cruises = {{YAW, 30, 110, 1, DEG(0.6)}}},
	{"turn that clips the gyro", 50, .setup = clipping_gyro, .steps = {{YAW, 10, 1, 4}, {ROLL, 20, 1.2, 5}}},
	{"lying with a gyro bias", 100, .act = gyro_bias, .steps = {{YAW, 75, 4, 1}, {X, 85, 6, 2}}},
	{"turning with a gyro bias", 100, .act = gyro_bias, .setup = uncalibrated,
		.sines = {{YAW, -2, 55, 0.8, 0.2, 0}, {ROLL, -2, 55, 0.5, 0.31, 1}, {PITCH, 70, 90, 0.4, 0.25, 1}}},
	{"lift", 90, .rate_hz = 200, .cruises = {{Z, 10, 22, 1.5, 1}, {Z, 40, 52, 1.5, -1}}, .steps = {{Z, 70, 6, 2}}},
	{"lift, linear axis", 100, .setup = axis, .start = {[ROLL] = 0.03},
		.cruises = {{Z, 10, 26, 1.5, 1}, {X, 40, 55, 1, -0.5}}, .steps = {{Z, 75, 6, 2}, {YAW, 85, 5, 1}}},
	{"lift, vertical", 110, .setup = vertical_lift, .start = {[PITCH] = 0.02},
		.cruises = {{Z, 10, 32, 2, 2}, {Z, 50, 72, 2, -2}}, .steps = {{Z, 85, 6, 2}},
		.sines = {{X, 11, 31, 0.002, 1.1, 0}}},
	{"lift, vertical, but inclined", 90, .setup = vertical_lift,
		.cruises = {{Z, 10, 30, 2, 1}, {X, 10, 30, 2, 0.3}, {Z, 50, 70, 2, -1}, {X, 50, 70, 2, -0.3}},
		.steps = {{ROLL, 75, 4, 0.3}}},
	{"on foot", 40, .rate_hz = 200, .setup = foot, .stride = {X, 6, 1.1, 1.3}},
	{"on foot, with own times", 40, .setup = foot_with_own_times, .stride = {X, 6, 1.3, 0.9}},
	{"on foot, any motion", 40, .stride = {X, 6, 1.1, 1.2}},
	{"hand held", 60, .rate_hz = 50, .setup = hand,
		.sines = {{X, 6, 30, 0.3, 0.6, 0}, {Z, 6, 30, 0.2, 0.9, 1}, {ROLL, 6, 30, 0.7, 0.5, 0},
			{YAW, 6, 30, 1, 0.3, 0}, {Y, 36, 50, 0.25, 0.8, 0}}},
	{"hand held, but in a train", 60, .setup = hand, .cruises = {{X, 10, 40, 1, 0.6}}},
	{"to and fro, levelled", 70, .setup = levelled,
		.sines = {{X, 6, 50, 0.4, 0.4, 0}, {PITCH, 6, 50, 0.3, 0.3, 0}}},
	{"to and fro, with a prior", 70, .setup = prior,
		.sines = {{X, 6, 50, 0.4, 0.4, 0}, {PITCH, 6, 50, 0.3, 0.3, 0}}},
	{"crane", 110, .rate_hz = 50, .setup = crane, .cruises = {{X, 12, 30, 2, 0.5}, {X, 60, 70, 1, -0.3}},
		.sines = {{PITCH, 12, 48, 0.06, 0.2229, 0}, {PITCH, 60, 95, 0.03, 0.2229, 0}}},
	{"swinging load of a crane that stands", 90, .setup = crane_of_known_rope,
		.sines = {{ROLL, 8, 60, 0.02, 0.22293, 0}}},
	{"arm of unknown length, moving at the start", 60, .setup = arm, .sines = {{PITCH, -2, 40, 0.9, 0.5, 0}}},
	{"arm of known length, moving at the start", 60, .setup = known_arm,
		.sines = {{PITCH, -2, 40, 0.8, 0.9, 0}, {YAW, -2, 40, 0.5, 0.7, 0}}},
	{"tumbling", 60, .signal = "tumble", .setup = lever_arm},
	{"boat, Kalman", 80, .signal = "boat", .setup = lever_arm},
	{"boat, as in the paper", 60, .signal = "boat", .setup = as_in_the_paper},
	{"boat, Mahony", 80, .signal = "boat", .setup = mahony},
	{"step of the roll axis", 40, .rate_hz = 250, .signal = "roll_step", .setup = lever_arm},
	{"on a shaking machine", 70, .rate_hz = 200, .setup = all_band, .sines = {{Z, 10, 40, 5.0 / 43700, 33.3, 0}}},
	{"on a machine that clips", 70, .setup = small_range,
		.sines = {{Z, 10, 40, 25.0 / 43700, 33.3, 0}, {X, 50, 60, 40.0 / 3950, 10, 0}}},
	{"a vibration near the sampling rate", 80, .setup = all_band, .sines = {{Z, 10, 60, 3.0 / 396000, 100.15, 0}}},
	{"shaken from the start", 50, .setup = all_band, .sines = {{Z, -2, 30, 9.0 / 3950, 10, 0}}},
	{"falls at the start", 40, .sines = {{Z, -1, 3, 9.0 / 88.8, 1.5, 0}}, .steps = {{Z, -0.6, 1.6, -5}}},
	{"ideal sensors on a robot", 80, .setup = ideal,
		.steps = {{X, 8, 5, 2}, {YAW, 18, 4, 1.5}, {Y, 30, 20, 1.2}, {YAW, 60, 15, 0.004}}},
	{"ideal sensors, turning slowly", 80, .setup = ideal,
		.cruises = {{YAW, 10, 40, 1, 1e-4}, {YAW, 50, 70, 1, 2e-5}}},
	{"noisy sensors on a robot", 100, .setup = noisy,
		.steps = {{X, 8, 5, 2}, {YAW, 18, 4, 1.5}, {Y, 30, 20, 1.2}, {YAW, 60, 15, 0.3}},
		.cruises = {{X, 80, 95, 1, 0.5}}},
	{"a long rest", 300, .rate_hz = 25, .steps = {{X, 250, 8, 1}}},
};

enum { MOTIONS_COUNT = sizeof MOTIONS / sizeof *MOTIONS };

int main(void)
{
	struct CMUnitTest tests[MOTIONS_COUNT + 1];

	for (int i = 0; i < MOTIONS_COUNT; i++)
		tests[i] = (struct CMUnitTest){MOTIONS[i].name, test_motion, NULL, NULL, (void *)&MOTIONS[i]};
	return trace_run("pipeline", tests, MOTIONS_COUNT);
}
