/* Whatever the time stamps, the outputs are bounded by what was measured, or marked invalid. */
#include "model_test.h"

#include <stdio.h>
#include <string.h>

#include "model/pipeline.h"
#include "model/sim/rng.h"
#include "model/sim/sensor.h"
#include "tests/unit/descriptors.h"

enum { SAMPLES = 3000 };
static const uint64_t INTERVAL_US = 10000;

/* The interval before the k-th sample. */
static uint64_t even(struct rng *rng, int k)
{
	(void)rng, (void)k;
	return INTERVAL_US;
}

static uint64_t close_10us(struct rng *rng, int k)
{
	(void)rng;
	return k % 10 == 0 ? 10 : k % 10 == 1 ? 2 * INTERVAL_US - 10 : INTERVAL_US;
}

static uint64_t close_500us(struct rng *rng, int k)
{
	(void)rng;
	return k % 10 == 0 ? 500 : k % 10 == 1 ? 2 * INTERVAL_US - 500 : INTERVAL_US;
}

static uint64_t close_1us(struct rng *rng, int k)
{
	(void)rng;
	return k % 2 ? 1 : 2 * INTERVAL_US - 1;
}

static uint64_t jittered(struct rng *rng, int k)
{
	(void)k;
	return 1 + (uint64_t)(2 * (double)INTERVAL_US * rng_uniform(rng));
}

static uint64_t exponential(struct rng *rng, int k)
{
	(void)k;
	return 1 + (uint64_t)(-(double)INTERVAL_US * log(1e-9 + rng_uniform(rng)));
}

static uint64_t any_magnitude(struct rng *rng, int k)
{
	(void)k;
	return (uint64_t)pow(10, 5.5 * rng_uniform(rng));
}

static uint64_t bursts(struct rng *rng, int k)
{
	return k % 30 == 0 ? 30 * INTERVAL_US - 29 * 900 : 900 - (uint64_t)(200 * rng_uniform(rng));
}

static uint64_t gaps(struct rng *rng, int k)
{
	(void)k;
	return rng_uniform(rng) < 0.01 ? 3000000 : INTERVAL_US;
}

static const struct pattern {
	const char *name;
	uint64_t (*interval_us)(struct rng *rng, int k);
	int implausible; /* outputs kept back, at most */
} PATTERNS[] = {
	{"even", even, 0},
	{"10 us", close_10us, 0},
	{"500 us", close_500us, 0},
	{"1 us, every other sample", close_1us, 0},
	{"jittered", jittered, 0},
	{"exponential", exponential, 0},
	{"of any magnitude", any_magnitude, SAMPLES / 10},
	{"bursts", bursts, 0},
	{"gaps", gaps, 0},
};

static bool output_finite(const struct pipeline_output *o)
{
	return vec3_finite(o->rate_b_rad_s) && vec3_finite(o->alpha_b_rad_s2) && vec3_finite(o->accel_b_m_s2) &&
	       vec3_finite(o->accel_n_m_s2) && vec3_finite(o->angles_rad) && vec3_finite(o->velocity_n_m_s) &&
	       vec3_finite(o->position_n_m) && vec3_finite(o->sigma.attitude_rad) && vec3_finite(o->sigma.position_m) &&
	       isfinite(o->q_nb.w + o->q_nb.x + o->q_nb.y + o->q_nb.z);
}

