/* What the calibrations and the identification of the lever arm find on simulated chips, also of motions that do not
 * suit them, compared with what they found when the trace was written (trace.h): progress, verdict, result, sigma. */
#include "tests/unit/model_test.h"

#include <stdio.h>
#include <string.h>

#include "model/identify/calibrate_accelerometer.h"
#include "model/identify/calibrate_gyro.h"
#include "model/identify/calibrate_magnetometer.h"
#include "model/identify/calibrate_temperature.h"
#include "model/identify/ellipsoid.h"
#include "model/identify/lever_identification.h"
#include "model/seed.h"
#include "model/sim/sensor.h"
#include "tests/unit/trace.h"

#define DEG(x) ((x)*RAD_PER_DEG)

static const double FOREVER = 1e9;
static const char FINE[] = "lsm303dlhc_l3gd20_fine", COARSE[] = "lsm303dlhc_l3gd20", OLD[] = "lsm303dlh_l3g4200d";

/* ---- simulated chips --------------------------------------------------------------------------------------------- */

/* A motion, and when it begins; before and after it the chip rests. */
struct scene {
	const char *name, *chip, *signal;
	double begin_s, end_s, seconds;
	double warming_K;
	uint64_t seed;
	bool variant; /* of the procedure, see there */
	double bias_instability, field_uT;
	double share;	/* of the signal's angle, default 1 */
	double stretch; /* of its times, likewise */
};

static struct sensor sensor_of(const struct scene *scene)
{
	struct sensor_config chip = *sensor_preset(scene->chip);
	struct sensor sensor;

	chip.warming_K = scene->warming_K;
	chip.warming_s = 60;
	chip.temperature_step_K = 0.125;
	assert_int_equal(sensor_init(&sensor, &chip, scene->seed), 0);
	return sensor;
}

static struct imu_sample next(struct sensor *sensor, const struct scene *scene)
{
	double t_s = sensor_instant_s(sensor);
	bool moves = t_s >= scene->begin_s && t_s < scene->end_s;
	struct signal signal = *signal_find(moves ? scene->signal : "rest");
	struct signal_truth truth;
	struct imu_sample s;

	signal.angle_rad *= scene->share > 0 ? scene->share : 1;
	signal.period_s *= scene->stretch > 0 ? scene->stretch : 1;
	signal.change_s *= scene->stretch > 0 ? scene->stretch : 1;
	signal_at(&signal, fmax(0, t_s - scene->begin_s), &truth);
	sensor_measure(sensor, &truth, &s);
	return s;
}

static bool is_full(double each_s, int k, double rate_hz)
{
	return (k + 1) % (int)(each_s * rate_hz) == 0;
}

/* t_s: 0 for the result */
static void block(const char *procedure, const struct scene *scene, double t_s)
{
	char header[80];

	if (t_s > 0)
		snprintf(header, sizeof header, "%s, %s, %.6g s", procedure, scene->name, t_s);
	else
		snprintf(header, sizeof header, "%s, %s, result", procedure, scene->name);
	trace_block(header);
}

static void trace_matrix(double m[3][3])
{
	const char *const names[] = {"matrix_x", "matrix_y", "matrix_z"};

	for (int i = 0; i < 3; i++)
		trace_vec(names[i], (struct vec3){m[i][0], m[i][1], m[i][2]}, 1e-7);
}

/* ---- gyro -------------------------------------------------------------------------------------------------------- */

/* variant: a log, of which the longest rest counts */
static const struct scene GYRO[] = {
	{"rest", FINE, "rest", .seconds = 15, .seed = 1, .bias_instability = 1.7e-4},
	{"after a motion", FINE, "tumble", .end_s = 12, .seconds = 30, .seed = 2, .bias_instability = 1e-4},
	{"moved", COARSE, "tumble", .end_s = 100, .seconds = 100, .seed = 3},
	{"turntable", FINE, "turntable", .end_s = 100, .seconds = 70, .seed = 4},
	{"slow turntable", FINE, "turntable", .end_s = 100, .seconds = 20, .seed = 4, .share = 0.3 / 360},
	{"log", FINE, "tumble", 8, 12, 40, 5, 5, true, .bias_instability = 1e-4},
	{"log, two short rests", OLD, "tumble", 4, 12, 16, 0, 6, true, .bias_instability = 1e-4},
	{"coarse, warming", COARSE, "rest", .seconds = 20, .warming_K = 10, .seed = 7, .bias_instability = 1e-4},
};

