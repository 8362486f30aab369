/* Angular rate and acceleration: the differentiator, and the two sources side by side. */
#include "model_test.h"

#include <string.h>

#include "model/rates.h"

static const double RATE_HZ = 200, DT_S = 1 / 200.0;
static const struct filter_config SMOOTH = {FILTER_BUTTERWORTH, 2, 20}, OFF = {FILTER_OFF, 2, 20};

static struct differentiator3 differentiator(double cutoff_hz)
{
	struct differentiator3 d = {.value = {0, 0, 0}};

	differentiator3_tune(&d, cutoff_hz, RATE_HZ);
	return d;
}

static struct vec3 along(double v)
{
	return (struct vec3){v, -v, 2 * v};
}

static void test_a_primed_differentiator_has_a_derivative_of_zero(void **state)
{
	struct differentiator3 d = differentiator(20);

	(void)state;
	differentiator3_prime(&d, along(3));
	for (int k = 0; k < 10; k++)
		assert_vec_near(differentiator3_step(&d, along(3), DT_S), along(0), 1e-12);
}

static void test_the_derivative_of_a_parabola_is_followed_without_lag(void **state)
{
	struct differentiator3 d = differentiator(20);
	struct vec3 rate = along(0);

	(void)state;
	for (int k = 0; k <= 200; k++) {
		double t = k * DT_S;

		rate = differentiator3_step(&d, along(1 + 4 * t + 3 * t * t), DT_S);
	}
	assert_vec_near(rate, along(4 + 6 * 1.0), 1e-6);
}

static void test_uneven_sampling_times_do_not_disturb_the_derivative_of_a_ramp(void **state)
{
	struct differentiator3 d = differentiator(20);
	struct vec3 rate = along(0);
	double t = 0;

	(void)state;
	for (int k = 0; k < 400; k++) {
		double dt_s = DT_S * (1 + 0.3 * any());

		t += dt_s;
		rate = differentiator3_step(&d, along(4 * t), dt_s);
	}
	assert_vec_near(rate, along(4), 1e-6);
}

/* Within 30 % of the interval the poles are those of even sampling; beyond, those of the interval itself. */
static void test_the_poles_are_those_of_even_sampling_within_30_percent(void **state)
{
	(void)state;
	for (double share = 0.62; share < 1.5; share += 0.05) {
		struct differentiator3 even = differentiator(20), uneven = differentiator(20);
		double by_even = differentiator3_step(&even, along(1), DT_S).x;
		double by_uneven = share * differentiator3_step(&uneven, along(1), share * DT_S).x;

		assert_int_equal(fabs(by_uneven / by_even - 1) < 1e-9, fabs(share - 1) < 0.299);
	}
}

static void test_a_lower_cutoff_lets_less_noise_through(void **state)
{
	struct differentiator3 slow = differentiator(10), fast = differentiator(40);
	double slow_power = 0, fast_power = 0;

	(void)state;
	for (int k = 0; k < 2000; k++) {
		struct vec3 noise = any_vec(1);

		slow_power += pow(differentiator3_step(&slow, noise, DT_S).x, 2);
		fast_power += pow(differentiator3_step(&fast, noise, DT_S).x, 2);
	}
	/* power goes with the cube of the cut-off: 64, less where the rate bounds it */
	assert_true(fast_power > 20 * slow_power && fast_power < 80 * slow_power);
}

static void test_the_fastest_cutoff_is_stable(void **state)
{
	struct differentiator3 d = differentiator(1e9);

	(void)state;
	for (int k = 0; k < 2000; k++)
		assert_true(vec3_norm(differentiator3_step(&d, any_vec(1), DT_S)) < 10 * RATE_HZ);
}

/* A body that swings about an oblique axis: rate and acceleration in closed form. */
static const struct vec3 AXIS = {0.6, 0, 0.8};

static double swing_angle(double t)
{
	return 1.2 * sin(2 * t);
}

