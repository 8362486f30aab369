/* Identification of the lever arm from recorded movements by hand, with the optical acceleration as reference. The
 * known values were fitted to the optical data of all trials of a mounting, without a correction of the delay, and
 * differ by 0.3 to 2.7 mm between trials. The trials are not part of the product: the tests are skipped without them
 * ($IMU9_BROAD). */
#include <glob.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "drivers/imu/imu_log.h"
#include "model/identify/lever_identification.h"
#include "model/pipeline.h"
#include "tests/unit/model_test.h"
#include "tools/lib/reference_log.h"

static const struct {
	const char *trial;
	struct vec3 arm_mm;
} KNOWN[] = {
	{"02", {2.3, -1.9, 7.8}},
	{"06", {-0.8, 0.4, 10.4}},
	{"09", {2.3, -1.9, 7.8}},
	{"14", {2.3, -1.9, 7.8}},
	{"15", {-0.8, 0.4, 10.4}},
	{"25", {3.2, 1.5, 8.6}},
	{"29", {1.3, -1.7, 6.3}},
	{"34", {1.3, 1.2, 7.4}},
};

static struct vec3 known_m(const char *trial)
{
	for (size_t i = 0; i < sizeof(KNOWN) / sizeof(KNOWN[0]); i++)
		if (strcmp(KNOWN[i].trial, trial) == 0)
			return vec3_scale(1e-3, KNOWN[i].arm_mm);
	fail_msg("trial %s", trial);
	return (struct vec3){0, 0, 0};
}

static void find_file(const char *trial, const char *kind, char *path, size_t size)
{
	const char *folder = getenv("IMU9_BROAD") ? getenv("IMU9_BROAD") : "../shared/data/broad";
	char pattern[512];
	glob_t found;

	snprintf(pattern, sizeof pattern, "%s/%s_*.%s.csv", folder, trial, kind);
	if (glob(pattern, 0, NULL, &found) != 0) {
		print_message("no trial %s in %s: set IMU9_BROAD\n", trial, folder);
		skip();
	}
	snprintf(path, size, "%s", found.gl_pathv[0]);
	globfree(&found);
}

/* Estimates of a trial: of all samples, without and with estimation of the delay, and of three parts of 30 s. */
enum { ALL, DELAY_ESTIMATED, PARTS, ESTIMATES = PARTS + 3 };

struct estimates {
	struct lever_estimate by[ESTIMATES];
	bool valid;
};

static bool in_part(int k, double t_s)
{
	const double from_s = 40 + 30 * (k - PARTS);

	return k < PARTS || (t_s >= from_s && t_s < from_s + 30);
}

/* As in the gateway and imu9-calibrate. */
static void replay(struct imu_log *log, struct reference_log *reference, struct lever_identification id[ESTIMATES])
{
	static struct pipeline pipeline;
	struct imu_sample sample;

	assert_int_equal(pipeline_init(&pipeline, &PIPELINE_DEFAULTS, log->rate_hz), 0);
	while (imu_log_next(log, &sample) == 1) {
		struct pipeline_output out;
		struct vec3 ref, gyro;
		const bool seen = reference_log_at(reference, sample.t_us, &ref);

		assert_int_equal(pipeline_step(&pipeline, &sample, &out), 0);
		gyro = fusion_rate_b(&pipeline.fusion, sample.gyro_rad_s);
		for (int k = 0; k < ESTIMATES; k++)
			if (in_part(k, (double)sample.t_us * 1e-6))
				lever_identification_step(
					&id[k], sample.t_us, gyro, sample.accel_m_s2, seen ? &ref : NULL);
	}
}

static const struct estimates *identify(const char *trial)
{
	static struct estimates results[100];
	static struct lever_identification id[ESTIMATES];
	static struct imu_log log;
	struct estimates *t = &results[atoi(trial)];
	struct reference_log reference = {0};
	char path[512], error[512];

	if (t->valid)
		return t;
	find_file(trial, "ref", path, sizeof path);
	assert_int_equal(reference_log_load(&reference, path, error, sizeof error), 0);
	find_file(trial, "imu", path, sizeof path);
	assert_int_equal(imu_log_open(&log, path, log_format_at(0), error, sizeof error), 0);
	for (int k = 0; k < ESTIMATES; k++) {
		const struct lever_identification_config config = {.rate_hz = log.rate_hz,
			.duration_s = 30,
			.reference = true,
			.estimate_delay = k == DELAY_ESTIMATED};

		assert_int_equal(lever_identification_init(&id[k], &config), 0);
	}
	replay(&log, &reference, id);
	imu_log_close(&log);
	reference_log_close(&reference);
	for (int k = 0; k < ESTIMATES; k++)
		t->by[k] = lever_identification_estimate(&id[k]);
	t->valid = true;
	return t;
}