static void test_gyro(void **state)
{
	const struct scene *scene = *state;
	struct calibrate_gyro_config config = CALIBRATE_GYRO_DEFAULTS;
	struct sensor sensor = sensor_of(scene);
	static struct calibrate_gyro c;

	if (scene->variant)
		config.rest_s = config.patience_s = (double)INFINITY;
	config.bias_instability_rad_s = scene->bias_instability;
	calibrate_gyro_init(&c, &config);
	for (int k = 0; k < scene->seconds * 100 && c.verdict == CALIBRATE_COLLECTING; k++) {
		struct imu_sample s = next(&sensor, scene);

		calibrate_gyro_step(&c, &s);
		if (is_full(5, k, 100) || c.verdict != CALIBRATE_COLLECTING) {
			block("gyro", scene, (k + 1) / 100.0);
			trace_value("verdict", c.verdict, 0);
			trace_value("progress", calibrate_gyro_progress(&c), 1e-6);
			trace_value("time_s", calibrate_rest_time_s(&c.rest), 1e-6);
		}
	}
	block("gyro", scene, 0);
	trace_value("verdict", calibrate_gyro_finish(&c), 0);
	trace_vec("bias_rad_s", c.result.bias_rad_s, 1e-8);
	trace_vec("sigma_rad_s", c.result.sigma_rad_s, 1e-9);
	trace_value("rest_s", c.result.rest_s, 1e-6);
	if (scene->warming_K > 0 && c.verdict == CALIBRATE_GOOD)
		trace_value("temperature_degC", c.result.temperature_degC, 1e-4);
	trace_check();
}

/* ---- accelerometer ----------------------------------------------------------------------------------------------- */

/* variant: six faces; end_s < seconds: a log */
static const struct scene ACCELEROMETER[] = {
	{"free", FINE, "multiposition", .end_s = 130, .seconds = 130, .seed = 1},
	{"free, with turns", COARSE, "multiposition", .end_s = 130, .seconds = 130, .seed = 2},
	{"free, old chip, warming", OLD, "multiposition", .end_s = 130, .seconds = 130, .warming_K = 5, .seed = 3},
	{"six faces", FINE, "multiposition", .end_s = 130, .seconds = 130, .seed = 4, .variant = true},
	{"six faces, with turns", COARSE, "multiposition", .end_s = 130, .seconds = 130, .seed = 5, .variant = true},
	{"free, a log", COARSE, "multiposition", 5, 68, 75, 3, .seed = 6},
	{"free, turns of 13.5 s", COARSE, "multiposition", .end_s = 570, .seconds = 570, .seed = 2, .stretch = 9},
	{"free, turns of 17 s", COARSE, "multiposition", .end_s = 720, .seconds = 720, .seed = 2, .stretch = 11.3},
	{"too few positions", COARSE, "multiposition", .end_s = 35, .seconds = 45, .seed = 7},
	{"moved", FINE, "tumble", .end_s = 140, .seconds = 130, .seed = 8},
};

