/* Samples that are read wrongly: what is integrated of them, and what the pipeline publishes after them. */
#include "model_test.h"

#include "model/glitch.h"
#include "model/pipeline.h"

static const double DT_S = 0.01, LEAST = 1;

/* The integral of what glitch_step() returns for these values of x, and of the values. */
struct integrals {
	double held, given;
	uint32_t glitches;
};

static struct integrals integrate(const double *x, int n)
{
	struct glitch g = {0};
	struct integrals sum = {0};

	for (int i = 0; i < n; i++) {
		sum.held += DT_S * glitch_step(&g, (struct vec3){x[i], 2, -3}, LEAST, DT_S).x;
		sum.given += DT_S * x[i];
	}
	sum.glitches = g.count;
	return sum;
}

static struct glitch at_rest(void)
{
	struct glitch g = {0};

	for (int i = 0; i < 3; i++)
		glitch_step(&g, (struct vec3){0, 0, 0}, LEAST, DT_S);
	return g;
}

static void test_a_single_sample_that_was_misread_is_not_integrated(void **state)
{
	static const double X[] = {0.1, 0, 0.1, 30, 0, 0.1, 0, -900, 0.1, 0};
	struct integrals sum = integrate(X, 10);

	(void)state;
	assert_int_equal(sum.glitches, 2);
	assert_near(sum.held, sum.given - 0.3 + 9, 0.005);
}

static void test_a_step_is_integrated_to_the_last_digit(void **state)
{
	static const double X[] = {0, 0, 0, 30, 30, 31, 30, 29, 5, 5, 5};
	struct integrals sum = integrate(X, 11);

	(void)state;
	assert_int_equal(sum.glitches, 0);
	assert_near(sum.held, sum.given, 1e-12);
}

static void test_a_step_is_held_back_for_one_sample(void **state)
{
	struct glitch g = at_rest();

	(void)state;
	assert_near(glitch_step(&g, (struct vec3){8, 0, 0}, LEAST, DT_S).x, 0, 0);
	assert_near(glitch_step(&g, (struct vec3){8, 0, 0}, LEAST, DT_S).x, 16, 0);
	assert_near(glitch_step(&g, (struct vec3){8, 0, 0}, LEAST, DT_S).x, 8, 0);
}

static void test_smaller_jumps_and_quick_motions_pass_unchanged(void **state)
{
	static const double SMALL[] = {0, 0, 0.9, 0, 0, -0.9, 0}, QUICK[] = {0, 3, 9, 25, 4, -7, 2};

	(void)state;
	for (int k = 0; k < 2; k++) {
		struct glitch g = {0};

		for (int i = 0; i < 7; i++) {
			double x = k ? QUICK[i] : SMALL[i];

			assert_near(glitch_step(&g, (struct vec3){x, 0, 0}, LEAST, DT_S).x, x, 0);
		}
	}
}

static void test_two_samples_in_a_row_are_no_glitch(void **state)
{
	static const double X[] = {0, 0, 0, 30, 30, 0, 0, 0};
	struct integrals sum = integrate(X, 8);

	(void)state;
	assert_int_equal(sum.glitches, 0);
	assert_near(sum.held, sum.given, 1e-12);
}

/* Over missing samples any motion jumps. */
static void test_a_jump_over_a_pause_passes_unchanged(void **state)
{
	struct glitch g = at_rest();

	(void)state;
	assert_near(glitch_step(&g, (struct vec3){8, 0, 0}, LEAST, 5 * DT_S).x, 8, 0);
	assert_near(glitch_step(&g, (struct vec3){8, 0, 0}, LEAST, DT_S).x, 8, 0);
}

/* By the interval that it had; after a much shorter one not all of it. */
static void test_a_step_is_made_up_for_over_the_next_interval(void **state)
{
	const struct {
		double interval_s, expected;
	} cases[] = {{2 * DT_S, 8 + 8 / 2.0}, {DT_S / 2, 8 + 2 * 8}, {DT_S / 1000, 8 + 4 * 8}};

	(void)state;
	for (int k = 0; k < 3; k++) {
		struct glitch g = at_rest();

		glitch_step(&g, (struct vec3){8, 0, 0}, LEAST, DT_S);
		assert_near(
			glitch_step(&g, (struct vec3){8, 0, 0}, LEAST, cases[k].interval_s).x, cases[k].expected, 1e-9);
	}
}

static void test_the_first_samples_and_those_after_a_restart_pass_unchanged(void **state)
{
	struct glitch g = {.count = 7};

	(void)state;
	for (int k = 0; k < 2; k++) {
		assert_near(glitch_step(&g, (struct vec3){5, 0, 0}, LEAST, DT_S).x, 5, 0);
		assert_near(glitch_step(&g, (struct vec3){50, 0, 0}, LEAST, DT_S).x, 50, 0);
		glitch_step(&g, (struct vec3){50, 0, 0}, LEAST, DT_S);
		glitch_step(&g, (struct vec3){500, 0, 0}, LEAST, DT_S); /* held back, and forgotten */
		glitch_restart(&g);
		assert_int_equal(g.count, 7);
	}
}

