#include "gateway/lever_arm_command.h"

#include "gateway/aids.h"
#include "gateway/settings.h"
#include "od_index.h"

/* 2060h:1 */
enum { COMMAND_START_HELD = 1, COMMAND_START_REFERENCE = 2, COMMAND_ACCEPT = 3, COMMAND_DISCARD = 4 };

enum { REFERENCE_HOLDS_US = 50000 };
/* Timeout, in multiples of the duration: the motion has pauses, or the reference is missing. */
enum { TIMEOUT = 3 };

/* ---- result ------------------------------------------------------------------------------------------------------ */

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

static void clear(void *ctx)
{
	const struct lever_estimate nothing = {0};

	publish(ctx, &nothing);
}

/* ---- commands ---------------------------------------------------------------------------------------------------- */

static enum od_status start(void *ctx, uint8_t command)
{
	struct lever_arm_command *c = ctx;
	const struct lever_identification_config config = {
		.rate_hz = c->pipeline->rate_hz,
		.duration_s = (double)c->values->lever_arm_identification.duration,
		.reference = command == COMMAND_START_REFERENCE,
	};

	if (lever_identification_init(&c->lever, &config) < 0)
		return OD_DEVICE_STATE;
	clear(c);
	c->started = true;
	return OD_OK;
}

static enum od_status accept(void *ctx)
{
	struct lever_arm_command *c = ctx;
	const float arm[] = {(float)c->arm_b_m.x, (float)c->arm_b_m.y, (float)c->arm_b_m.z};

	return settings_write(c->od, OD_INDEX_LEVER_ARM, arm, 3);
}

/* ---- acceleration of the reference point ------------------------------------------------------------------------- */

/* The value that was written is copied to its twin: sub-indices 1 to 3 REAL32, 4 to 6 in 16 bits. The write of the last
 * component, the transversal one, completes it. */
static void on_reference(void *ctx, const struct od_entry *entry)
{
	struct lever_arm_command *c = ctx;
	struct od_values *v = c->values;
	float *real[] = {&v->reference_acceleration.l, &v->reference_acceleration.s, &v->reference_acceleration.t};
	int16_t *twin[] = {
		&v->reference_acceleration.l16, &v->reference_acceleration.s16, &v->reference_acceleration.t16};
	const struct od_entry *steps =
		od_find(c->od->table, OD_INDEX_REFERENCE_ACCELERATION, OD_SUB_REFERENCE_ACCELERATION_L16, NULL);

	if (entry->sub <= 3)
		*twin[entry->sub - 1] = aids_to_16(*real[entry->sub - 1], steps->factor);
	else
		*real[entry->sub - 4] = (float)(*twin[entry->sub - 4] * steps->factor);
	if (entry->sub == 3)
		c->ref_b_m_s2 = (struct vec3){(double)*real[0], (double)*real[1], (double)*real[2]};
	else if (entry->sub == 6)
		c->ref_b_m_s2 = vec3_scale(steps->factor, (struct vec3){*twin[0], *twin[1], *twin[2]});
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

static void publish_estimate(struct lever_arm_command *c, bool late)
{
	const struct lever_estimate e = lever_identification_estimate(&c->lever);

	publish(c, &e);
	if (e.progress_percent == 100 || late)
		command_object_end(&c->command, e.verdict == LEVER_FOUND, (uint8_t)e.verdict);
}

void lever_arm_command_sample(struct lever_arm_command *c, const struct imu_sample *sample, uint64_t now_us)
{
	const struct vec3 *ref_b_m_s2 = reference_of(c, sample, now_us);
	struct imu_sample s;

	if (!command_object_running(&c->command))
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

	const bool late = (double)(now_us - c->started_us) > TIMEOUT * 1e6 * c->lever.config.duration_s;
	if (late || lever_identification_news(&c->lever))
		publish_estimate(c, late);
}

/* ---- life -------------------------------------------------------------------------------------------------------- */

void lever_arm_command_reset(struct lever_arm_command *c)
{
	command_object_reset(&c->command);
	c->ref_written = false;
	c->ref_until_us = 0;
}

void lever_arm_command_init(struct lever_arm_command *c, struct command_group *group, struct od *od,
	struct od_values *values, const struct pipeline *pipeline)
{
	c->od = od;
	c->values = values;
	c->pipeline = pipeline;
	c->command = (struct command_object){
		.group = group,
		.index = OD_INDEX_LEVER_ARM_IDENTIFICATION,
		.starts = COMMAND_START_REFERENCE,
		.accept = COMMAND_ACCEPT,
		.discard = COMMAND_DISCARD,
		.sensor_lost = LEVER_SENSOR_LOST,
		.state = &values->lever_arm_identification.state,
		.verdict = &values->lever_arm_identification.verdict,
		.on_start = start,
		.on_accept = accept,
		.on_clear = clear,
		.ctx = c,
	};
	c->reference_hook = (struct od_hook){.first = OD_INDEX_REFERENCE_ACCELERATION,
		.last = OD_INDEX_REFERENCE_ACCELERATION,
		.after = on_reference,
		.ctx = c};
	command_object_attach(&c->command, od);
	od_attach(od, &c->reference_hook);
	lever_arm_command_reset(c);
}