static struct rates rates(const struct filter_config *config)
{
	struct rates r;

	assert_int_equal(rates_init(&r, config, RATE_HZ), 0);
	return r;
}

static void step_swinging(struct rates *r, int k)
{
	double t = k * DT_S;
	struct vec3 gyro = vec3_scale(2.4 * cos(2 * t), AXIS);
	struct quat q = quat_from_rotation_vector(vec3_scale(swing_angle(t), AXIS));

	if (k == 0)
		rates_prime(r, gyro, q);
	else
		rates_step(r, gyro, q, DT_S);
}

static void test_both_sources_give_rate_and_acceleration_of_a_swinging_body(void **state)
{
	struct rates r = rates(&OFF);

	(void)state;
	for (int k = 0; k <= 600; k++)
		step_swinging(&r, k);
	for (int i = 0; i < RATE_SOURCES; i++) {
		/* the attitude shows the mean rate since the sample before: half an interval late */
		double t = 600 * DT_S - (i == RATES_FROM_ANGLES ? DT_S / 2 : 0);

		assert_vec_near(r.out[i].omega_b_rad_s, vec3_scale(2.4 * cos(2 * t), AXIS), 1e-4);
		assert_vec_near(r.out[i].alpha_b_rad_s2, vec3_scale(-4.8 * sin(2 * t), AXIS), 0.02);
	}
}

static void test_rates_from_the_attitude_are_independent_of_the_sign_of_the_quaternion(void **state)
{
	struct rates r = rates(&OFF);
	struct quat q = quat_from_rotation_vector((struct vec3){0, 0, 0.01});

	(void)state;
	rates_prime(&r, along(0), QUAT_IDENTITY);
	rates_step(&r, along(0), (struct quat){-q.w, -q.x, -q.y, -q.z}, DT_S);
	assert_vec_near(r.out[RATES_FROM_ANGLES].omega_b_rad_s, ((struct vec3){0, 0, 2}), 1e-9);
}

static void test_rates_from_the_attitude_pass_gimbal_lock_without_a_spike(void **state)
{
	struct rates r = rates(&SMOOTH);

	(void)state;
	for (int k = 0; k <= 400; k++) {
		struct vec3 turn = {0.001, PI / 4 + k * PI / 800, 0};
		struct quat q = quat_from_rotation_vector(turn);

		if (k == 0)
			rates_prime(&r, (struct vec3){0, RATE_HZ * PI / 800, 0}, q);
		else
			rates_step(&r, along(0), q, DT_S);
		assert_near(vec3_norm(r.out[RATES_FROM_ANGLES].omega_b_rad_s), RATE_HZ * PI / 800, 0.01);
		assert_near(vec3_norm(r.out[RATES_FROM_ANGLES].alpha_b_rad_s2), 0, 0.1);
	}
}

static void test_a_new_filter_continues_without_a_step(void **state)
{
	struct rates r = rates(&SMOOTH);
	struct body_rates before;

	(void)state;
	for (int k = 0; k <= 300; k++)
		step_swinging(&r, k);
	before = r.out[RATES_FROM_GYRO];
	assert_int_equal(rates_configure(&r, &(struct filter_config){FILTER_BUTTERWORTH, 4, 5}, RATE_HZ), 0);
	step_swinging(&r, 301);
	assert_vec_near(r.out[RATES_FROM_GYRO].omega_b_rad_s, before.omega_b_rad_s, 0.03);
	assert_vec_near(r.out[RATES_FROM_GYRO].alpha_b_rad_s2, before.alpha_b_rad_s2, 0.2);
}

static void test_a_filter_out_of_range_is_refused_and_the_old_one_stays(void **state)
{
	const struct filter_config bad = {FILTER_BUTTERWORTH, 9, 5};
	struct rates r = rates(&SMOOTH);

	(void)state;
	assert_int_equal(rates_configure(&r, &bad, RATE_HZ), -EINVAL);
	assert_int_equal(r.filter[0].config.order, 2);
	assert_int_equal(rates_init(&r, &bad, RATE_HZ), -EINVAL);
}

