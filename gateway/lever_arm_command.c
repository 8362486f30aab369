#include "gateway/lever_arm_command.h"

#include "gateway/calibration_command.h"
#include "gateway/settings.h"
#include "gateway/status.h"
#include "od_index.h"

/* 2060h:1 */
enum {
	COMMAND_ABORT = 0,
	COMMAND_START_HELD = 1,
	COMMAND_START_REFERENCE = 2,
	COMMAND_ACCEPT = 3,
	COMMAND_DISCARD = 4,
};

enum { REFERENCE_HOLDS_US = 50000 };
/* Motion that stops and starts, or a reference that does not come, ends it after so many times its duration. */
enum { PATIENCE = 3 };

#define REFERENCE16_M_S2 0.005 /* one step of 2075h:4 to 6, as in the EDS */

static enum lever_state state_of(const struct lever_arm_command *c)
{
	return (enum lever_state)c->values->lever_arm_identification.state;
}

static void enter(struct lever_arm_command *c, enum lever_state state)
{
	c->values->lever_arm_identification.state = (uint8_t)state;
}

/* ---- what it found ----------------------------------------------------------------------------------------------- */

static void publish(struct lever_arm_command *c, const struct lever_estimate *e)
{
	c->arm_b_m = e->lever_arm_b_m;
	c->values->lever_arm_identification.verdict = (uint8_t)e->verdict;
	c->values->lever_arm_identification.progress = (uint8_t)e->progress_percent;
	c->values->lever_arm_identification.l = (float)e->lever_arm_b_m.x;
	c->values->lever_arm_identification.s = (float)e->lever_arm_b_m.y;
	c->values->lever_arm_identification.t = (float)e->lever_arm_b_m.z;
	c->values->lever_arm_identification.sigma_l = (float)e->sigma_b_m.x;
	c->values->lever_arm_identification.sigma_s = (float)e->sigma_b_m.y;
	c->values->lever_arm_identification.sigma_t = (float)e->sigma_b_m.z;
	c->values->lever_arm_identification.residual = (float)e->residual_m_s2;
	c->values->lever_arm_identification.delay = (float)e->delay_s;
}

static void forget(struct lever_arm_command *c)
{
	const struct lever_estimate nothing = {0};

	publish(c, &nothing);
	enter(c, LEVER_IDLE);
}

/* ---- commands ---------------------------------------------------------------------------------------------------- */

static enum od_status start(struct lever_arm_command *c, bool reference)
{
	const struct lever_identification_config config = {
		.rate_hz = c->pipeline->rate_hz,
		.duration_s = (double)c->values->lever_arm_identification.duration,
		.reference = reference,
	};

	if (c->sensor_lost || state_of(c) == LEVER_RUNNING || c->values->calibration.state == CALIBRATION_RUNNING ||
		lever_identification_init(&c->lever, &config) < 0)
		return OD_DEVICE_STATE;
	forget(c);
	c->started = true;
	enter(c, LEVER_RUNNING);
	return OD_CONSUMED;
}

static enum od_status accept(struct lever_arm_command *c)
{
	const float arm[] = {(float)c->arm_b_m.x, (float)c->arm_b_m.y, (float)c->arm_b_m.z};
	enum od_status status;

	if (state_of(c) != LEVER_DONE)
		return OD_DEVICE_STATE;
	status = settings_write(c->od, OD_INDEX_LEVER_ARM, arm, 3);
	if (status != OD_OK)
		return status;
	enter(c, LEVER_IDLE);
	return OD_CONSUMED;
}

static enum od_status on_lever_command(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	struct lever_arm_command *c = ctx;

	if (entry->sub != 1 || size != 1)
		return OD_OK;
	switch (*(const uint8_t *)wire) {
	case COMMAND_START_HELD:
		return start(c, false);
	case COMMAND_START_REFERENCE:
		return start(c, true);
	case COMMAND_ACCEPT:
		return accept(c);
	case COMMAND_DISCARD:
		if (state_of(c) != LEVER_DONE && state_of(c) != LEVER_REFUSED)
			return OD_DEVICE_STATE;
		forget(c);
		return OD_CONSUMED;
	case COMMAND_ABORT:
		if (state_of(c) == LEVER_RUNNING)
			forget(c);
		return OD_CONSUMED;
	}
	return OD_BAD_VALUE;
}

