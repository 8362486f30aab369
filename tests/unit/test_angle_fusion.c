#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>
#include <errno.h>
#include <math.h>

#include "model/angle_fusion.h"
#include "model/sim/rng.h"
#include "model/sim/signal.h"
#include "model/math/units.h"

#define ANGLE_NOISE(ANGLE, GYRO, INSTABILITY)                                 \
	{                                                                     \
		.angle_sigma_rad = ANGLE, .gyro_density_rad_s_sqrt_hz = GYRO, \
		.gyro_bias_instability_rad_s = INSTABILITY                    \
	}

static const double DT_S = 0.01;
static const struct noise_config NOISE = ANGLE_NOISE(0.035, 5e-4, 2e-4); /* 2 deg, 0.03 deg/s/sqrt(Hz), 0.01 deg/s */

static struct vec3 gauss3(struct rng *rng, double sigma)
{
	double x = rng_gauss(rng), y = rng_gauss(rng), z = rng_gauss(rng);

	return vec3_scale(sigma, (struct vec3){x, y, z});
}

static double angle_between(struct quat a, struct quat b)
{
	struct quat d = quat_multiply(quat_conjugate(a), b);

	return 2 * vec3_norm((struct vec3){d.x, d.y, d.z});
}

struct run {
	struct angle_fusion fusion;
	double rms_rad; /* of the last half, length of the error */
};

static struct run run_on(
	const char *signal, double seconds, struct vec3 bias_rad_s, const struct noise_config *noise, uint64_t seed)
{
	const double gyro_sigma = noise->gyro_density_rad_s_sqrt_hz * sqrt(0.5 / DT_S);
	const int n = (int)(seconds / DT_S);
	struct run run = {.rms_rad = 0};
	struct rng rng;

	rng_init(&rng, seed);
	assert_int_equal(angle_fusion_init(&run.fusion, noise), 0);
	for (int k = 0; k < n; k++) {
		struct signal_truth truth, middle;
		struct vec3 gyro;
		struct quat given;

		signal_at(signal_find(signal), k * DT_S, &truth);
		signal_at(signal_find(signal), fmax(0, (k - 0.5) * DT_S),
			&middle); /* the mean rate since the last sample */
		gyro = vec3_add(vec3_add(middle.omega_b_rad_s, bias_rad_s), gauss3(&rng, gyro_sigma));
		given = quat_multiply(truth.q_nb, quat_from_rotation_vector(gauss3(&rng, noise->angle_sigma_rad)));
		angle_fusion_step(&run.fusion, gyro, given, DT_S);
		if (k >= n / 2)
			run.rms_rad += pow(angle_between(run.fusion.q_nb, truth.q_nb), 2) / (n - n / 2);
	}
	run.rms_rad = sqrt(run.rms_rad);
	return run;
}

static void test_the_gyro_reduces_the_noise_of_given_angles(void **state)
{
	struct run run = run_on("rest", 60, (struct vec3){0, 0, 0}, &NOISE, 1);

	(void)state;
	assert_true(run.rms_rad < 0.2 * RAD_PER_DEG); /* the given angles have 3.5 degrees: 2 per axis */
}

static void test_fast_turns_are_followed_without_lag(void **state)
{
	struct run run = run_on("tumble", 60, (struct vec3){0, 0, 0}, &NOISE, 1);

	(void)state;
	assert_true(run.rms_rad < 0.5 * RAD_PER_DEG); /* one sample of lag would be up to 7 degrees */
}

static void test_the_gyro_bias_is_estimated(void **state)
{
	const struct vec3 bias = {1e-3, -5e-4, 8e-4};
	struct run run = run_on("square", 300, bias, &NOISE, 1);

	(void)state;
	assert_true(vec3_norm(vec3_sub(run.fusion.gyro_bias_b_rad_s, bias)) < 2e-4);
}

/* Over many runs. */
static void test_its_variance_is_that_of_its_errors(void **state)
{
	const struct noise_config noise = ANGLE_NOISE(0.01, 2e-3, 0);
	double squares = 0;

	(void)state;
	for (uint64_t seed = 0; seed < 100; seed++) {
		struct run run = run_on("rest", 10, (struct vec3){0, 0, 0}, &noise, seed);

		squares += run.rms_rad * run.rms_rad / 3 / 100 / run.fusion.p_angle;
	}
	assert_true(squares > 0.85 && squares < 1.15);
}

static void test_the_sign_of_a_given_quaternion_does_not_matter(void **state)
{
	struct quat q = quat_from_rotation_vector((struct vec3){0.3, 0.2, -0.1}), minus = {-q.w, -q.x, -q.y, -q.z};
	struct angle_fusion f;

	(void)state;
	assert_int_equal(angle_fusion_init(&f, &NOISE), 0);
	angle_fusion_step(&f, (struct vec3){0, 0, 0}, q, DT_S);
	angle_fusion_step(&f, (struct vec3){0, 0, 0}, minus, DT_S);
	assert_true(angle_between(f.q_nb, q) < 1e-12);
}

static void test_a_noise_out_of_range_is_refused(void **state)
{
	const struct noise_config bad[] = {ANGLE_NOISE(0, 1, 0), ANGLE_NOISE(-1, 1, 0), ANGLE_NOISE(1, 0, 0),
		ANGLE_NOISE(1, 1, -1), ANGLE_NOISE(NAN, 1, 0)};
	struct angle_fusion f;

	(void)state;
	for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
		assert_int_equal(angle_fusion_init(&f, &bad[i]), -EINVAL);
}

/* Where the angles tell next to nothing, the bias becomes less certain by its instability in 100 s; at the start it is
 * known to ten of them. */
static void test_the_bias_is_known_to_ten_instabilities_and_walks_by_one_in_100_s(void **state)
{
	const double instability = NOISE.gyro_bias_instability_rad_s;
	struct noise_config blind = NOISE;
	struct angle_fusion f;

	(void)state;
	blind.angle_sigma_rad = 1e6;
	assert_int_equal(angle_fusion_init(&f, &blind), 0);
	for (int k = 0; k < 10001; k++) {
		double grown = f.p_bias / (instability * instability);

		assert_true(fabs(grown - 100 - fmax(0, (k - 1) / 1e4)) < 1e-3);
		angle_fusion_step(&f, (struct vec3){0, 0, 0}, (struct quat){1, 0, 0, 0}, DT_S);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_the_gyro_reduces_the_noise_of_given_angles),
		cmocka_unit_test(test_fast_turns_are_followed_without_lag),
		cmocka_unit_test(test_the_gyro_bias_is_estimated),
		cmocka_unit_test(test_its_variance_is_that_of_its_errors),
		cmocka_unit_test(test_the_sign_of_a_given_quaternion_does_not_matter),
		cmocka_unit_test(test_the_bias_is_known_to_ten_instabilities_and_walks_by_one_in_100_s),
		cmocka_unit_test(test_a_noise_out_of_range_is_refused),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
