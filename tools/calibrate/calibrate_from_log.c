#include <stdio.h>
#include <string.h>

#include "model/identify/calibrate_accelerometer.h"
#include "model/identify/calibrate_gyro.h"
#include "model/identify/calibrate_magnetometer.h"
#include "model/identify/calibrate_temperature.h"
#include "model/math/units.h"
#include "tools/calibrate/calibrate_sensor.h"
#include "tools/lib/cli.h"
#include "tools/lib/cli_file.h"

static struct imu_log input;

/* ---- the result as a configuration file -------------------------------------------------------------------------- */

static FILE *open_output(const struct calibrate_request *r)
{
	if (!r->output)
		puts("\nFor the configuration file of the gateway:");
	return cli_create(r->output);
}

static void write_vec3(FILE *f, const char *name, struct vec3 v)
{
	fprintf(f, "%s_x = %.7g\n%s_y = %.7g\n%s_z = %.7g\n", name, v.x, name, v.y, name, v.z);
}

static void write_matrix(FILE *f, const struct triad_calibration *t)
{
	static const char AXES[] = "xyz";

	for (int i = 0; i < 3; i++)
		for (int j = 0; j < 3; j++)
			fprintf(f, "%c%c = %.7g\n", AXES[i], AXES[j], t->matrix[i][j]);
}

static void write_triad(FILE *f, const char *section, const struct triad_calibration *t)
{
	fprintf(f, "[%s]\n", section);
	write_vec3(f, "bias", t->bias);
	write_matrix(f, t);
}

static int save_triad(const struct calibrate_request *r, const char *section, const struct triad_calibration *t)
{
	FILE *f = open_output(r);

	write_triad(f, section, t);
	cli_close(f, r->output);
	return CLI_OK;
}

static int refused(const struct calibrate_request *r, enum calibrate_verdict verdict)
{
	cli_error("%s: %s refused: %s", r->log, r->what, calibrate_text(verdict));
	return CLI_FAILED;
}

/* Names the sides that are farthest from all that was measured, the farthest first. */
static void tell_missing(const char *what, int sides, double (*gap_rad)(const void *c, int side), const void *c)
{
	enum { MOST = 4 };
	const double least_rad = 40 * RAD_PER_DEG; /* half the angle between two faces, less some */
	bool told[CALIBRATE_SIDES + 1] = {false};

	for (int n = 0; n < MOST; n++) {
		int farthest = 0;

		for (int side = 1; side <= sides; side++)
			if (!told[side] && (!farthest || gap_rad(c, side) > gap_rad(c, farthest) + 1e-9))
				farthest = side;
		if (!farthest || gap_rad(c, farthest) < least_rad)
			return;
		told[farthest] = true;
		if (gap_rad(c, farthest) < PI)
			cli_error("missing: %s %s; the nearest is %.0f deg away", calibrate_side_text(farthest), what,
				DEG_PER_RAD * gap_rad(c, farthest));
		else
			cli_error("missing: %s %s", calibrate_side_text(farthest), what);
	}
}

static double position_gap_rad(const void *c, int side)
{
	return calibrate_accelerometer_gap_rad(c, side);
}

