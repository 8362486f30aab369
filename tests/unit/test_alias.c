/* Vibration that samples show as a slow acceleration: when that is told, and what the position's sigma is worth. The
 * truth is an object that stands. */
#include "model_test.h"

#include "model/alias.h"
#include "model/pipeline.h"
#include "model/sim/rng.h"

static const double INTERVAL_S = 0.04;

/* Steps with a sine along x that turns in phase with it about y, from its phase 1 on. Returns the time after which it
 * may be an alias, or -1. */
static double found_after(double amplitude_m_s2, double hz, double turn_rad, double most_s, struct alias *a)
{
	const double w = 2 * PI * hz;

	*a = (struct alias){.velocity_m_s = {0}};
	for (double t = INTERVAL_S; t < most_s; t += INTERVAL_S) {
		struct vec3 accel = {amplitude_m_s2 * sin(1 + w * t) + 0.01, 0.02, -0.01};
		double turned = turn_rad * (sin(1 + w * t) - sin(1 + w * (t - INTERVAL_S)));

		alias_step(a, accel, (struct vec3){0, turned, 0}, INTERVAL_S);
		if (a->velocity_m_s[0] > 0)
			return t;
	}
	return -1;
}

static void test_a_sine_without_a_turn_may_be_an_alias_of_the_velocity_of_its_integral(void **state)
{
	static const double HZ[] = {0.1, 0.5, 1, 2, 3};

	(void)state;
	for (size_t i = 0; i < sizeof HZ / sizeof *HZ; i++) {
		struct alias a;
		double period = 1 / HZ[i], after = found_after(0.6, HZ[i], 0, 5 * period, &a),
		       v = 0.6 / (2 * PI * HZ[i]);

		if (after < period || after > (HZ[i] <= 1 ? 2 : 3) * period)
			fail_msg("%.1f Hz: found after %.2f s", HZ[i], after);
		assert_near(a.velocity_m_s[0], v, 0.15 * v);
		assert_near(a.position_m[0], v / (2 * PI * HZ[i]), 0.3 * v / (2 * PI * HZ[i]));
		assert_true(a.found_s[0] > period / 2 && a.found_s[0] <= after);
		assert_true(a.velocity_m_s[1] == 0 && a.velocity_m_s[2] == 0);
	}
}

/* A load on a rope, and an arm, turn by the acceleration over gravity or more. */
static void test_what_turns_with_its_acceleration_is_no_alias(void **state)
{
	struct alias a;

	(void)state;
	assert_true(found_after(0.6, 0.22, 0.6 / 9.81, 60, &a) < 0);
	assert_true(found_after(3, 0.5, 1, 60, &a) < 0);
}

static void test_drives_and_random_vibration_are_no_alias(void **state)
{
	struct alias a = {.velocity_m_s = {0}};
	const struct vec3 none = {0, 0, 0};
	struct rng noise;
	double x = 0;

	(void)state;
	rng_init(&noise, 1);
	for (double t = 0; t < 600; t += INTERVAL_S) { /* there, back, every 12 s: 1 m/s, ramps of 1 s, stops of 2 s */
		double in = fmod(t, 6), side = fmod(t, 12) < 6 ? 1 : -1, ramp = in < 1 ? 1 : in > 3 && in < 4 ? -1 : 0;

		x += INTERVAL_S / 0.1 * (rng_gauss(&noise) - x);
		alias_step(&a, (struct vec3){side * ramp * PI / 2 * sin(PI * fmod(in, 1)), x, rng_gauss(&noise)}, none,
			INTERVAL_S);
		if (a.velocity_m_s[0] + a.velocity_m_s[1] + a.velocity_m_s[2] > 0)
			fail_msg("after %.2f s", t);
	}
}

