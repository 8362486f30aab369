#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "drivers/imu/imu_log.h"
#include "model/identify/calibrate_accelerometer.h"
#include "model/identify/calibrate_gyro.h"
#include "model/identify/calibrate_magnetometer.h"
#include "model/identify/calibrate_temperature.h"
#include "tools/calibrate/calibrate_sensor.h"
#include "tools/lib/cli.h"
#include "model/math/units.h"

/* ---- reading ----------------------------------------------------------------------------------------------------- */

static void for_each_sample(const char *path, void (*take)(void *ctx, const struct imu_sample *sample), void *ctx)
{
	static struct imu_log log;
	struct imu_sample sample;
	char error[256];
	int got;

	if (imu_log_open(&log, path, error, sizeof error) < 0) {
		cli_error("%s", error);
		exit(CLI_FAILED);
	}
	while ((got = imu_log_next(&log, &sample)) == 1)
		take(ctx, &sample);
	imu_log_close(&log);
	if (got < 0) {
		cli_error("%s:%ld: %s", path, log.line, strerror(-got));
		exit(CLI_FAILED);
	}
	if (log.skipped)
		cli_error("%u rows skipped, the last one: %s", log.skipped, log.last_skip);
}

static void take_gyro(void *ctx, const struct imu_sample *sample)
{
	calibrate_gyro_step(ctx, sample);
}

static void take_accelerometer(void *ctx, const struct imu_sample *sample)
{
	calibrate_accelerometer_step(ctx, sample);
}

static void take_magnetometer(void *ctx, const struct imu_sample *sample)
{
	calibrate_magnetometer_step(ctx, sample);
}

static void take_temperature(void *ctx, const struct imu_sample *sample)
{
	calibrate_temperature_step(ctx, sample);
}

/* ---- the result as a configuration file -------------------------------------------------------------------------- */

static FILE *open_output(const struct calibrate_request *r)
{
	FILE *f = r->output ? fopen(r->output, "we") : stdout;

	if (!f) {
		cli_error("%s: %s", r->output, strerror(errno));
		exit(CLI_FAILED);
	}
	if (!r->output)
		puts("\nFor the gateway's configuration file:");
	return f;
}

static int close_output(const struct calibrate_request *r, FILE *f)
{
	bool bad = ferror(f) != 0;

	if (r->output)
		bad |= fclose(f) != 0;
	else
		bad |= fflush(f) != 0;
	if (bad)
		cli_error("%s: %s", r->output ? r->output : "standard output", strerror(errno));
	return bad ? CLI_FAILED : CLI_OK;
}

static void write_vec3(FILE *f, const char *name, struct vec3 v)
{
	fprintf(f, "%s_x = %.7g\n%s_y = %.7g\n%s_z = %.7g\n", name, v.x, name, v.y, name, v.z);
}

static void write_triad(FILE *f, const char *section, const struct triad_calibration *t)
{
	static const char AXES[] = "xyz";

	fprintf(f, "[%s]\n", section);
	write_vec3(f, "bias", t->bias);
	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			fprintf(f, "%c%c = %.7g\n", AXES[i], AXES[j], t->matrix[i][j]);
}

static int refused(const struct calibrate_request *r, enum calibrate_verdict verdict)
{
	cli_error("%s: %s refused: %s", r->log, r->what, calibrate_text(verdict));
	return CLI_FAILED;
}

static void print_vec3(const char *what, struct vec3 v, const char *unit)
{
	printf("%-12s %12.6g %12.6g %12.6g %s\n", what, v.x, v.y, v.z, unit);
}

static void print_matrix(const struct triad_calibration *t)
{
	for (int i = 0; i < 3; i++)
		printf("%-12s %12.6f %12.6f %12.6f\n", i == 0 ? "matrix" : "", t->matrix[i][0], t->matrix[i][1],
			t->matrix[i][2]);
}

