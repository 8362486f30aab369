#include "gateway/calibration_command.h"

#include "gateway/settings.h"
#include "od_index.h"

enum { TRIAD_VALUES = 12 }; /* bias and matrix, in the order of 2050h:1 to 12 and 2061h:14 to 25 */
static const double ACCELEROMETER_PATIENCE_S = 900, MAGNETOMETER_PATIENCE_S = 180;

static uint8_t percent(double share)
{
	return (uint8_t)(100 * fmax(0, fmin(1, share)));
}

/* ---- result ------------------------------------------------------------------------------------------------------ */

/* Value i of the result, 2061h:14 to 25. */
static float *result(const struct calibration_command *c, int i)
{
	return od_value(c->od, OD_INDEX_CALIBRATION, (uint8_t)(OD_SUB_CALIBRATION_BIAS_X + i), sizeof(float));
}

static void publish_triad(struct calibration_command *c, const struct triad_calibration *t)
{
	const double bias[3] = {t->bias.x, t->bias.y, t->bias.z};

	for (int i = 0; i < TRIAD_VALUES; i++)
		*result(c, i) = (float)(i < 3 ? bias[i] : t->matrix[(i - 3) / 3][i % 3]);
}

static void publish_temperature(struct calibration_command *c, double temperature_degC)
{
	c->values->calibration.temperature =
		isnan(temperature_degC) ? (float)CALIBRATION_NO_TEMPERATURE : (float)temperature_degC;
}

static void clear(void *ctx)
{
	const struct triad_calibration none = {.bias = {0, 0, 0}};
	struct calibration_command *c = ctx;

	c->values->calibration.kind = 0;
	c->values->calibration.verdict = CALIBRATE_COLLECTING;
	c->values->calibration.progress = 0;
	c->values->calibration.positions = c->values->calibration.positions_wanted = 0;
	c->values->calibration.next_side = 0;
	c->values->calibration.quality = 0;
	c->values->calibration.coverage = 0;
	c->values->calibration.field = 0;
	c->values->calibration.gyro_sigma = 0;
	publish_temperature(c, (double)NAN);
	publish_triad(c, &none);
}

/* ---- one function for each kind of calibration ------------------------------------------------------------------- */

static enum calibrate_verdict gyro_sample(struct calibration_command *c, const struct imu_sample *raw)
{
	struct calibrate_gyro *g = &c->gyro;
	const struct calibrate_gyro_result *r = &g->result;
	struct triad_calibration triad;
	enum calibrate_verdict verdict = calibrate_gyro_step(g, raw);

	c->values->calibration.progress = percent(calibrate_gyro_progress(g));
	if (verdict == CALIBRATE_COLLECTING)
		return verdict;
	triad = settings_pipeline(c->values).calibration.gyro; /* its matrix is kept */
	triad.bias = r->bias_rad_s;
	publish_triad(c, &triad);
	publish_temperature(c, r->temperature_degC);
	c->values->calibration.quality = (float)fmax(r->sigma_rad_s.x, fmax(r->sigma_rad_s.y, r->sigma_rad_s.z));
	return verdict;
}

static enum calibrate_verdict accelerometer_sample(struct calibration_command *c, const struct imu_sample *raw)
{
	struct calibrate_accelerometer *a = &c->accelerometer;
	const int before = a->positions;
	enum calibrate_verdict verdict = calibrate_accelerometer_step(a, raw);
	const int wanted = calibrate_accelerometer_wanted(a);

	if (a->positions != before)
		c->values->calibration.next_side = (uint8_t)calibrate_accelerometer_next(a);
	c->values->calibration.positions_wanted = (uint8_t)wanted;

	c->values->calibration.progress =
		verdict == CALIBRATE_COLLECTING ? percent(fmin(0.99, (double)a->positions / wanted)) : 100;
	c->values->calibration.positions = (uint8_t)a->positions;
	c->values->calibration.coverage = percent(a->coverage);
	if (verdict == CALIBRATE_COLLECTING)
		return verdict;
	c->values->calibration.next_side = 0;
	c->values->calibration.quality = (float)a->result.residual_m_s2;
	c->values->calibration.gyro_sigma = a->result.gyro.found ? (float)(100 * a->result.gyro.sigma) : 0;
	publish_triad(c, &a->result.calibration);
	publish_temperature(c, a->result.temperature_degC);
	return verdict;
}

static enum calibrate_verdict magnetometer_sample(struct calibration_command *c, const struct imu_sample *raw)
{
	struct calibrate_magnetometer *m = &c->magnetometer;
	const double before = m->coverage;
	enum calibrate_verdict verdict = calibrate_magnetometer_step(m, raw);