/* ---- in the pipeline --------------------------------------------------------------------------------------------- */

enum { RATE_HZ = 100 };

/* An object that lies, with a misread sample each two seconds from 10 s on, of the gyro or the accelerometer. */
static struct pipeline_output lie(struct pipeline *p, struct vec3 gyro_rad_s, struct vec3 accel_m_s2)
{
	struct pipeline_config c = PIPELINE_DEFAULTS;
	struct pipeline_output out;

	c.position.longest_integration_s = 0;
	assert_int_equal(pipeline_init(p, &c, RATE_HZ), 0);
	for (uint64_t k = 1; k <= 30 * RATE_HZ; k++) {
		struct imu_sample sample = {.t_us = k * 1000000 / RATE_HZ,
			.gyro_rad_s = any_vec(0.002),
			.accel_m_s2 = vec3_add((struct vec3){0, 0, 9.81}, any_vec(0.02)),
			.mag_uT = vec3_add((struct vec3){0, 20, -44}, any_vec(0.5)),
			.flags = SAMPLE_MAG};

		if (k > 10 * RATE_HZ && k % (2 * RATE_HZ) == 0) {
			sample.gyro_rad_s = vec3_add(sample.gyro_rad_s, gyro_rad_s);
			sample.accel_m_s2 = vec3_add(sample.accel_m_s2, accel_m_s2);
		}
		assert_int_equal(pipeline_step(p, &sample, &out), 0);
	}
	return out;
}

static struct pipeline pipeline;

static void test_what_lies_stays_where_it_is_and_level(void **state)
{
	static const struct vec3 NONE = {0, 0, 0};
	const struct {
		struct vec3 gyro_rad_s, accel_m_s2;
	} cases[] = {{{35, 0, 0}, NONE}, {{0, -8, 8}, NONE}, {NONE, {0, 30, 0}}, {NONE, {-39, 39, 20}},
		{{0.6, 0, 0}, {6, 0, 0}}};

	(void)state;
	for (int i = 0; i < 5; i++) {
		struct pipeline_output out = lie(&pipeline, cases[i].gyro_rad_s, cases[i].accel_m_s2);

		assert_true(pipeline.gyro_glitch.count + pipeline.accel_glitch.count >= 9);
		assert_true(out.status & PIPELINE_VALID && out.status & PIPELINE_REST);
		assert_true(vec3_norm(out.position_n_m) < 0.01);
		assert_true(fabs(out.angles_rad.x) + fabs(out.angles_rad.y) < 0.1 * RAD_PER_DEG);
		assert_true(vec3_norm(out.sigma.position_m) < 0.1);
	}
}

static void test_the_samples_themselves_are_published(void **state)
{
	struct pipeline_output out;
	const struct imu_sample knock = {.t_us = 30010000, .accel_m_s2 = {20, 0, 9.81}};

	(void)state;
	lie(&pipeline, (struct vec3){0, 0, 0}, (struct vec3){0, 0, 0});
	pipeline_step(&pipeline, &knock, &out);
	assert_vec_near(out.force_b_m_s2, knock.accel_m_s2, 1e-12);
	assert_true(out.accel_n_m_s2.x > 15);
}

static void test_a_discontinuity_keeps_their_number(void **state)
{
	struct imu_sample other = {.t_us = 30010000, .accel_m_s2 = {0, 0, 9.81}, .flags = SAMPLE_DISCONTINUITY};
	struct pipeline_output out;
	uint32_t glitches;

	(void)state;
	lie(&pipeline, (struct vec3){5, 0, 0}, (struct vec3){20, 0, 0});
	glitches = pipeline.gyro_glitch.count + pipeline.accel_glitch.count;
	assert_int_equal(glitches, 18); /* the last one is not known to be one yet */
	pipeline_step(&pipeline, &other, &out);
	assert_int_equal(pipeline.gyro_glitch.count + pipeline.accel_glitch.count, glitches);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_single_sample_that_was_misread_is_not_integrated),
		cmocka_unit_test(test_a_step_is_integrated_to_the_last_digit),
		cmocka_unit_test(test_a_step_is_held_back_for_one_sample),
		cmocka_unit_test(test_smaller_jumps_and_quick_motions_pass_unchanged),
		cmocka_unit_test(test_two_samples_in_a_row_are_no_glitch),
		cmocka_unit_test(test_a_jump_over_a_pause_passes_unchanged),
		cmocka_unit_test(test_a_step_is_made_up_for_over_the_next_interval),
		cmocka_unit_test(test_the_first_samples_and_those_after_a_restart_pass_unchanged),
		cmocka_unit_test(test_what_lies_stays_where_it_is_and_level),
		cmocka_unit_test(test_the_samples_themselves_are_published),
		cmocka_unit_test(test_a_discontinuity_keeps_their_number),
	};

	return cmocka_run_group_tests_name("glitch", tests, NULL, NULL);
}