/* The samples of a sensor whose clock is even, with the times of the pattern. */
static void run(const struct pattern *pattern, const char *motion, enum rate_source source, uint64_t seed)
{
	struct pipeline_config config = PIPELINE_DEFAULTS;
	struct sensor_config simulated = *sensor_preset("lsm303dlhc_l3gd20");
	double rate_most = 0, force_most = 0;
	struct pipeline_output out;
	static struct pipeline p;
	struct imu_sample s;
	struct sensor sensor;
	struct rng rng;
	uint64_t t_us = 1;

	config.estimator.lever_arm_b_m = simulated.lever_arm_b_m = (struct vec3){0.1, 0.05, -0.05};
	config.estimator.rates_from = source;
	assert_int_equal(pipeline_init(&p, &config, 100), 0);
	assert_int_equal(sensor_init(&sensor, &simulated, seed), 0);
	rng_init(&rng, seed);
	for (int k = 0; k < SAMPLES; k++) {
		sensor_next(&sensor, signal_find(motion), &s, NULL);
		t_us += pattern->interval_us(&rng, k);
		s.t_us = t_us;
		assert_int_equal(pipeline_step(&p, &s, &out), 0);
		rate_most = fmax(rate_most, vec3_norm(s.gyro_rad_s));
		force_most = fmax(force_most, vec3_norm(s.accel_m_s2));
		if (!output_finite(&out))
			fail_msg("%s, %s: sample %d is not finite", pattern->name, motion, k);
		if ((out.status & PIPELINE_VALID) && (vec3_norm(out.rate_b_rad_s) > 3 * rate_most + 0.5 ||
							     vec3_norm(out.accel_b_m_s2) > 3 * (force_most + 9.81)))
			fail_msg("%s, %s: sample %d is valid, with a rate of %g rad/s and %g m/s^2", pattern->name,
				motion, k, vec3_norm(out.rate_b_rad_s), vec3_norm(out.accel_b_m_s2));
	}
	/* an attitude that is corrected turns faster than any sensor: its derivative is another matter */
	if (source == RATES_FROM_GYRO && (int)p.implausible > pattern->implausible)
		fail_msg("%s, %s, source %d: %u outputs were kept back", pattern->name, motion, source, p.implausible);
}

static void test_outputs_stay_within_three_times_the_inputs_or_are_invalid_whatever_the_stamps(void **state)
{
	const char *const motions[] = {"square", "tumble", "pendulum", "rest"};

	(void)state;
	for (size_t i = 0; i < sizeof PATTERNS / sizeof *PATTERNS; i++)
		for (int motion = 0; motion < 4; motion++)
			for (uint64_t seed = 1; seed <= 2; seed++) {
				run(&PATTERNS[i], motions[motion], RATES_FROM_GYRO, seed);
				run(&PATTERNS[i], motions[motion], RATES_FROM_ANGLES, seed);
			}
}

/* The derivative of a steady turn's rate is 0, however close two samples are. */
static void test_two_stamps_close_to_each_other_give_no_angular_acceleration(void **state)
{
	const uint64_t close_us[] = {1, 10, 100, 500, 2000};

	(void)state;
	for (int i = 0; i < 5; i++) {
		struct pipeline_config config = PIPELINE_DEFAULTS;
		static struct pipeline p;
		struct pipeline_output out;
		struct rng rng;
		double even_most = 0, close_most = 0;
		uint64_t t_us = 0;

		rng_init(&rng, 1);
		assert_int_equal(pipeline_init(&p, &config, 100), 0);
		for (int k = 0; k < 2000; k++) {
			const double noise = 0.005;
			struct imu_sample s = {.accel_m_s2 = {0, 0, 9.81},
				.gyro_rad_s = {
					noise * rng_gauss(&rng), noise * rng_gauss(&rng), 1 + noise * rng_gauss(&rng)}};

			t_us += k >= 1000 && k % 10 == 0 ? close_us[i] : INTERVAL_US;
			s.t_us = t_us;
			assert_int_equal(pipeline_step(&p, &s, &out), 0);
			if (k > 100 && k < 1000)
				even_most = fmax(even_most, vec3_norm(out.alpha_b_rad_s2));
			if (k >= 1000)
				close_most = fmax(close_most, vec3_norm(out.alpha_b_rad_s2));
		}
		if (close_most > 2 * even_most)
			fail_msg("%d us: %g rad/s^2, %g with even stamps", (int)close_us[i], close_most, even_most);
	}
}