static void test_the_end_of_an_alias_is_told_once(void **state)
{
	const struct vec3 none = {0, 0, 0};
	struct alias a;
	double before;
	int ended = 0;

	(void)state;
	assert_true(found_after(0.6, 1, 0, 5, &a) > 0);
	before = a.velocity_m_s[0];
	for (double t = 0; t < 3; t += INTERVAL_S) {
		alias_step(&a, none, none, INTERVAL_S);
		ended += a.ended_m_s[0] > 0;
		assert_true(a.ended_m_s[0] == 0 || a.ended_m_s[0] == before);
	}
	assert_int_equal(ended, 1);
	assert_true(a.velocity_m_s[0] == 0);
}

enum { REST_S = 10, SHAKEN_S = 40, AFTER_S = 10, RATE_HZ = 100 };

/* Amplitudes behind a low-pass of 40 Hz: 0.16 at 100 Hz, 0.04 at 200 Hz of what it is before. */
static const struct shaking {
	double hz, amplitude_m_s2, most_beyond; /* .. share of the time after the first 10 s */
} SHAKINGS[] = {
	{100.1, 0.8, 0.4},
	{99.5, 0.3, 0.1},
	{100.5, 1.6, 0.1},
	{101, 0.8, 0.05},
	{198, 0.4, 0.05},
	{98, 1.6, 0.05},
};

static void test_a_position_that_an_alias_has_moved_is_within_three_sigma_from_two_periods_on(void **state)
{
	(void)state;
	for (size_t i = 0; i < sizeof SHAKINGS / sizeof *SHAKINGS; i++) {
		const struct shaking *c = &SHAKINGS[i];
		struct pipeline_config config = PIPELINE_DEFAULTS;
		static struct pipeline p;
		struct pipeline_output out = {.t_us = 0};
		int beyond = 0, told = 0, last = 0;
		struct rng noise;

		config.latency.sensor_s = config.latency.accelerometer_s = 0;
		config.fusion.use_magnetometer = 0;
		rng_init(&noise, i);
		assert_int_equal(pipeline_init(&p, &config, RATE_HZ), 0);
		for (int k = 0; k < (REST_S + SHAKEN_S + AFTER_S) * RATE_HZ; k++) {
			double t = (double)k / RATE_HZ;
			bool on = t >= REST_S && t < REST_S + SHAKEN_S;
			double wave = on ? c->amplitude_m_s2 * sin(2 * PI * c->hz * t) : 0;
			struct imu_sample s = {
				.t_us = (uint64_t)llround(1e6 * t),
				.gyro_rad_s = {1e-3 * rng_gauss(&noise), 1e-3 * rng_gauss(&noise),
					1e-3 * rng_gauss(&noise)},
				.accel_m_s2 = {0.3 * wave + 0.01 * rng_gauss(&noise),
					-0.3 * wave + 0.01 * rng_gauss(&noise), 9.81 + wave + 0.01 * rng_gauss(&noise)},
			};
			struct vec3 off, sigma;

			assert_int_equal(pipeline_step(&p, &s, &out), 0);
			off = out.position_n_m;
			sigma = out.sigma.position_m;
			last = fabs(off.x) > 3 * sigma.x + 1e-3 || fabs(off.y) > 3 * sigma.y + 1e-3 ||
			       fabs(off.z) > 3 * sigma.z + 1e-3;
			beyond += last;
			told += on && (out.status & PIPELINE_VIBRATION) != 0;
		}
		if (last || beyond > c->most_beyond * (SHAKEN_S + AFTER_S) * RATE_HZ)
			fail_msg("%.1f Hz: beyond 3 sigma for %d samples, at the end %d", c->hz, beyond, last);
		if (told < SHAKEN_S * RATE_HZ / 2)
			fail_msg("%.1f Hz: told for %d samples", c->hz, told);
	}
}

/* ---- limits of what counts as an alias ---- */

/* Half-waves in turn up and down, two kinds one after the other: a sine to this power. Each turns the object, and has
 * a dip in its middle, of one sample. */
struct half_waves {
	double time_s[2], peak_m_s2[2], power, turn_rad, dip_m_s2;
	bool turns_at_once; /* with its first sample */
};

static const struct half_waves ALIKE_WAVES = {{0.5, 0.5}, {1, 1}, 1, 0, 0, false};