static void test_accelerometer(void **state)
{
	const struct scene *scene = *state;
	struct sensor sensor = sensor_of(scene);
	struct calibrate_accelerometer_config config = {
		.positions = scene->variant ? CALIBRATE_SIX_FACES : CALIBRATE_FREE,
		.gravity_m_s2 = 9.81,
		.bias_instability_m_s2 = 1e-3,
		.use_all = scene->end_s<scene->seconds, .patience_s = scene->end_s> scene->seconds ? 120 : FOREVER};
	static struct calibrate_accelerometer c;

	calibrate_accelerometer_init(&c, &config);
	for (int k = 0; k < scene->seconds * 100 && c.verdict == CALIBRATE_COLLECTING; k++) {
		struct imu_sample s = next(&sensor, scene);

		calibrate_accelerometer_step(&c, &s);
		if (is_full(scene->stretch > 0 ? 200 : 20, k, 100) || c.verdict != CALIBRATE_COLLECTING) {
			block("accelerometer", scene, (k + 1) / 100.0);
			trace_value("positions", c.positions, 0);
			trace_value("coverage", c.coverage, 1e-6);
			trace_value("wanted", calibrate_accelerometer_wanted(&c), 0);
			trace_value("next", calibrate_accelerometer_next(&c), 0);
			trace_value("gap_rad", calibrate_accelerometer_gap_rad(&c, 3), 1e-6);
		}
	}
	block("accelerometer", scene, 0);
	trace_value("verdict", calibrate_accelerometer_finish(&c), 0);
	trace_vec("bias_m_s2", c.result.calibration.bias, 1e-6);
	trace_matrix(c.result.calibration.matrix);
	trace_value("residual_m_s2", c.result.residual_m_s2, 1e-7);
	trace_vec("bias_sigma_m_s2", c.result.bias_sigma_m_s2, 1e-8);
	trace_value("matrix_sigma", c.result.matrix_sigma, 1e-9);
	trace_value("faces_turned_rad", c.result.faces_turned_rad, 1e-7);
	if (scene->warming_K > 0 && c.verdict == CALIBRATE_GOOD)
		trace_value("temperature_degC", c.result.temperature_degC, 1e-4);
	trace_value("gyro_found", c.result.gyro.found, 0);
	trace_value("gyro_turns", c.result.gyro.turns, 0);
	trace_value("gyro_sigma", c.result.gyro.sigma, 1e-8);
	trace_matrix(c.result.gyro.matrix);
	trace_check();
}

/* ---- magnetometer ------------------------------------------------------------------------------------------------ */

/* variant: with spikes; end_s < seconds: a log */
static const struct scene MAGNETOMETER[] = {
	{"figure", COARSE, "figure", .end_s = 200, .seconds = 120, .seed = 1},
	{"figure, known strength", OLD, "figure", .end_s = 200, .seconds = 120, .seed = 2, .field_uT = 49},
	{"figure with spikes", COARSE, "figure", .end_s = 200, .seconds = 120, .seed = 3, .variant = true},
	{"figure, a log", COARSE, "figure", .end_s = 60, .seconds = 70, .seed = 4, .variant = true},
	{"turntable", COARSE, "turntable", .end_s = 200, .seconds = 130, .seed = 5},
	{"tumble", FINE, "tumble", .end_s = 200, .seconds = 130, .seed = 6},
	{"rest", FINE, "rest", .end_s = 200, .seconds = 130, .seed = 7},
};

static void test_magnetometer(void **state)
{
	const struct scene *scene = *state;
	struct sensor sensor = sensor_of(scene);
	const struct calibrate_magnetometer_config config = {scene->field_uT, scene->end_s < scene->seconds, 120};
	static struct calibrate_magnetometer c;

	calibrate_magnetometer_init(&c, &config);
	for (int k = 0; k < scene->seconds * 100 && c.verdict == CALIBRATE_COLLECTING; k++) {
		struct imu_sample s = next(&sensor, scene);

		if (scene->variant && k % 97 == 0)
			s.mag_uT.x += 30;
		calibrate_magnetometer_step(&c, &s);
		if (is_full(10, k, 100) || c.verdict != CALIBRATE_COLLECTING) {
			block("magnetometer", scene, (k + 1) / 100.0);
			trace_value("coverage", c.coverage, 1e-6);
			trace_value("progress", calibrate_magnetometer_progress(&c), 1e-6);
			trace_value("next", calibrate_magnetometer_next(&c), 0);
			trace_value("gap_rad", calibrate_magnetometer_gap_rad(&c, 2), 1e-6);
			trace_value("points", c.count, 0);
		}
	}
	block("magnetometer", scene, 0);
	trace_value("verdict", calibrate_magnetometer_finish(&c), 0);
	trace_vec("bias_uT", c.result.calibration.bias, 1e-5);
	trace_matrix(c.result.calibration.matrix);
	trace_value("field_uT", c.result.field_uT, 1e-5);
	trace_value("residual", c.result.residual, 1e-8);
	trace_vec("bias_sigma_uT", c.result.bias_sigma_uT, 1e-7);
	trace_check();
}