/* The attitude follows an accelerometer that was hit, quicker than any rate that the gyro measured. */
static void test_a_rate_beyond_what_was_measured_is_kept_back(void **state)
{
	struct pipeline_config config = PIPELINE_DEFAULTS;
	struct pipeline_output out, good = {.status = 0};
	static struct pipeline p;
	unsigned kept = 0;

	(void)state;
	config.estimator.rates_from = RATES_FROM_ANGLES;
	config.fusion.algorithm = FUSION_MADGWICK;
	config.fusion.madgwick_beta = 10;
	assert_int_equal(pipeline_init(&p, &config, 100), 0);
	for (int k = 0; k < 300; k++) {
		struct imu_sample s = {.t_us = (uint64_t)k * INTERVAL_US, .accel_m_s2 = {0, 0, 9.81}};

		if (k >= 100 && k < 120)
			s.accel_m_s2 = (struct vec3){9.81, 0, 0};
		assert_int_equal(pipeline_step(&p, &s, &out), 0);
		assert_int_equal(out.t_us, s.t_us);
		if (p.implausible == kept) {
			good = out;
			assert_true(vec3_norm(out.rate_b_rad_s) <= 0.5);
		} else {
			assert_int_equal(out.status & PIPELINE_VALID, 0);
			assert_vec_near(out.accel_n_m_s2, good.accel_n_m_s2, 0);
			assert_vec_near(out.rate_b_rad_s, good.rate_b_rad_s, 0);
			kept = p.implausible;
		}
	}
	assert_true(kept > 0 && kept < 100);
	assert_true(out.status & PIPELINE_VALID);
}

/* RMS of the tilt, degrees, on a swing of 30 degrees in a second. */
static double tilt_off_deg(double rate_hz)
{
	struct pipeline_config config = PIPELINE_DEFAULTS;
	struct sensor_config simulated = *sensor_preset("lsm303dlhc_l3gd20");
	const int samples = (int)(30 * rate_hz);
	struct pipeline_output out;
	struct signal_truth truth;
	static struct pipeline p;
	struct sensor sensor;
	struct imu_sample s;
	double sum = 0;

	config.latency.sensor_s = config.latency.accelerometer_s = 0;
	sensor_calibrate(&simulated);
	simulated.rate_hz = rate_hz;
	assert_int_equal(pipeline_init(&p, &config, rate_hz), 0);
	assert_int_equal(sensor_init(&sensor, &simulated, 1), 0);
	for (int k = 0; k < samples; k++) {
		struct vec3 up, true_up;

		sensor_next(&sensor, signal_find("pendulum"), &s, &truth);
		assert_int_equal(pipeline_step(&p, &s, &out), 0);
		up = quat_rotate_inverse(out.q_nb, (struct vec3){0, 0, 1});
		true_up = quat_rotate_inverse(truth.q_nb, (struct vec3){0, 0, 1});
		sum += k < samples / 10 ? 0 : pow(DEG_PER_RAD * vec3_norm(vec3_sub(up, true_up)), 2);
	}
	return sqrt(sum / (0.9 * samples));
}

static void test_the_tilt_degrades_gradually_with_fewer_samples_a_second(void **state)
{
	static const struct {
		double rate_hz, most_deg;
	} rates[] = {{8000, 0.7}, {1000, 0.7}, {100, 0.7}, {20, 0.8}, {10, 1.5}, {8, 2}, {5, 4}};

	(void)state;
	for (size_t i = 0; i < sizeof rates / sizeof *rates; i++) {
		double off_deg = tilt_off_deg(rates[i].rate_hz);

		if (!(off_deg < rates[i].most_deg))
			fail_msg("%g samples a second: %.2f deg", rates[i].rate_hz, off_deg);
	}
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_outputs_stay_within_three_times_the_inputs_or_are_invalid_whatever_the_stamps),
		cmocka_unit_test(test_two_stamps_close_to_each_other_give_no_angular_acceleration),
		cmocka_unit_test(test_the_tilt_degrades_gradually_with_fewer_samples_a_second),
		cmocka_unit_test(test_a_rate_beyond_what_was_measured_is_kept_back),
	};

	return cmocka_run_group_tests(tests, count_descriptors, no_descriptor_is_left);
}
