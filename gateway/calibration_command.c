#include "gateway/calibration_command.h"

#include "gateway/lever_arm_command.h"
#include "gateway/settings.h"
#include "gateway/status.h"
#include "od_index.h"

enum { TRIAD_VALUES = 12 }; /* bias and matrix, in the order of 2050h:1 to 12 and 2061h:14 to 25 */
enum { FOUND_FIRST = 14 };
static const double ACCELEROMETER_PATIENCE_S = 900, MAGNETOMETER_PATIENCE_S = 180;

static enum calibration_command_state state_of(const struct calibration_command *c)
{
	return (enum calibration_command_state)c->values->calibration.state;
}

static void enter(struct calibration_command *c, enum calibration_command_state state)
{
	c->values->calibration.state = (uint8_t)state;
}

static uint8_t percent(double share)
{
	return (uint8_t)(100 * fmax(0, fmin(1, share)));
}

/* ---- what it found ----------------------------------------------------------------------------------------------- */

/* Value i of the triad, 2061h:14 to 25. */
static float *found(const struct calibration_command *c, int i)
{
	return od_value(c->od, OD_INDEX_CALIBRATION, (uint8_t)(FOUND_FIRST + i), sizeof(float));
}

static void publish_triad(struct calibration_command *c, const struct triad_calibration *t)
{
	const double bias[3] = {t->bias.x, t->bias.y, t->bias.z};

	for (int i = 0; i < TRIAD_VALUES; i++)
		*found(c, i) = (float)(i < 3 ? bias[i] : t->matrix[(i - 3) / 3][i % 3]);
}

static void publish_temperature(struct calibration_command *c, double temperature_degC)
{
	c->values->calibration.temperature =
		isnan(temperature_degC) ? (float)CALIBRATION_NO_TEMPERATURE : (float)temperature_degC;
}

static void forget(struct calibration_command *c)
{
	const struct triad_calibration none = {.bias = {0, 0, 0}};

	enter(c, CALIBRATION_IDLE);
	c->values->calibration.kind = 0;
	c->values->calibration.verdict = CALIBRATE_COLLECTING;
	c->values->calibration.progress = 0;
	c->values->calibration.positions = c->values->calibration.positions_wanted = 0;
	c->values->calibration.next_side = 0;
	c->values->calibration.quality = 0;
	c->values->calibration.coverage = 0;
	c->values->calibration.field = 0;
	publish_temperature(c, (double)NAN);
	publish_triad(c, &none);
}

static void refuse(struct calibration_command *c, enum calibrate_verdict why)
{
	c->values->calibration.verdict = (uint8_t)why;
	enter(c, CALIBRATION_REFUSED);
}

/* ---- one function a kind, each a sample -------------------------------------------------------------------------- */

static enum calibrate_verdict gyro_sample(struct calibration_command *c, const struct imu_sample *raw)
{
	struct calibrate_gyro *g = &c->gyro;
	const struct calibrate_gyro_result *r = &g->result;
	struct triad_calibration triad;
	enum calibrate_verdict verdict = calibrate_gyro_step(g, raw);

	c->values->calibration.progress = percent(calibrate_gyro_progress(g));
	if (verdict == CALIBRATE_COLLECTING)
		return verdict;
	triad = settings_pipeline(c->values).calibration.gyro; /* the matrix stays */
	triad.bias = r->bias_rad_s;
	publish_triad(c, &triad);
	publish_temperature(c, r->temperature_degC);
	c->values->calibration.quality = (float)fmax(r->sigma_rad_s.x, fmax(r->sigma_rad_s.y, r->sigma_rad_s.z));
	return verdict;
}

static enum calibrate_verdict accelerometer_sample(struct calibration_command *c, const struct imu_sample *raw)
{
	struct calibrate_accelerometer *a = &c->accelerometer;
	const int before = a->positions, wanted = c->values->calibration.positions_wanted;
	enum calibrate_verdict verdict = calibrate_accelerometer_step(a, raw);

	if (a->positions != before)
		c->values->calibration.next_side = (uint8_t)calibrate_accelerometer_next(a);