static bool found_in(const struct half_waves *w, int count)
{
	const double dt_s = 1e-3;
	struct alias a = {.velocity_m_s = {0}};
	bool found = false;

	for (int h = 0; h < count; h++) {
		const int samples = (int)lround(w->time_s[h % 2] / dt_s);

		for (int k = 0; k < samples; k++) {
			const double shape = pow(sin(PI * (k + 0.5) / samples), w->power);
			const double accel =
				k == samples / 2 && w->dip_m_s2 > 0 ? -w->dip_m_s2 : w->peak_m_s2[h % 2] * shape;

			alias_step(&a, (struct vec3){0, h % 2 ? -accel : accel, 0},
				(struct vec3){0, 0, w->turns_at_once ? w->turn_rad * (k == 0) : w->turn_rad / samples},
				dt_s);
			found |= a.velocity_m_s[1] > 0;
		}
	}
	return found;
}

/* The first has none before it to be like. The end of the last shows with the next one. */
static void test_two_half_waves_above_0_4_s_suffice_four_are_needed_below_and_none_below_0_1_s_counts(void **state)
{
	(void)state;
	for (double time_s = 0.38; time_s < 0.43; time_s += 0.04) {
		struct half_waves w = ALIKE_WAVES;

		w.time_s[0] = w.time_s[1] = time_s;
		assert_false(found_in(&w, 3));
		assert_int_equal(found_in(&w, 4), time_s > 0.4);
		assert_int_equal(found_in(&w, 5), time_s > 0.4);
		assert_true(found_in(&w, 6));
		w.time_s[0] = w.time_s[1] = time_s / 4; /* 0.095 and 0.105 s */
		assert_int_equal(found_in(&w, 20), time_s > 0.4);
	}
}

/* By 1.3, as they are seen: what has a larger peak ends later. */
static void test_half_waves_are_alike_whose_times_and_areas_differ_by_less_than_a_third(void **state)
{
	(void)state;
	for (int apart = 0; apart < 2; apart++)
		for (int second = 0; second < 2; second++) {
			struct half_waves longer = ALIKE_WAVES, larger = ALIKE_WAVES, both = ALIKE_WAVES;

			longer.time_s[second] *= apart ? 1.8 : 1.22;
			longer.peak_m_s2[second] /= apart ? 1.8 : 1.22; /* of the same area */
			assert_int_equal(found_in(&longer, 10), !apart);
			larger.peak_m_s2[second] *= apart ? 1.4 : 1.22;
			assert_int_equal(found_in(&larger, 10), !apart);
			both.time_s[second] *= 1.26; /* an area of 1.59 times as much */
			both.peak_m_s2[second] *= 1.26;
			assert_false(found_in(&both, 10));
		}
}

/* The area as a share of peak times time: 0.5 to 0.8. A half-wave ends a moment later than its acceleration. */
static void test_half_waves_are_as_full_as_a_sine(void **state)
{
	(void)state;
	for (double power = 0.25; power < 3; power += 0.05) {
		struct half_waves w = ALIKE_WAVES;
		double full = 0;

		for (int k = 0; k < 1000; k++)
			full += pow(sin(PI * (k + 0.5) / 1000), power) / 1000;
		w.power = power;
		if (fabs(full - 0.5) > 0.03 && fabs(full - 0.8) > 0.03)
			assert_int_equal(found_in(&w, 10), full > 0.5 && full < 0.8);
	}
}

/* What hangs turns by its acceleration / gravity. That of the half-wave before counts as well. */
static void test_a_turn_of_a_fifth_of_what_hangs_explains_the_acceleration(void **state)
{
	(void)state;
	for (int i = 0; i < 4; i++) {
		const bool much = i % 2;
		struct half_waves w = ALIKE_WAVES;

		w.turns_at_once = i / 2;
		w.peak_m_s2[0] = w.peak_m_s2[1] = 2;
		w.turn_rad = (much ? 0.21 : 0.19) * 2 / 9.80665;
		assert_int_equal(found_in(&w, 10), !much);
	}
}