static void print(const char *trial, const struct lever_estimate *e)
{
	const struct vec3 off = vec3_sub(e->lever_arm_b_m, known_m(trial));

	print_message(
		"%s: error %5.2f %5.2f %5.2f mm, sigma %.2f %.2f %.2f mm, reference %.1f ms late, residual %.2f\n",
		trial, 1e3 * off.x, 1e3 * off.y, 1e3 * off.z, 1e3 * e->sigma_b_m.x, 1e3 * e->sigma_b_m.y,
		1e3 * e->sigma_b_m.z, 1e3 * e->delay_s, e->residual_m_s2);
}

static void test_a_fast_trial_gives_each_axis_within_2_mm(void **state)
{
	const char *const fast[] = {"06", "09", "29"};

	(void)state;
	for (int i = 0; i < 3; i++)
		assert_vec_near(identify(fast[i])->by[ALL].lever_arm_b_m, known_m(fast[i]), 0.002);
}

static void test_the_error_of_every_trial_is_below_3_sigma(void **state)
{
	(void)state;
	for (size_t i = 0; i < sizeof(KNOWN) / sizeof(KNOWN[0]); i++) {
		const struct lever_estimate *e = &identify(KNOWN[i].trial)->by[ALL];
		const struct vec3 off = vec3_sub(e->lever_arm_b_m, known_m(KNOWN[i].trial));

		print(KNOWN[i].trial, e);
		assert_int_equal(e->verdict, LEVER_FOUND);
		assert_true(fabs(off.x) < 3 * e->sigma_b_m.x);
		assert_true(fabs(off.y) < 3 * e->sigma_b_m.y);
		assert_true(fabs(off.z) < 3 * e->sigma_b_m.z);
	}
}

static void test_30_s_of_a_fast_trial_give_the_result_of_the_whole_trial(void **state)
{
	const char *const fast[] = {"06", "09", "29"};

	(void)state;
	for (int i = 0; i < 3; i++)
		for (int k = PARTS; k < ESTIMATES; k++) {
			const struct estimates *t = identify(fast[i]);

			assert_int_equal(t->by[k].verdict, LEVER_FOUND);
			assert_vec_near(t->by[k].lever_arm_b_m, t->by[ALL].lever_arm_b_m, 0.001);
		}
}

/* With the delay estimated, two trials of one mounting (06, 15) agree better. */
static void test_all_trials_have_the_same_delay_and_estimating_it_makes_them_agree_better(void **state)
{
	struct vec3 apart[PARTS];

	(void)state;
	for (size_t i = 0; i < sizeof(KNOWN) / sizeof(KNOWN[0]); i++) {
		print(KNOWN[i].trial, &identify(KNOWN[i].trial)->by[DELAY_ESTIMATED]);
		assert_near(identify(KNOWN[i].trial)->by[DELAY_ESTIMATED].delay_s, -0.0026, 0.0005);
	}
	for (int k = ALL; k <= DELAY_ESTIMATED; k++)
		apart[k] = vec3_sub(identify("06")->by[k].lever_arm_b_m, identify("15")->by[k].lever_arm_b_m);
	assert_true(vec3_norm(apart[DELAY_ESTIMATED]) < 0.6 * vec3_norm(apart[ALL]));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_fast_trial_gives_each_axis_within_2_mm),
		cmocka_unit_test(test_the_error_of_every_trial_is_below_3_sigma),
		cmocka_unit_test(test_30_s_of_a_fast_trial_give_the_result_of_the_whole_trial),
		cmocka_unit_test(test_all_trials_have_the_same_delay_and_estimating_it_makes_them_agree_better),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