	c->values->calibration.progress =
		verdict == CALIBRATE_COLLECTING ? percent(fmin(0.99, (double)a->positions / wanted)) : 100;
	c->values->calibration.positions = (uint8_t)a->positions;
	c->values->calibration.coverage = percent(a->coverage);
	if (verdict == CALIBRATE_COLLECTING)
		return verdict;
	c->values->calibration.next_side = 0;
	c->values->calibration.quality = (float)a->result.residual_m_s2;
	publish_triad(c, &a->result.calibration);
	publish_temperature(c, a->result.temperature_degC);
	return verdict;
}

static enum calibrate_verdict magnetometer_sample(struct calibration_command *c, const struct imu_sample *raw)
{
	struct calibrate_magnetometer *m = &c->magnetometer;
	enum calibrate_verdict verdict = calibrate_magnetometer_step(m, raw);

	c->values->calibration.progress = percent(calibrate_magnetometer_progress(m));
	c->values->calibration.coverage = percent(m->coverage);
	if (verdict == CALIBRATE_COLLECTING)
		return verdict;
	c->values->calibration.quality = (float)(100 * m->result.residual);
	c->values->calibration.field = (float)m->result.field_uT;
	publish_triad(c, &m->result.calibration);
	return verdict;
}

void calibration_command_sample(struct calibration_command *c, const struct imu_sample *raw)
{
	enum calibrate_verdict verdict = CALIBRATE_COLLECTING;

	c->sensor_lost = false;
	if (state_of(c) != CALIBRATION_RUNNING)
		return;
	switch (c->values->calibration.kind) {
	case CALIBRATION_GYRO:
		verdict = gyro_sample(c, raw);
		break;
	case CALIBRATION_SIX_FACES:
	case CALIBRATION_FREE:
		verdict = accelerometer_sample(c, raw);
		break;
	case CALIBRATION_MAGNETOMETER:
		verdict = magnetometer_sample(c, raw);
		break;
	}
	c->values->calibration.verdict = (uint8_t)verdict;
	if (verdict != CALIBRATE_COLLECTING)
		enter(c, verdict == CALIBRATE_GOOD ? CALIBRATION_DONE : CALIBRATION_REFUSED);
}

/* ---- commands ---------------------------------------------------------------------------------------------------- */

static void start_accelerometer(struct calibration_command *c, const struct calibrate_accelerometer_config *config)
{
	calibrate_accelerometer_init(&c->accelerometer, config);
	c->values->calibration.positions_wanted = (uint8_t)calibrate_accelerometer_wanted(&c->accelerometer);
	c->values->calibration.next_side = (uint8_t)calibrate_accelerometer_next(&c->accelerometer);
}

static enum od_status start(struct calibration_command *c, uint8_t kind)
{
	const struct pipeline_config config = settings_pipeline(c->values);
	struct calibrate_gyro_config gyro = CALIBRATE_GYRO_DEFAULTS;
	const struct calibrate_accelerometer_config accelerometer = {
		.positions = kind == CALIBRATION_SIX_FACES ? CALIBRATE_SIX_FACES : CALIBRATE_FREE,
		.gravity_m_s2 = config.estimator.gravity_m_s2,
		.bias_instability_m_s2 = config.noise.accel_bias_instability_m_s2,
		.patience_s = ACCELEROMETER_PATIENCE_S,
	};
	const struct calibrate_magnetometer_config magnetometer = {
		.field_uT = (double)c->values->calibration.field_strength,
		.patience_s = MAGNETOMETER_PATIENCE_S,
	};

	if (c->sensor_lost || state_of(c) == CALIBRATION_RUNNING ||
		c->values->lever_arm_identification.state == LEVER_RUNNING)
		return OD_DEVICE_STATE;
	gyro.bias_instability_rad_s = config.noise.gyro_bias_instability_rad_s;
	forget(c);
	c->values->calibration.kind = kind;
	if (kind == CALIBRATION_GYRO)
		calibrate_gyro_init(&c->gyro, &gyro);
	else if (kind == CALIBRATION_MAGNETOMETER)
		calibrate_magnetometer_init(&c->magnetometer, &magnetometer);
	else
		start_accelerometer(c, &accelerometer);
	enter(c, CALIBRATION_RUNNING);
	return OD_CONSUMED;
}