/* A moment of the other sign ends a half-wave when it is above 0.04 m/s^2 and a fifth of the peak. */
static void test_a_small_dip_does_not_end_a_half_wave(void **state)
{
	static const struct {
		double peak_m_s2, dip_m_s2;
	} dips[] = {{1, 0.2}, {0.1, 0.04}};

	(void)state;
	for (int i = 0; i < 2; i++)
		for (int large = 0; large < 2; large++) {
			struct half_waves w = ALIKE_WAVES;

			w.peak_m_s2[0] = w.peak_m_s2[1] = dips[i].peak_m_s2;
			w.dip_m_s2 = (large ? 1.05 : 0.95) * dips[i].dip_m_s2;
			assert_int_equal(found_in(&w, 10), !large);
		}
}

/* A steady acceleration in the place of the next half-wave: half as long again as the last one, it is none. That was
 * seen from a fifth of its peak on. */
static void test_what_lasts_half_as_long_again_is_no_longer_an_alias(void **state)
{
	const double dt_s = 1e-3;
	struct alias a = {.velocity_m_s = {0}};
	int k = 0;

	(void)state;
	for (; k < 2500; k++)
		alias_step(&a, (struct vec3){sin(2 * PI * (k + 0.5) * dt_s), 0, 0}, (struct vec3){0, 0, 0}, dt_s);
	assert_true(a.velocity_m_s[0] > 0);
	for (k = 0; k < 1000 && a.velocity_m_s[0] > 0; k++)
		alias_step(&a, (struct vec3){-1, 0, 0}, (struct vec3){0, 0, 0}, dt_s);
	assert_near(k * dt_s, 1.5 * (0.5 - asin(0.2) / (2 * PI)), 0.003);
	assert_near(a.ended_m_s[0], 0.5 / PI, 0.005); /* half the area of a half-wave of a sine of 0.5 s */
	assert_near(a.ended_m[0], a.ended_m_s[0] * 0.5 / PI, 0.002);
	alias_step(&a, (struct vec3){-1, 0, 0}, (struct vec3){0, 0, 0}, dt_s);
	assert_true(a.ended_m_s[0] == 0 && a.ended_m[0] == 0);
}

/* When the fourth half-wave begins, in which the alias is found, it has lasted for three. */
static void test_the_time_since_an_alias_began_is_told_once(void **state)
{
	const double dt_s = 1e-3;
	struct alias a = {.velocity_m_s = {0}};
	int told = 0;

	(void)state;
	for (int k = 0; k < 2500; k++) {
		alias_step(&a, (struct vec3){0, 0, 0.5 * sin(2 * PI * (k + 0.5) * dt_s)}, (struct vec3){0, 0, 0}, dt_s);
		if (a.found_s[2] > 0) {
			assert_near(a.found_s[2], 1.5, 0.04);
			told++;
		}
	}
	assert_int_equal(told, 1);
	assert_true(a.velocity_m_s[2] > 0 && a.found_s[0] == 0 && a.found_s[1] == 0);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_sine_without_a_turn_may_be_an_alias_of_the_velocity_of_its_integral),
		cmocka_unit_test(test_what_turns_with_its_acceleration_is_no_alias),
		cmocka_unit_test(test_drives_and_random_vibration_are_no_alias),
		cmocka_unit_test(test_the_end_of_an_alias_is_told_once),
		cmocka_unit_test(test_a_position_that_an_alias_has_moved_is_within_three_sigma_from_two_periods_on),
		cmocka_unit_test(
			test_two_half_waves_above_0_4_s_suffice_four_are_needed_below_and_none_below_0_1_s_counts),
		cmocka_unit_test(test_half_waves_are_alike_whose_times_and_areas_differ_by_less_than_a_third),
		cmocka_unit_test(test_half_waves_are_as_full_as_a_sine),
		cmocka_unit_test(test_a_turn_of_a_fifth_of_what_hangs_explains_the_acceleration),
		cmocka_unit_test(test_a_small_dip_does_not_end_a_half_wave),
		cmocka_unit_test(test_what_lasts_half_as_long_again_is_no_longer_an_alias),
		cmocka_unit_test(test_the_time_since_an_alias_began_is_told_once),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