/* ---- temperature ------------------------------------------------------------------------------------------------- */

static const struct scene TEMPERATURE[] = {
	{"warming", FINE, "rest", .seconds = 200, .warming_K = 20, .seed = 1},
	{"warming little", FINE, "rest", .seconds = 200, .warming_K = 7, .seed = 2},
	{"warming, moved meanwhile", COARSE, "tumble", 30, 50, 200, 25, .seed = 3},
	{"no thermometer", COARSE, "rest", .seconds = 60, .seed = 4},
	{"warming, always moved", COARSE, "tumble", 0, 300, 200, 25, .seed = 5},
};

static void test_temperature(void **state)
{
	const struct scene *scene = *state;
	struct sensor sensor = sensor_of(scene);
	static struct calibrate_temperature c;

	calibrate_temperature_init(&c);
	for (int k = 0; k < scene->seconds * 100; k++) {
		struct imu_sample s = next(&sensor, scene);

		calibrate_temperature_step(&c, &s);
	}
	block("temperature", scene, 0);
	trace_value("verdict", calibrate_temperature_finish(&c), 0);
	trace_vec("gyro_slope", c.result.compensation.gyro_slope, 1e-9);
	trace_vec("gyro_quadratic", c.result.compensation.gyro_quadratic, 1e-10);
	trace_vec("accel_slope", c.result.compensation.accel_slope, 1e-8);
	trace_vec("accel_quadratic", c.result.compensation.accel_quadratic, 1e-9);
	trace_value("reference_degC", c.result.compensation.reference_degC, 1e-4);
	trace_value("lowest_degC", c.result.lowest_degC, 1e-4);
	trace_value("highest_degC", c.result.highest_degC, 1e-4);
	trace_vec("gyro_residual_rad_s", c.result.gyro_residual_rad_s, 1e-9);
	trace_vec("accel_residual_m_s2", c.result.accel_residual_m_s2, 1e-8);
	trace_vec("gyro_slope_sigma", c.result.gyro_slope_sigma, 1e-10);
	trace_vec("accel_slope_sigma", c.result.accel_slope_sigma, 1e-9);
	trace_vec("gyro_rad_s", c.result.gyro_rad_s, 1e-8);
	trace_value("rest_s", c.result.rest_s, 1e-6);
	trace_value("quadratic", c.result.quadratic, 0);
	trace_check();
}

/* ---- lever arm --------------------------------------------------------------------------------------------------- */

