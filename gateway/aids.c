#include "gateway/aids.h"

#include <math.h>

#include "gateway/publish.h"
#include "gateway/status.h"
#include "model/math/rotation.h"
#include "od_index.h"
#include "model/math/units.h"

/* bits of 2073h */
enum { COMMAND_RESET_POSITION = 1 << 0, COMMAND_STANDSTILL = 1 << 1, COMMAND_ZERO_SLOPES = 1 << 2 };

enum { USED_FOR_US = 1000000, STANDSTILL_FOR_US = 500000 };

#define VELOCITY_SIGMA_MIN_M_S 0.001
#define YAW_SIGMA_MIN_DEG      0.01
#define STANDSTILL_SIGMA_M_S   0.005

/* ---- the same value as REAL32 and in 16 bits --------------------------------------------------------------------- */

int16_t aids_to_16(float value, double step)
{
	return (int16_t)fmax(INT16_MIN, fmin(INT16_MAX, round((double)value / step)));
}

static double step_of(const struct aids *a, uint16_t index, uint8_t sub)
{
	return od_step(a->od, od_find(a->od->table, index, sub, NULL));
}

/* The value that was written is copied to its twin. Velocities: sub-indices 1 to 4 REAL32, 5 to 8 their twins. */
static void follow_velocity(struct aids *a, uint8_t sub)
{
	const double step_m_s = step_of(a, OD_INDEX_VELOCITY_AID, OD_SUB_VELOCITY_AID_X16);
	struct od_values *v = a->values;
	float *real[] = {&v->velocity_aid.x, &v->velocity_aid.y, &v->velocity_aid.z};
	int16_t *twin[] = {&v->velocity_aid.x16, &v->velocity_aid.y16, &v->velocity_aid.z16};

	if (sub >= 1 && sub <= 3)
		*twin[sub - 1] = aids_to_16(*real[sub - 1], step_m_s);
	else if (sub >= 5 && sub <= 7)
		*real[sub - 5] = (float)(*twin[sub - 5] * step_m_s);
	else if (sub == 4)
		v->velocity_aid.sigma16 = (uint16_t)fmin(UINT16_MAX, round((double)v->velocity_aid.sigma / step_m_s));
	else if (sub == 8)
		v->velocity_aid.sigma = (float)(v->velocity_aid.sigma16 * step_m_s);
}

static void follow_attitude(struct aids *a, uint8_t sub)
{
	const double step_deg = step_of(a, OD_INDEX_ATTITUDE_RESET, OD_SUB_ATTITUDE_RESET_ROLL16);
	struct od_values *v = a->values;
	float *real[] = {&v->attitude_reset.roll, &v->attitude_reset.pitch, &v->attitude_reset.yaw};
	int16_t *twin[] = {&v->attitude_reset.roll16, &v->attitude_reset.pitch16, &v->attitude_reset.yaw16};

	if (sub >= 1 && sub <= 3)
		*twin[sub - 1] = aids_to_16(*real[sub - 1], step_deg);
	else if (sub >= 4 && sub <= 6)
		*real[sub - 4] = (float)(*twin[sub - 4] * step_deg);
}

/* ---- to the pipeline --------------------------------------------------------------------------------------------- */

static bool has_attitude(const struct aids *a)
{
	return a->values->sample.status & PIPELINE_VALID;
}

static void aid_velocity(struct aids *a)
{
	const struct od_values *v = a->values;
	struct vec3 velocity_m_s = {(double)v->velocity_aid.x, (double)v->velocity_aid.y, (double)v->velocity_aid.z};
	const struct quat q_nb = {
		(double)v->quaternion.w, (double)v->quaternion.x, (double)v->quaternion.y, (double)v->quaternion.z};

	if (v->velocity_aid.sigma <= 0 || !has_attitude(a))
		return;
	if (v->velocity_aid.frame == 1)
		velocity_m_s = quat_rotate(q_nb, velocity_m_s);
	if (pipeline_aid_velocity(
		    a->pipeline, velocity_m_s, fmax((double)v->velocity_aid.sigma, VELOCITY_SIGMA_MIN_M_S)) == 0)
		a->aided = true;
}

static void aid_yaw(struct aids *a)
{
	const struct od_values *v = a->values;
	double sigma_deg = fmax((double)v->yaw_aid.sigma, YAW_SIGMA_MIN_DEG);

	if (v->yaw_aid.sigma <= 0 || !has_attitude(a))
		return;
	if (pipeline_aid_yaw(a->pipeline, (double)v->yaw_aid.yaw * RAD_PER_DEG, sigma_deg * RAD_PER_DEG) == 0)
		a->aided = true;
}