/* With a temperature compensation the bias of the file is that at its reference temperature. */
static void print_temperature(double temperature_degC, const struct temperature_compensation *c)
{
	if (isnan(temperature_degC))
		return;
	printf("%-12s %12.4g degC (bias of the file: at %.4g degC)\n", "temperature", temperature_degC,
		c->reference_degC);
}

/* ---- one function a quantity ------------------------------------------------------------------------------------- */

static int gyro(const struct calibrate_request *r)
{
	static struct calibrate_gyro c;
	const struct calibrate_gyro_config config = {.rest_s = (double)INFINITY,
		.patience_s = (double)INFINITY,
		.bias_instability_rad_s = r->settings.noise.gyro_bias_instability_rad_s};
	struct triad_calibration triad = r->settings.calibration.gyro;
	enum calibrate_verdict verdict;

	calibrate_gyro_init(&c, &config);
	for_each_sample(r->log, take_gyro, &c);
	verdict = calibrate_gyro_finish(&c);
	if (verdict != CALIBRATE_GOOD)
		return refused(r, verdict);
	print_vec3("bias", vec3_scale(DEG_PER_RAD, c.result.bias_rad_s), "deg/s");
	print_vec3("1 sigma", vec3_scale(DEG_PER_RAD, c.result.sigma_rad_s), "deg/s");
	printf("%-12s %12.4g s\n", "rest", c.result.rest_s);
	print_temperature(c.result.temperature_degC, &r->settings.calibration.temperature);
	triad.bias = c.result.bias_rad_s;
	if (!isnan(c.result.temperature_degC))
		triad.bias = vec3_sub(triad.bias,
			calibration_gyro_shift(&r->settings.calibration.temperature, c.result.temperature_degC));
	FILE *f = open_output(r);
	write_triad(f, "gyro_calibration", &triad);
	return close_output(r, f);
}

static int accelerometer(const struct calibrate_request *r)
{
	static struct calibrate_accelerometer c;
	const struct calibrate_accelerometer_config config = {
		.positions = r->six ? CALIBRATE_SIX_FACES : CALIBRATE_FREE,
		.gravity_m_s2 = r->settings.estimator.gravity_m_s2,
		.bias_instability_m_s2 = r->settings.noise.accel_bias_instability_m_s2,
		.use_all = true,
		.patience_s = (double)INFINITY};
	struct triad_calibration triad;
	enum calibrate_verdict verdict;

	calibrate_accelerometer_init(&c, &config);
	for_each_sample(r->log, take_accelerometer, &c);
	verdict = calibrate_accelerometer_finish(&c);
	if (verdict == CALIBRATE_TOO_FEW_POSITIONS)
		cli_error("%d of %d positions found", c.positions, calibrate_accelerometer_wanted(&c));
	if (verdict == CALIBRATE_LARGE_RESIDUAL)
		cli_error("residual %.3g m/s^2 in %d positions", c.result.residual_m_s2, c.positions);
	if (verdict != CALIBRATE_GOOD)
		return refused(r, verdict);
	triad = c.result.calibration;
	print_vec3("bias", triad.bias, "m/s^2");
	print_vec3("1 sigma", c.result.bias_sigma_m_s2, "m/s^2");
	print_matrix(&triad);
	printf("%-12s %12.2g (each element of the matrix)\n", "1 sigma", c.result.matrix_sigma);
	printf("%-12s %12.4f m/s^2 RMS in %d positions, coverage %.0f %%\n", "residual", c.result.residual_m_s2,
		c.positions, 100 * c.coverage);
	if (r->six)
		printf("%-12s %12.2f deg between faces and sensor axes\n", "turned",
			c.result.faces_turned_rad * DEG_PER_RAD);
	print_temperature(c.result.temperature_degC, &r->settings.calibration.temperature);
	if (!isnan(c.result.temperature_degC))
		triad.bias = vec3_sub(triad.bias,
			calibration_accel_shift(&r->settings.calibration.temperature, c.result.temperature_degC));
	FILE *f = open_output(r);
	write_triad(f, "accelerometer_calibration", &triad);
	return close_output(r, f);
}