static const struct lever_scene {
	const char *name;
	double rate_hz, seconds;
	struct vec3 swing_rad, swing_hz; /* roll, pitch, yaw */
	struct vec3 travel_m, travel_hz; /* of the reference point */
	bool reference, estimate_delay;
	double late_s; /* the reference is by so much */
	int lost;      /* each n-th sample is */
	struct vec3 arm_m;
	double nominal_hz; /* default rate_hz */
} LEVER_ARMS[] = {
	{"by hand", 100, 30, {0.9, 0.7, 1.1}, {0.61, 0.83, 0.47}, .arm_m = {0.06, -0.05, 0.0624}},
	{"by hand, 400 Hz, samples lost", 400, 25, {0.5, 0.6, 0.8}, {0.9, 1.1, 0.7}, .lost = 37,
		.arm_m = {0.2, 0.1, -0.3}},
	{"by hand, 30 Hz", 30, 40, {0.5, 0.6, 0.8}, {0.5, 0.7, 0.4}, .arm_m = {0.2, 0.1, -0.3}},
	{"with a reference", 100, 30, {0.9, 0.7, 1.1}, {0.61, 0.83, 0.47}, {0.3, 0.2, 0.1}, {0.7, 0.9, 1.1}, true, true,
		0.008, .arm_m = {0.06, -0.05, 0.0624}},
	{"with a late reference", 100, 30, {0.9, 0.7, 1.1}, {0.61, 0.83, 0.47}, {0.3, 0.2, 0.1}, {0.7, 0.9, 1.1}, true,
		false, 0.004, .lost = 200, .arm_m = {0.06, -0.05, 0.0624}},
	{"moved, without a reference", 100, 30, {0.9, 0.7, 1.1}, {0.61, 0.83, 0.47}, {0.3, 0.2, 0.1}, {0.7, 0.9, 1.1},
		.arm_m = {0.06, -0.05, 0.0624}},
	{"about roll alone", 100, 30, {0.9, 0.01, 0}, {0.9, 0.5, 1}, .arm_m = {0.06, -0.05, 0.0624}},
	{"about yaw alone", 100, 30, {0, 0.01, 0.9}, {0.9, 0.5, 1}, .arm_m = {0.06, -0.05, 0.0624}},
	{"too slow", 100, 30, {0.1, 0.1, 0.1}, {0.3, 0.2, 0.25}, .arm_m = {0.06, -0.05, 0.0624}},
	{"too short", 100, 8, {0.9, 0.7, 1.1}, {0.61, 0.83, 0.47}, .arm_m = {0.06, -0.05, 0.0624}},
	{"twice as many samples as said", 220, 30, {0.9, 0.7, 1.1}, {0.61, 0.83, 0.47}, .arm_m = {0.06, -0.05, 0.0624},
		.nominal_hz = 100},
	{"half as many samples as said", 50, 30, {0.9, 0.7, 1.1}, {0.61, 0.83, 0.47}, .arm_m = {0.06, -0.05, 0.0624},
		.nominal_hz = 90},
	{"for minutes", 100, 150, {0.5, 0.4, 0.6}, {0.61, 0.83, 0.47}, .arm_m = {1, -0.5, 0.6}},
};

static void swing(double size, double hz, double t_s, double out[3])
{
	double w = 2 * PI * hz;

	out[0] = size * sin(w * t_s);
	out[1] = size * w * cos(w * t_s);
	out[2] = -size * w * w * sin(w * t_s);
}

static struct signal_truth lever_truth(const struct lever_scene *m, double t_s)
{
	double roll[3], pitch[3], yaw[3], x[3], y[3], z[3];
	struct rigid_motion body;

	swing(m->swing_rad.x, m->swing_hz.x, t_s, roll);
	swing(m->swing_rad.y, m->swing_hz.y, t_s, pitch);
	swing(m->swing_rad.z, m->swing_hz.z, t_s, yaw);
	swing(m->travel_m.x, m->travel_hz.x, t_s, x);
	swing(m->travel_m.y, m->travel_hz.y, t_s, y);
	swing(m->travel_m.z, m->travel_hz.z, t_s, z);
	body = rigid_motion_from_seed(&(struct seed_motion){
		{roll[0], pitch[0], yaw[0]}, {roll[1], pitch[1], yaw[1]}, {roll[2], pitch[2], yaw[2]}});
	return (struct signal_truth){.t_s = t_s,
		.q_nb = body.q_nb,
		.omega_b_rad_s = body.omega_b_rad_s,
		.alpha_b_rad_s2 = body.alpha_b_rad_s2,
		.accel_n_m_s2 = {x[2], y[2], z[2]}};
}

static void trace_estimate(const struct lever_scene *m, const struct lever_identification *id, double t_s)
{
	struct lever_estimate e = lever_identification_estimate(id);
	char header[80];

	snprintf(header, sizeof header, "lever arm, %s, %.6g s", m->name, t_s);
	trace_block(header);
	trace_value("verdict", e.verdict, 0);
	trace_value("progress_percent", e.progress_percent, 0);
	trace_vec("lever_arm_m", e.lever_arm_b_m, 1e-7);
	trace_vec("noise_sigma_m", e.noise_sigma_b_m, 1e-9);
	trace_vec("sigma_m", e.sigma_b_m, 1e-8);
	trace_value("residual_m_s2", e.residual_m_s2, 1e-7);
	trace_value("delay_s", e.delay_s, 1e-8);
	trace_value("windows", id->windows, 0);
}

