/* A chip that is noisier than told: the densities that standstills show, against white noise of a known one, and what
 * the navigation makes of them. */
#include "model_test.h"

#include "model/noise_seen.h"
#include "model/pipeline.h"
#include "model/sim/rng.h"

static const struct noise_config TOLD = {.gyro_density_rad_s_sqrt_hz = 5e-4, .accel_density_m_s2_sqrt_hz = 2e-3};

/* White noise of one-sided densities, and a sine, for some time. */
struct signal {
	double gyro_density, accel_density, amplitude_m_s2, hz;
};

static struct vec3 white(struct rng *rng, double density, double t_s)
{
	double sigma = density / sqrt(2 * t_s);

	return (struct vec3){sigma * rng_gauss(rng), sigma * rng_gauss(rng), sigma * rng_gauss(rng)};
}

static void feed(struct noise_seen *s, struct rng *rng, struct signal signal, double t_s, double for_s)
{
	for (double at_s = 0; at_s < for_s; at_s += t_s) {
		struct vec3 accel = white(rng, signal.accel_density, t_s);

		accel.x += signal.amplitude_m_s2 * sin(2 * PI * signal.hz * at_s) + 0.3;
		noise_seen_step(s, &TOLD, accel, white(rng, signal.gyro_density, t_s), t_s);
	}
}

static void test_nothing_seen_is_what_was_told(void **state)
{
	struct noise_seen s = {0};
	struct noise_config noise = noise_seen(&s, &TOLD);

	(void)state;
	assert_memory_equal(&noise, &TOLD, sizeof(TOLD));
}

/* What is seen of a new chip with that signal after some time. */
static struct noise_config seen_of(struct signal signal, double interval_s, double for_s, uint64_t seed)
{
	struct noise_seen s = {0};
	struct rng rng;

	rng_init(&rng, seed);
	feed(&s, &rng, signal, interval_s, for_s);
	return noise_seen(&s, &TOLD);
}

static void test_more_noise_than_told_is_seen_at_any_rate(void **state)
{
	static const double INTERVAL_S[] = {0.04, 0.042, 0.02, 0.1};

	(void)state;
	for (size_t i = 0; i < sizeof INTERVAL_S / sizeof *INTERVAL_S; i++) {
		struct noise_config noise = seen_of((struct signal){2e-3, 6e-3, 0, 0}, INTERVAL_S[i], 60, i);

		assert_near(noise.gyro_density_rad_s_sqrt_hz / 2e-3, 1, 0.15);
		assert_near(noise.accel_density_m_s2_sqrt_hz / 6e-3, 1, 0.15);
	}
}

static void test_slow_samples_show_nothing(void **state)
{
	static const double INTERVAL_S[] = {0.2, 0.5, 1, 7};

	(void)state;
	for (size_t i = 0; i < sizeof INTERVAL_S / sizeof *INTERVAL_S; i++) {
		struct noise_config noise = seen_of((struct signal){2e-3, 6e-3, 0, 0}, INTERVAL_S[i], 100, i);

		assert_memory_equal(&noise, &TOLD, sizeof(TOLD));
	}
}

static void test_less_noise_than_told_is_what_was_told(void **state)
{
	struct noise_config noise = seen_of((struct signal){2e-4, 1e-3, 0, 0}, 0.04, 120, 1);

	(void)state;
	assert_memory_equal(&noise, &TOLD, sizeof(TOLD));
}

static void test_five_seconds_show_it(void **state)
{
	(void)state;
	for (uint64_t seed = 0; seed < 50; seed++)
		assert_true(
			seen_of((struct signal){2e-3, 8e-3, 0, 0}, 0.04, 5, seed).accel_density_m_s2_sqrt_hz > 4e-3);
}

static void test_a_vibration_is_no_noise(void **state)
{
	(void)state;
	for (double hz = 8; hz < 12; hz += 0.1) { /* aliases of the interval, too */
		struct noise_config noise = seen_of((struct signal){4e-4, 1.5e-3, 0.3, hz}, 0.04, 60, 1);

		assert_near(noise.accel_density_m_s2_sqrt_hz / 2e-3, 1, 0.05);
	}
}

static void test_a_knock_is_no_noise(void **state)
{
	struct noise_seen s = {0};
	struct rng rng;

	(void)state;
	rng_init(&rng, 1);
	feed(&s, &rng, (struct signal){5e-4, 2e-3, 0, 0}, 0.04, 60);
	noise_seen_step(&s, &TOLD, (struct vec3){50, 0, 0}, (struct vec3){5, 0, 0}, 0.04);
	feed(&s, &rng, (struct signal){5e-4, 2e-3, 0, 0}, 0.04, 5);
	assert_true(noise_seen(&s, &TOLD).accel_density_m_s2_sqrt_hz < 1.3 * 2e-3);
	assert_true(noise_seen(&s, &TOLD).gyro_density_rad_s_sqrt_hz < 1.3 * 5e-4);
}