static int magnetometer(const struct calibrate_request *r)
{
	static struct calibrate_magnetometer c;
	const struct calibrate_magnetometer_config config = {
		.field_uT = r->field_uT, .use_all = true, .patience_s = (double)INFINITY};
	const struct calibrate_magnetometer_result *result = &c.result;
	enum calibrate_verdict verdict;

	calibrate_magnetometer_init(&c, &config);
	for_each_sample(r->log, take_magnetometer, &c);
	verdict = calibrate_magnetometer_finish(&c);
	if (verdict == CALIBRATE_POOR_COVERAGE)
		cli_error("coverage %.0f %%", 100 * c.coverage);
	if (verdict == CALIBRATE_LARGE_RESIDUAL)
		cli_error("residual %.1f %% of the field", 100 * result->residual);
	if (verdict != CALIBRATE_GOOD)
		return refused(r, verdict);
	print_vec3("bias", result->calibration.bias, "uT");
	print_vec3("1 sigma", result->bias_sigma_uT, "uT");
	print_matrix(&result->calibration);
	printf("%-12s %12.2f %% of the field RMS, coverage %.0f %%\n", "residual", 100 * result->residual,
		100 * c.coverage);
	printf("%-12s %12.2f uT\n", "field", result->field_uT);
	FILE *f = open_output(r);
	write_triad(f, "magnetometer_calibration", &result->calibration);
	return close_output(r, f);
}

static int temperature(const struct calibrate_request *r)
{
	static struct calibrate_temperature c;
	const struct calibrate_temperature_result *result = &c.result;
	const struct temperature_compensation *t = &result->compensation;
	enum calibrate_verdict verdict;

	calibrate_temperature_init(&c);
	for_each_sample(r->log, take_temperature, &c);
	verdict = calibrate_temperature_finish(&c);
	if (verdict != CALIBRATE_GOOD && result->rest_s > 0)
		cli_error("%.0f s of rest from %.1f to %.1f degC", result->rest_s, result->lowest_degC,
			result->highest_degC);
	if (verdict != CALIBRATE_GOOD)
		return refused(r, verdict);
	printf("%.0f s of rest from %.1f to %.1f degC, %s\n", result->rest_s, result->lowest_degC, result->highest_degC,
		result->quadratic ? "a parabola" : "a straight line");
	print_vec3("gyro slope", vec3_scale(DEG_PER_RAD, t->gyro_slope), "deg/s/K");
	print_vec3("1 sigma", vec3_scale(DEG_PER_RAD, result->gyro_slope_sigma), "deg/s/K");
	print_vec3("residual", vec3_scale(DEG_PER_RAD, result->gyro_residual_rad_s), "deg/s");
	print_vec3("accel slope", t->accel_slope, "m/s^2/K");
	print_vec3("1 sigma", result->accel_slope_sigma, "m/s^2/K");
	print_vec3("residual", result->accel_residual_m_s2, "m/s^2");
	FILE *f = open_output(r);
	fputs("[temperature_compensation]\n", f);
	write_vec3(f, "gyro_slope", t->gyro_slope);
	write_vec3(f, "accelerometer_slope", t->accel_slope);
	fprintf(f, "reference_temperature = %.7g\n", t->reference_degC);
	write_vec3(f, "gyro_quadratic", t->gyro_quadratic);
	write_vec3(f, "accelerometer_quadratic", t->accel_quadratic);
	fputs("[gyro_calibration]\n", f);
	write_vec3(f, "bias", result->gyro_rad_s);
	return close_output(r, f);
}

int calibrate_from_log(const struct calibrate_request *r)
{
	if (strcmp(r->what, "gyro") == 0)
		return gyro(r);
	if (strcmp(r->what, "accelerometer") == 0)
		return accelerometer(r);
	if (strcmp(r->what, "magnetometer") == 0)
		return magnetometer(r);
	return temperature(r);
}