/* ---- acceleration of the reference point from outside ------------------------------------------------------------ */

/* It is complete when its last component is written: the transversal one, REAL32 or 16 bits. */
static void on_reference(void *ctx, const struct od_entry *entry)
{
	struct lever_arm_command *c = ctx;
	const struct od_values *v = c->values;

	if (entry->sub == 3)
		c->ref_b_m_s2 = (struct vec3){(double)v->reference_acceleration.l, (double)v->reference_acceleration.s,
			(double)v->reference_acceleration.t};
	else if (entry->sub == 6)
		c->ref_b_m_s2 = vec3_scale(
			REFERENCE16_M_S2, (struct vec3){v->reference_acceleration.l16, v->reference_acceleration.s16,
						  v->reference_acceleration.t16});
	else
		return;
	c->ref_written = true;
}

static const struct vec3 *reference_of(struct lever_arm_command *c, const struct imu_sample *sample, uint64_t now_us)
{
	if (c->ref_written)
		c->ref_until_us = now_us + REFERENCE_HOLDS_US;
	c->ref_written = false;
	if (sample->flags & SAMPLE_REFERENCE)
		return &sample->ref_accel_b_m_s2;
	if (now_us >= c->ref_until_us)
		return NULL;
	c->lever.config.estimate_delay = true;
	return &c->ref_b_m_s2;
}

/* ---- samples ----------------------------------------------------------------------------------------------------- */

static void look(struct lever_arm_command *c, bool late)
{
	const struct lever_estimate e = lever_identification_estimate(&c->lever);

	publish(c, &e);
	if (e.progress_percent == 100 || late)
		enter(c, e.verdict == LEVER_FOUND ? LEVER_DONE : LEVER_REFUSED);
}

void lever_arm_command_sample(struct lever_arm_command *c, const struct imu_sample *sample, uint64_t now_us)
{
	const struct vec3 *ref_b_m_s2 = reference_of(c, sample, now_us);
	struct imu_sample s;

	c->sensor_lost = false;
	if (state_of(c) != LEVER_RUNNING)
		return;
	if (c->started)
		c->started_us = now_us;
	c->started = false;
	s = calibration_apply(&c->pipeline->calibration, sample);
	if (s.flags & (SAMPLE_SATURATED | SAMPLE_DISCONTINUITY))
		lever_identification_break(&c->lever);
	else
		lever_identification_step(
			&c->lever, s.t_us, fusion_rate_b(&c->pipeline->fusion, s.gyro_rad_s), s.accel_m_s2, ref_b_m_s2);

	const bool late = (double)(now_us - c->started_us) > PATIENCE * 1e6 * c->lever.config.duration_s;
	if (late || lever_identification_news(&c->lever))
		look(c, late);
}

void lever_arm_command_sensor_lost(struct lever_arm_command *c)
{
	c->sensor_lost = true;
	if (state_of(c) != LEVER_RUNNING)
		return;
	c->values->lever_arm_identification.verdict = LEVER_SENSOR_LOST;
	enter(c, LEVER_REFUSED);
}

unsigned lever_arm_command_status(const struct lever_arm_command *c)
{
	return state_of(c) == LEVER_RUNNING ? STATUS_COMMISSIONING : 0;
}

/* ---- life -------------------------------------------------------------------------------------------------------- */

void lever_arm_command_reset(struct lever_arm_command *c)
{
	forget(c);
	c->ref_written = false;
	c->ref_until_us = 0;
}

void lever_arm_command_init(
	struct lever_arm_command *c, struct od *od, struct od_values *values, const struct pipeline *pipeline)
{
	c->od = od;
	c->values = values;
	c->pipeline = pipeline;
	c->lever_hook = (struct od_hook){.first = OD_INDEX_LEVER_ARM_IDENTIFICATION,
		.last = OD_INDEX_LEVER_ARM_IDENTIFICATION,
		.before = on_lever_command,
		.ctx = c};
	c->reference_hook = (struct od_hook){.first = OD_INDEX_REFERENCE_ACCELERATION,
		.last = OD_INDEX_REFERENCE_ACCELERATION,
		.after = on_reference,
		.ctx = c};
	od_attach(od, &c->lever_hook);
	od_attach(od, &c->reference_hook);
	lever_arm_command_reset(c);
}