static void reset_attitude(struct aids *a)
{
	const struct od_values *v = a->values;
	const struct vec3 angles_deg = {
		(double)v->attitude_reset.roll, (double)v->attitude_reset.pitch, (double)v->attitude_reset.yaw};

	pipeline_reset_attitude(a->pipeline, quat_from_aerospace(vec3_scale(RAD_PER_DEG, angles_deg)));
}

static void zero_slopes(struct aids *a)
{
	struct od_values *v = a->values;
	static const uint16_t presets[] = {OD_INDEX_SLOPE_LONG16_PRESET_VALUE, OD_INDEX_SLOPE_LATERAL16_PRESET_VALUE,
		OD_INDEX_SLOPE_LONG32_PRESET_VALUE, OD_INDEX_SLOPE_LATERAL32_PRESET_VALUE};

	v->slope_long16_preset_value = v->slope_lateral16_preset_value = 0;
	v->slope_long32_preset_value = v->slope_lateral32_preset_value = 0;
	for (size_t i = 0; i < sizeof(presets) / sizeof(presets[0]); i++)
		publish_preset(a->od, presets[i]);
}

static void command(struct aids *a)
{
	uint16_t rising = a->values->commands & (uint16_t)~a->commands;

	a->commands = a->values->commands;
	if (rising & COMMAND_RESET_POSITION)
		pipeline_reset_position(a->pipeline);
	if (rising & COMMAND_ZERO_SLOPES)
		zero_slopes(a);
	a->standstill = a->commands & COMMAND_STANDSTILL;
	if (!a->standstill)
		a->standstill_until_us = 0;
}

static void after_write(void *ctx, const struct od_entry *entry)
{
	struct aids *a = ctx;

	switch (entry->index) {
	case OD_INDEX_VELOCITY_AID:
		follow_velocity(a, entry->sub);
		if (entry->sub == 4 || entry->sub == 8)
			aid_velocity(a);
		break;
	case OD_INDEX_YAW_AID:
		if (entry->sub == 2)
			aid_yaw(a);
		break;
	case OD_INDEX_ATTITUDE_RESET:
		follow_attitude(a, entry->sub);
		if (entry->sub != 7)
			break;
		if (a->values->attitude_reset.command && !a->reset_command)
			reset_attitude(a);
		a->reset_command = a->values->attitude_reset.command;
		break;
	case OD_INDEX_COMMANDS:
		command(a);
		break;
	}
}

void aids_init(struct aids *a, struct od *od, struct od_values *values, struct pipeline *pipeline)
{
	*a = (struct aids){.od = od, .values = values, .pipeline = pipeline};
	a->hook = (struct od_hook){
		.first = OD_INDEX_VELOCITY_AID, .last = OD_INDEX_COMMANDS, .after = after_write, .ctx = a};
	od_attach(od, &a->hook);
}

void aids_reset(struct aids *a)
{
	struct od_values *v = a->values;

	v->velocity_aid.x = v->velocity_aid.y = v->velocity_aid.z = v->velocity_aid.sigma = 0;
	v->velocity_aid.x16 = v->velocity_aid.y16 = v->velocity_aid.z16 = 0;
	v->velocity_aid.sigma16 = 0;
	v->yaw_aid.yaw = v->yaw_aid.sigma = 0;
	v->attitude_reset.roll = v->attitude_reset.pitch = v->attitude_reset.yaw = 0;
	v->attitude_reset.roll16 = v->attitude_reset.pitch16 = v->attitude_reset.yaw16 = 0;
	v->attitude_reset.command = a->reset_command = 0;
	v->reference_acceleration.l = v->reference_acceleration.s = v->reference_acceleration.t = 0;
	v->reference_acceleration.l16 = v->reference_acceleration.s16 = v->reference_acceleration.t16 = 0;
	v->commands = a->commands = 0;
	a->aided = a->standstill = false;
	a->used_until_us = a->standstill_until_us = 0;
}

void aids_step(struct aids *a, uint64_t now_us)
{
	if (a->standstill)
		a->standstill_until_us = now_us + STANDSTILL_FOR_US;
	a->standstill = false;
	if (now_us < a->standstill_until_us && has_attitude(a) &&
		pipeline_aid_velocity(a->pipeline, (struct vec3){0}, STANDSTILL_SIGMA_M_S) == 0)
		a->aided = true;
	if (a->aided)
		a->used_until_us = now_us + USED_FOR_US;
	a->aided = false;
}

unsigned aids_status(const struct aids *a, uint64_t now_us)
{
	return now_us < a->used_until_us ? STATUS_EXTERNAL_AID : 0;
}
