#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "model/identify/calibrate.h"
#include "od_values.h"
#include "tools/calibrate/calibrate_sensor.h"
#include "tools/calibrate/procedure.h"

enum {
	KIND = OD_SUB_CALIBRATION_KIND,
	VERDICT,
	PROGRESS,
	POSITIONS,
	WANTED,
	NEXT,
	QUALITY,
	COVERAGE,
	FIELD,
	TEMPERATURE,
	STRENGTH,
	FOUND,
	GYRO_SIGMA = FOUND + 12
}; /* sub-indices */
enum { GYRO = 1, SIX_FACES, FREE, MAGNETOMETER, ACCEPT = 10, DISCARD = 11 };

static const char *const WHAT_TO_DO[] = {
	[GYRO] = "Gyro: let the sensor rest, untouched, for about 10 s.",
	[SIX_FACES] =
		"Accelerometer: put the sensor in its fixture on each of its six faces, in any order, 3 s each: about\n"
		"a minute.",
	[FREE] = "Accelerometer: hold the sensor still for 3 s in each of 12 positions, every side and corner up. The\n"
		 "program says which side is missing. About 2 minutes.",
	[MAGNETOMETER] =
		"Magnetometer: turn the sensor slowly through all directions, away from iron and currents. About\n"
		"half a minute.",
};

static bool show_progress(struct procedure *p, void *ctx)
{
	const uint8_t kind = *(const uint8_t *)ctx;
	uint8_t progress, positions, wanted, next, coverage;
	char text[160];

	if (!procedure_byte(p, PROGRESS, &progress))
		return false;
	switch (kind) {
	case GYRO:
		snprintf(text, sizeof text, "do not touch the sensor: %u %%", progress);
		break;
	case MAGNETOMETER:
		if (!procedure_byte(p, COVERAGE, &coverage) || !procedure_byte(p, NEXT, &next))
			return false;
		snprintf(text, sizeof text, "turn it slowly through all directions: %u %% (coverage %u %%)%s%s",
			progress, coverage, next ? "; missing along the field: " : "",
			next ? calibrate_side_text(next) : "");
		break;
	default:
		if (!procedure_byte(p, POSITIONS, &positions) || !procedure_byte(p, WANTED, &wanted) ||
			!procedure_byte(p, NEXT, &next))
			return false;
		snprintf(text, sizeof text, "%u of %u positions; turn it and hold it still: %s up", positions, wanted,
			calibrate_side_text(next));
	}
	procedure_show(text);
	return true;
}

static bool print_result(struct procedure *p, uint8_t kind)
{
	static const char *const UNITS[] = {"", "rad/s", "m/s^2", "m/s^2", "uT"};
	float value[12], quality, temperature, gyro;

	for (uint8_t i = 0; i < 12; i++)
		if (!procedure_real(p, (uint8_t)(FOUND + i), &value[i]))
			return false;
	if (!procedure_real(p, QUALITY, &quality) || !procedure_real(p, TEMPERATURE, &temperature) ||
		!procedure_real(p, GYRO_SIGMA, &gyro))
		return false;
	procedure_result(p, "bias     %12.6g %12.6g %12.6g %s\n", (double)value[0], (double)value[1], (double)value[2],
		UNITS[kind]);
	if (kind != GYRO)
		for (int i = 3; i < 12; i += 3)
			procedure_result(p, "%-8s %12.6f %12.6f %12.6f\n", i == 3 ? "matrix" : "", (double)value[i],
				(double)value[i + 1], (double)value[i + 2]);
	procedure_result(p, "%-8s %12.4g %s\n", kind == GYRO ? "1 sigma" : "residual", (double)quality,
		kind == MAGNETOMETER ? "% of the field" : UNITS[kind]);
	if (temperature > -300)
		procedure_result(p, "%-8s %12.4g degC\n", "at", (double)temperature);
	if (gyro > 0)
		procedure_result(p,
			"%-8s %12.2g %% (1 sigma of its matrix; accepted with this if its bias is calibrated)\n",
			"gyro", (double)gyro);
	return true;
}

static int run(struct procedure *p, const struct calibrate_request *r, uint8_t kind)
{
	uint8_t state = 0, verdict;

	if (!procedure_begin(p, WHAT_TO_DO[kind]))
		return CLI_FAILED;
	if (r->field_uT > 0 && !procedure_write_real(p, STRENGTH, (float)r->field_uT))
		return CLI_FAILED;
	if (!procedure_start(p, kind) || !procedure_watch(p, show_progress, &kind, &state) ||
		!procedure_byte(p, VERDICT, &verdict))
		return CLI_FAILED;
	if (state != PROCEDURE_DONE) {
		cli_error("%s refused: %s", r->what, calibrate_text((enum calibrate_verdict)verdict));
		return CLI_FAILED;
	}
	return print_result(p, kind) && procedure_accept(p, ACCEPT, DISCARD) ? CLI_OK : CLI_FAILED;
}

int calibrate_live(const struct calibrate_request *r)
{
	const uint8_t kind = strcmp(r->what, "gyro") == 0	    ? GYRO
			     : strcmp(r->what, "magnetometer") == 0 ? MAGNETOMETER
			     : r->six				    ? SIX_FACES
								    : FREE;
	/* signals stay blocked: at a question they mean no */
	struct procedure p = {
		.object = OD_INDEX_CALIBRATION, .signal_fd = cli_signal_fd(), .yes = r->yes, .lead = r->lead};

	cli_node_open(&p.node, r->bus, r->node, r->timeout_ms);
	int result = run(&p, r, kind);
	cli_node_close(&p.node);
	close(p.signal_fd);
	return result;
}