static void test_lever_arm(void **state)
{
	const struct lever_scene *m = *state;
	const struct lever_identification_config config = {
		m->nominal_hz > 0 ? m->nominal_hz : m->rate_hz, 30, m->reference, m->estimate_delay};
	struct sensor_config chip = *sensor_preset(FINE);
	static struct lever_identification id;
	struct sensor sensor;

	sensor_calibrate(&chip);
	chip.rate_hz = m->rate_hz;
	chip.lever_arm_b_m = m->arm_m;
	chip.gyro.range = chip.accel.range = 1e3;
	chip.accel.bias_sigma = 0.02;
	assert_int_equal(sensor_init(&sensor, &chip, 3), 0);
	assert_int_equal(lever_identification_init(&id, &config), 0);
	for (int k = 0; k < m->seconds * m->rate_hz; k++) {
		double t_s = sensor_instant_s(&sensor);
		struct signal_truth truth = lever_truth(m, t_s), earlier = lever_truth(m, t_s - m->late_s);
		struct vec3 reference = quat_rotate_inverse(earlier.q_nb, earlier.accel_n_m_s2);
		struct imu_sample s;

		sensor_measure(&sensor, &truth, &s);
		if (m->lost > 0 && k % m->lost == 0)
			continue;
		lever_identification_step(
			&id, s.t_us, s.gyro_rad_s, s.accel_m_s2, m->reference && k % 50 ? &reference : NULL);
		if (is_full(m->seconds / 3, k, m->rate_hz))
			trace_estimate(m, &id, t_s);
	}
	trace_check();
}

/* ---- ellipsoid --------------------------------------------------------------------------------------------------- */

static void test_ellipsoid(void **state)
{
	enum { POINTS = 90 };
	struct vec3 points[POINTS];

	(void)state;
	for (int kind = 0; kind < 3; kind++) { /* even, with outliers, on a cap */
		for (int robust = 0; robust < 2; robust++) {
			struct ellipsoid e;
			char header[80];

			for (int i = 0; i < POINTS; i++) {
				double z = 1 - (i + 0.5) * (kind == 2 ? 0.7 : 2) / POINTS, r = sqrt(1 - z * z);
				double off = 0.3 * sin(3.7 * i * i) + (kind == 1 && i % 11 == 0 ? 8 : 0);

				points[i] = (struct vec3){10 + (40 + off) * r * cos(2.4 * i) + 5 * z,
					-5 + (50 - off) * r * sin(2.4 * i), 3 + (60 + off) * z + 4 * r * cos(2.4 * i)};
			}
			snprintf(header, sizeof header, "ellipsoid, kind %d, robust %d", kind, robust);
			trace_block(header);
			trace_value("guess", ellipsoid_guess(points, POINTS, 50, &e), 0);
			trace_vec("guessed_centre", e.centre, 1e-5);
			trace_value("fit", ellipsoid_fit(points, POINTS, 50, robust, &e), 0);
			trace_vec("centre", e.centre, 1e-5);
			trace_matrix(e.matrix.m);
			trace_value("rms", e.rms, 1e-6);
			trace_vec("sigma", e.sigma, 1e-6);
			trace_value("matrix_sigma", e.matrix_sigma, 1e-8);
			trace_value("coverage", e.coverage, 1e-6);
			trace_vec("eigenvalues", (struct vec3){e.least, e.largest, e.mean}, 1e-7);
		}
	}
	trace_check();
}

int main(void)
{
#define CASES(table, test)                                           \
	for (size_t i = 0; i < sizeof(table) / sizeof *(table); i++) \
		tests[count++] = (struct CMUnitTest){(table)[i].name, test, NULL, NULL, (void *)&(table)[i]};
	struct CMUnitTest tests[64];
	size_t count = 0;

	CASES(GYRO, test_gyro)
	CASES(ACCELEROMETER, test_accelerometer)
	CASES(MAGNETOMETER, test_magnetometer)
	CASES(TEMPERATURE, test_temperature)
	CASES(LEVER_ARMS, test_lever_arm)
	tests[count++] = (struct CMUnitTest)cmocka_unit_test(test_ellipsoid);
	return trace_run("identify", tests, count);
}