static double field_gap_rad(const void *c, int side)
{
	return calibrate_magnetometer_gap_rad(c, side);
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

/* The bias in the file is that at the reference temperature of the temperature compensation. */
static struct vec3 bias_at_reference(const struct calibrate_request *r, struct vec3 bias, double temperature_degC,
	struct vec3 (*shift)(const struct temperature_compensation *c, double temperature_degC))
{
	const struct temperature_compensation *c = &r->settings.calibration.temperature;

	if (isnan(temperature_degC))
		return bias;
	printf("%-12s %12.4g degC (the bias in the file is that at %.4g degC)\n", "temperature", temperature_degC,
		c->reference_degC);
	return vec3_sub(bias, shift(c, temperature_degC));
}

/* ---- one function for each quantity ------------------------------------------------------------------------------ */

static int gyro(const struct calibrate_request *r)
{
	static struct calibrate_gyro c;
	struct imu_sample sample;
	const struct calibrate_gyro_config config = {.rest_s = (double)INFINITY,
		.patience_s = (double)INFINITY,
		.bias_instability_rad_s = r->settings.noise.gyro_bias_instability_rad_s};
	struct triad_calibration triad = r->settings.calibration.gyro;
	enum calibrate_verdict verdict;

	calibrate_gyro_init(&c, &config);
	cli_log_open(&input, r->log, NULL);
	while (cli_log_next(&input, &sample))
		calibrate_gyro_step(&c, &sample);
	verdict = calibrate_gyro_finish(&c);
	if (verdict != CALIBRATE_GOOD)
		return refused(r, verdict);
	print_vec3("bias", vec3_scale(DEG_PER_RAD, c.result.bias_rad_s), "deg/s");
	print_vec3("1 sigma", vec3_scale(DEG_PER_RAD, c.result.sigma_rad_s), "deg/s");
	printf("%-12s %12.4g s\n", "rest", c.result.rest_s);
	triad.bias = bias_at_reference(r, c.result.bias_rad_s, c.result.temperature_degC, calibration_gyro_shift);
	return save_triad(r, "gyro_calibration", &triad);
}

static int accelerometer(const struct calibrate_request *r)
{
	static struct calibrate_accelerometer c;
	struct imu_sample sample;
	const struct calibrate_accelerometer_config config = {
		.positions = r->six ? CALIBRATE_SIX_FACES : CALIBRATE_FREE,
		.gravity_m_s2 = r->settings.estimator.gravity_m_s2,
		.bias_instability_m_s2 = r->settings.noise.accel_bias_instability_m_s2,
		.use_all = true,
		.patience_s = (double)INFINITY};
	struct triad_calibration triad;
	enum calibrate_verdict verdict;

	calibrate_accelerometer_init(&c, &config);
	cli_log_open(&input, r->log, NULL);
	while (cli_log_next(&input, &sample))
		calibrate_accelerometer_step(&c, &sample);
	verdict = calibrate_accelerometer_finish(&c);
	if (verdict == CALIBRATE_TOO_FEW_POSITIONS)
		cli_error("%d of %d positions found", c.positions, calibrate_accelerometer_wanted(&c));
	if (verdict == CALIBRATE_POOR_COVERAGE)
		cli_error("coverage %.0f %% in %d positions", 100 * c.coverage, c.positions);
	if (verdict == CALIBRATE_TOO_FEW_POSITIONS || verdict == CALIBRATE_POOR_COVERAGE)
		tell_missing("up", r->six ? CALIBRATE_FACES : CALIBRATE_SIDES, position_gap_rad, &c);
	if (verdict == CALIBRATE_IMPLAUSIBLE)
		cli_error("the forces at rest fit %.4g m/s^2 after a scale of %.3g %.3g %.3g and an offset of %.3g "
			  "m/s^2: "
			  "check the units",
			r->settings.estimator.gravity_m_s2, c.result.calibration.matrix[0][0],
			c.result.calibration.matrix[1][1], c.result.calibration.matrix[2][2],
			vec3_norm(c.result.calibration.bias));
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
		printf("%-12s %12.2f deg between faces and sensor axes\n", "rotation",
			c.result.faces_turned_rad * DEG_PER_RAD);
	if (c.result.gyro.found)
		printf("%-12s %12.2g (each element of the matrix of the gyro, from %d turns)\n", "1 sigma",
			c.result.gyro.sigma, c.result.gyro.turns);
	triad.bias = bias_at_reference(r, triad.bias, c.result.temperature_degC, calibration_accel_shift);
	FILE *f = open_output(r);
	write_triad(f, "accelerometer_calibration", &triad);
	if (c.result.gyro.found) {
		memcpy(triad.matrix, c.result.gyro.matrix, sizeof(triad.matrix));
		fputs("[gyro_calibration]\n", f);
		write_matrix(f, &triad);
	}
	cli_close(f, r->output);
	return CLI_OK;
}

static int magnetometer(const struct calibrate_request *r)
{
	static struct calibrate_magnetometer c;
	struct imu_sample sample;
	const struct calibrate_magnetometer_config config = {
		.field_uT = r->field_uT, .use_all = true, .patience_s = (double)INFINITY};
	const struct calibrate_magnetometer_result *result = &c.result;
	enum calibrate_verdict verdict;

	calibrate_magnetometer_init(&c, &config);
	cli_log_open(&input, r->log, NULL);
	while (cli_log_next(&input, &sample))
		calibrate_magnetometer_step(&c, &sample);
	verdict = calibrate_magnetometer_finish(&c);
	if (verdict == CALIBRATE_POOR_COVERAGE)
		cli_error("coverage %.0f %%", 100 * c.coverage);
	if (verdict == CALIBRATE_POOR_COVERAGE)
		tell_missing("along the field", CALIBRATE_SIDES, field_gap_rad, &c);
	if (verdict == CALIBRATE_IMPLAUSIBLE)
		cli_error("the field is %.3g uT long: check the units", result->field_uT);
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
	return save_triad(r, "magnetometer_calibration", &result->calibration);
}

static int temperature(const struct calibrate_request *r)
{
	static struct calibrate_temperature c;
	struct imu_sample sample;
	const struct calibrate_temperature_result *result = &c.result;
	const struct temperature_compensation *t = &result->compensation;
	enum calibrate_verdict verdict;

	calibrate_temperature_init(&c);
	cli_log_open(&input, r->log, NULL);
	while (cli_log_next(&input, &sample))
		calibrate_temperature_step(&c, &sample);
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
	cli_close(f, r->output);
	return CLI_OK;
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