/* What was seen half a minute ago counts a third. */
static void test_a_chip_that_becomes_quiet_is_trusted_again(void **state)
{
	struct noise_seen s = {0};
	struct rng rng;

	(void)state;
	rng_init(&rng, 1);
	feed(&s, &rng, (struct signal){2e-3, 8e-3, 0, 0}, 0.04, 60);
	feed(&s, &rng, (struct signal){2e-4, 1e-3, 0, 0}, 0.04, 120);
	assert_near(noise_seen(&s, &TOLD).accel_density_m_s2_sqrt_hz, 2e-3, 0.2e-3);
}

static void test_a_step_between_two_standstills_is_no_noise(void **state)
{
	struct noise_seen s = {0}, before;
	struct noise_config noise;

	(void)state;
	for (int k = 0; k < 100; k++)
		noise_seen_step(&s, &TOLD, (struct vec3){0, 0, 9.81}, (struct vec3){0, 0, 0}, 0.04);
	before = s;
	noise_seen_break(&s);
	assert_near(s.differences, before.differences, 0);
	for (int k = 0; k < 100; k++)
		noise_seen_step(&s, &TOLD, (struct vec3){5, 0, 8}, (struct vec3){1, 0, 0}, 0.04);
	noise = noise_seen(&s, &TOLD);
	assert_memory_equal(&noise, &TOLD, sizeof(TOLD));
}

/* ---- in the navigation ------------------------------------------------------------------------------------------- */

enum { RATE_HZ = 100 };

/* An object that stands for 20 s and creeps along x at 0.05 m/s for 40 s, which it reaches within a second. */
static struct pipeline_output creep(struct pipeline *p, enum motion_preset preset, double noise_factor, uint64_t seed)
{
	struct pipeline_config c = PIPELINE_DEFAULTS;
	const double gyro = noise_factor * c.noise.gyro_density_rad_s_sqrt_hz,
		     accel = noise_factor * c.noise.accel_density_m_s2_sqrt_hz;
	struct pipeline_output out;
	struct rng rng;

	rng_init(&rng, seed);
	c.position.navigation.preset = preset;
	c.position.longest_integration_s = 0;
	assert_int_equal(pipeline_init(p, &c, RATE_HZ), 0);
	for (uint64_t k = 1; k <= 60 * RATE_HZ; k++) {
		double t_s = (double)k / RATE_HZ;
		struct imu_sample sample = {
			.t_us = k * 1000000 / RATE_HZ, .gyro_rad_s = white(&rng, gyro, 1.0 / RATE_HZ)};

		sample.accel_m_s2 = white(&rng, accel, 1.0 / RATE_HZ);
		sample.accel_m_s2.x += t_s > 20 && t_s < 21 ? 0.05 * PI / 2 * sin(PI * (t_s - 20)) : 0;
		sample.accel_m_s2.z += 9.81;
		assert_int_equal(pipeline_step(p, &sample, &out), 0);
	}
	return out;
}

static struct pipeline pipeline;

static void test_a_noisy_chip_does_not_take_a_slow_motion_for_a_sure_standstill(void **state)
{
	(void)state;
	for (uint64_t seed = 0; seed < 8; seed++) {
		struct pipeline_output out = creep(&pipeline, MOTION_ANY, 2, seed);

		assert_true(out.status & PIPELINE_VALID);
		assert_true(fabs(out.position_n_m.x - 0.05 * 39.5) < 3 * out.sigma.position_m.x);
	}
}

static void test_the_noise_of_a_hand_is_not_the_chip_s(void **state)
{
	(void)state;
	creep(&pipeline, MOTION_HAND_HELD, 2, 1); /* a preset that does not stand by dwell sees it, below */
	assert_memory_equal(&pipeline.position.navigation.noise, &PIPELINE_DEFAULTS.noise, sizeof(struct noise_config));
}

static void test_the_noise_seen_outlasts_a_restart_of_the_navigation(void **state)
{
	struct navigation *n = &pipeline.position.navigation;
	double seen;

	(void)state;
	creep(&pipeline, MOTION_ANY, 2, 1);
	seen = n->noise.accel_density_m_s2_sqrt_hz;
	assert_near(seen / PIPELINE_DEFAULTS.noise.accel_density_m_s2_sqrt_hz, 2, 0.3);
	navigation_start(n, &PIPELINE_DEFAULTS.position.navigation, n->q_nb);
	assert_true(n->noise.accel_density_m_s2_sqrt_hz >= 0.9 * seen);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_nothing_seen_is_what_was_told),
		cmocka_unit_test(test_more_noise_than_told_is_seen_at_any_rate),
		cmocka_unit_test(test_slow_samples_show_nothing),
		cmocka_unit_test(test_less_noise_than_told_is_what_was_told),
		cmocka_unit_test(test_five_seconds_show_it),
		cmocka_unit_test(test_a_vibration_is_no_noise),
		cmocka_unit_test(test_a_knock_is_no_noise),
		cmocka_unit_test(test_a_chip_that_becomes_quiet_is_trusted_again),
		cmocka_unit_test(test_a_step_between_two_standstills_is_no_noise),
		cmocka_unit_test(test_a_noisy_chip_does_not_take_a_slow_motion_for_a_sure_standstill),
		cmocka_unit_test(test_the_noise_of_a_hand_is_not_the_chip_s),
		cmocka_unit_test(test_the_noise_seen_outlasts_a_restart_of_the_navigation),
	};

	return cmocka_run_group_tests_name("noise seen", tests, NULL, NULL);
}