static void test_rates_begin_at_zero_whatever_the_memory_had(void **state)
{
	struct rates r;

	(void)state;
	memset(&r, 0x55, sizeof(r));
	assert_int_equal(rates_init(&r, &SMOOTH, RATE_HZ), 0);
	for (int i = 0; i < RATE_SOURCES; i++) {
		assert_vec_near(r.out[i].omega_b_rad_s, along(0), 0);
		assert_vec_near(r.out[i].alpha_b_rad_s2, along(0), 0);
	}
	rates_step(&r, along(0), QUAT_IDENTITY, DT_S);
	for (int i = 0; i < RATE_SOURCES; i++) {
		assert_vec_near(r.out[i].omega_b_rad_s, along(0), 0);
		assert_vec_near(r.out[i].alpha_b_rad_s2, along(0), 0);
	}
}

static void test_a_new_filter_gives_the_rates_that_it_gives_from_the_start(void **state)
{
	const struct filter_config slow = {FILTER_BUTTERWORTH, 4, 5};
	struct rates changed = rates(&SMOOTH), fresh = rates(&slow);

	(void)state;
	for (int k = 0; k <= 800; k++) {
		if (k == 100)
			assert_int_equal(rates_configure(&changed, &slow, RATE_HZ), 0);
		step_swinging(&changed, k);
		step_swinging(&fresh, k);
	}
	for (int i = 0; i < RATE_SOURCES; i++) {
		assert_vec_near(changed.out[i].omega_b_rad_s, fresh.out[i].omega_b_rad_s, 1e-6);
		assert_vec_near(changed.out[i].alpha_b_rad_s2, fresh.out[i].alpha_b_rad_s2, 1e-6);
	}
}

/* What the first sample has turned by since then, the gyro measures as well. */
static void test_before_the_first_sample_the_attitude_is_that_of_no_turn(void **state)
{
	const struct vec3 turn = {0.01, -0.02, 0.03};
	struct rates r;

	(void)state;
	assert_int_equal(rates_init(&r, &SMOOTH, RATE_HZ), 0);
	rates_step(&r, vec3_scale(1 / DT_S, turn), quat_from_rotation_vector(turn), DT_S);
	assert_true(vec3_norm(r.out[RATES_FROM_GYRO].omega_b_rad_s) > 0);
	assert_vec_near(r.out[RATES_FROM_ANGLES].omega_b_rad_s, r.out[RATES_FROM_GYRO].omega_b_rad_s, 1e-9);
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_a_primed_differentiator_has_a_derivative_of_zero),
		cmocka_unit_test(test_the_derivative_of_a_parabola_is_followed_without_lag),
		cmocka_unit_test(test_uneven_sampling_times_do_not_disturb_the_derivative_of_a_ramp),
		cmocka_unit_test(test_the_poles_are_those_of_even_sampling_within_30_percent),
		cmocka_unit_test(test_a_lower_cutoff_lets_less_noise_through),
		cmocka_unit_test(test_the_fastest_cutoff_is_stable),
		cmocka_unit_test(test_both_sources_give_rate_and_acceleration_of_a_swinging_body),
		cmocka_unit_test(test_rates_from_the_attitude_are_independent_of_the_sign_of_the_quaternion),
		cmocka_unit_test(test_rates_from_the_attitude_pass_gimbal_lock_without_a_spike),
		cmocka_unit_test(test_a_new_filter_continues_without_a_step),
		cmocka_unit_test(test_a_filter_out_of_range_is_refused_and_the_old_one_stays),
		cmocka_unit_test(test_rates_begin_at_zero_whatever_the_memory_had),
		cmocka_unit_test(test_a_new_filter_gives_the_rates_that_it_gives_from_the_start),
		cmocka_unit_test(test_before_the_first_sample_the_attitude_is_that_of_no_turn),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