	if (m->coverage != before)
		c->values->calibration.next_side = (uint8_t)calibrate_magnetometer_next(m);
	c->values->calibration.progress = percent(calibrate_magnetometer_progress(m));
	c->values->calibration.coverage = percent(m->coverage);
	if (verdict == CALIBRATE_COLLECTING)
		return verdict;
	c->values->calibration.next_side = 0;
	c->values->calibration.quality = (float)(100 * m->result.residual);
	c->values->calibration.field = (float)m->result.field_uT;
	publish_triad(c, &m->result.calibration);
	return verdict;
}

void calibration_command_sample(struct calibration_command *c, const struct imu_sample *raw)
{
	enum calibrate_verdict verdict = CALIBRATE_COLLECTING;

	if (!command_object_running(&c->command))
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
	if (verdict != CALIBRATE_COLLECTING)
		command_object_end(&c->command, verdict == CALIBRATE_GOOD, (uint8_t)verdict);
}

/* ---- commands ---------------------------------------------------------------------------------------------------- */

static void start_accelerometer(struct calibration_command *c, const struct calibrate_accelerometer_config *config)
{
	calibrate_accelerometer_init(&c->accelerometer, config);
	c->values->calibration.next_side = (uint8_t)calibrate_accelerometer_next(&c->accelerometer);
}

static enum od_status start(void *ctx, uint8_t kind)
{
	struct calibration_command *c = ctx;
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

	gyro.bias_instability_rad_s = config.noise.gyro_bias_instability_rad_s;
	clear(c);
	c->values->calibration.kind = kind;
	if (kind == CALIBRATION_GYRO)
		calibrate_gyro_init(&c->gyro, &gyro);
	else if (kind == CALIBRATION_MAGNETOMETER)
		calibrate_magnetometer_init(&c->magnetometer, &magnetometer);
	else
		start_accelerometer(c, &accelerometer);
	return OD_OK;
}

/* The objects hold the biases at the reference temperature of 2054h, not at the temperature of the measurement. */
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

/* That of a gyro without a bias is not taken: it would pass for a calibrated one, or a module calibrates it. */
static enum od_status accept_gyro_matrix(const struct calibration_command *c)
{
	const struct gyro_turns_result *gyro = &c->accelerometer.result.gyro;
	const struct vec3 bias = settings_pipeline(c->values).calibration.gyro.bias;
	float v[TRIAD_VALUES] = {(float)bias.x, (float)bias.y, (float)bias.z};

	if (!gyro->found || vec3_norm(bias) == 0)
		return OD_OK;
	for (int i = 0; i < 9; i++)
		v[3 + i] = (float)gyro->matrix[i / 3][i % 3];
	return settings_write(c->od, OD_INDEX_GYRO_CALIBRATION, v, TRIAD_VALUES);
}

static enum od_status accept(void *ctx)
{
	const struct calibration_command *c = ctx;
	const uint8_t kind = c->values->calibration.kind;
	const uint16_t index = kind == CALIBRATION_GYRO		  ? OD_INDEX_GYRO_CALIBRATION
			       : kind == CALIBRATION_MAGNETOMETER ? OD_INDEX_MAGNETOMETER_CALIBRATION
								  : OD_INDEX_ACCELEROMETER_CALIBRATION;
	float v[TRIAD_VALUES];

	for (int i = 0; i < TRIAD_VALUES; i++)
		v[i] = *result(c, i);
	to_reference_temperature(c, v);
	enum od_status status = settings_write(c->od, index, v, TRIAD_VALUES);
	return status == OD_OK && index == OD_INDEX_ACCELEROMETER_CALIBRATION ? accept_gyro_matrix(c) : status;
}

/* ---- life -------------------------------------------------------------------------------------------------------- */

void calibration_command_reset(struct calibration_command *c)
{
	command_object_reset(&c->command);
}

void calibration_command_init(
	struct calibration_command *c, struct command_group *group, struct od *od, struct od_values *values)
{
	c->od = od;
	c->values = values;
	c->command = (struct command_object){
		.group = group,
		.index = OD_INDEX_CALIBRATION,
		.starts = CALIBRATION_MAGNETOMETER,
		.accept = CALIBRATION_ACCEPT,
		.discard = CALIBRATION_DISCARD,
		.aborted = CALIBRATE_ABORTED,
		.sensor_lost = CALIBRATE_SENSOR_LOST,
		.state = &values->calibration.state,
		.verdict = &values->calibration.verdict,
		.on_start = start,
		.on_accept = accept,
		.on_clear = clear,
		.ctx = c,
	};
	command_object_attach(&c->command, od);
	calibration_command_reset(c);
}