/* With 2054h the biases of the objects are those at its reference temperature, not at that of the measurement. */
static void to_reference_temperature(const struct calibration_command *c, float v[TRIAD_VALUES])
{
	const struct temperature_compensation t = settings_pipeline(c->values).calibration.temperature;
	const double at_degC = (double)c->values->calibration.temperature;
	struct vec3 shift;

	if (c->values->calibration.kind == CALIBRATION_MAGNETOMETER || !(at_degC > CALIBRATION_NO_TEMPERATURE))
		return;
	shift = c->values->calibration.kind == CALIBRATION_GYRO ? calibration_gyro_shift(&t, at_degC)
								: calibration_accel_shift(&t, at_degC);
	v[0] -= (float)shift.x;
	v[1] -= (float)shift.y;
	v[2] -= (float)shift.z;
}

static enum od_status accept(struct calibration_command *c)
{
	const uint8_t kind = c->values->calibration.kind;
	const uint16_t index = kind == CALIBRATION_GYRO		  ? OD_INDEX_GYRO_CALIBRATION
			       : kind == CALIBRATION_MAGNETOMETER ? OD_INDEX_MAGNETOMETER_CALIBRATION
								  : OD_INDEX_ACCELEROMETER_CALIBRATION;
	enum od_status status;
	float v[TRIAD_VALUES];

	if (state_of(c) != CALIBRATION_DONE)
		return OD_DEVICE_STATE;
	for (int i = 0; i < TRIAD_VALUES; i++)
		v[i] = *found(c, i);
	to_reference_temperature(c, v);
	status = settings_write(c->od, index, v, TRIAD_VALUES);
	if (status != OD_OK)
		return status;
	enter(c, CALIBRATION_IDLE);
	return OD_CONSUMED;
}

static enum od_status on_command(void *ctx, const struct od_entry *entry, const void *wire, size_t size)
{
	struct calibration_command *c = ctx;
	uint8_t command;

	if (entry->sub != 1 || size != 1)
		return OD_OK;
	command = *(const uint8_t *)wire;
	switch (command) {
	case CALIBRATION_ABORT:
		if (state_of(c) != CALIBRATION_RUNNING)
			return OD_CONSUMED;
		forget(c);
		c->values->calibration.verdict = CALIBRATE_ABORTED;
		return OD_CONSUMED;
	case CALIBRATION_GYRO:
	case CALIBRATION_SIX_FACES:
	case CALIBRATION_FREE:
	case CALIBRATION_MAGNETOMETER:
		return start(c, command);
	case CALIBRATION_ACCEPT:
		return accept(c);
	case CALIBRATION_DISCARD:
		if (state_of(c) != CALIBRATION_DONE && state_of(c) != CALIBRATION_REFUSED)
			return OD_DEVICE_STATE;
		forget(c);
		return OD_CONSUMED;
	}
	return OD_BAD_VALUE;
}

void calibration_command_sensor_lost(struct calibration_command *c)
{
	c->sensor_lost = true;
	if (state_of(c) == CALIBRATION_RUNNING)
		refuse(c, CALIBRATE_SENSOR_LOST);
}

unsigned calibration_command_status(const struct calibration_command *c)
{
	return state_of(c) == CALIBRATION_RUNNING ? STATUS_COMMISSIONING : 0;
}

/* ---- life -------------------------------------------------------------------------------------------------------- */

void calibration_command_reset(struct calibration_command *c)
{
	forget(c);
}

void calibration_command_init(struct calibration_command *c, struct od *od, struct od_values *values)
{
	c->od = od;
	c->values = values;
	c->hook = (struct od_hook){
		.first = OD_INDEX_CALIBRATION, .last = OD_INDEX_CALIBRATION, .before = on_command, .ctx = c};
	od_attach(od, &c->hook);
	forget(c);
}
